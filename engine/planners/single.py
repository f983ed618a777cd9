"""What A* and EEA* share: a floor made ready for one vehicle's searches, and the way found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.kernels import single
from engine.planners.kernels.tables import Tables
from engine.types import PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

STATUS = {
    single.SOLVED: PlanStatus.SOLVED,
    single.NO_PATH: PlanStatus.NO_PATH,
    single.BUDGET: PlanStatus.BUDGET_SPENT,
}


@dataclass(frozen=True, slots=True)
class Way:
    """One vehicle's way.

    states: motion states tick by tick (empty without a way) · cost: in the search's unit · trace: columns node, parent,
    g, h, f, open, one row per expansion in order, when asked for.
    """

    status: PlanStatus
    states: I32
    cost: int
    expanded: int
    trace: Mapping[str, NDArray[Any]] = field(default_factory=dict)


class Floor:
    """A grid's graph with the room and tables that searches on it reuse. Not for two threads at once."""

    def __init__(self, graph: MotionGraph, costs: CostTable, blocked: NDArray[np.uint8] | None = None):
        self.graph, self.costs = graph, costs
        self.blocked = np.zeros(graph.n_places, np.uint8) if blocked is None else blocked
        self.net = single.net_of(graph)
        self.per_place = 1 << self.net.shift
        self.kinds = {p.name: k for k, p in enumerate(graph.primitives)}
        self.state_work: single.StateWork | None = None
        self._tables: dict[bytes, Tables] = {}

    @cached_property
    def grounds(self) -> single.Grounds:
        """Neighbours of every place; blocked places have none."""
        grounds = single.grounds_of(self.graph)
        closed = np.append(self.blocked, 0).astype(np.bool_)
        grounds.step[closed[grounds.step]] = self.graph.n_places
        return grounds

    @cached_property
    def back(self) -> I32:
        """(P+1, D) place that a step in the opposite direction comes from: on one-way floors not a neighbour."""
        step = self.grounds.step
        none, heads = step.shape[0] - 1, step.shape[1]
        back = np.full_like(step, none)
        place, ahead = np.nonzero(step[:-1] != none)
        back[step[place, ahead], (ahead + heads // 2) % heads] = place
        return back

    @cached_property
    def two_way(self) -> bool:
        """Whether every step can be gone back."""
        return bool((self.back == self.grounds.step).all())

    @cached_property
    def turns_freely(self) -> bool:
        """Whether from any state a vehicle may roll on to any neighbour of its place, so that places say the states."""
        return single.turns_freely(self.graph, single.grounds_of(self.graph))

    @cached_property
    def lattice(self) -> single.Lattice:
        """The same places as cells in rows. Raises ValueError unless they are a 4-connected grid's."""
        return single.lattice_of(self.grounds)

    @cached_property
    def place_work(self) -> single.PlaceWork:
        """Room of searches over cells."""
        return single.new_place_work(self.lattice)

    def mj(self, cls: int = 0) -> I64:
        """Energy of each primitive, standby included, of an empty vehicle."""
        mj: I64 = self.costs.total_mj[cls, 0] + self.costs.standby_mj[cls] * self.graph.kind_ticks.astype(np.int64)
        return mj

    def table(self, goal: int, cost: I64) -> I64:
        """Exact energy from every state to a place on the floor without blocks."""
        tables = self._tables.setdefault(cost.tobytes(), Tables(self.graph, cost, poses=False))
        at = tables.slot(goal)
        row: I64 = tables.pool[at]
        return row

    def headings(self, place: int) -> I32:
        """The standing states of a place."""
        first = place * self.per_place
        return np.arange(first, first + self.per_place, 2, dtype=np.int32)

    def along(self, places: Sequence[int] | I32, start: int | None = None) -> I32:
        """States of a vehicle at these places tick by tick; without a start state it faces its first step."""
        path = np.asarray(places, np.int32)
        states = np.zeros(len(path), np.int32)
        begin = self.facing(path) if start is None else start
        if single.states_of(self.net, path, begin, states) >= 0:
            raise ValueError("the places don't follow each other")
        return states

    def facing(self, places: I32) -> int:
        """The standing state at the first place that faces the first step; east when there is none."""
        moved = np.nonzero(places != places[0])[0]
        first = int(places[0]) * self.per_place
        if not len(moved):
            return first
        to = int(places[moved[0]])
        ahead = np.nonzero(self.grounds.step[places[0]] == to)[0]
        return first + 2 * int(ahead[0]) if len(ahead) else first

    def energy(self, states: I32, cls: int = 0) -> int:
        """mJ of states tick by tick. Raises ValueError when they don't follow each other."""
        total = int(single.energy_along(self.net, states, self.mj(cls), int(self.costs.standby_mj[cls])))
        if total < 0:
            raise ValueError("the states don't follow each other")
        return total


def columns(trace: single.Trace, rows: int) -> dict[str, NDArray[Any]]:
    """The rows written of a trace, by name."""
    return {name: getattr(trace, name)[:rows].copy() for name in trace._fields} if rows else {}
