"""The constraint tree: conflict-based search over whole plans, in one compiled loop that can stop and go on.

Source: CBS (Sharon et al. 2015); cardinal conflicts and bypass (Boyarski et al. 2015); disjoint splitting (Li et al.
2019); dependency heuristics CG, DG, WDG (Felner et al. 2018, Li et al. 2019); target reasoning (Li et al. 2020); focal
list (Barer et al. 2014); dynamic priority of vehicles (xu2025, eq. 14). Promise: with w = 1 the plan is optimal for the
sum of costs; with w > 1 its cost is at most w times the proven lower bound. The one exception is `priority-branch`,
which is incomplete. Unsolvable instances don't end: the caller limits the work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.planners.kernels.cbs_low import (
    BY,
    FEW,
    FOUND,
    FREE_FROM,
    FULL,
    HARD,
    LAST,
    NONE,
    TIES,
    Layers,
    Roads,
    Work,
    add_landmark,
    add_other,
    bits_of,
    build_layers,
    clear_constraints,
    clear_others,
    close_place,
    finish_constraints,
    forbid_move,
    forbid_place,
    mark_single,
    search,
    slot_at,
)
from engine.planners.kernels.heap import drop_first, push

F64 = NDArray[np.float64]
I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

ROOT, NOT_AT, NOT_OVER, AT, OVER, LATER, BY_THEN = range(7)
"""Constraints: not at a place at a tick · not over a motion · at it · over it (both forbid it to all others) · arrive
for good later than a tick · by then (all others stay off that goal from then on)."""

OPEN, CHOSEN, PRUNED = 0, 1, 2
"""What became of a node."""

DONE, MORE, GROW, EMPTY = 0, 1, 2, 3
"""How a run of the loop ended: plan found or bound met · chunk of work over · room needed · nothing left."""

DISJOINT, CARDINAL, BYPASS, COVER, TARGET, BRANCH, W_MILLION, TRIES = range(8)
"""Slots of the options: switches; COVER 0 none, 1 CG, 2 DG, 3 WDG; w in millionths; prioritized orders to try."""

(
    NODES, RECS, ARENA, BEST, BEST_COST, HEAP, FOCAL, WAITING, HIGH, LOW, BOUND, STAGE, LONGEST, PAIRS, PAIR_STAMP,
    TRIED,
) = range(16)  # fmt: skip
"""Slots of Tree.num: counts, incumbent (1: there is one) and its cost, heap sizes, expansions, proven bound …"""

NEVER = np.int64(2**62)


class Case(NamedTuple):
    """n vehicles. h: (n, S) least cost to each one's goal · mass: (n,) share of the heaviest · orders: (m, n)."""

    start: I32
    goal: I32
    cls: I32
    h: I64
    mass: F64
    weights: F64  # (3,) of eq. 14
    orders: I32


class Tree(NamedTuple):
    """Nodes of the constraint tree, ways of single vehicles (records), heaps."""

    parent: I32  # nodes
    agent: I32
    kind: I8
    place: I32
    place2: I32
    tick: I32
    cost: I64
    low: I64
    h: I64
    knows: I8
    conflicts: I32
    status: I8
    dp_low: F64
    dp_high: F64
    rec: I32  # (N, n)
    rec_first: I64  # records
    rec_len: I32
    rec_cost: I64
    rec_min: I64
    rec_node: I32
    rec_agent: I32
    rec_wide: I8
    states: I32  # arena
    single: I8
    best: I32  # (n,) records of the incumbent
    open_key: I64
    open_item: I32
    focal_key: I64
    focal_item: I32
    wait_key: I64
    wait_item: I32
    pair_key: I64
    pair_value: I64
    pair_stamp: I32
    num: I64


class Desk(NamedTuple):
    """Scratch of one expansion."""

    here: I32  # (P,) who is here
    here_stamp: I64
    clock: I64
    a: I32  # conflicts
    b: I32
    place: I32
    place2: I32  # -1: both at `place`; else a goes place → place2 and b back
    tick: I32
    found: I64
    met: I32  # (n,) conflicts of each vehicle
    out: I64
    weight: I64  # (n, n) dependency graph
    mark: I32  # (n,)
    value: I64
    stack: I32
    joint_key: I64  # pairs seen
    joint_stamp: I32
    joint_stack: I64
    joint_clock: I64


@njit(cache=True, nogil=True)
def _place_at(r: Roads, t: Tree, rec: int, tick: int) -> int:
    return r.place[t.states[t.rec_first[rec] + min(tick, t.rec_len[rec])]]


