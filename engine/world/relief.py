"""Ground: heights, obstacles and friction on a grid of cells, from seeded generators.

Heights stand at the centres of cells, row 0 at the bottom. Shapes are those of the paper's outdoor scenes as far as its
text tells: "certain undulations and slopes" on about 60 m × 60 m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, unknown_name

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_SIDE = 1024
"""Cells along a side, at most."""
GAP_M = 2.5
"""Generated obstacles keep this far from the cells that must stay free."""


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Ground of H × W cells. Immutable.

    height_m: (H, W) at the centres of the cells · obstacle: (H, W) nothing drives there · friction: (H, W) factor on
    the vehicle's rolling resistance · slope_limit_deg: steeper cells are not driven on. Raises BadInput.
    """

    height_m: F32
    cell_m: float
    obstacle: Mask
    friction: F32
    slope_limit_deg: float = 30.0

    def __post_init__(self) -> None:
        shape = self.height_m.shape
        if len(shape) != 2 or min(shape) < 3 or max(shape) > MAX_SIDE:
            raise BadInput(
                f"a height map has 3 × 3 to {MAX_SIDE} × {MAX_SIDE} cells; got {' × '.join(map(str, shape))}"
            )
        for name in ("obstacle", "friction"):
            if getattr(self, name).shape != shape:
                raise BadInput(f"{name} has {getattr(self, name).shape} cells; the height map has {shape}")
        if not np.isfinite(self.height_m).all():
            raise BadInput("a height map has heights that are no numbers")
        if not (np.isfinite(self.friction).all() and (self.friction > 0).all()):
            raise BadInput("friction factors must be positive numbers")
        if self.cell_m <= 0 or not 0 < self.slope_limit_deg < 90:
            raise BadInput(f"got cells of {self.cell_m} m and a slope limit of {self.slope_limit_deg} degrees")

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.height_m.shape
        return height, width


def terrain_of(
    height_m: NDArray[np.floating],
    cell_m: float = 0.2,
    obstacle: Mask | None = None,
    friction: NDArray[np.floating] | None = None,
    slope_limit_deg: float = 30.0,
) -> Terrain:
    """Terrain from arrays (H, W), row 0 at the bottom; without obstacles and with friction 1 where none are given."""
    height = np.array(height_m, np.float32)
    return Terrain(
        height,
        cell_m,
        np.zeros(height.shape, np.bool_) if obstacle is None else np.array(obstacle, np.bool_),
        np.ones(height.shape, np.float32) if friction is None else np.array(friction, np.float32),
        slope_limit_deg,
    )


def tilt(height_m: F32, cell_m: float) -> F32:
    """(H, W) slope of the ground as a tangent, by central differences."""
    rows, columns = np.gradient(height_m.astype(np.float64), cell_m)
    out: F32 = np.hypot(rows, columns).astype(np.float32)
    return out


# ---------------------------------------------------------------- generators


def _grid(shape: tuple[int, int], cell_m: float) -> tuple[F64, F64]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (x + 0.5) * cell_m, (y + 0.5) * cell_m


def bumps(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """Gaussian hills of ½ to 1 height_m; 40 of them on 60 × 60 m fit the paper's saving, smooth fields do not."""
    x, y = _grid(shape, cell_m)
    out = np.zeros(shape)
    for _ in range(count):
        cx, cy = rng.uniform(0, shape[1] * cell_m), rng.uniform(0, shape[0] * cell_m)
        top, spread = height_m * rng.uniform(0.5, 1.0), rng.uniform(2.1, 3.9)
        out += top * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * spread**2))
    return out


