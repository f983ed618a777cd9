"""The contracts of planners and routers: what they are asked, what they see, what they answer.

A planner is a frozen value whose fields are its parameters. `init` makes its memory (named arrays and plain values);
`plan` reads a View and returns a Plan and the memory. It never writes what it is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from engine.energy import CostTable
from engine.traffic import Claims
from engine.types import Activity, Occupancy, PlanStatus
from engine.world.motion_graph import MotionGraph

I32 = NDArray[np.int32]
Memory = dict[str, Any]
"""Named arrays and plain values that a planner keeps from call to call; saved in checkpoints without pickle."""


NO_WAY = 2**21
"""Ticks that stand for 'unreachable'."""


class Rows(Protocol):
    """Backward tables: row `slot(goal)` of `pool` holds the cost of every pose (or state) to a goal place."""

    costs: NDArray[np.int64]
    pool: NDArray[np.int64]
    shift: int  # 1: over poses, state s in column s >> 1; 0: over states

    def slot(self, goal: int, keep: frozenset[int] | set[int] = frozenset()) -> int:
        """Row of a goal, computed when absent."""
        ...


class Search(Protocol):
    """What a run shares among its deciders: exact costs on the empty floor, and one vehicle's search among all."""

    graph: MotionGraph
    restart_mj: int  # most that a stop and a new start can add to a motion
    room: dict[str, Any]  # space that searches leave to their next call; nothing depends on what is in it

    @property
    def time(self) -> Rows:
        """Tables by time."""
        ...

    def ticks_to(self, goal: int, state: int) -> int:
        """Ticks from a state to a place on an empty floor; at least NO_WAY when there is no way."""
        ...

    def ticks_from(self, goal: int, states: I32) -> NDArray[np.int64]:
        """The same for many states at once."""
        ...

    def energy_to(self, goal: int, state: int) -> int:
        """mJ of that way for the least class, empty and rolling, standby included."""
        ...

    def by_edge(self, name: str, version: int, costs: NDArray[np.int64]) -> Rows:
        """Backward tables over poses with a cost per edge (E,), kept under a name until its version changes."""
        ...

    def through(self, view: View, objective: str, budget: Budget, within: float = 1.0) -> Plan:
        """The best plan for the view's request against its reservations, by `time` or `energy`.

        within: by time, how many times longer than the best it may take, in eighths.
        """
        ...


class Leg(NamedTuple):
    """One goal of a request: a place, and how long the vehicle stays there (the last stay is forever)."""

    place: int
    stay_ticks: int
    what: Activity
    loaded: bool  # while driving to it


class Request(NamedTuple):
    """Plan for one vehicle from a motion state at a tick through all legs.

    gap: the claim behind which the vehicle stands (its own claims are not in the table) · cls: vehicle class.
    """

    vehicle: int
    state: int
    gap: int
    tick: int
    cls: int
    legs: tuple[Leg, ...]


class View(NamedTuple):
    """What a planner may read: aliases of the simulation's arrays, not to be kept or written."""

    graph: MotionGraph
    occupancy: Occupancy
    margin_ticks: int
    costs: CostTable
    claims: Claims
    blocked: NDArray[np.uint8]  # (P,) of the overlay
    blocked_version: int
    search: Search  # backward tables and search space, shared by a run
    request: Request


class Plan(NamedTuple):
    """Timed motions of one vehicle: (n,) edges (-2 for a stay), Activity of stays, start and end ticks.

    energy_mj: standby included · bound: proven lower bound of the objective, or None.
    """

    status: PlanStatus
    edges: I32
    what: NDArray[np.int8]
    starts: I32
    ends: I32
    energy_mj: int = 0
    expanded: int = 0
    note: str = ""

    @property
    def found(self) -> bool:
        return self.status in (PlanStatus.SOLVED, PlanStatus.BOUNDED)


def no_plan(status: PlanStatus, expanded: int = 0, note: str = "") -> Plan:
    """An answer without motions."""
    none = np.zeros(0, np.int32)
    return Plan(status, none, np.zeros(0, np.int8), none, none, 0, expanded, note)


@dataclass(frozen=True, slots=True)
class Budget:
    """How much work one call may do."""

    expansions: int = 2_000_000


@dataclass(frozen=True, slots=True)
class Promise:
    """What a planner serves and guarantees; menus offer only what fits.

    mode: `lifelong` answers one vehicle's request at a time, `one-shot` plans all vehicles to their goals at once
    · connectivity: neighbours of a cell · turnings: of `motion.turning` · unit: needs motions of one tick each
    · cells: needs a floor of cells, not a network.
    """

    summary: str
    legal: bool = True
    complete: bool = False
    optimal: str = ""
    occupancies: frozenset[Occupancy] = frozenset(Occupancy)
    objectives: tuple[str, ...] = ("time",)
    mode: frozenset[str] = frozenset({"lifelong"})
    connectivity: frozenset[int] = frozenset({4, 8})
    turnings: frozenset[str] = frozenset({"arc", "pivot"})
    unit: bool = False
    cells: bool = False


