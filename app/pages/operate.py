"""Operate: start runs, watch them live, and command them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import ClientsideFunction, Input, Output, State, dcc, html, no_update

from app.components.basics import action_button, badge, empty, facts, section
from app.ids import Operate, Shell, Start
from app.library import fleet_overrides
from app.pages import data
from app.pages import stage as stage_page
from app.pages.base import Page, opened
from app.runs import RunManager
from engine.build import ROAMING
from engine.errors import WattlaneError
from engine.results.ground import ground_of

LEVEL_NAMES = ("critical", "good", "sufficient", "full", "reserve")
RUNS_SHOWN = 12
GOALS = "goals"
"""The source of orders of an instance: every vehicle has its goal, and there are no orders."""


def layout(manager: RunManager, settings: Any, run_id: str | None) -> html.Div:
    """The page for a run; without one, for the newest live run, or an empty state. Raises NoSuchRun."""
    if run_id is None:
        live = manager.live()
        run_id = live[-1] if live else None
    form = start_form(manager, settings.scenario)
    if run_id is None:
        return html.Div(
            [
                html.Div(
                    empty(
                        "Nothing is running", "Choose a scenario and start a run; it is recorded from its first tick."
                    ),
                    style={"marginBottom": "0"},
                ),
                html.Div(
                    [
                        section("Start a run", form),
                        section("Runs", html.Div(run_list(manager.list(), None), id=Operate.RUNS)),
                    ],
                    style={"maxWidth": "460px", "margin": "0 auto"},
                ),
            ],
            className="wl-scroll",
        )
    status = manager.status(run_id)

    def read(view: Any) -> tuple[dict[str, float], float, list[dict[str, Any]], bool]:
        ground = ground_of(view) is not None
        stations = [] if ground else view.world.floor_json()["stations"]
        return dict(view.thresholds(view.t_end)._asdict()), float(view.t_end), stations, ground

    levels, end, stations, ground = manager.read(run_id, read)
    orders = ground_commands() if ground else commands(stations, levels, manager.scenario(run_id))
    left = [
        section("This run", passport(status), html.Div(lifecycle(status), className="wl-row")),
        section("Commands", orders) if status["alive"] else None,
        section("Start a run", form, opened=not status["alive"]),
        section("Runs", html.Div(run_list(manager.list(), run_id), id=Operate.RUNS)),
    ]
    return stage_page.layout(status, "operate", levels, left, end * float(status["tick_s"]), ground=ground)


def passport(status: Mapping[str, Any]) -> html.Dl:
    """What a run is: scenario, planner, seed, parent."""
    parent = status.get("parent")
    origin = (
        dcc.Link(f"{parent['run_id']} at tick {parent['tick']}", href=f"/replay?run={parent['run_id']}")
        if parent
        else None
    )
    return facts(
        [
            ("Name", status.get("name")),
            ("Scenario", status.get("title") or status.get("scenario")),
            (
                "Planner",
                f"{status['planner']}, least {status['objective']}" if status.get("objective") else status["planner"],
            ),
            ("Dispatcher", None if status["planner"] in ROAMING else status.get("dispatcher")),
            ("Fleet", "1 robot" if status["planner"] in ROAMING else f"{status['fleet']} vehicles"),
            ("Seed", str(status["seed"])),
            ("Forked from", origin),
            ("Run", html.Code(status["run_id"], style={"fontSize": "11px", "wordBreak": "break-all"})),
        ]
    )


def lifecycle(status: Mapping[str, Any]) -> list[Any]:
    """Buttons for the life of a run."""
    about = {"run": status["run_id"], "label": status.get("name") or status["run_id"]}
    look = dcc.Link("Replay", href=f"/replay?run={status['run_id']}", className="wl-button small")
    if status["alive"]:
        return [action_button("Stop…", {"action": "stop", **about}), look]
    resume = action_button("Resume", {"action": "resume", **about}, kind="primary") if status["resumable"] else None
    return [resume, look]


def start_form(manager: RunManager, scenario: str | None) -> html.Div:
    """Scenario, planner, fleet size, seed, order rate, and further parameters as lines."""
    known = data.scenarios(manager)
    chosen = scenario if scenario in known else next(iter(known), None)
    return html.Div(
        [
            dmc.Select(
                id=Start.SCENARIO,
                label="Scenario",
                data=[{"value": name, "label": title or name} for name, title in known.items()],
                value=chosen,
                allowDeselect=False,
                size="xs",
                className="whole",
            ),
            dmc.Select(id=Start.PLANNER, label="Planner", data=data.planners(), allowDeselect=False, size="xs"),
            dmc.Select(id=Start.OBJECTIVE, label="Objective", data=["time", "energy"], allowDeselect=False, size="xs"),
            dmc.Select(
                id=Start.DISPATCHER,
                label="Dispatcher",
                data=data.dispatchers(),
                allowDeselect=False,
                size="xs",
                className="whole",
            ),
            dmc.NumberInput(id=Start.FLEET, label="Vehicles", min=1, max=5000, allowDecimal=False, size="xs"),
            dmc.NumberInput(id=Start.SEED, label="Seed", min=0, allowDecimal=False, size="xs"),
            dmc.NumberInput(id=Start.RATE, label="Orders per hour", min=0, size="xs", className="whole"),
            dmc.Textarea(
                id=Start.MORE,
                label="Further parameters",
                description="One per line, such as battery.capacity_wh = 800",
                autosize=True,
                minRows=2,
                maxRows=8,
                size="xs",
                className="whole",
            ),
            html.Details(
                [
                    html.Summary("All parameters", style={"fontSize": "12px", "cursor": "pointer"}),
                    html.Div(id=Start.KEYS),
                ],
                className="whole",
            ),
            html.Div(id=Start.ERROR, className="wl-error whole", role="alert"),
            dmc.Button("Start", id=Start.BUTTON, size="sm", className="whole"),
        ],
        className="wl-form",
    )


def commands(stations: Sequence[Mapping[str, Any]], levels: Mapping[str, float], scenario: Any) -> html.Div:
    """New order, order rate (neither where vehicles drive to goals), charging levels."""
    choices = [{"value": str(s["number"]), "label": f"{s['name']} ({s['kind']})"} for s in stations]
    rate = getattr(scenario.orders, "rate_per_h", None)
    orders = [
        dmc.Select(id=Operate.ORDER_FROM, label="Order from", data=choices, searchable=True, size="xs"),
        dmc.Select(id=Operate.ORDER_TO, label="to", data=choices, searchable=True, size="xs"),
        dmc.Button("Give the order", id=Operate.ORDER_BUTTON, size="xs", variant="light", className="whole"),
        dmc.NumberInput(
            id=Operate.RATE, label="Orders per hour", value=rate if rate is not None else "", min=0, size="xs"
        ),
        dmc.Button("Change rate", id=Operate.RATE_BUTTON, size="xs", variant="light", style={"alignSelf": "end"}),
    ]
    return html.Div(
        [
            *([] if scenario.orders.source == GOALS else orders),
            html.Details(
                [
                    html.Summary("Charging levels", style={"fontSize": "13px", "cursor": "pointer"}),
                    html.Div(
                        [
                            *(
                                dmc.NumberInput(
                                    id=f"{Operate.LEVELS}-{name}",
                                    label=f"{name.capitalize()} %",
                                    value=round(100 * levels[name], 1),
                                    min=0,
                                    max=100,
                                    size="xs",
                                )
                                for name in LEVEL_NAMES
                            ),
                            dmc.Button(
                                "Change levels",
                                id=Operate.LEVELS_BUTTON,
                                size="xs",
                                variant="light",
                                style={"alignSelf": "end"},
                            ),
                        ],
                        className="wl-form",
                        style={"marginTop": "6px"},
                    ),
                ],
                className="whole",
            ),
            html.P("More on the map: right-click a vehicle, charger or cell.", className="wl-hint whole"),
        ],
        className="wl-form",
    )


def ground_commands() -> html.Div:
    """On terrain all commands are given on the map or with what is selected."""
    hints = (
        "On the map: right-click a cell (or press long) to drop or remove an obstacle, or to send the robot there; "
        "right-click the robot to pause it or to let it break down.",
        "The robot learns of an obstacle when it sees it, and repairs its way.",
    )
    return html.Div([html.P(hint, className="wl-hint") for hint in hints])


KIND_OF_STATUS = {
    "running": "ok",
    "finished": "dim",
    "stopped": "dim",
    "interrupted": "warn",
    "failed": "bad",
}


def run_list(runs: Sequence[Mapping[str, Any]], current: str | None) -> Any:
    """The newest runs, live ones first, as links."""
    if not runs:
        return html.P("No runs yet. The first one appears here when it is started.", className="wl-hint")
    ordered = sorted(runs, key=lambda r: not r["alive"])[:RUNS_SHOWN]
    items = []
    for run in ordered:
        page = "operate" if run["alive"] else "replay"
        status = "running" if run["alive"] else str(run.get("status"))
        items.append(
            html.Li(
                dcc.Link(
                    [
                        run.get("name") or run.get("title") or run["run_id"],
                        " ",
                        badge("live" if run["alive"] else status, KIND_OF_STATUS.get(status, "dim")),
                        html.Small(f"{run.get('planner')}, seed {run.get('seed')} · {run['run_id']}"),
                    ],
                    href=f"/{page}?run={run['run_id']}",
                ),
                className="current" if run["run_id"] == current else "",
            )
        )
    more = dcc.Link(f"All {len(runs)} runs", href="/runs") if len(runs) > RUNS_SHOWN else None
    return html.Div([html.Ul(items, className="wl-runs"), more])


def started(manager: RunManager, values: Mapping[str, Any]) -> str:
    """Starts the run that the form describes; returns its id. Raises WattlaneError with the sentence to show."""
    overrides = data.overrides_from(values["more"])
    scenario = manager.scenarios.load(values["scenario"])
    changes = {} if values["fleet"] in (None, "") else fleet_overrides(scenario, values["fleet"])
    if scenario.orders.source != GOALS and values["rate"] not in (None, "", scenario.orders.rate_per_h):
        changes["orders.rate_per_h"] = values["rate"]
    if values["dispatcher"] and scenario.floor.kind != "terrain":
        changes["dispatch.policy"] = values["dispatcher"]
    overrides = {**changes, **overrides}
    seed = values["seed"]
    return manager.start(
        values["scenario"],
        seed=int(seed) if seed not in (None, "") else None,
        planner=values["planner"] or None,
        objective=values["objective"] or None,
        overrides=overrides,
    )


def shown(value: Any) -> str:
    """A parameter's value, shortened."""
    text = "none" if value in (None, "") else str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def register(app: dash.Dash, manager: RunManager) -> None:
    """The start form, the list of runs, and the command forms (which run in the browser)."""

    @app.callback(
        Output(Start.PLANNER, "value"),
        Output(Start.PLANNER, "data"),
        Output(Start.OBJECTIVE, "value"),
        Output(Start.OBJECTIVE, "data"),
        Output(Start.DISPATCHER, "value"),
        Output(Start.DISPATCHER, "style"),
        Output(Start.FLEET, "value"),
        Output(Start.FLEET, "disabled"),
        Output(Start.SEED, "value"),
        Output(Start.RATE, "value"),
        Output(Start.RATE, "disabled"),
        Output(Start.RATE, "style"),
        Output(Start.KEYS, "children"),
        Output(Start.ERROR, "children"),
        Input(Start.SCENARIO, "value"),
    )
    def fill(name: str | None) -> Any:
        if not name:
            return (no_update,) * 14
        try:
            known = data.scenario_values(manager, name)
            served = manager.scenarios.planners(name)
        except WattlaneError as error:
            return (*(no_update,) * 13, str(error))
        rate = known["orders.rate_per_h"]["value"]
        source = known["orders.source"]["value"]
        hidden = {"display": "none"} if source == GOALS else {}
        ground = known["floor.kind"]["value"] == "terrain"  # one robot, and nobody to dispatch
        no_dispatch = {"display": "none"} if ground else {}
        keys = html.Dl(
            [
                part
                for key, row in known.items()
                if "." in key and not (source == GOALS and key.startswith("orders."))
                for part in (html.Dt(html.Code(key)), html.Dd(f"{row['description']} · {shown(row['value'])}"))
            ],
            style={"fontSize": "12px", "maxHeight": "220px", "overflow": "auto"},
        )
        planner, objective = known["planner.name"]["value"], known["planner.objective"]["value"]
        objectives = served.get(planner) or ["time", "energy"]
        first = (planner, list(served), objective, objectives, known["dispatch.policy"]["value"], no_dispatch)
        first = (*first, known["fleet.count"]["value"], ground)
        shown_rate = "" if rate is None else rate
        return (*first, known["seed"]["value"], shown_rate, source != "poisson", hidden, keys, None)

    @app.callback(
        Output(Start.ERROR, "children", allow_duplicate=True),
        Output(Shell.URL, "href", allow_duplicate=True),
        Input(Start.BUTTON, "n_clicks"),
        State(Start.SCENARIO, "value"),
        State(Start.PLANNER, "value"),
        State(Start.OBJECTIVE, "value"),
        State(Start.DISPATCHER, "value"),
        State(Start.FLEET, "value"),
        State(Start.SEED, "value"),
        State(Start.RATE, "value"),
        State(Start.MORE, "value"),
        prevent_initial_call=True,
        running=[(Output(Start.BUTTON, "loading"), True, False)],
    )
    def start(clicks: int | None, *values: Any) -> tuple[Any, Any]:
        if not clicks:
            return no_update, no_update
        names = ("scenario", "planner", "objective", "dispatcher", "fleet", "seed", "rate", "more")
        return opened(lambda: started(manager, dict(zip(names, values, strict=True))))

    @app.callback(
        Output(Operate.RUNS, "children"),
        Input(Shell.RUNS_CHANGED, "data"),
        State(Shell.URL, "href"),
        prevent_initial_call=True,
    )
    def runs(_: Any, href: str | None) -> Any:
        return run_list(manager.list(), None)

    levels = [State(f"{Operate.LEVELS}-{name}", "value") for name in LEVEL_NAMES]
    for name, button, states in (
        ("newOrder", Operate.ORDER_BUTTON, [State(Operate.ORDER_FROM, "value"), State(Operate.ORDER_TO, "value")]),
        ("rate", Operate.RATE_BUTTON, [State(Operate.RATE, "value")]),
        ("levels", Operate.LEVELS_BUTTON, levels),
    ):
        app.clientside_callback(
            ClientsideFunction("wattlane", name), Input(button, "n_clicks"), *states, prevent_initial_call=True
        )


PAGE = Page(
    "Operate",
    "/operate",
    ("/", "/operate"),
    lambda manager, settings, path, query: layout(manager, settings, query.get("run")),
    lambda app, manager, settings: register(app, manager),
)
