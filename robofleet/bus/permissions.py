"""Who may say and hear what: Zenoh's access control, made from the table of topics and a roster of names.

Everything that is not named here is refused. A name is the common name of a certificate; what a message says of its
sender is never believed. The processes of this computer's user, on the Unix socket, may do everything: whoever can open
it owns the configuration, the keys and the processes.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from robofleet.bus.keys import ALIVE, QUERIES, TOPICS, Topic, key, sender_key
from robofleet.core.patterns import driver_role

UNIT, PAGE, OPERATOR, VIEWER, SCRIPT = "unit", "web", "operator", "viewer", "script"
PROCESSES = "controller", "supervisor", "tracker", "recorder", PAGE
ROLES = (*PROCESSES, OPERATOR, VIEWER, SCRIPT)
LOCAL = "unixsock-stream"  # the link of this user's own processes
SAYS, HEARS, ASKS, ANSWERS, LIVES, LOOKS = "says", "hears", "asks", "answers", "lives", "looks"
_IN, _OUT = "ingress", "egress"
# What the router lets through for what somebody may do: the kinds of messages, and their direction at the router.
_FLOWS: dict[str, tuple[tuple[str, str], ...]] = {
    SAYS: (("put", _IN), ("delete", _IN)),
    HEARS: (("declare_subscriber", _IN), ("put", _OUT), ("delete", _OUT)),
    ASKS: (("query", _IN), ("reply", _OUT)),
    ANSWERS: (("declare_queryable", _IN), ("query", _OUT), ("reply", _IN)),
    LIVES: (("liveliness_token", _IN),),
    LOOKS: (("liveliness_query", _IN), ("declare_liveliness_subscriber", _IN), ("liveliness_token", _OUT)),
}  # fmt: skip
_EVERYTHING = sorted({message for flows in _FLOWS.values() for message, _ in flows})


class Identity(NamedTuple):
    """Somebody with a certificate."""

    name: str
    role: str  # one of ROLES, or UNIT
    common_name: str  # of the certificate
    session: str | None = None  # the only Zenoh ID that it may have; None: several sessions at once


class Permission(NamedTuple):
    """One thing that an identity may do."""

    does: str  # SAYS, HEARS, ...
    topic: Topic
    full: str  # key, or an expression


def permissions(arena: str, who: Identity) -> Iterator[Permission]:
    """Yield all that an identity may do in an arena."""
    for topic in TOPICS:
        if topic is ALIVE:
            continue
        first, second = (ASKS, ANSWERS) if topic in QUERIES else (SAYS, HEARS)
        if (full := _reached(arena, topic, who, topic.sender.split(), sends=True)) is not None:
            yield Permission(first, topic, full)
        if (full := _reached(arena, topic, who, _receivers(topic))) is not None:
            yield Permission(second, topic, full)
    role = driver_role(who.name) if who.role == UNIT else who.role
    yield Permission(LIVES, ALIVE, key(arena, ALIVE, f"{role}/*/*"))
    yield Permission(LOOKS, ALIVE, key(arena, ALIVE, "**"))


def _receivers(topic: Topic) -> list[str]:
    """Return the roles that hear a topic, or answer on it."""
    several = {"all": ROLES, "viewers": ("recorder", PAGE, OPERATOR, VIEWER), "process": ("supervisor", "tracker")}
    receivers = [role for word in topic.receivers.split() for role in several.get(word, (word,))]
    return receivers if topic in QUERIES else [*receivers, "recorder"]  # it keeps what everybody said


def _reached(arena: str, topic: Topic, who: Identity, roles: Iterable[str], *, sends: bool = False) -> str | None:
    """Return the key of a topic that somebody reaches in one of these roles; None where it is in none of them."""
    if who.role not in roles and not (who.role == PAGE and OPERATOR in roles):  # the page asks for its operators
        return None
    own = topic.receivers == "process" and who.role in _receivers(topic)
    if "{}" not in topic.key:
        return key(arena, topic)
    about = who.name if who.role == UNIT or own else "*"
    if not topic.by_sender:
        return key(arena, topic, about)
    return sender_key(arena, topic, about, f"{who.role}/{who.name}/*" if sends else "*/*/*")


def access_control(arena: str, identities: Iterable[Identity]) -> dict[str, Any]:
    """Return Zenoh's ``access_control``: default deny, this table, and everything for this user's own processes."""
    rules = [
        _rule("everything", _EVERYTHING, (_IN, _OUT), ["**"]),
        # A publisher learns who subscribes, and an asker who answers: else Zenoh says nothing. That gives no more away.
        _rule("told", ["declare_subscriber", "declare_queryable"], (_OUT,), [f"rf/{arena}/**"]),
    ]  # fmt: skip
    subjects: list[dict[str, Any]] = [{"id": "this user", "link_protocols": [LOCAL]}]
    policies = [{"rules": ["everything"], "subjects": ["this user"]}]
    for who in identities:
        names = []
        for (message, flow), expressions in _by_flow(arena, who).items():
            names.append(f"{who.name}: {message} {flow}")
            rules.append(_rule(names[-1], [message], (flow,), sorted(expressions)))
        bound = {"zids": [who.session]} if who.session is not None else {}
        subjects.append({"id": who.name, "cert_common_names": [who.common_name], **bound})
        policies.append({"rules": ["told", *names], "subjects": [who.name]})
    return {
        "enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
    }  # fmt: skip


def _by_flow(arena: str, who: Identity) -> Mapping[tuple[str, str], set[str]]:
    found: dict[tuple[str, str], set[str]] = {}
    for permission in permissions(arena, who):
        for flow in _FLOWS[permission.does]:
            found.setdefault(flow, set()).add(permission.full)
    return found


def _rule(name: str, messages: list[str], flows: tuple[str, ...], expressions: list[str]) -> dict[str, Any]:
    return {
        "id": name, "permission": "allow", "messages": messages, "flows": list(flows), "key_exprs": expressions,
    }  # fmt: skip
