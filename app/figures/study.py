"""A study's figures from their plain data, by kind; a figure of several floors gives a panel each.

The data of each kind is described in engine.studies.base.Figure. Tables are no charts: `study_panels` leaves them out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from app.figures.base import empty_figure, line, translucent
from app.theme import INK, LIGHT, SERIES, known_scheme, template

SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "star")
"""Series differ by more than their colour."""
DASHES = ("solid", "dash", "dot", "dashdot")
NAMED_ROWS = 24
"""A Gantt chart of so many rows names each."""
FLOOR = {LIGHT: ("#f4f6f9", "#6b7682"), "dark": ("#1c222b", "#566270")}
"""Free cells and obstacles."""

Data = Mapping[str, Any]


class Panel(NamedTuple):
    """One chart of a figure. caption: empty when the figure's title says it all · ratio: height over width, None when
    it may be any.
    """

    caption: str
    chart: go.Figure
    ratio: float | None = None


def study_panels(figure: Data, scheme: str = LIGHT) -> list[Panel]:
    """The charts of a figure {name, title, kind, data}; none for a table. Raises KeyError for an unknown kind."""
    kind, data = figure["kind"], figure["data"]
    if kind == "table":
        return []
    if kind == "floor":
        return [_floor(data, name, scheme) for name in data["paths"]]
    return [Panel("", CHARTS[kind](str(figure["name"]), data, scheme))]


def _chart(name: str, data: Data, scheme: str) -> go.Figure:
    """An empty chart with the figure's axes."""
    chart = go.Figure()
    chart.update_layout(template=template(scheme), uirevision=name, showlegend=True, barmode="group")
    words = any(isinstance(x, str) for each in data.get("series", ()) for x in each.get("x", ()))
    chart.update_xaxes(title_text=data.get("x_title", ""), type="category" if words else "-")
    chart.update_yaxes(title_text=data.get("y_title", ""))
    if data.get("log_y"):
        chart.update_yaxes(type="log", tickformat=".3~g", dtick="D2")
    return chart


def _lines(name: str, data: Data, scheme: str, mode: str = "lines+markers") -> go.Figure:
    if not any(len(each["x"]) for each in data["series"]):
        return empty_figure(name, "No values", scheme)
    chart = _chart(name, data, scheme)
    _bands(chart, data.get("bands", ()), scheme)
    for k, each in enumerate(data["series"]):
        colour = SERIES[k % len(SERIES)]
        chart.add_scatter(
            x=each["x"], y=each["y"], mode=mode if each.get("points", True) else "lines", name=each["name"],
            error_y=_whiskers(each, colour),
            line=line(colour, 2, dash=each.get("style") or DASHES[k % len(DASHES)]),
            marker={"size": 8, "symbol": SYMBOLS[k % len(SYMBOLS)], "color": colour},
            hovertemplate=f"{each['name']}<br>%{{x}}: %{{y:.4~g}}<extra></extra>",
        )  # fmt: skip
    return chart


def _scatter(name: str, data: Data, scheme: str) -> go.Figure:
    return _lines(name, data, scheme, "markers")


def _bars(name: str, data: Data, scheme: str) -> go.Figure:
    if not any(len(each["x"]) for each in data["series"]):
        return empty_figure(name, "No values", scheme)
    chart = _chart(name, data, scheme)
    for k, each in enumerate(data["series"]):
        colour = SERIES[k % len(SERIES)]
        chart.add_bar(
            x=each["x"], y=each["y"], name=each["name"], marker_color=colour, error_y=_whiskers(each, None),
            hovertemplate=f"{each['name']}<br>%{{x}}: %{{y:.4~g}}<extra></extra>",
        )  # fmt: skip
    _bands(chart, data.get("bands", ()), scheme)
    return chart


def _whiskers(each: Data, colour: str | None) -> dict[str, Any] | None:
    half = each.get("half")
    if not half or all(value is None for value in half):
        return None
    more = {} if colour is None else {"color": colour}
    return {"type": "data", "array": [value or 0.0 for value in half], "thickness": 1.4, "width": 5, **more}


def _bands(chart: go.Figure, bands: Sequence[Data], scheme: str) -> None:
    """What the paper prints: a bar from low to high at each x, a short line where both are one value."""
    ink = INK[known_scheme(scheme)]["select"]
    for each in bands:
        if not each["x"]:
            continue
        pairs = list(zip(each["low"], each["high"], strict=True))
        words = [f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in pairs]
        widths = [3 if low == high else 0 for low, high in pairs]
        chart.add_scatter(
            x=each["x"], y=[(low + high) / 2 for low, high in pairs], mode="markers", showlegend=False,
            marker={"symbol": "line-ew", "size": 24, "color": ink, "line": {"width": widths, "color": ink}},
            error_y={"type": "data", "array": [(high - low) / 2 for low, high in pairs], "thickness": 9, "width": 0,
                     "color": translucent(ink, 0.35)},
            customdata=words, hovertemplate=f"{each['name']}<br>%{{x}}: %{{customdata}}<extra></extra>",
        )  # fmt: skip
        marker = {"symbol": "square", "size": 9, "color": translucent(ink, 0.6)}
        chart.add_scatter(x=[each["x"][0]], y=[None], mode="markers", name=each["name"], marker=marker)


