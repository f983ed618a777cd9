"""What a recording looks like: colours, class numbers, entity paths, and the blueprint it opens with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from engine.types import VehicleState

RGBA = tuple[int, int, int, int]

MAP = "world"
FLOOR = "world/floor"
STATIONS = "world/stations"
CHARGERS = "world/chargers"
CHARGER_LIGHTS = "world/chargers/light"
PARKING = "world/parking"
ONE_WAY = "world/one_way"
BLOCKED = "world/blocked"
ROUTES = "world/routes"
RESERVED = "world/reserved"
VEHICLES = "world/vehicles"
NOSES = "world/vehicles/nose"
NAMES = "world/vehicles/name"
LOADS = "world/vehicles/load"
LANES = "vehicles"
SOC = "battery/soc"
SOC_LEVELS = "battery/levels"
SOC_SPREAD = "battery/spread"
ACTIVITY = "fleet/activity"
ENERGY = "energy"
ORDERS = "orders"
TOTALS = "totals"
EVENTS = "events"
COMMANDS = "events/commands"

BACKGROUND: RGBA = (18, 22, 28, 255)
FLOOR_CLASSES: dict[str, tuple[int, str, RGBA]] = {
    "#": (1, "wall", (58, 66, 78, 255)),
    ".": (2, "aisle", (31, 37, 46, 255)),
    "R": (3, "rack", (92, 74, 52, 255)),
    "S": (4, "storage shelf", (70, 60, 48, 255)),
    "I": (5, "inbound station", (28, 84, 92, 255)),
    "O": (6, "outbound station", (84, 52, 104, 255)),
    "C": (7, "charger", (30, 58, 112, 255)),
    "P": (8, "parking", (46, 52, 62, 255)),
    ">": (9, "one-way aisle", (35, 42, 53, 255)),
}
"""Letter of a floor's cell → class number, name, colour; all one-way letters share one."""
JOINT_CLASS = 10
JOINT: tuple[str, RGBA] = ("between cells", (40, 47, 58, 255))

STATE_CLASS_0 = 32
"""Class number of VehicleState 0."""
STATES: dict[VehicleState, tuple[str, RGBA]] = {
    VehicleState.IDLE: ("idle", (139, 148, 158, 255)),
    VehicleState.MOVING: ("moving", (63, 185, 80, 255)),
    VehicleState.WAITING: ("waiting", (240, 136, 62, 255)),
    VehicleState.LOADING: ("loading", (45, 190, 180, 255)),
    VehicleState.TO_CHARGER: ("to charger", (140, 200, 255, 255)),
    VehicleState.CHARGING: ("charging", (56, 125, 255, 255)),
    VehicleState.FAULT: ("fault", (248, 81, 73, 255)),
    VehicleState.PAUSED: ("paused", (210, 168, 255, 255)),
}

CHARGER_CLASS_0 = 48
CHARGER_STATES: tuple[tuple[str, RGBA], ...] = (
    ("free", (90, 110, 140, 255)),
    ("booked", (140, 200, 255, 255)),
    ("charging", (56, 125, 255, 255)),
    ("out of order", (248, 81, 73, 255)),
)

LEVELS: dict[str, RGBA] = {
    "critical": (150, 60, 55, 255),
    "good": (150, 105, 55, 255),
    "sufficient": (70, 110, 75, 255),
}
"""Charge thresholds drawn beneath the state of charge."""

COMPONENT_COLOURS: dict[str, RGBA] = {
    "rolling": (63, 185, 80, 255),
    "turning": (240, 136, 62, 255),
    "starting": (248, 210, 90, 255),
    "climbing": (190, 140, 90, 255),
    "copper": (214, 120, 90, 255),
    "standby": (139, 148, 158, 255),
    "running": (45, 190, 180, 255),
    "recovered": (150, 220, 160, 255),
    "charged": (56, 125, 255, 255),
    "charger_loss": (120, 130, 220, 255),
}

CHARGING = ("charged", "charger_loss")
"""Components that charging adds, on a chart of their own: they dwarf the others."""

TOTAL_WORDS: dict[str, str] = {"orders_done": "Orders done", "energy_j": "Energy drawn [J]", "waiting_s": "Waiting [s]"}
"""What a run has come to, as `RunView.progress` tells it, for runs beside each other."""
RUN_COLOURS: tuple[RGBA, ...] = ((91, 192, 222, 255), (255, 159, 67, 255), (126, 211, 120, 255), (238, 120, 170, 255))

# Twelve hues that stay apart on a dark ground.
PALETTE: tuple[RGBA, ...] = (
    (91, 192, 222, 255),
    (255, 159, 67, 255),
    (126, 211, 120, 255),
    (238, 120, 170, 255),
    (160, 140, 255, 255),
    (245, 215, 90, 255),
    (77, 208, 190, 255),
    (255, 125, 105, 255),
    (150, 180, 255, 255),
    (200, 225, 110, 255),
    (215, 150, 235, 255),
    (205, 170, 125, 255),
)
EVENT_LEVELS: tuple[tuple[str, RGBA], ...] = (
    ("INFO", (150, 200, 235, 255)),
    ("WARN", (240, 190, 80, 255)),
    ("ERROR", (248, 81, 73, 255)),
)

FEW = 40
"""Up to so many vehicles each one's line and lane is worth seeing; beyond, the fleet's spread is."""

MANY_LABELS = 32
"""With more bays of a kind their labels would cover each other."""
WIDE_CELLS = 60
"""On a wider floor vehicles are drawn at a constant size on the screen, or nobody would see them."""


