"""Rows of the log at regular ticks: positions inside motions, states between changes, places held. numpy only.

A sample is taken at every tick that is a whole multiple of a step. Rows come in any batches; each sampler keeps what
later windows need. Arrays per sample are (k, n): k ticks in order, n vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.types import FOREVER, PRIMITIVE_0

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Columns = Mapping[str, Any]

_MOVES = ("vehicle", "t0", "t1", "from_place", "to_place", "from_heading", "to_heading", "loaded")


@dataclass(frozen=True, slots=True)
class Window:
    """Sample ticks `first, first + step, …` below `stop`; first is a multiple of step."""

    first: int
    stop: int
    step: int

    @property
    def ticks(self) -> I64:
        return np.arange(self.first, self.stop, self.step, dtype=np.int64)

    def __len__(self) -> int:
        return max(0, -(-(self.stop - self.first) // self.step))

    def index(self, tick: I64) -> I64:
        """Number of the first sample at or after each tick, within 0…len."""
        return np.clip(-(-(tick - self.first) // self.step), 0, len(self))


@dataclass(frozen=True, slots=True)
class Poses:
    """Samples of the fleet: ticks (k,), xy_m (k, n, 2), heading_deg (k, n), loaded (k, n); NaN where unknown."""

    ticks: I64
    xy_m: F32
    heading_deg: F32
    loaded: NDArray[np.bool_]


def spread(t0: I64, t1: I64, window: Window) -> tuple[I64, I64]:
    """Every sample of the window that lies in [t0, t1) of some row: (row, sample) pairs, row by row."""
    begin, end = window.index(t0), window.index(t1)
    counts = np.maximum(end - begin, 0)
    row = np.repeat(np.arange(len(counts)), counts)
    ahead = np.cumsum(counts) - counts
    sample = np.arange(len(row)) - np.repeat(ahead - begin, counts)
    return row, sample


class MotionSampler:
    """Poses from motion rows, which come when they have ended, and from keyframes, which say what is still open.

    A vehicle that stands in an open interval is known up to the keyframe's tick; one that moves, up to its last row.
    """

    def __init__(self, n: int, xy_m: F32, heading_deg: tuple[float, ...]) -> None:
        self.n = n
        self._xy = np.asarray(xy_m, np.float64)
        self._heading = np.asarray(heading_deg, np.float64)
        self._rows: list[dict[str, I64]] = []
        self._ended = np.full(n, -1, np.int64)  # t1 of the last ended row
        self._began = np.full(n, FOREVER, np.int64)  # t0 of the first row
        self._last = {name: np.full(n, -1, np.int64) for name in _MOVES}
        self._open = {name: np.full(n, -1, np.int64) for name in (*_MOVES, "kind", "tick")}
        self.t_end = -1

    def add(self, columns: Columns) -> None:
        """Take rows of `motions`."""
        rows = {name: np.array(columns[name], np.int64) for name in _MOVES}
        vehicle = rows["vehicle"]
        if not len(vehicle):
            return
        self._rows.append(rows)
        # Rows of a vehicle stand in order, and the last assignment to an index wins.
        np.minimum.at(self._began, vehicle, rows["t0"])
        self._ended[vehicle] = rows["t1"]
        for name, values in rows.items():
            self._last[name][vehicle] = values
        self.t_end = max(self.t_end, int(rows["t1"].max()))

    def add_open(self, columns: Columns) -> None:
        """Take rows of `keyframes`."""
        vehicle = np.asarray(columns["vehicle"], np.int64)
        if not len(vehicle):
            return
        for name, values in self._open.items():
            values[vehicle] = np.asarray(columns[name], np.int64)
        np.minimum.at(self._began, vehicle, np.asarray(columns["t0"], np.int64))
        self.t_end = max(self.t_end, int(np.asarray(columns["tick"]).max()))

    @property
    def began(self) -> int:
        """First tick at which every vehicle is known; FOREVER before that."""
        return int(self._began.max(initial=0))

    @property
    def complete(self) -> int:
        """First tick at which the pose of some vehicle isn't known yet."""
        standing = self._open_now() & (self._open["kind"] < PRIMITIVE_0)
        return int(np.where(standing, np.maximum(self._ended, self._open["tick"]), self._ended).min(initial=FOREVER))

    def take(self, window: Window, *, last: bool = False) -> Poses:
        """Poses in a window; rows that end inside it are forgotten.

        `last` carries every vehicle on to the window's end: through its open motion, and then where it stands.
        """
        rows = self._collect()
        extra = self._open_rows(window.stop, last)
        use = {name: np.concatenate([rows[name], extra[name]]) for name in _MOVES}
        row, sample = spread(use["t0"], use["t1"], window)
        k, n = len(window), self.n
        at = sample * n + use["vehicle"][row]

        begin, end = self._xy[use["from_place"]], self._xy[use["to_place"]]
        speed = (end - begin) / (use["t1"] - use["t0"])[:, None]
        turn = (self._heading[use["to_heading"]] - self._heading[use["from_heading"]] + 180.0) % 360.0 - 180.0
        since = (window.first + sample * window.step - use["t0"][row]).astype(np.float64)
        share = since / (use["t1"] - use["t0"])[row]

        xy = np.full((k * n, 2), np.nan, np.float32)
        xy[at] = begin[row] + speed[row] * since[:, None]
        heading = np.full(k * n, np.nan, np.float32)
        heading[at] = (self._heading[use["from_heading"]][row] + turn[row] * share) % 360.0
        loaded = np.zeros(k * n, np.bool_)
        loaded[at] = use["loaded"][row] > 0

        later = rows["t1"] > window.stop
        self._rows = [{name: values[later] for name, values in rows.items()}]
        return Poses(window.ticks, xy.reshape(k, n, 2), heading.reshape(k, n), loaded.reshape(k, n))

    def _collect(self) -> dict[str, I64]:
        """All rows kept, by vehicle, then time."""
        if not self._rows:
            return {name: np.zeros(0, np.int64) for name in _MOVES}
        rows = {name: np.concatenate([part[name] for part in self._rows]) for name in _MOVES}
        rows = {name: values[rows["t1"] > rows["t0"]] for name, values in rows.items()}
        order = np.lexsort((rows["t0"], rows["vehicle"]))
        return {name: values[order] for name, values in rows.items()}

    def _open_now(self) -> NDArray[np.bool_]:
        """Vehicles whose keyframe is newer than their last ended row."""
        return (self._open["tick"] >= 0) & (self._open["t0"] >= self._ended)

    def _open_rows(self, stop: int, last: bool) -> dict[str, I64]:
        """Rows that carry vehicles beyond their last ended one, up to `stop`."""
        is_open = self._open_now()
        standing = is_open & (self._open["kind"] < PRIMITIVE_0)
        parts = [self._standing(self._open, standing, np.where(standing, self._open["t0"], 0), stop)]
        if last:
            moving = is_open & ~standing & (self._open["t1"] > self._open["t0"]) & (self._open["t1"] < FOREVER)
            parts.append({name: self._open[name][moving] for name in _MOVES})
            parts.append(self._standing(self._open, moving, self._open["t1"], stop))
            stuck = is_open & ~standing & ~moving
            parts.append(self._standing({**self._open, "to_place": self._open["from_place"]}, stuck, self._ended, stop))
            parts.append(self._standing(self._last, ~is_open & (self._ended >= 0), self._ended, stop))
        return {name: np.concatenate([part[name] for part in parts]) for name in _MOVES}

    @staticmethod
    def _standing(source: dict[str, I64], who: NDArray[np.bool_], since: I64, stop: int) -> dict[str, I64]:
        rows = {name: source[name][who] for name in _MOVES}
        rows["vehicle"] = np.flatnonzero(who).astype(np.int64)
        rows["t0"] = since[who]
        rows["t1"] = np.full(len(rows["t0"]), stop, np.int64)
        rows["from_place"], rows["from_heading"] = rows["to_place"], rows["to_heading"]
        short = rows["t0"] < stop
        return {name: values[short] for name, values in rows.items()}


