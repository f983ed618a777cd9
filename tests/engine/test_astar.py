"""A* over places against textbook A* and networkx."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import ScenarioError
from engine.planners.astar import HEURISTICS, TIES, AStar
from engine.planners.kernels import single
from engine.planners.single import Floor
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance, random_floor
from engine.types import PlanStatus
from engine.world.grid import GridMotion, compile_grid
from tests import naive_mapf2 as naive


def floor_of(free: np.ndarray) -> Floor:
    graph = Instance("x", free, (), ()).graph()
    return Floor(graph, xu2025_costs(graph))


@st.composite
def questions(draw: st.DrawFn) -> tuple[np.ndarray, naive.Cell, naive.Cell]:
    """A small floor and two of its cells."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    start, goal = ((int(rng.integers(width)), int(rng.integers(height))) for _ in range(2))
    free = random_floor(rng, width, height, 0.0)
    free &= rng.random((height, width)) >= draw(st.sampled_from([0.0, 0.2, 0.4]))
    free[start[1], start[0]] = free[goal[1], goal[0]] = True
    return free, start, goal


@pytest.mark.nojit_slice
@settings(max_examples=60)
@given(questions(), st.sampled_from(sorted(HEURISTICS)), st.sampled_from(sorted(TIES)), st.integers(0, 9))
def test_the_way_is_as_short_as_networkx_says(
    question: tuple[np.ndarray, naive.Cell, naive.Cell], heuristic: str, tie: str, seed: int
) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    way = AStar(heuristic, tie, seed).search(floor, instance.place(start), instance.place(goal))
    steps = naive.steps(free, start, goal)
    if steps is None:
        assert way.status is PlanStatus.NO_PATH
        return
    assert way.cost == 1000 * steps
    assert len(way.states) == steps + 1
    places = way.states >> floor.net.shift
    assert (places[0], places[-1]) == (instance.place(start), instance.place(goal))
    assert floor.energy(way.states) >= 0  # each state follows from the one before


@pytest.mark.nojit_slice
@settings(max_examples=60)
@given(questions(), st.sampled_from(["fifo", "lifo"]), st.sampled_from(["manhattan", "chebyshev", "zero"]))
def test_buckets_expand_in_the_order_of_a_heap(
    question: tuple[np.ndarray, naive.Cell, naive.Cell], tie: str, heuristic: str
) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    rules = {
        "manhattan": lambda c: abs(c[0] - goal[0]) + abs(c[1] - goal[1]),
        "chebyshev": lambda c: max(abs(c[0] - goal[0]), abs(c[1] - goal[1])),
        "zero": lambda c: 0,
    }
    order, path = naive.expansions(free, start, goal, rules[heuristic], tie)
    way = AStar(heuristic, tie).search(floor, instance.place(start), instance.place(goal), trace=True)
    assert way.expanded == len(order)
    assert way.trace.get("node", np.zeros(0)).tolist() == [instance.place(c) for c in order]
    assert (way.states >> floor.net.shift).tolist() == [instance.place(c) for c in path]


@given(questions())
def test_both_open_lists_do_the_same(question: tuple[np.ndarray, naive.Cell, naive.Cell]) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    a, b = instance.place(start), instance.place(goal)
    for tie in ("fifo", "lifo"):
        way = AStar("manhattan", tie).search(floor, a, b, trace=True)
        ground = floor.grounds
        rows, out = single.new_trace(floor.graph.n_places), np.zeros(4, np.int64)
        single.astar_any(
            ground.step, floor.back, ground.xy, ground.length, np.zeros(floor.graph.n_places + 1, np.int32), a, b,
            single.MANHATTAN, np.zeros(0, np.int64), TIES[tie], 0, 2**62, rows, out,
        )  # fmt: skip
        assert out[1] == way.expanded
        for name, column in way.trace.items():
            if name != "open":  # the heap keeps what is outdated a while longer
                assert column.tolist() == getattr(rows, name)[: out[2]].tolist()


@given(questions(), st.sampled_from(sorted(HEURISTICS)), st.sampled_from(sorted(TIES)))
def test_a_trace_tells_the_search_and_does_not_change_it(
    question: tuple[np.ndarray, naive.Cell, naive.Cell], heuristic: str, tie: str
) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    a, b = instance.place(start), instance.place(goal)
    with_trace = AStar(heuristic, tie).search(floor, a, b, trace=True)
    without = AStar(heuristic, tie).search(floor, a, b)
    assert without.trace == {}
    assert with_trace.states.tolist() == without.states.tolist()
    t = with_trace.trace
    if not t:
        return
    assert t["parent"][0] == -1
    assert (t["f"] == t["g"] + t["h"]).all()
    at = {int(node): i for i, node in enumerate(t["node"])}
    for i in range(1, len(t["node"])):
        assert at[int(t["parent"][i])] < i
        assert t["g"][i] == t["g"][at[int(t["parent"][i])]] + 1000


