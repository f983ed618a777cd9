"""Ten ways in which a thesis's reservation table lets vehicles meet, each on a few cells: here nobody does.

The table itself, as described (`strict_thesis`), fails each of the built-in examples; corrected, it passes them.

Source: the Soochow thesis 2022 and its documented counterexamples. The judge, which shares no code with the planner,
decides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine import MemoryLog, judge, parse
from engine.build import build, resume, swap
from engine.errors import ScenarioError
from engine.scenario import load
from engine.scenario.checks import check
from engine.sim.judge import BreachKind
from engine.world import build_world, one_way

RULES = pytest.mark.parametrize("occupancy", ["hold", "mapf"])

RING = """
##########
I........O
#.######.#
C........C
##########
"""
CORRIDOR = """
#C###C#
I.....O
#######
"""
OPEN = """
#I###O#
C.....C
#.....#
C.....C
#######
"""


def scenario(rows: str, pairs: list[list[int]], vehicles: int = 2, **changes: Any):
    text = f'''
name = "few-cells"
title = "A few cells"
[time]
finish = "orders done and home"
[floor]
rows = """{rows}"""
[service]
pick_s = 2.0
drop_s = 2.0
[fleet]
count = {vehicles}
[battery]
capacity_wh = 500.0
[orders]
source = "listed"
pairs = {pairs}
'''
    return parse(text, "few cells", {key.replace("__", "."): value for key, value in changes.items()})


def finished(asked: Any, ticks: int = 2000) -> Any:
    """Run it to its end; the judge must find nothing and every order must be done."""
    log = MemoryLog()
    sim = build(asked, recorder=log)
    sim.advance(ticks)
    sim.flush()
    assert judge(log, asked, sim.world) == []
    assert sim.done
    assert sim.metrics()["orders_done"] == len(asked.orders.pairs)
    return sim, log


@RULES
def test_swap_of_neighbours(occupancy):
    finished(scenario(RING, [[1, 2], [2, 1], [1, 2], [2, 1]], floor__occupancy=occupancy))


@RULES
def test_crossing_diagonals(occupancy):
    changes = {"floor__occupancy": occupancy, "floor__connectivity": 8}
    sim, _ = finished(scenario(OPEN, [[1, 2], [2, 1], [1, 2], [2, 1]], vehicles=4, **changes))
    assert any("diagonal" in p.name for p in sim.graph.primitives)


@RULES
def test_a_parked_vehicle_is_seen(occupancy):
    # both want the same station: the second waits until the first has left, however long it stays
    changes = {"floor__occupancy": occupancy, "service__drop_s": 60.0}
    finished(scenario(RING, [[1, 2], [1, 2]], **changes))


@RULES
def test_an_idle_vehicle_that_is_never_planned_is_seen(occupancy):
    # the second vehicle stands in the shorter way and has nothing to do
    asked = scenario(RING, [[1, 2]], floor__occupancy=occupancy, fleet__start=[[0, 1], [4, 3]])
    log = MemoryLog()
    sim = build(asked, recorder=log)
    assert not sim.submit({"do": "pause", "vehicle": 7}).accepted
    assert sim.submit({"do": "fail", "vehicle": 1}).accepted
    sim.advance(500)
    sim.flush()
    assert judge(log, asked, sim.world) == []
    assert sim.metrics()["orders_done"] == 1
    assert sim.graph.state_place[sim.fleet.state[1]] == sim.world.place_at(4, 3)


@RULES
def test_waiting_at_the_start_is_no_shelter(occupancy):
    # vehicles that start in the aisle, in the way of the one planned first
    asked = scenario(RING, [[1, 2], [2, 1]], floor__occupancy=occupancy, fleet__start=[[2, 3], [4, 3]])
    finished(asked)


@RULES
def test_a_timed_conflict_does_not_disconnect(occupancy):
    # in the corridor there is no way around: the later one waits, it does not give up
    finished(scenario(CORRIDOR, [[1, 2], [2, 1]], floor__occupancy=occupancy))


@RULES
def test_a_dead_end_charger_is_left_before_it_is_entered(occupancy):
    asked = scenario(CORRIDOR, [[1, 2], [2, 1], [1, 2], [2, 1]], floor__occupancy=occupancy)
    sim, log = finished(asked)
    motions = log.table("motions")
    for charger in sim.world.chargers:
        assert (motions["to_place"] == charger).any()


def test_a_battery_of_31_percent_takes_no_order_that_it_cannot_finish():
    changes = {"energy__demand": "constant", "battery__model": "linear", "charger__rate_percent_per_s": 3.0}
    changes["energy__parameters"] = {"percent_per_s": 2.0}
    asked = scenario(RING, [[1, 2]], vehicles=1, battery__initial_soc=0.31, charging__sufficient=0.9, **changes)
    _, log = finished(asked)
    battery = log.table("battery")
    assert battery["charge_mc"].min() > 0
    # 31 % is above the level at which the thesis charges, and not enough for the way: it charged first
    assert (battery["charged_mj"] < 0).any()


def test_a_margin_keeps_followers_apart_at_unequal_speeds():
    changes = {"floor__margin_ticks": 2, "faults__delay_probability": 0.3, "faults__delay_ticks": [1, 6]}
    finished(scenario(RING, [[1, 2], [2, 1], [1, 2], [2, 1]], **changes))


def test_one_way_holds_for_edges_not_for_places():
    rows = """
