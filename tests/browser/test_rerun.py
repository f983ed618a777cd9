"""Rerun's viewer as the dashboard serves it: offline, and really drawing a run. Slow: WebGL in software."""

import io
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page

from engine.replay import looks
from tests.synthetic import make_run

pytestmark = pytest.mark.browser

DRAWN_WITHIN_MS = 150_000


def share_of(picture: np.ndarray, colour: tuple[int, ...], within: int = 6) -> float:
    """Share of a picture's pixels near a colour."""
    return float((np.abs(picture[..., :3].astype(int) - np.array(colour[:3])).max(-1) <= within).mean())


def wait_for_colours(page: Page, colours: dict[str, tuple[int, ...]], least: float) -> np.ndarray:
    """The first picture in which each colour covers at least this share; fails with what is missing."""
    missing: dict[str, float] = {}
    for _ in range(DRAWN_WITHIN_MS // 3000):
        picture = np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=DRAWN_WITHIN_MS))))
        shares = {name: share_of(picture, colour) for name, colour in colours.items()}
        missing = {name: share for name, share in shares.items() if share < least}
        if not missing:
            return picture
        page.wait_for_timeout(3000)
    return pytest.fail(f"the viewer did not draw {missing}")


@pytest.fixture
def run_id(dashboard) -> str:
    """A recorded run whose `.rrd` the server makes from the log when it is asked for."""
    name = "20261122-101500-rerun-0001"
    runs = Path(dashboard.data) / "runs"
    if not (runs / name).exists():
        make_run(runs, run_id=name, ticks=600)
    return name


@pytest.mark.timeout(400)
def test_the_viewer_draws_the_run_and_calls_nobody(webgl_page: Page, dashboard, run_id: str) -> None:
    recording = f"{dashboard.url}/recordings/{run_id}.rrd"
    webgl_page.goto(f"{dashboard.url}/rerun/index.html?url={recording}&hide_welcome_screen=true&theme=dark")
    webgl_page.wait_for_selector("canvas.visible", timeout=DRAWN_WITHIN_MS)
    colours = {name: colour for _, name, colour in looks.FLOOR_CLASSES.values() if name in ("wall", "rack", "charger")}
    wait_for_colours(webgl_page, colours, least=0.0005)


def test_the_viewers_page_is_closed_to_other_hosts(dashboard) -> None:
    with urllib.request.urlopen(f"{dashboard.url}/rerun/index.html", timeout=120) as answer:
        policy = answer.headers["content-security-policy"]
        page = answer.read().decode()
    assert "connect-src 'self'" in policy
    assert "fonts.googleapis" not in page


@pytest.mark.parametrize("name", ["unknown.rrd", "..%2f..%2fsecret.rrd"])
def test_a_recording_that_is_not_there_is_not_found(dashboard, name: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(f"{dashboard.url}/recordings/{name}", timeout=60)
    assert caught.value.code in (400, 404)
