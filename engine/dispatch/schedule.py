"""Sequences of orders for several vehicles: what is to be done, what a sequence takes, and how good it can be.

Source: Wang et al. 2019, eqs. 1-7 in their correct form: a vehicle goes to an order, takes the load, brings it to one
of the exits, and goes on from there; the last one to finish decides (makespan). Which exit is best between two orders
depends on nothing else, so a sequence of orders says it all. Times are whole numbers of any unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

I64 = NDArray[np.int64]

BARRED = 2**40
"""A time that stands for `may not`."""
ALLOWED = BARRED // 2
"""Every time that may be taken lies below."""

Routes = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Work:
    """R vehicles, N orders, E exits; BARRED where something may not be.

    first: (R, N) until vehicle r stands at order i with nothing done before, what it is doing now included; a vehicle
    that may not take an order at all is barred here · carry: (N, E) taking the load, the way to exit e, handing it over
    · back: (E, N) from exit e to order i.
    """

    first: I64
    carry: I64
    back: I64

    @cached_property
    def may(self) -> NDArray[np.bool_]:
        """(R, N) whether vehicle r may take order i."""
        return self.first < ALLOWED

    @cached_property
    def link(self) -> I64:
        """(N, N) from standing at order i to standing at order j, by the best exit; BARRED on the diagonal."""
        link = np.full((len(self.carry), self.back.shape[1]), 2 * BARRED, np.int64)
        for e in range(len(self.back)):
            np.minimum(link, self.carry[:, e : e + 1] + self.back[e], out=link)
        np.fill_diagonal(link, BARRED)
        return np.minimum(link, BARRED)

    @cached_property
    def end(self) -> I64:
        """(N,) from standing at order i to having brought it to the quickest exit."""
        end: I64 = self.carry.min(axis=1)
        return end

    def takes(self, vehicle: int, route: Sequence[int]) -> int:
        """Time at which a vehicle has done a sequence; 0 for none."""
        if not route:
            return 0
        ways = sum(int(self.link[i, j]) for i, j in pairwise(route))
        return int(self.first[vehicle, route[0]]) + ways + int(self.end[route[-1]])

    def exits(self, route: Sequence[int]) -> tuple[int, ...]:
        """The exit of every order of a sequence: the lowest of the best."""
        if not route:
            return ()
        between = [int((self.carry[i] + self.back[:, j]).argmin()) for i, j in pairwise(route)]
        return (*between, int(self.carry[route[-1]].argmin()))

    def lower_bound(self) -> int:
        """No schedule is done sooner.

        The larger of two: the farthest order, and the least total over all vehicles of an assignment that gives every
        order one before and one after it (circles allowed), shared evenly.
        """
        n, vehicles = len(self.carry), len(self.first)
        if not n:
            return 0
        arrive = np.where(self.may, self.first, BARRED).min(axis=0)
        later = (arrive[:, None] + self.carry).min(axis=0)[:, None] + self.back
        farthest = int((np.minimum(arrive, later.min(axis=0)) + self.end).max())
        return max(farthest, -(-self.least_total() // vehicles))

    def least_total(self) -> int:
        """Least sum of all vehicles' times when sequences may close to circles: the assignment relaxation."""
        from scipy.optimize import linear_sum_assignment

        n, vehicles = len(self.carry), len(self.first)
        cost = np.full((n + vehicles, n + vehicles), 0, np.int64)  # what goes before × what comes after
        cost[:n, :n] = self.link
        cost[:n, n:] = self.end[:, None]
        cost[n:, :n] = np.minimum(self.first, BARRED)
        rows, columns = linear_sum_assignment(cost)
        return int(cost[rows, columns].sum())


@dataclass(frozen=True)
class Schedule:
    """Who does what in which order, and how good that is.

    routes, exits: per vehicle · ends: (R,) when each is done, 0 without orders · bound: no schedule is done sooner ·
    nodes: of the search that found it.
    """

    routes: Routes
    exits: Routes
    ends: tuple[int, ...]
    bound: int
    nodes: int = 0

    @property
    def makespan(self) -> int:
        return max(self.ends, default=0)

    @property
    def total(self) -> int:
        return sum(self.ends)

    @property
    def gap(self) -> float:
        """Largest share by which the makespan may exceed the best possible one."""
        return (self.makespan - self.bound) / self.makespan if self.makespan else 0.0


def schedule_of(work: Work, routes: Sequence[Sequence[int]], bound: int | None = None, nodes: int = 0) -> Schedule:
    """The schedule of these sequences; without a bound, with the work's own."""
    each = tuple(tuple(int(i) for i in route) for route in routes)
    ends = tuple(work.takes(r, route) for r, route in enumerate(each))
    least = work.lower_bound() if bound is None else bound
    return Schedule(each, tuple(work.exits(route) for route in each), ends, min(least, max(ends, default=0)), nodes)


def by_rule(work: Work) -> Schedule:
    """The paper's rule: whoever is free first takes the order that it reaches soonest, and brings it to the exit
    nearest to that. Not optimal in general. Ties: the lower number.
    """
    n, vehicles = len(work.carry), len(work.first)
    left = list(range(n))
    routes: list[list[int]] = [[] for _ in range(vehicles)]
    exits: list[list[int]] = [[] for _ in range(vehicles)]
    clock = [0] * vehicles
    while left:
        able = [r for r in range(vehicles) if work.may[r, left].any()]
        if not able:
            break
        r = min(able, key=lambda r: (clock[r], r))
        reach = {
            i: int(work.back[exits[r][-1], i]) if exits[r] else int(work.first[r, i]) for i in left if work.may[r, i]
        }
        i = min(reach, key=lambda i: (reach[i], i))
        exit_ = int(work.carry[i].argmin())
        clock[r] += reach[i] + int(work.carry[i, exit_])
        routes[r].append(i)
        exits[r].append(exit_)
        left.remove(i)
    return Schedule(
        tuple(map(tuple, routes)), tuple(map(tuple, exits)), tuple(clock), min(work.lower_bound(), max(clock,
    default=0)) )  # fmt: skip
