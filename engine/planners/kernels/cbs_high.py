"""The constraint tree: conflict-based search over whole plans, in one compiled loop that can stop and go on.

Source: CBS (Sharon et al. 2015); cardinal conflicts and bypass (Boyarski et al. 2015); disjoint splitting (Li et al.
2019); dependency heuristics CG, DG, WDG (Felner et al. 2018, Li et al. 2019); target reasoning (Li et al. 2020); focal
list (Barer et al. 2014); repair of parts of a plan (Li et al. 2021); dynamic priority of vehicles (xu2025, eq. 14).
Promise: with w = 1 the plan is optimal for the sum of costs; with w > 1 its cost is at most w times the proven lower
bound. The one exception is `priority-branch`, which is incomplete. Unsolvable instances don't end: the caller limits
the work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean, lean_part
from engine.planners.kernels.cbs_low import (
    BY,
    FEW,
    FOUND,
    FREE_FROM,
    FULL,
    HARD,
    LAST,
    NONE,
    ROOM,
    SPENT,
    TIES,
    Bans,
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
    forbid,
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

OPEN, CHOSEN, PRUNED, ANSWER = 0, 1, 2, 3
"""What became of a node: waits · expanded · no better than the best plan · its plan is the answer."""

DONE, MORE, GROW, EMPTY = 0, 1, 2, 3
"""How a run of the loop ended: plan found or bound met · chunk of work over · room needed · nothing left."""

DISJOINT, CARDINAL, BYPASS, COVER, TARGET, BRANCH, W_MILLION, TRIES, PAIRED = range(9)
"""Slots of the options: switches (PAIRED: bounds by pairs); COVER 0 none, 1 CG, 2 DG, 3 WDG; w in millionths;
orders to plan anew in: later ones replan a part of the best plan."""

(
    NODES, RECS, ARENA, BEST, BEST_COST, HEAP, FOCAL, WAITING, HIGH, LOW, BOUND, STAGE, LONGEST, PAIRS, PAIR_STAMP,
    TRIED, TURNS, BEST_NODE, WORK, TILL, PLACED, PLACED_RECS, PLACED_ARENA, PLACED_COST,
) = range(24)  # fmt: skip
"""Slots of Tree.num: counts, incumbent (1: there is one) and its cost, heap sizes, expansions, proven bound …
WORK counts all that takes about 100 ns; a run is to end when it reaches TILL. PLACED: vehicles of an order done."""

(PARENT, AGENT, KIND, PLACE, PLACE2, TICK, KNOWS, CLASHES, STATUS, TURN, CONFLICT) = range(11)
"""Columns of Tree.node: node above · the constraint it adds · 1 when its h is from its own conflicts · conflicts · what
became of it, and in which turn · five of the conflict resolved: vehicles a and b, place, place2, tick."""
COST, PROVEN, H = range(3)
"""Columns of Tree.worth: of its plan, proven for its plan, least that its conflicts still add."""
FIRST, LENGTH, PRICE, LEAST, MADE_AT, OWNER, SEEN = range(7)
"""Columns of Tree.way: first state in the arena, ticks, cost, least cost at that node, node, vehicle, 1 when `single`
is known."""
OPEN_LIST, FOCAL_LIST, WAIT_LIST = range(3)

NEVER = np.int64(2**62)
MANY = np.int64(2**60)
"""No limit within one search: it is finite."""
REPLANNED = 5
"""Of the best plan 2 to 1 + REPLANNED vehicles are planned anew at a time."""
MATCHED = 10
"""Vehicles that an exact matching takes in; among more it is greedy."""


class Case(NamedTuple):
    """n vehicles. h: (n, S) least cost to each one's goal · mass: (n,) share of the heaviest · orders: (m, n)."""

    start: I32
    goal: I32
    cls: I32
    h: I64
    mass: F64
    weights: F64  # (3,) of eq. 14
    orders: I32
    pair: I64  # (n, n) least that two vehicles cost together, 0 where unknown


class Tree(NamedTuple):
    """Nodes of the constraint tree, ways of single vehicles (records), heaps."""

    node: I32  # (N, 15)
    worth: I64  # (N, 3)
    priority: F64  # (N, 2) of a and b, eq. 14
    rec: I32  # (N, n) record of each vehicle
    way: I64  # (R, 7)
    states: I32  # arena of all records
    single: I8  # 1 where all cheapest ways of the record's vehicle are at one place
    best: I32  # (n,) records of the incumbent
    key: I64  # (3, ·) heaps: open, focal, waiting for the bound
    item: I32
    pair_key: I64  # what two records must pay to avoid each other
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
    matched: I64  # (2**MATCHED,)
    cut: I64  # (2, 5) constraints of the two children


