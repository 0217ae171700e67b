"""One file a protocol: the firmware of a kind of robot, imitated from its public description."""
