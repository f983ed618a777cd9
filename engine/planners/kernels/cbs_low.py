"""One vehicle of a constraint tree: the cheapest way under its constraints, and all its cheapest ways as layers.

Source: low level of CBS (Sharon et al. 2015), landmarks of disjoint splitting (Li et al. 2019), decision diagrams (MDD)
of Boyarski et al. 2015. Objective-agnostic: every edge and every wait has an integer cost, resting at the goal after
the last arrival is free. Promise: `search` returns the true minimum over (state, tick) under the loaded constraints;
among equal costs few meetings with the others. Cost: a heap operation per node; nothing is allocated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.compiled import lean, lean_inline
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.tables import FAR
from engine.types import FOREVER

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

FOUND, NONE, FULL, SPENT = 0, 1, 2, 3
"""How a search ended."""

TIES, HARD, FEW = 0, 1, 2
"""The others' ways break ties; are obstacles; are met as seldom as the cost bound allows."""

LAST, FREE_FROM, BY, MARKS, BASE, STAMP, CLOSED, BASE_AT = range(8)
"""Slots of Bans.con: last tick at which a constraint acts · earliest tick of the last arrival · latest · number of
landmarks · cost that the last one proves until its tick, counted from tick 0 · current stamp · 1 with places closed
for good · that tick."""


BANNED, MUST, MUST_STAMP, AHEAD_TICK, AHEAD_PLACE = range(5)
CLOSED_AT, CLOSED_STAMP, ROW, QUEUE = range(4)
STATE, TICK, MET, BEFORE = range(4)
THEY, FILLED, ROOM = range(3)


class Roads(NamedTuple):
    """A graph of unit motions. Places may be states themselves.

    ptr, to, kind: CSR of motions · place, still: of each state · cost: (V, K) of a motion · wait: (V,) of a tick
    · back_ptr, back_from, back_kind: motions entering a state · place_ptr: states of each place
    · near_ptr, near: places from which a place is entered.
    """

    ptr: I32
    to: I32
    kind: I8
    place: I32
    still: I32
    cost: I64
    wait: I64
    back_ptr: I32
    back_from: I32
    back_kind: I8
    place_ptr: I32
    near_ptr: I32
    near: I32


class Bans(NamedTuple):
    """The constraints of one vehicle. Stamps stand for clearing."""

    con: I64
    key: I64  # forbidden places and motions by tick
    stamp: I32
    by_tick: I32  # (T, 5) stamp where any is forbidden · place to be in, its stamp · next landmark's tick, place
    by_place: I32  # (P, 4) tick from which it is closed for good, its stamp · row of `steps` or -1 · a queue
    steps: I32  # (R, P) least ticks to a place
    rows: I64  # (1,) rows filled


class Others(NamedTuple):
    """Where everybody else is."""

    at: I32  # (2, T·P) stamp: somebody is here · and goes there
    rest: I32  # (P, 2) tick from which somebody rests here, its stamp
    num: I64  # stamp, ticks filled, ticks of room


class Work(NamedTuple):
    """Reusable space of one search."""

    bans: Bans
    others: Others
    node: I32  # (N, 4) state, tick, meetings with the others, node before
    g: I64
    keys: I64  # heap
    items: I32
    slot_key: I64  # best node by (state, tick)
    slot: I32  # (M, 2) that node, stamp
    stamp: I64  # (1,) of the search
    path: I32  # states of the way found


class Layers(NamedTuple):
    """All ways within a cost, by tick: nodes in order of ticks, each with its motions."""

    state: I32
    tick: I32
    g: I64
    alive: I8
    ends: I8
    ptr: I32
    to: I32
    cost: I64
    slot_key: I64
    slot_node: I32
    slot_stamp: I32
    size: I64  # nodes, stamp, last tick, first tick at which a way ends


@njit(cache=True, nogil=True)
def slot_at(key, bits):  # type: ignore[no-untyped-def]
    """Home of a key in a table of 2**bits slots."""
    return np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(64 - bits))


