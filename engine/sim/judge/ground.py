"""Is a run on terrain legal? Trajectories, obstacles and slopes, energy and goal, worked out anew from ground and log.

Energy of a trajectory, piece by piece over the ground (equations of Zhang et al. 2021, corrected): `skid-steer` α·L +
m·g·Δz⁺/η + turning with α of a flat metre; `skid-steer-power` the power of both sides, a side that brakes giving back
its share. Scrubbing resists a turn of curvature κ with μ_t·m·g·l/2·(1 - e^(-|κ|·scrub)). Each component is rounded up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from engine.scenario import Scenario, goal_places
from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.commands import blocks_set, held
from engine.sim.judge.energy import Samples, batteries
from engine.sim.judge.levels import accepted
from engine.sim.judge.motion import continuity, name
from engine.sim.judge.record import Record, RunLog, record_of
from engine.types import COMPONENTS, Component
from engine.world.terrain import TerrainWorld

_DEFAULTS = {
    "mu": 0.08, "g": 9.81, "standby_w": 40.0, "wheel_m": 0.165, "track_m": 0.55, "track_factor": 1.5,
    "wheelbase_m": 0.51, "torque_nm_a": 0.044, "gear": 78.0, "resistance_ohm": 0.45, "efficiency": 0.8, "mu_turn": 0.5,
    "scrub_m": 1.0, "recovery": 0.0, "printed_efficiency": 0.0,
}  # fmt: skip
_PARTS = (Component.ROLLING, Component.TURNING, Component.CLIMBING, Component.COPPER, Component.RECOVERED)
_ROUNDING = 1
"""Millijoules by which the last bit may move a component that is rounded up."""


def judge_ground(reader: RunLog, scenario: Scenario, world: TerrainWorld) -> Iterator[Breach]:
    """Every broken rule of a run on terrain."""
    r = record_of(reader, world.graph)
    given = accepted(reader)
    yield from continuity(r, world)
    ks = list(_trajectories(r, world))
    yield from _exist(r, ks, world)
    yield from _free(r, ks, reader, world)
    yield from _energy(r, ks, reader, scenario, world)
    yield from held(r, given)
    yield from blocks_set(reader, given)
    goal = [int(c["place"]) for _, c in given if c["do"] == "send"] or list(goal_places(scenario, world))
    events = reader.table("events")
    if "run done" in list(events["kind"]) and r.n and r.b[-1] != goal[-1]:
        text = f"the run is done with vehicle 0 at {name(world, r.b[-1])}; its goal is {name(world, goal[-1])}"
        yield Breach(BreachKind.GOAL, r.end, (0,), int(r.b[-1]), text)


def _trajectories(r: Record, world: TerrainWorld) -> Iterator[int]:
    """For each interval the trajectory of the cluster that it drives, -1 for none that exists, -2 where it stands."""
    c, width = world.cluster, world.width
    for i in range(r.n):
        if not r.moves[i] or not r.legal[i]:
            yield -2
            continue
        h = int(r.heading_a[i])
        (ya, xa), (yb, xb) = divmod(int(r.a[i]), width), divmod(int(r.b[i]), width)
        fits = (c.end[h] == (xb - xa, yb - ya, int(r.heading_b[i]))).all(1) & (c.kind[h] == r.primitive[i])
        found = np.flatnonzero(fits)
        yield int(found[0]) if len(found) else -1


def _exist(r: Record, ks: list[int], world: TerrainWorld) -> Iterator[Breach]:
    """Every motion is a trajectory of its heading, and lasts as long as that does."""
    ticks = np.asarray(world.graph.kind_ticks, np.int64)
    for i, k in enumerate(ks):
        if k == -2:
            continue
        t = int(r.t0[i])
        if k == -1:
            where = f"from {name(world, r.a[i])} to {name(world, r.b[i])} at tick {t}"
            yield Breach(BreachKind.EDGE, t, (0,), int(r.b[i]), f"vehicle 0 drives {where}, where no trajectory leads")
        took, right = int(r.t1[i] - r.t0[i]), int(ticks[r.primitive[i]])
        if took > right or (took < right and not r.still[i]):
            text = f"vehicle 0 takes {took} ticks for a trajectory of {right} at tick {t}"
            yield Breach(BreachKind.DURATION, t, (0,), int(r.b[i]), text)


def _free(r: Record, ks: list[int], log: RunLog, world: TerrainWorld) -> Iterator[Breach]:
    """No obstacle comes under the robot's body, and no ground is steeper than its limit."""
    obstacle = world.terrain.obstacle.copy()
    blocks = log.table("blocks")
    changes = list(zip(*(blocks[c].tolist() for c in ("tick", "place", "blocked")), strict=True))
    at = 0
    for i in sorted((i for i, k in enumerate(ks) if k >= 0), key=lambda i: int(r.t0[i])):
        t = int(r.t0[i])
        while at < len(changes) and changes[at][0] <= t:
            obstacle.flat[changes[at][1]] = bool(changes[at][2])
            at += 1
        if (found := hindrance(world, obstacle, int(r.a[i]), int(r.heading_a[i]), ks[i])) is not None:
            kind, place, what = found
            yield Breach(kind, t, (0,), place, f"vehicle 0 {what} at tick {t}")


