"""Energy drawn since the start, by component, stacked; what went the other way as lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, on_axis, timed_figure, translucent
from app.theme import COMPONENTS, LIGHT

BESIDE = ("charged", "recovered", "charger_loss")
"""Components that are not drawn from the battery: lines of their amount, outside the stack."""


def unit_of(most_j: float) -> tuple[float, str]:
    """Divisor and unit in which the largest value reads well."""
    if most_j >= 1e6:
        return 1e6, "MJ"
    return (1e3, "kJ") if most_j >= 1e3 else (1.0, "J")


def energy_figure(data: Mapping[str, Any], scheme: str = LIGHT) -> go.Figure:
    """data: `t_s` (n,) and `components`: name → (n,) joules, cumulative. Those that are always zero are left out."""
    t_s = np.asarray(data["t_s"], np.float64)
    parts = {name: np.asarray(values, np.float64) for name, values in data["components"].items()}
    parts = {name: values for name, values in parts.items() if len(values) and np.any(values != 0)}
    if not len(t_s) or not parts:
        return empty_figure("energy", "No energy was drawn yet", scheme)
    drawn = [values for name, values in parts.items() if name not in BESIDE]
    most = max([float(np.max(np.sum(drawn, axis=0)))] if drawn else [0.0])
    most = max([most, *(float(np.max(np.abs(parts[name]))) for name in BESIDE if name in parts)])
    divisor, unit = unit_of(most)
    figure = timed_figure("energy", t_s[0], t_s[-1], scheme)
    x = on_axis(t_s)
    for name, values in parts.items():
        colour = COMPONENTS.get(name, "#888888")
        word = name.replace("_", " ")
        stacked = name not in BESIDE
        style: dict[str, Any] = (
            {"stackgroup": "drawn", "line": line(colour, 0.5), "fillcolor": translucent(colour, 0.75)}
            if stacked
            else {"line": line(colour, 1.6, dash="dash")}
        )
        figure.add_scatter(
            x=x,
            y=(values if stacked else np.abs(values)) / divisor,
            mode="lines",
            name=word,
            hovertemplate=f"{word} %{{y:.2f}} {unit}<extra></extra>",
            **style,
        )
    figure.update_layout(showlegend=True, hovermode="x")
    figure.update_yaxes(ticksuffix=f" {unit}", rangemode="tozero")
    return figure
