"""The table of topics: who says what to whom, how often, how much at most, and with which quality of service."""

import re
from functools import lru_cache
from typing import Any, NamedTuple

from robofleet.bus import messages
from robofleet.bus.layouts import Layout, ListLayout
from robofleet.core.patterns import OVERHEAD, TRACKER, driver_role, tracker_role

AnyLayout = Layout[Any] | ListLayout[Any]


class Topic(NamedTuple):
    """One row; ``{}`` in the key is a unit, a camera or a process. A *unit* is one driver process and its robots."""

    key: str
    sender: str  # role, or roles; a query's: who asks
    receivers: str  # roles; a query's: who answers. ``permissions.py`` reads both
    period_s: float  # nominal; 0: on demand
    priority: str  # Zenoh's names
    largest: int  # [bytes] of a message, and of an answer: the router and every receiver drop what is larger
    layout: AnyLayout | None  # None: text, or nothing
    reliable: bool = False
    by_sender: bool = False  # each sender has a key of its own below this one: ``sender_key``


_FIXED = 256  # [bytes]; the largest fixed layout has 32
_FLEET = 128 * 1024  # [bytes] of a list of robots, of which there can be 2048
_LONG = 512 * 1024  # [bytes] of one that says more of each: 142 bytes in a status, 120 and the figures in a tick

COMMAND = Topic("unit/{}/cmd", "controller", "unit", 0.033, "REAL_TIME", _FLEET, messages.UNIT_COMMAND)
STATUS = Topic("unit/{}/status", "unit", "all", 0.020, "DATA_HIGH", _LONG, messages.UNIT_STATUS)
ENABLE = Topic("unit/{}/enable", "supervisor", "unit", 0.040, "REAL_TIME", _FLEET, messages.UNIT_ENABLE)
LEASE = Topic("unit/{}/lease", "controller", "unit", 0.0, "REAL_TIME", _FLEET, messages.LEASE_REQUEST, reliable=True)
POSES = Topic("poses/{}", "tracker", "controller viewers script", 0.033, "REAL_TIME", _LONG, messages.FLEET_POSES)
# The controller tells which of several cameras it does not believe.
NEWS = Topic(
    "poses/{}/news", "tracker controller", "all", 0.0, "DATA_HIGH", _FIXED, messages.TRACKER_NEWS, reliable=True
)
PICTURE = Topic("poses/{}/picture", "tracker", "viewers script", 1.0, "DATA_LOW", 1_000_000, messages.PICTURE)
TICK = Topic("tick", "controller", "all", 0.033, "DATA", _LONG, messages.TICK_RECORD)
RECORDER = Topic("recorder", "recorder", "supervisor", 0.250, "DATA_LOW", _FIXED, messages.RECORDER_STATUS)
STATE = Topic("state", "supervisor", "all", 0.040, "REAL_TIME", _FLEET, messages.RUN_STATE, reliable=True)
BUSY = Topic("busy", "supervisor", "all", 0.0, "REAL_TIME", _FLEET, messages.BUSY_MACHINE, reliable=True)
# A program's setpoints, and a person's: no certificate of a program permits what a person may command.
WISH = Topic("group/{}/wish", "script", "controller", 0.033, "DATA_HIGH", _FLEET, messages.SCRIPT_WISH, by_sender=True)
TELEOP = Topic(
    "group/{}/teleop", "operator", "controller supervisor", 0.020, "DATA_HIGH", _FLEET, messages.SCRIPT_WISH,
    by_sender=True,
)  # fmt: skip
NOTE = Topic("group/{}/note", "script", "viewers tracker", 0.0, "DATA_LOW", _FLEET, messages.NOTE, reliable=True)
SHOWING = Topic("showing", "web", "web tracker", 0.0, "DATA_LOW", _FIXED, None, reliable=True)
TRUTH = Topic("sim/{}/truth", "unit", "tracker", 0.020, "DATA_LOW", _FLEET, messages.UNIT_TRUTH)
SENSORS = Topic("unit/{}/sensors", "unit", "all", 0.033, "DATA", _LONG, messages.UNIT_SENSORS)
CONFIG = Topic("unit/{}/config", "supervisor", "unit", 0.0, "DATA", _LONG, messages.HANDED, reliable=True)
HOST = Topic("unit/{}/host", "operator viewer", "unit", 0.0, "DATA_LOW", 1024, None, reliable=True)
REQUEST = Topic("request/{}", "operator", "process", 0.0, "REAL_TIME", _FLEET, None, reliable=True)
# What makes nothing move: who may only look may ask for it too, and operators ask for it by the topic above.
SAFE_REQUEST = Topic(
    "request/{}/safe", "operator viewer script", "process", 0.0, "REAL_TIME", _FIXED, None, reliable=True
)
ALIVE = Topic("alive/{}", "process", "all", 0.0, "DATA", 0, None, reliable=True)

