"""One vehicle's search among all, against a plain search over space and time."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.energy import cost_table
from engine.planners.base import Budget, Leg
from engine.planners.search import FloorSearch
from engine.types import Activity, PlanStatus
from engine.world.grid import GridMotion
from tests import naive
from tests.strategies import MASSES, Ask, Ground, grid_graph, grounds, model, requests

PER_FLOOR = 5
MANY = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


def compare(ground: Ground, r: Ask, objective: str) -> None:
    """Same answer as the plain search; and whatever was found is legal, tick by tick, and costs what it says."""
    goals, standby = ground.goals(r), ground.standby(r)
    plan = ground.search.through(ground.view(r), objective, Budget())
    best = naive.space_time(ground.floor, ground.reservations, goals, standby, r.state, r.tick, objective)
    if best is None:
        assert plan.status is PlanStatus.NO_PATH
        return
    assert plan.found, f"there is a way of {best}"
    ticks, mj = naive.play(ground.floor, ground.reservations, goals, standby, r.state, r.tick, plan)
    assert plan.energy_mj == mj
    assert (ticks if objective == "time" else mj) == best[0]


@settings(MANY, max_examples=240)
@given(st.data())
def test_earliest_arrival(data: st.DataObject) -> None:
    ground = data.draw(grounds())
    for _ in range(PER_FLOOR):
        ask = data.draw(requests(ground))
        if ask is not None:
            compare(ground, ask, "time")


@settings(MANY, max_examples=160)
@given(st.data())
def test_least_energy(data: st.DataObject) -> None:
    ground = data.draw(grounds(most=3))
    for _ in range(PER_FLOOR):
        ask = data.draw(requests(ground))
        if ask is not None:
            compare(ground, ask, "energy")