@lean
def _place_at(r: Roads, t: Tree, rec: int, tick: int) -> int:
    return r.place[t.states[t.way[rec, FIRST] + min(tick, t.way[rec, LENGTH])]]


@lean
def _least_at(r: Roads, h: I64, place: int) -> int:
    least = NEVER
    for s in range(r.place_ptr[place], r.place_ptr[place + 1]):
        least = min(least, h[s])
    return least


@lean
def load_constraints(r: Roads, k: Bans, c: Case, t: Tree, node: int, agent: int) -> bool:
    """Load what a node demands of a vehicle into the constraints. False when it contradicts itself."""
    clear_constraints(k)
    goal = c.goal[agent]
    wait = r.wait[c.cls[agent]]
    ok = True
    while node > 0:
        kind, who = np.int64(t.node[node, KIND]), np.int64(t.node[node, AGENT])
        p, q, tick = np.int64(t.node[node, PLACE]), np.int64(t.node[node, PLACE2]), np.int64(t.node[node, TICK])
        if who == agent:
            if kind == NOT_AT:
                forbid_place(k, p, tick, goal)
            elif kind == NOT_OVER:
                forbid(k, q, p, tick + 1)
            elif kind == AT:
                ok &= add_landmark(k, p, tick, goal, _least_at(r, c.h[agent], p), wait)
            elif kind == OVER:
                ok &= add_landmark(k, p, tick, goal, _least_at(r, c.h[agent], p), wait)
                ok &= add_landmark(k, q, tick + 1, goal, _least_at(r, c.h[agent], q), wait)
                # over the motion means not resting before it
                k.con[FREE_FROM] = max(k.con[FREE_FROM], tick + 1)
            elif kind == LATER:
                k.con[FREE_FROM] = max(k.con[FREE_FROM], tick + 1)
            elif kind == BY_THEN:
                k.con[BY] = min(k.con[BY], tick)
                k.con[LAST] = max(k.con[LAST], tick)
        elif kind == AT:
            forbid_place(k, p, tick, goal)
        elif kind == OVER:
            forbid_place(k, p, tick, goal)
            forbid_place(k, q, tick + 1, goal)
            forbid(k, p, q, tick + 1)
        elif kind == BY_THEN:
            if c.goal[who] == goal:
                ok = False
            close_place(k, c.goal[who], tick)
        node = np.int64(t.node[node, PARENT])  # type: ignore[assignment]
    finish_constraints(k)
    return ok


@lean
def _keep_way(t: Tree, path: I32, agent: int, node: int, out: I64, least: int) -> int:
    """Store the way just found as a record; -1 when there is no room."""
    rec, first, length = t.num[RECS], t.num[ARENA], out[1]
    if rec + 1 >= len(t.way) or first + length + 2 >= len(t.states):
        return -1
    for k in range(length + 1):
        t.states[first + k] = path[k]
    t.way[rec, FIRST], t.way[rec, LENGTH], t.way[rec, PRICE], t.way[rec, LEAST] = first, length, out[0], least
    t.way[rec, MADE_AT], t.way[rec, OWNER], t.way[rec, SEEN] = node, agent, 0
    t.num[RECS] += 1
    t.num[ARENA] += length + 1
    t.num[LONGEST] = max(t.num[LONGEST], length)
    return rec


@lean
def _count(t: Tree, d: Desk) -> None:
    """Enter the expansions of the last search."""
    t.num[LOW] += d.out[2]
    t.num[WORK] += d.out[2]


@lean
def _replan(
    r: Roads, w: Work, c: Case, t: Tree, d: Desk, node: int, agent: int, most: int, wide: int
) -> int:  # fmt: skip
    """New way of a vehicle under a node's constraints, meeting the node's other ways seldom; t.rec is updated."""
    if not load_constraints(r, w.bans, c, t, node, agent):
        return NONE
    clear_others(w.others)
    for k in range(len(c.start)):
        rec = np.int64(t.rec[node, k])
        if k != agent and rec >= 0:
            add_other(r.place, w.others, t.states, t.way[rec, FIRST], t.way[rec, LENGTH])
    least = np.int64(0)
    mode, bound, limit = np.int64(TIES), np.int64(most), MANY
    for turn in range(3 if wide > 1_000_000 else 1):
        d.out[2] = 0
        ended = search(
            r, w, c.h[agent], np.int64(c.cls[agent]), np.int64(c.start[agent]), np.int64(c.goal[agent]), mode, bound,
            limit, d.out,
        )  # fmt: skip
        _count(t, d)
        if turn == 0:
            if ended != FOUND:
                return ended
            least = d.out[0]
            mode, limit = np.int64(FEW), np.int64(20_000)
            bound = np.int64(min(int(least * (wide / 1e6)), most))
        elif ended == FOUND:
            break
        else:  # the cheapest one again: w.path may be spoilt
            mode, bound, limit = np.int64(TIES), np.int64(most), MANY
    new = _keep_way(t, w.path, agent, node, d.out, least)
    if new < 0:
        return FULL
    t.rec[node, agent] = new
    return FOUND


