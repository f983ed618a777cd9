"""Where two runs of one floor part: the first tick at which their fleets do not do the same, from their logs alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.results.runlog import Log, latest_keyframe
from engine.types import PRIMITIVE_0

I64 = NDArray[np.int64]

_DOES = ("kind", "from_place", "to_place", "from_heading", "to_heading", "loaded")
FIRST_WINDOW = 4096
"""Ticks compared first; runs under different planners part early, and each further window is eight times as long."""


@dataclass(frozen=True, slots=True)
class Divergence:
    """tick: first at which two fleets do not do the same · vehicles: those whose doing differs then, in order."""

    tick: int
    vehicles: tuple[int, ...]


def covered(log: Log) -> tuple[int, int]:
    """First and last tick of which a log tells of every vehicle: its newest keyframe is the last."""
    frame, ended = latest_keyframe(log)["tick"], log.table("motions")["t1"]
    return int(log.first_tick), int(frame[-1]) if len(frame) else int(ended.max(initial=0))


def trail(log: Log, first: int, end: int) -> I64:
    """What the fleet does in [first, end), which the log covers, as rows that are comparable between runs.

    (m, 10) tick, vehicle, kind, places, headings, loaded, and a motion's own t0 and t1 (0 for a stay), ordered by tick
    and vehicle: a vehicle has a row wherever what it does changes. A stay that the log tells in several intervals is
    one; a motion is another one when it takes another time.
    """
    motions, still = log.table("motions"), latest_keyframe(log)
    reach = (motions["t0"] < end) & (motions["t1"] > np.maximum(motions["t0"], first))
    # an interval that is open in the newest keyframe, unless a row tells how it ended
    vehicle, t0 = np.asarray(still["vehicle"], np.int64), np.asarray(still["t0"], np.int64)
    until = np.full(int(max(motions["vehicle"].max(initial=-1), vehicle.max(initial=-1))) + 1, -1, np.int64)
    until[motions["vehicle"]] = motions["t1"]  # a vehicle's rows stand in order, and the last assignment wins
    is_open = (t0 >= until[vehicle]) & (t0 < end)
    column = {
        name: np.concatenate([motions[name][reach], still[name][is_open]]).astype(np.int64)
        for name in ("vehicle", "t0", "t1", *_DOES)
    }
    order = np.argsort((column["vehicle"] << 32) + column["t0"], kind="stable")
    column = {name: values[order] for name, values in column.items()}
    drives = column["kind"] >= PRIMITIVE_0
    own = [np.where(drives, column[name], 0) for name in ("t0", "t1")]
    does = np.stack([column["vehicle"], *(column[name] for name in _DOES), *own], axis=1)
    changes = np.ones(len(does), np.bool_)
    changes[1:] = (does[1:] != does[:-1]).any(axis=1)
    tick = np.maximum(column["t0"], first)[changes]
    rows = np.concatenate([tick[:, None], does[changes]], axis=1)
    return np.asarray(rows[np.argsort((tick << 24) + rows[:, 1], kind="stable")])


def first_divergence(one: Log, other: Log) -> Divergence | None:
    """Where two runs part, within the ticks that both logs cover; None when nowhere."""
    (first_one, end_one), (first_other, end_other) = covered(one), covered(other)
    begin, end = max(first_one, first_other), min(end_one, end_other)
    window = FIRST_WINDOW
    while begin < end:
        stop = min(begin + window, end)
        found = _parting(trail(one, begin, stop), trail(other, begin, stop))
        if found is not None:
            return found
        begin, window = stop, 8 * window
    return None


def _parting(one: I64, other: I64) -> Divergence | None:
    """The least tick of the rows that only one of two trails has: until then both have the same rows."""
    n = min(len(one), len(other))
    differs = np.flatnonzero((one[:n] != other[:n]).any(axis=1))
    at = int(differs[0]) if len(differs) else n
    if at >= max(len(one), len(other)):
        return None
    tick = min(int(rows[at, 0]) for rows in (one, other) if at < len(rows))
    then = [{tuple(row) for row in rows[at:][rows[at:, 0] == tick].tolist()} for rows in (one, other)]
    return Divergence(tick, tuple(sorted({row[1] for row in then[0] ^ then[1]})))
