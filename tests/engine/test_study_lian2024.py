"""The study of lian2024: its runs, that other numbers of the vehicle need no other runs, table and figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.studies.base import Settings, as_plain, counted, study
from engine.studies.lian2024 import Lian2024
from engine.studies.lian2024_cells import MARK_S, run_cell
from engine.studies.lian2024_table import (
    AGVS,
    BASE,
    DISTANCE,
    FACTORS,
    FULL,
    OWN,
    PAPERS,
    QUICK,
    TABLE_3,
    TABLES_1_2,
    TURNS,
    Extent,
    after_learning,
    eer_of,
    gains,
    hours_words,
    kwh_of,
    orders_of,
    paper_arcs,
    steady,
)

HOURS = 1 / 6
SMALL = Extent(HOURS, HOURS, 1, (29,), tuple(f for f in FACTORS if f.kind == "own" or f.name.startswith("mass")))


def quiet(done: int, total: int, what: str) -> None:
    """Nobody listens."""


def cell(**more: Any) -> dict[str, Any]:
    asked = {
        "planner": "astar-turns", "objective": "time", "hours": HOURS, "seed": 3, "changes": {}, "keep": [],
        "recost": {}, "from_h": HOURS / 2,
    }  # fmt: skip
    return {**asked, **more}


def test_the_paper_s_own_numbers_agree_with_each_other() -> None:
    """What is printed besides table 3 follows from it; the printed standard error is of no number of samples."""
    totals = {method: sum(TABLE_3[method]) for method in PAPERS}
    assert 100 * (1 - totals[OWN] / totals[DISTANCE]) == pytest.approx(42.8, abs=0.05)
    assert 100 * (1 - totals[OWN] / totals[TURNS]) == pytest.approx(29.8, abs=0.05)
    assert [k + 1 for k in paper_arcs()] == [3, 2, 5, 4, 1]
    sd = TABLES_1_2["sd"]
    assert sd / 20**0.5 == pytest.approx(TABLES_1_2["se"], abs=1e-4)
    assert min(abs(sd / n**0.5 - 17.99548) for n in range(2, 200)) > 0.01


def test_cells_are_plain_and_distinct_seed_by_seed() -> None:
    for settings, extent in ((Settings(quick=True), QUICK), (Settings(), FULL)):
        cells = Lian2024().cells(settings)
        assert cells == json.loads(json.dumps(cells))
        assert len({json.dumps(c, sort_keys=True) for c in cells}) == len(cells)
        main = [c for c in cells if c["experiment"] == 1 and c["hours"] == extent.hours]
        assert len(main) == 4 * (2 if settings.quick else 5)
        seeds = {m: [c["seed"] for c in main if c["method"] == m] for m in (*PAPERS, "prioritized")}
        assert len({tuple(s) for s in seeds.values()}) == 1, "the same orders for all methods"
        few = Lian2024().cells(replace(settings, maps=1))
        assert cells[: len(few)] == few, "more seeds add cells, and change none"
        assert str(AGVS) in {c["case"] for c in cells}
        # windows begin and end at marks
        for hours in (after_learning(extent), extent.side_hours, extent.hours):
            assert hours * 3600 % MARK_S == pytest.approx(0)
    other = Lian2024().cells(Settings(seed=12))
    assert not {c["seed"] for c in other} & {c["seed"] for c in cells}
    assert Lian2024().maps == (2, 5)
    assert counted(Lian2024()) == "seeds"
    assert counted(study("xu2025")) == "maps"


def test_windows_of_a_run() -> None:
    r = {"orders_at": [10, 30, 60], "energy_at": {"copper": [3.6e6, 7.2e6, 18e6], "standby": [0.0, 3.6e6, 3.6e6]}}
    assert orders_of(r) == 60
    assert orders_of(r, 0, MARK_S / 3600) == 10
    assert orders_of(r, MARK_S / 3600, 3 * MARK_S / 3600) == 50
    assert kwh_of(r) == pytest.approx(6)
    assert eer_of(r, MARK_S / 3600) == pytest.approx(50 / 5)
    assert gains([r], [{**r, "orders_at": [10, 30, 50]}], orders_of) == [pytest.approx(20)]
    assert (hours_words(10), hours_words(0.75)) == ("10 h", "45 min")


def test_a_run_adds_up_and_other_vehicles_need_no_other_run() -> None:
    """The same motions with another mass or arc take what a run of such vehicles takes, but for ties among detours."""
    heavy = {"fleet.mass_kg": 1000.0}
    short = {"floor.network.mesh.spacing_m": 0.6, "motion.speed_mps": 0.6 / 0.9}
    recost = {"as it is": {}, "heavy": heavy, "short": short}
    r = run_cell(cell(keep=["arcs", "times"], recost=recost))
    assert (r["breaches"], r["stuck"], r["stranded"], r["plans_failed"]) == (0, 0, 0, 0)
    assert r["orders_at"][-1] == r["orders_done"] > 300
    assert (np.diff(r["orders_at"]) > 0).all()
    assert kwh_of(r) * 3.6e6 == pytest.approx(r["energy_j"], rel=1e-6)
    assert len(r["busy_s"]) == 404
    assert r["tests"]["visits"]["lane"]["n"] == 20
    assert min(r["lane_ms"]) >= 900
    assert r["recosted_j"]["as it is"] == pytest.approx(kwh_of(r, HOURS / 2) * 3.6e6, rel=5e-3)
    for name, changes in (("heavy", heavy), ("short", short)):
        other = run_cell(cell(changes=changes))
        assert other["orders_done"] == pytest.approx(r["orders_done"], rel=0.06)
        each = r["recosted_j"][name] / orders_of(r, HOURS / 2)
        assert each == pytest.approx(3.6e6 / eer_of(other, HOURS / 2), rel=0.06)


def test_a_steady_current_is_read_as_it_is_counted() -> None:
    run = steady()
    assert np.abs(run.error[run.stable]).max() < 1e-9
    assert run.q_ah[-1] == pytest.approx(run.cell.delivered_ah)


def test_the_study_from_cells_to_plain_values(tmp_path: Path) -> None:
    small = Lian2024(quick=SMALL)
    settings = Settings(quick=True, maps=1, folder=tmp_path)
    result = small.run(settings, quiet)
    assert {r.experiment for r in result.rows} == set(range(1, 8))
    assert result.breaches == 0 < result.plans
    assert {f.name for f in result.figures} >= {
        "figure-5", "how", "wrong", "learning", "table-3", "figure-6", "tables-1-2", "fleets", "tornado", "figure-2",
        "charge", "drive",
    }  # fmt: skip
    (headline,) = [r for r in result.rows if r.case == BASE]
    assert headline.paper == (26.84, 26.84)
    assert any("quick run" in r.quantity for r in result.rows)
    assert "quick" in result.notes[0]
    shares = [r for r in result.rows if "motors take" in r.quantity]
    assert len(shares) == 4
    assert all(r.verdict == "inside" for r in shares)
    wrong = next(f for f in result.figures if f.name == "wrong").data
    assert [line[0] for line in wrong["rows"]] == [*PAPERS, "prioritized"]
    assert all(line[wrong["columns"].index("breaches")] == 0 for line in wrong["rows"])
    plain = json.loads(json.dumps(as_plain(result), allow_nan=False))
    assert len(plain["rows"]) == len(result.rows)
    told: list[int] = []
    again = small.run(settings, lambda done, total, what: told.append(done))
    assert told == [len(small.cells(settings))]
    assert as_plain(again) == as_plain(result)
