"""Figures of the study of Lian et al. 2024."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.energy import tremblay as cells_of
from engine.studies.base import Cell, Figure, mean_interval
from engine.studies.lian2024_table import (
    BASE,
    EER_GAIN,
    METHODS,
    OWN,
    PAPERS,
    PRINTED_N,
    STATISTICS,
    TABLE_3,
    TABLES_1_2,
    TURNS,
    Extent,
    Measure,
    Runs,
    after_learning,
    busiest,
    eer_of,
    gains,
    hours_words,
    kwh_of,
    orders_of,
    paper_arcs,
    steady,
    tornado,
)

MAIN = (*PAPERS, "prioritized")
CURVE = 160
"""Points of a drawn curve."""


def figures_of(of: Runs, x: Extent) -> list[Figure]:
    """All of them, in the order of the experiments."""
    return [
        _bars(of, "figure-5", f"Figure 5: orders done in {hours_words(x.hours)}", "orders", orders_of),
        *_how(of),
        *_learning(of),
        _table_3(of),
        *_energy(of, x),
        *_distribution(of),
        *_fleets(of, x),
        _tornado(of, x),
        *_battery(of),
    ]


def _mean(values: Sequence[float], digits: int = 2) -> float | None:
    mean = mean_interval(values)[0]
    return None if np.isnan(mean) else round(mean, digits)


def _series(name: str, xs: Sequence[Any], values: Sequence[Sequence[float]], digits: int = 3) -> dict[str, Any]:
    """A series of means with their intervals."""
    pairs = [mean_interval(v) for v in values]
    halves = [None if half is None else round(half, digits) for _, half in pairs]
    return {"name": name, "x": list(xs), "y": [round(mean, digits) for mean, _ in pairs], "half": halves}


def _bars(of: Runs, name: str, title: str, y_title: str, measure: Measure) -> Figure:
    series = [_series(method, [method], [[measure(r) for r in of[1, BASE, method]]]) for method in MAIN]
    note = "Means over the seeds with 95 % intervals. `prioritized` isn't the paper's: it is what one would take today."
    return Figure(name, title, "bars", {"series": series, "y_title": y_title, "note": note})


def _how(of: Runs) -> list[Figure]:
    """How each method drove in the main runs, and that nothing went wrong in any."""
    drove, wrong = [], []
    for method in METHODS:
        main, every = of.get((1, BASE, method), []), [r for (_, _, m), runs in of.items() if m == method for r in runs]
        if not main:
            continue
        per_order = [
            _mean([r[key] / max(1, r["orders_done"]) for r in main])
            for key in ("metres", "turns", "starts", "waited_s")
        ]
        shares = [
            _mean([100 * r[key] / max(1, r["plans"]) for r in main]) for key in ("plans_detoured", "plans_failed")
        ]
        drove.append([method, *per_order, *shares])
        sums = [sum(r[key] for r in every) for key in ("plans", "breaches", "deadlocks", "stuck", "stranded")]
        wrong.append([method, len(every), *sums])
    note = (
        "Per order, of the runs with 29 AGVs. Detoured: the timer couldn't time the route, and a search among the "
        "reservations took over. Yielded: no way was found, so the AGV stayed and asked again."
    )
    columns = ["method", "m", "quarter turns", "starts", "waiting, s", "detoured, %", "yielded, %"]
    all_runs = (
        "Of every run of the study, other fleets and assumptions included. The judge sees each; unresolved: AGVs "
        "that had not moved for ten minutes when a run ended; stranded: with an empty battery."
    )
    counts = ["method", "runs", "plans", "breaches", "deadlocks resolved", "unresolved", "stranded"]
    return [
        Figure("how", "How each method drove", "table", {"columns": columns, "rows": drove, "note": note}),
        Figure("wrong", "What went wrong", "table", {"columns": counts, "rows": wrong, "note": all_runs}),
    ]


def _learning(of: Runs) -> list[Figure]:
    """Orders and arc times by half hour."""
    orders, times = [], []
    for method in MAIN:
        runs = of[1, BASE, method]
        hours = [s / 3600 for s in runs[0]["period_s"]]
        done = [[orders_of(r, h - 0.5, h) for r in runs] for h in hours]
        orders.append(_series(method, hours, done, 1))
        times.append(_series(method, hours, [[r["took_ms"][k] for r in runs] for k in range(len(hours))], 1))
    own = of[1, BASE, OWN]
    expected = [[r["expected_ms"][k] for r in own] for k in range(len(own[0]["period_s"]))]
    times.append({**_series("expected by stochastic", times[0]["x"], expected, 1), "style": "dot"})
    note = "The first half hour is driven with the arcs' own 900 ms; from its end on every half hour is learned from."
    return [
        Figure(
            "learning", "Learning: orders done in each half hour", "lines",
            {"series": orders, "x_title": "hours", "y_title": "orders in half an hour", "note": note},
        ),
        Figure(
            "arc-times", "Learning: what an arc took, and what was expected of it", "lines",
            {"series": times, "x_title": "hours", "y_title": "mean time of an arc, ms",
             "note": "An arc's own time is 900 ms; the rest is waiting. Means over all visits."},
        ),
    ]  # fmt: skip


def _table_3(of: Runs) -> Figure:
    rows = []
    for k, (lane, printed) in enumerate(zip(busiest(of), paper_arcs(), strict=True)):
        ours = [_mean([r["busy_s"][lane] for r in of[1, BASE, method]], 0) for method in MAIN]
        rows.append([k + 1, lane, *ours, f"arc {printed + 1}", *[round(TABLE_3[m][printed]) for m in PAPERS]])
    columns = ["", "lane", *MAIN, "the paper's", *[f"{method}, printed" for method in PAPERS]]
    note = (
        "Seconds per hour. The five lanes that the paper's three methods together hold longest, the same for all, "
        "beside the paper's five in the order of theirs; which arcs those are isn't printed."
    )
    return Figure(
        "table-3", "Table 3: the five busiest arcs", "table", {"columns": columns, "rows": rows, "note": note}
    )


def _energy(of: Runs, x: Extent) -> list[Figure]:
    """Figure 6, by component and as orders per energy."""
    short = min(x.energy_hours, x.hours)
    names = ("copper", "rolling", "starting", "turning", "standby")
    series = []
    for method in MAIN:
        runs = of[1, BASE, method]
        last = round(short * 3600 / 300) - 1
        each = [[r["energy_at"].get(name, [0.0] * (last + 1))[last] / 3.6e6 for r in runs] for name in names]
        total = [kwh_of(r, 0, short) for r in runs]
        series.append(_series(method, [*names, "total"], [*each, total]))
    return [
        Figure(
            "figure-6", f"Figure 6: energy in {hours_words(short)}", "bars",
            {"series": series, "y_title": "kWh", "note": "At the battery terminals, of all 29 AGVs. Copper: heat in "
             "the motors. Standby: sensors and controllers, 20 W each."},
        ),
        _bars(of, "eer", f"Orders per kWh in {hours_words(x.hours)}", "orders per kWh", eer_of),
    ]  # fmt: skip


def _distribution(of: Runs) -> list[Figure]:
    """Tables 1 and 2 of one lane, and its times."""
    run = of[1, BASE, OWN][0]
    kinds = [kind for kind in ("visits", "half hours") if kind in run["tests"]]
    rows = []
    for key, word in STATISTICS.items():
        printed = {"n": PRINTED_N, **TABLES_1_2}.get(key)
        rows.append([word, "–" if printed is None else printed, *[_round(run["tests"][k]["lane"][key]) for k in kinds]])
    words = {"visits": "20 visits", "half hours": "20 means of half hours"}
    note = (
        f"The {run['lane']}, visited most, in the first run. Where no number of the paper stands, it is lost. Its "
        "table 2 says 50 degrees of freedom, which go with none of its other numbers; 20 go with all. Lilliefors' p of "
        "0.2 is the lower bound that SPSS prints."
    )
    columns = ["statistic", "the paper", *[words[kind] for kind in kinds]]
    times = {
        "series": [{"name": run["lane"], "values": run["lane_ms"]}], "x_title": "time of a visit, ms",
        "note": "An arc takes at least its own 900 ms, which most visits do, and queues have a long tail.",
    }  # fmt: skip
    return [
        Figure("tables-1-2", "Tables 1 and 2: one lane", "table", {"columns": columns, "rows": rows, "note": note}),
        Figure("arc-histogram", "What the visits of that lane took", "histogram", times),
    ]


def _round(value: float) -> float:
    return float(f"{value:.4g}")


def _fleets(of: Runs, x: Extent) -> list[Figure]:
    """Throughput and gain over the size of the fleet."""
    first, sizes = after_learning(x), sorted(x.fleets)
    per_h = x.side_hours - first
    orders = [
        _series(m, sizes, [[orders_of(r, first) / per_h for r in of[5, str(n), m]] for n in sizes], 1) for m in PAPERS
    ]
    gained = []
    for what, measure in (("orders", orders_of), ("orders per energy", eer_of)):
        for base in (TURNS, "astar-distance"):
            values = [
                gains(of[5, str(n), OWN], of[5, str(n), base], lambda r, m=measure: m(r, first))  # type: ignore[misc]
                for n in sizes
            ]
            gained.append(_series(f"{what}, over {base}", sizes, values))
    note = f"From hour {first:g} to {x.side_hours:g}, so that something was learned."
    return [
        Figure("fleets", "Fleet size: orders per hour", "lines",
               {"series": orders, "x_title": "AGVs", "y_title": "orders per hour", "note": note}),
        Figure("fleet-gain", "Fleet size: what learned times gain", "lines",
               {"series": gained, "x_title": "AGVs", "y_title": "stochastic is better by, %", "note": note}),
    ]  # fmt: skip


def _tornado(of: Runs, x: Extent) -> Figure:
    """Bars from the gain as assumed to the gain with each assumption changed, what moves it most first."""
    (_, _, base), *changed = tornado(of, x)
    start = mean_interval(base)[0]
    moved: dict[str, list[dict[str, Any]]] = {}
    for factor, value, values in changed:
        end = mean_interval(values)[0]
        bar = {"row": f"{factor.name} → {value}", "begin": round(start, 3), "end": round(end, 3),
               "name": "more" if end >= start else "less"}  # fmt: skip
        moved.setdefault(factor.name, []).append(bar)
    widest = sorted(moved.values(), key=lambda two: -max(abs(bar["end"] - bar["begin"]) for bar in two))
    note = (
        f"Bars begin at the gain as assumed, {start:+.2f} %; the paper prints {EER_GAIN:+g} %. Their ends are as "
        "uncertain as the intervals in the table say."
    )
    title = "What the gain in orders per energy over astar-turns owes to assumptions"
    bars = [bar for two in widest for bar in two]
    return Figure("tornado", title, "gantt", {"bars": bars, "x_title": "gain, %", "note": note})


def _battery(of: Runs) -> list[Figure]:
    """Figure 2, and the state of charge two ways."""
    one = cells_of.cell()
    minutes, volts, zones = cells_of.discharge_curve(one)
    curve = []
    for zone in zones:
        at = np.flatnonzero((minutes >= zone.from_min) & (minutes <= zone.to_min))
        some = at[np.unique(np.linspace(0, len(at) - 1, CURVE).astype(int))]
        name = f"{zone.name}: {zone.slope_mv_min:.0f} mV/min"
        curve.append({"name": name, "x": minutes[some].round(3).tolist(), "y": volts[some].round(4).tolist(),
                      "points": False, "style": "solid"})  # fmt: skip
    run = steady()
    some = np.unique(np.linspace(0, len(run.t_s) - 1, CURVE).astype(int))
    charge = [
        {"name": name, "x": (run.t_s[some] / 60).round(2).tolist(), "y": (100 * y[some]).round(2).tolist(),
         "points": False}
        for name, y in (
            ("counted, over what is delivered", run.counted_soc),
            ("counted, over the rated 6 Ah", run.counted_rated_soc),
            ("read from the voltage", run.read_soc),
        )
    ]  # fmt: skip
    figures = [
        Figure("figure-2", "Figure 2: the cell at 8 A, and its three zones", "lines",
               {"series": curve, "x_title": "minutes", "y_title": "V",
                "note": "Voltages are assumed: the paper prints only where the curve bends."}),
        Figure("charge", "State of charge at 8 A, counted and read", "lines",
               {"series": charge, "x_title": "minutes", "y_title": "state of charge, %",
                "note": "Outside the stable zone, 2.5 to 49 minutes, the voltage doesn't tell the charge."}),
    ]  # fmt: skip
    driven = [r["drive"] for r in of[1, BASE, OWN] if "drive" in r]
    return figures if not driven else [*figures, _drive(driven[0])]


def _drive(drive: Cell) -> Figure:
    series = [
        {"name": name, "x": drive["min"], "y": drive[key], "points": False, "style": "solid"}
        for name, key in (
            ("counted, over what is delivered", "counted"), ("read from the voltage, every second", "read"),
        )
    ]  # fmt: skip
    note = "Starts draw several times the mean current, and the cell's slow polarisation lags behind them."
    return Figure(
        "drive", "State of charge of one AGV while it drives, counted and read", "lines",
        {"series": series, "x_title": "minutes", "y_title": "state of charge, %", "note": note},
    )  # fmt: skip
