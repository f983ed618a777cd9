"""Zhang et al. 2021: what energy-optimal ways save over the shortest ones, and what repair saves over planning anew.

Experiment 1: on seeded terrains of several classes AD* plans the shortest way and the cheapest one, and both are paid
for by the same costs. Experiment 2: a part of a map changes, and the search repairs its way or begins again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.build import terrain_costs, terrain_search
from engine.energy import parameter_sets
from engine.energy.skid_steer import SkidSteer
from engine.energy.terrain_costs import TerrainCosts
from engine.errors import InvariantBroken
from engine.planners.adstar import AdStar, Search
from engine.planners.base import Route
from engine.sim.judge.ground import hindrance
from engine.studies.base import Cell, Figure, Progress, Result, Row, Settings, by_quantity, row, run_cells
from engine.world.lattice import HEADINGS
from engine.world.relief import Terrain, generate
from engine.world.terrain import TerrainPlan, TerrainWorld, build_terrain, disc

CLASSES: dict[str, dict[str, Any]] = {
    "bumps": {"height_m": 1.5, "count": 40},
    "ridges": {"height_m": 1.2, "count": 40},
    "craters": {"height_m": 1.0, "count": 40},
    "smooth": {"height_m": 1.0},
}
"""Classes of terrain, and what the generator is asked for."""
OBSTACLES = 30
CORNER_M = 5.1
"""Start and goal stand so far from the corners of the ground."""
SHARES = (0.001, 0.01, 0.1)
"""Parts of the map that change in experiment 2."""
SEEN = "what 4 m around the robot reveal"
LONGER, SAVED = 3.7, 16.1
"""Printed in percent: length of the energy-optimal ways over that of the shortest, and energy that they save."""
UNENDING = 2**62

NOTES = (
    "The paper's 20 scenes and its tables of the robot's numbers are lost. The robot is one of its kind, the scenes "
    "are seeded terrains of four classes.",
    "Both ways are paid for by one cost, α·L + m·g·Δz⁺/η + turning. The printed cost (14) adds μ·m·g·Δz, which pays on "
    "the way down for the way up: with it hills cost nothing.",
    "AD* is that of Likhachev et al. 2005. The paper's listing begins again on every change (step 15 repeats step 2), "
    "and so saves nothing over planning anew; experiment 2 shows what repair does.",
    "Planning times are CPU times of one search to the optimum, kernels compiled, tables of costs made before. In "
    "distance the straight line is a good guess of what is left; in energy, hills make it a poor one, so that several "
    "times as many states are looked at. The paper finds both times equal.",
    "The cost of `power` counts what both motors draw at every moment, so that a descent spares rolling: of what a "
    "hill takes it gives a part back. Gentle ground then leaves hardly anything to be saved.",
)


@dataclass(frozen=True, slots=True)
class Zhang2021:
    """cluster: of trajectories · size_m: side of the ground · parameters: over the defaults of
    parameter_sets.zhang2021."""

    cluster: str = "figure4"
    size_m: float = 60.0
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return "zhang2021"

    @property
    def title(self) -> str:
        return "AD* on terrain: ways of least energy, and plans that are repaired"

    @property
    def paper(self) -> str:
        return "Zhang et al. 2021, low-energy planning by an improved AD*"

    @property
    def experiments(self) -> Mapping[int, str]:
        return {
            1: f"Energy-optimal ways against the shortest, {self.size_m:g} m × {self.size_m:g} m",
            2: "Repair against planning anew, by the part of the map that changes",
        }

    @property
    def maps(self) -> tuple[int, int]:
        return 2, 20

    def cells(self, settings: Settings) -> list[Cell]:
        """Every map of every case as plain values."""
        maps = settings.maps or self.maps[not settings.quick]
        return [
            {
                "what": f"experiment {e}, {name}, map {number + 1}", "experiment": e, "class": name, "map": number,
                "seed": settings.seed, "cluster": self.cluster, "size_m": self.size_m,
                "parameters": dict(self.parameters),
            }
            for e, names in ((1, tuple(CLASSES)), (2, ("bumps",)))
            for name in names
            for number in range(maps)
        ]  # fmt: skip

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        """Both experiments. Raises Ended."""
        cells = self.cells(settings)
        results = run_cells(solve_cell, cells, settings, progress, jobs)
        of: dict[tuple[int, str], list[Cell]] = {}
        for cell, result in zip(cells, results, strict=True):
            of.setdefault((cell["experiment"], cell["class"]), []).append(result)
        rows = by_quantity([*_ways(of), *_repairs(of)])
        return Result(
            self.name, self.title, self.paper, self.experiments, self.one_set(settings), tuple(rows),
            tuple(_figures(of, rows)), sum(r["plans"] for r in results), sum(r["breaches"] for r in results), NOTES,
        )  # fmt: skip

    def one_set(self, settings: Settings) -> dict[str, Any]:
        """What produced all rows. alpha_j_per_m: energy of a flat metre."""
        robot = robot_of(self.parameters)
        return {
            **parameter_sets.zhang2021(), **self.parameters, "mass_kg": robot.mass_kg, "cell_m": 0.2,
            "cluster": self.cluster, "size_m": self.size_m, "obstacles": OBSTACLES, "slope_limit_deg": 30.0,
            "seed": settings.seed,
            "alpha_j_per_m": round(sum(robot.flat_j_per_m), 2), "epsilon": AdStar().epsilon, "step": AdStar().step,
        }  # fmt: skip


def robot_of(parameters: Mapping[str, float], form: str = "climb") -> SkidSteer:
    """The robot of the study."""
    return SkidSteer(60.0, form, **{**parameter_sets.zhang2021(), **parameters})


# -- one cell ---------------------------------------------------------------------------------------------------------


def solve_cell(cell: Cell) -> Cell:
    """One map. Energies in J, lengths in m, CPU times in ms."""
    words = [cell["seed"], list(CLASSES).index(cell["class"]), cell["map"]]
    seed = int(np.random.SeedSequence(words).generate_state(1)[0])
    terrain = ground_of(cell["class"], seed, cell["size_m"])
    robot = robot_of(cell["parameters"])
    return _both(cell, terrain, robot) if cell["experiment"] == 1 else _changed(cell, terrain, robot, seed)


def ground_of(name: str, seed: int, size_m: float = 60.0) -> Terrain:
    """Terrain of a class; hills and obstacles of 60 m × 60 m as dense on any size."""
    asked, part = dict(CLASSES[name]), (size_m / 60) ** 2
    if "count" in asked:
        asked["count"] = max(1, round(asked["count"] * part))
    ends = ((CORNER_M, CORNER_M), (size_m - CORNER_M, size_m - CORNER_M))
    return generate(name, seed, size_m=(size_m, size_m), obstacles=round(OBSTACLES * part), free=ends, **asked)


def world_of(terrain: Terrain, cluster: str = "figure4") -> TerrainWorld:
    """The terrain of the study, known as it is."""
    return build_terrain(TerrainPlan(terrain, 0.1, cluster=cluster, prior="full"))


def ends_of(world: TerrainWorld) -> tuple[int, int]:
    """Start state, looking along the diagonal, and goal cell."""
    near, far = int(CORNER_M / world.grain_m), int((world.size_m[0] - CORNER_M) / world.grain_m)
    return world.place_at(near, near) * HEADINGS + 2, world.place_at(far, far)


def search_on(world: TerrainWorld, costs: TerrainCosts, robot: SkidSteer, **options: Any) -> Search:
    """A search from corner to corner."""
    start, goal = ends_of(world)
    found: Search = terrain_search(AdStar(**options), costs, robot, float(costs.friction.min()), start, goal)
    return found


def passes(search: Search) -> list[tuple[Route, float]]:
    """Every published way with the CPU milliseconds since the beginning."""
    found, begun = [], process_time()
    while not search.optimal:
        route = search.work(UNENDING)
        if route is not None:
            found.append((route, 1000 * (process_time() - begun)))
    return found


def _both(cell: Cell, terrain: Terrain, robot: SkidSteer) -> Cell:
    """The shortest way and the cheapest."""
    world = world_of(terrain, cell["cluster"])
    out: Cell = {"plans": 0, "breaches": 0, "length_m": {}, "energy_j": {}, "power_j": {}, "ms": {}, "curve": []}
    both = robot_of(cell["parameters"], "power")
    truth = {"energy_j": terrain_costs(world, robot, "energy", table=False)}
    truth["power_j"] = terrain_costs(world, both, "energy", table=False)
    length = terrain_costs(world, robot, "distance")
    ways: dict[str, Route] = {}
    for objective in ("distance", "energy"):
        costs = length if objective == "distance" else terrain_costs(world, robot, "energy")
        optimal = search_on(world, costs, robot, epsilon=1.0)
        optimal.restart()
        begun = process_time()
        route = optimal.best()
        out["ms"][objective] = 1000 * (process_time() - begun)
        if not route.found:
            return {**out, "cut_off": True}
        ways[objective] = route
        out["plans"] += 1
        out["breaches"] += breaches(world, terrain.obstacle, route)
        lengths = length.cost[route.states[:-1], route.ks]
        out["length_m"][objective] = float(lengths[lengths > 1].sum()) / 1000
        for word, ground in truth.items():
            out[word][objective] = _joules(ground, route)
        if objective == "energy":
            anytime = search_on(world, costs, robot)
            anytime.restart()
            best = float(route.cost)
            out["curve"] = [[r.bound, r.cost / best, ms] for r, ms in passes(anytime)]
    if cell["map"] == 0:
        out["picture"] = _picture(world, ways, out)
    return out


def _joules(ground: TerrainCosts, route: Route) -> float:
    steps = zip(route.states[:-1].tolist(), route.ks.tolist(), strict=True)
    return sum(int(ground.parts(s, k).sum()) for s, k in steps) / 1000


def breaches(world: TerrainWorld, obstacle: NDArray[np.bool_], route: Route) -> int:
    """What the judge finds on a way."""
    steps = zip(route.states[:-1].tolist(), route.ks.tolist(), strict=True)
    found = sum(hindrance(world, obstacle, s // HEADINGS, s % HEADINGS, k) is not None for s, k in steps)
    s, gaps = int(route.states[0]), 0
    for there, k in zip(route.states[1:].tolist(), route.ks.tolist(), strict=True):
        dx, dy, to = world.cluster.end[s % HEADINGS, k].tolist()
        gaps += (s // HEADINGS + dy * world.width + dx) * HEADINGS + to != there
        s = there
    return found + gaps


def _changed(cell: Cell, terrain: Terrain, robot: SkidSteer, seed: int) -> Cell:
    """Repair and planning anew after changes."""
    rng = np.random.default_rng(seed)
    world = world_of(terrain, cell["cluster"])
    out: Cell = {"plans": 0, "breaches": 0, "repair": {}, "expanded": {}, "ms": {}}
    costs = terrain_costs(world, robot, "energy")
    for share in (0.0, *SHARES):
        repaired = repair(world, costs, robot, changes(rng, world, costs, share))
        if repaired is None:
            continue
        name = SEEN if share == 0 else f"{100 * share:g} %"
        out["repair"][name], out["expanded"][name], out["ms"][name] = repaired
    return out


def changes(
    rng: np.random.Generator, world: TerrainWorld, costs: TerrainCosts, share: float
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.uint8]]:
    """Cells (N, 2), and what stands there from now on: a hill or a hollow, and a few obstacles.

    A round part of the map that holds a share of it, anywhere; with share 0 what a sensor of 4 m sees from the start.
    """
    rows, columns = world.terrain.shape
    start, goal = ends_of(world)
    y, x = divmod(start // HEADINGS, columns)
    radius = world.sensor_m / world.grain_m
    if share > 0:
        radius = math.sqrt(share * rows * columns / math.pi)
        x, y = int(rng.uniform(0, columns)), int(rng.uniform(0, rows))
    cells = disc(radius) + np.array([x, y], np.int32)
    cells = cells[(cells >= 0).all(1) & (cells < [columns, rows]).all(1)]
    cx, cy = cells.T
    away = np.hypot(cx - x, cy - y) / radius
    top = rng.choice([-1.0, 1.0]) * min(0.4, 0.05 * radius) * rng.uniform(0.5, 1.0)
    height = costs.height[cy, cx] + (top * np.cos(np.minimum(away, 1.0) * math.pi / 2) ** 2).astype(np.float32)
    obstacle: NDArray[np.uint8] = costs.obstacle[cy, cx].copy()
    for _ in range(max(1, round(len(cells) * 0.0005))):
        i = int(rng.integers(len(cells)))
        obstacle[(cx - cx[i]) ** 2 + (cy - cy[i]) ** 2 < 4] = 1
    for place in (start // HEADINGS, goal):
        py, px = divmod(place, columns)
        obstacle[(cx - px) ** 2 + (cy - py) ** 2 < 25] = 0
    return cells, height.astype(np.float32), obstacle


def repair(
    world: TerrainWorld,
    costs: TerrainCosts,
    robot: SkidSteer,
    news: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.uint8]],
) -> tuple[float, float, list[float]] | None:
    """CPU time, expansions: of repair in percent of planning anew at once for the optimum; both times in ms.

    The table of costs is brought up to date before either, and put back after both. None where there is no way.
    """
    search = search_on(world, costs, robot, epsilon=1.0, share=1.0)
    if not search.best().found:
        return None
    cells, height, obstacle = news
    x, y = cells.T
    old = costs.height[y, x].copy(), costs.obstacle[y, x].copy(), costs.friction[y, x].copy()
    changed = costs.see(cells, height, obstacle, old[2])
    own = ((y * world.width + x)[:, None] * HEADINGS + np.arange(HEADINGS)).ravel()
    states = np.union1d(changed, own).astype(np.int32)
    before, begun = search.expanded, process_time()
    # where the ground under the robot itself has changed, every key does
    search.changed(states, heights=bool((own == search.start).any()))
    route = search.best()
    repair_ms, expanded = 1000 * (process_time() - begun), search.expanded - before
    anew = search_on(world, costs, robot, epsilon=1.0)
    begun = process_time()
    anew.restart()
    other = anew.best()
    anew_ms = 1000 * (process_time() - begun)
    costs.see(cells, *old)
    if route.cost != other.cost:
        raise InvariantBroken(f"repair found {route.cost} mJ, planning anew {other.cost} mJ")
    return 100 * repair_ms / anew_ms, 100 * expanded / max(other.expanded, 1), [repair_ms, anew_ms]


def _picture(world: TerrainWorld, ways: Mapping[str, Route], found: Cell) -> Cell:
    """The map in cells of 1 m, and both ways."""
    block = 5
    rows, columns = world.height // block, world.width // block
    cells = world.terrain.obstacle[: rows * block, : columns * block].reshape(rows, block, columns, block)
    shut = np.asarray(cells.any(axis=(1, 3)), np.bool_)
    names = {"distance": "shortest", "energy": "least energy"}
    paths, captions = {}, {}
    for objective, route in ways.items():
        y, x = np.divmod(route.states // HEADINGS, world.width)
        xy = np.stack([x // block, y // block], 1)
        keep = np.concatenate([[True], (xy[1:] != xy[:-1]).any(1)])
        paths[names[objective]] = [xy[keep].tolist()]
        captions[names[objective]] = (
            f"{names[objective]}: {found['length_m'][objective]:.1f} m, {found['energy_j'][objective] / 1000:.2f} kJ"
        )
    return {
        "rows": ["".join(".@"[cell] for cell in line) for line in shut.tolist()],
        "paths": paths,
        "captions": captions,
    }


# -- the table --------------------------------------------------------------------------------------------------------

Cases = Mapping[tuple[int, str], list[Cell]]


def _more(result: Cell, what: str) -> float:
    """Percent by which the energy-optimal way has more of something than the shortest."""
    return float(100 * (result[what]["energy"] / result[what]["distance"] - 1))


def _ways(of: Cases) -> list[Row]:
    rows = []
    for (e, name), results in of.items():
        good = [r for r in results if e == 1 and not r.get("cut_off")]
        if not good:
            continue
        note = "the class that was calibrated" if name == "bumps" else ""
        rows.append(row(1, "energy saved over the shortest way", name, [-_more(r, "energy_j") for r in good], SAVED))
        rows.append(
            row(1, "longer than the shortest way", name, [_more(r, "length_m") for r in good], LONGER, note=note)
        )
        rows.append(row(1, "energy saved, counted as power", name, [-_more(r, "power_j") for r in good], None))
        times = [r["ms"]["energy"] / r["ms"]["distance"] for r in good]
        rows.append(
            row(1, "planning time over that of the shortest way", name, times, 1.0, "×", "the paper: about equal")
        )
    return rows


def _repairs(of: Cases) -> list[Row]:
    rows = []
    results = [r for (e, _), found in of.items() if e == 2 for r in found]
    for name in (f"{100 * share:g} %" for share in SHARES):
        good = [r for r in results if name in r["repair"]]
        if good:
            rows.append(row(2, "CPU time of repair over planning anew", name, [r["repair"][name] for r in good]))
            rows.append(row(2, "expansions of repair over planning anew", name, [r["expanded"][name] for r in good]))
    good = [r for r in results if SEEN in r["repair"]]
    if good:
        rows.append(row(2, "CPU time of repair over planning anew", SEEN, [r["repair"][SEEN] for r in good]))
        rows.append(row(2, "expansions of repair over planning anew", SEEN, [r["expanded"][SEEN] for r in good]))
    return rows


# -- figures ----------------------------------------------------------------------------------------------------------


def _figures(of: Cases, rows: Sequence[Row]) -> list[Figure]:
    figures = [_by_class(rows), _anytime(of), _repair_figure(rows)]
    for (e, name), results in of.items():
        if e == 1 and name == "bumps" and "picture" in results[0]:
            note = "The first map of its class, in squares of 1 m. Circles start, stars end."
            title = "Figure 8: the shortest way and the one of least energy"
            figures.append(Figure("figure-8", title, "floor", {**results[0]["picture"], "note": note}))
    return figures


def _by_class(rows: Sequence[Row]) -> Figure:
    names = {"energy saved over the shortest way": SAVED, "longer than the shortest way": LONGER}
    series, bands = [], []
    for quantity, paper in names.items():
        mine = [r for r in rows if r.quantity == quantity]
        x = [r.case for r in mine]
        series.append({"name": quantity, "x": x, "y": [r.ours for r in mine], "half": [r.half_width for r in mine]})
        band = {"name": f"the paper: {quantity.split()[0]}", "x": x, "low": [paper] * len(x), "high": [paper] * len(x)}
        bands.append(band)
    data = {
        "series": series, "bands": bands, "x_title": "class of terrain", "y_title": "%",
        "note": "Means over the maps with their 95 % intervals.",
    }  # fmt: skip
    return Figure("classes", "Experiment 1: energy-optimal ways by class of terrain", "lines", data)


def _anytime(of: Cases) -> Figure:
    """Cost over CPU time, at each ε the mean over the maps."""
    series = []
    for (e, name), results in of.items():
        curves = [r["curve"] for r in results if e == 1 and r.get("curve")]
        if curves:
            per_pass = list(zip(*curves, strict=True))
            x = [float(np.mean([point[2] for point in points])) for points in per_pass]
            series.append({"name": name, "x": x, "y": [float(np.mean([p[1] for p in points])) for points in per_pass]})
    note = "Each point is a pass: ε 2.5, 2, 1.5 and 1. What it publishes costs at most ε times the least."
    data = {"series": series, "x_title": "CPU time, ms", "y_title": "cost over the least", "note": note}
    return Figure("anytime", "A way at once, the best one later", "lines", data)


def _repair_figure(rows: Sequence[Row]) -> Figure:
    series = []
    for quantity in ("CPU time of repair over planning anew", "expansions of repair over planning anew"):
        mine = [r for r in rows if r.quantity == quantity]
        values = {"x": [r.case for r in mine], "y": [r.ours for r in mine], "half": [r.half_width for r in mine]}
        series.append({"name": quantity, **values})
    data = {
        "series": series, "x_title": "part of the map that changes", "y_title": "%", "log_y": True,
        "note": "Means over the maps. Above 100 % planning anew is cheaper, and the planner does that.",
    }  # fmt: skip
    return Figure("repair", "Experiment 2: repair against planning anew", "lines", data)
