"""`wattlane bench`: rates and ratios on this machine, measured one after the other in one run.

Machines differ and are busy: compare ratios, and rates of the same machine. Every rate is simulated or counted work
per second of wall time; a warm-up compiles what has to be compiled before anything is measured.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from app.settings import use_kernel_cache
from engine.errors import RunError

Say = Callable[[str], None]
SMALL, LARGE = "soochow2022-continuous", "warehouse-large"
FRAME_SIZES = (8, 200, 1000, 5000)
START_TIMEOUT_S = 300.0


@dataclass(frozen=True)
class Measured:
    """One line of the table; `goal` is a bound that the value should keep, as a person reads it."""

    name: str
    value: float
    unit: str
    goal: str = ""
    met: bool | None = None


def goal_at_least(name: str, value: float, unit: str, bound: float) -> Measured:
    return Measured(name, value, unit, f"≥ {bound:g}", value >= bound)


def goal_at_most(name: str, value: float, unit: str, bound: float) -> Measured:
    return Measured(name, value, unit, f"≤ {bound:g}", value <= bound)


def measure(*, quick: bool = False, say: Say = print) -> dict[str, Any]:
    """Everything, in order: {"machine": …, "results": [Measured as objects]}."""
    first = use_kernel_cache()
    from app import runner
    from app.bench_terrain import terrain

    if first:
        say("Compiling kernels, once: this takes up to a minute …")
    for scenario in (SMALL, LARGE):
        runner.warm_up(runner.asked_scenario(scenario, {}))
    results: list[Measured] = []
    with tempfile.TemporaryDirectory(prefix="wattlane-bench-") as scratch:
        folder = Path(scratch)
        say("Building floors …")
        results += floors()
        say("Simulation speed, log and recording …")
        results += simulation(folder, hours=1 if quick else 8)
        say("Replay …")
        results += replay(folder)
        say("The large warehouse …")
        results += large(folder, seconds=120 if quick else 900)
        say("Terrain …")
        results += terrain(Measured, goal_at_most, quick=quick)
        say("Frames …")
        results += frames()
        say("Starts …")
        results += starts(folder)
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    return {"machine": {**machine, "load": os.getloadavg()[0]}, "results": [asdict(one) for one in results]}


def timed_run(root: Path, scenario: str, seconds: float, *, rerun: bool) -> tuple[Path, float, Any]:
    """Runs a scenario headless as `wattlane run` does; returns folder, wall seconds without the judge, and the Tee."""
    from app import runner
    from engine.results.runs import Catalogue

    asked = runner.asked_scenario(scenario, {"time.until_s": seconds})
    folder = runner.prepare(Catalogue(root), asked)
    run = runner.Run.new(folder, rerun=rerun)
    begin = time.perf_counter()
    while not run.done:
        run.advance(600)
        run.flush()
    run.close(judge=False)
    return folder, time.perf_counter() - begin, run.tee


def simulation(root: Path, hours: float) -> list[Measured]:
    """Speed of the small scenario with its log, the share that the recording adds, and planner times."""
    seconds = hours * 3600.0
    plain: list[float] = []
    recorded: list[float] = []
    tee: Any = None
    for _ in range(3):  # in turns, so that a busy moment of the machine hits both
        _, wall_s, tee = timed_run(root / "small", SMALL, seconds, rerun=False)
        plain.append(wall_s)
        _, wall_s, _ = timed_run(root / "small", SMALL, seconds, rerun=True)
        recorded.append(wall_s)
    best, best_recorded = min(plain), min(recorded)
    plans = sorted(tee.planner_us)
    return [
        goal_at_least(f"{SMALL}, log on", seconds / best, "simulated s/s", 5000),
        goal_at_most("recording .rrd adds", 100.0 * (best_recorded / best - 1.0), "%", 25),
        Measured("plan, median CPU", plans[len(plans) // 2] / 1000.0, "ms"),
        Measured("plan, 95th percentile CPU", (tee.planner_p95_ms or 0.0), "ms"),
    ]


def floors() -> list[Measured]:
    """CPU time from a scenario to its world and motion graph, on a floor of ten thousand cells."""
    from app import runner

    asked = runner.asked_scenario(LARGE, {})
    spent = []
    for _ in range(5):
        begin = time.process_time()
        world = runner.world_of(asked)
        spent.append(time.process_time() - begin)
    name = f"floor of {world.cells.size:,} cells built, median CPU"
    return [goal_at_most(name, statistics.median(spent), "s", 1)]


def replay(root: Path) -> list[Measured]:
    """Opening the longest run recorded so far, and looking at ticks spread over it."""
    from app import runner
    from engine.results.runlog import LogReader
    from engine.results.view import RunView

    folder = max((root / "small").iterdir())
    scenario = runner.scenario_of(folder)
    world = runner.world_of(scenario)
    begin = time.perf_counter()
    view = RunView(LogReader(folder), scenario, world)
    view.poses(view.t_end / 2)
    opened_s = time.perf_counter() - begin
    looks = []
    for number in range(40):
        at = view.t_end * ((number * 17) % 40) / 40
        begin = time.perf_counter()
        view.poses(at)
        view.fleet(at)
        looks.append(time.perf_counter() - begin)
    return [
        goal_at_most("replay opens", opened_s, "s", 2),
        goal_at_most("any tick, median", 1000 * statistics.median(looks), "ms", 100),
    ]


def large(root: Path, seconds: float) -> list[Measured]:
    _, wall_s, tee = timed_run(root / "large", LARGE, seconds, rerun=False)
    return [
        goal_at_least(f"{LARGE}, log on", seconds / wall_s, "simulated s/s", 200),
        Measured(f"{LARGE}: plan, 95th percentile CPU", (tee.planner_p95_ms or 0.0), "ms"),
    ]


def frames() -> list[Measured]:
    """Frames encoded per second at several fleet sizes."""
    import numpy as np

    from app.live import encode_frame
    from engine.world.poses import Poses

    found = []
    for n in FRAME_SIZES:
        rng = np.random.default_rng(1)
        poses = Poses(**{field.name: rng.random(n).astype(np.float32) for field in fields(Poses)})
        count, begin = 0, time.perf_counter()
        while (spent := time.perf_counter() - begin) < 0.3:
            encode_frame(poses, width_m=100.0, height_m=100.0, time_s=float(count), tick=count)
            count += 1
        found.append(Measured(f"frames of {n} vehicles", count / spent, "frames/s"))
    return found


def starts(root: Path) -> list[Measured]:
    """Wall time of `--help`, and of a second start of the dashboard to its first live frame."""
    from app.runs import worker_environment

    helps = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run(
            [sys.executable, "-P", "-m", "app.cli", "--help"],
            check=True,
            stdout=subprocess.DEVNULL,
            env=worker_environment(),
        )
        helps.append(time.perf_counter() - begin)
    first_frame_s = [dashboard_start(root / "dashboard") for _ in range(2)][-1]
    return [
        goal_at_most("wattlane --help", min(helps), "s", 0.5),
        goal_at_most("second start of the dashboard to its first live frame", first_frame_s, "s", 5),
    ]


def dashboard_start(data: Path) -> float:
    """Seconds from starting the dashboard to the first live frame that it hands out. RunError when none comes."""
    from app.runs import worker_environment

    with socket.create_server(("127.0.0.1", 0)) as one:
        port = one.getsockname()[1]
    command = [sys.executable, "-P", "-m", "app.cli", "dashboard", "--no-browser", "--port", str(port)]
    begin = time.perf_counter()
    process = subprocess.Popen(
        [*command, "--data", str(data)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
    )
    try:
        while time.perf_counter() - begin < START_TIMEOUT_S and process.poll() is None:
            if has_frame(f"http://127.0.0.1:{port}"):
                return time.perf_counter() - begin
            time.sleep(0.02)
        raise RunError("the dashboard showed no live frame")
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def has_frame(address: str) -> bool:
    """True when the dashboard hands out a live frame of some run."""
    try:
        with urllib.request.urlopen(f"{address}/api/runs", timeout=10) as answer:
            live = [run["run_id"] for run in json.loads(answer.read()) if run["alive"]]
        for run_id in live:
            with urllib.request.urlopen(f"{address}/api/runs/{run_id}/frame", timeout=10) as answer:
                return answer.status == 200
    except (urllib.error.URLError, ConnectionError, TimeoutError):
        return False  # not listening yet, or no frame yet
    return False


def table(results: dict[str, Any]) -> str:
    """The results for a person."""
    lines = [line_of(one) for one in results["results"]]
    machine = results["machine"]
    head = f"Python {machine['python']}, {machine['machine']}, {machine['cores']} cores, load {machine['load']:.1f}"
    return "\n".join([head, *lines])


def line_of(one: dict[str, Any]) -> str:
    mark = {True: "met", False: "missed", None: ""}[one["met"]]
    goal = f"goal {one['goal']}: {mark}" if one["goal"] else ""
    return f"{one['name']:<58} {one['value']:>12,.2f} {one['unit']:<14} {goal}".rstrip()
