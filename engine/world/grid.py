"""Grids: cells, which neighbours a vehicle may enter from where, and their compilation to a MotionGraph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.world.motion_graph import MotionGraph, Primitive

STEPS: tuple[tuple[int, int], ...] = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""Direction d points 45·d degrees counter-clockwise from east; y grows upwards."""


@dataclass(frozen=True, slots=True)
class GridMotion:
    """How a vehicle moves between cells.

    turning: `arc` turns while driving into the next cell (xu2025), `pivot` turns on the spot, a primitive of its own.
    Durations are whole ticks. A diagonal step takes `diagonal_ticks`.
    """

    cell_mm: int = 1000
    turning: str = "arc"
    straight_ticks: int = 1
    turn_ticks: int = 1
    reverse_ticks: int = 1
    diagonal_ticks: int = 1


def compile_grid(free: NDArray[np.bool_], exits: NDArray[np.uint8], motion: GridMotion) -> MotionGraph:
    """Motion graph of a grid.

    free: (H, W) cells a vehicle may be in, row 0 at the bottom · exits: (H, W) bit d set when a vehicle may leave the
    cell in direction d (45·d degrees); a bit that leads outside or into an obstacle is ignored. Only even bits make a
    4-connected grid. A diagonal sweeps its two corner cells, which must be free. Places are the free cells, row by row
    from the bottom.
    """
    height, width = free.shape
    ys, xs = np.nonzero(free)
    n = len(xs)
    place_of = np.full((height, width), -1, np.int64)
    place_of[ys, xs] = np.arange(n)
    eight = bool((exits & 0b10101010).any())
    n_head = 8 if eight else 4
    per_turn = 8 // n_head
    primitives, index = _primitives(motion, n_head)

    # target[p, h]: the place one step ahead, or -1; corners only for diagonals
    target = np.full((n, n_head), -1, np.int64)
    corners = np.full((n, n_head, 2), -1, np.int64)
    for h in range(n_head):
        dx, dy = STEPS[h * per_turn]
        nx, ny = xs + dx, ys + dy
        ok = (nx >= 0) & (nx < width) & (ny >= 0) & (ny < height)
        ok &= ((exits[ys, xs] >> (h * per_turn)) & 1).astype(bool)
        to = np.where(ok, place_of[np.clip(ny, 0, height - 1), np.clip(nx, 0, width - 1)], -1)
        if dx and dy:
            a = place_of[ys, np.clip(nx, 0, width - 1)]
            b = place_of[np.clip(ny, 0, height - 1), xs]
            to = np.where((a >= 0) & (b >= 0), to, -1)
            corners[:, h, 0], corners[:, h, 1] = a, b
        target[:, h] = to

    per_place = n_head * 2
    parts: list[NDArray[np.int64]] = []  # columns: from, to, kind, corner a, corner b, twin key
    places = np.arange(n)
    for heading in range(n_head):
        for moving in (0, 1):
            src = places * per_place + heading * 2 + moving
            for out in range(n_head):
                gap = min((out - heading) % n_head, (heading - out) % n_head)
                turn_deg = gap * 45 * per_turn
                if motion.turning == "pivot":
                    if gap == 1:
                        kind = index[("pivot", turn_deg, moving, 0)]
                        dst = places * per_place + out * 2
                        parts.append(np.stack([src, dst, np.full(n, kind), np.full(n, -1), np.full(n, -1)], 1))
                    if gap:
                        continue
                ok = target[:, out] >= 0
                diagonal = (out * per_turn) % 2
                kind = index[("step", turn_deg, moving, diagonal)]
                dst = target[ok, out] * per_place + out * 2 + 1
                parts.append(
                    np.stack([src[ok], dst, np.full(ok.sum(), kind), corners[ok, out, 0], corners[ok, out, 1]], 1)
                )
    rows = np.concatenate(parts) if parts else np.zeros((0, 5), np.int64)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    return assemble(
        xy_m=np.stack([(xs + 0.5), (ys + 0.5)], 1).astype(np.float32) * np.float32(motion.cell_mm / 1000),
        per_place=per_place,
        n_head=n_head,
        rows=rows,
        primitives=primitives,
        arc_ticks=motion.straight_ticks,
    )


