"""Motor to battery: one drive of a vehicle of Lian et al. 2024, from its wheels to the state of charge."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from dash import html
from numpy.typing import NDArray

from app.lessons.base import Lesson, Preset, Query, read_whole
from engine.energy import parameter_sets
from engine.energy.drive import (
    Drive,
    Phase,
    Trace,
    inverse,
    kinetic_j,
    kinetic_of_wheels_j,
    rotation,
    steady_trace,
    trapezoid,
)
from engine.energy.lian2024 import motors_share
from engine.energy.tremblay import Cell, Discharge, Pack, cell, discharge_power, pack
from engine.errors import BadInput
from engine.scenario import load
from engine.types import Component

F64 = NDArray[np.float64]

DT_S = 0.02
SAMPLES = 4000
"""Longer drives are sampled in wider steps."""
SHOWN = 300
"""Points of a curve."""
LAST = 9999
COMPONENTS = (
    Component.COPPER, Component.ROLLING, Component.STARTING, Component.TURNING, Component.STANDBY, Component.RECOVERED,
)  # fmt: skip


@dataclass(frozen=True)
class Slider:
    """A number that a person sets. step: its grain; values have as many digits as it has."""

    word: str
    unit: str
    low: float
    high: float
    step: float


SLIDERS: dict[str, Slider] = {
    "mass": Slider("Mass of the vehicle", "kg", 50, 1000, 10),
    "load": Slider("Load", "kg", 0, 1000, 10),
    "gear": Slider("Gear", ": 1", 5, 60, 1),
    "speed": Slider("Speed", "m/s", 0.2, 3, 0.1),
    "distance": Slider("Distance", "m", 1, 40, 1),
    "turn": Slider("Turn half-way", "°", 0, 180, 15),
    "turning": Slider("Time to turn by 90°", "s", 0.5, 5, 0.1),
    "recovery": Slider("Recovered when braking", "%", 0, 100, 10),
    "soc": Slider("State of charge at the start", "%", 1, 100, 1),
}
KEYS = (*SLIDERS, "step")


class Asked(NamedTuple):
    """A checked state, in the units of the sliders."""

    mass: float
    load: float
    gear: float
    speed: float
    distance: float
    turn: float
    turning: float
    recovery: float
    soc: float


def read_number(text: str, key: str) -> float:
    """A slider's value. Raises BadInput."""
    s = SLIDERS[key]
    if not re.fullmatch(r"\d{1,4}(\.\d{1,3})?", text) or not s.low <= float(text) <= s.high:
        raise BadInput(f"{key}: a number from {s.low:g} to {s.high:g} {s.unit} was expected, got {text[:20]!r}")
    return float(text)


def read(query: Query) -> Asked:
    """The state of an address. Raises BadInput."""
    read_whole(query.get("step", ""), "step", 0, LAST, 0)
    return Asked(**{key: read_number(query[key], key) for key in SLIDERS})


# -- the drive --------------------------------------------------------------------------------------------------------


@cache
def battery() -> tuple[Cell, Pack]:
    """The cell, and the pack of the scenario lian2024."""
    asked, one = load("lian2024").battery, cell()
    return one, pack(one, asked.capacity_wh, asked.voltage_v)


def drive_of(asked: Asked) -> tuple[Drive, float]:
    """The drive, and the power of everything else in W."""
    numbers = {**parameter_sets.lian2024(asked.speed), "gear": asked.gear, "recovery": asked.recovery / 100}
    standby_w = numbers.pop("standby_w")
    return Drive(**numbers), standby_w


def phases_of(drive: Drive, asked: Asked) -> list[tuple[str, Phase]]:
    """The drive from rest to rest: the distance, half of it after the turn on the spot when there is one."""
    words = ("speeding up", "cruising", "braking")
    legs = 2 if asked.turn else 1
    leg = list(zip(words, trapezoid(drive, asked.distance / legs), strict=True))
    turn = rotation(math.radians(asked.turn), asked.turning * asked.turn / 90) if asked.turn else ()
    found = [*leg, *(("turning", phase) for phase in turn), *(leg if legs == 2 else ())]
    return [(word, phase) for word, phase in found if phase.duration_s > 0]


