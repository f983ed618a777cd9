"""What each trajectory of a cluster costs from each cell of a terrain: integers, for planning and for the ledger.

A trajectory is followed over the ground piece by piece (bilinear between the centres of cells, where the ends are);
each component is rounded up once, so that a whole number is never below the energy that bounds it. In the form `power`
a descent spares rolling first, then turning, then what climbing there is; with recovery it may give something back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean
from engine.energy.skid_steer import CLIMB, POWER, SkidSteer, constants
from engine.types import COMPONENTS, Component
from engine.world.lattice import HEADINGS, Cluster
from engine.world.terrain import disc

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

BLOCKED = 2**30
"""Cost of a trajectory that can't be driven; no way may cost as much."""
PARTS = (Component.ROLLING, Component.TURNING, Component.CLIMBING, Component.COPPER, Component.RECOVERED)
DISTANCE, ENERGY = 0, 1
OBJECTIVES: dict[str, int] = {"distance": DISTANCE, "energy": ENERGY}
# Fields of the constants of engine.energy.skid_steer.
FORM, WEIGHT, MU, PER_WORK, EFFICIENCY, COPPER_N2, WIDTH, RECOVERY, FLAT_ROLLING, FLAT_COPPER = range(10)


class Shapes(NamedTuple):
    """Trajectories as the kernels follow them: those of engine.world.lattice.Cluster, and beside each point the four
    cells around it and their weights; scrub: (16, K, M) moment in N·m that resists the turning of each piece."""

    end: I32
    pieces: I32
    corner: I32  # (16, K, M + 1, 2) lower left of the four cells
    weight: F64  # (16, K, M + 1, 4)
    middle: I32  # (16, K, M, 2) cell of each piece
    bend: F64
    piece_m: F64
    turn_rad: F64
    seconds: F64
    swept: I32
    n_swept: I32
    scrub: F64


class Ground(NamedTuple):
    """Ground as somebody knows it: heights (H, W), friction factors (H, W), and cells that are closed to the middle of
    the body (H, W)."""

    height: F32
    friction: F32
    closed: U8


def shapes_of(cluster: Cluster, robot: SkidSteer) -> Shapes:
    """The trajectories of a cluster for a robot."""
    corner = np.floor(cluster.point + 1e-9).astype(np.int32)
    fx, fy = np.moveaxis(np.clip(cluster.point - corner, 0.0, 1.0), -1, 0)
    weight = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], -1)
    middle = np.rint((cluster.point[:, :, 1:] + cluster.point[:, :, :-1]) / 2).astype(np.int32)
    scrub = np.vectorize(robot.scrub_nm, otypes=[np.float64])(cluster.bend)
    scrub[cluster.pieces == 0] = robot.scrub_nm(math.inf)
    return Shapes(
        cluster.end, cluster.pieces, corner, weight, middle, cluster.bend, cluster.piece_m, cluster.turn_rad,
        cluster.seconds, cluster.swept, cluster.n_swept, scrub,
    )  # fmt: skip


@lean
def height_at(height: F32, x: int, y: int, weight: F64) -> float:
    """Bilinear height in the square of cells whose lower left is (x, y)."""
    above, right = min(y + 1, height.shape[0] - 1), min(x + 1, height.shape[1] - 1)
    low = weight[0] * height[y, x] + weight[1] * height[y, right]
    return low + weight[2] * height[above, x] + weight[3] * height[above, right]


@lean
def on_the_spot(c: F64, shapes: Shapes, h: int, k: int, friction: float, parts: F64) -> None:
    """Joules by part of a turn on the spot."""
    scrub, turned = shapes.scrub[h, k, 0], shapes.turn_rad[h, k]
    parts[1] = scrub * turned * c[PER_WORK]
    if c[FORM] == POWER:
        drag = c[MU] * friction * c[WEIGHT] / 2
        parts[0] = 2 * drag * turned * c[WIDTH] / 2 * c[PER_WORK]
        parts[3] = 2 * c[COPPER_N2] * (drag + scrub / c[WIDTH]) ** 2 * shapes.seconds[h, k]


