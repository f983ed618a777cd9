"""Studies from the command line and behind the Papers page: what is printed, kept, shown; ending and going on."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from app import progress, study_report
from app import study as studies_module
from app.figures.study import study_panels
from app.study import SHIPPED, Asked, NoSuchResult, Store, Studies, compute, write_record
from engine.errors import BadInput, RunError, ScenarioError
from engine.studies.base import STUDIES, Cell, Ended, Figure, Progress, Result, Settings, row, run_cells
from tests.conftest import ROOT

KEYS = {
    "study", "made", "title", "paper", "experiments", "parameters", "rows", "figures", "plans", "breaches", "notes",
}  # fmt: skip
ROW_KEYS = {
    "experiment", "quantity", "case", "unit", "paper", "ours", "half_width", "n", "verdict", "off", "note",
}  # fmt: skip


def halve(cell: Cell) -> Cell:
    return {"y": cell["x"] / 2}


FIGURES = (
    Figure("l", "Lines", "lines", {"series": [{"name": "a", "x": ["p", "q"], "y": [1.0, 2.0], "half": [0.5, None]}],
           "bands": [{"name": "the paper", "x": ["p", "q"], "low": [1, 2], "high": [1, 3]}], "log_y": True}),
    Figure("b", "Bars", "bars", {"series": [{"name": "a", "x": [1, 2], "y": [1.0, 2.0]}], "y_title": "s"}),
    Figure("s", "Scatter", "scatter", {"series": [{"name": "a", "x": [1, 2], "y": [1.0, 2.0]}]}),
    Figure("h", "Histogram", "histogram", {"series": [{"name": "a", "values": [1.0, 2.0, 2.0]}], "x_title": "s"}),
    Figure("t", "Table", "table", {"columns": ["a", "b"], "rows": [["x", 1.5]], "note": "a | note"}),
    Figure("g", "Gantt", "gantt", {"bars": [{"row": "1", "begin": 0, "end": 2, "name": "drive"}], "x_title": "s"}),
    Figure("f", "Floor", "floor", {"rows": ["..", "@."], "paths": {"A*": [[[0, 0], [1, 0]]], "EEA*": [[[0, 0]]]},
           "captions": {"A*": "A*: 1 kJ"}}),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Tiny:
    """A study of a few cells that take no time, with a figure of every kind."""

    name: str = "tiny"
    title: str = "Halves"
    paper: str = "Nobody 2000, Halves"
    maps: tuple[int, int] = (3, 6)

    @property
    def experiments(self) -> Mapping[int, str]:
        return {1: "halves against wholes"}

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        maps = settings.maps or self.maps[not settings.quick]
        cells = [{"x": i + settings.seed, "what": f"map {i + 1}"} for i in range(maps)]
        values = [each["y"] for each in run_cells(halve, cells, settings, progress, jobs)]
        rows = (
            row(1, "half", "all", values, (0.0, 1e6), "m"),
            row(1, "half", "less", values, 0.0, "m"),
            row(1, "whole", "all", [2 * v for v in values], unit="m", note="not printed"),
        )
        parameters = {"seed": settings.seed, "masses_kg": [1.0, 2.5]}
        return Result(
            self.name, self.title, self.paper, self.experiments, parameters, rows, FIGURES, maps, 0, ("Whole | half.",)
        )


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(STUDIES, "tiny", "tests.app.test_study:Tiny")
    return "tiny"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "data")


def quiet(done: int, total: int, what: str) -> None:
    """Nobody listens."""


def made(name: str, store: Store, *, until: int | None = None, **asked: Any) -> dict[str, Any]:
    """A record, computed in this process; `until`: ended after so many cells."""
    told = quiet if until is None else lambda done, total, what: done < until
    return compute(name, Asked(**{"jobs": 1, **asked}), store, told, lambda text: None)


# -- the command line -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["xu2024"], ["unknown study 'xu2024'", "did you mean 'xu2025'"]),
        (["xu2025", "--maps", "0"], ["between 1 and 100000 maps", "got 0"]),
        (["xu2025", "--maps", "many"], ["--maps"]),
        (["xu2025", "--jobs", "0"], ["jobs", "-1 for one per core", "got 0"]),
        (["xu2025", "--seed", "-1"], ["a seed of zero or more was expected, got -1"]),
        (["xu2025", "extra"], ["extra"]),
        (["tiny", "--out", "{file}"], ["can't be written"]),
    ],
)
def test_bad_input_is_one_sentence(
    wattlane: Any, tiny: str, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    said = wattlane("study", *[a.format(file=tmp_path / "file") for a in arguments], "--data", tmp_path / "data")
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith("wattlane: ")
    assert "Traceback" not in said.err
    for word in words:
        assert word in said.err


def test_studies_are_listed(wattlane: Any, tiny: str, tmp_path: Path) -> None:
    said = wattlane("study", "--data", tmp_path)
    assert said.code == 0
    assert "tiny  Halves (Nobody 2000, Halves)" in said.out
    assert "  1  halves against wholes" in said.out
    listed = json.loads(wattlane("study", "--json", "--data", tmp_path).out)["studies"]
    assert [entry["study"] for entry in listed] == list(STUDIES)
    assert listed[-1]["maps"] == {"quick": 3, "full": 6}


def test_json_is_one_object_with_everything(wattlane: Any, tiny: str, tmp_path: Path) -> None:
    said = wattlane("study", "tiny", "--quick", "--jobs", 1, "--json", "--out", tmp_path / "out", "--data", tmp_path)
    assert said.code == 0
    assert said.out.count("\n") == 1
    record = json.loads(said.out)
    assert record.keys() == KEYS | {"files"}
    assert all(each.keys() == ROW_KEYS for each in record["rows"])
    about = record["made"]
    assert (about["quick"], about["maps"], about["seed"], about["cells"], about["kept"]) == (True, 3, 11, 3, 0)
    assert about["counted"] == "maps"
    assert about["versions"]["python"]
    assert [each["verdict"] for each in record["rows"]] == ["inside", "outside", "–"]
    files = [Path(file) for file in record["files"]]
    assert [file.name for file in files] == ["tiny.json", "tiny.md", "tiny.html"]
    assert json.loads(files[0].read_text("utf-8")) == {key: record[key] for key in KEYS}
    assert files[1].read_text("utf-8") == study_report.markdown(record)
    page = files[2].read_text("utf-8")
    assert page.startswith("<!doctype html>")
    head, _, body = page.rpartition("</head>")
    assert "plotly.js" in head
    assert not re.findall(r"(?:src|href)=", body), "it needs nothing beside itself"


def test_the_table_is_printed_with_verdicts_by_word_and_sign(wattlane: Any, tiny: str, tmp_path: Path) -> None:
    said = wattlane("study", "tiny", "--maps", 4, "--jobs", 1, "--data", tmp_path)
    assert said.code == 0
    assert "| 1 | half, m | all | 0 to 1e+06 | 6.25 | ±1.03 | 4 | inside |" in said.out
    assert "| outside by +6.25 |" in said.out
    assert "| 1 | whole (not printed), m | all | – | 12.50 |" in said.out
    assert "- masses_kg: 1, 2.5" in said.out
    assert "1 of 2 rows that the paper prints lie inside; no breach in 4 plans judged" in said.out
    assert "Kept for the Papers page as tiny/" in said.err


def test_breaches_end_with_their_own_code(
    wattlane: Any, tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Tiny.run

    def broken(self: Tiny, *given: Any) -> Result:
        return replace(run(self, *given), breaches=2)

    monkeypatch.setattr(Tiny, "run", broken)
    said = wattlane("study", "tiny", "--jobs", 1, "--data", tmp_path)
    assert said.code == 1
    assert "2 breaches in 6 plans judged" in said.out


def test_ctrl_c_keeps_what_is_computed(
    wattlane: Any, tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class AfterTwo:
        def __init__(self) -> None:
            self.asked = 0

        def is_set(self) -> bool:
            self.asked += 1
            return self.asked > 2  # the first question comes before any cell

    with monkeypatch.context() as patch:
        patch.setattr(progress, "stop_on_signals", lambda: contextlib.nullcontext(AfterTwo()))
        said = wattlane("study", "tiny", "--jobs", 1, "--data", tmp_path)
    assert said.code == 130
    assert "ended after 2 of 6 cells; the same command goes on" in said.err
    assert said.out == ""
    said = wattlane("study", "tiny", "--jobs", 1, "--json", "--data", tmp_path)
    assert json.loads(said.out)["made"]["kept"] == 2


def test_a_signal_ends_it_in_order(tmp_path: Path) -> None:
    """Ctrl-C reaches every process of the terminal; nothing is printed but the sentence."""
    command = [sys.executable, "-m", "app.cli", "study", "xu2025", "--maps", "3000", "--jobs", "2", "--data", tmp_path]
    with (tmp_path / "err").open("wb") as err:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=err, start_new_session=True)
    cells = tmp_path / "studies" / "xu2025" / "cells"
    wait_for(lambda: len(list(cells.glob("*/*.json"))) > 2 or process.poll() is not None)
    os.killpg(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=120)
    said = (tmp_path / "err").read_text()
    assert process.returncode == 130, said
    assert out == b""
    assert "the same command goes on" in said
    assert "Traceback" not in said


# -- what is kept -----------------------------------------------------------------------------------------------------


def test_a_run_goes_on_where_it_was_ended(tiny: str, store: Store) -> None:
    with pytest.raises(Ended):
        made(tiny, store, until=4)
    assert store.results(tiny) == []
    record = made(tiny, store)
    assert (record["made"]["kept"], record["made"]["cells"]) == (4, 6)
    assert made(tiny, store)["made"]["kept"] == 6
    assert made(tiny, store, seed=50)["made"]["kept"] == 0


def test_results_are_kept_newest_first_and_not_for_ever(tiny: str, store: Store) -> None:
    ids = [made(tiny, store, maps=1, seed=seed)["made"]["id"] for seed in range(studies_module.RESULTS_KEPT + 2)]
    listed = store.results(tiny)
    assert {each["id"] for each in listed} == set(ids[2:])
    assert listed == sorted(listed, key=lambda each: str(each["id"]), reverse=True)
    record = store.record(tiny, ids[-1])
    assert record["made"]["seed"] == len(ids) - 1
    for wrong in ("20200101-000000-000000", "../../etc", "", SHIPPED):
        with pytest.raises(NoSuchResult):
            store.record(tiny, wrong)
    with pytest.raises(NoSuchResult, match="did you mean 'tiny'"):
        store.results("tny")
    (store.root / tiny / "results" / f"{ids[-1]}.json").write_text("{")
    assert len(store.results(tiny)) == studies_module.RESULTS_KEPT - 1
    with pytest.raises(RunError, match="can't be read"):
        store.record(tiny, ids[-1])


def test_a_record_is_written_as_it_is(tmp_path: Path) -> None:
    record = {"a": [1, 2.5, -3e-9], "b": ["x, [1, 2]", None], "c": {"d": [[0, 1], [1, 1]], "e": []}}
    write_record(record, tmp_path / "r.json")
    assert json.loads((tmp_path / "r.json").read_text()) == record
    assert '"a": [1, 2.5, -3e-09]' in (tmp_path / "r.json").read_text()


def test_what_ships_is_whole() -> None:
    """One full run came with the program, and no plan of it breaks a rule."""
    store = Store(Path("/nowhere"))
    for name in STUDIES:
        (entry,) = store.results(name)
        assert entry["origin"] == SHIPPED
        record = store.record(name, SHIPPED)
        assert record.keys() == KEYS
        assert not record["made"]["quick"]
        assert record["breaches"] == 0 < record["plans"]
        assert record["made"]["versions"].keys() >= {"python", "numpy", "numba"}
        text = study_report.markdown(record)
        assert (ROOT / "assets" / "studies" / name / f"{name}.md").read_text("utf-8") == text


def test_the_pictures_that_ship_show_legal_paths() -> None:
    record = Store(Path("/nowhere")).record("xu2025", SHIPPED)
    for name in ("figure-8", "figure-10"):
        data = figure_data(record, name)
        free = {(x, y) for y, line in enumerate(data["rows"]) for x, letter in enumerate(line) if letter == "."}
        for ways in data["paths"].values():
            for way in ways:
                assert all(tuple(cell) in free for cell in way)
                steps = [abs(a[0] - b[0]) + abs(a[1] - b[1]) for a, b in itertools.pairwise(way)]
                assert max(steps) == 1


# -- figures ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.kind)
def test_every_kind_of_figure_is_drawn(figure: Figure, scheme: str) -> None:
    panels = study_panels(
        {"name": figure.name, "title": figure.title, "kind": figure.kind, "data": figure.data}, scheme
    )
    assert len(panels) == {"table": 0, "floor": 2}.get(figure.kind, 1)
    for panel in panels:
        json.loads(panel.chart.to_json())
    if figure.kind == "floor":
        assert [panel.caption for panel in panels] == ["A*: 1 kJ", "EEA*"]
        assert panels[0].ratio == 1.0


def test_a_figure_without_values_says_so() -> None:
    for kind in ("lines", "bars", "scatter", "histogram", "gantt"):
        data: dict[str, Any] = {"series": [], "bars": []}
        (panel,) = study_panels({"name": "n", "title": "t", "kind": kind, "data": data})
        assert panel.chart.layout.annotations[0].text


# -- behind the page --------------------------------------------------------------------------------------------------


def figure_data(record: Mapping[str, Any], name: str) -> Any:
    return next(each["data"] for each in record["figures"] if each["name"] == name)


def wait_for(condition: Any, seconds: float = 600) -> None:
    """Returns once the condition holds; fails when it doesn't in time."""
    give_up = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < give_up, "it did not come"
        time.sleep(0.1)


