"""The library: what is kept of an import and how, what is refused in a sentence, and that nothing leaves its folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import assets
from app import cli, runner
from app.library import (
    ImportOptions,
    Library,
    NoSuchScenario,
    Upload,
    checked_files,
    checked_name,
    fleet_overrides,
    is_instance,
    slug,
    thinned,
)
from app.settings import Settings
from engine.errors import BadInput, FormatError, ScenarioError
from engine.scenario import movingai
from engine.world import build_world

MAP = "type octile\r\nheight 3\r\nwidth 5\r\nmap\r\n.....\r\n.@@G.\r\n.....\r\n"
SCEN = (
    "version 1\n"
    "0\tfloor.map\t5\t3\t0\t0\t4\t0\t4\n"
    "0\tfloor.map\t5\t3\t4\t2\t0\t2\t4\n"
    "0\tfloor.map\t5\t3\t0\t2\t3\t1\t4\n"
)
BUILT_IN = assets.path("scenarios", "soochow2022.toml").read_text("utf-8")
TOML = BUILT_IN.replace('name = "soochow2022"', 'name = "my-floor"').replace("ten orders, eight AGVs", "mine")


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "scenarios")


def toml(text: str = TOML, name: str = "floor.toml") -> list[Upload]:
    return [Upload(name, text)]


def instance(scen: str | None = SCEN) -> list[Upload]:
    files = [Upload("Small Floor.map", MAP)]
    return files if scen is None else [Upload("trips.scen", scen), *files]


# ---------------------------------------------------------------- what is kept


def test_a_toml_is_kept_byte_for_byte_and_runs_under_its_name(library: Library) -> None:
    text = TOML.replace("\n", "\r\n") + "# ünïcode\r\n"
    assert library.add(toml(text)) == "my-floor"
    assert library.files("my-floor")["my-floor.toml"].read_bytes() == text.encode()
    same = {"name": "my-floor", "title": "Soochow thesis 2022: mine"}
    assert library.load("my-floor") == library.load("soochow2022", same)
    assert library.about("my-floor")["files"] == ["floor.toml"]
    entry = library.entry("my-floor")
    assert (entry.imported, entry.instance, entry.width, entry.height, entry.fleet) == (True, False, 24, 16, 8)


def test_map_and_scen_become_an_instance_and_are_kept_as_given(library: Library) -> None:
    name = library.add(instance(), wanted=ImportOptions(agents=2, planner="cbs"))
    assert name == "small-floor"
    kept = library.files(name)
    assert kept["small-floor.map"].read_bytes() == MAP.encode()
    assert kept["trips.scen"].read_bytes() == SCEN.encode()
    scenario = library.load(name)
    assert is_instance(scenario)
    assert scenario.planner.name == "cbs"
    # a file's rows count from the top, ours from the bottom
    assert scenario.fleet.start == ((0, 2), (4, 0))
    assert scenario.orders.goals == ((4, 2), (0, 0))
    assert library.floor(name)["trips"] == [[0.5, 2.5, 4.5, 2.5], [4.5, 0.5, 0.5, 0.5]]
    assert library.floor(name)["cells"] == [".....", ".##..", "....."]
    assert {f["level"] for f in library.findings(name)} == {"ok"}


def test_a_map_alone_gets_seeded_random_trips(library: Library) -> None:
    def trips(seed: int) -> Any:
        return library.look(instance(None), ImportOptions(agents=4, seed=seed))["trips"]

    assert trips(3) == trips(3)
    assert any(trips(3) != trips(seed) for seed in (4, 5, 6))
    name = library.add(instance(None), wanted=ImportOptions(agents=4, seed=3))
    assert library.floor(name)["trips"] == trips(3)
    assert library.about(name)["random_seed"] == 3
    scenario = library.load(name)
    free = movingai.parse_map(MAP)
    for cells in (scenario.fleet.start, scenario.orders.goals):
        assert len(set(cells)) == 4
        assert all(free[y, x] for x, y in cells)


def test_what_was_looked_at_is_what_is_kept(library: Library) -> None:
    wanted = ImportOptions(agents=3, planner="ecbs")
    seen = library.look(instance(), wanted)
    assert library.names() == library.built_in(), "looking keeps nothing"
    assert seen["most"] == 3
    assert seen["objective"] == "energy", "ecbs has no other"
    assert seen["planners"]["cbs"] == ["time"]
    assert "cbs" not in library.look(toml())["planners"], "it doesn't serve orders"
    name = library.add(instance(), seen["name"], wanted)
    floor = library.floor(name)
    assert (floor["cells"], floor["trips"]) == (list(seen["floor"]["cells"]), seen["trips"])
    assert library.entry(name).planner == "ecbs"


def test_planners_offered_are_those_that_build(library: Library) -> None:
    from engine.build import build

    name = library.add(instance())
    offered = library.planners(name)
    assert {"cbs", "ecbs", "time-window", "prioritized"} <= offered.keys()
    assert "cbs" not in library.planners("soochow2022")
    for planner in library.planners("soochow2022"):
        assert build(library.load("soochow2022", {"planner.name": planner})).tick == 0


def test_renaming_moves_and_deleting_removes_all(library: Library) -> None:
    name = library.add(instance())
    assert library.rename(name, "other") == "other"
    assert name not in library
    assert library.load("other").name == "other", "runs go by the new name"
    assert set(library.files("other")) == {"other.toml", "small-floor.map", "trips.scen"}
    library.delete("other")
    assert list(library.root.iterdir()) == []
    with pytest.raises(NoSuchScenario, match="unknown scenario 'other'"):
        library.file("other")


def test_a_fleet_of_fewer_takes_the_first_vehicles(library: Library) -> None:
    name = library.add(instance())
    scenario = library.load(name)
    fewer = library.load(name, fleet_overrides(scenario, 2))
    assert (fewer.fleet.count, fewer.fleet.start) == (2, scenario.fleet.start[:2])
    assert fewer.orders.goals == scenario.orders.goals[:2]
    assert fleet_overrides(scenario, 3) == {}
    for count in (0, 4):
        with pytest.raises(BadInput, match="1 to 3 were expected"):
            fleet_overrides(scenario, count)
    assert fleet_overrides(library.load("soochow2022"), 5) == {"fleet.count": 5}


def test_a_file_that_was_changed_by_hand_is_read_again(library: Library) -> None:
    library.add(toml())
    assert library.entry("my-floor").fleet == 8
    file = library.file("my-floor")
    file.write_text(TOML.replace("count = 8", "count = 11"))
    assert library.entry("my-floor").fleet == 11
    file.write_text(TOML.replace("count = 8", "count = -1"))
    assert "fleet.count: got -1" in library.entry("my-floor").error
    assert "my-floor" not in library.titles(), "what can't be read can't be started"
    file.write_bytes(b"name = '\xff'")
    assert "UTF-8" in library.entry("my-floor").error
    library.delete("my-floor")


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ([], "got no file"),
        ([Upload("a.pdf", "x")], "a.pdf: one .toml file, or one .map"),
        ([Upload("a.scen", SCEN)], "needs its .map"),
        ([Upload("a.toml", TOML), Upload("b.toml", TOML)], "got a.toml, b.toml"),
        ([Upload("a.toml", TOML), Upload("b.map", MAP)], "got a.toml, b.map"),
        ([Upload("a.toml", "\0")], "binary"),
        ([Upload("a.toml", "\ud800")], "UTF-8"),
        ([Upload("a.toml", "#" * (7 * 2**20))], "at most 6 MB; got 7.0 MB"),
    ],
)
def test_files_that_make_no_scenario_are_refused_in_a_sentence(files: list[Upload], sentence: str) -> None:
    with pytest.raises(BadInput, match=sentence):
        checked_files(files)


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        (toml(TOML.replace("count = 8", 'count = "eight"')), 'floor.toml, line 50: fleet.count: got "eight"'),
        (toml(TOML.replace("[fleet]", "[flete]")), "did you mean 'fleet'"),
        (toml(TOML + '[planner]\nname = "prioritised"\n'), "did you mean 'prioritized'"),
        (toml(TOML + '[planner]\nname = "cbs"\n'), "planner.name: 'cbs'"),
        (toml("x = ["), "malformed TOML"),
        ([Upload("s.map", MAP.replace("G", "?"))], "s.map, line 6: column 4"),
        (instance(SCEN.replace("\t4\t2\t0\t2", "\t2\t1\t0\t2")), "trips.scen, line 3: start \\(2, 1\\) is blocked"),
        (instance("version 2\n"), "trips.scen, line 1: 'version 1' was expected"),
    ],
)
def test_errors_name_file_and_line(library: Library, files: list[Upload], sentence: str) -> None:
    for act in (library.look, library.add):
        with pytest.raises((ScenarioError, FormatError), match=sentence):
            act(files)
    assert not library.root.exists(), "nothing is kept of what was refused"


@pytest.mark.parametrize("agents", [0, -3, 4, 10**9])
def test_as_many_vehicles_as_there_are_rows(library: Library, agents: int) -> None:
    with pytest.raises(BadInput, match="vehicles: 1 to 3 were expected"):
        library.add(instance(), wanted=ImportOptions(agents=agents))
    with pytest.raises(BadInput):
        library.add(instance(None), wanted=ImportOptions(agents=agents if agents != 4 else 14))


BAD_NAMES = [
    "",
    "..",
    "../x",
    "a/b",
    "a\\b",
    "/etc/passwd",
    "A",
    "a b",
    ".a",
    "a..b",
    "x.toml",
    "a\0b",
    "é",
    "a" * 81,
    None,
    7,
]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_could_lead_elsewhere_are_refused(library: Library, name: Any) -> None:
    with pytest.raises(BadInput):
        checked_name(name)
    library.add(toml(), "mine")
    with pytest.raises(BadInput):
        library.rename("mine", name)
    for act in (library.file, library.delete, library.load):
        with pytest.raises(NoSuchScenario):
            act(name)
    assert library.imported() == ["mine"]


@given(st.text())
def test_every_text_has_a_name_near_it(text: str) -> None:
    name = slug(text)
    assert checked_name(name) == name
    assert slug(name) == name


def test_taken_names_are_refused_and_a_free_one_is_named(library: Library) -> None:
    library.add(toml())
    for name in ("my-floor", "soochow2022"):
        with pytest.raises(BadInput, match=f"'{name}' already; '{name}-2' is free"):
            library.add(toml(), name)
    assert library.look(toml())["name"] == "my-floor-2"
    library.add(toml(), "second")
    with pytest.raises(BadInput, match="already"):
        library.rename("second", "my-floor")
    assert library.imported() == ["my-floor", "second"]


def test_built_in_scenarios_can_be_neither_renamed_nor_deleted(library: Library) -> None:
    for act in (lambda: library.delete("soochow2022"), lambda: library.rename("soochow2022", "x")):
        with pytest.raises(BadInput, match="came with the program"):
            act()
    assert "soochow2022" in library


def test_links_are_not_followed(library: Library, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "scenario.toml").write_text(TOML)
    library.root.mkdir()
    (library.root / "linked").symlink_to(outside)
    inner = library.root / "inner"
    inner.mkdir()
    (inner / "scenario.toml").symlink_to(outside / "scenario.toml")
    assert library.imported() == []
    with pytest.raises(NoSuchScenario):
        library.delete("linked")
    assert (outside / "scenario.toml").is_file()


def test_file_names_lead_nowhere(library: Library) -> None:
    files = [Upload("../../evil.map", MAP), Upload("/x/../y/é.scen", SCEN)]
    name = library.add(files, "safe")
    inside = {f.name for f in (library.root / name).iterdir()}
    assert inside == {"scenario.toml", "import.json", "evil.map", "floor.scen"}
    assert [f.name for f in library.root.iterdir()] == ["safe"]


def test_an_uploaded_toml_names_no_file_of_the_server(library: Library) -> None:
    with pytest.raises(ScenarioError):
        library.add(toml(TOML.replace('kind = "drawing"', 'kind = "movingai"\nmap = "../../secret.map"')))


# ---------------------------------------------------------------- pictures


@given(st.integers(1, 700), st.integers(1, 700))
def test_a_small_preview_is_small(width: int, height: int) -> None:
    rows = tuple("#" * width for _ in range(height))
    small = thinned(rows)
    assert max(small["width"], small["height"]) <= 160
    assert (len(small["cells"]), len(small["cells"][0])) == (small["height"], small["width"])


def test_a_network_is_drawn_from_nodes_and_arcs(library: Library) -> None:
    entry = library.entry("lian2024")
    assert (entry.size, entry.width, entry.height) == ("112 nodes, 202 arcs", 0, 0)
    assert library.look(toml(library.raw_text("lian2024")))["size"] == entry.size
    small = library.thumb("lian2024")
    assert (len(small["nodes"]), len(small["arcs"])) == (112, 202)
    assert all(0 < x < small["width"] and 0 < y < small["height"] for x, y, _ in small["nodes"])
    assert library.floor("lian2024")["kind"] == "network"
    assert not [f for f in library.findings("lian2024") if f["level"] != "ok"]
    assert "astar" not in library.planners("lian2024")


def test_a_preview_has_every_place_that_the_world_has(library: Library) -> None:
    name = library.add(instance())
    scenario = library.load(name)
    assert library.floor(name)["cells"] == build_world(scenario).floor_json()["cells"]
    assert library.look(instance())["floor"]["cells"] == tuple(build_world(scenario).floor_json()["cells"])


def test_findings_stand_where_they_are_about(library: Library) -> None:
    wrong = TOML.replace("Iv^SSSv^SSSv^SSSv^SSSv^#\n#v^SRS", "I#^SSSv^SSSv^SSSv^SSSv^#\n#v^SRS", 1)
    name = library.add(toml(wrong))
    error = next(f for f in library.findings(name) if f["level"] == "error")
    assert "I2 at (0, 8) has no aisle cell" in error["text"]
    assert (error["x"], error["y"]) == (0.5, 8.5)
    assert build_world(library.load(name)).place_name(error["place"]).startswith("I2")


# ---------------------------------------------------------------- the routes


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Any]:
    """A client of a dashboard of its own, as a browser on this machine would be."""
    from fastapi.testclient import TestClient

    from app import runs
    from app.server import create_app

    before = runs._manager
    app = create_app(Settings(data=tmp_path, scenario=None, open_browser=False))
    with TestClient(app.server, base_url="http://127.0.0.1:8050") as made:
        yield made
    app.wattlane_manager.close()
    runs.set_manager(before)


def sent(files: list[Upload], **more: Any) -> dict[str, Any]:
    return {"files": [{"name": f.name, "text": f.text} for f in files], **more}


def test_import_look_rename_delete_over_http(client: Any) -> None:
    seen = client.post("/api/scenarios/preview", json=sent(instance(), agents=2)).json()
    assert (seen["kind"], seen["fleet"], seen["most"]) == ("instance", 2, 3)
    made = client.post("/api/scenarios", json=sent(instance(), agents=2, planner="prioritized", name="mine"))
    assert (made.status_code, made.json()) == (201, {"name": "mine"})
    listed = client.get("/api/scenarios").json()
    assert listed["imported"] == ["mine"]
    assert {"mine", "soochow2022"} <= listed["scenarios"].keys()
    assert len(client.get("/api/scenarios/mine/floor").json()["trips"]) == 2
    assert client.get("/api/scenarios/mine/thumb").json()["width"] == 5
    assert client.get("/api/scenarios/mine/checks").json()["findings"][0]["level"] == "ok"
    file = client.get("/api/scenarios/mine/files/small-floor.map")
    assert file.content == MAP.encode()
    assert "attachment" in file.headers["content-disposition"]
    assert client.get("/scenarios?scenario=mine").status_code == 200
    assert client.patch("/api/scenarios/mine", json={"name": "yours"}).json() == {"name": "yours"}
    assert client.delete("/api/scenarios/yours").status_code == 200
    assert client.get("/api/scenarios").json()["imported"] == []


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({}, "files: a list"),
        ({"files": "x"}, "files: a list"),
        ({"files": [3]}, "files: a list"),
        ({"files": [{"name": 3, "text": ""}]}, "name: a text"),
        ({"files": [], "colour": 1}, "unknown key 'colour'"),
        (sent(toml(), agents="many"), "agents: a whole number"),
        (sent(toml(), seed=-1), "seed: zero or more"),
        (sent(toml(), name="../up"), "name: lower-case letters"),
    ],
)
def test_malformed_imports_are_answered_with_a_sentence(client: Any, body: dict[str, Any], sentence: str) -> None:
    answer = client.post("/api/scenarios", json=body)
    assert answer.status_code == 400
    assert sentence in answer.json()["error"]


def test_an_import_of_fifty_megabytes_is_refused_and_the_server_lives(client: Any, tmp_path: Path) -> None:
    huge = json.dumps(sent([Upload("huge.map", "." * (50 * 2**20))])).encode()
    answer = client.post("/api/scenarios", content=huge, headers={"content-type": "application/json"})
    assert answer.status_code == 413
    assert answer.json() == {"error": "a request may carry at most 8 MB"}
    assert client.get("/healthz").json()["status"] == "ok"
    assert not (tmp_path / "scenarios").exists()


def test_other_sites_may_import_and_delete_nothing(client: Any) -> None:
    client.post("/api/scenarios", json=sent(toml()))
    for headers in ({"origin": "http://evil.example"}, {"sec-fetch-site": "cross-site"}, {"host": "evil.example"}):
        for method, path in (("POST", "/api/scenarios"), ("DELETE", "/api/scenarios/my-floor")):
            answer = client.request(method, path, headers=headers, json=sent(toml(), name="theirs"))
            assert answer.status_code in (400, 403)
    assert client.get("/api/scenarios").json()["imported"] == ["my-floor"]


@pytest.mark.parametrize("name", ["..", "../runs", "%2e%2e", "nope", "a/b", "\0", "import.json"])
def test_unknown_scenarios_and_files_are_404(client: Any, name: str) -> None:
    for path in ("floor", "thumb", "checks", "files/x.toml"):
        assert client.get(f"/api/scenarios/{quote(name, safe='')}/{path}").status_code == 404
    assert client.get(f"/api/scenarios/soochow2022/files/{quote(name, safe='')}").status_code == 404
    assert client.delete(f"/api/scenarios/{quote(name, safe='')}").status_code in (404, 405)


# ---------------------------------------------------------------- the command line


def test_the_command_line_finds_imported_scenarios_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("WATTLANE_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    library = Library(tmp_path / "scenarios")
    library.add(toml(), "mine")
    assert cli.main(["validate", "mine"]) == 0
    assert "mine is valid" in capsys.readouterr().out
    assert cli.main(["validate", "mien"]) == 2
    assert "did you mean 'mine'" in capsys.readouterr().err
    assert runner.asked_scenario("mine", {"seed": 5}, library=library).seed == 5


def test_a_path_stays_a_path(tmp_path: Path, library: Library) -> None:
    file = tmp_path / "elsewhere.toml"
    file.write_text(TOML)
    assert runner.asked_scenario(str(file), {}, library=library).name == "my-floor"
    with pytest.raises(ScenarioError, match="there is no such file"):
        runner.asked_scenario("missing.toml", {}, library=library)


def test_random_trips_lie_in_the_largest_part() -> None:
    free = movingai.parse_map("type octile\nheight 3\nwidth 4\nmap\n..@.\n..@.\n..@.\n")
    made = movingai.random_trips(np.random.default_rng(1), free, 6)
    assert {x for x, _ in made.starts + made.goals} == {0, 1}
    with pytest.raises(FormatError, match="7 vehicles don't fit into 6 connected cells"):
        movingai.random_trips(np.random.default_rng(1), free, 7)
