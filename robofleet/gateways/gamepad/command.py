"""The command ``teleop``."""

import select
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from robofleet.bus.bus import Bus
from robofleet.bus.keys import STATE, TICK
from robofleet.bus.messages import RunState, TickRecord
from robofleet.bus.observer import Observer
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.core.refusal import LAB_MODULES, RefusedError, need_extra
from robofleet.gateways.gamepad.pads import EventPad
from robofleet.gateways.place import ConfigCopy, Served, answering, is_over, joined_bus, joined_otherwise, run_of
from robofleet.operator.commands import ArenaName
from robofleet.operator.hand import Hand, drivers
from robofleet.safety.supervisor import Phase

_REPEAT_NS = 20 * MS  # of a command that stays as it is


def drive(
    pad: EventPad, config: Config, bus: Bus, clock: Clock, group: str, over: Callable[[], bool], out: str = ""
) -> None:  # fmt: skip
    """Drive a group until the run is over; OSError where the gamepad is gone. Then, too, the robots stand.

    ``out``: the robot of the group that is driven out while the run is held; by default the first one.
    """
    hand, observer, described = Hand(bus, config, group), Observer(bus, [STATE, TICK]), groups.descriptions(config)
    out = out or next(own.robots[0] for own in config.groups if own.title == group)
    stick, served, refused = pad.read(), Served(over, clock.now_ns()), False
    try:
        while True:
            readable, _, _ = select.select([pad], [], [], _REPEAT_NS / S)
            if readable:
                stick = pad.read()
            now_ns = clock.now_ns()
            if STATE in observer.update(now_ns):
                served.take(observer[STATE].epoch, now_ns)
            if served.is_over(now_ns):
                return
            state: RunState | None = observer[STATE]
            record: TickRecord | None = observer[TICK]
            held = state is not None and state.phase == Phase.HOLD
            other = drivers(described, record).get(group, hand.epoch) != hand.epoch
            if stick.held and other and not refused:
                print(f"another person drives {group}: let go, wait, then press again", file=sys.stderr)
            refused = stick.held and (refused or other)  # until the button is let go
            tick = 0 if record is None else record.tick
            hand.drive(stick._replace(held=stick.held and not refused), tick, out if held else None)
    finally:
        hand.let_go()


def teleop(
    arena: ArenaName = None,
    config: ConfigCopy = None,
    group: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which group, if several have the behaviour teleop.")
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(metavar="ROBOT", help="The robot to drive during a hold. Default: the group's first."),
    ] = None,
    device: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="The gamepad, for example /dev/input/event3. Default: the only one."),
    ] = None,
) -> None:
    """Drive a robot with a gamepad.

    It drives the first robot of a group with the behaviour teleop.

    $ robofleet teleop

    $ robofleet teleop --out r3

    Press and hold L1 or R1: the left stick drives. Release it: the robot stands. During a hold it drives one robot,
    slowly. Ctrl-C ends this command; the run goes on.
    """
    from robofleet.bus.permissions import OPERATOR as PERSON  # noqa: PLC0415
    from robofleet.core.clock import WallClock  # noqa: PLC0415
    from robofleet.gateways.gamepad import pads  # noqa: PLC0415

    need_extra("teleop", "evdev")
    need_extra("lab", *LAB_MODULES)
    tree, access = run_of(arena or None, config)
    if why := joined_otherwise(tree, access, PERSON):
        raise RefusedError(why)
    chosen = _group(tree, group)
    robots = next(candidate for candidate in tree.groups if candidate.title == chosen).robots
    if out is not None and out not in robots:
        raise RefusedError(f"--out {out}: it is not in the group {chosen}: name one of {', '.join(robots)}")
    try:
        pad = pads.opened(device)
    except pads.PadError as error:
        raise RefusedError(str(error)) from error
    clock = WallClock()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with answering(tree):
        bus = joined_bus(tree, access, access.role, clock)
    robot = robots[0]
    print(
        f"{pad.name} drives {robot} while a shoulder button is held: Ctrl-C ends this, and not the run", file=sys.stderr
    )
    try:
        with suppress(KeyboardInterrupt):
            drive(pad, tree, bus, clock, chosen, lambda: is_over(tree, access), out or robot)
    except OSError as error:
        print(f"{pad.name} is gone ({error.strerror}): {robot} stands", file=sys.stderr)
        raise typer.Exit(1) from error
    finally:
        bus.close()


def _group(config: "Config", named: str | None) -> str:
    """Return the group that is driven; RefusedError where there is none, or several and none was named."""
    from robofleet.operator.hand import driven  # noqa: PLC0415

    found = driven(config)
    if not found:
        raise RefusedError(f"no group of {config.arena.name} has the behaviour teleop: give one to a group")
    if named is None and len(found) > 1:
        raise RefusedError(f"several groups are driven by hand: name one with --group: {', '.join(found)}")
    if named is not None and named not in found:
        raise RefusedError(f"--group {named}: it is not driven by hand: name one of {', '.join(found)}")
    return named or found[0]
