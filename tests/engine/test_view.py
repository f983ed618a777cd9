"""RunView against its slow twin, live against replayed, and what a person reads."""

from __future__ import annotations

import itertools
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import engine.build
import engine.scenario
from engine.results.runlog import LogReader, MemoryLog, RunLogWriter
from engine.results.schema import ENERGY_COLUMNS, TABLES
from engine.results.timeline import Timeline, overlap_sums
from engine.results.view import ACTIVITIES, RunView
from engine.scenario import Scenario, parse
from engine.types import FOREVER, NONE, Cause
from engine.world.floor import World, build_world
from tests import synthetic
from tests.naive_view import NaiveView

TICKS = 1300


@cache
def made() -> tuple[MemoryLog, Scenario, World]:
    scenario = parse(synthetic.scenario_toml(ticks=TICKS))
    world = build_world(scenario)
    log = MemoryLog()
    synthetic.make_log(log, scenario, world, ticks=TICKS, commands=synthetic.COMMANDS)
    return log, scenario, world


@cache
def views() -> tuple[RunView, NaiveView]:
    return RunView(*made()), NaiveView(*made())


times = st.one_of(st.integers(0, TICKS).map(float), st.floats(0, TICKS), st.floats(TICKS - 5, TICKS))


@settings(max_examples=60)
@given(time=times)
def test_poses_are_those_of_the_slow_twin(time: float) -> None:
    view, naive = views()
    poses = view.poses(time)
    for v in range(view.n):
        x, y, heading = naive.pose(v, time)
        assert poses.x_m[v] == pytest.approx(x, abs=1e-4)
        assert poses.y_m[v] == pytest.approx(y, abs=1e-4)
        assert abs((poses.heading_deg[v] - heading + 180) % 360 - 180) < 1e-3
        m = naive.interval(v, time)
        assert poses.loaded[v] == m["loaded"]
        assert poses.order[v] == m["order"]
        state = naive.last(naive.states, v, math.ceil(time) - 1)  # the state until now
        assert poses.state[v] == (state["state"] if state else 0)
        assert poses.soc[v] == pytest.approx(naive.charge(v, time) / view.capacity_mc, abs=1e-6)


@settings(max_examples=25)
@given(time=times)
def test_the_fleet_is_that_of_the_slow_twin(time: float) -> None:
    view, naive = views()
    for v, record in enumerate(view.fleet(time)):
        assert record["vehicle"] == v
        assert record["distance_m"] == pytest.approx(naive.distance_m(v, time), abs=1e-6)
        assert record["waiting_s"] == pytest.approx(naive.waiting_s(v, time), abs=1e-6)
        done = [o for o in naive.orders(time).values() if o[0] == "done" and o[1] == v]
        assert record["orders_done"] == len(done)


@settings(max_examples=25)
@given(time=times)
def test_orders_are_those_of_the_slow_twin(time: float) -> None:
    view, naive = views()
    expected = naive.orders(time)
    found = view.orders(time, limit=10_000)
    assert {o["order"]: (o["state"], o["vehicle"] if o["vehicle"] is not None else NONE) for o in found} == {
        n: (state, vehicle) for n, (state, vehicle, _) in expected.items()
    }
    closed = [o["state"] in ("done", "withdrawn") for o in found]
    assert closed == sorted(closed)  # what is open comes first
    for part in (False, True):
        numbers = [o["order"] for o, c in zip(found, closed, strict=True) if c is part]
        assert numbers == sorted(numbers, reverse=True)  # and the newest first
    for o in found:
        assert o["created_s"] == expected[o["order"]][2]
        assert len(view.orders(time, limit=3)) == min(3, len(found))
    kpis = view.kpis(time)
    assert kpis["orders_created"] == len(expected)
    assert kpis["orders_done"] == sum(state == "done" for state, _, _ in expected.values())


