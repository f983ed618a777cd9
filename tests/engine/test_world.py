"""Floors: numbering, access, one-way rules, diagonals, the block generator and well-formedness."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import BadInput
from engine.scenario.blocks import rows_of_blocks
from engine.scenario.checks import ill_formed_pairs, is_well_formed, place_graph
from engine.types import Occupancy, StationKind
from engine.world import FloorPlan, GridMotion, World, build_world
from engine.world.floor import AISLES, ENDPOINTS, LETTERS, ONE_WAY

HALL = ("#I#O#", "#...#", "R.#.R", "C...P")
STEP = {">": (1, 0), "^": (0, 1), "<": (-1, 0), "v": (0, -1)}


def floor(*rows: str, **kwargs: object) -> World:
    return build_world(FloorPlan(rows, **kwargs))  # type: ignore[arg-type]


def arcs(world: World) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Moves from cell to cell that the motion graph allows."""
    cell = [tuple(c) for c in world.cell_of_place.tolist()]
    graph = world.graph
    return {
        (cell[graph.state_place[a]], cell[graph.state_place[b]])
        for a, b in zip(graph.edge_from, graph.edge_to, strict=True)
        if graph.state_place[a] != graph.state_place[b]
    }


def naive_arcs(rows: tuple[str, ...]) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """The rules of a 4-connected floor, said once more, cell by cell."""
    height = len(rows)
    letter = {(x, height - 1 - y): c for y, row in enumerate(rows) for x, c in enumerate(row)}
    found = set()
    for (x, y), c in letter.items():
        if c in AISLES:
            for dx, dy in STEP.values():
                ahead = letter.get((x + dx, y + dy), "#")
                leaves = c == "." or STEP[c] == (dx, dy)
                enters = ahead == "." or (ahead in STEP and STEP[ahead] != (-dx, -dy))
                if leaves and enters:
                    found.add(((x, y), (x + dx, y + dy)))
        elif c in ENDPOINTS:
            for dx, dy in ((0, -1), (0, 1), (-1, 0), (1, 0)):
                if letter.get((x + dx, y + dy), "#") in AISLES:
                    found |= {((x, y), (x + dx, y + dy)), ((x + dx, y + dy), (x, y))}
                    break
    return found


@st.composite
def drawings(draw: st.DrawFn, letters: str = "...><^v#ROCP", most: int = 6) -> tuple[str, ...]:
    width, height = draw(st.integers(1, most)), draw(st.integers(1, most))
    text = draw(st.text(letters, min_size=width * height, max_size=width * height))
    if not set(text) & set(AISLES + ENDPOINTS):
        text = "." + text[1:]
    return tuple(text[i * width : (i + 1) * width] for i in range(height))


def test_stations_are_numbered_inbound_outbound_racks_in_reading_order() -> None:
    world = floor(*HALL)
    assert [(s.number, s.name, s.kind) for s in world.stations] == [
        (1, "I1", StationKind.INBOUND),
        (2, "O2", StationKind.OUTBOUND),
        (3, "R3", StationKind.RACK),
        (4, "R4", StationKind.RACK),
    ]
    assert [world.cell_of_place[s.place].tolist() for s in world.stations] == [[1, 3], [3, 3], [0, 1], [4, 1]]
    assert world.cell_of_place[world.chargers].tolist() == [[0, 0]]
    assert world.cell_of_place[world.parking].tolist() == [[4, 0]]
    assert world.place_name(world.stations[3].place) == "R4 at (4, 1)"
    assert world.place_name(world.place_at(2, 2)) == "(2, 2)"
    assert world.place_name(int(world.chargers[0])) == "C1 at (0, 0)"


def test_places_are_cells_row_by_row_from_the_bottom() -> None:
    world = floor(*HALL)
    keys = [(y, x) for x, y in world.cell_of_place.tolist()]
    assert keys == sorted(keys)
    for place, (x, y) in enumerate(world.cell_of_place.tolist()):
        assert world.place_at(x, y) == place
    assert world.place_at(0, 3) == -1
    assert world.place_at(-1, 0) == world.place_at(5, 0) == world.place_at(0, 4) == -1
    assert chr(world.cells[0, 0]) == "C"
    assert world.graph.xy_m[world.place_at(1, 0)].tolist() == [1.5, 0.5]