@lean
def find_conflicts(place: I32, t: Tree, d: Desk, recs: I32) -> int:
    """Conflicts of a plan into the desk, by tick; returns how many (of those that found room, all that matter)."""
    n = len(recs)
    longest = 0
    for k in range(n):
        longest = max(longest, t.way[recs[k], LENGTH])
        d.met[k] = 0
    count = 0
    room = len(d.a)
    for tick in range(longest + 1):
        d.clock[0] += 1
        now = d.clock[0]
        for k in range(n):
            rec = recs[k]
            length = t.way[rec, LENGTH]
            first = t.way[rec, FIRST]
            p = place[t.states[first + min(tick, length)]]
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
            if tick >= t.way[rec, LENGTH]:
                continue
            first = t.way[rec, FIRST]
            p = place[t.states[first + tick]]
            q = place[t.states[first + tick + 1]]
            if p != q and d.here_stamp[q] == now:
                j = d.here[q]
                if j < k:
                    other = recs[j]
                    if tick < t.way[other, LENGTH] and place[t.states[t.way[other, FIRST] + tick + 1]] == p:
                        if count < room:
                            d.a[count], d.b[count], d.place[count], d.place2[count] = j, k, q, p
                            d.tick[count] = tick
                            count += 1
                        d.met[j] += 1
                        d.met[k] += 1
    d.found[0] = count
    t.num[WORK] += n * (longest + 1) // 8
    return count


@lean
def _ways_within(r: Roads, k: Bans, c: Case, t: Tree, m: Layers, rec: int, cap: int, exact: bool) -> bool:
    """All ways of a record's vehicle within a cost, under the constraints it was made with. False: no room."""
    agent = t.way[rec, OWNER]
    load_constraints(r, k, c, t, t.way[rec, MADE_AT], agent)
    fits = build_layers(
        r, k, m, c.h[agent], np.int64(c.cls[agent]), np.int64(c.start[agent]), np.int64(c.goal[agent]), cap, exact
    )
    t.num[WORK] += 1 + (m.size[0] if fits else len(m.state))
    return fits


@lean_part
def _know_single(r: Roads, k: Bans, c: Case, t: Tree, m: Layers, rec: int) -> None:
    """Find at which ticks all cheapest ways of a record's vehicle are at one place."""
    if t.way[rec, SEEN]:
        return
    t.way[rec, SEEN] = 1
    first, length = t.way[rec, FIRST], t.way[rec, LENGTH]
    if t.way[rec, PRICE] == t.way[rec, LEAST] and _ways_within(r, k, c, t, m, rec, t.way[rec, PRICE], np.bool_(True)):
        mark_single(r, m, np.int64(c.goal[t.way[rec, OWNER]]), t.single, first, length)
    else:
        t.single[first : first + length + 1] = 0


@lean
def _single(t: Tree, rec: int, tick: int) -> int:
    return np.int64(t.single[t.way[rec, FIRST] + min(tick, t.way[rec, LENGTH])])


@lean
def _cardinal(r: Roads, w: Work, c: Case, t: Tree, d: Desk, m: Layers, node: int, k: int) -> int:
    """How many of the two vehicles of a conflict can't avoid it at their present cost."""
    tick, count = np.int64(d.tick[k]), np.int64(0)
    for turn in range(2):
        rec = np.int64(t.rec[node, d.b[k] if turn else d.a[k]])
        _know_single(r, w.bans, c, t, m, rec)
        one = _single(t, rec, tick)
        if d.place2[k] >= 0:
            one &= _single(t, rec, tick + 1)
        count += one
    return count


# --- dependency heuristics -------------------------------------------------------------------------------------------


@lean
def _joint(r: Roads, t: Tree, d: Desk, x: Layers, y: Layers, gx: int, gy: int) -> int:
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
        t.num[WORK] += 1
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


