"""Robots that are refused before a run: what they are said to be, and what answers when they are opened."""

import os
import pty
import signal
import threading
import tty
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest
import yaml
from pydantic import BaseModel, ConfigDict, Field

from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.drivers.serial_port import SerialPort
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.runs import check_drivers
from robofleet.runs.check import refusals
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import DriverContext, DriverError, DriverReading, WheelSpeeds
from tests.command import robofleet
from tests.runs.realrun import CLOCK, PLATOON

HERE = f"{__name__}:Echo"


class Echo:
    """A robot that answers every byte with the same one, and whose board takes a while to start."""

    concurrent: ClassVar[bool] = True

    class Settings(BaseModel):
        model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

        port: str
        """Its serial port."""
        boot_s: Annotated[float, Field(ge=0)] = 0.0
        """What its board takes."""
        closed: str = os.devnull
        """File that gets a line when it is closed."""

    def __init__(self, context: DriverContext) -> None:
        self._closed = Path(context.settings.closed)
        threading.Event().wait(context.settings.boot_s)
        self._line = SerialPort(context.settings.port, 57600)
        self._line.write(b"?")
        answered = self._line.wait(0.2) and self._line.read()
        if answered != b"?":
            self._line.close()
            raise DriverError(f"{context.settings.port}: {answered!r} is no answer of an Echo: is it another robot?")

    @staticmethod
    def refusals(settings: Settings, drive: DifferentialDrive) -> list[tuple[str, str]]:
        return [("vehicle.wheel_radius_m", "an Echo's wheels are smaller: lower it")] * (drive.wheel_radius > 0.016)

    def write(self, wheels: WheelSpeeds) -> None:
        raise AssertionError("nothing may move")

    def read(self) -> DriverReading:
        raise AssertionError("nobody asked for it")

    def close(self) -> None:
        self._line.close()
        with self._closed.open("a") as file:
            print(self, file=file)


class Crowded:
    """A robot of a world that is shared by all and bears one constructor at a time; it writes its name in a file."""

    busy = threading.Lock()

    class Settings(BaseModel):
        model_config = ConfigDict(frozen=True, extra="forbid")

        made: str
        ends_by: str = ""

    def __init__(self, context: DriverContext) -> None:
        if not self.busy.acquire(blocking=False):
            raise DriverError("another one is being constructed")
        with Path(context.settings.made).open("a") as file:
            print(context.robot, file=file)
        if context.settings.ends_by:
            os.kill(os.getpid(), signal.Signals[context.settings.ends_by])
        threading.Event().wait(0.02)
        self.busy.release()

    write, read = Echo.write, Echo.read

    def close(self) -> None:
        pass


class Mute:
    """A class whose author has forgotten half of it."""

    read = Echo.read


class Plain(Crowded):
    """A class whose settings are no model."""

    class Settings: ...


class Failing(Mute):
    """A class that raises what no driver should, where it is constructed."""

    write, close = Echo.write, Crowded.close

    def __init__(self, context: DriverContext) -> None:
        raise KeyError("gain")


class Bare(Failing):
    """A class that does not take what it is given."""

    def __init__(self) -> None: ...


class Judging(Failing):
    """A class that raises where it is asked for refusals."""

    Settings = Crowded.Settings

    @staticmethod
    def refusals(settings: BaseModel, drive: DifferentialDrive) -> list[tuple[str, str]]:
        raise ZeroDivisionError


class Eye:
    """A camera that exists."""


@pytest.fixture
def port() -> Iterator[str]:
    """Return the port of an Echo that is there."""
    ours, theirs = pty.openpty()
    name, over = os.ttyname(theirs), threading.Event()

    def answer() -> None:
        while not over.is_set():
            try:
                os.write(ours, os.read(ours, 64).replace(b"\n", b""))
            except OSError:
                return

    thread = threading.Thread(target=answer, daemon=True)
    tty.setraw(theirs)
    thread.start()
    yield name
    over.set()
    os.close(theirs)
    os.close(ours)


