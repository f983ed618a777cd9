"""A router's ways beside other methods': which are asked for, and that A*'s are the shortest."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from app import ways_beside
from app.cli import ways_text
from app.components.panels import ways_panel
from app.ways_beside import WaysBeside
from engine import MemoryLog
from engine.build import build
from engine.scenario import load
from engine.scenario.checks import place_graph
from engine.types import OrderState

FEW = {"planner.name": "aco", "planner.parameters": {"ants": 4, "iterations": 3}, "time.until_s": 40.0}


def ran(name: str = "soochow2022", overrides: dict[str, object] | None = None) -> tuple[MemoryLog, WaysBeside]:
    log = MemoryLog()
    sim = build(load(name, {**FEW, **(overrides or {})}), recorder=log)
    sim.advance(40)
    sim.flush()
    ways = WaysBeside.of(sim.scenario, sim.world)
    assert ways is not None
    return log, ways


def test_every_way_of_an_order_is_asked_for_once() -> None:
    log, ways = ran()
    asked = ways.queries(log)
    assert len(asked) == len(set(asked)) <= ways_beside.MOST
    assert all(a != b for a, b in asked)
    orders, plans = log.table("orders"), log.table("plans")
    assigned = set(plans["order"].tolist())
    for row in np.flatnonzero(orders["state"] == OrderState.OPEN):
        ends = (int(orders["from_place"][row]), int(orders["to_place"][row]))
        if orders["order"][row] in assigned and ends[0] != ends[1]:
            assert ends in asked
    assert ways.queries(log, -1) == []
    assert ways.queries(log, 10) == asked[: len(ways.queries(log, 10))]


@pytest.mark.parametrize("name", ["soochow2022", "soochow2022-four", "soochow2022-eight"])
def test_a_star_is_the_shortest_and_everybody_is_measured_on_the_same_ways(name: str) -> None:
    log, ways = ran(name)
    asked = ways.queries(log)[:6]
    told = ways.told(asked)
    assert (told["ways"], told["missing"]) == (len(asked), 0)
    assert list(told["methods"]) == ["aco", "classic ant system", "A*"]
    graph = place_graph(build(load(name)).world)
    xy_m = ways.xy_m
    for a, b in graph.edges:
        graph.edges[a, b]["m"] = float(np.linalg.norm(xy_m[a] - xy_m[b]))
    shortest = [nx.shortest_path_length(graph, a, b, weight="m") for a, b in asked]
    assert told["methods"]["A*"]["length_m"] == pytest.approx(np.mean(shortest))
    for one in told["methods"].values():
        assert one["length_m"] >= told["methods"]["A*"]["length_m"] - 1e-9
        assert one["above"] == pytest.approx(one["length_m"] / np.mean(shortest) - 1, abs=1e-9)
        assert one["cpu_ms"] > 0


def test_ways_are_searched_a_few_at_a_time_and_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    log, ways = ran()
    asked = ways.queries(log)
    assert len(asked) > 2
    first = ways.told(asked, within_s=0)
    assert (first["ways"], first["missing"]) == (1, len(asked) - 1)
    kept = dict(ways.found)
    whole = ways.told(asked)
    assert (whole["ways"], whole["missing"]) == (len(asked), 0)
    assert all(ways.found[query] is kept[query] for query in kept)
    monkeypatch.setattr(ways, "_asked", None)
    assert ways.told(asked) == whole


def test_only_routers_with_others_beside_them_have_any() -> None:
    for planner in ("prioritized", "astar"):
        scenario = load("soochow2022", {"planner.name": planner})
        assert WaysBeside.of(scenario, build(scenario).world) is None
    ground = load("zhang2021")
    assert WaysBeside.of(ground, None) is None  # type: ignore[arg-type]


def test_they_are_told_in_words_and_as_a_table() -> None:
    log, ways = ran()
    nothing = ways.told([])
    assert ways_text(nothing) == "none to compare"
    assert "No way was asked for yet" in str(ways_panel(nothing))
    told = ways.told(ways.queries(log)[:2])
    assert "A* " in ways_text(told)
    assert "first 2)" in ways_text(told)
    assert "classic ant system" in str(ways_panel(told))
    assert ways_panel(None) is None