#########
I.>>>>>.O
#.#####.#
#.<<<<<.#
#C#####C#
"""
    world = build_world(scenario(rows, [[1, 2]]))
    g = world.graph
    ways = {(int(g.state_place[a]), int(g.state_place[b])) for a, b in zip(g.edge_from, g.edge_to, strict=True)}
    one_way = {world.place_at(x, y) for y in (1, 3) for x in range(2, 7)}
    assert one_way
    assert not [(a, b) for a, b in ways if a in one_way and b in one_way and (b, a) in ways and a != b]
    finished(scenario(rows, [[1, 2], [2, 1], [1, 2]]))


def test_a_one_way_rule_that_cuts_the_floor_is_found():
    rows = """
#######
I.>>>.O
#C###C#
"""
    asked = scenario(rows, [[1, 2]])
    findings = check(asked, build_world(asked))
    assert any(f.level == "error" for f in findings)
    assert np.all([f.text for f in findings if f.level == "error"])


def test_an_order_that_no_battery_can_carry_is_found():
    changes = {"energy__demand": "constant", "battery__model": "linear", "energy__parameters": {"percent_per_s": 9.0}}
    asked = scenario(RING, [[1, 2]], **changes)
    findings = check(asked, build_world(asked))
    assert any(f.level == "error" and "battery" in f.check for f in findings)


def test_more_vehicles_than_places_to_rest_are_refused():
    with pytest.raises(ScenarioError, match="vehicles"):
        build(scenario(RING, [[1, 2]], vehicles=3))


# ---------------------------------------------------------------- the thesis's table, as described and corrected

CAUGHT = {
    "swap": (BreachKind.SWAP, 1, (0, 1)),
    "crossing": (BreachKind.CROSSING, 0, (0, 1)),
    "parked": (BreachKind.VERTEX, 2, (0, 1)),
    "idle": (BreachKind.VERTEX, 2, (0, 1)),
    "waiting": (BreachKind.VERTEX, 1, (0, 3)),
    "dead-end": (BreachKind.SWAP, 0, (0, 1)),
    "battery": (BreachKind.SOC, 33, (0,)),
}
"""What the judge finds first in each example: rule, tick of its begin, vehicles."""
BY_ANTS_AND_BY_ASTAR = pytest.mark.parametrize("ways", ["aco", "astar"])


def example(name: str, **parameters: Any) -> Any:
    changes = {f"planner.parameters.{key}": value for key, value in parameters.items()}
    return load(f"soochow2022-{name}", changes)


def recorded(asked: Any) -> tuple[Any, MemoryLog]:
    log = MemoryLog()
    sim = build(asked, recorder=log)
    sim.advance(int(asked.time.until_s))
    sim.flush()
    return sim, log


@BY_ANTS_AND_BY_ASTAR
@pytest.mark.parametrize("name", CAUGHT)
def test_the_judge_catches_the_thesis_table(name, ways):
    sim, log = recorded(example(name, ways=ways))
    breaches = judge(log, sim.scenario, sim.world)
    assert (breaches[0].kind, breaches[0].tick, breaches[0].vehicles) == CAUGHT[name]
    assert {b.kind for b in breaches} == {CAUGHT[name][0]}, "nothing else is wrong with what was executed"
    assert sim.done


@BY_ANTS_AND_BY_ASTAR
@pytest.mark.parametrize("name", [*CAUGHT, "disconnected"])
def test_corrected_it_passes_the_same_floors(name, ways):
    sim, log = recorded(example(name, ways=ways, strict_thesis=False))
    assert judge(log, sim.scenario, sim.world) == []
    assert sim.done
    assert not sim.open_loop


def test_a_conflict_for_a_moment_leaves_the_thesis_without_a_way():
    sim, log = recorded(example("disconnected"))
    assert not sim.done
    assert sim.graph.state_place[sim.fleet.state[1]] != sim.goals[1]
    assert "no way" in log.table("events")["kind"]
    asked = example("disconnected", strict_thesis=False)
    assert recorded(asked)[0].tick == 5, "one tick of waiting was enough"


def test_the_battery_runs_to_where_the_thesis_would_take_it():
    sim, log = recorded(example("battery"))
    charge = log.table("battery")["charge_mc"] / sim.parts.battery.capacity_mc
    assert charge.min() == pytest.approx(-0.24)


@pytest.mark.parametrize("name", ["swap", "dead-end"])
def test_the_one_way_rule_by_node_permits_what_the_rule_by_way_forbids(name):
    """Every node of the dead end's floor has a one-way straight; a vehicle can still be met on a way."""
    graph = build_world(example(name)).graph
    assert bool(one_way.breaks_node_rule(graph)) == (name == "swap")
    assert one_way.both_ways(graph)


