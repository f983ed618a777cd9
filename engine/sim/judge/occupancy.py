"""Do vehicles keep apart? Both occupancy rules, with swaps and crossing diagonals; whoever stands, occupies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.motion import corners_of, name
from engine.sim.judge.record import I64, Mask, Record
from engine.types import FOREVER, Occupancy
from engine.world.floor import World


@dataclass(frozen=True, slots=True)
class Held:
    """Places held during [begin, end) by vehicles; `corner` where a diagonal passes over it."""

    place: I64
    begin: I64
    end: I64
    vehicle: I64
    corner: Mask


def occupancy(r: Record, edge: I64, world: World) -> Iterator[Breach]:
    """Every clash of two vehicles under the world's rule.

    hold: a place is held from the start of the motion into it to the end of the motion out of it, and `margin_ticks`
    longer; corners during the diagonal. mapf: a place belongs to who stands in it or drives into it, so that following
    at the same tick is allowed; swaps and crossing diagonals are not.
    """
    hold = world.occupancy == Occupancy.HOLD
    swapped = list(_swaps(r))
    for i, j in swapped[:REPORTED]:
        a, b, t = int(r.vehicle[i]), int(r.vehicle[j]), int(max(r.t0[i], r.t0[j]))
        where = f"{name(world, r.a[i])} and {name(world, r.b[i])}"
        text = f"vehicles {min(a, b)} and {max(a, b)} drive through each other between {where} at tick {t}"
        yield Breach(BreachKind.SWAP, t, (min(a, b), max(a, b)), int(r.b[i]), text)
    stays = _stays(r, world.margin_ticks if hold else 0, hold)
    corners = _corners(r, edge, world)
    explained = {(min(v, w), max(v, w), p) for v, w, p in _places_of(r, swapped)} if hold else set()
    found = 0
    for i, j in _clashes(stays):
        v, w = sorted((int(stays.vehicle[i]), int(stays.vehicle[j])))
        place, t = int(stays.place[i]), int(max(stays.begin[i], stays.begin[j]))
        if (v, w, place) in explained:
            continue
        found += 1
        if found > REPORTED:
            break
        text = f"vehicles {v} and {w} are both at {name(world, place)} at tick {t}"
        if hold and world.margin_ticks and t >= stays.end[i] - world.margin_ticks:
            before, after = int(stays.vehicle[i]), int(stays.vehicle[j])
            text = f"vehicle {after} enters {name(world, place)} at tick {t}, too soon after vehicle {before}"
        yield Breach(BreachKind.VERTEX, t, (v, w), place, text)
    yield from _crossings(r, edge, world, stays if hold else None, corners)


def _stays(r: Record, margin: int, hold: bool) -> Held:
    """What every vehicle holds, place after place."""
    opens = r.moves & (r.a != r.b) & r.legal
    # the first interval stands for where a vehicle begins; when it already drives, both of its places count
    start = ~r.follows & r.legal
    entry = np.nonzero(opens)[0]
    first = np.nonzero(start)[0]
    row = np.concatenate([first, entry])
    is_entry = np.concatenate([np.zeros(len(first), np.bool_), np.ones(len(entry), np.bool_)])
    order = np.lexsort((is_entry, row))
    row, is_entry = row[order], is_entry[order]
    place = np.where(is_entry, r.b[row], r.a[row])
    # under mapf a place belongs to a vehicle from the tick after it sets out for it: where it begins, one tick earlier
    begin = r.t0[row] - (0 if hold else ~is_entry)
    end = np.full(len(row), FOREVER, np.int64)
    same = r.vehicle[row][1:] == r.vehicle[row][:-1]
    leave = row[1:]
    out = np.where(r.still[leave], FOREVER, r.t1[leave] + margin) if hold else r.t0[leave]
    end[:-1] = np.where(same, out, FOREVER)
    return Held(place, begin, end, r.vehicle[row], np.zeros(len(row), np.bool_))


def _corners(r: Record, edge: I64, world: World) -> Held:
    """Corners of every diagonal under way."""
    owner, place = corners_of(edge, world.graph)
    return Held(place, r.t0[owner], r.t1[owner], r.vehicle[owner], np.ones(len(owner), np.bool_))


def _clashes(h: Held) -> Iterator[tuple[int, int]]:
    """Pairs of rows of different vehicles that hold one place at the same time, earlier first."""
    order = np.lexsort((h.begin, h.place))
    place, begin, end, vehicle = h.place[order], h.begin[order], h.end[order], h.vehicle[order]
    alive = np.arange(len(order))
    for apart in range(1, len(order)):
        alive = alive[alive + apart < len(order)]
        later = alive + apart
        alive = alive[(place[later] == place[alive]) & (begin[later] < end[alive])]
        if len(alive) == 0:
            return
        later = alive + apart
        other = vehicle[later] != vehicle[alive]
        for i, j in zip(alive[other].tolist(), later[other].tolist(), strict=True):
            yield int(order[i]), int(order[j])


def _swaps(r: Record) -> Iterator[tuple[int, int]]:
    """Pairs of motions that pass each other on one edge."""
    rows = np.nonzero(r.moves & r.legal & (r.a != r.b))[0]
    low, high = np.minimum(r.a[rows], r.b[rows]), np.maximum(r.a[rows], r.b[rows])
    pair = low * (int(high.max(initial=0)) + 1) + high
    end = np.where(r.still[rows], FOREVER, r.t1[rows])
    held = Held(pair, r.t0[rows], end, r.vehicle[rows], np.zeros(len(rows), np.bool_))
    for i, j in _clashes(held):
        if r.a[rows[i]] == r.b[rows[j]]:
            yield int(rows[i]), int(rows[j])


def _places_of(r: Record, swapped: list[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    for i, j in swapped:
        yield int(r.vehicle[i]), int(r.vehicle[j]), int(r.a[i])
        yield int(r.vehicle[i]), int(r.vehicle[j]), int(r.b[i])


def _crossings(r: Record, edge: I64, world: World, stays: Held | None, corners: Held) -> Iterator[Breach]:
    """Under hold, corners are held like places; under mapf, two diagonals must not cross."""
    if len(corners.place) == 0:
        return
    seen: set[tuple[int, int, int]] = set()

    def breach(v: int, w: int, t: int, place: int) -> Breach | None:
        v, w = min(v, w), max(v, w)
        if (v, w, t) in seen or len(seen) >= REPORTED:
            return None
        seen.add((v, w, t))
        text = f"vehicles {v} and {w} cut each other's corner at {name(world, place)} at tick {t}"
        return Breach(BreachKind.CROSSING, t, (v, w), place, text)

    if stays is not None:
        both = Held(*(np.concatenate([getattr(stays, f), getattr(corners, f)]) for f in Held.__slots__))
        for i, j in _clashes(both):
            if both.corner[i] or both.corner[j]:
                t = int(max(both.begin[i], both.begin[j]))
                if found := breach(int(both.vehicle[i]), int(both.vehicle[j]), t, int(both.place[i])):
                    yield found
        return
    graph = world.graph
    first = graph.sweep_ptr[:-1].astype(np.int64)
    two = np.diff(graph.sweep_ptr) == 2
    rows = np.nonzero((edge >= 0) & two[np.maximum(edge, 0)])[0]
    c, d = graph.sweep[first[edge[rows]]].astype(np.int64), graph.sweep[first[edge[rows]] + 1].astype(np.int64)
    a, b = r.a[rows], r.b[rows]
    low = np.minimum(np.minimum(a, b), np.minimum(c, d))
    high = np.maximum(np.maximum(a, b), np.maximum(c, d))
    block = Held(low * graph.n_places + high, r.t0[rows], r.t1[rows], r.vehicle[rows], np.ones(len(rows), np.bool_))
    for i, j in _clashes(block):
        if {int(a[i]), int(b[i])} == {int(c[j]), int(d[j])}:
            t = int(max(r.t0[rows[i]], r.t0[rows[j]]))
            if found := breach(int(r.vehicle[rows[i]]), int(r.vehicle[rows[j]]), t, int(b[i])):
                yield found
