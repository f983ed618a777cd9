"""Anytime Dynamic A* (Likhachev et al. 2005) on a terrain's lattice: a way soon, better ways later, repaired on change.

Searches backward from the goal with OPEN, CLOSED and INCONS. A first way is found with the heuristic inflated by ε0;
each further pass lowers ε until it is 1 and the way is the cheapest there is. What a pass publishes costs at most ε
times the least. When costs change, the states that they touch become inconsistent and are worked through; when the
robot moves, only the keys change. Cost per expansion: the predecessors of one state, a logarithm of OPEN each.

Promise: legal on the map it is given, complete, optimal at ε = 1. The paper's listing is not followed: it mixes a
backward start (rhs(goal) = 0) with forward costs (16), puts the start, which is consistent, into OPEN, initialises
everything again on every change, and never lowers ε. Two of its traits can be had to see what they do: `anew` searches
from nothing on every change, `printed_h` uses the heuristic (17), whose height term has the wrong sign, so that
it overestimates ways down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, InvariantBroken
from engine.planners.base import Promise, Route
from engine.planners.kernels import adstar as kernel
from engine.types import Occupancy, PlanStatus

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
HEADINGS = kernel.HEADINGS
EXACT = 1000
"""ε is counted in thousandths."""
SHADE = 1 - 1e-7
"""Rounding of the last bit never lifts the heuristic above a cost."""


@dataclass(frozen=True, slots=True)
class Heuristic:
    """Least cost between two points of the ground, consistent: A per metre and B per metre of rise.

    form: `space` A·distance · `climb` A·distance + B·max(0, rise) · `slope` max(0, A·distance in the plane + B·rise)
    · `printed` A·distance - B·rise, equation (17). In millijoules or millimetres.
    """

    form: str
    per_m: float
    per_rise_m: float = 0.0

    FORMS = ("space", "climb", "slope", "printed")


@dataclass(frozen=True, slots=True)
class AdStar:
    """Parameters. epsilon: of the first pass · step: by which it is lowered · share: when a change touches more than
    this share of the states seen so far, planning anew is cheaper than repairing · per_tick: expansions while a robot
    drives · anew, printed_h: the paper's."""

    epsilon: float = 2.5
    step: float = 0.5
    share: float = 0.5
    per_tick: int = 20_000
    anew: bool = False
    printed_h: bool = False

    promise = Promise(
        "AD*: a way at once, better ones while there is time, repaired when the ground turns out otherwise",
        complete=True,
        optimal="distance or energy, once ε is 1",
        occupancies=frozenset({Occupancy.HOLD}),
        objectives=("energy", "distance"),
        mode=frozenset({"anytime"}),
    )

    def __post_init__(self) -> None:
        if not 1 <= self.epsilon <= 10 or self.step <= 0 or not 0 <= self.share <= 1 or self.per_tick < 1:
            raise BadInput(
                f"got epsilon {self.epsilon:g}, step {self.step:g}, share {self.share:g}, per_tick "
                f"{self.per_tick}; expected epsilon from 1 to 10, step above 0, share from 0 to 1, per_tick above 0"
            )


