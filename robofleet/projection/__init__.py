"""Projectors: where their light falls, how that is measured, and what shows their pictures."""
