"""What time and energy CBS share: the searched graph, workspaces that grow and are used again, the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.planners.kernels import cbs_high as high
from engine.planners.kernels import cbs_low as low
from engine.planners.kernels import cbs_pair as pair
from engine.planners.kernels.tables import FAR
from engine.planners.oneshot import Limits, Problem, Solution
from engine.types import Component, PlanStatus
from engine.world.motion_graph import MotionGraph

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

MILLION = 1_000_000
CHUNK_NODES, CHUNK_WORK = 200, 400_000
"""Nodes and steps of work between two looks at the limits: below 0.1 s."""
PAIRS, PAIR_EXPANSIONS = 1 << 17, 20_000
"""Room and work for the optimum of two vehicles; what is proven by then is their bound."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What the tree may do. cover: 0 none, 1 CG, 2 DG, 3 WDG · pairs: bounds from the optima of pairs · tries:
    prioritized orders for the incumbent · repairs: times per vehicle that a part of it is planned anew.
    """

    disjoint: bool = True
    cardinal: bool = True
    bypass: bool = True
    cover: int = 0
    pairs: bool = False
    target: bool = True
    branch: bool = False
    tries: int = 4
    repairs: int = 0
    w: float = 1.0
    weights: tuple[float, float, float] = (0.3, 0.3, 0.3)

    def options(self) -> I64:
        """As the compiled loop reads them."""
        out = np.zeros(16, np.int64)
        out[high.DISJOINT], out[high.CARDINAL] = self.disjoint, self.cardinal
        out[high.BYPASS], out[high.COVER] = self.bypass, self.cover
        out[high.TARGET], out[high.BRANCH], out[high.TRIES] = self.target, self.branch, self.tries
        out[high.PAIRED], out[high.W_MILLION] = self.pairs, round(self.w * MILLION)
        return out


def _csr(owner: NDArray[Any], n: int) -> I32:
    ptr = np.zeros(n + 1, np.int64)
    np.cumsum(np.bincount(owner, minlength=n), out=ptr[1:])
    return ptr.astype(np.int32)


def _near(graph: MotionGraph) -> tuple[I64, I64]:
    """Pairs (from place, to place), each once, sorted by the first; steps on the spot left out."""
    n = graph.n_places
    a = graph.state_place[graph.edge_from].astype(np.int64)
    b = graph.state_place[graph.edge_to].astype(np.int64)
    pairs = np.unique(a * n + b)
    a, b = pairs // n, pairs % n
    return a[a != b], b[a != b]


def _places_suffice(graph: MotionGraph, n_pairs: int) -> bool:
    """Whether every state of a place may go to the same places, in one motion each."""
    n = graph.n_places
    to = graph.state_place[graph.edge_to].astype(np.int64)
    if (graph.state_place[graph.edge_from] == to).any():
        return False
    ways = np.unique(graph.edge_from.astype(np.int64) * n + to)
    per_place = np.diff(graph.place_ptr)
    a, _ = _near(graph)
    return bool(len(ways) == per_place[a].sum()) and n_pairs > 0


def time_roads(graph: MotionGraph) -> low.Roads:
    """One per tick. Places are the states where the heading decides nothing."""
    a, b = _near(graph)
    if _places_suffice(graph, len(a)):
        n = graph.n_places
        back = np.argsort(b, kind="stable")
        each = np.arange(n, dtype=np.int32)
        zero = np.zeros(len(a), np.int8)
        back_ptr, back_from = _csr(b, n), a[back].astype(np.int32)
        return low.Roads(
            _csr(a, n), b.astype(np.int32), zero, each, each, np.ones((1, 1), np.int64), np.ones(1, np.int64),
            back_ptr, back_from, zero, np.arange(n + 1, dtype=np.int32), back_ptr, back_from,
        )  # fmt: skip
    return _roads(graph, np.zeros(graph.n_edges, np.int8), np.ones((1, 1), np.int64), np.ones(1, np.int64))


def energy_roads(problem: Problem) -> low.Roads:
    """Millijoules of the empty vehicle, standby included, on (place, heading, moving)."""
    table, graph = problem.costs, problem.graph
    mj = table.total_mj[:, 0, :] + table.standby_mj[:, None]
    return _roads(graph, graph.edge_kind, np.ascontiguousarray(mj), table.standby_mj)


def _roads(graph: MotionGraph, kind: I8, cost: I64, wait: I64) -> low.Roads:
    a, b = _near(graph)
    back = np.argsort(b, kind="stable")
    return low.Roads(
        graph.edge_ptr, graph.edge_to, kind, graph.state_place, graph.stopped, cost, wait, graph.rev_ptr,
        graph.edge_from[graph.rev_edge], kind[graph.rev_edge], graph.place_ptr,
        _csr(b, graph.n_places), a[back].astype(np.int32),
    )  # fmt: skip


class _Room:
    """Workspaces for one graph and number of vehicles; grown in place when a kernel asks."""

    def __init__(self, roads: low.Roads, n: int):
        self.roads, self.n = roads, n
        places, states = len(roads.place_ptr) - 1, len(roads.place)
        self.ticks = 256
        self.work = self._new_work(4096, 4096 + states)
        self.layers = [self._new_layers(4096) for _ in range(2)]
        self.tree = self._new_tree(256, 4096, 1 << 17)
        self.desk = _new_desk(n, places)
        self.h = np.empty((n, states), np.int64)
        self.keys = np.empty(len(roads.to) + states + 16, np.int64)
        self.items = np.empty(len(self.keys), np.int32)

    def _new_work(self, nodes: int, heap: int) -> low.Work:
        places = len(self.roads.place_ptr) - 1
        rows = int(np.clip(64_000_000 // (4 * places), 4, places))
        slots, t = 4 * nodes, self.ticks

        def i32(*shape: int) -> I32:
            return np.zeros(shape, np.int32)

        by_place = i32(places, 4)
        by_place[:, low.ROW] = -1
        bans = low.Bans(
            np.zeros(8, np.int64), np.zeros(16 * t, np.int64), i32(16 * t), i32(2 * t + 8, 5), by_place,
            np.empty((rows, places), np.int32), np.zeros(1, np.int64),
        )  # fmt: skip
        others = low.Others(i32(2, t * places), i32(places, 2), np.array([0, 0, t], np.int64))
        return low.Work(
            bans, others, i32(nodes, 4), np.zeros(nodes, np.int64), np.zeros(heap, np.int64), i32(heap),
            np.zeros(slots, np.int64), i32(slots, 2), np.zeros(1, np.int64), i32(t),
        )  # fmt: skip

    def _new_layers(self, nodes: int) -> low.Layers:
        def i32(size: int) -> I32:
            return np.zeros(size, np.int32)

        return low.Layers(
            i32(nodes), i32(nodes), np.zeros(nodes, np.int64), np.zeros(nodes, np.int8), np.zeros(nodes, np.int8),
            i32(nodes + 1), i32(6 * nodes), np.zeros(6 * nodes, np.int64), np.zeros(4 * nodes, np.int64),
            i32(4 * nodes), i32(4 * nodes), np.zeros(4, np.int64),
        )  # fmt: skip

    def _new_tree(self, nodes: int, recs: int, arena: int) -> high.Tree:
        heap, pairs, i32, i64 = 3 * nodes + 64, 1 << 14, np.int32, np.int64
        return high.Tree(
            np.zeros((nodes, 15), i32), np.zeros((nodes, 3), i64), np.zeros((nodes, 2)),
            np.zeros((nodes, self.n), i32), np.zeros((recs, 7), i64), np.zeros(arena, i32), np.zeros(arena, np.int8),
            np.zeros(self.n, i32), np.zeros((3, heap), i64), np.zeros((3, heap), i32), np.zeros(pairs, i64),
            np.zeros(pairs, i64), np.zeros(pairs, i32), np.zeros(32, i64),
        )  # fmt: skip

    def grow(self) -> None:
        """More room where it ran short."""
        t = self.tree
        nodes, recs, arena = len(t.node), len(t.way), len(t.states)
        used = t.num
        more_nodes = used[high.NODES] + 4 >= nodes or any(
            3 * nodes + 64 <= used[slot] + 8 for slot in (high.HEAP, high.FOCAL, high.WAITING)
        )
        more_recs = used[high.RECS] + 2 * self.n + 4 >= recs
        span = max(int(used[high.LONGEST]) * 2 + 64, self.ticks)
        more_arena = used[high.ARENA] + (2 * self.n + 4) * span >= arena
        if more_nodes or more_recs or more_arena:
            bigger = self._new_tree(nodes << more_nodes, recs << more_recs, max(arena << more_arena, 1 << 16))
            for name, old in t._asdict().items():
                new = getattr(bigger, name)
                if name.startswith("pair_"):
                    continue
                new[tuple(slice(0, size) for size in old.shape)] = old
            bigger.num[high.PAIRS] = 0
            self.tree = bigger
        longest = int(used[high.LONGEST])
        if 2 * longest + 16 >= self.ticks or not (more_nodes or more_recs or more_arena):
            self.ticks *= 2
            size = len(self.work.node) * 2
            self.work = self._new_work(size, size + len(self.roads.place))
            if len(self.layers[0].state) < 65_536:
                self.layers = [self._new_layers(len(self.layers[0].state) * 2) for _ in range(2)]


def _new_desk(n: int, places: int) -> high.Desk:
    room, joint = 4 * n + 256, 1 << 15

    def i32(size: int) -> I32:
        return np.zeros(size, np.int32)

    def i64(size: int) -> I64:
        return np.zeros(size, np.int64)

    return high.Desk(
        i32(places), i64(places), i64(1), i32(room), i32(room), i32(room), i32(room), i32(room), i64(1), i32(n), i64(8),
        np.zeros((n, n), np.int64), i32(n), i64(n), i32(3 * n + 3), i64(joint), i32(joint), i64(joint), i64(1),
        i64(1 << high.MATCHED), np.zeros((2, 5), np.int64),
    )  # fmt: skip


_ROOMS: list[tuple[Any, Any, _Room]] = []
_ROADS: list[tuple[MotionGraph, low.Roads]] = []


def kept_time_roads(graph: MotionGraph) -> low.Roads:
    """The time graph of the latest floors, built once each."""
    for known, roads in _ROADS:
        if known is graph:
            return roads
    roads = time_roads(graph)
    _ROADS.append((graph, roads))
    del _ROADS[:-4]
    return roads


def _room(key: Any, roads: low.Roads, n: int) -> _Room:
    """Workspaces of the latest graphs are kept; nothing in them outlives a solve but their size."""
    for owner, size, room in _ROOMS:
        if owner is key and size == n:
            room.roads = roads
            return room
    room = _Room(roads, n)
    _ROOMS.append((key, n, room))
    del _ROOMS[:-4]
    return room


def _refused(problem: Problem) -> str:
    """Why a problem can't be served; empty when it can."""
    graph = problem.graph
    if not graph.unit:
        return "conflict-based search needs motions of one tick each"
    if len(graph.sweep):
        return "conflict-based search serves floors without diagonal motions"
    at = graph.state_place[problem.starts]
    for word, places in (("start", at), ("goal", problem.goals)):
        if len(set(places.tolist())) < len(places):
            return f"two vehicles {word} at one place"
    if problem.blocked[at].any():
        return f"vehicle {int(np.nonzero(problem.blocked[at])[0][0])} starts at a blocked place"
    return ""


