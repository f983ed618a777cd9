"""Studies that a person can run and read: where results and cells are kept, and the process that computes one.

`<data>/studies/<name>/cells/` holds what is computed, cell by cell, so that a run that was ended goes on;
`<data>/studies/<name>/results/<id>.json` the newest results; assets/studies/<name>/<name>.json the one that ships.
A record is a study's result as plain values, with `made`: when, by what, and how it was asked for.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import assets
from app import wire
from app.runs import last_line, worker_environment
from engine.errors import BadInput, FormatError, RunError, WattlaneError

log = logging.getLogger(__name__)

SHIPPED = "shipped"
RESULTS_KEPT = 10
"""Own results of a study; older ones are removed."""
CONNECT_S = 10.0
PATIENCE_S = 8.0
"""A process that was asked to end is cut off after this; its cells are written whole or not at all."""
COMPILED = "compiled-study-{name}"
_ID = re.compile(r"\d{8}-\d{6}-\d{6}")


class NoSuchResult(RunError):
    """A study or result that isn't there."""


@dataclass(frozen=True, slots=True)
class Asked:
    """How a study is run. maps: per case, None for the study's own number · jobs: processes, −1 for one per core."""

    quick: bool = False
    maps: int | None = None
    seed: int = 11
    jobs: int = -1

    def __post_init__(self) -> None:
        if self.jobs != -1 and not 1 <= self.jobs <= 4096:
            raise BadInput(
                f"jobs: a number of processes, 1 or more, or -1 for one per core was expected, got {self.jobs}"
            )


def checked_study(name: str) -> str:
    """The name, when a study has it. Raises NoSuchResult with the nearest one."""
    from engine.errors import unknown_name
    from engine.studies.base import STUDIES

    if name not in STUDIES:
        raise NoSuchResult(unknown_name("study", str(name)[:60], STUDIES))
    return name


# -- results ----------------------------------------------------------------------------------------------------------


class Store:
    """Results and cells of all studies in one data folder, and the results that ship."""

    def __init__(self, data: Path) -> None:
        self.root = data / "studies"

    def cells(self, name: str) -> Path:
        return self.root / checked_study(name) / "cells"

    def results(self, name: str) -> list[dict[str, Any]]:
        """{id, origin (`own` or `shipped`), made} of each result, newest own first, the shipped one last."""
        own = self.root / checked_study(name) / "results"
        files = sorted((f for f in own.glob("*.json") if _ID.fullmatch(f.stem)), reverse=True) if own.is_dir() else []
        found = [(file.stem, "own", file) for file in files]
        shipped = self._shipped(name)
        if shipped.is_file():
            found.append((SHIPPED, SHIPPED, shipped))
        listed = []
        for result_id, origin, file in found:
            with contextlib.suppress(RunError):  # one that can't be read is no result
                listed.append({"id": result_id, "origin": origin, "made": _read(file)["made"]})
        return listed

    def record(self, name: str, result_id: str) -> dict[str, Any]:
        """A whole result. Raises NoSuchResult."""
        checked_study(name)
        if result_id == SHIPPED:
            file = self._shipped(name)
        elif _ID.fullmatch(str(result_id)):
            file = self.root / name / "results" / f"{result_id}.json"
        else:
            raise NoSuchResult(f"{str(result_id)[:60]!r} is no result of a study")
        if not file.is_file():
            raise NoSuchResult(f"study {name} has no result {result_id}")
        record = _read(file)
        record["made"]["id"] = result_id
        return record

    def save(self, record: dict[str, Any]) -> str:
        """Keeps a result and returns its id; the oldest ones beyond RESULTS_KEPT are removed."""
        folder = self.root / checked_study(str(record["study"])) / "results"
        folder.mkdir(parents=True, exist_ok=True)
        name = datetime.now(UTC).strftime("%Y%m%d-%H%M%S-%f")
        write_record(record, folder / f"{name}.json")
        for old in sorted(f for f in folder.glob("*.json") if _ID.fullmatch(f.stem))[:-RESULTS_KEPT]:
            old.unlink(missing_ok=True)
        return name

    @staticmethod
    def _shipped(name: str) -> Path:
        return assets.path("studies", name, f"{name}.json")


def _read(file: Path) -> dict[str, Any]:
    try:
        record = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{file.name}: a study's result was expected; it can't be read ({error})") from None
    if not isinstance(record, dict) or not {"study", "made", "rows", "figures"} <= record.keys():
        raise RunError(f"{file.name}: a study's result was expected; it is something else")
    return record


