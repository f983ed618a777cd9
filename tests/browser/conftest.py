"""Headless Chromium on a dashboard of its own.

`page` is watched: a console error, an uncaught exception or a request that leaves this host fails the test that
caused it. A test that provokes an error names it beforehand: `watch.allow("ERR_CONNECTION_REFUSED")`.
"""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Playwright,
    Request,
    expect,
    sync_playwright,
)

from tests.browser.stage import WAIT_MS
from tests.conftest import ROOT

QUIET = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
CANVAS = [*QUIET, "--disable-gpu"]
WEBGL = [*QUIET, "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
LOCAL_HOSTS = {"127.0.0.1", "localhost", "::1"}
LOCAL_SCHEMES = {"about", "blob", "data"}
START_S = 120.0
SHOTS = ROOT / "build" / "browser"


def chromium_path() -> str | None:
    """The system's Chromium; None leaves it to Playwright, which may have one of its own.

    A snap's can't see the folders that Playwright makes for it.
    """
    named = os.environ.get("WATTLANE_CHROMIUM")
    names = [named] if named else ["chromium", "google-chrome", "google-chrome-stable"]
    found = (shutil.which(name) for name in names)
    return next((path for path in found if path and not path.startswith("/snap/")), None)


def free_port() -> int:
    """A port of the loopback interface that nothing listens on."""
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Dashboard:
    """A dashboard in a process of its own. `stop` ends it, `kill` ends it as a crash would, `start` begins anew."""

    data: Path
    log: Path
    port: int = field(default_factory=free_port)
    args: list[str] = field(default_factory=list)
    process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def start(self) -> "Dashboard":
        """Starts it, and returns once it answers."""
        command = [sys.executable, "-m", "app.cli", "dashboard", "--no-browser", "--port", str(self.port), *self.args]
        with self.log.open("ab") as out:
            self.process = subprocess.Popen(
                command,
                env=os.environ | {"WATTLANE_DATA": str(self.data)},
                cwd=self.data,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        give_up = time.monotonic() + START_S
        while time.monotonic() < give_up:
            if self.process.poll() is not None:
                pytest.fail(f"the dashboard ended with {self.process.returncode}:\n{self.tail()}")
            if self.answers():
                return self
            time.sleep(0.1)
        self.kill()
        return pytest.fail(f"the dashboard did not answer within {START_S:.0f} s:\n{self.tail()}")

    def answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.url}/healthz", timeout=5) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, OSError):
            return False

    def stop(self) -> None:
        """Asks it to end, and sees that it and its workers have."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(15)
        self.kill()

    def kill(self) -> None:
        """Ends it and its workers at once."""
        if self.process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait(15)

    def tail(self, lines: int = 40) -> str:
        """The end of what it printed."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])


@dataclass
class Watch:
    """What a browser context did that it should not have done."""

    complaints: list[str] = field(default_factory=list)
    allowed: list[re.Pattern[str]] = field(default_factory=list)

    def allow(self, pattern: str) -> None:
        """Complaints that match this regular expression are expected."""
        self.allowed.append(re.compile(pattern))

    def follow(self, context: BrowserContext) -> None:
        context.on("console", self._console)
        context.on("weberror", lambda error: self.complaints.append(f"uncaught: {error.error}"))
        context.on("request", self._request)
        context.on("page", self._sockets)
        for page in context.pages:
            self._sockets(page)

    def verdict(self) -> list[str]:
        """The complaints that no pattern allows."""
        return [text for text in self.complaints if not any(pattern.search(text) for pattern in self.allowed)]

    def _sockets(self, page: Page) -> None:
        page.on("websocket", lambda socket: self._address(socket.url))

    def _console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(f"console: {message.text} ({message.location.get('url', '')})")

    def _request(self, request: Request) -> None:
        self._address(request.url)

    def _address(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in LOCAL_SCHEMES and parts.hostname not in LOCAL_HOSTS:
            self.complaints.append(f"left this host: {url[:200]}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Keeps a picture of each open page of a failed test, below build/browser."""
    report = yield
    arguments = getattr(item, "funcargs", {})
    context = arguments.get("context") or arguments.get("kept_context")
    if call.when == "call" and report.failed and context is not None:
        SHOTS.mkdir(parents=True, exist_ok=True)
        for number, page in enumerate(context.pages):
            name = re.sub(r"\W+", "-", item.nodeid).strip("-")
            try:
                page.screenshot(path=SHOTS / f"{name}-{number}.png", timeout=5000)
            except Exception as problem:
                report.sections.append(("screenshot", str(problem)))
    return report


# While Playwright is open its event loop runs in this thread, and asyncio.run refuses: it ends with this folder.
@pytest.fixture(scope="package")
def playwright() -> Iterator[Playwright]:
    expect.set_options(timeout=WAIT_MS)
    with sync_playwright() as started:
        yield started


@contextmanager
def _launch(playwright: Playwright, flags: list[str]) -> Iterator[Browser]:
    try:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=flags)
    except Exception as problem:
        pytest.fail(f"Chromium did not start (`make setup` installs it): {problem}")
    yield browser
    browser.close()


@pytest.fixture(scope="package")
def browser(playwright: Playwright) -> Iterator[Browser]:
    """Chromium without a GPU: the quick one, for every page that draws on a 2-D canvas."""
    with _launch(playwright, CANVAS) as launched:
        yield launched


@pytest.fixture(scope="package")
def webgl_browser(playwright: Playwright) -> Iterator[Browser]:
    """Chromium with WebGL in software, for Rerun's viewer only: slow."""
    with _launch(playwright, WEBGL) as launched:
        yield launched


@pytest.fixture
def watch() -> Iterator[Watch]:
    """Collects what the pages of this test do wrong, and fails the test for it in the end."""
    watching = Watch()
    yield watching
    complaints = watching.verdict()
    assert not complaints, "the page complained:\n" + "\n".join(complaints)


@contextmanager
def _watched(browser: Browser, watch: Watch, **options: object) -> Iterator[BrowserContext]:
    options.setdefault("viewport", {"width": 1440, "height": 900})
    context = browser.new_context(**options)  # type: ignore[arg-type]
    context.set_default_timeout(WAIT_MS)
    watch.follow(context)
    yield context
    context.close()


@pytest.fixture
def context(browser: Browser, watch: Watch, request: pytest.FixtureRequest) -> Iterator[BrowserContext]:
    """A watched, empty profile at 1440×900; an indirect parameter sets other options of Playwright's `new_context`."""
    with _watched(browser, watch, **getattr(request, "param", {})) as watched:
        yield watched


@pytest.fixture
def page(context: BrowserContext) -> Page:
    return context.new_page()


@pytest.fixture(scope="module")
def kept_context(browser: Browser) -> Iterator[BrowserContext]:
    """A profile with one page for a whole file: the second visit costs a quarter of the first."""
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    context.set_default_timeout(WAIT_MS)
    context.new_page()
    yield context
    context.close()


@pytest.fixture
def kept_page(kept_context: BrowserContext, watch: Watch) -> Iterator[Page]:
    """The page of that profile, watched."""
    watch.follow(kept_context)
    yield kept_context.pages[0]
    kept_context.pages[0].unroute_all()
    kept_context.pages[0].goto("about:blank")


@pytest.fixture
def webgl_page(webgl_browser: Browser, watch: Watch) -> Iterator[Page]:
    """A watched page in which Rerun's viewer can draw."""
    with _watched(webgl_browser, watch) as watched:
        yield watched.new_page()


@pytest.fixture(scope="package")
def dashboard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    """The dashboard that the browser tests share; it must outlive each of them."""
    folder = tmp_path_factory.mktemp("dashboard")
    started = Dashboard(data=folder, log=folder / "server.log").start()
    yield started
    started.stop()


@pytest.fixture
def new_dashboard(tmp_path: Path) -> Iterator[Callable[..., Dashboard]]:
    """Makes dashboards for one test alone: `new_dashboard()`, `new_dashboard("--scenario", "soochow2022")`."""
    made: list[Dashboard] = []

    def make(*args: str, data: Path | None = None) -> Dashboard:
        folder = data or tmp_path / f"data-{len(made)}"
        folder.mkdir(parents=True, exist_ok=True)
        made.append(Dashboard(data=folder, log=tmp_path / f"server-{len(made)}.log", args=list(args)))
        return made[-1].start()

    yield make
    for one in made:
        one.stop()
