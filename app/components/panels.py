"""The side panel: the fleet's numbers, or what is selected with what can be done about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dash import html

from app.components.basics import (
    action_button,
    clock,
    command_button,
    distance,
    energy,
    facts,
    percent,
    select_button,
    span,
)

Record = Mapping[str, Any]


def _number(value: float | None, digits: int = 0, unit: str = "") -> tuple[str, str]:
    return ("–" if value is None else f"{value:.{digits}f}", unit)


def _split(text: str) -> tuple[str, str]:
    """`12.3 kJ` as number and unit."""
    number, _, unit = text.partition(" ")
    return number, unit


def kpi_panel(kpis: Record) -> html.Div:
    """The fleet's headline numbers; rates and shares are over the last hour."""
    cards: list[tuple[str, tuple[str, str], str]] = [
        ("Throughput", _number(kpis["throughput_per_h"], 0, "orders/h"), "Orders done per hour"),
        ("Orders done", _number(kpis["orders_done"]), ""),
        ("Open orders", _number(kpis["orders_open"]), "Created and not yet done"),
        ("Oldest unserved", _split(span(kpis["oldest_open_s"])), "Age of the oldest order not yet picked up"),
        ("Order time", _split(span(kpis["order_time_mean_s"])), "Mean, from creation to delivery"),
        ("Order time p95", _split(span(kpis["order_time_p95_s"])), ""),
        ("Utilisation", _split(percent(kpis["utilisation"])), "Share of the fleet's time spent on plans"),
        ("Waiting", _split(percent(kpis["waiting_share"])), "Share of the fleet's time"),
        ("Mean charge", _split(percent(kpis["soc_mean"])), ""),
        ("Least charge", _split(percent(kpis["soc_min"])), ""),
        ("Energy", _split(energy(kpis["energy_j"])), "Drawn from the batteries so far"),
        ("Energy per order", _split(energy(kpis["energy_per_order_j"])), ""),
        ("Planner p50", _number(kpis["planner_p50_ms"], 2, "ms"), "CPU time of a plan, median"),
        ("Planner p95", _number(kpis["planner_p95_ms"], 2, "ms"), "CPU time of a plan, 95th percentile"),
    ]
    if beside := kpis.get("beside_j"):
        tip = "What this energy model would have drawn for the same motions; no battery feels it"
        cards.insert(12, (f"Energy, {beside['model']}", _split(energy(beside["energy_j"])), tip))
    if kpis.get("stranded"):
        cards.insert(0, ("Stranded", _number(kpis["stranded"], 0, "vehicles"), "With an empty battery"))
    return html.Div(
        [
            html.H2("Fleet"),
            html.Dl(
                [
                    html.Div([html.Dt(name, title=tip), html.Dd([number, html.Small(unit)])], className="wl-kpi")
                    for name, (number, unit), tip in cards
                ],
                className="wl-kpis",
            ),
            html.P("Rates and shares over the last hour. Select a vehicle, station or charger to look into it.",
                   className="wl-hint"),
        ]
    )  # fmt: skip


def soc_bar(soc: float | None, levels: Mapping[str, float]) -> Any:
    """A bar of charge with its number, and the charging levels as ticks."""
    if soc is None:
        return "–"
    kind = "critical" if soc < levels.get("critical", 0) else "low" if soc < levels.get("good", 0) else ""
    ticks = [
        html.Span(
            className="wl-soc-tick", title=f"{name} {percent(levels[name])}", style={"left": f"{100 * levels[name]:g}%"}
        )
        for name in ("critical", "good", "sufficient")
        if name in levels
    ]
    fill = html.Span(className=f"wl-soc-fill {kind}", style={"width": f"{100 * soc:.1f}%"})
    return html.Div(
        [html.Span(percent(soc), className="wl-soc-number"), html.Span([fill, *ticks], className="wl-soc-bar")],
        className="wl-soc",
    )


def vehicle_commands(record: Record) -> list[html.Button]:
    """What can be done with a vehicle in its present state, as the map's menu offers it."""
    v, state, order = record["vehicle"], record["state"], record["order"]
    fit = state not in ("fault", "paused")
    full = record["soc"] is not None and record["soc"] >= 1.0
    offers: list[tuple[bool, str, dict[str, Any]]] = [
        (state == "paused", "Continue", {"do": "continue"}),
        (fit, "Pause", {"do": "pause"}),
        (state not in ("fault", "charging", "to charger") and not full, "Charge now", {"do": "charge"}),
        (state == "fault", "Repair", {"do": "repair"}),
        (state != "fault", "Break down…", {"do": "fail"}),
    ]
    buttons = [command_button(word, {**command, "vehicle": v}) for offered, word, command in offers if offered]
    if fit and order is None:
        buttons.insert(1, action_button("Send to…", {"action": "send", "vehicle": v}))
    if order is not None and record["task"] == "to pick up" and state != "loading":
        buttons.insert(-1, command_button("Withdraw order…", {"do": "withdraw", "order": order}))
    return buttons


def vehicle_panel(record: Record, levels: Mapping[str, float], *, live: bool) -> html.Div:
    """One vehicle: what it does and why it waits, its charge and totals; commands when the run is live."""
    v = record["vehicle"]
    buttons = [action_button("Follow", {"action": "follow", "vehicle": v})]
    if live:
        buttons += vehicle_commands(record)
    state = html.Span(
        [
            html.Span(className="wl-dot", style={"background": f"var(--wl-state-{record['state'].replace(' ', '-')})"}),
            record["state"],
        ]
    )
    return html.Div(
        [
            html.H2(f"Vehicle {v}"),
            soc_bar(record["soc"], levels),
            html.P(f"It {record['why']}.", className="wl-why") if record["why"] else None,
            facts(
                [
                    ("State", state),
                    ("Since", clock(record["since_s"])),
                    ("Task", record["task"] or "none"),
                    ("Order", "none" if record["order"] is None else str(record["order"])),
                    ("Load", "loaded" if record["loaded"] else "empty"),
                    ("At", select_button(record["place_name"] or str(record["place"]), {
                        "kind": "place", "id": record["place"], "place": record["place"]})),
                    ("Heading", f"{record['heading_deg'] % 360:.0f}°"),
                    ("Voltage", f"{record['voltage_v']:.1f} V"),
                    ("Energy drawn", energy(record["energy_j"])),
                    ("Distance", distance(record["distance_m"])),
                    ("Waited", span(record["waiting_s"])),
                    ("Orders done", str(record["orders_done"])),
                ]
            ),
            html.Div(buttons, className="wl-row"),
        ]
    )  # fmt: skip


def place_panel(
    name: str,
    rows: Sequence[tuple[str, Any]],
    here: Sequence[Record],
    *,
    place: int,
    blocked: bool,
    live: bool,
    extra: Sequence[Any] = (),
) -> html.Div:
    """A cell, station or charger: what is known of it, who is there, and blocking it."""
    buttons = list(extra)
    if live:
        word = {"do": "unblock" if blocked else "block", "place": place, "label": name}
        buttons.append(command_button("Unblock" if blocked else "Block…", word))
    who = [select_button(f"vehicle {r['vehicle']}", {"kind": "vehicle", "id": r["vehicle"]}) for r in here]
    return html.Div(
        [
            html.H2(name),
            facts([*rows, ("Blocked", "yes" if blocked else "no"), ("Here now", html.Span(who) if who else "nobody")]),
            html.Div(buttons, className="wl-row"),
        ]
    )
