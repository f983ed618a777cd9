"""A vehicle on two driven wheels: kinematics, DC motors, and the electrical energy of trapezoidal speed profiles.

Lian et al. 2024, equations (1)-(8). Angles are counter-clockwise: ω = (v_r - v_l)/d, which makes (3) the inverse of
(1) and (2); the printed (2) has the other sign. The motor's balance of voltages is L·di/dt + R·i + C_e·Ω = U with Ω the
rotor's speed (the printed Ω̇ would be volts per second); its balance of power is U·i = R·i² + C_e·Ω·i + d(½·L·i²)/dt.
Over a motion primitive, which lasts a hundred times L/R = 9 ms, the inductance keeps nothing, so that i = τ/C_e.

Energy is what the motors draw, ∫ΣU·i dt. The paper takes the kinetic energy for it, which is a state and no
consumption; `kinetic_j` keeps that formula to be shown beside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.errors import BadInput

F64 = NDArray[np.float64]

SAMPLES = 128
"""Samples per phase of a profile. Exact while the motors drive, for power is then linear in time."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Numbers of a drive with two equal motors, SI units; engine.energy.parameter_sets.lian2024 says their sources.

    mu: rolling resistance · wheel_m: radius of the driven wheels · track_m: distance between them · gear: reduction
    · gear_efficiency: of the gear, both ways · length_m, width_m: of the body, for its inertia m(length²+width²)/12
    · resistance_ohm, inductance_h, emf_vs: R, L and C_e (V·s/rad, also the torque in N·m/A) of a motor
    · accel_mps2, brake_mps2: of a trapezoidal profile up to v_mps · recovery: share of what a braking motor gives that
    reaches the battery; 0 brakes by friction alone. Raises BadInput on numbers that no drive can have.
    """

    mu: float
    g: float
    v_mps: float
    wheel_m: float
    track_m: float
    gear: float
    gear_efficiency: float
    length_m: float
    width_m: float
    resistance_ohm: float
    inductance_h: float
    emf_vs: float
    accel_mps2: float
    brake_mps2: float
    recovery: float

    def __post_init__(self) -> None:
        may_be_zero = ("mu", "inductance_h", "recovery")
        for name in self.__slots__:
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0 or (value == 0 and name not in may_be_zero):
                raise BadInput(f"a drive's {name} is {value:g}; expected a positive number")
        for name in ("gear_efficiency", "recovery"):
            if getattr(self, name) > 1:
                raise BadInput(f"a drive's {name} is {getattr(self, name):g}; expected a share of at most 1")


def forward(v_l: ArrayLike, v_r: ArrayLike, track_m: float, printed: bool = False) -> tuple[F64, F64]:
    """Speed v and turning rate ω (counter-clockwise) from the rim speeds of both wheels: equations (1) and (2).

    printed: the paper's sign of (2), clockwise, which its own (3) does not invert.
    """
    left, right = np.asarray(v_l, np.float64), np.asarray(v_r, np.float64)
    rate = (left - right if printed else right - left) / track_m
    return (left + right) / 2, rate


def inverse(v: ArrayLike, omega: ArrayLike, wheel_m: float, track_m: float) -> tuple[F64, F64]:
    """Wheel speeds ω_l and ω_r in rad/s from v and ω: equation (3)."""
    speed, half = np.asarray(v, np.float64), np.asarray(omega, np.float64) * track_m / 2
    return (speed - half) / wheel_m, (speed + half) / wheel_m


def kinetic_j(mass_kg: float, v_l: ArrayLike, v_r: ArrayLike, printed: bool = False) -> F64:
    """Kinetic energy ⅛·m·(v_l + v_r)², the first line of (7); `printed` has ¼, twice too much. Inertia is left out."""
    total = np.asarray(v_l, np.float64) + np.asarray(v_r, np.float64)
    return np.asarray(mass_kg * total**2 * (0.25 if printed else 0.125))


def kinetic_of_wheels_j(
    mass_kg: float, omega_l: ArrayLike, omega_r: ArrayLike, wheel_m: float, printed: bool = False
) -> F64:
    """The same from wheel speeds, ⅛·m·r²·(ω_l + ω_r)², the second line of (7); `printed` has ¼·m·r, r not squared."""
    total = np.asarray(omega_l, np.float64) + np.asarray(omega_r, np.float64)
    return np.asarray(mass_kg * total**2 * (0.25 * wheel_m if printed else 0.125 * wheel_m**2))


# ---------------------------------------------------------------- motor


@dataclass(frozen=True, slots=True)
class MotorRun:
    """A motor over time, arrays of (T,); energies in joules since the start, at its terminals.

    input_j = copper_j + shaft_j + field_j: the balance of equation (4) times i, integrated.
    """

    t_s: F64
    current_a: F64
    rotor_rad_s: F64
    input_j: F64
    copper_j: F64
    shaft_j: F64
    field_j: F64


def run_motor(
    drive: Drive,
    voltage_v: Callable[[float], float],
    duration_s: float,
    rotor_inertia: float,
    load_nm: float = 0.0,
    start: tuple[float, float] = (0.0, 0.0),
    samples: int = 201,
) -> MotorRun:
    """One motor with its inductance under a voltage over time, turning an inertia (kg·m²) against a constant load.

    start: current in A and rotor speed in rad/s. Energies are integrated along with the motion, each for itself.
    """
    from scipy.integrate import solve_ivp

    r, inductance, c = drive.resistance_ohm, drive.inductance_h, drive.emf_vs
    if inductance <= 0:
        raise BadInput("a motor without inductance has no transient; expected inductance_h above 0")

    def slope(t: float, y: F64) -> list[float]:
        i, rotor, u = float(y[0]), float(y[1]), voltage_v(t)
        return [
            (u - r * i - c * rotor) / inductance,
            (c * i - load_nm) / rotor_inertia,
            u * i,
            r * i * i,
            c * rotor * i,
        ]

    times = np.linspace(0.0, duration_s, samples)
    step = inductance / r
    found = solve_ivp(
        slope, (0.0, duration_s), [*start, 0.0, 0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=step
    )
    i, rotor, given, copper, shaft = found.y
    return MotorRun(times, i, rotor, given, copper, shaft, 0.5 * inductance * (i**2 - start[0] ** 2))


@dataclass(frozen=True, slots=True)
class MotorPoint:
    """What one motor and the vehicle's two together do at constant speed."""

    current_a: float
    voltage_v: float
    power_w: float
    efficiency: float
    rotor_rad_s: float


