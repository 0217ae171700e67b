"""Reading configurations: what is refused, where it is said to be, and what comes out."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.config.files.yamlfile import Source, parse_yaml
from robofleet.config.load import ConfigError, load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.nodes.unit import driver_settings

CONFIGS = Path(__file__).parents[2] / "configs"
PLATOON = CONFIGS / "platoon.yaml"
TEXT = PLATOON.read_text()
HERE = "«"  # in an edit: where the fault is to be reported


def edited(*edits: tuple[str, str]) -> tuple[str, list[str]]:
    """Return the shipped configuration with edits made, and the ``line:column`` of each mark in them."""
    text = TEXT
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    places = []
    while HERE in text:
        before, text = text.split(HERE, 1)
        places.append(f"{before.count(chr(10)) + 1}:{len(before.rsplit(chr(10), 1)[-1]) + 1}")
        text = before + text
    return text, places


def faults_of(file: Path, *overrides: str, faults_file: Path | None = None) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load_config(file, overrides, faults_file)
    assert str(caught.value) == "\n".join(caught.value.faults)
    return caught.value.faults


@pytest.fixture
def platoon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shipped configuration, copied into the working directory and named relatively."""
    monkeypatch.chdir(tmp_path)
    file = Path("platoon.yaml")
    file.write_text(TEXT)
    return file


def test_the_shipped_platoon_is_the_papers_run() -> None:
    config = load_config(PLATOON)
    c, settings = config.controller, config.groups[0].settings
    assert (c.point_ahead_m, settings["spacing_m"], c.alpha, c.horizon_s) == (0.08, 0.25, 45, 0.6)
    assert (c.tick_s, settings["path_rate"], config.run.duration_s) == (0.033, 0.0455, 88)
    assert c.integrator == "exact"
    assert [robot.tag for robot in config.members] == [1, 2, 3, 4]


def test_an_ideal_robot_has_gternals_geometry_and_no_error() -> None:
    load = [f"robots.0.vehicle={name}" for name in ("gternal", "ideal")]
    real, ideal = (load_config(PLATOON, [o]).robots[0].vehicle for o in load)
    for key in ("wheel_radius_m", "wheel_base_m", "body_radius_m", "max_wheel_speed_rad_s", "max_speed_m_s"):
        assert getattr(ideal, key) == getattr(real, key)
    errors = ideal.simulated.model_dump(exclude={"loop_period_s", "battery_life_s"})
    assert errors.pop("wiring") == "straight"
    assert ideal.motor_lag_s == 0
    assert errors.pop("stop_lag_s") is None
    assert set(errors.values()) == {0}
    assert ideal.simulated.battery_life_s == 1e9


def without_errors(platoon: Path) -> Path:
    """Write a kind of robot that only real robots can be of, beside a configuration."""
    shipped = (CONFIGS / "robots" / "ideal.yaml").read_text()
    kind = platoon.with_name("kind.yaml")
    kind.write_text(shipped[: shipped.index("simulated:")])
    return kind


@pytest.mark.parametrize("how", [(), ("robots.2.driver=gternal", "robots.2.twin=gternal")])
def test_a_robot_that_does_not_exist_needs_its_errors(platoon: Path, how: tuple[str, ...]) -> None:
    kind = without_errors(platoon)
    (fault,) = faults_of(platoon, "robots.2.vehicle=kind.yaml", *how)
    assert fault.startswith(f"{kind}:2:1: simulated: is missing: say what a simulated robot of this kind gets wrong")


def test_a_robot_that_exists_needs_neither_errors_nor_a_start(platoon: Path) -> None:
    without_errors(platoon)
    exists = ("driver=gternal", "vehicle=kind.yaml", "settings={port: /dev/r3}", "start=null")
    config = load_config(platoon, ["groups.0.robots=[r1, r2, r4]", *(f"robots.2.{key}" for key in exists)])
    assert (config.robots[2].vehicle.simulated, config.robots[2].start) == (None, None)
    context = driver_settings.context(config, config.robots[2], lambda: 0)
    assert context.simulation is None
    assert context.settings.port == "/dev/r3"


