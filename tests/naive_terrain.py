"""Slow, obvious twins for terrain: the energy of a trajectory, Dijkstra on the lattice, and AD* as it is printed."""

from __future__ import annotations

import heapq
import math
from time import process_time
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra as scipy_dijkstra

from engine.planners.kernels import adstar as kernel

INF = 2**30
SMALL = """
name = "small"
title = "Small"
[time]
tick_s = 0.1
until_s = 100.0
finish = "goals reached"
[floor]
kind = "terrain"
cell_m = 0.2
[floor.terrain]
width_m = 12.0
length_m = 10.0
hills = 4
[motion]
speed_mps = 0.5
[fleet]
count = 1
mass_kg = 60.0
start = [[8, 8]]
[orders]
source = "goals"
goals = [[50, 40]]
[energy]
demand = "skid-steer"
[planner]
name = "adstar"
[log]
sample_s = 1.0
"""
"""A robot on 12 m × 10 m of ground."""


def bilinear(height, x: float, y: float) -> float:
    rows, columns = height.shape
    x0, y0 = math.floor(x + 1e-9), math.floor(y + 1e-9)
    fx, fy = max(x - x0, 0.0), max(y - y0, 0.0)
    x1, y1 = min(x0 + 1, columns - 1), min(y0 + 1, rows - 1)
    low = float(height[y0, x0]) * (1 - fx) + float(height[y0, x1]) * fx
    high = float(height[y1, x0]) * (1 - fx) + float(height[y1, x1]) * fx
    return low * (1 - fy) + high * fy


def joules(robot: Any, cluster: Any, height, friction, x: int, y: int, h: int, k: int) -> dict[str, float]:
    """Energy of a trajectory from a cell by part, in floating point."""
    out = dict.fromkeys(("rolling", "turning", "climbing", "copper", "recovered"), 0.0)
    weight, eta, width = robot.mass_kg * robot.g, robot.efficiency, robot.track_m * robot.track_factor
    per_work = eta if robot.printed_efficiency else 1 / eta
    heat = robot.resistance_ohm * (robot.wheel_m / (robot.torque_nm_a * robot.gear * eta)) ** 2
    full = robot.mu_turn * weight * robot.wheelbase_m / 2
    n = int(cluster.pieces[h, k])
    if n == 0:
        turned, mu = float(cluster.turn_rad[h, k]), robot.mu * float(friction[y, x])
        out["turning"] = full * turned * per_work
        if robot.form == "power":
            out["rolling"] = mu * weight * turned * width / 2 * per_work
            out["copper"] = 2 * heat * (mu * weight / 2 + full / width) ** 2 * float(cluster.seconds[h, k])
        return out
    flat_roll = robot.mu * weight * per_work
    flat_heat = 2 * heat * (robot.mu * weight / 2) ** 2 / robot.v_mps
    for j in range(n):
        (ax, ay), (bx, by) = cluster.point[h, k, j], cluster.point[h, k, j + 1]
        rise = bilinear(height, x + bx, y + by) - bilinear(height, x + ax, y + ay)
        flat, bend = float(cluster.piece_m[h, k]), float(cluster.bend[h, k, j])
        length = math.hypot(flat, rise)
        factor = float(friction[y + round((ay + by) / 2), x + round((ax + bx) / 2)])
        scrub = full * (1 - math.exp(-abs(bend) * robot.scrub_m))
        if robot.form == "climb":
            out["rolling"] += flat_roll * factor * length
            out["copper"] += flat_heat * factor**2 * length
            out["climbing"] += weight * max(rise, 0) * per_work
            out["turning"] += scrub * abs(bend) * flat * per_work
        elif robot.form == "power":
            took = float(cluster.seconds[h, k]) / n
            cos, sin, v = flat / length, rise / length, length / took
            work = 0.0
            for sign in (-1, 1):  # left side, right side; a bend to the left makes the right side the outer one
                outer = sign if bend > 0 else -sign
                force = weight * (robot.mu * factor * cos + sin) / 2 + outer * scrub / width
                power = force * v * (1 + outer * abs(bend) * width / 2)
                power = (power * per_work if power > 0 else power * eta) + heat * force**2
                if power > 0:
                    lost = min(heat * force**2, power)
                    out["copper"] += lost * took
                    work += (power - lost) * took
                else:
                    out["recovered"] += robot.recovery * power * took
            roll = min(work, weight * robot.mu * factor * flat * per_work)
            turn = min(work - roll, scrub * abs(bend) * length * per_work)
            out["rolling"] += roll
            out["turning"] += turn
            out["climbing"] += work - roll - turn
    if robot.form == "printed":
        dx, dy, _ = cluster.end[h, k]
        rise = float(height[y + dy, x + dx]) - float(height[y, x])
        cell = 0.2
        out["rolling"] = (flat_roll + flat_heat) * math.sqrt((dx * cell) ** 2 + (dy * cell) ** 2 + rise**2)
        out["climbing"] = max(robot.mu * weight * rise, -out["rolling"])
    return out


class Graph:
    """Successors and predecessors of lattice states as lists, from a cost table."""

    def __init__(self, end, cost, columns: int):
        self.next: list[list[tuple[int, int]]] = [[] for _ in cost]
        self.before: list[list[tuple[int, int]]] = [[] for _ in cost]
        self.cost: dict[tuple[int, int], int] = {}
        for s, row in enumerate(cost.tolist()):
            cell, h = divmod(s, 16)
            for k, c in enumerate(row):
                if c < INF:
                    dx, dy, to = end[h, k].tolist()
                    self.join(s, (cell + dy * columns + dx) * 16 + to, c)

    def join(self, a: int, b: int, c: int) -> None:
        """Two trajectories between the same states count as the cheaper one."""
        if (a, b) not in self.cost:
            self.next[a].append((b, c))
            self.before[b].append((a, c))
        self.cost[a, b] = min(c, self.cost.get((a, b), INF))

    def price(self, a: int, b: int) -> int:
        return self.cost.get((a, b), INF)


