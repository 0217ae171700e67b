"""Hello: one robot drives a square, corner by corner; the others stand.

Start it with: python configs/examples/hello.py
"""

from pathlib import Path

from robofleet import Fleet

CORNERS = [(-0.3, -0.3, 0), (0.3, -0.3, 90), (0.3, 0.3, 180), (-0.3, 0.3, 270), (-0.3, -0.3, 0)]  # [m, m, deg]

with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    robot = fleet.robots[0]
    for corner in CORNERS:
        fleet.go_to({robot: corner})
        x, y, _ = fleet.poses[0]
        print(f"{fleet.time:5.1f} s: {robot} is at ({x:+.3f}, {y:+.3f}) m, its corner is {corner[:2]}")
