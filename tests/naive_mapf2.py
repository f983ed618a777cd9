"""Slow, obvious twins of the one-shot searches: Dijkstra by networkx or by heapq, over cells as (x, y).

A heading is 0 east, 1 north, 2 west, 3 south. Nothing here shares code with the engine.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np

Cell = tuple[int, int]
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


def neighbours(free: np.ndarray, cell: Cell) -> Iterator[tuple[int, Cell]]:
    """Directions and cells around a cell that may be entered, east first."""
    height, width = free.shape
    for d, (dx, dy) in enumerate(STEPS):
        x, y = cell[0] + dx, cell[1] + dy
        if 0 <= x < width and 0 <= y < height and free[y, x]:
            yield d, (x, y)


def cells(free: np.ndarray) -> list[Cell]:
    """Free cells in the order of the places: row by row from the bottom."""
    return [(int(x), int(y)) for y, x in np.argwhere(free)]


def steps(free: np.ndarray, start: Cell, goal: Cell) -> int | None:
    """Fewest steps."""
    g = nx.Graph()
    g.add_nodes_from(cells(free))
    g.add_edges_from((c, n) for c in cells(free) for _, n in neighbours(free, c))
    try:
        return int(nx.shortest_path_length(g, start, goal))
    except nx.NetworkXNoPath:
        return None


def expansions(
    free: np.ndarray, start: Cell, goal: Cell, h: Callable[[Cell], float], tie: str
) -> tuple[list[Cell], list[Cell]]:
    """Textbook A* by a heap of (f, tie): cells in the order of expansion, and the path."""
    count = itertools.count()
    sign = 1 if tie == "fifo" else -1
    g, parent = {start: 0}, {start: start}
    heap: list[Any] = [(h(start), 0, start)]
    closed: set[Cell] = set()
    order = []
    while heap:
        _, _, cell = heapq.heappop(heap)
        if cell in closed:
            continue
        closed.add(cell)
        if cell == goal:
            path = [goal]
            while path[-1] != start:
                path.append(parent[path[-1]])
            return order, path[::-1]
        order.append(cell)
        for _, v in neighbours(free, cell):
            if g[cell] + 1 < g.get(v, 10**9):
                g[v], parent[v] = g[cell] + 1, cell
                heapq.heappush(heap, (g[v] + h(v), sign * (next(count) + 1), v))
    return order, []


@dataclass(frozen=True)
class Energy:
    """Millijoules by the formulas of the paper, rounded where the engine rounds."""

    mass: float = 1000.0
    mu: float = 0.01
    v: float = 1.0
    omega: float = 1.5707963267948966
    standby: float = 30.0
    reversal: str = "cost"
    restart: str = "cost"

    @property
    def wait(self) -> int:
        return round(1000 * self.standby)

    def move(self, heading: int, moving: bool, d: int) -> int:
        """Driving one cell in direction d."""
        gap = min((d - heading) % 4, (heading - d) % 4)
        start = round(1000 * 0.5 * self.mass * self.v**2)
        e_turn = 0.5 * self.mass * (1.2**2 + 0.9**2) / 12 * self.omega**2
        straight = round(1000 * self.mu * self.mass * 9.81)
        if not moving and self.restart == "straight":
            gap = 0
        if gap == 2 and self.reversal == "straight":
            gap = 0
        if gap == 0:
            total = straight
        elif gap == 1:
            total = round(1000 * self.mu * self.mass * 9.81 * math.pi / 4) + round(1000 * e_turn)
        else:
            total = straight + round(1000 * 2 * e_turn) + (start if moving else 0)
        return total + (0 if moving else start) + self.wait


State = tuple[Cell, int, bool]


def least_energy(free: np.ndarray, starts: Iterable[State], goal: Cell, energy: Energy) -> int | None:
    """Least mJ from any of the states, waits on the way allowed, by Dijkstra over (cell, heading, moving)."""
    best: dict[State, int] = dict.fromkeys(starts, 0)
    heap = [(0, state) for state in best]
    while heap:
        g, state = heapq.heappop(heap)
        if g > best[state]:
            continue
        cell, heading, moving = state
        if cell == goal:
            return g
        ahead: list[tuple[State, int]] = [((cell, heading, False), energy.wait)]
        ahead += [((v, d, True), energy.move(heading, moving, d)) for d, v in neighbours(free, cell)]
        for v, cost in ahead:
            if g + cost < best.get(v, 10**18):
                best[v] = g + cost
                heapq.heappush(heap, (g + cost, v))
    return None


def at(way: Sequence[Cell], t: int) -> Cell:
    """Where a vehicle is; it rests at the end of its way."""
    return way[min(t, len(way) - 1)]


def clash(way: Sequence[Cell], u: Cell, v: Cell, t: int) -> bool:
    """True when driving from u at t to v at t + 1 meets a vehicle on its way."""
    a, b = at(way, t), at(way, t + 1)
    return b == v or (a == v and b == u and u != v)


def among(
    free: np.ndarray, ways: Sequence[Sequence[Cell]], start: State, goal: Cell, energy: Energy | None,
    only: Sequence[Cell] | None = None,
) -> int | None:  # fmt: skip
    """Least mJ (or ticks without an energy) to rest at the goal among fixed ways; `only`: on this route, by waits."""
    calm = max([len(way) for way in ways], default=0)
    horizon = calm + 4 * int(free.sum()) + 4
    if any(at(way, 0) == start[0] for way in ways):
        return None
    ready = max([t + 1 for way in ways for t in range(len(way)) if way[t] == goal], default=0)
    if any(way[-1] == goal for way in ways):
        return None
    first = (start, 0, 0)
    best = {first: 0}
    heap: list[Any] = [(0, first)]
    while heap:
        g, node = heapq.heappop(heap)
        if g > best[node]:
            continue
        (cell, heading, moving), t, i = node
        if cell == goal and t >= ready and (only is None or i == len(only) - 1):
            return g
        if t == horizon:
            continue
        ahead: list[tuple[Any, int]] = [(((cell, heading, False), t + 1, i), energy.wait if energy else 1)]
        for d, v in neighbours(free, cell):
            if only is not None and (i + 1 >= len(only) or only[i + 1] != v):
                continue
            cost = energy.move(heading, moving, d) if energy else 1
            ahead.append((((v, d, True), t + 1, i + 1 if only is not None else 0), cost))
        for v, cost in ahead:
            if any(clash(way, cell, v[0][0], t) for way in ways):
                continue
            if g + cost < best.get(v, 10**18):
                best[v] = g + cost
                heapq.heappush(heap, (g + cost, v))
    return None
