"""The catalogue: names that stay inside its folder, states that are true, and deletion that refuses a live run."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.errors import BadInput, RunError
from engine.results import runs
from engine.results.runlog import RunLogWriter, write_manifest
from engine.results.runs import Catalogue, checked_id, checked_name, run_id_for
from tests import synthetic

CREATED = datetime(2026, 11, 22, 10, 15, tzinfo=UTC)


def test_an_id_says_when_and_what() -> None:
    assert run_id_for("soochow2022", CREATED).startswith("20261122-101500-soochow2022-")
    assert len({run_id_for("x", CREATED) for _ in range(50)}) > 40
    for odd in ("../../etc", "a b/c", "", "Ünïcode", "x" * 500):
        assert checked_id(run_id_for(odd, CREATED))


@pytest.mark.parametrize(
    "bad",
    [
        "",
        ".",
        "..",
        "../x",
        "a/b",
        "a\\b",
        "/etc/passwd",
        "a\0b",
        "-x",
        ".hidden",
        "a..b",
        "x" * 200,
        "a\n",
        None,
        7,
        "%2e%2e",
    ],
)
def test_ids_that_could_leave_the_folder_are_refused(tmp_path: Path, bad: object) -> None:
    catalogue = Catalogue(tmp_path)
    for ask in (catalogue.path, catalogue.get, catalogue.delete, catalogue.reader):
        with pytest.raises(BadInput, match="is not a run id"):
            ask(bad)  # type: ignore[arg-type]


@given(st.text(max_size=40))
def test_whatever_is_accepted_stays_inside(text: str) -> None:
    try:
        accepted = checked_id(text)
    except BadInput:
        return
    root = Path("runs").resolve()
    assert (root / accepted).resolve().parent == root


@pytest.mark.parametrize("bad", ["x" * 121, "a\nb", "a\x1bb", None, 3])
def test_labels_are_short_and_printable(bad: object) -> None:
    with pytest.raises(BadInput, match="at most 120 printable"):
        checked_name(bad)


def test_life_in_the_catalogue(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path / "runs")
    assert catalogue.list() == []
    folder = catalogue.new_folder("soochow2022", CREATED)
    manifest = {"run_id": folder.name, "created": CREATED.isoformat(), "scenario": "soochow2022"}
    writer = RunLogWriter(folder, manifest)
    (run,) = catalogue.list()
    assert run["status"] == "running"
    assert run["alive"]
    with pytest.raises(RunError, match="stop it before deleting"):
        catalogue.delete(folder.name)
    catalogue.rename(folder.name, "  my first run ")
    writer.update(ticks=5)
    assert catalogue.get(folder.name)["name"] == "my first run"
    writer.close("stopped")
    run = catalogue.get(folder.name)
    assert (run["status"], run["alive"], run["ticks"]) == ("stopped", False, 5)
    assert run["size_bytes"] > 0
    catalogue.delete(folder.name)
    assert catalogue.list() == []
    assert not folder.exists()
    with pytest.raises(RunError, match="there is no run"):
        catalogue.get(folder.name)


def test_a_run_whose_writer_died_is_interrupted(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    run_id = synthetic.make_run(tmp_path, ticks=50, close=False)
    write_manifest(tmp_path / run_id, {**catalogue.get(run_id), "status": "running"})
    assert catalogue.get(run_id)["status"] == "interrupted"


def test_what_is_no_run_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "manifest.json").write_text("{")
    run_id = synthetic.make_run(tmp_path, ticks=20)
    assert [run["run_id"] for run in Catalogue(tmp_path).list()] == [run_id]


def test_a_changed_manifest_is_read_again(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    run_id = synthetic.make_run(tmp_path, ticks=20)
    assert catalogue.get(run_id)["breaches"] is None
    write_manifest(tmp_path / run_id, {**json.loads((tmp_path / run_id / "manifest.json").read_text()), "breaches": 3})
    assert catalogue.get(run_id)["breaches"] == 3


def test_hundreds_of_runs_are_listed_newest_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for i in range(300):
        folder = tmp_path / f"run-{i:03d}"
        folder.mkdir()
        created = f"2026-11-22T10:{i // 60:02d}:{i % 60:02d}+00:00"
        (folder / "manifest.json").write_text(json.dumps({"created": created, "status": "finished"}))
    catalogue = Catalogue(tmp_path)
    catalogue.list()
    read: list[Path] = []
    monkeypatch.setattr(runs, "read_manifest", lambda folder: read.append(folder) or {})
    found = catalogue.list()
    assert read == [], "an unchanged passport is not read again"
    assert [run["run_id"] for run in found[:2]] == ["run-299", "run-298"]
    assert len(found) == 300
