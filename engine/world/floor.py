"""Floors: cells with letters, stations, chargers and one-way aisles, compiled to a motion graph.

Endpoints (stations, racks, chargers, parking) are spurs: each has exactly one access cell, so no route passes through.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name
from engine.types import NONE, Occupancy, StationKind
from engine.world.grid import STEPS, GridMotion, compile_grid
from engine.world.motion_graph import MotionGraph

if TYPE_CHECKING:
    from engine.world.network import NetworkPlan
    from engine.world.terrain import TerrainPlan

Cell = tuple[int, int]
"""(x, y), counted from 0 at the bottom left."""

LETTERS: dict[str, str] = {
    ".": "aisle",
    ">": "one-way aisle, east",
    "^": "one-way aisle, north",
    "<": "one-way aisle, west",
    "v": "one-way aisle, south",
    "I": "inbound station",
    "O": "outbound station",
    "R": "rack",
    "C": "charger",
    "P": "parking",
    "S": "storage shelf",
    "#": "wall",
}
"""What each letter of a drawing means."""

ONE_WAY: dict[str, int] = {">": 0, "^": 2, "<": 4, "v": 6}
"""Direction (index into grid.STEPS) in which a one-way cell is left."""

AISLES = "." + "".join(ONE_WAY)
STATIONS: dict[str, StationKind] = {"I": StationKind.INBOUND, "O": StationKind.OUTBOUND, "R": StationKind.RACK}
"""Letters of stations, in the order in which they are numbered."""
ENDPOINTS = "IORCP"
SIDES: dict[str, int] = {"south": 6, "north": 2, "west": 4, "east": 0}
"""Sides on which an endpoint looks for its access cell, in the order of preference."""


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """A floor as drawn.

    rows: equally long strings of LETTERS, top row first · access: endpoint's name → side of its access cell, for those
    that shall not use the first one in the order of SIDES · connectivity: 4 or 8.
    """

    rows: tuple[str, ...]
    motion: GridMotion = field(default_factory=GridMotion)
    access: Mapping[str, str] = field(default_factory=dict)
    connectivity: int = 4
    occupancy: Occupancy = Occupancy.HOLD
    margin_ticks: int = 0
    one_way: str = "lanes"


class HasFloorPlan(Protocol):
    """Anything that can say which floor it wants, such as a scenario."""

    def floor_plan(self) -> FloorPlan | NetworkPlan | TerrainPlan:
        """The floor as drawn, as nodes and arcs, or as ground."""
        ...


@dataclass(frozen=True, slots=True)
class Station:
    """A place where loads change hands; `access` is the aisle place before it, or -1 when it has none."""

    number: int
    name: str
    kind: StationKind
    place: int
    access: int


@dataclass(frozen=True, slots=True, eq=False)
class World(ABC):
    """A compiled floor with P places: what every kind of floor has. Immutable.

    Stations, chargers and parking are numbered in the floor's own reading order.
    """

    graph: MotionGraph
    occupancy: Occupancy
    margin_ticks: int
    stations: tuple[Station, ...]
    chargers: NDArray[np.int32]  # places
    parking: NDArray[np.int32]  # places
    access: NDArray[np.int32]  # (P,) access place of an endpoint, -1 for aisles and for endpoints without one
    endpoint: NDArray[np.bool_]  # (P,)
    names: tuple[str, ...] = field(repr=False)  # (P,) what a person calls each place: `R7 at (12, 7)` or `(3, 5)`

    @property
    @abstractmethod
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres."""

    @property
    @abstractmethod
    def grain_m(self) -> float:
        """The size of things on it: the side of a cell, the mean arc."""

    @abstractmethod
    def label(self, place: int) -> str:
        """What kind of place it is, and which: `cell (3, 5)`, `node N7`."""

    @abstractmethod
    def floor_json(self) -> dict[str, Any]:
        """What a browser needs to draw the floor: plain JSON values; lengths in metres, y upwards."""

    @property
    def n_places(self) -> int:
        return self.graph.n_places

    def station(self, number: int) -> Station:
        """The station with this number, from 1. Raises BadInput when there is none."""
        if not self.stations:
            raise BadInput(f"unknown station {number}; the floor has no stations")
        if not 1 <= number <= len(self.stations):
            raise BadInput(f"unknown station {number}; stations are numbered 1 to {len(self.stations)}")
        return self.stations[number - 1]

    def stations_of(self, kind: StationKind | str) -> tuple[Station, ...]:
        """Stations of one kind, by number; every station for `station`."""
        wanted = StationKind(kind)
        return tuple(s for s in self.stations if wanted in (StationKind.STATION, s.kind))

    def place_name(self, place: int) -> str:
        """What a person calls a place: `R7 at (12, 7)`, `C3 at (4, 0)` or `(3, 5)`."""
        return self.names[place]

    def spots(self) -> dict[str, Any]:
        """Places, stations, chargers and parking bays as floor_json tells them."""
        xy = np.round(self.graph.xy_m.astype(float), 4).tolist()

        def spot(place: int) -> dict[str, Any]:
            return {"place": place, "x": xy[place][0], "y": xy[place][1]}

        def bays(letter: str, places: NDArray[np.int32]) -> list[dict[str, Any]]:
            return [
                {"number": i, "name": f"{letter}{i}", **spot(place)} for i, place in enumerate(places.tolist(), start=1)
            ]

        return {
            "places": xy,
            "stations": [
                {"number": s.number, "name": s.name, "kind": str(s.kind), **spot(s.place)} for s in self.stations
            ],
            "chargers": bays("C", self.chargers),
            "parking": bays("P", self.parking),
        }


