"""Learned time: what the routers of Lian et al. 2024 expect of every arc, and one request routed by each of them.

The arc times are those of a recorded run of ten hours (scripts/learned_time.py); the routes are what the planners
answer to the times of each refresh, for a vehicle alone on the floor.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from dash import html
from numpy.typing import NDArray

import assets
from app.lessons.base import Lesson, Preset, Query, packed, read_whole
from engine.errors import BadInput, FormatError, unknown_name
from engine.planners.astar_distance import AStarDistance
from engine.planners.astar_turns import AStarTurns
from engine.planners.base import Leg, Memory, Observed, Request, Router, View
from engine.planners.routing import lengths_of, turns_of
from engine.planners.search import FloorSearch
from engine.planners.stochastic import MS, Stochastic
from engine.scenario import load
from engine.traffic import gap_at, new_claims
from engine.types import Activity
from engine.world import build_world
from engine.world.network import NetworkWorld

if TYPE_CHECKING:
    from engine.scenario import Scenario

SCENARIO = "lian2024"
FILE = assets.path("lessons") / "learned-time.parquet"
ABOUT = "wattlane"
"""The key of the file's own metadata under which it says which run it is from."""
KEYS = ("start", "goal", "show", "scale", "step", "have")
SCALES = ("", "log")
LAST = 9999

METHODS: dict[str, tuple[str, Router]] = {
    "stochastic": ("stochastic: least expected time", Stochastic()),
    "literal": ("stochastic as printed: eqs. 11, 12", Stochastic(literal=True)),
    "astar-turns": ("A*: distance, then turns", AStarTurns()),
    "astar-distance": ("A*: distance", AStarDistance()),
}
"""Word and router of each method, in the order of the page."""

I64 = NDArray[np.int64]

# The search keeps its tables from call to call and serves one at a time.
_ONE_AT_A_TIME = threading.Lock()


class Asked(NamedTuple):
    """A checked state: nodes of start and goal."""

    start: int
    goal: int


@dataclass(frozen=True)
class Learned:
    """The recorded run. Arrays (R, P): of every period what was seen, and what was expected after it.

    seconds: when each period ended, (R,) · samples: finished visits · busy_ms: held · expected_ms.
    """

    about: Mapping[str, Any]
    seconds: tuple[float, ...]
    samples: I64
    mean_ms: I64
    busy_ms: I64
    expected_ms: I64


@cache
def scenario() -> Scenario:
    """What was recorded, and is routed on."""
    return load(SCENARIO, {"planner.name": "stochastic", "planner.parameters": {}})


@cache
def network() -> NetworkWorld:
    """The floor of the lesson."""
    world = build_world(scenario())
    assert isinstance(world, NetworkWorld)
    return world


@cache
def stations() -> dict[str, int]:
    """Name → node of every entrance and rack."""
    return {s.name: s.place for s in network().stations}


@cache
def learned() -> Learned:
    """The recorded run. Raises FormatError when the file is of another floor."""
    import pyarrow.parquet as pq

    table = pq.read_table(FILE)
    about = json.loads((table.schema.metadata or {})[ABOUT.encode()])
    world = network()
    if about["places"] != world.n_places:
        raise FormatError(
            f"{FILE.name} is of a floor of {about['places']} places, {SCENARIO} has {world.n_places}; "
            "expected a file made by scripts/learned_time.py"
        )
    columns = {name: table[name].to_numpy() for name in table.column_names}
    ends = np.unique(columns["tick"])
    row = np.searchsorted(ends, columns["tick"])
    tick_s = scenario().time.tick_s
    own = np.rint(world.graph.arc_ticks * tick_s * MS).astype(np.int64)
    seen = {name: np.zeros((len(ends), world.n_places), np.int64) for name in ("samples", "mean_ms", "busy_ms")}
    for name, values in seen.items():
        values[row, columns["place"]] = columns[name]
    expected = np.empty((len(ends), world.n_places), np.int64)
    for k in range(len(ends)):  # an arc without a row is expected to take what it took before
        expected[k] = expected[k - 1] if k else own
        now = row == k
        expected[k, columns["place"][now]] = columns["expected_ms"][now]
    return Learned(about, tuple((ends * tick_s).tolist()), **seen, expected_ms=expected)


@cache
def expectations() -> I64:
    """Expected ms by step, (R + 1, P): before anything was seen, and after each refresh."""
    own = np.rint(network().graph.arc_ticks * scenario().time.tick_s * MS).astype(np.int64)
    return np.concatenate([own[None], learned().expected_ms])


