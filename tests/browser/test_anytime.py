"""The lesson on AD*: passes and ε, ground that is changed and repaired, the paper's traits, and the address."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import until
from tests.browser.test_learn import DARK, PHONE, after, answers, open_lesson

pytestmark = pytest.mark.browser
ENDS = "ground=bumps56x42s2&start=4.4&goal=51.37"
SMALL = "/learn/anytime?ground=flat24x20s1&start=3.10&goal=20.10&lower=0.5"


def at(page: Page, x: int, y: int) -> tuple[float, float]:
    """Where a cell is on the page."""
    spot = page.evaluate(
        "([x, y]) => { const v = wattlane.lesson.view; return v.place(x + y * v.floor.width); }", [x, y]
    )
    return spot[0], spot[1]


def drag(page: Page, *cells: tuple[int, int]) -> None:
    """Presses on the first cell, goes through the others, lets go, and waits for what that changes."""
    before = answers(page)
    page.mouse.move(*at(page, *cells[0]))
    page.mouse.down()
    for cell in cells[1:]:
        page.mouse.move(*at(page, *cell), steps=3)
    page.mouse.up()
    after(page, before)


def colour(page: Page, x: int, y: int) -> tuple[int, int, int]:
    """Red, green and blue of a spot beside a cell's middle."""
    found = page.evaluate(
        """([x, y]) => { const v = wattlane.lesson.view, g = v.geometry, ratio = v.canvas.width / v.canvas.clientWidth;
        const cell = x + y * g.width, spot = [g.left(cell) + g.size * 0.15, g.top(cell) + g.size * 0.85];
        return [...v.canvas.getContext('2d').getImageData(spot[0] * ratio, spot[1] * ratio, 1, 1).data]; }""",
        [x, y],
    )
    return found[0], found[1], found[2]


