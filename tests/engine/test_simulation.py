"""Runs on small random floors with faults and commands: nobody meets, no order is forgotten, all is repeatable."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.build import build, resume
from engine.errors import ScenarioError
from engine.results.runlog import MemoryLog
from engine.scenario import Scenario, parse
from engine.sim import kernels, planning
from engine.sim.judge import judge
from engine.traffic import FAR
from engine.types import Activity, Cause, OrderState
from tests import naive
from tests.strategies import HALL, LOOP, scenario_text

OPEN = """
I...O
.....
.R.R.
.....
CPCPC
"""
NARROW = """
#I##O##R##R#
P..........P
#C#P#C#P#C##
"""
WIDE = """
I.........O
..........R
R..........
P.........P
C.........C
P.........P
I....R....O
"""
ANY = 'mix = [{ from = "station", to = "station", weight = 1.0 }]'


def random_scenario(seed: int, *, faults: bool) -> Scenario:
    """A small floor with everything drawn: rule, margin, motions, fleet, planner, faults."""
    rng = random.Random(seed)
    rows = rng.choice([HALL, LOOP, OPEN, NARROW])
    rule = rng.choice(["hold", "hold", "mapf"])
    hold = rule == "hold"
    eight = rng.choice([4, 4, 8]) if rows != LOOP else 4
    margin = rng.choice([0, 0, 1, 3]) if hold else 0
    motion = f'turning = "{rng.choice(["arc", "pivot"])}"\n'
    if hold:
        names = ("straight_ticks", "turn_ticks", "reverse_ticks", "diagonal_ticks")
        motion += "\n".join(f"{name} = {rng.randint(1, 3)}" for name in names)
    sections = {
        "floor": f'occupancy = "{rule}"\nconnectivity = {eight}\nmargin_ticks = {margin}',
        "motion": motion,
        "fleet": "payload_kg = 500.0",
        "battery": 'model = "coulomb"\ncapacity_wh = 80.0\ninitial_soc = [0.3, 1.0]',
        "orders": f'source = "poisson"\nrate_per_h = {rng.choice([60, 200, 500])}\n{ANY}',
        "planner": f'name = "{rng.choice(["prioritized", "prioritized", "quickest"])}"\n'
        f'objective = "{rng.choice(["time", "energy"])}"',
    }
    if faults:
        sections["faults"] = (
            f"delay_probability = {rng.choice([0.0, 0.02, 0.2])}\ndelay_ticks = [1, {rng.choice([1, 3, 20])}]\n"
            f"breakdowns_per_vehicle_day = {rng.choice([0, 50, 300])}\nrepair_s = {rng.choice([20, 100])}"
        )
    count = rng.randint(2, sum(c in "CP" for c in rows) - 1) if rows != HALL else 1
    return parse(scenario_text(rows, count, seed=seed, **sections))


def random_command(rng: random.Random, sim: Any) -> dict[str, Any]:
    """A command that makes sense at least formally."""
    v, place = rng.randrange(sim.n), rng.randrange(sim.graph.n_places)
    stations, charger = len(sim.world.stations), rng.randrange(len(sim.world.chargers))
    return rng.choice(
        [
            {"do": "order", "from": rng.randint(1, stations), "to": rng.randint(1, stations)},
            {"do": "withdraw", "order": rng.randrange(max(1, len(sim.book)))},
            {"do": "charge", "vehicle": v},
            {"do": "send", "vehicle": v, "place": place},
            {"do": "pause", "vehicle": v},
            {"do": "continue", "vehicle": v},
            {"do": "fail", "vehicle": v},
            {"do": "repair", "vehicle": v},
            {"do": "block", "place": place},
            {"do": "unblock", "place": place},
            {"do": "charger out", "charger": charger},
            {"do": "charger back", "charger": charger},
            {"do": "rate", "per_h": rng.choice([0, 100, 500])},
            {"do": "thresholds", "good": rng.choice([0.2, 0.3, 0.5])},
        ]
    )


def so_far(sim: Any, log: MemoryLog) -> list[naive.Motion]:
    """Every interval until now, the open ones cut at the present tick."""
    sim.flush()
    rows = naive.rows_of({k: np.asarray(v).tolist() for k, v in log.table("motions").items()})
    frames = naive.rows_of({k: np.asarray(v).tolist() for k, v in log.table("keyframes").items()})
    open_now = [{**r, "t1": sim.tick} for r in frames if r["tick"] == sim.tick and r["t0"] < sim.tick]
    return rows + open_now


def nobody_met(sim: Any, log: MemoryLog) -> None:
    """Two independent opinions: the plain one of these tests, and the judge's."""
    floor = naive.Floor(sim.graph, sim.scenario.floor.occupancy == "hold", sim.scenario.floor.margin_ticks)
    assert naive.clashes(floor, naive.occupied(floor, so_far(sim, log))) == []
    assert judge(log, sim.scenario, sim.world) == []


