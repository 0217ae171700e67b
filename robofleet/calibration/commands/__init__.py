"""The commands of ``robofleet calibrate`` and ``robofleet sheet``: what they ask, write and say."""
