"""Motion-capture systems through the library ``motioncapture``: who answers, and their frames as they come.

The library waits for ever for a system that does not answer, and nothing else of the process runs meanwhile. So a
process of its own asks first; only a system that answered it is opened here.
"""

import json
import signal
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

from robofleet.config.mocap import MocapSettings
from robofleet.core.clock import Clock
from robofleet.tracking.bodies import Body
from robofleet.tracking.sources import CameraError

LIBRARY = "motioncapture"
_POLLED = frozenset({"vrpn"})  # systems of which the library's waitForNextFrame returns also where nothing came
_ANSWER_S, _BODY_S = 6.0, 2.0  # until a system answers, until it tells a body
_ASK = """
import json, sys, time
import motioncapture
system, options, patience_s = json.load(sys.stdin)
capture, end_s, names, frames = motioncapture.connect(system, options), time.monotonic() + patience_s, set(), 0
while frames < 20 and time.monotonic() < end_s:
    capture.waitForNextFrame()
    bodies = set(capture.rigidBodies)
    names |= bodies
    frames += bool(bodies)
print(json.dumps(sorted(names)))
"""


class CaptureFrame(NamedTuple):
    """One frame."""

    bodies: dict[str, Body]
    arrival_ns: int  # [this host's clock]


def bodies_there(settings: MocapSettings) -> list[str]:
    """Return the names of the bodies that a system tracks now; CameraError where it does not answer, or tracks none."""
    if find_spec(LIBRARY) is None:
        raise CameraError(f"the library {LIBRARY} is missing: pip install 'robofleet[mocap]'")
    given = json.dumps([settings.system, _options(settings), _BODY_S])
    where = f"{settings.system} at {settings.host}"
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-c", _ASK], input=given, capture_output=True, text=True, check=False,
            timeout=_ANSWER_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        mend = "start its streaming, and compare tracker.mocap.host with its address"
        raise CameraError(f"{where} sends nothing within {_ANSWER_S:g} s: {mend}") from None
    if answer.returncode:
        code = answer.returncode
        ended = f"exit code {code}" if code > 0 else f"killed by {signal.Signals(-code).name}"
        why = (answer.stderr.strip().splitlines() or [ended])[-1]
        raise CameraError(f"{where}: the library {LIBRARY} says: {why.partition(': ')[2] or why}: mend tracker.mocap")
    names: list[str] = json.loads(answer.stdout.splitlines()[-1])
    if not names:
        mend = "start its server, let it track the robots, and compare tracker.mocap.host with its address"
        raise CameraError(f"{where} sends no body: {mend}")
    return names


def _options(settings: MocapSettings) -> dict[str, str]:
    return {"hostname": settings.host, **settings.options}


class CaptureDevice:
    """The library's system, read as a camera is. Who takes the frames has to notice one that is silent.

    What a ``polled`` one gives again bit by bit, or without a body, is no frame: nothing came.
    """

    def __init__(self, capture: Any, clock: Clock, *, polled: bool = False) -> None:
        self._capture, self._clock, self._polled = capture, clock, polled
        self._last: dict[str, Body] = {}

    def read(self) -> CaptureFrame | None:
        self._capture.waitForNextFrame()
        arrival_ns = self._clock.now_ns()
        bodies = {}
        for name, body in self._capture.rigidBodies.items():
            p, q = body.position, body.rotation
            bodies[name] = Body(float(p[0]), float(p[1]), float(p[2]), q.x, q.y, q.z, q.w)
        if self._polled and bodies in ({}, self._last):
            return None
        self._last = bodies
        return CaptureFrame(bodies, arrival_ns)

    def close(self) -> None:
        """Nothing: the library has no way to let go of a system."""


def open_capture(settings: MocapSettings, clock: Clock) -> CaptureDevice:
    """Open a system that answers; CameraError where none does."""
    bodies_there(settings)
    capture = import_module(LIBRARY).connect(settings.system, _options(settings))
    return CaptureDevice(capture, clock, polled=settings.system in _POLLED)
