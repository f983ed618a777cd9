"""Counts that grow with the run: the fleet's occupancy, orders done and open, throughput. numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.types import OrderState, VehicleState

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

GROUPS: dict[str, tuple[VehicleState, ...]] = {
    "moving": (VehicleState.MOVING, VehicleState.TO_CHARGER),
    "waiting": (VehicleState.WAITING, VehicleState.PAUSED),
    "loading": (VehicleState.LOADING,),
    "charging": (VehicleState.CHARGING,),
    "idle": (VehicleState.IDLE,),
    "fault": (VehicleState.FAULT,),
}
"""Occupancy of the fleet: name → states counted."""

DONE, OPEN, RATE = "done", "open", "per_hour"
"""Series of OrderCounts."""


class Shares:
    """Mean share of the fleet in each group of states, per bin of ticks."""

    def __init__(self, bin_ticks: int) -> None:
        self._bin = bin_ticks
        group = np.zeros(max(VehicleState) + 1, np.int64)
        for i, states in enumerate(GROUPS.values()):
            group[list(states)] = i
        self._group = group
        self._count = np.zeros(len(GROUPS), np.int64)
        self._of = -1

    def add(self, ticks: I64, states: NDArray[np.uint8], *, last: bool) -> tuple[I64, F64]:
        """(ticks at which bins end, (m, groups) shares 0…1) of the bins that these samples complete."""
        m = len(GROUPS)
        number = ticks // self._bin
        first = int(number[0]) if self._of < 0 else self._of
        bins = int(number[-1]) - first + 1
        key = (number - first)[:, None] * m + self._group[states]
        counts = np.bincount(key.reshape(-1), minlength=bins * m).reshape(bins, m)
        counts[0] += self._count
        whole = bins if last else bins - 1
        self._of, self._count = first + bins - 1, counts[-1]
        total = counts[:whole].sum(1)
        some = total > 0
        ends = (first + np.flatnonzero(some) + 1) * self._bin
        return np.minimum(ends, int(ticks[-1]) if last else ends), counts[:whole][some] / total[some, None]


class OrderCounts:
    """Orders done and open as they change, and throughput per hour at the end of every bin."""

    def __init__(self, rate_ticks: int, tick_s: float) -> None:
        self._rate_ticks, self._tick_s = rate_ticks, tick_s
        self._ticks: list[I64] = []
        self._states: list[I64] = []
        self._done_at = np.zeros(0, np.int64)
        self._done = self._open = 0
        self._bin = 0

    def add(self, tick: I64, state: I64) -> None:
        self._ticks.append(tick)
        self._states.append(state)

    def take(self, until: int, bin_ticks: int) -> list[tuple[str, I64, F64]]:
        """(series, ticks, values) of what changed before `until`."""
        out: list[tuple[str, I64, F64]] = []
        if self._ticks:
            tick, state = np.concatenate(self._ticks), np.concatenate(self._states)
            self._ticks, self._states = [], []
            order = np.argsort(tick, kind="stable")
            tick, state = tick[order], state[order]
            done = state == OrderState.DONE
            came = (state == OrderState.OPEN).astype(np.int64)
            gone = done | (state == OrderState.WITHDRAWN)
            final = np.append(tick[1:] != tick[:-1], True)
            total_done = self._done + np.cumsum(done)
            total_open = self._open + np.cumsum(came - gone)
            self._done, self._open = int(total_done[-1]), int(total_open[-1])
            out.append((DONE, tick[final], total_done[final].astype(np.float64)))
            out.append((OPEN, tick[final], total_open[final].astype(np.float64)))
            self._done_at = np.concatenate([self._done_at, tick[done]])
        ends = np.arange(self._bin + 1, (until - 1) // bin_ticks + 1) * bin_ticks
        if len(ends):
            self._bin = int(ends[-1]) // bin_ticks
            since = np.maximum(ends - self._rate_ticks, 0)
            count = np.searchsorted(self._done_at, ends, "right") - np.searchsorted(self._done_at, since, "right")
            out.append((RATE, ends, count * 3600.0 / ((ends - since) * self._tick_s)))
            self._done_at = self._done_at[self._done_at > int(ends[-1]) - self._rate_ticks]
        return out
