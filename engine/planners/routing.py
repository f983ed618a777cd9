"""What routers over arcs share: one leg after the other by A*, around places that somebody holds for good."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from engine.planners.base import View
from engine.planners.kernels.routing import astar, close_taken, new_work
from engine.traffic import ground_of
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


def route_legs(view: View, cost: I64, h: Callable[[int], I64]) -> Sequence[I32]:
    """Edges for every leg of the request, least cost each, or an empty sequence when a leg has no way.

    cost: (E,) · h(goal): (poses,) estimate of the cost to go. Places that another vehicle holds for good are closed.
    """
    g, r = view.graph, view.request
    work = new_work(g.n_states, g.n_edges)
    ground = ground_of(g, view.blocked)
    closed = np.empty(g.n_places, np.uint8)
    close_taken(view.claims, g.n_places, r.vehicle, view.blocked, closed)
    out = np.empty(g.n_states // 2, np.int32)
    state, legs = r.state, []
    for leg in r.legs:
        n = astar(ground, work, cost, h(leg.place), closed, state, leg.place, out)
        if n < 0:
            return []
        legs.append(out[:n].copy())
        state = int(g.edge_to[out[n - 1]]) if n else state
        if leg.stay_ticks:
            state &= ~1
    return legs


def turns_of(graph: MotionGraph) -> I64:
    """Change of heading of every edge in degrees, (E,)."""
    by_kind = np.array([p.turn_deg for p in graph.primitives], np.int64)
    return by_kind[graph.edge_kind]


def lengths_of(graph: MotionGraph) -> I64:
    """Length of every edge in millimetres, (E,)."""
    lengths: I64 = graph.kind_mm[graph.edge_kind].astype(np.int64)
    return lengths


def entered(graph: MotionGraph) -> I32:
    """The arc that an edge drives into (a place), or -1 where it turns on the spot or drives into a node, (E,)."""
    here, there = graph.state_place[graph.edge_from], graph.state_place[graph.edge_to]
    arcs: I32 = np.where((here != there) & (graph.arc_ticks[there] > 0), there, -1).astype(np.int32)
    return arcs
