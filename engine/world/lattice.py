"""Clusters of trajectories: what a robot can drive from each heading, snapped to a lattice of cells and headings.

Zhang et al. 2021, section 3, SBMPO: controls (v, ω) and a duration are sampled quasi-randomly and driven through the
kinematic model (13) with φ = ψ = 0, v_y = 0 and z from the ground; ends that lie near a cell's centre and a heading are
kept. A sampled arc does not end exactly there: the two-point problem is solved again for a curvature that changes
linearly along the way, so that what is driven, and what it costs, belongs to the end that the lattice has.

Trajectories of one class (change of heading, seconds, turned on the spot or not) compete; a preset says which classes
it wants. ω is sampled to both sides, for the paper's [0, π/8] turns left only. Headings are 22.5 degrees apart, the
turn of one second at π/8. Those of the first three are sampled; the others are turned and mirrored, as the grid allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name

HEADINGS = 16
BIN = 2 * math.pi / HEADINGS
SEGMENT_M = 0.12
"""Length of the straight pieces by which a trajectory is followed over the ground, at most."""
NEAR_M = 0.1
"""How far from a cell's centre a sampled end may be."""
SAMPLES = 4096
"""Controls sampled per heading."""

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Class:
    """A kind of trajectory: turn in headings to the left (its mirror comes with it), seconds; pivot: on the spot."""

    turn: int
    seconds: float
    pivot: bool = False

    @property
    def two_sided(self) -> bool:
        """True when it has a mirror of its own."""
        return self.turn > 0


PRESETS: dict[str, tuple[Class, ...]] = {
    "figure4": (Class(0, 1), Class(1, 2), Class(2, 2), Class(1, 1, pivot=True)),
    "medium": (Class(0, 1), Class(0, 2), Class(1, 1.4), Class(1, 2), Class(2, 2), Class(1, 1, pivot=True)),
    "dense": (
        Class(0, 1), Class(0, 2), Class(0, 3), Class(1, 1.4), Class(1, 2), Class(2, 2), Class(2, 3),
        Class(3, 3), Class(1, 1, pivot=True),
    ),
}  # fmt: skip
"""Clusters by name. `figure4` has the paper's seven trajectories."""


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """K trajectories from each of 16 headings, as offsets; M the most pieces of any.

    Trajectory k of heading h leads (dx, dy) cells on to another heading; points are offsets in cells from the centre of
    the first cell. Everything is the same wherever it is driven. kind: trajectories of equal length and duration under
    the grid's symmetries, index into ticks and length_mm of a kind.
    """

    name: str
    end: I32  # (16, K, 3) dx, dy, heading
    kind: NDArray[np.int8]  # (16, K)
    pieces: I32  # (16, K) number of pieces, 0 for a turn on the spot
    point: F64  # (16, K, M + 1, 2)
    bend: F64  # (16, K, M) curvature of each piece in 1/m, to the left
    piece_m: F64  # (16, K)
    turn_rad: F64  # (16, K) all turning, to either side
    seconds: F64  # (16, K) whole ticks
    swept: I32  # (16, K, C, 2) cells that the middle of the body passes, the first and the last among them
    n_swept: I32  # (16, K)
    from_heading: I32  # (16, I) trajectories that end at a heading: their first heading and number, -1 for none
    from_k: I32  # (16, I)
    kind_name: tuple[str, ...]
    kind_ticks: I32
    kind_mm: I32
    reach: int  # cells from which the farthest point of any trajectory may be

    @property
    def size(self) -> int:
        """Trajectories per heading."""
        return int(self.end.shape[1])


def wheel_speeds(v_mps: float, omega: float, wheel_m: float, track_m: float) -> tuple[float, float]:
    """Left and right wheel in rad/s: equation (2)."""
    return (v_mps - track_m * omega / 2) / wheel_m, (v_mps + track_m * omega / 2) / wheel_m


