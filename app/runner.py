"""One run with its log, recording and checkpoints, however it is driven: by the command line or by a live worker.

A run's folder is all there is to know: `manifest.json` says what was asked, `scenario.toml` is the whole scenario with
every override, `log/` what happened, `checkpoints/<tick>/` where it can go on from.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import platform
import shutil
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.jsonable import plain
from engine.errors import BadInput, RunError, ScenarioError, unknown_name
from engine.results.schema import TABLES, VERSION

if TYPE_CHECKING:
    from app.library import Library
    from engine.results.runlog import RunLogWriter
    from engine.results.runs import Catalogue
    from engine.scenario import Scenario
    from engine.scenario.checks import Finding
    from engine.sim import Simulation

log = logging.getLogger(__name__)

CHECKPOINTS_KEPT = 40
CHECKPOINT_ROWS = "rows.json"
"""Written last: a checkpoint folder without it was cut short and does not count."""
PLANNER_SAMPLES = 512
WARM_UP_TICKS = 30
LOG_BYTES = 2 * 2**30
"""What the log of an endless run may take before its oldest segments go: weeks of a small floor."""
RECORDING = "run.rrd"
PER_PLACE_OR_TIME = frozenset({"occupancy_by_place", "occupancy_over_time"})
"""Metrics too long for a summary; the log has them."""
_PACKAGES = ("wattlane", "numpy", "numba", "scipy", "pyarrow", "pydantic", "rerun-sdk")


class Tee:
    """A recorder that hands every batch to several; what comes before they are there is kept for them."""

    def __init__(self) -> None:
        self.recorders: list[Any] = []
        self._early: list[tuple[str, Mapping[str, Any]]] | None = []
        self.planner_us: deque[int] = deque(maxlen=PLANNER_SAMPLES)

    def start(self, recorders: list[Any]) -> None:
        """Names the recorders and hands them what came before."""
        self.recorders = recorders
        early, self._early = self._early or [], None
        for table, columns in early:
            self.write(table, columns)

    def write(self, table: str, columns: Mapping[str, Any]) -> None:
        if self._early is not None:
            self._early.append((table, columns))
            return
        if table == "plans":
            self.planner_us.extend(int(us) for us in columns["cpu_us"])
        for recorder in self.recorders:
            recorder.write(table, columns)

    def close(self) -> None:
        """Each recorder is closed by the run, in its own way."""

    @property
    def planner_p95_ms(self) -> float | None:
        """95th percentile of the last plans' CPU time, or None before the first."""
        if not self.planner_us:
            return None
        ordered = sorted(self.planner_us)
        return ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))] / 1000.0


@dataclass(frozen=True)
class Checkpoint:
    """A place in a run from which it can go on: the tick, the folder, and the log's rows by table until then."""

    tick: int
    folder: Path
    rows: dict[str, int]

    @property
    def state(self) -> Path:
        return self.folder / "state"


def checkpoints(run_folder: Path) -> list[Checkpoint]:
    """The complete checkpoints of a run, oldest first."""
    found = []
    for rows_file in (run_folder / "checkpoints").glob(f"*/{CHECKPOINT_ROWS}"):
        if rows_file.parent.name.isdigit():
            rows = json.loads(rows_file.read_text(encoding="utf-8"))
            found.append(Checkpoint(int(rows_file.parent.name), rows_file.parent, rows))
    return sorted(found, key=lambda c: c.tick)


@dataclass(frozen=True)
class Given:
    """An operator's command as the log has it."""

    tick: int
    command: dict[str, Any]


def commands_after(run_folder: Path, rows: int, until: int | None = None) -> list[Given]:
    """Commands from the given row of the log on, up to and including a tick."""
    from engine.results.runlog import LogReader

    table = LogReader(run_folder).table("commands")
    found = []
    for tick, text in list(zip(table["tick"], table["command"], strict=True))[rows:]:
        if until is None or tick <= until:
            found.append(Given(int(tick), json.loads(str(text))))
    return found


