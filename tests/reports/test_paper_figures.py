"""The paper's figures of a run: what they draw, and whether the words beside them say what the run did."""

from collections.abc import Callable

import numpy as np
import pytest

from robofleet.recording.run import Run
from robofleet.reports.canvas import Plot, RunView
from robofleet.reports.plots import sections
from tests.recording_fixtures import Story

Make = Callable[..., Story]
SECTION = "The paper's figures"


def plots(story: Story) -> dict[str, Plot]:
    found = sections(RunView(Run(story.recording()), {"stops": []})).get(SECTION, [])
    return {plot.title.partition(":")[0]: plot for plot in found}


def this_run(plot: Plot) -> str:
    """Return what a caption says of the run."""
    paper, _, run = plot.caption.partition(" This run: ")
    assert paper.startswith("The paper: ")
    return run


def test_a_run_that_does_what_the_paper_says_agrees(story: Make) -> None:
    run = story(ticks=400)
    run.control_error[:] = 0.005
    captions = {title: this_run(plot) for title, plot in plots(run).items()}
    assert list(captions) == ["Fig. 14", "Fig. 15", "Fig. 16", "Fig. 17", "Fig. 18"]
    assert "differ by at most 0.0 mm. It agrees." in captions["Fig. 14"]
    assert captions["Fig. 15"] == "it is fastest at t = 10.0 s, with 0.129 m/s. It agrees."
    assert captions["Fig. 16"] == "after 5 s they are at most 0.0 mm away from it. It agrees."
    assert captions["Fig. 17"] == "5.00 mm, as large. These robots are simulated. It agrees."
    assert captions["Fig. 18"].startswith("after 5 s their means are 25.00, 25.00, 25.00 cm; at these times")
    assert captions["Fig. 18"].endswith("0.00 cm off. It agrees.")


def test_a_run_that_does_something_else_differs(story: Make) -> None:
    run = story(ticks=200)
    run.place((0.0, 0.0, 0.04, 0.0))
    run.aside(0.02)
    run.control_error[:] = 0.02
    captions = {title: this_run(plot) for title, plot in plots(run).items()}
    assert "It differs." in captions["Fig. 14"] and "20.0 mm away from it. It differs." in captions["Fig. 16"]
    assert captions["Fig. 15"] == "it ended before 9.5 s."
    assert captions["Fig. 17"] == "20.00 mm, larger. These robots are simulated. It differs."
    assert captions["Fig. 18"].endswith("cm. It differs.")


def test_a_reference_that_began_elsewhere_is_fastest_at_another_time(story: Make) -> None:
    run = story(ticks=400)
    run.origin = 0.0455 * (54.0 - 5.0)  # 5 s before the second time of highest speed
    assert this_run(plots(run)["Fig. 15"]) == "it is fastest at t = 5.0 s, with 0.129 m/s. It differs."


def test_smaller_errors_are_neither_agreement_nor_difference(story: Make) -> None:
    run = story(ticks=100)
    run.control_error[:] = 0.001
    assert this_run(plots(run)["Fig. 17"]) == "1.00 mm, smaller. These robots are simulated."


def test_trajectories_begin_where_the_points_were(story: Make) -> None:
    run = story(ticks=60)
    view = RunView(Run(run.recording()), {"stops": []})
    figure = plots(run)["Fig. 16"].draw(view)
    assert figure is not None
    (axes,) = figure.axes
    dots = [line.get_xydata()[0] for line in axes.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(dots, run.points[0], atol=1e-6)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("x, m", "y, m", 1.0)


@pytest.mark.parametrize("change", ["groups.0.settings.spacing_m=0.3", "controller.alpha=40"])
def test_another_platoon_has_none(change: str, story: Make) -> None:
    assert plots(story(change, ticks=40)) == {}
