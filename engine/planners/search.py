"""One vehicle's search through a chain of goals: checks, tables and buffers around the SIPP kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Budget, Plan, View, no_plan
from engine.planners.kernels import sipp
from engine.planners.kernels.tables import TICK, Tables, packed, packed_energy
from engine.traffic import FAR, STAY, Claims, ground_of
from engine.types import Occupancy, PlanStatus
from engine.world.motion_graph import MotionGraph

_STATUS = {
    sipp.SOLVED: PlanStatus.SOLVED,
    sipp.NO_PATH: PlanStatus.NO_PATH,
    sipp.BUDGET: PlanStatus.BUDGET_SPENT,
}


class FloorSearch:
    """Search space and backward tables of one graph and cost table; shared by all requests of a run."""

    def __init__(self, graph: MotionGraph, costs: CostTable):
        self.graph, self.costs = graph, costs
        # lower bounds over vehicle classes and loads, so that one table serves all
        least = costs.total_mj.min(axis=(0, 1)) + graph.kind_ticks.astype(np.int64) * costs.standby_mj.min()
        # a pivot ends at rest and the next motion starts: where there are pivots, stopped and rolling are two things
        pivots = any(p.pivot for p in graph.primitives)
        self.time = Tables(graph, packed(graph.kind_ticks, least), poses=not pivots)
        self.energy = Tables(graph, packed_energy(graph.kind_ticks, least), poses=False)
        self.room: dict[str, Any] = {}
        self._by_edge: dict[str, tuple[int, Tables]] = {}
        self._work = sipp.new_work(1 << 14, 1)
        self._out = np.zeros(2, np.int64)
        self._steps = [np.zeros(1 << 14, np.int32) for _ in range(3)]
        starts = [costs.total_mj[:, :, k] for k in range(len(graph.primitives))]
        twin = graph.edge_kind[graph.edge_twin]
        extra = [
            int((starts[b] - starts[a]).max())
            for a, b in set(zip(graph.edge_kind.tolist(), twin.tolist(), strict=True))
        ]
        self.restart_mj = max([0, *extra])

    def by_edge(self, name: str, version: int, costs: NDArray[np.int64]) -> Tables:
        """Backward tables over poses with a cost per edge, kept under a name until its version changes."""
        held = self._by_edge.get(name)
        if held is None or held[0] != version:
            held = (version, Tables(self.graph, costs, poses=True, per_edge=True))
            self._by_edge[name] = held
        return held[1]

    def ticks_to(self, goal: int, state: int) -> int:
        """Ticks from a state to a place on an empty floor; FAR >> TICK when there is no way."""
        return self.time.cost(goal, state) >> TICK

    def ticks_from(self, goal: int, states: NDArray[np.int32]) -> NDArray[np.int64]:
        """The same for many states at once."""
        row = self.time.slot(goal)
        ticks: NDArray[np.int64] = self.time.pool[row, states >> self.time.shift] >> TICK
        return ticks

    def energy_to(self, goal: int, state: int) -> int:
        """mJ (least class and load, rolling) of the quickest way from a state to a place on an empty floor."""
        return self.time.cost(goal, state) & ((1 << TICK) - 1)

    def through(self, view: View, objective: str, budget: Budget, within: float = 1.0) -> Plan:
        """The best plan through the request's legs by `time` or `energy`; by time at most `within` times as long."""
        r = view.request
        if not r.legs:
            return no_plan(PlanStatus.INCONSISTENT, note="a request without goals")
        if len(r.legs) > sipp.MAX_LEGS:
            return no_plan(PlanStatus.INCONSISTENT, note=f"a request with more than {sipp.MAX_LEGS} goals")
        goals = np.array([leg.place for leg in r.legs], np.int32)
        stays = np.array([leg.stay_ticks for leg in r.legs], np.int32)
        if sipp.a_goal_is_taken(view.claims, goals, r.tick):
            return no_plan(PlanStatus.NO_PATH)
        tables = self.time if objective == "time" else self.energy
        wanted = set(goals.tolist())
        slots = np.array([tables.slot(goal, wanted) for goal in goals.tolist()], np.int32)
        kind_mj = self.costs.total_mj[r.cls, [int(leg.loaded) for leg in r.legs]]
        standby = int(self.costs.standby_mj[r.cls])
        hold = view.occupancy is Occupancy.HOLD
        ground = ground_of(view.graph, view.blocked)
        per_place = int(self.graph.place_ptr[1] - self.graph.place_ptr[0])
        labels = len(view.claims.start) * per_place * (len(goals) + 1)
        if labels > len(self._work.best):
            self._work = sipp.new_work(len(self._work.state), labels)
        while True:
            if objective == "time":
                status = sipp.search_time(
                    view.claims, ground, self._work, hold, view.margin_ticks, r.state, r.gap, r.tick, goals, stays,
                    tables.pool, slots, tables.shift, kind_mj, standby, int(8 * within),
                    budget.expansions, self._out,
                )  # fmt: skip
            else:
                calm = settled(view.claims)
                status = sipp.search_energy(
                    view.claims, ground, self._work, hold, view.margin_ticks, r.state, r.gap, r.tick, goals, stays,
                    tables.pool, slots, kind_mj, standby, self.restart_mj, calm, budget.expansions, self._out,
                )  # fmt: skip
            if status != sipp.FULL:
                break
            self._work = sipp.new_work(4 * len(self._work.state), labels)
        expanded = int(self._out[1])
        if status != sipp.SOLVED:
            return no_plan(_STATUS[status], expanded)
        return self._plan(view, int(self._out[0]), expanded)

    def _plan(self, view: View, node: int, expanded: int) -> Plan:
        w = self._work
        n = sipp.trail(w, node, *self._steps) if len(w.state) <= len(self._steps[0]) else self._long_trail(node)
        edges, starts, ends = (a[:n].copy() for a in self._steps)
        what = np.full(n, -1, np.int8)
        what[edges == STAY] = [int(leg.what) for leg in view.request.legs]
        # the last stay is forever: the vehicle's final activity, not a step
        return Plan(
            PlanStatus.SOLVED, edges[:-1], what[:-1], starts[:-1], ends[:-1], int(w.energy[node]), expanded
        )  # fmt: skip

    def _long_trail(self, node: int) -> int:
        self._steps = [np.zeros(len(self._work.state), np.int32) for _ in range(3)]
        return int(sipp.trail(self._work, node, *self._steps))


def settled(claims: Claims) -> int:
    """The tick after which no claim begins or ends."""
    taken = claims.owner >= 0
    ends = np.concatenate([claims.start[taken], claims.end[taken]])
    ends = ends[ends < FAR]
    return int(ends.max()) if len(ends) else 0
