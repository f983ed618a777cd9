"""A generated warehouse: storage blocks between aisles, as a drawing.

Walls all round; inside them a two-lane ring road, driven on the right; between the blocks one-way aisles that alternate
their direction, and two-lane main roads. Crossings are open to all sides, so that the lanes stay strongly connected.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput

MAX_CELLS = 1_000_000
"""A larger floor is refused."""


def rows_of_blocks(
    *,
    columns: int,
    rows: int,
    block_width: int,
    block_height: int,
    aisle_width: int,
    main_every: int,
    racks: int,
    inbound: int,
    outbound: int,
    exits: int,
    chargers: int,
    parking: int,
) -> tuple[str, ...]:
    """Rows of letters (see engine.world.floor.LETTERS), top row first. Raises BadInput when something has no room.

    Blocks are block_width × block_height cells of storage. Racks and parking bays replace storage cells beside an
    aisle; stations and chargers replace wall cells beside the ring road: inbound west, outbound east, chargers south,
    then north. Exits are outbound stations too, at the ends of the eastbound lanes of aisles.
    """
    across = _lanes(columns, block_width, aisle_width, main_every, first=-1)  # the northbound lane lies east
    along = _lanes(rows, block_height, aisle_width, main_every, first=1)  # the eastbound lane lies south
    width, height = len(across), len(along)
    if width * height > MAX_CELLS:
        raise BadInput(f"{width} × {height} cells are more than {MAX_CELLS:,}")
    cells = np.full((height, width), "S", "<U1")
    for y, lane in enumerate(along):
        if lane:
            cells[y, :] = ">" if lane > 0 else "<"
    for x, lane in enumerate(across):
        if lane:
            cells[:, x] = "^" if lane > 0 else "v"
    cells[np.outer(np.array(along) != 0, np.array(across) != 0)] = "."
    cells[0, :] = cells[-1, :] = "#"
    cells[:, 0] = cells[:, -1] = "#"

    blocks = [(low, high, left, right) for low, high in reversed(_runs(along)) for left, right in _runs(across)]
    racks_of, bays_of = _shares(racks, len(blocks)), _shares(parking, len(blocks))
    for (low, high, left, right), n_racks, n_bays in zip(blocks, racks_of, bays_of, strict=True):
        beside_aisle = [(y, x) for y in dict.fromkeys((low, high)) for x in range(left, right + 1)]
        if n_racks + n_bays > len(beside_aisle):
            raise BadInput(
                f"{len(blocks)} blocks have {len(blocks) * len(beside_aisle)} storage cells beside an aisle; "
                f"{racks} racks and {parking} parking bays were asked for"
            )
        for i, at in enumerate(_spread(len(beside_aisle), n_racks + n_bays)):
            cells[beside_aisle[at]] = "R" if i < n_racks else "P"

    south = [(0, x) for x in range(1, width - 1) if cells[1, x] in "><"]
    north = [(height - 1, x) for x in range(1, width - 1) if cells[height - 2, x] in "><"]
    west = [(y, 0) for y in range(height - 2, 0, -1) if cells[y, 1] in "^v"]
    east = [(y, width - 1) for y in range(height - 2, 0, -1) if cells[y, width - 2] in "^v"]
    ends = [(y, x) for y in _from_middle(along) for x in (0, width - 1)]
    if exits > len(ends):
        raise BadInput(f"there is room for {len(ends)} exits at the ends of aisles; {exits} were asked for")
    for end in ends[:exits]:
        cells[end] = "O"
    _place(cells, west, inbound, "I", "inbound stations on the west side")
    _place(cells, east, outbound, "O", "outbound stations on the east side")
    if chargers > len(south):
        _place(cells, south, len(south), "C", "chargers")
        _place(cells, north, chargers - len(south), "C", "chargers on the south and north sides")
    else:
        _place(cells, south, chargers, "C", "chargers")
    return tuple("".join(row) for row in cells[::-1])


def _lanes(blocks: int, size: int, aisle_width: int, main_every: int, first: int) -> list[int]:
    """Along one axis: 0 is block or wall, +1 a lane towards east or north, -1 towards west or south.

    first: direction of the first lane of a two-lane road, and of the first one-way aisle.
    """
    road = [first, -first]
    out = [0, *road]
    direction = first
    for block in range(1, blocks + 1):
        out += [0] * size
        if block == blocks:
            continue
        if aisle_width == 2 or (main_every and block % main_every == 0):
            out += road
        else:
            out.append(direction)
            direction = -direction
    return [*out, *road, 0]


def _runs(lanes: list[int]) -> list[tuple[int, int]]:
    """First and last index of every block along an axis; the walls at both ends are none."""
    runs: list[tuple[int, int]] = []
    for i in range(1, len(lanes) - 1):
        if lanes[i] == 0:
            runs = [*runs[:-1], (runs[-1][0], i)] if runs and runs[-1][1] == i - 1 else [*runs, (i, i)]
    return runs


def _from_middle(lanes: list[int]) -> list[int]:
    """First lanes of the aisles between the blocks, the ring road left out, the middle one first."""
    aisles = [below + 1 for (_, below), _ in pairwise(_runs(lanes))]
    return sorted(aisles, key=lambda y: (abs(2 * y + 1 - len(lanes)), y))


def _shares(n: int, parts: int) -> list[int]:
    """n things dealt out evenly over the parts."""
    return [(i + 1) * n // parts - i * n // parts for i in range(parts)]


def _spread(n: int, k: int) -> list[int]:
    """k indices below n, evenly spaced."""
    return [(2 * i + 1) * n // (2 * k) for i in range(k)]


def _place(cells: NDArray[np.str_], slots: list[tuple[int, int]], count: int, letter: str, what: str) -> None:
    if count > len(slots):
        raise BadInput(f"there is room for {len(slots)} {what}; {count} were asked for")
    for at in _spread(len(slots), count):
        cells[slots[at]] = letter
