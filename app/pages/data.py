"""What the pages ask of the run manager and the scenarios, at one instant of one run. No Dash here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from app.figures.reservations import ribbon_rows
from app.runs import RunManager
from engine.results.ground import Ground, ground_of
from engine.world.network import NetworkWorld

POINTS = 240
EVENT_ROWS = 300
MARKS = 400
SPANS: dict[str, float] = {"600": 600.0, "3600": 3600.0, "28800": 28800.0, "0": 0.0}
"""Span of the charts in seconds by the value of its control; 0 is the whole run."""
LANES_S = (600.0, 120.0)
"""Of the reservations: so far back, and so far ahead."""
HOUR_S = 3600.0
LINES_FOR = 400
"""Fleets up to this size send a curve of charge per vehicle."""


@dataclass(frozen=True)
class Asked:
    """What one update of the page wants to know."""

    run_id: str
    time_s: float | None  # None: now
    tab: str
    span_s: float = 3600.0
    selection: dict[str, Any] | None = None
    parts: frozenset[str] = frozenset()

    @property
    def vehicle(self) -> int | None:
        chosen = self.selection or {}
        return chosen["id"] if chosen.get("kind") == "vehicle" else None


def known_selection(asked: Any) -> dict[str, Any] | None:
    """What the browser says is selected, when it is well formed."""
    if not isinstance(asked, dict) or asked.get("kind") not in ("vehicle", "station", "charger", "place"):
        return None
    number = asked.get("id")
    return asked if isinstance(number, int) and not isinstance(number, bool) and number >= 0 else None


@dataclass
class Told:
    """The answer: plain values and arrays, computed while the view was held."""

    time_s: float
    end_s: float
    tick_s: float
    levels: dict[str, float]
    ground: bool = False  # the run is on terrain
    values: dict[str, Any] = field(default_factory=dict)


def look(manager: RunManager, asked: Asked) -> Told:
    """Everything the open tab and the side panel show of a run at an instant. Raises NoSuchRun, RunError."""
    tick_s = float(manager.manifest(asked.run_id)["tick_s"])

    def ask(view: Any) -> Told:
        end = float(view.t_end)
        at = end if asked.time_s is None else min(max(0.0, asked.time_s / tick_s), end)
        told = Told(at * tick_s, end * tick_s, tick_s, dict(view.thresholds(at)._asdict()))
        since = max(0.0, at - asked.span_s / tick_s) if asked.span_s else 0.0
        told.values["since_s"] = since * tick_s
        _side(view, at, asked, told)
        _tab(view, since, at, asked, told)
        told.ground = ground_of(view) is not None
        told.values["blocked"] = blocked_places(view, at)
        told.values["chargers_out"] = [c["place"] for c in view.chargers(at) if c["state"] == "out of order"]
        if "marks" in asked.parts:
            told.values["marks"] = marks(view, end)
        return told

    told = manager.read(asked.run_id, ask)
    if "kpis" in told.values:
        told.values["ways"] = manager.ways_beside(asked.run_id, told.time_s / tick_s)
    return told


def _side(view: Any, at: float, asked: Asked, told: Told) -> None:
    ground = ground_of(view)
    if asked.selection is None:
        if ground is None:
            told.values["kpis"] = view.kpis(at)
        else:
            told.values["robot"] = robot(view, ground, at)
        return
    told.values["fleet"] = view.fleet(at)
    told.values["place_name"] = {}
    place = asked.selection.get("place")
    if isinstance(place, int) and 0 <= place < view.world.graph.n_places:
        told.values["place_name"] = {place: view.world.place_name(place)}
        if isinstance(view.world, NetworkWorld):
            told.values["place_title"] = view.world.label(place)
            told.values["arc"] = arc(view, place, at) if view.world.arc_of(place) >= 0 else None
        if ground is not None:
            told.values["cell"] = ground.cell(place, at)
    if asked.selection["kind"] == "charger":
        told.values["chargers"] = view.chargers(at)
    if asked.selection["kind"] == "station":
        told.values["orders"] = view.orders(at)


def robot(view: Any, ground: Ground, at: float) -> dict[str, Any]:
    """A robot on terrain: its search, power in W, energy in J by component, and its record in the fleet."""
    drawn = view.energy(0, at, 2)["components"]
    return {
        "search": ground.search(at),
        "watts": ground.watts(at),
        "energy": {name: float(values[-1]) for name, values in drawn.items()},
        "record": view.fleet(at)[0],
    }


def arc(view: Any, place: int, at: float) -> dict[str, float]:
    """What is known of one arc: expected_s, and over the last hour (or since the start) passages and occupancy."""
    found = view.arcs(max(0.0, at - HOUR_S / view.tick_s), at)
    return {name: float(values[place]) for name, values in found.items()}


def _tab(view: Any, since: float, at: float, asked: Asked, told: Told) -> None:
    values, tab = told.values, asked.tab
    if tab == "charts":
        if (ground := ground_of(view)) is not None:
            values["power"] = ground.power(since, at, POINTS)
            values["passes"] = ground.passes(since, at)
            values["objective"] = view.scenario.planner.objective
            values["energy"] = view.energy(since, at, 120)
            values["now_s"] = at * told.tick_s
            return
        few = view.n <= LINES_FOR
        values["soc"] = view.soc(since, at, POINTS if few else 120)
        values["occupancy"] = view.occupancy(since, at, 120)
        values["throughput"] = view.throughput(since, at, points=POINTS)
        values["energy"] = view.energy(since, at, 120)
    elif tab == "bands":
        values["bands"] = [(v, a * told.tick_s, b * told.tick_s, s) for v, a, b, s in view.bands(since, at)]
    elif tab == "reservations":
        before, ahead = (seconds / told.tick_s for seconds in LANES_S)
        values["lanes"] = (max(0.0, at - before), at + ahead)
        values["reservations"] = view.reservations(*values["lanes"])
        _, places = ribbon_rows(values["reservations"], *values["lanes"], asked.vehicle)
        values["place_names"] = {int(p): view.world.place_name(int(p)) for p in places}
    elif tab == "events":
        values["events"] = view.events(0, at, EVENT_ROWS)
    elif tab == "orders":
        values["orders"] = view.orders(at)
    elif tab == "chargers":
        values["fleet"] = values.get("fleet") or view.fleet(at)
        values["chargers"] = view.chargers(at)
    elif tab == "ways" and (ground := ground_of(view)) is not None:
        values["passes"] = ground.passes(-1, at)
        values["objective"] = view.scenario.planner.objective
    elif tab == "fleet":
        values["fleet"] = values.get("fleet") or view.fleet(at)


def blocked_places(view: Any, at: float) -> list[int]:
    """Places that are blocked at a tick, from the log."""
    blocks = view.reader.table("blocks")
    until = int(np.searchsorted(blocks["tick"], at, side="right"))
    state: dict[int, bool] = {}
    for place, blocked in zip(blocks["place"][:until].tolist(), blocks["blocked"][:until].tolist(), strict=True):
        state[int(place)] = bool(blocked)
    return [place for place, blocked in state.items() if blocked]


def marks(view: Any, end: float) -> list[dict[str, Any]]:
    """Moments for the time ruler: warnings and errors; all events where there are few."""
    events = view.events(0, end, 5 * MARKS)
    grave = [e for e in events if e["level"] > 0]
    chosen = events if len(events) <= MARKS else grave
    return [{"t": e["time_s"], "level": e["level"]} for e in chosen[:MARKS]]


def scenarios(manager: RunManager) -> dict[str, str]:
    """Built-in and imported scenarios: name → title."""
    return manager.scenarios.titles()


def scenario_values(manager: RunManager, name: str) -> dict[str, Any]:
    """Settable keys of a scenario with their values, for the form: key → record of engine.scenario.parameters."""
    import engine.scenario

    return {row["key"]: row for row in engine.scenario.parameters(manager.scenarios.load(name))}


def planners() -> list[str]:
    """Names of the registered planners."""
    import engine.build

    return [*engine.build.PLANNERS, *engine.build.ROAMING]


def dispatchers() -> list[str]:
    """Names of the registered dispatchers."""
    import engine.build

    return list(engine.build.DISPATCHERS)


def overrides_from(text: str | None) -> dict[str, object]:
    """`key = value` lines as overrides; values are TOML, bare words are texts. Raises BadInput naming the line."""
    import tomllib

    from engine.errors import BadInput

    found: dict[str, object] = {}
    for number, line in enumerate((text or "").splitlines(), start=1):
        line = line.split("#", 1)[0].strip()
        if not line:
            continue
        key, equals, value = (part.strip() for part in line.partition("="))
        if not equals or not key or not value:
            raise BadInput(f"line {number} of the parameters: `key = value` was expected; got {line!r}")
        try:
            found[key] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = value.strip("\"'")
    return found
