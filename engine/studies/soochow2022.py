"""Soochow thesis 2022: ants against A*, and what the reservation table and the one-way rule are worth.

Experiment 1: convergence, length and time of the colonies against A* by density · 2: the thesis's grid search · 3:
collisions and completion over random task sets, the table as described against the corrected one, by policy · 4: the
battery over long task sets · 5: the detour of one-way lanes. Every run is recorded and judged.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from time import process_time
from typing import Any

import numpy as np

from engine.build import build
from engine.planners.aco import Aco
from engine.planners.astar import AStar
from engine.planners.single import Floor
from engine.results.runlog import MemoryLog
from engine.scenario import Scenario, load
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import single_instance
from engine.sim.judge import BreachKind, judge
from engine.studies.base import Cell, Figure, Progress, Result, Row, Settings, by_quantity, row, run_cells
from engine.types import Activity
from engine.world import build_world, one_way

DENSITIES = (0.10, 0.20, 0.30)
SIZE = 20
PICTURED = 0.20
"""Density of the convergence curves and of the grid search."""
COLONIES: dict[str, dict[str, Any]] = {
    "classic": {"rule": "classic"},
    "literal": {"inducement": "literal"},
    "off": {"inducement": "off"},
    "exponent": {"inducement": "exponent"},
    "discard": {"inducement": "literal", "retreat": False},
}
WORDS = {
    "classic": "classic ant system",
    "literal": "improved, inducement as printed",
    "off": "improved, without inducement",
    "exponent": "improved, inducement in the exponent",
    "discard": "improved as printed, ants in dead ends discarded",
    "astar": "A*",
}
GRID = {
    "alpha": (1.0, 2.0), "beta": (3.0, 5.0, 7.0), "rho": (0.1, 0.3, 0.5), "explore": (0.1, 0.3, 0.5),
    "xi": (0.1, 0.3, 0.45),
}  # fmt: skip
"""The thesis tunes by grid search and prints neither grid nor result: assumed values."""
GRID_LETTERS = {"alpha": "α", "beta": "β", "rho": "ρ", "explore": "ε0", "xi": "ξ"}

POLICIES: dict[str, tuple[str, dict[str, Any]]] = {
    "one-way lanes": ("soochow2022", {}),
    "one-way ways": ("soochow2022", {"floor.one_way": "ways"}),
    "four directions": ("soochow2022-four", {}),
    "eight directions": ("soochow2022-eight", {}),
}
ORDERS, MANY_ORDERS = 10, 60
UNTIL_S, MANY_UNTIL_S = 1500, 6000
RESUMES = (1.0, 0.5)
"""State of charge at which a charging vehicle takes orders again: the thesis says both."""
COLLISIONS = (BreachKind.VERTEX, BreachKind.SWAP, BreachKind.CROSSING)
SIDES = {"as described": True, "corrected": False}
CAPS = {2: 100, 3: 300, 4: 50}
"""Most maps, or task sets per policy, of the experiments that need no more: 1,200 sets of ten tasks in all."""

NOTES = (
    "The thesis prints no numbers for its algorithm: no lengths, no times, no parameters after tuning. What it prints "
    "are claims, and these stand in the column of the paper: no collision, and one step for the one-way rule.",
    "The inducement as printed is a factor that is the same for every next place, so it cancels in the probability "
    "and in its maximum. The rows say on how many maps every choice of every ant was the same with and without it.",
    "Lengths are steps. A* is exact, so nothing can be shorter; the thesis's reason for ants, less cost, is the row of "
    "CPU times. Ants in a dead end go back and remember it, unless a row says that they are discarded, as printed.",
    "The classic ant system has the same retreat, bounds and global evaporation here, and its best way so far lays "
    "pheromone. So equipped it is no worse than the improved one: the retreat does what the three changes claim.",
    "A task set is ten orders between random stations, as in the thesis's table. Vehicles take them in turn; a "
    "collision is a breach of the classical rules (place, swap, crossing diagonals), which allow to follow into a "
    "place just left. As described, plans are executed as they are, so that collisions happen and the run goes on.",
    "`one-way lanes` is the floor as drawn, with open crossings; `one-way ways` lets every way between two aisle "
    "cells be driven in one direction only, the strict reading of the rule. Stations and chargers stay dead ends.",
    "Judged and free of breaches are the corrected runs; those as described are counted in the rows instead.",
    "The thesis's floor survives as a lost figure. Floor, service times (2 s) and task sets are ours.",
)


@dataclass(frozen=True, slots=True)
class Soochow2022:
    """No parameters."""

    @property
    def name(self) -> str:
        return "soochow2022"

    @property
    def title(self) -> str:
        return "Ants and a reservation table: what they find, and what they let happen"

    @property
    def paper(self) -> str:
        return "Soochow University thesis 2022, improved ant colony and reservation table"

    @property
    def experiments(self) -> Mapping[int, str]:
        return {
            1: f"Ant colonies against A* by density, {SIZE} × {SIZE}",
            2: f"Grid search of the colony's parameters, {percent(PICTURED)} obstacles",
            3: f"Collisions over random sets of {ORDERS} tasks, eight vehicles",
            4: f"The battery over {MANY_ORDERS} tasks, eight vehicles",
            5: "The detour of one-way lanes between all stations",
        }

    @property
    def maps(self) -> tuple[int, int]:
        return 6, 1000

    def cells(self, settings: Settings) -> list[Cell]:
        """Every map and task set as plain values."""
        n = settings.maps or self.maps[not settings.quick]
        cells: list[Cell] = []

        def add(experiment: int, what: str, **values: Any) -> None:
            for number in range(min(n, CAPS.get(experiment, n))):
                words = f"experiment {experiment}, {what}, {number + 1}"
                cells.append({"experiment": experiment, "map": number, "seed": settings.seed, **values, "what": words})

        for density in DENSITIES:
            add(1, f"{percent(density)} obstacles, map", density=density)
        add(2, "grid search, map", density=PICTURED)
        for policy in POLICIES:
            add(3, f"{policy}, task set", policy=policy)
        add(4, "task set", policy="one-way lanes")
        cells.append({"experiment": 5, "map": 0, "seed": settings.seed, "what": "experiment 5, detours"})
        return cells

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        """See Study."""
        cells = self.cells(settings)
        results = run_cells(solve_cell, cells, settings, progress, jobs)
        of: Cases = {}
        for cell, result in zip(cells, results, strict=True):
            case = cell.get("density", cell.get("policy", ""))
            of.setdefault((cell["experiment"], case), []).append(result)
        rows = by_quantity([*_length_rows(of), *_grid_rows(of), *_run_rows(of), *_battery_rows(of), *_detour_rows(of)])
        judged = [r[side] for (e, _), found in of.items() if e in (3, 4) for r in found for side in r if side[0] == "c"]
        return Result(
            self.name, self.title, self.paper, self.experiments, self.one_set(settings), tuple(rows),
            tuple(_figures(of)), len(judged), sum(sum(r["breaches"].values()) for r in judged), NOTES,
        )  # fmt: skip

    def one_set(self, settings: Settings) -> dict[str, Any]:
        """What produced all rows."""
        aco = Aco()
        return {
            "ants": aco.ants, "iterations": aco.iterations, "α": aco.alpha, "β": aco.beta, "ρ": aco.rho, "Q": aco.q,
            "ε0": aco.explore, "ξ": aco.xi, "τ0": aco.tau0, "τ within": [aco.low, aco.high],
            "ants and iterations per way of a run": [20, 20], "vehicles": 8, "service_s": 2.0, "seed": settings.seed,
            "loss_percent_per_s": 1.0, "charge_percent_per_s": 3.0, "charges_below": 0.3, "resumes_at": list(RESUMES),
        }  # fmt: skip


def percent(share: float) -> str:
    """A share in words."""
    return f"{100 * share:.0f} %"


# -- one cell ---------------------------------------------------------------------------------------------------------


def solve_cell(cell: Cell) -> Cell:
    """One map, or one task set."""
    words = [cell["seed"], cell["experiment"], round(1000 * cell.get("density", 0)), cell["map"]]
    rng = np.random.default_rng(np.random.SeedSequence(words))
    if cell["experiment"] == 5:
        return _detours()
    if cell["experiment"] in (3, 4):
        return _task_set(cell, rng)
    instance = single_instance(rng, SIZE, cell["density"])
    graph = instance.graph()
    floor = Floor(graph, xu2025_costs(graph, (1000.0,), {}))
    start, goal = instance.place(instance.starts[0]), instance.place(instance.goals[0])
    ask = _grid if cell["experiment"] == 2 else _colonies
    return ask(floor, start, goal, cell["map"])


def _colonies(floor: Floor, start: int, goal: int, seed: int) -> Cell:
    """Lengths by iteration, lost ants, CPU ms of every colony; A* beside them."""
    _load_kernels()
    steps, ms = _astar(floor, start, goal)
    out: Cell = {"astar": {"steps": steps, "ms": ms}}
    seen = {}
    for name, parameters in COLONIES.items():
        aco = Aco(**parameters)
        begun = process_time()
        found = aco.search(floor, start, goal, seed, trace=True)
        ms = (process_time() - begun) * 1000
        history = [int(n) for n in found.trace["best"]]
        out[name] = {"steps": found.steps, "ms": ms, "best": history, "at": found.found_at,
                     "lost": 100 * found.lost / (aco.ants * aco.iterations)}  # fmt: skip
        seen[name] = (found.places.tolist(), history, found.choices, found.exploited, found.retreats)
    out["identical"] = seen["literal"] == seen["off"]
    return out


def _astar(floor: Floor, start: int, goal: int) -> tuple[int, float]:
    """(steps, CPU ms) of A*; a mean of a few searches, after one that isn't timed."""
    steps = AStar().search(floor, start, goal).cost // 1000
    begun, times = process_time(), 20
    for _ in range(times):
        AStar().search(floor, start, goal)
    return steps, (process_time() - begun) / times * 1000


