"""Break it: where the Soochow thesis's reservation table lets vehicles meet, and the corrected one beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from dash import html

from app.lessons.base import Lesson, Preset, Query, read_whole
from engine.build import build
from engine.errors import BadInput, unknown_name
from engine.results.runlog import MemoryLog
from engine.scenario import load
from engine.sim.judge import judge

PARTS = 4
"""Steps of the playback per tick."""
LAST_STEP = 9999
KEYS = ("case", "step")


@dataclass(frozen=True)
class Case:
    """One counterexample. word: of its button · said: what the thesis says · broken: what happens · rule: what
    prevents it.
    """

    word: str
    said: str
    broken: str
    rule: str


CASES: dict[str, Case] = {
    "swap": Case(
        "Swap",
        "The table holds (place, tick). A way that meets no entry is free of conflicts.",
        "At no tick are both in one place: they change places, through each other.",
        "Reserve the way between two places as well: who drives from u to v excludes v to u during that tick.",
    ),
    "crossing": Case(
        "Crossing diagonals",
        "With eight directions a diagonal takes as long as a straight step.",
        "The two diagonals of a block share neither a place nor a way, and meet in the middle after half a tick.",
        "Two diagonals of one block exclude each other, and none cuts a corner where somebody is.",
    ),
    "parked": Case(
        "Parked vehicle",
        "The last place of a way is entered in the table for one tick more; that is said to be enough.",
        "The vehicle is still there two ticks later, and the next way leads into it.",
        "A goal stays reserved until the vehicle's next plan leaves it.",
    ),
    "idle": Case(
        "Idle vehicle",
        "The table holds the ways of the vehicles that were planned.",
        "Who has nothing to do was never planned, is in no table, and stands in the way.",
        "Whoever stands, occupies: parked, idle and charging vehicles are reserved for good.",
    ),
    "waiting": Case(
        "Waiting at the start",
        "When the goal is taken at the arrival, begin one second later, and again, until it is free.",
        "Nobody asks whether the start is free as long as that: a vehicle planned before comes through it.",
        "A wait is reserved and checked like a motion; if it is not safe, evade.",
    ),
    "disconnected": Case(
        "Disconnected",
        "A conflict in between makes the place an obstacle, and the way is searched again.",
        "The obstacle is meant for one tick and holds for all: the floor falls apart, no way is found.",
        "Search in place and time: the place is closed only while it is taken, and waiting is a step like any other.",
    ),
    "dead-end": Case(
        "Dead-end charger",
        "At every node of a straight road only one of the two directions is allowed: no head-on traffic.",
        "Every node keeps the rule. Yet the charger is left the way it is entered, so that one comes out as one "
        "drives in.",
        "One-way must hold for each way between two places; where a dead end can't keep it, its way is reserved.",
    ),
    "battery": Case(
        "Battery from 31 %",
        "After a task, below 30 %, go to the charger.",
        "At 31 % a task of 45 s is taken and the next charger is 10 s away: it would arrive at −24 %.",
        "Take an order only when the charge covers it, the way to a charger, and a reserve.",
    ),
}
SIDES = {"thesis": True, "corrected": False}


def read(query: Query) -> str:
    """The case of an address. Raises BadInput."""
    case = query["case"]
    if case not in CASES:
        raise BadInput(unknown_name("case", case[:40], CASES))
    read_whole(query.get("step", ""), "step", 0, LAST_STEP, 0)
    return case


def playback(case: str, *, strict: bool) -> dict[str, Any]:
    """One run of a case to its end: cells tick by tick, charge, what the judge found, plans that were refused."""
    scenario = load(f"soochow2022-{case}", {"planner.parameters.strict_thesis": strict})
    log = MemoryLog()
    sim = build(scenario, recorder=log)
    sim.advance(int(scenario.time.until_s or 0))
    sim.flush()
    world = sim.world
    xy = world.cell_of_place
    width = world.width

    def cell(place: int) -> int:
        return int(xy[place][0] + width * xy[place][1])

    motions, battery = log.table("motions"), log.table("battery")
    last = sim.tick if sim.done else int(motions["t1"].max()) + 2
    ways = []
    for v in range(sim.n):
        at = np.full(last + 1, -1)
        rows = np.flatnonzero(motions["vehicle"] == v)
        start = motions["from_place"][rows[0]] if len(rows) else sim.graph.state_place[sim.fleet.state[v]]
        at[0] = cell(int(start))
        for i in rows[np.argsort(motions["t0"][rows], kind="stable")].tolist():
            at[min(int(motions["t1"][i]), last) :] = cell(int(motions["to_place"][i]))
            at[int(motions["t0"][i]) : min(int(motions["t1"][i]), last)] = cell(int(motions["from_place"][i]))
        at[at < 0] = at[0]
        charge = np.zeros(last + 1)
        mine = (battery["vehicle"] == v) & (battery["tick"] <= last)
        charge[battery["tick"][mine]] = battery["charge_mc"][mine] / sim.parts.battery.capacity_mc
        ways.append({"cells": at.tolist(), "soc": [round(float(x), 3) for x in charge]})
    events = log.table("events")
    no_way = [text for kind, text in zip(events["kind"], events["text"], strict=True) if kind == "no way"]
    breaches = [
        {"kind": str(b.kind), "tick": b.tick, "vehicles": list(b.vehicles), "text": b.text,
         "cell": cell(b.place) if b.place >= 0 else -1}
        for b in judge(log, scenario, world)
    ]  # fmt: skip
    return {"ticks": last, "done": bool(sim.done), "ways": ways, "breaches": breaches, "no_way": no_way}


@cache
def answer_of(case: str) -> dict[str, Any]:
    """The floor and both runs of a case; they are always the same."""
    scenario = load(f"soochow2022-{case}")
    world: Any = build(scenario).world
    letters = [chr(code) for code in world.cells.ravel().tolist()]
    found = {side: playback(case, strict=strict) for side, strict in SIDES.items()}
    goals = [int(x + world.width * y) for x, y in scenario.orders.goals]
    about = CASES[case]
    return {
        "width": world.width,
        "height": world.height,
        "walls": "".join("0" if place >= 0 else "1" for place in world.place_of_cell.ravel().tolist()),
        "letters": "".join(letters),
        "goals": goals,
        "word": about.word,
        "said": about.said,
        "broken": about.broken,
        "rule": about.rule,
        "scenario": scenario.name,
        "battery": case == "battery",
        "sides": found,
    }


def answer(query: Query) -> dict[str, Any]:
    """The floor and both runs. Raises BadInput."""
    return answer_of(read(query))


# -- the page ---------------------------------------------------------------------------------------------------------

PRESETS = tuple(Preset(case.word, {"case": name}, case.broken) for name, case in CASES.items())


def text() -> list[Any]:
    """What stands beside the maps."""
    return [
        html.H3("The thesis"),
        html.P(
            "Vehicles are planned in the order of their tasks. Everybody's way goes into a reservation table of places "
            "and ticks. A later way that meets the table in between is searched again around that place; one that "
            "meets it at its end begins a second later. With a one-way rule this is said to solve all collisions."
        ),
        html.H3("What you see"),
        html.P(
            "First, exactly that, executed as planned, so that what goes wrong happens. Beside it or below, the "
            "corrected planner with the same tasks on the same floor. An independent judge, which knows neither, reads "
            "both records."
        ),
        html.H3("Run it yourself"),
        html.P("Each case is a scenario: open it on the Scenarios page, or run it by the name above the maps."),
    ]


LESSON = Lesson(
    title="Break it",
    summary="Eight small floors on which a reservation table that claims to solve all collisions doesn't: the "
    "judge's verdict, the rule that prevents it, and the corrected planner beside it.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={"cases": {name: case.word for name, case in CASES.items()}, "parts": PARTS},
)
