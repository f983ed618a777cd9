"""What a run on terrain adds to its recording: the ground in three dimensions, and what the search did.

Below `ground`: the mesh, pale, and over it what the sensor has seen by now; obstacles; the trajectories that lead on
from where the robot stands; OPEN and INCONS at each publication; the published ways, one entity per ε; the driven path,
coloured by power; the robot, tilted as the ground is. Beside it curves of power and of the search. Lengths are metres,
z points upwards. Rows of `ground/seen` and `ground/driven` add up: the view shows all of them up to its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from engine.replay import looks
from engine.replay.recording import Part
from engine.results.schema import ENERGY_COLUMNS
from engine.types import PRIMITIVE_0
from engine.world import surface
from engine.world.lattice import HEADINGS
from engine.world.terrain import TerrainWorld

I64 = NDArray[np.int64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Strips = list[NDArray[Any]]

SIDE = 150
"""Cells along a side of the whole ground's mesh, about."""
POSE_S = 0.2
"""The robot's pose is given so often while it moves."""
FRONTIER = 2000
"""Points of OPEN and of INCONS, at most."""
OVER_M = {looks.SEEN: 0.03, looks.DRIVEN: 0.3, looks.CLUSTER: 0.34, looks.FRONTIER_OPEN: 0.1, looks.GOAL: 1.2}
"""How far above the ground things are drawn, so that it does not swallow them."""
WAY_OVER_M = 0.25
OBSTACLE_M = 0.8
"""Height that obstacles are given: maps do not tell it."""
BODY_M = (0.7, 0.56, 0.3)
"""The robot as it is drawn: length, width, height."""
TABLES = ("motions", "plans", "searches", "battery", "blocks")


