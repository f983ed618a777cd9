"""Vehicles with goals: all of them planned at once, by a solver, or in turn with nobody in the way who may still move.

Plans made vehicle by vehicle see the others stand where they are for ever; between vehicles that begin at each other's
goals that leaves no way. Here the claims of everybody who can move are lifted first, and all are put in afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from engine import traffic
from engine.planners import Limits, Problem, Solution, Solver
from engine.planners.base import Leg, Plan, no_plan
from engine.sim import planning
from engine.traffic import Claims, Steps
from engine.types import FOREVER, NONE, Activity, PlanStatus, Task
from engine.units import MJ_PER_J, ticks_from_s

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation

PAUSE_S, LONGEST_S = 5.0, 600.0
"""Seconds until everybody is planned again when somebody is still without a way; twice as long each time in vain."""
STANDS = (0, 4, 4, 16)
"""Attempts to plan everybody in turn at one tick, and how many motions long those still to be planned keep their places
in each, so that they have time to get out of the way. The first follows the numbers of the vehicles and asks the
planner; the others draw an order, and take the exact search among the reservations, the timer's detour.
"""
PER_NODE = 500
"""Expansions that a node of a constraint tree counts as, in a solver's budget."""


def decide(sim: Simulation) -> None:
    """Plan everybody when that is due: at the start, with a new planner, and while somebody is without a way."""
    if not len(sim.goals):
        return
    anew, sim.plan_all = sim.plan_all, False
    stuck = away(sim)
    if not anew and not (stuck and sim.tick >= sim.together_at):
        return
    if sim.open_loop:
        if anew:
            once(sim)
        return
    solver = sim.parts.solver
    if anew and solver is not None and solve(sim, solver):
        return
    found = in_turn(sim, stuck, everybody=anew)
    if not found and not anew and solver is not None:
        found = solve(sim, solver)
    first, longest = (max(1, ticks_from_s(seconds, sim.tick_s)) for seconds in (PAUSE_S, LONGEST_S))
    sim.together_pause = first if found or anew else min(2 * sim.together_pause, longest)
    sim.together_at = sim.tick + sim.together_pause


def once(sim: Simulation) -> None:
    """Ask the planner once for every vehicle away from its goal; who is at its goal, or gets no plan, stays there."""
    for v in away(sim):
        goal = int(sim.goals[v])
        if planning.send(sim, v, (), (goal,), Task.TO_REST, NONE):
            sim.fleet.task[v] = int(Task.TO_REST)
        else:
            where = sim.world.place_name(goal)
            sim.say("no way", f"vehicle {v} gets no way to {where} and is not asked for again", 2, v, NONE, goal)


def movable(sim: Simulation) -> list[int]:
    """Vehicles that can be planned now: in working order, without an order, not sent elsewhere."""
    f = sim.fleet
    able = (f.failed == 0) & (f.order == NONE) & (f.task != Task.SENT)
    return [v for v in np.flatnonzero(able).tolist() if planning.service(sim, v) is None]


def away(sim: Simulation) -> list[int]:
    """Of these, vehicles without a plan to their goal."""
    if not len(sim.goals):
        return []
    return [v for v in movable(sim) if sim.home[v] != sim.goals[v] or v in sim.needs_plan]


# -- at once ----------------------------------------------------------------------------------------------------------


