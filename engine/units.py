"""Conversions at the edge: ticks, millijoules, millimetres inside; seconds, joules, metres outside."""

from __future__ import annotations

import re

from engine.errors import BadInput

MJ_PER_J = 1_000
MM_PER_M = 1_000
J_PER_WH = 3_600.0

_DURATION = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(ms|s|min|m|h|d)?\s*$")
_CLOCK = re.compile(r"^\s*(\d+):([0-5]?\d)(?::([0-5]?\d(?:\.\d+)?))?\s*$")
_SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0, None: 1.0}


def mj_from_j(energy_j: float) -> int:
    """Joules rounded half-even to whole millijoules."""
    return round(energy_j * MJ_PER_J)


def ticks_from_s(time_s: float, tick_s: float) -> int:
    """Seconds rounded to the nearest whole number of ticks."""
    return round(time_s / tick_s)


def seconds(text: str | float) -> float:
    """A duration in seconds from `90`, `90s`, `1.5min`, `8h`, `2d` or `01:30:00`. Raises BadInput."""
    if isinstance(text, int | float):
        return float(text)
    if match := _DURATION.match(text):
        return float(match[1]) * _SECONDS[match[2]]
    if match := _CLOCK.match(text):
        return int(match[1]) * 3600.0 + int(match[2]) * 60.0 + float(match[3] or 0)
    raise BadInput(f"a duration was expected such as '3600s', '90min', '8h' or '01:30:00'; got {text!r}")


def clock(time_s: float) -> str:
    """Seconds as `HH:MM:SS` (hours may exceed 24)."""
    whole = int(time_s)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"
