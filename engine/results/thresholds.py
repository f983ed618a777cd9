"""Charge levels in force: the scenario's, until an operator changes them."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

from engine.results.runlog import Columns
from engine.scenario import Scenario


class Thresholds(NamedTuple):
    """States of charge in [0, 1]; see the scenario's section `charging`."""

    critical: float
    good: float
    sufficient: float
    full: float
    reserve: float


def thresholds_at(scenario: Scenario, commands: Columns, time: float) -> Thresholds:
    """Levels at a time in ticks, after the accepted `thresholds` commands up to it."""
    asked = scenario.charging
    levels = Thresholds(asked.critical, asked.good, asked.sufficient, asked.full, asked.reserve)
    until = int(np.searchsorted(commands["tick"], time, side="right"))
    for text, accepted in zip(commands["command"][:until], commands["accepted"][:until], strict=True):
        if accepted and '"thresholds"' in text:
            command = json.loads(text)
            levels = levels._replace(**{k: float(v) for k, v in command.items() if k in Thresholds._fields})
    return levels
