"""Search playback: up to four searches side by side on one floor, from the traces of the compiled planners."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from dash import html

from app.lessons.base import (
    HEADINGS,
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
from engine.planners.astar import HEURISTICS as RULES
from engine.planners.astar import AStar
from engine.planners.eea import Eea, may_pay, with_waits
from engine.planners.kernels import single
from engine.planners.kernels.tables import FAR
from engine.planners.single import Floor, Way
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance
from engine.types import PlanStatus

PANELS = 4
EXPANSIONS = 15_000
"""A search ends after so many, with a sentence."""
TIMED_CELLS = 1600
"""Largest floor on which nodes are (cell, time): their number has no other bound."""
LAST_STEP = 999_999
KEYS = ("map", "start", "goal", "panels", "step")


@dataclass(frozen=True)
class Choice:
    """One algorithm of the menu. variant: of EEA*; empty: a search over cells by distance."""

    word: str
    variant: str
    heuristics: tuple[str, ...]
    ties: tuple[str, ...]


ALL_TIES = ("fifo", "lifo", "larger-g", "random")
TWO_TIES = ("fifo", "lifo")
ALGORITHMS: dict[str, Choice] = {
    "astar": Choice("A*: shortest way", "", ("manhattan", "euclidean", "table"), ALL_TIES),
    "dijkstra": Choice("Dijkstra: shortest way", "", ("zero",), ALL_TIES),
    "eea": Choice("EEA*: least energy", "exact", ("table", "closed", "paper"), TWO_TIES),
    "dijkstra-energy": Choice("Dijkstra: least energy", "exact", ("zero",), TWO_TIES),
    "eea-cell": Choice("EEA* by cell", "literal-cell", ("paper", "closed", "table"), TWO_TIES),
    "eea-time": Choice("EEA* by cell and time", "literal-cell-time", ("paper", "closed", "table"), TWO_TIES),
}  # fmt: skip
HEURISTIC_WORDS = {
    "manhattan": "Manhattan",
    "euclidean": "Euclidean",
    "zero": "h = 0",
    "table": "exact table",
    "closed": "closed form",
    "paper": "eq. 11",
}
TIE_WORDS = {"fifo": "FIFO", "lifo": "LIFO", "larger-g": "larger g", "random": "random"}


class Panel(NamedTuple):
    """What one panel searches with."""

    algorithm: str
    heuristic: str
    tie: str
    seed: int

    @property
    def text(self) -> str:
        return f"{self.algorithm}.{self.heuristic}.{self.tie}{self.seed if self.tie == 'random' else ''}"


class Asked(NamedTuple):
    """A checked state."""

    free: Mask
    start: Cell
    goal: Cell
    panels: tuple[Panel, ...]


def read_panel(text: str) -> Panel:
    """A panel such as `astar.manhattan.random7`. Raises BadInput."""
    algorithm, _, rest = text.partition(".")
    heuristic, _, tie = rest.partition(".")
    if algorithm not in ALGORITHMS:
        raise BadInput(unknown_name("algorithm", algorithm[:40], ALGORITHMS))
    choice = ALGORITHMS[algorithm]
    if heuristic not in choice.heuristics:
        raise BadInput(unknown_name(f"heuristic of {algorithm}", heuristic[:40], choice.heuristics))
    seed = 0
    if tie.startswith("random"):
        tie, seed = "random", read_whole(tie[6:], "seed of the random ties", 0, 999, 0)
    if tie not in choice.ties:
        raise BadInput(unknown_name(f"tie rule of {algorithm}", tie[:40], choice.ties))
    return Panel(algorithm, heuristic, tie, seed)


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
    if free.size > TIMED_CELLS and any(panel.algorithm == "eea-time" for panel in panels):
        raise BadInput(f"nodes of cell and time are for floors of at most {TIMED_CELLS} cells here; got {free.size}")
    read_whole(query.get("step", ""), "step", 0, LAST_STEP, 0)
    return Asked(free, start, goal, panels)


# -- what a search knows of its nodes ---------------------------------------------------------------------------------


class Move(NamedTuple):
    """A motion from one node to another: its cost in the search's unit, its energy, quarter turns, heading after it."""

    node: int
    cost: int
    mj: int
    turns: int
    heading: int


