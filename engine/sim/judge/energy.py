"""Does the energy add up? Every motion's energy anew from the scenario's numbers, the ledgers, and the batteries.

xu2025 (equations 2–6 and 12): rolling μ·m·g·l · a quarter turn also ½·I·ω² · a start also ½·m·v² · a reversal is two
turns and a start · standby P_s·Δt at every tick. I = m(length² + width²)/12. constant: a fixed percent of the battery
per second while moving. Each component of a motion is rounded once, half to even, to whole millijoules.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np

from engine.scenario import Scenario
from engine.sim.judge.batteries import Known, battery_of
from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.record import I64, Record, RunLog
from engine.types import COMPONENTS, Activity, Component
from engine.world.motion_graph import MotionGraph, Primitive

_LIAN2024 = {
    "mu": 0.015, "g": 9.81, "standby_w": 20.0, "wheel_m": 0.1, "track_m": 0.5, "gear": 30.0, "gear_efficiency": 0.85,
    "length_m": 0.5, "width_m": 0.5, "resistance_ohm": 0.4898, "emf_vs": 0.0327, "accel_mps2": 0.5, "brake_mps2": 0.5,
    "recovery": 0.0,
}  # fmt: skip
_CHARGING = (Component.CHARGED, Component.CHARGER_LOSS)


def energy(r: Record, log: RunLog, scenario: Scenario, graph: MotionGraph) -> Iterator[Breach]:
    """Every motion, ledger and battery that does not add up. Demand models without formulae here are not judged."""
    cost = costs(scenario, graph)
    if cost is not None:
        yield from _motions(r, cost, graph)
    samples = _samples(log)
    if samples is None:
        return
    if cost is not None:
        yield from _ledgers(r, samples, cost, scenario, graph)
    yield from _charging(r, samples, scenario)
    yield from batteries(r, samples, log, scenario)


def costs(scenario: Scenario, graph: MotionGraph) -> I64 | None:
    """Energy in mJ of (mass, primitive, empty or loaded, component); None for a demand model that the judge does not
    know. Vehicles have the masses in turn.
    """
    masses = scenario.fleet.masses_kg or (scenario.fleet.mass_kg,)
    each = [_costs(scenario, graph, mass) for mass in masses]
    return None if any(c is None for c in each) else np.stack([c for c in each if c is not None])


def _costs(scenario: Scenario, graph: MotionGraph, mass_kg: float) -> I64 | None:
    out = np.zeros((len(graph.primitives), 2, len(COMPONENTS)), np.int64)
    for k, primitive in enumerate(graph.primitives):
        for load, mass in enumerate((mass_kg, mass_kg + scenario.fleet.payload_kg)):
            if scenario.energy.demand == "xu2025":
                parts = xu2025_joules(primitive, mass, scenario.energy.parameters, scenario.motion.speed_mps)
            elif scenario.energy.demand == "lian2024":
                known = _lian2024(primitive, mass, scenario)
                if known is None:
                    return None
                parts = known
            elif scenario.energy.demand == "constant":
                percent = scenario.energy.parameters.get("percent_per_s", 1.0)
                joules = percent / 100 * scenario.battery.capacity_wh * 3600 * primitive.ticks * scenario.time.tick_s
                parts = {Component.RUNNING: joules}
            else:
                return None
            for component, joules in parts.items():
                out[k, load, component] = round(joules * 1000)
    return out


def xu2025_joules(
    primitive: Primitive, mass_kg: float, given: Mapping[str, float], speed_mps: float
) -> dict[Component, float]:
    """Energy of a motion by component, standby excluded. given: parameters over the defaults."""
    mu, g = given.get("mu", 0.01), given.get("g", 9.81)
    v_mps, omega = given.get("v_mps", speed_mps), given.get("omega", math.pi / 2)
    length_m, width_m = given.get("length_m", 1.2), given.get("width_m", 0.9)
    inertia = mass_kg * (length_m * length_m + width_m * width_m) / 12
    return {
        Component.ROLLING: mu * mass_kg * g * primitive.length_mm / 1000,
        Component.TURNING: primitive.turn_deg / 90 * inertia * omega * omega / 2,
        Component.STARTING: mass_kg * v_mps * v_mps / 2 if primitive.starts else 0.0,
    }


def _lian2024(primitive: Primitive, mass_kg: float, scenario: Scenario) -> dict[Component, float] | None:
    """Two motors with R and C_e behind a gear, phase by phase; None where braking motors or slow wheels need sampling.

    A start also bears the stop that follows it, and both give back the cruising that their ramps replace. In a turn
    the wheels speed up, keep on and slow down for a third of the time each.
    """
    given = {**_LIAN2024, "v_mps": scenario.motion.speed_mps, **scenario.energy.parameters}
    if given["recovery"]:
        return None
    eff, v, half = given["gear_efficiency"], given["v_mps"], given["track_m"] / 2
    drag = given["mu"] * mass_kg * given["g"] / 2  # of one wheel
    ampere_per_n = given["wheel_m"] / given["gear"] / given["emf_vs"] / eff
    metres, angle = primitive.length_mm / 1000, math.radians(primitive.turn_deg)
    took_s = primitive.ticks * scenario.time.tick_s

    def heat(force: float, seconds: float) -> float:
        """Copper loss of one motor that pulls; one that would have to brake is off."""
        return given["resistance_ohm"] * (force * ampere_per_n) ** 2 * seconds if force > 0 else 0.0

    out = {Component.ROLLING: 2 * drag * metres / eff, Component.COPPER: 2 * heat(drag, metres / v)}
    if primitive.starts:
        up, down = v / given["accel_mps2"], v / given["brake_mps2"]
        pull, slow = mass_kg * given["accel_mps2"] / 2, drag - mass_kg * given["brake_mps2"] / 2
        copper = heat(drag + pull, up) + heat(slow, down) - heat(drag, (up + down) / 2)
        work = (drag + pull) * v * up / 2 + max(slow, 0.0) * v * down / 2 - drag * v * (up + down) / 2
        out[Component.COPPER] += 2 * copper
        out[Component.STARTING] = 2 * work / eff
    if primitive.turn_deg:
        rolls = 0.0 if primitive.pivot or primitive.turn_deg == 180 else v
        third, top = took_s / 3, 1.5 * angle / took_s
        swing = mass_kg * (given["length_m"] ** 2 + given["width_m"] ** 2) / 12 * top / third / given["track_m"]
        if 0 < rolls <= top * half:
            return None
        copper = work = 0.0
        for side in (-1.0, 1.0):
            # along the wheel's own way: the outer wheel is pushed on by speeding up, the inner one of a roll held back
            own = 1.0 if rolls == 0 else side
            for push, mean in ((swing, 0.5), (0.0, 1.0), (-swing, 0.5)):
                force, speed = drag + own * push, abs(rolls + side * mean * top * half)
                copper += heat(force, third) - (heat(drag, third) if rolls else 0.0)
                work += max(force, 0.0) * speed * third
        out[Component.COPPER] += copper
        out[Component.TURNING] = (work - 2 * drag * rolls * took_s) / eff
    return out


def standby_mj(scenario: Scenario) -> int:
    """Standby energy per tick."""
    fallback = {"xu2025": 30.0, "lian2024": _LIAN2024["standby_w"]}.get(scenario.energy.demand, 0.0)
    return round(scenario.energy.parameters.get("standby_w", fallback) * scenario.time.tick_s * 1000)


def _motions(r: Record, cost: I64, graph: MotionGraph) -> Iterator[Breach]:
    """The energy logged with each motion."""
    total = cost.sum(3)
    expected = np.where(r.moves, total[r.vehicle % len(cost), r.primitive, np.clip(r.loaded, 0, 1)], 0)
    cut = np.nonzero(r.cut)[0]
    if len(cut):
        expected[cut] = _part(r, cut, cost, graph, r.t1[cut]).sum(1)
    rows = np.nonzero((r.energy_mj != expected) & r.legal & ~r.still)[0][:REPORTED]
    for i in rows.tolist():
        v, t = int(r.vehicle[i]), int(r.t0[i])
        logged, right = int(r.energy_mj[i]), int(expected[i])
        text = f"the motion of vehicle {v} at tick {t} is logged with {logged} mJ; {right} are right"
        yield Breach(BreachKind.ENERGY, t, (v,), int(r.b[i]), text)


def _part(r: Record, rows: I64, cost: I64, graph: MotionGraph, until: I64) -> I64:
    """Energy (rows, components) of motions up to a tick: spread over their ticks by cumulative floor."""
    whole = cost[r.vehicle[rows] % len(cost), r.primitive[rows], np.clip(r.loaded[rows], 0, 1)] * r.moves[rows, None]
    ticks = np.maximum(np.asarray(graph.kind_ticks, np.int64)[r.primitive[rows]], 1)
    passed = np.clip(np.minimum(until, r.t1[rows]) - r.t0[rows], 0, ticks)
    return np.asarray(whole * passed[:, None] // ticks[:, None])


class Samples:
    """Battery rows by vehicle and tick; `follows` where the row before is the same vehicle's."""

    def __init__(self, log: RunLog) -> None:
        b = log.table("battery")
        vehicle, tick = np.asarray(b["vehicle"], np.int64), np.asarray(b["tick"], np.int64)
        order = np.lexsort((tick, vehicle))
        self.vehicle, self.tick = vehicle[order], tick[order]
        self.charge = np.asarray(b["charge_mc"], np.int64)[order]
        self.voltage = np.asarray(b["voltage_mv"], np.int64)[order]
        self.ledger = np.stack([np.asarray(b[f"{name}_mj"], np.int64)[order] for name in COMPONENTS], 1)
        self.follows = np.zeros(len(order), np.bool_)
        self.follows[1:] = self.vehicle[1:] == self.vehicle[:-1]


