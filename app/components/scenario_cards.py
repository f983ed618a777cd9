"""The library's cards, and what there is to say of a scenario in words and tables."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dash import dcc, html

from app.components.basics import badge, facts
from app.library import Entry, is_instance

if TYPE_CHECKING:
    from engine.scenario import Scenario

TOML_SHOWN = 24_000
"""Letters of a scenario's text that the page shows; the download has all."""
PRIORS = {"full": "the whole ground", "coarse": "a coarse map of the heights", "none": "nothing of the ground"}
COUNTED = (("I", "inbound"), ("O", "outbound"), ("R", "racks"), ("C", "chargers"), ("P", "parking bays"))


def address(name: str) -> str:
    """The page's address with a scenario chosen; names need no quoting."""
    return f"/scenarios?scenario={name}"


def card(entry: Entry, chosen: bool) -> html.Li:
    """A link with a drawn preview, title and key numbers."""
    if entry.error:
        words: list[Any] = [badge("can't be read", "bad")]
    else:
        vehicles = f"{entry.fleet} vehicle{'' if entry.fleet == 1 else 's'}"
        words = [f"{entry.size.removesuffix(' cells')} · {vehicles} · {entry.planner}"]
    current = {"aria-current": "true"} if chosen else {}
    return html.Li(
        dcc.Link(
            [
                thumb(entry),
                html.Span(
                    [html.B(entry.title), html.Small(words), html.Span(marks(entry), className="wl-scn-marks")],
                    className="wl-scn-words",
                ),
            ],
            href=address(entry.name),
        ),
        className="current" if chosen else "",
        **current,
    )


def thumb(entry: Entry) -> html.Canvas:
    """A canvas that the browser fills with the floor; it stays empty where there is none."""
    floor = {} if entry.error else {"data-thumb": entry.name, "data-revision": entry.revision}
    return html.Canvas(className="wl-scn-thumb", **{"aria-hidden": "true"}, **floor)


def marks(entry: Entry) -> list[Any]:
    """What kind it is, and its paper, as badges."""
    return [
        badge("imported", "open") if entry.imported else badge("built in"),
        badge("instance", "dim") if entry.instance else None,
        html.Small(f"paper {entry.paper}") if entry.paper else None,
    ]


def action(text: str, what: str, name: str, *, danger: bool = False) -> html.Button:
    """A button for what the browser does to a scenario: rename, delete."""
    return html.Button(
        text,
        type="button",
        className=f"wl-button small{' wl-scn-danger' if danger else ''}",
        **{"data-scenario": json.dumps({"do": what, "name": name})},
    )


def paragraphs(text: str) -> list[html.P]:
    """A description's paragraphs; its own line ends inside them don't count."""
    return [html.P(" ".join(part.split())) for part in text.split("\n\n") if part.strip()]


def passport(scenario: Scenario, entry: Entry, about: Mapping[str, Any]) -> html.Dl:
    """What matters before a run."""
    floor, fleet, battery = scenario.floor, scenario.fleet, scenario.battery
    letters = Counter("".join(floor.drawing()))
    there = ", ".join(f"{letters[letter]} {word}" for letter, word in COUNTED if letters[letter])
    driving = f"{floor.connectivity} neighbours, occupancy {floor.occupancy}, turning {scenario.motion.turning}"
    ground = floor.terrain if floor.kind == "terrain" else None
    if ground is not None:
        driving = f"16 headings, trajectories {ground.cluster}, {scenario.motion.speed_mps:g} m/s"
        there = on_ground(ground)
    if entry.nodes:
        driving = f"along lanes, occupancy {floor.occupancy}, turning on the spot at nodes"
    files = " and ".join(about.get("files") or ())
    return facts(
        [
            ("Floor", entry.size if entry.nodes else f"{entry.size} of {floor.cell_m:g} m"),
            ("On it", there),
            ("Motion", driving),
            ("Knows beforehand", PRIORS[ground.prior] if ground else None),
            ("Sees", f"{ground.sensor_m:g} m around itself" if ground else None),
            ("Fleet", f"{'1 robot' if ground else f'{fleet.count} vehicles'} of {mass(scenario)} kg"),
            ("Orders", orders(scenario)),
            ("Planner", f"{scenario.planner.name}, least {scenario.planner.objective}"),
            ("Dispatcher", None if ground else scenario.dispatch.policy),
            ("Energy", f"{scenario.energy.demand}, {battery.capacity_wh:g} Wh {battery.model}"),
            ("Seed", str(scenario.seed)),
            ("Paper", scenario.paper),
            ("From", files),
            ("Trips", f"random, seed {about['random_seed']}" if about.get("random_seed") is not None else None),
            ("Imported", str(about.get("imported", ""))[:16].replace("T", " ")),
        ]
    )


def on_ground(ground: Any) -> str:
    """What there is on terrain, in words."""
    if ground.heights is not None:
        return "heights from a map"
    hills = f"{ground.generator}, seed {ground.seed}: {ground.hills} hills of up to {ground.hills_m:g} m"
    return f"{hills}, {ground.obstacles} obstacles, {ground.rough} rough patches"


def mass(scenario: Scenario) -> str:
    """Mass of the vehicles in kg; least and largest where they differ."""
    masses = sorted(set(scenario.fleet.each_mass_kg))
    return f"{masses[0]:g}" if len(masses) == 1 else f"{masses[0]:g} to {masses[-1]:g}"


def orders(scenario: Scenario) -> str:
    """Where the work comes from, in words."""
    given = scenario.orders
    if scenario.floor.kind == "terrain":
        return "none: the robot has one goal"
    if is_instance(scenario):
        return "none: every vehicle has one goal"
    if given.source == "listed":
        return f"{len(given.pairs)} listed"
    if given.source == "backlog":
        return f"a backlog of {given.backlog}, always refilled"
    limit = f", {given.limit} in all" if given.limit is not None else ""
    return f"Poisson, {given.rate_per_h:g} per hour{limit}"


def parameter_table(rows: Sequence[Mapping[str, Any]]) -> html.Div:
    """All settable keys with value and meaning; those that differ from the default stand out."""
    head = html.Tr([html.Th(word) for word in ("Key", "Value", "Default", "Meaning")])
    return html.Div(
        html.Table(
            [html.Thead(head), html.Tbody([_parameter(row) for row in rows if "." in row["key"]])],
            className="wl-catalogue wl-scn-parameters",
        ),
        className="wl-table-scroll",
        tabIndex=0,
        role="region",
        **{"aria-label": "Parameters"},
    )


def _parameter(row: Mapping[str, Any]) -> html.Tr:
    value, default = shown(row["value"]), "" if row["required"] else shown(row["default"])
    changed = value != default
    cells = [html.Code(row["key"]), html.B(value) if changed else value, default, row["description"]]
    return html.Tr([html.Td(cell) for cell in cells], className="changed" if changed else "")


def shown(value: Any) -> str:
    """A parameter's value, shortened."""
    if value is None or value == "":
        return "none"
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict | bool) else str(value)
    text = " ".join(text.split())
    return text if len(text) <= 60 else f"{text[:57]}…"


def toml_text(text: str) -> list[Any]:
    """The file as it is; a very long one is cut."""
    cut = len(text) > TOML_SHOWN
    note = html.P(f"… {len(text) - TOML_SHOWN:,} more letters; the download has all.", className="wl-hint")
    about = {"aria-label": "TOML"}
    pre = html.Pre(text[:TOML_SHOWN], className="wl-scn-toml", tabIndex=0, role="region", **about)
    return [pre, note if cut else None]
