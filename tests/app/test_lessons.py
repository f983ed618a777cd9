"""The lessons: what they play is what the planners did, and every address gives a floor or a sentence."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.lessons import LESSONS, ants, anytime, base, break_it, heuristics, learned_time, lesson, motor, search, tree
from engine.build import terrain_costs
from engine.energy import parameter_sets
from engine.energy.drive import forward
from engine.energy.lian2024 import lian2024
from engine.errors import BadInput, FormatError
from engine.planners.base import Observed
from engine.planners.routing import lengths_of, turns_of
from engine.planners.stochastic import Stochastic
from engine.types import Component
from engine.world.motion_graph import Primitive
from tests import naive_dispatch, naive_terrain
from tests import naive_mapf2 as naive
from tests.naive_mapf import joint_optimum

TRIALS = [
    f"{name}.{heuristic}.{tie}"
    for name, choice in search.ALGORITHMS.items()
    for heuristic in choice.heuristics
    for tie in choice.ties
]
EXACT = [text for text in TRIALS if text.split(".")[0] in ("eea", "dijkstra-energy")]


def columns(packed: dict[str, str]) -> dict[str, list[int]]:
    return {name: np.frombuffer(base64.b64decode(text), "<i4").tolist() for name, text in packed.items()}


def query_of(free: np.ndarray, start: naive.Cell, goal: naive.Cell, panels: str) -> dict[str, str]:
    ends = {"start": f"{start[0]}.{start[1]}", "goal": f"{goal[0]}.{goal[1]}"}
    return {"map": base.floor_text(free), **ends, "panels": panels}


@st.composite
def floors(draw: st.DrawFn) -> tuple[np.ndarray, naive.Cell, naive.Cell]:
    """A small floor and two different free cells, which may not reach each other."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = draw(st.integers(2, 8)), draw(st.integers(2, 8))
    free = rng.random((height, width)) >= draw(st.sampled_from([0.0, 0.2, 0.4]))
    start, goal = (int(n) for n in rng.choice(width * height, 2, replace=False))
    free.ravel()[[start, goal]] = True
    return free, (start % width, start // width), (goal % width, goal // width)


# -- search -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("panel", TRIALS)
@settings(max_examples=8)
@given(floors())
def test_a_playback_is_the_search(panel: str, question: tuple[np.ndarray, naive.Cell, naive.Cell]) -> None:
    free, start, goal = question
    answer = search.answer(query_of(free, start, goal, panel))
    told = answer["panels"][0]
    rows, entries, path = columns(told["rows"]), columns(told["entries"]), columns(told["path"])
    width = free.shape[1]
    assert told["solved"] is (naive.steps(free, start, goal) is not None)
    joules = told["unit"] == "J"
    for i, by in enumerate(rows["by"]):
        # each expansion follows from an earlier one, a cell away or on the spot
        assert by < i
        assert rows["energy"][i] == rows["g"][i] or not joules
        if by < 0:
            assert rows["cell"][i] == start[0] + width * start[1]
            continue
        assert (
            abs(rows["cell"][i] % width - rows["cell"][by] % width)
            + abs(rows["cell"][i] // width - rows["cell"][by] // width)
            == rows["steps"][i] - rows["steps"][by]
        )
        assert rows["g"][i] > rows["g"][by]
    expanded = {row: i for i, row in enumerate(entries["row"]) if row >= 0}
    assert sorted(expanded) == list(range(len(rows["g"])))
    for row, i in expanded.items():
        # what was put on the open list is what was taken from it
        for name in ("cell", "heading", "g", "h"):
            assert entries[name][i] == rows[name][row]
        assert entries["at"][i] == rows["by"][row] < entries["until"][i] == row
    for i, waiting in enumerate(rows["open"]):
        useful = sum(
            at < i and (until < 0 or until > i) for at, until in zip(entries["at"], entries["until"], strict=True)
        )
        assert useful <= waiting
    if told["solved"]:
        assert path["cell"][0] == start[0] + width * start[1]
        assert path["cell"][-1] == goal[0] + width * goal[1]
        assert path["energy"][-1] == told["energy_mj"]
        assert told["energy_mj"] == told["cost"] or not joules


@settings(max_examples=40)
@given(floors(), st.sampled_from(EXACT))
def test_the_goal_costs_what_it_must(question: tuple[np.ndarray, naive.Cell, naive.Cell], energy_panel: str) -> None:
    free, start, goal = question
    by_distance = ("astar.manhattan.lifo", "astar.euclidean.random3", "dijkstra.zero.larger-g")
    told = search.answer(query_of(free, start, goal, "~".join((*by_distance, energy_panel))))["panels"]
    steps = naive.steps(free, start, goal)
    least = naive.least_energy(free, [(start, h, False) for h in range(4)], goal, naive.Energy())
    for panel in told[:3]:
        assert panel["cost"] == (-1 if steps is None else 1000 * steps)
    assert told[3]["cost"] == (-1 if least is None else least)


@settings(max_examples=30)
@given(floors(), st.sampled_from(["fifo", "lifo"]))
def test_cells_are_expanded_in_the_textbook_order(
    question: tuple[np.ndarray, naive.Cell, naive.Cell], tie: str
) -> None:
    free, start, goal = question
    told = search.answer(query_of(free, start, goal, f"astar.manhattan.{tie}~dijkstra.zero.{tie}"))["panels"]
    estimates = (lambda c: abs(c[0] - goal[0]) + abs(c[1] - goal[1]), lambda c: 0)
    for panel, h in zip(told, estimates, strict=True):
        order, _ = naive.expansions(free, start, goal, h, tie)
        assert columns(panel["rows"])["cell"] == [x + free.shape[1] * y for x, y in order]


def test_the_counterexample_is_an_example() -> None:
    preset = next(p for p in search.PRESETS if p.word.startswith("3 × 3"))
    exact, cell, time = search.answer(preset.query)["panels"]
    # 628.1 + 128.1 + 2 · 338.37 J, and 628.1 + 3 · 338.37 J
    assert exact["cost"] / 1000 == pytest.approx(1432.9, abs=0.1)
    assert cell["cost"] == time["cost"]
    assert cell["cost"] / 1000 == pytest.approx(1643.3, abs=0.15)
    assert "1643 J" in preset.look
    assert "1433 J" in preset.look


def test_a_search_has_a_limit_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "EXPANSIONS", 10)
    told = search.answer({**search.PRESETS[0].query, "panels": "dijkstra.zero.fifo~dijkstra-energy.zero.fifo"})[
        "panels"
    ]
    for panel in told:
        assert not panel["solved"]
        assert panel["expanded"] == 10
        assert panel["status"].startswith("stopped after 10 expansions")


def test_increments_are_the_papers() -> None:
    joules = search.increments()
    assert joules["straight"] == pytest.approx(128.1, abs=0.05)
    assert joules["turn"] == pytest.approx(338.4, abs=0.1)
    assert joules["start"] == pytest.approx(628.1, abs=0.05)
    assert joules["wait"] == 30.0


# -- tree -------------------------------------------------------------------------------------------------------------


def positions(way: dict[str, Any], tick: int) -> int:
    return way["cells"][min(tick, len(way["cells"]) - 1)]


def clashes(plan: list[dict[str, Any]]) -> int:
    found = 0
    for tick in range(max(len(way["cells"]) for way in plan)):
        now = [positions(way, tick) for way in plan]
        then = [positions(way, tick + 1) for way in plan]
        found += len(now) - len(set(now))
        found += sum(
            now[i] == then[j] and now[j] == then[i] and now[i] != now[j] for i in range(len(now)) for j in range(i)
        )
    return found


@pytest.mark.parametrize("on", ["none", tree.ALL_ON, f"{tree.ALL_ON}.incumbent"])
@pytest.mark.parametrize("planner", ["cbs", "ecbs"])
@pytest.mark.parametrize("preset", tree.PRESETS[:5], ids=lambda p: p.word)
def test_a_tree_is_the_solvers(preset: base.Preset, planner: str, on: str) -> None:
    query = {**preset.query, "planner": planner, "on": on}
    told = tree.answer(query)
    nodes = told["nodes"]
    turns = sorted(node["turn"] for node in nodes if node["turn"] >= 0)
    assert turns == list(range(len(turns)))
    for node in nodes:
        plan = [told["ways"][way] for way in told["plans"][node["node"]]]
        cost = (
            sum(way["energy_mj"] for way in plan) if planner == "ecbs" else sum(len(way["cells"]) - 1 for way in plan)
        )
        assert cost == node["cost"]
        assert bool(clashes(plan)) is bool(node["conflicts"])
        if node["parent"] >= 0:
            parent = nodes[node["parent"]]
            assert parent["turn"] >= 0
            assert parent["f"] <= node["f"]
        if conflict := node["conflict"]:
            a, b = (plan[conflict[k]] for k in "ab")
            one = [positions(a, conflict["tick"]), positions(a, conflict["tick"] + 1)]
            two = [positions(b, conflict["tick"]), positions(b, conflict["tick"] + 1)]
            assert one == conflict["cells"] == two[::-1] if len(conflict["cells"]) > 1 else one[0] == two[0]
        if match := re.fullmatch(r"(\d) ([≠=]) \((\d+),(\d+)\) @(\d+)", node["short"]):
            vehicle, sign, x, y, tick = match.groups()
            here = positions(plan[int(vehicle)], int(tick)) == int(x) + told["width"] * int(y)
            assert here is (sign == "=")
        assert node["why"].endswith(".")
    if told["answer"]:
        assert clashes(told["answer"]) == 0


def test_switches_change_the_tree_and_never_the_optimum() -> None:
    query = tree.PRESETS[0].query
    sizes = {}
    for on in ("none", "disjoint", "cardinal.bypass", tree.FOUR, tree.ALL_ON):
        told = tree.answer({**query, "on": on})
        assert told["status"].startswith("optimal")
        sizes[on] = (len(told["nodes"]), told["cost"])
    assert len({cost for _, cost in sizes.values()}) == 1
    assert sizes[tree.ALL_ON][0] <= sizes[tree.FOUR][0] < sizes["none"][0] / 4


def test_the_optimum_is_the_joint_searchs() -> None:
    asked = tree.read(tree.PRESETS[1].query)
    problem = tree.problem_of(asked.instance, masses_kg=tree.MASSES[asked.mass])
    assert tree.answer(tree.PRESETS[1].query)["cost"] == joint_optimum(problem, energy=True)


def test_a_tree_has_a_limit_and_says_so() -> None:
    told = tree.answer({**tree.PRESETS[3].query, "planner": "ecbs"})
    assert told["expanded"] == tree.EXPANSIONS
    assert f"limit of {tree.EXPANSIONS} expansions" in told["status"]
    closed = tree.answer({**tree.PRESETS[0].query, "map": base.drawn("..", "##", ".."), "vehicles": "0.0-0.2~1.0-1.2"})
    assert closed["status"] == "no path: vehicle 0 has no way to its goal"
    assert closed["nodes"] == []


def test_rule_b_finds_no_plan_where_there_is_one() -> None:
    query = next(p for p in tree.PRESETS if p.word == "Rule B").query
    assert tree.answer(query)["status"] == "no plan: the priority rule left no plan"
    assert tree.answer({**query, "planner": "cbs"})["solved"]


# -- learned time -----------------------------------------------------------------------------------------------------


def test_the_recorded_times_are_what_the_router_learns() -> None:
    """Every refresh follows from what was seen before it, by the planner's own rule."""
    run, router, world = learned_time.learned(), Stochastic(), learned_time.network()
    tick_s = learned_time.scenario().time.tick_s
    assert run.seconds == tuple(1800.0 * k for k in range(1, 21))
    memory = router.init(world.graph, learned_time._floor_search()[1], np.random.default_rng(0))
    for k, before in enumerate(learned_time.expectations()[:-1]):
        memory = learned_time.taught(router, memory, before)
        np.testing.assert_array_equal(memory["expected_ms"], before)
        total = run.samples[k] * run.mean_ms[k] / (1000 * tick_s)
        after = router.learn(Observed(run.samples[k], total, tick_s), memory)["expected_ms"]
        assert np.abs(after - run.expected_ms[k]).max() <= 1  # means are logged in whole milliseconds
    assert run.samples.sum() > 100_000
    assert run.busy_ms.max() <= 1_800_000


@pytest.mark.slow
def test_the_recorded_times_are_those_of_the_run_as_it_is_now() -> None:
    """The first hour, simulated anew; when this fails, scripts/learned_time.py records the times again."""
    from engine import MemoryLog
    from engine.build import build

    log = MemoryLog()
    simulation = build(learned_time.scenario(), recorder=log)
    simulation.advance(36_000)
    simulation.flush()
    run, arcs = learned_time.learned(), log.table("arcs")
    for k, tick in enumerate((18_000, 36_000)):
        now = arcs["tick"] == tick
        np.testing.assert_array_equal(run.expected_ms[k, arcs["place"][now]], arcs["expected_ms"][now])
        np.testing.assert_array_equal(run.samples[k, arcs["place"][now]], arcs["samples"][now])


def best(graph: Any, costs: np.ndarray, state: int, goal: int) -> int:
    """The least sum of costs from a state to a place, by an independent search over poses."""
    import networkx as nx

    net = nx.DiGraph()
    ends = ((graph.edge_from // 2).tolist(), (graph.edge_to // 2).tolist(), costs.tolist())
    net.add_weighted_edges_from(zip(*ends, strict=True))
    found = nx.single_source_dijkstra_path_length(net, state // 2)
    poses = range(int(graph.place_ptr[goal]) // 2, int(graph.place_ptr[goal + 1]) // 2)
    return min(found[pose] for pose in poses if pose in found)


@pytest.mark.parametrize(("start", "goal"), [("N102", "E2"), ("E16", "E2"), ("N18", "E8"), ("E1", "N64")])
def test_every_route_is_the_best_by_its_own_measure(start: str, goal: str) -> None:
    told = {m["name"]: m for m in learned_time.answer({"start": start, "goal": goal, "have": "1"})["methods"]}
    view = learned_time._view(learned_time.read({"start": start, "goal": goal}))
    graph, world, end = view.graph, learned_time.network(), learned_time.stations()[goal]
    length, turn = lengths_of(graph), turns_of(graph)
    for step in (0, 7, 20):
        now = {name: method["ways"][method["taken"][step]] for name, method in told.items()}
        cost = learned_time._costs()[step]
        assert told["stochastic"]["expected_ms"][step] == best(graph, cost, view.request.state, end)
        assert all(told["stochastic"]["expected_ms"][step] <= method["expected_ms"][step] for method in told.values())
        assert now["astar-distance"]["mm"] == best(graph, length, view.request.state, end)
        fewest = best(graph, length * 10_000 + turn, view.request.state, end)
        assert now["astar-turns"]["mm"] * 10_000 + 90 * now["astar-turns"]["turns"] == fewest
        for way in now.values():
            assert (way["places"][0], way["places"][-1]) == (learned_time.stations()[start], end)
            lanes = [world.lane_ends[p - world.n_nodes].tolist() for p in way["places"] if p >= world.n_nodes]
            assert [a for _, a in lanes[:-1]] == [b for b, _ in lanes[1:]]
            assert way["mm"] == 900 * len(lanes) == 900 * way["arcs"]
    assert len(told["literal"]["ways"]) == 1  # blind to what was learned


def test_what_the_examples_say_of_the_routes_is_so() -> None:
    said = {p.word: {m["name"]: m for m in learned_time.answer(p.query)["methods"]} for p in learned_time.PRESETS}

    def taken(word: str, name: str, step: int) -> dict[str, Any]:
        method = said[word][name]
        return method["ways"][method["taken"][step]]

    busy = "Into a busy column"
    assert len({tuple(taken(busy, name, 0)["places"]) for name in learned_time.METHODS}) == 1
    assert (taken(busy, "stochastic", 20)["turns"], taken(busy, "astar-turns", 20)["turns"]) == (2, 1)
    assert said[busy]["astar-turns"]["expected_ms"][20] > 1.2 * said[busy]["stochastic"]["expected_ms"][20]
    for name in ("literal", "astar-turns", "astar-distance"):
        assert len(said[busy][name]["ways"]) == 1
    longer = [
        taken("A way round", "stochastic", k)["mm"] - taken("A way round", "astar-turns", k)["mm"] for k in range(21)
    ]
    assert longer[0] == 0
    assert max(longer) > 0
    assert len(said["Changing its mind"]["stochastic"]["ways"]) >= 6
    quiet = said["Nothing to gain"]
    assert len({method["expected_ms"][20] for method in quiet.values()}) == 1


def test_times_of_another_floor_are_refused(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyarrow.parquet as pq

    table = pq.read_table(learned_time.FILE)
    other = table.replace_schema_metadata({learned_time.ABOUT: '{"places": 12}'})
    pq.write_table(other, tmp_path / "other.parquet")
    monkeypatch.setattr(learned_time, "FILE", tmp_path / "other.parquet")
    with pytest.raises(FormatError, match="a floor of 12 places, lian2024 has 516"):
        learned_time.learned.__wrapped__()


# -- motor to battery -------------------------------------------------------------------------------------------------


def drive(**changes: str) -> dict[str, Any]:
    return dict(motor.answer({**motor.USUAL, **changes}))


@settings(max_examples=25)
@given(
    st.fixed_dictionaries({key: st.integers(0, round((s.high - s.low) / s.step)) for key, s in motor.SLIDERS.items()})
)
def test_any_drive_has_an_answer(at: dict[str, int]) -> None:
    query = {key: f"{s.low + at[key] * s.step:.1f}" for key, s in motor.SLIDERS.items()}
    told = motor.answer(query)
    curves = told["curves"]
    assert len({len(values) for values in curves.values()}) == 1
    assert all(np.isfinite(values).all() for values in curves.values())
    assert told["total"] == pytest.approx(sum(told["energy"].values()), abs=0.01)
    assert curves["ours"][-1] == pytest.approx(told["total"], abs=0.01)
    assert ("soc" in curves) is (told["drives"] is not None)
    assert "soc" in curves or told["limits"]
    if "soc" in curves:
        needed = np.maximum(np.abs(curves["voltage_l"]), np.abs(curves["voltage_r"]))
        assert bool(told["limits"]) >= bool((needed > np.array(curves["terminal"]) + 1e-3).any())
    track, wheel = parameter_sets.lian2024()["track_m"], parameter_sets.lian2024()["wheel_m"]
    v, _ = forward(np.array(curves["wheel_l"]) * wheel, np.array(curves["wheel_r"]) * wheel, track)
    np.testing.assert_allclose(v, curves["v"], atol=1e-4)


def test_a_drive_costs_what_the_demand_model_says_of_its_primitives() -> None:
    """Two starts over 5 m each and a pivot in 2 s: said by the primitives of a run, not by a trace over time."""
    told = drive(turn="90", turning="2.0")
    model = lian2024(**parameter_sets.lian2024())
    start = model.joules(Primitive("start straight 5000 mm", 5000, 0, True, False, 50), 500.0, 5.0)
    pivot = model.joules(Primitive("pivot 90°", 0, 90, False, True, 20), 500.0, 2.0)
    for component in (Component.COPPER, Component.TURNING):
        want = 2 * start.get(component, 0.0) + pivot.get(component, 0.0)
        assert told["energy"][component.name.lower()] == pytest.approx(want, rel=0.01)
    want = 2 * (start[Component.ROLLING] + start[Component.STARTING])
    assert told["energy"]["rolling"] + told["energy"]["starting"] == pytest.approx(want, rel=0.01)
    assert told["energy"]["standby"] == pytest.approx(20.0 * (2 * 7.0 + 2.0), rel=0.01)
    assert told["limits"] == []


def test_the_battery_gives_what_the_drive_draws() -> None:
    told = drive(distance="40")
    _, pack = motor.battery()
    volts = float(np.mean(told["curves"]["terminal"]))
    assert told["used"] * pack.delivered_ah * 3600 * volts == pytest.approx(told["total"], rel=0.03)
    assert told["drives"] == int(1 / told["used"])
    assert (np.diff(told["curves"]["soc"]) <= 0).all()


def test_the_papers_formula_is_a_state_taken_for_a_consumption() -> None:
    near, far = drive(), drive(distance="40")
    for told, seconds in ((near, 12.0), (far, 42.0)):
        assert told["paper"]["corrected"] == pytest.approx(250.0 + 20 * seconds, rel=1e-3)
        assert told["paper"]["quarter"] == pytest.approx(500.0 + 20 * seconds, rel=1e-3)
        assert told["paper"]["radius"] == pytest.approx(0.25 * 500 * 0.1 * 20**2 + 20 * seconds, rel=1e-3)
        assert max(told["curves"]["kinetic"]) == pytest.approx(250.0, rel=0.02)
        assert told["curves"]["kinetic"][-1] < 1.0
        assert told["curves"]["paper"][-1] == pytest.approx(told["paper"]["corrected"], rel=0.02)
    assert far["energy"]["rolling"] > 3 * near["energy"]["rolling"]


def test_what_the_examples_say_of_the_drive_is_so() -> None:
    told = {preset.word: motor.answer(preset.query) for preset in motor.PRESETS}
    impossible = {"The printed turn", "Too fast for the gear", "Nearly empty"}
    assert {word for word, answer in told.items() if answer["limits"]} == impossible
    assert told["Straight on"]["share"] > 0.8 > 0.6 > told["Light and geared down"]["share"]
    turn = told["The printed turn"]
    assert max(turn["curves"]["ours"]) > 0
    assert "turning, the motors need up to 25." in turn["limits"][0]
    assert max(sum(turn["curves"][part][k] for part in ("copper", "rolling", "inertia")) for k in range(300)) > 1900
    assert "Even without any load" in told["Too fast for the gear"]["limits"][1]
    for gear in range(5, 61):
        assert motor.limits(motor.run(motor.read({**motor.USUAL, "speed": "2.5", "gear": str(gear)})))
    assert motor.limits(motor.run(motor.read({**motor.USUAL, "turn": "90", "turning": "1.5"}))) == []
    assert drive(speed="1.2")["limits"] == []
    back = told["Recovered"]["energy"]["recovered"]
    assert -250.0 < back < drive(recovery="100")["energy"]["recovered"] < 0
    assert drive(soc="1", mass="50", gear="5", speed="0.2", distance="40", load="1000")["limits"]


# -- addresses --------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.integers(2, 60), st.integers(2, 60))
@settings(max_examples=30)
def test_a_floor_survives_its_address(seed: int, width: int, height: int) -> None:
    free = np.random.default_rng(seed).random((height, width)) > 0.3
    assert (base.read_floor(base.floor_text(free)) == free).all()


@pytest.mark.parametrize("name", LESSONS)
def test_every_example_is_shown_and_differs(name: str) -> None:
    shown = lesson(name)
    assert len({tuple(sorted(preset.query.items())) for preset in shown.presets}) == len(shown.presets)
    for preset in shown.presets:
        assert shown.begin(preset.query) == (dict(preset.query), "")
        assert shown.answer(preset.query)
    assert shown.begin({}) == (dict(shown.presets[0].query), "")


@pytest.mark.parametrize(
    ("name", "key", "value", "sentence"),
    [
        ("search", "map", "70x20", "sides of 2 to 60 cells were expected, got 70; nearest: 60"),
        ("search", "map", "20x20r90s1", "density of 0 to 35 % was expected, got 90; nearest: 35"),
        ("search", "map", "20x20b", "50 bytes of obstacles were expected, got 0"),
        ("search", "map", "20x20b****", "a text such as 20x20"),
        ("search", "map", "<script>", "a text such as 20x20"),
        ("search", "start", "3", "column.row such as 0.0 was expected"),
        ("search", "start", "20.0", "outside the floor of 20 × 20 cells; nearest: 19.0"),
        ("search", "goal", "0.0", "it lies at the start"),
        ("search", "panels", "astar.manhatan.fifo", "did you mean 'manhattan'"),
        ("search", "panels", "eea.table.random", "unknown tie rule of eea"),
        ("search", "panels", "~".join(["dijkstra.zero.fifo"] * 5), "at most 4 were expected, got 5"),
        ("search", "step", "-1", "a whole number from 0"),
        ("tree", "vehicles", "0.0-3.3", "2 to 5 were expected, got 1"),
        ("tree", "vehicles", "0.0-3.3~0.0-2.2", "vehicles 0 and 1 have one start, 0.0"),
        ("tree", "vehicles", "0.0-3.3~1.0-9.9", "goal of vehicle 1: 9.9 is outside"),
        ("tree", "map", "40x40", "at most 20 × 20 cells"),
        ("tree", "on", "disjiont", "did you mean 'disjoint'"),
        ("tree", "w", "9", "unknown w"),
        ("tree", "node", "x", "a whole number from 0"),
        ("learned-time", "start", "E77", "unknown start 'E77'; did you mean 'E7'"),
        ("learned-time", "goal", "N102", "goal: it is the start, N102"),
        ("learned-time", "show", "stochastik", "did you mean 'stochastic'"),
        ("learned-time", "step", "x", "a whole number from 0"),
        ("learned-time", "scale", "lgo", "did you mean 'log'"),
        ("motor", "mass", "5", "mass: a number from 50 to 1000 kg was expected, got '5'"),
        ("motor", "gear", "1e3", "gear: a number from 5 to 60"),
        ("motor", "speed", "-1", "speed: a number from 0.2 to 3 m/s"),
        ("anytime", "ground", "bumsp56x42s2", "did you mean 'bumps'"),
        ("anytime", "ground", "bumps56x90s2", "sides of 20 to 60 cells were expected, got 90; nearest: 60"),
        ("anytime", "goal", "99.1", "outside the floor of 56 × 42 cells; nearest: 55.1"),
        ("anytime", "objective", "enrgy", "did you mean 'energy'"),
        ("anytime", "epsilon", "0.5", "first ε: a number from 1 to 10 was expected, got '0.5'"),
        ("anytime", "lower", "nan", "ε is lowered by: a number from 0.05 to 5"),
        ("anytime", "share", "101", "a whole number from 0 to 100"),
        ("anytime", "changes", "q4_1.1", "a text such as r4_25.18"),
        ("anytime", "changes", "r9_1.1", "a brush of 0 to 8 cells was expected, got 9"),
        ("anytime", "changes", "r2_70.1", "changes: 70.1 is outside"),
        ("anytime", "changes", "~".join(["d1"] * 13), "at most 12 were expected, got 13"),
    ],
)
def test_a_bad_address_is_a_sentence_and_the_first_example(name: str, key: str, value: str, sentence: str) -> None:
    shown = lesson(name)
    state, problem = shown.begin({key: value})
    assert sentence in problem
    assert state == dict(shown.presets[0].query)
    with pytest.raises(BadInput, match=re.escape(sentence)):
        shown.read({**shown.presets[0].query, key: value})


def test_an_obstacle_is_no_start() -> None:
    _, problem = lesson("search").begin({"map": base.drawn("..", "#."), "start": "0.0", "goal": "1.1"})
    assert "start: 0.0 is an obstacle" in problem


def test_large_floors_refuse_timed_nodes() -> None:
    with pytest.raises(BadInput, match="at most 1600 cells here; got 3600"):
        search.read({"map": "60x60", "start": "0.0", "goal": "1.1", "panels": "eea-time.paper.fifo"})


def test_the_server_answers_or_says_why(client: Any) -> None:
    told = client.post("/learn/search", json={"panels": "astar.manhattan.fifo"})
    assert told.status_code == 200
    assert told.json()["panels"][0]["solved"]
    for path, body in (
        ("/learn/search", {"map": "1x1"}),
        ("/learn/search", {"map": ["20x20"]}),
        ("/learn/search", {"map": "x" * 3000}),
        ("/learn/tree", {"vehicles": "0.0"}),
        ("/learn/nothing", {}),
    ):
        refused = client.post(path, json=body)
        assert refused.status_code == 400
        assert refused.json()["error"]
    assert client.post("/learn/search", json=[]).status_code == 400


# -- heuristics -------------------------------------------------------------------------------------------------------

MATRIX = [f"{mode}.{rule}.{tie}" for mode in heuristics.MODES for rule in heuristics.RULES for tie in heuristics.TIES]


@settings(max_examples=60)
@given(floors(), st.lists(st.sampled_from(MATRIX), min_size=1, max_size=8))
def test_a_matrix_plays_its_searches(question: tuple[np.ndarray, naive.Cell, naive.Cell], panels: list[str]) -> None:
    free, start, goal = question
    answer = heuristics.answer(query_of(free, start, goal, "~".join(panels)))
    width = free.shape[1]
    for text, told in zip(panels, answer["panels"], strict=True):
        mode = text.partition(".")[0]
        _, neighbours, cut = heuristics.MODES[mode]
        least = naive_dispatch.shortest(free.tolist(), neighbours, cut, start, goal)
        assert told["solved"] == np.isfinite(least)
        rows, entries, path = columns(told["rows"]), columns(told["entries"]), columns(told["path"])
        assert len(rows["cell"]) == told["expanded"]
        expanded = {row: i for i, row in enumerate(entries["row"]) if row >= 0}
        assert sorted(expanded) == list(range(told["expanded"]))
        for row, i in expanded.items():
            for name in ("cell", "heading", "g", "h"):
                assert entries[name][i] == rows[name][row]
            if rows["by"][row] >= 0:
                dx = abs(rows["cell"][row] % width - rows["cell"][rows["by"][row]] % width)
                dy = abs(rows["cell"][row] // width - rows["cell"][rows["by"][row]] // width)
                assert dx + dy == 1 or (dx == dy == 1 and neighbours == 8)
        if told["solved"]:
            assert path["cell"][0] == start[0] + width * start[1]
            assert path["cell"][-1] == goal[0] + width * goal[1]
            assert told["longer"] == pytest.approx(told["cost"] / 1000 / least - 1, abs=1e-3)
            assert told["longer"] == 0 or not told["admissible"]


def test_the_paper_s_lengths_are_an_example() -> None:
    answer = heuristics.answer(heuristics.PRESETS[0].query)
    costs = {told["panel"]: told["cost"] for told in answer["panels"]}
    assert [costs[f"four.{rule}.fifo"] for rule in heuristics.RULES] == [14_000] * 4
    assert [costs[f"eight.{rule}.fifo"] for rule in heuristics.RULES] == [11_071] * 4
    oversteps = next(p for p in heuristics.PRESETS if p.word == "Manhattan oversteps")
    longer = {told["panel"]: told["longer"] for told in heuristics.answer(oversteps.query)["panels"]}
    assert longer["four.manhattan.fifo"] == 0
    assert longer["eight.manhattan.fifo"] > 0.05 < longer["cut.manhattan.fifo"]


# -- ants -------------------------------------------------------------------------------------------------------------


def asked_of_ants(**changes: str) -> dict[str, str]:
    return {**ants.PRESETS[0].query, "map": "9x7r20s3", "goal": "8.6", "iterations": "5", "ants": "4", **changes}


def test_colonies_play_what_they_did_and_the_printed_inducement_is_none() -> None:
    answer = ants.answer(asked_of_ants(panels="literal~off~exponent~classic"))
    literal, off, exponent, classic = answer["panels"]
    assert (literal["same"], off["same"]) == (1, 0)
    assert {name: literal[name] for name in literal if name not in ("kind", "word", "same")} == {
        name: off[name] for name in off if name not in ("kind", "word", "same")
    }
    assert classic["exploited"] == 0 < exponent["exploited"]
    free = base.read_floor(answer["map"])
    shortest = naive.steps(free, (0, 0), (8, 6))
    assert answer["astar"]["steps"] == shortest
    for panel in answer["panels"]:
        best = columns(panel["columns"])["best"]
        level = np.frombuffer(base64.b64decode(panel["tau"]), np.uint8).reshape(5, -1)
        assert level.shape == (5, free.size)
        assert not level[:, ~free.ravel()].any()
        assert best[-1] >= shortest
        for at, cells in panel["ways"]:
            assert len(cells) - 1 == best[at - 1]
            assert (cells[0], cells[-1]) == (0, 62)
            assert free.ravel()[cells].all()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"panels": "literal~exponents"}, "did you mean 'exponent'?"),
        ({"panels": "~".join(["off"] * 5)}, "at most 4 were expected, got 5"),
        ({"rho": "2"}, "a number from 0 to 1 was expected, got 2; nearest: 1"),
        ({"xi": "much"}, "ξ: a number was expected, got 'much'"),
        ({"beta": "9", "xi": "0.1"}, "must be at most 70"),
        ({"map": "40x40"}, "at most 1200 cells"),
        ({"goal": "0.0"}, "it lies at the start"),
    ],
)
def test_ants_name_what_is_wrong(changes: dict[str, str], sentence: str) -> None:
    with pytest.raises(BadInput, match=re.escape(sentence)):
        ants.answer(asked_of_ants(**changes))


# -- break it ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", break_it.CASES)
def test_the_thesis_breaks_and_the_corrected_planner_does_not(case: str) -> None:
    answer = break_it.answer({"case": case})
    thesis, corrected = answer["sides"]["thesis"], answer["sides"]["corrected"]
    assert bool(thesis["breaches"]) == (case != "disconnected")
    assert bool(thesis["no_way"]) == (case == "disconnected")
    assert (corrected["breaches"], corrected["no_way"], corrected["done"]) == ([], [], True)
    walls, width = answer["walls"], answer["width"]
    for side in (thesis, corrected):
        for way in side["ways"]:
            assert len(way["cells"]) == len(way["soc"]) == side["ticks"] + 1
            assert all(walls[cell] == "0" for cell in way["cells"])
            for a, b in pairwise(way["cells"]):
                assert max(abs(a % width - b % width), abs(a // width - b // width)) <= 1
    if answer["goals"]:
        assert [way["cells"][-1] for way in corrected["ways"]] == answer["goals"]


def test_an_unknown_case_is_answered_with_the_nearest() -> None:
    with pytest.raises(BadInput, match="did you mean 'parked'"):
        break_it.answer({"case": "parkd"})


# -- anytime and repair -----------------------------------------------------------------------------------------------


def judged(phase: anytime.Phase, asked: anytime.Asked) -> float:
    """The least cost of a phase by Dijkstra's search, over costs computed from its ground and nothing else."""
    world = anytime.world_of(asked.ground, asked.start, asked.goal)
    ground = replace(world.terrain, height_m=phase.height, obstacle=phase.obstacle)
    cost = terrain_costs(replace(world, terrain=ground), anytime.robot(), asked.objective).cost
    goal = asked.goal[1] * world.width + asked.goal[0]
    return float(naive_terrain.optimum(world.cluster.end, cost, world.width, goal)[phase.start])


@st.composite
def grounds(draw: st.DrawFn) -> dict[str, str]:
    """A small ground of any class, and some changes of every kind."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = 24, 20
    cells = [f"{x}.{y}" for x, y in zip(rng.integers(0, width, 40), rng.integers(0, height, 40), strict=True)]
    kinds = st.sampled_from(["r4_{}", "l5e1500_{}-{}", "o1e2000_{}", "o2_{}-{}", "x3_{}", "d3"])
    take = iter(cells)
    drawn = draw(st.lists(kinds, max_size=3))
    changes = "~".join(kind.format(*(next(take) for _ in range(kind.count("{")))) for kind in drawn)
    return {
        "ground": f"{draw(st.sampled_from(sorted(anytime.RELIEF)))}{width}x{height}s{rng.integers(1, 99)}",
        "start": "3.4", "goal": "20.15", "changes": changes, "lower": "0.5",
        "objective": draw(st.sampled_from(["energy", "distance"])), "raised": draw(st.sampled_from(["", "1"])),
        "anew": draw(st.sampled_from(["", "", "1"])), "share": draw(st.sampled_from(["", "5", "100"])),
    }  # fmt: skip


@settings(max_examples=25)
@given(grounds())
def test_every_pass_keeps_its_bound_and_repair_ends_where_planning_anew_does(query: dict[str, str]) -> None:
    told = anytime.answer(query)
    asked, changes = anytime.read(query)
    cells = told["width"] * told["height"]
    for i, phase in enumerate(told["phases"]):
        kept = anytime.phase(asked, changes[:i], changes[i].after if i < len(changes) else 1000)
        least = judged(kept, asked)
        assert phase["least"] == (least if np.isfinite(least) else -1)
        for way in phase["passes"]:
            assert way["found"] is (phase["least"] >= 0)
            assert not way["broken"]
            if way["found"]:
                assert least <= way["cost"] <= way["epsilon"] * least
                assert way["epsilon"] > 1 or way["cost"] == least
                assert way["ratio"] == pytest.approx(way["cost"] / least if least else 1, abs=1e-5)
        frames = np.frombuffer(base64.b64decode(phase["frames"]), np.uint8).reshape(-1, cells)
        counts = columns(phase["columns"])
        assert len(frames) == len(counts["pass"]) == phase["passes"][-1]["frame"] + 1
        assert counts["pass"][0] == -1
        assert counts["expanded"][0] == 0
        for number, way in enumerate(phase["passes"]):
            assert counts["pass"][way["frame"]] == number
            assert counts["expanded"][way["frame"]] == way["expanded"]
            fresh = frames[way["frame"]] & anytime.FRESH
            # a state is expanded twice in a pass at most, and a cell has 16
            assert fresh.sum() <= way["expanded"] <= 2 * 16 * fresh.sum()


def test_frames_show_the_search_as_it_is_without_them() -> None:
    """Stopping for every frame changes nothing: passes, ways and expansions are those of one call per pass."""
    query = anytime.PRESETS[0].query
    asked, _ = anytime.read(query)
    world = anytime.world_of(asked.ground, asked.start, asked.goal)
    costs = terrain_costs(world, anytime.robot(), "energy")
    search = anytime.search_of(asked, asked.options, costs, anytime.start_state(asked))
    passes = anytime.answer(query)["phases"][0]["passes"]
    for way in passes:
        before = search.expanded
        route = search.work(2**62)
        assert (route.bound, route.cost, search.expanded - before) == (way["epsilon"], way["cost"], way["expanded"])
    assert search.optimal
    assert [way["epsilon"] for way in passes] == [2.5, 2.25, 2.0, 1.75, 1.5, 1.25, 1.0]
    # a first way soon; nearly all the work is the proof
    assert passes[0]["expanded"] < 0.02 * sum(way["expanded"] for way in passes)
    assert passes[-2]["cost"] == passes[-1]["cost"]


def test_what_the_examples_say_of_repair_is_so() -> None:
    told = {preset.word: anytime.answer(preset.query) for preset in anytime.PRESETS}
    for preset in anytime.PRESETS[1:]:
        # each opens where a pass has just published its way
        left = int(preset.query["step"])
        for phase in told[preset.word]["phases"]:
            ends = [way["frame"] for way in phase["passes"]]
            if left <= ends[-1]:
                break
            left -= ends[-1] + 1
        assert left in ends, preset.word

    near = told["Near the robot"]["phases"][1]
    assert 4 * near["repair"][1] < near["fresh"][1]
    assert near["verdict"].endswith("The rule (anew above 50 %) repairs, rightly.")
    far, ruled = told["Near the goal"]["phases"][1], told["The rule"]["phases"][1]
    assert far["share"] < 0.2
    assert far["repair"][1] > 2 * far["fresh"][1]
    assert far["verdict"].endswith("here the wrong choice.")
    assert not far["anew"]
    assert ruled["anew"]
    assert ruled["passes"][0]["epsilon"] == 2.5
    assert ruled["passes"][-1]["cost"] == far["passes"][-1]["cost"]
    second = told["While ε is 2"]["phases"][2]
    assert second["fresh"][0] < second["repair"][0]
    assert second["fresh"][1] > 2.5 * second["repair"][1]
    drives = told["The robot drives"]["phases"]
    assert [drives[i]["repair"][1] for i in (1, 3)] == [0, 0]
    assert 0 < drives[2]["repair"][1] < drives[2]["fresh"][1] / 5


def test_the_paper_s_traits_do_what_is_said_of_them() -> None:
    anew, sign = (anytime.answer(p.query) for p in anytime.PRESETS if p.word.startswith("Printed"))
    for phase in anew["phases"][1:]:
        assert phase["anew"]
        assert phase["passes"][-1]["expanded"] == phase["fresh"][1] > phase["repair"][1]
    wasted = sum(phase["fresh"][1] - phase["repair"][1] for phase in anew["phases"][1:])
    assert f"{wasted:,} expansions more than repair" in anew["traits"][0]
    last = sign["phases"][0]["passes"][-1]
    assert last["broken"]
    assert last["ratio"] > 1.3
    assert f"it costs {last['ratio']:.3f} times the least" in sign["traits"][0]
    right = anytime.answer({**anytime.PRESETS[-1].query, "printed": ""})
    assert right["phases"][0]["passes"][-1]["cost"] == sign["phases"][0]["least"]
    assert "no height term" in anytime.answer({**anytime.PRESETS[-1].query, "objective": "distance"})["traits"][0]


def test_a_shut_goal_is_told_and_opened_again() -> None:
    query = {**anytime.PRESETS[0].query, "changes": "o4_51.37~x5_51.37"}
    before, shut, opened = anytime.answer(query)["phases"]
    assert not shut["passes"][-1]["found"]
    assert shut["least"] == -1
    assert opened["passes"][-1]["cost"] == before["passes"][-1]["cost"] == opened["least"]
