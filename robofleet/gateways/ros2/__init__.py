"""ROS 2: what a run says, as a ROS 2 graph hears it; and velocities that ROS 2 nodes wish."""
