"""The services: what an operator asks of a run. Each request brings the operator's key.

A server on this computer is reached by every web site that a browser here has open: a key that only the operator has
seen is what the page's token is.
"""

import json
import secrets
from functools import partial

from foxglove import MessageSchema, Schema, Service, ServiceRequest, ServiceSchema

from robofleet.core.valid_json import dumps
from robofleet.gateways.asking import SERVICES, Ask

_WITHIN_S = 10.0
_LARGEST = 1024  # of a request [bytes]
_REQUEST = {"type": "object", "properties": {"key": {"type": "string"}}, "required": ["key"]}
_RESPONSE = {"type": "object", "properties": {"success": {"type": "boolean"}, "message": {"type": "string"}}}
_STRANGER = "refused: this needs the operator's key: the layout in the run's folder has it"


def new_key() -> str:
    """Draw an operator's key."""
    return secrets.token_hex(16)


def services(ask: Ask, key: str) -> list[Service]:
    """Return them."""
    schema = ServiceSchema(
        "robofleet.Ask",
        request=_schema("robofleet.Request", _REQUEST),
        response=_schema("robofleet.Answer", _RESPONSE),
    )
    return [Service(what, schema=schema, handler=partial(_answer, ask, key, what)) for what in SERVICES]


def _schema(name: str, described: object) -> MessageSchema:
    return MessageSchema(
        encoding="json", schema=Schema(name=name, encoding="jsonschema", data=dumps(described).encode())
    )


def _answer(ask: Ask, key: str, what: str, request: ServiceRequest) -> bytes:
    try:
        done, text = ask(what).result(_WITHIN_S) if _permitted(request.payload, key) else (False, _STRANGER)
    except TimeoutError:
        done, text = False, f"no answer within {_WITHIN_S:g} s: the requests before it wait, too"
    return dumps({"success": done, "message": text}).encode()


def _permitted(payload: bytes, key: str) -> bool:
    try:
        fields = json.loads(payload) if len(payload) <= _LARGEST else None
    except (ValueError, RecursionError):
        return False
    shown = fields.get("key") if isinstance(fields, dict) else None
    return isinstance(shown, str) and secrets.compare_digest(shown.encode(), key.encode())
