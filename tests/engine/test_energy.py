"""Joules by hand, and a ledger that accounts for every millijoule at every tick."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from engine.build import build
from engine.energy import Battery, battery, battery_of, cost_table, parameters_over
from engine.energy.parameter_sets import constant, xu2025
from engine.errors import BadInput, ScenarioError
from engine.results.runlog import MemoryLog
from engine.results.view import RunView
from engine.scenario import parse
from engine.sim.judge import judge
from engine.types import COMPONENTS, Activity, Component
from engine.units import mj_from_j
from engine.world.grid import GridMotion
from tests import naive
from tests.strategies import HALL, LOOP, grid_graph, model, scenario_text

ORDERS = 'source = "poisson"\nrate_per_h = 500\nmix = [{ from = "station", to = "station", weight = 1.0 }]'


def joules(
    name: str, mass_kg: float = 1000.0, motion: GridMotion | None = None, eight: bool = False
) -> dict[str, float]:
    """Energy of a primitive in joules by component, standby of its duration included."""
    graph = grid_graph(2, 2, motion=motion, eight=eight)
    costs = cost_table(graph.primitives, model(), [(mass_kg, 0.0)], 1.0)
    kind = next(k for k, p in enumerate(graph.primitives) if p.name == name)
    out = {c: mj / 1000 for c, mj in zip(COMPONENTS, costs.mj[0, 0, kind].tolist(), strict=True) if mj}
    out["standby"] = graph.primitives[kind].ticks * int(costs.standby_mj[0]) / 1000
    return out


@pytest.mark.parametrize(
    ("name", "total"), [("straight", 128.1), ("turn", 338.4), ("start straight", 628.1), ("start turn", 838.4)]
)
def test_the_numbers_of_xu2025(name: str, total: float) -> None:
    assert sum(joules(name).values()) == pytest.approx(total, abs=0.05)


def test_components_of_xu2025() -> None:
    assert joules("straight") == {"rolling": 98.1, "standby": 30.0}
    assert joules("start straight") == {"rolling": 98.1, "starting": 500.0, "standby": 30.0}
    turn = joules("turn")
    assert turn["turning"] == pytest.approx(0.5 * 187.5 * (np.pi / 2) ** 2, abs=1e-3)
    assert turn["rolling"] == pytest.approx(98.1 * np.pi / 4, abs=1e-3)
    reverse = joules("reverse")
    # it stops, turns twice and starts again, whether it came rolling or not
    assert reverse == joules("start reverse")
    assert reverse["turning"] == pytest.approx(2 * turn["turning"], abs=2e-3)
    assert reverse["starting"] == 500.0
    assert set(joules("pivot", motion=GridMotion(turning="pivot"))) == {"turning", "standby"}
    assert joules("straight", 2000.0)["rolling"] == 196.2
    assert joules("diagonal straight", eight=True)["rolling"] == pytest.approx(98.1 * 2**0.5, abs=1e-3)


def test_a_table_is_rounded_once_per_primitive_and_sums_its_components() -> None:
    graph = grid_graph(2, 2, eight=True)
    demand = model()
    costs = cost_table(graph.primitives, demand, [(333.3, 77.7)], 0.7)
    for k, p in enumerate(graph.primitives):
        for load, mass in enumerate((333.3, 411.0)):
            for component, j in demand.joules(p, mass, p.ticks * 0.7).items():
                assert costs.mj[0, load, k, component] == mj_from_j(j)
    assert (costs.total_mj == costs.mj.sum(axis=3)).all()
    assert costs.standby_mj[0] == 21_000


def test_unknown_parameters_are_told_with_the_nearest() -> None:
    with pytest.raises(ScenarioError, match="standby_w"):
        parameters_over(xu2025(), {"standbyw": 3.0}, "xu2025")
    assert parameters_over(constant(), {"percent_per_s": 2.0}, "constant") == {"percent_per_s": 2.0}


def test_batteries_hold_what_they_say() -> None:
    assert battery.linear(1000.0, 48.0).capacity_mc == 1000 * 3600 * 1000
    full = battery.coulomb(480.0, 48.0)
    assert full.capacity_mc == 10 * 3600 * 1000  # 10 Ah
    assert set(full.voltage_mv.tolist()) == {48_000}


@pytest.fixture
def falling(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third battery in the registry: one function and one line."""
    monkeypatch.setitem(battery.BATTERIES, "falling", "tests.strategies:falling_battery")


