"""CBS in time against a joint search, against itself with single techniques switched off, and at its edges."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.planners import constraint_tree
from engine.planners.cbs import CBS
from engine.planners.constraint_tree import paths_of
from engine.planners.ecbs import ECBS
from engine.planners.oneshot import Limits
from engine.planners.problems import problem_of
from engine.scenario.movingai import random_instance
from engine.types import PlanStatus
from engine.world.grid import GridMotion
from tests.naive_mapf import check_plan, joint_optimum, random_problem
from tests.strategies import grid_graph

PLAIN = CBS(disjoint=False, cardinal=False, bypass=False, cover=0, target=False, tries=0)
FEW = Limits(nodes=300)
VARIANTS = {
    "plain": PLAIN,
    "default": CBS(),
    "disjoint": replace(PLAIN, disjoint=True),
    "cardinal": replace(PLAIN, cardinal=True),
    "bypass": replace(PLAIN, bypass=True),
    "target": replace(PLAIN, target=True),
    "disjoint and target": replace(PLAIN, disjoint=True, target=True),
    "CG": replace(PLAIN, cardinal=True, cover=1),
    "DG": replace(PLAIN, cover=2),
    "WDG": replace(PLAIN, cover=3),
    "first plan": replace(PLAIN, tries=3),
    "all but disjoint": CBS(disjoint=False),
    "all but target": CBS(target=False),
    "all but WDG": CBS(cover=0),
}


@pytest.mark.parametrize("n", [2, 3])
def test_equals_joint_search(n: int) -> None:
    rng = np.random.default_rng(n)
    plans = 0
    for _ in range(60):
        problem = random_problem(rng, n, int(rng.integers(2, 4)), int(rng.integers(2, 4)), 0.2)
        best = joint_optimum(problem, energy=False)
        found = CBS().solve(problem, FEW)
        if best is None:
            assert found.status in (PlanStatus.NO_PATH, PlanStatus.BUDGET_SPENT)
            assert found.states == ()
        else:
            plans += 1
            assert (found.status, found.cost) == (PlanStatus.SOLVED, best)
            check_plan(problem, found, energy=False)
    assert plans > 20


def test_every_technique_keeps_the_cost() -> None:
    rng = np.random.default_rng(7)
    compared = 0
    for _ in range(200):
        n = int(rng.integers(2, 7))
        walls = float(rng.choice([0.0, 0.2]))
        problem = random_problem(rng, n, int(rng.integers(3, 7)), int(rng.integers(3, 7)), walls)
        best = CBS().solve(problem, FEW)
        for name, solver in VARIANTS.items():
            found = solver.solve(problem, FEW)
            if best.status == PlanStatus.SOLVED == found.status:
                compared += 1
                assert found.cost == best.cost, name
                check_plan(problem, found, energy=False)
            elif best.status == PlanStatus.SOLVED:
                assert found.status == PlanStatus.BUDGET_SPENT, name
                assert found.lower_bound <= best.cost, name
    assert compared > 1_500


@pytest.mark.parametrize("w", [1.05, 1.2, 2.0])
def test_the_bound_holds(w: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(150):
        problem = random_problem(rng, int(rng.integers(2, 7)), 5, 5, 0.15)
        best, found = CBS().solve(problem, FEW), CBS(w=w).solve(problem, FEW)
        if best.status != PlanStatus.SOLVED:
            continue
        assert found.status in (PlanStatus.SOLVED, PlanStatus.BOUNDED)
        assert found.lower_bound <= best.cost <= found.cost <= w * found.lower_bound
        check_plan(problem, found, energy=False)


def test_headings_count_where_turning_takes_time() -> None:
    """With pivots the places alone don't decide how long a way takes."""
    rng = np.random.default_rng(3)
    for _ in range(25):
        problem = random_problem(rng, 2, 3, 3, 0.1)
        problem = replace(problem, graph=grid_graph(3, 3, motion=GridMotion(turning="pivot")))
        starts = rng.permutation(9)[:2]
        problem = replace(
            problem,
            starts=np.array([problem.graph.state(int(p), 1) for p in starts], np.int32),
            goals=rng.permutation(9)[:2].astype(np.int32),
            blocked=np.zeros(9, np.uint8),
        )
        found = CBS().solve(problem, FEW)
        assert found.cost == joint_optimum(problem, energy=False)
        check_plan(problem, found, energy=False)


