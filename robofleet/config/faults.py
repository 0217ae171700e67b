"""What can be wrong with a configuration, in plain words: single keys, and keys that contradict others."""

import difflib
import ipaddress
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from robofleet.config import bodies, cameras, obstacles, projectors, units
from robofleet.config.camera import SimulatedCameraSettings
from robofleet.config.robots import UNTAGGED
from robofleet.config.tree import Config
from robofleet.config.troubles import ClockStep, IdSwap, Late
from robofleet.core.patterns import (
    ENDPOINT_PATTERN,
    LONGEST_SOCKET_PATH,
    NAME_PATTERN,
    NETWORK_PATTERN,
    PRIVATE,
    SOCKET,
    TCP,
)

Complaint = tuple[str, str]  # dotted path, message

_NEAR = 0.8  # of names
_MOST_HINTS = 3
_LONGEST = 200  # of a value that is shown
_WORDS = {
    "missing": "is missing",
    "model_type": "must be a mapping",
    "dict_type": "must be a mapping",
    "tuple_type": "must be a list",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "string_too_short": "must not be empty",
    "string_too_long": "may have {max_length} characters at most",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than_equal": "must be at most {le:g}",
    "too_short": "needs {min_length} or more, has {actual_length}",
    "too_long": "may have {max_length} at most, has {actual_length}",
    "literal_error": "must be {expected}",
    "value_error": "{error}",  # of a validator of a behaviour's own
}
_PATTERNS = {
    NAME_PATTERN: "must be a small letter, then up to 31 small letters, digits, - or _",
    NETWORK_PATTERN: "must look like tls/192.168.1.5:7447",
    ENDPOINT_PATTERN: "must be private, or look like unixsock-stream//run/lab/bus.sock or tcp/127.0.0.1:7447",
}


def plain_words(error: ErrorDetails, root: type[BaseModel] = Config) -> str:
    """Return what is wrong and how to mend it, from one of pydantic's errors on a tree of kind ``root``."""
    kind, given, loc, context = error["type"], error["input"], error["loc"], error.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key: {did_you_mean(str(loc[-1]), _known_keys(loc[:-1], root))}"
    if kind == "union_tag_not_found":
        return "is missing: add it; configs/README.md describes it"
    if kind == "union_tag_invalid":
        kinds = context["expected_tags"].replace("'", "").split(", ")
        return f"there is no kind '{context['tag']}': {did_you_mean(context['tag'], kinds)}"
    if kind == "missing" or (given is None and loc):
        few = isinstance(loc[-1], int) and given is not None
        return "has too few values: add one" if few else "is missing: add it; configs/README.md describes it"
    words = _WORDS.get(kind)  # pydantic's own have braces that are none of ours, of patterns
    rule = _PATTERNS.get(context.get("pattern", "")) or (words.format(**context) if words else error["msg"])
    if kind == "value_error" or isinstance(given, dict | list | tuple):
        return rule
    hint = ""
    if kind in ("float_type", "int_type") and isinstance(given, str):
        hint = units.number_in(given, _key(loc))
    elif kind == "string_type":
        hint = ": quote it"
    elif kind in ("less_than", "less_than_equal") and isinstance(given, int | float):
        hint = units.meant(given, context.get("le", context.get("lt")), _key(loc))
    shown = repr(given)
    return f"{rule}, not {shown if len(shown) <= _LONGEST else shown[:_LONGEST] + '...'}{hint}"


def place_of(error: ErrorDetails) -> tuple[str | int, ...]:
    """Return the keys that lead to one of pydantic's errors: it also counts a fault's kind among them."""
    loc = error["loc"]
    if error["type"].startswith("union_tag"):
        return (*loc, "kind")
    if loc[:1] == ("groups",) and loc[2:3] == ("settings",):
        return (*loc[:3], *loc[3::2])  # of plain JSON: the kind of every value
    return (*loc[:2], *loc[3:]) if loc[:1] == ("faults",) and len(loc) > 2 else loc


def cross_checks(config: Config) -> list[Complaint]:
    """Return what is wrong between keys that are right by themselves."""
    if twice := list(_repeated("id", [robot.id for robot in config.robots])):
        return twice  # whoever names robots may mean either
    return [
        *(list(_untagged(config)) or _repeated("tag", [robot.tag for robot in config.robots])),
        *_bodies(config),
        *_members(config),
        *_units(config),
        *_troubles(config),
        *_endpoint(config),
        *cameras.complaints(config),
        *projectors.complaints(config.projectors, tuple((path, c.source) for path, c in config.camera_keys)),
        *_calibrations(config),
        *_simulated(config),
        *_sensors(config),
        *bodies.complaints(config),
        *obstacles.complaints(config.arena),
    ]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint at the nearest of the known names, else at all of them."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"