def optimum(end: Any, cost: Any, columns: int, goal: int) -> Any:
    """(S,) least cost from every state to any heading of a cell, by SciPy; inf where there is no way."""
    s, k = np.nonzero(cost < INF)
    dx, dy, to = np.moveaxis(end[s % 16, k], -1, 0)
    there = (s // 16 + dy * columns + dx) * 16 + to
    # one goal behind all headings of the goal's cell; of two trajectories between two states the cheaper
    n = len(cost)
    order = np.lexsort((cost[s, k], there, s))
    s, k, there = s[order], k[order], there[order]
    first = np.concatenate([[True], (s[1:] != s[:-1]) | (there[1:] != there[:-1])])
    a = np.concatenate([there[first], np.full(16, n)])
    b = np.concatenate([s[first], goal * 16 + np.arange(16)])
    weight = np.concatenate([cost[s, k][first].astype(float), np.full(16, 1e-9)])
    return np.round(scipy_dijkstra(csr_array((weight, (a, b)), shape=(n + 1, n + 1)), indices=n)[:n])


def dijkstra(graph: Graph, goals: list[int]) -> list[int]:
    """Least cost from every state to any of the goals; INF where there is no way."""
    out = [INF] * len(graph.next)
    queue = [(0, s) for s in goals]
    for s in goals:
        out[s] = 0
    while queue:
        d, s = heapq.heappop(queue)
        if d > out[s]:
            continue
        for p, _ in graph.before[s]:
            new = d + graph.price(p, s)
            if new < out[p]:
                out[p] = new
                heapq.heappush(queue, (new, p))
    return out


class NaiveAdStar:
    """Likhachev et al. 2005, figure by figure, over dictionaries; `h(a, b)` is consistent."""

    def __init__(self, graph: Graph, start: int, goals: list[int], h, epsilon: float):
        self.graph, self.start, self.h, self.epsilon = graph, start, h, epsilon
        self.goals = set(goals)
        self.g: dict[int, float] = {}
        self.rhs: dict[int, float] = dict.fromkeys(goals, 0)
        self.open: dict[int, tuple[float, float]] = {}
        self.closed: set[int] = set()
        self.incons: set[int] = set()
        self.expanded = 0
        for s in goals:
            self.open[s] = self.key(s)

    def key(self, s: int) -> tuple[float, float]:
        g, rhs = self.g.get(s, math.inf), self.rhs.get(s, math.inf)
        if g > rhs:
            return rhs + self.epsilon * self.h(self.start, s), rhs
        return g + self.h(self.start, s), g

    def update(self, s: int) -> None:
        if s not in self.goals:
            costs = [self.graph.price(s, n) + self.g.get(n, math.inf) for n, _ in self.graph.next[s]]
            self.rhs[s] = min(costs, default=math.inf)
        self.open.pop(s, None)
        self.incons.discard(s)
        if self.g.get(s, math.inf) != self.rhs.get(s, math.inf):
            if s not in self.closed:
                self.open[s] = self.key(s)
            else:
                self.incons.add(s)

    def compute(self) -> None:
        while self.open:
            s = min(self.open, key=lambda state: (self.open[state], state))
            settled = self.g.get(self.start, math.inf) == self.rhs.get(self.start, math.inf)
            if settled and self.open[s] >= self.key(self.start):
                return
            del self.open[s]
            self.expanded += 1
            before = [p for p, _ in self.graph.before[s]]
            if self.g.get(s, math.inf) > self.rhs.get(s, math.inf):
                self.g[s] = self.rhs[s]
                self.closed.add(s)
                for p in before:
                    self.update(p)
            else:
                self.g[s] = math.inf
                for p in [*before, s]:
                    self.update(p)

    def next_pass(self, epsilon: float) -> None:
        self.epsilon = epsilon
        waiting = [*self.open, *self.incons]
        self.incons.clear()
        self.closed.clear()
        self.open = {s: self.key(s) for s in waiting}

    @property
    def cost(self) -> float:
        return self.rhs.get(self.start, math.inf)


def main() -> None:
    """Prints CPU times of both on the same ground, of the first way and of all passes."""
    from engine.build import terrain_costs
    from engine.studies.zhang2021 import ground_of, robot_of, search_on, world_of

    robot = robot_of({})
    world = world_of(ground_of("bumps", 1, 16.0))
    costs = terrain_costs(world, robot, "energy")
    search_on(world, costs, robot).best()  # compiles
    search = search_on(world, costs, robot)
    begun = process_time()
    search.restart()
    route = search.best()
    fast_s = process_time() - begun
    goal = int(search.now[kernel.GOAL])
    graph = Graph(costs.cluster.end, costs.cost, world.width)
    shape = int(search.now[kernel.FORM])

    def h(a: int, b: int) -> int:
        (ya, xa), (yb, xb) = divmod(a // 16, world.width), divmod(b // 16, world.width)
        return kernel.between.py_func(search.lattice, shape, xa, ya, xb, yb)

    begun = process_time()
    slow = NaiveAdStar(graph, search.start, [goal * 16 + i for i in range(16)], h, 2.5)
    slow.compute()
    for epsilon in (2.0, 1.5, 1.0):
        slow.next_pass(epsilon)
        slow.compute()
    slow_s = process_time() - begun
    assert slow.cost == route.cost
    print(f"Python {slow_s:.2f} s, compiled {1e3 * fast_s:.2f} ms from ε = 2.5 to 1: {slow_s / fast_s:.0f} times")


if __name__ == "__main__":
    main()
