"""The reservation ribbon: places against time, a bar for each interval in which a vehicle holds a place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from app.figures.base import MS, empty_figure, on_axis, playhead, timed_figure
from app.theme import INK, LIGHT, SERIES, known_scheme

BARS_UP_TO = 2500
PLACES_UP_TO = 40
LABELS = 12


def ribbon_rows(
    data: Mapping[str, Any], t0: float, t1: float, selected: int | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The intervals to draw, cut to [t0, t1], and their places from the lane at the bottom up.

    With a vehicle selected these are its places in the order it comes to them; else the places reserved most often.
    """
    rows = {name: np.asarray(data[name]) for name in ("place", "t0", "t1", "vehicle")}
    inside = (rows["t1"] > t0) & (rows["t0"] < t1)
    rows = {name: values[inside] for name, values in rows.items()}
    rows["t0"] = np.maximum(rows["t0"], t0)
    rows["t1"] = np.minimum(rows["t1"], t1)
    if selected is not None and np.any(rows["vehicle"] == selected):
        own = rows["vehicle"] == selected
        by_time = np.argsort(rows["t0"][own], kind="stable")
        places = np.asarray(list(dict.fromkeys(rows["place"][own][by_time].tolist()))[:PLACES_UP_TO], np.int64)
    else:
        found, counts = np.unique(rows["place"], return_counts=True)
        places = np.sort(found[np.argsort(-counts, kind="stable")[:PLACES_UP_TO]])
    keep = np.isin(rows["place"], places)
    rows = {name: values[keep] for name, values in rows.items()}
    if len(rows["place"]) > BARS_UP_TO:
        latest = np.sort(np.argsort(rows["t0"], kind="stable")[-BARS_UP_TO:])
        rows = {name: values[latest] for name, values in rows.items()}
    return rows, places


def reservations_figure(
    data: Mapping[str, Any],
    t0_s: float,
    t1_s: float,
    tick_s: float = 1.0,
    now_s: float | None = None,
    selected: int | None = None,
    names: Mapping[int, str] | None = None,
    scheme: str = LIGHT,
) -> go.Figure:
    """data: arrays `place`, `t0`, `t1` (ticks), `vehicle` · names: what a place is called, else its number."""
    rows, places = ribbon_rows(data, t0_s / tick_s, t1_s / tick_s, selected)
    if not len(places):
        return empty_figure("reservations", "Nothing is reserved in this span", scheme)
    figure = timed_figure("reservations", t0_s, t1_s, scheme)
    lane = {int(place): k for k, place in enumerate(places)}
    y = np.asarray([lane[int(p)] for p in rows["place"]])
    labels = [(names or {}).get(int(p), str(int(p))) for p in places]
    colours = np.asarray(SERIES, dtype=object)[rows["vehicle"].astype(int) % len(SERIES)]
    if selected is not None:
        colours = np.where(rows["vehicle"] == selected, INK[known_scheme(scheme)]["select"], colours)
    figure.add_bar(
        orientation="h",
        y=y,
        base=on_axis(rows["t0"] * tick_s),
        x=(rows["t1"] - rows["t0"]) * tick_s * MS,
        width=0.8,
        marker={"color": colours.tolist(), "line": {"width": 0}},
        customdata=np.column_stack(
            [rows["vehicle"], [labels[k] for k in y], (rows["t1"] - rows["t0"]) * tick_s]
        ).tolist(),
        hovertemplate="%{customdata[1]}: vehicle %{customdata[0]}, %{customdata[2]} s<extra></extra>",
    )
    step = -(-len(places) // LABELS)
    figure.update_yaxes(
        tickmode="array",
        tickvals=list(range(0, len(places), step)),
        ticktext=labels[::step],
        title="place",
        zeroline=False,
        range=[-0.6, len(places) - 0.4],
    )
    figure.update_layout(barmode="overlay")
    if now_s is not None:
        playhead(figure, now_s, scheme)
    return figure
