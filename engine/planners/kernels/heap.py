"""A binary heap in two arrays: int64 keys, int32 payloads. The caller owns the size and the room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.compiled import lean


@lean
def push(keys: NDArray[np.int64], items: NDArray[np.int32], size: int, key: int, item: int) -> int:
    """Add an item; returns the new size. The arrays must have room."""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if keys[up] <= key:
            break
        keys[i] = keys[up]
        items[i] = items[up]
        i = up
    keys[i] = key
    items[i] = item
    return size + 1


@lean
def drop_first(keys: NDArray[np.int64], items: NDArray[np.int32], size: int) -> int:
    """Remove the smallest item (at index 0); returns the new size."""
    size -= 1
    key, item = keys[size], items[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i] = keys[child]
        items[i] = items[child]
        i = child
    keys[i] = key
    items[i] = item
    return size
