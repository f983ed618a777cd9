"""State bands: what each vehicle did, as a lane of coloured intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import MS, empty_figure, on_axis, playhead, timed_figure
from app.theme import INK, LIGHT, STATE_WORDS, STATES, known_scheme

BARS_UP_TO = 2500
LANES_UP_TO = 60
"""Thinner lanes than these would lose bars to the rounding of pixels."""
COLUMNS = 900


def bands_figure(
    bands: Sequence[tuple[int, float, float, int]],
    t0_s: float,
    t1_s: float,
    now_s: float | None = None,
    selected: int | None = None,
    scheme: str = LIGHT,
) -> go.Figure:
    """bands: (vehicle, from s, to s, VehicleState) · one bar trace per state; for many intervals or vehicles a
    raster instead, whose columns show the state at their middle.
    """
    if not len(bands):
        return empty_figure("bands", "Nothing has happened yet", scheme)
    table = np.asarray([(v, a, b, int(s)) for v, a, b, s in bands], np.float64)
    table[:, 1] = np.maximum(table[:, 1], t0_s)
    table[:, 2] = np.minimum(table[:, 2], t1_s)
    table = table[table[:, 2] > table[:, 1]]
    if not len(table):
        return empty_figure("bands", "Nothing happened in this span", scheme)
    figure = timed_figure("bands", t0_s, t1_s, scheme)
    vehicles = np.unique(table[:, 0]).astype(int)
    if len(table) <= BARS_UP_TO and len(vehicles) <= LANES_UP_TO:
        _bars(figure, table, scheme)
    else:
        _raster(figure, table, vehicles, t0_s, t1_s, scheme)
    figure.update_yaxes(
        autorange="reversed",
        tickmode="array" if len(vehicles) <= 30 else "auto",
        tickvals=vehicles if len(vehicles) <= 30 else None,
        title="vehicle",
        showgrid=False,
        zeroline=False,
    )
    figure.update_layout(showlegend=True, barmode="overlay", bargap=0.15)
    if selected is not None and selected in vehicles:
        frame = {"color": INK[known_scheme(scheme)]["select"], "width": 1.5}
        figure.add_hrect(y0=selected - 0.5, y1=selected + 0.5, line=frame, fillcolor="rgba(0,0,0,0)")
    if now_s is not None:
        playhead(figure, now_s, scheme)
    return figure


def _bars(figure: go.Figure, table: Any, scheme: str) -> None:
    colours = STATES[known_scheme(scheme)]
    for state, word in enumerate(STATE_WORDS):
        rows = table[table[:, 3] == state]
        if not len(rows):
            continue
        figure.add_bar(
            orientation="h",
            y=rows[:, 0],
            base=on_axis(rows[:, 1]),
            x=(rows[:, 2] - rows[:, 1]) * MS,
            width=0.85,
            name=word,
            marker={"color": colours[state], "line": {"width": 0}},
            customdata=rows[:, 2] - rows[:, 1],
            hovertemplate=f"vehicle %{{y}}: {word}, %{{customdata:.0f}} s<extra></extra>",
        )


def _raster(figure: go.Figure, table: Any, vehicles: Any, t0_s: float, t1_s: float, scheme: str) -> None:
    """A heat map of state numbers with one flat colour per state."""
    colours = STATES[known_scheme(scheme)]
    middles = t0_s + (np.arange(COLUMNS) + 0.5) * (t1_s - t0_s) / COLUMNS
    grid = np.full((len(vehicles), COLUMNS), np.nan)
    for row, vehicle in enumerate(vehicles):
        own = table[table[:, 0] == vehicle]
        own = own[np.argsort(own[:, 1])]
        at = np.searchsorted(own[:, 1], middles, side="right") - 1
        inside = (at >= 0) & (middles < own[np.maximum(at, 0), 2])
        grid[row, inside] = own[at[inside], 3]
    n = len(STATE_WORDS)
    steps = [[edge / n, colour] for k, colour in enumerate(colours) for edge in (k, k + 1)]
    words = np.asarray([*STATE_WORDS, ""], dtype=object)
    figure.add_heatmap(
        x=on_axis(middles),
        y=vehicles,
        z=grid,
        zmin=-0.5,
        zmax=n - 0.5,
        colorscale=steps,
        showscale=False,
        text=words[np.where(np.isnan(grid), n, np.nan_to_num(grid)).astype(int)],
        hovertemplate="vehicle %{y}: %{text}, %{x}<extra></extra>",
        name="state",
        ygap=1 if len(vehicles) <= LANES_UP_TO else 0,
    )
    for state in np.unique(grid[~np.isnan(grid)]).astype(int):
        figure.add_scatter(
            x=[None], y=[None], mode="markers", name=STATE_WORDS[state],
            marker={"color": colours[state], "symbol": "square", "size": 9},
        )  # fmt: skip
