"""Scenarios: the library of floors with previews, what the checks found, import, and a start from here."""

from __future__ import annotations

import time
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import ClientsideFunction, Input, Output, State, dcc, html, no_update

from app.components import scenario_cards as cards
from app.components.basics import empty, section
from app.ids import Scenarios, Shell
from app.library import MAX_BYTES, Entry, Library, fleet_overrides, is_instance
from app.pages.base import Page, opened
from app.runs import RunManager
from engine.errors import BadInput, unknown_name


def layout(library: Library, asked: str | None, first: str | None) -> html.Div:
    """The library with a scenario chosen: the one asked for, else the first.

    A name that names none gets the list and a sentence.
    """
    entries = library.entries()
    chosen = asked or (first if first in library else entries[0].name)
    found = next((entry for entry in entries if entry.name == chosen), None)
    config = {
        "name": found.name if found and not found.error else None,
        "revision": found.revision if found else None,
        "limit_bytes": MAX_BYTES,
        "nonce": time.time(),
    }
    return html.Div(
        [
            dcc.Store(id=Scenarios.CONFIG, data=config),
            dcc.Store(id=Scenarios.BOUND),
            html.Aside(
                [
                    html.H1("Scenarios"),
                    html.Div(id=Scenarios.DROP),
                    html.Ul([cards.card(entry, entry is found) for entry in entries], className="wl-scn-cards"),
                ],
                className="wl-scn-list",
                **{"aria-label": "Library"},
            ),
            html.Div(
                [
                    html.Div(id=Scenarios.IMPORT, hidden=True),
                    html.Div(detail(library, found, str(chosen)), id=Scenarios.DETAIL),
                ],
                className="wl-scn-main",
            ),
        ],
        className="wl-scenarios",
    )


def detail(library: Library, entry: Entry | None, chosen: str) -> Any:
    """Everything about the chosen scenario."""
    if entry is None:
        sentence = f"{unknown_name('scenario', chosen[:80], library.names())}."
        return empty("No such scenario", sentence, dcc.Link("Show the first one", href="/scenarios"))
    if entry.error:
        return html.Div(
            [
                _head(library, entry),
                html.Div(entry.error, className="wl-error wl-scn-broken", role="alert"),
                section("TOML", *cards.toml_text(library.raw_text(entry.name))),
            ]
        )
    import engine.scenario

    scenario = library.load(entry.name)
    return html.Div(
        [
            _head(library, entry),
            html.Div(
                [
                    html.Section(
                        [
                            html.Div(id=Scenarios.MAP, className="wl-scn-map"),
                            html.Div(id=Scenarios.LEGEND, className="wl-legend wl-scn-legend"),
                        ],
                        className="wl-scn-stage",
                        **{"aria-label": "Preview"},
                    ),
                    html.Aside(
                        [
                            section("Start from here", start_form(library, entry.name, scenario)),
                            section("About", cards.passport(scenario, entry, library.about(entry.name))),
                        ],
                        className="wl-scn-side",
                        **{"aria-label": "Start and key numbers"},
                    ),
                ],
                className="wl-scn-body",
            ),
            section(
                "What the checks found",
                html.Ul(
                    html.Li("Checking…"), id=Scenarios.FINDINGS, className="wl-scn-findings", **{"aria-live": "polite"}
                ),
            ),
            section("Description", *cards.paragraphs(scenario.description)) if scenario.description else None,
            section("Parameters", cards.parameter_table(engine.scenario.parameters(scenario)), opened=False),
            section("TOML", *cards.toml_text(library.raw_text(entry.name)), opened=False),
        ]
    )


def _head(library: Library, entry: Entry) -> html.Div:
    links = [
        html.A(
            f"Download {file[file.rindex('.') :]}",
            href=f"/api/scenarios/{entry.name}/files/{file}",
            className="wl-button small",
            download=file,
            title=file,
        )
        for file in library.files(entry.name)
    ]
    changes = [
        cards.action("Rename…", "rename", entry.name),
        cards.action("Delete…", "delete", entry.name, danger=True),
    ]
    return html.Div(
        [
            html.Div(
                [html.H2(entry.title), html.Div([html.Code(entry.name), *cards.marks(entry)], className="wl-row")]
            ),
            html.Div([*links, *(changes if entry.imported else ())], className="wl-row"),
        ],
        className="wl-scn-head",
    )


