"""A small, consistent run without the engine: vehicles on a one-way ring, with waits, orders, charges and commands.

`make_run(folder)` writes a whole run folder; `make_log(...)` only fills a recorder. Slow and obvious: no deadlock is
possible, since every vehicle books its destination before it leaves and the ring is never full.
"""

from __future__ import annotations

import heapq
import json
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.energy.demand import cost_table
from engine.energy.parameter_sets import xu2025
from engine.energy.xu2025 import Xu2025
from engine.results.runlog import RunLogWriter
from engine.results.schema import TABLES
from engine.scenario import Scenario, parse, start_places
from engine.types import (
    COMPONENTS,
    FOREVER,
    NONE,
    PRIMITIVE_0,
    Activity,
    Cause,
    Component,
    OrderState,
    Task,
    VehicleState,
)
from engine.world.floor import World, build_world

TOML = """
name = "synthetic"
title = "A ring of one-way aisles"
seed = {seed}
[time]
tick_s = {tick_s}
until_s = {until_s}
[floor]
margin_ticks = {margin}
rows = '''
#CCCRRRPPP#
v<<<<<<<<<<
vRRRPPPCCC^
v#########^
vRRRPPPCCC^
>>>>>>>>>>^
#IIICCCOOO#
'''
[motion]
straight_ticks = {straight}
turn_ticks = {turn}
reverse_ticks = {reverse}
[service]
pick_s = 5.0
drop_s = 4.0
[fleet]
count = {vehicles}
payload_kg = 250.0
[battery]
model = "coulomb"
capacity_wh = 60.0
[charger]
power_w = 1500.0
[orders]
source = "poisson"
rate_per_h = 240.0
[log]
sample_s = 10.0
keyframe_s = 120.0
"""

COMMANDS: tuple[tuple[int, dict[str, Any]], ...] = (
    (60, {"do": "order", "from": 1, "to": 8}),
    (120, {"do": "pause", "vehicle": 1}),
    (150, {"do": "continue", "vehicle": 1}),
    (200, {"do": "block", "place": "ring"}),
    (230, {"do": "unblock", "place": "ring"}),
    (300, {"do": "charger out", "charger": 11}),
    (420, {"do": "charger back", "charger": 11}),
    (500, {"do": "fail", "vehicle": 2}),
    (560, {"do": "repair", "vehicle": 2}),
    (600, {"do": "withdraw", "order": "open"}),
    (700, {"do": "thresholds", "critical": 0.2, "good": 0.4, "sufficient": 0.8, "full": 1.0, "reserve": 0.05}),
)
"""Commands of the usual synthetic run; "ring" and "open" are looked up when they are given."""


def scenario_toml(
    *,
    vehicles: int = 5,
    ticks: int = 1800,
    seed: int = 1,
    tick_s: float = 1.0,
    margin: int = 1,
    straight: int = 1,
    turn: int = 2,
    reverse: int = 3,
) -> str:
    """Text of the synthetic scenario."""
    return TOML.format(
        vehicles=vehicles,
        until_s=float(ticks * tick_s),
        seed=seed,
        tick_s=tick_s,
        margin=margin,
        straight=straight,
        turn=turn,
        reverse=reverse,
    )


def make_run(
    folder: Path | str,
    *,
    run_id: str = "20261122-101500-synthetic-0001",
    ticks: int = 1800,
    vehicles: int = 5,
    seed: int = 1,
    commands: Sequence[tuple[int, Mapping[str, Any]]] = COMMANDS,
    close: bool = True,
    **scenario: Any,
) -> str:
    """Write a run below `folder` and return its id. With close=False the segments stay, as after a kill."""
    text = scenario_toml(vehicles=vehicles, ticks=ticks, seed=seed, **scenario)
    asked = parse(text)
    manifest = {
        "run_id": run_id,
        "scenario": asked.name,
        "title": asked.title,
        "planner": asked.planner.name,
        "objective": asked.planner.objective,
        "seed": seed,
        "fleet": vehicles,
        "tick_s": asked.time.tick_s,
        "versions": {"wattlane": "0.1.0"},
        "parameters": {},
        "parent": None,
        "created": "2026-11-22T10:15:00+00:00",
        "ticks": 0,
        "wall_s": 0.0,
        "digest": "",
        "summary": {},
        "breaches": None,
        "retention": None,
        "note": "",
        "name": "",
    }
    writer = RunLogWriter(Path(folder) / run_id, manifest, scenario_toml=text, keyframe_ticks=120)
    made = make_log(writer, asked, build_world(asked), ticks=ticks, commands=commands)
    summary = {"orders_created": len(made.orders), "orders_done": sum(v.done for v in made.fleet), "stranded": 0}
    writer.close("finished", compact=close, ticks=ticks, wall_s=1.0, summary=summary)
    return run_id


