"""Who may say and hear what beyond this computer: every identity, every topic, every way to use it, over real links."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from itertools import product
from typing import NamedTuple

import pytest
import zenoh

from robofleet.bus.credentials import Credentials, session_id
from robofleet.bus.keys import (
    ALIVE,
    CAMERA,
    COMMAND,
    ENABLE,
    NEWS,
    NOTE,
    QUERIES,
    REQUEST,
    SAFE_REQUEST,
    SHOWING,
    TELEOP,
    TOPICS,
    WISH,
    Topic,
    key,
    sender_key,
    split,
)  # fmt: skip
from robofleet.bus.permissions import (
    ANSWERS,
    ASKS,
    HEARS,
    ROLES,
    SAYS,
    SCRIPT,
    UNIT,
    Identity,
    access_control,
    permissions,
)
from robofleet.bus.zenoh_bus import Network, ZenohBus, open_router
from robofleet.core.patterns import driver_role
from robofleet.hosts.authority import ROUTER, Authority, identities
from tests.bus.contract import CLOCK, until
from tests.endpoints import free_port, own_endpoint

ARENA = "lab"
UNITS = "r1", "r2"
NAMES = {
    "unit": UNITS,
    "sim": UNITS,
    "poses": (CAMERA,),
    "request": ("supervisor", "tracker"),
    "group": ("left", "right"),
}
MALLORY = "mallory"  # another script


def about(topic: Topic) -> tuple[str, ...]:
    """Return what a topic's keys name."""
    return NAMES[topic.key.partition("/")[0]] if "{}" in topic.key else ("",)


SENDERS = tuple(f"{role}/{name}/{session}" for role in ROLES for name in (role, MALLORY) for session in ("1f", "2e"))


def full_keys(topic: Topic) -> Iterator[str]:
    """Yield a topic's keys: where each sender has one of its own, those of every role, and of two of each role."""
    for name in about(topic):
        yield from (
            [sender_key(ARENA, topic, name, sender) for sender in SENDERS]
            if topic.by_sender
            else [key(ARENA, topic, name)]
        )


KEYS = {full: topic for topic in TOPICS if topic is not ALIVE for full in full_keys(topic)}
OPERATIONS = SAYS, HEARS, ASKS, ANSWERS


class Net(NamedTuple):
    """A router that is reached by certificates, and who has one."""

    local: str
    endpoint: str
    who: dict[str, Identity]
    authority: Authority
    probe: zenoh.Session  # of this user, on the socket

    def joined(self, name: str) -> ZenohBus:
        """Return the bus of somebody on another host."""
        own = Credentials.at(self.authority.folder, name)
        certificate = self.authority.entries()[name].newest
        session = session_id(certificate) if certificate.kind == UNIT else None
        role = name if certificate.kind == UNIT else certificate.kind
        return ZenohBus(ARENA, self.endpoint, role, CLOCK, credentials=own, session=session)


@pytest.fixture(scope="module", params=["tls", pytest.param("quic", marks=pytest.mark.slow)])
def net(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Net]:
    authority = Authority.create(ARENA, tmp_path_factory.mktemp("keys"))
    authority.issue(ROUTER, ROUTER, addresses=["127.0.0.1"])
    for name in (*UNITS, *ROLES):
        authority.issue(name, UNIT if name in UNITS else name, addresses=["127.0.0.1"])
    authority.issue(MALLORY, SCRIPT)
    local, beyond = own_endpoint(), f"{request.param}/127.0.0.1:{free_port()}"
    who = identities(authority)
    network = Network([beyond], Credentials.at(authority.folder, ROUTER), access_control(ARENA, who))
    router = open_router(local, network)
    bus = ZenohBus(ARENA, local, "witness", CLOCK)
    try:
        yield Net(local, beyond, {identity.name: identity for identity in who}, authority, bus._session)
    finally:
        bus.close()
        router.close()


def allowed(who: Identity, does: str) -> set[str]:
    """Return the keys that somebody may use in a way, by the table."""
    return {
        full
        for permission in permissions(ARENA, who)
        if permission.does == does
        for full in KEYS
        if zenoh.KeyExpr(permission.full).includes(zenoh.KeyExpr(full))
    }