class StepSampler:
    """The value of each vehicle at samples, from rows (tick, vehicle, value) that say when it changed."""

    def __init__(self, n: int, start: int) -> None:
        self._now = np.full(n, start, np.int64)
        self._rows: list[I64] = []  # (m, 3)

    def add(self, tick: Any, vehicle: Any, value: Any) -> None:
        self._rows.append(np.stack([np.asarray(c, np.int64) for c in (tick, vehicle, value)], 1))

    def take(self, window: Window) -> NDArray[np.uint8]:
        """(k, n) values in a window. Changes before its end are forgotten but for the last of each vehicle."""
        n = len(self._now)
        known = np.stack([np.full(n, window.first), np.arange(n), self._now], 1)
        rows = np.concatenate([known, *self._rows])
        late = rows[:, 0] >= window.stop
        self._rows = [rows[late]]
        rows = rows[~late]
        rows = rows[np.argsort(rows[:, 1], kind="stable")]
        # Changes come in order per vehicle, behind the value with which the window began.
        same = np.append(rows[1:, 1] == rows[:-1, 1], False) if len(rows) else np.zeros(0, np.bool_)
        until = np.where(same, np.append(rows[1:, 0], 0), window.stop)
        row, sample = spread(rows[:, 0], until, window)
        out = np.zeros(len(window) * n, np.uint8)
        out[sample * n + rows[row, 1]] = rows[row, 2]
        self._now[rows[:, 1]] = rows[:, 2]
        return out.reshape(len(window), n)


