"""The frame: pages that exist, sentences for those that don't, light and dark, phone width, help, reduced motion."""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import FIRST_FRAME_MS, api, open_stage, stop_run, until, vehicle_at
from tests.synthetic import make_run

pytestmark = pytest.mark.browser
ORDER = ("Operate", "Replay", "Compare", "Learn", "Papers", "Scenarios")
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="module")
def recorded(dashboard: Any) -> str:
    return make_run(dashboard.data / "runs", run_id=f"20261122-101500-synthetic-{uuid.uuid4().hex[:4]}")


@pytest.mark.parametrize("context", [{}, PHONE], indirect=True, ids=["desktop", "phone"])
def test_navigation_leads_only_to_what_exists(dashboard: Any, page: Page) -> None:
    """Every page of the bar is there in light and dark, nothing sticks out, the console stays empty (see `page`)."""
    page.goto(f"{dashboard.url}/runs")
    links = page.locator(".wl-nav a")
    expect(links.first).to_be_visible()
    words = links.all_inner_texts()
    assert words == [word for word in ORDER if word in words]
    schemes = ["light", "dark"]
    for word in words:
        link = page.locator(".wl-nav a", has_text=word)
        link.click()
        expect(link).to_have_class("current")
        expect(page.locator("#page > .wl-loading")).to_have_count(0)
        expect(page.locator("#page > *").first).to_be_visible()
        expect(page.locator(".wl-empty", has_text="can't be shown")).to_have_count(0)
        for scheme in schemes:
            if scheme != page.locator("html").get_attribute("data-mantine-color-scheme"):
                page.get_by_role("button", name="Light or dark").click()
            expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", scheme)
            wide = page.evaluate("Math.max(document.documentElement.scrollWidth, document.body.scrollWidth)")
            assert wide <= page.viewport_size["width"], (word, scheme)  # type: ignore[index]
        schemes.reverse()
    page.locator(".wl-nav a", has_text="Replay").click()
    expect(page.locator("h1")).to_have_text("Runs")


def test_a_stage_ends_with_its_page(dashboard: Any, page: Page, recorded: str) -> None:
    """However soon a page is left: nothing goes on in it, and nothing is said to components that are gone."""
    address = f"{dashboard.url}/replay?run={recorded}&t=300"
    open_stage(page, address)
    for _ in range(3):
        page.locator(".wl-nav a", has_text="Replay").click()
        expect(page.locator(".wl-catalogue")).to_be_visible()
        until(page, "wattlane.stage === null")
        expect(page.locator(".wl-chip")).to_have_count(0)
        page.locator("tr", has_text=recorded).get_by_role("link", name="Replay", exact=True).click()
        expect(page.locator(".wl-chip")).to_have_text("REPLAY")
        until(page, "wattlane.stage.pulseNumber > 0")


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
    until(page, "wattlane.stage.time >= 1", FIRST_FRAME_MS)
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
    until(page, f"wattlane.stage.map.palette.aisle !== '{floor}'")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
    page.wait_for_selector("#map[data-frames]")
    expect(page.locator("#soc-graph .xtick text").first).to_have_css("fill", "rgb(154, 167, 180)")


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
    expect(page.locator(".wl-right h2")).to_have_text("Fleet")
    parts = (".wl-map", ".wl-transport", ".wl-right", ".wl-left")
    tops = [page.locator(name).bounding_box()["y"] for name in parts]  # type: ignore[index]
    assert tops == sorted(tops)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.touchscreen.tap(*vehicle_at(page, 0)())
    expect(page.locator(".wl-right h2")).to_have_text("Vehicle 0")
    page.goto(f"{dashboard.url}/runs")
    expect(page.locator(".wl-catalogue")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("context", [PHONE], indirect=True)
def test_two_fingers_zoom_and_a_long_press_opens_the_menu(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}&t=300")
    expect(page.locator(".wl-right h2")).to_have_text("Fleet")
    fingers = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    box = page.locator(".wl-map-canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    scale = page.evaluate("wattlane.stage.map.view.scale")
    touch("touchStart", (x - 30, y), (x + 30, y))
    for wide in (40, 50, 60):
        touch("touchMove", (x - wide, y), (x + wide, y))
    touch("touchEnd")
    until(page, f"Math.abs(wattlane.stage.map.view.scale / {scale} - 2) < 0.1")
    expect(page.get_by_role("menu")).to_have_count(0)
    page.get_by_label("Fit the floor (R)").click()
    touch("touchStart", vehicle_at(page, 0)())
    expect(page.get_by_role("menuitem", name="Follow")).to_be_visible()
    touch("touchEnd")


@pytest.mark.parametrize("context", [{"reduced_motion": "reduce"}], indirect=True)
def test_reduced_motion_draws_no_steps_in_between(dashboard: Any, page: Page, recorded: str) -> None:
    open_stage(page, f"{dashboard.url}/replay?run={recorded}&t=300")
    page.evaluate("""() => {
      const m = wattlane.stage.map, draw = m._drawFleet.bind(m);
      window.drawn = [];
      m._drawFleet = (...args) => { window.drawn.push(Array.from(m.nowX).join()); draw(...args); };
    }""")
    page.fill("#time", "330")
    page.keyboard.press("Enter")
    until(page, "wattlane.stage.map.frame.time === 330 && !wattlane.stage.map.moving")
    until(page, "window.drawn.at(-1) === Array.from(wattlane.stage.map.frame.x).join()")
    assert page.evaluate("new Set(window.drawn).size") <= 2, "where they were, and where they are"


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