def read(query: Query) -> Asked:
    """The state of an address. Raises BadInput."""
    known = stations()
    for key in ("start", "goal"):
        if query[key] not in known:
            raise BadInput(unknown_name(key, query[key][:20], known))
    if query["start"] == query["goal"]:
        raise BadInput(f"goal: it is the start, {query['goal']}")
    for name in filter(None, query.get("show", "").split(".")):
        if name not in METHODS and name != "none":
            raise BadInput(unknown_name("method", name[:40], METHODS))
    if query.get("scale", "") not in SCALES:
        raise BadInput(unknown_name("scale", query["scale"][:20], SCALES[1:]))
    read_whole(query.get("step", ""), "step", 0, LAST, 0)
    return Asked(known[query["start"]], known[query["goal"]])


# -- routing ----------------------------------------------------------------------------------------------------------


@cache
def _floor_search() -> tuple[FloorSearch, Any]:
    """Search over the empty floor, and its costs, which these routers don't ask for."""
    from engine.build import build

    simulation = build(scenario())
    return FloorSearch(network().graph, simulation.parts.costs), simulation.parts.costs


def _view(asked: Asked) -> View:
    """One vehicle on the empty floor: it stands at the start, facing the goal's column (in that column: the goal)."""
    world = network()
    search, costs = _floor_search()
    claims = new_claims(world.n_places, 8)
    (ax, ay), (bx, by) = (world.graph.xy_m[node].tolist() for node in asked)
    facing = (0 if bx > ax else 180) if abs(bx - ax) > abs(world.grain_m) / 2 else (90 if by > ay else 270)
    state = world.graph.state(asked.start, world.graph.heading_deg.index(facing))
    legs = (Leg(asked.goal, 0, Activity.DROP, True),)
    request = Request(0, state, int(gap_at(claims, asked.start, 0)), 0, 0, legs)
    blocked = np.zeros(world.n_places, np.uint8)
    return View(world.graph, world.occupancy, 0, costs, claims, blocked, 0, search, request)


def taught(router: Stochastic, memory: Memory, expected_ms: I64) -> Memory:
    """A router's memory as if it had seen every arc once, taking what is expected of it: then it expects just that."""
    tick_s = scenario().time.tick_s
    at_once = Stochastic(router.turn_ms, router.stop_ms, min_samples=1, smoothing=1.0, literal=router.literal)
    once = (network().graph.arc_ticks > 0).astype(np.int64)
    return at_once.learn(Observed(once, expected_ms / (tick_s * MS), tick_s), memory)  # type: ignore[arg-type]


@cache
def _costs() -> tuple[I64, ...]:
    """Expected ms of every edge by step: arcs, turns and stops, as stochastic counts them."""
    view = _floor_search()
    router = Stochastic()
    empty = router.init(network().graph, view[1], np.random.default_rng(0))
    return tuple(taught(router, empty, row)["cost"] for row in expectations())


def routes(name: str, view: View) -> list[NDArray[np.int32]]:
    """The edges that a method answers with, by step."""
    _, router = METHODS[name]
    memory = router.init(view.graph, view.costs, np.random.default_rng(0))
    found: list[NDArray[np.int32]] = []
    for expected_ms in expectations():
        if isinstance(router, Stochastic):
            memory = taught(router, memory, expected_ms)
        elif found:  # it learns nothing
            found.append(found[0])
            continue
        legs, memory = router.route(view, memory)
        found.append(np.asarray(legs[0], np.int32))
    return found


def told(name: str, view: View) -> dict[str, Any]:
    """A method's different routes, which of them it takes at each step, and the expected time of that one then."""
    graph = network().graph
    found = routes(name, view)
    length, turn = lengths_of(graph), turns_of(graph)
    distinct: dict[bytes, int] = {}
    ways: list[dict[str, Any]] = []
    for edges in found:
        if edges.tobytes() in distinct:
            continue
        distinct[edges.tobytes()] = len(ways)
        places = [int(graph.state_place[view.request.state]), *graph.state_place[graph.edge_to[edges]].tolist()]
        ways.append(
            {
                "places": [p for i, p in enumerate(places) if i == 0 or p != places[i - 1]],
                "mm": int(length[edges].sum()),
                "turns": int(turn[edges].sum()) / 90,
                "arcs": int((graph.arc_ticks[graph.state_place[graph.edge_to[edges]]] > 0).sum()),
            }
        )
    return {
        "name": name,
        "ways": ways,
        "taken": [distinct[edges.tobytes()] for edges in found],
        "expected_ms": [int(cost[edges].sum()) for cost, edges in zip(_costs(), found, strict=True)],
    }


