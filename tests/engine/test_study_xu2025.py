"""The study of xu2025: cells, table, files, going on after an end."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from engine.build import SOLVERS
from engine.errors import InvariantBroken, RunError, ScenarioError
from engine.studies import base
from engine.studies.base import (
    FIGURE_KINDS,
    STUDIES,
    Ended,
    Figure,
    Settings,
    as_plain,
    by_quantity,
    code_version,
    mean_interval,
    row,
    run_cells,
    study,
)
from engine.studies.xu2025 import Xu2025, solve_cell


def quiet(done: int, total: int, what: str) -> None:
    """Nobody listens."""


def double(cell: base.Cell) -> base.Cell:
    return {"x": 2 * cell["x"]}


def test_every_registered_study_keeps_the_contract() -> None:
    for name in STUDIES:
        found = study(name)
        assert found.name == name
        assert found.title
        assert found.paper
        assert found.experiments
        assert 1 <= found.maps[0] <= found.maps[1]
    with pytest.raises(ScenarioError, match="did you mean 'xu2025'"):
        study("xu2024")


def test_cells_are_kept_and_not_computed_again(tmp_path: Path) -> None:
    cells = [{"x": i} for i in range(6)]
    asked: list[int] = []

    def counted(cell: base.Cell) -> base.Cell:
        asked.append(cell["x"])
        return double(cell)

    def until_three(done: int, total: int, what: str) -> bool:
        return done < 3

    with pytest.raises(Ended, match="ended after 3 of 6"):
        run_cells(counted, cells, Settings(folder=tmp_path), until_three)
    assert asked == [0, 1, 2]
    (folder,) = tmp_path.iterdir()
    assert folder.name == code_version(__name__)
    files = sorted(folder.iterdir())
    assert len(files) == 3
    files[0].write_text('{"cell":')  # cut off
    told: list[tuple[int, int]] = []
    results = run_cells(counted, cells, Settings(folder=tmp_path), lambda d, n, w: told.append((d, n)))
    assert results == [{"x": 2 * i} for i in range(6)]
    assert len(asked) == 3 + 4
    assert told[0] == (2, 6)
    assert told[-1] == (6, 6)
    run_cells(counted, cells, Settings(folder=tmp_path), quiet)
    assert len(asked) == 7


def test_cells_of_other_code_are_not_used_and_removed_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def counted(cell: base.Cell) -> base.Cell:
        asked.append(cell["x"])
        return double(cell)

    for number, code in enumerate(("one", "two", "three", "three")):
        monkeypatch.setattr(base, "code_version", lambda module, code=code: code)
        run_cells(counted, [{"x": 1}], Settings(folder=tmp_path), quiet)
        assert len(asked) == min(number, 2) + 1
    assert len(list(tmp_path.iterdir())) == base.VERSIONS_KEPT
    with pytest.raises(RunError, match="a worker has other code"):
        base._numbered(counted, 0, {"x": 1}, "four")


def test_cold_kernels_are_compiled_by_one_process(tmp_path: Path) -> None:
    """One cell of each experiment comes first, in this process; the answers stay in order."""
    cells = [{"x": i, "experiment": i % 2, "what": str(i)} for i in range(5)]
    told: list[str] = []
    found = run_cells(double, cells, Settings(cold=True), lambda d, n, w: told.append(w), jobs=2)
    assert found == [{"x": 2 * i} for i in range(5)]
    assert told[1:3] == ["0", "1"]
    assert sorted(told[3:]) == ["2", "3", "4"]


def test_a_run_on_more_cores_ends_when_told_to_and_gives_the_same(tmp_path: Path) -> None:
    cells = [{"x": i} for i in range(40)]
    with pytest.raises(Ended, match="ended after 2 of 40"):
        run_cells(double, cells, Settings(folder=tmp_path), lambda d, n, w: d < 2, jobs=2)
    assert len(list(tmp_path.glob("*/*.json"))) == 2
    assert run_cells(double, cells, Settings(folder=tmp_path), quiet, jobs=2) == [{"x": 2 * i} for i in range(40)]


def test_the_rows_of_a_quantity_stand_together() -> None:
    rows = [row(e, q, c, [1.0]) for e, q, c in ((1, "b", "x"), (1, "a", "x"), (2, "b", "x"), (1, "b", "y"))]
    assert [(r.experiment, r.quantity, r.case) for r in by_quantity(rows)] == [
        (1, "b", "x"), (1, "b", "y"), (1, "a", "x"), (2, "b", "x"),
    ]  # fmt: skip


def test_a_figure_is_of_a_known_kind() -> None:
    assert {Figure("f", "t", kind, {}).kind for kind in FIGURE_KINDS} == set(FIGURE_KINDS)
    with pytest.raises(InvariantBroken, match="did you mean 'lines'"):
        Figure("f", "t", "line", {})


def test_intervals_and_verdicts() -> None:
    mean, half = mean_interval([1.0, 2.0, 3.0, 4.0])
    assert mean == 2.5
    assert half == pytest.approx(3.182446 * math.sqrt(5 / 3) / 2, rel=1e-6)
    assert mean_interval([3.0]) == (3.0, None)
    values = [1.0, 2.0, 3.0, 4.0]
    assert (row(1, "q", "c", values, 2.5).verdict, row(1, "q", "c", values, 2.5).off) == ("inside", 0.0)
    assert (row(1, "q", "c", values, (5.0, 6.0)).verdict, row(1, "q", "c", values, (5.0, 6.0)).off) == ("outside", -2.5)
    assert (row(1, "q", "c", values, (0.0, 2.0)).verdict, row(1, "q", "c", values, (0.0, 2.0)).off) == ("inside", 0.5)
    assert row(1, "q", "c", values).verdict == "–"
    assert row(1, "q", "c", [], 3.0).verdict == "–"


def test_a_cell_is_the_same_every_time_but_for_its_run_times() -> None:
    cells = Xu2025().cells(Settings(maps=1))
    assert len(cells) == 5 + 4 + 3
    first, again = (solve_cell(json.loads(json.dumps(cells[2]))) for _ in range(2))
    assert {k: v for k, v in first.items() if k != "ms"} == {k: v for k, v in again.items() if k != "ms"}
    assert first["energy_j"]["eea"] == first["energy_j"]["eea_table"] == first["energy_j"]["eea_naive"]
    assert first["energy_j"]["eea"] <= min(first["energy_j"]["astar"], *first["ties_j"].values())
    assert first["ties_j"]["fifo"] == first["energy_j"]["astar"]
    assert first["breaches"] == dict.fromkeys(("astar", "eea_naive", "eea", "eea_table"), 0)
    assert first["steps"]["eea"] >= first["steps"]["astar"]
    assert first["expanded"]["eea_table"] <= first["expanded"]["eea"]


@pytest.mark.skipif("ecbs" not in SOLVERS, reason="needs the constraint trees")
def test_the_study_from_cells_to_files(tmp_path: Path) -> None:
    result = Xu2025().run(Settings(maps=2, folder=tmp_path / "cells"), quiet)
    assert {r.experiment for r in result.rows} == {1, 2, 3}
    assert result.breaches == 0
    assert result.plans == 2 * (5 + 4) * 4 + 2 * 3 * 3
    assert all(r.ours > 0 for r in result.rows if "EEA*" in r.quantity and "saved" in r.quantity)
    assert {f.name for f in result.figures} >= {"figure-7", "figure-8", "figure-10", "experiment-1", "ties"}
    assert result.parameters["r"] == pytest.approx(1.64, abs=0.01)
    assert result.parameters["tie rule of A*"] == "fifo"
    assert result.parameters["tie rule of CBS"]
    read = json.loads(json.dumps(as_plain(result), allow_nan=False))
    assert len(read["rows"]) == len(result.rows)
    assert read["rows"][0]["paper"] == [12.15, 16.44]
    # everything was kept: a second run computes nothing and says the same
    told: list[int] = []
    again = Xu2025().run(Settings(maps=2, folder=tmp_path / "cells"), lambda d, n, w: told.append(d))
    assert told == [24]
    assert as_plain(again) == as_plain(result)
    picture = next(f for f in result.figures if f.name == "figure-8").data
    assert picture["paths"]["A*"][0][0] == [0, 0]
    assert picture["paths"]["EEA*"][0][-1] == [19, 19]


def test_other_settings_are_other_cells(tmp_path: Path) -> None:
    names = {
        base._file(tmp_path, cell).name
        for one in (Xu2025(), Xu2025(tie="lifo"), Xu2025(parameters={"mu": 0.02}))
        for seed in (1, 2)
        for cell in one.cells(Settings(maps=1, seed=seed))
    }
    assert len(names) == 3 * 2 * 12
    for wrong in ({"maps": 0}, {"maps": 100_001}, {"seed": -1}):
        with pytest.raises(ScenarioError):
            Settings(**wrong)
