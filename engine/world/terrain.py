"""Terrain as a floor: ground, what of it is known beforehand, and the state lattice on which a robot drives.

Places are the cells, row by row from the bottom; states are (cell, heading), place · 16 + heading. The motions that
lead from one to another are the cluster's templates with offsets, so the motion graph lists no edges: on 300 × 300
cells and 16 headings they would take a gigabyte.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name
from engine.types import NONE, PRIMITIVE_0, Occupancy
from engine.world.floor import World
from engine.world.lattice import HEADINGS, Cluster, cluster
from engine.world.motion_graph import MotionGraph, Primitive
from engine.world.relief import Terrain, coarse

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

PRIORS = ("full", "coarse", "none")
"""What is known of the ground before a sensor has seen it: all, a coarse map of its heights, or nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainPlan:
    """Terrain as asked for.

    speed_mps, turn_rate: most that the robot drives and turns (rad/s) · cluster: preset of trajectories · body_m:
    radius of the disc that stands for the robot's body · sensor_m: how far it sees · prior: one of PRIORS · coarse_m:
    blocks of the coarse map.
    """

    terrain: Terrain
    tick_s: float
    speed_mps: float = 0.5
    turn_rate: float = math.pi / 8
    cluster: str = "figure4"
    body_m: float = 0.4
    sensor_m: float = 4.0
    prior: str = "coarse"
    coarse_m: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class TerrainWorld(World):
    """Compiled terrain of H × W cells."""

    terrain: Terrain = field(repr=False)
    cluster: Cluster = field(repr=False)
    prior_m: F32 = field(repr=False)  # (H, W) heights as they are known beforehand
    known: Mask = field(repr=False)  # (H, W) cells that are known beforehand as they are
    body_m: float
    sensor_m: float

    @property
    def width(self) -> int:
        return self.terrain.shape[1]

    @property
    def height(self) -> int:
        return self.terrain.shape[0]

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres."""
        return self.width * self.grain_m, self.height * self.grain_m

    @property
    def grain_m(self) -> float:
        """The side of a cell."""
        return self.terrain.cell_m

    def place_at(self, x: int, y: int) -> int:
        """The place of cell (x, y), or -1 outside."""
        return y * self.width + x if 0 <= x < self.width and 0 <= y < self.height else NONE

    def label(self, place: int) -> str:
        """`cell (3, 5)`."""
        y, x = divmod(place, self.width)
        return f"cell ({x}, {y})"

    def trajectory(self, place: int, heading: int, to_place: int, to_heading: int, kind: int) -> int:
        """Number of the trajectory of a kind that leads from one state to another, or -1."""
        y, x = divmod(place, self.width)
        to_y, to_x = divmod(to_place, self.width)
        return _by_end(self.cluster).get((heading, to_heading, to_x - x, to_y - y, kind), NONE)

    def along(self, place: int, heading: int, k: int, share: float) -> tuple[float, float]:
        """Where in metres the robot is when it has driven a share (0…1) of trajectory k from a state."""
        y, x = divmod(place, self.width)
        n = int(self.cluster.pieces[heading, k])
        points, at = self.cluster.point[heading, k, : n + 1], np.arange(n + 1) / max(n, 1)
        dx, dy = (float(np.interp(share, at, points[:, i])) for i in range(2))
        return (x + 0.5 + dx) * self.grain_m, (y + 0.5 + dy) * self.grain_m

    def floor_json(self) -> dict[str, Any]:
        """What a browser needs to draw the ground; fields per cell row by row from the bottom, in base64.

        heights, prior: as they are and as they are known beforehand (null where all is known), as `packed` · friction:
        hundredths, uint16 · cluster: (16, K, 3) ends and (16, K) lists of points, as offsets in cells.
        Places are the cells, and are not listed.
        """
        cluster = self.cluster
        points = [
            [np.round(cluster.point[h, k, : cluster.pieces[h, k] + 1], 3).tolist() for k in range(cluster.size)]
            for h in range(HEADINGS)
        ]
        letters = np.where(self.terrain.obstacle, "#", ".")
        return {
            "kind": "terrain",
            "width": self.width,
            "height": self.height,
            "cell_m": self.grain_m,
            "cells": ["".join(row) for row in letters],
            "heights": packed(self.terrain.height_m),
            "prior": None if self.known.all() else packed(self.prior_m),
            "friction": _base64(self.terrain.friction * 100),
            "slope_limit_deg": self.terrain.slope_limit_deg,
            "sensor_m": self.sensor_m,
            "body_m": self.body_m,
            "cluster": {"ends": cluster.end.tolist(), "points": points},
            "stations": [],
            "chargers": [],
            "parking": [],
            "one_way": [],
        }


def packed(heights: F32) -> dict[str, Any]:
    """Heights for a browser: low_m + unit_m · data, data uint16 row by row from the bottom, in base64."""
    low = float(heights.min())
    unit = max(float(heights.max()) - low, 1e-6) / 65535
    return {"low_m": low, "unit_m": unit, "data": _base64((heights - low) / unit)}


def _base64(values: NDArray[Any]) -> str:
    """Numbers as uint16, as near as it holds them, in base64."""
    return base64.b64encode(np.clip(np.rint(values), 0, 65535).astype("<u2").tobytes()).decode("ascii")


@lru_cache(maxsize=8)
def _by_end(cluster: Cluster) -> dict[tuple[int, int, int, int, int], int]:
    """Trajectories by (heading, heading at the end, dx, dy, kind)."""
    found = {}
    for h, k in np.ndindex(HEADINGS, cluster.size):
        dx, dy, to = cluster.end[h, k].tolist()
        found[(h, to, dx, dy, int(cluster.kind[h, k]))] = k
    return found


def disc(radius_cells: float) -> NDArray[np.int32]:
    """(N, 2) offsets (dx, dy) of cells within a radius."""
    n = math.floor(radius_cells)
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    near = x * x + y * y <= radius_cells * radius_cells
    return np.stack([x[near], y[near]], 1).astype(np.int32)


def build_terrain(plan: TerrainPlan) -> TerrainWorld:
    """Compile terrain. Raises BadInput with one sentence when it is wrong."""
    terrain = plan.terrain
    if plan.prior not in PRIORS:
        raise BadInput(unknown_name("prior", plan.prior, PRIORS))
    templates = cluster(plan.cluster, terrain.cell_m, plan.speed_mps, plan.turn_rate, plan.tick_s)
    needed = (templates.reach + 1) * terrain.cell_m + plan.body_m
    if plan.sensor_m < needed - 1e-9:
        raise BadInput(
            f"got a sensor of {plan.sensor_m:g} m, expected at least {needed:.1f} m: so far a trajectory leads"
        )
    known = np.full(terrain.shape, plan.prior == "full", np.bool_)
    if plan.prior == "full":
        prior = terrain.height_m
    elif plan.prior == "coarse":
        prior = coarse(terrain.height_m, terrain.cell_m, plan.coarse_m)
    else:
        prior = np.full(terrain.shape, terrain.height_m.mean(), np.float32)
    graph = _graph(terrain, templates)
    height, width = terrain.shape
    nothing = np.zeros(0, np.int32)
    return TerrainWorld(
        graph=graph,
        occupancy=Occupancy.HOLD,
        margin_ticks=0,
        stations=(),
        chargers=nothing,
        parking=nothing,
        access=np.full(graph.n_places, NONE, np.int32),
        endpoint=np.zeros(graph.n_places, np.bool_),
        names=tuple(f"({x}, {y})" for y in range(height) for x in range(width)),
        terrain=terrain,
        cluster=templates,
        prior_m=prior,
        known=known,
        body_m=plan.body_m,
        sensor_m=plan.sensor_m,
    )


def _graph(terrain: Terrain, templates: Cluster) -> MotionGraph:
    """Places, states and kinds of motion; no edges."""
    height, width = terrain.shape
    n = height * width
    if len(templates.kind_name) > 127 - int(PRIMITIVE_0):
        raise BadInput(f"a cluster has at most {127 - int(PRIMITIVE_0)} kinds of trajectories")
    y, x = np.divmod(np.arange(n), width)
    none, ptr = np.zeros(0, np.int32), np.zeros(n * HEADINGS + 1, np.int32)
    state = np.arange(n * HEADINGS, dtype=np.int32)
    primitives = tuple(
        Primitive(name, float(mm), 0, False, mm == 0, int(ticks))
        for name, mm, ticks in zip(
            templates.kind_name, templates.kind_mm.tolist(), templates.kind_ticks.tolist(), strict=True
        )
    )
    return MotionGraph(
        xy_m=((np.stack([x, y], 1) + 0.5) * terrain.cell_m).astype(np.float32),
        place_ptr=np.arange(0, n * HEADINGS + 1, HEADINGS, dtype=np.int32),
        state_place=state // HEADINGS,
        state_heading=(state % HEADINGS).astype(np.int8),
        state_moving=np.zeros(n * HEADINGS, np.int8),
        stopped=state,
        edge_ptr=ptr,
        edge_from=none,
        edge_to=none,
        edge_kind=np.zeros(0, np.int8),
        edge_twin=none,
        sweep_ptr=np.zeros(1, np.int32),
        sweep=none,
        rev_ptr=ptr,
        rev_edge=none,
        arc_ticks=np.zeros(n, np.int32),
        heading_deg=tuple(h * 360 / HEADINGS for h in range(HEADINGS)),
        primitives=primitives,
        kind_ticks=templates.kind_ticks,
        kind_mm=templates.kind_mm,
    )
