"""One robot that a person drives out of a held run, at a crawl, while all others stand. Pure.

The permission is the supervisor's alone. It listens to the person's commands itself, as the controller does: so it
sees by itself that the dead-man's button is held, and for which robot. It permits that robot only

- in a HOLD of a run that was RUNNING, in which nothing lasts but robots that are too close: poses are fresh, and every
  process is heard (what would end the run has ended it before this is asked);
- while the robot is seen, and its driver is heard, without a fault, with an open gate;
- while the newest command with the button is fresh, by its arrival and by the controller's tick that it echoes;
- if the button was pressed in this HOLD: a word with it follows a heard word without it, of the same hand. Whatever
  takes the permission back, another robot, another hand and silence need a new press. A button that was held when the
  run was held moves nothing.
"""

from collections.abc import Hashable, Iterable
from typing import NamedTuple

from robofleet.safety.latches import Latch
from robofleet.safety.monitor import SILENT_NS, UNSEEN_NS
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase, RunStatus
from robofleet.safety.view import NEVER, FleetView, RobotView

WORD_NS = 150_000_000  # age of the newest command by its arrival: a stick is read every 20 ms
WORD_TICKS = 5  # and by the tick that it echoes: a network that held it back made it no younger
NEWER_TICKS = 2  # that the person's computer may have heard while this process looked elsewhere
_MOST_HANDS = 16  # of which it is remembered that they let go
_LASTING = frozenset({Event.TOO_CLOSE})  # why a robot is to be driven out; the barrier lets it only move apart


class Word(NamedTuple):
    """A person's command."""

    hand: Hashable  # the sender, as the router knows it, and its epoch
    held: bool  # the dead-man's button
    robot: int  # row of the one that is to be driven out; NOBODY: that is not what it commands
    request: Event  # by which way the person commands
    tick: int  # that it echoes


class Rescue(NamedTuple):
    """What is remembered of the person's hand, and who is driven out."""

    word: Word | None = None  # newest of a hand that holds its button
    heard_ns: int = NEVER  # when it came
    pressed: bool = False  # its button was pressed in this HOLD, and nothing took the permission back since
    up: tuple[Hashable, ...] = ()  # hands whose newest word said that the button is up, the newest last
    robot: int = NOBODY  # the one that may move at a crawl
    request: Event = Event.NOTHING

    def cause(self, row: int) -> Event:
        """Return what is told of a robot that is driven out."""
        return self.request if row == self.robot else Event.NOTHING


def watch(
    before: Rescue, words: Iterable[Word], status: RunStatus, standing: tuple[Happening, ...], view: FleetView
) -> Rescue:
    """Return who may be driven out now, by the words that came since the last step, in their order."""
    now = before if before.robot == NOBODY else before._replace(robot=NOBODY, request=Event.NOTHING)
    several = False
    for word in words:
        own = now.word is None or word.hand == now.word.hand
        others = tuple(hand for hand in now.up if hand != word.hand)
        if word.held:
            fresh = _fresh(now, view)
            several = several or (fresh and not own)
            pressed = word.hand in now.up or (now.pressed and fresh and own)
            now = now._replace(word=word, heard_ns=view.now_ns, pressed=pressed, up=others)
        else:
            now = now._replace(up=(*others, word.hand)[-_MOST_HANDS:])
            now = now._replace(word=None) if own else now
    held = status.phase is Phase.HOLD and status.held is Phase.RUNNING
    if now.word is None or not (held and now.pressed and _fresh(now, view)):
        return now._replace(pressed=False) if now.pressed else now
    another = several or before.robot not in (NOBODY, now.word.robot)
    if another or not _is_well(now.word.robot, standing, view):
        return now._replace(pressed=False)
    return now._replace(robot=now.word.robot, request=now.word.request)


def _fresh(rescue: Rescue, view: FleetView) -> bool:
    word = rescue.word
    return (
        word is not None
        and view.now_ns - rescue.heard_ns <= WORD_NS
        and -NEWER_TICKS <= view.tick - word.tick <= WORD_TICKS
        and view.now_ns - view.controller_ns <= WORD_NS  # else its ticks say nothing of an age
    )


def _is_well(row: int, standing: tuple[Happening, ...], view: FleetView) -> bool:
    """Return whether a robot can be driven out: it is seen, heard and healthy, and nothing lasts that forbids it."""
    if not 0 <= row < view.driven or any(happening.event not in _LASTING for happening in standing):
        return False
    robot: RobotView = view.robots[row]
    seen = robot.seen_ns != NEVER and robot.unseen_ns < UNSEEN_NS and not robot.lost
    recent = robot.heard_ns != NEVER and view.now_ns - robot.heard_ns <= SILENT_NS
    return seen and recent and not robot.faults and robot.latch == Latch.NONE and not robot.failed
