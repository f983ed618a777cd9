"""From an instance to a one-shot problem.

A vehicle's heading at the start is that of the cheapest way to its goal by energy, alone on the floor (the first of
east, north, west, south among equals): Xu & Wang's first motion is straight in whichever direction it goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.energy import CostTable
from engine.errors import ScenarioError
from engine.planners.eea import Eea
from engine.planners.oneshot import I32, Problem
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
    if heading == "cheapest":
        chosen = cheapest_starts(graph, costs, starts, goals, cls)
    else:
        per_place = graph.n_states // max(graph.n_places, 1)
        chosen = np.array(starts, np.int32) * np.int32(per_place) + np.int32(2 * HEADINGS.index(heading))
    return Problem(graph, chosen, np.array(goals, np.int32), costs, cls, np.zeros(graph.n_places, np.uint8))


def cheapest_starts(graph: MotionGraph, costs: CostTable, starts: Sequence[int], goals: Sequence[int], cls: I32) -> I32:
    """The standing state of each start place that begins the cheapest way to its goal; facing east without a way."""
    floor = Floor(graph, costs)
    chosen = np.zeros(len(starts), np.int32)
    for i, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        way = Eea().search(floor, start, goal, cls=int(cls[i]))
        chosen[i] = way.states[0] if way.status is PlanStatus.SOLVED else start * floor.per_place
    return chosen
