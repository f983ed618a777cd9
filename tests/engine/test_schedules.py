"""Sequences of orders: exact, by insertion, by the paper's rule; and what they do in a run."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine import MemoryLog, judge
from engine.build import DISPATCHERS, build, resume
from engine.dispatch import kernels
from engine.dispatch.insertion import insertion
from engine.dispatch.makespan import makespan
from engine.dispatch.schedule import BARRED, Schedule, Work, by_rule, schedule_of
from engine.errors import ScenarioError
from engine.scenario import load, parse
from engine.sim.judge import judge_plan
from engine.types import OrderState
from tests import naive, naive_dispatch

NODES = 5000


def random_work(seed: int, vehicles: int, orders: int, exits: int = 2, barred: float = 0.0) -> Work:
    """Places on a floor of 26 × 18, or times without any geometry for every third seed; some vehicles may not take some
    orders, and some orders may not leave by some exits."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 0:
        first, carry, back = (rng.integers(1, 60, s) for s in ((vehicles, orders), (orders, exits), (exits, orders)))
    else:
        at, to, out = (rng.integers((1, 1), (27, 19), (n, 2)) for n in (vehicles, orders, exits))
        first, carry, back = (4 * np.abs(a[:, None] - b).sum(2) for a, b in ((at, to), (to, out), (out, to)))
        first, carry, back = first + 45, carry + 36, back + 45
    if barred:
        first = np.where(rng.random(first.shape) < barred, BARRED, first)
        first[0] = np.where(first.min(0) >= BARRED, 99, first[0])
        closed = rng.random(carry.shape) < barred
        carry = np.where(closed & ~closed.all(1, keepdims=True), BARRED, carry)
    return Work(first.astype(np.int64), carry.astype(np.int64), back.astype(np.int64))


def check(work: Work, found: Schedule) -> None:
    """Every order once, times as counted leg by leg, the bound a bound on it."""
    given = [i for route in found.routes for i in route]
    assert sorted(given) == np.flatnonzero(work.may.any(0)).tolist()
    for r, (route, exits) in enumerate(zip(found.routes, found.exits, strict=True)):
        assert found.ends[r] == naive_dispatch.time_of(work, r, list(route), list(exits))
        assert all(work.may[r, i] for i in route)
    assert found.bound <= found.makespan < BARRED


@pytest.mark.parametrize("seed", range(24))
def test_the_program_finds_what_dynamic_programming_finds(seed: int) -> None:
    vehicles, orders = 1 + seed % 3, 1 + seed * 5 % 6
    work = random_work(seed, vehicles, orders, exits=1 + seed % 4, barred=0.25 if seed % 2 else 0.0)
    found = makespan(work, NODES)
    check(work, found)
    assert found.makespan == naive_dispatch.least_makespan(work)
    assert found.gap == 0


def test_three_vehicles_and_eight_orders() -> None:
    work = random_work(1, 3, 8)
    found = makespan(work, NODES)
    check(work, found)
    assert found.makespan == found.bound == naive_dispatch.least_makespan(work)


def test_too_few_nodes_leave_a_gap_that_is_true() -> None:
    gaps = []
    for seed in (1, 4):
        work = random_work(seed, 3, 6)
        found = makespan(work, 1)
        check(work, found)
        assert found.bound <= naive_dispatch.least_makespan(work) <= found.makespan
        gaps.append(found.gap)
    assert max(gaps) < 0.2


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(1, 5), st.sampled_from([0.0, 0.3]))
def test_no_schedule_beats_its_lower_bound(seed: int, vehicles: int, orders: int, barred: float) -> None:
    work = random_work(seed, vehicles, orders, exits=2, barred=barred)
    least = naive_dispatch.least_makespan(work)
    assert work.lower_bound() <= least
    for found in (insertion(work, 50), by_rule(work)):
        check(work, found)
        assert found.makespan >= least


def test_by_rule_takes_the_nearest_order_and_the_nearest_exit() -> None:
    work = random_work(4, 2, 6)
    found = by_rule(work)
    check(work, found)
    clock, at, left = [0, 0], [-1, -1], set(range(6))
    took: list[list[int]] = [[], []]
    while left:
        r = 0 if clock[0] <= clock[1] else 1
        reach = {i: int(work.first[r, i] if at[r] < 0 else work.back[at[r], i]) for i in sorted(left)}
        i = min(reach, key=lambda i: reach[i])
        at[r] = int(np.argmin(work.carry[i]))
        clock[r] += reach[i] + int(work.carry[i, at[r]])
        took[r].append(i)
        left.remove(i)
    assert [list(r) for r in found.routes] == took
    assert found.ends == tuple(clock)