@njit(cache=True, nogil=True)
def _least_at(r: Roads, h: I64, place: int) -> int:
    least = NEVER
    for s in range(r.place_ptr[place], r.place_ptr[place + 1]):
        least = min(least, h[s])
    return least


@njit(cache=True, nogil=True)
def load_constraints(r: Roads, w: Work, c: Case, t: Tree, node: int, agent: int) -> bool:
    """Load what a node demands of a vehicle into the workspace. False when it contradicts itself."""
    clear_constraints(w)
    goal = c.goal[agent]
    wait = r.wait[c.cls[agent]]
    ok = True
    while node > 0:
        kind, who = np.int64(t.kind[node]), np.int64(t.agent[node])
        p, q, tick = np.int64(t.place[node]), np.int64(t.place2[node]), np.int64(t.tick[node])
        if who == agent:
            if kind == NOT_AT:
                forbid_place(r, w, p, tick, goal)
            elif kind == NOT_OVER:
                forbid_move(r, w, p, q, tick)
            elif kind == AT:
                ok &= add_landmark(w, p, tick, goal, _least_at(r, c.h[agent], p), wait)
            elif kind == OVER:
                ok &= add_landmark(w, p, tick, goal, _least_at(r, c.h[agent], p), wait)
                ok &= add_landmark(w, q, tick + 1, goal, _least_at(r, c.h[agent], q), wait)
                # over the motion means not resting before it
                w.con[FREE_FROM] = max(w.con[FREE_FROM], tick + 1)
            elif kind == LATER:
                w.con[FREE_FROM] = max(w.con[FREE_FROM], tick + 1)
            elif kind == BY_THEN:
                w.con[BY] = min(w.con[BY], tick)
                w.con[LAST] = max(w.con[LAST], tick)
        elif kind == AT:
            forbid_place(r, w, p, tick, goal)
        elif kind == OVER:
            forbid_place(r, w, p, tick, goal)
            forbid_place(r, w, q, tick + 1, goal)
            forbid_move(r, w, q, p, tick)
        elif kind == BY_THEN:
            if c.goal[who] == goal:
                ok = False
            close_place(w, c.goal[who], tick)
        node = np.int64(t.parent[node])  # type: ignore[assignment]
    finish_constraints(w)
    return ok


@njit(cache=True, nogil=True)
def _keep_way(t: Tree, w: Work, agent: int, node: int, out: I64, least: int) -> int:
    """Store the way just found as a record; -1 when there is no room."""
    rec, first, length = t.num[RECS], t.num[ARENA], out[1]
    if rec + 1 >= len(t.rec_len) or first + length + 2 >= len(t.states):
        return -1
    for k in range(length + 1):
        t.states[first + k] = w.path[k]
    t.rec_first[rec], t.rec_len[rec], t.rec_cost[rec], t.rec_min[rec] = first, length, out[0], least
    t.rec_node[rec], t.rec_agent[rec], t.rec_wide[rec] = node, agent, 0
    t.num[RECS] += 1
    t.num[ARENA] += length + 1
    t.num[LONGEST] = max(t.num[LONGEST], length)
    return rec


@njit(cache=True, nogil=True)
def _replan(
    r: Roads, w: Work, c: Case, t: Tree, d: Desk, node: int, agent: int, most: int, wide: int
) -> int:  # fmt: skip
    """New way of a vehicle under a node's constraints, meeting the node's other ways seldom; t.rec is updated."""
    if not load_constraints(r, w, c, t, node, agent):
        return NONE
    clear_others(w)
    n = len(c.start)
    for k in range(n):
        if k != agent and t.rec[node, k] >= 0:
            rec = t.rec[node, k]
            add_other(r, w, t.states, t.rec_first[rec], t.rec_len[rec])
    least = np.int64(0)
    mode, bound, limit = TIES, np.int64(most), most_expansions()
    tries = 3 if wide > 1_000_000 else 1
    for turn in range(tries):
        d.out[2] = 0
        ended = search(
            r, w, c.h[agent], np.int64(c.cls[agent]), np.int64(c.start[agent]), np.int64(c.goal[agent]), mode, bound,
            limit, d.out,
        )  # fmt: skip
        t.num[LOW] += d.out[2]
        if turn == 0:
            if ended != FOUND:
                return ended
            least = d.out[0]
            mode, bound, limit = FEW, min(np.int64(least * (wide / 1e6)), most), np.int64(20_000)  # type: ignore[assignment]
        elif ended == FOUND:
            break
        else:  # the cheapest one again: w.path may be spoilt
            mode, bound, limit = TIES, np.int64(most), most_expansions()
    rec = _keep_way(t, w, agent, node, d.out, least)
    if rec < 0:
        return FULL
    t.rec[node, agent] = rec
    return FOUND


