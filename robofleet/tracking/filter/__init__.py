"""The fleet filter: poses of all robots from the measurements of all cameras."""
