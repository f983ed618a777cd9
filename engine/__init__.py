"""Wattlane's engine. Names in the order in which data flows, each loaded when first asked for.

`engine.build` puts a simulation together: build, resume, replay, swap.

>>> from engine import MemoryLog, judge
>>> from engine.build import build
>>> log = MemoryLog()
>>> sim = build("soochow2022", seed=1, recorder=log)
>>> sim.advance(3600); sim.flush()
>>> judge(log, sim.scenario, sim.world)
[]
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_WHERE: dict[str, str] = {
    "Scenario": "engine.scenario",
    "library": "engine.scenario",
    "load": "engine.scenario",
    "parse": "engine.scenario",
    "World": "engine.world",
    "build_world": "engine.world",
    "MotionGraph": "engine.world.motion_graph",
    "Simulation": "engine.sim.simulation",
    "judge": "engine.sim.judge",
    "judge_plan": "engine.sim.judge",
    "RunLogWriter": "engine.results.runlog",
    "MemoryLog": "engine.results.runlog",
    "LogReader": "engine.results.runlog",
    "RunView": "engine.results.view",
    "metrics": "engine.results.metrics",
}

__all__ = list(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'engine' has no attribute {name!r}")
    return getattr(import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
