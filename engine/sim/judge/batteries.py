"""What a battery of each known model holds, and how fast it may fill, anew from the scenario's numbers.

linear: one volt, so that mC equal mJ · coulomb: the nominal voltage · tremblay: cells of 3.7 V and 6 Ah (rated) in
series, enough strings of them to be rated at capacity_wh; V = E0 − K·Q/(Q−q)·(q + i) + A·exp(−B·q) − R·i under a steady
load i, with q in Ah taken out; charging sends charge_a, or what holds charge_v, or stop_a where that is less still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scenario import Scenario
from engine.sim.judge.record import I64

STEPS = 1000
"""A battery's voltage and accepted power change at every thousandth of its charge."""
_CELL = {
    "e0_v": 3.7022, "k": 5.4e-4, "a_v": 0.3935, "b_per_ah": 1.0, "r_ohm": 0.01213, "q_ah": 6.729, "rated_ah": 6.0,
    "delivered_ah": 8.0 * 50 / 60, "charge_a": 3.0, "charge_v": 4.1, "stop_a": 0.3, "load_a": 5.0,
}  # fmt: skip


@dataclass(frozen=True)
class Known:
    """capacity_mc · millivolt, accept_w: (STEPS + 1,) over the charge, the latter the most that flows in; None: any."""

    capacity_mc: int
    millivolt: I64
    accept_w: NDArray[np.float64] | None = None

    def step(self, charge_mc: I64) -> I64:
        """Index into the tables."""
        return np.clip(charge_mc * STEPS // self.capacity_mc, 0, STEPS)

    def content_uj(self, charge_mc: I64) -> I64:
        """Energy down to empty, in mV·mC."""
        below = np.concatenate([[0], np.cumsum(self.millivolt[:-1])])
        at = self.step(charge_mc)
        over = charge_mc * STEPS - at * self.capacity_mc
        return np.asarray((below[at] * self.capacity_mc + over * self.millivolt[at]) // STEPS)


def battery_of(scenario: Scenario) -> Known | None:
    """The battery of a scenario; None for a model that the judge does not know."""
    battery = scenario.battery
    if battery.model == "tremblay":
        return _tremblay(scenario)
    if battery.model not in ("linear", "coulomb"):
        return None
    millivolt = 1000 if battery.model == "linear" else round(battery.voltage_v * 1000)
    capacity = round(battery.capacity_wh * 3600 * 1_000_000 / millivolt)
    return Known(capacity, np.full(STEPS + 1, millivolt, np.int64))


def _tremblay(scenario: Scenario) -> Known:
    battery = scenario.battery
    c = {**_CELL, **battery.parameters}
    in_series = max(1, round(battery.voltage_v / 3.7))
    strings = battery.capacity_wh / (in_series * 3.7 * c["rated_ah"])
    q = (1 - np.minimum((np.arange(STEPS + 1) + 0.5) / STEPS, 1.0)) * c["delivered_ah"]
    fade = c["k"] * c["q_ah"] / (c["q_ah"] - q)
    resting = c["e0_v"] - fade * q + c["a_v"] * np.exp(-c["b_per_ah"] * q)
    loaded = in_series * (resting - (fade + c["r_ohm"]) * c["load_a"])
    held = (c["charge_v"] - resting) / (c["k"] * c["q_ah"] / (q + 0.1 * c["q_ah"]) + c["r_ohm"])
    ampere = strings * np.maximum(np.minimum(held, c["charge_a"]), c["stop_a"])
    millivolt = np.maximum(np.rint(loaded * 1000), 1).astype(np.int64)
    return Known(round(c["delivered_ah"] * strings * 3_600_000), millivolt, ampere * loaded)
