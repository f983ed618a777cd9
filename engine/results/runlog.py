"""RunLog: a run's tables on disk, readable while they grow and after the writer was killed.

While running, each table is a row of Arrow IPC *stream* segments `log/<table>.<set>.arrows`; all tables change to a
new set together, when a keyframe is written, so that dropping old sets leaves a log that begins with a keyframe.
`log/keyframes.open` holds the newest keyframe, replaced at every flush. On close each table becomes one Parquet file.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.errors import InvariantBroken, RunError, unknown_name
from engine.results.columns import Columns, Store, checked
from engine.results.folder import (
    LOCK,
    LOG,
    MANIFEST,
    NEWEST,
    SCENARIO,
    disk_errors,
    read_manifest,
    replace_file,
    take_lock,
    write_manifest,
    writer_alive,
)
from engine.results.reading import Log, LogReader, latest_keyframe, with_newest
from engine.results.schema import TABLES, VERSION
from engine.results.segments import (
    append,
    batches_of,
    compact_log,
    copy_log,
    first_rows,
    message_of,
    record_batch,
    scan,
    schema_bytes,
    segment_from_parquet,
    segments_of,
)

__all__ = [
    "KEPT_WHOLE",
    "LOCK",
    "LOG",
    "MANIFEST",
    "NEWEST",
    "SCENARIO",
    "Columns",
    "Log",
    "LogReader",
    "MemoryLog",
    "RunLogWriter",
    "checked",
    "compact_log",
    "copy_log",
    "disk_errors",
    "latest_keyframe",
    "read_manifest",
    "write_manifest",
    "writer_alive",
]


KEPT_WHOLE: tuple[str, ...] = ("orders", "chargers", "commands", "blocks")
"""Small tables that retention never drops: what is open, and what an operator did, stays known."""


@dataclass(slots=True)
class SegmentSet:
    """Segments that were opened together: `motions.004.arrows`, `states.004.arrows` …"""

    number: int
    start_tick: int
    size: int = 0
    rows: dict[str, int] = field(default_factory=dict)


class RunLogWriter:
    """Recorder that writes a run folder. One writer per folder, held by a lock; use as a context manager or close().

    folder: created when absent · manifest: the run's passport, for a new run; None opens an existing folder to
    continue it (see truncate_to) · scenario_toml: text of the scenario · segment_bytes: size at which a set of
    segments is closed · buffer_rows: rows kept in memory before they are flushed on their own · retention_bytes: cap
    of an endless run's log, oldest closed sets go first · keyframe_ticks: keyframes closer than that are not kept.

    Every failure of the disk raises RunError with one sentence; what was written before stays readable, and rows not
    yet written stay buffered for the next flush.
    """

    def __init__(
        self,
        folder: Path | str,
        manifest: Mapping[str, Any] | None = None,
        *,
        scenario_toml: str = "",
        segment_bytes: int = 16 << 20,
        buffer_rows: int = 50_000,
        retention_bytes: int | None = None,
        keyframe_ticks: int = 300,
    ) -> None:
        self.folder = Path(folder)
        self._log = self.folder / LOG
        self._segment_bytes, self._buffer_rows = segment_bytes, buffer_rows
        self._retention_bytes, self._keyframe_ticks = retention_bytes, keyframe_ticks
        self._buffers: dict[str, list[Columns]] = {name: [] for name in TABLES}
        self._buffered = dict.fromkeys(TABLES, 0)
        self._rows = dict.fromkeys(TABLES, 0)  # written to segments, dropped ones included
        self._files: dict[str, tuple[int, int]] = {}  # table → (file descriptor, good length)
        self._newest: Columns | None = None
        self._newest_written = self._newest_kept = True
        self._last_keyframe = -(2**31)
        self._closed = False
        with disk_errors(self.folder):
            self._log.mkdir(parents=True, exist_ok=True)
        self._lock = take_lock(self.folder)
        try:
            self._begin(manifest, scenario_toml)
        except BaseException:
            self._lock.close()
            raise

    def _begin(self, manifest: Mapping[str, Any] | None, scenario_toml: str) -> None:
        exists = (self.folder / MANIFEST).exists()
        if manifest is None and not exists:
            raise RunError(f"{self.folder} holds no run: {MANIFEST} is missing")
        if manifest is not None and exists:
            raise RunError(f"{self.folder} already holds a run; open it without a manifest to continue it")
        if manifest is None:
            self.manifest = read_manifest(self.folder)
            if self.manifest.get("log_version", VERSION) != VERSION:
                raise RunError(f"{self.folder.name} has log version {self.manifest['log_version']}; this is {VERSION}")
            self._sets = self._adopt()
            self.update(status="running")
        else:
            self.manifest = {"run_id": self.folder.name, "log_version": VERSION, "status": "running", **manifest}
            self._sets = [SegmentSet(0, 0)]
            with disk_errors(self.folder):
                if scenario_toml:
                    replace_file(self.folder / SCENARIO, scenario_toml.encode())
            self.update()

    @property
    def rows(self) -> dict[str, int]:
        """Rows per table since the run began: written, buffered, and dropped by retention."""
        return {name: self._rows[name] + self._buffered[name] for name in TABLES}

    def write(self, table: str, columns: Mapping[str, Any]) -> None:
        """Append rows. Arrays are copied. A batch of `keyframes` flushes everything before it."""
        if self._closed:
            raise RunError(f"{self.folder.name} is closed")
        batch, n = checked(table, columns)
        if n == 0:
            return
        if table == "keyframes":
            self._write_keyframe(batch)
            return
        self._buffers[table].append(batch)
        self._buffered[table] += n
        if self._buffered[table] >= self._buffer_rows:
            self._flush_table(table)

    def _write_keyframe(self, batch: Columns) -> None:
        tick = int(batch["tick"].max())
        if self._sets[-1].size + sum(self._buffered.values()) * 8 >= self._segment_bytes:
            self.flush()
            self._rotate(tick)
        keep = tick - self._last_keyframe >= self._keyframe_ticks
        if keep:
            self._last_keyframe = tick
            self._buffers["keyframes"].append(batch)
            self._buffered["keyframes"] += len(batch["tick"])
        self._newest, self._newest_written, self._newest_kept = batch, False, keep
        self.flush()

    def flush(self) -> None:
        """Write what is buffered, then the newest keyframe. After this a kill loses nothing of it."""
        for table in TABLES:
            if self._buffered[table]:
                self._flush_table(table)
        if self._newest is not None and not self._newest_written:
            data = schema_bytes("keyframes", 0) + message_of(record_batch("keyframes", [self._newest]))
            with disk_errors(self.folder):
                replace_file(self._log / NEWEST, data, sync=False)
            self._newest_written = True

    def _flush_table(self, table: str) -> None:
        data = message_of(record_batch(table, self._buffers[table]))
        if table not in self._files:
            self._open_segment(table)
        fd, good = self._files[table]
        with disk_errors(self.folder):
            append(fd, data, good)
        n = self._buffered[table]
        self._files[table] = (fd, good + len(data))
        self._buffers[table], self._buffered[table] = [], 0
        self._rows[table] += n
        now = self._sets[-1]
        now.size += len(data)
        now.rows[table] = now.rows.get(table, 0) + n

    def _open_segment(self, table: str) -> None:
        head = schema_bytes(table, self._rows[table])
        path = self._log / f"{table}.{self._sets[-1].number:03d}.arrows"
        with disk_errors(self.folder):
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
            try:
                append(fd, head, 0)
            except OSError:
                os.close(fd)
                path.unlink(missing_ok=True)
                raise
        self._files[table] = (fd, len(head))
        self._sets[-1].size += len(head)

    def _close_segments(self) -> None:
        for fd, _ in self._files.values():
            os.close(fd)
        self._files.clear()

    def _rotate(self, tick: int) -> None:
        """Begin a new set at a keyframe, and drop the oldest closed ones when the cap is reached."""
        self._close_segments()
        self._sets.append(SegmentSet(self._sets[-1].number + 1, tick))
        self._last_keyframe = -(2**31)
        if self._retention_bytes is None:
            return
        dropped = 0
        while len(self._sets) > 2 and sum(s.size for s in self._sets) > self._retention_bytes:
            old = self._sets.pop(0)
            with disk_errors(self.folder):
                for table in TABLES:
                    if table not in KEPT_WHOLE:
                        (self._log / f"{table}.{old.number:03d}.arrows").unlink(missing_ok=True)
            kept = self.manifest.get("retention") or {}
            rows: dict[str, int] = dict(kept.get("dropped_rows", {}))
            for table, n in old.rows.items():
                if table not in KEPT_WHOLE:
                    rows[table] = rows.get(table, 0) + n
            self.manifest["retention"] = {
                "bytes": self._retention_bytes,
                "first_tick": self._sets[0].start_tick,
                "dropped_rows": rows,
                "kept_whole": list(KEPT_WHOLE),
            }
            dropped += 1
        if dropped:
            self.update()

    def update(self, **fields: Any) -> None:
        """Change fields of the manifest, atomically."""
        with contextlib.suppress(RunError):
            self.manifest["name"] = read_manifest(self.folder).get("name", "")  # a person may rename a live run
        self.manifest.update(fields)
        write_manifest(self.folder, self.manifest)

    def close(self, status: str = "finished", *, compact: bool = True, **fields: Any) -> None:
        """Flush, turn the segments into Parquet unless compact is False, note the status, and release the lock."""
        if self._closed:
            return
        try:
            if compact and self._newest is not None and not self._newest_kept:
                self._buffers["keyframes"].append(self._newest)
                self._newest_kept = True
                self._buffered["keyframes"] += len(self._newest["tick"])
            self.flush()
            self._close_segments()
            if compact:
                with disk_errors(self.folder):
                    compact_log(self._log)
            self.update(status=status, **fields)
        finally:
            self._closed = True
            self._close_segments()
            self._lock.close()

    def __enter__(self) -> RunLogWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close("finished" if kind is None else "failed", compact=kind is None)

    # -- continuing a run

    def _adopt(self, at_least: int = 0) -> list[SegmentSet]:
        """Count what is there, cut torn tails, and go on in a new set."""
        dropped: dict[str, int] = (self.manifest.get("retention") or {}).get("dropped_rows", {})
        sets: dict[int, SegmentSet] = {}
        with disk_errors(self.folder):
            for table in TABLES:
                self._rows[table] = dropped.get(table, 0)
                parquet = self._log / f"{table}.parquet"
                if parquet.exists():
                    segment_from_parquet(parquet, table)
                for number, path in segments_of(self._log, table):
                    found = scan(path)
                    if found.end == 0:
                        path.unlink()
                        continue
                    if found.end < path.stat().st_size:
                        os.truncate(path, found.end)
                    one = sets.setdefault(number, SegmentSet(number, 0))
                    one.size += found.end
                    one.rows[table] = sum(found.rows)
                    self._rows[table] = max(self._rows[table], found.first_row + one.rows[table])
        for number, one in sets.items():
            path = self._log / f"keyframes.{number:03d}.arrows"
            if path.exists() and (first := next(batches_of(path), None)) is not None:
                one.start_tick = int(first.column("tick")[0].as_py())
        ordered = [sets[number] for number in sorted(sets)]
        number = max([at_least, *(n + 1 for n in sets)])
        return [*ordered, SegmentSet(number, ordered[-1].start_tick if ordered else 0)]

    def truncate_to(self, rows_by_table: Mapping[str, int]) -> None:
        """Cut every table to its first n rows (0 for a table not named), so that a resumed run continues exactly there.

        Raises RunError when the log is shorter than asked, or its beginning was dropped.
        """
        if bad := sorted(set(rows_by_table) - set(TABLES)):
            raise InvariantBroken(unknown_name("table", bad[0], TABLES))
        self.flush()
        self._close_segments()
        self._newest, self._last_keyframe = None, -(2**31)
        dropped: dict[str, int] = (self.manifest.get("retention") or {}).get("dropped_rows", {})
        for table in TABLES:
            keep = int(rows_by_table.get(table, 0))
            if keep > self._rows[table]:
                raise RunError(f"{self.folder.name}: {table} has {self._rows[table]} rows; {keep} were expected")
            if keep < dropped.get(table, 0):
                raise RunError(f"{self.folder.name}: the first {dropped[table]} rows of {table} were dropped")
        # new numbers only, so that a reader that follows the old files notices
        number = max((number for number, _ in segments_of(self._log)), default=-1) + 1
        with disk_errors(self.folder):
            (self._log / NEWEST).unlink(missing_ok=True)
            for table in TABLES:
                self._cut(table, int(rows_by_table.get(table, 0)), number)
        self._sets = self._adopt(number + 1)

    def _cut(self, table: str, keep: int, number: int) -> None:
        for _, path in segments_of(self._log, table):
            found = scan(path)
            if found.first_row + sum(found.rows) <= keep:
                continue
            if found.first_row < keep:
                kept = first_rows(batches_of(path), keep - found.first_row)
                data = schema_bytes(table, found.first_row) + b"".join(message_of(b) for b in kept)
                replace_file(self._log / f"{table}.{number:03d}.arrows", data)
            path.unlink()


class MemoryLog:
    """Recorder and reader in one, in memory: for tests and short computations."""

    def __init__(self, *, keyframe_ticks: int = 300) -> None:
        self._stores = {name: Store(name) for name in TABLES}
        self._keyframe_ticks = keyframe_ticks
        self._last_keyframe = -(2**31)
        self._open: Columns | None = None
        self._seen: dict[str, int] = {}
        self.generation = 0
        self.manifest: dict[str, Any] = {}

    @property
    def first_tick(self) -> int:
        """Always 0: nothing is dropped."""
        return 0

    @property
    def rows(self) -> dict[str, int]:
        """Rows per table."""
        return {name: store.n for name, store in self._stores.items()}

    def write(self, table: str, columns: Mapping[str, Any]) -> None:
        """Append rows. Arrays are copied."""
        batch, n = checked(table, columns)
        if n == 0:
            return
        if table == "keyframes":
            self._open = batch
            tick = int(batch["tick"].max())
            if tick - self._last_keyframe < self._keyframe_ticks:
                return
            self._last_keyframe = tick
        self._stores[table].append(batch)

    def flush(self) -> None:
        """Nothing to do: rows are readable at once."""

    def close(self, status: str = "finished", **fields: Any) -> None:
        """Note the status in `manifest`."""
        self.manifest.update(status=status, **fields)

    def table(self, name: str) -> Columns:
        """Columns of one table; raises KeyError for a table that isn't in the schema."""
        if name not in self._stores:
            raise KeyError(unknown_name("table", name, TABLES))
        columns = self._stores[name].columns()
        return with_newest(columns, self._open) if name == "keyframes" else columns

    def refresh(self) -> bool:
        """True when rows were written since the last call."""
        before, self._seen = self._seen, self.rows
        return before != self._seen

    def truncate_to(self, rows_by_table: Mapping[str, int]) -> None:
        """Cut every table to its first n rows (0 for a table not named)."""
        for name, store in self._stores.items():
            store.cut(int(rows_by_table.get(name, 0)))
        self._open, self._last_keyframe = None, -(2**31)
        self.generation += 1
