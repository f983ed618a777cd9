"""`wattlane bench --instances DIR`: the planners on MovingAI instances, with peers beside them in the same run.

CPU time of this process, kernels compiled before, median of at least five calls. A line with a goal says whether it is
met; a line of a peer is a ratio to ours, and a lower bound (≥) where the peer did not finish.
"""

from __future__ import annotations

import csv
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app import bench_peers as peers
from app.bench import Measured, Say, goal_at_least, goal_at_most
from app.settings import use_kernel_cache
from engine.errors import BadInput

if TYPE_CHECKING:
    from engine.planners.oneshot import Limits, Problem, Solution
    from engine.scenario.movingai import Instance

GRIDS = tuple(f"rand20-{density}-{number}" for density in (10, 20, 30) for number in (1, 2, 3))
DENSITIES = (10, 20, 30)
RANDOM, WAREHOUSE, LARGE = "random-32-32-20", "warehouse-10-20-10-2-1", "rand512-20"
MASSES = (2000.0, 2200.0, 2350.0, 2500.0)
"""Kilograms of xu2025's experiment 3."""
CLOSE_S = 10.0
"""CPU seconds within which an instance should close."""
PROVE_S = 2.0
"""CPU seconds for a map of experiment 3."""


class Folder:
    """Instances by name, read once."""

    def __init__(self, path: Path):
        self.path = path
        if not path.is_dir():
            raise BadInput(f"--instances: a folder was expected, got {path}")
        self._known: dict[tuple[str, str], Instance | None] = {}
        if not any(self.get(name, "gen-1") for name in (*GRIDS, RANDOM, WAREHOUSE, LARGE)):
            raise BadInput(
                f"--instances: {path} holds none of the instances measured, such as {RANDOM}.map with "
                f"{RANDOM}-gen-1.scen"
            )

    def get(self, name: str, kind: str, agents: int | None = None) -> Instance | None:
        """An instance, None when it isn't there or has fewer vehicles."""
        from engine.scenario.movingai import read_instance

        key = (name, kind)
        if key not in self._known:
            files = self.path / f"{name}.map", self.path / f"{name}-{kind}.scen"
            self._known[key] = read_instance(*files) if all(file.is_file() for file in files) else None
        found = self._known[key]
        if found is None or agents is None:
            return found
        return found.first(agents) if agents <= found.agents else None


def measure(path: Path, *, quick: bool = False, say: Say = print) -> dict[str, Any]:
    """All goals in order: {"machine": …, "peers": …, "results": [Measured as objects], "rows": details by goal}."""
    first = use_kernel_cache("compiled-bench")
    folder = Folder(path)
    if first:
        say("Compiling kernels, once: this takes up to a minute …")
    known = peers.installed()
    results: list[Measured] = []
    rows: dict[str, Any] = {}
    parts: list[tuple[str, Callable[[], list[Measured]]]] = [
        ("A* on a large grid …", lambda: single(folder, known)),
        ("Optimal costs …", lambda: optimal(folder, rows, quick)),
        ("CBS …", lambda: cbs(folder, known, quick)),
        ("E-CBS on the maps of experiment 3 …", lambda: experiment(10 if quick else 100)),
        ("E-CBS with more vehicles …", lambda: crowds(folder, rows, quick)),
        ("Prioritized planning …", lambda: prioritized(folder, known)),
    ]
    for text, part in parts:
        say(text)
        results += part()
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    return {
        "machine": {**machine, "load": os.getloadavg()[0]}, "peers": known,
        "results": [asdict(one) for one in results], "rows": rows,
    }  # fmt: skip


def cpu_ms(call: Callable[[], Any], times: int = 5, most_s: float = 5.0) -> float:
    """Median CPU time of a call; after `most_s` seconds it isn't called again. Called once before it is measured."""
    call()
    spent: list[float] = []
    while len(spent) < times and sum(spent) < most_s:
        begin = time.process_time()
        call()
        spent.append(time.process_time() - begin)
    return 1000 * statistics.median(spent)


def within(seconds: float) -> Limits:
    """Limits that end after so many CPU seconds."""
    from engine.planners.oneshot import Limits

    end = time.process_time() + seconds
    return Limits(stop=lambda: time.process_time() >= end)


