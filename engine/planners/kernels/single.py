"""One vehicle alone on a floor: A* over places by distance, and over motion states by energy.

Source: Hart, Nilsson & Raphael 1968; energy form: Xu & Wang 2025 (EEA*). Optimal for an admissible heuristic. A search
is a few array accesses per expansion: what an earlier search left behind is larger than anything a new one writes
(`base` falls from search to search), so nothing is cleared; open lists are buckets of equal f, not heaps, wherever f
takes few values. Tracing writes into arrays of the caller; empty arrays are never touched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.tables import FAR
from engine.world.motion_graph import MotionGraph

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

SOLVED, NO_PATH, BUDGET, FULL = 0, 1, 2, 3
FIFO, LIFO, LARGER_G, RANDOM = 0, 1, 2, 3
MANHATTAN, CHEBYSHEV, EUCLIDEAN, OCTILE, ZERO, TABLE = 0, 1, 2, 3, 4, 5
SPAN = 1 << 43
"""Energies of one search lie below this many mJ."""


class Trace(NamedTuple):
    """Expansions in order: node (place or state), node it came from (-1 for none), g, h, f, size of the open list."""

    node: I32
    parent: I32
    g: I64
    h: I64
    f: I64
    open: I32


def new_trace(rows: int) -> Trace:
    """Room for so many expansions; 0 for no trace."""
    i32, i64 = np.int32, np.int64
    return Trace(
        np.zeros(rows, i32), np.zeros(rows, i32), np.zeros(rows, i64), np.zeros(rows, i64), np.zeros(rows, i64),
        np.zeros(rows, i32),
    )  # fmt: skip


# -- places -----------------------------------------------------------------------------------------------------------


class Grounds(NamedTuple):
    """A floor's places. step: (P+1, D) neighbour in each direction, P for none · xy: (P+1,) cell as x | y << 16
    · length: (D,) mm of a step in each direction.
    """

    step: I32
    xy: I32
    length: I64


def grounds_of(graph: MotionGraph) -> Grounds:
    """The projection of a grid's motion graph on its places."""
    n, heads = graph.n_places, len(graph.heading_deg)
    step = np.full((n + 1, heads), n, np.int32)
    to = graph.edge_to
    step[graph.state_place[graph.edge_from], graph.state_heading[to]] = graph.state_place[to]
    step[np.arange(n + 1)[:, None] == step] = n  # a pivot is no step
    cell_mm = cell_of(graph)
    cells = np.floor(graph.xy_m.astype(np.float64) * 1000 / cell_mm).astype(np.int64)
    xy = np.zeros(n + 1, np.int32)
    xy[:n] = cells[:, 0] | cells[:, 1] << 16
    length = [round(cell_mm * (2**0.5 if deg % 90 else 1)) for deg in graph.heading_deg]
    return Grounds(step, xy, np.array(length, np.int64))


def cell_of(graph: MotionGraph) -> int:
    """Side of a cell in mm: the length of a straight step."""
    return next((round(p.length_mm) for p in graph.primitives if p.turn_deg == 0 and p.length_mm), 1000)


class Lattice(NamedTuple):
    """A 4-connected grid's cells in rows, with a free margin, so that a neighbour is an offset.

    cell: (P,) of each place, x | y << 16 · place: (C,) of each cell, -1 for none · ways: (C,) a bit for each direction
    that leads on · wide: cells in a row.
    """

    cell: I32
    place: I32
    ways: NDArray[np.uint8]
    wide: int


def lattice_of(grounds: Grounds) -> Lattice:
    """The places of a 4-connected grid. Raises ValueError where a step leads elsewhere than to the next cell."""
    none = len(grounds.step) - 1
    cell = grounds.xy[:none] + 0x10001
    x, y = cell & 0xFFFF, cell >> 16
    wide = int(x.max(initial=0)) + 2
    at = x + y * wide
    size = wide * (int(y.max(initial=0)) + 2)
    place, ways = np.full(size, -1, np.int32), np.zeros(size, np.uint8)
    place[at] = np.arange(none)
    for d, offset in enumerate((1, wide, -1, -wide)):
        leads = grounds.step[:none, d] != none
        if (place[at + offset][leads] != grounds.step[:none, d][leads]).any():
            raise ValueError("steps between adjacent cells were expected")
        ways[at] |= leads.astype(np.uint8) << d
    return Lattice(cell, place, ways, wide)


