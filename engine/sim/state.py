"""The simulation's arrays, grouped by who may write them. V vehicles, C components, S step slots per vehicle.

Fleet: the step kernel and the commands · Sink: the step kernel, drained by the log. Steps and claims are traffic's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.types import COMPONENTS, FOREVER, NONE, Activity

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

NC = len(COMPONENTS)

# Reasons for which the kernel hands over to the deciders (Sink.marks).
ORDER_DONE, ARRIVED, CHARGED, STALLED, EMPTY, PICKED, LOW = 1, 2, 4, 8, 16, 32, 64

# Clock fields. RESTLESS: the deciders want to be asked at every occasion.
TICK, LATE, SAMPLE, PATIENCE, MARGIN, HOLD, SEED, DELAY_PPM, DELAY_LO, DELAY_HI, HALF, DECIDE = range(12)
RESTLESS, LINGERING, OPEN_LOOP = range(12, 15)


class Fleet(NamedTuple):
    """One row per vehicle."""

    state: I32  # motion state at the end of the last interval
    kind: I8  # the open interval, as in the log's motions
    cause: I8
    blocker: I32
    of_order: I32  # order and task when the open interval began
    of_task: I8
    t0: I32
    t1: I32  # FOREVER while the vehicle stands
    edge: I32  # motion under way, or -1
    rolled: I32  # tick at which it last came out of a motion still rolling
    loaded: I8
    order: I32
    task: I8
    final: I8  # what it does when its steps are done: REST, CHARGE or WAIT (no plan)
    step: I32  # next step
    steps: I32  # number of steps
    here: I32  # claim of the place it stands in or drives into
    back: I32  # claim of the place it is leaving, or -1
    sweep: I32  # (V, 2) claims of corners under way
    charge: I64
    rest: I64  # charge remainder below one mC, in mJ·1000 units of the voltage
    ledger: I64  # (V, C) mJ since tick 0
    sampled: I64  # charge at the last sample
    distance: I64  # mm
    done: I32  # orders delivered
    cls: I8  # vehicle class
    paused: I8
    failed: I8
    hold: I32  # a delay lasts until this tick
    drawn: I32  # step for which a delay was last drawn
    motions: I32  # motions started
    stalled: I32  # tick since which it has waited for somebody, or -1
    wake: I32  # a standing vehicle need not be asked before this tick
    shown: I32  # (V, 5) last row of the states table


class Levels(NamedTuple):
    """Charge levels per vehicle in mC; the charger: gross and net mJ per tick; the battery over its state of charge."""

    full: I64
    top_up: I64
    sufficient: I64
    good: I64
    capacity: I64
    power: I64  # (2,)
    voltage_mv: I64  # (POINTS,)
    accept_mj: I64  # (POINTS,) most that it takes in per tick


class Sink(NamedTuple):
    """Rows not yet handed to the log."""

    motions: I64
    battery: I64
    states: I64
    marks: I64  # (n, 4): tick, vehicle, attention bit, order
    filled: I64  # rows in each


def new_fleet(n: int) -> Fleet:
    """A fleet that stands, does nothing and belongs nowhere yet."""

    def i32(fill: int = 0) -> I32:
        return np.full(n, fill, np.int32)

    def i8(fill: int = 0) -> I8:
        return np.full(n, fill, np.int8)

    def i64() -> I64:
        return np.zeros(n, np.int64)

    return Fleet(
        state=i32(), kind=i8(Activity.REST), cause=i8(), blocker=i32(NONE), of_order=i32(NONE),
        of_task=i8(), t0=i32(), t1=i32(FOREVER), edge=i32(NONE),
        rolled=i32(-1), loaded=i8(), order=i32(NONE), task=i8(), final=i8(Activity.REST), step=i32(), steps=i32(),
        here=i32(NONE), back=i32(NONE), sweep=np.full((n, 2), NONE, np.int32), charge=i64(), rest=i64(),
        ledger=np.zeros((n, NC), np.int64), sampled=i64(), distance=i64(), done=i32(), cls=i8(), paused=i8(),
        failed=i8(), hold=i32(), drawn=i32(-1), motions=i32(), stalled=i32(-1), wake=i32(),
        shown=np.full((n, 5), -2, np.int32),
    )  # fmt: skip


def new_sink(vehicles: int) -> Sink:
    """Row buffers, a few thousand ticks deep."""
    rows = max(65_536, 16 * vehicles)
    return Sink(
        np.zeros((rows, 14), np.int64),
        np.zeros((rows, 4 + NC), np.int64),
        np.zeros((rows, 7), np.int64),
        np.zeros((rows, 4), np.int64),
        np.zeros(4, np.int64),
    )
