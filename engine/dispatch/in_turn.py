"""Orders in turn to the free vehicle of the lowest number, wherever it stands and however little charge it has.

Source: the Soochow thesis 2022, in which the tasks of a list go to the idle vehicles one by one, and the charge is
looked at after a task only.
"""

from __future__ import annotations

from dataclasses import dataclass

from engine.dispatch.base import NOBODY_FREE, Assignment, ChargingPolicy, FloorView, Refusal


@dataclass(frozen=True)
class InTurn:
    """No parameters."""

    charging: ChargingPolicy

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher."""
        left = sorted(free)
        out: list[Assignment] = []
        refused: list[Refusal] = []
        taken: set[int] = set()
        for order in view.waiting:
            a, b = view.orders.from_place[order], view.orders.to_place[order]
            if not left:
                refused.append(Refusal(order, NOBODY_FREE))
            elif view.blocked[a] or view.blocked[b]:
                refused.append(Refusal(order, "its station is blocked"))
            else:
                v = left[0]
                here = int(view.search.graph.place_ptr[a])
                need = view.need_mj(int(view.at[v]), a, False) + view.need_mj(here, b, True)
                spare = int(view.charge_mj[v]) - need
                rests = [r for r in self.charging.rests_after(view, v, b, spare) if r not in taken]
                if rests:
                    out.append(Assignment(order, v, tuple(rests)))
                    taken.add(rests[0])
                    left.pop(0)
                else:
                    refused.append(Refusal(order, "no rest place is free"))
        return out, refused