@dataclass(frozen=True)
class Run:
    """One drive, sampled: its trace, what each sample is about, and the battery, or why it can't do it."""

    asked: Asked
    drive: Drive
    standby_w: float
    mass_kg: float
    dt_s: float
    trace: Trace
    doing: list[str]
    battery: Discharge | None
    terminal_v: F64 | None
    refused: str


def run(asked: Asked) -> Run:
    """Drives what is asked for."""
    drive, standby_w = drive_of(asked)
    mass = asked.mass + asked.load
    named = phases_of(drive, asked)
    ends = np.cumsum([phase.duration_s for _, phase in named])
    dt = DT_S * math.ceil(float(ends[-1]) / DT_S / SAMPLES)
    path = steady_trace(drive, mass, tuple(phase for _, phase in named), dt)
    each = np.minimum(np.searchsorted(ends, path.t_s, side="right"), len(named) - 1)
    one, whole = battery()
    q_ah = (1 - asked.soc / 100) * one.delivered_ah
    found, terminal, refused = None, None, ""
    try:
        found = discharge_power(one, path.power_w + standby_w, dt, whole.cells, whole.strings, q_ah)
        terminal = whole.cells * found.voltage_v
    except BadInput:
        need = float(path.power_w.max()) + standby_w
        most = float(one.voltage_v(q_ah, 0.0)) ** 2 / (4 * one.r_ohm) * whole.cells * whole.strings
        refused = (
            f"Not possible as asked: the drive needs up to {need:,.0f} W, and the battery at {asked.soc:g} % gives "
            f"{most:,.0f} W at best. The curves show what the motors would need."
            if need > most
            else "Not possible as asked: the battery is empty before the drive ends. The curves show what it needs."
        )
    doing = [named[k][0] for k in each]
    return Run(asked, drive, standby_w, mass, dt, path, doing, found, terminal, refused)


def limits(done: Run) -> list[str]:
    """What stands against this drive, in sentences: the battery's power, and the voltage that the motors need."""
    if done.terminal_v is None:
        return [done.refused]
    need = np.abs(done.trace.voltage_v).max(axis=1)
    over = need > done.terminal_v
    if not over.any():
        return []
    drive, worst = done.drive, int(np.argmax(need - done.terminal_v))
    volts = float(done.terminal_v[worst])
    rotor = float(np.abs(wheel_speeds(done)[worst]).max()) * drive.gear
    first = float(done.trace.t_s[int(np.argmax(over))])
    said = (
        f"Not possible as asked: from {first:.1f} s on, {done.doing[int(np.argmax(over))]}, the motors need up to "
        f"{need[worst]:.1f} V, and the battery gives {volts:.1f} V. The curves show what they would need."
    )
    if drive.emf_vs * rotor > volts:
        return [
            said,
            f"Even without any load a motor turns at most {volts / drive.emf_vs:,.0f} rad/s on that voltage; with gear "
            f"{drive.gear:g} the wheels would have to turn it at {rotor:,.0f} rad/s. A smaller gear or less speed "
            "helps.",
        ]
    help_ = "more time for the turn" if done.doing[worst] == "turning" else "less speed"
    return [
        said,
        f"Of these, {drive.emf_vs * rotor:.1f} V are the motor's own voltage at {rotor:,.0f} rad/s, the rest drives "
        f"{float(np.abs(done.trace.current_a[worst]).max()):.1f} A through its resistance. Less mass or {help_} helps.",
    ]


def wheel_speeds(done: Run) -> F64:
    """(N, 2) rad/s of the left and the right wheel: equation (3)."""
    return np.stack(inverse(done.trace.v_mps, done.trace.omega, done.drive.wheel_m, done.drive.track_m), axis=1)


def wheel_torque(done: Run) -> F64:
    """(N, 2) N·m of the motors at the wheels, behind the gear."""
    current, drive = done.trace.current_a, done.drive
    drives = current * wheel_speeds(done) >= 0
    gain = np.where(drives, drive.gear_efficiency, 1 / drive.gear_efficiency)
    return np.asarray(current * drive.emf_vs * drive.gear * gain)