@pytest.fixture
def studies(tmp_path: Path) -> Iterator[Studies]:
    made = Studies(tmp_path)
    yield made
    made.close()
    for name in STUDIES:
        status = made.status(name)
        if status is not None:
            wait_for(lambda name=name: not made.status(name)["alive"])


def test_a_run_is_cancelled_goes_on_and_finishes(studies: Studies) -> None:
    assert studies.status("xu2025") is None
    with pytest.raises(RunError, match="is not being computed"):
        studies.cancel("xu2025")
    studies.start("xu2025", Asked(maps=400, jobs=2))
    with pytest.raises(RunError, match="xu2025 is being computed; cancel it"):
        studies.start("xu2025", Asked(maps=1))
    wait_for(lambda: studies.status("xu2025")["done"] > 3 or not studies.status("xu2025")["alive"])
    status = studies.status("xu2025")
    assert (status["phase"], status["total"], status["failure"]) == ("running", 4800, "")
    assert status["elapsed_s"] > 0
    studies.cancel("xu2025")
    assert studies.status("xu2025")["phase"] in ("cancelling", "cancelled")
    wait_for(lambda: not studies.status("xu2025")["alive"])
    assert studies.status("xu2025")["phase"] == "cancelled"
    kept = len(list(studies.store.cells("xu2025").glob("*/*.json")))
    assert kept > 3
    assert studies.store.results("xu2025")[0]["origin"] == SHIPPED
    studies.start("xu2025", Asked(maps=1, jobs=1))  # its first case's first map is among the cells kept
    wait_for(lambda: not studies.status("xu2025")["alive"])
    status = studies.status("xu2025")
    assert (status["phase"], status["done"], status["kept"] > 0) == ("finished", 12, True), status["failure"]
    newest = studies.store.results("xu2025")[0]
    assert (newest["id"], newest["origin"]) == (status["result_id"], "own")
    assert studies.store.record("xu2025", newest["id"])["breaches"] == 0


