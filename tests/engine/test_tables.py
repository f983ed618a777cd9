"""Backward tables against plain relaxation: time, then energy, on poses; energy, then time, on states."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.energy import cost_table
from engine.planners.base import NO_WAY
from engine.planners.kernels.tables import ENERGY, FAR, TICK, Tables, packed, packed_energy
from engine.planners.search import FloorSearch
from engine.world.grid import GridMotion
from engine.world.motion_graph import MotionGraph
from tests import naive
from tests.strategies import MASSES, costs_of, graphs, grid_graph, model


def check_tables(graph: MotionGraph, mj: np.ndarray, goal: int) -> None:
    """Both layers of a goal, state by state."""
    ticks = graph.kind_ticks
    time = Tables(graph, packed(ticks, mj), poses=True)
    energy = Tables(graph, packed_energy(ticks, mj), poses=False)
    rolling = [s for s in range(graph.n_states) if graph.state_moving[s]]
    pairs = [naive.Pair((int(t), int(c))) for t, c in zip(ticks, mj, strict=True)]
    # a pose counts as rolling, so only motions between rolling states are told apart; a pivot ends at rest
    pose = {s: s | 1 for s in range(graph.n_states)}
    folded = Folded(graph, pose)
    by_time = naive.costs_to(folded, pairs, goal, naive.Pair((0, 0)), rolling)
    turned = [naive.Pair((c, t)) for t, c in pairs]
    by_energy = naive.costs_to(graph, turned, goal, naive.Pair((0, 0)), range(graph.n_states))
    for s in range(graph.n_states):
        got = time.cost(goal, s)
        want = by_time.get(s | 1)
        assert (got >= FAR) if want is None else (got >> TICK, got & ((1 << TICK) - 1)) == tuple(want)
        got, want = energy.cost(goal, s), by_energy.get(s)
        assert (got >= FAR) if want is None else (got >> ENERGY, got & ((1 << ENERGY) - 1)) == tuple(want)


class Folded:
    """A graph in which a vehicle always rolls: edges leave rolling states and lead to rolling ones."""

    def __init__(self, graph: MotionGraph, pose: dict[int, int]):
        keep = [e for e in range(graph.n_edges) if graph.edge_from[e] & 1]
        self.n_edges = len(keep)
        self.edge_from = graph.edge_from[keep]
        self.edge_to = np.array([pose[int(s)] for s in graph.edge_to[keep]], np.int64)
        self.edge_kind = graph.edge_kind[keep]
        self.state_place = graph.state_place


@settings(max_examples=100)
@given(st.data())
def test_both_layers_are_the_plain_ones(data: st.DataObject) -> None:
    graph = data.draw(graphs())
    costs = data.draw(costs_of(graph))
    least = costs.total_mj.min(axis=(0, 1)) + graph.kind_ticks.astype(np.int64) * costs.standby_mj.min()
    check_tables(graph, least, data.draw(st.integers(0, graph.n_places - 1)))


@pytest.mark.nojit_slice
@pytest.mark.parametrize("turning", ["arc", "pivot"])
@pytest.mark.parametrize("eight", [False, True])
def test_a_small_hall(turning: str, eight: bool) -> None:
    graph = grid_graph(3, 3, [(1, 1)], GridMotion(turning=turning, turn_ticks=2), eight)
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    least = costs.total_mj.min(axis=(0, 1)) + graph.kind_ticks.astype(np.int64) * costs.standby_mj.min()
    check_tables(graph, least, 7)


def test_time_is_that_of_networkx() -> None:
    graph = grid_graph(6, 5, [(2, 2), (3, 2), (0, 4)], GridMotion(straight_ticks=2, turn_ticks=3, reverse_ticks=5))
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    search = FloorSearch(graph, costs)
    g = nx.DiGraph()
    for e in range(graph.n_edges):
        if graph.edge_from[e] & 1:
            ticks = graph.primitives[graph.edge_kind[e]].ticks
            g.add_edge(int(graph.edge_to[e]) >> 1, int(graph.edge_from[e]) >> 1, weight=ticks)
    for goal in (0, 11, graph.n_places - 1):
        poses = {s >> 1 for s in range(graph.n_states) if graph.state_place[s] == goal}
        far = nx.multi_source_dijkstra_path_length(g, poses)
        for s in range(graph.n_states):
            assert search.ticks_to(goal, s) == far[s >> 1]


def test_a_goal_out_of_reach_is_far_and_no_way() -> None:
    graph = grid_graph(3, 1, [(1, 0)])
    search = FloorSearch(graph, cost_table(graph.primitives, model(), MASSES, 1.0))
    assert search.ticks_to(1, 0) >= NO_WAY
    assert search.energy.cost(1, 0) >= FAR
    assert search.ticks_to(0, 0) == 0


def test_rows_are_kept_until_there_is_no_room_and_never_those_in_use() -> None:
    graph = grid_graph(6, 6)
    costs = packed(graph.kind_ticks, np.ones(len(graph.primitives), np.int64))
    room = 10 * 8 * (graph.n_states // 2)
    tables, plain = Tables(graph, costs, poses=True, max_bytes=room), Tables(graph, costs, poses=True)
    goals = [int(g) for g in np.random.default_rng(3).integers(0, graph.n_places, 200)]
    for i in range(len(goals)):
        wanted = set(goals[max(0, i - 4) : i + 1])
        slots = {g: tables.slot(g, wanted) for g in wanted}
        assert len(set(slots.values())) == len(wanted)
        for g, at in slots.items():
            row = plain.slot(g)
            assert (tables.pool[at] == plain.pool[row]).all()
    assert len(tables.pool) <= 10
