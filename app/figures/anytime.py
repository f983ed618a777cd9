"""An anytime search over time: ε of the published way, what the way ahead costs, and where it was repaired."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, on_axis, timed_figure
from app.figures.energy import unit_of
from app.theme import INK, LIGHT, SERIES, known_scheme

EPSILON, COST = SERIES[3], SERIES[0]


def anytime_figure(data: Mapping[str, Any], t0_s: float, t1_s: float, objective: str, scheme: str = LIGHT) -> go.Figure:
    """data: of engine.results.ground.Ground.passes · steps of ε to the left, of the cost to the right; a mark where a
    change of costs made a repair."""
    t_s, bound, cost = (np.asarray(data[name], np.float64) for name in ("t_s", "bound", "cost"))
    if not len(t_s):
        return empty_figure("anytime", "No way is published yet", scheme)
    divisor, unit = (1.0, "m") if objective == "distance" else unit_of(float(np.nanmax(cost, initial=0.0)))
    figure = timed_figure("anytime", t0_s, t1_s, scheme)
    x = on_axis(np.append(np.maximum(t_s, t0_s), t1_s))  # what holds, holds until now
    figure.add_scatter(
        x=x,
        y=np.append(cost, cost[-1]) / divisor,
        yaxis="y2",
        mode="lines",
        name="cost of the way ahead",
        line=line(COST, 1.6, shape="hv"),
        hovertemplate=f"%{{y:.2f}} {unit}<extra></extra>",
    )
    figure.add_scatter(
        x=x,
        y=np.append(bound, bound[-1]),
        mode="lines",
        name="ε",
        line=line(EPSILON, 2, shape="hv"),
        hovertemplate="within %{y:g} × of the least<extra></extra>",
    )
    mended = np.asarray(data["repaired"], np.bool_)
    if mended.any():
        figure.add_scatter(
            x=x[:-1][mended],
            y=cost[mended] / divisor,
            yaxis="y2",
            mode="markers",
            name="repaired",
            marker={"color": COST, "size": 6, "symbol": "diamond", "line": {"width": 1, "color": _ink(scheme)}},
            hovertemplate=f"repaired: %{{y:.2f}} {unit}<extra></extra>",
        )
    most = float(np.nanmax(bound, initial=1.0))
    figure.update_layout(
        showlegend=True,
        yaxis={"range": [0.9, max(most, 1.5) * 1.05], "title": "ε"},
        yaxis2={
            "overlaying": "y",
            "side": "right",
            "showgrid": False,
            "rangemode": "tozero",
            "ticksuffix": f" {unit}",
            "tickmode": "auto",
            "nticks": 5,
        },
    )
    return figure


def _ink(scheme: str) -> str:
    return INK[known_scheme(scheme)]["panel"]
