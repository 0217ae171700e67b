"""Configurations that come with robofleet."""

import yaml

from robofleet.config.calibrated import CameraModel
from robofleet.config.files.names import SHIPPED

PLATOON = SHIPPED / "platoon.yaml"
OVERHEAD = CameraModel.model_validate(yaml.safe_load((SHIPPED / "cameras" / "overhead.yaml").read_text()))
