"""Other people's planners from the package index, for `wattlane bench`: each is measured when it is installed.

networkx always is; pathfinding, pyastar2d, pymapf and cuplan are when somebody installed them beside Wattlane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.scenario.movingai import Instance

Call = Callable[[], Any]
OPTIONAL = ("pathfinding", "pyastar2d", "pymapf", "cuplan")


def installed() -> dict[str, str]:
    """Peers that can be measured here, and their versions."""
    found = {}
    for name in ("networkx", *OPTIONAL):
        try:
            import_module(name)
            found[name] = metadata.version(name)
        except ImportError:
            continue
    return found


def networkx_astar(instance: Instance) -> Call:
    """A* by Manhattan distance over all trips of an instance."""
    import networkx as nx

    free = instance.free
    height, width = free.shape
    graph = nx.Graph()
    cells = [(x, y) for y in range(height) for x in range(width) if free[y, x]]
    graph.add_nodes_from(cells)
    graph.add_edges_from(((x, y), (x + 1, y)) for x, y in cells if x + 1 < width and free[y, x + 1])
    graph.add_edges_from(((x, y), (x, y + 1)) for x, y in cells if y + 1 < height and free[y + 1, x])

    def call() -> list[int]:
        return [
            len(nx.astar_path(graph, a, b, heuristic=lambda u, v: abs(u[0] - v[0]) + abs(u[1] - v[1]))) - 1
            for a, b in zip(instance.starts, instance.goals, strict=True)
        ]

    return call


def pathfinding_astar(instance: Instance) -> Call:
    """The same by pathfinding."""
    grid_of = import_module("pathfinding.core.grid").Grid
    finder = import_module("pathfinding.finder.a_star").AStarFinder()
    grid = grid_of(matrix=instance.free.astype(int).tolist())

    def call() -> list[int]:
        steps = []
        for a, b in zip(instance.starts, instance.goals, strict=True):
            grid.cleanup()
            path, _ = finder.find_path(grid.node(*a), grid.node(*b), grid)
            steps.append(len(path) - 1)
        return steps

    return call


def pyastar2d_astar(instance: Instance) -> Call:
    """The same by pyastar2d."""
    import numpy as np

    search = import_module("pyastar2d").astar_path
    weights = np.where(instance.free, 1, np.inf).astype(np.float32)

    def call() -> list[int]:
        return [
            len(search(weights, a[::-1], b[::-1], allow_diagonal=False)) - 1
            for a, b in zip(instance.starts, instance.goals, strict=True)
        ]

    return call


def pymapf_cbs(instance: Instance, limit_s: float) -> Call:
    """CBS by pymapf: the sum of costs, or None when the limit ended it."""
    pymapf = import_module("pymapf")
    problem = _many(pymapf.MAPFProblem, pymapf.GridMap((~instance.free).astype(int).tolist()), pymapf.Agent, instance)

    def call() -> int | None:
        found = pymapf.solve(problem, "cbs", time_limit=limit_s, max_expansions=10**9)
        return None if found is None else int(found.sum_of_costs)

    return call


def cuplan_prioritized(instance: Instance) -> Call:
    """Prioritized planning by cuplan on the CPU: the sum of costs, or None without a plan."""
    cuplan = import_module("cuplan")
    problem = _many(cuplan.Problem, cuplan.Grid(~instance.free), cuplan.Agent, instance)
    planner = cuplan.PrioritizedPlanning(backend="cpu")

    def call() -> int | None:
        found = planner.solve(problem)
        return None if found is None else int(found.sum_of_costs)

    return call


def _many(problem_of: Any, grid: Any, agent_of: Any, instance: Instance) -> Any:
    ends: Sequence[Any] = list(zip(instance.starts, instance.goals, strict=True))
    return problem_of(grid, [agent_of(str(k), a[::-1], b[::-1]) for k, (a, b) in enumerate(ends)])