def _primitives(motion: GridMotion, n_head: int) -> tuple[tuple[Primitive, ...], dict[tuple[str, int, int, int], int]]:
    """Every primitive of a grid, and its index by (step or pivot, turn, moving, diagonal)."""
    out: list[Primitive] = []
    index: dict[tuple[str, int, int, int], int] = {}
    step_deg = 360 // n_head
    for diagonal in (0, 1) if n_head == 8 else (0,):
        length = motion.cell_mm * (2**0.5 if diagonal else 1.0)
        for turn in range(0, 181, step_deg) if motion.turning == "arc" else (0,):
            for moving in (1, 0):
                ticks = motion.diagonal_ticks if diagonal else motion.straight_ticks
                # a quarter arc of radius d/2 is π/4 of the straight length (xu2025 eq. 2-3)
                arc = 1.0 if turn == 180 else 1.0 - (1.0 - np.pi / 4) * min(turn, 90) / 90
                if turn in (90, 45, 135):
                    ticks = max(ticks, motion.turn_ticks)
                if turn == 180:
                    ticks = max(ticks, motion.reverse_ticks)
                word = {0: "straight", 180: "reverse"}.get(turn, "turn" if step_deg == 90 else f"turn {turn}")
                word = f"diagonal {word}" if diagonal else word
                index[("step", turn, moving, diagonal)] = len(out)
                # a reversal always stops first, so it always starts
                starts = not moving or turn == 180
                name = word if moving else f"start {word}"
                out.append(Primitive(name, length * arc, turn, starts, False, ticks))
    if motion.turning == "pivot":
        for moving in (1, 0):
            index[("pivot", step_deg, moving, 0)] = len(out)
            name = "stop pivot" if moving else "pivot"
            out.append(Primitive(name, 0, step_deg, False, True, motion.turn_ticks))
    return tuple(out), index


def assemble(
    *,
    xy_m: NDArray[np.float32],
    per_place: int,
    n_head: int,
    rows: NDArray[np.int64],
    primitives: tuple[Primitive, ...],
    headings: NDArray[np.int8] | None = None,
    heading_deg: tuple[int, ...] | None = None,
    arc_ticks: NDArray[np.int32] | int = 0,
) -> MotionGraph:
    """Build the CSR arrays from edge rows (from, to, kind, swept place a, swept place b) sorted by from, then to.

    headings: (S,) index into heading_deg of every state; without them every place has the same evenly spaced ones.
    """
    n = len(xy_m)
    s = n * per_place
    i32 = np.int32
    src, dst = rows[:, 0], rows[:, 1]
    edge_ptr = np.zeros(s + 1, i32)
    np.add.at(edge_ptr, src + 1, 1)
    edge_ptr = np.cumsum(edge_ptr, dtype=i32)
    rev_ptr = np.zeros(s + 1, i32)
    np.add.at(rev_ptr, dst + 1, 1)
    rev_ptr = np.cumsum(rev_ptr, dtype=i32)
    rev_edge = np.argsort(dst, kind="stable").astype(i32)
    twin = np.arange(len(rows), dtype=i32)
    key = src * s + dst
    want = (src ^ 1) * s + dst  # states come in pairs (stopped, moving)
    if len(rows):
        at = np.clip(np.searchsorted(key, want), 0, len(key) - 1)
        twin = np.where(key[at] == want, at, twin).astype(i32)
    swept = rows[:, 3:5]
    counts = (swept >= 0).sum(1)
    sweep_ptr = np.zeros(len(rows) + 1, i32)
    sweep_ptr[1:] = np.cumsum(counts)
    state = np.arange(s)
    return MotionGraph(
        xy_m=xy_m,
        place_ptr=(np.arange(n + 1) * per_place).astype(i32),
        state_place=(state // per_place).astype(i32),
        state_heading=(state % per_place // 2).astype(np.int8) if headings is None else headings,
        state_moving=(state & 1).astype(np.int8),
        stopped=(state & ~1).astype(i32),
        edge_ptr=edge_ptr,
        edge_from=src.astype(i32),
        edge_to=dst.astype(i32),
        edge_kind=rows[:, 2].astype(np.int8),
        edge_twin=twin,
        sweep_ptr=sweep_ptr,
        sweep=swept[swept >= 0].astype(i32),
        rev_ptr=rev_ptr,
        rev_edge=rev_edge,
        arc_ticks=np.broadcast_to(np.asarray(arc_ticks, i32), n).copy(),
        heading_deg=heading_deg or tuple(range(0, 360, 360 // n_head)),
        primitives=primitives,
        kind_ticks=np.array([p.ticks for p in primitives], i32),
        kind_mm=np.array([round(p.length_mm) for p in primitives], i32),
    )
