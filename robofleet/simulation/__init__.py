"""The laboratory that isn't there."""
