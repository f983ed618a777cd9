"""When a motion may start: the occupancy rules, as searches and the route timer read them.

`hold`: a vehicle holds the place it leaves, the place it enters and the corners it sweeps for the whole motion, and for
`margin` ticks more. `mapf`: unit motions; following into a just-vacated place is allowed, swapping and crossing is not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean, lean_inline
from engine.traffic.claims import Claims, free_from, gap_end
from engine.types import FOREVER
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]

DETOUR = "solved after a detour"
"""What a plan says when the route timer had to leave the router's route."""

STAY = -2
"""Edge code of a stay at a goal."""

HORIZON = 1 << 22
"""Ticks ahead beyond which nothing is planned; keeps packed costs within 63 bits."""


class GraphArrays(NamedTuple):
    """The arrays of a MotionGraph that the step and traffic read."""

    state_place: NDArray[np.int32]
    state_heading: NDArray[np.int8]
    edge_from: NDArray[np.int32]
    edge_to: NDArray[np.int32]
    edge_kind: NDArray[np.int8]
    edge_twin: NDArray[np.int32]
    sweep_ptr: NDArray[np.int32]
    sweep: NDArray[np.int32]
    kind_ticks: NDArray[np.int32]
    kind_mm: NDArray[np.int32]


def graph_arrays(graph: MotionGraph) -> GraphArrays:
    """Those arrays of a graph."""
    return GraphArrays(*(getattr(graph, name) for name in GraphArrays._fields))


class Ground(NamedTuple):
    """What a search reads of the floor: CSR arrays of MotionGraph, and the blocked places of the overlay."""

    state_place: I32
    edge_ptr: I32
    edge_to: I32
    edge_kind: NDArray[np.int8]
    edge_twin: I32
    sweep_ptr: I32
    sweep: I32
    place_ptr: I32
    kind_ticks: I32
    blocked: NDArray[np.uint8]


def ground_of(graph: MotionGraph, blocked: NDArray[np.uint8]) -> Ground:
    """Those arrays of a graph, with the blocked places of the overlay."""
    g = graph
    return Ground(
        g.state_place, g.edge_ptr, g.edge_to, g.edge_kind, g.edge_twin, g.sweep_ptr, g.sweep, g.place_ptr,
        g.kind_ticks, blocked,
    )  # fmt: skip


@lean
def crosses(c: Claims, a: int, b: int, tick: int) -> bool:
    """True when one vehicle goes from place a to place b during [tick, tick+1) under the classical rule."""
    at = c.next[a]
    while at >= 0:
        if c.end[at] == tick + 1:
            other = c.next[b]
            while other >= 0:
                if c.start[other] == tick + 1 and c.owner[other] == c.owner[at]:
                    return True
                other = c.next[other]
        at = c.next[at]
    return False


@lean_inline
def departure(
    c: Claims, g: Ground, hold: bool, margin: int, e: int, u: int, v: int, gap: int, t: int, until: int
) -> int:
    """Earliest tick ≥ t at which a motion from u may start into the free interval of v behind claim `gap`, or FOREVER.

    `until`: end of the vehicle's own free interval at u.
    """
    if not hold:
        return classical_departure(c, g, e, u, v, gap, t, until)
    # the last tick at which it may begin: then both free intervals end
    latest = min(until, gap_end(c, gap)) - g.kind_ticks[g.edge_kind[e]] - margin
    begin = max(t, c.end[gap])
    if begin > latest:
        return FOREVER
    if g.sweep_ptr[e] == g.sweep_ptr[e + 1]:
        return begin
    corners = g.sweep[g.sweep_ptr[e] : g.sweep_ptr[e + 1]]
    span = g.kind_ticks[g.edge_kind[e]] + margin
    return swept_departure(c.start, c.end, c.next, g.blocked, corners, span, begin, latest)


@lean
def swept_departure(
    start: I32, end: I32, after: I32, blocked: NDArray[np.uint8], corners: I32, span: int, begin: int, latest: int
) -> int:
    """Earliest tick from `begin` to `latest` from which all corners are free for `span` ticks, or FOREVER."""
    while begin <= latest:
        later = begin
        for corner in corners:
            if blocked[corner]:
                return FOREVER
            later = free_from(start, end, after, corner, later, span)
        if later == begin:
            return begin
        begin = later
    return FOREVER


@lean
def classical_departure(c: Claims, g: Ground, e: int, u: int, v: int, gap: int, t: int, until: int) -> int:
    """The same under the classical rule, where every motion takes one tick."""
    close = gap_end(c, gap)
    for q in range(g.sweep_ptr[e], g.sweep_ptr[e + 1]):
        if g.blocked[g.sweep[q]]:
            return FOREVER
    begin = max(t, c.end[gap] - 1)
    while True:
        if begin + 1 > until or begin + 2 > close:
            return FOREVER
        clash = crosses(c, v, u, begin)
        if not clash and g.sweep_ptr[e + 1] - g.sweep_ptr[e] == 2:
            a, b = g.sweep[g.sweep_ptr[e]], g.sweep[g.sweep_ptr[e] + 1]
            clash = crosses(c, a, b, begin) or crosses(c, b, a, begin)
        if not clash:
            return begin
        begin += 1