def vehicle_name(vehicle: int) -> str:
    """What a person calls a vehicle."""
    return f"AGV {vehicle}"


def vehicle_colour(vehicle: int) -> RGBA:
    return PALETTE[vehicle % len(PALETTE)]


def lane(vehicle: int, n: int) -> str:
    """Entity path of a vehicle's state lane; padded, so that lanes stand in the vehicles' order."""
    return f"{LANES}/AGV-{vehicle:0{len(str(n - 1))}d}"


def route(vehicle: int) -> str:
    """Entity path of a vehicle's planned route."""
    return f"{ROUTES}/AGV-{vehicle}"


def class_names() -> rr.AnnotationContext:
    """Names and colours of every class number in the map."""
    infos = [(0, "outside", BACKGROUND), (JOINT_CLASS, *JOINT)]
    infos += [(number, name, colour) for number, name, colour in FLOOR_CLASSES.values()]
    infos += [(STATE_CLASS_0 + state, name, colour) for state, (name, colour) in STATES.items()]
    infos += [(CHARGER_CLASS_0 + i, name, colour) for i, (name, colour) in enumerate(CHARGER_STATES)]
    return rr.AnnotationContext([rr.AnnotationInfo(id=i, label=name, color=colour) for i, name, colour in infos])


def _whole_run() -> rrb.TimeAxis:
    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeAxis(link="Independent", view_range=everything)


def blueprint(*, width_m: float, height_m: float, vehicles: int) -> Any:
    """Map and state lanes left, charts and events right, time panel on simulated time, playing."""
    floor = _floor("Floor", "", width_m, height_m, vehicles)
    soc_lines = f"+ {SOC}" if vehicles <= FEW else f"+ {SOC_SPREAD}"
    soc = rrb.TimeSeriesView(
        origin="battery",
        contents=[soc_lines, f"+ {SOC_LEVELS}/**"],
        name="State of charge [%]",
        axis_x=_whole_run(),
        axis_y=rrb.ScalarAxis(range=(0.0, 105.0)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    legend = rrb.PlotLegend("LeftTop")
    charts = rrb.Tabs(
        rrb.TimeSeriesView(
            origin=ENERGY,
            contents=["$origin/**", *(f"- $origin/{name}" for name in CHARGING)],
            name="Energy drawn [kJ]",
            axis_x=_whole_run(),
            plot_legend=legend,
        ),
        rrb.TimeSeriesView(
            origin="fleet",
            name="Occupancy [%]",
            axis_x=_whole_run(),
            axis_y=rrb.ScalarAxis(range=(0.0, 100.0)),
            plot_legend=legend,
        ),
        rrb.TimeSeriesView(
            origin=ENERGY,
            contents=[f"$origin/{name}" for name in CHARGING],
            name="Charged [kJ]",
            axis_x=_whole_run(),
            plot_legend=legend,
        ),
        rrb.TimeSeriesView(origin=ORDERS, name="Orders", axis_x=_whole_run(), plot_legend=legend),
        active_tab=0,
    )
    lanes = rrb.StateTimelineView(origin=LANES, name="What each vehicle does")
    log = rrb.TextLogView(
        origin=EVENTS,
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["sim_time"], text_log_columns=["LogLevel", "Body"]),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(floor, lanes, row_shares=[5, 3]),
            rrb.Vertical(soc, charts, log, row_shares=[1, 1, 1]),
            column_shares=[5, 3],
        ),
        _time_panel(),
        auto_views=False,
        auto_layout=False,
        collapse_panels=True,
    )


def blueprint_beside(names: Mapping[str, str], *, width_m: float, height_m: float, vehicles: int) -> Any:
    """The floors of several runs beside each other, below them what each comes to. names: by root, such as "A"."""
    floors = [_floor(name, root, width_m, height_m, vehicles) for root, name in names.items()]
    totals = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"+ /{root}/{TOTALS}/{total}" for root in names],
            name=text,
            axis_x=_whole_run(),
            plot_legend=rrb.PlotLegend("LeftTop"),
        )
        for total, text in TOTAL_WORDS.items()
    ]
    log = rrb.TextLogView(
        origin="/",
        contents=[f"+ /{root}/{EVENTS}/**" for root in names],
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["sim_time"], text_log_columns=["EntityPath", "LogLevel", "Body"]),
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Grid(*floors, grid_columns=2), rrb.Horizontal(*totals, log), row_shares=[5, 2]),
        _time_panel(),
        auto_views=False,
        auto_layout=False,
        collapse_panels=True,
    )


def _floor(name: str, root: str, width_m: float, height_m: float, vehicles: int) -> Any:
    """The map of a run whose entities stand below a root."""
    below = f"/{root}/" if root else "/"
    edge = 0.03 * max(width_m, height_m)
    return rrb.Spatial2DView(
        origin=f"{below}{MAP}",
        name=name,
        background=rrb.Background(color=BACKGROUND),
        # The routes of a large fleet hide the floor; the eye beside their name shows them.
        overrides={} if vehicles <= FEW else {f"{below}{ROUTES}": rrb.EntityBehavior(visible=False)},
        visual_bounds=rrb.VisualBounds2D(x_range=[-edge, width_m + edge], y_range=[-edge, height_m + edge]),
    )


def _time_panel() -> Any:
    return rrb.TimePanel(
        timeline="sim_time", state="collapsed", playback_speed=10.0, play_state="playing", loop_mode="off"
    )
