"""What routers over arcs share: one leg after the other by A*, around places that somebody holds for good."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.planners.base import Rows, View
from engine.planners.kernels.routing import new_work, route
from engine.traffic import ground_of
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


def route_legs(view: View, cost: I64, tables: Rows) -> Sequence[I32]:
    """Edges for every leg of the request, least cost each, or an empty sequence when a leg has no way.

    cost: (E,) · tables: what remains to each goal, over poses. Places that another vehicle holds for good are closed.
    """
    goals = np.array([leg.place for leg in view.request.legs], np.int32)
    wanted = set(goals.tolist())
    slots = np.array([tables.slot(goal, wanted) for goal in goals.tolist()], np.int32)
    return route_by(view, cost, tables.pool, slots, goals)


def route_by(view: View, cost: I64, pool: I64, slots: I32, goals: I32) -> Sequence[I32]:
    """The same with any estimates: row slots[i] of pool for leg i."""
    g, r, room = view.graph, view.request, view.search.room
    if "route" not in room:
        room["route"] = new_work(g.n_states, g.n_edges), np.empty(g.n_places, np.uint8)
    work, closed = room["route"]
    stays = np.array([leg.stay_ticks for leg in r.legs], np.int32)
    out, upto = np.empty(len(goals) * (g.n_states // 2), np.int32), np.zeros(len(goals), np.int32)
    found = route(
        view.claims, ground_of(g, view.blocked), work, cost, pool, slots, closed, r.vehicle, r.state, goals, stays,
        out, upto,
    )  # fmt: skip
    ends = upto.tolist()
    return [out[a:b] for a, b in zip([0, *ends], ends, strict=False)] if found else []


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
