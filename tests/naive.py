"""Slow, obvious twins of the engine's fast code, in plain Python. They share no code with what they check.

A reservation is (place, start, end, owner): the place is somebody's during [start, end). Everything is looked up by
going through all of them, every search tries every tick, and nothing is kept from one call to the next.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

FOREVER = 2**30
WAIT = "wait"
STAY = "stay"
Reservation = tuple[int, int, int, int]
Motion = dict[str, int]


# ---------------------------------------------------------------- the floor


@dataclass(frozen=True)
class Edge:
    """One motion, with everything that matters about it spelled out."""

    number: int
    source: int
    target: int
    from_place: int
    to_place: int
    kind: int
    ticks: int
    corners: tuple[int, ...]


@dataclass
class Floor:
    """A motion graph as lists, the occupancy rule, and what is blocked."""

    graph: Any = field(repr=False)
    hold: bool
    margin: int
    blocked: frozenset[int] = frozenset()
    edges: list[Edge] = field(init=False, repr=False)
    leaving: dict[int, list[Edge]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        g = self.graph
        place = g.state_place.tolist()
        self.edges = [
            Edge(
                e, int(g.edge_from[e]), int(g.edge_to[e]), place[g.edge_from[e]], place[g.edge_to[e]],
                int(g.edge_kind[e]), g.primitives[g.edge_kind[e]].ticks,
                tuple(g.sweep[g.sweep_ptr[e] : g.sweep_ptr[e + 1]].tolist()),
            )
            for e in range(g.n_edges)
        ]  # fmt: skip
        self.leaving = defaultdict(list)
        for e in self.edges:
            self.leaving[e.source].append(e)

    def place(self, state: int) -> int:
        return int(self.graph.state_place[state])

    def standing(self, state: int) -> int:
        return int(self.graph.stopped[state])


def costs_to(graph: Any, cost: Sequence[Any], goal: int, nothing: Any, states: Sequence[int]) -> dict[int, Any]:
    """Least cost from each of some states to a place, by relaxing every edge until nothing changes any more.

    cost: of each kind of motion, anything that adds and compares; `nothing` is its zero.
    """
    allowed = set(states)
    best = {s: nothing for s in states if graph.state_place[s] == goal}
    changed = True
    while changed:
        changed = False
        for e in range(graph.n_edges):
            a, b = int(graph.edge_from[e]), int(graph.edge_to[e])
            if a not in allowed or b not in best:
                continue
            through = best[b] + cost[graph.edge_kind[e]]
            if a not in best or through < best[a]:
                best[a] = through
                changed = True
    return best


class Pair(tuple[int, int]):
    """(ticks, mJ) that adds by parts and compares by ticks, then mJ."""

    def __add__(self, other: Any) -> Pair:
        return Pair((self[0] + other[0], self[1] + other[1]))


# ---------------------------------------------------------------- who may go where, when


def is_free(reservations: Sequence[Reservation], place: int, start: int, end: int) -> bool:
    """Nobody has the place at any time during [start, end)."""
    return not any(p == place and a < end and start < b for p, a, b, _ in reservations)


def goes_from_to(reservations: Sequence[Reservation], a: int, b: int, tick: int) -> bool:
    """Somebody is at a at a tick and at b at the next one (classical rule)."""
    last_at_a = {owner for p, _, end, owner in reservations if p == a and end == tick + 1}
    first_at_b = {owner for p, start, _, owner in reservations if p == b and start == tick + 1}
    return bool(last_at_a & first_at_b)


def may_wait(floor: Floor, reservations: Sequence[Reservation], place: int, tick: int) -> bool:
    """A vehicle in a place may still be there one tick later."""
    at = tick if floor.hold else tick + 1
    return is_free(reservations, place, at, at + 1)


def may_drive(floor: Floor, reservations: Sequence[Reservation], e: Edge, tick: int) -> bool:
    """A motion may start at a tick."""
    end = tick + e.ticks
    drives = e.from_place != e.to_place
    if drives and (e.to_place in floor.blocked or any(c in floor.blocked for c in e.corners)):
        return False
    if floor.hold:
        return (
            is_free(reservations, e.from_place, tick, end + floor.margin)
            and (not drives or is_free(reservations, e.to_place, tick, end))
            and all(is_free(reservations, c, tick, end + floor.margin) for c in e.corners)
        )
    assert e.ticks == 1
    if not is_free(reservations, e.to_place, tick + 1, tick + 2):
        return False
    if goes_from_to(reservations, e.to_place, e.from_place, tick):
        return False
    if e.corners:
        a, b = e.corners
        return not goes_from_to(reservations, a, b, tick) and not goes_from_to(reservations, b, a, tick)
    return True


def may_stay(floor: Floor, reservations: Sequence[Reservation], place: int, tick: int, ticks: int) -> bool:
    """A vehicle that is in a place at a tick may remain there so long."""
    return all(may_wait(floor, reservations, place, t) for t in range(tick, tick + ticks))


@dataclass(frozen=True)
class Goal:
    """Where to, how long to stay there, and what a motion on the way costs by kind."""

    place: int
    stay: int
    cost: Sequence[int]


def after(
    floor: Floor,
    reservations: Sequence[Reservation],
    goals: Sequence[Goal],
    standby: int,
    state: int,
    leg: int,
    tick: int,
) -> Iterator[tuple[int, int, int, int, Any]]:
    """Everything a vehicle may do next, as (state, goals reached, tick, mJ, what)."""
    here = floor.place(state)
    goal = goals[leg]
    if here == goal.place:
        if leg == len(goals) - 1:
            if is_free(reservations, here, tick + (not floor.hold), FOREVER):
                yield state, leg + 1, tick + goal.stay, goal.stay * standby, STAY
        elif may_stay(floor, reservations, here, tick, goal.stay):
            then = floor.standing(state) if goal.stay else state
            yield then, leg + 1, tick + goal.stay, goal.stay * standby, STAY
    for e in floor.leaving[state]:
        if may_drive(floor, reservations, e, tick):
            yield e.target, leg, tick + e.ticks, goal.cost[e.kind] + e.ticks * standby, e
    if may_wait(floor, reservations, here, tick):
        yield floor.standing(state), leg, tick + 1, standby, WAIT


def space_time(
    floor: Floor,
    reservations: Sequence[Reservation],
    goals: Sequence[Goal],
    standby: int,
    state: int,
    tick: int,
    by: str,
) -> tuple[int, int] | None:
    """Least ticks, or least mJ and then ticks, through all goals over (state, tick, goals reached); None without a way.

    Returns (ticks, mJ of some such way) by `time`, (mJ, ticks) by `energy`.

    Once the last reservation has begun or ended nothing changes any more, so all later ticks are one.
    """
    bounds = [t for _, a, b, _ in reservations for t in (a, b) if t < FOREVER]
    calm = max([tick, *bounds]) + 1
    queue: list[tuple[tuple[int, int], int, int, int, int, int]] = [((0, 0), 0, tick, state, 0, 0)]
    done: set[tuple[int, int, int]] = set()
    pushed = 0
    while queue:
        _, _, t, s, leg, mj = heapq.heappop(queue)
        if leg == len(goals):
            return (t - tick, mj) if by == "time" else (mj, t - tick)
        key = (s, leg, min(t, calm))
        if key in done:
            continue
        done.add(key)
        for s2, leg2, t2, cost, _ in after(floor, reservations, goals, standby, s, leg, t):
            pushed += 1
            worth = (t2 - tick, 0) if by == "time" else (mj + cost, t2 - tick)
            heapq.heappush(queue, (worth, pushed, t2, s2, leg2, mj + cost))
    return None


# ---------------------------------------------------------------- plans


def play(
    floor: Floor,
    reservations: Sequence[Reservation],
    goals: Sequence[Goal],
    standby: int,
    state: int,
    tick: int,
    plan: Any,
) -> tuple[int, int]:
    """Carry a plan out tick by tick and complain about everything illegal; returns (arrival, mJ)."""
    t, leg, mj = tick, 0, 0
    for e, start, end in zip(plan.edges.tolist(), plan.starts.tolist(), plan.ends.tolist(), strict=True):
        assert start >= t, f"step at {start} begins before the one before it ends at {t}"
        while t < start:
            assert may_wait(floor, reservations, floor.place(state), t), f"waits at {t} where it may not"
            state, t, mj = floor.standing(state), t + 1, mj + standby
        if e < 0:
            goal = goals[leg]
            assert floor.place(state) == goal.place, f"stays at {floor.place(state)}, not at its goal {goal.place}"
            assert end - start == goal.stay
            assert may_stay(floor, reservations, goal.place, t, goal.stay), f"stays from {t} where it may not"
            state = floor.standing(state) if goal.stay else state
            t, leg, mj = end, leg + 1, mj + goal.stay * standby
            continue
        edge = floor.edges[e]
        assert edge.source == state, f"motion {e} leaves state {edge.source}, the vehicle is in {state} at {t}"
        assert end - start == edge.ticks
        assert may_drive(floor, reservations, edge, t), f"drives at {t} from {edge.from_place} to {edge.to_place}"
        state, t = edge.target, end
        mj += goals[leg].cost[edge.kind] + edge.ticks * standby
    assert leg == len(goals) - 1, f"{leg} of {len(goals)} goals were reached"
    assert floor.place(state) == goals[-1].place, "ends elsewhere"
    assert is_free(reservations, goals[-1].place, t + (not floor.hold), FOREVER), "ends where it can't stay"
    return t - tick, mj


def route_in_time(
    floor: Floor, reservations: Sequence[Reservation], items: Sequence[tuple[str, int]], state: int, tick: int
) -> int | None:
    """Earliest arrival along a fixed route: ("go", pose) drives into a pose, ("stay", ticks) stays; None if never."""
    bounds = [t for _, a, b, _ in reservations for t in (a, b) if t < FOREVER]
    calm = max([tick, *bounds]) + 1
    queue = [(tick, 0, state)]
    done = set()
    while queue:
        t, i, s = heapq.heappop(queue)
        if i == len(items):
            return t
        if (min(t, calm), i, s) in done:
            continue
        done.add((min(t, calm), i, s))
        here = floor.place(s)
        word, what = items[i]
        if word == STAY and i == len(items) - 1:
            if is_free(reservations, here, t + (not floor.hold), FOREVER):
                heapq.heappush(queue, (t, i + 1, s))
        elif word == STAY:
            if may_stay(floor, reservations, here, t, what):
                heapq.heappush(queue, (t + what, i + 1, floor.standing(s) if what else s))
        else:
            for e in floor.leaving[s]:
                if e.target >> 1 == what and may_drive(floor, reservations, e, t):
                    heapq.heappush(queue, (t + e.ticks, i + 1, e.target))
        if may_wait(floor, reservations, here, t):
            heapq.heappush(queue, (t + 1, i, floor.standing(s)))
    return None


def reservations_of(
    floor: Floor, owner: int, place: int, since: int, drives: Sequence[tuple[Edge, int]], until: int
) -> list[Reservation]:
    """What somebody occupies who is in a place since a tick, then drives (edge, start) …, and vanishes at `until`."""
    out: list[Reservation] = []
    for e, start in drives:
        if e.from_place == e.to_place:
            continue
        end = start + e.ticks
        out.append((place, since, end + floor.margin if floor.hold else start + 1, owner))
        if floor.hold:
            out += [(c, start, end + floor.margin, owner) for c in e.corners]
        place, since = e.to_place, start if floor.hold else end
    out.append((place, since, until, owner))
    return out


# ---------------------------------------------------------------- lists of claims


@dataclass
class Intervals:
    """Claims of one place as a list of [start, end, name], always sorted, never thought about."""

    rows: list[tuple[int, int, int]] = field(default_factory=list)

    def add(self, start: int, end: int, name: int) -> None:
        self.rows = sorted([*self.rows, (start, end, name)])

    def remove(self, name: int) -> None:
        self.rows = [r for r in self.rows if r[2] != name]

    def taken(self, tick: int) -> bool:
        return any(a <= tick < b for a, b, _ in self.rows)

    def before(self, tick: int) -> int | None:
        """Name of the last claim that is over by a tick."""
        over = [r for r in self.rows if r[1] <= tick]
        return over[-1][2] if over else None

    def opens_until(self, tick: int) -> int:
        """When the next claim after a tick starts."""
        return min((a for a, _, _ in self.rows if a > tick), default=FOREVER)

    def free_from(self, tick: int, span: int) -> int:
        """First tick from which nobody has the place for so long."""
        ends = [b for _, b, _ in self.rows]
        for t in sorted({tick, *(e for e in ends if e >= tick)}):
            if t < FOREVER and not any(a < t + span and t < b for a, b, _ in self.rows):
                return t
        return FOREVER


@dataclass
class Step:
    """A step of the dependency graph: planned start, duration, and what must have happened before it starts."""

    start: int
    span: int
    ready: int = 0
    ended: list[int] = field(default_factory=list)  # these steps have ended
    gone: list[int] = field(default_factory=list)  # these have ended, and the margin is over
    begun: list[int] = field(default_factory=list)  # these have started


def earliest_starts(steps: Sequence[Step], margin: int) -> list[int]:
    """Longest paths: the least starts, none earlier than planned, that keep every promise; until nothing moves."""
    start = [max(s.start, s.ready) for s in steps]
    moved = True
    while moved:
        moved = False
        for i, s in enumerate(steps):
            least = max(
                start[i],
                *(start[j] + steps[j].span for j in s.ended),
                *(start[j] + steps[j].span + margin for j in s.gone),
                *(start[j] for j in s.begun),
                0,
            )
            if least != start[i]:
                start[i], moved = least, True
    return start


# ---------------------------------------------------------------- what really happened


PRIMITIVE_0 = 16


def rows_of(columns: Mapping[str, Any]) -> list[Motion]:
    """A table as one dictionary per row."""
    names = list(columns)
    return [dict(zip(names, values, strict=True)) for values in zip(*(list(columns[n]) for n in names), strict=True)]


def timeline(motions: Sequence[Motion]) -> dict[int, list[Motion]]:
    """Intervals by vehicle and time; complains when one does not begin where and when the one before ended."""
    by_vehicle: dict[int, list[Motion]] = defaultdict(list)
    for m in motions:
        by_vehicle[m["vehicle"]].append(m)
    for v, rows in by_vehicle.items():
        rows.sort(key=lambda m: m["t0"])
        assert rows[0]["t0"] == 0, f"vehicle {v} has no beginning"
        for a, b in pairwise(rows):
            assert a["t1"] == b["t0"], f"vehicle {v} is nowhere at {a['t1']}"
            assert (a["to_place"], a["to_heading"]) == (b["from_place"], b["from_heading"]), f"vehicle {v} jumps"
    return by_vehicle


def occupied(floor: Floor, motions: Sequence[Motion]) -> list[Reservation]:
    """What every vehicle of a recorded run occupied, as reservations."""
    heading = floor.graph.state_heading
    edge_of = {
        (e.from_place, int(heading[e.source]), e.to_place, int(heading[e.target]), e.kind): e for e in floor.edges
    }
    out: list[Reservation] = []
    for v, rows in timeline(motions).items():
        drives = []
        for m in rows:
            if m["kind"] < PRIMITIVE_0:
                assert m["from_place"] == m["to_place"]
                continue
            name = (m["from_place"], m["from_heading"], m["to_place"], m["to_heading"], m["kind"] - PRIMITIVE_0)
            assert name in edge_of, f"vehicle {v} makes a motion that does not exist at {m['t0']}"
            e = edge_of[name]
            assert m["t1"] - m["t0"] == e.ticks or m["t1"] == max(r["t1"] for r in rows)
            drives.append((e, m["t0"]))
        out += reservations_of(floor, v, rows[0]["from_place"], 0, drives, FOREVER)
    return out


def clashes(floor: Floor, reservations: Sequence[Reservation]) -> list[tuple[int, int, int, int]]:
    """(place, tick, vehicle, vehicle) whenever two share a place; under the classical rule also swaps and crossings."""
    out = []
    by_place: dict[int, list[Reservation]] = defaultdict(list)
    for r in reservations:
        by_place[r[0]].append(r)
    for place, rows in by_place.items():
        rows.sort(key=lambda r: r[1])
        for i, a in enumerate(rows):
            for b in rows[i + 1 :]:
                if b[1] >= a[2]:
                    break
                if a[3] != b[3]:
                    out.append((place, b[1], a[3], b[3]))
    if not floor.hold:
        out += _passings(floor, reservations)
    return out


def _passings(floor: Floor, reservations: Sequence[Reservation]) -> list[tuple[int, int, int, int]]:
    leaves = {(p, b, v) for p, _, b, v in reservations}
    moves = defaultdict(list)  # tick → (from, to, vehicle)
    for p, a, _, v in reservations:
        for e in {(e.from_place, e.to_place) for e in floor.edges if e.to_place == p and e.from_place != p}:
            if (e[0], a, v) in leaves:
                moves[a - 1].append((e[0], p, v))
    corners = {(e.from_place, e.to_place): set(e.corners) for e in floor.edges}
    out = []
    for tick, rows in moves.items():
        for i, (a, b, v) in enumerate(rows):
            for c, d, w in rows[i + 1 :]:
                if v != w and ((a, b) == (d, c) or {c, d} == corners[a, b]):
                    out.append((b, tick, v, w))
    return out


def energy_of_a_motion(mj: Sequence[int], span: int, past: int) -> list[int]:
    """What a motion has drawn by component after so many of its ticks: the cumulative floor."""
    return [c * past // span for c in mj]