@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 0, 1, 2, 3]))
def test_states_read_off_the_steps_follow_the_edges(seed: int, heading: int | None) -> None:
    rng = np.random.default_rng(seed)
    exits = ((rng.random((6, 7, 4)) < 0.8) @ np.array([1, 4, 16, 64], np.uint8)).astype(np.uint8)
    free = rng.random((6, 7)) < 0.9
    graph = compile_grid(free, exits, GridMotion())
    floor = Floor(graph, xu2025_costs(graph), (rng.random(graph.n_places) < 0.1).astype(np.uint8))
    assert floor.turns_freely
    assert not single.turns_freely(turning := compile_grid(free, exits, GridMotion(turning="pivot")), floor.grounds)
    assert turning.n_places == graph.n_places
    a, b = rng.integers(graph.n_places, size=2).tolist()
    way = AStar("manhattan", "lifo").search(floor, a, b, heading=heading)
    if way.status is PlanStatus.SOLVED:
        begin = None if heading is None else a * floor.per_place + 2 * heading
        assert way.states.tolist() == floor.along(way.states >> floor.net.shift, begin).tolist()


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(HEURISTICS)), st.sampled_from(sorted(TIES)))
def test_on_one_way_floors_parents_lead_to_their_children(seed: int, heuristic: str, tie: str) -> None:
    rng = np.random.default_rng(seed)
    exits = (rng.random((6, 7, 4)) < 0.7) @ np.array([1, 4, 16, 64], np.uint8)
    graph = compile_grid(rng.random((6, 7)) < 0.9, exits.astype(np.uint8), GridMotion())
    floor = Floor(graph, xu2025_costs(graph))
    a, b = rng.integers(graph.n_places, size=2).tolist()
    steps = floor.grounds.step
    way = AStar(heuristic, tie).search(floor, a, b, trace=True)
    network = nx.DiGraph([(p, int(q)) for p in range(graph.n_places) for q in steps[p] if q < graph.n_places])
    network.add_nodes_from(range(graph.n_places))
    if nx.has_path(network, a, b):
        assert way.cost == 1000 * nx.shortest_path_length(network, a, b)
    else:
        assert way.status is PlanStatus.NO_PATH
    g = dict(zip(way.trace.get("node", []), way.trace.get("g", []), strict=True))
    for node, parent, cost in zip(*(way.trace.get(name, []) for name in ("node", "parent", "g")), strict=True):
        if parent < 0:
            assert node == a
        else:
            assert node in steps[parent]
            assert cost == g[parent] + 1000


def test_a_room_is_used_again_and_again() -> None:
    floor = floor_of(np.ones((5, 5), np.bool_))
    floor.place_work.base[0] = 200  # nearly used up: the next searches begin anew
    for _ in range(40):
        assert AStar().search(floor, 0, 24).cost == 8000


def test_diagonals_count_their_length() -> None:
    graph = compile_grid(np.ones((5, 5), np.bool_), np.full((5, 5), 255, np.uint8), GridMotion())
    floor = Floor(graph, xu2025_costs(graph))
    for heuristic in ("octile", "euclidean", "chebyshev", "zero"):
        assert AStar(heuristic).search(floor, 0, 23).cost == 3 * 1414 + 1000


def test_the_limit_ends_a_search_and_blocks_are_avoided() -> None:
    graph = Instance("x", np.ones((3, 3), np.bool_), (), ()).graph()
    blocked = np.zeros(9, np.uint8)
    blocked[[1, 4]] = 1
    floor = Floor(graph, xu2025_costs(graph), blocked)
    assert AStar().search(floor, 0, 2).cost == 6000
    assert AStar().search(floor, 0, 2, limit=2).status is PlanStatus.BUDGET_SPENT
    assert AStar().search(floor, 0, 4).status is PlanStatus.NO_PATH


def test_the_random_rule_is_seeded() -> None:
    floor = floor_of(np.ones((9, 9), np.bool_))
    ways = [AStar(tie="random", seed=seed).search(floor, 0, 80).states.tolist() for seed in (1, 1, 2, 3)]
    assert ways[0] == ways[1]
    assert len({tuple(way) for way in ways}) > 1


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ScenarioError, match="did you mean 'manhattan'"):
        AStar("manhatten")
    with pytest.raises(ScenarioError, match="unknown tie rule"):
        AStar(tie="first")