@cache
def _load_kernels() -> None:
    """Loads the kernels into this process, so that no map's run time holds it."""
    instance = single_instance(np.random.default_rng(0), 6, 0.0)
    graph = instance.graph()
    floor = Floor(graph, xu2025_costs(graph, (1000.0,), {}))
    Aco(ants=2, iterations=2).search(floor, 0, 35, trace=True)


def _grid(floor: Floor, start: int, goal: int, seed: int) -> Cell:
    """Per cent above A* of every combination of the grid, in the order of itertools.product."""
    shortest = _astar(floor, start, goal)[0]
    above = []
    for values in itertools.product(*GRID.values()):
        parameters: dict[str, Any] = dict(zip(GRID, values, strict=True))
        found = Aco(**parameters).search(floor, start, goal, seed)
        above.append([100 * (found.steps / shortest - 1), found.found_at])
    return {"above": above}


def task_set(cell: Cell, rng: np.random.Generator, strict: bool, resume: float = 1.0) -> Scenario:
    """The scenario of a task set, from its own random numbers."""
    name, changes = POLICIES[cell["policy"]]
    many = cell["experiment"] == 4
    drawn = rng.integers(1, 19, (MANY_ORDERS if many else ORDERS, 2)).tolist()
    return load(
        name,
        {
            **changes, "floor.occupancy": "mapf", "dispatch.policy": "in-turn", "planner.name": "soochow-table",
            "planner.parameters": {"strict_thesis": strict}, "orders.pairs": drawn, "seed": cell["map"],
            "charging.sufficient": resume, "time.until_s": float(MANY_UNTIL_S if many else UNTIL_S),
        },
    )  # fmt: skip