def _mass(problem: Problem) -> NDArray[np.float64]:
    """Share of the heaviest, read from the rolling energy of a straight motion, which is proportional to mass."""
    rolling = problem.costs.mj[:, 0, :, Component.ROLLING].max(axis=1)[problem.cls].astype(np.float64)
    most = rolling.max() if len(rolling) else 0.0
    return rolling / most if most > 0 else np.ones(len(rolling))


@cache
def _shuffles(n: int, tries: int) -> I32:
    rng = np.random.default_rng(2025)
    return np.array([rng.permutation(n) for _ in range(tries)], np.int32).reshape(tries, n)


def orders_of(h0: I64, tries: int, repairs: int) -> I32:
    """Orders for the incumbent: longest way first, shortest first, then seeded shuffles; none without tries."""
    n, first = len(h0), np.argsort(h0, kind="stable")
    more = max(tries - 2, 0) + (repairs * n if tries else 0)
    out = np.empty((min(tries, 2) + more, n), np.int32)
    for k, order in enumerate((first[::-1], first)[:tries]):
        out[k] = order
    if more:
        out[min(tries, 2) :] = _shuffles(n, more)
    return out


def solve_tree(
    problem: Problem, limits: Limits, settings: Settings, *, energy: bool, trace: bool,
    later: Callable[[], None] = lambda: None,
) -> tuple[Solution, bool, list[I32]]:  # fmt: skip
    """Run the tree. The solution has no states yet: they are the third value, as places where the second is true.

    later: called once when a first chunk of work doesn't suffice.
    """
    n = len(problem.starts)
    note = _refused(problem)
    if note:
        return Solution(PlanStatus.INCONSISTENT, (), 0, 0, 0, 0, note), False, []
    if n == 0:
        return Solution(PlanStatus.SOLVED, (), 0, 0, 0, 0), False, []
    graph = problem.graph
    roads = energy_roads(problem) if energy else kept_time_roads(graph)
    room = _room((graph if energy else roads), roads, n)
    on_places = len(roads.place) == graph.n_places
    starts = graph.state_place[problem.starts] if on_places else problem.starts
    starts = np.ascontiguousarray(starts, np.int32)
    goals = np.ascontiguousarray(problem.goals, np.int32)
    cls = np.ascontiguousarray(problem.cls, np.int32) if energy else np.zeros(n, np.int32)
    for k in range(n):
        if limits.stop():
            return Solution(PlanStatus.BUDGET_SPENT, (), 0, 0, 0, 0), on_places, []
        low.fill_cost_to_goal(roads, cls[k], goals[k], problem.blocked, room.h[k], room.keys, room.items)
    h0 = room.h[np.arange(n), starts]
    if (h0 >= FAR).any():
        k = int(np.argmax(h0 >= FAR))
        return Solution(PlanStatus.NO_PATH, (), 0, 0, 0, 0, f"vehicle {k} has no way to its goal"), on_places, []
    orders = orders_of(h0, settings.tries, settings.repairs if n > 2 else 0)
    case = high.Case(
        starts, goals, cls, room.h, _mass(problem), np.array(settings.weights), orders, np.zeros((n, n), np.int64)
    )  # fmt: skip
    options = settings.options()
    _begin(room)
    if settings.pairs and n > 2 and _go(room, case, options, replace(limits, nodes=0)) == high.MORE:
        _pair_costs(room, case, limits)
    ended = _go(room, case, options, limits, later)
    return _answer(room, graph, settings, ended, energy, trace), on_places, _ways(room)


