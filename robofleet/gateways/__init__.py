"""Other worlds: programs that were written for something else drive a fleet."""