def _task_set(cell: Cell, rng: np.random.Generator) -> Cell:
    """The same tasks under the table as described, and corrected; in experiment 4 with both levels of resuming."""
    out = {}
    state = rng.bit_generator.state
    for (side, strict), resume in itertools.product(SIDES.items(), RESUMES if cell["experiment"] == 4 else RESUMES[:1]):
        rng.bit_generator.state = state
        out[f"{side} {resume:g}"] = run_of(task_set(cell, rng, strict, resume))
    return out


def run_of(scenario: Scenario) -> Cell:
    """One run to its end: what the judge counts by rule, whether and when everything was done, the battery."""
    log = MemoryLog()
    sim = build(scenario, recorder=log)
    begun = process_time()
    sim.advance(int(scenario.time.until_s or 0))
    ms = (process_time() - begun) * 1000
    sim.flush()
    found: dict[str, int] = {}
    for breach in judge(log, scenario, sim.world):
        found[str(breach.kind)] = found.get(str(breach.kind), 0) + 1
    motions, charge = log.table("motions"), log.table("battery")["charge_mc"] / sim.parts.battery.capacity_mc
    status = log.table("plans")["status"]
    return {
        "breaches": found, "done": bool(sim.done), "s": sim.tick * sim.tick_s, "orders": sim.metrics()["orders_done"],
        "no_way": int((np.asarray(status) == "no path").sum()), "lowest": float(charge.min()),
        "empty": int((sim.fleet.charge <= 0).sum() if not sim.open_loop else len(set(_empty(log)))),
        "charges": int((motions["kind"] == Activity.CHARGE).sum()), "ms": ms,
    }  # fmt: skip


