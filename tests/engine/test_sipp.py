"""One vehicle's search among all, against a plain search over space and time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.energy import cost_table
from engine.planners.base import Budget, Leg
from engine.planners.kernels.sipp import new_work
from engine.planners.search import FloorSearch, settled
from engine.types import Activity, PlanStatus
from engine.world.grid import GridMotion
from tests import naive
from tests.strategies import MASSES, Ask, Ground, grid_graph, grounds, model, requests

PER_FLOOR = 5
MANY = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
FOREVER = naive.FOREVER


def compare(ground: Ground, ask: Ask, objective: str) -> None:
    """Same answer as the plain search; and whatever was found is legal, tick by tick, and costs what it says."""
    goals, standby = ground.goals(ask), ground.standby(ask)
    plan = ground.search.through(ground.view(ask), objective, Budget())
    best = naive.space_time(ground.floor, ground.reservations, goals, standby, ask.state, ask.tick, objective)
    if best is None:
        assert plan.status == PlanStatus.NO_PATH
        return
    assert plan.found, f"there is a way of {best}"
    ticks, mj = naive.play(ground.floor, ground.reservations, goals, standby, ask.state, ask.tick, plan)
    assert plan.energy_mj == mj
    assert ticks == best[0] if objective == "time" else (mj, ticks) == best


def corridor(width: int, reservations: list[naive.Reservation], *, hold: bool = True, margin: int = 0) -> Ground:
    """A straight lane with places 0, 1 … from west to east."""
    graph = grid_graph(width, 1)
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    return Ground(naive.Floor(graph, hold, margin), costs, FloorSearch(graph, costs), reservations)


def rest_at(place: int, state: int, tick: int = 0) -> Ask:
    """Go to a place and stay there."""
    return Ask(state, tick, 0, (Leg(place, 0, Activity.REST, False),))


@settings(MANY, max_examples=400)
@given(st.data())
def test_earliest_arrival(data: st.DataObject) -> None:
    ground = data.draw(grounds())
    for _ in range(PER_FLOOR):
        ask = data.draw(requests(ground))
        if ask is not None:
            compare(ground, ask, "time")


@settings(MANY, max_examples=300)
@given(st.data())
def test_least_energy(data: st.DataObject) -> None:
    ground = data.draw(grounds(most=3))
    for _ in range(PER_FLOOR):
        ask = data.draw(requests(ground))
        if ask is not None:
            compare(ground, ask, "energy")


@pytest.mark.nojit_slice
@pytest.mark.parametrize("objective", ["time", "energy"])
@settings(MANY, max_examples=15)
@given(data=st.data())
def test_both_objectives_without_the_jit(objective: str, data: st.DataObject) -> None:
    ground = data.draw(grounds(most=3))
    ask = data.draw(requests(ground))
    if ask is not None:
        compare(ground, ask, objective)


@pytest.mark.nojit_slice
def test_who_arrives_earlier_may_need_more_energy() -> None:
    # place 3 is closed until tick 6: driving up to it and stopping there costs a second start
    ground = corridor(6, [(3, 0, 6, 1)])
    east = ground.graph.state(0, 0)
    for objective in ("time", "energy"):
        compare(ground, rest_at(5, east), objective)
    late = ground.search.through(ground.view(rest_at(5, east)), "energy", Budget())
    assert late.starts[0] == 4
    assert np.array_equal(late.ends[:-1], late.starts[1:])


def test_a_start_at_every_tick_is_tried_where_a_motion_of_two_ticks_meets_a_gap_of_two() -> None:
    graph = grid_graph(5, 1, motion=GridMotion(straight_ticks=2))
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    floor = naive.Floor(graph, True, 1)
    ground = Ground(floor, costs, FloorSearch(graph, costs), [(2, 0, 5, 1), (2, 10, FOREVER, 2), (3, 3, 6, 3)])
    for objective in ("time", "energy"):
        compare(ground, rest_at(4, graph.state(0, 0)), objective)


def test_a_goal_that_somebody_needs_later_is_no_place_to_stay() -> None:
    ground = corridor(3, [(2, 40, 41, 1)])
    plan = ground.search.through(ground.view(rest_at(2, 0)), "time", Budget())
    assert plan.found
    assert plan.starts[-1] >= 41
    taken = corridor(3, [(2, 40, FOREVER, 1)])
    for objective in ("time", "energy"):
        assert taken.search.through(taken.view(rest_at(2, 0)), objective, Budget()).status == PlanStatus.NO_PATH


def test_the_last_stay_is_no_step_and_a_plan_may_be_empty() -> None:
    ground = corridor(2, [])
    plan = ground.search.through(ground.view(rest_at(0, 0)), "time", Budget())
    assert plan.found
    assert (len(plan.edges), plan.energy_mj) == (0, 0)
    there = Ask(0, 5, 0, (Leg(1, 3, Activity.PICK, False), Leg(1, 0, Activity.REST, True)))
    plan = ground.search.through(ground.view(there), "time", Budget())
    assert plan.what.tolist()[-1] == Activity.PICK
    assert (plan.ends[-1] - plan.starts[-1]) == 3


@pytest.mark.parametrize("objective", ["time", "energy"])
def test_budget_and_requests_that_make_no_sense_are_answers(objective: str) -> None:
    ground = corridor(9, [])
    view = ground.view(rest_at(8, 0))
    plan = ground.search.through(view, objective, Budget(expansions=3))
    assert plan.status == PlanStatus.BUDGET_SPENT
    assert plan.expanded == 4
    assert ground.search.through(ground.view(Ask(0, 0, 0, ())), objective, Budget()).status == PlanStatus.INCONSISTENT


@pytest.mark.parametrize("objective", ["time", "energy"])
def test_a_search_that_outgrows_its_room_begins_anew_with_more(objective: str) -> None:
    graph = grid_graph(40, 40)
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    # everybody must wait for the gate in the middle column
    gate = [(p, 0, 60 + p % 7, 1 + p) for p in range(graph.n_places) if p % 40 == 20]
    ground = Ground(naive.Floor(graph, True, 0), costs, FloorSearch(graph, costs), gate)
    ask = rest_at(graph.n_places - 1, 0)
    ground.search._work = new_work(256, 1)
    small = ground.search.through(ground.view(ask), objective, Budget())
    assert small.found
    assert len(ground.search._work.state) > 1 << 11
    arrival, mj = naive.play(ground.floor, gate, ground.goals(ask), ground.standby(ask), 0, 0, small)
    assert mj == small.energy_mj
    assert arrival == small.ends[-1]
    again = ground.search.through(ground.view(ask), objective, Budget())
    assert np.array_equal(again.edges, small.edges)
    assert np.array_equal(again.starts, small.starts)


def test_no_energy_at_all_ends_too() -> None:
    graph = grid_graph(2, 1)
    costs = cost_table(graph.primitives, model(), MASSES, 1.0)
    for table in (costs.mj, costs.total_mj, costs.standby_mj):
        table[:] = 0
    ground = Ground(naive.Floor(graph, True, 0), costs, FloorSearch(graph, costs), [])
    legs = (Leg(0, 0, Activity.PICK, False), Leg(1, 0, Activity.DROP, True), Leg(1, 0, Activity.REST, False))
    plan = ground.search.through(ground.view(Ask(0, 4, 1, legs)), "energy", Budget(expansions=200))
    assert plan.found


def test_after_the_last_claim_nothing_changes() -> None:
    ground = corridor(4, [(2, 3, 9, 1), (3, 5, FOREVER, 2)])
    assert settled(ground.view(rest_at(0, 0)).claims) == 9
    assert settled(corridor(2, []).view(rest_at(0, 0)).claims) == 0
