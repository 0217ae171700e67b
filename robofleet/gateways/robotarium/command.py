"""The command ``robotarium``."""

import runpy
import sys
import traceback
import warnings
from pathlib import Path
from types import TracebackType
from typing import Annotated

import matplotlib as mpl
import typer

from robofleet.config.files.names import SHIPPED
from robofleet.config.files.yamlfile import printable
from robofleet.config.load import ConfigError
from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.refusal import LAB_MODULES, RefusedError, need_extra, new_folder
from robofleet.gateways.robotarium import script as scripts
from robofleet.gateways.robotarium import stand_in
from robofleet.gateways.robotarium.runs import Runs, Wanted
from robofleet.runs.folder import DEFAULT_FOLDER
from robofleet.scripts.fleet import FleetError

_CONFIG = SHIPPED / "robotarium.yaml"


def robotarium(
    script: Annotated[Path, typer.Argument(metavar="SCRIPT", help="A Python script for the Robotarium's simulator.")],
    rest: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CONFIG] [-- ARGUMENTS]",
            help="A configuration (YAML) with arena and robots; then the script's own arguments.",
        ),
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Run in real time; without it, simulate as fast as possible.")
    ] = False,
    ideal: Annotated[
        bool,
        typer.Option(
            "--ideal", help="Simulate robots without lag, dead band and slip, as the original simulator does."
        ),
    ] = False,
    api: Annotated[
        int | None,
        typer.Option(metavar="1|2", help="Version of the Robotarium's interface. Default: found in the script."),
    ] = None,
    overrides: Annotated[
        list[str], typer.Option("--set", metavar="KEY=VALUE", help="Change a key of CONFIG. Repeatable.")
    ] = [],  # noqa: B006 - typer copies it
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for the results. {DEFAULT_FOLDER}")] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Open no window, and print only what the script prints.")
    ] = False,
) -> None:
    """Run a script written for the Robotarium.

    The script stays as it is. Its robots are those of a configuration, simulated or real.

    $ robofleet robotarium go_to_point.py

    $ robofleet robotarium go_to_point.py configs/robotarium.yaml --real-time --set tracker.source=camera
    """
    config, arguments = _split(rest or [])
    version = _read(script, api)
    need_extra("lab", *LAB_MODULES)
    if out is not None:
        new_folder(out)
    runs = Runs(Wanted(config, script.stem, real_time, ideal, tuple(overrides), out, quiet))
    code = _run(script, arguments, runs, version)
    if not quiet:
        _tell(runs)
    if code:
        raise typer.Exit(code)


def _split(rest: list[str]) -> tuple[Path, list[str]]:
    """Return the configuration, and the script's own arguments."""
    if rest and Path(rest[0]).suffix in CONFIGURATIONS:
        return Path(rest[0]), rest[1:]
    return _CONFIG, rest


def _read(script: Path, api: int | None) -> int:
    """Return the script's version; RefusedError where it cannot be run."""
    if api not in (None, *scripts.VERSIONS):
        raise RefusedError(f"--api {api}: there are versions 1 and 2")
    try:
        source = script.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise RefusedError(f"{script} cannot be read: {why}: name a Python script") from error
    sys.path.insert(0, str(script.absolute().parent))
    try:
        package = scripts.installed()
        found = api or scripts.version_of(source, str(script)) or scripts.version_installed(package)
    except SyntaxError as error:
        traceback.print_exception(error, limit=0)
        raise RefusedError(f"{script} is no Python: mend the line above") from error
    except scripts.ScriptError as error:
        raise RefusedError(str(error)) from error
    return found


def _run(script: Path, arguments: list[str], runs: "Runs", version: int) -> int:
    """Run the script as Python does, and end what it has begun; return the exit code."""
    code, failed = 0, None
    if runs.wanted.quiet:
        mpl.use("Agg")
    if version == 1:
        stand_in.restore()
    sys.argv[:] = [str(script), *arguments]
    try:
        with stand_in.installed(runs, version), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*non-interactive")  # pictures are kept, not shown
            runpy.run_path(str(script), run_name="__main__")
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
        failed = f"the script ended with exit code {code}" if code else None
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
    except KeyboardInterrupt:
        code, failed = 1, "the operator interrupted"
        print("stopped: the operator interrupted", file=sys.stderr)
    except (ConfigError, FleetError) as error:
        code, failed = (1 if runs.run else 2), str(error)
        print(printable(f"{script}: {failed}"), file=sys.stderr)
    except Exception as error:  # noqa: BLE001 - whatever a script raises is its own
        code, failed = (1 if runs.run else 2), f"{type(error).__name__}: {error}"
        traceback.print_exception(error.with_traceback(_own(error.__traceback__, script)))
        print(printable(f"{script} ended by {failed}{_hint(error, version)}"), file=sys.stderr)
    runs.end(failed)
    if not code and not runs.moved:
        print(f"{script} never called step(): no robot moved", file=sys.stderr)
        code = 2
    return code


def _own(trace: TracebackType | None, script: Path) -> TracebackType | None:
    """Return a traceback without what stands before the script."""
    at = trace
    while at is not None and at.tb_frame.f_code.co_filename != str(script):
        at = at.tb_next
    return at or trace


def _hint(error: Exception, version: int) -> str:
    """Return why a name may be missing: the installed package is of the other version."""
    if not isinstance(error, ImportError | NameError | AttributeError | TypeError):
        return ""
    installed = scripts.version_installed(scripts.installed())
    if installed == version:
        return ""
    return f": the script is of version {version}, the installed {scripts.PACKAGE} of version {installed}"


def _tell(runs: "Runs") -> None:
    """Say what the project's own checks found in the last run."""
    run = runs.last
    if run is None or not (summary := run.fleet.summary):
        return
    gap, changed = summary.get("min_gap_mm"), summary.get("filtered_fraction") or 0.0
    parts = [f"{summary['outcome']}", f"{run.steps} steps of {len(run.robots)} robots"]
    parts += [] if gap is None else [f"smallest gap between bodies {gap:.0f} mm"]
    parts.append(f"the barrier changed {changed:.1%} of the commands")
    held = run.fleet.held
    parts += [f"the run was held and went on {held} time{'s' * (held > 1)}"] if held else []
    print(printable(f"robofleet: {', '.join(parts)}"))
    print(printable(f"robofleet: {run.folder}/report.html"))
