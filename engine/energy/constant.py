"""Demand model of the Soochow thesis 2022: a fixed share of the battery per second while running."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from engine.types import Component
from engine.world.motion_graph import Primitive


@dataclass(frozen=True, slots=True)
class Constant:
    """running_w: power while running, chosen so that the thesis's percent per second leave the battery."""

    running_w: float
    standby_w: float = 0.0

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Running power times the primitive's duration, whatever it does."""
        return {Component.RUNNING: self.running_w * duration_s}
