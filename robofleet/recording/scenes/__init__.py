"""What viewers draw of a run: the messages of their own that a recording holds."""
