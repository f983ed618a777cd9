"""Differential drive with two DC motors (Lian et al. 2024, equations 1–8, corrected): motion to electrical energy.

Counter-clockwise positive: ω = (v_r − v_l)/d; the paper's equation 2 has the sign of its equation 3 turned round.
Motor: U = R·i + L·di/dt + C_e·Ω, printed with Ω̇ for Ω. Energy is ∫ΣU·i dt, split into copper loss and the shaft's work
against rolling resistance, for speeding up and for turning; shaft work is paid through the gear's efficiency. Braking
gives back `regen` of what reaches the terminals, never more than the motion itself takes.

The schedule's ticks know no acceleration: a start speeds up over v/a seconds at constant a, wherever it happens, and
what that adds over cruising is charged to the motion that starts. A pivot speeds up during a third of its time and
slows down during another: the least copper loss of all such ramps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.types import Component
from engine.units import MM_PER_M
from engine.world.motion_graph import Primitive

F64 = NDArray[np.float64]

RAMP = 1 / 3
"""Share of a pivot's time in which it speeds up, and in which it slows down."""
CURRENT_LAG_S = 0.02
"""How fast the current follows the wanted force in a drive cycle; a few times the motor's L/R of 9 ms."""


class Motor(NamedTuple):
    """A DC motor: resistance in Ω, inductance in H, electromotive force in V·s/rad (and so torque in N·m/A)."""

    r_ohm: float
    l_h: float
    ce_vs: float

    def voltage(self, current_a: float, speed_rad_s: float, slope_a_s: float = 0.0) -> float:
        """Terminal voltage at a current, a shaft speed and a change of current."""
        return self.r_ohm * current_a + self.ce_vs * speed_rad_s + self.l_h * slope_a_s


def wheel_speeds(v_mps: float, omega: float, wheel_m: float, track_m: float) -> tuple[float, float]:
    """Wheel speeds (left, right) in rad/s of a body that drives at v and turns counter-clockwise at ω (equation 3)."""
    return (v_mps - omega * track_m / 2) / wheel_m, (v_mps + omega * track_m / 2) / wheel_m


def body_speeds(left: float, right: float, wheel_m: float, track_m: float) -> tuple[float, float]:
    """(v in m/s, ω in rad/s) of wheel speeds in rad/s; undoes wheel_speeds."""
    return wheel_m * (left + right) / 2, wheel_m * (right - left) / track_m


def kinetic_j(mass_kg: float, left: float, right: float, wheel_m: float, *, printed: bool = False) -> float:
    """Kinetic energy from wheel speeds, inertia left out (equation 7): m·r²·(ω_l + ω_r)²/8; as printed m·r·(…)²/4."""
    total = (left + right) ** 2
    return mass_kg * wheel_m * total / 4 if printed else mass_kg * wheel_m**2 * total / 8


