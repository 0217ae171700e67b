"""The camera's pose: from surveyed marks on the floor."""
