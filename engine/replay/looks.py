"""What a recording looks like: colours, class numbers, entity paths, and the blueprint it opens with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

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

GROUND = "ground"
TERRAIN = "ground/terrain"
SEEN = "ground/seen"
OBSTACLES = "ground/obstacles"
DROPPED = "ground/dropped"
FRONTIER_OPEN = "ground/open"
FRONTIER_INCONS = "ground/incons"
WAYS = "ground/ways"
DRIVEN = "ground/driven"
CLUSTER = "ground/trajectories"
ROBOT_POSE = "ground/robot"
GOAL = "ground/goal"
ALL_TRAJECTORIES = "cluster"
POWER = "power"
EPSILON = "search/epsilon"
EXPANDED = "search/expanded"
SIZE_OPEN = "search/frontier/open"
SIZE_INCONS = "search/frontier/incons"

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


OBSTACLE: RGBA = (104, 112, 126, 255)
DROPPED_COLOUR: RGBA = (248, 81, 73, 255)
OPEN_COLOUR: RGBA = (160, 255, 180, 255)
INCONS_COLOUR: RGBA = (255, 90, 200, 255)
GOAL_COLOUR: RGBA = (248, 210, 60, 255)
ROBOT: RGBA = (245, 150, 40, 255)
SEARCH_CURVES: dict[str, tuple[str, RGBA]] = {
    EPSILON: ("ε: proven bound", (255, 159, 67, 255)),
    EXPANDED: ("states expanded", (91, 192, 222, 255)),
    SIZE_OPEN: ("in OPEN", OPEN_COLOUR),
    SIZE_INCONS: ("in INCONS", INCONS_COLOUR),
}
LOW, MIDDLE, HIGH = (70, 118, 74), (170, 160, 104), (236, 226, 206)
"""Colours of the ground from its lowest to its highest point."""
ROUGH = (150, 96, 70)
"""Ground that resists rolling more than usual leans towards this."""
EPSILON_SPAN = (1.0, 2.5)
"""ε over which the colours of ways run; the paper begins with 2.5."""
POWER_SPAN_W = (40.0, 220.0)
"""Power of driving over which the driven path's colours run."""


def _between(share: Any, *colours: tuple[int, int, int]) -> Any:
    """(..., 3) colours at shares 0…1 of an evenly spaced ramp."""
    at = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(share, at, [colour[i] for colour in colours]) for i in range(3)], -1)


def _solid(rgb: Any) -> NDArray[np.uint8]:
    """(..., 4) opaque colours."""
    rounded = np.clip(np.rint(rgb), 0, 255).astype(np.uint8)
    return np.concatenate([rounded, np.full((*rounded.shape[:-1], 1), 255, np.uint8)], -1)


def ground_colours(height_m: Any, light: Any, friction: Any) -> NDArray[np.uint8]:
    """(..., 4) colours of ground by its height, light 0…1 and friction factor."""
    low, high = float(np.min(height_m)), float(np.max(height_m))
    rgb = _between((height_m - low) / max(high - low, 1e-9), LOW, MIDDLE, HIGH)
    lean = np.clip((np.asarray(friction)[..., None] - 1) * 0.6, 0, 0.7)
    rgb = rgb * (1 - lean) + np.array(ROUGH) * lean
    return _solid(rgb * (0.25 + 0.95 * np.asarray(light)[..., None]))


