"""Demand models of Lian et al. 2024: what two DC motors draw, and beside it the kinetic energy that the paper counts.

The world drives every way at cruising speed and starts and stops within it, so a start carries the energy of both its
ramps; the seconds that they take beyond that, `lost_s`, are not in the world's time. A turn lasts as long as its
primitive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from engine.energy.drive import Drive, cruise_j_per_m, kinetic_j, start_j, turn_j
from engine.types import Component
from engine.units import MM_PER_M
from engine.world.motion_graph import Primitive


@dataclass(frozen=True, slots=True)
class Lian2024:
    """Electrical energy of the motors; standby_w: sensors and controller, P_others of equation (8)."""

    drive: Drive
    standby_w: float

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Energy of one primitive in joules by component, standby excluded.

        Copper, rolling (gear losses included), starting (acceleration, less the driving that rolling out spares),
        turning (inertia and drag of a turn), recovered (negative). A reversal stops, turns and starts again.
        """
        metres = primitive.length_mm / MM_PER_M
        way = cruise_j_per_m(self.drive, mass_kg)
        copper, rolling = way.copper * metres, way.rolling * metres
        starting = turning = recovered = 0.0
        if primitive.starts:
            start = start_j(self.drive, mass_kg)
            copper += start.copper
            starting = start.rolling + start.inertia
            recovered += start.recovered
        if primitive.turn_deg:
            rolls = 0.0 if primitive.pivot or primitive.turn_deg == 180 else self.drive.v_mps
            turn = turn_j(self.drive, mass_kg, math.radians(primitive.turn_deg), duration_s, rolls)
            copper += turn.copper
            turning = turn.rolling + turn.inertia
            recovered += turn.recovered
        out = {
            Component.COPPER: copper,
            Component.ROLLING: rolling,
            Component.STARTING: starting,
            Component.TURNING: turning,
            Component.RECOVERED: recovered,
        }
        return {component: joules for component, joules in out.items() if joules}

    @property
    def lost_s(self) -> float:
        """Seconds that a start and a stop take beyond cruising over their distance."""
        return self.drive.v_mps / 2 * (1 / self.drive.accel_mps2 + 1 / self.drive.brake_mps2)


@dataclass(frozen=True, slots=True)
class Lian2024Paper:
    """The paper's (6)-(8): kinetic energy once per start, inertia dropped, and the others' power. To be shown beside.

    Kinetic energy is a state: counted as a consumption it drives any distance and turns on the spot for nothing.
    """

    drive: Drive
    standby_w: float
    printed: bool = False

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """½·m·v² of a start, corrected from (7), or with its printed factor ¼·m·(v_l+v_r)²."""
        if not primitive.starts:
            return {}
        v = self.drive.v_mps
        return {Component.STARTING: float(kinetic_j(mass_kg, v, v, self.printed))}


def lian2024(*, standby_w: float, **drive: float) -> Lian2024:
    """The demand model from engine.energy.parameter_sets.lian2024, changed or not. Raises BadInput."""
    return Lian2024(Drive(**drive), standby_w)


def lian2024_paper(*, standby_w: float, **drive: float) -> Lian2024Paper:
    """The paper's kinetic energy, corrected for its factor, from the same numbers. Raises BadInput."""
    return Lian2024Paper(Drive(**drive), standby_w)


MOTORS = frozenset({
    Component.COPPER, Component.ROLLING, Component.STARTING, Component.TURNING, Component.CLIMBING, Component.RECOVERED,
})  # fmt: skip
"""Components that the motors draw, or give back."""


def motors_share(energy: Mapping[Component, float]) -> float:
    """Share of the motors in energy by component, standby included: of a primitive, a drive or a run; 0 of nothing.

    The paper says more than 80 %.
    """
    drawn = {c: e for c, e in energy.items() if c in MOTORS or c is Component.STANDBY}
    total = sum(drawn.values())
    return sum(e for c, e in drawn.items() if c in MOTORS) / total if total else 0.0
