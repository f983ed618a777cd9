"""Compare: two to four runs of one scenario and seed beside each other, on one clock."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import dash
import dash_mantine_components as dmc
import numpy as np
from dash import ClientsideFunction, Input, Output, State, dcc, html, no_update

from app import figures
from app.api import run_ids_in
from app.comparing import FEWEST, LETTERS, MOST, Comparisons, Side, label, parting_words
from app.components.basics import action_button, badge, empty, section, span
from app.components.graphs import chart
from app.ids import Compare, Shell
from app.pages import data
from app.pages.base import Page, Query
from app.pages.operate import KIND_OF_STATUS
from app.runs import RunManager
from app.theme import LIGHT
from engine.errors import BadInput, WattlaneError
from engine.units import clock, seconds

if TYPE_CHECKING:
    from engine.studies.base import Beside

POINTS = 400
TICK_MS = 1500
DEFAULT_LENGTH = "1h"


def start_address(runs: Beside) -> str:
    """The start form filled with these runs."""
    known = {
        "scenario": runs.scenario,
        "planners": ",".join(runs.planners),
        "length": runs.length,
        "seed": "" if runs.seed is None else str(runs.seed),
        "set": "\n".join(f"{key} = {json.dumps(value)}" for key, value in runs.changes.items()),
    }
    return f"/compare?{urlencode({key: value for key, value in known.items() if value}, safe=':,')}"


def layout(manager: RunManager, beside: Comparisons, query: Query) -> html.Div:
    """The runs of an address beside each other; without runs, how to choose or start some."""
    run_ids = run_ids_in(query.get("runs", ""))
    if not run_ids:
        return start_page(manager, query)
    return stage(beside, beside.checked(run_ids))


# -- runs beside each other -------------------------------------------------------------------------------------------


def stage(beside: Comparisons, sides: Sequence[Side]) -> html.Div:
    """A map per run, the curves below, one transport bar."""
    ends = beside.ends(sides)
    first = sides[0].manifest
    config = {
        "runs": [
            {"letter": letter, "run": one.run_id, "label": label(one), "fleet": one.manifest["fleet"]}
            for letter, one in zip(LETTERS, sides, strict=False)
        ],
        "t_end": max(ends),
        "tick_s": float(first["tick_s"]),
        "nonce": time.time(),
    }
    found = beside.parting(sides)
    runs = ",".join(one.run_id for one in sides)
    alive = any(one.manifest["alive"] for one in sides)
    head = html.Header(
        [
            html.H1(f"{first.get('title') or first['scenario']}, seed {first['seed']}"),
            html.P(parting_words(found, min(ends)), id=Compare.PARTING),
            html.Button(
                "Go to the first divergence", id=Compare.GOTO, type="button", className="wl-button small primary",
                hidden=found is None, **{"data-action": '{"action": "parting"}'},
            ),
            html.A(
                "One .rrd of all", href=f"/api/compare/rrd?runs={runs}", className="wl-button small", download="",
            ),
            dcc.Link("Other runs", href="/runs", className="wl-button small"),
            dcc.Link("New comparison", href="/compare", className="wl-button small"),
        ],
        className="wl-compare-head",
    )  # fmt: skip
    charts = [
        chart(Compare.ORDERS, "Orders done"),
        chart(Compare.ENERGY, "Energy drawn"),
        chart(Compare.WAITING, "Waiting, all vehicles"),
    ]
    return html.Div(
        [
            dcc.Store(id=Compare.CONFIG, data=config),
            dcc.Store(id=Compare.BOUND),
            dcc.Store(id=Compare.DRAWN),
            dcc.Interval(id=Compare.TICK, interval=TICK_MS, disabled=not alive),
            head,
            html.Div(progress(beside.manager, sides), id=Compare.PROGRESS, className="wl-compare-progress"),
            html.Div(
                [run_map(letter, one) for letter, one in zip(LETTERS, sides, strict=False)],
                className="wl-compare-maps",
                **{"data-runs": str(len(sides))},
            ),
            html.Div(id=Compare.LEGEND),
            html.Section(charts, className="wl-compare-strip", **{"aria-label": "Differences over time"}),
            html.Div(id="transport", className="wl-transport mine", role="toolbar", **{"aria-label": "Time"}),
        ],
        className="wl-compare",
    )


def run_map(letter: str, one: Side) -> html.Section:
    """One run: what it is, what it has come to at the moment shown, its map."""
    name = one.manifest.get("name")
    parent = one.manifest.get("parent")
    origin = f"forked at tick {parent['tick']}" if parent else None
    words = [html.Small(word) for word in (name, origin) if word]
    return html.Section(
        [
            html.Header(
                [
                    html.H2([f"{letter} · ", dcc.Link(label(one), href=f"/replay?run={one.run_id}")]),
                    *words,
                    html.Div(id=f"{Compare.NUMBERS}-{letter}", className="wl-compare-numbers"),
                ]
            ),
            html.Div(id=f"{Compare.MAP}-{letter}"),
        ],
        className="wl-compare-run",
        **{"data-letter": letter, "aria-label": f"Run {letter}: {label(one)}"},
    )


def progress(manager: RunManager, sides: Sequence[Side]) -> list[Any]:
    """How far each run is while one of them is still going on; nothing afterwards."""
    statuses = [manager.status(one.run_id) for one in sides]
    if not any(status["alive"] for status in statuses):
        return []
    return [_progress(letter, *pair) for letter, *pair in zip(LETTERS, sides, statuses, strict=False)]


def _progress(letter: str, one: Side, status: Mapping[str, Any]) -> html.Div:
    at, until = float(status.get("sim_s") or 0.0), one.scenario.time.until_s
    share = 1.0 if not status["alive"] else min(1.0, at / until) if until else None
    phase = str(status.get("phase") or "")
    words = f"{letter} · {label(one)}: {clock(at)}" + (f" of {clock(until)}" if until else "")
    if status["alive"] and phase and phase != "running":
        words = f"{letter} · {label(one)}: {phase} …"
    state = "running" if status["alive"] else str(status["status"])
    more: list[Any] = [badge(state, KIND_OF_STATUS.get(state, "dim"))]
    if status["alive"]:
        gone = (datetime.now(UTC) - datetime.fromisoformat(str(one.manifest["created"]))).total_seconds()
        if share and share > 0.02:
            more.append(html.Small(f"{span(gone)} elapsed, about {span(gone * (1 - share) / share)} remaining"))
        more.append(action_button("Stop…", {"action": "stop", "run": one.run_id, "label": f"run {letter}"}))
    bar: Any = html.Div()
    if share is not None:
        bar = dmc.Progress(value=100 * share, size="md", **{"aria-label": f"Progress of run {letter}"})
    return html.Div([html.Span(words), bar, html.Div(more, className="wl-row")])


def draw(curves: Mapping[str, Any], parting_s: float | None, scheme: str) -> list[Any]:
    """The three charts of the strip: orders, energy, waiting."""
    drawn = []
    for key, small, large, least, nothing in (
        ("orders_done", ("", 1.0), ("", 1.0), np.inf, "No order is done in these runs"),
        ("energy_j", ("kJ", 1e3), ("MJ", 1e6), 1e7, ""),
        ("waiting_s", ("s", 1.0), ("h", 3600.0), 7200.0, "Nobody waits in these runs"),
    ):
        runs = {letter: np.asarray(run[key], np.float64) for letter, run in curves["runs"].items()}
        most = max((float(np.nanmax(run, initial=0.0)) for run in runs.values()), default=0.0)
        unit, scale = large if most > least else small
        scaled = {letter: run / scale for letter, run in runs.items()}
        drawn.append(
            figures.comparing_figure(
                key, curves["t_s"], scaled, unit=unit, nothing=nothing, parting_s=parting_s, scheme=scheme
            )
        )
    return drawn


# -- choosing and starting --------------------------------------------------------------------------------------------


def start_page(manager: RunManager, query: Query) -> html.Div:
    """What can be done where there are no runs yet: choose some, or start them here."""
    filled = bool(query.get("scenario"))
    said = empty(
        "Compare runs",
        "Choose two to four recorded runs of one scenario and seed, or start them here: they run as fast as they go, "
        "are recorded, and open beside each other.",
        dcc.Link("Choose recorded runs", href="/runs", className="wl-button" if filled else "wl-button primary"),
    )
    form = section("Start runs to compare", start_form(manager, query))
    return html.Div([html.Div([said, form], className="wl-compare-start")], className="wl-scroll")


def start_form(manager: RunManager, query: Query) -> html.Div:
    """Scenario, planners, seed, length; what the address says is filled in."""
    known = data.scenarios(manager)
    scenario = query.get("scenario") if query.get("scenario") in known else next(iter(known), None)
    return html.Div(
        [
            dcc.Store(id=Compare.ASKED, data=dict(query)),
            dmc.Select(
                id=Compare.SCENARIO,
                label="Scenario",
                data=[{"value": name, "label": title or name} for name, title in known.items()],
                value=scenario,
                allowDeselect=False,
                size="xs",
                className="whole",
            ),
            html.Div(
                dmc.MultiSelect(id=Compare.PLANNERS, label="Planners, two to four", maxValues=MOST, size="xs"),
                className="whole",
            ),
            dmc.NumberInput(id=Compare.SEED, label="Seed", min=0, allowDecimal=False, size="xs"),
            dmc.TextInput(
                id=Compare.LENGTH,
                label="Length, such as 10min, 1h",
                value=query.get("length", DEFAULT_LENGTH),
                size="xs",
            ),
            dmc.Textarea(
                id=Compare.CHANGES,
                label="Other parameters, of all of them",
                description="One per line, such as fleet.count = 20",
                value=query.get("set", ""),
                autosize=True,
                minRows=1,
                maxRows=8,
                size="xs",
                className="whole",
            ),
            html.Div(id=Compare.ERROR, className="wl-error whole", role="alert"),
            dmc.Button("Start and compare", id=Compare.START, size="sm", className="whole"),
        ],
        className="wl-form",
    )


def choices(manager: RunManager, scenario: str) -> list[dict[str, str]]:
    """Planners that serve a scenario, once for each objective that they have there."""
    return [
        {"value": f"{name}:{objective}", "label": name if len(known) == 1 else f"{name}, least {objective}"}
        for name, known in manager.scenarios.planners(scenario).items()
        for objective in known
    ]


def chosen(asked: str | None, offered: Sequence[Mapping[str, str]], own: str) -> list[str]:
    """The choices that an address names (`name` or `name:objective`); else the scenario's planner and another one."""
    values = [choice["value"] for choice in offered]
    found = []
    for word in (asked or "").split(","):
        fits = [value for value in values if word in (value, value.partition(":")[0])]
        found += [value for value in fits[:1] if value not in found]
    if not found:
        found = sorted(values, key=lambda value: value != own)[:FEWEST]
    return found[:MOST]


