"""Time windows: everybody's EEA* route first, then, in order, later vehicles wait for earlier ones.

Source: the comparison method [15] of Xu & Wang 2025, reconstructed. A vehicle keeps its route and inserts the waits
that cost least; when no waits help it is planned anew around the earlier ones. Legal; neither complete nor optimal.
When not even that finds a way, the vehicle is moved to the front of the order, and timing begins again. Cost: one
search per vehicle, and one pass over (position, tick) of its route.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.planners.eea import Eea
from engine.planners.kernels import spacetime
from engine.planners.one_shot_prioritized import Desk
from engine.planners.oneshot import Limits, Problem, Solution, at_once
from engine.types import PlanStatus

I32 = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class TimeWindow:
    """mend: how often timing may begin again with the vehicle that found no way in front."""

    mend: int = 100

    promise = at_once(
        "everybody's cheapest route, later vehicles wait for earlier ones", objectives=("energy",), turnings=("arc",)
    )

    def solve(self, problem: Problem, limits: Limits, *, trace: bool = False) -> Solution:
        """A plan by energy; the lower bound is what every vehicle would need alone. Trace: table `vehicles` with how
        each was timed (0 as it was, 1 by waits, 2 anew) and its mJ alone and now.
        """
        desk = Desk(problem)
        n, shift = len(problem.starts), desk.floor.net.shift
        routes: list[I32] = []
        alone = np.zeros(n, np.int64)
        low = 0
        eea = Eea()
        for a, (s, goal) in enumerate(zip(problem.starts.tolist(), problem.goals.tolist(), strict=True)):
            if limits.stop():
                return desk.none(PlanStatus.BUDGET_SPENT, "time ran out", low=low)
            heading = s % desk.floor.per_place // 2
            found = eea.search(desk.floor, s >> shift, goal, cls=int(problem.cls[a]), heading=heading)
            low += found.expanded
            if found.status is not PlanStatus.SOLVED:
                return desk.none(PlanStatus.NO_PATH, f"vehicle {a} can't reach its goal", low=low)
            routes.append(found.states)
            alone[a] = found.cost
        order = np.arange(n)
        for tried in range(1, self.mend + 2):
            if limits.stop() or low >= limits.expansions:
                break
            states: list[I32] = [np.zeros(0, np.int32)] * n
            mj, how = np.zeros(n, np.int64), np.zeros(n, np.int8)
            failed = -1
            for a in order.tolist():
                if limits.stop():
                    return desk.none(PlanStatus.BUDGET_SPENT, "time ran out", int(alone.sum()), low=low)
                states[a], mj[a], how[a], expanded = self._timed(
                    desk, a, routes[a], int(alone[a]), limits.expansions - low
                )
                low += expanded
                if mj[a] < 0:
                    failed = a
                    break
                desk.take(a, states[a], states)
            desk.forget([s for a, s in enumerate(states) if a != failed])
            if failed < 0:
                columns: dict[str, NDArray[Any]] = {"how": how, "alone_mj": alone, "mj": mj} if trace else {}
                note = f"{int((how == 1).sum())} vehicles wait, {int((how == 2).sum())} were planned anew"
                return Solution(
                    PlanStatus.SOLVED, tuple(states), int(mj.sum()), int(alone.sum()), tried, low, note,
                    {"vehicles": columns} if trace else {},
                )  # fmt: skip
            order = np.concatenate([[failed], order[order != failed]])
        return desk.none(PlanStatus.BUDGET_SPENT, "no order brings everybody to the goal", int(alone.sum()), low=low)

    def _timed(self, desk: Desk, vehicle: int, route: I32, alone: int, limit: int) -> tuple[I32, int, int, int]:
        """(states, mJ or -1, how, work) of one vehicle among the ways taken."""
        p = desk.problem
        cls = int(p.cls[vehicle])
        room, out = np.zeros(desk.ticks + len(route) + 4, np.int32), np.zeros(4, np.int64)
        status = spacetime.waits_on(
            desk.floor.net, desk.taken, p.blocked, route, desk.mj[cls], int(p.costs.standby_mj[cls]), room, out
        )
        if status == spacetime.SOLVED:
            return room[: out[0]].copy(), int(out[2]), int(out[2] > alone), int(out[1])
        found, mj, expanded = desk.cheapest(vehicle, limit)
        return found, mj, 2, int(out[1]) + expanded
