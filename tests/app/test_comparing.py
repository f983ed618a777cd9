"""Runs beside each other: which belong together, what is told of them, and how they are started."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest

from app import comparing
from app.comparing import Comparisons, side
from app.figures import comparing_figure
from app.pages.compare import choices, chosen, start, start_address
from app.pages.data import overrides_from
from app.runner import asked_scenario
from app.runs import RunManager
from app.settings import Settings
from app.study import SHIPPED, Store
from engine.errors import BadInput, RunError
from engine.results.runlog import LogReader, read_manifest, write_manifest
from engine.results.view import RunView
from engine.studies.base import Beside, beside, study
from tests.synthetic import COMMANDS, make_run

QUIET, BUSY, SHORT, SEEDED, FEWER = "a-quiet", "b-busy", "c-short", "d-seeded", "e-fewer"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with five runs of the synthetic scenario."""
    folder = tmp_path_factory.mktemp("beside")
    runs = folder / "runs"
    make_run(runs, run_id=QUIET, ticks=400, commands=())
    make_run(runs, run_id=BUSY, ticks=400, commands=COMMANDS[:3])
    make_run(runs, run_id=SHORT, ticks=200, commands=())
    make_run(runs, run_id=SEEDED, ticks=200, seed=2, commands=())
    make_run(runs, run_id=FEWER, ticks=200, vehicles=4, commands=())
    for run_id in (QUIET, BUSY):
        write_manifest(runs / run_id, {**read_manifest(runs / run_id), "planner": f"planner-of-{run_id[0]}"})
    return folder


@pytest.fixture(scope="module")
def manager(data: Path) -> Iterator[RunManager]:
    made = RunManager(Settings(data=data, scenario=None, open_browser=False))
    yield made
    made.close()


def view_of(data: Path, run_id: str) -> RunView:
    from app.runner import scenario_of, world_of

    scenario = scenario_of(data / "runs" / run_id)
    return RunView(LogReader(data / "runs" / run_id), scenario, world_of(scenario))


# Which belong together


@pytest.mark.parametrize(
    ("runs", "reason"),
    [
        ([QUIET], "two to four runs were expected; got 1"),
        ([QUIET, BUSY, SHORT, SEEDED, FEWER], "two to four runs were expected; got 5"),
        ([QUIET, BUSY, QUIET], "different runs were expected; got a-quiet twice"),
        ([QUIET, SEEDED], "in A and B (a-quiet and d-seeded) the seed is 1 and 2"),
        ([QUIET, SHORT, FEWER], "in A and C (a-quiet and e-fewer) fleet.count is 5 and 4"),
    ],
)
def test_runs_that_dont_belong_together_are_refused_with_what_differs(
    manager: RunManager, runs: list[str], reason: str
) -> None:
    with pytest.raises(BadInput, match=re.escape(reason)):
        Comparisons(manager).checked(runs)


def test_runs_of_one_scenario_and_seed_belong_together_however_long_they_go_on(manager: RunManager) -> None:
    sides = Comparisons(manager).checked([QUIET, BUSY, SHORT])
    assert [one.run_id for one in sides] == [QUIET, BUSY, SHORT]


def test_forks_of_one_run_belong_together_whatever_was_changed(data: Path) -> None:
    """A fork and its parent, and two forks of one parent, even one that was deleted."""
    parents = {QUIET: None, SEEDED: QUIET, SHORT: "gone", FEWER: "gone"}

    def manifest_of(run_id: str) -> dict[str, Any]:
        if run_id not in parents:
            raise RunError(f"there is no run {run_id}")
        parent = parents[run_id]
        found = read_manifest(data / "runs" / run_id)
        return {**found, "parent": {"run_id": parent, "tick": 50} if parent else None}

    sides = {run_id: side(data / "runs" / run_id, manifest_of) for run_id in parents}
    assert comparing.refusal([sides[QUIET], sides[SEEDED]]) == ""
    assert comparing.refusal([sides[SHORT], sides[FEWER]]) == ""
    assert "seed" in comparing.refusal([sides[SEEDED], sides[SHORT]])