def start(
    manager: RunManager, scenario: str, wanted: Sequence[str], seed: Any, length: str, changes: str = ""
) -> list[str]:
    """Starts a run per planner, as fast as it goes; returns their ids. Raises WattlaneError before any is started.

    changes: `key = value` lines over the scenario.
    """
    from app import runner

    if not FEWEST <= len(wanted) <= MOST:
        raise BadInput(f"two to four planners were expected; got {len(wanted)}")
    until_s = seconds((length or "").strip())
    whole = int(seed) if seed not in (None, "") else None
    overrides: dict[str, object] = {**data.overrides_from(changes), "time.until_s": until_s}
    asked = [dict(zip(("planner", "objective"), one.partition(":")[::2], strict=True)) for one in wanted]
    for one in asked:
        checked = runner.asked_scenario(scenario, overrides, seed=whole, library=manager.scenarios, **one)
        runner.checked_until(checked, until_s)
    return [manager.start(scenario, seed=whole, overrides=overrides, speed=0, **one) for one in asked]


# -- callbacks --------------------------------------------------------------------------------------------------------


def register(app: dash.Dash, manager: RunManager) -> None:
    """The curves, the progress of runs that still go on, and the start form."""
    beside = Comparisons(manager)
    register_stage(app, beside)
    register_form(app, manager)


