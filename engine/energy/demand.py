"""From motion to joules: the contract of a demand model, and the integer cost table that everything reads.

A demand model knows motion primitives (length, turn, start) and mass; it knows no cell, no tick and no order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from engine.errors import ScenarioError, unknown_name
from engine.types import Component
from engine.units import mj_from_j
from engine.world.motion_graph import Primitive


class DemandModel(Protocol):
    """Energy drawn at the battery terminals by one vehicle class."""

    @property
    def standby_w(self) -> float:
        """Power drawn all the time, also while standing."""
        ...

    def joules(self, primitive: Primitive, mass_kg: float, duration_s: float) -> Mapping[Component, float]:
        """Energy of one primitive in joules by component, standby excluded."""
        ...


@dataclass(frozen=True, slots=True)
class CostTable:
    """Integer costs of flat motion: classes V, load buckets 2 (empty, loaded), kinds K, components C.

    mj: (V, 2, K, C) millijoules, each rounded once, half to even · total_mj: (V, 2, K) their sums
    · standby_mj: (V,) per tick.
    """

    mj: NDArray[np.int64]
    total_mj: NDArray[np.int64]
    standby_mj: NDArray[np.int64]


def cost_table(
    primitives: Sequence[Primitive],
    model: DemandModel,
    masses_kg: Sequence[tuple[float, float]],
    tick_s: float,
) -> CostTable:
    """Cost table of a model for vehicle classes given as (empty mass, payload) in kilograms."""
    mj = np.zeros((len(masses_kg), 2, len(primitives), len(Component)), np.int64)
    for c, (empty, payload) in enumerate(masses_kg):
        for load, mass in enumerate((empty, empty + payload)):
            for k, primitive in enumerate(primitives):
                for component, joules in model.joules(primitive, mass, primitive.ticks * tick_s).items():
                    mj[c, load, k, component] = mj_from_j(joules)
    standby = np.full(len(masses_kg), mj_from_j(model.standby_w * tick_s), np.int64)
    return CostTable(mj, mj.sum(axis=3), standby)


def parameters_over(defaults: Mapping[str, float], given: Mapping[str, float], model: str) -> dict[str, float]:
    """Defaults overridden by given numbers; raises ScenarioError on an unknown name."""
    for name in given:
        if name not in defaults:
            raise ScenarioError(unknown_name(f"parameter of energy model {model!r}", name, defaults))
    return {**defaults, **given}