def test_stations_by_number_and_kind() -> None:
    world = floor(*HALL)
    assert world.station(2).name == "O2"
    assert [s.number for s in world.stations_of("rack")] == [3, 4]
    assert len(world.stations_of("station")) == 4
    for number in (0, 5):
        with pytest.raises(BadInput, match=f"unknown station {number}; stations are numbered 1 to 4"):
            world.station(number)


@settings(max_examples=150, deadline=None)
@given(drawings())
def test_moves_are_exactly_those_of_the_rules(rows: tuple[str, ...]) -> None:
    assert arcs(floor(*rows)) == naive_arcs(rows)


@settings(max_examples=60, deadline=None)
@given(drawings())
def test_each_endpoint_has_at_most_one_access_cell_and_no_endpoint_beside_it(rows: tuple[str, ...]) -> None:
    world = floor(*rows)
    graph = place_graph(world)
    for place in range(world.n_places):
        if world.endpoint[place]:
            access = int(world.access[place])
            expected = [access] if access >= 0 else []
            assert list(graph.succ[place]) == list(graph.pred[place]) == expected
            assert access < 0 or not world.endpoint[access]
        else:
            assert world.access[place] == -1


@pytest.mark.parametrize(("letter", "ahead"), STEP.items())
def test_a_one_way_cell_is_left_forwards_and_into_the_endpoints_beside_it(letter: str, ahead: tuple[int, int]) -> None:
    world = floor("...", f".{letter}.", "...")
    here = (1, 1)
    assert {b for a, b in arcs(world) if a == here} == {(1 + ahead[0], 1 + ahead[1])}
    front = (1 + ahead[0], 1 + ahead[1])
    assert {a for a, b in arcs(world) if b == here} == {(0, 1), (2, 1), (1, 0), (1, 2)} - {front}

    spurs = floor("#C#", f"C{letter}C", "#C#")
    assert {b for a, b in arcs(spurs) if a == here} == {(0, 1), (2, 1), (1, 0), (1, 2)}


def test_access_prefers_south_north_west_east_and_can_be_named() -> None:
    rows = ("...", ".R.", "...")
    assert arcs(floor(*rows)) >= {((1, 1), (1, 0)), ((1, 0), (1, 1))}
    for side, cell in {"north": (1, 2), "west": (0, 1), "east": (2, 1), "south": (1, 0)}.items():
        world = floor(*rows, access={"R1": side})
        assert {b for a, b in arcs(world) if a == (1, 1)} == {cell}
    assert {b for a, b in arcs(floor("...", ".R.", "###")) if a == (1, 1)} == {(1, 2)}
    assert {b for a, b in arcs(floor(".R.")) if a == (1, 0)} == {(0, 0)}


@pytest.mark.parametrize(
    ("rows", "access", "message"),
    [
        ((".R.", "..."), {"R2": "south"}, "unknown endpoint 'R2'; did you mean 'R1'"),
        ((".R.", "..."), {"R1": "up"}, "access of R1: unknown side 'up'"),
        ((".R.", "..."), {"R1": "north"}, r"access of R1: there is no aisle cell north of \(1, 1\)"),
        ((".X.", "..."), {}, "row 1, column 2 of the floor: unknown letter 'X'"),
        (("..", "..."), {}, "row 2 of the floor has 3 cells where row 1 has 2"),
        (("##", "#S"), {}, "no cell of the floor can hold a vehicle"),
        ((), {}, "at least one cell"),
        (("",), {}, "at least one cell"),
    ],
)
def test_a_wrong_drawing_is_answered_with_a_sentence(
    rows: tuple[str, ...], access: dict[str, str], message: str
) -> None:
    with pytest.raises(BadInput, match=message):
        floor(*rows, access=access)


