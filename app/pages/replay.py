"""Replay: the catalogue of runs, and a recorded run on the same stage as a live one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import ALL, ClientsideFunction, Input, Output, State, dcc, html, no_update

from app.comparing import LETTERS, Comparisons, label, refusal
from app.components.basics import action_button, badge, clock, empty, facts, section, size
from app.ids import Replay, Shell, Stage
from app.pages import data
from app.pages import stage as stage_page
from app.pages.base import Page, opened
from app.pages.operate import KIND_OF_STATUS, passport
from app.runs import RunManager
from engine.build import planners_for
from engine.errors import WattlaneError
from engine.results.ground import ground_of

SAME = "as recorded"
PICK_SOME = "Tick two to four runs of one scenario and seed to see them beside each other."


def layout(manager: RunManager, run_id: str) -> html.Div:
    """A recorded run. Raises NoSuchRun."""
    status = manager.status(run_id)
    manifest = manager.manifest(run_id)

    def read(view: Any) -> tuple[dict[str, float], float, list[str], bool]:
        ground = ground_of(view) is not None
        return dict(view.thresholds(view.t_end)._asdict()), float(view.t_end), planners_for(view.scenario), ground

    levels, end, planners, ground = manager.read(run_id, read)
    about = {"run": run_id, "label": status.get("name") or run_id}
    left = [
        section(
            "This run",
            passport(status),
            facts(
                [
                    ("Status", badge(status["status"], KIND_OF_STATUS.get(status["status"], "dim"))),
                    ("Verdict", verdict(manifest)),
                    ("Size", size(manifest.get("size_bytes"))),
                ]
            ),
            html.Div(
                [
                    dcc.Link("Operate", href=f"/operate?run={run_id}", className="wl-button small primary")
                    if status["alive"]
                    else None,
                    action_button("Resume", {"action": "resume", **about}, kind="primary")
                    if status["resumable"]
                    else None,
                    None if status["demo"] else action_button("Rename…", {"action": "rename", **about}),
                    dcc.Link("All runs", href="/runs", className="wl-button small"),
                ],
                className="wl-row",
            ),
        ),
        section("Fork from here", fork_form(planners)),
        section(
            "Look closer",
            html.Div(
                [
                    html.Button("Open in Rerun", id=Replay.RERUN_BUTTON, type="button", className="wl-button"),
                    *(
                        html.A(word, href=f"/api/runs/{run_id}/download/{what}", className="wl-button", download="")
                        for what, word in (("rrd", ".rrd"), ("csv", "CSV"), ("parquet", "Parquet"))
                    ),
                ],
                className="wl-row",
            ),
        ),
        dmc.Modal(
            html.Div(id=Replay.RERUN_HOST, className="wl-rerun"),
            id=Replay.RERUN,
            title="Rerun",
            fullScreen=True,
            zIndex=300,
            closeButtonProps={"aria-label": "Close"},
        ),
    ]
    return stage_page.layout(status, "replay", levels, left, end * float(status["tick_s"]), ground=ground)


def fork_form(planners: list[str]) -> html.Div:
    """A new live run from the moment shown, with something changed; planners: those that fit its scenario."""
    return html.Div(
        [
            html.P("Starts a live run from the moment shown, with one thing changed.", className="wl-hint whole"),
            dmc.Select(
                id=Replay.FORK_PLANNER,
                label="Planner",
                data=[SAME, *planners],
                value=SAME,
                allowDeselect=False,
                size="xs",
            ),
            dmc.NumberInput(
                id=Replay.FORK_SEED, label="Seed", placeholder=SAME, min=0, allowDecimal=False, size="xs", value=""
            ),
            dmc.Textarea(
                id=Replay.FORK_MORE,
                label="Parameters",
                description="One per line, such as planner.objective = energy",
                autosize=True,
                minRows=1,
                maxRows=6,
                size="xs",
                className="whole",
            ),
            html.Div(id=Replay.FORK_ERROR, className="wl-error whole", role="alert"),
            dcc.Store(id=Replay.FORK_AT),
            dmc.Button("Fork from here", id=Replay.FORK_BUTTON, size="xs", variant="light", className="whole"),
        ],
        className="wl-form",
    )


def verdict(manifest: Mapping[str, Any]) -> Any:
    """The judge's verdict as a badge."""
    breaches = manifest.get("breaches")
    if breaches is None:
        return badge("not judged yet", "dim")
    return badge("no breach", "ok") if breaches == 0 else badge(f"{breaches} breaches", "bad")


