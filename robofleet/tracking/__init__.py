"""Where each robot is: camera model, tags, filter."""
