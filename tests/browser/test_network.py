"""The live page of a path network: its arcs coloured by learned time and by occupancy, pointed at and selected."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import (
    MOVING,
    WAITING,
    api,
    open_stage,
    past_time,
    pause,
    place_at,
    stop_run,
    until,
    vehicle_at,
    vehicle_in,
)

pytestmark = pytest.mark.browser
REFRESH_S = 60.0
HOT = "wattlane.stage.map.heat && wattlane.stage.map.heatEnds[1] > wattlane.stage.map.heatEnds[0]"
FREE_LANE = """(least) => {
  const m = wattlane.stage.map, box = m.canvas.getBoundingClientRect();
  const lanes = m.floor.lanes.filter(({ place }) => {
    const [x, y] = m.placeScreen(place), under = m.pick(x, y);
    return under && under.place === place && document.elementFromPoint(box.left + x, box.top + y) === m.canvas;
  }).sort((a, b) => m.heat[a.place] - m.heat[b.place]);
  return (least ? lanes[0] : lanes[lanes.length - 1]).place;
}"""
"""The lane of least, or of most heat, of those that a pointer reaches."""
IN_ITS_COLOUR = """(place) => {
  const m = wattlane.stage.map, [x, y] = m.placeScreen(place), wanted = m.heatColour(place), r = 6;
  const { data } = m.ctx.getImageData(x * m.dpr - r, y * m.dpr - r, 2 * r, 2 * r);
  for (let i = 0; i < data.length; i += 4) if (`rgb(${data[i]},${data[i + 1]},${data[i + 2]})` === wanted) return true;
  return false;
}"""


@pytest.fixture(scope="module")
def run(dashboard: Any) -> Iterator[str]:
    """A live run of the network that learns every minute."""
    asked = {"planner.parameters.refresh_s": REFRESH_S}
    made = api(dashboard.url, "/api/runs", {"scenario": "lian2024", "seed": 3, "speed": 64, "overrides": asked})
    yield made["run_id"]
    stop_run(dashboard.url, made["run_id"])


@pytest.fixture
def network(dashboard: Any, kept_page: Page, run: str) -> Page:
    """The page of that run, after its first refresh and paused for everyone."""
    api(dashboard.url, f"/api/runs/{run}/control", {"op": "play"})
    open_stage(kept_page, f"{dashboard.url}/operate?run={run}&layers=ids")
    past_time(kept_page, int(REFRESH_S) + 30)
    pause(kept_page)
    return kept_page


def layer(page: Page, name: str, option: str) -> None:
    """Chooses in the menu of layers, and closes it: it covers part of the map."""
    page.get_by_label("Layers").click()
    page.locator(f"[data-layer={name}]").select_option(option)
    page.get_by_label("Layers").click()


def off(page: Page) -> None:
    page.mouse.move(5, 5)
    until(page, "wattlane.stage.map.tip.hidden")


def test_arcs_are_coloured_by_learned_time_and_by_occupancy(network: Page, run: str, dashboard: Any) -> None:
    page = network
    assert page.evaluate("wattlane.stage.map.floor.nodes.length") == 112
    assert page.evaluate("new Set(wattlane.stage.map.floor.lanes.map((lane) => lane.arc)).size") == 202
    legend = page.locator(".wl-heat-legend")
    expect(legend).to_be_hidden()
    layer(page, "heat", "expected")
    until(page, HOT)
    expect(legend).to_have_text(re.compile(r"^expected time0\.90 s\d+\.\d\d s$"))
    until(page, "location.search.includes('heat-expected')")
    for least in (True, False):
        until(page, f"({IN_ITS_COLOUR})(({FREE_LANE})({str(least).lower()}))")
    live = page.evaluate("[...wattlane.stage.map.heat]")
    time_s = page.evaluate("wattlane.stage.time")
    assert live == api(dashboard.url, f"/api/runs/{run}/heat?kind=expected&t1={time_s}")["values"]
    layer(page, "heat", "occupancy")
    until(page, f"{HOT} && wattlane.stage.map.heatEnds[0] === 0")
    expect(legend).to_have_text(re.compile(r"^occupancy0\d+\.\d %$"))
    until(page, f"({IN_ITS_COLOUR})(({FREE_LANE})(false))")
    page.goto(f"{dashboard.url}/replay?run={run}&t={time_s}&layers=heat-expected,w3600")
    until(page, "window.wattlane && wattlane.stage && wattlane.stage.map && " + HOT)
    assert page.evaluate("[...wattlane.stage.map.heat]") == live


def test_an_arc_tells_its_time_and_a_vehicle_is_selected(network: Page, run: str, dashboard: Any) -> None:
    page = network
    layer(page, "heat", "expected")
    until(page, HOT)
    place = page.evaluate(FREE_LANE, False)
    page.mouse.move(*place_at(page, place)())
    tip = page.locator(".wl-tip")
    told = re.compile(
        r"^(?:lane|kerb) [EN]\d+→[EN]\d+ · expected (\d+\.\d\d) s · (\d+) passages? in the last hour · "
        r"occupied (\d+\.\d) % of the time$"
    )
    expect(tip).to_have_text(told)
    match = told.match(tip.inner_text())
    assert match
    arcs = api(dashboard.url, f"/api/runs/{run}/arcs?t1={page.evaluate('wattlane.stage.time')}")
    assert match[1] == f"{arcs['expected_s'][place]:.2f}"
    assert match[2] == str(arcs["passages"][place])
    assert float(match[3]) == pytest.approx(100 * arcs["occupancy"][place], abs=0.11)
    page.mouse.click(*place_at(page, place)())
    side = page.locator(".wl-right")
    expect(side.locator("h2")).to_have_text(re.compile(r"^Lane [EN]\d+.*→"))
    expect(side).to_contain_text(f"{match[1]} s")
    expect(side).to_contain_text("in the last hour")
    off(page)
    vehicle = vehicle_in(page, MOVING, WAITING)
    page.mouse.click(*vehicle_at(page, vehicle)())
    expect(side.locator("h2")).to_have_text(f"Vehicle {vehicle}")
    until(page, f"location.search.includes('sel=v{vehicle}')")
