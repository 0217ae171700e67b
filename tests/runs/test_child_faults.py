"""Timed faults of a real run: its processes are killed and stopped by the launcher."""

from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.config.load import ConfigError
from robofleet.runs.check import load_checked
from tests.runs.realrun import PLATOON, RealRun, of_robots

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("{kind: killed, process: driver-r2, at_s: 0.5}", "r2: the driver went silent"),
        ("{kind: stopped, process: driver-r2, at_s: 0.5, duration_s: 5}", "r2: the driver went silent"),
    ],
)
def test_what_was_to_be_killed_or_stopped_is_what_the_supervisor_names(
    real_run: Callable[..., RealRun], fault: str, cause: str
) -> None:
    run = real_run(*of_robots("r1", "r2"), "--set", "drivers.robots_per_process=1", "--set", f"faults=[{fault}]")
    run.wait_until_running()
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert (run.summary["outcome"], run.summary["cause"]) == ("fault", f"{cause}: its log is in the run's folder")


@pytest.mark.parametrize("fault", ["{kind: clock_step, process: controller, step_s: 1.0}", "{kind: second_controller}"])
def test_what_only_lockstep_can_do_is_refused_in_real_time(fault: str) -> None:
    with pytest.raises(ConfigError, match=r"faults\.0\.kind: .* add --lockstep"):
        load_checked(PLATOON, [f"faults=[{fault}]"])
    assert load_checked(PLATOON, [f"faults=[{fault}]"], lockstep=True).faults


@pytest.mark.parametrize("kind", ["motor_stuck", "slip"])
def test_the_body_of_a_real_robot_has_no_faults_on_demand(kind: str) -> None:
    driver = f"robots.1.driver='{__name__}:Real'"
    with pytest.raises(ConfigError, match=r"faults\.0\.robot: r2 is real"):
        load_checked(PLATOON, [driver, f"faults=[{{kind: {kind}, robot: r2}}]"])


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "{kind: motor_stck, robot: r1}",
            "2:12: faults.0.kind: there is no kind 'motor_stck': did you mean 'motor_stuck'?",
        ),
        ("{robot: r1}", "2:5: faults.0.kind: is missing"),
        ("{kind: slip, robot: r9}", "2:25: faults.0.robot: there is no robot 'r9'"),
        ("{kind: killed, process: contoller}", "2:29: faults.0.process: there is no process 'contoller': did you mean"),
        ("{kind: network_cut, processes: [tracker, recorder]}", "2:44: faults.0.processes.1: there is no process 'rec"),
        ("{kind: lost, topics: [cmd, clock]}", "2:32: faults.0.topics.1: must be 'cmd'"),
        ("{kind: late, topics: [cmd], median_s: 1.0}", "faults.0.p99_s: must be more than the median"),
        ("{kind: lost, topics: [state], robot: r1}", "2:42: faults.0.robot: state is not said to one robot"),
        ("{kind: slip, robot: r1, at_s: 1000}", "2:35: faults.0.at_s: the run ends after 88 s"),
        ("{kind: slip, robot: r1, sigma_m: 1.0}", "2:29: faults.0.sigma_m: unknown key: known: at_s, duration_s"),
    ],
)
def test_a_bad_file_of_faults_is_a_line_each(tmp_path: Path, text: str, line: str) -> None:
    file = tmp_path / "f.yaml"
    file.write_text(f"faults:\n  - {text}\n")
    with pytest.raises(ConfigError) as refused:
        load_checked(PLATOON, [], file, lockstep=True)
    (fault,) = refused.value.faults
    assert fault.startswith(str(file))
    assert line in fault


class Real:
    """A robot that exists: it knows no truth."""

    def read(self) -> None: ...
    def write(self, wheels: object) -> None: ...
    def close(self) -> None: ...
