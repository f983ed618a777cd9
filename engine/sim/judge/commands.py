"""Does every accepted command of an operator have its effect?"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import islice

import numpy as np

from engine.scenario import Scenario
from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.levels import Given, accepted, levels
from engine.sim.judge.motion import name
from engine.sim.judge.record import Record, RunLog, last_before, spans
from engine.types import Activity, OrderState, Task
from engine.world.floor import World

IMPOSSIBLE = 1e-12
"""Numbers of arrivals less likely than this are no chance."""
_UPSETS = ("breakdown", "stranded", "deadlock", "stalled", "forked")


def commands(r: Record, log: RunLog, scenario: Scenario, world: World) -> Iterator[Breach]:
    """A paused or failed vehicle starts no motion, a charger that is out charges nobody, and so on."""
    given = accepted(log)
    yield from islice(held(r, given), REPORTED)
    yield from islice(_chargers(r, given, world), REPORTED)
    yield from islice(_withdrawn(log, given), REPORTED)
    yield from islice(blocks_set(log, given), REPORTED)
    yield from islice(_new_orders(log, given), REPORTED)
    yield from islice(_rates(log, given, scenario, r.end), REPORTED)
    yield from islice(_sent(r, log, given, world), REPORTED)
    yield from levels(r, log, given, scenario, world)


def _spans(given: Given, on: str, off: str, subject: str) -> dict[int, list[tuple[int, int]]]:
    """When each subject was switched on and off again by commands of two names."""
    return spans((int(c[subject]), tick, c["do"] == on) for tick, c in given if c.get("do") in (on, off))


def held(r: Record, given: Given) -> Iterator[Breach]:
    """Motions of vehicles that are paused or failed."""
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


def blocks_set(log: RunLog, given: Given) -> Iterator[Breach]:
    """Commands to block or free a place after which it is not so."""
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


def _rates(log: RunLog, given: Given, scenario: Scenario, end: int) -> Iterator[Breach]:
    """Orders arrive at the rate that was set: their number is one that Poisson arrivals may have."""
    t, e = log.table("orders"), log.table("events")
    mine = (t["source"] == 0) & (t["state"] == OrderState.OPEN)
    first = np.unique(t["order"][mine], return_index=True)[1]  # an order given back is open again
    arrivals = np.sort(np.asarray(t["tick"], np.int64)[mine][first])
    forks = [int(tick) for tick, kind in zip(e["tick"], e["kind"], strict=True) if kind == "forked"]
    changes = [(tick, float(c["per_h"])) for tick, c in given if c["do"] == "rate"]
    limited = scenario.orders.limit is not None
    for i, (given_at, per_h) in enumerate(changes):
        tick = max(given_at, log.first_tick)
        until = min([t for t in (*(c[0] for c in changes[i + 1 :]), *forks) if t >= tick], default=end)
        n = int(np.searchsorted(arrivals, until, side="right") - np.searchsorted(arrivals, tick, side="right"))
        mean = per_h / 3600 * scenario.time.tick_s * (until - tick)
        if arrivals_bound(n, mean) < IMPOSSIBLE and not (limited and n < mean):
            text = f"{n} orders arrive between ticks {tick} and {until}; at {per_h:g} per hour {mean:.1f} are expected"
            yield Breach(BreachKind.COMMAND, until, (), -1, text)


def arrivals_bound(n: int, mean: float) -> float:
    """Chernoff's bound of the chance of n or more, or of n or fewer, Poisson arrivals, whichever side n is on."""
    if n == 0 or mean == 0:
        return math.exp(-mean) if n == 0 else 0.0
    return math.exp(min(0.0, n - mean - n * math.log(n / mean)))


def _sent(r: Record, log: RunLog, given: Given, world: World) -> Iterator[Breach]:
    """A vehicle that is sent has a plan to the place, and its next plan begins there or it rests there.

    Not so when plans were given up on the way: somebody broke down or was blocked, or a deadlock was resolved.
    """
    p, e = log.table("plans"), log.table("events")
    upsets = [int(t) for t, kind in zip(e["tick"], e["kind"], strict=True) if kind in _UPSETS]
    upsets += [t for t, c in given if c["do"] in ("block", "charger out", "fail", "repair")]
    upsets += r.t0[r.kind == Activity.FAULT].tolist()
    values, offsets = p["places"]
    tick, found = np.asarray(p["tick"], np.int64), np.diff(offsets) > 0
    for when, command in given:
        if command["do"] != "send" or when < r.first_tick:
            continue
        v, place = int(command["vehicle"]), int(command["place"])
        mine = np.nonzero((p["vehicle"] == v) & found & (tick >= when))[0].tolist()
        sent = [i for i in mine if tick[i] == when and p["task"][i] == Task.SENT]
        to_it = [i for i in sent if values[offsets[i + 1] - 1] == place]
        where = name(world, place)
        if not to_it:
            text = f"vehicle {v} was sent to {where} at tick {when} and has no plan to it"
            yield Breach(BreachKind.COMMAND, when, (v,), place, text)
            continue
        later = [i for i in mine if i > to_it[-1]]
        until = int(tick[later[0]]) if later else r.end
        at = int(r.before(np.array([v]), np.array([until]))[0])
        ends_at = int(values[offsets[later[0]]]) if later else (int(r.b[at]) if at >= 0 else place)
        rests = later or (at >= 0 and r.kind[at] in (Activity.REST, Activity.CHARGE))
        if rests and ends_at != place and not any(when <= t <= until for t in upsets):
            text = f"vehicle {v} was sent to {where} at tick {when} and is at {name(world, ends_at)} at tick {until}"
            yield Breach(BreachKind.COMMAND, until, (v,), place, text)
