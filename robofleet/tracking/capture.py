"""Motion-capture systems through the library ``motioncapture``: who answers, and their frames as they come.

The library waits for ever for a system that does not answer, and nothing else of the process runs meanwhile. So a
process of its own asks first; only a system that answered it is opened here.
"""

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple, Protocol

from robofleet.bus.bus import Wake
from robofleet.config.mocap import MocapSettings
from robofleet.core.clock import Clock
from robofleet.tracking.bodies import Body
from robofleet.tracking.sources import CameraError

LIBRARY = "motioncapture"
POLLED = frozenset({"vrpn"})  # systems of which the library's waitForNextFrame returns also where nothing came
_ANSWER_S, _BODY_S = 6.0, 2.0  # until a system answers, until it tells a body
_LAST_FRAME_S = 0.2
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 2.0
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


class Capture(Protocol):
    """A motion-capture system, as the library has it; the simulated one has the same."""

    def waitForNextFrame(self) -> None:
        """Wait for the next frame."""

    @property
    def rigidBodies(self) -> Mapping[str, Any]:
        """The bodies that are tracked in the newest frame: ``position`` (3,), ``rotation`` with x, y, z, w."""


class CaptureFrame(NamedTuple):
    """One frame."""

    bodies: dict[str, Body]
    arrival_ns: int  # [this host's clock]


def read(capture: Capture, clock: Clock) -> CaptureFrame:
    """Return the next frame of a system, waiting for it."""
    capture.waitForNextFrame()
    arrival_ns = clock.now_ns()
    bodies = {}
    for name, body in capture.rigidBodies.items():
        p, q = body.position, body.rotation
        bodies[name] = Body(float(p[0]), float(p[1]), float(p[2]), q.x, q.y, q.z, q.w)
    return CaptureFrame(bodies, arrival_ns)


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


def open_capture(settings: MocapSettings) -> Capture:
    """Open a system that answers; CameraError where none does."""
    bodies_there(settings)
    capture: Capture = import_module(LIBRARY).connect(settings.system, _options(settings))
    return capture


def _options(settings: MocapSettings) -> dict[str, str]:
    return {"hostname": settings.host, **settings.options}


class CaptureReader:
    """Reads a system in a thread of its own. Of frames that nobody took the newest one is kept.

    One that fails is opened again, ever more patiently. One that is silent is waited for: who takes the frames has
    to notice. What a ``polled`` one gives again bit by bit, or without a body, is no frame: nothing came.
    """

    def __init__(
        self, open_capture: Callable[[], Capture], clock: Clock, wake: Wake, *, polled: bool = False
    ) -> None:  # fmt: skip
        """Open it here and now: CameraError where that fails."""
        self._open, self._clock, self._wake, self._polled = open_capture, clock, wake, polled
        self._capture: Capture | None = open_capture()
        self._newest: CaptureFrame | None = None
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._pause_s = _FIRST_PAUSE_S
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def next_ns(self) -> int | None:
        """Return None: a frame wakes the process."""
        return None

    def take(self, now_ns: int) -> CaptureFrame | None:
        """Return the newest frame not taken yet."""
        with self._lock:
            newest, self._newest = self._newest, None
        return newest

    def close(self) -> None:
        """End the thread, over which an interpreter that ends may abort; that of a silent system stays."""
        self._closing.set()
        self._thread.join(_LAST_FRAME_S)

    def _run(self) -> None:
        last: dict[str, Body] = {}
        while not self._closing.is_set():
            try:
                if self._capture is None:
                    self._capture = self._open()
                frame = read(self._capture, self._clock)
            except Exception as error:  # noqa: BLE001 - whatever a library raises, it gives no poses
                self._fail(str(error) or type(error).__name__)
                continue
            self._pause_s = _FIRST_PAUSE_S
            if self._polled and frame.bodies in ({}, last):
                continue
            last = frame.bodies
            with self._lock:
                self._newest = frame
            self._wake(0)

    def _fail(self, why: str) -> None:
        if self._closing.is_set():
            return
        if self._pause_s == _FIRST_PAUSE_S:
            print(f"motion capture: {why}", file=sys.stderr)
        self._capture = None
        self._closing.wait(self._pause_s)
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)


class CapturePoller:
    """Reads a system that knows when its next frame will be there, between two steps: lockstep has no threads."""

    def __init__(self, capture: "ScheduledCapture", clock: Clock) -> None:
        self._capture, self._clock = capture, clock

    def next_ns(self) -> int | None:
        """Return when there will be a frame."""
        return self._capture.ready_ns()

    def take(self, now_ns: int) -> CaptureFrame | None:
        """Return the frame that is there."""
        return read(self._capture, self._clock) if self._capture.ready_ns() <= now_ns else None

    def close(self) -> None:
        """Nothing to let go of."""


class ScheduledCapture(Capture, Protocol):
    """A system that knows when its next frame will be there."""

    def ready_ns(self) -> int:
        """Return when ``waitForNextFrame`` will not wait [ns]."""
