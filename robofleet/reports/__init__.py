"""What a run was: metrics, bounds, plots, report, comparison."""
