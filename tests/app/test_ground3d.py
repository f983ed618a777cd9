"""The ground in 3-D: what is put into the picture of a run, and how the picture shows it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from app.figures.ground3d import ABOVE_M, EYE, Scene, ground3d_figure
from app.pages.ground3d import eye_of, scene, sentence
from app.theme import DARK, GROUND, INK, LIGHT
from engine.build import build
from engine.results.ground import ground_of
from engine.results.runlog import MemoryLog
from engine.results.view import RunView
from engine.scenario import parse
from tests.naive_terrain import SMALL

PARTLY = SMALL.replace(
    "hills = 4", 'hills = 4\nobstacles = 5\nclear = [[1.7, 1.7], [10.1, 8.1]]\nsensor_m = 1.8\nprior = "none"'
)


@pytest.fixture(scope="module")
def driven() -> tuple[Any, Any]:
    """(ground of a run in which an operator has dropped an obstacle, its simulation)."""
    sim = build(parse(PARTLY), recorder=MemoryLog())
    sim.advance(60)
    assert sim.submit({"do": "block", "place": sim.world.place_at(30, 8)}).accepted
    sim.advance(2000)
    sim.flush()
    assert sim.done
    return ground_of(RunView(sim.log, sim.scenario, sim.world)), sim


def trace(figure: Any, name: str) -> Any:
    (found,) = (one for one in figure.data if one.name == name)
    return found


@pytest.mark.parametrize("tick", [0, 100, 10_000])
def test_a_scene_says_what_stands_where(driven: tuple[Any, Any], tick: int) -> None:
    ground, sim = driven
    at = min(tick, ground.view.t_end)
    shown = scene(ground, at)
    world = sim.world
    assert shown.height_m.shape == (len(shown.y), len(shown.x)) == world.terrain.shape
    np.testing.assert_allclose(shown.height_m, world.terrain.height_m)
    pose = ground.view.poses(at)
    assert shown.robot[0, :2] == pytest.approx((pose.x_m[0], pose.y_m[0]))
    assert shown.track[-1, :2] == pytest.approx(shown.robot[0, :2])
    assert shown.track[0, :2] == pytest.approx(world.graph.xy_m[8 * world.width + 8])
    steps = np.linalg.norm(np.diff(shown.track[:, :2], axis=0), axis=1)
    assert (steps < 0.6).all()
    assert len(shown.dropped) == (1 if at >= 60 else 0)
    area = sum(float(np.prod(high[:2] - low[:2])) for low, high in [*shown.obstacles, *shown.hidden])
    assert area == pytest.approx(world.terrain.obstacle.sum() * 0.04, rel=1e-4)
    if tick == 10_000:
        assert (shown.seen == (sim.believed.known == 1)).all()
    y, x = np.divmod(sim.goal_cell, world.width)
    assert shown.goal[0, :2] == pytest.approx(((x + 0.5) * 0.2, (y + 0.5) * 0.2))


def test_heights_as_the_robot_knows_them(driven: tuple[Any, Any]) -> None:
    ground, sim = driven
    shown = scene(ground, 50, believed=True)
    truth, prior = sim.world.terrain.height_m, sim.world.prior_m
    np.testing.assert_array_equal(shown.height_m, np.where(shown.seen, truth, prior))


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_seen_ground_lies_bright_over_pale(driven: tuple[Any, Any], scheme: str) -> None:
    shown = scene(driven[0], 100)
    figure = ground3d_figure(shown, scheme)
    bright, pale = (np.asarray(trace(figure, name).z, float) for name in ("seen", "not seen yet"))
    np.testing.assert_allclose(pale, shown.height_m, atol=1e-6)
    over = bright > pale
    assert (over == shown.seen).all()
    np.testing.assert_allclose(bright[shown.seen] - pale[shown.seen], ABOVE_M, atol=1e-5)
    assert 0 < np.isfinite(bright[~shown.seen]).sum() < (~shown.seen).sum() / 2
    ramp = [colour for _, colour in trace(figure, "seen").colorscale]
    assert ramp == [GROUND[scheme][name] for name in ("low", "mid", "high")]
    assert figure.layout.scene.xaxis.color == INK[scheme]["muted"]
    assert figure.layout.uirevision == "ground3d"
    assert len(figure.to_json()) < 400_000


def test_boxes_are_closed(driven: tuple[Any, Any]) -> None:
    shown = scene(driven[0], 100)
    mesh = trace(ground3d_figure(shown), "dropped by an operator")
    vertices = np.stack([mesh.x, mesh.y, mesh.z], 1)
    assert {tuple(v) for v in vertices.tolist()} == {
        (x, y, z) for x in shown.dropped[0, :, 0] for y in shown.dropped[0, :, 1] for z in shown.dropped[0, :, 2]
    }
    faces = np.stack([mesh.i, mesh.j, mesh.k], 1)
    edges = [tuple(sorted((f[a], f[(a + 1) % 3]))) for f in faces.tolist() for a in range(3)]
    assert len(faces) == 12
    assert all(edges.count(edge) == 2 for edge in edges)


def test_an_empty_scene_is_drawn_too() -> None:
    none, point = np.zeros((0, 3), np.float32), np.zeros((1, 3), np.float32)
    boxes, flat = np.zeros((0, 2, 3), np.float32), np.zeros((3, 4), np.float32)
    along = np.arange(4, dtype=np.float32)
    bare = Scene(along, along[:3], flat, flat > 0, boxes, boxes, boxes, none, none, point, 90.0, none)
    figure = ground3d_figure(bare, eye=(1.0, 2.0, 3.0))
    assert [one.name for one in figure.data] == ["seen", "not seen yet", "robot"]
    assert figure.layout.scene.camera.eye.to_plotly_json() == {"x": 1.0, "y": 2.0, "z": 3.0}
    json.loads(figure.to_json())


def test_the_moment_in_words(driven: tuple[Any, Any]) -> None:
    ground, _ = driven
    assert "No way has been published yet." in sentence(ground, -1, 0.1)
    first = int(ground.view.reader.table("searches")["tick"][0])
    assert "at most 2.5 times the least" in sentence(ground, first, 0.1)
    end = sentence(ground, ground.view.t_end, 0.36)
    assert end.startswith("00:00:")
    assert "36 % of the ground has been seen" in end
    assert "the cheapest there is" in end


def test_it_is_seen_from_where_it_was_turned_to() -> None:
    assert eye_of({"eye": None, "narrow": False}) == EYE
    assert eye_of({"eye": None, "narrow": True})[1] < EYE[1]
    assert eye_of({"eye": [1, 2, 3], "narrow": True}) == (1, 2, 3)
