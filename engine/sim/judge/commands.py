"""Does every accepted command of an operator have its effect?"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.record import Record, RunLog, last_before, spans
from engine.types import Activity, OrderState
from engine.world.floor import World

Given = list[tuple[int, dict[str, Any]]]
"""Accepted commands with their ticks, in order."""


def commands(r: Record, log: RunLog, world: World) -> Iterator[Breach]:
    """A paused or failed vehicle starts no motion, a charger that is out charges nobody, and so on."""
    given: Given = []
    t = log.table("commands")
    for tick, text, accepted in zip(t["tick"].tolist(), t["command"], t["accepted"].tolist(), strict=True):
        if accepted:
            given.append((tick, json.loads(text)))
    yield from islice(_held(r, given), REPORTED)
    yield from islice(_chargers(r, given, world), REPORTED)
    yield from islice(_withdrawn(log, given), REPORTED)
    yield from islice(_blocks(log, given), REPORTED)
    yield from islice(_new_orders(log, given), REPORTED)


def _spans(given: Given, on: str, off: str, subject: str) -> dict[int, list[tuple[int, int]]]:
    """When each subject was switched on and off again by commands of two names."""
    return spans((int(c[subject]), tick, c["do"] == on) for tick, c in given if c.get("do") in (on, off))


def _held(r: Record, given: Given) -> Iterator[Breach]:
    for on, off, word in (("pause", "continue", "paused"), ("fail", "repair", "failed")):
        for vehicle, intervals in _spans(given, on, off, "vehicle").items():
            for begin, end in intervals:
                rows = np.nonzero(r.moves & (r.vehicle == vehicle) & (r.t0 >= begin) & (r.t0 < end))[0]
                for i in rows.tolist():
                    text = f"vehicle {vehicle} starts to drive at tick {int(r.t0[i])} though it is {word}"
                    yield Breach(BreachKind.COMMAND, int(r.t0[i]), (vehicle,), int(r.b[i]), text)


def _chargers(r: Record, given: Given, world: World) -> Iterator[Breach]:
    for charger, intervals in _spans(given, "charger out", "charger back", "charger").items():
        place = int(world.chargers[charger])
        for begin, end in intervals:
            charges = (r.kind == Activity.CHARGE) & (r.b == place) & (r.t1 > begin) & (r.t0 < end)
            for i in np.nonzero(charges)[0].tolist():
                v, tick = int(r.vehicle[i]), int(max(r.t0[i], begin))
                text = f"vehicle {v} charges at C{charger + 1} at tick {tick}, which is out of order"
                yield Breach(BreachKind.COMMAND, tick, (v,), place, text)


def _withdrawn(log: RunLog, given: Given) -> Iterator[Breach]:
    t = log.table("orders")
    for tick, command in given:
        if command["do"] != "withdraw":
            continue
        order = int(command["order"])
        states = t["state"][(t["order"] == order) & (t["tick"] >= tick)]
        if not (states == OrderState.WITHDRAWN).any():
            yield Breach(BreachKind.COMMAND, tick, (), -1, f"order {order} was withdrawn at tick {tick} and goes on")


def _blocks(log: RunLog, given: Given) -> Iterator[Breach]:
    t = log.table("blocks")
    place, tick = np.asarray(t["place"], np.int64), np.asarray(t["tick"], np.int64)
    order = np.lexsort((np.arange(len(place)), tick, place))
    key, flag = (place[order] << 32) + tick[order], np.asarray(t["blocked"], np.int64)[order]
    # of several commands for a place at one tick the last one counts
    wanted = {(int(c["place"]), when): c["do"] == "block" for when, c in given if c["do"] in ("block", "unblock")}
    for (where, when), want in wanted.items():
        is_now = int(last_before(key, flag, np.array([where]), np.array([when]), 0)[0])
        if is_now != want:
            word = "blocked" if want else "unblocked"
            yield Breach(BreachKind.COMMAND, when, (), where, f"place {where} was {word} at tick {when} without effect")


def _new_orders(log: RunLog, given: Given) -> Iterator[Breach]:
    t = log.table("orders")
    mine = (t["source"] == 1) & (t["state"] == OrderState.OPEN)
    made = Counter(zip(*(t[c][mine].tolist() for c in ("tick", "from_station", "to_station")), strict=True))
    for tick, command in given:
        if command["do"] != "order":
            continue
        wanted = (tick, int(command["from"]), int(command["to"]))
        made[wanted] -= 1
        if made[wanted] < 0:
            text = f"the order from station {wanted[1]} to {wanted[2]} was accepted at tick {tick} and never created"
            yield Breach(BreachKind.COMMAND, tick, (), -1, text)