def _begin(room: _Room) -> None:
    """An empty tree."""
    num = room.tree.num
    stamp = num[high.PAIR_STAMP] + 1
    num[:] = 0
    num[high.PAIR_STAMP], num[high.BEST_COST] = stamp, high.NEVER


def _go(
    room: _Room, case: high.Case, options: I64, limits: Limits, later: Callable[[], None] | None = None
) -> int:  # fmt: skip
    """Run the tree within limits, making room where it runs short; how it ended."""
    while True:
        num = room.tree.num
        nodes = min(limits.nodes - int(num[high.HIGH]), CHUNK_NODES)
        ended = int(
            high.run(
                room.roads, room.work, case, room.tree, room.desk, room.layers[0], room.layers[1], options, nodes,
                limits.expansions - int(num[high.LOW]), CHUNK_WORK,
            )
        )  # fmt: skip
        num = room.tree.num
        if ended == high.MORE and later is not None:
            later()
            later = None
        if ended == high.GROW:
            room.grow()
        elif ended != high.MORE:
            return ended
        spent = num[high.HIGH] >= limits.nodes or num[high.LOW] >= limits.expansions or limits.stop()
        if spent and (ended == high.MORE or limits.nodes > 0):  # the root always gets its room
            return ended


@cache
def _pair_work(steps: int) -> pair.PairWork:
    return pair.new_pair_work(PAIRS, steps)