def make_log(
    recorder: Any,
    scenario: Scenario,
    world: World,
    *,
    ticks: int,
    commands: Sequence[tuple[int, Mapping[str, Any]]] = (),
    flush_every: int = 100,
) -> _Run:
    """Fill a recorder with a consistent run of so many ticks, flushing now and then; returns the run as it ended."""
    run = _Run(scenario, world, recorder, dict(_by_tick(commands)))
    for tick in range(ticks):
        run.decide(tick)
        if tick and tick % flush_every == 0:
            run.flush(tick)
        run.act(tick)
    run.decide(ticks)
    run.flush(ticks)
    return run


def _by_tick(commands: Sequence[tuple[int, Mapping[str, Any]]]) -> list[tuple[int, list[Mapping[str, Any]]]]:
    out: dict[int, list[Mapping[str, Any]]] = {}
    for tick, command in commands:
        out.setdefault(tick, []).append(command)
    return sorted(out.items())


def _columns(table: str, rows: list[tuple[Any, ...]]) -> dict[str, list[Any]]:
    return dict(zip(TABLES[table], map(list, zip(*rows, strict=True)), strict=True))


@dataclass
class _Vehicle:
    state: int
    kind: int = int(Activity.REST)
    cause: int = int(Cause.NONE)
    blocker: int = NONE
    t0: int = 0
    t1: int = FOREVER
    edge: int = NONE
    rolled: int = -1
    loaded: int = 0
    order: int = NONE
    task: int = int(Task.NONE)
    route: list[int] = field(default_factory=list)
    legs: list[tuple[int, int]] = field(default_factory=list)  # (destination, task) still to drive
    service: int = 0  # ticks of service due here, when the route is done
    then: int = int(Activity.REST)
    booked: set[int] = field(default_factory=set)
    charger: int = NONE
    charge: int = 0
    rest: int = 0
    ledger: list[int] = field(default_factory=lambda: [0] * len(COMPONENTS))
    distance: int = 0
    done: int = 0
    paused: bool = False
    failed: bool = False
    shown: tuple[int, ...] = ()


