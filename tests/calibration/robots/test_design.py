"""The proposed drive: what it promises is what the fit states afterwards, and it is better than some of each kind."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.behaviours.excitation import Excitation, Manoeuvre, of_each_kind, there_and_back
from robofleet.calibration.robots.design import Design, Designer, design, manoeuvres
from robofleet.calibration.robots.identified import with_identified
from robofleet.calibration.robots.information import DETERMINED, PARAMETERS
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.vehicles.differential_drive import body_from_wheels
from tests.robots import GTERNAL
from tests.shipped import PLATOON

from .conftest import Make, found, shots

SPIN = Manoeuvre(left_rad_s=-5.0, right_rad_s=5.0, duration_s=2.0)
LINE = Manoeuvre(left_rad_s=8.0, right_rad_s=8.0, duration_s=2.0)
CREEP = Manoeuvre(left_rad_s=-1.5, right_rad_s=1.5, duration_s=1.5, ramp=True)
FASTEST = Manoeuvre(left_rad_s=12.5, right_rad_s=12.5, duration_s=1.5)


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config(PLATOON)


@pytest.fixture(scope="module")
def designer(config: Config) -> Designer:
    return Designer(config, config.robots[0])


def test_a_manoeuvre_tells_what_it_excites(designer: Designer) -> None:
    before = dict(zip(PARAMETERS, designer.sigmas(designer.known), strict=True))

    def excited(each: Manoeuvre) -> set[str]:
        after = designer.sigmas(designer.known + designer.tells(each))
        return {name for name, sigma in zip(PARAMETERS, after, strict=True) if sigma < DETERMINED * before[name]}

    assert {"deadband_rad_s", "breakaway_rad_s"} <= excited(CREEP)
    assert {"tag_forward_m", "tag_left_m"} <= excited(SPIN)
    assert not {"deadband_rad_s", "breakaway_rad_s", "top_speed_rad_s"} & excited(SPIN)
    assert "top_speed_rad_s" in excited(FASTEST)
    assert not {"wheel_base_m", "deadband_rad_s", "slip_s_per_rad"} & excited(LINE)


def test_knowledge_adds_up_and_more_never_tells_less(designer: Designer) -> None:
    creep = designer.known + designer.tells(CREEP)
    both = creep + designer.tells(SPIN)
    assert (designer.sigmas(both) <= designer.sigmas(creep) * (1 + 1e-9)).all()
    assert designer.log_determinant(both) < designer.log_determinant(creep) < designer.log_determinant(designer.known)


@pytest.mark.parametrize("line_m", [0.0, 0.1, 0.3])
def test_candidates_keep_wheels_limits_and_the_free_line(line_m: float) -> None:
    for each in manoeuvres(GTERNAL, line_m):
        at = 0.0
        for spell in there_and_back(GTERNAL, each, 0.0):
            assert max(abs(spell.left), abs(spell.right)) <= GTERNAL.max_wheel_speed
            v, omega = body_from_wheels(spell.left, spell.right, GTERNAL.wheel_radius, GTERNAL.wheel_base)
            assert abs(v) <= GTERNAL.max_speed + 1e-12
            at += v * (spell.end - spell.start) * (0.5 if each.ramp else 1.0)
            if not omega and each.times == 1:
                assert abs(at) <= line_m + 1e-9


@pytest.fixture(scope="module")
def proposed(config: Config) -> Design:
    return design(config, config.robots[0], 30.0)


@pytest.mark.slow
def test_what_is_expected_is_what_the_fit_states(driven: Make, config: Config, proposed: Design) -> None:
    """The poses are noisier than it believed. What was found is what the next proposal begins with."""
    assert proposed.duration_s <= 30.0
    robot, drive = config.robots[0], driven(manoeuvres=proposed.manoeuvres)
    identified = found(drive)
    stated = np.sqrt(np.diag(identified.covariance))
    determined = [name in identified.determined for name in PARAMETERS]
    assert {"wheel_base_m", "delay_s", "deadband_rad_s", "breakaway_rad_s"} <= set(identified.determined)
    assert ((stated / proposed.expected)[determined] < 3.0).all()
    known = with_identified(config, robot, RobotCalibration(robot="r1"), identified, [shots(drive)], {})
    again = Designer(config, robot.model_copy(update={"calibration": known}))
    assert again.sigmas(again.known) == pytest.approx(stated, rel=0.03)


@pytest.mark.slow
def test_it_tells_more_than_some_of_each_kind(designer: Designer, proposed: Design) -> None:
    def volume(chosen: tuple[Manoeuvre, ...]) -> float:
        knowledge = designer.known
        for each in chosen:
            knowledge += designer.tells(each)
        return designer.log_determinant(knowledge)

    some = of_each_kind(GTERNAL)
    lasts_s = sum(list(there_and_back(GTERNAL, each, 0.0))[-1].end for each in some)
    assert proposed.duration_s < lasts_s
    assert volume(proposed.manoeuvres) < volume(some) - 2.0


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Result]:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(cli.app, [*map(str, arguments)])


@pytest.mark.slow
def test_the_command_writes_a_drive_that_can_be_run(run: Callable[..., Result], tmp_path: Path) -> None:
    done = run("calibrate", "drive", PLATOON, "--robots", "r3", "--seconds", "8", "--out", "drive.yaml")
    assert done.exit_code == 0, done.output
    assert "dead band" in done.stdout
    assert "robofleet run drive.yaml" in done.stdout
    (group,) = load_config(tmp_path / "drive.yaml").groups
    assert group.robots == ("r3", "r1", "r2", "r4")
    assert list(Excitation.Settings.model_validate(group.settings).manoeuvres) == ["r3"]
    assert load_config(tmp_path / "drive.yaml").run.duration_s < 9.0
    assert run("check", "drive.yaml").exit_code == 0


def test_bad_input_is_a_line_and_nothing_is_written(run: Callable[..., Result], tmp_path: Path) -> None:
    for arguments, says in (
        (("--robots", "r9"), "there is no robot 'r9'"),
        (("--seconds", "1"), "5"),
        (("--out", tmp_path), "is a folder: name a file"),
    ):
        done = run("calibrate", "drive", PLATOON, "--robots", "r1", "--seconds", "5", *arguments)
        assert done.exit_code == 2
        assert says in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == []
