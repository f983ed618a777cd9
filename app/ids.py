"""Ids of the dashboard's components; the browser's code knows those marked with *."""

from __future__ import annotations

from enum import StrEnum


class Shell(StrEnum):
    """What stays while pages change."""

    PROVIDER = "theme-provider"
    URL = "url"  # *
    THEME = "theme"  # * kept in the browser's local storage
    THEME_SWITCH = "theme-switch"  # *
    NOTIFY = "notify"  # *
    HELP = "help"  # *
    HELP_BUTTON = "help-button"
    NAV = "nav"
    TITLE = "title"
    PAGE = "page"
    STATUS = "wl-status"  # *
    RUNS_CHANGED = "runs-changed"  # *
    REBIND = "rebind"  # *


class Stage(StrEnum):
    """One run on the screen: Operate and Replay alike."""

    CONFIG = "stage"
    MAP = "map"  # *
    TRANSPORT = "transport"  # *
    TABS = "tabs"  # *
    TABS_BOX = "tabs-box"
    SELECTION = "selection"  # *
    PULSE = "pulse"  # *
    ACK = "pulse-ack"
    EXTRA = "map-extra"
    BOUND = "stage-bound"
    SPAN = "chart-span"
    SIDE = "side-panel"
    BANNER = "run-banner"
    SOC = "soc-graph"
    OCCUPANCY = "occupancy-graph"
    THROUGHPUT = "throughput-graph"
    ENERGY = "energy-graph"
    POWER = "power-graph"
    ANYTIME = "anytime-graph"
    BANDS = "bands-graph"
    RESERVATIONS = "reservations-graph"
    RESERVATIONS_NOTE = "reservations-note"
    EVENTS = "events-grid"
    ORDERS = "orders-grid"
    CHARGERS = "chargers-grid"
    FLEET = "fleet-grid"  # *
    WAYS = "ways-grid"


class Ground3D(StrEnum):
    """The window with the ground in three dimensions."""

    DIALOG = "ground3d"  # *
    ASKED = "ground3d-asked"  # *
    HEIGHTS = "ground3d-heights"  # *
    AGAIN = "ground3d-again"
    NOTE = "ground3d-note"  # *
    HOST = "ground3d-host"  # *
    GRAPH = "ground3d-graph"  # *


class Start(StrEnum):
    """The start form."""

    SCENARIO = "start-scenario"
    PLANNER = "start-planner"
    DISPATCHER = "start-dispatcher"
    OBJECTIVE = "start-objective"
    FLEET = "start-fleet"
    SEED = "start-seed"
    RATE = "start-rate"
    MORE = "start-more"
    BUTTON = "start-button"
    ERROR = "start-error"
    KEYS = "start-keys"


class Operate(StrEnum):
    """Commands that concern the whole run, and the list of runs."""

    RUNS = "run-list"
    ORDER_FROM = "order-from"  # *
    ORDER_TO = "order-to"  # *
    ORDER_BUTTON = "order-button"
    RATE = "rate-value"
    RATE_BUTTON = "rate-button"
    LEVELS = "level"  # with -critical, -good …
    LEVELS_BUTTON = "levels-button"


class Replay(StrEnum):
    """What a recorded run offers."""

    FORK_PLANNER = "fork-planner"
    FORK_SEED = "fork-seed"
    FORK_MORE = "fork-more"
    FORK_BUTTON = "fork-button"
    FORK_AT = "fork-at"
    FORK_ERROR = "fork-error"
    RERUN_BUTTON = "rerun-button"
    RERUN = "rerun-modal"
    RERUN_HOST = "rerun-host"  # *
    CATALOGUE = "catalogue"
    PICK = "pick"  # with the run's id
    COMPARE = "compare-picked"
    PICKED = "picked"


class Compare(StrEnum):
    """Runs beside each other, and the form that starts them. Each run's letter follows MAP and NUMBERS."""

    CONFIG = "compare-config"
    BOUND = "compare-bound"
    DRAWN = "compare-drawn"
    TICK = "compare-tick"
    PROGRESS = "compare-progress"
    PARTING = "compare-parting"  # *
    GOTO = "compare-goto"  # *
    LEGEND = "compare-legend"  # *
    MAP = "map"  # *
    NUMBERS = "numbers"  # *
    ORDERS = "compare-orders"  # *
    ENERGY = "compare-energy"  # *
    WAITING = "compare-waiting"  # *
    ASKED = "compare-asked"
    SCENARIO = "compare-scenario"
    PLANNERS = "compare-planners"
    SEED = "compare-seed"
    LENGTH = "compare-length"
    CHANGES = "compare-changes"
    START = "compare-start"
    ERROR = "compare-error"


class Scenarios(StrEnum):
    """The library: what is chosen, its preview, starting it, importing."""

    CONFIG = "scenarios-config"
    BOUND = "scenarios-bound"
    DROP = "scenarios-drop"  # *
    IMPORT = "scenarios-import"  # *
    DETAIL = "scenarios-detail"  # *
    MAP = "scenarios-map"  # *
    LEGEND = "scenarios-legend"  # *
    FINDINGS = "scenarios-findings"  # *
    NAME = "scenarios-name"
    PLANNER = "scenarios-planner"
    OBJECTIVE = "scenarios-objective"
    OBJECTIVES = "scenarios-objectives"
    FLEET = "scenarios-fleet"
    SEED = "scenarios-seed"
    START = "scenarios-start"
    CAUTION = "scenarios-caution"  # *
    ERROR = "scenarios-error"


class Learn(StrEnum):
    """A lesson; its script fills most of it."""

    CONFIG = "lesson-config"
    BOUND = "lesson-bound"
    STAGE = "lesson"  # *
    CONTROLS = "lesson-controls"  # *
    NOW = "lesson-now"  # *
    LOOK = "lesson-look"  # *
    TRANSPORT = "lesson-transport"  # *
    PROBLEM = "lesson-problem"  # *


class Papers(StrEnum):
    """One study: how it is run, how far it is, which result is shown."""

    SHOWN = "papers-shown"
    RESULT = "papers-result"
    QUICK = "papers-quick"
    MAPS = "papers-maps"
    SEED = "papers-seed"
    RUN = "papers-run"
    CANCEL = "papers-cancel"
    ERROR = "papers-error"
    TICK = "papers-tick"
    PROGRESS = "papers-progress"
    RUNNING = "papers-running"
    FIGURES = "papers-figures"
    DRAWN = "papers-drawn"
