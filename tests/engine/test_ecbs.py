"""CBS in energy against a joint search, against itself with single techniques switched off, and at its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.planners.ecbs import ECBS
from engine.planners.oneshot import Limits
from engine.types import PlanStatus
from tests.naive_mapf import check_plan, joint_optimum, random_problem

PLAIN = ECBS(disjoint=False, cardinal=False, bypass=False, target=False, tries=0)
FEW = Limits(nodes=300)
VARIANTS = {
    "plain": PLAIN,
    "default": ECBS(),
    "disjoint": replace(PLAIN, disjoint=True),
    "cardinal": replace(PLAIN, cardinal=True),
    "bypass": replace(PLAIN, bypass=True),
    "target": replace(PLAIN, target=True),
    "disjoint and target": replace(PLAIN, disjoint=True, target=True),
    "first plan": replace(PLAIN, tries=4),
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
