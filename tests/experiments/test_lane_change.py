"""Table 2 in both readings of eq. 26, this project's setting, and delay."""

from typing import Any

import numpy as np
import pytest

from robofleet.control.bicycle import bicycle_plant
from robofleet.experiments import lane_change
from robofleet.experiments.curves import lane_change as curve
from robofleet.experiments.lane_change import LaneChangeParameters
from robofleet.experiments.paper import parameters_of
from robofleet.experiments.results import Result
from robofleet.experiments.simulate import DivergedError, drive
from robofleet.vehicles.bicycle import FALCONE_2007

SPEEDS = ("10 m/s", "15 m/s", "19 m/s")


@pytest.fixture(scope="module")
def result() -> Result:
    parameters: LaneChangeParameters = parameters_of("lane-change")
    return lane_change.run(parameters)


def column(result: Result, title: str, name: str) -> list[Any]:
    (table,) = (table for table in result.tables if title in table.title)
    return [row[table.columns.index(name)] for row in table.rows]


def row(result: Result, title: str, *head: str) -> list[Any]:
    """Return the speeds' cells of the row that begins with ``head``."""
    (table,) = (table for table in result.tables if title in table.title)
    (found,) = (found for found in table.rows if found[: len(head)] == head)
    return [found[table.columns.index(speed)] for speed in SPEEDS]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_curve_is_eq_26_by_arc_length(sign: float) -> None:
    reference = curve(sign, 300.0)
    x, y = reference.position(np.linspace(0.0, 300.0, 5_000)).T
    w1, w2 = 2.4 / 25.0 * (x - 27.19) - 1.2, 2.4 / 21.95 * (x - 56.46) - 1.2
    assert y == pytest.approx(2.025 * (1.0 + np.tanh(w1)) + sign * 2.85 * (1.0 + np.tanh(w2)), abs=1e-7)
    assert x[0] == 0.0
    dense = np.linspace(0.0, x[-1], 1_000_001)
    w1, w2 = 2.4 / 25.0 * (dense - 27.19) - 1.2, 2.4 / 21.95 * (dense - 56.46) - 1.2
    height = 2.025 * (1.0 + np.tanh(w1)) + sign * 2.85 * (1.0 + np.tanh(w2))
    assert np.hypot(np.diff(dense), np.diff(height)).sum() == pytest.approx(300.0, abs=1e-6)


def test_an_open_curve_is_not_extrapolated() -> None:
    with pytest.raises(ValueError, match=r"300\.0 m long, but asked for 0\.0 to 301\.0 m"):
        curve(1.0, 300.0).position(np.array([0.0, 301.0]))


@pytest.mark.parametrize(
    ("reading", "lateral", "heading"),
    [("as printed", [9.3, 18.0, 25.4], [2.5, 2.4, 2.8]), ("minus sign", [7.5, 15.6, 23.9], [2.4, 2.35, 2.2])],
)
@pytest.mark.long
def test_both_readings(result: Result, reading: str, lateral: list[float], heading: list[float]) -> None:
    assert column(result, "lateral", reading) == pytest.approx(lateral, abs=0.5)
    assert column(result, "heading", reading) == pytest.approx(heading, abs=0.1)


@pytest.mark.long
def test_the_minus_sign_is_near_table_2(result: Result) -> None:
    assert column(result, "lateral", "paper") == [7.0, 16.0, 25.0]
    assert column(result, "lateral", "minus sign") == pytest.approx([7.0, 16.0, 25.0], abs=1.5)
    assert column(result, "heading", "minus sign") == pytest.approx([2.2, 2.2, 2.1], abs=0.3)
    assert column(result, "lateral", "Falcone 07") == [96.0, 125.0, 158.0]


@pytest.mark.long
def test_control_error_and_acceleration_are_the_paper_s(result: Result) -> None:
    for reading in ("as printed", "minus sign"):
        assert max(row(result, "transient", "control error, later, cm", reading)) < 10.0
        assert max(row(result, "transient", "acceleration, later, m/s²", reading)) < 0.5
        assert max(row(result, "transient", "acceleration, start, m/s²", reading)) == pytest.approx(1.5, abs=0.25)


@pytest.mark.long
def test_control_error_peaks_where_the_curve_turns_sharply(result: Result) -> None:
    at = result.data["control_error_peaks_at_z1_m"]["as printed"]
    for z1 in (52.0, 85.0):  # III-B
        assert min(abs(found - z1) for found in at) < 3.0


@pytest.mark.long
def test_own_setting_is_below_a_centimetre_with_and_without_delay(result: Result) -> None:
    without = row(result, "delay", "own", "no delay", "lateral, cm")
    rolled = row(result, "delay", "own", "100 ms, known", "lateral, cm")
    assert max(without) <= 1.0
    assert max(rolled) <= 1.0
    assert rolled[2] == pytest.approx(without[2], abs=0.01)
    assert row(result, "delay", "own", "100 ms, ignored", "lateral, cm") == ["diverged"] * 3
    assert len(result.data["diverged"]) == 3
    for name in ("own, as printed", "own, minus sign"):
        assert max(column(result, "lateral", name)) <= 1.0


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.long
def test_a_delay_of_70_ms_is_harmless_where_it_is_known_and_fatal_where_not(known: bool) -> None:
    parameters: LaneChangeParameters = parameters_of("lane-change")
    speed, delay = max(parameters.speeds_m_s), 0.07
    settings = parameters.recommended.settings(parameters.control_step_s, delay if known else 0.0)
    start = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
    loop, road = parameters.loop(delay), parameters.reference(parameters.readings[0])
    if known:
        assert np.abs(drive(bicycle_plant(FALCONE_2007), settings, loop, road, speed, start).lateral).max() < 0.01
    else:
        with pytest.raises(DivergedError):
            drive(bicycle_plant(FALCONE_2007), settings, loop, road, speed, start)


@pytest.mark.long
def test_what_the_paper_does_not_give_is_said(result: Result) -> None:
    notes = " ".join(note for table in result.tables for note in table.notes)
    assert "the paper gives no computing delay" in notes
    assert "70 ms that it is not told of make it diverge" in notes


@pytest.mark.long
def test_no_number_that_is_not_finite(result: Result) -> None:
    for figure in result.figures:
        for panel in figure.panels:
            assert panel.curves
            for line in panel.curves:
                assert len(line.x) == len(line.y) > 100
                assert np.isfinite(line.y).all()
