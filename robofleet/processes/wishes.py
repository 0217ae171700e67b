"""What scripts wish of their groups, as the controller takes it: checked, the newest alone, of one script a group.

A wish says by which tick its script decided. So its age is known without a comparison of clocks, and what a network
or a stopped script held back is old when it comes.
"""

import numpy as np

from robofleet.behaviours.interface import Wish, WishKind
from robofleet.behaviours.teleop import Teleop
from robofleet.comms.bus import Bus, Subscription
from robofleet.comms.keys import WISH
from robofleet.comms.messages import SCRIPT_WISH, ScriptWish
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.safety.supervisor import Phase

_BEYOND = 1e6  # [m/s, rad/s, m]: nobody wishes that
_GONE_S = 0.5  # after its newest wish a script that says no more has left its place to another one
_PARTED = WishKind.STAND, WishKind.DONE, WishKind.FAILED  # whoever said this is not in another's way
_KINDS = frozenset(WishKind)


class Wishes:
    """The newest wish of each group, in the order of the groups."""

    def __init__(self, config: Config, bus: Bus) -> None:
        scripted, by_hand = groups.scripted(config), groups.wishing(config, Teleop)
        tick_s = config.controller.tick_s
        self._groups = [
            _OfGroup(bus.newest(WISH, group.title), len(group.robots), tick_s, by_hand=group.title in by_hand)
            if group.title in scripted
            else None
            for group in config.groups
        ]
        self.nobody: tuple[Wish | None, ...] = (None,) * len(self._groups)
        self._some = any(self._groups)

    def at(self, tick: int, phase: Phase) -> tuple[Wish | None, ...]:
        """Return the wishes at a tick; while no robot may drive, wishes are dropped.

        In HOLD only a person's wish counts that drives one robot out.
        """
        if not self._some:
            return self.nobody
        return tuple(None if one is None else one.at(tick, phase) for one in self._groups)


class _OfGroup:
    def __init__(self, said: Subscription, robots: int, tick_s: float, *, by_hand: bool) -> None:
        self._said, self._robots, self._tick_s = said, robots, tick_s
        held = frozenset({WishKind.RESCUE, WishKind.STAND}) if by_hand else frozenset[WishKind]()
        self._kinds = {Phase.RUNNING: _KINDS - {WishKind.RESCUE}, Phase.HOLD: held}
        self._phase = Phase.IDLE
        self._newest: tuple[int, Wish] | None = None  # and the tick that it echoes

    def at(self, tick: int, phase: Phase) -> Wish | None:
        payload, kinds = self._said.take(), self._kinds.get(phase)
        if phase is not self._phase:
            self._newest, self._phase = None, phase
        if not kinds:
            return None
        if payload is not None:
            self._take(payload, tick, kinds)
        if self._newest is None:
            return None
        echoed, wish = self._newest
        return Wish(*wish[:4], (tick - echoed) * self._tick_s, *wish[5:])

    def _take(self, payload: bytes, tick: int, kinds: frozenset[WishKind]) -> None:
        """Take a wish that can be one, of the script that drives this group."""
        if (message := SCRIPT_WISH.view(payload)) is None:
            return
        head, robots = message
        known = head.kind in kinds and len(robots) == self._robots and 1 <= head.echo_tick <= tick
        if not known or not self._follows(head, tick):
            return
        values, told = SCRIPT_WISH.floats(robots).copy(), robots["told"] != 0
        if np.abs(values).max() > _BEYOND:
            return
        if not told.all():
            values[~told] = 0.0
        wish = Wish(WishKind(head.kind), values, told, head.order, 0.0, head.epoch, head.seq)
        self._newest = head.echo_tick, wish

    def _follows(self, head: ScriptWish, tick: int) -> bool:
        """Return whether a wish is the next word of the script that drives the group, or the first of the next one."""
        if self._newest is None:
            return True
        echoed, before = self._newest
        if head.epoch == before.epoch:
            return head.seq > before.seq
        return before.kind in _PARTED or (tick - echoed) * self._tick_s > _GONE_S