def robots(*settings: dict[str, Any], driver: str = HERE, **keys: Any) -> list[str]:
    """Return what makes the platoon's first robots Echoes."""
    changes = ["tracker.source=camera", "camera.source=v4l2"]
    for row, given in enumerate(settings):
        changes += [f"robots.{row}.driver='{driver}'"]
        changes += [f"robots.{row}.settings.{key}={value}" for key, value in given.items()]
        changes += [f"robots.{row}.{key}={value}" for key, value in keys.items()]
    return changes


def told(*changes: str) -> list[tuple[str, str]]:
    config = load_config(PLATOON, changes)
    return list(check_drivers.complaints(config)) or check_drivers.unreachable(config)


def test_a_robot_that_answers_is_accepted_and_let_go(port: str, tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    for _ in range(2):
        assert told(*robots({"port": port, "closed": closed})) == []
    assert len(closed.read_text().splitlines()) == 2


def test_drivers_are_constructed_one_after_the_other_in_order(tmp_path: Path) -> None:
    made = tmp_path / "made"
    assert told(*robots(*[{"made": made}] * 4, driver=f"{__name__}:Crowded")) == []
    assert made.read_text().split() == ["r1", "r2", "r3", "r4"]


def test_drivers_that_failed_at_once_are_made_again_one_after_the_other(tmp_path: Path) -> None:
    made = tmp_path / "made"
    config = load_config(PLATOON, robots(*[{"made": made}] * 4, driver=f"{__name__}:Crowded"))
    drivers = ConfiguredDrivers(config, CLOCK.now_ns)
    contexts = [drivers.context(robot.id) for robot in config.robots[:4]]
    with ThreadPoolExecutor(4) as pool:
        assert len(list(pool.map(drivers.driver, contexts))) == 4


def test_a_driver_that_crashes_is_named_and_the_command_goes_on(tmp_path: Path) -> None:
    settings = [{"made": tmp_path / "made"}, {"made": tmp_path / "made", "ends_by": "SIGKILL"}]
    ((path, why),) = told(*robots(*settings, driver=f"{__name__}:Crowded"))
    assert path == "robots.1.driver"
    assert why == "the process that opened it was killed by SIGKILL: mend its driver"


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        ("Mute", "has no write and no close: write what drivers/YOUR_OWN.md describes"),
        ("Plain", "has Settings that are no pydantic model: derive them from pydantic.BaseModel"),
        ("Failing", "raised KeyError: 'gain': mend line "),
        ("Bare", "2 were given: mend its class"),
        ("Judging", "raised ZeroDivisionError: : mend line "),
    ],
)
def test_a_class_of_ones_own_that_is_wrong_is_named_with_its_mistake(driver: str, words: str) -> None:
    settings = {"made": "made"} if driver == "Judging" else {}
    ((path, why),) = told(*robots(settings, driver=f"{__name__}:{driver}"))
    assert path == "robots.0.driver"
    assert words in why
    assert (__file__ in why) == ("mend line" in words)


def test_a_plant_of_ones_own_that_is_wrong_is_named_with_its_mistake() -> None:
    found = refusals(load_config(PLATOON, [f"plant.model={__name__}:Judging"]), lockstep=True)
    assert [path for path, _ in found] == ["plant.settings.made"]
    changes = [f"plant.model={__name__}:Judging", "plant.settings={made: x}"]
    (lacking, (path, why)) = refusals(load_config(PLATOON, changes), lockstep=True)
    assert lacking[1].endswith("has no step and no state: write what robofleet/simulation/PLANTS.md describes")
    assert path == "plant.model"
    assert "raised ZeroDivisionError: : mend line " in why


def test_robots_that_nobody_came_to_open_are_refused(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slices, "world", lambda _: os._exit(3))
    complaints = told(*robots({"port": port}, {"port": port + "2"}))
    assert [path for path, _ in complaints] == ["robots.0.settings.port", "robots.1.settings.port"]
    assert {why for _, why in complaints} == {"the process that opened it ended with exit code 3: mend its driver"}