# What is told


def test_what_is_told_of_each_run_is_what_its_view_says(data: Path, manager: RunManager) -> None:
    beside = Comparisons(manager)
    sides = beside.checked([QUIET, BUSY])
    told = beside.told(sides, 300.0)
    assert (told["time_s"], told["end_s"]) == (300.0, 400.0)
    assert [(run["letter"], run["run"], run["label"]) for run in told["runs"]] == [
        ("A", QUIET, "planner-of-a"), ("B", BUSY, "planner-of-b"),
    ]  # fmt: skip
    for run in told["runs"]:
        view = view_of(data, run["run"])
        kpis = view.kpis(300.0)
        assert {key: run[key] for key in comparing.NUMBERS if key != "waiting_s"} == {
            key: kpis[key] for key in comparing.NUMBERS if key != "waiting_s"
        }
        assert run["waiting_s"] == pytest.approx(sum(row["waiting_s"] for row in view.fleet(300.0)))
    parting = told["parting"]
    assert parting["tick"] == parting["each"]["B"] >= COMMANDS[0][0]
    assert parting["does"]["A"] != parting["does"]["B"]
    assert f"(tick {parting['tick']}), vehicle {parting['vehicle']}: in A it " in told["parting_text"]


def test_of_equal_runs_it_says_until_when_they_are_equal(manager: RunManager) -> None:
    beside = Comparisons(manager)
    told = beside.told(beside.checked([QUIET, SHORT]), None)
    assert told["parting"] is None
    assert told["time_s"] == 200.0
    assert "the same until 00:03:20" in told["parting_text"]
    words = comparing.parting_words({"time_s": 5.0, "tick": 5, "vehicle": 1, "does": dict.fromkeys("AB", "waits")}, 9.0)
    assert words.endswith("in A and B it waits, but not for equally long.")
    does = {"A": "waits", "B": "waits", "C": "turns to 90° at (1, 2)", "D": "waits"}
    words = comparing.parting_words({"time_s": 5.0, "tick": 5, "vehicle": 1, "does": does}, 9.0)
    assert words.endswith("in A, B and D it waits; in C it turns to 90° at (1, 2).")
    assert comparing.parting_words(None, 0.0) == "Not every run has begun yet."


def test_the_curves_end_with_their_runs(data: Path, manager: RunManager) -> None:
    beside = Comparisons(manager)
    curves = beside.curves(beside.checked([BUSY, SHORT]), points=81)
    t_s, runs = curves["t_s"], curves["runs"]
    assert (t_s[0], t_s[-1], len(t_s)) == (0.0, 400.0, 81)
    view = view_of(data, BUSY)
    for k in (0, 20, 63, 80):
        at = view.kpis(t_s[k])
        assert runs["A"]["orders_done"][k] == at["orders_done"]
        assert runs["A"]["energy_j"][k] == pytest.approx(at["energy_j"])
    assert not np.isnan(runs["B"]["orders_done"][t_s <= 200]).any()
    assert np.isnan(runs["B"]["orders_done"][t_s > 200]).all()


def test_the_figure_shows_each_curve_and_what_it_is_off_the_first() -> None:
    t_s = [0.0, 60.0, 120.0]
    runs = {"A": [0, 1, 4], "B": [0, 3, 3], "C": [0, 2, np.nan]}
    figure = comparing_figure("orders", t_s, runs, parting_s=30.0, scheme="dark")
    upper, lower = ([s for s in figure.data if (s.yaxis or "y") == axis] for axis in ("y", "y2"))
    assert [scatter.name for scatter in upper] == ["A", "B", "C"]
    assert list(lower[0].y) == [0, 2, -1]
    assert np.isnan(lower[1].y[2])
    assert lower[0].line.color == upper[1].line.color
    assert [shape.x0 for shape in figure.layout.shapes] == [0.0, 30_000.0]
    empty = comparing_figure("orders", [0.0, 0.0], {"A": [0, 0]})
    assert "Nothing is recorded yet" in empty.layout.annotations[0].text