def problem(instance: Instance, heading: str = "east", masses: Sequence[float] = (1000.0,)) -> Problem:
    from engine.planners.problems import problem_of

    return problem_of(instance, heading=heading, masses_kg=masses)


# -- one vehicle ------------------------------------------------------------------------------------------------------


def single(folder: Folder, known: dict[str, str]) -> list[Measured]:
    """Goal 2: plain A* and energy A* over all trips of the large grid."""
    from engine.planners.astar import AStar
    from engine.planners.eea import Eea
    from engine.planners.single import Floor

    instance = folder.get(LARGE, "gen-1")
    if instance is None:
        return []
    floor = Floor(instance.graph(), problem(instance.first(1)).costs)
    ends = [(instance.place(a), instance.place(b)) for a, b in zip(instance.starts, instance.goals, strict=True)]

    def all_by(planner: Any) -> list[Any]:
        return [planner.search(floor, a, b) for a, b in ends]

    found: list[Measured] = []
    plain, ms = [], 0.0
    for tie in ("fifo", "lifo"):
        astar = AStar(tie=tie)
        plain, ms = all_by(astar), cpu_ms(lambda one=astar: all_by(one))  # type: ignore[misc]
        found.append(Measured(f"A*, {tie}, {LARGE}, {len(ends)} queries", ms, "ms"))
        rate = sum(way.expanded for way in plain) / ms / 1000
        found.append(goal_at_least(f"A*, {tie}, over the motion graph", rate, "M exp/s", 25))
    steps = [len(way.states) - 1 for way in plain]
    searches = {
        "networkx": (peers.networkx_astar, 150.0),
        "pyastar2d": (peers.pyastar2d_astar, 4.0),
        "pathfinding": (peers.pathfinding_astar, None),
    }
    for name, (make, goal) in searches.items():
        if name not in known:
            continue
        call = make(instance)
        same = call() == steps
        ratio = cpu_ms(call, times=5 if name == "pyastar2d" else 1, most_s=1.0) / ms
        text = f"A*: {name} takes, in ours by lifo" + ("" if same else " (other costs!)")
        found.append(Measured(text, ratio, "×") if goal is None else goal_at_least(text, ratio, "×", goal))
    closed, table = all_by(Eea(heuristic="closed")), all_by(Eea())
    ms = cpu_ms(lambda: all_by(Eea(heuristic="closed")))
    found.append(Measured(f"energy A*, {LARGE}, {len(ends)} queries", ms, "ms"))
    found.append(goal_at_least("energy A*", sum(way.expanded for way in closed) / ms / 1000, "M exp/s", 7))
    fewer = sum(way.expanded for way in closed) / sum(way.expanded for way in table)
    same = [way.cost for way in closed] == [way.cost for way in table]
    text = "energy A*: expansions saved by the table, equal costs" if same else "energy A*: costs differ!"
    found.append(goal_at_least(text, fewer, "×", 10))
    return found


# -- many vehicles, in time -------------------------------------------------------------------------------------------


def optimal(folder: Folder, rows: dict[str, Any], quick: bool) -> list[Measured]:
    """Goal 1: known optimal sums of costs."""
    from engine.planners.cbs import CBS
    from engine.types import PlanStatus

    file = folder.path / "optimal_costs.csv"
    if not file.is_file():
        return []
    seconds = 2.0 if quick else CLOSE_S
    kept: list[dict[str, Any]] = []
    for name, scen, agents, cost in _optimal_rows(file):
        instance = folder.get(name, scen.removeprefix(f"{name}-").removesuffix(".scen"), agents)
        if instance is None:
            continue
        begin = time.process_time()
        answer = CBS().solve(problem(instance), within(seconds))
        kept.append(
            {
                "scen": scen, "agents": agents, "optimal": cost, "cost": answer.cost, "lower_bound": answer.lower_bound,
                "status": answer.status.value, "cpu_ms": round(1000 * (time.process_time() - begin), 2),
                "closed": answer.status is PlanStatus.SOLVED,
                "asked": "corner" in scen or agents in (8, 12) or (name == RANDOM and agents in (10, 20)),
            }
        )  # fmt: skip
    rows["optimal"] = kept
    differ = sum(row["closed"] and row["cost"] != row["optimal"] for row in kept)
    asked = [row for row in kept if row["asked"]]
    return [
        goal_at_most("optimal costs: rows that differ", differ, "rows", 0),
        Measured(f"optimal costs: rows of {len(kept)} closed in {seconds:g} s", sum(r["closed"] for r in kept), "rows"),
        goal_at_least(
            f"corner, 8, 12 vehicles, {RANDOM} 10 and 20: closed of {len(asked)}",
            sum(row["closed"] for row in asked), "rows", len(asked),
        ),
    ]  # fmt: skip


