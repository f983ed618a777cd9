"""What a page shows of a run on terrain beside the fleet, at any tick: search, way, driven trajectories, obstacles.

All of it follows from the log. What the robot knows does too: the cells within its sensor's radius of every state at
which a motion ended so far, and what was known beforehand.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.results.reading import Log, latest_keyframe
from engine.results.schema import ENERGY_COLUMNS
from engine.results.view import RunView
from engine.scenario import goal_places, start_places
from engine.types import COMPONENTS, NONE, PRIMITIVE_0, Component
from engine.world.relief import tilt
from engine.world.terrain import TerrainWorld

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

POWER_WINDOW_S = 5.0
"""Power of the moment is a mean over so long: one motion takes a second or two."""
_BESIDE = (Component.CHARGED, Component.CHARGER_LOSS)


@dataclass(frozen=True, slots=True)
class Ground:
    """Answers about a run on terrain. view: of such a run; its world is a TerrainWorld."""

    view: RunView
    world: TerrainWorld

    # -- what was driven, and seen

    def track(self, since: int = 0) -> dict[str, Any]:
        """Motions that have ended, from row `since` of the log's table on, as columns.

        start: the robot's first cell · from, next: rows told of · t0_s, t1_s, place, heading, k: the trajectory, by its
        state and number · watts: mean power at the battery.
        """
        m, tick_s = self.view.reader.table("motions"), self.view.tick_s
        n = len(m["t0"])
        first = since if 0 <= since <= n else 0
        rows = first + np.flatnonzero(m["kind"][first:] >= PRIMITIVE_0)
        columns = {name: m[name][rows].astype(np.int64) for name in _STATES}
        ks = [self.world.trajectory(*row) for row in zip(*(c.tolist() for c in _legs(columns)), strict=True)]
        seconds = (m["t1"][rows] - m["t0"][rows]) * tick_s
        return {
            "start": start_places(self.view.scenario, self.world)[0],
            "from": first,
            "next": n,
            "t0_s": np.round(m["t0"][rows] * tick_s, 3).tolist(),
            "t1_s": np.round(m["t1"][rows] * tick_s, 3).tolist(),
            "place": columns["from_place"].tolist(),
            "to": columns["to_place"].tolist(),
            "heading": columns["from_heading"].tolist(),
            "k": ks,
            "watts": np.round(m["energy_mj"][rows] / 1000 / seconds + self.standby_w(), 1).tolist(),
        }

    def looks(self, time: float) -> tuple[I64, I64]:
        """Ticks at which the sensor looked until a time, and from which cells: the start, and where motions ended."""
        m = self.view.reader.table("motions")
        ended = (m["kind"] >= PRIMITIVE_0) & (m["t1"] <= time)
        start = start_places(self.view.scenario, self.world)[0]
        return np.append(0, m["t1"][ended]).astype(np.int64), np.append(start, m["to_place"][ended]).astype(np.int64)

    def near(self, cells: I64, place: int) -> NDArray[np.bool_]:
        """Whether a place is within the sensor's radius of each cell."""
        (y, x), (cy, cx) = divmod(place, self.world.width), np.divmod(cells, self.world.width)
        radius = self.world.sensor_m / self.world.grain_m
        return np.asarray((cx - x) ** 2 + (cy - y) ** 2 <= radius * radius)

    def seen_since(self, place: int, tick: int, time: float) -> bool:
        """Whether the sensor has looked at a place at or after a tick, until a time."""
        ticks, cells = self.looks(time)
        if bool((self.near(cells, place) & (ticks >= tick)).any()):
            return True
        # a robot that stands sees at once what is dropped beside it
        m = self.view.reader.table("motions")
        under_way = (m["kind"] >= PRIMITIVE_0) & (m["t0"] <= tick) & (m["t1"] > tick)
        standing = not under_way.any() and int(_last(self.view.reader, tick)[1]) < PRIMITIVE_0
        return standing and bool(self.near(cells[ticks <= tick][-1:], place).any())

    def obstacles(self, time: float) -> list[list[int]]:
        """Cells whose obstacle an operator dropped (1) or removed (0): [place, there, whether the robot saw it]."""
        b = self.view.reader.table("blocks")
        known = int(np.searchsorted(b["tick"], time, side="right"))
        latest: dict[int, tuple[int, int]] = {}
        for place, there, tick in zip(
            *(b[name][:known].tolist() for name in ("place", "blocked", "tick")), strict=True
        ):
            latest[place] = (there, tick)
        return [[p, there, int(self.seen_since(p, tick, time))] for p, (there, tick) in latest.items()]

    # -- the search

    def goal(self, time: float) -> int:
        """The cell to which the robot is to go."""
        sent = [place for tick, place in _sent(self.view.reader) if tick <= time]
        return sent[-1] if sent else goal_places(self.view.scenario, self.world)[0]

    def passes(self, t0: float, t1: float) -> dict[str, Any]:
        """What the search has published in [t0, t1], with what held before: columns.

        t_s · bound: ε, the way costs at most so many times the least, NaN without a way · cost: of the way ahead, in J
        or m by the objective, NaN without one · expanded: since the row before · open, incons: sizes · anew: the first
        way to a goal · repaired: ε did not fall, so costs had changed.
        """
        s = self.view.reader.table("searches")
        first = max(0, int(np.searchsorted(s["tick"], t0, side="right")) - 1)
        last = int(np.searchsorted(s["tick"], t1, side="right"))
        rows = slice(first, last)
        anew, repaired = self._why()
        found = s["cost"][rows] >= 0
        return {
            "t_s": s["tick"][rows] * self.view.tick_s,
            "bound": np.where(found, s["bound"][rows] / 1000, np.nan),
            "cost": np.where(found & (s["tick"][rows] >= self._counted_from()), s["cost"][rows] / 1000, np.nan),
            "expanded": s["expanded"][rows].astype(np.int64),
            "open": s["open"][rows].astype(np.int64),
            "incons": s["incons"][rows].astype(np.int64),
            "anew": anew[rows],
            "repaired": repaired[rows],
        }

    def _counted_from(self) -> int:
        """Tick before which costs are in the other unit: where this run was forked for another objective, else 0."""
        parent = self.view.reader.manifest.get("parent") or {}
        changed = "planner.objective" in (parent.get("change") or {})
        return int(parent["tick"]) if changed else 0

    def _why(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """By row of `searches`: whether it is the first way to a goal; whether it mends one instead of bettering it."""
        s = self.view.reader.table("searches")
        mends = np.zeros(len(s["tick"]), np.bool_)
        mends[1:] = s["bound"][1:] >= s["bound"][:-1]
        e = self.view.reader.table("events")
        begun = [0, *(tick for tick, _ in _sent(self.view.reader))]
        begun += [t for t, kind in zip(e["tick"].tolist(), e["kind"].tolist(), strict=True) if kind == "forked"]
        first = np.searchsorted(s["tick"], np.array(begun, np.int64))
        anew = np.zeros(len(mends), np.bool_)
        anew[first[first < len(anew)]] = True
        return anew, mends & ~anew

    def search(self, time: float) -> dict[str, Any] | None:
        """The search at a time, as of its latest pass; None before the first.

        bound, cost: None without a way · expanded: of the last pass · total: expanded so far · ways: passes published
        so far · repairs: those of them that mended a way.
        """
        rows = self.passes(-1, time)
        if not len(rows["t_s"]):
            return None
        last = {name: values[-1].item() for name, values in rows.items()}
        return {
            "since_s": last["t_s"],
            "bound": None if np.isnan(last["bound"]) else last["bound"],
            "cost": None if np.isnan(last["cost"]) else last["cost"],
            "objective": self.view.scenario.planner.objective,
            "expanded": last["expanded"],
            "total": int(rows["expanded"].sum()),
            "open": last["open"],
            "incons": last["incons"],
            "ways": len(rows["t_s"]),
            "repairs": int(rows["repaired"].sum()),
        }

    def frontier(self, time: float) -> dict[str, list[int]]:
        """Cells in OPEN and in INCONS when the latest pass was done, thinned."""
        s = self.view.reader.table("searches")
        row = int(np.searchsorted(s["tick"], time, side="right")) - 1
        return {name: _item(s[f"{name}_places"], row) for name in ("open", "incons")}

    # -- the way ahead

    def way(self, time: float) -> tuple[int, F64]:
        """Row of the latest plan until a time (-1 before the first), and its way as (n, 2) points in metres."""
        p = self.view.reader.table("plans")
        row = int(np.searchsorted(p["tick"], time, side="right")) - 1
        if row < 0:
            return -1, np.zeros((0, 2))
        places, t_in = _item(p["places"], row), _item(p["t_in"], row)
        if not places:
            return row, np.zeros((0, 2))
        xy = self.world.graph.xy_m[places].astype(np.float64)
        heading = int(_last(self.view.reader, int(p["tick"][row]))[0])
        legs = self._trajectories(places, t_in, heading)
        if legs is None:
            return row, xy
        cluster, parts = self.world.cluster, [xy[:1]]
        for at, (h, k) in zip(xy, legs, strict=False):
            parts.append(at + cluster.point[h, k, 1 : int(cluster.pieces[h, k]) + 1] * self.world.grain_m)
        return row, np.concatenate(parts)

    def _trajectories(self, places: list[int], t_in: list[int], heading: int) -> list[tuple[int, int]] | None:
        """(heading, number) of the trajectory of every leg of a way, whose log holds cells and times alone."""
        cluster = self.world.cluster
        ticks = cluster.kind_ticks[cluster.kind]
        steps: list[dict[int, tuple[int, int]]] = []
        front = [heading]
        for leg in range(len(places) - 1):
            (y, x), (to_y, to_x) = divmod(places[leg], self.world.width), divmod(places[leg + 1], self.world.width)
            found: dict[int, tuple[int, int]] = {}
            for h in front:
                fits = (cluster.end[h, :, 0] == to_x - x) & (cluster.end[h, :, 1] == to_y - y)
                fits &= ticks[h] == t_in[leg + 1] - t_in[leg]
                for k in np.flatnonzero(fits).tolist():
                    found.setdefault(int(cluster.end[h, k, 2]), (h, k))
            if not found:
                return None
            steps.append(found)
            front = list(found)
        out, h = [], front[0]
        for found in reversed(steps):
            out.append(found[h])
            h = found[h][0]
        return out[::-1]

    # -- one cell, and power

    def cell(self, place: int, time: float) -> dict[str, Any]:
        """What a cell is, and what the robot knows of it: heights in m, slope in degrees.

        obstacle: as it is · believed: obstacle as the robot believes · known: seen or known beforehand · seen: seen.
        """
        terrain = self.world.terrain
        y, x = divmod(place, self.world.width)
        changes = {p: (there, seen) for p, there, seen in self.obstacles(time)}
        there, noticed = changes.get(place, (int(terrain.obstacle[y, x]), 1))
        seen = self.seen_since(place, 0, time)
        known = seen or bool(self.world.known[y, x])
        before = bool(terrain.obstacle[y, x]) and known
        return {
            "height_m": float(terrain.height_m[y, x]),
            "prior_m": float(self.world.prior_m[y, x]),
            "slope_deg": float(np.degrees(np.arctan(tilt(terrain.height_m, terrain.cell_m)[y, x]))),
            "slope_limit_deg": terrain.slope_limit_deg,
            "friction": float(terrain.friction[y, x]),
            "obstacle": bool(there),
            "believed": bool(there) and known if noticed else before,
            "known": known,
            "seen": seen,
        }

    def watts(self, time: float) -> float | None:
        """Mean power at the battery of the last few seconds; None before it is known."""
        found = float(self.view.power(time, POWER_WINDOW_S)[0])
        return None if np.isnan(found) else round(found, 1)

    def standby_w(self) -> float:
        """What the robot draws whatever it does, by the log's samples."""
        b = self.view.reader.table("battery")
        ticks = int(b["tick"][-1]) if len(b["tick"]) else 0
        return float(b["standby_mj"][-1]) / 1000 / (ticks * self.view.tick_s) if ticks else 0.0

    def power(self, t0: float, t1: float, points: int = 240) -> dict[str, Any]:
        """Power at the battery by component in [t0, t1]: t_s (m,) and watts {name: (m,)}, means between samples."""
        b = self.view.reader.table("battery")
        inside = np.flatnonzero((b["tick"] >= t0) & (b["tick"] <= t1))
        rows = inside[:: max(1, -(-len(inside) // points))]
        seconds = np.diff(b["tick"][rows]) * self.view.tick_s
        watts: dict[str, F64] = {}
        for component, (name, column) in enumerate(zip(COMPONENTS, ENERGY_COLUMNS, strict=True)):
            values = np.diff(b[column][rows]) / 1000 / np.maximum(seconds, self.view.tick_s)
            if component not in _BESIDE and values.any():
                watts[name] = values
        return {"t_s": b["tick"][rows][1:] * self.view.tick_s, "watts": watts}

    def told(self, time: float, since: int = 0, way: int = -2, frontier: bool = False) -> dict[str, Any]:
        """Everything that a map draws at a time.

        since: rows of `track` that are known already · way: row of the plan whose way is known already, then it is left
        out · frontier: also cells in OPEN and INCONS.
        """
        row, points = self.way(time)
        return {
            "time_s": time * self.view.tick_s,
            "goal": self.goal(time),
            "search": self.search(time),
            "way_row": row,
            "way": None if row == way else np.round(points, 2).ravel().tolist(),
            "watts": self.watts(time),
            "obstacles": self.obstacles(time),
            "track": self.track(since),
            "frontier": self.frontier(time) if frontier else None,
        }


_STATES = ("from_place", "from_heading", "to_place", "to_heading", "kind")


def _legs(columns: dict[str, I64]) -> Iterator[I64]:
    """The arguments of TerrainWorld.trajectory."""
    yield from (columns[name] for name in _STATES[:-1])
    yield columns["kind"] - PRIMITIVE_0


def _item(column: Any, row: int) -> list[int]:
    """One row of a list column; empty for -1."""
    values, offsets = column
    return values[int(offsets[row]) : int(offsets[row + 1])].tolist() if row >= 0 else []


def _sent(log: Log) -> list[tuple[int, int]]:
    """(tick, place) of every accepted command that sent the robot elsewhere."""
    c = log.table("commands")
    out = []
    for tick, text, accepted in zip(c["tick"].tolist(), c["command"].tolist(), c["accepted"].tolist(), strict=True):
        command = json.loads(str(text)) if accepted else {}
        if command.get("do") == "send":
            out.append((int(tick), int(command["place"])))
    return out


def _last(log: Log, tick: int) -> tuple[int, int]:
    """Heading at the end of the robot's last motion or stay that began before a tick, and its kind."""
    m, open_ = log.table("motions"), latest_keyframe(log)
    row = int(np.searchsorted(m["t0"], tick, side="left")) - 1
    ended = int(m["t1"][row]) if row >= 0 else -1
    if len(open_["tick"]) and ended <= int(open_["t0"][0]) < tick:
        return int(open_["to_heading"][0]), int(open_["kind"][0])
    if row >= 0:
        return int(m["to_heading"][row]), int(m["kind"][row])
    first = m["from_heading"] if len(m["t0"]) else open_["from_heading"]
    return int(first[0]) if len(first) else 0, NONE


def ground_of(view: RunView) -> Ground | None:
    """Answers about terrain, when the run is on any."""
    return Ground(view, view.world) if isinstance(view.world, TerrainWorld) else None
