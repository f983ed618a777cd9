"""What a page is: the entry of one area of the dashboard in the top bar, its addresses and its callbacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import dash

from app.runs import RunManager
from app.settings import Settings

Query = Mapping[str, str]
"""First value of every key of an address's query."""


@dataclass(frozen=True)
class Page:
    """One area.

    word, href: its link · paths: the addresses it answers · layout: (manager, settings, path, query) → the page;
    a WattlaneError becomes a sentence on the page · register: its callbacks.
    """

    word: str
    href: str
    paths: tuple[str, ...]
    layout: Callable[[RunManager, Settings, str, Query], Any]
    register: Callable[[dash.Dash, RunManager, Settings], None]
