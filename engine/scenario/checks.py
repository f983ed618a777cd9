"""Does the floor work, and does the scenario fit it? Every finding names the place, its cell and its station.

Well-formed (Čáp et al. 2015): between any two endpoints there is a path that avoids all other endpoints, so vehicles
that rest on endpoints never cut each other off.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from engine.energy.demand import DemandModel, parameters_over
from engine.errors import ScenarioError
from engine.scenario.instances import goal_places
from engine.scenario.model import Scenario
from engine.scenario.start import start_places
from engine.types import NONE, StationKind
from engine.units import J_PER_WH
from engine.world.floor import GridWorld, Station, World
from engine.world.relief import tilt
from engine.world.terrain import TerrainWorld, disc

if TYPE_CHECKING:
    import networkx as nx

NAMED = 5
"""So many places are named per check; the rest is counted."""

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Finding:
    """One answer of one check; `place` is where it is about, when it is about one."""

    level: Literal["error", "warning", "ok"]
    check: str
    text: str
    place: int | None = None


@dataclass(frozen=True, slots=True)
class Leg:
    """One way between two endpoints: time-optimal, fewest turns among those."""

    start: int
    end: int
    edges: tuple[int, ...]
    loaded: bool


def check(scenario: Scenario, world: World, demand: DemandModel | None = None) -> list[Finding]:
    """Everything worth knowing before a run, in a fixed order; at least one finding per check.

    demand: the model that turns motion into energy; without it, the scenario's own when it is `xu2025` or `constant`.
    """
    if isinstance(world, TerrainWorld):
        return list(_ground(scenario, world))
    if scenario.orders.source == "goals":
        return [*_goals(scenario, world), *_speed(scenario), *_battery_to_goals(scenario, world, demand)]
    graph = place_graph(world)
    main = _main_component(graph, world)
    findings = [*_reachable(world, graph, main), *_well_formed(world)]
    findings += [*_rest_places(scenario, world), *_starts(scenario, world, main)]
    if isinstance(world, GridWorld):
        findings += _speed(scenario)
    if any(f.level == "error" and f.check in ("reachable", "one-way") for f in findings):
        text = "not checked: stations or chargers can't be reached"
        return [*findings, Finding("warning", "battery", text)]
    return [*findings, *_battery(scenario, world, demand)]


def require(scenario: Scenario, world: World, demand: DemandModel | None = None) -> list[Finding]:
    """The findings of `check`; raises ScenarioError with one line per error when there is any."""
    findings = check(scenario, world, demand)
    errors = [f for f in findings if f.level == "error"]
    if errors:
        raise ScenarioError("\n".join(f"{scenario.name}: {f.check}: {f.text}" for f in errors))
    return findings


def place_graph(world: World) -> nx.DiGraph[int]:
    """Directed graph of places: an arc where some motion leads from one place to another."""
    import networkx as nx

    graph: nx.DiGraph[int] = nx.DiGraph()
    graph.add_nodes_from(range(world.n_places))
    graph.add_edges_from(_arcs(world).tolist())
    return graph


def is_well_formed(world: World) -> bool:
    """True when between any two endpoints there is a path that avoids all other endpoints. Exact."""
    return not ill_formed_pairs(world, 1)


def ill_formed_pairs(world: World, limit: int | None = None) -> list[tuple[int, int]]:
    """Ordered pairs of endpoint places (a, b) without a path from a to b that avoids all other endpoints.

    Fast when the aisles are strongly connected and every endpoint is attached to them both ways; else pair by pair.
    """
    import networkx as nx

    graph = place_graph(world)
    closed = _closed(world)
    ends = np.flatnonzero(closed).tolist()
    aisles = graph.subgraph(np.flatnonzero(~closed).tolist())
    attached = all(any(n in aisles for n in graph.succ[e]) and any(n in aisles for n in graph.pred[e]) for e in ends)
    if attached and len(aisles) and nx.is_strongly_connected(aisles):
        return []
    pairs: list[tuple[int, int]] = []
    for a in ends:
        reached: set[int] = set()
        for first in graph.succ[a]:
            if first in aisles and first not in reached:
                reached |= {first, *nx.descendants(aisles, first)}
        for b in ends:
            if a != b and not graph.has_edge(a, b) and not any(n in reached for n in graph.pred[b]):
                pairs.append((a, b))
                if len(pairs) == limit:
                    return pairs
    return pairs


def _closed(world: World) -> NDArray[np.bool_]:
    """(P,) places through which no path may need to lead: endpoints of a drawing; kerbs of a network, whose stations
    are through nodes where nobody stays for good."""
    if isinstance(world, GridWorld):
        return world.endpoint
    closed = np.zeros(world.n_places, np.bool_)
    closed[world.parking] = closed[world.chargers] = True
    return closed


def _arcs(world: World) -> NDArray[np.int64]:
    """(A, 2) distinct pairs of different places joined by a motion, sorted."""
    graph = world.graph
    arcs = np.stack([graph.state_place[graph.edge_from], graph.state_place[graph.edge_to]], 1).astype(np.int64)
    return np.unique(arcs[arcs[:, 0] != arcs[:, 1]], axis=0)


def _main_component(graph: nx.DiGraph[int], world: World) -> set[int]:
    """The strongly connected component with most endpoints, then most places, then the lowest place."""
    import networkx as nx

    endpoint = world.endpoint
    return max(nx.strongly_connected_components(graph), key=lambda c: (int(endpoint[list(c)].sum()), len(c), -min(c)))


def _reachable(world: World, graph: nx.DiGraph[int], main: set[int]) -> Iterator[Finding]:
    import networkx as nx

    core = min(main)
    after, before = nx.descendants(graph, core) | {core}, nx.ancestors(graph, core) | {core}
    problems: list[Finding] = []
    traps: list[int] = []
    unreachable: list[int] = []
    for place in range(world.n_places):
        if place in main:
            continue
        name = world.place_name(place)
        if not world.endpoint[place]:
            (traps if place in after else unreachable).append(place)
        elif world.access[place] == NONE:
            problems.append(Finding("error", "reachable", f"{name} has no aisle cell beside it", place))
        elif place in after:
            problems.append(Finding("error", "one-way", f"{name} can be entered, but has no way back", place))
        elif place in before:
            problems.append(Finding("error", "one-way", f"{name} can be left, but has no way to it", place))
        else:
            problems.append(Finding("error", "reachable", f"{name} is cut off from the rest of the floor", place))
    yield from problems[:NAMED]
    if len(problems) > NAMED:
        yield Finding("error", problems[NAMED].check, f"and {len(problems) - NAMED} more endpoints")
    if traps:
        text = f"{_listed(world, traps)} can be entered, but the one-way rules leave no way back"
        yield Finding("error", "one-way", text, traps[0])
    if unreachable:
        text = f"{_listed(world, unreachable)} can't be reached from the rest of the floor"
        yield Finding("warning", "one-way", text, unreachable[0])
    if not problems:
        count = int(world.endpoint.sum())
        yield Finding("ok", "reachable", f"each of {count} stations, chargers and parking bays can be reached and left")
    if not (problems or traps or unreachable):
        yield Finding("ok", "one-way", f"each of {world.n_places} places can be reached from every other")


def _listed(world: World, places: list[int]) -> str:
    names = ", ".join(world.place_name(p) for p in places[:NAMED])
    return names if len(places) <= NAMED else f"{names} and {len(places) - NAMED} more"


def _well_formed(world: World) -> Iterator[Finding]:
    pairs = ill_formed_pairs(world, 2)
    for a, b in pairs:
        text = f"every path from {world.place_name(a)} to {world.place_name(b)} leads through other endpoints"
        yield Finding("error", "well-formed", text, a)
    if not pairs:
        yield Finding("ok", "well-formed", "between any two endpoints there is a path that avoids all others")


def _rest_places(scenario: Scenario, world: World) -> Iterator[Finding]:
    chargers, parking, fleet = len(world.chargers), len(world.parking), scenario.fleet.count
    have = f"{chargers} chargers and {parking} parking bays"
    if chargers + parking < fleet:
        yield Finding("error", "rest places", f"{have} for {fleet} vehicles; each vehicle needs a place to rest")
    elif 0 < chargers < fleet == chargers + parking:
        text = f"{have} for {fleet} vehicles: with no bay to spare, nobody can make room at a charger"
        yield Finding("warning", "rest places", text)
    else:
        yield Finding("ok", "rest places", f"{have} for {fleet} vehicles")
    if not chargers and scenario.battery.exchange == "off":
        yield Finding("warning", "rest places", "the floor has no charger: an empty battery stays empty")


def _starts(scenario: Scenario, world: World, main: set[int]) -> Iterator[Finding]:
    start = scenario.fleet.start
    if isinstance(start, str) or not isinstance(world, GridWorld):
        return
    for vehicle, (x, y) in enumerate(start):
        place = world.place_at(x, y)
        if place not in main:
            text = f"vehicle {vehicle} starts at {world.place_name(place)}, from where not every station can be reached"
            yield Finding("error", "start", text, place)


def _speed(scenario: Scenario) -> Iterator[Finding]:
    driven = scenario.floor.cell_m / (scenario.motion.straight_ticks * scenario.time.tick_s)
    said = scenario.motion.speed_mps
    if abs(driven - said) > 0.01 * said:
        text = (
            f"a step of {scenario.floor.cell_m:g} m in {scenario.motion.straight_ticks} ticks is {driven:g} m/s, "
            f"but motion.speed_mps is {said:g}"
        )
        yield Finding("warning", "speed", text)


# ---------------------------------------------------------------- instances


def _goals(scenario: Scenario, world: World) -> Iterator[Finding]:
    """Every vehicle must be able to reach its goal, were it alone."""
    from scipy.sparse import csgraph

    ticks = _tick_matrix(world)
    starts, goals = start_places(scenario, world), goal_places(scenario, world)
    _, part = csgraph.connected_components(ticks, connection="strong")
    problems = []
    for vehicle, (a, b) in enumerate(zip(starts, goals, strict=True)):
        if part[a] != part[b] and not np.isfinite(_distances(ticks, [a])[0, b]):
            text = (
                f"vehicle {vehicle} starts at {world.place_name(a)}, from where no way leads to {world.place_name(b)}"
            )
            problems.append(Finding("error", "goals", text, b))
    yield from problems[:NAMED]
    if len(problems) > NAMED:
        yield Finding("error", "goals", f"and {len(problems) - NAMED} more vehicles without a way to their goals")
    if not problems:
        yield Finding("ok", "goals", f"each of {len(goals)} vehicles has a way to its goal")


def _ground(scenario: Scenario, world: TerrainWorld) -> Iterator[Finding]:
    """The robot can stand at its start and its goal, and ground that it may drive on joins them."""
    from scipy.ndimage import binary_dilation, label

    terrain = world.terrain
    near = disc(world.body_m / world.grain_m)
    body = np.zeros((2 * near.max() + 1,) * 2, np.bool_)
    body[near[:, 1] + near.max(), near[:, 0] + near.max()] = True
    steep = tilt(terrain.height_m, terrain.cell_m) > np.tan(np.radians(terrain.slope_limit_deg))
    parts, _ = label(~(binary_dilation(terrain.obstacle, body) | steep), np.ones((3, 3)))
    (start,), (goal,) = start_places(scenario, world), goal_places(scenario, world)
    for word, place in (("start", start), ("goal", goal)):
        if not parts.flat[place]:
            text = f"the robot can't stand at its {word} {world.place_name(place)}: an obstacle is near, or it is steep"
            yield Finding("error", "goals", text, place)
    if parts.flat[start] and parts.flat[goal]:
        if parts.flat[start] != parts.flat[goal]:
            text = f"obstacles and slopes cut the goal {world.place_name(goal)} off from the start"
            yield Finding("error", "goals", text, goal)
        else:
            yield Finding("ok", "goals", "ground that the robot may drive on joins its start and its goal")
    share = float((parts > 0).mean())
    yield Finding(
        "ok", "ground", f"{share:.0%} of the ground can be driven on; {world.known.mean():.0%} is known before"
    )


def _battery_to_goals(scenario: Scenario, world: World, demand: DemandModel | None) -> Iterator[Finding]:
    """The vehicles farthest from their goals, alone on the floor, against a full battery minus the reserve."""
    model = demand or _own_demand(scenario)
    if model is None:
        text = f"not checked: energy of demand model {scenario.energy.demand!r} was not given"
        yield Finding("warning", "battery", text)
        return
    starts, goals = start_places(scenario, world), goal_places(scenario, world)
    assert isinstance(world, GridWorld)  # goals are cells
    cells = world.cell_of_place
    away = np.abs(cells[list(goals)] - cells[list(starts)]).sum(1)
    ticks = _tick_matrix(world)
    worst = (-1.0, 0)
    for vehicle in np.argsort(-away, kind="stable")[:NAMED].tolist():
        if np.isfinite(_distances(ticks, [starts[vehicle]])[0, goals[vehicle]]):
            leg = _leg(world, starts[vehicle], goals[vehicle], False)
            worst = max(worst, (leg_energy_j(scenario, world, model, leg, vehicle), -vehicle))
    if worst[0] < 0:
        yield Finding("warning", "battery", "not checked: goals can't be reached")
        return
    vehicle, needed = -worst[1], worst[0] / (scenario.battery.capacity_wh * J_PER_WH)
    soc = scenario.battery.initial_soc
    usable = soc if isinstance(soc, float) else soc[0]
    text = (
        f"the way of vehicle {vehicle} from {world.place_name(starts[vehicle])} to {world.place_name(goals[vehicle])} "
        f"takes {needed:.1%} of a battery; {usable:.1%} is there at the start"
    )
    level: Literal["error", "warning", "ok"] = "error" if needed > usable else "ok"
    if usable >= needed > 0.9 * usable:
        level, text = "warning", f"{text}: waiting on the way may use up the rest"
    yield Finding(level, "battery", text, starts[vehicle])


# ---------------------------------------------------------------- battery


def _battery(scenario: Scenario, world: World, demand: DemandModel | None) -> Iterator[Finding]:
    """The longest order, from the farthest charger and on to the nearest one, against full minus reserve.

    An order that the battery serves from its nearest charger alone is a warning, not an error.
    """
    model = demand or _own_demand(scenario)
    if model is None:
        text = f"not checked: energy of demand model {scenario.energy.demand!r} was not given"
        yield Finding("warning", "battery", text)
        return
    legs = longest_order(scenario, world)
    if legs is None:
        yield Finding("warning", "battery", "not checked: no order is possible on this floor")
        return
    usable = scenario.charging.full - scenario.charging.reserve
    there = f"{usable:.1%} is there between charging.full and charging.reserve"
    needed, route = order_share(scenario, world, model, legs), _route(world, legs)
    text = f"the longest order, {route}, takes {needed:.1%} of a battery; {there}"
    if needed <= 0.9 * usable:
        yield Finding("ok", "battery", text)
        return
    if needed <= usable:
        yield Finding("warning", "battery", f"{text}: waiting on the way may use up the rest", legs[-1].start)
        return
    near = longest_order(scenario, world, from_nearest=True) or legs
    least = order_share(scenario, world, model, near)
    if least <= usable:
        advice = f"a vehicle that charged at {world.place_name(legs[0].start)} can't take it"
        text = f"{text}: {advice}; from the nearest charger, {_route(world, near)}, an order takes {least:.1%} at most"
        yield Finding("warning", "battery", text, legs[-1].start)
        return
    text = f"the longest order, {_route(world, near)}, takes {least:.1%} of a battery; {there}: it can never be served"
    yield Finding("error", "battery", text, near[-1].start)


def order_share(scenario: Scenario, world: World, model: DemandModel, legs: list[Leg]) -> float:
    """Part of a battery that an order's legs and its service take."""
    energy_j = sum(leg_energy_j(scenario, world, model, leg) for leg in legs)
    energy_j += model.standby_w * (scenario.service.pick_s + scenario.service.drop_s)
    return energy_j / (scenario.battery.capacity_wh * J_PER_WH)


