"""What is refused before a wheel turns: settings that are right one by one and cannot work together."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from robofleet.behaviours.interface import Bound, Refusal, Start
from robofleet.config import groups, obstacles, slices, units
from robofleet.config.faults import Complaint, plain_words
from robofleet.config.load import Change, ConfigFile, Files
from robofleet.config.robots import Robot, StartPose
from robofleet.config.tree import OWN_PLANT, Config
from robofleet.core.clock import S
from robofleet.core.plugins import PluginError, blamed, lacks, load
from robofleet.nodes import views
from robofleet.nodes.pose_sources import POSES
from robofleet.runs import check_behaviours, check_drivers, check_faults
from robofleet.runs.margins import margin_rows
from robofleet.safety.distances import least_room_m
from robofleet.safety.gate import VALID_NS
from robofleet.safety.supervisor import Phase
from robofleet.tracking.sources import AdjustableCamera, ScheduledCamera
from robofleet.vehicles.interface import SimulatedDriver
from robofleet.vehicles.solids import distances

_LONGEST_TICK_S = VALID_NS / S - 0.03  # status period, bus and lateness come off what the gate grants


class Study(NamedTuple):
    """What many configurations of one study share, so that each file is read once, and each robot opened once."""

    files: Files
    opened: dict[str, list[Complaint]]  # what was wrong when something was opened, by the settings it depends on

    def unreachable(self, config: Config, opens: Callable[[Config], list[Complaint]], *keys: str) -> list[Complaint]:
        """Return what is wrong with what ``opens`` opens; it is opened again only if one of the keys has changed."""
        settings = opens.__module__ + config.model_dump_json(include=set(keys))
        if settings not in self.opened:
            self.opened[settings] = opens(config)
        return self.opened[settings]


def load_checked(
    file: FilePath, overrides: Sequence[str | Change] = (), faults_file: FilePath | None = None, *,
    lockstep: bool = False, change: Callable[[Config], Config] | None = None, study: Study | None = None,
) -> Config:  # fmt: skip
    """Read a configuration that can work; ConfigError with every fault at its line and column.

    Where nothing else is wrong with the robots, each is opened once: what does not answer is a fault too. ``change``
    makes another one of it before it is judged: its groups do something else, for example. ``study``: of many like it.
    """
    shared = study or Study({}, {})
    source = ConfigFile(file, overrides, faults_file, shared.files)
    config = source.config if change is None else change(source.config)
    complaints = refusals(config, lockstep=lockstep)
    if not any(path.startswith("robots.") for path, _ in complaints):
        complaints += shared.unreachable(config, check_drivers.unreachable, "arena", "bus", "drivers", "robots")
    if not any(path.startswith(("robots.", "tracker.")) for path, _ in complaints):
        complaints += shared.unreachable(config, unreachable, "arena", "robots", "tracker", "camera", "cameras")
    source.refuse(complaints)
    return config


def refusals(config: Config, *, lockstep: bool = False) -> list[Complaint]:
    """Return what cannot work: (dotted path, what is wrong and how to mend it).

    Lockstep lets simulated time pass at any rate: it never moves a real robot, nor waits for a real camera.
    """
    faults = check_faults.complaints(config, lockstep=lockstep)
    complaints = [*check_drivers.complaints(config, lockstep=lockstep), *reality_complaints(config), *faults]
    complaints += [*_plant(config), *pose_complaints(config, lockstep=lockstep)]
    if config.tracker.source == "camera":
        for (path, _), view in zip(config.camera_keys, config.views, strict=True):
            complaints += _camera_source(view, path, lockstep)
        complaints += views.complaints(config)
    if impossible := list(check_behaviours.complaints(config)):
        return complaints + impossible
    for bound in _worst(bound for bound in _bounds(config) if not bound.holds):
        key = bound.path.rpartition(".")[2]
        itself = bound.what.startswith(key) and not bound.at_least  # not something that it brings about
        hint = units.meant(bound.value, bound.limit, key) if itself else ""
        complaints.append((bound.path, _broken(bound, hint)))
    complaints += _ways(config)
    if not any(path.startswith(("robots.", "groups.")) for path, _ in complaints):
        complaints += [
            (_absolute(config, where, refusal.key), refusal.message)
            for where, behaviour in enumerate(groups.behaviours(config))
            for refusal in behaviour.refusals()
        ]
    return complaints


def _plant(config: Config) -> Iterator[Complaint]:
    """Refuse a plant that is not there, its settings, and what it refuses itself."""
    name = config.plant.model
    if name == OWN_PLANT:
        if config.plant.settings:
            yield "plant.settings", f"{name!r} takes none: remove them, or name another plant.model"
        return
    try:
        kind = load(slices.PLANTS, name)
        settings = slices.plant_settings(config)
    except PluginError as error:
        yield "plant.model", str(error)
    except ValidationError as invalid:
        for wrong in invalid.errors(include_url=False):
            yield ".".join(["plant.settings", *map(str, wrong["loc"])]), plain_words(wrong, kind.Settings)
    else:
        if missing := lacks(kind, "step", "state"):
            yield "plant.model", f"{name!r} has {missing}: write what robofleet/simulation/PLANTS.md describes"
        try:
            refused = (
                kind.refusals(settings, [robot.id for robot in config.robots]) if hasattr(kind, "refusals") else ()
            )
            yield from [(f"plant.{path}", words) for path, words in refused]
        except Exception as error:  # noqa: BLE001 - a class of the user's raises anything
            yield "plant.model", f"the refusals of {name!r} {blamed(error)}"


def proofs(config: Config) -> list[tuple[str, str, str, str]]:
    """Return what was proved: (what, the tightest value, its limit, how much of it is used)."""
    tightest: dict[str, Bound] = {}
    for bound in _bounds(config):
        if bound.what not in tightest or bound.tightness > tightest[bound.what].tightness:
            tightest[bound.what] = bound
    return [
        (
            b.what,
            _shown(b.value, b.unit),
            ("≥ " if b.at_least else "< " if b.strict else "≤ ") + _shown(b.limit, b.unit),
            f"{b.tightness:.0%}",
        )
        for b in tightest.values()
    ] + [*start_rows(config), *margin_rows(config)]


def _worst(broken: Iterable[Bound]) -> list[Bound]:
    """Return one bound of those on one number that mending it mends all: the tightest of each direction."""
    kept: dict[object, Bound] = {}
    for bound in broken:
        by_itself = bound.path.endswith(("path_rate", "spacing_m"))
        key = (bound.path, bound.at_least) if by_itself else (bound.path, bound.what, bound.mend)
        if key not in kept or bound.tightness > kept[key].tightness:
            kept[key] = bound
    return list(kept.values())


def _bounds(config: Config) -> Iterator[Bound]:
    yield from _controller(config)
    for where, behaviour in enumerate(groups.behaviours(config)):
        for bound in behaviour.bounds():
            what = f"{behaviour.team.name}: {bound.what}" if len(config.groups) > 1 else bound.what
            yield replace(bound, path=_absolute(config, where, bound.path), what=what)
    yield from _start(config)
    if config.tracker.source == "camera":
        for (path, _), view in zip(config.camera_keys, config.views, strict=True):
            yield from _camera(view, path)


def _ways(config: Config) -> Iterator[Complaint]:
    """Refuse a start or a park to which the robots cannot go by themselves."""
    ways = (
        (config.run.begin == "go_to_start", Phase.POSITIONING, "start", groups.starts_of(config)),
        (config.run.end == "park", Phase.PARKING, "park", groups.parks_of(config)),
    )
    rows = {robot.id: row for row, robot in enumerate(config.robots)}
    for wanted, phase, key, known in ways:
        if not wanted:
            continue
        missing = [robot.id for robot in config.members if robot.id not in known]
        for name in missing:
            option = "run.begin: go_to_start" if phase is Phase.POSITIONING else "run.end: park"
            mend = f"add `{key}: {{x_m: ..., y_m: ..., heading_deg: ...}}`"
            yield f"robots.{rows[name]}.{key}", f"is missing: {option} must know where {name} is to go: {mend}"
        if missing:
            continue
        way = groups.on_the_way(config, phase)
        for refusal in (*way.refusals(), *_refused(way.bounds())):
            name = refusal.key.removeprefix("settings.goals.")
            if name in rows:
                yield f"robots.{rows[name]}.{key}", refusal.message
            else:
                yield f"run.{'begin' if phase is Phase.POSITIONING else 'end'}", f"{key}: {refusal.message}"


def _refused(bounds: Iterable[Bound]) -> Iterator[Refusal]:
    for bound in bounds:
        if not bound.holds:
            yield Refusal(bound.path, _broken(bound))


def _broken(bound: Bound, hint: str = "") -> str:
    relation = "at least" if bound.at_least else "less than" if bound.strict else "at most"
    value, limit = _shown(bound.value, bound.unit), _shown(bound.limit, bound.unit)
    return f"{bound.what} is {value}{hint}, must be {relation} {limit}: {bound.mend}"


def _absolute(config: Config, group: int, key: str) -> str:
    """Return where in the configuration a behaviour's key is."""
    first, _, rest = key.partition(".")
    ids = [robot.id for robot in config.robots]
    if first in ids:
        return f"robots.{ids.index(first)}.{rest}".rstrip(".")
    return f"groups.{group}.{key}" if first in ("settings", "robots", "behaviour", "") else key


