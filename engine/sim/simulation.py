"""A run: the compiled step, and between two calls of it the deciders, the commands and the log.

The step of a tick, as a table of contents: what ends ends → orders arrive → faults and repairs → vehicles without a
plan are planned → charging → dispatch → what is due starts → energy. `advance` stops after the deciders of its last
tick, so that commands given while paused act at the next step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine import traffic
from engine.dispatch.base import ChargingPolicy, Dispatcher, FloorView
from engine.energy import Battery, CostTable
from engine.errors import InvariantBroken
from engine.orders.book import OrderBook
from engine.orders.sources import OrderSource
from engine.planners.base import Budget, Leg, Memory, Plan, Planner, Request, Search, View
from engine.scenario.model import Scenario
from engine.sim import checkpoint, kernels
from engine.sim.commands import Answer, submit
from engine.sim.faults import Faults
from engine.sim.ledger import Ledger, Recorder
from engine.sim.state import (
    ARRIVED,
    CHARGED,
    DELAY_HI,
    DELAY_LO,
    DELAY_PPM,
    EMPTY,
    HALF,
    HOLD,
    LATE,
    LINGERING,
    MARGIN,
    ORDER_DONE,
    PATIENCE,
    PICKED,
    SAMPLE,
    SEED,
    STALLED,
    TICK,
    Levels,
    new_fleet,
    new_sink,
)
from engine.types import FOREVER, NONE, PRIMITIVE_0, Activity, Occupancy, OrderState, Task
from engine.units import ticks_from_s
from engine.world.floor import World

RETRY_S = 5.0
PATIENCE_S = 30.0
LEVEL_NAMES = ("critical", "good", "sufficient", "full", "reserve")


@dataclass(frozen=True, slots=True)
class Parts:
    """What a simulation is made of; engine.build puts it together."""

    scenario: Scenario
    world: World
    seed: int
    costs: CostTable
    battery: Battery
    power_mj: tuple[int, int]  # charger, per tick: drawn from the mains, stored in the battery
    search: Search
    planner: Planner
    planner_rng: np.random.Generator
    dispatcher: Dispatcher
    charging: ChargingPolicy
    source: OrderSource
    faults: Faults
    start: tuple[int, ...]
    initial_soc: NDArray[np.float64]


class Poses(NamedTuple):
    """Where everybody is at a time: (V,) arrays, metres and degrees; soc of the last battery sample, 0 to 1."""

    x_m: NDArray[np.float32]
    y_m: NDArray[np.float32]
    heading_deg: NDArray[np.float32]
    soc: NDArray[np.float32]
    state: NDArray[np.uint8]
    loaded: NDArray[np.uint8]
    low: NDArray[np.uint8]
    order: NDArray[np.int32]
    place: NDArray[np.int32]


class Simulation:
    """One run. `clock_ns` measures planning time for the log; it is given from outside and touches nothing else."""

    def __init__(self, parts: Parts, recorder: Recorder | None = None, clock_ns: Callable[[], int] = lambda: 0):
        self.parts, self.scenario, self.world = parts, parts.scenario, parts.world
        self.graph = parts.world.graph
        self.tick_s = parts.scenario.time.tick_s
        self.n = parts.scenario.fleet.count
        self._clock_ns = clock_ns
        n, places = self.n, self.graph.n_places
        self._arrays = traffic.graph_arrays(self.graph)
        self.fleet = new_fleet(n)
        self.steps = traffic.new_steps(n, 256)
        self.claims = traffic.new_claims(places, 64 * n + 1024)
        self.sink = new_sink(n)
        self.ledger = Ledger(recorder)
        self.blocked = np.zeros(places, np.uint8)
        self.block_version = 0
        self.book = OrderBook()
        self.source, self.faults = parts.source, parts.faults
        self.search = parts.search
        self.memory: Memory = parts.planner.init(self.graph, parts.costs, parts.planner_rng)
        self.levels = self._levels(n)
        self._clock = np.zeros(LINGERING + 1, np.int64)
        self._linger = np.full(16 * n + 64, NONE, np.int32)
        self._go, self._wait_for = np.zeros(n, np.int8), np.zeros(n, np.int32)
        self.home = np.full(n, NONE, np.int32)
        self.holder = np.full(places, NONE, np.int32)
        self.must_charge = np.zeros(n, np.uint8)
        self.charge_later = np.zeros(n, np.uint8)
        self.charger_out = np.zeros(len(self.world.chargers), np.uint8)
        self.thresholds = {k: float(getattr(self.scenario.charging, k)) for k in LEVEL_NAMES}
        self.needs_plan: list[int] = []
        self.queue: list[int] = []
        self.reasons: dict[int, str] = {}
        self.commands = 0
        self.done = False
        self.deadlocks = 0
        self._retry = FOREVER
        self._view = self._floor_view()
        self._begin()

    # ---- set-up -------------------------------------------------------------------------------------------------

    def _levels(self, n: int) -> Levels:
        capacity = self.parts.battery.capacity_mc

        def all_of(share: float) -> NDArray[np.int64]:
            return np.full(n, round(capacity * share), np.int64)

        charging = self.scenario.charging
        power = np.array(self.parts.power_mj, np.int64)
        return Levels(
            all_of(charging.full), all_of(max(charging.full - 0.03, charging.sufficient * 0.97)),
            all_of(charging.sufficient), all_of(1.0), power, self.parts.battery.voltage_mv,
        )  # fmt: skip

    def _floor_view(self) -> FloorView:
        world, fleet = self.world, self.scenario.fleet
        rests = np.concatenate([world.chargers, world.parking]).astype(np.int32)
        is_charger = np.zeros(self.graph.n_places, np.uint8)
        is_charger[world.chargers] = 1
        is_rest = np.zeros(self.graph.n_places, np.uint8)
        is_rest[rests] = 1
        full = self.parts.battery.capacity_mc * int(self.parts.battery.voltage_mv[-1]) // 1000
        return FloorView(
            tick=0, tick_s=self.tick_s, search=self.search, orders=self.book, at=np.zeros(self.n, np.int32),
            charge_mj=np.zeros(self.n, np.int64), capacity_mj=np.full(self.n, full, np.int64), home=self.home,
            holder=self.holder, is_charger=is_charger, is_rest=is_rest, rests=rests, xy=self.graph.xy_m,
            heaviest=1.0 + fleet.payload_kg / fleet.mass_kg, standby_mj=int(self.parts.costs.standby_mj[0]),
            service_ticks=self._service_ticks(), levels=self.thresholds, must_charge=self.must_charge,
            blocked=self.blocked,
        )  # fmt: skip

    def _service_ticks(self) -> tuple[int, int]:
        service = self.scenario.service
        return max(1, ticks_from_s(service.pick_s, self.tick_s)), max(1, ticks_from_s(service.drop_s, self.tick_s))

    def _begin(self) -> None:
        s, clock, f = self.scenario, self._clock, self.fleet
        clock[SAMPLE] = max(1, ticks_from_s(s.log.sample_s, self.tick_s))
        clock[PATIENCE] = max(2, ticks_from_s(PATIENCE_S, self.tick_s))
        clock[MARGIN] = self.world.margin_ticks
        clock[HOLD] = int(self.world.occupancy is Occupancy.HOLD)
        clock[SEED] = self.parts.seed % 2**62
        clock[DELAY_PPM] = round(s.faults.delay_probability * 1e6)
        clock[DELAY_LO], clock[DELAY_HI] = s.faults.delay_ticks
        clock[HALF] = 1
        f.charge[:] = np.rint(self.parts.initial_soc * self.parts.battery.capacity_mc).astype(np.int64)
        for v, place in enumerate(self.parts.start):
            f.here[v] = traffic.claim(self.claims, place, 0, FOREVER, v)
            f.state[v] = self._facing_out(place)
            self._settle(v, place)
            f.final[v] = int(Activity.CHARGE if self._view.is_charger[place] else Activity.REST)
            # the first interval begins as whatever the first step makes of it
            f.kind[v] = int(Activity.WAIT)
        kernels.sample(f, self.sink, self.levels, 0)
        self.say("run started", f"{self.scenario.title}, {self.n} vehicles")

    def _facing_out(self, place: int) -> int:
        """The standing state from which a vehicle drives straight out of a place."""
        g = self.graph
        for s in range(int(g.place_ptr[place]), int(g.place_ptr[place + 1]), 2):
            kinds = [g.primitives[g.edge_kind[e]] for e in range(int(g.edge_ptr[s]), int(g.edge_ptr[s + 1]))]
            if any(k.turn_deg == 0 and k.length_mm for k in kinds):
                return s
        return int(g.place_ptr[place])

    # ---- what others read ---------------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        return int(self._clock[TICK])

    @property
    def log(self) -> Recorder | None:
        return self.ledger.recorder

    def digest(self) -> str:
        """Hex digest of everything that happened so far; the same however often the log was flushed."""
        self.ledger.drain(self.sink)
        return self.ledger.digest()

    def metrics(self) -> dict[str, Any]:
        """A few counters of the moment."""
        f = self.fleet
        oldest = min((self.book.created[o] for o in self.book.open), default=self.tick)
        return {
            "orders_created": len(self.book),
            "orders_done": self.book.n_done,
            "orders_open": len(self.book.open),
            "oldest_open_s": (self.tick - oldest) * self.tick_s,
            "stranded": int((f.charge <= 0).sum()),
            "charging": int((f.kind == Activity.CHARGE).sum()),
            "queued": len(self.queue),
            "without_plan": len(self.needs_plan),
            "deadlocks": self.deadlocks,
        }

    def snapshot(self, ahead: float = 0.0) -> Poses:
        """Poses at a fraction of a tick (0 ≤ ahead < 1) after the present one."""
        f, g = self.fleet, self.graph
        time = self.tick + ahead
        moving = f.edge >= 0
        here = g.state_place[f.state]
        to_state = np.where(moving, g.edge_to[np.maximum(f.edge, 0)], f.state)
        to = g.state_place[to_state]
        span = np.where(moving, np.maximum(f.t1.astype(np.int64) - f.t0, 1), 1)
        part = np.where(moving, np.clip((time - f.t0) / span, 0, 1), 0.0)
        xy = g.xy_m[here] + (g.xy_m[to] - g.xy_m[here]) * part[:, None].astype(np.float32)
        degrees = np.array(g.heading_deg, np.float32)
        a, b = degrees[g.state_heading[f.state]], degrees[g.state_heading[to_state]]
        turn = (b - a + 180) % 360 - 180
        capacity = self.parts.battery.capacity_mc
        soc = (f.sampled / capacity).astype(np.float32)
        return Poses(
            xy[:, 0], xy[:, 1], ((a + turn * part) % 360).astype(np.float32), soc,
            np.maximum(f.shown[:, 0], 0).astype(np.uint8), f.loaded.astype(np.uint8),
            (soc < self.thresholds["good"]).astype(np.uint8), f.order.copy(), here.astype(np.int32),
        )  # fmt: skip

    # ---- time ---------------------------------------------------------------------------------------------------

    def advance(self, ticks: int) -> int:
        """Simulate so many ticks, fewer when the run is done; returns how many."""
        first = self.tick
        target = first + ticks
        c = self._clock
        while not self.done:
            wake = min(target, self.source.next_tick, self.faults.next_tick, self._retry)
            status = kernels.run(
                self.fleet, self.steps, self._arrays, self.claims, self.sink, self.parts.costs.mj,
                self.parts.costs.total_mj, self.parts.costs.standby_mj, self.levels, c, self.blocked, self._linger,
                self._go, self._wait_for, max(wake, self.tick),
            )  # fmt: skip
            self._view.tick = self.tick
            if status == 2:
                self.ledger.drain(self.sink)
                continue
            arrived = self._take_orders() if self.source.next_tick <= self.tick else False
            broken = self.faults.next_tick <= self.tick
            if status == 1 or arrived or broken or self._retry <= self.tick:
                self._decide(broken)
            if status == 0 and self.tick >= target:
                break
        return self.tick - first

    def flush(self) -> None:
        """Hand all rows to the recorder, and a keyframe row per vehicle for what is still open."""
        self.ledger.drain(self.sink)
        self.ledger.flush()
        if self.ledger.recorder is not None:
            self.ledger.send("keyframes", self._open_rows())

    def _open_rows(self) -> NDArray[np.int64]:
        """What is still open, a row per vehicle in the columns of `keyframes`."""
        f, g = self.fleet, self.graph
        driving = f.edge >= 0
        to = np.where(driving, g.edge_to[np.maximum(f.edge, 0)], f.state)
        kinds = np.where(driving, f.kind - PRIMITIVE_0, 0)
        mj = np.where(driving, self.parts.costs.total_mj[f.cls, f.loaded, kinds], 0)
        columns = (
            np.full(self.n, self.tick), np.arange(self.n), f.kind, f.cause, f.blocker, f.t0, f.t1,
            g.state_place[f.state], g.state_place[to], g.state_heading[f.state], g.state_heading[to], f.loaded, f.order,
            f.task, mj, np.maximum(f.shown[:, 0], 0), f.charge, f.distance, f.done,
        )  # fmt: skip
        return np.stack([c.astype(np.int64) for c in columns], axis=1)

    # ---- deciding -----------------------------------------------------------------------------------------------

    def _decide(self, broken: bool) -> None:
        self._retry = FOREVER
        self._read_marks()
        if broken:
            self._break_and_repair()
        self._replan()
        self._refresh_view()
        self._charging()
        self._dispatch()
        if self._unplanned_work():
            self._retry = self.tick + max(1, ticks_from_s(RETRY_S, self.tick_s))
        self._check_done()

    def _unplanned_work(self) -> bool:
        return bool(self.needs_plan or self.queue or (self.book.open and self._free()))

    def _take_orders(self) -> bool:
        taken = False
        while self.source.next_tick <= self.tick:
            _, a, b = self.source.take()
            self.add_order(a, b, source=0)
            taken = True
        return taken

    def add_order(self, a: int, b: int, source: int) -> int:
        """A new order between two station numbers; returns its number."""
        places = (self.world.station(a).place, self.world.station(b).place)
        order = self.book.add(self.tick, (a, b), places, source)
        self.order_row(order)
        return order

    def order_row(self, order: int, tick: int | None = None) -> None:
        b = self.book
        self.ledger.row(
            "orders", self.tick if tick is None else tick, order, b.state[order], b.vehicle[order],
            b.from_place[order], b.to_place[order], b.from_station[order], b.to_station[order], b.source[order],
        )  # fmt: skip

    def say(
        self, kind: str, text: str, level: int = 0, vehicle: int = NONE, order: int = NONE, place: int = NONE
    ) -> None:
        self.ledger.row("events", self.tick, kind, level, vehicle, order, place, text)

    def _read_marks(self) -> None:
        sink = self.sink
        n = int(sink.filled[3])
        marks = sink.marks[:n].tolist()
        sink.filled[3] = 0
        for tick, v, bit, order in marks:
            if bit == PICKED:
                self.book.state[order] = int(OrderState.PICKED)
                self.order_row(order, tick)
            elif bit == ORDER_DONE:
                self._order_done(tick, v, order)
            elif bit == ARRIVED:
                if v not in self.needs_plan:
                    self._arrived(v)
            elif bit == CHARGED:
                self.must_charge[v] = 0
            elif bit == EMPTY:
                self.say("stranded", f"vehicle {v} has run empty", 2, v, int(self.fleet.order[v]))
                self.fail(v)
            elif bit == STALLED:
                self._unlock(v)

    def _order_done(self, tick: int, v: int, order: int) -> None:
        f, book = self.fleet, self.book
        book.state[order] = int(OrderState.DONE)
        book.done_at[order] = tick
        book.n_done += 1
        self.order_row(order, tick)
        f.order[v] = NONE
        self._check_low(v)
        at_charger = self.home[v] != NONE and self._view.is_charger[self.home[v]]
        f.task[v] = int(Task.TO_CHARGER if self.must_charge[v] and at_charger else Task.TO_REST)

    def _check_low(self, v: int) -> None:
        soc = self.fleet.charge[v] / self.parts.battery.capacity_mc
        if self.charge_later[v] or soc < self.thresholds["good"]:
            self.charge_later[v] = 0
            self.must_charge[v] = 1

    def _arrived(self, v: int) -> None:
        f = self.fleet
        if f.task[v] == Task.SENT:
            self.say(
                "arrived", f"vehicle {v} is where it was sent", 0, v, NONE, int(self.graph.state_place[f.state[v]])
            )
        f.task[v] = int(Task.NONE)
        self._check_low(v)
        if self._view.is_charger[self.home[v]]:
            self._charger_row(int(self.home[v]), v, 1)

    def _charger_row(self, place: int, v: int, state: int) -> None:
        charger = int(np.flatnonzero(self.world.chargers == place)[0])
        self.ledger.row("chargers", self.tick, charger, v, state)

    def _settle(self, v: int, place: int) -> None:
        """Book a place as the end of a vehicle's plan."""
        old = int(self.home[v])
        charger = self._view.is_charger
        if old == place:
            return
        if old != NONE and self.holder[old] == v:
            self.holder[old] = NONE
            if charger[old]:
                self._charger_row(old, v, 2)
        self.home[v] = place
        self.holder[place] = v
        if charger[place]:
            self._charger_row(place, v, 1 if self.graph.state_place[self.fleet.state[v]] == place else 0)

    def _refresh_view(self) -> None:
        f, g = self.fleet, self.graph
        self._view.tick = self.tick
        driving = f.edge >= 0
        np.copyto(self._view.at, np.where(driving, g.edge_to[np.maximum(f.edge, 0)], f.state))
        volts = int(self.parts.battery.voltage_mv[-1])
        np.copyto(self._view.charge_mj, f.charge * volts // 1000)

    def _idle(self) -> list[int]:
        """Vehicles without an order that could be sent somewhere."""
        f = self.fleet
        able = (f.order == NONE) & (f.failed == 0) & (f.paused == 0) & (f.task != Task.SENT)
        return [v for v in np.flatnonzero(able).tolist() if v not in self.needs_plan]

    def _free(self) -> list[int]:
        """Vehicles that may take an order now."""
        return [v for v in self._idle() if not self.must_charge[v]]

    def _charging(self) -> None:
        idle = self._idle()
        if not idle:
            self.queue = []
            return
        f = self.fleet
        if not self.must_charge.any() and all(self._home_is_good(v) for v in idle):
            self.queue = []
            return
        moves, queue = self.parts.charging.moves(self._view, idle)
        for move in moves:
            task = Task.TO_CHARGER if move.to_charge else Task.TO_REST
            if self._send(move.vehicle, (), move.rests, task, NONE):
                f.task[move.vehicle] = int(task)
        for v in queue:
            if v not in self.queue:
                self.say("charger queue", f"vehicle {v} waits for a free charger", 1, v)
        self.queue = queue

    def _home_is_good(self, v: int) -> bool:
        home = int(self.home[v])
        return home != NONE and bool(self._view.is_rest[home]) and not self.blocked[home]

    def _dispatch(self) -> None:
        if not self.book.open:
            return
        free = self._free()
        if not free:
            return
        assignments, refusals = self.parts.dispatcher.assign(self._view, free)
        pick, drop = self._service_ticks()
        for a in assignments:
            legs = (
                Leg(self.book.from_place[a.order], pick, Activity.PICK, False),
                Leg(self.book.to_place[a.order], drop, Activity.DROP, True),
            )
            if self._send(a.vehicle, legs, a.rests, Task.TO_PICK, a.order):
                self.book.assign(a.order, a.vehicle)
                self.reasons.pop(a.order, None)
                self.fleet.order[a.vehicle] = a.order
                self.fleet.task[a.vehicle] = int(Task.TO_PICK)
                self.order_row(a.order)
            else:
                self._refuse(a.order, f"vehicle {a.vehicle} found no way free of conflicts")
        for r in refusals:
            self._refuse(r.order, r.reason)

    def _refuse(self, order: int, reason: str) -> None:
        if self.reasons.get(order) != reason:
            self.reasons[order] = reason
            if reason != "no vehicle is free":
                self.say("order waits", f"order {order}: {reason}", 0, NONE, order)

    def _check_done(self) -> None:
        finish = self.scenario.time.finish
        if finish == "never" or self.source.next_tick < FOREVER or self.book.unfinished:
            return
        f = self.fleet
        if finish == "orders done and home":
            home = (f.step >= f.steps) & (f.t1 == FOREVER) & (self.graph.state_place[f.state] == self.home)
            if not (home | (f.failed != 0)).all() or self.needs_plan:
                return
        self.done = True
        self.say("run done", "all orders are done" + (" and every vehicle is home" if "home" in finish else ""))

    # ---- planning -----------------------------------------------------------------------------------------------

    def _send(self, v: int, legs: tuple[Leg, ...], rests: tuple[int, ...], task: Task, order: int) -> bool:
        """Plan a vehicle through legs to the first rest place that works, and commit it; False leaves all as it was."""
        for rest in rests:
            final = Activity.CHARGE if self._view.is_charger[rest] else Activity.REST
            if self._plan(v, (*legs, Leg(rest, 0, final, False)), final, task, order):
                return True
        return False

    def _plan(self, v: int, legs: tuple[Leg, ...], final: Activity, task: Task, order: int) -> bool:
        f, p, c = self.fleet, self.steps, self.claims
        self._retime()
        state, tick = self._from(v)
        here, step, steps = int(f.here[v]), int(f.step[v]), int(f.steps[v])
        gap = traffic.lift(c, p, v, here, step, steps)
        view = View(
            self.graph, self.world.occupancy, self.world.margin_ticks, self.parts.costs, c, self.blocked,
            self.block_version, self.search, Request(v, state, int(gap), tick, int(f.cls[v]), legs),
        )  # fmt: skip
        begun = self._clock_ns()
        plan, self.memory = self.parts.planner.plan(view, self.memory, Budget())
        cpu_us = (self._clock_ns() - begun) // 1000
        if not plan.found:
            traffic.put_back(c, p, v, here, step, steps)
            self.ledger.row(
                "plans", self.tick, v, int(task), order, str(plan.status), [], [], [], tick, tick, 0, plan.expanded,
                cpu_us,
            )  # fmt: skip
            return False
        traffic.forget(c, p, v, step, steps, False)
        self._commit(v, plan)
        f.final[v] = int(final)
        self._settle(v, legs[-1].place)
        self._plan_row(v, plan, task, order, tick, cpu_us)
        if len(plan.edges) == 0 and f.t1[v] == FOREVER:
            f.task[v] = int(task)
            self._arrived(v)
        return True

    def _from(self, v: int) -> tuple[int, int]:
        """Motion state and tick from which a new plan for a vehicle starts."""
        f = self.fleet
        if f.t1[v] < FOREVER:
            state = int(self.graph.edge_to[f.edge[v]]) if f.edge[v] >= 0 else int(f.state[v]) & ~1
            return state, int(f.t1[v])
        rolling = f.rolled[v] == self.tick
        return (int(f.state[v]) if rolling else int(f.state[v]) & ~1), self.tick

    def _commit(self, v: int, plan: Plan) -> None:
        f, n = self.fleet, len(plan.edges)
        if n > self.steps.edge.shape[1]:
            self.steps = traffic.wider(self.steps, n)
        while self.claims.meta[0] < 3 * n + 8:
            self.claims = traffic.grown(self.claims, self.graph.n_places)
        traffic.commit(
            self.claims, self.steps, self._arrays, bool(self._clock[HOLD]), int(self._clock[MARGIN]), v,
            int(f.here[v]), plan.edges, plan.what, plan.starts, plan.ends, n,
        )  # fmt: skip
        f.step[v], f.steps[v] = 0, n
        f.stalled[v] = -1

    def _plan_row(self, v: int, plan: Plan, task: Task, order: int, tick: int, cpu_us: int) -> None:
        c, p, f = self.claims, self.steps, self.fleet
        slots = [int(f.here[v]), *(int(s) for s in p.claim[v, : len(plan.edges)] if s >= 0)]
        end = int(plan.ends[-1]) if len(plan.ends) else tick
        self.ledger.row(
            "plans", self.tick, v, int(task), order, plan.note or str(plan.status), c.place[slots].tolist(),
            c.start[slots].tolist(),
            c.end[slots].tolist(), tick, end, plan.energy_mj, plan.expanded, cpu_us,
        )  # fmt: skip

    def _retime(self) -> None:
        clock, f = self._clock, self.fleet
        if not clock[LATE]:
            return
        clock[LATE] = 0
        ready = np.where(f.t1 < FOREVER, f.t1, np.maximum(f.hold, self.tick)).astype(np.int32)
        ready[f.paused == 1] = np.maximum(ready[f.paused == 1], self.tick + 1)
        traffic.retime(
            self.claims, self.steps, self._arrays, bool(clock[HOLD]), int(clock[MARGIN]), f.step, f.steps, f.here,
            ready,
        )  # fmt: skip

    # ---- when plans fail ----------------------------------------------------------------------------------------

    def _drop_plan(self, v: int) -> None:
        """A vehicle gives up what it has not begun and stands where its present motion ends, until planned anew."""
        f, c = self.fleet, self.claims
        traffic.forget(c, self.steps, v, int(f.step[v]), int(f.steps[v]), True)
        f.steps[v] = f.step[v]
        f.final[v] = int(Activity.WAIT)
        f.stalled[v] = -1
        c.end[f.here[v]] = FOREVER
        if v not in self.needs_plan:
            self.needs_plan.append(v)

    def _behind(self, v: int) -> list[int]:
        """Vehicles that have reserved the place of a vehicle for later."""
        c = self.claims
        out: list[int] = []
        slot = int(c.next[self.fleet.here[v]])
        while slot >= 0:
            owner = int(c.owner[slot])
            if owner != v and owner not in out:
                out.append(owner)
            slot = int(c.next[slot])
        return out

    def _replan(self) -> None:
        """Plan the vehicles that lost their plans; those whose way they block lose theirs in turn."""
        for _ in range(2):
            waiting, self.needs_plan = self.needs_plan, []
            stuck: list[int] = []
            for v in waiting:
                if self.fleet.failed[v] or not self._plan_again(v):
                    stuck.append(v)
            fresh: list[int] = []
            for v in stuck:
                for w in self._behind(v):
                    if w not in stuck:
                        self._drop_plan(w)
                        fresh.append(w)
            self.needs_plan = [*stuck, *[w for w in self.needs_plan if w not in stuck]]
            if not fresh:
                break
        self.needs_plan = [v for v in self.needs_plan if not self.fleet.failed[v]]

    def _plan_again(self, v: int) -> bool:
        """A new plan for what a vehicle was doing; if that is impossible now, at least to a rest place."""
        self._refresh_view()
        f, book = self.fleet, self.book
        order = int(f.order[v])
        pick, drop = self._service_ticks()
        legs: tuple[Leg, ...] = ()
        task = Task.TO_REST
        if order != NONE:
            target = Leg(book.to_place[order], drop, Activity.DROP, True)
            legs, task = (target,), Task.TO_DROP
            if book.state[order] == OrderState.ASSIGNED:
                legs, task = (Leg(book.from_place[order], pick, Activity.PICK, False), target), Task.TO_PICK
        end = legs[-1].place if legs else int(self.graph.state_place[self._view.at[v]])
        rests = self.parts.charging.rests_after(self._view, v, end, int(self._view.charge_mj[v]))
        more = self._view.nearest_rest(v, end, chargers_only=False, count=6)
        every = tuple(dict.fromkeys([*rests, *more]))
        if self._send(v, legs, every, task, order):
            f.task[v] = int(task)
            return True
        if order != NONE and book.state[order] == OrderState.ASSIGNED:
            self._give_back(v, order)
            return self._plan_again(v)
        # loaded: stand aside where it blocks nobody, and try again later
        if legs and self._send(v, (), every, Task.TO_DROP, order):
            f.task[v] = int(Task.TO_DROP)
            self.needs_plan.append(v)
            return True
        return False

    def _give_back(self, v: int, order: int) -> None:
        self.book.reopen(order)
        self.fleet.order[v] = NONE
        self.fleet.task[v] = int(Task.TO_REST)
        self.order_row(order)
        self.say("order given back", f"vehicle {v} gives order {order} back", 1, v, order)

    def fail(self, v: int, until: int = FOREVER) -> None:
        """A vehicle breaks down once its present motion has ended."""
        f = self.fleet
        f.failed[v] = 1
        self._drop_plan(v)
        order = int(f.order[v])
        if order != NONE and self.book.state[order] == OrderState.ASSIGNED:
            self._give_back(v, order)
        self.faults.repair_at(v, until)

    def _break_and_repair(self) -> None:
        for v, repaired in self.faults.due(self.tick):
            if repaired:
                self.repair(v)
            elif not self.fleet.failed[v]:
                self.say("breakdown", f"vehicle {v} has broken down", 2, v, int(self.fleet.order[v]))
                self.fail(v, self.tick + self.faults.repair_ticks)

    def repair(self, v: int) -> None:
        if not self.fleet.failed[v]:
            return
        self.fleet.failed[v] = 0
        self.say("repaired", f"vehicle {v} works again", 0, v)
        if v not in self.needs_plan:
            self.needs_plan.append(v)

    def _unlock(self, v: int) -> None:
        """Deadlock watch: a vehicle has waited long. Follow who waits for whom; replan when that leads nowhere."""
        f = self.fleet
        if f.stalled[v] < 0:
            return
        chain = [v]
        while f.blocker[chain[-1]] >= 0 and int(f.blocker[chain[-1]]) not in chain:
            chain.append(int(f.blocker[chain[-1]]))
        last = int(f.blocker[chain[-1]])
        names = " → ".join(str(x) for x in chain)
        if last >= 0:
            self.deadlocks += 1
            self.say("deadlock", f"vehicles wait for each other: {names} → {last}; they are planned anew", 2, v)
            for w in chain[chain.index(last) :]:
                self._drop_plan(w)
        elif f.steps[chain[-1]] <= f.step[chain[-1]] or f.paused[chain[-1]] or f.failed[chain[-1]] or len(chain) == 1:
            self.say("stalled", f"vehicle {v} has waited long behind {names}; it is planned anew", 1, v)
            self._drop_plan(v)

    # ---- what commands do ---------------------------------------------------------------------------------------

    def submit(self, command: Mapping[str, Any]) -> Answer:
        """Check, log and carry out an operator's command at the present tick."""
        return submit(self, command)

    def settle(self) -> None:
        """Let the deciders act on what a command changed."""
        self._decide(False)

    def in_service(self, v: int) -> bool:
        """True while a vehicle picks or drops."""
        return int(self.fleet.kind[v]) in (Activity.PICK, Activity.DROP) and self.fleet.t1[v] < FOREVER

    def is_rest(self, place: int) -> bool:
        """True for a working charger or parking bay."""
        return bool(self._view.is_rest[place])

    def release_order(self, v: int) -> None:
        """A vehicle forgets its order and will be planned anew."""
        self.fleet.order[v] = NONE
        self.fleet.task[v] = int(Task.TO_REST)
        self._drop_plan(v)

    def send_to(self, v: int, place: int) -> bool:
        """Plan a vehicle to a place where it stays; False when there is no way."""
        self._refresh_view()
        if not self._send(v, (), (place,), Task.SENT, NONE):
            return False
        self.fleet.task[v] = int(Task.SENT)
        if v in self.needs_plan:
            self.needs_plan.remove(v)
        return True

    def set_block(self, place: int, blocked: bool) -> None:
        """Block a place or free it; vehicles that would enter it are planned anew."""
        self.blocked[place] = int(blocked)
        self.block_version += 1
        self.ledger.row("blocks", self.tick, place, int(blocked))
        x, y = (int(c) for c in self.world.cell_of_place[place])
        self.say("blocked" if blocked else "unblocked", f"cell ({x}, {y})", int(blocked), NONE, NONE, place)
        if not blocked:
            return
        slot = int(self.claims.next[place])
        owners: list[int] = []
        while slot >= 0:
            owner = int(self.claims.owner[slot])
            if slot not in (int(self.fleet.here[owner]), int(self.fleet.back[owner])):
                owners.append(owner)
            slot = int(self.claims.next[slot])
        for v in dict.fromkeys(owners):
            self._drop_plan(v)

    def set_charger(self, charger: int, *, works: bool) -> None:
        """Take a charger out of order or back; vehicles on it or on their way look for another."""
        place = int(self.world.chargers[charger])
        self.charger_out[charger] = int(not works)
        self._view.is_charger[place] = int(works)
        self._view.is_rest[place] = int(works)
        v = int(self.holder[place])
        self.ledger.row("chargers", self.tick, charger, v, 4 if works else 3)
        self.say("charger back" if works else "charger out", f"charger C{charger + 1}", int(not works), v, NONE, place)
        if v == NONE:
            return
        f = self.fleet
        if works:
            if f.step[v] >= f.steps[v]:
                f.final[v] = int(Activity.CHARGE)
        elif f.step[v] >= f.steps[v] and f.t1[v] == FOREVER:
            f.final[v] = int(Activity.REST)
        else:
            self._drop_plan(v)

    def set_thresholds(self, new: dict[str, float]) -> None:
        """New charge levels, shares of the capacity."""
        self.thresholds.update(new)
        capacity = self.parts.battery.capacity_mc
        self.levels.full[:] = round(capacity * new["full"])
        self.levels.sufficient[:] = round(capacity * new["sufficient"])
        self.levels.top_up[:] = round(capacity * max(new["full"] - 0.03, new["sufficient"] * 0.97))
        self.must_charge[self.fleet.charge >= self.levels.sufficient] = 0

    # ---- saving -------------------------------------------------------------------------------------------------

    def checkpoint(self, folder: Path) -> None:
        """Flush the log and write a checkpoint folder. Raises RunError."""
        self.flush()
        checkpoint.save(self, folder)

    def rest_places(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """(P,) working chargers, and places where vehicles may stand for good."""
        return self._view.is_charger, self._view.is_rest

    def set_book(self, book: OrderBook) -> None:
        """Take over the orders of a checkpoint."""
        self.book = book
        self._view.orders = book

    def become(self, parts: Parts, *, keep_orders: bool, keep_faults: bool) -> None:
        """Go on with another planner, policies or order source; motions already committed finish first."""
        old = self.parts
        if parts.planner != old.planner:
            self.memory = parts.planner.init(self.graph, parts.costs, parts.planner_rng)
        self.parts = replace(
            parts, world=old.world, search=old.search, costs=old.costs, battery=old.battery, power_mj=old.power_mj
        )
        self.scenario = parts.scenario
        if not keep_orders:
            self.source = parts.source
        if not keep_faults:
            self.faults = parts.faults
            self.faults.start_at(self.tick)
        faults = parts.scenario.faults
        self._clock[DELAY_PPM] = round(faults.delay_probability * 1e6)
        self._clock[DELAY_LO], self._clock[DELAY_HI] = faults.delay_ticks
        self._clock[SEED] = parts.seed % 2**62
        self.set_thresholds({k: float(getattr(parts.scenario.charging, k)) for k in LEVEL_NAMES})
        self.say("forked", f"from here on: {parts.scenario.planner.name}, seed {parts.seed}")

    def check(self) -> None:
        """Internal promises that must hold between two steps. Raises InvariantBroken."""
        c = self.claims
        for v in range(self.n):
            here = int(self.fleet.here[v])
            if c.owner[here] != v:
                raise InvariantBroken(f"vehicle {v} does not own the claim of its place")
        for place in range(self.graph.n_places):
            slot, past = int(c.next[place]), 0
            while slot >= 0:
                if c.start[slot] < past or c.end[slot] < c.start[slot]:
                    raise InvariantBroken(f"claims of place {place} overlap at tick {c.start[slot]}")
                past = int(c.end[slot])
                slot = int(c.next[slot])