def hindrance(
    world: TerrainWorld, obstacle: NDArray[np.bool_], place: int, h: int, k: int
) -> tuple[BreachKind, int, str] | None:
    """Why trajectory k of a heading can't be driven from a place: kind of breach, where, and in words; None if it can.

    obstacle: (H, W) what stands where.
    """
    rows, columns = world.terrain.shape
    z, cell_m = world.terrain.height_m, world.grain_m
    y0, x0 = divmod(place, columns)
    for dx, dy in world.cluster.swept[h, k, : world.cluster.n_swept[h, k]].tolist():
        x, y = x0 + dx, y0 + dy
        if not (0 <= x < columns and 0 <= y < rows):
            return BreachKind.OBSTACLE, place, "leaves the map"
        for a, b in _body(world.body_m / cell_m):
            if 0 <= x + a < columns and 0 <= y + b < rows and obstacle[y + b, x + a]:
                where = (y + b) * columns + x + a
                return BreachKind.BLOCKED, where, f"drives into an obstacle at {(x + a, y + b)}"
        west, east, south, north = max(x - 1, 0), min(x + 1, columns - 1), max(y - 1, 0), min(y + 1, rows - 1)
        across = float(z[y, east] - z[y, west]) / (east - west) / cell_m
        up = float(z[north, x] - z[south, x]) / (north - south) / cell_m
        degrees = math.degrees(math.atan(math.hypot(across, up)))
        if degrees > world.terrain.slope_limit_deg + 1e-4:
            return BreachKind.OBSTACLE, y * columns + x, f"drives at {(x, y)} on a slope of {degrees:.0f} degrees"
    return None


@lru_cache(maxsize=8)
def _body(radius_cells: float) -> tuple[tuple[int, int], ...]:
    """Cells within the body, as offsets."""
    n = math.floor(radius_cells)
    every = ((dx, dy) for dy in range(-n, n + 1) for dx in range(-n, n + 1))
    return tuple((dx, dy) for dx, dy in every if math.hypot(dx, dy) <= radius_cells)


def parts_mj(scenario: Scenario, world: TerrainWorld, place: int, h: int, k: int) -> dict[Component, int]:
    """Energy of a trajectory from a place by component, rounded up."""
    n = {**_DEFAULTS, "v_mps": scenario.motion.speed_mps, **scenario.energy.parameters}
    mass = scenario.fleet.each_mass_kg[0] + scenario.fleet.payload_kg
    joules = _joules(tuple(sorted(n.items())), mass, scenario.energy.demand, world, place, h, k)
    return {part: math.ceil(1000 * j) for part, j in zip(_PARTS, joules, strict=True)}


