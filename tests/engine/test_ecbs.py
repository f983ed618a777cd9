"""CBS in energy against a joint search, against itself with single techniques switched off, and at its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.planners.constraint_tree import energy_roads
from engine.planners.ecbs import ECBS
from engine.planners.kernels import cbs_low, cbs_pair
from engine.planners.oneshot import Limits
from engine.planners.problems import problem_of
from engine.planners.time_window import TimeWindow
from engine.scenario.movingai import Instance, corner_instance, random_instance
from engine.types import PlanStatus
from tests.naive_mapf import check_plan, joint_optimum, random_problem

PLAIN = ECBS(disjoint=False, cardinal=False, bypass=False, target=False, pairs=False, tries=0)
FEW = Limits(nodes=300)
# 20 × 20 cells row by row, five hexadecimal digits each, 1 where blocked; on each, an earlier version called a plan
# optimal although time windows found a cheaper one: after a landmark, a motion may have cost more than its tick
HARD_MAPS = (
    "240080000049a0000811000a04004000094800201000000002000890000000005000000060000101b0004003100100000008",
    "2f9ee3961001087009ce36f000400606204c0310440204e24140041453c841a0020544a20150984929aa048048445aa32462",
    "1046215888052064801128105a26e011a8968042d1043800244ee6020c8cc932f40d89271202439108402262130c41003068",
    "1a000130283e67164a42009388468104a08154886a506a3584a0a0301400600064b9b0820042c29d810010a64e7c6d004c00",
    "0c67c00080004a012401129440102423408244322a000100010c0823300008b000600044810418004200238105304a220100",
)
VARIANTS = {
    "plain": PLAIN,
    "default": ECBS(),
    "disjoint": replace(PLAIN, disjoint=True),
    "cardinal": replace(PLAIN, cardinal=True),
    "bypass": replace(PLAIN, bypass=True),
    "target": replace(PLAIN, target=True),
    "disjoint and target": replace(PLAIN, disjoint=True, target=True),
    "first plan": replace(PLAIN, tries=4, repairs=0),
    "first plan, repaired": replace(PLAIN, tries=1, repairs=6),
    "pairs": replace(PLAIN, pairs=True),
    "all but pairs": ECBS(pairs=False),
    "other weights": ECBS(weights=(0.0, 1.0, 0.0)),
}


@pytest.mark.parametrize(("n", "side", "times"), [(2, 3, 50), (3, 2, 20)])
def test_equals_joint_search(n: int, side: int, times: int) -> None:
    rng = np.random.default_rng(n)
    plans = 0
    for _ in range(times):
        problem = random_problem(rng, n, side, 3, 0.1)
        best = joint_optimum(problem, energy=True)
        found = ECBS().solve(problem, FEW)
        if best is None:
            assert found.status in (PlanStatus.NO_PATH, PlanStatus.BUDGET_SPENT)
            assert found.states == ()
        elif found.status == PlanStatus.SOLVED:
            plans += 1
            assert found.cost == best
            check_plan(problem, found, energy=True)
        else:
            assert found.status == PlanStatus.BUDGET_SPENT
            assert found.lower_bound <= best
    assert plans > times // 3


@pytest.mark.parametrize("standby_w", [30.0, 300.0])
def test_a_pair_costs_what_a_joint_search_says(standby_w: float) -> None:
    """The bound of two vehicles alone is their optimum, and never above it when the work is spent before."""
    rng = np.random.default_rng(int(standby_w))
    work, more = cbs_pair.new_pair_work(1 << 12, 16), 0
    for _ in range(40):
        problem = random_problem(rng, 2, int(rng.integers(2, 5)), 3, 0.1, standby_w)
        roads = energy_roads(problem)
        h = np.empty((2, len(roads.place)), np.int64)
        keys = np.empty(len(roads.to) + len(roads.place) + 16, np.int64)
        for k in range(2):
            cls, goal = int(problem.cls[k]), int(problem.goals[k])
            cbs_low.fill_cost_to_goal(roads, cls, goal, problem.blocked, h[k], keys, np.empty(len(keys), np.int32))
        alone = h[[0, 1], problem.starts]
        if (alone >= cbs_low.FAR).any():
            continue
        best = joint_optimum(problem, energy=True)
        for limit in (100_000, 5):
            out = np.zeros(2, np.int64)
            ended = cbs_pair.pair_cost(roads, work, h, problem.cls, problem.starts, problem.goals, 0, 1, limit, out)
            if ended == cbs_low.SPENT:
                assert limit == 5
                assert best is None or alone.sum() <= out[0] <= best
            else:
                assert (int(out[0]) if ended == cbs_low.FOUND else None) == best
        more += best is not None and best > alone.sum()
    assert more > 2


@pytest.mark.parametrize("standby_w", [30.0, 300.0])
def test_every_technique_keeps_the_cost(standby_w: float) -> None:
    rng = np.random.default_rng(7)
    compared = 0
    for _ in range(100):
        n = int(rng.integers(2, 5))
        problem = random_problem(rng, n, int(rng.integers(3, 7)), int(rng.integers(3, 7)), 0.1, standby_w)
        best = ECBS().solve(problem, FEW)
        for name, solver in VARIANTS.items():
            found = solver.solve(problem, FEW)
            if best.status == PlanStatus.SOLVED == found.status:
                compared += 1
                assert found.cost == best.cost, name
                check_plan(problem, found, energy=True)
            elif best.status == PlanStatus.SOLVED:
                assert found.status == PlanStatus.BUDGET_SPENT, name
                assert found.lower_bound <= best.cost, name
    assert compared > 400


@pytest.mark.parametrize("w", [1.02, 1.2])
def test_the_bound_holds(w: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(60):
        problem = random_problem(rng, int(rng.integers(2, 6)), 5, 5, 0.1)
        best, found = ECBS().solve(problem, FEW), ECBS(w=w).solve(problem, FEW)
        if best.status != PlanStatus.SOLVED:
            continue
        assert found.status in (PlanStatus.SOLVED, PlanStatus.BOUNDED)
        assert found.lower_bound <= best.cost <= found.cost <= w * found.lower_bound
        check_plan(problem, found, energy=True)


def test_priority_branch_is_legal_and_never_better() -> None:
    """Reading B of eq. 14: one child a node. It may miss plans, and its cost is no lower."""
    rng = np.random.default_rng(13)
    plans = 0
    for _ in range(80):
        problem = random_problem(rng, 3, 5, 5, 0.1)
        best = ECBS().solve(problem, FEW)
        found = ECBS(priority_branch=True).solve(problem, FEW, trace=True)
        parents = found.trace["tree"]["parent"] if found.trace else np.zeros(0, np.int32)
        assert len(np.unique(parents)) == len(parents)
        if found.states:
            plans += 1
            check_plan(problem, found, energy=True)
            if best.status == PlanStatus.SOLVED:
                assert found.lower_bound <= best.cost <= found.cost
    assert plans > 60


def test_the_lower_priority_is_constrained_first() -> None:
    rng = np.random.default_rng(17)
    seen = 0
    for _ in range(60):
        tree = replace(PLAIN, target=False).solve(random_problem(rng, 4, 5, 5, 0.1), FEW, trace=True).trace
        if not tree:
            continue
        chosen = tree["tree"]["status"] == 1
        seen += int(chosen.sum())
        assert (tree["tree"]["dp_low"][chosen] <= tree["tree"]["dp_high"][chosen]).all()
        assert (tree["tree"]["energy"] == tree["tree"]["cost"]).all()
    assert seen > 20


def corners(free: np.ndarray) -> Instance:
    last = len(free) - 1
    return Instance(
        "corners", free, ((0, last), (last, 0), (0, 0), (last, last)), ((last, 0), (0, last), (last, last), (0, 0))
    )


@pytest.mark.parametrize("bits", HARD_MAPS)
def test_no_plan_called_optimal_can_be_beaten(bits: str) -> None:
    rows = [f"{int(bits[i : i + 5], 16):020b}" for i in range(0, 100, 5)]
    free = np.array([[letter == "0" for letter in row] for row in rows[::-1]])
    problem = problem_of(corners(free), masses_kg=(2000.0, 2200.0, 2350.0, 2500.0))
    found, windows = ECBS().solve(problem, Limits()), TimeWindow().solve(problem, Limits())
    assert found.status == PlanStatus.SOLVED
    assert found.lower_bound == found.cost <= windows.cost
    check_plan(problem, found, energy=True)


def test_many_vehicles_are_bounded_by_groups_of_pairs() -> None:
    """Bounds of many vehicles: no bound of the default may lie above what the tree without pairs proves."""
    rng = np.random.default_rng(29)
    for _ in range(6):
        problem = problem_of(random_instance(rng, 12, 12, 0.1, 14))
        found, plain = ECBS().solve(problem, Limits(nodes=100)), ECBS(pairs=False).solve(problem, Limits(nodes=100))
        for one, other in ((found, plain), (plain, found)):
            if other.states:
                assert one.lower_bound <= other.cost
        if found.states:
            check_plan(problem, found, energy=True)


@pytest.mark.slow
@pytest.mark.parametrize("density", [0.1, 0.2, 0.3])
def test_never_worse_than_time_windows(density: float) -> None:
    rng = np.random.default_rng(31)
    for number in range(40):
        instance = corner_instance(rng, 20, density) if number < 20 else random_instance(rng, 20, 20, density, 12)
        problem = problem_of(instance, masses_kg=(2000.0, 2200.0, 2350.0, 2500.0))
        found, windows = ECBS().solve(problem, Limits(nodes=2_000)), TimeWindow().solve(problem, Limits())
        if windows.states:
            assert found.states
            assert found.cost <= windows.cost
            check_plan(problem, found, energy=True)
