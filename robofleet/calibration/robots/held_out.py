"""How far open-loop predictions are off on the shots that took no part in a fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.robots.shooting import Noise, Shots, Wheels, relative
from robofleet.core.arrays import Array

HORIZONS_S = 1.0, 2.0, 5.0


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """How far the tag was from where it was predicted to be, on the shots that took no part in the fit."""

    horizon_s: float
    position_rms_mm: float
    heading_rms_deg: float
    believed_rms_mm: float  # position, by what was believed before
    count: int


def held_out_errors(
    recordings: Sequence[Shots], chosen: Sequence[NDArray[np.bool_]], wheels: Wheels, before: Wheels, noise: Noise
) -> tuple[HeldOut, ...]:
    """Return the errors of each horizon over ``chosen`` poses of each recording, by two models."""
    every = []
    for horizon_s in HORIZONS_S:
        found, believed = (_errors(recordings, chosen, model, noise, horizon_s) for model in (wheels, before))
        rms = np.sqrt((found**2).mean(axis=0)) if len(found) else np.full(3, np.nan)
        believed_rms = np.sqrt((believed[:, :2] ** 2).sum(axis=1).mean()) if len(believed) else np.nan
        every.append(
            HeldOut(
                horizon_s=horizon_s, position_rms_mm=1e3 * float(np.hypot(*rms[:2])),
                heading_rms_deg=float(np.rad2deg(rms[2])), believed_rms_mm=1e3 * float(believed_rms), count=len(found),
            )
        )  # fmt: skip
    return tuple(every)


def _errors(
    recordings: Sequence[Shots], chosen: Sequence[NDArray[np.bool_]], wheels: Wheels, noise: Noise, horizon_s: float
) -> Array:
    """Return how far predictions are off (P, 3), in the tag's frame."""
    errors = [np.empty((0, 3))]
    for shots, own in zip(recordings, chosen, strict=True):
        at_s, predicted, measured = shots.ahead(wheels, noise, horizon_s)
        inside = own[np.searchsorted(shots.at_s, at_s)]
        errors.append(relative(measured[inside], predicted[inside]))
    return np.concatenate(errors)
