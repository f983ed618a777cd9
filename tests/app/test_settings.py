"""Where things live, and which settings are refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app import settings as module
from app.settings import Settings, cache_folder, data_folder, is_loopback, kernel_cache_key, make_token, writable
from engine.errors import BadInput


def test_the_data_folder_is_the_chosen_one_then_the_environments_then_the_platforms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATTLANE_DATA", str(tmp_path / "environment"))
    assert data_folder(tmp_path / "chosen") == tmp_path / "chosen"
    assert data_folder() == tmp_path / "environment"
    monkeypatch.delenv("WATTLANE_DATA")
    monkeypatch.setattr(module.sys, "platform", "linux")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "xdg"))
    assert data_folder() == tmp_path / "xdg" / "wattlane"
    monkeypatch.setenv("XDG_DATA_HOME", "relative/is/invalid")
    assert data_folder() == Path.home() / ".local/share/wattlane"


def test_the_cache_folder_can_be_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATTLANE_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    assert Settings(data=tmp_path).viewer_cache == tmp_path / "rerun"


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "[::1]", "127.1.2.3"])
def test_loopback_needs_no_token(host: str, tmp_path: Path) -> None:
    assert is_loopback(host)
    assert Settings(data=tmp_path, host=host).token is None


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "example.org"])
def test_beyond_loopback_a_token_is_demanded(host: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no token is set"):
        Settings(data=tmp_path, host=host)
    assert Settings(data=tmp_path, host=host, token=make_token()).host == host


@pytest.mark.parametrize("token", ["short", "with space in it", "semi;colon;here", "ünicode-token", ""])
def test_tokens_that_would_break_a_cookie_are_refused(token: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="8 to 200"):
        Settings(data=tmp_path, token=token)


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_ports_have_a_range(port: int, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="port"):
        Settings(data=tmp_path, port=port)


def test_the_address_is_one_that_a_browser_here_can_open(tmp_path: Path) -> None:
    token = make_token()
    assert Settings(data=tmp_path, port=8051).address == "http://127.0.0.1:8051"
    assert Settings(data=tmp_path, host="0.0.0.0", token=token).address == "http://127.0.0.1:8050"
    assert Settings(data=tmp_path, host="::1").address == "http://[::1]:8050"


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    file = tmp_path / "a file"
    file.write_text("")
    with pytest.raises(BadInput, match="a file"):
        writable(file / "runs")
    assert writable(tmp_path / "new" / "folder").is_dir()


def test_compiled_kernels_are_kept_apart_by_the_code_that_they_are_of(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text("from numba import njit\n")
    (tmp_path / "plain.py").write_text("x = 1\n")
    first = kernel_cache_key(tmp_path)
    (tmp_path / "plain.py").write_text("x = 2\n")
    assert kernel_cache_key(tmp_path) == first
    (tmp_path / "kernel.py").write_text("from numba import njit, prange\n")
    assert kernel_cache_key(tmp_path) != first


def test_the_kernel_cache_is_set_once_and_only_old_ones_are_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATTLANE_CACHE", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    for number in range(6):
        folder = tmp_path / "kernels" / f"old{number}"
        folder.mkdir(parents=True)
        os.utime(folder, (number, number))
    assert module.use_kernel_cache() is True
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == tmp_path / "kernels"
    assert {f.name for f in (tmp_path / "kernels").iterdir()} >= {"old5", "old4", "old3"}
    assert not (tmp_path / "kernels" / "old0").exists()
    module.kernels_compiled()
    assert module.use_kernel_cache() is False


def test_a_method_that_was_not_used_yet_is_warmed_up_on_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """What one planner and dispatcher compiled says nothing of others; commands are compiled once for all."""
    from app.runner import kernel_mark, warm_up
    from engine.scenario import load

    plain, other = load("wang2019"), load("wang2019", {"dispatch.policy": "insertion"})
    assert len({kernel_mark(one) for one in (plain, other, load("soochow2022"), load("lian2024"))}) == 4
    marks: list[str] = []
    monkeypatch.setattr(module, "kernels_compiled", lambda mark=module.WARM: marks.append(mark))
    warm_up(other, few=True)
    assert marks == [kernel_mark(other)]
    warm_up(plain)
    assert marks[1:] == [kernel_mark(plain), module.WARM]
