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
"""Slots of Work.con: last tick at which a constraint acts · earliest tick of the last arrival · latest · number of
landmarks · cost that the last one proves until its tick, counted from tick 0 · current stamp · 1 with places closed
for good · that tick."""


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


class Work(NamedTuple):
    """Reusable space of one search. Stamps stand for clearing."""

    state: I32  # nodes
    tick: I32
    g: I64
    met: I32
    parent: I32
    keys: I64  # heap
    items: I32
    slot_key: I64  # best node by (state, tick)
    slot_node: I32
    slot_stamp: I32
    con: I64
    stamp: I64  # counters of stamps: search, others
    con_key: I64  # forbidden places and motions by tick
    con_stamp: I32
    con_tick: I32  # (T,) stamp of ticks at which any is forbidden
    must: I32  # (T,) place to be in
    must_stamp: I32
    ahead_tick: I32  # (T,) next landmark
    ahead_place: I32
    closed: I32  # (P,) tick from which a place is closed for good
    closed_stamp: I32
    others: I32  # (T·P,) stamp: somebody is here
    others_next: I32  # and goes there
    others_len: I64  # ticks filled, ticks of room
    rest: I32  # (P,) tick from which somebody rests here
    rest_stamp: I32
    path: I32  # states of the way found
    row_of: I32  # (P,) row of `steps`, or -1
    steps: I32  # (R, P) least ticks to a place
    rows: I64
    queue: I32  # (P,)


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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def steps_to(r: Roads, w: Work, place: int) -> int:
    """Row of w.steps with the least ticks to a place, blocks ignored; -1 when there is no room."""
    row = w.row_of[place]
    if row >= 0:
        return row
    row = w.rows[0]
    if row >= w.steps.shape[0]:
        return -1
    w.rows[0] = row + 1
    w.row_of[place] = row
    out = w.steps[row]
    out[:] = FOREVER
    out[place] = 0
    w.queue[0] = place
    head, tail = 0, 1
    while head < tail:
        p = w.queue[head]
        head += 1
        for k in range(r.near_ptr[p], r.near_ptr[p + 1]):
            q = r.near[k]
            if out[q] >= FOREVER:
                out[q] = out[p] + 1
                w.queue[tail] = q
                tail += 1
    return row


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def clear_constraints(w: Work) -> None:
    """Forget all constraints."""
    w.con[STAMP] += 1
    w.con[LAST] = 0
    w.con[FREE_FROM] = 0
    w.con[BY] = FOREVER
    w.con[MARKS] = 0
    w.con[BASE] = 0
    w.con[BASE_AT] = 0
    w.con[CLOSED] = 0


@njit(cache=True, nogil=True)
def _forbid(w: Work, key: int, tick: int) -> None:
    """Forbid a key that acts at the end of the step into `tick`."""
    bits = bits_of(len(w.con_key))
    stamp = w.con[STAMP]
    at = slot_at(key, bits)
    mask = len(w.con_key) - 1
    while w.con_stamp[at] == stamp:
        if w.con_key[at] == key:
            return
        at = (at + 1) & mask
    w.con_stamp[at] = stamp
    w.con_key[at] = key
    w.con_tick[tick] = stamp
    w.con[LAST] = max(w.con[LAST], tick)


@njit(cache=True, nogil=True)
def forbid_place(r: Roads, w: Work, place: int, tick: int, goal: int) -> None:
    """Not at this place at this tick."""
    n = len(r.place_ptr) - 1
    _forbid(w, np.int64(tick) * (n + 1) * n + np.int64(place) * (n + 1) + n, tick)
    if place == goal:
        w.con[FREE_FROM] = max(w.con[FREE_FROM], tick + 1)


@njit(cache=True, nogil=True)
def forbid_move(r: Roads, w: Work, place: int, place2: int, tick: int) -> None:
    """Not from a place to another, leaving at this tick."""
    n = len(r.place_ptr) - 1
    _forbid(w, np.int64(tick + 1) * (n + 1) * n + np.int64(place2) * (n + 1) + place, tick + 1)


@njit(cache=True, nogil=True)
def _forbidden(con_key: I64, con_stamp: I32, stamp: int, key: int, bits: int) -> bool:
    at = slot_at(key, bits)
    mask = len(con_key) - 1
    while con_stamp[at] == stamp:
        if con_key[at] == key:
            return True
        at = (at + 1) & mask
    return False