def test_without_its_server_a_run_ends(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "app.study_worker", "xu2025", "--data", tmp_path, "--maps", "3000", "--jobs", "1"]
    process = subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
    )
    cells = tmp_path / "studies" / "xu2025" / "cells"
    wait_for(lambda: len(list(cells.glob("*/*.json"))) > 1 or process.poll() is not None)
    assert process.poll() is None
    process.stdin.close()  # type: ignore[union-attr]
    process.wait(60)


def test_what_a_page_asks_for_is_checked(studies: Studies) -> None:
    with pytest.raises(ScenarioError, match="maps per case"):
        studies.start("xu2025", Asked(maps=0))
    with pytest.raises(NoSuchResult, match="did you mean 'xu2025'"):
        studies.start("xu2024", Asked())
    with pytest.raises(BadInput, match="jobs"):
        Asked(jobs=-2)


def test_results_are_downloaded(client: httpx.Client) -> None:
    record = client.get("/papers/xu2025/shipped.json")
    assert record.status_code == 200
    assert record.json()["study"] == "xu2025"
    text = client.get("/papers/xu2025/shipped.md")
    assert text.text == study_report.markdown(record.json())
    assert text.headers["content-disposition"] == 'attachment; filename="xu2025-shipped.md"'
    for wrong in (
        "/papers/xu2025/shipped.exe",
        "/papers/xu2024/shipped.json",
        "/papers/xu2025/20200101-000000-000000.json",
    ):
        assert client.get(wrong).status_code == 404
        assert client.get(wrong).json()["error"]


# -- on a cluster -----------------------------------------------------------------------------------------------------


def test_a_cluster_gives_equal_results(tiny: str, tmp_path: Path) -> None:
    """A scheduler and two workers on loopback, against this process."""
    distributed = pytest.importorskip("distributed")
    here = made("xu2025", Store(tmp_path / "here"), maps=1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as cluster:
        there = compute(
            "xu2025", Asked(maps=1), Store(tmp_path / "there"), quiet, lambda text: None, cluster.scheduler_address
        )
    assert there["made"]["where"] == "a cluster"
    assert there["made"]["kept"] == 0
    assert there["rows"] == here["rows"]
    for name in ("figure-8", "figure-10"):
        assert figure_data(there, name) == figure_data(here, name)


def test_a_scheduler_that_is_not_there_is_a_sentence(
    wattlane: Any, tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(studies_module, "CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        said = wattlane("study", "tiny", "--scheduler", address, "--data", tmp_path)
        assert (said.code, said.out) == (2, "")
        assert f"--scheduler {address}: no dask scheduler answers there" in said.err
