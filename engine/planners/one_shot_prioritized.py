"""Prioritized planning, all at once: one vehicle after the other, each optimal against those before it.

Source: Erdmann & Lozano-Pérez 1987, Silver 2005; best of many orders. Legal; neither complete nor optimal. When a
vehicle finds no way it is moved to the front of the order, and planning begins again. Cost: one space-time search per
vehicle and pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.errors import ScenarioError, unknown_name
from engine.planners.kernels import spacetime
from engine.planners.kernels.single import steps_to
from engine.planners.kernels.tables import FAR
from engine.planners.oneshot import Limits, Problem, Solution, at_once
from engine.planners.single import Floor
from engine.types import PlanStatus

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

MOST_TICKS = 1 << 20
"""A way longer than this counts as none."""


@dataclass(frozen=True, slots=True)
class OneShotPrioritized:
    """objective: `time` (ticks) or `energy` (mJ) · order: of the first pass, `given`, `random`, or `longest` way first

    · passes: orders tried, the best is kept; all but the first are random · mend: how often a pass may begin again with
    the vehicle that found no way in front.
    """

    objective: str = "time"
    order: str = "given"
    passes: int = 1
    mend: int = 100
    seed: int = 0

    promise = at_once(
        "one vehicle after the other, each optimal against those before, all at once", optimal="per vehicle",
        objectives=("time", "energy"), turnings=("arc",),
    )  # fmt: skip

    def __post_init__(self) -> None:
        for what, name, known in (
            ("objective", self.objective, ("time", "energy")),
            ("order", self.order, ("given", "random", "longest")),
        ):
            if name not in known:
                raise ScenarioError(unknown_name(what, name, known))
        if self.passes < 1 or self.mend < 0:
            raise ScenarioError(f"passes ≥ 1 and mend ≥ 0 were expected, got {self.passes} and {self.mend}")

    def solve(self, problem: Problem, limits: Limits, *, trace: bool = False) -> Solution:
        """The best plan of its passes; the lower bound is what every vehicle would need alone."""
        desk = Desk(problem)
        n = len(problem.starts)
        alone = desk.alone(self.objective)
        if (alone < 0).any():
            who = np.nonzero(alone < 0)[0].tolist()
            return desk.none(PlanStatus.NO_PATH, f"vehicles {who} can't reach their goals")
        rng = np.random.default_rng(self.seed)
        best: list[I32] = []
        best_cost, low, tried = -1, 0, 0
        budget = False
        for number in range(self.passes):
            order = rng.permutation(n)
            if number == 0 and self.order != "random":
                order = np.arange(n) if self.order == "given" else np.argsort(-alone, kind="stable")
            for _ in range(self.mend + 1):
                if low >= limits.expansions or tried >= limits.nodes or limits.stop():
                    budget = True
                    break
                tried += 1
                states, cost, expanded, failed = desk.go(
                    self.objective, order.astype(np.int32), limits.expansions - low
                )
                low += expanded
                if failed < 0:
                    if best_cost < 0 or cost < best_cost:
                        best, best_cost = states, cost
                    break
                order = np.concatenate([[failed], order[order != failed]])
            if budget:
                break
        bound = int(alone.sum())
        if best_cost < 0:
            return desk.none(
                PlanStatus.BUDGET_SPENT, f"none of {tried} orders brings everybody to the goal", bound, tried, low
            )
        return Solution(PlanStatus.SOLVED, tuple(best), best_cost, bound, tried, low)


def prioritized_solve(problem: Problem, objective: str = "energy", passes: int = 24, seed: int = 0) -> Solution:
    """Best of many orders."""
    return OneShotPrioritized(objective, "longest", passes, 20, seed).solve(problem, Limits())


class Desk:
    """One problem's rooms and tables, used again from pass to pass."""

    def __init__(self, problem: Problem, floor: Floor | None = None):
        self.problem = problem
        self.floor = floor or Floor(problem.graph, problem.costs, problem.blocked)
        self.places = problem.graph.n_places
        self.ticks = 256
        self.mj = [self.floor.mj(c) for c in range(len(problem.costs.standby_mj))]
        self.taken = spacetime.new_taken(self.ticks, self.places)
        self.layers: spacetime.Layers | None = None
        self.nodes: spacetime.Nodes | None = None
        self._steps: tuple[I32, I32] | None = None

    def none(self, status: PlanStatus, note: str, bound: int = 0, high: int = 0, low: int = 0) -> Solution:
        """An answer without a plan."""
        return Solution(status, (), -1, bound, high, low, note)

    def steps(self) -> tuple[I32, I32]:
        """(rows, P+1) steps to every distinct goal, and the row of each vehicle."""
        if self._steps is None:
            distinct, row = np.unique(self.problem.goals, return_inverse=True)
            tables = np.empty((len(distinct), self.places + 1), np.int32)
            queue = np.zeros(self.places, np.int32)
            for i, goal in enumerate(distinct.tolist()):
                steps_to(self.floor.back, goal, tables[i], queue)
            self._steps = tables, row.astype(np.int32)
        return self._steps

    def energies(self, vehicle: int) -> I64:
        """Exact energy from every state to a vehicle's goal on the floor without blocks."""
        return self.floor.table(int(self.problem.goals[vehicle]), self.mj[int(self.problem.cls[vehicle])])

    def alone(self, objective: str) -> I64:
        """Cost of every vehicle if it were alone; -1 where there is no way. Energies ignore blocks: lower bounds."""
        p = self.problem
        tables, row = self.steps()
        ticks: I64 = tables[row, p.starts >> self.floor.net.shift].astype(np.int64)
        if objective == "time":
            return ticks
        mj = np.array([self.energies(a)[s] for a, s in enumerate(p.starts.tolist())], np.int64)
        mj[(ticks < 0) | (mj >= FAR)] = -1
        return mj

    def more_ticks(self) -> None:
        """Four times the room in time; forgets what was taken."""
        self.ticks *= 4
        self.taken = spacetime.new_taken(self.ticks, self.places)
        self.layers = None

    def go(self, objective: str, order: I32, limit: int) -> tuple[list[I32], int, int, int]:
        """One pass: (states, cost, expansions, the vehicle without a way or -1)."""
        return self._quick(order, limit) if objective == "time" else self._cheap(order, limit)

    def _quick(self, order: I32, limit: int) -> tuple[list[I32], int, int, int]:
        p, n = self.problem, len(order)
        tables, row = self.steps()
        starts = (p.starts >> self.floor.net.shift).astype(np.int32)
        while True:
            if self.layers is None:
                self.layers = spacetime.new_layers(self.ticks, self.places)
            ways, length, out = np.zeros((n, self.ticks), np.int32), np.zeros(n, np.int32), np.zeros(4, np.int64)
            status = spacetime.quickest_pass(
                self.floor.grounds.step, self.taken, p.blocked, self.layers, tables, row, starts, p.goals, order,
                limit, ways, length, out,
            )  # fmt: skip
            if status != spacetime.FULL or self.ticks >= MOST_TICKS:
                break
            self.more_ticks()
        spacetime.forget(self.taken, ways, length)
        if status != spacetime.SOLVED:
            return [], -1, int(out[1]), int(out[2])
        states = [self.floor.along(ways[a, : length[a]], int(p.starts[a])) for a in range(n)]
        return states, int(out[3]), int(out[1]), -1

    def _cheap(self, order: I32, limit: int) -> tuple[list[I32], int, int, int]:
        states: list[I32] = [np.zeros(0, np.int32)] * len(order)
        cost = low = 0
        failed = -1
        for a in order.tolist():
            found, mj, expanded = self.cheapest(a, limit - low)
            low += expanded
            if mj < 0:
                failed = a
                break
            states[a] = found
            cost += mj
            self.take(a, found, states)
        self.forget(states)
        return ([], -1, low, failed) if failed >= 0 else (states, cost, low, -1)

    def take(self, vehicle: int, states: I32, all_states: list[I32]) -> None:
        """Fix a vehicle's way; makes room first, and takes the others' ways anew."""
        if len(states) > self.ticks:
            while len(states) > self.ticks:
                self.ticks *= 2
            self.taken = spacetime.new_taken(self.ticks, self.places)
            for a, other in enumerate(all_states):
                if len(other) and a != vehicle:
                    spacetime.take(self.taken, a, other >> self.floor.net.shift, len(other))
        spacetime.take(self.taken, vehicle, states >> self.floor.net.shift, len(states))

    def forget(self, states: list[I32]) -> None:
        """Empty the floor."""
        for found in states:
            if len(found):
                spacetime.release(self.taken, found >> self.floor.net.shift, len(found))

    def cheapest(self, vehicle: int, limit: int) -> tuple[I32, int, int]:
        """Least energy of a vehicle among the ways taken: (states, mJ or -1, expansions)."""
        p = self.problem
        cls = int(p.cls[vehicle])
        table = self.energies(vehicle)
        out = np.zeros(4, np.int64)
        while True:
            if self.nodes is None:
                self.nodes = spacetime.new_nodes(1 << 14)
            room = np.zeros(self.ticks + 2 + p.graph.n_states, np.int32)
            status = spacetime.cheapest(
                self.floor.net, self.taken, p.blocked, self.nodes, table, self.mj[cls], int(p.costs.standby_mj[cls]),
                int(p.starts[vehicle]), int(p.goals[vehicle]), limit, room, out,
            )  # fmt: skip
            if status != spacetime.FULL:
                break
            if len(self.nodes.state) > 1 << 27:
                return np.zeros(0, np.int32), -1, int(out[1])
            self.nodes = spacetime.new_nodes(4 * len(self.nodes.state))
        if status != spacetime.SOLVED:
            return np.zeros(0, np.int32), -1, int(out[1])
        return room[: out[0]].copy(), int(out[2]), int(out[1])