@njit(cache=True, nogil=True)
def close_place(w: Work, place: int, tick: int) -> None:
    """Not at this place from this tick on."""
    stamp = w.con[STAMP]
    if w.closed_stamp[place] != stamp or w.closed[place] > tick:
        w.closed_stamp[place] = stamp
        w.closed[place] = tick
    w.con[CLOSED] = 1
    w.con[LAST] = max(w.con[LAST], tick)


@njit(cache=True, nogil=True)
def add_landmark(w: Work, place: int, tick: int, goal: int, least: int, wait: int) -> bool:
    """At this place at this tick; `least` is the cost from there to the goal. False when it contradicts another."""
    stamp = w.con[STAMP]
    if w.must_stamp[tick] == stamp and w.must[tick] != place:
        return False
    w.must_stamp[tick] = stamp
    w.must[tick] = place
    w.con[MARKS] += 1
    w.con[LAST] = max(w.con[LAST], tick)
    if place != goal:
        w.con[FREE_FROM] = max(w.con[FREE_FROM], tick + 1)
        if tick >= w.con[BASE_AT]:  # past it, a motion may have cost more than its tick
            w.con[BASE_AT] = tick
            w.con[BASE] = tick * wait + least
    return True


@njit(cache=True, nogil=True)
def finish_constraints(w: Work) -> None:
    """Note for every tick which landmark comes next; call after the last constraint."""
    w.con[LAST] = max(w.con[LAST], w.con[FREE_FROM])
    if w.con[MARKS] == 0:
        return
    stamp = w.con[STAMP]
    place, at = -1, -1
    for t in range(w.con[LAST], -1, -1):
        if w.must_stamp[t] == stamp:
            place, at = w.must[t], t
        w.ahead_place[t] = place
        w.ahead_tick[t] = at


# --- the others ------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def clear_others(w: Work) -> None:
    """Nobody else is on the floor."""
    w.stamp[1] += 1
    w.others_len[0] = 0


@njit(cache=True, nogil=True)
def add_other(r: Roads, w: Work, states: I32, first: int, length: int) -> bool:
    """Enter somebody's way (states[first : first + length + 1], then rest). False when the room is too short."""
    n = len(r.place_ptr) - 1
    stamp = w.stamp[1]
    fits = length + 1 < w.others_len[1]
    last = length if fits else w.others_len[1] - 1
    place = r.place[states[first]]
    for t in range(last):
        after = r.place[states[first + t + 1]]
        w.others[t * n + place] = stamp
        w.others_next[t * n + place] = after
        place = after
    if fits:
        if w.rest_stamp[place] != stamp or w.rest[place] > length:
            w.rest_stamp[place] = stamp
            w.rest[place] = length
        w.others_len[0] = max(w.others_len[0], length + 1)
    return fits


@njit(cache=True, nogil=True, inline="always")
def _meets(others, others_next, rest, rest_stamp, stamp, filled, room, n, u, v, t):  # type: ignore[no-untyped-def]
    """How many others one meets going from place u at tick t to place v."""
    met = 0
    if rest_stamp[v] == stamp and rest[v] <= t + 1:
        met += 1
    if t < filled:
        if t + 1 < room and others[(t + 1) * n + v] == stamp:
            met += 1
        if u != v and others[t * n + v] == stamp and others_next[t * n + v] == u:
            met += 1
    return met


# --- search ----------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, inline="always")
def _allowed(  # type: ignore[no-untyped-def]
    con, con_key, con_stamp, con_tick, ahead_tick, ahead_place, row_of, steps, closed, closed_stamp, n, u, v, t, bits,
    row,
):  # fmt: skip
    """Whether the constraints let one go from place u to place v, arriving at tick t."""
    stamp = con[STAMP]
    good = True
    if t <= con[LAST]:
        if con_tick[t] == stamp:
            key = np.int64(t) * (n + 1) * n + np.int64(v) * (n + 1)
            if _forbidden(con_key, con_stamp, stamp, key + n, bits) or (
                u != v and _forbidden(con_key, con_stamp, stamp, key + u, bits)
            ):
                good = False
        if con[MARKS] > 0 and ahead_tick[t] >= 0:
            gap = ahead_tick[t] - t
            if gap == 0:
                if v != ahead_place[t]:
                    good = False
            else:
                far = row_of[ahead_place[t]]
                if far >= 0 and steps[far, v] > gap:
                    good = False
    if con[CLOSED] == 1 and closed_stamp[v] == stamp and t >= closed[v]:
        good = False
    if row >= 0 and t + steps[row, v] > con[BY]:
        good = False
    return good