def catalogue(runs: Sequence[Mapping[str, Any]]) -> Any:
    """The table of all runs."""
    if not runs:
        return empty(
            "No runs yet",
            "Every run is recorded from its first tick, and can be replayed here afterwards.",
            dcc.Link("Start a run", href="/operate", className="wl-button primary"),
        )
    head = html.Tr(
        [html.Th(word) for word in ("Run", "Planner", "Seed", "Verdict", "Duration", "Size", "Status", "Actions")]
    )
    return html.Div(
        [
            html.Div(
                [
                    dmc.Button("Compare", id=Replay.COMPARE, size="xs", disabled=True),
                    html.Span(PICK_SOME, id=Replay.PICKED, role="status"),
                ],
                className="wl-compare-pick",
            ),
            html.Div(
                html.Table([html.Thead(head), html.Tbody([_row(run) for run in runs])], className="wl-catalogue"),
                className="wl-table-scroll",
            ),
        ]
    )


def _row(run: Mapping[str, Any]) -> html.Tr:
    run_id = run["run_id"]
    status = "running" if run["alive"] else str(run.get("status"))
    about = {"run": run_id, "label": run.get("name") or run_id}
    demo = run.get("demo")
    name = run.get("name") or run.get("title") or run.get("scenario") or run_id
    parent = run.get("parent")
    buttons = [
        dcc.Link("Operate", href=f"/operate?run={run_id}", className="wl-button small primary")
        if run["alive"]
        else None,
        dcc.Link("Replay", href=f"/replay?run={run_id}", className="wl-button small"),
        action_button("Resume", {"action": "resume", **about})
        if not demo and status in ("interrupted", "failed")
        else None,
        action_button("Stop…", {"action": "stop", **about}) if run["alive"] else None,
        None if demo else action_button("Rename…", {"action": "rename", **about}),
        None if demo or run["alive"] else action_button("Delete…", {"action": "delete", **about}),
    ]
    duration = run.get("sim_s", (run.get("ticks") or 0) * float(run.get("tick_s") or 1))
    return html.Tr(
        [
            html.Td(
                html.Div(
                    [
                        dmc.Checkbox(
                            id={"type": Replay.PICK, "run": run_id},
                            size="xs",
                            **{"aria-label": f"Choose {run_id} to compare"},
                        ),
                        html.Div(
                            [
                                dcc.Link(name, href=f"/{'operate' if run['alive'] else 'replay'}?run={run_id}"),
                                " ",
                                badge("demo", "open") if demo else None,
                                html.Small(run_id),
                                html.Small(f"forked from {parent['run_id']} at tick {parent['tick']}")
                                if parent
                                else None,
                            ]
                        ),
                    ],
                    className="wl-run-name",
                )
            ),
            html.Td([run.get("planner"), html.Small(f"least {run['objective']}") if run.get("objective") else None]),
            html.Td(str(run.get("seed"))),
            html.Td(verdict(run)),
            html.Td(clock(duration)),
            html.Td(size(run.get("size_bytes"))),
            html.Td([badge(status, KIND_OF_STATUS.get(status, "dim")), html.Small(run.get("note") or "")]),
            html.Td(html.Div(buttons, className="wl-row")),
        ]
    )


def picked(checked: Sequence[bool | None], ids: Sequence[Mapping[str, str]]) -> list[str]:
    """Ids of the runs that are ticked in the catalogue, the oldest first."""
    return sorted(one["run"] for one, on in zip(ids, checked, strict=True) if on)


def all_runs(manager: RunManager) -> list[dict[str, Any]]:
    """The manager's list, with the present length of live runs."""
    runs = manager.list()
    for run in runs:
        if run["alive"]:
            run["sim_s"] = manager.status(run["run_id"]).get("sim_s", 0.0)
    return runs