@lean
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
    gx, gy = np.int64(c.goal[t.way[ra, OWNER]]), np.int64(c.goal[t.way[rb, OWNER]])
    value = 0
    for extra in range(deepest):
        free = np.int64(0)
        for one in range(extra + 1):
            exact = extra == 0
            if not _ways_within(r, w.bans, c, t, x, ra, t.way[ra, LEAST] + one, exact) or not _ways_within(
                r, w.bans, c, t, y, rb, t.way[rb, LEAST] + extra - one, exact
            ):
                free = np.int64(-1)
                break
            free = np.int64(_joint(r, t, d, x, y, gx, gy))
            if free != 0:
                break
        if free != 0:
            break
        value = extra + 1
    if t.num[PAIRS] * 2 < len(t.pair_key):
        t.num[PAIRS] += 1
        t.pair_stamp[at], t.pair_key[at], t.pair_value[at] = stamp, key, value
    return value


@lean
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


@lean_part
def _cover_bound(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, node: int, how: int) -> int:
    """Lower bound of the extra cost that a node's conflicts force (unit costs); -1 when the work is spent before.

    What pairs cost is kept, so that asking again goes on where it ended.
    """
    n, known = len(c.start), t.num[PAIRS]
    d.weight[:] = 0
    for k in range(d.found[0]):
        a, b = np.int64(d.a[k]), np.int64(d.b[k])
        if d.weight[a, b] != 0:
            continue
        if t.num[WORK] >= t.num[TILL] and t.num[PAIRS] > known:
            return -1
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


@lean
def pair_bound(c: Case, t: Tree, d: Desk, node: int) -> int:
    """Lower bound of the extra cost of a node's plans: a matching of what pairs cost beyond their two cheapest ways."""
    n = len(c.start)
    count = 0
    for i in range(n):
        d.mark[i] = 0
    for i in range(n):
        for j in range(n):
            need = c.pair[i, j] - t.way[t.rec[node, i], LEAST] - t.way[t.rec[node, j], LEAST] if i != j else np.int64(0)
            d.weight[i, j] = max(need, 0)
            if need > 0 and d.mark[i] == 0:
                d.mark[i] = 1
                d.stack[count] = i
                count += 1
    total = np.int64(0)
    while count > MATCHED:
        best, bi, bj = np.int64(0), -1, -1
        for i in range(count):
            for j in range(i):
                if d.weight[d.stack[i], d.stack[j]] > best:
                    best, bi, bj = d.weight[d.stack[i], d.stack[j]], i, j
        if bi < 0:
            return total
        total += best
        for at in (bi, bj):  # bj < bi: the last one takes the place of each
            count -= 1
            d.stack[at] = d.stack[count]
    # over sets of vehicles: the first one alone, or with each of the others
    d.matched[0] = 0
    for group in range(1, 1 << count):
        i = 0
        while not (group >> i) & 1:
            i += 1
        rest = group ^ (1 << i)
        best = d.matched[rest]
        for j in range(i + 1, count):
            if (rest >> j) & 1:
                best = max(best, d.matched[rest ^ (1 << j)] + d.weight[d.stack[i], d.stack[j]])
        d.matched[group] = best
    return total + d.matched[(1 << count) - 1]


# --- branching -------------------------------------------------------------------------------------------------------


@lean
def _priority(c: Case, t: Tree, d: Desk, node: int, agent: int, tick: int) -> float:
    """Dynamic priority, eq. 14: heavy vehicles with a long way left and few conflicts keep their way."""
    n = len(c.start)
    most = 1
    for k in range(n):
        most = max(most, d.met[k])
    length = max(t.way[t.rec[node, agent], LENGTH], 1)
    left = 1.0 - min(tick, length) / length
    return c.weights[0] * c.mass[agent] + c.weights[1] * left - c.weights[2] * d.met[agent] / most


@lean_part
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


@lean
def _breaks(r: Roads, c: Case, t: Tree, node: int, agent: int) -> bool:
    """Whether a vehicle's present way breaks the node's own constraint."""
    kind, who = np.int64(t.node[node, KIND]), np.int64(t.node[node, AGENT])
    p, q, tick = np.int64(t.node[node, PLACE]), np.int64(t.node[node, PLACE2]), np.int64(t.node[node, TICK])
    rec = np.int64(t.rec[node, agent])
    if who == agent:
        if kind == NOT_AT:
            return _place_at(r, t, rec, tick) == p
        if kind == NOT_OVER:
            return _place_at(r, t, rec, tick) == p and _place_at(r, t, rec, tick + 1) == q
        if kind == LATER:
            return t.way[rec, LENGTH] <= tick
        if kind == BY_THEN:
            return t.way[rec, LENGTH] > tick
        return False  # AT, OVER: chosen from its own way
    if kind == AT:
        return _place_at(r, t, rec, tick) == p
    if kind == OVER:
        now, then = _place_at(r, t, rec, tick), _place_at(r, t, rec, tick + 1)
        return now == p or then == q or (now == q and then == p)
    if kind == BY_THEN:
        goal = c.goal[who]
        for at in range(tick, t.way[rec, LENGTH] + 1):
            if _place_at(r, t, rec, at) == goal:
                return True
        return t.way[rec, LENGTH] < tick and c.goal[agent] == goal
    return False


