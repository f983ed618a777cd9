"""Segments on disk: Arrow IPC streams that grow batch by batch, can be torn, and become Parquet in the end."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from engine.errors import RunError
from engine.results.columns import Columns
from engine.results.folder import LOG, NEWEST, disk_errors, replace_file
from engine.results.schema import LIST, TABLES, TEXT, VERSION

_SEGMENT = re.compile(r"^([a-z]+)\.(\d{3,})\.arrows$")


_ARROW: dict[str, Any] = {
    "int8": pa.int8(),
    "int16": pa.int16(),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "uint8": pa.uint8(),
    TEXT: pa.string(),
    LIST: pa.list_(pa.int32()),
}


CODEC = next((c for c in ("zstd", "lz4") if pa.Codec.is_available(c)), None)


SCHEMAS: dict[str, Any] = {
    name: pa.schema([pa.field(column, _ARROW[kind], nullable=False) for column, kind in kinds.items()])
    for name, kinds in TABLES.items()
}


_DICTIONARIES: dict[str, list[str]] = {
    name: [column for column, kind in kinds.items() if kind in (TEXT, "int8")] for name, kinds in TABLES.items()
}
"""Columns of few different values."""


_DIFFERENCES: dict[str, dict[str, str]] = {
    name: {column: "DELTA_BINARY_PACKED" for column, kind in kinds.items() if kind in ("int32", "int64")}
    for name, kinds in TABLES.items()
}
"""How the others are stored: neighbours are alike, so this takes a third less than dictionaries do, and less time."""


_OPTIONS = pa.ipc.IpcWriteOptions(compression=CODEC)


def schema_bytes(table: str, first_row: int) -> bytes:
    meta = {"first_row": str(first_row), "log_version": str(VERSION), "table": table}
    return bytes(SCHEMAS[table].with_metadata(meta).serialize())


def message_of(batch: Any) -> bytes:
    """One record batch as a compressed IPC message; a stream would put the schema before each."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema, options=_OPTIONS) as stream:
        stream.write_batch(batch)
        end = sink.tell()
    return bytes(memoryview(sink.getvalue())[len(batch.schema.serialize()) : end])


def record_batch(table: str, parts: list[Columns]) -> Any:
    arrays = []
    for name, kind in TABLES[table].items():
        if kind == LIST:
            values = np.concatenate([p[name][0] for p in parts])
            lengths = np.concatenate([np.diff(p[name][1]) for p in parts])
            offsets = np.zeros(len(lengths) + 1, np.int32)
            np.cumsum(lengths, out=offsets[1:])
            arrays.append(pa.ListArray.from_arrays(pa.array(offsets), pa.array(values)))
        else:
            arrays.append(pa.array(np.concatenate([p[name] for p in parts]), _ARROW[kind]))
    return pa.RecordBatch.from_arrays(arrays, schema=SCHEMAS[table])


def columns_of(batch: Any, table: str) -> Columns:
    out: Columns = {}
    for name, kind in TABLES[table].items():
        column = batch.column(name)
        if kind == LIST:
            offsets = column.offsets.to_numpy().astype(np.int64)
            out[name] = (column.flatten().to_numpy(), offsets - offsets[0])
        else:
            out[name] = column.to_numpy(zero_copy_only=False)
    return out


def _messages(data: bytes) -> Iterator[tuple[Any, int]]:
    """Complete IPC messages and where each ends; a torn tail ends the walk."""
    source = pa.BufferReader(data)
    while source.tell() + 8 <= len(data):
        try:
            message = pa.ipc.read_message(source)
        except (pa.ArrowInvalid, OSError, EOFError):
            return
        if source.tell() > len(data):
            return
        yield message, source.tell()


def head_of(data: bytes) -> tuple[Any, int]:
    """Schema of a segment and where its first batch begins; (None, 0) when the head is torn."""
    for message, end in _messages(data):
        if message.type == "schema":
            return pa.ipc.read_schema(message), end
        break
    return None, 0


def parse(data: bytes, schema: Any, path: Path) -> tuple[list[Any], int]:
    """Complete record batches in data, and how many bytes they took."""
    batches, used = [], 0
    for message, end in _messages(data):
        if message.type == "record batch":
            try:
                batches.append(pa.ipc.read_record_batch(message, schema))
            except (pa.ArrowInvalid, OSError) as error:
                raise RunError(f"{path} is damaged: {error}") from error
        used = end
    return batches, used


