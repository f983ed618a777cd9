"""Scenarios: reading and writing, one clear sentence per problem, the library, and the checks on load."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from engine import scenario as room
from engine.energy.xu2025 import Xu2025
from engine.errors import ScenarioError
from engine.scenario import Scenario, from_dict, library, load, parameters, parse, start_places
from engine.scenario.checks import Finding, check, leg_energy_j, longest_order, order_pairs, place_graph, require
from engine.scenario.toml_text import lines_of, nearest_line
from engine.world import build_world

SMALL = '''name = "small"
title = "Small"

[time]
finish = "orders done"

[floor]
rows = """
#I#O#
#...#
R...R
C...P
"""

[fleet]
count = 2

[orders]
source = "listed"
pairs = [
  [1, 2],
  [3, 4],
]
'''


def said(text: str, overrides: dict[str, object] | None = None) -> list[str]:
    """Lines of the error that a text earns."""
    with pytest.raises(ScenarioError) as caught:
        parse(text, "mine.toml", overrides)
    return str(caught.value).splitlines()


def line_of(text: str, needle: str) -> int:
    """Line on which a piece of text stands, from 1."""
    return text[: text.index(needle)].count("\n") + 1


# ---------------------------------------------------------------- reading


def test_a_small_scenario_reads_with_its_defaults() -> None:
    small = parse(SMALL)
    assert (small.name, small.title, small.seed, small.paper) == ("small", "Small", 1, "")
    assert small.time.tick_s == 1.0
    assert small.time.until_s is None
    assert small.orders.pairs == ((1, 2), (3, 4))
    assert (small.charging.critical, small.charging.good, small.charging.sufficient) == (0.15, 0.3, 0.8)
    assert (small.log.sample_s, small.log.keyframe_s) == (10.0, 300.0)
    assert build_world(small).n_places == 15


def test_a_scenario_is_frozen() -> None:
    small = parse(SMALL)
    with pytest.raises(ValidationError, match="frozen"):
        small.seed = 2  # type: ignore[misc]
    with pytest.raises(ValidationError, match="frozen"):
        small.fleet.count = 3  # type: ignore[misc]


def test_carriage_returns_and_numbers_without_a_point_are_fine() -> None:
    text = SMALL.replace("[fleet]", "[service]\npick_s = 3\n[fleet]").replace("\n", "\r\n")
    assert parse(text).service.pick_s == 3.0


@pytest.mark.parametrize(
    ("old", "new", "at", "sentence"),
    [
        ("count = 2", 'count = "many"', "count", 'fleet.count: got "many", expected a whole number'),
        ("count = 2", "count = 0", "count", "fleet.count: got 0, expected at least 1"),
        ("count = 2", "count = true", "count", "fleet.count: got true, expected a whole number"),
        ("count = 2", "count = 2.5", "count", "fleet.count: got 2.5, expected a whole number"),
        ("count = 2", "coutn = 2", "coutn", "fleet.coutn: unknown key 'coutn'; did you mean 'count'?"),
        ("count = 2", "", "[fleet]", "fleet.count: this key is missing and has no default"),
        (
            "count = 2",
            "count = 2\ntick_s = 1",
            "tick_s",
            "fleet.tick_s: unknown key 'tick_s'; it belongs to [time]",
        ),
        ("[fleet]", "[flet]\n[fleet]", "[flet]", "flet: unknown key 'flet'; did you mean 'fleet'?"),
        ('title = "Small"', "", "name", "title: this key is missing and has no default"),
        ('name = "small"', 'name = "Not So"', "name", 'name: got "Not So", expected text like ^[a-z0-9][a-z0-9._-]*$'),
        ('title = "Small"', "title = 7", "title", "title: got 7, expected text"),
        ('title = "Small"', 'title = ""', "title", 'title: got "", expected at least 1 characters'),
        (
            '"orders done"',
            '"orders don"',
            "finish",
            "time.finish: got \"orders don\", expected 'never', 'orders done', 'orders done and home' or "
            "'goals reached'; did you mean 'orders done'?",
        ),
        ("[fleet]", "[fleet]\nmass_kg = inf", "mass_kg", "fleet.mass_kg: got Infinity, expected a finite number"),
        ("[fleet]", "[fleet]\nmass_kg = 0", "mass_kg", "fleet.mass_kg: got 0, expected more than 0"),
        ("[fleet]", "[charging]\nfull = 2\n[fleet]", "full", "charging.full: got 2, expected at most 1"),
        ("[fleet]", "energy = 3\n[fleet]", "energy", "floor.energy: unknown key 'energy'"),
        ("[3, 4]", "[3, 5]", "[3, 5]", "orders.pairs, item 2: unknown station 5; the floor has stations 1 to 4"),
        ("[3, 4]", "[3, 0]", "[3, 0]", "orders.pairs, item 2, item 2: got 0, expected at least 1"),
        ("[3, 4]", "[3]", "[3]", "orders.pairs, item 2, item 2: this element is missing"),
        ("[3, 4]", "[3, 4, 1]", "[3, 4, 1]", "orders.pairs, item 2: got [3, 4, 1], expected at most 2 elements"),
        ("[3, 4]", "3", "3,\n]", "orders.pairs, item 2: got 3, expected a list"),
        ("R...R", "R.X.R", "R.X.R", "floor.rows: row 3, column 3: unknown letter 'X'"),
        ("R...R", "R..R", "R..R", "floor.rows: row 3 has 4 cells, expected 5 as in row 1"),
        (
            "[fleet]",
            '[floor.access]\nR3 = "north"\n[fleet]',
            "R3",
            "floor.access.R3: there is no aisle cell north of (0, 1); there is one east",
        ),
        ("[fleet]", '[floor.access]\nR33 = "east"\n[fleet]', "R33", "unknown endpoint 'R33'; did you mean 'R3'?"),
        ("[fleet]", '[floor.access]\nR3 = "up"\n[fleet]', "R3", "expected 'south', 'north', 'west' or 'east'"),
        ("count = 2", 'count = 2\nstart = "chargrs"', "start", "'parking' or a list; did you mean 'chargers'?"),
        ("count = 2", "count = 2\nstart = [[1, 1]]", "start", "fleet.start: got 1 cells for 2 vehicles"),
        (
            "count = 2",
            "count = 2\nstart = [[1, 1], [0, 3]]",
            "start",
            "fleet.start, item 2: (0, 3) is a wall; a vehicle can't be there",
        ),
        ("count = 2", "count = 2\nstart = [[1, 1], [1, 1]]", "start", "fleet.start, item 2: (1, 1) is taken twice"),
        (
            "count = 2",
            "count = 2\nstart = [[1, 1], [9, 1]]",
            "start",
            "fleet.start, item 2: (9, 1) lies outside the floor of 5 × 4 cells",
        ),
        ("count = 2", "count = 2\nstart = [[1, 1], [1, 'x']]", "start", 'item 2, item 2: got "x", expected a whole'),
        (
            "[fleet]",
            "[charging]\ngood = 0.1\n[fleet]",
            "[charging]",
            "charging.critical: got 0.15, expected at most charging.good, which is 0.1",
        ),
        (
            "[fleet]",
            "[battery]\ninitial_soc = [0.9, 0.2]\n[fleet]",
            "initial_soc",
            "battery.initial_soc: got [0.9, 0.2], expected [low, high]",
        ),
        ("[fleet]", "[battery]\ninitial_soc = 1.5\n[fleet]", "initial_soc", "expected at most 1 or a list"),
        ("[fleet]", "[faults]\ndelay_ticks = [3, 1]\n[fleet]", "delay_ticks", "expected [shortest, longest]"),
        ("[fleet]", "[log]\nsample_s = 0.5\n[fleet]", "sample_s", "log.sample_s: got 0.5, expected at least one tick"),
        ("[time]", "[time]\nuntil_s = 0.5", "until_s", "time.until_s: got 0.5, expected at least one tick of 1 s"),
        ('"listed"', '"poisson"', "finish", "poisson orders without orders.limit are never all done"),
        (
            'source = "listed"',
            'source = "poisson"\nmix = [\n  { from = "inbound", to = "rack" },\n  { from = "shop", to = "rack" },\n]',
            '"shop"',
            "orders.mix, item 2.from: got \"shop\", expected 'inbound', 'outbound', 'rack', 'entrance' or 'station'",
        ),
        ("[floor]", '[floor]\nkind = "blocks"', "rows =", "a floor of kind 'blocks' is generated and has no rows"),
        ("[floor]", '[floor]\nkind = "blocks"', "kind", "a floor of kind 'blocks' needs a table [floor.blocks]"),
        ("[fleet]", "[floor.blocks]\n[fleet]", "[floor.blocks]", "only a floor of kind 'blocks' has this table"),
    ],
)
def test_a_problem_is_told_with_file_line_field_and_what_was_expected(
    old: str, new: str, at: str, sentence: str
) -> None:
    text = SMALL.replace(old, new, 1)
    assert text != SMALL
    lines = said(text)
    match = [line for line in lines if sentence in line]
    assert match, lines
    assert match[0].startswith(f"mine.toml, line {line_of(text, at)}"), (match[0], line_of(text, at))


def test_several_problems_are_several_lines_in_one_answer() -> None:
    text = SMALL.replace("count = 2", "count = 0\nmass_kg = -1").replace("[orders]", "[ordres]")
    assert [line.split(": ")[1] for line in said(text)] == ["fleet.count", "fleet.mass_kg", "ordres"]


def test_a_misspelt_key_is_one_problem_though_the_right_one_is_missing() -> None:
    assert len(said(SMALL.replace("count = 2", "coutn = 2"))) == 1


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a = \n", "mine.toml, line 1, column 5: malformed TOML: invalid value"),
        ("a = 1\na = 2\n", "mine.toml, line 2, column 6: malformed TOML: cannot overwrite a value"),
        ("a = 1\nb = [1,", "mine.toml, line 2: malformed TOML: invalid value at the end of the text"),
        ("[a\n", "mine.toml, line 1, column 3: malformed TOML"),
        ("a = " + "[" * 5000, "mine.toml: malformed TOML: nested too deeply"),
        ("a = " + "1" * 5000, "mine.toml: malformed TOML"),
        ("x" * 5_000_001, "mine.toml: a scenario has at most 5,000,000 bytes, got 5,000,001"),
    ],
)
def test_malformed_toml_is_answered_with_file_and_line(text: str, sentence: str) -> None:
    assert said(text)[0].startswith(sentence)


def test_a_floor_without_a_drawing_or_without_a_free_cell() -> None:
    assert "a drawn floor needs rows of letters" in said(re.sub(r'rows = """.*?"""', "", SMALL, flags=re.S))[0]
    assert (
        "no cell of the floor can hold a vehicle"
        in said(re.sub(r'rows = """.*?"""', 'rows = "##"', SMALL, flags=re.S))[0]
    )


def test_listed_orders_need_pairs_and_a_mix_needs_its_stations() -> None:
    assert "listed orders need at least one pair" in said(re.sub(r"pairs = .*", "", SMALL, flags=re.S))[0]
    poisson = SMALL.replace('"listed"', '"poisson"\nlimit = 1').replace("#I#O#", "#I###").replace("[3, 4]", "[1, 2]")
    assert said(poisson)[0].endswith("the floor has no outbound station")


def test_a_generator_that_can_t_is_told_at_its_table() -> None:
    text = re.sub(
        r"\[floor\].*?\[fleet\]", '[floor]\nkind = "blocks"\n[floor.blocks]\nracks = 9999\n[fleet]', SMALL, flags=re.S
    )
    found = said(text)
    assert len(found) == 1
    assert found[0].startswith(f"mine.toml, line {line_of(text, '[floor.blocks]')}: floor.blocks: ")
    assert "9999 racks" in found[0]


# ---------------------------------------------------------------- overrides


@pytest.mark.parametrize(
    ("key", "value", "got"),
    [
        ("fleet.count", 1, 1),
        ("fleet.count", "1", 1),
        ("fleet.start", "parking", "parking"),
        ("fleet.start", "[[1, 0], [2, 0]]", ((1, 0), (2, 0))),
        ("battery.initial_soc", "[0.5, 0.75]", (0.5, 0.75)),
        ("battery.initial_soc", [0.5, 0.75], (0.5, 0.75)),
        ("time.until_s", "60", 60.0),
        ("time.until_s", "none", None),
        ("time.until_s", None, None),
        ("planner.parameters.window", "12", 12),
        ("energy.parameters.mu", "0.02", 0.02),
        ("title", "Two words", "Two words"),
        ("title", '"quoted"', "quoted"),
        ("title", "1\nseed = 9", "1\nseed = 9"),
        ("seed", " 12 ", 12),
    ],
)
def test_an_override_is_read_as_a_toml_value_or_as_text(key: str, value: object, got: object) -> None:
    found: Any = parse(SMALL, overrides={key: value})
    for part in key.split("."):
        found = found[part] if isinstance(found, dict) else getattr(found, part)
    assert found == got
    assert type(found) is type(got)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("fleet.count", "many", '--set fleet.count: got "many", expected a whole number'),
        ("fleet.cuont", "3", "--set fleet.cuont: unknown key 'cuont'; did you mean 'count'?"),
        ("fleet.cuont", None, "--set fleet.cuont: unknown key 'cuont'; did you mean 'count'?"),
        ("flet.count", "3", "--set flet.count: unknown key 'flet'; did you mean 'fleet'?"),
        ("fleet.count.x", "3", "--set fleet.count.x: fleet.count is a value, not a table"),
        ("fleet", "3", "--set fleet: got 3, expected a table"),
        ("fleet.count", None, "--set fleet.count: this key is missing and has no default"),
        ("fleet..count", "3", "--set fleet..count: a dotted key was expected, such as fleet.count"),
        ("", "3", "--set : a dotted key was expected, such as fleet.count"),
        ("charging.good", "0.9", "--set charging.good: got 0.9, expected at most charging.sufficient, which is 0.8"),
    ],
)
def test_a_wrong_override_is_told_by_its_key(key: str, value: object, sentence: str) -> None:
    assert said(SMALL, {key: value}) == [sentence]


# ---------------------------------------------------------------- files and library


def test_load_reads_files_and_says_what_is_wrong_with_them(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(SMALL, "utf-8")
    assert load(file) == load(str(file)) == parse(SMALL)
    assert load(file, {"seed": "5"}).seed == 5
    file.write_text(SMALL.replace("count = 2", "count = 0"), "utf-8")
    with pytest.raises(ScenarioError, match=rf"^{re.escape(str(file))}, line 16: fleet.count: "):
        load(file)
    file.write_bytes(b"name = '\xff'")
    with pytest.raises(ScenarioError, match="UTF-8 text was expected; byte 8 is not"):
        load(file)
    file.write_bytes(b"#" * 5_000_001)
    with pytest.raises(ScenarioError, match="at most 5,000,000 bytes, got 5,000,001"):
        load(file)
    with pytest.raises(ScenarioError, match="a TOML file was expected, got a folder"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("soochow2023", "unknown scenario 'soochow2023'; did you mean 'soochow2022'?"),
        (
            "xyz",
            "unknown scenario 'xyz'; known: lian2024, soochow2022, soochow2022-battery, soochow2022-continuous",
        ),
        ("nowhere/mine.toml", "nowhere/mine.toml: there is no such file"),
        ("../soochow2022", "../soochow2022: there is no such file"),
        ("mine.toml", "mine.toml: there is no such file"),
        ("a\0b", "unknown scenario"),
        ("x" * 5000, "File name too long"),
        ("", "unknown scenario ''"),
        (".", "a TOML file was expected, got a folder"),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest_or_with_all(
    name: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match=re.escape(sentence)):
        load(name)


def test_the_library_lists_names_with_titles() -> None:
    assert library() == {
        "soochow2022": "Soochow thesis 2022: ten orders, eight AGVs",
        "lian2024": "Path network, 29 AGVs, 16 entrances",
        "soochow2022-continuous": "Soochow floor, orders without end",
        "soochow2022-four": "Soochow thesis 2022: four directions everywhere",
        "soochow2022-eight": "Soochow thesis 2022: eight directions",
        "soochow2022-swap": "Break it: two change places",
        "soochow2022-crossing": "Break it: crossing diagonals",
        "soochow2022-parked": "Break it: a parked vehicle",
        "soochow2022-idle": "Break it: an idle vehicle",
        "soochow2022-waiting": "Break it: waiting at the start",
        "soochow2022-disconnected": "Break it: a conflict for a moment, an obstacle for good",
        "soochow2022-dead-end": "Break it: a charger at the end of a one-way lane",
        "soochow2022-battery": "Break it: a task at 31 % of charge",
        "warehouse-large": "Large warehouse: 200 AGVs",
        "xu2025": "Xu & Wang 2025: four vehicles from corner to corner",
        "zhang2021": "Terrain: a robot crosses hills that it half knows",
        "wang2019": "Wang et al. 2019: two robots, four orders, two exits",
    }


@pytest.mark.parametrize(
    "name",
    ["soochow2022", "soochow2022-continuous", "soochow2022-four", "soochow2022-eight", "warehouse-large", "xu2025"],
)
def test_built_in_scenarios_round_trip_and_pass_every_check(name: str) -> None:
    found = load(name)
    assert found.name == name
    assert parse(found.to_toml()) == found
    world = build_world(found)
    findings = require(found, world)
    assert {f.level for f in findings} == {"ok"}, findings
    with_goals = found.orders.source == "goals"
    whole = ["goals", "battery"] if with_goals else ["reachable", "one-way", "well-formed", "rest places", "battery"]
    assert [f.check for f in findings] == whole
    assert with_goals or nx.is_strongly_connected(place_graph(world))
    starts = start_places(found, world)
    assert len(set(starts)) == found.fleet.count
    assert with_goals or set(starts) <= {*world.chargers.tolist(), *world.parking.tolist()}


def test_soochow2022_is_the_thesis() -> None:
    found = load("soochow2022")
    world = build_world(found)
    kinds = [str(s.kind) for s in world.stations]
    assert kinds == ["inbound"] * 3 + ["outbound"] * 3 + ["rack"] * 12
    assert (len(world.chargers), found.fleet.count, found.fleet.start) == (15, 8, "chargers")
    assert found.orders.pairs == (
        (2, 5), (1, 8), (6, 12), (2, 3), (2, 8), (2, 2), (1, 1), (5, 2), (3, 10), (2, 6),
    )  # fmt: skip
    assert (found.energy.demand, found.energy.beside, found.battery.model) == ("constant", "xu2025", "linear")
    assert (found.charging.good, found.charger.rate_percent_per_s) == (0.3, 3.0)
    assert (found.time.tick_s, found.time.finish) == (1.0, "orders done and home")
    assert "lost figure" in found.description
    at = [world.chargers.tolist().index(p) for p in start_places(found, world)]
    assert {b - a for a, b in pairwise(at)} == {1, 2}, "spread evenly over the chargers"


def test_both_soochow_scenarios_have_the_same_floor() -> None:
    assert load("soochow2022").floor == load("soochow2022-continuous").floor


def test_warehouse_large_is_large_but_has_few_destinations() -> None:
    found = load("warehouse-large")
    world = build_world(found)
    assert world.cells.size >= 10_000
    assert found.fleet.count == 200
    assert 400 <= int(world.endpoint.sum()) <= 600


# ---------------------------------------------------------------- round trip

finite = st.floats(1e-6, 1e9, allow_nan=False, allow_infinity=False)
shares = st.lists(st.floats(0, 1), min_size=5, max_size=5).map(sorted)
words = st.text(st.characters(codec="utf-8"), max_size=40)


@settings(max_examples=150, deadline=None)
@given(
    title=words.filter(bool),
    description=words,
    seed=st.integers(0, 2**63 - 1),
    numbers=st.lists(finite, min_size=6, max_size=6),
    levels=shares,
    soc=st.one_of(st.floats(0.01, 1), st.lists(st.floats(0.01, 1), min_size=2, max_size=2).map(sorted)),
    parameters_=st.dictionaries(words, st.one_of(st.booleans(), st.integers(-(2**62), 2**62), finite, words)),
    energy=st.dictionaries(words, finite),
    until=st.one_of(st.none(), st.floats(1, 1e9)),
    start=st.sampled_from(["chargers", "parking", [[1, 0], [1, 1]]]),
    mix=st.lists(
        st.fixed_dictionaries(
            {"from": st.sampled_from(["inbound", "rack", "station"]), "to": st.just("outbound"), "weight": finite}
        ),
        min_size=1,
        max_size=3,
    ),
)
def test_toml_round_trip(
    title: str,
    description: str,
    seed: int,
    numbers: list[float],
    levels: list[float],
    soc: Any,
    parameters_: dict[str, Any],
    energy: dict[str, float],
    until: float | None,
    start: Any,
    mix: list[dict[str, Any]],
) -> None:
    data = tomllib.loads(SMALL)
    data |= {"title": title[:120], "description": description, "seed": seed}
    data["time"] = {"tick_s": 1.0} | ({"until_s": until} if until else {})
    data["charging"] = dict(zip(("reserve", "critical", "good", "sufficient", "full"), levels, strict=True))
    data["battery"] = {"initial_soc": soc, "capacity_wh": numbers[0], "voltage_v": numbers[1]}
    data["charger"] = {"power_w": numbers[2], "rate_percent_per_s": numbers[3]}
    data["planner"] = {"parameters": parameters_}
    data["energy"] = {"parameters": energy}
    data["fleet"] = {"count": 2, "start": start, "mass_kg": numbers[4]}
    data["orders"] = {"source": "poisson", "rate_per_h": numbers[5], "mix": mix}
    first = from_dict(data)
    text = first.to_toml()
    again = parse(text)
    assert again == first
    assert again.to_toml() == text


# ---------------------------------------------------------------- lines of keys

TRICKY = '''# comment = 1
a = 1
"b c".d = "x # no"  # = 3
[t.u]
e = """
f = 2
[no]
""\\""""
g = [ # h = 1
  1, [2,
  3], "]",
]
i = { j = 1, k = { l = [1, 2] } }
[[m]]
n = 1
[[m]]
n = 2
[m.o]
p = 3
[[m.q]]
r = 1
[[m.q]]
r = 2
[ s . 't' ]
u = \'\'\'
]\'\'\'
'''


def test_every_key_and_element_is_found_on_its_line() -> None:
    tomllib.loads(TRICKY)
    assert lines_of(TRICKY) == {
        ("a",): 2,
        ("b c",): 3,
        ("b c", "d"): 3,
        ("t", "u"): 4,
        ("t", "u", "e"): 5,
        ("t", "u", "g"): 9,
        ("t", "u", "g", 0): 10,
        ("t", "u", "g", 1): 10,
        ("t", "u", "g", 1, 0): 10,
        ("t", "u", "g", 1, 1): 11,
        ("t", "u", "g", 2): 11,
        ("t", "u", "i"): 13,
        ("t", "u", "i", "j"): 13,
        ("t", "u", "i", "k"): 13,
        ("t", "u", "i", "k", "l"): 13,
        ("t", "u", "i", "k", "l", 0): 13,
        ("t", "u", "i", "k", "l", 1): 13,
        ("m",): 14,
        ("m", 0): 14,
        ("m", 0, "n"): 15,
        ("m", 1): 16,
        ("m", 1, "n"): 17,
        ("m", 1, "o"): 18,
        ("m", 1, "o", "p"): 19,
        ("m", 1, "q"): 20,
        ("m", 1, "q", 0): 20,
        ("m", 1, "q", 0, "r"): 21,
        ("m", 1, "q", 1): 22,
        ("m", 1, "q", 1, "r"): 23,
        ("s", "t"): 24,
        ("s", "t", "u"): 25,
    }


def test_a_path_that_is_not_there_has_the_line_of_its_table() -> None:
    lines = lines_of("a = 1\n[b]\nc = 2\n")
    assert nearest_line(lines, ("b", "x", "y")) == 2
    assert nearest_line(lines, ("z",)) is None


plain = st.recursive(
    st.one_of(st.integers(-1000, 1000), st.booleans(), words),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(words, inner, max_size=3)),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(st.dictionaries(words, plain, max_size=5))
def test_every_top_level_key_of_written_toml_has_a_line(data: dict[str, Any]) -> None:
    import tomli_w

    text = tomli_w.dumps(data, multiline_strings=True)
    found = lines_of(text)
    assert {path[0] for path in found} == set(tomllib.loads(text))
    assert all(1 <= line <= text.count("\n") + 1 for line in found.values())


# ---------------------------------------------------------------- parameters


def test_every_parameter_can_be_set_to_its_default_and_is_described() -> None:
    rows = parameters()
    keys = [row["key"] for row in rows]
    assert len(keys) == len(set(keys))
    assert {"fleet.count", "seed", "orders.rate_per_h", "charging.good", "floor.blocks.columns"} <= set(keys)
    for row in rows:
        assert row["description"], row["key"]
        assert row["type"] in {"integer", "number", "text", "choice", "list", "table"}
        assert bool(row["choices"]) == (row["type"] == "choice")
        if row["default"] is not None and not row["key"].startswith(
            ("floor.blocks.", "floor.network.", "floor.terrain.")
        ):
            overrides = {row["key"]: row["default"]}
            if row["key"] in ("time.finish", "orders.source", "orders.pairs"):
                continue  # these three must agree with each other
            assert parse(SMALL, overrides=overrides)


def test_parameters_carry_the_values_of_a_scenario() -> None:
    rows = {row["key"]: row for row in parameters(load("warehouse-large"))}
    assert (rows["fleet.count"]["value"], rows["fleet.count"]["default"]) == (200, None)
    assert rows["fleet.count"]["required"]
    assert (rows["fleet.count"]["minimum"], rows["fleet.count"]["maximum"]) == (1, 10_000)
    assert rows["floor.blocks.rows"]["value"] == 24
    assert not any(row["key"].startswith("floor.blocks.") for row in parameters(load("soochow2022")))
    assert rows["orders.mix"]["value"][0] == {"from": "inbound", "to": "rack", "weight": 1.0}
    assert rows["time.finish"]["choices"] == ["never", "orders done", "orders done and home", "goals reached"]


def test_importing_the_room_is_light() -> None:
    code = (
        "import sys, engine.scenario, engine.scenario.checks; "
        "print([m for m in ('numba', 'scipy', 'networkx', 'tomli_w') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_front_door_lists_what_there_is() -> None:
    assert set(room.__all__) == {
        "Scenario", "from_dict", "from_movingai", "goal_places", "library", "load", "parameters", "parse",
        "start_places",
    }  # fmt: skip
    assert room.Scenario is Scenario


# ---------------------------------------------------------------- checks


def findings(rows: str, overrides: dict[str, object] | None = None) -> list[Finding]:
    drawn = "\n".join(rows.split())
    small = parse(SMALL, overrides={"floor.rows": drawn, "fleet.count": 1, **(overrides or {})})
    return check(small, build_world(small))


LISTED = {"orders.pairs": [[1, 2]]}


def test_a_cut_off_station_is_named_with_its_cell() -> None:
    found = findings("I.O C.# ### #R# ", LISTED)
    assert Finding("error", "reachable", "R3 at (1, 0) has no aisle cell beside it", 0) in found
    assert found[-1] == Finding("warning", "battery", "not checked: stations or chargers can't be reached")

    found = findings("I.O C.# ### R.P", LISTED)
    texts = [f.text for f in found if f.level == "error" and f.check == "reachable"]
    assert texts == [
        "R3 at (0, 0) is cut off from the rest of the floor",
        "P1 at (2, 0) is cut off from the rest of the floor",
    ]


def test_one_way_rules_that_trap_or_shut_out_are_named() -> None:
    found = findings("I..O C.>R ####", LISTED)
    assert {f.text for f in found if f.level == "error" and f.check == "one-way"} == {
        "R3 at (3, 1) can be entered, but has no way back",
        "(2, 1) can be entered, but the one-way rules leave no way back",
    }
    found = findings("O.## I.<R C.##", LISTED)
    assert "R3 at (3, 1) can be left, but has no way to it" in {f.text for f in found if f.check == "one-way"}


def test_many_problems_are_counted() -> None:
    found = findings("I.O C.# ### RRR RRR", LISTED)
    assert "and 1 more endpoints" in {f.text for f in found if f.level == "error"}


def test_an_aisle_nobody_can_reach_is_a_warning() -> None:
    found = findings("I.O C.# ### ...", LISTED)
    assert [f.text for f in found if f.level == "warning"] == [
        "(0, 0), (1, 0), (2, 0) can't be reached from the rest of the floor"
    ]
    assert found[-1].level == "ok"


def test_each_vehicle_needs_a_place_to_rest() -> None:
    small = parse(SMALL, overrides={"fleet.count": 3})
    world = build_world(small)
    text = "1 chargers and 1 parking bays for 3 vehicles; each vehicle needs a place to rest"
    assert Finding("error", "rest places", text) in check(small, world)
    with pytest.raises(ScenarioError, match=f"^small: rest places: {text}$"):
        require(small, world)
    with pytest.raises(ScenarioError, match=r"fleet\.count: got 3 vehicles, expected at most 2"):
        start_places(small, world)


def test_a_floor_without_a_charger_is_a_warning() -> None:
    found = findings("I.O P.#", LISTED)
    assert Finding("warning", "rest places", "the floor has no charger: an empty battery stays empty") in found
    assert found[-1].check == "battery"
    assert found[-1].level == "ok"


def test_a_start_cell_from_which_no_way_leads_is_named() -> None:
    found = findings("I.O C.# ### ...", {**LISTED, "fleet.start": [[1, 0]]})
    assert (
        Finding("error", "start", "vehicle 0 starts at (1, 0), from where not every station can be reached", 1) in found
    )


def test_a_speed_that_does_not_fit_the_ticks_is_a_warning() -> None:
    small = parse(SMALL, overrides={"motion.straight_ticks": 2})
    text = "a step of 1 m in 2 ticks is 0.5 m/s, but motion.speed_mps is 1"
    assert Finding("warning", "speed", text) in check(small, build_world(small))


def test_starts_spill_over_to_the_other_kind_of_rest_place() -> None:
    for kind, names in {"chargers": ["C1", "P1"], "parking": ["P1", "C1"]}.items():
        small = parse(SMALL, overrides={"fleet.start": kind})
        world = build_world(small)
        assert [world.place_name(p).split()[0] for p in start_places(small, world)] == names
    small = parse(SMALL, overrides={"fleet.start": [[2, 2], [1, 1]]})
    world = build_world(small)
    assert start_places(small, world) == (world.place_at(2, 2), world.place_at(1, 1))


# ---------------------------------------------------------------- battery


def test_the_longest_order_is_told_in_energy_by_hand() -> None:
    """Out of the spur: a reversal from standstill, which drives one cell and turns twice; then straight on."""
    small = parse(SMALL, overrides={"floor.rows": "C....I\n######", "fleet.count": 1, "orders.pairs": [[1, 1]]})
    world = build_world(small)
    legs = longest_order(small, world)
    assert legs is not None
    assert [(leg.start, leg.end, len(leg.edges)) for leg in legs] == [(0, 5, 5), (5, 5, 0), (5, 0, 5)]
    model = Xu2025(mu=0.01, g=9.81, v_mps=1.0, standby_w=30.0, omega=1.5707963267948966, length_m=1.2, width_m=0.9)
    straight, start, turn = 0.01 * 1000 * 9.81, 500.0, 0.5 * 187.5 * model.omega**2
    expected = start + 2 * turn + 5 * straight + 5 * 30.0
    assert leg_energy_j(small, world, model, legs[0]) == pytest.approx(expected)
    assert leg_energy_j(small, world, model, legs[2]) == pytest.approx(expected)


def test_an_order_that_no_battery_serves_is_an_error_with_its_way() -> None:
    small = parse(SMALL, overrides={"battery.capacity_wh": 0.5})
    found = check(small, build_world(small))[-1]
    assert (found.level, found.check) == ("error", "battery")
    assert re.search(
        r"the longest order, .* → .* takes \d+\.\d% of a battery; 95.0% is there .*never be served", found.text
    )
    assert found.place is not None
    huge = parse(SMALL, overrides={"battery.capacity_wh": 5000})
    assert check(huge, build_world(huge))[-1].level == "ok"


def test_an_order_that_only_the_farther_charger_cannot_serve_is_a_warning() -> None:
    """41 cells to the order and 10 back, or 1 and 10; from the farther charger that is more than there is."""
    found = load("soochow2022-battery")
    world = build_world(found)
    far, near = longest_order(found, world), longest_order(found, world, from_nearest=True)
    assert far is not None
    assert near is not None
    assert far[1:] == near[1:]
    assert (far[0].start, near[0].start) == tuple(world.chargers[::-1])
    assert len(far[0].edges) > len(near[0].edges) > 0
    told = check(found, world)[-1]
    assert (told.level, told.check) == ("warning", "battery")
    assert "a vehicle that charged at C2 at (51, 0) can't take it; from the nearest charger, C1 at (0, 0)" in told.text
    assert "never" not in told.text


def test_the_warning_stands_between_ninety_percent_and_all() -> None:
    small = parse(SMALL)
    world = build_world(small)
    legs = longest_order(small, world)
    assert legs is not None
    model = Xu2025(mu=0.01, g=9.81, v_mps=1.0, standby_w=30.0, omega=1.5707963267948966, length_m=1.2, width_m=0.9)
    need_wh = (sum(leg_energy_j(small, world, model, leg) for leg in legs) + 30.0 * 10) / 3600 / 0.95
    for factor, level in ((0.999, "error"), (1.001, "warning"), (1.12, "ok")):
        sized = parse(SMALL, overrides={"battery.capacity_wh": need_wh * factor})
        assert check(sized, world)[-1].level == level


def test_the_load_weighs_on_the_loaded_leg_only() -> None:
    small = parse(SMALL)
    heavy = parse(SMALL, overrides={"fleet.payload_kg": 500.0})
    world = build_world(small)
    legs = longest_order(small, world)
    assert legs is not None
    assert [leg.loaded for leg in legs] == [False, True, False]
    model = Xu2025(mu=0.01, g=9.81, v_mps=1.0, standby_w=0.0, omega=1.5, length_m=1.2, width_m=0.9)
    for leg in legs:
        ratio = leg_energy_j(heavy, world, model, leg) / leg_energy_j(small, world, model, leg)
        assert ratio == pytest.approx(1.5 if leg.loaded else 1.0)


def test_the_longest_order_is_the_longest_by_brute_force() -> None:
    found = load("soochow2022")
    world = build_world(found)
    legs = longest_order(found, world)
    assert legs is not None
    hops = dict(nx.all_pairs_shortest_path_length(place_graph(world)))
    chargers = world.chargers.tolist()
    expected = max(
        max(hops[c][a] for c in chargers) + hops[a][b] + min(hops[b][c] for c in chargers)
        for a, b in order_pairs(found, world)
    )
    assert sum(len(leg.edges) for leg in legs) == expected
    assert [len(leg.edges) for leg in legs] == [hops[leg.start][leg.end] for leg in legs]


def test_order_pairs_follow_the_mix() -> None:
    small = parse(
        SMALL,
        overrides={"orders.source": "poisson", "orders.limit": 1, "orders.mix": [{"from": "inbound", "to": "station"}]},
    )
    world = build_world(small)
    inbound = world.station(1).place
    assert order_pairs(small, world) == [(inbound, p) for p in sorted(s.place for s in world.stations)]


def test_an_unknown_demand_model_leaves_the_battery_unchecked_unless_given() -> None:
    small = parse(SMALL, overrides={"energy.demand": "other"})
    world = build_world(small)
    assert check(small, world)[-1].text == "not checked: energy of demand model 'other' was not given"
    model = Xu2025(mu=0.01, g=9.81, v_mps=1.0, standby_w=0.0, omega=1.5, length_m=1.2, width_m=0.9)
    assert check(small, world, model)[-1].level == "ok"
