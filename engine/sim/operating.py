"""What an operator's command does to the run, once it has been found good."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from engine.sim import deciding, planning
from engine.types import FOREVER, NONE, Activity, Task

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation


def is_rest(sim: Simulation, place: int) -> bool:
    """True for a working charger or parking bay."""
    return bool(sim.view.is_rest[place])


def release_order(sim: Simulation, v: int) -> None:
    """A vehicle forgets its order and will be planned anew."""
    sim.fleet.order[v] = NONE
    sim.fleet.task[v] = int(Task.TO_REST)
    deciding.check_low(sim, v)
    planning.drop_plan(sim, v)


def send_to(sim: Simulation, v: int, place: int) -> bool:
    """Plan a vehicle to a place where it stays; False when there is no way."""
    deciding.refresh_view(sim)
    if not planning.send(sim, v, (), (place,), Task.SENT, NONE):
        return False
    if planning.under_way(sim, v):
        sim.fleet.task[v] = int(Task.SENT)
    if v in sim.needs_plan:
        sim.needs_plan.remove(v)
    return True


def set_block(sim: Simulation, place: int, blocked: bool) -> None:
    """Block a place or free it; vehicles that would enter it are planned anew."""
    sim.blocked[place] = int(blocked)
    sim.block_version += 1
    sim.ledger.row("blocks", sim.tick, place, int(blocked))
    sim.say("blocked" if blocked else "unblocked", sim.world.label(place), int(blocked), NONE, NONE, place)
    if not blocked:
        sim.try_at[:] = sim.together_at = 0
        return
    slot = int(sim.claims.next[place])
    owners: list[int] = []
    while slot >= 0:
        owner = int(sim.claims.owner[slot])
        if slot not in (int(sim.fleet.here[owner]), int(sim.fleet.back[owner])):
            owners.append(owner)
        slot = int(sim.claims.next[slot])
    for v in dict.fromkeys([*owners, *cutting(sim, place)]):
        planning.drop_plan(sim, v)


def cutting(sim: Simulation, place: int) -> list[int]:
    """Vehicles that will drive over a corner: under the classical rule no claim says so."""
    g, f = sim.graph, sim.fleet
    over = np.searchsorted(g.sweep_ptr, np.flatnonzero(g.sweep == place), side="right") - 1
    left = [(v, sim.steps.edge[v, f.step[v] : f.steps[v]]) for v in range(sim.n)]
    return [v for v, edges in left if np.isin(edges, over).any()]


def set_charger(sim: Simulation, charger: int, *, works: bool) -> None:
    """Take a charger out of order or back; vehicles on it or on their way look for another."""
    place = int(sim.world.chargers[charger])
    sim.charger_out[charger] = int(not works)
    sim.view.is_charger[place] = int(works)
    sim.view.is_rest[place] = int(works)
    v = int(sim.holder[place])
    sim.ledger.row("chargers", sim.tick, charger, v, 4 if works else 3)
    sim.say("charger back" if works else "charger out", f"charger C{charger + 1}", int(not works), v, NONE, place)
    if v == NONE:
        return
    f = sim.fleet
    if works:
        if f.final[v] == Activity.REST:
            f.final[v] = int(Activity.CHARGE)
    elif f.step[v] >= f.steps[v] and f.t1[v] == FOREVER:
        f.final[v] = int(Activity.REST)
    else:
        planning.drop_plan(sim, v)


def change_battery(sim: Simulation, v: int, share: float, level: int = 1) -> None:
    """A vehicle gets another battery, charged to a share of its capacity. level: of the event."""
    sim.fleet.charge[v] = round(int(sim.levels.capacity[v]) * share)
    sim.fleet.rest[v] = 0
    sim.say("battery changed", f"vehicle {v} got a battery at {100 * share:.0f} %", level, v)


def set_thresholds(sim: Simulation, new: dict[str, float]) -> None:
    """New charge levels, shares of the capacity."""
    sim.thresholds.update(new)
    capacity = sim.parts.battery.capacity_mc
    sim.levels.full[:] = round(capacity * new["full"])
    sim.levels.sufficient[:] = round(capacity * new["sufficient"])
    sim.levels.good[:] = round(capacity * new["good"])
    sim.levels.top_up[:] = round(capacity * max(new["full"] - 0.03, new["sufficient"] * 0.97))
    sim.must_charge[sim.fleet.charge >= sim.levels.sufficient] = 0
