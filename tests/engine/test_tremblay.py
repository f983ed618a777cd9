"""A lithium cell: its curve in three zones, its charge told two ways, charging, and the pack that a vehicle carries."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.energy.battery import POINTS, battery_of
from engine.energy.drive import joules_of, steady_trace, trace, trapezoid
from engine.energy.lian2024 import lian2024
from engine.energy.parameter_sets import lian2024 as drive_numbers
from engine.energy.tremblay import (
    cell,
    charge,
    discharge,
    discharge_curve,
    discharge_power,
    pack,
    soc_of_voltage,
    tremblay,
)
from engine.errors import BadInput

ONE = cell()


def test_the_curve_falls_all_the_way_in_three_zones() -> None:
    minutes, volts, zones = discharge_curve(ONE)
    assert (np.diff(volts) < 0).all()
    assert (minutes[0], minutes[-1]) == (0.0, 50.0)
    assert [(z.name, z.from_min, z.to_min) for z in zones] == [
        ("initial", 0.0, 2.5), ("stable", 2.5, 49.0), ("end", 49.0, 50.0)
    ]  # fmt: skip
    slopes = [z.slope_mv_min for z in zones]
    assert slopes == pytest.approx([-44.8, -11.75, -585], rel=1e-3)
    # the constants are rounded; the end's slope hangs on the last digit of Q
    assert slopes == pytest.approx([-45, -12, -608], rel=0.04)
    anchors = np.interp([0.0, 2.5, 49.0, 50.0], minutes, volts) - [4.05, 3.85, 3.36, 2.75]
    assert math.sqrt(float((anchors**2).mean())) < 0.047
    for z in zones:
        a, b = np.interp([z.from_min, z.to_min], minutes, volts)
        assert 1000 * (b - a) / (z.to_min - z.from_min) == pytest.approx(z.slope_mv_min)


def test_at_half_the_current_the_zones_come_at_twice_the_time() -> None:
    minutes, _, zones = discharge_curve(ONE, 4.0, 90.0)
    assert minutes[-1] == 90.0
    assert [(z.from_min, z.to_min) for z in zones] == [(0.0, 5.0), (5.0, 90.0)]


@given(st.floats(0.01, 12), st.floats(0, 6.6), st.floats(1e-3, 0.05))
def test_voltage_falls_with_charge_and_with_current(current: float, q: float, more: float) -> None:
    here = float(ONE.voltage_v(q, current))
    assert float(ONE.voltage_v(q + more, current)) < here
    assert float(ONE.voltage_v(q, current + more)) < here
    assert float(ONE.charging_v(q, current)) > float(ONE.voltage_v(q, 0.0)) > here


def test_rated_and_delivered_are_two_numbers() -> None:
    assert ONE.delivered_ah / ONE.rated_ah == pytest.approx(1.111, abs=1e-3)
    run = discharge(ONE, np.full(3000, 8.0), 1.0)
    assert run.t_s[-1] == 3000
    assert run.counted_soc[-1] == pytest.approx(0.0, abs=1e-12)
    # a counter that trusts the label shows empty after 45 minutes, with a tenth still to come
    empty = int(np.argmax(run.counted_rated_soc <= 1e-9))
    assert run.t_s[empty] == 2700
    assert run.counted_soc[empty] == pytest.approx(0.1)
    seven = pack(ONE, 155.4, 25.9)
    assert (seven.cells, seven.strings) == (7, pytest.approx(1.0))
    assert (seven.rated_ah, seven.delivered_ah) == (pytest.approx(6.0), pytest.approx(20 / 3))
    assert seven.rated_wh == 155.4
    assert seven.delivered_wh == pytest.approx(169.4, abs=0.1)
    assert pack(ONE, 2 * 155.4, 25.9).strings == pytest.approx(2.0)


@given(st.floats(8 * 2.5 / 60, 8 * 49 / 60), st.floats(0, 10))
def test_in_the_stable_zone_voltage_tells_the_charge(q: float, current: float) -> None:
    soc, inside = soc_of_voltage(ONE, ONE.voltage_v(q, current), current)
    assert float(soc) == pytest.approx(1 - q / ONE.delivered_ah, abs=1e-9)
    margin = min(q - ONE.stable_from_ah, ONE.stable_to_ah - q)
    assert bool(inside) or margin < 1e-9


def test_outside_the_zone_the_reading_stops_at_its_end() -> None:
    soc, inside = soc_of_voltage(ONE, np.array([4.2, 3.6, 2.0]), 8.0)
    assert soc[[0, 2]] == pytest.approx([0.95, 0.02])
    assert inside.tolist() == [False, True, False]


def test_both_ways_agree_under_a_steady_current_and_err_under_a_changing_one() -> None:
    steady = discharge(ONE, np.full(3000, 8.0), 1.0, slow_a=8.0)
    assert np.abs(steady.error[steady.stable]).max() < 1e-9
    assert steady.stable.sum() == pytest.approx(46.5 * 60, abs=2)
    rough = discharge(ONE, np.random.default_rng(1).uniform(0, 10, 4000), 1.0)
    off = np.abs(rough.error[rough.stable])
    assert 0.01 < off.max() < 0.15
    # the error is the low pass alone: a reading that knew i* would be exact
    known = ONE.voltage_v(rough.q_ah, rough.current_a, rough.current_a)
    told, _ = soc_of_voltage(ONE, known, rough.current_a)
    assert told[rough.stable] == pytest.approx(rough.counted_soc[rough.stable], abs=1e-9)


def test_the_low_pass_forgets_with_its_time_constant() -> None:
    run = discharge(ONE, np.full(60, 8.0), 0.5, slow_a=2.0)
    assert run.slow_a == pytest.approx(8.0 - 6.0 * np.exp(-run.t_s / 30.0))
    slow = 2.0
    by_hand = []
    for i in (1.0, 5.0, 0.0, 8.0):
        slow += (1 - math.exp(-0.5 / 30)) * (i - slow)
        by_hand.append(slow)
    assert discharge(ONE, [1.0, 5.0, 0.0, 8.0], 0.5, slow_a=2.0).slow_a == pytest.approx(by_hand)


def test_a_drive_takes_its_joules_from_the_pack() -> None:
    d = lian2024(**drive_numbers()).drive
    phases = trapezoid(d, 9.0)
    power = steady_trace(d, 500.0, phases, 0.01).power_w + 20.0
    run = discharge_power(ONE, power, 0.01, 7)
    assert float(power.sum() * 0.01) == pytest.approx(joules_of(trace(d, 500.0, phases)).total + 220, rel=2e-3)
    assert run.voltage_v * run.current_a * 7 == pytest.approx(power, rel=1e-3)
    assert run.q_ah[-1] == pytest.approx(float(run.current_a.sum()) * 0.01 / 3600)
    assert (np.diff(run.counted_soc) < 0).all()
    double = discharge_power(ONE, 2 * power, 0.01, 7, 2.0)
    assert double.current_a == pytest.approx(run.current_a)


@pytest.mark.parametrize("missing", [20 / 3, 3.0, 0.5])
def test_charging_holds_the_current_and_then_the_voltage(missing: float) -> None:
    run = charge(ONE, missing, 1.0)
    held = run.held
    assert run.ended == "current"
    assert (run.current_a[~held] == 3.0).all()
    assert (run.voltage_v <= 4.1 + 1e-9).all()
    assert run.voltage_v[held] == pytest.approx(4.1)
    assert (np.diff(run.current_a[held]) < 0).all()
    assert run.current_a[-1] <= 0.3 < run.current_a[-2]
    assert run.q_ah[0] - run.q_ah[-1] == pytest.approx(float(run.current_a[:-1].sum()) / 3600)
    assert float(ONE.soc(run.q_ah[-1])) > 0.999
    assert 0.97 < float(ONE.soc(run.q_ah[int(np.argmax(held))])) < 0.99
    assert charge(ONE, 0.0).ended == "full"


def test_at_the_usual_voltage_these_constants_fill_up_under_full_current() -> None:
    run = charge(cell(charge_v=4.2), 20 / 3)
    assert run.ended == "full"
    assert not run.held.any()
    assert run.voltage_v.max() == pytest.approx(4.148, abs=1e-3)
    assert run.t_s[-1] == pytest.approx(3600 * 20 / 9, abs=1)


def test_the_battery_of_a_scenario() -> None:
    pack_ = tremblay(155.4, 25.9)
    assert pack_.capacity_mc == 24_000_000  # 6.667 Ah
    assert (np.diff(pack_.voltage_mv) >= 0).all()
    assert pack_.voltage_mv.shape == pack_.accept_w.shape == (POINTS,)
    q = np.linspace(0, 20 / 3, 5001)
    by_hand = 7 * float(np.trapezoid(ONE.voltage_v(q, 5.0), q))
    assert pack_.energy_mj(pack_.capacity_mc) / 3.6e6 == pytest.approx(by_hand, rel=1e-4)
    # it takes half its rated current until the charger holds the voltage, and never nothing
    current = pack_.accept_w / (pack_.voltage_mv / 1000)
    assert current[:975] == pytest.approx(3.0, rel=1e-4)
    assert (np.diff(current[985:999]) < 0).all()
    assert current.min() == pytest.approx(0.3, rel=1e-3)
    assert (pack_.accept_mj(0.1) > 0).all()
    bigger = tremblay(1554.0, 25.9)
    assert bigger.capacity_mc == 240_000_000
    assert (bigger.voltage_mv == pack_.voltage_mv).all()
    assert bigger.accept_w == pytest.approx(10 * pack_.accept_w)
    assert (tremblay(155.4, 25.9, load_a=8.0).voltage_mv < pack_.voltage_mv).all()
    assert tremblay(155.4, 25.9, delivered_ah=6.6).capacity_mc == 23_760_000
    assert battery_of("tremblay", 155.4, 25.9, {"charge_a": 6.0}).accept_w[500] == pytest.approx(
        2 * pack_.accept_w[500]
    )
    assert tremblay(310.8, 51.8).capacity_mc == 24_000_000


@pytest.mark.parametrize(("changes", "text"), [
    ({"r_ohm": -1.0}, "r_ohm is -1; expected a positive number"),
    ({"lag_s": math.inf}, "lag_s is inf"),
    ({"delivered_ah": 7.0}, "delivers 7 Ah; expected less than its q_ah, 6.729"),
    ({"stable_to_ah": 6.7}, "stable zone is 0.333333 to 6.7 Ah; expected an interval"),
])  # fmt: skip
def test_numbers_that_no_cell_can_have(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput, match=text):
        cell(**changes)


def test_what_a_cell_cannot_do_is_told() -> None:
    with pytest.raises(BadInput, match=r"6.800 Ah are taken out of a cell that holds 6.729 Ah"):
        discharge(ONE, np.full(3060, 8.0), 1.0)
    with pytest.raises(BadInput, match="can't deliver 1000 W after 0 s"):
        discharge_power(ONE, 1000.0, 1.0, 1)
    with pytest.raises(BadInput, match="charger of 3 V can't charge"):
        charge(replace(ONE, charge_v=3.0), 1.0)
    with pytest.raises(BadInput, match="takes the voltage to 0"):
        tremblay(155.4, 25.9, load_a=80.0)
