"""Heuristics matrix: one map, four heuristics, four or eight neighbours; all searches step together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

from dash import html

from app.lessons import search
from app.lessons.base import (
    Cell,
    Lesson,
    Mask,
    Preset,
    Query,
    check_cell,
    floor_answer,
    packed,
    read_cell,
    read_floor,
    read_whole,
)
from engine.errors import BadInput, unknown_name
from engine.planners import connected
from engine.planners.kernels import single
from engine.planners.single import Way
from engine.types import PlanStatus

PANELS = 8
RULES = ("manhattan", "euclidean", "chebyshev", "octile")
TIES = ("fifo", "lifo", "larger-g")
MODES: dict[str, tuple[str, int, bool]] = {
    "four": ("4 neighbours", 4, False),
    "eight": ("8 neighbours", 8, False),
    "cut": ("8, corners cut", 8, True),
}
WORDS = {"manhattan": "Manhattan", "euclidean": "Euclidean", "chebyshev": "Chebyshev", "octile": "octile"}
HEADINGS = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
UM_PER_MM = 1000
"""Searches count µm per metre of cell; the lesson shows mm, which fit its columns."""


class Panel(NamedTuple):
    """What one panel searches with."""

    mode: str
    heuristic: str
    tie: str

    @property
    def text(self) -> str:
        return ".".join(self)


class Asked(NamedTuple):
    """A checked state."""

    free: Mask
    start: Cell
    goal: Cell
    panels: tuple[Panel, ...]


def read_panel(text: str) -> Panel:
    """A panel such as `eight.octile.fifo`. Raises BadInput."""
    mode, _, rest = text.partition(".")
    heuristic, _, tie = rest.partition(".")
    for what, name, known in (("connectivity", mode, MODES), ("heuristic", heuristic, RULES), ("tie rule", tie, TIES)):
        if name not in known:
            raise BadInput(unknown_name(what, name[:40], known))
    return Panel(mode, heuristic, tie)


def read(query: Query) -> Asked:
    """The state of an address. Raises BadInput."""
    start, goal = read_cell(query["start"], "start"), read_cell(query["goal"], "goal")
    free = read_floor(query["map"], (start, goal))
    check_cell(start, "start", free)
    check_cell(goal, "goal", free)
    if start == goal:
        raise BadInput(f"goal: it lies at the start, {goal[0]}.{goal[1]}")
    panels = tuple(read_panel(text) for text in query["panels"].split("~"))
    if len(panels) > PANELS:
        raise BadInput(f"panels: at most {PANELS} were expected, got {len(panels)}")
    read_whole(query.get("step", ""), "step", 0, search.LAST_STEP, 0)
    return Asked(free, start, goal, panels)


def nodes_of(ground: connected.Ground, heuristic: str, start: int, goal: int) -> search.Nodes:
    """Nodes are places; costs in µm."""
    step, xy, n = ground.step.tolist(), ground.xy.tolist(), len(ground.cell_of)
    length, per_turn = ground.length.tolist(), 8 // ground.neighbours
    gx, gy = xy[goal] & 0xFFFF, xy[goal] >> 16
    rule = connected.HEURISTICS[heuristic]
    apart = getattr(single.length_apart, "py_func", single.length_apart)

    def moves(place: int, heading: int) -> Iterable[search.Move]:
        return [search.Move(v, length[d], 0, 0, d * per_turn) for d, v in enumerate(step[place]) if v < n]

    def h(place: int) -> int:
        return int(apart(rule, xy[place], gx, gy, connected.UM_PER_CELL, connected.UM_PER_DIAGONAL))

    return search.Nodes(moves, h, lambda p: p, lambda p: p, [start])


def play_panel(ground: connected.Ground, panel: Panel, ends: tuple[int, int], shortest: int) -> dict[str, Any]:
    """One search and its trace, ready for JSON. shortest: length of a shortest way with this connectivity, in µm."""
    found = connected.search(ground, *ends, panel.heuristic, panel.tie, trace=True, limit=search.EXPANSIONS)
    way = Way(found.status, found.places, found.length_um, found.expanded, found.trace)
    cells = ground.cell_of.tolist()
    played = search.play(nodes_of(ground, panel.heuristic, *ends), way, cells)
    for columns in (played.rows, played.entries):
        for name in ("g", "h"):
            columns[name] = [value // UM_PER_MM for value in columns[name]]
    solved = found.status is PlanStatus.SOLVED
    return {
        "panel": panel.text,
        "unit": "cells",
        "status": "goal reached" if solved else search.status_sentence(way, len(played.rows["cell"])),
        "solved": solved,
        "expanded": len(played.rows["cell"]),
        "cost": found.length_um // UM_PER_MM if solved else -1,
        "longer": found.length_um / shortest - 1 if solved else None,
        "admissible": panel.heuristic in connected.ADMISSIBLE[ground.neighbours],
        "energy_mj": 0,
        "turns": 0,
        "length": len(found.places) - 1,
        "rows": packed(played.rows),
        "entries": packed(played.entries),
        "path": packed({"cell": [cells[p] for p in found.places.tolist()]}),
    }


def answer(query: Query) -> dict[str, Any]:
    """The floor and every panel's trace. Raises BadInput."""
    asked = read(query)

    @cache
    def ground(mode: str) -> tuple[connected.Ground, tuple[int, int], int]:
        _, neighbours, cut = MODES[mode]
        made = connected.ground_of(asked.free, neighbours, cut)
        ends = (made.place(*asked.start), made.place(*asked.goal))
        return made, ends, connected.search(made, *ends, "octile").length_um

    return {
        **floor_answer(asked.free),
        "start": list(asked.start),
        "goal": list(asked.goal),
        "panels": [
            play_panel(made, panel, ends, shortest)
            for panel in asked.panels
            for made, ends, shortest in [ground(panel.mode)]
        ],
    }


