"""Batteries as tables: what the compiled step needs to turn millijoules into charge.

Charge is integer millicoulombs; voltage is derived from it. A battery model is one function that fills a table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.units import J_PER_WH

POINTS = 1001
"""Samples of a table over the state of charge from 0 to 1."""


@dataclass(frozen=True, slots=True)
class Battery:
    """capacity_mc: full charge in millicoulombs · voltage_mv: (POINTS,) terminal voltage over the state of charge."""

    capacity_mc: int
    voltage_mv: NDArray[np.int64]


def linear(capacity_wh: float, voltage_v: float) -> Battery:
    """Thesis battery: the state of charge falls and rises in proportion to energy (one volt, so mC equal mJ)."""
    return Battery(round(capacity_wh * J_PER_WH * 1000), np.full(POINTS, 1000, np.int64))


def coulomb(capacity_wh: float, voltage_v: float) -> Battery:
    """Coulomb counting at the nominal voltage."""
    millivolt = round(voltage_v * 1000)
    return Battery(round(capacity_wh * J_PER_WH * 1e6 / millivolt), np.full(POINTS, millivolt, np.int64))
