"""RunView's slow, obvious twin: every answer from a scan of all rows, one vehicle at a time."""

from __future__ import annotations

from typing import Any

from engine.results.runlog import Log, latest_keyframe
from engine.scenario import Scenario
from engine.types import PRIMITIVE_0, Activity, OrderState
from engine.world.floor import World

GROUPS = {
    Activity.WAIT: "waiting", Activity.PAUSE: "waiting", Activity.PICK: "loading", Activity.DROP: "loading",
    Activity.CHARGE: "charging", Activity.REST: "idle", Activity.FAULT: "fault",
}  # fmt: skip


def rows_of(log: Log, name: str) -> list[dict[str, Any]]:
    """A table as a list of records; list columns left out."""
    table = {c: v for c, v in log.table(name).items() if not isinstance(v, tuple)}
    return [dict(zip(table, row, strict=True)) for row in zip(*(v.tolist() for v in table.values()), strict=True)]


class NaiveView:
    """The same questions as RunView, of a log that does not change."""

    def __init__(self, log: Log, scenario: Scenario, world: World) -> None:
        self.scenario, self.world = scenario, world
        self.tick_s = scenario.time.tick_s
        self.motions, self.states = rows_of(log, "motions"), rows_of(log, "states")
        self.battery, self.orders_rows = rows_of(log, "battery"), rows_of(log, "orders")
        frame = latest_keyframe(log)
        self.open = [
            dict(zip(frame, row, strict=True)) for row in zip(*(v.tolist() for v in frame.values()), strict=True)
        ]
        self.t_end = max([m["t1"] for m in self.motions] + [o["tick"] for o in self.open])
        self.intervals = [dict(m) for m in self.motions]
        for o in self.open:
            self.intervals.append({**o, "t1": max(self.t_end, o["t0"]), "foreseen": o["t1"]})
        self.n = scenario.fleet.count

    def interval(self, v: int, time: float) -> dict[str, Any]:
        """The last interval of a vehicle that begins at or before a time."""
        found = None
        for m in self.intervals:
            if m["vehicle"] == v and m["t0"] <= time and (found is None or m["t0"] >= found["t0"]):
                found = m
        assert found is not None
        return found

    def pose(self, v: int, time: float) -> tuple[float, float, float]:
        """x and y in metres, heading in degrees."""
        m = self.interval(v, time)
        end = m.get("foreseen", m["t1"])
        share = 0.0
        if m["kind"] >= PRIMITIVE_0:
            share = min(1.0, (time - m["t0"]) / (end - m["t0"]))
        xy, deg = self.world.graph.xy_m, self.world.graph.heading_deg
        (x0, y0), (x1, y1) = xy[m["from_place"]].tolist(), xy[m["to_place"]].tolist()
        h0, h1 = deg[m["from_heading"]], deg[m["to_heading"]]
        turn = h1 - h0
        while turn >= 180:
            turn -= 360
        while turn < -180:
            turn += 360
        return x0 + (x1 - x0) * share, y0 + (y1 - y0) * share, (h0 + turn * share) % 360

    def last(self, rows: list[dict[str, Any]], v: int, time: float) -> dict[str, Any] | None:
        """The last row of a vehicle up to a time."""
        found = None
        for row in rows:
            if row["vehicle"] == v and row["tick"] <= time:
                found = row
        return found

    def charge(self, v: int, time: float) -> int:
        """Charge of the latest sample."""
        row = self.last(self.battery, v, time)
        assert row is not None
        return int(row["charge_mc"])

    def distance_m(self, v: int, time: float) -> float:
        """Length driven up to a time, a motion under way in part."""
        total = 0.0
        for m in self.intervals:
            if m["vehicle"] == v and m["kind"] >= PRIMITIVE_0 and m["t0"] < time:
                end = m.get("foreseen", m["t1"])
                share = min(1.0, (time - m["t0"]) / (end - m["t0"]))
                total += round(self.world.graph.primitives[m["kind"] - PRIMITIVE_0].length_mm) * share
        return total / 1000

    def waiting_s(self, v: int, time: float) -> float:
        """Time waited up to a time."""
        kinds = (Activity.WAIT, Activity.PAUSE)
        spans = [m for m in self.intervals if m["vehicle"] == v and m["kind"] in kinds]
        return sum(max(0.0, min(time, m["t1"]) - m["t0"]) for m in spans) * self.tick_s

    def shares(self, t0: float, t1: float) -> dict[str, float]:
        """Share of the fleet's time in [t0, t1] by activity."""
        sums = dict.fromkeys(["moving", *sorted(set(GROUPS.values()))], 0.0)
        for m in self.intervals:
            group = "moving" if m["kind"] >= PRIMITIVE_0 else GROUPS[m["kind"]]
            sums[group] += max(0.0, min(m["t1"], t1) - max(m["t0"], t0))
        total = sum(sums.values())
        return {name: value / total for name, value in sums.items()}

    def held(self, place: int, t0: float, t1: float) -> float:
        """Share of [t0, t1] during which a place is held."""
        spans = [m for m in self.intervals if place in (m["from_place"], m["to_place"])]
        return sum(max(0.0, min(m["t1"], t1) - max(m["t0"], t0)) for m in spans) / (t1 - t0)

    def orders(self, time: float) -> dict[int, tuple[str, int, int]]:
        """Order → state, vehicle (-1 none), tick of creation."""
        found: dict[int, tuple[str, int, int]] = {}
        for row in self.orders_rows:
            if row["tick"] <= time:
                created = found[row["order"]][2] if row["order"] in found else row["tick"]
                found[row["order"]] = (OrderState(row["state"]).name.lower(), row["vehicle"], created)
        return found
