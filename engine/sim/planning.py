"""Putting plans on the floor: asking the planner, committing its claims, re-timing them, giving them up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from engine import traffic
from engine.dispatch.base import SAFETY
from engine.planners.base import Budget, Leg, Plan, Request, View
from engine.sim import deciding
from engine.sim.state import HOLD, LATE, MARGIN
from engine.types import FOREVER, NONE, Activity, PlanStatus, Task
from engine.units import ticks_from_s

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation


def service_ticks(sim: Simulation) -> tuple[int, int]:
    service = sim.scenario.service
    return max(1, ticks_from_s(service.pick_s, sim.tick_s)), max(1, ticks_from_s(service.drop_s, sim.tick_s))


def send(sim: Simulation, v: int, legs: tuple[Leg, ...], rests: tuple[int, ...], task: Task, order: int) -> bool:
    """Plan a vehicle through legs to the first rest place that works, and commit it; False leaves all as it was."""
    return attempt(sim, v, legs, rests, task, order, within_charge=False) is PlanStatus.SOLVED


def attempt(
    sim: Simulation,
    v: int,
    legs: tuple[Leg, ...],
    rests: tuple[int, ...],
    task: Task,
    order: int,
    *,
    within_charge: bool = True,
) -> PlanStatus:
    """The same with the answer in a word: SOLVED, CHARGE when only plans beyond the charge were found, or NO_PATH."""
    why = PlanStatus.NO_PATH
    for rest in rests:
        final = Activity.CHARGE if sim.view.is_charger[rest] else Activity.REST
        status = plan(sim, v, (*legs, Leg(rest, 0, final, False)), final, task, order, within_charge)
        if status in (PlanStatus.SOLVED, PlanStatus.BOUNDED):
            return PlanStatus.SOLVED
        if status is PlanStatus.CHARGE:
            why = status
    return why


def plan(
    sim: Simulation, v: int, legs: tuple[Leg, ...], final: Activity, task: Task, order: int, within_charge: bool
) -> PlanStatus:
    f, p, c = sim.fleet, sim.steps, sim.claims
    retime(sim)
    tick = start_of(sim, v)[1]
    here, step, steps = int(f.here[v]), int(f.step[v]), int(f.steps[v])
    gap = traffic.lift(c, p, v, here, step, steps)
    plan, cpu_us = ask(sim, v, int(gap), legs)
    status = plan.status
    careful = within_charge and not sim.open_loop
    if plan.found and careful and left_after(sim, v, plan, tick) < floor_mj(sim, v, legs[-1].place, task):
        status = PlanStatus.CHARGE
    if not plan.found or status is PlanStatus.CHARGE:
        traffic.put_back(c, p, v, here, step, steps)
        sim.ledger.row(
            "plans", sim.tick, v, int(task), order, str(status), [], [], [], tick, tick, 0, plan.expanded, cpu_us
        )
        return status
    traffic.forget(c, p, v, step, steps, False)
    commit(sim, v, plan)
    accept(sim, v, plan, legs[-1].place, final, task, order, tick, cpu_us)
    return status


def left_after(sim: Simulation, v: int, plan: Plan, tick: int) -> int:
    """Energy in mJ left to a vehicle at the end of a plan that starts at a tick, waits included: exact without faults.

    A running motion counts as a whole.
    """
    f, costs, cls = sim.fleet, sim.parts.costs, int(sim.fleet.cls[v])
    now = sim.parts.battery.energy_of(int(f.charge[v]))
    if f.edge[v] >= 0:
        now -= int(costs.total_mj[cls, f.loaded[v], sim.graph.edge_kind[f.edge[v]]])
    return now - (tick - sim.tick) * int(costs.standby_mj[cls]) - plan.energy_mj


def floor_mj(sim: Simulation, v: int, rest: int, task: Task) -> int:
    """Energy in mJ that must be left at the end of a plan: the reserve, and the way to a charger where there is none.

    On the way to charge the reserve may be used: it is for that.
    """
    view = sim.view
    if view.is_charger[rest] and task is Task.TO_CHARGER:
        return 1
    reserve = int(view.levels["reserve"] * view.capacity_mj[v])
    return reserve if view.is_charger[rest] else reserve + int(view.to_charger_mj(rest) * SAFETY)


def ask(sim: Simulation, v: int, gap: int, legs: tuple[Leg, ...], *, exact: bool = False) -> tuple[Plan, int]:
    """What the planner answers for a vehicle whose claims are lifted, and its CPU time in µs.

    exact: the best plan among the reservations answers in the planner's place.
    """
    state, tick = start_of(sim, v)
    view = View(
        sim.graph, sim.world.occupancy, sim.world.margin_ticks, sim.parts.costs, sim.claims, sim.blocked,
        sim.block_version, sim.search, Request(v, state, gap, tick, int(sim.fleet.cls[v]), legs),
    )  # fmt: skip
    begun = sim.clock_ns()
    if exact:
        plan = sim.search.through(view, sim.scenario.planner.objective, Budget())
    else:
        plan, sim.memory = sim.parts.planner.plan(view, sim.memory, Budget())
    return plan, (sim.clock_ns() - begun) // 1000


def accept(
    sim: Simulation, v: int, plan: Plan, end: int, final: Activity, task: Task, order: int, tick: int, cpu_us: int
) -> None:
    """Book a committed plan: where it ends, what follows, its row in the log."""
    f = sim.fleet
    f.final[v] = int(final)
    settle(sim, v, end)
    plan_row(sim, v, plan, task, order, tick, cpu_us)
    if len(plan.edges) == 0 and f.t1[v] == FOREVER:
        f.task[v] = int(task)
        deciding.arrived(sim, v)


def under_way(sim: Simulation, v: int) -> bool:
    """False when a vehicle stands where its plan ends."""
    f = sim.fleet
    return bool(f.step[v] < f.steps[v] or f.t1[v] < FOREVER)


def start_of(sim: Simulation, v: int) -> tuple[int, int]:
    """Motion state and tick from which a new plan for a vehicle starts."""
    f = sim.fleet
    if f.t1[v] < FOREVER:
        state = int(sim.graph.edge_to[f.edge[v]]) if f.edge[v] >= 0 else int(f.state[v]) & ~1
        return state, int(f.t1[v])
    rolling = f.rolled[v] == sim.tick
    return (int(f.state[v]) if rolling else int(f.state[v]) & ~1), sim.tick


def commit(sim: Simulation, v: int, plan: Plan) -> None:
    f, n = sim.fleet, len(plan.edges)
    if n > sim.steps.edge.shape[1]:
        sim.steps = traffic.wider(sim.steps, n)
    while sim.claims.meta[0] < 3 * n + 8:
        sim.claims = traffic.grown(sim.claims, sim.graph.n_places)
    traffic.commit(
        sim.claims, sim.steps, sim.arrays, bool(sim.clock[HOLD]), int(sim.clock[MARGIN]), v,
        int(f.here[v]), plan.edges, plan.what, plan.starts, plan.ends, n,
    )  # fmt: skip
    f.step[v], f.steps[v] = 0, n
    f.stalled[v] = -1


def plan_row(sim: Simulation, v: int, plan: Plan, task: Task, order: int, tick: int, cpu_us: int) -> None:
    n = len(plan.edges)
    claimed = np.empty((3, n + 1), np.int32)
    claimed = claimed[:, : traffic.held(sim.claims, sim.steps, v, int(sim.fleet.here[v]), n, claimed)]
    end = int(plan.ends[-1]) if n else tick
    sim.ledger.row(
        "plans", sim.tick, v, int(task), order, plan.note or str(plan.status), *claimed, tick, end, plan.energy_mj,
        plan.expanded, cpu_us,
    )  # fmt: skip


def retime(sim: Simulation) -> None:
    clock, f = sim.clock, sim.fleet
    if not clock[LATE]:
        return
    clock[LATE] = 0
    if sim.open_loop:
        return
    ready = np.where(f.t1 < FOREVER, f.t1, np.maximum(f.hold, sim.tick)).astype(np.int32)
    ready[f.paused == 1] = np.maximum(ready[f.paused == 1], sim.tick + 1)
    far = traffic.retime(
        sim.claims, sim.steps, sim.arrays, bool(clock[HOLD]), int(clock[MARGIN]), f.step, f.steps, f.here,
        ready,
    )  # fmt: skip
    clock[LATE] = int(far > 0)


def drop_plan(sim: Simulation, v: int) -> None:
    """A vehicle gives up what it has not begun and stands where its present motion ends, until planned anew."""
    f, c = sim.fleet, sim.claims
    traffic.forget(c, sim.steps, v, int(f.step[v]), int(f.steps[v]), True)
    f.steps[v] = f.step[v]
    f.final[v] = int(Activity.WAIT)
    f.stalled[v] = -1
    c.end[f.here[v]] = FOREVER
    sim.clock[LATE] = 1
    sim.try_at[v] = 0
    if v not in sim.needs_plan:
        sim.needs_plan.append(v)


def behind(sim: Simulation, v: int) -> list[int]:
    """Vehicles that have reserved the place of a vehicle for later."""
    c = sim.claims
    out: list[int] = []
    slot = int(c.next[sim.fleet.here[v]])
    while slot >= 0:
        owner = int(c.owner[slot])
        if owner != v and owner not in out:
            out.append(owner)
        slot = int(c.next[slot])
    return out


def settle(sim: Simulation, v: int, place: int) -> None:
    """Book a place as the end of a vehicle's plan."""
    old = int(sim.home[v])
    charger = sim.view.is_charger
    if old == place:
        return
    if old != NONE and sim.holder[old] == v:
        sim.holder[old] = NONE
        if charger[old]:
            charger_row(sim, old, v, 2)
    sim.home[v] = place
    sim.holder[place] = v
    if charger[place]:
        charger_row(sim, place, v, 1 if sim.graph.state_place[sim.fleet.state[v]] == place else 0)


def charger_row(sim: Simulation, place: int, v: int, state: int) -> None:
    charger = int(np.flatnonzero(sim.world.chargers == place)[0])
    sim.ledger.row("chargers", sim.tick, charger, v, state)


def service(sim: Simulation, v: int) -> Activity | None:
    """PICK or DROP while a vehicle is at it."""
    f = sim.fleet
    busy = f.t1[v] < FOREVER and f.edge[v] == NONE
    return Activity(int(f.kind[v])) if busy else None
