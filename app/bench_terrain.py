"""`wattlane bench`: AD* on 60 m × 60 m of terrain. CPU times of this process, kernels compiled before."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from time import process_time
from typing import Any

SEEDS = (1, 2, 3, 4, 5)


def terrain(measured: Callable[..., Any], at_most: Callable[..., Any], *, quick: bool = False) -> list[Any]:
    """Compiling, the first way, the best way, and repair: medians over seeded terrains.

    measured, at_most: make a line of the table, without and with a goal.
    """
    import numpy as np

    from engine.build import terrain_costs
    from engine.studies.zhang2021 import changes, ground_of, passes, repair, robot_of, search_on, world_of

    robot = robot_of({})
    compiled, first, best, ratio, expanded, size = [], [], [], [], [], 0
    for seed in (0, *(SEEDS[:2] if quick else SEEDS)):
        ground = ground_of("bumps", seed)
        begun = process_time()
        world = world_of(ground)
        costs = terrain_costs(world, robot, "energy")
        compile_s = process_time() - begun
        search = search_on(world, costs, robot)
        begun = process_time()
        search.restart()
        restart_ms = 1000 * (process_time() - begun)
        found = passes(search)
        repaired = repair(world, costs, robot, changes(np.random.default_rng(seed), world, costs, 0.0))
        if seed == 0 or not found or not found[0][0].found or repaired is None:
            continue  # the first one compiles kernels
        compiled.append(compile_s)
        first.append(restart_ms + found[0][1])
        best.append((restart_ms + found[-1][1]) / 1000)
        expanded.append(search.expanded / max(found[-1][1], 1e-9) / 1000)
        ratio.append(repaired[0])
        arrays = [getattr(world.graph, name) for name in world.graph.__slots__]
        arrays += [costs.cost, costs.height, *search.open]
        size = sum(a.nbytes for a in arrays if isinstance(a, np.ndarray))
    middle = statistics.median
    return [
        at_most("terrain 300 × 300 × 16: compiled, CPU", middle(compiled), "s", 3),
        at_most("terrain: graph, costs and search", size / 1e6, "MB", 500),
        at_most("AD*: first way (ε = 2.5), CPU", middle(first), "ms", 50),
        at_most("AD*: best way (ε = 2.5 to 1), CPU", middle(best), "s", 0.6),
        at_most("AD*: repair of what 4 m reveal, over planning anew", middle(ratio), "%", 10),
        measured("AD*: expansions", middle(expanded), "million/s"),
    ]