def _samples(log: RunLog) -> Samples | None:
    samples = Samples(log)
    return samples if len(samples.tick) else None


def _sums(r: Record, s: Samples, cost: I64, graph: MotionGraph) -> I64:
    """Energy of every vehicle's motions up to each sample, (samples, components), from its first interval on."""
    if r.n == 0:
        return np.zeros_like(s.ledger)
    at, first = r.before(s.vehicle, s.tick), r.first(s.vehicle)
    known = at >= 0
    part = _part(r, np.maximum(at, 0), cost, graph, s.tick)
    out = np.zeros_like(s.ledger)
    kinds = (r.vehicle % len(cost), r.primitive, np.clip(r.loaded, 0, 1))
    cut = np.nonzero(r.cut)[0]
    short = _part(r, cut, cost, graph, r.t1[cut]) if len(cut) else None
    for c in range(cost.shape[3]):
        table = cost[:, :, :, c]
        if not table.any():
            continue
        each = np.where(r.moves, table[kinds], 0)
        if short is not None:
            each[cut] = short[:, c]
        running = np.concatenate([[0], np.cumsum(each)])
        out[:, c] = np.where(known, running[np.maximum(at, 0)] - running[np.minimum(first, r.n)] + part[:, c], 0)
    return out


def _ledgers(r: Record, s: Samples, cost: I64, scenario: Scenario, graph: MotionGraph) -> Iterator[Breach]:
    """Between two samples each component grows by the sum over the motions; standby by its power."""
    expected = _sums(r, s, cost, graph)
    expected[:, Component.STANDBY] = standby_mj(scenario) * s.tick
    covered = s.tick >= r.first_tick
    grown = np.diff(s.ledger, axis=0, prepend=0)
    due = np.diff(expected, axis=0, prepend=0)
    # the first sample of a vehicle counts from tick 0, when the log still covers that
    begins = ~s.follows
    grown[begins], due[begins] = s.ledger[begins], expected[begins]
    judged = np.where(begins, (s.tick == 0) | (r.first_tick == 0), np.concatenate([[False], covered[:-1]]))
    empty = (s.charge <= 0) | np.concatenate([[False], s.charge[:-1] <= 0])
    wrong = (grown != due) & judged[:, None]
    wrong[:, list(_CHARGING)] = False
    # an empty battery gives no standby
    wrong[:, Component.STANDBY] &= ~(empty & (grown[:, Component.STANDBY] < due[:, Component.STANDBY]))
    for i, c in np.argwhere(wrong)[:REPORTED].tolist():
        v, t = int(s.vehicle[i]), int(s.tick[i])
        text = (
            f"{COMPONENTS[c]} of vehicle {v} grows by {int(grown[i, c])} mJ up to tick {t}; "
            f"its motions add up to {int(due[i, c])} mJ"
        )
        yield Breach(BreachKind.ENERGY, t, (v,), -1, text)


