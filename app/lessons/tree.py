"""The constraint tree: conflict-based search on a few vehicles, node by node, from the traces of the solvers."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from dash import html
from numpy.typing import NDArray

from app.lessons.base import (
    Cell,
    Lesson,
    Mask,
    Preset,
    Query,
    check_cell,
    drawn,
    floor_answer,
    read_cell,
    read_floor,
    read_whole,
)
from engine.errors import BadInput, unknown_name
from engine.planners.cbs import CBS, lifted
from engine.planners.ecbs import ECBS
from engine.planners.kernels import cbs_high as high
from engine.planners.oneshot import Limits, Problem, Solution
from engine.planners.problems import problem_of
from engine.planners.single import Floor
from engine.scenario.movingai import Instance
from engine.types import PlanStatus

EXPANSIONS = 300
"""Nodes of the tree that a lesson expands."""
LOW_LEVEL = 1_000_000
"""Expansions of the searches below it."""
SIDE = 20
FLEET = (2, 5)
PLAN = "plan"
"""In place of a node: the plan that the search returned."""
LAST = 99_999
KEYS = ("map", "vehicles", "planner", "on", "w", "rule", "mass", "step", "node", "time")

PLANNERS = {"cbs": "CBS: least sum of arrival times", "ecbs": "E-CBS: least total energy"}
SWITCHES = {
    "disjoint": "disjoint splitting",
    "cardinal": "cardinal conflicts first",
    "bypass": "bypass",
    "target": "target reasoning",
    "pairs": "tree heuristic (bounds of pairs)",
    "incumbent": "first plan by priorities",
}
FACTORS = ("1", "1.05", "1.2", "1.5")
RULES = {"A": "A: both children, lower priority first", "B": "B: only the lower vehicle is constrained"}
MASSES = {"equal": (1000.0,), "mixed": (2000.0, 2200.0, 2350.0, 2500.0)}
MASS_WORDS = {"equal": "1000 kg each", "mixed": "2000, 2200, 2350, 2500 kg"}

# Workspaces of the solvers are kept from call to call and serve one at a time.
_ONE_AT_A_TIME = threading.Lock()


class Asked(NamedTuple):
    """A checked state. on: the switches that are on."""

    instance: Instance
    planner: str
    on: frozenset[str]
    w: float
    rule: str
    mass: str


def read(query: Query) -> Asked:
    """The state of an address. Raises BadInput."""
    trips = query["vehicles"].split("~")
    if not FLEET[0] <= len(trips) <= FLEET[1]:
        raise BadInput(f"vehicles: {FLEET[0]} to {FLEET[1]} were expected, got {len(trips)}")
    ends: list[tuple[Cell, Cell]] = []
    for k, trip in enumerate(trips):
        start, _, goal = trip.partition("-")
        ends.append((read_cell(start, f"start of vehicle {k}"), read_cell(goal, f"goal of vehicle {k}")))
    free = read_floor(query["map"], [cell for trip in ends for cell in trip])
    if max(free.shape) > SIDE:
        raise BadInput(f"map: at most {SIDE} × {SIDE} cells were expected in this lesson, got {free.shape[1]} × "
                       f"{free.shape[0]}")  # fmt: skip
    _check_ends(ends, free)
    for what, value, known in (
        ("planner", query["planner"], PLANNERS),
        ("w", query["w"], FACTORS),
        ("priority rule", query["rule"], RULES),
        ("mass", query["mass"], MASSES),
    ):
        if value not in known:
            raise BadInput(unknown_name(what, value[:40], known))
    on = frozenset(query["on"].split(".")) - {"", "none"}
    if odd := sorted(on - SWITCHES.keys()):
        raise BadInput(unknown_name("switch", odd[0][:40], SWITCHES))
    if query.get("node") != PLAN:
        read_whole(query.get("node", ""), "node", 0, LAST, 0)
    for key in ("step", "time"):
        read_whole(query.get(key, ""), key, 0, LAST, 0)
    instance = Instance("lesson", free, tuple(s for s, _ in ends), tuple(g for _, g in ends))
    return Asked(instance, query["planner"], on, float(query["w"]), query["rule"], query["mass"])


def _check_ends(ends: Sequence[tuple[Cell, Cell]], free: Mask) -> None:
    for which, word in enumerate(("start", "goal")):
        seen: dict[Cell, int] = {}
        for k, trip in enumerate(ends):
            cell = trip[which]
            check_cell(cell, f"{word} of vehicle {k}", free)
            if cell in seen:
                raise BadInput(f"vehicles {seen[cell]} and {k} have one {word}, {cell[0]}.{cell[1]}")
            seen[cell] = k


def solver(asked: Asked) -> CBS | ECBS:
    """The planner with its switches."""
    on = asked.on
    if asked.planner == "cbs":
        return CBS(
            w=asked.w, disjoint="disjoint" in on, cardinal="cardinal" in on, bypass="bypass" in on,
            target="target" in on, cover=3 if "pairs" in on else 0, tries=2 if "incumbent" in on else 0,
        )  # fmt: skip
    return ECBS(
        w=asked.w, priority_branch=asked.rule == "B", disjoint="disjoint" in on, cardinal="cardinal" in on,
        bypass="bypass" in on, target="target" in on, pairs="pairs" in on, tries=8 if "incumbent" in on else 0,
    )  # fmt: skip


# -- the tree as a person reads it ------------------------------------------------------------------------------------

Columns = Mapping[str, NDArray[Any]]


class Words:
    """Sentences about one traced tree."""

    def __init__(self, tree: Columns, cells: Sequence[int], width: int, energy: bool, w: float):
        self.tree = {name: column.tolist() for name, column in tree.items()}
        self.cells, self.width, self.energy, self.w = cells, width, energy, w

    def at(self, place: int) -> str:
        cell = self.cells[place]
        return f"({cell % self.width}, {cell // self.width})"

    def cost(self, value: int) -> str:
        return f"{value / 1000:,.1f} J" if self.energy else f"{value} steps"

    def constraint(self, k: int) -> str:
        """What a node demands beyond its parent."""
        t = self.tree
        who, kind, tick = f"Vehicle {t['agent'][k]}", t["kind"][k], t["tick"][k]
        here, there = t["place"][k], t["place2"][k]
        if kind == high.ROOT:
            return "None: every vehicle takes its own best way."
        if kind == high.NOT_AT:
            return f"{who} must not be at {self.at(here)} at step {tick}."
        if kind == high.AT:
            return f"{who} must be at {self.at(here)} at step {tick}; the others must not."
        if kind == high.NOT_OVER:
            return f"{who} must not drive {self.at(here)} → {self.at(there)} at step {tick}."
        if kind == high.OVER:
            return f"{who} must drive {self.at(here)} → {self.at(there)} at step {tick}; the others keep off."
        if kind == high.LATER:
            return f"{who} must come to rest at its goal later than step {tick}."
        return f"{who} must rest at its goal by step {tick}; the others keep off it from then on."

    def short(self, k: int) -> str:
        """The same in a few signs: ≠ not at, = at, ↛ not over, ⇒ over, @ step."""
        t = self.tree
        who, kind, tick = t["agent"][k], t["kind"][k], t["tick"][k]
        if kind == high.ROOT:
            return "no constraint"
        if kind in (high.LATER, high.BY_THEN):
            return f"{who} rests {'>' if kind == high.LATER else '≤'} {tick}"
        place = self.at(t["place"][k]).replace(" ", "")
        if kind in (high.NOT_AT, high.AT):
            return f"{who} {'≠' if kind == high.NOT_AT else '='} {place} @{tick}"
        return f"{who} {'↛' if kind == high.NOT_OVER else '⇒'} {self.at(t['place2'][k]).replace(' ', '')} @{tick}"

    def conflict(self, k: int) -> dict[str, Any] | None:
        """The conflict on which a node was expanded."""
        t = self.tree
        a, b, tick = t["a"][k], t["b"][k], t["conflict_tick"][k]
        if a < 0:
            return None
        here, there = t["at"][k], t["at2"][k]
        if there < 0:
            text = f"Vehicles {a} and {b} are both at {self.at(here)} at step {tick}."
        else:
            text = (
                f"Vehicles {a} and {b} swap {self.at(here)} and {self.at(there)} between steps {tick} and {tick + 1}."
            )
        low, top = t["dp_low"][k], t["dp_high"][k]
        sign = "=" if low == top else "<"
        order = f"Dynamic priority (eq. 14): {a} has {low:.3f} {sign} {top:.3f} of {b}; {a} is constrained first."
        cells = [self.cells[here]] + ([self.cells[there]] if there >= 0 else [])
        return {"a": a, "b": b, "tick": tick, "cells": cells, "text": text, "priority": order}

    def why(self, k: int) -> str:
        """Why a node came when it came."""
        t = self.tree
        turn = t["turn"][k]
        if turn < 0:
            return {
                high.PRUNED: "Never: its f is not below the cost of a plan that is known.",
                high.ANSWER: "It need not be expanded: its plan has no conflict, and nothing open is better.",
            }.get(t["status"][k], "Not yet, when the search ended.")
        waiting = [
            j
            for j in range(len(t["node"]))
            if j != k
            and (t["parent"][j] < 0 or 0 <= t["turn"][t["parent"][j]] < turn)
            and (t["turn"][j] > turn or (t["turn"][j] < 0 and t["status"][j] != high.PRUNED))
        ]
        if not waiting:
            return "It is the only open node."
        f, few = t["f"][k], t["n_conflicts"][k]
        least = min(t["f"][j] for j in waiting)
        same = [j for j in waiting if t["f"][j] == f]
        if f > least and self.w > 1:
            return (
                f"Its cost {self.cost(t['cost'][k])} is at most w = {self.w:g} times the least f, {self.cost(least)}; "
                f"of such nodes the one with the fewest conflicts comes first ({few})."
            )
        if not same:
            return f"Least f of {len(waiting) + 1} open nodes: {self.cost(f)}; the next has {self.cost(least)}."
        fewer = all(few < t["n_conflicts"][j] for j in same)
        others = f"{len(same)} other{'s' if len(same) > 1 else ''}"
        if fewer:
            return f"Least f, {self.cost(f)}, like {others}; it has the fewest conflicts ({few})."
        return f"Least f, {self.cost(f)}, like {others}; their order in the heap decides."


def pruned_from(tree: Mapping[str, Sequence[Any]], k: int) -> int:
    """The step from which a pruned node is known to be no better than a plan; -1 for a node that isn't pruned."""
    if tree["status"][k] != high.PRUNED:
        return -1
    born = [tree["turn"][p] + 1 if p >= 0 else 0 for p in tree["parent"]]
    plans = [born[j] for j, n in enumerate(tree["n_conflicts"]) if n == 0 and tree["cost"][j] <= tree["f"][k]]
    return max(born[k], min(plans)) if plans else born[k]


