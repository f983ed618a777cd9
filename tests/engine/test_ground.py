"""What pages show of a run on terrain follows from its log alone: it is compared with the run itself as it goes."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest

from engine import judge
from engine.results.ground import Ground, ground_of
from engine.results.view import RunView
from tests.engine.test_roaming import made, place

POINTS = 40


def looked_at(sim: Any) -> Ground:
    sim.flush()
    found = ground_of(RunView(sim.log, sim.scenario, sim.world))
    assert found is not None
    return found


def known(ground: Ground, time: float) -> Any:
    """(H, W) what was seen until a time, from the looks."""
    (rows, columns), radius = ground.world.terrain.shape, ground.world.sensor_m / ground.world.grain_m
    y, x = np.mgrid[:rows, :columns]
    seen = np.zeros((rows, columns), np.bool_)
    for cell in ground.looks(time)[1].tolist():
        seen |= (x - cell % columns) ** 2 + (y - cell // columns) ** 2 <= radius**2
    return seen


def test_what_is_known_and_where_the_robot_is_follow_from_the_log() -> None:
    sim = made()
    for _ in range(6):
        sim.advance(37)
        ground = looked_at(sim)
        assert (known(ground, sim.tick) == (sim.believed.known == 1)).all()
        shown, live = ground.view.poses(sim.tick), sim.snapshot()
        assert np.hypot(shown.x_m - live.x_m, shown.y_m - live.y_m)[0] < 1e-3
        assert shown.heading_deg[0] == pytest.approx(live.heading_deg[0], abs=1e-3)


def test_the_way_is_drawn_along_its_trajectories() -> None:
    sim, compared = made(), 0
    world, cluster = sim.world, sim.world.cluster
    while not sim.done:
        sim.advance(1)
        ground = looked_at(sim)
        plans = ground.view.reader.table("plans")["tick"]
        if not len(plans) or plans[-1] != sim.tick - 1 or compared > 5:
            continue
        wanted = [sim.graph.xy_m[sim.states[0] // 16]]
        for state, k in zip(sim.states.tolist(), sim.ks.tolist(), strict=False):
            cell, h = divmod(state, 16)
            n = int(cluster.pieces[h, k])
            wanted += list(sim.graph.xy_m[cell] + cluster.point[h, k, 1 : n + 1] * world.grain_m)
        assert ground.way(sim.tick)[1] == pytest.approx(np.array(wanted), abs=1e-6)
        compared += 1
        sim.advance(5)
    assert compared > 3
    assert looked_at(sim).way(-1)[0] == -1


def test_the_search_is_told_as_it_was_published() -> None:
    sim = made()
    assert looked_at(sim).search(0) is None
    sim.advance(60)
    sent = sim.submit({"do": "send", "vehicle": 0, "place": place(sim, 2.5, 8.0)})
    assert sent.accepted
    sim.advance(2000)
    ground, log = looked_at(sim), sim.log.table("searches")
    told = ground.search(sim.tick)
    assert told is not None
    assert (told["bound"], told["ways"], told["total"]) == (1, len(log["tick"]), int(log["expanded"].sum()))
    rows = ground.passes(-1, sim.tick)
    assert rows["anew"].sum() == 2  # a goal at the start, and another
    assert rows["t_s"][rows["anew"]][1] >= sent.tick * sim.tick_s
    assert not (rows["anew"] & rows["repaired"]).any()
    better = ~rows["anew"] & ~rows["repaired"]
    assert (np.diff(rows["bound"])[better[1:]] < 0).all()
    assert told["repairs"] == rows["repaired"].sum()
    assert [ground.goal(sent.tick - 1), ground.goal(sent.tick)] == [sim.parts.goal_cell, sim.goal_cell]
    for tick in log["tick"].tolist():  # scrubbed to any pass
        at = ground.search(tick)
        assert at is not None
        assert at["since_s"] == pytest.approx(tick * sim.tick_s)


def test_a_cell_is_told_as_it_is_and_as_the_robot_knows_it() -> None:
    sim = made()
    sim.advance(80)
    behind = place(sim, 1.1, 1.1)
    for at in (sim.search.start // 16 + 4, behind, place(sim, 9.5, 2.1)):
        sim.submit({"do": "block", "place": at})
    sim.advance(25)
    ground, rng = looked_at(sim), np.random.default_rng(3)
    changed = {p: bool(there) for p, there, _ in ground.obstacles(sim.tick)}
    assert len(changed) >= 2
    for at in [*changed, *rng.integers(0, sim.graph.n_places, POINTS).tolist()]:
        told = ground.cell(at, sim.tick)
        assert told["obstacle"] == bool(sim.truth.obstacle.flat[at])
        assert told["believed"] == bool(sim.believed.obstacle.flat[at])
        assert told["known"] == told["seen"] == bool(sim.believed.known.flat[at])
        assert told["height_m"] == pytest.approx(sim.truth.height.flat[at])
        assert told["friction"] == pytest.approx(sim.truth.friction.flat[at])


def test_the_track_and_the_power_add_up_to_what_was_drawn() -> None:
    sim = made()
    sim.advance(2000)
    ground = looked_at(sim)
    track = ground.track()
    assert min(track["k"]) >= 0
    assert track["next"] == len(sim.log.table("motions")["t0"])
    half = ground.track(track["next"] // 2)
    assert half["from"] + 0 == track["next"] // 2
    assert half["k"] == track["k"][len(track["k"]) - len(half["k"]) :]
    assert ground.track(10**9)["from"] == 0  # rows that there are not: from the beginning
    standby = ground.standby_w()
    spans = np.array(track["t1_s"]) - np.array(track["t0_s"])
    drive = float(((np.array(track["watts"]) - standby) * spans).sum())
    assert drive == pytest.approx(sim.log.table("motions")["energy_mj"].sum() / 1000, rel=0.01)
    power = ground.power(0, sim.tick, 10**6)
    t_s = np.append(0.0, power["t_s"])
    drawn = sum(float((watts * np.diff(t_s)).sum()) for watts in power["watts"].values())
    assert drawn == pytest.approx(sim.book.sum() / 1000)
    json.dumps(ground.told(sim.tick, frontier=True))
    assert ground.told(sim.tick, way=ground.way(sim.tick)[0])["way"] is None


def test_round_obstacles_are_dropped_and_taken_away_whole() -> None:
    sim = made()
    sim.advance(30)
    at = place(sim, 6.0, 2.0)
    before = sim.truth.obstacle.copy()
    assert sim.submit({"do": "block", "place": at, "radius_m": 0.8}).accepted
    dropped = np.flatnonzero(sim.truth.obstacle != before)
    y, x = np.divmod(dropped, sim.world.width)
    cy, cx = divmod(at, sim.world.width)
    assert (np.hypot(x - cx, y - cy) <= 4).all()
    assert len(dropped) >= 0.9 * np.pi * 16 - before[cy - 4 : cy + 5, cx - 4 : cx + 5].sum()
    assert not sim.submit({"do": "block", "place": at}).accepted
    assert "from 0 to 3" in sim.submit({"do": "block", "place": place(sim, 2.0, 9.0), "radius_m": 9}).reason
    own = sim.submit({"do": "block", "place": sim.search.start // 16 + 3, "radius_m": 0.8})
    assert not own.accepted
    assert "within 0.8 m" in own.reason
    assert sim.submit({"do": "unblock", "place": at, "whole": 1}).accepted
    assert not sim.truth.obstacle.flat[dropped].any()
    sim.advance(2000)
    sim.flush()
    assert sim.done
    assert [b.text for b in judge(sim.log, sim.scenario, sim.world)] == []


def test_the_ground_is_sent_as_it_is() -> None:
    sim = made()
    floor = json.loads(json.dumps(sim.world.floor_json()))
    for name, wanted in (("heights", sim.world.terrain.height_m), ("prior", sim.world.prior_m)):
        sent = np.frombuffer(base64.b64decode(floor[name]["data"]), "<u2")
        heights = floor[name]["low_m"] + floor[name]["unit_m"] * sent
        assert heights == pytest.approx(wanted.ravel(), abs=1e-3)
    friction = np.frombuffer(base64.b64decode(floor["friction"]), "<u2") / 100
    assert friction == pytest.approx(sim.world.terrain.friction.ravel(), abs=0.005)
    rows = ["".join("#" if shut else "." for shut in row) for row in sim.world.terrain.obstacle]
    assert floor["cells"] == rows
    ends = np.array(floor["cluster"]["ends"])
    for h, row in enumerate(floor["cluster"]["points"]):
        for k, points in enumerate(row):
            assert points[-1] == pytest.approx(ends[h, k, :2], abs=1e-3)
