"""Every vehicle rests at its own goal: the policy of runs without orders, where each vehicle has a place to go."""

from __future__ import annotations

from dataclasses import dataclass

from engine.dispatch.base import FloorView, Move


@dataclass(frozen=True)
class ToGoals:
    """goals: a place per vehicle. Charging is left to chance: vehicles that rest on chargers charge."""

    goals: tuple[int, ...]

    def rests_after(self, view: FloorView, vehicle: int, place: int, mj_left: int) -> list[int]:
        """The vehicle's goal."""
        return [self.goals[vehicle]]

    def moves(self, view: FloorView, idle: list[int]) -> tuple[list[Move], list[int]]:
        """Whoever rests elsewhere goes to its goal."""
        return [Move(v, (self.goals[v],), False) for v in idle if view.home[v] != self.goals[v]], []
