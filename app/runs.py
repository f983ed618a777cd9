"""The runs that a person can open: those on disk, and the live ones, each in a process of its own."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as AnswerTimeout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import assets
from app import wire
from app.library import Library
from app.settings import Settings
from engine.errors import BadInput, CommandError, RunError, WattlaneError, unknown_name

if TYPE_CHECKING:
    from app.ways_beside import WaysBeside
    from engine.results.runs import Catalogue
    from engine.results.view import RunView
    from engine.scenario import Scenario

log = logging.getLogger(__name__)

ANSWER_TIMEOUT_S = 30.0
CLOSE_TIMEOUT_S = 20.0
VIEWS_KEPT = 8
REFRESH_S = 0.4
WAYS_S = 0.3
"""CPU time that searching a run's ways again may take at a time, so that no page waits for long."""
LIVE_SPEEDS = (0.25, 64.0)
RESUMABLE = frozenset({"interrupted", "failed", "stopped"})
_RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,159}")


class NoSuchRun(RunError):
    """A run id that names no run."""


def checked_run_id(run_id: str) -> str:
    """The run id, when it can be one: letters, digits, `.`, `_`, `-`, and no path. Raises NoSuchRun."""
    if not isinstance(run_id, str) or not _RUN_ID.fullmatch(run_id) or ".." in run_id:
        raise NoSuchRun(f"{str(run_id)[:60]!r} is no run id")
    return run_id


