"""Two wheels and two motors: kinematics, the electrical balance, and energies that add up."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from engine.energy import cost_table
from engine.energy.drive import (
    Drive,
    Joules,
    Phase,
    cruise,
    forward,
    inverse,
    joules_of,
    kinetic_j,
    kinetic_of_wheels_j,
    rotation,
    run_motor,
    steady_trace,
    trace,
    trapezoid,
)
from engine.energy.lian2024 import MOTORS, Lian2024, lian2024, lian2024_paper, motors_share
from engine.energy.parameter_sets import lian2024 as numbers
from engine.errors import BadInput
from engine.types import Component
from engine.world.motion_graph import Primitive

SPEEDS = st.floats(-5, 5)
STRAIGHT = Primitive("straight", 900, 0, False, False, 9)
START = Primitive("start straight", 900, 0, True, False, 9)
PIVOT = Primitive("pivot", 0, 90, False, True, 10)


def model(**changes: float) -> Lian2024:
    return lian2024(**{**numbers(), **changes})


def drive(**changes: float) -> Drive:
    return model(**changes).drive


# ---------------------------------------------------------------- kinematics


@given(SPEEDS, SPEEDS, st.floats(0.02, 0.5), st.floats(0.1, 2))
def test_forward_and_inverse_undo_each_other(v: float, omega: float, wheel_m: float, track_m: float) -> None:
    rates = inverse(v, omega, wheel_m, track_m)
    assert forward(rates[0] * wheel_m, rates[1] * wheel_m, track_m) == pytest.approx((v, omega), abs=1e-9)
    again = inverse(*forward(v, omega, track_m), wheel_m, track_m)
    assert [w * wheel_m for w in again] == pytest.approx([v, omega], abs=1e-9)


def test_counter_clockwise_is_positive_and_the_printed_sign_is_not_the_inverse() -> None:
    assert forward(-0.2, 0.2, 0.5) == pytest.approx((0.0, 0.8))
    assert forward(-0.2, 0.2, 0.5, printed=True) == pytest.approx((0.0, -0.8))
    rates = inverse(0.0, 0.8, 0.1, 0.5)
    assert forward(rates[0] * 0.1, rates[1] * 0.1, 0.5, printed=True)[1] == pytest.approx(-0.8)


@given(st.floats(1, 2000), SPEEDS, SPEEDS)
def test_the_kinetic_energy_is_that_of_the_centre_and_the_printed_one_is_not(mass: float, a: float, b: float) -> None:
    v = forward(a, b, 0.5)[0]
    assert kinetic_j(mass, a, b) == pytest.approx(0.5 * mass * v**2)
    assert kinetic_of_wheels_j(mass, a / 0.1, b / 0.1, 0.1) == pytest.approx(0.5 * mass * v**2)
    assert kinetic_j(mass, a, b, printed=True) == pytest.approx(mass * v**2)
    assert kinetic_of_wheels_j(mass, a / 0.1, b / 0.1, 0.1, printed=True) == pytest.approx(mass * v**2 / 0.1)


# ---------------------------------------------------------------- motor


@pytest.mark.parametrize(
    ("mass", "gear", "current", "voltage", "power"),
    [(100, 20, 1.32, 7.19, 19.0), (500, 30, 4.41, 11.97, 105.6), (1000, 40, 6.62, 16.3, 216.0)],
)
def test_motors_at_cruising_speed(mass: float, gear: float, current: float, voltage: float, power: float) -> None:
    point = cruise(drive(gear=gear), mass)
    assert point.current_a == pytest.approx(current, abs=0.005)
    assert point.voltage_v == pytest.approx(voltage, rel=2e-3)
    assert point.power_w == pytest.approx(power, rel=2e-3)
    assert point.efficiency == pytest.approx(0.015 * mass * 9.81 / point.power_w)


@given(st.floats(2, 40), st.floats(5, 60), st.floats(0.0, 0.3), st.floats(1e-4, 1e-2))
@settings(max_examples=10)
def test_power_in_is_copper_shaft_and_field(volts: float, rad_s: float, load_nm: float, inertia: float) -> None:
    run = run_motor(drive(), lambda t: volts * (1 + 0.5 * math.sin(rad_s * t)), 0.3, inertia, load_nm, (3.0, 20.0))
    scale = np.abs(run.input_j).max() + 1e-3
    assert run.input_j == pytest.approx(run.copper_j + run.shaft_j + run.field_j, abs=1e-6 * scale)
    # what reaches the shaft moves the rotor against its load
    turned = np.concatenate([[0.0], np.cumsum((run.rotor_rad_s[1:] + run.rotor_rad_s[:-1]) / 2 * np.diff(run.t_s))])
    gained = 0.5 * inertia * (run.rotor_rad_s**2 - 20.0**2)
    assert run.shaft_j == pytest.approx(gained + load_nm * turned, abs=5e-3 * scale)


def test_a_motor_reaches_what_its_numbers_say() -> None:
    d = drive()
    free = run_motor(d, lambda t: 24.0, 1.0, 1e-4)
    assert free.rotor_rad_s[-1] * 60 / (2 * math.pi) == pytest.approx(7009, abs=1)
    assert free.current_a[-1] == pytest.approx(0.0, abs=1e-3)
    held = run_motor(d, lambda t: 24.0, 10 * 0.0044 / 0.4898, 1e6, samples=11)
    assert held.current_a[-1] == pytest.approx(49.0, abs=0.01)
    assert held.current_a[1] / (24 / 0.4898) == pytest.approx(1 - math.exp(-1), abs=1e-6)
    # turning steadily against a cruising vehicle's torque it takes what the quasi-static model says
    point = cruise(d, 500.0)
    loaded = run_motor(d, lambda t: point.voltage_v, 2.0, 1e-4, point.current_a * d.emf_vs)
    assert loaded.current_a[-1] == pytest.approx(point.current_a, rel=1e-6)
    assert loaded.rotor_rad_s[-1] == pytest.approx(point.rotor_rad_s, rel=1e-6)
    with pytest.raises(BadInput, match="without inductance"):
        run_motor(drive(inductance_h=0.0), lambda t: 1.0, 1.0, 1.0)


# ---------------------------------------------------------------- profiles


def by_hand(d: Drive, mass: float, distance: float) -> Joules:
    """A trapezoid without recovery in closed form, braking harder than rolling resistance does."""
    a, b, v, drag = d.accel_mps2, d.brake_mps2, d.v_mps, d.mu * mass * d.g

    def copper(force: float, seconds: float) -> float:
        current = force / 2 * d.wheel_m / d.gear / d.gear_efficiency / d.emf_vs
        return 2 * d.resistance_ohm * current**2 * seconds

    level = distance - v * v / 2 * (1 / a + 1 / b)
    return Joules(
        copper(drag + mass * a, v / a) + copper(drag, level / v),
        drag * (v * v / 2 / a + level) / d.gear_efficiency,
        0.5 * mass * v * v / d.gear_efficiency,
    )


@given(st.floats(50, 1500), st.floats(0.2, 1.5), st.floats(0.2, 1.5), st.floats(0.3, 2.0), st.floats(0.01, 30))
@settings(max_examples=25)
def test_a_trapezoid_has_its_closed_form(mass: float, a: float, b: float, v: float, more: float) -> None:
    d = drive(accel_mps2=a, brake_mps2=b, v_mps=v)
    distance = v * v / 2 * (1 / a + 1 / b) + more
    phases = trapezoid(d, distance)
    path = trace(d, mass, phases)
    assert path.v_mps @ path.dt_s == pytest.approx(distance)
    got, expected = joules_of(path), by_hand(d, mass, distance)
    for part in ("copper", "rolling", "inertia", "recovered"):
        assert getattr(got, part) == pytest.approx(getattr(expected, part), rel=1e-9, abs=1e-9)


def test_a_short_way_is_a_triangle() -> None:
    d = drive(accel_mps2=0.5, brake_mps2=1.0)
    phases = trapezoid(d, 0.3)
    path = trace(d, 500.0, phases)
    assert phases[1].duration_s == 0
    assert path.v_mps @ path.dt_s == pytest.approx(0.3)
    assert path.v_mps.max() < 1.0


@pytest.mark.parametrize(("recovery", "phases"), [
    (0.6, trapezoid(drive(), 3.0)), (0.6, rotation(1.7, 1.1)), (0.0, rotation(1.7, 1.1, 1.0)),
    (0.6, rotation(3.0, 0.9, 0.3)),
])  # fmt: skip
def test_halving_the_step_quarters_the_error(recovery: float, phases: tuple[Phase, ...]) -> None:
    d = drive(recovery=recovery)

    def total(samples: int) -> float:
        return joules_of(trace(d, 500.0, phases, samples)).total

    fine = total(40_000)
    errors = [abs(total(n) - fine) for n in (8, 32, 128)]
    assert errors[2] < 2e-4 * abs(fine)
    # kinks, where the friction brake takes over, fall between samples, so that single steps may differ
    assert errors[2] <= errors[0] / 30 + 1e-6 * abs(fine)


@given(st.floats(50, 1500), st.integers(3, 30), st.floats(0, 1), st.floats(0.2, 1.0), st.lists(st.integers(1, 3)))
@settings(max_examples=25)
def test_primitives_of_a_drive_sum_to_its_trapezoid(
    mass: float, pieces: int, recovery: float, accel: float, cuts: list[int]
) -> None:
    demand = model(recovery=recovery, accel_mps2=accel, brake_mps2=0.4)
    parts = [START, *[STRAIGHT] * pieces] + [replace(STRAIGHT, length_mm=450 * cut) for cut in cuts]
    assume(sum(p.length_mm for p in parts) > 500 / accel + 1250)
    whole = joules_of(trace(demand.drive, mass, trapezoid(demand.drive, sum(p.length_mm for p in parts) / 1000)))
    got: dict[Component, float] = {}
    for part in parts:
        for component, joules in demand.joules(part, mass, 0.9).items():
            got[component] = got.get(component, 0.0) + joules
    assert got[Component.COPPER] == pytest.approx(whole.copper)
    assert got[Component.ROLLING] + got[Component.STARTING] == pytest.approx(whole.rolling + whole.inertia)
    assert got.get(Component.RECOVERED, 0.0) == pytest.approx(whole.recovered, abs=1e-9)


@given(st.floats(50, 1500), st.floats(0, 1), st.floats(0.1, 3.0), st.floats(0.5, 3.0), st.floats(0, 1.5))
@settings(max_examples=25)
def test_what_motors_draw_is_voltage_times_current(
    mass: float, recovery: float, angle: float, seconds: float, v: float
) -> None:
    for phases in (rotation(angle, seconds, v), trapezoid(drive(), 4.0)):
        d = drive(recovery=recovery)
        path = trace(d, mass, phases)
        electric = path.voltage_v * path.current_a
        flows = np.where(electric > 0, electric, recovery * electric).sum(axis=1)
        assert path.power_w == pytest.approx(flows, abs=1e-9 * (1 + np.abs(flows).max()))
        assert (path.recovered_w <= 0).all()
        assert joules_of(path).total <= joules_of(trace(drive(), mass, phases)).total + 1e-9
        # both wheels belong to one body
        rims = [
            (path.voltage_v - d.resistance_ohm * path.current_a)[:, k] / d.emf_vs / d.gear * d.wheel_m for k in (0, 1)
        ]
        speed, rate = forward(*rims, d.track_m)
        assert speed == pytest.approx(path.v_mps, abs=1e-9)
        assert rate == pytest.approx(path.omega, abs=1e-9)


@pytest.mark.parametrize("phases", [trapezoid(drive(), 3.7), rotation(1.5, 1.0, 0.8), (Phase(0.4, 1.0), Phase(0.0))])
def test_a_motion_over_equal_steps_is_the_same_motion(phases: tuple[Phase, ...]) -> None:
    d = drive(recovery=0.5)
    path = steady_trace(d, 500.0, phases, 1e-4)
    assert path.t_s[-1] + 5e-5 == pytest.approx(sum(p.duration_s for p in phases), abs=1e-4)
    assert (path.dt_s == 1e-4).all()
    assert joules_of(path).total == pytest.approx(joules_of(trace(d, 500.0, phases)).total, rel=2e-3)


def test_without_losses_all_that_is_left_is_rolling() -> None:
    ideal = drive(recovery=1.0, gear_efficiency=1.0, resistance_ohm=1e-12)
    assert joules_of(trace(ideal, 500.0, trapezoid(ideal, 7.0))).total == pytest.approx(0.015 * 500 * 9.81 * 7.0)
    slick = replace(ideal, mu=0.0)
    assert joules_of(trace(slick, 500.0, rotation(math.pi / 2, 1.0))).total == pytest.approx(0.0, abs=1e-6)


def test_the_default_vehicle_can_do_what_its_profiles_ask() -> None:
    d = drive()
    for phases in (trapezoid(d, 9.0), rotation(math.pi / 2, 1.0)):
        path = trace(d, 500.0, phases)
        assert np.abs(path.current_a).max() < 24 / d.resistance_ohm
        assert np.abs(path.voltage_v).max() < 25.9
    wide = trace(drive(length_m=0.6), 500.0, rotation(math.pi / 2, 1.0))
    assert np.abs(wide.voltage_v).max() == pytest.approx(29.0, abs=0.1)


# ---------------------------------------------------------------- demand


def drive_of(demand: Lian2024, mass: float, arcs: int = 10) -> dict[Component, float]:
    """Arcs from rest to rest by component, with the others' power over the time that a vehicle takes for it."""
    out: dict[Component, float] = {}
    for part in [START, *[STRAIGHT] * (arcs - 1)]:
        for component, joules in demand.joules(part, mass, 0.9).items():
            out[component] = out.get(component, 0.0) + joules
    return {**out, Component.STANDBY: demand.standby_w * (0.9 * arcs + demand.lost_s)}