@lean
def _push_open(t: Tree, node: int, opt: I64) -> None:
    """Enter a node into the open list."""
    few = min(t.node[node, CLASHES], 1023)
    f = t.worth[node, PROVEN] + t.worth[node, H]
    t.num[HEAP] = push(t.key[OPEN_LIST], t.item[OPEN_LIST], t.num[HEAP], (f << 10) | few, node)
    if opt[W_MILLION] > 1_000_000:
        t.num[WAITING] = push(t.key[WAIT_LIST], t.item[WAIT_LIST], t.num[WAITING], t.worth[node, COST], node)


@lean_part
def _new_child(r: Roads, w: Work, c: Case, t: Tree, d: Desk, node: int, opt: I64, cut: I64) -> int:
    """A child with one more constraint, its ways replanned. Returns its number, -1 without a plan, -2 for no room."""
    child = np.int64(t.num[NODES])
    agent, kind = cut[0], cut[1]
    t.node[child, PARENT] = node
    for k in range(5):
        t.node[child, AGENT + k] = cut[k]
    t.node[child, KNOWS], t.node[child, STATUS], t.node[child, TURN] = 0, OPEN, -1
    t.node[child, CONFLICT:] = -1
    t.worth[child, COST], t.worth[child, PROVEN] = t.worth[node, COST], t.worth[node, PROVEN]
    n = len(c.start)
    for k in range(n):
        t.rec[child, k] = t.rec[node, k]
    binds_all = kind in (AT, OVER, BY_THEN)
    for k in range(n):
        who = np.int64(k) if binds_all else agent
        if _breaks(r, c, t, child, who):
            old = np.int64(t.rec[child, who])
            most = t.num[BEST_COST] - 1 - (t.worth[child, PROVEN] - t.way[old, LEAST])
            ended = _replan(r, w, c, t, d, child, who, most, opt[W_MILLION])
            if ended == FULL:
                return -2
            if ended != FOUND:
                return -1
            new = np.int64(t.rec[child, who])
            t.worth[child, COST] += t.way[new, PRICE] - t.way[old, PRICE]
            t.worth[child, PROVEN] += t.way[new, LEAST] - t.way[old, LEAST]
        if not binds_all:
            break
    t.num[NODES] += 1
    t.worth[child, H] = max(0, t.worth[node, PROVEN] + t.worth[node, H] - t.worth[child, PROVEN])
    return child


@lean
def _take(t: Tree, node: int) -> None:
    """The node's plan is the new incumbent."""
    t.num[BEST], t.num[BEST_COST], t.num[BEST_NODE] = 1, t.worth[node, COST], node
    for k in range(t.rec.shape[1]):
        t.best[k] = t.rec[node, k]


@lean
def _chosen(t: Tree, node: int) -> None:
    """The node has had its turn."""
    t.node[node, STATUS], t.node[node, TURN] = CHOSEN, t.num[TURNS]
    t.num[TURNS] += 1


@lean_part
def _raised(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, node: int, opt: I64) -> int:
    """Know a node's least extra cost. FOUND when it now stands elsewhere in the open list, or is pruned; else NONE.

    SPENT when the work is spent before it is known.
    """
    if (opt[COVER] == 0 and opt[PAIRED] == 0) or t.node[node, KNOWS] == 1:
        return NONE
    extra = np.int64(0)
    if opt[COVER] > 0:
        extra = np.int64(_cover_bound(r, w, c, t, d, x, y, node, opt[COVER]))
        if extra < 0:
            return SPENT
    t.node[node, KNOWS] = 1
    if opt[PAIRED] == 1:
        extra = max(extra, pair_bound(c, t, d, node))
    if extra <= t.worth[node, H]:
        return NONE
    t.worth[node, H] = extra
    if t.worth[node, PROVEN] + extra >= t.num[BEST_COST]:
        t.node[node, STATUS] = PRUNED
    else:
        _push_open(t, node, opt)
    return FOUND


