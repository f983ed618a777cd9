"""What one call of the command line said, and how it refuses."""

from __future__ import annotations

import json
from typing import Any


class Said:
    """Exit code, stdout and stderr of one call."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> Any:
        assert self.out.count("\n") == 1, "one JSON object on one line"
        return json.loads(self.out)


def refused(said: Said, *words: str) -> None:
    """Exit code 2, nothing on stdout, one sentence on stderr and no traceback."""
    assert said.code == 2
    assert said.out == ""
    assert "Traceback" not in said.err
    assert said.err.startswith("wattlane: ")
    for word in words:
        assert word in said.err
