"""Small pieces: icons, buttons that give commands, facts, badges, empty states; and how values are worded."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dash import html

Child = Any


def icon(name: str) -> html.Span:
    """An icon of assets/web/icons, in the colour of the text."""
    return html.Span(className=f"wl-icon wl-icon-{name}", **{"aria-hidden": "true"})


def command_button(text: str, command: Mapping[str, Any], *, kind: str = "") -> html.Button:
    """A button that gives an operator's command; the browser asks first where the consequence is serious."""
    return html.Button(
        text,
        type="button",
        className=f"wl-button small {kind}".strip(),
        **{"data-command": json.dumps(dict(command))},
    )


def action_button(text: str, action: Mapping[str, Any], *, kind: str = "", small: bool = True) -> html.Button:
    """A button for something the browser does: follow, send, resume, rename, delete, stop."""
    size = " small" if small else ""
    return html.Button(
        text,
        type="button",
        className=f"wl-button{size} {kind}".strip(),
        **{"data-action": json.dumps(dict(action))},
    )


def select_button(text: str, selection: Mapping[str, Any]) -> html.Button:
    """A link that selects something on the map and centres it."""
    return html.Button(text, type="button", className="wl-link", **{"data-select": json.dumps(dict(selection))})


def facts(rows: Sequence[tuple[str, Child]]) -> html.Dl:
    """A list of terms and values; rows without a value are left out."""
    children: list[Child] = []
    for term, value in rows:
        if value is not None and value != "":
            children += [html.Dt(term), html.Dd(value)]
    return html.Dl(children, className="wl-facts")


def badge(text: str, kind: str = "dim") -> html.Span:
    return html.Span(text, className=f"wl-badge {kind}")


def empty(title: str, sentence: str, *actions: Child) -> html.Div:
    """An empty state: says why, and names the first thing to do."""
    return html.Div(
        [
            html.H2(title),
            html.P(sentence),
            html.Div(list(actions), className="wl-row", style={"justifyContent": "center"}),
        ],
        className="wl-empty",
    )


def section(title: str, *children: Child, opened: bool = True) -> html.Details:
    return html.Details([html.Summary(title), *children], className="wl-section", open=opened)


def clock(time_s: float | None) -> str:
    """Seconds as HH:MM:SS; a dash when unknown."""
    if time_s is None:
        return "–"
    whole = int(time_s)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def span(time_s: float | None) -> str:
    """Seconds as a short span."""
    if time_s is None:
        return "–"
    if time_s < 90:
        return f"{time_s:.0f} s"
    return f"{time_s / 60:.0f} min" if time_s < 5400 else f"{time_s / 3600:.1f} h"


def energy(energy_j: float | None) -> str:
    if energy_j is None:
        return "–"
    if abs(energy_j) >= 1e6:
        return f"{energy_j / 1e6:.2f} MJ"
    return f"{energy_j / 1e3:.1f} kJ" if abs(energy_j) >= 1e3 else f"{energy_j:.0f} J"


def distance(distance_m: float | None) -> str:
    if distance_m is None:
        return "–"
    return f"{distance_m / 1000:.1f} km" if distance_m >= 10_000 else f"{distance_m:.0f} m"


def percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def size(size_bytes: float | None) -> str:
    if size_bytes is None:
        return "–"
    if size_bytes >= 1e9:
        return f"{size_bytes / 1e9:.1f} GB"
    return f"{size_bytes / 1e6:.1f} MB" if size_bytes >= 1e6 else f"{size_bytes / 1e3:.0f} kB"