def energy(done: Run) -> dict[Component, float]:
    """Joules by component: as the demand model `lian2024` names them."""
    path, dt = done.trace, done.dt_s
    turns = np.array([word == "turning" for word in done.doing])
    motion = path.rolling_w + path.inertia_w
    watts = {
        Component.COPPER: path.copper_w,
        Component.ROLLING: np.where(turns, 0.0, path.rolling_w),
        Component.STARTING: np.where(turns, 0.0, path.inertia_w),
        Component.TURNING: np.where(turns, motion, 0.0),
        Component.STANDBY: np.full(len(path.t_s), done.standby_w),
        Component.RECOVERED: path.recovered_w,
    }
    return {component: float(values.sum()) * dt for component, values in watts.items()}


def kinetic(done: Run) -> tuple[F64, F64]:
    """Kinetic energy of the drive at every moment, equation (7) corrected, and what the paper counts of it until then.

    A state falls again; counted as a consumption, each start adds the most that it reached.
    """
    left, right = (wheel_speeds(done) * done.drive.wheel_m).T
    state = kinetic_j(done.mass_kg, left, right)
    gained = np.maximum(np.diff(state, prepend=0.0), 0.0)
    return state, np.cumsum(gained)


def paper(done: Run) -> dict[str, float]:
    """Joules that the paper's (6)-(8) give for the drive: corrected, and with each of the printed slips."""
    top = float(np.abs(done.trace.v_mps).max())
    starts = 2 if done.asked.turn else 1
    wheel = top / done.drive.wheel_m
    mass, others = done.mass_kg, done.standby_w * len(done.trace.t_s) * done.dt_s
    return {
        "corrected": starts * float(kinetic_j(mass, top, top)) + others,
        "quarter": starts * float(kinetic_j(mass, top, top, printed=True)) + others,
        "radius": starts * float(kinetic_of_wheels_j(mass, wheel, wheel, done.drive.wheel_m, printed=True)) + others,
    }


# -- the answer -------------------------------------------------------------------------------------------------------


def answer(query: Query) -> dict[str, Any]:
    """Curves over the drive, its energy by component, and what the paper's formula says. Raises BadInput."""
    asked = read(query)
    done = run(asked)
    path = done.trace
    keep = np.unique(np.linspace(0, len(path.t_s) - 1, min(SHOWN, len(path.t_s))).astype(int))
    parts = energy(done)
    total = sum(parts.values())
    state, counted = kinetic(done)
    wheels, torque = wheel_speeds(done), wheel_torque(done)
    others = done.standby_w * done.dt_s * np.arange(1, len(path.t_s) + 1)
    curves: dict[str, F64] = {
        "t": path.t_s,
        "v": path.v_mps,
        **{f"wheel_{side}": wheels[:, i] for i, side in enumerate("lr")},
        **{f"torque_{side}": torque[:, i] for i, side in enumerate("lr")},
        **{f"current_{side}": path.current_a[:, i] for i, side in enumerate("lr")},
        **{f"voltage_{side}": path.voltage_v[:, i] for i, side in enumerate("lr")},
        "copper": path.copper_w,
        "rolling": path.rolling_w,
        "inertia": path.inertia_w,
        "standby": np.full(len(path.t_s), done.standby_w),
        "recovered": path.recovered_w,
        "ours": np.cumsum(path.power_w + done.standby_w) * done.dt_s,
        "paper": counted + others,
        "kinetic": state,
    }
    used = 0.0
    if done.battery is not None and done.terminal_v is not None:
        soc = done.battery.counted_soc
        curves |= {
            "terminal": done.terminal_v,
            "soc": 100 * soc,
            "drawn": done.battery.current_a * battery()[1].strings,
        }
        used = asked.soc / 100 - float(soc[-1])
    return {
        "curves": {name: [round(float(x), 4) for x in values[keep]] for name, values in curves.items()},
        "doing": [done.doing[k] for k in keep],
        "limits": limits(done),
        "energy": {str(component.name).lower(): round(parts[component], 3) for component in COMPONENTS},
        "total": total,
        "share": motors_share(parts),
        "paper": paper(done),
        "duration": len(path.t_s) * done.dt_s,
        "used": used,
        "drives": int(1 / used) if used > 0 else None,
    }


# -- the page ---------------------------------------------------------------------------------------------------------

USUAL = {"mass": "500", "load": "0", "gear": "30", "speed": "1.0", "distance": "10", "turn": "0", "turning": "1.0",
         "recovery": "0", "soc": "80"}  # fmt: skip

