"""Ants: up to four colonies on one floor, their pheromone iteration by iteration, A* as the reference."""

from __future__ import annotations

import base64
from typing import Any, NamedTuple

import numpy as np
from dash import html

from app.lessons.base import (
    Cell,
    Lesson,
    Mask,
    Preset,
    Query,
    check_cell,
    drawn,
    floor_answer,
    packed,
    read_cell,
    read_floor,
    read_whole,
)
from engine.errors import BadInput, unknown_name
from engine.planners.aco import Aco, Colony
from engine.planners.astar import AStar
from engine.planners.single import Floor
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance
from engine.types import PlanStatus

PANELS = 4
LARGEST = 1200
"""Cells of the largest floor: the pheromone of every iteration is sent."""
LAST_STEP = 999
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "literal": ("Improved, inducement as printed", {"inducement": "literal"}),
    "off": ("Improved, without inducement", {"inducement": "off"}),
    "exponent": ("Improved, inducement in the exponent", {"inducement": "exponent"}),
    "classic": ("Classic ant system", {"rule": "classic"}),
    "discard": ("As printed, dead ends are fatal", {"inducement": "literal", "retreat": False}),
}
NUMBERS: dict[str, tuple[str, float, float]] = {
    "alpha": ("α", 0.0, 5.0),
    "beta": ("β", 0.0, 10.0),
    "rho": ("ρ", 0.0, 1.0),
    "explore": ("ε0", 0.0, 1.0),
    "xi": ("ξ", 0.1, 0.49),
}
COUNTS: dict[str, tuple[str, int, int]] = {"ants": ("Ants", 1, 100), "iterations": ("Iterations", 1, 100)}
KEYS = ("map", "start", "goal", "panels", *COUNTS, *NUMBERS, "seed", "step")


class Asked(NamedTuple):
    """A checked state."""

    free: Mask
    start: Cell
    goal: Cell
    kinds: tuple[str, ...]
    parameters: dict[str, Any]
    seed: int


def read_number(text: str, letter: str, low: float, high: float, default: float) -> float:
    """A number within limits; the default for an empty text. Raises BadInput."""
    if not text:
        return default
    try:
        value = float(text[:20])
    except ValueError:
        raise BadInput(f"{letter}: a number was expected, got {text[:20]!r}") from None
    if not low <= value <= high:
        near = min(max(value, low), high)
        raise BadInput(f"{letter}: a number from {low:g} to {high:g} was expected, got {text[:20]}; nearest: {near:g}")
    return value


def read(query: Query) -> Asked:
    """The state of an address. Raises BadInput."""
    start, goal = read_cell(query["start"], "start"), read_cell(query["goal"], "goal")
    free = read_floor(query["map"], (start, goal))
    check_cell(start, "start", free)
    check_cell(goal, "goal", free)
    if start == goal:
        raise BadInput(f"goal: it lies at the start, {goal[0]}.{goal[1]}")
    if free.size > LARGEST:
        raise BadInput(f"map: at most {LARGEST} cells were expected here, got {free.size}")
    kinds = tuple(query["panels"].split("~"))
    for kind in kinds:
        if kind not in KINDS:
            raise BadInput(unknown_name("colony", kind[:40], KINDS))
    if len(kinds) > PANELS:
        raise BadInput(f"panels: at most {PANELS} were expected, got {len(kinds)}")
    own = Aco()
    parameters: dict[str, Any] = {
        name: read_number(query.get(name, ""), letter, low, high, getattr(own, name))
        for name, (letter, low, high) in NUMBERS.items()
    }
    for name, (word, least, most) in COUNTS.items():
        parameters[name] = read_whole(query.get(name, ""), word, least, most, getattr(own, name))
    for kind in kinds:
        try:
            Aco(**parameters, **KINDS[kind][1])
        except ValueError as error:
            raise BadInput(str(error)) from error
    read_whole(query.get("step", ""), "step", 0, LAST_STEP, 0)
    return Asked(free, start, goal, kinds, parameters, read_whole(query.get("seed", ""), "seed", 0, 999_999, 1))


def panel(kind: str, found: Colony, cells: np.ndarray[Any, Any], width: int, aco: Aco) -> dict[str, Any]:
    """What one panel plays: per iteration the pheromone of every cell (its strongest way out, 0 to 255 between the
    bounds), the best way so far, and counts.
    """
    trace = found.trace
    tau = trace["tau"].max(axis=2)
    level = np.zeros((len(tau), cells.max(initial=0) + 1), np.uint8)
    level[:, cells] = np.rint(255 * (tau - aco.low) / (aco.high - aco.low)).clip(0, 255).astype(np.uint8)
    best = trace["best"]
    fresh = np.flatnonzero(np.diff(best, prepend=-1))
    ways = [[int(k) + 1, cells[trace["way"][k][: best[k] + 1]].tolist()] for k in fresh.tolist()]
    return {
        "kind": kind,
        "word": KINDS[kind][0],
        "solved": found.status is PlanStatus.SOLVED,
        "cells": level.shape[1],
        "tau": base64.b64encode(level.tobytes()).decode(),
        "columns": packed({"best": best, "shortest": trace["shortest"], "lost": trace["lost"]}),
        "mean": [round(float(n), 2) for n in trace["mean"]],
        "ways": ways,
        "found_at": found.found_at,
        "choices": found.choices,
        "exploited": found.exploited,
        "retreats": found.retreats,
    }


