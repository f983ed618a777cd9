"""The frame: pages that exist, sentences for those that don't, light and dark, phone width, help, reduced motion."""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import api, open_stage, stop_run
from tests.synthetic import make_run

pytestmark = pytest.mark.browser
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="module")
def recorded(dashboard: Any) -> str:
    return make_run(dashboard.data / "runs", run_id=f"20261122-101500-synthetic-{uuid.uuid4().hex[:4]}")


def test_navigation_leads_only_to_what_exists(dashboard: Any, page: Page) -> None:
    page.goto(f"{dashboard.url}/runs")
    links = page.locator(".wl-nav a")
    expect(links).to_have_text(["Operate", "Replay"])
    for link in links.all():
        link.click()
        expect(page.locator(".wl-stage, .wl-catalogue").first).to_be_visible(timeout=20_000)
        page.wait_for_timeout(1500)  # charts that are still being drawn complain when they are taken away
    expect(page.locator("h1")).to_have_text("Runs")


@pytest.mark.parametrize(
    "path", ["/operate?run=no-such-run", "/replay?run=..%2F..%2Fetc", "/replay?run=%00", "/nothing-here"]
)
def test_what_is_not_there_is_a_sentence_with_a_way_on(dashboard: Any, page: Page, path: str) -> None:
    page.goto(dashboard.url + path)
    expect(page.locator(".wl-empty")).to_be_visible()
    page.get_by_role("link", name="See all runs").click()
    expect(page.locator("h1")).to_have_text("Runs")


def test_an_empty_program_names_the_first_action(new_dashboard: Callable[..., Any], page: Page) -> None:
    own = new_dashboard()
    open_stage(page, own.url)
    expect(page.locator(".wl-clock")).not_to_have_text("00:00:00", timeout=150_000)
    for run in api(own.url, "/api/runs"):
        stop_run(own.url, run["run_id"])
    for _ in range(600):
        if api(own.url, "/healthz")["live_runs"] == 0:
            break
        page.wait_for_timeout(200)
    page.goto(f"{own.url}/operate")
    expect(page.locator(".wl-empty")).to_contain_text("start a run", ignore_case=True)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_visible()


def test_light_and_dark_are_kept(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}&t=300")
    scheme = page.locator("html").get_attribute("data-mantine-color-scheme")
    assert scheme == "light"
    floor = page.evaluate("wattlane.stage.map.palette.aisle")
    page.get_by_role("button", name="Light or dark").click()
    expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
    page.wait_for_timeout(300)
    assert page.evaluate("wattlane.stage.map.palette.aisle") != floor
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
    page.wait_for_selector("#map[data-frames]")
    expect(page.locator("#soc-graph .xtick text").first).to_be_visible(timeout=15_000)
    colour = page.evaluate("getComputedStyle(document.querySelector('#soc-graph .xtick text')).fill")
    assert colour == "rgb(154, 167, 180)"


@pytest.mark.parametrize("context", [{"color_scheme": "dark"}], indirect=True)
def test_the_first_visit_follows_the_system(dashboard: Any, page: Page) -> None:
    page.goto(f"{dashboard.url}/runs")
    expect(page.locator("h1")).to_be_visible()
    expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")


def test_the_keys_are_explained(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keyboard shortcuts")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keyboard shortcuts")).to_be_hidden()
    page.keyboard.press("/")
    expect(page.locator("#find")).to_be_focused()
    page.keyboard.type("R8")
    assert page.evaluate("wattlane.stage.map.layers.ids"), "keys typed into a field are not shortcuts"
    page.keyboard.press("Enter")
    expect(page.locator(".wl-right h2")).to_contain_text("R8")


@pytest.mark.parametrize("context", [PHONE], indirect=True)
def test_on_a_phone_the_map_comes_first_and_nothing_sticks_out(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}&t=300")
    page.wait_for_timeout(1500)
    boxes = {name: page.locator(name).bounding_box() for name in (".wl-map", ".wl-transport", ".wl-right", ".wl-left")}
    tops = [box["y"] for box in boxes.values() if box]
    assert tops == sorted(tops)
    assert len(tops) == 4
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    x, y = page.evaluate("wattlane.stage.map.vehicleScreen(0)")
    page.touchscreen.tap(x, boxes[".wl-map"]["y"] + y)  # type: ignore[index]
    expect(page.locator(".wl-right h2")).to_have_text("Vehicle 0")
    page.goto(f"{dashboard.url}/runs")
    expect(page.locator(".wl-catalogue")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("context", [{"reduced_motion": "reduce"}], indirect=True)
def test_reduced_motion_draws_no_steps_in_between(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}&t=300")
    page.fill("#time", "330")
    page.keyboard.press("Enter")
    page.wait_for_timeout(600)
    before = page.evaluate("wattlane.stage.map.stats.draws")
    page.wait_for_timeout(700)
    assert page.evaluate("wattlane.stage.map.stats.draws") - before <= 2
    assert page.evaluate("wattlane.stage.map.nowX[0] === wattlane.stage.map.frame.x[0]")


def test_colours_have_contrast(dashboard: Any, page: Page) -> None:
    """AA: 4.5 for text, in both schemes, on page and panel."""
    page.goto(f"{dashboard.url}/runs")
    expect(page.locator("h1")).to_be_visible()
    for scheme in ("light", "dark"):
        page.evaluate(f"document.documentElement.dataset.mantineColorScheme = '{scheme}'")
        names = ("page", "panel", "text", "muted", "accent", "live", "mine", "paused", "danger")
        read = """(names) => Object.fromEntries(names.map((name) =>
            [name, getComputedStyle(document.documentElement).getPropertyValue('--wl-' + name)]))"""
        colours = page.evaluate(read, list(names))
        for ink in names[2:]:
            for paper in ("page", "panel"):
                assert contrast(colours[ink], colours[paper]) >= 4.5, (scheme, ink, paper, colours[ink])


def contrast(one: str, other: str) -> float:
    """Ratio of WCAG 2: (lighter + 0.05) / (darker + 0.05)."""

    def luminance(colour: str) -> float:
        match = re.fullmatch(r"\s*#([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})", colour)
        assert match, colour
        parts = [int(part, 16) / 255 for part in match.groups()]
        linear = [p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)
