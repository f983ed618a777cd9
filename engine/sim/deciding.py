"""What happens between two ticks when somebody must decide: orders, charging, dispatch, the end of the run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from engine.dispatch.base import NOBODY_FREE
from engine.planners.base import Leg
from engine.sim import kernels, operating, planning, recovery, together
from engine.sim.state import ARRIVED, CHARGED, EMPTY, ORDER_DONE, PICKED, RESTLESS, STALLED
from engine.types import FOREVER, NONE, Activity, OrderState, PlanStatus, StationKind, Task
from engine.units import ticks_from_s

if TYPE_CHECKING:
    from engine.dispatch.base import Assignment
    from engine.sim.simulation import Simulation

SENT = int(Task.SENT)
ROUNDS = 4
"""How many times orders are given out anew at one tick when some of them find no way."""
STAND_BACK_S = 30.0
"""Seconds for which an order that found no way lets others go first."""


def decide(sim: Simulation, broken: bool, more: bool = True) -> None:
    """Act on what happened; when that is only that loads were picked up and nothing else asks, note it."""
    news = read_marks(sim)
    sim.retry = FOREVER
    if not (news or broken or more or sim.plan_all or unplanned_work(sim)):
        planning.retime(sim)
        return
    take_orders(sim)
    if broken:
        recovery.break_and_repair(sim)
    recovery.replan(sim)
    together.decide(sim)
    refresh_view(sim)
    charging(sim)
    dispatch(sim)
    while more_orders(sim) and free_vehicles(sim):
        dispatch(sim)
    planning.retime(sim)
    restless = unplanned_work(sim)
    sim.clock[RESTLESS] = int(restless or len(sim.goals) > 0)
    if restless:
        sim.retry = sim.tick + max(1, ticks_from_s(recovery.RETRY_S, sim.tick_s))
    check_done(sim)


def unplanned_work(sim: Simulation) -> bool:
    return bool(sim.needs_plan or sim.queue or together.away(sim) or (sim.book.open and free_vehicles(sim)))


def take_orders(sim: Simulation) -> bool:
    taken = False
    while sim.source.next_tick <= sim.tick:
        _, a, b = sim.source.take()
        add_order(sim, a, b, source=0)
        taken = True
    return taken


def more_orders(sim: Simulation) -> bool:
    """Let the source see how many orders are open, and take what comes at once."""
    sim.source.see(len(sim.book.open))
    return take_orders(sim)


def add_order(sim: Simulation, a: int, b: int, source: int) -> int:
    """A new order between two station numbers; returns its number."""
    places = (sim.world.station(a).place, sim.world.station(b).place)
    order = sim.book.add(sim.tick, (a, b), places, source)
    order_row(sim, order)
    ways = f"from {sim.world.station(a).name} to {sim.world.station(b).name}"
    sim.say("new order", f"order {order} {ways}", 0, NONE, order, places[0])
    return order


def order_row(sim: Simulation, order: int, tick: int | None = None) -> None:
    b = sim.book
    sim.ledger.row(
        "orders", sim.tick if tick is None else tick, order, b.state[order], b.vehicle[order],
        b.from_place[order], b.to_place[order], b.from_station[order], b.to_station[order], b.source[order],
    )  # fmt: skip


def read_marks(sim: Simulation, before: int = FOREVER) -> bool:
    """Take note of what the kernel tells, but for the marks of later ticks; False when loads were picked up at most.

    Marks of earlier ticks are loads for which nobody had to be asked; they go into the log before what comes now.
    """
    sink = sim.sink
    n = int(sink.filled[3])
    if n == 0 or sink.marks[0, 0] >= before:
        return False
    marks = sink.marks[:n].tolist()
    later = [mark for mark in marks if mark[0] >= before]
    sink.marks[: len(later)] = sink.marks[n - len(later) : n]
    sink.filled[3] = len(later)
    news = False
    for tick, v, bit, order in marks[: n - len(later)]:
        news |= bit != PICKED
        if bit == PICKED:
            sim.book.state[order] = int(OrderState.PICKED)
            order_row(sim, order, tick)
            if tick == sim.tick:
                exchange(sim, v, sim.book.from_station[order])
        elif bit == ORDER_DONE:
            order_done(sim, tick, v, order)
        elif bit == ARRIVED:
            if v not in sim.needs_plan:
                arrived(sim, v)
        elif bit == CHARGED:
            if sim.must_charge[v]:
                sim.say("charged", f"vehicle {v} has enough charge to take orders again", 0, v)
            sim.must_charge[v] = 0
        elif bit == EMPTY:
            sim.say("stranded", f"vehicle {v} has run empty", 2, v, int(sim.fleet.order[v]))
            if not sim.open_loop:
                recovery.fail(sim, v)
        elif bit == STALLED:
            recovery.unlock(sim, v)
    return news


def order_done(sim: Simulation, tick: int, v: int, order: int) -> None:
    f, book = sim.fleet, sim.book
    book.state[order] = int(OrderState.DONE)
    book.done_at[order] = tick
    book.n_done += 1
    order_row(sim, order, tick)
    target = sim.world.station(book.to_station[order]).name
    sim.say("delivered", f"vehicle {v} has brought order {order} to {target}", 0, v, order, book.to_place[order])
    f.order[v] = NONE
    exchange(sim, v, book.to_station[order])
    check_low(sim, v)
    at_charger = sim.home[v] != NONE and sim.view.is_charger[sim.home[v]]
    f.task[v] = int(Task.TO_CHARGER if sim.must_charge[v] and at_charger else Task.TO_REST)


def exchange(sim: Simulation, v: int, station: int) -> None:
    """Where batteries are swapped, change that of a vehicle just served at an entrance when it is low."""
    low = sim.fleet.charge[v] < sim.levels.good[v]
    if sim.swaps and low and sim.world.station(station).kind is StationKind.ENTRANCE:
        operating.change_battery(sim, v, 1.0, level=0)


def check_low(sim: Simulation, v: int) -> None:
    if sim.swaps:
        return  # every order leads to an entrance
    soc = sim.fleet.charge[v] / sim.parts.battery.capacity_mc
    if sim.charge_later[v] or soc < sim.thresholds["good"]:
        sim.charge_later[v] = 0
        sim.must_charge[v] = 1


def arrived(sim: Simulation, v: int) -> None:
    f = sim.fleet
    if f.task[v] == Task.SENT:
        sim.say("arrived", f"vehicle {v} is where it was sent", 0, v, NONE, int(sim.graph.state_place[f.state[v]]))
    f.task[v] = int(Task.NONE)
    check_low(sim, v)
    home = int(sim.home[v])
    if sim.view.is_charger[home]:
        planning.charger_row(sim, home, v, 1)
        if sim.must_charge[v]:
            sim.say("charging", f"vehicle {v} charges at {sim.world.place_name(home)}", 0, v, NONE, home)


def refresh_view(sim: Simulation) -> None:
    f, battery = sim.fleet, sim.parts.battery
    sim.view.tick = sim.tick
    kernels.refresh(
        f.edge, f.state, f.charge, sim.graph.edge_to, battery.below_mv, battery.voltage_mv, battery.capacity_mc,
        sim.view.at, sim.view.charge_mj,
    )  # fmt: skip


def idle_vehicles(sim: Simulation) -> list[int]:
    """Vehicles without an order that could be sent somewhere."""
    f = sim.fleet
    orders = f.order.tolist()
    if NONE not in orders:
        return []
    idle = [v for v, order in enumerate(orders) if order == NONE]
    return [v for v in idle if not (f.failed[v] or f.paused[v] or f.task[v] == SENT or v in sim.needs_plan)]


def free_vehicles(sim: Simulation) -> list[int]:
    """Vehicles that may take an order now."""
    return [v for v in idle_vehicles(sim) if not sim.must_charge[v]]


def charging(sim: Simulation) -> None:
    idle = idle_vehicles(sim)
    if not idle or (sim.open_loop and len(sim.goals)):
        sim.queue = []
        return
    f = sim.fleet
    for v in idle if not sim.swaps else ():
        if f.charge[v] < sim.levels.good[v]:
            sim.must_charge[v] = 1
    if not sim.must_charge.tobytes().count(1) and all(home_is_good(sim, v) for v in idle):
        sim.queue = []
        return
    moves, queue = sim.parts.charging.moves(sim.view, idle)
    no_way: list[int] = []
    careful = len(sim.goals) == 0  # who has a goal goes there, come what may
    for move in moves:
        task = Task.TO_CHARGER if move.to_charge else Task.TO_REST
        status = planning.attempt(sim, move.vehicle, (), move.rests, task, NONE, within_charge=careful)
        if status is PlanStatus.SOLVED and planning.under_way(sim, move.vehicle):
            f.task[move.vehicle] = int(task)
        elif status is not PlanStatus.SOLVED and move.to_charge:
            no_way.append(move.vehicle)
    for v in [*queue, *no_way]:
        if v not in sim.queue:
            sim.say("charger queue", f"vehicle {v} waits for a {'free' if v in queue else 'way to a'} charger", 1, v)
    sim.queue = [*queue, *no_way]


def home_is_good(sim: Simulation, v: int) -> bool:
    home = int(sim.home[v])
    return home != NONE and bool(sim.view.is_rest[home]) and not sim.blocked[home]


def dispatch(sim: Simulation) -> None:
    """Give open orders to free vehicles; an order that finds no way stands back for a while, the next one is tried."""
    refused: dict[int, str] = {}
    hungry = False
    for _ in range(ROUNDS):
        tick = sim.tick
        waiting = [o for o in sim.book.open if sim.not_before.get(o, 0) <= tick] if sim.not_before else sim.book.open[:]
        free = free_vehicles(sim) if waiting else []
        if not free:
            break
        sim.view.waiting = waiting
        assignments, refusals = sim.parts.dispatcher.assign(sim.view, free)
        refused |= {r.order: r.reason for r in refusals}
        failed = [(a, why) for a in assignments if (why := give(sim, a)) is not PlanStatus.SOLVED]
        for a, why in failed:
            refused[a.order] = "no way free of conflicts was found"
            if why is PlanStatus.CHARGE:
                refused[a.order] = f"vehicle {a.vehicle} has too little charge for the way that is free"
                if charge_first(sim, a.vehicle):
                    hungry = True
                    continue  # another vehicle may have it at once
            sim.not_before[a.order] = sim.tick + max(1, ticks_from_s(STAND_BACK_S, sim.tick_s))
        if not failed:
            break
        refresh_view(sim)
    for order, reason in refused.items():
        if sim.reasons.get(order) != reason and order in sim.book.open:
            refuse(sim, order, reason)
    if hungry:
        charging(sim)


def charge_first(sim: Simulation, v: int) -> bool:
    """A free vehicle takes no orders until it is charged; False when it has nearly all that it can have."""
    if sim.fleet.charge[v] >= sim.levels.top_up[v] or not sim.view.is_charger.any():
        return False
    sim.must_charge[v] = 1
    return True


def give(sim: Simulation, a: Assignment) -> PlanStatus:
    """Plan an assignment and put it on the floor; NO_PATH or CHARGE when its vehicle finds no way within its charge."""
    book = sim.book
    pick, drop = sim.view.service_ticks
    target = book.to_place[a.order] if a.target == NONE else a.target
    legs = (
        Leg(book.from_place[a.order], pick, Activity.PICK, False),
        Leg(target, drop, Activity.DROP, True),
    )
    status = planning.attempt(sim, a.vehicle, legs, a.rests, Task.TO_PICK, a.order)
    if status is not PlanStatus.SOLVED:
        return status
    where = ""
    if target != book.to_place[a.order]:
        station = next(s for s in sim.world.stations if s.place == target)
        book.to_place[a.order], book.to_station[a.order] = target, station.number
        where = f" and brings it to {station.name}"
    book.assign(a.order, a.vehicle)
    sim.reasons.pop(a.order, None)
    sim.not_before.pop(a.order, None)
    sim.fleet.order[a.vehicle] = a.order
    sim.fleet.task[a.vehicle] = int(Task.TO_PICK)
    order_row(sim, a.order)
    note = f" ({a.note})" if a.note else ""
    sim.say("assigned", f"vehicle {a.vehicle} takes order {a.order}{where}{note}", 0, a.vehicle, a.order)
    return status


def refuse(sim: Simulation, order: int, reason: str) -> None:
    """Remember why an order waits now, and say so; that nobody is free is no news."""
    if reason == NOBODY_FREE and order in sim.reasons:
        return
    sim.reasons[order] = reason
    if reason != NOBODY_FREE:
        sim.say("order waits", f"order {order}: {reason}", 0, NONE, order)


def check_done(sim: Simulation) -> None:
    finish = sim.scenario.time.finish
    if finish == "goals reached":
        if together.reached(sim):
            sim.done = True
            sim.say("run done", "every vehicle rests at its goal")
        return
    if finish == "never" or sim.source.next_tick < FOREVER or sim.book.unfinished:
        return
    f = sim.fleet
    if finish == "orders done and home":
        home = (f.step >= f.steps) & (f.t1 == FOREVER) & (sim.graph.state_place[f.state] == sim.home)
        if not (home | (f.failed != 0)).all() or sim.needs_plan:
            return
    sim.done = True
    sim.say("run done", "all orders are done" + (" and every vehicle is home" if "home" in finish else ""))