def solve(sim: Simulation, solver: Solver) -> bool:
    """Plan everybody by the solver and commit it; False, with an event that says why, when it has no plan."""
    f, g, name = sim.fleet, sim.graph, sim.scenario.planner.name
    who = movable(sim)
    broken = np.flatnonzero(f.failed != 0).tolist()
    if len(who) + len(broken) < sim.n or (f.t1 < FOREVER).any():
        sim.say("planned together", f"{name} plans everybody at once, but some are busy; they are planned in turn", 1)
        return False
    blocked = sim.blocked.copy()
    blocked[g.state_place[f.state[broken]]] = 1
    starts = np.array([planning.start_of(sim, v)[0] for v in who], np.int32)
    problem = Problem(g, starts, sim.goals[who], sim.parts.costs, f.cls[who].astype(np.int32), blocked)
    work = sim.scenario.planner.work
    begun = sim.clock_ns()
    answer = solver.solve(problem, Limits(max(1, work // PER_NODE), work))
    each_us = (sim.clock_ns() - begun) // 1000 // max(len(who), 1)
    if not answer.states:
        why = f"{answer.status}{', ' if answer.note else ''}{answer.note}"
        sim.say("planned together", f"{name}: {why}; the vehicles are planned in turn", 1)
        return False
    said = str(answer.status)
    if answer.status is PlanStatus.BUDGET_SPENT and answer.cost > 0:
        said = f"budget spent, within {answer.cost / max(answer.lower_bound, 1):.3f} of the best"
    plans = {v: timed(sim, v, states, answer) for v, states in zip(who, answer.states, strict=True)}
    for v in who:
        clear(sim, v)
    for v in who:
        planning.commit(sim, v, plans[v])
    energy_j = sum(plan.energy_mj for plan in plans.values()) / MJ_PER_J
    last = max((int(plan.ends[-1]) for plan in plans.values() if len(plan.ends)), default=sim.tick)
    sim.say(
        "planned together",
        f"{name}: {said}; {len(who)} vehicles at their goals at {last * sim.tick_s:g} s with {energy_j:,.1f} J",
    )
    book(sim, plans, dict.fromkeys(plans, each_us))
    return True


def timed(sim: Simulation, v: int, states: NDArray[np.int32], answer: Solution) -> Plan:
    """A vehicle's motions from its states tick by tick; waits lie between them."""
    g, tick, cls = sim.graph, sim.tick, int(sim.fleet.cls[v])
    edges, starts = [], []
    for t, (a, b) in enumerate(zip(states[:-1].tolist(), states[1:].tolist(), strict=True)):
        if b != g.stopped[a]:
            first, last = int(g.edge_ptr[a]), int(g.edge_ptr[a + 1])
            edges.append(first + int(np.flatnonzero(g.edge_to[first:last] == b)[0]))
            starts.append(tick + t)
    edge, start = np.array(edges, np.int32), np.array(starts, np.int32)
    costs = sim.parts.costs
    energy = int(costs.total_mj[cls, 0, g.edge_kind[edge]].sum())
    if len(start):
        energy += int(start[-1] + 1 - tick) * int(costs.standby_mj[cls])
    status = answer.status if answer.status is not PlanStatus.BUDGET_SPENT else PlanStatus.BOUNDED
    expanded = answer.expanded_low // max(len(answer.states), 1)
    return Plan(status, edge, np.full(len(edge), -1, np.int8), start, start + 1, energy, expanded)


# -- in turn ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Kept:
    """What plans and claims were, to go back to."""

    claims: dict[str, NDArray[Any]]
    steps: dict[str, NDArray[Any]]
    at: NDArray[np.int32]  # (3, V): step, steps, stalled


def in_turn(sim: Simulation, stuck: list[int], *, everybody: bool) -> bool:
    """Plan all movable vehicles one after the other; True when somebody stuck has a plan now.

    Who finds no way is moved to the front of the order, and planning begins again (as in one-shot prioritized
    planning). Who finds none in front of all others stays where it stands, for now. Nothing changes when that is all,
    unless everybody shall be planned.
    """
    planning.retime(sim)
    f, who = sim.fleet, movable(sim)
    kept = Kept(
        {name: a.copy() for name, a in sim.claims._asdict().items()},
        {name: a.copy() for name, a in sim.steps._asdict().items()},
        np.stack([f.step, f.steps, f.stalled]),
    )  # fmt: skip
    for v in who:
        clear(sim, v)
    standing: list[int] = []
    first = [*stuck, *(v for v in who if v not in stuck)]
    for attempt, motions in enumerate(STANDS):
        order = [v for v in first if v not in standing]
        if attempt:
            order = [order[i] for i in sim.parts.planner_rng.permutation(len(order))]
        for _ in range(2 * len(who) + 2):
            plans, us, failed = one_pass(sim, order, motions * int(sim.graph.kind_ticks.max()), exact=attempt > 0)
            if failed is None:
                if not everybody and all(v in standing for v in stuck):
                    break
                for v in standing:
                    stay(sim, v)
                book(sim, plans, us)
                waits = f", {len(standing)} without a way wait" if standing else ""
                sim.say("planned together", f"{len(plans)} vehicles are planned in turn{waits}", int(bool(standing)))
                return any(v in plans for v in stuck)
            if failed == order[0]:
                standing.append(failed)
                sim.claims.end[f.here[failed]] = FOREVER
                traffic.put_back(sim.claims, sim.steps, failed, int(f.here[failed]), 0, 0)
            order = [v for v in (failed, *(v for v in order if v != failed)) if v not in standing]
            if not everybody and all(v in standing for v in stuck):
                break
        if all(v in standing for v in stuck):
            break
    sim.claims, sim.steps = Claims(**kept.claims), Steps(**kept.steps)
    f.step[:], f.steps[:], f.stalled[:] = kept.at
    return False


def one_pass(
    sim: Simulation, order: list[int], stand: int, *, exact: bool
) -> tuple[dict[int, Plan], dict[int, int], int | None]:
    """(plans, CPU µs, None) with everybody committed, or nothing committed and the vehicle without a way.

    stand: ticks for which those still to be planned keep their places.
    """
    plans: dict[int, Plan] = {}
    us: dict[int, int] = {}
    f = sim.fleet
    for v in order if stand else ():
        sim.claims.end[f.here[v]] = sim.tick + stand
        traffic.put_back(sim.claims, sim.steps, v, int(f.here[v]), 0, 0)
    for v in order:
        here, goal = int(f.here[v]), int(sim.goals[v])
        if stand:
            traffic.lift(sim.claims, sim.steps, v, here, 0, 0)
        gap = int(traffic.gap_at(sim.claims, int(sim.claims.place[here]), sim.tick))
        plan = no_plan(PlanStatus.NO_PATH)
        if gap >= 0:
            plan, us[v] = planning.ask(sim, v, gap, (Leg(goal, 0, final(sim, goal), False),), exact=exact)
        if not plan.found:
            for w in plans:
                traffic.lift(sim.claims, sim.steps, w, int(f.here[w]), 0, int(f.steps[w]))
                traffic.forget(sim.claims, sim.steps, w, 0, int(f.steps[w]), False)
                f.steps[w] = 0
            for w in order if stand else ():
                if w not in plans and w != v:
                    traffic.lift(sim.claims, sim.steps, w, int(f.here[w]), 0, 0)
            return {}, us, v
        planning.commit(sim, v, plan)
        plans[v] = plan
    return plans, us, None


def clear(sim: Simulation, v: int) -> None:
    """Take a vehicle's claims out of the table and its steps out of its plan; `commit` or `put_back` follows."""
    f = sim.fleet
    traffic.lift(sim.claims, sim.steps, v, int(f.here[v]), int(f.step[v]), int(f.steps[v]))
    traffic.forget(sim.claims, sim.steps, v, int(f.step[v]), int(f.steps[v]), False)
    f.step[v] = f.steps[v] = 0


def stay(sim: Simulation, v: int) -> None:
    """A vehicle without a way stands where it is, until it is planned again."""
    sim.fleet.final[v] = int(Activity.WAIT)
    sim.fleet.stalled[v] = -1
    if v not in sim.needs_plan:
        sim.needs_plan.append(v)


def book(sim: Simulation, plans: dict[int, Plan], us: dict[int, int]) -> None:
    """Book plans that are all committed."""
    sim.needs_plan = [v for v in sim.needs_plan if v not in plans]
    for v, plan in plans.items():
        goal = int(sim.goals[v])
        tick = planning.start_of(sim, v)[1]
        planning.accept(sim, v, plan, goal, final(sim, goal), Task.TO_REST, NONE, tick, us[v])
        if planning.under_way(sim, v):
            sim.fleet.task[v] = int(Task.TO_REST)


def final(sim: Simulation, goal: int) -> Activity:
    """What a vehicle does at its goal."""
    return Activity.CHARGE if sim.view.is_charger[goal] else Activity.REST


def reached(sim: Simulation) -> bool:
    """True when every vehicle rests at its goal."""
    f = sim.fleet
    return bool(((f.step >= f.steps) & (f.t1 == FOREVER) & (sim.graph.state_place[f.state] == sim.goals)).all())
