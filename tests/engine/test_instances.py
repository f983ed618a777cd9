"""MAPF instances as runs: read, checked, solved at once, driven step by step, judged, disturbed and resumed."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from engine import MemoryLog, judge, load
from engine.build import PLANNERS, SOLVERS, build, find, fitted, planners_for, replay, resume, swap
from engine.errors import FormatError, ScenarioError
from engine.planners import Limits, Problem
from engine.scenario import Scenario, from_movingai, parse
from engine.scenario.checks import check
from engine.scenario.movingai import Instance, corner_instance, map_text, random_instance, scen_text
from engine.types import PRIMITIVE_0, Occupancy
from engine.world import build_world

WORK = 200_000
"""Expansions after which a solver gives up: some small instances have no plan, which a constraint tree can't tell."""

ON_INSTANCES = [name for name in PLANNERS if Occupancy.MAPF in find(PLANNERS, "planner", name).promise.occupancies]
"""Lifelong planners that serve the occupancy of instances."""


def instance(seed: int, agents: int = 5) -> Instance:
    """A small floor with up to so many vehicles."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            density = float(rng.choice([0.0, 0.1, 0.2]))
            sides = int(rng.integers(3, 8)), int(rng.integers(3, 8))
            return random_instance(rng, *sides, density, int(rng.integers(1, agents + 1)))
        except FormatError:
            continue


def asked(of: Instance, planner: str = "prioritized", /, **changes: Any) -> Scenario:
    text = from_movingai(map_text(of.free), scen_text(of), planner=planner, masses_kg=(1000.0, 1500.0)).to_toml()
    return parse(text, overrides={"planner.work": WORK, **{k.replace("__", "."): v for k, v in changes.items()}})


def paths_of(log: MemoryLog, sim: Any) -> NDArray[np.int64]:
    """(V, T+1) place of every vehicle at every tick, from the log's motions."""
    at = np.repeat(np.array(sim.parts.start)[:, None], sim.tick + 1, axis=1)
    m = log.table("motions")
    drives = np.flatnonzero(m["kind"] >= PRIMITIVE_0)
    for i in drives[np.argsort(m["t1"][drives], kind="stable")].tolist():
        at[m["vehicle"][i], m["t1"][i] :] = m["to_place"][i]
    return at


def problem_at_start(sim: Any) -> Problem:
    """What a solver is asked at tick 0."""
    states = sim.parts.facing
    blocked = np.zeros(sim.graph.n_places, np.uint8)
    return Problem(sim.graph, states, sim.goals, sim.parts.costs, sim.fleet.cls.astype(np.int32), blocked)


# ---------------------------------------------------------------- as planned


