"""Calibrations as YAML files: written atomically; the previous file is kept."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import yaml

from robofleet.config.calibrated import Provenance
from robofleet.config.files.part import load_part
from robofleet.config.load import ConfigError
from robofleet.core.clock import utc_now
from robofleet.core.errors import BadInputError
from robofleet.core.settings import Model
from robofleet.runs.folder import STAMP

EARLIER = "earlier"  # folder beside a calibration, of those that it replaced

M = TypeVar("M", bound=Model)


class CalibrationError(BadInputError):
    """Raised where a measurement or a file cannot be used: one line for each fault, and how to mend it."""

    def __init__(self, faults: Iterable[str] | str) -> None:
        self.faults = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__("\n".join(self.faults))


def provenance(
    command: str,
    inputs: Mapping[str, bytes],
    figures: Mapping[str, float | None],
    parameters: Sequence[str] = (),
    covariance: Sequence[Sequence[float]] = (),
) -> Provenance:
    """Return where a calibration comes from; ``inputs``: name of what was measured, and its bytes.

    The covariance keeps twelve digits: of parameters that all but replace one another, it has no inverse with six.
    """
    return Provenance(
        date=utc_now().isoformat(timespec="seconds"),
        tool=f"robofleet {version('robofleet')}, calibrate {command}",
        inputs={name: hashlib.blake2b(data, digest_size=16).hexdigest() for name, data in inputs.items()},
        figures={name: None if value is None else float(f"{value:.6g}") for name, value in figures.items()},
        parameters=tuple(parameters),
        covariance=tuple(tuple(float(f"{value:.12g}") for value in row) for row in covariance),
    )


def load(file: Path, kind: type[M]) -> M:
    """Read a calibration; CalibrationError with every fault of a file that cannot be read or is impossible."""
    try:
        return load_part(file, kind)
    except ConfigError as error:
        raise CalibrationError(error.faults) from error


def save(file: Path, calibration: Model) -> Path | None:
    """Write a calibration to ``file``; returns where the one before was moved to, None if there was none.

    Raises:
        CalibrationError: if it cannot be written; the one before is still in its place then.
    """
    header = f"# Written by robofleet calibrate; the one before it is in {EARLIER}/.\n"
    tree = calibration.model_dump(mode="json", exclude_none=True)
    text = header + yaml.safe_dump(tree, sort_keys=False, width=110)
    written = file.with_name(f".{file.name}.new")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        kept = _keep(file) if file.exists() else None
        written.write_text(text, encoding="utf-8")
        written.replace(file)
    except OSError as error:
        raise CalibrationError(f"{file}: cannot be written: {error.strerror}") from error
    return kept


def _keep(file: Path) -> Path:
    """Copy a calibration into the folder of the earlier ones, under the instant of its replacement."""
    folder = file.parent / EARLIER
    folder.mkdir(exist_ok=True)
    stamp, count = utc_now().strftime(STAMP), 0
    while (kept := folder / f"{file.stem}-{stamp}{f'-{count}' if count else ''}.yaml").exists():
        count += 1
    kept.write_bytes(file.read_bytes())
    return kept
