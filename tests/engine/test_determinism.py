"""Same scenario, seed and commands give the same digest, however the run is cut, recorded, resumed or replayed."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest

import assets
from engine import MemoryLog, judge, load
from engine.build import build, replay, resume, swap
from engine.errors import RunError, ScenarioError
from engine.sim import checkpoint as saving

TROUBLE: dict[str, object] = {
    "faults.delay_probability": 0.05,
    "faults.breakdowns_per_vehicle_day": 60.0,
    "faults.repair_s": 200.0,
}
VARIANTS: dict[str, dict[str, object]] = {
    "plain": {},
    "trouble": TROUBLE,
    "trouble, margin": {**TROUBLE, "floor.margin_ticks": 1},
    "trouble, pivot of two ticks": {**TROUBLE, "motion.turning": "pivot", "motion.turn_ticks": 2},
    "trouble, classical": {**TROUBLE, "floor.occupancy": "mapf"},
    "trouble, eight directions": {**TROUBLE, "floor.connectivity": 8},
    "energy": {"planner.objective": "energy"},
    "timed routes": {**TROUBLE, "planner.name": "quickest"},
    "routes of A*": {**TROUBLE, "planner.name": "astar", "planner.parameters.tie": "lifo"},
    "routes of A*, eight directions": {"planner.name": "astar", "floor.connectivity": 8},
    "routes of EEA*": {**TROUBLE, "planner.name": "eea"},
    "routes of EEA* as printed": {"planner.name": "eea", "planner.parameters.variant": "literal-cell-time"},
    "few chargers for many": {"fleet.count": 15, "battery.initial_soc": [0.3, 0.5]},
}

Command = tuple[int, int, dict[str, Any]]


def scenario(changes: dict[str, object]):
    return load("soochow2022-continuous", changes)


def some_command(rng: random.Random, sim: Any) -> dict[str, Any]:
    """A command that may or may not make sense now."""
    vehicle, place = rng.randrange(sim.n + 1), rng.randrange(sim.graph.n_places)
    charger = rng.randrange(len(sim.charger_out))
    blocked = sim.blocked.nonzero()[0].tolist()
    return rng.choice(
        [
            {"do": "order", "from": rng.randint(1, 18), "to": rng.randint(1, 19)},
            {"do": "withdraw", "order": rng.randrange(len(sim.book) + 1)},
            {"do": "charge", "vehicle": vehicle},
            {"do": "send", "vehicle": vehicle, "place": place},
            {"do": "pause", "vehicle": vehicle},
            {"do": "continue", "vehicle": vehicle},
            {"do": "fail", "vehicle": vehicle},
            {"do": "repair", "vehicle": vehicle},
            {"do": "block", "place": place},
            {"do": "unblock", "place": blocked[0] if blocked else place},
            {"do": "charger out", "charger": charger},
            {"do": "charger back", "charger": charger},
            {"do": "rate", "per_h": rng.randint(50, 250)},
            {"do": "thresholds", "good": rng.random() * 0.5},
            {"do": "dance"},
        ]
    )


def operated(sim: Any, seed: int, until: int, every: int = 40) -> list[Command]:
    """Advance a simulation while somebody gives it commands; returns them."""
    rng = random.Random(seed)
    given: list[Command] = []
    while sim.tick < until:
        sim.advance(min(rng.randint(1, every), until - sim.tick))
        command = some_command(rng, sim)
        answer = sim.submit(command)
        assert answer.tick == sim.tick
        assert answer.reason
        given.append((answer.tick, answer.number, command))
    return given


@pytest.mark.parametrize("name", VARIANTS)
def test_the_judge_finds_nothing(name):
    asked = scenario(VARIANTS[name])
    log = MemoryLog()
    sim = build(asked, recorder=log)
    for _ in range(4):
        sim.advance(900)
        sim.check()
    sim.flush()
    assert judge(log, asked, sim.world) == []
    assert sim.metrics()["orders_done"] > 60
    assert sim.metrics()["stranded"] == 0


@pytest.mark.parametrize("seed", range(4))
def test_nothing_an_operator_says_breaks_a_rule(seed):
    asked = scenario({**TROUBLE, "seed": seed})
    log = MemoryLog()
    sim = build(asked, recorder=log)
    operated(sim, seed, until=2500)
    sim.advance(500)
    sim.flush()
    assert judge(log, asked, sim.world) == []


def test_the_digest_knows_neither_steps_nor_flushes_nor_recorders():
    asked = scenario(TROUBLE)
    whole = build(asked)
    whole.advance(1500)
    pieces = build(asked, recorder=MemoryLog())
    rng = random.Random(5)
    while pieces.tick < 1500:
        pieces.advance(min(rng.choice([1, 1, 7, 130]), 1500 - pieces.tick))
        if rng.random() < 0.3:
            pieces.flush()
    assert pieces.digest() == whole.digest()
    other = build(asked, seed=asked.seed + 1)
    other.advance(1500)
    assert other.digest() != whole.digest()


@pytest.mark.parametrize(
    "name", ["trouble", "trouble, margin", "trouble, pivot of two ticks", "timed routes", "routes of EEA*"]
)
def test_resuming_and_replaying_end_as_the_uninterrupted_run(name, tmp_path: Path):
    asked = scenario(VARIANTS[name])
    sim = build(asked)
    given = operated(sim, 11, until=1000)
    sim.checkpoint(tmp_path / "1000")
    given += operated(sim, 12, until=1600)
    sim.advance(400)
    again = build(asked)
    replay(again, given, 2000)
    assert again.digest() == sim.digest()
    resumed = resume(tmp_path / "1000")
    assert resumed.tick == 1000
    replay(resumed, given, 2000)
    resumed.check()
    assert resumed.digest() == sim.digest()


def test_a_fork_shares_the_past_and_changes_the_future(tmp_path: Path):
    asked = scenario(TROUBLE)
    sim = build(asked)
    sim.advance(777)
    sim.checkpoint(tmp_path / "777")
    log = MemoryLog()
    fork = build(asked, recorder=log)
    fork.advance(777)
    changed = swap(fork, planner="quickest", seed=99, overrides={"orders.rate_per_h": 100.0})
    fork.advance(2000)
    fork.flush()
    fork.check()
    assert changed.planner.name == "quickest"
    assert judge(log, asked, fork.world) == []
    sim.advance(2000)
    assert fork.digest() != sim.digest()
    with pytest.raises(ScenarioError, match="fleet"):
        swap(resume(tmp_path / "777"), overrides={"fleet.count": 3})


def test_a_checkpoint_of_other_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    sim = build("soochow2022")
    sim.advance(30)
    sim.checkpoint(tmp_path / "30")
    monkeypatch.setattr(saving, "code_version", lambda: "another")
    with pytest.raises(RunError, match="another version"):
        resume(tmp_path / "30")


def test_a_damaged_checkpoint_is_refused(tmp_path: Path):
    sim = build("soochow2022")
    sim.advance(30)
    sim.checkpoint(tmp_path / "30")
    (tmp_path / "30" / saving.ARRAYS).write_bytes(b"PK damaged")
    with pytest.raises(RunError, match="can't be read"):
        resume(tmp_path / "30")


@pytest.mark.parametrize("name", ["soochow2022-continuous", "warehouse-large"])
def test_nobody_strands_and_no_order_is_forgotten(name):
    hours = 8 if name == "soochow2022-continuous" else 0.25
    sim = build(name)
    worst = 0.0
    for _ in range(8):
        sim.advance(int(3600 * hours / 8))
        worst = max(worst, sim.metrics()["oldest_open_s"])
    assert sim.metrics()["stranded"] == 0
    assert worst < 600


def test_the_thesis_run_is_done():
    sim = build("soochow2022", seed=1)
    sim.advance(3600)
    assert sim.done
    assert sim.metrics()["orders_done"] == 10
    home = sim.graph.state_place[sim.fleet.state]
    assert set(home.tolist()) <= set(sim.world.chargers.tolist())


@pytest.mark.parametrize("name", ["demo-ten-orders", "demo-hour-with-breakdowns"])
def test_the_recorded_demos_come_out_again(name):
    folder = assets.path("demos", name)
    passport = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    sim = build(load(folder / "scenario.toml"))
    sim.advance(passport["ticks"])
    assert sim.digest() == passport["digest"], "the engine has changed: record the demos anew with `make demos`"
