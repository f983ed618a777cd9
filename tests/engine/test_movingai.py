"""MovingAI files: what is read, what is refused and where, and what the generators promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from engine.errors import FormatError
from engine.scenario import movingai
from engine.scenario.movingai import Instance, instance_of, map_text, parse_map, parse_scen, scen_text

MAP = "type octile\nheight 2\nwidth 4\nmap\n.@GS\nOTWE\n"
SCEN = "version 1\n0\tsmall.map\t4\t2\t0\t0\t3\t1\t3.5\n1\tsmall.map\t4\t2\t2\t0\t3\t0\t1\n"


def test_rows_are_turned_upside_down() -> None:
    assert parse_map(MAP).tolist() == [[False, False, False, True], [True, False, True, True]]
    first = parse_scen(SCEN)[0]
    assert (first.start, first.goal, first.optimal) == ((0, 1), (3, 0), 3.5)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.rstrip("\n"),
        lambda text: text + "\n\n",
        lambda text: text.replace("height 2\nwidth 4", "width 4\nheight\t2"),
    ],
)
def test_kinds_of_map_that_are_read(change) -> None:  # type: ignore[no-untyped-def]
    assert (parse_map(change(MAP)) == parse_map(MAP)).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\t", "   "),
        lambda text: text.replace("version 1\n", "version 1.0\n"),
        lambda text: text.replace("\n", "\n\n"),
    ],
)
def test_kinds_of_scenario_that_are_read(change) -> None:  # type: ignore[no-untyped-def]
    got = parse_scen(change(SCEN))
    assert [(t.start, t.goal, t.map) for t in got] == [(t.start, t.goal, t.map) for t in parse_scen(SCEN)]


def test_a_name_may_have_folders_and_spaces() -> None:
    text = SCEN.replace("small.map", "maps/my floor/small.map")
    assert parse_scen(text)[1].map == "maps/my floor/small.map"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "'map' is missing"),
        (MAP.replace("height 2\n", ""), "line 3: 'height' is missing"),
        (MAP.replace("height 2", "height two"), "line 2: height: a whole number"),
        (MAP.replace("height 2", "height 0"), "line 2: height must be 1…"),
        (MAP.replace("height 2", "height 3"), "line 7: 3 rows were expected, got 2"),
        (MAP.replace("height 2", "height 1"), "line 6: 1 rows were expected, got 2"),
        (MAP.replace("type octile", "kind octile"), "line 1: 'type'"),
        (MAP.replace("width 4", "width 4\nwidth 4"), "line 4: a second width"),
        (MAP.replace(".@GS", ".@G"), "line 5: a row of 4 cells was expected, got 3"),
        (MAP.replace(".@GS", ".@xS"), "line 5: column 3: one of"),
    ],
)
def test_bad_maps_are_refused_with_their_line(text: str, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        parse_map(text, "small.map")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("version 1", "version 2"), "line 1: 'version 1' was expected"),
        (("version 1\n", ""), "line 1: 'version 1' was expected"),
        (("\t3.5", ""), "line 2: 9 fields were expected"),
        (("3.5", "far"), "line 2: a length was expected, got 'far'"),
        (("\t2\t0\t3", "\ttwo\t0\t3"), "line 3: start x: a whole number"),
        (("\t2\t0\t3", "\t4\t0\t3"), "line 3: start x must be 0…3, got 4"),
        (("\t2\t0\t3", "\t-1\t0\t3"), "line 3: start x must be"),
        (("\t2\t0\t3", "\t1_0\t0\t3"), "line 3: start x: a whole number"),
    ],
)
def test_bad_scenarios_are_refused_with_their_line(change: tuple[str, str], words: str) -> None:
    with pytest.raises(FormatError, match=words):
        parse_scen(SCEN.replace(*change), "small.scen")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("4\t2\t2\t0", "4\t2\t1\t0"), r"line 3: start \(1, 0\) is blocked"),
        (("4\t2\t2\t0", "4\t2\t0\t0"), r"line 3: start \(0, 0\) is taken by line 2"),
        (("3\t0\t1", "3\t1\t1"), r"line 3: goal \(3, 1\) is taken by line 2"),
        (("1\tsmall.map\t4\t2", "1\tsmall.map\t5\t2"), "line 3: the map small is 4 × 2 cells"),
    ],
)
def test_rows_that_do_not_fit_the_map_are_refused(change: tuple[str, str], words: str) -> None:
    trips = parse_scen(SCEN.replace(*change))
    with pytest.raises(FormatError, match=words):
        instance_of(parse_map(MAP), trips, 2, "small")
    assert instance_of(parse_map(MAP), trips, 1, "small").agents == 1


def test_more_vehicles_than_rows_are_refused() -> None:
    with pytest.raises(FormatError, match="3 vehicles were asked for; it has 2 rows"):
        instance_of(parse_map(MAP), parse_scen(SCEN), 3)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="can't be read"):
        movingai.read_map(tmp_path / "none.map")
    (tmp_path / "bad.map").write_bytes(b"type \xff")
    with pytest.raises(FormatError, match="byte 5"):
        movingai.read_map(tmp_path / "bad.map")


@given(arrays(np.bool_, st.tuples(st.integers(1, 7), st.integers(1, 7))))
def test_maps_come_back_as_written(free: np.ndarray) -> None:
    assert (parse_map(map_text(free)) == free).all()


@given(st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_instances_come_back_as_written(seed: int, agents: int) -> None:
    made = movingai.random_instance(np.random.default_rng(seed), 6, 5, 0.2, agents)
    read = instance_of(parse_map(map_text(made.free)), parse_scen(scen_text(made)), None)
    assert (read.free == made.free).all()
    assert (read.starts, read.goals) == (made.starts, made.goals)


def test_files_come_back_as_written(tmp_path: Path) -> None:
    made = movingai.corner_instance(np.random.default_rng(3), 8, 0.2)
    (tmp_path / "a.map").write_text(map_text(made.free))
    (tmp_path / "a.scen").write_text(scen_text(made))
    read = movingai.read_instance(tmp_path / "a.map", tmp_path / "a.scen", 2)
    assert (read.name, read.starts, read.goals) == ("a", made.starts[:2], made.goals[:2])


@pytest.mark.parametrize("density", [0.0, 0.1, 0.3])
def test_generated_floors_have_their_density_and_connect(density: float) -> None:
    for seed in range(10):
        made = movingai.corner_instance(np.random.default_rng(seed), 12, density)
        assert (~made.free).sum() == round(density * 144)
        assert movingai.are_connected(made.free, [*made.starts, *made.goals])
        again = movingai.corner_instance(np.random.default_rng(seed), 12, density)
        assert (made.free == again.free).all()
    single = movingai.single_instance(np.random.default_rng(0), 20, density)
    assert (single.starts, single.goals) == (((0, 0),), ((19, 19),))


def test_generators_say_what_is_impossible() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(FormatError, match="no room"):
        movingai.single_instance(rng, 3, 1.0)
    with pytest.raises(FormatError, match="don't fit"):
        movingai.random_instance(rng, 3, 3, 0.5, 9)


def test_a_cells_place_is_the_graphs() -> None:
    made = movingai.random_instance(np.random.default_rng(1), 7, 5, 0.3, 4)
    graph = made.graph()
    assert graph.unit
    for x, y in (*made.starts, *made.goals):
        assert graph.xy_m[made.place((x, y))].tolist() == [x + 0.5, y + 0.5]


def test_the_first_vehicles_of_an_instance() -> None:
    made = Instance("x", np.ones((2, 2), np.bool_), ((0, 0), (1, 0)), ((1, 1), (0, 1)))
    assert made.first(1).starts == ((0, 0),)
    with pytest.raises(FormatError, match="3 vehicles"):
        made.first(3)
