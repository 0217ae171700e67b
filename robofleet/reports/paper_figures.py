"""The figures of the paper's laboratory run (IV-C), Figs. 14 to 18, of a run; each beside what the paper says of it."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from robofleet.behaviours.platoon import Platoon
from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, FAINT, INK
from robofleet.recording.gauge import Curve
from robofleet.reports.canvas import Legend, Plot, RunView, few, level, lines, sheet, strips
from robofleet.reports.group_plots import colours
from robofleet.reports.overview import draw_body, draw_floor, floor_inch, floor_shapes, trail
from robofleet.reports.paper import CONTROL_ERROR_MM, FASTEST_S, SETTLED_S, SPACING_M

_MEASURED = {"control_error", "reference_parameter", "path_error", "spacing"}
_STILLS = 4
_WINDOW_S = 11.0  # around a time of highest speed: half a side of the path
_CLOSE_MM, _EQUAL_MM, _TOGETHER_S = 10.0, 10.0, 2.0  # what counts as close to the path, as equal, as the same time
_CM_A_MM, _CM_A_M = 0.1, 100.0


class PaperFigure(NamedTuple):
    """One of the paper's figures: how a run draws it, what the paper says of it, and what the run says."""

    number: int
    name: str
    draw: Callable[[RunView], Figure]
    paper: str
    measured: Callable[[RunView], tuple[str, bool | None]]  # in words, and whether it agrees; None: not measured
    legend: Callable[[RunView], Legend]

    @property
    def title(self) -> str:
        return f"Fig. {self.number}: {self.name}"

    def run(self, view: RunView) -> str:
        """Return what a run says of it, and whether that agrees with the paper."""
        words, agrees = self.measured(view)
        return words + {True: " It agrees.", False: " It differs.", None: ""}[agrees]


def plots(view: RunView) -> Iterator[Plot]:
    """Yield the figures of a platoon's run as its report shows them; none where its behaviour did not measure it."""
    if not _MEASURED.issubset(curve.name for curve in view.run.parts[0].curves):
        return
    for figure in FIGURES:
        caption = f"The paper: {figure.paper} This run: {figure.run(view)}"
        yield Plot(figure.title, figure.draw, caption, figure.legend, long=figure.draw is not _stills)


def _curve(view: RunView, name: str) -> Curve:
    return next(curve for curve in view.run.parts[0].curves if curve.name == name)


def _still_ticks(view: RunView) -> list[int]:
    times_s = np.arange(_STILLS) * view.span[1] / _STILLS
    return [int(k) for k in np.searchsorted(view.run.clock_time_s, times_s).clip(0, len(view.run.t) - 1)]


def _stills(view: RunView) -> Figure:
    poses, references = view.run.poses(), view.run.references
    figure, every = sheet(floor_inch(view.config) * 1.08, 2, 2)
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.96, wspace=0.02, hspace=0.1)
    for axes, k in zip(every, _still_ticks(view), strict=True):
        draw_floor(axes, view.config, floor_shapes(view.run))
        axes.set_title(f"t = {view.run.clock_time_s[k]:.0f} s", loc="center")
        for row, (robot, colour) in enumerate(zip(view.config.members, view.colours, strict=True)):
            draw_body(axes, robot, poses[k, row], colour, named=False)
            axes.plot(*references[k, row], "o", ms=4, mfc="white", mec=colour, zorder=5)
    return figure


def _nearly_equal(view: RunView) -> tuple[str, bool | None]:
    spacing_mm = _curve(view, "spacing").values[_still_ticks(view)[1:]]
    if not np.isfinite(spacing_mm).all():
        return "the spacing was not measured.", None
    apart_mm = float(np.ptp(spacing_mm, axis=1).max())
    return f"from the second still on, distances differ by at most {apart_mm:.1f} mm.", apart_mm <= _EQUAL_MM


