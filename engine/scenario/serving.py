"""Which exits an order may leave by, and which part of the floor a vehicle serves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.scenario.model import Scenario
from engine.types import StationKind
from engine.world.floor import World


def exits_of(scenario: Scenario, world: World) -> tuple[int, ...]:
    """Places of the outbound stations when the dispatcher chooses among them; else none."""
    if scenario.dispatch.exits != "any outbound":
        return ()
    return tuple(station.place for station in world.stations_of(StationKind.OUTBOUND))


def regions_of(scenario: Scenario, world: World) -> NDArray[np.int16]:
    """(P,) strip of the floor, from west to east, of every place; empty without regions."""
    count = scenario.dispatch.regions
    if not count:
        return np.zeros(0, np.int16)
    share = world.graph.xy_m[:, 0].astype(np.float64) / world.size_m[0]
    return np.clip((share * count).astype(np.int16), 0, count - 1)
