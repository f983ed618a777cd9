"""Papers: each paper's experiments run again, its table beside ours. A study that is registered has a page here."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from itertools import groupby
from typing import Any
from weakref import WeakKeyDictionary

import dash
import dash_mantine_components as dmc
from dash import Input, Output, State, ctx, dcc, html, no_update
from fastapi import FastAPI
from fastapi.responses import Response

from app import study_report
from app.api import answer
from app.components.basics import badge, empty, facts, section, span
from app.figures.study import study_panels
from app.ids import Papers, Shell
from app.pages.base import Page, Query
from app.pages.compare import start_address
from app.runs import RunManager
from app.study import SHIPPED, Asked, Studies, checked_study
from app.theme import GRAPH_CONFIG, LIGHT
from engine.errors import WattlaneError

TICK_MS = 1000
DOWNLOADS = {"json": "application/json", "md": "text/markdown; charset=utf-8", "html": "text/html; charset=utf-8"}

_of: WeakKeyDictionary[RunManager, Studies] = WeakKeyDictionary()


def studies_of(manager: RunManager) -> Studies:
    """The studies of a dashboard; its runs and its studies share a data folder."""
    return _of.setdefault(manager, Studies(manager.settings.data))


# -- layout -----------------------------------------------------------------------------------------------------------


def layout(studies: Studies, query: Query) -> html.Div:
    """One study: the list beside it, how to run it, the result that is shown. Raises NoSuchResult."""
    from engine.studies.base import STUDIES, counted, study

    name = checked_study(query.get("study") or next(iter(STUDIES)))
    found = study(name)
    results = studies.store.results(name)
    result_id = query.get("result") or (results[0]["id"] if results else None)
    record = studies.store.record(name, result_id) if result_id else None
    chosen = {"study": name, "result": result_id, "newest": query.get("result") is None}
    return html.Div(
        [
            dcc.Store(id=Papers.SHOWN, data=chosen),
            dcc.Store(id=Papers.RUNNING),
            dcc.Store(id=Papers.DRAWN),
            dcc.Interval(id=Papers.TICK, interval=TICK_MS),
            html.Aside(
                [
                    section("Studies", html.Ul([_link(each, name) for each in STUDIES], className="wl-runs")),
                    section("Run it", run_form(found.maps, counted(found))),
                ],
                className="wl-papers-side",
            ),
            html.Div(
                [
                    html.H1(found.title),
                    html.P(["Source: ", found.paper], className="wl-papers-source"),
                    html.Ol([html.Li(what) for what in found.experiments.values()], className="wl-papers-list"),
                    html.Div(id=Papers.PROGRESS),
                    shown(name, results, record) if record else nothing_yet(),
                ],
                className="wl-papers-main",
            ),
        ],
        className="wl-papers",
    )


def _link(name: str, present: str) -> html.Li:
    from engine.studies.base import study

    found = study(name)
    link = dcc.Link([name, html.Small(found.paper)], href=f"/papers?study={name}")
    return html.Li(link, className="current" if name == present else "")


def nothing_yet() -> html.Div:
    return empty(
        "No results yet", "Run it: a quick run takes about a minute, and goes on where it was when it is ended."
    )


def run_form(maps: tuple[int, int], counted: str) -> html.Div:
    """Quick or full, how many maps (or what a study counts), seed."""
    quick, full = maps
    return html.Div(
        [
            dmc.SegmentedControl(
                id=Papers.QUICK,
                data=[
                    {"value": "quick", "label": f"Quick ({quick} {counted})"},
                    {"value": "full", "label": f"Full ({full} {counted})"},
                ],
                value="quick",
                fullWidth=True,
                size="xs",
                className="whole",
            ),
            dmc.NumberInput(
                id=Papers.MAPS, label=f"{counted.capitalize()} per case", placeholder="as above", min=1, max=100_000,
                allowDecimal=False, size="xs", value="",
            ),
            dmc.NumberInput(id=Papers.SEED, label="Seed", min=0, allowDecimal=False, size="xs", value=11),
            html.Div(id=Papers.ERROR, className="wl-error whole", role="alert"),
            dmc.Button("Run", id=Papers.RUN, size="xs", className="whole"),
            html.P(
                "On all cores, after live runs and the dashboard. What is computed is kept: a run that was cancelled "
                "goes on where it was.",
                className="wl-hint whole",
            ),
        ],
        className="wl-form",
    )  # fmt: skip


def shown(name: str, results: list[dict[str, Any]], record: Mapping[str, Any]) -> html.Div:
    """A result: where it comes from, its table, its figures, why it differs."""
    result_id = record["made"].get("id", SHIPPED)
    links = [
        html.A(word, href=f"/papers/{name}/{result_id}.{ending}", className="wl-button small", download="")
        for ending, word in (("json", "JSON"), ("md", "Markdown"), ("html", "HTML with figures"))
    ]
    return html.Div(
        [
            html.Div(
                [
                    dmc.Select(
                        id=Papers.RESULT,
                        data=[{"value": each["id"], "label": result_words(each)} for each in results],
                        value=result_id,
                        allowDeselect=False,
                        size="xs",
                        w=440,
                        label="Result shown",
                    ),
                    html.Div([html.Span("Download"), *links, methods_link(record)], className="wl-row"),
                ],
                className="wl-papers-bar",
            ),
            html.P(made(record), className="wl-hint"),
            html.P(
                [
                    badge(study_report.judged(record), "bad" if record["breaches"] else "ok"),
                    html.Span(f" {study_report.tally(record)}."),
                ]
            ),
            table(record),
            html.H2("Why ours differs, and how it was counted"),
            html.Ul([html.Li(note) for note in record["notes"]], className="wl-papers-list"),
            html.H2("One parameter set for all rows"),
            facts([(name, study_report.value_words(value)) for name, value in record["parameters"].items()]),
            html.H2("Figures"),
            html.Div(id=Papers.FIGURES, className="wl-papers-figures"),
        ]
    )


def methods_link(record: Mapping[str, Any]) -> Any:
    """To runs of a study's methods beside each other, where they run in a scenario."""
    from engine.studies.base import beside, study

    runs = beside(study(record["study"]), record)
    return dcc.Link("Compare these methods", href=start_address(runs), className="wl-button small") if runs else None


