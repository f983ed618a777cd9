"""Least makespan, exactly: assignment, sequence and exit of every order as a mixed integer program, solved by HiGHS.

Source: Wang et al. 2019 asks for this model, and prints it incompletely. Here every order is an arc from the exit where
its vehicle was before to the exit where it is brought; a sequence is a walk through the exits that uses its orders'
arcs once each. Promise: optimal within the nodes given, else the best found with its gap. Cost: 3 vehicles × 8 orders
one to two seconds, 4 × 10 up to half a minute; beyond VARIABLES, insertion alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.dispatch.ahead import give_first
from engine.dispatch.base import Assignment, ChargingPolicy, FloorView, Refusal
from engine.dispatch.insertion import insertion
from engine.dispatch.schedule import ALLOWED, Schedule, Work, schedule_of

VARIABLES = 500
"""Larger programs are left to insertion."""
ROUNDS = 500
"""Of local search, before the program for a first bound, and after it to shorten what doesn't decide."""


class _Rows:
    """Rows of a sparse system low ≤ A x ≤ high."""

    def __init__(self) -> None:
        self.columns: list[NDArray[np.int64]] = []
        self.values: list[NDArray[np.float64]] = []
        self.low: list[float] = []
        self.high: list[float] = []

    def add(self, low: float, high: float, *terms: tuple[Any, Any]) -> None:
        """One row: terms are (variables, coefficient or as many)."""
        columns = [np.asarray(c, np.int64).ravel() for c, _ in terms]
        self.columns.append(np.concatenate(columns))
        self.values.append(
            np.concatenate(
                [
                    np.broadcast_to(np.asarray(v, float).ravel(), c.shape)
                    for c, (_, v) in zip(columns, terms, strict=True)
                ]
            )
        )
        self.low.append(low)
        self.high.append(high)

    def constraint(self, variables: int) -> Any:
        """For scipy."""
        from scipy import sparse
        from scipy.optimize import LinearConstraint

        ptr = np.concatenate([[0], np.cumsum([len(c) for c in self.columns])])
        shape = (len(self.columns), variables)
        matrix = sparse.csr_array((np.concatenate(self.values), np.concatenate(self.columns), ptr), shape=shape)
        return LinearConstraint(matrix, self.low, self.high)


@dataclass(frozen=True)
class _Program:
    """Where the variables of a program stand; R vehicles, N orders, E exits.

    begin: (R, N, E) order i is vehicle r's first, brought to e · then: (R, N, E, E) it comes from exit h, is brought to
    e · stop: (R, E) its last exit · seen: (R, E) it comes by e · enter, pass_: (R, E), (R, E, E) a flow that reaches
    every exit seen · makespan.
    """

    begin: NDArray[np.int64]
    then: NDArray[np.int64]
    stop: NDArray[np.int64]
    seen: NDArray[np.int64]
    enter: NDArray[np.int64]
    pass_: NDArray[np.int64]
    makespan: int

    @staticmethod
    def of(vehicles: int, orders: int, exits: int) -> _Program:
        """Numbers the variables."""
        r, n, e = vehicles, orders, exits
        shapes = [(r, n, e), (r, n, e, e), (r, e), (r, e), (r, e), (r, e, e)]
        starts = np.concatenate([[0], np.cumsum([int(np.prod(s)) for s in shapes])])
        parts = [np.arange(a, a + int(np.prod(s))).reshape(s) for a, s in zip(starts[:-1], shapes, strict=True)]
        begin, then, stop, seen, enter, pass_ = parts
        return _Program(begin, then, stop, seen, enter, pass_, int(starts[-1]))

    def rows(self, work: Work) -> _Rows:
        """The constraints."""
        rows = _Rows()
        vehicles, orders, exits = self.begin.shape
        first = work.first[:, :, None] + work.carry[None]
        then = work.back.T[:, :, None] + work.carry[:, None, :]
        for i in range(orders):
            rows.add(1, 1, (self.begin[:, i], 1), (self.then[:, i], 1))
        for r in range(vehicles):
            begin, walk = self.begin[r], self.then[r]
            rows.add(-np.inf, 0, (begin, first[r]), (walk, then), (self.makespan, -1))
            rows.add(0, 1, (begin, 1))
            for e in range(exits):
                others = [h for h in range(exits) if h != e]
                # what comes to an exit leaves it or stops there
                rows.add(
                    0, 0, (begin[:, e], 1), (walk[:, others, e], 1), (walk[:, e, others], -1), (self.stop[r, e], -1)
                )
                # an exit from which it leaves is one that the flow reaches
                for i in range(orders):
                    rows.add(-np.inf, 0, (walk[i, e], 1), (self.seen[r, e], -1))
                flow = [(self.enter[r, e], 1), (self.pass_[r, others, e], 1), (self.pass_[r, e, others], -1)]
                rows.add(0, 0, *flow, (self.seen[r, e], -1))
                rows.add(-np.inf, 0, (self.enter[r, e], 1), (begin[:, e], -exits))
                for h in others:
                    rows.add(-np.inf, 0, (self.pass_[r, h, e], 1), (walk[:, h, e], -exits))
        return rows

    def solve(self, work: Work, most: int, nodes: int) -> Any:
        """scipy's answer; `most`: a makespan that is known to be possible."""
        from scipy.optimize import Bounds, milp

        count = self.makespan + 1
        high = np.ones(count)
        exits = self.begin.shape[2]
        high[self.enter] = high[self.pass_] = exits
        high[self.begin[work.first[:, :, None] + work.carry[None] >= ALLOWED]] = 0
        then = np.broadcast_to(work.back.T[:, :, None] + work.carry[:, None, :], self.then.shape[1:])
        high[self.then[:, then >= ALLOWED]] = 0
        high[self.then[~work.may]] = 0
        high[self.makespan] = most
        low = np.zeros(count)
        low[self.makespan] = work.lower_bound()
        whole = np.zeros(count)
        whole[: self.seen.min()] = 1
        goal = np.zeros(count)
        goal[self.makespan] = 1
        barred = Work(*(np.where(a < ALLOWED, a, 0) for a in (work.first, work.carry, work.back)))
        return milp(
            goal, constraints=self.rows(barred).constraint(count), bounds=Bounds(low, high), integrality=whole,
            options={"node_limit": nodes, "mip_rel_gap": 0.0},
        )  # fmt: skip

    def routes(self, x: NDArray[np.float64]) -> list[list[int]]:
        """The walk of every vehicle through the arcs of a solution (Hierholzer)."""
        out: list[list[int]] = []
        for r in range(len(self.begin)):
            begun = np.argwhere(x[self.begin[r]] > 0.5).tolist()
            if not begun:
                out.append([])
                continue
            arcs: dict[int, list[tuple[int, int]]] = {}
            for i, h, e in np.argwhere(x[self.then[r]] > 0.5).tolist():
                arcs.setdefault(h, []).append((e, i))
            out.append([begun[0][0], *_walk(arcs, begun[0][1])])
        return out


