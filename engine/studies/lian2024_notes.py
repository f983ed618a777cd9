"""Why the results differ from those of Lian et al. 2024, with the numbers that show it, and how things were counted."""

from __future__ import annotations

from collections.abc import Sequence

from engine.build import costs_of
from engine.studies.base import Cell, mean_interval
from engine.studies.lian2024_cells import changed
from engine.studies.lian2024_table import (
    AGVS,
    BASE,
    DISTANCE,
    EER_GAIN,
    OWN,
    SLOW,
    TURN,
    TURNS,
    Extent,
    Measure,
    Runs,
    after_learning,
    agvs,
    busiest,
    eer_of,
    gains,
    hours_words,
    orders_of,
)
from engine.units import MJ_PER_J
from engine.world import build_world


def notes_of(of: Runs, x: Extent, quick: bool) -> list[str]:
    """Sentences, the most important first."""
    found = [_quick(x)] if quick else []
    return [*found, _headline(of, x), _why(of), *_weighed(of, x), _fleets(of, x), _bound(of, x), *_counting(of, x)]


def _quick(x: Extent) -> str:
    return (
        f"A quick run: {hours_words(x.hours)} in place of 10 h, few seeds, and {x.side_seeds} seed beside, so that "
        "intervals are wide or missing and half of a run lies before anything was learned. Its verdicts say little."
    )


def _mean(runs: Sequence[Cell], measure: Measure) -> float:
    return mean_interval([measure(r) for r in runs])[0]


def _gain(own: Sequence[Cell], base: Sequence[Cell], measure: Measure) -> str:
    """`+1.2 % (± 0.4)`."""
    mean, half = mean_interval(gains(own, base, measure))
    return f"{mean:+.1f} %" + ("" if half is None else f" (± {half:.1f})")


def _headline(of: Runs, x: Extent) -> str:
    own, base = of[1, BASE, OWN], of[1, BASE, TURNS]
    return (
        f"The printed {EER_GAIN:+g} % of orders per energy over {TURNS} isn't found: learned times change it by "
        f"{_gain(own, base, eer_of)} in {hours_words(x.hours)}, and the orders by {_gain(own, base, orders_of)}. The "
        "paper neither defines its efficiency nor prints the numbers behind it; counted as its equations 6 to 8 count "
        "energy, the table has another row."
    )


def _why(of: Runs) -> str:
    """What the routes look like and cost, from the motions."""

    def per_order(method: str, key: str) -> float:
        return _mean(of[1, BASE, method], lambda r: r[key] / max(1, r["orders_done"]))

    def detoured(method: str) -> float:
        return _mean(of[1, BASE, method], lambda r: 100 * r["plans_detoured"] / max(1, r["plans"]))

    def took(method: str) -> float:
        return _mean(of[1, BASE, method], lambda r: r["took_ms"][-1] if r["took_ms"] else 0.0)

    turn, arc = _turn_and_arc_j()
    return (
        "Learning does what it should: queues stay where they are (see the correlation in experiment 4), an arc "
        f"takes {took(OWN):.0f} ms in the mean at the end with learned routes, {took(TURNS):.0f} ms with {TURNS}, and "
        f"an order waits {per_order(OWN, 'waited_s'):.1f} s in place of {per_order(TURNS, 'waited_s'):.1f}. But a way "
        f"around a queue is paid with turns, {per_order(OWN, 'turns'):.2f} an order in place of "
        f"{per_order(TURNS, 'turns'):.2f}. The method weighs a turn by its second; in energy, stopping, turning and "
        f"starting again take {turn:.0f} J, as much as {turn / arc:.0f} arcs straight on. So it wins time and not "
        "energy. The motors' energy is in starts and turns, hardly in metres. And the timer, which schedules all "
        f"methods alike, lets no route run into a jam: {detoured(TURNS):.0f} % of the routes of {TURNS} couldn't be "
        f"timed among the reservations and gave way to a search that could, {detoured(OWN):.0f} % of those of {OWN}. "
        "The paper says nothing of how its vehicles give way to each other; baselines that queue up blindly would "
        "lose more."
    )


def _weighed(of: Runs, x: Extent) -> list[str]:
    """What the method gains when a turn weighs more than its second; nothing where that wasn't run."""
    base, first = of[5, AGVS, TURNS], after_learning(x)
    cases = {value: of.get((6, f"{TURN.name} → {value}", OWN), []) for value in (TURN.low, TURN.high)}
    found = [
        f"as {value}, {_gain(runs, base, lambda r: orders_of(r, first))} orders and "
        f"{_gain(runs, base, lambda r: eer_of(r, first))} orders per energy"
        for value, runs in {"its 1 s": of[5, AGVS, OWN], **cases}.items() if runs
    ]  # fmt: skip
    if len(found) == 1:
        return []
    return [f"The method with a turn weighed otherwise, against {TURNS} in experiment 6: {'; '.join(found)}."]


