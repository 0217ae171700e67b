"""A run on Foxglove's own protocol, for Foxglove and Lichtblick."""