def _controller(config: Config) -> Iterator[Bound]:
    controller = config.controller
    if controller.integrator == "euler":
        mend = f"lower alpha below {2 / controller.tick_s:.3g}, or take the exact integrator"
        gain = controller.alpha * controller.tick_s
        yield Bound("controller.alpha", "Euler's gain, alpha * tick_s,", gain, 2.0, "", mend, strict=True)
    mend = f"lower it below {1 / controller.tick_s:.3g}, or a distance is used up within a tick"
    used = controller.barrier.rate_per_s * controller.tick_s
    yield Bound("controller.barrier.rate_per_s", "rate_per_s * tick_s", used, 1.0, "", mend, strict=True)
    mend = "a command is valid for 120 ms and at each tick up to 30 ms old, so the gates would close between two ticks"
    yield Bound("controller.tick_s", "tick_s", controller.tick_s, _LONGEST_TICK_S, "s", mend)


def _start(config: Config) -> Iterator[Bound]:
    """Every robot stands inside, clear of the others, with room for its wheels to be tried."""
    placed = [(i, robot, robot.start) for i, robot in enumerate(config.robots) if robot.start is not None]
    driven = {robot.id for robot in config.members}
    for i, robot, start in placed:
        for axis, (name, at) in enumerate((("x", start.x_m), ("y", start.y_m))):
            what = f"a start pose's reach in {name} with the body's radius"
            room = least_room_m(slices.drive(robot).wheel_radius) if robot.id in driven else 0.0
            reach, half = abs(at) + robot.vehicle.body_radius_m, config.arena.size_m[axis] / 2 - room
            yield Bound(f"robots.{i}.start", what, reach, half, "m", f"move {robot.id} into the arena")
    yield from _beside_solids(config, placed)
    for (i, first, here), (j, other, second_pose) in itertools.combinations(placed, 2):
        apart = math.hypot(here.x_m - second_pose.x_m, here.y_m - second_pose.y_m)
        bodies = first.vehicle.body_radius_m + other.vehicle.body_radius_m
        tried = [robot for robot in (first, other) if robot.id in driven]
        room = bodies + max((least_room_m(slices.drive(robot).wheel_radius) for robot in tried), default=0.0)
        if len(tried) == 1:
            k, moves = (i, other) if first.id not in driven else (j, first)
            what = "the distance of a robot that is not in the group from one that is, at the start"
            mend = f"{moves.id}'s wheels are tried before a start, so move {config.robots[k].id} away from it"
            yield Bound(f"robots.{k}.start", what, apart, room, "m", mend, at_least=True)
        else:
            what, mend = "the distance between two robots at the start", f"move {first.id} and {other.id} apart"
            yield Bound(f"robots.{j}.start", what, apart, room, "m", mend, at_least=True)


