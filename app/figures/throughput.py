"""Orders done per hour, and orders still open."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, on_axis, timed_figure, translucent
from app.theme import LIGHT, SERIES


def throughput_figure(data: Mapping[str, Any], scheme: str = LIGHT) -> go.Figure:
    """data: `t_s` (n,), `per_h` (n,) orders done per hour over a sliding window, `open` (n,) orders not yet done."""
    t_s = np.asarray(data["t_s"], np.float64)
    if not len(t_s):
        return empty_figure("throughput", "No order is done yet", scheme)
    figure = timed_figure("throughput", t_s[0], t_s[-1], scheme)
    x = on_axis(t_s)
    done, waiting = SERIES[2], SERIES[1]
    figure.add_scatter(
        x=x,
        y=np.asarray(data["per_h"], np.float64),
        mode="lines",
        name="done per hour",
        line=line(done, 2),
        fill="tozeroy",
        fillcolor=translucent(done, 0.15),
        hovertemplate="%{y:.0f} done per hour<extra></extra>",
    )
    figure.add_scatter(
        x=x,
        y=np.asarray(data["open"], np.float64),
        mode="lines",
        name="open orders (right)",
        line=line(waiting, 1.5, shape="hv"),
        yaxis="y2",
        hovertemplate="%{y:.0f} open<extra></extra>",
    )
    figure.update_layout(
        showlegend=True,
        hovermode="x",
        yaxis={"rangemode": "tozero"},
        yaxis2={"overlaying": "y", "side": "right", "rangemode": "tozero", "showgrid": False,
                "tickmode": "auto", "nticks": 4, "tickformat": "d"},
    )  # fmt: skip
    return figure