ESTOP = b"estop"  # a request; every process that serves requests keeps places for this one
CAMERA = OVERHEAD  # in the key of the poses of a camera that has no other name
LARGEST_MESSAGE = 1 << 20  # [bytes] with all that Zenoh puts around a payload

TOPICS = (
    COMMAND, STATUS, ENABLE, LEASE, CONFIG, HOST, POSES, NEWS, PICTURE, TICK, RECORDER, STATE, BUSY, TRUTH, SENSORS,
    WISH, TELEOP, NOTE, SHOWING, REQUEST, SAFE_REQUEST, ALIVE,
)  # fmt: skip
QUERIES = LEASE, CONFIG, HOST, REQUEST, SAFE_REQUEST  # queries, which somebody answers
OF_UNITS = COMMAND, STATUS, ENABLE, LEASE, TRUTH  # that a recording has of each unit; of some it has SENSORS


_PATTERNS = [
    (
        topic,
        re.compile(
            re.escape(topic.key).replace(r"\{\}", "(?P<name>[^/*]+)")
            + ("" if "{}" in topic.key else "(?P<name>)")
            + ("(?:/(?P<sender>[^/*]+/[^/*]+/[^/*]+))?" if topic.by_sender else "(?P<sender>)")
        ),
    )
    for topic in TOPICS
]


def key(arena: str, topic: Topic, name: str = "") -> str:
    """Return the full key of a topic."""
    return f"rf/{arena}/{topic.key.format(name)}"


def sender_key(arena: str, topic: Topic, name: str, sender: str) -> str:
    """Return the key on which one sender publishes.

    ``sender``: role, name and session, divided by slashes. The router lets nobody publish under another role or name.
    """
    return f"{key(arena, topic, name)}/{sender}"


def every_key(arena: str, topic: Topic, name: str = "") -> str:
    """Return the expression by which a topic is heard of all its senders."""
    return sender_key(arena, topic, name, "*/*/*") if topic.by_sender else key(arena, topic, name)


def of_every_sender(full: str) -> str:
    """Return the expression by which a key is heard of all its senders; another expression as it is."""
    found = named(full)
    return f"{full}/*/*/*" if found is not None and found[0].by_sender else full


@lru_cache(4096)
def split(full: str) -> tuple[str, str]:
    """Return the key of a topic without the sender, and the sender; empty where the topic has one key for all."""
    found = _matched(full)
    sender = "" if found is None else found[2]
    return full.removesuffix(f"/{sender}"), sender


def said_by(topic: Topic, name: str) -> tuple[str, ...]:
    """Return the names that the process may have which says what is said on a topic; the first of several senders."""
    role = topic.sender.split()[0]
    own = {"unit": (driver_role(name),), TRACKER: (TRACKER, tracker_role(name))}
    return own.get(role, (role,))


def served_by(topic: Topic, name: str) -> str:
    """Return the process that answers what is asked on a topic, as it is called among the living."""
    return driver_role(name) if topic in (LEASE, CONFIG, HOST) else name


def named(full: str) -> tuple[Topic, str] | None:
    """Return the topic of a full key, and what it is about; None for an expression of many keys."""
    found = _matched(full)
    return None if found is None else found[:2]


def _matched(full: str) -> tuple[Topic, str, str] | None:
    """Return the topic of a full key, what it is about, and who sent it."""
    tail = full.split("/", 2)[-1]
    for topic, pattern in _PATTERNS:
        if found := pattern.fullmatch(tail):
            return topic, found["name"] or "", found["sender"] or ""
    return None


def largest(expression: str) -> int:
    """Return the most bytes that a message of a key may have, or of any key of an expression of one topic."""
    found = named(expression.replace("*", "any"))
    return LARGEST_MESSAGE if found is None else found[0].largest
