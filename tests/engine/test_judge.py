"""The judge: a clean run has no breach, and each way of breaking one is named as what it is."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from engine.results.runlog import MemoryLog
from engine.results.schema import TABLES
from engine.scenario import Scenario, parse
from engine.sim.judge import Breach, BreachKind, judge, judge_plan
from engine.sim.judge.commands import arrivals_bound
from engine.sim.judge.energy import costs, standby_mj
from engine.types import FOREVER, NONE, PRIMITIVE_0, Activity, Component, Occupancy, OrderState, Task
from engine.world.floor import FloorPlan, World, build_world
from engine.world.grid import GridMotion
from tests import synthetic

Table = dict[str, np.ndarray]


class Changed:
    """A log whose tables can be changed before they are judged."""

    first_tick = 0

    def __init__(self, log: Any) -> None:
        self.tables: dict[str, dict[str, Any]] = {
            name: {c: v if isinstance(v, tuple) else v.copy() for c, v in log.table(name).items()} for name in TABLES
        }

    def table(self, name: str) -> dict[str, Any]:
        return self.tables[name]

    def __getitem__(self, name: str) -> dict[str, Any]:
        return self.tables[name]

    def drop(self, name: str, row: int) -> None:
        self.tables[name] = {c: np.delete(v, row) for c, v in self.tables[name].items()}

    def add(self, name: str, **row: Any) -> None:
        """Append a row, and keep the table in order of its ticks."""
        table = self.tables[name]
        grown = {}
        for c, v in table.items():
            more = np.empty(1, v.dtype)
            more[0] = row[c]
            grown[c] = np.concatenate([v, more])
        order = np.argsort(grown["tick"], kind="stable")
        self.tables[name] = {c: v[order] for c, v in grown.items()}


@cache
def recorded() -> tuple[MemoryLog, Scenario, World]:
    scenario = parse(synthetic.scenario_toml(ticks=1500))
    world = build_world(scenario)
    log = MemoryLog()
    synthetic.make_log(log, scenario, world, ticks=1500, commands=synthetic.COMMANDS)
    return log, scenario, world


def kinds(breaches: list[Breach]) -> set[str]:
    return {str(b.kind) for b in breaches}


@pytest.mark.parametrize("margin", [0, 1, 3])
@pytest.mark.parametrize(("straight", "turn", "tick_s"), [(1, 1, 1.0), (2, 3, 0.5), (1, 2, 0.7)])
def test_a_consistent_run_is_clean(margin: int, straight: int, turn: int, tick_s: float) -> None:
    text = synthetic.scenario_toml(ticks=1200, margin=margin, straight=straight, turn=turn, reverse=2, tick_s=tick_s)
    scenario = parse(text)
    log = MemoryLog()
    world = build_world(scenario)
    run = synthetic.make_log(log, scenario, world, ticks=1200, commands=synthetic.COMMANDS)
    assert sum(v.done for v in run.fleet) > 3
    assert judge(log, scenario, world) == []


def test_the_recorded_run_has_everything_in_it() -> None:
    log, _, _ = recorded()
    m = log.table("motions")
    assert set(range(7)) <= set(m["kind"].tolist())
    assert set(log.table("orders")["state"].tolist()) == set(range(5))
    assert log.table("battery")["charged_mj"].any()


# ------------------------------------------------------------------------------------ one change, one kind of breach


def rows_where(table: dict[str, Any], wanted: Callable[[dict[str, Any]], np.ndarray]) -> list[int]:
    return np.nonzero(wanted(table))[0].tolist()


def stands(m: dict[str, Any]) -> np.ndarray:
    return ((m["kind"] == Activity.WAIT) | (m["kind"] == Activity.REST)) & (m["t0"] > 0)


def a_gap(log: Changed, pick: int, amount: int) -> None:
    rows = rows_where(log["motions"], stands)
    log.drop("motions", rows[pick % len(rows)])


def an_overlap(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, stands)
    m["t1"][rows[pick % len(rows)]] += amount


def another_place(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, stands)
    i = rows[pick % len(rows)]
    m["from_place"][i] = m["to_place"][i] = (m["to_place"][i] + amount) % 60


def another_heading(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, stands)
    i = rows[pick % len(rows)]
    m["from_heading"][i] = m["to_heading"][i] = (m["to_heading"][i] + 1 + amount % 3) % 4


def outside(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    m["to_place"][pick % len(m["t0"])] = 1000 + amount


def motion_energy(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    m["energy_mj"][pick % len(m["t0"])] += amount


def component_shifted(log: Changed, pick: int, amount: int) -> None:
    b = log["battery"]
    i = pick % len(b["tick"])
    later = (b["vehicle"] == b["vehicle"][i]) & (b["tick"] >= b["tick"][i])
    b["rolling_mj"][later] += amount
    b["turning_mj"][later] -= amount


def standby_forgotten(log: Changed, pick: int, amount: int) -> None:
    b = log["battery"]
    b["copper_mj"] += b["standby_mj"]
    b["standby_mj"][:] = 0


def charge_off(log: Changed, pick: int, amount: int) -> None:
    b = log["battery"]
    rows = rows_where(b, lambda t: (t["tick"] > 0) & (t["charge_mc"] < 3_000_000))
    b["charge_mc"][rows[pick % len(rows)]] += 1 + amount


def voltage_off(log: Changed, pick: int, amount: int) -> None:
    b = log["battery"]
    b["voltage_mv"][pick % len(b["tick"])] += amount


def load_flipped(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, stands)
    m["loaded"][rows[pick % len(rows)]] ^= 1


def done_twice(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    rows = rows_where(o, lambda t: t["state"] == OrderState.DONE)
    i = rows[pick % len(rows)]
    log.add("orders", **{**{c: v[i] for c, v in o.items()}, "tick": o["tick"].max() + amount, "vehicle": NONE})


def another_station(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    rows = rows_where(o, lambda t: t["state"] >= OrderState.PICKED)
    rows = [i for i in rows if o["state"][i] != OrderState.WITHDRAWN]
    i = rows[pick % len(rows)]
    o["from_place"][i], o["to_place"][i] = o["to_place"][i], o["from_place"][i]


def never_assigned(log: Changed, pick: int, amount: int) -> None:
    rows = rows_where(log["orders"], lambda t: t["state"] == OrderState.ASSIGNED)
    served = set(log["orders"]["order"][log["orders"]["state"] == OrderState.PICKED].tolist())
    rows = [i for i in rows if int(log["orders"]["order"][i]) in served]
    log.drop("orders", rows[pick % len(rows)])


def picked_by_another(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    rows = rows_where(o, lambda t: t["state"] == OrderState.ASSIGNED)
    served = set(o["order"][o["state"] == OrderState.PICKED].tolist())
    rows = [i for i in rows if int(o["order"][i]) in served]
    i = rows[pick % len(rows)]
    o["vehicle"][i] = (o["vehicle"][i] + 1) % 5


def driven_into_a_block(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, lambda t: (t["kind"] >= PRIMITIVE_0) & (t["from_place"] != t["to_place"]))
    i = rows[pick % len(rows)]
    log.add("blocks", tick=max(m["t0"][i] - amount % 2, 0), place=m["to_place"][i], blocked=1)
    log.add("blocks", tick=m["t0"][i] + 1, place=m["to_place"][i], blocked=0)


def given_command(log: Changed, tick: int, **command: Any) -> None:
    log.add("commands", tick=tick, number=99, command=json.dumps(command), accepted=1, reason="")


def pause_ignored(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, lambda t: t["kind"] >= PRIMITIVE_0)
    i = rows[pick % len(rows)]
    assume(int(m["vehicle"][i]) != 1)  # whose own pause would end this one
    given_command(log, int(m["t0"][i]), do="pause", vehicle=int(m["vehicle"][i]))
    given_command(log, int(m["t0"][i]) + 1, do="continue", vehicle=int(m["vehicle"][i]))


def charger_out_ignored(log: Changed, pick: int, amount: int) -> None:
    m = log["motions"]
    rows = rows_where(m, lambda t: t["kind"] == Activity.CHARGE)
    i = rows[pick % len(rows)]
    place = int(m["to_place"][i])
    charger = recorded()[2].chargers.tolist().index(place)
    given_command(log, int(m["t0"][i]), do="charger out", charger=charger)


def withdrawal_ignored(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    rows = rows_where(o, lambda t: t["state"] == OrderState.DONE)
    i = rows[pick % len(rows)]
    given_command(log, int(o["tick"][i]) - 1, do="withdraw", order=int(o["order"][i]))


def block_ignored(log: Changed, pick: int, amount: int) -> None:
    given_command(log, 1000 + amount, do="block", place=pick % 60)


def order_ignored(log: Changed, pick: int, amount: int) -> None:
    given_command(log, 1000 + amount, **{"do": "order", "from": 1, "to": 2})


def rate_ignored(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    arrivals = [i for i in rows_where(o, lambda t: t["state"] == OrderState.OPEN) if o["source"][i] == 0]
    given_command(log, int(o["tick"][arrivals[pick % (len(arrivals) - 1)]]), do="rate", per_h=0.0)


def a_flood_ignored(log: Changed, pick: int, amount: int) -> None:
    given_command(log, pick % 1000, do="rate", per_h=100_000.0)


def after_all_commands(log: Changed, tick: np.ndarray) -> np.ndarray:
    return tick > int(log["commands"]["tick"].max())


def low_is_ignored(log: Changed, pick: int, amount: int) -> None:
    o = log["orders"]
    rows = rows_where(o, lambda t: (t["state"] == OrderState.ASSIGNED) & after_all_commands(log, t["tick"]))
    i = rows[pick % len(rows)]
    v, tick = int(o["vehicle"][i]), int(o["tick"][i])
    b, m = log["battery"], log["motions"]
    sample = rows_where(b, lambda t: (t["vehicle"] == v) & (t["tick"] <= tick))[-1]
    since = int(b["tick"][sample])
    charges = (m["vehicle"] == v) & (m["kind"] == Activity.CHARGE) & (m["t1"] > since) & (m["t0"] <= tick)
    assume(not charges.any() and b["charge_mc"][sample] < 0.99 * b["charge_mc"].max())
    given_command(log, since - 1, do="thresholds", good=0.999, sufficient=1.0)


def full_is_ignored(log: Changed, pick: int, amount: int) -> None:
    given_command(log, 701 + amount, do="thresholds", good=0.1, sufficient=0.2, full=0.3)


def topping_up_ignored(log: Changed, pick: int, amount: int) -> None:
    # whoever charges is said to rest: from some tick on, for longer than between two samples
    m, world = log["motions"], recorded()[2]
    given_command(log, 720, do="thresholds", full=1.0)
    rows = rows_where(m, lambda t: (t["kind"] == Activity.CHARGE) & (t["t0"] > 720) & (t["t1"] - t["t0"] > 20))
    assert set(m["to_place"][rows].tolist()) <= set(world.chargers.tolist())
    m["kind"][rows] = Activity.REST


def charge_ignored(log: Changed, pick: int, amount: int) -> None:
    o, m = log["orders"], log["motions"]
    rows = rows_where(o, lambda t: (t["state"] == OrderState.ASSIGNED) & after_all_commands(log, t["tick"]))
    i = rows[pick % len(rows)]
    v, since = int(o["vehicle"][i]), int(o["tick"][i]) - 1
    charging = (m["vehicle"] == v) & (m["kind"] == Activity.CHARGE) & (m["t1"] > since) & (m["t0"] <= since + 1)
    assume(not charging.any())
    given_command(log, since, do="charge", vehicle=v)


def send_ignored(log: Changed, pick: int, amount: int) -> None:
    given_command(log, 701 + amount, do="send", vehicle=pick % 5, place=pick % 60)


def sent_elsewhere(log: Changed, pick: int, amount: int) -> None:
    p = log["plans"]
    values, offsets = p["places"]
    values = values.copy()
    rows = [i for i in np.nonzero(after_all_commands(log, p["tick"]))[0].tolist() if offsets[i + 1] > offsets[i]]
    follow = {i: [j for j in rows if j > i and p["vehicle"][j] == p["vehicle"][i]] for i in rows}
    rows = [i for i in rows if follow[i]]
    i = rows[pick % len(rows)]
    p["task"][i] = Task.SENT
    v, place = int(p["vehicle"][i]), int(values[offsets[i + 1] - 1])
    values[offsets[follow[i][0]]] = (place + amount) % 60
    p["places"] = (values, offsets)
    given_command(log, int(p["tick"][i]), do="send", vehicle=v, place=place)


CHANGES: list[tuple[Callable[[Changed, int, int], None], BreachKind]] = [
    (a_gap, BreachKind.CONTINUITY),
    (an_overlap, BreachKind.CONTINUITY),
    (another_place, BreachKind.CONTINUITY),
    (another_heading, BreachKind.CONTINUITY),
    (outside, BreachKind.OBSTACLE),
    (motion_energy, BreachKind.ENERGY),
    (component_shifted, BreachKind.ENERGY),
    (standby_forgotten, BreachKind.ENERGY),
    (charge_off, BreachKind.BATTERY),
    (voltage_off, BreachKind.BATTERY),
    (load_flipped, BreachKind.LOAD),
    (done_twice, BreachKind.ORDER),
    (another_station, BreachKind.ORDER),
    (never_assigned, BreachKind.ORDER),
    (picked_by_another, BreachKind.ORDER),
    (driven_into_a_block, BreachKind.BLOCKED),
    (pause_ignored, BreachKind.COMMAND),
    (charger_out_ignored, BreachKind.COMMAND),
    (withdrawal_ignored, BreachKind.COMMAND),
    (block_ignored, BreachKind.COMMAND),
    (order_ignored, BreachKind.COMMAND),
    (rate_ignored, BreachKind.COMMAND),
    (a_flood_ignored, BreachKind.COMMAND),
    (low_is_ignored, BreachKind.COMMAND),
    (full_is_ignored, BreachKind.COMMAND),
    (charge_ignored, BreachKind.COMMAND),
    (send_ignored, BreachKind.COMMAND),
    (sent_elsewhere, BreachKind.COMMAND),
]


@pytest.mark.parametrize(("change", "kind"), CHANGES, ids=[c.__name__ for c, _ in CHANGES])
@settings(max_examples=15)
@given(pick=st.integers(0, 10_000), amount=st.integers(1, 50))
def test_a_change_is_named_as_what_it_is(
    change: Callable[[Changed, int, int], None], kind: BreachKind, pick: int, amount: int
) -> None:
    base, scenario, world = recorded()
    log = Changed(base)
    change(log, pick, amount)
    found = judge(log, scenario, world)
    assert found, "the change was not noticed"
    if change is outside:  # how long a vehicle that left the floor is anywhere is no question any more
        assert str(kind) in kinds(found)
    elif change in (picked_by_another, another_place):  # who may be too low for it, or now rests at a charger
        assert {str(kind)} <= kinds(found) <= {str(kind), "command"}
    elif change is an_overlap:  # the interval overrun may be one that charges, or make the record end later
        assert {str(kind)} <= kinds(found) <= {str(kind), "energy", "duration"}
    else:
        assert kinds(found) == {str(kind)}
    assert all(b.text and "\n" not in b.text for b in found)


def test_who_rests_at_a_charger_when_it_should_top_up_is_named() -> None:
    base, scenario, world = recorded()
    log = Changed(base)
    topping_up_ignored(log, 0, 0)
    found = judge(log, scenario, world)
    assert {str(BreachKind.COMMAND)} <= kinds(found) <= {str(BreachKind.COMMAND), str(BreachKind.ENERGY)}
    assert any("it charges below" in b.text for b in found)


def test_numbers_of_arrivals() -> None:
    for n, mean in ((0, 3.0), (5, 5.0), (9, 4.0), (2, 9.0), (40, 20.0)):
        side = range(n, 200) if n >= mean else range(n + 1)
        exact = sum(np.exp(k * np.log(mean) - mean - math.lgamma(k + 1)) for k in side)
        assert exact <= arrivals_bound(n, mean) <= 1.0
    assert arrivals_bound(0, 100.0) < 1e-40
    assert arrivals_bound(300, 100.0) < 1e-40
    assert arrivals_bound(1, 0.0) == 0.0


@pytest.mark.parametrize(
    ("section", "changes", "kind"),
    [
        ("service", {"pick_s": 6.0}, BreachKind.SERVICE),
        ("service", {"drop_s": 1.0}, BreachKind.SERVICE),
        ("battery", {"capacity_wh": 30.0}, BreachKind.SOC),
        ("fleet", {"payload_kg": 500.0}, BreachKind.ENERGY),
        ("fleet", {"mass_kg": 999.0}, BreachKind.ENERGY),
        ("energy", {"parameters": {"standby_w": 31.0}}, BreachKind.ENERGY),
        ("energy", {"demand": "constant"}, BreachKind.ENERGY),
        ("charger", {"power_w": 100.0}, BreachKind.ENERGY),
        ("charger", {"efficiency": 0.5}, BreachKind.ENERGY),
    ],
)
def test_a_run_is_judged_by_its_scenario(section: str, changes: dict[str, Any], kind: BreachKind) -> None:
    log, scenario, world = recorded()
    other = scenario.model_copy(update={section: getattr(scenario, section).model_copy(update=changes)})
    # another capacity is also another level below which nobody takes orders
    assert str(kind) in (found := kinds(judge(log, other, world)))
    assert found <= {str(kind), "command"} if section == "battery" else found == {str(kind)}


def test_a_run_is_judged_by_its_world() -> None:
    log, scenario, _ = recorded()
    slower = scenario.model_copy(update={"motion": scenario.motion.model_copy(update={"turn_ticks": 3})})
    found = kinds(judge(log, slower, build_world(slower)))
    assert "duration" in found
    assert found <= {"duration", "energy"}  # energy is spread over the ticks of a motion
    rows = scenario.floor.rows or ""
    turned = scenario.model_copy(
        update={"floor": scenario.floor.model_copy(update={"rows": rows.replace(">>>>>>>>>>^", "<<<<<<<<<<^")})}
    )
    found = kinds(judge(log, turned, build_world(turned)))
    assert "one-way" in found
    assert found <= {"one-way", "edge", "primitive"}


def test_a_run_without_margin_breaks_a_margin() -> None:
    text = synthetic.scenario_toml(ticks=600, margin=0)
    scenario = parse(text)
    log = MemoryLog()
    synthetic.make_log(log, scenario, build_world(scenario), ticks=600)
    strict = parse(synthetic.scenario_toml(ticks=600, margin=2))
    found = judge(log, strict, build_world(strict))
    assert kinds(found) == {"vertex"}
    assert "too soon after" in found[0].text


def test_the_energy_of_the_papers_defaults() -> None:
    """papers.md 1.1: straight 128.1 J, turn 338.4 J, start 628.1 J, wait 30 J, all with the standby of their second."""
    scenario = parse(synthetic.scenario_toml(straight=1, turn=1, reverse=1))
    scenario = scenario.model_copy(update={"fleet": scenario.fleet.model_copy(update={"mass_kg": 1000.0})})
    world = build_world(scenario)
    of_masses = costs(scenario, world.graph)
    assert of_masses is not None
    table = of_masses[0]
    standby = standby_mj(scenario) / 1000
    total = {p.name: table[k, 0].sum() / 1000 + standby for k, p in enumerate(world.graph.primitives)}
    assert standby == 30.0
    assert total["straight"] == pytest.approx(128.1, abs=0.01)
    assert total["turn"] == pytest.approx(98.1 * np.pi / 4 + 0.5 * 187.5 * (np.pi / 2) ** 2 + 30, abs=1e-3)
    assert total["start straight"] == pytest.approx(628.1, abs=0.01)
    turn = 0.5 * 187.5 * (np.pi / 2) ** 2
    assert total["start reverse"] == pytest.approx(628.1 + 2 * turn, abs=0.01)
    assert table[:, 1, Component.ROLLING].sum() == pytest.approx(1.25 * table[:, 0, Component.ROLLING].sum(), abs=9)


# ---------------------------------------------------------------------------------------- vehicles that meet


OPEN_FLOOR = tuple(["." * 6] * 5)


def open_world(occupancy: Occupancy, *, connectivity: int = 8, margin: int = 0, straight: int = 1) -> World:
    motion = GridMotion(turning="arc", straight_ticks=straight, turn_ticks=straight, diagonal_ticks=straight)
    return build_world(
        FloorPlan(OPEN_FLOOR, motion=motion, connectivity=connectivity, occupancy=occupancy, margin_ticks=margin)
    )


def open_scenario(vehicles: int) -> Scenario:
    text = synthetic.scenario_toml(vehicles=vehicles, margin=0)
    return parse(text)


def drive(world: World, log: MemoryLog, paths: list[tuple[int, list[tuple[int, int]]]]) -> MemoryLog:
    """Each vehicle waits until its tick, then drives over its cells without a stop, then rests; energies are right."""
    g = world.graph
    of_masses = costs(open_scenario(len(paths)), g)
    assert of_masses is not None
    table = of_masses[0]
    rows: list[tuple[int, ...]] = []
    frames: list[tuple[int, ...]] = []
    end = 1 + max(start + sum(10 for _ in cells) for start, cells in paths)
    for v, (start, cells) in enumerate(paths):
        place = world.place_at(*cells[0])
        state = g.state(place, 0)
        if start:
            rows.append((v, 4, 0, NONE, 0, start, place, place, 0, 0, 0, NONE, 0, 0))
        t = start
        for cell in cells[1:]:
            target = world.place_at(*cell)
            edges = range(int(g.edge_ptr[state]), int(g.edge_ptr[state + 1]))
            e = next(e for e in edges if g.state_place[g.edge_to[e]] == target)
            to, k = int(g.edge_to[e]), int(g.edge_kind[e])
            t1 = t + int(g.kind_ticks[k])
            heads = int(g.state_heading[state]), int(g.state_heading[to])
            energy = int(table[k, 0].sum())
            rows.append((v, PRIMITIVE_0 + k, 0, NONE, t, t1, place, target, *heads, 0, NONE, 3, energy))
            state, place, t = to, target, t1
        heading = int(g.state_heading[state])
        motion = (v, 4, 0, NONE, t, FOREVER, place, place, heading, heading, 0, NONE, 0, 0)
        frames.append((end, *motion, 0, 0, 0, 0))
    rows.sort(key=lambda row: row[5])
    if rows:
        log.write("motions", dict(zip(TABLES["motions"], map(list, zip(*rows, strict=True)), strict=True)))
    log.write("keyframes", dict(zip(TABLES["keyframes"], map(list, zip(*frames, strict=True)), strict=True)))
    return log


def meeting(occupancy: Occupancy, *paths: tuple[int, list[tuple[int, int]]], **world: Any) -> set[str]:
    floor = open_world(occupancy, **world)
    return kinds(judge(drive(floor, MemoryLog(), list(paths)), open_scenario(len(paths)), floor))


HOLD, MAPF = Occupancy.HOLD, Occupancy.MAPF


@pytest.mark.parametrize("straight", [1, 3])
@pytest.mark.parametrize("rule", [HOLD, MAPF])
def test_two_in_one_place(rule: Occupancy, straight: int) -> None:
    east = [(0, 1), (1, 1), (2, 1)]
    assert meeting(rule, (0, east), (0, [(2, 1)]), straight=straight) == {"vertex"}  # a parked vehicle occupies
    assert meeting(rule, (0, east), (0, [(2, 3), (2, 2), (2, 1)]), straight=straight, connectivity=4) == {"vertex"}
    assert meeting(rule, (0, east), (0, [(4, 4), (4, 3)]), straight=straight) == set()


@pytest.mark.parametrize("straight", [1, 3])
@pytest.mark.parametrize("rule", [HOLD, MAPF])
def test_two_through_each_other(rule: Occupancy, straight: int) -> None:
    assert meeting(rule, (0, [(0, 1), (1, 1)]), (0, [(1, 1), (0, 1)]), straight=straight) == {"swap"}


@pytest.mark.parametrize("straight", [1, 3])
def test_following_is_for_the_classical_rule(straight: int) -> None:
    first, second = (0, [(1, 1), (2, 1), (3, 1)]), (0, [(0, 1), (1, 1), (2, 1)])
    assert meeting(MAPF, first, second, straight=straight) == set()
    assert meeting(HOLD, first, second, straight=straight) == {"vertex"}
    assert meeting(HOLD, first, (straight, second[1]), straight=straight) == set()
    assert meeting(HOLD, first, (straight, second[1]), straight=straight, margin=1) == {"vertex"}
    assert meeting(HOLD, first, (straight + 1, second[1]), straight=straight, margin=1) == set()


@pytest.mark.parametrize("rule", [HOLD, MAPF])
def test_a_ring_may_turn_only_under_the_classical_rule(rule: Occupancy) -> None:
    ring = [(1, 1), (2, 1), (2, 2), (1, 2)]
    paths = [(0, [ring[i], ring[(i + 1) % 4]]) for i in range(4)]
    assert meeting(rule, *paths) == (set() if rule == MAPF else {"vertex"})


@pytest.mark.parametrize("straight", [1, 2])
@pytest.mark.parametrize("rule", [HOLD, MAPF])
def test_diagonals_cross(rule: Occupancy, straight: int) -> None:
    rising, falling = (0, [(1, 1), (2, 2)]), (0, [(1, 2), (2, 1)])
    assert meeting(rule, rising, falling, straight=straight) == {"crossing"}
    assert meeting(rule, rising, (0, [(2, 1), (1, 2)]), straight=straight) == {"crossing"}
    after = meeting(rule, rising, (straight, [(1, 2), (2, 1)]), straight=straight)
    # the second stands in a corner of the first: only the rule that holds corners minds
    assert after == ({"crossing"} if rule == HOLD else set())


def test_a_corner_is_held_while_a_diagonal_passes() -> None:
    assert meeting(HOLD, (0, [(1, 1), (2, 2)]), (0, [(3, 1), (2, 1)]), straight=2) == {"crossing"}
    assert meeting(HOLD, (0, [(1, 1), (2, 2)]), (2, [(3, 1), (2, 1)]), straight=2) == set()


cells = st.tuples(st.integers(0, 5), st.integers(0, 4))


@st.composite
def wandering(draw: st.DrawFn, diagonal: bool) -> tuple[int, list[tuple[int, int]]]:
    path = [draw(cells)]
    for _ in range(draw(st.integers(0, 5))):
        x, y = path[-1]
        steps = [
            (x + dx, y + dy)
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            if (dx or dy) and (diagonal or not (dx and dy)) and 0 <= x + dx < 6 and 0 <= y + dy < 5
        ]
        path.append(draw(st.sampled_from(steps)))
    return draw(st.integers(0, 4)), path


def naive_hold(world: World, log: MemoryLog, margin: int) -> bool:
    """Tick by tick: does anybody hold what another holds? Slow and obvious."""
    held: dict[tuple[int, int], set[int]] = {}
    m, k = log.table("motions"), log.table("keyframes")
    g = world.graph
    end = int(k["tick"][-1])
    for i in range(len(m["t0"])):
        v, a, b, t0, t1 = (int(m[c][i]) for c in ("vehicle", "from_place", "to_place", "t0", "t1"))
        for t in range(t0, t1):
            held.setdefault((b, t), set()).add(v)
            held.setdefault((a, t), set()).add(v)
            (ax, ay), (bx, by) = world.cell_of_place[a].tolist(), world.cell_of_place[b].tolist()
            if ax != bx and ay != by:
                held.setdefault((world.place_at(ax, by), t), set()).add(v)
                held.setdefault((world.place_at(bx, ay), t), set()).add(v)
        if a != b:
            for t in range(t1, t1 + margin):
                held.setdefault((a, t), set()).add(v)
    for i in range(len(k["tick"])):
        for t in range(int(k["t0"][i]), end + 5):
            held.setdefault((int(k["to_place"][i]), t), set()).add(int(k["vehicle"][i]))
    assert g.n_places == 30
    return any(len(vehicles) > 1 for vehicles in held.values())


@settings(max_examples=80)
@given(
    paths=st.lists(wandering(diagonal=True), min_size=1, max_size=4),
    margin=st.integers(0, 2),
    straight=st.integers(1, 3),
)
def test_holding_is_what_a_tick_by_tick_count_says(
    paths: list[tuple[int, list[tuple[int, int]]]], margin: int, straight: int
) -> None:
    world = open_world(HOLD, margin=margin, straight=straight)
    log = drive(world, MemoryLog(), paths)
    found = kinds(judge(log, open_scenario(len(paths)), world))
    assert found <= {"vertex", "swap", "crossing"}
    assert bool(found) == naive_hold(world, log, margin)


@settings(max_examples=80)
@given(paths=st.lists(wandering(diagonal=True), min_size=1, max_size=4))
def test_a_run_and_a_plan_are_judged_alike(paths: list[tuple[int, list[tuple[int, int]]]]) -> None:
    """The classical rule, once from intervals and once from places per tick."""
    world = open_world(MAPF)
    log = drive(world, MemoryLog(), paths)
    timed = [[world.place_at(*path[0])] * start + [world.place_at(*cell) for cell in path] for start, path in paths]
    of_run = {(b.kind, b.vehicles) for b in judge(log, open_scenario(len(paths)), world)}
    of_plan = {(b.kind, b.vehicles) for b in judge_plan(world.graph, timed)}
    assert of_run == of_plan


# ---------------------------------------------------------------------------------------------------- plans


def place(world: World, *cells: tuple[int, int]) -> list[int]:
    return [world.place_at(*c) for c in cells]


def test_plans_begin_and_end_where_they_should() -> None:
    world = open_world(MAPF)
    a, b = place(world, (0, 0), (1, 0))
    assert judge_plan(world.graph, [[a, b]], starts=[a], goals=[b]) == []
    assert kinds(judge_plan(world.graph, [[a, b]], starts=[b], goals=[a])) == {"goal"}
    assert kinds(judge_plan(world.graph, [[a, b]], goals=[a, b])) == {"goal"}
    assert judge_plan(world.graph, []) == []


def test_plans_keep_to_the_graph() -> None:
    plan = FloorPlan((">>>", "...", "#.."))
    world = build_world(plan)
    a, b, c = place(world, (0, 2), (1, 2), (2, 2))
    assert judge_plan(world.graph, [[a, b, c]]) == []
    assert kinds(judge_plan(world.graph, [[b, a]])) == {"one-way"}
    assert kinds(judge_plan(world.graph, [[a, c]])) == {"edge"}
    assert kinds(judge_plan(world.graph, [[a, -1]])) == {"obstacle"}
    assert kinds(judge_plan(world.graph, [[a, b]], blocked=[b])) == {"blocked"}


def test_plans_rest_at_their_goals() -> None:
    world = open_world(MAPF)
    a, b, c = place(world, (0, 0), (1, 0), (2, 0))
    assert kinds(judge_plan(world.graph, [[b], [a, a, a, b, c]])) == {"vertex"}
    assert kinds(judge_plan(world.graph, [[a, b], [b, a]])) == {"swap"}
    assert judge_plan(world.graph, [[b, c], [a, b]]) == []
    assert kinds(judge_plan(world.graph, [[b, c], [a, b]], occupancy=HOLD)) == {"vertex"}


# -------------------------------------------------------------------------------------------- speed, broken runs


def test_a_log_that_stops_in_the_middle_is_judged_up_to_there() -> None:
    base, scenario, world = recorded()
    log = Changed(base)
    keep = log["motions"]["t1"] <= 700
    log.tables["motions"] = {c: v[keep] for c, v in log["motions"].items()}
    for name in TABLES:
        if name != "motions":
            keep = log[name]["tick"] <= 700
            log.tables[name] = {c: v if isinstance(v, tuple) else v[keep] for c, v in log[name].items()}
    assert judge(log, scenario, world) == []


def test_an_empty_log_is_clean() -> None:
    _, scenario, world = recorded()
    assert judge(MemoryLog(), scenario, world) == []


def test_everything_wrong_is_still_a_list() -> None:
    """Nonsense everywhere: the judge names it and does not stumble."""
    base, scenario, world = recorded()
    rng = np.random.default_rng(1)
    for _ in range(10):
        log = Changed(base)
        m = log["motions"]
        for column in m.values():
            rows = rng.integers(0, len(column), 300)
            column[rows] = rng.integers(-5, 130, 300).astype(column.dtype)
        m["vehicle"][:] = np.abs(m["vehicle"]) % 9
        m["t0"][:] = np.abs(m["t0"])
        assert judge(log, scenario, world)
