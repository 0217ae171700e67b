"""What a laboratory measures once: its camera, the camera's place, and each robot."""
