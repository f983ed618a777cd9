"""The contract of one-shot solvers: all vehicles at once, from their starts to their goals, where they rest.

Unit-duration graphs and the classical `mapf` occupancy. A solver is a frozen value whose fields are its parameters;
unsolvable and out of budget are answers, not exceptions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Promise
from engine.types import Occupancy, PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Problem:
    """n vehicles on a unit-duration graph.

    starts: (n,) motion states, standing · goals: (n,) places · cls: (n,) vehicle class of each, row of `costs` ·
    blocked: (P,) 1 where nobody may go.
    """

    graph: MotionGraph
    starts: I32
    goals: I32
    costs: CostTable
    cls: I32
    blocked: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Limits:
    """How much work a solver may do; `stop` is asked between chunks of work (an injected clock may live in it)."""

    nodes: int = 10_000_000
    expansions: int = 2_000_000_000
    stop: Callable[[], bool] = lambda: False


@dataclass(frozen=True, slots=True)
class Solution:
    """The answer.

    states: one (T_i + 1,) array of motion states per vehicle, by tick, up to its arrival for good (empty without a
    plan) · cost: in the solver's objective (ticks, or mJ; waiting before the last arrival counts, resting at the goal
    does not) · lower_bound: proven · trace: columns by table name when asked for.
    """

    status: PlanStatus
    states: tuple[I32, ...]
    cost: int
    lower_bound: int
    expanded_high: int
    expanded_low: int
    note: str = ""
    trace: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)


def at_once(
    summary: str, *, optimal: str = "", complete: bool = False, objectives: tuple[str, ...], turnings: tuple[str, ...]
) -> Promise:
    """The promise of a one-shot solver: unit motions, four neighbours, the classical occupancy."""
    return Promise(
        summary=summary, complete=complete, optimal=optimal, occupancies=frozenset({Occupancy.MAPF}),
        objectives=objectives, mode=frozenset({"one-shot"}), connectivity=frozenset({4}),
        turnings=frozenset(turnings), unit=True,
    )  # fmt: skip


class Solver(Protocol):
    """Solves whole problems."""

    promise: Promise

    def solve(self, problem: Problem, limits: Limits, *, trace: bool = False) -> Solution:
        """The best plan it can find within the limits."""
        ...