@dataclass
class Nodes:
    """The nodes of one search, as its trace numbers them.

    moves: (node, heading by which it was reached, -1 before the first motion) → its motions · h: its heuristic · place
    of a node · key: what counts as the same node: the node itself, or its place · timed: nodes at other times differ.
    """

    moves: Callable[[int, int], Iterable[Move]]
    h: Callable[[int], int]
    place: Callable[[int], int]
    key: Callable[[int], int]
    starts: Sequence[int]
    timed: bool = False
    known: dict[int, int] = field(default_factory=dict)

    def estimate(self, node: int) -> int:
        """The heuristic, worked out once per node."""
        if node not in self.known:
            self.known[node] = int(self.h(node))
        return self.known[node]


def _plain(kernel: Any) -> Any:
    """A kernel's plain Python function: for single values, without compiling."""
    return getattr(kernel, "py_func", kernel)


TURNS = (0, 1, 2, 1)
TURN_WORDS = ("straight", "turn", "reverse", "turn")


def _by_distance(floor: Floor, panel: Panel, start: int, goal: int) -> Nodes:
    """Nodes are places; the energy of their motions is only counted along."""
    step, xy = floor.grounds.step.tolist(), floor.grounds.xy.tolist()
    cell_mm, n, kind = int(floor.grounds.length[0]), floor.graph.n_places, floor.kinds
    mj = floor.mj().tolist()
    driving = [mj[kind[word]] for word in TURN_WORDS]
    starting = mj[kind["start straight"]]
    table = np.full(n + 1, -1, np.int32)
    if panel.heuristic == "table":
        single.steps_to(floor.grounds.step, goal, table, np.zeros(n, np.int32))
    gx, gy = xy[goal] & 0xFFFF, xy[goal] >> 16
    apart = _plain(single.length_apart)

    def moves(place: int, heading: int) -> Iterable[Move]:
        for d, v in enumerate(step[place]):
            if v < n:
                gap = (d - heading) % 4 if heading >= 0 else 0
                yield Move(v, cell_mm, driving[gap] if heading >= 0 else starting, TURNS[gap], d)

    def h(place: int) -> int:
        if panel.heuristic == "table":
            return int(table[place]) * cell_mm if table[place] >= 0 else int(FAR)
        return int(apart(RULES[panel.heuristic], xy[place], gx, gy, cell_mm, 0))

    return Nodes(moves, h, lambda p: p, lambda p: p, [start])


