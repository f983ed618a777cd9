"""The table of the study of Lian et al. 2024: what is run, what the paper prints, and the rows from the runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from engine.energy import tremblay as cells_of
from engine.energy.lian2024 import motors_share
from engine.studies.base import Cell, Row, by_quantity, row
from engine.studies.lian2024_cells import MARK_S
from engine.types import Component

METHODS = {
    "stochastic": ("stochastic", "time"),
    "astar-turns": ("astar-turns", "time"),
    "astar-distance": ("astar-distance", "time"),
    "prioritized": ("prioritized", "time"),
    "prioritized (energy)": ("prioritized", "energy"),
}
"""Word in the table → planner and objective. The first three are the paper's, the others what one would take today."""
PAPERS = ("stochastic", "astar-turns", "astar-distance")
OWN, TURNS, DISTANCE = PAPERS
SLOW = "prioritized (energy)"
"""Plans for minutes of CPU per simulated minute."""

EER_GAIN = 26.84
"""Orders per energy over `astar-turns`, printed."""
TABLE_3: dict[str, tuple[float, ...]] = {
    OWN: (600.453, 795.233, 1254.215, 985.635, 1055.236),
    TURNS: (1042.322, 1423.355, 2001.368, 1058.788, 1155.996),
    DISTANCE: (1055.466, 1583.993, 2650.477, 1345.218, 1565.362),
}
"""Seconds per hour that five arcs were held, printed."""
TABLES_1_2 = {
    "sd": 80.2962, "se": 17.9548, "skew_se": 0.512, "kurtosis_se": 0.992, "shapiro_w": 0.960, "shapiro_p": 0.539,
    "lilliefors_d": 0.088, "lilliefors_p": 0.2,
}  # fmt: skip
"""Printed; se is what the printed interval implies, for the printed 17.99548 goes with no number of samples."""
STATISTICS = {
    "n": "samples", "mean": "mean, ms", "se": "standard error, ms", "ci_low": "95 % from, ms", "ci_high": "95 % to, ms",
    "trimmed_mean": "5 % trimmed mean, ms", "median": "median, ms", "sd": "standard deviation, ms",
    "max": "largest, ms", "min": "smallest, ms", "range": "range, ms", "iqr": "interquartile range, ms",
    "skew": "skewness", "skew_se": "its standard error", "kurtosis": "kurtosis", "kurtosis_se": "its standard error",
    "lilliefors_d": "Lilliefors D", "lilliefors_p": "Lilliefors p", "shapiro_w": "Shapiro–Wilk W",
    "shapiro_p": "Shapiro–Wilk p",
}  # fmt: skip
PRINTED_N = 20


class Factor(NamedTuple):
    """Something assumed: its two other values in words, and what they change in the scenario.

    kind: `run` needs runs of its own, `own` those of the paper's method alone, `energy` none: the same
    motions are costed again.
    """

    name: str
    low: str
    low_changes: dict[str, Any]
    high: str
    high_changes: dict[str, Any]
    kind: str


def _poisson(rate_per_h: float) -> dict[str, Any]:
    return {"orders.source": "poisson", "orders.rate_per_h": rate_per_h}


def _service(seconds: float) -> dict[str, Any]:
    return {"service.pick_s": seconds, "service.drop_s": seconds}


def _arc(metres: float) -> dict[str, Any]:
    """Another length; the printed 900 ms stay."""
    return {"floor.network.mesh.spacing_m": metres, "motion.speed_mps": metres / 0.9}


def _others(watts: float) -> dict[str, Any]:
    return {"energy.parameters.standby_w": watts}


def _ramps(mps2: float) -> dict[str, Any]:
    return {"energy.parameters.accel_mps2": mps2, "energy.parameters.brake_mps2": mps2}


