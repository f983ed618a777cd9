"""Rerun's viewers: the web viewer's files, to be served by ourselves without a network, and the native window.

The files stand inside Rerun's executable. It serves them once, on loopback, for as long as fetching them takes.
"""

from __future__ import annotations

import contextlib
import fcntl
import gzip
import http.client
import importlib.metadata
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from engine.errors import RunError

FILES: tuple[str, ...] = ("index.html", "re_viewer.js", "re_viewer_bg.wasm")
"""The web viewer, as its page names them; `re_viewer_bg.wasm.gz` lies beside them."""

FETCH_WITHIN_S = 60.0
"""How long the executable may take to start and hand out its files."""

OPENS_WITHIN_S = 3.0
"""How long a window that can't open may take to say so."""

_LINK = re.compile(r"[ \t]*<link\b[^>]*>\s*?\n")
_TELEMETRY = re.compile(r"[ \t]*if \(window\.location\.hostname == \"[^\"]*rerun\.io\"\) \{.*?\n[ \t]*\}\n", re.DOTALL)
_CALLS_OUT = re.compile(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//(?!github\.com)|fonts\.g|fifteen-thirtyeight""")

_LOADER = '<script src="re_viewer.js"></script>'
# The viewer asks for updates and reports its use: both get an empty answer from here, and no error in the console.
_STAY_HERE = """<link rel="icon" href="data:," />
    <script>
      const fetch_anything = window.fetch.bind(window);
      window.fetch = (what, options) => {
        const url = new URL(what instanceof Request ? what.url : what, location.href);
        const here = url.origin === location.origin || url.protocol === "blob:" || url.protocol === "data:";
        return here ? fetch_anything(what, options) : Promise.resolve(new Response("{}", { status: 404 }));
      };
    </script>
    """


def version() -> str:
    """Version of the installed Rerun, such as `0.41.0`. Raises RunError when there is none."""
    try:
        return importlib.metadata.version("rerun-sdk")
    except importlib.metadata.PackageNotFoundError:
        raise RunError("Rerun is not installed: `pip install rerun-sdk` brings its viewer") from None


def viewer_files(cache_dir: Path) -> Path:
    """Folder with the web viewer's FILES, fetched on the first call and kept for each version of Rerun.

    The page loads nothing from any other host. Processes that ask at the same time wait for one to fetch.
    Raises RunError with one sentence when the files can't be had.
    """
    folder = cache_dir / f"rerun-{version()}"
    if _complete(folder):
        return folder
    try:
        cache_dir.mkdir(parents=True, exist_ok=True)
        with _locked(cache_dir / f"{folder.name}.lock"):
            if not _complete(folder):
                _fetch_into(folder)
    except OSError as error:
        raise RunError(f"the Rerun viewer could not be put into {cache_dir}: {error.strerror or error}") from error
    return folder


def open_native(recording: Path) -> None:
    """Open a recording in Rerun's own window, which outlives this process. Raises RunError when it does not open."""
    if not recording.is_file():
        raise RunError(f"there is no recording at {recording}")
    version()
    with tempfile.TemporaryFile() as said:
        # Its message port would otherwise listen on every network interface.
        command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", "auto", str(recording)]
        started = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
        )
        try:
            code = started.wait(timeout=OPENS_WITHIN_S)
        except subprocess.TimeoutExpired:
            return
        if code != 0:
            said.seek(0)
            raise RunError(f"Rerun's window did not open: {_last_line(said.read())}")


def _complete(folder: Path) -> bool:
    return all((folder / name).is_file() for name in FILES)


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _fetch_into(folder: Path) -> None:
    """Fetch the files beside the folder and move them into place at once, so that a torn fetch leaves nothing."""
    with tempfile.TemporaryDirectory(prefix=f"{folder.name}.", dir=folder.parent) as scratch:
        fresh = Path(scratch) / "viewer"
        fresh.mkdir()
        with _serving() as port:
            for name in FILES:
                _download(port, name, fresh / name)
        page = fresh / "index.html"
        page.write_text(offline_page(page.read_text("utf-8")), "utf-8")
        wasm = fresh / FILES[2]
        if wasm.read_bytes()[:4] != b"\0asm":
            raise RunError("the Rerun viewer could not be fetched: what came is no WebAssembly module")
        with wasm.open("rb") as plain, gzip.GzipFile(f"{wasm}.gz", "wb", compresslevel=5, mtime=0) as packed:
            shutil.copyfileobj(plain, packed, 1 << 20)
        fresh.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        fresh.replace(folder)


def offline_page(page: str) -> str:
    """The viewer's page without web fonts, icons, visitor counting and calls to other hosts.

    Raises RunError when it still names another host, or no longer has the place where calls are stopped.
    """
    page = _TELEMETRY.sub("", _LINK.sub("", page))
    head, at, tail = page.partition(_LOADER)
    if not at:
        raise RunError("the Rerun viewer's page has changed, so it can't be kept from calling other hosts")
    page = f"{head}{_STAY_HERE}{at}{tail}"
    if found := _CALLS_OUT.search(page):
        raise RunError(f"the Rerun viewer's page calls another host ({found[0]!r}), so it is not served")
    return page


@contextlib.contextmanager
def _serving() -> Iterator[int]:
    """Run Rerun's own web server on loopback; yields its port once it answers."""
    port, message_port = _free_ports()
    address = ["--bind", "127.0.0.1", "--web-viewer-port", str(port), "--port", str(message_port)]
    with tempfile.TemporaryDirectory() as home, tempfile.TemporaryFile() as said:
        # With an empty home it is a first session, which reports nothing to anyone.
        places = {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "XDG_CACHE_HOME": home}
        server = subprocess.Popen(
            [sys.executable, "-m", "rerun", "--serve-web", *address],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            env={**os.environ, **places},
            start_new_session=True,
        )
        try:
            give_up = time.monotonic() + FETCH_WITHIN_S
            while not _answers(port):
                if server.poll() is not None:
                    said.seek(0)
                    raise RunError(f"the Rerun viewer could not be fetched: {_last_line(said.read())}")
                if time.monotonic() > give_up:
                    raise RunError(f"the Rerun viewer could not be fetched: no answer in {FETCH_WITHIN_S:.0f} s")
                time.sleep(0.05)
            yield port
        finally:
            # `python -m rerun` starts the executable as its child: end both.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGKILL)
            server.wait()


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False


def _download(port: int, name: str, to: Path) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=FETCH_WITHIN_S)
    try:
        connection.request("GET", f"/{name}")
        answer = connection.getresponse()
        if answer.status != http.HTTPStatus.OK:
            raise RunError(f"the Rerun viewer could not be fetched: {name} answered {answer.status} {answer.reason}")
        with to.open("wb") as out:
            shutil.copyfileobj(answer, out, 1 << 20)
    except http.client.HTTPException as error:
        raise RunError(f"the Rerun viewer could not be fetched: {name}: {error}") from error
    finally:
        connection.close()


def _free_ports() -> tuple[int, int]:
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as two:
        return one.getsockname()[1], two.getsockname()[1]


def _last_line(said: bytes) -> str:
    """What a program said last, without colours; a sentence when it said nothing."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", said.decode("utf-8", "replace")).strip()
    return text.splitlines()[-1].strip() if text else "it ended without a word"
