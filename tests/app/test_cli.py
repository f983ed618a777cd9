"""The command line: what it prints, where, and how it ends."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from app import cli
from engine.errors import BadInput
from tests.app.said import refused

KEYS = {
    "scenario", "planner", "seed", "run_id", "run_dir", "sim_s", "wall_s", "orders_created", "orders_done", "breaches",
    "stranded", "energy_j", "energy_by_component", "digest",
}  # fmt: skip


@pytest.fixture
def data(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the recorded run's data folder, to be changed."""
    shutil.copytree(recorded, tmp_path / "data")
    return tmp_path / "data"


def test_help_and_version(wattlane: Any) -> None:
    assert "dashboard" in wattlane("--help").out
    assert wattlane("--version").out.startswith("wattlane ")
    for command in ("dashboard", "run", "resume", "replay", "judge", "export", "validate", "solve", "bench", "runs"):
        assert wattlane(command, "--help").code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fly"], ["fly"]),
        (["run"], ["scenario"]),
        (["run", "soochow2022", "--fleet", "3"], ["--fleet"]),
        (["run", "soochow2022", "--seed", "one"], ["--seed"]),
        (["run", "soochow2021"], ["soochow2021", "did you mean 'soochow2022'"]),
        (["run", "no/such/file.toml"], ["no/such/file.toml"]),
        (["run", "soochow2022", "--planner", "prioritised"], ["planner", "'prioritized'"]),
        (["run", "soochow2022", "--objective", "fun"], ["objective"]),
        (["run", "soochow2022", "--set", "fleet.count"], ["key=value"]),
        (["run", "soochow2022", "--set", "fleet.cuont=3"], ["fleet", "count"]),
        (["run", "soochow2022", "--set", "fleet.count=many"], ["fleet.count"]),
        (["run", "soochow2022", "--until", "tomorrow"], ["tomorrow", "8h"]),
        (["run", "soochow2022", "--until", "0s"], ["one tick"]),
        (["run", "soochow2022", "--name", "x" * 200], ["name"]),
        (["runs", "show", "nothing"], ["no run 'nothing'"]),
        (["runs", "rm", "../../etc"], ["no run"]),
        (["judge", "nothing"], ["no run"]),
        (["judge", "nothing.json"], ["nothing.json", "no such file"]),
        (["replay", "nothing"], ["no run"]),
        (["resume", "nothing"], ["no run"]),
        (["export", "nothing", "--to", "xlsx"], ["xlsx", "csv"]),
        (["validate", "nothing.toml"], ["nothing.toml"]),
        (["dashboard", "--port", "99999"], ["port"]),
        (["dashboard", "--host", "0.0.0.0"], ["token"]),
        (["dashboard", "--token", "short"], ["token"]),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_two(
    wattlane: Any, tmp_path: Path, arguments: list[str], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATTLANE_DATA", str(tmp_path))
    refused(wattlane(*arguments), *words)


def test_malformed_toml_names_file_and_line(wattlane: Any, tmp_path: Path) -> None:
    file = tmp_path / "broken.toml"
    file.write_text("name = 'x'\n[floor\n")
    refused(wattlane("validate", file), "broken.toml", "line 2")
    file.write_bytes(b"\xff\xfe")
    refused(wattlane("validate", file), "UTF-8")


def test_a_folder_that_cannot_be_written_is_named(wattlane: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    refused(wattlane("run", "soochow2022", "--data", tmp_path / "file"), str(tmp_path / "file"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--planner", "aco", "--set", "planner.parameters.antz=3"], "unknown parameter of aco 'antz'; did you mean"),
        (["--planner", "aco", "--set", "planner.parameters.ants=three"], "aco: ants: got 'three', expected a whole"),
        (["--planner", "aco", "--set", "planner.parameters.ants=2.5"], "aco: ants: got 2.5, expected a whole number"),
        (["--planner", "aco", "--set", "planner.parameters.rho=true"], "aco: rho: got True, expected a number"),
        (["--planner", "aco", "--set", "planner.parameters.retreat=1"], "aco: retreat: got 1, expected true or false"),
        (["--planner", "aco", "--set", "planner.parameters.rule=7"], "aco: rule: got 7, expected a text"),
        (["--planner", "aco", "--set", "planner.parameters.ants=0"], "ants must be from 1 to 1000; got 0"),
        (["--dispatcher", "insertion", "--set", "dispatch.parameters.rounds=many"], "dispatch.parameters.rounds"),
        (["--dispatcher", "insertion", "--set", "dispatch.parameters.turns=3"], "unknown parameter of insertion"),
    ],
)
def test_a_wrong_parameter_is_told_before_a_run_is_made(
    wattlane: Any, tmp_path: Path, arguments: list[str], words: str
) -> None:
    said = wattlane("run", "soochow2022", *arguments, "--data", tmp_path)
    assert said.code == 2
    assert words in said.err
    assert not list(tmp_path.glob("runs/*"))


def test_built_in_scenarios_are_valid(wattlane: Any) -> None:
    from engine.scenario import library

    for name in library():
        said = wattlane("validate", name)
        if name == "soochow2022-battery":  # from the farther charger alone: the rule that it is there to break
            assert "takes 102.0% of a battery" in said.out
        assert said.code == 0, said.out
        assert f"{name} is valid" in said.out


def test_run_prints_one_json_object_and_twice_the_same_digest(wattlane: Any, tmp_path: Path) -> None:
    said = [
        wattlane("run", "soochow2022-continuous", "--until", "5min", "--json", *more, "--data", tmp_path)
        for more in (["--no-rrd"], ["--rrd", "--name", "with recording"])
    ]
    first, second = (one.json for one in said)
    assert set(first) >= KEYS
    assert (first["sim_s"], first["breaches"], first["stranded"]) == (300.0, 0, 0)
    assert said[0].code == 0
    assert first["digest"] == second["digest"]
    assert abs(sum(first["energy_by_component"].values()) - first["energy_j"]) < 1e-6 or "charged" in str(first)
    run_dir = Path(second["run_dir"])
    assert run_dir.parent == tmp_path / "runs"
    assert (run_dir / "run.rrd").is_file()
    assert not (Path(first["run_dir"]) / "run.rrd").exists()
    assert json.loads((run_dir / "manifest.json").read_text())["name"] == "with recording"


def test_out_names_the_folder_of_the_runs_folder(wattlane: Any, tmp_path: Path) -> None:
    summary = wattlane(
        "run", "soochow2022-continuous", "--until", "20s", "--no-rrd", "--json", "--out", tmp_path / "here"
    ).json
    folder = Path(summary["run_dir"])
    assert folder.parent == tmp_path / "here"
    assert wattlane("judge", folder, "--json").json["breaches"] == []


def test_an_endless_scenario_says_where_it_stops() -> None:
    from app import runner

    endless = runner.asked_scenario("soochow2022-continuous", {})
    assert runner.default_until_s(endless) == 3600.0
    assert runner.default_until_s(runner.asked_scenario("soochow2022", {})) is None
    assert runner.default_until_s(runner.asked_scenario("soochow2022-continuous", {"time.until_s": 60.0})) is None


def test_runs_are_listed_shown_and_removed(wattlane: Any, data: Path, run_id: str) -> None:
    assert run_id in wattlane("runs", "list", "--data", data).out
    assert [run["run_id"] for run in wattlane("runs", "list", "--json", "--data", data).json["runs"]] == [run_id]
    for name in (run_id, run_id[:20], "last", data / "runs" / run_id):
        assert wattlane("runs", "show", name, "--json", "--data", data).json["run_id"] == run_id
    assert wattlane("runs", "rm", run_id, "--data", data).code == 0
    assert wattlane("runs", "list", "--json", "--data", data).json["runs"] == []


def test_the_judges_verdict_is_the_exit_code(wattlane: Any, data: Path, run_id: str) -> None:
    said = wattlane("judge", run_id, "--data", data)
    assert said.code == 0
    assert "legal" in said.out
    log = data / "runs" / run_id / "log" / "motions.parquet"
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(log)
    places = table.column("to_place").to_numpy().copy()
    places[len(places) // 2] = (places[len(places) // 2] + 5) % 100
    column = table.schema.get_field_index("to_place")
    table = table.set_column(column, table.schema.field(column), pa.array(places, pa.int32()))
    pq.write_table(table, log)
    said = wattlane("judge", run_id, "--data", data)
    assert said.code == 1
    assert "breaches" in said.out


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_are_exported(wattlane: Any, data: Path, run_id: str, tmp_path: Path, kind: str) -> None:
    from engine.results.runlog import LogReader

    target = tmp_path / "out"
    assert wattlane("export", run_id, "--to", kind, "--out", target, "--data", data).code == 0
    rows = len(LogReader(data / "runs" / run_id).table("motions")["t0"])
    if kind == "csv":
        assert len((target / "motions.csv").read_text().splitlines()) == rows + 1
    else:
        import pyarrow.parquet as pq

        assert pq.read_table(target / "motions.parquet").num_rows == rows
    (tmp_path / "file").write_text("")
    refused(wattlane("export", run_id, "--to", kind, "--out", tmp_path / "file" / "x", "--data", data), "written")


def test_a_recording_is_exported_even_when_none_was_written(
    wattlane: Any, data: Path, run_id: str, tmp_path: Path
) -> None:
    target = tmp_path / "there.rrd"
    assert wattlane("export", run_id, "--to", "rrd", "--out", target, "--data", data).code == 0
    assert target.read_bytes()[:4] == b"RRF2"


def test_a_finished_run_is_not_resumed(wattlane: Any, data: Path, run_id: str) -> None:
    refused(wattlane("resume", run_id, "--data", data), "finished")


def test_two_beginnings_that_fit_are_told_apart(data: Path, run_id: str) -> None:
    from engine.errors import RunError

    shutil.copytree(data / "runs" / run_id, data / "runs" / f"{run_id}-b")
    assert cli.find_run(run_id, data).name == run_id
    with pytest.raises(RunError, match="begins 2 runs"):
        cli.find_run(run_id[:15], data)


def test_overrides_are_pairs() -> None:
    assert cli.overrides_of(["a.b=1", "c = x=y "]) == {"a.b": "1", "c": "x=y"}
    for wrong in ("a", "=1", " =1"):
        with pytest.raises(BadInput):
            cli.overrides_of([wrong])


def test_disk_errors_are_sentences() -> None:
    assert cli.sentence(OSError(28, "No space left on device")) == "the disk is full"
    assert cli.sentence(PermissionError(13, "Permission denied", "/x")) == "/x: Permission denied"
