"""Charging by levels: critical, good, sufficient, full (the words of openTCS).

Below `good` a vehicle without an order goes charging and takes no order until it is `sufficient`; it charges to
`full`. When every charger is taken it queues, and an idle vehicle that has enough makes room.
"""

from __future__ import annotations

from dataclasses import dataclass

from engine.dispatch.base import FloorView, Move
from engine.types import NONE


@dataclass(frozen=True)
class Levels:
    """The thresholds themselves are state (an operator may change them): they come with the view."""

    def rests_after(self, view: FloorView, vehicle: int, place: int, mj_left: int) -> list[int]:
        """A charger when it will be below `good` then; else where idle vehicles stand."""
        chargers = view.chargers
        low = mj_left < view.levels["good"] * view.capacity_mj[vehicle]
        plenty = chargers >= len(view.home)
        if low or plenty:
            found = view.nearest_rest(vehicle, place, chargers_only=True)
            if found or (low and chargers):
                return found  # nobody starts what would leave it queueing with the little that is left
            return view.nearest_rest(vehicle, place, chargers_only=False)
        parking = [
            r for r in view.nearest_rest(vehicle, place, chargers_only=False, count=12) if not view.is_charger[r]
        ]
        return parking[:3] or view.nearest_rest(vehicle, place, chargers_only=False)

    def moves(self, view: FloorView, idle: list[int]) -> tuple[list[Move], list[int]]:
        """See ChargingPolicy."""
        out: list[Move] = []
        queue: list[int] = []
        taken: set[int] = set()
        graph = view.search.graph
        for v in sorted(idle, key=lambda v: (view.charge_mj[v] / view.capacity_mj[v], v)):
            here = int(graph.state_place[view.at[v]])
            home = int(view.home[v])
            if view.must_charge[v]:
                if home != NONE and view.is_charger[home]:
                    continue
                found = [r for r in view.nearest_rest(v, here, chargers_only=True) if r not in taken]
                if found:
                    taken.add(found[0])
                    out.append(Move(v, tuple(found), True))
                else:
                    queue.append(v)
            elif home == NONE or not view.is_rest[home] or view.blocked[home]:
                found = [r for r in self.rests_after(view, v, here, int(view.charge_mj[v])) if r not in taken]
                if found:
                    taken.add(found[0])
                    out.append(Move(v, tuple(found), False))
        if queue:
            out += self.make_room(view, idle, len(queue), taken)
        return out, queue

    def make_room(self, view: FloorView, idle: list[int], wanted: int, taken: set[int]) -> list[Move]:
        """Idle vehicles that have enough leave their chargers to those that queue, the fullest first."""
        out: list[Move] = []
        able = [v for v in idle if not view.must_charge[v] and view.home[v] != NONE and view.is_charger[view.home[v]]]
        for v in sorted(able, key=lambda v: (-view.soc(v), v))[:wanted]:
            away = [
                r
                for r in view.nearest_rest(v, int(view.home[v]), chargers_only=False, count=12)
                if not view.is_charger[r] and r not in taken
            ]
            if away:
                taken.add(away[0])
                out.append(Move(v, tuple(away[:3]), False))
        return out