PRESETS = (
    Preset(
        "Straight on",
        USUAL,
        "Play the drive. Speeding up takes most of the current, and copper loss grows with its square; cruising takes "
        "little, but all the way. Move one slider at a time and watch the table.",
    ),
    Preset(
        "The printed turn",
        {**USUAL, "turn": "90"},
        "90° in the printed 1.0 s: the motors could, on the battery's nominal 25.9 V. But they draw 2 kW for a moment, "
        "and under that current the battery's voltage gives way. Take more time for the turn.",
    ),
    Preset(
        "Light and geared down",
        {**USUAL, "mass": "100", "gear": "20"},
        "The paper says that motors take more than 80 %. That depends on the vehicle: with 100 kg and gear 20 the "
        "sensors and the controller take nearly as much. Move the mass and watch the share.",
    ),
    Preset(
        "Too fast for the gear",
        {**USUAL, "speed": "2.5"},
        "A turning motor is a source itself: C·Ω grows with gear and speed. Where it passes the battery's voltage no "
        "current flows. Lower the gear: now it takes more current. This vehicle has no gear for 2.5 m/s.",
    ),
    Preset(
        "Metres for nothing",
        {**USUAL, "distance": "40"},
        "In the paper's formula each start costs ½ m v², and the way nothing: 40 m take what 4 m take, but for the "
        "standby. Kinetic energy (dashed) is a state: it is there while driving and gone after braking.",
    ),
    Preset(
        "Recovered",
        {**USUAL, "gear": "45", "recovery": "100"},
        "Now the motors brake and give current back. It is less than the kinetic energy: rolling takes its share, then "
        "the gear, then the copper, and below some speed nothing is left. A larger gear helps: less current.",
    ),
    Preset(
        "Nearly empty",
        {**USUAL, "speed": "1.2", "soc": "1"},
        "With 80 % this drive is possible. At the end of its charge the battery's voltage falls steeply, most of all "
        "under load, and the same motors no longer reach the same speed.",
    ),
)


def text() -> Sequence[Any]:
    """What stands beside the curves."""
    numbers = parameter_sets.lian2024()
    one, whole = battery()
    return [
        html.H3("From wheel to battery"),
        html.P(
            "Wheels: ω = (v ∓ ½ d ψ̇)/r (eq. 3), left and right. Force on each: rolling resistance ½ μ m g and what "
            "accelerates or turns the mass. Motor: torque through the gear, current i = τ/C."
        ),
        html.P(
            "Voltage: U = R i + C Ω (eq. 4, with Ω the rotor's speed; the inductance is settled within hundredths of a "
            "second). Power U i = copper R i² + shaft C Ω i. The sum over both motors, with the others' "
            f"{numbers['standby_w']:.0f} W, is what the battery gives."
        ),
        html.P(
            f"Battery: {whole.cells} lithium cells of {one.rated_ah:g} Ah. V = E₀ − K·Q/(Q−q)·(q + i*) + A·e^(−Bq) − "
            "R i; the state of charge counts coulombs over the delivered "
            f"{one.delivered_ah:.2f} Ah."
        ),
        html.H3("The paper's formula"),
        html.P(
            "E = ½ m v² + P·t takes the motion's energy for the consumption, (6)–(8). Equation (7) prints ¼ m (v_l + "
            "v_r)² for it, twice the energy, and then ¼ m r (ω_l + ω_r)², with r not squared; right is ⅛ m r² (ω_l + "
            "ω_r)². Friction, copper and turning are in none of them."
        ),
        html.H3("Which numbers"),
        html.P(
            f"Printed: R = {numbers['resistance_ohm']:g} Ω, C = {numbers['emf_vs']:g} V·s/rad, 90° in 1.0 s, 6 Ah. "
            f"Assumed: μ = {numbers['mu']:g}, wheels of {numbers['wheel_m']:g} m radius, {numbers['track_m']:g} m "
            f"apart, gear efficiency {100 * numbers['gear_efficiency']:.0f} %, ±{numbers['accel_mps2']:g} m/s², the "
            "cell's constants, and what the sliders begin with.",
            className="wl-hint",
        ),
    ]


LESSON = Lesson(
    title="Motor to battery",
    summary="One drive of a vehicle on two DC motors: wheel speeds and torque, current, voltage, power and state of "
    "charge, for any mass, gear and speed; the energy by component beside the paper's kinetic formula.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={"sliders": {name: asdict(slider) for name, slider in SLIDERS.items()}},
)