@njit(cache=True, nogil=True)
def bits_of(size):  # type: ignore[no-untyped-def]
    """log2 of a table's size, a power of two."""
    bits = 0
    while (1 << bits) < size:
        bits += 1
    return bits


@lean
def fill_cost_to_goal(r: Roads, cls: int, goal: int, blocked, out: I64, keys: I64, items: I32) -> None:  # type: ignore[no-untyped-def]
    """out[s]: least cost from every state to the goal place on the floor without others; FAR when unreachable."""
    out[:] = FAR
    if blocked[goal]:
        return
    if r.cost.shape[1] == 1:  # every motion costs the same
        unit = r.cost[cls, 0]
        tail = 0
        for s in range(r.place_ptr[goal], r.place_ptr[goal + 1]):
            out[s] = 0
            items[tail] = s
            tail += 1
        head = 0
        while head < tail:
            s = items[head]
            head += 1
            for k in range(r.back_ptr[s], r.back_ptr[s + 1]):
                u = r.back_from[k]
                if out[u] >= FAR and not blocked[r.place[u]]:
                    out[u] = out[s] + unit
                    items[tail] = u
                    tail += 1
        return
    size = 0
    for s in range(r.place_ptr[goal], r.place_ptr[goal + 1]):
        out[s] = 0
        size = push(keys, items, size, 0, s)
    while size > 0:
        d, s = keys[0], items[0]
        size = drop_first(keys, items, size)
        if d > out[s]:
            continue
        for k in range(r.back_ptr[s], r.back_ptr[s + 1]):
            u = r.back_from[k]
            through = d + r.cost[cls, r.back_kind[k]]
            if through < out[u] and not blocked[r.place[u]]:
                out[u] = through
                size = push(keys, items, size, through, u)


@lean
def steps_to(r: Roads, k: Bans, place: int) -> int:
    """Row of k.steps with the least ticks to a place, blocks ignored; -1 when there is no room."""
    row = np.int64(k.by_place[place, ROW])
    if row >= 0:
        return row
    row = k.rows[0]
    if row >= k.steps.shape[0]:
        return -1
    k.rows[0] = row + 1
    k.by_place[place, ROW] = row
    out = k.steps[row]
    out[:] = FOREVER
    out[place] = 0
    k.by_place[0, QUEUE] = place
    head, tail = 0, 1
    while head < tail:
        p = k.by_place[head, QUEUE]
        head += 1
        for i in range(r.near_ptr[p], r.near_ptr[p + 1]):
            q = r.near[i]
            if out[q] >= FOREVER:
                out[q] = out[p] + 1
                k.by_place[tail, QUEUE] = q
                tail += 1
    return row


@lean
def lift(ptr: I32, to: I32, place: I32, still: I32, start: int, places: I32, out: I32) -> None:
    """States of a way given by places: the motion that leads there, or standing."""
    s = start
    out[0] = s
    for t in range(1, len(places)):
        if places[t] == place[s]:
            s = still[s]
        else:
            for e in range(ptr[s], ptr[s + 1]):
                if place[to[e]] == places[t]:
                    s = to[e]
                    break
        out[t] = s


# --- constraints -----------------------------------------------------------------------------------------------------


@lean
def clear_constraints(k: Bans) -> None:
    """Forget all constraints."""
    stamp = k.con[STAMP]
    k.con[:] = 0
    k.con[STAMP], k.con[BY] = stamp + 1, FOREVER


@lean
def forbid(k: Bans, place: int, before: int, tick: int) -> None:
    """Not at this place at this tick, or, coming from the place `before` (the number of places: from anywhere)."""
    n = len(k.by_place)
    key = (np.int64(tick) * n + place) * (n + 1) + before
    bits = bits_of(len(k.key))
    stamp = k.con[STAMP]
    at = slot_at(key, bits)
    mask = len(k.key) - 1
    while k.stamp[at] == stamp:
        if k.key[at] == key:
            return
        at = (at + 1) & mask
    k.stamp[at] = stamp
    k.key[at] = key
    k.by_tick[tick, BANNED] = stamp
    k.con[LAST] = max(k.con[LAST], tick)