def test_passes_are_played_and_epsilon_is_moved(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/anytime")
    status, slider = page.locator(".wl-lesson-status"), page.get_by_label("ε of the pass that is shown")
    expect(page.get_by_role("button", name="Anytime", exact=True)).to_have_attribute("aria-pressed", "true")
    expect(status).to_contain_text("only the goal waits in OPEN")
    slider.fill("0")
    expect(status).to_have_text(
        "ε = 2.5: after 126 expansions a way for 1,309.2 J, proven to cost at most 2.50 times the least; "
        "in truth it costs 1.118 times the least."
    )
    fresh = page.evaluate("[...wattlane.lesson.bitsAt()].findIndex((bits, cell) => bits >> 4 > 1 && cell % 56 < 50)")
    (red, _, blue), (red_beside, _, blue_beside) = colour(page, fresh % 56, fresh // 56), colour(page, 2, 30)
    assert blue - red > 40 > abs(blue_beside - red_beside), "expanded cells are blue, the ground is grey"
    expect(page).to_have_url(re.compile(rf"\?{ENDS}&step=5$"))
    slider.fill("6")
    expect(status).to_contain_text("ε = 1.0: after 5,450 expansions a way for 1,171.2 J, and it is proven to be the")
    rows = page.locator(".wl-anytime-table tbody tr")
    expect(rows).to_have_count(7)
    expect(page.locator(".wl-anytime-table tr.current td").first).to_have_text("ε = 1.0")
    page.locator("body").click(position={"x": 5, "y": 60})
    page.keyboard.press("ArrowLeft")
    expect(status).to_contain_text("states expanded of 5,450 in this pass")
    expect(page.locator(".wl-lesson-counts")).to_contain_text("1.25 × least")
    page.keyboard.press("Home")
    page.get_by_label("Steps per second").select_option("100")
    page.get_by_role("button", name="Play (Space)").click()
    expect(page.get_by_label("Step number")).to_have_value("49")
    expect(page.locator(".wl-lesson-curve path")).to_have_count(2)


def test_changed_ground_is_repaired_and_its_address_reopens_it(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/anytime?{ENDS}")
    page.get_by_role("button", name="Obstacle", exact=True).click()
    drag(page, (8, 7))
    # what is touched is shown at once: the end of the repair
    expect(page.locator(".wl-lesson-counts")).to_contain_text("1,710 of 1,710")
    verdict = page.locator(".wl-anytime-verdict")
    expect(verdict).to_contain_text("Repair expands 1,710 states, planning anew 10,349.")
    expect(verdict.locator(".wl-anytime-bar.chosen")).to_have_text("repair1,710")
    page.get_by_role("button", name="Raise", exact=True).click()
    drag(page, (20, 3), (26, 3))
    expect(page.locator(".wl-anytime-changes li")).to_have_count(2)
    until(page, "location.search.includes('changes=o1_8.7~r4_20.3-23.3-26.3&')")
    address, status = page.url, page.locator(".wl-lesson-status").inner_text()
    page.goto("about:blank")
    open_lesson(page, address)
    expect(page.locator(".wl-lesson-status")).to_have_text(status)
    page.get_by_role("button", name="obstacles dropped at (8, 7)").click()
    expect(page.locator(".wl-lesson-counts")).to_contain_text("1,710 of 1,710")
    before = answers(page)
    page.get_by_role("button", name="Take back").click()
    after(page, before)
    expect(verdict).to_have_count(1)
    before = answers(page)
    page.get_by_label("Anew above so many per cent").fill("2")
    page.keyboard.press("Enter")
    after(page, before)
    expect(verdict).to_contain_text("The rule (anew above 2 %) begins anew: here the wrong choice.")
    before = answers(page)
    page.get_by_role("button", name="Remove change 1").click()
    after(page, before)
    expect(verdict).to_have_count(0)


def test_a_change_comes_after_the_pass_that_is_shown(dashboard: Any, page: Page) -> None:
    open_lesson(page, dashboard.url + SMALL)
    page.get_by_label("ε of the pass that is shown").fill("1")
    expect(page.locator(".wl-lesson-status")).to_contain_text("ε = 2.0:")
    page.get_by_role("button", name="Obstacle", exact=True).click()
    drag(page, (12, 10))
    until(page, "location.search.includes('changes=o1e2000_12.10&')")
    expect(page.locator(".wl-lesson-status")).to_contain_text("ε = 2.0: after")
    before = answers(page)
    page.get_by_label("Raise ε again after a change").check()
    after(page, before)
    expect(page.locator(".wl-lesson-status")).to_contain_text("ε = 2.5: after")
    before = answers(page)
    page.get_by_role("button", name="Drive on").click()
    after(page, before)
    expect(page.locator(".wl-anytime-changes li").nth(1)).to_contain_text("8 trajectories driven, ε = 2.5")
    expect(page.locator(".wl-anytime-verdict").first).to_contain_text("only keys change")


def test_ends_are_dragged_and_the_ground_is_edited_with_the_keyboard(dashboard: Any, page: Page) -> None:
    open_lesson(page, dashboard.url + SMALL)
    drag(page, (20, 10), (18, 15))
    until(page, "wattlane.lesson.state.goal == '18.15'")
    page.locator(".wl-lesson-canvas").focus()
    for key in ("ArrowRight", "ArrowRight", "ArrowRight"):
        page.keyboard.press(key)
    before = answers(page)
    page.keyboard.press("Enter")
    after(page, before)
    until(page, "wattlane.lesson.state.changes == 'r4e2500_5.10'")
    expect(page.locator(".wl-tip")).to_contain_text("0.12 m high")
    before = answers(page)
    page.keyboard.press("s")
    after(page, before)
    until(page, "wattlane.lesson.state.start == '5.10'")
    page.get_by_role("button", name="Obstacle", exact=True).click()
    page.get_by_label("Radius of the brush in cells").fill("4")
    drag(page, (18, 12))
    expect(page.locator(".wl-lesson-status")).to_contain_text("There is no way.")
    before = answers(page)
    page.get_by_label("Class of ground").select_option("craters")
    after(page, before)
    until(page, "location.search.includes('ground=craters24x20s1') && !location.search.includes('changes')")


def test_the_paper_s_traits_say_what_goes_wrong(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/anytime")
    page.get_by_role("button", name="Printed: height sign").click()
    alert = page.get_by_role("alert").filter(has_text="Height sign as printed")
    expect(alert).to_contain_text("it costs 1.333 times the least")
    expect(page.locator(".wl-lesson-status")).to_contain_text("the bound is broken")
    expect(page.locator(".wl-anytime-broken").last).to_have_text("1.333 !")
    before = answers(page)
    page.get_by_label("Height sign of h as printed").uncheck()
    after(page, before)
    expect(alert).to_have_count(0)
    expect(page.locator(".wl-lesson-status")).to_contain_text("proven to be the least")
    before = answers(page)
    page.get_by_role("button", name="Printed: anew").click()
    after(page, before)
    expect(page.get_by_role("alert")).to_contain_text("19,959 expansions more than repair")


@pytest.mark.parametrize("context", [{**PHONE, **DARK}], indirect=True)
def test_on_a_phone_in_the_dark(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/anytime?{ENDS}&changes=o1_8.7&step=62")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    expect(page.get_by_role("button", name="Look only")).to_have_attribute("aria-pressed", "true")
    page.touchscreen.tap(*at(page, 8, 7))
    expect(page.locator(".wl-tip")).to_contain_text("obstacle")
    page.get_by_label("ε of the pass that is shown").scroll_into_view_if_needed()
    expect(page.get_by_label("ε of the pass that is shown")).to_be_visible()


def test_a_bad_ground_says_so(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/anytime?ground=bumps80x42s2")
    expect(page.get_by_role("alert").filter(has_text="sides of 20 to 60 cells were expected, got 80")).to_be_visible()
    expect(page.locator(".wl-lesson-group .wl-button").first).to_have_attribute("aria-pressed", "true")