def _histogram(name: str, data: Data, scheme: str) -> go.Figure:
    values = [value for each in data["series"] for value in each["values"]]
    if not values:
        return empty_figure(name, "No values", scheme)
    chart = _chart(name, {"y_title": "count", **data}, scheme)
    edges = np.histogram_bin_edges(values, "auto")
    bins = {"start": edges[0], "end": edges[-1], "size": edges[1] - edges[0]}
    for k, each in enumerate(data["series"]):
        chart.add_histogram(
            x=each["values"], name=each["name"], xbins=bins, opacity=0.75, marker_color=SERIES[k % len(SERIES)]
        )
    chart.update_layout(barmode="overlay")
    return chart


def _gantt(name: str, data: Data, scheme: str) -> go.Figure:
    if not data["bars"]:
        return empty_figure(name, "Nothing was scheduled", scheme)
    chart = _chart(name, data, scheme)
    of: dict[str, list[Data]] = {}
    for bar in data["bars"]:
        of.setdefault(str(bar["name"]), []).append(bar)
    for k, (word, bars) in enumerate(of.items()):
        chart.add_bar(
            orientation="h", name=word, y=[str(bar["row"]) for bar in bars], base=[bar["begin"] for bar in bars],
            x=[bar["end"] - bar["begin"] for bar in bars], marker_color=SERIES[k % len(SERIES)],
            customdata=[[bar["begin"], bar["end"]] for bar in bars],
            hovertemplate=f"{word}<br>%{{y}}: %{{customdata[0]:.4~g}} to %{{customdata[1]:.4~g}}<extra></extra>",
        )  # fmt: skip
    chart.update_layout(barmode="overlay")
    rows = list(dict.fromkeys(str(bar["row"]) for bar in data["bars"]))
    chart.update_yaxes(autorange="reversed", type="category", categoryorder="array", categoryarray=rows)
    if len(rows) <= NAMED_ROWS:
        chart.update_yaxes(dtick=1)
    return chart


def _floor(data: Data, method: str, scheme: str) -> Panel:
    """One method's paths on the floor; vehicles that share cells are drawn a little apart."""
    free, wall = FLOOR[known_scheme(scheme)]
    ink = INK[known_scheme(scheme)]
    cells = np.array([[letter == "@" for letter in row] for row in data["rows"]], np.uint8)
    height, width = cells.shape
    chart = go.Figure(
        go.Heatmap(z=cells, zmin=0, zmax=1, colorscale=[[0, free], [1, wall]], showscale=False, hoverinfo="skip",
                   xgap=0.5, ygap=0.5)
    )  # fmt: skip
    ways = data["paths"][method]
    for k, way in enumerate(ways):
        xy = np.asarray(way, float) + 0.14 * (k - (len(ways) - 1) / 2)
        colour = SERIES[k % len(SERIES)] if len(ways) > 1 else ink["select"]
        word = f"vehicle {k + 1}" if len(ways) > 1 else method
        chart.add_scatter(
            x=xy[:, 0], y=xy[:, 1], mode="lines", line=line(colour, 2.6, dash=DASHES[k % len(DASHES)]), name=word,
            customdata=[[t, *cell] for t, cell in enumerate(way)],
            hovertemplate=f"{word}, step %{{customdata[0]}}: (%{{customdata[1]}}, %{{customdata[2]}})<extra></extra>",
        )  # fmt: skip
        for x, y, symbol, what in ((*xy[0], "circle", "start"), (*xy[-1], "star", "goal")):
            chart.add_scatter(
                x=[x], y=[y], mode="markers", showlegend=False, name=f"{what} of {word}",
                marker={"symbol": symbol, "size": 12, "color": colour, "line": {"width": 1, "color": ink["text"]}},
                hovertemplate=f"{what} of {word}<extra></extra>",
            )  # fmt: skip
    chart.update_layout(template=template(scheme), uirevision=method, showlegend=len(ways) > 1)
    chart.update_xaxes(range=[-0.5, width - 0.5], constrain="domain", showgrid=False, zeroline=False, nticks=6)
    chart.update_yaxes(
        range=[-0.5, height - 0.5], scaleanchor="x", constrain="domain", showgrid=False, zeroline=False, nticks=6
    )
    return Panel(str(data.get("captions", {}).get(method, method)), chart, height / width)


CHARTS: dict[str, Callable[[str, Data, str], go.Figure]] = {
    "lines": _lines,
    "bars": _bars,
    "scatter": _scatter,
    "histogram": _histogram,
    "gantt": _gantt,
}