class Worker:
    """The server's end of one live run's process: its newest frame and status, and answers to what is asked."""

    def __init__(self, run_id: str, folder: Path, arguments: list[str]) -> None:
        self.run_id = run_id
        self.folder = folder
        self.frame: bytes = b""
        self.frame_number = 0
        self.status: dict[str, Any] = {"phase": "starting"}
        self.heard = time.monotonic()
        self.ended = threading.Event()
        self.exit_code: int | None = None
        self.failure = ""
        self._numbers = itertools.count(1)
        self._waiting: dict[int, Future[dict[str, Any]]] = {}
        self._lock = threading.Lock()
        self._listeners: dict[int, Callable[[], None]] = {}
        with (folder / "worker.log").open("ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "app.worker", str(folder), *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=worker_environment(),
                start_new_session=True,  # Ctrl-C in the terminal is the server's to handle
            )
        self._reader = threading.Thread(target=self._read, name=f"run {run_id}", daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        return not self.ended.is_set()

    def listen(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Calls `wake` (from another thread) whenever a frame or status came; returns what ends that."""
        key = next(self._numbers)
        with self._lock:
            self._listeners[key] = wake

        def stop() -> None:
            with self._lock:
                self._listeners.pop(key, None)

        return stop

    def ask(self, op: str, timeout_s: float = ANSWER_TIMEOUT_S, **values: Any) -> dict[str, Any]:
        """The process's answer. Raises RunError when it is gone or too busy to answer in time."""
        number = next(self._numbers)
        answer: Future[dict[str, Any]] = Future()
        with self._lock:
            if self.ended.is_set():
                raise RunError(f"the process of run {self.run_id} has ended; resume the run to go on")
            self._waiting[number] = answer
        try:
            self._send(wire.pack_json({"id": number, "op": op, **values}))
            return answer.result(timeout_s)
        except AnswerTimeout:
            raise RunError(f"run {self.run_id} is busy and gave no answer within {timeout_s:g} s") from None
        finally:
            with self._lock:
                self._waiting.pop(number, None)

    def close(self) -> None:
        """Tells the process that nobody listens any more: it saves a checkpoint and ends."""
        try:
            cast(Any, self.process.stdin).close()
        except OSError:
            log.debug("the pipe to run %s was already closed", self.run_id)

    def _send(self, message: bytes) -> None:
        pipe = cast(Any, self.process.stdin)
        try:
            with self._lock:
                pipe.write(message)
                pipe.flush()
        except (OSError, ValueError):
            raise RunError(f"the process of run {self.run_id} has ended; resume the run to go on") from None

    def _read(self) -> None:
        pipe = cast(Any, self.process.stdout)
        try:
            while (message := wire.read_message(pipe)) is not None:
                self._take(*message)
        except (WattlaneError, OSError) as error:
            self.failure = f"the run's process said something unreadable: {error}"
            self.process.kill()
        self.exit_code = self.process.wait()
        pipe.close()
        with self._lock:
            self.ended.set()
            waiting = list(self._waiting.values())
        for answer in waiting:
            answer.set_exception(RunError(f"the process of run {self.run_id} ended before it answered"))
        self._wake()

    def _take(self, kind: bytes, payload: bytes) -> None:
        self.heard = time.monotonic()
        if kind == wire.FRAME:
            self.frame = payload
            self.frame_number += 1
        else:
            message = wire.read_json(payload)
            if "id" in message:
                with self._lock:
                    answer = self._waiting.get(message["id"])
                if answer is not None and not answer.done():
                    answer.set_result(message)
                return
            if "failure" in message:
                self.failure = str(message["failure"])
            self.status = message
        self._wake()

    def _wake(self) -> None:
        with self._lock:
            listeners = list(self._listeners.values())
        for wake in listeners:
            wake()

    def obituary(self) -> str:
        """Why the process ended, when it did not end on purpose; else an empty text."""
        if self.failure:
            return self.failure
        code = self.exit_code
        if not code:
            return ""
        if code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = str(-code)
            return f"the run's process was ended by signal {name}"
        return f"the run's process ended with code {code}: {last_line(self.folder / 'worker.log')}"


def last_line(path: Path) -> str:
    """The last line of a text file that says something."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 4096))
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].strip() if lines else "it said nothing"


def worker_environment() -> dict[str, str]:
    """The environment in which `python -P -m app.worker` finds this program."""
    environment = dict(os.environ)
    root = Path(__file__).resolve().parent.parent
    if root.name not in ("site-packages", "dist-packages"):
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(root), environment.get("PYTHONPATH", "")]))
    return environment


@dataclass
class _Opened:
    """A run's view with what guards and dates it."""

    view: RunView
    lock: threading.RLock
    refreshed: float
    settled: bool  # the log is closed: it won't grow
    ways: WaysBeside | None  # of a router that other methods stand beside


class RunManager:
    """Every run of one data folder, and the demo runs that come with the program (read only).

    Methods raise NoSuchRun, RunError or BadInput with the sentence to show. Safe to call from any thread.
    """

    def __init__(self, settings: Settings) -> None:
        from engine.results.runs import Catalogue

        self.settings = settings
        self.catalogue: Catalogue = Catalogue(settings.runs)
        self.demos: Catalogue = Catalogue(assets.path("demos"))
        self.scenarios = Library(settings.scenarios)
        self.workers: dict[str, Worker] = {}
        self._ended: dict[str, Worker] = {}
        self._views: OrderedDict[str, _Opened] = OrderedDict()
        self._lock = threading.RLock()
        self._starting = threading.Lock()
        self.mark_interrupted()

    # What there is

    def home(self, run_id: str) -> Catalogue:
        """The catalogue that holds the run: the user's, or the demos'. Raises NoSuchRun."""
        checked_run_id(run_id)
        for catalogue in (self.catalogue, self.demos):
            folder = catalogue.root / run_id
            if (folder / "manifest.json").is_file() and folder.resolve().is_relative_to(catalogue.root.resolve()):
                return catalogue
        raise NoSuchRun(f"there is no run {run_id!r}")

    def folder(self, run_id: str) -> Path:
        return self.home(run_id).root / run_id

    def is_demo(self, run_id: str) -> bool:
        return self.home(run_id) is self.demos

    def manifest(self, run_id: str) -> dict[str, Any]:
        """The run's passport, with `alive` and `size_bytes`."""
        return self.home(run_id).get(run_id)

    def list(self) -> list[dict[str, Any]]:
        """One passport per run with `demo`, `alive`, `size_bytes`: newest first, demos last."""
        own = [{**entry, "demo": False} for entry in self.catalogue.list()]
        for entry in own:
            if self.worker_alive(entry["run_id"]):
                entry.update(status="running", alive=True)  # its process may not have taken the lock yet
        return own + [{**entry, "demo": True} for entry in self.demos.list()]

    def live(self) -> list[str]:
        """The ids of the runs whose process is alive, oldest first."""
        with self._lock:
            return [run_id for run_id, worker in self.workers.items() if worker.alive]

    def worker(self, run_id: str) -> Worker | None:
        with self._lock:
            worker = self.workers.get(run_id)
        return worker if worker is not None and worker.alive else None

    def worker_alive(self, run_id: str) -> bool:
        return self.worker(run_id) is not None

    def status(self, run_id: str) -> dict[str, Any]:
        """What the page's mode chip and transport bar show; cheap enough to ask twice a second."""
        manifest = self.manifest(run_id)
        keys = ("run_id", "scenario", "title", "planner", "objective", "seed", "fleet", "tick_s", "status", "name")
        answer = {key: manifest.get(key) for key in (*keys, "dispatcher")}
        answer["run_id"] = run_id
        answer.update(note=manifest.get("note") or "", parent=manifest.get("parent"), demo=self.is_demo(run_id))
        answer.update(breaches=manifest.get("breaches"), ticks=manifest.get("ticks"))
        with self._lock:
            worker = self.workers.get(run_id) or self._ended.get(run_id)
        tick = int(manifest.get("ticks") or 0)
        answer.update(tick=tick, sim_s=tick * float(manifest["tick_s"]), asked=None, speed=0.0, phase="", done=False)
        answer["alive"] = worker is not None and worker.alive
        if worker is not None:
            answer.update({k: v for k, v in worker.status.items() if k != "type"})
            answer["age_s"] = round(time.monotonic() - worker.heard, 3)
            if worker.alive:
                answer["status"] = "running"
        if not answer["alive"]:
            answer["phase"] = ""
            answer["paused"] = True
            answer["speed"] = 0.0
        answer["resumable"] = not answer["alive"] and not answer["demo"] and answer["status"] in RESUMABLE
        return answer

    def scenario(self, run_id: str) -> Scenario:
        from app.runner import scenario_of

        return scenario_of(self.folder(run_id))

    # Views

    def view(self, run_id: str) -> RunView:
        """The run's view, read up to what is on disk. Views are refreshed in place: use `read` to have it alone."""
        return self._opened(run_id).view

    def read(self, run_id: str, question: Callable[[RunView], Any]) -> Any:
        """question(view), with the view to itself: views are refreshed in place."""
        opened = self._opened(run_id)
        with opened.lock:
            return question(opened.view)

    def ways_beside(self, run_id: str, until: float) -> dict[str, Any] | None:
        """The ways that a run asked for until a tick, by its router and beside it; None for other planners.

        Searches a few at a time: what is still missing comes with the next calls.
        """
        opened = self._opened(run_id)
        if opened.ways is None:
            return None
        with opened.lock:
            queries = opened.ways.queries(opened.view.reader, until)
        return opened.ways.told(queries, WAYS_S)

    def _opened(self, run_id: str) -> _Opened:
        from app.runner import scenario_of, world_of
        from app.ways_beside import WaysBeside
        from engine.build import beside_costs
        from engine.results.runlog import LogReader
        from engine.results.view import RunView

        folder = self.folder(run_id)
        with self._lock:
            opened = self._views.get(run_id)
            if opened is not None:
                self._views.move_to_end(run_id)
        if opened is None:
            settled = not self._growing(folder)  # asked before, so that the last rows aren't missed
            scenario = scenario_of(folder)
            world = world_of(scenario)
            view = RunView(LogReader(folder), scenario, world, beside_costs(scenario, world))
            ways = WaysBeside.of(scenario, world)
            opened = _Opened(view, threading.RLock(), time.monotonic(), settled, ways)
            with self._lock:
                opened = self._views.setdefault(run_id, opened)
                while len(self._views) > VIEWS_KEPT:
                    self._views.popitem(last=False)
        elif not opened.settled and time.monotonic() - opened.refreshed > REFRESH_S:
            with opened.lock:
                if time.monotonic() - opened.refreshed > REFRESH_S:
                    settled = not self._growing(folder)
                    opened.view.refresh()
                    opened.refreshed = time.monotonic()
                    opened.settled = settled
        return opened

    def _growing(self, folder: Path) -> bool:
        """True while some process writes the run's log, or is about to."""
        from engine.results.runlog import writer_alive

        return self.worker_alive(folder.name) or writer_alive(folder)

    def _forget_view(self, run_id: str) -> None:
        with self._lock:
            self._views.pop(run_id, None)

    # Live runs

    def start(
        self,
        scenario: str,
        *,
        from_file: bool = False,
        seed: int | None = None,
        planner: str | None = None,
        objective: str | None = None,
        overrides: Mapping[str, object] | None = None,
        name: str = "",
        speed: float = 1.0,
        paused: bool = False,
    ) -> str:
        """Starts a live run in a process of its own and returns its id. The scenario is checked before.

        scenario: name of a built-in or imported one; with `from_file` (never for what came over the network) also a
        path.
        """
        from app import runner
        from engine.results.runs import checked_name

        if not from_file and scenario not in self.scenarios:
            raise BadInput(unknown_name("scenario", scenario, self.scenarios.names()))
        pace = _pace(speed, paused)
        label = checked_name(name)
        asked = runner.asked_scenario(
            scenario, overrides or {}, seed=seed, planner=planner, objective=objective, library=self.scenarios
        )
        return self._launch(runner.prepare(self.catalogue, asked, name=label), pace)

    def resume(self, run_id: str) -> str:
        """Goes on with an interrupted, failed or stopped run from its last checkpoint."""
        folder = self._own(run_id)
        if self.worker_alive(run_id):
            raise RunError(f"run {run_id} is running already")
        status = self.manifest(run_id).get("status")
        if status not in RESUMABLE:
            raise RunError(f"run {run_id} is {status} and can't be resumed; fork it instead")
        return self._launch(folder, ["--mode", "resume"])

    def fork(
        self,
        run_id: str,
        tick: int,
        *,
        planner: str | None = None,
        seed: int | None = None,
        overrides: Mapping[str, object] | None = None,
        name: str = "",
    ) -> str:
        """Starts a live run that shares this one's past up to a tick and goes on with something changed."""
        from app import runner
        from engine.results.runs import checked_name

        parent, label = self.folder(run_id), checked_name(name)
        end = self.read(run_id, lambda view: view.t_end)
        if not 0 <= tick <= end:
            raise BadInput(f"a tick between 0 and {end} was expected; got {tick}")
        folder = runner.prepare_fork(
            self.catalogue, parent, tick, planner=planner, seed=seed, overrides=overrides or {}, name=label
        )
        return self._launch(folder, ["--mode", "fork", "--parent", str(parent)])

    def command(self, run_id: str, command: Mapping[str, Any]) -> dict[str, Any]:
        """An operator's command: {accepted, reason, tick, number}."""
        if not isinstance(command.get("do"), str):
            raise CommandError('a command such as {"do": "pause", "vehicle": 3} was expected; it has no "do"')
        return self._ask(run_id, "command", command=dict(command))

    def control(self, run_id: str, op: str, **values: Any) -> dict[str, Any]:
        """pause | play | step (ticks) | speed (factor; 0 = as fast as it goes) | stop | resume."""
        if op == "resume":
            return {"run_id": self.resume(run_id), "accepted": True}
        if op == "step":
            ticks = values.get("ticks", 1)
            if not isinstance(ticks, int) or isinstance(ticks, bool) or not 1 <= ticks <= 100_000:
                raise BadInput(f"a number of ticks between 1 and 100000 was expected; got {ticks!r}")
            return self._ask(run_id, "step", ticks=ticks)
        if op == "speed":
            return self._ask(run_id, "speed", factor=_checked_speed(values.get("factor", values.get("speed"))))
        if op in ("pause", "play", "stop"):
            return self._ask(run_id, op, timeout_s=60.0 if op == "stop" else ANSWER_TIMEOUT_S)
        raise BadInput(f"unknown control {op!r}; known: pause, play, resume, speed, step, stop")

    def rename(self, run_id: str, name: str) -> None:
        """Gives the run a label of at most 120 characters."""
        from engine.results.runs import checked_name

        self._own(run_id)
        label = checked_name(name)
        if self.worker_alive(run_id):
            self._ask(run_id, "label", name=label)
        else:
            self.catalogue.rename(run_id, label)

    def delete(self, run_id: str) -> None:
        """Removes the run and everything it recorded. A running one has to be stopped first."""
        self._own(run_id)
        if self.worker_alive(run_id):
            raise RunError(f"run {run_id} is running; stop it before it is deleted")
        self._forget_view(run_id)
        self.catalogue.delete(run_id)
        with self._lock:
            self._ended.pop(run_id, None)

    def close(self) -> None:
        """Every live run saves a checkpoint and ends; waits for that."""
        with self._lock:
            workers = list(self.workers.values())
        for worker in workers:
            worker.close()
        deadline = time.monotonic() + CLOSE_TIMEOUT_S
        for worker in workers:
            if not worker.ended.wait(max(0.0, deadline - time.monotonic())):
                log.warning("run %s did not end in time and is cut off", worker.run_id)
                worker.process.kill()

    def mark_interrupted(self) -> list[str]:
        """Runs that claim to be running though nobody writes them: listed as interrupted from now on."""
        from app.runner import amend

        found = []
        for entry in self.catalogue.list():
            if entry["status"] == "interrupted" and not entry["alive"]:
                note = "the program ended while it ran"
                with contextlib.suppress(RunError):
                    if amend(self.catalogue.path(entry["run_id"]), "running", status="interrupted", note=note):
                        found.append(entry["run_id"])
        return found

    def _own(self, run_id: str) -> Path:
        folder = self.folder(run_id)
        if self.is_demo(run_id):
            raise RunError(f"{run_id} came with the program and can't be changed; fork it instead")
        return folder

    def _ask(self, run_id: str, op: str, **values: Any) -> dict[str, Any]:
        self.folder(run_id)
        worker = self.worker(run_id)
        if worker is None:
            raise RunError(f"run {run_id} is not running; resume it, or fork it where you want to go on")
        answer = worker.ask(op, **values)
        answer.pop("id", None)
        if error := answer.get("error"):
            raise CommandError(str(error))
        return answer

    def _launch(self, folder: Path, arguments: list[str]) -> str:
        run_id = folder.name
        with self._starting:
            if self.worker_alive(run_id):
                raise RunError(f"run {run_id} is running already")
            self._forget_view(run_id)
            worker = Worker(run_id, folder, arguments)
            with self._lock:
                self._ended.pop(run_id, None)
                self.workers[run_id] = worker
        threading.Thread(target=self._outlive, args=(worker,), name=f"end of {run_id}", daemon=True).start()
        return run_id

    def _outlive(self, worker: Worker) -> None:
        """Waits for the process's end; one that did not close its run is recorded as failed."""
        from app.runner import amend

        worker.ended.wait()
        reason = worker.obituary()
        if reason:
            log.warning("run %s: %s", worker.run_id, reason)
            try:
                amend(worker.folder, "running", status="failed", note=reason)
            except (OSError, RunError) as error:
                log.warning("run %s: its manifest can't be written: %s", worker.run_id, error)
        self._forget_view(worker.run_id)
        with self._lock:
            if self.workers.get(worker.run_id) is worker:
                del self.workers[worker.run_id]
                self._ended[worker.run_id] = worker


def _checked_speed(factor: object) -> float:
    low, high = LIVE_SPEEDS
    if isinstance(factor, int | float) and not isinstance(factor, bool) and (factor == 0 or low <= factor <= high):
        return float(factor)
    raise BadInput(f"a speed between {low:g} and {high:g}, or 0 for as fast as it goes, was expected; got {factor!r}")


def _pace(speed: float, paused: bool) -> list[str]:
    return ["--mode", "new", "--speed", repr(_checked_speed(speed)), *(["--paused"] if paused else [])]


_manager: RunManager | None = None


def set_manager(manager: RunManager | None) -> None:
    """Makes this the program's manager; the server does it once."""
    global _manager
    _manager = manager


def manager() -> RunManager:
    """The program's manager. Raises RunError before the server has started."""
    if _manager is None:
        raise RunError("the dashboard has not started")
    return _manager
