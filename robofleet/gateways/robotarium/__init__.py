"""Scripts that were written for the Robotarium's Python simulator drive a fleet, unmodified."""
