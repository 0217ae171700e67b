"""ROS 2: a run's messages on a ROS 2 graph; and velocity commands of ROS 2 nodes."""