def test_diagonals_join_plain_aisle_cells_only_and_never_sweep_an_endpoint() -> None:
    open_floor = floor("..", "..", connectivity=8)
    assert ((0, 0), (1, 1)) in arcs(open_floor)
    assert open_floor.graph.heading_deg == tuple(range(0, 360, 45))
    for rows in (("#.", ".."), ("C.", ".."), (">.", ".."), ("S.", "..")):
        moves = arcs(floor(*rows, connectivity=8))
        assert ((0, 0), (1, 1)) not in moves
        assert all(abs(ax - bx) + abs(ay - by) == 1 for (ax, ay), (bx, by) in moves)


def test_storage_and_walls_hold_no_vehicle() -> None:
    world = floor("S.#", "...")
    assert world.n_places == 4
    assert world.place_at(0, 1) == world.place_at(2, 1) == -1


def test_motion_and_occupancy_reach_the_world() -> None:
    world = floor("..", motion=GridMotion(cell_mm=500, straight_ticks=3), occupancy=Occupancy.MAPF, margin_ticks=2)
    assert (world.occupancy, world.margin_ticks, world.cell_mm) == (Occupancy.MAPF, 2, 500)
    assert world.graph.xy_m.tolist() == [[0.25, 0.25], [0.75, 0.25]]
    assert next(p for p in world.graph.primitives if p.name == "straight").ticks == 3


def test_arrays_of_a_world_cannot_be_written() -> None:
    world = floor(*HALL)
    for array in (world.cells, world.chargers, world.place_of_cell, world.cell_of_place, world.access, world.endpoint):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_floor_json_is_plain_and_complete() -> None:
    world = floor("I.>", "#.#", "C.P")
    data = json.loads(json.dumps(world.floor_json()))
    assert data == {
        "kind": "grid",
        "width": 3,
        "height": 3,
        "cell_m": 1.0,
        "cells": ["C.P", "#.#", "I.>"],
        "places": [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [1.5, 1.5], [0.5, 2.5], [1.5, 2.5], [2.5, 2.5]],
        "stations": [{"number": 1, "name": "I1", "kind": "inbound", "place": 4, "x": 0.5, "y": 2.5}],
        "chargers": [{"number": 1, "name": "C1", "place": 0, "x": 0.5, "y": 0.5}],
        "parking": [{"number": 1, "name": "P1", "place": 2, "x": 2.5, "y": 0.5}],
        "one_way": [{"place": 6, "x": 2.5, "y": 2.5, "heading_deg": 0}],
    }
    assert set("".join(data["cells"])) <= set(LETTERS)


# ---------------------------------------------------------------- well-formed


def naive_ill_formed(world: World) -> set[tuple[int, int]]:
    """The definition itself: remove all other endpoints, look for a path."""
    graph = place_graph(world)
    ends = [p for p in range(world.n_places) if world.endpoint[p]]
    found = set()
    for a, b in permutations(ends, 2):
        rest = graph.subgraph([p for p in graph if p not in ends or p in (a, b)])
        if not nx.has_path(rest, a, b):
            found.add((a, b))
    return found


@settings(max_examples=150, deadline=None)
@given(drawings(letters="....>^#RC", most=5), st.data())
def test_well_formedness_is_that_of_the_definition(rows: tuple[str, ...], data: st.DataObject) -> None:
    world = floor(*rows)
    # aisle cells declared endpoints make routes through endpoints possible, which a drawing never does
    extra = data.draw(st.lists(st.integers(0, world.n_places - 1), max_size=3))
    endpoint = world.endpoint.copy()
    endpoint[extra] = True
    world = replace(world, endpoint=endpoint)
    expected = naive_ill_formed(world)
    assert set(ill_formed_pairs(world)) == expected
    assert is_well_formed(world) == (not expected)
    assert len(ill_formed_pairs(world, 2)) == min(2, len(expected))


