"""What is installed: Python, the packages of each extra, the robots' drivers, compiled kernels."""

import platform
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from importlib.util import find_spec
from pathlib import Path

from robofleet.core.plugins import PluginError, load
from robofleet.core.refusal import how_to_install
from robofleet.doctor.elsewhere import NoAnswerError, run_apart
from robofleet.doctor.findings import Finding, Mark, ok
from robofleet.doctor.needs import Needs

_REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[^]]*\])?([^;]*)(?:;.*extra == ['\"]([\w-]+)['\"].*)?")
_FOR_DEVELOPERS = {"bench", "dev"}
_KERNELS = (
    "import json, robofleet.core.kernels.store as s; "
    "print(json.dumps([str(s.folder()), str(s.SHIPPED) if s.runs_shipped() else '']))"
)
_WITHOUT = {  # an extra that the configuration does not need, and what is not there without it
    "basler": "only Basler's cameras need it",
    "web": "only the operator's page (`--web`, `robofleet web`) needs it",
    "lab": "only the computer that runs the whole fleet needs it, and not one that runs `robofleet node driver`",
}


def python(_needs: Needs) -> Iterator[Finding]:
    says = f"{platform.python_version()}, {platform.machine()}, {sys.executable}"
    if sys.maxsize <= 1 << 32:
        yield Finding("Python", Mark.WARN, f"{says}, 32 bit", "take a 64-bit Python: numba and OpenCV have no other")
    else:
        yield ok("Python", says)


def packages(needs: Needs) -> Iterator[Finding]:
    """The packages of robofleet itself and of each extra, with versions that are too old."""
    try:
        requirements, extras = requires("robofleet") or [], metadata("robofleet").get_all("Provides-Extra") or []
    except PackageNotFoundError:
        yield Finding("packages", Mark.MISSING, "robofleet is not installed in this Python", how_to_install("lab"))
        return
    needed = {""} | ({"lab"} if needs.whole_run else set())
    if any(camera.source == "basler" for camera in needs.cameras):
        needed.add("basler")
    for extra in ["", *(name for name in extras if name not in _FOR_DEVELOPERS)]:
        names = [
            (name, bounds)
            for name, bounds, needed_by in map(_parts, requirements)
            if needed_by == extra and name != "robofleet"
        ]
        if not names:
            continue  # another name of an extra that stands here too
        yield _of_extra(extra, names, required=extra in needed)


def _of_extra(extra: str, names: list[tuple[str, str]], *, required: bool) -> Finding:
    title = f"packages of {extra}" if extra else "packages"
    wrong = [words for name, bounds in names if (words := _unfit(name, bounds))]
    if not wrong:
        return ok(title, ", ".join(f"{name} {version(name)}" for name, _ in names))
    if required:
        return Finding(title, Mark.MISSING, "; ".join(wrong), how_to_install(extra or "lab"))
    return ok(title, f"{'; '.join(wrong)}: {_WITHOUT.get(extra, 'this machine does not need it')}")


def _parts(requirement: str) -> tuple[str, str, str]:
    found = _REQUIREMENT.fullmatch(requirement.strip())
    assert found is not None, requirement
    return found[1], found[2].strip(), found[3] or ""


def _unfit(name: str, bounds: str) -> str:
    try:
        installed = version(name)
    except PackageNotFoundError:
        return f"{name} is not installed"
    for relation, limit in re.findall(r"(>=|<)\s*([\d.]+)", bounds):
        if (_numbers(installed) >= _numbers(limit)) is (relation == "<"):
            return f"{name} {installed} is installed, and {bounds} is needed"
    return ""


def _numbers(text: str) -> tuple[int, ...]:
    numbers = [int(number) for number in re.findall(r"\d+", re.split(r"[^\d.]", text)[0])]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def drivers(needs: Needs) -> Iterator[Finding]:
    robots_of: dict[str, list[str]] = {}
    for robot in needs.robots:
        robots_of.setdefault(robot.driver, []).append(robot.id)
    for name, robots in robots_of.items():
        title = f"driver {name}"
        try:
            load("robofleet.drivers", name)
        except PluginError as error:
            yield Finding(title, Mark.MISSING, f"for {', '.join(robots)}: {error}")
        else:
            yield ok(title, f"for {', '.join(robots)}")


def kernels(needs: Needs) -> Iterator[Finding]:
    """Whether compiled functions are kept from an earlier run, and where."""
    if not needs.whole_run or find_spec("numba") is None:
        return  # not needed, or said already
    try:
        folder, shipped = run_apart(_KERNELS)
    except NoAnswerError as error:
        cure = f"`{sys.executable} -c 'import numba'` says why"
        yield Finding("kernels", Mark.WARN, f"numba could not be asked: {error}", cure)
        return
    for cache in filter(None, (shipped, folder)):
        files = [file for file in Path(cache).glob("*") if not file.name.startswith(".")]
        if files:
            size_mb = sum(file.stat().st_size for file in files) / 1e6
            yield ok("kernels", f"{len(files)} compiled functions, {size_mb:.1f} MB, in {cache}")
            return
    cure = "the first run compiles them, once; later ones load them"
    yield Finding("kernels", Mark.WARN, f"none is compiled in {folder}", cure)