@pytest.mark.usefixtures("falling")
def test_the_energy_of_a_charge_is_the_integral_of_its_voltage() -> None:
    for name, parameters in (("coulomb", {}), ("linear", {}), ("falling", {"knee": 0.7})):
        b = battery_of(name, 30.0, 47.9, parameters)
        charge = np.sort(np.random.default_rng(2).integers(0, b.capacity_mc + 1, 200))
        sample = charge * (battery.POINTS - 1) // b.capacity_mc
        width = b.capacity_mc / (battery.POINTS - 1)
        for q, i in zip(charge.tolist(), sample.tolist(), strict=True):
            by_hand = sum(b.voltage_mv[:i].tolist()) * width + int(b.voltage_mv[i]) * (q - i * width)
            assert b.energy_mj(q) == pytest.approx(by_hand / 1000, abs=1.001)
        if name != "falling":
            assert (b.energy_mj(charge) == charge * int(b.voltage_mv[0]) // 1000).all()
        assert (np.diff(b.energy_mj(charge)) >= 0).all()


@pytest.mark.usefixtures("falling")
def test_batteries_that_make_no_sense_are_told_what_is_wrong() -> None:
    with pytest.raises(ScenarioError, match="unknown battery model 'coulom'; did you mean 'coulomb'"):
        battery_of("coulom", 30.0, 48.0)
    with pytest.raises(ScenarioError, match="unknown parameter of battery model 'falling' 'kne'; did you mean 'knee'"):
        battery_of("falling", 30.0, 48.0, {"kne": 0.5})
    with pytest.raises(ScenarioError, match="unknown parameter of battery model 'coulomb' 'knee'"):
        battery_of("coulomb", 30.0, 48.0, {"knee": 0.5})
    flat = np.zeros(battery.POINTS, np.int64)
    with pytest.raises(BadInput, match="voltage_mv must be 1001 positive numbers"):
        Battery(1000, flat)
    with pytest.raises(BadInput, match="accept_w must be 1001 positive numbers"):
        Battery(1000, flat + 1, np.zeros(battery.POINTS))
    with pytest.raises(BadInput, match="capacity_mc must be positive; got 0"):
        Battery(0, flat + 1)


@pytest.mark.usefixtures("falling")
def test_a_third_battery_has_its_voltage_and_fills_the_slower_the_fuller_it_is() -> None:
    text = scenario_text(
        LOOP, 3, orders=ORDERS, charger="power_w = 901.7", charging="sufficient = 0.9",
        battery='model = "falling"\ncapacity_wh = 30.0\nvoltage_v = 47.9\ninitial_soc = [0.3, 0.6]\n'
        "parameters = { knee = 0.7 }",
    )  # fmt: skip
    asked, log = parse(text), MemoryLog()
    sim = build(asked, recorder=log)
    b, f = sim.parts.battery, sim.fleet
    assert (b.accept_w[699], b.accept_w[-1]) == (600.0, 20.0)
    seen = []
    for _ in range(1500):
        before = (f.charge.copy(), f.rest.copy(), f.ledger.copy())
        sim.advance(1)
        for v in range(sim.n):
            sample = int(before[0][v]) * (battery.POINTS - 1) // b.capacity_mc
            volt, drawn = int(b.voltage_mv[sample]), net(f.ledger[v]) - net(before[2][v])
            assert (before[0][v] - f.charge[v]) * volt + f.rest[v] == drawn * 1000 + before[1][v]
            assert 0 <= f.charge[v] <= b.capacity_mc
            assert -drawn <= b.accept_w[sample] * 1000
            if drawn < 0:
                seen.append((sample, -drawn))
    assert {power for sample, power in seen if sample < 690} == {600_000}
    slow = [power for sample, power in seen if sample > 850]
    assert slow
    assert max(slow) < 320_000
    assert sim.metrics()["orders_done"] > 10
    assert sim.metrics()["stranded"] == 0
    sim.flush()
    assert judge(log, asked, sim.world) == []
    view = RunView(log, asked, sim.world)
    assert view.capacity_mc == b.capacity_mc
    row = {c: v[-1] for c, v in log.table("battery").items() if c in ("vehicle", "charge_mc", "voltage_mv")}
    assert row["voltage_mv"] == b.voltage_mv[row["charge_mc"] * (battery.POINTS - 1) // b.capacity_mc]
    assert view.poses(sim.tick).soc[row["vehicle"]] == pytest.approx(row["charge_mc"] / b.capacity_mc, abs=1e-6)


def net(ledger: np.ndarray) -> int:
    """What left the battery: everything drawn, less what came in from the charger."""
    return int(ledger.sum())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"motion": 'turning = "pivot"\nturn_ticks = 3\nstraight_ticks = 2'},
        {"time": "tick_s = 0.3", "fleet": "mass_kg = 733.3\npayload_kg = 211.7"},
        {"battery": 'model = "linear"\ncapacity_wh = 30.0\ninitial_soc = [0.3, 0.6]'},
        {"faults": "delay_probability = 0.1\nbreakdowns_per_vehicle_day = 100.0\nrepair_s = 30.0"},
    ],
)
def test_every_millijoule_is_accounted_for_at_every_tick(changes: dict[str, Any]) -> None:
    settled = {
        "battery": 'model = "coulomb"\ncapacity_wh = 30.0\nvoltage_v = 47.9\ninitial_soc = [0.3, 0.6]',
        **changes,
    }
    text = scenario_text(LOOP, 3, orders=ORDERS, charger="power_w = 901.7", **settled)
    sim = build(parse(text))
    f, volt, mj = sim.fleet, int(sim.parts.battery.voltage_mv[0]), sim.parts.costs.mj
    charged = False
    for _ in range(1500):
        before = (f.charge.copy(), f.rest.copy(), f.ledger.copy())
        sim.advance(1)
        for v in range(sim.n):
            drawn = net(f.ledger[v]) - net(before[2][v])
            assert (before[0][v] - f.charge[v]) * volt + f.rest[v] == drawn * 1000 + before[1][v]
            assert 0 <= f.rest[v] < volt
            assert 0 <= f.charge[v] <= sim.levels.full[v]
            delta = f.ledger[v] - before[2][v]
            assert (delta[[c for c in Component if c != Component.CHARGED]] >= 0).all()
            charged = charged or bool(delta[Component.CHARGED] < 0)
            kind = int(f.kind[v])
            if kind >= 16 and f.t1[v] > sim.tick:  # under way: so far it has drawn the cumulative floor
                cost = mj[0, f.loaded[v], kind - 16].tolist()
                span, past = int(f.t1[v] - f.t0[v]), sim.tick - int(f.t0[v])
                was, now = (naive.energy_of_a_motion(cost, span, k) for k in (past - 1, past))
                moving = [b - a for a, b in zip(was, now, strict=True)]
                standby = int(delta[Component.STANDBY])
                assert delta.tolist() == [m + standby * (c == Component.STANDBY) for c, m in enumerate(moving)]
    assert charged
    assert sim.metrics()["orders_done"] > 10


