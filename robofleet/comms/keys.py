"""The table of topics: who says what to whom, how often, how much at most, and with which quality of service."""

from typing import NamedTuple


class Topic(NamedTuple):
    """One row; ``{}`` in the key is a robot, a camera or a process."""

    key: str
    period_s: float  # nominal; 0: on demand
    priority: str  # Zenoh's names
    largest: int  # [bytes] of a message, and of an answer: the router and every receiver drop what is larger
    reliable: bool = False


_FIXED = 256  # [bytes]; the largest fixed layout has 190
_FLEET = 128 * 1024  # [bytes] of a list of robots, of which there can be 587

COMMAND = Topic("robot/{}/cmd", 0.033, "REAL_TIME", _FIXED)
STATUS = Topic("robot/{}/status", 0.020, "DATA_HIGH", _FIXED)
ENABLE = Topic("robot/{}/enable", 0.040, "REAL_TIME", _FIXED)
LEASE = Topic("robot/{}/lease", 0.0, "REAL_TIME", _FIXED, reliable=True)
POSES = Topic("poses/{}", 0.033, "REAL_TIME", _FLEET)
NEWS = Topic("poses/{}/news", 0.0, "DATA_HIGH", _FIXED, reliable=True)
PICTURE = Topic("poses/{}/picture", 1.0, "DATA_LOW", 1_000_000)
TICK = Topic("tick", 0.033, "DATA", _FLEET)
RECORDER = Topic("recorder", 0.250, "DATA_LOW", _FIXED)
STATE = Topic("state", 0.040, "REAL_TIME", _FLEET, reliable=True)
BUSY = Topic("busy", 0.0, "REAL_TIME", _FLEET, reliable=True)
TRUTH = Topic("sim/{}/truth", 0.010, "DATA_LOW", _FIXED)
REQUEST = Topic("request/{}", 0.0, "REAL_TIME", _FLEET, reliable=True)
ALIVE = Topic("alive/{}", 0.0, "DATA", 0, reliable=True)

CAMERA = "overhead"  # the one camera's name, in the key of its poses
LARGEST_MESSAGE = 1 << 20  # [bytes] with all that Zenoh puts around a payload

TOPICS = (COMMAND, STATUS, ENABLE, LEASE, POSES, NEWS, PICTURE, TICK, RECORDER, STATE, BUSY, TRUTH, REQUEST, ALIVE)


def key(arena: str, topic: Topic, name: str = "") -> str:
    """Return the full key of a topic."""
    return f"rf/{arena}/{topic.key.format(name)}"


def driver_role(robot: str) -> str:
    """Return what a process that drives a robot is called among the living."""
    return f"driver-{robot}"


def served_by(topic: Topic, name: str) -> str:
    """Return the process that answers what is asked on a topic, as it is called among the living."""
    return driver_role(name) if topic is LEASE else name


def named(full: str) -> tuple[Topic, str] | None:
    """Return the topic of a full key, and what it is about; None for an expression of many keys."""
    tail = full.split("/", 2)[-1]
    for topic in TOPICS:
        before, _, after = topic.key.partition("{}")
        name = tail[len(before) : len(tail) - len(after)]
        if "*" not in full and tail == before + name + after and ("/" not in name) and ("{}" in topic.key or not name):
            return topic, name
    return None


def largest(expression: str) -> int:
    """Return the most bytes that a message of a key may have, or of any key of an expression of one topic."""
    found = named(expression.replace("*", "any"))
    return LARGEST_MESSAGE if found is None else found[0].largest