@lean
def piece_power(
    c: F64, rise: float, flat: float, bend: float, scrub: float, friction: float, took: float, parts: F64
) -> None:
    """Add the joules of one piece in the form `power`: flat metres, rise, curvature, seconds."""
    length = math.sqrt(flat * flat + rise * rise)
    roll = c[MU] * friction * c[WEIGHT] * flat / length
    ahead = (roll + c[WEIGHT] * rise / length) / 2
    speed, turning = length / took, scrub / c[WIDTH]
    mechanical = 0.0
    for side in range(2):
        outer = 1.0 if (side == 1) == (bend > 0) else -1.0
        force = ahead + outer * turning
        work = force * speed * (1.0 + outer * abs(bend) * c[WIDTH] / 2)
        heat = c[COPPER_N2] * force * force
        power = work * (c[PER_WORK] if work > 0 else c[EFFICIENCY]) + heat
        if power > 0:
            parts[3] += min(heat, power) * took
            mechanical += max(power - heat, 0.0) * took
        else:
            parts[4] += c[RECOVERY] * power * took
    rolling = min(mechanical, roll * length * c[PER_WORK])
    turned = min(mechanical - rolling, scrub * abs(bend) * length * c[PER_WORK])
    parts[0] += rolling
    parts[1] += turned
    parts[2] += mechanical - rolling - turned


@lean
def follow(c: F64, ground: Ground, shapes: Shapes, cell_m: float, x: int, y: int, h: int, k: int, parts: F64) -> float:
    """Joules by part of a trajectory from a cell, whose end must lie on the map; returns its length in metres."""
    parts[:] = 0.0
    n = shapes.pieces[h, k]
    if n == 0:
        on_the_spot(c, shapes, h, k, ground.friction[y, x], parts)
        return 0.0
    flat, took = shapes.piece_m[h, k], shapes.seconds[h, k] / n
    first = before = float(ground.height[y, x])
    length = 0.0
    for j in range(n):
        cx, cy = x + shapes.corner[h, k, j + 1, 0], y + shapes.corner[h, k, j + 1, 1]
        now = height_at(ground.height, cx, cy, shapes.weight[h, k, j + 1])
        rise = now - before
        before = now
        straight = math.sqrt(flat * flat + rise * rise)
        length += straight
        friction = float(ground.friction[y + shapes.middle[h, k, j, 1], x + shapes.middle[h, k, j, 0]])
        bend, scrub = shapes.bend[h, k, j], shapes.scrub[h, k, j]
        if c[FORM] == POWER:
            piece_power(c, rise, flat, bend, scrub, friction, took, parts)
        elif c[FORM] == CLIMB:
            parts[0] += c[FLAT_ROLLING] * friction * straight
            parts[3] += c[FLAT_COPPER] * friction * friction * straight
            parts[2] += max(rise, 0.0) * c[WEIGHT] * c[PER_WORK]
            parts[1] += scrub * abs(bend) * flat * c[PER_WORK]
    if c[FORM] != POWER and c[FORM] != CLIMB:
        dx, dy, rise = shapes.end[h, k, 0] * cell_m, shapes.end[h, k, 1] * cell_m, before - first
        parts[0] = (c[FLAT_ROLLING] + c[FLAT_COPPER]) * math.sqrt(dx * dx + dy * dy + rise * rise)
        parts[2] = max(c[MU] * c[WEIGHT] * rise, -parts[0])
    return length


@lean
def open_way(ground: Ground, shapes: Shapes, x: int, y: int, h: int, k: int) -> bool:
    """True when no cell that the middle of the body passes is closed or off the map."""
    rows, columns = ground.height.shape
    for i in range(shapes.n_swept[h, k]):
        cx, cy = x + shapes.swept[h, k, i, 0], y + shapes.swept[h, k, i, 1]
        if cx < 0 or cy < 0 or cx >= columns or cy >= rows or ground.closed[cy, cx]:
            return False
    return True


