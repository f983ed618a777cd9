"""What an operator may say while a robot drives on terrain: stop it, send it elsewhere, drop and remove obstacles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput
from engine.sim.commands import Refused
from engine.types import NONE
from engine.world.lattice import HEADINGS
from engine.world.terrain import disc

if TYPE_CHECKING:
    from engine.sim.roaming import Roaming

I32 = NDArray[np.int32]
WIDEST_M = 3.0
"""Radius of the largest obstacle that is dropped."""


def _vehicle(v: int) -> None:
    if v != 0:
        raise BadInput(f"there is no vehicle {v}; the robot is vehicle 0")


def _place(sim: Roaming, place: int) -> str:
    if not 0 <= place < sim.graph.n_places:
        raise BadInput(f"there is no place {place}; the floor's are numbered 0 to {sim.graph.n_places - 1}")
    return sim.world.label(place)


def _pause(sim: Roaming, vehicle: int) -> str:
    _vehicle(vehicle)
    if sim.paused:
        raise Refused("vehicle 0 is already paused")
    sim.paused = True
    return "vehicle 0 pauses as soon as its present motion has ended"


def _continue(sim: Roaming, vehicle: int) -> str:
    _vehicle(vehicle)
    if not sim.paused:
        raise Refused("vehicle 0 is not paused")
    sim.paused = False
    return "vehicle 0 goes on"


def _fail(sim: Roaming, vehicle: int) -> str:
    _vehicle(vehicle)
    if sim.failed:
        raise Refused("vehicle 0 is already broken down")
    sim.failed = True
    sim.say("breakdown", "vehicle 0 was taken out by the operator", 2, 0)
    return "vehicle 0 stops when its present motion has ended and stays there until it is repaired"


def _repair(sim: Roaming, vehicle: int) -> str:
    _vehicle(vehicle)
    if not sim.failed:
        raise Refused("vehicle 0 is not broken down")
    sim.failed = False
    sim.say("repaired", "vehicle 0 works again", 0, 0)
    return "vehicle 0 works again"


def _send(sim: Roaming, vehicle: int, place: int) -> str:
    _vehicle(vehicle)
    cell = _place(sim, place)
    if sim.failed:
        raise Refused("vehicle 0 is broken down")
    if sim.believed.closed.flat[place]:
        raise Refused(f"{cell} is too near an obstacle or too steep to stand in, as far as vehicle 0 knows")
    sim.retarget(place)
    return f"vehicle 0 goes to {cell}"


def _block(sim: Roaming, place: int, radius_m: float = 0.0) -> str:
    """An obstacle in one cell, or a round one about it."""
    cell = _place(sim, place)
    if not 0 <= radius_m <= WIDEST_M:
        raise BadInput(f"'radius_m' must be from 0 to {WIDEST_M:g}; got {radius_m:g}")
    y, x = divmod(place, sim.world.width)
    if sim.truth.obstacle[y, x]:
        raise Refused(f"there is an obstacle in {cell} already")
    cells = disc(radius_m / sim.world.grain_m) + np.array([x, y], np.int32)
    cells = cells[((cells >= 0) & (cells < [sim.world.width, sim.world.height])).all(1)]
    cells = cells[sim.truth.obstacle[cells[:, 1], cells[:, 0]] == 0]
    if _in_the_way(sim, cells):
        raise Refused(f"vehicle 0 is in {cell}, or about to be" if radius_m == 0 else
                      f"vehicle 0 is within {radius_m:g} m of {cell}, or about to be")  # fmt: skip
    _set(sim, place, cells, True)
    return f"an obstacle stands in {cell}" if radius_m == 0 else f"an obstacle stands {radius_m:g} m around {cell}"


def _unblock(sim: Roaming, place: int, whole: float = 0.0) -> str:
    """Free one cell, or take away the whole obstacle that it belongs to."""
    cell = _place(sim, place)
    y, x = divmod(place, sim.world.width)
    if not sim.truth.obstacle[y, x]:
        raise Refused(f"there is no obstacle in {cell}")
    cells = np.array([[x, y]], np.int32)
    if whole:
        from scipy.ndimage import label

        parts, _ = label(sim.truth.obstacle, np.ones((3, 3)))
        cells = np.argwhere(parts == parts[y, x])[:, ::-1].astype(np.int32)
    _set(sim, place, cells, False)
    return f"{cell} is free again" if len(cells) == 1 else f"the obstacle of {len(cells)} cells at {cell} is gone"


def _in_the_way(sim: Roaming, cells: I32) -> bool:
    """True when the robot's body covers one of these cells where it stands or on the motion under way."""
    cell, h = divmod(sim.state, HEADINGS)
    at = np.array([divmod(cell, sim.world.width)[::-1]])
    if sim.k != NONE:
        at = at + sim.cluster.swept[h, sim.k, : sim.cluster.n_swept[h, sim.k]]
    body = {(ax + dx, ay + dy) for ax, ay in at.tolist() for dx, dy in sim.truth.body.tolist()}
    return any((x, y) in body for x, y in cells.tolist())


def _set(sim: Roaming, place: int, cells: I32, stands: bool) -> None:
    """Put an obstacle into cells (N, 2), or take it away; the robot learns of it when it sees it."""
    x, y = cells.T
    true = sim.truth
    true.see(cells, true.height[y, x], np.full(len(cells), stands, np.uint8), true.friction[y, x])
    for at in (y * sim.world.width + x).tolist():
        sim.blocked[at] = int(stands)
        sim.ledger.row("blocks", sim.tick, at, int(stands))
    sim.say("blocked" if stands else "unblocked", sim.world.label(place), int(stands), NONE, place)
    if sim.k == NONE:
        sim.look()


COMMANDS: dict[str, tuple[Callable[..., str], dict[str, Any]]] = {
    "send": (_send, {"vehicle": int, "place": int}),
    "pause": (_pause, {"vehicle": int}),
    "continue": (_continue, {"vehicle": int}),
    "fail": (_fail, {"vehicle": int}),
    "repair": (_repair, {"vehicle": int}),
    "block": (_block, {"place": int, "radius_m": None}),
    "unblock": (_unblock, {"place": int, "whole": None}),
}
"""What may be said: who does it, and its fields; those without a type may be left out."""
