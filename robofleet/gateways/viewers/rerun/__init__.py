"""A run in rerun's archetypes, on rerun's own protocol."""
