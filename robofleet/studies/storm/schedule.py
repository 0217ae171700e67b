"""From a seed to a storm: timed faults, several at once, and random requests of an operator."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydantic import TypeAdapter

from robofleet.config.robots import Robot
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault
from robofleet.studies.storm.parking import Parking

WINDOW_S = 10.0  # of faults, from the first moment of running; with the checks before and the new start after it, 20 s
_SHORTEST_S, _LONGEST_S = 0.05, 5.0
_LONGER_S = {"motor_stuck": 1.0}  # than others: what is named only after so long
_MOST_FAULTS = 6  # of one seed
_CALM_SHARE = 0.5  # of seeds with gentle faults only, inside the envelope
_TOPICS = ("cmd", "enable", "status", "poses", "state", "tick")
_FROZEN, _FROZEN_S = 0.3, (0.1, 2.0)  # share of seeds whose supervisor is frozen at an emergency stop, and how long
_REQUESTS = (b"hold", b"resume", b"estop", b"reset", b"stop", b"start", b"status", b"\xff nonsense")
_FAULTS: TypeAdapter[InjectedFault] = TypeAdapter(InjectedFault)

T = TypeVar("T")


class Act(NamedTuple):
    """What the operator asks for in the middle of it."""

    at_s: float  # since the fleet ran first
    request: bytes


_TOGETHER = 1, 2, None  # robots in a driver process, by the seed; None: all of them


class Plan(NamedTuple):
    """One seed's storm. Times count from the first moment of running [s]."""

    faults: tuple[InjectedFault, ...]
    acts: tuple[Act, ...]
    healed_s: float  # every fault and every random request has ended
    outside_s: float  # from here on bodies may touch; inf: never
    parked: tuple[Robot, ...] = ()  # bystanders


