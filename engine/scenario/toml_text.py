"""TOML as text: which line a key stands on, and writing a scenario out."""

from __future__ import annotations

import re
import tomllib
from typing import Any

Path = tuple[str | int, ...]
"""Where a value stands: keys, and indices into arrays."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}\s#]+")


def lines_of(text: str) -> dict[Path, int]:
    """Line (from 1) of every key, table and array element of valid TOML; the line on which the value begins for
    multi-line strings is that of the opening quotes.
    """
    scanner = _Scanner(text)
    scanner.document()
    return scanner.lines


def nearest_line(lines: dict[Path, int], path: Path) -> int | None:
    """Line of a path, or of the longest part of it that stands in the text; None when no part does."""
    for end in range(len(path), 0, -1):
        if path[:end] in lines:
            return lines[path[:end]]
    return None


class _Scanner:
    """Walks text that tomllib has accepted, so it needs no error handling of its own."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Path, int] = {}
        self._counted = 0
        self._line = 1

    def line(self) -> int:
        self._line += self.text.count("\n", self._counted, self.at)
        self._counted = self.at
        return self._line

    def document(self) -> None:
        table: Path = ()
        counts: dict[Path, int] = {}
        while True:
            self._skip()
            if self.at >= len(self.text):
                return
            if self._take("[["):
                keys, line = self._key()
                self._skip()
                self._take("]]")
                keys = self._indexed(keys[:-1], counts) + keys[-1:]
                counts[keys] = counts.get(keys, -1) + 1
                table = (*keys, counts[keys])
                self._note(keys, line)
                self._note(table, line)
            elif self._take("["):
                keys, line = self._key()
                self._skip()
                self._take("]")
                table = self._indexed(keys, counts)
                self._note(table, line)
            else:
                self._pair(table)

    def _indexed(self, keys: Path, counts: dict[Path, int]) -> Path:
        """Keys with the index of the latest element put in after every array of tables."""
        out: Path = ()
        for key in keys:
            out = (*out, key)
            if out in counts:
                out = (*out, counts[out])
        return out

    def _pair(self, table: Path) -> None:
        keys, line = self._key()
        for end in range(1, len(keys)):
            self._note((*table, *keys[:end]), line)
        self._skip()
        self._take("=")
        self._skip()
        self.lines[(*table, *keys)] = line
        self._value((*table, *keys))

    def _key(self) -> tuple[Path, int]:
        parts: list[str] = []
        self._skip()
        line = self.line()
        while True:
            self._skip()
            if self.text[self.at] in "\"'":
                begin = self.at
                self._string()
                parts.append(next(iter(tomllib.loads(f"{self.text[begin : self.at]} = 0"))))  # escapes undone
            else:
                match = _BARE.match(self.text, self.at)
                if match is None:
                    self.at += 1
                    return tuple(parts), line
                parts.append(match[0])
                self.at = match.end()
            self._skip(newlines=False)
            if not self._take("."):
                return tuple(parts), line

    def _value(self, path: Path) -> None:
        self._note(path, self.line())
        first = self.text[self.at]
        if first in "\"'":
            self._string()
        elif first == "[":
            self.at += 1
            index = 0
            while True:
                self._skip()
                if self._take("]"):
                    return
                self._value((*path, index))
                index += 1
                self._skip()
                self._take(",")
        elif first == "{":
            self.at += 1
            while True:
                self._skip()
                if self._take("}"):
                    return
                self._pair(path)
                self._skip()
                self._take(",")
        else:
            match = _SCALAR.match(self.text, self.at)
            self.at = match.end() if match else self.at + 1

    def _string(self) -> None:
        quote = self.text[self.at]
        if self.text.startswith(quote * 3, self.at):
            self.at += 3
            while not self.text.startswith(quote * 3, self.at):
                self.at += 2 if quote == '"' and self.text[self.at] == "\\" else 1
            self.at += 3
            while self.at < len(self.text) and self.text[self.at] == quote:  # up to two quotes may end the content
                self.at += 1
            return
        self.at += 1
        while self.text[self.at] != quote:
            self.at += 2 if quote == '"' and self.text[self.at] == "\\" else 1
        self.at += 1

    def _skip(self, newlines: bool = True) -> None:
        """Past blanks and, with newlines, past comments and line ends."""
        blanks = " \t\r\n" if newlines else " \t"
        while self.at < len(self.text):
            if self.text[self.at] in blanks:
                self.at += 1
            elif newlines and self.text[self.at] == "#":
                end = self.text.find("\n", self.at)
                self.at = len(self.text) if end < 0 else end
            else:
                return

    def _take(self, token: str) -> bool:
        if self.text.startswith(token, self.at):
            self.at += len(token)
            return True
        return False

    def _note(self, path: Path, line: int) -> None:
        self.lines.setdefault(path, line)


def write(values: dict[str, Any]) -> str:
    """TOML text of nested plain values; strings with line ends become multi-line strings."""
    import tomli_w

    return tomli_w.dumps(values, multiline_strings=True)
