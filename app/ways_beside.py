"""A router's ways beside other methods': what a run asked of its router is asked of them too, after the fact.

A router that has a `beside` names who stands beside it (see engine.planners.base.Compared). Searched again are the
first distinct ways of a run, each on the floor without vehicles and blocks, and each by the run's own method as well;
times are CPU times of this thread. Nothing of it reaches the simulation, its log or its digest.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from engine.build import PLANNERS, costs_of, find, planner_of
from engine.planners.base import Compared
from engine.results.runlog import Log
from engine.scenario import Scenario
from engine.types import OrderState, Task
from engine.world import World

MOST = 40
"""Ways of a run that are searched again."""

Query = tuple[int, int]


class WaysBeside:
    """What was found of a run's ways so far. Each way is searched once; safe for several threads."""

    def __init__(self, scenario: Scenario, world: World, router: Compared) -> None:
        from engine.planners.single import Floor

        self.xy_m = world.graph.xy_m.astype(np.float64)
        self.seed = scenario.seed
        self.methods = router.beside(Floor(world.graph, costs_of(scenario, world)))
        self.found: dict[Query, dict[str, tuple[float, float]] | None] = {}
        self._lock = threading.Lock()

    @classmethod
    def of(cls, scenario: Scenario, world: World) -> WaysBeside | None:
        """None where the planner is no router that others stand beside."""
        name = scenario.planner.name
        if name not in PLANNERS or not hasattr(find(PLANNERS, "planner", name), "beside"):
            return None
        return cls(scenario, world, planner_of(name, scenario).router)

    @staticmethod
    def queries(log: Log, until: float = np.inf) -> list[Query]:
        """The first distinct ways that were planned until a tick: (from, to) places, at most MOST, in order."""
        orders, plans = log.table("orders"), log.table("plans")
        opened = orders["state"] == OrderState.OPEN
        numbers = (orders[name][opened].tolist() for name in ("order", "from_place", "to_place"))
        ends = {order: (a, b) for order, a, b in zip(*numbers, strict=True)}
        values, offsets = plans["places"]
        found: dict[Query, None] = {}
        for row, (task, order) in enumerate(zip(plans["task"].tolist(), plans["order"].tolist(), strict=True)):
            if plans["tick"][row] > until or len(found) >= MOST:
                break
            places = values[int(offsets[row]) : int(offsets[row + 1])].tolist()
            pick, drop = ends.get(order, (-1, -1))
            between = {Task.TO_PICK: [pick, drop], Task.TO_DROP: [drop]}.get(task, [])
            stops = [place for place in (*places[:1], *between, *places[-1:]) if place >= 0]
            found |= dict.fromkeys((a, b) for a, b in pairwise(stops) if a != b)
        return list(found)[:MOST]

    def told(self, queries: list[Query], within_s: float = np.inf) -> dict[str, Any]:
        """Lengths and CPU times by method over these ways; no more are searched once so much CPU time is spent.

        ways: how many · missing: still to be searched · methods: name → length_m (mean), above (share above the last
        one, which is exact; None without ways), cpu_ms (median).
        """
        with self._lock:
            begun = time.thread_time()
            for query in queries:
                if query not in self.found:
                    self.found[query] = self._asked(query)
                if time.thread_time() - begun > within_s:
                    break
            missing = sum(query not in self.found for query in queries)
            rows = [row for query in queries if (row := self.found.get(query))]
        told: dict[str, dict[str, float | None]] = {}
        lengths = {name: np.array([row[name][0] for row in rows]) for name in self.methods}
        exact = list(lengths.values())[-1]
        for name, length in lengths.items():
            told[name] = {
                "length_m": float(length.mean()) if rows else None,
                "above": float(length.sum() / exact.sum() - 1) if rows else None,
                "cpu_ms": float(np.median([row[name][1] for row in rows])) if rows else None,
            }
        return {"ways": len(rows), "missing": missing, "methods": told}

    def _asked(self, query: Query) -> dict[str, tuple[float, float]] | None:
        """Metres and CPU ms by method, or None when one of them finds no way."""
        seed = self.seed + len(self.found)
        if not self.found:
            for search in self.methods.values():
                search(*query, seed)  # loads its kernels, so that no time holds that
        answers = {name: self._timed(search, query, seed) for name, search in self.methods.items()}
        return answers if all(length > 0 for length, _ in answers.values()) else None

    def _timed(self, search: Callable[[int, int, int], Any], query: Query, seed: int) -> tuple[float, float]:
        begun = time.thread_time_ns()
        places = search(*query, seed)
        took_ms = (time.thread_time_ns() - begun) / 1e6
        return float(np.linalg.norm(np.diff(self.xy_m[places], axis=0), axis=1).sum()), took_ms
