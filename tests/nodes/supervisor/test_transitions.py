"""One table through the supervisor: where a run is, what comes, where it is then, and by what cause.

In every row wheels are permitted only while the run moves, and an emergency stop latches every gate.
"""

from collections.abc import Callable, Iterable
from math import nan
from struct import pack
from typing import NamedTuple

import pytest

from robofleet.bus.keys import CAMERA, ENABLE, NEWS, REQUEST, SAFE_REQUEST, STATUS, TICK, Topic
from robofleet.bus.messages import TRACKER_NEWS, RobotTick, TickRecord, TrackerNews
from robofleet.core.clock import MS, S
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Phase
from robofleet.tracking.events import TrackerEvent
from robofleet.vehicles.interface import WIRED_STOP, RobotFault
from tests.nodes.stand import ROBOTS, Stand

Step = Callable[[Stand], object]
IDLE, ARMED, RUNNING, HOLD, FAULT, ESTOP = (
    Phase.IDLE, Phase.ARMED, Phase.RUNNING, Phase.HOLD, Phase.FAULT, Phase.ESTOP,
)  # fmt: skip


def run(ms: int) -> Step:
    return lambda stand: stand.run(ms * MS)


def ask(*requests: str) -> Step:
    """Ask for what is granted, also for what was met already."""

    def step(stand: Stand) -> None:
        for request in requests:
            assert stand.ask(request, 200 * MS) == "ok"

    return step


def refused(request: str, why: str) -> Step:
    def step(stand: Stand) -> None:
        answer = stand.ask(request)
        assert answer.startswith("refused: ")
        assert why in answer

    return step


def together(*requests: tuple[Topic, bytes]) -> Step:
    """Ask for several things before the supervisor looks."""

    def step(stand: Stand) -> None:
        for topic, request in requests:
            stand.bench.bus.ask(topic, "supervisor", request)

    return step


def silent(*names: str) -> Step:
    return lambda stand: stand.silent.update(names)


def heard(stand: Stand) -> None:
    stand.silent.clear()


def hidden(robot: str) -> Step:
    return lambda stand: stand.hidden.add(robot)


def shown(stand: Stand) -> None:
    stand.hidden.clear()


def says(robot: str, **fields: float) -> Step:
    return lambda stand: setattr(stand.robots[robot], "says", fields)


def gate(robot: str, **fields: object) -> Step:
    return lambda stand: [setattr(stand.robots[robot], name, value) for name, value in fields.items()]


def free(size: int) -> Step:
    return lambda stand: setattr(stand, "free_bytes", size)


def news(event: int, robot: str | None = None) -> Step:
    return lambda stand: stand.tell(event, robot, 0.5)


def malformed_news(stand: Stand) -> None:
    news = TRACKER_NEWS.encode(TrackerNews(1, 1, 0, TrackerEvent.CAMERA_MOVED, 0, 0.0))[:-8] + pack("<d", nan)
    stand.bench.bus.publisher(NEWS, CAMERA)(news)


def tick(robot: dict[str, float], **changes: int) -> Step:
    def step(stand: Stand) -> None:
        stand.tell_tick(robot, **changes)
        stand.node.step(stand.bench.now_ns)

    return step


def fleet_of_another_size(stand: Stand) -> None:
    record = TickRecord(3, 1, 10**6, -1, 0, *[0] * 6, 200, 0, 0, 0, 0, (RobotTick(*[0.0] * 15),) * 9, ())
    stand.bench.say(TICK, record)
    stand.node.step(stand.bench.now_ns)


def other_controller(stand: Stand) -> None:
    stand.epoch, stand.tick = 8, 0


def overtaken_status(stand: Stand) -> None:
    old = stand.robots["r1"].status(stand.bench.now_ns - 30 * MS, stand.build)
    stand.bench.say(STATUS, old._replace(latch=Latch.EMERGENCY_STOP), "r1")
    stand.node.step(stand.bench.now_ns)


def clock_anew(stand: Stand) -> None:
    stand.robots["r1"].boot_id, stand.robots["r1"].clock_ns = 4711, stand.bench.now_ns


