"""From a gamepad to a run: the stick's newest state by the newest tick, while the dead-man's button is held."""

import select
from collections.abc import Callable

from robofleet.bus.bus import Bus
from robofleet.bus.keys import STATE
from robofleet.bus.messages import RunState
from robofleet.bus.observer import Observer
from robofleet.bus.ticks import TickFollower
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.gateways.gamepad.pads import Pad
from robofleet.operator.hand import Hand
from robofleet.safety.supervisor import Phase

_AGAIN_NS = 20 * MS  # a command that stays as it is
_SILENT_NS = 3 * S  # of the controller


def drive(
    pad: Pad, config: Config, bus: Bus, clock: Clock, group: str, over: Callable[[], bool], out: str = ""
) -> None:  # fmt: skip
    """Drive a group until the run is over; OSError where the gamepad is gone. Then, too, the robots stand.

    ``out``: the robot of the group that is driven out while the run is held; by default the first one.
    """
    hand, observer = Hand(bus, config, group), Observer(bus, [STATE])
    out = out or next(own.robots[0] for own in config.groups if own.title == group)
    epoch = 0  # of the run's supervisor: another one is another run's
    ticks = TickFollower(bus, round(config.controller.tick_s * S), lambda _: None)
    stick = pad.read()
    newest, heard_ns = 0, clock.now_ns()
    try:
        while True:
            readable, _, _ = select.select([pad], [], [], _AGAIN_NS / S)
            if readable:
                stick = pad.read()
            ticks.update()
            now_ns = clock.now_ns()
            observer.update(now_ns)
            state: RunState | None = observer[STATE]
            epoch = epoch or (state.epoch if state else 0)
            if state is not None and state.epoch != epoch:
                return
            if state is not None and state.phase == Phase.HOLD:
                hand.drive_out(out, stick, ticks.newest)
            else:
                hand.drive(stick, ticks.newest)
            if ticks.newest != newest:
                newest, heard_ns = ticks.newest, now_ns
            elif now_ns - heard_ns > _SILENT_NS and over():
                return
    finally:
        hand.let_go()
