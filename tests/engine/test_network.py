"""Path networks: places, motions, kerbs, files, and fleets that never lock each other in."""

from __future__ import annotations

import json
import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine import MemoryLog, judge
from engine.build import build
from engine.errors import BadInput, FormatError, ScenarioError
from engine.scenario import load, parse
from engine.scenario.checks import check, ill_formed_pairs, place_graph
from engine.types import Occupancy, StationKind
from engine.world import build_world
from engine.world.network import Arc, NetworkPlan, NetworkWorld, Node, from_networkx, mesh, read_graphml


def world_of(nodes: tuple[Node, ...], arcs: tuple[Arc, ...], **more: object) -> NetworkWorld:
    world = build_world(NetworkPlan(nodes, arcs, mm_per_tick=100.0, turn_ticks=10, **more))  # type: ignore[arg-type]
    assert isinstance(world, NetworkWorld)
    return world


def lian() -> NetworkWorld:
    world = build_world(load("lian2024"))
    assert isinstance(world, NetworkWorld)
    return world


def test_the_paper_s_network_has_its_numbers():
    world = lian()
    assert (world.n_nodes, len(world.arcs)) == (112, 202)
    assert len(world.stations_of("entrance")) == 16
    assert len(world.stations_of("rack")) == 96
    assert world.n_places == 112 + 2 * 202
    ticks = {(p.length_mm, p.turn_deg): p.ticks for p in world.graph.primitives}
    assert ticks[900, 0] == 9  # 900 ms an arc
    assert ticks[0, 90] == 10  # 1000 ms a turn
    assert ticks[450, 0] in (4, 5)


def test_half_arcs_add_up_to_whole_ones_and_straight_on_holds_the_node():
    world = lian()
    g = world.graph
    halves = [p for p in g.primitives if p.length_mm == 450 and not p.starts]
    assert sum(p.ticks for p in halves) == 9
    for e in range(g.n_edges):
        a, b = g.state_place[g.edge_from[e]], g.state_place[g.edge_to[e]]
        swept = g.sweep[g.sweep_ptr[e] : g.sweep_ptr[e + 1]].tolist()
        if a >= world.n_nodes and b >= world.n_nodes:
            node = world.lane_ends[a - world.n_nodes, 1]
            assert swept == [node] == [world.lane_ends[b - world.n_nodes, 0]]
            assert world.lane_ends[a - world.n_nodes, 0] != world.lane_ends[b - world.n_nodes, 1]
        else:
            assert swept == []


def test_a_way_costs_its_arcs_and_its_turns():
    from scipy import sparse
    from scipy.sparse import csgraph

    world = lian()
    g = world.graph
    ticks = g.kind_ticks[g.edge_kind].astype(float)
    matrix = sparse.csr_array((ticks, g.edge_to, g.edge_ptr), shape=(g.n_states, g.n_states))
    node = {n.name: i for i, n in enumerate(world.nodes)}
    east, start = g.heading_deg.index(0), node["2/3"]
    from_start = csgraph.dijkstra(matrix, indices=g.state(start, east))
    for (x, y), turns in (((9, 3), 0), ((9, 5), 1), ((2, 6), 1), ((1, 3), 2)):
        goal = node[f"{x}/{y}"]
        found = from_start[g.place_ptr[goal] : g.place_ptr[goal + 1]].min()
        assert found == 9 * (abs(x - 2) + abs(y - 3)) + 10 * turns


def test_kerbs_leave_every_node_in_reach_of_every_other():
    world = lian()
    open_lanes = np.ones(len(world.lane_arc), bool)
    open_lanes[world.parking - world.n_nodes] = False
    graph = nx.DiGraph()
    graph.add_nodes_from(range(world.n_nodes))
    graph.add_edges_from(world.lane_ends[open_lanes].tolist())
    assert nx.is_strongly_connected(graph)
    assert len(set(world.lane_arc[world.parking - world.n_nodes].tolist())) == len(world.parking) >= 60
    assert ill_formed_pairs(world) == []
    assert not [f for f in check(load("lian2024"), world) if f.level == "error"]


