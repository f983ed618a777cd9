"""Arc times: the observer against a plain count, the paper's tables, and routers that learn from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine import MemoryLog, judge
from engine.build import build, planner_of
from engine.planners.base import Leg, Observed, Request, View
from engine.planners.search import FloorSearch
from engine.planners.stochastic import Stochastic, p_quicker, printed_h
from engine.results.arcs import busy_s, describe, kurtosis_se, motion_rows, normality, shares_that_pass, skew_se, visits
from engine.results.view import RunView
from engine.scenario import load
from engine.sim import checkpoint
from engine.traffic import gap_at, new_arc_times, new_claims, observe
from engine.types import PRIMITIVE_0, Activity
from engine.world import build_world

NONE = np.zeros(0, np.int32)


@pytest.fixture(scope="module")
def run():
    """Four minutes of the network with periods of one minute."""
    log = MemoryLog()
    changes = {"planner.name": "stochastic", "planner.parameters.refresh_s": 60.0, "fleet.count": 40}
    sim = build(load("lian2024", changes), recorder=log)
    sim.advance(2400)
    sim.flush()
    return sim, log


def plain_visits(log, world):
    """(place, end, ticks) of every finished visit, vehicle by vehicle, said once more."""
    out = []
    rows = motion_rows(log)
    for v in np.unique(rows[:, 0]):
        at, waited = None, 0
        for _, kind, _, _, t0, t1, here, there, *_ in rows[rows[:, 0] == v].tolist():
            enters = kind >= PRIMITIVE_0 and here != there and world.graph.arc_ticks[there] > 0
            if (enters or kind in (Activity.PICK, Activity.DROP)) and at is not None:
                out.append((at, t0, int(world.graph.arc_ticks[at]) + waited))
                at = None
            if enters:
                at, waited = there, 0
            elif kind == Activity.WAIT:
                waited += t1 - t0
            elif kind in (Activity.REST, Activity.CHARGE):
                at = None
    return sorted(out)


def test_visits_are_those_of_a_plain_count(run):
    sim, log = run
    found = visits(log, sim.world, sim.tick_s)
    ticks = (found.ms / 100).astype(int).tolist()
    rows = sorted(zip(found.place.tolist(), found.tick.tolist(), ticks, strict=True))
    assert rows == plain_visits(log, sim.world)
    assert found.ms.min() == 900
    assert len(found.ms) > 2000


@given(st.lists(st.integers(1, 400), max_size=8))
def test_batches_of_any_size_are_observed_alike(cuts):
    rng = np.random.default_rng(sum(cuts))
    n, vehicles, places = 400, 4, 9
    rows = np.zeros((n, 14), np.int64)
    rows[:, 0] = rng.integers(0, vehicles, n)
    rows[:, 1] = rng.choice([Activity.WAIT, Activity.PICK, Activity.REST, PRIMITIVE_0, PRIMITIVE_0 + 1], n)
    rows[:, 4] = np.sort(rng.integers(0, 5000, n))
    rows[:, 5] = rows[:, 4] + rng.integers(1, 9, n)
    rows[:, 6], rows[:, 7] = rng.integers(0, places, n), rng.integers(0, places, n)
    own = np.array([0, 0, 0, 9, 9, 9, 9, 9, 9], np.int32)
    whole, parts = new_arc_times(own, vehicles), new_arc_times(own, vehicles)
    observe(whole, rows, n, NONE, NONE, NONE)
    ends = sorted({*np.cumsum(cuts).clip(0, n).tolist(), n})
    for a, b in zip([0, *ends], ends, strict=False):
        observe(parts, rows[a:b], b - a, NONE, NONE, NONE)
    for x, y in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(x, y)


def test_the_log_has_every_period_and_the_planner_learned_from_it(run):
    sim, log = run
    arcs = log.table("arcs")
    assert np.unique(arcs["tick"]).tolist() == [600, 1200, 1800, 2400]
    found = visits(log, sim.world, sim.tick_s)
    expected = np.where(sim.graph.arc_ticks > 0, 900, 0)
    for end in (600, 1200, 1800, 2400):
        rows = arcs["tick"] == end
        # a visit counts in the period in which the interval that follows it was written to the log
        place, n = arcs["place"][rows], arcs["samples"][rows]
        enough = n >= 5
        smoothed = np.rint(0.5 * expected[place] + 0.5 * arcs["mean_ms"][rows])
        right = np.where(enough, smoothed, expected[place])
        assert np.abs(arcs["expected_ms"][rows] - right).max() <= 1
        expected[place] = arcs["expected_ms"][rows]
    assert (arcs["samples"].sum() - len(found.ms)) in range(-40, 41)
    np.testing.assert_array_equal(sim.memory["expected_ms"][place], arcs["expected_ms"][rows])
    assert (arcs["mean_ms"][arcs["samples"] > 0] >= 900).all()


def test_busy_time_is_what_the_intervals_say(run):
    sim, log = run
    held = busy_s(log, sim.world, sim.tick_s, 600, 1800)
    rows = motion_rows(log)
    for place in sim.world.parking[:5].tolist():
        want = sum(max(0, min(r[5], 1800) - max(r[4], 600)) for r in rows.tolist() if place in (r[6], r[7]))
        assert held[place] == pytest.approx(want * sim.tick_s)
    assert held.max() <= 120.0 + 1e-6


def test_the_view_tells_of_arcs_what_the_log_says(run):
    sim, log = run
    view = RunView(log, sim.scenario, sim.world)
    own = sim.graph.arc_ticks * sim.tick_s
    np.testing.assert_array_equal(view.heat("expected", 0, 599), own)
    assert (view.heat("expected", 0, 600) != own).any()
    np.testing.assert_allclose(view.heat("expected", 0, 2400), sim.memory["expected_ms"] / 1000)
    np.testing.assert_array_equal(view.heat("expected", 0, 1799), view.heat("expected", 1500, 1200))
    told, rows = view.arcs(600, 1800), motion_rows(log)
    moves = rows[(rows[:, 1] >= PRIMITIVE_0) & (rows[:, 6] != rows[:, 7]) & (rows[:, 4] >= 600) & (rows[:, 4] < 1800)]
    np.testing.assert_array_equal(told["passages"], np.bincount(moves[:, 7], minlength=sim.world.n_places))
    np.testing.assert_allclose(told["occupancy"], busy_s(log, sim.world, sim.tick_s, 600, 1800) / 120, atol=1e-9)
    np.testing.assert_array_equal(told["expected_s"], view.heat("expected", 600, 1800))


def test_the_run_is_legal_and_resumes_to_the_same_digest(run, tmp_path):
    sim, log = run
    assert judge(log, sim.scenario, sim.world) == []
    first = build(sim.scenario)
    first.advance(1000)
    first.checkpoint(tmp_path / "at")
    again = build(sim.scenario)
    checkpoint.restore(again, tmp_path / "at", checkpoint.read_plain(tmp_path / "at"))
    again.advance(1400)
    assert again.digest() == sim.digest()


# ---------------------------------------------------------------- statistics


def test_the_standard_errors_are_those_of_the_paper_s_table():
    assert (round(skew_se(20), 3), round(kurtosis_se(20), 3)) == (0.512, 0.992)
    assert (round(skew_se(50), 3), round(kurtosis_se(50), 3)) == (0.337, 0.662)


def test_twenty_samples_with_the_paper_s_deviation_give_its_interval():
    """Table 1: deviation 80.2962 and half width 37.5798 belong to n = 20 and a standard error of 17.9548."""
    ms = np.random.default_rng(1).standard_normal(20)
    ms = 2001.112 + 80.2962 * (ms - ms.mean()) / ms.std(ddof=1)
    found = describe(ms)
    assert found["mean"] - found["ci_low"] == pytest.approx(37.5798, abs=2e-3)
    assert found["se"] == pytest.approx(17.9548, abs=1e-4)
    assert found["ci_low"] == pytest.approx(1963.5322, abs=2e-3)


def test_normal_samples_pass_at_their_level_and_queues_do_not():
    rng = np.random.default_rng(3)
    passed = [normality(rng.normal(2000, 80, 20), rng) for _ in range(150)]
    assert 0.88 <= np.mean([p["lilliefors_p"] > 0.05 for p in passed]) <= 1.0
    assert 0.88 <= np.mean([p["shapiro_p"] > 0.05 for p in passed]) <= 1.0
    queue = 900 + 1000 * rng.exponential(1.0, 200) * (rng.random(200) < 0.3)
    skewed = normality(queue, rng)
    assert skewed["lilliefors_p"] < 0.01
    assert skewed["shapiro_p"] < 1e-6
    assert describe(queue)["skew"] > 2 * skew_se(200)
    assert normality(np.full(20, 900.0))["shapiro_p"] == 0.0
    with pytest.raises(ValueError, match="at least"):
        normality(np.arange(3.0))


def test_arc_times_of_a_run_are_not_normal(run):
    sim, log = run
    share = shares_that_pass(visits(log, sim.world, sim.tick_s), most=20)
    assert share["arcs"] > 5
    assert share["shapiro"] < 0.5
    assert share["median_skew"] > 0


# ---------------------------------------------------------------- theorem 1

moments = st.tuples(st.floats(-1e3, 1e3), st.floats(0.0, 1e3), st.floats(-1e3, 1e3), st.floats(0.0, 1e3))


@given(moments)
def test_theorem_1_holds_for_independent_normals(of):
    mean_x, sd_x, mean_y, sd_y = of
    p = p_quicker(mean_x, sd_x, mean_y, sd_y)
    if mean_x <= mean_y:
        assert p >= 0.5
    elif mean_x > mean_y + 1e-9 * math.hypot(sd_x, sd_y):
        assert p < 0.5


def test_theorem_1_fails_for_an_exponential():
    """X ~ Exp(1) and Y = 0.8: E X > E Y, and yet X ≤ Y is the likelier."""
    draws = np.random.default_rng(0).exponential(1.0, 200_000)
    assert draws.mean() > 0.8
    assert (draws <= 0.8).mean() == pytest.approx(1 - math.exp(-0.8), abs=0.005)
    assert 1 - math.exp(-0.8) > 0.5


# ---------------------------------------------------------------- routers


@pytest.fixture(scope="module")
def empty():
    """The network without anybody, its search, and what a request needs."""
    scenario = load("lian2024")
    sim = build(scenario)
    world = sim.world
    claims = new_claims(world.n_places, 64)
    blocked = np.zeros(world.n_places, np.uint8)

    def view(a: str, b: str) -> View:
        node = {n.name: i for i, n in enumerate(world.nodes)}
        start = world.graph.state(node[a], world.graph.heading_deg.index(0))
        legs = (Leg(node[b], 50, Activity.PICK, False), Leg(int(world.parking[0]), 0, Activity.REST, False))
        request = Request(0, start, int(gap_at(claims, node[a], 0)), 0, 0, legs)
        search = FloorSearch(world.graph, sim.parts.costs)
        return View(world.graph, world.occupancy, 0, sim.parts.costs, claims, blocked, 0, search, request)

    return sim, view


def learned(router: Stochastic, sim, slow=(), ms: int = 5000):
    """The router's memory after a period in which some places took so long and all others their own time."""
    graph = sim.graph
    memory = router.init(graph, sim.parts.costs, np.random.default_rng(0))
    nothing = np.zeros(graph.n_places, np.int64)
    memory = router.learn(Observed(nothing, nothing, sim.tick_s), memory)
    n = np.where(graph.arc_ticks > 0, 10, 0).astype(np.int64)
    total = n * graph.arc_ticks
    total[list(slow)] = 10 * ms // 100
    return router.learn(Observed(n, total, sim.tick_s), memory)