ALPHA = "alpha: 45 "
TRAPS = [
    ((ALPHA, "alpha: «1e-3 "), "controller.alpha", "1.0e-3"),
    ((ALPHA, "alpha: «-.5 "), "controller.alpha", "-0.5"),
    ((ALPHA, "alpha: «045 "), "controller.alpha", "octal, 37: write 45"),
    ((ALPHA, "alpha: «08 "), "controller.alpha", "write 8"),
    ((ALPHA, "alpha: «0o17 "), "controller.alpha", "write 15"),
    ((ALPHA, "alpha: «1:30 "), "controller.alpha", "base 60, 90: write 90"),
    ((ALPHA, "alpha: «1:30.5 "), "controller.alpha", "base 60"),
    ((ALPHA, "alpha: «2024-01-31 "), "controller.alpha", "timestamp: quote it, '2024-01-31'"),
    ((ALPHA, "alpha: «!!float 45 "), "controller.alpha", "remove 'float'"),
    ((ALPHA, "alpha: «" + "9" * 5000 + " "), "controller.alpha", "too long"),
    ((ALPHA, "alpha: «0" + "7" * 5000 + " "), "controller.alpha", "too long"),
    (("trigger: tick", "trigger: «on"), "camera.trigger", "as true: write true or false, or quote it, 'on'"),
    (("trigger: tick", "trigger: «off"), "camera.trigger", "reads off as false"),
    (("trigger: tick", "trigger: «Yes"), "camera.trigger", "reads Yes as true"),
    (("trigger: tick", "trigger: «no"), "camera.trigger", "reads no as false"),
    (("  alpha: 45", "  alpha: 45\n  «7: 50"), "controller.7", "quote it, '7'"),
    (("  alpha: 45", "  alpha: 45\n  «on: 50"), "controller.on", "quote it, 'on'"),
    (("  alpha: 45", "  alpha: 45\n  ? «[a]\n  : 50"), "controller: ", "a key must be text"),
    (("  alpha: 45", "  alpha: 45\n  «<<: {alpha: 50}"), "controller.<<", "write the keys out"),
    (("45  # paper\n  horizon_s: 0.6 ", "&a 45\n  horizon_s: «*a "), "controller.horizon_s", "stands for"),
]  # fmt: skip


@pytest.mark.parametrize(("edit", "path", "hint"), TRAPS, ids=lambda value: str(value)[-40:])
def test_a_yaml_trap_is_refused_at_its_place_with_a_hint(
    platoon: Path, edit: tuple[str, str], path: str, hint: str
) -> None:
    text, places = edited(edit)
    platoon.write_text(text)
    (fault,) = faults_of(platoon)
    assert fault.startswith(f"platoon.yaml:{places[0]}: {path}")
    assert hint in fault


MANTISSAS = ["0", "7", "08", "09", "017", "045", "123456789", "0.", "1.", "1.5", "00.5", "010.25", ".5", ".05"]


@pytest.mark.parametrize("exponent", ["", "e0", "e5", "E-3", "e+12", "E07", "e-99"])
def test_what_looks_like_a_number_is_read_as_that_number_or_refused_with_its_spelling(exponent: str) -> None:
    for text in (sign + mantissa + exponent for sign in ("", "-", "+") for mantissa in MANTISSAS):
        node, faults = parse_yaml(text, Source("file"))
        if not faults:
            assert node is not None and node.plain() == float(text), text
            continue
        spelling = re.search(r"write (\S+?)(,| without)", faults[0].message)
        assert spelling is not None and yaml.safe_load(spelling[1]) == float(text), text


@pytest.mark.parametrize(
    ("content", "where", "message"),
    [
        (b"# nothing\n", "1:1", "is empty"),
        (b"hello\n", "1:1", "must be a mapping"),
        (b"a: 1\n---\na: 2\n", "2:1", "second document"),
        (b"a: 1\nb: [1, 2\nc: 3\n", "2:4", "this list is not closed"),
        (b"a: 1\nb: \xe9\n", "2:4", "is not UTF-8"),
        (b"{}\n" + b'"a\\nb": 1\n', "2:1", "is not YAML"),
        (b"a: 1\nbc: \x07\n", "2:5", "may not stand in YAML"),
        (b'a: "\\UFFFFFFFF"\n', "1:1", "is not YAML"),
        (b"[" * 10_000, "1:1", "nested too deeply"),
    ],
)
def test_what_is_no_configuration_is_refused(platoon: Path, content: bytes, where: str, message: str) -> None:
    platoon.write_bytes(content)
    (fault,) = faults_of(platoon)
    assert fault.startswith(f"platoon.yaml:{where}: ")
    assert message in fault


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    (fault,) = faults_of(tmp_path / "none.yaml")
    assert fault.startswith(f"{tmp_path}/none.yaml:1:1: there is no such file: ")
    assert faults_of(tmp_path) == (f"{tmp_path}:1:1: is a folder: name a file",)


def test_aliases_that_explode_are_refused_at_once(platoon: Path) -> None:
    lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 60)]
    platoon.write_text("\n".join(lines) + "\nloop: &loop [*loop]\n")
    faults = faults_of(platoon)
    assert sum("aliases are not read" in fault for fault in faults) == 59 * 9 + 1