@lean
def forbid_place(k: Bans, place: int, tick: int, goal: int) -> None:
    """Not at this place at this tick."""
    forbid(k, place, np.int64(len(k.by_place)), tick)
    if place == goal:
        k.con[FREE_FROM] = max(k.con[FREE_FROM], tick + 1)


@lean_inline
def _forbidden(k: Bans, stamp: int, key: int, bits: int) -> bool:
    at = slot_at(key, bits)
    mask = len(k.key) - 1
    while k.stamp[at] == stamp:
        if k.key[at] == key:
            return True
        at = (at + 1) & mask
    return False


@lean
def close_place(k: Bans, place: int, tick: int) -> None:
    """Not at this place from this tick on."""
    stamp = k.con[STAMP]
    if k.by_place[place, CLOSED_STAMP] != stamp or k.by_place[place, CLOSED_AT] > tick:
        k.by_place[place, CLOSED_STAMP] = stamp
        k.by_place[place, CLOSED_AT] = tick
    k.con[CLOSED] = 1
    k.con[LAST] = max(k.con[LAST], tick)


@lean
def add_landmark(k: Bans, place: int, tick: int, goal: int, least: int, wait: int) -> bool:
    """At this place at this tick; `least` is the cost from there to the goal. False when it contradicts another."""
    stamp = k.con[STAMP]
    if k.by_tick[tick, MUST_STAMP] == stamp and k.by_tick[tick, MUST] != place:
        return False
    k.by_tick[tick, MUST_STAMP] = stamp
    k.by_tick[tick, MUST] = place
    k.con[MARKS] += 1
    k.con[LAST] = max(k.con[LAST], tick)
    if place != goal:
        k.con[FREE_FROM] = max(k.con[FREE_FROM], tick + 1)
        if tick >= k.con[BASE_AT]:  # past it, a motion may have cost more than its tick
            k.con[BASE_AT] = tick
            k.con[BASE] = tick * wait + least
    return True


@lean
def finish_constraints(k: Bans) -> None:
    """Note for every tick which landmark comes next; call after the last constraint."""
    k.con[LAST] = max(k.con[LAST], k.con[FREE_FROM])
    if k.con[MARKS] == 0:
        return
    place, at = -1, -1
    for t in range(k.con[LAST], -1, -1):
        if k.by_tick[t, MUST_STAMP] == k.con[STAMP]:
            place, at = k.by_tick[t, MUST], t
        k.by_tick[t, AHEAD_PLACE] = place
        k.by_tick[t, AHEAD_TICK] = at


@lean
def _tables(r: Roads, k: Bans, goal: int) -> int:
    """Make the tables of steps that the constraints ask for; the goal's row, or -1 when it isn't needed."""
    if k.con[MARKS] > 0:
        for t in range(k.con[LAST] + 1):
            if k.by_tick[t, MUST_STAMP] == k.con[STAMP]:
                steps_to(r, k, np.int64(k.by_tick[t, MUST]))
    return steps_to(r, k, goal) if k.con[BY] < FOREVER else np.int64(-1)


class Rules(NamedTuple):
    """What a search reads of the constraints at every step: slots of Bans.con, and two sizes."""

    stamp: int
    last: int
    marks: int
    closed: int
    by: int
    bits: int  # log2 of the slots for forbidden keys
    row: int  # steps to the goal, or -1


@lean
def _rules(r: Roads, k: Bans, goal: int) -> Rules:
    c = k.con
    return Rules(c[STAMP], c[LAST], c[MARKS], c[CLOSED], c[BY], bits_of(len(k.key)), _tables(r, k, goal))


