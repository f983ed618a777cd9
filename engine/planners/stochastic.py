"""Routes by learned arc times (Lian et al. 2024, the paper's own method).

Every arc (i, j) has an expected time E(w_ij), at first its own, later the mean of what vehicles needed in the last
period. A* over (node, heading): g sums the expected times of the arcs driven, T per turn of 90 degrees and T_o per
stop; h is the exact expected time to go, by a backward search over the whole network, so the route is optimal for the
expected times. Minimising expectations picks the arc that is probably quicker only where P(X ≤ Y) ≥ ½ goes with
E(X) ≤ E(Y) (the paper's theorem 1), as for independent normals (p_quicker).

Printed otherwise, and here as `literal`: g = L/v_e + ΣT + T_o, blind to what was learned, and h = the number of arcs to
go times the mean expected time of all arcs, which overestimates where arcs are quicker than the mean.

Promise: legal by the shared timer; least expected time on an empty floor. Cost: one A* per leg, one backward search per
goal and period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.planners.base import Memory, Observed, Promise, View
from engine.planners.routing import entered, lengths_of, route_by, route_legs, turns_of
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

MS = 1000


@dataclass(frozen=True)
class Stochastic:
    """turn_ms: T · stop_ms: T_o · refresh_s: period · min_samples: fewer leave an arc's time as it was.

    smoothing: weight of the newest mean; below 1 not everybody changes over to the same empty arcs at once · literal:
    the printed g and h.
    """

    turn_ms: int = 1000
    stop_ms: int = 0
    refresh_s: float = 1800.0
    min_samples: int = 5
    smoothing: float = 0.5
    literal: bool = False

    promise = Promise(
        summary="the route of least expected time, learned from what arcs took so far",
        optimal="in expected time, on an empty floor",
        occupancies=frozenset({Occupancy.HOLD}),
    )

    def __post_init__(self) -> None:
        if not 0 < self.smoothing <= 1:
            raise ValueError(f"smoothing must be more than 0 and at most 1; got {self.smoothing!r}")
        if self.turn_ms < 0 or self.stop_ms < 0 or self.min_samples < 1 or self.refresh_s <= 0:
            raise ValueError("turn_ms and stop_ms can't be negative, min_samples and refresh_s must be positive")

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """What stays the same; `learn` fills in expected times and costs, first before anything was observed."""
        arc, turn = entered(graph), turns_of(graph) * self.turn_ms // 90
        into_node = (arc < 0) & (lengths_of(graph) > 0)
        return {
            "own_ticks": graph.arc_ticks.astype(np.int64),
            "arc": arc,
            "extra_ms": turn + np.where(into_node, self.stop_ms, 0),
            "expected_ms": np.zeros(graph.n_places, np.int64),
            "cost": np.zeros(graph.n_edges, np.int64),
            "version": 0,
        }

    def learn(self, observed: Observed, memory: Memory) -> Memory:
        """Expected times after a period in which arcs were visited so often and took so long."""
        tick_ms, n = round(observed.tick_s * MS), observed.samples
        own = memory["own_ticks"] * tick_ms
        old = memory["expected_ms"] if memory["version"] else own
        mean = observed.total_ticks * tick_ms / np.maximum(n, 1)
        new = np.where(n >= self.min_samples, np.rint((1 - self.smoothing) * old + self.smoothing * mean), old)
        expected = new.astype(np.int64)
        arc = memory["arc"]
        cost = np.where(arc >= 0, (own if self.literal else expected)[arc], 0) + memory["extra_ms"]
        return {**memory, "expected_ms": expected, "cost": cost, "version": int(memory["version"]) + 1}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router."""
        if self.literal:
            goals = np.array([leg.place for leg in view.request.legs], np.int32)
            h = np.stack([printed_h(view.graph, memory["expected_ms"], goal) for goal in goals.tolist()])
            return route_by(view, memory["cost"], h, np.arange(len(goals), dtype=np.int32), goals), memory
        tables = view.search.by_edge("expected", int(memory["version"]), memory["cost"])
        return route_legs(view, memory["cost"], tables), memory


def printed_h(graph: MotionGraph, expected_ms: I64, goal: int) -> I64:
    """Equation 12 as printed, over poses: Manhattan distance in mean arcs times the mean expected time of all arcs."""
    lanes = graph.arc_ticks > 0
    arc_m = float(graph.kind_mm[graph.edge_kind[entered(graph) >= 0]].max()) / 1000
    away = np.abs(graph.xy_m - graph.xy_m[goal]).sum(axis=1) / arc_m
    h: I64 = np.rint(away * expected_ms[lanes].mean()).astype(np.int64)
    return h[graph.state_place[::2]]


def p_quicker(mean_x: float, sd_x: float, mean_y: float, sd_y: float) -> float:
    """P(X ≤ Y) for independent normal X and Y: at least ½ exactly when mean_x ≤ mean_y, which is theorem 1.

    For other distributions the theorem fails: of X ~ Exp(1) and Y = 0.8, X is larger in the mean and yet the smaller
    one with probability 1 − e^−0.8 = 0.55.
    """
    spread = math.hypot(sd_x, sd_y)
    if spread == 0:
        return float(mean_x <= mean_y)
    return 0.5 * math.erfc((mean_x - mean_y) / spread / math.sqrt(2))