@njit(cache=True, nogil=True)
def most_expansions() -> int:
    """No limit within one search: it is finite."""
    return np.int64(2**60)


@njit(cache=True, nogil=True)
def find_conflicts(r: Roads, t: Tree, d: Desk, recs: I32) -> int:
    """Conflicts of a plan into the desk, by tick; returns how many (of those that found room, all that matter)."""
    n = len(recs)
    longest = 0
    for k in range(n):
        longest = max(longest, t.rec_len[recs[k]])
        d.met[k] = 0
    count = 0
    room = len(d.a)
    for tick in range(longest + 1):
        d.clock[0] += 1
        now = d.clock[0]
        for k in range(n):
            rec = recs[k]
            length = t.rec_len[rec]
            first = t.rec_first[rec]
            p = r.place[t.states[first + min(tick, length)]]
            if d.here_stamp[p] == now:
                j = d.here[p]
                if count < room:
                    d.a[count], d.b[count], d.place[count], d.place2[count], d.tick[count] = j, k, p, -1, tick
                    count += 1
                d.met[j] += 1
                d.met[k] += 1
            else:
                d.here_stamp[p] = now
                d.here[p] = k
        if tick == longest:
            break
        # swaps between this tick and the next
        for k in range(n):
            rec = recs[k]
            if tick >= t.rec_len[rec]:
                continue
            first = t.rec_first[rec]
            p = r.place[t.states[first + tick]]
            q = r.place[t.states[first + tick + 1]]
            if p != q and d.here_stamp[q] == now:
                j = d.here[q]
                if j < k:
                    other = recs[j]
                    if tick < t.rec_len[other] and r.place[t.states[t.rec_first[other] + tick + 1]] == p:
                        if count < room:
                            d.a[count], d.b[count], d.place[count], d.place2[count] = j, k, q, p
                            d.tick[count] = tick
                            count += 1
                        d.met[j] += 1
                        d.met[k] += 1
    d.found[0] = count
    return count


@njit(cache=True, nogil=True)
def _know_single(r: Roads, w: Work, c: Case, t: Tree, m: Layers, rec: int) -> None:
    """Find at which ticks all cheapest ways of a record's vehicle are at one place."""
    if t.rec_wide[rec]:
        return
    t.rec_wide[rec] = 1
    agent = np.int64(t.rec_agent[rec])
    first, length = t.rec_first[rec], np.int64(t.rec_len[rec])
    load_constraints(r, w, c, t, np.int64(t.rec_node[rec]), agent)
    if t.rec_cost[rec] == t.rec_min[rec] and build_layers(
        r, w, m, c.h[agent], np.int64(c.cls[agent]), np.int64(c.start[agent]), np.int64(c.goal[agent]), t.rec_cost[rec],
        True,
    ):  # fmt: skip
        mark_single(r, m, c.goal[agent], t.single, first, length)
    else:
        for k in range(length + 1):
            t.single[first + k] = 0


@njit(cache=True, nogil=True)
def _single(t: Tree, rec: int, tick: int) -> int:
    if tick >= t.rec_len[rec]:
        return t.single[t.rec_first[rec] + t.rec_len[rec]]
    return t.single[t.rec_first[rec] + tick]


@njit(cache=True, nogil=True)
def _cardinal(r: Roads, w: Work, c: Case, t: Tree, d: Desk, m: Layers, node: int, k: int) -> int:
    """How many of the two vehicles of a conflict can't avoid it at their present cost."""
    ra, rb = np.int64(t.rec[node, d.a[k]]), np.int64(t.rec[node, d.b[k]])
    _know_single(r, w, c, t, m, ra)
    _know_single(r, w, c, t, m, rb)
    tick = np.int64(d.tick[k])
    one, two = _single(t, ra, tick), _single(t, rb, tick)
    if d.place2[k] >= 0:
        one &= _single(t, ra, tick + 1)
        two &= _single(t, rb, tick + 1)
    return one + two


