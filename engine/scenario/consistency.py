"""What the fields of a scenario must say together; needs no compiled world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name
from engine.scenario.blocks import MAX_CELLS
from engine.scenario.model import Scenario
from engine.scenario.toml_text import Path
from engine.types import StationKind
from engine.world.floor import (
    AISLES,
    ENDPOINTS,
    LETTERS,
    SIDES,
    STATIONS,
    access_side,
    build_world,
    cells_from_rows,
    named_endpoints,
)


@dataclass(frozen=True, slots=True)
class Problem:
    """What is wrong and where: path of the field, sentence, and row of the drawing when it is about one."""

    path: Path
    text: str
    row: int | None = None


def problems_of(scenario: Scenario) -> list[Problem]:
    """Every contradiction within a scenario whose single fields are fine; empty when there is none."""
    problems = [*_floor(scenario), *_levels(scenario), *_times(scenario)]
    if problems and any(p.path[0] == "floor" for p in problems):
        return problems  # stations and cells can't be named on a floor that is wrong
    if scenario.floor.kind == "network":
        return [*problems, *_network(scenario)]
    if scenario.battery.exchange == "charge":
        text = "only the entrances of a network charge; on other floors draw chargers (C)"
        problems.append(Problem(("battery", "exchange"), text))
    cells = cells_from_rows(scenario.floor.drawing())
    counts = {kind: int((cells == ord(letter)).sum()) for letter, kind in STATIONS.items()}
    return [*problems, *_access(scenario, cells), *_orders(scenario, counts, cells), *_fleet(scenario, cells)]


def _network(scenario: Scenario) -> Iterator[Problem]:
    """A network that can be compiled, and orders and starts that fit it."""
    from engine.world.network import NetworkWorld

    try:
        world = build_world(scenario)
    except BadInput as error:
        yield Problem(("floor", "network"), str(error))
        return
    assert isinstance(world, NetworkWorld)
    counts = {kind: len(world.stations_of(kind)) for kind in StationKind}
    yield from _orders(scenario, counts)
    if scenario.fleet.heading != "best":
        text = f"got {scenario.fleet.heading!r}; on a network vehicles look along their kerbs ('best')"
        yield Problem(("fleet", "heading"), text)
    if not isinstance(scenario.fleet.start, str):
        yield Problem(("fleet", "start"), "a network has no cells; vehicles start on its kerbs ('parking')")
    elif scenario.fleet.count > len(world.parking):
        text = f"got {scenario.fleet.count} vehicles, expected at most {len(world.parking)}: so many kerbs there are"
        yield Problem(("fleet", "count"), text)


def _floor(scenario: Scenario) -> Iterator[Problem]:
    floor = scenario.floor
    if floor.network is not None and floor.kind != "network":
        yield Problem(("floor", "network"), "only a floor of kind 'network' has this table")
    if floor.terrain is not None and floor.kind != "terrain":
        yield Problem(("floor", "terrain"), "only a floor of kind 'terrain' has this table")
    if floor.kind == "terrain":
        yield from _terrain(scenario)
        return
    if floor.kind == "network":
        for key in ("rows", "blocks", "map"):
            if getattr(floor, key) is not None:
                yield Problem(("floor", key), f"a floor of kind 'network' has no {key}")
        if floor.network is None or (floor.network.mesh is None) == (not floor.network.nodes):
            text = "a floor of kind 'network' needs a table [floor.network] with either `mesh` or `nodes` and `arcs`"
            yield Problem(("floor", "network" if floor.network is not None else "kind"), text)
        return
    if floor.kind == "blocks":
        if floor.rows is not None:
            yield Problem(("floor", "rows"), "a floor of kind 'blocks' is generated and has no rows")
        if floor.blocks is None:
            yield Problem(("floor", "kind"), "a floor of kind 'blocks' needs a table [floor.blocks]")
            return
        try:
            floor.drawing()
        except BadInput as error:
            yield Problem(("floor", "blocks"), str(error))
        return
    if floor.blocks is not None:
        yield Problem(("floor", "blocks"), "only a floor of kind 'blocks' has this table")
    if floor.map is not None:
        text = "a map beside the scenario is read when the scenario is a file; here `rows` must hold the map's rows"
        if floor.kind != "movingai":
            text = f"only a floor of kind 'movingai' has a map; this one is of kind {floor.kind!r}"
        yield Problem(("floor", "map"), text)
        return
    rows = floor.drawing()
    if not rows:
        yield Problem(("floor", "rows" if floor.rows is not None else "kind"), "a drawn floor needs rows of letters")
        return
    if sum(map(len, rows)) > MAX_CELLS:
        yield Problem(("floor", "rows"), f"a floor has at most {MAX_CELLS:,} cells")
        return
    # MovingAI's letters are already translated here: what is left untranslated is unknown
    letters, known = (".#", ".GSE@OTW") if floor.kind == "movingai" else ("".join(LETTERS), "".join(LETTERS))
    for number, row in enumerate(rows):
        if len(row) != len(rows[0]):
            text = f"row {number + 1} has {len(row)} cells, expected {len(rows[0])} as in row 1"
            yield Problem(("floor", "rows"), text, number)
        for column, letter in enumerate(row):
            if letter not in letters:
                text = f"row {number + 1}, column {column + 1}: {unknown_name('letter', letter, known)}"
                yield Problem(("floor", "rows"), text, number)
                break
    if not any(letter in AISLES + ENDPOINTS for row in rows for letter in row):
        yield Problem(("floor", "rows"), "no cell of the floor can hold a vehicle")


def _terrain(scenario: Scenario) -> Iterator[Problem]:
    """Ground that can be made, and one robot that goes somewhere on it."""
    floor = scenario.floor
    for key in ("rows", "blocks"):
        if getattr(floor, key) is not None:
            yield Problem(("floor", key), f"a floor of kind 'terrain' has no {key}")
    if floor.terrain is None:
        yield Problem(("floor", "kind"), "a floor of kind 'terrain' needs a table [floor.terrain]")
        return
    if floor.map is not None:
        text = "a map beside the scenario is read when the scenario is a file; here `terrain.heights` must hold it"
        yield Problem(("floor", "map"), text)
    try:
        build_world(scenario)
    except BadInput as error:
        yield Problem(("floor", "terrain"), str(error))
        return
    if floor.occupancy != "hold":
        yield Problem(("floor", "occupancy"), f"got {floor.occupancy!r}; terrain needs 'hold'")
    if scenario.fleet.count != 1:
        yield Problem(("fleet", "count"), f"got {scenario.fleet.count}; one robot drives on terrain")
    if isinstance(scenario.fleet.start, str):
        text = f"got {scenario.fleet.start!r}; on terrain the robot starts in a cell [[x, y]]"
        yield Problem(("fleet", "start"), text)
    if scenario.orders.source != "goals":
        yield Problem(("orders", "source"), f"got {scenario.orders.source!r}; on terrain the robot has one of 'goals'")


def _access(scenario: Scenario, cells: NDArray[np.uint8]) -> Iterator[Problem]:
    endpoints = named_endpoints(cells)
    for name, side in scenario.floor.access.items():
        if name not in endpoints:
            yield Problem(("floor", "access", name), unknown_name("endpoint", name, endpoints))
            continue
        x, y = endpoints[name]
        if access_side(cells, x, y, side) is None:
            sides = [s for s in SIDES if access_side(cells, x, y, s) is not None]
            good = f"; there is one {' and '.join(sides)}" if sides else ""
            yield Problem(("floor", "access", name), f"there is no aisle cell {side} of ({x}, {y}){good}")


def _levels(scenario: Scenario) -> Iterator[Problem]:
    charging = scenario.charging
    names = ("reserve", "critical", "good", "sufficient", "full")
    for low, high in pairwise(names):
        a, b = getattr(charging, low), getattr(charging, high)
        if a > b:
            yield Problem(("charging", low), f"got {a:g}, expected at most charging.{high}, which is {b:g}")
    if isinstance(soc := scenario.battery.initial_soc, tuple) and soc[0] > soc[1]:
        yield Problem(("battery", "initial_soc"), f"got [{soc[0]:g}, {soc[1]:g}], expected [low, high]")


def _times(scenario: Scenario) -> Iterator[Problem]:
    time, orders = scenario.time, scenario.orders
    if time.until_s is not None and time.until_s < time.tick_s:
        yield Problem(("time", "until_s"), f"got {time.until_s:g}, expected at least one tick of {time.tick_s:g} s")
    for key in ("sample_s", "keyframe_s"):
        if (value := getattr(scenario.log, key)) < time.tick_s:
            yield Problem(("log", key), f"got {value:g}, expected at least one tick of {time.tick_s:g} s")
    if time.finish != "never" and orders.source in ("poisson", "backlog") and orders.limit is None:
        text = f"got {time.finish!r}, but {orders.source} orders without orders.limit are never all done"
        yield Problem(("time", "finish"), text)
    if (time.finish == "goals reached") != (orders.source == "goals") and time.finish != "never":
        wanted = "'goals reached' or 'never'" if orders.source == "goals" else "an end that orders can bring"
        yield Problem(
            ("time", "finish"), f"got {time.finish!r}, but orders.source is {orders.source!r}: expected {wanted}"
        )
    low, high = scenario.faults.delay_ticks
    if low > high:
        yield Problem(("faults", "delay_ticks"), f"got [{low}, {high}], expected [shortest, longest]")


def _orders(
    scenario: Scenario, counts: Mapping[StationKind, int], cells: NDArray[np.uint8] | None = None
) -> Iterator[Problem]:
    """counts: stations of each kind · cells: of a floor that has some."""
    orders = scenario.orders
    if orders.source == "goals":
        if cells is None:
            yield Problem(("orders", "source"), "got 'goals', which are cells, and a network has none")
        else:
            yield from _cells(scenario, cells, orders.goals, ("orders", "goals"))
        return
    total = sum(n for kind, n in counts.items() if kind is not StationKind.STATION)
    if orders.source == "listed":
        if not orders.pairs:
            yield Problem(("orders", "pairs"), "listed orders need at least one pair of station numbers")
        for i, pair in enumerate(orders.pairs):
            for number in pair:
                if number > total:
                    text = f"unknown station {number}; the floor has stations 1 to {total}"
                    yield Problem(("orders", "pairs", i), text)
        return
    for i, item in enumerate(orders.mix):
        for key, kind in (("from", item.from_), ("to", item.to)):
            if not (total if kind == "station" else counts.get(StationKind(kind), 0)):
                yield Problem(("orders", "mix", i, key), f"the floor has no {kind} station")


def _fleet(scenario: Scenario, cells: NDArray[np.uint8]) -> Iterator[Problem]:
    start = scenario.fleet.start
    if not isinstance(start, str):
        yield from _cells(scenario, cells, start, ("fleet", "start"))


def _cells(
    scenario: Scenario, cells: NDArray[np.uint8], given: tuple[tuple[int, int], ...], path: Path
) -> Iterator[Problem]:
    """One cell per vehicle, each on the floor, passable and given once."""
    height, width = cells.shape
    if len(given) != scenario.fleet.count:
        yield Problem(path, f"got {len(given)} cells for {scenario.fleet.count} vehicles; expected one each")
    seen: set[tuple[int, int]] = set()
    for i, (x, y) in enumerate(given):
        if x >= width or y >= height:
            yield Problem((*path, i), f"({x}, {y}) lies outside the floor of {width} × {height} cells")
        elif (letter := chr(cells[y, x])) not in AISLES + ENDPOINTS:
            yield Problem((*path, i), f"({x}, {y}) is a {LETTERS[letter]}; a vehicle can't be there")
        elif (x, y) in seen:
            yield Problem((*path, i), f"({x}, {y}) is taken twice")
        seen.add((x, y))
