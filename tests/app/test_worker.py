"""Live runs in processes of their own: pace, commands, kill −9, resume, fork, and the end of the server."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app import runner
from app.live import decode_frame
from app.runs import RunManager, Worker
from app.settings import Settings
from engine.errors import BadInput, CommandError, RunError
from engine.results.runlog import LogReader, read_manifest

SCENARIO = "soochow2022-continuous"
PATIENCE_S = 120.0


def until(true: Callable[[], Any], what: str) -> Any:
    """Waits for something that a process does; the test's own timeout is the judge of slowness."""
    deadline = time.monotonic() + PATIENCE_S
    while not (found := true()):
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.01)
    return found


def started(manager: RunManager, **values: Any) -> tuple[str, Worker]:
    run_id = manager.start(SCENARIO, **{"overrides": {"time.until_s": 3000.0}, "speed": 64, **values})
    worker = manager.worker(run_id)
    assert worker is not None
    until(lambda: worker.frame or not worker.alive, "the first frame")
    assert worker.frame, worker.obituary()
    return run_id, worker


def ended(manager: RunManager, run_id: str) -> dict[str, Any]:
    until(lambda: not manager.worker_alive(run_id), "the end")
    return manager.status(run_id)


def uninterrupted_digest(folder: Path, tmp_path: Path) -> str:
    """The digest of the same scenario with the same commands, run at one go."""
    from engine.results.runs import Catalogue

    twin = runner.prepare(Catalogue(tmp_path / "twin"), runner.scenario_of(folder))
    run = runner.Run.new(twin, rerun=False)
    run.pending = deque(runner.commands_after(folder, 0))
    run.advance(1_000_000)
    digest = run.sim.digest()
    run.close(judge=False)
    return str(digest)


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[RunManager]:
    made = RunManager(Settings(data=tmp_path / "data"))
    yield made
    made.close()


def test_pause_step_speed_and_commands(manager: RunManager) -> None:
    run_id, worker = started(manager, paused=True)
    assert manager.status(run_id)["paused"] is True
    tick = manager.status(run_id)["tick"]
    assert manager.control(run_id, "step", ticks=10)["accepted"]
    until(lambda: decode_frame(worker.frame).tick == tick + 10, "ten steps")
    manager.control(run_id, "step")
    until(lambda: decode_frame(worker.frame).tick == tick + 11, "one step")
    answer = manager.command(run_id, {"do": "pause", "vehicle": 1})
    assert (answer["accepted"], answer["tick"], answer["number"]) == (True, tick + 11, 0)
    answer = manager.command(run_id, {"do": "pause", "vehicle": 99})
    assert answer["accepted"] is False
    assert "99" in answer["reason"]
    # Written before they are answered, also while paused.
    log = LogReader(manager.folder(run_id)).table("commands")
    assert log["accepted"].tolist() == [1, 0]
    for nonsense in ({}, {"do": 3}):
        with pytest.raises(CommandError):
            manager.command(run_id, nonsense)
    for factor in (-1, 65, 0.1, "fast", None, True):
        with pytest.raises(BadInput, match="speed"):
            manager.control(run_id, "speed", factor=factor)
    manager.control(run_id, "play")
    until(lambda: decode_frame(worker.frame).tick > tick + 20, "going on")
    manager.rename(run_id, "live label")
    assert manager.manifest(run_id)["name"] == "live label"
    with pytest.raises(RunError, match="running"):
        manager.delete(run_id)
    assert manager.control(run_id, "stop")["accepted"]
    status = ended(manager, run_id)
    assert (status["status"], status["name"], status["resumable"]) == ("stopped", "live label", True)


def test_a_live_frame_equals_the_replayed_one(manager: RunManager) -> None:
    from app.api import replay_frame

    run_id, worker = started(manager, paused=True)
    manager.control(run_id, "step", ticks=200)
    until(lambda: decode_frame(worker.frame).tick == 200, "200 ticks")
    manager.command(run_id, {"do": "pause", "vehicle": 99})  # flushes
    live = decode_frame(worker.frame)
    replayed = decode_frame(replay_frame(manager, run_id, 200.0))
    assert live.tick == replayed.tick
    for column in ("x", "y", "heading", "state", "flags"):
        assert live.vehicles[column].tolist() == replayed.vehicles[column].tolist(), column


