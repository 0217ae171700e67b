"""A projector's light in a run: halos against their robots, a lap on a lit floor, the seam of two projectors.

    python -m tools.measure.tracking.projected_light [halo] [lap] [seam]      (from the project's root)

``halo``: robots at 0.2 m/s, three pictures of delay, the shipped projector. The camera sees each halo, a circle is
fitted to its light on the floor, and its centre is compared with the robot's true place at the image's mid-exposure.
``lap``: the paper's lap in lockstep with rendered images, on the dark floor, with paths, references and halos, and
with a checkerboard over the whole floor beside them; without the discs around the robots, too. ``seam``: two
projectors, calibrated by two cameras, show a white image during a run: how bright the floor is where both light it.
"""

import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import cv2
import numpy as np
import yaml

from robofleet.bus.keys import TRUTH
from robofleet.config.load import spelled
from robofleet.config.projectors import ProjectorOptics
from robofleet.core.arrays import Array, Array32
from robofleet.core.clock import S, stopwatch_ns
from robofleet.projection.drawing import SIZES
from robofleet.projection.model import Projector
from robofleet.recording.run import Run
from robofleet.reports.metrics import summary
from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraContext, Frame
from tools.measure.calibration.projector import calibrated, configured, drawn
from tools.measure.program import program

_FILE = Path("configs") / "projector.yaml"
_GROUP = "{behaviour: platoon, robots: [r1, r2, r3, r4], settings: {path: platoon, spacing_m: 0.4, path_rate: 0.09}}"
_TWO = "two-cameras.yaml"
_FAST_M_S = 0.18, 0.22
_CELL_PX, _CELLS = 60, (32, 20)  # of the checkerboard: 0.1 m on the floor
_AROUND = np.ones((21, 21), np.uint8)  # blurred edges of discs [px]
_LEAST_PX = 200  # of a halo that is seen whole, or nearly so
_ROUND = 0.2  # by which a halo's greatest and least radius differ at most, as a share


def faster() -> list[str]:
    """Return the changes by which the robots drive twice as fast as they can."""
    gternal = yaml.safe_load((_FILE.parent / "robots" / "gternal.yaml").read_text())
    gternal |= {"max_speed_m_s": 0.4, "max_wheel_speed_rad_s": 25.0}
    robots = [{"id": f"r{tag}", "tag": tag, "vehicle": gternal} for tag in range(1, 5)]
    return [f"robots={spelled(robots)}", f"groups=[{_GROUP}]"]


class WatchingCamera(SimulatedCamera):
    """A simulated camera that keeps where halos lie on the floor."""

    halos: ClassVar[list[tuple[int, Array]]] = []  # mid-exposure [ns], centres (n, 2) [m]
    cameras: ClassVar[list["WatchingCamera"]] = []

    def __init__(self, context: CameraContext) -> None:
        super().__init__(context)
        model = context.config.camera.model
        v, u = np.mgrid[: model.height, : model.width]
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
        self.cameras.append(self)
        self.floor = CameraGeometry.from_model(model).to_plane(pixels, 0.0).reshape(model.height, model.width, 2)

    def read(self) -> Frame:
        frame = super().read()
        assert self.projection is not None
        self.halos.append((frame.exposure_ns, rings(self.projection.light[0], self.floor)))
        return frame


_WATCHING = f"{WatchingCamera.__module__}:{WatchingCamera.__name__}"


def rings(light: Array32, floor: Array) -> Array:
    """Return the centres (n, 2) [m] of bright rings in light (H, W) whose pixels lie at ``floor`` (H, W, 2)."""
    bright = (light > 0.5 * light.max()).astype(np.uint8) if light.max() > 0 else np.zeros(light.shape, np.uint8)
    count, labels = cv2.connectedComponents(bright)
    found = []
    for label in range(1, count):
        points, weights = floor[labels == label], light[labels == label]
        if len(points) < _LEAST_PX:
            continue
        # x^2 + y^2 = 2 a x + 2 b y + c
        A = np.column_stack([2.0 * points, np.ones(len(points))]) * weights[:, None]
        centre = np.linalg.lstsq(A, weights * (points**2).sum(axis=1), rcond=None)[0][:2]
        radii = np.linalg.norm(points - centre, axis=1)
        if np.ptp(radii) < _ROUND * radii.mean():
            found.append(centre)
    return np.reshape(found, (-1, 2))


def measure_halo(duration_s: float) -> None:
    """Print how far halos lie from their robots, of the images in which robots drive fast."""
    WatchingCamera.halos.clear()
    shown = "projection={show: [halos]}"
    run = Lockstep(
        load_checked(
            _FILE, [*faster(), f"camera.source={_WATCHING}", shown, f"run.duration_s={duration_s}"], lockstep=True
        )
    )
    with patch.dict(SIZES, arrow=0.0):  # its light would be a part of the circle's
        print(f"  {why(*run.run())}")
    start_ns = int(Run(run.recording).ticks["stamp_ns"][0])
    halos = [(exposure_ns, centres) for exposure_ns, centres in WatchingCamera.halos if exposure_ns >= start_ns]
    exposures_ns = np.array([exposure_ns for exposure_ns, _ in halos])
    places, speeds = [], []
    for robot in run.recording.config.members:
        true = run.recording.of_robot(TRUTH, robot.id)
        x, y, v = (np.interp(exposures_ns, true["stamp_ns"], true[name]) for name in ("x_m", "y_m", "v_m_s"))
        places.append(np.column_stack([x, y]))
        speeds.append(v)
    at, true_m_s = np.stack(places, axis=1), np.stack(speeds, axis=1)
    pairs = [
        (np.linalg.norm(at[k] - centre, axis=1).min(), true_m_s[k, np.linalg.norm(at[k] - centre, axis=1).argmin()])
        for k, (_, centres) in enumerate(halos)
        for centre in centres
    ]
    off_m, speed_m_s = np.array(pairs).T
    (low, high), every = _FAST_M_S, np.ones(len(off_m), np.bool_)
    for name, which in (("all", every), (f"{low} to {high} m/s", (low <= speed_m_s) & (speed_m_s <= high))):
        median, p99, most = 1e3 * np.percentile(off_m[which], [50, 99, 100])
        print(f"  halos, {name}: {which.sum()} seen, {speed_m_s[which].mean():.3f} m/s in the mean: "
              f"off {median:.2f} mm in the median, {p99:.2f} mm p99, {most:.2f} mm at most")  # fmt: skip


