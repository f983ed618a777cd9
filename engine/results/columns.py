"""Columns of the log's tables in memory: checked on the way in, growing, handed out as views."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from engine.errors import InvariantBroken, RunError, unknown_name
from engine.results.schema import LIST, TABLES, TEXT

Columns = dict[str, Any]
"""Columns of a table: a numpy array each; text as an object array; a list column as (values, offsets)."""


def checked(table: str, columns: Mapping[str, Any]) -> tuple[Columns, int]:
    """Copies of the columns with the schema's types, and the number of rows. Raises InvariantBroken on a mismatch."""
    if table not in TABLES:
        raise InvariantBroken(unknown_name("table", table, TABLES))
    kinds = TABLES[table]
    if columns.keys() != kinds.keys():
        odd = sorted(columns.keys() ^ kinds.keys())
        raise InvariantBroken(f"table {table}: columns {odd} are missing or unknown")
    out: Columns = {}
    sizes: set[int] = set()
    for name, kind in kinds.items():
        part = columns[name]
        if kind == LIST:
            values, offsets = _list_column(part)
            out[name] = (values, offsets)
            sizes.add(len(offsets) - 1)
        elif kind == TEXT:
            texts = np.empty(len(part), object)
            texts[:] = [str(text) for text in part]
            out[name] = texts
            sizes.add(len(texts))
        else:
            out[name] = np.array(part, dtype_of(kind), ndmin=1)
            sizes.add(len(out[name]))
    if len(sizes) != 1:
        raise InvariantBroken(f"table {table}: columns of different lengths {sorted(sizes)}")
    return out, sizes.pop()


def _list_column(part: Any) -> tuple[Any, Any]:
    if isinstance(part, tuple) and len(part) == 2:
        return np.array(part[0], np.int32), np.array(part[1], np.int64)
    lengths = np.array([len(p) for p in part], np.int64)
    offsets = np.zeros(len(part) + 1, np.int64)
    np.cumsum(lengths, out=offsets[1:])
    values = np.concatenate([np.asarray(p, np.int32) for p in part]) if len(part) else np.zeros(0, np.int32)
    return values.astype(np.int32), offsets


class Store:
    """Growing columns; views of the filled part are handed out."""

    def __init__(self, table: str) -> None:
        self.n = 0
        self._kinds = TABLES[table]
        self._values: dict[str, np.ndarray[Any, Any]] = {}
        self._offsets: dict[str, np.ndarray[Any, Any]] = {}
        self.clear()

    def clear(self) -> None:
        self.n = 0
        for name, kind in self._kinds.items():
            self._values[name] = np.empty(0, dtype_of(kind))
            if kind == LIST:
                self._offsets[name] = np.zeros(1, np.int64)

    def append(self, batch: Columns) -> None:
        n = self.n
        more = 0
        for name, kind in self._kinds.items():
            part = batch[name]
            if kind == LIST:
                values, offsets = part
                more = len(offsets) - 1
                filled = int(self._offsets[name][n])
                self._values[name] = grown(self._values[name], filled, values)
                self._offsets[name] = grown(self._offsets[name], n + 1, offsets[1:] - offsets[0] + filled)
            else:
                more = len(part)
                self._values[name] = grown(self._values[name], n, part)
        self.n = n + more

    def cut(self, n: int) -> None:
        if n > self.n:
            raise RunError(f"the log has {self.n} rows; {n} were expected")
        columns = self.columns()
        self.clear()
        self.append(
            {
                name: (c[0][: c[1][n]], c[1][: n + 1].copy()) if isinstance(c, tuple) else c[:n]
                for name, c in columns.items()
            }
        )

    def columns(self) -> Columns:
        out: Columns = {}
        for name, kind in self._kinds.items():
            if kind == LIST:
                offsets = self._offsets[name][: self.n + 1]
                out[name] = (self._values[name][: offsets[-1]], offsets)
            else:
                out[name] = self._values[name][: self.n]
        return out


def dtype_of(kind: str) -> Any:
    return object if kind == TEXT else np.int32 if kind == LIST else np.dtype(kind)


def grown(array: Any, filled: int, part: Any) -> Any:
    if not len(part):
        return array  # it may be an adopted one, which can't be written to
    need = filled + len(part)
    if need > len(array):
        if filled == 0:
            return part  # adopted as it is: the usual case for a closed run
        bigger = np.empty(max(need, 2 * len(array), 1024), array.dtype)
        bigger[:filled] = array[:filled]
        array = bigger
    array[filled:need] = part
    return array
