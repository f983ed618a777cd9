"""Lithium cell after Tremblay and Shepherd: voltage over charge and current, state of charge two ways, CC-CV charging.

Discharge: V = E0 - K·Q/(Q-q)·(q + i*) + A·exp(-B·q) - R·i with q in Ah taken out of a full cell and i* the current
through a low pass. Charge: the polarisation of i* is K·Q/(q + 0.1·Q). Lian et al. 2024 print the test (6 Ah rated, 8 A)
and where the curve bends (2.5 and 49 of 50 minutes, figure 2), but no voltage: the constants fit assumed ones.

A cell has two capacities, never one for the other: what is rated, and what the test delivered, 8 A over 50 minutes.
State of charge 1…0 spans what is delivered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.energy import parameter_sets
from engine.energy.battery import POINTS, Battery
from engine.errors import BadInput

F64 = NDArray[np.float64]

S_PER_H = 3600.0
BISECTIONS = 60
TEST_A = 8.0
"""Current of the test behind figure 2."""


@dataclass(frozen=True)
class Cell:
    """Numbers of a cell; engine.energy.parameter_sets.tremblay says their sources.

    e0_v, k, a_v, b_per_ah, r_ohm, q_ah: E0, K, A, B, R, Q · rated_ah, delivered_ah: on the label, and out of a full
    cell in the test · lag_s: time constant of i* · stable_from_ah, stable_to_ah: q between which the voltage tells the
    charge · charge_a, charge_v, stop_a: charging at constant current, then constant voltage until the current falls to
    stop_a. Raises BadInput on numbers that no cell can have.
    """

    e0_v: float
    k: float
    a_v: float
    b_per_ah: float
    r_ohm: float
    q_ah: float
    rated_ah: float
    delivered_ah: float
    lag_s: float
    stable_from_ah: float
    stable_to_ah: float
    charge_a: float
    charge_v: float
    stop_a: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value) or value <= 0:
                raise BadInput(f"a cell's {name} is {value:g}; expected a positive number")
        if not self.delivered_ah < self.q_ah:
            raise BadInput(f"a cell delivers {self.delivered_ah:g} Ah; expected less than its q_ah, {self.q_ah:g}")
        if not self.stable_from_ah < self.stable_to_ah <= self.delivered_ah:
            raise BadInput(
                f"a cell's stable zone is {self.stable_from_ah:g} to {self.stable_to_ah:g} Ah; expected an interval "
                f"within the {self.delivered_ah:g} Ah that it delivers"
            )

    @property
    def stable_ah(self) -> tuple[float, float]:
        return self.stable_from_ah, self.stable_to_ah

    def voltage_v(self, q_ah: ArrayLike, current_a: ArrayLike, slow_a: ArrayLike | None = None) -> F64:
        """Terminal voltage while discharging; slow_a is i*, the current itself when it has been steady."""
        q, i = np.asarray(q_ah, np.float64), np.asarray(current_a, np.float64)
        slow = i if slow_a is None else np.asarray(slow_a, np.float64)
        return np.asarray(self._open(q) - self.k * self.q_ah / (self.q_ah - q) * slow - self.r_ohm * i)

    def charging_v(self, q_ah: ArrayLike, current_a: ArrayLike) -> F64:
        """Terminal voltage while a steady current, given positive, flows in."""
        q, i = np.asarray(q_ah, np.float64), np.asarray(current_a, np.float64)
        return np.asarray(self._open(q) + (self._refill(q) + self.r_ohm) * i)

    def charging_a(self, q_ah: ArrayLike) -> F64:
        """Current that a CC-CV charger sends in: charge_a, or less where that would exceed charge_v; at least 0."""
        q = np.asarray(q_ah, np.float64)
        at_limit = (self.charge_v - self._open(q)) / (self._refill(q) + self.r_ohm)
        return np.asarray(np.clip(at_limit, 0.0, self.charge_a))

    def soc(self, q_ah: ArrayLike) -> F64:
        """State of charge 0…1 over what the cell delivers."""
        return np.asarray(np.clip(1 - np.asarray(q_ah, np.float64) / self.delivered_ah, 0.0, 1.0))

    def _open(self, q: F64) -> F64:
        """Voltage without current, polarisation by charge included."""
        fading = self.a_v * np.exp(-self.b_per_ah * q)
        return np.asarray(self.e0_v - self.k * self.q_ah / (self.q_ah - q) * q + fading)

    def _refill(self, q: F64) -> F64:
        return np.asarray(self.k * self.q_ah / (q + 0.1 * self.q_ah))


def cell(**changes: float) -> Cell:
    """The cell of engine.energy.parameter_sets.tremblay, with changes. Raises BadInput."""
    return Cell(**{**parameter_sets.tremblay(), **changes})


# ---------------------------------------------------------------- discharging


@dataclass(frozen=True)
class Discharge:
    """A cell over time, (T,) each: current and its low pass, charge taken out, terminal voltage."""

    cell: Cell
    t_s: F64
    current_a: F64
    slow_a: F64
    q_ah: F64
    voltage_v: F64

    @cached_property
    def counted_soc(self) -> F64:
        """(T,) state of charge by counting coulombs from full, over the delivered capacity."""
        return self.cell.soc(self.q_ah)

    @cached_property
    def counted_rated_soc(self) -> F64:
        """(T,) the same over the rated capacity: what a counter shows that trusts the label."""
        return np.clip(1 - self.q_ah / self.cell.rated_ah, 0.0, 1.0)

    @cached_property
    def read_soc(self) -> F64:
        """(T,) state of charge read from voltage and current; at the ends of the stable zone outside it."""
        return soc_of_voltage(self.cell, self.voltage_v, self.current_a)[0]

    @cached_property
    def stable(self) -> NDArray[np.bool_]:
        """(T,) whether voltage tells the charge."""
        low, high = self.cell.stable_ah
        return np.asarray((self.q_ah >= low) & (self.q_ah <= high))

    @property
    def error(self) -> F64:
        """(T,) read less counted, in state of charge."""
        return self.read_soc - self.counted_soc


def discharge(cell: Cell, current_a: ArrayLike, dt_s: float, q_ah: float = 0.0, slow_a: float = 0.0) -> Discharge:
    """A cell under a current over time, (T,) samples each held for dt_s; values are those at the end of each.

    q_ah, slow_a: charge taken out and i* before. Raises BadInput when more is taken out than the cell holds.
    """
    from scipy.signal import lfilter

    i = np.atleast_1d(np.asarray(current_a, np.float64))
    q = q_ah + np.cumsum(i) * dt_s / S_PER_H
    if q.size and q.max() >= cell.q_ah:
        raise BadInput(f"{q.max():.3f} Ah are taken out of a cell that holds {cell.q_ah:g} Ah; expected a shorter time")
    keep = math.exp(-dt_s / cell.lag_s)
    slow, _ = lfilter([1 - keep], [1, -keep], i, zi=[keep * slow_a])
    times = dt_s * np.arange(1, len(i) + 1, dtype=np.float64)
    return Discharge(cell, times, i, np.asarray(slow, np.float64), q, cell.voltage_v(q, i, slow))


def discharge_power(
    cell: Cell, power_w: ArrayLike, dt_s: float, cells: int, strings: float = 1.0, q_ah: float = 0.0
) -> Discharge:
    """A cell of a pack (`cells` in series, `strings` beside each other) that delivers a power over time, (T,) in W.

    In each sample i is the smaller root of P = V(i)·i. Raises BadInput when the cell can't deliver it.
    """
    each = np.atleast_1d(np.asarray(power_w, np.float64)) / (cells * strings)
    keep = math.exp(-dt_s / cell.lag_s)
    currents, q, slow = np.empty(len(each)), q_ah, 0.0
    for n, power in enumerate(each.tolist()):
        source = float(cell.voltage_v(q, 0.0, slow))
        root = source**2 - 4 * cell.r_ohm * power
        current = (source - math.sqrt(root)) / (2 * cell.r_ohm) if root >= 0 and source > 0 else math.inf
        q += current * dt_s / S_PER_H
        slow = keep * slow + (1 - keep) * current
        if not q < cell.q_ah:
            raise BadInput(f"the cell can't deliver {power:.4g} W after {n * dt_s:.4g} s; expected less power or time")
        currents[n] = current
    return discharge(cell, currents, dt_s, q_ah)


def soc_of_voltage(cell: Cell, voltage_v: ArrayLike, current_a: ArrayLike) -> tuple[F64, NDArray[np.bool_]]:
    """State of charge from terminal voltage under a steady current, by bisection, and whether it lies in the zone.

    The voltage falls all the way, but only in the stable zone does it tell the charge: outside, the nearer end.
    """
    voltage, i = np.broadcast_arrays(np.asarray(voltage_v, np.float64), np.asarray(current_a, np.float64))
    first, last = cell.stable_ah
    low, high = np.full(voltage.shape, first), np.full(voltage.shape, last)
    inside = (voltage <= cell.voltage_v(low, i)) & (voltage >= cell.voltage_v(high, i))
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        above = cell.voltage_v(middle, i) > voltage
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return cell.soc((low + high) / 2), np.asarray(inside)


@dataclass(frozen=True)
class Zone:
    """A stretch of the discharge curve, with its mean slope."""

    name: str
    from_min: float
    to_min: float
    slope_mv_min: float


ZONES = (("initial", 0.0, 2.5), ("stable", 2.5, 49.0), ("end", 49.0, 50.0))
"""Figure 2 of Lian et al. 2024: where its discharge curve bends, in minutes at 8 A."""


def discharge_curve(
    cell: Cell, current_a: float = TEST_A, minutes: float = 50.0, step_s: float = 3.0
) -> tuple[F64, F64, tuple[Zone, ...]]:
    """Figure 2: minutes and volts under a steady current, (T,) each, and the mean slope of each zone that it reaches.

    At another current than the test's the zones keep their charge, so that they begin earlier or later.
    """
    stretch = TEST_A / current_a
    zones = [(name, low * stretch, high * stretch) for name, low, high in ZONES]
    t = np.unique(np.concatenate([np.arange(0.0, minutes * 60, step_s) / 60, [minutes], [z[1] for z in zones]]))
    t = t[t <= minutes]

    def volts(at: ArrayLike) -> F64:
        return cell.voltage_v(np.asarray(at) * current_a / 60, current_a)

    reached = [(name, low, min(high, minutes)) for name, low, high in zones if low < minutes]
    slopes = [
        Zone(name, low, high, 1000 * float(volts(high) - volts(low)) / (high - low)) for name, low, high in reached
    ]
    return t, volts(t), tuple(slopes)


# ---------------------------------------------------------------- charging


@dataclass(frozen=True)
class Charge:
    """A cell on a CC-CV charger, (T,) each; ended: `full` when nothing is missing, `current` when it fell to stop_a."""

    t_s: F64
    current_a: F64
    voltage_v: F64
    q_ah: F64
    ended: str

    @property
    def held(self) -> NDArray[np.bool_]:
        """(T,) whether the charger holds the voltage."""
        return np.asarray(self.current_a < self.current_a.max() * (1 - 1e-9), np.bool_)


def charge(cell: Cell, q_ah: float, dt_s: float = 1.0) -> Charge:
    """Charging a cell from which q_ah were taken: values at the start of each step of dt_s, the last where it ends.

    Raises BadInput when the charger's voltage sends no current in.
    """
    if cell.charge_v <= float(cell.charging_v(cell.delivered_ah, 0.0)):
        raise BadInput(f"a charger of {cell.charge_v:g} V can't charge a cell; expected charge_v above its voltage")
    rows: list[tuple[float, float, float, float]] = []
    q = q_ah
    while True:
        current = float(cell.charging_a(q))
        rows.append((len(rows) * dt_s, current, float(cell.charging_v(q, current)), q))
        if q <= 0 or current <= cell.stop_a:
            break
        q = max(0.0, q - current * dt_s / S_PER_H)
    t, i, v, left = np.array(rows).T
    return Charge(t, i, v, left, "full" if q <= 0 else "current")


# ---------------------------------------------------------------- pack


@dataclass(frozen=True, slots=True)
class Pack:
    """`cells` in series, `strings` of them beside each other; rated and delivered, the latter at the test's 8 A."""

    cells: int
    strings: float
    rated_ah: float
    delivered_ah: float
    rated_wh: float
    delivered_wh: float