@settings(max_examples=25)
@given(span=st.tuples(st.floats(0, TICKS), st.floats(0, TICKS)).map(sorted), points=st.integers(1, 7))
def test_occupancy_is_that_of_the_slow_twin(span: list[float], points: int) -> None:
    view, naive = views()
    t0, t1 = span[0], max(span[1], span[0] + 1.0)
    t1 = min(t1, TICKS)
    t0 = min(t0, t1 - 0.5)
    found = view.occupancy(t0, t1, points)
    edges = np.linspace(t0, t1, points + 1)
    for i in range(points):
        expected = naive.shares(edges[i], edges[i + 1])
        for name in ACTIVITIES:
            assert found[name][i] == pytest.approx(expected[name], abs=1e-6), name
    heat = view.heat("occupancy", t0, t1)
    for place in range(0, view.world.graph.n_places, 7):
        assert heat[place] == pytest.approx(naive.held(place, t0, t1), abs=1e-6)


@given(
    spans=st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50), st.integers(0, 2)), max_size=20),
    first=st.integers(0, 40),
    length=st.integers(1, 30),
    bins=st.integers(1, 9),
)
def test_sums_of_overlaps(spans: list[tuple[int, int, int]], first: int, length: int, bins: int) -> None:
    edges = np.linspace(first, first + length, bins + 1)
    t0 = np.array([min(a, b) for a, b, _ in spans], np.int64)
    t1 = np.array([max(a, b) for a, b, _ in spans], np.int64)
    group = np.array([g for _, _, g in spans], np.int64)
    found = overlap_sums(edges, t0, t1, group, 3)
    for i in range(bins):
        for g in range(3):
            each = np.clip(np.minimum(t1, edges[i + 1]) - np.maximum(t0, edges[i]), 0, None)[group == g]
            assert found[i, g] == pytest.approx(each.sum(), abs=1e-9)


@given(st.lists(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 30)), max_size=8), max_size=5))
def test_a_timeline_grows_as_if_sorted_at_once(parts: list[list[tuple[int, int]]]) -> None:
    line = Timeline()
    rows: list[tuple[int, int]] = []
    for part in parts:
        rows += part
        table = np.array(rows, np.int64).reshape(-1, 2)
        line.extend(table[:, 0], table[:, 1])
    ordered = sorted(range(len(rows)), key=lambda i: (rows[i], i))
    assert line.row.tolist() == ordered
    for time in range(-1, 32):
        at = line.position(np.arange(5), time)
        for v in range(5):
            own = [i for i in ordered if rows[i][0] == v and rows[i][1] <= time]
            assert (line.row[at[v]] if at[v] >= 0 else None) == (own[-1] if own else None)


def test_what_grows_is_what_was_recorded(tmp_path: Path) -> None:
    """Live and replayed agree: a view that refreshes while the run is written, and one of the closed run."""
    _, scenario, world = made()
    writer = RunLogWriter(tmp_path / "r", {"tick_s": 1.0}, segment_bytes=20_000)
    live: list[tuple[int, Any, Any]] = []
    view: RunView | None = None

    class Tee:
        def write(self, table: str, columns: Any) -> None:
            writer.write(table, columns)

        def flush(self) -> None:
            nonlocal view
            writer.flush()
            if view is None:
                view = RunView(LogReader(tmp_path / "r"), scenario, world)
            else:
                assert view.refresh()
                assert not view.refresh()
            live.append((view.t_end, view.poses(view.t_end), view.fleet(view.t_end)))

    synthetic.make_log(Tee(), scenario, world, ticks=600, commands=synthetic.COMMANDS, flush_every=37)
    writer.close()
    replayed = RunView(LogReader(tmp_path / "r"), scenario, world)
    assert [t for t, _, _ in live] == [*range(37, 600, 37), 600]
    for t, poses, fleet in live:
        again = replayed.poses(t)
        for name in ("x_m", "y_m", "heading_deg", "loaded", "order", "place"):
            assert np.array_equal(getattr(poses, name), getattr(again, name)), (t, name)
        for record, later in zip(fleet, replayed.fleet(t), strict=True):
            assert record["distance_m"] == pytest.approx(later["distance_m"])
            assert record["waiting_s"] == pytest.approx(later["waiting_s"])
    assert view is not None
    view.refresh()
    assert view.fleet(600) == replayed.fleet(600)
    assert view.orders(450) == replayed.orders(450)
    assert view.kpis(599.5) == replayed.kpis(599.5)