@lean_inline
def _allowed(k: Bans, rule: Rules, u: int, v: int, t: int) -> bool:
    """Whether the constraints let one go from place u to place v, arriving at tick t."""
    if t <= rule.last:
        if k.by_tick[t, BANNED] == rule.stamp:
            n = len(k.by_place)
            key = (np.int64(t) * n + v) * (n + 1)
            if _forbidden(k, rule.stamp, key + n, rule.bits) or (
                u != v and _forbidden(k, rule.stamp, key + u, rule.bits)
            ):
                return False
        if rule.marks > 0 and k.by_tick[t, AHEAD_TICK] >= 0:
            gap = k.by_tick[t, AHEAD_TICK] - t
            if gap == 0:
                if v != k.by_tick[t, AHEAD_PLACE]:
                    return False
            else:
                far = k.by_place[k.by_tick[t, AHEAD_PLACE], ROW]
                if far >= 0 and k.steps[far, v] > gap:
                    return False
    if rule.closed == 1 and k.by_place[v, CLOSED_STAMP] == rule.stamp and t >= k.by_place[v, CLOSED_AT]:
        return False
    return rule.row < 0 or t + k.steps[rule.row, v] <= rule.by


# --- the others ------------------------------------------------------------------------------------------------------


@lean
def clear_others(o: Others) -> None:
    """Nobody else is on the floor."""
    o.num[THEY] += 1
    o.num[FILLED] = 0


@lean
def add_other(place: I32, o: Others, states: I32, first: int, length: int) -> bool:
    """Enter somebody's way (states[first : first + length + 1], then rest). False when the room is too short.

    place: of each state.
    """
    n = len(o.rest)
    stamp = o.num[THEY]
    fits = length + 1 < o.num[ROOM]
    last = length if fits else o.num[ROOM] - 1
    p = place[states[first]]
    for t in range(last):
        after = place[states[first + t + 1]]
        o.at[0, t * n + p] = stamp
        o.at[1, t * n + p] = after
        p = after
    if fits:
        if o.rest[p, 1] != stamp or o.rest[p, 0] > length:
            o.rest[p, 1] = stamp
            o.rest[p, 0] = length
        o.num[FILLED] = max(o.num[FILLED], length + 1)
    return fits


@lean_inline
def _meets(o: Others, they: int, filled: int, ticks: int, u: int, v: int, t: int) -> int:
    """How many others one meets going from place u at tick t to place v. they, filled, ticks: of o.num."""
    n = len(o.rest)
    met = np.int64(0)
    if o.rest[v, 1] == they and o.rest[v, 0] <= t + 1:
        met += 1
    if t < filled:
        if t + 1 < ticks and o.at[0, (t + 1) * n + v] == they:
            met += 1
        if u != v and o.at[0, t * n + v] == they and o.at[1, t * n + v] == u:
            met += 1
    return met


@lean
def _left(o: Others, goal: int) -> int:
    """Tick from which nobody else is at the goal any more; -1 when somebody rests there."""
    if o.rest[goal, 1] == o.num[THEY]:
        return -1
    n = len(o.rest)
    for t in range(o.num[FILLED] - 1, -1, -1):
        if o.at[0, t * n + goal] == o.num[THEY]:
            return t + 1
    return 0


# --- search ----------------------------------------------------------------------------------------------------------


