"""A quantity of several runs over time: each run's curve, and below it the difference from the first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike

from app.figures.base import empty_figure, line, on_axis, playhead, timed_figure
from app.theme import INK, LIGHT, SERIES, known_scheme

DASHES = ("solid", "dash", "dot", "dashdot")
UPPER, LOWER = (0.46, 1.0), (0.0, 0.32)


def comparing_figure(
    name: str,
    t_s: ArrayLike,
    runs: Mapping[str, ArrayLike],
    *,
    unit: str = "",
    nothing: str = "",
    parting_s: float | None = None,
    scheme: str = LIGHT,
) -> go.Figure:
    """t_s (m,) · runs: (m,) of each run by its letter, NaN where it has ended, the first one is compared with.

    nothing: what to say when every curve is zero throughout · parting_s: where the runs part, marked by a thin line.
    The first shape is the moment shown, at 0 until it is moved.
    """
    times = np.asarray(t_s, np.float64)
    values = {letter: np.asarray(curve, np.float64) for letter, curve in runs.items()}
    if len(times) < 2 or times[-1] <= 0 or not values:
        return empty_figure(name, "Nothing is recorded yet", scheme)
    if nothing and not any(np.nan_to_num(curve).any() for curve in values.values()):
        return empty_figure(name, nothing, scheme)
    figure = timed_figure(name, 0.0, times[-1], scheme)
    x, base = on_axis(times), next(iter(values.values()))
    ink = INK[known_scheme(scheme)]
    for number, (letter, curve) in enumerate(values.items()):
        style = line(SERIES[number], 2.0, dash=DASHES[number], shape="hv")
        hover = f"{letter} %{{y:,.6~g}} {unit}<extra></extra>"
        figure.add_scatter(x=x, y=curve, mode="lines", name=letter, line=style, hovertemplate=hover)
        if number:
            figure.add_scatter(
                x=x,
                y=curve - base,
                mode="lines",
                yaxis="y2",
                line=line(SERIES[number], 1.6, shape="hv"),
                showlegend=False,
                hovertemplate=f"{letter} − A %{{y:+,.4~g}} {unit}<extra></extra>",
            )
    playhead(figure, 0.0, scheme)
    if parting_s is not None:
        when = float(on_axis(parting_s))
        thin = {"color": ink["muted"], "width": 1, "dash": "dot"}
        figure.add_shape(type="line", xref="x", yref="paper", x0=when, x1=when, y0=0, y1=1, line=thin)
    figure.add_annotation(
        text="difference from A", xref="paper", yref="paper", x=0, y=LOWER[1], xanchor="left", yanchor="bottom",
        showarrow=False, font={"size": 10, "color": ink["muted"]},
    )  # fmt: skip
    figure.update_layout(
        showlegend=True,
        hovermode="x",
        xaxis={"anchor": "y2"},
        yaxis={"domain": UPPER, "rangemode": "tozero", "nticks": 4, "title": {"text": unit}},
        yaxis2={"domain": LOWER, "nticks": 3, "zeroline": True, "zerolinecolor": ink["muted"]},
    )
    return figure
