"""One vehicle among others whose ways are fixed: searches over (place, tick) and (state, tick), waits on a route.

Source: Silver 2005 (cooperative A*). Occupancy is `mapf`: no two in a place, no swaps, following allowed, who has
arrived stays. After the last motion of the others (`calm`) the floor is still, so all later ticks are one layer: each
search is finite and complete, and optimal in its cost. Cost: a few array accesses per place and tick (time), a heap
operation per state and tick (energy).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.single import Net
from engine.planners.kernels.tables import FAR
from engine.types import FOREVER

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

SOLVED, NO_PATH, BUDGET, FULL = 0, 1, 2, 3


class Taken(NamedTuple):
    """Fixed ways. who: (T, P) vehicle + 1 · parked: (P,) tick from which somebody rests · last: (P,) latest tick at
    which somebody is there · calm: (1,) latest arrival.
    """

    who: I32
    parked: I32
    last: I32
    calm: I64


def new_taken(ticks: int, places: int) -> Taken:
    """An empty floor with room for ways of so many ticks."""
    return Taken(
        np.zeros((ticks, places), np.int32), np.full(places, FOREVER, np.int32), np.full(places, -1, np.int32),
        np.zeros(1, np.int64),
    )  # fmt: skip


@lean
def take(k: Taken, vehicle: int, way: I32, n: int) -> None:
    """Fix a way of n places, tick by tick; the last is its resting place."""
    for t in range(n):
        p = way[t]
        k.who[t, p] = vehicle + 1
        k.last[p] = max(k.last[p], t)
    k.parked[way[n - 1]] = n - 1
    k.last[way[n - 1]] = FOREVER
    k.calm[0] = max(k.calm[0], n - 1)


@lean
def release(k: Taken, way: I32, n: int) -> None:
    """Forget a way; only good when all of them are forgotten before the next search."""
    for t in range(n):
        k.who[t, way[t]] = 0
        k.last[way[t]] = -1
    k.parked[way[n - 1]] = FOREVER
    k.calm[0] = 0


@njit(cache=True, nogil=True, inline="always")
def open_to(k, blocked, u, v, t):  # type: ignore[no-untyped-def]
    """True when a vehicle in u may be in v at tick t + 1."""
    if blocked[v] or k.parked[v] <= t + 1:
        return False
    if t >= k.calm[0]:
        return True
    if k.who[t + 1, v] != 0:
        return False
    other = k.who[t, v]
    return u == v or other == 0 or k.who[t + 1, u] != other


class Layers(NamedTuple):
    """Reusable room of searches over (place, tick). seen: (T * P,) stamp of the search that was there."""

    seen: I32
    stamp: I64  # (1,)
    place: I32
    tick: I32
    parent: I32
    next: I32
    head: I32


def new_layers(ticks: int, places: int) -> Layers:
    """Room for so many ticks."""

    def i32(n: int) -> I32:
        return np.zeros(n, np.int32)

    n = ticks * places
    return Layers(
        i32(n), np.zeros(1, np.int64), i32(n), i32(n), i32(n), i32(n), np.full(4 * (ticks + places), -1, np.int32)
    )  # fmt: skip


@lean
def quickest(
    step: I32, k: Taken, blocked: U8, w: Layers, table: I32, start: int, goal: int, limit: int, way: I32, out: I64
) -> int:  # fmt: skip
    """Earliest arrival for good. table: (P+1,) steps to the goal. out: places of the way, expansions (added up)."""
    places, heads = len(step) - 1, step.shape[1]
    if table[start] < 0 or blocked[start] or k.parked[start] == 0 or k.who[0, start] != 0:
        return NO_PATH
    if k.last[goal] == FOREVER:
        return NO_PATH
    layers = k.calm[0] + 2
    if layers * places > len(w.seen):
        return FULL
    w.stamp[0] += 1
    stamp = w.stamp[0]
    calm, ready = k.calm[0], k.last[goal] + 1
    n, expanded = 1, 0
    f = max(np.int64(table[start]), np.int64(ready))
    first, highest = f, f
    if highest + 4 >= len(w.head):
        return FULL
    w.place[0], w.tick[0], w.parent[0], w.next[0] = start, 0, -1, -1
    w.head[f] = 0
    status = NO_PATH
    while f <= highest:
        at = w.head[f]
        if at < 0:
            f += 1
            continue
        w.head[f] = w.next[at]
        u, t = w.place[at], w.tick[at]
        layer = min(t, calm + 1)
        if t > calm:
            if w.seen[layer * places + u] == stamp:
                continue
            w.seen[layer * places + u] = stamp
        if u == goal and t >= ready:
            if t + 1 > len(way) or t + 1 > len(k.who):
                status = FULL
                break
            out[0] = t + 1
            i = at
            while i >= 0:
                way[w.tick[i]] = w.place[i]
                i = w.parent[i]
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if n + heads + 1 >= len(w.place) or highest + 4 >= len(w.head):
            status = FULL
            break
        expanded += 1
        late = min(t + 1, calm + 1) * places
        for d in range(heads, -1, -1):
            v = u if d == heads else step[u, d]
            if v >= places or w.seen[late + v] == stamp or table[v] < 0 or not open_to(k, blocked, u, v, t):
                continue
            if t + 1 <= calm:
                w.seen[late + v] = stamp
            f2 = max(np.int64(t) + 1 + table[v], np.int64(ready))
            w.place[n], w.tick[n], w.parent[n], w.next[n] = v, t + 1, at, w.head[f2]
            w.head[f2] = n
            highest = max(highest, f2)
            n += 1
    for i in range(first, highest + 1):
        w.head[i] = -1
    out[1] += expanded
    return status


@lean
def quickest_pass(
    step: I32, k: Taken, blocked: U8, w: Layers, tables: I32, row: I32, starts: I32, goals: I32, order: I32,
    limit: int, ways: I32, length: I32, out: I64,
) -> int:  # fmt: skip
    """All vehicles in order. ways: (n, T), length: (n,). out[2]: the vehicle that found no way, out[3] ticks in all.

    `k` is empty before and after, but for a FULL or failed pass, when `forget` empties it.
    """
    length[:] = 0
    out[3] = 0
    for i in range(len(order)):
        a = order[i]
        status = quickest(
            step, k, blocked, w, tables[row[a]], starts[a], goals[a], limit - out[1], ways[a], out
        )  # fmt: skip
        if status != SOLVED:
            out[2] = a
            return status
        length[a] = out[0]
        out[3] += out[0] - 1
        take(k, a, ways[a], length[a])
    return SOLVED


@lean
def forget(k: Taken, ways: I32, length: I32) -> None:
    """Empty the floor of all ways taken."""
    for a in range(len(length)):
        if length[a] > 0:
            release(k, ways[a], length[a])


class Nodes(NamedTuple):
    """Reusable room of searches over (state, tick): nodes, a hash of (state, layer) → node, heap."""

    state: I32
    tick: I32
    g: I64
    parent: I32
    key: I64
    node: I32
    mark: I32
    stamp: I64  # (1,)
    heap_f: I64
    heap_n: I32


def new_nodes(nodes: int) -> Nodes:
    """Room for so many nodes, a power of two."""

    def i32(n: int) -> I32:
        return np.zeros(n, np.int32)

    def i64(n: int) -> I64:
        return np.zeros(n, np.int64)

    return Nodes(
        i32(nodes), i32(nodes), i64(nodes), i32(nodes), i64(2 * nodes), i32(2 * nodes), i32(2 * nodes), i64(1),
        i64(nodes), i32(nodes),
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _slot(w, key, stamp):  # type: ignore[no-untyped-def]
    mask = len(w.key) - 1
    at = np.int64((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(30)) & mask
    while w.mark[at] == stamp and w.key[at] != key:
        at = (at + 1) & mask
    return at


@lean
def cheapest(
    net: Net, k: Taken, blocked: U8, w: Nodes, table: I64, cost: I64, standby: int, start: int, goal: int, limit: int,
    states: I32, out: I64,
) -> int:  # fmt: skip
    """Least energy to rest at the goal for good. cost: (K,) mJ of each primitive, standby included.

    states: room for calm + 2 + S ticks. out: states of the way, expansions (added up), mJ.
    """
    shift = net.shift
    u = start >> shift
    if table[start] >= FAR or blocked[u] or k.parked[u] == 0 or k.who[0, u] != 0 or k.last[goal] == FOREVER:
        return NO_PATH
    w.stamp[0] += 1
    stamp = w.stamp[0]
    calm, ready = k.calm[0], k.last[goal] + 1
    total = np.int64(len(net.stopped))
    n, size, expanded = 1, 0, 0
    w.state[0], w.tick[0], w.g[0], w.parent[0] = start, 0, 0, -1
    at = _slot(w, np.int64(start), stamp)
    w.key[at], w.node[at], w.mark[at] = start, 0, stamp
    size = push(w.heap_f, w.heap_n, size, table[start], 0)
    status = NO_PATH
    while size > 0:
        node = w.heap_n[0]
        size = drop_first(w.heap_f, w.heap_n, size)
        s, t, g = w.state[node], w.tick[node], w.g[node]
        at = _slot(w, min(t, calm + 1) * total + s, stamp)
        if w.node[at] != node:
            continue
        u = s >> shift
        if u == goal and t >= ready:
            out[0], out[2] = t + 1, g
            i = node
            while i >= 0:
                states[w.tick[i]] = w.state[i]
                i = w.parent[i]
            status = SOLVED
            break
        if expanded >= limit:
            status = BUDGET
            break
        if n + 32 >= len(w.state) or size + 32 >= len(w.heap_f):
            status = FULL
            break
        expanded += 1
        last = net.edge_ptr[s + 1]
        # after calm nothing opens any more: only who stands at the goal's door could still wait, and need not
        for e in range(net.edge_ptr[s], last + (1 if t <= calm else 0)):
            if e < last:
                v = net.edge_to[e]
                g2 = g + cost[net.edge_kind[e]]
            else:
                v = net.stopped[s]
                g2 = g + standby
            h = table[v]
            if h >= FAR or not open_to(k, blocked, u, v >> shift, t):
                continue
            key = min(t + 1, calm + 1) * total + v
            at = _slot(w, key, stamp)
            if w.mark[at] == stamp and w.g[w.node[at]] <= g2:
                continue
            w.key[at], w.node[at], w.mark[at] = key, n, stamp
            w.state[n], w.tick[n], w.g[n], w.parent[n] = v, t + 1, g2, node
            size = push(w.heap_f, w.heap_n, size, g2 + h, n)
            n += 1
    out[1] += expanded
    return status


@njit(cache=True, nogil=True)
def waits_on(
    net: Net, k: Taken, blocked: U8, path: I32, cost: I64, standby: int, states: I32, out: I64
) -> int:  # fmt: skip
    """Least energy along a fixed way by waiting only.

    path: its states without waits · states: room for calm + 3 ticks more than the path.

    Dynamic programming over (position, rolling or standing) tick by tick. out: states, positions looked at (added up),
    mJ. NO_PATH when no wait helps.
    """
    steps = len(path) - 1
    shift = net.shift
    goal = path[steps] >> shift
    if k.last[goal] == FOREVER or k.parked[path[0] >> shift] == 0 or k.who[0, path[0] >> shift] != 0:
        return NO_PATH
    ready = k.last[goal] + 1
    ticks = k.calm[0] + steps + 2
    # cost of the step from position i, standing and rolling
    onward = np.full((steps + 1, 2), FAR, np.int64)
    for i in range(steps):
        for m in range(2):
            s = path[i] if m else net.stopped[path[i]]
            for e in range(net.edge_ptr[s], net.edge_ptr[s + 1]):
                if net.edge_to[e] == path[i + 1]:
                    onward[i, m] = cost[net.edge_kind[e]]
    now = np.full((steps + 1, 2), FAR, np.int64)
    then = np.empty((steps + 1, 2), np.int64)
    # who it came from: 0, 1 waited (standing, rolling before), 2, 3 moved
    came = np.full((ticks + 1, steps + 1, 2), -1, np.int8)
    now[0, path[0] & 1] = 0
    cheapest_mj, at_tick, at_m = FAR, -1, 0
    for t in range(ticks + 1):
        if t >= ready:
            for m in range(2):
                if now[steps, m] < cheapest_mj:
                    cheapest_mj, at_tick, at_m = now[steps, m], t, m
        if t == ticks:
            break
        then[:] = FAR
        for i in range(steps + 1):
            u = path[i] >> shift
            for m in range(2):
                g = now[i, m]
                if g >= FAR:
                    continue
                out[1] += 1
                if g + standby < then[i, 0] and open_to(k, blocked, u, u, t):
                    then[i, 0] = g + standby
                    came[t + 1, i, 0] = m
                if i < steps and onward[i, m] < FAR and g + onward[i, m] < then[i + 1, 1]:
                    v = path[i + 1] >> shift
                    if open_to(k, blocked, u, v, t):
                        then[i + 1, 1] = g + onward[i, m]
                        came[t + 1, i + 1, 1] = 2 + m
        now, then = then, now
    if at_tick < 0:
        return NO_PATH
    out[0], out[2] = at_tick + 1, cheapest_mj
    i, m = steps, at_m
    for t in range(at_tick, -1, -1):
        states[t] = path[i] if m else net.stopped[path[i]]
        by = came[t, i, m]
        if by >= 2:
            i -= 1
        m = by & 1
    return SOLVED