def last_tick(run_folder: Path) -> int:
    """The last tick that the log on disk reaches."""
    from engine.results.runlog import LogReader

    reader = LogReader(run_folder)
    ends = [0]
    for name, column in (("motions", "t1"), ("keyframes", "tick"), ("battery", "tick"), ("commands", "tick")):
        values = reader.table(name)[column]
        if len(values):
            ends.append(int(values.max()))
    return max(ends)


# What is asked


def asked_scenario(
    name: str,
    overrides: Mapping[str, object],
    *,
    seed: int | None = None,
    planner: str | None = None,
    objective: str | None = None,
    library: Library | None = None,
) -> Scenario:
    """The scenario with everything that was asked. Raises BadInput with the sentence to show.

    name: of a built-in one, of one in the library, or a path.
    """
    import engine.scenario

    asked = dict(overrides)
    for key, value in (("seed", seed), ("planner.name", planner), ("planner.objective", objective)):
        if value is not None:
            asked[key] = value
    by_name = library is not None and library.means(name)
    scenario = library.load(name, asked) if library and by_name else engine.scenario.load(name, asked)
    return checked(scenario)


def checked(scenario: Scenario) -> Scenario:
    """The scenario with its planner's own objective. Raises ScenarioError when a part is unknown or doesn't fit."""
    from engine.build import check_parameters, fitted

    check_names(scenario)
    found = fitted(scenario)
    check_parameters(found)
    return found


def check_names(scenario: Scenario) -> None:
    """Raises ScenarioError with the nearest name when a part is named that there is not; imports none of them."""
    from engine import build

    parts = (
        ("planner", scenario.planner.name, {**build.PLANNERS, **build.SOLVERS, **build.ROAMING}),
        ("dispatcher", scenario.dispatch.policy, build.DISPATCHERS),
        ("charging policy", scenario.charging.policy, build.CHARGING),
        ("demand model", scenario.energy.demand, {**build.DEMAND, **build.DRIVES}),
        ("battery model", scenario.battery.model, build.BATTERIES),
    )
    for what, name, registry in parts:
        if name not in registry:
            raise ScenarioError(unknown_name(what, name, registry))