# The command line and the server


def test_the_command_prints_a_table_and_where_they_part(wattlane: Any, data: Path, manager: RunManager) -> None:
    said = wattlane("compare", QUIET, BUSY, "--data", data)
    assert said.code == 0
    beside = Comparisons(manager)
    told = beside.told(beside.checked([QUIET, BUSY]), None)
    assert told["parting_text"] in said.out
    assert "planner-of-a" in said.out
    row = next(line for line in said.out.splitlines() if "orders done" in line)
    assert [int(word) for word in row.split() if word.isdigit()][:2] == [run["orders_done"] for run in told["runs"]]


def test_the_command_writes_one_recording_and_one_json(wattlane: Any, data: Path, tmp_path: Path) -> None:
    file = tmp_path / "both.rrd"
    said = wattlane("compare", QUIET, SHORT, "--json", "--out", file, "--data", data)
    assert said.code == 0
    told = json.loads(said.out)
    assert told["file"] == str(file)
    assert told["parting"] is None
    assert [run["run"] for run in told["runs"]] == [QUIET, SHORT]
    assert file.read_bytes()[:4] == b"RRF2"


def test_the_command_refuses_with_a_sentence(wattlane: Any, data: Path) -> None:
    for runs, reason in (([QUIET, SEEDED], "the seed is 1 and 2"), ([QUIET], "got 1"), ([QUIET, "none"], "no run")):
        said = wattlane("compare", *runs, "--data", data)
        assert said.code == 2
        assert reason in said.err
        assert not said.out


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[Any]:
    from fastapi.testclient import TestClient

    from app.runs import set_manager
    from app.server import create_app

    app = create_app(Settings(data=data, scenario=None, open_browser=False))
    with TestClient(app.server, base_url="http://127.0.0.1:8050") as made:
        yield made
    app.wattlane_manager.close()
    set_manager(None)


def test_the_server_answers_for_any_moment(client: Any) -> None:
    early = client.get(f"/api/compare?runs={QUIET},{BUSY}&t=40").json()
    late = client.get(f"/api/compare?runs={QUIET},{BUSY}").json()
    assert early["time_s"] == 40
    assert late["time_s"] == 400
    assert all(a["energy_j"] < b["energy_j"] for a, b in zip(early["runs"], late["runs"], strict=True))
    made = client.get(f"/api/compare/rrd?runs={QUIET},{SHORT}")
    assert made.status_code == 200
    assert made.content[:4] == b"RRF2"


@pytest.mark.parametrize(
    ("query", "status", "words"),
    [
        ("", 400, "two to four runs were expected; got 0"),
        (f"runs={QUIET},{SEEDED}", 400, "the seed is 1 and 2"),
        (f"runs={QUIET},nobody", 404, "no run"),
        (f"runs={QUIET},../{BUSY}", 404, "no run id"),
        (f"runs={QUIET},{BUSY}&t=-1", 400, "t"),
    ],
)
def test_the_server_refuses_with_a_sentence(client: Any, query: str, status: int, words: str) -> None:
    for path in ("/api/compare", "/api/compare/rrd"):
        if "t=-1" in query and path.endswith("rrd"):
            continue
        answer = client.get(f"{path}?{query}")
        assert answer.status_code == status
        assert words in answer.json()["error"]


# Starting runs to compare


def test_what_the_form_offers_and_what_an_address_fills_in(manager: RunManager) -> None:
    offered = choices(manager, "soochow2022")
    values = [choice["value"] for choice in offered]
    assert {"prioritized:time", "prioritized:energy", "quickest:time"} <= set(values)
    assert {"value": "quickest:time", "label": "quickest"} in offered
    assert {"value": "prioritized:energy", "label": "prioritized, least energy"} in offered
    assert chosen("quickest,prioritized:energy,nobody", offered, "prioritized:time") == [
        "quickest:time", "prioritized:energy",
    ]  # fmt: skip
    assert chosen(None, offered, "quickest:time")[0] == "quickest:time"
    assert len(chosen(None, offered, "quickest:time")) == 2