@lean
def cost_of(
    c: F64, ground: Ground, shapes: Shapes, cell_m: float, objective: int, x: int, y: int, h: int, k: int, parts: F64
) -> int:
    """Cost of a trajectory from a cell: millijoules or millimetres, rounded up; BLOCKED when it can't be driven.

    At least 1, where recovery gives something back too: repair asks for positive costs, or ties hide what is outdated.
    """
    if not open_way(ground, shapes, x, y, h, k):
        return BLOCKED
    length = follow(c, ground, shapes, cell_m, x, y, h, k, parts)
    if objective == DISTANCE:
        return max(math.ceil(1000.0 * length), 1)
    total = 0
    for i in range(len(parts)):
        total += math.ceil(1000.0 * parts[i])
    return min(max(total, 1), BLOCKED)


@lean
def fill(c: F64, ground: Ground, shapes: Shapes, cell_m: float, objective: int, parts: F64, cost: I32) -> None:
    """cost: (S, K), state (y · W + x) · 16 + heading."""
    rows, columns = ground.height.shape
    for y in range(rows):
        for x in range(columns):
            for h in range(HEADINGS):
                s = (y * columns + x) * HEADINGS + h
                for k in range(cost.shape[1]):
                    cost[s, k] = cost_of(c, ground, shapes, cell_m, objective, x, y, h, k, parts)


@lean
def refill(
    c: F64, ground: Ground, shapes: Shapes, cell_m: float, objective: int, parts: F64, cost: I32, dirty: U8, box: I64,
    changed: I32,
) -> int:  # fmt: skip
    """Costs anew from the cells within box (x0, y0, x1, y1, exclusive) that are dirty; the states for which any of them
    changed go to `changed`. Returns their number."""
    columns, n = ground.height.shape[1], 0
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            if not dirty[y, x]:
                continue
            for h in range(HEADINGS):
                s = (y * columns + x) * HEADINGS + h
                different = False
                for k in range(cost.shape[1]):
                    new = cost_of(c, ground, shapes, cell_m, objective, x, y, h, k, parts)
                    if new != cost[s, k]:
                        cost[s, k] = new
                        different = True
                if different:
                    changed[n] = s
                    n += 1
    return n


@lean
def close(
    height: F32, obstacle: U8, known: U8, body: I32, steepest: float, cell_m: float, box: I64, closed: U8
) -> None:
    """Close the cells within box to which the body must not come: an obstacle in it, or ground steeper than allowed.

    Slopes are judged where the cell and its four neighbours are known. steepest: a tangent.
    """
    rows, columns = height.shape
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            shut = False
            for i in range(len(body)):
                bx, by = x + body[i, 0], y + body[i, 1]
                if 0 <= bx < columns and 0 <= by < rows and obstacle[by, bx]:
                    shut = True
                    break
            if not shut and known[y, x]:
                west, east, south, north = max(x - 1, 0), min(x + 1, columns - 1), max(y - 1, 0), min(y + 1, rows - 1)
                if known[y, west] and known[y, east] and known[south, x] and known[north, x]:
                    across = (height[y, east] - height[y, west]) / ((east - west) * cell_m)
                    up = (height[north, x] - height[south, x]) / ((north - south) * cell_m)
                    shut = across * across + up * up > steepest * steepest
            closed[y, x] = shut