def all_well(sim: Any) -> None:
    """Undo whatever an operator may have done."""
    for v in range(sim.n):
        sim.submit({"do": "repair", "vehicle": v})
        sim.submit({"do": "continue", "vehicle": v})
    for place in np.flatnonzero(sim.blocked).tolist():
        sim.submit({"do": "unblock", "place": place})
    for charger in range(len(sim.world.chargers)):
        sim.submit({"do": "charger back", "charger": charger})
    sim.submit({"do": "rate", "per_h": 0})


def finished(sim: Any) -> bool:
    return all(s in (OrderState.DONE, OrderState.WITHDRAWN) for s in sim.book.state)


@pytest.mark.parametrize("seed", range(40))
def test_whatever_happens_nobody_meets_and_work_goes_on(seed: int) -> None:
    asked = random_scenario(seed, faults=True)
    log = MemoryLog()
    sim = build(asked, recorder=log)
    rng = random.Random(seed)
    while sim.tick < 700:
        sim.advance(rng.choice([1, 1, 2, 3, 7, 20, 61]))
        sim.check()
        if rng.random() < 0.15:
            sim.submit(random_command(rng, sim))
            sim.check()
    nobody_met(sim, log)
    all_well(sim)
    done = sim.metrics()["orders_done"]
    for _ in range(40):
        if finished(sim):
            break
        sim.advance(500)
    # broken down again, perhaps; but never stuck for good
    assert finished(sim) or sim.metrics()["orders_done"] > done
    sim.check()
    nobody_met(sim, log)


@pytest.mark.parametrize("seed", range(100, 130))
def test_without_faults_every_order_is_done_and_nobody_strands(seed: int) -> None:
    log = MemoryLog()
    sim = build(random_scenario(seed, faults=False), recorder=log)
    sim.advance(1000)
    sim.submit({"do": "rate", "per_h": 0})
    oldest = 0.0
    while not finished(sim) and sim.tick < 40_000:
        sim.advance(500)
        oldest = max(oldest, sim.metrics()["oldest_open_s"])
    assert finished(sim)
    # idle for hours: whoever falls low goes charging, also from a parking bay
    sim.advance(20_000)
    assert sim.metrics()["stranded"] == 0
    assert (sim.fleet.charge >= 0.1 * sim.parts.battery.capacity_mc).all()
    sim.check()
    nobody_met(sim, log)


