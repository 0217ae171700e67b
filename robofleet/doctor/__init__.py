"""What a run needs of this machine, looked at without a run: ``robofleet doctor``."""
