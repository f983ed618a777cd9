"""Is every order picked and dropped once, at its places, by its vehicle, in turn, and for as long as service takes?"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from engine.scenario import Scenario
from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.motion import name
from engine.sim.judge.record import Record, RunLog, last_before
from engine.types import Activity, OrderState
from engine.units import ticks_from_s
from engine.world.floor import World

O = OrderState  # noqa: E741
_NEXT: dict[int, tuple[int, ...]] = {
    -1: (O.OPEN,),
    O.OPEN: (O.ASSIGNED, O.WITHDRAWN),
    O.ASSIGNED: (O.ASSIGNED, O.OPEN, O.PICKED, O.WITHDRAWN),
    O.PICKED: (O.DONE,),
    O.DONE: (),
    O.WITHDRAWN: (),
}
_WORD = {s.value: s.name.lower() for s in O}


def orders(r: Record, log: RunLog, scenario: Scenario, world: World) -> Iterator[Breach]:
    """Every breach in the life of every order."""
    yield from islice(_lives(log), REPORTED)
    yield from islice(_ways(log, scenario, world), REPORTED)
    yield from islice(_services(r, log, scenario, world), REPORTED)
    yield from islice(_loads(r, log, world), REPORTED)


def _lives(log: RunLog) -> Iterator[Breach]:
    """States follow each other as they may, and the vehicle that picks is the one assigned."""
    t = log.table("orders")
    state: dict[int, int] = {}
    owner: dict[int, int] = {}
    last: dict[int, int] = {}
    columns = (t[c].tolist() for c in ("tick", "order", "state", "vehicle"))
    for tick, order, new, vehicle in zip(*columns, strict=True):
        old = state.get(order, -1)
        if new not in _NEXT[old]:
            before = _WORD.get(old, "unknown")
            text = f"order {order} becomes {_WORD.get(new, new)} at tick {tick} while it is {before}"
            yield Breach(BreachKind.ORDER, tick, (vehicle,) if vehicle >= 0 else (), -1, text)
        elif tick < last.get(order, tick):
            yield Breach(BreachKind.ORDER, tick, (), -1, f"order {order} goes back in time at tick {tick}")
        if new == O.ASSIGNED:
            owner[order] = vehicle
        elif new in (O.PICKED, O.DONE) and vehicle != owner.get(order, vehicle):
            text = f"order {order} is {_WORD[new]} by vehicle {vehicle} and assigned to vehicle {owner[order]}"
            yield Breach(BreachKind.ORDER, tick, (vehicle, owner[order]), -1, text)
        state[order], last[order] = new, tick


def _ways(log: RunLog, scenario: Scenario, world: World) -> Iterator[Breach]:
    """An order keeps its stations; where exits are chosen, it may get another outbound one when it is assigned. And
    with regions, a vehicle takes orders of its own."""
    t = log.table("orders")
    chosen = scenario.dispatch.exits == "any outbound"
    regions, width = scenario.dispatch.regions, world.size_m[0]
    outbound = {s.number for s in world.stations_of("outbound")}
    ways: dict[int, tuple[int, int]] = {}
    columns = (t[c].tolist() for c in ("tick", "order", "state", "vehicle", "from_station", "to_station", "from_place"))
    for tick, order, state, vehicle, start, end, place in zip(*columns, strict=True):
        before = ways.setdefault(order, (start, end))
        ways[order] = (start, end)
        free = chosen and state == O.ASSIGNED and {before[1], end} <= outbound
        if before[0] != start or (before[1] != end and not free):
            text = (
                f"order {order} goes from {start} to {end} at tick {tick}, and before from {before[0]} to {before[1]}"
            )
            yield Breach(BreachKind.ORDER, tick, (), place, text)
        if regions and state == O.ASSIGNED:
            own = min(int(float(world.graph.xy_m[place, 0]) / width * regions), regions - 1)
            if own != vehicle % regions:
                text = f"vehicle {vehicle} of region {vehicle % regions} takes order {order} of region {own}"
                yield Breach(BreachKind.ORDER, tick, (vehicle,), place, text)


def _services(r: Record, log: RunLog, scenario: Scenario, world: World) -> Iterator[Breach]:
    """Each picked and done row has its service, at the order's place and of the right length; and conversely."""
    t = log.table("orders")
    tick_s = scenario.time.tick_s
    lasts = {
        int(Activity.PICK): ticks_from_s(scenario.service.pick_s, tick_s),
        int(Activity.DROP): ticks_from_s(scenario.service.drop_s, tick_s),
    }
    word = {int(Activity.PICK): "picked", int(Activity.DROP): "dropped"}
    # (kind, vehicle, order) → (place, ticks, tick of the end); parts of an interrupted service add up
    done: dict[tuple[int, int, int], tuple[int, int, int]] = {}
    rows = np.nonzero(((r.kind == Activity.PICK) | (r.kind == Activity.DROP)) & ~r.still)[0]
    columns = (c[rows].tolist() for c in (r.kind, r.vehicle, r.order, r.b, r.t0, r.t1))
    for kind, v, order, place, t0, t1 in zip(*columns, strict=True):
        ticks = done.get((kind, v, order), (place, 0, 0))[1] + t1 - t0
        done[kind, v, order] = (place, ticks, t1)
    columns = (t[c].tolist() for c in ("tick", "order", "state", "vehicle", "from_place", "to_place"))
    for tick, order, state, v, start, end in zip(*columns, strict=True):
        if state not in (O.PICKED, O.DONE) or tick <= r.first_tick:
            continue
        kind, place = (int(Activity.PICK), start) if state == O.PICKED else (int(Activity.DROP), end)
        service = done.pop((kind, v, order), None)
        if service is None and lasts[kind] == 0:
            at = int(r.before(np.array([v]), np.array([tick - 1]))[0])
            service = (int(r.b[at]), 0, tick) if at >= 0 else None
        if service is None:
            text = f"order {order} is {word[kind]} at tick {tick} without a service of vehicle {v}"
            yield Breach(BreachKind.ORDER, tick, (v,), place, text)
            continue
        if service[0] != place:
            text = f"order {order} is {word[kind]} at {name(world, service[0])} instead of {name(world, place)}"
            yield Breach(BreachKind.ORDER, tick, (v,), service[0], text)
        if service[2] != tick:
            text = f"order {order} is {word[kind]} at tick {tick}, and its service ends at tick {service[2]}"
            yield Breach(BreachKind.ORDER, tick, (v,), place, text)
        if service[1] != lasts[kind] and tick - service[1] > r.first_tick:
            text = f"order {order} is {word[kind]} in {service[1]} ticks; the scenario says {lasts[kind]}"
            yield Breach(BreachKind.SERVICE, tick, (v,), place, text)
    for (kind, v, order), (place, ticks, tick) in done.items():
        if ticks >= lasts[kind]:
            text = f"vehicle {v} serves order {order} at tick {tick}, which is not {word[kind]} then"
            yield Breach(BreachKind.ORDER, tick, (v,), place, text)


def _loads(r: Record, log: RunLog, world: World) -> Iterator[Breach]:
    """A vehicle is loaded from the end of its pick to the end of its drop, and never otherwise."""
    t = log.table("orders")
    state, vehicle = np.asarray(t["state"], np.int64), np.asarray(t["vehicle"], np.int64)
    rows = np.nonzero(((state == O.PICKED) | (state == O.DONE)) & (vehicle >= 0))[0]
    tick = np.asarray(t["tick"], np.int64)[rows]
    order = np.lexsort((rows, tick, vehicle[rows]))
    rows = rows[order]
    key = (vehicle[rows] << 32) + tick[order]
    expected = last_before(key, state[rows] == O.PICKED, r.vehicle, r.t0, 0)
    for i in np.nonzero(r.loaded != expected)[0].tolist():
        v, t0 = int(r.vehicle[i]), int(r.t0[i])
        word = "loaded" if r.loaded[i] else "empty"
        text = f"vehicle {v} is logged as {word} at tick {t0}, and its orders say otherwise"
        yield Breach(BreachKind.LOAD, t0, (v,), int(r.b[i]), text)
