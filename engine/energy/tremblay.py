"""Lithium battery after Tremblay & Dessaint 2009 (Shepherd's discharge curve), fitted to figure 2 of Lian et al. 2024.

V = E0 − K·Q/(Q − q)·(q + i*) + A·e^(−B·q) − R·i, with q the charge taken in Ah and i* the current, low-passed. At 8 A
the curve has the figure's three zones: 0–2.5, 2.5–49 and 49–50 min. The paper prints no voltages: the anchors are
assumed. Rated are 6 Ah; 50 min at 8 A deliver 6.667 Ah. Neither stands for the other here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.energy.battery import POINTS, Battery
from engine.errors import ScenarioError

F64 = NDArray[np.float64]

CELL_V = 3.7
"""Nominal voltage of a cell."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Parameters of one cell; charges in Ah. stable: between these charges taken, voltage tells the state of charge."""

    e0_v: float = 3.7022
    k_v: float = 5.4e-4
    a_v: float = 0.3935
    b_per_ah: float = 1.0
    r_ohm: float = 0.01213
    q_ah: float = 6.729
    rated_ah: float = 6.0
    usable_ah: float = 6.667
    test_a: float = 8.0
    stable_ah: tuple[float, float] = (0.333, 6.53)

    def voltage_v(self, taken_ah: float, current_a: float, slow_a: float | None = None) -> float:
        """Terminal voltage while a current is drawn (positive) or charged (negative); slow_a: i*, else the current."""
        q, i, slow = taken_ah, current_a, current_a if slow_a is None else slow_a
        fall = self.k_v * self.q_ah / (self.q_ah - q)
        # while charging, the polarisation term falls with the charge that is still missing
        polarised = fall * slow if slow >= 0 else self.k_v * self.q_ah / (q + 0.1 * self.q_ah) * slow
        return self.e0_v - fall * q - polarised + self.a_v * math.exp(-self.b_per_ah * q) - self.r_ohm * i

    def taken_from_voltage(self, voltage_v: float, current_a: float) -> float:
        """Charge taken at a voltage under a current, by bisection, clamped to the stable zone."""
        low, high = self.stable_ah
        if voltage_v >= self.voltage_v(low, current_a):
            return low
        if voltage_v <= self.voltage_v(high, current_a):
            return high
        for _ in range(60):
            middle = (low + high) / 2
            if self.voltage_v(middle, current_a) > voltage_v:
                low = middle
            else:
                high = middle
        return (low + high) / 2

    def soc_by_counting(self, taken_ah: float) -> float:
        """State of charge by counting what was taken, of what the cell delivers."""
        return 1 - taken_ah / self.usable_ah

    def soc_by_voltage(self, voltage_v: float, current_a: float) -> float:
        """State of charge by inverting the discharge curve; only the stable zone is told apart."""
        return self.soc_by_counting(self.taken_from_voltage(voltage_v, current_a))

    def discharge(self, current_a: float, dt_s: float = 1.0, cut_v: float = 2.75) -> tuple[F64, F64, F64]:
        """(seconds, volts, Ah taken) from full at a constant current until the cut-off voltage."""
        hours = np.arange(0.0, self.q_ah / current_a, dt_s / 3600)
        taken = current_a * hours
        volts = np.array([self.voltage_v(q, current_a) for q in taken.tolist()])
        n = int(np.argmax(volts < cut_v)) or len(volts)
        return hours[:n] * 3600, volts[:n], taken[:n]

    def cc_cv(
        self, taken_ah: float, current_a: float = 3.0, top_v: float = 4.2, until_a: float = 0.3, dt_s: float = 1.0
    ) -> tuple[F64, F64, F64, F64]:
        """(seconds, volts, amperes, Ah taken) of a charge at constant current, then at constant voltage."""
        rows: list[tuple[float, float, float, float]] = []
        q, t, amps = taken_ah, 0.0, current_a
        while q > 0 and amps > until_a and len(rows) < 200_000:
            amps = min(amps, self._amps_at(q, top_v, current_a))
            rows.append((t, self.voltage_v(q, -amps), amps, q))
            q -= amps * dt_s / 3600
            t += dt_s
        t_s, volts, current, left = np.array(rows).reshape(-1, 4).T
        return t_s, volts, current, left

    def _amps_at(self, q: float, top_v: float, most_a: float) -> float:
        """Charging current that keeps the terminals at a voltage, at most so many amperes."""
        if self.voltage_v(q, -most_a) <= top_v:
            return most_a
        rest = self.voltage_v(q, 0.0)
        slope = (self.voltage_v(q, -most_a) - rest) / most_a
        return max((top_v - rest) / slope, 0.0)


def tremblay(capacity_wh: float, voltage_v: float) -> Battery:
    """A pack of cells in series for its voltage and in parallel for its energy, at the test current per cell.

    capacity_wh is rated: cells × 6 Ah × 3.7 V. What it delivers is the discharge curve's. Raises ScenarioError.
    """
    cell = Cell()
    series = round(voltage_v / CELL_V)
    if series < 1:
        raise ScenarioError(f"battery.voltage_v: got {voltage_v:g}, expected at least one cell of {CELL_V} V")
    strings = capacity_wh / (series * CELL_V * cell.rated_ah)
    # the table runs from empty to full
    taken = cell.usable_ah * (1 - np.arange(POINTS) / (POINTS - 1))
    volts = np.array([cell.voltage_v(q, cell.test_a) for q in taken.tolist()]) * series
    return Battery(round(cell.usable_ah * 3600 * 1000 * strings), np.rint(volts * 1000).astype(np.int64))