def test_blocked_places_are_walls() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        problem = random_problem(rng, 3, 5, 5, 0.0)
        blocked = np.zeros(problem.graph.n_places, np.uint8)
        blocked[rng.permutation(25)[:5]] = 1
        blocked[problem.graph.state_place[problem.starts]] = blocked[problem.goals] = 0
        problem = replace(problem, blocked=blocked)
        found = CBS().solve(problem, FEW)
        if found.states:
            check_plan(problem, found, energy=False)


def test_no_way_for_one_vehicle() -> None:
    problem = random_problem(np.random.default_rng(0), 2, 3, 3, 0.0)
    blocked = np.zeros(9, np.uint8)
    blocked[problem.goals[0]] = 1
    if problem.graph.state_place[problem.starts[1]] == problem.goals[0]:
        blocked[:] = 0
    found = CBS().solve(replace(problem, blocked=blocked), FEW)
    assert found.status == PlanStatus.NO_PATH
    assert "vehicle 0" in found.note


def test_two_in_an_aisle_cannot_pass() -> None:
    problem = random_problem(np.random.default_rng(0), 2, 4, 1, 0.0)
    graph = problem.graph
    problem = replace(
        problem,
        starts=np.array([graph.state(0, 0), graph.state(3, 0)], np.int32),
        goals=np.array([3, 0], np.int32),
    )
    found = CBS().solve(problem, Limits(nodes=200))
    assert found.status in (PlanStatus.BUDGET_SPENT, PlanStatus.NO_PATH)
    assert found.states == ()
    if found.status == PlanStatus.BUDGET_SPENT:
        assert found.lower_bound >= 6


def test_one_goal_for_two_is_refused() -> None:
    problem = random_problem(np.random.default_rng(0), 2, 3, 3, 0.0)
    found = CBS().solve(replace(problem, goals=np.array([4, 4], np.int32)), FEW)
    assert found.status == PlanStatus.INCONSISTENT


def test_a_stopped_search_says_how_far_it_got() -> None:
    rng = np.random.default_rng(23)
    seen = 0
    for _ in range(200):
        problem = random_problem(rng, 6, 4, 4, 0.0)
        best = CBS().solve(problem, FEW)
        found = replace(PLAIN, tries=4).solve(problem, Limits(nodes=1))
        if found.status != PlanStatus.BUDGET_SPENT or best.status != PlanStatus.SOLVED:
            continue
        seen += 1
        assert found.lower_bound <= best.cost
        if found.states:
            assert found.cost >= best.cost
            check_plan(problem, found, energy=False)
    assert seen > 5