def _empty(log: MemoryLog) -> list[int]:
    """Vehicles that were ever empty."""
    battery = log.table("battery")
    return [int(v) for v in battery["vehicle"][battery["charge_mc"] <= 0]]


def _detours() -> Cell:
    """Steps between all ordered pairs of stations under each policy."""
    out: Cell = {}
    for policy, (name, changes) in POLICIES.items():
        world = build_world(load(name, changes))
        at = np.array([s.place for s in world.stations], np.int32)
        apart = one_way.steps_between(world.graph, at)[~np.eye(len(at), dtype=np.bool_)]
        out[policy] = {
            "steps": [int(n) for n in apart], "connected": one_way.strongly_connected(world.graph),
            "both_ways": len(one_way.both_ways(world.graph)),
        }  # fmt: skip
    return out


# -- the table --------------------------------------------------------------------------------------------------------

Cases = dict[tuple[int, Any], list[Cell]]


def above(result: Cell, name: str) -> float:
    """Per cent by which a colony's way is longer than the shortest; infinite without a way."""
    steps = result[name]["steps"]
    return float(100 * (steps / result["astar"]["steps"] - 1)) if steps >= 0 else float("inf")


def _length_rows(of: Cases) -> list[Row]:
    rows = []
    for (e, density), results in of.items():
        if e != 1:
            continue
        case = percent(density)
        for name in COLONIES:
            reached = [r for r in results if r[name]["steps"] >= 0]
            none = len(results) - len(reached)
            note = f"no way on {none} of {len(results)} maps" if none else ""
            longer = [above(r, name) for r in reached]
            rows.append(row(1, f"longer than A*: {WORDS[name]}", case, longer, note=note))
        for name in ("classic", "exponent", "discard"):
            rows.append(row(1, f"ants lost: {WORDS[name]}", case, [r[name]["lost"] for r in results]))
        same = [100.0 * r["identical"] for r in results]
        rows.append(
            row(1, "maps on which the printed inducement changes nothing", case, same, note="claimed: it guides")
        )
        slower = [r["exponent"]["ms"] / r["astar"]["ms"] for r in results]
        rows.append(row(1, "CPU time over that of A*: improved", case, slower, None, "times", "claimed: less cost"))
    return rows


def _grid_means(of: Cases) -> tuple[list[tuple[float, ...]], Any]:
    """(combinations, (n, 2) means of per cent above A* and of the iteration that found the best)."""
    found = np.array([r["above"] for (e, _), results in of.items() if e == 2 for r in results])
    return list(itertools.product(*GRID.values())), found.mean(axis=0)


def _grid_rows(of: Cases) -> list[Row]:
    results = [r for (e, _), found in of.items() if e == 2 for r in found]
    combinations, means = _grid_means(of)
    order = np.lexsort((means[:, 1], means[:, 0]))
    rows = []
    for word, at in (("the best", int(order[0])), ("the worst", int(order[-1]))):
        values = [r["above"][at][0] for r in results]
        rows.append(row(2, f"longer than A*: {word} of {len(combinations)} settings", named(combinations[at]), values))
    return rows


def named(values: Sequence[float]) -> str:
    """A setting in letters."""
    return ", ".join(f"{GRID_LETTERS[name]} {value:g}" for name, value in zip(GRID, values, strict=True))


def collisions(run: Cell) -> int:
    """Breaches that are two vehicles meeting."""
    return sum(run["breaches"].get(str(kind), 0) for kind in COLLISIONS)


