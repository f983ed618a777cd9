"""Timed plans as classical multi-agent path finding writes them: a place per tick and vehicle; and plan files, whose
energies and costs are counted anew from the cells alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from engine.scenario.plan_file import HEADINGS, PlanFile, PlanVehicle
from engine.sim.judge.breach import Breach, BreachKind, in_order
from engine.sim.judge.energy import xu2025_joules
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph, Primitive

STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""One cell in each of HEADINGS, y upwards."""


def judge_plan(
    graph: MotionGraph,
    paths: Sequence[Sequence[int]] | NDArray[np.integer],
    *,
    starts: Sequence[int] | None = None,
    goals: Sequence[int] | None = None,
    occupancy: Occupancy = Occupancy.MAPF,
    blocked: Iterable[int] = (),
) -> list[Breach]:
    """Breaches of a plan in which every motion takes one tick.

    paths: per vehicle the place at tick 0, 1, 2 …; who has arrived rests there, so lengths may differ · starts, goals:
    where each path must begin and end · blocked: places that may not be entered. Headings are free. mapf: no two in one
    place, no swaps, no crossing diagonals, following allowed; hold: also the place just being left is closed.
    """
    if len(paths) == 0:
        return []
    longest = max(len(path) for path in paths)
    at = np.stack([_rested(np.asarray(path, np.int64), longest) for path in paths])
    found = [*_ends(at, paths, starts, goals)]
    legal = (at >= 0) & (at < graph.n_places)
    for v, t in np.argwhere(~legal).tolist():
        found.append(Breach(BreachKind.OBSTACLE, t, (v,), int(at[v, t]), f"vehicle {v} is at no place at tick {t}"))
    at = np.where(legal, at, -1 - np.arange(len(at))[:, None])  # never equal to anybody's
    found += _steps(graph, at, set(blocked))
    found += _meetings(graph, at, occupancy)
    return in_order(found)


def judge_plan_file(plan: PlanFile) -> list[Breach]:
    """Breaches of a plan file: of the rules of motion, and of what it says of its energy and cost."""
    instance = plan.instance()
    graph = instance.graph()
    ys, xs = np.nonzero(instance.free)
    place = {cell: p for p, cell in enumerate(zip(xs.tolist(), ys.tolist(), strict=True))}
    paths = [[place.get(plan.up(cell), -1) for cell in vehicle.path] for vehicle in plan.vehicles]
    ends = [[place[cell] for cell in cells] for cells in (instance.starts, instance.goals)]
    found = judge_plan(graph, paths, starts=ends[0], goals=ends[1])
    return in_order([*found, *_claims(plan, {p.name: p for p in graph.primitives})])


def _claims(plan: PlanFile, primitives: dict[str, Primitive]) -> Iterator[Breach]:
    last = max(len(vehicle.path) for vehicle in plan.vehicles) - 1
    energies = [path_mj(vehicle, plan.energy, primitives) for vehicle in plan.vehicles]
    for v, (vehicle, right) in enumerate(zip(plan.vehicles, energies, strict=True)):
        if right is not None and right != vehicle.energy_mj:
            text = f"vehicle {v} is said to use {vehicle.energy_mj} mJ; {right} are right"
            yield Breach(BreachKind.ENERGY, last, (v,), -1, text)
    ticks = sum(len(vehicle.path) - 1 for vehicle in plan.vehicles)
    if plan.objective == "time" and plan.cost != ticks:
        text = f"the plan is said to cost {plan.cost} ticks; {ticks} are right"
        yield Breach(BreachKind.DURATION, last, (), -1, text)
    total = sum(e for e in energies if e is not None)
    if plan.objective == "energy" and None not in energies and plan.cost != total:
        yield Breach(BreachKind.ENERGY, last, (), -1, f"the plan is said to cost {plan.cost} mJ; {total} are right")


def path_mj(vehicle: PlanVehicle, energy: Mapping[str, float], primitives: dict[str, Primitive]) -> int | None:
    """Energy of a path from its cells alone; None when it leaps. Waits keep the heading and cost standby."""
    standby = round(energy["standby_w"] * 1000)
    facing, moving, total = HEADINGS.index(vehicle.heading), False, 0
    for (x, y), (x2, y2) in pairwise(vehicle.path):
        total += standby
        step = (x2 - x, y - y2)
        if step == (0, 0):
            moving = False
            continue
        if step not in STEPS:
            return None
        ahead = STEPS.index(step)
        turn = ("straight", "turn", "reverse", "turn")[(ahead - facing) % 4]
        motion = primitives[turn if moving else f"start {turn}"]
        parts = xu2025_joules(motion, vehicle.mass_kg, energy, energy["v_mps"])
        total += sum(round(joules * 1000) for joules in parts.values())
        facing, moving = ahead, True
    return total