def congested(seed: int) -> Scenario:
    """Too many orders for too few lanes, and batteries of half an hour: plans wait long, and waiting burns standby."""
    rng = random.Random(seed)
    rows, count = rng.choice([(NARROW, 5), (NARROW, 5), (OPEN, 4)])
    names = ("straight_ticks", "turn_ticks", "reverse_ticks", "diagonal_ticks")
    motion = f'turning = "{rng.choice(["arc", "pivot"])}"\n' + "\n".join(f"{n} = {rng.randint(1, 3)}" for n in names)
    planner = f'name = "{rng.choice(["prioritized", "quickest"])}"\nobjective = "{rng.choice(["time", "energy"])}"'
    return parse(
        scenario_text(
            rows, count, seed=seed, floor=f"margin_ticks = {rng.choice([0, 1, 3])}", motion=motion, planner=planner,
            fleet="payload_kg = 500.0", battery="capacity_wh = 20.0\ninitial_soc = [0.35, 1.0]",
            orders=f'source = "poisson"\nrate_per_h = {rng.choice([200, 500, 1000])}\n{ANY}',
        )
    )  # fmt: skip


@pytest.mark.parametrize("seed", [*range(300, 312), 332])
def test_nobody_strands_in_heavy_congestion(seed: int) -> None:
    sim = build(congested(seed))
    lowest = 1.0
    while sim.tick < 3000:
        sim.advance(50)
        lowest = min(lowest, float((sim.fleet.charge / sim.parts.battery.capacity_mc).min()))
    assert sim.metrics()["stranded"] == 0
    # the reserve is left over but for the way to a charger
    assert lowest > 0.02
    assert sim.metrics()["orders_done"] > 50


def test_a_plan_beyond_the_charge_is_refused_and_the_vehicle_charges_first() -> None:
    # an estimate that is too low makes the dispatcher choose the vehicle; the plan itself tells
    text = scenario_text(
        NARROW, 2, fleet='start = "parking"', battery="capacity_wh = 4.0\ninitial_soc = 0.42",
        orders=f'source = "poisson"\nrate_per_h = 0\n{ANY}', charging="good = 0.2\nsufficient = 0.6",
    )  # fmt: skip
    log = MemoryLog()
    sim = build(parse(text), recorder=log)
    object.__setattr__(sim.parts.dispatcher, "need", lambda view, v, a, b: 0)
    sim.advance(1)
    sim.submit({"do": "order", "from": 1, "to": 4})
    assert not sim.book.state.count(OrderState.ASSIGNED)
    assert sim.must_charge.any()
    sim.flush()
    assert "too little charge" in log.table("plans")["status"].tolist()
    waits = [e["text"] for e in naive.rows_of(log.table("events")) if e["kind"] == "order waits"]
    assert any("too little charge for the way that is free" in text for text in waits)
    sim.advance(900)
    assert sim.metrics()["orders_done"] == 1
    assert sim.metrics()["stranded"] == 0
    nobody_met(sim, log)


@pytest.mark.parametrize("seed", range(200, 220))
def test_cuts_flushes_recorders_and_checkpoints_leave_no_trace(seed: int, tmp_path: Path) -> None:
    asked = random_scenario(seed, faults=True)

    def run(way: str) -> str:
        rng = random.Random(seed)
        sim = build(asked, recorder=MemoryLog() if way != "plain" else None)
        while sim.tick < 500:
            ticks, save = rng.choice([1, 2, 7, 20, 61]), rng.random() < 0.1
            for _ in range(ticks if way == "by ticks" else 1):
                sim.advance(1 if way == "by ticks" else ticks)
            if rng.random() < 0.15:
                sim.submit(random_command(rng, sim))
            if save and way == "by ticks":
                sim.flush()
            if save and way == "saved":
                folder = tmp_path / str(sim.tick)
                sim.checkpoint(folder)
                sim = resume(folder, recorder=sim.log)
        return str(sim.digest())

    assert run("by ticks") == run("plain")
    assert run("saved") == run("plain")


def test_late_diagonals_do_not_cross() -> None:
    # planned one after the other, due together because of delays: nothing but the step keeps them apart
    for seed in range(3):
        text = scenario_text(
            WIDE, 6, seed=seed, floor='occupancy = "mapf"\nconnectivity = 8',
            faults="delay_probability = 0.3\ndelay_ticks = [1, 2]",
            orders=f'source = "poisson"\nrate_per_h = 1500\n{ANY}',
        )  # fmt: skip
        log = MemoryLog()
        sim = build(parse(text), recorder=log)
        sim.advance(2200)
        nobody_met(sim, log)
        assert sim.metrics()["orders_done"] > 100