def way_rows(problem: Problem, solution: Solution, cells: Sequence[int]) -> list[dict[str, Any]]:
    """Every way of one vehicle that some node's plan holds."""
    plans, ways = solution.trace["plans"], solution.trace["ways"]
    floor = Floor(problem.graph, problem.costs)
    count = int(ways["way"][-1]) + 1
    owner = np.zeros(count, np.int64)
    owner[plans["way"]] = plans["vehicle"]
    first = np.searchsorted(ways["way"], np.arange(count + 1)).tolist()
    rows = []
    for k in range(count):
        part = slice(first[k], first[k + 1])
        places, states = ways["place"][part], ways["state"][part]
        vehicle = int(owner[k])
        if states[0] < 0:
            states = lifted(problem.graph, int(problem.starts[vehicle]), places)
        rows.append(way_row(floor, states, int(problem.cls[vehicle]), cells))
    return rows


def way_row(floor: Floor, states: NDArray[np.int32], cls: int, cells: Sequence[int]) -> dict[str, Any]:
    """One way: cells and headings by step, energy in mJ."""
    places = floor.graph.state_place[states].tolist()
    headings = floor.graph.state_heading[states].tolist()
    return {"cells": [cells[p] for p in places], "headings": headings, "energy_mj": floor.energy(states, cls)}


