"""Hypothesis strategies: small random floors, reservations of others, requests; and texts of small scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from engine.energy import Battery, CostTable, battery, cost_table
from engine.energy.parameter_sets import xu2025
from engine.energy.xu2025 import Xu2025
from engine.planners.base import Leg, Request, View
from engine.planners.search import FloorSearch
from engine.traffic import claim, gap_at, new_claims
from engine.types import Activity, Occupancy
from engine.world.grid import GridMotion, compile_grid
from engine.world.motion_graph import MotionGraph
from tests import naive

MASSES = [(1000.0, 500.0), (400.0, 1200.0)]


@dataclass(frozen=True)
class Ask:
    """A request for one more vehicle."""

    state: int
    tick: int
    cls: int
    legs: tuple[Leg, ...]


@dataclass(frozen=True)
class Ground:
    """A floor with its rule, costs, and what is reserved on it."""

    floor: naive.Floor
    costs: CostTable
    search: FloorSearch
    reservations: list[naive.Reservation]

    @property
    def graph(self) -> MotionGraph:
        return self.floor.graph

    def free_places(self, tick: int) -> list[int]:
        """Where a vehicle may stand at a tick."""
        return [p for p in range(self.graph.n_places) if naive.is_free(self.reservations, p, tick, tick + 1)]

    def __repr__(self) -> str:
        g, f = self.graph, self.floor
        ways = sorted({(e.from_place, e.to_place) for e in f.edges if e.from_place != e.to_place})
        kinds = [(p.name, p.ticks) for p in g.primitives]
        total, standby = self.costs.total_mj.tolist(), self.costs.standby_mj.tolist()
        return (
            f"Ground(xy={g.xy_m.tolist()}, ways={ways}, kinds={kinds}, hold={f.hold}, margin={f.margin}, "
            f"blocked={set(f.blocked)}, mj={total}, standby={standby}, reservations={self.reservations})"
        )

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    def goals(self, ask: Ask) -> list[naive.Goal]:
        """The request's legs as the naive search reads them."""
        total = self.costs.total_mj[ask.cls]
        return [naive.Goal(leg.place, leg.stay_ticks, total[int(leg.loaded)].tolist()) for leg in ask.legs]

    def standby(self, ask: Ask) -> int:
        return int(self.costs.standby_mj[ask.cls])

    def view(self, ask: Ask) -> View:
        """What a planner is shown, with these reservations as claims of vehicles 1, 2 …"""
        graph = self.graph
        claims = new_claims(graph.n_places, len(self.reservations) + 8)
        for place, start, end, owner in self.reservations:
            assert claim(claims, place, start, end, owner) >= 0
        gap = int(gap_at(claims, int(graph.state_place[ask.state]), ask.tick))
        assert gap >= 0
        blocked = np.zeros(graph.n_places, np.uint8)
        blocked[list(self.floor.blocked)] = 1
        rule = Occupancy.HOLD if self.floor.hold else Occupancy.MAPF
        request = Request(0, ask.state, gap, ask.tick, ask.cls, ask.legs)
        return View(graph, rule, self.floor.margin, self.costs, claims, blocked, 0, self.search, request)


def model(standby_w: float = 30.0) -> Xu2025:
    """The default demand model."""
    return Xu2025(**{**xu2025(), "standby_w": standby_w})


def grid_graph(
    width: int,
    height: int,
    walls: Sequence[tuple[int, int]] = (),
    motion: GridMotion | None = None,
    eight: bool = False,
) -> MotionGraph:
    """A grid where every free cell may be left in every direction."""
    free = np.ones((height, width), np.bool_)
    for x, y in walls:
        free[y, x] = False
    exits = np.full((height, width), 0b11111111 if eight else 0b01010101, np.uint8)
    return compile_grid(free, exits, motion or GridMotion())


