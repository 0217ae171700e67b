"""Model-predictive control: the first robot parks, and plans its next three seconds round an obstacle at every tick.

The plan is the inputs u_0, u_1, ... of a unicycle that minimise its distance from the goal, within the wheels' limits
and outside of the obstacle. The robot does u_0; the next tick plans anew from what it sees. casadi finds derivatives
and plan. Compare newton_raphson_flow.py, which takes one linear solve a tick, but knows no obstacles.

Start it with: python configs/examples/mpc.py
"""

import sys
from pathlib import Path

import numpy as np

from robofleet import Fleet

try:
    import casadi as ca
except ModuleNotFoundError:
    print(f"this needs casadi: {sys.executable} -m pip install casadi", file=sys.stderr)
    raise SystemExit(2) from None

NODES, STEP = 15, 0.2  # of the plan; from one to the next [s]
GOAL = np.array([0.4, -0.3, 0.0])  # [m, m, rad]
NEAR = 0.015, 0.05  # it has parked: within [m], [rad]
LIMIT = np.array([0.12, 1.5])  # of v [m/s] and omega [rad/s]
OBSTACLE, RADIUS = np.array([-0.3, 0.1]), 0.25  # that the centre keeps out of [m]

opti = ca.Opti()
now, z, u = opti.parameter(3), opti.variable(3, NODES + 1), opti.variable(2, NODES)
inside = opti.variable(NODES)  # how far a node is inside: poses have noise, and a plan there must be
opti.subject_to(z[:, 0] == now)
for k in range(NODES):
    opti.subject_to(opti.bounded(-LIMIT, u[:, k], LIMIT))
    psi = z[2, k] + STEP / 2 * u[1, k]  # in the middle of the step
    opti.subject_to(z[:, k + 1] == z[:, k] + STEP * ca.vertcat(u[0, k] * ca.cos(psi), u[0, k] * ca.sin(psi), u[1, k]))
    opti.subject_to(ca.sumsqr(z[:2, k + 1] - OBSTACLE) >= RADIUS**2 - inside[k])
opti.subject_to(inside >= 0)
away, turned = ca.sumsqr(z[:2, 1:] - ca.repmat(GOAL[:2], 1, NODES)), ca.sum2(1 - ca.cos(z[2, 1:] - GOAL[2]))
opti.minimize(away + 0.02 * turned + 0.001 * ca.sumsqr(u) + 10 * ca.sum1(inside))
opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes"})

with Fleet.from_arguments(Path(__file__).parents[1] / "script.yaml") as fleet:
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    fleet.mark("obstacle", OBSTACLE + RADIUS * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
    clearance = np.inf
    setpoints = np.zeros((len(fleet.robots), 2))
    for _ in fleet.ticks(30):
        opti.set_value(now, fleet.poses[0])
        plan = opti.solve()
        opti.set_initial(plan.value_variables())  # the next plan is much the same
        setpoints[0] = plan.value(u[:, 0])
        fleet.drive(setpoints)
        fleet.mark("plan", np.transpose(plan.value(z[:2, :])), line=True)
        clearance = min(clearance, float(np.linalg.norm(fleet.poses[0, :2] - OBSTACLE)) - RADIUS)
        off = fleet.poses[0] - GOAL
        if np.linalg.norm(off[:2]) < NEAR[0] and abs(off[2]) < NEAR[1]:
            break
    away_mm, clearance_mm = 1e3 * np.linalg.norm(off[:2]), 1e3 * clearance
    fleet.keep(from_goal_mm=away_mm, clearance_mm=clearance_mm)

print(f"the robot is {away_mm:.1f} mm and {np.degrees(off[2]):+.1f} degrees from its goal,")
print(f"and was never nearer to the obstacle than {clearance_mm:.1f} mm")
