"""Power at the battery over time, by component, stacked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, on_axis, timed_figure, translucent
from app.theme import COMPONENTS, LIGHT


def power_figure(data: Mapping[str, Any], scheme: str = LIGHT) -> go.Figure:
    """data: `t_s` (n,) ends of the spans and `watts`: name → (n,) their means; what is recovered lies below zero."""
    t_s = np.asarray(data["t_s"], np.float64)
    parts = {name: np.asarray(values, np.float64) for name, values in data["watts"].items()}
    if not len(t_s) or not parts:
        return empty_figure("power", "No power was drawn yet", scheme)
    figure = timed_figure("power", t_s[0], t_s[-1], scheme)
    x = on_axis(t_s)
    for name, values in parts.items():
        colour = COMPONENTS.get(name, "#888888")
        word = name.replace("_", " ")
        figure.add_scatter(
            x=x,
            y=values,
            mode="lines",
            name=word,
            stackgroup="recovered" if name == "recovered" else "drawn",
            line=line(colour, 0.5, shape="vh"),
            fillcolor=translucent(colour, 0.75),
            hovertemplate=f"{word} %{{y:.0f}} W<extra></extra>",
        )
    figure.update_layout(showlegend=True, hovermode="x")
    figure.update_yaxes(ticksuffix=" W")
    return figure