def measure_lap(duration_s: float, which: Sequence[str]) -> None:
    """Print a lap's figures under each light."""
    with tempfile.TemporaryDirectory() as folder:
        checkerboard = Path(folder) / "checkerboard.png"
        cells = 255 * (np.indices(_CELLS[::-1]).sum(axis=0) % 2).astype(np.uint8)
        cv2.imwrite(str(checkerboard), np.kron(cells, np.ones((_CELL_PX, _CELL_PX), np.uint8)))
        lights = {
            "dark": ("projectors=[]",),
            "paths": (),
            "checkerboard": (f"projection.background={checkerboard}",),
            "without discs": (f"projection.background={checkerboard}",),
        }
        for name in which or lights:
            none = patch("robofleet.simulation.run_picture.disc_radii", lambda config: np.zeros(len(config.bodies)))
            with none if name == "without discs" else nullcontext():
                print_lap(name, f"run.duration_s={duration_s}", *lights[name])


def print_lap(name: str, *overrides: str) -> None:
    began_ns = stopwatch_ns()
    run = Lockstep(load_checked(_FILE, overrides, lockstep=True))
    outcome, cause = run.run()
    columns = Run(run.recording)
    figures = summary(run.recording, name=name, mode="lockstep", outcome=outcome, cause=cause, run=columns)
    missed, lost = 1.0 - columns.items["measured"].mean(), int((columns.items["lost"] > 0).sum())
    pose_mm, control_mm = figures["pose_error"]["rms_mm"], figures["control_error_mm"]["mean"]
    print(
        f"  {name}: {why(outcome, cause)}, not measured {100 * missed:.3f} %, lost {lost}, pose {pose_mm:.4f} mm rms, "
        f"control error {control_mm:.4f} mm, {(stopwatch_ns() - began_ns) / S:.0f} s",
        flush=True,
    )


def why(outcome: str, cause: str | None) -> str:
    return f"{outcome}: {cause}" if cause else outcome


def measure_seam() -> None:
    """Print how bright the floor is where two projectors light it, beside where one does."""
    rng = np.random.default_rng(1)
    projectors = [drawn(rng, name, x, 1500.0, 3.2) for name, x in (("left", -1.4), ("right", 1.4))]
    for projector in projectors:
        projector["simulated"]["vignetting"] = 0.0  # which no calibration knows
    config = configured(_TWO, 1, projectors)
    found, _ = calibrated(config, {camera.name: camera.model for _, camera in config.camera_keys})
    for projector in projectors:
        projector["calibration"] = found[projector["name"]].model.model_dump(mode="json")
    WatchingCamera.cameras.clear()
    with tempfile.TemporaryDirectory() as folder:
        white = Path(folder) / "white.png"
        cv2.imwrite(str(white), np.full((20, 60), 255, np.uint8))
        changes = [
            *(f"cameras.{k}.source={_WATCHING}" for k in range(2)), f"projectors={spelled(projectors)}",
            f"projection={{show: [background], background: {white}}}", "run.duration_s=1",
        ]  # fmt: skip
        print(f"  {why(*Lockstep(load_checked(_FILE.with_name(_TWO), changes, lockstep=True)).run())}")
    truths = [Projector.from_model(ProjectorOptics(**each["simulated"]["model"])) for each in projectors]
    for camera in WatchingCamera.cameras:
        assert camera.projection is not None
        points = camera.floor.reshape(-1, 2)
        inside = np.abs(points / config.arena.size_m).max(axis=1) < 0.4  # outer edges of pictures are dark
        lit = np.array([truth.lights(np.column_stack([points, np.zeros(len(points))])) for truth in truths])
        light = camera.projection.light[0]
        whole = cv2.erode((light > 0.5 * light.max()).astype(np.uint8), _AROUND).ravel() > 0  # but for discs
        light, bright = light.ravel(), inside & whole
        usual = np.median(light[bright & (lit.sum(axis=0) == 1)])
        low, high = np.percentile(light[bright & lit.all(axis=0)], [0.1, 99.9]) / usual
        print(f"  where both light the floor: {100 * low - 100:+.1f} to {100 * high - 100:+.1f} %")
    places = found["left"].points
    fallen = [
        truth.floor(found[each["name"]].fit.projector.pixels(places))
        for truth, each in zip(truths, projectors, strict=True)
    ]
    print(f"  what both draw is {1e3 * np.nanmax(np.linalg.norm(fallen[0] - fallen[1], axis=1)):.2f} mm apart at most")


def main() -> None:
    parser = program(__doc__, seconds=(88.0, "of a lap, and half of it of the halos"), light=("", "which alone"))
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    given = parser.parse_args()
    for part in given.parts or PARTS:
        print(f"{part}:")
        if part == "halo":
            measure_halo(given.seconds / 2)
        elif part == "seam":
            measure_seam()
        else:
            measure_lap(given.seconds, [given.light] if given.light else [])


PARTS = "halo", "lap", "seam"

if __name__ == "__main__":
    main()
