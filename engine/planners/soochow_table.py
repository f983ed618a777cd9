"""The Soochow thesis's reservation table, as it is described and corrected.

Thesis 2022, chapter 4.2 (`strict_thesis`), where every step takes a tick: vehicles are planned in the order of their
tasks. Everybody's way is a list of (place, tick), and its last place is entered for one tick more. A way that meets the
table in between is searched again with the place of the conflict as an obstacle; a way that meets it at its end begins
one tick later, and again.
Nothing else is looked at: not two vehicles that change places, not diagonals that cross, not vehicles that stay longer
than that tick or were never planned, not the place where a vehicle waits to begin. The thesis says that this and its
one-way rule avoid all collisions. Promise: none (`legal` is False), so its plans are executed as they are.

Corrected: the same routes, timed by the shared timer against reservations of places, edges and crossings that last
until somebody leaves; a search among the reservations where no waiting helps. Promise: legal.
Cost: one search per leg, in the thesis's form one more for every conflict in between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.aco import Aco
from engine.planners.astar import AStar
from engine.planners.base import Budget, Memory, Plan, Promise, View, no_plan
from engine.planners.routes import AStarRoutes, edges_along, floor_of
from engine.planners.single import Floor
from engine.traffic import STAY
from engine.traffic.timer import Timed
from engine.types import PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

WAYS = ("aco", "astar")
LONGEST_WAIT = 10_000
"""Ticks after which waiting at the start is given up."""


@dataclass(frozen=True)
class SoochowTable:
    """strict_thesis: as described, collisions and all · ways: what finds them, `aco` or `astar` · ants,
    iterations, inducement: of the colonies.
    """

    strict_thesis: bool = False
    ways: str = "aco"
    ants: int = 20
    iterations: int = 20
    inducement: str = "exponent"

    promise = Promise(
        summary="the Soochow thesis's reservation table; with strict_thesis as described, which collides",
        turnings=frozenset({"arc"}),
        cells=True,
    )

    def __post_init__(self) -> None:
        if self.ways not in WAYS:
            raise ValueError(f"ways must be {' or '.join(map(repr, WAYS))}; got {self.ways!r}")
        self.colony.rules()  # raises for parameters that no colony has
        object.__setattr__(self, "promise", replace(type(self).promise, legal=not self.strict_thesis))

    @cached_property
    def colony(self) -> Aco:
        """The ants that find the ways."""
        return Aco(ants=self.ants, iterations=self.iterations, inducement=self.inducement)

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """The colonies' seed and number, and the table: rows of vehicle, place, tick."""
        none = np.zeros(0, np.int32)
        return {**self.colony.init(graph, costs, rng), "table_vehicle": none, "table_place": none, "table_tick": none}

    def plan(self, view: View, memory: Memory, budget: Budget) -> tuple[Plan, Memory]:
        """Answer the view's request."""
        if not self.strict_thesis:
            found, kept = Timed(self.colony if self.ways == "aco" else AStarRoutes()).plan(view, memory, budget)
            return found, {**memory, **kept}
        r, table = view.request, Table.of(memory, view.request.vehicle, view.request.tick)
        legs: list[tuple[I32, int]] = []
        place, tick = int(view.graph.state_place[r.state]), r.tick
        for leg in r.legs:
            floor = floor_of(view, leg.loaded)
            way, wait, memory = self._leg(floor, table, place, leg.place, tick, memory)
            if not len(way):
                return no_plan(PlanStatus.NO_PATH), memory
            legs.append((way, wait))
            table.enter(r.vehicle, way, wait, tick)
            place, tick = leg.place, tick + wait + len(way) - 1 + leg.stay_ticks
        return _timed(view, legs), {**memory, **table.columns()}

    def _leg(
        self, floor: Floor, table: Table, start: int, goal: int, tick: int, memory: Memory
    ) -> tuple[I32, int, Memory]:
        """(places, ticks to wait first, memory) of one leg; no places when there is no way."""
        closed = floor.blocked.copy()
        way, memory = self._way(floor, closed, start, goal, memory)
        wait = 0
        while len(way):
            met = table.first_met(way, tick + wait)
            if met < 0:
                break
            if met < len(way) - 1:
                closed[way[met]] = 1
                way, memory = self._way(floor, closed, start, goal, memory)
            elif wait < LONGEST_WAIT:
                wait += 1
            else:
                way = way[:0]
        return way, wait, memory

    def _way(self, floor: Floor, closed: U8, start: int, goal: int, memory: Memory) -> tuple[I32, Memory]:
        """Places of a way around closed ones; empty when there is none."""
        if self.ways == "astar":
            around = Floor(floor.graph, floor.costs, closed) if closed.any() else floor
            rule = "manhattan" if len(floor.graph.heading_deg) == 4 else "octile"
            found = AStar(rule).search(around, start, goal)
            return floor.graph.state_place[found.states].astype(np.int32), memory
        memory = {**memory, "colonies": int(memory["colonies"]) + 1}
        seed = memory["seed"] + memory["colonies"]
        return self.colony.search(floor, start, goal, seed, closed=closed).places, memory