def test_a_motion_of_several_ticks_draws_its_energy_and_no_more() -> None:
    cost = [100, 7, 0, 1]
    for span in (1, 2, 3, 7):
        steps = [naive.energy_of_a_motion(cost, span, k) for k in range(span + 1)]
        assert steps[-1] == cost
        assert all(b >= a for s, t in pairwise(steps) for a, b in zip(s, t, strict=True))


def test_the_thesis_battery_loses_one_percent_a_second_and_gains_three() -> None:
    text = scenario_text(
        LOOP, 2, orders=ORDERS, energy='demand = "constant"', battery='model = "linear"\ncapacity_wh = 1000.0',
        charger="rate_percent_per_s = 3.0", charging="good = 0.5\nsufficient = 0.9",
    )  # fmt: skip
    sim = build(parse(text))
    f, percent = sim.fleet, sim.parts.battery.capacity_mc // 100
    seen = set()
    for _ in range(600):
        before = f.charge.copy()
        sim.advance(1)
        for v in range(sim.n):
            # at an integer tick the interval that is open now began before it, or has just ended: ask the charge
            change = int(f.charge[v] - before[v])
            seen.add(change)
            assert change in (0, -percent) or 0 < change <= 3 * percent
    assert {0, -percent, 3 * percent} <= seen


@pytest.mark.parametrize("voltage", [48.0, 51.3])
def test_an_empty_battery_gives_nothing_and_owes_nothing(voltage: float) -> None:
    text = scenario_text(
        HALL, 1, battery=f"capacity_wh = 1.0\nvoltage_v = {voltage}\ninitial_soc = 0.7", fleet='start = "parking"',
        charging="good = 0.0\ncritical = 0.0\nreserve = 0.0", orders=ORDERS.replace("500", "0"),
    )  # fmt: skip
    sim = build(parse(text))
    first = int(sim.fleet.charge[0])
    sim.advance(300)
    volt = int(sim.parts.battery.voltage_mv[0])
    assert sim.fleet.charge[0] == 0
    assert 0 <= first * volt - 1000 * net(sim.fleet.ledger[0]) < 1000
    assert sim.metrics()["stranded"] == 1
    before = sim.fleet.ledger.copy()
    sim.advance(50)
    assert (sim.fleet.ledger == before).all()


def test_the_log_tells_the_ledger() -> None:
    log = MemoryLog()
    sim = build(parse(scenario_text(LOOP, 3, orders=ORDERS, log="sample_s = 7.0")), recorder=log)
    sim.advance(700)
    sim.flush()
    rows = naive.rows_of({k: np.asarray(v).tolist() for k, v in log.table("battery").items()})
    assert [r["tick"] for r in rows] == [t for t in range(0, 701, 7) for _ in range(3)]
    for v in range(3):
        last = rows[-3 + v]
        assert [last[f"{c}_mj"] for c in COMPONENTS] == sim.fleet.ledger[v].tolist()
        assert last["charge_mc"] == sim.fleet.charge[v]
    drives = naive.rows_of({k: np.asarray(v).tolist() for k, v in log.table("motions").items()})
    total = sum(r["energy_mj"] for r in drives if r["kind"] >= 16)
    moving = sum(int(sim.fleet.ledger[:, c].sum()) for c in (Component.ROLLING, Component.TURNING, Component.STARTING))
    under_way = [v for v in range(3) if sim.fleet.edge[v] >= 0]
    assert total == moving or under_way
    assert all(r["energy_mj"] == 0 for r in drives if r["kind"] <= Activity.PAUSE)
