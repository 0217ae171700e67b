"""The interface for a user's own script (``robofleet.Fleet``), and its links to runs."""