def node_rows(words: Words) -> list[dict[str, Any]]:
    """The nodes of the tree with their sentences."""
    t = words.tree
    return [
        {
            "node": k,
            "parent": t["parent"][k],
            "turn": t["turn"][k],
            "status": t["status"][k],
            "pruned": pruned_from(t, k),
            "cost": t["cost"][k],
            "bound": t["low"][k],
            "h": t["h"][k],
            "f": t["f"][k],
            "conflicts": t["n_conflicts"][k],
            "constraint": words.constraint(k),
            "short": words.short(k),
            "positive": t["positive"][k],
            "conflict": words.conflict(k),
            "why": words.why(k),
        }
        for k in t["node"]
    ]


def ending(solution: Solution, words: Words | None, asked: Asked) -> str:
    """How the search ended."""
    if words is None or solution.status is PlanStatus.INCONSISTENT:
        return f"{solution.status.value}: {solution.note}"
    cost, bound = words.cost(solution.cost), words.cost(solution.lower_bound)
    best = f"best plan {cost}" if solution.states else "no plan yet"
    if solution.status is PlanStatus.SOLVED:
        source = (
            "" if high.ANSWER in words.tree["status"] else "; the plan came from priorities, the tree only proved it"
        )
        return f"optimal: {cost}, proven after {solution.expanded_high} expansions{source}"
    if solution.status is PlanStatus.NO_PATH:
        return f"no plan: {solution.note}"
    if solution.status is PlanStatus.BUDGET_SPENT:
        return f"stopped at this lesson's limit of {EXPANSIONS} expansions: {best}, proven to be at least {bound}"
    if asked.planner == "ecbs" and asked.rule == "B":
        return f"a plan of {cost}; rule B proves nothing beyond the root's bound {bound}"
    return f"bounded: {cost} is within w = {asked.w:g} of the proven bound {bound}"


