"""Grids compiled to motion graphs: every state and edge by the rules, said once more cell by cell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.world.grid import STEPS, GridMotion, compile_grid
from engine.world.motion_graph import MotionGraph
from tests.strategies import graphs, grid_graph

Pose = tuple[int, int, int, int]  # x, y, degrees, moving


def poses(graph: MotionGraph) -> list[Pose]:
    xy = np.floor(graph.xy_m).astype(int)
    return [
        (int(xy[p][0]), int(xy[p][1]), graph.heading_deg[h], int(m))
        for p, h, m in zip(graph.state_place, graph.state_heading, graph.state_moving, strict=True)
    ]


def wanted_edges(free: np.ndarray, exits: np.ndarray, motion: GridMotion) -> set[tuple[Pose, Pose, int, bool, tuple]]:
    """(from, to, ticks, starts, corners) of every motion, from the rules."""
    height, width = free.shape
    eight = bool((exits & 0b10101010).any())
    directions = range(8) if eight else range(0, 8, 2)
    step = 45 if eight else 90
    out = set()

    def is_free(x: int, y: int) -> bool:
        return 0 <= x < width and 0 <= y < height and bool(free[y, x])

    for y in range(height):
        for x in range(width):
            if not free[y, x]:
                continue
            for d in directions:
                for moving in (0, 1):
                    here = (x, y, 45 * d, moving)
                    for e in directions:
                        turn = min((e - d) % 8, (d - e) % 8) * 45
                        if motion.turning == "pivot" and turn:
                            if turn == step:
                                out.add((here, (x, y, 45 * e, 0), motion.turn_ticks, False, ()))
                            continue
                        dx, dy = STEPS[e]
                        if not exits[y, x] >> e & 1 or not is_free(x + dx, y + dy):
                            continue
                        corners: tuple = ()
                        if dx and dy:
                            if not (is_free(x + dx, y) and is_free(x, y + dy)):
                                continue
                            corners = tuple(sorted([(x + dx, y), (x, y + dy)]))
                        ticks = motion.diagonal_ticks if dx and dy else motion.straight_ticks
                        if turn == 180:
                            ticks = max(ticks, motion.reverse_ticks)
                        elif turn:
                            ticks = max(ticks, motion.turn_ticks)
                        starts = not moving or turn == 180
                        out.add((here, (x + dx, y + dy, 45 * e, 1), ticks, starts, corners))
    return out


def edges_of(graph: MotionGraph) -> set[tuple[Pose, Pose, int, bool, tuple]]:
    pose, xy = poses(graph), np.floor(graph.xy_m).astype(int).tolist()
    out = set()
    for e in range(graph.n_edges):
        p = graph.primitives[graph.edge_kind[e]]
        swept = graph.sweep[graph.sweep_ptr[e] : graph.sweep_ptr[e + 1]].tolist()
        corners = tuple(sorted(tuple(xy[c]) for c in swept))
        out.add((pose[graph.edge_from[e]], pose[graph.edge_to[e]], p.ticks, p.starts, corners))
    assert len(out) == graph.n_edges
    return out


@settings(max_examples=60)
@given(st.data())
def test_edges_are_exactly_those_of_the_rules(data: st.DataObject) -> None:
    width, height = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    n = width * height
    free = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n))).reshape(height, width)
    free[0, 0] = True
    every = data.draw(st.sampled_from([0b01010101, 0b11111111]))
    exits = np.array(data.draw(st.lists(st.integers(0, 255), min_size=n, max_size=n)), np.uint8) & np.uint8(every)
    exits = exits.reshape(height, width)
    ticks = st.integers(1, 4)
    motion = GridMotion(1000, data.draw(st.sampled_from(["arc", "pivot"])), *(data.draw(ticks) for _ in range(4)))
    assert edges_of(compile_grid(free, exits, motion)) == wanted_edges(free, exits, motion)


@settings(max_examples=40)
@given(graphs())
def test_arrays_belong_together(graph: MotionGraph) -> None:
    e = np.arange(graph.n_edges)
    assert (np.diff(graph.edge_from) >= 0).all()
    for s in range(graph.n_states):
        assert (graph.edge_from[graph.edge_ptr[s] : graph.edge_ptr[s + 1]] == s).all()
        entering = graph.rev_edge[graph.rev_ptr[s] : graph.rev_ptr[s + 1]]
        assert (graph.edge_to[entering] == s).all()
    assert sorted(graph.rev_edge.tolist()) == e.tolist()
    twin = graph.edge_twin
    assert (twin[twin] == e).all()
    assert (twin != e).all()
    assert (graph.edge_to[twin] == graph.edge_to).all()
    assert (graph.edge_from[twin] == graph.edge_from ^ 1).all()
    assert (graph.kind_ticks[graph.edge_kind[twin]] == graph.kind_ticks[graph.edge_kind]).all()
    assert (graph.state_moving[graph.stopped] == 0).all()
    assert (graph.state_place[graph.stopped] == graph.state_place).all()
    assert (graph.state_heading[graph.stopped] == graph.state_heading).all()
    assert (graph.kind_ticks == [p.ticks for p in graph.primitives]).all()
    assert len({p.name for p in graph.primitives}) == len(graph.primitives)
    assert graph.unit == all(p.ticks == 1 for p in graph.primitives)


def test_lengths_of_motions() -> None:
    by_name = {p.name: p for p in grid_graph(2, 2, motion=GridMotion(cell_mm=2000), eight=True).primitives}
    assert by_name["straight"].length_mm == 2000
    assert by_name["turn 90"].length_mm == pytest.approx(2000 * np.pi / 4, rel=1e-15)
    assert by_name["reverse"].length_mm == 2000
    assert by_name["diagonal straight"].length_mm == 2000 * 2**0.5
    assert by_name["start turn 45"].turn_deg == 45
    assert by_name["turn 90"].length_mm < by_name["turn 45"].length_mm < by_name["straight"].length_mm
    pivots = [p for p in grid_graph(2, 2, motion=GridMotion(turning="pivot", turn_ticks=4)).primitives if p.pivot]
    assert [(p.name, p.length_mm, p.turn_deg, p.ticks) for p in pivots] == [
        ("stop pivot", 0, 90, 4),
        ("pivot", 0, 90, 4),
    ]


def test_a_state_is_found_by_place_heading_and_moving() -> None:
    graph = grid_graph(3, 2)
    for place in range(6):
        for heading in range(4):
            for moving in (0, 1):
                s = graph.state(place, heading, moving)
                assert (graph.state_place[s], graph.state_heading[s], graph.state_moving[s]) == (place, heading, moving)
    with pytest.raises(KeyError):
        graph.state(0, 4)
