"""Batteries as tables: what the compiled step needs to turn millijoules into charge, and to know how fast it may fill.

Charge is integer millicoulombs and a battery's whole memory, so changing a battery is setting a number. Voltage and the
power that it accepts are derived from charge. A model is a function of a scenario's `[battery]` that returns a Battery:
its first two arguments are capacity_wh and voltage_v, all others are keywords that `battery.parameters` may set.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, ScenarioError, unknown_name
from engine.units import J_PER_WH

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

POINTS = 1001
"""Samples of a table over the state of charge from 0 to 1; sample i holds from i/(POINTS-1) to the next."""

BATTERIES: dict[str, str] = {
    "coulomb": "engine.energy.battery:coulomb",
    "linear": "engine.energy.battery:linear",
    "tremblay": "engine.energy.tremblay:tremblay",
}
"""Battery models by name."""


def _any_power() -> F64:
    return np.full(POINTS, np.inf)


@dataclass(frozen=True)
class Battery:
    """A battery over its state of charge. Raises BadInput on tables that could stop the step.

    capacity_mc: full charge in millicoulombs · voltage_mv: (POINTS,) terminal voltage, at least 1 mV
    · accept_w: (POINTS,) most power that may flow in: falling where a charger holds the voltage (CC-CV), infinite where
    the charger alone decides.
    """

    capacity_mc: int
    voltage_mv: I64
    accept_w: F64 = field(default_factory=_any_power)

    def __post_init__(self) -> None:
        for name in ("voltage_mv", "accept_w"):
            table = getattr(self, name)
            if table.shape != (POINTS,) or not (table >= (1 if name == "voltage_mv" else 1e-3)).all():
                raise BadInput(f"a battery's {name} must be {POINTS} positive numbers; got {table.shape}")
        if self.capacity_mc < 1:
            raise BadInput(f"a battery's capacity_mc must be positive; got {self.capacity_mc}")

    @cached_property
    def below_mv(self) -> I64:
        """(POINTS,) sum of the voltages of all samples before each one."""
        return np.concatenate([[0], np.cumsum(self.voltage_mv[:-1], dtype=np.int64)])

    def energy_mj(self, charge_mc: Any) -> Any:
        """Energy in mJ down to empty, of a charge or an array of charges: the integral of the voltage."""
        last = POINTS - 1
        at = np.minimum(np.maximum(charge_mc, 0) * last // self.capacity_mc, last)
        over = np.maximum(charge_mc, 0) * last - at * self.capacity_mc
        return (self.below_mv[at] * self.capacity_mc + self.voltage_mv[at] * over) // (1000 * last)

    def energy_of(self, charge_mc: int) -> int:
        """The same of one charge."""
        last, charge_mc = POINTS - 1, max(charge_mc, 0)
        at = min(charge_mc * last // self.capacity_mc, last)
        over = charge_mc * last - at * self.capacity_mc
        return (int(self.below_mv[at]) * self.capacity_mc + int(self.voltage_mv[at]) * over) // (1000 * last)

    def accept_mj(self, tick_s: float) -> I64:
        """(POINTS,) most energy in mJ that may flow in per tick."""
        return np.minimum(np.maximum(self.accept_w * tick_s * 1000, 1), 2.0**60).astype(np.int64)


def battery_of(
    model: str, capacity_wh: float, voltage_v: float, parameters: Mapping[str, float] | None = None
) -> Battery:
    """The battery of a scenario. Raises ScenarioError on unknown models and parameters, with the nearest name."""
    if model not in BATTERIES:
        raise ScenarioError(unknown_name("battery model", model, BATTERIES))
    module, _, name = BATTERIES[model].partition(":")
    make: Callable[..., Battery] = getattr(import_module(module), name)
    known = list(inspect.signature(make).parameters)[2:]
    for parameter in parameters or {}:
        if parameter not in known:
            raise ScenarioError(unknown_name(f"parameter of battery model {model!r}", parameter, known))
    return make(capacity_wh, voltage_v, **(parameters or {}))


def linear(capacity_wh: float, voltage_v: float) -> Battery:
    """Thesis battery: the state of charge falls and rises in proportion to energy (one volt, so mC equal mJ)."""
    return Battery(round(capacity_wh * J_PER_WH * 1000), np.full(POINTS, 1000, np.int64))


def coulomb(capacity_wh: float, voltage_v: float) -> Battery:
    """Coulomb counting at the nominal voltage."""
    millivolt = round(voltage_v * 1000)
    return Battery(round(capacity_wh * J_PER_WH * 1e6 / millivolt), np.full(POINTS, millivolt, np.int64))
