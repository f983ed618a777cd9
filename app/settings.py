"""Where things live and how the dashboard listens. Built from options and the environment, then frozen."""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import os
import re
import secrets
import shutil
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from engine.errors import BadInput

DEFAULT_SCENARIO = "soochow2022-continuous"
DEFAULT_PORT = 8050
LOOPBACK = "127.0.0.1"
WARM = "compiled"
BODY_LIMIT = 8 * 2**20
"""Bytes that a request may carry; Dash's own callbacks need a few hundred kilobytes at most."""

_TOKEN = re.compile(r"[A-Za-z0-9._~-]{8,200}")


def _platform_folder(xdg: str, unix: str, mac: str, windows: str) -> Path:
    """The platform's per-user folder for one kind of file, with `wattlane` appended."""
    if sys.platform == "win32":
        root = Path(os.environ.get(windows) or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        root = Path.home() / mac
    else:
        configured = os.environ.get(xdg, "")
        # The XDG specification: a relative path is invalid and is ignored.
        root = Path(configured) if os.path.isabs(configured) else Path.home() / unix
    return root / "wattlane"


def data_folder(chosen: str | Path | None = None) -> Path:
    """The folder for runs and settings: the one chosen, else WATTLANE_DATA, else the platform's. Not created here."""
    text = chosen or os.environ.get("WATTLANE_DATA") or ""
    if text:
        return Path(text).expanduser().resolve()
    return _platform_folder("XDG_DATA_HOME", ".local/share", "Library/Application Support", "LOCALAPPDATA")


def scenarios_folder(data: Path) -> Path:
    """The folder below the data folder that holds the user's own scenarios."""
    return data / "scenarios"


def cache_folder() -> Path:
    """The folder for what can be made again: WATTLANE_CACHE, else the platform's. Not created here."""
    chosen = os.environ.get("WATTLANE_CACHE")
    if chosen:
        return Path(chosen).expanduser().resolve()
    return _platform_folder("XDG_CACHE_HOME", ".cache", "Library/Caches", "LOCALAPPDATA")


def writable(folder: Path) -> Path:
    """Creates the folder and proves that a file can be written there. Raises BadInput with the reason."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".write-test-"):
            pass
    except OSError as error:
        raise BadInput(
            f"the folder {folder} can't be written ({error.strerror or error}); "
            "choose another with --data or WATTLANE_DATA"
        ) from None
    return folder


def is_loopback(host: str) -> bool:
    """True when only this machine can reach the host."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Settings:
    """How one dashboard runs.

    data: folder that holds `runs/` and `scenarios/` · host, port: where it listens · token: what a client must show,
    or None on loopback · allowed_hosts: further names under which it is reached (a proxy's), for the Host check
    · scenario: started when no run is open; None starts nothing · open_browser: open a page on start.
    """

    data: Path = field(default_factory=data_folder)
    host: str = LOOPBACK
    port: int = DEFAULT_PORT
    token: str | None = None
    allowed_hosts: tuple[str, ...] = ()
    scenario: str | None = DEFAULT_SCENARIO
    open_browser: bool = True
    body_limit: int = BODY_LIMIT

    def __post_init__(self) -> None:
        if not 0 < self.port < 65536:
            raise BadInput(f"a port between 1 and 65535 was expected; got {self.port}")
        if self.token is not None and not _TOKEN.fullmatch(self.token):
            raise BadInput("a token of 8 to 200 letters, digits and -._~ was expected")
        if not is_loopback(self.host) and not self.token:
            raise BadInput(
                f"--host {self.host} lets other machines in, and no token is set; "
                "start with --token TEXT or WATTLANE_TOKEN (`--token new` makes one), or stay on 127.0.0.1"
            )

    @property
    def runs(self) -> Path:
        return self.data / "runs"

    @property
    def scenarios(self) -> Path:
        return scenarios_folder(self.data)

    @property
    def viewer_cache(self) -> Path:
        return cache_folder() / "rerun"

    @property
    def address(self) -> str:
        """What a person types into a browser on this machine, token excluded."""
        host = self.host
        if host in ("0.0.0.0", ""):
            host = LOOPBACK
        elif host == "::":
            host = "[::1]"
        elif ":" in host and not host.startswith("["):
            host = f"[{host}]"
        return f"http://{host}:{self.port}"


def make_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(24)


def kernel_cache_key(engine_folder: Path) -> str:
    """Names the compiled kernels of this code (numba looks only at a kernel's own file, not at what it calls)."""
    found = hashlib.sha256(sys.version.encode())
    for file in sorted(engine_folder.rglob("*.py")):
        content = file.read_bytes()
        if b"numba" in content:
            found.update(file.relative_to(engine_folder).as_posix().encode() + b"\0" + content + b"\0")
    return found.hexdigest()[:16]


def use_kernel_cache(mark: str = WARM) -> bool:
    """Points numba at the per-user cache for this code; call before numba is imported.

    Returns True when kernels have still to be compiled: those of a run, or those that a mark of its own stands for. An
    environment that sets NUMBA_CACHE_DIR is respected.
    """
    import engine

    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        folder = Path(chosen)
    else:
        parent = cache_folder() / "kernels"
        folder = parent / kernel_cache_key(Path(str(engine.__file__)).parent)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return True  # numba then finds its own place, or compiles each time
        _forget_old(parent, keep=4)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return not (folder / mark).exists()


def kernels_compiled(mark: str = WARM) -> None:
    """Notes that the cache in use holds every kernel that a run needs, or what the mark stands for."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder:
        with contextlib.suppress(OSError):
            (Path(folder) / mark).touch()


def _forget_old(parent: Path, keep: int) -> None:
    """Removes all but the newest folders of compiled kernels."""
    folders = sorted((f for f in parent.iterdir() if f.is_dir()), key=lambda f: f.stat().st_mtime, reverse=True)
    for old in folders[keep:]:
        shutil.rmtree(old, ignore_errors=True)
