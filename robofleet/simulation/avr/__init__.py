"""An emulated Arduino: simavr behind a shim in C, and the Python around it."""
