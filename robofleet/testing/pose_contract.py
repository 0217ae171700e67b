"""The contract of pose sources: a class of checks, to be subclassed with the source under test."""

import itertools
import math
import threading
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.bus.messages import UNIT_TRUTH, Truth, UnitTruth
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.pose_sources import pose_source
from robofleet.runs.check import pose_complaints
from robofleet.tracking.events import Notice
from robofleet.tracking.sources import Observation, PoseContext, PoseSource

MOCAP = SHIPPED / "mocap.yaml"
TICK_NS, STEP_NS = 33 * MS, 10 * MS
V, OMEGA = 0.2, 2.0  # of the robots [m/s, rad/s]
CENTRES = ((-1.0, 0.5), (1.0, 0.5), (-1.0, -0.5), (1.0, -0.5))


class PoseBench:
    """Four robots that drive circles on a simulated clock, and publish their true poses.

    Attributes:
        config: The configuration.
        clock: The simulated clock.
        bus: The bus in memory.
        hidden: Robots that publish nothing.
    """

    def __init__(self, source: str, keys: tuple[str, ...]) -> None:
        """Make the bench.

        Args:
            source: The source, as ``tracker.source`` names it.
            keys: Changes of ``configs/mocap.yaml``, as behind ``--set``.
        """
        self.config = load_config(MOCAP, ["drivers.robots_per_process=1", f"tracker.source={source}", *keys])
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        self.began_ns = S
        self.woken = threading.Event()
        self.bus: Any = MemoryBus("mocap", self.clock, 0)
        self._publish = [self.bus.publisher(TRUTH, robot.id) for robot in self.config.robots]
        self.ticks: Any = SimpleNamespace(began_ns=S, newest=0, newest_stamp_ns=0, update=lambda: None)
        self.hidden: set[str] = set()

    def open(self) -> PoseSource:
        """Open the source.

        Returns:
            The source.
        """
        context = PoseContext(
            config=self.config, clock=self.clock, bus=self.bus, ticks=self.ticks, rng=np.random.default_rng(1),
            extra_delay_ns=0, wake=lambda _: self.woken.set(), real_time=False, around=lambda feed: feed,
        )  # fmt: skip
        return pose_source(context)

    def pose(self, row: int, instant_ns: float) -> tuple[float, float, float]:
        """Compute the true pose of a robot.

        Args:
            row: The robot, counted from 0.
            instant_ns: The time [ns].

        Returns:
            x, y [m], psi [rad; world].
        """
        psi = OMEGA * (instant_ns - self.began_ns) / S + row
        x, y = CENTRES[row]
        r = V / OMEGA
        return x + r * math.sin(psi), y - r * math.cos(psi), math.remainder(psi, math.tau)

    def poses(self) -> dict[str, tuple[float, float, float]]:
        """Compute the robots' true poses now.

        Returns:
            x, y [m], psi [rad; world] by the robots' ids.
        """
        now_ns = self.clock.now_ns()
        return {robot.id: self.pose(row, now_ns) for row, robot in enumerate(self.config.robots)}

    def step(self) -> None:
        """Let 10 ms pass, and publish the true poses."""
        self.clock.advance_to(self.clock.now_ns() + STEP_NS)
        now_ns = self.clock.now_ns()
        if (now_ns - self.began_ns) // TICK_NS > self.ticks.newest:
            self.ticks.newest += 1
            self.ticks.newest_stamp_ns = self.began_ns + self.ticks.newest * TICK_NS
        for robot, publish, pose in zip(self.config.robots, self._publish, self.poses().values(), strict=True):
            if robot.id not in self.hidden:
                publish(UNIT_TRUTH.encode(UnitTruth(now_ns, now_ns, (Truth(0, *pose, V, OMEGA),))))


class PoseContract:
    """Checks for every source of poses.

    Subclass it in a file of tests::

        class TestMine(PoseContract):
            source = "myposes:UdpPoses"

            def measure(self, bench: PoseBench) -> None:
                send(bench.poses())

    Attributes:
        source: The source under test, as ``tracker.source`` names it.
        keys: Changes of ``configs/mocap.yaml``, as behind ``--set``.
        error_m: The largest error of a position [m].
        error_rad: The largest error of a heading [rad].
        threaded: Whether an observation comes from a thread. It has a second then.
    """

    source: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ()
    error_m: ClassVar[float] = 2e-3
    error_rad: ClassVar[float] = 0.02
    threaded: ClassVar[bool] = False

    @pytest.fixture
    def bench(self) -> PoseBench:
        """Make the bench of the source.

        Returns:
            The bench.
        """
        return PoseBench(self.source, self.keys)

    def measure(self, bench: PoseBench) -> None:
        """Let the outer world measure. A source that takes its poses from the bus needs nothing.

        Args:
            bench: The bench, with the robots' true poses.
        """

    def _observed(self, bench: PoseBench, source: PoseSource, seconds: float) -> list[Observation]:
        """Let time pass, and return all observations."""
        seen = []
        for _ in range(round(seconds * S / STEP_NS)):
            bench.step()
            self.measure(bench)
            if self.threaded:
                assert bench.woken.wait(1.0), "an observation that is there has to wake the process"
                bench.woken.clear()
            now_ns = bench.clock.now_ns()
            while (observation := source.observe(now_ns)) is not None:
                assert observation.exposure_ns <= now_ns, "measured in the future"
                seen.append(observation)
            next_ns = source.next_ns()
            assert next_ns is None or next_ns > now_ns, "due, and yet it has nothing: the process would not rest"
        return seen

    def test_poses_are_where_the_robots_were(self, bench: PoseBench) -> None:
        source = bench.open()
        seen = self._observed(bench, source, 0.5)
        source.close()
        rows = {robot.tag: row for row, robot in enumerate(bench.config.robots)}
        assert {pose.tag for observation in seen[-5:] for pose in observation.poses} == set(rows)
        for observation in seen[len(seen) // 2 :]:
            for pose in observation.poses:
                x, y, psi = bench.pose(rows[pose.tag], observation.exposure_ns + pose.after_ns - pose.coasted_ns)
                assert math.hypot(pose.x_m - x, pose.y_m - y) < self.error_m
                assert abs(math.remainder(pose.psi_rad - psi, math.tau)) < self.error_rad

    def test_every_observation_is_later_than_the_last_and_has_each_robot_once(self, bench: PoseBench) -> None:
        source = bench.open()
        seen = self._observed(bench, source, 0.3)
        source.close()
        instants = [observation.exposure_ns for observation in seen]
        assert len(seen) > 5 and all(earlier < later for earlier, later in itertools.pairwise(instants))
        for observation in seen:
            tags = [pose.tag for pose in observation.poses]
            assert len(set(tags)) == len(tags)
            assert all(-math.pi <= pose.psi_rad <= math.pi for pose in observation.poses)
            assert observation.refused >= 0

    def test_news_are_told_once(self, bench: PoseBench) -> None:
        source = bench.open()
        self._observed(bench, source, 0.2)
        assert all(isinstance(notice, Notice) for notice in source.news())
        assert source.news() == ()
        source.close()

    def test_without_anything_to_measure_it_returns_at_once(self, bench: PoseBench) -> None:
        source = bench.open()
        assert source.observe(bench.clock.now_ns()) is None
        source.close()

    def test_it_can_be_closed_twice_and_opened_again(self, bench: PoseBench) -> None:
        for _ in range(2):
            source = bench.open()
            source.close()
            source.close()

    def test_its_configuration_is_not_refused(self, bench: PoseBench) -> None:
        assert list(pose_complaints(bench.config)) == []
