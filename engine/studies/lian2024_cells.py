"""What one cell of the study of Lian et al. 2024 computes: a run, judged, and the numbers that the table needs of it.

A run is made without files: its log stays in memory, and what is kept of it are sums.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.build import beside_costs, build, costs_of
from engine.energy import tremblay as cells_of
from engine.results.arcs import Visits, busy_s, describe, normality, shares_that_pass, visits
from engine.results.beside import energy_beside
from engine.results.metrics import metrics
from engine.results.runlog import MemoryLog, latest_keyframe
from engine.results.schema import ENERGY_COLUMNS
from engine.scenario import Scenario, load
from engine.sim.judge import judge
from engine.sim.simulation import Simulation
from engine.studies.base import Cell
from engine.types import COMPONENTS, FOREVER, PRIMITIVE_0, Activity, Component, OrderState
from engine.units import MJ_PER_J
from engine.world import build_world

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

SCENARIO = "lian2024"
MARK_S = 300
"""Orders and energy are kept as they stand at every multiple of this."""
STUCK_S = 600.0
"""Who is under way and hasn't moved for so long waits for something that never comes."""
SAMPLES = 20
"""The paper's table 1 is of so many: its interval and its standard errors say so."""
HISTOGRAM = 400
DRIVE_S = 1500
"""Length of the drive over which the two states of charge are compared."""
POINTS = 240
"""Points of a curve that are kept."""
NOT_DRAWN = (Component.CHARGED, Component.CHARGER_LOSS)


def run_cell(cell: Cell) -> Cell:
    """One run of a method: {planner, objective, hours, seed, changes, keep, recost, from_h}.

    changes: dotted key → value over the scenario · keep: which parts beyond the sums: `arcs`, `times`, `drive`
    · recost: name → further changes, whose energy is worked out from the same motions, from hour from_h to the end.
    """
    changes = {"planner.name": cell["planner"], "planner.objective": cell["objective"], **cell["changes"]}
    scenario = load(SCENARIO, changes)
    log = MemoryLog(keyframe_ticks=FOREVER)
    sim = build(scenario, seed=cell["seed"], recorder=log)
    sim.advance(round(cell["hours"] * 3600 / sim.tick_s))
    sim.flush()
    out = {**_totals(sim, log), **_over_time(sim, log), **_driving(sim, log), **_verdict(sim, log)}
    if "arcs" in cell["keep"]:
        out |= _arcs(sim, log)
    if "times" in cell["keep"]:
        out |= _times(sim, log)
    if "drive" in cell["keep"]:
        out |= drive_on_battery(sim, log)
    if cell["recost"]:
        out["recosted_j"] = {name: recosted(sim, log, other, cell) for name, other in cell["recost"].items()}
    return out


def changed(changes: dict[str, Any]) -> Scenario:
    """The study's scenario with changes."""
    return load(SCENARIO, changes)


def _totals(sim: Simulation, log: MemoryLog) -> Cell:
    """Orders, planning, energy by component in J, and the same energy as the paper counts it."""
    found = metrics(log, sim.tick_s, beside_costs(sim.scenario, sim.world))
    kept = ("orders_done", "energy_j", "energy_by_component", "plans", "plans_failed", "plans_detoured", "stranded")
    kinds = log.table("events")["kind"]
    return {
        **{name: found[name] for name in kept},
        "kinetic_j": sum(found["energy_beside_by_component"].values()),
        "longest_unserved_s": found["longest_unserved_s"],
        "moving": found["activity_shares"]["moving"],
        "swaps": int((kinds == "battery changed").sum()),
    }


def _over_time(sim: Simulation, log: MemoryLog) -> Cell:
    """Orders delivered and J drawn until every mark, cumulative; the first entry is of the first mark."""
    marks = np.arange(MARK_S, sim.tick * sim.tick_s + 1, MARK_S)
    orders, battery = log.table("orders"), log.table("battery")
    done = np.sort(orders["tick"][orders["state"] == OrderState.DONE])
    ticks = np.rint(marks / sim.tick_s).astype(np.int64)
    energy: dict[str, list[float]] = {}
    for name, column in zip(COMPONENTS, ENERGY_COLUMNS, strict=True):
        if name not in {c.name.lower() for c in NOT_DRAWN} and battery[column].any():
            fleet = np.bincount(battery["tick"], weights=battery[column], minlength=int(ticks.max(initial=0)) + 1)
            energy[name] = (fleet[ticks] / MJ_PER_J).round(1).tolist()
    return {"orders_at": np.searchsorted(done, ticks, side="right").tolist(), "energy_at": energy}


