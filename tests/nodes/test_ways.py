"""The way to the start before a run, and to the park after it: phases of their own, with every check and gate."""

import math

import numpy as np
import pytest

from robofleet.bus.keys import STATE, key
from robofleet.bus.messages import RUN_STATE
from robofleet.config import groups
from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.core.refusal import RefusedError
from robofleet.operator import run_command
from robofleet.recording.run import Run
from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Event, Phase
from tests.shipped import PLATOON

ANYWHERE = [
    "robots.0.start={x_m: 1.2, y_m: -0.5, heading_deg: 20}",
    "robots.1.start={x_m: 0.2, y_m: -0.5, heading_deg: 120}",
    "robots.2.start={x_m: -0.2, y_m: 0.5, heading_deg: 20}",
    "robots.3.start={x_m: 0.9, y_m: 0.6, heading_deg: 200}",
]
PARKS = [f"robots.{k}.park={{x_m: {1.2 - 0.3 * k:.1f}, y_m: -0.7, heading_deg: 90}}" for k in range(4)]
FAST = ["tracker.source=truth", "run.bounds={}"]


def configured(*overrides: str) -> Config:
    return load_checked(PLATOON, [*FAST, *overrides], lockstep=True)


def phases(run: Lockstep) -> list[int]:
    payloads = run.recording.messages[key("platoon", STATE)]
    states = [state.phase for payload in payloads if (state := RUN_STATE.decode(payload)) is not None]
    return [phase for k, phase in enumerate(states) if k == 0 or phase != states[k - 1]]


@pytest.fixture(scope="module")
def there_and_back() -> Lockstep:
    run = Lockstep(configured(*ANYWHERE, *PARKS, "run.begin=go_to_start", "run.end=park", "run.duration_s=3"))
    assert run.run() == ("completed", None)
    return run


@pytest.mark.slow
def test_a_run_goes_to_its_start_drives_and_parks(there_and_back: Lockstep) -> None:
    order = [Phase.IDLE, Phase.ARMED, Phase.POSITIONING, Phase.RUNNING, Phase.PARKING, Phase.IDLE]
    assert phases(there_and_back) == order


@pytest.mark.slow
def test_the_robots_stand_at_their_places_when_the_run_begins_and_in_the_park_at_its_end(
    there_and_back: Lockstep,
) -> None:
    config, run = there_and_back.recording.config, Run(there_and_back.recording)
    places = np.array(list(groups.starts_of(config).values()))
    first = run.poses()[0]
    assert np.hypot(*(first[:, :2] - places[:, :2]).T).max() < 0.005
    assert np.abs(np.remainder(first[:, 2] - places[:, 2] + math.pi, math.tau) - math.pi).max() < math.radians(3)
    parked = np.array(list(groups.parks_of(config).values()))
    whole = Run(there_and_back.recording, every_tick=True)
    assert np.hypot(*(whole.poses()[-1][:, :2] - parked[:, :2]).T).max() < 0.005


@pytest.mark.slow
def test_only_the_run_itself_is_counted(there_and_back: Lockstep) -> None:
    run = Run(there_and_back.recording)
    assert run.t[-1] == pytest.approx(3.0, abs=0.05)
    assert (run.ticks["phase"] == Phase.RUNNING).all()


@pytest.mark.slow
def test_a_hold_on_the_way_goes_on_with_the_way() -> None:
    run = Lockstep(configured(*ANYWHERE, "run.begin=go_to_start", "run.duration_s=1"))
    run.request(b"start")
    assert run.advance(60.0, lambda: run.status.phase is Phase.POSITIONING)
    run.request(b"hold")
    assert run.advance(1.0, lambda: run.status.phase is Phase.HOLD)
    run.request(b"resume")
    assert run.advance(1.0, lambda: run.status.phase is Phase.POSITIONING)
    assert run.advance(60.0, lambda: run.status.phase is Phase.RUNNING)
    assert run.status.cause is Event.AT_START
    run.close()


@pytest.mark.slow
def test_an_operator_parks_a_run_that_is_held() -> None:
    run = Lockstep(configured(*PARKS))
    run.request(b"start")
    assert run.advance(60.0, lambda: run.status.phase is Phase.RUNNING)
    run.request(b"hold")
    assert run.advance(1.0, lambda: run.status.phase is Phase.HOLD)
    run.request(b"park")
    assert run.advance(60.0, lambda: run.status.phase is Phase.IDLE)
    assert run.status.cause is Event.PARKED
    run.close()


@pytest.mark.parametrize(
    ("overrides", "key", "words"),
    [
        (["run.end=park"], "robots.0.park", "is missing: run.end: park must know where r1 is to go"),
        (["run.end=park", *PARKS[:3]], "robots.3.park", "is missing"),
        (
            ["run.end=park", *PARKS[:3], "robots.3.park={x_m: 2.0, y_m: 0, heading_deg: 0}"],
            "robots.3.park",
            "from the edge",
        ),
        (
            ["run.end=park", *PARKS[:3], "robots.3.park={x_m: 1.2, y_m: -0.65, heading_deg: 0}"],
            "robots.3.park",
            "goals of r1 and r4",
        ),
    ],
)
def test_a_park_that_cannot_be_reached_is_refused(overrides: list[str], key: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        configured(*overrides)
    assert any(key in fault and words in fault for fault in refused.value.faults)


def test_go_makes_a_group_of_those_that_are_named() -> None:
    config = configured(*run_command.goal_overrides(["r2=0.5,0.2,90", "r4=-0.5,0.2,0"]))
    assert [robot.id for robot in config.members] == ["r2", "r4"]
    run = Lockstep(config)
    assert run.run() == ("completed", None)
    assert run.status.cause in (Event.ACCOMPLISHED, Event.STOP_REQUESTED)
    x, y, psi = Run(run.recording).poses()[-1, 0]
    assert math.dist((x, y), (0.5, 0.2)) < 0.005
    assert abs(math.remainder(psi - math.pi / 2, math.tau)) < math.radians(3)


@pytest.mark.parametrize("goal", ["r1", "r1=1,2", "r1=a,b,c", "=1,2,3", "r1=1,2,3,4"])
def test_a_goal_that_is_none(goal: str) -> None:
    with pytest.raises(RefusedError, match="write ROBOT=X,Y,DEG in metres and degrees"):
        run_command.goal_overrides([goal])
