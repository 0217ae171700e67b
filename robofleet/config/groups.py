"""From the configuration's groups to their behaviours. These functions load the behaviours' modules."""

import math
import re
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from robofleet.behaviours import described
from robofleet.behaviours.interface import Behaviour, Flow, Pose, Team
from robofleet.config import barrier, slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config, Group
from robofleet.core.clock import S
from robofleet.core.patterns import NAME_PATTERN
from robofleet.core.plugins import PluginError, load
from robofleet.safety.starts import Reason
from robofleet.safety.supervisor import Phase

GROUP = "robofleet.behaviours"  # of entry points
_WAYS = {Phase.POSITIONING: "to-start", Phase.PARKING: "to-park"}


def named(config: Config) -> Config:
    """Return the configuration with a name for each group: its behaviour's, or ``group1`` and so on."""
    taken = [group.name for group in config.groups if group.name]
    names = [group.behaviour for group in config.groups]
    found = []
    for k, group in enumerate(config.groups):
        own = names.count(group.behaviour) == 1 and group.behaviour not in taken
        fits = re.fullmatch(NAME_PATTERN, group.behaviour) is not None
        found.append(group.name or (group.behaviour if own and fits else f"group{k + 1}"))
    every = tuple(group.model_copy(update={"name": name}) for group, name in zip(config.groups, found, strict=True))
    return config.model_copy(update={"groups": every})


def kind(group: Group) -> type[Behaviour]:
    """Return the class of a group's behaviour; PluginError where there is none."""
    return load_kind(group.behaviour)


def load_kind(name: str) -> type[Behaviour]:
    """Return a behaviour's class by its name, or as ``module:Class``; PluginError where there is none."""
    found: type[Behaviour] = load(GROUP, name)
    if not issubclass(found, Behaviour):
        raise PluginError(f"{name!r} is not a behaviour: derive it from robofleet.behaviours.Behaviour")
    if found.decide is Behaviour.decide:
        raise PluginError(f"{name!r} decides nothing: write its method `decide`")
    return found


def own(config: Config) -> Collection[str]:
    """Return the behaviours that a configuration names."""
    return {group.behaviour for group in config.groups}


def team(config: Config, group: Group) -> Team:
    """Return what a behaviour knows of its group."""
    robots, c = [config.robot(name) for name in group.robots], config.controller
    bodies = tuple(barrier.body(config, robot) for robot in robots)
    return Team(
        name=group.title,
        robots=group.robots,
        drives=tuple(body.drive for body in bodies),
        bodies=bodies,
        starts=tuple(None if config.run.begin == "go_to_start" else _start(robot) for robot in robots),
        bystanders=tuple((r.id, barrier.body(config, r), _start(r)) for r in config.bystanders),
        keepout=barrier.keepout(config),
        arena=config.arena.size_m,
        tick=c.tick_s,
        delay=slices.delay_ns(config, robots[0]) / S,
        point_ahead=c.point_ahead_m,
        flow=Flow(c.alpha, c.horizon_s, c.integrator),
        rng=slices.generator(config.run.seed, "behaviour", group.title),
    )


def behaviour(config: Config, group: Group) -> Behaviour:
    """Return what a group does; PluginError where its class cannot be loaded, ValueError where it cannot be made."""
    return made(group, team(config, group))


def made(group: Group, team: Team) -> Behaviour:
    """Return a group's behaviour for a team; errors as ``behaviour``."""
    behaviour = kind(group)
    return behaviour(behaviour.Settings.model_validate(group.settings), team)


def behaviours(config: Config) -> tuple[Behaviour, ...]:
    """Return what the groups do, in their order."""
    return tuple(behaviour(config, group) for group in config.groups)


def relocated(config: Config, folder: Path) -> Config:
    """Return the configuration with files of a folder where those that its groups name are gone."""
    found = [
        kind(group).Settings.model_validate(group.settings, context={"folder": folder}).model_dump(mode="json")
        for group in config.groups
    ]
    every = (group.model_copy(update={"settings": own}) for group, own in zip(config.groups, found, strict=True))
    return config.model_copy(update={"groups": tuple(every)})


def scripted(config: Config) -> tuple[str, ...]:
    """Return the names of the groups whose behaviours take a script's wishes."""
    return tuple(group.title for group in config.groups if kind(group).takes_wishes)


def taking_setpoints(config: Config, behaviour: type[Behaviour]) -> tuple[str, ...]:
    """Return the names of the groups of one kind of behaviour."""
    return tuple(group.title for group in config.groups if issubclass(kind(group), behaviour))


def descriptions(config: Config) -> tuple[described.Group, ...]:
    """Return the groups as others see them."""
    return tuple(
        described.described(behaviour, group.behaviour)
        for behaviour, group in zip(behaviours(config), config.groups, strict=True)
    )


def jam_of(config: Config) -> Callable[[Sequence[Pose]], Reason | None]:
    """Return what says of the members' poses which two robots of a group would not get past each other."""
    if config.run.begin == "go_to_start":
        return lambda _: None  # they find a way
    every, own = behaviours(config), rows(config.groups)

    def jam(poses: Sequence[Pose]) -> Reason | None:
        for behaviour, members in zip(every, own, strict=True):
            why = behaviour.start(poses[members]).jam
            if why is not None:
                order = None if why.order is None else tuple(members.start + row for row in why.order)
                return Reason(members.start + why.behind, members.start + why.other, order)
        return None

    return jam


def phases(config: Config) -> frozenset[Phase]:
    """Return the phases that a run can be in."""
    known = frozenset(Phase)
    if config.run.begin != "go_to_start":
        known -= {Phase.POSITIONING}
    return known if all(robot.park is not None for robot in config.members) else known - {Phase.PARKING}


def on_the_way(config: Config, phase: Phase) -> Behaviour:
    """Return what drives all members to their start, or to the park."""
    goals = starts_of(config) if phase is Phase.POSITIONING else parks_of(config)
    poses: JsonValue = {
        name: {"x_m": x, "y_m": y, "heading_deg": math.degrees(psi)} for name, (x, y, psi) in goals.items()
    }  # fmt: skip
    robots = tuple(robot.id for robot in config.members)
    return behaviour(config, Group(name=_WAYS[phase], behaviour="go_to", robots=robots, settings={"goals": poses}))


def starts_of(config: Config) -> dict[str, Pose]:
    """Return where each member is to stand when its behaviour begins, as far as that is known."""
    found: dict[str, Pose] = {}
    for group in config.groups:
        places = behaviour(config, group).places() or ()
        found |= dict(zip(group.robots, places, strict=False))
    for robot in config.members:
        if robot.id not in found and robot.start is not None:
            found[robot.id] = slices.start_pose(robot)
    return found


def parks_of(config: Config) -> dict[str, Pose]:
    """Return where each member is parked, as far as the configuration says so."""
    return {robot.id: (robot.park.x_m, robot.park.y_m, robot.park.psi) for robot in config.members if robot.park}


def rows(groups: Sequence[Group]) -> list[slice]:
    """Return which rows of the members' arrays are each group's."""
    ends = np.cumsum([0, *(len(group.robots) for group in groups)]).tolist()
    return [slice(first, last) for first, last in pairwise(ends)]


def _start(robot: Robot) -> tuple[float, float, float] | None:
    return None if robot.start is None else slices.start_pose(robot)
