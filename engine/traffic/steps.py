"""Plans under execution: committing their claims, dropping them, and re-timing them when somebody is late.

A vehicle always holds the claim of the place it is in, open-ended unless a step leaves it. The dependency graph is the
order of claims at each place; `retime` moves planned times later along it and never changes the order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.compiled import lean
from engine.traffic.claims import Claims, claim, discard, link, unlink
from engine.traffic.departures import GraphArrays
from engine.types import FOREVER, NONE

I32 = NDArray[np.int32]


FAR = FOREVER // 2
"""Planned times from here on mean: behind somebody who does not leave for now."""


class Steps(NamedTuple):
    """Plans under execution, (V, S): edge of the motion graph or -1 for a stay, ticks, claims of the places entered."""

    edge: I32
    what: NDArray[np.int8]  # Activity of a stay
    start: I32
    end: I32
    claim: I32
    sweep0: I32
    sweep1: I32


def new_steps(n: int, slots: int) -> Steps:
    """Empty plans with room for so many steps per vehicle."""

    def i32() -> I32:
        return np.full((n, slots), NONE, np.int32)

    return Steps(i32(), np.zeros((n, slots), np.int8), i32(), i32(), i32(), i32(), i32())


@lean
def lift(c: Claims, p: Steps, v: int, here: int, step: int, steps: int) -> int:
    """Take a vehicle's claims from its present place on out of the table, to plan as if it were gone.

    Returns the claim before its present one: the free interval in which it stands.
    """
    gap = c.prev[here]
    unlink(c, here)
    for k in range(step, steps):
        if p.claim[v, k] >= 0:
            unlink(c, p.claim[v, k])
        if p.sweep0[v, k] >= 0:
            unlink(c, p.sweep0[v, k])
        if p.sweep1[v, k] >= 0:
            unlink(c, p.sweep1[v, k])
    return gap


@lean
def held(c: Claims, p: Steps, v: int, here: int, n: int, out: I32) -> int:
    """Places, starts and ends of a vehicle's claims from its present place through n steps, into the rows of `out`
    (3, n + 1); returns their number."""
    out[0, 0], out[1, 0], out[2, 0] = c.place[here], c.start[here], c.end[here]
    i = 1
    for k in range(n):
        slot = p.claim[v, k]
        if slot >= 0:
            out[0, i], out[1, i], out[2, i] = c.place[slot], c.start[slot], c.end[slot]
            i += 1
    return i


@lean
def put_back(c: Claims, p: Steps, v: int, here: int, step: int, steps: int) -> None:
    """Undo `lift`."""
    link(c, here)
    for k in range(step, steps):
        if p.claim[v, k] >= 0:
            link(c, p.claim[v, k])
        if p.sweep0[v, k] >= 0:
            link(c, p.sweep0[v, k])
        if p.sweep1[v, k] >= 0:
            link(c, p.sweep1[v, k])


@lean
def forget(c: Claims, p: Steps, v: int, step: int, steps: int, linked: bool) -> None:
    """Give back the claims of steps not yet started."""
    for k in range(step, steps):
        for slot in (p.claim[v, k], p.sweep0[v, k], p.sweep1[v, k]):
            if slot >= 0:
                if linked:
                    unlink(c, slot)
                discard(c, slot)
        p.claim[v, k], p.sweep0[v, k], p.sweep1[v, k] = NONE, NONE, NONE


@lean
def commit(
    c: Claims, p: Steps, g: GraphArrays, hold: bool, margin: int, v: int, here: int, edges: I32,
    what: NDArray[np.int8], starts: I32, ends: I32, n: int,
) -> None:  # fmt: skip
    """Enter a plan of n steps (edge ≥ 0, or a stay) as steps 0…n-1 of vehicle v and link its claims.

    `here` is the unlinked claim of the place where the plan begins; it is linked again with its true end.
    """
    at = here
    c.end[here] = FOREVER
    for k in range(n):
        p.edge[v, k], p.what[v, k], p.start[v, k], p.end[v, k] = edges[k], what[k], starts[k], ends[k]
        p.claim[v, k], p.sweep0[v, k], p.sweep1[v, k] = NONE, NONE, NONE
        if edges[k] < 0:
            p.edge[v, k] = NONE
            continue
        e = edges[k]
        place = g.state_place[g.edge_to[e]]
        if place == c.place[at]:
            continue
        if hold:
            c.end[at] = ends[k] + margin
        else:
            c.end[at] = starts[k] + 1
        if at == here:
            link(c, here)
        at = claim(c, place, starts[k] if hold else ends[k], FOREVER, v)
        p.claim[v, k] = at
        if hold:
            for q in range(g.sweep_ptr[e], g.sweep_ptr[e + 1]):
                slot = claim(c, g.sweep[q], starts[k], ends[k] + margin, v)
                if q == g.sweep_ptr[e]:
                    p.sweep0[v, k] = slot
                else:
                    p.sweep1[v, k] = slot
    if at == here:
        link(c, here)


@njit(cache=True, nogil=True)
def retime(
    c: Claims, p: Steps, g: GraphArrays, hold: bool, margin: int, step: I32, steps: I32, here: I32, ready: I32
) -> int:
    """Move the planned times of all steps not yet started to the earliest that the order of claims allows.

    ready: (V,) first tick at which a vehicle can start its next step. Steps are visited in the order of their old
    start, which is an order of the dependency graph. Steps behind somebody who never leaves (it broke down) go to FAR
    and come back when that has changed. Returns how many steps are there.
    """
    n_steps = 0
    for v in range(len(step)):
        n_steps += max(steps[v] - step[v], 0)
    when = np.empty(n_steps, np.int64)
    who = np.empty(n_steps, np.int32)
    which = np.empty(n_steps, np.int32)
    i = 0
    for v in range(len(step)):
        for k in range(step[v], steps[v]):
            when[i], who[i], which[i] = p.start[v, k], v, k
            i += 1
    order = np.argsort(when, kind="mergesort")
    far = 0
    again = True
    while again:
        again = False
        far = 0
        at_tick = ready.copy()
        at_claim = here.copy()
        for j in order:
            v, k = who[j], which[j]
            begin = at_tick[v] if p.start[v, k] >= FAR else max(p.start[v, k], at_tick[v])
            for slot in (p.claim[v, k], p.sweep0[v, k], p.sweep1[v, k]):
                # the margin keeps others away, not the vehicle itself
                if slot >= 0 and c.owner[c.prev[slot]] >= 0 and c.owner[c.prev[slot]] != v:
                    gone = c.end[c.prev[slot]]
                    if gone >= FOREVER:
                        gone = FAR + 1
                    begin = max(begin, gone if hold else gone - 1)
            far += begin >= FAR
            span = p.end[v, k] - p.start[v, k]
            if begin != p.start[v, k]:
                if not hold:
                    again = True
                p.start[v, k], p.end[v, k] = begin, begin + span
            at_tick[v] = begin + span
            if p.claim[v, k] >= 0:
                c.end[at_claim[v]] = begin + span + margin if hold else begin + 1
                at_claim[v] = p.claim[v, k]
                c.start[at_claim[v]] = begin if hold else begin + span
            for slot in (p.sweep0[v, k], p.sweep1[v, k]):
                if slot >= 0:
                    c.start[slot], c.end[slot] = begin, begin + span + margin
    return far


def wider(p: Steps, slots: int) -> Steps:
    """The same plans with room for at least so many steps."""
    n, old = p.edge.shape
    out = new_steps(n, max(2 * old, slots))
    for name in Steps._fields:
        getattr(out, name)[:, :old] = getattr(p, name)
    return out