def pack(cell: Cell, capacity_wh: float, voltage_v: float) -> Pack:
    """The pack of nominal 3.7 V cells that is rated at capacity_wh."""
    cells = max(1, round(voltage_v / parameter_sets.CELL_NOMINAL_V))
    strings = capacity_wh / (cells * parameter_sets.CELL_NOMINAL_V * cell.rated_ah)
    q = np.linspace(0.0, cell.delivered_ah, 2001)
    one_wh = float(np.trapezoid(cell.voltage_v(q, TEST_A), q))
    return Pack(
        cells, strings, cell.rated_ah * strings, cell.delivered_ah * strings, capacity_wh, one_wh * cells * strings
    )


def tremblay(
    capacity_wh: float,
    voltage_v: float,
    load_a: float = 5.0,
    rated_ah: float | None = None,
    delivered_ah: float | None = None,
    r_ohm: float | None = None,
    charge_a: float | None = None,
    charge_v: float | None = None,
    stop_a: float | None = None,
) -> Battery:
    """Battery model: a pack of cells, its voltage over charge under a steady load of load_a per cell.

    capacity_wh is what is rated (3.7 V · rated Ah of each cell); the state of charge spans what is delivered. Charging
    follows the CC-CV current; below stop_a the charger goes on with that until the pack is full. The other arguments
    change the cell's numbers. Raises BadInput on numbers that no cell can have.
    """
    asked = {
        "rated_ah": rated_ah,
        "delivered_ah": delivered_ah,
        "r_ohm": r_ohm,
        "charge_a": charge_a,
        "charge_v": charge_v,
        "stop_a": stop_a,
    }
    one = cell(**{name: value for name, value in asked.items() if value is not None})
    whole = pack(one, capacity_wh, voltage_v)
    soc = np.minimum((np.arange(POINTS) + 0.5) / (POINTS - 1), 1.0)
    q = (1 - soc) * one.delivered_ah
    volts = whole.cells * one.voltage_v(q, load_a)
    if not (volts > 0).all():
        raise BadInput(f"a load of {load_a:g} A per cell takes the voltage to 0 before the cell is empty")
    current = np.maximum(one.charging_a(q), one.stop_a) * whole.strings
    millivolt = np.maximum(np.rint(volts * 1000), 1).astype(np.int64)
    return Battery(round(whole.delivered_ah * S_PER_H * 1000), millivolt, current * volts)
