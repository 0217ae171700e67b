"""The robots: from a recorded drive to tag offset, wheels, delay and lag."""
