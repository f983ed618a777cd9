"""Ant colonies as routers: the improved ant system of the Soochow thesis 2022, and the classic one beside it.

The thesis's three changes: an ant follows the largest p_ij with probability 1 − ε0 and draws by p_ij otherwise · the
inducement is η_j = 1 / f(j) with A*'s estimate f = step + Manhattan distance, stronger at first and weaker later · all
ants better than the median lay pheromone, not only the best. As printed, the time-varying inducement is a factor that
is the same for every j and so cancels in p_ij (`literal` equals `off`, choice by choice); `exponent` puts it where it
acts, β_eff = β (1−ξ)/ξ · (K−k)/K. Evaporation is global; τ keeps within bounds; an ant in a dead end goes back.

Promise: legal by the shared timer; no bound on the length. The shortest way is what A* finds, exactly and in less
time: every result shows it beside. Cost: iterations × (a power per step of the floor + ants × steps).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.errors import unknown_name
from engine.planners.astar import AStar
from engine.planners.base import Memory, Promise, View
from engine.planners.kernels import ants as kernels
from engine.planners.routes import edges_along, floor_of
from engine.planners.single import Floor
from engine.types import PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
F64 = NDArray[np.float64]

INDUCEMENTS = {"exponent": kernels.EXPONENT, "literal": kernels.LITERAL, "off": kernels.OFF}
RULES = ("improved", "classic")
MOST = 70.0
"""Largest exponent: beyond, τ^α η^β of a far place is no number any more."""
LIMITS = {
    "ants": (1, 1000), "iterations": (1, 10_000), "alpha": (0, 10), "beta": (0, 20), "rho": (0, 1), "explore": (0, 1),
    "q": (0, 1e6), "tau0": (1e-6, 1e6), "low": (1e-6, 1e6), "high": (1e-6, 1e6),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Colony:
    """What a colony found. places: of the best way, empty without one · counts by name · trace: columns per iteration
    when asked for (tau (K, P, D), way (K, P+1), best, shortest, mean, lost).
    """

    status: PlanStatus
    places: I32
    found_at: int
    lost: int
    choices: int
    exploited: int
    retreats: int
    trace: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Steps of the best way; -1 without one."""
        return len(self.places) - 1


