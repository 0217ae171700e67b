"""The lens: from images of a board to a camera model and its uncertainty."""
