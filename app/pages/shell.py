"""The frame around every page: top bar, routing, notifications, help, light and dark."""

from __future__ import annotations

import logging
from functools import cache
from importlib import import_module
from typing import Any
from urllib.parse import parse_qs

import dash
import dash_mantine_components as dmc
from dash import ClientsideFunction, Input, Output, State, ctx, dcc, html

from app.components.basics import empty, icon
from app.ids import Shell
from app.pages import stage
from app.pages.base import Page, Query
from app.runs import RunManager
from app.settings import Settings
from engine.errors import WattlaneError

log = logging.getLogger(__name__)

PAGES: tuple[str, ...] = (
    "app.pages.operate:PAGE",
    "app.pages.replay:PAGE",
    "app.pages.compare:PAGE",
    "app.pages.learn:PAGE",
    "app.pages.papers:PAGE",
    "app.pages.scenarios:PAGE",
)
"""In the order of the top bar; the first is also the start page."""

KEYS: tuple[tuple[str, str], ...] = (
    ("Space", "pause or continue"),
    ("← →", "one tick back, on"),
    ("Shift ← →", "ten ticks"),
    ("Ctrl ← →", "previous, next event"),
    ("Home End", "to the start; to live or the end"),
    ("↑ ↓", "faster, slower"),
    ("F", "follow the selected vehicle"),
    ("P", "routes"),
    ("I", "numbers"),
    ("G", "grid"),
    ("H", "next heat map"),
    ("R", "fit the floor"),
    ("+ −", "zoom"),
    ("/", "find"),
    ("Esc", "close, cancel, select nothing"),
    ("?", "this help"),
)


FAILURE = "The server made a mistake; its log says where."


def layout() -> dmc.MantineProvider:
    """What stays while pages change."""
    brand = [html.Img(src="/assets/icons/wattlane.svg", alt=""), "Wattlane"]
    top = html.Header(
        [
            dcc.Link(brand, href="/operate", className="wl-brand"),
            html.Nav(id=Shell.NAV, className="wl-nav", children=nav(""), **{"aria-label": "Pages"}),
            html.Div(id=Shell.TITLE, className="wl-title"),
            html.Div(id=Shell.STATUS, className="wl-status"),
            html.Button(icon("theme"), id=Shell.THEME_SWITCH, type="button", className="wl-tool",
                        title="Light or dark", **{"aria-label": "Light or dark"}),
            html.Button(icon("help"), id=Shell.HELP_BUTTON, type="button", className="wl-tool",
                        title="Keyboard shortcuts (?)", **{"aria-label": "Keyboard shortcuts"}),
        ],
        className="wl-top",
    )  # fmt: skip
    keys = html.Div([html.Div([html.Kbd(key), word]) for key, word in KEYS], className="wl-keys")
    mouse = html.P(
        "On the map: drag to move, wheel or pinch to zoom, click to select, double-click to centre, "
        "right-click or long press for what can be done. Pausing a live simulation pauses it for everyone; "
        "once you look back, play and pause move only your own view.",
        className="wl-hint",
    )
    return dmc.MantineProvider(
        html.Div(
            [
                html.A("Skip to the page", href=f"#{Shell.PAGE}", className="wl-skip"),
                dcc.Location(id=Shell.URL, refresh="callback-nav"),
                dcc.Store(id=Shell.THEME, storage_type="local"),
                dcc.Store(id=Shell.RUNS_CHANGED),
                dcc.Store(id=Shell.REBIND),
                dmc.NotificationContainer(id=Shell.NOTIFY, position="bottom-right", containerWidth=380),
                top,
                html.Main(id=Shell.PAGE, className="wl-page", children=html.Div("Loading…", className="wl-loading")),
                dmc.Modal(
                    [keys, mouse],
                    id=Shell.HELP,
                    title="Keyboard shortcuts",
                    size="lg",
                    zIndex=350,
                    closeButtonProps={"aria-label": "Close"},
                ),
            ],
            id="wl-root",
            className="wl-app",
        ),
        id=Shell.PROVIDER,
        theme={
            "primaryColor": "blue",
            "primaryShade": {"light": 8, "dark": 8},
            "fontFamily": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif",
        },
    )