def test_the_classical_rule_needs_motions_of_one_tick() -> None:
    text = scenario_text(HALL, 1, floor='occupancy = "mapf"', motion="turn_ticks = 2")
    with pytest.raises(ScenarioError, match=r"'mapf', which needs motions of one tick.*'turn' takes 2"):
        build(parse(text))


def test_a_margin_does_not_keep_a_vehicle_from_its_own_trail() -> None:
    # it turns round in the station before the margin of its access cell is over
    text = scenario_text(
        "#I#\nC.O\n", 1, floor="margin_ticks = 9",
        orders=f'source = "poisson"\nrate_per_h = 300\n{ANY}',
    )  # fmt: skip
    log = MemoryLog()
    sim = build(parse(text), recorder=log)
    for _ in range(400):
        sim.advance(1)
        sim.check()
    assert sim.metrics()["orders_done"] > 5
    assert sim.metrics()["deadlocks"] == 0
    assert all(r["blocker"] != r["vehicle"] for r in so_far(sim, log))


def test_who_stood_behind_a_stuck_vehicle_comes_back() -> None:
    text = scenario_text(NARROW, 4, orders=f'source = "poisson"\nrate_per_h = 400\n{ANY}')
    sim = build(parse(text))
    sim.advance(60)
    for v in range(3):
        sim.submit({"do": "fail", "vehicle": v})
    sim.advance(300)
    for v in range(3):
        sim.submit({"do": "repair", "vehicle": v})
    sim.submit({"do": "rate", "per_h": 0})
    sim.advance(3000)
    assert finished(sim)
    planned = [sim.steps.start[v, sim.fleet.step[v]] for v in range(sim.n) if sim.fleet.step[v] < sim.fleet.steps[v]]
    assert all(start < FAR for start in planned)


def test_who_waits_behind_one_that_never_leaves_says_for_whom_and_is_seen() -> None:
    for seed in range(2):
        log = MemoryLog()
        text = scenario_text(NARROW, 6, seed=seed, orders=f'source = "poisson"\nrate_per_h = 700\n{ANY}')
        sim = build(parse(text), recorder=log)
        ahead = None
        while ahead is None:
            sim.advance(1)
            going = [v for v in range(sim.n) if sim.fleet.step[v] < sim.fleet.steps[v]]
            ahead = next((v for v in going if planning.behind(sim, v)), None)
        # it gives its plan up and is forgotten: nobody plans it again
        planning.drop_plan(sim, ahead)
        sim.needs_plan.clear()
        planning.retime(sim)
        behind = {v for v in range(sim.n) if (sim.steps.start[v, sim.fleet.step[v] : sim.fleet.steps[v]] >= FAR).any()}
        since = sim.tick
        assert behind
        sim.advance(120)
        waits = [r for r in so_far(sim, log) if r["kind"] == Activity.WAIT and r["t1"] - r["t0"] > 25]
        assert any(r["vehicle"] in behind and r["cause"] == Cause.VEHICLE and r["blocker"] == ahead for r in waits)
        assert not any(r["vehicle"] in behind and r["cause"] == Cause.PLANNED and r["t0"] >= since for r in waits)
        events = naive.rows_of(log.table("events"))
        stalled = [e for e in events if e["kind"] == "stalled" and e["tick"] > since]
        assert any(e["vehicle"] in behind and f"{ahead}" in e["text"] for e in stalled)
        nobody_met(sim, log)


