"""What the judge reports."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

REPORTED = 1000
"""At most so many breaches are reported per rule: a broken run breaks it everywhere."""


class BreachKind(StrEnum):
    """Which rule was broken."""

    CONTINUITY = "continuity"  # a gap or overlap in time, or a vehicle that is somewhere else than it was
    OBSTACLE = "obstacle"  # not a place for vehicles
    EDGE = "edge"  # no way leads from one place to the other
    ONE_WAY = "one-way"  # only the opposite way exists
    PRIMITIVE = "primitive"  # the way exists, but not by this motion from this state
    DURATION = "duration"
    BLOCKED = "blocked"  # drove into a blocked place
    VERTEX = "vertex"  # two vehicles in one place
    SWAP = "swap"  # two vehicles through each other
    CROSSING = "crossing"  # over a diagonal or its corners
    ORDER = "order"  # picked or dropped at the wrong place, by the wrong vehicle, twice, or out of turn
    SERVICE = "service"  # took another time than the scenario says
    LOAD = "load"  # loaded or empty against its orders
    ENERGY = "energy"  # a ledger that is not the sum over the motions
    BATTERY = "battery"  # a charge that does not follow from the ledger
    SOC = "soc"  # below empty or above full
    COMMAND = "command"  # an accepted command without its effect
    GOAL = "goal"  # a plan that begins or ends elsewhere


@dataclass(frozen=True, slots=True)
class Breach:
    """One broken rule. tick: when · vehicles: who · place: where, or -1 · text: a sentence for a person."""

    kind: BreachKind
    tick: int
    vehicles: tuple[int, ...]
    place: int
    text: str


def in_order(breaches: Iterable[Breach]) -> list[Breach]:
    """By tick, then kind, vehicles and place."""
    return sorted(breaches, key=lambda b: (b.tick, b.kind, b.vehicles, b.place))
