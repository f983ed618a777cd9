"""Compare: runs chosen in the catalogue or started here, beside each other on one clock."""

from __future__ import annotations

import re
import uuid
from dataclasses import dataclass
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import FIRST_FRAME_MS, api, at_time, chip, past_time, until
from tests.synthetic import make_run

pytestmark = pytest.mark.browser
DRAWN = "wattlane.stage && wattlane.stage.panels.length && wattlane.stage.panels.every((p) => p.map && p.map.frame)"


@dataclass(frozen=True)
class Runs:
    """One that nobody commanded, the same with commands, a shorter one, and one of another seed."""

    quiet: str
    commanded: str
    short: str
    other_seed: str

    @property
    def pair(self) -> str:
        return f"{self.quiet},{self.commanded}"


@pytest.fixture(scope="module")
def runs(dashboard: Any) -> Runs:
    def make(**how: Any) -> str:
        return make_run(dashboard.data / "runs", run_id=f"20261122-101500-beside-{uuid.uuid4().hex[:4]}", **how)

    return Runs(make(ticks=900, commands=()), make(ticks=900), make(ticks=300, commands=()), make(ticks=300, seed=2))


def open_beside(page: Page, url: str, query: str) -> None:
    """Opens runs beside each other, and returns once every map has its fleet and its numbers."""
    page.goto(f"{url}/compare?{query}")
    drawn(page)


def drawn(page: Page) -> None:
    page.wait_for_selector("#map-A[data-frames]", timeout=FIRST_FRAME_MS)
    until(page, DRAWN)
    until(page, "document.querySelector('#numbers-A').dataset.t !== undefined")


def shown_times(page: Page) -> list[float]:
    return page.evaluate("wattlane.stage.panels.map((p) => p.map.frame.time)")


