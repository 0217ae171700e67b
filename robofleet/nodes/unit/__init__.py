"""A driver process: the robots of one unit behind their gates."""
