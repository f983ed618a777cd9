"""`wattlane solve` and plan files: answers, files, and how bad input is refused."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app import solving
from engine.planners.constraint_tree import paths_of
from tests.app.said import refused

KEYS = [
    "map", "scen", "agents", "planner", "objective", "status", "cost", "lower_bound", "energy_j", "makespan",
    "expanded_high", "expanded_low", "cpu_ms", "breaches",
]  # fmt: skip
MAP = """type octile
height 4
width 5
map
.....
.@.@.
..S..
@...W
"""
TRIPS = [(0, 0, 4, 0), (4, 0, 0, 0), (0, 2, 4, 2), (4, 2, 0, 2)]
# from (0, 0) to (2, 2), upside down: counted by the cell alone, the way of three turns looks cheaper
TRAP = "type octile\nheight 3\nwidth 3\nmap\n.@.\n...\n..@\n"


def scen(trips: list[tuple[int, ...]], width: int, height: int) -> str:
    rows = ["\t".join(map(str, (0, "x.map", width, height, *trip, 0))) for trip in trips]
    return "\r\n".join(["version 1", *rows, ""])


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    floor, trips = tmp_path / "small.map", tmp_path / "small.scen"
    floor.write_text(MAP.replace("\n", "\r\n"))
    trips.write_text(scen(TRIPS, 5, 4))
    return floor, trips


@pytest.mark.parametrize(
    ("planner", "objective"),
    [
        ("cbs", "time"),
        ("ecbs", "energy"),
        ("time-window", "energy"),
        ("prioritized", "time"),
        ("prioritized", "energy"),
    ],
)
def test_every_planner_answers_and_is_judged(
    wattlane: Any, files: tuple[Path, Path], tmp_path: Path, planner: str, objective: str
) -> None:
    out = tmp_path / "plan.json"
    arguments = ("--planner", planner, "--objective", objective, "--agents", 3, "--mass", "2000,2500", "--out", out)
    said = wattlane("solve", *files, *arguments, "--json")
    assert said.code == 0
    answer = said.json
    assert list(answer) == KEYS
    assert (answer["agents"], answer["objective"], answer["status"]) == (3, objective, "solved")
    assert answer["lower_bound"] <= answer["cost"]
    assert answer["breaches"] == 0
    plan = json.loads(out.read_text())
    assert [v["mass_kg"] for v in plan["vehicles"]] == [2000, 2500, 2000]
    assert sum(v["energy_mj"] for v in plan["vehicles"]) == pytest.approx(1000 * answer["energy_j"])
    assert answer["makespan"] == max(len(v["path"]) for v in plan["vehicles"]) - 1
    if objective == "time":
        assert answer["cost"] == sum(len(v["path"]) - 1 for v in plan["vehicles"])
    else:
        assert answer["cost"] == pytest.approx(1000 * answer["energy_j"])
    for vehicle, (x, y, x2, y2) in zip(plan["vehicles"], TRIPS, strict=False):
        assert (vehicle["path"][0], vehicle["path"][-1]) == ([x, y], [x2, y2])
        assert all(plan["rows"][y][x] == "." for x, y in vehicle["path"])
    assert "legal" in wattlane("judge", out).out


def test_one_vehicle_pays_for_the_papers_shortcut(wattlane: Any, tmp_path: Path) -> None:
    floor, trips = tmp_path / "trap.map", tmp_path / "trap.scen"
    floor.write_text(TRAP)
    trips.write_text(scen([(0, 2, 2, 0)], 3, 3))
    exact = wattlane("solve", floor, trips, "--planner", "eea", "--json").json
    literal = [
        "--set",
        "variant=literal-cell",
        "--set",
        "heuristic=paper",
        "--set",
        "tie=fifo",
        "--out",
        tmp_path / "p",
    ]
    paper = wattlane("solve", floor, trips, "--planner", "eea", *literal, "--json").json
    assert exact["energy_j"] == pytest.approx(1432.9, abs=0.2)
    assert paper["energy_j"] == pytest.approx(1643.3, abs=0.3)
    assert paper["lower_bound"] == exact["cost"] == exact["lower_bound"]
    assert wattlane("judge", tmp_path / "p").code == 0
    for tie in ("fifo", "lifo", "larger-g", "random"):
        said = wattlane("solve", floor, trips, "--planner", "astar", "--set", f"tie={tie}", "--json")
        assert (said.json["cost"], said.json["breaches"]) == (4, 0)


def test_a_summary_for_a_person(wattlane: Any, files: tuple[Path, Path]) -> None:
    said = wattlane("solve", *files, "--planner", "time-window", "--agents", 2)
    assert said.code == 0
    for words in ("2 vehicles", "% above the optimum", "no plan below", " J", "legal"):
        assert words in said.out
    assert "proven optimal" in wattlane("solve", *files, "--planner", "cbs", "--agents", 2).out


def test_traces_are_written(wattlane: Any, files: tuple[Path, Path], tmp_path: Path) -> None:
    for name in ("tree.json", "tree.npz"):
        file = tmp_path / name
        arguments = ("--planner", "ecbs", "--set", "tries=0", "--agents", 4, "--trace", file)
        assert wattlane("solve", *files, *arguments).code == 0
        if file.suffix == ".json":
            tables = {t: {c: np.array(v) for c, v in cs.items()} for t, cs in json.loads(file.read_text()).items()}
        else:
            arrays = np.load(file, allow_pickle=False)
            tables = {}
            for key in arrays.files:
                table, _, column = key.partition("/")
                tables.setdefault(table, {})[column] = arrays[key]
        tree = tables["tree"]
        assert tree["parent"][0] == -1
        assert len(paths_of(tables, int(tree["node"][-1]))) == 4
    file = tmp_path / "search.json"
    wattlane("solve", *files, "--planner", "eea", "--agents", 1, "--trace", file)
    rows = json.loads(file.read_text())["expansions"]
    assert set(rows) == {"order", "node", "parent", "g", "h", "f", "open"}
    assert rows["order"] == list(range(len(rows["node"])))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--planner", "cbss"], ["cbss", "did you mean"]),
        (["--planner", "cbs", "--objective", "energy"], ["cbs minimises time", "ecbs"]),
        (["--planner", "ecbs", "--objective", "fun"], ["objective", "fun"]),
        (["--planner", "time-window", "--w", "1.2"], ["--w", "cbs and ecbs"]),
        (["--planner", "cbs", "--w", "0.9"], ["--w", "at least 1", "0.9"]),
        (["--planner", "cbs", "--w", "nan"], ["--w", "at least 1", "nan"]),
        (["--planner", "cbs", "--agents", "9"], ["9 vehicles", "4 rows"]),
        (["--planner", "cbs", "--agents", "0"], ["--agents"]),
        (["--planner", "astar"], ["one vehicle", "--agents 1"]),
        (["--planner", "cbs", "--mass", "heavy"], ["--mass", "heavy"]),
        (["--planner", "cbs", "--mass", "-1"], ["--mass", "above 0"]),
        (["--planner", "cbs", "--energy", "nu=1"], ["nu", "'mu'"]),
        (["--planner", "cbs", "--energy", "mu=x"], ["mu", "'x'"]),
        (["--planner", "cbs", "--set", "tris=1"], ["tris", "'tries'"]),
        (["--planner", "cbs", "--set", "disjoint=maybe"], ["disjoint", "true or false"]),
        (["--planner", "cbs", "--set", "tries"], ["key=value"]),
        (["--planner", "cbs", "--heading", "up"], ["heading", "up"]),
        (["--planner", "cbs", "--trace", "tree.csv"], [".json or .npz", "tree.csv"]),
        (["--planner", "cbs", "--time-limit", "soon"], ["soon", "8h"]),
        (["--planner", "cbs", "--out", "no-such-folder/plan.json"], ["--out", "no-such-folder doesn't exist"]),
        (["--planner", "ecbs", "--energy", "mu=-1"], ["--energy mu", "a number above 0", "'-1'"]),
    ],
)
def test_bad_input_is_one_sentence(
    wattlane: Any, files: tuple[Path, Path], arguments: list[str], words: list[str]
) -> None:
    refused(wattlane("solve", *files, *arguments), *words)


def test_bad_files_are_named_with_their_lines(wattlane: Any, files: tuple[Path, Path], tmp_path: Path) -> None:
    floor, trips = files
    refused(wattlane("solve", tmp_path / "no.map", trips, "--planner", "cbs"), "no.map")
    (tmp_path / "bad.map").write_text(MAP.replace("S", "?"))
    refused(wattlane("solve", tmp_path / "bad.map", trips, "--planner", "cbs"), "line 7", "'?'")
    (tmp_path / "bad.scen").write_text(scen([(0, 0, 1, 1)], 5, 4))
    refused(wattlane("solve", floor, tmp_path / "bad.scen", "--planner", "cbs"), "line 2", "blocked")


def test_no_path_is_an_answer(wattlane: Any, tmp_path: Path) -> None:
    floor, trips, out = tmp_path / "wall.map", tmp_path / "wall.scen", tmp_path / "plan.json"
    floor.write_text("height 1\nwidth 3\nmap\n.@.\n")
    trips.write_text(scen([(0, 0, 2, 0)], 3, 1))
    for planner in ("cbs", "ecbs", "prioritized", "time-window", "astar", "eea"):
        said = wattlane("solve", floor, trips, "--planner", planner, "--out", out, "--json")
        assert said.code == 0
        assert (said.json["status"], said.json["cost"], said.json["breaches"]) == ("no path", None, 0)
        assert "no plan" in said.err
        assert not out.exists()


def test_the_time_limit_ends_a_search_without_end(tmp_path: Path) -> None:
    """Two vehicles that can't pass each other: the tree has no end, the clock has."""
    floor, trips = tmp_path / "aisle.map", tmp_path / "aisle.scen"
    floor.write_text("height 1\nwidth 4\nmap\n....\n")
    trips.write_text(scen([(0, 0, 3, 0), (3, 0, 0, 0)], 4, 1))
    ticking = count()
    for planner in ("cbs", "ecbs"):
        asked = solving.Asked(floor, trips, planner, time_limit_s=3.0, parameters={"target": "no"})
        answer = solving.solve(asked, solving.read(asked), clock=lambda: float(next(ticking)))
        assert answer.summary["status"] == "budget spent"
        assert answer.summary["lower_bound"] > 0
        assert "no plan below" in solving.summary_text(answer, [])