def body_speeds(left: float, right: float, wheel_m: float, track_m: float) -> tuple[float, float]:
    """Speed and turning rate from wheel speeds: equation (1)."""
    return wheel_m * (left + right) / 2, wheel_m * (right - left) / track_m


def drive(v_mps: float, omega: float, seconds: float, heading: float) -> tuple[float, float, float]:
    """Where constant controls lead from the origin: equation (13), solved exactly. (x, y, heading)."""
    end = heading + omega * seconds
    if abs(omega) < 1e-9:
        return v_mps * seconds * math.cos(heading), v_mps * seconds * math.sin(heading), heading
    radius = v_mps / omega
    return radius * (math.sin(end) - math.sin(heading)), radius * (math.cos(heading) - math.cos(end)), end


@dataclass(frozen=True, slots=True)
class _Way:
    """A trajectory of a base heading: its end in cells and headings, curvature a + b·s over length_m."""

    dx: int
    dy: int
    turn: int
    a: float
    b: float
    length_m: float
    seconds: float
    misfit: float
    kind: str = ""


@lru_cache(maxsize=8)
def cluster(
    name: str = "figure4",
    cell_m: float = 0.2,
    v_mps: float = 0.5,
    omega: float = math.pi / 8,
    tick_s: float = 0.1,
) -> Cluster:
    """The cluster of a preset for a robot that drives up to v_mps and turns up to omega rad/s. Raises BadInput."""
    if name not in PRESETS:
        raise BadInput(unknown_name("cluster", name, PRESETS))
    found: dict[tuple[int, int], list[_Way]] = {}
    for h, side in ((0, 1), (1, 1), (1, -1), (2, 1)):
        taken: set[tuple[int, int, int]] = set()
        ways = found[h, side] = []
        for kind in PRESETS[name]:
            ways.append(_base(h, side, kind, taken, cell_m, v_mps, omega, tick_s))
            taken.add((ways[-1].dx, ways[-1].dy, ways[-1].turn))
    every = [_ways(h, found, PRESETS[name]) for h in range(HEADINGS)]
    return _assembled(name, every, cell_m, tick_s)


def _base(
    h: int,
    side: int,
    kind: Class,
    taken: set[tuple[int, int, int]],
    cell_m: float,
    v_mps: float,
    omega: float,
    tick_s: float,
) -> _Way:
    """The best trajectory of a class from heading h to one side (1 left): the sample that fits its lattice state best,
    solved again."""
    name = f"{'left' if side > 0 else 'right'} " if kind.two_sided and h == 1 else ""
    degrees = kind.turn * 360 / HEADINGS
    what = f"turn {degrees:g}°" if kind.turn else "straight"
    name = f"{'pivot' if kind.pivot else f'{name}{what}'} from {h * 360 / HEADINGS:g}° in {kind.seconds:g} s"
    if kind.pivot:
        seconds = math.ceil(BIN * kind.turn / omega / tick_s - 1e-6) * tick_s
        return _Way(0, 0, side * kind.turn, 0.0, 0.0, 0.0, seconds, 0.0, name)
    found: dict[tuple[int, int], _Way] = {}
    for v, rate, seconds in _controls(v_mps, omega, kind):
        x, y, end = drive(v, side * rate, seconds, h * BIN)
        dx, dy, turn = round(x / cell_m), round(y / cell_m), round((end - h * BIN) / BIN)
        if turn != side * kind.turn or (dx, dy) == (0, 0) or (dx, dy, turn) in taken:
            continue
        off = math.hypot(x - dx * cell_m, y - dy * cell_m)
        if off > NEAR_M:
            continue
        misfit = off / NEAR_M + abs(end - h * BIN - turn * BIN) / BIN - 2 * v / v_mps
        if (dx, dy) not in found or misfit < found[dx, dy].misfit:
            found[dx, dy] = _Way(dx, dy, turn, side * rate / v, 0.0, v * seconds, seconds, misfit, name)
    for way in sorted(found.values(), key=lambda w: (w.misfit, w.dx, w.dy)):
        solved = _solved(way, h, cell_m, v_mps, omega, tick_s)
        if solved is not None and solved.seconds <= 1.6 * kind.seconds:
            return solved
    raise BadInput(
        f"no trajectory turns by {kind.turn} headings in about {kind.seconds:g} s on cells of {cell_m:g} m at "
        f"{v_mps:g} m/s and {math.degrees(omega):g} degrees per second; expected smaller cells or a faster robot"
    )