def idle(stand: Stand) -> None:
    stand.run(S // 5)
    assert stand.state.phase == IDLE


def unseen(stand: Stand) -> None:
    hidden("r1")(stand)
    idle(stand)


def waiting(stand: Stand) -> None:
    unseen(stand)
    ask("start")(stand)
    stand.run(3 * S)


def held(stand: Stand) -> None:
    stand.running()
    ask("hold")(stand)


def faulty(stand: Stand) -> None:
    stand.running()
    other_controller(stand)
    stand.run(100 * MS)
    assert stand.state.phase == FAULT


def stopped(stand: Stand) -> None:
    stand.running()
    ask("estop")(stand)


def without(name: str) -> Step:
    """Let one never be heard."""

    def begin(stand: Stand) -> None:
        silent(name)(stand)
        stand.run(S)

    return begin


class Row(NamedTuple):
    """``begin``: a fleet in its first state."""

    begin: Step
    steps: Iterable[Step]
    phase: Phase
    event: Event
    robot: int = NOBODY
    attended: bool = False


running, armed = Stand.running, Stand.armed
STALLED = {"left_angle_rad": 1.0, "left_output_rad_s": 12.5}  # a wheel stands, though it is told to turn
BEGINNINGS = {"idle": idle, "armed": armed, "running": running, "held": held, "faulty": faulty}
MISSING = {
    "r1": Event.DRIVER_SILENT, "r4": Event.DRIVER_SILENT, "controller": Event.CONTROLLER_SILENT,
    "tracker": Event.TRACKER_SILENT,
}  # fmt: skip
NEWS_ENDS = {
    TrackerEvent.CAMERA_STALLED: (HOLD, Event.CAMERA_STALLED), TrackerEvent.CAMERA_FROZEN: (HOLD, Event.CAMERA_FROZEN),
    TrackerEvent.CAMERA_UNPLUGGED: (FAULT, Event.CAMERA_LOST), TrackerEvent.CAMERA_RESIZED: (FAULT, Event.CAMERA_LOST),
    TrackerEvent.CAMERA_STRANGE: (FAULT, Event.CAMERA_LOST), TrackerEvent.CAMERA_ENDED: (FAULT, Event.CAMERA_LOST),
    TrackerEvent.CAMERA_MOVED: (FAULT, Event.CAMERA_MOVED), TrackerEvent.POSES_SILENT: (HOLD, Event.POSES_SILENT),
}  # fmt: skip
ROBOT_NEWS_ENDS = {
    TrackerEvent.TAG_TWICE: (HOLD, Event.TAG_TWICE), TrackerEvent.TAG_JUMPED: (FAULT, Event.POSE_JUMPED),
    TrackerEvent.TAG_CARRIED: (FAULT, Event.POSE_JUMPED),
}  # fmt: skip
HARMLESS_NEWS = [
    (TrackerEvent.BODY_LOST, "r2"), (TrackerEvent.TAG_FOUND, "r2"), (TrackerEvent.CAMERA_CORRECTED, None),
    (TrackerEvent.PRINT_STRETCHED, "r2"), (TrackerEvent.TAG_HEIGHT, "r2"),
    (TrackerEvent.TAG_TWICE, None), (250, "r2"),  # nobody's tag, and an event of another version
]  # fmt: skip
ORDERS = (b"reset", b"resume", b"start")

ROWS = {
    # what an operator asks for
    "nothing": Row(idle, [run(1000)], IDLE, Event.NOTHING),
    "start": Row(idle, [ask("start", "start"), run(1000)], RUNNING, Event.PROVED),
    "start of an armed fleet": Row(armed, [ask("start")], RUNNING, Event.PROVED),
    "stop": Row(running, [ask("stop", "stop")], IDLE, Event.STOP_REQUESTED),
    "hold": Row(running, [ask("hold", "hold"), run(1000)], HOLD, Event.HOLD_REQUESTED),
    "resume": Row(held, [ask("resume", "resume")], RUNNING, Event.RESUME_REQUESTED),
    "estop": Row(running, [ask("estop", "estop"), run(1000)], ESTOP, Event.ESTOP_REQUESTED),
    "reset, and start": Row(stopped, [ask("reset"), run(1000), running], RUNNING, Event.PROVED),
    "reset of what is clear": Row(idle, [ask("reset")], IDLE, Event.NOTHING),
    # what it is refused, with the way out
    "hold what is idle": Row(idle, [refused("hold", "start it")], IDLE, Event.NOTHING),
    "resume what is idle": Row(idle, [refused("resume", "start it")], IDLE, Event.NOTHING),
    "no request": Row(running, [refused("resume and go", "not one of")], RUNNING, Event.PROVED),
    "start what is held": Row(held, [refused("start", "resume it")], HOLD, Event.HOLD_REQUESTED),
    "reset what runs": Row(running, [refused("reset", "stop it")], RUNNING, Event.PROVED),
    "reset what is held": Row(held, [refused("reset", "stop it")], HOLD, Event.HOLD_REQUESTED),
    "arm what runs": Row(running, [refused("arm", "hold it")], RUNNING, Event.PROVED),
    "arm what is held": Row(held, [refused("arm", "resume it")], HOLD, Event.HOLD_REQUESTED),
    **{f"{what} after a stop": Row(stopped, [refused(what, "reset")], ESTOP, Event.ESTOP_REQUESTED)
       for what in ("start", "stop", "resume")},
    # a supervisor that stood still finds several requests: no order of before undoes a stop
    **{f"{order.decode()}, and a stop {when}": Row(running, [together(*requests), run(1000)], ESTOP,
                                                   Event.ESTOP_REQUESTED)
       for order in ORDERS
       for when, requests in {
           "after it": ((REQUEST, order), (SAFE_REQUEST, b"estop")),
           "before it": ((SAFE_REQUEST, b"estop"), (REQUEST, order)),
           "of an operator": ((REQUEST, b"estop"), (REQUEST, order), (REQUEST, b"hold")),
       }.items()},
    # a fleet that is not whole
    **{f"start without {who}": Row(without(who), [ask("start"), run(1000)], ARMED, Event.START_REQUESTED)
       for who in MISSING},
    **{f"start, and then {who}": Row(without(who), [ask("start"), run(1000), heard, run(200)], RUNNING, Event.PROVED)
       for who in MISSING},
    **{f"{who} silent while armed": Row(armed, [silent(who), run(1000), refused("start", "")], FAULT, event,
                                        ROBOTS.index(who) if who in ROBOTS else NOBODY)
       for who, event in MISSING.items()},
    **{f"{who} silent": Row(running, [silent(who), run(580)], HOLD if who == "tracker" else FAULT, event,
                            ROBOTS.index(who) if who in ROBOTS else NOBODY) for who, event in MISSING.items()},
    "start without a tag": Row(armed, [
        hidden("r3"), run(500), refused("start", "r3: the tracker lost the robot: mend it, then start, or stop"),
        shown, run(200), ask("start")], RUNNING, Event.PROVED),
    "start of a latched robot": Row(idle, [
        gate("r2", latch=Latch.EMERGENCY_STOP, latch_id=8), run(200), refused("start", "r2: "), ask("reset"), running],
        RUNNING, Event.PROVED),
    # what holds or ends it, and how it goes on
    "the first cause stays": Row(running, [
        silent("r2"), run(1000), silent("r1", "controller"), run(1000), heard, refused("start", "reset"), run(1000)],
        FAULT, Event.DRIVER_SILENT, 1),
    "a fault is reset": Row(faulty, [ask("reset"), running], RUNNING, Event.PROVED),
    "resume into silence": Row(running, [
        silent("tracker"), run(500), refused("resume", "the tracker went silent")], HOLD, Event.TRACKER_SILENT),
    "resume after silence": Row(running, [
        silent("tracker"), run(500), heard, run(200), ask("resume")], RUNNING, Event.RESUME_REQUESTED),
    "resume with a lost tag": Row(held, [
        hidden("r1"), run(3000), refused("resume", "r1: the tracker lost the robot")], HOLD, Event.HOLD_REQUESTED),
    "a lost tag": Row(running, [hidden("r4"), run(2100)], FAULT, Event.TAG_LOST, 3),
    "a full disk": Row(running, [
        free(0), run(40), refused("resume", "the disk is full: mend it, then resume, or stop")], HOLD, Event.DISK_FULL),
    "room on the disk": Row(running, [free(0), run(40), free(1 << 40), run(40), ask("resume")], RUNNING,
                            Event.RESUME_REQUESTED),
    "a stalled wheel": Row(running, [says("r2", **STALLED), run(1100)], HOLD, Event.WHEEL_STALLED, 1),
    "a wheel that stalls again": Row(running, [
        says("r2", **STALLED), run(1100), says("r2", left_angle_rad=1.0), run(100), ask("resume"),
        says("r2", **STALLED), run(1100)], HOLD, Event.WHEEL_STALLED, 1),
    "a fleet of another size": Row(running, [fleet_of_another_size], FAULT, Event.OTHER_BUILD),
    "another version's numbers": Row(running, [says("r1", boot_id=4711, latch=99, gate=77), run(100)], FAULT,
                                     Event.DRIVER_RESTARTED, 0),
    "a driver's clock begins anew": Row(running, [clock_anew, run(100)], FAULT, Event.DRIVER_RESTARTED, 0),
    # what was overtaken says nothing
    "an old status": Row(running, [overtaken_status], RUNNING, Event.PROVED),
    "an old tick": Row(running, [tick({"blocked": 1.0}, tick=1)], RUNNING, Event.PROVED),
    # the tracker's news
    **{event.name: Row(running, [news(event), run(40)], *to) for event, to in NEWS_ENDS.items()},
    **{f"{event.name} of r2": Row(running, [news(event, "r2"), run(40)], *to, 1)
       for event, to in ROBOT_NEWS_ENDS.items()},
    **{f"{event}, {robot}: harmless": Row(running, [news(event, robot), run(40)], RUNNING, Event.PROVED)
       for event, robot in HARMLESS_NEWS},
    "news behind news": Row(running, [
        news(TrackerEvent.CAMERA_MOVED), news(TrackerEvent.CAMERA_CORRECTED), run(40)], FAULT, Event.CAMERA_MOVED),
    "malformed news": Row(running, [malformed_news, run(40)], RUNNING, Event.PROVED),
    # emergencies, and the way out of them
    **{f"{phase}: a robot's own e-stop": Row(begin, [says("r2", faults=WIRED_STOP), run(100)], ESTOP,
                                             Event.WIRED_STOP, 1) for phase, begin in BEGINNINGS.items()},
    "reset while an e-stop is pressed": Row(stopped, [
        says("r3", faults=WIRED_STOP), run(100), refused("reset", "r3: its own e-stop is pressed"), run(1000),
        says("r3"), run(100), ask("reset")], IDLE, Event.RESET),
    "reset of a robot that is unplugged": Row(stopped, [
        says("r3", faults=RobotFault.UNREACHABLE, left_rad_s=3.0), run(100), refused("reset", "lost the connection")],
        ESTOP, Event.ESTOP_REQUESTED),
    "reset without a robot that is gone": Row(running, [
        silent("r3"), gate("r3", deaf=True), ask("estop"), refused("reset", "r3 has not acknowledged"), run(400),
        ask("reset")], IDLE, Event.RESET),
    **{f"{phase}: the operator is gone": Row(begin, [run(3000), silent("operator"), run(1100)], ESTOP,
                                             Event.OPERATOR_LOST, attended=True)
       for phase, begin in {"waiting": waiting, "armed": armed, "running": running, "held": held}.items()},
    "who asks for a start has a second to be there": Row(unseen, [
        silent("operator"), run(3000), ask("start"), run(700)], ARMED, Event.START_REQUESTED, attended=True),
    "who asks for a start and stays away": Row(unseen, [
        silent("operator"), run(3000), ask("start"), run(900)], ESTOP, Event.OPERATOR_LOST, attended=True),
    "nobody attends": Row(running, [silent("operator"), run(3000)], RUNNING, Event.PROVED),
}  # fmt: skip


@pytest.mark.slow_after_first
@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_a_run_goes_where_the_table_says(row: Row, stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(attended=row.attended)
    row.begin(stand)
    for step in row.steps:
        step(stand)
    assert stand.cause == (row.phase, row.event, row.robot)
    fastest = [robot.vehicle.max_wheel_speed_rad_s for robot in stand.bench.config.members]
    limits = [enables[-1].limit_rad_s for robot in ROBOTS if (enables := stand.bench.heard(ENABLE, robot))]
    assert limits == (fastest if row.phase in MOVING else [0.0] * len(limits))
    assert [robot.permitted for robot in stand.state.robots] == [int(row.phase in MOVING)] * 4
    if row.phase is ESTOP:
        stand.run(100 * MS)
        assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}
