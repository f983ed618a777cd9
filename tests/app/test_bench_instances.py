"""`wattlane bench --instances`: what it reads, and what its lines say; speeds are measured by the command itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app import bench_instances, bench_peers
from app.bench import table
from engine.errors import BadInput
from engine.planners.cbs import CBS
from engine.scenario.movingai import map_text, random_instance, scen_text
from tests.app.said import refused

NAME = "rand20-10-1"
HEAD = "map,scen,agents,optimal_sum_of_costs\n"


@pytest.fixture
def folder(tmp_path: Path) -> bench_instances.Folder:
    """One small instance under one of the names that are measured."""
    instance = random_instance(np.random.default_rng(1), 10, 10, 0.1, 12, NAME)
    (tmp_path / f"{NAME}.map").write_text(map_text(instance.free))
    (tmp_path / f"{NAME}-gen-1.scen").write_text(scen_text(instance))
    return bench_instances.Folder(tmp_path)


def test_a_folder_without_instances_is_refused(wattlane: Any, tmp_path: Path) -> None:
    refused(wattlane("bench", "--instances", tmp_path), "random-32-32-20.map")
    refused(wattlane("bench", "--instances", tmp_path / "none"), "a folder was expected")


def test_known_costs_are_compared(folder: bench_instances.Folder) -> None:
    instance = folder.get(NAME, "gen-1", 8)
    assert instance is not None
    cost = CBS().solve(bench_instances.problem(instance), bench_instances.within(5)).cost
    csv = folder.path / "optimal_costs.csv"
    for right in (True, False):
        csv.write_text(f"{HEAD}{NAME}.map,{NAME}-gen-1.scen,8,{cost + (not right)}\nother.map,other-gen-1.scen,2,5\n")
        rows: dict[str, Any] = {}
        found = bench_instances.optimal(folder, rows, quick=True)
        assert [one.met for one in found] == [right, None, True]
        assert [(row["cost"], row["closed"]) for row in rows["optimal"]] == [(cost, True)]
    csv.write_text(f"{HEAD}{NAME}.map,x.scen,8\n")
    with pytest.raises(BadInput, match="line 2"):
        bench_instances.optimal(folder, {}, quick=True)


def test_energy_is_measured_with_its_gap(folder: bench_instances.Folder) -> None:
    rows: dict[str, Any] = {}
    found = bench_instances.crowds(folder, rows, quick=True)
    assert [row["agents"] for row in rows["ecbs"]] == [8, 12]
    for row in rows["ecbs"]:
        assert row["lower_bound"] <= row["cost"] <= row["time_window"]
        assert row["gap"] == pytest.approx(row["cost"] / row["lower_bound"] - 1)
    text = table({"machine": {"python": "3", "machine": "x", "cores": 1, "load": 0.0}, "results": map(vars, found)})
    assert "worse than time windows" in text
    assert "met" in text


def test_networkx_agrees_on_the_steps(folder: bench_instances.Folder) -> None:
    from tests.naive_mapf2 import steps

    instance = folder.get(NAME, "gen-1")
    assert instance is not None
    assert "networkx" in bench_peers.installed()
    found = bench_peers.networkx_astar(instance)()
    assert found == [steps(instance.free, a, b) for a, b in zip(instance.starts, instance.goals, strict=True)]
