"""The step: ends what ends, starts what may start, moves energy. One call runs until somebody must decide.

Order within a tick t: intervals that end at t end; deciders are called (outside); steps that are due start; energy of
[t, t+1) is drawn. A step starts when its claims are the first of their places: the dependency graph in action.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean, lean_inline
from engine.sim.state import (
    ARRIVED,
    CHARGED,
    DECIDE,
    DELAY_HI,
    DELAY_LO,
    DELAY_PPM,
    EMPTY,
    HALF,
    HOLD,
    I8,
    I32,
    I64,
    LATE,
    LINGERING,
    LOW,
    MARGIN,
    NC,
    OPEN_LOOP,
    ORDER_DONE,
    PATIENCE,
    PICKED,
    RESTLESS,
    SAMPLE,
    SEED,
    STALLED,
    TICK,
    Fleet,
    Levels,
    Sink,
)
from engine.traffic import FAR, Claims, GraphArrays, Steps, release
from engine.types import FOREVER, NONE, PRIMITIVE_0, Activity, Cause, Component, Task, VehicleState

WAIT, PICK, DROP, CHARGE = int(Activity.WAIT), int(Activity.PICK), int(Activity.DROP), int(Activity.CHARGE)
REST, FAULT, PAUSE = int(Activity.REST), int(Activity.FAULT), int(Activity.PAUSE)
C_NONE, C_PLANNED, C_VEHICLE, C_BLOCKED = int(Cause.NONE), int(Cause.PLANNED), int(Cause.VEHICLE), int(Cause.BLOCKED)
C_DELAY, C_NO_PLAN, C_OPERATOR = int(Cause.DELAY), int(Cause.NO_PLAN), int(Cause.OPERATOR)
C_EMPTY = int(Cause.EMPTY)
V_IDLE, V_MOVING, V_WAITING = int(VehicleState.IDLE), int(VehicleState.MOVING), int(VehicleState.WAITING)
V_LOADING, V_TO_CHARGER, V_CHARGING = (
    int(VehicleState.LOADING),
    int(VehicleState.TO_CHARGER),
    int(VehicleState.CHARGING),
)
V_FAULT, V_PAUSED = int(VehicleState.FAULT), int(VehicleState.PAUSED)
STANDBY, CHARGED_MJ, LOSS = int(Component.STANDBY), int(Component.CHARGED), int(Component.CHARGER_LOSS)
TO_CHARGER, TO_DROP = int(Task.TO_CHARGER), int(Task.TO_DROP)
P0 = int(PRIMITIVE_0)
GO, HALT, YIELD = 1, 2, 3
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]


@lean
def noise(seed: int, vehicle: int, draw: int) -> int:
    """A 63-bit hash (splitmix64) of seed, vehicle and draw number."""
    x = (
        np.uint64(seed)
        + np.uint64(vehicle) * np.uint64(0x9E3779B97F4A7C15)
        + np.uint64(draw) * np.uint64(0xD1B54A32D192ED03)
    )
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.int64((x ^ (x >> np.uint64(31))) >> np.uint64(1))


@lean
def close_interval(f: Fleet, g: GraphArrays, sink: Sink, total_mj: I64, v: int, t: int) -> None:
    """Write the open interval of a vehicle to the log, ending at t."""
    if t <= f.t0[v]:
        return
    n = sink.filled[0]
    row = sink.motions[n]
    here = g.state_place[f.state[v]]
    heading = g.state_heading[f.state[v]]
    row[0], row[1], row[2], row[3], row[4], row[5] = v, f.kind[v], f.cause[v], f.blocker[v], f.t0[v], t
    row[6], row[7], row[8], row[9] = here, here, heading, heading
    row[10], row[11], row[12], row[13] = f.loaded[v], f.of_order[v], f.of_task[v], 0
    if f.edge[v] >= 0:
        to = g.edge_to[f.edge[v]]
        row[7], row[9] = g.state_place[to], g.state_heading[to]
        row[13] = total_mj[f.cls[v], f.loaded[v], f.kind[v] - P0]
    sink.filled[0] = n + 1


@lean
def open_interval(
    f: Fleet, g: GraphArrays, sink: Sink, total_mj: I64, v: int, kind: int, cause: int, blocker: int, t: int, t1: int
) -> None:
    """Begin an interval unless the same one is already open."""
    same = f.kind[v] == kind and f.cause[v] == cause and f.blocker[v] == blocker and f.t1[v] == t1
    if same and kind < P0 and f.of_order[v] == f.order[v] and f.of_task[v] == f.task[v]:
        return
    close_interval(f, g, sink, total_mj, v, t)
    begin_interval(f, v, kind, cause, blocker, t, t1)


@lean
def begin_interval(f: Fleet, v: int, kind: int, cause: int, blocker: int, t: int, t1: int) -> None:
    """Set what the open interval is."""
    f.kind[v], f.cause[v], f.blocker[v], f.t0[v], f.t1[v] = kind, cause, blocker, t, t1
    f.of_order[v], f.of_task[v] = f.order[v], f.task[v]


@lean
def mark(f: Fleet, sink: Sink, levels: Levels, clock: I64, v: int, bit: int, t: int) -> None:
    """Tell the deciders. A load picked up may wait until they are asked, unless plans or batteries depend on it."""
    if bit != PICKED or clock[LATE] or clock[RESTLESS] or f.charge[v] < levels.good[v]:
        clock[DECIDE] = 1
    n = sink.filled[3]
    sink.marks[n, 0], sink.marks[n, 1], sink.marks[n, 2], sink.marks[n, 3] = t, v, bit, f.order[v]
    sink.filled[3] = n + 1


@lean
def leave(c: Claims, clock: I64, linger: I32, slot: int) -> None:
    """A vehicle has left a claimed place: the claim goes now, or after the margin."""
    if clock[MARGIN] == 0:
        release(c, slot)
    else:
        linger[clock[LINGERING]] = slot
        clock[LINGERING] += 1


@lean
def finish(
    f: Fleet, g: GraphArrays, c: Claims, sink: Sink, total_mj: I64, levels: Levels, clock: I64, linger: I32, v: int,
    t: int,
) -> None:  # fmt: skip
    """End the interval of a vehicle that is due at t."""
    kind = f.kind[v]
    close_interval(f, g, sink, total_mj, v, t)
    if kind >= P0:
        f.state[v] = g.edge_to[f.edge[v]]
        f.distance[v] += g.kind_mm[kind - P0]
        f.rolled[v] = t
        f.edge[v] = NONE
        if f.back[v] >= 0:
            leave(c, clock, linger, f.back[v])
            f.back[v] = NONE
        for i in range(2):
            if f.sweep[v, i] >= 0:
                leave(c, clock, linger, f.sweep[v, i])
                f.sweep[v, i] = NONE
    elif kind == PICK:
        f.loaded[v] = 1
        f.task[v] = TO_DROP
        mark(f, sink, levels, clock, v, PICKED, t)
    elif kind == DROP:
        f.loaded[v] = 0
        f.done[v] += 1
        mark(f, sink, levels, clock, v, ORDER_DONE, t)
    begin_interval(f, v, WAIT, C_PLANNED, NONE, t, FOREVER)
    f.wake[v] = t
    if f.step[v] == f.steps[v]:
        mark(f, sink, levels, clock, v, ARRIVED, t)


@lean
def first(c: Claims, slot: int) -> int:
    """NONE when a claim is the first of its place, but for its owner's own margin; else the owner of the one before."""
    if slot < 0 or c.owner[c.prev[slot]] == c.owner[slot]:
        return NONE
    return c.owner[c.prev[slot]]