def write_record(record: dict[str, Any], file: Path) -> None:
    """Writes a record whole or not at all; arrays of numbers stay on one line."""
    text = json.dumps(record, ensure_ascii=False, allow_nan=False, indent=1)
    text = re.sub(r"\[\s+(-?[\d.e+-]+(?:,\s+-?[\d.e+-]+)*)\s+\]", lambda m: "[" + re.sub(r"\s+", " ", m[1]) + "]", text)
    part = file.with_suffix(".part")
    part.write_text(text + "\n", "utf-8")
    part.replace(file)


# -- computing --------------------------------------------------------------------------------------------------------


def compute(
    name: str,
    asked: Asked,
    store: Store,
    progress: Callable[[int, int, str], bool | None],
    say: Callable[[str], None],
    scheduler: str | None = None,
) -> dict[str, Any]:
    """Runs a study in this process and its children, keeps cells and result, and returns the record.

    progress: told (cells done, in all, what); False ends it · say: told what takes long before the first cell ·
    scheduler: address of a dask scheduler to run the cells on. Raises Ended, BadInput, RunError.
    """
    from app.settings import use_kernel_cache, writable

    use_kernel_cache()
    from engine.studies.base import Settings, as_plain, code_version, counted, study

    found = study(checked_study(name))
    folder = store.cells(name)
    settings = Settings(asked.quick, asked.maps, asked.seed, folder)
    writable(folder)
    marker = (
        Path(os.environ["NUMBA_CACHE_DIR"]) / COMPILED.format(name=name) if "NUMBA_CACHE_DIR" in os.environ else None
    )
    cold = marker is not None and not marker.exists()
    if cold and scheduler is None:
        say("Compiling kernels, once: this takes up to two minutes …")
    cells: list[int] = []  # kept from before, in all

    def told(done: int, total: int, what: str) -> bool | None:
        if not cells:
            cells.extend((done, total))
        return progress(done, total, what)

    begun = time.monotonic()
    with _where(scheduler) as backend:
        result = found.run(replace(settings, backend=backend, cold=cold), told, asked.jobs)
    if marker is not None and scheduler is None:
        with contextlib.suppress(OSError):
            marker.touch()
    record = as_plain(result)
    made = _made(asked, scheduler)
    made |= {"maps": asked.maps or found.maps[not asked.quick], "counted": counted(found)}
    made |= {"wall_s": round(time.monotonic() - begun, 1)}
    made |= {"kept": cells[0], "cells": cells[1], "code": code_version(type(found).__module__)}
    record = {"study": record.pop("study"), "made": made, **record}
    made["id"] = store.save(record)
    return record


def _made(asked: Asked, scheduler: str | None) -> dict[str, Any]:
    """When and by what, and how it was asked for."""
    from app.runner import versions

    return {
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "quick": asked.quick,
        "seed": asked.seed,
        "where": "this machine" if scheduler is None else "a cluster",
        "processes": (os.cpu_count() or 1) if asked.jobs == -1 else asked.jobs,
    }


