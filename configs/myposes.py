"""Poses of one's own, in a file beside the configuration that names it: `tracker.source: myposes:UdpPoses`.

Another program sends them by UDP, one line of JSON a measurement: {"r1": [x_m, y_m, heading_rad], "r2": [...]}.
"""

import json
import math
import socket
import threading

from robofleet import CameraError, Observation, PoseContext, TagPose

PORT = 5601


class UdpPoses:
    """Keeps the newest line. robofleet itself tells when none comes, and stops a robot that is not in it."""

    def __init__(self, context: PoseContext) -> None:
        self._numbers = {robot.id: robot.tag for robot in context.config.robots}  # by which messages name them
        self._clock, self._wake = context.clock, context.wake
        self._newest: Observation | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("127.0.0.1", PORT))
        except OSError as error:
            raise CameraError(f"UDP port {PORT}: {error.strerror}: end the other program that listens") from error
        self._socket.settimeout(0.1)  # then it looks whether it is closed
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def next_ns(self) -> None:
        """Return that a line wakes the process."""
        return

    def observe(self, now_ns: int) -> Observation | None:
        """Return what came since the last call, or None."""
        newest, self._newest = self._newest, None
        return newest

    def news(self) -> tuple[()]:
        """Return that there is nothing to tell."""
        return ()

    def close(self) -> None:
        """Let go of the port."""
        self._closed.set()
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        while not self._closed.is_set():
            try:
                line = self._socket.recv(65536)
            except TimeoutError:
                continue
            arrival_ns = self._clock.now_ns()  # better, where it is known: when the poses were measured
            try:
                by_name = {name: tuple(map(float, pose)) for name, pose in json.loads(line).items()}
            except (AttributeError, TypeError, ValueError):
                continue  # not for us
            poses = [
                TagPose(self._numbers[name], 0, 0, pose[0], pose[1], math.remainder(pose[2], math.tau))
                for name, pose in by_name.items()
                if name in self._numbers and len(pose) == 3 and all(map(math.isfinite, pose))
            ]
            self._newest = Observation(arrival_ns, tuple(poses), len(by_name) - len(poses))
            self._wake(0)