@dataclass(frozen=True)
class Aco:
    """rule: `improved`, or `classic` (Euclidean inducement, roulette, only the best way lays pheromone) · inducement:
    `exponent`, `literal` or `off` · explore: ε0 · xi: ξ · tau0, low, high: pheromone at first, and its bounds.
    """

    rule: str = "improved"
    inducement: str = "exponent"
    ants: int = 30
    iterations: int = 40
    alpha: float = 1.0
    beta: float = 5.0
    rho: float = 0.2
    q: float = 100.0
    explore: float = 0.3
    xi: float = 0.3
    tau0: float = 1.0
    low: float = 0.05
    high: float = 8.0
    retreat: bool = True

    promise = Promise(
        summary="the best way of an ant colony on the empty floor, made safe by waiting",
        turnings=frozenset({"arc"}),
        cells=True,
    )

    def __post_init__(self) -> None:
        for what, name, known in (("rule", self.rule, RULES), ("inducement", self.inducement, INDUCEMENTS)):
            if name not in known:
                raise ValueError(unknown_name(what, name, known))
        for name, (low, high) in LIMITS.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must be from {low:g} to {high:g}; got {getattr(self, name)!r}")
        if not 0 < self.xi < 0.5:
            raise ValueError(f"xi must be more than 0 and less than 0.5; got {self.xi!r}")
        if self.low > self.high:
            raise ValueError(f"low must be at most high; got {self.low!r} and {self.high!r}")
        if self.inducement == "exponent" and self.beta * (1 - self.xi) / self.xi > MOST:
            raise ValueError(f"beta · (1 − xi) / xi must be at most {MOST:g}; got {self.beta!r} and {self.xi!r}")

    def rules(self) -> kernels.Rules:
        """The parameters as kernels take them."""
        improved = self.rule == "improved"
        kind = INDUCEMENTS[self.inducement] if improved else kernels.OFF
        return kernels.Rules(
            self.ants, self.iterations, float(self.alpha), float(self.beta), float(self.rho), float(self.q),
            float(self.explore) if improved else 1.0, float(self.xi), float(self.tau0), float(self.low),
            float(self.high), kind, improved, bool(self.retreat),
        )  # fmt: skip

    def eta(self, floor: Floor, goal: int) -> F64:
        """Inducement of every place, (P,)."""
        xy = floor.grounds.xy[:-1].astype(np.int64)
        dx, dy = np.abs((xy & 0xFFFF) - (xy[goal] & 0xFFFF)), np.abs((xy >> 16) - (xy[goal] >> 16))
        if self.rule == "improved":
            near: F64 = 1.0 / (1.0 + dx + dy)
            return near
        # at the goal 1/d would be infinite: half a cell stands for none
        straight: F64 = 1.0 / np.maximum(np.hypot(dx, dy), 0.5)
        return straight

    def search(
        self, floor: Floor, start: int, goal: int, seed: int = 0, *, closed: NDArray[np.uint8] | None = None,
        trace: bool = False, pheromone: bool = False,
    ) -> Colony:  # fmt: skip
        """The best way of one colony between two places.

        closed: places not to be entered, the floor's own blocks by default · trace, pheromone: keep columns of every
        iteration, and τ of every step.
        """
        step, rules = floor.grounds.step, self.rules()
        places, ways = len(step) - 1, step.shape[1]
        shut = floor.blocked if closed is None else closed
        if shut[start] or shut[goal]:
            return Colony(PlanStatus.NO_PATH, np.zeros(0, np.int32), 0, 0, 0, 0, 0)
        room = kernels.new_room(places, ways, self.ants)
        kept = kernels.new_ant_trace(self.iterations if trace or pheromone else 0, places if pheromone else 0, ways)
        out = np.zeros(6, np.int64)
        kernels.colony(step, shut, self.eta(floor, goal), start, goal, rules, seed % 2**62, room, kept, out)
        n = int(out[kernels.BEST])
        columns = {name: getattr(kept, name) for name in kept._fields if len(getattr(kept, name))}
        return Colony(
            PlanStatus.SOLVED if n >= 0 else PlanStatus.NO_PATH, room.best[: n + 1].copy(), int(out[kernels.AT]),
            int(out[kernels.LOST]), int(out[kernels.CHOICES]), int(out[kernels.EXPLOITED]),
            int(out[kernels.RETREATS]), columns,
        )  # fmt: skip

    def beside(self, floor: Floor) -> Mapping[str, Callable[[int, int, int], I32]]:
        """See Compared: these ants, the classic ones, and A*, whose ways are the shortest."""
        classic = replace(self, rule="classic")
        exact = AStar("manhattan" if floor.grounds.step.shape[1] == 4 else "octile")

        def shortest(start: int, goal: int, seed: int) -> I32:
            places: I32 = floor.graph.state_place[exact.search(floor, start, goal).states]
            return places

        return {
            "aco": lambda start, goal, seed: self.search(floor, start, goal, seed).places,
            "classic ant system": lambda start, goal, seed: classic.search(floor, start, goal, seed).places,
            "A*": shortest,
        }

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """The seed of the run's colonies, and how many there were."""
        return {"seed": int(rng.integers(2**40)), "colonies": 0}

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """See Router. A colony per leg; each has a seed of its own."""
        g, state, legs = view.graph, view.request.state, []
        for leg in view.request.legs:
            floor = floor_of(view, leg.loaded)
            memory = {**memory, "colonies": int(memory["colonies"]) + 1}
            found = self.search(floor, int(g.state_place[state]), leg.place, memory["seed"] + memory["colonies"])
            if found.status is not PlanStatus.SOLVED:
                return [], memory
            states = floor.along(found.places, int(state) & ~1)
            legs.append(edges_along(g, states))
            state = int(states[-1])
        return legs, memory
