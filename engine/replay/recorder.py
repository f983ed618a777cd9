"""The `.rrd` of a run, written while it goes from the same rows as the RunLog.

Rows are buffered and sent in columns: one entity per kind for the fleet, an entity per vehicle for its state lane and
its route only. Positions are sampled; everything else is sent when it changes. Timelines: `tick` (sequence) and
`sim_time` (duration). Lengths are metres; y points downwards from the floor's upper edge, as in every 2-D view.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from engine.energy import battery_of
from engine.errors import RunError
from engine.replay import looks
from engine.replay.floor_map import View2D, log_floor
from engine.replay.ground import GroundRecorder
from engine.replay.recording import Recording
from engine.replay.sampler import HeldPlaces, MotionSampler, StepSampler, Window, flatten
from engine.replay.tallies import DONE, GROUPS, OPEN, RATE, OrderCounts, Shares
from engine.results.runlog import checked
from engine.results.schema import ENERGY_COLUMNS
from engine.scenario.model import Scenario
from engine.types import COMPONENTS, FOREVER, VehicleState
from engine.world.floor import World
from engine.world.terrain import TerrainWorld

I64 = NDArray[np.int64]

BATCH_CELLS = 1 << 18
"""Vehicle samples per chunk, so that a chunk stays near 3 MB."""
FIRST_BATCH, LAST_BATCH = 32, 4096
"""Sample ticks per chunk: small at first so that there is soon something to see, then doubling."""
COARSER_AFTER = 3_000_000
"""Vehicle samples (60 to 100 MB) after which the sampling step doubles, and again after as many more."""
PER_VEHICLE, ROWS_PER_VEHICLE = frozenset({"states", "plans"}), 16
"""Tables that go to an entity per vehicle, and how many rows each must have on average in a large fleet."""
SHARE_S = 60.0
"""Occupancy is averaged, and throughput given, once per so many simulated seconds."""
RATE_S = 900.0
"""Throughput counts the orders done within so many seconds."""

_STRIPS = rr.components.LineStrip2DBatch([]).as_arrow_array().type
_STATE_WORDS = pa.array([name for name, _ in looks.STATES.values()])


class RerunRecorder:
    """Recorder (`write`, `flush`, `close`) that writes `path`; use as a context manager or close().

    A batch of `keyframes` says that all rows before its tick were written. Positions lie `sample_s` apart, rounded to
    whole ticks; each COARSER_AFTER vehicle samples the step doubles. Raises RunError when the file can't be written.
    `path` may be a Recording that several runs share: then this run's entities stand below `root`, its curves are
    named after it, and whoever made the file finishes it.
    """

    def __init__(
        self,
        path: Path | str | Recording,
        scenario: Scenario,
        world: World,
        *,
        run_id: str,
        sample_s: float = 1.0,
        root: str = "",
    ) -> None:
        self.closed = False
        self._root = root
        self._world, self._scenario = world, scenario
        self._n = n = int(scenario.fleet.count)
        self._tick_s = float(scenario.time.tick_s)
        self._view = View2D(world)
        self._xy = self._view.xy(world.graph.xy_m)
        self._step = max(1, round(sample_s / self._tick_s))
        self._sampled = 0
        self._next: int | None = None  # next sample tick; None before the fleet is known
        self._batch = FIRST_BATCH
        self._max_batch = int(np.clip(BATCH_CELLS // n, 16, LAST_BATCH))
        self._tick_end = 0
        self._started = False
        self._rows: dict[str, list[dict[str, Any]]] = {}
        self._motions = MotionSampler(n, world.graph.xy_m, world.graph.heading_deg)
        self._states = StepSampler(n, VehicleState.IDLE)
        self._held = HeldPlaces()
        self._share = max(1, round(SHARE_S / self._tick_s))
        self._capacity_mc = battery_of(**scenario.battery.asked).capacity_mc
        self._energy_seen: set[str] = set()
        self._shares = Shares(self._share)
        self._orders = OrderCounts(max(1, round(RATE_S / self._tick_s)), self._tick_s)
        self._charger_now = np.zeros(len(world.chargers), np.int64)
        self._levels = {name: float(getattr(scenario.charging, name)) for name in looks.LEVELS}
        self._lane = np.full(n, -1, np.int64)
        self._blocked: dict[int, None] = {}
        self._clear_at = np.full(n, FOREVER, np.int64)
        self._shared = isinstance(path, Recording)
        self._file = path if isinstance(path, Recording) else self._new_file(path, run_id)
        self._part = self._file.part(root, self._tick_s)
        self._send = self._part.send
        log_floor(self._part.static, self._world, self._view)
        self._ground = GroundRecorder(self._part, world, self._tick_s) if isinstance(world, TerrainWorld) else None
        self._log_styles()

    # ---------------------------------------------------------------------------------------------- recorder

    def write(self, table: str, columns: Mapping[str, Any]) -> None:
        """Take rows of one table of the schema. Arrays are copied."""
        if self.closed:
            raise RunError(f"the recording {self._file.path.name} is closed")
        rows, count = checked(table, columns)
        if not count:
            return
        if self._ground is not None:
            self._ground.write(table, rows)
        match table:
            case "motions":
                self._motions.add(rows)
            case "plans":
                self._held.add(rows)
                self._rows.setdefault(table, []).append(rows)
            case "keyframes":
                self._motions.add_open(rows)
                self._add_first_states(rows)
                self._tick_end = max(self._tick_end, int(rows["tick"].max()))
                self._emit(int(rows["tick"].max()))
            case "searches":
                self._tick_end = max(self._tick_end, int(rows["tick"].max()))
            case _:
                if table == "states":
                    self._states.add(rows["tick"], rows["vehicle"], rows["state"])
                self._rows.setdefault(table, []).append(rows)
                self._tick_end = max(self._tick_end, int(rows["tick"].max()))

    def _add_first_states(self, keyframe: dict[str, Any]) -> None:
        """Learn from the first keyframe what a log that begins later than its run does not say otherwise."""
        if self._started:
            return
        self._started = True
        told = np.zeros(self._n, np.bool_)
        for part in self._rows.get("states", []):
            told[part["vehicle"]] = True
        new = ~told[keyframe["vehicle"]]
        rows = {name: keyframe[name][new] for name in ("tick", "vehicle", "state")}
        self._states.add(rows["tick"], rows["vehicle"], rows["state"])
        self._rows.setdefault("states", []).append(rows)

    def flush(self) -> None:
        """Nothing has to be done: rows are sent in batches that keep the file small."""

    def close(self) -> None:
        """Send what is left, up to the last tick known, and finish the file."""
        if self.closed:
            return
        self.closed = True
        try:
            self._tick_end = max(self._tick_end, self._motions.t_end)
            self._emit(self._tick_end + 1, last=True)
        finally:
            if not self._shared:
                self._file.close()

    def __enter__(self) -> RerunRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def note(self) -> dict[str, Any]:
        """How the positions were sampled, for the run's manifest."""
        return {"sample_s": self._step * self._tick_s, "rerun": rr.__version__}

    # ---------------------------------------------------------------------------------------------- the file

    def _new_file(self, path: Path | str, run_id: str) -> Recording:
        view = self._view
        if isinstance(self._world, TerrainWorld):
            blueprint = looks.ground_blueprint(width_m=view.width_m, height_m=view.height_m)
        else:
            blueprint = looks.blueprint(width_m=view.width_m, height_m=view.height_m, vehicles=self._n)
        return Recording(path, run_id, f"{self._scenario.title} · {run_id}", blueprint)

    def _log_styles(self) -> None:
        """Names, colours and sizes that hold for the whole recording."""
        n, cell = self._n, self._view.cell_m
        static = self._part.static
        names = [looks.vehicle_name(v) for v in range(n)]
        colours = [looks.vehicle_colour(v) for v in range(n)]
        # A negative radius is one on the screen.
        body, load, route = (-4.0, -1.5, -1.0) if self._view.wide else (0.36 * cell, 0.15 * cell, 0.035 * cell)
        static(looks.VEHICLES, rr.Points2D.from_fields(radii=body, show_labels=False))
        names_above = rr.Points2D.from_fields(
            labels=[str(v) for v in range(n)],
            show_labels=True,
            radii=0.01 * cell,
            colors=(235, 240, 245, 255),
            draw_order=33.0,
        )
        static(looks.NAMES, names_above)
        static(looks.CHARGER_LIGHTS, rr.Points2D.from_fields(radii=0.1 * cell, show_labels=False))
        static(looks.NOSES, rr.Points2D.from_fields(radii=0.09 * cell, colors=(16, 20, 26, 255), draw_order=32.0))
        static(looks.LOADS, rr.Points2D.from_fields(radii=load, colors=(255, 255, 255, 255), draw_order=31.0))
        static(
            looks.RESERVED,
            rr.Boxes2D.from_fields(radii=0.025 * cell, colors=(248, 210, 90, 255)),
        )
        static(looks.BLOCKED, rr.Boxes2D.from_fields(radii=0.07 * cell, colors=(248, 81, 73, 255)))
        static(looks.SOC, rr.SeriesLines(names=names, colors=colours, widths=1.5))
        static(
            looks.SOC_SPREAD,
            rr.SeriesLines(
                names=["lowest", "mean", "highest"],
                colors=[(240, 136, 62, 255), (91, 192, 222, 255), (126, 211, 120, 255)],
                widths=1.5,
            ),
        )
        share_colours = [looks.STATES[states[0]][1] for states in GROUPS.values()]
        static(looks.ACTIVITY, rr.SeriesLines(names=[self._named(g) for g in GROUPS], colors=share_colours, widths=1.5))
        for name in COMPONENTS:
            line = rr.SeriesLines(
                names=self._named(name.replace("_", " ")), colors=looks.COMPONENT_COLOURS[name], widths=1.5
            )
            static(f"{looks.ENERGY}/{name}", line)
        for name, colour in looks.LEVELS.items():
            static(
                f"{looks.SOC_LEVELS}/{name}", rr.SeriesLines(names=name, colors=colour, interpolation_mode="StepAfter")
            )
        for path, text, colour in (
            (f"{looks.ORDERS}/{DONE}", "orders done", (126, 211, 120, 255)),
            (f"{looks.ORDERS}/{OPEN}", "orders open", (240, 136, 62, 255)),
            (f"{looks.ORDERS}/{RATE}", "orders per hour", (91, 192, 222, 255)),
        ):
            static(
                path, rr.SeriesLines(names=self._named(text), colors=colour, widths=1.5, interpolation_mode="StepAfter")
            )
        words = [name for name, _ in looks.STATES.values()]
        lane = rr.StateConfiguration(values=words, labels=words, colors=[colour for _, colour in looks.STATES.values()])
        for vehicle in range(n):
            static(looks.lane(vehicle, n), lane)
            static(
                looks.route(vehicle),
                rr.LineStrips2D.from_fields(colors=looks.vehicle_colour(vehicle), radii=route, show_labels=False),
            )

    def _named(self, curve: str) -> str:
        return f"{self._root} {curve}" if self._root else curve

    # ---------------------------------------------------------------------------------------------- batches

    def _emit(self, until: int, *, last: bool = False) -> None:
        """Send samples below `until` as far as the whole fleet is known, and the rows that came with them."""
        if not last:
            until = min(until, self._motions.complete)
        if self._next is None:
            began = self._motions.began
            if began == FOREVER and not last:
                return
            self._next = -(-(began if began < FOREVER else 0) // self._step) * self._step
            self._send_lights(np.array([self._next]), self._charger_now[None])
            self._send_levels(self._next)
        if not last and (until - self._next) // self._step < self._batch:
            return
        while self._next < until:
            stop = min(until, self._next + self._max_batch * self._step)
            window = Window(self._next, stop, self._step)
            self._send_samples(window, last=last and stop == until)
            self._next = window.first + len(window) * window.step
            self._sampled += len(window) * self._n
            if self._sampled > COARSER_AFTER:
                self._sampled, self._step = 0, 2 * self._step
                self._next = -(-self._next // self._step) * self._step
        self._batch = min(2 * self._batch, self._max_batch)
        if self._ground is not None:
            self._ground.emit()
        self._send_rows(until, last=last)
        self._file.flush()

    def _send_samples(self, window: Window, *, last: bool) -> None:
        poses = self._motions.take(window, last=last)
        states = self._states.take(window)
        k, n = states.shape
        xy = self._view.xy(poses.xy_m)
        every = np.full(k, n, np.int64)
        classes = (states + np.uint8(looks.STATE_CLASS_0)).astype(np.uint16).reshape(-1)
        fleet = rr.Points2D.columns(positions=xy.reshape(-1, 2), class_ids=classes)
        self._send(looks.VEHICLES, poses.ticks, fleet.partition(every))

        if not self._view.wide:
            angle = np.deg2rad(poses.heading_deg)
            ahead = np.stack([np.cos(angle), -np.sin(angle)], -1) * np.float32(0.24 * self._view.cell_m)
            noses = rr.Points2D.columns(positions=(xy + ahead).reshape(-1, 2))
            self._send(looks.NOSES, poses.ticks, noses.partition(every))
        if n <= looks.FEW:
            above = xy - np.array([0.0, 0.9 * self._view.cell_m], np.float32)
            self._send(looks.NAMES, poses.ticks, rr.Points2D.columns(positions=above.reshape(-1, 2)).partition(every))
        loads = rr.Points2D.columns(positions=xy[poses.loaded])
        self._send(looks.LOADS, poses.ticks, loads.partition(poses.loaded.sum(1)))

        ticks, places, lengths = self._held.take(window)
        centres = self._xy[places]
        boxes = rr.Boxes2D.columns(centers=centres, half_sizes=np.full_like(centres, 0.46 * self._view.cell_m))
        self._send(looks.RESERVED, ticks, boxes.partition(lengths))

        bins, shares = self._shares.add(poses.ticks, states, last=last)
        activity = rr.Scalars.columns(scalars=100.0 * shares)
        self._send(looks.ACTIVITY, bins, activity)

    def _send_rows(self, until: int, *, last: bool) -> None:
        """Send the rows that say when something changed."""
        for table, send in (
            ("battery", self._send_battery),
            ("states", self._send_lanes),
            ("chargers", self._send_chargers),
            ("blocks", self._send_blocks),
            ("events", self._send_events),
            ("commands", self._send_commands),
        ):
            if parts := self._pop(table, last=last):
                send(parts)
        plans = self._pop("plans", last=last)
        if not self._rows.get("plans"):
            self._send_routes(plans, until)
        if last:
            self._send_levels(self._tick_end)
        orders = self._rows.pop("orders", [])
        if orders:
            self._orders.add(_joined(orders, "tick"), _joined(orders, "state"))
        for series, ticks, values in self._orders.take(until, self._share):
            self._send(f"{looks.ORDERS}/{series}", ticks, rr.Scalars.columns(scalars=values))

    def _pop(self, table: str, *, last: bool) -> list[dict[str, Any]]:
        """Rows to send; those that go to an entity per vehicle wait until a chunk for each is worth it."""
        parts = self._rows.get(table, [])
        few = sum(len(part["tick"]) for part in parts) < ROWS_PER_VEHICLE * self._n
        if table in PER_VEHICLE and few and not last and self._n > looks.FEW:
            return []
        return self._rows.pop(table, [])

    def _send_levels(self, tick: int) -> None:
        """Charge thresholds from a tick on, as lines beneath the vehicles'."""
        for name, level in self._levels.items():
            column = rr.Scalars.columns(scalars=np.array([100.0 * level]))
            self._send(f"{looks.SOC_LEVELS}/{name}", np.array([tick]), column)

    def _send_battery(self, parts: list[dict[str, Any]]) -> None:
        tick, vehicle = _joined(parts, "tick"), _joined(parts, "vehicle")
        ticks, row = np.unique(tick, return_inverse=True)
        # A tick whose rows have not all come yet waits for the rest.
        whole = np.bincount(row, minlength=len(ticks)) >= self._n
        rest = ~whole[row] & (tick == ticks[-1])
        if rest.any() and not self.closed:
            self._rows["battery"] = [{name: _joined(parts, name)[rest] for name in parts[0]}]
        ticks, at = ticks[whole], np.cumsum(whole)[row] - 1
        keep = whole[row]
        soc = np.zeros((len(ticks), self._n))
        soc[at[keep], vehicle[keep]] = _joined(parts, "charge_mc")[keep] * (100.0 / self._capacity_mc)
        line = rr.Scalars.columns(scalars=soc.reshape(-1)).partition(np.full(len(ticks), self._n))
        self._send(looks.SOC, ticks, line)
        if self._n > looks.FEW:
            spread = np.stack([soc.min(1), soc.mean(1), soc.max(1)], 1)
            self._send(looks.SOC_SPREAD, ticks, rr.Scalars.columns(scalars=spread))
        for name, column in zip(COMPONENTS, ENERGY_COLUMNS, strict=True):
            total_mj = np.zeros(len(ticks), np.int64)
            np.add.at(total_mj, at[keep], _joined(parts, column)[keep])
            # a curve begins with its first joule, however the rows were batched
            since = 0 if name in self._energy_seen else int(np.argmax(total_mj != 0))
            if name in self._energy_seen or total_mj.any():
                self._energy_seen.add(name)
                line = rr.Scalars.columns(scalars=total_mj[since:] / 1e6)
                self._send(f"{looks.ENERGY}/{name}", ticks[since:], line)

    def _send_lanes(self, parts: list[dict[str, Any]]) -> None:
        tick, vehicle, state = (_joined(parts, name) for name in ("tick", "vehicle", "state"))
        for who, rows in _by_vehicle(vehicle):
            # The table also tells of changes of task or cause, within a state.
            before = np.append(self._lane[who], state[rows][:-1])
            self._lane[who] = state[rows[-1]]
            rows = rows[state[rows] != before]
            if not len(rows):
                continue
            text = rr.components.TextBatch(_STATE_WORDS.take(pa.array(state[rows])))
            column = rr.ComponentColumn(rr.StateChange.descriptor_state(), text)
            self._send(looks.lane(who, self._n), tick[rows], [column])

    def _send_routes(self, parts: list[dict[str, Any]], until: int) -> None:
        """Each plan's places as a line from its tick on, and nothing once it has ended without a new one."""
        tick, vehicle, end = (_joined(parts, name) for name in ("tick", "vehicle", "end"))
        places, sizes = flatten([part["places"] for part in parts])
        starts = np.cumsum(sizes) - sizes
        groups = dict(_by_vehicle(vehicle))
        over = self._clear_at < until
        for who in sorted(groups.keys() | set(np.flatnonzero(over).tolist())):
            rows = groups.get(who, np.zeros(0, np.int64))
            ends = np.append(self._clear_at[who], end[rows])
            cleared = ends[ends < np.append(tick[rows], until)]
            self._clear_at[who] = ends[-1] if ends[-1] >= until else FOREVER
            # A plan that ends where it begins stands before the row that clears it.
            at = np.concatenate([tick[rows], cleared])
            order = np.argsort(at, kind="stable")
            lengths = np.concatenate([sizes[rows] * (sizes[rows] > 1), np.zeros(len(cleared), np.int64)])[order]
            begins = np.concatenate([starts[rows], np.zeros(len(cleared), np.int64)])[order]
            offsets = np.append(0, np.cumsum(lengths))
            index = np.arange(offsets[-1]) + np.repeat(begins - offsets[:-1], lengths)
            points = rr.encodings.Vec2DBatch(self._xy[places[index]]).as_arrow_array()
            shown = (lengths > 0).astype(np.int32)
            edges = offsets[np.append(True, lengths > 0)].astype(np.int32)
            strips = rr.components.LineStrip2DBatch(pa.ListArray.from_arrays(edges, points, type=_STRIPS))
            column = rr.ComponentColumn(rr.LineStrips2D.descriptor_strips(), strips, lengths=shown)
            self._send(looks.route(who), at[order], [column])

    def _send_chargers(self, parts: list[dict[str, Any]]) -> None:
        tick, charger, state = (_joined(parts, name) for name in ("tick", "charger", "state"))
        m = len(self._charger_now)
        shown = np.array([1, 2, 0, 3, 0, -1])[state]  # what a row of the table leaves behind
        known = (charger >= 0) & (charger < m) & (shown >= 0)
        ticks, row = np.unique(tick[known], return_inverse=True)
        now = np.full((len(ticks) + 1, m), -1, np.int64)
        now[0] = self._charger_now
        now[row + 1, charger[known]] = shown[known]
        latest = np.maximum.accumulate(np.where(now >= 0, np.arange(len(now))[:, None], 0), axis=0)
        filled = np.take_along_axis(now, latest, 0)
        self._charger_now = filled[-1]
        self._send_lights(ticks, filled[1:])

    def _send_lights(self, ticks: I64, states: I64) -> None:
        """(k, chargers) what each charger shows from each tick on."""
        m = states.shape[1]
        if not m:
            return
        classes = (states + looks.CHARGER_CLASS_0).astype(np.uint16).reshape(-1)
        # In the bay's corner, where a vehicle that charges does not hide it.
        corner = np.array([0.3, -0.3], np.float32) * np.float32(self._view.cell_m)
        centres = np.tile(self._xy[self._world.chargers] + corner, (len(ticks), 1))
        dots = rr.Points2D.columns(positions=centres, class_ids=classes).partition(np.full(len(ticks), m))
        self._send(looks.CHARGER_LIGHTS, ticks, dots)

    def _send_blocks(self, parts: list[dict[str, Any]]) -> None:
        tick, place, blocked = (_joined(parts, name) for name in ("tick", "place", "blocked"))
        sets: list[I64] = []
        for where, closed in zip(place.tolist(), blocked.tolist(), strict=True):
            self._blocked.pop(where, None)
            if closed:
                self._blocked[where] = None
            sets.append(np.array(list(self._blocked), np.int64))
        lengths = np.array([len(s) for s in sets])
        centres = self._xy[np.concatenate(sets)]
        halves = np.full_like(centres, 0.4 * self._view.cell_m)
        self._send(looks.BLOCKED, tick, rr.Boxes2D.columns(centers=centres, half_sizes=halves).partition(lengths))

    def _send_events(self, parts: list[dict[str, Any]]) -> None:
        level = np.clip(_joined(parts, "level"), 0, len(looks.EVENT_LEVELS) - 1)
        names = np.array([name for name, _ in looks.EVENT_LEVELS], object)[level]
        colours = np.array([colour for _, colour in looks.EVENT_LEVELS], np.uint8)[level]
        text = [str(t) for part in parts for t in part["text"]]
        columns = rr.TextLog.columns(text=text, level=names.tolist(), color=colours)
        self._send(looks.EVENTS, _joined(parts, "tick"), columns)

    def _send_commands(self, parts: list[dict[str, Any]]) -> None:
        accepted = _joined(parts, "accepted") > 0
        words = ["accepted" if yes else "refused" for yes in accepted.tolist()]
        command = [str(c) for part in parts for c in part["command"]]
        for tick, given, yes in zip(_joined(parts, "tick").tolist(), command, accepted.tolist(), strict=True):
            if yes and "thresholds" in given:
                self._set_levels(tick, json.loads(given))
        reason = [str(r) for part in parts for r in part["reason"]]
        text = [f"{w}: {c}" + (f": {r}" if r else "") for w, c, r in zip(words, command, reason, strict=True)]
        level = ["INFO" if yes else "WARN" for yes in accepted.tolist()]
        self._send(looks.COMMANDS, _joined(parts, "tick"), rr.TextLog.columns(text=text, level=level))

    def _set_levels(self, tick: int, command: Mapping[str, Any]) -> None:
        self._levels |= {name: float(command[name]) for name in self._levels if name in command}
        self._send_levels(tick)


def _joined(parts: list[dict[str, Any]], name: str) -> I64:
    """One numeric column of some batches."""
    return np.concatenate([np.asarray(part[name], np.int64) for part in parts] or [np.zeros(0, np.int64)])


def _by_vehicle(vehicle: I64) -> list[tuple[int, I64]]:
    """(vehicle, its rows in order) for each vehicle that has any."""
    if not len(vehicle):
        return []
    order = np.argsort(vehicle, kind="stable")
    edges = np.flatnonzero(np.diff(vehicle[order])) + 1
    return [(int(vehicle[rows[0]]), rows) for rows in np.split(order, edges)]