@cache
def pages() -> tuple[Page, ...]:
    """All pages."""
    named = (name.partition(":") for name in PAGES)
    return tuple(getattr(import_module(module), attribute) for module, _, attribute in named)


def page_at(path: str) -> Page | None:
    """The page that answers an address."""
    return next((page for page in pages() if path in page.paths), None)


def nav(path: str) -> list[Any]:
    """The links to the pages, the present one marked."""
    here = page_at(path)
    return [
        dcc.Link(page.word, href=page.href, **({"className": "current"} if page is here else {})) for page in pages()
    ]


def query_of(search: str | None) -> Query:
    """The first value of every key of an address's query."""
    return {key: values[0] for key, values in parse_qs((search or "").lstrip("?")).items()}


def failed(error: Exception) -> None:
    """What a page's callback didn't foresee: into the log, and said on the page."""
    log.error("A page's callback failed", exc_info=error)
    dash.set_props(Shell.NOTIFY, failure())


def failure() -> dict[str, Any]:
    """Properties of the notifications that say so; while one is shown, no second one is."""
    about = {"title": "Something went wrong", "message": f"{FAILURE} The page may show old values."}
    return {
        "sendNotifications": [{"action": "show", "id": "failure", "color": "red", "autoClose": 12000, **about}],
    }


def failed_page(error: Exception) -> tuple[Any, Any, Any]:
    """The same when a page can't be made at all: in its place."""
    log.error("A page can't be shown", exc_info=error)
    home = dcc.Link("See all runs", href="/runs", className="wl-button primary")
    sentence = empty("This page can't be shown", FAILURE, home)
    return (
        html.Div(sentence, className="wl-scroll", role="alert"),
        nav(ctx.inputs[f"{Shell.URL}.pathname"] or "/"),
        None,
    )


def content(manager: RunManager, settings: Settings, path: str, query: Query) -> Any:
    """The page of an address; what goes wrong becomes a sentence on the page."""
    home = dcc.Link("See all runs", href="/runs", className="wl-button primary")
    found = page_at(path)
    if found is None:
        sentence = f"There is no page {path[:60]}."
        return html.Div(empty("Nothing here", sentence, home), className="wl-scroll")
    try:
        return found.layout(manager, settings, path, query)
    except WattlaneError as error:
        return html.Div(empty("This page can't be shown", str(error), home), className="wl-scroll")


def title(manager: RunManager, path: str, query: Query) -> Any:
    """Scenario and run for the top bar."""
    run_id = query.get("run")
    if path in pages()[0].paths and run_id is None:
        live = manager.live()
        run_id = live[-1] if live else None
    if run_id is None or path == "/runs":
        return None
    try:
        status = manager.status(run_id)
    except WattlaneError:
        return None
    return [
        html.B(status.get("name") or status.get("title") or status.get("scenario")),
        f" · {status['planner']}, seed {status['seed']}",
    ]


def install(app: dash.Dash, manager: RunManager, settings: Settings) -> None:
    """Gives the app its layout and all callbacks."""
    app.layout = layout()

    @app.callback(
        Output(Shell.PAGE, "children"),
        Output(Shell.NAV, "children"),
        Output(Shell.TITLE, "children"),
        Input(Shell.URL, "pathname"),
        Input(Shell.URL, "search"),
        Input(Shell.REBIND, "data"),
        on_error=failed_page,
    )
    def route(pathname: str | None, search: str | None, _: Any) -> tuple[Any, Any, Any]:
        path = (pathname or "/").rstrip("/") or "/"
        query = query_of(search)
        return content(manager, settings, path, query), nav(path), title(manager, path, query)

    app.clientside_callback(
        ClientsideFunction("wattlane", "scheme"),
        Output(Shell.PROVIDER, "forceColorScheme"),
        Output(Shell.THEME, "data"),
        Input(Shell.THEME_SWITCH, "n_clicks"),
        State(Shell.THEME, "data"),
    )
    app.clientside_callback(
        ClientsideFunction("wattlane", "help"),
        Output(Shell.HELP, "opened"),
        Input(Shell.HELP_BUTTON, "n_clicks"),
        prevent_initial_call=True,
    )
    stage.register(app, manager)
    for page in pages():
        page.register(app, manager, settings)
    # Dash's FastAPI backend lists the assets on the first request for `/`; a deep link would come before it.
    app._setup_server()
