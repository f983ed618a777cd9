"""The contracts of dispatchers and charging policies, and what they are shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from engine.dispatch import kernels
from engine.orders.book import OrderBook
from engine.planners.base import Search
from engine.types import NONE

SAFETY = 1.25
"""Waiting, restarts and detours over the energy of the quickest way on an empty floor."""
NOBODY_FREE = "no vehicle is free"
"""The one refusal that is no news."""


@dataclass(slots=True)
class FloorView:
    """Read-only aliases of what dispatchers may know; made once per run, `tick` apart.

    state, soc: (V,) · free: vehicles without an order that may take one · home: (V,) place where a vehicle's plan
    ends · holder: (P,) vehicle whose plan ends at a place, or -1 · rests: rest places in working order.
    """

    tick: int
    tick_s: float
    search: Search
    orders: OrderBook
    waiting: list[int]  # open orders that may be given now, oldest first
    at: NDArray[np.int32]  # (V,) motion state from which a new plan would start
    charge_mj: NDArray[np.int64]  # (V,) energy left at the present voltage
    capacity_mj: NDArray[np.int64]
    home: NDArray[np.int32]
    holder: NDArray[np.int32]
    is_charger: NDArray[np.uint8]  # (P,) a working charger
    is_rest: NDArray[np.uint8]  # (P,) a place where a vehicle may stand for good
    rests: NDArray[np.int32]
    xy: NDArray[np.float32]
    heaviest: float  # loaded mass over empty mass
    standby_mj: int
    service_ticks: tuple[int, int]
    levels: dict[str, float]
    must_charge: NDArray[np.uint8]  # (V,) below `good` and not yet back at `sufficient`
    blocked: NDArray[np.uint8]
    order: NDArray[np.int32]  # (V,) order that a vehicle carries out now, or -1
    failed: NDArray[np.int8]  # (V,)
    paused: NDArray[np.int8]  # (V,)
    exits: tuple[int, ...] = ()  # places of the exits when a dispatcher chooses among them; else orders say where
    region: NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, np.int16))  # (P,) empty without regions
    _near: dict[int, NDArray[np.int32]] = field(default_factory=dict)

    def targets(self, order: int) -> list[int]:
        """Places, not blocked, where an order may be brought; empty also when its load can't be fetched."""
        book = self.orders
        own = book.to_place[order]
        if self.blocked[book.from_place[order]]:
            return []
        return [p for p in (self.exits if own in self.exits else (own,)) if not self.blocked[p]]

    def may_take(self, vehicle: int, order: int) -> bool:
        """Whether an order lies in a vehicle's region: vehicle v serves region v modulo their number."""
        if not len(self.region):
            return True
        return bool(self.region[self.orders.from_place[order]] == vehicle % (int(self.region.max()) + 1))

    def soc(self, vehicle: int) -> float:
        """State of charge of a vehicle, 0 to 1."""
        return float(self.charge_mj[vehicle] / self.capacity_mj[vehicle])

    def need_mj(self, state: int, goal: int, loaded: bool) -> int:
        """Energy of the quickest way to a place, with a start and the load; an estimate from above."""
        ticks, mj = self.search.ticks_to(goal, state), self.search.energy_to(goal, state)
        driving = (mj - ticks * self.standby_mj) * (self.heaviest if loaded else 1.0)
        return int(driving) + ticks * self.standby_mj + self.search.restart_mj

    @property
    def chargers(self) -> int:
        """How many chargers work."""
        return self.is_charger.tobytes().count(1)

    def to_charger_mj(self, place: int) -> int:
        """Energy of the way from a place to the nearest charger as the crow flies; 0 on a floor without."""
        if not self.chargers:
            return 0
        chargers = self.rests[self.is_charger[self.rests] == 1]
        away = np.abs(self.xy[chargers] - self.xy[place]).sum(axis=1)
        return self.need_mj(int(self.search.graph.place_ptr[place]), int(chargers[int(away.argmin())]), False)

    def nearest_rest(self, vehicle: int, place: int, chargers_only: bool, count: int = 3) -> list[int]:
        """The nearest free rest places by distance as the crow flies; the vehicle's own counts as free."""
        out = np.empty(count, np.int32)
        near = self.rests_by_distance(place)
        n = kernels.free_rests(near, self.holder, self.blocked, self.is_charger, vehicle, chargers_only, out)
        found: list[int] = out[:n].tolist()
        return found

    def rests_by_distance(self, place: int) -> NDArray[np.int32]:
        """All rest places, the nearest to a place first; sorted once per place."""
        if place not in self._near:
            away = np.abs(self.xy[self.rests] - self.xy[place]).sum(axis=1)
            self._near[place] = self.rests[np.argsort(away, kind="stable")]
        return self._near[place]


class Assignment(NamedTuple):
    """An order for a vehicle, and where the vehicle rests afterwards (candidates, best first).

    target: place where it is brought, -1 for the order's own · note: how good the plan is that it comes from.
    """

    order: int
    vehicle: int
    rests: tuple[int, ...]
    target: int = NONE
    note: str = ""


class Refusal(NamedTuple):
    """Why an order is not given to anybody now."""

    order: int
    reason: str


class Dispatcher(Protocol):
    """Gives open orders to free vehicles."""

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """Assignments, at most one per vehicle, and a refusal for every open order that it looked at in vain."""
        ...


class Move(NamedTuple):
    """Send a vehicle without an order to a rest place (candidates, best first)."""

    vehicle: int
    rests: tuple[int, ...]
    to_charge: bool


class ChargingPolicy(Protocol):
    """Says when a vehicle must charge, where it rests after an order, and who moves to a charger now."""

    def rests_after(self, view: FloorView, vehicle: int, place: int, mj_left: int) -> list[int]:
        """Where a vehicle may go from a place with so much energy left; empty when there is nowhere."""
        ...

    def moves(self, view: FloorView, idle: list[int]) -> tuple[list[Move], list[int]]:
        """Moves of idle vehicles, and the vehicles that queue for a charger, first come first."""
        ...
