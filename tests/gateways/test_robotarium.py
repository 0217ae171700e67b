"""Scripts of the Robotarium, both versions, unmodified: what they see, what the robots do, what is refused.

The installed package of the Robotarium is a stub here: only its utilities draw initial conditions.
"""

import json
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from robofleet.gateways.robotarium.script import ScriptError, version_of
from tests.command import robofleet

pytestmark = pytest.mark.usefixtures("unplotted")

ROOT = Path(__file__).parents[2]
SHOWN = 5  # lines at most of what is said of a refusal, without a traceback
NOT_NEEDED = "tracker.source=truth"

STUB = {
    "__init__.py": "",
    "robotarium_abc.py": "class ARobotarium: ...\n",
    "robotarium.py": "raise AssertionError('the installed simulator is not to be loaded')\n",
    "utilities/__init__.py": "",
    "utilities/misc.py": """
        import random
        import numpy as np

        def generate_initial_poses(N, width, height):
            return np.array(random.sample([[x, y, 0.0] for x in range(11) for y in range(2)], N)).T

        def generate_random_poses(N, spacing, width, height):
            x, y = np.linspace(-width / 2, width / 2, N), np.random.uniform(-height / 2, height / 2, N)
            return np.vstack([x, y, np.zeros(N)])

        generate_initial_conditions = generate_random_poses
    """,
}  # fmt: skip

