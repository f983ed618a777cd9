"""Replay: the catalogue, and a recorded run scrubbed, linked to, forked and downloaded."""

from __future__ import annotations

import re
import uuid
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import FIRST_FRAME_MS, api, at_time, chip, note, open_stage, past_time, stop_run, tab, until
from tests.synthetic import make_run

pytestmark = pytest.mark.browser


@pytest.fixture
def recorded(dashboard: Any) -> str:
    """A recorded run of half an hour, with a block, a breakdown and commands."""
    run_id = f"20261122-101500-synthetic-{uuid.uuid4().hex[:4]}"
    return make_run(dashboard.data / "runs", run_id=run_id)


@pytest.fixture
def replayed(dashboard: Any, kept_page: Page, recorded: str) -> Page:
    page = kept_page
    open_stage(page, f"{dashboard.url}/replay?run={recorded}")
    return page


def test_the_catalogue_renames_and_deletes(dashboard: Any, kept_page: Page, recorded: str) -> None:
    page = kept_page
    page.goto(f"{dashboard.url}/runs")
    row = page.locator("tr", has_text=recorded)
    expect(row).to_contain_text("00:30:00")
    row.get_by_role("button", name="Rename…").click()
    page.fill("#wl-prompt", "Ring <b>one</b>")
    page.keyboard.press("Enter")
    note(page, "Renamed")
    expect(row.get_by_role("link", name="Ring <b>one</b>")).to_be_visible()
    row.get_by_role("button", name="Delete…").click()
    dialog = page.locator(".wl-dialog")
    expect(dialog).to_contain_text("gone for good")
    dialog.get_by_role("button", name="Cancel").click()
    expect(row).to_have_count(1)
    row.get_by_role("button", name="Delete…").click()
    dialog.get_by_role("button", name="Delete", exact=True).click()
    expect(row).to_have_count(0)


def test_any_moment_is_reached_forwards_and_backwards(replayed: Page) -> None:
    page = replayed
    chip(page, "REPLAY")
    at_time(page, 0)
    for typed, seconds in (("00:12:30", 750), ("90s", 90), ("600", 600), ("20:00", 1200)):
        page.fill("#time", typed)
        page.keyboard.press("Enter")
        expect(page.locator("#time")).not_to_be_focused()
        at_time(page, seconds)
    page.fill("#time", "soon")
    page.keyboard.press("Enter")
    note(page, "Not a time")
    page.keyboard.press("Escape")
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowLeft")
    at_time(page, 1189)
    page.keyboard.press("End")
    at_time(page, 1800)
    page.keyboard.press("Home")
    at_time(page, 0)


def test_it_plays_on_its_own_clock(replayed: Page) -> None:
    page = replayed
    page.locator("#speed").select_option("16")
    page.get_by_label("Play my view (Space)").click()
    past_time(page, 20)
    moved = page.evaluate("Array.from(wattlane.stage.map.nowX).join()")
    until(page, f"Array.from(wattlane.stage.map.nowX).join() !== '{moved}'")
    page.get_by_label("Pause my view (Space)").click()
    expect(page.get_by_label("Play my view (Space)")).to_be_visible()
    still = page.evaluate("wattlane.stage.time")
    page.wait_for_timeout(500)
    assert page.evaluate("wattlane.stage.time") == still


def test_the_map_shows_what_the_log_says(dashboard: Any, replayed: Page, recorded: str) -> None:
    page = replayed
    page.fill("#time", "777")
    page.keyboard.press("Enter")
    until(page, "wattlane.stage.map.frame.time === 777 && !wattlane.stage.map.moving")
    fleet = api(dashboard.url, f"/api/runs/{recorded}/view?t=777&parts=fleet")["fleet"]
    for row in fleet:
        v = row["vehicle"]
        x, y = page.evaluate(f"[wattlane.stage.map.nowX[{v}], wattlane.stage.map.nowY[{v}]]")
        assert (x, y) == (pytest.approx(row["x"], abs=0.01), pytest.approx(row["y"], abs=0.01))


def test_a_copied_link_opens_the_same_view(dashboard: Any, replayed: Page) -> None:
    page = replayed
    page.fill("#time", "500")
    page.keyboard.press("Enter")
    tab(page, "Fleet")
    page.locator("#fleet-grid .ag-center-cols-container [row-id='2'] [col-id='state']").click()
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("g")
    page.keyboard.press("h")
    until(page, "['t=500', 'sel=v2', 'tab=fleet'].every((word) => location.search.slice(1).split('&').includes(word))")
    link = page.url
    page.goto("about:blank")
    open_stage(page, link)
    expect(page.locator(".wl-right h2")).to_have_text("Vehicle 2")
    expect(page.get_by_role("tab", name="Fleet", exact=True)).to_have_attribute("aria-selected", "true")
    layers = page.evaluate("wattlane.stage.map.layers")
    assert layers["grid"] is True
    assert layers["heat"] == "occupancy"
    at_time(page, 500)
    expect(page).to_have_url(link)