def _run_rows(of: Cases) -> list[Row]:
    rows = []
    for (e, policy), results in of.items():
        if e != 3:
            continue
        for side in SIDES:
            runs = [r[f"{side} 1"] for r in results]
            claim = 0.0 if side == "as described" else None
            hit = [100.0 * (collisions(r) > 0) for r in runs]
            rows.append(row(3, f"task sets with a collision: {side}", policy, hit, claim))
            each = [float(collisions(r)) for r in runs]
            rows.append(row(3, f"collisions per task set: {side}", policy, each, claim, "collisions"))
            done = [100.0 * r["done"] for r in runs]
            rows.append(row(3, f"task sets done: {side}", policy, done, 100.0 if claim is not None else None))
            times = [r["s"] for r in runs if r["done"]]
            rows.append(row(3, f"time until all are home: {side}", policy, times, None, "s", "of those done"))
            refused = [float(r["no_way"]) for r in runs]
            rows.append(row(3, f"plans refused for want of a way: {side}", policy, refused, None, "plans"))
    return rows


def _battery_rows(of: Cases) -> list[Row]:
    rows = []
    results = [r for (e, _), found in of.items() if e == 4 for r in found]
    for side, resume in itertools.product(SIDES, RESUMES):
        runs, case = [r[f"{side} {resume:g}"] for r in results], f"resume at {percent(resume)}"
        rows.append(row(4, f"task sets with an empty vehicle: {side}", case, [100.0 * (r["empty"] > 0) for r in runs]))
        rows.append(row(4, f"lowest charge: {side}", case, [100 * r["lowest"] for r in runs]))
        rows.append(row(4, f"task sets done: {side}", case, [100.0 * r["done"] for r in runs]))
        times = [r["s"] for r in runs if r["done"]]
        rows.append(row(4, f"time until all are home: {side}", case, times, None, "s", "of those done"))
        rows.append(row(4, f"stays at a charger: {side}", case, [float(r["charges"]) for r in runs], None, "stays"))
    return rows


def _detour_rows(of: Cases) -> list[Row]:
    found = of[5, ""][0]
    rows = []
    for policy in ("one-way lanes", "one-way ways"):
        note = f"strongly connected; {found[policy]['both_ways']} ways are still driven in both directions"
        for base in ("four directions", "eight directions"):
            more = [float(a - b) for a, b in zip(found[policy]["steps"], found[base]["steps"], strict=True)]
            claim = 1.0 if base == "eight directions" else None
            rows.append(row(5, f"steps beyond {base}", policy, more, claim, "steps", note))
    return rows


# -- figures ----------------------------------------------------------------------------------------------------------


def _figures(of: Cases) -> list[Figure]:
    return [
        _convergence(of), _lengths(of), _times(of), _grid_table(of), _collision_bars(of), _done_bars(of), _charges(of),
        _detour_histogram(of),
    ]  # fmt: skip


def _convergence(of: Cases) -> Figure:
    """Mean length of the best way so far, by iteration."""
    results = of[1, PICTURED]
    series = []
    for name in COLONIES:
        shown = [r for r in results if r[name]["steps"] >= 0]
        curves = np.array([np.array(r[name]["best"], np.float64) / r["astar"]["steps"] for r in shown])
        if not len(curves):
            continue
        curves[curves < 0] = np.nan
        y = [round(float(value), 2) for value in 100 * (np.nanmean(curves, axis=0) - 1)]
        style = {"style": "dash"} if name == "off" else {}
        series.append({"name": WORDS[name], "x": list(range(1, len(y) + 1)), "y": y, **style})
    note = (
        "Means over the maps of the best way so far. As printed and without inducement lie on each other: it cancels."
    )
    data = {"series": series, "x_title": "iteration", "y_title": "longer than A*, %", "note": note}
    return Figure("convergence", f"Convergence, {percent(PICTURED)} obstacles", "lines", data)


def _by_density(of: Cases, value: Any, names: Sequence[str]) -> list[dict[str, Any]]:
    cases = [(percent(density), results) for (e, density), results in of.items() if e == 1]
    return [
        {"name": WORDS[name], "x": [case for case, _ in cases], "y": [value(found, name) for _, found in cases]}
        for name in names
    ]