@dataclass(frozen=True, slots=True)
class Scan:
    first_row: int
    rows: tuple[int, ...]
    end: int  # length of the readable part; 0 when even the head is torn


def scan(path: Path) -> Scan:
    data = path.read_bytes()
    schema, start = head_of(data)
    if schema is None:
        return Scan(0, (), 0)
    table = path.name.split(".")[0]
    batches, used = parse(data[start:], SCHEMAS[table], path)
    return Scan(int(schema.metadata[b"first_row"]), tuple(b.num_rows for b in batches), start + used)


def batches_of(path: Path) -> Iterator[Any]:
    data = path.read_bytes()
    schema, start = head_of(data)
    if schema is not None:
        yield from parse(data[start:], SCHEMAS[path.name.split(".")[0]], path)[0]


def first_rows(batches: Iterator[Any], n: int) -> Iterator[Any]:
    for batch in batches:
        if n <= 0:
            return
        yield batch.slice(0, n)
        n -= batch.num_rows


def gathered(batches: Iterator[Any], schema: Any, rows: int) -> Iterator[Any]:
    """Tables of about `rows` rows: one row group each."""
    held: list[Any] = []
    n = 0
    for batch in batches:
        held.append(batch)
        n += batch.num_rows
        if n >= rows:
            yield pa.Table.from_batches(held, schema).combine_chunks()
            held, n = [], 0
    if held:
        yield pa.Table.from_batches(held, schema).combine_chunks()


def segments_of(log: Path, table: str | None = None) -> list[tuple[int, Path]]:
    """Segments by number, of one table or of all."""
    found = []
    with contextlib.suppress(FileNotFoundError):
        for entry in os.scandir(log):
            match = _SEGMENT.match(entry.name)
            if match and table in (None, match[1]):
                found.append((int(match[2]), Path(entry.path)))
    return sorted(found)


def segment_from_parquet(path: Path, table: str) -> None:
    """Turn a closed table into a segment again; segments left by a killed compaction are copies and go first."""
    for _, old in segments_of(path.parent, table):
        old.unlink()
    with pq.ParquetFile(path) as file:
        first = int((file.schema_arrow.metadata or {}).get(b"first_row", b"0"))
        if file.metadata.num_rows or first:
            parts = [schema_bytes(table, first)]
            for batch in file.iter_batches(1 << 16):
                parts.append(message_of(pa.RecordBatch.from_arrays(batch.columns, schema=SCHEMAS[table])))
            replace_file(path.parent / f"{table}.000.arrows", b"".join(parts))
    path.unlink()


def append(fd: int, data: bytes, good: int) -> None:
    """Append all of data, or cut the file back to its good length and raise."""
    view = memoryview(data)
    try:
        while view:
            view = view[os.write(fd, view) :]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(fd, good)
            os.lseek(fd, good, os.SEEK_SET)
        raise


def compact_log(log: Path) -> None:
    """Turn the segments of every table into one Parquet file each, and remove them. Safe to repeat after a kill."""
    for table, schema in SCHEMAS.items():
        final = log / f"{table}.parquet"
        segments = segments_of(log, table)
        if not final.exists():
            first = scan(segments[0][1]).first_row if segments else 0
            part = final.with_suffix(".parquet.part")
            meta = schema.with_metadata({"first_row": str(first), "log_version": str(VERSION)})
            try:
                with pq.ParquetWriter(
                    part, meta, compression=CODEC or "snappy", use_dictionary=_DICTIONARIES[table],
                    column_encoding=_DIFFERENCES[table],
                ) as out:  # fmt: skip
                    for chunk in gathered((b for _, path in segments for b in batches_of(path)), schema, 1 << 20):
                        out.write_table(chunk)
                with part.open("rb") as file:
                    os.fsync(file.fileno())
                part.replace(final)
            except OSError:
                part.unlink(missing_ok=True)
                raise
        for _, path in segments:
            path.unlink()
    (log / NEWEST).unlink(missing_ok=True)


def copy_log(source: Path | str, target: Path | str) -> None:
    """Copy a run's log files into another run folder, as they are now (a fork continues from a copy)."""
    source, target = Path(source) / LOG, Path(target) / LOG
    with disk_errors(target):
        target.mkdir(parents=True, exist_ok=True)
        for path in sorted(source.iterdir()):
            if path.suffix in (".arrows", ".parquet", ".open"):
                shutil.copyfile(path, target / path.name)
