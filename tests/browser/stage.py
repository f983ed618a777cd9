"""What the browser tests do on a page: open a run, find things on the canvas, read the notifications."""

from __future__ import annotations

import contextlib
import json
import re
import urllib.error
import urllib.request
from typing import Any

from playwright.sync_api import Locator, Page, expect

FIRST_FRAME_MS = 150_000
"""A first start compiles kernels."""


def api(url: str, path: str, body: dict[str, Any] | None = None) -> Any:
    """JSON from the dashboard, asked for beside the browser."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url + path, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def stop_run(url: str, run: str) -> None:
    """Tidies up: stops a run; one too busy to answer ends with its dashboard."""
    with contextlib.suppress(urllib.error.HTTPError):
        api(url, f"/api/runs/{run}/control", {"op": "stop"})


def open_stage(page: Page, address: str) -> None:
    """Opens a page with a map and returns once the fleet is drawn."""
    page.goto(address)
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)


def clock_s(page: Page) -> int:
    """The simulated time shown in the top bar."""
    hours, minutes, seconds = page.locator(".wl-clock").inner_text().split(":")
    return int(hours) * 3600 + int(minutes) * 60 + int(seconds)


def clock_text(seconds: int) -> str:
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def at_time(page: Page, seconds: int) -> None:
    """Waits until the page shows this simulated time."""
    expect(page.locator(".wl-clock")).to_have_text(clock_text(seconds))


def vehicle_at(page: Page, vehicle: int) -> tuple[float, float]:
    """Where a vehicle is drawn, in pixels of the page."""
    x, y = page.evaluate(f"wattlane.stage.map.vehicleScreen({vehicle})")
    return _on_page(page, x, y)


def place_at(page: Page, place: int) -> tuple[float, float]:
    """Where a place is drawn, in pixels of the page."""
    x, y = page.evaluate(f"wattlane.stage.map.placeScreen({place})")
    return _on_page(page, x, y)


def _on_page(page: Page, x: float, y: float) -> tuple[float, float]:
    box = page.locator(".wl-map-canvas").bounding_box()
    assert box is not None
    return box["x"] + x, box["y"] + y


def menu_at(page: Page, spot: tuple[float, float], item: str) -> None:
    """Chooses from the map's context menu."""
    page.mouse.click(*spot, button="right")
    page.get_by_role("menuitem", name=item).click()


def note(page: Page, text: str | re.Pattern[str]) -> Locator:
    """A notification with this text; there within a second or two."""
    found = page.locator(".mantine-Notification-root", has_text=text).first
    expect(found).to_be_visible(timeout=4000)
    return found


def chip(page: Page, mode: str, timeout_ms: float = 10_000) -> None:
    expect(page.locator(".wl-chip")).to_have_text(mode, timeout=timeout_ms)


def tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click()
