"""MAPF instances as scenarios: from MovingAI texts, and what their checks find."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from engine.errors import FormatError, ScenarioError
from engine.scenario.model import Scenario
from engine.scenario.reading import from_dict
from engine.world.floor import GridWorld
from engine.world.terrain import TerrainWorld

if TYPE_CHECKING:
    from engine.world.floor import World

END_S = 86_400.0
"""Simulated seconds after which an instance ends whose vehicles can't all reach their goals."""


def from_movingai(
    map_text: str,
    scen_text: str,
    *,
    agents: int | None = None,
    planner: str = "prioritized",
    objective: str = "time",
    map_name: str = "floor.map",
    scen_name: str = "floor.scen",
    masses_kg: float | Sequence[float] = 1000.0,
    seed: int = 1,
) -> Scenario:
    """A scenario of the first `agents` rows (all by default): unit steps, occupancy `mapf`, a goal for every vehicle.

    masses_kg: of all vehicles, or theirs in turn · map_name, scen_name: for messages, title and name. Raises
    ScenarioError with file and line.
    """
    from engine.scenario.movingai import instance_of, map_rows, parse_map, parse_scen

    try:
        free = parse_map(map_text, map_name)
        instance = instance_of(free, parse_scen(scen_text, scen_name), agents, map_name, scen_name)
    except FormatError as error:
        raise ScenarioError(str(error)) from error
    if not instance.agents:
        raise ScenarioError(f"{scen_name}: at least one vehicle was expected, got none")
    stem = re.sub(r"\.map$", "", map_name)
    shown = stem if len(stem) <= 60 else stem[:59] + "…"
    masses: dict[str, Any] = (
        {"mass_kg": float(masses_kg)} if isinstance(masses_kg, int | float) else {"masses_kg": tuple(masses_kg)}
    )
    height, width = free.shape
    n = instance.agents
    return from_dict(
        {
            "name": _slug(stem),
            "title": f"{shown}: {n} vehicle{'s' * (n != 1)} to {'their goals' if n != 1 else 'its goal'}",
            "description": f"MovingAI map {map_name} ({width} × {height} cells), the first {n} rows of {scen_name}.",
            "seed": seed,
            "time": {"finish": "goals reached", "until_s": END_S},
            "floor": {"kind": "movingai", "occupancy": "mapf", "rows": "\n".join(map_rows(free))},
            "fleet": {"count": n, "start": instance.starts, **masses},
            "orders": {"source": "goals", "goals": instance.goals},
            "planner": {"name": planner, "objective": objective},
            "log": {"sample_s": 1.0},
        },
        scen_name,
    )


def _slug(stem: str) -> str:
    """A name that a scenario may have, from that of a file."""
    return re.sub(r"[^a-z0-9._-]+", "-", stem.lower()).strip("._-")[:80] or "instance"


def goal_places(scenario: Scenario, world: World) -> tuple[int, ...]:
    """Goal of every vehicle as a place; empty where orders come from elsewhere."""
    if scenario.orders.source != "goals" or not isinstance(world, GridWorld | TerrainWorld):
        return ()
    return tuple(world.place_at(x, y) for x, y in scenario.orders.goals)