def _optimal_rows(file: Path) -> Iterator[tuple[str, str, int, int]]:
    with file.open(encoding="utf-8", newline="") as text:
        for at, row in enumerate(csv.DictReader(text), 2):
            try:
                name = str(row["map"]).removesuffix(".map")
                yield name, str(row["scen"]), int(row["agents"]), int(row["optimal_sum_of_costs"])
            except (KeyError, ValueError, TypeError) as error:
                wanted = "map,scen,agents,optimal_sum_of_costs"
                raise BadInput(f"{file.name}, line {at}: {wanted} was expected, got {list(row.values())}") from error


def cbs(folder: Folder, known: dict[str, str], quick: bool) -> list[Measured]:
    """Goal 3: CBS in time by groups of instances, and pymapf on the same."""
    from engine.planners.cbs import CBS

    groups: list[tuple[str, list[Instance | None], float | None]] = [
        *((f"corner-1, {d} %", [folder.get(f"rand20-{d}-{n}", "corner-1") for n in (1, 2, 3)], 0.5) for d in DENSITIES),
        *(
            (f"{k} vehicles, {d} %", [folder.get(f"rand20-{d}-{n}", "gen-1", k) for n in (1, 2, 3)], None)
            for k in (8, 12)
            for d in DENSITIES
        ),
        (f"{RANDOM}, 10", [folder.get(RANDOM, "gen-1", 10)], None),
        (f"{RANDOM}, 20", [folder.get(RANDOM, "gen-1", 20)], 10.0),
        (f"{RANDOM}, 30", [folder.get(RANDOM, "gen-1", 30)], 60.0),
    ]
    found = []
    for text, listed, goal in groups:
        instances = [one for one in listed if one is not None]
        if not instances:
            continue
        each = [_solving(CBS(), problem(one), CLOSE_S) for one in instances]
        ms = [cpu_ms(call, times=5) for call in each]
        median = statistics.median(ms)
        line = f"CBS, {text}"
        found.append(Measured(line, median, "ms") if goal is None else goal_at_most(line, median, "ms", goal))
        if "pymapf" in known and not (quick and instances[0].agents >= 20):
            found.append(_beside_pymapf(text, instances, sum(ms), 5.0 if quick else 20.0))
    if (instance := folder.get(RANDOM, "gen-1", 30)) is not None:
        ms_w = cpu_ms(_solving(CBS(w=1.2), problem(instance), CLOSE_S))
        found.append(goal_at_most(f"CBS, w = 1.2, {RANDOM}, 30", ms_w, "ms", 10))
    return found


def _solving(planner: Any, asked: Problem, seconds: float) -> Callable[[], Solution]:
    return lambda: planner.solve(asked, within(seconds))


def _beside_pymapf(text: str, instances: Sequence[Instance], ours_ms: float, limit_s: float) -> Measured:
    theirs, ended = 0.0, False
    for one in instances:
        call = peers.pymapf_cbs(one, limit_s)
        begin = time.process_time()
        ended |= call() is None
        spent = time.process_time() - begin
        # short calls are repeated, long ones have said what they take
        theirs += 1000 * spent if spent > 0.5 else cpu_ms(call, times=5, most_s=1.0)
    mark = "≥ " if ended else ""
    return goal_at_least(f"CBS, {text}: pymapf takes, in ours {mark}".rstrip(), theirs / ours_ms, "×", 20)


# -- many vehicles, in energy -----------------------------------------------------------------------------------------