@pytest.mark.parametrize("rule", ["lanes", "ways"])
def test_only_dead_ends_of_the_one_way_floor_are_driven_both_ways(rule):
    world = build_world(load("soochow2022", {"floor.one_way": rule}))
    ends = {*world.chargers.tolist(), *(s.place for s in world.stations)}
    between_aisles = [pair for pair in one_way.both_ways(world.graph) if not ends & set(pair)]
    assert bool(between_aisles) == (rule == "lanes"), "as drawn, crossings are open"
    assert len(one_way.both_ways(world.graph)) - len(between_aisles) == len(ends)
    assert one_way.strongly_connected(world.graph)
    if rule == "ways":
        assert {*one_way.breaks_node_rule(world.graph)} <= {*world.access.tolist()}, "before endpoints only"
        findings = check(load("soochow2022", {"floor.one_way": rule}), world)
        assert {f.level for f in findings if f.check in ("reachable", "one-way", "well-formed")} == {"ok"}


def test_a_one_way_floor_costs_more_than_one_step():
    """The thesis says one step at most, compared with eight directions."""
    steps = {}
    for name, changes in (("one-way", {"floor.one_way": "ways"}), ("eight", {})):
        world = build_world(load("soochow2022" if changes else "soochow2022-eight", changes))
        at = [s.place for s in world.stations]
        steps[name] = one_way.steps_between(world.graph, np.array(at, np.int32))
    more = (steps["one-way"] - steps["eight"])[~np.eye(len(at), dtype=bool)]
    assert (more >= 0).all()
    assert (more > 1).mean() > 0.5


def test_a_checkpoint_of_an_open_loop_goes_on_to_the_same_collision(tmp_path):
    asked = example("parked")
    whole = build(asked)
    whole.advance(60)
    sim = build(asked)
    sim.advance(1)
    sim.checkpoint(tmp_path / "one")
    again = resume(tmp_path / "one")
    again.advance(59)
    assert again.digest() == whole.digest()
    with pytest.raises(ScenarioError, match="executed as they are"):
        swap(sim, planner="soochow-table", overrides={"planner.parameters.strict_thesis": False})


@pytest.mark.parametrize(
    ("key", "value", "sentence"), [("ways", "ants", "'aco' or 'astar'"), ("ants", 0, "from 1 to 1000")]
)
def test_bad_parameters_of_the_table_are_named(key, value, sentence):
    with pytest.raises(ScenarioError, match=sentence):
        build(example("swap", **{key: value}))