def register_stage(app: dash.Dash, beside: Comparisons) -> None:
    @app.callback(
        Output(Compare.ORDERS, "figure"),
        Output(Compare.ENERGY, "figure"),
        Output(Compare.WAITING, "figure"),
        Output(Compare.PROGRESS, "children"),
        Output(Compare.TICK, "disabled"),
        Output(Compare.DRAWN, "data"),
        Input(Compare.CONFIG, "data"),
        Input(Shell.THEME, "data"),
        Input(Compare.TICK, "n_intervals"),
        State(Compare.DRAWN, "data"),
    )
    def refresh(config: Any, scheme: Any, ticks: int | None, drawn: Any) -> Any:
        if not config or scheme is None:
            return (no_update,) * 6
        try:
            sides = beside.sides([run["run"] for run in config["runs"]])
            alive = any(one.manifest["alive"] for one in sides)
            ends = beside.ends(sides)
            now = [ends, scheme, alive, config["nonce"]]
            bars = progress(beside.manager, sides)
            over = not alive and bool(drawn) and not drawn[2]  # once more after the end: the last rows come with it
            if now == drawn:
                return (*(no_update,) * 3, bars, over, no_update)
            found = beside.parting(sides)
            curves = beside.curves(sides, POINTS)
        except WattlaneError as error:
            return (*(no_update,) * 3, html.P(str(error), className="wl-error", role="alert"), True, no_update)
        when = None if found is None else found["time_s"]
        return (*draw(curves, when, scheme if isinstance(scheme, str) else LIGHT), bars, over, now)

    app.clientside_callback(
        ClientsideFunction("wattlane", "bindCompare"), Output(Compare.BOUND, "data"), Input(Compare.CONFIG, "data")
    )
    app.clientside_callback(
        ClientsideFunction("wattlane", "compareDrawn"), Input(Compare.DRAWN, "data"), prevent_initial_call=True
    )