@contextlib.contextmanager
def _where(scheduler: str | None) -> Iterator[str]:
    """joblib's backend: this machine's processes, or a dask cluster. Raises BadInput when it can't be reached."""
    if scheduler is None:
        yield "loky"
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise BadInput(
            "--scheduler needs the package `distributed`: install wattlane with the extra `cluster`"
        ) from None
    import joblib

    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(
            f"--scheduler {scheduler}: no dask scheduler answers there ({error or type(error).__name__}); "
            "an address such as tcp://127.0.0.1:8786 was expected"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise BadInput(f"--scheduler {scheduler}: the scheduler has no workers; start some with `dask worker`")
        with joblib.parallel_config("dask", client=client):
            yield "dask"


# -- runs of the dashboard --------------------------------------------------------------------------------------------


class StudyRun:
    """The server's end of one study's process: how far it is, and what came of it."""

    def __init__(self, name: str, asked: Asked, data: Path) -> None:
        self.name = name
        self.asked = asked
        self.begun = time.monotonic()
        self.took_s = 0.0
        self.phase = "starting"  # then running, cancelling; in the end finished, cancelled or failed
        self.what = ""
        self.done = self.total = self.kept = 0
        self.first_s: float | None = None  # when the first cell was computed
        self.failure = ""
        self.result_id = ""
        self._lock = threading.Lock()
        self._ended = threading.Event()
        folder = data / "studies" / name
        folder.mkdir(parents=True, exist_ok=True)
        self._log = folder / "worker.log"
        arguments = [name, "--data", str(data), "--seed", str(asked.seed), "--jobs", str(asked.jobs)]
        arguments += ["--quick"] if asked.quick else []
        arguments += [] if asked.maps is None else ["--maps", str(asked.maps)]
        with self._log.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "app.study_worker", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=worker_environment(),
                start_new_session=True,  # its children are ended with it, and Ctrl-C is the server's to handle
            )
        threading.Thread(target=self._read, name=f"study {name}", daemon=True).start()

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    def cancel(self) -> None:
        """Asks the process to end, and cuts it off when it doesn't."""
        with self._lock:
            if not self.alive or self.phase == "cancelling":
                return
            self.phase = "cancelling"
        with contextlib.suppress(OSError, ValueError):
            cast(Any, self._process.stdin).close()
        threading.Thread(target=self._cut_off, daemon=True).start()

    def _cut_off(self) -> None:
        if not self._ended.wait(PATIENCE_S):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                if hasattr(os, "killpg"):
                    os.killpg(self._process.pid, signal.SIGKILL)
                else:
                    self._process.kill()

    def status(self) -> dict[str, Any]:
        """phase, cells done and in all, seconds elapsed and remaining (None while unknown), failure, result_id."""
        elapsed = time.monotonic() - self.begun if self.alive else self.took_s
        remaining = None
        computed = self.done - self.kept
        if self.alive and self.first_s is not None and computed > 1:
            rate = (computed - 1) / max(1e-3, elapsed - self.first_s)
            remaining = (self.total - self.done) / rate if rate else None
        return {
            "study": self.name, "phase": self.phase, "alive": self.alive, "what": self.what, "done": self.done,
            "total": self.total, "kept": self.kept, "elapsed_s": elapsed, "remaining_s": remaining,
            "failure": self.failure, "result_id": self.result_id, "quick": self.asked.quick, "maps": self.asked.maps,
            "seed": self.asked.seed,
        }  # fmt: skip

    def _read(self) -> None:
        pipe = cast(Any, self._process.stdout)
        try:
            while (message := wire.read_message(pipe)) is not None:
                self._take(wire.read_json(message[1]))
        except (FormatError, OSError) as error:
            self.failure = f"the study's process said something unreadable: {error}"
            self._process.kill()
        code = self._process.wait()
        pipe.close()
        with self._lock:
            self.took_s = time.monotonic() - self.begun
            if self.result_id:
                self.phase = "finished"
            elif self.phase == "cancelling":
                self.phase = "cancelled"
            else:
                self.phase = "failed"
                self.failure = self.failure or f"its process ended with code {code}: {last_line(self._log)}"
            self._ended.set()
        with contextlib.suppress(OSError, ValueError):
            cast(Any, self._process.stdin).close()

    def _take(self, message: dict[str, Any]) -> None:
        with self._lock:
            if "failure" in message:
                self.failure = str(message["failure"])
            if "result" in message:
                self.result_id = str(message["result"])
            if "say" in message:
                self.what = str(message["say"])
            if "done" in message:
                self.done, self.total, self.what = int(message["done"]), int(message["total"]), str(message["what"])
                if self.phase == "starting":
                    self.phase, self.kept = "running", self.done
                if self.done > self.kept and self.first_s is None:
                    self.first_s = time.monotonic() - self.begun


class Studies:
    """The studies of one dashboard: their results, and the one that is being computed. Safe to call from any thread."""

    def __init__(self, data: Path) -> None:
        self.data = data
        self.store = Store(data)
        self._runs: dict[str, StudyRun] = {}
        self._lock = threading.Lock()

    def start(self, name: str, asked: Asked) -> None:
        """Begins a study in a process of its own. Raises BadInput, RunError when one is being computed already."""
        from app.settings import writable
        from engine.studies.base import Settings

        checked_study(name)
        Settings(asked.quick, asked.maps, asked.seed)
        writable(self.store.cells(name))
        with self._lock:
            busy = next((run.name for run in self._runs.values() if run.alive), None)
            if busy is not None:
                raise RunError(f"{busy} is being computed; cancel it, or wait until it is done")
            self._runs[name] = StudyRun(name, asked, self.data)

    def cancel(self, name: str) -> None:
        """Ends a study's run; its cells are kept. Raises RunError when it isn't running."""
        run = self._run(name)
        if run is None or not run.alive:
            raise RunError(f"{name} is not being computed")
        run.cancel()

    def status(self, name: str) -> dict[str, Any] | None:
        """How its run is or how it ended, None when it wasn't run since the dashboard began."""
        run = self._run(name)
        return None if run is None else run.status()

    def close(self) -> None:
        """Ends what is being computed."""
        with self._lock:
            runs = list(self._runs.values())
        for run in runs:
            run.cancel()

    def _run(self, name: str) -> StudyRun | None:
        with self._lock:
            return self._runs.get(checked_study(name))


def sentence(error: Exception) -> str:
    """What a person reads when a study can't go on."""
    if isinstance(error, OSError):
        return f"{error.strerror or error}: {error.filename}" if error.filename else str(error.strerror or error)
    return str(error)


FORESEEN = (WattlaneError, OSError)
