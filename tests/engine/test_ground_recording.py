"""Recordings of runs on terrain: what stands below `ground` against a slow reading of the log and the map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.build import build
from engine.results.runlog import MemoryLog
from engine.results.view import RunView
from engine.scenario import parse
from engine.types import PRIMITIVE_0
from engine.world import surface
from tests.engine.test_replay import Both, moving, read, rows_of, same_content, verify
from tests.naive_terrain import SMALL, bilinear

pytest.importorskip("rerun")

PARTLY = SMALL.replace(
    "hills = 4",
    'hills = 4\nobstacles = 5\nrough = 1\nclear = [[1.7, 1.7], [10.1, 8.1]]\nsensor_m = 1.8\nprior = "none"',
)
CELL = 0.2


@dataclass
class Recorded:
    sim: Any
    log: MemoryLog
    path: Path
    entities: dict[str, list[dict[str, Any]]]
    removed: int  # an obstacle of the map that an operator took away
    dropped: int

    @property
    def height(self) -> Any:
        return self.sim.world.terrain.height_m

    def ground_at(self, x: float, y: float) -> float:
        rows, columns = self.height.shape
        x, y = min(max(x / CELL - 0.5, 0), columns - 1), min(max(y / CELL - 0.5, 0), rows - 1)
        return bilinear(self.height, x, y)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A run over half-known ground, recorded while it went; an operator drops one obstacle and removes another."""
    from engine.replay.recorder import RerunRecorder
    from engine.world import build_world

    scenario = parse(PARTLY)
    log = MemoryLog()
    path = tmp_path_factory.mktemp("ground") / "run.rrd"
    with RerunRecorder(path, scenario, build_world(scenario), run_id="ground-1") as recorder:
        sim = build(scenario, recorder=Both(log, recorder))
        removed = int(np.flatnonzero(sim.world.terrain.obstacle)[0])
        dropped = sim.world.place_at(30, 8)
        for ticks, command in ((60, ("block", dropped)), (50, ("unblock", removed))):
            sim.advance(ticks)
            answer = sim.submit({"do": command[0], "place": command[1]})
            assert answer.accepted, answer.reason
            sim.flush()
        sim.advance(2000)
        sim.flush()
        assert sim.done
    return Recorded(sim, log, path, read(path), removed, dropped)


def driven(run: Recorded) -> list[dict[str, Any]]:
    return [row for row in rows_of(run.log, "motions") if row["kind"] >= PRIMITIVE_0]


def test_the_recording_verifies_and_stays_small(recorded: Recorded) -> None:
    assert verify(recorded.path).returncode == 0
    assert recorded.path.stat().st_size < 1_500_000
    assert {"/ground/terrain", "/cluster", "/world/floor", "/ground/goal"} <= recorded.entities.keys()


def test_the_mesh_is_the_ground_from_edge_to_edge(recorded: Recorded) -> None:
    (mesh,) = (row for row in recorded.entities["/ground/terrain"] if row.get("Mesh3D:vertex_positions"))
    points = np.array(mesh["Mesh3D:vertex_positions"])
    assert (points[:, :2].min(0).tolist(), points[:, :2].max(0).tolist()) == ([0, 0], pytest.approx([12, 10]))
    for x, y, z in points[::97].tolist():
        assert z == pytest.approx(recorded.ground_at(x, y), abs=1e-4)
    a, b, c = points[np.array(mesh["Mesh3D:triangle_indices"])].transpose(1, 0, 2)
    facing = np.cross(b - a, c - a)
    assert (facing[:, 2] > 0).all(), "a triangle faces down"
    assert facing[:, 2].sum() / 2 == pytest.approx(120, rel=1e-4)


def test_what_is_seen_grows_by_what_each_look_adds(recorded: Recorded) -> None:
    world = recorded.sim.world
    radius = world.sensor_m / CELL
    known: set[tuple[int, int]] = set()
    looks = [(0, driven(recorded)[0]["from_place"])] + [(row["t1"], row["to_place"]) for row in driven(recorded)]
    wanted: dict[int, set[tuple[int, int]]] = {}
    for tick, place in looks:
        py, px = divmod(place, world.width)
        disc = {
            (x, y)
            for y in range(world.height)
            for x in range(world.width)
            if (x - px) ** 2 + (y - py) ** 2 <= radius**2
        }
        if disc - known:
            wanted[tick] = disc - known
        known |= disc
    vertices = moving(recorded.entities, "ground/seen", "Mesh3D:vertex_positions")
    triangles = moving(recorded.entities, "ground/seen", "Mesh3D:triangle_indices")
    assert sorted(vertices) == sorted(wanted)
    for tick, cells in wanted.items():
        corners = np.array(vertices[tick])[np.array(triangles[tick])]
        middle = corners.mean(1)[:, :2] / CELL
        assert {(int(x), int(y)) for x, y in middle.tolist()} == cells
        assert len(middle) == 2 * len(cells)
    believed = recorded.sim.believed.known == 1
    assert {(x, y) for y, x in np.argwhere(believed).tolist()} == known