def _beside_solids(config: Config, placed: Sequence[tuple[int, Robot, StartPose]]) -> Iterator[Bound]:
    """Every robot starts on the floor and beside the obstacles, with room for its wheels to be tried."""
    solids, driven = obstacles.every(config.arena), {robot.id for robot in config.members}
    away = distances(solids, np.array([(start.x_m, start.y_m) for _, _, start in placed]).reshape(-1, 2))
    for solid, row in zip(solids, away.tolist(), strict=True):
        for (i, robot, _), left in zip(placed, row, strict=True):
            room = least_room_m(slices.drive(robot).wheel_radius) if robot.id in driven else 0.0
            what = f"a start's distance from {'the edge of floor_m' if solid.floor else 'an obstacle'}"
            near = "its wheels are tried there" if robot.id in driven else "its body stands there"
            mend = f"{near}, so move {robot.id}" + ("" if solid.floor else f" or {solid.name}")
            least = robot.vehicle.body_radius_m + room
            yield Bound(f"robots.{i}.start", what, left, least, "m", mend, at_least=True)


def _camera(view: Config, path: str) -> Iterator[Bound]:
    camera = view.camera
    period = view.controller.tick_s if camera.trigger == "tick" else 1 / camera.rate_hz
    taken = camera.exposure_s + camera.readout_s
    mend = "the next frame begins before, so shorten the exposure"
    yield Bound(f"{path}.exposure_s", "exposure and readout of a frame", taken, period, "s", mend)
    if camera.adjusts_exposure:
        from robofleet.tracking.cameras.exposure import longest_exposure  # noqa: PLC0415 - loads OpenCV

        longest = longest_exposure(view)
        what, mend = f"the first exposure, with {longest.why}", "shorten it, or set camera.exposure_control to fixed"
        yield Bound(f"{path}.exposure_s", what, camera.exposure_s, longest.time_s, "s", mend)
    if camera.trigger == "tick":
        needed = camera.exposure_s / 2 + camera.readout_s
        what, mend = "the time from mid-exposure to the tick", "half the exposure and the readout go first"
        lead = camera.trigger_lead_s
        yield Bound(f"{path}.trigger_lead_s", what, lead, needed, "s", mend, at_least=True)