@lru_cache(maxsize=32)
def _controls(v_mps: float, omega: float, kind: Class) -> tuple[tuple[float, float, float], ...]:
    """Halton points over speeds up to v_mps, turning rates to the left up to omega, and durations near the class's."""
    from scipy.stats import qmc

    points = qmc.Halton(3, scramble=False).random(SAMPLES)
    span = 0.15 * kind.seconds
    low, high = (0.0, 1.0) if kind.turn else (-0.2, 0.2)
    controls = (
        (v_mps * float(p[0]), omega * (low + (high - low) * float(p[1])), kind.seconds + span * (2 * float(p[2]) - 1))
        for p in points
    )
    return tuple(c for c in controls if c[0] > 0.02)


def _solved(way: _Way, h: int, cell_m: float, v_mps: float, omega: float, tick_s: float) -> _Way | None:
    """The way with curvature a + b·s and length so that it ends exactly in its cell and heading; None when it can't."""
    from scipy.optimize import fsolve

    target = np.array([way.dx * cell_m, way.dy * cell_m, way.turn * BIN])

    def miss(unknown: F64) -> F64:
        x, y, turned = _follow(h * BIN, float(unknown[0]), float(unknown[1]), float(unknown[2]), 33)
        return np.array([x[-1] - target[0], y[-1] - target[1], turned[-1] - target[2]])

    solution, _, status, _ = fsolve(miss, np.array([way.a, way.b, way.length_m]), full_output=True)
    a, b, length = (float(v) for v in solution)
    if status != 1 or length <= 0 or length > 2 * (math.hypot(*target[:2]) + cell_m):
        return None
    sharpest = max(abs(a), abs(a + b * length))
    speed = min(v_mps, omega / sharpest if sharpest > 0 else v_mps)
    seconds = math.ceil(length / speed / tick_s - 1e-6) * tick_s
    return replace(way, a=a, b=b, length_m=length, seconds=seconds)


def _follow(heading: float, a: float, b: float, length: float, points: int) -> tuple[F64, F64, F64]:
    """x, y and turn along a way, by Simpson's rule on cos and sin of the heading."""
    s = np.linspace(0.0, length, 2 * points - 1)
    turned = a * s + b * s * s / 2
    step = length / (points - 1)
    out = []
    for f in (np.cos(heading + turned), np.sin(heading + turned)):
        area = (f[:-2:2] + 4 * f[1:-1:2] + f[2::2]) * step / 6
        out.append(np.concatenate([[0.0], np.cumsum(area)]))
    return out[0], out[1], turned[::2]


def _ways(h: int, found: dict[tuple[int, int], list[_Way]], classes: tuple[Class, ...]) -> list[_Way]:
    """All trajectories of a heading; the right side of 0 and 45 degrees mirrors the left one, that of 22.5 does not."""
    quarter, rest = divmod(h, 4)
    out = []
    for k, kind in enumerate(classes):
        for side in (1, -1) if kind.two_sided else (1,):
            if rest == 1:
                way = found[1, side if kind.two_sided else 1][k]
            elif rest == 3:  # heading 1 mirrored in the diagonal, where left is right
                way = _in_diagonal(found[1, -side if kind.two_sided else 1][k])
            else:
                way = found[rest, 1][k]
                if side < 0:
                    way = _in_axis(way) if rest == 0 else _in_diagonal(way)
            for _ in range(quarter):
                way = replace(way, dx=-way.dy, dy=way.dx)
            out.append(way)
    return out


def _in_axis(way: _Way) -> _Way:
    return replace(way, dy=-way.dy, turn=-way.turn, a=-way.a, b=-way.b)


