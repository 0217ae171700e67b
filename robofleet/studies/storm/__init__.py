"""Fuzz tests of a fleet: random faults by the thousand, in lockstep, and independent judges of what the fleet did."""