def answer(query: Query) -> dict[str, Any]:
    """The floor, the tree, and every node's plan. Raises BadInput."""
    asked = read(query)
    problem = problem_of(asked.instance, masses_kg=MASSES[asked.mass])
    with _ONE_AT_A_TIME:
        solution = solver(asked).solve(problem, Limits(EXPANSIONS, LOW_LEVEL), trace=True)
    energy = asked.planner == "ecbs"
    free = asked.instance.free
    cells = np.flatnonzero(free.ravel()).tolist()
    found: dict[str, Any] = {"nodes": [], "ways": [], "plans": [], "answer": None}
    words = None
    if solution.trace:
        words = Words(solution.trace["tree"], cells, free.shape[1], energy, asked.w)
        ways = way_rows(problem, solution, cells)
        plans = solution.trace["plans"]["way"].reshape(-1, asked.instance.agents).tolist()
        found = {"nodes": node_rows(words), "ways": ways, "plans": plans, "answer": None}
        if solution.states:
            floor = Floor(problem.graph, problem.costs)
            found["answer"] = [
                way_row(floor, states, int(cls), cells)
                for states, cls in zip(solution.states, problem.cls.tolist(), strict=True)
            ]
    return {
        **floor_answer(free),
        "vehicles": [[list(s), list(g)] for s, g in zip(asked.instance.starts, asked.instance.goals, strict=True)],
        "unit": "J" if energy else "steps",
        "status": ending(solution, words, asked),
        "solved": bool(solution.states),
        "cost": solution.cost,
        "bound": solution.lower_bound,
        "expanded": solution.expanded_high,
        "searches": solution.expanded_low,
        **found,
    }


# -- the page ---------------------------------------------------------------------------------------------------------

FOUR = "disjoint.cardinal.bypass.target"
ALL_ON = f"{FOUR}.pairs"
COMMON = {"w": "1", "rule": "A", "mass": "equal"}
ROOM = {"map": "4x4", "vehicles": "0.0-3.3~3.0-0.3~0.3-3.0~3.3-0.0"}
RECTANGLE = {"map": "6x6", "vehicles": "0.1-5.4~1.0-4.5"}
PASSING = {"map": drawn("##.##", ".....", "##.##"), "vehicles": "0.1-4.1~4.1-0.1"}