class TerrainCosts:
    """Costs of a map that may change: what somebody knows of the ground, and the table (S, K) over it.

    Without a table it tells what single trajectories cost. Arrays are the object's own; `see` puts in what has become
    known and returns the states whose costs changed.
    """

    def __init__(
        self,
        cluster: Cluster,
        robot: SkidSteer,
        cell_m: float,
        height_m: F32,
        obstacle: NDArray[np.bool_],
        friction: F32,
        known: NDArray[np.bool_],
        slope_limit_deg: float,
        body_m: float,
        objective: str = "energy",
        table: bool = True,
    ) -> None:
        self.cluster, self.robot, self.cell_m = cluster, robot, cell_m
        self.objective = OBJECTIVES[objective]
        self.shapes, self.constants = shapes_of(cluster, robot), constants(robot)
        self.height, self.friction = height_m.astype(np.float32), friction.astype(np.float32)
        self.obstacle, self.known = obstacle.astype(np.uint8), known.astype(np.uint8)
        self.body = disc(body_m / cell_m)
        self.steepest = math.tan(math.radians(slope_limit_deg))
        rows, columns = height_m.shape
        self._parts = np.zeros(len(PARTS))
        self._dirty = np.zeros((rows, columns), np.uint8)
        self.closed = np.zeros((rows, columns), np.uint8)
        self.ground = Ground(self.height, self.friction, self.closed)
        self.close()
        self.cost = np.empty((rows * columns * HEADINGS if table else 0, cluster.size), np.int32)
        if table:
            self.fill()

    def fill(self) -> None:
        """The whole table anew."""
        fill(self.constants, self.ground, self.shapes, self.cell_m, self.objective, self._parts, self.cost)

    def close(self) -> None:
        """Closed cells anew, everywhere."""
        rows, columns = self.height.shape
        self._close(np.array([0, 0, columns, rows], np.int64))

    def _close(self, box: I64) -> None:
        close(self.height, self.obstacle, self.known, self.body, self.steepest, self.cell_m, box, self.closed)

    def parts(self, state: int, k: int) -> I64:
        """(C,) millijoules by component of trajectory k from a state, in the order of engine.types.Component."""
        cell, h = divmod(state, HEADINGS)
        y, x = divmod(cell, self.height.shape[1])
        follow(self.constants, self.ground, self.shapes, self.cell_m, x, y, h, k, self._parts)
        out = np.zeros(len(COMPONENTS), np.int64)
        out[list(PARTS)] = np.ceil(1000.0 * self._parts).astype(np.int64)
        return out

    def can(self, state: int, k: int) -> bool:
        """True when nothing stands in the way of trajectory k from a state."""
        cell, h = divmod(state, HEADINGS)
        y, x = divmod(cell, self.height.shape[1])
        return bool(open_way(self.ground, self.shapes, x, y, h, k))

    def see(self, cells: I32, height_m: F32, obstacle: U8, friction: F32) -> I32:
        """Put in what cells (N, 2) as (x, y) are known to be; returns the states whose costs changed, ascending."""
        if len(cells) == 0:
            return np.zeros(0, np.int32)
        x, y = cells[:, 0], cells[:, 1]
        self.height[y, x], self.obstacle[y, x], self.friction[y, x], self.known[y, x] = height_m, obstacle, friction, 1
        rows, columns = self.height.shape
        near = int(np.abs(self.body).max(initial=0)) + 1
        before = self.closed.copy()
        box = np.array([x.min() - near, y.min() - near, x.max() + near + 1, y.max() + near + 1], np.int64)
        box = np.clip(box, 0, [columns, rows, columns, rows]).astype(np.int64)
        self._close(box)
        touched = before != self.closed
        touched[y, x] = True
        return self._refill(touched) if len(self.cost) else np.zeros(0, np.int32)

    def _refill(self, touched: NDArray[np.bool_]) -> I32:
        """Costs anew from wherever a trajectory may touch these cells."""
        rows, columns = touched.shape
        reach = self.cluster.reach
        self._dirty[:] = 0
        ys, xs = np.nonzero(touched)
        for dy in range(-reach, reach + 1):
            inside = (ys + dy >= 0) & (ys + dy < rows)
            self._dirty[ys[inside] + dy, xs[inside]] = 1
        ys, xs = np.nonzero(self._dirty)
        for dx in range(-reach, reach + 1):
            inside = (xs + dx >= 0) & (xs + dx < columns)
            self._dirty[ys[inside], xs[inside] + dx] = 1
        ys, xs = np.nonzero(self._dirty)
        box = np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], np.int64)
        changed = np.empty(int(self._dirty.sum()) * HEADINGS, np.int32)
        n = refill(
            self.constants, self.ground, self.shapes, self.cell_m, self.objective, self._parts, self.cost, self._dirty,
            box, changed,
        )  # fmt: skip
        return changed[:n]
