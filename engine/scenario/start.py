"""Where the vehicles of a scenario stand at tick 0."""

from __future__ import annotations

from engine.errors import ScenarioError
from engine.scenario.model import Scenario
from engine.world.floor import GridWorld, World
from engine.world.terrain import TerrainWorld


def start_places(scenario: Scenario, world: World) -> tuple[int, ...]:
    """Place of every vehicle at tick 0, all different. Raises ScenarioError when there are too few.

    Vehicles are spread evenly over the chargers (or the parking); those that find none there stand on the other kind.
    """
    start, count = scenario.fleet.start, scenario.fleet.count
    if not isinstance(start, str) and isinstance(world, GridWorld | TerrainWorld):
        return tuple(world.place_at(x, y) for x, y in start)
    first, second = (world.chargers, world.parking) if start != "parking" else (world.parking, world.chargers)
    if count > len(first) + len(second):
        raise ScenarioError(
            f"fleet.count: got {count} vehicles, expected at most {len(first) + len(second)}: "
            f"the floor has {len(world.chargers)} chargers and {len(world.parking)} parking bays"
        )
    here = min(count, len(first))
    places: list[int] = []
    for bays, n in ((first, here), (second, count - here)):
        places += [int(bays[i * len(bays) // n]) for i in range(n)]
    return tuple(places)