# -- the page ---------------------------------------------------------------------------------------------------------


def panels(modes: Iterable[str], rules: Sequence[str] = RULES, tie: str = "fifo") -> str:
    """A panel for every heuristic of every connectivity."""
    return "~".join(Panel(mode, rule, tie).text for mode in modes for rule in rules)


PAPER = {"map": "10x10r15s60", "start": "0.2", "goal": "9.7"}
OVERSTEPS = {"map": "16x10r25s209", "start": "0.2", "goal": "15.7"}

PRESETS = (
    Preset(
        "The whole matrix",
        {**PAPER, "panels": panels(("four", "eight"))},
        "Step to the end. Within a row all lengths are the same: the heuristic decides how many cells are expanded, "
        "the connectivity how long the way is. Table 1 of Wang et al. sets three of the first row against one of the "
        "second.",
    ),
    Preset(
        "Corners cut",
        {**PAPER, "panels": panels(("eight", "cut"))},
        "A diagonal past the corner of an obstacle saves a little more, and a vehicle of any width would hit it. "
        "Floors of runs never allow it.",
    ),
    Preset(
        "Manhattan oversteps",
        {**OVERSTEPS, "panels": "~".join(panels(MODES, [rule]) for rule in ("manhattan", "octile"))},
        "With diagonals the Manhattan distance counts more than what is left: it hurries to the goal, expands few "
        "cells, and comes by a way that is not the shortest. With four neighbours it is the best of the four.",
    ),
    Preset(
        "Open floor",
        {"map": "24x16", "start": "3.3", "goal": "20.12", "panels": panels(("four", "eight"))},
        "Without obstacles the octile distance is exact with eight neighbours, the Manhattan distance with four. What "
        "is expanded beyond the way is ties: the next example breaks them.",
    ),
    Preset(
        "Ties broken",
        {"map": "24x16", "start": "3.3", "goal": "20.12", "panels": panels(("four", "eight"), tie="larger-g")},
        "The same, equal f by larger g: exact heuristics go straight. Euclidean and Chebyshev have hardly any ties to "
        "break; they are too small.",
    ),
    Preset(
        "Large floor",
        {"map": "60x60r20s2", "start": "0.0", "goal": "59.59", "panels": panels(("four", "eight"))},
        "The order of the heuristics stays on larger floors: octile, Euclidean, Chebyshev with eight neighbours.",
    ),
)


def text() -> list[Any]:
    """What stands beside the maps."""
    rules = {
        "Manhattan": "|Δx| + |Δy|",
        "Euclidean": "√(Δx² + Δy²)",
        "Chebyshev": "max(|Δx|, |Δy|)",
        "octile": "√2 · min(|Δx|, |Δy|) + max − min",
    }
    return [
        html.H3("Four estimates"),
        html.Table(
            html.Tbody([html.Tr([html.Td(name), html.Td(formula)]) for name, formula in rules.items()]),
            className="wl-lesson-table",
        ),
        html.P(
            "Octile is what Wang et al. 2019 call the complex diagonal distance (eq. 12). It is the exact distance on "
            "an empty floor with eight neighbours, as Manhattan is with four."
        ),
        html.H3("Admissible"),
        html.P(
            "A heuristic that never exceeds what is left finds a shortest way. The larger it is, the fewer cells are "
            "expanded. With eight neighbours Manhattan exceeds it: a diagonal step costs √2 and Manhattan counts 2."
        ),
        html.H3("Four or eight neighbours"),
        html.P(
            "A straight step costs 1, a diagonal one √2. A diagonal needs both cells beside it free, unless corners "
            "may be cut. Nine columns and five rows take 14 steps with four neighbours, and 4 + 5√2 = 11.07 with "
            "eight: a fifth less, whatever the heuristic."
        ),
    ]


LESSON = Lesson(
    title="Heuristics matrix",
    summary="Manhattan, Euclidean, Chebyshev and octile distance, each with four and with eight neighbours, step by "
    "step on the same map: what shortens the way, and what only saves work.",
    presets=PRESETS,
    keys=search.KEYS,
    read=read,
    answer=answer,
    text=text,
    options={
        "algorithms": {name: {"word": word, "heuristics": list(RULES), "ties": list(TIES)}
                       for name, (word, _, _) in MODES.items()},
        "heuristics": WORDS,
        "ties": {name: search.TIE_WORDS[name] for name in TIES},
        "headings": list(HEADINGS),
        "arrows": ["→", "↗", "↑", "↖", "←", "↙", "↓", "↘"],
        "panels": PANELS,
        "first": "eight.octile.fifo",
    },
)  # fmt: skip