def _charging(r: Record, s: Samples, scenario: Scenario) -> Iterator[Breach]:
    """Charge flows only while charging, not faster than the charger gives, and with its losses."""
    ticks = np.where(r.kind == Activity.CHARGE, r.t1 - r.t0, 0)
    running = np.concatenate([[0], np.cumsum(ticks)])
    at, first = r.before(s.vehicle, s.tick), r.first(s.vehicle)
    row = np.maximum(at, 0)
    if r.n == 0:
        return
    partial = np.where(r.kind[row] == Activity.CHARGE, np.clip(np.minimum(s.tick, r.t1[row]) - r.t0[row], 0, None), 0)
    charging = np.where(at >= 0, running[row] - running[np.minimum(first, r.n)] + partial, 0)
    taken = -np.diff(s.ledger[:, Component.CHARGED], prepend=0)
    lost = np.diff(s.ledger[:, Component.CHARGER_LOSS], prepend=0)
    during = np.diff(charging, prepend=0)
    judged = s.follows & (np.concatenate([[0], s.tick[:-1]]) >= r.first_tick)
    battery = battery_of(scenario)
    if battery is not None:
        yield from islice(_accepted(s, np.where(judged, during, 0), scenario, battery), REPORTED)
    # a rate in percent says what reaches the battery, and nothing of losses
    share = 0.0 if scenario.charger.rate_percent_per_s is not None else 1 - scenario.charger.efficiency
    most = max_charge_mj(scenario)
    wrong = (taken < 0) | (taken > during * most + 1) | (np.abs(lost - share * taken) > during + 1)
    for i in np.nonzero(wrong & judged)[0][:REPORTED].tolist():
        v, t = int(s.vehicle[i]), int(s.tick[i])
        took = f"takes {int(taken[i])} mJ and loses {int(lost[i])} mJ"
        text = f"vehicle {v} {took} up to tick {t} in {int(during[i])} ticks of charging"
        yield Breach(BreachKind.ENERGY, t, (v,), -1, text)


