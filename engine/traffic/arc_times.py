"""What driving along an arc takes: observed on every visit, for routers that learn and for statistics.

An arc is a place with `arc_ticks` of its own: a lane of a network, a cell of a grid. A visit begins when a vehicle sets
out for it and ends when it sets out for the next arc, or stays somewhere to load. Its time is the arc's own ticks plus
all waiting meanwhile, also on the node at its end; turning on the spot, loading and resting are no part of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.types import NONE, PRIMITIVE_0, Activity

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

P0 = int(PRIMITIVE_0)
WAIT, PICK, DROP = int(Activity.WAIT), int(Activity.PICK), int(Activity.DROP)
REST, CHARGE = int(Activity.REST), int(Activity.CHARGE)


class ArcTimes(NamedTuple):
    """Sums over finished visits by place (P,), and the visits under way by vehicle (V,).

    own: ticks of the arc itself, 0 where a place is none · samples, total, squares: number, ticks and squared ticks of
    visits · busy: ticks during which it was held.
    """

    own: I32
    samples: I64
    total: I64
    squares: I64
    busy: I64
    visit: I32
    waited: I64
    since: I64


def new_arc_times(own: I32, vehicles: int) -> ArcTimes:
    """Nothing observed yet."""
    p = len(own)

    def sums() -> I64:
        return np.zeros(p, np.int64)

    visit, zeros = np.full(vehicles, NONE, np.int32), np.zeros(vehicles, np.int64)
    return ArcTimes(np.asarray(own, np.int32), sums(), sums(), sums(), sums(), visit, zeros, zeros.copy())


@lean
def observe(a: ArcTimes, rows: I64, n: int, visit_of: I32, ticks_of: I32, ended: I32) -> int:
    """Take n motion rows (columns of the log's motions) in their order, at any batch size.

    Finished visits also go to visit_of (place), ticks_of and ended (tick), as many as these have room for; returns
    their number.
    """
    found = 0
    for i in range(n):
        v, kind, t0, t1, here, there = rows[i, 0], rows[i, 1], rows[i, 4], rows[i, 5], rows[i, 6], rows[i, 7]
        ends = kind in (PICK, DROP)
        if kind >= P0 and here != there:
            a.busy[here] += t1 - a.since[v]
            a.since[v] = t0
            ends = a.own[there] > 0
        elif kind == WAIT:
            a.waited[v] += t1 - t0
        elif kind in (REST, CHARGE):
            a.visit[v] = NONE
        if ends:
            p = a.visit[v]
            if p >= 0:
                ticks = a.own[p] + a.waited[v]
                a.samples[p] += 1
                a.total[p] += ticks
                a.squares[p] += ticks * ticks
                if found < len(visit_of):
                    visit_of[found], ticks_of[found], ended[found] = p, ticks, t0
                found += 1
            a.visit[v] = there if kind >= P0 else NONE
            a.waited[v] = 0
    return found