def test_times_outside_the_log_are_clamped() -> None:
    view, _ = views()
    assert np.array_equal(view.poses(-5).x_m, view.poses(0).x_m)
    assert np.array_equal(view.poses(1e9).x_m, view.poses(TICKS).x_m)
    assert view.kpis(1e9)["time_s"] == TICKS
    assert view.soc(-10, 1e9, 5)["t_s"].tolist() == [0, 325, 650, 975, 1300]


def test_a_log_whose_beginning_was_dropped_begins_there(tmp_path: Path) -> None:
    _, scenario, world = made()
    with RunLogWriter(tmp_path / "r", {"tick_s": 1.0}, segment_bytes=5_000, retention_bytes=30_000) as writer:
        synthetic.make_log(writer, scenario, world, ticks=TICKS, commands=synthetic.COMMANDS, flush_every=20)
    view = RunView(LogReader(tmp_path / "r"), scenario, world)
    whole, _ = views()
    first = view.first_tick
    assert 0 < first < TICKS
    assert np.array_equal(view.poses(0).x_m, view.poses(first).x_m)
    for time in (first, first + 0.5, (first + TICKS) / 2, TICKS):
        a, b = view.fleet(time), whole.fleet(time)
        # at the first tick the state shown is that of the tick before, which is gone
        for name in ("x", "y", "orders_done") if time == first else ("x", "y", "state", "orders_done"):
            assert [r[name] for r in a] == [r[name] for r in b], (time, name)
        assert [r["distance_m"] for r in a] == pytest.approx([r["distance_m"] for r in b])
    assert len(view.orders(TICKS, 10_000)) == len(whole.orders(TICKS, 10_000))


def test_why_somebody_waits_is_a_sentence() -> None:
    view, naive = views()
    said: dict[int, str] = {}
    for row in naive.states:
        if row["state"] == 2:
            record = view.fleet(row["tick"] + 0.5)[row["vehicle"]]
            said.setdefault(row["cause"], record["why"])
            if row["cause"] == Cause.VEHICLE:
                assert record["why"].startswith(f"waits for vehicle {row['blocker']} to leave ")
                ahead = naive.interval(row["blocker"], row["tick"])
                names = {view.world.place_name(ahead[c]) for c in ("from_place", "to_place")}
                left = [m for m in naive.motions if m["vehicle"] == row["blocker"] and m["t1"] <= row["tick"]]
                names |= {view.world.place_name(left[-1]["from_place"])} if left else set()
                assert any(record["why"].endswith(name) for name in names)
    assert "is blocked" in said[Cause.BLOCKED]
    fleet = [view.fleet(t) for t in (125, 510)]
    assert fleet[0][1]["why"] in ("is paused by the operator", "")
    assert {"is broken down"} & {r["why"] for r in fleet[1]} == {"is broken down"}
    assert all(r["why"] == "" for r in fleet[0] if r["state"] == "moving")


def test_routes_begin_where_the_vehicle_is() -> None:
    view, naive = views()
    seen = 0
    for time in range(3, TICKS, 41):
        for route in view.routes(time):
            m = naive.interval(route["vehicle"], time)
            running = m["kind"] >= 16 and time < m.get("foreseen", m["t1"])
            assert route["places"][0] == (m["from_place"] if running else m["to_place"])
            if running:
                assert route["places"][1] == m["to_place"]
            assert len(route["places"]) == len(route["t_in"]) == len(route["t_out"])
            assert route["t_out"][-1] == FOREVER
            seen += 1
    assert seen > 40


