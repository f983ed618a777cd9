"""A run on terrain: one robot drives its plan over ground that it knows only in part, and sees more as it goes.

The step of a tick, as a table of contents: what ends ends → the sensor looks → the search works within its budget →
what is due starts → energy. Plans are made on what is believed, energy is drawn as the ground is. The same log, ledger,
commands and checkpoints as on a floor; one Python step per tick, for there is one robot.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import Battery
from engine.energy.terrain_costs import BLOCKED, TerrainCosts
from engine.errors import BadInput, InvariantBroken, RunError
from engine.planners.base import AnytimeSearch, Route
from engine.results.schema import THINNED
from engine.scenario.model import Scenario
from engine.sim import checkpoint, ground_commands
from engine.sim.commands import Answer, Refused, values_of
from engine.sim.ledger import Ledger, Recorder
from engine.sim.state import NC, new_sink
from engine.types import FOREVER, NONE, PRIMITIVE_0, Activity, Cause, Component, PlanStatus, Task, VehicleState
from engine.units import ticks_from_s
from engine.world.lattice import HEADINGS
from engine.world.poses import Poses
from engine.world.terrain import TerrainWorld, disc

_PLAIN = (
    "tick", "half", "state", "k", "t0", "t1", "kind", "cause", "task", "began", "next", "goal_cell", "charge", "rest",
    "sampled", "distance", "paused", "failed", "stranded", "done", "commands", "published",
    "counted",
)  # fmt: skip
_SHOWN: dict[int, VehicleState] = {
    Activity.WAIT: VehicleState.WAITING,
    Activity.REST: VehicleState.IDLE,
    Activity.FAULT: VehicleState.FAULT,
    Activity.PAUSE: VehicleState.PAUSED,
}


@dataclass(frozen=True, slots=True)
class GroundParts:
    """What a run on terrain is made of; engine.build puts it together.

    believed: the ground as the robot knows it, with the costs over which it plans · truth: as it is · search_of: a
    search over the believed costs from a state to a cell.
    """

    scenario: Scenario
    world: TerrainWorld
    seed: int
    battery: Battery
    believed: TerrainCosts
    truth: TerrainCosts
    search_of: Callable[[TerrainCosts, int, int], AnytimeSearch]
    per_tick: int
    standby_mj: int
    start: int  # motion state
    goal_cell: int
    initial_soc: float
    source: Any  # of orders: there are none


class Roaming:
    """One run on terrain; the same calls as engine.sim.simulation.Simulation."""

    def __init__(self, parts: GroundParts, recorder: Recorder | None = None, clock_ns: Callable[[], int] = lambda: 0):
        self.parts, self.scenario, self.world = parts, parts.scenario, parts.world
        self.graph, self.cluster = parts.world.graph, parts.world.cluster
        self.tick_s, self.n = parts.scenario.time.tick_s, 1
        self.clock_ns = clock_ns
        self.believed, self.truth = parts.believed, parts.truth
        self.ledger, self.sink = Ledger(recorder), new_sink(1)
        self.tick, self.half, self.done = 0, False, False
        self.state, self.k, self.goal_cell = parts.start, NONE, parts.goal_cell
        self.kind, self.cause, self.task = int(Activity.WAIT), int(Cause.PLANNED), int(Task.NONE)
        self.began = int(Task.NONE)  # task when the open interval began
        self.t0, self.t1 = 0, FOREVER
        self.parts_mj = np.zeros(NC, np.int64)  # of the motion under way
        self.book = np.zeros(NC, np.int64)
        self.charge = round(parts.initial_soc * parts.battery.capacity_mc)
        self.rest = self.sampled = self.distance = self.commands = 0
        self.paused = self.failed = self.stranded = False
        self.shown: list[int] = [-2] * 5
        self.states, self.ks = np.array([self.state], np.int32), np.zeros(0, np.int32)
        self.next = 0  # step of the way that is driven next
        self.published: list[float] = [0.0, 0.0]  # ε and cost of the plan last written to the log
        self.counted = 0  # expansions up to then
        self.sample_every = max(1, ticks_from_s(parts.scenario.log.sample_s, self.tick_s))
        self.eye = disc(parts.world.sensor_m / parts.world.grain_m)
        self.blocked = np.zeros(self.graph.n_places, np.uint8)
        self.look()
        self.search = parts.search_of(self.believed, self.state, self.goal_cell)
        self.sample()
        self.say("run started", f"{self.scenario.title}, 1 vehicle")

    # ---------------------------------------------------------------- the step

    def advance(self, ticks: int) -> int:
        """Simulate so many ticks, fewer when the run is done; returns how many."""
        first = self.tick
        while True:
            if not self.half:
                self.finish()
                self.half = True
            self.settle()
            if self.done or self.tick >= first + ticks:
                return self.tick - first
            self.plan()
            self.start()
            self.show()
            self.draw()
            self.tick += 1
            self.half = False
            if self.tick % self.sample_every == 0:
                self.sample()
            if max(self.sink.filled[:3]) > len(self.sink.motions) - 8:
                self.drain()

    def finish(self) -> None:
        """End the motion that is due, and look around."""
        if self.t1 != self.tick:
            return
        self.close()
        self.distance += int(self.graph.kind_mm[self.kind - PRIMITIVE_0])
        self.state, self.k = self.after(), NONE
        self.begin(Activity.WAIT, Cause.PLANNED, FOREVER)
        self.look()

    def after(self) -> int:
        """The motion state from which the next motion starts."""
        if self.k == NONE:
            return self.state
        cell, h = divmod(self.state, HEADINGS)
        dx, dy, to = self.cluster.end[h, self.k].tolist()
        return int((cell + dy * self.world.width + dx) * HEADINGS + to)

    def look(self) -> None:
        """The sensor reveals heights, obstacles and friction around the robot; the search hears of what is new."""
        y, x = divmod(self.state // HEADINGS, self.world.width)
        cells = self.eye + np.array([x, y], np.int32)
        inside = (cells >= 0).all(1) & (cells < [self.world.width, self.world.height]).all(1)
        cells = cells[inside]
        cx, cy = cells.T
        old, true = self.believed, self.truth
        news = (old.known[cy, cx] == 0) | (old.obstacle[cy, cx] != true.obstacle[cy, cx])
        if not news.any():
            return
        cells, cx, cy = cells[news], cx[news], cy[news]
        changed = old.see(cells, true.height[cy, cx], true.obstacle[cy, cx], true.friction[cy, cx])
        if not hasattr(self, "search"):
            return
        own = ((cy * self.world.width + cx)[:, None] * HEADINGS + np.arange(HEADINGS)).ravel().astype(np.int32)
        self.search.changed(np.union1d(changed, own).astype(np.int32))

    def settle(self) -> None:
        """See whether the goal is reached."""
        if self.k != NONE or self.done or self.state // HEADINGS != self.goal_cell:
            return
        if self.kind != Activity.REST:
            self.task = int(Task.NONE)
            self.open(Activity.REST, Cause.NONE)
            self.say("arrived", "vehicle 0 is at its goal", 0, 0, self.goal_cell)
        if self.scenario.time.finish == "goals reached":
            self.done = True
            if self.tick % self.sample_every:
                self.sample()
            self.say("run done", "every vehicle rests at its goal")

    def plan(self) -> None:
        """Let the search work; what it publishes is driven from the next motion on."""
        if self.search.optimal or self.failed or self.after() // HEADINGS == self.goal_cell:
            return
        begun, before = self.clock_ns(), self.search.expanded
        route = self.search.work(self.parts.per_tick)
        if route is None:
            return
        self.adopt(route, self.search.expanded - before, (self.clock_ns() - begun) // 1000)

    def adopt(self, route: Route, expanded: int, cpu_us: int) -> None:
        """Drive a published way; log it when it is news."""
        if route.found and (len(route.states) == 0 or route.states[0] != self.after()):
            raise InvariantBroken("a way starts where the robot will not be")
        news = [route.bound, float(route.cost)] if route.found else [0.0, -1.0]
        same = route.found and np.array_equal(route.ks, self.ks[self.next :])
        self.states, self.ks, self.next = route.states, route.ks, 0
        self.task = int(Task.TO_REST)
        if (same and news[0] >= self.published[0]) or news == self.published:
            return
        self.published = news
        starts, end = self.times(route)
        note = f"within {route.bound:g} of the least" if route.status is PlanStatus.BOUNDED else str(route.status)
        place = (route.states // HEADINGS).tolist()
        out = [*starts[1:], FOREVER] if place else []
        first = starts[0] if starts else self.tick
        self.ledger.row(
            "plans", self.tick, 0, self.task, NONE, note, place, starts, out, first, end,
            route.cost + (end - first) * self.parts.standby_mj if route.found else 0, expanded, cpu_us,
        )  # fmt: skip
        waiting, later = self.search.frontier()
        self.ledger.row(
            "searches", self.tick, 0, round(1000 * news[0]), int(news[1]), self.search.expanded - self.counted,
            len(waiting), len(later), _thinned(waiting), _thinned(later),
        )  # fmt: skip
        self.counted = self.search.expanded

    def times(self, route: Route) -> tuple[list[int], int]:
        """Ticks at which the places of a way are left or, the last, reached."""
        begin = self.t1 if self.k != NONE else self.tick
        kinds = self.cluster.kind[route.states[:-1] % HEADINGS, route.ks]
        ticks = np.concatenate([[begin], begin + np.cumsum(self.graph.kind_ticks[kinds].astype(np.int64))]).tolist()
        return (ticks, ticks[-1]) if len(route.states) else ([], begin)

    def start(self) -> None:
        """Begin the next motion of the way, or say why not."""
        if self.k != NONE or self.kind == Activity.REST:
            return
        if self.failed:
            self.open(Activity.FAULT, Cause.NONE)
        elif self.paused:
            self.open(Activity.PAUSE, Cause.OPERATOR)
        elif self.next >= len(self.ks) or self.states[self.next] != self.state:
            self.open(Activity.WAIT, Cause.NO_PLAN)
        elif self.believed.cost[self.state, self.ks[self.next]] >= BLOCKED:
            self.open(Activity.WAIT, Cause.BLOCKED)
        else:
            self.drive(int(self.ks[self.next]))

    def drive(self, k: int) -> None:
        """Begin a motion, if there is charge for it."""
        heading = self.state % HEADINGS
        if not self.truth.can(self.state, k):
            raise InvariantBroken("the robot would drive where it can't, though it sees the ground ahead")
        parts = self.truth.parts(self.state, k)
        kind = int(self.cluster.kind[heading, k])
        ticks = int(self.graph.kind_ticks[kind])
        if int(parts.sum()) + ticks * self.parts.standby_mj > int(self.parts.battery.energy_mj(self.charge)):
            self.open(Activity.WAIT, Cause.EMPTY)
            if not self.stranded:
                self.stranded = True
                self.say("stranded", "vehicle 0 has too little charge for its next motion", 2, 0)
            return
        self.parts_mj = parts
        self.open(PRIMITIVE_0 + kind, Cause.NONE, self.tick + ticks)
        self.k = k
        self.next += 1
        self.search.move(self.after())

    def draw(self) -> None:
        """Move the energy of [tick, tick + 1): motion spread over its ticks by cumulative floor, standby."""
        drawn = 0
        if self.k != NONE:
            span, past = self.t1 - self.t0, self.tick - self.t0
            part = self.parts_mj * (past + 1) // span - self.parts_mj * past // span
            self.book += part
            drawn += int(part.sum())
        if self.charge > 0:
            self.book[Component.STANDBY] += self.parts.standby_mj
            drawn += self.parts.standby_mj
        volt, before = self.voltage_mv(), self.charge
        work = drawn * 1000 + self.rest
        moved = work // volt
        if moved >= before > 0:
            self.book[Component.STANDBY] -= drawn - (before * volt - self.rest) // 1000
            moved, work = before, before * volt
        self.rest = work - moved * volt
        self.charge = min(before - moved, self.parts.battery.capacity_mc)
        if self.charge <= 0 < before and not self.stranded:
            self.stranded = True
            self.say("stranded", "vehicle 0 has run empty", 2, 0)

    def voltage_mv(self) -> int:
        """Voltage at the present charge, from the battery's table."""
        table = self.parts.battery.voltage_mv
        last = len(table) - 1
        return int(table[min(max(self.charge * last // self.parts.battery.capacity_mc, 0), last)])

    # ---------------------------------------------------------------- the log

    def open(self, kind: int, cause: Cause, t1: int = FOREVER) -> None:
        """Begin an interval unless the same one is already open."""
        if self.kind == kind and self.cause == cause and self.t1 == t1 and self.began == self.task:
            return
        self.close()
        self.begin(kind, cause, t1)

    def begin(self, kind: int, cause: Cause, t1: int) -> None:
        """Set what the open interval is."""
        self.kind, self.cause, self.t0, self.t1, self.began = int(kind), int(cause), self.tick, t1, self.task

    def close(self) -> None:
        """Write the open interval to the log, ending now."""
        if self.tick <= self.t0:
            return
        here, there = self.state, self.after()
        row = self.sink.motions[self.sink.filled[0]]
        row[:] = (
            0, self.kind, self.cause, NONE, self.t0, self.tick, here // HEADINGS, there // HEADINGS, here % HEADINGS,
            there % HEADINGS, 0, NONE, self.began, int(self.parts_mj.sum()) if self.k != NONE else 0,
        )  # fmt: skip
        self.sink.filled[0] += 1

    def show(self) -> None:
        """A row of `states` when anything in it changed."""
        state = VehicleState.MOVING if self.kind >= PRIMITIVE_0 else _SHOWN[self.kind]
        now = [int(state), self.task, NONE, self.cause, NONE]
        if now != self.shown:
            self.shown = now
            self.sink.states[self.sink.filled[2]] = (self.tick, 0, *now)
            self.sink.filled[2] += 1

    def sample(self) -> None:
        """A row of `battery`."""
        self.sink.battery[self.sink.filled[1]] = (self.tick, 0, self.charge, self.voltage_mv(), *self.book)
        self.sink.filled[1] += 1
        self.sampled = self.charge

    def say(self, kind: str, text: str, level: int = 0, vehicle: int = NONE, place: int = NONE) -> None:
        self.ledger.row("events", self.tick, kind, level, vehicle, NONE, place, text)

    def drain(self) -> None:
        """Hand the rows of motions, battery and states to the ledger."""
        self.ledger.drain(self.sink)

    @property
    def log(self) -> Recorder | None:
        return self.ledger.recorder

    def digest(self) -> str:
        """Hex digest of everything that happened so far; the same however often the log was flushed."""
        self.drain()
        return self.ledger.digest()

    def flush(self) -> None:
        """Hand all rows to the recorder, and a keyframe row for what is still open."""
        self.drain()
        self.ledger.flush()
        if self.ledger.recorder is None:
            return
        here, there = self.state, self.after()
        row = (
            self.tick, 0, self.kind, self.cause, NONE, self.t0, self.t1, here // HEADINGS, there // HEADINGS,
            here % HEADINGS, there % HEADINGS, 0, NONE, self.began,
            int(self.parts_mj.sum()) if self.k != NONE else 0, max(self.shown[0], 0), self.charge, self.distance, 0,
        )  # fmt: skip
        self.ledger.send("keyframes", np.array([row], np.int64))

    # ---------------------------------------------------------------- for others

    def metrics(self) -> dict[str, Any]:
        """A few counters of the moment."""
        return {
            "orders_created": 0,
            "orders_done": 0,
            "orders_open": 0,
            "oldest_open_s": 0.0,
            "stranded": int(self.stranded),
            "charging": 0,
            "queued": 0,
            "without_plan": int(self.next >= len(self.ks) and self.kind != Activity.REST and self.k == NONE),
            "deadlocks": 0,
            "epsilon": self.search.epsilon,
            "expanded": self.search.expanded,
            "known": float(self.believed.known.mean()),
        }

    def snapshot(self, ahead: float = 0.0) -> Poses:
        """Pose at a fraction of a tick (0 ≤ ahead < 1) after the present one, on the trajectory that is driven."""
        cell, h = divmod(self.state, HEADINGS)
        xy, to = self.graph.xy_m[cell].tolist(), self.after() % HEADINGS
        part = 0.0
        if self.k != NONE:
            part = min(max((self.tick + ahead - self.t0) / max(self.t1 - self.t0, 1), 0.0), 1.0)
            xy = self.world.along(cell, h, self.k, part)
        turn = (to - h + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        soc = self.sampled / self.parts.battery.capacity_mc

        def one(value: float, kind: Any = np.float32) -> NDArray[Any]:
            return np.array([value], kind)

        return Poses(
            one(xy[0]), one(xy[1]), one((h + turn * part) * 360 / HEADINGS % 360), one(soc),
            one(max(self.shown[0], 0), np.uint8), one(max(self.shown[1], 0), np.uint8), one(0, np.uint8),
            one(soc < self.scenario.charging.good, np.uint8), one(NONE, np.int32), one(cell, np.int32),
        )  # fmt: skip

    def submit(self, command: Mapping[str, Any]) -> Answer:
        """Check, log and carry out an operator's command at the present tick. Never raises for what a person said."""
        number = self.commands
        self.commands += 1
        try:
            handler, values = values_of(command, ground_commands.COMMANDS)
            reason, accepted = handler(self, **values), True
        except (BadInput, Refused) as why:
            reason, accepted = str(why), False
        text = json.dumps(command, sort_keys=True, default=str)
        self.ledger.row("commands", self.tick, number, text, int(accepted), reason)
        return Answer(accepted, reason, self.tick, number)

    def retarget(self, cell: int) -> None:
        """Another goal."""
        self.goal_cell = cell
        self.ks = np.zeros(0, np.int32)
        self.states, self.next = np.array([self.after()], np.int32), 0
        self.published = [0.0, 0.0]
        self.search.retarget(cell)
        if self.kind == Activity.REST:
            self.open(Activity.WAIT, Cause.PLANNED)

    def become(self, parts: GroundParts, *, keep_orders: bool, keep_faults: bool) -> None:
        """Go on with another planner or seed; the motion under way finishes first."""
        self.scenario = parts.scenario
        fresh = parts.believed
        if fresh.objective != self.believed.objective:
            old = self.believed
            for mine, seen in ((fresh.height, old.height), (fresh.friction, old.friction), (fresh.known, old.known)):
                mine[...] = seen
            fresh.obstacle[...], fresh.closed[...] = old.obstacle, old.closed
            fresh.fill()
            self.believed = fresh
        self.parts = parts
        self.search = parts.search_of(self.believed, self.after(), self.goal_cell)
        self.published, self.counted = [0.0, 0.0], 0
        self.say("forked", f"from here on: {parts.scenario.planner.name}, seed {parts.seed}")

    # ---------------------------------------------------------------- checkpoints

    def checkpoint(self, folder: Path) -> None:
        """Flush the log and write a checkpoint folder. Raises RunError."""
        self.flush()
        arrays: dict[str, Any] = {"parts_mj": self.parts_mj, "book": self.book, "states": self.states, "ks": self.ks}
        for name in ("height", "obstacle", "friction", "known"):
            arrays[f"believed.{name}"] = getattr(self.believed, name)
        arrays["truth.obstacle"], arrays["blocked"] = self.truth.obstacle, self.blocked
        arrays |= {f"search.{name}": array for name, array in self.search.to_memory().items()}
        plain = {
            "code": checkpoint.code_version(),
            "scenario": self.scenario.to_toml(),
            "own": {name: getattr(self, name) for name in _PLAIN},
            "shown": self.shown,
            "ledger": self.ledger.to_plain(),
        }
        checkpoint.write(folder, arrays, plain)

    def restore(self, folder: Path, plain: dict[str, Any]) -> None:
        """Bring a freshly built run of the same scenario to the checkpoint's tick. Raises RunError."""
        arrays = checkpoint.read_arrays(folder)
        try:
            for name in ("height", "obstacle", "friction", "known"):
                getattr(self.believed, name)[...] = arrays[f"believed.{name}"]
            self.truth.obstacle[...] = arrays["truth.obstacle"]
            self.parts_mj, self.book = arrays["parts_mj"], arrays["book"]
            self.states, self.ks, self.blocked = arrays["states"], arrays["ks"], arrays["blocked"]
            memory = {name[7:]: array for name, array in arrays.items() if name.startswith("search.")}
            for name, value in plain["own"].items():
                setattr(self, name, value)
            self.shown = list(plain["shown"])
        except (KeyError, ValueError) as why:
            raise RunError(f"the checkpoint {folder.name} can't be read: {why}") from why
        self.believed.close()
        self.truth.close()
        self.believed.fill()
        self.search.retarget(self.goal_cell)
        self.search.restore(memory)
        self.sink.filled[:] = 0
        self.ledger.restore(plain["ledger"])


def _thinned(states: NDArray[np.int32]) -> list[int]:
    """Cells of states, each once; of too many, every so manieth."""
    cells = np.unique(states // HEADINGS)
    return list(cells[:: -(-len(cells) // THINNED) or 1].tolist())
