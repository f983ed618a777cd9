"""What two vehicles cost together: A* over pairs of states, for the bounds of energy CBS.

Source: Hart, Nilsson & Raphael 1968 on the joint space of two vehicles, each one's exact cost to go as its heuristic.
Promise: the optimum of the two alone on the floor, or, when the work is spent, a lower bound of it. Both move in every
tick, so that time is no part of a node: only who waits for whom is, and the many ways to share out waits in a corridor,
which a constraint tree tells apart by a node each, are one layer of equal f.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.cbs_low import FOUND, NONE, SPENT, Roads, bits_of, slot_at
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.tables import FAR

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

SHIFT = 20
"""Bits of a heap key below f: among equal f the pair nearest its goals comes first."""


class PairWork(NamedTuple):
    """Reusable room. slot: (M, 2) node of a pair, stamp · key, g: of each node · to, cost: (2, ·) each one's steps."""

    key: I64
    g: I64
    slot: I32
    keys: I64  # heap
    items: I32
    to: I32
    cost: I64
    stamp: I64  # (1,)


def new_pair_work(nodes: int, steps: int) -> PairWork:
    """Room for so many pairs (a power of two), and for so many steps of one vehicle."""
    i32, i64 = np.int32, np.int64
    return PairWork(
        np.zeros(nodes, i64), np.zeros(nodes, i64), np.zeros((2 * nodes, 2), i32), np.zeros(4 * nodes, i64),
        np.zeros(4 * nodes, i32), np.zeros((2, steps), i32), np.zeros((2, steps), i64), np.zeros(1, i64),
    )  # fmt: skip


@lean
def _steps_of(r: Roads, h: I64, cls: int, goal: int, s: int, to: I32, cost: I64) -> int:
    """Where a vehicle may be after a tick, and at what cost; the number of states stands for rest at its goal."""
    rest = len(r.place)
    if s == rest:
        to[0], cost[0] = rest, 0
        return 1
    n = 0
    for e in range(r.ptr[s] - 1, r.ptr[s + 1]):
        s2, c = (r.still[s], r.wait[cls]) if e < r.ptr[s] else (r.to[e], r.cost[cls, r.kind[e]])
        if h[s2] >= FAR:
            continue
        to[n], cost[n] = s2, c
        n += 1
        if r.place[s2] == goal:
            to[n], cost[n] = rest, c
            n += 1
    return n


@lean
def _reach(q: PairWork, bits: int, count: int, size: int, key: int, g: int, h: int) -> tuple[int, int]:
    """Enter a pair unless it was reached as cheaply; (nodes, size of the heap)."""
    at, mask = slot_at(key, bits), len(q.slot) - 1
    stamp = q.stamp[0]
    while q.slot[at, 1] == stamp and q.key[q.slot[at, 0]] != key:
        at = (at + 1) & mask
    if q.slot[at, 1] != stamp:
        q.slot[at, 0], q.slot[at, 1] = count, stamp
        q.key[count] = key
        q.g[count] = g
        count += 1
    elif q.g[q.slot[at, 0]] <= g:
        return count, size
    node = np.int64(q.slot[at, 0])
    q.g[node] = g
    size = push(q.keys, q.items, size, ((g + h) << SHIFT) | min(h >> 12, (1 << SHIFT) - 1), node)
    return count, size


@lean
def pair_cost(
    r: Roads, q: PairWork, h: I64, cls: I32, start: I32, goal: I32, i: int, j: int, limit: int, out: I64
) -> int:  # fmt: skip
    """Least cost of vehicles i and j, each resting at its goal in the end, without the others.

    h: (n, S) least cost to each one's goal. out: the cost (a lower bound of it when SPENT), expansions. NONE: there is
    no such plan.
    """
    rest, wide = len(r.place), np.int64(len(r.place) + 1)
    to, to_j, cost, cost_j = q.to[0], q.to[1], q.cost[0], q.cost[1]
    hi, hj, gi, gj = h[i], h[j], np.int64(goal[i]), np.int64(goal[j])
    bits = bits_of(len(q.slot))
    q.stamp[0] += 1
    count, size, done = 0, 0, 0
    for first in range(2):
        for second in range(2):
            if (first and r.place[start[i]] != gi) or (second and r.place[start[j]] != gj):
                continue
            a, b = rest if first else np.int64(start[i]), rest if second else np.int64(start[j])
            left = (0 if first else hi[a]) + (0 if second else hj[b])
            count, size = _reach(q, bits, count, size, a * wide + b, np.int64(0), left)
    ended = NONE
    while size > 0:
        f, node = q.keys[0] >> SHIFT, np.int64(q.items[0])
        size = drop_first(q.keys, q.items, size)
        a, b, g = q.key[node] // wide, q.key[node] % wide, q.g[node]
        if g + (0 if a == rest else hi[a]) + (0 if b == rest else hj[b]) < f:
            continue  # it was reached more cheaply since
        out[0] = f
        if a == rest and b == rest:
            ended = FOUND
            break
        n = _steps_of(r, hi, cls[i], gi, a, to, cost)
        m = _steps_of(r, hj, cls[j], gj, b, to_j, cost_j)
        if done >= limit or count + n * m >= len(q.key) or size + n * m >= len(q.keys):
            ended = SPENT
            break
        done += 1
        p, pb = gi if a == rest else np.int64(r.place[a]), gj if b == rest else np.int64(r.place[b])
        for k in range(n):
            p2 = gi if to[k] == rest else np.int64(r.place[to[k]])
            left = np.int64(0) if to[k] == rest else hi[to[k]]
            for e in range(m):
                pb2 = gj if to_j[e] == rest else np.int64(r.place[to_j[e]])
                if p2 == pb2 or (p2 == pb and pb2 == p):
                    continue
                both = left + (np.int64(0) if to_j[e] == rest else hj[to_j[e]])
                count, size = _reach(
                    q, bits, count, size, np.int64(to[k]) * wide + to_j[e], g + cost[k] + cost_j[e], both
                )
    out[1] = done
    return ended