class HeldPlaces:
    """Which places are reserved at samples, from committed plans; a new plan ends its vehicle's former one."""

    def __init__(self) -> None:
        self._held = np.zeros((0, 4), np.int64)  # vehicle, place, t_in, t_out
        self._new: list[Columns] = []

    def add(self, columns: Columns) -> None:
        """Take rows of `plans`."""
        if len(columns["tick"]):
            self._new.append({name: columns[name] for name in ("tick", "vehicle", "places", "t_in", "t_out")})

    def take(self, window: Window) -> tuple[I64, I64, I64]:
        """(ticks (m,), places, lengths (m,)): samples at which the reserved places changed, and what they are then."""
        self._merge()
        held = self._held
        row, sample = spread(held[:, 2], held[:, 3], window)
        k = len(window)
        changed = np.zeros(k + 1, np.bool_)
        # A window says what is held when it begins.
        changed[0] = True
        touched = held[:, 2:4].reshape(-1)
        changed[window.index(touched[touched > window.first])] = True
        changed = changed[:k]
        order = np.argsort(sample, kind="stable")
        order = order[changed[sample[order]]]
        lengths = np.bincount(sample[order], minlength=k)[changed]
        self._held = held[held[:, 3] > window.stop - 1]
        return window.ticks[changed], held[row[order], 1], lengths

    def _merge(self) -> None:
        """Turn the new plans into intervals, cutting each where its vehicle's next one begins."""
        if not self._new:
            return
        tick = np.concatenate([np.asarray(part["tick"], np.int64) for part in self._new])
        vehicle = np.concatenate([np.asarray(part["vehicle"], np.int64) for part in self._new])
        places, sizes = flatten([part["places"] for part in self._new])
        t_in, _ = flatten([part["t_in"] for part in self._new])
        t_out, _ = flatten([part["t_out"] for part in self._new])
        self._new = []
        plan = np.repeat(np.arange(len(tick)), sizes)
        starts = np.full(len(tick), FOREVER, np.int64)
        np.minimum.at(starts, plan, t_in)
        starts = np.maximum(starts, tick)

        order = np.lexsort((np.arange(len(tick)), vehicle))
        until = np.full(len(tick), FOREVER, np.int64)
        follows = vehicle[order[1:]] == vehicle[order[:-1]]
        until[order[:-1][follows]] = starts[order[1:][follows]]

        held = self._held
        if len(held):
            firsts = order[np.append(True, ~follows)]
            cut = np.full(int(max(held[:, 0].max(), vehicle.max())) + 1, FOREVER, np.int64)
            cut[vehicle[firsts]] = starts[firsts]
            held = held.copy()
            held[:, 3] = np.minimum(held[:, 3], cut[held[:, 0]])
        fresh = np.stack([vehicle[plan], places, t_in, np.minimum(t_out, until[plan])], 1)
        held = np.concatenate([held, fresh])
        self._held = held[held[:, 3] > held[:, 2]]


def flatten(parts: list[tuple[Any, Any]]) -> tuple[I64, I64]:
    """One list column from its batches, each (values, offsets): all values, and the length of each row."""
    values = [np.asarray(v[o[0] : o[-1]], np.int64) for v, o in parts]
    sizes = [np.diff(np.asarray(o, np.int64)) for _, o in parts]
    nothing = [np.zeros(0, np.int64)]
    return np.concatenate(values or nothing), np.concatenate(sizes or nothing)
