"""Observing what arcs take: for planners that learn from it, and for the log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from engine.planners.base import Learner, Observed
from engine.traffic import ArcTimes, new_arc_times, observe
from engine.types import FOREVER
from engine.units import ticks_from_s
from engine.world.network import NetworkWorld

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation

PERIOD_S = 1800.0
"""How often arc times are logged when the planner names no period."""
MS = 1000
_NOTHING = np.zeros(0, np.int32)


class Learning:
    """Arc times of a run: of the present period, in which what the kernel logs is counted.

    next_tick: when the period ends; FOREVER when nobody asks for arc times.
    """

    def __init__(self, sim: Simulation):
        planner: Any = sim.parts.planner
        router = getattr(planner, "router", planner)
        self.learner = router if isinstance(router, Learner) else None
        self.on = self.learner is not None or isinstance(sim.world, NetworkWorld)
        self.period = max(1, ticks_from_s(self.learner.refresh_s if self.learner else PERIOD_S, sim.tick_s))
        self.times: ArcTimes = new_arc_times(sim.graph.arc_ticks, sim.n)
        self.next_tick = self.period * (sim.tick // self.period + 1) if self.on else FOREVER

    def see(self, rows: NDArray[np.int64], n: int) -> None:
        """Take n motion rows."""
        if self.on:
            observe(self.times, rows, n, _NOTHING, _NOTHING, _NOTHING)


def begin(sim: Simulation) -> None:
    """Let a planner that learns know that nothing was observed yet."""
    if sim.learning.learner is not None:
        nothing = np.zeros(sim.graph.n_places, np.int64)
        sim.memory = sim.learning.learner.learn(Observed(nothing, nothing, sim.tick_s), sim.memory)


def refresh(sim: Simulation) -> None:
    """End a period: let the planner learn, log the arcs, and count from zero."""
    sim.drain()
    learning, times = sim.learning, sim.learning.times
    learning.next_tick = sim.tick + learning.period
    tick_ms = sim.tick_s * MS
    expected: Any = np.rint(times.own * tick_ms)
    if learning.learner is not None:
        sim.memory = learning.learner.learn(Observed(times.samples, times.total, sim.tick_s), sim.memory)
        expected = sim.memory["expected_ms"]
    n = np.maximum(times.samples, 1)
    mean = times.total / n
    spread = np.sqrt(np.maximum(times.squares - times.total * mean, 0) / np.maximum(times.samples - 1, 1))
    for p in np.flatnonzero((times.own > 0) & ((times.samples > 0) | (times.busy > 0))).tolist():
        sim.ledger.row(
            "arcs", sim.tick, p, int(times.samples[p]), round(mean[p] * tick_ms), round(spread[p] * tick_ms),
            round(times.busy[p] * tick_ms), int(expected[p]),
        )  # fmt: skip
    for sums in (times.samples, times.total, times.squares, times.busy):
        sums[:] = 0
