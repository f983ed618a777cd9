"""Does every vehicle go on where it was, and does every motion exist? Continuity, edges, durations, blocked places."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from engine.sim.judge.breach import REPORTED, Breach, BreachKind
from engine.sim.judge.record import I64, Mask, Record, RunLog, last_before
from engine.world.floor import World
from engine.world.motion_graph import MotionGraph


def continuity(r: Record, world: World) -> Iterator[Breach]:
    """Intervals follow each other without gap or overlap, in time, place and heading; who stands does not move."""
    kind: BreachKind = BreachKind.CONTINUITY
    for i in _some(~r.legal):
        v, t = int(r.vehicle[i]), int(r.t0[i])
        inside = all(0 <= p < world.graph.n_places for p in (r.a[i], r.b[i]))
        broken = BreachKind.PRIMITIVE if inside else BreachKind.OBSTACLE
        text = "a motion that does not exist" if inside else f"place {int(r.b[i])}, where no vehicle may be"
        yield Breach(broken, t, (v,), int(r.b[i]), f"vehicle {v} is logged with {text}, at tick {t}")
    previous = np.arange(r.n) - 1
    for i in _some(r.follows & (r.t0 != r.t1[previous])):
        v = int(r.vehicle[i])
        what = "nothing" if r.t0[i] > r.t1[i - 1] else "two things at once"
        text = f"vehicle {v} does {what} between ticks {int(r.t1[i - 1])} and {int(r.t0[i])}"
        yield Breach(kind, int(min(r.t0[i], r.t1[i - 1])), (v,), int(r.a[i]), text)
    begins = ~r.follows & (r.t0 > r.first_tick)
    for i in _some(begins):
        v = int(r.vehicle[i])
        text = f"vehicle {v} does nothing before tick {int(r.t0[i])}"
        yield Breach(kind, r.first_tick, (v,), int(r.a[i]), text)
    for i in _some(r.t1 < r.t0 + ~r.still):
        v = int(r.vehicle[i])
        text = f"an interval of vehicle {v} ends at tick {int(r.t1[i])}, not after it begins"
        yield Breach(kind, int(r.t0[i]), (v,), int(r.a[i]), text)
    chained = r.follows & r.legal & r.legal[previous]
    for i in _some(chained & (r.a != r.b[previous])):
        v, t = int(r.vehicle[i]), int(r.t0[i])
        text = f"vehicle {v} was at {name(world, r.b[i - 1])} and is at {name(world, r.a[i])} at the same tick {t}"
        yield Breach(kind, t, (v,), int(r.a[i]), text)
    turned = chained & (r.a == r.b[previous]) & (r.heading_a != r.heading_b[previous])
    for i in _some(turned):
        v, t = int(r.vehicle[i]), int(r.t0[i])
        yield Breach(kind, t, (v,), int(r.a[i]), f"vehicle {v} changes its heading in no time at tick {t}")
    stands = r.legal & ~r.moves & ((r.a != r.b) | (r.heading_a != r.heading_b))
    for i in _some(stands):
        v, t = int(r.vehicle[i]), int(r.t0[i])
        yield Breach(kind, t, (v,), int(r.a[i]), f"vehicle {v} stands from tick {t} and yet ends elsewhere")


def edges_of(r: Record, graph: MotionGraph) -> I64:
    """Edge of the graph that each motion drives, or -1. A vehicle rolls when it came rolling into this very tick."""
    n_headings, n_kinds = len(graph.heading_deg), len(graph.primitives)
    pivot = np.array([p.pivot for p in graph.primitives], np.bool_)
    rolls = np.zeros(r.n, np.bool_)
    rolls[1:] = r.follows[1:] & r.moves[:-1] & ~pivot[r.primitive[:-1]] & ~r.cut[:-1] & (r.t1[:-1] == r.t0[1:])
    slots = graph.n_places * n_headings
    state_at = np.full(slots * 2, -1, np.int64)
    own = graph.state_place.astype(np.int64) * n_headings + graph.state_heading
    state_at[own * 2 + graph.state_moving] = np.arange(graph.n_states)
    key = (graph.edge_from.astype(np.int64) * n_kinds + graph.edge_kind) * slots + own[graph.edge_to]
    order = np.argsort(key)
    key = key[order]
    found = np.full(r.n, -1, np.int64)
    rows = np.nonzero(r.moves & r.legal)[0]
    if len(key) == 0:
        return found
    state = state_at[(r.a[rows] * n_headings + r.heading_a[rows]) * 2 + rolls[rows]]
    want = (state * n_kinds + r.primitive[rows]) * slots + r.b[rows] * n_headings + r.heading_b[rows]
    at = np.minimum(np.searchsorted(key, want), len(key) - 1)
    found[rows] = np.where((key[at] == want) & (state >= 0), order[at], -1)
    return found


def existence(r: Record, edge: I64, world: World) -> Iterator[Breach]:
    """Every motion is an edge of the graph, driven by the primitive for its state, for as long as that takes."""
    graph = world.graph
    stayed = r.cut & (r.a == r.b) & (r.heading_a == r.heading_b)
    place_from = graph.state_place[graph.edge_from].astype(np.int64)
    place_to = graph.state_place[graph.edge_to].astype(np.int64)
    ways = np.unique(place_from * graph.n_places + place_to)
    for i in _some(r.moves & r.legal & (edge < 0) & ~stayed):
        v, t, a, b = int(r.vehicle[i]), int(r.t0[i]), int(r.a[i]), int(r.b[i])
        where = f"from {name(world, a)} to {name(world, b)} at tick {t}"
        if _has(ways, a * graph.n_places + b):
            word = graph.primitives[int(r.primitive[i])].name
            yield Breach(
                BreachKind.PRIMITIVE,
                t,
                (v,),
                b,
                f"vehicle {v} drives {where} by {word!r}, which its state does not allow",
            )
        elif _has(ways, b * graph.n_places + a):
            yield Breach(BreachKind.ONE_WAY, t, (v,), b, f"vehicle {v} drives {where} against the one-way rule")
        else:
            yield Breach(BreachKind.EDGE, t, (v,), b, f"vehicle {v} drives {where}, where no way leads")
    ticks = np.asarray(graph.kind_ticks, np.int64)[r.primitive]
    took = r.t1 - r.t0
    wrong = np.where(r.still, took > ticks, took != ticks)
    for i in _some(r.moves & ~r.cut & wrong & (took > 0)):
        v, t = int(r.vehicle[i]), int(r.t0[i])
        word = graph.primitives[int(r.primitive[i])].name
        text = f"vehicle {v} takes {int(took[i])} ticks for {word!r} at tick {t}; {int(ticks[i])} are right"
        yield Breach(BreachKind.DURATION, t, (v,), int(r.b[i]), text)


def blocked(r: Record, edge: I64, log: RunLog, world: World) -> Iterator[Breach]:
    """No motion starts into a place, or over a corner, while it is blocked."""
    rows = log.table("blocks")
    place, tick = np.asarray(rows["place"], np.int64), np.asarray(rows["tick"], np.int64)
    if len(place) == 0:
        return
    order = np.lexsort((np.arange(len(place)), tick, place))
    key, flag = (place[order] << 32) + tick[order], np.asarray(rows["blocked"])[order]
    row = np.nonzero(r.moves & (r.a != r.b))[0]
    where = r.b[row]
    over, corner = corners_of(edge, world.graph)
    row, where = np.concatenate([row, over]), np.concatenate([where, corner])
    closed = last_before(key, flag, where, r.t0[row], 0) == 1
    for i, place in sorted(zip(row[closed].tolist(), where[closed].tolist(), strict=True))[:REPORTED]:
        v, t, word = int(r.vehicle[i]), int(r.t0[i]), "into" if place == r.b[i] else "over"
        text = f"vehicle {v} drives {word} {name(world, place)} at tick {t}, which is blocked"
        yield Breach(BreachKind.BLOCKED, t, (v,), place, text)


def corners_of(edge: I64, graph: MotionGraph) -> tuple[I64, I64]:
    """(rows, places): the corners that the motions of a record pass over, a row for each."""
    rows = np.nonzero(edge >= 0)[0]
    count = np.diff(graph.sweep_ptr).astype(np.int64)[edge[rows]]
    rows, count = rows[count > 0], count[count > 0]
    owner = np.repeat(rows, count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    return owner, graph.sweep[graph.sweep_ptr[edge[owner]] + step].astype(np.int64)


def name(world: World, place: int) -> str:
    """What a person calls a place, also one that does not exist."""
    return world.place_name(int(place)) if 0 <= place < world.graph.n_places else f"place {int(place)}"


def _has(sorted_values: I64, value: int) -> bool:
    at = int(np.searchsorted(sorted_values, value))
    return at < len(sorted_values) and int(sorted_values[at]) == value


def _some(mask: Mask) -> list[int]:
    return [int(i) for i in np.nonzero(mask)[0][:REPORTED]]
