"""Cameras: drivers, recorded images, troubles of a camera, exposure."""
