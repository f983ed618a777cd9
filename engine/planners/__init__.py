"""Planners: one file per method; the contracts are in `base` (lifelong) and `oneshot`."""

from engine.planners.oneshot import Limits, Problem, Solution, Solver

__all__ = ["Limits", "Problem", "Solution", "Solver"]