def test_a_killed_run_is_shown_resumed_and_ends_as_if_nothing_had_been(manager: RunManager, tmp_path: Path) -> None:
    run_id, worker = started(manager)
    until(lambda: decode_frame(worker.frame).tick > 100, "some ticks")
    manager.command(run_id, {"do": "pause", "vehicle": 2})
    manager.control(run_id, "pause")  # saves a checkpoint
    manager.control(run_id, "play")
    manager.command(run_id, {"do": "rate", "per_h": 200})
    until(lambda: decode_frame(worker.frame).tick > 300, "more ticks")
    manager.command(run_id, {"do": "continue", "vehicle": 2})
    os.kill(worker.process.pid, signal.SIGKILL)
    status = ended(manager, run_id)
    until(lambda: manager.status(run_id)["status"] == "failed", "the verdict")
    status = manager.status(run_id)
    assert "SIGKILL" in status["note"]
    assert status["resumable"]
    with pytest.raises(RunError, match="not running"):
        manager.command(run_id, {"do": "continue", "vehicle": 2})
    manager.control(run_id, "resume")
    manager.control(run_id, "speed", factor=0)
    assert ended(manager, run_id)["status"] == "finished"
    manifest = until(lambda: (m := manager.manifest(run_id))["breaches"] is not None and m, "the judge")
    assert manifest["digest"] == uninterrupted_digest(manager.folder(run_id), tmp_path)
    assert (manifest["breaches"], manifest["ticks"]) == (0, 3000)


def test_a_run_killed_before_its_first_checkpoint_begins_again(manager: RunManager, tmp_path: Path) -> None:
    run_id, worker = started(manager)
    manager.command(run_id, {"do": "pause", "vehicle": 1})
    os.kill(worker.process.pid, signal.SIGKILL)
    ended(manager, run_id)
    shutil.rmtree(manager.folder(run_id) / "checkpoints", ignore_errors=True)
    until(lambda: manager.status(run_id)["status"] == "failed", "the verdict")
    manager.control(run_id, "resume")
    manager.control(run_id, "speed", factor=0)
    assert ended(manager, run_id)["status"] == "finished"
    assert manager.manifest(run_id)["digest"] == uninterrupted_digest(manager.folder(run_id), tmp_path)


def test_without_a_server_a_run_saves_itself(manager: RunManager, tmp_path: Path) -> None:
    run_id, worker = started(manager)
    until(lambda: decode_frame(worker.frame).tick > 50, "some ticks")
    worker.close()  # what the pipe shows when the server is killed
    status = ended(manager, run_id)
    assert worker.exit_code == 0
    assert (status["status"], status["resumable"]) == ("interrupted", True)
    assert runner.checkpoints(manager.folder(run_id))
    manager.control(run_id, "resume")
    manager.control(run_id, "speed", factor=0)
    assert ended(manager, run_id)["status"] == "finished"
    assert manager.manifest(run_id)["digest"] == uninterrupted_digest(manager.folder(run_id), tmp_path)


def test_a_fork_shares_the_past_and_names_its_parent(manager: RunManager) -> None:
    run_id, worker = started(manager)
    until(lambda: decode_frame(worker.frame).tick > 60, "some ticks")
    manager.control(run_id, "pause")  # saves a checkpoint
    manager.control(run_id, "step", ticks=60)
    until(lambda: manager.command(run_id, {"do": "pause", "vehicle": 99}) and True, "a flush")
    end = decode_frame(worker.frame).tick
    tick = until(lambda: decode_frame(worker.frame).tick >= end and end - 7, "a tick to fork at")
    until(lambda: manager.read(run_id, lambda view: view.t_end) >= tick, "the log")
    fork = manager.fork(run_id, tick, seed=99)
    child = manager.worker(fork)
    assert child is not None
    until(lambda: child.frame or not child.alive, "the fork's first frame")
    assert child.frame, child.obituary()
    assert read_manifest(manager.folder(fork))["parent"] == {"run_id": run_id, "tick": tick, "change": {"seed": 99}}
    manager.control(fork, "stop")
    ended(manager, fork)
    for name in ("motions", "orders", "commands"):
        mine, theirs = (LogReader(manager.folder(which)).table(name) for which in (fork, run_id))
        column = "t1" if name == "motions" else "tick"
        for key in mine:
            if key in ("number", "command", "reason") and name == "commands":
                continue
            ours = mine[key][mine[column] < tick].tolist()
            assert ours == theirs[key][theirs[column] < tick].tolist(), (name, key)


def test_claims_without_a_writer_are_listed_as_interrupted(manager: RunManager, recorded: Path, run_id: str) -> None:
    folder = manager.settings.runs / run_id
    shutil.copytree(recorded / "runs" / run_id, folder)
    manifest = {**read_manifest(folder), "status": "running"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    again = RunManager(manager.settings)
    entry = next(e for e in again.list() if e["run_id"] == run_id)
    assert (entry["status"], entry["alive"]) == ("interrupted", False)
    assert read_manifest(folder)["status"] == "interrupted"


def test_a_full_disk_stops_the_run_with_a_sentence(manager: RunManager, monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    # The process inherits a limit on file sizes: the log's next write fails, as on a full disk.
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        run_id = manager.start(SCENARIO, speed=0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    ended(manager, run_id)
    until(lambda: manager.status(run_id)["status"] == "failed", "the verdict")
    note = manager.status(run_id)["note"]
    assert note
    assert "Traceback" not in note
    assert manager.list()
