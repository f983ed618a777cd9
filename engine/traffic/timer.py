"""The shared route timer: turns a fixed route into timed motions against the reservations.

Routers say where; this says when. Along the route it keeps, for every free interval of every place, the earliest
arrival (SIPP on a line: complete for the route, earliest arrival at its end). Rules when a route can't be timed,
because something head-on or parked closes it: `detour` (a search over the whole floor takes over for this request),
then `yield` (the vehicle stays where it may stand, and is asked again later). Plans say which rule made them, so
comparisons of routers can say how much of the work the timer did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Budget, Memory, Observed, Plan, Promise, Router, View, no_plan
from engine.traffic.claims import Claims, gap_end
from engine.traffic.departures import HORIZON, STAY, Ground, departure, ground_of
from engine.types import FOREVER, Occupancy, PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
DETOUR = "solved after a detour"


@njit(cache=True, nogil=True)
def time_route(
    c: Claims, g: Ground, hold: bool, margin: int, place: int, gap: int, t0: int, rolling: bool, items: I32,
    stays: I32, edges: I32, starts: I32, ends: I32, room: int,
) -> int:  # fmt: skip
    """Times for a route of n items (edge, or STAY with its ticks in `stays`; the last STAY is forever).

    room: labels to provide per item. Fills edges, starts, ends and returns n, or -1 when the route can't be timed.
    """
    n = len(items)
    label_gap = np.full((n + 1, room), -1, np.int32)
    label_t = np.zeros((n + 1, room), np.int32)
    label_roll = np.zeros((n + 1, room), np.int8)
    came = np.zeros((n + 1, room), np.int32)
    began = np.zeros((n + 1, room), np.int32)
    used = np.zeros((n + 1, room), np.int32)
    count = np.zeros(n + 1, np.int32)
    label_gap[0, 0], label_t[0, 0], label_roll[0, 0], count[0] = gap, t0, rolling, 1
    at = place
    for i in range(n):
        last = i == n - 1
        for a in range(count[i]):
            here, t, roll = label_gap[i, a], label_t[i, a], label_roll[i, a]
            until = gap_end(c, here)
            if items[i] == STAY:
                if (last and until < FOREVER) or (not last and t + stays[i] + margin >= until):
                    continue
                count[i + 1] = keep(
                    label_gap, label_t, label_roll, came, began, used, count[i + 1], i + 1, here, t + stays[i],
                    roll if stays[i] == 0 else 0, a, t, STAY,
                )  # fmt: skip
                continue
            v = g.state_place[g.edge_to[items[i]]]
            into = here if v == at else v
            if v != at and g.blocked[v]:
                return -1
            while into >= 0 and (v == at or c.end[into] <= until):
                # compiled edges of a twin pair stand in the order of their states: stopped, then rolling
                rolls = 1 if items[i] > g.edge_twin[items[i]] else 0
                e = items[i] if rolls == roll else g.edge_twin[items[i]]
                begin = t
                if v == at:
                    if t + g.kind_ticks[g.edge_kind[e]] + margin > until:
                        begin = FOREVER
                else:
                    begin = departure(c, g, hold, margin, e, at, v, into, t, until)
                    if begin > t and roll and begin < FOREVER:
                        e = g.edge_twin[e]
                        begin = departure(c, g, hold, margin, e, at, v, into, t + 1, until)
                if begin < t0 + HORIZON and count[i + 1] < room:
                    end = begin + g.kind_ticks[g.edge_kind[e]]
                    # a pivot ends at rest
                    count[i + 1] = keep(
                        label_gap, label_t, label_roll, came, began, used, count[i + 1], i + 1, into, end,
                        g.edge_to[e] & 1, a, begin, e,
                    )  # fmt: skip
                into = -1 if v == at else c.next[into]
        if items[i] != STAY:
            at = g.state_place[g.edge_to[items[i]]]
        if count[i + 1] == 0:
            return -1
    a = 0
    for i in range(n, 0, -1):
        edges[i - 1], starts[i - 1], ends[i - 1] = used[i, a], began[i, a], label_t[i, a]
        a = came[i, a]
    return n


@njit(cache=True, nogil=True, _nrt=False)
def keep(label_gap, label_t, label_roll, came, began, used, n, i, gap, t, roll, a, begin, e):  # type: ignore[no-untyped-def]
    """Remember an arrival unless the same free interval was reached earlier; returns the number of labels."""
    at = n
    for b in range(n):
        if label_gap[i, b] == gap:
            if label_t[i, b] <= t:
                return n
            at = b
    label_gap[i, at], label_t[i, at], label_roll[i, at] = gap, t, roll
    came[i, at], began[i, at], used[i, at] = a, begin, e
    return max(n, at + 1)


@dataclass(frozen=True)
class Timed:
    """A planner made of a router and the shared timer."""

    router: Router
    promise: Promise = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "promise", self.router.promise)

    @property
    def refresh_s(self) -> float | None:
        """How often the router learns, or None when it doesn't."""
        period: float | None = getattr(self.router, "refresh_s", None)
        return period

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """The router's memory."""
        return self.router.init(graph, costs, rng)

    def learn(self, observed: Observed, memory: Memory) -> Memory:
        """See Planner."""
        learned: Memory = self.router.learn(observed, memory)  # type: ignore[attr-defined]
        return learned

    def plan(self, view: View, memory: Memory, budget: Budget) -> tuple[Plan, Memory]:
        """The router's route, timed; else a detour."""
        legs, memory = self.router.route(view, memory)
        if len(legs) == len(view.request.legs):
            plan = self.timed(view, legs)
            if plan.found:
                return plan, memory
        plan = view.search.through(view, "time", budget)
        if not plan.found:
            return plan, memory
        return (
            Plan(plan.status, plan.edges, plan.what, plan.starts, plan.ends, plan.energy_mj, plan.expanded, DETOUR),
            memory,
        )

    def timed(self, view: View, legs: Sequence[I32]) -> Plan:
        """Times for the edges of every leg, with its stay at the end."""
        r, g = view.request, view.graph
        items = np.concatenate([np.append(edges, STAY) for edges in legs]).astype(np.int32)
        stays = np.zeros(len(items), np.int32)
        at_stay = np.flatnonzero(items == STAY)
        stays[at_stay] = [leg.stay_ticks for leg in r.legs]
        out = [np.zeros(len(items), np.int32) for _ in range(3)]
        busiest = 8 + int(np.bincount(view.claims.place[view.claims.owner >= 0], minlength=1).max())
        n = time_route(
            view.claims, ground_of(g, view.blocked), view.occupancy is Occupancy.HOLD, view.margin_ticks,
            int(g.state_place[r.state]), r.gap, r.tick, bool(r.state & 1), items, stays, *out, busiest,
        )  # fmt: skip
        if n < 0:
            return no_plan(PlanStatus.NO_PATH)
        edges, starts, ends = (a[: n - 1] for a in out)
        what = np.full(n - 1, -1, np.int8)
        what[at_stay[:-1]] = [int(leg.what) for leg in r.legs[:-1]]
        loads = np.repeat([int(leg.loaded) for leg in r.legs], np.diff(at_stay, prepend=-1))[: n - 1]
        driving = edges >= 0
        energy = int(view.costs.total_mj[r.cls, loads[driving], g.edge_kind[edges[driving]]].sum())
        if len(ends):
            energy += int(ends[-1] - r.tick) * int(view.costs.standby_mj[r.cls])
        return Plan(PlanStatus.SOLVED, edges, what, starts, ends, energy, n)