@lean_inline
def due(
    f: Fleet,
    p: Steps,
    g: GraphArrays,
    sink: Sink,
    total_mj: I64,
    standby_mj: I64,
    levels: Levels,
    clock: I64,
    v: int,
    t: int,
) -> bool:
    """True when a vehicle's next motion is due at t; otherwise it starts its stay, or says why it stands.

    Sets the tick at which to ask again; until then nothing changes without the deciders.
    """
    f.wake[v] = FOREVER
    if f.failed[v]:
        open_interval(f, g, sink, total_mj, v, FAULT, C_NONE, NONE, t, FOREVER)
        return False
    if f.paused[v]:
        open_interval(f, g, sink, total_mj, v, PAUSE, C_OPERATOR, NONE, t, FOREVER)
        clock[LATE] = 1
        return False
    k = f.step[v]
    if k >= f.steps[v]:
        kind, cause = f.final[v], C_NONE
        if kind == WAIT:
            cause = C_NO_PLAN
        elif kind == CHARGE:
            f.wake[v] = t + 1
            resting = f.kind[v] == REST and f.t0[v] < t
            if f.charge[v] >= levels.full[v] or (resting and f.charge[v] >= levels.top_up[v]):
                kind = REST
        open_interval(f, g, sink, total_mj, v, kind, cause, NONE, t, FOREVER)
        return False
    if f.hold[v] > t:
        f.wake[v] = f.hold[v]
        open_interval(f, g, sink, total_mj, v, WAIT, C_DELAY, NONE, t, FOREVER)
        clock[LATE] = 1
        return False
    if t < p.start[v, k] < FAR:
        f.wake[v] = p.start[v, k]
        open_interval(f, g, sink, total_mj, v, WAIT, C_PLANNED, NONE, t, FOREVER)
        return False
    if p.edge[v, k] < 0:
        if p.start[v, k] < t:
            clock[LATE] = 1
        f.step[v] = k + 1
        f.state[v] &= ~1
        open_interval(f, g, sink, total_mj, v, p.what[v, k], C_NONE, NONE, t, t + p.end[v, k] - p.start[v, k])
        return False
    if clock[DELAY_PPM] > 0 and f.drawn[v] != f.motions[v]:
        f.drawn[v] = f.motions[v]
        r = noise(clock[SEED], v, f.motions[v])
        if r % 1_000_000 < clock[DELAY_PPM]:
            f.hold[v] = t + clock[DELAY_LO] + (r // 1_000_000) % (clock[DELAY_HI] - clock[DELAY_LO] + 1)
            clock[LATE] = 1
            if f.hold[v] > t:
                f.wake[v] = f.hold[v]
                open_interval(f, g, sink, total_mj, v, WAIT, C_DELAY, NONE, t, FOREVER)
                return False
    kind = g.edge_kind[motion_now(f, p, g, v, t)]
    need = total_mj[f.cls[v], f.loaded[v], kind] + g.kind_ticks[kind] * standby_mj[f.cls[v]]
    spent = need * 1000 > f.charge[v] * voltage(levels, f.charge[v], levels.capacity[v])
    if spent and clock[OPEN_LOOP] == 0:
        open_interval(f, g, sink, total_mj, v, WAIT, C_EMPTY, NONE, t, FOREVER)
        clock[LATE] = 1
        return False
    return True


@lean
def motion_now(f: Fleet, p: Steps, g: GraphArrays, v: int, t: int) -> int:
    """Edge of a vehicle's next motion at t: from rest, unless it came rolling into this very tick."""
    e = p.edge[v, f.step[v]]
    rolling = f.rolled[v] == t and f.state[v] & 1 == 1
    return e if (g.edge_from[e] & 1 == 1) == rolling else g.edge_twin[e]


@lean
def voltage(levels: Levels, charge: int, capacity: int) -> int:
    """Voltage in mV at a charge, from the battery's table."""
    return levels.voltage_mv[sample_at(levels, charge, capacity)]


@lean
def sample_at(levels: Levels, charge: int, capacity: int) -> int:
    """Index of a charge in the battery's tables."""
    last = len(levels.voltage_mv) - 1
    return min(max(charge * last // capacity, 0), last)


@lean
def start_motion(
    f: Fleet, p: Steps, g: GraphArrays, c: Claims, sink: Sink, total_mj: I64, clock: I64, v: int, t: int
) -> None:
    """Begin the next motion of a vehicle."""
    k = f.step[v]
    e = motion_now(f, p, g, v, t)
    f.state[v] = g.edge_from[e]
    kind = g.edge_kind[e]
    end = t + g.kind_ticks[kind]
    if end != p.end[v, k]:
        clock[LATE] = 1
    open_interval(f, g, sink, total_mj, v, P0 + kind, C_NONE, NONE, t, end)
    f.edge[v] = e
    f.step[v] = k + 1
    f.motions[v] += 1
    f.stalled[v] = -1
    if p.claim[v, k] >= 0:
        if clock[HOLD] == 1:
            f.back[v] = f.here[v]
            c.end[f.here[v]] = end + clock[MARGIN]
        else:
            release(c, f.here[v])
        f.here[v] = p.claim[v, k]
        f.sweep[v, 0], f.sweep[v, 1] = p.sweep0[v, k], p.sweep1[v, k]


@lean
def cross(f: Fleet, p: Steps, g: GraphArrays, v: int, w: int) -> bool:
    """True when the next motion of w is the other diagonal of the block over which v drives next."""
    at, b = g.sweep_ptr[p.edge[v, f.step[v]]], p.edge[w, f.step[w]]
    here, there = g.state_place[g.edge_from[b]], g.state_place[g.edge_to[b]]
    x, y = g.sweep[at], g.sweep[at + 1]
    return (x == here and y == there) or (x == there and y == here)


@lean_inline
def start_steps(
    f: Fleet,
    p: Steps,
    g: GraphArrays,
    c: Claims,
    sink: Sink,
    total_mj: I64,
    standby_mj: I64,
    levels: Levels,
    clock: I64,
    blocked: U8,
    go: I8,
    wait_for: I32,
    t: int,
) -> None:
    """Start every step that is due and free to start; a vehicle that may not, waits and says for whom.

    In an open loop nobody waits for anybody: what was planned happens, collisions too.
    """
    n = len(f.state)
    for v in range(n):
        go[v] = 0
        if f.wake[v] > t or f.t1[v] < FOREVER or not due(f, p, g, sink, total_mj, standby_mj, levels, clock, v, t):
            continue
        go[v] = GO
        k = f.step[v]
        wait_for[v] = max(first(c, p.claim[v, k]), first(c, p.sweep0[v, k]), first(c, p.sweep1[v, k]))
        if p.claim[v, k] >= 0 and blocked[g.state_place[g.edge_to[p.edge[v, k]]]]:
            go[v] = HALT
        elif wait_for[v] >= 0 and clock[HOLD] == 1 and clock[OPEN_LOOP] == 0:
            go[v] = YIELD
    if clock[HOLD] == 0 and clock[OPEN_LOOP] == 0:
        # classical rule: following and rotating is allowed, so the largest set that can move together moves
        changed = True
        while changed:
            changed = False
            for v in range(n):
                if go[v] != GO:
                    continue
                # diagonals planned for different ticks may be due at one when somebody is late
                e = p.edge[v, f.step[v]]
                for w in range(v if g.sweep_ptr[e + 1] - g.sweep_ptr[e] == 2 else 0):
                    if go[w] == GO and cross(f, p, g, v, w):
                        go[v], wait_for[v] = YIELD, w
                        changed = True
                        break
                if go[v] != GO or wait_for[v] < 0:
                    continue
                b = wait_for[v]
                before = c.prev[p.claim[v, f.step[v]]]
                follows = go[b] == GO and f.here[b] == before and p.claim[b, f.step[b]] >= 0
                if not follows or c.owner[c.prev[before]] >= 0:
                    go[v] = YIELD
                    changed = True
    for v in range(n):
        if go[v] == GO:
            start_motion(f, p, g, c, sink, total_mj, clock, v, t)
        elif go[v] != 0:
            f.wake[v] = t + 1
            clock[LATE] = 1
            if f.stalled[v] < 0:
                f.stalled[v] = t
            elif (t - f.stalled[v]) % clock[PATIENCE] == 0:
                mark(f, sink, levels, clock, v, STALLED, t)
            if go[v] == HALT:
                open_interval(f, g, sink, total_mj, v, WAIT, C_BLOCKED, NONE, t, FOREVER)
            else:
                open_interval(f, g, sink, total_mj, v, WAIT, C_VEHICLE, wait_for[v], t, FOREVER)


@lean
def show_states(f: Fleet, sink: Sink, t: int) -> None:
    """A states row for every vehicle whose state, task, order or reason changed."""
    for v in range(len(f.state)):
        kind = f.kind[v]
        if kind >= P0:
            state = V_TO_CHARGER if f.task[v] == TO_CHARGER else V_MOVING
        elif kind == WAIT:
            state = V_WAITING
        elif kind in (PICK, DROP):
            state = V_LOADING
        elif kind == CHARGE:
            state = V_CHARGING
        elif kind == FAULT:
            state = V_FAULT
        elif kind == PAUSE:
            state = V_PAUSED
        else:
            state = V_IDLE
        s = f.shown[v]
        if s[0] != state or s[1] != f.task[v] or s[2] != f.order[v] or s[3] != f.cause[v] or s[4] != f.blocker[v]:
            s[0], s[1], s[2], s[3], s[4] = state, f.task[v], f.order[v], f.cause[v], f.blocker[v]
            row = sink.states[sink.filled[2]]
            row[0], row[1] = t, v
            row[2], row[3], row[4], row[5], row[6] = s[0], s[1], s[2], s[3], s[4]
            sink.filled[2] += 1


@lean_inline
def draw_energy(
    f: Fleet, g: GraphArrays, sink: Sink, mj: I64, standby_mj: I64, levels: Levels, clock: I64, t: int
) -> None:
    """Move the energy of [t, t+1): motion spread over its ticks by cumulative floor, standby, charging."""
    for v in range(len(f.state)):
        drawn = np.int64(0)
        if f.kind[v] >= P0:
            cost = mj[f.cls[v], f.loaded[v], f.kind[v] - P0]
            span, past = f.t1[v] - f.t0[v], t - f.t0[v]
            for i in range(cost.shape[0]):
                if cost[i] != 0:
                    part = cost[i] if span == 1 else cost[i] * (past + 1) // span - cost[i] * past // span
                    f.ledger[v, i] += part
                    drawn += part
        if f.charge[v] > 0 or clock[OPEN_LOOP] == 1:
            f.ledger[v, STANDBY] += standby_mj[f.cls[v]]
            drawn += standby_mj[f.cls[v]]
        volt = voltage(levels, f.charge[v], levels.capacity[v])
        if f.kind[v] == CHARGE:
            gross, net = levels.power[0], levels.power[1]
            room = ((levels.full[v] - f.charge[v]) * volt + 999) // 1000
            room = min(room, levels.accept_mj[sample_at(levels, f.charge[v], levels.capacity[v])]) + drawn
            if net > room:
                gross, net = gross * room // net, room
            f.ledger[v, CHARGED_MJ] -= gross
            f.ledger[v, LOSS] += gross - net
            drawn -= net
        before = f.charge[v]
        work = drawn * 1000 + f.rest[v]
        moved = work // volt
        if moved >= before > 0 and clock[OPEN_LOOP] == 0:
            # standby gets what is left of the charge, and no more
            f.ledger[v, STANDBY] -= drawn - (before * volt - f.rest[v]) // 1000
            moved, work = before, before * volt
        f.rest[v] = work - moved * volt
        f.charge[v] = before - moved
        if before < levels.sufficient[v] <= f.charge[v] or before < levels.full[v] <= f.charge[v]:
            mark(f, sink, levels, clock, v, CHARGED, t + 1)
        if before >= levels.good[v] > f.charge[v] and f.order[v] == NONE:
            mark(f, sink, levels, clock, v, LOW, t + 1)
        if f.charge[v] <= 0 and before > 0:
            mark(f, sink, levels, clock, v, EMPTY, t + 1)


@lean
def sample(f: Fleet, sink: Sink, levels: Levels, t: int) -> None:
    """A battery row for every vehicle."""
    for v in range(len(f.state)):
        row = sink.battery[sink.filled[1]]
        row[0], row[1], row[2] = t, v, f.charge[v]
        row[3] = voltage(levels, f.charge[v], levels.capacity[v])
        for i in range(NC):
            row[4 + i] = f.ledger[v, i]
        f.sampled[v] = f.charge[v]
        sink.filled[1] += 1


@lean
def run(
    f: Fleet,
    p: Steps,
    g: GraphArrays,
    c: Claims,
    sink: Sink,
    mj: I64,
    total_mj: I64,
    standby_mj: I64,
    levels: Levels,
    clock: I64,
    blocked: U8,
    linger: I32,
    go: I8,
    wait_for: I32,
    until: int,
) -> int:
    """Advance to tick `until`. 0: arrived there · 1: somebody must decide at clock[TICK] · 2: row buffers are full."""
    n = len(f.state)
    f.wake[:] = clock[TICK]  # the deciders may have changed anything
    while True:
        t = clock[TICK]
        if clock[HALF] == 0:
            i = 0
            while i < clock[LINGERING]:
                if c.end[linger[i]] <= t:
                    release(c, linger[i])
                    clock[LINGERING] -= 1
                    linger[i] = linger[clock[LINGERING]]
                else:
                    i += 1
            for v in range(n):
                if f.t1[v] == t:
                    finish(f, g, c, sink, total_mj, levels, clock, linger, v, t)
            clock[HALF] = 1
        if clock[DECIDE] == 1:
            clock[DECIDE] = 0
            return 1
        if t >= until:
            return 0
        deep = max(sink.filled[0], sink.filled[1], sink.filled[2], sink.filled[3])
        if deep + 4 * n + 8 > len(sink.motions):
            return 2
        start_steps(f, p, g, c, sink, total_mj, standby_mj, levels, clock, blocked, go, wait_for, t)
        show_states(f, sink, t)
        draw_energy(f, g, sink, mj, standby_mj, levels, clock, t)
        if (t + 1) % clock[SAMPLE] == 0:
            sample(f, sink, levels, t + 1)
        clock[TICK] = t + 1
        clock[HALF] = 0


@lean
def refresh(
    edge: I32, state: I32, charge: I64, edge_to: I32, below_mv: I64, voltage_mv: I64, capacity: int, at: I32,
    charge_mj: I64,
) -> None:  # fmt: skip
    """Where each vehicle's next plan would start, and its energy (Battery.energy_mj), into the last two."""
    last = len(voltage_mv) - 1
    for v in range(len(edge)):
        at[v] = edge_to[edge[v]] if edge[v] >= 0 else state[v]
        q = max(charge[v], 0)
        i = min(q * last // capacity, last)
        charge_mj[v] = (below_mv[i] * capacity + voltage_mv[i] * (q * last - i * capacity)) // (1000 * last)


@lean
def digest(lanes: U64, rows: I64, count: int) -> None:
    """Fold rows of integers into two 64-bit lanes, in order; independent of how rows are batched."""
    a, b = lanes[0], lanes[1]
    for i in range(count):
        for x in rows[i]:
            a = (a ^ np.uint64(x)) * np.uint64(0x9E3779B97F4A7C15)
            a ^= a >> np.uint64(29)
            b = (b + np.uint64(x)) * np.uint64(0xD6E8FEB86659FD93)
            b ^= b >> np.uint64(32)
    lanes[0], lanes[1] = a, b