class Table:
    """The thesis's table: who is where at which tick, as far as it was planned."""

    def __init__(self, vehicle: I32, place: I32, tick: I32) -> None:
        self.vehicle, self.place, self.tick = vehicle, place, tick

    @classmethod
    def of(cls, memory: Memory, vehicle: int, tick: int) -> Table:
        """The others' entries from a tick on."""
        keep = (memory["table_vehicle"] != vehicle) & (memory["table_tick"] >= tick)
        return cls(*(memory[f"table_{name}"][keep] for name in ("vehicle", "place", "tick")))

    def columns(self) -> Memory:
        """As it stands in the planner's memory."""
        return {"table_vehicle": self.vehicle, "table_place": self.place, "table_tick": self.tick}

    def enter(self, vehicle: int, way: I32, wait: int, tick: int) -> None:
        """Put a way in, its first place while it waits there too, and its last for one tick more."""
        places = np.concatenate([np.full(wait, way[0]), way, way[-1:]]).astype(np.int32)
        self.vehicle = np.append(self.vehicle, np.full(len(places), vehicle, np.int32))
        self.place = np.append(self.place, places)
        self.tick = np.append(self.tick, np.arange(tick, tick + len(places), dtype=np.int32))

    def first_met(self, way: I32, begin: int) -> int:
        """Index of the first place of a way, begun at a tick, that is taken then; the start is not looked at. Or -1."""
        taken = set(zip(self.place.tolist(), self.tick.tolist(), strict=True))
        for i, place in enumerate(way.tolist()[1:], start=1):
            if (place, begin + i) in taken:
                return i
        return -1


def _timed(view: View, legs: list[tuple[I32, int]]) -> Plan:
    """Motions and stays of ways that begin after their waits."""
    r, g = view.request, view.graph
    edges, what, starts, ends = [], [], [], []
    energy, state, tick = 0, int(r.state), r.tick
    for (way, wait), leg in zip(legs, r.legs, strict=True):
        floor = floor_of(view, leg.loaded)
        states = floor.along(np.append(np.full(wait, way[0], np.int32), way), state if not wait else state & ~1)
        moves = edges_along(g, states)
        ends_at = tick + wait + np.cumsum(g.kind_ticks[g.edge_kind[moves]], dtype=np.int64)
        energy += int(view.costs.total_mj[r.cls, int(leg.loaded), g.edge_kind[moves]].sum())
        edges += [*moves.tolist(), STAY]
        what += [*([-1] * len(moves)), int(leg.what)]
        starts += [tick + wait, *ends_at.tolist()]
        tick = starts[-1] + leg.stay_ticks
        ends += [*ends_at.tolist(), tick]
        state = int(states[-1]) if not leg.stay_ticks else int(states[-1]) & ~1
    n = len(edges) - 1  # the last stay is forever
    energy += (int(ends[n - 1]) - r.tick) * int(view.costs.standby_mj[r.cls]) if n else 0
    return Plan(
        PlanStatus.SOLVED, np.array(edges[:n], np.int32), np.array(what[:n], np.int8), np.array(starts[:n], np.int32),
        np.array(ends[:n], np.int32), energy, n,
    )  # fmt: skip
