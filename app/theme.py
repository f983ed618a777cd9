"""Colours and the plotly templates, light and dark. The same colours stand in assets/web/style.css for the canvas."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

LIGHT, DARK = "light", "dark"

STATE_WORDS: tuple[str, ...] = ("idle", "moving", "waiting", "loading", "to charger", "charging", "fault", "paused")
"""Words for VehicleState, by its value."""

STATES: dict[str, tuple[str, ...]] = {
    LIGHT: ("#8a939d", "#2e9e4f", "#e07b16", "#12908e", "#5aaee6", "#1c6dd0", "#d32f2f", "#7b5fb0"),
    DARK: ("#8b949e", "#3fb950", "#f0883e", "#2dbeb4", "#8cc8ff", "#387dff", "#f85149", "#a78bda"),
}
"""Colour of VehicleState, by its value."""

INK: dict[str, dict[str, str]] = {
    LIGHT: {"text": "#17202b", "muted": "#53606f", "line": "#d5dbe3", "panel": "#ffffff", "select": "#d6006f"},
    DARK: {"text": "#e6edf3", "muted": "#9aa7b4", "line": "#313a45", "panel": "#161b22", "select": "#ff6fb5"},
}

SERIES: tuple[str, ...] = (
    "#4e79a7", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#76b7b2",
    "#edc948", "#9c755f", "#ff9da7", "#86bcb6", "#8cd17d", "#d37295",
)  # fmt: skip
"""Colours of things that have only a number, in turn."""

COMPONENTS: dict[str, str] = {
    "rolling": "#4e79a7",
    "turning": "#f28e2b",
    "starting": "#e15759",
    "climbing": "#76b7b2",
    "copper": "#9c755f",
    "standby": "#a3adb8",
    "running": "#edc948",
    "recovered": "#59a14f",
    "charged": "#1c8fe0",
    "charger_loss": "#b07aa1",
}
"""Colour of an energy component, by its name."""

GROUND: dict[str, dict[str, str]] = {
    LIGHT: {
        "low": "#86b174", "mid": "#e0d49a", "high": "#b98556", "unseen-low": "#c9d0d9", "unseen-high": "#eef1f4",
        "obstacle": "#3a434d", "hidden": "#98a2ad", "dropped": "#d32f2f", "way": "#0b57d0", "track": "#17202b",
        "goal": "#c2185b", "robot": "#c2410c",
    },
    DARK: {
        "low": "#3f7a57", "mid": "#96925f", "high": "#c99a6c", "unseen-low": "#2a323c", "unseen-high": "#59626d",
        "obstacle": "#c3ccd6", "hidden": "#6f7883", "dropped": "#ff6b61", "way": "#7cc0ff", "track": "#f4f7fa",
        "goal": "#ff8fc0", "robot": "#ffa94d",
    },
}  # fmt: skip
"""Colours of terrain in three dimensions; those of the map stand in assets/web/terrain.css."""

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif"

GRAPH_CONFIG: dict[str, Any] = {
    "displaylogo": False,
    "modeBarButtonsToRemove": ["sendChartToCloud", "select2d", "lasso2d"],
    "responsive": True,
    "scrollZoom": False,
}
"""`config` of every graph."""


def known_scheme(scheme: object) -> str:
    """`dark` for "dark", else `light`."""
    return DARK if scheme == DARK else LIGHT


def state_colour(word: str, scheme: str) -> str:
    """Colour of a state by its word; unknown words are idle's grey."""
    colours = STATES[known_scheme(scheme)]
    return colours[STATE_WORDS.index(word)] if word in STATE_WORDS else colours[0]


def template(scheme: str) -> go.layout.Template:
    """A small plotly template: transparent paper, thin grid, our font."""
    ink = INK[known_scheme(scheme)]
    axis = {
        "gridcolor": ink["line"],
        "linecolor": ink["line"],
        "zerolinecolor": ink["line"],
        "zerolinewidth": 1,
        "automargin": True,
        "ticks": "",
        "title": {"standoff": 4, "font": {"size": 11}},
    }
    return go.layout.Template(
        layout={
            "font": {"family": FONT, "size": 11, "color": ink["muted"]},
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "colorway": list(SERIES),
            "hovermode": "closest",
            "hoverlabel": {
                "bgcolor": ink["panel"],
                "bordercolor": ink["line"],
                "font": {"color": ink["text"], "family": FONT},
                "align": "left",
            },
            "margin": {"l": 8, "r": 8, "t": 6, "b": 6},
            "legend": {
                "orientation": "h",
                "y": 1.02,
                "yanchor": "bottom",
                "x": 0,
                "font": {"size": 10},
                "itemwidth": 30,
            },
            "xaxis": axis | {"ticklabelstandoff": 3},
            "yaxis": axis | {"ticklabelstandoff": 4},
            "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": ink["muted"], "activecolor": ink["text"]},
        }
    )