def result_words(result: Mapping[str, Any]) -> str:
    """A result in the list of results."""
    about = result["made"]
    when = datetime.fromisoformat(about["at"]).strftime("%Y-%m-%d %H:%M")
    whose = "came with the program" if result["origin"] == SHIPPED else "your own"
    return f"{when} · {study_report.counted_words(about)} · seed {about['seed']} · {whose}"


def made(record: Mapping[str, Any]) -> str:
    """When, how and by what a result was made."""
    about = record["made"]
    took = f"{about['cells'] - about['kept']} of {about['cells']} cells computed in {span(about['wall_s'])}"
    processes = f"{about['processes']} process{'es' if about['processes'] > 1 else ''} on {about['where']}"
    return f"{study_report.made_words(record)}; {took} by {processes}; code {about['code']}."


def table(record: Mapping[str, Any]) -> html.Div:
    """The paper's numbers beside ours, by experiment; rows that are about runs link to them."""
    from engine.studies.base import beside, study

    asked = study(record["study"])
    links = {k: start_address(runs) for k, row in enumerate(record["rows"]) if (runs := beside(asked, record, row))}
    words = ("Quantity", "Case", "Paper", "Ours", "95 %", "n", "Verdict", *(("Runs",) if links else ()))
    head = html.Tr([html.Th(word) for word in words])
    bodies = []
    for number, what in record["experiments"].items():
        title = html.Tr(html.Th(f"Experiment {number}: {what}", colSpan=len(words), scope="colgroup"))
        rows = [
            {**row, "link": links.get(k), "linked": bool(links)}
            for k, row in enumerate(record["rows"])
            if str(row["experiment"]) == str(number)
        ]
        groups = [list(group) for _, group in groupby(rows, key=lambda row: (row["quantity"], row["unit"]))]
        bodies.append(html.Tbody([title, *[line for group in groups for line in _rows(group)]]))
    return html.Div(
        html.Table([html.Thead(head), *bodies], className="wl-catalogue wl-papers-table"),
        className="wl-table-scroll", tabIndex=0, role="region", **{"aria-label": "Table"},
    )  # fmt: skip


def _rows(group: list[Mapping[str, Any]]) -> list[html.Tr]:
    """The cases of one quantity."""
    unit = f" {group[0]['unit']}" if group[0]["unit"] == "%" else ""
    notes = {row.get("note") for row in group}
    shared = notes.pop() if len(notes) == 1 else None
    words = ", ".join(word for word in ("" if unit else group[0]["unit"], shared) if word)
    quantity = html.Th(
        [group[0]["quantity"], html.Small(words) if words else None], rowSpan=len(group), scope="rowgroup"
    )
    return [
        html.Tr(
            [
                quantity if k == 0 else None,
                html.Td([row["case"], html.Small(row["note"]) if row.get("note") and not shared else None]),
                html.Td(study_report.paper_words(row) + (unit if row["paper"] else "")),
                html.Td(study_report.number(row["ours"]) + unit),
                html.Td(study_report.interval_words(row)),
                html.Td(str(row["n"])),
                html.Td(verdict(row)),
                html.Td(runs_link(row)) if row["linked"] else None,
            ]
        )
        for k, row in enumerate(group)
    ]


