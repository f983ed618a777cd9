"""Recordings: what stands in the `.rrd` against what a slow reading of the same rows says."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.errors import RunError
from engine.replay import viewer
from engine.replay.sink import is_finished
from engine.results.runlog import LogReader, MemoryLog
from engine.results.schema import LIST, TABLES
from engine.results.view import RunView
from engine.scenario import Scenario, parse
from engine.types import FOREVER, PRIMITIVE_0, VehicleState
from engine.world.floor import World, build_world
from tests.conftest import ROOT
from tests.synthetic import COMMANDS, make_log, make_run, scenario_toml

TICKS, VEHICLES = 900, 5

rerun = pytest.importorskip("rerun")


class Both:
    """A recorder that passes on to several."""

    def __init__(self, *recorders: Any) -> None:
        self.recorders = recorders

    def write(self, table: str, columns: Any) -> None:
        for recorder in self.recorders:
            recorder.write(table, columns)

    def flush(self) -> None:
        for recorder in self.recorders:
            recorder.flush()


@dataclass
class Recorded:
    scenario: Scenario
    world: World
    log: MemoryLog
    path: Path
    note: dict[str, Any]


def setting(**options: Any) -> tuple[Scenario, World]:
    scenario = parse(scenario_toml(**{"vehicles": VEHICLES, "ticks": TICKS, **options}))
    return scenario, build_world(scenario)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A synthetic run with every kind of command, recorded while it went."""
    from engine.replay.recorder import RerunRecorder

    scenario, world = setting()
    log = MemoryLog()
    path = tmp_path_factory.mktemp("replay") / "run.rrd"
    with RerunRecorder(path, scenario, world, run_id="synthetic-1") as recorder:
        make_log(Both(log, recorder), scenario, world, ticks=TICKS, commands=COMMANDS, flush_every=70)
    return Recorded(scenario, world, log, path, recorder.note())


