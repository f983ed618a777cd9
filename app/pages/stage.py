"""The stage: map, side panel, tabs and transport bar of one run, with the callback that keeps them up to date."""

from __future__ import annotations

import time
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import ClientsideFunction, Input, Output, dcc, html, no_update

from app import figures
from app.components import tables
from app.components.basics import action_button, clock, command_button
from app.components.graphs import chart, graph
from app.components.panels import (
    ground_panel,
    ground_rows,
    kpi_panel,
    place_panel,
    soc_bar,
    vehicle_panel,
    ways_panel,
)
from app.ids import Stage
from app.pages import data, ground3d
from app.runs import RunManager
from engine.errors import WattlaneError

TABS: tuple[tuple[str, str], ...] = (
    ("charts", "Charts"),
    ("bands", "State bands"),
    ("reservations", "Reservations"),
    ("events", "Events"),
    ("orders", "Orders"),
    ("chargers", "Chargers"),
    ("fleet", "Fleet"),
    ("ways", "Ways"),
)
OF_GROUND = frozenset({"charts", "bands", "events", "ways"})
OF_FLEET = frozenset(name for name, _ in TABS) - {"ways"}
"""Tabs that make sense: one robot on terrain has no reservations, orders and chargers."""
MARKS_EVERY = 5
"""The ruler's event ticks are read anew with every fifth update."""


def layout(
    status: dict[str, Any], page: str, levels: dict[str, float], left: list[Any], end_s: float, *, ground: bool = False
) -> html.Div:
    """The stage for a run. status: of RunManager.status · page: "operate" or "replay" · left: the left column ·
    ground: the run is on terrain."""
    config = {
        "run": status["run_id"],
        "page": page,
        "live": bool(status["alive"]),
        "t_end": end_s,
        "tick_s": float(status["tick_s"]),
        "status": status["status"],
        "fleet": status["fleet"],
        "nonce": time.time(),
    }
    return html.Div(
        [
            dcc.Store(id=Stage.CONFIG, data=config),
            dcc.Store(id=Stage.SELECTION),
            dcc.Store(id=Stage.PULSE),
            dcc.Store(id=Stage.ACK),
            dcc.Store(id=Stage.EXTRA),
            dcc.Store(id=Stage.BOUND),
            html.Aside(left, className="wl-left", **{"aria-label": "Run"}),
            html.Section(
                [html.Div(id=Stage.BANNER, children=banner(status, page)), html.Div(id=Stage.MAP)],
                className="wl-centre",
                **{"aria-label": "Map"},
            ),
            html.Aside(
                html.Div(id=Stage.SIDE, children=html.Div("Reading the run…", className="wl-loading")),
                className="wl-right",
                **{"aria-label": "What is selected, or the fleet"},
            ),
            _tabs(levels, ground),
            html.Div(id=Stage.TRANSPORT, className="wl-transport", role="toolbar", **{"aria-label": "Time"}),
            *(ground3d.dialog() if ground else []),
        ],
        className="wl-stage",
    )