@pytest.mark.parametrize("solver", SOLVERS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 100_000))
def test_a_run_without_faults_is_the_solvers_plan(solver: str, seed: int) -> None:
    log = MemoryLog()
    sim = build(asked(instance(seed), solver), recorder=log)
    plan = sim.parts.solver.solve(problem_at_start(sim), Limits(WORK // 500, WORK))
    sim.advance(1)
    sim.check()
    sim.advance(1000)
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    if not plan.states:
        assert any(str(plan.status) in text for text in log.table("events")["text"].tolist())
        return
    assert sim.done
    assert sim.tick == max(len(states) - 1 for states in plan.states)
    driven = paths_of(log, sim)
    for v, states in enumerate(plan.states):
        places = sim.graph.state_place[states]
        assert driven[v, : len(places)].tolist() == places.tolist()
        assert (driven[v, len(places) :] == places[-1]).all()
    energies = log.table("plans")["energy_mj"]
    resting = sum((sim.tick - len(s) + 1) * int(sim.parts.costs.standby_mj[0]) for s in plan.states)
    assert sim.fleet.ledger.sum() == energies.sum() + resting
    if solver in ("ecbs", "time-window"):
        assert energies.sum() == plan.cost
    else:
        assert sum(len(s) - 1 for s in plan.states) == plan.cost


@pytest.mark.parametrize("planner", ON_INSTANCES)
def test_lifelong_planners_bring_vehicles_to_each_others_starts(planner: str) -> None:
    """Four corners, each vehicle begins at another's goal: nobody finds a way while the others are seen to stay."""
    scenario = asked(corner_instance(np.random.default_rng(7), 12, 0.15), planner)
    log = MemoryLog()
    sim = build(scenario, recorder=log)
    if sim.parts.solver is not None:
        sim = build(scenario.model_copy(update={"floor": scenario.floor.model_copy(update={"occupancy": "hold"})}))
        log = sim.ledger.recorder = MemoryLog()
    sim.advance(2000)
    sim.flush()
    assert sim.done
    assert judge(log, sim.scenario, sim.world) == []


def test_the_paper_run_costs_what_ecbs_proves() -> None:
    log = MemoryLog()
    sim = build("xu2025", recorder=log)
    proof = sim.parts.solver.solve(problem_at_start(sim), Limits())
    sim.advance(10_000)
    sim.flush()
    assert (sim.done, sim.tick, sim.metrics()["stranded"]) == (True, 38, 0)
    assert judge(log, sim.scenario, sim.world) == []
    assert (proof.cost, proof.lower_bound) == (51_274_300, 51_274_300)
    assert sim.fleet.ledger.sum() == proof.cost


# ---------------------------------------------------------------- disturbed

TROUBLE: dict[str, Any] = {
    "faults__delay_probability": 0.1,
    "faults__breakdowns_per_vehicle_day": 2000.0,
    "faults__repair_s": 8.0,
}
HOLD: dict[str, Any] = {"floor__occupancy": "hold", "floor__margin_ticks": 1, "motion__turn_ticks": 2}


def some_command(rng: random.Random, sim: Any) -> dict[str, Any]:
    vehicle, place = rng.randrange(sim.n), rng.randrange(sim.graph.n_places)
    blocked = sim.blocked.nonzero()[0].tolist()
    return rng.choice(
        [
            *({"do": word, "vehicle": vehicle} for word in ("pause", "continue", "fail", "repair", "charge")),
            {"do": "block", "place": place},
            {"do": "unblock", "place": blocked[0] if blocked else place},
            {"do": "send", "vehicle": vehicle, "place": place},
            {"do": "order", "from": 1, "to": 2},
            {"do": "rate", "per_h": 10},
        ]
    )


def all_well(sim: Any) -> list[dict[str, Any]]:
    """Commands that undo whatever stops vehicles."""
    blocked = [{"do": "unblock", "place": place} for place in sim.blocked.nonzero()[0].tolist()]
    return blocked + [{"do": word, "vehicle": v} for v in range(sim.n) for word in ("continue", "repair")]


@pytest.mark.parametrize("planner", list(dict.fromkeys([*ON_INSTANCES, *SOLVERS])))
@pytest.mark.parametrize("seed", range(4))
def test_nothing_an_operator_or_a_fault_does_breaks_a_rule(planner: str, seed: int, tmp_path: Path) -> None:
    rng = random.Random(f"{planner} {seed}")
    hold = seed == 3 and planner in PLANNERS
    log = MemoryLog()
    sim = build(asked(instance(seed + 100), planner, **TROUBLE, **(HOLD if hold else {})), recorder=log)
    given: list[tuple[int, int, dict[str, Any]]] = []

    def say(command: dict[str, Any]) -> None:
        answer = sim.submit(command)
        assert answer.reason
        given.append((answer.tick, answer.number, command))
        sim.check()

    while sim.tick < 50 and not sim.done:
        sim.advance(rng.randint(1, 5))
        sim.check()
        if sim.done:
            break
        say(some_command(rng, sim))
        if len(given) == 4:
            sim.checkpoint(tmp_path / "here")
    for command in all_well(sim):
        say(command)
    sim.advance(300)
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    if len(given) >= 4 and (tmp_path / "here").exists():
        again = resume(tmp_path / "here")
        replay(again, given)
        again.advance(sim.tick - again.tick)
        assert again.digest() == sim.digest()


@pytest.mark.parametrize("planner", list(dict.fromkeys([*ON_INSTANCES, *SOLVERS])))
def test_vehicles_get_home_after_trouble(planner: str) -> None:
    """A blocked cell on the way, a vehicle that breaks down and is repaired: late, but everybody arrives."""
    of = corner_instance(np.random.default_rng(1), 10, 0.1)
    log = MemoryLog()
    sim = build(asked(of, planner, faults__delay_probability=0.05), recorder=log)
    sim.advance(3)
    ahead = int(sim.arrays.state_place[sim.arrays.edge_to[sim.steps.edge[0, sim.fleet.step[0] + 3]]])
    assert sim.submit({"do": "block", "place": ahead}).accepted
    sim.advance(4)
    assert sim.submit({"do": "fail", "vehicle": 1}).accepted
    assert sim.submit({"do": "pause", "vehicle": 2}).accepted
    sim.advance(20)
    assert sim.submit({"do": "repair", "vehicle": 1}).accepted
    assert sim.submit({"do": "continue", "vehicle": 2}).accepted
    sim.advance(1000)
    sim.flush()
    assert sim.done
    assert judge(log, sim.scenario, sim.world) == []
    assert not (paths_of(log, sim)[:, 4:] == ahead).any()


def test_a_goal_that_is_blocked_is_waited_for() -> None:
    sim = build(asked(corner_instance(np.random.default_rng(1), 6, 0.0), "cbs"))
    goal = int(sim.goals[0])
    sim.advance(2)
    assert sim.submit({"do": "block", "place": goal}).accepted
    sim.advance(300)
    assert not sim.done
    assert sim.needs_plan == [0]
    assert sim.submit({"do": "unblock", "place": goal}).accepted
    sim.advance(100)
    assert sim.done


def test_a_solver_without_a_plan_says_so_and_the_vehicles_are_planned_in_turn() -> None:
    of = random_instance(np.random.default_rng(2), 7, 7, 0.1, 14)
    log = MemoryLog()
    sim = build(asked(of, "cbs", planner__work=1, **{"planner.parameters": {"tries": 0}}), recorder=log)
    sim.advance(500)
    sim.flush()
    said = log.table("events")["text"].tolist()
    assert any(text.startswith("cbs: budget spent") and "planned in turn" in text for text in said), said
    assert sim.done
    assert judge(log, sim.scenario, sim.world) == []


def test_a_fork_is_planned_anew_from_where_the_vehicles_are(tmp_path: Path) -> None:
    of = corner_instance(np.random.default_rng(4), 12, 0.2)
    log = MemoryLog()
    sim = build(asked(of, "cbs"), recorder=log)
    sim.advance(5)
    swap(sim, planner="ecbs")
    sim.advance(3)
    sim.checkpoint(tmp_path / "fork")
    sim.advance(500)
    sim.flush()
    assert sim.done
    assert judge(log, sim.scenario, sim.world) == []
    plans = log.table("plans")
    assert plans["tick"].tolist() == [0] * 4 + [5] * 4
    again = resume(tmp_path / "fork")
    again.advance(500)
    assert again.digest() == sim.digest()


def test_a_failed_vehicle_on_anothers_goal_is_no_end() -> None:
    of = corner_instance(np.random.default_rng(1), 6, 0.0)
    sim = build(asked(of, "ecbs"))
    assert sim.submit({"do": "fail", "vehicle": 3}).accepted
    sim.advance(200)
    assert not sim.done
    there = [v for v in range(4) if sim.graph.state_place[sim.fleet.state[v]] == sim.goals[v]]
    assert there == [1, 2]
    assert sim.submit({"do": "repair", "vehicle": 3}).accepted
    sim.advance(200)
    assert sim.done


# ---------------------------------------------------------------- reading and checking

MAP = "type octile\nheight 3\nwidth 4\nmap\n.GSE\n@OTW\n....\n"
SCEN = "version 1\n0\tm.map\t4\t3\t0\t0\t3\t0\t3\n0\tm.map\t4\t3\t3\t2\t0\t2\t3\n"


def test_a_movingai_instance_is_a_scenario() -> None:
    read = from_movingai(MAP, SCEN, map_name="Some Map.map", scen_name="s.scen", seed=9)
    assert (read.name, read.seed, read.fleet.count) == ("some-map", 9, 2)
    assert read.floor.drawing() == ("....", "####", "....")
    assert read.fleet.start == ((0, 2), (3, 0))
    assert read.orders.goals == ((3, 2), (0, 0))
    assert parse(read.to_toml()) == read
    assert [f.level for f in check(read, build_world(read))] == ["ok", "ok"]
    assert from_movingai(MAP, SCEN, agents=1).fleet.count == 1


@pytest.mark.parametrize(
    ("scen", "agents", "said"),
    [
        (SCEN, 3, "s.scen: 3 vehicles were asked for; it has 2 rows"),
        ("version 1\n", None, "s.scen: at least one vehicle was expected, got none"),
        (SCEN.replace("3\t0\t3", "3\t1\t3"), None, "s.scen, line 2: goal (3, 1) is blocked on the map m.map"),
        (SCEN.replace("3\t2\t0\t2", "0\t0\t0\t2"), None, "s.scen, line 3: start (0, 0) is taken by line 2"),
        (SCEN.replace("4\t3\t0", "4\t5\t0", 1), None, "s.scen, line 2: the map m.map is 4 × 3 cells"),
    ],
)
def test_bad_instances_are_told_with_their_lines(scen: str, agents: int | None, said: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        from_movingai(MAP, scen, agents=agents, map_name="m.map", scen_name="s.scen")
    assert str(caught.value).startswith(said)
    with pytest.raises(ScenarioError, match=r"m.map, line 5: column 1: one of .* was expected, got 'X'"):
        from_movingai(MAP.replace(".G", "XG"), SCEN, map_name="m.map")


TOML = """
name = "inst"
title = "Instance"
[time]
finish = "goals reached"
[floor]
kind = "movingai"
occupancy = "mapf"
map = "maps/m.map"
[fleet]
count = 2
start = [[0, 2], [3, 0]]
[orders]
source = "goals"
goals = [[3, 2], [0, 0]]
[planner]
name = "ecbs"
"""


def test_a_map_beside_the_scenario_is_read_into_it(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "m.map").write_text(MAP)
    file = tmp_path / "inst.toml"
    file.write_text(TOML)
    read = load(file)
    assert (read.floor.map, read.floor.rows) == (None, "....\n@@@@\n....")
    assert parse(read.to_toml()) == read
    with pytest.raises(ScenarioError, match=r"line 9: floor.map: a map beside the scenario is read when"):
        parse(TOML)
    for name in ("../m.map", "/etc/passwd", "m.txt"):
        file.write_text(TOML.replace("maps/m.map", name))
        with pytest.raises(ScenarioError, match=r"line 9: floor.map: got .*, expected a .map file in the folder"):
            load(file)
    file.write_text(TOML.replace("maps/m.map", "n.map"))
    with pytest.raises(ScenarioError, match=r"line 9: floor.map: .*n.map: can't be read: No such file"):
        load(file)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[3, 2], [0, 0]]", "[3, 2]]", "orders.goals: got 1 cells for 2 vehicles; expected one each"),
        ("[3, 2], [0, 0]]", "[3, 2], [0, 1]]", "orders.goals, item 2: (0, 1) is a wall; a vehicle can't be there"),
        ("[3, 2], [0, 0]]", "[3, 2], [3, 2]]", "orders.goals, item 2: (3, 2) is taken twice"),
        ("[3, 2], [0, 0]]", "[3, 2], [9, 0]]", "orders.goals, item 2: (9, 0) lies outside the floor of 4 × 3 cells"),
        ("[0, 2], [3, 0]]", "[0, 2], [0, 2]]", "fleet.start, item 2: (0, 2) is taken twice"),
        (
            "goals reached",
            "orders done",
            "time.finish: got 'orders done', but orders.source is 'goals': expected 'goals reached' or 'never'",
        ),
        ("@OTW", "@OXW", "floor.rows: row 2, column 3: unknown letter 'X'; known: ., @, E, G, O, S, T, W"),
    ],
)
def test_what_instances_say_must_fit_together(old: str, new: str, said: str) -> None:
    text = TOML.replace('map = "maps/m.map"', 'rows = """\n.GSE\n@OTW\n....\n"""')
    assert parse(text)
    with pytest.raises(ScenarioError) as caught:
        parse(text.replace(old, new))
    assert said in str(caught.value)