@dataclass(frozen=True, slots=True, eq=False)
class GridWorld(World):
    """A compiled drawing of W × H cells.

    Places are the cells that a vehicle may be in, row by row from the bottom; stations, chargers and parking are
    numbered in reading order (top row first, left to right).
    """

    cell_mm: int
    cells: NDArray[np.uint8]  # (H, W) codes of LETTERS, row 0 at the bottom
    place_of_cell: NDArray[np.int32]  # (H, W), -1 where no vehicle may be
    cell_of_place: NDArray[np.int32]  # (P, 2) as (x, y)

    @property
    def width(self) -> int:
        return int(self.cells.shape[1])

    @property
    def height(self) -> int:
        return int(self.cells.shape[0])

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres."""
        return self.width * self.cell_mm / 1000, self.height * self.cell_mm / 1000

    @property
    def grain_m(self) -> float:
        """The side of a cell."""
        return self.cell_mm / 1000

    def place_at(self, x: int, y: int) -> int:
        """The place of cell (x, y), or -1 when no vehicle may be there or it lies outside."""
        if not (0 <= x < self.width and 0 <= y < self.height):
            return NONE
        return int(self.place_of_cell[y, x])

    def label(self, place: int) -> str:
        """`cell (3, 5)`."""
        x, y = self.cell_of_place[place].tolist()
        return f"cell ({x}, {y})"

    def floor_json(self) -> dict[str, Any]:
        """What a browser needs to draw the floor: plain JSON values; lengths in metres, rows from the bottom."""
        spots = self.spots()
        xy = spots["places"]
        directed = [
            {
                "place": (place := int(self.place_of_cell[y, x])),
                "x": xy[place][0],
                "y": xy[place][1],
                "heading_deg": 45 * direction,
            }
            for letter, direction in ONE_WAY.items()
            for y, x in np.argwhere(self.cells == ord(letter)).tolist()
        ]
        return {
            "kind": "grid",
            "width": self.width,
            "height": self.height,
            "cell_m": self.grain_m,
            "cells": [row.tobytes().decode("ascii") for row in self.cells],
            **spots,
            "one_way": sorted(directed, key=lambda row: int(row["place"])),
        }


def cells_from_rows(rows: tuple[str, ...]) -> NDArray[np.uint8]:
    """(H, W) letter codes, row 0 at the bottom. Raises BadInput for unknown letters and rows of unequal length."""
    if not rows or not rows[0]:
        raise BadInput("a floor needs at least one cell")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise BadInput(f"row {number} of the floor has {len(row)} cells where row 1 has {len(rows[0])}")
        for column, letter in enumerate(row, start=1):
            if letter not in LETTERS:
                raise BadInput(f"row {number}, column {column} of the floor: {unknown_name('letter', letter, LETTERS)}")
    flat = np.frombuffer("".join(reversed(rows)).encode("ascii"), np.uint8)
    return flat.reshape(len(rows), len(rows[0])).copy()


def named_endpoints(cells: NDArray[np.uint8]) -> dict[str, Cell]:
    """Endpoint's name → cell, in the order of their numbers: stations I1…, O…, R… counted through; C1…; P1…."""
    names: dict[str, Cell] = {}
    number = 0
    for letter in ENDPOINTS:
        if letter not in STATIONS:
            number = 0
        for x, y in _reading_order(cells, letter):
            number += 1
            names[f"{letter}{number}"] = (x, y)
    return names