def pale(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The same ground before anybody has seen it: nearly grey, and dim."""
    rgb = colours[..., :3].astype(np.float64)
    grey = rgb.mean(-1, keepdims=True) * np.array([0.92, 0.98, 1.1])
    return _solid((0.2 * rgb + 0.8 * grey) * 0.62)


def ramp(watts: Any) -> NDArray[np.uint8]:
    """(N, 4) colours of the driven path by power in watts: green, yellow, red."""
    low, high = POWER_SPAN_W
    share = np.clip((np.asarray(watts, np.float64) - low) / (high - low), 0, 1)
    return _solid(_between(share, (63, 185, 80), (248, 210, 90), (248, 81, 73)))


def way(bound: int) -> str:
    """Entity path of the ways published with an ε in thousandths."""
    return f"{WAYS}/epsilon-{bound / 1000:g}"


def epsilon_colour(bound: int) -> RGBA:
    """Colour of a way by its ε in thousandths: from orange to blue, the cheapest."""
    low, high = EPSILON_SPAN
    share = np.clip((bound / 1000 - low) / (high - low), 0, 1)
    r, g, b = np.rint(_between(share, (56, 165, 255), (190, 120, 235), (255, 145, 40))).astype(int).tolist()
    return r, g, b, 255


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


def ground_blueprint(*, width_m: float, height_m: float) -> Any:
    """Terrain: the 3-D view in front, the map behind it, events and trajectories beside it, curves below."""
    span, corner = _whole_run(), rrb.PlotLegend("LeftTop")
    soc = rrb.TimeSeriesView(
        origin="battery",
        contents=[f"+ {SOC}", f"+ {SOC_LEVELS}/**"],
        name="State of charge [%]",
        axis_x=span,
        axis_y=rrb.ScalarAxis(range=(0.0, 105.0)),
        plot_legend=rrb.PlotLegend(visible=False),
    )

    def curve(origin: str, name: str) -> Any:
        return rrb.TimeSeriesView(origin=origin, name=name, axis_x=span, plot_legend=corner)

    log = rrb.TextLogView(
        origin=EVENTS,
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["sim_time"], text_log_columns=["LogLevel", "Body"]),
    )
    edge = 0.03 * max(width_m, height_m)
    flat = rrb.Spatial2DView(
        origin=MAP,
        name="Map",
        background=rrb.Background(color=BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=[-edge, width_m + edge], y_range=[-edge, height_m + edge]),
    )
    cluster = rrb.Spatial2DView(
        origin=ALL_TRAJECTORIES, name="All trajectories", background=rrb.Background(color=BACKGROUND)
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(_ground_view("Ground", "", width_m, height_m), flat, active_tab=0),
                rrb.Vertical(cluster, log, row_shares=[1, 1]),
                column_shares=[7, 2],
            ),
            rrb.Horizontal(
                rrb.Tabs(curve(POWER, "Power [W]"), curve(ENERGY, "Energy drawn [kJ]"), active_tab=0),
                rrb.Tabs(
                    curve(EPSILON, "ε"),
                    curve(EXPANDED, "States expanded"),
                    curve(f"{SIZE_OPEN.rsplit('/', 1)[0]}", "OPEN and INCONS"),
                    active_tab=0,
                ),
                soc,
            ),
            row_shares=[3, 1],
        ),
        _time_panel(),
        auto_views=False,
        auto_layout=False,
        collapse_panels=True,
    )


def _ground_view(name: str, root: str, width_m: float, height_m: float, away: float = 1.0) -> Any:
    """The 3-D view of a run whose entities stand below a root; what is seen and driven adds up to the time shown.

    away: how much farther off it is seen from than fills a wide view.
    """
    below = f"/{root}/" if root else "/"
    until_now = rrb.VisibleTimeRanges(
        timeline="sim_time",
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    return rrb.Spatial3DView(
        origin=f"{below}{GROUND}",
        name=name,
        background=rrb.Background(color=BACKGROUND),
        line_grid=False,
        overrides={f"{below}{path}": until_now for path in (SEEN, DRIVEN)},
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(0.5 * width_m, (0.4 - 0.68 * away) * height_m, 0.52 * away * max(width_m, height_m)),
            look_target=(0.5 * width_m, 0.4 * height_m, 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def blueprint_beside(names: Mapping[str, str], *, width_m: float, height_m: float, vehicles: int, ground: bool) -> Any:
    """The floors of several runs beside each other, below them what each comes to. names: by root, such as "A"."""
    if ground:
        floors = [_ground_view(name, root, width_m, height_m, away=1.4) for root, name in names.items()]
    else:
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
        if not ground or total != "orders_done"  # a robot on terrain has none
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
