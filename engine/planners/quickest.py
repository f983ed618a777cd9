"""Quickest route on the empty floor, blind to the other vehicles; the shared timer schedules it.

The plainest router: it descends the exact backward table of each goal. Promise: legal by the timer; optimal on an empty
floor; no claim with traffic. Cost: the length of the route.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Memory, Promise, View
from engine.planners.kernels.tables import FAR
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]


@njit(cache=True, nogil=True)
def descend(edge_ptr, edge_to, edge_kind, state_place, cost, table, shift, state, goal, out):  # type: ignore[no-untyped-def]
    """Edges from a state to a goal place down a table; their number, or -1 when there is no way."""
    n = 0
    while state_place[state] != goal:
        best, by = FAR, -1
        for e in range(edge_ptr[state], edge_ptr[state + 1]):
            through = table[edge_to[e] >> shift]
            if through < FAR and through + cost[edge_kind[e]] < best:
                best, by = through + cost[edge_kind[e]], e
        if by < 0 or n == len(out):
            return -1
        out[n] = by
        n += 1
        state = edge_to[by]
    return n


@dataclass(frozen=True)
class Quickest:
    """No parameters."""

    promise = Promise(
        summary="the quickest route on the empty floor, made safe by waiting", optimal="on an empty floor"
    )

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Nothing to remember."""
        return {}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        g, tables = view.graph, view.search.time
        out = np.zeros(g.n_states, np.int32)
        state, legs = view.request.state, []
        for leg in view.request.legs:
            row = tables.slot(leg.place)
            n = descend(
                g.edge_ptr, g.edge_to, g.edge_kind, g.state_place, tables.costs, tables.pool[row], tables.shift, state,
                leg.place, out,
            )  # fmt: skip
            if n < 0:
                return [], memory
            legs.append(out[:n].copy())
            state = int(g.edge_to[out[n - 1]]) if n else state
            if leg.stay_ticks:
                state &= ~1
        return legs, memory
