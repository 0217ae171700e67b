"""The shipped platoon with more robots: on a path and in an arena that hold them, all on the path from the start."""

import json

import numpy as np

from robofleet.behaviours.paths import PathFile
from robofleet.behaviours.platoon import Platoon
from robofleet.config.load import load_config
from tests.runs.realrun import PLATOON

_SPACING_M = 0.25
_SHARE = 0.9  # of the path, that a long platoon takes


def fleet_of(robots: int) -> list[str]:
    """Return what makes the platoon's configuration one of so many robots, on a path and in an arena that hold them."""
    if robots == 4:  # as it is shipped
        return ["tracker.source=truth"]
    shipped = Platoon.Settings.model_validate(load_config(PLATOON).groups[0].settings)
    scale = max(1.0, robots * _SPACING_M / (_SHARE * shipped.path.path().length()))
    knots = [
        {
            "at_m": [round(scale * x, 4) for x in knot.at_m],
            "derivative_m": [round(scale * d, 4) for d in knot.derivative_m],
        }
        for knot in shipped.path.knots
    ]
    path = PathFile.model_validate({"knots": knots}).path()
    fine = np.linspace(path.sides, 0.0, 200_000)
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.position(fine), axis=0), axis=1))])
    here = np.interp(_SPACING_M * np.arange(robots), walked, fine)
    places = np.hstack([path.position(here), np.degrees(np.arctan2(*path.tangent(here).T[::-1]))[:, None]]).round(4)
    fleet = [
        {
            "id": f"r{k}",
            "tag": k,
            "vehicle": "gternal",
            "start": dict(zip(("x_m", "y_m", "heading_deg"), pose, strict=True)),
        }
        for k, pose in enumerate(places.tolist(), 1)
    ]
    changes = {
        "arena.size_m": [round(3.2 * scale, 2), round(2.0 * scale, 2)],
        "robots": fleet,
        "groups.0.robots": [robot["id"] for robot in fleet],
        "groups.0.settings.path": {"knots": knots},
        "groups.0.settings.path_rate": round(shipped.path_rate / scale, 6),
        "drivers.robots_per_process": max(1, robots // 2),
        "tracker.source": "truth",
        "run.duration_s": 600,
    }
    return [f"{name}={json.dumps(value)}" for name, value in changes.items()]