@pytest.mark.nojit_slice
@pytest.mark.parametrize("seed", range(6))
def test_insertion_is_what_its_twin_inserts(seed: int) -> None:
    vehicles, orders = 3, 14
    work = random_work(seed, vehicles, orders, barred=0.2 if seed % 2 else 0.0)
    after, owner = np.full(orders + vehicles, -1, np.int32), np.full(orders, -1, np.int32)
    time = np.zeros(vehicles, np.int64)
    routes: list[list[int]] = [[] for _ in range(vehicles)]
    for limit, order in zip([0, 200, 400, 10**6] * 4, np.random.default_rng(seed).permutation(orders), strict=False):
        kernels.insert(work.link, work.end, work.first, after, owner, time, order, limit)
        before = routes
        routes = naive_dispatch.inserted(work, before, int(order), limit)
        mine: list[list[int]] = [[] for _ in range(vehicles)]
        for r in range(vehicles):
            at = after[orders + r]
            while at >= 0:
                mine[r].append(int(at))
                at = after[at]
        assert [work.takes(r, route) for r, route in enumerate(mine)] == time.tolist()
        # equally good places may differ: what counts is what they cost
        cost = []
        for each in (mine, routes):
            r = next(r for r in range(vehicles) if len(each[r]) > len(before[r]))
            now = work.takes(r, each[r])
            cost.append((now <= limit, now - work.takes(r, before[r]) if now <= limit else now))
        assert cost[0] == cost[1]
        routes = mine
    for order in range(0, orders, 2):
        kernels.remove(work.link, work.end, work.first, after, owner, time, order)
        routes = [[i for i in route if i != order] for route in routes]
        assert [work.takes(r, route) for r, route in enumerate(routes)] == time.tolist()


def test_local_search_never_makes_it_worse_and_gets_near_the_least() -> None:
    ours, least = 0, 0
    for seed in range(12):
        work = random_work(seed, 3, 7)
        plain, better = insertion(work, 0), insertion(work, 400)
        assert (better.makespan, better.total) <= (plain.makespan, plain.total) or better.makespan < plain.makespan
        again = insertion(work, 100, better)
        assert again.makespan <= better.makespan
        ours, least = ours + better.makespan, least + naive_dispatch.least_makespan(work)
    assert ours <= 1.02 * least


def test_a_hundred_vehicles_and_a_thousand_orders() -> None:
    work = random_work(1, 100, 1000)
    found = insertion(work, 3000)
    check(work, found)
    assert found.gap < 0.05


def test_nothing_to_do() -> None:
    for vehicles, orders in ((2, 0), (0, 0)):
        empty = Work(*(np.zeros(s, np.int64) for s in ((vehicles, orders), (orders, 1), (1, orders))))
        for found in (insertion(empty, 10), makespan(empty, 10), by_rule(empty)):
            assert found.makespan == found.gap == 0
    work = random_work(1, 2, 3)
    assert schedule_of(work, [[0, 1, 2], []]).ends[1] == 0


def test_hungarian_has_the_least_sum_of_ways() -> None:
    pairs = [[55, 1], [20, 1], [78, 1], [100, 1], [60, 1]]
    sim = wang(
        dispatch__policy="hungarian", orders__pairs=pairs, fleet__count=3, fleet__start=[[8, 13], [17, 6], [2, 3]]
    )
    sim.advance(0)
    ways = {
        (v, o): sim.search.ticks_to(sim.book.from_place[o], at)
        for v, at in enumerate(sim.view.at.tolist())
        for o in range(5)
    }
    sim.advance(1)
    assert sorted(sim.book.vehicle[o] for o in range(5) if sim.book.vehicle[o] >= 0) == [0, 1, 2]
    taken = sum(ways[int(v), o] for o, v in enumerate(sim.book.vehicle) if v >= 0)
    assert taken == min(sum(ways[v, o] for v, o in enumerate(some)) for some in permutations(range(5), 3))


# ---------------------------------------------------------------- in a run


def wang(**changes: Any) -> Any:
    text = load("wang2019").to_toml()
    return build(parse(text, "wang2019", {k.replace("__", "."): v for k, v in changes.items()}), recorder=MemoryLog())


@pytest.mark.parametrize("policy", sorted(DISPATCHERS))
def test_every_dispatcher_serves_the_paper_s_floor(policy: str) -> None:
    sim = wang(dispatch__policy=policy)
    sim.advance(1000)
    sim.flush()
    assert sim.done
    assert sim.book.state == [OrderState.DONE] * 4
    assert judge(sim.log, sim.scenario, sim.world) == []
    rows = naive.rows_of(sim.log.table("orders"))
    out = {r["order"]: r["to_station"] for r in rows if r["state"] == OrderState.DONE}
    # `nearest` and `in-turn` leave the exit as ordered; the others bring K2 and K4 to the east
    as_ordered = policy in ("nearest", "in-turn")
    assert out == ({0: 1, 1: 1, 2: 1, 3: 1} if as_ordered else {0: 1, 1: 2, 2: 1, 3: 2})


