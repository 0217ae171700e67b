"""A recorded run in other programs' files: tables, a ROS 2 bag, a LeRobot dataset, a film."""
