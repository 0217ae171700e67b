"""The laboratory run (IV-C) in simulation, and how errors travel along longer platoons.

The platoons run the whole stack in lockstep, with poses in the pixels' place: the tracker's noise goes through the
filter, the law and the robots.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours.paths import PathFile
from robofleet.behaviours.platoon import Platoon
from robofleet.config.files.names import SHIPPED
from robofleet.config.files.parameters import Parameters
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.settings import NonNegative, Positive
from robofleet.experiments.platoon_gain import INTEGRATORS, GainParameters, Integrator, robot_gains, settings_of
from robofleet.experiments.platoon_views import (
    Drive,
    gain_table,
    laboratory_figures,
    laboratory_table,
    travel_figure,
    travel_table,
)
from robofleet.experiments.results import Result
from robofleet.recording.run import Run
from robofleet.reports.canvas import RunView
from robofleet.runs.lockstep import Lockstep


class PlatoonParameters(Parameters):
    """``configs/paper/platoon.yaml``."""

    config: str
    sizes: Annotated[tuple[Annotated[int, Field(ge=2, le=64)], ...], Field(min_length=1, strict=False)]
    room: Annotated[float, Field(gt=1.0)]
    duration_s: Positive
    settle_s: NonNegative
    position_noise_m: NonNegative
    heading_noise_rad: NonNegative
    seed: Annotated[int, Field(ge=0)]
    gain: GainParameters


def run(parameters: PlatoonParameters) -> Result:
    """Drive all platoons, measure the gains, and put both into tables and figures."""
    base = load_config(SHIPPED / f"{parameters.config}.yaml", [f"run.seed={parameters.seed}"])
    drives = {(n, i): drive(parameters, base, n, i) for n in parameters.sizes for i in INTEGRATORS}
    gains = {integrator: robot_gains(parameters.gain, base, integrator) for integrator in INTEGRATORS}
    frequencies = np.array(parameters.gain.periods) / parameters.gain.period_s
    figures = laboratory_figures(drives, base)
    means = {key: found.mean_errors(parameters.settle_s) * 1e3 for key, found in drives.items()}
    return Result(
        (
            laboratory_table(drives, base, figures),
            travel_table(means, parameters.position_noise_m),
            gain_table(gains, frequencies),
        ),
        (*figures, travel_figure(means, gains, frequencies)),
        {
            "control_error_mm": {f"{integrator} {n}": mean.tolist() for (n, integrator), mean in means.items()},
            "gain": {i: {f"{f:g} Hz": g for f, g in zip(frequencies, gains[i], strict=True)} for i in INTEGRATORS},
        },
    )


def drive(parameters: PlatoonParameters, base: Config, robots: int, integrator: Integrator) -> Drive:
    config = scaled(parameters, base, robots, integrator)
    found = driven(config, f"the platoon of {robots}")
    (recorded,) = found.group_figures
    view = RunView(found, {"stops": []}) if robots == len(base.members) else None
    return Drive(found.t, recorded.figures["control_error"], found.points(), view)


def driven(config: Config, what: str) -> Run:
    """Return a run in lockstep, which must come to its end."""
    lockstep = Lockstep(config)
    outcome, cause = lockstep.run()
    if outcome != "completed":
        raise RuntimeError(f"{what} ended: {cause}")
    return Run(lockstep.recording)


def scaled(parameters: PlatoonParameters, base: Config, robots: int, integrator: Integrator) -> Config:
    """Return the configuration of a platoon: path and arena of a longer one are scaled, speed and law are the same.

    The paper's number of robots drive as long as their own configuration says: a lap.
    """
    own = settings_of(base)
    scale = max(1.0, parameters.room * robots * own.spacing_m / own.path.path().length())
    tree = base.model_dump(mode="json")
    (group,) = tree["groups"]
    for knot in group["settings"]["path"]["knots"]:
        knot["at_m"] = [scale * value for value in knot["at_m"]]
        knot["derivative_m"] = [scale * value for value in knot["derivative_m"]]
    ids = [f"r{k + 1}" for k in range(robots)]
    group["robots"] = ids
    group["settings"]["path_rate"] = own.path_rate / scale
    tree["arena"]["size_m"] = [scale * side for side in base.arena.size_m]
    template = tree["robots"][0]
    if robots != len(base.members):  # the configuration has a start for its own number of robots
        settings = Platoon.Settings.model_validate(group["settings"])
        starts = _starts(settings.path, own.spacing_m, base.controller.point_ahead_m, robots)
        tree["robots"] = [
            template | {"id": name, "tag": tag, "start": start}
            for tag, (name, start) in enumerate(zip(ids, starts, strict=True))
        ]
    tree["controller"]["integrator"] = integrator
    tree["tracker"] |= {"source": "truth"}
    tree["tracker"]["truth"] |= {
        "position_noise_m": parameters.position_noise_m,
        "heading_noise_rad": parameters.heading_noise_rad,
    }
    if robots != len(base.members):
        tree["run"]["duration_s"] = parameters.duration_s
    return Config.model_validate(tree)


def _starts(file: PathFile, spacing_m: float, point_ahead_m: float, robots: int) -> list[dict[str, float]]:
    """Start poses along the path, the points p at their spacing."""
    path = file.path()
    sigma = [0.0]
    for _ in range(robots - 1):
        sigma.append(float(path.back(np.array([sigma[-1]]), spacing_m)[0]))
    tangent = path.tangent(np.array(sigma))
    centre = path.position(np.array(sigma)) - point_ahead_m * tangent
    heading = np.degrees(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return [
        {"x_m": x, "y_m": y, "heading_deg": angle}
        for (x, y), angle in zip(centre.tolist(), heading.tolist(), strict=True)
    ]
