"""The one structure that every world compiles to and every planner searches.

States hold whatever the cost of the next motion depends on: place, heading, moving or stopped. Edges are motion
primitives. Waiting is implicit: at every state a vehicle may stand any number of ticks and is then in
`stopped[state]`. Immutable; what changes while running lives in the Overlay.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

I8 = NDArray[np.int8]
I32 = NDArray[np.int32]
F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Primitive:
    """One kind of motion: what its time and energy depend on.

    name: field's word, unique in a graph · length_mm: distance driven, not rounded (energy is computed from it)
    · turn_deg: change of heading, 0…180 · starts: begins from standstill · pivot: turns on the spot · ticks: duration.
    """

    name: str
    length_mm: float
    turn_deg: int
    starts: bool
    pivot: bool
    ticks: int


@dataclass(frozen=True, slots=True)
class MotionGraph:
    """CSR arrays over motion states; P places, S states, E edges.

    The states of place p are place_ptr[p]:place_ptr[p+1]; the edges leaving state s are edge_ptr[s]:edge_ptr[s+1].
    """

    xy_m: F32  # (P, 2) centre of each place
    place_ptr: I32  # (P+1,)
    state_place: I32  # (S,)
    state_heading: I8  # (S,) index into heading_deg
    state_moving: I8  # (S,) 1 when the vehicle rolls, 0 when it stands
    stopped: I32  # (S,) the state after standing still here
    edge_ptr: I32  # (S+1,)
    edge_from: I32  # (E,)
    edge_to: I32  # (E,)
    edge_kind: I8  # (E,) index into primitives
    edge_twin: I32  # (E,) same motion from the other moving flag; itself when there is none
    sweep_ptr: I32  # (E+1,) further places an edge passes over (corners of a diagonal)
    sweep: I32
    rev_ptr: I32  # (S+1,) edges entering a state
    rev_edge: I32  # (E,)
    arc_ticks: I32  # (P,) ticks of driving along a place that is an arc of the ways; 0 where it is none
    heading_deg: tuple[float, ...]
    primitives: tuple[Primitive, ...]
    kind_ticks: I32 = field(repr=False)  # (K,)
    kind_mm: I32 = field(repr=False)  # (K,) distance in whole millimetres

    @property
    def n_places(self) -> int:
        return len(self.place_ptr) - 1

    @property
    def n_states(self) -> int:
        return len(self.state_place)

    @property
    def n_edges(self) -> int:
        return len(self.edge_to)

    @property
    def unit(self) -> bool:
        """True when every motion lasts one tick (what classical MAPF and CBS need)."""
        return bool((self.kind_ticks == 1).all())

    def state(self, place: int, heading: int, moving: int = 0) -> int:
        """The state at a place with a heading index; raises KeyError when the place has none such."""
        for s in range(int(self.place_ptr[place]), int(self.place_ptr[place + 1])):
            if self.state_heading[s] == heading and self.state_moving[s] == moving:
                return s
        raise KeyError((place, heading, moving))
