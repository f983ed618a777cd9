"""ECBS: the least total energy of all vehicles, in millijoules, with the exact state (place, heading, moving) below.

Source: E-CBS of xu2025 (section 1.1 of the specification) on CBS (Sharon et al. 2015) with disjoint splitting (Li et
al. 2019). Equation 14 gives every vehicle of a conflict a dynamic priority; the lower one is constrained first. Two
readings: the rule orders the branches (default; optimal), or only the lower vehicle is constrained (`priority_branch`;
incomplete, not optimal). Promise: legal; optimal in the default reading with w = 1, else within w of the proven bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from engine.planners.constraint_tree import Settings, solve_tree
from engine.planners.oneshot import Limits, Problem, Solution, at_once
from engine.planners.time_window import TimeWindow
from engine.types import PlanStatus


@dataclass(frozen=True, slots=True)
class ECBS:
    """w: proven factor of suboptimality · weights: w1, w2, w3 of eq. 14 (mass, way left, conflicts) · disjoint,
    cardinal, bypass, target, pairs (bounds from the optima of pairs): each changes the work, never the cost · tries:
    orders of prioritized planning for a first plan · repairs: times per vehicle that a part of it is planned anew.
    """

    w: float = 1.0
    priority_branch: bool = False
    weights: tuple[float, float, float] = (0.3, 0.3, 0.3)
    disjoint: bool = True
    cardinal: bool = True
    bypass: bool = True
    target: bool = True
    pairs: bool = True
    tries: int = 12
    repairs: int = 10

    promise = at_once(
        "the least energy of all vehicles together, all at once", optimal="for the fleet, in energy", complete=True,
        objectives=("energy",), turnings=("arc", "pivot"),
    )  # fmt: skip

    def solve(self, problem: Problem, limits: Limits, *, trace: bool = False) -> Solution:
        """Least energy; waiting before the last arrival counts, resting at the goal does not."""
        settings = Settings(
            disjoint=self.disjoint and not self.priority_branch, cardinal=self.cardinal, bypass=self.bypass,
            target=self.target, pairs=self.pairs and not self.priority_branch, branch=self.priority_branch,
            tries=0 if self.priority_branch else self.tries, repairs=self.repairs,
            w=self.w, weights=self.weights,
        )  # fmt: skip
        # a search that doesn't finish is never worse than time windows, which are laid early, before time is up
        aside: list[Solution] = []

        def lay_windows() -> None:
            if not aside and not self.priority_branch and serves_windows(problem):
                aside.append(TimeWindow().solve(problem, Limits(stop=limits.stop)))

        found, _, ways = solve_tree(problem, limits, settings, energy=True, trace=trace, later=lay_windows)
        found = replace(found, states=tuple(ways)) if ways else found
        if found.status is not PlanStatus.BUDGET_SPENT:
            return found
        lay_windows()
        windows = aside[0] if aside else found
        if not windows.states or (found.states and found.cost <= windows.cost):
            return found
        return replace(found, states=windows.states, cost=windows.cost, note="the plan is that of time windows")


def serves_windows(problem: Problem) -> bool:
    """Whether time windows can be laid over the floor: turns are driven, not made on the spot."""
    return not any(primitive.pivot for primitive in problem.graph.primitives)