MISTAKES = [  # others stand in tests/test_beginners_mistakes.py
    (
        (
            "platoon\n    robots: [r1, r2, r3, r4]  # the leader first\n    settings:\n      path",
            "consensus\n    robots: [r1, r2, r3, r4]\n    settings:\n      «path",
        ),
        "groups.0.settings.path", "unknown key: known: edges",
    ),
    (("behaviour: platoon", "name: «P\n    behaviour: platoon"), "groups.0.name", "must be a small letter"),
    (("run: {", "run: {«xyz: 1, "), "run.xyz", "known: attended, begin, bounds, duration_s, end, seed"),
    (("  alpha: 45  # paper\n", ""), "controller.alpha", "is missing"),
    ((ALPHA, "alpha:« "), "controller.alpha", "is missing"),
    ((ALPHA, "alpha: «fast "), "controller.alpha", "must be a number, not 'fast'"),
    ((ALPHA, "alpha: «0 "), "controller.alpha", "must be at least 0.001, not 0"),
    ((ALPHA, "alpha: «.inf "), "controller.alpha", "must be a finite number"),
    ((ALPHA, "alpha: «true "), "controller.alpha", "must be a number, not True"),
    ((ALPHA, "alpha: «[45] "), "controller.alpha", "must be a number"),
    (("tag: 2", "tag: «2.0"), "robots.1.tag", "must be a whole number, not 2.0"),
    (("tag: 2", "tag: «65536"), "robots.1.tag", "must be at most 65535, not 65536"),
    (("id: r2", "id: «2"), "robots.1.id", "must be text, not 2: quote it"),
    (("trigger: tick", "trigger: «tik"), "camera.trigger", "must be 'free' or 'tick', not 'tik'"),
    (("size_m: [3.2, 2.0]", "size_m: «[3.2]"), "arena.size_m.1", "has too few values"),
    (("size_m: [3.2, 2.0]", "size_m: «[3.2, 2.0, 1.0]"), "arena.size_m", "may have 2 at most"),
    (("size_m: [3.2, 2.0]", "size_m: [3.2, «wide]"), "arena.size_m.1", "must be a number"),
    (("size_m: [3.2, 2.0]", "size_m: «3.2"), "arena.size_m", "must be a list"),
    (("[r1, r2, r3, r4]", "«[]"), "groups.0.robots", "needs 1 or more, has 0"),
    (("arena: {name: platoon, size_m: [3.2, 2.0]}", "arena: «88"), "arena", "must be a mapping, not 88"),
    (("run: {", "bus: {endpoint: «udp/1.2.3.4:0}\nrun: {"), "bus.endpoint", "must be private, or look like"),
    (("[r1, r2, r3, r4]", "[r1, r2, «r33]"), "groups.0.robots.2", "no robot 'r33': did you mean 'r3'?"),
    (("height: 720", "height: «480"), "camera.height", "480 px, but its model is calibrated for 720"),
    (("model: overhead", "model: «overhed"), "camera.model", "did you mean 'overhead'?"),
    (("path: platoon", "path: «elsewhere/p.yaml"), "groups.0.settings.path", "there is no file elsewhere/p.yaml"),
]  # fmt: skip


@pytest.mark.parametrize(("edit", "path", "message"), MISTAKES, ids=lambda value: str(value)[-40:])
def test_a_mistake_is_reported_at_its_place_in_plain_words(
    platoon: Path, edit: tuple[str, str], path: str, message: str
) -> None:
    text, places = edited(edit)
    platoon.write_text(text)
    faults = faults_of(platoon)
    parent = edited(("  tick_s", "  «tick_s"))[1]  # a key that is not there has its parent's place
    (own_path,) = places or parent
    (fault,) = [fault for fault in faults if fault.startswith(f"platoon.yaml:{own_path}: {path}: ")]
    assert message in fault


def test_all_faults_are_reported_at_once_in_the_order_of_the_file(platoon: Path) -> None:
    text, places = edited(
        ("arena: {", "arena: {«colour: red, "),
        ("tag: 2", "tag: «1e1"),
        ("spacing_m: 0.25", "spacing_m: «-1"),
        (ALPHA, "alpha: «x "),
        ("trigger: tick", "trigger: «on"),
    )
    platoon.write_text(text)
    assert [fault.split(": ")[0] for fault in faults_of(platoon)] == [f"platoon.yaml:{p}" for p in places]


