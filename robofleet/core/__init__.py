"""What every room may use: clock, settings, files, JSON, plug-ins, bad input, compiled kernels."""