# --- dependency heuristics -------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _joint(r: Roads, d: Desk, x: Layers, y: Layers, gx: int, gy: int) -> int:
    """1 when a pair of ways from the two layers has no conflict, 0 when there is none, -1 when too large to tell."""
    d.joint_clock[0] += 1
    stamp = d.joint_clock[0]
    bits = bits_of(len(d.joint_key))
    mask = len(d.joint_key) - 1
    room = len(d.joint_key) >> 1
    wide = np.int64(y.size[0] + 1)
    if x.alive[0] == 0 or y.alive[0] == 0:
        return 0
    top, seen = 0, 0
    d.joint_stack[top] = 0 * wide + 0
    top = 1
    nx, ny = x.size[0], y.size[0]
    while top > 0:
        top -= 1
        pair = d.joint_stack[top]
        i, j = pair // wide, pair % wide
        if i == nx and j == ny:
            return 1
        px = gx if i == nx else r.place[x.state[i]]
        py = gy if j == ny else r.place[y.state[j]]
        # each one's choices: its motions, then rest (choice one past the last)
        x0, x1 = (0, 0) if i == nx else (x.ptr[i], x.ptr[i + 1])
        y0, y1 = (0, 0) if j == ny else (y.ptr[j], y.ptr[j + 1])
        for a in range(x0, x1 + 1):
            if a == x1:
                if i < nx and x.ends[i] == 0:
                    continue
                i2 = np.int64(nx)
                qx = gx
            else:
                if x.to[a] < 0:
                    continue
                i2 = np.int64(x.to[a])
                qx = r.place[x.state[i2]]
            for b in range(y0, y1 + 1):
                if b == y1:
                    if j < ny and y.ends[j] == 0:
                        continue
                    j2 = np.int64(ny)
                    qy = gy
                else:
                    if y.to[b] < 0:
                        continue
                    j2 = np.int64(y.to[b])
                    qy = r.place[y.state[j2]]
                if qx == qy or (qx == py and qy == px and px != py):
                    continue
                key = i2 * wide + j2
                at = slot_at(key, bits)
                while d.joint_stamp[at] == stamp and d.joint_key[at] != key:
                    at = (at + 1) & mask
                if d.joint_stamp[at] == stamp:
                    continue
                seen += 1
                if seen >= room or top + 1 >= len(d.joint_stack):
                    return -1
                d.joint_stamp[at], d.joint_key[at] = stamp, key
                d.joint_stack[top] = key
                top += 1
    return 0


@njit(cache=True, nogil=True)
def _dependency(
    r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, ra: int, rb: int, deepest: int
) -> int:
    """Proven least extra cost of two vehicles that must not conflict, in steps of the least wait (unit costs only)."""
    bits = bits_of(len(t.pair_key))
    mask = len(t.pair_key) - 1
    stamp = t.num[PAIR_STAMP]
    key = (np.int64(min(ra, rb)) << 31) | max(ra, rb)
    at = slot_at(key, bits)
    while t.pair_stamp[at] == stamp:
        if t.pair_key[at] == key:
            return t.pair_value[at]
        at = (at + 1) & mask
    a, b = np.int64(t.rec_agent[ra]), np.int64(t.rec_agent[rb])
    value = 0
    for extra in range(deepest):
        free = 0
        for one in range(extra + 1):
            load_constraints(r, w, c, t, np.int64(t.rec_node[ra]), a)
            if not build_layers(
                r, w, x, c.h[a], np.int64(c.cls[a]), np.int64(c.start[a]), np.int64(c.goal[a]), t.rec_min[ra] + one,
                extra == 0,
            ):  # fmt: skip
                free = -1
                break
            load_constraints(r, w, c, t, np.int64(t.rec_node[rb]), b)
            if not build_layers(
                r, w, y, c.h[b], np.int64(c.cls[b]), np.int64(c.start[b]), np.int64(c.goal[b]),
                t.rec_min[rb] + extra - one, extra == 0,
            ):  # fmt: skip
                free = -1
                break
            free = _joint(r, d, x, y, c.goal[a], c.goal[b])
            if free != 0:
                break
        if free != 0:
            break
        value = extra + 1
    if t.num[PAIRS] * 2 < len(t.pair_key):
        t.num[PAIRS] += 1
        t.pair_stamp[at], t.pair_key[at], t.pair_value[at] = stamp, key, value
    return value


