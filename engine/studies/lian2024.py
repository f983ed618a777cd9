"""Lian et al. 2024: routes by learned arc times against A* on distance and A* that turns least, on the path network.

Experiment 1: orders done in ten hours (figure 5). 2: how long the busiest arcs are held (table 3). 3: energy and orders
per energy (figure 6). 4: how arc times are distributed (tables 1 and 2). 5: fleets of other sizes. 6: what the headline
owes to assumptions. 7: the battery (figure 2). All methods get the same orders, batteries and timer; every run is
judged. What a run computes is in lian2024_cells, rows and figures in lian2024_table and lian2024_figures.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import assets
from engine.build import demand_model
from engine.studies import lian2024_table as table
from engine.studies.base import Beside, Cell, Progress, Result, Settings, run_cells
from engine.studies.lian2024_cells import SCENARIO, changed, run_cell
from engine.studies.lian2024_figures import figures_of
from engine.studies.lian2024_notes import notes_of
from engine.studies.lian2024_table import AGVS, BASE, FULL, METHODS, OWN, PAPERS, QUICK, SLOW, TURNS, Extent


@dataclass(frozen=True, slots=True)
class Lian2024:
    """quick, full: what a quick and a full run do."""

    quick: Extent = field(default=QUICK)
    full: Extent = field(default=FULL)

    @property
    def name(self) -> str:
        return "lian2024"

    @property
    def title(self) -> str:
        return "Learned arc times: routes for 29 AGVs on a path network"

    @property
    def paper(self) -> str:
        return "Lian et al. 2024, distributed multi-AGV scheduling with a time-occupancy heuristic"

    @property
    def experiments(self) -> Mapping[int, str]:
        return {
            1: "orders done (figure 5)",
            2: "how long the five busiest arcs are held (table 3)",
            3: "energy, and orders per energy (figure 6)",
            4: "how arc times are distributed (tables 1 and 2)",
            5: "fleets of other sizes: where congestion makes the method pay",
            6: "what the gain in orders per energy owes to assumptions",
            7: "the battery (figure 2)",
        }

    @property
    def maps(self) -> tuple[int, int]:
        return 2, 5

    @property
    def counted(self) -> str:
        return "seeds"

    def beside(self, record: Mapping[str, Any], row: Mapping[str, Any] | None = None) -> Beside | None:
        """The runs of a row's methods at the first seed; rows of one method get another one to compare with."""
        known = {"hours": self.full.hours, "hours of experiments 5 and 6": self.full.side_hours, **record["parameters"]}
        seed = 1000 * int(known["seed"])
        if row is None:
            names = tuple(METHODS[method][0] for method in (*PAPERS, "prioritized"))
            return Beside(SCENARIO, names, f"{known['hours']:g}h", seed)
        methods = _methods_in(f"{row['quantity']}, {row['case']}")
        if row["experiment"] > 6 or not methods or "alone" in row["case"]:
            return None
        if len(methods) == 1:
            methods += [TURNS if methods[0] == OWN else OWN]
        length, changes = LENGTH.search(row["quantity"]), {}
        hours = known["hours of experiments 5 and 6"] if row["experiment"] > 4 else known["hours"]
        if (fleet := FLEET.search(row["case"])) is not None:
            changes = {"fleet.count": int(fleet[1])}
        if row["experiment"] == 6 and row["case"] != BASE:
            driven = {case: changes for case, kind, changes in _assumptions(self.full) if kind == "run"}
            if row["case"] not in driven:
                return None  # other costs of the same motions, or parameters of one method alone
            changes = driven[row["case"]]
        planners = tuple(":".join(METHODS[method]) for method in methods[:4])
        return Beside(SCENARIO, planners, f"{length[1]}{length[2]}" if length else f"{hours:g}h", seed, changes)

    def extent(self, settings: Settings) -> Extent:
        return self.quick if settings.quick else self.full

    def cells(self, settings: Settings) -> list[Cell]:
        """Every run as plain values, seed by seed."""
        x, seeds = self.extent(settings), settings.maps or self.maps[not settings.quick]
        text = assets.path("scenarios", f"{SCENARIO}.toml").read_bytes()
        same = {"changes": {}, "keep": [], "recost": {}, "from_h": table.after_learning(x)}
        same["scenario"] = hashlib.sha256(text).hexdigest()[:16]
        cells: list[Cell] = []
        for number in range(seeds):
            asked = [*_main(x), *(_beside(x) if number < x.side_seeds else ())]
            for experiment, case, method, hours, more in asked:
                planner, objective = METHODS[method]
                cells.append({
                    "what": f"{case}, {method}, seed {number + 1}", "experiment": experiment, "case": case,
                    "method": method, "planner": planner, "objective": objective, "hours": hours, "number": number,
                    "seed": 1000 * settings.seed + number, **same, **more,
                })  # fmt: skip
        return cells

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        """All runs. Raises Ended."""
        cells, x = self.cells(settings), self.extent(settings)
        results = run_cells(run_cell, cells, settings, progress, jobs)
        of: dict[tuple[int, str, str], list[Cell]] = {}
        for cell, result in zip(cells, results, strict=True):
            of.setdefault((cell["experiment"], cell["case"], cell["method"]), []).append(result)
        rows = table.rows_of(of, x, settings.quick)
        return Result(
            self.name, self.title, self.paper, self.experiments, self.one_set(settings), tuple(rows),
            tuple(figures_of(of, x)), sum(r["plans"] for r in results), sum(r["breaches"] for r in results),
            tuple(notes_of(of, x, settings.quick)),
        )  # fmt: skip

    def one_set(self, settings: Settings) -> dict[str, Any]:
        """What produced all rows; experiments 5 and 6 change one thing each."""
        scenario, x = changed({}), self.extent(settings)
        seeds = settings.maps or self.maps[not settings.quick]
        model = demand_model("lian2024", scenario)
        drive = {name: getattr(model.drive, name) for name in model.drive.__slots__}
        battery = scenario.battery
        return {
            "places": "8 × 14, 202 arcs of two lanes, 16 entrances", "AGVs": scenario.fleet.count,
            "arc_ms": 900, "turn_ms": 1000, "tick_s": scenario.time.tick_s,
            "refresh_min": 30, "orders": f"a backlog of {scenario.orders.backlog}, entrance to node and back, uniform",
            "pick_s": scenario.service.pick_s, "drop_s": scenario.service.drop_s, "mass_kg": scenario.fleet.mass_kg,
            "payload_kg": scenario.fleet.payload_kg, "standby_w": model.standby_w, **drive,
            "battery": f"{battery.model}, {battery.capacity_wh:g} Wh, {battery.voltage_v:g} V, "
                       f"{battery.exchange} below {100 * scenario.charging.good:g} %",
            "hours": x.hours, "hours of experiments 5 and 6": x.side_hours,
            "seeds of experiments 5 and 6": min(seeds, x.side_seeds), "seed": settings.seed,
        }  # fmt: skip


