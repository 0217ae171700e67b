"""One file for each process of a run."""