@pytest.mark.parametrize("rule", ["mapf", "hold"])
def test_a_block_on_a_corner_stops_a_diagonal_already_planned(rule: str) -> None:
    stopped = 0
    for seed in range(4):
        log = MemoryLog()
        text = scenario_text(
            WIDE, 6, seed=seed, floor=f'occupancy = "{rule}"\nconnectivity = 8',
            orders=f'source = "poisson"\nrate_per_h = 1500\n{ANY}',
        )  # fmt: skip
        sim = build(parse(text), recorder=log)
        g, f = sim.graph, sim.fleet
        sim.advance(30)
        for v in range(sim.n):
            ahead = sim.steps.edge[v, f.step[v] : f.steps[v]]
            corners = [c for e in ahead[ahead >= 0] for c in g.sweep[g.sweep_ptr[e] : g.sweep_ptr[e + 1]].tolist()]
            if corners and sim.submit({"do": "block", "place": corners[-1]}).accepted:
                stopped += 1
        sim.advance(60)
        sim.check()
        nobody_met(sim, log)
    assert stopped > 3


def test_a_parked_vehicle_that_falls_low_goes_charging() -> None:
    text = scenario_text(
        HALL, 1, fleet='start = "parking"', battery="capacity_wh = 10.0\ninitial_soc = 0.5",
        orders=f'source = "poisson"\nrate_per_h = 0\n{ANY}',
    )  # fmt: skip
    sim = build(parse(text))
    sim.advance(200)
    assert sim.graph.state_place[sim.fleet.state[0]] == sim.world.parking[0]
    sim.advance(800)
    assert sim.graph.state_place[sim.fleet.state[0]] == sim.world.chargers[0]
    assert sim.fleet.charge[0] > 0.9 * sim.parts.battery.capacity_mc


def test_pose_between_two_ticks() -> None:
    text = scenario_text(LOOP, 2, motion="straight_ticks = 3\nturn_ticks = 2")
    sim = build(parse(text))
    seen = False
    for _ in range(300):
        sim.advance(1)
        a, half, b = sim.snapshot(), sim.snapshot(0.5), sim.snapshot(0.999)
        for v in range(sim.n):
            moving = sim.fleet.edge[v] >= 0
            seen = seen or bool(moving)
            away = abs(half.x_m[v] - a.x_m[v]) + abs(half.y_m[v] - a.y_m[v])
            assert (away > 0) == moving or sim.fleet.t1[v] == sim.tick
            assert abs(b.x_m[v] - a.x_m[v]) + abs(b.y_m[v] - a.y_m[v]) <= 1.0
            assert 0 <= half.heading_deg[v] < 360
            assert 0.0 <= half.soc[v] <= 1.0
    assert seen


@pytest.mark.nojit_slice
def test_a_short_run_without_the_jit() -> None:
    log = MemoryLog()
    sim = build(random_scenario(2, faults=True), recorder=log)
    for _ in range(6):
        sim.advance(15)
        sim.check()
    nobody_met(sim, log)


@pytest.mark.nojit_slice
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
def test_compiled_and_plain_integers_agree() -> None:
    lanes = np.array([1, 2], np.uint64)
    rows = np.array([[1, -1, 2**40], [0, 7, -(2**30)]], np.int64)
    kernels.digest(lanes, rows, 2)
    assert [hex(int(x)) for x in lanes] == ["0x9a65ae221cba62b9", "0xc387a86d69d5e22f"]
    drawn = [int(kernels.noise(7, v, d)) for v, d in ((0, 0), (3, 100))]
    assert drawn == [673033133788753802, 5131241274092996933]


def test_an_interval_says_why_somebody_waits() -> None:
    text = scenario_text(
        NARROW, 5, orders=f'source = "poisson"\nrate_per_h = 600\n{ANY}', faults="delay_probability = 0.2"
    )
    log = MemoryLog()
    sim = build(parse(text), recorder=log)
    sim.advance(1500)
    waits = [r for r in so_far(sim, log) if r["kind"] == Activity.WAIT]
    assert {1, 2, 4} <= {r["cause"] for r in waits}
    for r in waits:
        assert (r["blocker"] >= 0) == (r["cause"] == 2)
