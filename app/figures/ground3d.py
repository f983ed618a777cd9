"""Ground in three dimensions: what has been seen of it bright, the rest pale, with obstacles, way, track and robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from app.theme import GROUND, INK, LIGHT, known_scheme, template

F32 = NDArray[np.float32]

TALLER = 2.0
"""Heights are drawn so much larger than lengths: real ground looks flat on a screen."""
ABOVE_M, BELOW_M = 0.05, 0.1
"""The bright ground lies so far above the pale one, and its edge below it."""
NOSE_M = 2.0

Eye = tuple[float, float, float]
EYE: Eye = (0.0, -1.45, 1.15)
"""From the south, and above."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What is drawn; points are (N, 3) in metres, x east, y north, z up.

    x (W,), y (H,), height_m (H, W): the ground's grid · seen (H, W) · obstacles, hidden, dropped: (N, 2, 3) lower and
    upper corners of boxes, hidden those that the sensor has not seen · way, track: lines · robot: one point,
    heading_deg its heading · goal: one point or none.
    """

    x: F32
    y: F32
    height_m: F32
    seen: NDArray[np.bool_]
    obstacles: F32
    hidden: F32
    dropped: F32
    way: F32
    track: F32
    robot: F32
    heading_deg: float
    goal: F32


def ground3d_figure(scene: Scene, scheme: str = LIGHT, *, eye: Eye = EYE) -> go.Figure:
    """The scene. eye: whence it is seen, in plotly's units of the drawn space."""
    colours = GROUND[known_scheme(scheme)]
    figure = go.Figure()
    _surfaces(figure, scene, colours)
    for name, corners, colour in (
        ("obstacle", scene.obstacles, colours["obstacle"]),
        ("obstacle not seen yet", scene.hidden, colours["hidden"]),
        ("dropped by an operator", scene.dropped, colours["dropped"]),
    ):
        if len(corners):
            _boxes(figure, name, corners, colour)
    for name, points, colour, width in (
        ("way ahead", scene.way, colours["way"], 6),
        ("driven", scene.track, colours["track"], 5),
    ):
        if len(points) > 1:
            figure.add_scatter3d(**_columns(points), mode="lines", name=name, line={"color": colour, "width": width})
    _robot(figure, scene, colours)
    if len(scene.goal):
        marker = {"color": colours["goal"], "size": 8, "symbol": "cross"}
        figure.add_scatter3d(**_columns(scene.goal), mode="markers", name="goal", marker=marker)
    _space(figure, scene, scheme, eye)
    return figure


def _surfaces(figure: go.Figure, scene: Scene, colours: dict[str, str]) -> None:
    """Two surfaces, for on one the colours would run into each other: a pale one of the whole ground, and over it what
    has been seen, whose edge, which is shaded badly, goes below the other."""
    low, high = float(scene.height_m.min()), float(scene.height_m.max())
    tall = (colours["low"], colours["mid"], colours["high"])
    dim = (colours["unseen-low"], colours["unseen-high"])
    beside = binary_dilation(scene.seen, iterations=2)
    shift = np.where(scene.seen, ABOVE_M, np.where(beside, -BELOW_M, np.nan))
    for name, above, ramp in (("seen", shift, tall), ("not seen yet", 0.0, dim)):
        figure.add_surface(
            x=scene.x,
            y=scene.y,
            z=(scene.height_m + above).astype(np.float32),
            cmin=low,
            cmax=max(high, low + 1e-6),
            colorscale=[[i / (len(ramp) - 1), colour] for i, colour in enumerate(ramp)],
            showscale=False,
            name=name,
            lighting={"ambient": 0.62, "diffuse": 0.75, "specular": 0.03, "roughness": 0.95, "fresnel": 0.0},
            lightposition={"x": -20000, "y": 20000, "z": 25000},
            hovertemplate="x %{x:.1f} m, y %{y:.1f} m, height %{z:.2f} m<extra>" + name + "</extra>",
        )


def _boxes(figure: go.Figure, name: str, corners: F32, colour: str) -> None:
    """Upright boxes as one mesh: eight corners and twelve triangles each."""
    pick = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    vertices = corners[:, pick, np.arange(3)].reshape(-1, 3)
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 3, 7], [1, 7, 5]]
    )  # fmt: skip
    i, j, k = (8 * np.arange(len(corners))[:, None, None] + faces).reshape(-1, 3).astype(np.int32).T
    figure.add_mesh3d(
        **_columns(vertices),
        i=i,
        j=j,
        k=k,
        name=name,
        color=colour,
        flatshading=True,
        lighting={"ambient": 0.85, "diffuse": 0.35, "specular": 0.05},
        showlegend=True,
        hoverinfo="name",
    )


def _robot(figure: go.Figure, scene: Scene, colours: dict[str, str]) -> None:
    """A diamond, and a line that shows where it heads: its body is too small to be seen from afar."""
    angle = np.deg2rad(scene.heading_deg)
    ahead = scene.robot + np.array([[np.cos(angle) * NOSE_M, np.sin(angle) * NOSE_M, 0]], np.float32)
    figure.add_scatter3d(
        **_columns(np.concatenate([scene.robot, ahead])),
        mode="lines+markers",
        name="robot",
        line={"color": colours["robot"], "width": 8},
        marker={"color": colours["robot"], "size": [9, 0.1], "symbol": "diamond", "line": {"width": 0}},
    )


def _space(figure: go.Figure, scene: Scene, scheme: str, eye: Eye) -> None:
    ink = INK[known_scheme(scheme)]
    wide, deep = float(np.ptp(scene.x)), float(np.ptp(scene.y))
    tall = max(float(np.ptp(scene.height_m)), 0.5) + 1.5
    longest = max(wide, deep)
    axis = {
        "showbackground": False,
        "gridcolor": ink["line"],
        "linecolor": ink["line"],
        "zerolinecolor": ink["line"],
        "color": ink["muted"],
        "showspikes": False,
    }
    figure.update_layout(
        template=template(scheme),
        uirevision="ground3d",
        showlegend=True,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={"orientation": "h", "x": 0.01, "y": 0.99, "yanchor": "top", "itemsizing": "constant"},
        scene={
            "xaxis": axis | {"title": {"text": "x [m]"}, "nticks": 7},
            "yaxis": axis | {"title": {"text": "y [m]"}, "nticks": 7},
            "zaxis": axis | {"title": {"text": "height [m]"}, "nticks": 4},
            "aspectmode": "manual",
            "aspectratio": {
                "x": 1.7 * wide / longest,
                "y": 1.7 * deep / longest,
                "z": 1.7 * TALLER * tall / longest,
            },
            "camera": {
                "eye": dict(zip("xyz", eye, strict=True)),
                "center": {"x": 0.0, "y": -0.05, "z": -0.1},
            },
            "dragmode": "turntable",
        },
    )


def _columns(points: Any) -> dict[str, Sequence[float]]:
    return dict(zip("xyz", np.asarray(points, np.float32).T, strict=True))