def meant_among(given: Iterable[str], key: str) -> bool:
    """Return whether a key, or one that is near to it, is among those that were given."""
    return bool(difflib.get_close_matches(key, list(given), n=1))


def counted(number: int, what: str) -> str:
    """Return a number of things in words: ``1 item``, ``2 items``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def meant(loc: tuple[str | int, ...], root: type[BaseModel] = Config) -> tuple[str | int, ...]:
    """Return the known key that an unknown one is nearest to, else the unknown one; ``root``: as in ``plain_words``."""
    near = difflib.get_close_matches(str(loc[-1]), sorted(_known_keys(loc[:-1], root)), n=1)
    return (*loc[:-1], *near) if near else loc


def _known_keys(loc: Iterable[str | int], root: type[BaseModel] = Config) -> list[str]:
    """Return the keys that the mapping at ``loc`` may have."""
    kind = root
    kinds: dict[str | int, type[BaseModel]] = {}
    inside: type[BaseModel] | None = None  # of a mapping whose keys are names
    for part in loc:
        if part in kinds:
            kind = kinds[part]
        elif inside is not None:
            kind, inside = inside, None
        elif isinstance(part, str) and part in kind.model_fields:
            annotation = kind.model_fields[part].annotation
            if get_origin(annotation) is dict:
                inside = get_args(annotation)[1]
                continue
            kind = (get_args(annotation) or (annotation,))[0]
            kinds = _kinds(kind)
    return list(getattr(kind, "model_fields", ()))


def elsewhere(key: str, models: Mapping[str, type[BaseModel]], written: Callable[[str], bool]) -> list[str]:
    """Return where in the tree a key of this name stands, else a key of a near name: three dotted paths at most.

    ``models``: the tree by the paths of its parts. ``written``: whether the configuration has the mapping at a path;
    keys of such a mapping go before all others.
    """
    paths = [path for start, model in models.items() for path in _paths(model, start)]
    names = [path.rpartition(".")[2] for path in paths]
    near = difflib.get_close_matches(key, names, n=1, cutoff=_NEAR)
    found = [path for path, name in zip(paths, names, strict=True) if name in near]
    present = [path for path in found if "." not in path or written(path.rpartition(".")[0])]
    return sorted(present or found, key=lambda path: path.count("."))[:_MOST_HINTS]


def _paths(model: type[BaseModel], start: str = "") -> Iterator[str]:
    """Yield the dotted paths of all keys; an item of a list is its first."""
    for name, field in model.model_fields.items():
        yield start + name
        annotation = field.annotation
        item = "0." if get_origin(annotation) is tuple else ""
        for inner in (annotation, *get_args(annotation)):
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                yield from _paths(inner, f"{start}{name}.{item}")


def _key(loc: tuple[str | int, ...]) -> str:
    """Return the key, whose end is its unit."""
    return next((part for part in reversed(loc) if isinstance(part, str)), "")


def _kinds(union: object) -> dict[str | int, type[BaseModel]]:
    """Return the models of a union by their kinds; none where it is no union."""
    models = get_args(get_args(union)[0]) if get_args(union) else ()
    return {name: model for model in models for name in get_args(model.model_fields["kind"].annotation)}


def _untagged(config: Config) -> Iterator[tuple[str, str]]:
    """Yield the robots that lack the tag by which a camera knows them: (dotted path, what is wrong)."""
    for i, robot in enumerate(config.robots):
        if robot.tag == UNTAGGED:
            yield f"robots.{i}.tag", f"is missing: a camera knows {robot.id} by its tag: add `tag: NUMBER`"


def _repeated(key: str, values: Sequence[object]) -> Iterator[Complaint]:
    for i, value in enumerate(values):
        if (first := values.index(value)) < i:
            yield f"robots.{i}.{key}", f"{value} is robots.{first}'s already: give each robot its own"


def _bodies(config: Config) -> Iterator[Complaint]:
    """Bodies of the motion capture that are two robots', or a robot's and nobody's."""
    if config.tracker.source != "mocap":
        return
    names = [robot.body_name for robot in config.robots]
    yield from _repeated("body", names)
    for i, name in enumerate(config.tracker.mocap.others):
        if name in names:
            yield f"tracker.mocap.others.{i}", f"{name} is the body of {config.robots[names.index(name)].id}: remove it"


