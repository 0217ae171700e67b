"""What every source of poses has to keep, whoever wrote it: one class of checks, to be subclassed with what is tried.

    from tests.tracking.poses_contract import PosesContract

    class TestMine(PosesContract):
        source = "myposes:UdpPoses"

        def measure(self, bench):                 # what the outer world does when the robots have moved
            send(bench.poses())

The robots drive circles, on a clock that nobody waits for; each says on the bus where it truly is, as simulated ones
do. A source with a thread of its own has a second to come up with each observation.
"""

import itertools
import math
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.pose_sources import pose_source
from robofleet.runs.check import pose_complaints
from robofleet.tracking.events import Notice
from robofleet.tracking.sources import Observation, PoseContext
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth

MOCAP = Path(__file__).parents[2] / "configs" / "mocap.yaml"
TICK_NS, STEP_NS = 33 * MS, 10 * MS
V, OMEGA = 0.2, 2.0  # of the robots [m/s, rad/s]
CENTRES = ((-1.0, 0.5), (1.0, 0.5), (-1.0, -0.5), (1.0, -0.5))


class PosesBench:
    """A source alone, and robots that drive circles."""

    def __init__(self, source: str, keys: tuple[str, ...]) -> None:
        self.config = load_config(MOCAP, ["drivers.robots_per_process=1", f"tracker.source={source}", *keys])
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        self.began_ns = S
        self.woken = threading.Event()
        self.bus: Any = MemoryBus("mocap", self.clock, 0)
        self._publish = [self.bus.publisher(TRUTH, robot.id) for robot in self.config.robots]
        self.ticks: Any = SimpleNamespace(began_ns=S, newest=0, newest_stamp_ns=0, update=lambda: None)
        self.hidden: set[str] = set()

    def opened(self) -> Any:
        context = PoseContext(
            config=self.config, clock=self.clock, bus=self.bus, ticks=self.ticks, rng=np.random.default_rng(1),
            extra_delay_ns=0, wake=lambda _: self.woken.set(), real_time=False, around=lambda feed: feed,
        )  # fmt: skip
        return pose_source(context)

    def where(self, row: int, instant_ns: float) -> tuple[float, float, float]:
        psi = OMEGA * (instant_ns - self.began_ns) / S + row
        x, y = CENTRES[row]
        r = V / OMEGA
        return x + r * math.sin(psi), y - r * math.cos(psi), math.remainder(psi, math.tau)

    def poses(self) -> dict[str, tuple[float, float, float]]:
        """Return where the robots are now."""
        now_ns = self.clock.now_ns()
        return {robot.id: self.where(row, now_ns) for row, robot in enumerate(self.config.robots)}

    def step(self) -> None:
        """Let the robots move."""
        self.clock.advance_to(self.clock.now_ns() + STEP_NS)
        now_ns = self.clock.now_ns()
        if (now_ns - self.began_ns) // TICK_NS > self.ticks.newest:
            self.ticks.newest += 1
            self.ticks.newest_stamp_ns = self.began_ns + self.ticks.newest * TICK_NS
        for robot, publish, pose in zip(self.config.robots, self._publish, self.poses().values(), strict=True):
            if robot.id not in self.hidden:
                publish(TRUTH_LAYOUT.encode(Truth(now_ns, now_ns, *pose, V, OMEGA)))


class PosesContract:
    """All of it."""

    source: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ()
    error_m: ClassVar[float] = 2e-3  # of a pose at most
    error_rad: ClassVar[float] = 0.02
    threaded: ClassVar[bool] = False  # an observation may come a little after what brings it

    @pytest.fixture
    def bench(self) -> PosesBench:
        return PosesBench(self.source, self.keys)

    def measure(self, bench: PosesBench) -> None:
        """Do what makes the outer world measure; nothing for a source that takes its poses from the bus."""

    def observed(self, bench: PosesBench, source: Any, seconds: float) -> list[Observation]:
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

    def test_poses_are_where_the_robots_were(self, bench: PosesBench) -> None:
        source = bench.opened()
        seen = self.observed(bench, source, 0.5)
        source.close()
        rows = {robot.tag: row for row, robot in enumerate(bench.config.robots)}
        assert {pose.tag for observation in seen[-5:] for pose in observation.poses} == set(rows)
        for observation in seen[len(seen) // 2 :]:
            for pose in observation.poses:
                x, y, psi = bench.where(rows[pose.tag], observation.exposure_ns + pose.after_ns - pose.coasted_ns)
                assert math.hypot(pose.x_m - x, pose.y_m - y) < self.error_m
                assert abs(math.remainder(pose.psi_rad - psi, math.tau)) < self.error_rad

    def test_every_observation_is_later_than_the_last_and_has_each_robot_once(self, bench: PosesBench) -> None:
        source = bench.opened()
        seen = self.observed(bench, source, 0.3)
        source.close()
        instants = [observation.exposure_ns for observation in seen]
        assert len(seen) > 5 and all(one < other for one, other in itertools.pairwise(instants))
        for observation in seen:
            tags = [pose.tag for pose in observation.poses]
            assert len(set(tags)) == len(tags)
            assert all(-math.pi <= pose.psi_rad <= math.pi for pose in observation.poses)
            assert observation.refused >= 0

    def test_news_are_told_once(self, bench: PosesBench) -> None:
        source = bench.opened()
        self.observed(bench, source, 0.2)
        assert all(isinstance(notice, Notice) for notice in source.news())
        assert source.news() == ()
        source.close()

    def test_without_anything_to_measure_it_returns_at_once(self, bench: PosesBench) -> None:
        source = bench.opened()
        assert source.observe(bench.clock.now_ns()) is None
        source.close()

    def test_it_can_be_closed_twice_and_opened_again(self, bench: PosesBench) -> None:
        for _ in range(2):
            source = bench.opened()
            source.close()
            source.close()

    def test_its_configuration_is_not_refused(self, bench: PosesBench) -> None:
        assert list(pose_complaints(bench.config)) == []
