"""From an instance to a one-shot problem.

A vehicle's heading at the start is that of the cheapest way to its goal by energy, alone on the floor (the first of
east, north, west, south among equals): Xu & Wang's first motion is straight in whichever direction it goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.errors import ScenarioError
from engine.planners.eea import Eea
from engine.planners.oneshot import Problem
from engine.planners.single import Floor
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance
from engine.types import PlanStatus
from engine.world.motion_graph import MotionGraph

HEADINGS = ("east", "north", "west", "south")


def problem_of(
    instance: Instance,
    agents: int | None = None,
    *,
    masses_kg: Sequence[float] = (1000.0,),
    parameters: Mapping[str, float] | None = None,
    heading: str = "cheapest",
    graph: MotionGraph | None = None,
) -> Problem:
    """The first `agents` vehicles (all by default) on the instance's 4-connected unit-duration graph.

    masses_kg: in turn, one per vehicle · parameters: of xu2025's energies, over the defaults · heading: `cheapest`, or
    one of HEADINGS for all · graph: the instance's own, when it is already there. Raises FormatError, ScenarioError.
    """
    if heading != "cheapest" and heading not in HEADINGS:
        raise ScenarioError(f"heading: 'cheapest' or one of {', '.join(HEADINGS)} was expected, got {heading!r}")
    if not masses_kg or min(masses_kg) <= 0:
        raise ScenarioError(f"masses in kg above 0 were expected, got {list(masses_kg)}")
    instance = instance if agents is None else instance.first(agents)
    graph = graph or instance.graph()
    n = instance.agents
    each = [float(masses_kg[i % len(masses_kg)]) for i in range(n)]
    distinct = sorted(set(each)) or [float(masses_kg[0])]
    costs = xu2025_costs(graph, distinct, parameters)
    cls = np.array([distinct.index(mass) for mass in each], np.int32)
    places = np.cumsum(instance.free.ravel()).reshape(instance.free.shape) - 1
    starts = [int(places[y, x]) for x, y in instance.starts]
    goals = [int(places[y, x]) for x, y in instance.goals]
    per_place = graph.n_states // max(graph.n_places, 1)
    chosen = np.zeros(n, np.int32)
    floor = Floor(graph, costs)
    for i, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        if heading == "cheapest":
            way = Eea().search(floor, start, goal, cls=int(cls[i]))
            solved = way.status is PlanStatus.SOLVED
            chosen[i] = way.states[0] if solved else start * per_place
        else:
            chosen[i] = start * per_place + 2 * HEADINGS.index(heading)
    return Problem(graph, chosen, np.array(goals, np.int32), costs, cls, np.zeros(graph.n_places, np.uint8))