def test_a_goal_out_of_reach_is_found() -> None:
    text = TOML.replace('map = "maps/m.map"', 'rows = """\n.GSE\n@OTW\n....\n"""')
    read = parse(text.replace("[3, 2], [0, 0]]", "[3, 0], [0, 0]]"))
    found = check(read, build_world(read))
    assert (found[0].level, found[0].check) == ("error", "goals")
    assert found[0].text == "vehicle 0 starts at (0, 2), from where no way leads to (3, 0)"
    log = MemoryLog()
    sim = build(read, recorder=log)
    sim.advance(100)
    sim.flush()
    said = log.table("events")["text"].tolist()
    assert "ecbs: no path, vehicle 0 has no way to its goal; the vehicles are planned in turn" in said
    assert sim.graph.state_place[sim.fleet.state[1]] == sim.goals[1]
    assert judge(log, sim.scenario, sim.world) == []


# ---------------------------------------------------------------- who fits


def test_planners_are_offered_where_they_fit() -> None:
    of = asked(instance(1))
    assert planners_for(of) == [
        "prioritized",
        "quickest",
        "astar",
        "eea",
        "aco",
        "soochow-table",
        "cbs",
        "ecbs",
        "time-window",
    ]
    on_hold = [
        "prioritized",
        "quickest",
        "stochastic",
        "astar-distance",
        "astar-turns",
        "astar",
        "eea",
        "aco",
        "soochow-table",
    ]
    assert planners_for(load("soochow2022")) == on_hold
    assert planners_for(load("lian2024")) == on_hold[:-4]
    assert planners_for(asked(instance(1), motion__turning="pivot")) == ["prioritized", "quickest", "cbs", "ecbs"]
    assert planners_for(asked(instance(1), floor__connectivity=8)) == [
        "prioritized",
        "quickest",
        "astar",
        "aco",
        "soochow-table",
    ]
    assert planners_for(asked(instance(1), **HOLD)) == on_hold


