"""State of charge over time: a line per vehicle, or the spread of a large fleet, with the charging levels."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, on_axis, timed_figure, translucent
from app.theme import INK, LIGHT, SERIES, known_scheme

LINES_UP_TO = 20
LEVELS_SHOWN = ("critical", "good", "sufficient")


def soc_figure(
    data: Mapping[str, Any],
    levels: Mapping[str, float] | None = None,
    selected: int | None = None,
    scheme: str = LIGHT,
) -> go.Figure:
    """data: `t_s` (m,), `soc` (n, m) in 0…1 (NaN unknown), `vehicles` (n) · levels: charging levels in 0…1.

    Up to 20 vehicles are lines; beyond, the band from the 5th to the 95th percentile, median and least, and the
    selected vehicle on top.
    """
    t_s = np.asarray(data["t_s"], np.float64)
    soc = 100.0 * np.asarray(data["soc"], np.float64)
    vehicles = [int(v) for v in data["vehicles"]]
    if not len(t_s) or not vehicles:
        return empty_figure("soc", "No battery samples yet", scheme)
    figure = timed_figure("soc", t_s[0], t_s[-1], scheme)
    x = on_axis(t_s)
    if len(vehicles) <= LINES_UP_TO:
        _lines(figure, x, soc, vehicles, selected, scheme)
    else:
        _spread(figure, x, soc, vehicles, selected, scheme)
    ink = INK[known_scheme(scheme)]
    for name in LEVELS_SHOWN:
        if levels and (level := levels.get(name)) is not None:
            figure.add_hline(
                y=100.0 * level,
                line={"color": ink["muted"], "width": 1, "dash": "dot"},
                annotation={"text": name, "font": {"size": 10}, "xanchor": "left", "x": 0, "yanchor": "bottom"},
            )
    figure.update_yaxes(range=[0, 103], ticksuffix=" %")
    return figure


def _lines(figure: go.Figure, x: Any, soc: Any, vehicles: list[int], selected: int | None, scheme: str) -> None:
    order = sorted(range(len(vehicles)), key=lambda k: vehicles[k] == selected)
    for k in order:
        vehicle = vehicles[k]
        chosen = vehicle == selected
        colour = INK[known_scheme(scheme)]["select"] if chosen else SERIES[vehicle % len(SERIES)]
        figure.add_scatter(
            x=x,
            y=soc[k],
            mode="lines",
            name=f"vehicle {vehicle}",
            line=line(colour, 2.6 if chosen else 1.3),
            opacity=1.0 if chosen or selected not in vehicles else 0.4,
            hovertemplate=f"vehicle {vehicle}<br>%{{x}}<br>%{{y:.1f}} %<extra></extra>",
        )


def _spread(figure: go.Figure, x: Any, soc: Any, vehicles: list[int], selected: int | None, scheme: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # instants before the first sample are all NaN
        p5, median, p95 = np.nanpercentile(soc, [5, 50, 95], axis=0)
        least = np.nanmin(soc, axis=0)
    colour = SERIES[0]
    figure.add_scatter(x=x, y=p5, mode="lines", line=line(colour, 0), hoverinfo="skip", name="5th percentile")
    figure.add_scatter(
        x=x,
        y=p95,
        mode="lines",
        line=line(colour, 0),
        fill="tonexty",
        fillcolor=translucent(colour, 0.25),
        name="5th to 95th percentile",
        hoverinfo="skip",
    )
    for name, values, style in (
        ("median", median, line(colour, 2)),
        ("least", least, line(SERIES[3], 1.3, dash="dash")),
    ):
        figure.add_scatter(
            x=x, y=values, mode="lines", name=name, line=style, hovertemplate=f"{name} %{{y:.1f}} %<extra></extra>"
        )
    if selected in vehicles:
        _lines(figure, x, soc[[vehicles.index(selected)]], [selected], selected, scheme)
