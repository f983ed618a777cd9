"""Where two runs part, against a scan of every vehicle at every tick; and what a run has come to, at any time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.results import divergence
from engine.results.divergence import Divergence, first_divergence
from engine.results.runlog import MemoryLog
from engine.results.view import RunView
from engine.scenario import Scenario, parse
from engine.types import PRIMITIVE_0, Activity
from engine.world.floor import World, build_world
from tests import synthetic
from tests.naive_view import NaiveView, rows_of

TICKS = 240
VEHICLES = 4


def setting(seed: int = 1) -> tuple[Scenario, World]:
    scenario = parse(synthetic.scenario_toml(vehicles=VEHICLES, ticks=TICKS, seed=seed))
    return scenario, build_world(scenario)


def log_of(commands: Any = (), *, seed: int = 1, ticks: int = TICKS, flush_every: int = 100) -> MemoryLog:
    log = MemoryLog()
    synthetic.make_log(log, *setting(seed), ticks=ticks, commands=commands, flush_every=flush_every)
    return log


def changed(log: MemoryLog, change: Any) -> MemoryLog:
    """A log whose motions are what `change` makes of them."""
    out = MemoryLog()
    for table in ("motions", "keyframes"):
        rows = rows_of(log, table)
        rows = change(rows) if table == "motions" else rows
        out.write(table, {name: [row[name] for row in rows] for name in rows[0]})
    return out


def slow(one: MemoryLog, other: MemoryLog) -> Divergence | None:
    """The first tick at which some vehicle does not do the same, asked of every vehicle at every tick."""
    views = [NaiveView(log, *setting()) for log in (one, other)]

    def doing(view: NaiveView, vehicle: int, tick: int) -> tuple[int, ...]:
        m = view.interval(vehicle, tick)
        does = tuple(m[name] for name in ("kind", "from_place", "to_place", "from_heading", "to_heading", "loaded"))
        return (*does, m["t0"], m.get("foreseen", m["t1"])) if m["kind"] >= PRIMITIVE_0 else does

    for tick in range(min(max(o["tick"] for o in view.open) for view in views)):
        differ = tuple(v for v in range(VEHICLES) if doing(views[0], v, tick) != doing(views[1], v, tick))
        if differ:
            return Divergence(tick, differ)
    return None


given_commands = st.lists(
    st.tuples(
        st.integers(5, TICKS - 5),
        st.one_of(
            st.builds(lambda v: {"do": "pause", "vehicle": v}, st.integers(0, VEHICLES - 1)),
            st.builds(lambda v: {"do": "fail", "vehicle": v}, st.integers(0, VEHICLES - 1)),
            st.just({"do": "order", "from": 1, "to": 8}),
        ),
    ),
    max_size=3,
).map(lambda commands: tuple(sorted(commands, key=lambda command: command[0])))


@settings(max_examples=25, deadline=None)
@given(mine=given_commands, yours=given_commands, seed=st.sampled_from([1, 1, 1, 2]))
def test_the_first_divergence_is_that_of_a_scan_of_every_tick(mine: Any, yours: Any, seed: int) -> None:
    one, other = log_of(mine), log_of(yours, seed=seed)
    found = first_divergence(one, other)
    assert found == slow(one, other) == first_divergence(other, one)
    if mine == yours and seed == 1:
        assert found is None


@pytest.mark.parametrize("window", [1, 7, 60, TICKS])
def test_it_does_not_depend_on_how_far_is_compared_at_once(window: int, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = log_of(), log_of(((150, {"do": "pause", "vehicle": 1}),))
    expected = slow(one, other)
    assert expected is not None
    monkeypatch.setattr(divergence, "FIRST_WINDOW", window)
    assert first_divergence(one, other) == expected
    assert first_divergence(one, one) is None


def test_how_often_a_log_was_flushed_and_how_a_stay_is_told_make_no_difference() -> None:
    def cut_stays(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        out = []
        for row in rows:
            middle = (row["t0"] + row["t1"]) // 2
            if row["kind"] < PRIMITIVE_0 and row["t0"] < middle:
                out += [{**row, "t1": middle}, {**row, "t0": middle, "cause": 1}]
            else:
                out.append(row)
        return out

    log = log_of()
    assert first_divergence(log, log_of(flush_every=17)) is None
    cut = changed(log, cut_stays)
    assert len(cut.table("motions")["t0"]) > len(log.table("motions")["t0"])
    assert first_divergence(log, cut) is None


def test_a_motion_that_takes_another_time_differs_from_its_first_tick() -> None:
    log = log_of()
    drives = [k for k, row in enumerate(rows_of(log, "motions")) if row["kind"] >= PRIMITIVE_0]
    at = drives[len(drives) // 2]
    row = rows_of(log, "motions")[at]
    longer = changed(log, lambda rows: [{**r, "t1": r["t1"] + (k == at)} for k, r in enumerate(rows)])
    assert first_divergence(log, longer) == Divergence(row["t0"], (row["vehicle"],))


def test_runs_are_compared_as_far_as_both_go() -> None:
    command = ((180, {"do": "fail", "vehicle": 2}),)
    whole, other = log_of(), log_of(command)
    found = first_divergence(whole, other)
    assert found is not None
    assert 180 <= found.tick < TICKS
    assert first_divergence(log_of(ticks=100), whole) is None
    assert first_divergence(log_of(ticks=150), log_of(command)) is None
    empty = MemoryLog()
    assert first_divergence(empty, whole) is None


def test_what_a_run_has_come_to_is_what_its_fleet_and_its_orders_say() -> None:
    scenario, world = setting()
    log = log_of(((60, {"do": "pause", "vehicle": 1}),))
    view, naive = RunView(log, scenario, world), NaiveView(log, scenario, world)
    times = [0.0, 1.0, 37.5, 100.0, 199.0, float(view.t_end)]
    told = view.progress(times)
    for k, time in enumerate(times):
        kpis = view.kpis(time)
        assert told["orders_done"][k] == kpis["orders_done"]
        assert told["energy_j"][k] == pytest.approx(kpis["energy_j"])
        assert told["waiting_s"][k] == pytest.approx(sum(naive.waiting_s(v, time) for v in range(VEHICLES)))
    curve = view.progress(np.arange(view.t_end + 1))
    for values in curve.values():
        assert (np.diff(values) >= 0).all()
    assert not any(values.any() for values in view.progress([0.0]).values())
    waits = [row for row in rows_of(log, "motions") if row["kind"] in (Activity.WAIT, Activity.PAUSE)]
    assert waits, "the run should wait somewhere"
