"""A run's folder: its passport, its lock, and what the disk may answer."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from engine.errors import RunError

MANIFEST, SCENARIO, LOCK, LOG, NEWEST = "manifest.json", "scenario.toml", "writer.lock", "log", "keyframes.open"


_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would become larger than allowed",
    errno.EACCES: "the folder may not be written to",
    errno.EPERM: "the folder may not be written to",
    errno.EROFS: "the disk is read-only",
    errno.ENOTDIR: "a part of its path is not a folder",
    errno.EEXIST: "a file stands in the way",
}


@contextlib.contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turn failures of the disk into RunError with one sentence."""
    try:
        yield
    except OSError as error:
        reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
        raise RunError(f"can't write the run {folder}: {reason}; what was recorded before is kept") from error


def replace_file(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            file.write(data)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def read_manifest(folder: Path | str) -> dict[str, Any]:
    """The run's passport; raises RunError when it is missing or damaged."""
    path = Path(folder) / MANIFEST
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunError(f"{Path(folder)} holds no run: {MANIFEST} is missing") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RunError(f"{path} can't be read: {error}") from error
    if not isinstance(found, dict):
        raise RunError(f"{path} is not a JSON object")
    return found


def write_manifest(folder: Path | str, manifest: Mapping[str, Any]) -> None:
    """Replace the manifest, whole or not at all."""
    with disk_errors(Path(folder)):
        replace_file(Path(folder) / MANIFEST, json.dumps(manifest, indent=1, default=_plain).encode())


def _plain(value: object) -> object:
    """Numpy scalars and paths in a manifest."""
    return value.item() if isinstance(value, np.generic) else str(value)


def take_lock(folder: Path) -> IO[bytes]:
    with disk_errors(folder):
        file = (folder / LOCK).open("ab+")
    for attempt in range(10):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            # writer_alive() holds the lock for an instant
            threading.Event().wait(0.01 * attempt)
        except OSError as error:
            file.close()
            raise RunError(f"can't lock the run {folder}: {error.strerror}") from error
        else:
            with disk_errors(folder):
                file.truncate(0)
                file.write(str(os.getpid()).encode())
                file.flush()
            return file
    file.seek(0)
    owner = file.read().decode(errors="replace").strip()
    file.close()
    raise RunError(f"run {folder.name} is being written by another process{f' ({owner})' if owner else ''}")


def writer_alive(folder: Path | str) -> bool:
    """True while a writer holds the run's lock."""
    try:
        with (Path(folder) / LOCK).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False
