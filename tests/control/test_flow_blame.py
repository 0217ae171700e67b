"""A function that numba cannot compile is named: function, file, line, source and cause."""

from pathlib import Path

import pytest

from robofleet.control.flow import FlowError, FlowSettings, MemorylessFlow, NewtonRaphsonFlow, Plant
from tests.control import uncompilable

SETTINGS = FlowSettings(20.0, 0.5, 0.01)
FILE = Path(uncompilable.__file__)
LONG = pytest.mark.long
LINES = FILE.read_text().splitlines()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("role", "function", "source", "cause"),
    [
        ("plant.f", "formats", 'len(f"{x[0]:.3f}")', "format spec in f-strings not supported yet"),
        ("plant.h", "counts_bytes", "len(x.dumps())", "Unknown attribute 'dumps' of type array(float64, 1d, C)"),
        ("g", "fails_inside", "np.fft.rfft(v)", "Unknown attribute 'rfft' of type Module"),
        pytest.param(
            "plant.f", "multiplies_integers", "MIX @ x", "'@' arguments must all have the same dtype", marks=LONG
        ),
        pytest.param("g", "asks_too_much", "np.full(", "it knows no full(", marks=LONG),
    ],
)
def test_function_line_and_cause_are_named(role: str, function: str, source: str, cause: str) -> None:
    bad = getattr(uncompilable, function)
    line = next(k for k, text in enumerate(LINES, 1) if source in text)
    with pytest.raises(FlowError) as error:
        if role == "g":
            MemorylessFlow(bad, 1, 5.0, 0.02, [0.0])
        else:
            f, h = (bad, lambda x: x) if role == "plant.f" else (lambda x, u: u, bad)
            NewtonRaphsonFlow(Plant(f, h, 1, 1), SETTINGS, [0.0])
    refusal_start = f"{FILE}:{line}: `{LINES[line - 1].strip()}`"
    assert str(error.value).startswith(f"{role}: numba cannot compile {function}: {refusal_start}: {cause}")
    assert "\n" not in str(error.value)


def test_what_cannot_be_told_from_a_changed_one_is_named() -> None:
    with pytest.raises(FlowError, match=r"reads_a_dict \(.*uncompilable.py:\d+\) reads CAR, of type dict"):
        NewtonRaphsonFlow(Plant(uncompilable.reads_a_dict, lambda x: x, 1, 1), SETTINGS, [0.0])


@pytest.mark.slow
def test_functions_that_do_not_fit_together_are_shown_with_what_they_return() -> None:
    with pytest.raises(FlowError, match=r"functions together \(plant.f returns array\(complex128, 1d, C\), plant.h "):
        NewtonRaphsonFlow(Plant(lambda x, u: u + 0j, lambda x: x, 1, 1), SETTINGS, [0.0])