@dataclass(frozen=True, slots=True)
class Observed:
    """What arcs took during one period, by place (P,): number of visits, and their ticks summed."""

    samples: NDArray[np.int64]
    total_ticks: NDArray[np.int64]
    tick_s: float


@dataclass(frozen=True, slots=True)
class Route:
    """A way over a lattice. states: (n + 1,) from the start to the goal · ks: (n,) trajectories · cost: their sum
    · bound: it costs at most so many times the least · expanded: states since the search was made."""

    status: PlanStatus
    states: I32
    ks: I32
    cost: int
    bound: float
    expanded: int

    @property
    def found(self) -> bool:
        return self.status in (PlanStatus.SOLVED, PlanStatus.BOUNDED)


class AnytimeSearch(Protocol):
    """A search to one goal that goes on while its robot drives and its costs change."""

    @property
    def optimal(self) -> bool:
        """True when there is nothing left to do until something changes."""
        ...

    @property
    def epsilon(self) -> float:
        """How many times the least the way of the present pass may cost."""
        ...

    @property
    def expanded(self) -> int:
        """States expanded since the beginning."""
        ...

    def frontier(self) -> tuple[I32, I32]:
        """States that wait to be expanded, in this pass and in the next one."""
        ...

    def work(self, budget: int) -> Route | None:
        """Expand at most so many states; a way when a pass is done with that."""
        ...

    def move(self, start: int) -> None:
        """The robot plans from another state."""
        ...

    def changed(self, states: I32, heights: bool = False, epsilon: float | None = None) -> None:
        """Costs from these states, or the heights of their cells, have changed; heights: so may all have."""
        ...

    def retarget(self, goal_cell: int) -> None:
        """Plan to another cell."""
        ...

    def to_memory(self) -> Memory:
        """Named arrays from which `restore` goes on."""
        ...

    def restore(self, memory: Memory) -> None:
        """Undo `to_memory`."""
        ...


class Planner(Protocol):
    """Decides where and when."""

    promise: Promise

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Memory for a run."""
        ...

    def plan(self, view: View, memory: Memory, budget: Budget) -> tuple[Plan, Memory]:
        """Answer the view's request."""
        ...


@runtime_checkable
class Learner(Protocol):
    """A planner or router that learns from what arcs took; its memory then has `expected_ms` (P,)."""

    refresh_s: float

    def learn(self, observed: Observed, memory: Memory) -> Memory:
        """Called at the beginning, with nothing observed, and then after every period."""
        ...


class Router(Protocol):
    """Decides where, not when: the shared timer of `traffic` schedules its routes."""

    promise: Promise

    def init(self, graph: MotionGraph, costs: CostTable, rng: np.random.Generator) -> Memory:
        """Memory for a run."""
        ...

    def route(self, view: View, memory: Memory) -> tuple[Sequence[I32], Memory]:
        """For every leg of the view's request the edges from the previous goal, or an empty sequence for no way."""
        ...


@runtime_checkable
class Compared(Protocol):
    """A router in whose results other methods stand beside it."""

    def beside(self, floor: Any) -> Mapping[str, Callable[[int, int, int], I32]]:
        """Who answers the same queries on a `single.Floor`: name → (start, goal, seed) → places, empty without a way.

        The router itself comes first, and last one that is exact.
        """
        ...


KINDS: Mapping[type, tuple[str, Callable[[Any], bool]]] = {
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a whole number", lambda value: not isinstance(value, bool) and isinstance(value, int)),
    float: ("a number", lambda value: not isinstance(value, bool) and isinstance(value, int | float)),
    str: ("a text", lambda value: isinstance(value, str)),
}
"""What a parameter must be, by the type of its default."""


def configured(cls: type, parameters: Mapping[str, object], name: str = "") -> Any:
    """An instance of a frozen planner dataclass with these parameters. Raises ScenarioError on unknown names and on
    values of another type. name: of the planner, as a person writes it.
    """
    from dataclasses import fields

    from engine.errors import ScenarioError, unknown_name

    whose = name or cls.__name__
    known = {f.name: f for f in fields(cls)}
    for key, value in parameters.items():
        if key not in known:
            raise ScenarioError(unknown_name(f"parameter of {whose}", key, known))
        expected, fits = KINDS.get(type(known[key].default), ("", lambda value: True))
        if not fits(value):
            raise ScenarioError(f"{whose}: {key}: got {value!r}, expected {expected}")
    try:
        return cls(**parameters)
    except (TypeError, ValueError) as why:
        raise ScenarioError(f"{whose}: {why}") from why
