"""Layouts for the viewers that open a run's file: what to plot, and a file of each viewer's own kind."""
