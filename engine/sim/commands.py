"""What an operator may say while a run goes on. Checked, logged with its tick, then done; refused with a reason."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.errors import BadInput, unknown_name
from engine.sim import deciding, operating, planning, recovery
from engine.types import NONE, OrderState

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation


FRESH = 0.1
"""State of charge of the battery that an empty vehicle gets when it is repaired."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Accepted or not, and why; `tick` at which it takes effect, `number` of the command in this run."""

    accepted: bool
    reason: str
    tick: int
    number: int


class Refused(Exception):
    """The command makes sense but can't be done now; the message says why."""


def submit(sim: Simulation, command: Mapping[str, Any]) -> Answer:
    """Check, log and carry out one command. Never raises for what a person said."""
    number = sim.commands
    sim.commands += 1
    try:
        handler, values = values_of(command, COMMANDS)
        reason, accepted = handler(sim, **{k.replace("from", "source"): v for k, v in values.items()}), True
    except (BadInput, Refused) as why:
        reason, accepted = str(why), False
    text = json.dumps(command, sort_keys=True, default=str)
    sim.ledger.row("commands", sim.tick, number, text, int(accepted), reason)
    if accepted:
        sim.settle()
    return Answer(accepted, reason, sim.tick, number)


def values_of(
    command: Mapping[str, Any], known: Mapping[str, tuple[Callable[..., str], dict[str, Any]]]
) -> tuple[Callable[..., str], dict[str, Any]]:
    """Who does a command, and its fields as numbers. Raises BadInput with the nearest name."""
    what = command.get("do")
    if not isinstance(what, str) or what not in known:
        raise BadInput(unknown_name("command", str(what), known))
    handler, needs = known[what]
    for key in command:
        if key != "do" and key not in needs:
            raise BadInput(unknown_name(f"field of command {what!r}", str(key), needs))
    return handler, {k: _number(command, k, kind) for k, kind in needs.items() if k in command or kind is not None}