class GroundRecorder:
    """Takes rows of the tables that it draws from, and sends them when told to. One robot."""

    def __init__(self, part: Part, world: TerrainWorld, tick_s: float) -> None:
        self._part, self._world, self._tick_s = part, world, tick_s
        self._height, self._cell_m = world.terrain.height_m, world.grain_m
        self._every = max(1, round(POSE_S / tick_s))
        self._rows: dict[str, list[dict[str, Any]]] = {}
        self._seen = np.zeros(self._height.shape, np.bool_)
        self._begun = False
        self._goal = -1
        self._shown: list[int] = []  # ε of the ways drawn, in thousandths, in the order of publication
        self._styled: set[int] = set()
        self._battery: tuple[int, int] | None = None  # tick and mJ of the latest sample
        self._obstacle = world.terrain.obstacle.copy()
        self._ground = _Corners(world)
        self._log_static()

    def write(self, table: str, rows: dict[str, Any]) -> None:
        """Take checked rows of one table."""
        if table in TABLES:
            self._rows.setdefault(table, []).append(rows)

    def emit(self) -> None:
        """Send what has come."""
        rows = {name: _joined(self._rows.pop(name, [])) for name in TABLES}
        self._send_motions(rows["motions"])
        self._send_searches(rows["searches"])
        self._send_ways(rows["plans"], rows["searches"], rows["motions"])
        self._send_power(rows["battery"])
        self._send_blocks(rows["blocks"])

    # ---------------------------------------------------------------- what never changes

    def _log_static(self) -> None:
        static = self._part.static
        static(looks.GROUND, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        static(looks.TERRAIN, self._ground.whole())
        static(looks.OBSTACLES, rr.Boxes3D.from_fields(colors=looks.OBSTACLE, fill_mode="solid"))
        static(looks.DROPPED, rr.Boxes3D.from_fields(colors=looks.DROPPED_COLOUR, fill_mode="solid"))
        static(looks.FRONTIER_OPEN, rr.Points3D.from_fields(colors=looks.OPEN_COLOUR, radii=0.07))
        static(looks.FRONTIER_INCONS, rr.Points3D.from_fields(colors=looks.INCONS_COLOUR, radii=0.09))
        static(looks.CLUSTER, rr.LineStrips3D.from_fields(colors=(255, 255, 255, 255), radii=0.025))
        static(looks.DRIVEN, rr.LineStrips3D.from_fields(radii=0.07))
        static(
            looks.GOAL, rr.Points3D.from_fields(colors=looks.GOAL_COLOUR, radii=0.4, labels="goal", show_labels=True)
        )
        length, width, height = BODY_M
        body = rr.Boxes3D(
            centers=[[0, 0, height / 2 + 0.1], [length * 0.36, 0, height + 0.14]],
            half_sizes=[[length / 2, width / 2, height / 2], [0.1, width / 2.4, 0.05]],
            colors=[looks.ROBOT, (16, 20, 26, 255)],
            fill_mode="solid",
        )
        static(f"{looks.ROBOT_POSE}/body", body)
        static(looks.POWER, rr.SeriesLines(names="power", colors=(248, 210, 90, 255), widths=1.5))
        for path, (name, colour) in looks.SEARCH_CURVES.items():
            line = rr.SeriesLines(names=name, colors=colour, widths=1.5, interpolation_mode="StepAfter")
            static(path, line)
        self._log_cluster()

    def _log_cluster(self) -> None:
        """All trajectories of the cluster, from every heading, around one cell; y downwards."""
        world = self._world
        colours = [looks.PALETTE[h % len(looks.PALETTE)] for h in range(HEADINGS)]
        strips, of = [], []
        for h, k in np.ndindex(HEADINGS, world.cluster.size):
            n = int(world.cluster.pieces[h, k])
            if n:
                strips.append(world.cluster.point[h, k, : n + 1] * (self._cell_m, -self._cell_m))
                of.append(colours[h])
        self._part.static(looks.ALL_TRAJECTORIES, rr.LineStrips2D(strips, colors=of, radii=0.008))

    # ---------------------------------------------------------------- where the robot is, and what it sees

    def _send_motions(self, rows: list[dict[str, Any]]) -> None:
        moments: list[int] = []
        poses: list[NDArray[Any]] = []  # x, y, heading in degrees
        ends: list[tuple[int, int, int]] = []  # tick, place, heading
        driven: list[tuple[int, NDArray[Any], float]] = []
        for row in rows:
            if not self._begun:
                self._begun = True
                self._send_boxes(looks.OBSTACLES, row["t0"], self._world.terrain.obstacle)
                ends.append((row["t0"], row["from_place"], row["from_heading"]))
                moments.append(row["t0"])
                poses.append(np.array([self._pose(row["from_place"], row["from_heading"])]))
            if row["kind"] < PRIMITIVE_0:
                continue
            way = self._way(row)
            ticks = np.append(np.arange(row["t0"] + self._every, row["t1"], self._every), row["t1"])
            share = (ticks - row["t0"]) / (row["t1"] - row["t0"])
            moments.extend(ticks.tolist())
            poses.append(_along(way, row["from_heading"], row["to_heading"], share))
            ends.append((row["t1"], row["to_place"], row["to_heading"]))
            if len(way) > 1:
                driven.append((row["t1"], way, row["energy_mj"] / 1000 / ((row["t1"] - row["t0"]) * self._tick_s)))
        if poses:
            self._send_poses(np.array(moments, np.int64), np.concatenate(poses))
            self._send_seen([(tick, place) for tick, place, _ in ends])
            self._send_cluster(ends)
        if driven:
            strips = [self._over(looks.DRIVEN, way) for _, way, _ in driven]
            columns = rr.LineStrips3D.columns(strips=strips, colors=looks.ramp([watts for *_, watts in driven]))
            ticks = np.array([tick for tick, *_ in driven], np.int64)
            self._part.send(looks.DRIVEN, ticks, columns.partition(np.ones(len(ticks), np.int64)))

    def _pose(self, place: int, heading: int) -> tuple[float, float, float]:
        x, y = self._world.graph.xy_m[place].tolist()
        return x, y, heading * 360 / HEADINGS

    def _way(self, row: Mapping[str, Any]) -> NDArray[np.float64]:
        """Points (P, 2) that a motion passes."""
        kind, to = row["kind"] - PRIMITIVE_0, (row["to_place"], row["to_heading"])
        return surface.way(self._world, row["from_place"], row["from_heading"], *to, kind)

    def _over(self, path: str, xy_m: NDArray[Any]) -> F32:
        return surface.lifted(self._height, self._cell_m, xy_m, OVER_M[path])

    def _send_poses(self, ticks: I64, poses: NDArray[Any]) -> None:
        from scipy.spatial.transform import Rotation

        middle, turned = surface.tilted(self._height, self._cell_m, poses[:, :2], poses[:, 2])
        pose = rr.Transform3D.columns(translation=middle, quaternion=Rotation.from_matrix(turned).as_quat())
        self._part.send(looks.ROBOT_POSE, ticks, pose)

    def _send_seen(self, ends: list[tuple[int, int]]) -> None:
        """The cells that each look has added, as a mesh of their own."""
        for tick, place in ends:
            new = surface.around(self._world, np.array([place])) & ~self._seen
            if new.any():
                self._seen |= new
                columns = [
                    rr.Mesh3D.columns(**{name: values}).partition([len(values)])
                    for name, values in self._ground.patch(new).items()
                ]
                self._part.send(looks.SEEN, np.array([tick], np.int64), *columns)

    def _send_cluster(self, ends: list[tuple[int, int, int]]) -> None:
        """The trajectories that lead on from each place and heading in which the robot comes to be."""
        cluster, strips, lengths = self._world.cluster, [], []
        for _, place, h in ends:
            here = [cluster.point[h, k, : n + 1] for k, n in enumerate(cluster.pieces[h].tolist()) if n]
            strips += [self._over(looks.CLUSTER, self._world.graph.xy_m[place] + p * self._cell_m) for p in here]
            lengths.append(len(here))
        columns = rr.LineStrips3D.columns(strips=strips).partition(lengths)
        self._part.send(looks.CLUSTER, np.array([tick for tick, *_ in ends], np.int64), columns)

    # ---------------------------------------------------------------- the search

    def _send_searches(self, rows: list[dict[str, Any]]) -> None:
        if not rows:
            return
        ticks = np.array([row["tick"] for row in rows], np.int64)
        for path, column in ((looks.FRONTIER_OPEN, "open_places"), (looks.FRONTIER_INCONS, "incons_places")):
            places = [row[column][:: -(-len(row[column]) // FRONTIER) or 1] for row in rows]
            points = self._over(looks.FRONTIER_OPEN, self._world.graph.xy_m[np.concatenate(places).astype(np.int64)])
            self._part.send(path, ticks, rr.Points3D.columns(positions=points).partition([len(p) for p in places]))
        curves = {
            looks.EPSILON: np.array([row["bound"] / 1000 for row in rows]),
            looks.EXPANDED: np.array([row["expanded"] for row in rows], np.float64),
            looks.SIZE_OPEN: np.array([row["open"] for row in rows], np.float64),
            looks.SIZE_INCONS: np.array([row["incons"] for row in rows], np.float64),
        }
        for path, values in curves.items():
            self._part.send(path, ticks, rr.Scalars.columns(scalars=values))

    def _send_ways(self, plans: Any, searches: Any, motions: Any) -> None:
        """A way stays until a pass with the same or a higher ε begins anew, or the robot arrives."""
        # Each publication is a row in both tables.
        bounds = {search["tick"]: search["bound"] for search in searches}
        told: list[tuple[int, int, Any]] = [
            (plan["tick"], bounds[plan["tick"]], plan["places"]) for plan in plans if plan["tick"] in bounds
        ]
        told += [(row["t1"], -1, row["to_place"]) for row in motions if row["kind"] >= PRIMITIVE_0]
        for tick, bound, what in sorted(told, key=lambda one: one[:2]):
            at = np.array([tick], np.int64)
            if bound < 0:
                if what == self._goal:
                    self._clear(at, self._shown)
                continue
            if not self._shown or bound >= self._shown[-1] or bound == 0:
                self._clear(at, [old for old in self._shown if old != bound])
            if len(what) == 0:
                continue
            if bound not in self._styled:
                self._styled.add(bound)
                style = rr.LineStrips3D.from_fields(colors=looks.epsilon_colour(bound), radii=0.06)
                self._part.static(looks.way(bound), style)
            xy = self._world.graph.xy_m[what]
            # of ways that run together the better one is on top
            strip = surface.lifted(self._height, self._cell_m, xy, WAY_OVER_M - 0.03 * bound / 1000)
            self._part.send(looks.way(bound), at, rr.LineStrips3D.columns(strips=[strip]).partition([1]))
            self._shown = [old for old in self._shown if old != bound] + [bound]
            if int(what[-1]) != self._goal:
                self._goal = int(what[-1])
                self._part.send(looks.GOAL, at, rr.Points3D.columns(positions=self._over(looks.GOAL, xy[-1:])))

    def _clear(self, at: I64, bounds: list[int]) -> None:
        for bound in bounds:
            self._part.send(looks.way(bound), at, rr.LineStrips3D.columns(strips=[]).partition([0]))
        self._shown = [old for old in self._shown if old not in bounds]

    # ---------------------------------------------------------------- power, obstacles

    def _send_power(self, rows: list[dict[str, Any]]) -> None:
        """Mean power between samples, at the later of them."""
        if not rows:
            return
        samples = [] if self._battery is None else [self._battery]
        samples += [(row["tick"], sum(row[name] for name in ENERGY_COLUMNS)) for row in rows]
        self._battery = samples[-1]
        ticks = np.array([tick for tick, _ in samples[1:]], np.int64)
        watts = np.array([(e1 - e0) / 1000 / ((t1 - t0) * self._tick_s) for (t0, e0), (t1, e1) in pairwise(samples)])
        self._part.send(looks.POWER, ticks, rr.Scalars.columns(scalars=watts))

    def _send_blocks(self, rows: list[dict[str, Any]]) -> None:
        first = self._world.terrain.obstacle
        for row in rows:
            y, x = divmod(row["place"], self._world.width)
            self._obstacle[y, x] = row["blocked"] > 0
            if first[y, x]:
                self._send_boxes(looks.OBSTACLES, row["tick"], first & self._obstacle)
            else:
                self._send_boxes(looks.DROPPED, row["tick"], self._obstacle & ~first)

    def _send_boxes(self, path: str, tick: int, mask: NDArray[np.bool_]) -> None:
        """Rectangles of cells as boxes that stand on the ground."""
        of = surface.boxes(mask)
        low, high = of[:, :2] * self._cell_m, of[:, 2:] * self._cell_m
        centres = surface.lifted(self._height, self._cell_m, (low + high) / 2, OBSTACLE_M / 2 - 0.2)
        halves = np.column_stack([(high - low) / 2, np.full(len(of), OBSTACLE_M / 2 + 0.2)])
        columns = rr.Boxes3D.columns(centers=centres, half_sizes=halves).partition([len(of)])
        self._part.send(path, np.array([tick], np.int64), columns)


class _Corners:
    """The ground as the corners of its cells: positions and colours, bright and pale."""

    def __init__(self, world: TerrainWorld) -> None:
        terrain, cell = world.terrain, world.grain_m
        self.shape = (world.height + 1, world.width + 1)
        y, x = np.mgrid[: self.shape[0], : self.shape[1]]
        self.xyz = surface.lifted(terrain.height_m, cell, np.stack([x.ravel(), y.ravel()], 1) * cell)
        height = self.xyz[:, 2].reshape(self.shape)
        light = surface.shade(height, cell)
        rough = terrain.friction[np.minimum(y, world.height - 1), np.minimum(x, world.width - 1)]
        self.bright = looks.ground_colours(height, light, rough).reshape(-1, 4)
        self.pale = looks.pale(self.bright)

    def whole(self) -> rr.Mesh3D:
        """All of it, coarse and pale."""
        rows, columns = (surface.every(n, SIDE + 1) for n in self.shape)
        corner = rows[:, None] * self.shape[1] + columns
        triangle = _triangles(corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:])
        return rr.Mesh3D(**self._mesh(triangle, self.pale, 0.0))

    def patch(self, cells: NDArray[np.bool_]) -> dict[str, Any]:
        """Some cells, bright: arguments of a mesh."""
        y, x = np.nonzero(cells)
        first = y * self.shape[1] + x
        above = first + self.shape[1]
        return self._mesh(_triangles(first, first + 1, above, above + 1), self.bright, OVER_M[looks.SEEN])

    def _mesh(self, triangle: I64, colour: U8, above_m: float) -> dict[str, Any]:
        used, index = np.unique(triangle, return_inverse=True)
        return {
            "vertex_positions": self.xyz[used] + np.array([0, 0, above_m], np.float32),
            "triangle_indices": index.reshape(-1, 3).astype(np.uint32),
            "vertex_colors": colour[used],
        }


def _triangles(a: I64, b: I64, c: I64, d: I64) -> I64:
    """(2 N, 3) the two triangles of each rectangle: a, b its lower corners, c, d its upper ones."""
    return np.stack([a, b, d, a, d, c], -1).reshape(-1, 3)


def _along(way: NDArray[np.float64], heading: int, to: int, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) x, y and heading in degrees after shares of a motion; it turns along the shorter arc."""
    at = np.linspace(0, 1, len(way)) if len(way) > 1 else np.zeros(1)
    turn = (to - heading + HEADINGS // 2) % HEADINGS - HEADINGS // 2
    x, y = (np.interp(share, at, way[:, i]) for i in range(2))
    return np.stack([x, y, (heading + turn * share) * 360 / HEADINGS], 1)


def _joined(parts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of some batches of one table, as dictionaries; a list column has its values."""
    out: list[dict[str, Any]] = []
    for part in parts:
        columns = [
            [c[0][a:b] for a, b in pairwise(c[1])] if isinstance(c, tuple) else np.asarray(c).tolist()
            for c in part.values()
        ]
        out += [dict(zip(part, row, strict=True)) for row in zip(*columns, strict=True)]
    return out