def test_an_event_leads_to_its_time_and_place(replayed: Page) -> None:
    page = replayed
    page.keyboard.press("End")
    tab(page, "Events")
    row = page.locator("#events-grid .ag-row").first
    when = row.locator("[col-id='time_s']")
    expect(when).to_have_text(re.compile(r"\d\d:\d\d:\d\d"))
    begun = when.inner_text()
    row.locator("[col-id='text']").click()
    expect(row).to_have_class(re.compile("ag-row-selected"))
    at_time(page, 1800)
    row.locator("[col-id='text']").dblclick()
    expect(page.locator(".wl-clock")).to_have_text(begun)
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("End")
    at_time(page, 1800)
    row = page.locator("#events-grid .ag-row[row-index='2']")
    begun = row.locator("[col-id='time_s']").inner_text()
    row.locator("[col-id='text']").click()
    page.keyboard.press("Enter")
    expect(page.locator(".wl-clock")).to_have_text(begun)
    page.keyboard.press("Home")
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("Control+ArrowRight")
    expect(page.locator(".wl-clock")).not_to_have_text("00:00:00")


def test_commands_of_a_recorded_run_are_refused(replayed: Page) -> None:
    page = replayed
    tab(page, "Fleet")
    page.locator("#fleet-grid .ag-center-cols-container [row-id='1'] [col-id='state']").click()
    expect(page.locator(".wl-right h2")).to_have_text("Vehicle 1")
    assert page.locator(".wl-right").get_by_role("button").all_inner_texts()[-1] == "Follow"
    page.evaluate("wattlane.command({do: 'pause', vehicle: 1})")
    note(page, "Not a live run")


def test_downloads(replayed: Page, recorded: str) -> None:
    page = replayed
    for word, ending in (("CSV", "csv.zip"), ("Parquet", "parquet.zip")):
        with page.expect_download() as download:
            page.get_by_role("link", name=word).click()
        assert download.value.suggested_filename == f"{recorded}-{ending}"


def test_a_fork_is_a_live_run_with_a_parent(dashboard: Any, kept_page: Page) -> None:
    page = kept_page
    live = api(dashboard.url, "/api/runs", {"scenario": "soochow2022-continuous", "seed": 3, "speed": 64})["run_id"]
    open_stage(page, f"{dashboard.url}/operate?run={live}")
    past_time(page, 60)
    stop_run(dashboard.url, live)
    open_stage(page, f"{dashboard.url}/replay?run={live}&t=40")
    page.fill("#fork-seed", "99")
    page.get_by_role("button", name="Fork from here").click()
    page.wait_for_url(re.compile(r"/operate\?run="))
    expect(page.locator(".wl-left")).to_contain_text(f"{live} at tick 40")
    fork = re.search(r"run=([^&]+)", page.url)
    assert fork
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)
    past_time(page, 41)
    chip(page, "LIVE")
    stop_run(dashboard.url, fork[1])


def test_vehicles_are_coloured_by_what_is_chosen(dashboard: Any, replayed: Page, recorded: str) -> None:
    page = replayed
    page.fill("#time", "400")
    page.keyboard.press("Enter")
    until(page, "wattlane.stage.map.frame.time === 400")
    page.get_by_label("Layers", exact=True).click()
    colour, legend = page.get_by_label("Colour by"), page.locator(".wl-legend")
    for choice, word in (("number", "and so on"), ("state of charge", "75 %"), ("task", "to deliver")):
        colour.select_option(label=choice)
        expect(legend).to_contain_text(word)
    fleet = api(dashboard.url, f"/api/runs/{recorded}/view?t=400&parts=fleet")["fleet"]
    for row in fleet:
        said = page.evaluate("(id) => wattlane.stage.map.describe({ kind: 'vehicle', id })", row["vehicle"])
        assert row["task"] in said
    colour.select_option(label="energy rate")
    expect(legend).to_contain_text(re.compile(r"\d+ W"))
    power = api(dashboard.url, f"/api/runs/{recorded}/power?t=400")["values"]
    assert page.evaluate("wattlane.stage.map.power") == power
    assert "by-power" in page.url
