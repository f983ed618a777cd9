"""Free vehicles and open orders matched so that the sum of the ways to the orders is least.

Source: Kuhn 1955; solved by scipy's `linear_sum_assignment`. Optimal for one order per vehicle, blind to what comes
after. Of more orders than vehicles the nearest are taken first, so only the oldest `look` orders compete.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.dispatch.ahead import work_of
from engine.dispatch.base import NOBODY_FREE, Assignment, ChargingPolicy, FloorView, Refusal
from engine.dispatch.nearest import Nearest
from engine.dispatch.schedule import BARRED


@dataclass(frozen=True)
class Hungarian:
    """look: how many of the oldest open orders are matched at a time."""

    charging: ChargingPolicy
    look: int = 50

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher. A pair that the battery doesn't allow is barred, and the rest matched anew."""
        from scipy.optimize import linear_sum_assignment

        looked = view.waiting[: self.look]
        if not free:
            return [], [Refusal(o, NOBODY_FREE) for o in looked]
        orders = [o for o in looked if view.targets(o)]
        why = {o: "its station is blocked" for o in looked if o not in orders}
        work, targets = work_of(view, free, orders)
        cost = np.where(work.may, work.first, BARRED)
        nearest = Nearest(self.charging)
        found: dict[int, Assignment] = {}
        taken: set[int] = set()
        while True:
            rows = [r for r in range(len(free)) if r not in found]
            columns = [i for i, o in enumerate(orders) if all(a.order != o for a in found.values())]
            matched = linear_sum_assignment(cost[np.ix_(rows, columns)])
            pairs = [(rows[r], columns[i]) for r, i in zip(*(m.tolist() for m in matched), strict=True)]
            pairs = [(r, i) for r, i in pairs if cost[r, i] < BARRED]
            barred = False
            for r, i in pairs:
                target = targets[int(work.carry[i].argmin())]
                one = nearest.choose(view, orders[i], [free[r]], taken, target)
                if isinstance(one, Refusal):
                    cost[r, i] = BARRED
                    why[orders[i]] = one.reason
                    barred = True
                    continue
                found[r] = Assignment(one.order, one.vehicle, one.rests, target)
                taken.add(one.rests[0])
            if not barred:
                break
        given = {a.order for a in found.values()}
        return [found[r] for r in sorted(found)], [
            Refusal(o, why.get(o, NOBODY_FREE)) for o in looked if o not in given
        ]