def test_the_robot_stands_on_the_ground_and_leans_with_it(recorded: Recorded) -> None:
    view = RunView(recorded.log, recorded.sim.scenario, recorded.sim.world)
    places = moving(recorded.entities, "ground/robot", "Transform3D:translation")
    turns = moving(recorded.entities, "ground/robot", "Transform3D:quaternion")
    assert len(places) > 50
    assert set(np.diff(sorted(places))[:10]) <= {1, 2}
    for tick in sorted(places)[::7]:
        pose = view.poses(float(tick))
        (x, y, z), (qx, qy, qz, qw) = places[tick][0], turns[tick][0]
        assert (x, y) == pytest.approx((pose.x_m[0], pose.y_m[0]), abs=1e-4)
        assert z == pytest.approx(recorded.ground_at(x, y), abs=0.06)
        ahead = np.array([1 - 2 * (qy**2 + qz**2), 2 * (qx * qy + qz * qw), 2 * (qx * qz - qy * qw)])
        heading = np.rad2deg(np.arctan2(ahead[1], ahead[0]))
        assert (heading - pose.heading_deg[0] + 180) % 360 - 180 == pytest.approx(0, abs=0.01)
        flat = np.hypot(ahead[0], ahead[1])
        dx, dy = 0.3 * ahead[:2] / flat
        rise = recorded.ground_at(x + dx, y + dy) - recorded.ground_at(x - dx, y - dy)
        assert ahead[2] / flat == pytest.approx(rise / 0.6, abs=1e-3)


def test_the_driven_path_and_the_trajectories_that_lead_on(recorded: Recorded) -> None:
    strips = moving(recorded.entities, "ground/driven", "LineStrips3D:strips")
    legs = {row["t1"]: row for row in driven(recorded) if row["from_place"] != row["to_place"]}
    assert sorted(strips) == sorted(legs)
    xy = recorded.sim.world.graph.xy_m
    for tick, row in legs.items():
        ends = np.array(strips[tick][0])[[0, -1], :2]
        np.testing.assert_allclose(ends, xy[[row["from_place"], row["to_place"]]], atol=1e-4)
    cluster = recorded.sim.world.cluster
    ahead = moving(recorded.entities, "ground/trajectories", "LineStrips3D:strips")
    for row in driven(recorded)[::5]:
        found = sorted(tuple(np.round(strip[-1][:2], 3)) for strip in ahead[row["t1"]])
        moves = cluster.pieces[row["to_heading"]] > 0
        wanted = xy[row["to_place"]] + cluster.end[row["to_heading"], moves, :2] * CELL
        np.testing.assert_allclose(found, sorted(map(tuple, wanted.tolist())), atol=2e-3)


