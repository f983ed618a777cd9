"""A* over places by distance: the baseline of every comparison.

Source: Hart, Nilsson & Raphael 1968. Complete; optimal with every heuristic here on the grids for which it is a lower
bound (manhattan only where no diagonal is driven). Which of many shortest ways it returns is its tie rule's doing:
`fifo` takes equal f in the order of their insertion (neighbours east, north, west, south), `lifo` the latest first,
`larger-g` the one farthest from the start, `random` any, by its seed. Cost: about 30 ns per expansion for whole-cell
heuristics with fifo or lifo (lists of equal f), ten times that otherwise (a heap).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.errors import ScenarioError, unknown_name
from engine.planners.kernels import single
from engine.planners.kernels.tables import FAR
from engine.planners.single import STATUS, Floor, Way, columns
from engine.types import PlanStatus

HEURISTICS = {
    "manhattan": single.MANHATTAN,
    "euclidean": single.EUCLIDEAN,
    "octile": single.OCTILE,
    "chebyshev": single.CHEBYSHEV,
    "zero": single.ZERO,
    "table": single.TABLE,
}
TIES = {"fifo": single.FIFO, "lifo": single.LIFO, "larger-g": single.LARGER_G, "random": single.RANDOM}
WHOLE = ("manhattan", "chebyshev", "zero", "table")
"""Heuristics that count whole cells."""


@dataclass(frozen=True, slots=True)
class AStar:
    """heuristic: one of HEURISTICS · tie: one of TIES · seed: of the random tie rule."""

    heuristic: str = "manhattan"
    tie: str = "fifo"
    seed: int = 0

    def __post_init__(self) -> None:
        for what, name, known in (("heuristic", self.heuristic, HEURISTICS), ("tie rule", self.tie, TIES)):
            if name not in known:
                raise ScenarioError(unknown_name(what, name, known))

    def search(
        self, floor: Floor, start: int, goal: int, *, trace: bool = False, heading: int | None = None,
        limit: int = 2**62,
    ) -> Way:  # fmt: skip
        """A shortest way between two places; cost in mm. heading: index at the start, its first step's by default.

        Trace: nodes are places, g, h and f mm.
        """
        ground, places = floor.grounds, floor.graph.n_places
        out = np.zeros(4, np.int64)
        rows = single.new_trace(places if trace else 0)
        if floor.blocked[start] or floor.blocked[goal]:
            return Way(PlanStatus.NO_PATH, np.zeros(0, np.int32), -1, 0)
        rule, tie = HEURISTICS[self.heuristic], TIES[self.tie]
        cell, four = int(ground.length[0]), ground.step.shape[1] == 4
        table = np.zeros(0, np.int32)
        if rule == single.TABLE:
            if not four:
                raise ScenarioError("the heuristic 'table' serves 4-connected grids")
            table = np.full(places + 1, -1, np.int32)
            single.steps_to(floor.back, goal, table, np.zeros(places, np.int32))
        # against a one-way step the table may change by more than one
        whole = self.heuristic in WHOLE and (rule != single.TABLE or floor.two_way)
        buckets = four and whole and self.tie in ("fifo", "lifo")
        unit = cell if buckets else 1
        if buckets:
            best = floor.place_work.best
            status = single.astar_unit(
                floor.lattice, floor.place_work, start, goal, rule, table, self.tie == "lifo", limit, rows, out
            )
        else:
            best = np.zeros(places + 1, np.int32)
            long_table = np.where(table < 0, FAR, table.astype(np.int64) * cell)
            status = single.astar_any(
                ground.step, floor.back, ground.xy, ground.length, best, start, goal, rule, long_table, tie, self.seed,
                limit, rows, out,
            )  # fmt: skip
        kept = columns(rows, int(out[2]))
        kept |= {name: kept[name] * unit for name in ("g", "h", "f") if name in kept}
        if status != single.SOLVED:
            return Way(STATUS[status], np.zeros(0, np.int32), -1, int(out[1]), kept)
        buffer = np.zeros(int(out[0]) * unit // cell + 1, np.int32)
        begin = None if heading is None else start * floor.per_place + 2 * heading
        if buckets:
            states = np.empty(len(buffer), np.int32)
            single.trail(floor.lattice, best, goal, buffer, floor.net.shift, states)
            if begin is not None:
                states[0] = begin
            if not floor.turns_freely:
                states = floor.along(buffer, begin)
        else:
            states = floor.along(buffer[: single.way_back(floor.back, best, start, goal, buffer)], begin)
        return Way(PlanStatus.SOLVED, states, int(out[0]) * unit, int(out[1]), kept)
