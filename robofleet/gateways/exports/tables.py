"""A recorded run's tables as CSV or Parquet files, written part by part: the run may be longer than memory."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from robofleet.config.load import resolved_yaml
from robofleet.recording.columns import COLUMNS
from robofleet.recording.reading import Imports, about
from robofleet.recording.run import Recording
from robofleet.reports import run_tables
from robofleet.reports.run_tables import Words

_UNITS = {
    "_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad", "_deg": "deg", "_mm": "mm", "_ms": "ms", "_m": "m", "_s": "s",
}  # fmt: skip
_MEANINGS = {column.name: column.meaning for column in COLUMNS}


def write_csv(run: Path, folder: Path, imports: Imports) -> None:
    """Write each table of a run as a CSV file; what is not known is empty.

    Raises:
        RecordingError: The recording cannot be read.
        OSError: A file cannot be written.
    """
    _write(run, folder, imports, "csv", csv.CSVWriter, plain=True)


def write_parquet(run: Path, folder: Path, imports: Imports) -> None:
    """Write each table of a run as a Parquet file, with units and versions; as ``write_csv``."""
    _write(run, folder, imports, "parquet", partial(parquet.ParquetWriter, compression="zstd"), plain=False)


def _write(
    run: Path, folder: Path, imports: Imports, ending: str, writer: Callable[..., AbstractContextManager[Any]], *,
    plain: bool,
) -> None:  # fmt: skip
    recording = about(run, imports)
    metadata = _metadata(run, recording)
    folder.mkdir()
    for name in run_tables.names(recording.groups):
        parts = _parts(run, recording, name, imports, plain=plain)
        first = next(parts)
        schema = first.schema.with_metadata(metadata | {"table": name})
        with writer(str(folder / f"{name}.{ending}"), schema) as file:
            file.write_table(first.cast(schema))
            for part in parts:
                file.write_table(part.cast(schema))


def _parts(run: Path, recording: Recording, name: str, imports: Imports, *, plain: bool) -> Iterator[pa.Table]:
    """Yield the parts of a table; ``plain``: with words as text, and without metadata."""
    for columns in run_tables.parts(run, recording.groups, name, imports):
        arrays = {column: _array(values) for column, values in columns.items()}
        if plain:
            arrays = {
                column: a.cast(pa.string()) if pa.types.is_dictionary(a.type) else a for column, a in arrays.items()
            }
        fields = [pa.field(column, array.type, metadata=_about(column)) for column, array in arrays.items()]
        yield pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))


def _array(values: Any) -> pa.Array:
    if isinstance(values, Words):
        codes = pa.array(values.codes, pa.int16(), mask=values.codes < 0)
        return pa.DictionaryArray.from_arrays(codes, pa.array(values.words, pa.string()))
    if values.dtype == object:
        return pa.array(values.tolist(), pa.string())
    return pa.array(values, mask=np.isnan(values) if values.dtype.kind == "f" else None)


def _about(column: str) -> dict[str, str]:
    """Return unit and meaning of a column, as far as they are known."""
    unit = next((unit for ending, unit in _UNITS.items() if column.endswith(ending)), "")
    return {key: text for key, text in (("unit", unit), ("meaning", _MEANINGS.get(column, ""))) if text}


def _metadata(run: Path, recording: Recording) -> dict[str, str]:
    """Return what each table says of its run."""
    provenance = recording.provenance
    made = {} if provenance is None else {"mode": provenance.mode, "epoch_ns": str(provenance.epoch_ns)}
    versions = {} if provenance is None else provenance.versions
    return {
        "run": run.absolute().name,
        "config": resolved_yaml(recording.config),
        "written_by": f"robofleet {version('robofleet')}",
        **made,
        **{f"version of {name}": text for name, text in versions.items()},
    }