def _rested(path: NDArray[np.int64], length: int) -> NDArray[np.int64]:
    return np.concatenate([path, np.full(length - len(path), path[-1] if len(path) else -1)])


def _ends(
    at: NDArray[np.int64],
    paths: Sequence[Sequence[int]] | NDArray[np.integer],
    starts: Sequence[int] | None,
    goals: Sequence[int] | None,
) -> Iterator[Breach]:
    for tick, wanted, word in ((0, starts, "begins"), (at.shape[1] - 1, goals, "ends")):
        if wanted is not None and len(wanted) != len(paths):
            text = f"the plan has {len(paths)} vehicles; {len(wanted)} were expected"
            yield Breach(BreachKind.GOAL, tick, (), -1, text)
            continue
        for v, place in enumerate(wanted or ()):
            if at[v, tick] != place:
                text = f"vehicle {v} {word} at place {int(at[v, tick])} instead of {place}"
                yield Breach(BreachKind.GOAL, tick, (v,), int(at[v, tick]), text)


def _steps(graph: MotionGraph, at: NDArray[np.int64], blocked: set[int]) -> Iterator[Breach]:
    n = graph.n_places
    ways = set((graph.state_place[graph.edge_from].astype(np.int64) * n + graph.state_place[graph.edge_to]).tolist())
    moved = np.argwhere((at[:, 1:] != at[:, :-1]) & (at[:, 1:] >= 0) & (at[:, :-1] >= 0))
    for v, t in moved.tolist():
        a, b = int(at[v, t]), int(at[v, t + 1])
        if a * n + b not in ways:
            one_way = b * n + a in ways
            kind = BreachKind.ONE_WAY if one_way else BreachKind.EDGE
            why = "against the one-way rule" if one_way else "where no way leads"
            yield Breach(kind, t, (v,), b, f"vehicle {v} drives from place {a} to {b} at tick {t}, {why}")
        if b in blocked:
            yield Breach(BreachKind.BLOCKED, t, (v,), b, f"vehicle {v} drives into blocked place {b} at tick {t}")


def _meetings(graph: MotionGraph, at: NDArray[np.int64], occupancy: Occupancy) -> Iterator[Breach]:
    corners = _corners(graph)
    for t in range(at.shape[1]):
        now = at[:, t]
        where: dict[int, list[int]] = {}
        for v, place in enumerate(now.tolist()):
            for w in where.get(place, ()):
                text = f"vehicles {w} and {v} are both at place {place} at tick {t}"
                yield Breach(BreachKind.VERTEX, t, (w, v), place, text)
            where.setdefault(place, []).append(v)
        if t + 1 == at.shape[1]:
            return
        then = at[:, t + 1]
        diagonals: dict[frozenset[int], list[int]] = {}
        for v in np.nonzero(now != then)[0].tolist():
            a, b = int(now[v]), int(then[v])
            for w in where.get(b, ()):
                if then[w] == a and v < w:
                    text = f"vehicles {v} and {w} drive through each other between places {a} and {b} at tick {t}"
                    yield Breach(BreachKind.SWAP, t, (v, w), b, text)
                elif then[w] not in (a, b) and occupancy == Occupancy.HOLD:
                    text = f"vehicle {v} drives into place {b} at tick {t} while vehicle {w} is leaving it"
                    yield Breach(BreachKind.VERTEX, t, (min(v, w), max(v, w)), b, text)
            if (a, b) in corners:
                for w in diagonals.get(corners[a, b], ()):
                    text = f"vehicles {w} and {v} cross each other's diagonal at tick {t}"
                    yield Breach(BreachKind.CROSSING, t, (w, v), b, text)
                diagonals.setdefault(frozenset((a, b)), []).append(v)


def _corners(graph: MotionGraph) -> dict[tuple[int, int], frozenset[int]]:
    """The two corners that a diagonal from one place to another passes over."""
    edges = np.nonzero(np.diff(graph.sweep_ptr) == 2)[0]
    a = graph.state_place[graph.edge_from[edges]].tolist()
    b = graph.state_place[graph.edge_to[edges]].tolist()
    first = graph.sweep_ptr[edges]
    c, d = graph.sweep[first].tolist(), graph.sweep[first + 1].tolist()
    return {(i, j): frozenset((k, m)) for i, j, k, m in zip(a, b, c, d, strict=True)}