class _Dice:
    """A seed's draws."""

    def __init__(self, config: Config, rng: np.random.Generator) -> None:
        self.rng = rng
        self.robots = [robot.id for robot in config.robots]
        self.drivers = list(config.driven)

    def one(self, values: Sequence[T]) -> T:
        return values[int(self.rng.integers(len(values)))]

    def between(self, low: float, high: float) -> float:
        return round(float(self.rng.uniform(low, high)), 3)

    def likely(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def duration(self) -> float:
        return round(math.exp(self.rng.uniform(math.log(_SHORTEST_S), math.log(_LONGEST_S))), 3)


def _robot(dice: _Dice) -> dict[str, Any]:
    return {"robot": dice.one(dice.robots)}


def _route(dice: _Dice) -> dict[str, Any]:
    topics = dice.rng.permutation(_TOPICS)[: 1 + int(dice.rng.integers(3))].tolist()
    return {"topics": topics, "robot": dice.one([None, *dice.robots])}


def _message(dice: _Dice) -> dict[str, Any]:
    return {**_route(dice), "share": dice.one((0.01, 0.1, 0.5, 1.0))}


def _lost(dice: _Dice) -> dict[str, Any]:
    return {**_message(dice), "burst_s": dice.one((0.0, 0.06, 0.2))}


def _late(dice: _Dice) -> dict[str, Any]:
    return {**_route(dice), "median_s": dice.between(0.002, 0.03), "p99_s": dice.between(0.06, 0.3)}


def _few(dice: _Dice) -> dict[str, Any]:
    names = ["controller", "tracker", "supervisor", *dice.drivers]
    first, second = dice.one(names), dice.one(names)
    return {"processes": tuple(dict.fromkeys((first, second))), "held_back": dice.likely(0.5)}


def _lab(dice: _Dice) -> dict[str, Any]:
    return {"process": dice.one(("controller", "tracker", "supervisor"))}


def _runs(dice: _Dice) -> dict[str, Any]:
    speed = dice.one((-1.0, 1.0)) * dice.between(1.0, 8.0)
    return {**_robot(dice), "wheel": dice.one(("left", "right")), "speed_rad_s": speed}


# Each kind's own fields.
_GENTLE: dict[str, Callable[[_Dice], dict[str, Any]]] = {
    "motor_stuck": _robot,
    "low_battery": _robot,
    "wired_stop": _robot,
    "pose_dropout": _robot,
    "camera_frozen": lambda _: {},
    "camera_stalled": lambda _: {},
    "pose_delay": lambda dice: {"delay_s": dice.between(0.01, 0.08)},
    "pose_noise": lambda dice: {**_robot(dice), "sigma_m": dice.between(0.0005, 0.002), "sigma_rad": 0.005},
    "lost": _lost,
    "late": _late,
    **dict.fromkeys(("duplicated", "reordered", "not_a_number", "malformed"), _message),
    "network_cut": _few,
    "killed": _lab,
    "stopped": _lab,
    "disk_full": lambda _: {},
    "second_controller": lambda _: {},
}
_ROUGH: dict[str, Callable[[_Dice], dict[str, Any]]] = {
    "slip": _robot,
    "motor_runs": _runs,
    "id_swap": lambda dice: {"robots": tuple(dice.rng.permutation(dice.robots)[:2].tolist())},
    "duplicate_tag": _robot,
    "pose_noise": lambda dice: {**_robot(dice), "sigma_m": dice.between(0.005, 0.1), "sigma_rad": 0.1},
    "pose_delay": lambda dice: {"delay_s": dice.between(0.1, 0.25)},
    # A gate that does not run closes nothing: the robot's own firmware stops its wheels.
    "killed": lambda dice: {"process": dice.one(dice.drivers)},
    "stopped": lambda dice: {"process": dice.one(dice.drivers)},
    "clock_step": lambda dice: {
        "process": dice.one(["controller", "tracker", "supervisor", *dice.drivers]),
        "step_s": dice.one((-1.0, -0.05, 0.05, 1.0)),
    },
}
# Outside the envelope bodies may touch: whoever is told wrong poses by so much cannot keep them apart, nor can who has
# a wheel that does not stop.
_OUTSIDE = ("id_swap", "pose_noise", "pose_delay", "motor_runs")
KINDS = tuple(dict.fromkeys((*_GENTLE, *_ROUGH, "pushed")))


def shared(config: Config, seed: int) -> Config:
    """Return a seed's fleet: where the configuration does not say who shares a process, the seed does."""
    if config.drivers.robots_per_process is not None:
        return config
    together = _TOGETHER[seed % len(_TOGETHER)]
    return config.model_copy(update={"drivers": config.drivers.model_copy(update={"robots_per_process": together})})


def plan(config: Config, seed: int) -> Plan:
    """Return a seed's storm: the same one for the same seed and fleet."""
    dice = _Dice(shared(config, seed), generator(seed, "storm"))
    calm = dice.likely(_CALM_SHARE)
    pool = [(kind, make, False) for kind, make in _GENTLE.items()]
    pool += [] if calm else [(kind, make, True) for kind, make in _ROUGH.items()]
    faults, outside_s, healed_s = [], math.inf, 0.0
    for _ in range(1 + int(dice.rng.integers(_MOST_FAULTS))):
        kind, make, rough = dice.one(pool)
        at_s = dice.between(0.0, WINDOW_S - _SHORTEST_S)
        duration_s = round(min(dice.duration() + _LONGER_S.get(kind, 0.0), WINDOW_S - at_s), 3)
        faults.append(_FAULTS.validate_python({"kind": kind, "at_s": at_s, "duration_s": duration_s, **make(dice)}))
        outside_s = min(outside_s, at_s if rough and kind in _OUTSIDE else math.inf)
        healed_s = max(healed_s, at_s + duration_s)
    acts = [Act(dice.between(0.0, WINDOW_S), dice.one(_REQUESTS)) for _ in range(int(dice.rng.integers(3)))]
    if dice.likely(_FROZEN):
        duration_s = dice.between(*_FROZEN_S)
        at_s = dice.between(0.0, WINDOW_S - duration_s)
        frozen = {"kind": "stopped", "process": "supervisor", "at_s": at_s, "duration_s": duration_s}
        faults.append(_FAULTS.validate_python(frozen))
        acts.append(Act(round(at_s + dice.between(0.0, duration_s), 3), b"estop"))
        healed_s = max(healed_s, round(at_s + duration_s, 3))
    parked, befallen = Parking(config, generator(seed, "parking"), WINDOW_S).draw()
    faults += befallen
    ends = [fault.at_s + fault.duration_s for fault in befallen if fault.at_s is not None and fault.duration_s]
    healed_s = max([healed_s, *ends, *(act.at_s for act in acts)])
    return Plan(tuple(faults), tuple(sorted(acts)), healed_s, outside_s, parked)
