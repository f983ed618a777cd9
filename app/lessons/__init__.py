"""The lessons of Learn. A further one is one file here and one line below, and a script in assets/web."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from app.lessons.base import Lesson

LESSONS: dict[str, str] = {
    "search": "app.lessons.search:LESSON",
    "heuristics": "app.lessons.heuristics:LESSON",
    "anytime": "app.lessons.anytime:LESSON",
    "tree": "app.lessons.tree:LESSON",
    "learned-time": "app.lessons.learned_time:LESSON",
    "motor": "app.lessons.motor:LESSON",
    "ants": "app.lessons.ants:LESSON",
    "break-it": "app.lessons.break_it:LESSON",
}
"""The lesson at /learn/{name}, in the order of the page."""


@cache
def lesson(name: str) -> Lesson:
    """A lesson by its name. Raises KeyError."""
    module, _, attribute = LESSONS[name].partition(":")
    found: Lesson = getattr(import_module(module), attribute)
    return found
