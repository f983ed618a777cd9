"""MovingAI maps and scenarios: readers, writers and seeded generators.

A file's origin is its top left corner; everything here has y growing upwards, as `compile_grid` wants it. `_flip` is
the one place where the two meet. Passable: `.` `G` `S` `E`; blocked: `@` `O` `T` `W`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import FormatError
from engine.world.grid import GridMotion, compile_grid
from engine.world.motion_graph import MotionGraph

PASSABLE = ".GSE"
BLOCKED = "@OTW"
MAX_BYTES = 100_000_000
"""A larger file is refused before it is read."""
MAX_SIDE = 16_384
"""Cells along a side of a map, at most."""
FOUR = 0b01010101
"""Exits of a cell of a 4-connected grid."""

Mask = NDArray[np.bool_]
Cell = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Trip:
    """One row of a scenario; cells are (x, y), y upwards. `line`: where it stands in its file, 0 when in none."""

    bucket: int
    map: str
    width: int
    height: int
    start: Cell
    goal: Cell
    optimal: float = 0.0
    line: int = 0


@dataclass(frozen=True, slots=True)
class Instance:
    """k vehicles on a grid. free: (H, W), row 0 at the bottom · starts, goals: k cells (x, y) each."""

    name: str
    free: Mask
    starts: tuple[Cell, ...]
    goals: tuple[Cell, ...]

    @property
    def agents(self) -> int:
        return len(self.starts)

    def first(self, agents: int) -> Instance:
        """The same floor with the first so many vehicles. Raises FormatError when there are fewer."""
        if not 0 <= agents <= self.agents:
            raise FormatError(f"{self.name}: {agents} vehicles were asked for; there are {self.agents}")
        return Instance(self.name, self.free, self.starts[:agents], self.goals[:agents])

    def graph(self, motion: GridMotion | None = None) -> MotionGraph:
        """Its 4-connected motion graph; every motion lasts one tick unless told otherwise."""
        return compile_grid(self.free, np.full(self.free.shape, FOUR, np.uint8), motion or GridMotion())

    def place(self, cell: Cell) -> int:
        """Number of a free cell among the places of the graph."""
        x, y = cell
        return int(self.free[:y].sum() + self.free[y, :x].sum())


def _flip(y: int, height: int) -> int:
    """From y downwards to y upwards, and back."""
    return height - 1 - y


# -- reading ----------------------------------------------------------------------------------------------------------


def read_map(path: str | Path) -> Mask:
    """Free cells of a `.map` file, row 0 at the bottom. Raises FormatError."""
    return parse_map(_text(path), Path(path).name)


def read_scen(path: str | Path) -> tuple[Trip, ...]:
    """Rows of a `.scen` file. Raises FormatError."""
    return parse_scen(_text(path), Path(path).name)


def read_instance(map_path: str | Path, scen_path: str | Path, agents: int | None = None) -> Instance:
    """The first `agents` rows of a scenario (all by default) on a map. Raises FormatError."""
    free = read_map(map_path)
    return instance_of(free, read_scen(scen_path), agents, Path(map_path).stem, Path(scen_path).name)


def parse_map(text: str, source: str = "<map>") -> Mask:
    """Free cells of a map's text, row 0 at the bottom. Raises FormatError with the line."""
    lines = text.removeprefix("\ufeff").splitlines()
    sides: dict[str, int] = {}
    at = 0
    for at, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        word = words[0].lower()
        if word == "map" and len(words) == 1:
            break
        if word == "type" and len(words) == 2:
            continue
        if word not in ("height", "width") or len(words) != 2:
            raise _wrong(source, at, f"'type', 'height', 'width' or 'map' was expected, got {_cut(line)}")
        if word in sides:
            raise _wrong(source, at, f"a second {word}")
        sides[word] = _whole(words[1], word, source, at)
        if not 1 <= sides[word] <= MAX_SIDE:
            raise _wrong(source, at, f"{word} must be 1…{MAX_SIDE}, got {sides[word]}")
    else:
        raise _wrong(source, len(lines), "the line 'map' is missing")
    for side in ("height", "width"):
        if side not in sides:
            raise _wrong(source, at, f"{side!r} is missing before 'map'")
    height, width = sides["height"], sides["width"]
    rows = [line.rstrip() for line in lines[at:]]
    while rows and not rows[-1]:
        rows.pop()
    if len(rows) != height:
        raise _wrong(source, at + min(len(rows), height) + 1, f"{height} rows were expected, got {len(rows)}")
    free = np.zeros((height, width), np.bool_)
    known = set(PASSABLE + BLOCKED)
    for i, row in enumerate(rows):
        if len(row) != width:
            raise _wrong(source, at + 1 + i, f"a row of {width} cells was expected, got {len(row)}")
        if not known.issuperset(row):
            x = next(x for x, letter in enumerate(row) if letter not in known)
            raise _wrong(
                source,
                at + 1 + i,
                f"column {x + 1}: one of {' '.join(PASSABLE + BLOCKED)} was expected, got {row[x]!r}",
            )
        free[_flip(i, height)] = [letter in PASSABLE for letter in row]
    return free


