"""What photographs of a grid of tags tell of a projector, and whether that is good enough."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.extrinsics.arena import covariance_of
from robofleet.calibration.extrinsics.placing import PARAMETERS, on_plane
from robofleet.calibration.extrinsics.region import lattice
from robofleet.calibration.store import CalibrationError, provenance
from robofleet.config.calibrated import CameraModel
from robofleet.config.projectors import ProjectorModel
from robofleet.core.arrays import Array
from robofleet.projection.fit import LEAST, Fit, FitError, Seen, fit
from robofleet.projection.model import VALUES, Projector
from robofleet.projection.patterns import Grid, Reading, bends
from robofleet.tracking.camera import CameraGeometry

_LAID_PX = 0.007  # to which a camera sees prints where they are, however many it averages: measured in simulation
_LEAST_LIT = 0.005  # share of an image in which light that falls into it tells
_SATURATED = 0.5  # share of its light
_BLUR_M = 0.006  # standard deviation of an edge, above which lines are smeared
_USABLE_M = 0.002  # predicted error
_CAMERA_BLUR_PX = 0.8  # standard deviation of an edge by a sharp camera's lens and pixels
_STEP_PX = 0.1


class Found(NamedTuple):
    """A projector that can be used."""

    model: ProjectorModel
    fit: Fit
    seen: Array  # (N, 2) where the tags were seen [m; world]
    points: Array  # (ROWS * COLUMNS, 3) all over the arena [m; world]
    sigma_m: Array  # (G,) predicted there, both coordinates together; NaN: not lit, or reached by no pattern
    covered: float  # share of the arena that all projectors light together
    notes: tuple[str, ...]

    @property
    def figures(self) -> Mapping[str, float | None]:
        assert self.model.calibrated is not None
        return self.model.calibrated.figures


def measure(
    name: str,
    grid: Grid,
    cameras: Mapping[str, CameraModel],
    readings: Mapping[str, Reading],
    delay_s: float,
    arena_m: tuple[float, float],
    others: Sequence[Projector | None],
    least_covered: float,
    inputs: Mapping[str, bytes],
) -> Found:
    """Return a projector from what cameras read of its grid.

    ``others``: the arena's other projectors, None for each that is not calibrated. ``least_covered``: share of the
    arena that all have to light.

    Raises:
        CalibrationError: It cannot be told, or not well enough.
    """
    _refuse_unseen(name, readings)
    geometries = {camera: CameraGeometry.from_model(model) for camera, model in cameras.items()}
    reading = {camera: own for camera, own in readings.items() if len(own.tags)}
    try:
        seen = [_seen(grid, own, geometries[camera], cameras[camera]) for camera, own in reading.items()]
        first = fit(seen, grid.size).projector
        seen = [
            _seen(grid, own, geometries[camera], cameras[camera], bends(grid, own.tags, geometries[camera], first))
            for camera, own in reading.items()
        ]
        found = _with_common(
            fit(seen, grid.size), max(_m_per_px(geometries[camera], own) for camera, own in reading.items())
        )
    except FitError as refused:
        raise CalibrationError(f"projector {name}: {refused}") from refused
    half = np.array(arena_m) / 2.0
    points, pixels = lattice(-half, half, 0.0), np.concatenate([own.pixels for own in seen])
    reached = _reached(found.projector, pixels[found.used], points, grid.pitch_px)
    sigma = np.where(reached, np.sqrt(np.trace(found.projector.spread(points), axis1=1, axis2=2)), np.nan)
    lit = reached.copy()
    for other in others:
        if other is not None:
            lit |= other.lights(points)
    blur_m = min(
        math.sqrt(max(own.blur_px**2 - _CAMERA_BLUR_PX**2, 0.0)) * _m_per_px(geometries[camera], own)
        for camera, own in reading.items()
    )
    figures = {
        "tags_used": float(found.used.sum()),
        "tags_left_out": float((~found.used).sum()),
        "residual_rms_mm": 1e3 * math.sqrt(float((found.error[found.used] ** 2).sum(axis=1).mean())),
        "residual_ratio": found.noise,
        "predicted_rms_mm": 1e3 * math.sqrt(float(np.nanmean(sigma**2))) if reached.any() else None,
        "predicted_max_mm": 1e3 * float(np.nanmax(sigma)) if reached.any() else None,
        "covered": float(lit.mean()),
        "edge_mm": 1e3 * blur_m,
        "delay_ms": 1e3 * delay_s,
        "white_over_room": max(own.over_room for own in reading.values()),
    }
    notes = _notes(cameras, readings, others, least_covered, float(lit.mean()))
    _refuse_poor(name, figures, others, least_covered, blur_m)
    where = provenance("projector", inputs, figures, VALUES, found.projector.covariance.tolist())
    optics = found.projector.model.model_copy(update={"delay_s": round(delay_s, 4)})
    model = ProjectorModel(**dict(optics), calibrated=where)
    return Found(model, found, np.concatenate([own.floor for own in seen]), points, sigma, float(lit.mean()), notes)


def verify(name: str, model: ProjectorModel, found: Found) -> str:
    """Return that a projector still lights the floor where its calibration says; CalibrationError where it does not.

    Compared are the places of a new calibration with those of the old one.
    """
    old = Projector.from_model(model)
    pixels = old.pixels(found.points)
    both = np.isfinite(pixels[:, 0]) & np.isfinite(found.sigma_m)
    off = found.fit.projector.floor(pixels[both]) - found.points[both, :2]
    most_mm = 1e3 * float(np.linalg.norm(off, axis=1).max()) if both.any() else math.inf
    expected_mm = 1e3 * float(np.nanmax(found.sigma_m)) * _MOVED
    if most_mm > max(expected_mm, _STILL_MM):
        raise CalibrationError(
            f"projector {name}: its light now falls {most_mm:.1f} mm from where its calibration says: run robofleet "
            "calibrate projector"
        )
    return f"projector {name}: its light falls where its calibration says, to {most_mm:.2f} mm"


_MOVED = 4.0  # standard deviations
_STILL_MM = 0.5  # that warm lamps and floors move


def _refuse_unseen(name: str, readings: Mapping[str, Reading]) -> None:
    """Refuse a projector whose light, or whose pattern, no camera reads; CalibrationError says why."""
    lit = [own for own in readings.values() if own.lit >= _LEAST_LIT]
    tags = sum(len(own.tags) for own in readings.values())
    seeing = ", ".join(readings)
    if not lit:
        raise CalibrationError(
            f"projector {name}: no camera ({seeing}) sees its light: switch it on, show the page on it, and let it "
            "light the floor"
        )
    if all(own.saturated > _SATURATED for own in lit):
        raise CalibrationError(
            f"projector {name}: its white is too bright for {seeing}: shorten camera.exposure_s, or dim the projector"
        )
    if tags < LEAST:
        raise CalibrationError(
            f"projector {name}: its light is seen, but {tags} tags of its pattern are read, {LEAST} are needed: focus "
            "it, switch its mirroring off, or dim the room"
        )


def _seen(grid: Grid, own: Reading, camera: CameraGeometry, model: CameraModel, off: Array | float = 0.0) -> Seen:
    pixels = own.pixels - off
    steps = _STEP_PX * np.eye(2)
    moved = [camera.to_plane(pixels + step, 0.0) - camera.to_plane(pixels - step, 0.0) for step in steps]
    J = np.stack(moved, axis=2) / (2.0 * _STEP_PX)
    covariance = own.sigma_px[:, None, None] ** 2 * (J @ J.transpose(0, 2, 1))
    by_camera = np.zeros((len(pixels), 2, 0))
    if model.arena is not None and model.arena.covariance:
        values, vectors = np.linalg.eigh(covariance_of("camera: arena", model.arena.covariance, len(PARAMETERS)))
        slopes = camera.moved(np.eye(4)).to_plane(pixels, 1.0)
        _, by_pose, _ = on_plane(camera.T_world_camera, slopes, np.zeros(len(pixels)))
        by_camera = by_pose @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return Seen(grid.centres[own.tags], camera.to_plane(pixels, 0.0), covariance, by_camera)


def _m_per_px(camera: CameraGeometry, own: Reading) -> float:
    """Return how far apart the floor's points are that two neighbouring pixels see, in the pattern's middle."""
    u, v = np.median(own.pixels, axis=0)
    return float(np.linalg.norm(np.diff(camera.to_plane(np.array([[u, v], [u + 1.0, v]]), 0.0), axis=0)))


def _with_common(found: Fit, m_per_px: float) -> Fit:
    """Return a fit that may be off by what no average betters, as a shift."""
    covariance = found.projector.covariance.copy()
    along = [VALUES.index("shift_x_m"), VALUES.index("shift_y_m")]
    covariance[along, along] += (_LAID_PX * m_per_px) ** 2
    return found._replace(projector=replace(found.projector, covariance=covariance))


def _reached(projector: Projector, pixels: Array, points: Array, around_px: float) -> NDArray[np.bool_]:
    """Return which points (N, 3) are lit by pixels that lie among those that were seen, or near them."""
    lit = projector.pixels(points)
    hull = cv2.convexHull(pixels.astype(np.float32))
    inside = [bool(np.isfinite(u)) and cv2.pointPolygonTest(hull, (u, v), True) >= -around_px for u, v in lit.tolist()]
    return np.array(inside)


def _notes(
    cameras: Mapping[str, CameraModel],
    readings: Mapping[str, Reading],
    others: Sequence[Projector | None],
    least_covered: float,
    covered: float,
) -> tuple[str, ...]:
    notes = [f"{camera}: sees nothing of the pattern" for camera, own in readings.items() if not len(own.tags)]
    notes += [
        f"{camera}: its file does not say how well its pose is known: that is not part of the predicted error"
        for camera, model in cameras.items()
        if len(readings[camera].tags) and (model.arena is None or not model.arena.covariance)
    ]
    if covered < least_covered and None in others:
        notes.append(f"{100 * covered:.0f} % of the arena is lit so far: calibrate the other projectors, too")
    return tuple(notes)


def _refuse_poor(
    name: str,
    figures: Mapping[str, float | None],
    others: Sequence[Projector | None],
    least_covered: float,
    blur_m: float,
) -> None:
    faults = []
    if blur_m > _BLUR_M:
        faults.append(
            f"projector {name}: out of focus: an edge is {1e3 * blur_m:.1f} mm wide on the floor (one standard "
            f"deviation), more than {1e3 * _BLUR_M:g}: focus it"
        )
    covered, most_mm = figures["covered"] or 0.0, figures["predicted_max_mm"]
    if covered < least_covered and None not in others:
        faults.append(
            f"projector {name}: {100 * covered:.0f} % of the arena is lit by a pattern that a camera sees, less than "
            f"{100 * least_covered:.0f}: hang it higher, turn it, add a camera, or lower --least-percent"
        )
    if most_mm is not None and most_mm > 1e3 * _USABLE_M:
        faults.append(
            f"projector {name}: its light would be {most_mm:.1f} mm off, more than {1e3 * _USABLE_M:g}: calibrate the "
            "cameras better (calibrate arena), or let them see more of the picture"
        )
    if faults:
        raise CalibrationError(faults)
