"""EEA*: A* on energy.

Source: Xu & Wang 2025. Default: exact. A state is (cell, heading, rolling or standing); waits keep the heading, and a
reversal stops, turns twice and starts again; complete and optimal. As printed, selectable for comparison:

`literal-cell`, `literal-cell-time`: a node is a cell, or a cell at a time; not optimal, for the next increment depends
on the heading (3×3 counterexample: 1643.2 J against 1432.9 J).
`reversal = "straight"`: a half turn costs what a straight cell costs (eq. 12's cross product can't tell them apart).
`restart = "straight"`: after a wait any direction is straight, so that wait and start can avoid a turn.

Heuristics: `table`, exact cost to go by one backward search per goal; `closed`, admissible and consistent; `paper`
(eq. 11), admissible only while a turn costs no less than a straight cell; `zero`, Dijkstra. Cost: about 150 ns per
expansion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.errors import ScenarioError, unknown_name
from engine.planners.kernels import single
from engine.planners.single import STATUS, Floor, Way, columns
from engine.types import PlanStatus

I64 = NDArray[np.int64]

VARIANTS = ("exact", "literal-cell", "literal-cell-time")
HEURISTICS = ("table", "closed", "paper", "zero")
RULES = ("cost", "straight")


@dataclass(frozen=True, slots=True)
class Eea:
    """variant: one of VARIANTS · heuristic: one of HEURISTICS · tie: `fifo` or `lifo` among equal f

    · reversal, restart: `cost` charges what they cost, `straight` counts them as straight
    · increments: False counts every energy anew from the start (the paper's slow form, same answers).
    """

    variant: str = "exact"
    heuristic: str = "table"
    tie: str = "lifo"
    reversal: str = "cost"
    restart: str = "cost"
    increments: bool = True

    def __post_init__(self) -> None:
        for what, name, known in (
            ("variant", self.variant, VARIANTS),
            ("heuristic", self.heuristic, HEURISTICS),
            ("tie rule", self.tie, ("fifo", "lifo")),
            ("reversal rule", self.reversal, RULES),
            ("restart rule", self.restart, RULES),
        ):
            if name not in known:
                raise ScenarioError(unknown_name(what, name, known))

    def mj(self, floor: Floor, cls: int = 0) -> I64:
        """Energy of each primitive under the rules, standby included."""
        cost, kind = floor.mj(cls).copy(), floor.kinds
        if self.restart == "straight":
            for name in ("start turn", "start reverse"):
                cost[kind[name]] = cost[kind["start straight"]]
        if self.reversal == "straight":
            cost[kind["reverse"]] = cost[kind["straight"]]
            cost[kind["start reverse"]] = cost[kind["start straight"]]
        return cost

    def bounds(self, cost: I64, standby: int, kinds: dict[str, int]) -> single.Closed:
        """What the heuristic counts per cell, turn, reversal and start, where it is no table."""
        if self.heuristic == "closed":
            return closed(with_waits(cost, standby, kinds), kinds)
        return single.Closed(0, 0, 0, 0) if self.heuristic == "zero" else paper(cost, kinds)

    def search(
        self, floor: Floor, start: int, goal: int, *, cls: int = 0, heading: int | None = None, trace: bool = False,
        limit: int = 2**62,
    ) -> Way:  # fmt: skip
        """A way of least energy between two places; cost in mJ. heading: index at the start, the best by default.

        Trace: nodes are states, g, h and f mJ.
        """
        net = floor.net
        if floor.blocked[start] or floor.blocked[goal]:
            return Way(PlanStatus.NO_PATH, np.zeros(0, np.int32), -1, 0)
        cost, standby = self.mj(floor, cls), int(floor.costs.standby_mj[cls])
        starts = floor.headings(start)
        if heading is not None:
            starts = starts[heading : heading + 1]
        table = (
            floor.table(goal, with_waits(cost, standby, floor.kinds))
            if self.heuristic == "table"
            else np.zeros(0, np.int64)
        )
        bounds = self.bounds(cost, standby, floor.kinds)
        most = floor.graph.n_states * (64 if self.variant == "literal-cell-time" else 1)
        rows = single.new_trace(min(most, 1_000_000) if trace else 0)
        out = np.zeros(4, np.int64)
        if self.variant != "exact":
            return self._literal(floor, starts, goal, cost, standby, bounds, table, rows, out, limit)
        waits, reverse = may_pay(cost, standby, floor.kinds)
        work = floor.state_work or single.new_state_work(floor.graph.n_states, 4 * floor.graph.n_states + 1024)
        while True:
            floor.state_work = work
            status = single.eea(
                net, work, floor.blocked, cost, standby, waits, reverse, not self.increments, starts,
                goal, bounds, table, self.tie == "lifo", limit, rows, out,
            )  # fmt: skip
            if status != single.FULL:
                break
            work = single.new_state_work(floor.graph.n_states, 2 * len(work.item), 4 * len(work.key))
        kept = columns(rows, int(out[3]))
        if status != single.SOLVED:
            return Way(STATUS[status], np.zeros(0, np.int32), -1, int(out[2]), kept)
        states = []
        at = int(out[0])
        while True:
            states.append(at)
            by = int(work.came[at])
            if by == -1:
                break
            at = int(net.edge_from[by]) if by >= 0 else -2 - by
        path = np.array(states[::-1], np.int32)
        return Way(PlanStatus.SOLVED, path, int(out[1]), int(out[2]), kept)

    def _literal(
        self, floor: Floor, starts: NDArray[np.int32], goal: int, cost: I64, standby: int, bounds: single.Closed,
        table: I64, rows: single.Trace, out: I64, limit: int,
    ) -> Way:  # fmt: skip
        n = floor.graph.n_places
        steps = np.full(n + 1, -1, np.int32)
        single.steps_to(floor.back, goal, steps, np.zeros(n, np.int32))
        if steps[starts[0] >> floor.net.shift] < 0:  # time would go on for ever
            return Way(PlanStatus.NO_PATH, np.zeros(0, np.int32), -1, 0)
        layers = 1 if self.variant == "literal-cell" else 256
        while True:
            size = layers * n
            best, came, state = np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(size, np.int32)
            status = single.eea_literal(
                floor.net, floor.blocked, cost, standby, layers, starts, goal, bounds, table, self.tie == "lifo",
                limit, best, came, state, rows, out,
            )  # fmt: skip
            if status != single.FULL:
                break
            if size > 1 << 24:
                status = single.BUDGET
                break
            layers *= 4
        kept = columns(rows, int(out[3]))
        if status != single.SOLVED:
            return Way(STATUS[status], np.zeros(0, np.int32), -1, int(out[2]), kept)
        places = []
        at = int(out[0])
        while at >= 0:
            places.append(at % n)
            at = int(came[at])
        way = np.array(places[::-1], np.int32)
        begin = int(starts[0]) if len(starts) == 1 else None
        return Way(PlanStatus.SOLVED, floor.along(way, begin), int(out[1]), int(out[2]), kept)


def with_waits(cost: I64, standby: int, kind: dict[str, int]) -> I64:
    """Energy of each primitive when standing before it is free to choose, but for its standby."""
    least = cost.copy()
    for name in ("straight", "turn", "reverse"):
        least[kind[name]] = min(int(cost[kind[name]]), standby + int(cost[kind[f"start {name}"]]))
    return least


def closed(cost: I64, kind: dict[str, int]) -> single.Closed:
    """Bounds of the consistent closed form from the costs of a 4-connected grid."""
    straight, turn, reverse = (int(cost[kind[name]]) for name in ("straight", "turn", "reverse"))
    cell = min(straight, turn, reverse)
    behind = max(0, min(turn, reverse) - cell)
    begin = [int(cost[kind["start straight"]]) - straight, int(cost[kind["start turn"]]) - turn]
    begin.append(int(cost[kind["start reverse"]]) - min(turn, reverse))
    return single.Closed(cell, max(0, turn - cell), behind, max(0, min(begin)))


def paper(cost: I64, kind: dict[str, int]) -> single.Closed:
    """Bounds of eq. 11: a straight cell for each one ahead, and nothing else."""
    return single.Closed(int(cost[kind["straight"]]), 0, 0, 0)


def may_pay(cost: I64, standby: int, kind: dict[str, int]) -> tuple[bool, int]:
    """Whether standing can pay on the way, and the kind of reversal that can't pay right after a motion, or -1."""
    names = ("straight", "turn", "reverse")
    waits = any(int(cost[kind[f"start {name}"]]) + standby < int(cost[kind[name]]) for name in names)
    there_and_back = int(cost[kind["straight"]]) + int(cost[kind["reverse"]])
    useless = all(
        int(cost[kind[f"{first}{name}"]])
        <= int(cost[kind[f"{first}straight"]]) - int(cost[kind["straight"]]) + there_and_back + int(cost[kind[other]])
        for first in ("", "start ")
        for name in names
        for other in names
    )
    return waits, kind["reverse"] if useless and not waits else -1
