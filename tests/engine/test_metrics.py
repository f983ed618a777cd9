"""Metrics against slow counts over the same log."""

import json
from pathlib import Path

import numpy as np
import pytest

from engine.results.metrics import metrics
from engine.results.runlog import LogReader, MemoryLog
from engine.results.schema import LIST, TABLES
from engine.scenario import parse
from engine.traffic import DETOUR
from engine.types import PRIMITIVE_0, Activity, OrderState, PlanStatus
from engine.world.floor import build_world
from tests import synthetic
from tests.naive_view import NaiveView

TICKS = 1000


@pytest.fixture(scope="module")
def counted() -> tuple[dict, NaiveView]:
    scenario = parse(synthetic.scenario_toml(ticks=TICKS, tick_s=0.5))
    log = MemoryLog()
    log.manifest["tick_s"] = 0.5
    synthetic.make_log(log, scenario, build_world(scenario), ticks=TICKS, commands=synthetic.COMMANDS)
    return metrics(log), NaiveView(log, scenario, build_world(scenario))


def test_orders_are_counted(counted: tuple[dict, NaiveView]) -> None:
    found, naive = counted
    orders = naive.orders(TICKS)
    ends = {r["order"]: r["tick"] for r in naive.orders_rows if r["state"] == OrderState.DONE}
    took = sorted((ends[n] - orders[n][2]) * 0.5 for n in ends)
    assert found["orders_created"] == len(orders)
    assert found["orders_done"] == len(ends)
    assert found["orders_withdrawn"] == sum(s == "withdrawn" for s, _, _ in orders.values())
    assert found["orders_created"] == found["orders_done"] + found["orders_withdrawn"] + found["orders_open"]
    assert found["order_time_mean_s"] == pytest.approx(sum(took) / len(took))
    assert took[0] <= found["order_time_mean_s"] <= found["order_time_p95_s"] <= took[-1]
    assert found["throughput_per_h"] == pytest.approx(len(ends) / (TICKS * 0.5 / 3600))
    unserved = [TICKS - t for s, _, t in orders.values() if s in ("open", "assigned")]
    assert found["oldest_unserved_s"] == max(unserved, default=0) * 0.5
    assert found["longest_unserved_s"] >= found["oldest_unserved_s"]


def test_time_is_divided(counted: tuple[dict, NaiveView]) -> None:
    found, naive = counted
    shares = naive.shares(0, TICKS)
    assert found["activity_shares"] == pytest.approx(shares)
    assert found["utilisation"] == pytest.approx(shares["moving"] + shares["waiting"] + shares["loading"])
    waits = [m for m in naive.intervals if m["kind"] == Activity.WAIT]
    total = sum(min(m["t1"], TICKS) - m["t0"] for m in waits) * 0.5
    assert sum(found["waiting_s_by_cause"].values()) == pytest.approx(total)
    assert found["waiting_s_by_cause"]["vehicle"] > 0
    drives = [m for m in naive.intervals if m["kind"] >= PRIMITIVE_0]
    empty = sum(m["t1"] - m["t0"] for m in drives if not m["loaded"]) / sum(m["t1"] - m["t0"] for m in drives)
    assert found["empty_share"] == pytest.approx(empty, abs=0.01)
    assert len(found["occupancy_over_time"]["t_s"]) == len(found["occupancy_over_time"]["idle"]) == 48
    assert found["occupancy_by_place"][16] == pytest.approx(naive.held(16, 0, TICKS), abs=1e-5)


def test_energy_is_the_last_ledger(counted: tuple[dict, NaiveView]) -> None:
    found, naive = counted
    last = [naive.last(naive.battery, v, TICKS) for v in range(naive.n)]
    total = sum(row["rolling_mj"] for row in last if row) / 1000
    assert found["energy_by_component"]["rolling"] == pytest.approx(total)
    drawn = {k: v for k, v in found["energy_by_component"].items() if k not in ("charged", "charger_loss")}
    assert found["energy_j"] == pytest.approx(sum(drawn.values()))
    assert found["energy_per_order_j"] == pytest.approx(found["energy_j"] / found["orders_done"])
    assert found["stranded"] == 0
    assert found["planner_p50_ms"] <= found["planner_p95_ms"]


def test_a_plan_that_goes_another_way_is_no_failed_plan() -> None:
    log = MemoryLog()
    given = [str(PlanStatus.SOLVED), DETOUR, DETOUR, str(PlanStatus.NO_PATH), str(PlanStatus.CHARGE)]
    empty = {name: [[]] * 5 if kind is LIST else np.zeros(5, int) for name, kind in TABLES["plans"].items()}
    log.write("plans", {**empty, "status": given})
    found = metrics(log)
    assert (found["plans"], found["plans_detoured"], found["plans_failed"]) == (5, 2, 2)


def test_metrics_are_plain_json_also_of_an_empty_log() -> None:
    empty = metrics(MemoryLog())
    assert json.loads(json.dumps(empty)) == empty
    assert empty["throughput_per_h"] is None
    assert empty["orders_done"] == 0


def test_metrics_of_a_run_on_disk_and_in_memory_agree(tmp_path: Path) -> None:
    run_id = synthetic.make_run(tmp_path, ticks=300)
    scenario = parse(synthetic.scenario_toml(ticks=300))
    log = MemoryLog(keyframe_ticks=120)
    synthetic.make_log(log, scenario, build_world(scenario), ticks=300, commands=synthetic.COMMANDS)
    on_disk = metrics(LogReader(tmp_path / run_id))
    assert on_disk == metrics(log)
    assert json.loads(json.dumps(on_disk)) == on_disk
