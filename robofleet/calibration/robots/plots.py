"""Plots of an identified robot: observed and predicted, and what is left."""

import math

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.shooting import Shots, relative
from robofleet.core.figures import COLOURS, QUIET, STYLE

_SHOWN_S = 6.0
_SHOWN_RESIDUALS = 400  # of each channel
_LAGS = 20


def motion_figure(found: Identification, shots: Shots) -> Figure:
    """Draw the observed and the predicted speed and turning of some busy seconds."""
    h = np.diff(shots.at_s)
    seen = relative(shots.poses[:-1], shots.poses[1:]) / h[:, None]
    model = shots.motion(found.wheels).steps / h[:, None]
    c, s = math.cos(found.wheels.tag_heading_rad), math.sin(found.wheels.tag_heading_rad)
    # the tag's way is that of the centre, and of its arm while the robot turns
    along = c * seen[:, 0] - s * seen[:, 1] + seen[:, 2] * found.wheels.tag_left_m
    busiest = int(np.convolve(np.abs(np.diff(model[:, 0], append=0.0)), np.ones(60), "same").argmax())
    shown = np.abs(shots.at_s[1:] - shots.at_s[1:][busiest]) < _SHOWN_S / 2.0
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots(2, 1, sharex=True)
        for axis, observed, predicted, label in (
            (axes[0], 1e3 * along, 1e3 * model[:, 0], "speed [mm/s]"),
            (axes[1], seen[:, 2], model[:, 2], "turning [rad/s]"),
        ):
            axis.plot(shots.at_s[1:][shown], observed[shown], ".", ms=3, color=COLOURS[1], label="observed")
            axis.plot(shots.at_s[1:][shown], predicted[shown], color=COLOURS[0], lw=1.0, label="predicted")
            axis.set(ylabel=label)
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
        axes[1].set(xlabel="time [s]")
    return figure


def residual_figure(found: Identification, shots: Shots) -> Figure:
    """Draw the first recording's residuals and their autocorrelation."""
    e, names = found.residuals[0], ("x", "y", "heading")
    known = e.any(axis=1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 2.8), layout="constrained")
        time, correlation = figure.subplots(1, 2, width_ratios=(2, 1))
        for k, name in enumerate(names):
            white = e[known, k]
            every = max(1, len(white) // _SHOWN_RESIDUALS)
            time.plot(shots.at_s[known][::every], white[::every], ".", ms=2, color=COLOURS[k], label=name)
            own = [
                float((white[lag:] * white[: len(white) - lag]).mean() / (white**2).mean()) for lag in range(1, _LAGS)
            ]
            correlation.plot(range(1, _LAGS), own, ".-", lw=0.6, ms=4, color=COLOURS[k])
        time.axhspan(-2.0, 2.0, color=QUIET, alpha=0.15, lw=0)
        time.set(xlabel="time [s]", ylabel="residual [standard deviations]", ylim=(-8, 8))
        time.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        bound = 2.0 / math.sqrt(max(1, int(known.sum())))
        correlation.axhspan(-bound, bound, color=QUIET, alpha=0.2, lw=0)
        correlation.set(xlabel="images later", ylabel="correlation", ylim=(-0.5, 0.5))
    return figure