def altered(plan: dict[str, Any], where: str, value: Any) -> str:
    """The plan's text with one value replaced, or dropped where the value is Ellipsis."""
    plan = json.loads(json.dumps(plan))
    at: Any = plan
    *path, last = [int(part) if part.isdigit() else part for part in where.split(".")]
    for part in path:
        at = at[part]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return json.dumps(plan)


@pytest.fixture
def plan(wattlane: Any, files: tuple[Path, Path], tmp_path: Path) -> dict[str, Any]:
    out = tmp_path / "plan.json"
    wattlane("solve", *files, "--planner", "ecbs", "--agents", 2, "--out", out)
    found: dict[str, Any] = json.loads(out.read_text())
    return found


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        ("format", "wattlane plan 2", ["not a plan file", "wattlane plan 1"]),
        ("format", ..., ["not a plan file", "wattlane plan 1"]),
        ("vehicles", ..., ["vehicles", "missing"]),
        ("vehicles", [], ["vehicles"]),
        ("vehicles.0.path", [], ["vehicles[0].path"]),
        ("vehicles.0.path.1", [1], ["vehicles[0].path[1]"]),
        ("vehicles.0.path.1", [1, "a"], ["vehicles[0].path[1][1]", "'a'"]),
        ("vehicles.0.heading", "up", ["vehicles[0].heading", "'up'"]),
        ("vehicles.0.mass_kg", -1, ["mass_kg", "greater than 0"]),
        ("vehicles.0.goal", [1, 1], ["vehicles[0].goal", "[1, 1]"]),
        ("vehicles.0.goal", [99, 0], ["vehicles[0].goal", "[99, 0]"]),
        ("vehicles.0.colour", "red", ["colour", "no such field"]),
        ("rows.1", "...", ["rows", "5 cells"]),
        ("rows.1", ".#.@.", ["'#'"]),
        ("energy.mu", ..., ["'mu' is missing"]),
        ("energy.nu", 1.0, ["'nu'", "'mu'"]),
        ("cost", 1.5, ["cost", "1.5"]),
        ("objective", "joy", ["objective", "'joy'"]),
    ],
)
def test_malformed_plans_are_refused(
    wattlane: Any, plan: dict[str, Any], tmp_path: Path, where: str, value: Any, words: list[str]
) -> None:
    file = tmp_path / "altered.json"
    file.write_text(altered(plan, where, value))
    refused(wattlane("judge", file), "altered.json", *words)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", "[" * 5000, '{"a": 1}', "map\n...\n", "\x00\xff"])
def test_other_files_are_no_plans(wattlane: Any, tmp_path: Path, text: str) -> None:
    file = tmp_path / "other.txt"
    file.write_bytes(text.encode("latin-1"))
    refused(wattlane("judge", file), "other.txt", "plan file")


@pytest.mark.parametrize(
    ("where", "value", "kind"),
    [
        ("vehicles.0.energy_mj", 1, "energy"),
        ("cost", 1, "energy"),
        ("vehicles.0.path.1", [9, 9], "obstacle"),
        ("vehicles.0.path.1", [1, 1], "obstacle"),
        ("vehicles.0.path.1", [4, 2], "edge"),
        ("vehicles.0.start", [2, 0], "goal"),
        ("vehicles.0.goal", [2, 0], "goal"),
        ("vehicles.0.mass_kg", 999.0, "energy"),
        ("energy.standby_w", 31.0, "energy"),
    ],
)
def test_the_judge_finds_what_is_wrong(
    wattlane: Any, plan: dict[str, Any], tmp_path: Path, where: str, value: Any, kind: str
) -> None:
    file = tmp_path / "altered.json"
    file.write_text(altered(plan, where, value))
    said = wattlane("judge", file, "--json")
    assert said.code == 1
    assert kind in {breach["kind"] for breach in said.json["breaches"]}
    assert "breaches" in wattlane("judge", file).out


def test_the_judge_finds_collisions_and_wrong_sums_of_time(
    wattlane: Any, files: tuple[Path, Path], tmp_path: Path
) -> None:
    out = tmp_path / "plan.json"
    wattlane("solve", *files, "--planner", "cbs", "--agents", 2, "--out", out)
    plan = json.loads(out.read_text())
    for vehicle, xs in zip(plan["vehicles"], (range(5), range(4, -1, -1)), strict=True):
        vehicle["path"] = [[x, 0] for x in xs]
    out.write_text(json.dumps(plan))
    kinds = {breach["kind"] for breach in wattlane("judge", out, "--json").json["breaches"]}
    assert {"vertex", "duration"} <= kinds
