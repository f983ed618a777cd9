"""Improved A* (the second baseline of Lian et al. 2024): least distance, and of those ways the one that turns least.

The paper's baseline smooths turns after the search ([25], not printed); on a network of fixed arcs that is to choose
among equally short ways by their turns, which is done exactly here. Promise: least (metres, turns) on an empty floor,
legal by the shared timer. Cost: one A* per leg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Memory, Promise, View
from engine.planners.routing import lengths_of, route_legs, turns_of
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]

MM = 2**16
"""A millimetre outweighs all the degrees that a route turns."""


@dataclass(frozen=True)
class AStarTurns:
    """No parameters."""

    promise = Promise(
        summary="the shortest route in metres that turns least, made safe by waiting",
        optimal="in distance, then turns, on an empty floor",
        occupancies=frozenset({Occupancy.HOLD}),
    )

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Costs of the edges."""
        return {"cost": lengths_of(graph) * MM + turns_of(graph)}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        tables = view.search.by_edge("turns", 0, memory["cost"])
        return route_legs(view, memory["cost"], tables), memory