def _camera_source(view: Config, path: str, lockstep: bool) -> Iterator[Complaint]:
    source = view.camera.source
    try:
        found = load("robofleet.cameras", source)
    except PluginError as error:
        yield f"{path}.source", str(error)
    else:
        if lockstep and not issubclass(found, ScheduledCamera):
            yield f"{path}.source", f"{source!r} keeps real time, and lockstep does not: run without --lockstep"
        if view.camera.adjusts_exposure and not issubclass(found, AdjustableCamera):
            yield f"{path}.exposure_control", f"the exposure of {source!r} cannot be adjusted: set it to fixed"
        for where, message in getattr(found, "refusals", _none)(view):
            yield where.replace("camera", path, 1) if where.startswith("camera.") else where, message


def _none(_config: Config) -> tuple[Complaint, ...]:
    return ()


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()


def pose_complaints(config: Config, *, lockstep: bool = False) -> Iterator[Complaint]:
    """Yield why the source of poses cannot work. Nothing is opened."""
    source = config.tracker.source
    try:
        found = load(POSES, source)
    except PluginError as error:
        yield "tracker.source", str(error)
        return
    in_lockstep = getattr(found, "works_in_lockstep", None)
    if lockstep and source != "camera" and not (in_lockstep is not None and in_lockstep(config)):
        yield "tracker.source", f"{source!r} keeps real time, and lockstep does not: run without --lockstep"
    yield from getattr(found, "refusals", _none)(config)


