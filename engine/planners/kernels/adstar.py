"""AD* over a state lattice: backward search in (S, 4) rows of integers, a lazy heap, costs from a table.

State s = (y · W + x) · 16 + heading; trajectory k of s costs cost[s, k] and leads to the state that the cluster says. A
row of `node` holds g, rhs, the key with which the state stands in OPEN (or -1), and a word: the best trajectory (127
for none), bit 7 for INCONS, and from bit 8 on the pass in which the state was last closed. An entry of the heap
counts only while its key is the one of the row. Keys are one integer: k1 · 2³¹ + k2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

INF = 2**30
G, RHS, KEY, WORD = range(4)
NO_K, IN_INCONS, PASS = 127, 128, 8
HEADINGS, SHIFT = 16, 4
# Fields of `now`: heap size, INCONS size, pass, inflation ε in thousandths, keys' lead k_m, expansions of this call and
# of all, start state, goal cell, goal heading (-1 for any), heuristic, whole searches begun, cell of the start.
SIZE, HELD, TURN, EPS, LEAD, CALL, ALL, START, GOAL, FACING, FORM, BEGUN, START_X, START_Y = range(14)
FIELDS = 14
# Heuristics: A·distance in space · that and B·climb · max(0, A·distance in the plane + B·rise) · as printed in (17)
SPACE, CLIMB, SLOPE, PRINTED = range(4)
DONE, MORE, FULL = range(3)


class Lattice(NamedTuple):
    """Where trajectories lead, and on what ground."""

    end: I32  # (16, K, 3) dx, dy, heading
    from_heading: I32  # (16, I)
    from_k: I32
    height: F32  # (H, W)
    cost: I32  # (S, K)
    weight: F64  # (3,) of the heuristic: A, B, side of a cell


class Open(NamedTuple):
    """The queue, INCONS and the rows."""

    node: I64  # (S, 4)
    keys: I64
    items: I32
    incons: I32
    now: I64  # (FIELDS,)


@lean
def between(lat: Lattice, form: int, xa: int, ya: int, xb: int, yb: int) -> int:
    """Least cost from cell a to cell b: what the heuristic says, a whole number."""
    dx, dy = (xb - xa) * lat.weight[2], (yb - ya) * lat.weight[2]
    rise = float(lat.height[yb, xb]) - float(lat.height[ya, xa])
    flat2 = dx * dx + dy * dy
    if form == SLOPE:
        return np.int64(max(0.0, lat.weight[0] * math.sqrt(flat2) + lat.weight[1] * rise))
    far = lat.weight[0] * math.sqrt(flat2 + rise * rise)
    if form == CLIMB:
        far += lat.weight[1] * max(rise, 0.0)
    elif form == PRINTED:
        far += lat.weight[1] * -rise
    return np.int64(max(0.0, far))


@lean
def key_at(lat: Lattice, o: Open, s: int, x: int, y: int) -> int:
    """Key of a state of cell (x, y): inflated heuristic when it is overconsistent, the plain one when it is not."""
    g, rhs = o.node[s, G], o.node[s, RHS]
    h = between(lat, o.now[FORM], o.now[START_X], o.now[START_Y], x, y)
    if g > rhs:
        return ((rhs + h * o.now[EPS] // 1000 + o.now[LEAD]) << 31) | rhs
    return ((g + h + o.now[LEAD]) << 31) | g


@lean
def key_of(lat: Lattice, o: Open, s: int) -> int:
    """Key of a state."""
    cell, columns = s >> SHIFT, lat.height.shape[1]
    y = cell // columns
    return key_at(lat, o, s, cell - y * columns, y)


@lean
def successor(lat: Lattice, s: int, k: int) -> int:
    """The state to which trajectory k of a state leads."""
    h = s & (HEADINGS - 1)
    step = lat.end[h, k, 1] * lat.height.shape[1] + lat.end[h, k, 0]
    return ((s >> SHIFT) + step) * HEADINGS + lat.end[h, k, 2]


@lean
def is_goal(o: Open, s: int) -> bool:
    return (s >> SHIFT) == o.now[GOAL] and (o.now[FACING] < 0 or (s & (HEADINGS - 1)) == o.now[FACING])


@lean
def place(lat: Lattice, o: Open, s: int, x: int, y: int) -> None:
    """Put a state of cell (x, y) where it belongs: in OPEN, in INCONS, or, consistent, in neither."""
    row = o.node[s]
    if row[G] == row[RHS]:
        row[KEY] = -1
        row[WORD] &= ~IN_INCONS
    elif (row[WORD] >> PASS) == o.now[TURN]:
        row[KEY] = -1
        if not row[WORD] & IN_INCONS:
            row[WORD] |= IN_INCONS
            o.incons[o.now[HELD]] = s
            o.now[HELD] += 1
    else:
        key = key_at(lat, o, s, x, y)
        if row[KEY] != key:
            row[KEY] = key
            o.now[SIZE] = push(o.keys, o.items, o.now[SIZE], key, s)


@lean
def put(lat: Lattice, o: Open, s: int) -> None:
    """The same for any state."""
    cell, columns = s >> SHIFT, lat.height.shape[1]
    y = cell // columns
    place(lat, o, s, cell - y * columns, y)


@lean
def look_ahead(lat: Lattice, o: Open, s: int) -> None:
    """rhs of a state anew: the least over its trajectories."""
    if is_goal(o, s):
        return
    best, rhs = NO_K, INF
    for k in range(lat.cost.shape[1]):
        c = lat.cost[s, k]
        if c < INF:
            there = c + o.node[successor(lat, s, k), G]
            if there < rhs:
                best, rhs = k, there
    o.node[s, RHS] = rhs
    o.node[s, WORD] = (o.node[s, WORD] & ~NO_K) | best


@lean
def expand(lat: Lattice, o: Open, s: int) -> None:
    """One expansion: a state becomes consistent, or is raised, and its predecessors hear of it."""
    row = o.node[s]
    lowers = row[G] > row[RHS]
    if lowers:
        row[G] = row[RHS]
        row[WORD] = (row[WORD] & 255) | (o.now[TURN] << PASS)
    else:
        row[G] = INF
        put(lat, o, s)
    g, h, cell = row[G], s & (HEADINGS - 1), s >> SHIFT
    rows, columns = lat.height.shape
    y = cell // columns
    x = cell - y * columns
    for i in range(lat.from_heading.shape[1]):
        a = lat.from_heading[h, i]
        if a < 0:
            break
        k = lat.from_k[h, i]
        px, py = x - lat.end[a, k, 0], y - lat.end[a, k, 1]
        if px < 0 or py < 0 or px >= columns or py >= rows:
            continue
        p = (py * columns + px) * HEADINGS + a
        c = lat.cost[p, k]
        if c >= INF:
            continue
        if lowers:
            if c + g < o.node[p, RHS] and not is_goal(o, p):
                o.node[p, RHS] = c + g
                o.node[p, WORD] = (o.node[p, WORD] & ~NO_K) | k
                place(lat, o, p, px, py)
        elif (o.node[p, WORD] & NO_K) == k:
            look_ahead(lat, o, p)
            place(lat, o, p, px, py)


@lean
def compute(lat: Lattice, o: Open, budget: int) -> int:
    """ComputeOrImprovePath: expand until the start is settled, at most so many states.

    DONE: the start's cost is within ε, or there is no way · MORE: the budget is spent · FULL: the heap is.
    """
    now = o.now
    now[CALL] = 0
    start = now[START]
    room = len(o.keys) - lat.from_heading.shape[1] - 2
    while True:
        while now[SIZE] > 0 and o.node[o.items[0], KEY] != o.keys[0]:
            now[SIZE] = drop_first(o.keys, o.items, now[SIZE])
        settled = o.node[start, G] == o.node[start, RHS]
        if now[SIZE] == 0 or (settled and o.keys[0] >= key_of(lat, o, start)):
            return DONE
        if now[CALL] >= budget:
            return MORE
        if now[SIZE] > room:
            return FULL
        s, old = np.int64(o.items[0]), o.keys[0]
        now[SIZE] = drop_first(o.keys, o.items, now[SIZE])
        key = key_of(lat, o, s)
        o.node[s, KEY] = -1
        if key > old:  # the start has moved since it was put here
            o.node[s, KEY] = key
            now[SIZE] = push(o.keys, o.items, now[SIZE], key, s)
            continue
        now[CALL] += 1
        now[ALL] += 1
        expand(lat, o, s)


@lean
def forget(o: Open) -> None:
    """Every state as if never seen."""
    o.node[:, G] = INF
    o.node[:, RHS] = INF
    o.node[:, KEY] = -1
    o.node[:, WORD] = NO_K
    o.now[SIZE] = o.now[HELD] = o.now[LEAD] = 0
    o.now[TURN] = 1


@lean
def begin(lat: Lattice, o: Open) -> None:
    """Search from nothing: the goal alone is in OPEN."""
    forget(o)
    o.now[BEGUN] += 1
    for h in range(HEADINGS):
        s = o.now[GOAL] * HEADINGS + h
        if is_goal(o, s):
            o.node[s, RHS] = 0
            put(lat, o, s)


@lean
def next_pass(lat: Lattice, o: Open, rekey: bool) -> None:
    """OPEN takes in INCONS, CLOSED is emptied; rekey: all keys anew, as a new ε or new heights need."""
    now = o.now
    now[TURN] += 1
    if rekey:
        now[LEAD] = 0
        compact(lat, o, True)
    held = now[HELD]
    now[HELD] = 0
    for i in range(held):
        s = o.incons[i]
        if o.node[s, WORD] & IN_INCONS:
            o.node[s, WORD] &= ~IN_INCONS
            put(lat, o, s)


@lean
def compact(lat: Lattice, o: Open, rekey: bool) -> None:
    """Leave out the entries of the heap that no longer count, with new keys when asked for, and order it again."""
    kept = 0
    for i in range(o.now[SIZE]):
        s, key = o.items[i], o.keys[i]
        if o.node[s, KEY] == key:
            o.node[s, KEY] = -2 - s  # met: a second entry of the same key does not count
            o.items[kept], o.keys[kept] = s, key
            kept += 1
    for i in range(kept):
        s = o.items[i]
        o.node[s, KEY] = -1
        if rekey:
            o.keys[i] = key_of(lat, o, s)
    o.now[SIZE] = 0
    for i in range(kept):
        s, key = o.items[i], o.keys[i]
        o.node[s, KEY] = key
        o.now[SIZE] = push(o.keys, o.items, o.now[SIZE], key, s)


@lean
def touch(lat: Lattice, o: Open, states: I32) -> None:
    """Costs of these states' trajectories changed: their rhs anew, and where they belong."""
    for i in range(len(states)):
        s = np.int64(states[i])
        if o.now[SIZE] > len(o.keys) - 4:
            compact(lat, o, False)
        look_ahead(lat, o, s)
        put(lat, o, s)


@lean
def way(lat: Lattice, o: Open, states: I32, ks: I32) -> int:
    """Follow the best trajectories from the start; returns how many, or -1 when they lead nowhere."""
    s = o.now[START]
    n = 0
    while not is_goal(o, s):
        k = o.node[s, WORD] & NO_K
        if k == NO_K or n == len(ks):
            return -1
        states[n], ks[n] = s, k
        n += 1
        s = successor(lat, s, k)
    states[n] = s
    return n