@lean_part
def _branch(t: Tree, d: Desk, node: int, k: int, low: int, opt: I64) -> None:
    """The constraints that resolve a conflict, into d.cut: (2, 5) vehicle, kind, place, place2, tick of each child.

    low: the vehicle that is constrained first, the other one's rival.
    """
    a, b = np.int64(d.a[k]), np.int64(d.b[k])
    p, q, tick = np.int64(d.place[k]), np.int64(d.place2[k]), np.int64(d.tick[k])
    if low == b:
        a, b = b, a
        if q >= 0:
            p, q = q, p
    cut = t.node[node]  # `a` has the lower priority; it goes p → q
    cut[CONFLICT], cut[CONFLICT + 1], cut[CONFLICT + 2], cut[CONFLICT + 3], cut[CONFLICT + 4] = a, b, p, q, tick
    one, two, not_kind, kind = a, a, NOT_AT, AT
    if q >= 0:
        not_kind, kind = NOT_OVER, OVER
    elif opt[TARGET] == 1 and opt[BRANCH] == 0:
        if tick >= t.way[t.rec[node, a], LENGTH]:
            one, two, not_kind, kind = a, a, LATER, BY_THEN
        elif tick >= t.way[t.rec[node, b], LENGTH]:
            one, two, not_kind, kind = b, b, LATER, BY_THEN
    p2, q2 = p, q
    if opt[DISJOINT] == 0 and kind != BY_THEN:
        two, kind = b, not_kind
        if q >= 0:
            p2, q2 = q, p
    first, second = d.cut[0], d.cut[1]
    first[0], first[1], first[2], first[3], first[4] = one, not_kind, p, q, tick
    second[0], second[1], second[2], second[3], second[4] = two, kind, p2, q2, tick


@lean_part
def _bypassed(t: Tree, node: int, kid: int, own: int) -> bool:
    """Whether a child has the node's cost and fewer conflicts; the node then takes the child's ways."""
    same = t.worth[kid, COST] == t.worth[node, COST] and t.worth[kid, PROVEN] == t.worth[node, PROVEN]
    if not same or t.node[kid, CLASHES] >= own:
        return False
    for j in range(t.rec.shape[1]):
        rec = t.rec[kid, j]
        if rec != t.rec[node, j]:
            t.rec[node, j] = rec
            t.way[rec, MADE_AT], t.way[rec, SEEN] = node, 0
    t.node[node, CLASHES] = t.node[kid, CLASHES]
    t.node[node, KNOWS] = 0
    t.node[node, CONFLICT:] = -1
    return True


@lean_part
def _expand(r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, node: int, opt: I64) -> int:
    """Resolve one conflict of a node. FULL when there is no room, SPENT when the work is: nothing has happened then."""
    while True:
        own = find_conflicts(r.place, t, d, t.rec[node])
        if own == 0:
            _chosen(t, node)
            if t.worth[node, COST] < t.num[BEST_COST]:
                _take(t, node)
            return FOUND
        raised = _raised(r, w, c, t, d, x, y, node, opt)
        if raised != NONE:
            return raised
        k = _choose(r, w, c, t, d, x, node, opt)
        a, b = np.int64(d.a[k]), np.int64(d.b[k])
        low = _priority(c, t, d, node, a, np.int64(d.tick[k]))
        high = _priority(c, t, d, node, b, np.int64(d.tick[k]))
        t.priority[node, 0], t.priority[node, 1] = min(low, high), max(low, high)
        _branch(t, d, node, k, b if high < low else a, opt)
        nodes, recs, arena = t.num[NODES], t.num[RECS], t.num[ARENA]
        bypassed = False
        for turn in range(1 if opt[BRANCH] == 1 else 2):
            kid = _new_child(r, w, c, t, d, node, opt, d.cut[turn])
            if kid == -2:
                t.num[NODES], t.num[RECS], t.num[ARENA] = nodes, recs, arena
                return FULL
        for kid in range(nodes, t.num[NODES]):
            t.node[kid, CLASHES] = find_conflicts(r.place, t, d, t.rec[kid])
            if opt[BYPASS] == 1 and _bypassed(t, node, kid, own):
                bypassed = True
                break
        if bypassed:
            t.num[NODES] = nodes
            continue
        for kid in range(nodes, t.num[NODES]):
            if t.worth[kid, PROVEN] + t.worth[kid, H] >= t.num[BEST_COST]:
                t.node[kid, STATUS] = PRUNED
                continue
            if t.node[kid, CLASHES] == 0 and t.worth[kid, COST] < t.num[BEST_COST]:
                _take(t, kid)
            _push_open(t, kid, opt)
        _chosen(t, node)
        return FOUND


# --- the loop --------------------------------------------------------------------------------------------------------