class Tried:
    """What came through of what somebody tried on every key, and on all at once."""

    def __init__(self, net: Net, session: zenoh.Session, who: Identity) -> None:
        self._probe, self._session, self._who = net.probe, session, who

    def __call__(self, does: str) -> set[str]:
        """Return the keys on which something came, or was answered; the witness does the other part."""
        mine, everything = does in (HEARS, ANSWERS), ["rf/**"]
        receiver, sender = (self._session, self._probe) if mine else (self._probe, self._session)
        expressions = [*KEYS, *everything] if mine else everything
        if does in (SAYS, HEARS):
            return self._heard(receiver, expressions, sender, does)
        queryables = [receiver.declare_queryable(full, lambda q: q.reply(q.key_expr, b"yes")) for full in expressions]
        self.marked(does)
        answered = _all_answers(sender, allowed(self._who, does))
        for queryable in queryables:
            queryable.undeclare()
        return answered

    def _heard(self, receiver: zenoh.Session, expressions: list[str], sender: zenoh.Session, does: str) -> set[str]:
        keys: set[str] = set()
        noted = zenoh.handlers.Callback(lambda sample: keys.add(str(sample.key_expr)), indirect=False)
        subscribers = [receiver.declare_subscriber(full, noted) for full in expressions]
        self.marked(does)
        expected = allowed(self._who, does)

        def put() -> bool:
            for full in KEYS:
                sender.put(full, b"said")
            return keys >= expected

        until(put)
        put()
        self.marked("end")
        for subscriber in subscribers:
            subscriber.undeclare()
        return keys

    def marked(self, mark: str) -> None:
        """Return when what this session said before has passed the router: its token, which it may say, is seen."""
        role = driver_role(self._who.name) if self._who.role == UNIT else self._who.role
        full = key(ARENA, ALIVE, f"{role}/{mark}/1")
        token = self._session.liveliness().declare_token(full)
        assert until(lambda: full in _living(self._probe)), f"{self._who.name} may not say that it lives"
        token.undeclare()


def _all_answers(session: zenoh.Session, expected: set[str]) -> set[str]:
    """Ask on every key, again until all that may answer have, and return which keys were answered.

    The order changes from one time to the next: the router lets 500 requests a second through, and drops the others.
    """
    answered: set[str] = set()
    order = list(KEYS)

    def asked() -> bool:
        order.reverse()
        asking = {full: session.get(full, target=zenoh.QueryTarget.ALL, timeout=0.5) for full in order}
        answered.update(full for full, replies in asking.items() if any(reply.ok is not None for reply in replies))
        return answered >= expected

    until(asked)
    return answered


def _living(session: zenoh.Session) -> set[str]:
    return {
        str(reply.ok.key_expr) for reply in session.liveliness().get(f"rf/{ARENA}/alive/**") if reply.ok is not None
    }


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", [*UNITS, *ROLES])
def test_everybody_says_hears_asks_and_answers_what_the_table_says_and_nothing_else(net: Net, name: str) -> None:
    who = net.who[name]
    bus = net.joined(name)
    try:
        tried = Tried(net, bus._session, who)
        for does in OPERATIONS:
            assert tried(does) & KEYS.keys() == allowed(who, does), f"{name} {does}"
    finally:
        bus.close()


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", [*UNITS, *ROLES])
def test_everybody_sees_who_lives_and_nobody_claims_the_place_of_another(net: Net, name: str) -> None:
    who = net.who[name]
    roles = [*ROLES, *map(driver_role, UNITS)]
    own = driver_role(name) if who.role == UNIT else who.role
    seen = net.probe.liveliness().declare_token(key(ARENA, ALIVE, "supervisor/witness/1"))
    bus = net.joined(name)
    try:
        tokens = [bus._session.liveliness().declare_token(key(ARENA, ALIVE, f"{role}/claimed/1")) for role in roles]
        assert until(lambda: key(ARENA, ALIVE, f"{own}/claimed/1") in _living(net.probe))
        claimed = {full.split("/")[3] for full in _living(net.probe) if "/claimed/" in full}
        assert claimed == {own}
        assert key(ARENA, ALIVE, "supervisor/witness/1") in _living(bus._session)
        for token in tokens:
            token.undeclare()
    finally:
        bus.close()
        seen.undeclare()


