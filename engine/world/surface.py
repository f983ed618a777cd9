"""Ground as a surface in space, for whoever draws it: coarser grids, light, heights under points, obstacles as boxes,
and what a sensor has seen. Lengths in metres, x east, y north, z up."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.world.terrain import TerrainWorld, disc

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]

LIGHT = (-1.0, 1.0, 1.6)
"""Where the light comes from: the north-west, as on maps."""
REACH_M = 0.3
"""Half the length and width over which a robot's tilt follows the ground."""


def every(n: int, most: int) -> I64:
    """Evenly spaced indices below n, the first and the last among them; about `most` of them, or all."""
    step = -(-n // most)
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def grid_of(world: TerrainWorld, most: int) -> tuple[I64, I64]:
    """Rows and columns of cells of a coarser grid of about most × most, the edges among them."""
    return every(world.height, most), every(world.width, most)


def shade(height_m: F32, cell_m: float) -> F32:
    """(H, W) brightness 0…1 of the ground under LIGHT; level ground has about 0.72."""
    rows, columns = np.gradient(height_m.astype(np.float64), cell_m)
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    lit = (-columns * light[0] - rows * light[1] + light[2]) / np.sqrt(rows**2 + columns**2 + 1)
    out: F32 = np.clip(lit, 0, 1).astype(np.float32)
    return out


def lifted(height_m: F32, cell_m: float, xy_m: NDArray[Any], above_m: float = 0.0) -> F32:
    """(N, 3) points (N, 2) put onto the ground, or so much above it; beyond the edge it goes on level."""
    from scipy.ndimage import map_coordinates

    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    z = map_coordinates(height_m, xy.T[::-1] / cell_m - 0.5, order=1, mode="nearest", output=np.float64)
    return np.column_stack([xy, z + above_m]).astype(np.float32)


def tilted(height_m: F32, cell_m: float, xy_m: NDArray[Any], heading_deg: NDArray[Any]) -> tuple[F32, F64]:
    """Where bodies stand, and how: points (N, 3), and rotations (N, 3, 3) whose columns are ahead, left and up."""
    xy, angle = np.asarray(xy_m, np.float64), np.deg2rad(heading_deg)
    ahead = REACH_M * np.stack([np.cos(angle), np.sin(angle)], -1)
    aside = ahead[:, ::-1] * [-1, 1]
    front, back, left, right = (
        lifted(height_m, cell_m, xy + d).astype(np.float64) for d in (ahead, -ahead, aside, -aside)
    )
    x, y = front - back, left - right
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y -= (x * y).sum(1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    middle = np.column_stack([xy, (front + back + left + right)[:, 2] / 4]).astype(np.float32)
    return middle, np.stack([x, y, np.cross(x, y)], -1)


def boxes(obstacle: Mask) -> I64:
    """(N, 4) x0, y0, x1, y1 of rectangles of cells that cover a mask without overlap: runs along the rows, upper
    bounds exclusive, those that lie exactly above each other joined."""
    edge = np.diff(np.pad(obstacle.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    y, x0 = np.nonzero(edge == 1)
    x1 = np.nonzero(edge == -1)[1]
    found: dict[tuple[int, int, int], int] = {}  # (x0, x1, y1) of the rectangles so far → their first row
    for row, begin, end in zip(y.tolist(), x0.tolist(), x1.tolist(), strict=True):
        found[begin, end, row + 1] = found.pop((begin, end, row), row)
    return np.array([[a, y0, b, y1] for (a, b, y1), y0 in found.items()], np.int64).reshape(-1, 4)


def around(world: TerrainWorld, places: NDArray[Any]) -> Mask:
    """(H, W) cells that a sensor in any of these places sees."""
    y, x = np.divmod(np.unique(np.asarray(places, np.int64)), world.width)
    cells = np.stack([x, y], 1)[:, None] + disc(world.sensor_m / world.grain_m)
    inside = ((cells >= 0) & (cells < [world.width, world.height])).all(-1)
    seen = np.zeros((world.height, world.width), np.bool_)
    seen[cells[..., 1][inside], cells[..., 0][inside]] = True
    return seen


def way(world: TerrainWorld, place: int, heading: int, to_place: int, to_heading: int, kind: int) -> F64:
    """(P, 2) points of the trajectory of a kind from one state to another, the ends among them; else its two ends."""
    k = world.trajectory(place, heading, to_place, to_heading, kind)
    if k < 0:
        return np.asarray(world.graph.xy_m[[place, to_place]], np.float64)
    n = int(world.cluster.pieces[heading, k])
    points: F64 = world.graph.xy_m[place] + world.cluster.point[heading, k, : n + 1] * world.grain_m
    return points