@lean_part
def _prioritize(r: Roads, w: Work, c: Case, t: Tree, d: Desk, order: I32, kept: int) -> int:
    """Vehicles one after another in an order, earlier ones being obstacles; a better plan becomes the incumbent.

    The first `kept` of the order keep their ways of the incumbent. SPENT when the work is spent before the last one;
    the next call goes on. FULL: the order begins again.
    """
    if t.num[PLACED] == 0:
        t.num[PLACED_RECS], t.num[PLACED_ARENA], t.num[PLACED_COST] = t.num[RECS], t.num[ARENA], 0
        for i in range(kept if t.num[BEST] else 0):
            d.stack[order[i]] = t.best[order[i]]
            t.num[PLACED_COST] += t.way[t.best[order[i]], PRICE]
            t.num[PLACED] += 1
    clear_others(w.others)
    clear_constraints(w.bans)
    finish_constraints(w.bans)
    for i in range(t.num[PLACED]):
        rec = np.int64(d.stack[order[i]])
        add_other(r.place, w.others, t.states, t.way[rec, FIRST], t.way[rec, LENGTH])
    ended = np.int64(FOUND)
    while ended == FOUND and t.num[PLACED] < len(order):
        if t.num[WORK] >= t.num[TILL]:
            return SPENT
        k = np.int64(order[t.num[PLACED]])
        most = t.num[BEST_COST] - 1 - t.num[PLACED_COST]
        for i in range(t.num[PLACED] + 1, len(order)):
            most -= t.way[t.rec[0, order[i]], LEAST]
        d.out[2] = 0
        ended = np.int64(search(
            r, w, c.h[k], np.int64(c.cls[k]), np.int64(c.start[k]), np.int64(c.goal[k]), np.int64(HARD),
            most, np.int64(1_000_000), d.out,
        ))  # fmt: skip
        _count(t, d)
        if ended == FOUND:
            rec = np.int64(_keep_way(t, w.path, k, np.int64(0), d.out, d.out[0]))
            if rec < 0 or not add_other(r.place, w.others, t.states, t.way[rec, FIRST], t.way[rec, LENGTH]):
                ended = np.int64(FULL)
            else:
                d.stack[k] = rec
                t.num[PLACED] += 1
                t.num[PLACED_COST] += d.out[0]
    t.num[PLACED] = 0
    if ended == FOUND and t.num[PLACED_COST] < t.num[BEST_COST]:
        t.num[BEST], t.num[BEST_COST], t.num[BEST_NODE] = 1, t.num[PLACED_COST], -1
        for i in range(len(order)):
            t.best[i] = d.stack[i]
    else:
        t.num[RECS], t.num[ARENA] = t.num[PLACED_RECS], t.num[PLACED_ARENA]
    return FULL if ended == FULL else FOUND


@lean_part
def _root(r: Roads, w: Work, c: Case, t: Tree, d: Desk, opt: I64) -> int:
    """Every vehicle for itself."""
    t.num[RECS], t.num[ARENA], t.num[NODES] = 0, 0, 0
    t.node[0] = -1
    t.node[0, KIND], t.node[0, KNOWS], t.node[0, STATUS] = ROOT, 0, OPEN
    t.worth[0] = 0
    t.rec[0] = -1
    for k in range(len(c.start)):
        ended = _replan(r, w, c, t, d, np.int64(0), np.int64(k), NEVER, opt[W_MILLION])
        if ended != FOUND:
            return ended
        t.worth[0, COST] += t.way[t.rec[0, k], PRICE]
        t.worth[0, PROVEN] += t.way[t.rec[0, k], LEAST]
    t.num[NODES] = 1
    t.node[0, CLASHES] = find_conflicts(r.place, t, d, t.rec[0])
    t.num[BEST], t.num[BEST_COST], t.num[BEST_NODE] = 0, NEVER, -1
    t.num[BOUND] = t.worth[0, PROVEN]
    t.num[TRIED] = t.num[TURNS] = t.num[HEAP] = t.num[FOCAL] = t.num[WAITING] = 0
    if t.node[0, CLASHES] == 0:
        _take(t, np.int64(0))
    return FOUND


@lean
def _weed(t: Tree) -> None:
    """Drop from the front of the open list what is done, out of date or no better than the best plan."""
    keys, items = t.key[OPEN_LIST], t.item[OPEN_LIST]
    while t.num[HEAP] > 0:
        top = np.int64(items[0])
        f = keys[0] >> 10
        if t.node[top, STATUS] == OPEN and f == t.worth[top, PROVEN] + t.worth[top, H]:
            if f < t.num[BEST_COST]:
                return
            t.node[top, STATUS] = PRUNED
        t.num[HEAP] = drop_first(keys, items, t.num[HEAP])


