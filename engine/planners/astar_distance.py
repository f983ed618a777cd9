"""Traditional A* on distance (the first baseline of Lian et al. 2024): turns and traffic cost nothing.

Source: Hart, Nilsson & Raphael 1968. Promise: a shortest route in metres, legal by the shared timer; among equally
short ones it doesn't choose, so it turns more often than it must. Cost: one A* per leg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Memory, Promise, View
from engine.planners.routing import lengths_of, route_legs
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]


@dataclass(frozen=True)
class AStarDistance:
    """No parameters."""

    promise = Promise(
        summary="the shortest route in metres, turns for nothing, made safe by waiting",
        optimal="in distance, on an empty floor",
        occupancies=frozenset({Occupancy.HOLD}),
    )

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Lengths of the edges."""
        return {"cost": lengths_of(graph)}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        tables = view.search.by_edge("distance", 0, memory["cost"])
        return route_legs(view, memory["cost"], tables), memory
