"""Batteries at entrances: charged there, swapped or left alone, and what the judge says of charge over time."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from engine import MemoryLog
from engine.build import build
from engine.energy import battery_of
from engine.errors import ScenarioError
from engine.scenario import Scenario, load
from engine.scenario.checks import check
from engine.sim.judge import BreachKind, judge
from engine.sim.judge import batteries as judged
from engine.types import Activity, StationKind, VehicleState
from engine.world import World
from tests.engine.test_judge import Changed

HOURS_3 = 108_000


@cache
def run(exchange: str) -> tuple[MemoryLog, Scenario, World, Any]:
    """Three hours of ten vehicles that begin nearly empty; at entrances they charge at 2 C."""
    scenario = load(
        "lian2024",
        {"battery.exchange": exchange, "fleet.count": 10, "battery.initial_soc": [0.25, 0.4],
         "battery.parameters": {"charge_a": 12.0}, "charging.sufficient": 0.6},
    )  # fmt: skip
    log = MemoryLog()
    sim = build(scenario, seed=3, recorder=log)
    sim.advance(HOURS_3)
    sim.flush()
    return log, scenario, sim.world, sim


def test_chargers_stand_beside_entrances_and_close_no_way() -> None:
    _, scenario, world, _ = run("charge")
    entrances = {s.place for s in world.stations_of(StationKind.ENTRANCE)}
    beside = {int(a) for a in world.lane_ends[world.chargers - world.n_nodes, 0]}  # type: ignore[attr-defined]
    assert beside == entrances
    assert len(world.chargers) == len(entrances) == 16
    assert not set(world.chargers.tolist()) & set(world.parking.tolist())
    assert len(world.parking) == 64
    assert not [f for f in check(scenario, world) if f.level != "ok"]


def test_vehicles_charge_at_entrances_for_hours() -> None:
    log, scenario, world, sim = run("charge")
    assert judge(log, scenario, world) == []
    assert sim.metrics()["stranded"] == sim.deadlocks == 0
    m, states = log.table("motions"), log.table("states")
    charging = m["kind"] == Activity.CHARGE
    assert set(m["from_place"][charging].tolist()) <= set(world.chargers.tolist())
    assert len(set(m["vehicle"][charging].tolist())) == 10
    assert (states["state"] == VehicleState.CHARGING).any()
    # orders are still carried in the last hour, on what was charged
    o = log.table("orders")
    assert ((o["tick"] > 72_000) & (o["state"] == 3)).sum() > 20
    b = log.table("battery")
    first, last = b["tick"] == 0, b["tick"] == b["tick"].max()
    assert -b["charged_mj"][last].sum() > 3 * (b["charge_mc"][first] * 26).sum() * 0.2


def test_a_battery_takes_what_its_cells_accept() -> None:
    """Between two samples of charging alone, the charge grows by the CC-CV current, standby taken off."""
    log, scenario, _, _sim = run("charge")
    b, m = log.table("battery"), log.table("motions")
    pack = battery_of(**scenario.battery.asked)
    order = np.lexsort((b["tick"], b["vehicle"]))
    vehicle, tick, charge = (b[c][order].astype(np.int64) for c in ("vehicle", "tick", "charge_mc"))
    found = 0
    for v, t0, t1 in zip(*(m[c][m["kind"] == Activity.CHARGE] for c in ("vehicle", "t0", "t1")), strict=True):
        inside = np.flatnonzero((vehicle == v) & (tick >= t0) & (tick <= t1))
        for i, j in itertools.pairwise(inside):
            at = charge[[i, j]] * 1000 // pack.capacity_mc
            watts = pack.accept_w[at[0] : at[1] + 1]
            volts = pack.voltage_mv[at[0] : at[1] + 1] / 1000
            gained_c, seconds = (charge[j] - charge[i]) / 1000, (tick[j] - tick[i]) / 10
            low, high = (watts / volts).min() * seconds, (watts / volts).max() * seconds
            assert low * 0.999 - 1 <= gained_c <= high * 1.001 + 1
            found += 1
    assert found > 50


def test_without_exchange_they_end_stranded_and_the_checks_warn() -> None:
    log, scenario, world, sim = run("off")
    assert any("an empty battery stays empty" in f.text for f in check(scenario, world) if f.level == "warning")
    assert sim.metrics()["stranded"] == 10
    assert judge(log, scenario, world) == []


def test_swapped_batteries_are_judged_too() -> None:
    log, scenario, world, sim = run("swap")
    assert judge(log, scenario, world) == []
    assert (log.table("events")["kind"] == "battery changed").sum() > 20
    assert sim.metrics()["stranded"] == 0


def test_a_drawn_floor_has_chargers_of_its_own() -> None:
    with pytest.raises(ScenarioError, match=r"battery\.exchange.*draw chargers"):
        load("soochow2022-continuous", {"battery.exchange": "charge"})
    assert load("soochow2022", {"battery.exchange": "none"}).battery.exchange == "off"


@pytest.mark.parametrize("model", ["linear", "coulomb", "tremblay"])
def test_the_judge_knows_the_same_batteries(model: str) -> None:
    scenario = load("lian2024", {"battery.model": model})
    if model == "tremblay":
        scenario = load("lian2024", {"battery.parameters": {"load_a": 3.0, "rated_ah": 5.0, "charge_v": 4.0}})
    mine, theirs = judged.battery_of(scenario), battery_of(**scenario.battery.asked)
    assert mine is not None
    assert mine.capacity_mc == theirs.capacity_mc
    assert np.abs(mine.millivolt - theirs.voltage_mv).max() <= 1
    charge = np.linspace(0, mine.capacity_mc, 777).astype(np.int64)
    np.testing.assert_allclose(mine.content_uj(charge) / 1000, theirs.energy_mj(charge), atol=2, rtol=1e-4)
    if mine.accept_w is not None:
        np.testing.assert_allclose(mine.accept_w, theirs.accept_w, rtol=1e-9)


def charge_off(b: dict[str, Any], i: int) -> None:
    b["charge_mc"][i] += 300


def voltage_off(b: dict[str, Any], i: int) -> None:
    b["voltage_mv"][i] += 2


def charged_too_fast(b: dict[str, Any], i: int) -> None:
    """A tenth more reaches the battery from here on, and the charge says so: conserved, but more than it accepts."""
    later = (b["vehicle"] == b["vehicle"][i]) & (b["tick"] >= b["tick"][i])
    more_mj = 1_800_000
    b["charged_mj"][later] -= round(more_mj / 0.92)
    b["charger_loss_mj"][later] += round(more_mj / 0.92) - more_mj
    b["charge_mc"][later] += more_mj * 1000 // b["voltage_mv"][later]


@pytest.mark.parametrize("tamper", [charge_off, voltage_off, charged_too_fast])
def test_tampering_with_the_charge_is_named(tamper: Callable[[dict[str, Any], int], None]) -> None:
    log, scenario, world, _ = run("charge")
    changed = Changed(log)
    b, m = changed["battery"], log.table("motions")
    longest = int(np.argmax(np.where(m["kind"] == Activity.CHARGE, m["t1"] - m["t0"], 0)))
    inside = (b["vehicle"] == m["vehicle"][longest]) & (b["tick"] > m["t0"][longest] + 1200)
    i = int(np.flatnonzero(inside)[0])
    tamper(b, i)
    found = judge(changed, scenario, world)  # type: ignore[arg-type]
    hit = [breach for breach in found if breach.kind is BreachKind.BATTERY and breach.tick == int(b["tick"][i])]
    assert hit
    assert hit[0].vehicles == (int(b["vehicle"][i]),)
