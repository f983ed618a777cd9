"""The shared route timer: when, for a route that somebody else has chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.energy import cost_table
from engine.planners.base import Budget, Leg, Memory, Promise, View
from engine.planners.quickest import Quickest
from engine.planners.search import FloorSearch
from engine.traffic.timer import DETOUR, Timed
from engine.types import Activity, PlanStatus
from tests import naive
from tests.strategies import MASSES, Ask, Ground, grid_graph, grounds, model, requests

MANY = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
FOREVER = naive.FOREVER


@dataclass(frozen=True)
class Given:
    """A router that was told its route."""

    legs: tuple[tuple[int, ...], ...]
    promise = Promise(summary="as told")

    def init(self, graph: object, costs: object, rng: object) -> Memory:
        return {}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[np.ndarray], Memory]:
        return [np.array(leg, np.int32) for leg in self.legs], memory


@st.composite
def routes(draw: st.DrawFn, ground: Ground, state: int, legs: int) -> tuple[list[list[int]], list[int]]:
    """A random walk as (edges by leg, goals), as routers give it: always rolling."""
    floor = ground.floor
    out, goals = [], []
    for _ in range(legs):
        edges = []
        for choice in draw(st.lists(st.integers(0, 7), max_size=5)):
            ways = floor.leaving[state]
            if not ways:
                break
            e = ways[choice % len(ways)]
            edges.append(e.number)
            state = e.target
        out.append(edges)
        goals.append(floor.place(state))
    return out, goals


def check_times(ground: Ground, ask: Ask, edges: list[list[int]]) -> None:
    """The timed route arrives as early as the plain search says, and is legal."""
    floor, items = ground.floor, []
    for leg, route in zip(ask.legs, edges, strict=True):
        items += [("go", floor.edges[e].target >> 1) for e in route]
        items.append((naive.STAY, leg.stay_ticks))
    best = naive.route_in_time(floor, ground.reservations, items, ask.state, ask.tick)
    plan = Timed(Given(tuple(tuple(e) for e in edges))).timed(ground.view(ask), [np.array(e, np.int32) for e in edges])
    assert plan.found == (best is not None), f"the route takes until {best}"
    if best is None:
        return
    ticks, mj = naive.play(
        floor, ground.reservations, ground.goals(ask), ground.standby(ask), ask.state, ask.tick, plan
    )
    assert ask.tick + ticks == best
    assert plan.energy_mj == mj
    driven = [floor.edges[e].target >> 1 for e in plan.edges.tolist() if e >= 0]
    assert driven == [pose for word, pose in items if word == "go"]


def one_route(data: st.DataObject, most: int) -> None:
    ground = data.draw(grounds(most=most))
    ask = data.draw(requests(ground))
    if ask is None:
        return
    edges, goals = data.draw(routes(ground, ask.state, len(ask.legs)))
    legs = tuple(Leg(goal, leg.stay_ticks, leg.what, leg.loaded) for goal, leg in zip(goals, ask.legs, strict=True))
    check_times(ground, Ask(ask.state, ask.tick, ask.cls, legs), edges)


@settings(MANY, max_examples=500)
@given(st.data())
def test_a_route_is_timed_as_early_as_can_be(data: st.DataObject) -> None:
    one_route(data, 4)


@pytest.mark.nojit_slice
@settings(MANY, max_examples=20)
@given(st.data())
def test_times_without_the_jit(data: st.DataObject) -> None:
    one_route(data, 3)


def hall(reservations: list[naive.Reservation]) -> Ground:
    """Three lanes of five places; places 0…4 are the southern one."""
    graph = grid_graph(5, 3)
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    return Ground(naive.Floor(graph, True, 0), costs, FloorSearch(graph, costs), reservations)


def ask_for(ground: Ground, start: int, goal: int) -> Ask:
    return Ask(ground.graph.state(start, 0), 0, 0, (Leg(goal, 0, Activity.REST, False),))


def test_a_route_waits_for_who_passes() -> None:
    ground = hall([(2, 0, 4, 1)])
    plan, _ = Timed(Quickest()).plan(ground.view(ask_for(ground, 0, 4)), {}, Budget())
    assert (plan.status, plan.note) == (PlanStatus.SOLVED, "")
    assert plan.ends[-1] == 4 + 3


def test_a_closed_route_detours_and_says_so() -> None:
    ground = hall([(2, 0, FOREVER, 1)])
    ask = ask_for(ground, 0, 4)
    plan, _ = Timed(Quickest()).plan(ground.view(ask), {}, Budget())
    assert (plan.status, plan.note) == (PlanStatus.SOLVED, DETOUR)
    naive.play(ground.floor, ground.reservations, ground.goals(ask), ground.standby(ask), ask.state, 0, plan)


def test_a_route_over_a_blocked_place_detours() -> None:
    ground = hall([])
    ground = Ground(naive.Floor(ground.graph, True, 0, frozenset({2})), ground.costs, ground.search, [])
    plan, _ = Timed(Quickest()).plan(ground.view(ask_for(ground, 0, 4)), {}, Budget())
    assert plan.note == DETOUR
    assert 2 not in ground.graph.state_place[ground.graph.edge_to[plan.edges]]


def test_without_any_way_the_answer_is_no_path_and_nothing_has_changed() -> None:
    ground = hall([(p, 0, FOREVER, 1 + p) for p in (2, 7, 12)])
    view = ground.view(ask_for(ground, 0, 4))
    before = [a.copy() for a in view.claims]
    plan, _ = Timed(Quickest()).plan(view, {}, Budget())
    assert plan.status == PlanStatus.NO_PATH
    assert len(plan.edges) == 0
    assert all((a == b).all() for a, b in zip(before, view.claims, strict=True))


def test_a_router_without_a_way_is_answered_by_the_search() -> None:
    ground = hall([])
    view = ground.view(ask_for(ground, 0, 4))
    plan, _ = Timed(Given(())).plan(view, {}, Budget())
    assert plan.note == DETOUR


def test_the_quickest_route_is_as_long_as_the_table_says() -> None:
    ground = hall([])
    rng = np.random.default_rng(5)
    for _ in range(60):
        start, *goals = rng.integers(0, ground.graph.n_places, 3).tolist()
        state = ground.graph.state(start, int(rng.integers(0, 4)))
        legs = tuple(Leg(g, s, Activity.PICK, False) for g, s in zip(goals, (2, 0), strict=True))
        ask = Ask(state, 0, 0, legs)
        plan, _ = Timed(Quickest()).plan(ground.view(ask), {}, Budget())
        best = ground.search.through(ground.view(ask), "time", Budget())
        assert plan.note == ""
        naive.play(ground.floor, [], ground.goals(ask), ground.standby(ask), state, 0, plan)
        # leg by leg the quickest is the best, but where a leg ends decides how the next begins
        assert plan.ends[-1] >= best.ends[-1]
        assert plan.ends[-1] - 2 >= ground.search.ticks_to(goals[0], state)
