"""Which robot answers at a port: its driver is opened there and closed again, as `robofleet check` does.

A driver that is opened asks who is there and tells the robot to stand: no wheel moves. It is done only where the user
says so: opening a port resets an Arduino, and what is no robot may take a question for a command.

Without a configuration each kind is asked in turn, Create 2 first: it takes single bytes for commands, and nothing else
is said to one that has answered. The next two act on whole lines of text alone. rfp is last: its firmware has
one rate built in, so the usual ones are tried. A robot that does not fit the settings has answered all the same.
"""

from collections.abc import Iterator, Sequence
from os.path import realpath
from typing import Any

from robofleet.core.clock import WallClock
from robofleet.core.plugins import load
from robofleet.doctor.examination import Look, finished
from robofleet.doctor.findings import Finding, Mark, ok
from robofleet.doctor.needs import Needs
from robofleet.doctor.serial_ports import devices, holders
from robofleet.nodes.unit import driver_settings
from robofleet.nodes.unit.reconnecting_driver import in_words
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import DriverContext, DriverError, MisfitError

ALL = "all"
_COUNTS = {"counts_per_turn": 1000.0}  # what settings need and an answer does not depend on
_KINDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("create2", {}),
    ("gternal", {}),
    ("arduino_bridge", _COUNTS),
    *(("rfp", {**_COUNTS, "baud": baud}) for baud in (57600, 115200, 250000)),
)
_ANY_DRIVE = DifferentialDrive(
    wheel_radius=0.03, wheel_base=0.15, max_wheel_speed=1.0, max_speed=0.01, motor_lag=0.1, max_wheel_acceleration=1.0
)
_AT_MOST_S = 45.0  # the slower drivers give a port six seconds, rfp at each rate


def ask(needs: Needs, requested: Sequence[str], at_most_s: float = _AT_MOST_S) -> list[Finding]:
    """Ask ports at once, ``all``: the configuration's, or without one every USB port."""
    return finished([_look(path, [*_contexts(needs, path)]) for path in _paths(needs, requested)], at_most_s)


def _paths(needs: Needs, requested: Sequence[str]) -> list[str]:
    paths: list[str] = []
    for name in requested:
        if name != ALL:
            paths.append(name)
        elif needs.config is not None:
            paths += [port.path for port in needs.ports()]
        else:
            paths += [device.path for device in devices() if device.usb is not None]
    return list({realpath(path): path for path in reversed(paths)}.values())[::-1]


def _contexts(needs: Needs, path: str) -> Iterator[tuple[str, DriverContext]]:
    """Yield the kinds that are tried at a port: of the robot that has it in the configuration, else each."""
    clock = WallClock()
    for port in needs.ports():
        if needs.config is not None and realpath(port.path) == realpath(path):
            robot = needs.config.robot(port.robot)
            yield robot.driver, driver_settings.context(needs.config, robot, clock.now_ns)
            return
    for kind, settings in _KINDS:
        made = load("robofleet.drivers", kind).Settings.model_validate({"port": path, **settings})
        yield kind, DriverContext(robot="", drive=_ANY_DRIVE, simulation=None, now_ns=clock.now_ns, settings=made)


def _look(path: str, contexts: Sequence[tuple[str, DriverContext]]) -> Look:
    """Begin to ask at a port: a driver that hangs holds nobody up."""
    name, grave = f"answer at {path}", Mark.MISSING if contexts[0][1].robot else Mark.WARN
    cure = "unplug it and plug it in again; mend the driver, if it is yours"
    hangs = Finding(name, grave, "its driver did not finish opening it", cure)
    return Look(lambda: iter([_answer(path, contexts, hangs)]), hangs)


def _answer(path: str, contexts: Sequence[tuple[str, DriverContext]], silent: Finding) -> Finding:
    """Open the port by each kind until one answers."""
    if using := holders(path):
        says = f"not asked: process {using[0].pid} ({using[0].command}) has it open"
        return Finding(silent.name, Mark.WARN, says, "end that program first")
    owner, refusals = contexts[0][1].robot, []
    for kind, context in contexts:
        try:
            load("robofleet.drivers", kind)(context).close()
        except Exception as error:  # noqa: BLE001 - a driver may be anybody's
            if owner or not isinstance(error, MisfitError):
                refusal = str(error).removeprefix(f"{path}: ") if isinstance(error, DriverError) else in_words(error)
                refusals.append(refusal)
                continue
        baud = "" if kind != "rfp" else f" and `baud: {context.settings.baud}`"
        end = f", which is {owner}" if owner else f": write `driver: {kind}`{baud} for it"
        return ok(silent.name, f"{kind} answers{end}")
    says, _, cure = refusals[-1].partition(": ")
    if not owner and len(set(refusals)) > 1:
        kinds = ", ".join(dict(_KINDS))
        says, cure = f"none of {kinds} answers", "switch the robot on, and look at its cable"
    return silent._replace(says=says, cure=cure)
