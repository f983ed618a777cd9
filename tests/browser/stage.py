"""What the browser tests do on a page: open a run, find things on the canvas, read the notifications.

Nothing here depends on how fast the machine is: each step waits until the page shows that the one before is done.
"""

from __future__ import annotations

import contextlib
import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

WAIT_MS = 60_000
"""How long a condition may take to come true: on a busy machine long, and no test is about speed."""
FIRST_FRAME_MS = 400_000
"""A first start compiles kernels."""

Spot = Callable[[], tuple[float, float]]
IDLE, MOVING, WAITING, LOADING, TO_CHARGER, CHARGING, FAULT, PAUSED = range(8)

CLICKABLE = """(states) => {
  const m = wattlane.stage.map, box = m.canvas.getBoundingClientRect();
  for (let v = 0; v < m.n; v++) {
    if (!states.includes(m.frame.state[v])) continue;
    const [x, y] = m.vehicleScreen(v), under = m.pick(x, y);
    if (under && under.kind === "vehicle" && under.id === v
      && document.elementFromPoint(box.left + x, box.top + y) === m.canvas) return v;
  }
  return -1;
}"""
"""The first vehicle in one of these states that a click on the map reaches; -1 when there is none."""


def api(url: str, path: str, body: dict[str, Any] | None = None) -> Any:
    """JSON from the dashboard, asked for beside the browser."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url + path, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=120) as answer:
        return json.load(answer)


def stop_run(url: str, run: str) -> None:
    """Tidies up: stops a run and waits for its end, so that the front page shows another; a busy one is left."""
    with contextlib.suppress(urllib.error.HTTPError):
        api(url, f"/api/runs/{run}/control", {"op": "stop"})
        give_up = time.monotonic() + 60
        while api(url, f"/api/runs/{run}")["alive"] and time.monotonic() < give_up:
            time.sleep(0.1)


def open_stage(page: Page, address: str) -> None:
    """Opens a page with a map and returns once the fleet is drawn."""
    page.goto(address)
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)


def until(page: Page, condition: str, timeout_ms: float = WAIT_MS) -> None:
    """Waits until JavaScript is true. (Playwright's own wait compiles it in the page, which its policy forbids.)"""
    give_up = time.monotonic() + timeout_ms / 1000
    while not page.evaluate(f"!!({condition})"):
        assert time.monotonic() < give_up, f"never came true: {condition}"
        page.wait_for_timeout(50)


def settled(page: Page) -> None:
    """Waits until the fleet is drawn where the newest frame says; ends only where nothing moves."""
    until(page, "wattlane.stage.map.frame && !wattlane.stage.map.moving")


def pause(page: Page) -> None:
    """Pauses the simulation for everyone, and waits until it stands and is drawn so."""
    page.get_by_role("button", name=re.compile("^Pause the simulation")).click()
    chip(page, "PAUSED")
    settled(page)


def step(page: Page, ticks: int) -> None:
    """Simulates so many ticks of a paused run, and waits until they are drawn."""
    tick = page.evaluate("wattlane.stage.map.frame.tick")
    page.evaluate(f"wattlane.stage.step({ticks})")
    until(page, f"wattlane.stage.map.frame.tick === {tick + ticks}")
    settled(page)


def vehicle_in(page: Page, *states: int) -> int:
    """A vehicle of a paused run that is in one of these states and can be clicked; steps on until there is one."""
    for _ in range(60):
        vehicle = int(page.evaluate(CLICKABLE, list(states)))
        if vehicle >= 0:
            return vehicle
        step(page, 10)
    return pytest.fail(f"no vehicle came into one of the states {states} within 600 ticks")


def clock_s(page: Page) -> int:
    """The simulated time shown in the top bar."""
    hours, minutes, seconds = page.locator(".wl-clock").inner_text().split(":")
    return int(hours) * 3600 + int(minutes) * 60 + int(seconds)


def clock_text(seconds: int) -> str:
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def at_time(page: Page, seconds: int) -> None:
    """Waits until the page shows this simulated time."""
    expect(page.locator(".wl-clock")).to_have_text(clock_text(seconds))


def past_time(page: Page, seconds: int) -> None:
    """Waits until the page shows at least this simulated time."""
    until(page, f"wattlane.stage.time >= {seconds}", FIRST_FRAME_MS)


def vehicle_at(page: Page, vehicle: int) -> Spot:
    """Where a vehicle is drawn, in pixels of the page."""
    return lambda: _on_page(page, f"wattlane.stage.map.vehicleScreen({vehicle})")


def place_at(page: Page, place: int) -> Spot:
    """Where a place is drawn, in pixels of the page."""
    return lambda: _on_page(page, f"wattlane.stage.map.placeScreen({place})")


def _on_page(page: Page, inside: str) -> tuple[float, float]:
    x, y = page.evaluate(inside)
    box = page.locator(".wl-map-canvas").bounding_box()
    assert box is not None
    return box["x"] + x, box["y"] + y


def menu_of(page: Page, spot: Spot) -> list[str]:
    """Opens the map's context menu and returns what it offers."""
    page.mouse.click(*spot(), button="right")
    expect(page.get_by_role("menu")).to_be_visible()
    return page.get_by_role("menuitem").all_inner_texts()


def menu_at(page: Page, spot: Spot, item: str) -> None:
    """Chooses from the map's context menu; what it offers follows the run's log, so it is opened until it does."""
    offered: list[str] = []
    for _ in range(60):
        offered = menu_of(page, spot)
        if item in offered:
            page.get_by_role("menuitem", name=item, exact=True).click()
            return
        page.keyboard.press("Escape")
        page.wait_for_timeout(500)
    pytest.fail(f"the menu never offered {item!r}, but {offered}")


def note(page: Page, text: str | re.Pattern[str]) -> Locator:
    """A notification with this text."""
    found = page.locator(".mantine-Notification-root", has_text=text).first
    expect(found).to_be_visible()
    return found


def chip(page: Page, mode: str, timeout_ms: float | None = None) -> None:
    expect(page.locator(".wl-chip")).to_have_text(mode, timeout=timeout_ms)


def tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click()
