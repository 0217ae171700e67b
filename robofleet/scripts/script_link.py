"""How a script of the user's own reaches a run: what ``robofleet.Fleet`` needs of one, in lockstep and in real time."""

from pathlib import Path
from typing import Any, NoReturn, Protocol

from robofleet.behaviours.script import Script
from robofleet.bus.keys import Topic
from robofleet.config import groups
from robofleet.config.tree import Bounds, Config, Group
from robofleet.core.errors import RobofleetError
from robofleet.safety.advice import advised
from robofleet.safety.supervisor import RunStatus

BEHAVIOUR = "script"
_LONG_S = 1e6  # the script ends the run


class FleetError(RobofleetError):
    """Raised where a script's run cannot begin, is held, or has ended. The message says why, and what to do."""


class Link(Protocol):
    """A run as its script sees it."""

    config: Config
    folder: Path | None  # in which the run is recorded
    ends: bool  # the run ends with the script

    @property
    def status(self) -> RunStatus:
        """Where the run is."""

    @property
    def tick(self) -> bytes:
        """The newest tick's record."""

    def begin(self) -> None:
        """Wait until the robots may drive; FleetError where the run ends before."""

    def next_tick(self) -> bytes:
        """Wait for the next tick, and return its record; FleetError where none comes any more."""

    def newest(self, topic: Topic, unit: str) -> bytes | None:
        """Return the newest message of a unit: its STATUS, or its SENSORS."""

    def wish(self, payload: bytes) -> None:
        """Send setpoints."""

    def note(self, payload: bytes) -> None:
        """Send a note."""

    def ask(self, what: bytes) -> None:
        """Ask the supervisor; FleetError where it refuses."""

    def done(self, parting: bytes) -> dict[str, Any] | None:
        """Leave, as the script is done; ``parting``: its last setpoints. Returns the summary of a run that ended."""

    def failed(self, parting: bytes, why: str) -> dict[str, Any] | None:
        """Leave, when the script has ended by an error."""


def scripted(config: Config) -> Config:
    """Return a configuration whose run a script ends, and in which some group takes its setpoints.

    One without such a group gets one, of all the robots that would have driven.
    """
    run: dict[str, Any] = {"duration_s": _LONG_S, "end": "where_they_stand"}
    update: dict[str, Any] = {}
    if not groups.taking_setpoints(config, Script):
        settings = groups.load_kind(BEHAVIOUR).Settings().model_dump(mode="json")
        robots = tuple(robot.id for robot in config.members)
        update["groups"] = (Group(name=BEHAVIOUR, behaviour=BEHAVIOUR, robots=robots, settings=settings),)
        run["bounds"] = Bounds()  # they judge what another behaviour does
    return config.model_copy(update={**update, "run": config.run.model_copy(update=run)})


def first(config: Config, count: int | None) -> Config:
    """Return a configuration of the first so many robots that drive, without all others; None: as it is.

    FleetError where there are not so many.
    """
    if count is None:
        return config
    members = config.members
    if not 0 < count <= len(members):
        raise FleetError(
            f"robots: {count} are asked for, and {config.arena.name} has {len(members)}: ask for 1 to them all"
        )
    kept = {robot.id for robot in members[:count]}
    every = [
        group.model_copy(update={"robots": tuple(r for r in group.robots if r in kept)}) for group in config.groups
    ]
    robots = tuple(robot for robot in config.robots if robot.id in kept)
    return config.model_copy(update={"robots": robots, "groups": tuple(group for group in every if group.robots)})


def ended(status: RunStatus, config: Config) -> FleetError:
    """Return why there are no more ticks."""
    words = advised(status.describe(config.ids), status.cause)
    return FleetError(f"the run has ended ({status.phase.name.lower()}): {words}")


def held(status: RunStatus, config: Config) -> FleetError:
    return FleetError(f"the run is held: {status.describe(config.ids)}: `fleet.resume()` goes on")


def refuse(answer: str, what: bytes) -> NoReturn:
    raise FleetError(f"{what.decode()} was refused: {answer.removeprefix('refused: ')}")