def lanes(world, edges) -> list[str]:
    graph = world.graph
    places = [int(graph.state_place[graph.edge_to[e]]) for e in edges]
    return [world.names[p] for p in places if p >= world.n_nodes]


def way(sim, edges) -> tuple[int, int]:
    """(millimetres, degrees turned) of a route."""
    kinds = [sim.graph.primitives[k] for k in sim.graph.edge_kind[list(edges)]]
    return sum(k.length_mm for k in kinds), sum(k.turn_deg for k in kinds)


def test_routers_find_their_own_optimum(empty):
    sim, view = empty
    v = view("1/1", "7/5")
    for name, turns in (("astar-turns", 90), ("stochastic", 90), ("astar-distance", None)):
        router = planner_of(name, sim.scenario).router
        memory = router.init(sim.graph, sim.parts.costs, np.random.default_rng(0))
        if name == "stochastic":
            memory = learned(router, sim)
        legs, _ = router.route(v, memory)
        mm, turned = way(sim, legs[0])
        assert mm == 10 * 900
        assert turns is None or turned == turns


def test_the_stochastic_router_drives_around_what_it_knows_to_be_slow(empty):
    sim, view = empty
    v = view("1/3", "6/3")
    router = Stochastic(smoothing=1.0)
    straight, _ = router.route(v, learned(router, sim))
    assert way(sim, straight[0]) == (5 * 900, 0)
    slow = [int(sim.graph.state_place[sim.graph.edge_to[e]]) for e in straight[0]][1:3]
    memory = learned(router, sim, slow, 6000)
    around, _ = router.route(v, memory)
    assert not {sim.world.names[p] for p in slow} & set(lanes(sim.world, around[0]))
    # exact: the expected time of the detour is the least over all ways, by an independent search
    import networkx as nx

    graph = nx.DiGraph()
    for e in range(sim.graph.n_edges):
        a, b = int(sim.graph.edge_from[e]) >> 1, int(sim.graph.edge_to[e]) >> 1
        graph.add_edge(a, b, ms=int(memory["cost"][e]))
    goal = v.request.legs[0].place
    ends = range(int(sim.graph.place_ptr[goal]) >> 1, int(sim.graph.place_ptr[goal + 1]) >> 1)
    best = nx.single_source_dijkstra_path_length(graph, v.request.state >> 1, weight="ms")
    assert sum(memory["cost"][around[0]]) == min(best[p] for p in ends if p in best)


