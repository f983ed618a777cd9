"""Where orders come from, who takes them and why not, and who goes charging."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.build import build
from engine.dispatch.kernels import free_rests
from engine.dispatch.levels import Levels
from engine.dispatch.nearest import Nearest
from engine.orders.book import OrderBook
from engine.orders.sources import Listed, Poisson
from engine.results.runlog import MemoryLog
from engine.scenario import parse
from engine.types import FOREVER, NONE, Activity, OrderState, Task
from tests import naive, naive_dispatch
from tests.strategies import HALL, LOOP, scenario_text

MIX = [([1, 2], [3], 3.0), ([3], [1, 2], 1.0)]
NO_ORDERS = 'source = "poisson"\nrate_per_h = 0\nmix = [{ from = "station", to = "station", weight = 1.0 }]'
ROW = """
#I##O##R##R##R#
...............
#C#C#C#C#P#P#P#
"""


def poisson(seed: int = 1, rate: float = 360.0, tick_s: float = 1.0, limit: int | None = None) -> Poisson:
    return Poisson(np.random.default_rng(seed), rate, MIX, tick_s, limit)


def take(source: Poisson, n: int) -> list[tuple[int, int, int]]:
    return [source.take() for _ in range(n)]


def events(log: MemoryLog, kind: str) -> list[str]:
    rows = naive.rows_of(log.table("events"))
    return [r["text"] for r in rows if r["kind"] == kind]


# ---------------------------------------------------------------- sources


@pytest.mark.parametrize("tick_s", [1.0, 0.25])
def test_poisson_gaps_have_the_mean_and_spread_of_the_rate(tick_s: float) -> None:
    ticks = np.array([t for t, _, _ in take(poisson(tick_s=tick_s), 20_000)])
    gaps = np.diff(ticks) * tick_s
    assert gaps.mean() == pytest.approx(10.0, rel=0.03)
    assert gaps.std() == pytest.approx(10.0, rel=0.05)
    assert (gaps >= 0).all()


def test_poisson_goes_between_the_kinds_by_their_weights() -> None:
    pairs = [(a, b) for _, a, b in take(poisson(), 8000)]
    there = sum(b == 3 for _, b in pairs) / len(pairs)
    assert there == pytest.approx(0.75, abs=0.02)
    assert {a for a, b in pairs if b == 3} == {1, 2}
    assert {b for a, b in pairs if a == 3} == {1, 2}


def test_looking_ahead_draws_nothing_and_a_seed_is_a_sequence() -> None:
    one, two = poisson(), poisson()
    got = []
    for tick in range(4000):
        while one.next_tick <= tick:
            assert one.next_tick == one.next_tick
            got.append(one.take())
    assert got == take(two, len(got))
    assert got != take(poisson(seed=2), len(got))
    assert all(t == int(t) and t < 4000 for t, _, _ in got)


def test_a_new_rate_begins_now_and_a_rate_of_nothing_ends_it() -> None:
    source = poisson()
    take(source, 5)
    assert source.set_rate(0.0, 1000) == ""
    assert source.next_tick == FOREVER
    assert source.set_rate(36_000.0, 5000) == ""
    ticks = [t for t, _, _ in take(source, 5000)]
    assert ticks[0] >= 5000
    assert (ticks[-1] - 5000) / 5000 == pytest.approx(0.1, rel=0.05)


def test_a_limit_ends_the_orders() -> None:
    source = poisson(limit=3)
    take(source, 3)
    assert source.next_tick == FOREVER


def test_a_source_goes_on_from_what_was_saved() -> None:
    source = poisson()
    take(source, 17)
    source.set_rate(100.0, 4000)
    saved = json.loads(json.dumps(source.to_plain()))
    rest = take(source, 50)
    again = poisson(seed=99, rate=1.0, limit=5)
    again.restore(saved)
    assert take(again, 50) == rest
    listed = Listed([(1, 2), (2, 3), (3, 1)])
    listed.take()
    other = Listed([(1, 2), (2, 3), (3, 1)])
    other.restore(listed.to_plain())
    assert [other.take(), other.take()] == [(0, 2, 3), (0, 3, 1)]
    assert other.next_tick == FOREVER
    assert "listed" in listed.set_rate(10.0, 3)


def test_the_book_keeps_open_orders_by_age() -> None:
    book = OrderBook()
    for i in range(4):
        book.add(i, (1, 2), (10, 11), 0)
    book.assign(1, 7)
    book.assign(0, 6)
    assert book.open == [2, 3]
    book.reopen(1)
    assert (book.open, book.vehicle[1], book.state[1]) == ([1, 2, 3], NONE, OrderState.OPEN)
    assert book.unfinished == 4
    assert OrderBook.from_plain(json.loads(json.dumps(book.to_plain()))) == book


# ---------------------------------------------------------------- dispatch


def run(rows: str, count: int, pairs: list[list[int]], **sections: Any) -> Any:
    text = scenario_text(rows, count, **{"orders": f'source = "listed"\npairs = {pairs}', **sections})
    return build(parse(text), recorder=MemoryLog())


def test_the_nearest_free_vehicle_takes_the_oldest_order() -> None:
    cells = "start = [[1, 0], [7, 0]]"  # C1 and C4
    sim = run(ROW, 2, [[3, 1], [1, 3]], fleet=cells)
    sim.advance(1)
    # R3 at (7, 2) is right above C4; then the other one is all that is left
    assert sim.fleet.order.tolist() == [1, 0]
    assert sim.book.state == [OrderState.ASSIGNED] * 2
    near = run(ROW, 2, [[1, 3]], fleet=cells)
    near.advance(1)
    assert near.fleet.order.tolist() == [0, NONE]


def test_distance_is_driven_not_flown() -> None:
    # one-way: the vehicle beside the station has to go all the way round
    rows = "##I####\n.>>>>>.\n.<<<<<.\n#C###C#\n"
    sim = run(rows, 2, [[1, 1]])
    goal = sim.world.station(1).place
    ticks = [sim.search.ticks_to(goal, int(s)) for s in sim.fleet.state]
    sim.advance(1)
    assert sim.fleet.order[int(np.argmin(ticks))] == 0
    assert ticks[0] != ticks[1]


def test_without_a_free_vehicle_orders_wait_by_age() -> None:
    sim = run(ROW, 1, [[1, 2], [2, 3], [3, 1]])
    order = []
    for _ in range(300):
        sim.advance(1)
        if sim.fleet.order[0] not in (NONE, *order[-1:]):
            order.append(int(sim.fleet.order[0]))
    assert order == [0, 1, 2]
    assert sim.metrics()["orders_done"] == 3


def test_reasons_are_told_once() -> None:
    sim = run(ROW, 1, [[1, 2]], orders=NO_ORDERS)
    sim.submit({"do": "block", "place": int(sim.world.station(2).place)})
    sim.submit({"do": "order", "from": 1, "to": 2})
    sim.advance(60)
    sim.flush()
    assert events(sim.log, "order waits") == ["order 0: its station is blocked"]
    sim.submit({"do": "unblock", "place": int(sim.world.station(2).place)})
    sim.advance(120)
    assert sim.metrics()["orders_done"] == 1


def test_too_little_charge_is_a_reason() -> None:
    sim = run(ROW, 1, [[1, 3]], battery="capacity_wh = 1.0", charging="good = 0.1\ncritical = 0.1")
    sim.advance(3)
    sim.flush()
    assert "charge" in sim.reasons[0]
    assert len(events(sim.log, "order waits")) == 1


def test_an_order_that_leaves_a_vehicle_low_needs_a_free_charger() -> None:
    # two vehicles, one charger, taken by a broken vehicle: what would end below `good` is not begun
    rows = "#I##O#\n......\n#C##P#\n"
    sim = run(
        rows, 2, [[1, 2]], battery="capacity_wh = 12.0\ninitial_soc = 0.4",
        charging="good = 0.35\nreserve = 0.0", fleet="start = [[1, 0], [4, 0]]", orders=NO_ORDERS,
    )  # fmt: skip
    sim.submit({"do": "fail", "vehicle": 0})
    sim.submit({"do": "order", "from": 1, "to": 2})
    sim.advance(5)
    assert sim.book.state == [OrderState.OPEN]
    assert sim.reasons[0] == "no rest place is free"
    sim.submit({"do": "repair", "vehicle": 0})
    sim.advance(400)
    assert sim.book.state == [OrderState.DONE]
    assert sim.metrics()["stranded"] == 0


def test_need_is_no_less_than_what_the_way_really_takes() -> None:
    for motion in ("", 'turning = "pivot"\nturn_ticks = 2'):
        sim = run(ROW, 1, [[1, 4]], motion=motion, fleet="payload_kg = 900.0", service="pick_s = 5.0\ndrop_s = 5.0")
        a, b = sim.world.station(1).place, sim.world.station(4).place
        sim.advance(0)
        need = Nearest(Levels()).need(sim.view, 0, a, b)
        before = int(sim.fleet.charge[0])
        while sim.metrics()["orders_done"] == 0 or sim.fleet.t1[0] < FOREVER or sim.fleet.step[0] < sim.fleet.steps[0]:
            sim.advance(1)
        used = (before - int(sim.fleet.charge[0])) * int(sim.parts.battery.voltage_mv[0]) // 1000
        assert 0.5 * need < used <= need


# ---------------------------------------------------------------- charging


def test_below_good_it_charges_before_it_works_and_works_from_sufficient() -> None:
    sim = run(
        ROW, 1, [[1, 2]], battery="capacity_wh = 20.0\ninitial_soc = 0.25",
        charging="good = 0.3\nsufficient = 0.6\nfull = 0.9", charger="power_w = 500.0",
    )  # fmt: skip
    capacity = sim.parts.battery.capacity_mc
    started = None
    while sim.metrics()["orders_done"] == 0:
        sim.advance(1)
        if started is None and sim.fleet.order[0] == 0:
            started = sim.fleet.charge[0] / capacity
    assert started == pytest.approx(0.6, abs=0.02)
    sim.advance(300)
    assert 0.85 * capacity < sim.fleet.charge[0] <= 0.9 * capacity


def test_more_vehicles_than_chargers_queue_and_all_get_their_turn() -> None:
    rows = "#I##O##R##R##R#\n...............\n#C#P#C#P#P#P#P#\n"
    sim = run(
        rows, 5, [[1, 2]], battery="capacity_wh = 30.0\ninitial_soc = [0.2, 0.28]", charger="power_w = 1500.0",
        charging="good = 0.3\nsufficient = 0.8", orders=NO_ORDERS,
    )  # fmt: skip
    queued, charged = 0, set()
    for _ in range(600):
        sim.advance(1)
        queued = max(queued, len(sim.queue))
        charging = np.flatnonzero(sim.fleet.kind == Activity.CHARGE).tolist()
        charged |= set(charging)
        assert len(charging) <= 2
    assert queued == 3
    assert charged == set(range(5))
    assert not sim.queue
    assert not sim.must_charge.any()
    assert (sim.fleet.charge > 0.5 * sim.parts.battery.capacity_mc).all()
    sim.flush()
    waiting = [t for t in events(sim.log, "charger queue") if "waits for a free charger" in t]
    assert len(waiting) == len(set(waiting)) == 3


def test_a_full_vehicle_makes_room() -> None:
    rows = "#I##O#\n......\n#C#PP#\n"
    sim = run(rows, 2, [[1, 2]], orders=NO_ORDERS, battery="capacity_wh = 30.0\ninitial_soc = 1.0")
    sim.advance(5)
    sim.submit({"do": "charge", "vehicle": 1})  # it stands in the parking bay, a little below full
    sim.advance(200)
    place = sim.graph.state_place[sim.fleet.state].tolist()
    assert place[1] == sim.world.chargers[0]
    assert place[0] in sim.world.parking
    assert not sim.must_charge.any()


def test_idle_vehicles_rest_where_they_bother_nobody() -> None:
    sim = run(HALL, 1, [[1, 2], [2, 3], [3, 1]])
    sim.advance(400)
    assert sim.metrics()["orders_done"] == 3
    assert sim.home[0] in (*sim.world.chargers, *sim.world.parking)
    assert sim.graph.state_place[sim.fleet.state[0]] == sim.home[0]
    assert sim.fleet.task[0] == Task.NONE


def test_two_vehicles_never_book_one_place() -> None:
    sim = run(LOOP, 4, [[1, 2]], orders=NO_ORDERS.replace("0\n", "700\n"), battery="capacity_wh = 40.0")
    for _ in range(600):
        sim.advance(1)
        homes = sim.home[sim.home != NONE].tolist()
        assert len(homes) == len(set(homes))
        assert all(sim.holder[h] == v for v, h in enumerate(sim.home.tolist()) if h != NONE)
        assert {int(v) for v in sim.holder if v != NONE} <= set(range(4))


@given(data=st.data(), vehicle=st.integers(0, 3), only=st.booleans(), count=st.integers(0, 6))
@settings(max_examples=60, deadline=None)
def test_free_rest_places_are_those_of_the_slow_twin(data: st.DataObject, vehicle: int, only: bool, count: int) -> None:
    places = 8
    near = data.draw(st.permutations(range(places)))
    holder, blocked, chargers = (
        data.draw(st.lists(st.integers(low, high), min_size=places, max_size=places))
        for low, high in ((NONE, 3), (0, 1), (0, 1))
    )
    out = np.empty(count, np.int32)
    flags = (np.array(a, np.uint8) for a in (blocked, chargers))
    n = free_rests(np.array(near, np.int32), np.array(holder, np.int32), *flags, vehicle, only, out)
    assert out[:n].tolist() == naive_dispatch.free_rests(near, holder, blocked, chargers, vehicle, only, count)