def test_a_file_beside_the_configuration_hides_the_shipped_one(platoon: Path) -> None:
    shipped = (CONFIGS / "robots" / "gternal.yaml").read_text()
    assert load_config(platoon).robots[0].vehicle.wheel_base_m == 0.105
    Path("robots").mkdir()
    Path("robots/gternal.yaml").write_text(shipped.replace("0.105", "0.1"))
    assert load_config(platoon).robots[0].vehicle.wheel_base_m == 0.1


def test_a_path_is_taken_from_the_configurations_folder(platoon: Path, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "narrow.yaml").write_text((CONFIGS / "robots" / "ideal.yaml").read_text().replace("0.105", "0.09"))
    (folder / "platoon.yaml").write_text(TEXT)
    config = load_config(Path("elsewhere/platoon.yaml"), ["robots.1.vehicle=narrow.yaml"])
    assert [robot.vehicle.wheel_base_m for robot in config.robots] == [0.105, 0.09, 0.105, 0.105]


def test_a_fault_in_a_shared_file_is_reported_once_at_that_files_place(platoon: Path) -> None:
    Path("robots").mkdir()
    text = (CONFIGS / "robots" / "gternal.yaml").read_text()
    for old, new in (("radius_m: 0.016", "radius_m: -1"), ("base_m: 0.105", "base_m: 1e-1"), ("max_speed_m_s", "#")):
        text = text.replace(old, new)
    Path("robots/gternal.yaml").write_text(text)
    assert faults_of(platoon) == (
        "robots/gternal.yaml:2:1: max_speed_m_s: is missing: add it; configs/README.md describes it",
        "robots/gternal.yaml:2:17: wheel_radius_m: must be at least 0.001, not -1",
        "robots/gternal.yaml:3:15: wheel_base_m: YAML reads 1e-1 as text: write 1.0e-1, or quote it, '1e-1'",
    )


def test_an_unreadable_named_file_is_one_fault_of_that_file(platoon: Path) -> None:
    Path("robots/gternal.yaml").mkdir(parents=True)
    assert faults_of(platoon) == ("robots/gternal.yaml:1:1: is a folder: name a file",)


def test_overrides_are_read_as_yaml_and_the_last_one_counts(platoon: Path) -> None:
    config = load_config(
        platoon,
        [
            "robots.0.tag=7", "controller.alpha=30", "controller.alpha=31.5", "tracker.source=truth",
            "controller.filter.gate_sigma=3", "robots.1.vehicle.motor_lag_s=0.3",
            "arena.size_m=[3.4, 2.2]", "robots.2.vehicle=ideal", "robots.2.vehicle.simulated.slip_noise=0.5",
            "run={duration_s: 5, attended: true}",
        ],
    )  # fmt: skip
    assert config.robots[0].tag == 7
    assert config.controller.alpha == 31.5
    assert config.tracker.source == "truth"
    assert config.controller.filter.gate_sigma == 3
    assert [robot.vehicle.motor_lag_s for robot in config.robots] == [0.08, 0.3, 0, 0.08]
    assert [robot.vehicle.simulated.slip_noise for robot in config.robots] == [0.2, 0.2, 0.5, 0.2]
    assert config.arena.size_m == (3.4, 2.2)
    assert config.run.attended


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("robots.-1.tag=1", "robots.-1.tag: robots has 4 items, counted from 0: there is no '-1'"),
        ("arena.name.first=a", "arena.name.first: arena.name is 'platoon': it has no 'first'"),
        ("controler.alpha=1", "controler: unknown key: did you mean 'controller'?"),
        ("controller.alpha=1e-3", "controller.alpha: YAML reads 1e-3 as text: write 1.0e-3"),
        ("controller.alpha=", "controller.alpha: is empty"),
        ("controller.alpha=[", "controller.alpha: is not YAML"),
        ("controller.alpha=-1", "controller.alpha: must be at least 0.001, not -1"),
        ("robots.1.tag=1", "robots.1.tag: 1 is robots.0's already"),
        ("tracker.tag_height_m=2.5", "tracker.tag_height_m: a tag of 0.07 m at 2.5 m fills the image"),
        ("tracker.tag_height_m=3", "tracker.tag_height_m: a tag of 0.07 m at 3 m fills the image"),
        ("robots.1.tag_height_m=2.49", "robots.1.tag_height_m: a tag of 0.07 m at 2.49 m fills the image"),
        (
            "tracker.floor_tags=[{tag: 100, side_m: 9, x_m: 0, y_m: 0}]",
            "tracker.floor_tags.0: a tag of 9 m at 0 m fills",
        ),
        ("robots.0.vehicle=gternl", "robots.0.vehicle: there is no file"),
        ("=3", "write KEY=VALUE"),
        ("controller..alpha=3", "write KEY=VALUE"),
    ],
)
def test_a_wrong_override_is_named(platoon: Path, override: str, message: str) -> None:
    (fault,) = faults_of(platoon, override)
    assert fault.startswith(f"--set {override}: {message}")


