"""What a lesson is, and how floors, cells and columns of numbers stand in addresses and answers."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput
from engine.scenario.movingai import random_floor

Query = Mapping[str, str]
"""A lesson's state as it stands in its address."""
Cell = tuple[int, int]
Mask = NDArray[np.bool_]

SIDES = (2, 60)
"""Cells along a side of a lesson's floor."""
DENSEST = 35
"""Per cent of obstacles on a random floor: above, hardly any connects two corners."""
TEXT_LIMIT = 2000

HEADINGS = ("east", "north", "west", "south")
_FLOOR = re.compile(r"(\d{1,4})x(\d{1,4})(?:r(\d{1,3})s(\d{1,9})|b([A-Za-z0-9_-]*))?")
_CELL = re.compile(r"(\d{1,4})\.(\d{1,4})")


@dataclass(frozen=True)
class Preset:
    """A state to begin with: the word on its button, the state, and what to look at."""

    word: str
    query: Query
    look: str


@dataclass(frozen=True)
class Lesson:
    """One lesson.

    title, summary: of its card · presets: the first is what an empty address shows · keys: of a state, all others are
    ignored · read: checks a state, raising BadInput with the sentence to show · answer: state → what its script plays,
    JSON-ready; raises BadInput · text: the explanation beside it, as Dash components · options: what its script offers.
    """

    title: str
    summary: str
    presets: tuple[Preset, ...]
    keys: tuple[str, ...]
    read: Callable[[Query], Any]
    answer: Callable[[Query], Mapping[str, Any]]
    text: Callable[[], Sequence[Any]]
    options: Mapping[str, Any] = field(default_factory=dict)

    def begin(self, query: Query) -> tuple[dict[str, str], str]:
        """The state of an address, and the sentence that says what was wrong with it: then the default is shown."""
        asked = {key: str(query[key]) for key in self.keys if query.get(key)}
        state = {**self.presets[0].query, **asked} if asked else dict(self.presets[0].query)
        try:
            self.read(state)
        except BadInput as error:
            sentence = f"This address can't be shown: {error}. Here is the first example instead."
            return dict(self.presets[0].query), sentence
        return state, ""


def checked_state(asked: Mapping[str, Any], keys: Sequence[str]) -> dict[str, str]:
    """The texts of a request by their known keys; empty ones count as absent. Raises BadInput."""
    state = {key: asked[key] for key in keys if asked.get(key)}
    for key, value in state.items():
        if not isinstance(value, str) or len(value) > TEXT_LIMIT:
            raise BadInput(f"{key}: a text of at most {TEXT_LIMIT} characters was expected")
    return state


def read_floor(text: str, connected: Sequence[Cell] = ()) -> Mask:
    """Free cells (H, W), row 0 at the bottom, of `20x12`, of `20x12b…` (obstacles as bits, base64url, row by row from
    the bottom) or of `20x12r15s7` (15 % random obstacles, seed 7, connecting the cells given). Raises BadInput.
    """
    match = _FLOOR.fullmatch(text)
    if not match:
        raise BadInput(f"map: {text[:40]!r} was got, a text such as 20x20, 20x20r20s7 or 20x20b… was expected")
    width, height = int(match[1]), int(match[2])
    for side in (width, height):
        if not SIDES[0] <= side <= SIDES[1]:
            near = min(max(side, SIDES[0]), SIDES[1])
            raise BadInput(f"map: sides of {SIDES[0]} to {SIDES[1]} cells were expected, got {side}; nearest: {near}")
    if match[3] is not None:
        density, seed = int(match[3]), int(match[4])
        if density > DENSEST:
            raise BadInput(f"map: a density of 0 to {DENSEST} % was expected, got {density}; nearest: {DENSEST}")
        inside = [cell for cell in connected if cell[0] < width and cell[1] < height]
        return random_floor(np.random.default_rng(seed), width, height, density / 100, list(dict.fromkeys(inside)))
    free = np.ones((height, width), np.bool_)
    if match[5] is not None:
        free.ravel()[:] = ~_bits(match[5], width * height)
    return free


def _bits(text: str, count: int) -> Mask:
    try:
        packed = np.frombuffer(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)), np.uint8)
    except (binascii.Error, ValueError):
        raise BadInput("map: the obstacles are no base64") from None
    if len(packed) != (count + 7) // 8:
        raise BadInput(f"map: {(count + 7) // 8} bytes of obstacles were expected, got {len(packed)}")
    return np.unpackbits(packed, count=count, bitorder="little").astype(np.bool_)


def floor_text(free: Mask) -> str:
    """A floor as `read_floor` reads it."""
    height, width = free.shape
    if free.all():
        return f"{width}x{height}"
    bits = np.packbits(~free.ravel(), bitorder="little").tobytes()
    return f"{width}x{height}b{base64.urlsafe_b64encode(bits).decode().rstrip('=')}"


def drawn(*rows: str) -> str:
    """The text of a floor drawn with `.` free and `#` obstacle, the top row first."""
    return floor_text(np.array([[letter == "." for letter in row] for row in reversed(rows)], np.bool_))


def read_cell(text: str, what: str) -> Cell:
    """A cell `column.row`, counted from the bottom left corner. Raises BadInput."""
    match = _CELL.fullmatch(text)
    if not match:
        raise BadInput(f"{what}: {text[:20]!r} was got, column.row such as 0.0 was expected")
    return int(match[1]), int(match[2])


def check_cell(cell: Cell, what: str, free: Mask) -> None:
    """Raises BadInput when a cell is outside the floor or an obstacle."""
    height, width = free.shape
    x, y = cell
    if x >= width or y >= height:
        raise BadInput(f"{what}: {x}.{y} is outside the floor of {width} × {height} cells; nearest: "
                       f"{min(x, width - 1)}.{min(y, height - 1)}")  # fmt: skip
    if not free[y, x]:
        raise BadInput(f"{what}: {x}.{y} is an obstacle")


def read_question(query: Query) -> tuple[Mask, Cell, Cell]:
    """Floor, start and goal of an address, the ends free and apart. Raises BadInput."""
    start, goal = read_cell(query["start"], "start"), read_cell(query["goal"], "goal")
    free = read_floor(query["map"], (start, goal))
    check_cell(start, "start", free)
    check_cell(goal, "goal", free)
    if start == goal:
        raise BadInput(f"goal: it lies at the start, {goal[0]}.{goal[1]}")
    return free, start, goal


def read_whole(text: str, what: str, low: int, high: int, default: int) -> int:
    """A whole number within limits; the default for an empty text. Raises BadInput."""
    if text == "":
        return default
    if not re.fullmatch(r"\d{1,9}", text) or not low <= int(text) <= high:
        raise BadInput(f"{what}: a whole number from {low} to {high} was expected, got {text[:20]!r}")
    return int(text)


def floor_answer(free: Mask) -> dict[str, Any]:
    """A floor as its script draws it: obstacles as a text of 0 and 1, row by row from the bottom."""
    height, width = free.shape
    return {
        "width": width,
        "height": height,
        "walls": "".join("0" if cell else "1" for cell in free.ravel().tolist()),
        "map": floor_text(free),
    }


def packed(columns: Mapping[str, Sequence[int] | NDArray[Any]]) -> dict[str, str]:
    """Columns of 32-bit integers, little-endian, as base64."""
    return {name: base64.b64encode(np.asarray(v, "<i4").tobytes()).decode() for name, v in columns.items()}
