"""The parts of the map that never change, logged once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from engine.replay import looks
from engine.types import StationKind
from engine.world.floor import ONE_WAY, GridWorld, World
from engine.world.network import NetworkWorld
from engine.world.surface import shade
from engine.world.terrain import TerrainWorld

PIXELS_PER_SIDE = 2048
"""The floor's picture is no larger, however many cells there are."""

_STATION_COLOURS: dict[StationKind, looks.RGBA] = {
    StationKind.INBOUND: (77, 208, 225, 255),
    StationKind.OUTBOUND: (200, 140, 240, 255),
    StationKind.RACK: (214, 170, 110, 255),
    StationKind.ENTRANCE: (77, 208, 225, 255),
    StationKind.STATION: (200, 200, 200, 255),
}


class View2D:
    """From the floor's metres, y upwards, to the recording's metres, y downwards from the floor's upper edge."""

    def __init__(self, world: World) -> None:
        self.cell_m = world.grain_m
        self.width_m, self.height_m = world.size_m
        self.wide = max(self.width_m, self.height_m) / self.cell_m > looks.WIDE_CELLS

    def xy(self, xy_m: NDArray[Any]) -> NDArray[np.float32]:
        """(…, 2) positions in the recording."""
        out = np.array(xy_m, np.float32)
        out[..., 1] = np.float32(self.height_m) - out[..., 1]
        return out


def log_floor(static: Callable[..., None], world: World, view: View2D) -> None:
    """Floor, stations, chargers, parking and one-way arrows. static(path, *archetypes) logs what never changes."""
    static(looks.MAP, looks.class_names())
    xy = view.xy(world.graph.xy_m)
    if isinstance(world, GridWorld):
        picture, per_cell = floor_picture(world.cells)
        metres = view.cell_m / per_cell
        static(looks.FLOOR, rr.SegmentationImage(picture), rr.Transform3D(scale=[metres, metres, 1.0]))
        _log_one_way(static, world, view)
    elif isinstance(world, TerrainWorld):
        terrain = world.terrain
        ground = looks.ground_colours(terrain.height_m, shade(terrain.height_m, view.cell_m), terrain.friction)
        ground[terrain.obstacle] = looks.OBSTACLE
        scale = [view.cell_m, view.cell_m, 1.0]
        static(looks.FLOOR, rr.Image(ground[::-1, :, :3]), rr.Transform3D(scale=scale))
    elif isinstance(world, NetworkWorld):
        arcs = xy[[(arc.a, arc.b) for arc in world.arcs]]
        static(looks.FLOOR, rr.LineStrips2D(arcs, colors=(96, 112, 134, 255), radii=0.02 * view.cell_m))
    if world.stations:
        places = np.array([s.place for s in world.stations])
        labels = [s.name for s in world.stations]
        colours = [_STATION_COLOURS[s.kind] for s in world.stations]
        static(looks.STATIONS, _bays(xy[places], view.cell_m, colours, labels, show=len(places) <= looks.MANY_LABELS))
    for path, letter, places, colour in (
        (looks.CHARGERS, "C", world.chargers, (90, 140, 235, 255)),
        (looks.PARKING, "P", world.parking, (110, 120, 135, 255)),
    ):
        if len(places):
            labels = [f"{letter}{i}" for i in range(1, len(places) + 1)]
            static(
                path,
                _bays(xy[places], view.cell_m, [colour] * len(places), labels, show=len(places) <= looks.MANY_LABELS),
            )


def _bays(centres: NDArray[Any], cell_m: float, colours: Any, labels: list[str], *, show: bool) -> rr.Boxes2D:
    return rr.Boxes2D(
        centers=centres,
        half_sizes=np.full_like(centres, 0.43 * cell_m),
        colors=colours,
        labels=labels,
        show_labels=show,
        radii=0.025 * cell_m,
    )


def _log_one_way(static: Any, world: GridWorld, view: View2D) -> None:
    origins, vectors = [], []
    for letter, direction in ONE_WAY.items():
        for y, x in np.argwhere(world.cells == ord(letter)).tolist():
            angle = np.deg2rad(45.0 * direction)
            along = np.array([np.cos(angle), np.sin(angle)]) * view.cell_m
            centre = (np.array([x, y]) + 0.5) * view.cell_m
            origins.append(centre - 0.2 * along)
            vectors.append(0.4 * along * (1, -1))
    if origins:
        arrows = rr.Arrows2D(
            origins=view.xy(np.array(origins)),
            vectors=np.array(vectors),
            colors=(96, 112, 134, 255),
            radii=0.035 * view.cell_m,
        )
        static(looks.ONE_WAY, arrows)


def floor_picture(cells: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], int]:
    """(class numbers with the upper row first, pixels per cell): each cell a tile, parted by a thin joint."""
    number = np.zeros(256, np.uint8)
    for letter, (class_id, _, _) in looks.FLOOR_CLASSES.items():
        number[ord(letter)] = class_id
    for letter in ONE_WAY:
        number[ord(letter)] = looks.FLOOR_CLASSES[">"][0]
    tiles = number[cells[::-1]]
    per_cell = max(1, min(16, PIXELS_PER_SIDE // max(tiles.shape)))
    picture = tiles.repeat(per_cell, 0).repeat(per_cell, 1)
    if per_cell >= 8:
        solid = number[ord("#")]
        joint = np.zeros(picture.shape, np.bool_)
        joint[::per_cell] = joint[:, ::per_cell] = True
        picture[joint & (picture != solid)] = looks.JOINT_CLASS
    return picture, per_cell