def test_reservations_end_with_the_next_plan() -> None:
    view, _ = views()
    r = view.reservations(200, 400)
    assert (r["t0"] < r["t1"]).all()
    assert (r["t1"] > 200).all()
    assert (r["t0"] < 400).all()
    assert (r["t1"] <= 400).all()
    assert set(r["vehicle"].tolist()) == set(range(5))
    plans = made()[0].table("plans")
    for v in range(5):
        ticks = plans["tick"][plans["vehicle"] == v]
        final = r["vehicle"] == v
        for a, b in zip(r["t0"][final], r["t1"][final], strict=True):
            assert not ((ticks > a) & (ticks < b)).any() or not (ticks[(ticks > a) & (ticks < b)] > a).any() or b <= 400


def test_bands_follow_each_other() -> None:
    view, naive = views()
    bands = view.bands(100, 900)
    for v in range(5):
        own = [b for b in bands if b[0] == v]
        assert own[0][1] == 100
        assert own[-1][2] == 900
        for a, b in itertools.pairwise(own):
            assert a[2] == b[1]
            assert a[3] != b[3]
        for _, t0, t1, state in own:
            row = naive.last(naive.states, v, (t0 + t1) / 2)
            assert row is not None
            assert row["state"] == state
    assert view.bands(100, 900, vehicles=[2]) == [b for b in bands if b[0] == 2]


def test_chargers_tell_who_is_there() -> None:
    view, naive = views()
    charging = [m for m in naive.motions if m["kind"] == 3]
    assert charging
    for m in charging[:10]:
        record = next(c for c in view.chargers((m["t0"] + m["t1"]) / 2) if c["place"] == m["to_place"])
        assert (record["state"], record["vehicle"]) == ("charging", m["vehicle"])
    assert view.chargers(350)[11]["state"] == "out of order"
    assert view.chargers(450)[11]["state"] != "out of order"
    at_start = [c for c in view.chargers(0) if c["state"] == "occupied"]
    assert len(at_start) == 5


def test_events_are_the_newest_first() -> None:
    view, _ = views()
    events = view.events(0, TICKS)
    assert [e["tick"] for e in events] == sorted((e["tick"] for e in events), reverse=True)
    assert len(view.events(0, TICKS, limit=2)) == 2
    assert view.events(0, TICKS, limit=2) == events[:2]
    assert all(200 <= e["tick"] <= 240 for e in view.events(200, 240))
    assert {e["kind"] for e in view.events(200, 240)} >= {"block"}


def test_curves_end_at_the_totals() -> None:
    view, _ = views()
    energy = view.energy(0, TICKS, 20)
    assert all((np.diff(values) >= 0).all() for name, values in energy["components"].items() if name != "charged")
    drawn = sum(v[-1] for name, v in energy["components"].items() if name not in ("charged", "charger_loss"))
    assert drawn == pytest.approx(view.kpis(TICKS)["energy_j"])
    soc = view.soc(0, TICKS, 30, vehicles=[3, 1, 99])
    assert soc["vehicles"] == [3, 1]
    assert soc["soc"].shape == (2, 30)
    assert soc["soc"][:, 0].tolist() == [1.0, 1.0]
    through = view.throughput(0, TICKS, 600.0)
    assert through["open"][-1] == view.kpis(TICKS)["orders_open"]
    done = np.sort([o["done_s"] for o in view.orders(TICKS, 10_000) if o["done_s"] is not None])
    assert through["per_h"][-1] == pytest.approx((done > TICKS - 600).sum() * 6)
    assert view.heat("waiting", 0, TICKS).sum() > 0
    with pytest.raises(ValueError, match="known: occupancy"):
        view.heat("speed", 0, 1)


def test_thresholds_follow_the_operator() -> None:
    view, _ = views()
    assert (view.thresholds(699).good, view.thresholds(700).good) == (0.3, 0.4)


