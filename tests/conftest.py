"""What every test shares: where the tree is, a data folder of its own, and which tests run beside which."""

import os
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from app.settings import use_kernel_cache

# Before anything imports numba: the processes that the tests start then find the same compiled kernels.
use_kernel_cache()

ROOT = Path(__file__).resolve().parent.parent

hypothesis.settings.register_profile("default", deadline=None)
# A build that fails must fail again, so it draws the same examples each time.
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "default")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the browser tests, and keeps them on one worker; any other file stays on one worker too."""
    browser_tests = Path(__file__).parent / "browser"
    for item in items:
        in_browser = item.path.is_relative_to(browser_tests)
        if in_browser:
            item.add_marker(pytest.mark.browser)
        group = "browser" if in_browser else item.path.relative_to(ROOT).as_posix()
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session")
def root() -> Path:
    """The top of the source tree."""
    return ROOT


@pytest.fixture(scope="session", autouse=True)
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where runs go while the tests run: never into the user's own folder."""
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WATTLANE_DATA", str(folder))
        patch.delenv("WATTLANE_TOKEN", raising=False)
        patch.delenv("HOST", raising=False)
        yield folder