@dataclass(frozen=True, slots=True)
class Drive:
    """Parameters in SI units. wheel_m: radius · track_m: between the wheels · gear: motor turns per wheel turn."""

    v_mps: float
    wheel_m: float
    track_m: float
    gear: float
    gear_efficiency: float
    r_ohm: float
    l_h: float
    ce_vs: float
    mu: float
    g: float
    accel_mps2: float
    regen: float
    length_m: float
    width_m: float
    standby_w: float

    @property
    def motor(self) -> Motor:
        """One of the two motors."""
        return Motor(self.r_ohm, self.l_h, self.ce_vs)

    def current_a(self, force_n: float) -> float:
        """Current of each motor for a force of both wheels on the ground; the gear helps to brake."""
        torque = force_n * self.wheel_m / 2 / self.gear
        return torque / self.ce_vs * (self.gear_efficiency if force_n < 0 else 1 / self.gear_efficiency)

    def copper_j(self, force_n: float, time_s: float) -> float:
        """Copper loss of both motors under a force for a time."""
        return float(2 * self.r_ohm * self.current_a(force_n) ** 2 * time_s)

    def inertia(self, mass_kg: float) -> float:
        """Moment of inertia of the vehicle as a plate."""
        return mass_kg * (self.length_m**2 + self.width_m**2) / 12

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Energy of one primitive in joules by component, standby excluded."""
        rolling_n = self.mu * mass_kg * self.g
        out = dict.fromkeys((Component.ROLLING, Component.STARTING, Component.TURNING, Component.COPPER), 0.0)
        recovered = 0.0
        if primitive.pivot:
            recovered += self._pivot(out, math.radians(primitive.turn_deg), rolling_n, mass_kg, duration_s)
        else:
            length = primitive.length_mm / MM_PER_M
            out[Component.ROLLING] = rolling_n * length / self.gear_efficiency
            out[Component.COPPER] = self.copper_j(rolling_n, length / self.v_mps)
            omega = math.radians(primitive.turn_deg) / duration_s
            out[Component.TURNING] = self.inertia(mass_kg) * omega**2 / 2 / self.gear_efficiency
        ramp_s, ramp_m = self.v_mps / self.accel_mps2, self.v_mps**2 / self.accel_mps2 / 2
        if primitive.starts:
            out[Component.STARTING] = mass_kg * self.v_mps**2 / 2 / self.gear_efficiency
            fast = self.copper_j(rolling_n + mass_kg * self.accel_mps2, ramp_s)
            out[Component.COPPER] += fast - self.copper_j(rolling_n, ramp_m / self.v_mps)
        if primitive.stops:
            recovered += self._braked(mass_kg * self.accel_mps2 - rolling_n, ramp_m, ramp_s)
        back = min(self.regen * recovered, sum(out.values()))
        return {**out, Component.RECOVERED: -back} if back > 0 else out

    def _pivot(
        self, out: dict[Component, float], angle: float, rolling_n: float, mass_kg: float, duration_s: float
    ) -> float:
        """Add a pivot's energy to `out`; returns what its braking gives at the terminals."""
        ramp_s = RAMP * duration_s
        top = angle / (duration_s - ramp_s)
        ramp_angle = top * ramp_s / 2
        friction = rolling_n * self.track_m / 2  # moment of the wheels' rolling resistance
        swing = self.inertia(mass_kg) * top / ramp_s
        out[Component.TURNING] = self.inertia(mass_kg) * top**2 / 2 / self.gear_efficiency
        slowing = friction - swing
        angles = angle - ramp_angle if slowing < 0 else angle
        out[Component.ROLLING] = friction * angles / self.gear_efficiency
        if slowing >= 0:
            out[Component.TURNING] -= swing * ramp_angle / self.gear_efficiency
        # a moment M is a couple of forces M/d at the wheels: as much current as a force of 2·M/d straight ahead
        of = 2 / self.track_m
        out[Component.COPPER] = self.copper_j(of * (friction + swing), ramp_s)
        out[Component.COPPER] += self.copper_j(of * friction, duration_s - 2 * ramp_s)
        if slowing >= 0:
            out[Component.COPPER] += self.copper_j(of * slowing, ramp_s)
            return 0.0
        return self._braked(-of * slowing, self.track_m / 2 * ramp_angle, ramp_s)

    def _braked(self, force_n: float, length_m: float, time_s: float) -> float:
        """What reaches the terminals when the wheels brake with a force over a length."""
        if force_n <= 0:
            return 0.0
        return max(force_n * length_m * self.gear_efficiency - self.copper_j(-force_n, time_s), 0.0)


@dataclass(frozen=True, slots=True)
class PaperDrive:
    """The paper's own account (equations 6–8): each motion consumes its kinetic energy, and standby. Turning is free.

    Kinetic energy is a state and no consumption; this is here to be compared. printed: with the printed factor and
    radius instead of the corrected ones.
    """

    v_mps: float
    wheel_m: float
    printed: float
    standby_w: float

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Kinetic energy at cruising speed for every motion over ground."""
        if primitive.pivot or not primitive.length_mm:
            return {}
        wheel = self.v_mps / self.wheel_m
        return {Component.RUNNING: kinetic_j(mass_kg, wheel, wheel, self.wheel_m, printed=bool(self.printed))}


@dataclass(frozen=True, slots=True)
class Cycle:
    """One drive from rest to rest, sampled: arrays of equal length, per motor where it says so.

    t_s, v_mps · current_a, voltage_v: of one motor · shaft_w, copper_w, power_w: of both, power at the terminals.
    """

    t_s: F64
    v_mps: F64
    current_a: F64
    voltage_v: F64
    shaft_w: F64
    copper_w: F64
    power_w: F64


def drive_cycle(model: Drive, distance_m: float, mass_kg: float, dt_s: float = 0.001) -> Cycle:
    """A trapezoidal drive over a distance; a triangle when it is too short to reach the cruising speed."""
    accel = model.accel_mps2
    top = min(model.v_mps, math.sqrt(accel * distance_m))
    ramp, cruise = top / accel, (distance_m - top**2 / accel) / top
    t: F64 = np.arange(0.0, 2 * ramp + cruise + 10 * CURRENT_LAG_S, dt_s)
    v: F64 = np.clip(np.minimum(accel * t, accel * (2 * ramp + cruise - t)), 0.0, top)
    a = np.where(t < ramp, accel, np.where((t >= ramp + cruise) & (t < 2 * ramp + cruise), -accel, 0.0))
    force = mass_kg * a + model.mu * mass_kg * model.g * (v > 0)
    wanted = np.array([model.current_a(f) for f in force.tolist()])
    current = np.zeros_like(t)
    keep = math.exp(-dt_s / CURRENT_LAG_S)
    for k in range(1, len(t)):
        current[k] = wanted[k] + (current[k - 1] - wanted[k]) * keep
    slope: F64 = np.gradient(current, dt_s)
    speed = v / model.wheel_m * model.gear
    voltage = model.r_ohm * current + model.ce_vs * speed + model.l_h * slope
    return Cycle(
        t, v, current, voltage, 2 * model.ce_vs * speed * current, 2 * model.r_ohm * current**2, 2 * voltage * current
    )