def start_form(library: Library, name: str, scenario: Any) -> html.Div:
    """Planner, objective, vehicles and seed of a live run."""
    fits = library.planners(name)
    ground = scenario.floor.kind == "terrain"
    most = len(scenario.orders.goals) if is_instance(scenario) else 5000
    planner = scenario.planner.name if scenario.planner.name in fits else next(iter(fits), None)
    objectives = fits.get(planner or "", ["time", "energy"])
    objective = scenario.planner.objective
    hint = None if fits else html.P("No planner fits this floor.", className="wl-hint whole")
    return html.Div(
        [
            dcc.Store(id=Scenarios.NAME, data=name),
            dcc.Store(id=Scenarios.OBJECTIVES, data=fits),
            dmc.Select(
                id=Scenarios.PLANNER,
                label="Planner",
                data=list(fits),
                value=planner,
                allowDeselect=False,
                size="xs",
            ),
            dmc.Select(
                id=Scenarios.OBJECTIVE,
                label="Objective",
                data=objectives,
                value=objective if objective in objectives else objectives[0],
                allowDeselect=False,
                size="xs",
            ),
            dmc.NumberInput(
                id=Scenarios.FLEET,
                label="Robots" if ground else f"Vehicles (of {most})" if is_instance(scenario) else "Vehicles",
                disabled=ground,
                value=scenario.fleet.count,
                min=1,
                max=most,
                clampBehavior="none",
                allowDecimal=False,
                size="xs",
            ),
            dmc.NumberInput(id=Scenarios.SEED, label="Seed", value=scenario.seed, min=0, allowDecimal=False, size="xs"),
            hint,
            html.P(id=Scenarios.CAUTION, className="wl-hint whole", hidden=True),
            html.Div(id=Scenarios.ERROR, className="wl-error whole", role="alert"),
            dmc.Button("Start", id=Scenarios.START, size="sm", className="whole", disabled=not fits),
        ],
        className="wl-form",
    )


def started(manager: RunManager, name: str, planner: str | None, objective: str | None, fleet: Any, seed: Any) -> str:
    """Starts the run that the form describes; returns its id. Raises WattlaneError with the sentence to show."""
    if fleet in (None, ""):
        raise BadInput("vehicles: a whole number was expected")
    return manager.start(
        name,
        seed=int(seed) if seed not in (None, "") else None,
        planner=planner or None,
        objective=objective or None,
        overrides=fleet_overrides(manager.scenarios.load(name), int(fleet)),
    )


def register(app: dash.Dash, manager: RunManager) -> None:
    """The preview, which the browser draws, and the start."""
    app.clientside_callback(
        ClientsideFunction("wattlane", "scenarios"),
        Output(Scenarios.BOUND, "data"),
        Input(Scenarios.CONFIG, "data"),
    )

    app.clientside_callback(
        ClientsideFunction("wattlane", "objectives"),
        Output(Scenarios.OBJECTIVE, "data"),
        Output(Scenarios.OBJECTIVE, "value"),
        Input(Scenarios.PLANNER, "value"),
        State(Scenarios.OBJECTIVES, "data"),
        State(Scenarios.OBJECTIVE, "value"),
        prevent_initial_call=True,
    )

    @app.callback(
        Output(Scenarios.ERROR, "children"),
        Output(Shell.URL, "href", allow_duplicate=True),
        Input(Scenarios.START, "n_clicks"),
        State(Scenarios.NAME, "data"),
        State(Scenarios.PLANNER, "value"),
        State(Scenarios.OBJECTIVE, "value"),
        State(Scenarios.FLEET, "value"),
        State(Scenarios.SEED, "value"),
        prevent_initial_call=True,
        running=[(Output(Scenarios.START, "loading"), True, False)],
    )
    def start(clicks: int | None, name: str, *values: Any) -> tuple[Any, Any]:
        if not clicks:
            return no_update, no_update
        return opened(lambda: started(manager, name, *values))


PAGE = Page(
    "Scenarios",
    "/scenarios",
    ("/scenarios",),
    lambda manager, settings, path, query: layout(manager.scenarios, query.get("scenario"), settings.scenario),
    lambda app, manager, settings: register(app, manager),
)