@pytest.mark.parametrize(
    ("settings", "path", "words"),
    [
        ({"port": "/dev/ttyNONE"}, "robots.0.settings.port", "/dev/ttyNONE: there is no such port"),
        ({"port": "/dev/null"}, "robots.0.settings.port", "/dev/null: this is not a serial port"),
        ({"port": "/"}, "robots.0.settings.port", "/: this is not a serial port"),
        ({}, "robots.0.settings.port", "missing"),
        ({"port": "/dev/ttyNONE", "boot_s": -1}, "robots.0.settings.boot_s", ""),
        ({"port": "/dev/ttyNONE", "baud": 1}, "robots.0.settings.baud", ""),
    ],
)
def test_a_robot_that_cannot_be_opened_is_named_at_its_place(settings: dict[str, Any], path: str, words: str) -> None:
    ((where, why),) = told(*robots(settings))
    assert where == path
    assert words in why


def test_a_port_that_another_program_has_is_refused(port: str) -> None:
    held = SerialPort(port, 57600)
    try:
        ((path, why),) = told(*robots({"port": port}))
    finally:
        held.close()
    assert (path, why) == ("robots.0.settings.port", f"{port}: another program has it open: end that one")


def test_a_robot_that_speaks_another_protocol_is_refused() -> None:
    ours, theirs = pty.openpty()
    try:
        ((path, why),) = told(*robots({"port": os.ttyname(theirs)}))
    finally:
        os.close(ours)
        os.close(theirs)
    assert path == "robots.0.settings.port"
    assert "is it another robot?" in why


def test_two_robots_do_not_share_a_port_whatever_it_is_called(tmp_path: Path) -> None:
    (tmp_path / "left").symlink_to("/dev/ttyNONE")
    complaint = told(*robots({"port": "/dev/ttyNONE"}, {"port": tmp_path / "left"}))
    assert complaint == [("robots.1.settings.port", "r1 has this port: each robot needs its own")]


def test_what_a_driver_refuses_is_said_at_its_place_and_nothing_is_opened(port: str) -> None:
    changes = robots({"port": "/dev/ttyNONE"})
    ((path, why),) = told(*changes, "robots.0.vehicle.wheel_radius_m=0.0162")
    assert (path, why) == ("robots.0.vehicle.wheel_radius_m", "an Echo's wheels are smaller: lower it")


def test_robots_are_opened_at_once_and_a_slow_one_is_waited_for_and_said(
    port: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before_ns = CLOCK.now_ns()
    slow = [{"port": f"/dev/ttyNONE{n}", "boot_s": 1.2} for n in range(3)]
    complaints = told(*robots({"port": port}, *slow))
    assert [path for path, _ in complaints] == [f"robots.{row}.settings.port" for row in (1, 2, 3)]
    assert (CLOCK.now_ns() - before_ns) * 1e-9 < 3.3, "one after the other takes 3.6 s"
    assert "waiting for r2, r3, r4 to answer" in capsys.readouterr().err


def test_a_twin_needs_a_driver_with_a_port() -> None:
    assert told("robots.0.twin=gternal")[0][0] == "robots.0.twin"
    assert told("robots.0.twin=gternel", "robots.0.driver=gternal")[0][0] == "robots.0.twin"
    port = "robots.0.settings.port=/dev/ttyNONE"
    assert told("robots.0.twin=gternal", "robots.0.driver=gternal", port) == [], "it answers in the place of that one"


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_command_names_every_robot_that_does_not_answer_and_leaves_nothing(command: str, tmp_path: Path) -> None:
    config = tmp_path / "lab.yaml"
    tree = yaml.safe_load(PLATOON.read_text())
    for robot in tree["robots"]:
        robot["reality"] = "simulated"
    tree["robots"][1] |= {"driver": HERE, "settings": {"port": "/dev/ttyNONE"}, "reality": "real"}
    tree["camera"]["source"] = f"{__name__}:Eye"
    config.write_text(yaml.safe_dump(tree))
    out = ["--out", str(tmp_path / "out")] if command == "run" else []
    result = robofleet(command, config, *out)
    assert result.exit_code == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith(f"{config}:")
    assert "robots.1.settings.port: /dev/ttyNONE: there is no such port" in line
    assert not (tmp_path / "out").exists()