@njit(cache=True, nogil=True)
def weighted_cover(weight: I64, mark: I32, value: I64, stack: I32) -> int:
    """Least sum of x ≥ 0 (integers) with x[i] + x[j] ≥ weight[i, j], or a lower bound of it when that takes long."""
    n = len(weight)
    for i in range(n):
        mark[i] = 0
    total = 0
    for seed in range(n):
        if mark[seed]:
            continue
        # connected component in stack[0:size], in breadth-first order
        size, head = 1, 0
        stack[0] = seed
        mark[seed] = 1
        while head < size:
            i = stack[head]
            head += 1
            for j in range(n):
                if weight[i, j] > 0 and mark[j] == 0:
                    mark[j] = 1
                    stack[size] = j
                    size += 1
        if size == 1:
            continue
        if size == 2:
            total += weight[stack[0], stack[1]]
            continue
        # depth first over values; value[k] is that of stack[k]
        bound = 0  # a matching
        for k in range(size):
            stack[n + k] = 0
        while True:
            best, bi, bj = 0, -1, -1
            for k in range(size):
                for q in range(k + 1, size):
                    if stack[n + k] == 0 and stack[n + q] == 0 and weight[stack[k], stack[q]] > best:
                        best, bi, bj = weight[stack[k], stack[q]], k, q
            if bi < 0:
                break
            stack[n + bi] = stack[n + bj] = 1
            bound += best
        best = NEVER  # type: ignore[assignment]
        k, spent, steps = 0, 0, 0
        value[0] = -1
        complete = True
        while k >= 0:
            steps += 1
            if steps > 20_000:
                complete = False
                break
            i = stack[k]
            if value[k] < 0:
                need, most = 0, 0
                for q in range(size):
                    e = weight[i, stack[q]]
                    most = max(most, e)
                    if q < k:
                        need = max(need, e - value[q])
                value[k] = need
                stack[2 * n + k] = most
            else:
                spent -= value[k]
                value[k] += 1
            if value[k] > stack[2 * n + k] or spent + value[k] >= best:
                k -= 1
                continue
            spent += value[k]
            if k + 1 == size:
                best = spent
                if best <= bound:
                    break
                spent -= value[k]
                k -= 1
            else:
                k += 1
                value[k] = -1
        total += best if complete else bound
    return total


@njit(cache=True, nogil=True)
def _cover_bound(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, node: int, how: int) -> int:
    """Lower bound of the extra cost that a node's conflicts force (unit costs)."""
    n = len(c.start)
    d.weight[:] = 0
    for k in range(d.found[0]):
        a, b = np.int64(d.a[k]), np.int64(d.b[k])
        if d.weight[a, b] != 0:
            continue
        if how == 1:
            if _cardinal(r, w, c, t, d, x, node, k) < 2:
                continue
            value = 1
        else:
            value = _dependency(
                r, w, c, t, d, x, y, np.int64(t.rec[node, a]), np.int64(t.rec[node, b]), 1 if how == 2 else 4
            )
        d.weight[a, b] = d.weight[b, a] = value if value > 0 else -1  # -1: seen
    for i in range(n):
        for j in range(n):
            d.weight[i, j] = max(d.weight[i, j], 0)
    return weighted_cover(d.weight, d.mark, d.value, d.stack)


# --- branching -------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _priority(c: Case, t: Tree, d: Desk, node: int, agent: int, tick: int) -> float:
    """Dynamic priority, eq. 14: heavy vehicles with a long way left and few conflicts keep their way."""
    n = len(c.start)
    most = 1
    for k in range(n):
        most = max(most, d.met[k])
    length = max(t.rec_len[t.rec[node, agent]], 1)
    left = 1.0 - min(tick, length) / length
    return c.weights[0] * c.mass[agent] + c.weights[1] * left - c.weights[2] * d.met[agent] / most


@njit(cache=True, nogil=True)
def _choose(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, node: int, opt: I64) -> int:
    """Index of the conflict to resolve: cardinal before semi-cardinal before others, then the earliest."""
    if opt[CARDINAL] == 0:
        return 0
    best, best_rank = 0, -1
    for k in range(d.found[0]):
        rank = _cardinal(r, w, c, t, d, x, node, k)
        if rank > best_rank:
            best, best_rank = k, rank
            if rank == 2:
                break
    return best


@njit(cache=True, nogil=True)
def _breaks(r: Roads, c: Case, t: Tree, node: int, agent: int) -> bool:
    """Whether a vehicle's present way breaks the node's own constraint."""
    kind, who = np.int64(t.kind[node]), np.int64(t.agent[node])
    p, q, tick = np.int64(t.place[node]), np.int64(t.place2[node]), np.int64(t.tick[node])
    rec = np.int64(t.rec[node, agent])
    if who == agent:
        if kind == NOT_AT:
            return _place_at(r, t, rec, tick) == p
        if kind == NOT_OVER:
            return _place_at(r, t, rec, tick) == p and _place_at(r, t, rec, tick + 1) == q
        if kind == LATER:
            return t.rec_len[rec] <= tick
        if kind == BY_THEN:
            return t.rec_len[rec] > tick
        return False  # AT, OVER: chosen from its own way
    if kind == AT:
        return _place_at(r, t, rec, tick) == p
    if kind == OVER:
        now, then = _place_at(r, t, rec, tick), _place_at(r, t, rec, tick + 1)
        return now == p or then == q or (now == q and then == p)
    if kind == BY_THEN:
        goal = c.goal[who]
        for at in range(tick, t.rec_len[rec] + 1):
            if _place_at(r, t, rec, at) == goal:
                return True
        return t.rec_len[rec] < tick and c.goal[agent] == goal
    return False


