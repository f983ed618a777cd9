"""RunView: everything that a page shows of a run, at any tick, computed from its log alone.

Live and replayed pages ask the same questions here. Times are ticks (fractions allowed where a pose is interpolated);
what is returned to a person is in seconds, joules and metres. Before the first tick that the log still covers, and
after the last, times are clamped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable, battery_of
from engine.results.beside import energy_beside
from engine.results.runlog import Columns, Log, latest_keyframe
from engine.results.schema import ENERGY_COLUMNS
from engine.results.thresholds import Thresholds, thresholds_at
from engine.results.timeline import Timeline, overlap_sums
from engine.scenario import Scenario, start_places
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
from engine.world.floor import World
from engine.world.poses import Poses
from engine.world.terrain import TerrainWorld

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

STATE_WORDS: dict[int, str] = {s: s.name.lower().replace("_", " ") for s in VehicleState}
TASK_WORDS: dict[int, str] = {
    Task.NONE: "",
    Task.TO_PICK: "to pick up",
    Task.TO_DROP: "to deliver",
    Task.TO_REST: "to rest",
    Task.TO_CHARGER: "to charge",
    Task.SENT: "sent",
}
ORDER_WORDS: dict[int, str] = {s: s.name.lower() for s in OrderState}
CAUSE_WORDS: dict[int, str] = {c: c.name.lower().replace("_", " ") for c in Cause}

ACTIVITIES: tuple[str, ...] = ("moving", "waiting", "loading", "charging", "idle", "fault")
"""What a fleet's time is divided into. A paused vehicle counts as waiting."""

HEATS: tuple[str, ...] = ("occupancy", "waiting", "energy", "expected")
"""Kinds of heat map."""

_GROUP_OF: dict[int, int] = {
    Activity.WAIT: 1,
    Activity.PICK: 2,
    Activity.DROP: 2,
    Activity.CHARGE: 3,
    Activity.REST: 4,
    Activity.FAULT: 5,
    Activity.PAUSE: 1,
}
GROUP = np.array([_GROUP_OF.get(kind, 0) for kind in range(128)], np.int64)
"""Index into ACTIVITIES by `motions.kind`."""

_STATE_OF_GROUP = np.array(
    [
        VehicleState.MOVING,
        VehicleState.WAITING,
        VehicleState.LOADING,
        VehicleState.CHARGING,
        VehicleState.IDLE,
        VehicleState.FAULT,
    ],
    np.uint8,
)
_DRAWN = [c for c in Component if c not in (Component.CHARGED, Component.CHARGER_LOSS)]
# chargers.state
BOOKED, CONNECTED, RELEASED, OUT, BACK, QUEUED = range(6)


@dataclass(frozen=True, slots=True)
class _Now:
    """The interval that every vehicle is in at one time; arrays per vehicle."""

    position: NDArray[np.int64]  # of its ended interval in the timeline, or -1
    open: NDArray[np.bool_]  # it is the keyframe's open one
    known: NDArray[np.bool_]
    col: dict[str, NDArray[np.int64]]
    share: F64  # of the interval that has passed, 0…1


