"""Path networks: nodes and arcs with positions and lengths, compiled to a motion graph on which arcs are places too.

An arc that may be driven both ways has two lanes, one per direction; a lane holds one vehicle, and so does a node. A
vehicle drives from lane to lane straight through the node between them, which it holds meanwhile; to turn or to hand
over a load it drives into the node, pivots on the spot, and drives out. It waits where it stands: on its lane or node.

Kerbs are lanes on which vehicles may rest for good. They are chosen so that the other lanes alone still lead from
every node to every other: whoever rests never closes a way, and any plan can end. Without them a network of through
nodes is not well-formed for more vehicles than it has dead ends.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, FormatError, unknown_name
from engine.types import NONE, PRIMITIVE_0, Occupancy, StationKind
from engine.world.floor import Station, World
from engine.world.grid import assemble
from engine.world.motion_graph import MotionGraph, Primitive

if TYPE_CHECKING:
    import networkx as nx

THROUGH_DEG = 20
"""A bend of at most so many degrees is driven through a node without stopping."""
PIVOT_STEP_DEG = 15
"""Pivots cost what the nearest multiple of this costs."""
MAX_KINDS = 127 - int(PRIMITIVE_0)
"""The log keeps kinds of motion in one byte."""
LANE_OFFSET_M = 0.12
"""Lanes of an arc are drawn, and driven, so far to the right of its middle."""
LETTERS: dict[StationKind, str] = {
    StationKind.ENTRANCE: "E",
    StationKind.INBOUND: "I",
    StationKind.OUTBOUND: "O",
    StationKind.RACK: "N",
    StationKind.STATION: "S",
}
"""First letter of a station's name, and the order in which stations are numbered."""


@dataclass(frozen=True, slots=True)
class Node:
    """A point of the network; `kind` makes it a station."""

    name: str
    x_m: float
    y_m: float
    kind: StationKind | None = None


@dataclass(frozen=True, slots=True)
class Arc:
    """A way between two nodes, by their index; length in millimetres, one_way from a to b only."""

    a: int
    b: int
    length_mm: int
    one_way: bool = False


