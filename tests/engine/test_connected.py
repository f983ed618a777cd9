"""A* by connectivity and heuristic against Dijkstra written plainly."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import BadInput
from engine.planners.connected import ADMISSIBLE, RULES, UM_PER_CELL, ground_of, search
from engine.planners.kernels import single
from engine.types import PlanStatus
from tests import naive_dispatch as naive

MODES = ((4, False), (8, False), (8, True))


@st.composite
def floors(draw: st.DrawFn) -> tuple[np.ndarray, tuple[int, int], tuple[int, int]]:
    """A floor and two free cells, which may not reach each other."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = draw(st.integers(1, 12)), draw(st.integers(2, 12))
    free = rng.random((height, width)) >= draw(st.sampled_from([0.0, 0.2, 0.4]))
    a, b = (int(n) for n in rng.choice(width * height, 2, replace=False))
    free.ravel()[[a, b]] = True
    return free, (a % width, a // width), (b % width, b // width)


@settings(max_examples=60, deadline=None)
@given(floors(), st.sampled_from(MODES), st.sampled_from(["fifo", "lifo", "larger-g", "random"]))
def test_admissible_heuristics_find_what_dijkstra_finds(
    question: tuple[np.ndarray, tuple[int, int], tuple[int, int]], mode: tuple[int, bool], tie: str
) -> None:
    free, start, goal = question
    ground = ground_of(free, *mode)
    least = naive.shortest(free.tolist(), *mode, start, goal)
    expanded = {}
    for heuristic in RULES:
        found = search(ground, ground.place(*start), ground.place(*goal), heuristic, tie, trace=True)
        assert (found.status is PlanStatus.SOLVED) is math.isfinite(least)
        if found.status is not PlanStatus.SOLVED:
            continue
        way = ground.cells(found.places)
        assert (way[0], way[-1]) == (start, goal)
        driven = sum(math.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(way))
        assert found.length == pytest.approx(driven, abs=1e-4)
        assert driven >= least - 1e-6
        if heuristic in ADMISSIBLE[mode[0]]:
            assert driven == pytest.approx(least, abs=1e-6)
            expanded[heuristic] = found.expanded
            # no expansion's estimate exceeds what the goal costs in the end
            assert found.trace["f"].max(initial=0) <= found.length_um
    if expanded and tie == "larger-g":
        # with equal f by larger g, a larger consistent heuristic expands no more, but for ties at the end
        assert expanded["octile"] <= expanded["zero"]


@settings(max_examples=40, deadline=None)
@given(st.integers(-60, 60), st.integers(-60, 60))
def test_which_heuristics_are_admissible_on_an_open_floor(dx: int, dy: int) -> None:
    diagonal = min(abs(dx), abs(dy))
    exact = {4: float(abs(dx) + abs(dy)), 8: 2**0.5 * diagonal + abs(abs(dx) - abs(dy))}
    apart = getattr(single.length_apart, "py_func", single.length_apart)
    for neighbours, least in exact.items():
        for name in RULES:
            rule = {"manhattan": 0, "chebyshev": 1, "euclidean": 2, "octile": 3, "zero": 4}[name]
            h = apart(rule, 100 + dx | (100 + dy) << 16, 100, 100, UM_PER_CELL, 1_414_214) / UM_PER_CELL
            if name in ADMISSIBLE[neighbours]:
                assert h <= least + 1e-4
            elif diagonal:
                assert h > least


def test_manhattan_with_diagonals_may_miss_the_shortest_way() -> None:
    rng = np.random.default_rng(3)
    longer = 0
    for _ in range(40):
        free = rng.random((12, 12)) >= 0.25
        free[0, 0] = free[11, 11] = True
        ground = ground_of(free, 8)
        ends = ground.place(0, 0), ground.place(11, 11)
        least, found = (search(ground, *ends, name).length_um for name in ("octile", "manhattan"))
        longer += found > least
    assert longer > 3


def test_nine_columns_and_five_rows() -> None:
    free = np.ones((10, 10), np.bool_)
    for (neighbours, cut), (length, nodes) in zip(
        MODES, ((14, 15), (4 + 5 * 2**0.5, 10), (4 + 5 * 2**0.5, 10)), strict=True
    ):
        ground = ground_of(free, neighbours, cut)
        found = search(ground, ground.place(0, 2), ground.place(9, 7))
        assert found.length == pytest.approx(length, abs=1e-5)
        assert len(found.places) == nodes


def test_corners_are_cut_only_when_asked() -> None:
    free = np.array([[1, 0], [1, 1]], np.bool_)  # row 0 at the bottom: (1, 0) is an obstacle
    free_ends = ((0, 0), (1, 1))
    for cut, length in ((False, 2.0), (True, 2**0.5)):
        ground = ground_of(free, 8, cut)
        assert search(ground, *(ground.place(*cell) for cell in free_ends)).length == pytest.approx(length, abs=1e-5)


def test_bad_questions_get_a_sentence() -> None:
    free = np.ones((3, 3), np.bool_)
    with pytest.raises(BadInput, match="4 or 8 neighbours were expected, got 6"):
        ground_of(free, 6)
    ground = ground_of(free)
    with pytest.raises(BadInput, match="unknown heuristic 'octil'; did you mean 'octile'"):
        search(ground, 0, 1, "octil")
    with pytest.raises(BadInput, match="unknown tie rule"):
        search(ground, 0, 1, "octile", "filo")
    assert search(ground, 0, 8, limit=2).status is PlanStatus.BUDGET_SPENT
