"""Learn: the lessons, and one of them at a time, played back in the browser from traces of the planners."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any
from urllib.parse import urlencode

import dash
from dash import ClientsideFunction, Input, Output, dcc, html
from fastapi import Body, Response

from app import api
from app.components.basics import section
from app.ids import Learn
from app.lessons import LESSONS, lesson
from app.lessons.base import Lesson, Preset, checked_state
from app.pages.base import Page, Query
from app.runs import RunManager
from app.settings import Settings
from engine.errors import BadInput, unknown_name

HOME = "/learn"


def address(name: str, preset: Preset) -> str:
    """Where a preset of a lesson is shown."""
    return f"{HOME}/{name}?{urlencode(preset.query, safe='~')}"


def layout(path: str, query: Query) -> html.Div:
    """The lessons as cards, or one of them."""
    name = path.removeprefix(HOME).strip("/")
    return one(name, query) if name else cards()


def cards() -> html.Div:
    """Every lesson with its examples."""
    found = [(name, lesson(name)) for name in LESSONS]
    return html.Div(
        [
            html.H1("Learn"),
            html.P(
                "How the planners think, played back from what they did. Every address holds the whole state of a "
                "lesson: send it, and it opens as you see it.",
                className="wl-lesson-lead",
            ),
            html.Div([card(name, each) for name, each in found], className="wl-lesson-cards"),
        ],
        className="wl-scroll",
    )


def card(name: str, shown: Lesson) -> html.Section:
    """One lesson: what it shows, and its examples as links."""
    return html.Section(
        [
            html.H2(dcc.Link(shown.title, href=f"{HOME}/{name}")),
            html.P(shown.summary),
            html.Div(
                [dcc.Link(p.word, href=address(name, p), className="wl-button small") for p in shown.presets],
                className="wl-row",
            ),
        ],
        className="wl-lesson-card",
    )


def one(name: str, query: Query) -> html.Div:
    """A lesson; its script fills the floor, the controls and the transport bar."""
    shown = lesson(name)
    state, problem = shown.begin(query)
    config = {
        "lesson": name,
        "state": state,
        "keys": list(shown.keys),
        "presets": [{"word": p.word, "state": dict(p.query), "look": p.look} for p in shown.presets],
        "options": dict(shown.options),
    }
    links = [
        dcc.Link(lesson(other).title, href=f"{HOME}/{other}", className="current" if other == name else "")
        for other in LESSONS
    ]
    return html.Div(
        [
            html.Div(problem, id=Learn.PROBLEM, className="wl-banner", role="alert", hidden=not problem),
            html.Div(
                [
                    html.Aside(
                        [
                            html.Nav(links, className="wl-lesson-nav", **{"aria-label": "Lessons"}),
                            html.Div(id=Learn.CONTROLS),
                        ],
                        className="wl-left",
                        **{"aria-label": "Settings of the lesson"},
                    ),
                    html.Section(id=Learn.STAGE, className="wl-lesson-stage", **{"aria-label": shown.title}),
                    html.Aside(
                        [
                            html.Div(id=Learn.LOOK, className="wl-why"),
                            html.Div(id=Learn.NOW, className="wl-lesson-now", **{"aria-live": "polite"}),
                            section("How to read it", *shown.text()),
                        ],
                        className="wl-right wl-lesson-text",
                        **{"aria-label": "Explanation"},
                    ),
                    html.Div(id=Learn.TRANSPORT, className="wl-lesson-transport"),
                ],
                className="wl-lesson",
            ),
            dcc.Store(id=Learn.CONFIG, data=config),
            dcc.Store(id=Learn.BOUND),
        ],
        className="wl-lesson-page",
    )


def answered(name: str, asked: Mapping[str, Any]) -> Mapping[str, Any]:
    """What a lesson's script asked for. Raises BadInput."""
    if name not in LESSONS:
        raise BadInput(unknown_name("lesson", name[:40], LESSONS))
    shown = lesson(name)
    return shown.answer({**shown.presets[0].query, **checked_state(asked, shown.keys)})


def register(app: dash.Dash) -> None:
    """The route that the lessons' scripts ask, and the binding of the script."""

    @app.server.post(f"{HOME}/{{name}}")
    def ask(name: str, asked: Annotated[dict[str, Any], Body()]) -> Response:
        return api.answer(answered(name, asked))

    app.clientside_callback(
        ClientsideFunction("wattlane", "lesson"), Output(Learn.BOUND, "data"), Input(Learn.CONFIG, "data")
    )


def page_layout(manager: RunManager, settings: Settings, path: str, query: Query) -> html.Div:
    """The page's entry for the frame."""
    return layout(path, query)


PAGE = Page(
    "Learn",
    HOME,
    (HOME, *(f"{HOME}/{name}" for name in LESSONS)),
    page_layout,
    lambda app, manager, settings: register(app),
)
