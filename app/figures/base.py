"""What all figures share: a time axis, the theme, a playhead, an empty figure that says why it is empty."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from app.theme import INK, known_scheme, template

MS = 1000.0
DAY_S = 86400.0


def on_axis(time_s: ArrayLike) -> NDArray[np.float64]:
    """Simulated seconds as the milliseconds since 1970 that a date axis takes: it then labels them as clock times.

    A whole number of two or four digits would be read as a year: it becomes a quarter of a millisecond more.
    """
    ms = np.asarray(time_s, np.float64) * MS
    year = ((ms >= 10) & (ms < 100)) | ((ms >= 1000) & (ms < 10_000))
    return np.asarray(np.where(year & (ms == np.rint(ms)), ms + 0.25, ms))


def timed_figure(name: str, t0_s: float, t1_s: float, scheme: str) -> go.Figure:
    """An empty figure whose x axis is simulated time from t0_s to t1_s. `name` keeps a person's zoom across updates."""
    figure = go.Figure()
    long = t1_s > DAY_S
    figure.update_layout(template=template(scheme), uirevision=name, showlegend=False)
    figure.update_xaxes(
        type="date",
        range=on_axis([t0_s, max(t1_s, t0_s + 1)]).tolist(),
        tickformat="%-d %H:%M" if long else ("%H:%M:%S" if t1_s - t0_s < 600 else "%H:%M"),
        hoverformat="day %-d %H:%M:%S" if long else "%H:%M:%S",
        nticks=6 if t1_s - t0_s >= 600 else 4,  # labels with seconds are wide
    )
    return figure


def playhead(figure: go.Figure, time_s: float, scheme: str) -> None:
    """A vertical line at the moment shown."""
    ink = INK[known_scheme(scheme)]
    figure.add_shape(
        type="line",
        xref="x",
        yref="paper",
        x0=float(on_axis(time_s)),
        x1=float(on_axis(time_s)),
        y0=0,
        y1=1,
        line={"color": ink["select"], "width": 1.5},
    )


def empty_figure(name: str, sentence: str, scheme: str) -> go.Figure:
    """A figure that says why there is nothing to see."""
    figure = go.Figure()
    figure.update_layout(template=template(scheme), uirevision=name, showlegend=False)
    figure.update_xaxes(visible=False)
    figure.update_yaxes(visible=False)
    figure.add_annotation(text=sentence, showarrow=False, xref="paper", yref="paper", x=0.5, y=0.5, font={"size": 12})
    return figure


def line(colour: str, width: float = 1.4, **more: Any) -> dict[str, Any]:
    return {"color": colour, "width": width, **more}


def translucent(colour: str, alpha: float) -> str:
    """`#rrggbb` as an rgba() text."""
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha:g})"
