"""Do the operator's charge levels hold, and does who was told to charge do so?

From the first `thresholds` command on: nobody charges beyond `full`, nobody rests at a working charger that should top
up, and nobody below `good` is given an order. What is known of a charge between two samples is that it does not rise
without charging.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

from engine.scenario import Scenario
from engine.sim.judge.batteries import battery_of
from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.motion import name
from engine.sim.judge.record import I64, Record, RunLog, spans
from engine.types import Activity, OrderState
from engine.world.floor import World

Given = list[tuple[int, dict[str, Any]]]
"""Accepted commands with their ticks, in order."""
TOP_UP, NEARLY_SUFFICIENT = 0.03, 0.97
"""A rested vehicle charges again this far below `full`, but not below this share of `sufficient`."""


def accepted(log: RunLog) -> Given:
    """Every accepted command of a run."""
    t = log.table("commands")
    rows = zip(t["tick"].tolist(), t["command"], t["accepted"].tolist(), strict=True)
    return [(tick, json.loads(text)) for tick, text, good in rows if good]


def levels(r: Record, log: RunLog, given: Given, scenario: Scenario, world: World) -> Iterator[Breach]:
    """Every breach of charge levels that an operator set, and every `charge` command without its effect."""
    yield from islice(_told_to_charge(r, log, given), REPORTED)
    changes = [(tick, c) for tick, c in given if c["do"] == "thresholds"]
    battery = battery_of(scenario)
    b = log.table("battery")
    if not changes or battery is None or r.n == 0 or len(b["tick"]) == 0:
        return
    tick = np.asarray(b["tick"], np.int64)
    keep = tick > changes[0][0]
    vehicle, tick = np.asarray(b["vehicle"], np.int64)[keep], tick[keep]
    soc = np.asarray(b["charge_mc"], np.int64)[keep] / battery.capacity_mc
    force = _InForce(scenario, changes)
    yield from islice(_at_chargers(r, (vehicle, tick, soc), force, given, world), REPORTED)
    if scenario.battery.exchange != "swap":  # else an order is the way to a full battery
        yield from islice(_orders_when_low(r, log, (vehicle, tick, soc), force), REPORTED)


class _InForce:
    """Charge levels over time."""

    def __init__(self, scenario: Scenario, changes: Given) -> None:
        now = {k: float(getattr(scenario.charging, k)) for k in ("good", "sufficient", "full")}
        self.since, rows = [-1], [dict(now)]
        for tick, command in changes:
            now.update({k: float(v) for k, v in command.items() if k in now})
            self.since.append(tick)
            rows.append(dict(now))
        self.level = {k: np.array([row[k] for row in rows]) for k in now}

    def at(self, level: str, tick: I64) -> Any:
        """A level in force during [tick, tick + 1)."""
        return self.level[level][np.searchsorted(self.since, tick, side="right") - 1]


def _at_chargers(
    r: Record, samples: tuple[I64, I64, Any], force: _InForce, given: Given, world: World
) -> Iterator[Breach]:
    vehicle, tick, soc = samples
    at = r.before(vehicle, tick)
    row = np.maximum(at, 0)
    known = (at >= 0) & (r.t1[row] > tick)
    full = force.at("full", tick)
    over = known & (r.kind[row] == Activity.CHARGE) & (soc > full + 1e-6)
    for i in np.nonzero(over)[0].tolist():
        v, t = int(vehicle[i]), int(tick[i])
        text = f"vehicle {v} charges at tick {t} with {soc[i]:.1%}; charging ends at {full[i]:.1%}"
        yield Breach(BreachKind.COMMAND, t, (v,), int(r.b[row[i]]), text)
    switched = ((int(c["charger"]), t, c["do"] == "charger out") for t, c in given if c["do"].startswith("charger "))
    out = {int(world.chargers[charger]): when for charger, when in spans(switched).items()}
    top_up = np.maximum(full - TOP_UP, force.at("sufficient", tick) * NEARLY_SUFFICIENT)
    idle = known & (r.kind[row] == Activity.REST) & np.isin(r.b[row], world.chargers) & (soc < top_up - 1e-6)
    for i in np.nonzero(idle)[0].tolist():
        v, t, place = int(vehicle[i]), int(tick[i]), int(r.b[row[i]])
        if any(begin <= t <= end for begin, end in out.get(place, ())):
            continue
        text = (
            f"vehicle {v} rests at {name(world, place)} at tick {t} with {soc[i]:.1%}; it charges below {top_up[i]:.1%}"
        )
        yield Breach(BreachKind.COMMAND, t, (v,), place, text)


def _assigned(log: RunLog) -> Iterator[tuple[int, int, int]]:
    """(tick, vehicle, order) of every assignment."""
    t = log.table("orders")
    rows = np.nonzero(np.asarray(t["state"]) == OrderState.ASSIGNED)[0]
    yield from zip(*(t[c][rows].tolist() for c in ("tick", "vehicle", "order")), strict=True)


def _charged(r: Record, vehicle: int, begin: int, end: int) -> bool:
    """True when a vehicle charges at any time during [begin, end]."""
    mine = (r.vehicle == vehicle) & (r.kind == Activity.CHARGE)
    return bool((mine & (r.t0 <= end) & (r.t1 > begin)).any())


def _orders_when_low(r: Record, log: RunLog, samples: tuple[I64, I64, Any], force: _InForce) -> Iterator[Breach]:
    vehicle, tick, soc = samples
    key = (vehicle << 32) + tick
    order = np.argsort(key, kind="stable")
    key, soc = key[order], soc[order]
    for t, v, number in _assigned(log):
        at = int(np.searchsorted(key, (v << 32) + t, side="right")) - 1
        if at < 0 or key[at] >> 32 != v:
            continue
        since = int(key[at] & 0xFFFFFFFF)
        # given at the tick of the command, it may have been before it
        good = min(float(force.at("good", np.array([when]))[0]) for when in (t - 1, t))
        if soc[at] < good - 1e-6 and not _charged(r, v, since, t):
            text = f"order {number} is given to vehicle {v} at tick {t} with {soc[at]:.1%}; below {good:.1%} it charges"
            yield Breach(BreachKind.COMMAND, t, (v,), -1, text)


def _told_to_charge(r: Record, log: RunLog, given: Given) -> Iterator[Breach]:
    """After a `charge` command a vehicle charges before it is given another order, unless levels are changed."""
    told = [(tick, int(c["vehicle"])) for tick, c in given if c["do"] == "charge" and tick >= r.first_tick]
    if not told:
        return
    changed = [tick for tick, c in given if c["do"] in ("thresholds", "repair")]
    assigned = sorted(_assigned(log))
    for tick, v in told:
        later = next(((t, o) for t, w, o in assigned if w == v and t > tick), None)
        if later is None or any(tick <= t <= later[0] for t in changed) or _charged(r, v, tick, later[0]):
            continue
        text = f"vehicle {v} was told to charge at tick {tick} and takes order {later[1]} at tick {later[0]} instead"
        yield Breach(BreachKind.COMMAND, later[0], (v,), -1, text)
