"""The judge: is a run, or a plan, legal? It shares no code with planners, traffic or the simulation.

What it reads is the log alone; what it knows of the rules it works out anew from the scenario and the world.
"""

from __future__ import annotations

from engine.scenario import Scenario
from engine.sim.judge.breach import Breach, BreachKind, in_order
from engine.sim.judge.commands import commands
from engine.sim.judge.energy import energy
from engine.sim.judge.ground import judge_ground
from engine.sim.judge.motion import blocked, continuity, edges_of, existence
from engine.sim.judge.occupancy import occupancy
from engine.sim.judge.orders import orders
from engine.sim.judge.plan import judge_plan, judge_plan_file
from engine.sim.judge.record import RunLog, record_of
from engine.world.floor import World
from engine.world.terrain import TerrainWorld

__all__ = ["Breach", "BreachKind", "judge", "judge_plan", "judge_plan_file"]


def judge(reader: RunLog, scenario: Scenario, world: World) -> list[Breach]:
    """Every broken rule of a recorded run, by tick; an empty list is a clean verdict.

    reader: a finished, running or killed run's log, up to where it goes; what retention dropped is not judged.
    At most breach.REPORTED breaches are listed per rule.
    """
    if isinstance(world, TerrainWorld):
        return in_order(judge_ground(reader, scenario, world))
    r = record_of(reader, world.graph)
    edge = edges_of(r, world.graph)
    return in_order(
        [
            *continuity(r, world),
            *existence(r, edge, world),
            *blocked(r, edge, reader, world),
            *occupancy(r, edge, world),
            *orders(r, reader, scenario, world),
            *energy(r, reader, scenario, world.graph),
            *commands(r, reader, scenario, world),
        ]
    )
