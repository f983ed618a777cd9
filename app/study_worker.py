"""The process of one study's run: computes its cells on all cores, tells how far it is, and keeps the result.

`python -m app.study_worker NAME --data FOLDER [--quick] [--maps N] [--seed S] [--jobs J]`. It talks over stdout
(app/wire.py). When stdin ends it was cancelled, or the server is gone: it ends, and what is computed is kept.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, BinaryIO

from app import wire
from app.study import FORESEEN, Asked, Store, compute, sentence
from engine.errors import WattlaneError

TELL_S = 0.2
GRACE_S = 5.0
"""What a cell that is being computed may take to end."""
NICE = 10
"""Live runs and the dashboard come first."""


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="app.study_worker", description="The process of one study's run.")
    parser.add_argument("name")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--maps", type=int)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--jobs", type=int, default=-1)
    return parser.parse_args(argv)


def _until_end(stream: BinaryIO, ending: threading.Event) -> None:
    """Waits for the end of stdin, then for the study to end by itself, and cuts it and its children off after that."""
    while stream.read(4096):
        pass
    ending.set()
    time.sleep(GRACE_S)
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
        os.killpg(os.getpid(), signal.SIGKILL)
    os._exit(1)


def main(argv: list[str] | None = None) -> int:
    arguments = parse(argv)
    # Whatever prints must not reach the pipe to the server.
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICE)
    ending = threading.Event()
    requests = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
    threading.Thread(target=_until_end, args=(requests, ending), name="listener", daemon=True).start()
    told = [0.0]

    def tell(message: dict[str, Any]) -> None:
        try:
            out.write(wire.pack_json(message))
            out.flush()
        except OSError:
            ending.set()

    def progress(done: int, total: int, what: str) -> bool:
        now = time.monotonic()
        if now - told[0] >= TELL_S or done == total or told[0] == 0.0:
            told[0] = now
            tell({"done": done, "total": total, "what": what})
        return not ending.is_set()

    asked = Asked(arguments.quick, arguments.maps, arguments.seed, arguments.jobs)
    try:
        record = compute(arguments.name, asked, Store(arguments.data), progress, lambda text: tell({"say": text}))
    except FORESEEN as error:
        if not ending.is_set():
            tell({"failure": sentence(error)})
        return 0 if ending.is_set() and isinstance(error, WattlaneError) else 1
    tell({"result": record["made"]["id"]})
    return 0


if __name__ == "__main__":
    sys.exit(main())
