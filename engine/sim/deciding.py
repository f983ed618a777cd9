"""What happens between two ticks when somebody must decide: orders, charging, dispatch, the end of the run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from engine.planners.base import Leg
from engine.sim import planning, recovery
from engine.sim.state import ARRIVED, CHARGED, EMPTY, ORDER_DONE, PICKED, STALLED
from engine.types import FOREVER, NONE, Activity, OrderState, Task
from engine.units import ticks_from_s

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation


def decide(sim: Simulation, broken: bool) -> None:
    sim.retry = FOREVER
    read_marks(sim)
    if broken:
        recovery.break_and_repair(sim)
    recovery.replan(sim)
    refresh_view(sim)
    charging(sim)
    dispatch(sim)
    if unplanned_work(sim):
        sim.retry = sim.tick + max(1, ticks_from_s(recovery.RETRY_S, sim.tick_s))
    check_done(sim)


def unplanned_work(sim: Simulation) -> bool:
    return bool(sim.needs_plan or sim.queue or (sim.book.open and free_vehicles(sim)))


def take_orders(sim: Simulation) -> bool:
    taken = False
    while sim.source.next_tick <= sim.tick:
        _, a, b = sim.source.take()
        add_order(sim, a, b, source=0)
        taken = True
    return taken


def add_order(sim: Simulation, a: int, b: int, source: int) -> int:
    """A new order between two station numbers; returns its number."""
    places = (sim.world.station(a).place, sim.world.station(b).place)
    order = sim.book.add(sim.tick, (a, b), places, source)
    order_row(sim, order)
    return order


def order_row(sim: Simulation, order: int, tick: int | None = None) -> None:
    b = sim.book
    sim.ledger.row(
        "orders", sim.tick if tick is None else tick, order, b.state[order], b.vehicle[order],
        b.from_place[order], b.to_place[order], b.from_station[order], b.to_station[order], b.source[order],
    )  # fmt: skip


def read_marks(sim: Simulation) -> None:
    sink = sim.sink
    n = int(sink.filled[3])
    marks = sink.marks[:n].tolist()
    sink.filled[3] = 0
    for tick, v, bit, order in marks:
        if bit == PICKED:
            sim.book.state[order] = int(OrderState.PICKED)
            order_row(sim, order, tick)
        elif bit == ORDER_DONE:
            order_done(sim, tick, v, order)
        elif bit == ARRIVED:
            if v not in sim.needs_plan:
                arrived(sim, v)
        elif bit == CHARGED:
            sim.must_charge[v] = 0
        elif bit == EMPTY:
            sim.say("stranded", f"vehicle {v} has run empty", 2, v, int(sim.fleet.order[v]))
            recovery.fail(sim, v)
        elif bit == STALLED:
            recovery.unlock(sim, v)


def order_done(sim: Simulation, tick: int, v: int, order: int) -> None:
    f, book = sim.fleet, sim.book
    book.state[order] = int(OrderState.DONE)
    book.done_at[order] = tick
    book.n_done += 1
    order_row(sim, order, tick)
    f.order[v] = NONE
    check_low(sim, v)
    at_charger = sim.home[v] != NONE and sim.view.is_charger[sim.home[v]]
    f.task[v] = int(Task.TO_CHARGER if sim.must_charge[v] and at_charger else Task.TO_REST)


def check_low(sim: Simulation, v: int) -> None:
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
    if sim.view.is_charger[sim.home[v]]:
        planning.charger_row(sim, int(sim.home[v]), v, 1)


def refresh_view(sim: Simulation) -> None:
    f, g = sim.fleet, sim.graph
    sim.view.tick = sim.tick
    driving = f.edge >= 0
    np.copyto(sim.view.at, np.where(driving, g.edge_to[np.maximum(f.edge, 0)], f.state))
    volts = int(sim.parts.battery.voltage_mv[-1])
    np.copyto(sim.view.charge_mj, f.charge * volts // 1000)


def idle_vehicles(sim: Simulation) -> list[int]:
    """Vehicles without an order that could be sent somewhere."""
    f = sim.fleet
    able = (f.order == NONE) & (f.failed == 0) & (f.paused == 0) & (f.task != Task.SENT)
    return [v for v in np.flatnonzero(able).tolist() if v not in sim.needs_plan]


def free_vehicles(sim: Simulation) -> list[int]:
    """Vehicles that may take an order now."""
    return [v for v in idle_vehicles(sim) if not sim.must_charge[v]]


def charging(sim: Simulation) -> None:
    idle = idle_vehicles(sim)
    if not idle:
        sim.queue = []
        return
    f = sim.fleet
    if not sim.must_charge.any() and all(home_is_good(sim, v) for v in idle):
        sim.queue = []
        return
    moves, queue = sim.parts.charging.moves(sim.view, idle)
    for move in moves:
        task = Task.TO_CHARGER if move.to_charge else Task.TO_REST
        if planning.send(sim, move.vehicle, (), move.rests, task, NONE):
            f.task[move.vehicle] = int(task)
    for v in queue:
        if v not in sim.queue:
            sim.say("charger queue", f"vehicle {v} waits for a free charger", 1, v)
    sim.queue = queue


def home_is_good(sim: Simulation, v: int) -> bool:
    home = int(sim.home[v])
    return home != NONE and bool(sim.view.is_rest[home]) and not sim.blocked[home]


def dispatch(sim: Simulation) -> None:
    if not sim.book.open:
        return
    free = free_vehicles(sim)
    if not free:
        return
    assignments, refusals = sim.parts.dispatcher.assign(sim.view, free)
    pick, drop = planning.service_ticks(sim)
    for a in assignments:
        legs = (
            Leg(sim.book.from_place[a.order], pick, Activity.PICK, False),
            Leg(sim.book.to_place[a.order], drop, Activity.DROP, True),
        )
        if planning.send(sim, a.vehicle, legs, a.rests, Task.TO_PICK, a.order):
            sim.book.assign(a.order, a.vehicle)
            sim.reasons.pop(a.order, None)
            sim.fleet.order[a.vehicle] = a.order
            sim.fleet.task[a.vehicle] = int(Task.TO_PICK)
            order_row(sim, a.order)
        else:
            refuse(sim, a.order, f"vehicle {a.vehicle} found no way free of conflicts")
    for r in refusals:
        refuse(sim, r.order, r.reason)


def refuse(sim: Simulation, order: int, reason: str) -> None:
    if sim.reasons.get(order) != reason:
        sim.reasons[order] = reason
        if reason != "no vehicle is free":
            sim.say("order waits", f"order {order}: {reason}", 0, NONE, order)


def check_done(sim: Simulation) -> None:
    finish = sim.scenario.time.finish
    if finish == "never" or sim.source.next_tick < FOREVER or sim.book.unfinished:
        return
    f = sim.fleet
    if finish == "orders done and home":
        home = (f.step >= f.steps) & (f.t1 == FOREVER) & (sim.graph.state_place[f.state] == sim.home)
        if not (home | (f.failed != 0)).all() or sim.needs_plan:
            return
    sim.done = True
    sim.say("run done", "all orders are done" + (" and every vehicle is home" if "home" in finish else ""))