def test_a_script_shadows_no_other_one_and_commands_as_no_person(net: Net) -> None:
    """Whatever it sends, and however much: its messages have its own name, and a place beside the others'."""
    with closing(ZenohBus(ARENA, net.local, "controller", CLOCK)) as controller, ExitStack() as stack:
        programs, persons = (controller.newest_by_sender(topic, "left") for topic in (WISH, TELEOP))
        recorded = controller.stream(key(ARENA, WISH, "left"), capacity=10_000)
        first, second = (stack.enter_context(closing(net.joined(name))) for name in ("script", MALLORY))
        sends, floods = (bus.publisher(WISH, "left") for bus in (first, second))
        found: dict[str, bytes] = {}

        def came(*texts: bytes) -> bool:
            found.update(programs.take())
            return sorted(found.values()) == sorted(texts)

        assert until(lambda: (sends(b"first"), came(b"first"))[1])
        (own,) = found
        forged = [key(ARENA, topic, "left") for topic in (WISH, TELEOP)]
        forged += [sender_key(ARENA, topic, "left", sender) for topic in (WISH, TELEOP) for sender in (own, *SENDERS)]
        forged = [full for full in forged if f"/script/{MALLORY}/" not in full]
        forged += [sender_key(ARENA, WISH, name, f"script/{MALLORY}/*") for name in ("left", "*")]  # of many keys
        sends(b"newest")
        for k in range(2000):
            second._session.put(forged[k % len(forged)], b"forged")
            floods(b"flood")
        Tried(net, second._session, net.who[MALLORY]).marked("forged")
        assert until(lambda: (floods(b"flood"), came(b"newest", b"flood"))[1])
        assert found.pop(own) == b"newest"
        assert [sender.rpartition("/")[0] for sender in found] == [f"script/{MALLORY}"]
        assert not persons.take()
        assert not [full for _, full, _ in recorded.drain() if split(full)[1] not in (own, *found)]


def test_the_table_gives_to_each_what_it_needs_and_wheels_to_few() -> None:
    who = [*(Identity(unit, UNIT, unit) for unit in UNITS), *(Identity(role, role, role) for role in ROLES)]
    may = {(identity.name, does): allowed(identity, does) for identity, does in product(who, OPERATIONS)}
    commands, enables = ({key(ARENA, topic, unit) for unit in UNITS} for topic in (COMMAND, ENABLE))
    assert [identity.name for identity in who if may[identity.name, SAYS] & commands] == ["controller"]
    assert [identity.name for identity in who if may[identity.name, SAYS] & enables] == ["supervisor"]
    request = key(ARENA, REQUEST, "supervisor")
    assert [identity.name for identity in who if request in may[identity.name, ASKS]] == ["web", "operator"]
    for unit, other in (UNITS, UNITS[::-1]):
        assert not {full for does in OPERATIONS for full in may[unit, does] if f"/{other}/" in full}
    permitted = {
        (name, topic): {full for full in may[name, SAYS] if KEYS[full] is topic} for name, _ in may for topic in TOPICS
    }
    assert [identity.name for identity in who if permitted[identity.name, WISH]] == ["script"]
    assert [identity.name for identity in who if permitted[identity.name, TELEOP]] == ["web", "operator"], (
        "a person's, and no program's"
    )
    for identity, topic in product(who, (WISH, TELEOP)):
        senders = {split(full)[1] for full in permitted[identity.name, topic]}
        assert all(sender.startswith(f"{identity.role}/{identity.name}/") for sender in senders), (
            "nobody in another's name"
        )
    assert may["script", SAYS] - permitted["script", WISH] == {key(ARENA, NOTE, group) for group in NAMES["group"]}
    assert {KEYS[full] for full in may["script", ASKS]} == {SAFE_REQUEST}, "a script starts and resumes nothing"
    news = {full for full, topic in KEYS.items() if topic is NEWS}
    assert [identity.name for identity in who if may[identity.name, SAYS] & news] == ["controller", "tracker"], (
        "who doubts a camera"
    )
    assert may["viewer", SAYS] == set()
    assert may["operator", SAYS] == permitted["operator", TELEOP], "in groups that a person drives"
    assert may["web", SAYS] == permitted["web", TELEOP] | {key(ARENA, SHOWING)}
    assert all(topic in QUERIES for full in may["viewer", ASKS] for topic in [KEYS[full]])
