"""Wang et al. 2019: distances, times, a schedule and routes of two robots with four orders, and A* by four heuristics.

Experiments 1 to 5 work the paper's tables out again: what it prints, what its formulas give, and where they differ.
Experiment 6 goes beyond it: larger floors, more robots and orders. Times of the case are exact, in sixths of a second.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations, product
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.build import DISPATCHERS, build, costs_of
from engine.dispatch.insertion import insertion
from engine.dispatch.makespan import makespan
from engine.dispatch.schedule import Schedule, Work, by_rule
from engine.planners.astar import AStar
from engine.planners.connected import ADMISSIBLE, Ground, ground_of, search
from engine.planners.single import Floor
from engine.results.runlog import MemoryLog
from engine.scenario import load, parse
from engine.scenario.movingai import Instance, random_floor
from engine.sim.judge import judge, judge_plan
from engine.studies.base import Cell, Figure, Progress, Result, Row, Settings, row, run_cells
from engine.types import OrderState
from engine.world import GridWorld, build_world

ROBOTS = {"W1": (8, 13), "W2": (17, 6)}
"""Printed; the second is printed as another W1."""
ORDERS = {"K1": (9, 11), "K2": (18, 8), "K3": (5, 7), "K4": (22, 15)}
EXITS = {"B1": (1, 9), "B2": (26, 9)}
PICKED_AT = {"K1": (8, 11), "K2": (19, 8), "K3": (5, 6), "K4": (22, 16)}
"""The cells whose distances are those of table 3: there is no other for any of them."""
BESIDE = {**PICKED_AT, "K4": (22, 14)}
"""Aisle cells where they can be picked: (22, 16) is a rack."""
SPEED_MPS, PICK_S, DROP_S = 1.5, 7.5, 6.0
UNIT_S = 1 / 6
"""All times of the case are whole multiples of this."""

TABLE_1 = {
    "manhattan": (45, 15, 14.0),
    "euclidean": (60, 15, 14.0),
    "chebyshev": (64, 15, 14.0),
    "octile": (39, 10, 11.0),
}
"""Heuristic → expanded, nodes of the path, length."""
TABLE_3 = {
    "W1": (2, 16, 10, 17), "W2": (14, 4, 12, 15),
    "B1": (9, 19, 7, 28), "B2": (20, 8, 24, 11),
}  # fmt: skip
TABLE_4 = {
    "W1": (8.8, 18.2, 14.2, 18.8), "W2": (16.8, 10.2, 15.5, 17.5),
    "B1": (12.0, 18.6, 10.7, 24.6), "B2": (19.3, 11.3, 22.0, 13.3),
}  # fmt: skip
PRINTED_S = {"W1": 42.2, "W2": 48.1}
PRINTED_M = {"W1": 21.0, "W2": 23.3}
PLAN = {"W1": ("K1", "B1", "K3", "B1"), "W2": ("K2", "B2", "K4", "B2")}
"""The paper's schedule."""

SIDE, DENSITY = 10, 0.15
START, GOAL = (0, 2), (9, 7)
"""Nine columns and five rows apart: the least lengths are 14 with four neighbours and 11.07 with eight."""
LARGE = (64, 256)
MODES: dict[str, tuple[int, bool]] = {
    "4 neighbours": (4, False),
    "8 neighbours": (8, False),
    "8, corners cut": (8, True),
}
WORDS = {"manhattan": "Manhattan", "euclidean": "Euclidean", "chebyshev": "Chebyshev", "octile": "octile"}
EXACT = ((2, 8), (3, 6), (3, 8))
"""Robots and orders of the exact program's random instances."""
MANY = ((10, 100), (30, 300), (100, 1000))
"""Of insertion's."""
NODES, ROUNDS = 20_000, 3000