def test_overrides_faults_follow_the_files(platoon: Path) -> None:
    platoon.write_text(edited((ALPHA, "alpha: x "))[0])
    faults = faults_of(platoon, "run.seed=-1", "run.settle_s=-1")
    assert [fault.split(": ")[0] for fault in faults] == [
        "platoon.yaml:19:10", "--set run.seed=-1", "--set run.settle_s=-1"
    ]  # fmt: skip


STUCK = "{robot: r2, kind: motor_stuck, at_s: 3, duration_s: 2}"


@pytest.mark.parametrize("text", [f"faults:\n  - {STUCK}\n", f"- {STUCK}\n"])
def test_a_faults_file_replaces_the_faults(platoon: Path, text: str) -> None:
    platoon.write_text(f"{TEXT}faults: [{STUCK}, {STUCK}]\n")
    Path("storm.yaml").write_text(text)
    assert len(load_config(platoon).faults) == 2
    config = load_config(platoon, ["faults.0.at_s=4"], Path("storm.yaml"))
    assert [(fault.robot, fault.at_s) for fault in config.faults] == [("r2", 4)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- {robot: r9, kind: motor_stuck, at_s: 3, duration_s: 2}", "1:11: 0.robot: there is no robot 'r9'"),
        ("faults: [{robot: r1, kind: x, at_s: 3, duration_s: 2}]", "1:28: faults.0.kind: there is no kind 'x'"),
        ("falts: []", "1:1: falts: unknown key: did you mean 'faults'?"),
        ("faults: 3", "1:9: faults: must be a list, not 3"),
    ],
)  # fmt: skip
def test_a_wrong_faults_file_is_reported_at_its_own_place(platoon: Path, text: str, message: str) -> None:
    Path("storm.yaml").write_text(text)
    assert faults_of(platoon, faults_file=Path("storm.yaml"))[0].startswith(f"storm.yaml:{message}")


def test_a_missing_faults_file_is_refused(platoon: Path) -> None:
    (fault,) = faults_of(platoon, faults_file=Path("s.yaml"))
    assert fault.startswith("s.yaml:1:1: there is no such file: ")


CART = "arena.moving=[{name: cart, tag: 40, radius_m: 0.12, start: {x_m: 0, y_m: 0, heading_deg: 0}}]"
UNPLACED = [f"robots.{i}.start=null" for i in range(4)]
WHOLE = [*((file, ()) for file in sorted(CONFIGS.glob("*.yaml"))), *((PLATOON, more) for more in ([CART], UNPLACED))]


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("file", "overrides"), WHOLE, ids=str)
def test_a_configuration_is_written_out_and_read_back_equal(
    file: Path, overrides: Sequence[str], tmp_path: Path
) -> None:
    config = load_config(file, overrides)
    text = resolved_yaml(config)
    assert ("camera" in yaml.safe_load(text)) != ("cameras" in yaml.safe_load(text)), "one of the two keys"
    (tmp_path / "again.yaml").write_text(text)
    assert load_config(tmp_path / "again.yaml") == config
    assert file != PLATOON or all(robot.start is not None for robot in config.members)


TEXTS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1) | st.sampled_from(
    ["1e-3", "on", "010", "1:30", "0o7", "null", "~", "2024-01-31", "*a", "a: b", "# c", "'", "-.5"]
)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    st.lists(TEXTS, min_size=4, max_size=4),
    st.lists(st.floats(1.0, 100.0), min_size=2, max_size=2),
    st.floats(-360.0, 360.0),
    st.integers(0, 2**63 - 1),
)
def test_any_text_and_number_is_read_back_equal(
    tmp_path_factory: pytest.TempPathFactory, drivers: list[str], positive: list[float], angle: float, seed: int
) -> None:
    tree: dict[str, Any] = load_config(PLATOON).model_dump()
    for robot, driver in zip(tree["robots"], drivers, strict=True):
        robot["driver"] = driver
    tree["robots"][0]["start"]["heading_deg"] = angle
    tree["controller"].update(alpha=positive[0], horizon_s=positive[1])
    tree["run"]["seed"] = seed
    config = Config.model_validate(tree)
    file = tmp_path_factory.getbasetemp() / "resolved.yaml"
    file.write_text(resolved_yaml(config), encoding="utf-8")
    assert load_config(file) == config
