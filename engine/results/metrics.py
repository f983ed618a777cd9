"""What a run amounts to, computed from its log alone: throughput, order times, use of the fleet, energy, planning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.results.beside import energy_beside
from engine.results.runlog import Log, latest_keyframe
from engine.results.schema import ENERGY_COLUMNS
from engine.results.timeline import overlap_sums
from engine.results.view import ACTIVITIES, CAUSE_WORDS, GROUP
from engine.traffic import DETOUR
from engine.types import COMPONENTS, FOREVER, NONE, PRIMITIVE_0, Activity, Component, OrderState, PlanStatus

SLICES = 48
"""Number of equal slices in which occupancy over time is given."""
_NOT_FOUND = tuple(
    str(s) for s in (PlanStatus.NO_PATH, PlanStatus.BUDGET_SPENT, PlanStatus.INCONSISTENT, PlanStatus.CHARGE)
)
_NOT_DRAWN = (Component.CHARGED, Component.CHARGER_LOSS)


def metrics(reader: Log, tick_s: float | None = None, beside: CostTable | None = None) -> dict[str, Any]:
    """Numbers of a run as plain JSON values; None where there is nothing to divide by.

    tick_s: seconds per tick; left out, the log's manifest says. Times in s, energy in J, shares in [0, 1], throughput
    in orders per hour. `occupancy_by_place` is the share of the run during which each place was held, by place.
    beside: costs of a second demand model, whose energy is added as information.
    """
    if tick_s is None:
        tick_s = float(reader.manifest.get("tick_s", 1.0))
    spans = _intervals(reader)
    first, end = float(reader.first_tick), float(spans["end"])
    hours = max(end - first, 0.0) * tick_s / 3600.0
    orders = _orders(reader, end, tick_s)
    energy = _energy(reader)
    done = orders["orders_done_here"]
    drawn = sum(j for name, j in energy.items() if name not in {c.name.lower() for c in _NOT_DRAWN})
    return {
        "sim_s": end * tick_s,
        "from_s": first * tick_s,
        **{k: v for k, v in orders.items() if k != "orders_done_here"},
        "throughput_per_h": done / hours if hours > 0 else None,
        **_activity(spans, first, end, tick_s),
        **_places(spans, first, end),
        "energy_j": drawn,
        "energy_by_component": energy,
        "energy_per_order_j": drawn / orders["orders_done"] if orders["orders_done"] else None,
        **_battery(reader),
        **_planning(reader),
        **(
            {} if beside is None else {"energy_beside_by_component": energy_beside(reader, beside, spans["fleet"], end)}
        ),
    }


def _intervals(reader: Log) -> dict[str, Any]:
    """Every interval, the open ones until the end of the log."""
    m, frame = reader.table("motions"), latest_keyframe(reader)
    end = int(m["t1"].max()) if len(m["t1"]) else 0
    if len(frame["tick"]):
        end = max(end, int(frame["tick"][-1]))
    fleet = int(max(m["vehicle"].max(initial=-1), frame["vehicle"].max(initial=-1))) + 1
    ended = np.zeros(fleet, np.int64)
    np.maximum.at(ended, m["vehicle"], m["t1"])
    fresh = (frame["t0"] >= ended[frame["vehicle"]]) & (frame["t0"] < end)
    out: dict[str, Any] = {"end": end, "fleet": fleet}
    for name in ("vehicle", "kind", "cause", "t0", "t1", "from_place", "to_place", "loaded"):
        more = np.full(len(fresh), end) if name == "t1" else frame[name]
        out[name] = np.concatenate([m[name], more[fresh]]).astype(np.int64)
    return out


def _activity(spans: dict[str, Any], first: float, end: float, tick_s: float) -> dict[str, Any]:
    """Shares of the fleet's time, waiting by cause, and the empty share of driving."""
    kind = spans["kind"]
    ticks = np.minimum(spans["t1"], end) - np.maximum(spans["t0"], first)
    by_group = np.bincount(GROUP[kind], weights=ticks, minlength=len(ACTIVITIES))
    total = float(by_group.sum())
    shares = dict(zip(ACTIVITIES, (by_group / total if total else by_group).tolist(), strict=True))
    waits = kind == Activity.WAIT
    by_cause = np.bincount(spans["cause"][waits], weights=ticks[waits], minlength=len(CAUSE_WORDS)) * tick_s
    drives = kind >= PRIMITIVE_0
    driven = float(ticks[drives].sum())
    edges = np.linspace(first, max(end, first + 1e-9), SLICES + 1)
    slices = overlap_sums(edges, spans["t0"], spans["t1"], GROUP[kind], len(ACTIVITIES))
    slices = slices / np.maximum(slices.sum(1, keepdims=True), 1e-12)
    return {
        "utilisation": shares["moving"] + shares["waiting"] + shares["loading"] if total else None,
        "activity_shares": shares,
        "empty_share": float(ticks[drives & (spans["loaded"] == 0)].sum()) / driven if driven else None,
        "waiting_s_by_cause": {CAUSE_WORDS[i]: float(s) for i, s in enumerate(by_cause) if s > 0},
        "occupancy_over_time": {
            "t_s": (edges[1:] * tick_s).tolist(),
            **{name: slices[:, i].tolist() for i, name in enumerate(ACTIVITIES)},
        },
    }


