"""Anytime and repair: AD* on a small terrain, pass by pass, and what of its plan a change of the ground touches.

Sources: Likhachev et al. 2005, Anytime Dynamic A*: OPEN, INCONS, ε, keys that inflate h for lowered states alone. Zhang
et al. 2021: the cluster of figure 4, the cost (14) and the heuristic (17), whose height term is printed with the wrong
sign; step 15 of its listing repeats step 2, so that every change begins the search anew. All that is shown is what
engine.planners.adstar did; the terrain is the paper's at a third of its size, slopes unchanged.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from dash import html
from numpy.typing import NDArray

from app.lessons.base import Cell, Lesson, Preset, Query, check_cell, packed, read_cell, read_whole
from engine.build import terrain_costs, terrain_search
from engine.energy import parameter_sets
from engine.energy.skid_steer import SkidSteer
from engine.energy.terrain_costs import TerrainCosts
from engine.errors import BadInput, InvariantBroken, unknown_name
from engine.planners.adstar import EXACT, AdStar, Search
from engine.planners.base import Route
from engine.world.lattice import HEADINGS
from engine.world.relief import generate, terrain_of
from engine.world.terrain import TerrainPlan, TerrainWorld, build_terrain, disc

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

CELL_M = 0.2
SHRINK = 3
"""Hills are generated on a ground so many times as large, and shrunk."""
RELIEF: dict[str, tuple[str, float]] = {
    "bumps": ("bumps", 1.5),
    "ridges": ("ridges", 1.2),
    "ramps": ("ramps", 1.5),
    "craters": ("craters", 1.0),
    "smooth": ("smooth field", 1.0),
    "flat": ("flat", 0.0),
}
"""Classes of ground: their word, and the metres of their highest hills before shrinking."""
HILLS, STONES = 14, 5
ROOM_CELLS = 6
"""Generated obstacles keep so far from start and goal."""
SIDES = (20, 60)
BUMP_M = 0.12
"""What one dab of the brush raises or lowers."""
HIGHEST_M = 3.0
CHANGES, DABS, BRUSH = 12, 60, 8
LAST = 9999
UNENDING = 2**62
FRAME, GROWTH = 16, 1.4
"""Expansions of the first frame of a pass, and by how much each further one has more."""
FRESH, BEFORE, OPEN, INCONS, COUNTED = 1, 2, 4, 8, 16
"""Bits of a cell in a frame; from COUNTED on, the headings expanded in this pass, 15 at most."""
KEYS = (
    "ground", "start", "goal", "objective", "epsilon", "lower", "share", "raised", "anew", "printed", "changes", "step",
)  # fmt: skip
_GROUND = re.compile(r"([a-z]{3,8})(\d{1,3})x(\d{1,3})s(\d{1,6})")
_CHANGE = re.compile(r"([rlox])(\d)(?:e(\d{4,5}))?_([\d.-]+)")
_DRIVE = re.compile(r"d(\d{1,2})(?:e(\d{4,5}))?")


class Change(NamedTuple):
    """Something that happens once ε has come down to `after` thousandths. size: radius of the brush in cells, or of
    `d` the trajectories driven."""

    kind: str
    size: int
    after: int
    cells: tuple[Cell, ...]


class Asked(NamedTuple):
    """A checked state without its changes. ground: class, columns, rows, seed."""

    ground: tuple[str, int, int, int]
    start: Cell
    goal: Cell
    objective: str
    epsilon: float
    lower: float
    share: float
    raised: bool
    anew: bool
    printed: bool

    @property
    def options(self) -> AdStar:
        return AdStar(
            epsilon=self.epsilon, step=self.lower, share=self.share, anew=self.anew, printed_h=self.printed
        )  # fmt: skip


def read_number(text: str, word: str, low: float, high: float) -> float:
    """A number within limits. Raises BadInput."""
    if not re.fullmatch(r"\d{1,3}(\.\d{1,3})?", text) or not low <= float(text) <= high:
        raise BadInput(f"{word}: a number from {low:g} to {high:g} was expected, got {text[:20]!r}")
    return float(text)


def read_ground(text: str) -> tuple[str, int, int, int]:
    """`bumps56x42s3`: class, columns, rows, seed. Raises BadInput."""
    match = _GROUND.fullmatch(text)
    if not match:
        raise BadInput(f"ground: {text[:30]!r} was got, a text such as bumps56x42s3 was expected")
    if match[1] not in RELIEF:
        raise BadInput(unknown_name("ground", match[1], RELIEF))
    sides = int(match[2]), int(match[3])
    for side in sides:
        if not SIDES[0] <= side <= SIDES[1]:
            near = min(max(side, SIDES[0]), SIDES[1])
            raise BadInput(
                f"ground: sides of {SIDES[0]} to {SIDES[1]} cells were expected, got {side}; nearest: {near}"
            )
    return match[1], *sides, int(match[4])


def read_changes(text: str) -> tuple[Change, ...]:
    """`r4_25.18-27.18~o1e1500_12.9~d6`: hills, obstacles and drives in their order; e is the ε at which one comes.
    Raises BadInput.
    """
    found = []
    for part in text.split("~") if text else ():
        if drive := _DRIVE.fullmatch(part):
            found.append(Change("d", int(drive[1]), int(drive[2] or EXACT), ()))
        elif change := _CHANGE.fullmatch(part):
            cells = tuple(read_cell(cell, "changes") for cell in change[4].split("-"))
            found.append(Change(change[1], int(change[2]), int(change[3] or EXACT), cells))
        else:
            raise BadInput(f"changes: {part[:30]!r} was got, a text such as r4_25.18, o1_12.9-13.9 or d6 was expected")
        if found[-1].size > BRUSH and found[-1].kind != "d":
            raise BadInput(f"changes: a brush of 0 to {BRUSH} cells was expected, got {found[-1].size}")
        if len(found[-1].cells) > DABS:
            raise BadInput(f"changes: at most {DABS} dabs in one were expected, got {len(found[-1].cells)}")
    if len(found) > CHANGES:
        raise BadInput(f"changes: at most {CHANGES} were expected, got {len(found)}")
    return tuple(found)


def read(query: Query) -> tuple[Asked, tuple[Change, ...]]:
    """The state of an address. Raises BadInput."""
    ground = read_ground(query["ground"])
    start, goal = read_cell(query["start"], "start"), read_cell(query["goal"], "goal")
    for cell, what in ((start, "start"), (goal, "goal")):
        check_cell(cell, what, np.ones((ground[2], ground[1]), np.bool_))
    if start == goal:
        raise BadInput(f"goal: it lies at the start, {goal[0]}.{goal[1]}")
    objective = query.get("objective", "") or "energy"
    if objective not in ("energy", "distance"):
        raise BadInput(unknown_name("objective", objective[:20], ("energy", "distance")))
    read_whole(query.get("step", ""), "step", 0, LAST, 0)
    asked = Asked(
        ground, start, goal, objective,
        read_number(query.get("epsilon", "") or "2.5", "first ε", 1, 10),
        read_number(query.get("lower", "") or "0.25", "ε is lowered by", 0.05, 5),
        read_whole(query.get("share", ""), "share", 0, 100, 50) / 100,
        *(bool(read_whole(query.get(name, ""), name, 0, 1, 0)) for name in ("raised", "anew", "printed")),
    )  # fmt: skip
    changes = read_changes(query.get("changes", ""))
    for change in changes:
        for cell in change.cells:
            check_cell(cell, "changes", np.ones((ground[2], ground[1]), np.bool_))
    return asked, changes


# -- the ground -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def world_of(ground: tuple[str, int, int, int], start: Cell, goal: Cell) -> TerrainWorld:
    """The ground as generated, without obstacles near start and goal."""
    name, columns, rows, seed = ground
    grain = SHRINK * CELL_M
    whole = generate(
        name, seed, size_m=(columns * grain, rows * grain), cell_m=grain, height_m=RELIEF[name][1], count=HILLS,
        obstacles=0 if name == "flat" else STONES,
    )  # fmt: skip
    y, x = np.mgrid[:rows, :columns]
    near = [np.hypot(x - cx, y - cy) <= ROOM_CELLS for cx, cy in (start, goal)]
    obstacle = whole.obstacle & ~near[0] & ~near[1]
    return build_terrain(TerrainPlan(terrain_of(whole.height_m / SHRINK, CELL_M, obstacle), 0.1, prior="full"))


@lru_cache(maxsize=1)
def robot() -> SkidSteer:
    """The robot of the scenario zhang2021."""
    return SkidSteer(60.0, "climb", **parameter_sets.zhang2021())


@lru_cache(maxsize=8)
def table_of(ground: tuple[str, int, int, int], start: Cell, goal: Cell, objective: str) -> I32:
    """(S, K) costs over the ground as generated."""
    cost: I32 = terrain_costs(world_of(ground, start, goal), robot(), objective).cost
    cost.setflags(write=False)
    return cost


def costs_on(world: TerrainWorld, objective: str, height: F32, obstacle: Mask, table: I32) -> TerrainCosts:
    """Costs with arrays of their own, from a table that was computed before."""
    ground = world.terrain
    costs = TerrainCosts(
        world.cluster, robot(), CELL_M, height, obstacle, ground.friction, np.ones(ground.shape, np.bool_),
        ground.slope_limit_deg, world.body_m, objective, table=False,
    )  # fmt: skip
    costs.cost = table.copy()
    return costs


def search_of(asked: Asked, options: AdStar, costs: TerrainCosts, start: int) -> Search:
    """AD* over these costs, from a state to the goal of the lesson."""
    x, y = asked.goal
    found: Search = terrain_search(options, costs, robot(), 1.0, start, y * asked.ground[1] + x)
    return found


def start_state(asked: Asked) -> int:
    """The start, looking towards the goal."""
    (x, y), (gx, gy) = asked.start, asked.goal
    heading = round(math.atan2(gy - y, gx - x) / (2 * math.pi) * HEADINGS) % HEADINGS
    return (y * asked.ground[1] + x) * HEADINGS + heading


def edited(change: Change, height: F32, obstacle: U8) -> tuple[I32, F32, U8]:
    """Cells (N, 2) that a change makes different, with their new heights and obstacles."""
    rows, columns = height.shape
    new_height, new_obstacle = height.astype(np.float64), obstacle.copy()
    for x, y in change.cells:
        cells = disc(change.size) + np.array([x, y], np.int32)
        cells = cells[(cells >= 0).all(1) & (cells < [columns, rows]).all(1)]
        cx, cy = cells.T
        if change.kind in "ox":
            new_obstacle[cy, cx] = change.kind == "o"
        else:
            away = np.hypot(cx - x, cy - y) / (change.size + 1)
            top = BUMP_M if change.kind == "r" else -BUMP_M
            new_height[cy, cx] += top * np.cos(away * math.pi / 2) ** 2
    low = new_height.clip(-HIGHEST_M, HIGHEST_M).astype(np.float32)
    ys, xs = np.nonzero((low != height) | (new_obstacle != obstacle))
    return np.stack([xs, ys], 1).astype(np.int32), low[ys, xs], new_obstacle[ys, xs]


# -- one phase: a change, and the passes after it ---------------------------------------------------------------------


class Film:
    """What is shown, frame by frame: (cells,) bits, and counts."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.columns: dict[str, list[int]] = {name: [] for name in ("pass", "expanded", "open", "incons")}

    def add(self, number: int, expanded: int, search: Search, fresh: Mask, before: Mask) -> None:
        """The present moment of a search. fresh, before: (S,) states expanded in this pass, and before it."""
        waiting, later = search.frontier()
        counted = np.minimum(fresh.reshape(-1, HEADINGS).sum(1), 15).astype(np.uint8)
        bits = counted * COUNTED + (counted > 0) * FRESH
        bits |= before.reshape(-1, HEADINGS).any(1) * np.uint8(BEFORE)
        for states, bit in ((waiting, OPEN), (later, INCONS)):
            bits[np.unique(states // HEADINGS)] |= np.uint8(bit)
        self.frames.append(bits.astype(np.uint8).tobytes())
        for name, value in zip(self.columns, (number, expanded, len(waiting), len(later)), strict=True):
            self.columns[name].append(value)


class Phase(NamedTuple):
    """What a search did up to a moment, ready for JSON, and all that is needed to go on from there."""

    told: dict[str, Any]
    memory: dict[str, Any]
    height: F32
    obstacle: Mask
    table: I32
    start: int
    route: Route
    known: Mask  # (S,) states expanded since the search began from nothing


class Pass(NamedTuple):
    """epsilon: of the pass · frame: number of its last one."""

    route: Route
    epsilon: float
    expanded: int
    frame: int


def run(search: Search, stop: int, film: Film, known: Mask) -> list[Pass]:
    """Every pass until ε is at most `stop`."""
    passes: list[Pass] = []
    while not search.solved or EXACT * search.epsilon > stop:
        fresh, begun, budget = np.zeros(len(known), np.bool_), search.expanded, float(FRAME)
        route: Route | None = None
        while route is None:
            cost, lowered = search.settled()
            route = search.work(int(budget))
            after = search.settled()
            fresh |= (after[0] != cost) | (after[1] != lowered)
            film.add(len(passes), search.expanded - begun, search, fresh, known)
            budget *= GROWTH
        known |= fresh
        passes.append(Pass(route, search.epsilon, search.expanded - begun, len(film.frames) - 1))
    if not passes:  # nothing has changed for the search
        film.add(0, 0, search, np.zeros(len(known), np.bool_), known)
        passes.append(Pass(search.route(), search.epsilon, 0, len(film.frames) - 1))
    return passes


def counted(search: Search) -> tuple[int, int]:
    """Expansions until there is a way again, and until it is the least."""
    begun, first = search.expanded, 0
    if not search.solved:
        search.work(UNENDING)
        first = search.expanded - begun
    search.best()
    return first, search.expanded - begun


@lru_cache(maxsize=16)
def phase(asked: Asked, changes: tuple[Change, ...], stop: int) -> Phase:
    """The search after these changes, once ε has come down to `stop` thousandths."""
    world = world_of(asked.ground, asked.start, asked.goal)
    if not changes:
        table = table_of(asked.ground, asked.start, asked.goal, asked.objective)
        costs = costs_on(world, asked.objective, world.terrain.height_m, world.terrain.obstacle, table)
        search = search_of(asked, asked.options, costs, start_state(asked))
        known = np.zeros(len(costs.cost), np.bool_)
        told: dict[str, Any] = {}
        touched = np.zeros(0, np.int32)
    else:
        earlier, change = phase(asked, changes[:-1], changes[-1].after), changes[-1]
        costs = costs_on(world, asked.objective, earlier.height, earlier.obstacle, earlier.table)
        search = search_of(asked, asked.options, costs, earlier.start)
        search.restore(earlier.memory)
        known = earlier.known.copy()
        told, touched = happened(asked, change, earlier, costs, search)
        if told["anew"]:
            known[:] = False
    film = Film()
    film.add(-1, 0, search, np.zeros(len(known), np.bool_), known)
    passes = run(search, stop, film, known)
    least = search_of(asked, AdStar(epsilon=1.0), costs, search.start).best()
    told |= {
        "start": place(search.start, world.width),
        "heights": base64.b64encode(np.rint(1000 * costs.height).astype("<i2").tobytes()).decode(),
        "walls": "".join(map(str, costs.obstacle.ravel().tolist())),
        "shut": "".join(map(str, costs.closed.ravel().tolist())),
        "touched": np.unique(touched // HEADINGS).tolist(),
        "least": least.cost if least.found else -1,
        "least_way": line(world, least),
        "passes": [
            {**way_told(world, costs, each, least), "expanded": each.expanded, "frame": each.frame} for each in passes
        ],
        "frames": base64.b64encode(b"".join(film.frames)).decode(),
        "columns": packed(film.columns),
    }
    return Phase(
        told, search.to_memory(), costs.height, costs.obstacle.astype(np.bool_), costs.cost, search.start,
        passes[-1].route, known,
    )  # fmt: skip


def happened(
    asked: Asked, change: Change, earlier: Phase, costs: TerrainCosts, search: Search
) -> tuple[dict[str, Any], I32]:
    """Lets a change happen to a search; what it did, and what repair and planning anew expand for a way of one ε."""
    twin = search_of(asked, replace(asked.options, share=1.0, anew=False), costs, earlier.start)
    twin.restore(earlier.memory)
    both, begun, epsilon = (search, twin), search.begun, search.epsilon
    states, share, after = np.zeros(0, np.int32), 0.0, round(EXACT * epsilon)
    if change.kind == "d":
        way = earlier.route.states
        start = int(way[min(change.size, len(way) - 1)]) if len(way) else earlier.start
        for each in both:
            each.move(start)
    else:
        start = earlier.start
        cells, height, obstacle = edited(change, costs.height, costs.obstacle)
        x, y = cells.T
        seen = costs.see(cells, height, obstacle, costs.friction[y, x])
        own = ((y * costs.height.shape[1] + x)[:, None] * HEADINGS + np.arange(HEADINGS)).ravel()
        states = np.union1d(seen, own).astype(np.int32)
        share = search.touched(states)
        if len(states):
            epsilon = asked.epsilon if asked.raised else epsilon
            for each in both:
                # where the ground under the robot itself has changed, every key does
                each.changed(states, heights=bool((own == start).any()), epsilon=epsilon if asked.raised else None)
    new = search_of(asked, replace(asked.options, epsilon=epsilon), costs, start)
    return {
        "change": {"kind": change.kind, "size": change.size, "cells": change.cells, "after": after},
        "repair": counted(twin),
        "fresh": counted(new),
        "share": share,
        "states": len(states),
        "anew": search.begun > begun,
    }, states


# -- what is told -----------------------------------------------------------------------------------------------------


def place(state: int, columns: int) -> list[int]:
    """[x, y, heading] of a state."""
    cell, heading = divmod(state, HEADINGS)
    return [cell % columns, cell // columns, heading]


def line(world: TerrainWorld, route: Route) -> list[list[float]]:
    """Points of a way in cells, along its trajectories."""
    if not route.found:
        return []
    shapes = world.cluster
    points: list[list[float]] = []
    for state, k in zip(route.states.tolist(), route.ks.tolist(), strict=False):
        x, y, h = place(state, world.width)
        steps = shapes.point[h, k, : shapes.pieces[h, k] + 1] + (x, y)
        points += np.round(steps, 2).tolist()
    return [*points, [float(n) for n in place(int(route.states[-1]), world.width)[:2]]]


def way_told(world: TerrainWorld, costs: TerrainCosts, done: Pass, least: Route) -> dict[str, Any]:
    """A published way: what it costs, what is promised of it, and what is true."""
    route = done.route
    if not route.found:
        return {"found": False, "epsilon": done.epsilon, "cost": -1, "ratio": 0.0, "broken": False, "way": []}
    xy = np.array(line(world, route))
    columns, rows = np.clip(np.rint(xy).astype(int), 0, [world.width - 1, world.height - 1]).T
    rises = np.diff(costs.height[rows, columns])
    parts = sum((costs.parts(s, k) for s, k in zip(route.states.tolist(), route.ks.tolist(), strict=False)), start=0)
    return {
        "found": True,
        "epsilon": done.epsilon,
        "cost": route.cost,
        "ratio": round(route.cost / least.cost, 6) if least.cost else 1.0,
        "broken": route.cost > route.bound * least.cost,
        "energy_mj": int(np.sum(parts)),
        "length_m": round(float(np.hypot(*np.diff(xy, axis=0).T).sum()) * CELL_M, 2),
        "climb_m": round(float(rises[rises > 0].sum()), 2),
        "way": xy.tolist(),
    }


def verdict(told: dict[str, Any], asked: Asked) -> str:
    """What a change cost, in sentences."""
    repair, fresh = told["repair"], told["fresh"]
    counts = f"Repair expands {repair[1]:,} states, planning anew {fresh[1]:,}"
    if repair[0] != repair[1] or fresh[0] != fresh[1]:
        counts += f"; for the first way alone, {repair[0]:,} and {fresh[0]:,}"
    if told["change"]["kind"] == "d":
        return (
            "The robot has driven on. The search runs backward, so what states cost to the goal stays right and only "
            f"keys change. {counts}."
        )
    if not told["states"]:
        return "Nothing has changed."
    share = f"{100 * told['share']:.1f} % of the states seen so far are touched."
    if asked.anew:
        return f"{share} As printed, every change begins the search anew. {counts}."
    rule = f"The rule (anew above {100 * asked.share:g} %) " + ("begins anew" if told["anew"] else "repairs")
    if repair[1] == fresh[1]:
        return f"{share} {counts}. {rule}."
    right = (fresh[1] < repair[1]) == told["anew"]
    return f"{share} {counts}. {rule}{', rightly' if right else ': here the wrong choice'}."


def trait(asked: Asked, phases: Sequence[dict[str, Any]]) -> list[str]:
    """What goes wrong with the paper's traits, in sentences."""
    said = []
    if asked.printed and asked.objective == "distance":
        said.append("Height sign as printed: nothing happens, for distance has no height term.")
    elif asked.printed:
        broken = [way for told in phases for way in told["passes"] if way["broken"]]
        worst = max(broken, key=lambda way: float(way["ratio"] / way["epsilon"]), default=None)
        said.append(
            "Height sign as printed: h charges for going down and refunds climbing. On the way down it overestimates, "
            "so the search believes it is done too soon, and no bound is proven. "
            + (
                f"The way of ε = {worst['epsilon']:g} is said to cost at most {worst['epsilon']:.2f} times the least; "
                f"it costs {worst['ratio']:.3f} times the least."
                if worst
                else "On this ground it happens to do no harm: let the way fall towards the goal."
            )
        )
    if asked.anew:
        wasted = [told["fresh"][1] - told["repair"][1] for told in phases[1:] if told["anew"]]
        said.append(
            "Anew on every change: step 15 of the listing repeats step 2, the initialisation, so nothing that was "
            "known is used again. "
            + (f"Here that takes {sum(wasted):,} expansions more than repair." if wasted else "Change the ground.")
        )
    return said


def answer(query: Query) -> dict[str, Any]:
    """The ground, and every phase of the search with its frames. Raises BadInput."""
    asked, changes = read(query)
    _, columns, rows, _ = asked.ground
    try:
        phases = [
            dict(phase(asked, changes[:i], changes[i].after if i < len(changes) else EXACT).told)
            for i in range(len(changes) + 1)
        ]
    except InvariantBroken as error:
        if not asked.printed:
            raise
        raise BadInput(
            f"with the height sign as printed the search loses itself here: {error}. Take a change back, or the sign"
        ) from error
    for told in phases[1:]:
        told["verdict"] = verdict(told, asked)
    return {
        "width": columns,
        "height": rows,
        "cell_m": CELL_M,
        "goal": list(asked.goal),
        "objective": asked.objective,
        "phases": phases,
        "traits": trait(asked, phases),
    }


# -- the page ---------------------------------------------------------------------------------------------------------

HILLS_2 = {"ground": "bumps56x42s2", "start": "4.4", "goal": "51.37"}
RIDGES_3 = {"ground": "ridges56x42s3", "start": "4.4", "goal": "51.37"}
HILLS_1 = {"ground": "bumps56x42s1", "start": "51.37", "goal": "4.4"}

PRESETS = (
    Preset(
        "Anytime",
        HILLS_2,
        "Play, or move ε from 2.5 to 1. The first way needs about a hundred expansions, the proof that a way is the "
        "cheapest needs nearly all of them. Compare the bound that is proven with the real cost.",
    ),
    Preset(
        "Near the robot",
        {**HILLS_2, "changes": "o1_8.7", "step": "62"},
        "An obstacle drops onto the way, near the robot. Few states lie between it and the start: repair expands a "
        "part of what planning anew would. Drop more along the way and compare.",
    ),
    Preset(
        "Near the goal",
        {**RIDGES_3, "changes": "o2_48.34", "step": "46"},
        "An obstacle near the goal touches few states, but the ways of nearly all others run through these. Each "
        "outdated state is expanded twice, raised and lowered: planning anew wins, and the rule, which only counts "
        "what is touched, doesn't see it.",
    ),
    Preset(
        "The rule",
        {**RIDGES_3, "changes": "o2_48.34", "share": "10", "step": "55"},
        "The same obstacle, with a rule that plans anew above 10 %: now it begins anew, with the first ε again, and a "
        "first way is there soon. Set the share to 50 and compare; then try it with a change near the robot.",
    ),
    Preset(
        "While ε is 2",
        {**HILLS_2, "changes": "o1e2000_33.10~r4_20.3-24.3", "raised": "1", "step": "19"},
        "The first obstacle drops while the way is only proven to cost at most twice the least; the passes go on after "
        "it. ε is raised after each change, so that a way is there soon: planning anew has one sooner still, but needs "
        "three times the expansions until it is the least again.",
    ),
    Preset(
        "The robot drives",
        {**HILLS_2, "changes": "d8~o1_33.4~d8", "step": "60"},
        "The robot drives eight trajectories: no state is expanded, for the search began at the goal. Then something "
        "lies in its way, and it drives on. Press Drive on yourself, and drop obstacles before it.",
    ),
    Preset(
        "Printed: anew",
        {**HILLS_2, "changes": "o1_8.7~r4_24.3~o1_40.9", "anew": "1", "step": "67"},
        "The paper's listing initialises everything again on every change. Switch it off on the left, and see what "
        "was saved.",
    ),
    Preset(
        "Printed: height sign",
        {**HILLS_1, "printed": "1", "step": "65"},
        "With the printed sign of (17) the last pass says that its way is the cheapest. The dotted one is. Switch the "
        "sign off on the left.",
    ),
)


def text() -> list[Any]:
    """What stands beside the ground."""
    return [
        html.H3("A state"),
        html.P(
            "A cell and one of 16 headings; from each, seven trajectories of the robot lead on. What they cost follows "
            "from the ground below them: rolling, turning, and climbing m·g·Δz. The search begins at the goal, so g is "
            "what a state costs to the goal."
        ),
        html.H3("Anytime"),
        html.P(
            "Keys are g + ε·h, with h a lower bound of what the robot still has to pay to get there. With ε = 2.5 the "
            "search hurries to the robot and proves that its way costs at most 2.5 times the least. Each further pass "
            "lowers ε. What a pass finds cheaper after having expanded it once is put off to the next pass: INCONS. "
            "Only OPEN and INCONS are taken up again; all the rest is kept."
        ),
        html.H3("Repair"),
        html.P(
            "When the ground changes, the states whose trajectories cross it look at their trajectories again. Those "
            "that got cheaper are lowered; those that got dearer are raised first, and every state that relied on "
            "them too, before they are lowered to what they cost now. What lies between the goal and the change is "
            "not touched at all."
        ),
        html.H3("Repair or anew"),
        html.P(
            "A raised state is expanded twice, so where much is raised planning anew is cheaper. The planner begins "
            "anew when more than a share of the states seen is touched. That share is known before; how many states "
            "rely on them is not, and it is large near the goal. Both counts were really computed, from the same ε on."
        ),
        html.H3("Sources"),
        html.P(
            "Likhachev and others, Anytime Dynamic A*, 2005. Zhang and others, 2021: energy on terrain; its "
            "equation (17) and steps 2 and 15 of its listing are the two switches. The ground is of the classes of the "
            "study, a third as large, with the same slopes.",
            className="wl-hint",
        ),
    ]


LESSON = Lesson(
    title="Anytime and repair",
    summary="AD* on hills that you shape: move ε from 2.5 to 1 and see the way get better, then change the ground and "
    "see what repair touches, against planning anew.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={"relief": {name: word for name, (word, _) in RELIEF.items()}, "changes": CHANGES, "dabs": DABS},
)