def _tabs(levels: dict[str, float], ground: bool) -> html.Div:
    bodies: dict[str, Any] = {
        "charts": html.Div(
            [
                # all are on the page, since a callback must find what it fills; those of the other kind are hidden
                chart(Stage.SOC, "State of charge", hidden=ground),
                chart(Stage.OCCUPANCY, "Occupancy: what the fleet does", hidden=ground),
                chart(Stage.THROUGHPUT, "Throughput: orders per hour, and open", hidden=ground),
                chart(Stage.ANYTIME, "Search: ε, and cost of the way ahead", hidden=not ground),
                chart(Stage.POWER, "Power at the battery, by component", hidden=not ground),
                chart(Stage.ENERGY, "Energy drawn, by component"),
            ],
            className=f"wl-charts{' of-three' if ground else ''}",
        ),
        "bands": html.Div([html.Div(graph(Stage.BANDS, "State bands"))], className="wl-one"),
        "reservations": html.Div(
            [
                html.Div(id=Stage.RESERVATIONS_NOTE, className="wl-hint"),
                html.Div(graph(Stage.RESERVATIONS, "Reservations")),
            ],
            className="wl-one",
        ),
        "events": tables.events_grid(Stage.EVENTS),
        "orders": tables.orders_grid(Stage.ORDERS),
        "chargers": tables.chargers_grid(Stage.CHARGERS),
        "fleet": tables.fleet_grid(Stage.FLEET, levels),
        "ways": tables.ways_grid(Stage.WAYS),
    }
    spans = dmc.SegmentedControl(
        id=Stage.SPAN,
        value="3600",
        size="xs",
        data=[
            {"value": v, "label": w} for v, w in (("600", "10 min"), ("3600", "1 h"), ("28800", "8 h"), ("0", "all"))
        ],
        **{"aria-label": "Span of the charts"},
    )
    return html.Div(
        [
            html.Div(className="wl-grip", id="tabs-grip", title="Drag to make the tabs higher or lower"),
            dmc.Tabs(
                [
                    html.Div(
                        [
                            dmc.TabsList(
                                [
                                    dmc.TabsTab(word, value=name)
                                    for name, word in TABS
                                    if name in (OF_GROUND if ground else OF_FLEET)
                                ]
                            ),
                            html.Div(
                                [
                                    spans,
                                    html.Button(
                                        html.Span(className="wl-icon wl-icon-chevron", **{"aria-hidden": "true"}),
                                        type="button",
                                        className="wl-tool",
                                        title="Fold or unfold the tabs",
                                        **{
                                            "aria-label": "Fold or unfold the tabs",
                                            "data-action": '{"action": "fold"}',
                                        },
                                    ),
                                ],
                                className="wl-tab-tools",
                            ),
                        ],
                        className="wl-tab-list",
                    ),
                    html.Div(
                        [dmc.TabsPanel(bodies[name], value=name, style={"height": "100%"}) for name, _ in TABS],
                        className="wl-tab-body",
                    ),
                ],
                id=Stage.TABS,
                value="charts",
                keepMounted=True,
            ),
        ],
        id=Stage.TABS_BOX,
        className="wl-tabs",
    )


def banner(status: dict[str, Any], page: str) -> Any:
    """A line above the map when the run needs a person: its process died, or it is over."""
    if status["alive"] or page != "operate":
        return None
    note = f" ({status['note']})" if status.get("note") else ""
    look = dcc.Link("Replay it", href=f"/replay?run={status['run_id']}", className="wl-button small")
    if status["status"] in ("interrupted", "failed"):
        text = f"This run's process has ended{note}. What was recorded is kept."
        resume = action_button("Resume from the last checkpoint", {"action": "resume", "run": status["run_id"]})
        return html.Div(
            [html.Span(text), resume if status["resumable"] else None, look], className="wl-banner", role="alert"
        )
    text = f"This run is {status['status']}{note}."
    return html.Div([html.Span(text), look], className="wl-banner info", role="status")


def side_panel(told: data.Told, asked: data.Asked, live: bool) -> Any:
    """What the right column shows."""
    values, chosen = told.values, asked.selection
    if chosen is None and told.ground:
        return ground_panel(values["robot"])
    if chosen is None:
        return html.Div([kpi_panel(values["kpis"]), ways_panel(values.get("ways"))])
    fleet = values["fleet"]
    if chosen["kind"] == "vehicle":
        if asked.vehicle is None or asked.vehicle >= len(fleet):
            return html.P("This run has no such vehicle.", className="wl-hint")
        levels = {} if told.ground else told.levels  # nothing charges on terrain
        return vehicle_panel(fleet[asked.vehicle], levels, live=live, ground=told.ground)
    place = chosen.get("place")
    if place is None:
        return html.P("Nothing is known of this place.", className="wl-hint")
    name = values["place_name"].get(place, f"place {place}")
    here = [r for r in fleet if r["place"] == place]
    title = values.get("place_title", f"cell {name}")
    title, rows, extra = title[0].upper() + title[1:], [("Place", str(place)), *_arc(values.get("arc"))], []
    if chosen["kind"] == "charger":
        title = f"Charger {name}"
        rows, extra = _charger(told, place, live)
    elif chosen["kind"] == "station":
        title, rows = f"Station {name}", _station(told, chosen["id"])
    if told.ground:
        cell, sent = values["cell"], command_button("Send the robot here", {"do": "send", "vehicle": 0, "place": place})
        rows, extra = ground_rows(cell), [sent] if live else []
        stands = cell["obstacle"]
        return place_panel(title, rows, here, place=place, blocked=stands, live=live, extra=extra, ground=True)
    return place_panel(title, rows, here, place=place, blocked=place in values["blocked"], live=live, extra=extra)


