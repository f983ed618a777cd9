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


def folded(function: F) -> F:
    """The same, and put into its callers whole: for what is small, called often, and would be handed many arrays."""
    options: Any = {"cache": True, "nogil": True, "_nrt": False, "forceinline": True}
    return cast(F, njit(**options)(function))