def _speed(view: RunView) -> Array:
    """Return how fast the leader's reference moves at each tick (K,) [m/s]; NaN where it had none."""
    settings, law = Platoon.Settings.model_validate(view.config.groups[0].settings), view.config.controller
    path, rate = settings.path.path(), settings.path_rate
    ahead = rate * (law.horizon_s + law.command_delay_s)  # what is recorded is where it is a horizon later
    sigma = _curve(view, "reference_parameter").values[:, 0] - ahead
    speed, known = np.full(len(sigma), np.nan), np.isfinite(sigma)
    speed[known] = rate * np.linalg.norm(path.derivative(sigma[known] % path.sides), axis=-1)
    return speed


def _fastest(view: RunView) -> list[tuple[float, float]]:
    """Return time [s] and speed [m/s] of the highest speed near each of the paper's times that the run reached."""
    t, speed = view.run.t, _speed(view)
    known = np.isfinite(speed)
    near = [np.flatnonzero(known & (abs(t - at_s) < _WINDOW_S)) for at_s in FASTEST_S if t[-1] > at_s]
    return [(float(t[k]), float(speed[k])) for k in (rows[speed[rows].argmax()] for rows in near if len(rows))]


def _reference_speed(view: RunView) -> Figure:
    figure, (axes,) = strips(view, ["|r′|, m/s"])
    lines(axes, view.run.clock_time_s, _speed(view)[:, None], view.span, COLOURS[:1])
    for t, speed in _fastest(view):
        at = float(np.interp(t, view.run.t, view.run.clock_time_s))
        axes.plot(at, speed, "o", ms=4, color=COLOURS[1])
        axes.annotate(f"{t:.1f} s", (at, speed), (0, -12), textcoords="offset points", ha="center", color=INK)
    axes.set_ylim(bottom=0.0)
    return figure


def _fastest_words(view: RunView) -> tuple[str, bool | None]:
    found = _fastest(view)
    if not found:
        return f"it ended before {FASTEST_S[0]:g} s.", None
    times = " and ".join(f"{t:.1f} s" for t, _ in found)
    agrees = all(abs(t - paper_s) <= _TOGETHER_S for (t, _), paper_s in zip(found, FASTEST_S, strict=False))
    return f"it is fastest at t = {times}, with {max(speed for _, speed in found):.3f} m/s.", agrees


def _trajectories(view: RunView) -> Figure:
    points = view.run.points()
    figure, (axes,) = sheet(0.8 * floor_inch(view.config))
    (path,) = (shape.points for shape in view.run.groups[0].shapes if shape.name == "path")
    axes.plot(*np.concatenate([path, path[:1]]).T, color=FAINT, lw=7.0)
    for row, colour in enumerate(view.colours):
        axes.plot(*trail(points[:, row]).T, color=colour, lw=3.0 - 0.7 * row)  # each shows beside the next one's
    for row, colour in enumerate(view.colours):
        axes.plot(*points[0, row], "o", ms=7, mfc=colour, mec="white")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    return figure


def _follow(view: RunView) -> tuple[str, bool | None]:
    error_mm = _curve(view, "path_error").values[view.run.counts_spacing]
    if not np.isfinite(error_mm).any():
        return "the path error was not measured.", None
    first_s, largest_mm = view.config.run.spacing_settle_s, float(np.nanmax(error_mm))
    return f"after {first_s:g} s they are at most {largest_mm:.1f} mm away from it.", largest_mm <= _CLOSE_MM


def _control_errors(view: RunView) -> Figure:
    figure, (axes,) = strips(view, ["‖ρ(t+T) − p̃(t+T)‖, mm"])
    values = _curve(view, "control_error").values
    lines(axes, view.run.clock_time_s, values, view.span, view.colours)
    axes.set_ylim(0.0, 1.1 * max(CONTROL_ERROR_MM, float(np.nanmax(values[view.run.after(SETTLED_S)], initial=0.0))))
    level(axes, CONTROL_ERROR_MM, "the paper's mean, on hardware")
    return figure


