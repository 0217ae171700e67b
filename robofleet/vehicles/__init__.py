"""How things move. Pure: no clock, no I/O; free of numba, for a robot's small computer."""