def _pair_costs(room: _Room, case: high.Case, limits: Limits) -> None:
    """Fill case.pair for the pairs in conflict at the root: what they cost at least, alone with each other."""
    desk, roads = room.desk, room.roads
    work = _pair_work(int(np.diff(roads.ptr).max(initial=0)) * 2 + 4)
    out, found = np.zeros(2, np.int64), int(desk.found[0])
    for i, j in sorted(set(zip(desk.a[:found].tolist(), desk.b[:found].tolist(), strict=True))):
        if limits.stop():
            return
        ended = pair.pair_cost(roads, work, case.h, case.cls, case.start, case.goal, i, j, PAIR_EXPANSIONS, out)
        if ended != low.NONE:
            case.pair[i, j] = case.pair[j, i] = out[0]
        room.tree.num[high.LOW] += out[1]


def _ways(room: _Room) -> list[I32]:
    t = room.tree
    if not t.num[high.BEST]:
        return []
    first, length = t.way[t.best, high.FIRST].tolist(), t.way[t.best, high.LENGTH].tolist()
    return [t.states[i : i + k + 1].copy() for i, k in zip(first, length, strict=True)]


def _answer(room: _Room, graph: MotionGraph, settings: Settings, ended: int, energy: bool, trace: bool) -> Solution:
    num = room.tree.num
    found = bool(num[high.BEST])
    bound = int(room.tree.worth[0, high.PROVEN] if settings.branch else num[high.BOUND])
    cost = int(num[high.BEST_COST]) if found else 0
    if found:
        bound = min(bound, cost)
    note = ""
    if ended == high.EMPTY:
        status = PlanStatus.NO_PATH
        note = "the priority rule left no plan" if settings.branch else "no plan exists"
    elif ended == high.DONE:
        status = PlanStatus.SOLVED if cost == bound else PlanStatus.BOUNDED
    else:
        status = PlanStatus.BUDGET_SPENT
    columns = tree_columns(room, graph, energy) if trace else {}
    return Solution(status, (), cost, bound, int(num[high.HIGH]), int(num[high.LOW]), note, columns)


