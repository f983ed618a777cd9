"""What a page is: the entry of one area of the dashboard in the top bar, its addresses and its callbacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import dash
from dash import no_update

from app.runs import RunManager
from app.settings import Settings
from engine.errors import WattlaneError

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


def opened(start: Callable[[], str]) -> tuple[Any, Any]:
    """Starts a run for a form; start() returns its id. (sentence for the form, address of the run's page)."""
    try:
        return None, f"/operate?run={start()}"
    except WattlaneError as error:
        return str(error), no_update
    except OSError as error:
        return f"the disk refused: {error.strerror or error}", no_update