def experiment(maps: int) -> list[Measured]:
    """Goal 4, first half: maps of xu2025's experiment 3, drawn as the study draws them."""
    import numpy as np

    from engine.planners.ecbs import ECBS
    from engine.scenario.movingai import corner_instance
    from engine.studies.base import Settings
    from engine.types import PlanStatus

    found, seed = [], Settings().seed
    for percent in DENSITIES:
        ms, proven = [], 0
        for number in range(maps):
            rng = np.random.default_rng(np.random.SeedSequence([seed, 3, 20, 10 * percent, number]))
            asked = problem(corner_instance(rng, 20, percent / 100), "cheapest", MASSES)
            ECBS().solve(asked, within(PROVE_S))  # may be the first to need a kernel
            begin = time.process_time()
            answer = ECBS().solve(asked, within(PROVE_S))
            ms.append(1000 * (time.process_time() - begin))
            proven += answer.status is PlanStatus.SOLVED and ms[-1] <= 1000 * PROVE_S
        text = f"E-CBS, experiment 3, {percent} %"
        found += [
            goal_at_least(f"{text}: proven in {PROVE_S:g} s, of {maps}", proven, "maps", maps),
            goal_at_most(f"{text}: median", statistics.median(ms), "ms", 10),
            Measured(f"{text}: longest", max(ms), "ms"),
        ]
    return found


def crowds(folder: Folder, rows: dict[str, Any], quick: bool) -> list[Measured]:
    """Goal 4, second half: 8 and 12 vehicles on 20 × 20, 20 on the random map; time windows on the same."""
    from engine.planners.ecbs import ECBS
    from engine.planners.oneshot import Limits
    from engine.planners.time_window import TimeWindow
    from engine.types import PlanStatus

    seconds = 2.0 if quick else CLOSE_S
    asked = [(name, k) for name in GRIDS for k in (8, 12)] + [(RANDOM, 20)]
    kept: list[dict[str, Any]] = []
    for name, agents in asked:
        instance = folder.get(name, "gen-1", agents)
        if instance is None:
            continue
        one = problem(instance, "cheapest")
        if not kept:  # what compiling takes is nobody's
            for planner in (TimeWindow(), ECBS()):
                planner.solve(one, Limits(nodes=200))
        windows = TimeWindow().solve(one, within(seconds))
        begin = time.process_time()
        answer = ECBS().solve(one, within(seconds))
        kept.append(
            {
                "map": name, "agents": agents, "status": answer.status.value, "cost": answer.cost,
                "lower_bound": answer.lower_bound, "cpu_ms": round(1000 * (time.process_time() - begin), 2),
                "gap": answer.cost / max(answer.lower_bound, 1) - 1 if answer.states else None,
                "proven": answer.status is PlanStatus.SOLVED,
                "time_window": windows.cost if windows.states else None,
                "worse": bool(windows.states) and (not answer.states or answer.cost > windows.cost),
            }
        )  # fmt: skip
    rows["ecbs"] = kept
    if not kept:
        return []
    good = sum(row["gap"] is not None and row["gap"] <= 0.05 for row in kept)
    widest = max((row["gap"] for row in kept if row["gap"] is not None), default=0.0)
    return [
        goal_at_least(
            f"E-CBS, 8, 12, 20 vehicles: within 1.05 in {seconds:g} s, of {len(kept)}", good, "maps", len(kept)
        ),
        Measured("E-CBS, 8, 12, 20 vehicles: proven optimal", sum(row["proven"] for row in kept), "maps"),
        Measured("E-CBS, 8, 12, 20 vehicles: widest gap", 100 * widest, "%"),
        goal_at_most("E-CBS worse than time windows", sum(row["worse"] for row in kept), "maps", 0),
    ]


def prioritized(folder: Folder, known: dict[str, str]) -> list[Measured]:
    """Goal 5: one pass of prioritized planning."""
    from engine.planners.one_shot_prioritized import OneShotPrioritized

    found = []
    for name, agents, goal in ((RANDOM, 100, 5.0), (WAREHOUSE, 200, 80.0)):
        instance = folder.get(name, "gen-1", agents)
        if instance is None:
            continue
        one = problem(instance)
        answer = OneShotPrioritized().solve(one, within(60))
        ms = cpu_ms(_solving(OneShotPrioritized(), one, 60)) / max(answer.expanded_high, 1)
        found.append(goal_at_most(f"prioritized, {name}, {agents}, a pass", ms, "ms", goal))
        if "cuplan" in known:
            call = peers.cuplan_prioritized(instance)
            found.append(Measured(f"prioritized, {name}: cuplan takes, in ours", cpu_ms(call, 1) / ms, "×"))
    return found
