"""Energy: demand (motion → joules by component), battery (joules → charge), cited parameters."""

from engine.energy.battery import Battery, battery_of
from engine.energy.demand import CostTable, DemandModel, cost_table, parameters_over

__all__ = ["Battery", "CostTable", "DemandModel", "battery_of", "cost_table", "parameters_over"]