def floor_answer() -> dict[str, Any]:
    """The floor, and what was seen and expected, by step and lane: what doesn't change from request to request."""
    world, run = network(), learned()
    lanes = np.arange(world.n_nodes, world.n_places)
    period = np.diff([0.0, *run.seconds]) * MS
    held = np.rint(1000 * run.busy_ms / period[:, None])  # in thousandths of the period
    return {
        "floor": world.floor_json(),
        "seconds": [0.0, *run.seconds],
        "expected": packed({str(k): row[lanes] for k, row in enumerate(expectations())}),
        "samples": packed({str(k): row[lanes] for k, row in enumerate(run.samples, start=1)}),
        "busy": packed({str(k): row[lanes] for k, row in enumerate(held, start=1)}),
        "about": dict(run.about),
    }


def answer(query: Query) -> dict[str, Any]:
    """Every method's routes for the request, by step. Raises BadInput."""
    asked = read(query)
    with _ONE_AT_A_TIME:
        view = _view(asked)
        methods = [told(name, view) for name in METHODS]
    return {
        "start": asked.start,
        "goal": asked.goal,
        "methods": methods,
        **({} if query.get("have") else floor_answer()),
    }


# -- the page ---------------------------------------------------------------------------------------------------------

PRESETS = (
    Preset(
        "Into a busy column",
        {"start": "N102", "goal": "E2"},
        "Step through the refreshes. At first all four drive along the row and down the column of entrances. That "
        "column fills up, since vehicles load there: once its arcs are known to be slow, stochastic goes down beside "
        "it, at the price of a second turn. The other routes don't change, but their time does.",
    ),
    Preset(
        "A way round",
        {"start": "E16", "goal": "E2"},
        "Both ends lie in the same column. Along it is the shortest way; when it is slow enough, stochastic drives a "
        "longer way through the next column. Compare length and expected time in the table.",
    ),
    Preset(
        "Changing its mind",
        {"start": "N18", "goal": "E8"},
        "Many routes are nearly equal, and every half hour another one is the least. If all vehicles changed over at "
        "once they would fill it: that is why new means count by half (smoothing).",
    ),
    Preset(
        "Nothing to gain",
        {"start": "E10", "goal": "N79"},
        "In the middle of the floor arcs differ little. The shortest route with one turn remains the least in expected "
        "time, and all methods agree.",
    ),
)


def text() -> Sequence[Any]:
    """What stands beside the network."""
    router = Stochastic()
    return [
        html.H3("What is learned"),
        html.P(
            f"Every {router.refresh_s / 60:.0f} simulated minutes each arc gets a new expected time E(w): half the "
            "mean of the visits in that period, half the old value. Fewer than "
            f"{router.min_samples} visits leave it as it was. A visit is the driving itself and all waiting on the "
            "arc and on the node at its end. Each direction of an arc is a lane of its own."
        ),
        html.P(
            "The colours are those of a real run, not of a model: ten hours in which stochastic itself routed all "
            "vehicles. Point at an arc to read its time, its passages in the last period, and how long it was held."
        ),
        html.H3("How a request is routed"),
        html.Dl(
            [
                html.Dt("stochastic"),
                html.Dd(f"A* with g = ΣE(w) + {router.turn_ms} ms per turn of 90°, and h the exact expected time to "
                        "go: no route has less expected time."),
                html.Dt("literal"),
                html.Dd("The paper's (11) and (12): g counts length over speed and turns, h the arcs to go times the "
                        "mean of all E(w). What was learned enters as that one mean, the same for every arc, so the "
                        "route never learns."),
                html.Dt("astar-turns"),
                html.Dd("Least metres, then fewest turns."),
                html.Dt("astar-distance"),
                html.Dd("Least metres. It doesn't choose between equal lengths; here its ties fall on the same routes "
                        "as those of astar-turns."),
            ]
        ),
        html.P(
            "One vehicle alone on the floor, standing at the start and facing the goal's column. The expected time of "
            "a route is the sum that stochastic would give it, whoever chose it.",
            className="wl-hint",
        ),
        html.H3("What is not promised"),
        html.P(
            "The least expectation is not always the likelier winner: P(X ≤ Y) ≥ ½ follows from E(X) ≤ E(Y) for "
            "normal times, not in general, and arc times are skewed. Nor is a sum of means the time that a vehicle "
            "will need when all others use the same numbers."
        ),
    ]  # fmt: skip


LESSON = Lesson(
    title="Learned time",
    summary="The network of Lian et al. 2024 coloured by what its arcs are expected to take, refresh by refresh over "
    "ten hours, and one request routed by each method: length, turns, expected time.",
    presets=PRESETS,
    keys=KEYS,
    read=read,
    answer=answer,
    text=text,
    options={"methods": {name: word for name, (word, _) in METHODS.items()}, "floor": SCENARIO},
)