@njit(cache=True, nogil=True)
def _push_open(c: Case, t: Tree, node: int, opt: I64) -> None:
    """Enter a node into the open list."""
    few = min(t.conflicts[node], 1023)
    f = t.low[node] + t.h[node]
    t.num[HEAP] = push(t.open_key, t.open_item, t.num[HEAP], (f << 10) | few, node)
    if opt[W_MILLION] > 1_000_000 and t.num[STAGE] == 1:
        t.num[WAITING] = push(t.wait_key, t.wait_item, t.num[WAITING], t.cost[node], node)


@njit(cache=True, nogil=True)
def _new_child(
    r: Roads, w: Work, c: Case, t: Tree, d: Desk, node: int, opt: I64, agent: int, kind: int, p: int, q: int, tick: int
) -> int:  # fmt: skip
    """A child with one more constraint, its ways replanned. Returns its number, -1 without a plan, -2 for no room."""
    child = np.int64(t.num[NODES])
    n = len(c.start)
    t.parent[child], t.agent[child], t.kind[child] = node, agent, kind
    t.place[child], t.place2[child], t.tick[child] = p, q, tick
    t.cost[child], t.low[child] = t.cost[node], t.low[node]
    t.knows[child], t.status[child], t.h[child] = 0, OPEN, 0
    for k in range(n):
        t.rec[child, k] = t.rec[node, k]
    for k in range(n):
        who = k if kind in (AT, OVER, BY_THEN) else agent
        if _breaks(r, c, t, child, who):
            old = t.rec[child, who]
            most = t.num[BEST_COST] - 1 - (t.low[child] - t.rec_min[old])
            ended = _replan(r, w, c, t, d, child, who, most, opt[W_MILLION])
            if ended == FULL:
                return -2
            if ended != FOUND:
                return -1
            new = t.rec[child, who]
            t.cost[child] += t.rec_cost[new] - t.rec_cost[old]
            t.low[child] += t.rec_min[new] - t.rec_min[old]
        if kind not in (AT, OVER, BY_THEN):
            break
    t.num[NODES] += 1
    t.h[child] = max(0, t.low[node] + t.h[node] - t.low[child])
    return child


@njit(cache=True, nogil=True)
def _take(t: Tree, node: int) -> None:
    """The node's plan is the new incumbent."""
    t.num[BEST], t.num[BEST_COST] = 1, t.cost[node]
    for k in range(t.rec.shape[1]):
        t.best[k] = t.rec[node, k]