def cruise(drive: Drive, mass_kg: float, speed_mps: float | None = None) -> MotorPoint:
    """Both motors at constant speed on the level: i = τ/C_e, U = R·i + C_e·Ω, P = 2·U·i."""
    speed = drive.v_mps if speed_mps is None else speed_mps
    torque = drive.mu * mass_kg * drive.g / 2 * drive.wheel_m / drive.gear / drive.gear_efficiency
    current, rotor = torque / drive.emf_vs, speed / drive.wheel_m * drive.gear
    voltage = drive.resistance_ohm * current + drive.emf_vs * rotor
    power = 2 * voltage * current
    rolling = drive.mu * mass_kg * drive.g * speed
    return MotorPoint(current, voltage, power, rolling / power if power else 0.0, rotor)


# ---------------------------------------------------------------- profiles


@dataclass(frozen=True, slots=True)
class Trace:
    """A motion sampled at N midpoints; motors are (N, 2), left and right.

    dt_s: (N,) length of each sample's interval · rolling_w, inertia_w: power of the motors against rolling resistance
    and into motion, gear losses included · recovered_w: what flows back, never positive. Both motors together.
    """

    t_s: F64
    dt_s: F64
    v_mps: F64
    omega: F64
    current_a: F64
    voltage_v: F64
    copper_w: F64
    rolling_w: F64
    inertia_w: F64
    recovered_w: F64

    @property
    def power_w(self) -> F64:
        """(N,) drawn by the motors: the sum of U·i over both, less what recovery loses."""
        return self.copper_w + self.rolling_w + self.inertia_w + self.recovered_w


