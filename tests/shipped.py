"""Configurations that come with robofleet."""

from robofleet.config.files.names import SHIPPED

PLATOON = SHIPPED / "platoon.yaml"
