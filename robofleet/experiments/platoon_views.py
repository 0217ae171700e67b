"""Tables and figures of the platoon experiment; of the laboratory run, those of its report."""

from dataclasses import dataclass

import numpy as np

from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.experiments.platoon_gain import INTEGRATORS, Integrator, settings_of
from robofleet.experiments.results import Cell, Curve, Figure, Panel, RunFigure, Table
from robofleet.reports import paper_figures
from robofleet.reports.canvas import RunView
from robofleet.reports.paper import CONTROL_ERROR_MM

Key = tuple[int, Integrator]  # robots, integrator


@dataclass(frozen=True)
class Drive:
    """One platoon's run: ticks (K,), robots (N,)."""

    t: Array  # [s]
    control_error: Array  # (K, N) [m]
    points: Array  # true p (K, N, 2) [m]
    view: RunView | None  # of the paper's number of robots

    def mean_errors(self, settle_s: float) -> Array:
        """Mean control error of each robot (N,) [m]."""
        return np.asarray(self.control_error[self.t >= settle_s].mean(axis=0))

    def spacing(self) -> Array:
        """Distances between successive points (K, N - 1) [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=1), axis=-1))


def laboratory_figures(drives: dict[Key, "Drive"], base: Config) -> tuple[RunFigure, ...]:
    """The paper's Figs. 14 to 18."""
    found = drives.get((len(base.members), "exact"))
    view = None if found is None else found.view
    return () if view is None else tuple(RunFigure(plot, view) for plot in paper_figures.plots(view))


def laboratory_table(drives: dict[Key, "Drive"], base: Config, figures: tuple[RunFigure, ...]) -> Table:
    """Row 8: the paper's four robots, beside the paper; and what its figures say."""
    captions = (f"{figure.plot.title}. {figure.plot.caption}" for figure in figures)
    rows: list[tuple[Cell, ...]] = [("the paper (hardware)", CONTROL_ERROR_MM, None, None)]
    n = len(base.members)
    for integrator in INTEGRATORS:
        if (n, integrator) not in drives:
            continue
        found = drives[n, integrator]
        settled = found.t >= base.run.spacing_settle_s
        deviation = np.abs(found.spacing()[settled] - settings_of(base).spacing_m).max()
        errors = found.mean_errors(base.run.settle_s) * 1e3
        rows.append((f"simulation, {integrator}", float(errors.mean()), float(errors.max()), float(deviation) * 1e3))
    return Table(
        "Laboratory run: four robots",
        ("", "error mm", "worst mm", "spacing off mm"),
        tuple(rows),
        ("The paper's robots are hardware, these are simulated.", *captions),
        ("", ".2f", ".2f", ".2f"),
    )


def travel_table(means: dict[Key, Array], position_noise_m: float) -> Table:
    """How the mean control error grows along longer platoons."""
    rows: list[tuple[Cell, ...]] = []
    for (n, integrator), mean in means.items():
        first, middle, last = float(mean[0]), float(mean[n // 2 - 1]), float(mean[-1])
        rows.append((str(n), integrator, first, middle, last, last / first, last / middle))
    return Table(
        f"Mean control error along the platoon, pose noise {position_noise_m * 1e3:g} mm",
        ("robots", "integrator", "first mm", "middle mm", "last mm", "to first", "to middle"),
        tuple(rows),
        ("The last one's error over the first's, and over the middle one's (of 32: robot 16).",),
        ("", "", ".2f", ".2f", ".2f", ".2f", ".2f"),
    )


def gain_table(gains: dict[Integrator, list[float | None]], frequencies: Array) -> Table:
    """The largest gain from any robot to the next."""
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (f"{frequency:.3g}", *(gains[integrator][k] for integrator in INTEGRATORS))
        for k, frequency in enumerate(frequencies)
    )
    return Table(
        "Largest gain from a robot to the next, over frequency",
        ("frequency Hz", *INTEGRATORS),
        rows,
        (
            "A platoon whose gain stays at 1 does not amplify what its leader does.",
            "With euler even rounding grows from robot to robot until references that may not retreat cut it off.",
        ),
        ("", ".4f", ".4f"),
    )


def travel_figure(means: dict[Key, Array], gains: dict[Integrator, list[float | None]], frequencies: Array) -> Figure:
    """Errors along the longest platoon, and the gain from robot to robot."""
    longest = max(n for n, _ in means)
    robots = np.arange(1.0, longest + 1.0)
    errors = tuple(Curve(integrator, robots, means[longest, integrator]) for integrator in INTEGRATORS)
    gain = tuple(
        Curve(integrator, frequencies, np.array(gains[integrator], dtype=np.float64), "dots")
        for integrator in INTEGRATORS
    )
    return Figure(
        "along-the-platoon",
        "How errors travel along the platoon",
        (
            Panel("robot", "mean control error [mm]", errors, scales=("linear", "log")),
            Panel("frequency [Hz]", "largest gain to the next robot", gain, scales=("log", "linear")),
        ),
    )