@settings(max_examples=25)
@given(st.integers(3, 12), st.data())
def test_any_connected_network_compiles_and_keeps_its_kerbs_apart(n: int, data: st.DataObject):
    """Random points on a circle, a ring and chords: all places reach each other, also without the kerbs."""
    angles = sorted(data.draw(st.lists(st.integers(0, 359), min_size=n, max_size=n, unique=True)))
    nodes = tuple(Node(str(a), 9 * math.cos(math.radians(a)), 9 * math.sin(math.radians(a))) for a in angles)
    ring = {(i, (i + 1) % n) for i in range(n)}
    chords = data.draw(st.sets(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=4))
    pairs = ring | {(a, b) for a, b in chords if a != b and (a, b) not in ring and (b, a) not in ring and a < b}
    arcs = tuple(Arc(a, b, 2000 + 100 * (a % 3)) for a, b in sorted(pairs))
    world = world_of(nodes, arcs, kerbs=n)
    g = world.graph
    assert nx.is_strongly_connected(place_graph(world))
    assert ill_formed_pairs(world) == []
    for s in range(g.n_states):
        assert g.state(int(g.state_place[s]), int(g.state_heading[s]), int(g.state_moving[s])) == s
    for e in range(g.n_edges):
        twin = g.edge_twin[e]
        assert g.edge_to[twin] == g.edge_to[e]
        assert twin == e or twin == g.edge_twin[twin] or g.edge_twin[twin] == e
        turn = g.primitives[g.edge_kind[e]].turn_deg
        a, b = g.heading_deg[g.state_heading[g.edge_from[e]]], g.heading_deg[g.state_heading[g.edge_to[e]]]
        exact = min((a - b) % 360, (b - a) % 360)
        if g.primitives[g.edge_kind[e]].pivot:
            assert turn == max(15, 15 * round(exact / 15))
        else:
            assert turn == 0
            assert exact <= 20


def test_a_network_comes_from_networkx_graphml_and_toml(tmp_path):
    graph = nx.Graph()
    graph.add_node("A", x=0.0, y=0.0, kind="entrance")
    graph.add_node("B", x=2.0, y=0.0)
    graph.add_node("C", x=2.0, y=1.5, kind="rack")
    graph.add_edge("A", "B")
    graph.add_edge("B", "C", length=4.0)
    graph.add_edge("C", "A")
    nx.write_graphml(graph, tmp_path / "net.graphml")
    nodes, arcs = from_networkx(graph)
    assert {(nodes[a.a].name, nodes[a.b].name): a.length_mm for a in arcs} == {
        ("A", "B"): 2000,
        ("A", "C"): 2500,
        ("B", "C"): 4000,
    }
    again, same = read_graphml(tmp_path / "net.graphml")
    assert again == nodes
    assert {(a.a, a.b, a.length_mm) for a in same} == {(a.a, a.b, a.length_mm) for a in arcs}
    text = """
name = "triangle"
title = "Three nodes"
[time]
tick_s = 0.1
[floor]
kind = "network"
[floor.network]
kerbs = 2
nodes = [
  { name = "A", x = 0.0, y = 0.0, kind = "entrance" },
  { name = "B", x = 2.0, y = 0.0 },
  { name = "C", x = 2.0, y = 1.5, kind = "rack" },
]
arcs = [{ from = "A", to = "B" }, { from = "B", to = "C", length_m = 4.0 }, { from = "C", to = "A" }]
[motion]
turn_ticks = 10
[fleet]
count = 1
start = "parking"
[orders]
mix = [{ from = "entrance", to = "rack" }]
"""
    scenario = parse(text)
    assert parse(scenario.to_toml()) == scenario
    world = build_world(scenario)
    assert isinstance(world, NetworkWorld)
    assert world.nodes == nodes
    assert set(world.arcs) == {Arc(0, 1, 2000), Arc(1, 2, 4000), Arc(2, 0, 2500)}
    json.dumps(world.floor_json())


def test_one_way_arcs_come_from_a_directed_graph():
    graph = nx.DiGraph()
    for name, (x, y) in {"A": (0, 0), "B": (3, 0), "C": (0, 3)}.items():
        graph.add_node(name, x=x, y=y)
    graph.add_edges_from([("A", "B"), ("B", "C"), ("C", "A"), ("B", "A")])
    nodes, arcs = from_networkx(graph)
    assert {(nodes[a.a].name, nodes[a.b].name): a.one_way for a in arcs} == {
        ("A", "B"): False,
        ("B", "C"): True,
        ("C", "A"): True,
    }
    world = world_of(nodes, arcs)
    assert len(world.lane_arc) == 4
    assert [world.names[p] for p in world.parking] == ["B→A"]  # the only lane whose closing cuts nobody off


