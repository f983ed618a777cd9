"""The ground in 3-D: drawn when it is asked for and not before, turned by keys, and a plain word without WebGL."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, Request, expect

from app.theme import GROUND
from tests.browser.stage import FIRST_FRAME_MS, api, chip, open_stage, past_time, stop_run, until
from tests.synthetic import make_run

pytestmark = pytest.mark.browser
SMALL = {
    "floor.terrain.width_m": 16,
    "floor.terrain.length_m": 14,
    "floor.terrain.hills": 5,
    "floor.terrain.obstacles": 6,
    "floor.terrain.clear": [[2.1, 2.1], [13.1, 11.1]],
    "fleet.start": [[10, 10]],
    "orders.goals": [[65, 55]],
}
PLOT = "document.querySelector('#ground3d-host .js-plotly-plot')"
EYE = f"(() => {{ const {{ x, y, z }} = {PLOT}._fullLayout.scene.camera.eye; return [x, y, z]; }})()"
HEIGHTS = f"{PLOT}._fullData[1].z.reduce((sum, row) => sum + row.reduce((part, z) => part + z, 0), 0)"
"""Sum of the heights of the pale surface."""
TOLD = re.compile(r"\d+ % of the ground has been seen")


@pytest.fixture(scope="module")
def run(dashboard: Any) -> Iterator[str]:
    """A live run on 16 m × 14 m that pauses after its first six seconds."""
    made = api(dashboard.url, "/api/runs", {"scenario": "zhang2021", "paused": True, "overrides": SMALL})
    api(dashboard.url, f"/api/runs/{made['run_id']}/control", {"op": "step", "ticks": 60})
    yield made["run_id"]
    stop_run(dashboard.url, made["run_id"])


@pytest.fixture
def asked(request: pytest.FixtureRequest) -> list[str]:
    """What the page has asked the server of the 3-D view; fills as it goes."""
    found: list[str] = []

    def note(sent: Request) -> None:
        if "ground3d-asked" in (sent.post_data or "") and "_dash-update" in sent.url:
            found.append(sent.post_data or "")

    page = request.getfixturevalue("webgl_page" if "webgl_page" in request.fixturenames else "page")
    page.on("request", note)
    return found


def opened(page: Page) -> None:
    """Opens the window by keyboard, and returns once the picture is drawn."""
    page.get_by_role("button", name="The ground in 3-D").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog", name="The ground in 3-D")).to_be_visible()
    expect(page.locator("#ground3d-note")).to_have_text(TOLD, timeout=FIRST_FRAME_MS)
    until(page, f"{PLOT} && {PLOT}._fullLayout.scene && {PLOT}._fullLayout.scene._scene")


def share(page: Page, colour: str, within: int = 40) -> float:
    """Share of the picture's pixels near a colour of the theme: ground is lit, so not every one is exact."""
    shot = page.locator("#ground3d-host").screenshot()
    picture = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return float((np.abs(picture - wanted).max(-1) <= within).mean())


def drawn(page: Page, scheme: str) -> None:
    """Waits until seen and unseen ground are in the picture."""
    for name in ("low", "unseen-low"):
        found = 0.0
        for _ in range(60):
            found = share(page, GROUND[scheme][name])
            if found > 0.02:
                break
            page.wait_for_timeout(500)
        assert found > 0.02, f"{name} ground covers {found:.3f} of the picture"


@pytest.mark.timeout(400)
def test_the_ground_is_drawn_on_demand_and_turned_by_keys(
    dashboard: Any, webgl_page: Page, run: str, asked: list[str]
) -> None:
    page = webgl_page
    open_stage(page, f"{dashboard.url}/operate?run={run}")
    past_time(page, 6)
    chip(page, "PAUSED")
    assert asked == []
    opened(page)
    assert len(asked) == 1
    drawn(page, page.evaluate("wattlane.scheme()"))
    traces = page.evaluate(f"{PLOT}.data.map(({{ type, name }}) => `${{type}} ${{name}}`)")
    assert {"surface seen", "surface not seen yet", "scatter3d driven", "scatter3d robot"} <= set(traces)
    # arrow keys turn the picture, and neither step through time nor pan the map
    tick, before = page.evaluate("wattlane.stage.map.frame.tick"), page.evaluate(EYE)
    page.locator("#ground3d-host").focus()
    for key in ("ArrowRight", "ArrowUp", "+"):
        page.keyboard.press(key)
    until(page, f"Math.abs({EYE}[0]) > 0.05")
    after = page.evaluate(EYE)
    assert after[2] / np.linalg.norm(after) > before[2] / np.linalg.norm(before)
    assert np.linalg.norm(after) < np.linalg.norm(before)
    # other heights are another question, and leave it turned
    before = page.evaluate(HEIGHTS)
    page.get_by_text("As the robot knows it", exact=True).click()
    until(page, f"{HEIGHTS} !== {before}")
    assert len(asked) == 2
    assert page.evaluate(EYE) == pytest.approx(after, abs=1e-3)
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_role("button", name="The ground in 3-D")).to_be_focused()
    assert page.evaluate("wattlane.stage.map.frame.tick") == tick
    chip(page, "PAUSED")


@pytest.mark.timeout(400)
def test_it_fits_a_phone_and_the_light_theme(dashboard: Any, webgl_page: Page, run: str) -> None:
    page = webgl_page
    page.set_viewport_size({"width": 390, "height": 844})
    page.add_init_script("localStorage.setItem('theme', JSON.stringify('light'))")
    open_stage(page, f"{dashboard.url}/replay?run={run}&t=3")
    opened(page)
    expect(page.locator("#ground3d-note")).to_contain_text("00:00:03")
    drawn(page, "light")
    box = page.locator("#ground3d-host").bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    assert box["height"] > 300
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_without_webgl_it_says_so_and_asks_for_nothing(dashboard: Any, page: Page, run: str, asked: list[str]) -> None:
    page.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        " return /webgl/.test(kind) ? null : get.call(this, kind, ...more); };"
    )
    open_stage(page, f"{dashboard.url}/replay?run={run}&t=3")
    page.get_by_role("button", name="The ground in 3-D").click()
    expect(page.locator("#ground3d-note")).to_contain_text("WebGL is missing or turned off")
    page.get_by_role("button", name="Show the present moment").click()
    expect(page.locator("#ground3d-note")).to_contain_text("WebGL is missing or turned off")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert asked == []


def test_a_floor_has_no_such_view(dashboard: Any, page: Page) -> None:
    name = "20261122-101500-flat-0001"
    make_run(Path(dashboard.data) / "runs", run_id=name, ticks=60)
    open_stage(page, f"{dashboard.url}/replay?run={name}")
    expect(page.get_by_role("button", name="The ground in 3-D")).to_have_count(0)