def test_before_the_first_flush_everybody_stands_at_the_start() -> None:
    _, scenario, world = made()
    log = MemoryLog()
    view = RunView(log, scenario, world)
    assert view.t_end == 0
    poses = view.poses(10)
    assert poses.place.tolist() == [int(world.chargers[i * 12 // 5]) for i in range(5)] or len(set(poses.place)) == 5
    assert [r["state"] for r in view.fleet(0)] == ["idle"] * 5
    for answer in (view.orders(0), view.events(0, 1), view.routes(0), view.bands(0, 1)):
        assert answer == []
    assert view.kpis(0)["orders_done"] == 0
    assert len(view.chargers(0)) == len(world.chargers)
    view.soc(0, 0), view.energy(0, 0), view.occupancy(0, 0, 5), view.throughput(0, 0), view.reservations(0, 1)
    synthetic.make_log(log, scenario, world, ticks=50)
    assert view.refresh()
    assert view.t_end == 50


def test_a_cut_log_is_read_anew(tmp_path: Path) -> None:
    base, scenario, world = made()
    with RunLogWriter(tmp_path / "r", {"tick_s": 1.0}) as writer:
        for name in TABLES:
            writer.write(name, base.table(name))
        rows = dict.fromkeys(TABLES, 0)
        view = RunView(LogReader(tmp_path / "r"), scenario, world)
        assert view.t_end == TICKS
        keep = int((base.table("motions")["t1"] <= 300).sum())
        writer.truncate_to({**rows, "motions": keep})
        view.refresh()
        assert view.t_end == 300
        assert np.array_equal(view.poses(250).x_m, views()[0].poses(250).x_m)


@pytest.mark.parametrize("time", [3.0, 61.5, 300.0, 545.0, 1299.0])
def test_power_is_the_ledgers_change_over_the_window(time: float) -> None:
    """Slow twin: the samples of the log, read one by one; charging counts against what is drawn."""
    view, _ = views()
    battery = made()[0].table("battery")
    for v, watts in enumerate(view.power(time).tolist()):
        rows = [i for i in range(len(battery["tick"])) if battery["vehicle"][i] == v and battery["tick"][i] <= time]
        last = rows[-1]
        first = max([i for i in rows if battery["tick"][i] <= time - 60], default=rows[0])
        seconds = int(battery["tick"][last] - battery["tick"][first])
        joules = sum(int(battery[name][last]) - int(battery[name][first]) for name in ENERGY_COLUMNS) / 1000
        assert (math.isnan(watts) and seconds == 0) or watts == pytest.approx(joules / seconds)


def test_held_is_what_nobody_else_has_or_reserved_for_earlier() -> None:
    """Slow twin: every pair of claims at one place is compared."""
    view, _ = views()
    waits = 0
    for time in range(3, TICKS, 29):
        routes, poses, now = view.routes(time), view.poses(time), view._now(time)
        claims = [(r["vehicle"], p, t) for r in routes for p, t in zip(r["places"], [-1, *r["t_in"][1:]], strict=True)]
        for v in set(range(view.n)) - {r["vehicle"] for r in routes}:
            claims += [(v, int(poses.place[v]), -1), (v, int(now.col["to_place"][v]), -1)]
        for route in routes:
            held = 0
            for place, tick in zip(route["places"], [-1, *route["t_in"][1:]], strict=True):
                mine = (tick, route["vehicle"])
                if any(w != mine[1] and p == place and (t, w) < mine for w, p, t in claims):
                    break
                held += 1
            assert route["held"] == held
            waits += held < len(route["places"])
    assert waits > 5, "somebody had to wait for somebody"


def test_held_is_what_the_claims_of_the_simulation_grant() -> None:
    scenario = engine.scenario.load("soochow2022-continuous")
    log = MemoryLog()
    sim = engine.build.build(scenario, recorder=log)
    seen = 0
    for _ in range(40):
        sim.advance(23)
        sim.flush()
        for route in RunView(log, scenario, sim.world).routes(float(sim.tick)):
            v, granted = route["vehicle"], 1
            steps = [int(s) for s in sim.steps.claim[v, int(sim.fleet.step[v]) : int(sim.fleet.steps[v])] if s >= 0]
            for slot in steps:
                before = int(sim.claims.prev[slot])
                while before >= 0 and int(sim.claims.owner[before]) in (NONE, v):
                    before = int(sim.claims.prev[before])
                if before >= 0:
                    break
                granted += 1
            assert route["held"] == granted, (sim.tick, v)
            seen += 1
    assert seen > 50
