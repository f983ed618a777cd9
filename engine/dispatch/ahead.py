"""Dispatch by sequences: plan who takes which open orders one after another, then give every free vehicle its first.

Vehicles under way are planned with what they still have to do, so an order may wait for a vehicle that is near soon.
The plan is made anew at every decision and not remembered.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from engine.dispatch.base import NOBODY_FREE, Assignment, ChargingPolicy, FloorView, Refusal
from engine.dispatch.nearest import Nearest
from engine.dispatch.schedule import ALLOWED, BARRED, Schedule, Work
from engine.planners.base import NO_WAY
from engine.types import NONE, OrderState

LATER = "it comes later in a vehicle's sequence"
ELSEWHERE = "no vehicle of its region can reach it"


def give_first(
    view: FloorView, free: list[int], charging: ChargingPolicy, look: int, plan: Callable[[Work], Schedule]
) -> tuple[list[Assignment], list[Refusal]]:
    """The first orders of the free vehicles' sequences, with a check that the battery lasts; see Dispatcher.

    An order whose vehicle can't take it now goes to the nearest free vehicle that has nothing to do.
    """
    looked = view.waiting[:look]
    if not free:
        return [], [Refusal(o, NOBODY_FREE) for o in looked]
    refused = [Refusal(o, "its station is blocked") for o in looked if not view.targets(o)]
    orders = [o for o in looked if view.targets(o)]
    vehicles = [*free, *(v for v in busy(view) if v not in free)]
    work, targets = work_of(view, vehicles, orders)
    schedule = plan(work)
    nearest = Nearest(charging)
    out: list[Assignment] = []
    taken: set[int] = set()
    failed: list[tuple[int, int, Refusal]] = []
    given: set[int] = set()
    for r, route in enumerate(schedule.routes[: len(free)]):
        if not route:
            continue
        order, target = orders[route[0]], targets[schedule.exits[r][0]]
        found = nearest.choose(view, order, [vehicles[r]], taken, target)
        if isinstance(found, Refusal):
            failed.append((order, target, found))
            continue
        good = f"at most {100 * schedule.gap:.1f} % above the least" if schedule.gap else "the least possible"
        note = f"first of {len(route)}; all are done in {round(schedule.makespan * view.tick_s)} s, {good}"
        out.append(Assignment(found.order, found.vehicle, found.rests, target, note))
        taken.add(found.rests[0])
        given.add(order)
    for order, target, why in failed:
        left = [v for v in free if all(a.vehicle != v for a in out)]
        found = nearest.choose(view, order, left, taken, target) if left else why
        if isinstance(found, Refusal):
            refused.append(found)
        else:
            out.append(Assignment(found.order, found.vehicle, found.rests, target))
            taken.add(found.rests[0])
        given.add(order)
    planned = {i for route in schedule.routes for i in route}
    for i, order in enumerate(orders):
        if order not in given:
            refused.append(Refusal(order, LATER if i in planned else ELSEWHERE))
    return out, refused


def busy(view: FloorView) -> list[int]:
    """Vehicles that carry out an order now, and will be free after it."""
    out = (view.order == NONE) | (view.failed != 0) | (view.paused != 0) | (view.must_charge != 0)
    return [int(v) for v in np.flatnonzero(~out)]


def work_of(view: FloorView, vehicles: list[int], orders: list[int]) -> tuple[Work, list[int]]:
    """The open orders as work for these vehicles, in ticks from now on an empty floor; and the place of every exit."""
    pick, drop = view.service_ticks
    graph, search, book = view.search.graph, view.search, view.orders
    begin = [book.from_place[o] for o in orders]
    ways_out = [view.targets(o) for o in orders]
    exits = sorted({place for places in ways_out for place in places})
    ready, state = _ready(view, vehicles)
    standing = np.array(graph.place_ptr, np.int32)
    first = np.full((len(vehicles), len(orders)), BARRED, np.int64)
    back = np.full((len(exits), len(orders)), BARRED, np.int64)
    carry = np.full((len(orders), len(exits)), BARRED, np.int64)
    at_exits, at_begin = standing[exits], standing[begin]
    for i, place in enumerate(begin):
        first[:, i] = ready + search.ticks_from(place, state)
        back[:, i] = search.ticks_from(place, at_exits)
        first[[not view.may_take(v, orders[i]) for v in vehicles], i] = BARRED
    for e, place in enumerate(exits):
        serves = np.array([place in places for places in ways_out], np.bool_)
        carry[:, e] = np.where(serves, pick + drop + search.ticks_from(place, at_begin), BARRED)
    for times in (first, back, carry):
        times[times >= min(NO_WAY, ALLOWED)] = BARRED
    return Work(first, carry, back), exits


def _ready(view: FloorView, vehicles: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """(R,) ticks until each vehicle is done with its order, and (R,) the state in which it is then."""
    graph, search, book = view.search.graph, view.search, view.orders
    pick, drop = view.service_ticks
    ready = np.zeros(len(vehicles), np.int64)
    state = np.array([int(view.at[v]) for v in vehicles], np.int32)
    for r, v in enumerate(vehicles):
        order = int(view.order[v])
        if order == NONE:
            continue
        begin, end = book.from_place[order], book.to_place[order]
        if book.state[order] == OrderState.ASSIGNED:
            ready[r] += search.ticks_to(begin, int(state[r])) + pick
            state[r] = graph.place_ptr[begin]
        ready[r] += search.ticks_to(end, int(state[r])) + drop
        state[r] = graph.place_ptr[end]
    return ready, state
