"""The RunLog's tables: names, columns, types and meaning. Pure data; anyone may import it.

A row is written when what it describes has ended; what is still open stands in the latest `keyframes` rows.
Times are ticks. `t1` is exclusive: the vehicle does this during [t0, t1).
"""

from __future__ import annotations

from engine.types import COMPONENTS

VERSION = 1

I8, I16, I32, I64, U8, TEXT, LIST = "int8", "int16", "int32", "int64", "uint8", "string", "list<int32>"

ENERGY_COLUMNS: tuple[str, ...] = tuple(f"{name}_mj" for name in COMPONENTS)

MOTION: dict[str, str] = {
    "vehicle": I32,
    "kind": I8,  # engine.types.Activity, or PRIMITIVE_0 + index into MotionGraph.primitives
    "cause": I8,  # engine.types.Cause, for waits
    "blocker": I32,  # the vehicle it waits for, or -1
    "t0": I32,
    "t1": I32,
    "from_place": I32,
    "to_place": I32,  # equals from_place when it stands
    "from_heading": I8,
    "to_heading": I8,
    "loaded": I8,  # 0 or 1, during the interval
    "order": I32,  # the order it serves, or -1
    "task": I8,  # engine.types.Task of the plan
    "energy_mj": I32,  # drawn by the motion itself, standby excluded
}

TABLES: dict[str, dict[str, str]] = {
    # What every vehicle did, gapless per vehicle from tick 0.
    "motions": MOTION,
    # Charge and ledger per vehicle at tick 0 and every `log.sample_s`; ledgers are cumulative since tick 0.
    "battery": {"tick": I32, "vehicle": I32, "charge_mc": I64, "voltage_mv": I32, **dict.fromkeys(ENERGY_COLUMNS, I64)},
    # State changes of a vehicle (engine.types.VehicleState), with what it is about.
    "states": {"tick": I32, "vehicle": I32, "state": I8, "task": I8, "order": I32, "cause": I8, "blocker": I32},
    # One row per change of an order (engine.types.OrderState).
    "orders": {
        "tick": I32,
        "order": I32,
        "state": I8,
        "vehicle": I32,
        "from_place": I32,
        "to_place": I32,
        "from_station": I32,  # station number, or -1
        "to_station": I32,
        "source": I8,  # 0 the scenario's, 1 an operator's
    },
    # Every committed plan: places in order with the interval during which each is reserved.
    "plans": {
        "tick": I32,
        "vehicle": I32,
        "task": I8,
        "order": I32,
        "status": TEXT,
        "places": LIST,
        "t_in": LIST,
        "t_out": LIST,  # FOREVER for the place where the plan ends
        "start": I32,
        "end": I32,  # tick of arrival at the last place
        "energy_mj": I64,  # planned, standby included
        "expanded": I32,
        "cpu_us": I32,  # outside the digest
    },
    # Charger bookings: state 0 booked, 1 connected, 2 released, 3 out of order, 4 back in order, 5 queued.
    "chargers": {"tick": I32, "charger": I32, "vehicle": I32, "state": I8},
    # Everything worth a line to a person.
    "events": {"tick": I32, "kind": TEXT, "level": I8, "vehicle": I32, "order": I32, "place": I32, "text": TEXT},
    # Operator's commands, in the order in which they were given; written before they are answered.
    "commands": {"tick": I32, "number": I32, "command": TEXT, "accepted": I8, "reason": TEXT},
    # Blocked places over time (operator's or faults'): blocked 1 or 0.
    "blocks": {"tick": I32, "place": I32, "blocked": I8},
    # What driving along each arc took in the period that ended at a tick, and what routers expect of it from then on.
    "arcs": {
        "tick": I32,
        "place": I32,
        "samples": I32,  # finished visits
        "mean_ms": I32,  # of those; 0 without any
        "sd_ms": I32,
        "busy_ms": I32,  # held
        "expected_ms": I32,  # of a router that learns; else the arc's own time
    },
    # Every pass of an anytime search that brought something new, with what it left to do; its way is in `plans`.
    "searches": {
        "tick": I32,
        "vehicle": I32,
        "bound": I32,  # thousandths: the way costs at most so many times the least; 0 without a way
        "cost": I64,  # of the way, in mJ or mm by the objective; -1 without a way
        "expanded": I32,  # states, since the row before
        "open": I32,  # states in OPEN
        "incons": I32,  # states in INCONS
        "open_places": LIST,  # their cells, thinned to at most THINNED
        "incons_places": LIST,
    },
    # What is still open: the running interval of every vehicle, and its counters, at a tick.
    "keyframes": {
        "tick": I32,
        **MOTION,
        "state": I8,
        "charge_mc": I64,
        "distance_mm": I64,
        "orders_done": I32,
    },
}

THINNED = 4000

OUTSIDE_DIGEST: dict[str, frozenset[str]] = {"plans": frozenset({"cpu_us"})}
"""Columns that may differ between two equal runs."""

NOT_IN_DIGEST: frozenset[str] = frozenset({"keyframes"})
"""Tables whose rows depend on when the log was flushed."""