def _turn_and_arc_j() -> tuple[float, float]:
    """J of a quarter turn with the start after it beyond driving on, and of an arc straight on; standby is left out."""
    scenario = changed({})
    world = build_world(scenario)
    mj = costs_of(scenario, world).total_mj[0, 0]
    kinds = world.graph.primitives

    def of(starts: bool, pivot: bool) -> float:
        longest = max(
            (p.length_mm, -p.turn_deg, i) for i, p in enumerate(kinds) if (p.starts, p.pivot) == (starts, pivot)
        )
        return float(mj[longest[2]]) / MJ_PER_J

    arc = of(False, False)
    return of(False, True) + of(True, False) - arc, arc


def _fleets(of: Runs, x: Extent) -> str:
    """Where congestion makes the method pay."""
    first = after_learning(x)
    by_size = [
        f"{agvs(n)} {_gain(of[5, str(n), OWN], of[5, str(n), TURNS], lambda r: orders_of(r, first))} and "
        f"{_gain(of[5, str(n), OWN], of[5, str(n), TURNS], lambda r: eer_of(r, first))}"
        for n in sorted(x.fleets)
    ]
    return f"Orders and orders per energy over {TURNS} by the size of the fleet: {'; '.join(by_size)}."


def _bound(of: Runs, x: Extent) -> str:
    modern, own = of[1, BASE, "prioritized"], of[1, BASE, OWN]
    first = after_learning(x)
    alone = ""
    if 1 in x.fleets:
        gained = mean_interval(gains(of[5, "1", TURNS], of[5, AGVS, TURNS], lambda r: eer_of(r, first)))[0]
        alone = (
            f" One AGV alone does {gained:.0f} % more orders per energy than 29 with the same routes: so much "
            "congestion costs."
        )
    return (
        "`prioritized`, which looks for route and time together among the reservations and learns nothing, does "
        f"{_gain(modern, own, orders_of)} orders against {OWN} and {_gain(modern, own, eer_of)} orders per energy: it "
        f"drives further rather than wait.{alone}{_energy_search(of, x)}"
    )


def _energy_search(of: Runs, x: Extent) -> str:
    """What the slow planner gains over the same minutes; nothing where it wasn't run."""
    slow = of.get((1, BASE, SLOW), [])
    if not slow:
        return ""
    base = of[1, BASE, TURNS][: len(slow)]
    energy = _gain(slow, base, lambda r: eer_of(r, 0, x.slow_hours))
    orders = _gain(slow, base, lambda r: orders_of(r, 0, x.slow_hours))
    return (
        f" Who wants energy has to search for it: `{SLOW}` does {energy} orders per energy over {TURNS}, with {orders} "
        f"orders, in the first {hours_words(x.slow_hours)}; it plans for minutes of CPU per simulated minute, so no "
        "longer."
    )


def _counting(of: Runs, x: Extent) -> list[str]:
    """How things were counted, and what is assumed."""
    own = of[1, BASE, OWN][0]
    swaps = own["swaps"] / x.hours / int(AGVS)
    lanes = ", ".join(lane.removeprefix("lane ") for lane in busiest(of))
    held = of[1, BASE, OWN], of[1, BASE, TURNS]
    five = -mean_interval(gains(*held, lambda r: sum(r["busy_s"][lane] for lane in busiest(of))))[0]
    every = -mean_interval(gains(*held, lambda r: sum(r["busy_s"].values())))[0]
    return [
        f"Table 3: our five lanes ({lanes}) are those that the paper's three methods together hold longest after the "
        f"first hour; choosing them by {DISTANCE} alone would flatter the others. The paper's five aren't named. An "
        f"arc has a lane for each direction here, and each holds one AGV. Learned times empty these by {five:.0f} % "
        f"against {TURNS} and fill others: all lanes together lose {every:.0f} %.",
        "Tables 1 and 2: a visit takes the arc's own 900 ms or that and a queue, so its times have a floor and a "
        "long tail and no test takes them for normal. Ten hours hold 20 half hours, and the paper's tests have 20 "
        "samples: means of half hours are nearer to normal. That one sample of 20 isn't rejected doesn't prove that "
        "all arcs are normal, which theorem 1 needs.",
        "The first half hour is the same for everybody: nothing is learned yet. Experiments 5 and 6 count from "
        f"{hours_words(after_learning(x))} to {hours_words(x.side_hours)}.",
        "Assumed, for the paper doesn't say: orders, service times, the arcs' length, mass, gear, wheels, the power "
        "of the others. With 500 kg and a gear of 30 the motors take more than the paper's 80 %; with 100 kg and 20 "
        "about half. The tornado changes one at a time: orders and service with runs of their own, vehicle and arcs "
        "(whose 900 ms stay) by costing the same motions again.",
        f"One charge doesn't last ten hours: batteries are changed at the entrances below 30 %, {swaps:.1f} times an "
        "hour per AGV. The paper names neither charger nor change, and prints no voltage: the cell's curve is fitted "
        "to assumed ones.",
        "While driving, currents change within seconds. The voltage then tells the charge only through means of a "
        "minute, for the cell's polarisation lags; counting knows the charge but not the capacity: over the rated 6 Ah "
        "it is a tenth too low when 6.67 Ah are delivered.",
    ]
