"""A run as the judge sees it: every interval, by vehicle and time, with the ones still open when the log ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from engine.types import FOREVER, PRIMITIVE_0, Activity
from engine.world.motion_graph import MotionGraph

I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


class RunLog(Protocol):
    """What the judge needs of a recorded run."""

    @property
    def first_tick(self) -> int:
        """First tick that the log covers."""

    def table(self, name: str) -> Mapping[str, Any]:
        """Columns of a table."""


@dataclass(frozen=True, slots=True)
class Record:
    """Intervals sorted by vehicle, then t0; arrays of equal length n, integers.

    moves: it is a motion primitive of the graph (index `primitive`) · cut: a breakdown ended it early · still: it was
    open when the log ended · follows: the row before belongs to the same vehicle · legal: kind, places and headings
    exist, so that the latter may be used as indices.
    """

    vehicle: I64
    kind: I64
    t0: I64
    t1: I64
    a: I64
    b: I64
    heading_a: I64
    heading_b: I64
    loaded: I64
    order: I64
    energy_mj: I64
    still: Mask
    follows: Mask
    legal: Mask
    moves: Mask
    cut: Mask
    primitive: I64
    key: I64  # vehicle << 32 | t0
    first_tick: int
    end: int
    fleet: int

    @property
    def n(self) -> int:
        return len(self.vehicle)

    def before(self, vehicle: I64, tick: I64) -> I64:
        """Index of the last interval of each vehicle with t0 ≤ tick, or -1."""
        at = np.searchsorted(self.key, (vehicle << 32) + np.maximum(tick, -1), side="right") - 1
        if self.n == 0:
            return np.full(len(vehicle), -1, np.int64)
        return np.where((at >= 0) & (self.vehicle[np.maximum(at, 0)] == vehicle), at, -1)

    def first(self, vehicle: I64) -> I64:
        """Index of the first interval of each vehicle (the number of rows when it has none)."""
        return np.searchsorted(self.key, vehicle << 32, side="left").astype(np.int64)


def record_of(log: RunLog, graph: MotionGraph) -> Record:
    """Read a run's intervals, ended and open."""
    motions, frames = log.table("motions"), log.table("keyframes")
    names = ("vehicle", "kind", "t0", "t1", "from_place", "to_place", "from_heading", "to_heading", "loaded", "order")
    col = {name: np.asarray(motions[name]) for name in (*names, "energy_mj")}
    end = int(col["t1"].max()) if len(col["t1"]) else 0
    ticks = np.asarray(frames["tick"], np.int64)
    latest = np.zeros(0, np.int64)
    if len(ticks):
        # one row per vehicle, the last written at that tick
        rows = np.nonzero(ticks == ticks[-1])[0][::-1]
        latest = rows[np.unique(np.asarray(frames["vehicle"])[rows], return_index=True)[1]]
        end = max(end, int(ticks[-1]))
    is_open = {name: np.asarray(frames[name])[latest] for name in col}
    ended = np.zeros(int(max(is_open["vehicle"].max(initial=-1), col["vehicle"].max(initial=-1))) + 1, np.int64)
    np.maximum.at(ended, col["vehicle"], col["t1"])
    # a keyframe older than the last motions, or of an interval that has only just begun, says nothing more
    fresh = (is_open["t0"] >= ended[is_open["vehicle"]]) & (is_open["t0"] < end)
    is_open = {name: values[fresh] for name, values in is_open.items()}
    is_open["t1"] = np.full(len(is_open["t0"]), end, np.int32)
    still = np.concatenate([np.zeros(len(col["t0"]), np.bool_), np.ones(len(is_open["t0"]), np.bool_)])
    col = {name: np.concatenate([col[name], is_open[name]]) for name in col}

    key = (col["vehicle"].astype(np.int64) << 32) + np.maximum(col["t0"], -1)
    order = np.argsort(key, kind="stable")
    col = {name: values[order].astype(np.int64) for name, values in col.items()}
    vehicle, kind, t0, t1 = col["vehicle"], col["kind"], col["t0"], col["t1"]
    follows = np.zeros(len(vehicle), np.bool_)
    follows[1:] = vehicle[1:] == vehicle[:-1]
    n_kinds, n_headings = len(graph.primitives), len(graph.heading_deg)
    moves = (kind >= PRIMITIVE_0) & (kind - PRIMITIVE_0 < n_kinds)
    legal = moves | ((kind >= 0) & (kind <= max(Activity)))
    for name, limit in (
        ("from_place", graph.n_places),
        ("to_place", graph.n_places),
        ("from_heading", n_headings),
        ("to_heading", n_headings),
    ):
        legal &= (col[name] >= 0) & (col[name] < limit)
    primitive = np.where(moves, kind - PRIMITIVE_0, 0)
    fails_next = np.zeros(len(vehicle), np.bool_)
    fails_next[:-1] = follows[1:] & (kind[1:] == Activity.FAULT) & (t0[1:] == t1[:-1])
    short = t1 - t0 < np.asarray(graph.kind_ticks, np.int64)[primitive]
    still = still[order]
    return Record(
        vehicle=vehicle,
        kind=kind,
        t0=t0,
        t1=t1,
        a=col["from_place"],
        b=col["to_place"],
        heading_a=col["from_heading"],
        heading_b=col["to_heading"],
        loaded=col["loaded"],
        order=col["order"],
        energy_mj=col["energy_mj"],
        still=still,
        follows=follows,
        legal=legal,
        moves=moves,
        cut=moves & short & fails_next & ~still,
        primitive=primitive,
        key=key[order],
        first_tick=int(log.first_tick),
        end=end,
        fleet=len(ended),
    )


def last_before(key_table: I64, value: NDArray[Any], group: I64, tick: I64, otherwise: int) -> I64:
    """Value of the last row (group << 32 | tick, ascending) at or before each tick, else `otherwise`."""
    if len(key_table) == 0:
        return np.full(len(group), otherwise, np.int64)
    at = np.searchsorted(key_table, (group << 32) + tick, side="right") - 1
    own = (at >= 0) & (key_table[np.maximum(at, 0)] >> 32 == group)
    return np.where(own, np.asarray(value, np.int64)[np.maximum(at, 0)], otherwise)


def spans(switches: Iterable[tuple[int, int, bool]]) -> dict[int, list[tuple[int, int]]]:
    """Intervals [on, off) per subject from switches (subject, tick, on) in order; the last may stay open."""
    begun: dict[int, int] = {}
    out: dict[int, list[tuple[int, int]]] = {}
    for subject, tick, on in switches:
        if on:
            begun.setdefault(subject, tick)
        elif subject in begun:
            out.setdefault(subject, []).append((begun.pop(subject), tick))
    for subject, tick in begun.items():
        out.setdefault(subject, []).append((tick, FOREVER))
    return out
