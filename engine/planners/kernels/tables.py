"""Backward tables: the exact cost from every state to a goal place on an empty floor, by Dijkstra over reversed edges.

Two layers, each packing two costs into one integer so that the second breaks ties of the first: `time` is (ticks, mJ)
on poses (a state pair stopped/moving counts as one, taken as moving: a lower bound); `energy` is (mJ, ticks) on states,
exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

FAR = np.int64(2**62)
"""Cost of a state from which the goal can't be reached."""

TICK = 40
"""Bits of the energy part of a packed (ticks, mJ) cost."""

ENERGY = 22
"""Bits of the time part of a packed (mJ, ticks) cost: as many as HORIZON has."""


@lean
def _table(
    place_ptr: I32, edge_from: I32, rev_ptr: I32, rev_edge: I32, cost: I64, goal: int, poses: bool, out: I64, keys: I64,
    items: I32,
) -> None:  # fmt: skip
    """Fill `out` with costs to any state of the goal place. `poses`: collapse state pairs."""
    out[:] = FAR
    size = 0
    for s in range(place_ptr[goal], place_ptr[goal + 1]):
        at = s >> 1 if poses else s
        if out[at] > 0:
            out[at] = 0
            size = push(keys, items, size, 0, at)
    while size > 0:
        d, at = keys[0], items[0]
        size = drop_first(keys, items, size)
        if d > out[at]:
            continue
        first, last = (2 * at, 2 * at + 2) if poses else (at, at + 1)
        for s in range(first, last):
            for r in range(rev_ptr[s], rev_ptr[s + 1]):
                e = rev_edge[r]
                before = edge_from[e]
                if poses:
                    if before & 1 == 0:
                        continue
                    before >>= 1
                through = d + cost[e]
                if through < out[before]:
                    out[before] = through
                    size = push(keys, items, size, through, before)


class Tables:
    """Backward tables by goal, kept least-recently-used in one array so that kernels take a pool and slot numbers.

    costs: (K,) cost of each primitive in the table's unit, or (E,) of each edge when `per_edge`. Tables are made on the
    floor without blocks: a block only makes ways longer, so they stay lower bounds.
    """

    def __init__(
        self,
        graph: MotionGraph,
        costs: NDArray[np.int64],
        *,
        poses: bool,
        per_edge: bool = False,
        max_bytes: int = 400_000_000,
    ):
        width = graph.n_states // 2 if poses else graph.n_states
        self.shift = 1 if poses else 0
        slots = int(np.clip(max_bytes // (8 * max(width, 1)), 8, max(graph.n_places, 8)))
        self.costs = costs
        self._edge_costs = costs if per_edge else costs[graph.edge_kind]
        self._graph, self._limit = graph, slots
        self.pool = np.empty((min(slots, 16), width), np.int64)
        self._slot: dict[int, int] = {}
        self._keys = np.empty(graph.n_edges + graph.n_states + 16, np.int64)
        self._items = np.empty(len(self._keys), np.int32)

    def slot(self, goal: int, keep: frozenset[int] | set[int] = frozenset()) -> int:
        """Row of `pool` with the costs to a goal place; computed when absent. `keep`: goals not to evict."""
        at = self._slot.pop(goal, None)
        if at is None:
            at = self._room(keep)
            g = self._graph
            _table(
                g.place_ptr, g.edge_from, g.rev_ptr, g.rev_edge, self._edge_costs, goal, bool(self.shift),
                self.pool[at], self._keys, self._items,
            )  # fmt: skip
        self._slot[goal] = at
        return at

    def cost(self, goal: int, state: int) -> int:
        """Cost from a state to a goal place; FAR when unreachable."""
        at = self.slot(goal)  # may make the pool anew
        return int(self.pool[at, state >> self.shift])

    def _room(self, keep: frozenset[int] | set[int]) -> int:
        used = len(self._slot)
        if used < len(self.pool):
            return used
        if used < self._limit:
            more = np.empty((min(2 * used, self._limit), self.pool.shape[1]), np.int64)
            more[:used] = self.pool
            self.pool = more
            return used
        oldest = next(goal for goal in self._slot if goal not in keep)
        return self._slot.pop(oldest)


def packed(ticks: NDArray[np.int32], mj: NDArray[np.int64]) -> NDArray[np.int64]:
    """(ticks, mJ) as one integer that orders by time, then energy."""
    return (ticks.astype(np.int64) << TICK) + mj


def packed_energy(ticks: NDArray[np.int32], mj: NDArray[np.int64]) -> NDArray[np.int64]:
    """(mJ, ticks) as one integer that orders by energy, then time."""
    return (mj << ENERGY) + ticks