@lean
def _next(t: Tree, wide: int) -> int:
    """The node to expand: least f, or with w > 1 the fewest conflicts among those within the bound."""
    if wide > 1_000_000:
        keys, items = t.key[WAIT_LIST], t.item[WAIT_LIST]
        near, near_items = t.key[FOCAL_LIST], t.item[FOCAL_LIST]
        while t.num[WAITING] > 0 and keys[0] * 1_000_000 <= t.num[BOUND] * wide:
            kid = np.int64(items[0])
            t.num[WAITING] = drop_first(keys, items, t.num[WAITING])
            if t.node[kid, STATUS] == OPEN:
                key = (np.int64(t.node[kid, CLASHES]) << 42) | min(t.worth[kid, COST], 2**42 - 1)
                t.num[FOCAL] = push(near, near_items, t.num[FOCAL], key, kid)
        while t.num[FOCAL] > 0 and t.node[near_items[0], STATUS] != OPEN:
            t.num[FOCAL] = drop_first(near, near_items, t.num[FOCAL])
        if t.num[FOCAL] > 0:
            return np.int64(near_items[0])
    return np.int64(t.item[OPEN_LIST, 0])


@lean
def _cramped(t: Tree, w: Work) -> bool:
    """Whether the next expansion may not find room."""
    most = max(t.num[HEAP], t.num[WAITING], t.num[FOCAL])
    ticks = min(len(w.path), w.others.num[ROOM])
    return t.num[NODES] + 4 >= len(t.node) or most + 8 >= t.key.shape[1] or t.num[LONGEST] * 2 + 16 >= ticks


@lean
def run(
    r: Roads, w: Work, c: Case, t: Tree, d: Desk, x: Layers, y: Layers, opt: I64, nodes: int, expansions: int, work: int
) -> int:  # fmt: skip
    """Go on until the plan is proven, or so many more nodes, single-vehicle expansions or steps of work are spent.

    With no nodes it ends once the root is there, so that c.pair can be filled for its conflicts.
    """
    till_high, till_low = t.num[HIGH] + nodes, t.num[LOW] + expansions
    t.num[TILL] = t.num[WORK] + work
    if t.num[STAGE] == 0:
        ended = np.int64(_root(r, w, c, t, d, opt))
        if ended != FOUND:
            return GROW if ended == FULL else EMPTY
        t.num[STAGE] = 1
        if nodes == 0:
            return MORE
    if t.num[STAGE] == 1:
        if opt[PAIRED] == 1:
            t.worth[0, H] = pair_bound(c, t, d, np.int64(0))
            t.num[BOUND] += t.worth[0, H]
        _push_open(t, np.int64(0), opt)
        t.num[STAGE] = 2
    while t.num[TRIED] < len(c.orders):
        if t.num[BEST] == 1 and t.num[BEST_COST] * 1_000_000 <= t.num[BOUND] * opt[W_MILLION]:
            break
        if t.num[LOW] >= till_low:
            return MORE
        kept = 0 if t.num[TRIED] < opt[TRIES] else max(len(c.start) - 2 - t.num[TRIED] % REPLANNED, 0)
        ended = np.int64(_prioritize(r, w, c, t, d, c.orders[t.num[TRIED]], np.int64(kept)))
        if ended != FOUND:
            return GROW if ended == FULL else MORE
        t.num[TRIED] += 1
    while True:
        _weed(t)
        if t.num[HEAP] == 0:
            if t.num[BEST] == 0:
                return EMPTY
            t.num[BOUND] = max(t.num[BOUND], t.num[BEST_COST])
            return DONE
        t.num[BOUND] = max(t.num[BOUND], t.key[OPEN_LIST, 0] >> 10)
        if t.num[BEST] == 1 and t.num[BEST_COST] * 1_000_000 <= t.num[BOUND] * opt[W_MILLION]:
            return DONE
        if t.num[HIGH] >= till_high or t.num[LOW] >= till_low or t.num[WORK] >= t.num[TILL]:
            return MORE
        if _cramped(t, w):
            return GROW
        node = _next(t, opt[W_MILLION])
        raised = t.worth[node, PROVEN] + t.worth[node, H]
        ended = np.int64(_expand(r, w, c, t, d, x, y, node, opt))
        if ended == FULL:
            return GROW
        if ended == SPENT:
            return MORE
        # a node that only moved up in the open list is not expanded yet
        if t.node[node, STATUS] == CHOSEN or raised == t.worth[node, PROVEN] + t.worth[node, H]:
            t.num[HIGH] += 1