def test_open_incons_and_epsilon_are_those_of_each_publication(recorded: Recorded) -> None:
    from engine.replay.ground import FRONTIER

    rows = rows_of(recorded.log, "searches")
    assert any(row["incons_places"] for row in rows)
    for column in ("open", "incons"):
        points = moving(recorded.entities, f"ground/{column}", "Points3D:positions")
        sizes = moving(recorded.entities, f"search/frontier/{column}", "Scalars:scalars")
        for row in rows:
            places = row[f"{column}_places"]
            shown = points[row["tick"]] or []
            assert len(shown) == min(len(places), len(places[:: -(-len(places) // FRONTIER) or 1]))
            cells = {tuple(np.floor(np.array(p[:2]) / CELL).astype(int).tolist()) for p in shown}
            assert len(cells) == len(shown)
            assert cells <= {divmod(c, recorded.sim.world.width)[::-1] for c in places}
            assert sizes[row["tick"]] == [row[column]]
    epsilon = moving(recorded.entities, "search/epsilon", "Scalars:scalars")
    assert epsilon == {row["tick"]: [row["bound"] / 1000] for row in rows}


def test_ways_by_epsilon_stay_until_the_search_begins_anew_or_the_robot_arrives(recorded: Recorded) -> None:
    """Play the log back slowly: which ways are there at each tick at which anything changes."""
    searches, plans = rows_of(recorded.log, "searches"), rows_of(recorded.log, "plans")
    bounds = sorted({row["bound"] for row in searches})
    assert len(bounds) > 2
    shown: dict[int, dict[int, list[Any]]] = {
        bound: moving(recorded.entities, f"ground/ways/epsilon-{bound / 1000:g}", "LineStrips3D:strips")
        for bound in bounds
    }
    standing: dict[int, int] = {}
    last = 10**9
    xy = recorded.sim.world.graph.xy_m
    for plan, search in zip(plans, searches, strict=True):
        if search["bound"] >= last:
            standing.clear()
        standing[search["bound"]] = len(plan["places"])
        last = search["bound"]
        for bound in bounds:
            latest = [tick for tick in shown[bound] if tick <= plan["tick"]]
            strips = shown[bound][max(latest)] if latest else []
            assert [len(strip) for strip in strips] == ([standing[bound]] if bound in standing else [])
        way = np.array(shown[search["bound"]][plan["tick"]][0])
        np.testing.assert_allclose(way[:, :2], xy[plan["places"]], atol=1e-4)
    arrived = driven(recorded)[-1]["t1"]
    assert all(ways[max(ways)] == [] for ways in shown.values() if ways)
    assert max(max(ways) for ways in shown.values()) == arrived
    goal = moving(recorded.entities, "ground/goal", "Points3D:positions")
    ((where,),) = goal.values()
    assert where[:2] == pytest.approx(xy[plans[-1]["places"][-1]].tolist())


def test_power_adds_up_to_the_energy_drawn(recorded: Recorded) -> None:
    power = moving(recorded.entities, "power", "Scalars:scalars")
    ticks = sorted(row["tick"] for row in rows_of(recorded.log, "battery"))
    assert sorted(power) == ticks[1:]
    joules = sum(power[b][0] * (b - a) * 0.1 for a, b in pairwise(ticks))
    assert joules == pytest.approx(recorded.sim.book.sum() / 1000)


def test_obstacles_are_covered_by_boxes_and_follow_the_operator(recorded: Recorded) -> None:
    first = recorded.sim.world.terrain.obstacle
    without = first.copy()
    without.flat[recorded.removed] = False
    only = np.zeros_like(first)
    only.flat[recorded.dropped] = True
    assert [mask.tolist() for mask in boxed(recorded, "obstacles")] == [first.tolist(), without.tolist()]
    assert [mask.tolist() for mask in boxed(recorded, "dropped")] == [only.tolist()]


def boxed(run: Recorded, name: str) -> list[Any]:
    """Cells below the boxes of each row of an entity; none twice."""
    centres = moving(run.entities, f"ground/{name}", "Boxes3D:centers")
    halves = moving(run.entities, f"ground/{name}", "Boxes3D:half_sizes")
    out = []
    for tick in sorted(centres):
        count = np.zeros(run.height.shape, int)
        for (x, y, _), (w, d, _) in zip(centres[tick], halves[tick], strict=True):
            x0, x1, y0, y1 = (round(v / CELL) for v in (x - w, x + w, y - d, y + d))
            count[y0:y1, x0:x1] += 1
        assert count.max() <= 1
        out.append(count > 0)
    return out


def test_a_rebuilt_recording_equals_the_one_written_meanwhile(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay.rebuild import rebuild

    sim = recorded.sim
    rebuild(recorded.log, sim.scenario, sim.world, tmp_path / "b.rrd", run_id="ground-1")
    assert verify(tmp_path / "b.rrd").returncode == 0
    same_content(recorded.path, tmp_path / "b.rrd")


def test_two_runs_beside_each_other_have_a_ground_each(recorded: Recorded, tmp_path: Path) -> None:
    from engine.replay.rebuild import rebuild_beside

    view = RunView(recorded.log, recorded.sim.scenario, recorded.sim.world)
    rebuild_beside({"A": view, "B": view}, {"A": "A energy", "B": "B distance"}, tmp_path / "both.rrd")
    both = read(tmp_path / "both.rrd")
    for root in "AB":
        ticks = moving(both, f"{root}/ground/robot", "Transform3D:translation")
        assert ticks == moving(recorded.entities, "ground/robot", "Transform3D:translation")


@pytest.mark.parametrize("seed", range(3))
def test_rectangles_cover_a_mask_once(seed: int) -> None:
    mask = np.random.default_rng(seed).random((9, 13)) < 0.5
    count = np.zeros(mask.shape, int)
    for x0, y0, x1, y1 in surface.boxes(mask).tolist():
        assert x0 < x1
        assert y0 < y1
        count[y0:y1, x0:x1] += 1
    assert (count == mask).all()


def test_a_coarser_grid_keeps_the_edges() -> None:
    assert surface.every(300, 150).tolist() == [*range(0, 300, 2), 299]
    assert surface.every(5, 150).tolist() == [0, 1, 2, 3, 4]
    assert surface.every(301, 151).tolist() == list(range(0, 301, 2))


def test_light_comes_from_the_north_west() -> None:
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    level, north_west, south_east = (surface.shade(h.astype(np.float32), 1.0)[2, 2] for h in (0 * x, x - y, y - x))
    assert north_west > level > south_east
    assert level == pytest.approx(1.6 / np.linalg.norm(surface.LIGHT))