@pytest.mark.parametrize("policy", sorted(DISPATCHERS))
def test_every_dispatcher_serves_orders_that_keep_coming(policy: str) -> None:
    text = load("soochow2022-continuous").to_toml()
    changes = {"dispatch.policy": policy, "orders.rate_per_h": 400.0, "fleet.count": 6}
    sim = build(parse(text, "busy", changes), recorder=MemoryLog())
    sim.advance(400)
    sim.flush()
    assert judge(sim.log, sim.scenario, sim.world) == []
    assert sim.metrics()["orders_done"] > 15


def test_orders_stay_in_their_region() -> None:
    sim = wang(dispatch__regions=2, dispatch__policy="insertion", orders__pairs=[[55, 1], [85, 1], [85, 1]])
    sim.advance(1200)
    sim.flush()
    assert sim.book.vehicle == [0, 0, 0]
    assert sim.done
    assert judge(sim.log, sim.scenario, sim.world) == []
    # judged by the rule of another number of regions, it is wrong
    other = sim.scenario.model_copy(
        update={"dispatch": sim.scenario.dispatch.model_copy(update={"regions": 28})}
    )  # fmt: skip
    assert "region" in judge(sim.log, other, sim.world)[0].text


def test_the_judge_sees_an_order_brought_elsewhere() -> None:
    sim = wang()
    sim.advance(1000)
    sim.flush()
    strict = sim.scenario.model_copy(
        update={"dispatch": sim.scenario.dispatch.model_copy(update={"exits": "as ordered"})}
    )  # fmt: skip
    assert len([b for b in judge(sim.log, strict, sim.world) if "goes from" in b.text]) == 2


def test_a_blocked_exit_is_not_chosen() -> None:
    sim = wang(orders__pairs=[[78, 1]], fleet__count=2)
    sim.submit({"do": "block", "place": int(sim.world.station(2).place)})
    sim.advance(800)
    assert sim.book.to_station == [1]
    assert sim.book.state == [OrderState.DONE]


def test_dispatchers_refuse_parameters_that_they_do_not_have() -> None:
    with pytest.raises(ScenarioError, match="unknown parameter of makespan 'node'; did you mean 'nodes'"):
        wang(dispatch__parameters={"node": 3})


def test_who_drives_against_a_lane_is_told() -> None:
    world = wang().world
    along = [world.place_at(x, 9) for x in range(3, 7)]
    assert judge_plan(world.graph, [along], starts=along[:1], goals=along[-1:]) == []
    breaches = judge_plan(world.graph, [along[::-1]], starts=along[-1:], goals=along[:1])
    assert {str(breach.kind) for breach in breaches} == {"one-way"}


@pytest.mark.parametrize("policy", ["insertion", "makespan"])
def test_a_run_that_is_resumed_is_the_run_that_was_not_ended(policy: str, tmp_path: Path) -> None:
    text = load("soochow2022-continuous").to_toml()
    changes = {"dispatch.policy": policy, "orders.rate_per_h": 400.0, "fleet.count": 4}
    whole = build(parse(text, "busy", changes), recorder=MemoryLog())
    whole.advance(100)
    whole.checkpoint(tmp_path / "checkpoint")
    whole.advance(100)
    again = resume(tmp_path / "checkpoint", recorder=MemoryLog())
    again.advance(100)
    assert again.fleet.charge.tolist() == whole.fleet.charge.tolist()
    assert again.fleet.state.tolist() == whole.fleet.state.tolist()
    assert again.book.to_plain() == whole.book.to_plain()


def test_the_layout_is_the_paper_s() -> None:
    sim = wang()
    rows = sim.scenario.floor.drawing()
    assert (len(rows[0]) - 2, len(rows) - 2) == (26, 18)
    racks = {(x, len(rows) - 1 - y) for y, row in enumerate(rows) for x, letter in enumerate(row) if letter == "R"}
    columns, lines = [3, 9, 15, 21], [3, 7, 11, 15]
    assert racks == {(x + i, y + j) for x in columns for y in lines for i in range(4) for j in range(2)}
    exits = [sim.world.cell_of_place[s.access].tolist() for s in sim.world.stations_of("outbound")]
    assert exits == [[1, 9], [26, 9]]
    # keep right: the lane to the east lies south of the one to the west
    assert [rows[len(rows) - 1 - y][4] for y in (1, 2, 5, 6, 9, 10)] == [">", "<"] * 3
    assert [rows[len(rows) - 1 - 3][x] for x in (1, 2, 7, 8)] == ["v", "^"] * 2
