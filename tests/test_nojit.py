"""The slice without the JIT is what it says: kernels run as plain Python in it, and compiled otherwise."""

import types

import numba
import pytest


@pytest.mark.nojit_slice
def test_kernels_are_plain_python_exactly_when_asked() -> None:
    @numba.njit
    def double(x):
        return 2 * x

    assert isinstance(double, types.FunctionType) == bool(numba.config.DISABLE_JIT)
    assert double(21) == 42
