"""Latches that drivers have left on this computer: they refuse a start at once, and are cleared between runs."""

import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress

from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.core.patterns import NAME_PATTERN
from robofleet.core.refusal import RefusedError, unkept
from robofleet.nodes.unit.state_store import FileStateStore, StoredLatch, latched_arenas
from robofleet.operator.terminal.terminal import Terminal
from robofleet.safety.latches import Latch

_KEY_WITHIN_S = 10  # then the run's command ends
_CAUSES = {
    Latch.EMERGENCY_STOP: "an emergency stop",
    Latch.WIRED_STOP: "the robot's own e-stop",
    Latch.DRIVER_FAILED: "a driver that lost its robot",
    Latch.MEMORY_LOST: "a state file that cannot be read",
    Latch.ROBOT_FAULT: "a fault that the robot reported",
    Latch.RUNAWAY: "a wheel that turned by itself",
}


def of_run(config: Config) -> tuple[StoredLatch, ...]:
    """Return the latches of a run's robots, of those that this computer drives."""
    return FileStateStore(config.arena.name).latches(local_robots(config))


def local_robots(config: Config) -> tuple[str, ...]:
    """Return the robots whose drivers keep their state for this user on this computer."""
    if config.drivers.started_by == "systemd":
        return ()
    return tuple(robot for robot in config.ids if config.unit_of[robot] not in config.daemons)


def refuse_latched(config: Config, command: Sequence[str] = ()) -> None:
    """Refuse a start that the supervisor would refuse later; ``command``: the same start, which resets first."""
    if not (latches := of_run(config)):
        return
    look = "" if are_simulated(latches) else "Look at the robots. "
    ways = [["robofleet", "reset", config.arena.name], *([[*command]] if command else [])]
    how = " or: ".join(f"`{shlex.join(way)}`" for way in ways)
    raise RefusedError(f"{config.arena.name}: {latched_words(latches)}. {look}Clear it with: {how}")


def tell_latched(config: Config, *, ask: bool) -> None:
    """Say at the end of a run which robots are latched, and how that is cleared.

    ``ask``: where nothing is real, a key of the run's terminal clears it at once.
    """
    if not (latches := of_run(config)):
        return
    arena, words = config.arena.name, latched_words(latches)
    if ask and are_simulated(latches) and sys.stderr.isatty():
        with Terminal() as terminal:
            if terminal.present:
                print(f"{words}.\n z  reset    any other key, or {_KEY_WITHIN_S} s: leave it", file=sys.stderr)
                clock = WallClock()
                if "z" in terminal.keys(clock, clock.now_ns() + _KEY_WITHIN_S * S):
                    print(cleared(arena, latches)[1], file=sys.stderr)
                    return
                words = "It stays latched"
    look = "" if are_simulated(latches) else "Look at the robots. "
    print(f"{words}. {look}Clear it with: `robofleet reset {arena}`", file=sys.stderr)


def reset_stored(arena: str | None, config: Config | None = None, *, confirmed: bool = False) -> tuple[bool, str]:
    """Clear the latches of an arena without a run; return whether it is done, and what happened.

    ``arena``: None means the only one with latches; ``config``: its configuration, if that was named; ``confirmed``:
    real robots are at rest, and nobody need be asked.
    """
    try:
        latched = latched_arenas() if config is None else ()
        if arena is None:
            if len(latched) > 1:
                raise RefusedError(f"several arenas have latched robots: name one of {', '.join(latched)}")
            if not latched:
                return True, "no robot is latched on this computer: nothing to reset"
            arena = latched[0]
        elif config is None and not (re.fullmatch(NAME_PATTERN, arena) and FileStateStore(arena).known):
            found = f"arenas with latched robots: {', '.join(latched)}" if latched else "no robot is latched here"
            raise RefusedError(f"{arena}: no run of such an arena was on this computer; {found}")
        latches = FileStateStore(arena).latches()
    except OSError as error:
        raise unkept(error) from error
    elsewhere = "" if config is None else _elsewhere(config)
    if not latches:
        return True, f"{arena}: no robot is latched on this computer: nothing to reset{elsewhere}"
    if not (confirmed or are_simulated(latches) or _confirmed(arena, latches)):
        return False, f"{arena}: nothing is reset"
    done, words = cleared(arena, latches)
    return done, f"{words}{elsewhere}"


def cleared(arena: str, latches: Sequence[StoredLatch]) -> tuple[bool, str]:
    """Clear these latches, and no others; return whether it is done, and what happened."""
    try:
        changed = FileStateStore(arena).clear(latches)
    except OSError as error:
        raise unkept(error) from error
    if changed:
        return False, f"{arena}: {', '.join(changed)}: latched anew meanwhile, and not reset: look at the robots"
    robots = ", ".join(stored.robot for stored in latches)
    return True, f"{arena}: {robots}: reset; nothing has moved, and the next run can start"


def are_simulated(latches: Sequence[StoredLatch]) -> bool:
    """Whether nothing real was in the runs that left these latches."""
    return all(stored.simulated for stored in latches)


def latched_words(latches: Sequence[StoredLatch]) -> str:
    """Return who is latched, by what and since when: robots with the same cause together."""
    by_cause: dict[Latch, list[StoredLatch]] = {}
    for stored in latches:
        by_cause.setdefault(stored.latch, []).append(stored)
    return "; ".join(
        f"{', '.join(stored.robot for stored in same)} {'is' if len(same) == 1 else 'are'} latched by {_CAUSES[latch]} "
        f"({max(stored.since for stored in same).astimezone():%-d %b %H:%M})"
        for latch, same in by_cause.items()
    )


def _confirmed(arena: str, latches: Sequence[StoredLatch]) -> bool:
    """Ask whether real robots are at rest; RefusedError where nobody can be asked."""
    words = f"{arena}: {latched_words(latches)}"
    if not sys.stdin.isatty():
        raise RefusedError(
            f"{words}. Look at the robots. If they are at rest and may drive again: `robofleet reset {arena} --yes`"
        )
    answer = ""
    with suppress(EOFError):
        answer = input(f"{words}.\nLook at the robots. Are they at rest, and may they drive again? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def _elsewhere(config: Config) -> str:
    """Return which robots have their latches on computers of their own."""
    robots = [robot for robot in config.ids if config.unit_of[robot] in config.daemons]
    if not robots:
        return ""
    return f". The state of {', '.join(robots)} is on computers of their own: `robofleet run CONFIG --reset` clears it"
