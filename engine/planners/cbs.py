"""CBS: the least sum of arrival ticks of all vehicles.

Source: Sharon et al. 2015, with cardinal conflicts and bypass (Boyarski et al. 2015), disjoint splitting and
dependency heuristics (Li et al. 2019), target reasoning (Li et al. 2020). Promise: legal and optimal; complete on
solvable problems, without end on unsolvable ones, where the limits end it. Cost: a node per resolved conflict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.planners.constraint_tree import Settings, solve_tree
from engine.planners.kernels.cbs_low import lift
from engine.planners.oneshot import Limits, Problem, Solution, at_once
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class CBS:
    """w: proven factor of suboptimality · cover: heuristic of the tree, 0 none, 1 CG, 2 DG, 3 WDG · disjoint,
    cardinal, bypass, target: each changes the work, never the cost · tries: orders of prioritized planning
    for a first plan.
    """

    w: float = 1.0
    disjoint: bool = True
    cardinal: bool = True
    bypass: bool = True
    cover: int = 3
    target: bool = True
    tries: int = 2

    promise = at_once(
        "the least sum of arrival times, all vehicles at once", optimal="for the fleet, in time", complete=True,
        objectives=("time",), turnings=("arc", "pivot"),
    )  # fmt: skip

    def solve(self, problem: Problem, limits: Limits, *, trace: bool = False) -> Solution:
        """Least sum of ticks until each vehicle's last arrival."""
        settings = Settings(
            disjoint=self.disjoint, cardinal=self.cardinal, bypass=self.bypass, cover=self.cover, target=self.target,
            tries=self.tries, w=self.w,
        )  # fmt: skip
        found, on_places, ways = solve_tree(problem, limits, settings, energy=False, trace=trace)
        if not ways:
            return found
        if not on_places:
            return replace(found, states=tuple(ways))
        return replace(
            found, states=tuple(lifted(problem.graph, int(s), w) for s, w in zip(problem.starts, ways, strict=True))
        )


def lifted(graph: MotionGraph, start: int, places: I32) -> I32:
    """Motion states of a way given by places, from a standing start."""
    out = np.empty(len(places), np.int32)
    lift(graph.edge_ptr, graph.edge_to, graph.state_place, graph.stopped, start, places, out)
    return out