@njit(cache=True, nogil=True)
def _expand(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, node: int, opt: I64) -> int:
    """Resolve one conflict of a node. FULL when there is no room: nothing has happened then."""
    while True:
        if find_conflicts(r, t, d, t.rec[node]) == 0:
            t.status[node] = CHOSEN
            if t.cost[node] < t.num[BEST_COST]:
                _take(t, node)
            return FOUND
        if opt[COVER] > 0 and t.knows[node] == 0:
            t.knows[node] = 1
            extra = _cover_bound(r, w, c, t, d, x, y, node, opt[COVER])
            if extra > t.h[node]:
                t.h[node] = extra
                if t.low[node] + extra >= t.num[BEST_COST]:
                    t.status[node] = PRUNED
                    return FOUND
                _push_open(c, t, node, opt)
                return FOUND
        k = _choose(r, w, c, t, d, x, node, opt)
        a, b = np.int64(d.a[k]), np.int64(d.b[k])
        p, q, tick = np.int64(d.place[k]), np.int64(d.place2[k]), np.int64(d.tick[k])
        low, high = _priority(c, t, d, node, a, tick), _priority(c, t, d, node, b, tick)
        if high < low:
            a, b = b, a
            low, high = high, low
            if q >= 0:
                p, q = q, p
        # now `a` has the lower priority and is constrained first; it goes p → q
        t.dp_low[node], t.dp_high[node] = low, high
        nodes, recs, arena = t.num[NODES], t.num[RECS], t.num[ARENA]
        resting = np.int64(-1)
        if q < 0 and opt[TARGET] == 1 and opt[BRANCH] == 0:
            if tick >= t.rec_len[t.rec[node, a]]:
                resting = a
            elif tick >= t.rec_len[t.rec[node, b]]:
                resting = b
        kids = 0
        one = two = -1
        for turn in range(1 if opt[BRANCH] == 1 else 2):
            if resting >= 0:
                kid = _new_child(
                    r, w, c, t, d, node, opt, resting, LATER if turn == 0 else BY_THEN, p, -1, tick
                )  # fmt: skip
            elif q < 0:
                who = a if turn == 0 or opt[DISJOINT] == 1 else b
                kind = AT if turn == 1 and opt[DISJOINT] == 1 else NOT_AT
                kid = _new_child(r, w, c, t, d, node, opt, who, kind, p, -1, tick)
            elif opt[DISJOINT] == 1:
                kid = _new_child(r, w, c, t, d, node, opt, a, OVER if turn == 1 else NOT_OVER, p, q, tick)
            elif turn == 0:
                kid = _new_child(r, w, c, t, d, node, opt, a, NOT_OVER, p, q, tick)
            else:
                kid = _new_child(r, w, c, t, d, node, opt, b, NOT_OVER, q, p, tick)
            if kid == -2:
                t.num[NODES], t.num[RECS], t.num[ARENA] = nodes, recs, arena
                return FULL
            if kid >= 0:
                kids += 1
                if turn == 0:
                    one = kid
                else:
                    two = kid
        own = d.found[0]
        swapped = False
        for kid in (one, two):
            if kid < 0:
                continue
            t.conflicts[kid] = find_conflicts(r, t, d, t.rec[kid])
            if (
                opt[BYPASS] == 1
                and t.cost[kid] == t.cost[node]
                and t.low[kid] == t.low[node]
                and t.conflicts[kid] < own
            ):
                for j in range(len(c.start)):
                    rec = t.rec[kid, j]
                    if rec != t.rec[node, j]:
                        t.rec[node, j] = rec
                        t.rec_node[rec] = node
                        t.rec_wide[rec] = 0
                t.conflicts[node] = t.conflicts[kid]
                swapped = True
                break
        if swapped:
            t.num[NODES] = nodes
            t.knows[node] = 0
            continue
        for kid in (one, two):
            if kid < 0:
                continue
            f = t.low[kid] + t.h[kid]
            if f >= t.num[BEST_COST]:
                t.status[kid] = PRUNED
                continue
            if t.conflicts[kid] == 0 and t.cost[kid] < t.num[BEST_COST]:
                _take(t, kid)
            _push_open(c, t, kid, opt)
        t.status[node] = CHOSEN
        return FOUND


# --- the loop --------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _prioritize(r: Roads, w: Work, c: Case, t: Tree, d: Desk, order: I32) -> int:
    """Vehicles one after another in an order, earlier ones being obstacles; a better plan becomes the incumbent."""
    recs, arena = t.num[RECS], t.num[ARENA]
    clear_others(w)
    clear_constraints(w)
    finish_constraints(w)
    total, good = 0, True
    for k in order:
        d.out[2] = 0
        ended = search(
            r, w, c.h[k], np.int64(c.cls[k]), np.int64(c.start[k]), np.int64(c.goal[k]), HARD,
            t.num[BEST_COST] - 1 - total, np.int64(1_000_000), d.out,
        )  # fmt: skip
        t.num[LOW] += d.out[2]
        if ended == FULL:
            t.num[RECS], t.num[ARENA] = recs, arena
            return FULL
        if ended != FOUND:
            good = False
            break
        rec = _keep_way(t, w, k, 0, d.out, d.out[0])
        if rec < 0:
            t.num[RECS], t.num[ARENA] = recs, arena
            return FULL
        d.stack[k] = rec
        total += d.out[0]
        if not add_other(r, w, t.states, t.rec_first[rec], t.rec_len[rec]):
            t.num[RECS], t.num[ARENA] = recs, arena
            return FULL
    if good and total < t.num[BEST_COST]:
        t.num[BEST], t.num[BEST_COST] = 1, total
        for k in range(len(order)):
            t.best[k] = d.stack[k]
    else:
        t.num[RECS], t.num[ARENA] = recs, arena
    return FOUND