def parse_scen(text: str, source: str = "<scen>") -> tuple[Trip, ...]:
    """Rows of a scenario's text. Raises FormatError with the line."""
    lines = iter(enumerate(text.removeprefix("\ufeff").splitlines(), 1))
    for at, line in lines:
        words = line.split()
        if not words:
            continue
        if len(words) != 2 or words[0].lower() != "version" or words[1] not in ("1", "1.0"):
            raise _wrong(source, at, f"'version 1' was expected, got {_cut(line)}")
        break
    else:
        raise _wrong(source, 1, "'version 1' was expected, got nothing")
    return tuple(_trip(line, source, at) for at, line in lines if line.strip())


def _trip(line: str, source: str, at: int) -> Trip:
    # a map's name may hold spaces where tabs separate
    fields = [field.strip() for field in line.strip().split("\t")] if "\t" in line else line.split()
    if len(fields) != 9:
        fields = line.split()
    if len(fields) != 9:
        raise _wrong(
            source, at, "9 fields were expected (bucket, map, width, height, start x y, goal x y, length), "
            f"got {len(fields)}: {_cut(line)}"
        )  # fmt: skip
    names = ("width", "height", "start x", "start y", "goal x", "goal y")
    width, height, *xy = (_whole(fields[2 + i], name, source, at) for i, name in enumerate(names))
    for i, name in enumerate(names[2:]):
        if not 0 <= xy[i] < (width, height)[i % 2]:
            raise _wrong(source, at, f"{name} must be 0…{(width, height)[i % 2] - 1}, got {xy[i]}")
    try:
        optimal = float(fields[8])
    except ValueError:
        raise _wrong(source, at, f"a length was expected, got {fields[8]!r}") from None
    start, goal = (xy[0], _flip(xy[1], height)), (xy[2], _flip(xy[3], height))
    return Trip(_whole(fields[0], "bucket", source, at), fields[1], width, height, start, goal, optimal, at)


def instance_of(
    free: Mask, trips: Sequence[Trip], agents: int | None = None, name: str = "<map>", source: str = "<scen>"
) -> Instance:
    """The first `agents` trips (all by default) on a floor; each start and goal is free and taken once.

    Raises FormatError with the line.
    """
    wanted = len(trips) if agents is None else agents
    if not 0 <= wanted <= len(trips):
        raise FormatError(f"{source}: {wanted} vehicles were asked for; it has {len(trips)} rows")
    height, width = free.shape
    taken: dict[tuple[str, Cell], int] = {}
    for trip in trips[:wanted]:
        if (trip.width, trip.height) != (width, height):
            got = f"{trip.width} × {trip.height}"
            raise _wrong(source, trip.line, f"the map {name} is {width} × {height} cells, the row says {got}")
        for word, cell in (("start", trip.start), ("goal", trip.goal)):
            shown = f"{word} ({cell[0]}, {_flip(cell[1], height)})"
            if not free[cell[1], cell[0]]:
                raise _wrong(source, trip.line, f"{shown} is blocked on the map {name}")
            if (word, cell) in taken:
                raise _wrong(source, trip.line, f"{shown} is taken by line {taken[word, cell]}")
            taken[word, cell] = trip.line
    chosen = trips[:wanted]
    return Instance(name, free, tuple(t.start for t in chosen), tuple(t.goal for t in chosen))


def _text(path: str | Path) -> str:
    file = Path(path)
    try:
        if file.stat().st_size > MAX_BYTES:
            raise FormatError(f"{file.name}: at most {MAX_BYTES:,} bytes are read, got {file.stat().st_size:,}")
        return file.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{file.name}: UTF-8 text was expected; byte {error.start} is not") from error
    except OSError as error:
        raise FormatError(f"{file}: can't be read: {error.strerror or error}") from error


def _wrong(source: str, line: int, text: str) -> FormatError:
    return FormatError(f"{source}, line {line}: {text}" if line else f"{source}: {text}")


def _cut(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "…")


def _whole(text: str, what: str, source: str, line: int) -> int:
    try:
        # int() alone would take 1_000 and other scripts' digits
        if not text.isascii() or "_" in text:
            raise ValueError
        return int(text)
    except ValueError:
        raise _wrong(source, line, f"{what}: a whole number was expected, got {_cut(text)}") from None