@lean
def search(
    r: Roads, w: Work, h: I64, cls: int, start: int, goal: int, mode: int, bound: int, limit: int, out: I64
) -> int:
    """Cheapest way from a standing start to rest at the goal, under the loaded constraints.

    h: least cost to the goal by state · bound: dearer ways are not wanted · out[0] cost, out[1] ticks, out[2]
    expansions (added to); the states are left in w.path.
    """
    k, o, node, gs = w.bans, w.others, w.node, w.g
    wait, cost = r.wait[cls], r.cost[cls]
    free_from, base, base_at = k.con[FREE_FROM], k.con[BASE], k.con[BASE_AT]
    stop = k.con[LAST]
    if mode != TIES:
        stop = max(stop, o.num[FILLED])
    if mode == HARD:
        left = _left(o, goal)
        if left < 0:
            return NONE
        free_from = max(free_from, left)
    if stop + 2 >= len(k.by_tick):
        return FULL
    rule = _rules(r, k, goal)
    they, filled, ticks = o.num[THEY], o.num[FILLED], o.num[ROOM]
    bits = bits_of(len(w.slot_key))
    w.stamp[0] += 1
    stamp = w.stamp[0]
    room = min(len(node), len(w.slot_key) >> 1) - 16
    f = max(h[start], free_from * wait, base)
    if f >= FAR or f > bound or not _allowed(k, rule, r.place[start], r.place[start], np.int64(0)):
        return NONE
    node[0, STATE], node[0, TICK], node[0, MET], node[0, BEFORE] = start, 0, 0, -1
    gs[0] = 0
    count, size, done = 1, push(w.keys, w.items, 0, np.int64(0), np.int64(0)), 0
    at = _slot(w, np.int64(start) * (stop + 1), stamp, bits)
    w.slot[at, 0] = 0
    ended = NONE
    while size > 0:
        here = w.items[0]
        size = drop_first(w.keys, w.items, size)
        s, t, met, g = node[here, STATE], node[here, TICK], node[here, MET], gs[here]
        u = r.place[s]
        if u == goal and t >= free_from and t <= rule.by:
            out[0], out[1] = g, t
            while here >= 0:
                w.path[node[here, TICK]] = node[here, STATE]
                here = node[here, BEFORE]
            ended = FOUND
            break
        at = _slot(w, np.int64(s) * (stop + 1) + min(t, stop), stamp, bits)
        if w.slot[at, 0] != here:
            continue
        done += 1
        if done > limit:
            ended = SPENT
            break
        if count + (r.ptr[s + 1] - r.ptr[s]) + 1 > room or size + 64 >= len(w.keys) or t + 2 >= len(w.path):
            ended = FULL
            break
        t2 = t + 1
        owed = max(free_from * wait, base if t2 <= base_at else 0) - t2 * wait
        for e in range(r.ptr[s] - 1 if t < stop else r.ptr[s], r.ptr[s + 1]):
            if e < r.ptr[s]:
                s2, g2 = r.still[s], g + wait
            else:
                s2, g2 = r.to[e], g + cost[r.kind[e]]
            f = g2 + max(h[s2], owed)
            if h[s2] >= FAR or f > bound:
                continue
            v = r.place[s2]
            if not _allowed(k, rule, u, v, np.int64(t2)):
                continue
            more = _meets(o, they, filled, ticks, u, v, np.int64(t))
            if mode == HARD and more > 0:
                continue
            met2 = met + more
            at = _slot(w, np.int64(s2) * (stop + 1) + min(t2, stop), stamp, bits)
            old = w.slot[at, 0]
            if old >= 0:
                met1, g1 = node[old, MET], gs[old]
                if mode == FEW:
                    if met1 < met2 or (met1 == met2 and g1 <= g2):
                        continue
                elif g1 < g2 or (g1 == g2 and met1 <= met2):
                    continue
            w.slot[at, 0] = count
            node[count, STATE], node[count, TICK], node[count, MET], node[count, BEFORE] = s2, t2, met2, here
            gs[count] = g2
            late, few = 4095 - min(t2, 4095), np.int64(min(met2, 511))
            rank = (few << 53) | (f << 12) | late if mode == FEW else (f << 21) | (few << 12) | late
            size = push(w.keys, w.items, size, rank, count)
            count += 1
    out[2] += done
    return ended


@lean_inline
def _slot(w: Work, key: int, stamp: int, bits: int) -> int:
    """Where the best node of a key is kept; a new slot holds node -1."""
    at = slot_at(key, bits)
    mask = len(w.slot_key) - 1
    while w.slot[at, 1] == stamp and w.slot_key[at] != key:
        at = (at + 1) & mask
    if w.slot[at, 1] != stamp:
        w.slot[at, 1], w.slot_key[at], w.slot[at, 0] = stamp, key, -1
    return at