def test_an_endpoint_in_a_corridor_makes_a_floor_ill_formed() -> None:
    world = floor("C.....C")
    assert is_well_formed(world)
    endpoint = world.endpoint.copy()
    endpoint[3] = True
    assert set(ill_formed_pairs(replace(world, endpoint=endpoint))) == {(0, 6), (6, 0)}


# ---------------------------------------------------------------- generator

BLOCKS = {
    "columns": 3,
    "rows": 4,
    "block_width": 6,
    "block_height": 2,
    "aisle_width": 1,
    "main_every": 2,
    "racks": 12,
    "inbound": 2,
    "outbound": 2,
    "exits": 0,
    "chargers": 5,
    "parking": 7,
}


@settings(max_examples=40, deadline=None)
@given(
    st.fixed_dictionaries(
        {
            "columns": st.integers(1, 5),
            "rows": st.integers(1, 5),
            "block_width": st.integers(3, 7),
            "block_height": st.integers(1, 4),
            "aisle_width": st.sampled_from([1, 2]),
            "main_every": st.integers(0, 3),
            "racks": st.integers(0, 2),
            "inbound": st.integers(0, 1),
            "outbound": st.integers(0, 1),
            "exits": st.integers(0, 3),
            "chargers": st.integers(0, 5),
            "parking": st.integers(0, 1),
        }
    )
)
def test_generated_floors_are_strongly_connected_well_formed_and_complete(blocks: dict[str, int]) -> None:
    blocks["exits"] = min(blocks["exits"], 2 * (blocks["rows"] - 1))
    rows = rows_of_blocks(**blocks)
    text = "".join(rows)
    for letter, key in {"I": "inbound", "R": "racks", "C": "chargers", "P": "parking"}.items():
        assert text.count(letter) == blocks[key]
    assert text.count("O") == blocks["outbound"] + blocks["exits"]
    world = floor(*rows)
    assert nx.is_strongly_connected(place_graph(world))
    assert is_well_formed(world)
    assert (world.access[world.endpoint] >= 0).all()


def test_lanes_keep_right_and_one_way_aisles_alternate() -> None:
    rows = rows_of_blocks(**BLOCKS)
    bottom_up = rows[::-1]
    assert set(bottom_up[1][1:-1]) == {">", "."}, "the outer lane of the ring runs east in the south"
    assert set(bottom_up[2][1:-1]) == {"<", "."}
    middle = bottom_up[3]
    assert middle[1:3] == middle[-3:-1] == "v^", "on every column road the northbound lane lies east"
    signs = [row[3] for row in bottom_up if row[3] in "<>"]
    assert signs == [">", "<", ">", ">", "<", "<", ">", "<"], "ring, aisle, main road, aisle, ring"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"racks": 10_000}, "storage cells beside an aisle; 10000 racks and 7 parking bays were asked for"),
        ({"inbound": 99}, "there is room for 8 inbound stations on the west side; 99 were asked for"),
        ({"outbound": 99}, "there is room for 8 outbound stations on the east side; 99 were asked for"),
        ({"exits": 99}, "there is room for 6 exits at the ends of aisles; 99 were asked for"),
        ({"chargers": 99}, "chargers on the south and north sides"),
        ({"columns": 100, "rows": 100, "block_width": 100, "block_height": 20}, "are more than 1,000,000"),
    ],
)
def test_what_has_no_room_is_refused(change: dict[str, int], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        rows_of_blocks(**{**BLOCKS, **change})


def test_a_floor_of_ten_thousand_cells_is_whole() -> None:
    rows = rows_of_blocks(**{**BLOCKS, "columns": 10, "rows": 24, "block_width": 12})
    world = floor(*rows)
    assert world.cells.size >= 10_000
    assert world.n_places == sum(letter in (*AISLES, *ENDPOINTS) for row in rows for letter in row)
    assert arcs(world) == naive_arcs(rows)


def test_one_way_letters_match_the_headings_of_the_graph() -> None:
    for letter, direction in ONE_WAY.items():
        dx, dy = STEP[letter]
        assert np.allclose([np.cos(np.radians(45 * direction)), np.sin(np.radians(45 * direction))], [dx, dy])
