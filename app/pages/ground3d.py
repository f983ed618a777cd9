"""The ground in three dimensions, on demand: a window over the stage that fetches one moment when it is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import dash
import dash_mantine_components as dmc
import numpy as np
from dash import ClientsideFunction, Input, Output, dcc, html

from app.components.basics import clock
from app.components.graphs import NOTHING, graph
from app.figures.ground3d import EYE, TALLER, Eye, Scene, ground3d_figure
from app.ids import Ground3D
from app.runs import RunManager
from engine.errors import BadInput, WattlaneError
from engine.results.ground import Ground, ground_of
from engine.types import NONE
from engine.world import surface

SIDE = 150
"""Points along a side of the surface, about."""
OBSTACLE_M = 0.5
"""Height that obstacles are given: maps do not tell it."""
OVER_M = 0.12
NARROW = 1.9
BELIEVED = "believed"


def dialog() -> list[Any]:
    """The window, empty and closed, and what it is asked for. The map's button opens it: `wattlane.ground3d`."""
    heights = dmc.SegmentedControl(
        id=Ground3D.HEIGHTS,
        value="true",
        size="xs",
        data=[{"value": "true", "label": "As it is"}, {"value": BELIEVED, "label": "As the robot knows it"}],
        **{"aria-label": "Heights"},
    )
    again = html.Button("Show the present moment", id=Ground3D.AGAIN, type="button", className="wl-button")
    return [
        dcc.Store(id=Ground3D.ASKED),
        dmc.Modal(
            html.Div(
                [
                    html.Div([heights, again], className="wl-row"),
                    html.P(id=Ground3D.NOTE, role="status", className="wl-hint"),
                    html.Div(
                        graph(Ground3D.GRAPH, "The ground in 3-D"),
                        id=Ground3D.HOST,
                        className="wl-ground3d-host",
                        tabIndex=0,
                        role="group",
                        **{"aria-label": "The ground in 3-D; arrow keys turn it, + and − bring it nearer or farther"},
                    ),
                ],
                className="wl-ground3d",
            ),
            id=Ground3D.DIALOG,
            title="The ground in 3-D",
            fullScreen=True,
            zIndex=300,
            closeButtonProps={"aria-label": "Close"},
        ),
    ]


def scene(ground: Ground, time: float, *, believed: bool = False) -> Scene:
    """What stands where at a tick; believed: heights as the robot knows them."""
    world, view = ground.world, ground.view
    terrain, cell = world.terrain, world.grain_m
    _, cells = ground.looks(time)
    seen = surface.around(world, cells)
    height = np.where(seen | world.known, terrain.height_m, world.prior_m) if believed else terrain.height_m
    rows, columns = surface.grid_of(world, SIDE)
    changed = {place: there for place, there, _ in ground.obstacles(time)}
    stands = terrain.obstacle.copy()
    stands.flat[list(changed)] = [there > 0 for there in changed.values()]
    pose = view.poses(time)
    robot = np.array([[pose.x_m[0], pose.y_m[0]]], np.float64)
    track = [*driven(ground, time), robot]
    goal = world.graph.xy_m[ground.goal(time)][None]

    def on(xy: Any, above: float = OVER_M) -> Any:
        return surface.lifted(height, cell, xy, above)

    def boxes(mask: Any) -> Any:
        of = surface.boxes(mask) * cell
        base = on((of[:, :2] + of[:, 2:]) / 2, 0.0)[:, 2]
        low, high = np.column_stack([of[:, :2], base - 0.2]), np.column_stack([of[:, 2:], base + OBSTACLE_M])
        return np.stack([low, high], 1).astype(np.float32)

    return Scene(
        x=((columns + 0.5) * cell).astype(np.float32),
        y=((rows + 0.5) * cell).astype(np.float32),
        height_m=height[np.ix_(rows, columns)].astype(np.float32),
        seen=seen[np.ix_(rows, columns)],
        obstacles=boxes(stands & terrain.obstacle & seen),
        hidden=boxes(stands & terrain.obstacle & ~seen),
        dropped=boxes(stands & ~terrain.obstacle),
        way=on(ground.way(time)[1], 0.3),
        track=on(np.concatenate(track), 0.4),
        robot=on(robot, 0.5),
        heading_deg=float(pose.heading_deg[0]),
        goal=on(goal, 0.8),
    )


def driven(ground: Ground, time: float) -> list[Any]:
    """Points (n, 2) of every motion that has ended until a tick, behind the first cell."""
    world, told = ground.world, ground.track()
    until = time * ground.view.tick_s + 1e-6
    parts = [world.graph.xy_m[[told["start"]]].astype(np.float64)]
    for place, heading, k, t1_s in zip(told["place"], told["heading"], told["k"], told["t1_s"], strict=True):
        if t1_s <= until and k != NONE:
            n = int(world.cluster.pieces[heading, k])
            parts.append(world.graph.xy_m[place] + world.cluster.point[heading, k, 1 : n + 1] * world.grain_m)
    return parts


def sentence(ground: Ground, time: float, seen: float) -> str:
    """The moment in words: what is shown of it, and how large heights are drawn."""
    found, tick_s = ground.search(time), ground.view.tick_s
    way = "No way has been published yet."
    if found is not None and found["bound"] is None:
        way = "There is no way to the goal."
    elif found is not None and found["bound"] == 1:
        way = "The way ahead is the cheapest there is, as far as the robot knows."
    elif found is not None:
        way = f"The way ahead costs at most {found['bound']:g} times the least."
    return (
        f"{clock(time * tick_s)}. {100 * seen:.0f} % of the ground has been seen: bright; the rest is pale. {way} "
        f"Heights are drawn {TALLER:g} times as large. Drag or use the arrow keys to turn it."
    )


def eye_of(asked: Mapping[str, Any]) -> Eye:
    """Whence the ground was seen last; at first from the south, from farther away on a narrow screen."""
    if asked["eye"] is None:
        away = NARROW if asked["narrow"] else 1.0
        return EYE[0] * away, EYE[1] * away, EYE[2] * away
    x, y, z = (float(v) for v in asked["eye"])
    return x, y, z


def register(app: dash.Dash, manager: RunManager) -> None:
    """What the window shows, when it is asked."""

    @app.callback(
        Output(Ground3D.GRAPH, "figure"),
        Output(Ground3D.NOTE, "children"),
        Input(Ground3D.ASKED, "data"),
        prevent_initial_call=True,
    )
    def show(asked: Any) -> tuple[Any, Any]:
        def ask(view: Any) -> tuple[Scene, str]:
            ground = ground_of(view)
            if ground is None:
                raise BadInput("this run is on a floor; the 3-D view shows runs on terrain")
            end = float(view.t_end)
            at = end if asked["t"] is None else min(max(0.0, asked["t"] / view.tick_s), end)
            shown = scene(ground, at, believed=asked["heights"] == BELIEVED)
            return shown, sentence(ground, at, float(shown.seen.mean()))

        try:
            shown, words = manager.read(asked["run"], ask)
        except WattlaneError as error:
            return NOTHING, html.Span(str(error), className="wl-error", role="alert")
        return ground3d_figure(shown, asked["scheme"], eye=eye_of(asked)), words

    for name, source in (
        ("ground3dAgain", Input(Ground3D.AGAIN, "n_clicks")),
        ("ground3dHeights", Input(Ground3D.HEIGHTS, "value")),
        ("ground3dOpened", Input(Ground3D.DIALOG, "opened")),
    ):
        app.clientside_callback(ClientsideFunction("wattlane", name), source, prevent_initial_call=True)
