"""What an operator may say while a robot drives on terrain: stop it, send it elsewhere, drop and remove obstacles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.errors import BadInput
from engine.sim.commands import Refused
from engine.types import NONE
from engine.world.lattice import HEADINGS

if TYPE_CHECKING:
    from engine.sim.roaming import Roaming


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


def _block(sim: Roaming, place: int) -> str:
    cell = _place(sim, place)
    y, x = divmod(place, sim.world.width)
    if sim.truth.obstacle[y, x]:
        raise Refused(f"there is an obstacle in {cell} already")
    if _in_the_way(sim, x, y):
        raise Refused(f"vehicle 0 is in {cell}, or about to be")
    _set(sim, place, True)
    return f"an obstacle stands in {cell}"


def _unblock(sim: Roaming, place: int) -> str:
    cell = _place(sim, place)
    if not sim.truth.obstacle.flat[place]:
        raise Refused(f"there is no obstacle in {cell}")
    _set(sim, place, False)
    return f"{cell} is free again"


def _in_the_way(sim: Roaming, x: int, y: int) -> bool:
    """True when the robot's body covers a cell where it stands or on the motion under way."""
    cell, h = divmod(sim.state, HEADINGS)
    at = np.array([divmod(cell, sim.world.width)[::-1]])
    if sim.k != NONE:
        at = at + sim.cluster.swept[h, sim.k, : sim.cluster.n_swept[h, sim.k]]
    body = {(dx, dy) for dx, dy in sim.truth.body.tolist()}
    return any((x - ax, y - ay) in body for ax, ay in at.tolist())


def _set(sim: Roaming, place: int, stands: bool) -> None:
    """Put an obstacle into a cell, or take it away; the robot learns of it when it sees it."""
    y, x = divmod(place, sim.world.width)
    true = sim.truth
    one = np.array([[x, y]], np.int32)
    true.see(one, true.height[y, x], np.array([stands], np.uint8), true.friction[y, x])
    sim.blocked[place] = int(stands)
    sim.ledger.row("blocks", sim.tick, place, int(stands))
    sim.say("blocked" if stands else "unblocked", sim.world.label(place), int(stands), NONE, place)
    if sim.k == NONE:
        sim.look()


COMMANDS: dict[str, tuple[Callable[..., str], dict[str, Any]]] = {
    "send": (_send, {"vehicle": int, "place": int}),
    "pause": (_pause, {"vehicle": int}),
    "continue": (_continue, {"vehicle": int}),
    "fail": (_fail, {"vehicle": int}),
    "repair": (_repair, {"vehicle": int}),
    "block": (_block, {"place": int}),
    "unblock": (_unblock, {"place": int}),
}
"""What may be said: who does it, and its fields."""
