"""A gamepad at a computer of the operator's drives a robot, without a browser."""