def _lengths(of: Cases) -> Figure:
    def mean(results: Sequence[Cell], name: str) -> float:
        found = [above(r, name) for r in results if r[name]["steps"] >= 0]
        return float(np.mean(found)) if found else float("nan")

    data = {"series": _by_density(of, mean, list(COLONIES)), "x_title": "obstacles", "y_title": "longer than A*, %",
            "note": "Means of the best ways at the end."}  # fmt: skip
    return Figure("lengths", "Length of the ways against A*, by density", "bars", data)


def _times(of: Cases) -> Figure:
    def median(results: Sequence[Cell], name: str) -> float:
        return float(np.median([r[name]["ms"] for r in results]))

    series = _by_density(of, median, ["classic", "exponent", "astar"])
    note = "Medians of one process, kernels compiled: 30 ants, 40 iterations; one search of A*."
    data = {"series": series, "x_title": "obstacles", "y_title": "CPU time, ms", "log_y": True, "note": note}
    return Figure("times", "CPU time of one way", "lines", data)


def _grid_table(of: Cases) -> Figure:
    combinations, means = _grid_means(of)
    order = np.lexsort((means[:, 1], means[:, 0]))[:10].tolist()
    rows = [
        [*combinations[i], round(float(means[i, 0]), 2), round(float(means[i, 1]), 1)] for i in order
    ]  # fmt: skip
    columns = [*GRID_LETTERS.values(), "longer than A*, %", "found in iteration"]
    note = f"The best ten of {len(combinations)} settings: mean length, then mean iteration that found the best way."
    return Figure("grid", "Grid search", "table", {"columns": columns, "rows": rows, "note": note})


def _collision_bars(of: Cases) -> Figure:
    series = []
    for kind in COLLISIONS:
        means = []
        for (e, _), results in of.items():
            if e == 3:
                means.append(float(np.mean([r["as described 1"]["breaches"].get(str(kind), 0) for r in results])))
        series.append({"name": str(kind), "x": list(POLICIES), "y": means})
    corrected = [
        float(np.mean([collisions(r["corrected 1"]) for r in results])) for (e, _), results in of.items() if e == 3
    ]
    series.append({"name": "corrected, all kinds", "x": list(POLICIES), "y": corrected})
    data = {"series": series, "x_title": "policy", "y_title": "collisions per task set",
            "note": "As described by the thesis, by kind; the corrected table beside it."}  # fmt: skip
    return Figure("collisions", "Collisions by policy", "bars", data)


def _done_bars(of: Cases) -> Figure:
    series = []
    for side in SIDES:
        y = [
            100 * float(np.mean([r[f"{side} 1"]["done"] and not collisions(r[f"{side} 1"]) for r in results]))
            for (e, _), results in of.items()
            if e == 3
        ]
        series.append({"name": side, "x": list(POLICIES), "y": y})
    data = {"series": series, "x_title": "policy", "y_title": "task sets, %",
            "note": "All tasks done, everybody home, and nobody met on the way."}  # fmt: skip
    return Figure("done", "Task sets done without a collision", "bars", data)


def _charges(of: Cases) -> Figure:
    results = [r for (e, _), found in of.items() if e == 4 for r in found]
    series = [
        {"name": f"{side}, resume at {percent(resume)}",
         "values": [round(100 * r[f"{side} {resume:g}"]["lowest"], 1) for r in results]}
        for side, resume in itertools.product(SIDES, RESUMES)
    ]  # fmt: skip
    data = {"series": series, "x_title": "lowest charge of a task set, %",
            "note": "Below zero a vehicle would have stopped on the way."}  # fmt: skip
    return Figure("charges", f"The lowest charge over {MANY_ORDERS} tasks", "histogram", data)


def _detour_histogram(of: Cases) -> Figure:
    found = of[5, ""][0]
    series = [
        {"name": policy, "values": [a - b for a, b in zip(found[policy]["steps"], found["eight directions"]["steps"],
                                                           strict=True)]}
        for policy in ("four directions", "one-way lanes", "one-way ways")
    ]  # fmt: skip
    data = {"series": series, "x_title": "steps beyond eight directions",
            "note": "Between all ordered pairs of the 18 stations. The thesis: at most one step."}  # fmt: skip
    return Figure("detours", "What one-way lanes cost", "histogram", data)
