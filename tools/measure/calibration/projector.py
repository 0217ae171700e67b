"""Projectors calibrated by cameras: where their light falls against where it should, and whether predictions are true.

    python -m tools.measure.calibration.projector [--seeds N] [--seams N] [--camera-error]     (from the project's root)

Each seed draws a projector with 5 degrees of keystone, a lens, focus and vignetting, over the shipped configuration's
floor and camera, and two projectors over that of two cameras. Everything is photographed by simulated cameras with
noise; time is simulated. ``--camera-error``: the cameras hang elsewhere than their calibration says, by draws of its
covariance. Chi-square: the mean of e' S^-1 e over the floor, over 2: 1 where predictions are true.
"""

import math
from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from robofleet.calibration.extrinsics.placing import PARAMETERS, moved, rotation_vector
from robofleet.calibration.projector.measured import Found, measure
from robofleet.calibration.projector.photographs import Photographer, SimulatedDisplay
from robofleet.calibration.store import provenance
from robofleet.config.calibrated import CameraModel, PoseSettings
from robofleet.config.load import load_config, spelled
from robofleet.config.tree import Config
from robofleet.core.clock import S, SimulatedClock
from robofleet.projection.model import Projector
from robofleet.projection.patterns import Grid, read
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraContext
from tools.measure.program import program

_SIZE = 1920, 1080
_KEYSTONE_DEG = 5.0
_ARENAS = ("platoon.yaml", {"main": 0.0}), ("two-cameras.yaml", {"left": -1.4, "right": 1.4})
_TURN_RAD, _SHIFT_M = math.radians(0.01), 3e-4  # standard deviations of a camera's pose, in each direction


class Skipping(SimulatedClock):
    """A clock that skips all waiting."""

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        self.advance_to(max(instant_ns, self.now_ns()))


def drawn(rng: np.random.Generator, name: str, x: float, focal_px: float, height_m: float) -> dict[str, Any]:
    """Return a projector that hangs near x on the arena's long axis, as a configuration has it."""
    around = rng.uniform(-math.pi, math.pi)
    tilt = math.radians(_KEYSTONE_DEG) * np.array([math.cos(around), math.sin(around), 0.0])
    about = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, rng.normal(0.0, 0.01)]))[0]
    R = np.asarray(np.diag([1.0, -1.0, -1.0]) @ about, np.float64)
    aim = np.array([x, 0.0, 0.0]) + np.append(rng.normal(0.0, 0.02, 2), 0.0)
    eye = aim - R[:, 2] * height_m / -R[2, 2]
    model = {
        "width": _SIZE[0], "height": _SIZE[1], "focal_px": [focal_px] * 2,
        "centre_px": (np.array([959.5, 539.5]) + rng.normal(0.0, [5.0, 20.0])).tolist(),
        "distortion": (rng.normal(0.0, 1.0, 4) * [0.03, 0.01, 5e-4, 5e-4]).tolist(),
        "T_world_projector": {"position_m": eye.tolist(), "rotation_rad": rotation_vector(R).tolist()},
        "delay_s": rng.uniform(0.033, 0.067),
    }  # fmt: skip
    truth = {"model": model, "vignetting": rng.uniform(0.0, 0.4), "focus_px": rng.uniform(0.5, 2.0)}
    return {"name": name, "width": _SIZE[0], "height": _SIZE[1], "simulated": truth}


def configured(file: str, seed: int, projectors: list[dict[str, Any]]) -> Config:
    changes = ["tracker.source=truth", f"run.seed={seed}", f"projectors={spelled(projectors)}"]
    config = load_config(Path("configs") / file, changes)
    free = tuple(camera.model_copy(update={"trigger": "free"}) for _, camera in config.camera_keys)
    return config.model_copy(update={"camera": free[0], "cameras": free if config.cameras else ()})


def miscalibrated(model: CameraModel, rng: np.random.Generator) -> CameraModel:
    """Return a camera's file that is wrong by a draw of the covariance that it states."""
    sigma = np.array([_TURN_RAD] * 3 + [_SHIFT_M] * 3)
    T = moved(CameraGeometry.from_model(model).T_world_camera, sigma * rng.standard_normal(6))
    pose = PoseSettings(position_m=tuple(T[:3, 3].tolist()), rotation_rad=tuple(rotation_vector(T[:3, :3]).tolist()))
    where = provenance("arena", {}, {}, PARAMETERS, np.diag(sigma**2).tolist())
    return model.model_copy(update={"T_world_camera": pose, "arena": where})