def test_the_share_of_the_motors() -> None:
    heavy, light = model(), model(gear=20.0)
    cruising = {**heavy.joules(STRAIGHT, 500.0, 0.9), Component.STANDBY: 18.0}
    assert motors_share(cruising) == pytest.approx(0.841, abs=1e-3)
    assert motors_share(drive_of(heavy, 500.0)) == pytest.approx(0.894, abs=1e-3)
    cruising = {**light.joules(STRAIGHT, 100.0, 0.9), Component.STANDBY: 18.0}
    assert motors_share(cruising) == pytest.approx(0.488, abs=1e-3)
    assert motors_share(drive_of(light, 100.0)) == pytest.approx(0.556, abs=1e-3)
    assert motors_share({}) == 0.0
    assert motors_share({Component.CHARGED: -5.0, Component.STANDBY: 1.0}) == 0.0


def test_what_primitives_cost() -> None:
    demand = model()
    arc = demand.joules(STRAIGHT, 500.0, 0.9)
    assert arc == pytest.approx({
        Component.COPPER: 2 * 0.4898 * cruise(demand.drive, 500.0).current_a ** 2 * 0.9,
        Component.ROLLING: 0.015 * 500 * 9.81 * 0.9 / 0.85,
    })  # fmt: skip
    start = demand.joules(START, 500.0, 0.9)
    assert start[Component.STARTING] == pytest.approx((250 - 0.015 * 500 * 9.81 * 1.0) / 0.85)
    assert set(demand.joules(PIVOT, 500.0, 1.0)) == {Component.COPPER, Component.TURNING}
    reverse = Primitive("reverse", 900, 180, True, False, 20)
    spot = demand.joules(replace(PIVOT, turn_deg=180), 500.0, 2.0)
    both = demand.joules(reverse, 500.0, 2.0)
    assert both[Component.TURNING] == pytest.approx(spot[Component.TURNING])
    assert both[Component.STARTING] == start[Component.STARTING]
    assert both[Component.COPPER] == pytest.approx(start[Component.COPPER] + spot[Component.COPPER])
    # two motions of half the angle and half the time turn as fast, and start and stop twice as often
    half = demand.joules(replace(PIVOT, turn_deg=45), 500.0, 0.5)
    assert half[Component.COPPER] > spot[Component.COPPER] / 4