def _in_diagonal(way: _Way) -> _Way:
    return replace(way, dx=way.dy, dy=way.dx, turn=-way.turn, a=-way.a, b=-way.b)


def _assembled(name: str, ways: list[list[_Way]], cell_m: float, tick_s: float) -> Cluster:
    size = len(ways[0])
    pieces = np.array([[math.ceil(w.length_m / SEGMENT_M) for w in row] for row in ways], np.int32)
    most = max(int(pieces.max()), 1)
    point, bend = np.zeros((HEADINGS, size, most + 1, 2)), np.zeros((HEADINGS, size, most))
    swept: list[list[list[tuple[int, int]]]] = []
    for h, row in enumerate(ways):
        swept.append([])
        for k, way in enumerate(row):
            n = int(pieces[h, k])
            cells: dict[tuple[int, int], None] = {(0, 0): None}
            if n:
                x, y, _ = _follow(h * BIN, way.a, way.b, way.length_m, n * 8 + 1)
                x, y = x / cell_m, y / cell_m
                x[-1], y[-1] = way.dx, way.dy
                point[h, k, : n + 1] = np.stack([x[::8], y[::8]], 1)
                middle = (np.arange(n) + 0.5) * way.length_m / n
                bend[h, k, :n] = way.a + way.b * middle
                cells |= dict.fromkeys(
                    zip(np.rint(x).astype(int).tolist(), np.rint(y).astype(int).tolist(), strict=True)
                )
            swept[h].append(list(cells))
    widest = max(len(cells) for row in swept for cells in row)
    over, n_swept = np.zeros((HEADINGS, size, widest, 2), np.int32), np.zeros((HEADINGS, size), np.int32)
    for h, k in np.ndindex(HEADINGS, size):
        n_swept[h, k] = len(swept[h][k])
        over[h, k, : n_swept[h, k]] = swept[h][k]
    names = list(dict.fromkeys(w.kind for row in ways for w in row))
    first = {w.kind: w for row in ways for w in row}
    end = np.array([[(w.dx, w.dy, (h + w.turn) % HEADINGS) for w in row] for h, row in enumerate(ways)], np.int32)
    into = [[(h, k) for h, k in np.ndindex(HEADINGS, size) if end[h, k, 2] == to] for to in range(HEADINGS)]
    widest_in = max(map(len, into))
    from_heading, from_k = (np.full((HEADINGS, widest_in), -1, np.int32) for _ in range(2))
    for to, pairs in enumerate(into):
        for i, (h, k) in enumerate(pairs):
            from_heading[to, i], from_k[to, i] = h, k
    made = Cluster(
        name=name,
        end=end,
        kind=np.array([[names.index(w.kind) for w in row] for row in ways], np.int8),
        pieces=pieces,
        point=point,
        bend=bend,
        piece_m=np.array([[w.length_m / max(1, math.ceil(w.length_m / SEGMENT_M)) for w in row] for row in ways]),
        turn_rad=np.array([[_turning(w) for w in row] for row in ways]),
        seconds=np.array([[w.seconds for w in row] for row in ways]),
        swept=over,
        n_swept=n_swept,
        from_heading=from_heading,
        from_k=from_k,
        kind_name=tuple(names),
        kind_ticks=np.array([round(first[n].seconds / tick_s) for n in names], np.int32),
        kind_mm=np.array([round(first[n].length_m * 1000) for n in names], np.int32),
        reach=math.ceil(np.abs(point).max()) + 1,
    )
    for f in fields(made):
        if isinstance(value := getattr(made, f.name), np.ndarray):
            value.setflags(write=False)
    return made


def _turning(way: _Way) -> float:
    """All turning of a way in radians, to either side."""
    if not way.length_m:
        return abs(way.turn) * BIN
    s = np.linspace(0, way.length_m, 201)
    bend = np.abs(way.a + way.b * s)
    return float(np.sum((bend[1:] + bend[:-1]) / 2) * way.length_m / 200)
