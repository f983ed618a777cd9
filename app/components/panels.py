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
from app.theme import COMPONENTS

Record = Mapping[str, Any]
BOULDER_M = 0.8
"""Radius of the obstacle that a button drops on terrain; the map's menu has the same."""


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


def ways_panel(ways: Record | None) -> html.Div | None:
    """A router's ways beside other methods'; nothing for planners that nobody stands beside."""
    if ways is None:
        return None
    title = html.H2("The same ways by other methods")
    if not ways["ways"]:
        return html.Div([title, html.P("No way was asked for yet.", className="wl-hint")])
    head = html.Tr([html.Th(word) for word in ("Method", "Metres", "Above A*", "CPU ms")])
    rows = [
        html.Tr(
            [
                html.Td(name),
                html.Td(f"{one['length_m']:.1f}"),
                html.Td(f"{100 * one['above']:.1f} %"),
                html.Td(f"{one['cpu_ms']:.2f}"),
            ]
        )
        for name, one in ways["methods"].items()
    ]
    more = f", {ways['missing']} more to come" if ways["missing"] else ""
    words = (
        f"Mean length and median CPU time of the first {ways['ways']} distinct ways of this run{more}: each searched "
        "again by all methods, on the floor without vehicles and blocks. A* is exact."
    )
    table = html.Table([html.Thead(head), html.Tbody(rows)], className="wl-catalogue wl-plain")
    return html.Div([title, html.Div(table, className="wl-table-scroll"), html.P(words, className="wl-hint")])


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


def vehicle_commands(record: Record, *, ground: bool = False) -> list[html.Button]:
    """What can be done with a vehicle in its present state, as the map's menu offers it; on terrain nothing charges."""
    v, state, order = record["vehicle"], record["state"], record["order"]
    fit = state not in ("fault", "paused")
    full = record["soc"] is not None and record["soc"] >= 1.0
    offers: list[tuple[bool, str, dict[str, Any]]] = [
        (state == "paused", "Continue", {"do": "continue"}),
        (fit, "Pause", {"do": "pause"}),
        (not (ground or full) and state not in ("fault", "charging", "to charger"), "Charge now", {"do": "charge"}),
        (state == "fault", "Repair", {"do": "repair"}),
        (state != "fault", "Break down…", {"do": "fail"}),
    ]
    buttons = [command_button(word, {**command, "vehicle": v}) for offered, word, command in offers if offered]
    if fit and order is None:
        buttons.insert(1, action_button("Send to…", {"action": "send", "vehicle": v}))
    if order is not None and record["task"] == "to pick up" and state != "loading":
        buttons.insert(-1, command_button("Withdraw order…", {"do": "withdraw", "order": order}))
    return buttons


