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

from engine.compiled import lean
from engine.energy import CostTable
from engine.planners.base import Budget, Memory, Plan, Promise, Router, View, no_plan
from engine.traffic.claims import Claims, gap_end
from engine.traffic.departures import DETOUR, HORIZON, STAY, Ground, departure, ground_of
from engine.types import FOREVER, Occupancy, PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
DETOUR_WITHIN = 1.25
"""A detour takes at most so many times as long as the best one: exact search would take most of the planning time."""


@njit(cache=True, nogil=True)
def time_route(
    c: Claims, g: Ground, hold: bool, margin: int, place: int, gap: int, t0: int, rolling: bool, items: I32,
    stays: I32, edges: I32, starts: I32, ends: I32,
) -> int:  # fmt: skip
    """Times for a route of n items (edge, or STAY with its ticks in `stays`; the last STAY is forever).

    Fills edges, starts, ends and returns n, or -1 when the route can't be timed.
    """
    n = len(items)
    room = 8  # labels per item: no more than free intervals of a place
    for i in range(n):
        slot, intervals = g.state_place[g.edge_to[items[i]]] if items[i] != STAY else place, 8
        while slot >= 0:
            slot = c.next[slot]
            intervals += 1
        room = max(room, intervals)
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


@lean
def keep(
    label_gap: I32, label_t: I32, label_roll: NDArray[np.int8], came: I32, began: I32, used: I32, n: int, i: int,
    gap: int, t: int, roll: int, a: int, begin: int, e: int,
) -> int:  # fmt: skip
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


@njit(cache=True, nogil=True)
def time_legs(
    c: Claims, g: Ground, hold: bool, margin: int, place: int, gap: int, t0: int, rolling: bool, driven: I32,
    legs: I32, load_mj: I64, standby: int, edges: I32, starts: I32, ends: I32, what: NDArray[np.int8],
) -> tuple[int, int]:  # fmt: skip
    """Times and energy of a route through legs (edges, stay ticks, activity, loaded), one row each.

    load_mj: (2, K). Fills the arrays, whose last entry is the last stay, and returns (steps, mJ), or (-1, 0).
    """
    n = len(edges)
    items, stays = np.empty(n, np.int32), np.zeros(n, np.int32)
    i = at = 0
    for leg in range(len(legs)):
        for _ in range(legs[leg, 0]):
            items[i], what[i] = driven[at], -1
            i, at = i + 1, at + 1
        items[i], stays[i], what[i] = STAY, legs[leg, 1], legs[leg, 2]
        i += 1
    if time_route(c, g, hold, margin, place, gap, t0, rolling, items, stays, edges, starts, ends) < 0:
        return -1, 0
    energy, i = np.int64(0), 0
    for leg in range(len(legs)):
        for _ in range(legs[leg, 0]):
            energy += load_mj[legs[leg, 3], g.edge_kind[edges[i]]]
            i += 1
        i += 1
    if n > 1:
        energy += np.int64(ends[n - 2] - t0) * standby
    return n, energy


@dataclass(frozen=True)
class Timed:
    """A planner made of a router and the shared timer."""

    router: Router
    promise: Promise = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "promise", self.router.promise)

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """The router's memory."""
        return self.router.init(graph, costs, rng)

    def plan(self, view: View, memory: Memory, budget: Budget) -> tuple[Plan, Memory]:
        """The router's route, timed; else a detour."""
        legs, memory = self.router.route(view, memory)
        if len(legs) == len(view.request.legs):
            plan = self.timed(view, legs)
            if plan.found:
                return plan, memory
        plan = view.search.through(view, "time", budget, DETOUR_WITHIN)
        if not plan.found:
            return plan, memory
        return plan._replace(note=DETOUR), memory

    def timed(self, view: View, legs: Sequence[I32]) -> Plan:
        """Times for the edges of every leg, with its stay at the end."""
        r, g = view.request, view.graph
        driven = np.concatenate(legs)
        asked = np.array(r.legs, np.int32)  # place, stay ticks, activity, loaded
        asked[:, 0] = [len(way) for way in legs]
        n = len(driven) + len(asked)
        edges, starts, ends = (np.empty(n, np.int32) for _ in range(3))
        what = np.empty(n, np.int8)
        timed, energy = time_legs(
            view.claims, ground_of(g, view.blocked), view.occupancy is Occupancy.HOLD, view.margin_ticks,
            int(g.state_place[r.state]), r.gap, r.tick, bool(r.state & 1), driven, asked,
            view.costs.total_mj[r.cls], int(view.costs.standby_mj[r.cls]), edges, starts, ends, what,
        )  # fmt: skip
        if timed < 0:
            return no_plan(PlanStatus.NO_PATH)
        return Plan(PlanStatus.SOLVED, edges[: n - 1], what[: n - 1], starts[: n - 1], ends[: n - 1], energy, n)
