"""A* over poses (place and heading) with a cost per edge, for routers: where to drive, blind to when.

Source: Hart, Nilsson & Raphael 1968. Poses join the standing and the rolling state of a place and heading; an edge
costs the same from both. `h` is any array over poses: with a consistent one the route is optimal, with another the
first one found, as in the paper's lists. Ties go to whoever came first. Cost: a heap operation per edge seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.tables import FAR
from engine.traffic import Claims, Ground
from engine.types import FOREVER

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

ORDER_BITS = 22
"""Low bits of a heap key: the order of arrival."""


class Work(NamedTuple):
    """Reusable space for poses and heap; `stamp` marks the present search."""

    g: I64
    by: I32
    came: I32
    seen: I32
    done: I32
    stamp: I64
    keys: I64
    items: I32


def new_work(n_states: int, n_edges: int) -> Work:
    """Space for one graph."""
    poses = n_states // 2

    def i32(n: int) -> I32:
        return np.zeros(n, np.int32)

    return Work(
        np.empty(poses, np.int64), np.empty(poses, np.int32), np.empty(poses, np.int32), i32(poses), i32(poses),
        np.zeros(1, np.int64), np.empty(n_edges + 8, np.int64), np.empty(n_edges + 8, np.int32),
    )  # fmt: skip


@lean
def close_taken(c: Claims, n_places: int, owner: int, blocked: U8, closed: U8) -> None:
    """Mark the places that are blocked, or in which somebody else comes to stay with no end known."""
    for p in range(n_places):
        slot = p
        while c.next[slot] >= 0:
            slot = c.next[slot]
        closed[p] = blocked[p] or (slot != p and c.owner[slot] != owner and c.end[slot] >= FOREVER)


@lean
def astar(g: Ground, w: Work, cost: I64, h: I64, closed: U8, start: int, goal: int, out: I32) -> int:
    """Edges from a state to a goal place into `out`; their number, or -1 when there is no way.

    cost: (E,) · h: (poses,), FAR where the goal can't be reached · closed: (P,) places not to be entered.
    """
    w.stamp[0] += 1
    stamp = w.stamp[0]
    first = start >> 1
    if h[first] >= FAR:
        return -1
    w.g[first], w.by[first], w.seen[first] = 0, -1, stamp
    size = push(w.keys, w.items, 0, h[first] << ORDER_BITS, first)
    arrivals = 1
    while size > 0:
        at = w.items[0]
        size = drop_first(w.keys, w.items, size)
        if w.done[at] == stamp:
            continue
        w.done[at] = stamp
        if g.state_place[2 * at] == goal:
            n = 0
            back = at
            while w.by[back] >= 0:
                n += 1
                back = w.came[back]
            if n > len(out):
                return -1
            for i in range(n - 1, -1, -1):
                out[i] = w.by[at]
                at = w.came[at]
            return n
        rolling = 2 * at + 1
        for e in range(g.edge_ptr[rolling], g.edge_ptr[rolling + 1]):
            to = g.edge_to[e] >> 1
            place = g.state_place[2 * to]
            if h[to] >= FAR or w.done[to] == stamp or (closed[place] and place != g.state_place[2 * at]):
                continue
            shut = False
            for q in range(g.sweep_ptr[e], g.sweep_ptr[e + 1]):
                shut |= closed[g.sweep[q]] == 1
            through = w.g[at] + cost[e]
            if shut or (w.seen[to] == stamp and through >= w.g[to]):
                continue
            w.g[to], w.by[to], w.came[to], w.seen[to] = through, e, at, stamp
            size = push(w.keys, w.items, size, ((through + h[to]) << ORDER_BITS) + arrivals, to)
            arrivals += 1
    return -1


@lean
def route(
    c: Claims, g: Ground, w: Work, cost: I64, pool: I64, slots: I32, closed: U8, owner: int, start: int, goals: I32,
    stays: I32, out: I32, upto: I32,
) -> bool:  # fmt: skip
    """Edges through all goals into `out`, those of leg i before upto[i]; False when a leg has no way.

    h of leg i is row slots[i] of pool.
    """
    close_taken(c, len(closed), owner, g.blocked, closed)
    at, n = start, 0
    for i in range(len(goals)):
        k = astar(g, w, cost, pool[slots[i]], closed, at, goals[i], out[n:])
        if k < 0:
            return False
        n += k
        upto[i] = n
        if k > 0:
            at = g.edge_to[out[n - 1]]
        if stays[i] > 0:
            at &= ~1
    return True