def test_a_cost_table_takes_recovered_energy_off() -> None:
    kinds = (STRAIGHT, START, PIVOT, Primitive("turn", 706.86, 90, False, False, 9))
    plain, saving = (cost_table(kinds, model(recovery=r), [(500.0, 200.0)], 0.1) for r in (0.0, 0.6))
    assert not plain.mj[..., Component.RECOVERED].any()
    # a start carries the recovery of its stop; this quick a pivot would have to draw power to brake
    assert (saving.mj[0, :, 1, Component.RECOVERED] < 0).all()
    assert not saving.mj[0, :, 2, Component.RECOVERED].any()
    assert not saving.mj[..., 0, Component.RECOVERED].any()
    assert (saving.total_mj <= plain.total_mj).all()
    assert (saving.total_mj > 0).all()
    assert (saving.mj.sum(axis=3) == saving.total_mj).all()
    assert (plain.total_mj[0, 1] > plain.total_mj[0, 0]).all()
    assert plain.standby_mj.tolist() == [2000]
    used = {Component(c) for c in np.flatnonzero(saving.mj.any(axis=(0, 1, 2)))}
    assert used <= MOTORS


def test_the_paper_counts_kinetic_energy_once_per_start() -> None:
    paper = lian2024_paper(**numbers())
    assert paper.joules(START, 500.0, 0.9) == {Component.STARTING: 250.0}
    assert replace(paper, printed=True).joules(START, 500.0, 0.9) == {Component.STARTING: 500.0}
    assert paper.joules(STRAIGHT, 500.0, 0.9) == {}
    assert paper.joules(PIVOT, 500.0, 1.0) == {}
    assert paper.standby_w == 20.0


@pytest.mark.parametrize(("changes", "text"), [
    ({"gear": 0.0}, "gear is 0; expected a positive number"),
    ({"mu": -0.1}, "mu is -0.1"),
    ({"accel_mps2": math.nan}, "accel_mps2 is nan"),
    ({"gear_efficiency": 1.2}, "gear_efficiency is 1.2; expected a share"),
    ({"recovery": 3.0}, "recovery is 3; expected a share"),
])  # fmt: skip
def test_numbers_that_no_drive_can_have(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput, match=text):
        drive(**changes)


def test_a_motion_must_last() -> None:
    with pytest.raises(BadInput, match="without duration"):
        trace(drive(), 500.0, ())
