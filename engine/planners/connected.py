"""A* on grids of four or eight neighbours, with corners cut or not, by any heuristic: connectivity apart from
heuristic.

Source: Wang et al. 2019, section 2.2; its "complex diagonal distance" (eq. 12) is the octile distance. Complete;
shortest where the heuristic is admissible (ADMISSIBLE says on which grids that is). Floors of runs never cut corners
(engine.world.grid), because a vehicle on a diagonal sweeps both; here it may be asked for. Lengths are in µm, so that
rounding never makes the Euclidean distance exceed a way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name
from engine.planners.astar import HEURISTICS, TIES
from engine.planners.kernels import single
from engine.planners.single import STATUS, columns
from engine.types import PlanStatus
from engine.world.grid import STEPS

RULES = ("manhattan", "euclidean", "chebyshev", "octile", "zero")
"""Heuristics that need no table."""
ADMISSIBLE: Mapping[int, tuple[str, ...]] = {
    4: ("manhattan", "euclidean", "chebyshev", "octile", "zero"),
    8: ("euclidean", "chebyshev", "octile", "zero"),
}
"""Neighbours → heuristics that never exceed the shortest way, whatever the obstacles."""
UM_PER_CELL = 1_000_000
UM_PER_DIAGONAL = 1_414_214
"""√2 cells, rounded up: the Euclidean distance stays a lower bound."""
ENTRIES_LIMIT = 4_000_000
"""Cells of a floor at most."""
REOPENED = 4
"""Room of a trace in expansions per place: inadmissible heuristics close some more than once."""


@dataclass(frozen=True)
class Ground:
    """The free cells of a floor as places, row by row from the bottom, and how they are joined.

    free: (H, W) · place_of: (H, W), -1 for obstacles · cell_of: (P,) x + W y · step: (P+1, D) neighbour in each
    direction, P for none; every step leads both ways · xy, length: as of engine.planners.kernels.single.Grounds, in µm.
    """

    free: NDArray[np.bool_]
    place_of: NDArray[np.int32]
    cell_of: NDArray[np.int64]
    step: NDArray[np.int32] = field(repr=False)
    xy: NDArray[np.int32] = field(repr=False)
    length: NDArray[np.int64] = field(repr=False)

    @property
    def neighbours(self) -> int:
        return int(self.step.shape[1])

    def place(self, x: int, y: int) -> int:
        """The place of a cell, -1 when no vehicle may be there."""
        height, width = self.free.shape
        return int(self.place_of[y, x]) if 0 <= x < width and 0 <= y < height else -1

    def cells(self, places: NDArray[np.int32]) -> list[tuple[int, int]]:
        """Places as (x, y)."""
        width = self.free.shape[1]
        return [(c % width, c // width) for c in self.cell_of[places].tolist()]


def ground_of(free: NDArray[np.bool_], neighbours: int = 4, cut_corners: bool = False) -> Ground:
    """Join the free cells. cut_corners: a diagonal asks for its two ends only, else for both cells beside it too.

    Raises BadInput for other numbers of neighbours than 4 and 8, and for floors too large.
    """
    if neighbours not in (4, 8):
        raise BadInput(f"4 or 8 neighbours were expected, got {neighbours}")
    if free.size > ENTRIES_LIMIT:
        raise BadInput(f"a floor of at most {ENTRIES_LIMIT:,} cells was expected, got {free.size:,}")
    height, width = free.shape
    ys, xs = np.nonzero(free)
    n = len(xs)
    place_of = np.full((height + 2, width + 2), n, np.int32)  # a border spares every question about the edge
    place_of[ys + 1, xs + 1] = np.arange(n)
    step = np.full((n + 1, neighbours), n, np.int32)
    turn = 8 // neighbours
    for d in range(neighbours):
        dx, dy = STEPS[d * turn]
        to = place_of[ys + 1 + dy, xs + 1 + dx].copy()
        if dx and dy and not cut_corners:
            beside = np.maximum(place_of[ys + 1, xs + 1 + dx], place_of[ys + 1 + dy, xs + 1])
            to[beside == n] = n
        step[:n, d] = to
    length = [UM_PER_DIAGONAL if d * turn % 2 else UM_PER_CELL for d in range(neighbours)]
    xy = np.zeros(n + 1, np.int32)
    xy[:n] = xs | ys << 16
    inner = place_of[1:-1, 1:-1].copy()
    inner[inner == n] = -1
    return Ground(free, inner, ys * width + xs, step, xy, np.array(length, np.int64))


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found. places: from start to goal, none without a way · length_um: of it, -1 without · trace: as of
    engine.planners.single.Way, when asked for.
    """

    status: PlanStatus
    places: NDArray[np.int32]
    length_um: int
    expanded: int
    trace: Mapping[str, NDArray[Any]]

    @property
    def length(self) -> float:
        """In cells."""
        return self.length_um / UM_PER_CELL


def search(
    ground: Ground, start: int, goal: int, heuristic: str = "octile", tie: str = "fifo", *, trace: bool = False,
    limit: int = 2**62,
) -> Found:  # fmt: skip
    """A* between two places. Raises BadInput for unknown rules."""
    if heuristic not in RULES:
        raise BadInput(unknown_name("heuristic", heuristic, RULES))
    if tie not in TIES:
        raise BadInput(unknown_name("tie rule", tie, TIES))
    n = len(ground.cell_of)
    best, out = np.zeros(n + 1, np.int32), np.zeros(4, np.int64)
    rows = single.new_trace(REOPENED * n if trace else 0)
    status = single.astar_any(
        ground.step, ground.step, ground.xy, ground.length, best, start, goal, HEURISTICS[heuristic],
        np.zeros(0, np.int64), TIES[tie], 0, limit, rows, out,
    )  # fmt: skip
    kept = columns(rows, int(out[2]))
    if status != single.SOLVED:
        return Found(STATUS[status], np.zeros(0, np.int32), -1, int(out[1]), kept)
    buffer = np.zeros(n, np.int32)
    count = single.way_back(ground.step, best, start, goal, buffer)
    return Found(PlanStatus.SOLVED, buffer[:count].copy(), int(out[0]), int(out[1]), kept)