def tree_columns(room: _Room, graph: MotionGraph, energy: bool) -> dict[str, Mapping[str, NDArray[Any]]]:
    """What the search did, as tables `tree`, `plans` and `ways`.

    tree, a row per node: node, parent (-1 at the root) · the constraint it adds to its parent's: agent, kind (see
    KINDS), place, place2 (of a motion, else -1), tick, positive · cost, low (proven for its plan), h (of the tree),
    f = low + h, all in ticks or mJ, energy (mJ, -1 where the tree counts ticks) · n_conflicts · turn in which it was
    expanded, from 0, or -1 · the conflict it was expanded on, -1 where it wasn't: a (constrained first), b, at,
    at2 (of a swap: a drives at → at2, else -1), conflict_tick · dp_low, dp_high: dynamic priorities of a and b
    · status: 0 open, 1 expanded, 2 pruned, 3 its plan is the answer.
    plans: node, vehicle, way. ways: way, tick, place, state (-1 where the search knows places only).
    """
    t, n = room.tree, int(room.tree.num[high.NODES])
    node, worth = t.node[:n].copy(), t.worth[:n].copy()
    best = int(t.num[high.BEST_NODE])
    if t.num[high.BEST] and best >= 0:
        node[best, high.STATUS] = high.ANSWER
    names = ("parent", "agent", "kind", "place", "place2", "tick", "n_conflicts", "status", "turn")
    at = (
        high.PARENT, high.AGENT, high.KIND, high.PLACE, high.PLACE2, high.TICK, high.CLASHES, high.STATUS, high.TURN
    )  # fmt: skip
    tree: dict[str, NDArray[Any]] = {
        "node": np.arange(n, dtype=np.int32),
        **{name: node[:, column] for name, column in zip(names, at, strict=True)},
        **{name: node[:, high.CONFLICT + k] for k, name in enumerate(("a", "b", "at", "at2", "conflict_tick"))},
        "positive": np.isin(node[:, high.KIND], (high.AT, high.OVER, high.BY_THEN)),
        "cost": worth[:, high.COST],
        "low": worth[:, high.PROVEN],
        "h": worth[:, high.H],
        "f": worth[:, high.PROVEN] + worth[:, high.H],
        "energy": worth[:, high.COST] if energy else np.full(n, -1, np.int64),
        "dp_low": t.priority[:n, 0].copy(),
        "dp_high": t.priority[:n, 1].copy(),
    }
    vehicles = room.n
    used, way = np.unique(t.rec[:n], return_inverse=True)
    plans: dict[str, NDArray[Any]] = {
        "node": np.repeat(np.arange(n, dtype=np.int32), vehicles),
        "vehicle": np.tile(np.arange(vehicles, dtype=np.int32), n),
        "way": way.ravel().astype(np.int32),
    }
    spans = t.way[used, high.LENGTH] + 1
    tick = np.arange(int(spans.sum())) - np.repeat(np.cumsum(spans) - spans, spans)
    states = t.states[np.repeat(t.way[used, high.FIRST], spans) + tick]
    on_places = len(room.roads.place) == graph.n_places
    ways: dict[str, NDArray[Any]] = {
        "way": np.repeat(np.arange(len(used), dtype=np.int32), spans),
        "tick": tick.astype(np.int32),
        "place": room.roads.place[states].astype(np.int32),
        "state": np.full(len(states), -1, np.int32) if on_places else states,
    }
    return {"tree": tree, "plans": plans, "ways": ways}


KINDS = (
    "root", "not at place at tick", "not over motion at tick", "at place at tick", "over motion at tick",
    "last arrival later than tick", "last arrival by tick",
)  # fmt: skip
"""What the constraint kinds 0…6 of a tree demand of their agent; the last three bind the other vehicles as well."""


def paths_of(trace: Mapping[str, Mapping[str, NDArray[Any]]], node: int) -> list[I32]:
    """Places of every vehicle by tick, up to its last arrival, in the plan of a node of a traced tree."""
    plans, ways = trace["plans"], trace["ways"]
    chosen = plans["way"][plans["node"] == node]
    first = np.searchsorted(ways["way"], chosen)
    last = np.searchsorted(ways["way"], chosen, side="right")
    return [ways["place"][a:b] for a, b in zip(first.tolist(), last.tolist(), strict=True)]