def recosted(sim: Simulation, log: MemoryLog, changes: dict[str, Any], cell: Cell) -> float:
    """J that the run's motions take from hour from_h on with other numbers of vehicle and drive.

    Durations stay as they are, and batteries are swapped long before they are empty, so a run of such vehicles would
    differ only where a detour chooses by energy among equally quick ways.
    """
    other = changed({**cell["changes"], **changes})
    costs = costs_of(other, build_world(other))
    first = cell["from_h"] * 3600 / sim.tick_s
    return sum(energy_beside(log, costs, sim.n, sim.tick).values()) - sum(
        energy_beside(log, costs, sim.n, first).values()
    )


def _driving(sim: Simulation, log: MemoryLog) -> Cell:
    """Metres, quarter turns, starts, and vehicle seconds of waiting, of the whole fleet."""
    m, primitives = log.table("motions"), sim.graph.primitives
    drove = m["kind"] >= PRIMITIVE_0
    counts = np.bincount(m["kind"][drove].astype(np.int64) - PRIMITIVE_0, minlength=len(primitives))
    waits = m["kind"] == Activity.WAIT
    return {
        "metres": float(counts @ np.array([p.length_mm for p in primitives])) / 1000,
        "turns": float(counts @ np.array([p.turn_deg for p in primitives])) / 90,
        "starts": int(counts @ np.array([p.starts for p in primitives])),
        "waited_s": float((m["t1"][waits] - m["t0"][waits]).sum()) * sim.tick_s,
        "vehicle_s": float(sim.n * sim.tick) * sim.tick_s,
    }


def _verdict(sim: Simulation, log: MemoryLog) -> Cell:
    """What the judge says, deadlocks that were resolved, and vehicles that stood still for good when the run ended."""
    breaches = judge(log, sim.scenario, sim.world)
    m, frame = log.table("motions"), latest_keyframe(log)
    moved = np.zeros(sim.n, np.int64)
    some = (m["kind"] != Activity.WAIT) & (m["kind"] != Activity.REST)
    np.maximum.at(moved, m["vehicle"][some], m["t1"][some])
    waits = frame["vehicle"][(frame["kind"] == Activity.WAIT)].astype(np.int64)
    stuck = int((sim.tick - moved[waits] > STUCK_S / sim.tick_s).sum())
    return {"breaches": len(breaches), "deadlocks": sim.deadlocks, "stuck": stuck}


# -- arcs -------------------------------------------------------------------------------------------------------------


