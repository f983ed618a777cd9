"""A skid-steered robot on a slope: wheel dynamics, motors, and two forms of what driving costs.

Zhang et al. 2021, equations (1)-(10) and (14), with what papers do not agree on put right:

- Equation (3), M·q̈ + C + G = τ, for the wheels of both sides: `torques`. Wheels that are dragged sideways resist a
  turn with the moment `scrub_nm`, which grows with curvature and is μ_t·m·g·l/2 on the spot.
- (5) I = τ/(K_T·gear·η), (4) and (6)-(9) P = ω·τ/η + I²·R_e for each side; printed is η·ω·τ. A side that brakes gives
  back `recovery` of what it could, by default nothing.
- Costs of a piece of way, of which one holds and never both, for the first term of (14) already contains rolling:
  `climb`, α·L + m·g·Δz⁺/η + turning with α the energy of a flat metre; `power`, the integral (10) of both sides' power.
  `printed`, α·‖Δ‖ + μ·m·g·Δz, is (14) with its where-list: potential energy bears no friction factor, and going down
  pays for going up again. It is there to be compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput

F64 = NDArray[np.float64]

CLIMB, POWER, PRINTED = range(3)
FORMS: tuple[str, ...] = ("climb", "power", "printed")
"""Forms of cost, by number."""


@dataclass(frozen=True, slots=True)
class SkidSteer:
    """Numbers of a robot, SI units; engine.energy.parameter_sets.zhang2021 says their sources. Raises BadInput."""

    mass_kg: float
    form: str
    mu: float
    g: float
    v_mps: float
    standby_w: float
    wheel_m: float
    track_m: float
    track_factor: float
    wheelbase_m: float
    torque_nm_a: float
    gear: float
    resistance_ohm: float
    efficiency: float
    mu_turn: float
    scrub_m: float
    recovery: float
    printed_efficiency: float

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise BadInput(f"a cost has form {' or '.join(map(repr, FORMS))}; got {self.form!r}")
        may_be_zero = ("standby_w", "recovery", "printed_efficiency", "mu_turn")
        for name in self.__slots__[2:]:
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0 or (value == 0 and name not in may_be_zero):
                raise BadInput(f"a robot's {name} is {value:g}; expected a positive number")
        for name in ("efficiency", "recovery", "printed_efficiency"):
            if getattr(self, name) > 1:
                raise BadInput(f"a robot's {name} is {getattr(self, name):g}; expected at most 1")

    @property
    def weight_n(self) -> float:
        return self.mass_kg * self.g

    @property
    def width_m(self) -> float:
        """Track as which a skid-steered robot turns."""
        return self.track_m * self.track_factor

    @property
    def per_work(self) -> float:
        """Energy drawn per work of a driving wheel."""
        return self.efficiency if self.printed_efficiency else 1 / self.efficiency

    @property
    def copper_w_n2(self) -> float:
        """Copper loss of one side per square of its force at the ground: (r/(K_T·gear·η))²·R_e."""
        return self.resistance_ohm * (self.wheel_m / (self.torque_nm_a * self.gear * self.efficiency)) ** 2

    @property
    def flat_j_per_m(self) -> tuple[float, float]:
        """α, energy of a flat metre straight on at v_mps: (rolling, copper)."""
        force = self.mu * self.weight_n
        return force * self.per_work, 2 * self.copper_w_n2 * (force / 2) ** 2 / self.v_mps

    def scrub_nm(self, bend: float) -> float:
        """Moment that resists a turn of curvature `bend` in 1/m; infinite is on the spot."""
        return self.mu_turn * self.weight_n * self.wheelbase_m / 2 * (1 - math.exp(-abs(bend) * self.scrub_m))


def torques(
    robot: SkidSteer, v: float, omega: float, slope: float = 0.0, dv: float = 0.0, domega: float = 0.0
) -> tuple[float, float]:
    """Torques at the left and right wheels in N·m: equation (3).

    v, omega: speed and turning rate; dv, domega: their derivatives · slope: angle of the ground ahead, up is positive.
    M = [[a, b], [b, a]] with a = m·r²/4 + r²·I_z/B² and b = m·r²/4 - r²·I_z/B².
    """
    r, width = robot.wheel_m, robot.width_m
    inertia = robot.mass_kg * (robot.wheelbase_m**2 + robot.track_m**2) / 12
    a = robot.mass_kg * r * r / 4 + r * r * inertia / width**2
    b = robot.mass_kg * r * r / 4 - r * r * inertia / width**2
    left, right = (dv - width * domega / 2) / r, (dv + width * domega / 2) / r
    bend = math.inf if v == 0 else omega / v
    turning = math.copysign(r * robot.scrub_nm(bend) / width, omega) if omega else 0.0
    ahead = r * robot.weight_n * math.sin(slope) / 2
    rolls = r * robot.mu * robot.weight_n * math.cos(slope) / 2
    v_left, v_right = v - width * omega / 2, v + width * omega / 2
    return (
        a * left + b * right + ahead + (math.copysign(rolls, v_left) if v_left else 0.0) - turning,
        b * left + a * right + ahead + (math.copysign(rolls, v_right) if v_right else 0.0) + turning,
    )


def side_power_w(robot: SkidSteer, torque_nm: float, wheel_rad_s: float) -> float:
    """Power that one side draws: equations (5)-(9); negative where braking gives something back."""
    current = torque_nm / (robot.torque_nm_a * robot.gear * robot.efficiency)
    work = torque_nm * wheel_rad_s
    power = work * (robot.per_work if work > 0 else robot.efficiency) + current**2 * robot.resistance_ohm
    return power if power > 0 else robot.recovery * power


def power_w(robot: SkidSteer, v: float, omega: float, slope: float = 0.0) -> float:
    """Power of both sides at a steady speed and turning rate: the integrand of equation (10)."""
    left, right = torques(robot, v, omega, slope)
    half = robot.width_m * omega / 2
    return side_power_w(robot, left, (v - half) / robot.wheel_m) + side_power_w(
        robot, right, (v + half) / robot.wheel_m
    )


def least(robot: SkidSteer, friction: float) -> tuple[str, float, float]:
    """Least cost on ground with at least this friction factor: a form, J per metre, J per metre of rise.

    Forms are those of a consistent heuristic: `climb`, A·distance + B·max(0, rise), and `slope`, max(0, A·distance in
    the plane + B·rise), for a descent may be free.
    """
    rolling, copper = robot.flat_j_per_m
    if robot.form == "power":
        return "slope", rolling * friction, robot.weight_n * robot.per_work
    if robot.form == "printed":
        return "space", rolling + copper - robot.mu * robot.weight_n, 0.0
    return "climb", rolling * friction + copper * friction**2, robot.weight_n * robot.per_work


def constants(robot: SkidSteer) -> F64:
    """What the kernels of engine.energy.terrain_costs need, in their order."""
    rolling, copper = robot.flat_j_per_m
    return np.array([
        FORMS.index(robot.form), robot.weight_n, robot.mu, robot.per_work, robot.efficiency, robot.copper_w_n2,
        robot.width_m, robot.recovery, rolling, copper,
    ])  # fmt: skip