@st.composite
def graphs(draw: st.DrawFn, unit: bool = False, most: int = 4) -> MotionGraph:
    """Motion graphs of small floors: walls, one-way ways, 4 or 8 neighbours, arcs or pivots, motions of any length."""
    width, height = draw(st.integers(1, most)), draw(st.integers(1, most))
    cells = draw(st.lists(st.integers(0, 5), min_size=width * height, max_size=width * height))
    free = np.array(cells).reshape(height, width) > 0
    free[0, 0] = True
    eight = draw(st.booleans())
    every = 0b11111111 if eight else 0b01010101
    closed = draw(st.lists(st.integers(0, 255), min_size=width * height, max_size=width * height))
    ways = draw(st.sampled_from(["all", "all", "some"]))
    exits = np.full((height, width), every, np.uint8)
    if ways == "some":
        exits &= ~np.array([a & b for a, b in zip(closed, reversed(closed), strict=True)], np.uint8).reshape(
            exits.shape
        )
    ticks = st.just(1) if unit else st.integers(1, 3)
    motion = GridMotion(
        cell_mm=1000, turning=draw(st.sampled_from(["arc", "pivot"])), straight_ticks=draw(ticks),
        turn_ticks=draw(ticks), reverse_ticks=draw(ticks), diagonal_ticks=draw(ticks),
    )  # fmt: skip
    return compile_grid(free, exits, motion)


@st.composite
def costs_of(draw: st.DrawFn, graph: MotionGraph) -> CostTable:
    """Costs of xu2025 for two classes, or arbitrary ones where starting costs no less than rolling on."""
    if draw(st.booleans()):
        return cost_table(graph.primitives, model(draw(st.sampled_from([30.0, 0.0, 200.0]))), MASSES, 1.0)
    kinds = len(graph.primitives)
    mj = np.array(draw(st.lists(st.integers(0, 9), min_size=4 * kinds, max_size=4 * kinds)), np.int64)
    table = np.zeros((2, 2, kinds, 10), np.int64)
    # primitives come in pairs: rolling on, starting
    table[..., 0] = np.sort(mj.reshape(2, 2, kinds // 2, 2)).reshape(2, 2, kinds)
    return CostTable(table, table.sum(axis=3), np.array([draw(st.integers(0, 3))] * 2, np.int64))


@st.composite
def walked(draw: st.DrawFn, floor: naive.Floor, count: int) -> list[naive.Reservation]:
    """What vehicles occupy that wander about legally one after the other; some remain, some vanish."""
    out: list[naive.Reservation] = []
    for owner in range(1, count + 1):
        choices = draw(st.lists(st.integers(0, 255), min_size=1, max_size=7))
        state, t = choices[0] % floor.graph.n_states & ~1, choices[-1] % 4
        place, since = floor.place(state), t
        if not naive.is_free(out, place, t, t + 1):
            continue
        drives: list[tuple[naive.Edge, int]] = []
        for choice in choices[1:]:
            goal = [naive.Goal(-1, 0, [0] * len(floor.graph.primitives))]
            ways = list(naive.after(floor, out, goal, 0, state, 0, t))
            if not ways:
                break
            then, _, t2, _, what = ways[choice % len(ways)]
            if isinstance(what, naive.Edge):
                drives.append((what, t))
            state, t = then, t2
        remains = choices[-1] % 3 and naive.is_free(out, floor.place(state), t, naive.FOREVER)
        mine = naive.reservations_of(floor, owner, place, since, drives, naive.FOREVER if remains else t + 1)
        # with a margin, or at once over its own corner, a vehicle may touch its own trail
        if not any(naive.is_free(mine[:i], p, a, b) is False for i, (p, a, b, _) in enumerate(mine)):
            out += mine
    return out


@st.composite
def scattered(draw: st.DrawFn, floor: naive.Floor) -> list[naive.Reservation]:
    """Arbitrary disjoint reservations."""
    n = floor.graph.n_places
    some = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, 14), st.integers(1, 6)), max_size=8))
    out: list[naive.Reservation] = []
    for owner, (place, start, span) in enumerate(some):
        end = naive.FOREVER if span == 6 and start > 4 else start + span
        if naive.is_free(out, place, start, end):
            out.append((place, start, end, 1 + owner % 3))
    return out