def _walk(arcs: dict[int, list[tuple[int, int]]], at: int) -> list[int]:
    """Names of all arcs as one walk from a node on; arcs: from → (to, name). They must be connected and balanced."""
    trail: list[int] = []
    stack: list[tuple[int, int | None]] = [(at, None)]
    while stack:
        node, name = stack[-1]
        if arcs.get(node):
            stack.append(arcs[node].pop())
        else:
            stack.pop()
            if name is not None:
                trail.append(name)
    return trail[::-1]


def makespan(work: Work, nodes: int) -> Schedule:
    """The schedule of least makespan, found within so many nodes of branch and bound, or the best known with its bound.

    An order that no vehicle may take is in no sequence.
    """
    able = np.flatnonzero(work.may.any(axis=0))
    if len(able) < len(work.carry):
        part = makespan(Work(work.first[:, able], work.carry[able], work.back[:, able]), nodes)
        return replace(part, routes=tuple(tuple(int(able[i]) for i in route) for route in part.routes))
    known = insertion(work, ROUNDS)
    vehicles, orders, exits = len(work.first), len(work.carry), len(work.back)
    if known.makespan <= known.bound or vehicles * orders * exits * (exits + 1) > VARIABLES:
        return known
    program = _Program.of(vehicles, orders, exits)
    found = program.solve(work, known.makespan, nodes)
    bound = known.bound
    if found.status == 2:  # nothing below what is known, which is rounded by nothing
        bound = known.makespan
    elif found.mip_dual_bound is not None and np.isfinite(found.mip_dual_bound):
        bound = max(bound, int(np.ceil(found.mip_dual_bound - 1e-4)))
    if found.x is None:
        return replace(known, bound=min(bound, known.makespan), nodes=_nodes(found))
    routes: Sequence[Sequence[int]] = program.routes(found.x)
    best = schedule_of(work, routes, bound, _nodes(found))
    if best.makespan > known.makespan:
        best = replace(known, bound=min(bound, known.makespan), nodes=best.nodes)
    # the program asks nothing of vehicles that aren't the last: local search shortens their sequences
    shorter = insertion(work, ROUNDS, best)
    return replace(shorter, bound=min(bound, shorter.makespan), nodes=best.nodes)


def _nodes(found: Any) -> int:
    return int(found.mip_node_count or 0)


@dataclass(frozen=True)
class Makespan:
    """look: oldest open orders considered · nodes: of branch and bound at each decision."""

    charging: ChargingPolicy
    look: int = 8
    nodes: int = 50

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher."""
        return give_first(view, free, self.charging, self.look, lambda work: makespan(work, self.nodes))