@njit(cache=True, nogil=True)
def search(
    r: Roads, w: Work, h: I64, cls: int, start: int, goal: int, mode: int, bound: int, limit: int, out: I64
) -> int:
    """Cheapest way from a standing start to rest at the goal, under the loaded constraints.

    h: least cost to the goal by state · bound: dearer ways are not wanted · out[0] cost, out[1] ticks, out[2]
    expansions (added to); the states are left in w.path.
    """
    n = len(r.place_ptr) - 1
    wait = r.wait[cls]
    con, con_key, con_stamp, con_tick = w.con, w.con_key, w.con_stamp, w.con_tick
    ahead_tick, ahead_place, row_of, steps = w.ahead_tick, w.ahead_place, w.row_of, w.steps
    closed, closed_stamp = w.closed, w.closed_stamp
    others, others_next, rest, rest_stamp = w.others, w.others_next, w.rest, w.rest_stamp
    they, filled, ticks = w.stamp[1], w.others_len[0], w.others_len[1]
    ptr, to, kind, place, still = r.ptr, r.to, r.kind, r.place, r.still
    cost = r.cost[cls]
    state, tick, gs, mets, parent, keys, items = w.state, w.tick, w.g, w.met, w.parent, w.keys, w.items
    slot_key, slot_node, slot_stamp = w.slot_key, w.slot_node, w.slot_stamp
    stop = w.con[LAST]
    if mode != TIES:
        stop = max(stop, w.others_len[0])
    free_from, by, base, base_at = w.con[FREE_FROM], w.con[BY], w.con[BASE], w.con[BASE_AT]
    goal_stamp = w.stamp[1]
    if mode == HARD:
        if w.rest_stamp[goal] == goal_stamp:
            return NONE
        for t in range(w.others_len[0] - 1, -1, -1):
            if w.others[t * n + goal] == goal_stamp:
                free_from = max(free_from, t + 1)
                break
    if stop + 2 >= len(w.con_tick):
        return FULL
    row = -1
    if by < FOREVER:
        row = steps_to(r, w, goal)
    if w.con[MARKS] > 0:
        for t in range(w.con[LAST] + 1):
            if w.must_stamp[t] == w.con[STAMP]:
                steps_to(r, w, w.must[t])
    con_bits = bits_of(len(w.con_key))
    bits = bits_of(len(slot_key))
    mask = len(slot_key) - 1
    w.stamp[0] += 1
    stamp = w.stamp[0]
    room = min(len(state), len(slot_key) >> 1) - 16
    f = max(h[start], free_from * wait, base)
    if (
        f >= FAR
        or f > bound
        or not _allowed(
            con,
            con_key,
            con_stamp,
            con_tick,
            ahead_tick,
            ahead_place,
            row_of,
            steps,
            closed,
            closed_stamp,
            n,
            place[start],
            place[start],
            0,
            con_bits,
            row,
        )
    ):
        return NONE
    state[0], tick[0], gs[0], mets[0], parent[0] = start, 0, 0, 0, -1
    count, size, done = 1, 0, 0
    size = push(keys, items, size, 0, 0)
    key = np.int64(start) * (stop + 1)
    at = slot_at(key, bits)
    slot_stamp[at], slot_key[at], slot_node[at] = stamp, key, 0
    while size > 0:
        node = items[0]
        size = drop_first(keys, items, size)
        s, t, g, met = state[node], tick[node], gs[node], mets[node]
        u = place[s]
        if u == goal and t >= free_from and t <= by:
            out[0], out[1] = g, t
            out[2] += done
            k = node
            while k >= 0:
                w.path[tick[k]] = state[k]
                k = parent[k]
            return FOUND
        key = np.int64(s) * (stop + 1) + min(t, stop)
        at = slot_at(key, bits)
        while slot_key[at] != key or slot_stamp[at] != stamp:
            at = (at + 1) & mask
        if slot_node[at] != node:
            continue
        done += 1
        if done > limit:
            out[2] += done
            return SPENT
        if count + (ptr[s + 1] - ptr[s]) + 1 > room or size + 64 >= len(keys) or t + 2 >= len(w.path):
            out[2] += done
            return FULL
        t2 = t + 1
        first = ptr[s] - 1 if t < stop else ptr[s]
        for e in range(first, ptr[s + 1]):
            if e < ptr[s]:
                s2 = still[s]
                g2 = g + wait
            else:
                s2 = to[e]
                g2 = g + cost[kind[e]]
            if h[s2] >= FAR:
                continue
            f = g2 + max(h[s2], max(free_from * wait, base if t2 <= base_at else 0) - t2 * wait)
            if f > bound:
                continue
            v = place[s2]
            if not _allowed(
                con,
                con_key,
                con_stamp,
                con_tick,
                ahead_tick,
                ahead_place,
                row_of,
                steps,
                closed,
                closed_stamp,
                n,
                u,
                v,
                t2,
                con_bits,
                row,
            ):
                continue
            more = _meets(others, others_next, rest, rest_stamp, they, filled, ticks, n, u, v, t)
            if mode == HARD and more > 0:
                continue
            met2 = met + more
            key = np.int64(s2) * (stop + 1) + min(t2, stop)
            at = slot_at(key, bits)
            while slot_stamp[at] == stamp and slot_key[at] != key:
                at = (at + 1) & mask
            if slot_stamp[at] == stamp:
                old = slot_node[at]
                if mode == FEW:
                    if mets[old] < met2 or (mets[old] == met2 and gs[old] <= g2):
                        continue
                elif gs[old] < g2 or (gs[old] == g2 and mets[old] <= met2):
                    continue
            slot_stamp[at], slot_key[at], slot_node[at] = stamp, key, count
            state[count], tick[count], gs[count], mets[count], parent[count] = s2, t2, g2, met2, node
            late = 4095 - min(t2, 4095)
            few = min(met2, 511)
            if mode == FEW:
                rank = (np.int64(few) << 53) | (f << 12) | late
            else:
                rank = (f << 21) | (np.int64(few) << 12) | late
            size = push(keys, items, size, rank, count)
            count += 1
    out[2] += done
    return NONE


