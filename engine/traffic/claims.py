"""Reservations by interval: who may be in which place, when, and in which order.

Each place holds a linked list of claims [start, end) sorted by time. A plan's claims are at once its reservations and
the nodes of the dependency graph: a vehicle may enter a place when every claim before its own has gone. Times shift
when vehicles are late, the order never does, so lateness can't cause a collision and the graph stays acyclic.

The first P claims are sentinels, one before the first interval of each place. Arrays in, arrays out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.types import FOREVER

I32 = NDArray[np.int32]


class Claims(NamedTuple):
    """start, end, owner, place, next, prev: (capacity,); free: stack of unused slots; meta: [their number]."""

    start: I32
    end: I32
    owner: I32
    place: I32
    next: I32
    prev: I32
    free: I32
    meta: NDArray[np.int64]


def new_claims(n_places: int, capacity: int) -> Claims:
    """Empty claims for n_places, with room for `capacity` claims beside the sentinels."""
    size = n_places + capacity
    i32 = np.int32
    start = np.zeros(size, i32)
    end = np.zeros(size, i32)
    place = np.full(size, -1, i32)
    place[:n_places] = np.arange(n_places)
    free = np.arange(size - 1, n_places - 1, -1, dtype=i32)
    none = np.full(size, -1, i32)
    return Claims(start, end, none.copy(), place, none.copy(), none.copy(), free, np.array([capacity], np.int64))


def grown(claims: Claims, n_places: int) -> Claims:
    """The same claims with twice the room."""
    old = len(claims.start)
    extra = old - n_places

    def wider(array: I32, fill: int) -> I32:
        return np.concatenate([array, np.full(extra, fill, np.int32)])

    n_free = int(claims.meta[0])
    free = np.zeros(2 * extra, np.int32)
    free[:extra] = np.arange(old + extra - 1, old - 1, -1)
    free[extra : extra + n_free] = claims.free[:n_free]
    return Claims(
        wider(claims.start, 0),
        wider(claims.end, 0),
        wider(claims.owner, -1),
        wider(claims.place, -1),
        wider(claims.next, -1),
        wider(claims.prev, -1),
        free,
        np.array([n_free + extra], np.int64),
    )


@lean
def link(c: Claims, slot: int) -> None:
    """Put an unlinked claim into its place's list, behind every claim that starts no later."""
    at = c.place[slot]
    after = c.next[at]
    while after >= 0 and c.start[after] <= c.start[slot]:
        at = after
        after = c.next[at]
    c.next[slot] = after
    c.prev[slot] = at
    c.next[at] = slot
    if after >= 0:
        c.prev[after] = slot


@lean
def unlink(c: Claims, slot: int) -> None:
    """Take a claim out of its list; its fields stay, so that it can be linked again."""
    before, after = c.prev[slot], c.next[slot]
    c.next[before] = after
    if after >= 0:
        c.prev[after] = before
    c.next[slot] = -1
    c.prev[slot] = -1


@lean
def claim(c: Claims, place: int, start: int, end: int, owner: int) -> int:
    """A new linked claim; its slot, or -1 when there is no room."""
    if c.meta[0] == 0:
        return -1
    c.meta[0] -= 1
    slot = c.free[c.meta[0]]
    c.place[slot] = place
    c.start[slot] = start
    c.end[slot] = end
    c.owner[slot] = owner
    link(c, slot)
    return slot


@lean
def discard(c: Claims, slot: int) -> None:
    """Give an unlinked claim's slot back."""
    c.owner[slot] = -1
    c.place[slot] = -1
    c.free[c.meta[0]] = slot
    c.meta[0] += 1


@lean
def release(c: Claims, slot: int) -> None:
    """Unlink a claim and give its slot back."""
    unlink(c, slot)
    discard(c, slot)


@lean
def gap_at(c: Claims, place: int, tick: int) -> int:
    """The claim after which the place is free at a tick, or -1 when it is taken then."""
    at = place
    after = c.next[at]
    while after >= 0 and c.end[after] <= tick:
        at = after
        after = c.next[at]
    if after >= 0 and c.start[after] <= tick:
        return -1
    return at


@lean
def gap_end(c: Claims, slot: int) -> int:
    """When the free interval after a claim ends: FOREVER behind the last."""
    after = c.next[slot]
    return c.start[after] if after >= 0 else FOREVER


@lean
def free_from(start: I32, end: I32, after: I32, place: int, tick: int, span: int) -> int:
    """The first tick ≥ `tick` from which a place is free for `span` ticks, or FOREVER. start, end, after: of claims."""
    at = place
    while True:
        begin = max(tick, end[at])
        at = after[at]
        if at < 0 or begin + span <= start[at]:
            return begin
