"""A run: the compiled step, and between two calls of it the deciders, the commands and the log.

The step of a tick, as a table of contents: what ends ends → orders arrive → faults and repairs → vehicles without a
plan are planned → charging → dispatch → what is due starts → energy. `advance` stops after the deciders of its last
tick, so that commands given while paused act at the next step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine import traffic
from engine.dispatch.base import ChargingPolicy, Dispatcher, FloorView
from engine.energy import Battery, CostTable
from engine.errors import InvariantBroken, ScenarioError
from engine.orders.book import OrderBook
from engine.orders.sources import OrderSource
from engine.planners import Solver
from engine.planners.base import Memory, Planner, Search
from engine.scenario.model import Scenario
from engine.scenario.serving import exits_of, regions_of
from engine.sim import checkpoint, deciding, kernels, learning, operating, planning
from engine.sim.commands import Answer, submit
from engine.sim.faults import Faults
from engine.sim.ledger import Ledger, Recorder
from engine.sim.state import (
    DECIDE,
    DELAY_HI,
    DELAY_LO,
    DELAY_PPM,
    HALF,
    HOLD,
    LATE,
    MARGIN,
    OPEN_LOOP,
    PATIENCE,
    RESTLESS,
    SAMPLE,
    SEED,
    TICK,
    Levels,
    new_fleet,
    new_sink,
)
from engine.types import FOREVER, NONE, PRIMITIVE_0, Activity, Occupancy
from engine.units import ticks_from_s
from engine.world.floor import World
from engine.world.poses import Poses

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
    cls: NDArray[np.int8]  # (V,) vehicle class, row of the costs
    facing: NDArray[np.int32]  # (V,) motion state at tick 0; empty: straight out of the place
    goals: NDArray[np.int32]  # (V,) place where a vehicle goes for good; empty: orders say where
    solver: Solver | None = None  # plans everybody at once


class Simulation:
    """One run. `clock_ns` measures planning time for the log; it is given from outside and touches nothing else."""

    def __init__(self, parts: Parts, recorder: Recorder | None = None, clock_ns: Callable[[], int] = lambda: 0):
        self.parts, self.scenario, self.world = parts, parts.scenario, parts.world
        self.graph = parts.world.graph
        self.tick_s = parts.scenario.time.tick_s
        self.n = parts.scenario.fleet.count
        self.clock_ns = clock_ns
        n, places = self.n, self.graph.n_places
        self.arrays = traffic.graph_arrays(self.graph)
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
        self.swaps = parts.scenario.battery.exchange == "swap"
        self.goals = parts.goals
        self.plan_all = len(parts.goals) > 0  # everybody with a goal is to be planned at the next occasion
        self.together_at, self.together_pause = 0, 1
        self.memory: Memory = parts.planner.init(self.graph, parts.costs, parts.planner_rng)
        self.levels = self._levels(n)
        self.tick = 0
        self.clock = np.zeros(OPEN_LOOP + 1, np.int64)
        self.clock[OPEN_LOOP] = not parts.planner.promise.legal
        self.linger = np.full(16 * n + 64, NONE, np.int32)
        self.go, self.wait_for = np.zeros(n, np.int8), np.zeros(n, np.int32)
        self.home = np.full(n, NONE, np.int32)
        self.holder = np.full(places, NONE, np.int32)
        self.must_charge = np.zeros(n, np.uint8)
        self.charge_later = np.zeros(n, np.uint8)
        self.charger_out = np.zeros(len(self.world.chargers), np.uint8)
        self.thresholds = {k: float(getattr(self.scenario.charging, k)) for k in LEVEL_NAMES}
        self.needs_plan: list[int] = []
        self.try_at = np.zeros(n, np.int32)
        self.queue: list[int] = []
        self.reasons: dict[int, str] = {}
        self.not_before: dict[int, int] = {}  # open orders for which no way was found: when to try again
        self.commands = 0
        self.done = False
        self.deadlocks = 0
        self.retry = FOREVER
        self.view = self._floor_view()
        self.learning = learning.Learning(self)
        learning.begin(self)
        self._begin()

    def _levels(self, n: int) -> Levels:
        capacity = self.parts.battery.capacity_mc

        def all_of(share: float) -> NDArray[np.int64]:
            return np.full(n, round(capacity * share), np.int64)

        charging = self.scenario.charging
        power = np.array(self.parts.power_mj, np.int64)
        return Levels(
            all_of(charging.full), all_of(max(charging.full - 0.03, charging.sufficient * 0.97)),
            all_of(charging.sufficient), all_of(charging.good), all_of(1.0), power, self.parts.battery.voltage_mv,
            self.parts.battery.accept_mj(self.tick_s),
        )  # fmt: skip

    def _floor_view(self) -> FloorView:
        world, fleet = self.world, self.scenario.fleet
        rests = np.concatenate([world.chargers, world.parking]).astype(np.int32)
        is_charger = np.zeros(self.graph.n_places, np.uint8)
        is_charger[world.chargers] = 1
        is_rest = np.zeros(self.graph.n_places, np.uint8)
        is_rest[rests] = 1
        full = self.parts.battery.energy_mj(self.parts.battery.capacity_mc)
        return FloorView(
            tick=0, tick_s=self.tick_s, search=self.search, orders=self.book, waiting=[], at=np.zeros(self.n, np.int32),
            charge_mj=np.zeros(self.n, np.int64), capacity_mj=np.full(self.n, full, np.int64), home=self.home,
            holder=self.holder, is_charger=is_charger, is_rest=is_rest, rests=rests, xy=self.graph.xy_m,
            heaviest=1.0 + fleet.payload_kg / min(fleet.each_mass_kg), standby_mj=int(self.parts.costs.standby_mj[0]),
            service_ticks=planning.service_ticks(self), levels=self.thresholds, must_charge=self.must_charge,
            blocked=self.blocked, order=self.fleet.order, failed=self.fleet.failed, paused=self.fleet.paused,
            exits=exits_of(self.scenario, world), region=regions_of(self.scenario, world),
        )  # fmt: skip

    def _begin(self) -> None:
        s, clock, f = self.scenario, self.clock, self.fleet
        clock[SAMPLE] = max(1, ticks_from_s(s.log.sample_s, self.tick_s))
        clock[PATIENCE] = max(2, ticks_from_s(PATIENCE_S, self.tick_s))
        clock[MARGIN] = self.world.margin_ticks
        clock[HOLD] = int(self.world.occupancy is Occupancy.HOLD)
        clock[SEED] = self.parts.seed % 2**62
        clock[DELAY_PPM] = round(s.faults.delay_probability * 1e6)
        clock[DELAY_LO], clock[DELAY_HI] = s.faults.delay_ticks
        clock[HALF] = clock[DECIDE] = clock[RESTLESS] = 1
        f.cls[:] = self.parts.cls
        f.charge[:] = np.rint(self.parts.initial_soc * self.parts.battery.capacity_mc).astype(np.int64)
        for v, place in enumerate(self.parts.start):
            f.here[v] = traffic.claim(self.claims, place, 0, FOREVER, v)
            f.state[v] = self.parts.facing[v] if len(self.parts.facing) else self._facing_out(place)
            planning.settle(self, v, place)
            f.final[v] = int(Activity.CHARGE if self.view.is_charger[place] else Activity.REST)
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

    @property
    def open_loop(self) -> bool:
        """True when the planner promises nothing: its plans are executed as they are."""
        return bool(self.clock[OPEN_LOOP])

    @property
    def log(self) -> Recorder | None:
        return self.ledger.recorder

    def digest(self) -> str:
        """Hex digest of everything that happened so far; the same however often the log was flushed."""
        self.drain()
        return self.ledger.digest()

    def drain(self) -> None:
        """Take the kernel's rows: arc times from the motions, then all to the ledger."""
        self.learning.see(self.sink.motions, int(self.sink.filled[0]))
        self.ledger.drain(self.sink)

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
            np.maximum(f.shown[:, 0], 0).astype(np.uint8), np.maximum(f.shown[:, 1], 0).astype(np.uint8),
            f.loaded.astype(np.uint8), (soc < self.thresholds["good"]).astype(np.uint8), f.order.copy(),
            here.astype(np.int32),
        )  # fmt: skip

    def advance(self, ticks: int) -> int:
        """Simulate so many ticks, fewer when the run is done; returns how many."""
        first = self.tick
        target = first + ticks
        c = self.clock
        while not self.done:
            wake = min(target, self.source.next_tick, self.faults.next_tick, self.retry, self.learning.next_tick)
            status = kernels.run(
                self.fleet, self.steps, self.arrays, self.claims, self.sink, self.parts.costs.mj,
                self.parts.costs.total_mj, self.parts.costs.standby_mj, self.levels, c, self.blocked, self.linger,
                self.go, self.wait_for, max(wake, self.tick),
            )  # fmt: skip
            self.tick = self.view.tick = int(c[TICK])
            deciding.read_marks(self, self.tick)
            if status == 2:
                self.drain()
                continue
            if self.learning.next_tick <= self.tick:
                learning.refresh(self)
            arrived = deciding.take_orders(self) if self.source.next_tick <= self.tick else False
            broken = self.faults.next_tick <= self.tick
            again = self.retry <= self.tick
            if status == 1 or arrived or broken or again:
                deciding.decide(self, broken, arrived or again)
            else:
                deciding.read_marks(self)
            if status == 0 and self.tick >= target:
                break
        return self.tick - first

    def flush(self) -> None:
        """Hand all rows to the recorder, and a keyframe row per vehicle for what is still open."""
        self.drain()
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
            g.state_place[f.state], g.state_place[to], g.state_heading[f.state], g.state_heading[to], f.loaded,
            f.of_order, f.of_task, mj, np.maximum(f.shown[:, 0], 0), f.charge, f.distance, f.done,
        )  # fmt: skip
        return np.stack([c.astype(np.int64) for c in columns], axis=1)

    def say(
        self, kind: str, text: str, level: int = 0, vehicle: int = NONE, order: int = NONE, place: int = NONE
    ) -> None:
        self.ledger.row("events", self.tick, kind, level, vehicle, order, place, text)

    def submit(self, command: Mapping[str, Any]) -> Answer:
        """Check, log and carry out an operator's command at the present tick."""
        return submit(self, command)

    def settle(self) -> None:
        """Let the deciders act on what a command changed."""
        deciding.decide(self, False)

    def checkpoint(self, folder: Path) -> None:
        """Flush the log and write a checkpoint folder. Raises RunError."""
        self.flush()
        checkpoint.save(self, folder)

    def rest_places(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """(P,) working chargers, and places where vehicles may stand for good."""
        return self.view.is_charger, self.view.is_rest

    def set_book(self, book: OrderBook) -> None:
        """Take over the orders of a checkpoint."""
        self.book = book
        self.view.orders = book

    def become(self, parts: Parts, *, keep_orders: bool, keep_faults: bool) -> None:
        """Go on with another planner, policies or order source; motions already committed finish first.

        Raises ScenarioError between planners whose plans are kept apart and planners whose plans are executed as they
        are.
        """
        if parts.planner.promise.legal == self.open_loop:
            raise ScenarioError("a fork can't change between plans that are kept apart and plans executed as they are")
        old = self.parts
        if parts.planner != old.planner or parts.solver != old.solver:
            self.plan_all = len(self.goals) > 0
            self.clock[RESTLESS] = 1
            self.clock[DECIDE] |= len(self.goals) > 0
            self.memory = parts.planner.init(self.graph, parts.costs, parts.planner_rng)
        self.parts = replace(
            parts, world=old.world, search=old.search, costs=old.costs, battery=old.battery, power_mj=old.power_mj
        )
        if parts.planner != old.planner or parts.solver != old.solver:
            times = self.learning.times
            self.learning = learning.Learning(self)
            self.learning.times = times
            learning.begin(self)
        self.scenario = parts.scenario
        if not keep_orders:
            self.source = parts.source
        if not keep_faults:
            self.faults = parts.faults
            self.faults.start_at(self.tick)
        faults = parts.scenario.faults
        self.clock[DELAY_PPM] = round(faults.delay_probability * 1e6)
        self.clock[DELAY_LO], self.clock[DELAY_HI] = faults.delay_ticks
        self.clock[SEED] = parts.seed % 2**62
        operating.set_thresholds(self, {k: float(getattr(parts.scenario.charging, k)) for k in LEVEL_NAMES})
        self.say("forked", f"from here on: {parts.scenario.planner.name}, seed {parts.seed}")

    def check(self) -> None:
        """Internal promises that must hold between two steps. Raises InvariantBroken."""
        c = self.claims
        for v in range(self.n):
            here = int(self.fleet.here[v])
            if c.owner[here] != v:
                raise InvariantBroken(f"vehicle {v} does not own the claim of its place")
        if self.clock[LATE] or self.open_loop:
            return  # somebody is late: times are put right before the next plan, the order holds all the time
        for place in range(self.graph.n_places):
            before, slot = place, int(c.next[place])
            while slot >= 0:
                # a vehicle that turns round at once may enter a place within its own margin
                apart = c.end[before] <= c.start[slot] or c.owner[before] == c.owner[slot]
                if not apart or c.end[slot] <= c.start[slot]:
                    raise InvariantBroken(f"claims of place {place} overlap at tick {c.start[slot]}")
                before, slot = slot, int(c.next[slot])
