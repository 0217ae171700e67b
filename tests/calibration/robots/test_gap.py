"""The gap of recorded runs to their simulation, and of several runs over days."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from robofleet import cli
from robofleet.bus.keys import STATE, key
from robofleet.calibration.robots import gap, gap_curve
from robofleet.calibration.robots.gap_curve import Day
from robofleet.config.load import load_config
from robofleet.config.tree import Bounds, Config
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.reports.bounds import judged
from robofleet.reports.predicted import Gap, GapFigure, RobotGap
from tests.shipped import PLATOON

RECORDED = Path(__file__).parents[2] / "recordings"


def test_a_run_has_no_gap_to_itself() -> None:
    recording = read(RECORDED / "platoon.mcap")
    found, robots = gap.figures(recording, recording)
    closed = [each for each in found if "by the commands" not in each.name]
    assert {"control error", "exposure to tick"} <= {each.name for each in closed}
    assert all(each.ratio == pytest.approx(1.0) for each in closed)
    assert all(each.low <= 1.0 <= each.high for each in closed)
    assert {each.robot for each in robots} <= {"r1", "r2", "r3", "r4"}


def test_a_gap_is_judged_where_somebody_measured_it() -> None:
    bounds = Bounds(gap=1.2)
    assert judged({}, bounds) == []
    for worst, met in ((1.1, True), (1.3, False)):
        (verdict,) = judged({"gap": {"worst": worst}}, bounds)
        assert verdict["pass"] == met


def test_a_run_that_is_too_short_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended before the controller's first tick."""
    monkeypatch.chdir(tmp_path)
    recording, run = read(RECORDED / "platoon.mcap"), tmp_path / "short"
    run.mkdir()
    state = key(recording.config.arena.name, STATE)
    with RunLog(run / FILE, recording.config, drawn=False) as log:
        log.add(state, recording.messages[state][0], 0)
    done = CliRunner().invoke(cli.app, ["gap", "short", "--configs", str(tmp_path)])
    assert done.exit_code == 2
    assert "short: it is too short to compare: record some seconds of driving" in " ".join(done.stderr.split())
    assert [file.name for file in run.iterdir()] == [FILE]


@pytest.mark.parametrize(("sources", "simulated"), [(("simulated",) * 2, "camera"), (("simulated", "v4l2"), "truth")])
def test_poses_of_a_camera_that_is_not_simulated_come_from_the_truth(sources: tuple[str, ...], simulated: str) -> None:
    """One real camera of several is enough."""
    config: Config = load_config(PLATOON.parent / "two-cameras.yaml")
    cameras = tuple(
        camera.model_copy(update={"source": source}) for camera, source in zip(config.cameras, sources, strict=True)
    )
    config = config.model_copy(update={"cameras": cameras, "camera": cameras[0]})
    assert gap.simulated(config, Recording(config), []).tracker.source == simulated


def day(number: int, **ratios: tuple[float, float, float]) -> Day:
    """Return a day on which robots had these ratios, with their intervals."""
    robots = tuple(
        RobotGap(
            robot=robot,
            figure=GapFigure(
                name="pose after 5 s", unit="mm", recorded=2.0 * ratio - 1.0, simulated=1.0,
                ratio=max(ratio, 1 / ratio),
                low=low if ratio >= 1 else 1 / high, high=high if ratio >= 1 else 1 / low,
            ),
        )
        for robot, (ratio, low, high) in ratios.items()
    )  # fmt: skip
    worst = max((each.figure for each in robots), key=lambda figure: figure.ratio)
    return Day(f"day{number}", f"2026-01-0{number}T08:00:00Z", Gap(figures=(worst,), robots=robots))


def test_a_robot_that_wears_is_named_since_when_and_no_other() -> None:
    days = [
        day(1, r1=(1.0, 0.9, 1.1), r2=(1.0, 0.9, 1.1), r3=(0.8, 0.7, 0.9)),
        day(2, r1=(1.2, 1.05, 1.3), r2=(1.3, 1.2, 1.4), r3=(0.9, 0.85, 1.0)),  # r1 as well as before, in its interval
        day(3, r1=(1.4, 1.3, 1.5), r2=(1.0, 0.9, 1.2), r3=(0.8, 0.7, 0.9)),  # r2 was worse on one day only
        day(4, r1=(1.6, 1.5, 1.7), r2=(1.0, 0.9, 1.2), r3=(0.7, 0.6, 0.8)),
    ]
    (line,) = gap_curve.worn(days)
    assert line.startswith("r1: since day3 its predictions are worse than in day1")
    assert gap_curve.worn(days[:1]) == []
    _, rows = gap_curve.table(days)
    assert [row[-2:] for row in rows] == [("r1", "1.00"), ("r2", "1.30"), ("r1", "1.40"), ("r1", "1.60")]
