"""Seeded breakdowns and repairs of vehicles. Delays of single motions are drawn in the step kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from engine.types import FOREVER


class Faults:
    """Exponential times between breakdowns, per vehicle; each vehicle draws from a generator of its own."""

    def __init__(self, seed: np.random.SeedSequence, vehicles: int, per_day: float, repair_ticks: int, tick_s: float):
        self._rngs = [np.random.default_rng(s) for s in seed.spawn(vehicles)]
        self._mean = 86_400.0 / per_day / tick_s if per_day > 0 else 0.0
        self.repair_ticks = max(1, repair_ticks)
        self._next = [self._draw(v, 0) for v in range(vehicles)]
        self._repair = [FOREVER] * vehicles
        self.next_tick = min(self._next, default=FOREVER)

    def _draw(self, v: int, tick: int) -> int:
        if not self._mean:
            return FOREVER
        return int(min(tick + 1 + self._rngs[v].exponential(self._mean), FOREVER))

    def due(self, tick: int) -> list[tuple[int, bool]]:
        """(vehicle, repaired) for every breakdown (False) and repair (True) up to a tick, and draw the next."""
        out: list[tuple[int, bool]] = []
        for v in range(len(self._next)):
            if self._repair[v] <= tick:
                self._repair[v] = FOREVER
                out.append((v, True))
            if self._next[v] <= tick:
                self._next[v] = self._draw(v, tick)
                out.append((v, False))
        self._set_next()
        return out

    def repair_at(self, vehicle: int, tick: int) -> None:
        """A broken vehicle will work again at a tick (FOREVER: when somebody says so)."""
        self._repair[vehicle] = tick
        self._set_next()

    def start_at(self, tick: int) -> None:
        """Draw the first breakdowns anew, from a tick on."""
        self._next = [self._draw(v, tick) for v in range(len(self._next))]
        self._set_next()

    def _set_next(self) -> None:
        self.next_tick = min(min(self._next, default=FOREVER), min(self._repair, default=FOREVER))

    def to_plain(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return {"next": self._next, "repair": self._repair, "rngs": [r.bit_generator.state for r in self._rngs]}

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Undo `to_plain`."""
        self._next, self._repair = list(plain["next"]), list(plain["repair"])
        for rng, state in zip(self._rngs, plain["rngs"], strict=True):
            rng.bit_generator.state = state
        self._set_next()