# -- writing ----------------------------------------------------------------------------------------------------------


def map_text(free: Mask) -> str:
    """A `.map` file: `.` where free, `@` where not."""
    height, width = free.shape
    return "\n".join(["type octile", f"height {height}", f"width {width}", "map", *map_rows(free)]) + "\n"


def map_rows(free: Mask) -> list[str]:
    """The rows of such a file, top row first."""
    return ["".join(".@"[not cell] for cell in row) for row in free[::-1]]


def scen_text(instance: Instance, map_name: str = "") -> str:
    """A `.scen` file of an instance's vehicles; optimal lengths are left at 0."""
    height, width = instance.free.shape
    name = map_name or f"{instance.name}.map"
    lines = ["version 1"]
    for i, ((sx, sy), (gx, gy)) in enumerate(zip(instance.starts, instance.goals, strict=True)):
        sides = (i // 10, name, width, height, sx, _flip(sy, height), gx, _flip(gy, height), 0)
        lines.append("\t".join(map(str, sides)))
    return "\n".join(lines) + "\n"


# -- generating -------------------------------------------------------------------------------------------------------


def random_floor(
    rng: np.random.Generator, width: int, height: int, density: float, connected: Sequence[Cell] = ()
) -> Mask:
    """A floor with round(density · cells) obstacles, uniformly placed, on which the given cells reach each other.

    Drawn again until it holds. Raises FormatError after 10,000 draws.
    """
    cells = width * height
    keep = np.zeros((height, width), np.bool_)
    for x, y in connected:
        keep[y, x] = True
    room = np.flatnonzero(~keep)
    obstacles = round(density * cells)
    if not 0 <= obstacles <= len(room):
        raise FormatError(f"density {density} leaves no room for {len(connected)} cells")
    for _ in range(10_000):
        free = np.ones((height, width), np.bool_)
        free.ravel()[rng.choice(room, obstacles, replace=False)] = False
        if are_connected(free, connected):
            return free
    raise FormatError(f"no floor of {width} × {height} cells at density {density} connects {list(connected)}")


def largest_part(free: Mask) -> Mask:
    """(H, W) the most free cells that reach each other by horizontal and vertical steps."""
    from scipy import ndimage

    labels, parts = ndimage.label(free)
    sizes = np.bincount(labels.ravel(), minlength=parts + 1)
    sizes[0] = 0
    part: Mask = free & (labels == int(sizes.argmax()))
    return part


def are_connected(free: Mask, cells: Sequence[Cell]) -> bool:
    """True when all the cells are free and reach each other by horizontal and vertical steps."""
    from scipy import ndimage

    labels, _ = ndimage.label(free)
    found = {int(labels[y, x]) for x, y in cells}
    return 0 not in found and len(found) <= 1


def single_instance(rng: np.random.Generator, size: int, density: float, name: str = "single") -> Instance:
    """One vehicle from (0, 0) to the opposite corner of a random square (xu2025, experiments 1 and 2)."""
    start, goal = (0, 0), (size - 1, size - 1)
    return Instance(name, random_floor(rng, size, size, density, (start, goal)), (start,), (goal,))


def corner_instance(rng: np.random.Generator, size: int, density: float, name: str = "corners") -> Instance:
    """Four vehicles in the corners of a random square, each to the diagonal corner (xu2025, experiment 3)."""
    last = size - 1
    starts = ((0, 0), (last, 0), (0, last), (last, last))
    goals = ((last, last), (0, last), (last, 0), (0, 0))
    return Instance(name, random_floor(rng, size, size, density, starts), starts, goals)


def random_instance(
    rng: np.random.Generator, width: int, height: int, density: float, agents: int, name: str = "random"
) -> Instance:
    """Vehicles with distinct random starts and distinct random goals, each goal within reach of its start.

    Raises FormatError when the largest connected part of the floor is too small.
    """
    return random_trips(rng, random_floor(rng, width, height, density), agents, name)


def random_trips(rng: np.random.Generator, free: Mask, agents: int, name: str = "random") -> Instance:
    """The same on a given floor: starts and goals uniformly from its largest connected part."""
    ys, xs = np.nonzero(largest_part(free))
    if agents > len(xs):
        raise FormatError(f"{agents} vehicles don't fit into {len(xs)} connected cells")
    picks = [rng.permutation(len(xs))[:agents] for _ in range(2)]
    starts, goals = (tuple((int(xs[i]), int(ys[i])) for i in pick) for pick in picks)
    return Instance(name, free, starts, goals)
