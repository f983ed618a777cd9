"""When plans fail: breakdowns and repairs, planning anew whoever lost a plan, the deadlock watch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from engine.planners.base import Leg
from engine.sim import deciding, planning
from engine.types import FOREVER, NONE, Activity, OrderState, Task
from engine.units import ticks_from_s

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation

RETRY_S = 5.0
"""Seconds until what could not be planned is tried again."""


def replan(sim: Simulation) -> None:
    """Plan the vehicles that lost their plans; those whose way they block lose theirs in turn."""
    if not sim.needs_plan:
        return
    pause = max(1, ticks_from_s(RETRY_S, sim.tick_s))
    for _ in range(2):
        waiting, sim.needs_plan = sim.needs_plan, []
        later = [v for v in waiting if sim.try_at[v] > sim.tick]
        stuck: list[int] = []
        for v in waiting:
            if sim.try_at[v] > sim.tick:
                continue
            sim.try_at[v] = sim.tick + pause
            if sim.fleet.failed[v] or not plan_again(sim, v):
                stuck.append(v)
        fresh: list[int] = []
        for v in stuck:
            for w in planning.behind(sim, v):
                if w not in stuck and w not in later:
                    if sim.fleet.task[w] == Task.SENT:
                        sim.say("stalled", f"vehicle {v} stands in the way of vehicle {w}, which is planned anew", 1, w)
                    planning.drop_plan(sim, w)
                    fresh.append(w)
        sim.needs_plan = list(dict.fromkeys([*stuck, *later, *sim.needs_plan]))
        if not fresh:
            break
        for v in stuck:
            sim.try_at[v] = sim.tick
    sim.needs_plan = [v for v in sim.needs_plan if not sim.fleet.failed[v]]


def plan_again(sim: Simulation, v: int) -> bool:
    """A new plan for what a vehicle was doing; if that is impossible now, at least to a rest place."""
    deciding.refresh_view(sim)
    f, book = sim.fleet, sim.book
    order = int(f.order[v])
    pick, drop = planning.service_ticks(sim)
    legs: tuple[Leg, ...] = ()
    task = Task.TO_REST
    service = planning.service(sim, v)
    picked = order != NONE and (book.state[order] == OrderState.PICKED or service == Activity.PICK)
    if order != NONE and service != Activity.DROP:
        target = Leg(book.to_place[order], drop, Activity.DROP, True)
        legs, task = (target,), Task.TO_DROP
        if not picked:
            legs, task = (Leg(book.from_place[order], pick, Activity.PICK, False), target), Task.TO_PICK
    end = legs[-1].place if legs else int(sim.graph.state_place[sim.view.at[v]])
    rests = sim.parts.charging.rests_after(sim.view, v, end, int(sim.view.charge_mj[v]))
    more = sim.view.nearest_rest(v, end, chargers_only=False, count=6)
    every = tuple(dict.fromkeys([*rests, *more]))
    if planning.send(sim, v, legs, every, task, order):
        if service is None:
            f.task[v] = int(task)
        return True
    if order != NONE and not picked:
        give_back(sim, v, order)
        return plan_again(sim, v)
    # loaded: stand aside where it blocks nobody, and try again later
    if legs and planning.send(sim, v, (), every, Task.TO_DROP, order):
        sim.needs_plan.append(v)
        return True
    return False


def give_back(sim: Simulation, v: int, order: int) -> None:
    sim.book.reopen(order)
    sim.fleet.order[v] = NONE
    sim.fleet.task[v] = int(Task.TO_REST)
    deciding.check_low(sim, v)
    deciding.order_row(sim, order)
    sim.say("order given back", f"vehicle {v} gives order {order} back", 1, v, order)


def fail(sim: Simulation, v: int, until: int = FOREVER) -> None:
    """A vehicle breaks down once its present motion has ended."""
    f = sim.fleet
    f.failed[v] = 1
    planning.drop_plan(sim, v)
    order = int(f.order[v])
    if order != NONE and sim.book.state[order] == OrderState.ASSIGNED and planning.service(sim, v) is None:
        give_back(sim, v, order)
    sim.faults.repair_at(v, until)


def break_and_repair(sim: Simulation) -> None:
    for v, repaired in sim.faults.due(sim.tick):
        if repaired:
            repair(sim, v)
        elif not sim.fleet.failed[v]:
            sim.say("breakdown", f"vehicle {v} has broken down", 2, v, int(sim.fleet.order[v]))
            fail(sim, v, sim.tick + sim.faults.repair_ticks)


def repair(sim: Simulation, v: int) -> None:
    if not sim.fleet.failed[v]:
        return
    sim.fleet.failed[v] = 0
    sim.say("repaired", f"vehicle {v} works again", 0, v)
    sim.try_at[:] = sim.together_at = 0
    if v not in sim.needs_plan:
        sim.needs_plan.append(v)


def unlock(sim: Simulation, v: int) -> None:
    """Deadlock watch: a vehicle has waited long. Follow who waits for whom; replan when that leads nowhere."""
    f = sim.fleet
    if f.stalled[v] < 0:
        return
    chain = [v]
    while f.blocker[chain[-1]] >= 0 and int(f.blocker[chain[-1]]) not in chain:
        chain.append(int(f.blocker[chain[-1]]))
    last = int(f.blocker[chain[-1]])
    names = " → ".join(str(x) for x in chain)
    if last >= 0:
        sim.deadlocks += 1
        sim.say("deadlock", f"vehicles wait for each other: {names} → {last}; they are planned anew", 2, v)
        for w in chain[chain.index(last) :]:
            planning.drop_plan(sim, w)
    elif f.steps[chain[-1]] <= f.step[chain[-1]] or f.paused[chain[-1]] or f.failed[chain[-1]] or len(chain) == 1:
        sim.say("stalled", f"vehicle {v} has waited long behind {names}; it is planned anew", 1, v)
        planning.drop_plan(sim, v)