# --- all cheapest ways ------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def build_layers(r: Roads, w: Work, m: Layers, h: I64, cls: int, start: int, goal: int, cap: int, exact: bool) -> bool:
    """Every way within a cost under the loaded constraints. exact: only ways of that very cost. False: no room."""
    n = len(r.place_ptr) - 1
    wait = r.wait[cls]
    con, con_key, con_stamp, con_tick = w.con, w.con_key, w.con_stamp, w.con_tick
    ahead_tick, ahead_place, row_of, steps = w.ahead_tick, w.ahead_place, w.row_of, w.steps
    closed, closed_stamp = w.closed, w.closed_stamp
    free_from, by, base, base_at = w.con[FREE_FROM], w.con[BY], w.con[BASE], w.con[BASE_AT]
    row = -1
    if by < FOREVER:
        row = steps_to(r, w, goal)
    if w.con[MARKS] > 0:
        for t in range(w.con[LAST] + 1):
            if w.must_stamp[t] == w.con[STAMP]:
                steps_to(r, w, w.must[t])
    con_bits = bits_of(len(w.con_key))
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
        for e in range(r.ptr[s] - 1, r.ptr[s + 1]):
            if e < r.ptr[s]:
                s2 = r.still[s]
                c = wait
            else:
                s2 = r.to[e]
                c = r.cost[cls, r.kind[e]]
            if h[s2] >= FAR:
                continue
            g2 = g + c
            if g2 + max(h[s2], max(free_from * wait, base if t < base_at else 0) - (t + 1) * wait) > cap:
                continue
            if not _allowed(
                con,
                con_key,
                con_stamp,
                con_tick,
                ahead_tick,
                ahead_place,
                row_of,
                steps,
                closed,
                closed_stamp,
                n,
                u,
                r.place[s2],
                t + 1,
                con_bits,
                row,
            ):
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
    for k in range(count - 1, -1, -1):
        good = m.ends[k] == 1
        if good:
            first_end = min(first_end, m.tick[k])
        for e in range(m.ptr[k], m.ptr[k + 1]):
            to = m.to[e]
            if m.alive[to] and (not exact or m.g[to] == m.g[k] + m.cost[e]):
                good = True
            else:
                m.to[e] = -1
        if good:
            m.alive[k] = 1
            last = max(last, m.tick[k])
    m.size[0], m.size[2], m.size[3] = count, last, first_end
    return True


@njit(cache=True, nogil=True)
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