def ridges(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """Long straight banks with a pass somewhere along each."""
    x, y = _grid(shape, cell_m)
    size = max(shape) * cell_m
    out = np.zeros(shape)
    for _ in range(max(1, count // 8)):
        cx, cy, angle = rng.uniform(0, size), rng.uniform(0, size), rng.uniform(0, math.pi)
        along = (x - cx) * math.cos(angle) + (y - cy) * math.sin(angle)
        across = -(x - cx) * math.sin(angle) + (y - cy) * math.cos(angle)
        gap = 1 - np.exp(-((along - rng.uniform(-size / 4, size / 4)) ** 2) / (2 * 3.0**2))
        out = np.maximum(
            out, height_m * rng.uniform(0.7, 1.2) * gap * np.exp(-(across**2) / (2 * rng.uniform(1.8, 2.8) ** 2))
        )
    return out


def ramps(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """Plateaus with sides of about 20 degrees, one of them a gentle ramp."""
    x, y = _grid(shape, cell_m)
    size = max(shape) * cell_m
    out = np.zeros(shape)
    for _ in range(max(1, count // 6)):
        cx, cy, angle = rng.uniform(0, size), rng.uniform(0, size), rng.uniform(0, 2 * math.pi)
        top, half = height_m * rng.uniform(0.7, 1.3), rng.uniform(2.0, 5.0)
        u = (x - cx) * math.cos(angle) + (y - cy) * math.sin(angle)
        w = -(x - cx) * math.sin(angle) + (y - cy) * math.cos(angle)
        steep, gentle = top / math.tan(math.radians(20)), top / math.tan(math.radians(7))
        side = np.maximum(np.maximum(np.abs(w) - half, 0) / steep, np.maximum(-u - half, 0) / steep)
        fall = np.clip(np.maximum(side, np.maximum(u - half, 0) / gentle), 0, 1)
        out = np.maximum(out, top * 0.5 * (1 + np.cos(math.pi * fall)))
    return out


def craters(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """Bowls with a raised rim."""
    x, y = _grid(shape, cell_m)
    out = np.zeros(shape)
    for _ in range(max(1, count // 3)):
        cx, cy = rng.uniform(0, shape[1] * cell_m), rng.uniform(0, shape[0] * cell_m)
        radius, top = rng.uniform(2.5, 4.5), height_m * rng.uniform(0.5, 1.0)
        d = np.hypot(x - cx, y - cy) / radius
        out += top * (0.5 * np.exp(-((d - 1) ** 2) / 0.08) - np.exp(-(d**2) / 0.3))
    return out


def mixed(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """A share of each."""
    part = max(1, count // 3)
    out = np.zeros(shape)
    for make in (bumps, ridges, craters):
        out += make(rng, shape, cell_m, height_m, part)
    return out


def smooth(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """A random field without hills of its own: noise blurred over 4 m, of standard deviation ½ height_m."""
    from scipy.ndimage import gaussian_filter

    field = np.asarray(gaussian_filter(rng.standard_normal(shape), 4.0 / cell_m, mode="reflect"), np.float64)
    return np.asarray(field / field.std() * height_m / 2)


def flat(rng: np.random.Generator, shape: tuple[int, int], cell_m: float, height_m: float, count: int) -> F64:
    """No hills."""
    return np.zeros(shape)


Generator = Callable[[np.random.Generator, tuple[int, int], float, float, int], F64]
GENERATORS: dict[str, Generator] = {
    "bumps": bumps,
    "ridges": ridges,
    "ramps": ramps,
    "craters": craters,
    "smooth": smooth,
    "mixed": mixed,
    "flat": flat,
}
"""Classes of terrain by name."""


def generate(
    name: str,
    seed: int,
    *,
    size_m: tuple[float, float] = (60.0, 60.0),
    cell_m: float = 0.2,
    height_m: float = 1.5,
    count: int = 40,
    obstacles: int = 0,
    rough: int = 0,
    slope_limit_deg: float = 30.0,
    free: tuple[tuple[float, float], ...] = (),
) -> Terrain:
    """Seeded terrain of one class. Raises BadInput on an unknown name.

    size_m: width and height · height_m: of the highest hills · count: of hills · obstacles: round ones of 0.4 to 1.2 m
    radius · rough: round patches of 2 to 5 m radius on which rolling resistance is 1.5 to 2.5 times as high · free:
    points in metres that obstacles keep clear of. Heights do not depend on obstacles and patches.
    """
    if name not in GENERATORS:
        raise BadInput(unknown_name("terrain", name, GENERATORS))
    shape = (round(size_m[1] / cell_m), round(size_m[0] / cell_m))
    if min(shape) < 3 or max(shape) > MAX_SIDE:
        raise BadInput(f"a terrain has 3 to {MAX_SIDE} cells a side; got {shape[1]} × {shape[0]}")
    hills, stones, patches = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    height = GENERATORS[name](hills, shape, cell_m, height_m, count)
    x, y = _grid(shape, cell_m)
    obstacle = np.zeros(shape, np.bool_)
    placed = 0
    for _ in range(50 * obstacles):
        if placed == obstacles:
            break
        cx, cy, radius = stones.uniform(0, size_m[0]), stones.uniform(0, size_m[1]), stones.uniform(0.4, 1.2)
        if all(math.hypot(cx - fx, cy - fy) > radius + GAP_M for fx, fy in free):
            obstacle |= np.hypot(x - cx, y - cy) <= radius
            placed += 1
    friction = np.ones(shape)
    for _ in range(rough):
        cx, cy, radius = patches.uniform(0, size_m[0]), patches.uniform(0, size_m[1]), patches.uniform(2.0, 5.0)
        factor = patches.uniform(1.5, 2.5)
        friction = np.where(np.hypot(x - cx, y - cy) <= radius, np.maximum(friction, factor), friction)
    return terrain_of(height, cell_m, obstacle, friction, slope_limit_deg)


def coarse(height_m: F32, cell_m: float, block_m: float) -> F32:
    """(H, W) heights as a map of blocks of block_m knows them: block means, interpolated between their centres."""
    from scipy.ndimage import map_coordinates

    block = max(1, round(block_m / cell_m))
    rows, columns = height_m.shape
    n, m = -(-rows // block), -(-columns // block)
    sums = np.add.reduceat(
        np.add.reduceat(height_m.astype(np.float64), range(0, rows, block), 0), range(0, columns, block), 1
    )
    sizes = np.outer(np.minimum(block, rows - block * np.arange(n)), np.minimum(block, columns - block * np.arange(m)))
    means = sums / sizes
    at = np.meshgrid((np.arange(rows) + 0.5) / block - 0.5, (np.arange(columns) + 0.5) / block - 0.5, indexing="ij")
    out = np.asarray(map_coordinates(means, at, order=1, mode="nearest"))
    return out.astype(np.float32)
