"""Writes the configuration of a large fleet, that of the rows ``scale`` of ``bench.py``, for a run in real time.

.venv/bin/python tools/large_fleet.py 100 --units 4 --out hundred.yaml
.venv/bin/python tools/large_fleet.py 50 --units 2 --camera --out fifty.yaml
"""

import argparse
from pathlib import Path

from packages import needing

with needing("bench", "lab"):
    import cv2  # noqa: F401 - what bench_scale needs, named first
    import yaml
    from bench_scale import fleet


def as_file(count: int, units: int, *, camera: bool) -> str:
    """Return the configuration of a fleet whose robots share so many units.

    ``camera``: one of 1920 x 1080 pixels, as high as it must hang, sees them all, with tags that it finds from there.
    """
    tree = fleet(count).model_dump(mode="json", exclude_defaults=True)
    for k, robot in enumerate(tree["robots"]):
        robot["unit"] = f"u{k % units + 1}"
    if camera:
        width, height, shipped = 1920, 1080, tree["camera"]["model"]
        larger = width / shipped["width"]
        shipped |= {"width": width, "height": height}
        shipped |= {name: [larger * value for value in shipped[name]] for name in ("focal_px", "centre_px")}
        high = max(tree["arena"]["size_m"][0] / width, tree["arena"]["size_m"][1] / height) * shipped["focal_px"][0]
        shipped["T_world_camera"]["position_m"] = [0.0, 0.0, 1.03 * high]
        tree["camera"] |= {"width": width, "height": height, "trigger": "tick"}
        tree["tracker"] |= {"source": "camera", "tag_side_m": 0.085}
    return yaml.safe_dump(tree, sort_keys=False)


def main() -> None:
    """Write a configuration."""
    parser = argparse.ArgumentParser(description="Write the configuration of a large fleet.")
    parser.add_argument("robots", type=int)
    parser.add_argument("--units", type=int, default=1)
    parser.add_argument("--camera", action="store_true")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.write_text(as_file(arguments.robots, arguments.units, camera=arguments.camera))


if __name__ == "__main__":
    main()
