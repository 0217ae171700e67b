"""Why a fleet is not ready: said by the launcher and by lockstep when a run does not start."""

from robofleet.bus.keys import TICK
from robofleet.recording.run import Recording
from robofleet.safety.supervisor import Event, RunStatus

_SOMEBODY_MISSING = (Event.CONTROLLER_SILENT, Event.TRACKER_SILENT, Event.DRIVER_SILENT, Event.TAG_LOST)


def why(recording: Recording, status: RunStatus) -> str:
    """Say why a run did not start: the supervisor's cause, and all who are missing where it names one."""
    cause = status.describe(recording.config.ids)
    return f"{cause}; {missing(recording)}" if status.cause in _SOMEBODY_MISSING else cause


def missing(recording: Recording) -> str:
    """Say who is not ready, and what to look at."""
    robots = recording.config.members
    tick = recording.newest(TICK)
    if tick is None:
        return "no tick of the controller came"
    silent = [robot.id for robot in robots if recording.newest_status(robot.id) is None]
    if silent:
        return f"no status of {', '.join(silent)}"
    lost = [f"{robot.id} (tag {robot.tag})" for robot, item in zip(robots, tick.robots, strict=True) if item.lost]
    return f"the tracker does not see {', '.join(lost)}" if lost else "the supervisor did not start the run"