def _arc(known: dict[str, float] | None) -> list[tuple[str, Any]]:
    """What is known of an arc of a network, over the last hour."""
    if known is None:
        return []
    return [
        ("Expected time", f"{known['expected_s']:.2f} s"),
        ("Passages", f"{known['passages']:.0f} in the last hour"),
        ("Occupied", f"{100 * known['occupancy']:.1f} % of it"),
    ]


def _charger(told: data.Told, place: int, live: bool) -> tuple[list[tuple[str, Any]], list[Any]]:
    """What is known of the charger at a place, and its command."""
    fleet = told.values["fleet"]
    record = next((c for c in told.values["chargers"] if c["place"] == place), None)
    if record is None:
        return [], []
    (row,) = tables.charger_rows([record], fleet, live=live)
    connected = record["vehicle"]

    def names(vehicles: list[int]) -> str:
        return ", ".join(f"vehicle {v}" for v in vehicles) or "nobody"

    rows = [
        ("State", record["state"]),
        ("Since", clock(record["since_s"])),
        ("Charge", None if connected is None else soc_bar(fleet[connected]["soc"], told.levels)),
        ("On their way", names(record["bookings"])),
        ("Queue", names(record["queue"])),
    ]
    return rows, [command_button(row["command_text"], row["command"])] if live else []


def _station(told: data.Told, number: int) -> list[tuple[str, Any]]:
    """What is known of a station: its orders that are under way."""
    orders = [o for o in told.values["orders"] if number in (o["from_station"], o["to_station"])]
    active = [o for o in orders if o["state"] in tables.ACTIVE_ORDERS]
    words = [f"order {o['order']}: {o['from_name']} → {o['to_name']}, {o['state']}" for o in active[:6]]
    following = html.Div([html.Div(word) for word in words]) if words else "none"
    return [("Number", str(number)), ("Active orders", str(len(active))), ("Next", following)]


def tab_outputs(told: data.Told, asked: data.Asked, scheme: str, live: bool) -> dict[str, Any]:
    """New values for what the open tab holds, by output name."""
    values, tab = told.values, asked.tab
    if tab == "charts" and told.ground:
        return {
            "anytime": figures.anytime_figure(
                values["passes"], values["since_s"], values["now_s"], values["objective"], scheme
            ),
            "power": figures.power_figure(values["power"], scheme),
            "energy": figures.energy_figure(values["energy"], scheme),
        }
    if tab == "charts":
        return {
            "soc": figures.soc_figure(values["soc"], told.levels, asked.vehicle, scheme),
            "occupancy": figures.occupancy_figure(values["occupancy"], scheme),
            "throughput": figures.throughput_figure(values["throughput"], scheme),
            "energy": figures.energy_figure(values["energy"], scheme),
        }
    if tab == "bands":
        return {
            "bands": figures.bands_figure(
                values["bands"], values["since_s"], told.time_s, told.time_s, asked.vehicle, scheme
            )
        }
    if tab == "reservations":
        first, last = (t * told.tick_s for t in values["lanes"])
        whose = (
            f"the places of vehicle {asked.vehicle}" if asked.vehicle is not None else "the places reserved most often"
        )
        return {
            "reservations": figures.reservations_figure(
                values["reservations"],
                first,
                last,
                told.tick_s,
                told.time_s,
                asked.vehicle,
                values["place_names"],
                scheme,
            ),
            "note": f"Who holds which place when, from {clock(first)} to {clock(last)}: {whose}. "
            "Right of the line lies what is reserved ahead.",
        }
    if tab == "events":
        return {"events": tables.event_rows(values["events"])}
    if tab == "orders":
        return {"orders": tables.order_rows(values["orders"], live=live)}
    if tab == "chargers":
        return {"chargers": tables.charger_rows(values["chargers"], values["fleet"], live=live)}
    if tab == "ways":
        return {"ways": tables.way_rows(values["passes"], values["objective"])} if told.ground else {}
    return {"fleet": tables.fleet_rows(values["fleet"])}