def runs_link(row: Mapping[str, Any]) -> Any:
    """To the runs that a row is about, ready to be started beside each other."""
    if not row["link"]:
        return None
    said = f"Compare runs: {row['quantity']}, {row['case']}"
    return dcc.Link("Compare", href=row["link"], className="wl-papers-compare", title=said)


def verdict(row: Mapping[str, Any]) -> Any:
    """`✓ inside`, `▲ outside by +1.20`, `▼ outside by −0.80`, or nothing to compare with."""
    if row["verdict"] == "–":
        return html.Span("not printed", className="wl-papers-none")
    inside = row["verdict"] == "inside"
    sign = "✓" if inside else "▲" if (row["off"] or 0) > 0 else "▼"
    return badge(f"{sign} {study_report.verdict_words(row)}", "ok" if inside else "bad")


def figures(record: Mapping[str, Any], scheme: str) -> list[html.Figure]:
    """A result's figures, drawn for a colour scheme."""
    return [_figure(figure, scheme) for figure in record["figures"]]


def _figure(figure: Mapping[str, Any], scheme: str) -> html.Figure:
    data = figure["data"]
    panels = []
    for panel in study_panels(figure, scheme):
        graph = dcc.Graph(figure=panel.chart, config=GRAPH_CONFIG, responsive=True, className="wl-papers-chart")
        box = html.Div(graph, className="wl-papers-floor" if panel.ratio else "wl-papers-wide")
        panels.append(html.Div([html.P(panel.caption) if panel.caption else None, box]))
    if figure["kind"] == "table":
        head = html.Tr([html.Th(word) for word in data["columns"]])
        rows = [html.Tr([html.Td(study_report.value_words(cell)) for cell in row]) for row in data["rows"]]
        plain = html.Table([html.Thead(head), html.Tbody(rows)], className="wl-catalogue wl-plain")
        panels.append(
            html.Div(plain, className="wl-table-scroll", tabIndex=0, role="region", **{"aria-label": figure["title"]})
        )
    note = html.P(data["note"], className="wl-hint") if data.get("note") else None
    many = " several" if len(panels) > 1 else ""
    return html.Figure(
        [html.Figcaption(figure["title"]), html.Div(panels, className=f"wl-papers-panels{many}"), note],
        className=f"wl-papers-figure{many}",
    )


# -- progress ---------------------------------------------------------------------------------------------------------


def progress(status: Mapping[str, Any] | None) -> Any:
    """How far a run is, or how it ended; nothing when there was none."""
    if status is None or status["phase"] == "finished":
        return None
    done, total = status["done"], status["total"]
    if status["alive"]:
        share = 100 * done / total if total else 0
        counts = f"{done} of {total} cells" if total else "starting"
        kept = f", {status['kept']} kept from before" if status["kept"] else ""
        remaining = "" if status["remaining_s"] is None else f", about {span(status['remaining_s'])} remaining"
        text = f"{status['phase'].capitalize()}: {counts}{kept}; {span(status['elapsed_s'])} elapsed{remaining}"
        return html.Div(
            [
                html.Div(
                    [
                        html.Span(text, className="wl-papers-count"),
                        html.Button(
                            "Cancel", id=Papers.CANCEL, type="button", className="wl-button small",
                            disabled=status["phase"] == "cancelling",
                        ),
                    ],
                    className="wl-row",
                ),
                dmc.Progress(value=share, size="md", **{"aria-label": "Progress of the study"}),
                html.P(status["what"], className="wl-hint"),
            ],
            className="wl-papers-progress",
        )  # fmt: skip
    if status["phase"] == "cancelled":
        kept = f"The {done} of {total} cells computed are kept" if total else "Nothing was computed yet"
        return html.Div(f"Cancelled. {kept}; running it again goes on.", className="wl-banner info", role="status")
    return html.Div(f"The run failed: {status['failure']}.", className="wl-banner", role="alert")


# -- callbacks --------------------------------------------------------------------------------------------------------


