"""The watch itself: what it must see, so that the silence of the other tests means something."""

import pytest
from playwright.sync_api import BrowserContext, Page

pytestmark = pytest.mark.browser


def show(page: Page, body: str) -> None:
    page.goto("about:blank")
    page.set_content(f"<!doctype html><title>watched</title>{body}")


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ("<script>console.error('a red line')</script>", "console: a red line"),
        ("<script>null.x</script>", "uncaught: Cannot read"),
        ("<img src='http://elsewhere.invalid/pixel.png'>", "left this host: http://elsewhere.invalid/pixel.png"),
        (
            "<script>new WebSocket('ws://elsewhere.invalid/live')</script>",
            "left this host: ws://elsewhere.invalid/live",
        ),
    ],
)
def test_complaints_are_seen(context: BrowserContext, page: Page, watch, body: str, complaint: str) -> None:
    context.route("**/*", lambda route: route.abort())
    show(page, body)
    for _ in range(100):
        if any(text.startswith(complaint) for text in watch.verdict()):
            break
        page.wait_for_timeout(100)
    else:
        pytest.fail(f"{complaint} was not seen, but {watch.verdict()}")
    watch.allow(".*")


def test_a_clean_page_passes(page: Page, watch) -> None:
    show(page, "<script>console.log('fine'); document.title = 'drawn'</script><img src='data:,'>")
    page.wait_for_function("document.title === 'drawn'")
    assert watch.verdict() == []


def test_webgl_is_there_for_rerun(webgl_page: Page) -> None:
    show(webgl_page, "<canvas></canvas>")
    assert webgl_page.evaluate("!!document.querySelector('canvas').getContext('webgl2')")
