"""Where orders come from: listed pairs, Poisson arrivals between kinds of stations, or a backlog kept full."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from engine.errors import InvariantBroken
from engine.types import FOREVER


class OrderSource(Protocol):
    """Yields orders as (tick, from station, to station), in the order of their ticks."""

    @property
    def next_tick(self) -> int:
        """Tick of the next order; FOREVER when there is none to come."""
        ...

    def take(self) -> tuple[int, int, int]:
        """The next order."""
        ...

    def see(self, open_orders: int) -> None:
        """Take note of how many orders wait for a vehicle."""
        ...

    def set_rate(self, per_h: float, tick: int) -> str:
        """Change the mean rate from a tick on; returns why not, or an empty string."""
        ...

    def start_at(self, tick: int) -> None:
        """Let the first order come after a tick."""
        ...

    def to_plain(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        ...

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Undo `to_plain`."""
        ...


class Listed:
    """Pairs of station numbers, all known at tick 0."""

    def __init__(self, pairs: Sequence[tuple[int, int]]):
        self._pairs = tuple(pairs)
        self._at = 0

    @property
    def next_tick(self) -> int:
        return 0 if self._at < len(self._pairs) else FOREVER

    def take(self) -> tuple[int, int, int]:
        a, b = self._pairs[self._at]
        self._at += 1
        return 0, a, b

    def see(self, open_orders: int) -> None:
        """Listed orders wait for nobody."""

    def set_rate(self, per_h: float, tick: int) -> str:
        return "the orders of this scenario are listed; there is no rate to change"

    def start_at(self, tick: int) -> None:
        self._at = len(self._pairs) if tick > 0 else 0

    def to_plain(self) -> dict[str, Any]:
        return {"at": self._at}

    def restore(self, plain: Mapping[str, Any]) -> None:
        self._at = int(plain["at"])


class NoOrders:
    """None at all: the vehicles drive to goals of their own."""

    next_tick = FOREVER

    def take(self) -> tuple[int, int, int]:
        raise InvariantBroken("there is no order to take")

    def see(self, open_orders: int) -> None:
        """Nobody waits."""

    def set_rate(self, per_h: float, tick: int) -> str:
        return "the vehicles of this scenario drive to goals of their own; there is no rate to change"

    def start_at(self, tick: int) -> None:
        """Nothing starts."""

    def to_plain(self) -> dict[str, Any]:
        return {}

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Nothing to restore."""


class Poisson:
    """Arrivals with exponential gaps between kinds of stations.

    mix: rows of (stations to come from, stations to go to, weight) · limit: number of orders, or None · initial: orders
    that wait already at tick 0.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        rate_per_h: float,
        mix: Sequence[tuple[Sequence[int], Sequence[int], float]],
        tick_s: float,
        limit: int | None,
        initial: int = 0,
    ):
        self._rng, self._mix, self._tick_s = rng, mix, tick_s
        self._rate, self._left = rate_per_h, limit
        weights = np.array([w for _, _, w in mix])
        self._bounds = np.cumsum(weights / weights.sum())
        self._initial = initial
        self._time = 0.0
        self._draw_gap()

    def _draw_gap(self) -> None:
        gap = self._rng.exponential(3600.0 / self._rate / self._tick_s) if self._rate > 0 else float(FOREVER)
        self._time = min(self._time + gap, float(FOREVER))

    @property
    def next_tick(self) -> int:
        if self._left == 0:
            return FOREVER
        return 0 if self._initial else int(self._time)

    def take(self) -> tuple[int, int, int]:
        tick = self.next_tick
        row = min(int(np.searchsorted(self._bounds, self._rng.random(), side="right")), len(self._mix) - 1)
        sources, targets, _ = self._mix[row]
        a = sources[int(self._rng.integers(len(sources)))]
        b = targets[int(self._rng.integers(len(targets)))]
        if self._left is not None:
            self._left -= 1
        if self._initial:
            self._initial -= 1
        else:
            self._draw_gap()
        return tick, a, b

    def see(self, open_orders: int) -> None:
        """Arrivals wait for nobody."""

    def set_rate(self, per_h: float, tick: int) -> str:
        self._rate = per_h
        self.start_at(tick)
        return ""

    def start_at(self, tick: int) -> None:
        self._time, self._initial = float(tick), 0
        self._draw_gap()

    def to_plain(self) -> dict[str, Any]:
        return {
            "rng": self._rng.bit_generator.state,
            "rate": self._rate,
            "left": self._left,
            "time": self._time,
            "initial": self._initial,
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        self._rng.bit_generator.state = plain["rng"]
        self._rate, self._left, self._time = plain["rate"], plain["left"], plain["time"]
        self._initial = plain["initial"]


class Backlog:
    """A closed loop: whenever fewer than `backlog` orders are open, new ones come between kinds of stations.

    The sequence of orders depends on the seed alone, not on how fast they are carried. mix, limit: as for Poisson.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        mix: Sequence[tuple[Sequence[int], Sequence[int], float]],
        backlog: int,
        limit: int | None,
    ):
        self._rng, self._mix, self._backlog, self._left = rng, mix, backlog, limit
        weights = np.array([w for _, _, w in mix])
        self._bounds = np.cumsum(weights / weights.sum()).tolist()
        self._missing = backlog

    @property
    def next_tick(self) -> int:
        return 0 if self._missing > 0 and self._left != 0 else FOREVER

    def take(self) -> tuple[int, int, int]:
        which, origin, target = self._rng.random(3).tolist()
        sources, targets, _ = self._mix[min(bisect_right(self._bounds, which), len(self._mix) - 1)]
        a, b = sources[int(origin * len(sources))], targets[int(target * len(targets))]
        self._missing -= 1
        if self._left is not None:
            self._left -= 1
        return 0, a, b

    def see(self, open_orders: int) -> None:
        self._missing = self._backlog - open_orders

    def set_rate(self, per_h: float, tick: int) -> str:
        return "the orders of this scenario come as fast as they are carried; there is no rate to change"

    def start_at(self, tick: int) -> None:
        self._missing = self._backlog

    def to_plain(self) -> dict[str, Any]:
        return {"rng": self._rng.bit_generator.state, "left": self._left, "missing": self._missing}

    def restore(self, plain: Mapping[str, Any]) -> None:
        self._rng.bit_generator.state = plain["rng"]
        self._left, self._missing = plain["left"], plain["missing"]