def _arcs(sim: Simulation, log: MemoryLog) -> Cell:
    """Seconds per hour that every lane was held, in the later part of the run; mean arc times by period, and how
    far the lanes' means of one period agree with the next (of those visited at least 20 times).

    The later part begins after an hour, or halfway through a shorter run.
    """
    world, first = sim.world, min(round(3600 / sim.tick_s), sim.tick // 2)
    hours = (sim.tick - first) * sim.tick_s / 3600
    busy = busy_s(log, world, sim.tick_s, first, sim.tick) / hours
    arcs = log.table("arcs")
    periods = np.unique(arcs["tick"])
    samples = arcs["samples"].astype(np.int64)

    def mean_of(column: str) -> list[float]:
        sums = [float(arcs[column][at].astype(np.float64) @ samples[at]) for at in (arcs["tick"] == t for t in periods)]
        counts = [int(samples[arcs["tick"] == t].sum()) for t in periods]
        return [round(total / max(1, n), 1) for total, n in zip(sums, counts, strict=True)]

    lanes = np.flatnonzero(sim.graph.arc_ticks > 0)
    by_lane = np.full((len(periods), sim.graph.n_places), np.nan)
    often = samples >= SAMPLES
    by_lane[np.searchsorted(periods, arcs["tick"][often]), arcs["place"][often]] = arcs["mean_ms"][often]
    same = [_correlation(a, b) for a, b in pairwise(by_lane)]
    return {
        "persistence": float(np.mean(same)) if same else None,
        "busy_s": dict(zip([world.label(int(p)) for p in lanes], busy[lanes].round(1).tolist(), strict=True)),
        "period_s": (periods * sim.tick_s).tolist(),
        "took_ms": mean_of("mean_ms"),
        "expected_ms": mean_of("expected_ms"),
    }


def _correlation(a: F64, b: F64) -> float:
    """Pearson's, of the entries that both have."""
    both = ~np.isnan(a) & ~np.isnan(b)
    return float(np.corrcoef(a[both], b[both])[0, 1])


def _times(sim: Simulation, log: MemoryLog) -> Cell:
    """The paper's tables 1 and 2 for the lane that was visited most, and how many lanes pass.

    Twice: with the first 20 visits after half an hour (or half of a shorter run), and, where a run is long enough to
    have 20 of them, with means of half hours, which are what the routes are planned with.
    """
    first = min(round(1800 / sim.tick_s), sim.tick // 2)
    single = visits(log, sim.world, sim.tick_s, first)
    arcs = log.table("arcs")
    place, tick, ms = (arcs[c][arcs["samples"] > 0] for c in ("place", "tick", "mean_ms"))
    means = Visits(place.astype(np.int64), tick.astype(np.int64), ms.astype(np.float64))
    most = int(np.bincount(single.place, minlength=1).argmax())
    out: Cell = {"lane": sim.world.label(most), "lane_ms": single.of(most)[:HISTOGRAM].tolist(), "tests": {}}
    for name, found in (("visits", single), ("half hours", means)):
        some = found.of(most)[:SAMPLES]
        if len(some) == SAMPLES:
            table = {**describe(some), **normality(some)}
            out["tests"][name] = {"lane": table, "all": dict(shares_that_pass(found, least=SAMPLES, most=SAMPLES))}
    return out


# -- battery ----------------------------------------------------------------------------------------------------------


def drive_on_battery(sim: Simulation, log: MemoryLog) -> Cell:
    """The first vehicle's power at every second on one cell of its pack, full at the start: state of charge two ways.

    Energy of a motion is spread evenly over it.
    """
    m = log.table("motions")
    mine = m["vehicle"] == 0
    t0, t1, mj = (m[name][mine].astype(np.float64) for name in ("t0", "t1", "energy_mj"))
    edges = np.concatenate([t0, t1[-1:]]) * sim.tick_s
    drawn = np.concatenate([[0.0], np.cumsum(mj)]) / MJ_PER_J
    seconds = np.arange(0.0, min(DRIVE_S, float(edges[-1])) + 1)
    standby_w = float(sim.parts.costs.standby_mj[0]) / MJ_PER_J / sim.tick_s
    power = np.diff(np.interp(seconds, edges, drawn)) + standby_w
    asked = sim.scenario.battery
    one = cells_of.cell(**asked.parameters)
    pack = cells_of.pack(one, asked.capacity_wh, asked.voltage_v)
    run = cells_of.discharge_power(one, power, 1.0, pack.cells, pack.strings)
    error = run.error[run.stable]
    minutes = len(power) // 60
    volts, amperes, counted = (
        each[: 60 * minutes].reshape(minutes, 60).mean(axis=1)
        for each in (run.voltage_v, run.current_a, run.counted_soc)
    )
    calm, inside = cells_of.soc_of_voltage(one, volts, amperes)
    kept = np.unique(np.linspace(0, len(power) - 1, POINTS).astype(int))
    return {
        "drive": {
            "min": (run.t_s[kept] / 60).round(3).tolist(),
            "volts": run.voltage_v[kept].round(4).tolist(),
            "counted": (100 * run.counted_soc[kept]).round(3).tolist(),
            "label": (100 * run.counted_rated_soc[kept]).round(3).tolist(),
            "read": (100 * run.read_soc[kept]).round(3).tolist(),
            "stable": run.stable[kept].tolist(),
        },
        "drive_rms": _rms(100 * error),
        "drive_worst": float(np.abs(error).max(initial=0.0) * 100),
        "minute_rms": _rms(100 * (calm - counted)[inside]),
        "drive_w": float(power.mean()),
        "drive_a": float(run.current_a.mean()),
    }


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