@pytest.mark.parametrize(
    ("nodes", "arcs", "more", "why"),
    [
        ((("A", 0, 0), ("A", 1, 0)), ((0, 1, 900),), {}, "two nodes are called 'A'"),
        ((("A", 0, 0), ("B", 0, 0)), ((0, 1, 900),), {}, "stand at one point"),
        ((("A", 0, 0), ("B", 1, 0)), ((0, 0, 900),), {}, "leads back to it"),
        ((("A", 0, 0), ("B", 1, 0)), ((0, 1, 100),), {}, "less than two ticks"),
        ((("A", 0, 0), ("B", 1, 0)), ((0, 1, 900), (1, 0, 900)), {}, "two arcs lead from A to B|from B to A"),
        ((("A", 0, 0), ("B", 1, 0)), ((0, 1, 900),), {"occupancy": Occupancy.MAPF}, "needs occupancy 'hold'"),
        ((("A", 0, 0),), (), {}, "at least two nodes"),
    ],
)
def test_a_wrong_network_is_refused_with_a_sentence(nodes, arcs, more, why):
    with pytest.raises(BadInput, match=why):
        world_of(tuple(Node(*n) for n in nodes), tuple(Arc(*a) for a in arcs), **more)


def test_wrong_files_and_scenarios_are_told(tmp_path):
    bad = tmp_path / "bad.graphml"
    bad.write_text("no xml")
    with pytest.raises(FormatError, match="not a GraphML file"):
        read_graphml(bad)
    graph = nx.Graph()
    graph.add_node("A", x=0.0)
    graph.add_edge("A", "A")
    nx.write_graphml(graph, bad)
    with pytest.raises(FormatError, match=r"bad.graphml: A: there is no 'y'"):
        read_graphml(bad)
    with pytest.raises(ScenarioError, match=r"fleet\.count: got 65 vehicles, expected at most 64"):
        load("lian2024", {"fleet.count": 65})
    with pytest.raises(ScenarioError, match="has no rows"):
        load("lian2024", {"floor.rows": "..."})
    with pytest.raises(ScenarioError, match=r"floor\.network"):
        load("lian2024", {"floor.network.mesh.spacing_m": 0.05})


def test_a_mesh_is_numbered_from_below_with_entrances_in_its_outer_columns():
    nodes, arcs = mesh(3, 2, 2.0)
    assert [(n.name, n.x_m, n.y_m, n.kind) for n in nodes] == [
        ("0/0", 0.0, 0.0, StationKind.ENTRANCE),
        ("1/0", 2.0, 0.0, StationKind.RACK),
        ("2/0", 4.0, 0.0, StationKind.ENTRANCE),
        ("0/1", 0.0, 2.0, StationKind.ENTRANCE),
        ("1/1", 2.0, 2.0, StationKind.RACK),
        ("2/1", 4.0, 2.0, StationKind.ENTRANCE),
    ]
    assert {(a.a, a.b) for a in arcs} == {(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)}


@pytest.mark.parametrize(("planner", "vehicles"), [("quickest", 29), ("prioritized", 60)])
def test_a_fleet_on_the_network_stays_live_and_legal(planner: str, vehicles: int):
    """No breach, no deadlock, nobody left without a plan, and orders done all the time."""
    log = MemoryLog()
    sim = build(load("lian2024", {"fleet.count": vehicles, "planner.name": planner}), recorder=log)
    done = 0
    for _ in range(3):
        sim.advance(600)
        sim.check()
        assert sim.book.n_done > done
        done = sim.book.n_done
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    now = sim.metrics()
    assert (sim.deadlocks, now["without_plan"], now["stranded"]) == (0, 0, 0)
    assert now["oldest_open_s"] < 60


def test_blocked_lanes_and_breakdowns_end_in_no_deadlock():
    """Sixty vehicles, a lane blocked and a vehicle broken down every half a minute, all put right again."""
    log = MemoryLog()
    sim = build(load("lian2024", {"fleet.count": 60, "planner.name": "stochastic"}), seed=5, recorder=log)
    rng = np.random.default_rng(5)
    lanes, vehicles = rng.integers(112, sim.graph.n_places, 8), rng.integers(0, 60, 8)
    for lane, vehicle in zip(lanes.tolist(), vehicles.tolist(), strict=True):
        sim.advance(300)
        sim.submit({"do": "block", "place": lane})
        sim.submit({"do": "fail", "vehicle": vehicle})
        sim.check()
    for lane, vehicle in zip(lanes.tolist(), vehicles.tolist(), strict=True):
        sim.submit({"do": "unblock", "place": lane})
        sim.submit({"do": "repair", "vehicle": vehicle})
    done = sim.book.n_done
    sim.advance(1200)
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    assert sim.book.n_done > done + 20
    now = sim.metrics()
    assert (sim.deadlocks, now["without_plan"], now["stranded"]) == (0, 0, 0)
