"""Sweeps: many lockstep runs of one configuration, with keys, seeds and faults varied."""
