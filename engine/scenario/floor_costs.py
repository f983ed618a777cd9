"""Energy costs of vehicles on an instance, where no scenario file gives them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from engine.energy import CostTable, cost_table, parameter_sets, parameters_over
from engine.energy.xu2025 import Xu2025
from engine.world.motion_graph import MotionGraph


def xu2025_costs(
    graph: MotionGraph,
    masses_kg: Sequence[float] = (1000.0,),
    parameters: Mapping[str, float] | None = None,
    tick_s: float = 1.0,
) -> CostTable:
    """Cost table with one class per mass by Xu & Wang 2025, whose default parameters `parameters` overrides."""
    numbers = parameters_over(parameter_sets.xu2025(), parameters or {}, "xu2025")
    return cost_table(graph.primitives, Xu2025(**numbers), [(mass, 0.0) for mass in masses_kg], tick_s)
