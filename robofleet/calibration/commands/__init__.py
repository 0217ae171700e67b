"""Measure cameras and robots, once for each laboratory.

$ robofleet calibrate intrinsics ceiling --live configs/lab.yaml

$ robofleet calibrate arena ceiling survey.yaml --live configs/lab.yaml

Exit code 0: measured, and accurate enough to use. 2: refused, with a line for each reason; no file is written.
"""