@njit(cache=True, nogil=True)
def run(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, opt: I64, nodes: int, work: int) -> int:
    """Go on until the plan is proven, `nodes` more nodes or `work` more single-vehicle expansions are spent."""
    n = len(c.start)
    till_high, till_low = t.num[HIGH] + nodes, t.num[LOW] + work
    if t.num[STAGE] == 0:
        # the root: every vehicle for itself
        t.num[RECS], t.num[ARENA], t.num[NODES] = 0, 0, 0
        t.parent[0], t.agent[0], t.kind[0] = -1, -1, ROOT
        t.place[0], t.place2[0], t.tick[0] = -1, -1, -1
        t.cost[0], t.low[0], t.h[0], t.knows[0], t.status[0] = 0, 0, 0, 0, OPEN
        for k in range(n):
            t.rec[0, k] = -1
        for k in range(n):
            ended = _replan(r, w, c, t, d, np.int64(0), k, NEVER, opt[W_MILLION])
            if ended == FULL:
                return GROW
            if ended != FOUND:
                return EMPTY
            t.cost[0] += t.rec_cost[t.rec[0, k]]
            t.low[0] += t.rec_min[t.rec[0, k]]
        t.num[NODES] = 1
        t.conflicts[0] = find_conflicts(r, t, d, t.rec[0])
        t.num[BOUND] = t.low[0]
        t.num[BEST], t.num[BEST_COST] = 0, NEVER
        t.num[STAGE] = 1
        t.num[TRIED] = 0
        if t.conflicts[0] == 0:
            _take(t, 0)
        t.num[HEAP] = t.num[FOCAL] = t.num[WAITING] = 0
        _push_open(c, t, 0, opt)
    while t.num[TRIED] < min(opt[TRIES], len(c.orders)):
        if t.num[BEST] == 1 and t.num[BEST_COST] * 1_000_000 <= t.num[BOUND] * opt[W_MILLION]:
            break
        if _prioritize(r, w, c, t, d, c.orders[t.num[TRIED]]) == FULL:
            return GROW
        t.num[TRIED] += 1
    wide = opt[W_MILLION]
    while True:
        # drop what is done or can't improve
        while t.num[HEAP] > 0:
            top = np.int64(t.open_item[0])
            f = t.open_key[0] >> 10
            if t.status[top] != OPEN or f != t.low[top] + t.h[top]:
                t.num[HEAP] = drop_first(t.open_key, t.open_item, t.num[HEAP])
            elif f >= t.num[BEST_COST]:
                t.status[top] = PRUNED
                t.num[HEAP] = drop_first(t.open_key, t.open_item, t.num[HEAP])
            else:
                break
        if t.num[HEAP] == 0:
            if t.num[BEST] == 0:
                return EMPTY
            t.num[BOUND] = max(t.num[BOUND], t.num[BEST_COST])
            return DONE
        t.num[BOUND] = max(t.num[BOUND], t.open_key[0] >> 10)
        if t.num[BEST] == 1 and t.num[BEST_COST] * 1_000_000 <= t.num[BOUND] * wide:
            return DONE
        if t.num[HIGH] >= till_high or t.num[LOW] >= till_low:
            return MORE
        if (
            t.num[NODES] + 4 >= len(t.parent)
            or t.num[HEAP] + 8 >= len(t.open_key)
            or t.num[WAITING] + 8 >= len(t.wait_key)
            or t.num[FOCAL] + 8 >= len(t.focal_key)
            or t.num[LONGEST] * 2 + 16 >= len(w.path)
            or t.num[LONGEST] * 2 + 16 >= w.others_len[1]
        ):
            return GROW
        node = np.int64(-1)
        if wide > 1_000_000:
            while t.num[WAITING] > 0 and t.wait_key[0] * 1_000_000 <= t.num[BOUND] * wide:
                kid = t.wait_item[0]
                t.num[WAITING] = drop_first(t.wait_key, t.wait_item, t.num[WAITING])
                if t.status[kid] == OPEN:
                    key = (np.int64(t.conflicts[kid]) << 42) | min(t.cost[kid], 2**42 - 1)
                    t.num[FOCAL] = push(t.focal_key, t.focal_item, t.num[FOCAL], key, kid)
            while t.num[FOCAL] > 0 and t.status[t.focal_item[0]] != OPEN:
                t.num[FOCAL] = drop_first(t.focal_key, t.focal_item, t.num[FOCAL])
            if t.num[FOCAL] > 0:
                node = np.int64(t.focal_item[0])
        if node < 0:
            node = np.int64(t.open_item[0])
        knew = t.knows[node]
        before = t.low[node] + t.h[node]
        if _expand(r, w, c, t, d, x, y, node, opt) == FULL:
            return GROW
        if t.status[node] == CHOSEN or knew == t.knows[node] or before == t.low[node] + t.h[node]:
            t.num[HIGH] += 1
