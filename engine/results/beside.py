"""A second demand model's energy of a run, worked out from its motions: information only, no battery feels it."""

from __future__ import annotations

import numpy as np

from engine.energy import CostTable
from engine.results.runlog import Log
from engine.types import COMPONENTS, PRIMITIVE_0, Component


def energy_beside(reader: Log, costs: CostTable, vehicles: int, until: float) -> dict[str, float]:
    """Energy in J by component of the motions that ended by a tick, with standby for all vehicles; zeros left out.

    costs: a row per vehicle, or of several vehicles in turn.
    """
    m = reader.table("motions")
    drove = (m["kind"] >= PRIMITIVE_0) & (m["t1"] <= until)
    rows, _, kinds, components = costs.mj.shape
    of_row = m["vehicle"][drove].astype(np.int64) % rows
    cell = (of_row * 2 + m["loaded"][drove]) * kinds + m["kind"][drove] - PRIMITIVE_0
    counts = np.bincount(cell, minlength=rows * 2 * kinds)
    mj = (costs.mj.reshape(-1, components) * counts[:, None]).sum(axis=0)
    mj[Component.STANDBY] += int(costs.standby_mj[0]) * vehicles * int(until)
    return {name: int(x) / 1000.0 for name, x in zip(COMPONENTS, mj, strict=True) if x}
