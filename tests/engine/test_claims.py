"""Reservations by interval against plain lists; re-timing against longest paths in the dependency graph."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.planners.base import Budget, Leg, Plan
from engine.traffic import (
    Claims,
    Steps,
    claim,
    commit,
    forget,
    gap_at,
    gap_end,
    grown,
    lift,
    new_claims,
    new_steps,
    put_back,
    release,
    retime,
    wider,
)
from engine.traffic.claims import discard, free_from, link, unlink
from engine.traffic.departures import GraphArrays, graph_arrays
from engine.types import FOREVER, NONE, Activity
from tests import naive
from tests.strategies import Ask, Ground, grounds

PLACES = 3


def listed(c: Claims, place: int) -> list[int]:
    """Slots of a place in the order of their list; complains when the links back say otherwise."""
    out, at = [], place
    while c.next[at] >= 0:
        after = int(c.next[at])
        assert c.prev[after] == at
        assert c.place[after] == place
        out.append(after)
        at = after
    return out


def check_lists(c: Claims, places: int, plain: list[naive.Intervals]) -> None:
    for place in range(places):
        rows = [(int(c.start[s]), int(c.end[s]), s) for s in listed(c, place)]
        assert rows == plain[place].rows
        for tick in range(26):
            gap = int(gap_at(c, place, tick))
            if plain[place].taken(tick):
                assert gap == -1
                continue
            before = plain[place].before(tick)
            assert gap == (place if before is None else before)
            assert gap_end(c, gap) == plain[place].opens_until(tick)
            for span in (1, 3):
                assert free_from(c.start, c.end, c.next, place, tick, span) == plain[place].free_from(tick, span)


@pytest.mark.nojit_slice
@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.integers(0, 6), st.integers(0, PLACES - 1), st.integers(0, 20), st.integers(1, 5)), max_size=30
    )
)
def test_lists_stay_sorted_and_disjoint(ops: list[tuple[int, int, int, int]]) -> None:
    c = new_claims(PLACES, 6)
    plain = [naive.Intervals() for _ in range(PLACES)]
    held: list[tuple[int, int]] = []
    for op, place, start, span in ops:
        end = FOREVER if span == 5 else start + span
        if op <= 3:
            if any(a < end and start < b for a, b, _ in plain[place].rows):
                continue
            full = c.meta[0] == 0
            slot = int(claim(c, place, start, end, 7))
            assert (slot == -1) == full
            if full:
                c = grown(c, PLACES)
                slot = int(claim(c, place, start, end, 7))
            plain[place].add(start, end, slot)
            held.append((place, slot))
        elif held:
            place, slot = held[start % len(held)]
            if op == 4:
                release(c, slot)
                plain[place].remove(slot)
                held.remove((place, slot))
            else:
                unlink(c, slot)
                link(c, slot)
        check_lists(c, PLACES, plain)
    assert c.meta[0] + len(held) == len(c.start) - PLACES


def test_slots_are_used_again_and_growing_keeps_everything() -> None:
    c = new_claims(2, 4)
    slots = [int(claim(c, 0, t, t + 1, v)) for v, t in enumerate((5, 1, 9, 3))]
    assert sorted(slots) == [2, 3, 4, 5]
    assert claim(c, 1, 0, 1, 9) == -1
    release(c, slots[0])
    assert claim(c, 1, 0, 4, 9) == slots[0]
    more = grown(c, 2)
    assert [more.start[s] for s in listed(more, 0)] == [1, 3, 9]
    assert {int(claim(more, 0, t, t + 1, 1)) for t in (20, 22, 24, 26)} == {6, 7, 8, 9}
    assert claim(more, 0, 40, 41, 1) == -1
    unlink(c, slots[1])
    discard(c, slots[1])
    assert c.owner[slots[1]] == NONE


class Fleet:
    """Vehicles whose plans are committed one after the other, as the simulation does it."""

    def __init__(self, ground: Ground, starts: list[int]):
        self.ground, self.n = ground, len(starts)
        graph = ground.graph
        self.arrays: GraphArrays = graph_arrays(graph)
        self.claims = new_claims(graph.n_places, 400)
        self.steps: Steps = new_steps(self.n, 64)
        self.count = np.zeros(self.n, np.int32)
        self.state = [int(graph.place_ptr[p]) for p in starts]
        self.here = np.array([claim(self.claims, p, 0, FOREVER, v) for v, p in enumerate(starts)], np.int32)

    @property
    def rule(self) -> tuple[bool, int]:
        return self.ground.floor.hold, self.ground.floor.margin

    def plan(self, v: int, legs: tuple[Leg, ...]) -> Plan:
        """Lift, plan, and commit or put back."""
        c, p = self.claims, self.steps
        gap = int(lift(c, p, v, int(self.here[v]), 0, int(self.count[v])))
        view = self.ground.view(Ask(self.state[v], 0, 0, legs))
        view = view._replace(claims=c, request=view.request._replace(vehicle=v, gap=gap))
        plan = self.ground.search.through(view, "time", Budget())
        if not plan.found:
            put_back(c, p, v, int(self.here[v]), 0, int(self.count[v]))
            return plan
        forget(c, p, v, 0, int(self.count[v]), False)
        n = len(plan.edges)
        commit(
            c, p, self.arrays, *self.rule, v, int(self.here[v]), plan.edges, plan.what, plan.starts, plan.ends, n
        )  # fmt: skip
        self.count[v] = n
        return plan

    def everything(self) -> list[np.ndarray]:
        return [a.copy() for a in (*self.claims, *self.steps)]


@st.composite
def fleets(draw: st.DrawFn) -> Fleet:
    """A few vehicles on a small floor, each with a plan if there is one."""
    ground = draw(grounds(most=4))
    ground = Ground(ground.floor, ground.costs, ground.search, [])
    n = ground.graph.n_places
    starts = draw(st.lists(st.integers(0, n - 1), min_size=1, max_size=4, unique=True))
    fleet = Fleet(ground, starts)
    for v in draw(st.permutations(range(len(starts)))):
        goals = draw(st.lists(st.integers(0, n - 1), min_size=1, max_size=3))
        stays = draw(st.lists(st.integers(0, 4), min_size=3, max_size=3))
        legs = [Leg(p, s, Activity.PICK, False) for p, s in zip(goals, stays, strict=False)]
        legs[-1] = Leg(goals[-1], 0, Activity.REST, False)
        fleet.plan(v, tuple(legs))
    return fleet


def dependencies(f: Fleet, ready: np.ndarray) -> tuple[list[tuple[int, int]], list[naive.Step]]:
    """The steps of all vehicles and what each waits for, read off the lists of claims."""
    p, c, margin = f.steps, f.claims, f.ground.floor.margin
    names = [(v, k) for v in range(f.n) for k in range(f.count[v])]
    number = {name: i for i, name in enumerate(names)}
    steps = [naive.Step(int(p.start[v, k]), int(p.end[v, k] - p.start[v, k])) for v, k in names]
    entered_by: dict[int, int] = {}
    left_by: dict[int, int] = {}
    for v in range(f.n):
        at = int(f.here[v])
        if f.count[v]:
            steps[number[v, 0]].ready = int(ready[v])
        for k in range(f.count[v]):
            i = number[v, k]
            if k:
                steps[i].ended.append(i - 1)
            if p.claim[v, k] >= 0:
                left_by[at] = i
                at = int(p.claim[v, k])
                entered_by[at] = i
            for corner in (int(p.sweep0[v, k]), int(p.sweep1[v, k])):
                if corner >= 0:
                    entered_by[corner] = left_by[corner] = i
    for place in range(f.ground.graph.n_places):
        slots = listed(c, place)
        for before, after in itertools.pairwise(slots):
            step = steps[entered_by[after]]
            (step.gone if f.ground.floor.hold else step.begun).append(left_by[before])
    assert margin == 0 or f.ground.floor.hold
    return names, steps


@settings(max_examples=150)
@given(st.data())
def test_retiming_is_the_longest_path_and_keeps_the_order(data: st.DataObject) -> None:
    f = data.draw(fleets())
    late = data.draw(st.lists(st.integers(0, 12), min_size=f.n, max_size=f.n))
    ready = np.array(late, np.int32)
    names, steps = dependencies(f, ready)
    own = [
        c
        for place in range(f.ground.graph.n_places)
        for a, c in zip(listed(f.claims, place), listed(f.claims, place)[1:], strict=False)
        if f.claims.owner[a] == f.claims.owner[c] and f.claims.start[c] < f.claims.end[a]
    ]
    before = [listed(f.claims, p) for p in range(f.ground.graph.n_places)]
    step = np.zeros(f.n, np.int32)
    retime(f.claims, f.steps, f.arrays, *f.rule, step, f.count, f.here, ready)
    assert [listed(f.claims, p) for p in range(f.ground.graph.n_places)] == before
    if not own:  # with a margin a vehicle that turns round at once meets its own trail: tested where it drives
        assert [int(f.steps.start[v, k]) for v, k in names] == naive.earliest_starts(steps, f.ground.floor.margin)
    for (v, k), s in zip(names, steps, strict=True):
        assert f.steps.end[v, k] - f.steps.start[v, k] == s.span
    for slots in before:
        for a, b in itertools.pairwise(slots):
            same = f.claims.owner[a] == f.claims.owner[b]
            assert f.claims.end[a] <= f.claims.start[b] or same
    once = f.everything()
    retime(f.claims, f.steps, f.arrays, *f.rule, step, f.count, f.here, ready)
    assert all((a == b).all() for a, b in zip(once, f.everything(), strict=True))


@settings(max_examples=80)
@given(st.data())
def test_committed_plans_never_share_a_place(data: st.DataObject) -> None:
    f = data.draw(fleets())
    rows = []
    for v in range(f.n):
        drives = [(f.ground.floor.edges[e], int(t)) for e, t in _drives(f.steps, v, int(f.count[v]))]
        place = f.ground.floor.place(f.state[v])
        rows += naive.reservations_of(f.ground.floor, v, place, 0, drives, FOREVER)
    assert not naive.clashes(f.ground.floor, rows)
    slots = [s for p in range(f.ground.graph.n_places) for s in listed(f.claims, p)]
    booked = sorted(
        (int(f.claims.place[s]), int(f.claims.start[s]), int(f.claims.end[s]), int(f.claims.owner[s])) for s in slots
    )
    assert booked == sorted(rows)


def _drives(p: Steps, v: int, n: int) -> list[tuple[int, int]]:
    return [(int(p.edge[v, k]), int(p.start[v, k])) for k in range(n) if p.edge[v, k] >= 0]


@settings(max_examples=60)
@given(st.data())
def test_a_plan_that_fails_leaves_everything_as_it_was(data: st.DataObject) -> None:
    f = data.draw(fleets())
    for v in range(f.n):
        was = f.everything()
        here, n = int(f.here[v]), int(f.count[v])
        lift(f.claims, f.steps, v, here, 0, n)
        assert all(f.claims.owner[s] != v for p in range(f.ground.graph.n_places) for s in listed(f.claims, p))
        put_back(f.claims, f.steps, v, here, 0, n)
        assert all((a == b).all() for a, b in zip(was, f.everything(), strict=True))


def test_wider_plans_keep_their_steps() -> None:
    p = new_steps(2, 3)
    p.edge[1, 2], p.claim[0, 0] = 17, 4
    more = wider(p, 10)
    assert more.edge.shape == (2, 10)
    assert (more.edge[1, 2], more.claim[0, 0], more.edge[1, 3]) == (17, 4, NONE)