NOTES = (
    "Table 1: a path of 15 nodes and length 14 has four neighbours per cell, one of 10 nodes and length 11 has eight. "
    "The paper compares three heuristics on the one with a fourth on the other. On the same grid every admissible "
    "heuristic finds the same length: 20 % is what diagonals save, not what the octile distance saves.",
    "The paper's map is lost. Ours are random ones of 10 × 10 cells with 15 % obstacles, between cells nine columns "
    "and five rows apart, where the least lengths are 14 and 4 + 5√2 = 11.07. Obstacles lengthen "
    "some. Its numbers are of one map, ours are means: beside them stands where 95 % of the maps lie.",
    "Table 3: every printed distance differs by one metre from the Manhattan distance of the printed coordinates. All "
    "16 are the distances to a cell beside each rack instead; for K4 to (22, 16), which is a rack itself.",
    "Table 4 follows from table 3 at 1.5 m/s with 7.5 s to pick and 6 s to unload; 18.67 and 24.67 s are cut off, all "
    "others are rounded.",
    "T1 and T2: the way from the exit to the second order is charged with the time of the way back, 6 s to unload "
    "included, instead of 7.5 s to pick. That is 1.5 s too little for each robot.",
    "The schedule is right all the same: of all 1920 none is done sooner. The rule that finds it is not exact.",
    "F1 and F2 aren't the lengths behind T1 and T2: those are Manhattan, 25 and 34 m. F1 is near the octile distance "
    "of the printed coordinates; F2 is no length that we found.",
    "On the floor of the scenario `wang2019` robots keep right and drive into the rack's cell to pick: the ways are "
    "longer than on free cells. Those rows are driven, with both robots on the floor, and judged.",
    "The printed seconds of table 1 (12 to 29 s for a hundred cells) are no times of a search; ours take microseconds.",
)  # fmt: skip


# -- the case ---------------------------------------------------------------------------------------------------------


def units(metres: float, service_s: float) -> int:
    """A way and a service in sixths of a second."""
    return round((metres / SPEED_MPS + service_s) / UNIT_S)


def manhattan(a: tuple[int, int], b: tuple[int, int]) -> int:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def octile(a: tuple[int, int], b: tuple[int, int]) -> float:
    """Eq. 12, with its bars where they belong."""
    diagonal, straight = min(abs(a[0] - b[0]), abs(a[1] - b[1])), manhattan(a, b)
    return float(2**0.5 * diagonal + (straight - 2 * diagonal))


def distances(orders: Mapping[str, tuple[int, int]] = ORDERS) -> dict[str, tuple[int, ...]]:
    """Manhattan distances from robots and exits to orders, as table 3 lists them."""
    return {name: tuple(manhattan(at, to) for to in orders.values()) for name, at in {**ROBOTS, **EXITS}.items()}


def case(table: Mapping[str, Sequence[float]] = TABLE_3) -> Work:
    """The case as work in sixths of a second: picking belongs to the way to an order."""
    first = [[units(d, PICK_S) for d in table[name]] for name in ROBOTS]
    back = [[units(d, PICK_S) for d in table[name]] for name in EXITS]
    carry = [[units(table[name][i], DROP_S) for name in EXITS] for i in range(len(ORDERS))]
    return Work(*(np.array(a, np.int64) for a in (first, carry, back)))


def every_schedule(work: Work) -> Iterator[tuple[int, ...]]:
    """When each robot is done, for every way to deal out, sequence and bring out the orders: 1920 for the case."""
    n, exits = len(work.carry), range(len(work.back))
    for sequence in permutations(range(n)):
        for cut in range(n + 1):
            for leave in product(exits, repeat=n):
                ends = []
                for r, part in enumerate((range(cut), range(cut, n))):
                    clock, at = 0, -1
                    for k in part:
                        i = sequence[k]
                        clock += int(work.first[r, i] if at < 0 else work.back[at, i]) + int(work.carry[i, leave[k]])
                        at = leave[k]
                    ends.append(clock)
                yield tuple(ends)


def literal_s(robot: str) -> float:
    """The paper's sum: legs of table 4, the way to the second order charged as the way back from it."""
    orders, one, other = list(ORDERS), PLAN[robot][:2], PLAN[robot][2:]
    legs = [TABLE_4[robot][orders.index(one[0])], TABLE_4[one[1]][orders.index(one[0])]]
    legs += [TABLE_4[one[1]][orders.index(other[0])], TABLE_4[other[1]][orders.index(other[0])]]
    return round(sum(legs), 1)


