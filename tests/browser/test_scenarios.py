"""Scenarios: choosing, previews, what the checks found, import by file, starting from here, rename and delete."""

from __future__ import annotations

import re
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

import assets
from engine.scenario.movingai import map_text, random_floor, random_trips, scen_text
from tests.browser.stage import FIRST_FRAME_MS, api, note, open_stage, stop_run

pytestmark = pytest.mark.browser
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
CHECKED = "#scenarios-findings[data-done]"
ERROR = "#scenarios-import-error"
TOML = assets.path("scenarios", "soochow2022.toml").read_text("utf-8").replace('name = "soochow2022"', 'name = "mine"')
WALLED_IN = TOML.replace("Iv^SSSv^SSSv^SSSv^SSSv^#\n#v^SRS", "I#^SSSv^SSSv^SSSv^SSSv^#\n#v^SRS", 1)


@pytest.fixture
def library(dashboard: Any) -> Iterator[str]:
    """The dashboard's address; what a test imported is gone afterwards."""
    yield dashboard.url
    for name in api(dashboard.url, "/api/scenarios")["imported"]:
        request = urllib.request.Request(f"{dashboard.url}/api/scenarios/{name}", method="DELETE")
        urllib.request.urlopen(request, timeout=30).close()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of 12 × 9 cells with 6 trips, a scenario, one with a mistake in it, and one whose checks find errors."""
    import numpy as np

    folder = tmp_path_factory.mktemp("files")
    rng = np.random.default_rng(1)
    instance = random_trips(rng, random_floor(rng, 12, 9, 0.1), 6, "small")
    (folder / "small.map").write_text(map_text(instance.free))
    (folder / "small.scen").write_text(scen_text(instance))
    (folder / "mine.toml").write_text(TOML)
    (folder / "wrong.toml").write_text(TOML.replace("count = 8", 'count = "eight"'))
    (folder / "walled-in.toml").write_text(WALLED_IN.replace('name = "mine"', 'name = "walled-in"'))
    return folder


def opened(page: Page, url: str, name: str = "soochow2022") -> Page:
    page.goto(f"{url}/scenarios?scenario={name}")
    expect(page.locator(f'#scenarios-map[data-shown="{name}"]')).to_be_visible(timeout=30_000)
    return page


def give(page: Page, *paths: Path) -> None:
    page.set_input_files("#scenarios-files", [str(path) for path in paths])


def seen(page: Page, name: str) -> None:
    """Waits until the files were read and previewed."""
    expect(page.locator(f'#scenarios-import[data-seen="{name}"]')).to_be_visible(timeout=30_000)


def post(url: str, *paths: Path, **more: Any) -> str:
    given = [{"name": path.name, "text": path.read_text()} for path in paths]
    return str(api(url, "/api/scenarios", {"files": given, **more})["name"])


def test_a_card_opens_preview_findings_parameters_and_toml(library: str, page: Page) -> None:
    opened(page, library)
    expect(page.locator(".wl-scn-cards .current")).to_contain_text("Soochow thesis 2022")
    for canvas in page.locator(".wl-scn-thumb").all():
        expect(canvas).to_have_attribute("data-drawn", re.compile("."), timeout=20_000)
    expect(page.locator("#scenarios-legend")).to_contain_text("charger")
    expect(page.locator(CHECKED)).to_contain_text("each of 33 stations", timeout=30_000)
    card = page.locator(".wl-scn-cards a", has_text="Soochow floor, orders without end")
    card.focus()
    page.keyboard.press("Enter")
    page.wait_for_url(re.compile(r"scenario=soochow2022-continuous$"))
    expect(page.locator('#scenarios-map[data-shown="soochow2022-continuous"]')).to_be_visible(timeout=30_000)
    expect(page.locator(".wl-scn-cards .current a")).to_be_focused()
    page.get_by_text("TOML", exact=True).click()
    expect(page.locator(".wl-scn-toml")).to_contain_text('name = "soochow2022-continuous"')
    page.get_by_text("Parameters", exact=True).click()
    expect(page.locator(".wl-scn-parameters .changed").first).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download .toml").click()
    text = Path(download.value.path()).read_text("utf-8")
    assert text == assets.path("scenarios", "soochow2022-continuous.toml").read_text("utf-8")


def test_an_unknown_name_gets_the_list_and_a_sentence(library: str, page: Page) -> None:
    page.goto(f"{library}/scenarios?scenario=..%2F..%2Fetc")
    expect(page.locator(".wl-empty")).to_contain_text("unknown scenario '../../etc'")
    expect(page.locator(".wl-scn-cards li")).not_to_have_count(0)
    page.get_by_role("link", name="Show the first one").click()
    expect(page.locator("#scenarios-map[data-shown]")).to_be_visible(timeout=30_000)


def test_a_mistake_is_named_with_its_line_and_the_form_keeps_its_values(
    library: str, page: Page, files: Path, watch: Any
) -> None:
    watch.allow("400")
    opened(page, library)
    give(page, files / "wrong.toml")
    expect(page.locator(ERROR)).to_have_text('wrong.toml, line 50: fleet.count: got "eight", expected a whole number')
    page.fill("#scenarios-import-name", "No Such Name")
    give(page, files / "mine.toml")
    seen(page, "mine")
    expect(page.locator(ERROR)).to_be_empty()
    expect(page.locator("#scenarios-import-name")).to_have_value("No Such Name")
    page.get_by_role("button", name="Import", exact=True).click()
    expect(page.locator(ERROR)).to_contain_text("did you mean 'no-such-name'?")
    page.fill("#scenarios-import-name", "soochow2022")
    page.get_by_role("button", name="Import", exact=True).click()
    expect(page.locator(ERROR)).to_contain_text("there is a scenario 'soochow2022' already")
    page.fill("#scenarios-import-name", "kept")
    page.keyboard.press("Enter")
    page.wait_for_url(re.compile(r"scenario=kept$"))
    expect(page.locator(".wl-scn-cards .current")).to_contain_text("imported")
    assert "kept" in api(library, "/api/scenarios")["imported"]


def test_what_the_checks_found_is_marked_on_the_floor(library: str, page: Page, files: Path) -> None:
    name = post(library, files / "walled-in.toml")
    opened(page, library, name)
    errors = page.locator(f"{CHECKED} .error")
    expect(errors.first).to_contain_text("I2 at (0, 8) has no aisle cell beside it", timeout=30_000)
    expect(page.locator("#scenarios-map")).to_have_attribute("data-marks", re.compile("[1-9]"))
    expect(page.locator("#scenarios-caution")).to_contain_text("The checks found")
    errors.first.get_by_role("button", name="Show on the map").click()
    assert page.evaluate("wattlane.library.map.view.y") == 8.5
    assert page.evaluate("wattlane.library.map.chosen.level") == "error"


def test_map_and_scen_are_previewed_imported_and_run_live(library: str, page: Page, files: Path) -> None:
    opened(page, library)
    give(page, files / "small.map")
    seen(page, "small")
    expect(page.locator("#scenarios-import-seed")).to_be_visible()
    drawn = page.evaluate("wattlane.library.importMap.trips")
    page.fill("#scenarios-import-seed", "5")
    expect(page.locator("#scenarios-import")).to_have_attribute("data-looks", "2", timeout=20_000)
    assert page.evaluate("wattlane.library.importMap.trips") != drawn
    give(page, files / "small.scen")
    expect(page.locator("#scenarios-import-facts")).to_contain_text("6 vehicles")
    expect(page.locator("#scenarios-import-seed")).to_be_hidden()
    page.fill("#scenarios-import-agents", "4")
    expect(page.locator("#scenarios-import-facts")).to_contain_text("4 vehicles")
    offered = page.locator("#scenarios-import-planner option").all_inner_texts()
    assert {"cbs", "ecbs", "prioritized", "time-window"} <= set(offered)
    page.get_by_role("button", name="Import", exact=True).click()
    page.wait_for_url(re.compile(r"scenario=small$"))
    expect(page.locator('#scenarios-map[data-shown="small"]')).to_be_visible(timeout=30_000)
    assert len(page.evaluate("wattlane.library.map.trips")) == 4
    page.fill("#scenarios-fleet", "3")
    page.get_by_role("button", name="Start", exact=True).click()
    page.wait_for_url(re.compile(r"/operate\?run="), timeout=30_000)
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)
    expect(page.locator(".wl-left")).to_contain_text("3 vehicles")
    made = re.search(r"run=([^&]+)", page.url)
    assert made
    status = api(library, f"/api/runs/{made[1]}")
    assert (status["scenario"], status["planner"], status["fleet"]) == ("small", "prioritized", 3)
    open_stage(page, f"{library}/replay?run={made[1]}&t=1")
    assert page.evaluate("wattlane.stage.map.n") == 3
    if api(library, f"/api/runs/{made[1]}")["alive"]:
        stop_run(library, made[1])


def test_files_can_be_dropped(library: str, page: Page, files: Path) -> None:
    opened(page, library)
    page.evaluate(
        """(files) => {
            const dropped = new DataTransfer();
            for (const [name, text] of files) dropped.items.add(new File([text], name));
            document.querySelector('.wl-scenarios').dispatchEvent(
                new DragEvent('drop', { dataTransfer: dropped, bubbles: true, cancelable: true }));
        }""",
        [[file.name, file.read_text()] for file in (files / "small.map", files / "small.scen")],
    )
    seen(page, "small")
    expect(page.locator(".wl-scn-files")).to_have_text(re.compile(r"small\.map.*small\.scen", re.DOTALL))
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#scenarios-map")).to_be_visible()
    expect(page.locator("#scenarios-import")).to_be_hidden()


def test_a_huge_file_is_refused_before_it_is_sent(library: str, page: Page, tmp_path: Path) -> None:
    opened(page, library)
    (tmp_path / "huge.map").write_bytes(b"." * (50 * 2**20))
    (tmp_path / "picture.map").write_bytes(b"\xff\xfe\x00")
    give(page, tmp_path / "huge.map")
    expect(page.locator(ERROR)).to_have_text("huge.map: at most 6.0 MB can be imported; got 50.0 MB")
    give(page, tmp_path / "picture.map")
    expect(page.locator(ERROR)).to_have_text("picture.map: UTF-8 text was expected")
    assert api(library, "/healthz")["status"] == "ok"


def test_rename_and_delete_ask_first(library: str, page: Page, files: Path, watch: Any) -> None:
    watch.allow("400")
    opened(page, library, post(library, files / "mine.toml"))
    page.get_by_role("button", name="Rename…").click()
    page.fill("#wl-prompt", "../up")
    page.get_by_role("button", name="Save").click()
    note(page, "Not renamed")
    page.get_by_role("button", name="Rename…").click()
    page.fill("#wl-prompt", "yours")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url(re.compile(r"scenario=yours$"))
    expect(page.locator(".wl-scn-head code")).to_have_text("yours")
    page.get_by_role("button", name="Delete…").click()
    page.get_by_role("button", name="Cancel").click()
    assert api(library, "/api/scenarios")["imported"] == ["yours"]
    page.get_by_role("button", name="Delete…").click()
    page.locator("dialog").get_by_role("button", name="Delete").click()
    page.wait_for_url(re.compile(r"/scenarios$"))
    expect(page.locator(".wl-scn-cards li", has_text="imported")).to_have_count(0)
    opened(page, library, "soochow2022")
    expect(page.get_by_role("button", name="Delete…")).to_have_count(0)


def test_operate_offers_imported_scenarios_and_the_planners_that_fit(library: str, page: Page, files: Path) -> None:
    post(library, files / "small.map", files / "small.scen", name="small", planner="cbs")
    recorded = next(run["run_id"] for run in api(library, "/api/runs") if not run["alive"])
    page.goto(f"{library}/operate?run={recorded}")
    page.locator("#start-scenario").click()
    page.get_by_role("option", name=re.compile("small: 6 vehicles")).click()
    expect(page.locator("#start-planner")).to_have_value("cbs")
    expect(page.locator("#start-rate")).to_be_disabled()
    page.locator("#start-planner").click()
    expect(page.get_by_role("option", name="ecbs")).to_be_visible()


@pytest.mark.parametrize("context", [PHONE, PHONE | {"color_scheme": "dark"}], indirect=True, ids=["light", "dark"])
def test_on_a_phone_nothing_sticks_out(library: str, page: Page, files: Path) -> None:
    opened(page, library, "warehouse-large")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    cards = page.locator(".wl-scn-cards .current").bounding_box()
    assert cards
    assert 0 <= cards["x"] <= 390, "the chosen card is in view"
    give(page, files / "small.map", files / "small.scen")
    seen(page, "small")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_preview_moves_by_keys_and_follows_the_scheme(library: str, page: Page) -> None:
    opened(page, library)
    canvas = page.locator("#scenarios-map canvas").first
    canvas.focus()
    before = page.evaluate("wattlane.library.map.view")
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    after = page.evaluate("wattlane.library.map.view")
    assert after["scale"] > before["scale"]
    assert after["x"] > before["x"]
    page.keyboard.press("r")
    assert page.evaluate("wattlane.library.map.view") == before
    light = page.evaluate("wattlane.library.map.palette.aisle")
    page.get_by_role("button", name="Light or dark").click()
    expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
    expect(page.locator("#scenarios-map")).to_have_attribute("data-scheme", "dark")
    assert page.evaluate("wattlane.library.map.palette.aisle") != light
