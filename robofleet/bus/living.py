"""Which processes are on a bus, by their liveliness tokens: bookkeeping, by which answers are believed, never safety.

A token ``alive/<role>/<zid>/<pid>`` says whose session it is; Zenoh says of every answer which session gave it. So the
answer of another session is told from that of the process that was asked. Where several say that they have a role,
none of them is believed: that keeps an operator from an answer, and never gives one that was made up. It does not
protect against who writes Zenoh's protocol with his own hands; certificates will.
"""

import os
from collections.abc import Sequence
from typing import NamedTuple

import zenoh

from robofleet.bus.keys import ALIVE, key
from robofleet.core.errors import RobofleetError

_MOST_TOKENS_OF_ROLE = 16  # two are enough to believe nobody


class RoleTakenError(RobofleetError):
    """Raised where another process has the role already. The message names it."""

    def __init__(self, arena: str, role: str, living: "Sequence[Token]") -> None:
        which = ", ".join(f"process {token.pid}" for token in living)
        super().__init__(f"the arena {arena} has a {role} already ({which}): end that one first")


class Token(NamedTuple):
    """A process that is there."""

    zid: str
    pid: str  # as it says; text, since anybody may have said it


def alive_key(arena: str, role: str, session: zenoh.Session) -> str:
    return key(arena, ALIVE, f"{role}/{session.info.zid()}/{os.getpid()}")


def others(session: zenoh.Session, arena: str, role: str) -> list[Token]:
    replies = session.liveliness().get(key(arena, ALIVE, f"{role}/*/*"))
    tokens = [_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
    return [token for token in tokens if token.zid != str(session.info.zid())][:_MOST_TOKENS_OF_ROLE]


def roles(session: zenoh.Session, arena: str) -> set[str]:
    replies = session.liveliness().get(key(arena, ALIVE, "*/*/*"))
    return {str(reply.ok.key_expr).split("/")[-3] for reply in replies if reply.ok is not None}


class Living:
    """The sessions that have a role, kept up to date by Zenoh's own thread."""

    def __init__(self, session: zenoh.Session, arena: str, role: str) -> None:
        self._role = role
        self._tokens: set[Token] = set()
        callback = zenoh.handlers.Callback(self._told, indirect=False)
        expression = key(arena, ALIVE, f"{role}/*/*")
        self._subscriber = session.liveliness().declare_subscriber(expression, callback, history=True)

    @property
    def ids(self) -> set[str]:
        return {token.zid for token in tuple(self._tokens)}

    @property
    def doubt(self) -> str:
        """Why an answer in this role is not believed."""
        if len(self.ids) < 2:
            return f"another client answered in place of the {self._role}"
        living = ", ".join(sorted(token.pid for token in tuple(self._tokens)))
        return f"several processes claim to be the {self._role}, so none is believed (processes {living})"

    def _told(self, sample: zenoh.Sample) -> None:
        token = _token(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.DELETE:
            self._tokens = self._tokens - {token}
        elif len(self._tokens) < _MOST_TOKENS_OF_ROLE:
            self._tokens = self._tokens | {token}


def _token(full: str) -> Token:
    return Token(*full.split("/")[-2:])
