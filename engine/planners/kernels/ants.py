"""A colony of ants between two places of a floor: Soochow thesis 2022, chapter 4.1, and the classic ant system.

An ant at i goes on to j with p_ij = τ_ij^α η_ij^β / Σ. What depends on the iteration only (τ^α η^β of every step) is
worked out once per iteration, so a choice is a look at the few steps of a place. Lengths are steps: the thesis lets a
diagonal take as long as a straight step. Random numbers are splitmix64, drawn in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

OFF, LITERAL, EXPONENT = 0, 1, 2
"""Inducement: none, as printed (a factor that cancels in p), or where it acts: on the exponent β."""
TIE = 1 - 1e-12
"""Choices as good as this times the best one are equally good; rounding must not decide between them."""
BEST, AT, LOST, CHOICES, EXPLOITED, RETREATS = range(6)
"""Counts of a run: steps of the best way (-1 for none), iteration that found it, ants without a way, choices."""


class Rules(NamedTuple):
    """Parameters of a colony, in the letters of the thesis.

    explore: ε0, the share of choices by roulette · xi: ξ · low, high: bounds of τ · batch: all ants that are better
    than the median lay pheromone; else only the best way so far · retreat: an ant in a dead end goes back.
    """

    ants: int
    iterations: int
    alpha: float
    beta: float
    rho: float
    q: float
    explore: float
    xi: float
    tau0: float
    low: float
    high: float
    inducement: int
    batch: bool
    retreat: bool


class Room(NamedTuple):
    """Work space of one floor. tau, weight: (P, D) · seen: (P,) · path, way: (ants, P) places and directions."""

    tau: F64
    weight: F64
    seen: I32
    path: I32
    way: NDArray[np.int8]
    length: I32
    best: I32
    best_way: NDArray[np.int8]


def new_room(places: int, directions: int, ants: int) -> Room:
    """Room for so many ants."""
    shape, each = (places, directions), (ants, places + 1)
    return Room(
        np.zeros(shape), np.zeros(shape), np.zeros(places, np.int32), np.zeros(each, np.int32),
        np.zeros(each, np.int8), np.zeros(ants, np.int32), np.zeros(places + 1, np.int32),
        np.zeros(places + 1, np.int8),
    )  # fmt: skip


class AntTrace(NamedTuple):
    """A row per iteration; empty arrays are not written.

    tau: (K, P, D) pheromone after it · way: (K, P+1) places of the best way so far, and best: its steps, -1 for none
    · shortest: of the iteration, -1 for none · mean: of the ants that arrived · lost: ants that did not.
    """

    tau: F32
    way: I32
    best: I32
    shortest: I32
    mean: F64
    lost: I32


def new_ant_trace(iterations: int, places: int = 0, directions: int = 0) -> AntTrace:
    """Room for so many iterations, and for their pheromone when places are given."""
    rows = np.int32
    return AntTrace(
        np.zeros((iterations if places else 0, places, directions), np.float32),
        np.zeros((iterations if places else 0, places + 1), rows), np.zeros(iterations, rows),
        np.zeros(iterations, rows), np.zeros(iterations), np.zeros(iterations, rows),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def draw(state):  # type: ignore[no-untyped-def]
    """(next state, number in [0, 1)): splitmix64."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    x = state
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x = x ^ (x >> np.uint64(31))
    return state, np.float64(x >> np.uint64(11)) * 2.0**-53


@njit(cache=True, nogil=True)
def weigh(step: I32, closed: U8, eta: F64, r: Rules, k: int, room: Room) -> None:
    """τ^α η^β of every step in iteration k; 0 where none leads."""
    places, ways = room.tau.shape
    induced = (1 - r.xi) / r.xi * (r.iterations - k) / r.iterations
    power = r.beta * induced if r.inducement == EXPONENT else r.beta
    factor = induced if r.inducement == LITERAL else 1.0
    for i in range(places):
        for d in range(ways):
            j = step[i, d]
            if j == places or closed[j]:
                room.weight[i, d] = 0.0
            else:
                room.weight[i, d] = room.tau[i, d] ** r.alpha * (factor * eta[j]) ** power


