"""Ant colonies: the mathematics of choice and pheromone, a slow twin, and A* as the reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine import MemoryLog, judge
from engine.build import build
from engine.errors import ScenarioError
from engine.planners.aco import Aco
from engine.planners.astar import AStar
from engine.planners.single import Floor
from engine.scenario import load
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance, single_instance
from engine.types import PlanStatus
from tests import naive_ants

SMALL = Aco(ants=8, iterations=6)
POCKET = ("#######", "#.....#", "#.###.#", "#...#.#", "#.###.#", "#.....#", "#######")
"""A dead end between start (1, 3) and goal (5, 3)."""


def drawn(rows: tuple[str, ...], start: tuple[int, int], goal: tuple[int, int]) -> tuple[Floor, int, int]:
    free = np.array([[letter == "." for letter in row] for row in reversed(rows)])
    instance = Instance("drawn", free, (start,), (goal,))
    graph = instance.graph()
    floor = Floor(graph, xu2025_costs(graph, (1000.0,), {}))
    return floor, instance.place(start), instance.place(goal)


def random_floor(number: int, size: int = 10, density: float = 0.25) -> tuple[Floor, int, int]:
    instance = single_instance(np.random.default_rng(number), size, density)
    graph = instance.graph()
    return (
        Floor(graph, xu2025_costs(graph, (1000.0,), {})),
        instance.place(instance.starts[0]),
        instance.place(instance.goals[0]),
    )


@pytest.mark.nojit_slice
@pytest.mark.parametrize(
    "rule", [{"rule": "classic"}, {"inducement": "off"}, {"inducement": "literal"}, {}, {"retreat": False}]
)
def test_the_compiled_colony_is_the_slow_one(rule: dict[str, Any]) -> None:
    aco = replace(SMALL, **rule)
    for number in range(3):
        floor, start, goal = random_floor(number, 8)
        found = aco.search(floor, start, goal, number, pheromone=True)
        way, tau, history = naive_ants.colony(floor, aco, start, goal, number)
        assert found.places.tolist() == way
        assert found.trace["best"].tolist() == history
        np.testing.assert_array_equal(found.trace["tau"][-1], tau.astype(np.float32))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.2, 0.35]))
def test_the_printed_inducement_cancels(number: int, density: float) -> None:
    """The factor is the same for every next place: no choice of any ant differs, nor any pheromone."""
    floor, start, goal = random_floor(number, 12, density)
    literal, off = (
        replace(SMALL, inducement=kind).search(floor, start, goal, number, pheromone=True)
        for kind in ("literal", "off")
    )
    assert literal.places.tolist() == off.places.tolist()
    assert (literal.choices, literal.exploited, literal.retreats) == (off.choices, off.exploited, off.retreats)
    for name, column in literal.trace.items():
        np.testing.assert_array_equal(column, off.trace[name])


def test_the_exponent_acts() -> None:
    floor, start, goal = random_floor(3, 20)
    off, exponent = (
        replace(Aco(), inducement=kind).search(floor, start, goal, 1, pheromone=True).trace["tau"]
        for kind in ("off", "exponent")
    )
    assert not np.array_equal(off, exponent)


def test_probabilities_sum_to_one_and_the_factor_is_not_in_them() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        tau, eta = rng.uniform(0.05, 8, 4), 1 / rng.integers(1, 60, 4)
        p = naive_ants.probabilities(tau, eta, 1, 5)
        assert p.sum() == pytest.approx(1)
        np.testing.assert_allclose(naive_ants.probabilities(tau, eta, 1, 5, factor=0.7 / 0.3 * 0.4), p, rtol=1e-12)


def test_ants_exploit_with_probability_one_minus_epsilon() -> None:
    floor, start, goal = random_floor(1, 20, 0.1)
    for explore in (0.1, 0.3, 0.5):
        found = replace(Aco(), explore=explore).search(floor, start, goal, 7)
        share, sd = found.exploited / found.choices, np.sqrt(explore * (1 - explore) / found.choices)
        assert abs(share - (1 - explore)) < 4 * sd
    assert Aco(rule="classic").search(floor, start, goal).exploited == 0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 0.9), st.sampled_from(["improved", "classic"]))
def test_pheromone_is_conserved(number: int, rho: float, rule: str) -> None:
    """Σ τ falls by ρ of itself and grows by ρ Q, however many ants lay it and however long their ways are."""
    floor, start, goal = random_floor(number)
    aco = replace(SMALL, rule=rule, rho=rho, low=1e-6, high=1e6, q=50.0)
    trace = aco.search(floor, start, goal, number, pheromone=True).trace
    before = float(trace["tau"][0].size)
    for tau in trace["tau"]:
        after = float(tau.astype(np.float64).sum())
        assert after == pytest.approx((1 - rho) * before + rho * aco.q, rel=1e-5)
        before = after


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["improved", "classic"]), st.booleans())
def test_a_way_is_one_and_no_shorter_than_that_of_astar(number: int, rule: str, retreat: bool) -> None:
    floor, start, goal = random_floor(number)
    found = replace(SMALL, rule=rule, retreat=retreat).search(floor, start, goal, number, pheromone=True)
    again = replace(SMALL, rule=rule, retreat=retreat).search(floor, start, goal, number)
    assert again.places.tolist() == found.places.tolist()
    tau = found.trace["tau"]
    assert tau.min() >= np.float32(SMALL.low)
    assert tau.max() <= SMALL.high
    assert (np.diff(found.trace["best"][found.trace["best"] > 0]) <= 0).all()
    if retreat:
        assert found.status is PlanStatus.SOLVED
        assert found.lost == 0
    if found.status is PlanStatus.SOLVED:
        path = found.places.tolist()
        assert (path[0], path[-1]) == (start, goal)
        assert len(set(path)) == len(path)
        assert all(b in floor.grounds.step[a] for a, b in pairwise(path))
        assert found.steps >= AStar().search(floor, start, goal).cost // 1000


def test_a_dead_end_loses_ants_that_do_not_go_back() -> None:
    floor, start, goal = drawn(POCKET, (1, 3), (5, 3))
    closed = floor.blocked.copy()
    stuck = replace(SMALL, retreat=False, ants=30).search(floor, start, goal, closed=closed)
    back = replace(SMALL, ants=30).search(floor, start, goal, closed=closed)
    assert stuck.lost > 0
    assert back.lost == 0
    assert back.status is PlanStatus.SOLVED
    closed[floor.grounds.step[goal][floor.grounds.step[goal] < len(closed)]] = 1
    shut = SMALL.search(floor, start, goal, closed=closed)
    assert (shut.status, shut.steps, shut.lost) == (PlanStatus.NO_PATH, -1, SMALL.ants * SMALL.iterations)


@pytest.mark.parametrize(
    ("lengths", "chosen"),
    [([5, 3, 9], [1]), ([4, 4, 4], [0]), ([2, 4], [0]), ([3, 3, 8, 9], [0, 1]), ([3, 3, 3, 9], [0]), ([], [])],
)  # fmt: skip
def test_better_than_the_median_or_else_one_of_the_best(lengths: list[int], chosen: list[int]) -> None:
    assert naive_ants.better_than_median(lengths) == chosen


@pytest.mark.parametrize(
    ("given_", "sentence"),
    [
        ({"rule": "improve"}, "did you mean 'improved'"),
        ({"inducement": "exponents"}, "did you mean 'exponent'"),
        ({"ants": 0}, "ants must be from 1 to 1000; got 0"),
        ({"xi": 0.5}, "xi must be more than 0 and less than 0.5"),
        ({"low": 9.0}, "low must be at most high"),
        ({"beta": 10.0, "xi": 0.1}, "must be at most 70"),
    ],
)
def test_bad_parameters_are_named(given_: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Aco(**given_)
    changes = {f"planner.parameters.{key}": value for key, value in given_.items()}
    with pytest.raises(ScenarioError, match=sentence):
        build(load("soochow2022", {"planner.name": "aco", **changes}))


def test_the_thesis_floor_runs_on_ants_without_a_breach() -> None:
    scenario = load("soochow2022", {"planner.name": "aco", "planner.parameters.iterations": 10})
    log = MemoryLog()
    sim = build(scenario, recorder=log)
    sim.advance(2000)
    sim.flush()
    assert sim.done
    assert sim.metrics()["orders_done"] == 10
    assert sim.memory["colonies"] > 20
    assert judge(log, scenario, sim.world) == []