def _route(world: World, legs: list[Leg]) -> str:
    """Places of an order's legs: `C1 at (0, 0) → I1 at (2, 1) → …`."""
    return " → ".join(world.place_name(p) for p in dict.fromkeys([legs[0].start, *(leg.end for leg in legs)]))


def longest_order(scenario: Scenario, world: World, *, from_nearest: bool = False) -> list[Leg] | None:
    """Legs of the longest order: from the charger farthest from it, with the load, on to the nearest charger.

    from_nearest: begin at the nearest charger instead · without chargers, from a parking bay, and no last leg.
    None when no order has two reachable ends.
    """
    pairs = order_pairs(scenario, world)
    rest = world.chargers if len(world.chargers) else world.parking
    origins = sorted({a for a, _ in pairs})
    if not origins or not len(rest):
        return None
    ticks = _tick_matrix(world)
    from_rest = _distances(ticks, rest.tolist())
    to_rest = _distances(ticks.T.tocsr(), rest.tolist())
    from_origin = dict(zip(origins, _distances(ticks, origins), strict=True))
    has_charger = bool(len(world.chargers))
    first = from_rest.argmin(axis=0) if from_nearest else from_rest.argmax(axis=0)
    best: tuple[float, int, int] | None = None
    for a, b in pairs:
        total = float(from_rest[first[a], a] + from_origin[a][b] + (to_rest[:, b].min() if has_charger else 0.0))
        if np.isfinite(total) and (best is None or total > best[0]):
            best = (total, a, b)
    if best is None:
        return None
    _, a, b = best
    legs = [_leg(world, int(rest[first[a]]), a, False), _leg(world, a, b, True)]
    if has_charger:
        legs.append(_leg(world, b, int(rest[to_rest[:, b].argmin()]), False))
    return legs


