"""One file a process, and what runs them."""