def _places(spans: dict[str, Any], first: float, end: float) -> dict[str, Any]:
    """Share of the run during which each place was held."""
    a, b = spans["from_place"], spans["to_place"]
    ticks = np.minimum(spans["t1"], end) - np.maximum(spans["t0"], first)
    n = int(max(a.max(initial=-1), b.max(initial=-1))) + 1
    moved = a != b
    held = np.bincount(b, weights=ticks, minlength=n) + np.bincount(a[moved], weights=ticks[moved], minlength=n)
    return {"occupancy_by_place": np.round(held / max(end - first, 1.0), 6).tolist()}


def _orders(reader: Log, end: float, tick_s: float) -> dict[str, Any]:
    """Counts, times from creation to delivery, and the age of the oldest order not yet picked up."""
    o = reader.table("orders")
    state, number, tick = o["state"].astype(np.int64), o["order"].astype(np.int64), o["tick"].astype(np.int64)
    n = int(number.max(initial=-1)) + 1
    last = np.full(n, NONE, np.int64)
    last[number] = state
    created, ended = np.full(n, FOREVER, np.int64), np.full(n, FOREVER, np.int64)
    opened = np.nonzero(state == OrderState.OPEN)[0]
    np.minimum.at(created, number[opened], tick[opened])
    closed = np.nonzero((state == OrderState.DONE) | (state == OrderState.WITHDRAWN))[0]
    ended[number[closed]] = tick[closed]
    picked = np.full(n, FOREVER, np.int64)
    taken = np.nonzero(state == OrderState.PICKED)[0]
    picked[number[taken]] = tick[taken]
    done = last == OrderState.DONE
    took = (ended - created)[done] * tick_s
    unserved = (last >= 0) & (last < OrderState.PICKED)
    until = np.minimum(np.minimum(picked, ended), end)[last >= 0]
    return {
        "orders_created": int((last >= 0).sum()),
        "orders_done": int(done.sum()),
        "orders_withdrawn": int((last == OrderState.WITHDRAWN).sum()),
        "orders_open": int(((last >= 0) & (ended == FOREVER)).sum()),
        "orders_done_here": int((done & (ended > reader.first_tick)).sum()),
        "order_time_mean_s": float(took.mean()) if len(took) else None,
        "order_time_p95_s": float(np.percentile(took, 95)) if len(took) else None,
        "oldest_unserved_s": float((end - created[unserved]).max()) * tick_s if unserved.any() else 0.0,
        "longest_unserved_s": float((until - created[last >= 0]).max()) * tick_s if (last >= 0).any() else 0.0,
    }


def _energy(reader: Log) -> dict[str, float]:
    """Energy of the whole fleet by component in J, of every vehicle's last sample; zeros left out."""
    b = reader.table("battery")
    latest = _last_rows(b["vehicle"])
    sums = {name: int(b[column][latest].sum()) for name, column in zip(COMPONENTS, ENERGY_COLUMNS, strict=True)}
    return {name: mj / 1000.0 for name, mj in sums.items() if mj}


def _battery(reader: Log) -> dict[str, Any]:
    b = reader.table("battery")
    return {"stranded": int((b["charge_mc"][_last_rows(b["vehicle"])] <= 0).sum())}


def _last_rows(vehicle: NDArray[Any]) -> NDArray[np.int64]:
    """The last row of every vehicle."""
    last = np.full(int(vehicle.max(initial=-1)) + 1, -1, np.int64)
    last[vehicle] = np.arange(len(vehicle))
    return last[last >= 0]


def _planning(reader: Log) -> dict[str, Any]:
    """CPU time of the planner per plan; the wall clock's only trace in a log, and outside the digest."""
    plans = reader.table("plans")
    cpu = plans["cpu_us"]
    status = plans["status"].astype(str)
    return {
        "plans": len(cpu),
        "plans_failed": int(np.isin(status, _NOT_FOUND).sum()),
        "plans_detoured": int((status == DETOUR).sum()),
        "planner_p50_ms": float(np.percentile(cpu, 50)) / 1000.0 if len(cpu) else None,
        "planner_p95_ms": float(np.percentile(cpu, 95)) / 1000.0 if len(cpu) else None,
    }