def register_form(app: dash.Dash, manager: RunManager) -> None:
    @app.callback(
        Output(Compare.PLANNERS, "data"),
        Output(Compare.PLANNERS, "value"),
        Output(Compare.SEED, "value"),
        Output(Compare.ERROR, "children"),
        Input(Compare.SCENARIO, "value"),
        State(Compare.ASKED, "data"),
    )
    def fill(name: str | None, asked: Any) -> Any:
        if not name:
            return (no_update,) * 4
        try:
            offered = choices(manager, name)
            scenario = manager.scenarios.load(name)
        except WattlaneError as error:
            return no_update, no_update, no_update, str(error)
        here = asked if asked and asked.get("scenario") == name else {}
        seed = str(here.get("seed", ""))
        own = f"{scenario.planner.name}:{scenario.planner.objective}"
        picked = chosen(here.get("planners"), offered, own)
        return offered, picked, int(seed) if seed.isdigit() else scenario.seed, None

    @app.callback(
        Output(Compare.ERROR, "children", allow_duplicate=True),
        Output(Shell.URL, "href", allow_duplicate=True),
        Input(Compare.START, "n_clicks"),
        State(Compare.SCENARIO, "value"),
        State(Compare.PLANNERS, "value"),
        State(Compare.SEED, "value"),
        State(Compare.LENGTH, "value"),
        State(Compare.CHANGES, "value"),
        prevent_initial_call=True,
        running=[(Output(Compare.START, "loading"), True, False)],
    )
    def begin(
        clicks: int | None, scenario: str, wanted: list[str] | None, seed: Any, length: str, changes: str
    ) -> tuple[Any, Any]:
        if not clicks:
            return no_update, no_update
        try:
            runs = start(manager, scenario, wanted or [], seed, length, changes)
        except WattlaneError as error:
            return str(error), no_update
        except OSError as error:
            return f"the disk refused: {error.strerror or error}", no_update
        return None, f"/compare?runs={','.join(runs)}"


PAGE = Page(
    "Compare",
    "/compare",
    ("/compare",),
    lambda manager, settings, path, query: layout(manager, Comparisons(manager), query),
    lambda app, manager, settings: register(app, manager),
)