def test_an_arc_with_few_samples_keeps_its_time_and_smoothing_takes_a_share(empty):
    sim, _ = empty
    lane = sim.world.n_nodes + 7
    for router, n, expected in ((Stochastic(), 4, 900), (Stochastic(), 5, 1950), (Stochastic(smoothing=1.0), 5, 3000)):
        memory = router.init(sim.graph, sim.parts.costs, np.random.default_rng(0))
        samples, total = np.zeros(sim.graph.n_places, np.int64), np.zeros(sim.graph.n_places, np.int64)
        memory = router.learn(Observed(samples, total, sim.tick_s), memory)
        samples[lane], total[lane] = n, 30 * n
        assert router.learn(Observed(samples, total, sim.tick_s), memory)["expected_ms"][lane] == expected
    with pytest.raises(ValueError, match="smoothing"):
        Stochastic(smoothing=0.0)


def test_the_printed_heuristic_overestimates_and_so_misses_the_best(empty):
    """Arcs slower in the mean than on the way: h as printed is more than what remains, and g is blind to them."""
    sim, view = empty
    v = view("1/3", "6/3")
    half = (sim.world.n_nodes + np.arange(0, len(sim.world.lane_arc), 2)).tolist()
    literal, corrected = Stochastic(smoothing=1.0, literal=True), Stochastic(smoothing=1.0)
    memory = learned(literal, sim, half, 9000)
    goal = v.request.legs[0].place
    h = printed_h(sim.graph, memory["expected_ms"], goal)
    rows = FloorSearch(sim.graph, sim.parts.costs).by_edge("own", 0, memory["cost"])
    exact = rows.pool[rows.slot(goal)]
    assert (h[exact < 2**40] > exact[exact < 2**40] + 900).any()
    legs, _ = literal.route(v, memory)
    best, _ = corrected.route(v, learned(corrected, sim, half, 9000))
    truth = learned(corrected, sim, half, 9000)["cost"]
    assert truth[legs[0]].sum() >= truth[best[0]].sum()


def test_a_parked_vehicle_is_driven_around(empty):
    sim, view = empty
    v = view("1/3", "6/3")
    router = planner_of("astar-turns", sim.scenario).router
    memory = router.init(sim.graph, sim.parts.costs, np.random.default_rng(0))
    straight, _ = router.route(v, memory)
    lane = int(sim.graph.state_place[sim.graph.edge_to[straight[0][2]]])
    from engine.traffic import claim, release

    slot = claim(v.claims, lane, 40, 2**30, 5)
    around, _ = router.route(v, memory)
    assert sim.world.names[lane] not in lanes(sim.world, around[0])
    release(v.claims, slot)
    assert build_world(load("lian2024")).n_places == sim.world.n_places
