"""Prioritized planning and time windows: searches among fixed ways against Dijkstra, plans by the judge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, reject, settings
from hypothesis import strategies as st

from engine.errors import FormatError, ScenarioError
from engine.planners.kernels import spacetime
from engine.planners.one_shot_prioritized import Desk, OneShotPrioritized, prioritized_solve
from engine.planners.oneshot import Limits, Problem, Solution
from engine.planners.problems import HEADINGS, problem_of
from engine.planners.single import Floor
from engine.planners.time_window import TimeWindow
from engine.scenario.movingai import Instance, corner_instance, random_instance
from engine.sim.judge import judge_plan
from engine.types import PlanStatus
from tests import naive_mapf2 as naive

MANY = settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
ENERGY = naive.Energy()


@st.composite
def crowds(draw: st.DrawFn) -> Instance:
    """A few vehicles on a small floor, each within reach of its goal."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = draw(st.integers(2, 5)), draw(st.integers(2, 5))
    density = draw(st.sampled_from([0.0, 0.2, 0.3]))
    try:
        return random_instance(rng, width, height, density, draw(st.integers(1, 3)))
    except FormatError:  # too many vehicles for the largest part of the floor
        reject()


def as_cells(instance: Instance, problem: Problem, states: np.ndarray) -> list[naive.Cell]:
    names = naive.cells(instance.free)
    return [names[int(p)] for p in problem.graph.state_place[states]]


def check(problem: Problem, found: Solution, objective: str) -> None:
    """Judge, cost and bound of a plan."""
    place = problem.graph.state_place
    ways = [place[states].tolist() for states in found.states]
    goals = problem.goals.tolist()
    assert judge_plan(problem.graph, ways, starts=place[problem.starts].tolist(), goals=goals) == []
    assert [int(states[0]) for states in found.states] == problem.starts.tolist()
    floor = Floor(problem.graph, problem.costs)
    mj = sum(floor.energy(s, int(c)) for s, c in zip(found.states, problem.cls, strict=True))
    assert found.cost == (mj if objective == "energy" else sum(len(way) - 1 for way in ways))
    assert found.lower_bound <= found.cost


@MANY
@given(crowds())
def test_searches_among_fixed_ways_are_optimal(instance: Instance) -> None:
    problem = problem_of(instance, heading="north")
    desk = Desk(problem)
    ways: list[list[naive.Cell]] = []
    everything: list[np.ndarray] = []
    for a in range(instance.agents):
        start = (instance.starts[a], 1, False)
        states, mj, _ = desk.cheapest(a, 2**40)
        assert (mj if mj >= 0 else None) == naive.among(instance.free, ways, start, instance.goals[a], ENERGY)
        tables, row = desk.steps()
        layers, out = spacetime.new_layers(256, problem.graph.n_places), np.zeros(4, np.int64)
        way = np.zeros(256, np.int32)
        status = spacetime.quickest(
            desk.floor.grounds.step, desk.taken, problem.blocked, layers, tables[row[a]], instance.place(start[0]),
            int(problem.goals[a]), 2**40, way, out,
        )  # fmt: skip
        ticks = naive.among(instance.free, ways, start, instance.goals[a], None)
        assert (int(out[0]) - 1 if status == spacetime.SOLVED else None) == ticks
        if mj < 0:
            return
        everything.append(states)
        ways.append(as_cells(instance, problem, states))
        desk.take(a, states, everything)


@MANY
@given(crowds())
def test_waits_on_a_route_are_the_cheapest(instance: Instance) -> None:
    assume(instance.agents >= 2)
    problem = problem_of(instance, heading="east")
    desk = Desk(problem)
    alone = [desk.cheapest(a, 2**40)[0] for a in range(instance.agents)]
    ways: list[list[naive.Cell]] = []
    for a in range(instance.agents):
        room, out = np.zeros(desk.ticks + len(alone[a]) + 4, np.int32), np.zeros(4, np.int64)
        mj = desk.mj[0]
        status = spacetime.waits_on(desk.floor.net, desk.taken, problem.blocked, alone[a], mj, ENERGY.wait, room, out)
        start, route = (instance.starts[a], 0, False), as_cells(instance, problem, alone[a])
        best = naive.among(instance.free, ways, start, instance.goals[a], ENERGY, route)
        assert (int(out[2]) if status == spacetime.SOLVED else None) == best
        if best is None:
            return
        timed = room[: out[0]].copy()
        assert desk.floor.energy(timed) == best
        ways.append(as_cells(instance, problem, timed))
        spacetime.take(desk.taken, a, problem.graph.state_place[timed], len(timed))


@MANY
@given(
    crowds(), st.sampled_from(["time", "energy"]), st.sampled_from(["given", "random", "longest"]), st.integers(1, 3)
)
def test_prioritized_plans_are_legal_and_cost_what_they_say(
    instance: Instance, objective: str, order: str, passes: int
) -> None:
    problem = problem_of(instance, masses_kg=(1000.0, 2000.0))
    found = OneShotPrioritized(objective, order, passes).solve(problem, Limits())
    assert found.status in (PlanStatus.SOLVED, PlanStatus.BUDGET_SPENT)
    if found.status is PlanStatus.SOLVED:
        check(problem, found, objective)
    again = OneShotPrioritized(objective, order, passes).solve(problem, Limits())
    assert [s.tolist() for s in again.states] == [s.tolist() for s in found.states]


