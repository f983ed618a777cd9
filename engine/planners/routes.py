"""A* by distance and EEA* as routers of lifelong runs: they say where, the shared timer says when.

Sources: engine.planners.astar and engine.planners.eea, whose parameters these take. Promise: legal by the timer;
shortest, or of least energy, on an empty floor (`eea` in its variant `exact`). Blocked cells are avoided. Cost: one
search per leg.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.astar import AStar
from engine.planners.base import Memory, Promise, View
from engine.planners.eea import Eea
from engine.planners.single import Floor, Way
from engine.types import PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]


@dataclass(frozen=True)
class AStarRoutes:
    """heuristic: of AStar, or `best`: manhattan with four neighbours, octile with eight · tie, seed: of AStar."""

    heuristic: str = "best"
    tie: str = "fifo"
    seed: int = 0

    promise = Promise(
        summary="a shortest route on the empty floor, made safe by waiting",
        optimal="in distance, on an empty floor",
        turnings=frozenset({"arc"}),
        cells=True,
    )

    def __post_init__(self) -> None:
        AStar("octile" if self.heuristic == "best" else self.heuristic, self.tie, self.seed)

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Nothing to remember."""
        return {}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        rule = ("manhattan" if len(view.graph.heading_deg) == 4 else "octile") if self.heuristic == "best" else None
        method = AStar(rule or self.heuristic, self.tie, self.seed)

        def way(floor: Floor, place: int, goal: int, heading: int) -> Way:
            return method.search(floor, place, goal, heading=heading)

        return _legs(view, way), memory


@dataclass(frozen=True)
class EeaRoutes:
    """As of Eea: variant `exact`, `literal-cell` or `literal-cell-time`, and its other parameters."""

    variant: str = "exact"
    heuristic: str = "table"
    tie: str = "lifo"
    reversal: str = "cost"
    restart: str = "cost"

    promise = Promise(
        summary="the route of least energy on the empty floor, made safe by waiting",
        optimal="in energy, on an empty floor",
        objectives=("energy",),
        turnings=frozenset({"arc"}),
        cells=True,
        connectivity=frozenset({4}),
    )

    def __post_init__(self) -> None:
        self.method()

    def method(self) -> Eea:
        """The search with these parameters."""
        return Eea(self.variant, self.heuristic, self.tie, self.reversal, self.restart)

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Nothing to remember."""
        return {}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        method, cls = self.method(), view.request.cls

        def way(floor: Floor, place: int, goal: int, heading: int) -> Way:
            return method.search(floor, place, goal, cls=cls, heading=heading)

        return _legs(view, way), memory


def _legs(view: View, way: Callable[[Floor, int, int, int], Way]) -> Sequence[I32]:
    """Edges of every leg of the view's request, by a search (floor, place, goal, heading); empty for no way."""
    g, state, legs = view.graph, view.request.state, []
    for leg in view.request.legs:
        found = way(floor_of(view, leg.loaded), int(g.state_place[state]), leg.place, int(g.state_heading[state]))
        if found.status is not PlanStatus.SOLVED:
            return []
        legs.append(edges_along(g, found.states))
        state = int(found.states[-1])
    return legs


def edges_along(graph: MotionGraph, states: I32) -> I32:
    """The motions between states that follow each other tick by tick; waits are left out."""
    out = []
    for a, b in zip(states[:-1].tolist(), states[1:].tolist(), strict=True):
        if b != graph.stopped[a]:
            first, last = int(graph.edge_ptr[a]), int(graph.edge_ptr[a + 1])
            out.append(first + int(np.flatnonzero(graph.edge_to[first:last] == b)[0]))
    return np.array(out, np.int32)


_FLOORS: list[tuple[MotionGraph, CostTable, bool, Floor]] = []
"""Rooms and tables of the latest floors; nothing in them outlives a search but what follows from the floor."""


def floor_of(view: View, loaded: bool) -> Floor:
    """The floor with its present blocks, and the costs of an empty or a loaded vehicle."""
    for graph, costs, load, floor in _FLOORS:
        if graph is view.graph and costs is view.costs and load == loaded:
            if not np.array_equal(floor.blocked, view.blocked):
                floor.blocked[:] = view.blocked
                for name in ("grounds", "back", "two_way", "lattice"):
                    floor.__dict__.pop(name, None)
            return floor
    c = view.costs
    table = CostTable(c.mj[:, ::-1], c.total_mj[:, ::-1], c.standby_mj) if loaded else c
    floor = Floor(view.graph, table, view.blocked.copy())
    _FLOORS.append((view.graph, c, loaded, floor))
    del _FLOORS[:-4]
    return floor
