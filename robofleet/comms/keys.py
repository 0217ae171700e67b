"""The table of topics: who says what to whom, how often, and with which quality of service."""

from typing import NamedTuple


class Topic(NamedTuple):
    """One row; ``{}`` in the key is a robot, a camera or a process."""

    key: str
    period_s: float  # nominal; 0: on demand
    priority: str  # Zenoh's names
    reliable: bool = False


COMMAND = Topic("robot/{}/cmd", 0.033, "REAL_TIME")
STATUS = Topic("robot/{}/status", 0.020, "DATA_HIGH")
ENABLE = Topic("robot/{}/enable", 0.040, "REAL_TIME")
LEASE = Topic("robot/{}/lease", 0.0, "REAL_TIME", reliable=True)
POSES = Topic("poses/{}", 0.033, "REAL_TIME")
NEWS = Topic("poses/{}/news", 0.0, "DATA_HIGH", reliable=True)
PICTURE = Topic("poses/{}/picture", 1.0, "DATA_LOW")
TICK = Topic("tick", 0.033, "DATA")
RECORDER = Topic("recorder", 0.250, "DATA_LOW")
STATE = Topic("state", 0.040, "REAL_TIME", reliable=True)
TRUTH = Topic("sim/{}/truth", 0.010, "DATA_LOW")
REQUEST = Topic("request/{}", 0.0, "REAL_TIME", reliable=True)
ALIVE = Topic("alive/{}", 0.0, "DATA", reliable=True)

CAMERA = "overhead"  # the one camera's name, in the key of its poses

TOPICS = (COMMAND, STATUS, ENABLE, LEASE, POSES, NEWS, PICTURE, TICK, RECORDER, STATE, TRUTH, REQUEST, ALIVE)


def key(arena: str, topic: Topic, name: str = "") -> str:
    """Return the full key of a topic."""
    return f"rf/{arena}/{topic.key.format(name)}"


def everything(arena: str) -> str:
    """Return the key expression of all that is said in an arena."""
    return f"rf/{arena}/**"


def named(full: str) -> tuple[Topic, str] | None:
    """Return the topic of a full key, and what it is about; None for an expression of many keys."""
    tail = full.split("/", 2)[-1]
    for topic in TOPICS:
        before, _, after = topic.key.partition("{}")
        name = tail[len(before) : len(tail) - len(after)]
        if "*" not in full and tail == before + name + after and ("/" not in name) and ("{}" in topic.key or not name):
            return topic, name
    return None
