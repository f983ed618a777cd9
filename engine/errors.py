"""What can go wrong, as one small tree.

WattlaneError
├── BadInput          a person's input is wrong; the message is the whole answer (exit code 2)
│   ├── ScenarioError     a scenario file or parameter
│   ├── CommandError      an operator's command that makes no sense
│   └── FormatError       a foreign file (map, scen, plan)
├── RunError          a run's folder is missing, locked, damaged or from another version
└── InvariantBroken   the program contradicts itself: a defect, never the user's fault
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class WattlaneError(Exception):
    """Root of every error that Wattlane raises on purpose."""


class BadInput(WattlaneError, ValueError):
    """A person's input is wrong; the message says what was got and what was expected."""


class ScenarioError(BadInput):
    """A scenario is malformed or cannot be built."""


class CommandError(BadInput):
    """An operator's command is malformed."""


class FormatError(BadInput):
    """A file in a foreign format is malformed."""


class RunError(WattlaneError):
    """A recorded run can't be used: missing, locked, damaged or from another version."""


class InvariantBroken(WattlaneError, AssertionError):
    """An internal promise did not hold."""


def nearest_name(got: str, known: Iterable[str]) -> str:
    """Suffix `; did you mean 'x'?` with the nearest known name, or the list of names when none is near."""
    names = sorted(known)
    near = difflib.get_close_matches(got, names, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(names)}" if names else ""


def unknown_name(what: str, got: str, known: Iterable[str]) -> str:
    """One sentence for an unknown name: what it names, what was got, and the nearest known one."""
    return f"unknown {what} {got!r}{nearest_name(got, known)}"