# --- all cheapest ways ------------------------------------------------------------------------------------------------


@lean
def build_layers(r: Roads, k: Bans, m: Layers, h: I64, cls: int, start: int, goal: int, cap: int, exact: bool) -> bool:
    """Every way within a cost under the loaded constraints. exact: only ways of that very cost. False: no room."""
    wait = r.wait[cls]
    free_from, by, base, base_at = k.con[FREE_FROM], k.con[BY], k.con[BASE], k.con[BASE_AT]
    rule = _rules(r, k, goal)
    bits = bits_of(len(m.slot_key))
    mask = len(m.slot_key) - 1
    m.size[1] += 1
    stamp = m.size[1]
    room = min(len(m.state), len(m.slot_key) >> 1) - 16
    m.state[0], m.tick[0], m.g[0] = start, 0, 0
    count, edges, at_node = 1, 0, 0
    while at_node < count:
        s, t, g = m.state[at_node], m.tick[at_node], m.g[at_node]
        u = r.place[s]
        m.alive[at_node] = 0
        m.ends[at_node] = u == goal and t >= free_from and t <= by and (g == cap or not exact)
        m.ptr[at_node] = edges
        if count + (r.ptr[s + 1] - r.ptr[s]) + 1 > room or edges + 64 > len(m.to):
            return False
        owed = max(free_from * wait, base if t < base_at else 0) - (t + 1) * wait
        for e in range(r.ptr[s] - 1, r.ptr[s + 1]):
            if e < r.ptr[s]:
                s2, c = r.still[s], wait
            else:
                s2, c = r.to[e], r.cost[cls, r.kind[e]]
            g2 = g + c
            if h[s2] >= FAR or g2 + max(h[s2], owed) > cap:
                continue
            if not _allowed(k, rule, u, r.place[s2], np.int64(t) + 1):
                continue
            key = np.int64(t + 1) * len(r.place) + s2
            at = slot_at(key, bits)
            while m.slot_stamp[at] == stamp and m.slot_key[at] != key:
                at = (at + 1) & mask
            if m.slot_stamp[at] != stamp:
                m.slot_stamp[at], m.slot_key[at], m.slot_node[at] = stamp, key, count
                m.state[count], m.tick[count], m.g[count] = s2, t + 1, g2
                count += 1
            to = m.slot_node[at]
            m.g[to] = min(m.g[to], g2)
            m.to[edges], m.cost[edges] = to, c
            edges += 1
        at_node += 1
    m.ptr[count] = edges
    # from the end: keep what still reaches an end
    last, first_end = 0, FOREVER
    for i in range(count - 1, -1, -1):
        good = m.ends[i] == 1
        if good:
            first_end = min(first_end, m.tick[i])
        for e in range(m.ptr[i], m.ptr[i + 1]):
            to = m.to[e]
            if m.alive[to] and (not exact or m.g[to] == m.g[i] + m.cost[e]):
                good = True
            else:
                m.to[e] = -1
        if good:
            m.alive[i] = 1
            last = max(last, m.tick[i])
    m.size[0], m.size[2], m.size[3] = count, last, first_end
    return True


@lean
def mark_single(r: Roads, m: Layers, goal: int, out: I8, first: int, length: int) -> None:
    """out[first + t] = 1 where all ways are at one place at tick t ≤ length; resting at the goal counts as there."""
    count = m.size[0]
    k = 0
    for t in range(length + 1):
        place, one = -1, 1
        if t >= m.size[3]:
            place = goal
        while k < count and m.tick[k] == t:
            if m.alive[k]:
                p = r.place[m.state[k]]
                if place < 0:
                    place = p
                elif place != p:
                    one = 0
            k += 1
        out[first + t] = one
