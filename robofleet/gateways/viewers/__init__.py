"""A run in viewers, while it is on."""