def build_world(source: FloorPlan | NetworkPlan | TerrainPlan | HasFloorPlan) -> World:
    """Compile a floor, or the floor of a scenario. Raises BadInput with one sentence when the plan is wrong."""
    from engine.world.network import NetworkPlan, build_network
    from engine.world.terrain import TerrainPlan, build_terrain

    plan = source if isinstance(source, FloorPlan | NetworkPlan | TerrainPlan) else source.floor_plan()
    if isinstance(plan, TerrainPlan):
        return build_terrain(plan)
    return build_grid(plan) if isinstance(plan, FloorPlan) else build_network(plan)


def build_grid(plan: FloorPlan) -> GridWorld:
    """Compile a drawing. Raises BadInput with one sentence when it is wrong.

    An endpoint without an aisle cell beside it is built all the same, cut off; the scenario's checks name it.
    """
    cells = cells_from_rows(plan.rows)
    height, width = cells.shape
    free = np.isin(cells, _codes(AISLES + ENDPOINTS))
    if not free.any():
        raise BadInput("no cell of the floor can hold a vehicle")
    ys, xs = np.nonzero(free)
    place_of_cell = np.full((height, width), NONE, np.int32)
    place_of_cell[ys, xs] = np.arange(len(xs), dtype=np.int32)
    cell_of_place = np.stack([xs, ys], 1).astype(np.int32)

    exits = aisle_exits(cells, plan.connectivity)
    if plan.one_way == "ways":
        exits &= ~against_lanes(cells)
    endpoints = named_endpoints(cells)
    for name, side in plan.access.items():
        if name not in endpoints:
            raise BadInput(unknown_name("endpoint", name, endpoints))
        if side not in SIDES:
            raise BadInput(f"access of {name}: {unknown_name('side', side, SIDES)}")
    access = np.full(len(xs), NONE, np.int32)
    is_endpoint = np.zeros(len(xs), np.bool_)
    for name, (x, y) in endpoints.items():
        place = place_of_cell[y, x]
        is_endpoint[place] = True
        towards = access_side(cells, x, y, plan.access.get(name))
        if towards is None:
            if name in plan.access:
                raise BadInput(f"access of {name}: there is no aisle cell {plan.access[name]} of ({x}, {y})")
            continue
        dx, dy = STEPS[towards]
        exits[y, x] |= 1 << towards
        exits[y + dy, x + dx] |= 1 << ((towards + 4) % 8)
        access[place] = place_of_cell[y + dy, x + dx]

    at = {cell: name for name, cell in endpoints.items()}

    def places(letter: str) -> NDArray[np.int32]:
        found = [place_of_cell[y, x] for x, y in _reading_order(cells, letter)]
        return np.array(found, np.int32)

    stations = tuple(
        Station(int(name[1:]), name, STATIONS[name[0]], int(p := place_of_cell[y, x]), int(access[p]))
        for name, (x, y) in endpoints.items()
        if name[0] in STATIONS
    )
    return GridWorld(
        graph=compile_grid(free, exits, plan.motion),
        occupancy=plan.occupancy,
        margin_ticks=plan.margin_ticks,
        cell_mm=plan.motion.cell_mm,
        stations=stations,
        chargers=_frozen(places("C")),
        parking=_frozen(places("P")),
        cells=_frozen(cells),
        place_of_cell=_frozen(place_of_cell),
        cell_of_place=_frozen(cell_of_place),
        access=_frozen(access),
        endpoint=_frozen(is_endpoint),
        names=tuple(f"{at[x, y]} at ({x}, {y})" if (x, y) in at else f"({x}, {y})" for x, y in cell_of_place.tolist()),
    )


