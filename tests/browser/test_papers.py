"""Papers: the shipped result, a run of one's own with its progress, cancelling it, and that all of it stays."""

from __future__ import annotations

import json
import re
import urllib.request
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import until
from tests.browser.test_pages import PHONE

pytestmark = pytest.mark.browser
COMPUTED_MS = 600_000
"""A first run compiles kernels."""
CHARTS = 10
"""Of xu2025: five of lines, five floors."""


def open_papers(page: Page, url: str, query: str = "", charts: int = CHARTS) -> None:
    """Opens the page and returns once its figures are drawn."""
    page.goto(f"{url}/papers{query}")
    expect(page.locator(".wl-papers-table")).to_be_visible()
    drawn(page, charts)


def ending(words: str) -> re.Pattern[str]:
    """What a field's value ends with."""
    return re.compile(re.escape(words) + "$")


def drawn(page: Page, charts: int = CHARTS) -> None:
    """Every chart is there: one that is taken away while it is drawn complains."""
    expect(page.locator(".wl-papers-chart .xaxislayer-above")).to_have_count(charts, timeout=60_000)


def test_what_ships_is_shown_with_its_table_and_figures(dashboard: Any, page: Page) -> None:
    open_papers(page, dashboard.url)
    expect(page.locator(".wl-nav a.current")).to_have_text("Papers")
    expect(page.locator("h1")).to_contain_text("EEA* and E-CBS")
    table = page.locator(".wl-papers-table")
    expect(table.locator("tbody")).to_have_count(3)
    expect(table.get_by_text("energy saved by E-CBS over CBS")).to_be_visible()
    words = [text.split()[:2] for text in table.locator(".wl-badge").all_inner_texts()]
    assert words
    assert all(sign + word.rstrip(",") in ("✓inside", "▲outside", "▼outside") for sign, word in words), words
    expect(page.get_by_text("no breach in")).to_be_visible()
    expect(page.locator(".wl-facts", has_text="tie rule of A*")).to_contain_text("fifo")
    expect(page.locator("#papers-result")).to_have_value(ending("came with the program"))
    for name in ("Figure 7", "Figure 8", "Figure 10"):
        expect(page.locator("figcaption", has_text=name)).to_be_visible()
    expect(page.locator(".wl-papers-floor")).to_have_count(5)
    for kind in ("JSON", "Markdown", "HTML with figures"):
        address = page.get_by_role("link", name=kind, exact=True).get_attribute("href")
        with urllib.request.urlopen(dashboard.url + str(address), timeout=60) as answer:
            assert answer.status == 200
            if kind == "JSON":
                assert json.load(answer)["study"] == "xu2025"


def test_figures_follow_light_and_dark(dashboard: Any, page: Page) -> None:
    open_papers(page, dashboard.url, "?study=xu2025")
    word = page.locator(".wl-papers-chart .xtick text").first
    expect(word).to_have_css("fill", "rgb(83, 96, 111)")
    page.get_by_role("button", name="Light or dark").click()
    expect(word).to_have_css("fill", "rgb(154, 167, 180)")
    drawn(page)


@pytest.mark.parametrize("context", [PHONE], indirect=True)
def test_on_a_phone_nothing_sticks_out(dashboard: Any, page: Page) -> None:
    open_papers(page, dashboard.url)
    until(page, "document.documentElement.scrollWidth <= 390")
    tops = [page.locator(name).bounding_box() for name in (".wl-papers-side", ".wl-papers-main")]
    assert tops[0]["y"] < tops[1]["y"]  # type: ignore[index]


def test_a_run_is_cancelled_and_another_one_finishes_and_stays(dashboard: Any, page: Page) -> None:
    open_papers(page, dashboard.url)
    page.locator("#papers-maps").fill("500")
    page.get_by_role("button", name="Run", exact=True).click()
    progress = page.locator(".wl-papers-progress")
    expect(progress).to_contain_text("elapsed")
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    expect(progress).to_contain_text("of 6000 cells", timeout=COMPUTED_MS)
    expect(progress).to_contain_text("remaining", timeout=COMPUTED_MS)
    page.reload()
    drawn(page)
    expect(progress).to_contain_text("of 6000 cells")
    page.get_by_role("button", name="Cancel").click()
    ended = page.locator(".wl-banner", has_text="Cancelled")
    expect(ended).to_be_visible(timeout=30_000)
    expect(ended).to_contain_text("are kept")
    expect(page.locator("#papers-result")).to_have_value(ending("came with the program"))

    page.locator("#papers-maps").fill("1")
    page.get_by_role("button", name="Run", exact=True).click()
    expect(page.locator("#papers-result")).to_have_value(ending("your own"), timeout=COMPUTED_MS)
    expect(progress).to_have_count(0)
    drawn(page)
    page.reload()
    drawn(page)
    expect(page.locator("#papers-result")).to_have_value(ending("1 maps · seed 11 · your own"))

    page.locator("#papers-result").click()
    page.get_by_role("option", name="came with the program").click()
    expect(page.locator("#papers-result")).to_have_value(ending("came with the program"))
    until(page, "location.href.endsWith('/papers?study=xu2025&result=shipped')")
    drawn(page)


def test_what_is_not_there_is_a_sentence(dashboard: Any, page: Page) -> None:
    page.goto(f"{dashboard.url}/papers?study=xu2024")
    expect(page.locator(".wl-empty")).to_contain_text("unknown study 'xu2024'; did you mean 'xu2025'?")
    page.goto(f"{dashboard.url}/papers?study=xu2025&result=..%2F..%2Fetc")
    expect(page.locator(".wl-empty")).to_contain_text("is no result of a study")


def test_a_row_leads_to_its_runs(dashboard: Any, page: Page) -> None:
    """The form of Compare is filled with what the row was computed from; nothing is started yet."""
    open_papers(page, dashboard.url, "?study=lian2024", charts=12)
    rows = page.locator(".wl-papers-table tbody", has_text="Experiment 5").locator("tr", has_text="15 AGVs, stochastic")
    rows.get_by_role("link", name="Compare").click()
    expect(page.locator("#compare-length")).to_have_value("1h")
    expect(page.locator("#compare-seed")).to_have_value("11000")
    expect(page.locator("#compare-changes")).to_have_value("fleet.count = 15")
    chosen = page.locator(".wl-compare-start").get_by_text(re.compile("^(stochastic|astar-turns)$"))
    expect(chosen.filter(visible=True)).to_have_count(2)