def vehicle_panel(record: Record, levels: Mapping[str, float], *, live: bool, ground: bool = False) -> html.Div:
    """One vehicle: what it does and why it waits, its charge and totals; commands when the run is live."""
    v = record["vehicle"]
    buttons = [action_button("Follow", {"action": "follow", "vehicle": v})]
    if live:
        buttons += vehicle_commands(record, ground=ground)
    state = html.Span(
        [
            html.Span(className="wl-dot", style={"background": f"var(--wl-state-{record['state'].replace(' ', '-')})"}),
            record["state"],
        ]
    )
    return html.Div(
        [
            html.H2("Robot" if ground else f"Vehicle {v}"),
            soc_bar(record["soc"], levels),
            html.P(f"It {record['why']}.", className="wl-why") if record["why"] else None,
            facts(
                [
                    ("State", state),
                    ("Since", clock(record["since_s"])),
                    ("Task", None if ground else record["task"] or "none"),
                    ("Order", None if ground else "none" if record["order"] is None else str(record["order"])),
                    ("Load", None if ground else "loaded" if record["loaded"] else "empty"),
                    ("At", select_button(record["place_name"] or str(record["place"]), {
                        "kind": "place", "id": record["place"], "place": record["place"]})),
                    ("Heading", f"{record['heading_deg'] % 360:.0f}°"),
                    ("Voltage", f"{record['voltage_v']:.1f} V"),
                    ("Energy drawn", energy(record["energy_j"])),
                    ("Distance", distance(record["distance_m"])),
                    ("Waited", span(record["waiting_s"])),
                    ("Orders done", None if ground else str(record["orders_done"])),
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
    ground: bool = False,
) -> html.Div:
    """A cell, station or charger: what is known of it, who is there, and blocking it; on terrain by an obstacle."""
    buttons = list(extra)
    if live:
        word = {"do": "unblock" if blocked else "block", "place": place, "label": name}
        if ground:  # all of it, or one that can't be stepped round
            word |= {"whole": 1} if blocked else {"radius_m": BOULDER_M}
        does = (
            ("Remove the obstacle", f"Drop an obstacle, {2 * BOULDER_M:g} m wide") if ground else ("Unblock", "Block…")
        )
        buttons.append(command_button(does[0 if blocked else 1], word))
    who = [select_button(f"vehicle {r['vehicle']}", {"kind": "vehicle", "id": r["vehicle"]}) for r in here]
    return html.Div(
        [
            html.H2(name),
            facts(
                [
                    *rows,
                    ("Blocked", None if ground else "yes" if blocked else "no"),
                    ("Here now", html.Span(who) if who else "nobody"),
                ]
            ),
            html.Div(buttons, className="wl-row"),
        ]
    )


def ground_rows(cell: Record) -> list[tuple[str, Any]]:
    """What there is to say of a cell of terrain, and what the robot knows of it."""
    knows = "seen" if cell["seen"] else "known beforehand" if cell["known"] else "not seen yet"
    height = f"{cell['height_m']:.2f} m"
    if not cell["known"]:
        height += f"; the robot reckons with {cell['prior_m']:.2f} m"
    slope = f"{cell['slope_deg']:.0f}°"
    if cell["slope_deg"] > cell["slope_limit_deg"]:
        slope += f", steeper than the {cell['slope_limit_deg']:g}° it drives on"
    obstacle = "yes" if cell["obstacle"] else "no"
    if cell["obstacle"] != cell["believed"]:
        obstacle += ", which the robot has not seen yet"
    return [
        ("Height", height),
        ("Slope", slope),
        ("Friction", f"× {cell['friction']:.2f}" if cell["friction"] != 1 else "× 1"),
        ("Obstacle", obstacle),
        ("Robot's view", knows),
    ]


def bound_words(search: Record | None) -> tuple[str, str]:
    """How good the published way is, and what that rests on."""
    if search is None:
        return "Searching for a first way", "Nothing is published yet"
    if search["bound"] is None:
        return "No way is known", "As far as the robot knows the ground, nothing leads to the goal"
    if search["bound"] <= 1:
        return "Optimal", "ε = 1: no way is cheaper on the ground as the robot knows it"
    return f"Within ≤ {search['bound']:g} × of the least", f"ε = {search['bound']:g}; it falls while there is time"


def ground_panel(robot: Record) -> html.Div:
    """A robot on terrain: how good its way is and what the search did for it, power, and energy by component."""
    search, record = robot["search"], robot["record"]
    bound, rests_on = bound_words(search)
    known = search or {"cost": None, "expanded": 0, "total": 0, "open": 0, "incons": 0, "ways": 0, "repairs": 0}
    length = known.get("objective") == "distance"
    cost = "–" if known["cost"] is None else f"{known['cost']:.1f} m" if length else energy(known["cost"])
    cards: list[tuple[str, tuple[str, str], str]] = [
        ("Cost of the way", _split(cost), "Of the way ahead, when it was published"),
        ("Ways published", _number(known["ways"]), "Passes that brought a new way or a better bound"),
        ("Expanded", _many(known["total"]), "States that the search has expanded so far"),
        ("In the last pass", _many(known["expanded"]), "States expanded for the way now shown"),
        ("OPEN", _many(known["open"]), "States left in OPEN by the last pass"),
        ("INCONS", _many(known["incons"]), "States left in INCONS by the last pass: for the next one"),
        ("Repairs", _number(known["repairs"]), "Ways mended because the ground turned out otherwise"),
        ("Power now", _number(robot["watts"], 0, "W"), "Mean of the last few seconds, at the battery"),
        ("Charge", _split(percent(record["soc"])), ""),
        ("Driven", _split(distance(record["distance_m"])), ""),
    ]
    return html.Div(
        [
            html.H2("Search"),
            html.P([bound, html.Small(rests_on)], className="wl-ground-bound", role="status"),
            html.P(f"The robot {record['why']}.", className="wl-why") if record["why"] else None,
            html.Dl(
                [
                    html.Div([html.Dt(name, title=tip), html.Dd([number, html.Small(unit)])], className="wl-kpi")
                    for name, (number, unit), tip in cards
                ],
                className="wl-kpis",
            ),
            html.H2("Energy so far"),
            energy_parts(robot["energy"]),
            html.P("Select a cell to see its height, slope, friction and obstacle; right-click it to drop an obstacle "
                   "or to send the robot there.", className="wl-hint"),
        ]
    )  # fmt: skip


def _many(count: int) -> tuple[str, str]:
    """A count of states: in thousands where it is large."""
    return _number(count / 1000, 1, "thousand") if count >= 10_000 else _number(count)


def energy_parts(parts: Mapping[str, float]) -> Any:
    """Energy by component in J, as bars with their numbers."""
    drawn = {name: value for name, value in parts.items() if value}
    if not drawn:
        return html.P("Nothing was drawn yet.", className="wl-hint")
    most = max(abs(value) for value in drawn.values())
    rows: list[Any] = []
    for name, value in drawn.items():
        style = {"width": f"{100 * abs(value) / most:.1f}%", "background": COMPONENTS.get(name, "#888888")}
        rows += [
            html.Dt(name.replace("_", " ")),
            html.Span(html.Span(style=style), className="wl-ground-bar", **{"aria-hidden": "true"}),
            html.Dd(energy(value)),
        ]
    total = sum(drawn.values())
    rows += [html.Dt(html.B("in all")), html.Span(), html.Dd(html.B(energy(total)))]
    return html.Dl(rows, className="wl-ground-parts")
