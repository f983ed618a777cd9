"""Demand model of Xu & Wang 2025 (equations 2–6 and 12, reconstructed): rolling, turning, starting, standby.

straight μ·m·g·l · quarter turn μ·m·g·π·d/4 + ½·I·ω² · start ½·m·v² · standby P_s·Δt. A reversal costs what it does:
it stops, turns twice and starts again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from engine.types import Component
from engine.units import MM_PER_M
from engine.world.motion_graph import Primitive


@dataclass(frozen=True, slots=True)
class Xu2025:
    """Parameters in SI units; `omega` is the turning rate in rad/s."""

    mu: float
    g: float
    v_mps: float
    standby_w: float
    omega: float
    length_m: float
    width_m: float

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Energy of one primitive in joules by component, standby excluded. One E_turn per started 90 degrees."""
        inertia = mass_kg * (self.length_m**2 + self.width_m**2) / 12
        turns = primitive.turn_deg / 90
        out = {Component.ROLLING: self.mu * mass_kg * self.g * primitive.length_mm / MM_PER_M}
        if turns:
            out[Component.TURNING] = turns * 0.5 * inertia * self.omega**2
        if primitive.starts:
            out[Component.STARTING] = 0.5 * mass_kg * self.v_mps**2
        return out