@lru_cache(maxsize=4096)
def _joules(
    numbers: tuple[tuple[str, float], ...], mass: float, demand: str, world: TerrainWorld, place: int, h: int, k: int
) -> tuple[float, float, float, float, float]:
    n, c = dict(numbers), world.cluster
    y0, x0 = divmod(place, world.width)
    weight, width = mass * n["g"], n["track_m"] * n["track_factor"]
    draw = n["efficiency"] if n["printed_efficiency"] else 1 / n["efficiency"]
    heat = n["resistance_ohm"] * (n["wheel_m"] / (n["torque_nm_a"] * n["gear"] * n["efficiency"])) ** 2
    spot = n["mu_turn"] * weight * n["wheelbase_m"] / 2
    z, friction = world.terrain.height_m, world.terrain.friction
    count, took = int(c.pieces[h, k]), float(c.seconds[h, k])
    if count == 0:
        turned, drag = float(c.turn_rad[h, k]), n["mu"] * float(friction[y0, x0]) * weight / 2
        if demand == "skid-steer":
            return 0.0, spot * turned * draw, 0.0, 0.0, 0.0
        lost = 2 * heat * (drag + spot / width) ** 2 * took
        return drag * turned * width * draw, spot * turned * draw, 0.0, lost, 0.0

    def height(point: NDArray[np.float64]) -> float:
        x, y = x0 + float(point[0]), y0 + float(point[1])
        i, j = min(int(x + 1e-9), world.width - 2), min(int(y + 1e-9), world.height - 2)
        u, v = min(max(x - i, 0.0), 1.0), min(max(y - j, 0.0), 1.0)
        low = float(z[j, i]) * (1 - u) + float(z[j, i + 1]) * u
        return low * (1 - v) + (float(z[j + 1, i]) * (1 - u) + float(z[j + 1, i + 1]) * u) * v

    roll = turn = climb = copper = back = 0.0
    flat, each_s = float(c.piece_m[h, k]), took / count
    for p, q, bend in zip(
        c.point[h, k, :count], c.point[h, k, 1 : count + 1], c.bend[h, k, :count].tolist(), strict=True
    ):
        rise = height(q) - height(p)
        length, middle = math.hypot(flat, rise), np.rint((p + q) / 2).astype(int)
        rub = n["mu"] * float(friction[y0 + middle[1], x0 + middle[0]])
        scrub = spot * (1 - math.exp(-abs(bend) * n["scrub_m"]))
        if demand == "skid-steer":
            roll += rub * weight * draw * length
            copper += 2 * heat * (rub * weight / 2) ** 2 / n["v_mps"] * length
            climb += weight * max(rise, 0.0) * draw
            turn += scrub * abs(bend) * flat * draw
            continue
        work = 0.0
        for outer in (1.0, -1.0):
            force = (rub * weight * flat + weight * rise) / length / 2 + outer * scrub / width
            power = force * length / each_s * (1 + outer * abs(bend) * width / 2)
            power = power * (draw if power > 0 else n["efficiency"]) + heat * force**2
            copper += min(heat * force**2, max(power, 0.0)) * each_s
            work += max(power - heat * force**2, 0.0) * each_s if power > 0 else 0.0
            back += n["recovery"] * min(power, 0.0) * each_s
        rolled = min(work, rub * weight * flat * draw)
        turned = min(work - rolled, scrub * abs(bend) * length * draw)
        roll, turn, climb = roll + rolled, turn + turned, climb + work - rolled - turned
    return roll, turn, climb, copper, back


def _energy(r: Record, ks: list[int], log: RunLog, scenario: Scenario, world: TerrainWorld) -> Iterator[Breach]:
    """Every motion's energy, and what the ledger and the battery make of them."""
    zero = dict.fromkeys(_PARTS, 0)
    parts = [
        parts_mj(scenario, world, int(r.a[i]), int(r.heading_a[i]), k) if k >= 0 else zero for i, k in enumerate(ks)
    ]
    right = np.array([sum(p.values()) for p in parts], np.int64)
    wrong = (np.abs(r.energy_mj - right) > len(_PARTS) * _ROUNDING) & r.legal
    for i in np.nonzero(wrong)[0][:REPORTED].tolist():
        t = int(r.t0[i])
        text = f"the motion of vehicle 0 at tick {t} is logged with {int(r.energy_mj[i])} mJ; {int(right[i])} are right"
        yield Breach(BreachKind.ENERGY, t, (0,), int(r.b[i]), text)
    samples = Samples(log)
    if not len(samples.tick):
        return
    yield from batteries(r, samples, log, scenario)
    if r.first_tick > 0:
        return  # what retention dropped is not there to be added up
    standby = round(scenario.energy.parameters.get("standby_w", _DEFAULTS["standby_w"]) * scenario.time.tick_s * 1000)
    for i, tick in enumerate(samples.tick.tolist()):
        share = np.clip((tick - r.t0) / np.maximum(_spans(r, world), 1), 0, 1)
        for component in Component:
            booked = int(samples.ledger[i, component])
            if component is Component.STANDBY:
                fits = booked == standby * tick or (samples.charge[i] <= 0 and booked < standby * tick)
                due = standby * tick
            else:
                each = np.array([p.get(component, 0) for p in parts])
                due = round(float((each * share).sum()))
                fits = abs(booked - due) <= _ROUNDING * (int((each != 0).sum()) + 1)
            if not fits:
                text = f"{COMPONENTS[component]} is {booked} mJ at tick {tick}; motions add up to {due} mJ"
                yield Breach(BreachKind.ENERGY, tick, (0,), -1, text)
                return


def _spans(r: Record, world: TerrainWorld) -> NDArray[np.int64]:
    """Ticks that each interval lasts, the open one too."""
    ticks = np.asarray(world.graph.kind_ticks, np.int64)
    return np.where(r.moves, ticks[r.primitive], np.maximum(r.t1 - r.t0, 1))