def planned(work: Work, plan: Mapping[str, Sequence[str]] = PLAN) -> tuple[int, ...]:
    """When each robot is done with a plan such as PLAN."""
    orders, exits, ends = list(ORDERS), list(EXITS), []
    for r, robot in enumerate(ROBOTS):
        clock, at = 0, -1
        for order, leave in zip(plan[robot][::2], plan[robot][1::2], strict=True):
            i, e = orders.index(order), exits.index(leave)
            clock += int(work.first[r, i] if at < 0 else work.back[at, i]) + int(work.carry[i, e])
            at = e
        ends.append(clock)
    return tuple(ends)


def seconds(time: float) -> float:
    """Sixths of a second in seconds, as printed."""
    return round(time * UNIT_S, 2)


# -- the study --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Wang2019:
    """All tables of the paper, and what lies beyond."""

    @property
    def name(self) -> str:
        return "wang2019"

    @property
    def title(self) -> str:
        return "Dispatch of two robots, and four heuristics of A*"

    @property
    def paper(self) -> str:
        return "Wang, Liu & Wang 2019, task scheduling and path optimization by improved A*"

    @property
    def experiments(self) -> Mapping[int, str]:
        return {
            1: "Table 1: heuristics and connectivity of A*, 10 × 10, 15 % obstacles",
            2: "Table 3: distances of the case",
            3: "Table 4: times of its legs",
            4: "The case: who takes which order, and when all are done",
            5: "The routes of the case",
            6: "Beyond the paper: large floors, many robots and orders",
        }

    @property
    def maps(self) -> tuple[int, int]:
        return 20, 200

    def cells(self, settings: Settings) -> list[Cell]:
        """Every map of every case as plain values."""
        maps = settings.maps or self.maps[not settings.quick]
        few = max(1, min(5, maps // 20))
        cells: list[Cell] = [{"experiment": 4, "kind": "case", "what": "the case on its floor"}]
        cells += [
            {"experiment": 1 if size == SIDE else 6, "kind": "grid", "size": size, "map": number,
             "what": f"A* on {size} × {size}, map {number + 1}"}
            for size in (SIDE, *LARGE)
            for number in range(maps if size == SIDE else min(maps, 2 * few))
        ]  # fmt: skip
        cells += [
            {"experiment": 6, "kind": kind, "robots": robots, "orders": orders, "map": number,
             "what": f"{kind}, {robots} robots and {orders} orders, {number + 1}"}
            for kind, sizes in (("exact", EXACT), ("insertion", MANY))
            for robots, orders in sizes
            for number in range(few)
        ]  # fmt: skip
        return [{**cell, "seed": settings.seed} for cell in cells]

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        """All experiments. Raises Ended."""
        cells = self.cells(settings)
        results = run_cells(solve_cell, cells, settings, progress, jobs)
        done = list(zip(cells, results, strict=True))
        of_case = next(result for cell, result in done if cell["kind"] == "case")
        of_grids = {
            size: [result for cell, result in done if cell["kind"] == "grid" and cell["size"] == size]
            for size in (SIDE, *LARGE)
        }
        of_many: dict[tuple[str, int, int], list[Cell]] = {}
        for cell, result in done:
            if cell["kind"] in ("exact", "insertion"):
                of_many.setdefault((cell["kind"], cell["robots"], cell["orders"]), []).append(result)
        rows = [*_grid_rows(of_grids[SIDE]), *_table_rows(), *_case_rows(of_case), *_route_rows(of_case)]
        rows += [*_large_rows(of_grids), *_many_rows(of_many)]
        return Result(
            self.name, self.title, self.paper, self.experiments, self.one_set(settings), tuple(rows),
            tuple(_figures(of_case, of_grids, of_many)), sum(r["plans"] for r in results),
            sum(r["breaches"] for r in results), NOTES,
        )  # fmt: skip

    def one_set(self, settings: Settings) -> dict[str, Any]:
        """What produced all rows."""
        return {
            "speed_mps": SPEED_MPS, "pick_s": PICK_S, "drop_s": DROP_S, "cell_m": 1.0, "obstacles": DENSITY,
            "tie rule of A*": "fifo", "branch-and-bound nodes at most": NODES, "rounds of local search": ROUNDS,
            "seed": settings.seed,
        }  # fmt: skip


# -- one cell ---------------------------------------------------------------------------------------------------------


def solve_cell(cell: Cell) -> Cell:
    """The case, one map, or one set of robots and orders; each with the number of plans judged and their breaches."""
    if cell["kind"] == "case":
        return _case()
    if cell["kind"] == "grid":
        return _grid(cell)
    rng = np.random.default_rng([cell["seed"], cell["robots"], cell["orders"], cell["map"]])
    work = random_work(rng, cell["robots"], cell["orders"])
    begun = process_time()
    found = makespan(work, NODES) if cell["kind"] == "exact" else insertion(work, ROUNDS)
    return {
        "cpu_s": process_time() - begun, "makespan": found.makespan, "bound": found.bound, "gap": found.gap,
        "rule": by_rule(work).makespan, "nodes": found.nodes, "plans": 0, "breaches": 0,
    }  # fmt: skip


def random_work(rng: np.random.Generator, robots: int, orders: int) -> Work:
    """Robots anywhere and orders at racks of the paper's floor, or of one so much larger that each robot has as much
    room as there; two exits for every two robots, in the west and the east."""
    factor = max(1.0, (robots / 2) ** 0.5)
    width, height = round(26 * factor), round(18 * factor)
    at = rng.integers((1, 1), (width + 1, height + 1), (robots, 2))
    to = rng.integers((3, 3), (width - 1, height - 1), (orders, 2))
    ys = np.linspace(1, height, max(1, robots // 2) + 2)[1:-1].round()
    out = np.array([(x, y) for y in ys for x in (1, width)])

    def time(a: Any, b: Any, service_s: float) -> NDArray[np.int64]:
        far = np.abs(a[:, None] - b).sum(2)
        ticks: NDArray[np.int64] = np.rint((far / SPEED_MPS + service_s) / UNIT_S).astype(np.int64)
        return ticks

    return Work(time(at, to, PICK_S), time(to, out, DROP_S), time(out, to, PICK_S))


def _grid(cell: Cell) -> Cell:
    """Every heuristic on every connectivity of one map, equal f first in, first out."""
    size = cell["size"]
    rng = np.random.default_rng([cell["seed"], size, cell["map"]])
    start, goal = (START, GOAL) if size == SIDE else ((0, 0), (size - 1, size - 1))
    free = random_floor(rng, size, size, DENSITY, [start, goal])
    out: Cell = {"expanded": {}, "length": {}, "nodes": {}, "us": {}, "plans": 0, "breaches": 0}
    graph = Instance("map", free, (), ()).graph()
    for mode, (neighbours, cut) in MODES.items():
        ground = ground_of(free, neighbours, cut)
        ends = (ground.place(*start), ground.place(*goal))
        for heuristic in WORDS:
            begun = process_time()
            found = search(ground, *ends, heuristic)
            key = f"{mode}|{heuristic}"
            out["us"][key] = (process_time() - begun) * 1e6
            out["expanded"][key], out["length"][key] = found.expanded, found.length
            out["nodes"][key] = len(found.places)
            if neighbours == 4:
                out["plans"] += 1
                out["breaches"] += len(judge_plan(graph, [found.places.tolist()], starts=ends[:1], goals=ends[1:]))
            if cell["size"] == SIDE and cell["map"] == 0 and heuristic == "octile":
                out.setdefault("picture", {})[mode] = ground.cells(found.places)
    if "picture" in out:
        out["rows"] = ["".join(".@"[not cell] for cell in line) for line in free.tolist()]
    return out


def _case() -> Cell:
    """The case: every schedule, what the methods find, its routes, and its runs on the floor with keep-right lanes."""
    work = case()
    ends = list(every_schedule(work))
    by_end: dict[int, int] = {}
    for end in ends:
        by_end[max(end)] = by_end.get(max(end), 0) + 1
    found = {
        "the paper's rule": by_rule(work), "insertion": insertion(work, ROUNDS), "exact program": makespan(work, NODES)
    }  # fmt: skip
    out: Cell = {
        "schedules": len(ends), "by_end": sorted(by_end.items()), "planned": list(planned(work)),
        "totals": min(sum(end) for end in ends), "found": {name: _plain(s) for name, s in found.items()},
        "printed_coordinates": list(planned(case(distances()))), "driven": {}, "plans": 0, "breaches": 0,
    }  # fmt: skip
    for policy in DISPATCHERS:
        scenario = parse(load("wang2019").to_toml(), "wang2019", {"dispatch.policy": policy})
        log = MemoryLog()
        sim = build(scenario, recorder=log)
        sim.advance(3000)
        sim.flush()
        table = log.table("orders")
        out["driven"][policy] = round(float(table["tick"][table["state"] == OrderState.DONE].max()) * sim.tick_s, 2)
        out["plans"] += len(log.table("plans")["tick"])
        out["breaches"] += len(judge(log, sim.scenario, sim.world))
    return {**out, **_routes(out)}


def _plain(schedule: Schedule) -> Cell:
    return {"ends": list(schedule.ends), "makespan": schedule.makespan, "bound": schedule.bound}


def _routes(so_far: Cell) -> Cell:
    """The ways of PLAN as cells: on any free cell, by four and eight neighbours, and on the lanes."""
    scenario = load("wang2019")
    world = build_world(scenario)
    assert isinstance(world, GridWorld)
    rows = scenario.floor.drawing()[::-1]
    free = np.array([[letter not in "RS#" for letter in line[1:-1]] for line in rows[1:-1]])
    paths: dict[str, list[list[tuple[int, int]]]] = {}
    metres: dict[str, list[float]] = {}
    for mode, (neighbours, cut) in MODES.items():
        ground = ground_of(free, neighbours, cut)
        paths[mode], metres[mode] = [], []
        for robot in ROBOTS:
            stops = [ROBOTS[robot], *(BESIDE.get(name) or EXITS[name] for name in PLAN[robot])]
            way, length = _along(ground, stops)
            paths[mode].append(way)
            metres[mode].append(length)
    lanes, plans, breaches = _on_lanes(scenario, world)
    paths["lanes, keeping right"] = lanes
    metres["lanes, keeping right"] = [float(len(way) - 1) for way in lanes]
    return {
        "paths": paths, "metres": metres,
        "rows": ["".join("@" if letter in "RS#" else "." for letter in line) for line in rows],
        "plans": so_far["plans"] + plans, "breaches": so_far["breaches"] + breaches,
    }  # fmt: skip


def _along(ground: Ground, stops: Sequence[tuple[int, int]]) -> tuple[list[tuple[int, int]], float]:
    """Cells of the shortest way through stops, both counted from 1, and its length."""
    cells, length = [stops[0]], 0.0
    for a, b in pairwise(stops):
        found = search(ground, ground.place(a[0] - 1, a[1] - 1), ground.place(b[0] - 1, b[1] - 1))
        cells += [(x + 1, y + 1) for x, y in ground.cells(found.places)[1:]]
        length += found.length
    return cells, length


def _on_lanes(scenario: Any, world: GridWorld) -> tuple[list[list[tuple[int, int]]], int, int]:
    """Cells of PLAN's ways on the scenario's floor, into the racks and exits; each leg judged by the one-way rules."""
    floor = Floor(world.graph, costs_of(scenario, world))
    places = {name: world.place_at(*cell) for name, cell in {**ROBOTS, **ORDERS}.items()}
    places |= {name: world.stations[i].place for i, name in enumerate(EXITS)}
    ways, legs, breaches = [], 0, 0
    for robot in ROBOTS:
        cells: list[tuple[int, int]] = []
        for a, b in pairwise([places[name] for name in (robot, *PLAN[robot])]):
            way = AStar().search(floor, a, b)
            visited = world.graph.state_place[way.states].tolist()
            breaches += len(judge_plan(world.graph, [visited], starts=[a], goals=[b]))
            legs += 1
            along = [tuple(cell) for cell in world.cell_of_place[visited].tolist()]
            cells += along[1:] if cells else along
        ways.append(cells)
    return ways, legs, breaches


# -- the table --------------------------------------------------------------------------------------------------------


def _one(
    experiment: int, quantity: str, case_: str, ours: float, paper: float | None = None, unit: str = "s", note: str = ""
) -> Row:
    """A row of one exact number: inside means equal as printed."""
    return row(experiment, quantity, case_, [round(ours, 2)], paper, unit, note)


def less(results: Sequence[Cell], what: str, one: str, other: str) -> list[float]:
    """Percent by which the second key's value lies below the first's, map by map."""
    return [100.0 * (1 - r[what][other] / r[what][one]) for r in results]


def _spread(values: Sequence[float]) -> str:
    """Where most maps lie, since the paper's numbers are of one."""
    low, high = np.percentile(values, (2.5, 97.5))
    return f"95 % of the maps: {low:.0f} to {high:.0f}"


def _grid_rows(results: Sequence[Cell]) -> Iterator[Row]:
    for mode in MODES:
        for name, word in WORDS.items():
            paper = TABLE_1[name] if (mode == "4 neighbours") == (name != "octile") else None
            paper = None if mode == "8, corners cut" else paper
            values = [float(r["expanded"][f"{mode}|{name}"]) for r in results]
            yield row(1, f"cells expanded, {mode}", word, values, paper and paper[0], "cells", _spread(values))
    for mode in MODES:
        for name, word in WORDS.items():
            paper = TABLE_1[name] if (mode == "4 neighbours") == (name != "octile") else None
            paper = None if mode == "8 neighbours" else paper
            values = [r["length"][f"{mode}|{name}"] for r in results]
            note = "may be longer than the shortest" if name not in ADMISSIBLE[MODES[mode][0]] else ""
            yield row(1, f"length, {mode}", word, values, paper and paper[2], "cells", note)
    saved = "length saved by the octile distance over Manhattan"
    yield row(
        1, saved, "4 neighbours both", less(results, "length", "4 neighbours|manhattan", "4 neighbours|octile"), 20.0,
        note="the claim: 20 % by the heuristic",
    )  # fmt: skip
    for mode in list(MODES)[1:]:
        yield row(
            1, "length saved by diagonals, octile both", mode,
            less(results, "length", "4 neighbours|octile", f"{mode}|octile"), 20.0, note="what the 20 % is",
        )  # fmt: skip
    for what, which, printed in (("expansions", "expanded", 0), ("nodes of the path", "nodes", 1)):
        for name in ("manhattan", "euclidean", "chebyshev"):
            printed_share = 100 * (1 - TABLE_1["octile"][printed] / TABLE_1[name][printed])
            yield row(
                1, f"{what} saved, compared as the paper does", f"octile over {WORDS[name]}",
                less(results, which, f"4 neighbours|{name}", "8, corners cut|octile"), round(printed_share, 1),
                note="octile with 8 neighbours, corners cut, against 4; the paper's from its table 1",
            )  # fmt: skip
    for name in ("euclidean", "chebyshev"):
        yield row(
            1, "expansions saved by the octile distance, 8 neighbours both", f"over {WORDS[name]}",
            less(results, "expanded", f"8 neighbours|{name}", "8 neighbours|octile"),
        )  # fmt: skip


def _table_rows() -> Iterator[Row]:
    for quantity, orders, note in (
        ("Manhattan distance of the printed coordinates", ORDERS, ""),
        ("distance to the cells of the orders that table 3 has", PICKED_AT, ""),
    ):
        found = distances(orders)
        for name, line in TABLE_3.items():
            for i, order in enumerate(ORDERS):
                yield _one(2, quantity, f"{name}–{order}", found[name][i], line[i], "m", note)
    for name, times in TABLE_4.items():
        service = PICK_S if name in ROBOTS else DROP_S
        for i, order in enumerate(ORDERS):
            exact = TABLE_3[name][i] / SPEED_MPS + service
            cut = times[i] != round(exact, 1)
            yield row(
                3, "time of a leg from table 3", f"{name}→{order}" if name in ROBOTS else f"{order}→{name}",
                [round(exact, 1)], times[i], "s", f"{exact:.2f}, cut off in print" if cut else "",
            )  # fmt: skip


def _case_rows(result: Cell) -> Iterator[Row]:
    for r, robot in enumerate(ROBOTS):
        printed = PRINTED_S[robot]
        yield _one(4, f"{robot} is done, by the paper's arithmetic", "table 4", literal_s(robot), printed)
        note = "the paper counts 6 s for the second pick"
        yield _one(4, f"{robot} is done", "table 3", seconds(result["planned"][r]), printed, note=note)
        yield _one(4, f"{robot} is done", "printed coordinates", seconds(result["printed_coordinates"][r]), printed)
    ends = result["by_end"]
    yield _one(4, "least makespan", f"all {result['schedules']} schedules", seconds(ends[0][0]), PRINTED_S["W2"],
               note="the paper's schedule has it, its sum is wrong")  # fmt: skip
    yield _one(4, "runner-up", f"all {result['schedules']} schedules", seconds(ends[1][0]))
    for name, found in result["found"].items():
        gap = (found["makespan"] - found["bound"]) / found["makespan"]
        words = f"at most {100 * gap:.1f} % above the least" if gap else "proven least"
        yield _one(4, "makespan found", name, seconds(found["makespan"]), note=words)
    for policy, driven in result["driven"].items():
        note = "the exit stays as ordered" if policy == "nearest" else ""
        yield _one(4, "all orders brought, driven on the lanes", policy, driven, note=note)


def _route_rows(result: Cell) -> Iterator[Row]:
    for r, robot in enumerate(ROBOTS):
        stops = [ROBOTS[robot], *(ORDERS.get(name) or EXITS[name] for name in PLAN[robot])]
        far = sum(octile(a, b) for a, b in pairwise(stops))
        printed = PRINTED_M[robot]
        quantity = f"length of {robot}'s route"
        yield _one(5, quantity, "octile distance of the printed coordinates", far, printed, "m")
        beside = [ROBOTS[robot], *(PICKED_AT.get(name) or EXITS[name] for name in PLAN[robot])]
        straight = sum(manhattan(a, b) for a, b in pairwise(beside))
        yield _one(5, quantity, "Manhattan, table 3", straight, printed, "m", "what its time counts")
        for mode, metres in result["metres"].items():
            on_lanes = mode not in MODES
            yield _one(5, quantity, mode, metres[r], None if on_lanes else printed, "m")


def _large_rows(of: Mapping[int, Sequence[Cell]]) -> Iterator[Row]:
    for size in LARGE:
        for mode in list(MODES)[1:]:
            values = less(of[size], "length", "4 neighbours|octile", f"{mode}|octile")
            yield row(6, "length saved by diagonals, octile both", f"{size} × {size}, {mode}", values)
    for size in LARGE:
        for name in ("euclidean", "chebyshev"):
            values = less(of[size], "expanded", f"8 neighbours|{name}", "8 neighbours|octile")
            case_ = f"{size} × {size}, over {WORDS[name]}"
            yield row(6, "expansions saved by the octile distance, 8 neighbours", case_, values)
    for size in LARGE:
        values = less(of[size], "length", "8 neighbours|octile", "8 neighbours|manhattan")
        yield row(6, "length lost by Manhattan, 8 neighbours", f"{size} × {size}", [-value for value in values])


def _many_rows(of: Mapping[tuple[str, int, int], Sequence[Cell]]) -> Iterator[Row]:
    word = {"exact": "exact program", "insertion": "insertion"}
    for (kind, robots, orders), results in of.items():
        gaps = [100.0 * r["gap"] for r in results]
        yield row(6, f"gap to the lower bound, {word[kind]}", f"{robots} robots, {orders} orders", gaps)
    for (kind, robots, orders), results in of.items():
        worse = [100.0 * (r["rule"] / r["makespan"] - 1) for r in results]
        yield row(6, f"the paper's rule takes longer than {word[kind]}", f"{robots} robots, {orders} orders", worse)
    for (kind, robots, orders), results in of.items():
        times = [r["cpu_s"] for r in results]
        yield row(6, f"CPU time, {word[kind]}", f"{robots} robots, {orders} orders", times, unit="s")


# -- figures ----------------------------------------------------------------------------------------------------------


def _figures(
    of_case: Cell, of_grids: Mapping[int, Sequence[Cell]], of_many: Mapping[tuple[str, int, int], Sequence[Cell]]
) -> list[Figure]:
    return [_gantt(), _all_schedules(of_case), _route_map(of_case), *_matrices(of_grids), *_example(of_grids[SIDE])]


def _gantt() -> Figure:
    """The case leg by leg, in the correct arithmetic and in the paper's."""
    bars = []
    orders = list(ORDERS)
    for robot in ROBOTS:
        for wrong in (False, True):
            clock, table = 0.0, robot
            for k, (order, leave) in enumerate(zip(PLAN[robot][::2], PLAN[robot][1::2], strict=True)):
                i = orders.index(order)
                pick = DROP_S if wrong and k else PICK_S
                legs = (
                    ("to the order", TABLE_3[table][i] / SPEED_MPS), ("pick", pick),
                    ("to the exit", TABLE_3[leave][i] / SPEED_MPS), ("unload", DROP_S),
                )  # fmt: skip
                for name, lasts in legs:
                    line = f"{robot}, as printed" if wrong else robot
                    bars.append({"row": line, "begin": round(clock, 3), "end": round(clock + lasts, 3), "name": name})
                    clock += lasts
                table = leave
    note = (
        "W1: K1 to B1, then K3 to B1. W2: K2 to B2, then K4 to B2. As printed, the second pick lasts 6 s instead of "
        "7.5 s; the printed sums add rounded legs, so they end at 42.2 and 48.1 s."
    )
    return Figure("schedule", "The schedule of the case", "gantt", {"bars": bars, "x_title": "s", "note": note})


def _all_schedules(result: Cell) -> Figure:
    values = [seconds(end) for end, count in result["by_end"] for _ in range(count)]
    best, second = result["by_end"][:2]
    note = (
        f"Makespans of all {result['schedules']} ways to assign, sequence and bring out the four orders. "
        f"The least, {seconds(best[0]):.2f} s, is that of {best[1]}; then comes {seconds(second[0]):.2f} s."
    )
    data = {"series": [{"name": "schedules", "values": values}], "x_title": "makespan, s", "note": note}
    return Figure("schedules", "Every schedule of the case", "histogram", data)


def _route_map(result: Cell) -> Figure:
    captions = {
        name: f"{name}: {metres[0]:.2f} and {metres[1]:.2f} m" for name, metres in result["metres"].items()
    }  # fmt: skip
    data = {
        "rows": result["rows"], "paths": result["paths"], "captions": captions,
        "note": "Vehicle 1 is W1, vehicle 2 is W2. Coordinates as printed, from 1; the outermost cells are the wall. "
        "On lanes they drive into the racks and exits, elsewhere to the aisle cell beside them.",
    }  # fmt: skip
    return Figure("figure-7", "Figure 7: both routes", "floor", data)


def _matrices(of: Mapping[int, Sequence[Cell]]) -> Iterator[Figure]:
    columns = [
        "connectivity",
        "heuristic",
        "expanded",
        "length",
        "nodes of the path",
        "admissible",
        "longer than shortest",
    ]
    for size, results in of.items():
        lines: list[list[Any]] = []
        for mode, (neighbours, _) in MODES.items():
            shortest = [r["length"][f"{mode}|octile"] for r in results]
            for name, word in WORDS.items():
                key = f"{mode}|{name}"
                longer = sum(r["length"][key] > s + 1e-9 for r, s in zip(results, shortest, strict=True))
                means = [float(np.mean([r[what][key] for r in results])) for what in ("expanded", "length", "nodes")]
                said = "yes" if name in ADMISSIBLE[neighbours] else "no"
                share = f"{longer} of {len(results)}"
                lines.append([mode, word, *(round(mean, 2) for mean in means), said, share])
        note = f"Means of {len(results)} maps with 15 % obstacles; equal f first in, first out."
        title = f"Connectivity × heuristic, {size} × {size}"
        yield Figure(f"matrix-{size}", title, "table", {"columns": columns, "rows": lines, "note": note})
    series = [
        {"name": mode, "x": list(WORDS.values()),
         "y": [float(np.mean([r["length"][f"{mode}|{name}"] for r in of[SIDE]])) for name in WORDS]}
        for mode in MODES
    ]  # fmt: skip
    note = (
        "What decides about the length is the connectivity. The paper compares the first three with the last one cut."
    )
    data = {"series": series, "y_title": "length, cells", "note": note}
    yield Figure("lengths", "Length by heuristic and connectivity, 10 × 10", "bars", data)


def _example(results: Sequence[Cell]) -> Iterator[Figure]:
    found = next((r for r in results if "picture" in r), None)
    if found is not None:
        captions = {
            mode: f"{mode}: {found['length'][f'{mode}|octile']:.2f} cells, {len(way)} nodes"
            for mode, way in found["picture"].items()
        }
        data = {
            "rows": found["rows"], "paths": {mode: [way] for mode, way in found["picture"].items()},
            "captions": captions, "note": "The octile distance each time; the first map.",
        }  # fmt: skip
        yield Figure("figure-5", "Figure 5: one map by each connectivity", "floor", data)