PRESETS = (
    Preset(
        "Four in a room",
        {**ROOM, **COMMON, "planner": "ecbs", "on": FOUR},
        "Everybody's best way leads round a corner, and all meet. Switch disjoint splitting off: the same optimum "
        "needs several times the nodes, for both children allow the same plans again. Bounds of pairs halve them.",
    ),
    Preset(
        "Two cross",
        {"map": "5x5", "vehicles": "0.2-4.2~2.0-2.4", **COMMON, "planner": "ecbs", "on": "none"},
        "The smallest tree: one conflict, two children, one wait. Click the root, then move the time to the conflict.",
    ),
    Preset(
        "Rectangle",
        {**RECTANGLE, **COMMON, "planner": "cbs", "on": ALL_ON},
        "Both have many shortest ways through the same rectangle. Without any switch the tree tries them one by one; "
        "with bypass or disjoint splitting a handful of nodes suffices.",
    ),
    Preset(
        "Passing place",
        {**PASSING, **COMMON, "planner": "cbs", "on": ALL_ON},
        "Head-on in a corridor: one must step aside. In steps the tree is small. Choose E-CBS: waiting costs 30 J, a "
        "bypass over 1 kJ, so that hundreds of nodes delay before one evades.",
    ),
    Preset(
        "A goal in the way",
        {"map": drawn("###.###", ".......", "###.###"), "vehicles": "0.1-6.1~3.2-3.1", **COMMON, "planner": "cbs",
         "on": ALL_ON},
        "Vehicle 1 rests in the gap that vehicle 0 needs. Target reasoning asks one question: is it there for good "
        "before or after the other passes?",
    ),
    Preset(
        "Rule B",
        {**PASSING, **COMMON, "mass": "mixed", "rule": "B", "planner": "ecbs", "on": "none"},
        "Only the vehicle of lower priority is ever constrained. Here that branch is a dead end: rule B ends without a "
        "plan, although one exists. Choose rule A to see it.",
    ),
    Preset(
        "Bounded",
        {**ROOM, **COMMON, "mass": "mixed", "planner": "ecbs", "on": "none", "w": "1.05"},
        "With w = 1.05 the search may take any node within 5 % of the bound, the one with the fewest conflicts first. "
        "Compare the expansions with w = 1.",
    ),
)  # fmt: skip


def text() -> list[Any]:
    """What stands beside the tree."""
    return [
        html.H3("The tree"),
        html.P(
            "A node is a set of constraints and a plan: every vehicle's cheapest way under them. The root has none. "
            "The search takes the node of least f, looks for a conflict in its plan, and makes two children, each "
            "with one constraint more that forbids it. The first node without a conflict is optimal, since no child "
            "is cheaper than its parent."
        ),
        html.P(
            "CBS counts steps until each vehicle's last arrival; E-CBS counts joules, with EEA* below. f is the cost "
            "of the node's ways, plus what the tree heuristic proves that its conflicts must still cost: for CBS a "
            "cover of the dependent pairs (WDG), for E-CBS the optima of pairs."
        ),
        html.H3("What keeps it small"),
        html.Dl(
            [
                html.Dt("Disjoint splitting"),
                html.Dd("One child forbids a vehicle the place, the other demands it of the same vehicle: no plan "
                        "belongs to both."),
                html.Dt("Cardinal first"),
                html.Dd("Conflicts that neither vehicle can avoid at its present cost raise f in both children."),
                html.Dt("Bypass"),
                html.Dd("A child of equal cost with fewer conflicts gives its way to the node; nothing branches."),
                html.Dt("Target reasoning"),
                html.Dd("A resting vehicle in the way: later at its goal, or first and for good."),
                html.Dt("First plan"),
                html.Dd("Prioritized planning gives a plan at once; nodes that can't beat it are pruned."),
            ]
        ),
        html.H3("Dynamic priority (eq. 14)"),
        html.P(
            "DP = w₁ m/mₘₐₓ + w₂ (1 − done/length) − w₃ c/cₘₐₓ: heavy vehicles with a long way left and few "
            "conflicts keep their way. Rule A only orders the two children and stays optimal. Rule B drops the second."
        ),
    ]  # fmt: skip


LESSON = Lesson(
    title="Constraint tree",
    summary="CBS and E-CBS on two to five vehicles: every node with its plan, conflict, constraint, cost and "
    "priorities; switch the techniques on and off and watch the tree shrink.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={
        "planners": PLANNERS,
        "switches": SWITCHES,
        "factors": list(FACTORS),
        "rules": RULES,
        "masses": MASS_WORDS,
        "side": SIDE,
        "fleet": list(FLEET),
        "limit": EXPANSIONS,
    },
)