@MANY
@given(crowds())
def test_time_windows_are_legal_and_cost_what_they_say(instance: Instance) -> None:
    problem = problem_of(instance, masses_kg=(2000.0, 2500.0))
    found = TimeWindow().solve(problem, Limits(), trace=True)
    assert found.status in (PlanStatus.SOLVED, PlanStatus.BUDGET_SPENT)
    if found.status is PlanStatus.SOLVED:
        check(problem, found, "energy")
        table = found.trace["vehicles"]
        assert int(table["mj"].sum()) == found.cost
        assert ((table["how"] == 0) == (table["mj"] == table["alone_mj"])).all() or (table["how"] == 2).any()


def test_a_later_vehicle_waits_for_an_earlier_one() -> None:
    free = np.ones((3, 3), np.bool_)
    free[0, [0, 2]] = free[2, [0, 2]] = False
    instance = Instance("crossing", free, ((0, 1), (1, 0)), ((2, 1), (1, 2)))
    problem = problem_of(instance)
    found = TimeWindow().solve(problem, Limits(), trace=True)
    assert found.trace["vehicles"]["how"].tolist() == [0, 1]
    assert found.cost == found.lower_bound + 30_000
    assert found.note == "1 vehicles wait, 0 were planned anew"
    check(problem, found, "energy")


def test_where_no_wait_helps_a_vehicle_is_planned_anew() -> None:
    free = np.ones((2, 5), np.bool_)
    instance = Instance("head-on", free, ((0, 0), (4, 0)), ((4, 0), (0, 0)))
    found = TimeWindow().solve(problem_of(instance), Limits(), trace=True)
    assert found.trace["vehicles"]["how"].tolist() == [0, 2]


def test_impossible_problems_are_answers() -> None:
    free = np.array([[1, 0, 1]], np.bool_)
    apart = problem_of(Instance("apart", free, ((0, 0),), ((2, 0),)))
    lane = problem_of(Instance("lane", np.ones((1, 3), np.bool_), ((0, 0), (2, 0)), ((2, 0), (0, 0))))
    for solver in (TimeWindow(), OneShotPrioritized(), OneShotPrioritized("energy")):
        assert solver.solve(apart, Limits()).status is PlanStatus.NO_PATH
        assert solver.solve(lane, Limits()).status is PlanStatus.BUDGET_SPENT
        assert solver.solve(lane, Limits(stop=lambda: True)).status is PlanStatus.BUDGET_SPENT


def test_more_passes_are_never_worse_and_many_vehicles_fit() -> None:
    problem = problem_of(corner_instance(np.random.default_rng(5), 20, 0.2), masses_kg=(2000.0, 2500.0))
    costs = [OneShotPrioritized("energy", "longest", passes).solve(problem, Limits()).cost for passes in (1, 4, 16)]
    assert costs == sorted(costs, reverse=True)
    assert prioritized_solve(problem, passes=4).cost == costs[1]
    many = problem_of(random_instance(np.random.default_rng(1), 32, 32, 0.2, 100), heading="east")
    found = OneShotPrioritized("time", "random").solve(many, Limits())
    assert found.status is PlanStatus.SOLVED
    check(many, found, "time")


def test_rooms_grow() -> None:
    problem = problem_of(random_instance(np.random.default_rng(2), 8, 8, 0.1, 6))
    usual = [OneShotPrioritized(o).solve(problem, Limits()).cost for o in ("time", "energy")]
    for objective, cost in zip(("time", "energy"), usual, strict=True):
        desk = Desk(problem)
        desk.ticks = 3
        desk.taken = spacetime.new_taken(3, problem.graph.n_places)
        desk.nodes = spacetime.new_nodes(64)
        states, got, _, failed = desk.go(objective, np.arange(6, dtype=np.int32), 2**40)
        assert (got, failed) == (cost, -1)
        assert len(states) == 6


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_heading_may_be_given(heading: str) -> None:
    instance = Instance("open", np.ones((3, 3), np.bool_), ((0, 0),), ((2, 2),))
    problem = problem_of(instance, heading=heading)
    assert problem.graph.state_heading[problem.starts].tolist() == [HEADINGS.index(heading)]
    assert problem.graph.state_moving[problem.starts].tolist() == [0]


def test_unknown_words_are_refused() -> None:
    instance = Instance("open", np.ones((3, 3), np.bool_), ((0, 0),), ((2, 2),))
    with pytest.raises(ScenarioError, match="heading"):
        problem_of(instance, heading="up")
    with pytest.raises(ScenarioError, match="masses"):
        problem_of(instance, masses_kg=())
    with pytest.raises(ScenarioError, match="unknown objective 'energi'; did you mean 'energy'"):
        OneShotPrioritized("energi")
    with pytest.raises(ScenarioError, match="passes"):
        OneShotPrioritized(passes=0)