def passport(
    scenario: Scenario, created: datetime, *, name: str = "", parent: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The manifest of a run that is about to begin."""
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "planner": scenario.planner.name,
        "objective": scenario.planner.objective,
        "dispatcher": scenario.dispatch.policy,
        "seed": scenario.seed,
        "fleet": scenario.fleet.count,
        "tick_s": scenario.time.tick_s,
        "versions": versions(),
        "parameters": dict(scenario.planner.parameters),
        "parent": dict(parent) if parent else None,
        "created": created.isoformat(timespec="seconds"),
        "status": "running",
        "ticks": 0,
        "wall_s": 0.0,
        "digest": None,
        "summary": None,
        "breaches": None,
        "log_version": VERSION,
        "retention": None,
        "note": "",
        "name": name,
    }


def versions() -> dict[str, str]:
    """Versions of what a digest depends on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def prepare(
    catalogue: Catalogue, scenario: Scenario, *, name: str = "", parent: Mapping[str, Any] | None = None
) -> Path:
    """A new run folder with its passport and scenario, ready to be run by any process."""
    from engine.results.runlog import SCENARIO, disk_errors, write_manifest

    now = datetime.now(UTC)
    folder = catalogue.new_folder(scenario.name, now)
    with disk_errors(folder):
        (folder / SCENARIO).write_text(scenario.to_toml(), encoding="utf-8")
    write_manifest(folder, {"run_id": folder.name, **passport(scenario, now, name=name, parent=parent)})
    return folder


def prepare_fork(
    catalogue: Catalogue,
    parent: Path,
    tick: int,
    *,
    planner: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
    name: str = "",
) -> Path:
    """A run folder for a fork: its scenario is the parent's with the change, its passport names parent and tick."""
    from engine.build import FORKABLE

    change: dict[str, object] = dict(overrides or {})
    if planner is not None:
        change["planner.name"] = planner
    if seed is not None:
        change["seed"] = seed
    for key in change:
        if key.split(".")[0] not in FORKABLE:
            raise BadInput(
                f"a fork can't change {key!r}: what is on the floor already depends on it; "
                f"it can change {', '.join(FORKABLE)}"
            )
    scenario = asked_scenario(str(parent / "scenario.toml"), change)
    return prepare(catalogue, scenario, name=name, parent={"run_id": parent.name, "tick": tick, "change": change})


def amend(run_folder: Path, only_if: str | None, **changes: Any) -> bool:
    """Changes the passport of a run that nobody writes, if its status is the given one; True when it did."""
    from engine.results.runlog import read_manifest, write_manifest, writer_alive

    if writer_alive(run_folder):
        return False
    manifest = read_manifest(run_folder)
    if only_if is not None and manifest.get("status") != only_if:
        return False
    write_manifest(run_folder, {**manifest, **changes})
    return True


# Running


class Run:
    """A simulation with its log. Made by `new`, `resume` or `fork`; driven by `advance`; ended by `close`.

    One Run per folder and process; the log's lock refuses a second. Disk failures raise RunError or OSError.
    """

    def __init__(self, folder: Path, writer: RunLogWriter, sim: Simulation, tee: Tee, scenario: Scenario) -> None:
        self.folder = folder
        self.writer = writer
        self.sim = sim
        self.tee = tee
        self.scenario = scenario
        self.pending: deque[Given] = deque()
        until_s = scenario.time.until_s
        self.end_tick = None if until_s is None else round(until_s / scenario.time.tick_s)
        self.catch_up_to = 0
        self.flushed_tick = sim.tick
        self.rerun: Any = None
        self._saved_tick = -1
        self._wall_before = float(writer.manifest.get("wall_s") or 0.0)
        self._began = time.monotonic()

    @property
    def wall_s(self) -> float:
        return self._wall_before + time.monotonic() - self._began

    @property
    def tick_s(self) -> float:
        return float(self.scenario.time.tick_s)

    @property
    def done(self) -> bool:
        """True at the scenario's own finish or at its `until_s`."""
        return bool(self.sim.done) or (self.end_tick is not None and self.sim.tick >= self.end_tick)

    @property
    def catching_up(self) -> bool:
        return self.sim.tick < self.catch_up_to and not self.done

    # Beginnings

    @classmethod
    def new(cls, folder: Path, *, rerun: bool = True) -> Run:
        """A run from tick 0, in a folder that `prepare` made."""
        scenario = scenario_of(folder)
        tee = Tee()
        writer = open_writer(folder, scenario)
        sim = simulation(scenario, None, tee)
        run = cls(folder, writer, sim, tee, scenario)
        run._record(rerun)
        return run

    @classmethod
    def resume(cls, folder: Path, *, rerun: bool = True) -> Run:
        """Goes on from the last checkpoint, or from the beginning when there is none.

        What the log held beyond the checkpoint is simulated again, with the operator's commands, until `catch_up_to`.
        """
        scenario = scenario_of(folder)
        saved = checkpoints(folder)
        point = saved[-1] if saved else None
        end = last_tick(folder)
        pending = commands_after(folder, point.rows["commands"] if point else 0)
        writer = open_writer(folder, scenario)
        writer.truncate_to(point.rows if point else dict.fromkeys(TABLES, 0))
        tee = Tee()
        sim = simulation(scenario, point, tee)
        run = cls(folder, writer, sim, tee, scenario)
        run.pending = deque(pending)
        run.catch_up_to = max([end, *(g.tick for g in pending)])
        run._saved_tick = point.tick if point else -1
        run.writer.update(note="", digest=None, summary=None, breaches=None)
        run._record(rerun, past=point is not None)
        return run

    @classmethod
    def fork(cls, folder: Path, parent: Path, *, rerun: bool = True) -> Run:
        """Shares the parent's past up to the passport's tick, then goes on with what the passport changes."""
        from engine.build import swap
        from engine.results.runlog import copy_log, read_manifest

        asked = read_manifest(folder)["parent"]
        tick = int(asked["tick"])
        past, scenario = scenario_of(parent), scenario_of(folder)
        point = next((c for c in reversed(checkpoints(parent)) if c.tick <= tick), None)
        if point is not None:
            copy_log(parent, folder)
        writer = open_writer(folder, scenario)
        tee = Tee()
        if point is not None:
            writer.truncate_to(point.rows)
        sim = simulation(past, point, tee)
        run = cls(folder, writer, sim, tee, past)
        run.pending = deque(commands_after(parent, point.rows["commands"] if point else 0, until=tick))
        run._record(rerun, past=point is not None)
        run.advance(tick - sim.tick)
        swap(run.sim, overrides=asked["change"])
        run.scenario = scenario
        run.checkpoint()
        return run

    def _record(self, rerun: bool, *, past: bool = False) -> None:
        """Names the recorders; with `past`, the recording begins with what the log holds already."""
        recorders: list[Any] = [self.writer]
        if rerun:
            from engine.replay.rebuild import feed
            from engine.replay.recorder import RerunRecorder
            from engine.results.runlog import LogReader

            run_id, world = self.folder.name, self.sim.world
            self.rerun = RerunRecorder(self.folder / RECORDING, self.scenario, world, run_id=run_id)
            if past:
                feed(self.rerun, LogReader(self.folder), whole=True)
            recorders.append(self.rerun)
        self.tee.start(recorders)

    # Going on

    def advance(self, ticks: int) -> int:
        """Simulates up to `ticks` more ticks, giving pending commands at theirs; returns how many it did."""
        advanced = 0
        if self.end_tick is not None:
            ticks = min(ticks, self.end_tick - self.sim.tick)
        while True:
            while self.pending and self.pending[0].tick <= self.sim.tick:
                self.sim.submit(self.pending.popleft().command)
            room = ticks - advanced
            if self.pending:
                room = min(room, self.pending[0].tick - self.sim.tick)
            if room <= 0:
                return advanced
            step = self.sim.advance(room)
            advanced += step
            if step == 0:
                return advanced

    def flush(self) -> None:
        """Everything until now is on its way to the disk when this returns."""
        self.sim.flush()
        self.writer.flush()
        self.flushed_tick = self.sim.tick

    def checkpoint(self) -> None:
        """Saves a place from which the run can go on; nothing when this tick is saved already."""
        if self.sim.tick == self._saved_tick:
            return
        self.flush()
        root = self.folder / "checkpoints"
        final = root / f"{self.sim.tick:09d}"
        draft = root / f".{self.sim.tick:09d}"
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        self.sim.checkpoint(draft / "state")
        (draft / CHECKPOINT_ROWS).write_text(json.dumps(self.writer.rows), encoding="utf-8")
        if final.exists():
            shutil.rmtree(final)
        draft.replace(final)
        self._saved_tick = self.sim.tick
        self._thin_out()

    def _thin_out(self) -> None:
        """Keeps the newest checkpoints dense and the older ones sparse."""
        saved = checkpoints(self.folder)
        if len(saved) > CHECKPOINTS_KEPT:
            for old in saved[1 : CHECKPOINTS_KEPT // 2 : 2]:
                shutil.rmtree(old.folder, ignore_errors=True)

    # Ending

    def interrupt(self, note: str) -> None:
        """Saves a checkpoint and lets go of the run, which can be resumed."""
        self.checkpoint()
        self._end_recording()
        self.writer.close("interrupted", compact=False, ticks=self.sim.tick, wall_s=round(self.wall_s, 3), note=note)

    def close(self, status: str = "finished", *, judge: bool = True) -> dict[str, Any]:
        """Ends the run for good: log, recording, passport, verdict. Returns the summary (the `run --json` object).

        A recording that can't be written costs a note, never the run.
        """
        if status != "finished":
            self.checkpoint()
        self.sim.flush()
        self.writer.flush()
        digest = self.sim.digest()
        wall_s = round(self.wall_s, 3)
        note = self._end_recording()
        summary = self._summary(status, digest, wall_s)
        self.writer.close(status, ticks=self.sim.tick, wall_s=wall_s, digest=digest, summary=summary, note=note)
        if judge:
            summary["breaches"] = judge_run(self.folder, self.scenario, self.sim.world)
            amend(self.folder, status, summary=summary, breaches=summary["breaches"])
        return summary

    def _end_recording(self) -> str:
        """Closes the recording; returns what went wrong, or an empty text."""
        if self.rerun is None:
            return ""
        try:
            self.rerun.close()
            self.writer.update(recording=self.rerun.note())
        except (RunError, OSError) as error:
            log.warning("run %s has no recording: %s", self.folder.name, error)
            return f"the Rerun recording is missing: {error}"
        finally:
            self.rerun = None
        return ""

    def _summary(self, status: str, digest: str, wall_s: float) -> dict[str, Any]:
        from app.ways_beside import WaysBeside
        from engine.build import beside_costs
        from engine.results.metrics import metrics
        from engine.results.runlog import LogReader

        reader = LogReader(self.folder)
        measured = metrics(reader, beside=beside_costs(self.scenario, self.sim.world))
        if (ways := WaysBeside.of(self.scenario, self.sim.world)) is not None:
            measured["ways_beside"] = ways.told(ways.queries(reader))
        counters = self.sim.metrics()
        return {
            "scenario": self.scenario.name,
            "planner": self.scenario.planner.name,
            "objective": self.scenario.planner.objective,
            "dispatcher": self.scenario.dispatch.policy,
            "seed": self.scenario.seed,
            "run_id": self.folder.name,
            "run_dir": str(self.folder),
            "status": status,
            "sim_s": self.sim.tick * self.tick_s,
            "wall_s": wall_s,
            "orders_created": counters["orders_created"],
            "orders_done": counters["orders_done"],
            "orders_open": counters["orders_open"],
            "breaches": None,
            "stranded": counters["stranded"],
            "energy_j": measured["energy_j"],
            "energy_by_component": measured["energy_by_component"],
            "digest": digest,
            "metrics": {name: value for name, value in measured.items() if name not in PER_PLACE_OR_TIME},
        }


def simulation(scenario: Scenario, point: Checkpoint | None, tee: Tee) -> Simulation:
    """A simulation at a checkpoint, or at tick 0 of the scenario; planning is timed by the CPU time of this thread."""
    from engine.build import build, resume

    if point is not None:
        return resume(point.state, recorder=tee, clock_ns=time.thread_time_ns)
    return build(scenario, recorder=tee, clock_ns=time.thread_time_ns)


def kernel_mark(scenario: Scenario) -> str:
    """The mark in the cache of kernels for what a live run of this scenario calls: others may call more."""
    planner = scenario.planner
    return "-".join(("live", scenario.floor.kind, planner.name, planner.objective, scenario.dispatch.policy))


def warm_up(scenario: Scenario, *, few: bool = False) -> None:
    """Compiles every kernel that a run of this scenario calls, by running a short one that nobody sees.

    few: only its planner's and its dispatcher's, since those of commands are there.
    """
    from app.settings import kernels_compiled
    from engine import traffic
    from engine.build import build

    sim = build(scenario)
    numbers = [station.number for station in sim.world.stations]
    there, back = (
        ([{"do": "order", "from": a, "to": b}] for a, b in ((numbers[0], numbers[-1]), (numbers[-1], numbers[0])))
        if numbers
        else ([], [])
    )
    said: list[dict[str, Any]] = [
        *there,
        {"do": "pause", "vehicle": 0},
        *back,
        {"do": "continue", "vehicle": 0},
        {"do": "fail", "vehicle": 0},
        {"do": "block", "place": 0},
        {"do": "repair", "vehicle": 0},
        {"do": "charge", "vehicle": 0},
    ]
    for command in there if few else said:
        sim.advance(WARM_UP_TICKS)
        sim.submit(command)
    sim.advance(WARM_UP_TICKS)
    sim.snapshot()
    sim.flush()
    kernels_compiled(kernel_mark(scenario))
    if few:
        return
    if scenario.floor.kind == "terrain":
        kernels_compiled()
        return
    # What a plan that isn't found needs: no short run is sure to meet one.
    claims, steps, fleet = sim.claims, sim.steps, sim.fleet
    at = (0, int(fleet.here[0]), int(fleet.step[0]), int(fleet.steps[0]))
    traffic.lift(claims, steps, *at)
    traffic.put_back(claims, steps, *at)
    kernels_compiled()


def scenario_of(folder: Path) -> Scenario:
    """The whole scenario of a run. Raises RunError or ScenarioError."""
    import engine.scenario

    try:
        text = (folder / "scenario.toml").read_text(encoding="utf-8")
    except OSError as error:
        raise RunError(f"the scenario of run {folder.name} can't be read: {error.strerror or error}") from None
    return engine.scenario.parse(text, source=f"{folder.name}/scenario.toml")


def world_of(scenario: Scenario) -> Any:
    """The world that a scenario describes."""
    from engine.world import build_world

    return build_world(scenario)


def open_writer(folder: Path, scenario: Scenario) -> RunLogWriter:
    """The log of a run that this process writes from now on; one that never ends is kept within LOG_BYTES."""
    from engine.results.runlog import RunLogWriter

    keyframe_ticks = max(1, round(scenario.log.keyframe_s / scenario.time.tick_s))
    endless = scenario.time.until_s is None and scenario.time.finish == "never"
    return RunLogWriter(folder, None, keyframe_ticks=keyframe_ticks, retention_bytes=LOG_BYTES if endless else None)


def judge_run(folder: Path, scenario: Scenario, world: Any) -> int:
    """Judges what is on disk, writes judge.json, and returns the number of breaches."""
    return len(judge_folder(folder, scenario, world)["breaches"])


def judge_folder(folder: Path, scenario: Scenario, world: Any) -> dict[str, Any]:
    from engine.results.runlog import LogReader
    from engine.sim.judge import judge

    breaches = judge(LogReader(folder), scenario, world)
    verdict = {"run_id": folder.name, "breaches": [plain(dataclasses.asdict(b)) for b in breaches]}
    with contextlib.suppress(OSError):  # a demo's folder may be read-only
        (folder / "judge.json").write_text(json.dumps(verdict, ensure_ascii=False, indent=1), encoding="utf-8")
    return verdict


def breach_text(breach: Mapping[str, Any]) -> str:
    """One breach for a person."""
    return f"tick {breach['tick']:>6}  {breach['kind']:<10}  {breach['text']}"


def findings_of(scenario: Scenario) -> list[Finding]:
    """What the checks on a scenario and its floor found."""
    from engine.scenario.checks import check

    return check(scenario, world_of(scenario))


def rebuild_recording(folder: Path, scenario: Scenario, world: Any) -> Path:
    """Makes `run.rrd` from the log."""
    from engine.replay.rebuild import rebuild
    from engine.results.runlog import LogReader

    target = folder / RECORDING
    rebuild(LogReader(folder), scenario, world, target, run_id=folder.name)
    return target


def default_until_s(scenario: Scenario) -> float | None:
    """Where a headless run of this scenario stops when nobody says: None at its own finish, else after an hour."""
    if scenario.time.until_s is not None or scenario.time.finish != "never":
        return None
    return 3600.0


def checked_until(scenario: Scenario, until_s: float) -> int:
    """Ticks until a simulated time; raises BadInput when there is none."""
    ticks = round(until_s / scenario.time.tick_s)
    if not 1 <= ticks < 2**30:
        raise BadInput(f"a time of at least one tick ({scenario.time.tick_s:g} s) was expected; got {until_s:g} s")
    return ticks