def _mean_error(view: RunView) -> tuple[str, bool | None]:
    values = _curve(view, "control_error").values[view.run.after(SETTLED_S)]
    if not np.isfinite(values).any():
        return f"it ended before {SETTLED_S} s.", None
    mean_mm = float(np.nanmean(values))
    hardware = "" if view.run.truth is None else " These robots are simulated."
    size = "as large" if abs(mean_mm / CONTROL_ERROR_MM - 1) < 0.3 else "smaller" if mean_mm < CONTROL_ERROR_MM else ""
    return f"{mean_mm:.2f} mm, {size or 'larger'}.{hardware}", None if size == "smaller" else bool(size)


def _spacings(view: RunView) -> Figure:
    figure, (axes,) = strips(view, ["‖p(i) − p(i−1)‖, cm"])
    curve = _curve(view, "spacing")
    cm, target_cm = curve.values * _CM_A_MM, SPACING_M * _CM_A_M
    lines(axes, view.run.clock_time_s, cm, view.span, colours(view, view.run.parts[0], curve))
    low, high = np.nanmin(cm, initial=target_cm - 1.0), np.nanmax(cm, initial=target_cm + 1.0)
    axes.set_ylim(low - 0.5, high + 0.5)
    level(axes, target_cm, "target")
    return figure


def _converge(view: RunView) -> tuple[str, bool | None]:
    mm, rows = _curve(view, "spacing").values, view.run.counts_spacing
    if not np.isfinite(mm[rows]).any(axis=0).all():
        return "the spacing was not measured.", None
    mean_cm = np.nanmean(mm[rows], axis=0) * _CM_A_MM
    off_cm = np.abs(mm[:, -1] * _CM_A_MM - SPACING_M * _CM_A_M)
    near = [int(np.argmin(abs(view.run.t - at_s))) for at_s in FASTEST_S if at_s <= view.run.t[-1]]
    means, last = (", ".join(f"{cm:.2f}" for cm in values) for values in (mean_cm, off_cm[near]))
    return (
        f"after {view.config.run.spacing_settle_s:g} s their means are {means} cm"
        + (f"; at these times the last one is {last} cm off." if near else "."),
        bool((abs(mean_cm - SPACING_M * _CM_A_M) <= _EQUAL_MM * _CM_A_MM).all()),
    )


def _robots(view: RunView) -> Legend:
    return few(list(zip(view.run.robots, view.colours, strict=True)))


def _pairs(view: RunView) -> Legend:
    curve = _curve(view, "spacing")
    return few(list(zip(curve.of, colours(view, view.run.parts[0], curve), strict=True)))


FIGURES = (
    PaperFigure(
        14, "stills", _stills,
        "four robots on the path, clockwise; from the second still on, their distances are nearly equal.",
        _nearly_equal, _robots,
    ),
    PaperFigure(
        15, "reference speed", _reference_speed,
        f"the reference's speed changes; it is highest at about t = {FASTEST_S[0]:g} s and {FASTEST_S[1]:g} s.",
        _fastest_words, lambda _: [],
    ),
    PaperFigure(
        16, "trajectories", _trajectories,
        "after a transient the points p follow the path closely; dots are where they began.",
        _follow, _robots,
    ),
    PaperFigure(
        17, "control errors", _control_errors,
        f"the mean of the four robots is about {CONTROL_ERROR_MM:g} mm after t = {SETTLED_S:g} s.",
        _mean_error, _robots,
    ),
    PaperFigure(
        18, "spacings", _spacings,
        f"the distances of successive points p go to {SPACING_M * _CM_A_M:g} cm; the last one departs from it at about "
        f"t = {FASTEST_S[0]:g} s and {FASTEST_S[1]:g} s, where speed is highest.",
        _converge, _pairs,
    ),
)  # fmt: skip