@dataclass(frozen=True, slots=True)
class Joules:
    """Energy of a motion by cause, in joules; recovered is never positive."""

    copper: float = 0.0
    rolling: float = 0.0
    inertia: float = 0.0
    recovered: float = 0.0

    @property
    def total(self) -> float:
        return self.copper + self.rolling + self.inertia + self.recovered

    def __add__(self, other: Joules) -> Joules:
        return self.plus(other, 1.0)

    def __sub__(self, other: Joules) -> Joules:
        return self.plus(other, -1.0)

    def plus(self, other: Joules, times: float) -> Joules:
        return Joules(
            self.copper + times * other.copper,
            self.rolling + times * other.rolling,
            self.inertia + times * other.inertia,
            self.recovered + times * other.recovered,
        )


@dataclass(frozen=True, slots=True)
class Phase:
    """A part of a profile with constant accelerations: duration, v and ω at its start, and how fast they change."""

    duration_s: float
    v_mps: float = 0.0
    accel_mps2: float = 0.0
    omega: float = 0.0
    alpha: float = 0.0


def trace(drive: Drive, mass_kg: float, phases: tuple[Phase, ...], samples: int = SAMPLES) -> Trace:
    """A motion through its phases, each sampled at the midpoints of equal intervals. Raises BadInput on none.

    A motor whose power turns negative gives `recovery` of it back; where it would have to draw power to brake, and all
    along without recovery, the friction brake does it.
    """
    kept = _lasting(phases)
    middle = (np.arange(samples) + 0.5) / samples
    local = np.concatenate([middle * p.duration_s for p in kept])
    each = np.repeat(np.arange(len(kept)), samples)
    return _trace(drive, mass_kg, kept, each, local, np.array([p.duration_s for p in kept])[each] / samples)


def steady_trace(drive: Drive, mass_kg: float, phases: tuple[Phase, ...], dt_s: float) -> Trace:
    """The same at the midpoints of steps of one length, as many as fit to the nearest: to be shown over time."""
    kept = _lasting(phases)
    ends = np.cumsum([p.duration_s for p in kept])
    t = (np.arange(max(1, round(float(ends[-1]) / dt_s))) + 0.5) * dt_s
    each = np.minimum(np.searchsorted(ends, t, side="right"), len(kept) - 1)
    begins = np.concatenate([[0.0], ends[:-1]])
    return _trace(drive, mass_kg, kept, each, t - begins[each], np.full(len(t), dt_s))


def _lasting(phases: tuple[Phase, ...]) -> list[Phase]:
    kept = [phase for phase in phases if phase.duration_s > 0]
    if not kept:
        raise BadInput("a motion without duration was given; expected at least one phase that lasts")
    return kept


