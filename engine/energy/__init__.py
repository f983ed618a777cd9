"""Energy: demand (motion → joules by component), battery (joules → charge), cited parameters."""

from engine.energy.battery import Battery
from engine.energy.demand import CostTable, DemandModel, cost_table, parameters_over

__all__ = ["Battery", "CostTable", "DemandModel", "cost_table", "parameters_over"]