def aisle_exits(cells: NDArray[np.uint8], connectivity: int = 4) -> NDArray[np.uint8]:
    """(H, W) exit bits between aisle cells only, as compile_grid takes them.

    A one-way cell is left only in its direction and not entered from its front. A diagonal joins plain aisle cells
    whose two corners are plain aisle cells too, so that it never sweeps an endpoint nor crosses a one-way lane.
    """
    aisle = np.isin(cells, _codes(AISLES))
    plain = cells == ord(".")
    exits = np.zeros(cells.shape, np.uint8)
    for direction in range(0, 8, 2):
        leaves = plain.copy()
        entered = aisle.copy()
        for letter, along in ONE_WAY.items():
            if along == direction:
                leaves |= cells == ord(letter)
            if along == (direction + 4) % 8:
                entered &= cells != ord(letter)
        exits |= ((leaves & _ahead(entered, *STEPS[direction])).astype(np.uint8) << direction).astype(np.uint8)
    if connectivity == 8:
        for direction in range(1, 8, 2):
            dx, dy = STEPS[direction]
            ok = plain & _ahead(plain, dx, dy) & _ahead(plain, dx, 0) & _ahead(plain, 0, dy)
            exits |= (ok.astype(np.uint8) << direction).astype(np.uint8)
    return exits


def against_lanes(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W) exit bits against the lanes: on a straight road all cells are left in the direction of its lanes, if they
    agree on one. Diagonals are against them all.
    """
    out = np.full(cells.shape, 0b10101010, np.uint8)
    for lines, marks, turned in ((cells, out, "><"), (cells.T, out.T, "^v")):
        east, west = (ord(letter) for letter in turned)
        back = {east: ONE_WAY[turned[1]], west: ONE_WAY[turned[0]]}
        for line, mark in zip(lines, marks, strict=True):
            aisle = np.concatenate([[False], np.isin(line, _codes(AISLES)), [False]])
            begins, ends = np.flatnonzero(np.diff(aisle.astype(np.int8)) == 1), np.flatnonzero(~aisle[1:] & aisle[:-1])
            for a, b in zip(begins.tolist(), ends.tolist(), strict=True):
                found = set(line[a:b].tolist()) & {east, west}
                if len(found) == 1:
                    mark[a:b] |= 1 << back[found.pop()]
    return out


def access_side(cells: NDArray[np.uint8], x: int, y: int, named: str | None) -> int | None:
    """Direction of the access cell of an endpoint: the named side, else the first of SIDES with an aisle cell."""
    height, width = cells.shape
    for side in (SIDES[named],) if named else SIDES.values():
        dx, dy = STEPS[side]
        if 0 <= x + dx < width and 0 <= y + dy < height and chr(cells[y + dy, x + dx]) in AISLES:
            return side
    return None


def _ahead(mask: NDArray[np.bool_], dx: int, dy: int) -> NDArray[np.bool_]:
    """mask shifted so that out[y, x] = mask[y + dy, x + dx], False outside."""
    height, width = mask.shape
    out = np.zeros_like(mask)
    to_y = slice(max(-dy, 0), height - max(dy, 0))
    to_x = slice(max(-dx, 0), width - max(dx, 0))
    from_y = slice(max(dy, 0), height - max(-dy, 0))
    from_x = slice(max(dx, 0), width - max(-dx, 0))
    out[to_y, to_x] = mask[from_y, from_x]
    return out


def _reading_order(cells: NDArray[np.uint8], letter: str) -> Iterator[Cell]:
    """Cells with this letter as (x, y): top row first, left to right."""
    ys, xs = np.nonzero(cells[::-1] == ord(letter))
    for y, x in zip(ys.tolist(), xs.tolist(), strict=True):
        yield x, cells.shape[0] - 1 - y


def _codes(letters: str) -> NDArray[np.uint8]:
    return np.frombuffer(letters.encode("ascii"), np.uint8)


def _frozen(array: Any) -> Any:
    array.setflags(write=False)
    return array
