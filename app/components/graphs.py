"""A chart with its caption; every graph gets the same configuration."""

from __future__ import annotations

from typing import Any

from dash import dcc, html

from app.theme import GRAPH_CONFIG

NOTHING: dict[str, Any] = {
    "layout": {
        "xaxis": {"visible": False},
        "yaxis": {"visible": False},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
    }
}
"""The figure of a graph that has nothing to show yet."""


def graph(graph_id: str, label: str) -> dcc.Graph:
    return dcc.Graph(
        id=graph_id,
        config=GRAPH_CONFIG,
        responsive=True,
        style={"height": "100%"},
        figure=NOTHING,
        **({"aria-label": label} if "aria-" in dcc.Graph().available_wildcard_properties else {}),
    )


def chart(graph_id: str, caption: str, *, hidden: bool = False) -> html.Figure:
    """A small chart with its caption above."""
    children: list[Any] = [
        html.Figcaption(caption),
        html.Div(graph(graph_id, caption), style={"flex": 1, "minHeight": 0}),
    ]
    return html.Figure(children, className="wl-chart", hidden=hidden)
