"""What an operator says: checked, logged before it is answered, carried out, or refused with its reason."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from engine.build import build
from engine.results.runlog import MemoryLog
from engine.scenario import parse
from engine.sim.judge import judge
from engine.types import NONE, Activity, Cause, OrderState, Task
from tests import naive
from tests.strategies import scenario_text

FLOOR = """
#I##O##R##R##R#
...............
...............
#C#C#C#C#P#P#P#
"""
NO_ORDERS = 'source = "poisson"\nrate_per_h = 0\nmix = [{ from = "station", to = "station", weight = 1.0 }]'


def start(count: int = 2, **sections: Any) -> Any:
    return build(parse(scenario_text(FLOOR, count, **{"orders": NO_ORDERS, **sections})), recorder=MemoryLog())


def tell(sim: Any, do: str, **fields: Any) -> Any:
    return sim.submit({"do": do, **{k.rstrip("_"): v for k, v in fields.items()}})


def until(sim: Any, so: Callable[[], bool], most: int = 400) -> None:
    for _ in range(most):
        if so():
            return
        sim.advance(1)
    raise AssertionError("it never came")


def place_of(sim: Any, v: int) -> int:
    return int(sim.graph.state_place[sim.fleet.state[v]])


def fine(sim: Any) -> None:
    """The judge agrees, commands and their effects included."""
    sim.check()
    sim.flush()
    assert judge(sim.log, sim.scenario, sim.world) == []


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ({"do": "ordre", "from": 1, "to": 2}, r"unknown command 'ordre'; did you mean 'order'\?"),
        ({"do": 3}, "unknown command '3'"),
        ({}, "unknown command 'None'"),
        ({"do": "order", "from": 1}, "command 'order' needs 'to'"),
        ({"do": "order", "from": 1, "to": 2, "fast": 1}, "unknown field of command 'order' 'fast'"),
        ({"do": "order", "from": 1, "to": "2"}, "'to' must be a number; got '2'"),
        ({"do": "order", "from": True, "to": 2}, "'from' must be a number; got True"),
        ({"do": "order", "from": 1.5, "to": 2}, "'from' must be a whole number; got 1.5"),
        ({"do": "order", "from": float("nan"), "to": 2}, "'from' must be a number"),
        ({"do": "order", "from": 1, "to": 99}, "unknown station 99; stations are numbered 1 to 5"),
        ({"do": "withdraw", "order": 0}, "there is no order 0; 0 were given so far"),
        ({"do": "charge", "vehicle": 7}, "there is no vehicle 7; the fleet is numbered 0 to 1"),
        ({"do": "charge", "vehicle": 0}, "vehicle 0 is already charged"),
        ({"do": "send", "vehicle": 0, "place": -1}, "there is no place -1"),
        ({"do": "continue", "vehicle": 0}, "vehicle 0 is not paused"),
        ({"do": "repair", "vehicle": 0}, "vehicle 0 is not broken down"),
        ({"do": "unblock", "place": 9}, "is not blocked"),
        ({"do": "charger out", "charger": 4}, "there is no charger 4; they are numbered 0 to 3"),
        ({"do": "charger back", "charger": 1}, "charger C2 is in order"),
        ({"do": "rate", "per_h": -3}, "'per_h' must lie between 0 and 1000000; got -3"),
        ({"do": "thresholds", "good": 1.2}, "'good' must lie between 0 and 1; got 1.2"),
        ({"do": "thresholds", "critical": 0.9}, "thresholds must rise"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_reason_and_logged(command: dict[str, Any], reason: str) -> None:
    sim = start()
    answer = sim.submit(command)
    assert not answer.accepted
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(answer.reason)
    sim.flush()
    (row,) = naive.rows_of(sim.log.table("commands"))
    assert (row["tick"], row["number"], row["accepted"], row["reason"]) == (0, 0, 0, answer.reason)
    assert json.loads(row["command"]) == pytest.approx(command, nan_ok=True) if command else row["command"] == "{}"
    fine(sim)


def test_a_command_is_stamped_with_its_tick_and_number_and_logged_before_its_effects() -> None:
    sim = start()
    sim.advance(7)
    first, second = tell(sim, "order", from_=1, to=3), tell(sim, "order", from_=3, to=1)
    assert (first.accepted, first.tick, first.number) == (True, 7, 0)
    assert (second.tick, second.number, second.reason) == (7, 1, "order 1 from R3 to I1")
    sim.advance(100)
    fine(sim)
    assert sim.metrics()["orders_done"] == 2
    rows = naive.rows_of(sim.log.table("orders"))
    assert [(r["order"], r["source"]) for r in rows if r["state"] == OrderState.OPEN] == [(0, 1), (1, 1)]


def test_withdrawing() -> None:
    sim = start(1)
    for _ in range(3):
        tell(sim, "order", from_=1, to=5)
    assert tell(sim, "withdraw", order=2).accepted
    assert sim.book.open == [1]
    until(sim, lambda: place_of(sim, 0) not in sim.world.chargers)
    assert tell(sim, "withdraw", order=0).accepted
    assert sim.book.state[0] == OrderState.WITHDRAWN
    until(sim, lambda: sim.book.state[1] == OrderState.PICKED)
    answer = tell(sim, "withdraw", order=1)
    assert answer.reason == "vehicle 0 has already picked order 1 up"
    until(sim, lambda: sim.book.state[1] == OrderState.DONE)
    assert tell(sim, "withdraw", order=1).reason == "order 1 is already done"
    assert tell(sim, "withdraw", order=0).reason == "order 0 is already withdrawn"
    sim.advance(50)
    fine(sim)
    assert sim.metrics()["orders_done"] == 1


def test_a_load_being_picked_is_not_withdrawn() -> None:
    sim = start(1, service="pick_s = 9.0")
    tell(sim, "order", from_=1, to=5)
    until(sim, lambda: sim.fleet.kind[0] == Activity.PICK)
    assert "just picking" in tell(sim, "withdraw", order=0).reason
    sim.advance(100)
    fine(sim)


def test_charging_on_demand_ends_and_the_vehicle_works_again() -> None:
    # from above `sufficient`: it charges to the full and is free again
    sim = start(1, battery="capacity_wh = 40.0\ninitial_soc = 0.85", fleet='start = "parking"')
    assert tell(sim, "charge", vehicle=0).accepted
    until(sim, lambda: sim.fleet.kind[0] == Activity.CHARGE)
    assert sim.must_charge[0]
    until(sim, lambda: not sim.must_charge[0])
    assert sim.fleet.charge[0] == sim.levels.full[0]
    tell(sim, "order", from_=1, to=2)
    until(sim, lambda: sim.metrics()["orders_done"] == 1)
    fine(sim)


def test_charging_waits_for_the_order_under_way() -> None:
    sim = start(1, battery="capacity_wh = 40.0\ninitial_soc = 0.9")
    tell(sim, "order", from_=1, to=5)
    sim.advance(3)
    assert tell(sim, "charge", vehicle=0).reason == "vehicle 0 goes charging after order 0"
    tell(sim, "order", from_=5, to=1)
    until(sim, lambda: sim.book.state[0] == OrderState.DONE)
    sim.advance(1)
    assert sim.book.state[1] == OrderState.OPEN
    until(sim, lambda: sim.book.state[1] == OrderState.DONE)
    fine(sim)


def test_sending() -> None:
    sim = start(2)
    goal = int(sim.world.parking[1])
    assert tell(sim, "send", vehicle=0, place=goal).accepted
    assert sim.fleet.task[0] == Task.SENT
    tell(sim, "order", from_=1, to=2)
    until(sim, lambda: place_of(sim, 0) == goal)
    until(sim, lambda: sim.metrics()["orders_done"] == 1)
    assert sim.fleet.task[0] == Task.NONE
    assert (tell(sim, "send", vehicle=1, place=goal).reason).endswith("is taken by vehicle 0")
    station = int(sim.world.station(1).place)
    assert "nothing may park there" in tell(sim, "send", vehicle=0, place=station).reason
    blocked = sim.world.place_at(0, 1)
    tell(sim, "block", place=blocked)
    assert tell(sim, "send", vehicle=0, place=blocked).reason == "cell (0, 1) is blocked"
    tell(sim, "pause", vehicle=0)
    assert tell(sim, "send", vehicle=0, place=int(sim.world.parking[2])).reason == "vehicle 0 is paused"
    sim.advance(100)
    fine(sim)


def test_sent_to_where_it_stands_it_is_free_again() -> None:
    sim = start(1)
    assert tell(sim, "send", vehicle=0, place=place_of(sim, 0)).accepted
    assert sim.fleet.task[0] == Task.NONE
    tell(sim, "order", from_=1, to=2)
    until(sim, lambda: sim.metrics()["orders_done"] == 1)
    fine(sim)


def test_a_busy_or_broken_vehicle_is_not_sent() -> None:
    sim = start(1)
    tell(sim, "order", from_=1, to=2)
    goal = int(sim.world.parking[0])
    assert "is busy with order 0" in tell(sim, "send", vehicle=0, place=goal).reason
    tell(sim, "fail", vehicle=0)
    assert tell(sim, "send", vehicle=0, place=goal).reason == "vehicle 0 is broken down"
    assert tell(sim, "fail", vehicle=0).reason == "vehicle 0 is already broken down"


def test_pausing_stops_at_the_next_place_and_keeps_the_order() -> None:
    sim = start(1, motion="straight_ticks = 3")
    tell(sim, "order", from_=1, to=5)
    until(sim, lambda: sim.fleet.edge[0] >= 0 and sim.fleet.t1[0] > sim.tick + 1)
    tell(sim, "pause", vehicle=0)
    sim.advance(1)
    assert sim.fleet.edge[0] >= 0
    sim.advance(30)
    here = place_of(sim, 0)
    sim.advance(100)
    assert place_of(sim, 0) == here
    assert (sim.fleet.kind[0], sim.fleet.cause[0]) == (Activity.PAUSE, Cause.OPERATOR)
    assert tell(sim, "pause", vehicle=0).reason == "vehicle 0 is already paused"
    tell(sim, "continue", vehicle=0)
    until(sim, lambda: sim.metrics()["orders_done"] == 1)
    fine(sim)


def test_failing_gives_the_order_to_somebody_else_and_repairing_helps() -> None:
    sim = start(2)
    tell(sim, "order", from_=5, to=1)
    v = int(np.flatnonzero(sim.fleet.order == 0)[0])
    sim.advance(3)
    assert tell(sim, "fail", vehicle=v).accepted
    assert sim.fleet.order.tolist() == [0 if w != v else NONE for w in range(2)]
    until(sim, lambda: sim.metrics()["orders_done"] == 1)
    assert sim.fleet.kind[v] == Activity.FAULT
    tell(sim, "repair", vehicle=v)
    sim.advance(80)
    assert place_of(sim, v) in (*sim.world.chargers, *sim.world.parking)
    fine(sim)


def test_a_loaded_vehicle_that_fails_keeps_its_load_and_brings_it_later() -> None:
    sim = start(2)
    tell(sim, "order", from_=1, to=5)
    until(sim, lambda: sim.book.state[0] == OrderState.PICKED)
    v = sim.book.vehicle[0]
    tell(sim, "fail", vehicle=v)
    sim.advance(50)
    assert (sim.book.vehicle[0], sim.fleet.loaded[v]) == (v, 1)
    tell(sim, "repair", vehicle=v)
    until(sim, lambda: sim.book.state[0] == OrderState.DONE)
    fine(sim)


@pytest.mark.parametrize("ahead", [10, 13])  # at the tick of a battery sample, and between two
def test_an_empty_vehicle_is_repaired_with_a_little_charge(ahead: int) -> None:
    sim = start(1, battery="capacity_wh = 1.0\ninitial_soc = 0.1", fleet='start = "parking"')
    until(sim, lambda: sim.metrics()["stranded"] == 1, 2000)
    sim.advance(ahead - sim.tick % 10)
    assert tell(sim, "repair", vehicle=0).accepted
    assert sim.fleet.charge[0] == sim.levels.capacity[0] // 10
    sim.advance(25)
    fine(sim)


def test_a_blocked_cell_is_driven_round_and_free_again_later() -> None:
    sim = start(1)
    tell(sim, "order", from_=1, to=5)
    wall = [sim.world.place_at(7, 1), sim.world.place_at(7, 2)]
    assert tell(sim, "block", place=wall[0]).reason == "cell (7, 1) is blocked"
    assert "already blocked" in tell(sim, "block", place=wall[0]).reason
    until(sim, lambda: sim.book.state[0] == OrderState.PICKED)
    tell(sim, "block", place=wall[1])
    sim.advance(120)
    assert sim.book.state[0] == OrderState.PICKED
    tell(sim, "unblock", place=wall[1])
    until(sim, lambda: sim.book.state[0] == OrderState.DONE)
    fine(sim)
    assert [r["blocked"] for r in naive.rows_of(sim.log.table("blocks"))] == [1, 1, 0]


def test_a_charger_out_of_order_is_left_and_one_that_is_back_charges() -> None:
    sim = start(1, battery="capacity_wh = 40.0\ninitial_soc = 0.2")
    sim.advance(2)
    here = place_of(sim, 0)
    i = sim.world.chargers.tolist().index(here)
    assert tell(sim, "charger out", charger=i).accepted
    assert "already out of order" in tell(sim, "charger out", charger=i).reason
    until(sim, lambda: place_of(sim, 0) != here and sim.fleet.kind[0] == Activity.CHARGE)
    for k in range(4):
        tell(sim, "charger out", charger=k)
    assert sim.fleet.kind[0] != Activity.CHARGE or sim.advance(1)
    assert sim.fleet.kind[0] != Activity.CHARGE
    for k in range(4):
        assert tell(sim, "charger back", charger=k).accepted
    until(sim, lambda: sim.fleet.charge[0] == sim.levels.full[0])
    fine(sim)


def test_a_charger_that_is_back_while_somebody_is_coming_charges_it() -> None:
    # one charger, and no other place to rest
    text = scenario_text("#I#O#\n.....\n##C##\n", 1, orders=NO_ORDERS, battery="capacity_wh = 20.0\ninitial_soc = 0.5")
    sim = build(parse(text), recorder=MemoryLog())
    tell(sim, "order", from_=1, to=2)
    until(sim, lambda: sim.book.state[0] == OrderState.PICKED)
    tell(sim, "charger out", charger=0)
    sim.advance(3)
    tell(sim, "charger back", charger=0)
    until(sim, lambda: sim.fleet.charge[0] == sim.levels.full[0])
    fine(sim)


def test_rates_and_listed_orders() -> None:
    sim = start(1)
    assert tell(sim, "rate", per_h=3600).reason == "3600 orders per hour from now on"
    sim.advance(60)
    assert 30 < sim.metrics()["orders_created"] < 100
    listed = start(1, orders='source = "listed"\npairs = [[1, 2]]')
    assert tell(listed, "rate", per_h=10).reason.startswith("the orders of this scenario are listed")


def test_new_thresholds_send_the_low_charging() -> None:
    sim = start(2, battery="capacity_wh = 40.0\ninitial_soc = 0.6", fleet='start = "parking"')
    sim.advance(10)
    assert sim.metrics()["charging"] == 0
    answer = tell(sim, "thresholds", good=0.7, sufficient=0.9)
    assert "good 70 %" in answer.reason
    until(sim, lambda: sim.metrics()["charging"] == 2)
    until(sim, lambda: not sim.must_charge.any())
    fine(sim)