def order_pairs(scenario: Scenario, world: World) -> list[tuple[int, int]]:
    """Distinct (from, to) places of every order that the scenario can ask for; sorted."""
    if scenario.orders.source == "listed":
        pairs = {(world.station(a).place, world.station(b).place) for a, b in scenario.orders.pairs}
    else:

        def stations(kind: str) -> tuple[Station, ...]:
            return world.stations_of(StationKind(kind))

        pairs = {(a.place, b.place) for m in scenario.orders.mix for a in stations(m.from_) for b in stations(m.to)}
    return sorted(pairs)


def leg_energy_j(scenario: Scenario, world: World, demand: DemandModel, leg: Leg, vehicle: int | None = None) -> float:
    """Energy of a leg in joules, standby included; of the heaviest vehicle unless one is named."""
    graph, tick_s = world.graph, scenario.time.tick_s
    masses = scenario.fleet.each_mass_kg
    mass_kg = (max(masses) if vehicle is None else masses[vehicle]) + (scenario.fleet.payload_kg if leg.loaded else 0.0)
    counts = np.bincount(graph.edge_kind[list(leg.edges)], minlength=len(graph.primitives)) if leg.edges else ()
    total = 0.0
    for primitive, count in zip(graph.primitives, counts, strict=False):
        duration_s = primitive.ticks * tick_s
        each = sum(demand.joules(primitive, mass_kg, duration_s).values()) + demand.standby_w * duration_s
        total += int(count) * each
    return total