class _Run:
    def __init__(self, scenario: Scenario, world: World, recorder: Any, commands: dict[int, Any]) -> None:
        self.s, self.w, self.g, self.recorder, self.commands = scenario, world, world.graph, recorder, commands
        self.random = random.Random(scenario.seed)
        tick_s = scenario.time.tick_s
        empty, load = scenario.fleet.mass_kg, scenario.fleet.payload_kg
        model = Xu2025(**{**xu2025(scenario.motion.speed_mps), **scenario.energy.parameters})
        self.cost = cost_table(self.g.primitives, model, [(empty, load)], tick_s)
        self.volt = round(scenario.battery.voltage_v * 1000)
        self.capacity = round(scenario.battery.capacity_wh * 3600 * 1e6 / self.volt)
        self.gross = round(scenario.charger.power_w * tick_s * 1000)
        self.net = int(self.gross * scenario.charger.efficiency)
        self.level = {"good": 0.3, "sufficient": 0.8}
        self.sample = round(scenario.log.sample_s / tick_s)
        self.pick, self.drop = round(scenario.service.pick_s / tick_s), round(scenario.service.drop_s / tick_s)
        self.rate = scenario.orders.rate_per_h / 3600 * tick_s
        self.rows: dict[str, list[tuple[Any, ...]]] = {name: [] for name in TABLES}
        self.holder: dict[int, int] = {}
        self.linger: dict[int, int] = {}  # place → tick until which it stays closed
        self.blocked: set[int] = set()
        self.out: set[int] = set()
        self.orders: list[dict[str, int]] = []
        self.number = 0
        self.fleet: list[_Vehicle] = []
        for v, place in enumerate(start_places(scenario, world)):
            self.holder[place] = v
            self.fleet.append(_Vehicle(self.g.state(place, 0), charge=self.capacity, booked={place}))
        for v in range(len(self.fleet)):
            self._sample(0, v)

    # -- one tick

    def decide(self, t: int) -> None:
        """What ends, ends; then commands, orders and dispatch. A flush comes after it, as in the engine."""
        self.finish_tick(t)
        for command in self.commands.get(t, ()):
            self._command(t, dict(command))
        self._new_orders(t)
        self._dispatch(t)

    def act(self, t: int) -> None:
        """Start what may start, and move the energy of [t, t + 1)."""
        for v in range(len(self.fleet)):
            self._start(t, v)
        for v in range(len(self.fleet)):
            self._show(t, v)
            self._energy(t, v)
        if (t + 1) % self.sample == 0:
            for v in range(len(self.fleet)):
                self._sample(t + 1, v)

    def finish_tick(self, t: int) -> None:
        for place in [p for p, until in self.linger.items() if until <= t]:
            del self.linger[place], self.holder[place]
        for v, a in enumerate(self.fleet):
            if a.t1 == t:
                self._finish(t, v)

    def flush(self, t: int) -> None:
        """Push the rows, then the keyframe of what is open."""
        for name, rows in self.rows.items():
            if rows:
                self.recorder.write(name, _columns(name, rows))
                rows.clear()
        frames = []
        for v, a in enumerate(self.fleet):
            frames.append((t, *self._motion_row(v, a.t1), a.shown[0] if a.shown else 0, a.charge, a.distance, a.done))
        self.recorder.write("keyframes", _columns("keyframes", frames))
        self.recorder.flush()

    def _motion_row(self, v: int, t1: int) -> tuple[int, ...]:
        a, g = self.fleet[v], self.g
        end = int(g.edge_to[a.edge]) if a.edge >= 0 else a.state
        energy = int(self.cost.total_mj[0, a.loaded, a.kind - PRIMITIVE_0]) if a.edge >= 0 else 0
        return (
            v, a.kind, a.cause, a.blocker, a.t0, t1, int(g.state_place[a.state]), int(g.state_place[end]),
            int(g.state_heading[a.state]), int(g.state_heading[end]), a.loaded, a.order, a.task, energy,
        )  # fmt: skip

    def _close(self, t: int, v: int) -> None:
        if t > self.fleet[v].t0:
            self.rows["motions"].append(self._motion_row(v, t))

    def _open(self, t: int, v: int, kind: int, cause: int = 0, blocker: int = NONE, t1: int = FOREVER) -> None:
        a = self.fleet[v]
        if (a.kind, a.cause, a.blocker, a.t1) == (kind, cause, blocker, t1) and kind < PRIMITIVE_0:
            return
        self._close(t, v)
        a.kind, a.cause, a.blocker, a.t0, a.t1 = kind, cause, blocker, t, t1

    def _finish(self, t: int, v: int) -> None:
        a, g = self.fleet[v], self.g
        self._close(t, v)
        if a.edge >= 0:
            left = int(g.state_place[a.state])
            a.state, a.rolled = int(g.edge_to[a.edge]), t
            a.distance += int(g.kind_mm[a.kind - PRIMITIVE_0])
            a.edge = NONE
            if self.s.floor.margin_ticks:
                self.linger[left] = t + self.s.floor.margin_ticks
            else:
                del self.holder[left]
            if all(left != place for place, _ in a.legs) and left not in a.route[-1:]:
                a.booked.discard(left)
        elif a.kind == Activity.PICK:
            a.loaded = 1
            a.task = int(Task.TO_DROP)
            self._order_row(t, a.order, OrderState.PICKED, v)
        elif a.kind == Activity.DROP:
            a.loaded = 0
            a.done += 1
            self._order_row(t, a.order, OrderState.DONE, v)
            a.order, a.task = NONE, int(Task.NONE)
        a.kind, a.cause, a.blocker, a.t0, a.t1 = int(Activity.WAIT), int(Cause.PLANNED), NONE, t, FOREVER

    # -- deciding

    def _new_orders(self, t: int) -> None:
        if self.random.random() < self.rate:
            inbound = [s for s in self.w.stations if s.kind == "inbound"]
            racks = [s for s in self.w.stations if s.kind == "rack"]
            outbound = [s for s in self.w.stations if s.kind == "outbound"]
            pair = (inbound, racks) if self.random.random() < 0.5 else (racks, outbound)
            self._new_order(t, self.random.choice(pair[0]), self.random.choice(pair[1]), 0)

    def _new_order(self, t: int, start: Any, end: Any, source: int) -> int:
        self.orders.append(
            {"from": start.place, "to": end.place, "a": start.number, "b": end.number, "source": source, "state": 0}
        )
        self._order_row(t, len(self.orders) - 1, OrderState.OPEN, NONE)
        return len(self.orders) - 1

    def _order_row(self, t: int, n: int, state: OrderState, v: int) -> None:
        o = self.orders[n]
        o["state"] = int(state)
        self.rows["orders"].append((t, n, int(state), v, o["from"], o["to"], o["a"], o["b"], o["source"]))

    def _dispatch(self, t: int) -> None:
        taken = set().union(*(a.booked for a in self.fleet))
        for v, a in enumerate(self.fleet):
            if a.t1 < FOREVER or a.route or a.legs or a.service or a.paused or a.failed or a.order >= 0:
                continue
            low = a.charge < self.level["good"] * self.capacity
            charging = a.then == Activity.CHARGE and a.charge < self.level["sufficient"] * self.capacity
            if not low and not charging:
                for n, o in enumerate(self.orders):
                    if o["state"] == OrderState.OPEN and not {o["from"], o["to"]} & (taken - a.booked):
                        self._close(t, v)  # what it did so far was not for this order
                        a.t0, a.order = t, n
                        self._order_row(t, n, OrderState.ASSIGNED, v)
                        a.legs = [(o["from"], int(Task.TO_PICK)), (o["to"], int(Task.TO_DROP))]
                        self._leave(t, v, {o["from"], o["to"]})
                        taken |= a.booked
                        break
            here = int(self.g.state_place[a.state])
            if a.order < 0 and not charging and not (a.then == Activity.REST and here in self._rest()):
                self._go_and_rest(t, v, low, taken)
            elif a.order < 0 and low and a.then != Activity.CHARGE:
                self._go_and_rest(t, v, True, taken)

    def _rest(self) -> set[int]:
        return {int(p) for p in (*self.w.parking, *self.w.chargers)}

    def _go_and_rest(self, t: int, v: int, low: bool, taken: set[int]) -> None:
        a = self.fleet[v]
        places = self.w.chargers if low else self.w.parking
        here = int(self.g.state_place[a.state])
        free = [i for i, p in enumerate(places) if int(p) not in taken and not (low and i in self.out)]
        if low and here in self.w.chargers.tolist():
            free = [self.w.chargers.tolist().index(here)]
        if not free:
            return
        target = int(places[free[0]])
        a.legs = [(target, int(Task.TO_CHARGER if low else Task.TO_REST))] if target != here else []
        self._leave(t, v, {target})
        taken.add(target)
        a.then = int(Activity.CHARGE if low else Activity.REST)
        if low:
            a.charger = free[0]
            self.rows["chargers"].append((t, free[0], v, 0 if target != here else 1))
            self.rows["events"].append((t, "charge", 0, v, NONE, target, f"vehicle {v} goes to charger C{free[0] + 1}"))

    def _leave(self, t: int, v: int, booked: set[int]) -> None:
        a = self.fleet[v]
        a.booked = {int(self.g.state_place[a.state])} | booked
        a.then = int(Activity.REST)
        if a.charger >= 0:
            self.rows["chargers"].append((t, a.charger, v, 2))
            a.charger = NONE

    # -- executing

    def _start(self, t: int, v: int) -> None:
        a, g = self.fleet[v], self.g
        if a.t1 < FOREVER:
            return
        if a.failed:
            self._open(t, v, int(Activity.FAULT))
            return
        if a.paused:
            self._open(t, v, int(Activity.PAUSE), int(Cause.OPERATOR))
            return
        if not a.route and not a.service and a.legs:
            target, a.task = a.legs.pop(0)
            a.route = self._path(a.state, target)
            a.service = {int(Task.TO_PICK): self.pick, int(Task.TO_DROP): self.drop}.get(a.task, 0)
            self._plan_row(t, v)
        if not a.route:
            if a.service:
                kind = Activity.PICK if a.task == Task.TO_PICK else Activity.DROP
                a.state = int(g.stopped[a.state])
                self._open(t, v, int(kind), t1=t + a.service)
                a.service = 0
            else:
                charging = a.then == Activity.CHARGE and a.charge < self.capacity and a.charger not in self.out
                if a.then == Activity.CHARGE and a.kind != Activity.CHARGE and charging and a.t0 < FOREVER:
                    self.rows["chargers"].append((t, a.charger, v, 1))
                a.task = int(Task.NONE)
                self._open(t, v, int(Activity.CHARGE if charging else Activity.REST))
            return
        if a.rolled != t:
            a.state = int(g.stopped[a.state])
        target = a.route[0]
        if target in self.blocked:
            self._open(t, v, int(Activity.WAIT), int(Cause.BLOCKED))
            return
        if target in self.holder:
            self._open(t, v, int(Activity.WAIT), int(Cause.VEHICLE), self.holder[target])
            return
        edge = self._edge(a.state, target)
        kind = int(g.edge_kind[edge])
        self.holder[target] = v
        self._open(t, v, PRIMITIVE_0 + kind, t1=t + int(g.kind_ticks[kind]))
        a.edge = edge
        a.route.pop(0)

    def _edge(self, state: int, place: int) -> int:
        for e in range(int(self.g.edge_ptr[state]), int(self.g.edge_ptr[state + 1])):
            if self.g.state_place[self.g.edge_to[e]] == place:
                return e
        raise AssertionError((state, place))

    def _path(self, state: int, target: int) -> list[int]:
        """Quickest places from a state to a place, by Dijkstra on the motion graph."""
        g = self.g
        heap, before, seen = [(0, state, NONE)], {}, set()
        while heap:
            cost, s, parent = heapq.heappop(heap)
            if s in seen:
                continue
            seen.add(s)
            before[s] = parent
            if g.state_place[s] == target:
                places = []
                while s >= 0:
                    places.append(int(g.state_place[s]))
                    s = before[s]
                return places[-2::-1]
            for e in range(int(g.edge_ptr[s]), int(g.edge_ptr[s + 1])):
                heapq.heappush(heap, (cost + int(g.kind_ticks[g.edge_kind[e]]), int(g.edge_to[e]), s))
        raise AssertionError(f"no way to {target}")

    def _plan_row(self, t: int, v: int) -> None:
        a, g = self.fleet[v], self.g
        places, t_in, t_out = [int(g.state_place[a.state])], [t], []
        s, now, energy = int(g.stopped[a.state]), t, 0
        for target in a.route:
            e = self._edge(s, target)
            kind = int(g.edge_kind[e])
            places.append(target)
            t_in.append(now)
            now += int(g.kind_ticks[kind])
            t_out.append(now + self.s.floor.margin_ticks)
            energy += int(self.cost.total_mj[0, a.loaded, kind])
            s = int(g.edge_to[e])
        energy += (now - t) * int(self.cost.standby_mj[0])
        t_out.append(FOREVER)
        cpu = 200 + self.random.randrange(800)
        self.rows["plans"].append(
            (t, v, a.task, a.order, "solved", places, t_in, t_out, t, now, energy, len(places) * 7, cpu)
        )

    def _show(self, t: int, v: int) -> None:
        a = self.fleet[v]
        word = {
            int(Activity.WAIT): VehicleState.WAITING, int(Activity.PICK): VehicleState.LOADING,
            int(Activity.DROP): VehicleState.LOADING, int(Activity.CHARGE): VehicleState.CHARGING,
            int(Activity.REST): VehicleState.IDLE, int(Activity.FAULT): VehicleState.FAULT,
            int(Activity.PAUSE): VehicleState.PAUSED,
        }  # fmt: skip
        moving = VehicleState.TO_CHARGER if a.task == Task.TO_CHARGER else VehicleState.MOVING
        state = moving if a.kind >= PRIMITIVE_0 else word[a.kind]
        row = (int(state), a.task, a.order, a.cause, a.blocker)
        if row != a.shown:
            a.shown = row
            self.rows["states"].append((t, v, *row))

    # -- energy

    def _energy(self, t: int, v: int) -> None:
        a = self.fleet[v]
        drawn = int(self.cost.standby_mj[0])
        a.ledger[Component.STANDBY] += drawn
        if a.kind >= PRIMITIVE_0:
            span, past = a.t1 - a.t0, t - a.t0
            for i, c in enumerate(self.cost.mj[0, a.loaded, a.kind - PRIMITIVE_0].tolist()):
                part = c * (past + 1) // span - c * past // span
                a.ledger[i] += part
                drawn += part
        if a.kind == Activity.CHARGE:
            room = ((self.capacity - a.charge) * self.volt + 999) // 1000 + drawn
            gross, net = self.gross, self.net
            if net > room:
                gross, net = gross * room // net, room
            a.ledger[Component.CHARGED] -= gross
            a.ledger[Component.CHARGER_LOSS] += gross - net
            drawn -= net
        work = drawn * 1000 + a.rest
        a.charge -= work // self.volt
        a.rest = work % self.volt

    def _sample(self, t: int, v: int) -> None:
        a = self.fleet[v]
        self.rows["battery"].append((t, v, a.charge, self.volt, *a.ledger))

    # -- commands

    def _command(self, t: int, command: dict[str, Any]) -> None:
        do = command["do"]
        reason = ""
        if command.get("place") == "ring":
            command["place"] = self.w.place_at(6, 1)
        if command.get("order") == "open":
            command["order"] = next((n for n, o in enumerate(self.orders) if o["state"] == OrderState.OPEN), NONE)
        if do == "order":
            self._new_order(t, self.w.station(command["from"]), self.w.station(command["to"]), 1)
        elif do == "withdraw":
            n = command["order"]
            if n >= 0:
                self._order_row(t, n, OrderState.WITHDRAWN, NONE)
            else:
                reason = "there is no open order"
        elif do in ("pause", "continue"):
            self.fleet[command["vehicle"]].paused = do == "pause"
        elif do in ("fail", "repair"):
            self.fleet[command["vehicle"]].failed = do == "fail"
            text = f"vehicle {command['vehicle']} {'broke down' if do == 'fail' else 'works again'}"
            self.rows["events"].append((t, "fault", 2 if do == "fail" else 0, command["vehicle"], NONE, NONE, text))
        elif do in ("block", "unblock"):
            place = command["place"]
            change: Callable[[int], None] = self.blocked.add if do == "block" else self.blocked.discard
            change(place)
            self.rows["blocks"].append((t, place, int(do == "block")))
            self.rows["events"].append((t, "block", 1, NONE, NONE, place, f"{self.w.place_name(place)} {do}ed"))
        elif do in ("charger out", "charger back"):
            i = command["charger"]
            (self.out.add if do == "charger out" else self.out.discard)(i)
            self.rows["chargers"].append((t, i, NONE, 3 if do == "charger out" else 4))
        elif do == "thresholds":
            self.level = {name: command[name] for name in self.level}
        self.rows["commands"].append((t, self.number, json.dumps(command), int(not reason), reason))
        self.number += 1