def unreachable(config: Config) -> list[Complaint]:
    """Ask the source of poses who is there; returns who does not answer."""
    return list(getattr(load(POSES, config.tracker.source), "unreachable", _none)(config))


def reality_complaints(config: Config) -> Iterator[Complaint]:
    """Yield the robots whose poses could never come."""
    source, cameras = config.tracker.source, [camera.source for _, camera in config.camera_keys]
    real = [camera for _, camera in config.camera_keys if not camera.rendered]
    capture = config.tracker.mocap.system if source == "mocap" else ""
    if source == "camera" and not config.seen:
        yield "tracker.source", "there is no robot that the camera could see, all are simulated: take truth"
    for i, robot in enumerate(config.robots):
        try:
            mend = f"give {robot.id} a driver" if robot.twin is None else f"remove {robot.id}'s twin"
            tells, looks = _tells(robot), source == "camera" and any(map(_looks, cameras))
        except PluginError:
            continue  # said already
        if tells and looks and robot.reality == "real":
            yield f"robots.{i}.reality", f"{cameras[0]!r} cannot see {robot.id}, which is simulated: write simulated"
        elif not tells and robot.reality == "simulated":
            yield f"robots.{i}.reality", f"nobody knows where {robot.id} is, {robot.driver!r} cannot tell: write real"
        elif not tells and source == "truth":
            yield f"robots.{i}.driver", f"{robot.driver!r} cannot tell where {robot.id} is: take tracker.source camera"
        elif not tells and capture == "simulated":
            message = f"a simulated motion capture cannot measure {robot.id}: name tracker.mocap.system"
            yield f"robots.{i}.driver", message
        elif tells and capture not in ("", "mock", "simulated") and robot.reality == "real":
            yield f"robots.{i}.driver", f"{capture!r} cannot measure a simulated robot: {mend}"
        elif not tells and source == "camera" and not real:
            yield f"robots.{i}.driver", f"a simulated camera cannot see {robot.id}: take a real one, or give it a twin"


def _tells(robot: Robot) -> bool:
    """Return whether a robot says where it truly is: there is none, or its twin."""
    return robot.twin is not None or issubclass(load("robofleet.drivers", robot.driver), SimulatedDriver)


def _looks(camera: str) -> bool:
    """Return whether a camera's images are of what exists now."""
    return not issubclass(load("robofleet.cameras", camera), ScheduledCamera)


def start_rows(config: Config) -> list[tuple[str, str, str, str]]:
    """Return what a table of proofs says of the starts: (what, value, limit, how much of it is used)."""
    settle_s = config.run.spacing_settle_s
    found: list[tuple[str, str, str, str]] = []
    for start in _judged_starts(config):
        found += start.rows
        if start.arrived_s:
            late_s = max(start.arrived_s)
            takes = f"{late_s:.1f} s" if math.isfinite(late_s) else "over 25 s"
            note = "ok" if late_s <= settle_s else "slow"
            found.append(("the time until every robot is in its place", takes, f"{settle_s:g} s", note))
    return found


def start_warnings(config: Config) -> Iterator[str]:
    """Yield what works and may take long, a line each."""
    settle_s = config.run.spacing_settle_s
    for start in _judged_starts(config):
        for late_s, warning in () if start.jam else start.warnings:
            if late_s > settle_s:
                yield f"{warning}; figures count after {settle_s:g} s (run.spacing_settle_s)"


def _judged_starts(config: Config) -> Iterator[Start]:
    """Yield what each behaviour says of its robots' starts, where all of them have one."""
    for behaviour in groups.behaviours(config):
        poses = [pose for pose in behaviour.team.starts if pose is not None]
        if len(poses) == len(behaviour.team):
            yield behaviour.start(poses)
