"""Words that every room shares: states, causes, components. Values are stored in logs: never renumber them."""

from __future__ import annotations

from enum import IntEnum, StrEnum

NONE = -1
"""'No place / vehicle / order' in integer arrays."""

FOREVER = 2**30
"""A tick later than any run; the open end of an interval."""


class Activity(IntEnum):
    """What a vehicle does during one interval of the motion table (`motions.kind` below PRIMITIVE_0)."""

    WAIT = 0
    PICK = 1
    DROP = 2
    CHARGE = 3
    REST = 4
    FAULT = 5
    PAUSE = 6


PRIMITIVE_0 = 16
"""`motions.kind - PRIMITIVE_0` indexes MotionGraph.primitives for intervals in which the vehicle moves."""


class Cause(IntEnum):
    """Why a vehicle waits (`motions.cause`)."""

    NONE = 0
    PLANNED = 1  # the plan itself waits here
    VEHICLE = 2  # another vehicle has not yet left a place (motions.blocker says which)
    BLOCKED = 3  # an operator or a fault blocked the place ahead
    DELAY = 4  # a seeded delay holds it
    NO_PLAN = 5  # it asked for a plan and none was found yet
    CHARGER_QUEUE = 6  # it needs a charger and all are taken
    OPERATOR = 7  # paused by the operator
    EMPTY = 8  # too little charge is left for the next motion


class VehicleState(IntEnum):
    """State shown for a vehicle (`states.state`)."""

    IDLE = 0
    MOVING = 1
    WAITING = 2
    LOADING = 3
    TO_CHARGER = 4
    CHARGING = 5
    FAULT = 6
    PAUSED = 7


class Task(IntEnum):
    """What a vehicle's present plan is for."""

    NONE = 0
    TO_PICK = 1
    TO_DROP = 2
    TO_REST = 3
    TO_CHARGER = 4
    SENT = 5


class OrderState(IntEnum):
    OPEN = 0
    ASSIGNED = 1
    PICKED = 2
    DONE = 3
    WITHDRAWN = 4


class Component(IntEnum):
    """Columns of the energy ledger, in millijoules at the battery terminals; drawn is positive."""

    ROLLING = 0
    TURNING = 1
    STARTING = 2
    CLIMBING = 3
    COPPER = 4
    STANDBY = 5
    RUNNING = 6
    RECOVERED = 7
    CHARGED = 8
    CHARGER_LOSS = 9


COMPONENTS: tuple[str, ...] = tuple(c.name.lower() for c in Component)


class StationKind(StrEnum):
    INBOUND = "inbound"
    OUTBOUND = "outbound"
    RACK = "rack"
    ENTRANCE = "entrance"
    STATION = "station"


class Occupancy(StrEnum):
    """How vehicles exclude each other; read by judge, reservations and planners alike."""

    MAPF = "mapf"
    HOLD = "hold"


class PlanStatus(StrEnum):
    """How planning ended; the value is the sentence a person reads."""

    SOLVED = "solved"
    BOUNDED = "bounded"
    NO_PATH = "no path"
    BUDGET_SPENT = "budget spent"
    INCONSISTENT = "inconsistent request"
    CHARGE = "too little charge"