class RunView:
    """Answers about a run.

    reader: a LogReader or MemoryLog · scenario, world: what the run was built from · beside: costs of the scenario's
    second demand model, shown as information.
    """

    def __init__(self, reader: Log, scenario: Scenario, world: World, beside: CostTable | None = None) -> None:
        self.reader, self.scenario, self.world, self.beside = reader, scenario, world, beside
        self.tick_s = float(scenario.time.tick_s)
        self.capacity_mc = battery_of(**scenario.battery.asked).capacity_mc
        self.n = int(scenario.fleet.count)
        self.t_end = 0
        self._start = np.asarray(start_places(scenario, world), np.int64)
        self._heading = np.asarray(world.graph.heading_deg, np.float64)
        self._xy = np.asarray(world.graph.xy_m, np.float64)
        self._kind_ticks = np.asarray(world.graph.kind_ticks, np.int64)
        self._kind_mm = np.asarray(world.graph.kind_mm, np.int64)
        self._cache: dict[str, tuple[int, Any]] = {}
        self._reset()
        self._sync()

    def refresh(self) -> bool:
        """Read what was appended to the log since; True when there was anything."""
        changed = self.reader.refresh()
        if changed:
            self._sync()
        return changed

    def _reset(self) -> None:
        self._generation = self.reader.generation
        self._motions, self._states, self._battery, self._plans = Timeline(), Timeline(), Timeline(), Timeline()
        self._cache.clear()

    def _sync(self) -> None:
        tables = {name: self.reader.table(name) for name in ("motions", "states", "battery", "plans")}
        if self.reader.generation != self._generation:
            self._reset()
            tables = {name: self.reader.table(name) for name in tables}
        m = tables["motions"]
        self._motions.extend(m["vehicle"], m["t0"])
        for name, line in (("states", self._states), ("battery", self._battery), ("plans", self._plans)):
            line.extend(tables[name]["vehicle"], tables[name]["tick"])
        self._m, self._s, self._b, self._p = m, tables["states"], tables["battery"], tables["plans"]
        self._open = self._open_rows(latest_keyframe(self.reader))
        last = int(m["t1"][-1]) if len(m["t1"]) else 0
        self.first_tick = self.reader.first_tick
        self.t_end = max(last, self._open_tick)
        if self._motions.n:
            self.n = max(self.n, int(self._motions.key[-1] >> 32) + 1)
        self._cache.clear()

    def _open_rows(self, frame: Columns) -> dict[str, NDArray[np.int64]]:
        """The newest keyframe by vehicle; `known` tells where it has a row."""
        vehicle = np.asarray(frame["vehicle"], np.int64)
        self._open_tick = int(frame["tick"][-1]) if len(vehicle) else 0
        n = max(self.n, int(vehicle.max()) + 1 if len(vehicle) else 0)
        self.n = n
        out: dict[str, NDArray[np.int64]] = {}
        for name, values in frame.items():
            column = np.full(n, NONE, np.int64)
            column[vehicle] = values
            out[name] = column
        out["known"] = np.zeros(n, np.int64)
        out["known"][vehicle] = 1
        return out

    def _clamp(self, time: float) -> float:
        return float(min(max(time, self.first_tick), max(self.t_end, self.first_tick)))

    # -- where everybody is

    def _now(self, time: float) -> _Now:
        n, o = self.n, self._open
        at = self._motions.position(np.arange(n), time)
        at = np.where(at < 0, self._motions.first(np.arange(n)), at)
        row = self._motions.row[at] if self._motions.n else np.zeros(n, np.int64)
        ended = at >= 0
        names = ("kind", "cause", "blocker", "t0", "t1", "from_place", "to_place", "from_heading", "to_heading")
        col: dict[str, NDArray[np.int64]] = {}
        for name in (*names, "loaded", "order", "task"):
            col[name] = np.where(ended, self._m[name][row], NONE) if self._motions.n else np.full(n, NONE, np.int64)
        known = o["known"] == 1
        usable = known & (~ended | ((time >= col["t1"]) & (o["t0"] >= col["t1"]) & (o["t0"] <= time)))
        for name, values in col.items():
            col[name] = np.where(usable, o[name], values)
        moving = col["kind"] >= PRIMITIVE_0
        # an open motion's end: as foreseen, else by its primitive; an open stay lasts until now
        index = np.clip(col["kind"] - PRIMITIVE_0, 0, len(self._kind_ticks) - 1)
        foreseen = np.where(
            (col["t1"] > col["t0"]) & (col["t1"] < FOREVER), col["t1"], col["t0"] + self._kind_ticks[index]
        )
        col["t1"] = np.where(usable, np.where(moving, foreseen, FOREVER), col["t1"])
        found = ended | usable
        if not found.all():
            first = np.resize(self._start, n) if len(self._start) else np.zeros(n, np.int64)
            for name, fill in (("from_place", first), ("to_place", first), ("kind", np.full(n, int(Activity.REST)))):
                col[name] = np.where(found, col[name], fill)
            for name in ("from_heading", "to_heading", "loaded", "task", "t0", "t1", "cause"):
                col[name] = np.where(found, col[name], 0)
        share = np.clip((time - col["t0"]) / np.maximum(col["t1"] - col["t0"], 1), 0.0, 1.0)
        return _Now(np.where(ended, at, -1), usable, found, col, share)

    def poses(self, time: float) -> Poses:
        """The fleet at a time in ticks; positions are interpolated inside motions, headings along the shorter arc."""
        time = self._clamp(time)
        now = self._now(time)
        c = now.col
        moving = c["kind"] >= PRIMITIVE_0
        share = np.where(moving, now.share, 0.0)
        start, end = self._xy[c["from_place"]], self._xy[c["to_place"]]
        xy = start + (end - start) * share[:, None]
        if isinstance(self.world, TerrainWorld):
            self._along(self.world, xy, c, share)
        h0, h1 = self._heading[c["from_heading"]], self._heading[c["to_heading"]]
        heading = (h0 + ((h1 - h0 + 180.0) % 360.0 - 180.0) * share) % 360.0
        soc = self._soc_at(np.arange(self.n), time)
        state = self._state_at(time, now)
        arrived = moving & (now.share >= 1.0)
        return Poses(
            x_m=xy[:, 0].astype(np.float32),
            y_m=xy[:, 1].astype(np.float32),
            heading_deg=heading.astype(np.float32),
            soc=soc.astype(np.float32),
            state=state,
            task=self._task_at(time, now),
            loaded=(c["loaded"] > 0).astype(np.uint8),
            low=(soc < self.thresholds(time).good).astype(np.uint8),
            order=self._order_at(time, now).astype(np.int32),
            place=np.where(arrived, c["to_place"], c["from_place"]).astype(np.int32),
        )

    def _along(self, world: TerrainWorld, xy: F64, c: dict[str, NDArray[np.int64]], share: F64) -> None:
        """Move positions from the chord to the trajectory that is driven."""
        for v in np.flatnonzero(c["kind"] >= PRIMITIVE_0).tolist():
            place, heading = int(c["from_place"][v]), int(c["from_heading"][v])
            kind = int(c["kind"][v] - PRIMITIVE_0)
            k = world.trajectory(place, heading, int(c["to_place"][v]), int(c["to_heading"][v]), kind)
            if k != NONE:
                xy[v] = world.along(place, heading, k, float(share[v]))

    def _state_at(self, time: float, now: _Now) -> NDArray[np.uint8]:
        state = _STATE_OF_GROUP[GROUP[np.clip(now.col["kind"], 0, 127)]]
        state[now.col["kind"] == Activity.PAUSE] = VehicleState.PAUSED
        if time <= 0:
            return np.zeros(self.n, np.uint8)
        row = self._state_rows(time)
        if self._states.n:
            state = np.where(row >= 0, self._s["state"][row], state).astype(np.uint8)
        return state

    def _task_at(self, time: float, now: _Now) -> NDArray[np.uint8]:
        """The Task of every vehicle's plan, as a live frame shows it."""
        if time <= 0:
            return np.zeros(self.n, np.uint8)
        task, row = now.col["task"], self._state_rows(time)
        if self._states.n:
            task = np.where(row >= 0, self._s["task"][row], task)
        return np.maximum(task, 0).astype(np.uint8)

    def _order_at(self, time: float, now: _Now) -> NDArray[np.int64]:
        """The order that every vehicle serves: an interval is labelled when it ends, a state when it begins."""
        row = self._row_at(self._states, time)
        if not self._states.n:
            return now.col["order"]
        return np.where((row < 0) | (now.open & (time >= self._open_tick)), now.col["order"], self._s["order"][row])

    def _state_rows(self, time: float) -> NDArray[np.int64]:
        """Row of the states table for every vehicle, or -1: the state until a time, as a live frame shows it then."""
        return self._row_at(self._states, np.ceil(time) - 1)

    def _row_at(self, line: Timeline, time: float) -> NDArray[np.int64]:
        """Row of a table for every vehicle at a time, or -1."""
        at = line.position(np.arange(self.n), time)
        return np.where(at >= 0, line.row[at], -1) if line.n else at

    def _soc_at(self, vehicles: NDArray[Any], time: Any) -> F64:
        """State of charge of the latest sample; arguments broadcast. NaN where none is known."""
        charge = np.full(np.broadcast(vehicles, time).shape, np.nan)
        if self._battery.n:
            at = self._battery.position(vehicles, time)
            at = np.where(at < 0, self._battery.first(np.broadcast_to(vehicles, at.shape)), at)
            charge = np.where(at >= 0, self._b["charge_mc"][self._battery.row[at]], np.nan)
        return np.clip(charge / self.capacity_mc, 0.0, 1.0)

    def thresholds(self, time: float) -> Thresholds:
        """Charge levels in force: the scenario's, or an operator's latest."""
        return thresholds_at(self.scenario, self.reader.table("commands"), time)

    # -- fleet

    def fleet(self, time: float) -> list[dict[str, Any]]:
        """One record per vehicle: what it does, for which order, why it waits, its charge, and its totals so far.

        soc in [0, 1] or None · energy_j drawn, charging left out · waiting_s all its waiting so far · since_s start of
        its present state · low, critical: below the levels of the same names (low: `good`).
        """
        time = self._clamp(time)
        poses, now = self.poses(time), self._now(time)
        levels = self.thresholds(time)
        sums = self._sums(time, now)
        row = self._state_rows(time)
        energy, voltage = self._energy_at(time)
        done = self._orders_done(time)
        records = []
        for v in range(self.n):
            known = row[v] >= 0
            state = int(poses.state[v])
            task = int(self._s["task"][row[v]]) if known else int(now.col["task"][v])
            order = int(self._s["order"][row[v]]) if known else int(now.col["order"][v])
            soc = float(poses.soc[v])
            records.append(
                {
                    "vehicle": v,
                    "name": f"AGV {v}",
                    "state": STATE_WORDS[state],
                    "task": TASK_WORDS.get(task, ""),
                    "order": order if order >= 0 else None,
                    "place": int(poses.place[v]),
                    "place_name": self.world.place_name(int(poses.place[v])),
                    "x": float(poses.x_m[v]),
                    "y": float(poses.y_m[v]),
                    "heading_deg": float(poses.heading_deg[v]),
                    "loaded": bool(poses.loaded[v]),
                    "soc": None if np.isnan(soc) else soc,
                    "low": bool(poses.low[v]),
                    "critical": bool(soc < levels.critical),
                    "voltage_v": float(voltage[v]),
                    "energy_j": float(energy[v]),
                    "distance_m": float(sums["mm"][v]) / 1000.0,
                    "orders_done": int(done[v]),
                    "waiting_s": float(sums["waiting"][v]) * self.tick_s,
                    "since_s": float(self._s["tick"][row[v]] if known else now.col["t0"][v]) * self.tick_s,
                    "why": self._why(v, time, state, row[v], now),
                }
            )
        return records

    def _why(self, v: int, time: float, state: int, row: int, now: _Now) -> str:
        """A sentence for a vehicle that does not get on; empty for one that does."""
        if state == VehicleState.FAULT:
            return "is broken down"
        if state == VehicleState.PAUSED:
            return "is paused by the operator"
        if state != VehicleState.WAITING:
            return ""
        cause = int(self._s["cause"][row] if row >= 0 else now.col["cause"][v])
        blocker = int(self._s["blocker"][row] if row >= 0 else now.col["blocker"][v])
        if cause in (Cause.VEHICLE, Cause.BLOCKED):
            ahead = self._remaining(v, time, now)[0][1:2]
            where = self.world.place_name(int(ahead[0])) if len(ahead) else ""
            if cause == Cause.BLOCKED:
                return f"waits because {where or 'the place ahead'} is blocked"
            who = f"vehicle {blocker}" if blocker >= 0 else "another vehicle"
            return f"waits for {who} to leave {where}" if where else f"waits for {who}"
        return {
            int(Cause.PLANNED): "waits as planned, to let others pass",
            int(Cause.DELAY): "is held up by a delay",
            int(Cause.NO_PLAN): "waits for a plan",
            int(Cause.CHARGER_QUEUE): "waits for a free charger",
            int(Cause.OPERATOR): "is held by the operator",
            int(Cause.EMPTY): "has too little charge for its next motion",
        }.get(cause, "waits")

    def _cumulative(self) -> dict[str, NDArray[np.int64]]:
        """Running sums over the ended intervals in the timeline's order, one entry longer."""

        def build() -> dict[str, NDArray[np.int64]]:
            # by kind from small tables, then one gather each: a million rows in a few hundredths of a second
            kind = self._m["kind"]
            mm_of_kind, waits = np.zeros(128, np.int32), np.zeros(128, np.int32)
            mm_of_kind[PRIMITIVE_0 : PRIMITIVE_0 + len(self._kind_mm)] = self._kind_mm
            waits[[Activity.WAIT, Activity.PAUSE]] = 1
            parts = {
                "mm": mm_of_kind[kind],
                "waiting": (self._m["t1"] - self._m["t0"]) * waits[kind],
                "moves": (self._m["from_place"] != self._m["to_place"]).astype(np.int32),
            }
            sums = {}
            for name, values in parts.items():
                sums[name] = np.zeros(len(kind) + 1, np.int64)
                np.cumsum(values[self._motions.row], out=sums[name][1:])
            return sums

        return self._cached("cumulative", build)  # type: ignore[no-any-return]

    def _sums(self, time: float, now: _Now) -> dict[str, F64]:
        """Distance in mm and waiting in ticks of every vehicle up to a time, the running interval in part."""
        cum = self._cumulative()
        first = self._motions.first(np.arange(self.n))
        kind = now.col["kind"]
        # intervals that ended; the one that time is in is added in part
        upto = np.where(now.open, now.position + 1, now.position)
        base_mm = np.zeros(self.n)
        frames = self.reader.table("keyframes")
        if self.first_tick > 0 and len(frames["tick"]):
            head = frames["tick"] == frames["tick"][0]
            base_mm[frames["vehicle"][head]] = frames["distance_mm"][head]
        out: dict[str, F64] = {}
        for name in ("mm", "waiting"):
            c = cum[name]
            out[name] = np.where(first >= 0, c[np.maximum(upto, 0)] - c[np.maximum(first, 0)], 0).astype(np.float64)
        moving = kind >= PRIMITIVE_0
        mm = self._kind_mm[np.clip(kind - PRIMITIVE_0, 0, len(self._kind_mm) - 1)]
        out["mm"] += base_mm + np.where(moving, mm * now.share, 0.0)
        waits = (kind == Activity.WAIT) | (kind == Activity.PAUSE)
        passed = np.clip(np.minimum(time, now.col["t1"]) - now.col["t0"], 0, None)
        out["waiting"] += np.where(waits, passed, 0.0)
        return out

    def _energy_at(self, time: float) -> tuple[F64, F64]:
        """Energy drawn by every vehicle in J and its voltage in V, of the latest sample."""
        row = self._row_at(self._battery, time)
        if not self._battery.n:
            return np.zeros(self.n), np.full(self.n, float(self.scenario.battery.voltage_v))
        drawn = sum(self._b[ENERGY_COLUMNS[c]][row].astype(np.float64) for c in _DRAWN)
        return np.where(row >= 0, drawn, 0.0) / 1000.0, self._b["voltage_mv"][row] / 1000.0

    def power(self, time: float, window_s: float = 60.0) -> F64:
        """Mean power of every vehicle at its battery over the latest window, in W; negative while it charges.

        Samples are `log.sample_s` apart, and the window reaches from one to another; NaN where there are not two.
        """
        time = self._clamp(time)
        if not self._battery.n:
            return np.full(self.n, np.nan)
        last, first = self._row_at(self._battery, time), self._row_at(self._battery, time - window_s / self.tick_s)
        first = np.where(first >= 0, first, self._battery.row[self._battery.first(np.arange(self.n))])
        seconds = (self._b["tick"][last].astype(np.int64) - self._b["tick"][first]) * self.tick_s
        joules = sum((self._b[name][last] - self._b[name][first]) / 1000.0 for name in ENERGY_COLUMNS)
        return np.where((last >= 0) & (seconds > 0), joules / np.maximum(seconds, self.tick_s), np.nan)

    def _orders_done(self, time: float) -> NDArray[np.int64]:
        o = self.reader.table("orders")
        k = int(np.searchsorted(o["tick"], time, side="right"))
        done = (o["state"][:k] == OrderState.DONE) & (o["vehicle"][:k] >= 0)
        return np.bincount(o["vehicle"][:k][done], minlength=self.n)

    # -- orders, chargers, events

    def _orders_at(self, time: float) -> dict[str, NDArray[np.int64]]:
        """Arrays per order known at a time: state, vehicle, stations, and the tick of each step (-1 not yet)."""
        o = self.reader.table("orders")
        k = int(np.searchsorted(o["tick"], time, side="right"))
        number = o["order"][:k].astype(np.int64)
        n = int(number.max()) + 1 if k else 0
        state, vehicle = o["state"][:k].astype(np.int64), o["vehicle"][:k].astype(np.int64)
        out = {
            name: np.full(n, NONE, np.int64) for name in ("state", "vehicle", "from_station", "to_station", "source")
        }
        out["state"][number], out["vehicle"][number] = state, vehicle  # the last row of an order wins
        for name in ("from_station", "to_station", "source"):
            out[name][number] = o[name][:k]
        tick = o["tick"][:k].astype(np.int64)
        # an order that was given back opens again: created keeps the first tick, the others the last
        opened = np.nonzero(state == OrderState.OPEN)[0][::-1]
        out["created"] = np.full(n, NONE, np.int64)
        out["created"][number[opened]] = tick[opened]
        for name, word in (("assigned", OrderState.ASSIGNED), ("picked", OrderState.PICKED), ("done", OrderState.DONE)):
            out[name] = np.full(n, NONE, np.int64)
            rows = state == word
            out[name][number[rows]] = tick[rows]
        out["ended"] = np.full(n, NONE, np.int64)
        ended = (state == OrderState.DONE) | (state == OrderState.WITHDRAWN)
        out["ended"][number[ended]] = tick[ended]
        out["assigned"][out["state"] == OrderState.OPEN] = NONE
        return out

    def orders(self, time: float, limit: int = 200) -> list[dict[str, Any]]:
        """Orders known at a time: those not yet done first, then the newest first. Steps not yet taken are None.

        age_s: since it was created, until now or until it was done or withdrawn.
        """
        time = self._clamp(time)
        a = self._orders_at(time)
        exists = np.nonzero(a["state"] >= 0)[0]
        closed = a["ended"][exists] >= 0
        chosen = exists[np.lexsort((-exists, closed))][:limit]

        def seconds(tick: int) -> float | None:
            return tick * self.tick_s if tick >= 0 else None

        return [
            {
                "order": n,
                "state": ORDER_WORDS[int(a["state"][n])],
                "vehicle": int(a["vehicle"][n]) if a["vehicle"][n] >= 0 else None,
                "from_station": int(a["from_station"][n]),
                "to_station": int(a["to_station"][n]),
                "from_name": self._station_name(int(a["from_station"][n])),
                "to_name": self._station_name(int(a["to_station"][n])),
                "source": "operator" if a["source"][n] == 1 else "scenario",
                "created_s": seconds(int(a["created"][n])),
                "assigned_s": seconds(int(a["assigned"][n])),
                "picked_s": seconds(int(a["picked"][n])),
                "done_s": seconds(int(a["done"][n])),
                "age_s": float((a["ended"][n] if a["ended"][n] >= 0 else time) - a["created"][n]) * self.tick_s,
            }
            for n in chosen.tolist()
        ]

    def _station_name(self, number: int) -> str:
        return self.world.stations[number - 1].name if 1 <= number <= len(self.world.stations) else ""

    def chargers(self, time: float) -> list[dict[str, Any]]:
        """One record per charger: free, booked, charging, occupied or out of order, by whom and since when.

        queue: vehicles that wait for it (or, under charger None, for any) · bookings: vehicles on their way to it.
        """
        time = self._clamp(time)
        c = self.reader.table("chargers")
        k = int(np.searchsorted(c["tick"], time, side="right"))
        charger, vehicle, state = (c[name][:k].astype(np.int64) for name in ("charger", "vehicle", "state"))
        n = len(self.world.chargers)
        last_of_vehicle = np.full(self.n, -1, np.int64)
        about = np.nonzero((vehicle >= 0) & (vehicle < self.n) & ~np.isin(state, (OUT, BACK)))[0]
        last_of_vehicle[vehicle[about]] = about
        out = np.full(n, -1, np.int64)
        turned = np.nonzero(np.isin(state, (OUT, BACK)) & (charger >= 0) & (charger < n))[0]
        out[charger[turned]] = turned
        by: dict[tuple[int, int], list[int]] = {}
        for row in sorted(int(r) for r in last_of_vehicle if r >= 0):
            by.setdefault((int(charger[row]), int(state[row])), []).append(row)
        poses = self.poses(time)
        stands = self._now(time).col["kind"] < PRIMITIVE_0
        guest = {int(p): v for v, p in enumerate(poses.place) if stands[v]}

        def vehicles(i: int, word: int) -> list[int]:
            return [int(vehicle[r]) for r in by.get((i, word), [])]

        records: list[dict[str, Any]] = []
        for i in range(n):
            connected = by.get((i, CONNECTED), [])
            booked = by.get((i, BOOKED), [])
            broken = out[i] >= 0 and state[out[i]] == OUT
            row = int(out[i]) if broken else connected[-1] if connected else booked[0] if booked else -1
            here = guest.get(int(self.world.chargers[i]))  # one that stands there from the start was never connected
            charging = here is not None and poses.state[here] == VehicleState.CHARGING
            word = "out of order" if broken else "charging" if charging else "occupied" if here is not None else ""
            records.append(
                {
                    "charger": i,
                    "name": f"C{i + 1}",
                    "place": int(self.world.chargers[i]),
                    "state": word or ("booked" if booked else "free"),
                    "vehicle": here,
                    "since_s": float(c["tick"][row]) * self.tick_s if row >= 0 else None,
                    "queue": vehicles(i, QUEUED),
                    "bookings": vehicles(i, BOOKED),
                }
            )
        return records

    def events(self, t0: float, t1: float, limit: int = 200) -> list[dict[str, Any]]:
        """The newest `limit` events in [t0, t1], newest first. level: 0 information, 1 warning, 2 error."""
        e = self.reader.table("events")
        first = int(np.searchsorted(e["tick"], t0, side="left"))
        last = int(np.searchsorted(e["tick"], t1, side="right"))
        return [
            {
                "tick": int(e["tick"][i]),
                "time_s": int(e["tick"][i]) * self.tick_s,
                "kind": str(e["kind"][i]),
                "level": int(e["level"][i]),
                "vehicle": int(e["vehicle"][i]) if e["vehicle"][i] >= 0 else None,
                "order": int(e["order"][i]) if e["order"][i] >= 0 else None,
                "place": int(e["place"][i]) if e["place"][i] >= 0 else None,
                "text": str(e["text"][i]),
            }
            for i in range(last - 1, max(first, last - limit) - 1, -1)
        ]

    # -- routes and reservations

    def routes(self, time: float) -> list[dict[str, Any]]:
        """What is left of every vehicle's plan: places from the present one, with the planned ticks t_in and t_out.

        held: so many of these places the vehicle has or may enter without waiting for anybody: no other vehicle is
        there, and none has reserved them for earlier.
        """
        time = self._clamp(time)
        now = self._now(time)
        found, claims = [], []
        for v in range(self.n):
            places, t_in, t_out = self._remaining(v, time, now)
            if len(places) > 1:
                found.append({"vehicle": v, "places": places.tolist(), "t_in": t_in.tolist(), "t_out": t_out.tolist()})
                claims.append((v, places, np.concatenate([[-1], t_in[1:]])))
        for record, first in zip(found, self._first_in_line(claims, now), strict=True):
            record["held"] = len(first) if first.all() else int(np.argmin(first))
        return found

    def _first_in_line(self, claims: list[tuple[int, Any, Any]], now: _Now) -> list[NDArray[np.bool_]]:
        """For every (vehicle, places, ticks): whether nobody else has, or has reserved for earlier, each place."""
        if not claims:
            return []
        planned = np.array([v for v, _, _ in claims])
        others = np.setdiff1d(np.arange(self.n), planned)  # without a way left: each has the place it is in
        lengths = [len(places) for _, places, _ in claims]
        here = np.where(now.share < 1.0, now.col["from_place"], now.col["to_place"])
        place = np.concatenate([*(places for _, places, _ in claims), here[others], now.col["to_place"][others]])
        owner = np.concatenate([np.repeat(planned, lengths), others, others])
        tick = np.concatenate([*(ticks for _, _, ticks in claims), np.full(2 * len(others), -1)])
        line = np.lexsort((tick, place))
        begins = np.diff(place[line], prepend=-1) != 0
        queue = np.cumsum(begins) - 1
        stranger = owner[line] != owner[line][begins][queue]
        seen = np.cumsum(stranger)
        first = np.empty(len(line), np.bool_)
        first[line] = seen == (seen - stranger)[begins][queue]
        return np.split(first[: sum(lengths)], np.cumsum(lengths)[:-1])

    def _remaining(self, v: int, time: float, now: _Now) -> tuple[Any, Any, Any]:
        """Places of a vehicle's plan from its present place on, and their planned ticks."""
        empty = np.zeros(0, np.int64)
        at = int(self._plans.position(np.array([v]), time)[0])
        if at < 0:
            return empty, empty, empty
        row = int(self._plans.row[at])
        values, offsets = self._p["places"]
        a, b = int(offsets[row]), int(offsets[row + 1])
        places, t_in, t_out = values[a:b], self._p["t_in"][0][a:b], self._p["t_out"][0][a:b]
        if b == a:
            return empty, empty, empty
        c = now.col
        running = c["kind"][v] >= PRIMITIVE_0 and now.share[v] < 1.0
        present = int(c["from_place"][v] if running else c["to_place"][v])
        # how many places it has left since the plan; the nearest visit of the present place is meant
        moves = self._cumulative()["moves"]
        begun = int(self._motions.position(np.array([v]), float(self._p["tick"][row]) - 1)[0]) + 1
        first = int(self._motions.first(np.array([v]))[0])
        upto = int(now.position[v]) + int(now.open[v] or not running)
        passed = int(moves[max(upto, 0)] - moves[max(begun, first, 0)]) if first >= 0 else 0
        visits = np.nonzero(places == present)[0]
        if len(visits) == 0:
            return (
                np.concatenate([[present], places]),
                np.concatenate([[int(time)], t_in]),
                np.concatenate([t_in[:1], t_out]),
            )
        i = int(visits[np.argmin(np.abs(visits - passed))])
        return places[i:], t_in[i:], t_out[i:]

    def reservations(self, t0: float, t1: float) -> dict[str, NDArray[np.int64]]:
        """Reserved places in [t0, t1] as arrays place, t0, t1, vehicle; a plan counts until the vehicle's next one."""
        line = self._plans
        none = np.zeros(0, np.int64)
        if line.n == 0:
            return {"place": none, "t0": none, "t1": none, "vehicle": none}
        until = np.full(line.n, FOREVER, np.int64)
        same = line.vehicle[1:] == line.vehicle[:-1]
        until[:-1][same] = line.tick[1:][same]
        keep = (line.tick <= t1) & (until > t0)
        row, cut = line.row[keep], until[keep]
        values, offsets = self._p["places"]
        counts = np.diff(offsets)[row]
        owner = np.repeat(np.arange(len(row)), counts)
        flat = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts) + offsets[row][owner]
        begin = np.maximum(self._p["t_in"][0][flat].astype(np.int64), self._p["tick"][row].astype(np.int64)[owner])
        end = np.minimum(self._p["t_out"][0][flat].astype(np.int64), cut[owner])
        inside = (begin < end) & (end > t0) & (begin < t1)
        return {
            "place": values[flat][inside].astype(np.int64),
            "t0": begin[inside],
            "t1": np.minimum(end[inside], int(np.ceil(t1))),
            "vehicle": self._p["vehicle"][row].astype(np.int64)[owner][inside],
        }

    # -- numbers and curves

    def kpis(self, time: float) -> dict[str, Any]:
        """Headline numbers at a time. Rates and shares are over the last hour (or since the start, when shorter)."""
        time = self._clamp(time)
        a = self._orders_at(time)
        span = max(min(time - self.first_tick, 3600.0 / self.tick_s), 1.0)
        since = time - span
        done = (a["state"] == OrderState.DONE) & (a["created"] >= 0)
        recent = done & (a["done"] > since)
        took = (a["done"] - a["created"])[recent] * self.tick_s
        waiting = (a["state"] >= 0) & (a["ended"] < 0)
        unserved = waiting & (a["state"] < OrderState.PICKED)
        shares = {name: float(values[0]) for name, values in self.occupancy(since, time, 1).items() if name != "t_s"}
        poses = self.poses(time)
        energy, _ = self._energy_at(time)
        plans = self._plan_times(since, time)
        hours = span * self.tick_s / 3600.0
        return {
            "time_s": time * self.tick_s,
            "orders_created": int((a["state"] >= 0).sum()),
            "orders_done": int(done.sum()),
            "orders_open": int(waiting.sum()),
            "oldest_open_s": float((time - a["created"][unserved].min()) * self.tick_s) if unserved.any() else 0.0,
            "throughput_per_h": float(recent.sum()) / hours,
            "order_time_mean_s": float(took.mean()) if len(took) else None,
            "order_time_p95_s": float(np.percentile(took, 95)) if len(took) else None,
            "utilisation": shares["moving"] + shares["waiting"] + shares["loading"],
            "waiting_share": shares["waiting"],
            "charging_share": shares["charging"],
            "energy_j": float(energy.sum()),
            "energy_per_order_j": float(energy.sum()) / int(done.sum()) if done.any() else None,
            "beside_j": self._beside(time),
            "soc_mean": float(np.nanmean(poses.soc)) if not np.isnan(poses.soc).all() else None,
            "soc_min": float(np.nanmin(poses.soc)) if not np.isnan(poses.soc).all() else None,
            "stranded": int((poses.soc <= 0).sum()),
            "vehicles": self.n,
            **{
                f"vehicles_{word}": int((poses.state == state).sum())
                for word, state in (
                    ("moving", VehicleState.MOVING),
                    ("waiting", VehicleState.WAITING),
                    ("charging", VehicleState.CHARGING),
                    ("idle", VehicleState.IDLE),
                    ("fault", VehicleState.FAULT),
                )
            },
            "planner_p50_ms": float(np.percentile(plans, 50)) / 1000.0 if len(plans) else None,
            "planner_p95_ms": float(np.percentile(plans, 95)) / 1000.0 if len(plans) else None,
        }

    def _beside(self, time: float) -> dict[str, Any] | None:
        """The second demand model's name and energy in J, or None when the scenario has none."""
        if self.beside is None:
            return None
        parts = energy_beside(self.reader, self.beside, self.n, time)
        return {"model": self.scenario.energy.beside, "energy_j": sum(parts.values()), "components": parts}

    def _plan_times(self, t0: float, t1: float) -> NDArray[Any]:
        tick = self._p["tick"]
        a, b = np.searchsorted(tick, t0, side="left"), np.searchsorted(tick, t1, side="right")
        return np.asarray(self._p["cpu_us"][int(a) : int(b)])

    def soc(self, t0: float, t1: float, points: int = 300, vehicles: Sequence[int] | None = None) -> dict[str, Any]:
        """State of charge over time: t_s (m,), soc (n, m) in [0, 1], vehicles (n)."""
        chosen = list(range(self.n)) if vehicles is None else [v for v in vehicles if 0 <= v < self.n]
        times = self._grid(t0, t1, points)
        soc = self._soc_at(np.asarray(chosen, np.int64)[:, None], times[None, :])
        return {"t_s": times * self.tick_s, "soc": soc, "vehicles": chosen}

    def energy(self, t0: float, t1: float, points: int = 300) -> dict[str, Any]:
        """Energy of the fleet in J since the start, by component: t_s (m,), components {name: (m,)}; zeros left out."""
        times = self._grid(t0, t1, points)
        at = self._battery.position(np.arange(self.n)[:, None], times[None, :])
        components: dict[str, F64] = {}
        for name, column in zip(COMPONENTS, ENERGY_COLUMNS, strict=True):
            values = self._b[column]
            if self._battery.n and values.any():
                known = np.where(at >= 0, values[self._battery.row[at]], 0)
                components[name] = known.sum(0) / 1000.0
        return {"t_s": times * self.tick_s, "components": components}

    def occupancy(self, t0: float, t1: float, points: int = 300) -> dict[str, Any]:
        """Shares of the fleet's time by activity in equal slices of [t0, t1]: t_s (m,) their ends, and (m,) each."""
        t0, t1 = self._clamp(t0), self._clamp(t1)
        edges = np.linspace(t0, max(t1, t0 + 1e-9), points + 1)
        c = self._overlapping(t0, t1)
        sums = overlap_sums(edges, c["t0"], c["t1"], GROUP[c["kind"]], len(ACTIVITIES))
        total = np.maximum(sums.sum(1), 1e-12)
        shares = {name: sums[:, i] / total for i, name in enumerate(ACTIVITIES)}
        return {"t_s": edges[1:] * self.tick_s, **shares}

    def throughput(self, t0: float, t1: float, window_s: float = 3600.0, points: int = 300) -> dict[str, Any]:
        """Orders done per hour over a moving window, and orders open: t_s, per_h, open (m,)."""
        times = self._grid(t0, t1, points)
        a = self._orders_at(self.t_end)
        done = np.sort(a["done"][a["done"] >= 0])
        created = np.sort(a["created"][a["created"] >= 0])
        ended = np.sort(a["ended"][a["ended"] >= 0])
        window = np.minimum(window_s / self.tick_s, np.maximum(times, 1.0))
        count = np.searchsorted(done, times, side="right") - np.searchsorted(done, times - window, side="right")
        is_open = np.searchsorted(created, times, side="right") - np.searchsorted(ended, times, side="right")
        return {"t_s": times * self.tick_s, "per_h": count * 3600.0 / (window * self.tick_s), "open": is_open}

    def progress(self, times: Sequence[float] | NDArray[Any]) -> dict[str, Any]:
        """What the fleet has come to by each time, (m,) each: orders_done, energy_j drawn, waiting_s of all vehicles.

        Energy is that of the latest sample, `log.sample_s` apart; a paused vehicle waits.
        """
        times = np.clip(np.asarray(times, np.float64), self.first_tick, max(self.t_end, self.first_tick))
        done, drawn, begun, ended = self._cached("progress", self._progress)
        at = self._battery.position(np.arange(self.n)[:, None], times[None, :])
        known = np.where(at >= 0, drawn[self._battery.row[at]], 0).sum(0) if self._battery.n else np.zeros(len(times))
        waited = _passed(begun, times) - _passed(ended, times)
        return {
            "orders_done": np.searchsorted(done, times, side="right"),
            "energy_j": known / 1000.0,
            "waiting_s": waited * self.tick_s,
        }

    def _progress(self) -> tuple[NDArray[np.int64], ...]:
        """Ticks at which an order was done, mJ drawn by battery row, ticks at which a waiting begins, and ends."""
        orders = self._orders_at(self.t_end)["done"]
        drawn = np.asarray(sum(self._b[ENERGY_COLUMNS[c]].astype(np.int64) for c in _DRAWN))
        c = self._overlapping(self.first_tick, self.t_end)
        waits = (c["kind"] == Activity.WAIT) | (c["kind"] == Activity.PAUSE)
        return np.sort(orders[orders >= 0]), drawn, np.sort(c["t0"][waits]), np.sort(c["t1"][waits])

    def bands(self, t0: float, t1: float, vehicles: Sequence[int] | None = None) -> list[tuple[int, float, float, int]]:
        """States of every vehicle in [t0, t1] as (vehicle, t0, t1, VehicleState), equal neighbours merged."""
        t0, t1 = self._clamp(t0), self._clamp(t1)
        line = self._states
        if line.n == 0:
            return []
        state, vehicle = self._s["state"][line.row], line.vehicle
        fresh = np.ones(line.n, np.bool_)
        fresh[1:] = (state[1:] != state[:-1]) | (vehicle[1:] != vehicle[:-1])
        state, vehicle, begin = state[fresh], vehicle[fresh], line.tick[fresh]
        end = np.full(len(begin), FOREVER, np.int64)
        same = vehicle[1:] == vehicle[:-1]
        end[:-1][same] = begin[1:][same]
        keep = (begin < t1) & (end > t0)
        if vehicles is not None:
            keep &= np.isin(vehicle, np.asarray(vehicles, np.int64))
        return list(
            zip(
                vehicle[keep].tolist(),
                np.maximum(begin[keep], t0).tolist(),
                np.minimum(end[keep], t1).tolist(),
                state[keep].astype(int).tolist(),
                strict=True,
            )
        )

    def heat(self, kind: str, t0: float, t1: float) -> F64:
        """Per place in [t0, t1]: `occupancy` share of the time that it is held · `waiting` s waited in it · `energy` J
        of the motions that ended in it · `expected` s that driving along it is expected to take at t1, 0 for no arc.
        """
        t0, t1 = self._clamp(t0), self._clamp(t1)
        if kind == "expected":
            return self._expected_s(t1)
        n = self.world.graph.n_places
        c = self._overlapping(t0, t1)
        span = np.minimum(c["t1"], t1) - np.maximum(c["t0"], t0)
        if kind == "occupancy":
            moved = c["from_place"] != c["to_place"]
            held = np.bincount(c["to_place"], weights=span, minlength=n)
            held += np.bincount(c["from_place"][moved], weights=span[moved], minlength=n)
            return np.asarray(held / max(t1 - t0, 1e-9))
        if kind == "waiting":
            waits = c["kind"] == Activity.WAIT
            return np.asarray(np.bincount(c["to_place"][waits], weights=span[waits], minlength=n) * self.tick_s)
        if kind == "energy":
            share = span / np.maximum(c["t1"] - c["t0"], 1)
            return np.asarray(np.bincount(c["to_place"], weights=c["energy_mj"] * share, minlength=n) / 1000.0)
        raise ValueError(f"unknown heat map {kind!r}; known: {', '.join(HEATS)}")

    def arcs(self, t0: float, t1: float) -> dict[str, Any]:
        """Arcs in [t0, t1], per place (P,): `expected_s` at t1, `occupancy` as in `heat`, `passages` that began."""
        t0, t1 = self._clamp(t0), self._clamp(t1)
        c = self._overlapping(t0, t1)
        enters = (c["kind"] >= PRIMITIVE_0) & (c["from_place"] != c["to_place"]) & (c["t0"] >= t0)
        passages = np.bincount(c["to_place"][enters], minlength=self.world.graph.n_places)
        return {
            "expected_s": self._expected_s(t1),
            "occupancy": self.heat("occupancy", t0, t1),
            "passages": passages,
        }

    def _expected_s(self, time: float) -> F64:
        """What a router expects of each arc, by the last refresh until a time: before the first, the arc's own time."""
        expected = np.asarray(self.world.graph.arc_ticks, np.float64) * self.tick_s
        a = self.reader.table("arcs")
        known = int(np.searchsorted(a["tick"], time, side="right"))
        expected[a["place"][:known]] = a["expected_ms"][:known] / 1000.0  # the last row of a place counts
        return expected

    def _overlapping(self, t0: float, t1: float) -> dict[str, NDArray[Any]]:
        """Intervals that overlap [t0, t1], the open ones until the end of the log. Rows are in order of t1."""
        m, o = self._m, self._open
        first = int(np.searchsorted(m["t1"], t0, side="right"))
        names = ("vehicle", "kind", "cause", "t0", "t1", "from_place", "to_place", "loaded", "energy_mj")
        inside = m["t0"][first:] < t1
        last = self._motions.position(np.arange(self.n), float(FOREVER))
        ended = np.where(last >= 0, m["t1"][self._motions.row[last]] if self._motions.n else 0, 0)
        is_open = (o["known"] == 1) & (o["t0"] >= ended) & (o["t0"] < t1) & (self.t_end > t0)
        out: dict[str, NDArray[Any]] = {}
        for name in names:
            more = np.full(self.n, self.t_end) if name == "t1" else o[name]
            out[name] = np.concatenate([m[name][first:][inside].astype(np.int64), more[is_open]])
        return out

    def _grid(self, t0: float, t1: float, points: int) -> F64:
        return np.linspace(self._clamp(t0), max(self._clamp(t1), self._clamp(t0)), max(points, 2))

    def _cached(self, name: str, build: Any) -> Any:
        """A value that holds until the next refresh."""
        if name not in self._cache:
            self._cache[name] = build()
        return self._cache[name]


def _passed(ticks: NDArray[np.int64], times: F64) -> F64:
    """Σ max(0, T - tick) over ascending ticks, at every time T."""
    sums = np.concatenate([[0], np.cumsum(ticks)])
    before = np.searchsorted(ticks, times)
    return np.asarray(before * times - sums[before])