def _calibrations(config: Config) -> Iterator[Complaint]:
    for i, robot in enumerate(config.robots):
        if robot.calibration is not None and robot.calibration.robot != robot.id:
            message = f"was measured on '{robot.calibration.robot}', not on '{robot.id}': calibrate this robot"
            yield f"robots.{i}.calibration", message
    known = {robot.tag: f"robot {robot.id}'s" for robot in config.robots}
    for i, floor_tag in enumerate(config.tracker.floor_tags):
        if floor_tag.tag in known:
            yield f"tracker.floor_tags.{i}.tag", f"{floor_tag.tag} is {known[floor_tag.tag]} already: take another id"
        known[floor_tag.tag] = f"tracker.floor_tags.{i}'s"


def no_errors(robot: int) -> Complaint:
    """Return the refusal of a robot that does not exist, and whose vehicle does not say how bad it is."""
    return (
        f"robots.{robot}.vehicle.simulated",
        "is missing: say what a simulated robot of this kind gets wrong: `simulated: {...}`, "
        "configs/robots/ideal.yaml has none",
    )


def _sensors(config: Config) -> Iterator[Complaint]:
    """Yield robots with ``sensors: true`` whose kind has no sensors."""
    for i, robot in enumerate(config.robots):
        kind = robot.vehicle.sensors
        if robot.sensors and (kind is None or not kind.model_dump(exclude={"period_s"}, exclude_none=True)):
            message = "its vehicle has no sensors: describe them in vehicle.sensors, or remove this key"
            yield f"robots.{i}.sensors", message


def _simulated(config: Config) -> Iterator[Complaint]:
    """Robots that only a plant can move: a real robot needs no errors."""
    for i, robot in enumerate(config.robots):
        if robot.vehicle.simulated is None and (robot.driver == "simulated" or robot.twin is not None):
            yield no_errors(i)


def _units(config: Config) -> Iterator[Complaint]:
    """Units of one name, and tags that no camera can see."""
    taken = {crew[0].id for crew in config.crews}
    for i, robot in enumerate(config.robots):
        if robot.unit in taken:
            message = f"{robot.unit} is the unit of the robot {robot.unit} already: give it another name"
            yield f"robots.{i}.unit", message
        if config.tracker.source == "camera" and robot.reality == "real" and robot.tag != UNTAGGED:
            yield from cameras.unknown_id(config, f"robots.{i}.tag", robot.tag)


def _members(config: Config) -> Iterator[Complaint]:
    """What names no robot, and groups that name one twice."""
    known = [robot.id for robot in config.robots]
    named: list[tuple[str, str]] = []
    for path, camera in config.camera_keys:
        named += _in_scenes(f"{path}.simulated", camera.simulated)
    index: dict[str, int] = {}
    titles: dict[str, int] = {}
    for i, group in enumerate(config.groups):
        if group.name is not None and titles.setdefault(group.name, i) != i:
            yield f"groups.{i}.name", f"{group.name} is groups.{titles[group.name]}'s already: give each its own"
        for k, robot in enumerate(group.robots):
            named.append((f"groups.{i}.robots.{k}", robot))
            if robot in group.robots[:k]:
                yield f"groups.{i}.robots.{k}", f"{robot} is in the group already: remove one"
            elif index.setdefault(robot, i) != i:
                yield f"groups.{i}.robots.{k}", f"{robot} is in groups.{index[robot]} already: a robot has one group"
    unseen = [robot.id for robot in config.virtual]
    for path, robot in named:
        if robot in unseen and path.startswith("camera"):
            yield path, f"{robot} is in no image, its reality is simulated: name another robot"
        if robot not in known:
            yield path, f"there is no robot '{robot}': {did_you_mean(robot, known)}"


def _in_scenes(path: str, simulated: SimulatedCameraSettings) -> list[Complaint]:
    """Return the robots that a simulated camera names, each with its path."""
    named = [(f"{path}.covers.{i}.robot", cover.robot) for i, cover in enumerate(simulated.covers)]
    named += [(f"{path}.tag_offsets.{i}.robot", offset.robot) for i, offset in enumerate(simulated.tag_offsets)]
    named += [(f"{path}.prints.{i}.robot", tag.robot) for i, tag in enumerate(simulated.prints) if tag.robot]
    swaps = ((i, k, robot) for i, swap in enumerate(simulated.swaps) for k, robot in enumerate(swap.robots))
    return [*named, *((f"{path}.swaps.{i}.robots.{k}", robot) for i, k, robot in swaps)]


