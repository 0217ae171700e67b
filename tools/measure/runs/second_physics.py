"""The shipped fleets on this project's own plant and on MuJoCo, by own pixels and by MuJoCo's, in lockstep.

    python -m tools.measure.runs.second_physics [--fleets platoon,go-to,formation] [--duration 88] [--settings '{...}']
    python -m tools.measure.runs.second_physics --frames 100 [--noise-gray 0]
    python -m tools.measure.runs.second_physics --rank [--duration 25]

Means of one run. Control errors do not see slip; true errors do: of the platoon's path, of the formation's shape, and
where robots that go to goals stand in the end, who have no control error. ``--settings`` are those of MuJoCo's plant.
``--frames``: instead, how exactly the tracker places robots on frames of either renderer. ``--rank``: instead, whether
both plants rank ten settings of the platoon's controller alike, by poses without images.
"""

import itertools
import math
from pathlib import Path

import numpy as np

from robofleet.config.load import load_config
from robofleet.core.clock import S, cpu_ns
from robofleet.simulation.mujoco.camera import MujocoCamera
from robofleet.simulation.sources import SimulatedCamera
from robofleet.testing import run_lockstep
from robofleet.tracking.sight import FleetSight
from tools.measure.program import program

CONFIGS = Path(__file__).parents[3] / "configs"
WAYS = {
    "own plant, own pixels": (),
    "MuJoCo, own pixels": ("plant.model=mujoco",),
    "MuJoCo, its pixels": ("plant.model=mujoco", "camera.source=mujoco"),
}
RANKED = [  # horizon_s, alpha, point_ahead_m
    (0.6, 45, 0.08), (0.3, 45, 0.08), (0.9, 45, 0.08), (1.2, 45, 0.08), (0.6, 10, 0.08),
    (0.6, 20, 0.08), (0.6, 45, 0.05), (0.6, 45, 0.12), (0.4, 20, 0.06), (0.9, 15, 0.10),
]  # fmt: skip
CONTROL_ERROR = "control_error_mm"
TRUE_ERRORS = ("path_error_mm", "shape_error_mm", "final_distance_to_goal_mm")
SETTLED = 4  # frames until a tag is followed


def drive(fleet: str, changes: list[str]) -> list[str]:
    """Return a run's row: outcome, figures [mm], CPU time [s]."""
    began_ns = cpu_ns()
    run = run_lockstep(load_config(CONFIGS / f"{fleet}.yaml", changes))
    (group,) = run.summary["groups"].values()
    true = next(key for key in TRUE_ERRORS if key in group)
    means = [group[key] and group[key]["mean"] for key in (CONTROL_ERROR, true) if key in group]
    pose, gap = run.summary["pose_error"], run.summary["min_gap_mm"]
    figures = [*[None] * (2 - len(means)), *means, pose and pose["rms_mm"], gap]
    shown = ["-" if figure is None else f"{figure:.2f}" for figure in figures]
    return [run.outcome, *shown, f"{(cpu_ns() - began_ns) / S:.0f}"]


def rank(duration_s: float) -> None:
    """Print the path and control errors of each setting on both plants, and Kendall's tau of each."""
    print("horizon s, alpha, point ahead m | path error own, MuJoCo mm | control error own, MuJoCo mm")
    rows: list[list[float]] = []
    for horizon, alpha, ahead in RANKED:
        keys = {"controller.horizon_s": horizon, "controller.alpha": alpha, "controller.point_ahead_m": ahead}
        changes = [f"{key}={value}" for key, value in keys.items()]
        means: list[float] = []
        for plant in ("own", "mujoco"):
            run = ["tracker.source=truth", f"run.duration_s={duration_s}", f"plant.model={plant}", *changes]
            figures = run_lockstep(load_config(CONFIGS / "platoon.yaml", run)).summary
            means += [figures[key]["mean"] for key in ("path_error_mm", CONTROL_ERROR)]
        rows.append(means)
        print(
            f"{horizon}, {alpha}, {ahead} | {means[0]:.3f}, {means[2]:.3f} | {means[1]:.3f}, {means[3]:.3f}", flush=True
        )
    for name, own, other in zip(("path", "control"), (0, 1), (2, 3), strict=True):
        pairs = itertools.combinations(rows, 2)
        agree = [np.sign((a[own] - b[own]) * (a[other] - b[other])) for a, b in pairs]
        print(f"Kendall's tau, {name} error: {np.mean(agree):.2f}")


def frames(count: int, noise_gray: float) -> None:
    """Print errors of robots that stand anywhere under the shipped camera, on frames with so much noise."""
    config = load_config(CONFIGS / "platoon.yaml", [f"camera.noise_gray={noise_gray}"])
    rows = {robot.tag: row for row, robot in enumerate(config.robots)}
    print("renderer | poses | position rms, worst mm | heading rms, worst deg | lost")
    for name, camera in (("own", SimulatedCamera), ("MuJoCo", MujocoCamera)):
        renderer, rng = camera.renderer(config, np.random.default_rng(1)), np.random.default_rng(2)
        errors: list[np.ndarray] = []
        wanted = 0
        for _ in range(count):
            x = np.linspace(-1.2, 1.2, 4) + rng.uniform(-0.25, 0.25, 4)
            poses = np.column_stack([x, rng.uniform(-0.85, 0.85, 4), rng.uniform(-math.pi, math.pi, 4)])
            sight = FleetSight(config)
            for k in range(SETTLED + 1):
                seen = sight.see(renderer.render(poses).copy(), (k + 1) * S // 30).poses
            wanted += len(poses)
            errors += [np.array([pose.x, pose.y, pose.psi]) - poses[rows[pose.tag]] for pose in seen]
        off = np.array(errors)
        mm = 1e3 * np.hypot(off[:, 0], off[:, 1])
        deg = np.degrees(np.abs(np.remainder(off[:, 2] + math.pi, math.tau) - math.pi))
        mm_rms, deg_rms = (math.sqrt(np.mean(values**2)) for values in (mm, deg))
        print(
            f"{name} | {len(off)} | {mm_rms:.4f}, {mm.max():.4f} | {deg_rms:.4f}, {deg.max():.4f} | {wanted - len(off)}"
        )


def main() -> None:
    arguments = program(
        __doc__, fleets="platoon,go-to,formation", duration=0.0, settings="{}", frames=0, noise_gray=3.0, rank=False
    ).parse_args()
    if arguments.rank:
        rank(arguments.duration or 25.0)
        return
    if arguments.frames:
        frames(arguments.frames, arguments.noise_gray)
        return
    print("fleet | plant, pixels | outcome | control error | true error | pose rms | smallest gap mm | CPU s")
    for fleet in arguments.fleets.split(","):
        for way, changes in WAYS.items():
            own = [*changes, *([f"run.duration_s={arguments.duration}"] if arguments.duration else [])]
            if changes:
                own.append(f"plant.settings={arguments.settings}")
            print(" | ".join([fleet, way, *drive(fleet, own)]), flush=True)


if __name__ == "__main__":
    main()