def calibrated(config: Config, known: Mapping[str, CameraModel]) -> tuple[dict[str, Found], float]:
    """Calibrate all projectors; returns what was found, and the time for the photographs of one [s; simulated]."""
    clock, grid, found = Skipping(), Grid(_SIZE), {}
    views = {camera.name: config.model_copy(update={"camera": camera}) for _, camera in config.camera_keys}
    cameras = {name: SimulatedCamera(CameraContext.without_run(view, clock)) for name, view in views.items()}
    pictures, began_ns = grid.pictures(), clock.now_ns()
    for projector in config.projectors:
        photographer = Photographer(SimulatedDisplay(projector.name, cameras, clock), cameras, clock)
        taken = {shown: photographer.take(picture) for shown, picture in pictures.items()}
        seen = {camera: {shown: means[camera] for shown, means in taken.items()} for camera in cameras}
        readings = {camera: read(grid, images) for camera, images in seen.items()}
        brightest = max(readings, key=lambda camera: readings[camera].lit)
        delay_s = photographer.delay_s(brightest, pictures, seen[brightest])
        for camera in cameras.values():
            camera.project(projector.name, pictures["black"])
        found[projector.name] = measure(
            projector.name, grid, known, readings, delay_s, config.arena.size_m, [None], 1.0, {}
        )
    return found, (clock.now_ns() - began_ns) / S / len(config.projectors)


def lit(truth: Projector, model: Projector, points: np.ndarray) -> np.ndarray:
    """Return where the light falls that a calibration means for points (N, 3): (N, 2) [m]; NaN: none."""
    places: np.ndarray = truth.floor(model.pixels(points))
    return places


def truth_of(config: Config, name: str) -> Projector:
    simulated = next(each.simulated for each in config.projectors if each.name == name)
    assert simulated is not None
    return Projector.from_model(simulated.model)


def main() -> None:
    arguments = program(
        __doc__, seeds=20, camera_error=False, seams=(5, "seeds of which two projectors are calibrated, too")
    ).parse_args()
    print("seed | max mm | rms mm | predicted rms mm | chi-square | tags | delay off ms | photographs s | seam mm")
    rows = []
    for seed in range(1, arguments.seeds + 1):
        rng = np.random.default_rng(seed)
        row: list[float] = []
        for file, places in _ARENAS if seed <= arguments.seams else _ARENAS[:1]:
            config = configured(file, seed, [drawn(rng, name, x, 1500.0, 3.2) for name, x in places.items()])
            known = {
                camera.name: miscalibrated(camera.model, rng) if arguments.camera_error else camera.model
                for _, camera in config.camera_keys
            }
            found, photographs_s = calibrated(config, known)
            if len(found) == 1:
                row += figures(config, found["main"], photographs_s)
            else:
                fallen = [lit(truth_of(config, name), own.fit.projector, own.points) for name, own in found.items()]
                row.append(1e3 * float(np.nanmax(np.linalg.norm(fallen[0] - fallen[1], axis=1))))
        rows.append(row)
        print(seed, *(f"{value:.3g}" for value in row), sep=" | ", flush=True)
    columns = list(zip_longest(*rows))
    for name, statistic in (("mean", np.mean), ("max", np.max)):
        print(
            name, *(f"{statistic([cell for cell in column if cell is not None]):.3g}" for column in columns), sep=" | "
        )


def figures(config: Config, found: Found, photographs_s: float) -> list[float]:
    truth, projector = truth_of(config, "main"), found.fit.projector
    inside = np.isfinite(found.sigma_m)
    points = found.points[inside]
    error = lit(truth, projector, points) - points[:, :2]
    weighted = np.linalg.solve(projector.spread(points), error[:, :, None])[:, :, 0]
    chi_square = float((error * weighted).sum(axis=1).mean()) / 2.0
    off_mm = 1e3 * np.linalg.norm(error, axis=1)
    delay_off_ms = (found.figures["delay_ms"] or 0.0) - 1e3 * _delay_s(config)
    predicted_mm = 1e3 * math.sqrt(float((found.sigma_m[inside] ** 2).mean()))
    return [
        float(off_mm.max()), math.sqrt(float((off_mm**2).mean())), predicted_mm, chi_square,
        float(found.fit.used.sum()), delay_off_ms, photographs_s,
    ]  # fmt: skip


def _delay_s(config: Config) -> float:
    simulated = config.projectors[0].simulated
    assert simulated is not None
    return simulated.model.delay_s


if __name__ == "__main__":
    main()
