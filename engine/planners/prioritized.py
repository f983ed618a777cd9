"""Prioritized planning, one request after the other against all that is reserved.

Source: Silver 2005, Čáp et al. 2015 (revised prioritized planning on well-formed floors), Phillips & Likhachev 2011
(safe intervals). Promise: legal; complete for one vehicle against the reservations, optimal in time or in energy for
it; not optimal for the fleet. Because every plan ends where the vehicle may stand forever and endpoints are spurs, a
plan from rest always exists on a floor without faults. Cost: one SIPP search per request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.energy import CostTable
from engine.planners.base import Budget, Memory, Plan, Promise, View
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph


@dataclass(frozen=True)
class Prioritized:
    """objective: `time` (ties by energy, nearly always the least) or `energy` (ties by arrival)."""

    objective: str = "time"

    promise = Promise(
        summary="one vehicle after the other, each optimal against the reservations of those before",
        complete=False,
        optimal="per vehicle",
        objectives=("time", "energy"),
        occupancies=frozenset({Occupancy.HOLD, Occupancy.MAPF}),
    )

    def __post_init__(self) -> None:
        if self.objective not in self.promise.objectives:
            raise ValueError(f"objective must be 'time' or 'energy'; got {self.objective!r}")

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """No memory beside the search space, which is derived."""
        return {}

    def plan(self, view: View, memory: Memory, budget: Budget) -> tuple[Plan, Memory]:
        """The best plan for the view's request."""
        return view.search.through(view, self.objective, budget), memory