def test_runs_are_chosen_in_the_catalogue(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    page.goto(f"{dashboard.url}/runs")
    button = page.get_by_role("button", name="Compare", exact=True)
    expect(button).to_be_disabled()

    def tick(run: str) -> None:
        page.get_by_label(f"Choose {run} to compare").click()

    tick(runs.quiet)
    expect(page.locator("#picked")).to_contain_text("Two to four runs were expected; got 1")
    tick(runs.other_seed)
    expect(page.locator("#picked")).to_contain_text(re.compile("the seed is (1 and 2|2 and 1)"))
    expect(button).to_be_disabled()
    tick(runs.other_seed)
    tick(runs.commanded)
    expect(page.locator("#picked")).to_contain_text("2 runs")
    button.click()
    page.wait_for_url(re.compile(r"/compare\?runs="))
    drawn(page)
    chip(page, "REPLAY")
    assert page.locator(".wl-compare-run").count() == 2


def test_one_clock_moves_all_maps(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    open_beside(page, dashboard.url, f"runs={runs.pair},{runs.short}")
    page.fill("#time", "600")
    page.keyboard.press("Enter")
    at_time(page, 600)
    until(page, "wattlane.stage.panels.slice(0, 2).every((p) => p.map.frame.time === 600)")
    assert shown_times(page)[2] == 300
    expect(page.locator("#numbers-C")).to_contain_text("ended at 00:05:00")
    until(page, "document.querySelector('#numbers-A').dataset.t === '600'")
    for run in api(dashboard.url, f"/api/compare?runs={runs.pair}&t=600")["runs"]:
        expect(page.locator(f"#numbers-{run['letter']}")).to_contain_text(f"orders {run['orders_done']}")
    page.locator("#map-A .wl-map-canvas").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowLeft")
    at_time(page, 589)
    page.keyboard.press("Home")
    at_time(page, 0)
    page.locator("#speed").select_option("16")
    page.keyboard.press("Space")
    past_time(page, 20)
    page.get_by_label("Pause my view (Space)").click()
    still = page.evaluate("wattlane.stage.time")
    until(page, f"wattlane.stage.panels.every((p) => Math.abs(p.map.frame.time - {still}) < 1e-6)")


def test_the_first_divergence_is_marked_and_reached(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    open_beside(page, dashboard.url, f"runs={runs.pair}")
    parting = api(dashboard.url, f"/api/compare?runs={runs.pair}")["parting"]
    assert 60 <= parting["tick"] < 900
    until(page, f"wattlane.stage.marks.length === 1 && wattlane.stage.marks[0].t === {parting['time_s']}")
    expect(page.locator("#compare-parting")).to_contain_text(f"(tick {parting['tick']}), vehicle {parting['vehicle']}:")
    page.get_by_role("button", name="Go to the first divergence").click()
    at_time(page, parting["tick"])
    until(page, f"wattlane.stage.panels.every((p) => p.map.selection.id === {parting['vehicle']})")
    page.keyboard.press("Home")
    at_time(page, 0)
    page.locator("#map-B .wl-map-canvas").focus()
    page.keyboard.press("Control+ArrowRight")
    at_time(page, parting["tick"])
    for theme in ("one", "the other"):
        for name in ("orders", "energy", "waiting"):
            plot = f"document.querySelector('#compare-{name} .js-plotly-plot')"
            shown = f"{plot}.layout.shapes[0].x0 === {1000 * parting['time_s']}"
            until(page, f"{plot} && {plot}.layout.shapes && {shown}")
            assert page.evaluate(f"{plot}.data.map((trace) => trace.name)")[:2] == ["A", "B"], theme
        page.get_by_label("Light or dark").click()
    href = page.get_by_role("link", name="One .rrd of all").get_attribute("href")
    assert href == f"/api/compare/rrd?runs={runs.pair}"


def test_a_copied_link_opens_the_same_view(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    open_beside(page, dashboard.url, f"runs={runs.pair}&t=500&sel=v2&layers=grid,ids")
    at_time(page, 500)
    until(
        page, "wattlane.stage.panels.every((p) => p.map.layers.grid && !p.map.layers.paths && p.map.selection.id === 2)"
    )
    page.locator("#map-B .wl-map-canvas").focus()
    page.keyboard.press("h")
    until(page, "wattlane.stage.panels.every((p) => p.map.heat)")
    until(page, "new Set(wattlane.stage.panels.map((p) => p.map.heatEnds.join())).size === 1")
    page.locator("#map-B").get_by_label("Zoom in (+)").click()
    until(page, "new Set(wattlane.stage.panels.map((p) => JSON.stringify(p.map.view))).size === 1")
    link = page.url
    assert re.search(r"layers=grid%2Cids%2Cheat-occupancy", link)
    page.goto("about:blank")
    page.goto(link)
    drawn(page)
    at_time(page, 500)
    until(page, "wattlane.stage.panels.every((p) => p.map.layers.heat === 'occupancy' && p.map.selection.id === 2)")
    expect(page).to_have_url(link)


def test_on_a_phone_the_maps_stack(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    page.set_viewport_size({"width": 390, "height": 844})
    open_beside(page, dashboard.url, f"runs={runs.pair}")
    upper, lower = (page.locator(f"#map-{letter}").bounding_box() for letter in "AB")
    assert upper is not None
    assert lower is not None
    assert lower["y"] >= upper["y"] + upper["height"]
    assert min(upper["width"], lower["width"]) >= 380
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.set_viewport_size({"width": 1440, "height": 900})


def test_the_form_starts_runs_and_opens_them(dashboard: Any, kept_page: Page) -> None:
    page = kept_page
    page.goto(f"{dashboard.url}/compare?scenario=soochow2022&planners=prioritized:energy,quickest&seed=5&length=soon")
    chosen = page.locator(".mantine-MultiSelect-pill")
    expect(chosen).to_have_count(2)
    expect(page.locator("#compare-seed")).to_have_value("5")
    page.get_by_role("button", name="Start and compare").click()
    expect(page.locator("#compare-error")).to_contain_text("a duration was expected")
    page.fill("#compare-length", "30s")
    page.get_by_role("button", name="Start and compare").click()
    page.wait_for_url(re.compile(r"/compare\?runs="))
    page.wait_for_selector("#map-A[data-frames]", timeout=FIRST_FRAME_MS)
    expect(page.locator(".wl-compare-run h2")).to_have_text(["A · prioritized, least energy", "B · quickest"])
    expect(page.locator("#compare-progress > div")).to_have_count(0, timeout=FIRST_FRAME_MS)
    until(page, "wattlane.stage.end === 30")
    page.locator("#map-A .wl-map-canvas").focus()
    page.keyboard.press("End")
    at_time(page, 30)
    until(page, "wattlane.stage.panels.every((p) => p.map.frame.time === 30)")
    page.locator(".wl-nav a", has_text="Replay").click()
    until(page, "wattlane.stage === null")


def test_what_cant_be_compared_is_a_sentence(dashboard: Any, kept_page: Page, runs: Runs) -> None:
    page = kept_page
    page.goto(f"{dashboard.url}/compare?runs={runs.quiet},{runs.other_seed}")
    expect(page.locator(".wl-empty")).to_contain_text("the seed is 1 and 2")
    page.goto(f"{dashboard.url}/compare")
    expect(page.get_by_role("link", name="Choose recorded runs")).to_be_visible()
