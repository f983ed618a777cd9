"""A run's tables as CSV or Parquet files, for other programs."""

from __future__ import annotations

import itertools
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from engine.errors import RunError
from engine.results.runlog import LogReader
from engine.results.schema import LIST, TABLES, TEXT


def write_tables(run_folder: Path, target: Path, kind: str) -> list[Path]:
    """Writes every table of the log to `target/<table>.csv` or `.parquet` and returns the files.

    Lists become numbers separated by spaces in CSV. Raises RunError when a file can't be written.
    """
    import pyarrow.csv
    import pyarrow.parquet

    reader = LogReader(run_folder)
    written = []
    try:
        target.mkdir(parents=True, exist_ok=True)
        for name in TABLES:
            table = arrow_table(name, reader.table(name), lists_as_text=kind == "csv")
            file = target / f"{name}.{kind}"
            if kind == "csv":
                pyarrow.csv.write_csv(table, file)
            else:
                pyarrow.parquet.write_table(table, file)
            written.append(file)
    except OSError as error:
        raise RunError(f"{target} can't be written: {error.strerror or error}") from None
    return written


def arrow_table(name: str, columns: dict[str, Any], *, lists_as_text: bool) -> Any:
    """One table of the schema as an Arrow table."""
    import pyarrow

    arrays = {}
    for column, kind in TABLES[name].items():
        values = columns[column]
        if kind == LIST:
            flat, offsets = values
            if lists_as_text:
                rows = (flat[a:b] for a, b in itertools.pairwise(offsets))
                arrays[column] = pyarrow.array([" ".join(map(str, row.tolist())) for row in rows], pyarrow.string())
            else:
                arrays[column] = pyarrow.ListArray.from_arrays(
                    pyarrow.array(offsets, pyarrow.int32()), pyarrow.array(flat, pyarrow.int32())
                )
        elif kind == TEXT:
            arrays[column] = pyarrow.array(list(values), pyarrow.string())
        else:
            arrays[column] = pyarrow.array(values)
    return pyarrow.table(arrays)


def zipped(run_folder: Path, kind: str) -> Path:
    """A temporary zip of the tables, with the passport and the scenario; whoever asked removes it."""
    with tempfile.TemporaryDirectory(prefix="wattlane-") as scratch:
        files = write_tables(run_folder, Path(scratch) / "tables", kind)
        files += [run_folder / name for name in ("manifest.json", "scenario.toml") if (run_folder / name).is_file()]
        method = zipfile.ZIP_DEFLATED if kind == "csv" else zipfile.ZIP_STORED
        with tempfile.NamedTemporaryFile(prefix="wattlane-", suffix=".zip", delete=False) as made:
            with zipfile.ZipFile(made, "w", method, compresslevel=1) as archive:
                for file in files:
                    archive.write(file, f"{run_folder.name}/{file.name}")
            return Path(made.name)
