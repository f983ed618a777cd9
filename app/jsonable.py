"""From numpy's values to JSON's."""

from __future__ import annotations

import math
from typing import Any


def plain(value: Any) -> Any:
    """Plain JSON values; numbers that JSON lacks become null. numpy is asked only by its own methods, not imported."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)
