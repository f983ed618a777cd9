"""A file that takes Rerun's bytes through a pipe, so that a full disk is an error here.

Rerun's own file writer gives up on a full disk, after which its flush and its disconnect may wait for ever.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
from pathlib import Path

from engine.errors import RunError

PIPE_BYTES = 1 << 20


class FileSink:
    """Copies what is written to `address` into a file, until every writer has closed it.

    After a failed write the rest is swallowed, and check() raises RunError.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._error: OSError | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise RunError(f"the recording {path} can't be written: {error.strerror or error}") from error
        self._from, self._to = os.pipe()
        with contextlib.suppress(AttributeError, OSError):
            fcntl.fcntl(self._to, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._thread = threading.Thread(target=self._copy, name=f"recording {path.name}", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Path by which this process opens the pipe's writing end."""
        return f"/dev/fd/{self._to}"

    def opened(self) -> None:
        """The writer has opened `address`: from now on the pipe ends with it."""
        os.close(self._to)

    def check(self) -> None:
        """Raise RunError when a write has failed."""
        if self._error is not None:
            raise RunError(f"the recording {self.path} can't be written: {self._error.strerror}") from self._error

    def finish(self) -> None:
        """Wait for the last byte. Raises RunError when a write has failed."""
        self._thread.join()
        self.check()

    def _copy(self) -> None:
        with self._file, open(self._from, "rb", buffering=0) as pipe:
            while chunk := pipe.read(PIPE_BYTES):
                left = memoryview(chunk)
                while left and self._error is None:
                    try:
                        left = left[self._file.write(left) :]
                    except OSError as error:
                        self._error = error


def is_finished(path: Path) -> bool:
    """True when a recording was closed; one whose writer was killed lacks Rerun's footer, and can be rebuilt."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        return b"RRF2FOOT" in file.read()
    return False
