"""Each check that is taken out of a gate, of the supervisor or of the controller is found by a few storms."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.clock import MS, S
from robofleet.config.tree import Config
from robofleet.processes.keeping import MemoryKeeping
from robofleet.processes.storm.episode import play
from robofleet.safety import barrier, gate, monitor, supervisor
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import Event, Phase
from robofleet.vehicles.interface import STOP

Patch = pytest.MonkeyPatch
_FEW = 30  # seeds; the first that goes red ends a test


@pytest.fixture(scope="module")
def fleet(platoon_of: Callable[..., Config]) -> Config:
    return platoon_of("tracker.source=truth")


def _old_messages_count(patch: Patch) -> None:
    patch.setattr(gate, "VALID_NS", 10 * S)


def _obeying_also(patch: Patch, unless: Callable[[Any, Any, int], bool]) -> None:
    """Let the gate obey fresh commands that it should refuse."""
    take = gate._take_command

    def taken(state: Any, drive: Any, command: Any, now_ns: int) -> Any:
        after = take(state, drive, command, now_ns)
        fresh = command.boot_id == state.boot_id and now_ns < command.nonce + gate.VALID_NS
        if after.refused == state.refused or not fresh or unless(state, command, now_ns):
            return after
        return state._replace(seq=command.seq, command_nonce=command.nonce, wheels=command.wheels, heard_ns=now_ns)

    patch.setattr(gate, "_take_command", taken)


def _any_sequence_number(patch: Patch) -> None:
    _obeying_also(patch, lambda state, command, _: (command.epoch, command.session) != (state.epoch, state.session))


def _any_lease(patch: Patch) -> None:
    _obeying_also(patch, lambda state, command, _: command.seq <= state.seq)


def _refused_feeds_the_watchdog(patch: Patch) -> None:
    take = gate._take_command

    def taken(state: Any, drive: Any, command: Any, now_ns: int) -> Any:
        after = take(state, drive, command, now_ns)
        return after._replace(heard_ns=now_ns, command_nonce=max(after.command_nonce, now_ns - 10 * MS))

    patch.setattr(gate, "_take_command", taken)


def _no_ramp(patch: Patch) -> None:
    follow = gate._follow
    patch.setattr(gate, "_follow", lambda *args: follow(*args)._replace(output=args[1]))


def _slow_ramp(patch: Patch) -> None:
    follow = gate._follow
    patch.setattr(
        gate, "_follow", lambda state, target, acceleration, now: follow(state, target, acceleration / 9, now)
    )


def _no_limit(patch: Patch) -> None:
    take = gate._take_permission
    patch.setattr(gate, "_take_permission", lambda *args: take(*args)._replace(limit=12.5))


def _cleared_by_anything(patch: Patch) -> None:
    take = gate._take_permission
    patch.setattr(gate, "_take_permission", lambda *args: take(*args)._replace(latch=Latch.NONE))


def _latch_ignored(patch: Patch) -> None:
    target = gate._target
    patch.setattr(gate, "_target", lambda state, now_ns: target(state._replace(latch=Latch.NONE), now_ns))


def _lease_for_everybody(patch: Patch) -> None:
    patch.setattr(gate, "LAPSE_NS", 0)


def _nothing_kept(patch: Patch) -> None:
    patch.setattr(MemoryKeeping, "save", lambda *_: None)


def _robot_goes_on(patch: Patch) -> None:
    from drivers.simulated import SimulatedRobot

    write = SimulatedRobot.write
    patch.setattr(SimulatedRobot, "write", lambda robot, wheels: None if wheels == STOP else write(robot, wheels))


def _unseen(*events: Event) -> Callable[[Patch], None]:
    def blind(patch: Patch) -> None:
        watch = monitor.watch

        def watched(*args: Any) -> Any:
            memory, happenings = watch(*args)
            return memory, tuple(h for h in happenings if h.event not in events)

        patch.setattr(monitor, "watch", watched)

    return blind


def _no_cause(patch: Patch) -> None:
    step = supervisor.step

    def silent(status: Any, happening: Any) -> Any:
        after = step(status, happening)
        return after if after.phase is Phase.RUNNING else after._replace(cause=Event.NOTHING)

    patch.setattr(supervisor, "step", silent)


def _no_barrier(patch: Patch) -> None:
    patch.setattr(barrier.Barrier, "filter", lambda self, *args: (0, 0))


def _no_reset(patch: Patch) -> None:
    step = supervisor.step
    patch.setattr(supervisor, "step", lambda s, h: s if h.event is Event.RESET else step(s, h))


@pytest.mark.parametrize(
    ("sabotage", "invariant"),
    [
        (_old_messages_count, "the target is not zero without"),
        (_any_sequence_number, "a refused command"),
        (_any_lease, "a refused command"),
        (_refused_feeds_the_watchdog, "a refused command"),
        (_no_ramp, "a wheel accelerates"),
        (_slow_ramp, "the output was not zero 230 ms"),
        (_no_limit, "a refused enable"),
        (_cleared_by_anything, "a latch was cleared"),
        (_latch_ignored, "the target is not zero without"),
        (_lease_for_everybody, "the lease changed"),
        (_nothing_kept, "the lease changed"),
        (_robot_goes_on, "the robot is not at rest"),
        (_unseen(Event.WIRED_STOP, Event.GATE_LATCHED), "nothing stopped"),
        (_unseen(Event.BATTERY_LOW), "nothing stopped"),
        (_unseen(Event.TAG_LATE, Event.TAG_LOST), "nothing stopped"),
        (_unseen(Event.TAG_TWICE), "nothing stopped"),
        (_unseen(Event.DRIVER_SILENT, Event.DRIVER_RESTARTED), "nothing stopped"),
        (_unseen(Event.CAMERA_STALLED, Event.TRACKER_SILENT, Event.TAG_LATE, Event.TAG_LOST), "nothing stopped"),
        (_no_cause, "without a cause"),
        (_no_barrier, "the body touches"),
        (_no_reset, "it does not run again"),
    ],
)
def test_a_check_that_is_missing_is_found(
    fleet: Config, monkeypatch: Patch, sabotage: Callable[[Patch], None], invariant: str
) -> None:
    sabotage(monkeypatch)
    for seed in range(1, _FEW + 1):
        found = [violation.invariant for violation in play(fleet, seed).violations]
        if any(invariant in name for name in found):
            return
    pytest.fail(f"{_FEW} storms have not found it")
