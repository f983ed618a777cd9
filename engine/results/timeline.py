"""Rows of a growing table by vehicle and tick: sorted once, extended as rows come, searched for many at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

I64 = NDArray[np.int64]


class Timeline:
    """Index of a table by (vehicle, tick). `row[i]` is the table's row at position i of the sorted order."""

    def __init__(self) -> None:
        self.key: I64 = np.zeros(0, np.int64)
        self.row: I64 = np.zeros(0, np.int64)
        self.n = 0

    def extend(self, vehicle: NDArray[Any], tick: NDArray[Any]) -> bool:
        """Take in the rows from `self.n` on of the whole columns; True when there were any."""
        fresh = len(vehicle) - self.n
        if fresh <= 0:
            return False
        key = keys(vehicle[self.n :], tick[self.n :])
        order = np.argsort(key, kind="stable")
        key, row = key[order], order + self.n
        if self.n == 0:
            self.key, self.row = key, row
        else:
            at = np.searchsorted(self.key, key, side="right")
            self.key, self.row = np.insert(self.key, at, key), np.insert(self.row, at, row)
        self.n += fresh
        return True

    def position(self, vehicle: NDArray[Any], time: NDArray[Any] | float) -> I64:
        """Position of the last row with tick ≤ time of each vehicle, or -1; arguments broadcast."""
        vehicle = np.asarray(vehicle, np.int64)
        at = np.searchsorted(self.key, keys(vehicle, np.floor(time)), side="right") - 1
        own = (at >= 0) & ((self.key[np.maximum(at, 0)] >> 32) == vehicle) if self.n else np.zeros(at.shape, np.bool_)
        return np.where(own, at, -1)

    def first(self, vehicle: NDArray[Any]) -> I64:
        """Position of the first row of each vehicle, or -1."""
        vehicle = np.asarray(vehicle, np.int64)
        at = np.searchsorted(self.key, vehicle << 32, side="left")
        inside = np.minimum(at, max(self.n - 1, 0))
        own = (at < self.n) & ((self.key[inside] >> 32) == vehicle) if self.n else np.zeros(at.shape, np.bool_)
        return np.where(own, at, -1)

    @property
    def vehicle(self) -> I64:
        """Vehicle at each position."""
        return self.key >> 32

    @property
    def tick(self) -> I64:
        """Tick at each position."""
        return self.key & 0xFFFFFFFF


def keys(vehicle: NDArray[Any], tick: Any) -> I64:
    """Sort keys; vehicles and ticks are not negative (a negative tick sorts before every row of its vehicle)."""
    return (np.asarray(vehicle, np.int64) << 32) + np.maximum(np.asarray(tick, np.int64), -1)


def overlap_sums(
    edges: NDArray[np.float64], t0: NDArray[Any], t1: NDArray[Any], group: NDArray[Any], n_groups: int
) -> NDArray[np.float64]:
    """Time that intervals [t0, t1) spend in each bin: (bins, n_groups), edges ascending and equally spaced.

    Uses Σ max(0, min(T, t1) - t0) at every edge T, so its cost does not depend on how long the intervals are.
    """
    bins = len(edges) - 1
    first, last = float(edges[0]), float(edges[-1])
    if last <= first or len(t0) == 0:
        return np.zeros((max(bins, 0), n_groups))
    total = np.zeros((bins + 1, n_groups))
    for sign, when in ((1.0, np.clip(t0, first, last)), (-1.0, np.clip(t1, first, last))):
        at = np.minimum(((when - first) * (bins / (last - first))).astype(np.int64), bins)
        # rounding may put a time one bin early or late
        at -= when < edges[at]
        at += (at < bins) & (when >= edges[np.minimum(at + 1, bins)])
        # counts from the next edge on; what begins at the last edge counts nowhere
        slot = (at + 1) * n_groups + group
        shape, size = (bins + 2, n_groups), (bins + 2) * n_groups
        count = np.bincount(slot, minlength=size).reshape(shape).cumsum(0)[:-1]
        ticks = np.bincount(slot, weights=when, minlength=size).reshape(shape).cumsum(0)[:-1]
        total += sign * (count * edges[:, None] - ticks)
    return np.asarray(np.diff(total, axis=0))
