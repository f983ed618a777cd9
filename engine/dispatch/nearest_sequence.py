"""The rule of Wang et al. 2019: every vehicle takes the order that it reaches soonest, and brings it to the nearest
exit.

Source: Wang et al. 2019, section 3. A greedy rule: it happens to be optimal for the paper's case, and is not in
general. Vehicles choose in the order of their numbers; an order's age counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from engine.dispatch.ahead import work_of
from engine.dispatch.base import NOBODY_FREE, Assignment, ChargingPolicy, FloorView, Refusal
from engine.dispatch.nearest import Nearest


@dataclass(frozen=True)
class NearestSequence:
    """look: how many of the oldest open orders a vehicle may choose from."""

    charging: ChargingPolicy
    look: int = 50

    def assign(self, view: FloorView, free: list[int]) -> tuple[list[Assignment], list[Refusal]]:
        """See Dispatcher."""
        looked = view.waiting[: self.look]
        if not free:
            return [], [Refusal(o, NOBODY_FREE) for o in looked]
        left = [o for o in looked if view.targets(o)]
        why = {o: "its station is blocked" for o in looked if o not in left}
        work, targets = work_of(view, free, left)
        row = {o: i for i, o in enumerate(left)}
        nearest = Nearest(self.charging)
        out: list[Assignment] = []
        taken: set[int] = set()
        for r, v in enumerate(free):
            soonest = sorted((int(work.first[r, row[o]]), o) for o in left if work.may[r, row[o]])
            for _, order in soonest:
                target = targets[int(work.carry[row[order]].argmin())]
                found = nearest.choose(view, order, [v], taken, target)
                if isinstance(found, Refusal):
                    why[order] = found.reason
                    continue
                out.append(Assignment(order, v, found.rests, target))
                taken.add(found.rests[0])
                left.remove(order)
                break
        return out, [Refusal(o, why.get(o, NOBODY_FREE)) for o in looked if o in left or o not in row]
