"""The exercises of configs/LESSON.md: what a class begins with does not pass, and a solution does."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LESSON = Path(__file__).parents[1] / "configs" / "lesson"
RUN = ["run", "--lockstep", "--strict"]
SOLUTIONS = {  # the command that judges, and what to change in which file
    "exercise1": (["check"], {
        "exercise1.yaml": [("r2, tag: 1", "r2, tag: 2"), ("1.9", "1.2"), ("speed_m_s: 80", "speed_m_s: 0.08"),
                           ("tag_hight_m", "tag_height_m")],
    }),
    "exercise2": (RUN, {"exercise2.yaml": [("integrator: euler", "integrator: exact")]}),
    "exercise3": (RUN, {"exercise3.py": [(
        "velocities = np.zeros_like(points)",
        "gap = goals - points; velocities = gap * np.minimum(1, self.settings.speed_m_s"
        " / np.maximum(1e-6, np.linalg.norm(gap, axis=1, keepdims=True)))",
    )]}),
    "exercise4": (RUN, {"exercise4.py": [(
        "(points[j] - points[i])", "(points[j] - points[i] - corners[j] + corners[i])",
    )]}),
    "exercise5": (RUN, {"exercise5.py": [(
        "velocities = self.settings.gain_per_s * error",
        "tick = self.team.tick; velocities = self.settings.gain_per_s * error"
        " + (self.reference(now.t + tick) - self.reference(now.t)) / tick",
    )]}),
    "exercise6": (RUN, {"exercise6.yaml": [("  tick_s: 0.033\n", "  tick_s: 0.033\n  disturbance: estimated\n")]}),
}  # fmt: skip


@pytest.fixture
def lesson(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of what the class has."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(LESSON, "lesson", ignore=shutil.ignore_patterns("__pycache__")))


def judged(name: str) -> int:
    command = [sys.executable, "-m", "robofleet", *SOLUTIONS[name][0], f"lesson/{name}.yaml"]
    return subprocess.run(command, capture_output=True, check=False).returncode


def solve(lesson: Path, name: str) -> None:
    for file, changes in SOLUTIONS[name][1].items():
        text = (lesson / file).read_text()
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        (lesson / file).write_text(text)


def test_every_exercise_has_a_solution_that_the_class_does_not_see() -> None:
    files = {file.stem for file in LESSON.glob("exercise*.yaml")}
    assert files == set(SOLUTIONS) == set(re.findall(r"exercise\d", (LESSON.parent / "LESSON.md").read_text()))


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLUTIONS)
def test_an_exercise_is_not_solved_at_first_and_its_solution_solves_it(lesson: Path, name: str) -> None:
    assert judged(name) == (2 if name == "exercise1" else 1)
    solve(lesson, name)
    assert judged(name) == 0
