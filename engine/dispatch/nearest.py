"""Nearest available vehicle first, orders in the order of their age, with a check that the battery lasts.

An order goes to the free vehicle that reaches its first station soonest on an empty floor, among those whose charge
covers the way there, the carriage, the way to a rest place and to a charger, and the reserve.
"""

from __future__ import annotations

from dataclasses import dataclass

from engine.dispatch.base import NOBODY_FREE, SAFETY, Assignment, ChargingPolicy, FloorView, Refusal
from engine.planners.base import NO_WAY
from engine.types import NONE


@dataclass(frozen=True)
class Nearest:
    """look: how many of the oldest open orders are considered at a time."""

    charging: ChargingPolicy
    look: int = 50

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher."""
        left = list(free)
        out: list[Assignment] = []
        refused: list[Refusal] = []
        taken: set[int] = set()
        looked = view.waiting[: self.look]
        for i, order in enumerate(looked):
            if not left:
                refused += [Refusal(o, NOBODY_FREE) for o in looked[i:]]
                break
            found = self.choose(view, order, left, taken)
            if isinstance(found, Refusal):
                refused.append(found)
                continue
            out.append(found)
            taken.add(found.rests[0])
            left.remove(found.vehicle)
        return out, refused

    def choose(
        self, view: FloorView, order: int, left: list[int], taken: set[int], target: int = NONE
    ) -> Assignment | Refusal:
        """The nearest of the vehicles left that can carry an order, to a target or its own; or why none can."""
        a = view.orders.from_place[order]
        b = view.orders.to_place[order] if target == NONE else target
        if view.blocked[a] or view.blocked[b]:
            return Refusal(order, "its station is blocked")
        near = sorted(zip(view.search.ticks_from(a, view.at[left]).tolist(), left, strict=True))
        reason = "no vehicle can reach its station"
        for ticks, v in near:
            if not view.may_take(v, order):
                reason = "no vehicle of its region is free"
                continue
            if ticks >= NO_WAY:
                break
            spare = int(view.charge_mj[v] - view.levels["reserve"] * view.capacity_mj[v]) - self.need(view, v, a, b)
            if spare < 0:
                reason = "no free vehicle has enough charge for it"
                continue
            rests = [r for r in self.charging.rests_after(view, v, b, spare) if r not in taken]
            if rests:
                return Assignment(order, v, tuple(rests))
            reason = "no rest place is free"
        return Refusal(order, reason)

    def need(self, view: FloorView, v: int, a: int, b: int) -> int:
        """Energy in mJ for an order from place a to place b and on to the nearest charger."""
        graph = view.search.graph
        need = view.need_mj(int(view.at[v]), a, False)
        need += view.need_mj(int(graph.place_ptr[a]), b, True)
        need += sum(view.service_ticks) * view.standby_mj
        return int((need + view.to_charger_mj(b)) * SAFETY)
