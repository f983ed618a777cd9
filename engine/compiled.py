"""How kernels that allocate nothing are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def lean(function: F) -> F:
    """Compiled, cached, without the interpreter's lock, and without counting references to arrays.

    Such a function can't make an array. Calls that pass on dozens of arrays, as the step's do, cost a fifth.
    """
    options: Any = {"cache": True, "nogil": True, "_nrt": False}
    return cast(F, njit(**options)(function))


def lean_inline(function: F) -> F:
    """The same, and always a part of whoever calls it: for what is called once,
    or for a few lines in an innermost loop that would be handed many arrays."""
    options: Any = {"cache": True, "nogil": True, "forceinline": True, "_nrt": False}
    return cast(F, njit(**options)(function))


def lean_part(function: F) -> F:
    """The same for a part of one caller, apart only to be read: compiled with it, once, and not a second time alone."""
    options: Any = {"cache": True, "nogil": True, "inline": "always", "_nrt": False}
    return cast(F, njit(**options)(function))