def read(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Entity → its rows as dictionaries, by tick; static rows have none."""
    from rerun.chunk import RrdReader

    out: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        out.setdefault(chunk.entity_path, []).extend(batch.to_pylist())
    for rows in out.values():
        rows.sort(key=lambda row: row.get("tick", -1))
    return out


def moving(entities: dict[str, list[dict[str, Any]]], path: str, component: str) -> dict[int, Any]:
    """tick → value of a component that isn't static."""
    rows = entities[f"/{path}"]
    return {row["tick"]: row[component] for row in rows if row.get("tick") is not None and component in row}


def rows_of(log: Any, table: str) -> list[dict[str, Any]]:
    columns = dict(log.table(table))
    for name, kind in TABLES[table].items():
        if kind == LIST:
            values, offsets = columns[name]
            columns[name] = [values[a:b].tolist() for a, b in pairwise(offsets)]
        else:
            columns[name] = columns[name].tolist()
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def slow_positions(run: Recorded, ticks: list[int]) -> dict[int, list[tuple[float, float]]]:
    """Where each vehicle is, looked up row by row; y downwards from the floor's upper edge."""
    rows = rows_of(run.log, "motions")
    newest = max(row["tick"] for row in rows_of(run.log, "keyframes"))
    rows += [row for row in rows_of(run.log, "keyframes") if row["tick"] == newest]
    height = run.world.height * run.world.cell_mm / 1000
    out: dict[int, list[tuple[float, float]]] = {}
    for tick in ticks:
        fleet = []
        for vehicle in range(run.scenario.fleet.count):
            row = next(r for r in rows if r["vehicle"] == vehicle and r["t0"] <= tick < r["t1"])
            share = (tick - row["t0"]) / (row["t1"] - row["t0"]) if row["kind"] >= PRIMITIVE_0 else 0.0
            (x0, y0), (x1, y1) = (run.world.graph.xy_m[row[end]].tolist() for end in ("from_place", "to_place"))
            fleet.append((x0 + (x1 - x0) * share, height - (y0 + (y1 - y0) * share)))
        out[tick] = fleet
    return out


def verify(path: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


# ------------------------------------------------------------------------------------------------ contents


def test_a_closed_file_verifies_and_has_statistics(recorded: Recorded) -> None:
    checked = verify(recorded.path)
    assert checked.returncode == 0, checked.stderr
    command = [sys.executable, "-m", "rerun", "rrd", "stats", str(recorded.path)]
    stats = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert stats.returncode == 0, stats.stderr
    assert "/blueprint_panel" in stats.stdout, "no blueprint"
    assert int(re.search(r"num_chunks = ([\d ]+)", stats.stdout)[1].replace(" ", "")) < 600


def test_positions_are_those_of_the_rows_at_every_second(recorded: Recorded) -> None:
    found = moving(read(recorded.path), "world/vehicles", "Points2D:positions")
    assert sorted(found) == list(range(TICKS + 1))
    some = [*range(0, TICKS, 7), TICKS]
    for tick, fleet in slow_positions(recorded, some).items():
        np.testing.assert_allclose(found[tick], fleet, atol=1e-5, err_msg=f"tick {tick}")


def test_states_colour_the_vehicles_and_fill_their_lanes(recorded: Recorded) -> None:
    from engine.replay import looks

    entities = read(recorded.path)
    classes = moving(entities, "world/vehicles", "Points2D:class_ids")
    changes = rows_of(recorded.log, "states")
    for tick in range(0, TICKS + 1, 11):
        shown = [VehicleState(number - looks.STATE_CLASS_0) for number in classes[tick]]
        assert shown == [
            [row["state"] for row in changes if row["vehicle"] == v and row["tick"] <= tick][-1]
            for v in range(VEHICLES)
        ]
    for v in range(VEHICLES):
        lane = moving(entities, looks.lane(v, VEHICLES), "StateChange:state")
        words: dict[int, str] = {}
        for row in changes:
            if row["vehicle"] == v:
                words[int(row["tick"])] = looks.STATES[VehicleState(row["state"])][0]
        merged = {t: w for i, (t, w) in enumerate(words.items()) if i == 0 or w != list(words.values())[i - 1]}
        assert {tick: value[0] for tick, value in lane.items()} == merged


def test_the_view_of_the_run_and_the_recording_agree(recorded: Recorded) -> None:
    from engine.results.view import RunView

    view = RunView(recorded.log, recorded.scenario, recorded.world)
    entities = read(recorded.path)
    found = moving(entities, "world/vehicles", "Points2D:positions")
    loads = moving(entities, "world/vehicles/load", "Points2D:positions")
    height = recorded.world.height * recorded.world.cell_mm / 1000
    for tick in range(0, TICKS, 13):
        poses = view.poses(float(tick))
        np.testing.assert_allclose(found[tick], np.stack([poses.x_m, height - poses.y_m], 1), atol=1e-5)
        assert len(loads[tick] or []) == int(poses.loaded.sum())


def test_charge_energy_and_orders_follow_the_log(recorded: Recorded) -> None:
    from engine.results.view import RunView

    entities = read(recorded.path)
    capacity = RunView(recorded.log, recorded.scenario, recorded.world).capacity_mc
    soc = moving(entities, "battery/soc", "Scalars:scalars")
    rolling = moving(entities, "energy/rolling", "Scalars:scalars")
    sums: dict[int, int] = {}
    for row in rows_of(recorded.log, "battery"):
        assert soc[row["tick"]][row["vehicle"]] == pytest.approx(100 * row["charge_mc"] / capacity)
        sums[int(row["tick"])] = sums.get(int(row["tick"]), 0) + int(row["rolling_mj"])
    assert set(soc) == set(sums)
    begun = {t: s / 1e6 for t, s in sums.items() if s}  # a curve begins with its first joule
    assert {tick: value[0] for tick, value in rolling.items()} == pytest.approx(begun)

    orders = rows_of(recorded.log, "orders")
    done, is_open = 0, 0
    wanted: dict[int, tuple[int, int]] = {}
    for row in orders:
        done += row["state"] == 3
        is_open += (row["state"] == 0) - (row["state"] in (3, 4))
        wanted[int(row["tick"])] = (done, is_open)
    for i, series in enumerate(("done", "open")):
        found = moving(entities, f"orders/{series}", "Scalars:scalars")
        assert {tick: value[0] for tick, value in found.items()} == {tick: both[i] for tick, both in wanted.items()}
    rate = moving(entities, "orders/per_hour", "Scalars:scalars")
    assert rate[600][0] == pytest.approx(6.0 * sum(row["state"] == 3 and row["tick"] <= 600 for row in orders))


def test_occupancy_is_the_share_of_samples_by_minute(recorded: Recorded) -> None:
    entities = read(recorded.path)
    classes = moving(entities, "world/vehicles", "Points2D:class_ids")
    shares = moving(entities, "fleet/activity", "Scalars:scalars")
    assert min(shares) == 60
    idle = np.mean([c == 32 for tick in range(60, 120) for c in classes[tick]])
    assert shares[120][4] == pytest.approx(100 * idle)
    assert all(sum(row) == pytest.approx(100) for row in shares.values())


def test_routes_appear_with_a_plan_and_go_when_it_ends(recorded: Recorded) -> None:
    from engine.replay import looks

    entities = read(recorded.path)
    plans = rows_of(recorded.log, "plans")
    xy = recorded.world.graph.xy_m * [1, -1] + [0, recorded.world.height * recorded.world.cell_mm / 1000]
    for v in range(VEHICLES):
        mine = [plan for plan in plans if plan["vehicle"] == v]
        rows = moving(entities, looks.route(v), "LineStrips2D:strips")
        for plan, following in zip(mine, [*mine[1:], None], strict=True):
            if following is not None and following["tick"] == plan["tick"]:
                continue
            if len(plan["places"]) > 1:
                np.testing.assert_allclose(rows[plan["tick"]][0], xy[plan["places"]], atol=1e-5)
            over = following["tick"] if following is not None else TICKS + 1
            if plan["end"] < over:
                assert rows[plan["end"]] == []


def test_reserved_places_are_those_of_the_plans_in_force(recorded: Recorded) -> None:
    entities = read(recorded.path)
    found = moving(entities, "world/reserved", "Boxes2D:centers")
    height = recorded.world.height * recorded.world.cell_mm / 1000
    plans = rows_of(recorded.log, "plans")
    for tick in range(0, TICKS, 17):
        wanted = []
        for v in range(VEHICLES):
            given = [plan for plan in plans if plan["vehicle"] == v and plan["tick"] <= tick]
            for plan in given[-1:]:
                for place, t_in, t_out in zip(plan["places"], plan["t_in"], plan["t_out"], strict=True):
                    if t_in <= tick < t_out:
                        x, y = recorded.world.graph.xy_m[place].tolist()
                        wanted.append((round(x, 3), round(height - y, 3)))
        latest = found[max(t for t in found if t <= tick)]
        assert sorted((round(x, 3), round(y, 3)) for x, y in latest or []) == sorted(wanted), tick


def test_events_commands_and_blocked_places_are_told(recorded: Recorded) -> None:
    entities = read(recorded.path)
    told = [(row["tick"], row["TextLog:text"][0]) for row in entities["/events"]]
    assert sorted(told) == sorted((row["tick"], row["text"]) for row in rows_of(recorded.log, "events"))
    levels = {row["TextLog:text"][0]: row["TextLog:level"][0] for row in entities["/events"]}
    assert levels["vehicle 2 broke down"] == "ERROR"
    commands = [row["TextLog:text"][0] for row in entities["/events/commands"]]
    assert len(commands) == len(COMMANDS)
    assert any(text.startswith('accepted: {"do": "pause"') for text in commands)
    blocked = moving(entities, "world/blocked", "Boxes2D:centers")
    assert [len(boxes or []) for _, boxes in sorted(blocked.items())] == [1, 0]
    good = moving(entities, "battery/levels/good", "Scalars:scalars")
    assert good == {0: [30.0], 700: [40.0], TICKS: [40.0]}


def test_both_timelines_tell_the_same_time(tmp_path: Path) -> None:
    from engine.replay.recorder import RerunRecorder

    scenario, world = setting(ticks=200, tick_s=0.5)
    with RerunRecorder(tmp_path / "a.rrd", scenario, world, run_id="half") as recorder:
        make_log(recorder, scenario, world, ticks=200)
    assert recorder.note()["sample_s"] == 1.0
    rows = [row for row in read(tmp_path / "a.rrd")["/world/vehicles"] if row.get("tick") is not None]
    assert [row["tick"] for row in rows] == list(range(0, 201, 2))
    assert all(row["sim_time"].total_seconds() == row["tick"] * 0.5 for row in rows)


def test_the_map_has_its_stations_chargers_and_blueprint(recorded: Recorded) -> None:
    entities = read(recorded.path)
    labels = {name: entities[f"/world/{name}"][0]["Boxes2D:labels"] for name in ("stations", "chargers", "parking")}
    assert labels["stations"] == [station.name for station in recorded.world.stations]
    assert labels["chargers"] == [f"C{i}" for i in range(1, len(recorded.world.chargers) + 1)]
    arrows = entities["/world/one_way"][0]["Arrows2D:vectors"]
    assert len(arrows) == int(np.isin(recorded.world.cells, [ord(c) for c in "<>^v"]).sum())
    picture = entities["/world/floor"][0]
    assert picture["SegmentationImage:buffer"]


# ------------------------------------------------------------------------------------------------ batches


def shuffled_batches(log: Any, seed: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """The log's rows in batches of arbitrary size, tables in arbitrary order, each keyframe behind its rows."""
    from engine.replay.rebuild import rows_at

    chance = random.Random(seed)
    tables = {name: log.table(name) for name in TABLES if name != "keyframes"}
    keys = {name: np.asarray(c["t1" if name == "motions" else "tick"]) for name, c in tables.items()}
    frames = log.table("keyframes")
    begin = -1
    for end in np.unique(frames["tick"]).tolist():
        parts = []
        for name, columns in tables.items():
            rows = np.flatnonzero((keys[name] > begin) & (keys[name] <= end))
            cuts = sorted(chance.sample(range(len(rows) + 1), min(3, len(rows) + 1)))
            for a, b in zip([0, *cuts], [*cuts, len(rows)], strict=True):
                keep = np.isin(np.arange(len(keys[name])), rows[a:b])
                parts.append((chance.random(), a, name, rows_at(name, columns, keep)))
        # Batches of one table stay in order.
        order = sorted(range(len(parts)), key=lambda i: parts[i][0])
        queues: dict[str, list[Any]] = {}
        for part in parts:
            queues.setdefault(part[2], []).append(part[3])
        for i in order:
            name = parts[i][2]
            yield name, queues[name].pop(0)
        yield "keyframes", rows_at("keyframes", frames, frames["tick"] == end)
        begin = end


def same_content(one: Path, other: Path) -> None:
    a, b = read(one), read(other)
    skip = ("/view", "/container", "/viewport", "/__", "/time_panel", "/blueprint", "/selection", "/top_panel")
    names = {name for name in a.keys() | b.keys() if not name.startswith(skip)}
    for name in sorted(names):
        mine, theirs = (
            [{k: v for k, v in row.items() if k != "rerun.controls.RowId"} for row in e[name]] for e in (a, b)
        )
        if name == "/world/reserved":
            # A batch begins with what is reserved then: compare what is seen, not how often it is said.
            mine, theirs = (_changes(rows) for rows in (mine, theirs))
        key = json.dumps
        assert sorted(key(r, default=str) for r in mine) == sorted(key(r, default=str) for r in theirs), name


def _changes(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for row in rows:
        boxes = sorted(map(tuple, row.get("Boxes2D:centers") or []))
        if row.get("tick") is not None and (not out or out[-1]["boxes"] != boxes):
            out.append({"tick": row["tick"], "boxes": boxes})
    return out


@pytest.mark.parametrize("seed", [1, 2])
def test_how_rows_are_batched_does_not_matter(recorded: Recorded, tmp_path: Path, seed: int) -> None:
    from engine.replay.recorder import RerunRecorder

    with RerunRecorder(tmp_path / "other.rrd", recorded.scenario, recorded.world, run_id="synthetic-1") as recorder:
        for table, columns in shuffled_batches(recorded.log, seed):
            recorder.write(table, columns)
    same_content(recorded.path, tmp_path / "other.rrd")


def test_a_large_fleets_lanes_and_routes_come_in_larger_chunks(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from engine.replay import looks
    from engine.replay import recorder as module

    monkeypatch.setattr(looks, "FEW", 2)
    monkeypatch.setattr(module, "ROWS_PER_VEHICLE", 5)
    with module.RerunRecorder(tmp_path / "a.rrd", recorded.scenario, recorded.world, run_id="large") as recorder:
        for table, columns in shuffled_batches(recorded.log, 4):
            recorder.write(table, columns)
    few, many = read(recorded.path), read(tmp_path / "a.rrd")
    for v in range(VEHICLES):
        lane = (looks.lane(v, VEHICLES), "StateChange:state")
        assert moving(many, *lane) == moving(few, *lane)
        route = (looks.route(v), "LineStrips2D:strips")
        assert moving(many, *route) == moving(few, *route)


def test_a_rebuilt_recording_equals_the_one_written_meanwhile(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay import rebuild

    note = rebuild.rebuild(recorded.log, recorded.scenario, recorded.world, tmp_path / "b.rrd", run_id="synthetic-1")
    assert note == recorded.note == {"sample_s": 1.0, "rerun": viewer.version()}
    assert verify(tmp_path / "b.rrd").returncode == 0
    same_content(recorded.path, tmp_path / "b.rrd")
    assert [p.name for p in tmp_path.iterdir()] == ["b.rrd"]


def test_small_slices_rebuild_the_same(recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from engine.replay import rebuild

    monkeypatch.setattr(rebuild, "SLICE_ROWS", 50)
    rebuild.rebuild(recorded.log, recorded.scenario, recorded.world, tmp_path / "b.rrd", run_id="synthetic-1")
    same_content(recorded.path, tmp_path / "b.rrd")


def test_a_long_run_is_sampled_coarser_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from engine.replay import recorder as module

    monkeypatch.setattr(module, "COARSER_AFTER", 800)
    monkeypatch.setattr(module, "LAST_BATCH", 32)
    scenario, world = setting(vehicles=4)
    with module.RerunRecorder(tmp_path / "a.rrd", scenario, world, run_id="long") as recorder:
        make_log(recorder, scenario, world, ticks=TICKS, flush_every=50)
    assert recorder.note()["sample_s"] == 4.0
    ticks = np.array(sorted(moving(read(tmp_path / "a.rrd"), "world/vehicles", "Points2D:positions")))
    assert set(np.diff(ticks)) == {1, 2, 4}
    assert np.all(np.diff(np.diff(ticks)) >= 0)


def test_a_large_fleet_is_recorded_by_its_spread(tmp_path: Path) -> None:
    from engine.replay import looks
    from engine.replay.recorder import RerunRecorder

    scenario, world = setting(ticks=100)
    many = scenario.model_copy(update={"fleet": scenario.fleet.model_copy(update={"count": looks.FEW + 1})})
    n = looks.FEW + 1
    with RerunRecorder(tmp_path / "a.rrd", many, world, run_id="many") as recorder:
        battery = {name: np.zeros(n, np.int64) for name in TABLES["battery"]}
        recorder.write("battery", {**battery, "vehicle": np.arange(n), "charge_mc": np.arange(n) * 1_000_000})
        frame = {name: np.zeros(n, np.int64) for name in TABLES["keyframes"]}
        frame |= {"vehicle": np.arange(n), "tick": np.full(n, 50), "t1": np.full(n, FOREVER), "kind": np.full(n, 4)}
        recorder.write("keyframes", frame)
    entities = read(tmp_path / "a.rrd")
    low, mean, high = moving(entities, "battery/spread", "Scalars:scalars")[0]
    assert low == 0
    assert mean == pytest.approx(high / 2)
    assert len(moving(entities, "world/vehicles", "Points2D:positions")) == 51
    assert verify(tmp_path / "a.rrd").returncode == 0


# ------------------------------------------------------------------------------------------------ failures

KILLED = """
import os, signal, sys
from pathlib import Path
from engine.replay.recorder import RerunRecorder
from engine.results.runlog import RunLogWriter
from engine.scenario import parse
from engine.world.floor import build_world
from tests.synthetic import make_log, scenario_toml

class Both:
    def write(self, table, columns):
        log.write(table, columns); recorder.write(table, columns)
    def flush(self):
        log.flush(); recorder.flush()

folder = Path(sys.argv[1])
text = scenario_toml(vehicles=5, ticks=2000)
scenario = parse(text); world = build_world(scenario)
log = RunLogWriter(folder, {"run_id": folder.name}, scenario_toml=text)
recorder = RerunRecorder(folder / "run.rrd", scenario, world, run_id=folder.name)
make_log(Both(), scenario, world, ticks=650)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_after_a_kill_the_log_gives_a_good_recording(tmp_path: Path) -> None:
    from engine.replay.rebuild import rebuild

    folder = tmp_path / "20261122-101500-killed-0001"
    died = subprocess.run(
        [sys.executable, "-c", KILLED, str(folder)], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert died.returncode == -signal.SIGKILL, died.stderr
    assert verify(folder / "run.rrd").returncode != 0
    assert not is_finished(folder / "run.rrd")

    log = LogReader(folder)
    scenario = parse((folder / "scenario.toml").read_text())
    world = build_world(scenario)
    rebuild(log, scenario, world, folder / "run.rrd", run_id=folder.name)
    assert verify(folder / "run.rrd").returncode == 0
    assert is_finished(folder / "run.rrd")
    assert not is_finished(folder / "no.rrd")
    found = moving(read(folder / "run.rrd"), "world/vehicles", "Points2D:positions")
    assert sorted(found) == list(range(651))
    run = Recorded(scenario, world, log, folder / "run.rrd", {})
    for tick, fleet in slow_positions(run, [0, 100, 333, 649]).items():
        np.testing.assert_allclose(found[tick], fleet, atol=1e-5)


def test_a_run_folder_gives_its_recording(tmp_path: Path) -> None:
    from engine.replay.rebuild import rebuild

    run_id = make_run(tmp_path, ticks=300, vehicles=3)
    scenario = parse((tmp_path / run_id / "scenario.toml").read_text())
    rebuild(LogReader(tmp_path / run_id), scenario, build_world(scenario), tmp_path / run_id / "run.rrd", run_id=run_id)
    assert verify(tmp_path / run_id / "run.rrd").returncode == 0


def test_runs_beside_each_other_are_two_trees_on_one_timeline(recorded: Recorded, tmp_path: Path) -> None:
    """Each tree is the run's own recording, with the run's totals added."""
    from engine.replay import looks
    from engine.replay.rebuild import rebuild, rebuild_beside

    other = MemoryLog()
    make_log(other, recorded.scenario, recorded.world, ticks=400, commands=COMMANDS[:2])
    logs = {"A": recorded.log, "B": other}
    views = {root: RunView(log, recorded.scenario, recorded.world) for root, log in logs.items()}
    path = tmp_path / "both.rrd"
    rebuild_beside(views, {"A": "A prioritized", "B": "B quickest"}, path)
    assert verify(path).returncode == 0
    both = read(path)
    for root, log in logs.items():
        rebuild(log, recorded.scenario, recorded.world, tmp_path / f"{root}.rrd", run_id=root)
        alone = read(tmp_path / f"{root}.rrd")
        names = {name for name in alone if not name.startswith(("/__", "/blueprint"))}
        below = {name.removeprefix(f"/{root}") for name in both if name.startswith(f"/{root}/")}
        totals = {f"/totals/{total}" for total in looks.TOTAL_WORDS}
        assert below == names | totals
        for name in (looks.VEHICLES, looks.SOC, f"{looks.ORDERS}/done"):
            component = next(key for key in alone[f"/{name}"][-1] if ":" in key)
            assert moving(both, f"{root}/{name}", component) == moving(alone, name, component)
        progress = views[root].progress(range(views[root].t_end + 1))
        for total in looks.TOTAL_WORDS:
            found = moving(both, f"{root}/totals/{total}", "Scalars:scalars")
            assert found == {tick: [pytest.approx(progress[total][tick])] for tick in found}
            assert max(found) == views[root].t_end
    shown = {
        root: {row["tick"] for row in both[f"/{root}/{looks.VEHICLES}"] if row.get("tick") is not None} for root in logs
    }
    assert shown["B"] < shown["A"]


def test_a_resumed_run_continues_its_recording(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay.rebuild import feed
    from engine.replay.recorder import RerunRecorder

    before, after = MemoryLog(), []
    for table, columns in shuffled_batches(recorded.log, 3):
        if after or (table == "keyframes" and columns["tick"][0] > 300):
            after.append((table, columns))
        else:
            before.write(table, columns)
    with RerunRecorder(tmp_path / "a.rrd", recorded.scenario, recorded.world, run_id="synthetic-1") as recorder:
        feed(recorder, before, whole=True)
        for table, columns in after:
            recorder.write(table, columns)
    same_content(recorded.path, tmp_path / "a.rrd")


def test_a_place_that_can_not_be_written_is_an_error(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay.rebuild import rebuild
    from engine.replay.recorder import RerunRecorder

    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RunError, match="can't be written"):
        RerunRecorder(tmp_path / "file" / "a.rrd", recorded.scenario, recorded.world, run_id="a")
    (tmp_path / "taken").mkdir()
    with pytest.raises(RunError, match="can't be written"):
        rebuild(recorded.log, recorded.scenario, recorded.world, tmp_path / "taken", run_id="a")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "taken"]


FULL = """
import resource, sys
from engine.errors import RunError
from engine.replay.recorder import RerunRecorder
from engine.scenario import parse
from engine.world.floor import build_world
from tests.synthetic import make_log, scenario_toml

scenario = parse(scenario_toml(vehicles=5, ticks=900)); world = build_world(scenario)
recorder = RerunRecorder(sys.argv[1], scenario, world, run_id="full")
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
for step in (lambda: make_log(recorder, scenario, world, ticks=900), recorder.close):
    try:
        step()
    except RunError as error:
        print(error)
"""


def test_a_full_disk_is_an_error(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL, str(tmp_path / "a.rrd")]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30)
    assert told.returncode == 0, told.stderr
    assert len(told.stdout.splitlines()) == 2
    assert all("can't be written: File too large" in line for line in told.stdout.splitlines())


def test_a_closed_recording_takes_nothing_more(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay.recorder import RerunRecorder

    recorder = RerunRecorder(tmp_path / "a.rrd", recorded.scenario, recorded.world, run_id="a")
    recorder.close()
    recorder.close()
    assert verify(tmp_path / "a.rrd").returncode == 0
    with pytest.raises(RunError, match="closed"):
        recorder.write("events", recorded.log.table("events"))


def test_a_recording_turned_off_by_the_environment_is_an_error(recorded: Recorded, tmp_path: Path) -> None:
    code = (
        "import sys; from tests.synthetic import *; from engine.replay.recorder import RerunRecorder;"
        "s = parse(scenario_toml()); RerunRecorder(sys.argv[1], s, build_world(s), run_id='off').close()"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.rrd")]
    told = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "RERUN": "off"}, capture_output=True, text=True, timeout=60
    )
    assert told.returncode == 1
    assert re.search("RunError: the recording .*: RERUN=off turns recording off", told.stderr)


# ------------------------------------------------------------------------------------------------ viewer


def test_the_viewer_is_fetched_once_and_calls_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ThreadPoolExecutor(2) as pool:
        folders = list(pool.map(viewer.viewer_files, [tmp_path, tmp_path]))
    assert folders[0] == folders[1] == tmp_path / f"rerun-{viewer.version()}"
    files = {path.name: path.stat().st_size for path in folders[0].iterdir()}
    assert set(files) == {*viewer.FILES, "re_viewer_bg.wasm.gz"}
    assert files["re_viewer_bg.wasm.gz"] < files["re_viewer_bg.wasm"] / 2
    page = (folders[0] / "index.html").read_text()
    assert not re.search(r"(?:src|href)=\"?https?:(?!//github)", page)
    assert "fonts.g" not in page
    assert sorted(p.name for p in tmp_path.iterdir()) == [folders[0].name, f"{folders[0].name}.lock"]

    monkeypatch.setattr(viewer, "_fetch_into", lambda folder: pytest.fail("fetched again"))
    assert viewer.viewer_files(tmp_path) == folders[0]


def test_a_viewer_that_can_not_be_had_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RunError, match="could not be put into"):
        viewer.viewer_files(tmp_path / "file")
    monkeypatch.setattr(viewer.sys, "executable", sys.executable)
    monkeypatch.setenv("RERUN_CLI_PATH", str(tmp_path / "missing"))
    with pytest.raises(RunError, match="could not be fetched") as caught:
        viewer.viewer_files(tmp_path / "cache")
    assert "\n" not in str(caught.value)
    assert [p.name for p in (tmp_path / "cache").iterdir() if p.is_dir()] == []


def test_a_page_that_calls_other_hosts_is_not_served() -> None:
    good = '<link href="https://fonts.invalid/x.css" rel="stylesheet" />\n<script src="re_viewer.js"></script>'
    assert "fonts.invalid" not in viewer.offline_page(good)
    with pytest.raises(RunError, match="calls another host"):
        viewer.offline_page(good + '<script src="https://elsewhere.invalid/count.js"></script>')
    with pytest.raises(RunError, match="has changed"):
        viewer.offline_page("<html></html>")


def test_the_native_viewer_says_why_it_does_not_open(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RunError, match="there is no recording"):
        viewer.open_native(recorded.path.with_name("missing.rrd"))
    monkeypatch.setenv("RERUN_CLI_PATH", str(recorded.path.with_name("missing")))
    monkeypatch.setattr(viewer, "OPENS_WITHIN_S", 120.0)  # a loaded machine takes its time to refuse
    with pytest.raises(RunError, match="did not open"):
        viewer.open_native(recorded.path)


def test_the_front_door_and_the_viewer_load_no_rerun() -> None:
    code = (
        "import sys, engine.replay, engine.replay.viewer; sys.exit('rerun' in sys.modules or 'pyarrow' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60).returncode == 0
