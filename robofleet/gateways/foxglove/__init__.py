"""A run on Foxglove's own protocol, for viewers that look at it while it is on."""