@njit(cache=True, nogil=True)
def walk(step, closed, start, goal, r, room, ant, stamp, state, out):  # type: ignore[no-untyped-def]
    """(random state, steps of one ant's way, or -1 when it is lost)."""
    places, ways = room.tau.shape
    path, way, seen, weight = room.path[ant], room.way[ant], room.seen, room.weight
    path[0], seen[start] = start, stamp
    n, at = 0, start
    while at != goal:
        total, top, last = 0.0, -1.0, -1
        for d in range(ways):
            j = step[at, d]
            if j < places and seen[j] != stamp and not closed[j]:
                total += weight[at, d]
                top, last = max(top, weight[at, d]), d
        if last < 0:
            if not r.retreat or n == 0:
                return state, -1
            n -= 1
            at = path[n]
            out[RETREATS] += 1
            continue
        state, u = draw(state)
        exploit = u >= r.explore
        bar = top * TIE
        if not exploit:
            state, u = draw(state)
            bar = u * total
        run, chosen = 0.0, last
        for d in range(ways):
            j = step[at, d]
            if j < places and seen[j] != stamp and not closed[j]:
                run = weight[at, d] if exploit else run + weight[at, d]
                if run >= bar if exploit else run > bar:
                    chosen = d
                    break
        out[CHOICES] += 1
        out[EXPLOITED] += exploit
        way[n] = chosen
        at = step[at, chosen]
        n += 1
        path[n], seen[at] = at, stamp
    return state, n


@njit(cache=True, nogil=True)
def lay(room: Room, r: Rules, best: int) -> None:
    """Evaporation everywhere, then pheromone on the ways of the better ants, then the bounds."""
    places, ways = room.tau.shape
    for i in range(places):
        for d in range(ways):
            room.tau[i, d] *= 1 - r.rho
    if r.batch:
        home = np.sort(room.length[room.length >= 0])
        if len(home):
            middle = (home[(len(home) - 1) // 2] + home[len(home) // 2]) / 2
            better = 0
            for a in range(r.ants):
                better += 0 <= room.length[a] < middle
            for a in range(r.ants):
                n = room.length[a]
                # all equally long: one of them speaks for all
                if 0 <= n < middle or (better == 0 and n == home[0]):
                    amount = r.rho * r.q / (max(better, 1) * max(n, 1))
                    for t in range(n):
                        room.tau[room.path[a, t], room.way[a, t]] += amount
                    if better == 0:
                        break
    elif best > 0:
        for t in range(best):
            room.tau[room.best[t], room.best_way[t]] += r.rho * r.q / best
    for i in range(places):
        for d in range(ways):
            room.tau[i, d] = min(max(room.tau[i, d], r.low), r.high)


@njit(cache=True, nogil=True)
def colony(
    step: I32, closed: U8, eta: F64, start: int, goal: int, r: Rules, seed: int, room: Room, trace: AntTrace, out: I64
) -> None:
    """Runs a colony; the best way is left in room.best, the counts in out (6,).

    step: (P+1, D) neighbours, P for none · closed: (P,) places not to be entered · eta: (P,) inducement of a place.
    """
    room.tau[:] = r.tau0
    room.seen[:] = 0
    out[:] = 0
    best, state = -1, np.uint64(seed)
    for k in range(r.iterations):
        weigh(step, closed, eta, r, k, room)
        lost, shortest, total = 0, -1, 0
        for a in range(r.ants):
            state, n = walk(step, closed, start, goal, r, room, a, k * r.ants + a + 1, state, out)
            room.length[a] = n
            if n < 0:
                lost += 1
                continue
            total += n
            if shortest < 0 or n < shortest:
                shortest = n
            if best < 0 or n < best:
                best = n
                out[AT] = k + 1
                room.best[: n + 1] = room.path[a, : n + 1]
                room.best_way[:n] = room.way[a, :n]
        lay(room, r, best)
        out[LOST] += lost
        if len(trace.best):
            trace.best[k], trace.shortest[k], trace.lost[k] = best, shortest, lost
            trace.mean[k] = total / max(r.ants - lost, 1)
        if len(trace.tau):
            trace.tau[k] = room.tau
            trace.way[k] = room.best
    out[BEST] = best
