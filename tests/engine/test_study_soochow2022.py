"""The soochow2022 study: cells that do what they say, one small run, and the result that is shipped."""

from __future__ import annotations

import json

import numpy as np
import pytest

import assets
from engine.studies import soochow2022 as study
from engine.studies.base import Settings


@pytest.fixture(scope="module")
def result() -> study.Result:
    return study.Soochow2022().run(Settings(maps=1), lambda done, of, what: True)


def test_every_experiment_has_its_cells() -> None:
    full, quick = (study.Soochow2022().cells(Settings(quick=quick)) for quick in (False, True))
    by = {e: sum(cell["experiment"] == e for cell in full) for e in range(1, 6)}
    assert by == {1: 3000, 2: 100, 3: 1200, 4: 50, 5: 1}
    assert len(quick) < 120
    assert len({json.dumps(cell) for cell in full}) == len(full)


def test_one_map_of_everything(result: study.Result) -> None:
    assert (result.plans, result.breaches) == (6, 0)
    assert {row.experiment for row in result.rows} == {1, 2, 3, 4, 5}
    assert [f.name for f in result.figures] == [
        "convergence", "lengths", "times", "grid", "collisions", "done", "charges", "detours",
    ]  # fmt: skip
    of = {(row.quantity, row.case): row for row in result.rows}
    for density in ("10 %", "20 %", "30 %"):
        assert of["maps on which the printed inducement changes nothing", density].ours == 100
        assert of["longer than A*: classic ant system", density].ours >= 0
    for policy in study.POLICIES:
        assert of["task sets with a collision: corrected", policy].ours == 0
        assert of["task sets done: corrected", policy].ours == 100
    detour = of["steps beyond eight directions", "one-way ways"]
    assert (detour.verdict, detour.n) == ("outside", 18 * 17)


def test_a_task_set_is_the_same_for_both_sides() -> None:
    cell = {"experiment": 3, "policy": "eight directions", "map": 4, "seed": 1}
    strict, corrected = (study.task_set(cell, np.random.default_rng(9), strict) for strict in (True, False))
    assert strict.orders == corrected.orders
    assert len(strict.orders.pairs) == study.ORDERS
    assert strict.model_copy(update={"planner": corrected.planner}) == corrected


def test_the_grid_is_the_thesis_parameters() -> None:
    assert list(study.GRID_LETTERS) == list(study.GRID)
    assert study.named((1.0, 5.0, 0.1, 0.5, 0.1)) == "α 1, β 5, ρ 0.1, ε0 0.5, ξ 0.1"


def test_the_shipped_result_counts_a_thousand_task_sets_and_no_collision_of_the_corrected_planner() -> None:
    file = assets.path("studies", "soochow2022", "soochow2022.json")
    record = json.loads(file.read_text("utf-8"))
    assert file.stat().st_size < 100_000
    assert (record["study"], record["breaches"]) == ("soochow2022", 0)
    rows = [r for r in record["rows"] if r["quantity"].startswith("task sets with a collision")]
    for side, most in (("as described", 100.0), ("corrected", 0.0)):
        found = [r for r in rows if r["quantity"].endswith(side)]
        assert sum(r["n"] for r in found) >= 1000
        assert all((0 < r["ours"] <= most) if most else r["ours"] == 0 for r in found)
    same = [r for r in record["rows"] if "changes nothing" in r["quantity"]]
    assert [r["ours"] for r in same] == [100.0] * 3