def _own_demand(scenario: Scenario) -> DemandModel | None:
    from engine.energy import constant, lian2024, parameter_sets, xu2025

    given = scenario.energy.parameters
    if scenario.energy.demand == "constant":
        values = parameters_over(parameter_sets.constant(), given, "constant")
        return constant.Constant(values["percent_per_s"] / 100 * scenario.battery.capacity_wh * J_PER_WH)
    if scenario.energy.demand == "xu2025":
        defaults = parameter_sets.xu2025(scenario.motion.speed_mps)
        return xu2025.Xu2025(**parameters_over(defaults, given, "xu2025"))
    if scenario.energy.demand == "lian2024":
        defaults = parameter_sets.lian2024(scenario.motion.speed_mps)
        return lian2024.lian2024(**parameters_over(defaults, given, "lian2024"))
    return None


def _tick_matrix(world: World) -> Any:
    """Sparse (P, P) matrix of the ticks of the quickest motion from place to place."""
    from scipy import sparse

    graph = world.graph
    a, b = graph.state_place[graph.edge_from].astype(np.int64), graph.state_place[graph.edge_to].astype(np.int64)
    moves = a != b
    key, ticks = a[moves] * world.n_places + b[moves], graph.kind_ticks[graph.edge_kind[moves]]
    order = np.lexsort((ticks, key))
    key, first = np.unique(key[order], return_index=True)
    rows, columns = np.divmod(key, world.n_places)
    shape = (world.n_places, world.n_places)
    return sparse.csr_array((ticks[order][first].astype(np.float64), (rows, columns)), shape=shape)