@st.composite
def grounds(draw: st.DrawFn, most: int = 4) -> Ground:
    """A floor, its rule and its costs, with others about."""
    hold = draw(st.booleans())
    graph = draw(graphs(unit=not hold, most=most))
    n = graph.n_places
    blocked = draw(st.lists(st.integers(0, n - 1), max_size=1)) if draw(st.integers(0, 3)) == 0 else []
    floor = naive.Floor(graph, hold, draw(st.integers(0, 1)) if hold else 0, frozenset(blocked))
    legal = draw(st.booleans())
    reservations = draw(walked(floor, draw(st.integers(1, 3)))) if legal else draw(scattered(floor))
    costs = draw(costs_of(graph))
    return Ground(floor, costs, FloorSearch(graph, costs), reservations)


@st.composite
def requests(draw: st.DrawFn, ground: Ground) -> Ask | None:
    """A request for one more vehicle: from where it can be, through one to three goals; None when it can be nowhere."""
    tick = draw(st.integers(0, 4))
    places = ground.free_places(tick)
    if not places:
        return None
    graph = ground.graph
    place = draw(st.sampled_from(places))
    first, last = int(graph.place_ptr[place]), int(graph.place_ptr[place + 1])
    state = draw(st.integers(first, last - 1))
    n = draw(st.integers(1, 3))
    legs = [
        Leg(draw(st.integers(0, graph.n_places - 1)), draw(st.integers(0, 3)), Activity.PICK, draw(st.booleans()))
        for _ in range(n)
    ]
    legs[-1] = Leg(legs[-1].place, 0, Activity.REST, legs[-1].loaded)
    return Ask(state, tick, draw(st.integers(0, 1)), tuple(legs))


# ---------------------------------------------------------------- scenarios

HALL = """
I....O
.R..R.
......
.P..C.
"""
"""Open aisles all round, a few spurs."""

LOOP = """
#I##O##R#
..<<<<<<.
.>>>>>>..
#C#C#C#P#
"""
"""Two one-way lanes with everything beside them."""


def scenario_text(rows: str, count: int, **sections: Any) -> str:
    """TOML of a small scenario; `sections` are lines by table, as in `motion="turn_ticks = 2"`."""
    tables = {
        "time": 'finish = "never"',
        "battery": 'model = "coulomb"\ncapacity_wh = 50.0',
        "charger": "power_w = 2000.0",
        "service": "pick_s = 2.0\ndrop_s = 2.0",
        "orders": 'source = "poisson"\nrate_per_h = 400.0\nmix = [{ from = "station", to = "station", weight = 1.0 }]',
        **{k: v for k, v in sections.items() if k not in ("floor", "fleet", "seed")},
    }
    text = f'name = "test"\ntitle = "Test"\nseed = {sections.get("seed", 1)}\n'
    text += f'[floor]\nrows = """\n{rows.strip()}\n"""\n{sections.get("floor", "")}\n'
    text += f"[fleet]\ncount = {count}\n{sections.get('fleet', '')}\n"
    return text + "".join(f"[{name}]\n{lines}\n" for name, lines in tables.items())


def falling_battery(capacity_wh: float, voltage_v: float, *, knee: float = 0.8, taper_w: float = 20.0) -> Battery:
    """A third battery: its voltage falls with the charge, and beyond `knee` it accepts less and less power."""
    soc = np.arange(battery.POINTS) / (battery.POINTS - 1)
    voltage_mv = np.rint(1000 * voltage_v * (0.8 + 0.3 * soc - 0.15 * np.exp(-25 * soc))).astype(np.int64)
    accept_w = np.where(soc < knee, 600.0, taper_w + (600.0 - taper_w) * np.clip((1 - soc) / (1 - knee), 0, 1))
    return Battery(round(capacity_wh * 3600 * 1000 / voltage_v), voltage_mv, accept_w)