TURN = Factor(
    "a turn weighed as its 1 s", "2 s", {"planner.parameters.turn_ms": 2000}, "4 s",
    {"planner.parameters.turn_ms": 4000}, "own",
)  # fmt: skip
FACTORS = (
    Factor("orders: a backlog", "Poisson, 1000 per h", _poisson(1000), "Poisson, 2000 per h", _poisson(2000), "run"),
    Factor("service: 5 s", "2 s", _service(2), "15 s", _service(15), "run"),
    Factor(
        "learning: half of the mean", "all of the mean", {"planner.parameters.smoothing": 1.0}, "g and h as printed",
        {"planner.parameters.literal": True}, "own",
    ),
    TURN,
    Factor("arc: 0.9 m", "0.6 m", _arc(0.6), "1.35 m", _arc(1.35), "energy"),
    Factor("mass: 500 kg", "100 kg", {"fleet.mass_kg": 100.0}, "1000 kg", {"fleet.mass_kg": 1000.0}, "energy"),
    Factor("load: none", "100 kg", {"fleet.payload_kg": 100.0}, "500 kg", {"fleet.payload_kg": 500.0}, "energy"),
    Factor("others: 20 W", "5 W", _others(5.0), "100 W", _others(100.0), "energy"),
    Factor("ramps: 0.5 m/s²", "0.25 m/s²", _ramps(0.25), "1 m/s²", _ramps(1.0), "energy"),
    Factor(
        "gear: 30", "20", {"energy.parameters.gear": 20.0}, "40", {"energy.parameters.gear": 40.0}, "energy"
    ),
)  # fmt: skip
AGVS = "29"
"""Vehicles of the main runs."""
BASE = "as assumed"


@dataclass(frozen=True, slots=True)
class Extent:
    """How much is run: hours of the main runs and of those beside, seeds beside, fleets (29 among them), factors.

    slow_hours: of the planner that is too slow for more, 0 to leave it out · energy_hours: of figure 6.
    """

    hours: float
    side_hours: float
    side_seeds: int
    fleets: tuple[int, ...]
    factors: tuple[Factor, ...]
    slow_hours: float = 0.0
    energy_hours: float = 2.0


QUICK = Extent(1.0, 0.75, 1, (1, 5, 29, 60), FACTORS[:2] + FACTORS[4:])
FULL = Extent(10.0, 1.0, 3, (1, 5, 15, 29, 45, 60), FACTORS, MARK_S / 3600)

Runs = Mapping[tuple[int, str, str], list[Cell]]
"""Results by experiment, case and method, in the order of their seeds."""
Measure = Callable[[Cell], float]


# -- measures ---------------------------------------------------------------------------------------------------------


def _at(marks: Sequence[float], seconds: float) -> float:
    """A cumulative value as it stood after so many seconds."""
    n = round(seconds / MARK_S)
    return float(marks[n - 1]) if n else 0.0


def orders_of(r: Cell, first_h: float = 0.0, last_h: float | None = None) -> float:
    """Orders delivered between two hours, to the run's end without a second one."""
    last_s = len(r["orders_at"]) * MARK_S if last_h is None else last_h * 3600
    return _at(r["orders_at"], last_s) - _at(r["orders_at"], first_h * 3600)


def kwh_of(r: Cell, first_h: float = 0.0, last_h: float | None = None) -> float:
    """Energy drawn from the batteries between two hours."""
    last_s = len(r["orders_at"]) * MARK_S if last_h is None else last_h * 3600
    return sum(_at(e, last_s) - _at(e, first_h * 3600) for e in r["energy_at"].values()) / 3.6e6


def eer_of(r: Cell, first_h: float = 0.0, last_h: float | None = None) -> float:
    """Orders per kWh: the paper's energy efficiency, whose definition isn't printed."""
    kwh = kwh_of(r, first_h, last_h)
    return orders_of(r, first_h, last_h) / kwh if kwh else 0.0


def gains(own: Sequence[Cell], base: Sequence[Cell], measure: Measure) -> list[float]:
    """Percent by which a measure is higher than the base's, seed by seed."""
    return [100 * (measure(a) / measure(b) - 1) for a, b in zip(own, base, strict=True) if measure(b)]


def hours_words(hours: float) -> str:
    """`10 h`, `45 min`."""
    return f"{hours:g} h" if hours >= 1 else f"{60 * hours:g} min"