def _distances(ticks: Any, sources: list[int]) -> F64:
    from scipy.sparse import csgraph

    found: F64 = csgraph.dijkstra(ticks, indices=sources)
    return found


def _leg(world: World, start: int, end: int, loaded: bool) -> Leg:
    """Time-optimal way between two endpoints, beginning at rest as a vehicle that drove straight in stands."""
    from scipy import sparse
    from scipy.sparse import csgraph

    if start == end:
        return Leg(start, end, (), loaded)
    graph = world.graph
    turn = np.array([p.turn_deg / 90 + p.starts for p in graph.primitives])
    weight = graph.kind_ticks[graph.edge_kind] + 1e-4 * turn[graph.edge_kind]
    matrix = sparse.csr_array((weight, graph.edge_to, graph.edge_ptr), shape=(graph.n_states, graph.n_states))
    source = _state_at_rest(world, start)
    distance, before = csgraph.dijkstra(matrix, indices=source, return_predecessors=True)
    states = np.arange(graph.place_ptr[end], graph.place_ptr[end + 1])
    state = int(states[distance[states].argmin()])
    edges: list[int] = []
    while state != source:
        previous = int(before[state])
        span = range(int(graph.edge_ptr[previous]), int(graph.edge_ptr[previous + 1]))
        edges.append(min((e for e in span if graph.edge_to[e] == state), key=lambda e: float(weight[e])))
        state = previous
    return Leg(start, end, tuple(reversed(edges)), loaded)


def _state_at_rest(world: World, endpoint: int) -> int:
    """State of a vehicle standing at an endpoint, heading away from its access cell; the first elsewhere."""
    if not isinstance(world, GridWorld) or world.access[endpoint] == NONE:
        return int(world.graph.place_ptr[endpoint])
    (x, y), (ax, ay) = world.cell_of_place[endpoint], world.cell_of_place[world.access[endpoint]]
    inwards = round(np.degrees(np.arctan2(int(y) - int(ay), int(x) - int(ax)))) % 360
    return world.graph.state(endpoint, world.graph.heading_deg.index(inwards))