class PlaceWork(NamedTuple):
    """Reusable room of searches over cells. best: (C,) g << 4 | closed << 3 | direction it came by, over `base`.

    queue: (4, ·) cells that wait, by f modulo 4 · ends: (2, 4) first and end of each.
    """

    best: I32
    base: I64  # (1,)
    queue: I32
    ends: I64


def new_place_work(lattice: Lattice) -> PlaceWork:
    """Room for one floor."""
    cells = len(lattice.place)
    return PlaceWork(
        np.full(cells, 2**31 - 1, np.int32), np.full(1, (2**31 - 1) >> 4, np.int64),
        np.zeros((4, 4 * cells + 16), np.int32), np.zeros((2, 4), np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def cells_apart(rule, xy, gx, gy):  # type: ignore[no-untyped-def]
    """Steps that a rule counts between two cells of a 4-connected grid."""
    dx, dy = abs((xy & 0xFFFF) - gx), abs((xy >> 16) - gy)
    if rule == MANHATTAN:
        return dx + dy
    if rule == CHEBYSHEV:
        return max(dx, dy)
    return 0


@lean
def astar_unit(
    lattice: Lattice, w: PlaceWork, start: int, goal: int, rule: int, table: I32, lifo: bool, limit: int, trace: Trace,
    out: I64,
) -> int:  # fmt: skip
    """Fewest steps with a heuristic that changes by at most one a step. out: steps, expansions, rows traced.

    f grows by at most two a step, so four lists hold all: taken from the front (fifo) or the end, joined at the end.
    """
    wide, place, ways = lattice.wide, lattice.place, lattice.ways
    best, queue, first, end = w.best, w.queue, w.ends[0], w.ends[1]
    if w.base[0] < 2 * len(best) + 4:
        best[:] = 2**31 - 1
        w.base[0] = (2**31 - 1) >> 4
    w.base[0] -= len(best) + 2
    base = w.base[0]
    w.ends[:] = 0
    item = lattice.cell[start]
    target = lattice.cell[goal]
    gx, gy = target & 0xFFFF, target >> 16
    f = np.int64(table[start]) if rule == TABLE else np.int64(cells_apart(rule, item, gx, gy))
    out[0], out[1], out[2] = -1, 0, 0
    if rule == TABLE and f < 0:
        return NO_PATH
    expanded, traced, empty = 0, 0, 0
    best[(item >> 16) * wide + (item & 0xFFFF)] = base << 4
    queue[f & 3, 0] = item
    end[f & 3] = 1
    status = NO_PATH
    while empty < 4:
        k = f & 3
        if first[k] == end[k]:
            first[k] = end[k] = 0
            f += 1
            empty += 1
            continue
        empty = 0
        if lifo:
            end[k] -= 1
            item = queue[k, end[k]]
        else:
            item = queue[k, first[k]]
            first[k] += 1
        at = (item >> 16) * wide + (item & 0xFFFF)
        mark = best[at]
        if mark & 8:
            continue
        best[at] = mark | 8
        g = (mark >> 4) - base
        if item == target:
            out[0] = g
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if expanded < len(trace.node):
            trace.node[expanded], trace.g[expanded], trace.f[expanded] = place[at], g, f
            trace.h[expanded], trace.open[expanded] = f - g, end.sum() - first.sum()
            trace.parent[expanded] = -1 if g == 0 else place[at - offset(mark & 7, wide)]
            traced += 1
        expanded += 1
        ahead = np.int32((base + g + 1) << 4)
        open_ways = ways[at]
        for d in range(4):
            to = at + offset(d, wide)
            if (ahead | 15) < best[to] and (open_ways >> d) & 1:
                best[to] = ahead | d
                cell = item + offset(d, 1 << 16)
                h = np.int64(table[place[to]]) if rule == TABLE else np.int64(cells_apart(rule, cell, gx, gy))
                if h < 0:
                    continue
                k2 = (g + 1 + h) & 3
                queue[k2, end[k2]] = cell
                end[k2] += 1
    out[1], out[2] = expanded, traced
    return status


@njit(cache=True, nogil=True, inline="always")
def offset(d, wide):  # type: ignore[no-untyped-def]
    """From a cell to the next one east, north, west or south."""
    if d == 0:
        return 1
    if d == 1:
        return wide
    if d == 2:
        return -1
    return -wide


@lean
def trail(lattice: Lattice, best: I32, goal: int, places: I32, shift: int, states: I32) -> None:
    """Write the places from start to goal that the last `astar_unit` found, and the states of rolling that way.

    The first state stands and faces the first step. shift: as in Net; the states are true where every state leads on to
    all the neighbours of its place.
    """
    cell = lattice.cell[goal]
    at = (cell >> 16) * lattice.wide + (cell & 0xFFFF)
    d = 0
    for i in range(len(places) - 1, -1, -1):
        places[i] = lattice.place[at]
        if i > 0:
            d = best[at] & 7
            states[i] = places[i] << shift | d << 1 | 1
            at -= offset(d, lattice.wide)
    states[0] = places[0] << shift | d << 1


@njit(cache=True, nogil=True, inline="always")
def came_from(d, heads):  # type: ignore[no-untyped-def]
    """The opposite direction."""
    return d + heads // 2 if d < heads // 2 else d - heads // 2


@lean
def way_back(back: I32, best: I32, start: int, goal: int, places: I32) -> int:
    """Write the places from start to goal that `astar_any` found; returns their number.

    back: (P+1, D) where a step in the opposite direction comes from.
    """
    heads = back.shape[1]
    n, at = 1, goal
    while at != start:
        at = back[at, came_from(best[at] & 7, heads)]
        n += 1
    i, at = n - 1, goal
    places[i] = goal
    while at != start:
        at = back[at, came_from(best[at] & 7, heads)]
        i -= 1
        places[i] = at
    return n


@njit(cache=True, nogil=True, inline="always")
def length_apart(rule, xy, gx, gy, cell, diagonal):  # type: ignore[no-untyped-def]
    """Millimetres that a rule counts between two cells, rounded down."""
    dx, dy = abs((xy & 0xFFFF) - gx), abs((xy >> 16) - gy)
    if rule == MANHATTAN:
        return (dx + dy) * cell
    if rule == CHEBYSHEV:
        return max(dx, dy) * cell
    if rule == EUCLIDEAN:
        return np.int64(np.sqrt(np.float64(dx * dx + dy * dy)) * cell)
    if rule == OCTILE:
        return (max(dx, dy) - min(dx, dy)) * cell + min(dx, dy) * diagonal
    return np.int64(0)


@njit(cache=True, nogil=True)
def astar_any(
    step: I32, back: I32, xy: I32, length: I64, best: I32, start: int, goal: int, rule: int, table: I64, tie: int,
    seed: int, limit: int, trace: Trace, out: I64,
) -> int:  # fmt: skip
    """Shortest way in mm with any heuristic and tie rule, by a heap of (f, tie). out: mm, expansions, rows traced.

    Closed places are opened again when a shorter way to them appears. best: (P+1,) direction by which each was reached
    · back: (P+1, D) where a step in the opposite direction comes from.
    """
    places, heads = len(step) - 1, step.shape[1]
    cell, diagonal = length[0], length[heads // 4 // 2] if heads == 8 else length[0] * 1414 // 1000
    if heads == 8:
        diagonal = length[1]
    gx, gy = xy[goal] & 0xFFFF, xy[goal] >> 16
    g = np.full(places + 1, FAR, np.int64)
    g[places] = -1
    room = 4 * heads * places + 16
    key_f, key_t, key_g = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    items = np.empty(room, np.int32)
    out[0], out[1], out[2] = -1, 0, 0
    first = table[start] if rule == TABLE else np.int64(length_apart(rule, xy[start], gx, gy, cell, diagonal))
    if first >= FAR:
        return NO_PATH
    g[start] = 0
    key_f[0], key_t[0], key_g[0], items[0] = first, 0, 0, start
    size, count, expanded, traced = 1, np.int64(1), 0, 0
    noise = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0xD1B54A32D192ED03)
    status = NO_PATH
    while size > 0:
        f, p, gp = key_f[0], items[0], key_g[0]
        size -= 1
        _sift_down(key_f, key_t, key_g, items, size)
        if gp != g[p]:
            continue
        if p == goal:
            out[0] = gp
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if expanded < len(trace.node):
            trace.node[expanded], trace.g[expanded], trace.f[expanded] = p, gp, f
            trace.h[expanded], trace.open[expanded] = f - gp, size
            trace.parent[expanded] = -1 if p == start else back[p, came_from(best[p], heads)]
            traced += 1
        expanded += 1
        for d in range(heads):
            v = step[p, d]
            g2 = gp + length[d]
            if g2 >= g[v]:
                continue
            g[v] = g2
            best[v] = d
            h = table[v] if rule == TABLE else np.int64(length_apart(rule, xy[v], gx, gy, cell, diagonal))
            if h >= FAR:
                continue
            if tie == FIFO:
                t = count
            elif tie == LIFO:
                t = -count
            elif tie == LARGER_G:
                t = -g2
            else:
                noise ^= noise << np.uint64(13)
                noise ^= noise >> np.uint64(7)
                noise ^= noise << np.uint64(17)
                t = np.int64(noise >> np.uint64(1))
            count += 1
            _sift_up(key_f, key_t, key_g, items, size, g2 + h, t, g2, v)
            size += 1
    out[1], out[2] = expanded, traced
    return status


@lean
def _sift_up(key_f: I64, key_t: I64, key_g: I64, items: I32, i: int, f: int, t: int, g: int, item: int) -> None:
    while i > 0:
        up = (i - 1) >> 1
        if key_f[up] < f or (key_f[up] == f and key_t[up] <= t):
            break
        key_f[i], key_t[i], key_g[i], items[i] = key_f[up], key_t[up], key_g[up], items[up]
        i = up
    key_f[i], key_t[i], key_g[i], items[i] = f, t, g, item


@lean
def _sift_down(key_f: I64, key_t: I64, key_g: I64, items: I32, size: int) -> None:
    f, t, g, item = key_f[size], key_t[size], key_g[size], items[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        right = child + 1
        if right < size and (
            key_f[right] < key_f[child] or (key_f[right] == key_f[child] and key_t[right] < key_t[child])
        ):
            child = right
        if key_f[child] > f or (key_f[child] == f and key_t[child] >= t):
            break
        key_f[i], key_t[i], key_g[i], items[i] = key_f[child], key_t[child], key_g[child], items[child]
        i = child
    key_f[i], key_t[i], key_g[i], items[i] = f, t, g, item


@lean
def steps_to(step: I32, goal: int, out: I32, queue: I32) -> None:
    """Fewest steps from every place to the goal, -1 for none, by breadth-first search; ways lead both ways."""
    places = len(step) - 1
    out[:] = -1
    out[goal] = 0
    queue[0] = goal
    n, i = 1, 0
    while i < n:
        p = queue[i]
        i += 1
        for d in range(step.shape[1]):
            v = step[p, d]
            if v < places and out[v] < 0:
                out[v] = out[p] + 1
                queue[n] = v
                n += 1


# -- motion states ----------------------------------------------------------------------------------------------------


class Net(NamedTuple):
    """What an energy search reads of a motion graph whose places have 2**shift states each.

    xy: (P,) cell as x | y << 16.
    """

    edge_ptr: I32
    edge_to: I32
    edge_from: I32
    edge_kind: I8
    stopped: I32
    xy: I32
    shift: int


def net_of(graph: MotionGraph) -> Net:
    """The arrays of a grid's graph. Raises ValueError when its places differ in their states."""
    per_place = graph.n_states // max(graph.n_places, 1)
    if per_place & (per_place - 1) or not (np.diff(graph.place_ptr) == per_place).all():
        raise ValueError("a floor whose places all have 8 or 16 states was expected")
    return Net(
        graph.edge_ptr, graph.edge_to, graph.edge_from, graph.edge_kind, graph.stopped, grounds_of(graph).xy[:-1],
        per_place.bit_length() - 1,
    )  # fmt: skip


def turns_freely(graph: MotionGraph, grounds: Grounds) -> bool:
    """Whether every state leads to all neighbours of its place in one motion, and rolls on in that direction."""
    none, heads = len(grounds.step) - 1, grounds.step.shape[1]
    steps = (grounds.step[:-1] != none).sum(axis=1)
    out = np.diff(graph.edge_ptr).reshape(none, -1)
    if out.shape[1] != 2 * heads or (out != steps[:, None]).any():
        return False
    heading = np.arange(graph.n_states) % (2 * heads) // 2
    to = graph.edge_to
    if (graph.state_heading != heading).any() or not graph.state_moving[to].all():
        return False
    seen = np.zeros((graph.n_states, heads), np.bool_)
    seen[graph.edge_from, graph.state_heading[to]] = True
    return bool(seen.sum() == graph.n_edges)


class Closed(NamedTuple):
    """Closed-form bounds in mJ: each cell ahead, one turn more, one reversal more, a start."""

    cell: int
    turn: int
    behind: int
    start: int


class StateWork(NamedTuple):
    """Reusable room of energy searches. best: (S,) (g over `base`) << 1 | closed · came: (S,) edge (-1 start, -2 - s:
    stood in s).

    item: (N,) state << 32 | 1 + next entry of equal f; `slot` finds the chain of an f by hashing.
    """

    best: I64
    base: I64  # (1,)
    came: I32
    item: I64
    slot: I32
    key: I64
    head: I32
    tail: I32
    heap_f: I64
    heap_b: I32


def new_state_work(states: int, entries: int, keys: int = 1 << 12) -> StateWork:
    """Room for so many states, entries and distinct f; keys is a power of two."""

    def i32(n: int) -> I32:
        return np.full(n, -1, np.int32)

    return StateWork(
        np.full(states, FAR, np.int64), np.full(1, FAR >> 1, np.int64), i32(states), np.zeros(entries, np.int64),
        i32(keys), np.zeros(keys, np.int64), i32(keys), i32(keys), np.zeros(2 * keys, np.int64), i32(2 * keys),
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def closed_form(c, xy, facing, moving, gx, gy):  # type: ignore[no-untyped-def]
    """Least energy to a cell without obstacles: consistent, for it knows heading and standstill."""
    dx, dy = np.int64(gx - (xy & 0xFFFF)), np.int64(gy - (xy >> 16))
    if dx == 0 and dy == 0:
        return np.int64(0)
    h = (abs(dx) + abs(dy)) * c.cell
    if facing & 1:
        ahead, aside = dy, dx
    else:
        ahead, aside = dx, dy
    if facing & 2:
        ahead = -ahead
    if aside != 0:
        h += c.turn
    elif ahead < 0:
        h += c.behind
    if moving == 0:
        h += c.start
    return h


@lean
def _bucket(w: StateWork, f: int, used: int, size: int) -> tuple[int, int, int]:
    """Chain of an f: (chain, chains in use, size of the heap). A chain outside the heap (its tail is -2) joins it."""
    mask = len(w.slot) - 1
    at = np.int64((np.uint64(f) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(32)) & mask
    b = w.slot[at]
    while b >= 0 and w.key[b] != f:
        at = (at + 1) & mask
        b = w.slot[at]
    if b < 0:
        b = used
        used += 1
        w.slot[at] = b
        w.key[b] = f
        w.head[b], w.tail[b] = -1, -2
    if w.tail[b] == -2:
        w.tail[b] = -1
        size = push(w.heap_f, w.heap_b, size, f, b)
    return b, used, size


@lean
def walked(net: Net, came: I32, cost: I64, standby: int, s: int) -> int:
    """mJ from the start to a state, along the motions by which it was reached."""
    total = np.int64(0)
    by = came[s]
    while by != -1:
        if by >= 0:
            total += cost[net.edge_kind[by]]
            by = came[net.edge_from[by]]
        else:
            total += standby
            by = came[-2 - by]
    return total


@lean
def eea(
    net: Net, w: StateWork, blocked: NDArray[np.uint8], cost: I64, standby: int, waits: bool, reverse: int,
    rewalk: bool, starts: I32, goal: int, closed: Closed, table: I64, lifo: bool, limit: int, trace: Trace, out: I64,
) -> int:  # fmt: skip
    """Least energy from any of the starts to any state of a place. cost: (K,) mJ of each primitive, standby included.

    table: (S,) cost to go, or empty for the closed form · waits: standing may pay (only where a restart is cheaper than
    a turn) · reverse: a primitive that never pays right after another motion, or -1 · rewalk: count each g
    anew from the start, as the paper's slow form does. out: last state, mJ, expansions, rows traced. FULL: no room.
    """
    w.base[0] -= SPAN
    if w.base[0] < SPAN:
        w.best[:] = FAR
        w.base[0] = (FAR >> 1) - SPAN
    base = w.base[0]
    w.slot[:] = -1
    best, came, item = w.best, w.came, w.item
    use_table = len(table) > 0
    tracing = len(trace.node) > 0
    shift = net.shift
    gxy = net.xy[goal]
    gx, gy = gxy & 0xFFFF, gxy >> 16
    n, used, size, expanded, traced, waiting = 0, 0, 0, 0, 0, 0
    for i in range(len(starts)):
        s = starts[i]
        h = table[s] if use_table else closed_form(closed, net.xy[s >> shift], s >> 1, s & 1, gx, gy)
        if h >= FAR or best[s] <= base << 1:
            continue
        best[s], came[s] = base << 1, -1
        b, used, size = _bucket(w, h, used, size)
        item[n] = np.int64(s) << 32
        if w.head[b] == -1:
            w.head[b] = n
        else:
            item[w.tail[b]] |= n + 1
        w.tail[b] = n
        n += 1
        waiting += 1
    out[0], out[1], out[2], out[3] = -1, -1, 0, 0
    status = NO_PATH
    while True:
        while size > 0 and w.head[w.heap_b[0]] == -1:
            w.tail[w.heap_b[0]] = -2
            size = drop_first(w.heap_f, w.heap_b, size)
        if size == 0:
            break
        f, b = w.heap_f[0], w.heap_b[0]
        entry = item[w.head[b]]
        s = entry >> 32
        w.head[b] = (entry & 0xFFFFFFFF) - 1
        waiting -= 1
        if best[s] & 1:
            continue
        best[s] |= 1
        gs = best[s] >> 1
        if s >> shift == goal:
            out[0], out[1] = s, gs - base
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if n + 32 >= len(item) or used + 32 >= len(w.key) // 2:
            status = FULL
            break
        if tracing and expanded < len(trace.node):
            trace.node[expanded], trace.g[expanded], trace.f[expanded] = s, gs - base, f
            trace.h[expanded], trace.open[expanded] = f - gs + base, waiting
            e = came[s]
            trace.parent[expanded] = net.edge_from[e] if e >= 0 else (-1 if e == -1 else -2 - e)
            traced += 1
        expanded += 1
        last = net.edge_ptr[s + 1]
        stand = waits and s & 1 == 1
        skip = reverse if came[s] >= 0 else -1
        for e in range(net.edge_ptr[s], last + stand):
            if e < last:
                kind = net.edge_kind[e]
                if kind == skip:
                    continue
                v = net.edge_to[e]
                g2 = gs + cost[kind]
                by = e
            else:
                v = net.stopped[s]
                g2 = gs + standby
                by = -2 - s
            if rewalk:
                g2 += walked(net, came, cost, standby, s) + base - gs
            if (g2 << 1 | 1) >= best[v] or blocked[v >> shift]:
                continue
            best[v] = g2 << 1
            came[v] = by
            if use_table:
                h = table[v]
                if h >= FAR:
                    continue
            else:
                h = closed_form(closed, net.xy[v >> shift], v >> 1, v & 1, gx, gy)
            f2 = g2 - base + h
            if f2 == f:
                b2 = b
            else:
                b2, used, size = _bucket(w, f2, used, size)
            item[n] = np.int64(v) << 32
            if w.head[b2] == -1:
                w.head[b2] = w.tail[b2] = n
            elif lifo:
                item[n] |= w.head[b2] + 1
                w.head[b2] = n
            else:
                item[w.tail[b2]] |= n + 1
                w.tail[b2] = n
            n += 1
            waiting += 1
    out[2], out[3] = expanded, traced
    return status


@njit(cache=True, nogil=True)
def eea_literal(
    net: Net, blocked: NDArray[np.uint8], cost: I64, standby: int, layers: int, starts: I32, goal: int, closed: Closed,
    table: I64, lifo: bool, limit: int, best: I64, came: I64, state: I32, trace: Trace, out: I64,
) -> int:  # fmt: skip
    """EEA* as printed: a node is a cell (layers = 1) or a cell at a time (layers > 1), whatever the heading.

    Not optimal: the first or cheapest arrival at a node decides with which heading all later increments are counted.
    best, came, state: (layers * P,) g, node before and motion state of each node. out: last node, mJ, expansions, rows.
    """
    places = len(net.xy)
    best[:], came[:] = FAR, -1
    shift = net.shift
    gx, gy = net.xy[goal] & 0xFFFF, net.xy[goal] >> 16
    room = 1 << 12
    key_f, key_t, key_g = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    items = np.empty(room, np.int32)
    size, count, expanded, traced = 0, np.int64(0), 0, 0
    out[0], out[1], out[2], out[3] = -1, -1, 0, 0
    # all the starts are one node: its first motion goes in any direction, as the best of them can
    root = starts[0] >> shift
    best[root], state[root] = 0, -1  # -1: it has not moved yet
    h = table[starts[0]] if len(table) else closed_form(closed, net.xy[root], starts[0] >> 1, 0, gx, gy)
    _sift_up(key_f, key_t, key_g, items, size, h, count, 0, root)
    size += 1
    status = NO_PATH
    while size > 0:
        f, node, g = key_f[0], np.int64(items[0]), key_g[0]
        size -= 1
        _sift_down(key_f, key_t, key_g, items, size)
        if g != best[node]:
            continue
        p = node % places
        if p == goal:
            out[0], out[1] = node, g
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if expanded < len(trace.node):
            trace.node[expanded] = starts[0] if state[node] < 0 else state[node]
            trace.g[expanded], trace.f[expanded] = g, f
            trace.h[expanded], trace.open[expanded] = f - g, size
            trace.parent[expanded] = -1
            if came[node] >= 0:
                trace.parent[expanded] = starts[0] if state[came[node]] < 0 else state[came[node]]
            traced += 1
        expanded += 1
        if size + 64 > len(items):
            more = 2 * len(items)
            key_f, key_t, key_g = _longer(key_f, more), _longer(key_t, more), _longer(key_g, more)
            items = _longer(items, more)
        layer = node // places + 1 if layers > 1 else 0
        if layer >= layers:
            status = FULL
            break
        unmoved = state[node] < 0
        for i in range(len(starts) if unmoved else 1):
            s = starts[i] if unmoved else state[node]
            for e in range(net.edge_ptr[s], net.edge_ptr[s + 1] + 1):
                if e < net.edge_ptr[s + 1]:
                    v = net.edge_to[e]
                    g2 = g + cost[net.edge_kind[e]]
                else:
                    v = net.stopped[s]
                    g2 = g + standby
                at = layer * places + (v >> shift)
                if g2 >= best[at] or blocked[v >> shift]:
                    continue
                h = table[v] if len(table) else closed_form(closed, net.xy[v >> shift], v >> 1, v & 1, gx, gy)
                if h >= FAR:
                    continue
                best[at], came[at] = g2, node
                state[at] = -1 if unmoved and e == net.edge_ptr[s + 1] else v
                count += 1
                _sift_up(key_f, key_t, key_g, items, size, g2 + h, -count if lifo else count, g2, at)
                size += 1
    out[2], out[3] = expanded, traced
    return status


@njit(cache=True, nogil=True)
def _longer(a, n):  # type: ignore[no-untyped-def]
    b = np.empty(n, a.dtype)
    b[: len(a)] = a
    return b


@lean
def states_of(net: Net, places: I32, start: int, states: I32) -> int:
    """States of a vehicle that is at these places tick by tick; -1, or the tick at which no motion leads on."""
    s = start
    states[0] = s
    for t in range(1, len(places)):
        if places[t] == s >> net.shift:
            s = net.stopped[s]
        else:
            found = -1
            for e in range(net.edge_ptr[s], net.edge_ptr[s + 1]):
                if net.edge_to[e] >> net.shift == places[t]:
                    found = net.edge_to[e]
                    break
            if found < 0:
                return t
            s = found
        states[t] = s
    return -1


@lean
def energy_along(net: Net, states: I32, cost: I64, standby: int) -> int:
    """mJ of states tick by tick, waits included; -1 when one doesn't follow from the one before."""
    total = np.int64(0)
    for t in range(1, len(states)):
        a, b = states[t - 1], states[t]
        if b == net.stopped[a]:
            total += standby
            continue
        found = False
        for e in range(net.edge_ptr[a], net.edge_ptr[a + 1]):
            if net.edge_to[e] == b:
                total += cost[net.edge_kind[e]]
                found = True
                break
        if not found:
            return -1
    return total
