"""The page about a run: honest about what went well, what did not and what was not measured; and it stands alone."""

import html
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robofleet.config.load import load_config
from robofleet.core.figures import robot_colours
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.run import Recording, Run
from robofleet.reports import report
from robofleet.reports.canvas import Plot
from robofleet.safety.latches import GateStatus
from tests.command import robofleet
from tests.recording.recorded import in_order
from tests.recording_fixtures import Story
from tests.shipped import PLATOON

Make = Callable[..., Any]
TITLES = [
    "On the time axis", "Paths of the points", "Control error", "Timed error", "Path error", "Centre error", "Spacing",
    "Fig. 14: stills", "Fig. 15: reference speed", "Fig. 16: trajectories", "Fig. 17: control errors",
    "Fig. 18: spacings", "Wheels", "The filter against the truth", "Distribution",
    "From the image to the wheel", "Ticks",
]  # fmt: skip
MANY = 100


@pytest.fixture
def page(figures: Make, tmp_path: Path) -> Callable[..., str]:
    """Return what writes a recording's page and reads it."""

    def write(recording: Recording, **ended: str) -> str:
        return report.write(Run(recording), figures(recording) | ended, tmp_path).read_text()

    return write


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the plots out: they take their time."""
    monkeypatch.setattr(report, "sections", lambda view: {})


def of_title(sections: dict[str, list[Plot]], title: str) -> Plot:
    (found,) = (plot for plots in sections.values() for plot in plots if plot.title == title)
    return found


def words(page: str) -> str:
    """Return what a person reads."""
    return html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"<(style|svg).*?</\1>", "", page, flags=re.DOTALL)))


def verdict(page: str) -> tuple[str, str]:
    """Return the colour of the verdict and its words."""
    (found,) = re.findall(r'<p class="verdict ?(\w*)">(.*?)</p>', page, flags=re.DOTALL)
    return found[0], words(found[1]).strip()


def plots(page: str) -> list[str]:
    return [html.unescape(title) for title in re.findall(r"<figure><h3>(.*?)</h3>", page)]


def test_a_good_run_is_green_and_has_every_plot(story: Make, page: Make, add_status: Make, add_image: Make) -> None:
    run = story("run.bounds.overruns=30")
    recording = run.recording()
    for k in range(10, 200, 10):
        add_status(recording, "r1", run.stamp(k), applied=(run.stamp(k) - 19_000_000, run.stamp(k)))
        add_image(recording, run.stamp(k), (1, 2, 3, 4))
    text = page(recording)
    assert verdict(text)[0] == "good"
    assert "Completed, every bound met" in verdict(text)[1]
    assert plots(text) == TITLES
    assert text.count("✗") == 0
    assert "at a wheel: 19.0 ms" in words(text)
    for robot, colour in zip(("r1", "r2", "r3", "r4"), robot_colours(4), strict=True):
        assert text.count(f'<i style="background:{colour}"></i>{robot}</span>') >= 4
        assert text.count(f"stroke: {colour}") > 8, "every plot draws a robot in its own colour"


@pytest.mark.usefixtures("plain")
def test_a_bound_that_was_not_met_makes_it_red_and_says_by_how_much(story: Make, page: Make) -> None:
    run = story("run.bounds={control_error_mean_mm: 1.0, path_error_mean_mm: 4}")
    run.control_error[:] = 0.0025
    colour, shown = verdict(page(run.recording()))
    assert colour == "bad"
    assert "1 of 2 bounds not met" in shown
    assert "control error, mean: 2.5 mm; limit 1 mm" in shown


@pytest.mark.usefixtures("plain")
def test_without_bounds_it_says_how_to_ask_for_some(story: Make, page: Make) -> None:
    text = words(page(story("run.bounds={}").recording()))
    assert "no figure was checked" in text
    assert "bounds: {control_error_mean_mm" in text


@pytest.mark.usefixtures("plain")
def test_a_fault_is_said_first_and_stops_are_listed(story: Make, page: Make, add_status: Make) -> None:
    run = story()
    recording = run.recording()
    for k, gate in ((10, GateStatus.OPEN), (20, GateStatus.NO_ENABLE)):
        add_status(recording, "r2", run.stamp(k), gate=gate)
    colour, shown = verdict(text := page(recording, outcome="fault", cause="r2: <its own> e-stop"))
    assert colour == "bad"
    assert shown.startswith("Ended by a fault: r2: <its own> e-stop")
    assert "1 unrequested stop" in shown
    assert "0.66 0.66 r2 no permission of the supervisor arrived" in " ".join(words(text).split())


@pytest.mark.slow
def test_without_the_truth_it_says_what_is_not_known(story: Make, page: Make) -> None:
    text = page(story().recording(truth=False))
    assert set(TITLES) - set(plots(text)) == {
        "Timed error", "Path error", "Centre error", "The filter against the truth", "Distribution",
        "From the image to the wheel",
    }  # fmt: skip
    assert words(text).count("true poses are known of simulated robots only") == 5
    assert "nan" not in words(text)


@pytest.mark.slow
@pytest.mark.parametrize("ticks", [1, 2])
def test_a_run_of_a_few_ticks_has_a_page(story: Make, page: Make, ticks: int) -> None:
    assert "Control error" in plots(page(story(ticks=ticks).recording()))


def test_a_run_that_did_not_start_says_why_and_shows_no_empty_plot(
    story: Make, page: Make, add_state: Make, add_status: Make
) -> None:
    recording = Recording(story().config)
    add_status(recording, "r1", 5_000_000_000)
    colour, shown = verdict(text := page(recording, outcome="fault", cause="r1: its wheels are swapped"))
    assert colour == "bad"
    assert shown.startswith("Did not start: r1: its wheels are swapped")
    assert plots(text) == [TITLES[0]]
    assert "never drove" in words(text)


@pytest.mark.usefixtures("plain")
def test_a_file_that_broke_off_and_messages_that_are_missing_are_said(story: Make, page: Make) -> None:
    recording = story().recording()
    recording.trouble, recording.dropped = "ends before its index", 1234
    text_shown = verdict(page(recording))[1]
    assert "ends before its index" in text_shown
    assert "1,234 messages" in text_shown


@pytest.mark.slow
def test_one_robot_alone_has_a_page(story: Make, page: Make) -> None:
    text = page(story("groups.0.robots=[r3]", "run.bounds={}").recording())
    assert "Spacing. Not measured: it needs more robots" in words(text)


@pytest.mark.long
def test_a_hundred_robots_fit_into_two_megabytes(page: Make) -> None:
    config = load_config(PLATOON)
    robot = config.robots[0]
    robots = tuple(robot.model_copy(update={"id": f"r{k}", "tag": k}) for k in range(MANY))
    settings = config.groups[0].settings | {"spacing_m": 0.03}
    group = config.groups[0].model_copy(update={"robots": tuple(r.id for r in robots), "settings": settings})
    run = Story(config.model_copy(update={"robots": robots, "groups": (group,)}), 150)
    text = page(run.recording())
    assert len(text) < 2_000_000
    assert 'href="data:image/png' in text, "so many lines are drawn as pixels"
    assert len(set(robot_colours(MANY))) > 60


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere_and_the_same_run_gives_the_same_page(story: Make, page: Make) -> None:
    first = page(story(ticks=20).recording())
    assert not re.search(r'(src|href)="(?!#|data:)', first)
    assert "<script" not in first
    assert "url(http" not in first
    assert page(story(ticks=20).recording()) == first


@pytest.mark.slow
def test_every_figure_is_a_file_for_a_paper_too_and_the_page_links_it(
    story: Make, figures: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = report.sections
    monkeypatch.setattr(report, "sections", lambda view: {"One": [of_title(every(view), "Control error")]})
    recording, folder = story(ticks=20).recording(), tmp_path / "my paper"
    page = report.write(Run(recording), figures(recording), tmp_path, folder).read_text()
    assert re.findall(r'href="([^"#]+)"', page) == ["my%20paper/control-error.svg", "my%20paper/control-error.pdf"]
    svg, pdf = (folder / "control-error.svg").read_text(), (folder / "control-error.pdf").read_bytes()
    for colour in robot_colours(4):
        assert f"stroke: {colour}" in svg
    assert "<!-- r4 -->" in svg, "the legend is in the file"
    assert pdf.startswith(b"%PDF")
    assert b"/Type3" not in pdf
    report.write(Run(recording), figures(recording), tmp_path, folder)
    assert ((folder / "control-error.svg").read_text(), (folder / "control-error.pdf").read_bytes()) == (svg, pdf)


@pytest.mark.usefixtures("plain")
def test_an_aborted_run_says_its_cause_first_and_no_bound_that_was_not_judged(story: Make, page: Make) -> None:
    recording = story("run.bounds.overruns=30").recording(truth=False)
    text = page(recording, outcome="stopped", cause="the operator interrupted")
    lines = [line.strip() for line in verdict(text)[1].splitlines()]
    assert lines[0] == "Stopped: the operator interrupted"
    assert lines[-1] == "4 of 8 limits were not checked: the run ended too early."
    assert "not measured, " not in words(text)
    assert "\N{BALLOT X}" not in words(text)
    assert words(text).count("not checked") >= 5


@pytest.fixture
def kept(tmp_path: Path) -> Callable[..., Path]:
    """Return what keeps a hand-made run in a folder, as its recorder does."""

    def keep(run: Story, name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        recording = run.recording()
        with RunLog(folder / FILE, run.config) as log:
            for index, (full, payload) in enumerate(in_order(recording)):
                log.add(full, payload, index)
        return folder

    return keep


@pytest.mark.usefixtures("plain")
def test_the_command_writes_page_and_columns_beside_the_recording(story: Make, kept: Make) -> None:
    folder = kept(story("run.bounds={path_error_mean_mm: 4}"), "one")
    for named in (folder, folder / FILE):
        result = robofleet("report", named)
        assert (result.exit_code, result.stderr) == (0, "")
        assert result.stdout.strip() == str(folder / "report.html")
        assert (folder / "metrics.csv").read_text().count("\n") == 1 + 300 * 4
        for made in ("report.html", "metrics.csv"):
            (folder / made).unlink()


@pytest.mark.usefixtures("plain")
def test_the_command_ends_with_1_where_a_bound_was_not_met(story: Make, kept: Make) -> None:
    run = story("run.bounds={path_error_mean_mm: 4}")
    run.aside(0.005)
    result = robofleet("report", folder := kept(run, "one"))
    assert result.exit_code == 1
    assert result.stderr == "bound not met: path error, mean: 5 mm; limit 4 mm\n"
    assert (folder / "report.html").exists()


def test_bad_input_is_one_line_and_exit_code_2(story: Make, kept: Make, tmp_path: Path) -> None:
    run_folder = kept(story(ticks=3), "one")
    (tmp_path / "text.mcap").write_text("no recording")
    for arguments, message in (
        ((tmp_path / "nowhere",), "there is no such recording"),
        ((tmp_path / "text.mcap",), "not a recording"),
        ((run_folder, tmp_path / "nowhere"), "there is no such recording"),
        ((run_folder, "--out", tmp_path / "two.html"), "--out: one run's report stands in its folder"),
        ((run_folder, run_folder, "--out", run_folder / FILE / "page.html"), "cannot be written"),
    ):
        result = robofleet("report", *arguments)
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        (line,) = result.stderr.splitlines()
        assert message in line
    assert not (run_folder / "report.html").exists()