def register(app: dash.Dash, manager: RunManager) -> None:
    """Run, cancel, progress, the choice of a result, figures; and the downloads."""
    studies = studies_of(manager)
    add_downloads(app.server, studies)

    @app.callback(
        Output(Papers.ERROR, "children"),
        Input(Papers.RUN, "n_clicks"),
        State(Papers.SHOWN, "data"),
        State(Papers.QUICK, "value"),
        State(Papers.MAPS, "value"),
        State(Papers.SEED, "value"),
        prevent_initial_call=True,
        running=[(Output(Papers.RUN, "loading"), True, False)],
    )
    def run(clicks: Any, chosen: Any, quick: str, maps: Any, seed: Any) -> Any:
        if not clicks or not chosen:
            return no_update
        try:
            wanted = whole(maps, "How many per case")
            asked = Asked(quick == "quick", wanted, whole(seed, "Seed") or 0)
            studies.start(chosen["study"], asked)
        except WattlaneError as error:
            return str(error)
        except OSError as error:
            return f"the disk refused: {error.strerror or error}"
        return None

    @app.callback(
        Output(Papers.CANCEL, "disabled"),
        Input(Papers.CANCEL, "n_clicks"),
        State(Papers.SHOWN, "data"),
        prevent_initial_call=True,
    )
    def cancel(clicks: Any, chosen: Any) -> Any:
        if not clicks or not chosen:
            return no_update
        try:
            studies.cancel(chosen["study"])
        except WattlaneError:
            return no_update  # it has just ended by itself
        return True

    @app.callback(
        Output(Papers.PROGRESS, "children"),
        Output(Papers.RUN, "disabled"),
        Output(Papers.RUNNING, "data"),
        Output(Shell.REBIND, "data", allow_duplicate=True),
        Output(Shell.URL, "search", allow_duplicate=True),
        Input(Papers.TICK, "n_intervals"),
        Input(Papers.ERROR, "children"),
        State(Papers.SHOWN, "data"),
        State(Papers.RUNNING, "data"),
        prevent_initial_call="initial_duplicate",
    )
    def tick(count: int | None, _: Any, chosen: Any, before: Any) -> Any:
        if not chosen:
            return (no_update,) * 5
        status = studies.status(chosen["study"])
        alive = bool(status and status["alive"])
        rebind, search = no_update, no_update
        if before and not alive and status and status["result_id"]:
            # the newest result is what an address without one shows
            rebind, search = (
                (status["result_id"], no_update) if chosen["newest"] else (no_update, address(chosen["study"]))
            )
        return progress(status), alive, alive, rebind, search

    @app.callback(
        Output(Shell.URL, "search", allow_duplicate=True),
        Input(Papers.RESULT, "value"),
        State(Papers.SHOWN, "data"),
        prevent_initial_call=True,
    )
    def choose(result_id: str | None, chosen: Any) -> Any:
        if not result_id or not chosen or result_id == chosen["result"] or ctx.triggered_id != Papers.RESULT:
            return no_update
        return address(chosen["study"], result_id)

    @app.callback(
        Output(Papers.FIGURES, "children"),
        Output(Papers.DRAWN, "data"),
        Input(Papers.SHOWN, "data"),
        Input(Shell.THEME, "data"),
        State(Papers.DRAWN, "data"),
    )
    def draw(chosen: Any, scheme: Any, drawn: Any) -> Any:
        if not chosen or not chosen["result"] or scheme is None:
            return no_update, no_update
        now = [chosen["study"], chosen["result"], scheme]
        if now == drawn:
            return no_update, no_update
        try:
            record = studies.store.record(chosen["study"], chosen["result"])
        except WattlaneError as error:
            return html.P(str(error), className="wl-error", role="alert"), now
        return figures(record, scheme if isinstance(scheme, str) else LIGHT), now


def address(study: str, result_id: str | None = None) -> str:
    return f"?study={study}" + (f"&result={result_id}" if result_id else "")


def whole(value: Any, what: str) -> int | None:
    """A whole number from a field, None from an empty one. Raises BadInput."""
    from engine.errors import BadInput

    if value in (None, ""):
        return None
    try:
        number = int(str(value))
    except ValueError:
        raise BadInput(f"{what}: a whole number was expected, got {str(value)[:40]!r}") from None
    return number


def add_downloads(server: FastAPI, studies: Studies) -> None:
    """`/papers/<study>/<result>.json`, `.md`, `.html`."""

    @server.get("/papers/{study}/{file}")
    def download(study: str, file: str) -> Response:
        result_id, _, ending = file.rpartition(".")
        try:
            record = studies.store.record(study, result_id)
        except WattlaneError as error:
            return answer({"error": str(error)}, 404)
        if ending not in DOWNLOADS:
            return answer({"error": f"json, md or html was expected, got {ending[:20]!r}"}, 404)
        if ending == "json":
            return answer(record)
        text = study_report.markdown(record) if ending == "md" else study_report.html(record)
        headers = {"content-disposition": f'attachment; filename="{study}-{result_id}.{ending}"'}
        return Response(text, 200, headers, DOWNLOADS[ending])


PAGE = Page(
    "Papers",
    "/papers",
    ("/papers",),
    lambda manager, settings, path, query: layout(studies_of(manager), query),
    lambda app, manager, settings: register(app, manager),
)
