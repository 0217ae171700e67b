"""Advice to the operator for each cause, shown where a run ends or stands, and for each phase. Pure.

It imports nothing heavy: `robofleet stop` and `status` wait for it.
"""

from robofleet.safety.supervisor import Event, Phase

WAY_OUT: dict[int, str] = {  # by phase
    Phase.IDLE: "nothing runs: start it",
    Phase.ARMED: "the fleet is being armed: start it once the checks are passed, or stop",
    Phase.RUNNING: "the run goes on: hold it, or stop it",
    Phase.POSITIONING: "the robots go to their start: hold them, or stop",
    Phase.PARKING: "the robots are being parked: hold them, or stop",
    Phase.HOLD: "the run is held: resume it, or stop it",
    Phase.FAULT: "the run ended by a fault: mend it, then reset",
    Phase.ESTOP: "the emergency stop is latched: look at the robots, then reset",
}

_SEE_LOG = "its log is in the run's folder"
_BUSY = "end other programs that keep this machine busy"
_ONCE_MORE = "a resume asks it once more"
_MEND = f"mend the behaviour and start again; {_ONCE_MORE}"
_ADVICE = {
    Event.SUPERVISOR_STALLED: _BUSY,
    Event.TICKS_OVERRUN: _BUSY,
    Event.DRIVER_SILENT: _SEE_LOG,
    Event.DRIVER_RESTARTED: _SEE_LOG,
    Event.LINK_LOST: "`robofleet hosts` shows its link; when it is back, `robofleet resume` goes on",
    Event.CONTROLLER_SILENT: _SEE_LOG,
    Event.CONTROLLER_RESTARTED: _SEE_LOG,
    Event.TRACKER_SILENT: _SEE_LOG,
    Event.TRACKER_RESTARTED: _SEE_LOG,
    Event.ESTOP_UNANSWERED: _SEE_LOG,
    Event.OTHER_BUILD: "start every process with one version and one configuration",
    Event.LEASE_LOST: "end the other controller, or start with --takeover",
    Event.DISK_FULL: "make room",
    Event.CAMERA_STALLED: "look at its cable; the tracker's log says more",
    Event.CAMERA_FROZEN: "look at its cable; the tracker's log says more",
    Event.POSES_SILENT: "look at the motion capture's own program and its network; the tracker's log says more",
    Event.CAMERA_OUT: "look at that camera; its tracker's log says more",
    Event.CAMERA_LOST: "plug it in again, mend camera.source, or name a longer recording",
    Event.WIRED_STOP: "release it, then `robofleet run CONFIG --reset`",
    Event.ROBOT_FAULT: "look at the robot; its driver's log says more",
    Event.BUMPED: "free it, then `robofleet run CONFIG --reset`",
    Event.CLIFF: "put it back on the floor, then `robofleet run CONFIG --reset`",
    Event.WHEEL_DROPPED: "put it down, then `robofleet run CONFIG --reset`",
    Event.OVERCURRENT: "free its wheels, then `robofleet run CONFIG --reset`",
    Event.CHARGING: "take it off its charger, then `robofleet run CONFIG --reset`",
    Event.UNREACHABLE: "plug it in, switch it on, then `robofleet run CONFIG --reset`; its driver's log says more",
    Event.RUNAWAY: "switch off its power and repair it, then `robofleet run CONFIG --reset`",
    Event.WHEEL_STALLED: "look at its motors, encoders and their plugs, then `robofleet resume`",
    Event.BATTERY_LOW: "charge it",
    Event.TAG_LOST: "clear the view of it, or put it back; a tag needs light",
    Event.TAG_TWICE: "take one of the two away",
    Event.POSE_JUMPED: "put it back at its start",
    Event.OUTSIDE_ARENA: "put it back",
    Event.TOO_CLOSE: "move them apart",
    Event.FILTER_INFEASIBLE: "move it clear of the others and of the edge",
    Event.DEADLOCKED: "move one of them aside",
    Event.BYSTANDER_LOST: "clear the view of it, or put it back",
    Event.BYSTANDER_MOVED: "see that it stands clear of the path",
    Event.NOT_AT_REST: "let it stand, then start again",
    Event.DID_NOT_MOVE: "switch it on, and compare its tag with robots[].tag",
    Event.WRONG_TAG_MOVED: "exchange their tags, or mend robots[].tag",
    Event.MOVED_UNASKED: "compare the tags with robots[].tag, and which robot each driver reaches; let nobody push one",
    Event.WHEELS_SWAPPED: "exchange its motors' plugs, left for right",
    Event.LEFT_REVERSED: "reverse that motor",
    Event.RIGHT_REVERSED: "reverse that motor",
    Event.BOTH_REVERSED: "turn its tag, or reverse both motors",
    Event.WRONG_ORDER: "exchange the two, or write groups[].robots in the order in which they stand",
    Event.WAYS_CROSS: "put it at its place on the path, behind the robot that it follows",
    Event.ENCODER_WRONG: "look at that encoder",
    Event.UNDER_WAY_TOO_LONG: "see who stands in whose way, move it, then resume",
    Event.BEHAVIOUR_RAISED: f"read it, {_MEND}",
    Event.BEHAVIOUR_NOT_FINITE: _MEND,
    Event.BEHAVIOUR_SHAPE: f"it must be one velocity (x, y) for each robot: {_MEND}",
    Event.BEHAVIOUR_LATE: f"make it faster, or raise controller.tick_s; {_ONCE_MORE}",
    Event.BEHAVIOUR_NO_WAY: "clear a way, then `robofleet resume`",
    Event.SCRIPT_SILENT: "start the script again, then `robofleet resume`",
    Event.SCRIPT_FAILED: "mend it and start it again, then `robofleet resume`",
    Event.HELD_TOO_LONG: "start again",
}


def advised(words: str, cause: int, *, busy: bool = False) -> str:
    """Return an event's words with what to do about it; as they are where they say it, or nothing is to be done.

    ``busy``: the machine's load made it.
    """
    advice = _BUSY if busy else next((advice for event, advice in _ADVICE.items() if event == cause), None)
    return words if advice is None else f"{words}: {advice}"
