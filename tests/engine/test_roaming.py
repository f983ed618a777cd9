"""A robot on terrain: what it sees, how its plan is repaired; it is logged, judged and reproducible."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from engine import MemoryLog, judge
from engine.build import build, fitted, planners_for, replay, resume, swap
from engine.errors import ScenarioError
from engine.results.metrics import metrics
from engine.results.view import RunView
from engine.scenario import load, parse
from engine.scenario.checks import check
from engine.types import COMPONENTS, Activity, Component
from tests.naive_terrain import SMALL

PARTLY = SMALL.replace(
    "hills = 4", 'hills = 4\nobstacles = 5\nclear = [[1.7, 1.7], [10.1, 8.1]]\nsensor_m = 1.8\nprior = "none"'
)
TICKS = 2000


def made(text: str = PARTLY, **changes: Any) -> Any:
    return build(parse(text, "s.toml", changes or None), recorder=MemoryLog())


def place(sim: Any, x: float, y: float) -> int:
    """The cell at a point in metres."""
    return sim.world.place_at(int(x / 0.2), int(y / 0.2))


def run(sim: Any) -> Any:
    sim.advance(TICKS)
    sim.flush()
    return sim


def breaches(sim: Any) -> list[str]:
    return [b.text for b in judge(sim.log, sim.scenario, sim.world)]


def events(sim: Any) -> list[str]:
    return list(sim.log.table("events")["kind"])


@pytest.mark.parametrize("demand", ["skid-steer", "skid-steer-power"])
@pytest.mark.parametrize("objective", ["energy", "distance"])
def test_a_robot_reaches_its_goal_and_is_judged_clean(demand: str, objective: str) -> None:
    sim = run(made(**{"energy.demand": demand, "planner.objective": objective, "energy.parameters.recovery": 0.3}))
    assert sim.done
    assert sim.state // 16 == sim.goal_cell
    assert breaches(sim) == []
    rows = sim.log.table("battery")
    sums = [int(rows[f"{name}_mj"][-1]) for name in COMPONENTS]
    assert sums == sim.book.tolist()
    drained = sim.parts.battery.capacity_mc - int(rows["charge_mc"][-1])
    assert drained * 48_000 // 1000 == pytest.approx(sum(sums), abs=100)
    assert sums[Component.ROLLING] > 0 < sums[Component.STANDBY]


def test_it_sees_what_the_map_does_not_say_and_repairs_its_plan() -> None:
    sim = made()
    assert 0 < sim.believed.known.mean() < 0.2
    assert sim.believed.obstacle.sum() < sim.truth.obstacle.sum()
    run(sim)
    assert sim.done
    seen = sim.believed.known == 1
    assert (sim.believed.height[seen] == sim.truth.height[seen]).all()
    assert (sim.believed.obstacle[seen] == sim.truth.obstacle[seen]).all()
    plans = sim.log.table("plans")
    status = list(plans["status"])
    assert status[0] == "within 2.5 of the least"
    assert "solved" in status
    assert int(plans["tick"][-1]) > int(plans["tick"][0])


def test_every_published_pass_is_logged_with_what_it_left_to_do() -> None:
    sim = run(made())
    log = sim.log.table("searches")
    plans = sim.log.table("plans")
    assert log["tick"].tolist() == plans["tick"].tolist()
    assert log["bound"][0] == 2500
    assert (log["bound"][-1], log["open"][0] > 0) == (1000, True)
    assert 0 < log["expanded"].sum() <= sim.search.expanded
    cells, ends = log["open_places"]
    for i, n in enumerate(log["open"].tolist()):
        part = cells[ends[i] : ends[i + 1]].tolist()
        assert min(n, 1) <= len(part) == len(set(part)) <= n


def test_the_frontier_is_the_states_whose_two_costs_differ() -> None:
    sim = made()
    while sim.search.work(50) is None:
        pass
    assert [len(part) > 0 for part in sim.search.frontier()] == [True, True]
    rows = sim.search.node
    differ = np.flatnonzero(rows[:, 0] != rows[:, 1])
    assert np.union1d(*sim.search.frontier()).tolist() == differ.tolist()


def test_what_it_drives_at_last_is_the_cheapest_way_when_it_knows_the_ground() -> None:
    """On a known map nothing is to be repaired: the energy drawn is the cost of the last plan."""
    sim = run(made(SMALL.replace("hills = 4", 'hills = 4\nprior = "full"'), **{"planner.parameters.epsilon": 1.0}))
    best = sim.parts.search_of(sim.believed, sim.parts.start, sim.goal_cell).best()
    drawn = int(sim.book.sum() - sim.book[Component.STANDBY])
    assert drawn == best.cost
    assert len(sim.log.table("plans")["tick"]) == 1
    assert breaches(sim) == []


def test_the_same_scenario_gives_the_same_digest_however_it_is_advanced() -> None:
    one, two = run(made()), made()
    while not two.done:
        two.advance(7)
        two.snapshot(0.5)
        two.flush()
    assert one.digest() == two.digest()
    assert made(seed=2).digest() == made().digest()  # nothing is drawn here


def test_an_obstacle_that_is_dropped_is_driven_around() -> None:
    free = run(made(SMALL))
    sim = made(SMALL)
    sim.advance(60)
    wall = [place(sim, 6.1, y) for y in np.arange(2.1, 7.9, 0.2)]
    for where in wall:
        assert sim.submit({"do": "block", "place": where}).accepted
    run(sim)
    assert sim.done
    assert sim.tick > free.tick
    assert breaches(sim) == []
    assert len(sim.log.table("blocks")["tick"]) == len(wall)
    assert not sim.submit({"do": "block", "place": wall[0]}).accepted
    assert sim.submit({"do": "unblock", "place": wall[0]}).accepted


def test_a_shut_goal_is_waited_for_until_the_way_is_free() -> None:
    sim = made(SMALL.replace("hills = 4", 'hills = 0\nprior = "full"\nsensor_m = 20.0'))
    sim.advance(30)
    wall = [place(sim, 6.1, y) for y in np.arange(0.1, 10.0, 0.2)]
    for where in wall:
        sim.submit({"do": "block", "place": where})
    sim.advance(100)
    sim.flush()
    assert "no path" in list(sim.log.table("plans")["status"])
    assert sim.kind == Activity.WAIT
    assert not sim.done
    for where in wall[20:32]:
        assert sim.submit({"do": "unblock", "place": where}).accepted
    run(sim)
    assert sim.done
    assert breaches(sim) == []


def test_commands_are_answered_logged_and_have_their_effect() -> None:
    sim = made()
    sim.advance(20)
    said = [
        ({"do": "pause", "vehicle": 0}, True),
        ({"do": "pause", "vehicle": 0}, False),
        ({"do": "pause", "vehicle": 3}, False),
        ({"do": "dance"}, False),
        ({"do": "block", "place": 10**7}, False),
        ({"do": "block", "place": sim.state // 16}, False),
        ({"do": "unblock", "place": 0}, False),
    ]
    for command, accepted in said:
        answer = sim.submit(command)
        assert (answer.accepted, bool(answer.reason)) == (accepted, True)
    sim.advance(60)
    assert sim.kind == Activity.PAUSE
    sim.submit({"do": "continue", "vehicle": 0})
    sim.advance(5)
    sim.submit({"do": "fail", "vehicle": 0})
    sim.advance(60)
    assert sim.kind == Activity.FAULT
    sim.submit({"do": "repair", "vehicle": 0})
    goal = place(sim, 2.1, 8.1)
    assert sim.submit({"do": "send", "vehicle": 0, "place": goal}).accepted
    run(sim)
    assert sim.state // 16 == goal
    assert breaches(sim) == []
    logged = sim.log.table("commands")
    assert json.loads(logged["command"][0]) == said[0][0]
    assert len(logged["tick"]) == len(said) + 4


def test_a_run_with_commands_is_replayed_from_them() -> None:
    sim = made()
    for tick, command in ((15, {"do": "block", "place": place(sim, 7.1, 6.1)}), (60, {"do": "pause", "vehicle": 0})):
        sim.advance(tick - sim.tick)
        sim.submit(command)
    sim.advance(40)
    sim.submit({"do": "continue", "vehicle": 0})
    run(sim)
    table = sim.log.table("commands")
    columns = (table[c] for c in ("tick", "number", "command"))
    given = [(int(t), int(n), json.loads(text)) for t, n, text in zip(*columns, strict=True)]
    again = made()
    replay(again, given, sim.tick)
    assert again.digest() == sim.digest()


@pytest.mark.parametrize("at", [3, 41, 150])
def test_a_checkpoint_resumes_to_the_digest_of_the_whole_run(tmp_path, at: int) -> None:
    whole, first = made(), made()
    for sim in (whole, first):
        sim.advance(2)
        sim.submit({"do": "block", "place": place(sim, 6.1, 5.1)})
        sim.advance(at - 2)
    first.checkpoint(tmp_path / "c")
    second = resume(tmp_path / "c", recorder=MemoryLog())
    assert second.tick == at
    run(whole)
    run(second)
    assert second.digest() == whole.digest()


def test_a_run_is_forked_with_another_planner_or_objective() -> None:
    sim = made()
    sim.advance(40)
    swap(sim, overrides={"planner.objective": "distance", "planner.parameters.epsilon": 1.5})
    run(sim)
    assert sim.done
    assert "forked" in events(sim)
    assert breaches(sim) == []
    with pytest.raises(ScenarioError, match="a fork can't change 'floor'"):
        swap(sim, overrides={"floor.terrain.hills": 3})


def test_a_battery_that_is_too_small_strands_the_robot() -> None:
    sim = run(made(**{"battery.capacity_wh": 0.4}))
    assert sim.stranded
    assert not sim.done
    assert "stranded" in events(sim)
    assert sim.charge >= 0
    assert breaches(sim) == []


def test_a_budget_of_few_expansions_lets_the_robot_drive_before_its_plan_is_the_best() -> None:
    slow = run(made(**{"planner.parameters.per_tick": 40}))
    assert slow.done
    assert breaches(slow) == []
    status = list(slow.log.table("plans")["status"])
    assert len([s for s in status if s.startswith("within")]) >= 1


def test_the_view_and_the_metrics_of_a_run_on_terrain() -> None:
    sim = made()
    sim.advance(100)
    sim.flush()
    view = RunView(sim.log, sim.scenario, sim.world)
    shown, live = view.poses(sim.tick), sim.snapshot()
    assert shown.state.tolist() == live.state.tolist()
    assert np.hypot(shown.x_m - live.x_m, shown.y_m - live.y_m)[0] < 0.3  # a chord stands for the trajectory
    run(sim)
    found = metrics(sim.log, sim.tick_s)
    assert found["energy_j"] == pytest.approx(sim.book.sum() / 1000)
    floor = sim.world.floor_json()
    assert (floor["kind"], floor["width"], floor["height"]) == ("terrain", 60, 50)
    json.dumps(floor)


def changed(log: MemoryLog, name: str, column: str, row: int, value: int) -> Any:
    class Other:
        first_tick = log.first_tick

        def table(self, asked: str) -> Mapping[str, Any]:
            columns = dict(log.table(asked))
            if asked == name:
                columns[column] = np.array(columns[column])
                columns[column][row] = value
            return columns

    return Other()


@pytest.mark.parametrize(
    ("table", "column", "row", "value", "kind"),
    [
        ("motions", "energy_mj", 4, 17, "energy"),
        ("motions", "to_place", 4, 9, "edge"),
        ("motions", "t1", 4, 9000, "duration"),
        ("battery", "rolling_mj", 3, 5, "energy"),
        ("battery", "charge_mc", 3, 5, "battery"),
    ],
)
def test_the_judge_finds_what_is_wrong(table: str, column: str, row: int, value: int, kind: str) -> None:
    sim = run(made())
    found = judge(changed(sim.log, table, column, row, value), sim.scenario, sim.world)
    assert kind in {str(b.kind) for b in found}


def test_the_judge_finds_obstacles_and_slopes_in_the_way() -> None:
    sim = run(made(SMALL))
    for change, kind in (
        ({"floor.terrain.slope_limit_deg": 2.0}, "obstacle"),
        ({"floor.terrain.obstacles": 40, "floor.terrain.clear": [[1.7, 1.7], [10.1, 8.1]]}, "blocked"),
    ):
        other = parse(SMALL, "s.toml", change)
        from engine.world import build_world

        assert kind in {str(b.kind) for b in judge(sim.log, other, build_world(other))}


def test_only_what_fits_terrain_is_offered_for_it() -> None:
    scenario = parse(SMALL)
    assert planners_for(scenario) == ["adstar"]
    assert fitted(scenario).planner.objective == "energy"
    for change, words in (
        ({"planner.name": "ecbs"}, "plans on floors"),
        ({"planner.name": "adstr"}, "unknown"),
    ):
        with pytest.raises(ScenarioError, match=words):
            fitted(parse(SMALL, "s.toml", change))
    with pytest.raises(ScenarioError, match="needs terrain"):
        fitted(parse(load("soochow2022").to_toml(), "s.toml", {"planner.name": "adstar"}))
    with pytest.raises(ScenarioError, match="expected 'skid-steer'"):
        made(SMALL.replace('demand = "skid-steer"', ""))
    with pytest.raises(ScenarioError, match="is a robot on terrain"):
        build(parse(load("soochow2022").to_toml(), "s.toml", {"energy.demand": "skid-steer"}))
    with pytest.raises(ScenarioError, match="unknown parameter"):
        made(**{"energy.parameters.mue": 1.0})


def test_checks_say_whether_the_goal_can_be_reached() -> None:
    good = load("zhang2021")
    from engine.world import build_world

    found = check(good, build_world(good))
    assert [f.level for f in found] == ["ok", "ok"]
    for change, words in (
        ({"floor.terrain.slope_limit_deg": 0.5}, "cut|can't stand"),
        ({"floor.terrain.obstacles": 300, "floor.terrain.clear": [[1.7, 1.7], [10.1, 8.1]]}, "can't stand|cut"),
    ):
        bad = parse(SMALL.replace("hills = 4", "hills = 40"), "s.toml", change)
        levels = {f.level: f.text for f in check(bad, build_world(bad))}
        assert "error" in levels
        assert any(word in levels["error"] for word in words.split("|"))