OUTPUTS: dict[str, Output] = {
    "ack": Output(Stage.ACK, "data"),
    "extra": Output(Stage.EXTRA, "data"),
    "side": Output(Stage.SIDE, "children"),
    "banner": Output(Stage.BANNER, "children"),
    "soc": Output(Stage.SOC, "figure"),
    "occupancy": Output(Stage.OCCUPANCY, "figure"),
    "throughput": Output(Stage.THROUGHPUT, "figure"),
    "energy": Output(Stage.ENERGY, "figure"),
    "power": Output(Stage.POWER, "figure"),
    "anytime": Output(Stage.ANYTIME, "figure"),
    "bands": Output(Stage.BANDS, "figure"),
    "reservations": Output(Stage.RESERVATIONS, "figure"),
    "note": Output(Stage.RESERVATIONS_NOTE, "children"),
    "events": Output(Stage.EVENTS, "rowData"),
    "orders": Output(Stage.ORDERS, "rowData"),
    "chargers": Output(Stage.CHARGERS, "rowData"),
    "fleet": Output(Stage.FLEET, "rowData"),
    "ways": Output(Stage.WAYS, "rowData"),
}


def register(app: dash.Dash, manager: RunManager) -> None:
    """The stage's callbacks: one that answers every pulse of the browser, and those that run in the browser."""

    @app.callback(
        output=OUTPUTS,
        inputs={
            "pulse": Input(Stage.PULSE, "data"),
            "tab": Input(Stage.TABS, "value"),
            "selection": Input(Stage.SELECTION, "data"),
            "spanned": Input(Stage.SPAN, "value"),
        },
        prevent_initial_call=True,
    )
    def refresh(pulse: Any, tab: str, selection: Any, spanned: str) -> dict[str, Any]:
        answer: dict[str, Any] = dict.fromkeys(OUTPUTS, no_update)
        if not pulse:
            return answer
        answer["ack"] = pulse["n"]
        parts = frozenset({"marks"}) if pulse["n"] % MARKS_EVERY == 1 else frozenset()
        asked = data.Asked(
            run_id=pulse["run"],
            time_s=pulse["t"],
            tab=tab or "charts",
            span_s=data.SPANS.get(spanned, 3600.0),
            selection=data.known_selection(selection),
            parts=parts,
        )
        try:
            status = manager.status(asked.run_id)
            told = data.look(manager, asked)
        except WattlaneError as error:
            answer["side"] = html.P(str(error), className="wl-error", role="alert")
            return answer
        live = bool(status["alive"] and pulse["follow"])  # the past takes no commands
        answer |= tab_outputs(told, asked, pulse["scheme"], live)
        answer["side"] = side_panel(told, asked, live)
        if pulse["live"] and not status["alive"]:
            answer["banner"] = banner(status, pulse["page"])
        answer["extra"] = {
            "run": asked.run_id,
            "t_end": told.end_s,
            "blocked": told.values["blocked"],
            "chargers_out": told.values["chargers_out"],
            "events": told.values.get("marks"),
        }
        return answer

    ground3d.register(app, manager)
    # With an output, unlike the others: a callback without one is not called when its page appears.
    app.clientside_callback(
        ClientsideFunction("wattlane", "bind"), Output(Stage.BOUND, "data"), Input(Stage.CONFIG, "data")
    )
    for name, source in (
        ("extra", Input(Stage.EXTRA, "data")),
        ("acknowledge", Input(Stage.ACK, "data")),
        ("tab", Input(Stage.TABS, "value")),
        ("selectRow", Input(Stage.FLEET, "cellClicked")),
        ("centreRow", Input(Stage.FLEET, "cellDoubleClicked")),
    ):
        app.clientside_callback(ClientsideFunction("wattlane", name), source, prevent_initial_call=True)