# Robots go to goals by the point 5 cm ahead of them; what both versions, and the reference below, share.
LAW = """
    import json
    import numpy as np

    STARTS = np.array([[-0.8, 0.8, 0.0], [-0.4, 0.3, 0.6], [0.0, 3.0, -1.5]])
    GOALS = np.array([[0.4, -0.5, -0.6], [-0.5, -0.2, 0.4]])

    def law(x):
        c, s = np.cos(x[2]), np.sin(x[2])
        e = GOALS - x[:2] - 0.05 * np.vstack([c, s])
        e *= 0.12 / np.maximum(np.hypot(*e), 0.12)
        return np.vstack([c * e[0] + s * e[1], (c * e[1] - s * e[0]) / 0.05])
"""
SCRIPT_2 = (
    LAW
    + """
    import rps.robotarium as robotarium

    r = robotarium.Robotarium(number_of_robots=3, show_figure=True, initial_conditions=STARTS, sim_in_real_time=True)
    r._axes_handle.plot([0, 1], [0, 1])
    first = None
    for _ in range(400):
        x = r.get_poses()
        first = x if first is None else first
        r.set_velocities(np.arange(3), law(x))
        r.step()
    r.debug()
    print(json.dumps({"first": first.tolist(), "last": r.get_poses().tolist()}))
"""
)
SCRIPT_1 = (
    LAW
    + """
    from rps.robotarium import Robotarium

    r = Robotarium(3, True, False, STARTS)
    r.axes.plot([0, 1], [0, 1])
    assert r.boundaries == [-1.6, -1, 3.2, 2] and np.mat("1 2").shape == (1, 2)
    first = None
    for _ in range(400):
        x = r.get_poses()
        first = x.copy() if first is None else first
        r.set_velocities(np.arange(3), law(x))
        before = x.copy()
        r.step()
        assert (x != before).any() or _ > 300  # of version 1: the array that the script has is the robots' poses
    r.call_at_scripts_end()
    print(json.dumps({"first": first.tolist(), "last": r.get_poses().tolist()}))
"""
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a folder for scripts, in which the stub is as good as installed."""
    for name, text in STUB.items():
        file = tmp_path / "installed" / "rps" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text))
    monkeypatch.syspath_prepend(str(tmp_path / "installed"))
    monkeypatch.setattr(sys, "argv", [*sys.argv])
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    import matplotlib.pyplot as plt

    plt.close("all")
    for name in [name for name in sys.modules if name == "rps" or name.startswith("rps.")]:
        del sys.modules[name]


Runs = Callable[..., Result]


@pytest.fixture
def runs(folder: Path) -> Runs:
    def run(text: str, *options: str) -> Result:
        (folder / "script.py").write_text(textwrap.dedent(text))
        return robofleet("robotarium", "script.py", "--out", "run", *options)

    return run


def told(result: Result) -> Any:
    """Return what the script printed as JSON."""
    assert result.exit_code == 0, result.output
    return json.loads(next(line for line in result.stdout.splitlines() if line.startswith("{")))


def by_the_original(steps: int, law: str = LAW) -> np.ndarray:
    """Return where the original's robots end: exact poses, Euler's steps of 33 ms, no lag."""
    known: dict[str, Any] = {}
    exec(textwrap.dedent(law), known)
    x = known["STARTS"].copy()
    for _ in range(steps):
        v, omega = known["law"](x)
        x += 0.033 * np.vstack([v * np.cos(x[2]), v * np.sin(x[2]), omega])
    return np.asarray(x)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the matrix subclass")  # np.mat is what scripts of version 1 say
@pytest.mark.parametrize(("script", "report"), [(SCRIPT_2, "debug: 400 steps"), (SCRIPT_1, "call_at_scripts_end: 400")])
def test_a_script_of_either_version_runs_and_ends_where_the_original_ends(
    script: str, report: str, runs: Runs, folder: Path
) -> None:
    result = runs(script)
    poses = told(result)
    known: dict[str, Any] = {}
    exec(textwrap.dedent(LAW), known)
    first, last = np.array(poses["first"]), np.array(poses["last"])
    assert np.abs(first[:2] - known["STARTS"][:2]).max() < 0.005
    assert np.hypot(*(last - by_the_original(400))[:2]).max() < 0.03
    assert report in result.stdout
    assert "robofleet: completed, 400 steps of 3 robots" in result.stdout
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert (summary["outcome"], len(summary["robots"])) == ("completed", 3)
    assert (folder / "run" / "figure1.png").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("steps", [60, 150])
def test_ideal_robots_are_on_their_way_where_the_original_has_them(steps: int, runs: Runs) -> None:
    poses = told(runs(SCRIPT_2.replace("range(400)", f"range({steps})"), "--ideal", "--quiet"))
    apart = np.hypot(*(np.array(poses["last"]) - by_the_original(steps))[:2])
    assert apart.max() < 0.012  # they begin a tick or two later, with 4 mm a tick


@pytest.mark.slow
def test_two_runs_of_a_script_leave_the_same_trace(runs: Runs, folder: Path) -> None:
    short = SCRIPT_2.replace("range(400)", "range(30)")
    traces = set()
    for out in ("one", "two"):
        assert runs(short, "--quiet", "--out", out).exit_code == 0
        traces.add(json.loads((folder / out / "summary.json").read_text())["trace_hash"])
    assert len(traces) == 1


@pytest.mark.slow
def test_the_sensors_of_version_2_have_its_units_and_signs(runs: Runs) -> None:
    values = told(
        runs("""
        import json
        import numpy as np
        import rps.robotarium as robotarium

        wall = np.array([[[0.5, -0.9], [0.5, 0.9]]])
        r = robotarium.Robotarium(number_of_robots=1, initial_conditions=np.array([[-0.2], [0.0], [0.0]]),
                                  use_distance_sensors=True, obstacles=wall)
        ahead = []
        for step in range(60):
            x = r.get_poses()
            ahead.append((r.get_distances()[3, 0], r.get_distance_endpoints()[0, 3, 0]))
            r.set_velocities(np.array([0]), np.array([[0.1], [0.2]]))
            r.step()
        said = {name: getattr(r, name)().tolist() for name in (
            "get_accelerations", "get_gyros", "get_magnetic_fields", "get_orientations", "get_encoders",
            "get_distances",
        )}
        print(json.dumps(said | {"ahead": ahead, "psi": float(x[2, 0])}))
    """)
    )
    distances, ends = np.array(values["ahead"])[1:10].T
    seen = distances > 0
    assert seen.sum() >= 5
    assert np.median(distances[seen]) == pytest.approx(0.65, abs=0.06)  # from 5 cm ahead of the axle to the wall
    assert np.median(ends[seen]) == pytest.approx(0.5, abs=0.06)
    assert values["get_distances"][0][0] == -1  # nothing behind it
    assert values["get_accelerations"][2][0] == pytest.approx(-9.8, abs=0.3)
    assert values["get_gyros"][2][0] == pytest.approx(0.2, abs=0.05)
    assert values["get_magnetic_fields"][2][0] == pytest.approx(-39.9, abs=25)  # microtesla
    assert values["get_orientations"][0] == pytest.approx(np.degrees(values["psi"]), abs=3)
    turns = np.array(values["get_encoders"])[:, 0] / (28 * 100.37)
    wished = 60 * 0.033 * (0.1 + np.array([-1, 1]) * 0.2 * 0.105 / 2) / 0.016 / (2 * np.pi)
    assert turns == pytest.approx(wished, rel=0.12)  # left, right; wheels are off by some per cent, and begin late


@pytest.mark.slow
def test_errors_are_counted_as_the_original_counts_them(runs: Runs) -> None:
    values = told(
        runs("""
        import json
        import numpy as np
        import rps.robotarium as robotarium

        r = robotarium.Robotarium(number_of_robots=2, initial_conditions=np.array([[-0.1, 0.1], [0, 0], [0, 3.14159]]))
        twice = early = None
        for step in range(40):
            r.get_poses()
            try:
                r.get_poses()
            except AssertionError as error:
                twice = str(error)
            r.set_velocities(np.arange(2), np.full((2, 2), [[0.2], [9.0 * (step < 7)]]))
            r.step()
            try:
                r.step()
            except AssertionError as error:
                early = str(error)
        r.debug()
        print(json.dumps({"errors": r._errors, "twice": twice, "early": early}))
    """)
    )
    assert values["errors"]["exceeded_actuator_limits"] == 7
    assert "once" in values["twice"]
    assert "before" in values["early"]


@pytest.mark.slow
def test_version_1_counts_each_robots_collisions(runs: Runs) -> None:
    values = told(
        runs("""
        import json
        import numpy as np
        import rps.robotarium as robotarium

        starts = np.array([[-0.09, 0.09, 1.0], [0, 0, 0], [0, 3.14159, 0]])
        r = robotarium.Robotarium(number_of_robots=3, show_figure=False, initial_conditions=starts)
        for step in range(5):
            r.get_poses()
            r.step()
        r.call_at_scripts_end()
        print(json.dumps(r._errors))
    """)
    )
    assert values["collision"] == {"0": 5, "1": 5}  # their points 25 mm ahead are 130 mm apart
    assert "boundary" not in values


@pytest.mark.slow
def test_random_starts_are_drawn_as_the_original_draws_them_and_a_new_robotarium_is_a_new_run(
    runs: Runs, folder: Path
) -> None:
    values = told(
        runs(
            """
        import json
        import numpy as np
        import rps.robotarium as robotarium
        from rps.utilities.misc import generate_initial_conditions

        found = []
        for episode in range(2):
            np.random.seed(episode)
            r = robotarium.Robotarium(number_of_robots=4, show_figure=False)
            np.random.seed(episode)
            found.append([generate_initial_conditions(4, 0.2, 2.5, 1.5).tolist(), r.get_poses().tolist()])
            r.step()
        print(json.dumps(found))
    """.replace("json.dumps(found)", 'json.dumps({"found": found})')
        )
    )["found"]
    for drawn, stood in np.array(values):
        assert np.abs(drawn - stood).max() < 0.02
    assert {run_folder.name for run_folder in folder.glob("run*")} == {"run", "run-2"}


MOVE = """
    import numpy as np
    import rps.robotarium as robotarium
    r = robotarium.Robotarium(number_of_robots={robots}, initial_conditions=np.array({starts}, float))
    r.get_poses()
    r.step()
"""
TWO = MOVE.format(robots=2, starts=[[0, 0.5], [0, 0], [0, 0]])


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (TWO, ["no.yaml"], "no.yaml"),
        (TWO, ["--api", "3"], "--api 3: there are versions 1 and 2"),
        (TWO, ["--set", "robots.0.vehicel=gternal"], "did you mean"),
        (MOVE.format(robots=21, starts=np.zeros((3, 21)).tolist()), [], "asks for 21 robots"),
        (MOVE.format(robots=2, starts=[[0, 0.05], [0, 0], [0, 0]]), [], "move r1 and r2 apart"),
        (MOVE.format(robots=2, starts=[[0, 1.7], [0, 0], [0, 0]]), [], "move r2 into the arena"),
        ("import rps.robotarium\nx = (", [], "script.py is no Python"),
        ("import no_such_module", [], "script.py ended by ModuleNotFoundError"),
        ("from rps.utilities.misc import at_pose", [], "is of version 1, the installed rps of version 2"),
        (TWO.replace("    r.step()\n", ""), ["--api", "2"], "never called step()"),
        ("print('nothing')", [], "never called step()"),
        (TWO + "    r.debug(), r.boundaries\n", [], "say --api 1 or --api 2"),
    ],
)
def test_bad_input_ends_with_a_line_and_exit_code_2(text: str, options: list[str], words: str, runs: Runs) -> None:
    result = runs(text, *options)
    assert result.exit_code == 2, result.output
    last = result.stderr.strip().splitlines()[-1]
    assert words in last or words in result.stderr.strip().splitlines()[0]
    assert len(result.stderr.splitlines()) <= SHOWN or "Traceback" in result.stderr or "no Python" in words


def test_a_script_that_raises_shows_its_own_traceback_and_ends_its_run(runs: Runs, folder: Path) -> None:
    result = runs(TWO + "    1 / 0\n")
    assert result.exit_code == 1
    assert result.stderr.count('File "') == 1  # its own line, and none of ours
    assert result.stderr.strip().splitlines()[-1] == "script.py ended by ZeroDivisionError: division by zero"
    assert json.loads((folder / "run" / "summary.json").read_text())["outcome"] == "stopped"


def test_without_the_robotariums_package_a_line_says_what_to_install(
    folder: Path, runs: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(folder / "installed")])
    result = runs(TWO)
    assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
    assert "pip install git+https://github.com/robotarium" in result.stderr


@pytest.mark.parametrize(
    ("text", "version"),
    [
        ("r = Robotarium(number_of_robots=3)\nr.call_at_scripts_end()", 1),
        ("r = x.Robotarium(3)\nprint(r.time_step)", 1),
        ("from rps.utilities.graph import cycle_GL", 1),
        ("from rps.utilities.misc import *\nwhile at_pose(x, y): ...", 1),
        ("r = x.Robotarium(number_of_robots=3, skip_initialization=True)", 2),
        ("r = x.Robotarium(number_of_robots=3)\nr._axes_handle.plot()", 2),
        ("import rps.utilities.misc as m\nat_pose = m.create_at_pose()\nat_pose(1, 2)", 2),
        ("import logging\nlogging.debug('nothing')\nr = x.Robotarium(3)\nr.step()", None),
    ],
)
def test_the_version_is_found_from_what_a_script_names(text: str, version: int | None) -> None:
    assert version_of(text, "script.py") == version


def test_what_names_both_versions_is_asked_about() -> None:
    with pytest.raises(ScriptError, match="--api 1 or --api 2"):
        version_of("r = Robotarium(3)\nr.debug()\nr.time_step", "script.py")


@pytest.mark.usefixtures("alone")
@pytest.mark.long
def test_in_real_time_a_script_that_is_late_goes_on(folder: Path) -> None:
    goals, near = "[[0.4, -0.5, -0.6], [-0.5, -0.2, 0.4]]", "[[-0.5, 0.5, 0.0], [-0.4, 0.3, 0.3]]"
    law = LAW.replace(goals, near)
    assert law != LAW
    (folder / "script.py").write_text(
        textwrap.dedent(SCRIPT_2.replace(LAW, law))
        .replace("range(400)", "range(150)")
        .replace("first = None", "import time\nfirst = None")
        .replace("    r.step()", "    r.step()\n    time.sleep(2 * (_ == 20))")
    )
    env = {**os.environ, "PYTHONPATH": f"{folder / 'installed'}:{ROOT}"}
    command = [sys.executable, "-m", "robofleet", "robotarium", "script.py", "--real-time", "--out", "run"]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    poses = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert np.hypot(*(np.array(poses["last"]) - by_the_original(150, law))[:2]).max() < 0.03
    assert re.search(r"the run was held and went on \d times?\b", done.stdout)
    assert json.loads((folder / "run" / "summary.json").read_text())["outcome"] == "completed"
