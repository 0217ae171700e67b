"""Senders of random valid setpoints, for groups that a program or a person drives.

It sees the controller's ticks and answers each of them on the group's own topic, as a script, a person's hand or a
ROS 2 node does: with its epoch, a number that grows, and the tick that it has seen.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.script import Script
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TELEOP, TICK, Topic, key
from robofleet.bus.messages import SCRIPT_WISH, TICK_RECORD
from robofleet.bus.setpoints import setpoint_topics
from robofleet.config import groups, slices
from robofleet.config.slices import generator
from robofleet.config.tree import Config, Group
from robofleet.core.arrays import Array

_EPOCH_BITS = 30
_CHANGE_EVERY_S = 0.3, 3.0  # from, to
_SHARE, _TURN_RATE, _TURN_RAD_S = 0.5, 2.0, 1.0  # of its top speed; how it turns towards a goal, at most
_INSIDE, _BEYOND = 0.6, 1.1  # of the half arena: goals of a sender that is calm, and of one that is not
_KINDS = WishKind.BODY, WishKind.BODY, WishKind.POINT, WishKind.POSES, WishKind.STAND


class Senders:
    """A sender for each group that takes setpoints; ``calm`` lets all of them drive every robot about."""

    def __init__(self, config: Config, bus: MemoryBus) -> None:
        topics, scripts = setpoint_topics(config), groups.taking_setpoints(config, Script)
        self._senders = [
            _Sender(config, bus, group, topics[group.title], anything=group.title in scripts)
            for group in config.groups
            if group.title in topics
        ]
        self._tick_key = key(config.arena.name, TICK)
        if self._senders:
            bus.tap(self._take)

    def calm(self) -> None:
        """Let every robot drive from now on."""
        for sender in self._senders:
            sender.kinds = (WishKind.BODY,)
            sender.reach = _INSIDE
            sender.left_ticks = 0

    def _take(self, message: tuple[str, bytes]) -> None:
        if message[0] == self._tick_key and (record := TICK_RECORD.view(message[1])) is not None:
            head, robots = record
            for sender in self._senders:
                sender.answer(head.tick, robots)


class _Sender:
    """A person drives the group's first robot alone; ``anything``: it knows every kind of setpoint."""

    def __init__(self, config: Config, bus: MemoryBus, group: Group, topic: Topic, *, anything: bool) -> None:
        self._rng = generator(config.run.seed, "setpoints", group.title)
        self._epoch, self._seq, self._order = slices.drawn_id(self._rng, _EPOCH_BITS), 0, 0
        self._rows = np.array([config.ids.index(robot) for robot in group.robots])
        members = {robot.id: robot for robot in config.members}
        drives = [slices.drive(members[robot]) for robot in group.robots]
        self._speeds = np.array([_SHARE * drive.max_speed for drive in drives])
        self._half, self._tick_s = np.array(config.arena.size_m) / 2, config.controller.tick_s
        self._robots = np.zeros(len(group.robots), SCRIPT_WISH.item_dtype)
        self._robots["told"] = [row == 0 or topic is not TELEOP for row in range(len(group.robots))]
        self._values = SCRIPT_WISH.floats(self._robots)  # of the same memory (N, 3)
        self._publish: Callable[[bytes], None] = bus.publisher(topic, group.title)
        self.kinds: tuple[WishKind, ...] = _KINDS if anything else (WishKind.BODY, WishKind.BODY, WishKind.STAND)
        self.reach, self.left_ticks = _BEYOND, 0
        self._kind, self._goals = WishKind.STAND, np.zeros((len(group.robots), 2))

    def answer(self, tick: int, robots: Any) -> None:
        if self.left_ticks <= 0:
            self._change()
        self.left_ticks -= 1
        at, psi = np.column_stack([robots["x_m"], robots["y_m"]])[self._rows], robots["psi_rad"][self._rows]
        self._values[:] = 0.0
        if self._kind is WishKind.POSES:
            self._values[:, :2] = self._goals
        elif self._kind is not WishKind.STAND:
            self._values[:, :2] = self._towards(at, psi)
        if not np.isfinite(self._values).all():
            return  # a robot that nobody has seen yet
        self._seq += 1
        self._publish(SCRIPT_WISH.encode_array((self._epoch, self._seq, self._kind, self._order, tick), self._robots))

    def _change(self) -> None:
        rng = self._rng
        self._kind = self.kinds[int(rng.integers(len(self.kinds)))]
        self._order += self._kind is WishKind.POSES
        self._goals = rng.uniform(-1.0, 1.0, self._goals.shape) * self.reach * self._half
        self.left_ticks = round(float(rng.uniform(*_CHANGE_EVERY_S)) / self._tick_s)

    def _towards(self, at: Array, psi: Array) -> Array:
        """Return velocities towards the goals: of the points, or v [m/s] and omega [rad/s] of the bodies, never 0."""
        way = self._goals - at
        if self._kind is WishKind.POINT:
            return np.asarray(self._speeds[:, None] * way / np.maximum(np.hypot(*way.T), 1e-3)[:, None])
        off = (np.arctan2(way[:, 1], way[:, 0]) - psi + math.pi) % math.tau - math.pi
        turn = np.clip(_TURN_RATE * off, -_TURN_RAD_S, _TURN_RAD_S)
        return np.column_stack([self._speeds * np.cos(off / 2), turn])
