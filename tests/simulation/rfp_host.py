"""A host at the line of an emulated board, without a driver, and wheels that do as the board's gate says."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol, TypeVar

from robofleet.drivers.rfp_frames import (
    Command,
    Health,
    Hello,
    Identity,
    Lease,
    Message,
    Permission,
    Receiver,
    Status,
    frame,
    message,
)

EMERGENCY_STOP = 2  # as a latch
OPEN, NO_COMMAND, NO_ENABLE, LATCHED, NO_LEASE = range(5)  # the gate's states
_SESSION = 7
Received = TypeVar("Received", Status, Health, Identity)
_COMMAND_MS = 20


class Line(Protocol):
    """What an emulated board offers to a host."""

    def receive(self, data: bytes) -> None: ...

    def transmitted(self) -> bytes: ...


class RfpHost(ABC):
    """Time passes in whole milliseconds."""

    board: Line

    def __init__(self, counts_per_turn: float) -> None:
        self.newest: dict[type, Message] = {}
        self.commands: tuple[float, float] | None = None  # of both wheels [rad/s]; None: the host is silent
        self.ms = 0
        self._receiver = Receiver()
        self._sent = self._seq = 0
        self._per_ms = counts_per_turn / math.tau / 512.0 / 1000.0  # counts of a speed on the line
        self._owed = [0.0, 0.0]  # of counts
        self.turned = [0, 0]  # counts of both wheels

    @abstractmethod
    def run_board(self, ms: int, left_counts: int, right_counts: int) -> None:
        """Let the board run until then, while its encoders count."""

    @property
    def status(self) -> Status:
        return self._newest(Status)

    @property
    def health(self) -> Health:
        return self._newest(Health)

    def identity(self) -> Identity:
        """Ask the board who it is."""
        self.say(Hello())
        self.pass_ms(20)
        return self._newest(Identity)

    def _newest(self, kind: type[Received]) -> Received:
        newest = self.newest[kind]
        assert isinstance(newest, kind)
        return newest

    def say(self, *messages: Message) -> None:
        for each in messages:
            self.board.receive(frame(each, self._sent))
            self._sent += 1

    def pass_ms(self, ms: int, each: Callable[[], None] = lambda: None) -> None:
        """Let time pass; the host commands as it does all the time. ``each`` is called in each millisecond."""
        for _ in range(ms):
            if self.commands is not None and self.ms % _COMMAND_MS == 0:
                self.command(*self.commands)
            self.ms += 1
            self.run_board(self.ms, *self._turned())
            for body in self._receiver.receive(self.board.transmitted()):
                if (received := message(body)) is not None:
                    self.newest[type(received)] = received
            each()

    def command(self, left: float, right: float, **permission: int) -> None:
        """Send a command and a permission by the newest nonce; ``permission``: what is special in it."""
        self._seq += 1
        epoch, nonce = self.health.epoch, (self.status.boot_id, self.status.nonce)
        allowed = {"latch": 0, "clear": 0, "limit": 32767, **permission}
        self.say(
            Command(epoch, _SESSION, self._seq, *nonce, round(left * 512), round(right * 512)),
            Permission(epoch, self._seq, *nonce, **allowed),
        )

    def drive(self, left: float, right: float) -> None:
        """Take the lease, and command until the wheels have these speeds [rad/s]."""
        self.say(Lease(_SESSION, 1))
        self.pass_ms(200)  # until a Health says of which epoch it is
        self.commands = left, right
        self.pass_ms(400)
        assert self.status.gate == OPEN
        assert (self.status.left_output, self.status.right_output) == (round(left * 512), round(right * 512))

    def _turned(self) -> tuple[int, int]:
        """Return the counts of ideal wheels in a millisecond."""
        if (status := self.newest.get(Status)) is None:
            return 0, 0
        assert isinstance(status, Status)
        for side, speed in enumerate((status.left_output, status.right_output)):
            self._owed[side] += speed * self._per_ms
        whole = int(self._owed[0]), int(self._owed[1])
        for side in (0, 1):
            self._owed[side] -= whole[side]
            self.turned[side] += whole[side]
        return whole
