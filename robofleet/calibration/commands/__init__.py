"""The commands of ``tools/calibrate.py``: what they ask, write and say."""
