"""Reading a run's log: from Parquet when it is closed, else from the segments, while they grow."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from engine.errors import RunError, unknown_name
from engine.results.columns import Columns, Store
from engine.results.folder import LOG, NEWEST, read_manifest
from engine.results.schema import TABLES, VERSION
from engine.results.segments import SCHEMAS, batches_of, columns_of, head_of, parse, segments_of


class Log(Protocol):
    """What can be asked of a recorded run, on disk or in memory."""

    manifest: dict[str, Any]

    @property
    def first_tick(self) -> int:
        """First tick that the log still covers: 0 unless retention dropped the beginning."""

    @property
    def generation(self) -> int:
        """Changes when rows that were read before are no longer valid: the log was cut and goes on differently."""

    def table(self, name: str) -> Columns:
        """Columns of one table of the schema, as far as they were read."""

    def refresh(self) -> bool:
        """Read what was appended since; True when there was anything."""


class LogReader:
    """Reads a run folder, also while it is being written: Parquet when closed, else the segments.

    Tables are read when first asked for; refresh() reads only what was appended, and ignores a torn last batch until
    it is complete. Arrays that were handed out stay valid and don't change. Raises RunError for a folder without a
    run, another log version, or damaged files.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.manifest = read_manifest(self.folder)
        if self.manifest.get("log_version", VERSION) != VERSION:
            raise RunError(f"{self.folder.name} has log version {self.manifest['log_version']}; this is {VERSION}")
        self._log = self.folder / LOG
        self._tables: dict[str, Reading] = {}
        self._open: Columns | None = None

    @property
    def first_tick(self) -> int:
        """First tick that the log still covers: 0 unless retention dropped the beginning."""
        motions = self._reading("motions")
        frames = self._reading("keyframes").store
        if motions.first_row == 0 or frames.n == 0:
            return 0
        return int(frames.columns()["tick"][0])

    @property
    def generation(self) -> int:
        """Changes when rows that were read before are no longer valid: the log was cut and goes on differently."""
        return sum(reading.reloads for reading in self._tables.values())

    def table(self, name: str) -> Columns:
        """Columns of one table; raises KeyError for a table that isn't in the schema."""
        reading = self._reading(name)
        columns = reading.store.columns()
        if name == "keyframes":
            return with_newest(columns, self._newest())
        return columns

    def refresh(self) -> bool:
        """Read what was appended since to the tables in use; True when there was anything."""
        before = self._open
        self._open = None
        newest = self._newest()  # before the tables, which are written first: so they are never older
        changed = newest is not None and (before is None or int(newest["tick"][0]) != int(before["tick"][0]))
        for name, reading in self._tables.items():
            changed |= reading.read(self._log, name)
        return changed

    def _reading(self, name: str) -> Reading:
        if name not in self._tables:
            if name not in TABLES:
                raise KeyError(unknown_name("table", name, TABLES))
            if self._open is None:
                self._newest()
            reading = Reading(name)
            reading.read(self._log, name)
            self._tables[name] = reading
        return self._tables[name]

    def _newest(self) -> Columns | None:
        if self._open is None:
            path = self._log / NEWEST
            with contextlib.suppress(FileNotFoundError):
                for batch in batches_of(path):
                    self._open = columns_of(batch, "keyframes")
        return self._open


def with_newest(frames: Columns, newest: Columns | None) -> Columns:
    """The kept keyframes, with the newest one, which takes the place of one of the same tick."""
    if newest is None or (len(frames["tick"]) and int(frames["tick"][-1]) > int(newest["tick"][0])):
        return frames
    n = int(np.searchsorted(frames["tick"], int(newest["tick"][0])))
    return {name: np.concatenate([frames[name][:n], newest[name]]) for name in frames}


def latest_keyframe(log: Log) -> Columns:
    """The newest keyframe: what every vehicle was doing when the log was last flushed, one row each."""
    frames = log.table("keyframes")
    ticks = frames["tick"]
    if len(ticks) == 0:
        return frames
    latest = np.nonzero(ticks == ticks[-1])[0]
    # a tick may have been flushed twice, with commands in between: its last rows count
    _, back = np.unique(frames["vehicle"][latest][::-1], return_index=True)
    keep = latest[::-1][back]
    return {name: values[keep] for name, values in frames.items()}


@dataclass(slots=True)
class Reading:
    """How far a table was read: up to `offset` in segment `number`, or a whole Parquet file."""

    name: str
    store: Store = field(init=False)
    first_row: int = 0
    number: int = -1
    offset: int = 0
    parquet: bool = False
    reloads: int = 0

    def __post_init__(self) -> None:
        self.store = Store(self.name)

    def read(self, log: Path, name: str) -> bool:
        before = self.store.n
        for _ in range(5):
            try:
                if self._advance(log, name):
                    return self.store.n != before
            except FileNotFoundError:
                continue  # the writer replaced segments by Parquet, or dropped one, under our eyes
            before = -1
            self.reloads += 1
            self.store.clear()
            self.first_row, self.number, self.offset, self.parquet = 0, -1, 0, False
        raise RunError(f"{log.parent.name}: the files of table {name} don't follow each other")

    def _advance(self, log: Path, name: str) -> bool:
        """Read what is new; False when the files no longer continue what was read (the log was cut)."""
        path = log / f"{name}.parquet"
        if path.exists():
            if self.parquet:
                return True
            return self._read_parquet(path, name)
        if self.parquet:
            return False
        segments = segments_of(log, name)
        if self.number >= 0 and not any(number == self.number for number, _ in segments):
            newer = [number for number, _ in segments if number > self.number]
            if not newer or len(newer) < len(segments):
                return False
        for number, segment in segments:
            if number < self.number:
                continue
            if not self._read_segment(number, segment, name):
                return False
        return True

    def _read_segment(self, number: int, path: Path, name: str) -> bool:
        with path.open("rb") as file:
            if number == self.number:
                size = os.fstat(file.fileno()).st_size
                if size < self.offset:
                    return False
                if size == self.offset:
                    return True
                file.seek(self.offset)
                batches, used = parse(file.read(), SCHEMAS[name], path)
            else:
                data = file.read()
                schema, start = head_of(data)
                if schema is None:
                    return True  # not even its head is there yet
                first = int((schema.metadata or {}).get(b"first_row", b"0"))
                if self.number < 0:
                    self.first_row = first
                elif first != self.first_row + self.store.n:
                    return False
                self.number, self.offset = number, start
                batches, used = parse(data[start:], SCHEMAS[name], path)
        self.offset += used
        for batch in batches:
            self.store.append(columns_of(batch, name))
        return True

    def _read_parquet(self, path: Path, name: str) -> bool:
        try:
            with pq.ParquetFile(path) as file:
                first = int((file.schema_arrow.metadata or {}).get(b"first_row", b"0"))
                table = file.read()
        except pa.ArrowInvalid as error:
            raise RunError(f"{path} is damaged: {error}") from error
        if self.number >= 0:
            skip = self.first_row + self.store.n - first
            if not 0 <= skip <= table.num_rows:
                return False
            table = table.slice(skip)
        else:
            self.first_row = first
        if set(table.column_names) != set(TABLES[name]):
            raise RunError(f"{path} does not have the columns of table {name}")
        if table.num_rows:
            self.store.append(columns_of(table.combine_chunks().to_batches()[0], name))
        self.parquet = True
        return True
