"""Saving in the middle of everything: motions of several ticks, blocks, breakdowns, queues, a fork."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.build import build, replay, resume, swap
from engine.errors import RunError, ScenarioError
from engine.results.runlog import MemoryLog
from engine.scenario import parse
from engine.sim.checkpoint import ARRAYS, PLAIN
from engine.sim.judge import judge
from engine.types import FOREVER
from tests.strategies import scenario_text

FLOOR = """
#I##O##R##R##R#
...............
...............
#C#C#C#C#P#P#P#
"""
ORDERS = 'source = "poisson"\nrate_per_h = 500\nmix = [{ from = "station", to = "station", weight = 1.0 }]'


def busy(seed: int = 3, **sections: Any) -> Any:
    text = scenario_text(
        FLOOR, 6, seed=seed, orders=ORDERS,
        **{
            "floor": "margin_ticks = 1",
            "motion": 'turning = "pivot"\nturn_ticks = 3\nstraight_ticks = 2',
            "battery": "capacity_wh = 25.0\ninitial_soc = [0.25, 0.7]",
            "faults": "delay_probability = 0.1\nbreakdowns_per_vehicle_day = 200.0\nrepair_s = 40.0",
            **sections,
        },
    )  # fmt: skip
    return build(parse(text))


@pytest.mark.parametrize("tick", [0, 1, 37, 38, 39, 40, 211, 400])
def test_a_checkpoint_at_any_tick_is_the_run_itself(tick: int, tmp_path: Path) -> None:
    sim = busy()
    sim.advance(tick)
    sim.checkpoint(tmp_path / "here")
    other = resume(tmp_path / "here")
    assert other.tick == tick
    assert other.digest() == sim.digest()
    assert other.metrics() == sim.metrics()
    sim.advance(500)
    other.advance(500)
    assert other.digest() == sim.digest()
    other.check()
    for a, b in zip((*sim.fleet, *sim.claims), (*other.fleet, *other.claims), strict=True):
        assert (a == b).all()


def test_in_the_middle_of_motions_blocks_breakdowns_and_queues(tmp_path: Path) -> None:
    sim = busy()
    rng = random.Random(1)
    seen = set()
    for _ in range(900):
        sim.advance(1)
        if rng.random() < 0.05:
            sim.submit({"do": rng.choice(["block", "unblock"]), "place": rng.randrange(15, 40)})
        driving = (sim.fleet.edge >= 0) & (sim.fleet.t1 - sim.tick > 0) & (sim.fleet.t1 < FOREVER)
        now = {
            "driving": bool(driving.any()), "blocked": bool(sim.blocked.any()), "failed": bool(sim.fleet.failed.any()),
            "queue": bool(sim.queue), "unplanned": bool(sim.needs_plan), "late": bool(sim.clock[1]),
        }  # fmt: skip
        new = {k for k, v in now.items() if v} - seen
        if new:
            seen |= new
            sim.checkpoint(tmp_path / str(sim.tick))
            other = resume(tmp_path / str(sim.tick))
            other.advance(150)
            sim_then = resume(tmp_path / str(sim.tick))
            sim_then.advance(70)
            sim_then.advance(80)
            assert other.digest() == sim_then.digest()
    assert seen == {"driving", "blocked", "failed", "queue", "unplanned", "late"}


def test_what_is_saved_has_no_pickle_and_no_numpy_scalars(tmp_path: Path) -> None:
    sim = busy()
    sim.advance(200)
    sim.submit({"do": "thresholds", "good": 0.35})
    sim.checkpoint(tmp_path / "x")
    plain = json.loads((tmp_path / "x" / PLAIN).read_text())
    assert plain["tick"] == 200
    with np.load(tmp_path / "x" / ARRAYS, allow_pickle=False) as stored:
        assert all(stored[name].dtype != object for name in stored.files)
    other = resume(tmp_path / "x")
    assert other.thresholds == sim.thresholds
    assert other.levels.good.tolist() == sim.levels.good.tolist()
    assert not list(tmp_path.glob("*.part"))


def test_a_checkpoint_can_be_written_again_and_says_when_it_can_not(tmp_path: Path) -> None:
    sim = busy()
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RunError, match="could not be written"):
        sim.checkpoint(tmp_path / "file" / "below")
    with pytest.raises(RunError, match="can't be read"):
        resume(tmp_path / "nowhere")
    sim.checkpoint(tmp_path / "0")
    (tmp_path / "0" / PLAIN).write_text("{")
    with pytest.raises(RunError, match="can't be read"):
        resume(tmp_path / "0")


def test_commands_after_the_checkpoint_are_given_again(tmp_path: Path) -> None:
    sim = busy()
    given: list[tuple[int, int, dict[str, Any]]] = []

    def tell(**command: Any) -> None:
        answer = sim.submit(command)
        given.append((answer.tick, answer.number, command))

    sim.advance(50)
    tell(do="block", place=20)
    sim.checkpoint(tmp_path / "50")
    tell(do="pause", vehicle=2)
    tell(do="nonsense")
    sim.advance(120)
    tell(do="continue", vehicle=2)
    tell(do="unblock", place=20)
    sim.advance(200)
    again, whole = resume(tmp_path / "50"), busy()
    for other in (again, whole):
        replay(other, given, sim.tick)
        assert other.tick == sim.tick
        assert other.digest() == sim.digest()


def test_a_fork_in_mid_motion_goes_on_legally_and_can_be_saved_itself(tmp_path: Path) -> None:
    log = MemoryLog()
    sim = build(busy().scenario, recorder=log)
    sim.advance(100)
    while not (sim.fleet.edge >= 0).any():
        sim.advance(1)
    first = sim.tick
    swap(sim, planner="quickest", seed=77)
    orders = len(sim.book)
    sim.advance(150)
    sim.checkpoint(tmp_path / "fork")
    sim.advance(250)
    sim.flush()
    assert len(sim.book) > orders
    assert sim.tick == first + 400
    assert judge(log, sim.scenario, sim.world) == []
    other = resume(tmp_path / "fork")
    assert (other.scenario.planner.name, other.scenario.seed) == ("quickest", 77)
    other.advance(250)
    assert other.digest() == sim.digest()


@pytest.mark.parametrize(
    ("overrides", "said"),
    [({"motion.turn_ticks": 1}, "motion"), ({"floor.margin_ticks": 0}, "floor"), ({"time.tick_s": 2.0}, "time")],
)
def test_a_fork_can_not_change_what_already_happened(overrides: dict[str, Any], said: str) -> None:
    sim = busy()
    sim.advance(10)
    before = sim.digest()
    with pytest.raises(ScenarioError, match=said):
        swap(sim, overrides=overrides)
    assert sim.digest() == before


@pytest.mark.nojit_slice
def test_a_checkpoint_without_the_jit(tmp_path: Path) -> None:
    sim = busy()
    sim.advance(25)
    sim.checkpoint(tmp_path / "25")
    other = resume(tmp_path / "25")
    sim.advance(20)
    other.advance(20)
    assert other.digest() == sim.digest()