def after_learning(x: Extent) -> float:
    """Hour at which a run beside begins to count: after the first refresh."""
    return 0.5 if x.side_hours > 0.5 else MARK_S * (x.side_hours * 3600 // (2 * MARK_S)) / 3600


# -- rows -------------------------------------------------------------------------------------------------------------


def rows_of(of: Runs, x: Extent, quick: bool) -> list[Row]:
    """The whole table."""
    return [
        *orders_rows(of, x, quick), *arc_rows(of), *energy_rows(of, x), *times_rows(of), *fleet_rows(of, x),
        *factor_rows(of, x), *battery_rows(of),
    ]  # fmt: skip


def orders_rows(of: Runs, x: Extent, quick: bool) -> list[Row]:
    """Figure 5."""
    hours = hours_words(x.hours) + (", a quick run" if quick else "")
    main = {method: of[1, BASE, method] for method in (*PAPERS, "prioritized")}
    rows = [
        row(1, f"orders done in {hours}", method, [orders_of(r) for r in runs], unit="orders")
        for method, runs in main.items()
    ]
    for base in (TURNS, DISTANCE):
        gained = gains(main[OWN], main[base], orders_of)
        note = "the paper: more; its numbers are lost"
        rows.append(row(1, f"more orders in {hours}", f"{OWN} over {base}", gained, (0.0, 100.0), note=note))
    gained = gains(main["prioritized"], main[OWN], orders_of)
    rows.append(row(1, f"more orders in {hours}", f"prioritized over {OWN}", gained))
    for method in PAPERS:
        shares = [100 * r["plans_detoured"] / max(1, r["plans"]) for r in main[method]]
        rows.append(row(1, "routes that couldn't be timed and gave way to a detour", method, shares))
    for method, runs in main.items():
        waits = [r["waited_s"] / max(1, r["orders_done"]) for r in runs]
        rows.append(row(1, "waiting per order", method, waits, unit="s"))
    return rows


def busiest(of: Runs) -> list[str]:
    """The five lanes that the paper's three methods hold longest, taken together."""
    total: dict[str, float] = {}
    for method in PAPERS:
        for r in of[1, BASE, method]:
            for lane, seconds in r["busy_s"].items():
                total[lane] = total.get(lane, 0.0) + seconds
    return sorted(total, key=lambda lane: -total[lane])[:5]


def paper_arcs() -> list[int]:
    """The paper's arcs in the same order: by the sum over its methods, from 0."""
    return sorted(range(5), key=lambda k: -sum(TABLE_3[m][k] for m in PAPERS))


def arc_rows(of: Runs) -> list[Row]:
    """Table 3."""
    lanes, rows = busiest(of), []
    for k, (lane, printed) in enumerate(zip(lanes, paper_arcs(), strict=True)):
        for method in PAPERS:
            held = [r["busy_s"][lane] for r in of[1, BASE, method]]
            note = f"ours {lane.removeprefix('lane ')}, the paper's arc {printed + 1}"
            what = f"held per hour, arc {k + 1} of 5"
            rows.append(row(2, what, method, held, TABLE_3[method][printed], "s", note))
    for base in (DISTANCE, TURNS):
        printed_less = 100 * (1 - sum(TABLE_3[OWN]) / sum(TABLE_3[base]))

        def of_five(r: Cell) -> float:
            return float(sum(r["busy_s"][lane] for lane in lanes))

        less = [-g for g in gains(of[1, BASE, OWN], of[1, BASE, base], of_five)]
        rows.append(row(2, f"less than {base} on the five together", OWN, less, round(printed_less, 1)))
    for base in (DISTANCE, TURNS):
        less = [-g for g in gains(of[1, BASE, OWN], of[1, BASE, base], lambda r: float(sum(r["busy_s"].values())))]
        rows.append(row(2, f"less than {base} on all lanes together", OWN, less))
    return rows


def energy_rows(of: Runs, x: Extent) -> list[Row]:
    """Figure 6, orders per energy, and the motors' share."""
    short = min(x.energy_hours, x.hours)
    main = {method: of[1, BASE, method] for method in (*PAPERS, "prioritized")}
    rows = [
        row(3, f"energy in {hours_words(short)}", method, [kwh_of(r, 0, short) for r in runs], unit="kWh")
        for method, runs in main.items()
    ]
    for last in dict.fromkeys((short, x.hours)):
        for method, runs in main.items():
            values = [eer_of(r, 0, last) for r in runs]
            rows.append(row(3, f"orders per kWh in {hours_words(last)}", method, values, unit="orders/kWh"))
    for last in dict.fromkeys((short, x.hours)):
        gained = gains(main[OWN], main[TURNS], lambda r, last=last: eer_of(r, 0, last))  # type: ignore[misc]
        rows.append(row(3, f"more orders per energy in {hours_words(last)}", f"{OWN} over {TURNS}", gained, EER_GAIN))
    for method, base in ((OWN, DISTANCE), ("prioritized", OWN)):
        gained = gains(main[method], main[base], eer_of)
        rows.append(row(3, f"more orders per energy in {hours_words(x.hours)}", f"{method} over {base}", gained))

    def as_printed(r: Cell) -> float:
        return float(r["orders_done"]) / float(r["kinetic_j"])

    note = "kinetic energy of every start, and 20 W: equations 6 to 8"
    gained = gains(main[OWN], main[TURNS], as_printed)
    what = f"more orders per energy as the paper counts it in {hours_words(x.hours)}"
    rows.append(row(3, what, f"{OWN} over {TURNS}", gained, EER_GAIN, note=note))
    rows += _slow_rows(of, x)
    if 1 in x.fleets:
        first = after_learning(x)
        alone = gains(of[5, "1", TURNS], of[5, AGVS, TURNS], lambda r: eer_of(r, first))
        note = "the same routes when nobody is in the way"
        rows.append(row(3, "more orders per energy", f"one AGV alone over 29, {TURNS}", alone, note=note))
    for method, runs in main.items():
        shares = [100 * motors_share(by_component(r)) for r in runs]
        rows.append(row(3, "energy that the motors take", method, shares, (80.0, 100.0)))
    return rows


def by_component(r: Cell) -> dict[Component, float]:
    """Energy of a whole run in J."""
    return {Component[name.upper()]: joules for name, joules in r["energy_by_component"].items()}


def _slow_rows(of: Runs, x: Extent) -> list[Row]:
    """All methods over the few minutes for which the slowest was run."""
    rows: list[Row] = []
    seeds = len(of.get((1, BASE, SLOW), ()))
    for what, measure, unit in (("orders done", orders_of, "orders"), ("orders per kWh", eer_of, "orders/kWh")):
        for method in METHODS if seeds else ():
            values = [measure(r, 0, x.slow_hours) for r in of[1, BASE, method][:seeds]]
            quantity = f"{what} in the first {hours_words(x.slow_hours)}"
            rows.append(row(3, quantity, method, values, unit=unit, note="from a standing start"))
    return rows


def times_rows(of: Runs) -> list[Row]:
    """Tables 1 and 2."""
    rows = []
    runs = of[1, BASE, OWN]
    for kind, words in (("visits", "20 visits"), ("half hours", "20 means of half hours")):
        tests = [r["tests"][kind] for r in runs if kind in r["tests"]]
        if not tests:
            continue
        case = f"busiest lane, {words}"
        for key, word, unit in (
            ("sd", "standard deviation", "ms"), ("se", "standard error of the mean", "ms"), ("skew", "skewness", ""),
            ("skew_se", "standard error of the skewness", ""), ("kurtosis_se", "standard error of the kurtosis", ""),
            ("shapiro_w", "Shapiro–Wilk W", ""), ("lilliefors_d", "Lilliefors D", ""),
        ):  # fmt: skip
            note = "printed as 17.99548; its interval implies this" if key == "se" else ""
            digits = 3 if key.endswith("_se") else 6  # these follow from n alone: compared as printed
            values = [round(t["lane"][key], digits) for t in tests]
            rows.append(row(4, word, case, values, TABLES_1_2.get(key), unit, note))
        for test, word in (("lilliefors", "Lilliefors"), ("shapiro", "Shapiro–Wilk")):
            shares = [100 * t["all"][test] for t in tests]
            note = f"of {min(t['all']['arcs'] for t in tests)} lanes or more; the paper: all pass"
            what = f"lanes that {word} doesn't reject as normal at 5 %"
            rows.append(row(4, what, words, shares, 100.0, note=note))
        rows.append(row(4, "median skewness of all lanes", words, [t["all"]["median_skew"] for t in tests], unit=""))
    for method in PAPERS:
        same = [r["persistence"] for r in of[1, BASE, method] if r["persistence"] is not None]
        what = "lanes' mean times in a half hour and in the next: correlation"
        if same:
            rows.append(row(4, what, method, same, unit="", note="what there is to learn"))
    return by_quantity(rows)


def agvs(fleet: int) -> str:
    return f"{fleet} AGV{'s' if fleet > 1 else ''}"


def fleet_rows(of: Runs, x: Extent) -> list[Row]:
    """Fleets of other sizes, after the first refresh."""
    rows, first = [], after_learning(x)
    per_h = x.side_hours - first
    for fleet in sorted(x.fleets):
        runs = {method: of[5, str(fleet), method] for method in PAPERS}
        for method in PAPERS:
            values = [orders_of(r, first) / per_h for r in runs[method]]
            rows.append(row(5, "orders per hour", f"{agvs(fleet)}, {method}", values, unit="orders/h"))
    for what, measure in (("orders", orders_of), ("orders per energy", eer_of)):
        for base in (TURNS, DISTANCE):
            for fleet in sorted(x.fleets):
                own, other = of[5, str(fleet), OWN], of[5, str(fleet), base]
                gained = gains(own, other, lambda r, m=measure: m(r, first))  # type: ignore[misc]
                rows.append(row(5, f"more {what}, {OWN} over {base}", agvs(fleet), gained))
    return rows


def tornado(of: Runs, x: Extent) -> list[tuple[Factor, str, list[float]]]:
    """Gain in orders per energy over `astar-turns`, seed by seed, with each assumption changed; first as assumed."""
    first = after_learning(x)
    own, base = of[5, AGVS, OWN], of[5, AGVS, TURNS]

    def by_ledger(r: Cell) -> float:
        return eer_of(r, first)

    found = [(Factor(BASE, "", {}, "", {}, ""), "", gains(own, base, by_ledger))]
    for factor in x.factors:
        for value in (factor.low, factor.high):
            case = f"{factor.name} → {value}"
            if factor.kind == "energy":
                gained = gains(own, base, lambda r, c=case: orders_of(r, first) / r["recosted_j"][c])  # type: ignore[misc]
            else:
                other = base if factor.kind == "own" else of[6, case, TURNS]
                gained = gains(of[6, case, OWN], other, by_ledger)
            found.append((factor, value, gained))
    return found


def factor_rows(of: Runs, x: Extent) -> list[Row]:
    what = f"more orders per energy, {OWN} over {TURNS}"
    return [
        row(6, what, f"{factor.name} → {value}" if value else BASE, values, EER_GAIN)
        for factor, value, values in tornado(of, x)
    ]


def battery_rows(of: Runs) -> list[Row]:
    """Capacity, the discharge curve's slopes, and the two states of charge."""
    one = cells_of.cell()
    run = steady()
    error = 100 * run.error[run.stable]
    driven = [r for r in of[1, BASE, OWN] if "drive" in r]
    slopes = [
        row(7, "mean slope at 8 A", f"{z.name}, {z.from_min:g} to {z.to_min:g} min", [z.slope_mv_min], unit="mV/min",
            note="no voltage is printed")
        for z in cells_of.discharge_curve(one)[2]
    ]  # fmt: skip
    label = 100 * (run.counted_rated_soc - run.counted_soc)
    rows = [
        row(7, "delivered at 8 A in 50 min", "one cell", [one.delivered_ah], 8 * 50 / 60, "Ah", "6 Ah are rated"),
        *slopes,
        row(7, "state of charge, voltage less counting: root mean square", "8 A, stable zone",
            [float(np.sqrt(np.mean(error**2)))]),
    ]  # fmt: skip
    for key, case in (("drive_rms", "driving, every second"), ("minute_rms", "driving, means of a minute")):
        what = "state of charge, voltage less counting: root mean square"
        rows.append(row(7, what, f"{case}, stable zone", [r[key] for r in driven]))
    what = "state of charge, counting over 6 Ah less counting over what is delivered"
    rows.append(row(7, what, "8 A, after 45 min", [float(np.interp(45.0, run.t_s / 60, label))]))
    return rows


def steady() -> cells_of.Discharge:
    """The paper's test: 8 A until a moment before the cell is empty."""
    one = cells_of.cell()
    seconds = round(one.delivered_ah / cells_of.TEST_A * 3600)
    return cells_of.discharge(one, np.full(seconds, cells_of.TEST_A), 1.0, slow_a=cells_of.TEST_A)