def _troubles(config: Config) -> Iterator[Complaint]:
    """Timed faults of robots that are not there, or that cannot be."""
    known = [robot.id for robot in config.robots]
    for i, fault in enumerate(config.faults):
        robot = getattr(fault, "robot", None)
        named = [] if robot is None else [("robot", robot)]
        named += [(f"robots.{k}", name) for k, name in enumerate(getattr(fault, "robots", ()))]
        for key, name in named:
            if name not in known:
                yield f"faults.{i}.{key}", f"there is no robot '{name}': {did_you_mean(name, known)}"
        if fault.kind == "camera_frozen" and config.tracker.own_times:
            yield f"faults.{i}.kind", f"{config.tracker.source} has no image that could freeze: take camera_stalled"
        if isinstance(fault, IdSwap) and fault.robots[0] == fault.robots[1]:
            yield f"faults.{i}.robots.1", f"{fault.robots[1]} has its own tag: name two robots"
        if isinstance(fault, Late) and fault.p99_s <= fault.median_s:
            yield f"faults.{i}.p99_s", f"must be more than the median, {fault.median_s:g} s"
        if isinstance(fault, ClockStep) and (fault.process == "router" or fault.process.startswith("tracker")):
            message = f"a simulated camera has no other clock than the {fault.process}'s: name another process"
            yield f"faults.{i}.process", message
        if fault.at_s is not None and fault.at_s >= config.run.duration_s:
            message = f"the run ends after {config.run.duration_s:g} s: nothing would happen: make it earlier"
            yield f"faults.{i}.at_s", message
        topics = getattr(fault, "topics", ())
        if robot is not None and (of_all := [t for t in topics if t in ("poses", "state", "tick")]):
            yield f"faults.{i}.robot", f"{of_all[0]} is not sent to one robot: leave robot out, or {of_all[0]}"


def _endpoint(config: Config) -> Iterator[Complaint]:
    """An address that strangers can reach is refused to every process, also to one that is started by hand."""
    endpoint = config.bus.endpoint
    if config.drivers.started_by == "systemd" and (endpoint == PRIVATE or endpoint.endswith(":0")):
        yield (
            "bus.endpoint",
            "drivers that are there before the run cannot know where it will be: "
            "name a socket, as unixsock-stream//run/robofleet/lab.sock",
        )
    if config.bus.router == "service" and endpoint.endswith(":0"):
        yield "bus.endpoint", "a router that is there before the run has one port: name it, or leave the endpoint out"
    if config.drivers.started_by == "daemon":
        yield from _daemons(config)
    if endpoint.startswith(SOCKET):
        length = len(endpoint.removeprefix(SOCKET).encode())
        if length > LONGEST_SOCKET_PATH:
            yield "bus.endpoint", f"the path has {length} bytes, a socket's at most {LONGEST_SOCKET_PATH}: shorten it"
    if not endpoint.startswith(TCP):
        return
    host, _, port = endpoint.removeprefix(TCP).rpartition(":")
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        message = f"{host} can be reached from outside and TCP is not encrypted: leave it out, or write private"
        yield "bus.endpoint", message
    elif config.bus.insecure is None:
        yield (
            "bus.endpoint",
            "over TCP every user of this computer can drive: leave it out for a private socket, "
            "or say `insecure: loopback` beside it",
        )
    if int(port) > 65535:
        yield "bus.endpoint", f"there is no port {port}: take 0 for any free one, or up to 65535"


def _daemons(config: Config) -> Iterator[Complaint]:
    """Drivers on other computers are known by their certificates, and reach the router by its own."""
    if not config.bus.listen:
        yield (
            "drivers.started_by",
            "the robots' computers reach this one by its network: name its address, as "
            "`bus: {listen: [quic/192.168.1.10:7447]}`",
        )
    for i, robot in enumerate(config.robots):
        if robot.unit is None and robot.driver != "simulated":
            yield (
                f"robots.{i}.unit",
                f"missing: the computer of {robot.id} is known by its unit's certificate: write `unit: {robot.id}`, "
                f"and `robofleet keys add {config.arena.name} {robot.id}`",
            )