def max_charge_mj(scenario: Scenario) -> int:
    """Most that a charger gives per tick, losses included."""
    charger, tick_s = scenario.charger, scenario.time.tick_s
    power_w = charger.power_w
    if charger.rate_percent_per_s is not None:
        power_w = charger.rate_percent_per_s / 100 * scenario.battery.capacity_wh * 3600
    return math.ceil(power_w * tick_s * 1000)


def _accepted(s: Samples, during: I64, scenario: Scenario, battery: Known) -> Iterator[Breach]:
    """What reaches the battery while charging is no more than it takes at the charges that it had."""
    if battery.accept_w is None:
        return
    grown = np.diff(s.ledger, axis=0, prepend=0)
    taken = -grown[:, Component.CHARGED] - grown[:, Component.CHARGER_LOSS]
    drawn = np.delete(grown, _CHARGING, axis=1).sum(1)
    # it may have driven before it charged: no lower than this
    before = np.concatenate([[0], s.charge[:-1]])
    low = battery.step(np.minimum(before, s.charge) - drawn * 1000 // battery.millivolt.min())
    high = battery.step(np.maximum(before, s.charge))
    for i in np.nonzero(s.follows & (during > 0))[0].tolist():
        most = battery.accept_w[low[i] : high[i] + 1].max() * scenario.time.tick_s * 1000
        if taken[i] - drawn[i] > during[i] * most + 1:
            v, t = int(s.vehicle[i]), int(s.tick[i])
            text = (
                f"the battery of vehicle {v} takes {int(taken[i])} mJ up to tick {t} in {int(during[i])} ticks of "
                f"charging; at its charge it accepts {int(during[i] * most)} mJ beside the {int(drawn[i])} mJ in use"
            )
            yield Breach(BreachKind.BATTERY, t, (v,), -1, text)


def batteries(r: Record, s: Samples, log: RunLog, scenario: Scenario) -> Iterator[Breach]:
    """Charge falls by what the ledger's components sum to at the battery's voltage, between empty and full.

    The only other way to change it is to change the battery, which is an event.
    """
    battery = battery_of(scenario)
    if battery is None:
        return
    for i in np.nonzero((s.charge < 0) | (s.charge > battery.capacity_mc))[0][:REPORTED].tolist():
        v, t = int(s.vehicle[i]), int(s.tick[i])
        text = f"the charge of vehicle {v} at tick {t} is {s.charge[i] / battery.capacity_mc:.2%} of its capacity"
        yield Breach(BreachKind.SOC, t, (v,), -1, text)
    volt = battery.millivolt[battery.step(s.charge)]
    conserved_uj = battery.content_uj(s.charge) + s.ledger.sum(1) * 1000
    jump = np.where(s.follows, np.diff(conserved_uj, prepend=0), 0) / volt
    for vehicle, tick in _battery_changes(log):
        # a command given at a tick acts after that tick's sample
        at = int(np.searchsorted((s.vehicle << 32) + s.tick, (vehicle << 32) + tick, side="right"))
        jump[at : at + 1] = 0
    unlike = np.abs(s.voltage - volt) > (battery.accept_w is not None)  # of a curve the last mV may round otherwise
    wrong = unlike | (np.abs(jump) > _slack_mc(r, s, battery, scenario))
    for i in np.nonzero(wrong)[0][:REPORTED].tolist():
        v, t = int(s.vehicle[i]), int(s.tick[i])
        text = f"the charge of vehicle {v} at tick {t} is {int(jump[i])} mC off what its ledger says"
        if unlike[i]:
            text = f"the voltage of vehicle {v} at tick {t} is {int(s.voltage[i])} mV; {int(volt[i])} are right"
        yield Breach(BreachKind.BATTERY, t, (v,), -1, text)


def _slack_mc(r: Record, s: Samples, battery: Known, scenario: Scenario) -> I64:
    """How far charge and ledger may be apart.

    Less than one mC is carried over, but for mC that are mJ. Where the voltage falls with the charge, a tick has that
    of its beginning: at most the peak of a tick times the change between two samples. Rounding may be off by one mV.
    """
    volt = battery.millivolt[battery.step(s.charge)]
    if battery.accept_w is None:
        return np.where(volt == 1000, 0, 1)
    tick_mj = scenario.time.tick_s * 1000
    peak = (r.energy_mj / np.maximum(r.t1 - r.t0, 1)).max(initial=0) + battery.accept_w.max() * tick_mj
    moved = np.abs(np.diff(s.ledger, axis=0, prepend=0)).sum(1) * 1000 // volt
    before = np.concatenate([s.charge[:1], s.charge[:-1]])
    low, high = np.minimum(before, s.charge) - moved, np.maximum(before, s.charge) + moved
    change = battery.millivolt[battery.step(high)] - battery.millivolt[battery.step(low)]
    return np.asarray(2 + (peak * 1000 / volt * change + moved) // volt, np.int64)


def _battery_changes(log: RunLog) -> list[tuple[int, int]]:
    """Vehicle and tick of every battery change."""
    e = log.table("events")
    rows = np.nonzero(e["kind"] == "battery changed")[0]
    return list(zip(e["vehicle"][rows].tolist(), e["tick"][rows].tolist(), strict=True))
