"""A robot on terrain: drawn live with what it knows, commanded by obstacles, replayed at any tick, previewed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import (
    FIRST_FRAME_MS,
    api,
    chip,
    menu_of,
    note,
    open_stage,
    past_time,
    pause,
    place_at,
    stop_run,
    tab,
    until,
)

pytestmark = pytest.mark.browser
GROUND = "wattlane.stage.map.ground"
SMALL = {
    "floor.terrain.width_m": 30,
    "floor.terrain.length_m": 30,
    "floor.terrain.hills": 12,
    "floor.terrain.obstacles": 12,
    "floor.terrain.clear": [[3.1, 3.1], [27.1, 27.1]],
    "fleet.start": [[15, 15]],
    "orders.goals": [[135, 135]],
}
AHEAD = """(metres) => {
  const m = wattlane.stage.map, { way } = m.ground, [x, y] = [m.nowX[0], m.nowY[0]];
  let nearest = 0, least = Infinity;
  for (let i = 0; i < way.length; i += 2) {
    const d = Math.hypot(way[i] - x, way[i + 1] - y);
    if (d < least) { least = d; nearest = i; }
  }
  for (let i = nearest; i < way.length; i += 2) {
    if (Math.hypot(way[i] - x, way[i + 1] - y) < metres) continue;
    return m._placeAtPoint(way[i], way[i + 1]);
  }
  return -1;
}"""
"""The cell of the way that is so far from the robot."""
CLEARANCE = """(place) => {
  const { way } = wattlane.stage.map.ground, [x, y] = wattlane.stage.map.floor.places[place];
  let least = Infinity;
  for (let i = 0; i < way.length; i += 2) least = Math.min(least, Math.hypot(way[i] - x, way[i + 1] - y));
  return least;
}"""
"""Metres between the way and the middle of a cell."""
COLOURS = """() => {
  const m = wattlane.stage.map, { data } = m.still.getContext("2d").getImageData(0, 0, m.still.width, m.still.height);
  const seen = new Set();
  for (let i = 0; i < data.length; i += 4 * 7) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
  return seen.size;
}"""
KNOWN = f"{GROUND}.known.reduce((sum, one) => sum + one, 0)"


@pytest.fixture(scope="module")
def run(dashboard: Any) -> Iterator[str]:
    """A live run on 30 m × 30 m."""
    made = api(dashboard.url, "/api/runs", {"scenario": "zhang2021", "speed": 4, "overrides": SMALL})
    yield made["run_id"]
    stop_run(dashboard.url, made["run_id"])


def told(dashboard: Any, run: str, time_s: float | None = None) -> Any:
    """What the server says of the ground at a time."""
    return api(dashboard.url, f"/api/runs/{run}/ground" + ("" if time_s is None else f"?t={time_s}"))


def test_a_way_is_published_bettered_and_mended_round_an_obstacle(dashboard: Any, kept_page: Page, run: str) -> None:
    page = kept_page
    open_stage(page, f"{dashboard.url}/operate?run={run}")
    until(page, f"{GROUND}.search && {GROUND}.way.length > 0", FIRST_FRAME_MS)
    assert page.evaluate(COLOURS) > 500  # relief, not flat paint
    past_time(page, 8)
    pause(page)
    # ε has fallen from the first way, which was soon there, to the best one
    until(page, f"{GROUND}.search.bound === 1")
    assert told(dashboard, run, 0.6)["search"]["bound"] > 1
    expect(page.locator(".wl-ground-bound")).to_contain_text("Optimal")
    assert page.locator(".wl-kpi", has_text="Expanded").locator("dd").inner_text() != "0"
    # what makes no sense for one robot is not there
    assert "Reservations" not in page.get_by_role("tab").all_inner_texts()
    expect(page.locator("#occupancy-graph")).to_be_hidden()
    # an obstacle on the way ahead, within the sensor's reach
    place = int(page.evaluate(AHEAD, 3.0))
    assert page.evaluate(CLEARANCE, place) < 0.3
    offered = menu_of(page, place_at(page, place))
    assert "Send the robot here" in offered
    page.get_by_role("menuitem", name=re.compile("Drop an obstacle here, 1.6 m wide")).click()
    note(page, "Block: accepted")
    until(page, f"{GROUND}.obstacleAt({place})")
    repairs = told(dashboard, run)["search"]["repairs"]
    known = page.evaluate(KNOWN)
    page.get_by_role("button", name=re.compile("^Continue the simulation")).click()
    until(page, f"({CLEARANCE})({place}) > 0.8 + 0.3")
    until(page, f"{GROUND}.search.repairs > {repairs}")
    until(page, f"{KNOWN} > {known}")  # and it sees more as it drives
    pause(page)
    # the cell tells what it is; the same place offers to take the obstacle away
    page.mouse.click(*place_at(page, place)())
    expect(page.locator(".wl-right dd").nth(3)).to_have_text("yes")
    for term in ("Height", "Slope", "Friction", "Obstacle", "Robot's view"):
        expect(page.locator(".wl-right dt", has_text=term)).to_be_visible()
    page.get_by_role("button", name="Remove the obstacle").click()
    note(page, "Unblock: accepted")
    until(page, f"!{GROUND}.obstacleAt({place})")
    tab(page, "Events")
    expect(page.locator("#events-grid")).to_contain_text("blocked")


def test_any_moment_of_it_is_replayed(dashboard: Any, kept_page: Page, run: str) -> None:
    page = kept_page
    api(dashboard.url, f"/api/runs/{run}/control", {"op": "speed", "speed": 0})
    api(dashboard.url, f"/api/runs/{run}/control", {"op": "play"})
    open_stage(page, f"{dashboard.url}/replay?run={run}&t=6")
    chip(page, "REPLAY")
    until(page, f"{GROUND}.search && {GROUND}.track.t1_s.length > 0")

    def at(time_s: float) -> tuple[int, int, float]:
        page.evaluate(f"wattlane.stage.seek({time_s})")
        until(page, f"Math.abs(wattlane.stage.map.frame.time - {time_s}) < 0.11")
        wanted = told(dashboard, run, time_s)
        until(page, f"{GROUND}.wayRow === {wanted['way_row']}")
        ended = sum(t <= time_s + 1e-6 for t in wanted["track"]["t1_s"])
        until(page, f"{GROUND}.shown === {ended + 1}")
        until(page, "!wattlane.stage.map.stillStale")
        assert page.evaluate(f"{GROUND}.search.total") == wanted["search"]["total"]
        return page.evaluate(KNOWN), ended, wanted["search"]["bound"]

    early, late, again = at(0.6), at(8.0), at(0.6)
    assert early == again
    assert late[0] > early[0]
    assert late[1] > early[1]
    assert early[2] > late[2] == 1
    # without the veil the ground is shown as it is
    page.get_by_label("Layers").click()
    page.get_by_label("Veil what is not seen yet").uncheck()
    until(page, f"{KNOWN} === 150 * 150")
    assert "veil" not in page.url
    expect(page.locator("[data-layer=heat]")).to_have_count(0)


def test_terrain_is_previewed_with_its_relief(dashboard: Any, kept_page: Page) -> None:
    page = kept_page
    page.goto(f"{dashboard.url}/scenarios?scenario=zhang2021")
    page.wait_for_selector("#scenarios-map[data-shown=zhang2021]", timeout=FIRST_FRAME_MS)
    until(page, "document.querySelector('[data-thumb=zhang2021]').dataset.drawn")
    expect(page.locator("#scenarios-legend")).to_contain_text("contours every")
    expect(page.locator("#scenarios-findings[data-done]")).to_contain_text("joins its start and its goal")
    expect(page.locator(".wl-scn-side")).to_contain_text("a coarse map of the heights")
    expect(page.locator(".wl-scn-parameters")).to_contain_text("floor.terrain.sensor_m")
