"""Slow, obvious twins of the one-shot solvers: A* over joint states, one vehicle's costs, small random problems."""

from __future__ import annotations

import heapq
from itertools import product

import numpy as np

from engine.energy import cost_table
from engine.planners.oneshot import Problem, Solution
from engine.sim.judge import judge_plan
from tests.strategies import grid_graph, model

MASSES = [(2000.0, 0.0), (2200.0, 0.0), (2350.0, 0.0), (2500.0, 0.0)]


def random_problem(
    rng: np.random.Generator, n: int, width: int, height: int, walls: float, standby_w: float = 30.0
) -> Problem:
    """n vehicles with distinct starts and goals on a grid with walls."""
    while True:
        free = rng.random((height, width)) >= walls
        if free.sum() >= n + 1:
            break
    graph = grid_graph(width, height, [(int(x), int(y)) for y, x in np.argwhere(~free)])
    starts = rng.permutation(graph.n_places)[:n]
    goals = rng.permutation(graph.n_places)[:n]
    states = [graph.state(int(p), int(rng.integers(4))) for p in starts]
    costs = cost_table(graph.primitives, model(standby_w), MASSES, 1.0)
    return Problem(
        graph,
        np.array(states, np.int32),
        goals.astype(np.int32),
        costs,
        rng.integers(0, len(MASSES), n).astype(np.int32),
        np.zeros(graph.n_places, np.uint8),
    )


def steps(problem: Problem, vehicle: int, state: int, energy: bool) -> list[tuple[int, int]]:
    """(next state, cost) of every motion and of standing still."""
    graph, cls = problem.graph, problem.cls[vehicle]
    standby = int(problem.costs.standby_mj[cls])
    out = [(int(graph.stopped[state]), standby if energy else 1)]
    for e in range(graph.edge_ptr[state], graph.edge_ptr[state + 1]):
        to = int(graph.edge_to[e])
        if not problem.blocked[graph.state_place[to]]:
            out.append((to, int(problem.costs.total_mj[cls, 0, graph.edge_kind[e]]) + standby if energy else 1))
    return out


def alone(problem: Problem, vehicle: int, energy: bool) -> dict[int, int]:
    """Least cost of one vehicle from every state to its goal, by relaxing until nothing changes."""
    graph = problem.graph
    goal = int(problem.goals[vehicle])
    cost = {s: 0 for s in range(graph.n_states) if graph.state_place[s] == goal}
    moves = [steps(problem, vehicle, s, energy) for s in range(graph.n_states)]
    changed = True
    while changed:
        changed = False
        for s in range(graph.n_states):
            for to, c in moves[s]:
                if to in cost and cost[to] + c < cost.get(s, 2**62):
                    cost[s] = cost[to] + c
                    changed = True
    return cost


def joint_optimum(problem: Problem, energy: bool, most: int = 400_000) -> int | None:
    """Least sum of costs of all vehicles together; None when there is no plan. A vehicle that rests has arrived."""
    graph = problem.graph
    n = len(problem.starts)
    place = graph.state_place.tolist()
    h = [alone(problem, k, energy) for k in range(n)]
    start = tuple((int(s), False) for s in problem.starts)
    if any(s not in h[k] for k, (s, _) in enumerate(start)):
        return None
    best = {start: 0}
    heap = [(sum(h[k][s] for k, (s, _) in enumerate(start)), 0, start)]
    closed = set()
    while heap:
        _, g, now = heapq.heappop(heap)
        if now in closed:
            continue
        closed.add(now)
        if all(rest for _, rest in now):
            return g
        assert len(closed) < most, "too large for the slow twin"
        choices = []
        for k, (s, rest) in enumerate(now):
            if rest:
                choices.append([((s, True), 0)])
                continue
            mine = [((to, False), c) for to, c in steps(problem, k, s, energy) if to in h[k]]
            if place[s] == problem.goals[k]:
                mine.append(((s, True), 0))
            choices.append(mine)
        for pick in product(*choices):
            then = tuple(state for state, _ in pick)
            at, to = [place[s] for s, _ in now], [place[s] for s, _ in then]
            if len(set(to)) < n:
                continue
            if any(at[i] == to[j] and at[j] == to[i] and at[i] != to[i] for i in range(n) for j in range(i)):
                continue
            g2 = g + sum(c for _, c in pick)
            if g2 < best.get(then, 2**62):
                best[then] = g2
                f = g2 + sum(0 if rest else h[k][s] for k, (s, rest) in enumerate(then))
                heapq.heappush(heap, (f, g2, then))
    return None


def cost_of(problem: Problem, solution: Solution, energy: bool) -> int:
    """Cost of a plan, walked motion by motion; fails where a motion doesn't exist."""
    total = 0
    for k, states in enumerate(solution.states):
        for a, b in zip(states[:-1].tolist(), states[1:].tolist(), strict=True):
            total += min(c for to, c in steps(problem, k, a, energy) if to == b)
    return total


def check_plan(problem: Problem, solution: Solution, energy: bool) -> None:
    """The plan is legal, starts and ends where asked, and costs what it says."""
    graph = problem.graph
    assert [int(states[0]) for states in solution.states] == problem.starts.tolist()
    breaches = judge_plan(
        graph,
        [graph.state_place[states] for states in solution.states],
        starts=graph.state_place[problem.starts].tolist(),
        goals=problem.goals.tolist(),
        blocked=np.nonzero(problem.blocked)[0].tolist(),
    )
    assert breaches == []
    assert cost_of(problem, solution, energy) == solution.cost
    assert solution.lower_bound <= solution.cost
