"""What the fleet does over time: shares of the vehicles, stacked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, on_axis, timed_figure, translucent
from app.theme import LIGHT, state_colour

ORDER = ("moving", "loading", "waiting", "charging", "idle", "fault")


def occupancy_figure(data: Mapping[str, Any], scheme: str = LIGHT) -> go.Figure:
    """data: `t_s` (n,) and shares 0…1 (n,) under `moving`, `loading`, `waiting`, `charging`, `idle`, `fault`."""
    t_s = np.asarray(data["t_s"], np.float64)
    if not len(t_s):
        return empty_figure("occupancy", "Nothing has happened yet", scheme)
    figure = timed_figure("occupancy", t_s[0], t_s[-1], scheme)
    x = on_axis(t_s)
    for name in ORDER:
        if name not in data or not np.any(np.asarray(data[name]) > 0):
            continue
        colour = state_colour(name, scheme)
        figure.add_scatter(
            x=x,
            y=100.0 * np.asarray(data[name], np.float64),
            mode="lines",
            name=name,
            stackgroup="fleet",
            line={"width": 0.5, "color": colour},
            fillcolor=translucent(colour, 0.8),
            hovertemplate=f"{name} %{{y:.0f}} %<extra></extra>",
        )
    figure.update_layout(showlegend=True, hovermode="x")
    figure.update_yaxes(range=[0, 100], ticksuffix=" %")
    return figure
