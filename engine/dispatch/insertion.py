"""Insertion with local search: sequences for many vehicles and orders, in the time that a decision may take.

Source: cheapest insertion (Solomon 1987) into sequences that keep within a time, and ruin and recreate (Schrimpf et
al. 2000) around the vehicle that is done last. Promise: legal; not optimal, the gap to a lower bound is told. Cost: an
insertion looks at every place of every sequence; 100 vehicles × 1,000 orders take about a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.dispatch import kernels
from engine.dispatch.ahead import give_first
from engine.dispatch.base import Assignment, ChargingPolicy, FloorView, Refusal
from engine.dispatch.schedule import Schedule, Work, schedule_of

SLACK = 1.02
"""Sequences are first filled to so much of the lower bound, then each order goes to who is done soonest with it."""
TAKEN_OUT = 6
"""Orders that a round takes out of one sequence at most."""


def insertion(work: Work, rounds: int, start: Schedule | None = None) -> Schedule:
    """A schedule by insertion, improved for so many rounds; `start` is improved instead when given.

    An order that no vehicle may take is in no sequence.
    """
    n, vehicles = len(work.carry), len(work.first)
    bound = work.lower_bound()
    if not n or not vehicles:
        return schedule_of(work, [()] * vehicles, bound)
    first, link, end = (np.ascontiguousarray(a, np.int64) for a in (work.first, work.link, work.end))
    after = np.full(n + vehicles, -1, np.int32)
    owner = np.full(n, -1, np.int32)
    time = np.zeros(vehicles, np.int64)
    if start is not None:
        for r, route in enumerate(start.routes):
            chain = (n + r, *route)
            after[list(chain[:-1])] = chain[1:]
            owner[list(route)] = r
            time[r] = work.takes(r, route)
    # the longest first, so that short ones fill what is left
    alone = np.where(work.may, first, kernels.BARRED).min(axis=0) + end
    for i in np.argsort(-alone, kind="stable").tolist() if start is None else ():
        kernels.insert(link, end, first, after, owner, time, i, int(bound * SLACK))
    kept = np.empty(2 * n + vehicles, np.int32)
    done = kernels.improve(link, end, first, after, owner, time, kept, bound, rounds, TAKEN_OUT)
    routes: list[list[int]] = [[] for _ in range(vehicles)]
    for r in range(vehicles):
        at = int(after[n + r])
        while at >= 0:
            routes[r].append(at)
            at = int(after[at])
    return schedule_of(work, routes, bound, int(done))


@dataclass(frozen=True)
class Insertion:
    """look: oldest open orders considered · rounds: of local search at each decision."""

    charging: ChargingPolicy
    look: int = 200
    rounds: int = 300

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher."""
        return give_first(view, free, self.charging, self.look, lambda work: insertion(work, self.rounds))
