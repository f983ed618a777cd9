"""The motor drive and the lithium battery of Lian et al. 2024: equations, balances, and the numbers of the paper."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine import MemoryLog, judge
from engine.build import build, demand_model
from engine.energy import parameter_sets
from engine.energy.battery import POINTS
from engine.energy.drive import Drive, Motor, PaperDrive, body_speeds, drive_cycle, kinetic_j, wheel_speeds
from engine.energy.tremblay import Cell, tremblay
from engine.errors import ScenarioError
from engine.scenario import load
from engine.sim.judge.energy import costs
from engine.types import Component
from engine.world import build_world
from engine.world.motion_graph import Primitive

speeds = st.floats(-5, 5)
sizes = st.floats(0.02, 2)


def drive(**changes: float) -> Drive:
    return Drive(**{**parameter_sets.drive(), **changes})


# ---------------------------------------------------------------- kinematics and the motor


@given(speeds, speeds, sizes, sizes)
def test_forward_and_inverse_kinematics_undo_each_other(v, omega, wheel, track):
    left, right = wheel_speeds(v, omega, wheel, track)
    assert body_speeds(left, right, wheel, track) == pytest.approx((v, omega), abs=1e-9)


def test_counter_clockwise_turns_the_right_wheel_faster():
    left, right = wheel_speeds(1.0, 0.5, 0.1, 0.6)
    assert right > left
    assert body_speeds(left, right, 0.1, 0.6)[1] > 0


@given(speeds, speeds)
def test_corrected_kinetic_energy_is_half_m_v_squared_and_the_printed_one_is_not(left, right):
    v, _ = body_speeds(left, right, 0.1, 0.6)
    assert kinetic_j(500.0, left, right, 0.1) == pytest.approx(500 * v * v / 2)
    # the printed factor is twice too large and the radius stands once instead of squared
    assert kinetic_j(500.0, left, right, 0.1, printed=True) == pytest.approx(500 * v * v / 2 * 2 / 0.1)


@pytest.mark.parametrize(
    ("mass", "gear", "amps", "volts", "watts"),
    [(100.0, 20.0, 1.32, 7.19, 19.0), (500.0, 30.0, 4.41, 11.97, 105.6), (1000.0, 40.0, 6.62, 16.3, 216.0)],
)
def test_cruising_takes_the_currents_that_were_worked_out_by_hand(mass, gear, amps, volts, watts):
    model = drive(gear=gear)
    current = model.current_a(0.015 * mass * 9.81)
    voltage = model.motor.voltage(current, 1.0 / 0.1 * gear)
    assert (current, voltage) == (pytest.approx(amps, rel=5e-3), pytest.approx(volts, rel=5e-3))
    assert 2 * current * voltage == pytest.approx(watts, rel=5e-3)
    metre = Primitive("straight", 1000, 0, False, False, 10)
    assert sum(model.joules(metre, mass, 1.0).values()) == pytest.approx(2 * current * voltage, rel=1e-9)


def test_motors_take_more_than_80_percent_with_the_defaults_and_half_with_a_light_vehicle():
    metre = Primitive("straight", 1000, 0, False, False, 10)
    for mass, gear, low, high in ((500.0, 30.0, 0.8, 0.9), (100.0, 20.0, 0.4, 0.6)):
        motors = sum(drive(gear=gear).joules(metre, mass, 1.0).values())
        assert low < motors / (motors + 20.0) < high


def test_no_load_speed_and_stall_current_of_the_printed_motor():
    motor = Motor(0.4898, 0.0044, 0.0327)
    assert 24 / motor.ce_vs * 60 / (2 * math.pi) == pytest.approx(7009, abs=1)
    assert 24 / motor.r_ohm == pytest.approx(49.0, abs=0.05)
    assert motor.voltage(24 / motor.r_ohm, 0.0) == pytest.approx(24)


@given(st.floats(0.3, 8.0), st.floats(100, 1000))
def test_the_electrical_balance_holds_over_a_drive(distance, mass):
    """U·i = R·i² + C_e·Ω·i + d(½·L·i²)/dt at every moment, and energy in is energy out over the whole drive."""
    model = drive()
    c = drive_cycle(model, distance, mass, 0.002)
    stored = np.gradient(c.current_a, 0.002) * model.l_h * c.current_a * 2
    np.testing.assert_allclose(c.power_w, c.copper_w + c.shaft_w + stored, atol=1e-6 * np.abs(c.power_w).max())
    total, parts = np.trapezoid(c.power_w, c.t_s), np.trapezoid(c.copper_w + c.shaft_w, c.t_s)
    assert total == pytest.approx(parts, abs=0.02 * np.abs(parts) + 2.0)  # it ends nearly without current
    assert np.trapezoid(c.v_mps, c.t_s) == pytest.approx(distance, rel=0.02)


def test_a_primitive_costs_what_its_part_of_a_drive_costs():
    """Start and cruise of an integrated drive against the closed form, when the current follows at once."""
    model, mass, t = drive(), 500.0, np.linspace(0, 2.0, 20001)
    force = mass * model.accel_mps2 + model.mu * mass * model.g
    current = model.current_a(force)
    speed = model.accel_mps2 * t / model.wheel_m * model.gear
    up = float(np.trapezoid(2 * (model.r_ohm * current**2 + model.ce_vs * speed * current), t))
    metre = Primitive("start straight", 1000, 0, True, False, 10)
    assert sum(model.joules(metre, mass, 1.0).values()) == pytest.approx(up, rel=1e-6)


def test_braking_gives_back_no_more_than_allowed_nor_than_the_motion_takes():
    stop = Primitive("stop pivot", 0, 90, False, True, 10, True)
    plain = drive().joules(stop, 500.0, 1.0)
    assert Component.RECOVERED not in plain
    assert drive().joules(Primitive("pivot", 0, 90, False, True, 10), 500.0, 1.0) == plain
    totals = [sum(drive(regen=r).joules(stop, 500.0, 1.0).values()) for r in (0.0, 0.3, 0.6, 1.0)]
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] >= 0
    weak = drive(regen=1.0, r_ohm=1e-6)
    assert sum(weak.joules(stop, 500.0, 1.0).values()) >= 0


def test_a_pivot_in_the_printed_second_stays_below_the_stall_current():
    model = drive()
    swing = model.inertia(500.0) * (1.5 * math.pi / 2) / (1 / 3)
    force = 2 / model.track_m * (swing + model.mu * 500 * model.g * model.track_m / 2)
    assert 30 < model.current_a(force) < 49


@given(
    st.sampled_from([(900, 0, False, False), (450, 0, True, False), (0, 90, False, True), (0, 180, False, True)]),
    st.floats(50, 1500),
    st.floats(0, 1),
    st.floats(0.2, 2),
    st.booleans(),
)
def test_the_judge_s_formulae_give_the_same(kind, mass, regen, accel, stops):
    length, turn, starts, pivot = kind
    scenario = load("lian2024", {"energy.parameters": {"regen": regen, "accel_mps2": accel}, "fleet.mass_kg": mass})
    primitive = Primitive("p", length, turn, starts, pivot, 10 if pivot else length // 100, stops and pivot)

    class Graph:
        primitives = (primitive,)

    model = demand_model("drive", scenario)
    mine = model.joules(primitive, mass, primitive.ticks * 0.1)
    for component, value in enumerate(costs(scenario, Graph())[0, 0].tolist()):
        assert value == pytest.approx(1000 * mine.get(Component(component), 0.0), abs=1.01)


def test_the_paper_s_account_charges_kinetic_energy_and_lets_turns_be_free():
    model = PaperDrive(**parameter_sets.drive_paper())
    metre, pivot = Primitive("straight", 1000, 0, False, False, 10), Primitive("pivot", 0, 90, False, True, 10)
    assert model.joules(metre, 500.0, 1.0) == {Component.RUNNING: pytest.approx(250.0)}
    assert model.joules(pivot, 500.0, 1.0) == {}


# ---------------------------------------------------------------- battery


def test_the_discharge_curve_has_the_three_zones_of_figure_2():
    t, volts, taken = Cell().discharge(8.0)
    minutes = t / 60
    assert 49.5 < minutes[-1] < 50.6
    assert taken[-1] == pytest.approx(6.67, abs=0.06)
    assert (np.diff(volts) < 0).all()

    def slope(a: float, b: float) -> float:
        return float(np.interp(b, minutes, volts) - np.interp(a, minutes, volts)) / (b - a) * 1000

    first, stable, last = slope(0, 2.5), slope(2.5, 49), slope(49, minutes[-1])
    assert first == pytest.approx(-45, abs=5)
    assert stable == pytest.approx(-12, abs=2)
    assert last < -300


def test_rated_and_delivered_charge_are_two_numbers():
    cell = Cell()
    assert cell.rated_ah == 6.0
    assert cell.usable_ah == pytest.approx(8 * 50 / 60, abs=1e-3)


@given(st.floats(0.34, 6.5), st.floats(0.5, 10))
def test_voltage_tells_the_charge_in_the_stable_zone(taken, amps):
    cell = Cell()
    assert cell.taken_from_voltage(cell.voltage_v(taken, amps), amps) == pytest.approx(taken, abs=1e-4)


def test_outside_the_stable_zone_the_two_estimates_part():
    cell = Cell()
    inside, outside = 3.0, 0.05
    by_volts = cell.soc_by_voltage(cell.voltage_v(inside, 8.0), 8.0)
    assert by_volts == pytest.approx(cell.soc_by_counting(inside), abs=1e-6)
    clamped = cell.soc_by_voltage(cell.voltage_v(outside, 8.0), 8.0)
    assert cell.soc_by_counting(outside) - clamped == pytest.approx((0.333 - 0.05) / 6.667, abs=1e-6)


def test_charging_keeps_the_current_and_then_the_voltage():
    t, volts, amps, left = Cell().cc_cv(5.0)
    constant = amps >= 2.999
    assert constant[0]
    assert (np.diff(constant.astype(int)) <= 0).all()
    assert volts.max() <= 4.2 + 1e-9
    assert volts[~constant] == pytest.approx(4.2, abs=2e-2) if (~constant).any() else True
    assert left[-1] < 0.05 or amps[-1] < 0.35
    assert (np.diff(left) < 0).all()
    assert float(np.trapezoid(amps, t)) / 3600 == pytest.approx(5.0 - left[-1], abs=0.01)


def test_a_pack_is_a_table_from_empty_to_full():
    pack = tremblay(155.4, 25.9)
    assert len(pack.voltage_mv) == POINTS
    assert (np.diff(pack.voltage_mv) >= 0).all()
    assert pack.capacity_mc == pytest.approx(6.667 * 3600 * 1000, rel=1e-3)
    assert pack.voltage_mv[POINTS // 2] == pytest.approx(25_000, rel=0.05)
    assert tremblay(310.8, 25.9).capacity_mc == pytest.approx(2 * pack.capacity_mc, rel=1e-6)
    with pytest.raises(ScenarioError, match="at least one cell"):
        tremblay(10.0, 1.0)


# ---------------------------------------------------------------- in a run


def test_a_run_swaps_batteries_at_entrances_strands_nobody_and_adds_up():
    log = MemoryLog()
    changes = {"battery.capacity_wh": 60.0, "battery.initial_soc": [0.3, 0.4], "log.sample_s": 5.0}
    sim = build(load("lian2024", changes), recorder=log)
    sim.advance(3000)
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    events = log.table("events")
    swapped = [v for v, kind in zip(events["vehicle"], events["kind"], strict=True) if kind == "battery changed"]
    assert len(swapped) > 5
    assert sim.metrics()["stranded"] == 0
    ledger = sim.fleet.ledger.sum(axis=0)
    assert ledger[Component.COPPER] > ledger[Component.ROLLING] > 0
    assert ledger[Component.STANDBY] == 29 * 3000 * 2000
    assert build_world(sim.scenario).n_places == sim.world.n_places
