"""How far open-loop predictions are off on the shots that took no part in a fit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.robots.shooting import Noise, Shots, Wheels
from robofleet.core.arrays import Array

HORIZONS_S = 1.0, 2.0, 5.0


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """How far the tag was from where it was predicted to be, on the shots that took no part in the fit."""

    horizon_s: float
    position_rms_mm: float
    believed_rms_mm: float  # position, by what was believed before
    count: int


def held_out_errors(
    recordings: Sequence[Shots], chosen: Sequence[NDArray[np.bool_]], wheels: Wheels, before: Wheels, noise: Noise
) -> tuple[HeldOut, ...]:
    """Return the errors of each horizon over ``chosen`` poses of each recording, by two models."""
    every = []
    for horizon_s in HORIZONS_S:
        found, believed = (_errors(recordings, chosen, model, noise, horizon_s) for model in (wheels, before))
        rms_mm, believed_rms_mm = (
            1e3 * math.sqrt((off**2).mean()) if len(off) else math.nan for off in (found, believed)
        )
        every.append(
            HeldOut(horizon_s=horizon_s, position_rms_mm=rms_mm, believed_rms_mm=believed_rms_mm, count=len(found))
        )
    return tuple(every)


def _errors(
    recordings: Sequence[Shots], chosen: Sequence[NDArray[np.bool_]], wheels: Wheels, noise: Noise, horizon_s: float
) -> Array:
    """Return by how much predictions miss the tag's place (P,) [m]."""
    errors = [np.empty(0)]
    for shots, own in zip(recordings, chosen, strict=True):
        at_s, predicted, measured = shots.ahead(wheels, noise, horizon_s)
        inside = own[np.searchsorted(shots.at_s, at_s)]
        errors.append(np.linalg.norm((predicted - measured)[inside, :2], axis=1))
    return np.concatenate(errors)