class Search:
    """A search under way over a cost table that belongs to somebody else, who says when it changes (`changed`).

    end, from_heading, from_k: of the cluster · height: (H, W) · cost: (S, K), kernel.INF where there is no way. Heights
    and costs are read, never written, and must not be replaced.
    """

    def __init__(
        self,
        options: AdStar,
        end: I32,
        from_heading: I32,
        from_k: I32,
        height: F32,
        cost: I32,
        cell_m: float,
        heuristic: Heuristic,
        start: int,
        goal_cell: int,
        facing: int = -1,
    ) -> None:
        states = len(cost)
        if not (0 <= start < states and 0 <= goal_cell < states // HEADINGS and -1 <= facing < HEADINGS):
            raise BadInput(f"start {start}, goal {goal_cell} or heading {facing} lies outside the lattice")
        self.options = options
        if options.printed_h:
            heuristic = Heuristic("printed", heuristic.per_m, heuristic.per_rise_m)
        weight = np.array([heuristic.per_m * SHADE, heuristic.per_rise_m * SHADE, cell_m])
        self.lattice = kernel.Lattice(end, from_heading, from_k, height, cost, weight)
        self.now = np.zeros(kernel.FIELDS, np.int64)
        self.now[kernel.GOAL], self.now[kernel.FACING] = goal_cell, facing
        self._stand(start, height.shape[1])
        self.now[kernel.FORM] = Heuristic.FORMS.index(heuristic.form)
        self.node = np.empty((states, 4), np.int64)
        self.open = kernel.Open(
            self.node, np.empty(states + 65536, np.int64), np.empty(states + 65536, np.int32),
            np.empty(states, np.int32), self.now,
        )  # fmt: skip
        self.solved = False  # the present pass is done
        self.restart()

    def _stand(self, start: int, columns: int) -> None:
        self.now[kernel.START] = start
        self.now[kernel.START_Y], self.now[kernel.START_X] = divmod(start // HEADINGS, columns)

    @property
    def epsilon(self) -> float:
        """Inflation of the present pass."""
        return int(self.now[kernel.EPS]) / EXACT

    @property
    def start(self) -> int:
        return int(self.now[kernel.START])

    @property
    def expanded(self) -> int:
        """States expanded since the beginning."""
        return int(self.now[kernel.ALL])

    @property
    def optimal(self) -> bool:
        """True when there is nothing left to do until something changes."""
        return self.solved and self.epsilon == 1

    @property
    def begun(self) -> int:
        """Searches from nothing, the first among them."""
        return int(self.now[kernel.BEGUN])

    def settled(self) -> tuple[I64, I64]:
        """(S,) present costs to the goal, kernel.INF where unknown; and the pass in which they were last lowered, 0 for
        none. Whatever is expanded changes one of them, so that two moments tell the states between."""
        return self.node[:, kernel.G].copy(), self.node[:, kernel.WORD] >> kernel.PASS

    def frontier(self) -> tuple[I32, I32]:
        """States in OPEN and in INCONS, each once, ascending."""
        size, held = int(self.now[kernel.SIZE]), int(self.now[kernel.HELD])
        waiting, later = self.open.items[:size], self.open.incons[:held]
        counts = self.node[waiting, kernel.KEY] == self.open.keys[:size]
        return np.unique(waiting[counts]), np.unique(later[(self.node[later, kernel.WORD] & kernel.IN_INCONS) > 0])

    def restart(self, epsilon: float | None = None) -> None:
        """Plan anew."""
        self.now[kernel.EPS] = round(EXACT * (self.options.epsilon if epsilon is None else epsilon))
        kernel.begin(self.lattice, self.open)
        self.solved = False

    def work(self, budget: int) -> Route | None:
        """Expand at most so many states; the way when a pass is done with that, else None.

        Called again after that, it lowers ε and begins the next pass.
        """
        if self.optimal:
            return None
        if self.solved:
            self.now[kernel.EPS] = max(EXACT, self.now[kernel.EPS] - round(EXACT * self.options.step))
            kernel.next_pass(self.lattice, self.open, True)
            self.solved = False
        begun = self.expanded
        while True:
            said = kernel.compute(self.lattice, self.open, budget - (self.expanded - begun))
            if said != kernel.FULL:
                break
            kernel.compact(self.lattice, self.open, False)
        if said == kernel.MORE:
            return None
        self.solved = True
        return self.route()

    def best(self) -> Route:
        """The cheapest way, however long that takes."""
        route = self.work(2**62)
        while (better := self.work(2**62)) is not None:
            route = better
        return route if route is not None else self.route()

    def route(self) -> Route:
        """The way that the present pass has found."""
        cost = int(self.node[self.start, kernel.RHS])
        none = np.zeros(0, np.int32)
        if cost >= kernel.INF:
            return Route(PlanStatus.NO_PATH, none, none, kernel.INF, 1.0, self.expanded)
        states, ks = np.empty(len(self.node) // 8 + 2, np.int32), np.empty(len(self.node) // 8 + 1, np.int32)
        n = kernel.way(self.lattice, self.open, states, ks)
        if n < 0:
            raise InvariantBroken("the best trajectories do not lead to the goal")
        status = PlanStatus.SOLVED if self.epsilon == 1 else PlanStatus.BOUNDED
        driven = int(self.lattice.cost[states[:n], ks[:n]].astype(np.int64).sum())
        return Route(status, states[: n + 1].copy(), ks[:n].copy(), driven, self.epsilon, self.expanded)

    def move(self, start: int) -> None:
        """The robot is, or will be, at another state; a heuristic towards it may be less by what it has moved."""
        if start == self.start:
            return
        xa, ya = self.now[[kernel.START_X, kernel.START_Y]].tolist()
        self._stand(start, self.lattice.height.shape[1])
        xb, yb = self.now[[kernel.START_X, kernel.START_Y]].tolist()
        ahead = kernel.between(self.lattice, int(self.now[kernel.FORM]), xa, ya, xb, yb)
        self.now[kernel.LEAD] += math.ceil((ahead + 1) * int(self.now[kernel.EPS]) / EXACT)
        self.solved = False

    def changed(self, states: I32, heights: bool = False, epsilon: float | None = None) -> None:
        """Costs from these states, or the heights of their cells, have changed; heights: all may have, the start's too.

        Begins a pass with the present ε, or another one, or plans anew where that is cheaper.
        """
        if epsilon is not None:
            self.now[kernel.EPS] = round(EXACT * epsilon)
        if len(states) == 0 and not heights and epsilon is None:
            return
        if self.options.anew or self._much(states):
            self.restart(self.epsilon if self.options.anew else None)
            return
        kernel.next_pass(self.lattice, self.open, heights or epsilon is not None)
        kernel.touch(self.lattice, self.open, states)
        self.solved = False

    def touched(self, states: I32) -> float:
        """Which share of the states seen so far these are."""
        among = int((self.node[states, kernel.RHS] < kernel.INF).sum())
        return among / max(int((self.node[:, kernel.RHS] < kernel.INF).sum()), 1)

    def _much(self, states: I32) -> bool:
        """True when so many of the states seen so far are touched that a new search is cheaper than repair."""
        return self.options.share < 1 and self.touched(states) > self.options.share

    def retarget(self, goal_cell: int) -> None:
        """Plan anew to another cell."""
        self.now[kernel.GOAL], self.now[kernel.FACING] = goal_cell, -1
        self.restart()

    def to_memory(self) -> dict[str, Any]:
        """Named arrays from which `restore` goes on; only what has been seen."""
        size, held = int(self.now[kernel.SIZE]), int(self.now[kernel.HELD])
        rows = self.node
        seen = np.flatnonzero((rows[:, :2] < kernel.INF).any(1) | (rows[:, kernel.WORD] != kernel.NO_K)).astype(
            np.int32
        )
        return {
            "now": self.now.copy(),
            "solved": np.array([self.solved], np.int8),
            "seen": seen,
            "rows": rows[seen],
            "keys": self.open.keys[:size].copy(),
            "items": self.open.items[:size].copy(),
            "incons": self.open.incons[:held].copy(),
        }

    def restore(self, memory: dict[str, Any]) -> None:
        """Undo `to_memory`."""
        kernel.forget(self.open)
        self.now[:] = memory["now"]
        self.solved = bool(memory["solved"][0])
        self.node[memory["seen"]] = memory["rows"]
        self.open.keys[: len(memory["keys"])] = memory["keys"]
        self.open.items[: len(memory["items"])] = memory["items"]
        self.open.incons[: len(memory["incons"])] = memory["incons"]