@pytest.mark.parametrize("planner", [CBS(), ECBS(), CBS(w=1.1, cover=0), ECBS(pairs=False)], ids=repr)
def test_the_clock_is_asked_often(planner: CBS | ECBS, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two looks at the clock no more work is done than a chunk, one node and one pair's bound."""
    tree = constraint_tree.high.run
    work = [0]
    since = [0]

    def watched(*arguments: Any) -> int:
        num = arguments[3].num
        before = int(num[constraint_tree.high.WORK])
        ended = int(tree(*arguments))
        work[0] += int(num[constraint_tree.high.WORK]) - before
        return ended

    def clock() -> bool:
        assert work[0] - since[0] <= 1.5 * constraint_tree.CHUNK_WORK
        since[0] = work[0]
        return work[0] > 5 * constraint_tree.CHUNK_WORK

    monkeypatch.setattr(constraint_tree.high, "run", watched)
    problem = problem_of(random_instance(np.random.default_rng(5), 16, 16, 0.2, 26))
    found = planner.solve(problem, Limits(stop=clock))
    clock()
    assert work[0] > 2 * constraint_tree.CHUNK_WORK or found.status in (PlanStatus.SOLVED, PlanStatus.BOUNDED)


def test_an_order_of_vehicles_is_gone_on_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """However small the chunks of work, the answer and the work are the same."""
    rng = np.random.default_rng(11)
    for _ in range(6):
        problem = problem_of(random_instance(rng, 8, 8, 0.1, 9))
        for planner in (CBS(tries=6), ECBS()):
            found = planner.solve(problem, Limits(nodes=200))
            with monkeypatch.context() as patched:
                patched.setattr(constraint_tree, "CHUNK_WORK", 1)
                pieces = planner.solve(problem, Limits(nodes=200))
            assert (pieces.cost, pieces.lower_bound, pieces.expanded_high, pieces.expanded_low) == (
                found.cost, found.lower_bound, found.expanded_high, found.expanded_low,
            )  # fmt: skip
            assert [way.tolist() for way in pieces.states] == [way.tolist() for way in found.states]


def test_the_tree_is_recorded_when_asked() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        problem = random_problem(rng, 5, 4, 4, 0.0)
        found = replace(PLAIN, disjoint=True).solve(problem, FEW, trace=True)
        assert CBS().solve(problem, FEW).trace == {}
        tree = found.trace["tree"]
        assert tree["parent"][0] == -1
        assert (tree["parent"][1:] < tree["node"][1:]).all()
        assert (tree["status"] == 1).sum() >= min(found.expanded_high, 1)
        # costs never fall on the way down
        assert (tree["cost"][1:] >= tree["cost"][tree["parent"][1:]]).all()
        if len(tree["node"]) > 10:
            assert tree["positive"].any()
            return
    pytest.fail("no tree grew")


def test_the_trace_holds_every_nodes_plan_and_conflict() -> None:
    rng = np.random.default_rng(2)
    answers = 0
    for solver in (CBS(tries=0), replace(PLAIN, bypass=True), ECBS(tries=0)):
        for _ in range(10):
            problem = random_problem(rng, 5, 4, 4, 0.0)
            found = solver.solve(problem, Limits(nodes=60), trace=True)
            tree = found.trace["tree"]
            for node in tree["node"].tolist():
                paths = paths_of(found.trace, node)
                assert [int(path[0]) for path in paths] == problem.graph.state_place[problem.starts].tolist()
                tick = tree["conflict_tick"][node]
                assert (tree["turn"][node] >= 0) == (tree["status"][node] == 1) or tree["status"][node] == 3
                if tick < 0:
                    continue
                a, b = (paths[tree[name][node]] for name in ("a", "b"))
                at, at2 = tree["at"][node], tree["at2"][node]
                where = [(int(p[min(tick, len(p) - 1)]), int(p[min(tick + 1, len(p) - 1)])) for p in (a, b)]
                assert where == [(at, at2), (at2, at)] if at2 >= 0 else where[0][0] == where[1][0] == at
            answer = tree["node"][tree["status"] == 3]
            if len(answer):
                answers += 1
                ways = [problem.graph.state_place[states].tolist() for states in found.states]
                assert [path.tolist() for path in paths_of(found.trace, int(answer[0]))] == ways
    assert answers > 10


@pytest.mark.nojit_slice
@pytest.mark.filterwarnings("ignore:overflow encountered")  # hashing wraps, in plain Python with a warning
def test_plain_python_finds_the_same() -> None:
    rng = np.random.default_rng(37)
    solved = 0
    for _ in range(10):
        problem = random_problem(rng, int(rng.integers(2, 4)), 3, 3, 0.1)
        for solver, energy in ((CBS(), False), (replace(PLAIN, cover=2), False), (ECBS(), True)):
            found = solver.solve(problem, Limits(nodes=8))
            if found.status == PlanStatus.SOLVED:
                solved += 1
                assert found.cost == joint_optimum(problem, energy)
                check_plan(problem, found, energy)
    assert solved > 20
