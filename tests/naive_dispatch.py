"""Slow, obvious twins of dispatch and of A* on grids, in plain Python. They share no code with what they check."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from itertools import pairwise, permutations, product
from typing import Any

BARRED = 2**39


def time_of(work: Any, vehicle: int, route: list[int], exits: list[int]) -> int:
    """When a vehicle has done a sequence of orders, each by its exit."""
    clock, at = 0, None
    for order, leave in zip(route, exits, strict=True):
        clock += int(work.first[vehicle, order]) if at is None else int(work.back[at, order])
        clock += int(work.carry[order, leave])
        at = leave
    return clock


def free_rests(
    near: list[int], holder: list[int], blocked: list[int], chargers: list[int], vehicle: int, only: bool, count: int
) -> list[int]:
    """The first rest places that are the vehicle's own or nobody's, and not blocked; with `only`, chargers alone."""
    free = [p for p in near if holder[p] in (-1, vehicle) and not blocked[p]]
    return [p for p in free if chargers[p] or not only][:count]


def schedules(vehicles: int, orders: int, exits: int) -> Iterator[list[tuple[list[int], list[int]]]]:
    """Every way to give all orders to the vehicles, in every sequence and by every exit; (route, exits) per vehicle."""
    for row in permutations(range(orders)):
        for cuts in product(range(orders + 1), repeat=vehicles - 1):
            ends = [0, *cuts, orders]
            if any(a > b for a, b in pairwise(ends)):
                continue
            for leave in product(range(exits), repeat=orders):
                yield [(list(row[a:b]), list(leave[a:b])) for a, b in pairwise(ends)]


def least_makespan(work: Any) -> int:
    """By dynamic programming over subsets of the orders: independent of any program or search."""
    orders, exits = len(work.carry), len(work.back)
    full = 1 << orders
    best = [0] + [BARRED] * (full - 1)
    for vehicle in range(len(work.first)):
        done = [[BARRED] * exits for _ in range(full)]
        for i in range(orders):
            for e in range(exits):
                done[1 << i][e] = int(work.first[vehicle, i] + work.carry[i, e])
        for some in range(1, full):
            for i in range(orders):
                if some >> i & 1 or work.first[vehicle, i] >= BARRED:
                    continue
                there = min(done[some][h] + int(work.back[h, i]) for h in range(exits))
                for e in range(exits):
                    now = there + int(work.carry[i, e])
                    done[some | 1 << i][e] = min(done[some | 1 << i][e], now)
        alone = [0] + [min(row) for row in done[1:]]
        merged = [BARRED] * full
        for some in range(full):
            part = some
            while True:
                merged[some] = min(merged[some], max(best[some ^ part], alone[part]))
                if part == 0:
                    break
                part = (part - 1) & some
        best = merged
    return best[-1]


def inserted(work: Any, routes: list[list[int]], order: int, limit: int) -> list[list[int]]:
    """Routes with an order put in where it adds least within the limit, else where its vehicle is done soonest."""

    def takes(vehicle: int, route: list[int]) -> int:
        if not route:
            return 0
        clock = int(work.first[vehicle, route[0]])
        for a, b in pairwise(route):
            clock += min(int(work.carry[a, e] + work.back[e, b]) for e in range(len(work.back)))
        return clock + int(min(work.carry[route[-1]]))

    within, soonest = [], []
    for r, route in enumerate(routes):
        for at in range(len(route) + 1):
            more = [*route[:at], order, *route[at:]]
            now = takes(r, more)
            if work.first[r, order] < BARRED:
                (within if now <= limit else soonest).append(
                    ((now - takes(r, route)) if now <= limit else now, r, more)
                )
    if not (within or soonest):
        return routes
    _, r, more = min(within or soonest, key=lambda each: each[0])
    return [more if k == r else route for k, route in enumerate(routes)]


def shortest(free: Any, neighbours: int, cut_corners: bool, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Length of a shortest way in cells by Dijkstra; infinite without one."""
    height, width = len(free), len(free[0])

    def open_(x: int, y: int) -> bool:
        return 0 <= x < width and 0 <= y < height and bool(free[y][x])

    done: set[tuple[int, int]] = set()
    heap = [(0.0, start)]
    while heap:
        far, (x, y) = heapq.heappop(heap)
        if (x, y) == goal:
            return far
        if (x, y) in done:
            continue
        done.add((x, y))
        for dx, dy in product((-1, 0, 1), repeat=2):
            if (dx, dy) == (0, 0) or (neighbours == 4 and dx and dy) or not open_(x + dx, y + dy):
                continue
            if dx and dy and not cut_corners and not (open_(x + dx, y) and open_(x, y + dy)):
                continue
            heapq.heappush(heap, (far + math.hypot(dx, dy), (x + dx, y + dy)))
    return math.inf
