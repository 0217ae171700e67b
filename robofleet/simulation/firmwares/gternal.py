"""GTernal's motor controller, imitated from its public firmware (github.com/robotarium/GTernal, Teensy, ArduinoJson 5).

Its loop looks at the serial line, then at its 500 ms stop, then at its wheels. What it does there that matters:

- It empties its input before it looks, so what comes while it answers is lost: of two lines at once the second.
- A first byte, whatever it is, makes it read an object to its end. While it waits for the next byte, up to a second
  for each, it does not look at its stop: half a line holds that up.
- An object that is not whole does nothing, and is answered with empty lists.
- Any ``write`` starts the stop's time anew, no ``read`` does. A request that is neither is what the last one was.
- It clips nothing; motors that can do no more do no more. It tells nothing of its encoders.

Of its sensors it has the battery, the charger, the distances and the orientation here; what else can be read is
answered as unknown.
"""

import json
import math
import re
from collections.abc import Callable, Generator
from typing import Any

from robofleet.core.errors import RobofleetError
from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.differential_drive import wheels_from_body
from robofleet.vehicles.interface import STOP, WheelSpeeds

_BYTE_PATIENCE_NS = 1_000_000_000  # for the next byte of an object
_LEAST_V, _LEAST_W = 1e-4, 0.01  # less of both, and the motors get no current [m/s, rad/s]
_EMPTY_V, _FULL_V = 3.3, 4.2  # assumed: a lithium cell, taken as linear between
_STEP_V = 3.3 / 1023.0 * 20.0 / 15.0  # of its converter, behind a divider
_DEEPEST_NESTING = 10
_NUMBER = re.compile(r"[+-]?\d*\.?\d*(?:[eE][+-]?\d+)?")
_UNQUOTED = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZ_`abcdefghijklmnopqrstuvwxyz0123456789+-.")

_Reading = Generator[None, str, Any]  # takes bytes as they come, returns what they say


class _MalformedError(RobofleetError):
    """Raised where a request to the firmware is no JSON object."""


class GTernalFirmware:
    """One motor controller, switched on at rest."""

    baud = 500_000
    watchdog_s = 0.5

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._v = self._w = 0.0
        self._writes = False  # what the last request was
        self._written_ns = 0
        self._byte_ns: int | None = None  # when the newest byte of an object came; None: none has begun
        self._begin()

    def opened(self, now_ns: int) -> None:
        """Nothing: its line is always there."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Read an object on; once it ends, answer, and lose the rest."""
        for byte in data.decode("latin-1"):
            self._byte_ns = now_ns
            try:
                self._object.send(byte)
            except StopIteration as ended:
                return self._obey(ended.value, now_ns)
            except _MalformedError:
                return self._obey({}, now_ns)
        return b""

    def loop(self, now_ns: int) -> bytes:
        answer = b""
        if self._byte_ns is not None and now_ns - self._byte_ns >= _BYTE_PATIENCE_NS:
            answer = self._obey({}, now_ns)
        if self._byte_ns is None and now_ns - self._written_ns > self.watchdog_s * 1e9:
            self._v = self._w = 0.0
        self._follow()
        return answer

    def _follow(self) -> None:
        drive = self._hardware.drive
        stands = abs(self._v) < _LEAST_V and abs(self._w) < _LEAST_W
        wheels = wheels_from_body(self._v, self._w, drive.wheel_radius, drive.wheel_base)
        self._hardware.command = STOP if stands else WheelSpeeds(*wheels)

    def _begin(self) -> None:
        self._byte_ns = None
        self._object = _Reader().read()
        next(self._object)

    def _obey(self, call: Any, now_ns: int) -> bytes:
        """Do what an object asks, in its order."""
        self._begin()
        status: list[int] = []
        body: list[dict[str, Any]] = []
        interfaces, bodies = _member(call, "iface"), _member(call, "body")
        for index, request in enumerate(_member(call, "request")):
            if request in ("read", "write"):
                self._writes = request == "write"
            interface = interfaces[index] if index < len(interfaces) else None
            given = bodies[index] if index < len(bodies) else None
            known, answer = self._write(interface, given, now_ns) if self._writes else self._read(interface, now_ns)
            status += [1] * known
            body.append(answer)
        self._follow()
        return json.dumps({"status": status, "body": body}, separators=(",", ":")).encode()

    def _write(self, interface: Any, given: Any, now_ns: int) -> tuple[bool, dict[str, Any]]:
        self._written_ns = now_ns
        if interface == "motor":
            self._v, self._w = _number(given, "v"), _number(given, "w")
        return interface in ("motor", "left_led", "right_led"), {}

    def _read(self, interface: Any, now_ns: int) -> tuple[bool, dict[str, Any]]:
        volts = _EMPTY_V + (_FULL_V - _EMPTY_V) * self._hardware.charge
        if interface == "batt_volt":
            return True, {"batt_volt": round(volts // _STEP_V * _STEP_V, 6)}
        if interface == "charge_status":
            return True, {"charge_status": False}
        sensed = None if self._hardware.sense is None else self._hardware.sense(now_ns)
        if interface == "distances" and sensed is not None and sensed.distances is not None:
            # In whole millimetres; nothing seen is 0.
            return True, {"distances": [0.0 if math.isnan(d) else round(d, 3) for d in sensed.distances]}
        if interface == "orientation" and sensed is not None and sensed.heading is not None:
            degrees = round(math.degrees(-sensed.heading) * 16.0) / 16.0  # as its sensor counts, clockwise
            return True, {"orientation": [degrees % 360.0, 0.0, 0.0]}
        return False, {}


class _Reader:
    """ArduinoJson 5's reader, byte by byte: quotes may be left out, and a value is a text until somebody uses it."""

    def __init__(self) -> None:
        self._byte = ""  # that is looked at; "": it has not come yet

    def read(self) -> _Reading:
        return (yield from self._object(_DEEPEST_NESTING))

    def _object(self, depth: int) -> _Reading:
        return dict((yield from self._items("{", "}", self._pair, depth)))

    def _list(self, depth: int) -> _Reading:
        return (yield from self._items("[", "]", self._value, depth))

    def _items(self, opening: str, closing: str, item: Callable[[int], _Reading], depth: int) -> _Reading:
        if not depth or not (yield from self._skip(opening)):
            raise _MalformedError
        found: list[Any] = []
        if (yield from self._skip(closing)):
            return found
        while True:
            found.append((yield from item(depth - 1)))
            if (yield from self._skip(closing)):
                return found
            if not (yield from self._skip(",")):
                raise _MalformedError

    def _pair(self, depth: int) -> _Reading:
        key = yield from self._text()
        if not (yield from self._skip(":")):
            raise _MalformedError
        return key, (yield from self._value(depth))

    def _value(self, depth: int) -> _Reading:
        yield from self._skip("")
        if self._byte == "{":
            return (yield from self._object(depth))
        return (yield from (self._list(depth) if self._byte == "[" else self._text()))

    def _text(self) -> _Reading:
        yield from self._skip("")
        text, quote = "", self._byte if self._byte in "'\"" else ""
        if quote:
            self._byte = ""
        while (byte := (yield from self._look())) != quote and (quote or byte in _UNQUOTED):
            text, self._byte = text + byte, ""
        if quote:
            self._byte = ""
        return text

    def _skip(self, wanted: str) -> _Reading:
        """Skip blanks, and the wanted byte if it is there; returns whether it was."""
        while (yield from self._look()) in " \t\r\n":
            self._byte = ""
        if self._byte != wanted:
            return False
        self._byte = ""
        return True

    def _look(self) -> _Reading:
        while not self._byte.strip("\0"):
            self._byte = yield
        return self._byte


def _member(value: Any, name: str) -> list[Any]:
    found = value.get(name)
    return found if isinstance(found, list) else []


def _number(given: Any, name: str) -> float:
    """Return what begins as a number; 0 where none is."""
    text = given.get(name) if isinstance(given, dict) else None
    match = _NUMBER.match(text) if isinstance(text, str) else None
    try:
        return float(match[0]) if match else 0.0
    except ValueError:
        return 0.0