@dataclass(frozen=True, slots=True)
class NetworkPlan:
    """A network as asked for.

    mm_per_tick: cruising speed · turn_ticks: a pivot of 90 degrees; others in proportion · kerbs: how many lanes
    vehicles may rest on; as many as the network can give when there are fewer · entrances_charge: one more kerb
    at every entrance, with a charger.
    """

    nodes: tuple[Node, ...]
    arcs: tuple[Arc, ...]
    mm_per_tick: float
    turn_ticks: int
    kerbs: int = 64
    occupancy: Occupancy = Occupancy.HOLD
    margin_ticks: int = 0
    entrances_charge: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class NetworkWorld(World):
    """A compiled network of N nodes and L lanes: places 0…N-1 are the nodes, N…N+L-1 the lanes."""

    nodes: tuple[Node, ...] = field(repr=False)
    arcs: tuple[Arc, ...] = field(repr=False)
    lane_arc: NDArray[np.int32] = field(repr=False)  # (L,)
    lane_ends: NDArray[np.int32] = field(repr=False)  # (L, 2) nodes

    @property
    def n_nodes(self) -> int:
        return len(self.nodes)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres, with a margin of half the mean arc."""
        (x0, y0, x1, y1) = extent(self.nodes, self.arcs)
        return x1 - x0, y1 - y0

    @property
    def grain_m(self) -> float:
        """The mean length of an arc."""
        return float(np.mean([arc.length_mm for arc in self.arcs])) / 1000

    def label(self, place: int) -> str:
        """`node E1` or `lane E1→N17`."""
        return f"{'node' if place < self.n_nodes else 'lane'} {self.names[place]}"

    def arc_of(self, place: int) -> int:
        """The arc of a lane, or -1 for a node."""
        return int(self.lane_arc[place - self.n_nodes]) if place >= self.n_nodes else NONE

    def floor_json(self) -> dict[str, Any]:
        """What a browser needs to draw the network: plain JSON values; lengths in metres, y upwards."""
        width, height = self.size_m
        kerbs = {*self.parking.tolist(), *self.chargers.tolist()}
        return {
            "kind": "network",
            "width_m": round(width, 4),
            "height_m": round(height, 4),
            "cell_m": round(self.grain_m, 4),
            **self.spots(),
            "nodes": [{"place": i, "name": n.name, "kind": str(n.kind or "")} for i, n in enumerate(self.nodes)],
            "lanes": [
                {"place": self.n_nodes + i, "arc": int(arc), "from": a, "to": b, "kerb": self.n_nodes + i in kerbs}
                for i, (arc, (a, b)) in enumerate(zip(self.lane_arc, self.lane_ends.tolist(), strict=True))
            ],
        }


def extent(nodes: tuple[Node, ...], arcs: tuple[Arc, ...]) -> tuple[float, float, float, float]:
    """Smallest and largest x and y (x0, y0, x1, y1) in metres, with a margin of half the mean arc."""
    margin = float(np.mean([arc.length_mm for arc in arcs])) / 2000
    xs, ys = [n.x_m for n in nodes], [n.y_m for n in nodes]
    return min(xs) - margin, min(ys) - margin, max(xs) + margin, max(ys) + margin


def mesh(columns: int, rows: int, spacing_m: float) -> tuple[tuple[Node, ...], tuple[Arc, ...]]:
    """A rectangular network; the outermost columns are entrances, all other nodes racks. Row by row from the bottom."""
    nodes = tuple(
        Node(
            f"{x}/{y}",
            x * spacing_m,
            y * spacing_m,
            StationKind.ENTRANCE if x in (0, columns - 1) else StationKind.RACK,
        )
        for y in range(rows)
        for x in range(columns)
    )
    length = round(spacing_m * 1000)
    across = [Arc(i, i + 1, length) for i in range(rows * columns) if (i + 1) % columns]
    up = [Arc(i, i + columns, length) for i in range((rows - 1) * columns)]
    return nodes, (*across, *up)


def from_networkx(graph: nx.Graph[Any]) -> tuple[tuple[Node, ...], tuple[Arc, ...]]:
    """Nodes and arcs of a networkx graph; a directed one has one-way arcs. Raises BadInput.

    Nodes need `x` and `y` in metres, and may have `kind` (a StationKind) and `name`; edges may have `length` in metres,
    otherwise it is the distance between their nodes.
    """
    index: dict[Any, int] = {}
    nodes: list[Node] = []
    for key, data in graph.nodes(data=True):
        index[key] = len(nodes)
        name = str(data.get("name", key))
        kind = str(data.get("kind", "")) or None
        if kind is not None and kind not in tuple(StationKind):
            raise BadInput(f"node {name}: {unknown_name('kind', kind, tuple(StationKind))}")
        nodes.append(
            Node(name, _metres(data, "x", name), _metres(data, "y", name), StationKind(kind) if kind else None)
        )
    directed = graph.is_directed()
    arcs: dict[tuple[int, int], Arc] = {}
    for a, b, data in graph.edges(data=True):
        i, j = index[a], index[b]
        length = _metres(data, "length", f"{a} – {b}") if "length" in data else _apart(nodes[i], nodes[j])
        back = arcs.get((j, i))
        if directed and back is not None and back.length_mm == round(length * 1000):
            arcs[(j, i)] = Arc(j, i, back.length_mm)  # both ways of one arc
        else:
            arcs[(i, j)] = Arc(i, j, round(length * 1000), directed)
    return tuple(nodes), tuple(arcs.values())


def read_graphml(path: Path) -> tuple[tuple[Node, ...], tuple[Arc, ...]]:
    """Nodes and arcs of a GraphML file, as from_networkx takes them. Raises FormatError."""
    import networkx as nx

    try:
        graph = nx.read_graphml(path)
        return from_networkx(graph)
    except BadInput as why:
        raise FormatError(f"{path.name}: {why}") from why
    except OSError as why:
        raise FormatError(f"{path.name}: can't be read: {why.strerror or why}") from why
    except (nx.NetworkXError, ElementTree.ParseError, KeyError, ValueError) as why:
        raise FormatError(f"{path.name}: not a GraphML file: {why}") from why


def _metres(data: Mapping[str, Any], key: str, of: str) -> float:
    try:
        value = float(data[key])
    except KeyError:
        raise BadInput(f"{of}: there is no {key!r}; expected a number of metres") from None
    except (TypeError, ValueError):
        raise BadInput(f"{of}: got {key} = {data[key]!r}, expected a number of metres") from None
    if not math.isfinite(value):
        raise BadInput(f"{of}: got {key} = {value}, expected a finite number of metres")
    return value


def _apart(a: Node, b: Node) -> float:
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


# ---------------------------------------------------------------- compilation


def build_network(plan: NetworkPlan) -> NetworkWorld:
    """Compile a network. Raises BadInput with one sentence when it is wrong."""
    _check(plan)
    nodes, n = plan.nodes, len(plan.nodes)
    ends = [(i, *ab) for i, arc in enumerate(plan.arcs) for ab in _directions(arc)]
    lane_arc = np.array([i for i, _, _ in ends], np.int32)
    lane_ends = np.array([(a, b) for _, a, b in ends], np.int32).reshape(-1, 2)
    x0, y0, _, _ = extent(nodes, plan.arcs)
    xy = np.array([(node.x_m - x0, node.y_m - y0) for node in nodes])
    way = xy[lane_ends[:, 1]] - xy[lane_ends[:, 0]]
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    right = np.stack([unit[:, 1], -unit[:, 0]], 1) * LANE_OFFSET_M
    two = np.array([not plan.arcs[i].one_way for i in lane_arc])
    lane_xy = xy[lane_ends].mean(axis=1) + right * two[:, None]
    graph = _compile(plan, lane_arc, lane_ends, unit, np.concatenate([xy, lane_xy]).astype(np.float32))
    parking, chargers = (np.array([n + lane for lane in some], np.int32) for some in choose_kerbs(plan, lane_ends, xy))
    order = [(kind, i) for kind in LETTERS for i, node in enumerate(nodes) if node.kind is kind]
    stations = tuple(
        Station(number, f"{LETTERS[kind]}{number}", kind, i, NONE) for number, (kind, i) in enumerate(order, start=1)
    )
    called = {s.place: s.name for s in stations}
    name = [called.get(i, node.name) for i, node in enumerate(nodes)]
    names = [f"{called[i]} at {node.name}" if i in called else node.name for i, node in enumerate(nodes)]
    endpoint = np.zeros(graph.n_places, np.bool_)
    endpoint[[s.place for s in stations]] = True
    world = NetworkWorld(
        graph=graph,
        occupancy=plan.occupancy,
        margin_ticks=plan.margin_ticks,
        stations=stations,
        chargers=chargers,
        parking=parking,
        access=np.full(graph.n_places, NONE, np.int32),
        endpoint=endpoint,
        names=(*names, *(f"{name[a]}→{name[b]}" for a, b in lane_ends.tolist())),
        nodes=nodes,
        arcs=plan.arcs,
        lane_arc=lane_arc,
        lane_ends=lane_ends,
    )
    for array in (parking, chargers, world.access, endpoint, lane_arc, lane_ends):
        array.setflags(write=False)
    return world


def _check(plan: NetworkPlan) -> None:
    n = len(plan.nodes)
    if n < 2 or not plan.arcs:
        raise BadInput(f"a network needs at least two nodes and an arc; got {n} nodes and {len(plan.arcs)} arcs")
    if plan.occupancy is not Occupancy.HOLD:
        raise BadInput(f"a network needs occupancy 'hold'; got {str(plan.occupancy)!r}")
    names = [node.name for node in plan.nodes]
    if len(set(names)) < n:
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise BadInput(f"two nodes are called {twice!r}")
    seen: set[tuple[int, int]] = set()
    for arc in plan.arcs:
        a, b = plan.nodes[arc.a].name, plan.nodes[arc.b].name
        if arc.a == arc.b:
            raise BadInput(f"the arc from {a} leads back to it")
        if _apart(plan.nodes[arc.a], plan.nodes[arc.b]) == 0:
            raise BadInput(f"nodes {a} and {b} stand at one point")
        if arc.length_mm / plan.mm_per_tick < 1.5:
            raise BadInput(
                f"the arc from {a} to {b} is {arc.length_mm} mm, which takes less than two ticks at "
                f"{plan.mm_per_tick:g} mm per tick; expected a longer arc or a shorter tick"
            )
        for lane in _directions(arc):
            if lane in seen:
                raise BadInput(f"two arcs lead from {plan.nodes[lane[0]].name} to {plan.nodes[lane[1]].name}")
            seen.add(lane)


def _directions(arc: Arc) -> Iterator[tuple[int, int]]:
    yield arc.a, arc.b
    if not arc.one_way:
        yield arc.b, arc.a


class _Kinds:
    """Primitives as they come up, each once."""

    def __init__(self) -> None:
        self.all: list[Primitive] = []
        self._index: dict[tuple[str, int, int, bool, int], int] = {}

    def of(self, role: str, length_mm: int, turn_deg: int, starts: bool, ticks: int) -> int:
        key = (role, length_mm, turn_deg, starts, ticks)
        if key not in self._index:
            pivot = role == "pivot"
            word = {"pivot": "pivot" if starts else "stop pivot"}.get(role, f"start {role}" if starts else role)
            name = f"{word} {turn_deg}°" if pivot else f"{word} {length_mm} mm"
            if any(p.name == name for p in self.all):
                name = f"{name} in {ticks} ticks"
            self._index[key] = len(self.all)
            self.all.append(Primitive(name, length_mm, turn_deg, starts and not pivot, pivot, ticks))
        return self._index[key]


def _compile(
    plan: NetworkPlan,
    lane_arc: NDArray[np.int32],
    lane_ends: NDArray[np.int32],
    unit: NDArray[np.float64],
    xy_m: NDArray[np.float32],
) -> MotionGraph:
    """States: a lane has its own heading, a node those of its lanes; each standing and rolling."""
    n, lanes = len(plan.nodes), len(lane_arc)
    degrees = (np.rint(np.degrees(np.arctan2(unit[:, 1], unit[:, 0]))).astype(int) % 360).tolist()
    heading_deg = tuple(sorted(set(degrees)))
    index = {deg: i for i, deg in enumerate(heading_deg)}
    out: list[list[int]] = [[] for _ in range(n)]
    at_node: list[list[int]] = [[] for _ in range(n)]
    for lane, (a, b) in enumerate(lane_ends.tolist()):
        out[a].append(lane)
        for node in (a, b):
            if (h := index[degrees[lane]]) not in at_node[node]:
                at_node[node].append(h)
    slots = max(map(len, at_node))
    per_place = 2 * slots
    headings = np.zeros((n + lanes, slots), np.int8)
    for place in range(n + lanes):
        own = sorted(at_node[place]) if place < n else [index[degrees[place - n]]]
        headings[place] = (own + [h for h in range(len(heading_deg)) if h not in own])[:slots]

    def state(place: int, heading: int, moving: int) -> int:
        slot: int = headings[place].tolist().index(heading)
        return place * per_place + 2 * slot + moving

    kinds = _Kinds()
    rows: list[tuple[int, int, int, int, int]] = []
    length = [plan.arcs[i].length_mm for i in lane_arc]
    ticks = [round(mm / plan.mm_per_tick) for mm in length]
    lead_mm, lead = [mm // 2 for mm in length], [t // 2 for t in ticks]  # from the node behind to where one stands
    for lane, (_, node) in enumerate(lane_ends.tolist()):
        heading = index[degrees[lane]]
        rest_mm, rest = length[lane] - lead_mm[lane], ticks[lane] - lead[lane]
        for moving in (0, 1):
            start = state(n + lane, heading, moving)
            kind = kinds.of("into node", rest_mm, 0, not moving, rest)
            rows.append((start, state(node, heading, 1), kind, NONE, NONE))
            for ahead in out[node]:
                if _turn(degrees[lane], degrees[ahead]) <= THROUGH_DEG:
                    kind = kinds.of("straight", rest_mm + lead_mm[ahead], 0, not moving, rest + lead[ahead])
                    rows.append((start, state(n + ahead, index[degrees[ahead]], 1), kind, node, NONE))
    for node in range(n):
        leaves = sorted({index[degrees[lane]] for lane in out[node]})
        for heading in at_node[node]:
            for moving in (0, 1):
                start = state(node, heading, moving)
                for ahead in out[node]:
                    if index[degrees[ahead]] == heading:
                        kind = kinds.of("out of node", lead_mm[ahead], 0, not moving, lead[ahead])
                        rows.append((start, state(n + ahead, heading, 1), kind, NONE, NONE))
                for towards in leaves:
                    if towards != heading:
                        exact = _turn(heading_deg[heading], heading_deg[towards])
                        turn = max(PIVOT_STEP_DEG, PIVOT_STEP_DEG * round(exact / PIVOT_STEP_DEG))
                        span = max(1, round(plan.turn_ticks * turn / 90))
                        kind = kinds.of("pivot", 0, turn, not moving, span)
                        rows.append((start, state(node, towards, 0), kind, NONE, NONE))
    if len(kinds.all) > MAX_KINDS:
        raise BadInput(
            f"the network has {len(kinds.all)} kinds of motion, expected at most {MAX_KINDS}: "
            "let more arcs have equal lengths"
        )
    return assemble(
        xy_m=xy_m,
        per_place=per_place,
        n_head=slots,
        rows=np.array(sorted(rows), np.int64),
        primitives=tuple(kinds.all),
        headings=np.repeat(headings.reshape(-1), 2),
        heading_deg=heading_deg,
        arc_ticks=np.array([0] * n + ticks, np.int32),
    )


def _turn(a: int, b: int) -> int:
    """Change of heading in degrees, 0 to 180."""
    return min((b - a) % 360, (a - b) % 360)


def choose_kerbs(
    plan: NetworkPlan, lane_ends: NDArray[np.int32], xy: NDArray[np.float64]
) -> tuple[list[int], list[int]]:
    """Lanes on which vehicles may rest, and those among the others on which they charge, ascending.

    The lanes left over lead from node to node wherever all lanes do, and every arc keeps one. Greedy: first a lane out
    of every entrance, where they charge; then the outermost, for few shortest routes lead over them, and those at
    entrances last.
    """
    away = np.abs(xy - xy.mean(axis=0))
    outer = (away / np.maximum(away.max(axis=0), 1e-9)).max(axis=1)
    entrance = np.array([node.kind is StationKind.ENTRANCE for node in plan.nodes])
    rank = outer[lane_ends].mean(axis=1) - 2 * entrance[lane_ends].any(axis=1)
    onward: list[set[int]] = [set() for _ in plan.nodes]
    for a, b in lane_ends.tolist():
        onward[a].add(b)

    def reaches(a: int, b: int) -> bool:
        seen, ahead = {a}, [a]
        while ahead and b not in seen:
            more = onward[ahead.pop()] - seen
            seen |= more
            ahead += more
        return b in seen

    def closed(lane: int) -> bool:
        a, b = lane_ends[lane].tolist()
        if b not in onward[a] or a not in onward[b]:
            return False
        onward[a].remove(b)
        if not reaches(a, b):  # b leads back to a: with another way there, everything still leads everywhere
            onward[a].add(b)
        return b not in onward[a]

    kerbs: list[int] = []
    chargers: list[int] = []
    for node in np.flatnonzero(entrance).tolist() if plan.entrances_charge else ():
        out = np.flatnonzero(lane_ends[:, 0] == node).tolist()
        chargers += islice((lane for lane in out if closed(lane)), 1)
    for lane in np.argsort(-rank, kind="stable").tolist():
        if len(kerbs) < plan.kerbs and closed(lane):
            kerbs.append(lane)
    return sorted(kerbs), sorted(chargers)