def identical(a: Colony, b: Colony) -> bool:
    """True when two colonies did the same: every choice counted, every pheromone to the last bit."""
    counts = ("choices", "exploited", "retreats", "lost", "found_at")
    return all(getattr(a, name) == getattr(b, name) for name in counts) and all(
        np.array_equal(a.trace[name], b.trace[name]) for name in a.trace
    )


def answer(query: Query) -> dict[str, Any]:
    """The floor, the shortest way, and every colony. Raises BadInput."""
    asked = read(query)
    instance = Instance("floor", asked.free, (asked.start,), (asked.goal,))
    graph = instance.graph()
    floor = Floor(graph, xu2025_costs(graph))
    start, goal = instance.place(asked.start), instance.place(asked.goal)
    cells = np.flatnonzero(asked.free.ravel())
    shortest = AStar().search(floor, start, goal)
    reachable = shortest.status is PlanStatus.SOLVED
    found, panels = [], []
    for kind in asked.kinds:
        aco = Aco(**asked.parameters, **KINDS[kind][1])
        found.append(aco.search(floor, start, goal, asked.seed, trace=True, pheromone=True))
        panels.append(panel(kind, found[-1], cells, asked.free.shape[1], aco))
    for i, each in enumerate(panels):
        each["same"] = next((j for j in range(len(found)) if j != i and identical(found[i], found[j])), -1)
    return {
        **floor_answer(asked.free),
        "iterations": asked.parameters["iterations"],
        "ants": asked.parameters["ants"],
        "parameters": asked.parameters,
        "seed": asked.seed,
        "astar": {
            "steps": shortest.cost // 1000 if reachable else -1,
            "expanded": shortest.expanded,
            "cells": cells[graph.state_place[shortest.states]].tolist(),
        },
        "panels": panels,
    }


# -- the page ---------------------------------------------------------------------------------------------------------

RANDOM = {"map": "24x18r33s37", "start": "0.0", "goal": "23.17", "ants": "8", "seed": "1"}
POCKET = {
    "map": drawn(
        "...............",
        ".#############.",
        ".............#.",
        ".............#.",
        ".............#.",
        ".............#.",
        ".............#.",
        ".#############.",
        "...............",
    ),
    "start": "4.4",
    "goal": "14.4",
    "seed": "1",
}
OPEN = {"map": "16x12", "start": "0.0", "goal": "15.11", "ants": "8", "seed": "1"}

PRESETS = (
    Preset(
        "It cancels",
        {**RANDOM, "panels": "literal~off~exponent~classic"},
        "The two upper colonies are the same ant for ant: as printed, the time-varying inducement multiplies every "
        "p the same way and is divided out again. Below, the same factor in the exponent, and the classic ant system. "
        "The dashed line is A*: nothing can be shorter.",
    ),
    Preset(
        "Switched on and off",
        {**RANDOM, "map": "24x18r33s11", "panels": "literal~off"},
        "Change ξ, the seed, or draw obstacles: the two maps stay identical, to the last bit of the pheromone. "
        "Then choose the exponent on one side.",
    ),
    Preset(
        "Dead ends",
        {**POCKET, "panels": "discard~literal", "ants": "20", "iterations": "20"},
        "The pocket lies on the straight way. As printed, an ant in a dead end is lost; with the retreat it goes back "
        "and remembers the cell. Compare the lost ants.",
    ),
    Preset(
        "Too greedy",
        {**OPEN, "panels": "off~exponent", "explore": "0.05", "rho": "0.6", "iterations": "20"},
        "With ε0 = 0.05 nearly every choice is the largest p, and half of the pheromone goes each time: the first "
        "good way is the last one. On an open floor that does no harm; draw a wall across it.",
    ),
)


def text() -> list[Any]:
    """What stands beside the maps."""
    return [
        html.H3("A choice"),
        html.P(
            "An ant at i goes on to j with p = τ^α η^β / Σ. The classic system takes η = 1/d, d the straight distance "
            "from j to the goal, and always draws by p. The thesis takes η = 1/f with A*'s f = step + Manhattan "
            "distance, and with probability 1 − ε0 simply the largest p."
        ),
        html.H3("The inducement"),
        html.P(
            "Printed: η = (1−ξ)/ξ · (K−k)/K · 1/f, to guide strongly at first and weakly later. The factor is the same "
            "for every j, so it stands above and below the fraction line of p, and cancels. In the exponent, "
            "β·(1−ξ)/ξ·(K−k)/K, it does what it is meant to do."
        ),
        html.H3("Pheromone"),
        html.P(
            "After each iteration τ falls by the share ρ everywhere. Then all ants better than the median lay "
            "ρ·Q/(n·L) on their ways; in the classic system only the best way so far does. τ stays between 0.05 and 8."
        ),
        html.H3("The reference"),
        html.P(
            "The shortest way of one vehicle is what A* finds, exactly, with a few hundred expansions; a colony makes "
            "tens of thousands of choices and promises nothing."
        ),
    ]


LESSON = Lesson(
    title="Ants",
    summary="Ant colonies side by side: pheromone as colour iteration by iteration, the best way so far against A*, "
    "and the printed inducement switched on and off without any effect.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={
        "kinds": {name: word for name, (word, _) in KINDS.items()},
        "numbers": {
            name: {"letter": letter, "low": low, "high": high, "own": getattr(Aco(), name)}
            for name, (letter, low, high) in {**COUNTS, **NUMBERS}.items()
        },
        "panels": PANELS,
    },
)