def _number(command: Mapping[str, Any], key: str, kind: type | None) -> Any:
    if key not in command:
        raise BadInput(f"command {command['do']!r} needs {key!r}")
    value = command[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise BadInput(f"{key!r} must be a number; got {value!r}")
    if kind is int and value != int(value):
        raise BadInput(f"{key!r} must be a whole number; got {value!r}")
    return int(value) if kind is int else float(value)


def _vehicle(sim: Simulation, v: int) -> int:
    if not 0 <= v < sim.n:
        raise BadInput(f"there is no vehicle {v}; the fleet is numbered 0 to {sim.n - 1}")
    return v


def _place(sim: Simulation, place: int) -> str:
    if not 0 <= place < sim.graph.n_places:
        raise BadInput(f"there is no place {place}; the floor's are numbered 0 to {sim.graph.n_places - 1}")
    return sim.world.label(place)


def _order(sim: Simulation, source: int, to: int) -> str:
    for number in (source, to):
        sim.world.station(number)
    order = deciding.add_order(sim, source, to, source=1)
    return f"order {order} from {sim.world.station(source).name} to {sim.world.station(to).name}"


def _withdraw(sim: Simulation, order: int) -> str:
    book = sim.book
    if not 0 <= order < len(book):
        raise BadInput(f"there is no order {order}; {len(book)} were given so far")
    state = OrderState(book.state[order])
    if state is OrderState.PICKED:
        raise Refused(f"vehicle {book.vehicle[order]} has already picked order {order} up")
    if state in (OrderState.DONE, OrderState.WITHDRAWN):
        raise Refused(f"order {order} is already {state.name.lower()}")
    vehicle = book.vehicle[order]
    if state is OrderState.OPEN:
        book.open.remove(order)
    else:
        if planning.service(sim, vehicle) is not None:
            raise Refused(f"vehicle {vehicle} is just picking order {order} up")
        operating.release_order(sim, vehicle)
    book.state[order] = int(OrderState.WITHDRAWN)
    sim.reasons.pop(order, None)
    deciding.order_row(sim, order)
    return f"order {order} is withdrawn"


def _charge(sim: Simulation, vehicle: int) -> str:
    v = _vehicle(sim, vehicle)
    if len(sim.goals):
        raise Refused(f"vehicle {v} drives to its goal and charges nowhere on the way")
    if sim.fleet.failed[v]:
        raise Refused(f"vehicle {v} is broken down")
    if sim.fleet.charge[v] >= sim.levels.full[v]:
        raise Refused(f"vehicle {v} is already charged")
    if sim.fleet.order[v] != NONE:
        sim.charge_later[v] = 1
        return f"vehicle {v} goes charging after order {int(sim.fleet.order[v])}"
    sim.must_charge[v] = 1
    return f"vehicle {v} goes charging"


def _send(sim: Simulation, vehicle: int, place: int) -> str:
    v, cell = _vehicle(sim, vehicle), _place(sim, place)
    if sim.fleet.failed[v] or sim.fleet.paused[v]:
        raise Refused(f"vehicle {v} is {'broken down' if sim.fleet.failed[v] else 'paused'}")
    if sim.fleet.order[v] != NONE:
        raise Refused(f"vehicle {v} is busy with order {int(sim.fleet.order[v])}; withdraw it first")
    if sim.blocked[place]:
        raise Refused(f"{cell} is blocked")
    holder = int(sim.holder[place])
    if holder not in (NONE, v):
        raise Refused(f"{cell} is taken by vehicle {holder}")
    if sim.world.endpoint[place] and not operating.is_rest(sim, place):
        raise Refused(f"{cell} is a station; nothing may park there")
    if not operating.send_to(sim, v, place):
        raise Refused(f"vehicle {v} found no way to {cell} that ends without blocking others")
    return f"vehicle {v} goes to {cell}"


def _pause(sim: Simulation, vehicle: int) -> str:
    v = _vehicle(sim, vehicle)
    if sim.fleet.paused[v]:
        raise Refused(f"vehicle {v} is already paused")
    sim.fleet.paused[v] = 1
    return f"vehicle {v} pauses as soon as it has reached its next place"


def _continue(sim: Simulation, vehicle: int) -> str:
    v = _vehicle(sim, vehicle)
    if not sim.fleet.paused[v]:
        raise Refused(f"vehicle {v} is not paused")
    sim.fleet.paused[v] = 0
    return f"vehicle {v} goes on"


def _fail(sim: Simulation, vehicle: int) -> str:
    v = _vehicle(sim, vehicle)
    if sim.fleet.failed[v]:
        raise Refused(f"vehicle {v} is already broken down")
    sim.say("breakdown", f"vehicle {v} was taken out by the operator", 2, v)
    recovery.fail(sim, v)
    return f"vehicle {v} stops at its next place and stays there until it is repaired"


def _repair(sim: Simulation, vehicle: int) -> str:
    v = _vehicle(sim, vehicle)
    if not sim.fleet.failed[v]:
        raise Refused(f"vehicle {v} is not broken down")
    if sim.fleet.charge[v] <= 0:
        operating.change_battery(sim, v, FRESH)
    recovery.repair(sim, v)
    return f"vehicle {v} works again"


def _block(sim: Simulation, place: int) -> str:
    cell = _place(sim, place)
    if sim.blocked[place]:
        raise Refused(f"{cell} is already blocked")
    operating.set_block(sim, place, True)
    return f"{cell} is blocked"


def _unblock(sim: Simulation, place: int) -> str:
    cell = _place(sim, place)
    if not sim.blocked[place]:
        raise Refused(f"{cell} is not blocked")
    operating.set_block(sim, place, False)
    return f"{cell} is free again"


def _charger_out(sim: Simulation, charger: int) -> str:
    _charger(sim, charger)
    if sim.charger_out[charger]:
        raise Refused(f"charger C{charger + 1} is already out of order")
    operating.set_charger(sim, charger, works=False)
    return f"charger C{charger + 1} is out of order"


def _charger_back(sim: Simulation, charger: int) -> str:
    _charger(sim, charger)
    if not sim.charger_out[charger]:
        raise Refused(f"charger C{charger + 1} is in order")
    operating.set_charger(sim, charger, works=True)
    return f"charger C{charger + 1} works again"


def _charger(sim: Simulation, charger: int) -> None:
    if not 0 <= charger < len(sim.charger_out):
        raise BadInput(f"there is no charger {charger}; they are numbered 0 to {len(sim.charger_out) - 1}")


def _rate(sim: Simulation, per_h: float) -> str:
    if per_h < 0 or per_h > 1e6:
        raise BadInput(f"'per_h' must lie between 0 and 1000000; got {per_h:g}")
    if why := sim.source.set_rate(per_h, sim.tick):
        raise Refused(why)
    return f"{per_h:g} orders per hour from now on"


def _thresholds(sim: Simulation, **given: float) -> str:
    new = {**sim.thresholds, **given}
    for name, value in new.items():
        if not 0 <= value <= 1:
            raise BadInput(f"{name!r} must lie between 0 and 1; got {value:g}")
    if not new["critical"] <= new["good"] <= new["sufficient"] <= new["full"]:
        raise BadInput("thresholds must rise: critical ≤ good ≤ sufficient ≤ full")
    operating.set_thresholds(sim, new)
    return "thresholds: " + ", ".join(f"{k} {100 * v:.0f} %" for k, v in new.items())


_LEVEL: dict[str, Any] = dict.fromkeys(("critical", "good", "sufficient", "full", "reserve"))
COMMANDS: dict[str, tuple[Callable[..., str], dict[str, Any]]] = {
    "order": (_order, {"from": int, "to": int}),
    "withdraw": (_withdraw, {"order": int}),
    "charge": (_charge, {"vehicle": int}),
    "send": (_send, {"vehicle": int, "place": int}),
    "pause": (_pause, {"vehicle": int}),
    "continue": (_continue, {"vehicle": int}),
    "fail": (_fail, {"vehicle": int}),
    "repair": (_repair, {"vehicle": int}),
    "block": (_block, {"place": int}),
    "unblock": (_unblock, {"place": int}),
    "charger out": (_charger_out, {"charger": int}),
    "charger back": (_charger_back, {"charger": int}),
    "rate": (_rate, {"per_h": float}),
    "thresholds": (_thresholds, _LEVEL),
}
"""What may be said: who does it, and its fields (None: an optional number)."""
