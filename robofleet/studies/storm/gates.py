"""What every gate must keep, judged from what it was given and what it let through.

An independent oracle: it does not call the gate. The rules of acceptance are written here a second time. Each change
of the gate's memory needs a message that allows it, and each target that is not zero needs that memory. So, by
induction from an empty memory, only an authorised controller turned the wheels.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.clock import MS, S
from robofleet.safety.gate import NEVER, GateState, LeaseAction
from robofleet.safety.latches import Latch
from robofleet.studies.storm.ledger import GateDecision, Span, Violation
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP

_VALID_NS = 120 * MS
_TARGET_WITHIN_NS = 130 * MS
_OUTPUT_WITHIN_NS = 230 * MS
_RAMP_NS = _OUTPUT_WITHIN_NS - _TARGET_WITHIN_NS
_LAPSE_NS = 1 * S
_CATCH_UP_NS = 20 * MS  # the longest stretch of a ramp that one step may make good
_LIMIT = 1.01
_BOOT_IDS = 1 << 64  # they have 64 bits
_PASSING = (
    "since_ns", "refused", "output_left", "output_right", "target_left", "target_right", "at_ns", "moved_by",
    "target_after_ns", "output_after_ns", "status", "deadline_ns",
)  # fmt: skip # time moves these
_memory = attrgetter(*(field.name for field in fields(GateState) if field.name not in _PASSING))
_lease = attrgetter("epoch", "session")
_command = attrgetter("seq", "command_nonce", "wheels", "heard_ns")
_enable = attrgetter("enabled_nonce", "enabled_seq", "limit")


class GateAudit:
    """One robot's gate through a storm."""

    def __init__(
        self, robot: str, drive: DifferentialDrive, authorised: Callable[[int], bool], outages: Sequence[Span]
    ) -> None:
        self._robot, self._drive = robot, drive
        self._authorised = authorised  # whether a reset was asked for before an instant of lockstep's clock
        self._outages = outages  # of its driver
        self._held_ns = NEVER  # when it was last asked again after it had not been for too long
        self._found: list[Violation] = []
        self.standing: Array = np.empty((0, 2))  # instant [ns], whether the output is zero
        self.moving: Array = np.empty((0, 2))  # instant [ns], whether the target is not zero

    def violations(self, decisions: Sequence[GateDecision]) -> list[Violation]:
        rows, until_ns, start = [], 0, 0
        before, previous = GateState(boot_id=0), None
        for row, decision in enumerate(decisions):
            true_ns, now_ns, _, state = decision
            if state.boot_id != before.boot_id:
                start = row if previous is None or not _set_back(decision, previous) else start
                before = self._begun(decision, before, previous)
            self._held_up(decision, previous)
            if _memory(state) != _memory(before):
                self._explain(decision, before)
            elif state.refused == before.refused:
                self._counted(decision, before)
            if state.target != STOP:
                self._permitted(decision)
                until_ns = min(state.command_nonce, state.enabled_nonce)
            rows.append((true_ns, now_ns, until_ns, start, *state.output, *state.target))
            before, previous = state, decision
        if rows:
            self._measure(np.array(rows, dtype=np.float64))
        return sorted(self._found, key=lambda violation: violation.at_s)

    def _fail(self, at_ns: float, invariant: str, numbers: object) -> None:
        self._found.append(Violation(invariant, at_ns / S, self._robot, str(numbers)))

    def _held_up(self, decision: GateDecision, previous: GateDecision | None) -> None:
        """A gate that let its wheels turn and was not asked for 120 ms gives nothing, and takes nothing of before."""
        if previous is None or previous.state.boot_id != decision.state.boot_id:
            self._held_ns = NEVER
            return
        moved = not previous.state.output == STOP == previous.state.target
        if moved and decision.now_ns - previous.now_ns > _VALID_NS:
            self._held_ns = decision.now_ns
            if decision.state.output != STOP:
                self._fail(decision.true_ns, "a gate that was held up goes on", decision.state.output)

    # What the gate remembers

    def _begun(self, decision: GateDecision, before: GateState, previous: GateDecision | None) -> GateState:
        """Return what a gate with a new boot id may know: its lease's epoch and its latch."""
        state = decision.state
        if previous is not None and _set_back(decision, previous):  # it must forget
            return replace(
                before, boot_id=state.boot_id, heard_ns=state.heard_ns,
                command_nonce=NEVER, enabled_nonce=NEVER, enabled_seq=0,
            )  # fmt: skip
        if state.latch == Latch.MEMORY_LOST != before.latch:
            return GateState(boot_id=state.boot_id, epoch=state.epoch, latch=state.latch, latch_id=state.latch_id)
        latch = Latch.NONE if before.latch == Latch.DRILL else before.latch
        return GateState(boot_id=state.boot_id, epoch=before.epoch, latch=latch, latch_id=before.latch_id)

    def _explain(self, decision: GateDecision, before: GateState) -> None:
        """Find what allowed each change."""
        state = decision.state
        granted = state.session != 0 and _lease(state) != _lease(before)
        if _lease(state) != _lease(before):
            self._lease(decision, before)
        if (state.latch, state.latch_id) != (before.latch, before.latch_id):
            self._latch(decision, before)
        if _enable(state) != (before.enabled_nonce, before.enabled_seq, 0.0 if granted else before.limit):
            self._enable(decision, before)
        forgotten = (0, NEVER, before.wheels, decision.now_ns) if granted else _command(before)
        if _command(state) != forgotten:
            self._command(decision, forgotten[0])

    def _lease(self, decision: GateDecision, before: GateState) -> None:
        _, now_ns, inputs, state = decision
        session, action = (inputs.lease_session, inputs.lease_action) if inputs.lease else (0, LeaseAction.RELEASE)
        if state.session == 0:
            allowed = action == LeaseAction.RELEASE and session == before.session and state.epoch == before.epoch
        else:
            free = before.session == 0 or now_ns - before.heard_ns >= _LAPSE_NS or action == LeaseAction.TAKE_OVER
            rest = before.output == STOP and not inputs.turning
            allowed = free and rest and state.session == session and state.epoch == before.epoch + 1
            allowed = allowed and action != LeaseAction.RELEASE
        if not allowed:
            change = f"{_lease(before)} to {_lease(state)} by {(session, action)}, output {before.output}"
            self._fail(decision.true_ns, "the lease changed without a right", change)

    def _latch(self, decision: GateDecision, before: GateState) -> None:
        true_ns, _, inputs, state = decision
        permitted = self._valid_permission(decision, before)
        change = f"{Latch(before.latch).name} {before.latch_id} to {Latch(state.latch).name} {state.latch_id}"
        if state.latch > before.latch or state.latch_id > before.latch_id:
            latch = max(inputs.latch, inputs.permission_latch if permitted else Latch.NONE)
            if state.latch != latch:
                self._fail(true_ns, "a latch that nobody asked for", change)
            return
        rest = before.output == STOP and not inputs.turning and not inputs.latch
        if not permitted or inputs.permission_clear != before.latch_id or not rest:
            self._fail(true_ns, "a latch was cleared without an authorised reset at rest", f"{change} by {inputs}")
        elif before.latch != Latch.DRILL and not self._authorised(true_ns):
            self._fail(true_ns, "a latch was cleared and nobody had asked for a reset", change)

    def _enable(self, decision: GateDecision, before: GateState) -> None:
        i, state = decision.inputs, decision.state
        allowed = {0.0} if i.permission_latch else {0.0, i.permission_limit}
        newest = (state.enabled_nonce, state.enabled_seq) == (i.permission_nonce, i.permission_seq)
        if not (self._valid_permission(decision, before) and newest and state.limit in allowed):
            change = f"{_enable(before)} to {_enable(state)} by {i}"
            self._fail(decision.true_ns, "a refused enable changed more than a counter", change)

    def _command(self, decision: GateDecision, last_seq: int) -> None:
        _, now_ns, i, state = decision
        allowed = i.command_seq, i.command_nonce, (i.command_left, i.command_right), now_ns
        if not i.command or not self._obeyed(decision, last_seq) or _command(state) != allowed:
            change = f"to {_command(state)} by {i}, epoch {state.epoch}, last {last_seq}, at {now_ns}"
            self._fail(decision.true_ns, "a refused command changed more than a counter", change)

    def _counted(self, decision: GateDecision, before: GateState) -> None:
        """Nothing changed: whatever came was refused, and is counted."""
        inputs = decision.inputs
        if inputs.command or inputs.permission:
            self._fail(decision.true_ns, "a refused message was not counted", inputs)

    # The rules of acceptance

    def _valid_permission(self, decision: GateDecision, before: GateState) -> bool:
        i = decision.inputs
        return (
            i.permission
            and self._fresh(i.permission_boot_id, i.permission_nonce, decision)
            and (i.permission_nonce, i.permission_seq) > (before.enabled_nonce, before.enabled_seq)
            and (i.permission_epoch == before.epoch or bool(i.permission_latch))
        )

    def _obeyed(self, decision: GateDecision, last_seq: int) -> bool:
        i, state, drive = decision.inputs, decision.state, self._drive
        left, right = i.command_left, i.command_right
        return (
            self._fresh(i.command_boot_id, i.command_nonce, decision)
            and (i.command_epoch, i.command_session) == (state.epoch, state.session)
            and state.session != 0
            and i.command_seq > last_seq
            and max(abs(left), abs(right)) <= _LIMIT * drive.max_wheel_speed
            and drive.wheel_radius * abs(left + right) / 2.0 <= _LIMIT * drive.max_speed
        )

    def _fresh(self, boot_id: int, nonce: int, decision: GateDecision) -> bool:
        """Whether a message echoes this start of the driver, not long ago, and since the gate was held up."""
        age_ns = decision.now_ns - nonce
        known = boot_id == decision.state.boot_id and nonce >= max(0, self._held_ns)
        return known and 0 <= age_ns < _VALID_NS

    # What reaches the wheels

    def _permitted(self, decision: GateDecision) -> None:
        """A target that is not zero needs a lease, a valid command, a valid enable and no latch."""
        _, now_ns, _, state = decision
        left, right = state.target
        limit = min(state.limit, self._drive.max_wheel_speed)
        if not (
            state.session
            and state.latch == Latch.NONE
            and 0 <= state.command_nonce <= now_ns < state.command_nonce + _VALID_NS
            and 0 <= state.enabled_nonce <= now_ns < state.enabled_nonce + _VALID_NS
            and state.target == state.wheels
            and max(abs(left), abs(right)) <= _LIMIT * limit
        ):
            self._fail(decision.true_ns, "the target is not zero without lease, command, enable or limit", decision[1:])

    def _measure(self, rows: Array) -> None:
        """Speeds, accelerations and times, all at once."""
        true_ns, now_ns, nonce_ns, start = rows[:, :4].T
        output, target = rows[:, 4:6], rows[:, 6:8]
        drive = self._drive
        for speed, limit in (
            (abs(output).max(axis=1), drive.max_wheel_speed),
            (abs(output.sum(axis=1)) * drive.wheel_radius / 2.0, drive.max_speed),
        ):
            self._report("a wheel is faster than it may be", true_ns, speed > _LIMIT * limit, speed)
        same = start[1:] == start[:-1]
        elapsed_ns = np.maximum(np.diff(true_ns), np.clip(np.diff(now_ns), 0, _CATCH_UP_NS))
        change = abs(np.diff(output, axis=0)).max(axis=1)
        fast = change > drive.max_wheel_acceleration * elapsed_ns / S + 1e-9
        standing = np.asarray(~output.any(axis=1))
        held_up = standing[1:] & (np.diff(now_ns) > _VALID_NS)
        self._report(
            "a wheel accelerates more than it may",
            true_ns[1:], fast & same & ~held_up, change * S / np.maximum(elapsed_ns, 1.0),
        )  # fmt: skip
        closed = np.asarray(~target.any(axis=1))
        self.standing, self.moving = np.column_stack([true_ns, standing]), np.column_stack([true_ns, ~closed])
        rising = (abs(output[1:]) > abs(output[:-1]) + 1e-12) | (output[1:] * output[:-1] < 0)
        self._report(
            "the output rose or reversed while the target was zero",
            true_ns[1:], rising.any(axis=1) & closed[1:] & same, output[1:, 0],
        )  # fmt: skip
        steady = same & ~self._out(true_ns) & (np.diff(now_ns) >= 0)
        age_ns = now_ns[1:] - nonce_ns[:-1]
        late = ~closed[:-1] & (age_ns > _TARGET_WITHIN_NS) & steady
        self._report("the target was not zero 130 ms after the newest nonce", true_ns[1:], late, age_ns / MS)
        late = ~standing[:-1] & closed[:-1] & (age_ns > _OUTPUT_WITHIN_NS) & steady
        self._report("the output was not zero 230 ms after the newest nonce", true_ns[1:], late, age_ns / MS)

    def _out(self, true_ns: Array) -> NDArray[np.bool_]:
        """Return between which rows the driver itself did not run, or had its clock changed."""
        out = np.zeros(len(true_ns) - 1, dtype=np.bool_)
        for outage in self._outages:  # its ramp to zero comes late, too
            out |= (true_ns[:-1] <= outage.end_ns + _RAMP_NS) & (true_ns[1:] >= outage.start_ns)
        return out

    def _report(self, invariant: str, at_ns: Array, wrong: NDArray[np.bool_], figure: Array) -> None:
        for row in np.flatnonzero(wrong)[:3]:
            self._fail(at_ns[row], invariant, f"{figure[row]:.6g}")


def _set_back(decision: GateDecision, previous: GateDecision) -> bool:
    """Return whether a gate with a new boot id had its clock set back: a restart draws another number."""
    return decision.state.boot_id == (previous.state.boot_id + 1) % _BOOT_IDS


def intervals(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Return first and last index of every run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    yield from zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
