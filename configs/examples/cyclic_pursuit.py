"""Cyclic pursuit: each robot pursues the next one, and all end on a circle, equally spaced.

Every robot drives towards the next one, turned outwards by an angle. With pi / N it stays on a circle on which the next
one is a chord away. A robot that is nearer turns further outwards, one that is further away turns inwards: so the
circle gets its radius (after Marshall, Broucke and Francis, 2004). Complex numbers turn a vector by one product.

Start it with: python configs/examples/cyclic_pursuit.py
"""

from pathlib import Path

import numpy as np

from robofleet import Fleet

RADIUS, SPEED = 0.5, 0.1  # [m], [m/s]

with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    n = len(fleet.robots)
    chord = 2 * RADIUS * np.sin(np.pi / n)
    z = fleet.points @ [1, 1j]
    order = np.argsort(np.angle(z - z.mean()))  # counter-clockwise
    pursued = order[(np.argsort(order) + 1) % n]
    for _ in fleet.ticks(40):
        z = fleet.points @ [1, 1j]
        to_next = z[pursued] - z
        angle = np.pi / n * np.minimum(chord / abs(to_next), 2.0)
        velocity = SPEED * np.exp(-1j * angle) * to_next / abs(to_next)
        fleet.move(np.column_stack([velocity.real, velocity.imag]))
    z = fleet.points @ [1, 1j]
    off, gaps = abs(z - z.mean()) - RADIUS, abs(z[pursued] - z)
    fleet.keep(off_circle_mm=1e3 * off, gap_mm=1e3 * gaps)

print(f"the robots are {np.round(1e3 * off)} mm off the circle; the next one is {np.round(1e3 * gaps)} mm away")
