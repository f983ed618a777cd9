"""The dashboard as people start it: a process with an address, a live run, and an end."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app.live import decode_frame
from app.server import bind, serve
from app.settings import Settings
from engine.errors import BadInput

PATIENCE_S = 150.0
WATTLANE = [sys.executable, "-m", "app.cli", "dashboard", "--no-browser"]


def until(true: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while not (found := true()):
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.05)
    return found


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as one:
        return int(one.getsockname()[1])


class Dashboard:
    """A dashboard in a process of its own."""

    def __init__(self, data: Path, *arguments: str) -> None:
        self.port = free_port()
        self.log = data / "said.txt"
        data.mkdir(parents=True, exist_ok=True)
        with self.log.open("wb") as said:
            command = [*WATTLANE, "--port", str(self.port), "--data", str(data), *arguments]
            self.process = subprocess.Popen(command, stderr=said, stdout=said)
        until(lambda: "Wattlane is at" in self.said() or self.process.poll() is not None, "the address")
        assert self.process.poll() is None, self.said()

    def said(self) -> str:
        return self.log.read_text()

    def get(self, path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=30) as answer:
            return bytes(answer.read())

    def post(self, path: str, value: dict[str, Any]) -> dict[str, Any]:
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.port}{path}",
            data=json.dumps(value).encode(),
            headers={"content-type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=30) as answer:
            return dict(json.loads(answer.read()))

    def runs(self) -> list[dict[str, Any]]:
        return [run for run in json.loads(self.get("/api/runs")) if not run["demo"]]

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(60)


@pytest.fixture
def dashboards(tmp_path: Path) -> Iterator[Callable[..., Dashboard]]:
    made: list[Dashboard] = []

    def start(*arguments: str) -> Dashboard:
        made.append(Dashboard(tmp_path / "data", *arguments))
        return made[-1]

    yield start
    for one in made:
        one.end()


def test_it_starts_a_live_run_and_saves_it_at_the_end(dashboards: Callable[..., Dashboard]) -> None:
    dashboard = dashboards()
    run = until(dashboard.runs, "a run")[0]
    assert f"/operate?run={run['run_id']}" in dashboard.said()
    path = f"/api/runs/{run['run_id']}"

    def frame() -> Any:
        try:
            return decode_frame(dashboard.get(f"{path}/frame"))
        except urllib.error.HTTPError as error:
            if error.code != 503:
                raise
            return None

    first = until(frame, "a frame")
    until(lambda: frame().time_s > first.time_s, "the next frame")
    assert dashboard.post(f"{path}/command", {"do": "rate", "per_h": 100})["accepted"] is True
    assert dashboard.post(f"{path}/control", {"op": "pause"})["paused"] is True
    dashboard.end()
    manifest = json.loads((dashboard.log.parent / "runs" / run["run_id"] / "manifest.json").read_text())
    assert manifest["status"] == "interrupted"
    assert "Traceback" not in dashboard.said()


def test_a_killed_server_leaves_runs_that_can_be_resumed(dashboards: Callable[..., Dashboard]) -> None:
    first = dashboards()
    run_id = until(first.runs, "a run")[0]["run_id"]
    path = f"/api/runs/{run_id}"
    until(lambda: json.loads(first.get(path)).get("tick", 0) > 0, "some ticks")
    first.post(f"{path}/control", {"op": "speed", "factor": 64})
    first.post(f"{path}/command", {"do": "pause", "vehicle": 2})
    os.kill(first.process.pid, signal.SIGKILL)
    first.process.wait()
    manifest_file = first.log.parent / "runs" / run_id / "manifest.json"
    until(lambda: json.loads(manifest_file.read_text())["status"] == "interrupted", "the worker's checkpoint")
    again = dashboards()
    old = next(run for run in again.runs() if run["run_id"] == run_id)
    assert (old["status"], old["alive"]) == ("interrupted", False)
    assert old["ticks"] > 0
    assert again.post(f"{path}/control", {"op": "resume"})["run_id"] == run_id

    def gone_on() -> bool:
        status = json.loads(again.get(path))
        assert status["status"] == "running", status["note"]
        return bool(status.get("tick", 0) > old["ticks"])

    until(gone_on, "going on")


def test_a_second_dashboard_on_the_same_port_is_refused(dashboards: Callable[..., Dashboard], tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(BadInput, match=f"port {port} is in use"):
            bind(Settings(data=tmp_path, port=port))
        said = subprocess.run(
            [*WATTLANE, "--port", str(port), "--data", str(tmp_path)],
            capture_output=True,
            text=True,
            check=False,
        )
    assert said.returncode == 2
    assert "in use" in said.stderr
    assert "Traceback" not in said.stderr


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-host.invalid"])
def test_a_host_that_is_not_this_machine_is_refused(host: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no address of this machine"):
        bind(Settings(data=tmp_path, host=host, token="long-enough-token"))


def test_more_than_one_web_process_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WEB_CONCURRENCY", "2")
    with pytest.raises(BadInput, match="one web process"):
        serve(Settings(data=tmp_path, port=free_port()), say=print)


def test_an_unknown_scenario_is_a_sentence(tmp_path: Path) -> None:
    said = subprocess.run(
        [*WATTLANE, "--scenario", "soochow2021", "--port", str(free_port()), "--data", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 2
    assert "did you mean" in said.stderr
    assert "Traceback" not in said.stderr


def test_ctrl_c_closes_a_headless_run_which_then_goes_on(tmp_path: Path) -> None:
    run = [sys.executable, "-m", "app.cli", "run", "soochow2022-continuous", "--until", "30d", "--no-rrd"]
    process = subprocess.Popen(
        [*run, "--data", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    until(lambda: list(tmp_path.glob("runs/*/log/motions.*")), "the log")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "resume" in err
    folder = next((tmp_path / "runs").iterdir())
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["status"], manifest["breaches"]) == ("stopped", 0)
    assert folder.name in out
    until_s = str(manifest["ticks"] + 60)
    again = [sys.executable, "-m", "app.cli", "resume", "last", "--until", until_s, "--json", "--data", str(tmp_path)]
    said = subprocess.run(again, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout)["sim_s"] == float(until_s)
