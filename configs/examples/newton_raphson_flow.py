"""The Newton-Raphson flow by hand: the paper's law, which robofleet's controller is made of, in one screen of numpy.

u' = alpha (dg/du)^-1 (r(t + T) - g(x, u))  (eq. 14). g predicts the output at t + T, if u is held until then. The input
flows to where the prediction meets the reference. Here the plant is the unicycle, and its output a point ahead of the
axle. The law knows them by f and h alone: with another f and h, and their derivatives, it drives another robot.

Start it with: python configs/examples/newton_raphson_flow.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

ALPHA, T, STEPS = 45.0, 0.6, 6  # the paper's gain [1/s] and horizon [s]; steps of the prediction
AHEAD = 0.08  # of the point, before the axle [m]
RADII, LAP_S = np.array([1.0, 0.6]), 60.0  # the ellipse that the robots drive [m]

Array = NDArray[np.float64]


def f(x: Array, u: Array) -> tuple[Array, Array, Array]:
    """Return x', df/dx and df/du (eq. 27); x: z1, z2 [m], psi [rad]; u: v [m/s], omega [rad/s]."""
    s, c, v = np.sin(x[2]), np.cos(x[2]), u[0]
    f_x = np.array([[0, 0, -v * s], [0, 0, v * c], [0, 0, 0]])
    return np.array([v * c, v * s, u[1]]), f_x, np.array([[c, 0], [s, 0], [0, 1]])


def h(x: Array) -> tuple[Array, Array]:
    """Return the output y [m], and dh/dx."""
    s, c = np.sin(x[2]), np.cos(x[2])
    return x[:2] + AHEAD * np.array([c, s]), np.array([[1, 0, -AHEAD * s], [0, 1, AHEAD * c]])


def predict(x: Array, u: Array) -> tuple[Array, Array]:
    """Return g (eqs 11 to 13) and dg/du (eqs 24 and 25): the output after T, and how the input changes it."""
    dt, x_u = T / STEPS, np.zeros((3, 2))
    for _ in range(STEPS):
        rate, f_x, f_u = f(x, u)
        x, x_u = x + dt * rate, x_u + dt * (f_x @ x_u + f_u)
    y, h_x = h(x)
    return y, h_x @ x_u


def flow(x: Array, u: Array, r: Array, dt: float) -> tuple[Array, Array]:
    """Return u after dt, and the control error r - g: eq. 14 solved with x and r held.

    The paper's forward Euler has the gain alpha dt in place of 1 - exp(-alpha dt): here it would ring.
    """
    g, g_u = predict(x, u)
    return u + (1 - np.exp(-ALPHA * dt)) * np.linalg.solve(g_u, r - g), r - g


with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    first = np.arctan2(*(fleet.points / RADII).T[::-1])  # each robot begins where the ellipse is near it

    def reference(t: float) -> Array:
        """Return where the robots' points are to be (N, 2) [m]."""
        angle = first + 2 * np.pi * t / LAP_S
        position: Array = RADII * np.column_stack([np.cos(angle), np.sin(angle)])
        return position

    way = reference(0.1) - reference(0.0)
    heading = np.arctan2(way[:, 1], way[:, 0])
    centre = reference(0.0) - AHEAD * np.column_stack([np.cos(heading), np.sin(heading)])
    fleet.go_to({robot: (*centre[i], np.degrees(heading[i])) for i, robot in enumerate(fleet.robots)})
    fleet.mark("ellipse", [reference(t)[0] for t in np.linspace(0, LAP_S, 100)], closed=True)

    u, control, tracking = np.zeros((len(fleet.robots), 2)), [], []
    for t in fleet.ticks(20):
        steps = [flow(x, u, r, fleet.tick_s) for x, u, r in zip(fleet.poses, u, reference(t + T), strict=True)]
        u = np.array([step[0] for step in steps])
        fleet.drive(u)
        if t > 1.4:  # the transient's end in the paper
            control.append(np.linalg.norm([step[1] for step in steps], axis=1))
            tracking.append(np.linalg.norm(reference(t) - fleet.points, axis=1))
    fleet.keep(control_error_mm=1e3 * np.mean(control), tracking_error_mm=1e3 * np.mean(tracking))

print(f"mean control error |r(t+T) - g|: {1e3 * np.mean(control):.2f} mm; the paper's robots: 5 mm")
print(f"mean tracking error |r(t) - y|:  {1e3 * np.mean(tracking):.2f} mm")
