"""Timed plans on a motion graph, as classical multi-agent path finding writes them: a place per tick and vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from engine.sim.judge.breach import Breach, BreachKind, in_order
from engine.types import Occupancy
from engine.world.motion_graph import MotionGraph


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
