"""Safe-interval path planning through a chain of goals over a motion graph with reservations.

Source: Phillips & Likhachev 2011 (SIPP), extended to motions of any duration, to both occupancy rules, to a chain of
goals with a stay at each (the last stay is forever), and to energy. A label is (state, free interval, goals reached).
`time`: earliest arrival dominates, ties by energy; complete, optimal in time. `energy`: a label that arrives earlier
does not dominate, for waiting costs standby and a restart; Pareto labels, standing labels depart at every tick while
anything ahead can still change; ties by arrival. Complete, optimal in energy, then in time. Cost: a heap operation per
label and motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.planners.kernels.heap import drop_first, push
from engine.planners.kernels.tables import ENERGY, FAR, TICK
from engine.traffic import HORIZON, STAY, Claims, Ground, departure, gap_end
from engine.types import FOREVER

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

SOLVED, NO_PATH, BUDGET, FULL = 0, 1, 2, 3
MAX_LEGS = 255
"""A chain has at most so many goals."""


class Work(NamedTuple):
    """Reusable search space: nodes of the search tree, best labels by key, heap. `stamp` marks the current search."""

    state: I32
    gap: I32
    leg: I32
    tick: I32
    energy: I64
    parent: I32
    edge: I32
    depart: I32
    chain: I32  # next node of the same label (energy search)
    waited: I32  # how long a node's label has stood by the time it is next expanded (energy search)
    rest: I64  # cost from reaching goal i to the end, along the goals
    best: I64
    seen: I32
    stamp: I64
    keys: I64
    items: I32


def new_work(nodes: int, labels: int) -> Work:
    """Search space for so many nodes and label keys."""

    def i32(n: int) -> I32:
        return np.zeros(n, np.int32)

    return Work(
        i32(nodes), i32(nodes), i32(nodes), i32(nodes), np.zeros(nodes, np.int64), i32(nodes), i32(nodes), i32(nodes),
        i32(nodes), i32(nodes), np.zeros(MAX_LEGS + 1, np.int64), np.zeros(labels, np.int64), i32(labels),
        np.zeros(1, np.int64), np.zeros(2 * nodes, np.int64), i32(2 * nodes),
    )  # fmt: skip


@lean
def a_goal_is_taken(c: Claims, goals: I32, tick: int) -> bool:
    """True when somebody comes to stay in the last goal with no end known, or stays so in another one by a tick."""
    for i in range(len(goals)):
        slot = goals[i]
        while c.next[slot] >= 0:
            slot = c.next[slot]
        if c.end[slot] >= FOREVER and (i == len(goals) - 1 or c.start[slot] <= tick):
            return True
    return False


@lean
def label_key(g: Ground, gap: int, leg: int, n_legs: int, s: int) -> int:
    """Where the label of a free interval, a leg and a state is kept: the states of a place side by side."""
    first = g.place_ptr[g.state_place[s]]
    return (gap * n_legs + leg) * (g.place_ptr[1] - g.place_ptr[0]) + s - first


@lean
def weighted(h: int, eighths: int) -> int:
    """A cost to go times a weight."""
    return h if eighths == 8 else h // 8 * eighths


@lean
def search_time(
    c: Claims, g: Ground, w: Work, hold: bool, margin: int, start: int, start_gap: int, t0: int,
    goals: I32, stays: I32, pool: I64, slots: I32, shift: int, kind_mj: I64, standby: int, eighths: int, limit: int,
    out: I64,
) -> int:  # fmt: skip
    """Earliest arrival through all goals. kind_mj: (legs, K) energy by leg; out[0] last node, out[1] expansions.

    eighths: weight of the cost to go in eighths; above 8 the plan is found sooner, and takes at most so much longer.
    """
    n_legs = len(goals)
    w.stamp[0] += 1
    stamp = w.stamp[0]
    rest = w.rest
    rest[n_legs - 1] = rest[n_legs] = 0
    for i in range(n_legs - 2, -1, -1):
        least = FAR
        for s in range(g.place_ptr[goals[i]], g.place_ptr[goals[i] + 1]):
            least = min(least, pool[slots[i + 1], s >> shift])
        if least >= FAR:
            return NO_PATH
        rest[i] = rest[i + 1] + least + (np.int64(stays[i]) << TICK) + np.int64(stays[i]) * standby
    first = pool[slots[0], start >> shift]
    if first >= FAR:
        return NO_PATH
    n, size, expanded = 1, 0, 0
    w.state[0], w.gap[0], w.leg[0], w.tick[0], w.energy[0] = start, start_gap, 0, t0, 0
    w.parent[0], w.edge[0], w.depart[0] = -1, -1, t0
    size = push(w.keys, w.items, size, weighted(first + rest[0], eighths), 0)
    key = label_key(g, start_gap, 0, n_legs, start)
    w.best[key], w.seen[key] = 0, stamp
    while size > 0:
        node = w.items[0]
        size = drop_first(w.keys, w.items, size)
        s, gap, leg, t, mj = w.state[node], w.gap[node], w.leg[node], w.tick[node], w.energy[node]
        if leg == n_legs:
            out[0], out[1] = node, expanded
            return SOLVED
        u = g.state_place[s]
        key = label_key(g, gap, leg, n_legs, s)
        if ((np.int64(t) - t0) << TICK) + mj > w.best[key]:
            continue
        expanded += 1
        if expanded > limit:
            out[1] = expanded
            return BUDGET
        until = gap_end(c, gap)
        if n + 64 >= len(w.state) or size + 64 >= len(w.keys):
            return FULL
        if u == goals[leg]:
            last = leg == n_legs - 1
            t2 = t + stays[leg]
            if (last and until >= FOREVER) or (not last and t2 + margin < until):
                s2 = s if stays[leg] == 0 else s & ~1
                spent = mj + np.int64(stays[leg]) * standby
                value = ((np.int64(t2) - t0) << TICK) + spent
                fresh = True
                if not last:
                    key = label_key(g, gap, leg + 1, n_legs, s2)
                    fresh = w.seen[key] != stamp or value < w.best[key]
                    if fresh:
                        w.best[key], w.seen[key] = value, stamp
                if fresh:
                    h = np.int64(0) if last else pool[slots[leg + 1], s2 >> shift] + rest[leg + 1]
                    w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, gap, leg + 1, t2, spent
                    w.parent[n], w.edge[n], w.depart[n] = node, STAY, t
                    size = push(w.keys, w.items, size, value + weighted(h, eighths), n)
                    n += 1
        for e0 in range(g.edge_ptr[s], g.edge_ptr[s + 1]):
            v = g.state_place[g.edge_to[e0]]
            if v == u:
                ticks = g.kind_ticks[g.edge_kind[e0]]
                if t + ticks + margin > until:
                    continue
                s2, t2 = g.edge_to[e0], t + ticks
                spent = mj + kind_mj[leg, g.edge_kind[e0]] + np.int64(ticks) * standby
                h = pool[slots[leg], s2 >> shift]
                value = ((np.int64(t2) - t0) << TICK) + spent
                key = label_key(g, gap, leg, n_legs, s2)
                if h < FAR and (w.seen[key] != stamp or value < w.best[key]):
                    w.best[key], w.seen[key] = value, stamp
                    w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, gap, leg, t2, spent
                    w.parent[n], w.edge[n], w.depart[n] = node, e0, t
                    size = push(w.keys, w.items, size, value + weighted(h + rest[leg], eighths), n)
                    n += 1
                continue
            if g.blocked[v]:
                continue
            into = v
            while into >= 0 and c.end[into] <= until:
                e = e0
                begin = departure(c, g, hold, margin, e, u, v, into, t, until)
                if begin > t and s & 1 and begin < FOREVER:
                    # it stands before it goes: the motion starts from rest
                    e = g.edge_twin[e0]
                    begin = departure(c, g, hold, margin, e, u, v, into, t + 1, until)
                if begin < t0 + HORIZON:
                    kind = g.edge_kind[e]
                    s2, t2 = g.edge_to[e], begin + g.kind_ticks[kind]
                    spent = mj + kind_mj[leg, kind] + np.int64(t2 - t) * standby
                    h = pool[slots[leg], s2 >> shift]
                    value = ((np.int64(t2) - t0) << TICK) + spent
                    key = label_key(g, into, leg, n_legs, s2)
                    if h < FAR and (w.seen[key] != stamp or value < w.best[key]):
                        if n + 4 >= len(w.state) or size + 4 >= len(w.keys):
                            return FULL
                        w.best[key], w.seen[key] = value, stamp
                        w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, into, leg, t2, spent
                        w.parent[n], w.edge[n], w.depart[n] = node, e, begin
                        size = push(w.keys, w.items, size, value + weighted(h + rest[leg], eighths), n)
                        n += 1
                into = c.next[into]
    out[1] = expanded
    return NO_PATH


@lean
def dominated(
    w: Work, key: int, stamp: int, t: int, mj: int, moving: bool, standby: int, restart: int, calm: int
) -> bool:  # fmt: skip
    """True when a label at this key can do all that a new one at (t, mJ) can, at no more energy and then no later."""
    if w.seen[key] != stamp:
        return False
    at = w.best[key]
    while at >= 0:
        # nothing changes after `calm`: whoever is there by then has no reason to wait on
        wait = min(t, calm) - min(w.tick[at], calm)
        if wait >= 0:
            reach = w.energy[at] + np.int64(wait) * standby
            if moving and wait > 0:
                reach += restart
            if reach < mj or (reach == mj and w.tick[at] <= t):
                return True
        at = w.chain[at]
    return False


@lean
def worth(mj: int, ticks: int) -> int:
    """Energy and time packed so that time breaks ties in energy."""
    return (np.int64(mj) << ENERGY) + ticks


@lean
def add_label(w: Work, n: int, key: int, stamp: int) -> None:
    """Append node n to the labels of a key."""
    w.chain[n] = w.best[key] if w.seen[key] == stamp else -1
    w.best[key], w.seen[key] = n, stamp


@lean
def search_energy(
    c: Claims, g: Ground, w: Work, hold: bool, margin: int, start: int, start_gap: int, t0: int,
    goals: I32, stays: I32, pool: I64, slots: I32, kind_mj: I64, standby: int, restart: int, calm: int, limit: int,
    out: I64,
) -> int:  # fmt: skip
    """Least energy through all goals, the earliest among equals. calm: tick after which no claim starts or ends
    · restart: most a stop can cost · pool: backward tables of packed (mJ, ticks).

    A standing label in the heap stands for departing exactly at its present tick; popped, it moves on by one tick.
    Its node keeps the tick at which it came to stand; the heap item's tick is tick[node] + waited.
    """
    n_legs = len(goals)
    w.stamp[0] += 1
    stamp = w.stamp[0]
    rest = w.rest
    rest[n_legs - 1] = rest[n_legs] = 0
    for i in range(n_legs - 2, -1, -1):
        least = FAR
        for s in range(g.place_ptr[goals[i]], g.place_ptr[goals[i] + 1]):
            least = min(least, pool[slots[i + 1], s])
        if least >= FAR:
            return NO_PATH
        rest[i] = rest[i + 1] + least + ((np.int64(stays[i]) * standby) << ENERGY) + stays[i]
    if pool[slots[0], start] >= FAR:
        return NO_PATH
    waited = w.waited
    waited[0] = 0
    n, size, expanded = 1, 0, 0
    w.state[0], w.gap[0], w.leg[0], w.tick[0], w.energy[0] = start, start_gap, 0, t0, 0
    w.parent[0], w.edge[0], w.depart[0] = -1, -1, t0
    size = push(w.keys, w.items, size, pool[slots[0], start] + rest[0], 0)
    add_label(w, 0, label_key(g, start_gap, 0, n_legs, start), stamp)
    while size > 0:
        node = w.items[0]
        f = w.keys[0]
        size = drop_first(w.keys, w.items, size)
        s, gap, leg = w.state[node], w.gap[node], w.leg[node]
        t, mj = w.tick[node] + waited[node], w.energy[node] + np.int64(waited[node]) * standby
        if leg == n_legs:
            out[0], out[1] = node, expanded
            return SOLVED
        expanded += 1
        if expanded > limit:
            out[1] = expanded
            return BUDGET
        if n + 128 >= len(w.state) or size + 128 >= len(w.keys):
            return FULL
        u = g.state_place[s]
        until = gap_end(c, gap)
        if u == goals[leg]:
            last = leg == n_legs - 1
            t2 = t + stays[leg]
            if (last and until >= FOREVER) or (not last and t2 + margin < until):
                s2 = s if stays[leg] == 0 else s & ~1
                spent = mj + np.int64(stays[leg]) * standby
                key = label_key(g, gap, leg + 1, n_legs, s2)
                if last or not dominated(w, key, stamp, t2, spent, s2 & 1 == 1, standby, restart, calm):
                    h = np.int64(0) if last else pool[slots[leg + 1], s2] + rest[leg + 1]
                    w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, gap, leg + 1, t2, spent
                    w.parent[n], w.edge[n], w.depart[n] = node, STAY, t
                    waited[n] = 0
                    if not last:
                        add_label(w, n, key, stamp)
                    size = push(w.keys, w.items, size, worth(spent, t2 - t0) + h, n)
                    n += 1
        for e in range(g.edge_ptr[s], g.edge_ptr[s + 1]):
            kind = g.edge_kind[e]
            ticks = g.kind_ticks[kind]
            s2, t2 = g.edge_to[e], t + ticks
            v = g.state_place[s2]
            into = gap
            if v == u:
                if t2 + margin > until:
                    continue
            else:
                if g.blocked[v]:
                    continue
                into = v
                while into >= 0 and departure(c, g, hold, margin, e, u, v, into, t, until) != t:
                    into = c.next[into]
                if into < 0:
                    continue
            spent = mj + kind_mj[leg, kind] + np.int64(ticks) * standby
            h = pool[slots[leg], s2]
            if h >= FAR:
                continue
            key = label_key(g, into, leg, n_legs, s2)
            if dominated(w, key, stamp, t2, spent, s2 & 1 == 1, standby, restart, calm):
                continue
            w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, into, leg, t2, spent
            w.parent[n], w.edge[n], w.depart[n] = node, e, t
            waited[n] = 0
            add_label(w, n, key, stamp)
            size = push(w.keys, w.items, size, worth(spent, t2 - t0) + h + rest[leg], n)
            n += 1
        if t + 1 + margin < until and t < calm:
            if s & 1 == 0:
                waited[node] += 1
                size = push(w.keys, w.items, size, f + worth(standby, 1), node)
            else:
                # it comes to stand: a label of its own, one tick on
                s2 = s & ~1
                spent = mj + standby
                key = label_key(g, gap, leg, n_legs, s2)
                if not dominated(w, key, stamp, t + 1, spent, False, standby, restart, calm):
                    w.state[n], w.gap[n], w.leg[n], w.tick[n], w.energy[n] = s2, gap, leg, t + 1, spent
                    w.parent[n], w.edge[n], w.depart[n] = node, -1, t
                    waited[n] = 0
                    add_label(w, n, key, stamp)
                    size = push(w.keys, w.items, size, worth(spent, t + 1 - t0) + pool[slots[leg], s2] + rest[leg], n)
                    n += 1
    out[1] = expanded
    return NO_PATH


@lean
def trail(w: Work, node: int, edges: I32, starts: I32, ends: I32) -> int:
    """Steps (edge or STAY, start, end) from the root to a node, in order; returns their number."""
    n = 0
    at = node
    while at > 0:
        if w.edge[at] != -1:
            n += 1
        at = w.parent[at]
    i = n
    at = node
    while at > 0:
        if w.edge[at] != -1:
            i -= 1
            edges[i], starts[i], ends[i] = w.edge[at], w.depart[at], w.tick[at]
        at = w.parent[at]
    return n