def _by_energy(floor: Floor, panel: Panel, start: int, goal: int) -> Nodes:
    """Nodes are motion states; as printed, states of one cell are the same node."""
    net, variant = floor.net, ALGORITHMS[panel.algorithm].variant
    literal, timed = variant != "exact", variant == "literal-cell-time"
    eea = Eea(variant, panel.heuristic, panel.tie)
    cost, standby = eea.mj(floor), int(floor.costs.standby_mj[0])
    bounds = eea.bounds(cost, standby, floor.kinds)
    table = floor.table(goal, with_waits(cost, standby, floor.kinds)) if panel.heuristic == "table" else None
    skip = -1 if literal else may_pay(cost, standby, floor.kinds)[1]
    ptr, to, kinds = net.edge_ptr.tolist(), net.edge_to.tolist(), net.edge_kind.tolist()
    mj, xy, shift = cost.tolist(), net.xy.tolist(), net.shift
    turns = [primitive.turn_deg // 90 for primitive in floor.graph.primitives]
    mask = (1 << shift) - 1
    gx, gy = xy[goal] & 0xFFFF, xy[goal] >> 16
    closed_form = _plain(single.closed_form)
    starts = floor.headings(start).tolist()

    def moves(state: int, heading: int) -> Iterable[Move]:
        for s in starts if literal and heading < 0 else [state]:
            for e in range(ptr[s], ptr[s + 1]):
                k, v = kinds[e], to[e]
                if k != skip or heading < 0:
                    yield Move(v, mj[k], mj[k], turns[k], (v & mask) >> 1)
            if timed:
                yield Move(s & ~1, standby, standby, 0, heading)

    def h(state: int) -> int:
        if table is not None:
            return int(table[state])
        return int(closed_form(bounds, xy[state >> shift], state >> 1, state & 1, gx, gy))

    def place(state: int) -> int:
        return state >> shift

    return Nodes(moves, h, place, place if literal else int, starts[:1] if literal else starts, timed)


# -- playing a trace --------------------------------------------------------------------------------------------------


class Reached(NamedTuple):
    """How a node was put on the open list: by which expansion (-1: at the start), its layer of time, its motion, and
    which entry it is."""

    by: int
    layer: int
    move: Move
    entry: int


@dataclass
class Played:
    """A trace with what its reader wants to see; columns of equal length.

    Of every expansion: cell, heading, by (the expansion that it came from), g, h, open (entries of the open list),
    energy, turns, steps so far. Of every entry into the open list: at (the expansion that made it), until (the one that
    took it out, or made it useless; -1: none), row (the expansion of this very node; -1: none), cell, heading, g, h.
    """

    rows: dict[str, list[int]]
    entries: dict[str, list[int]]


def play(nodes: Nodes, way: Way, cells: Sequence[int]) -> Played:
    """Follows the expansions of a trace, and finds what each put on the open list: a node that it reached first, or
    at less cost than before."""
    rows: dict[str, list[int]] = {
        k: [] for k in ("cell", "heading", "by", "g", "h", "open", "energy", "turns", "steps")
    }
    entries: dict[str, list[int]] = {name: [] for name in ("at", "until", "row", "cell", "heading", "g", "h")}
    best: dict[tuple[int, int], tuple[int, int]] = {}
    came: dict[tuple[int, int], Reached] = {}

    def enter(by: int, layer: int, move: Move, g: int) -> None:
        key = (nodes.key(move.node), layer if nodes.timed else 0)
        least, before = best.get(key, (FAR, -1))
        h = nodes.estimate(move.node)
        if g >= least or h >= FAR:
            return
        number = len(entries["at"])
        best[key] = (g, number)
        if before >= 0 and entries["until"][before] < 0:
            entries["until"][before] = by
        came.setdefault((move.node, g), Reached(by, layer, move, number))
        values = (by, -1, -1, cells[nodes.place(move.node)], move.heading, g, h)
        for name, value in zip(entries, values, strict=True):
            entries[name].append(value)

    literal = len(nodes.starts) == 1
    for s in nodes.starts:
        enter(-1, 0, Move(s, 0, 0, 0, -1 if literal else (s & 7) >> 1), 0)
    trace = [way.trace[name].tolist() for name in ("node", "g", "h", "open")] if way.trace else [[], [], [], []]
    for i, (node, g, h, waiting) in enumerate(zip(*trace, strict=True)):
        by, layer, move, entry = came[node, g]
        entries["until"][entry] = entries["row"][entry] = i
        energy, turns, steps = move.mj, move.turns, int(move.mj > 0 and move.cost > 0)
        if by >= 0:
            energy, turns = energy + rows["energy"][by], turns + rows["turns"][by]
            steps = rows["steps"][by] + (cells[nodes.place(node)] != rows["cell"][by])
        values = (cells[nodes.place(node)], move.heading, by, g, h, waiting, energy, turns, steps)
        for name, value in zip(rows, values, strict=True):
            rows[name].append(value)
        arrived = move.heading if steps else -1
        for motion in nodes.moves(node, arrived):
            enter(i, layer + 1, motion, g + motion.cost)
    return Played(rows, entries)


def play_panel(floor: Floor, panel: Panel, start: int, goal: int, cells: Sequence[int]) -> dict[str, Any]:
    """One search and its trace, ready for JSON. cells: cell of each place, x + width · y."""
    choice = ALGORITHMS[panel.algorithm]
    if choice.variant:
        nodes = _by_energy(floor, panel, start, goal)
        eea = Eea(choice.variant, panel.heuristic, panel.tie)
        way = eea.search(floor, start, goal, trace=True, limit=EXPANSIONS)
    else:
        nodes = _by_distance(floor, panel, start, goal)
        astar = AStar(panel.heuristic, panel.tie, panel.seed)
        way = astar.search(floor, start, goal, trace=True, limit=EXPANSIONS)
    played = play(nodes, way, cells)
    path = way.states.tolist()
    places = [s >> floor.net.shift for s in path]
    energy = [0] + [floor.energy(way.states[: t + 1]) for t in range(1, len(path))]
    headings = [(s % floor.per_place) >> 1 for s in path]
    # facing the first step costs nothing: a quarter turn is counted from the second on
    turns = sum(TURNS[(b - a) % 4] for a, b in itertools.pairwise(headings))
    length = sum(a != b for a, b in itertools.pairwise(places))
    return {
        "panel": panel.text,
        "unit": "J" if choice.variant else "m",
        "status": status_sentence(way, len(played.rows["cell"])),
        "solved": way.status is PlanStatus.SOLVED,
        "expanded": len(played.rows["cell"]),
        "cost": way.cost,
        "energy_mj": energy[-1],
        "turns": turns,
        "length": length,
        "rows": packed(played.rows),
        "entries": packed(played.entries),
        "path": packed({"cell": [cells[p] for p in places], "heading": headings, "energy": energy}),
    }


def status_sentence(way: Way, rows: int) -> str:
    """How a search ended."""
    if way.status is PlanStatus.SOLVED:
        return f"goal reached after {rows:,} expansions"
    if way.status is PlanStatus.BUDGET_SPENT:
        return f"stopped after {rows:,} expansions, this lesson's limit"
    return f"open list empty after {rows:,} expansions: no path"


def answer(query: Query) -> dict[str, Any]:
    """The floor and every panel's trace. Raises BadInput."""
    asked = read(query)
    graph = Instance("lesson", asked.free, (), ()).graph()
    floor = Floor(graph, xu2025_costs(graph))
    width = asked.free.shape[1]
    cells = np.flatnonzero(asked.free.ravel()).tolist()
    start, goal = (int(np.searchsorted(cells, y * width + x)) for x, y in (asked.start, asked.goal))
    return {
        **floor_answer(asked.free),
        "start": list(asked.start),
        "goal": list(asked.goal),
        "panels": [play_panel(floor, panel, start, goal, cells) for panel in asked.panels],
    }


# -- the page ---------------------------------------------------------------------------------------------------------

RANDOM_20 = {"map": "20x20r20s4", "start": "0.0", "goal": "19.19"}
EMPTY_16 = {"map": "16x16", "start": "1.1", "goal": "14.12"}
TRAP = {"map": drawn(".#.", "...", "..#"), "start": "0.0", "goal": "2.2"}
CUL_DE_SAC = {
    "map": drawn(
        "....................",
        "....................",
        "....................",
        "......########......",
        ".............#......",
        ".............#......",
        ".............#......",
        ".............#......",
        ".............#......",
        "......########......",
        "....................",
        "....................",
        "....................",
    ),
    "start": "3.6",
    "goal": "17.6",
}
CLOSED_IN = {
    "map": drawn(
        "................",
        "................",
        ".........#####..",
        ".........#...#..",
        ".........#...#..",
        ".........#...#..",
        ".........#####..",
        "................",
        "................",
    ),
    "start": "2.4",
    "goal": "11.4",
}

PRESETS = (
    Preset(
        "Distance or energy",
        {**RANDOM_20, "panels": "astar.manhattan.fifo~dijkstra.zero.fifo~eea.table.lifo~eea.closed.lifo"},
        "All four find a way of the same length or nearly so, but only EEA* counts turns and starts. Compare energy "
        "and turns below the maps, then how many expansions each way of estimating needs.",
    ),
    Preset(
        "3 × 3 counterexample",
        {**TRAP, "panels": "eea.table.fifo~eea-cell.paper.fifo~eea-time.paper.fifo"},
        "Step to the end. Keyed on the cell, the search keeps one arrival at the middle, and its heading costs a turn "
        "more afterwards: 1643 J. With the heading in the state it keeps both arrivals: 1433 J.",
    ),
    Preset(
        "Tie rules",
        {**EMPTY_16, "panels": "~".join(f"astar.manhattan.{tie}" for tie in ("fifo", "lifo", "larger-g", "random7"))},
        "Without obstacles every cell of the rectangle has the same f. All ways are equally short; which one is "
        "returned, with how many turns and joules, is the tie rule's doing. A comparison must name its tie rule.",
    ),
    Preset(
        "Heuristics of distance",
        {**RANDOM_20, "panels": "~".join(f"{name}.fifo" for name in
                                         ("astar.manhattan", "astar.euclidean", "dijkstra.zero", "astar.table"))},
        "The same length each time. The larger an admissible h, the fewer cells are closed; the exact table leaves "
        "only ties.",
    ),
    Preset(
        "Heuristics of energy",
        {**RANDOM_20, "panels": "~".join(f"{name}.lifo" for name in
                                         ("dijkstra-energy.zero", "eea.paper", "eea.closed", "eea.table"))},
        "The same energy each time. Equation 11 knows no turns, the closed form one turn ahead and the start, the "
        "table all of them: it expands the states of one best way and no other.",
    ),
    Preset(
        "Cul-de-sac",
        {**CUL_DE_SAC, "panels": "astar.manhattan.fifo~astar.euclidean.fifo~eea.closed.lifo~eea.table.lifo"},
        "A straight estimate fills the pocket before it looks outside. The backward table has seen the wall already.",
    ),
    Preset(
        "No way",
        {**CLOSED_IN, "panels": "astar.manhattan.fifo~eea.closed.lifo"},
        "The open list runs empty: only then is it known that there is no path. Open the wall with a click.",
    ),
)  # fmt: skip


def increments() -> dict[str, float]:
    """Joules of one tick by its motion, at the default parameters: equation 12."""
    graph = Instance("increments", np.ones((2, 2), np.bool_), (), ()).graph()
    floor = Floor(graph, xu2025_costs(graph))
    joules = {name: float(floor.mj()[k]) / 1000 for name, k in floor.kinds.items()}
    return {
        "wait": float(floor.costs.standby_mj[0]) / 1000,
        "straight": joules["straight"],
        "turn": joules["turn"],
        "start": joules["start straight"],
        "reverse": joules["reverse"],
    }


def text() -> list[Any]:
    """What stands beside the maps."""
    joules = increments()
    formulas = {
        "wait": "Pₛ Δt",
        "straight": "μ m g d + Pₛ Δt",
        "turn": "μ m g π d / 4 + ½ I ω² + Pₛ Δt",
        "start": "½ m v² + straight",
        "reverse": "stop, two turns, start",
    }
    rows = [html.Tr([html.Td(name), html.Td(formulas[name]), html.Td(f"{joules[name]:.1f} J")]) for name in formulas]
    return [
        html.H3("Best first"),
        html.P(
            [
                "Each step takes the open node with the least ",
                html.B("f = g + h"),
                ": g is what the way to it costs, h a lower bound of what remains. Equal f: the tie rule decides, "
                "oldest first (FIFO), newest first (LIFO), larger g, or random. With h = 0 this is Dijkstra's search.",
            ]
        ),
        html.P(
            "A*: a node is a cell, g counts metres. Manhattan h = |Δx| + |Δy|; Euclidean is smaller, so it closes more."
        ),
        html.P(
            "EEA*: a node is (cell, heading, rolling or standing), g counts joules. A cell is up to eight nodes; the "
            "map shows its best, the pointer lists all. A green corner: other states of the cell are still open."
        ),
        html.H3("Increments (eq. 12)"),
        html.Table(html.Tbody(rows), className="wl-lesson-table"),
        html.P("1000 kg, d = 1 m, v = 1 m/s, Δt = 1 s, μ = 0.01, ω = π/2 rad/s, Pₛ = 30 W.", className="wl-hint"),
        html.H3("h for energy"),
        html.P(
            "Eq. 11 counts (Pₛ Δt + μ m g d) per cell of Manhattan distance. It is admissible only while a turn costs "
            "no less than a straight cell. The closed form adds the turn that must come, a reversal, and the start of "
            "a standing vehicle. The exact table is one backward search from the goal over all states."
        ),
        html.H3("The defect"),
        html.P(
            "As printed, EEA* keys its nodes on the cell, or on cell and time. The next increment depends on the "
            "heading, so two arrivals at one cell aren't interchangeable: the cheaper may be the wrong one to keep."
        ),
    ]  # fmt: skip


LESSON = Lesson(
    title="Search playback",
    summary="A*, Dijkstra and EEA* side by side on one floor that you draw: open, closed and path, step by step, with "
    "g, h and f of every cell and the energy of every way.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={
        "algorithms": {
            name: {"word": c.word, "heuristics": list(c.heuristics), "ties": list(c.ties)}
            for name, c in ALGORITHMS.items()
        },
        "heuristics": HEURISTIC_WORDS,
        "ties": TIE_WORDS,
        "headings": list(HEADINGS),
        "arrows": ["→", "↑", "←", "↓"],
        "panels": PANELS,
        "first": "astar.manhattan.fifo",
    },
)
