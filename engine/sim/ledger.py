"""Rows on their way to the log: drains the kernel's buffers, folds every row into the digest, hands them on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from json.encoder import encode_basestring_ascii
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from engine.results.schema import LIST, NOT_IN_DIGEST, OUTSIDE_DIGEST, TABLES, TEXT
from engine.sim.kernels import digest
from engine.sim.state import Sink

_NUMPY = {"int8": np.int8, "int16": np.int16, "int32": np.int32, "int64": np.int64, "uint8": np.uint8}
_DRAINED = ("motions", "battery", "states")
_AT_ONCE = 4096
"""Single rows that are folded into the digest together: many in a loop cost half of what they cost one by one."""


class Recorder(Protocol):
    """Anything that takes rows: the RunLog, a Rerun recording, memory."""

    def write(self, table: str, columns: Mapping[str, Any]) -> None:
        """Rows of a table as equally long columns."""
        ...


class Ledger:
    """The digest, and the rows since the last flush. Rows of a table keep their order, however often it is flushed."""

    def __init__(self, recorder: Recorder | None):
        self.recorder = recorder
        self.rows: dict[str, int] = dict.fromkeys(TABLES, 0)
        self._lanes = {name: np.array([1, 2], np.uint64) for name in _DRAINED}
        self._chain = b""
        self._new: list[tuple[str, Sequence[Any]]] = []
        self._pending: dict[str, list[Sequence[Any]]] = {}

    def drain(self, sink: Sink) -> None:
        """Take the kernel's rows."""
        for i, (name, rows) in enumerate(zip(_DRAINED, (sink.motions, sink.battery, sink.states), strict=True)):
            n = int(sink.filled[i])
            if n:
                digest(self._lanes[name], rows, n)
                self.send(name, rows[:n])
                self.rows[name] += n
                sink.filled[i] = 0

    def send(self, name: str, rows: NDArray[np.int64]) -> None:
        """Rows (n, columns) of integers straight to the recorder."""
        if self.recorder is None:
            return
        columns = TABLES[name].items()
        self.recorder.write(name, {c: rows[:, i].astype(_NUMPY[kind]) for i, (c, kind) in enumerate(columns)})

    def row(self, table: str, *values: Any) -> None:
        """One row of a table, values in the order of its columns."""
        self.rows[table] += 1
        self._new.append((table, values))
        if len(self._new) >= _AT_ONCE:
            self._fold()

    def _fold(self) -> None:
        """Fold the new rows into the digest, in order, and put them with the others of their tables."""
        chain, blake2b = self._chain, hashlib.blake2b
        for table, values in self._new:
            if table in _PATTERNS:
                pattern, odd = _PATTERNS[table]
                text = pattern % (values if odd is None else tuple([write(values[i]) for i, write in odd]))
                chain = blake2b(chain + text.encode(), digest_size=16).digest()
            if self.recorder is not None:
                self._pending.setdefault(table, []).append(values)
        self._chain = chain
        self._new.clear()

    def flush(self) -> None:
        """Hand the single rows to the recorder."""
        self._fold()
        if self.recorder is None:
            return
        for table, rows in self._pending.items():
            columns: dict[str, Any] = {}
            for (name, kind), values in zip(TABLES[table].items(), zip(*rows, strict=True), strict=True):
                columns[name] = np.array(values, _NUMPY[kind]) if kind in _NUMPY else list(values)
            self.recorder.write(table, columns)
        self._pending.clear()

    def digest(self) -> str:
        """Hex digest of all rows so far."""
        self._fold()
        parts = b"".join(self._lanes[name].tobytes() for name in _DRAINED)
        return hashlib.blake2b(parts + self._chain, digest_size=16).hexdigest()

    def to_plain(self) -> dict[str, Any]:
        """Plain values for a checkpoint; call after `flush`."""
        return {
            "rows": self.rows,
            "chain": self._chain.hex(),
            "lanes": {name: [int(x) for x in lane] for name, lane in self._lanes.items()},
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Undo `to_plain`; rows since the beginning are forgotten."""
        self._new.clear()
        self.rows = {**dict.fromkeys(TABLES, 0), **plain["rows"]}
        self._chain = bytes.fromhex(plain["chain"])
        self._lanes = {name: np.array(lane, np.uint64) for name, lane in plain["lanes"].items()}


def _list(value: Any) -> str:
    """A list or an array of integers as compact JSON."""
    return repr(value.tolist() if isinstance(value, np.ndarray) else value).replace(" ", "")


def _pattern(table: str) -> tuple[str, list[tuple[int, Callable[[Any], Any]]] | None]:
    """How a row becomes compact JSON: a pattern, and what to fill in; None where all of a row is, as it is."""
    write = {TEXT: encode_basestring_ascii, LIST: _list}
    skip = OUTSIDE_DIGEST.get(table, frozenset())
    kept = [(i, kind) for i, (name, kind) in enumerate(TABLES[table].items()) if name not in skip]
    pattern = ",".join("%s" if kind in write else "%d" for _, kind in kept)
    plain = len(kept) == len(TABLES[table]) and not any(kind in write for _, kind in kept)
    return f'["{table}",{pattern}]', None if plain else [(i, write.get(kind, int)) for i, kind in kept]


_PATTERNS = {table: _pattern(table) for table in TABLES if table not in NOT_IN_DIGEST}
