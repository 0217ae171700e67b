"""Where the experiments' parameters are: ``configs/paper/<name>.yaml``."""

from pathlib import Path

SHIPPED = Path(__file__).parents[1] / "configs" / "paper"