def _trace(drive: Drive, mass_kg: float, phases: list[Phase], each: NDArray[np.intp], local: F64, dt_s: F64) -> Trace:
    """(N,) samples: the phase of each, the time since it began, and the interval that it stands for."""
    columns = np.array([[p.v_mps, p.accel_mps2, p.omega, p.alpha] for p in phases])[each]
    v0, a, omega0, alpha = columns.T
    begins = np.concatenate([[0.0], np.cumsum([p.duration_s for p in phases])])[each]
    v, omega = v0 + a * local, omega0 + alpha * local

    half = drive.track_m / 2
    speed = np.stack([v - omega * half, v + omega * half], axis=1)
    inertia = mass_kg * (drive.length_m**2 + drive.width_m**2) / 12
    drag = np.sign(speed) * drive.mu * mass_kg * drive.g / 2
    linear, angular = mass_kg * a / 2, inertia * alpha / drive.track_m
    push = np.stack([linear - angular, linear + angular], axis=1)
    force = drag + push
    drives = force * speed >= 0

    gain = np.where(drives, 1 / drive.gear_efficiency, drive.gear_efficiency)
    current = force * drive.wheel_m / drive.gear * gain / drive.emf_vs
    shaft = force * speed * gain
    copper = drive.resistance_ohm * current**2
    gives = ~drives & (copper + shaft < 0) & (drive.recovery > 0)
    current = np.where(drives | gives, current, 0.0)
    voltage = drive.resistance_ohm * current + drive.emf_vs * speed / drive.wheel_m * drive.gear

    def driven(power: F64) -> F64:
        return np.asarray(np.where(drives, power, 0.0).sum(axis=1))

    return Trace(
        t_s=begins + local,
        dt_s=dt_s,
        v_mps=v,
        omega=omega,
        current_a=current,
        voltage_v=voltage,
        copper_w=driven(copper),
        rolling_w=driven(drag * speed * gain),
        inertia_w=driven(push * speed * gain),
        recovered_w=np.where(gives, drive.recovery * (copper + shaft), 0.0).sum(axis=1),
    )


def joules_of(path: Trace) -> Joules:
    """A trace integrated over time."""
    parts = (path.copper_w, path.rolling_w, path.inertia_w, path.recovered_w)
    return Joules(*(float(power @ path.dt_s) for power in parts))


def trapezoid(drive: Drive, distance_m: float) -> tuple[Phase, ...]:
    """Phases from rest to rest over a distance: up, cruise, down; a triangle when the distance is too short."""
    a, b = drive.accel_mps2, drive.brake_mps2
    top = min(drive.v_mps, float(np.sqrt(2 * distance_m / (1 / a + 1 / b))))
    level = distance_m - top**2 / 2 * (1 / a + 1 / b)
    return Phase(top / a, 0.0, a), Phase(max(level, 0.0) / top, top), Phase(top / b, top, -b)


def rotation(angle_rad: float, duration_s: float, v_mps: float = 0.0) -> tuple[Phase, ...]:
    """Phases of a turn within a duration, at constant speed: a third of it up, a third level, a third down."""
    third = duration_s / 3
    top = 1.5 * angle_rad / duration_s
    alpha = top / third
    return (
        Phase(third, v_mps, 0.0, 0.0, alpha),
        Phase(third, v_mps, 0.0, top, 0.0),
        Phase(third, v_mps, 0.0, top, -alpha),
    )


# ---------------------------------------------------------------- motion primitives


@lru_cache(maxsize=4096)
def cruise_j_per_m(drive: Drive, mass_kg: float) -> Joules:
    """Energy per metre at constant speed."""
    return joules_of(trace(drive, mass_kg, (Phase(1 / drive.v_mps, drive.v_mps),), 1))


@lru_cache(maxsize=4096)
def start_j(drive: Drive, mass_kg: float) -> Joules:
    """What a start and the stop that follows it some time add to cruising over the whole way.

    Both ramps less cruising over their distance, so that the primitives of a drive sum to its trapezoid wherever it
    stops. Rolling out on kinetic energy spares driving, hence `rolling` and often `copper` of the stop count against
    the start.
    """
    a, b, v = drive.accel_mps2, drive.brake_mps2, drive.v_mps
    ramps = joules_of(trace(drive, mass_kg, (Phase(v / a, 0.0, a), Phase(v / b, v, -b))))
    return ramps.plus(cruise_j_per_m(drive, mass_kg), -(v**2) / 2 * (1 / a + 1 / b))


@lru_cache(maxsize=4096)
def turn_j(drive: Drive, mass_kg: float, angle_rad: float, duration_s: float, v_mps: float) -> Joules:
    """What turning within a duration adds to driving straight at v_mps; on the spot when that is 0."""
    turning = joules_of(trace(drive, mass_kg, rotation(angle_rad, duration_s, v_mps)))
    if not v_mps:
        return turning
    return turning - joules_of(trace(drive, mass_kg, (Phase(duration_s, v_mps),), 1))