def test_an_address_fills_in_everything_that_runs_need() -> None:
    runs = Beside("lian2024", ("stochastic:time", "astar-turns"), "10h", 11000, {"orders.source": "poisson", "a.b": 2})
    address = start_address(runs)
    assert address.startswith("/compare?scenario=lian2024&planners=stochastic:time,astar-turns&length=10h&seed=11000&")
    query = dict(parse_qsl(urlsplit(address).query))
    assert overrides_from(query["set"]) == runs.changes
    assert start_address(Beside("xu2025", ("cbs",))) == "/compare?scenario=xu2025&planners=cbs"


@pytest.mark.parametrize("name", ["lian2024", "xu2025"])
def test_the_rows_of_a_study_offer_runs_that_can_be_started(manager: RunManager, name: str) -> None:
    """Whatever a row asks for, planners and parameters, is known to its scenario; so are all of a study's methods."""
    found = study(name)
    record = Store(manager.settings.data).record(name, SHIPPED)
    asked = {runs for row in record["rows"] if (runs := _plain(beside(found, record, row)))}
    whole = _plain(beside(found, record))
    assert asked
    assert whole
    for scenario, planners, _, seed, changes in {*asked, whole}:
        offered = choices(manager, scenario)
        values = chosen(",".join(planners), offered, "")
        assert [value.partition(":")[0] for value in values] == [word.partition(":")[0] for word in planners]
        for word in planners:
            planner, _, objective = word.partition(":")
            asked_scenario(scenario, dict(changes), seed=seed, planner=planner, objective=objective or None)


def _plain(runs: Beside | None) -> Any:
    return runs and (*runs[:4], tuple(runs.changes.items()))


def test_a_row_asks_for_its_own_methods_length_and_parameters(manager: RunManager) -> None:
    record = Store(manager.settings.data).record("lian2024", SHIPPED)

    def runs(quantity: str, case: str) -> Beside | None:
        rows = [row for row in record["rows"] if (row["quantity"], row["case"]) == (quantity, case)]
        return beside(study("lian2024"), record, rows[0])

    both = ("stochastic:time", "astar-turns:time")
    poisson = {"orders.source": "poisson", "orders.rate_per_h": 1000}
    gain = "more orders per energy, stochastic over astar-turns"
    assert runs("more orders in 10 h", "stochastic over astar-turns") == Beside("lian2024", both, "10h", 11000)
    assert runs("energy in 2 h", "stochastic") == Beside("lian2024", both, "2h", 11000)
    assert runs(gain, "15 AGVs") == Beside("lian2024", both, "1h", 11000, {"fleet.count": 15})
    assert runs(gain, "orders: a backlog → Poisson, 1000 per h") == Beside("lian2024", both, "1h", 11000, poisson)
    assert runs(gain, "gear: 30 → 20") is None
    assert runs("skewness", "busiest lane, 20 visits") is None
    assert beside(study("soochow2022"), {}) is None


@pytest.mark.parametrize(
    ("wanted", "length", "words"),
    [
        (["quickest:time"], "1min", "two to four planners were expected; got 1"),
        (["quickest:time", "prioritized:time"], "soon", "a duration was expected"),
        (["quickest:time", "prioritized:time"], "0s", "time"),
        (["quickest:time", "nobody:time"], "1min", "nobody"),
        (["quickest:time", "aco:time"], "1min", "cont.*did you mean 'count'"),
    ],
)
def test_a_form_that_asks_for_the_impossible_starts_nothing(
    manager: RunManager, wanted: list[str], length: str, words: str
) -> None:
    before = len(manager.list())
    with pytest.raises((BadInput, ValueError), match=words):
        start(manager, "soochow2022", wanted, 1, length, "fleet.cont = 3" if "cont" in words else "")
    assert len(manager.list()) == before