@pytest.mark.parametrize(
    ("planner", "changes", "why"),
    [
        ("cbs", {"floor__occupancy": "hold"}, "needs the occupancy 'mapf', and floor.occupancy is 'hold'"),
        ("ecbs", {"floor__connectivity": 8}, "needs 4 neighbours per cell, and floor.connectivity is 8"),
        ("eea", {"motion__turning": "pivot"}, "needs vehicles that turn while driving, and motion.turning is 'pivot'"),
    ],
)
def test_a_planner_that_does_not_fit_is_refused(planner: str, changes: dict[str, Any], why: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        build(asked(instance(1), planner, **changes))
    assert str(caught.value).startswith(f"planner.name: {planner!r} {why}; expected 'prioritized' or")


def test_solvers_need_goals_and_unknown_names_get_the_nearest() -> None:
    with pytest.raises(
        ScenarioError, match=r"'ecbs' plans all vehicles at once, each to its goal, and orders.source is"
    ):
        build("soochow2022", planner="ecbs")
    with pytest.raises(ScenarioError, match="unknown planner 'ecb'; did you mean 'ecbs'"):
        build("xu2025", planner="ecb")


def test_a_planner_with_one_objective_has_that_objective() -> None:
    for name in SOLVERS:
        objectives = find(SOLVERS, "planner", name).promise.objectives
        for given_one in ("time", "energy"):
            got = fitted(asked(instance(1), name, planner__objective=given_one)).planner.objective
            assert got == (given_one if len(objectives) > 1 else objectives[0])


def test_headings_at_the_start_can_be_given() -> None:
    west = build(asked(instance(1), fleet__heading="west"))
    assert {west.graph.heading_deg[h] for h in west.graph.state_heading[west.fleet.state].tolist()} == {180}
