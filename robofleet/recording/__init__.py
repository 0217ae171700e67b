"""What happened: metrics of a run."""
