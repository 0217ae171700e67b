"""The setpoints of programs and persons, as the controller takes them: checked, the newest, of one session a group.

A setpoint says by which tick its sender decided. So its age is known without a comparison of clocks, and what a network
or a stopped script held back is old when it comes.

The first session of a run has the group's lease, until it says that it has ended, or until its newest message is older
than half a second. A hold of the run takes no lease away. Who sends is known by the key, which the router permits to
that sender alone; of another sender's epoch and numbers nothing is believed.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from robofleet.behaviours.interface import Wish, WishKind
from robofleet.bus.bus import Bus, BySender
from robofleet.bus.keys import TELEOP
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.bus.setpoints import setpoint_topics
from robofleet.config.tree import Config
from robofleet.safety.supervisor import Phase

_BEYOND = 1e6  # [m/s, rad/s, m]: no setpoint is so large
LEASE_EXPIRES_S = 0.5  # after its newest message a session that sends no more has left its lease to another one
_PARTING_KINDS = frozenset({WishKind.DONE, WishKind.FAILED})  # by these a session ends; a person's hand also by STAND
_KINDS, _NOTHING = frozenset(WishKind), frozenset[WishKind]()


class SetpointInbox:
    """The newest setpoint of each group, in the order of the groups."""

    def __init__(self, config: Config, bus: Bus) -> None:
        topics, tick_s = setpoint_topics(config), config.controller.tick_s
        self._groups = [
            None
            if (topic := topics.get(group.title)) is None
            else _OfGroup(bus.newest_by_sender(topic, group.title), len(group.robots), tick_s, by_hand=topic is TELEOP)
            for group in config.groups
        ]
        self.nobody: tuple[Wish | None, ...] = (None,) * len(self._groups)
        self._some = any(self._groups)

    def at(self, tick: int, phase: Phase) -> tuple[Wish | None, ...]:
        """Return the setpoints at a tick; while no robot may drive, setpoints are dropped.

        In HOLD only setpoints of a person who drives one robot out count.
        """
        if not self._some:
            return self.nobody
        return tuple(None if group is None else group.at(tick, phase) for group in self._groups)


class _Lease(NamedTuple):
    """Who drives a group, by the newest message of that session."""

    session: tuple[str, int]  # the sender, as the router knows it, and the epoch
    seq: int
    echo_tick: int
    parted: bool


class _OfGroup:
    def __init__(self, setpoints: BySender, robots: int, tick_s: float, *, by_hand: bool) -> None:
        self._setpoints, self._robots, self._tick_s = setpoints, robots, tick_s
        held = frozenset({WishKind.RESCUE, WishKind.STAND}) if by_hand else _NOTHING
        self._kinds = {Phase.RUNNING: _KINDS - {WishKind.RESCUE}, Phase.HOLD: held}
        self._parting = _PARTING_KINDS | {WishKind.STAND} if by_hand else _PARTING_KINDS
        self._phase = Phase.IDLE
        self._lease: _Lease | None = None
        self._newest: Wish | None = None  # of the session that has the lease; its age is that of this tick

    def at(self, tick: int, phase: Phase) -> Wish | None:
        if phase is not self._phase:
            self._newest, self._phase = None, phase
        kinds = self._kinds.get(phase, _NOTHING)
        for sender, payload in self._setpoints.take():
            if self._take(sender, payload, tick, kinds):
                break  # of one session in a tick: a replay has no other
        newest, lease = self._newest, self._lease
        if newest is None or lease is None:
            return None
        return replace(newest, age=(tick - lease.echo_tick) * self._tick_s)

    def _take(self, sender: str, payload: bytes, tick: int, kinds: frozenset[WishKind]) -> bool:
        """Take a setpoint that can be one, of the session that drives this group; returns whether it is done."""
        if (message := SCRIPT_WISH.view(payload)) is None:
            return False
        head, robots = message
        session = sender, head.epoch
        known = head.kind in _KINDS and len(robots) == self._robots and 1 <= head.echo_tick <= tick
        if not known or not self._follows(session, head.seq, tick):
            return False
        lease = _Lease(session, head.seq, head.echo_tick, head.kind in self._parting)
        if head.kind not in kinds:
            if self._lease is not None and self._lease.session == session:
                self._lease = lease  # it waits until the robots may drive
            return False
        values, about = SCRIPT_WISH.floats(robots).copy(), robots["told"] != 0
        if np.abs(values).max() > _BEYOND:
            return False
        if not about.all():
            values[~about] = 0.0
        self._lease = lease
        self._newest = Wish(
            kind=WishKind(head.kind), values=values, told=about, order=head.order, age=0.0, epoch=head.epoch,
            seq=head.seq,
        )  # fmt: skip
        return True

    def _follows(self, session: tuple[str, int], seq: int, tick: int) -> bool:
        """Return whether a session may drive the group: it has the lease, or who had it has ended or is silent."""
        lease = self._lease
        if lease is None:
            return True
        if session == lease.session:
            return seq > lease.seq
        return lease.parted or (tick - lease.echo_tick) * self._tick_s > LEASE_EXPIRES_S