LENGTH = re.compile(r" in (?:the first )?([\d.]+) (h|min)$")
FLEET = re.compile(r"^(\d+) AGV")


def _methods_in(text: str) -> list[str]:
    """The table's words for methods in a row, in the order in which they stand there."""
    longest = sorted(METHODS, key=len, reverse=True)
    return list(dict.fromkeys(re.findall("|".join(map(re.escape, longest)), text)))


def _assumptions(x: Extent) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(case, kind, changes) of both other values of every factor."""
    for factor in x.factors:
        for value, changes in ((factor.low, factor.low_changes), (factor.high, factor.high_changes)):
            yield f"{factor.name} → {value}", factor.kind, changes


Asked = tuple[int, str, str, float, dict[str, Any]]
"""Experiment, case, method, hours, and what else a cell says."""


def _main(x: Extent) -> Iterator[Asked]:
    """The long runs of one seed."""
    for method in (*PAPERS, "prioritized"):
        yield 1, BASE, method, x.hours, {"keep": ["arcs", "times", "drive"] if method == OWN else ["arcs"]}


def _beside(x: Extent) -> Iterator[Asked]:
    """The short runs of one seed: the slow planner, fleets, assumptions."""
    if x.slow_hours:
        yield 1, BASE, SLOW, x.slow_hours, {}
    recost = {case: changes for case, kind, changes in _assumptions(x) if kind == "energy"}
    for fleet in reversed(x.fleets):
        for method in PAPERS:
            again = recost if str(fleet) == AGVS and method in (OWN, TURNS) else {}
            yield 5, str(fleet), method, x.side_hours, {"changes": {"fleet.count": fleet}, "recost": again}
    for case, kind, changes in _assumptions(x):
        for method in {"run": (OWN, TURNS), "own": (OWN,), "energy": ()}[kind]:
            yield 6, case, method, x.side_hours, {"changes": changes}