def catalogue_page(manager: RunManager) -> html.Div:
    """All runs: Replay's start."""
    return html.Div(
        [
            html.H1("Runs", style={"fontSize": "20px", "marginTop": 0}),
            html.Div(catalogue(all_runs(manager)), id=Replay.CATALOGUE),
        ],
        className="wl-scroll",
    )


def register(app: dash.Dash, manager: RunManager) -> None:
    """Catalogue, fork, and the embedded viewer."""

    @app.callback(
        Output(Replay.CATALOGUE, "children"),
        Input(Shell.RUNS_CHANGED, "data"),
        prevent_initial_call=True,
    )
    def changed(_: Any) -> Any:
        return catalogue(all_runs(manager))

    beside = Comparisons(manager)

    @app.callback(
        Output(Replay.COMPARE, "disabled"),
        Output(Replay.PICKED, "children"),
        Input({"type": Replay.PICK, "run": ALL}, "checked"),
        State({"type": Replay.PICK, "run": ALL}, "id"),
        prevent_initial_call=True,
    )
    def pick(checked: list[bool | None], ids: list[dict[str, str]]) -> tuple[bool, str]:
        runs = picked(checked, ids)
        if not runs:
            return True, PICK_SOME
        try:
            sides = beside.sides(runs)
            reason = refusal(sides)
        except WattlaneError as error:
            reason, sides = str(error), []
        if reason:
            return True, f"{reason[0].upper()}{reason[1:]}."
        named = [f"{letter} {label(one)}" for letter, one in zip(LETTERS, sides, strict=False)]
        return False, f"{len(runs)} runs: {', '.join(named)}."

    @app.callback(
        Output(Shell.URL, "href", allow_duplicate=True),
        Input(Replay.COMPARE, "n_clicks"),
        State({"type": Replay.PICK, "run": ALL}, "checked"),
        State({"type": Replay.PICK, "run": ALL}, "id"),
        prevent_initial_call=True,
    )
    def compare(clicks: int | None, checked: list[bool | None], ids: list[dict[str, str]]) -> Any:
        runs = picked(checked, ids)
        return f"/compare?runs={','.join(runs)}" if clicks and runs else no_update

    @app.callback(
        Output(Replay.FORK_ERROR, "children"),
        Output(Shell.URL, "href", allow_duplicate=True),
        Input(Replay.FORK_AT, "data"),
        State(Stage.CONFIG, "data"),
        State(Replay.FORK_PLANNER, "value"),
        State(Replay.FORK_SEED, "value"),
        State(Replay.FORK_MORE, "value"),
        prevent_initial_call=True,
        running=[(Output(Replay.FORK_BUTTON, "loading"), True, False)],
    )
    def fork(at: Any, config: Any, planner: str, seed: Any, more: str | None) -> tuple[Any, Any]:
        if not at or not config:
            return no_update, no_update
        return opened(
            lambda: manager.fork(
                config["run"],
                round(at["t"] / config["tick_s"]),
                planner=None if planner == SAME else planner,
                seed=int(seed) if seed not in (None, "") else None,
                overrides=data.overrides_from(more),
            )
        )

    app.clientside_callback(
        ClientsideFunction("wattlane", "forkAt"),
        Output(Replay.FORK_AT, "data"),
        Input(Replay.FORK_BUTTON, "n_clicks"),
        prevent_initial_call=True,
    )
    app.clientside_callback(
        ClientsideFunction("wattlane", "rerun"),
        Output(Replay.RERUN, "opened"),
        Input(Replay.RERUN_BUTTON, "n_clicks"),
        prevent_initial_call=True,
    )


def _page(manager: RunManager, path: str, run_id: str | None) -> html.Div:
    return layout(manager, run_id) if path == "/replay" and run_id else catalogue_page(manager)


PAGE = Page(
    "Replay",
    "/runs",
    ("/runs", "/replay"),
    lambda manager, settings, path, query: _page(manager, path, query.get("run")),
    lambda app, manager, settings: register(app, manager),
)
