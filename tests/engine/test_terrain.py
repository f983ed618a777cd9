"""Ground, its files, trajectory clusters, and the energy of driving over it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image

from engine.energy.parameter_sets import zhang2021
from engine.energy.skid_steer import FORMS, SkidSteer, power_w, torques
from engine.energy.terrain_costs import BLOCKED, PARTS, TerrainCosts
from engine.errors import BadInput, FormatError
from engine.scenario import parse
from engine.types import Component
from engine.world.height_files import packed, read_heights, unpacked
from engine.world.lattice import BIN, HEADINGS, PRESETS, body_speeds, cluster, drive, wheel_speeds
from engine.world.relief import GENERATORS, coarse, generate, terrain_of, tilt
from engine.world.terrain import TerrainPlan, build_terrain
from tests.naive_terrain import SMALL, joules

CELL = 0.2


def robot(form: str = "climb", **changes: float) -> SkidSteer:
    return SkidSteer(60.0, form, **{**zhang2021(), **changes})


def costs_on(height: np.ndarray, form: str = "climb", name: str = "figure4", **given: object) -> TerrainCosts:
    shape = height.shape
    args = {"obstacle": np.zeros(shape, np.bool_), "friction": np.ones(shape, np.float32), "slope": 60.0, "body": 0.1}
    args |= given
    r = given.get("robot", robot(form))
    return TerrainCosts(
        cluster(name), r, CELL, height.astype(np.float32), args["obstacle"], args["friction"],
        np.ones(shape, np.bool_), args["slope"], args["body"],
    )  # fmt: skip


# ---------------------------------------------------------------- ground


@pytest.mark.parametrize("name", sorted(GENERATORS))
def test_a_generator_makes_the_same_ground_from_a_seed(name: str) -> None:
    make = {"size_m": (20.0, 14.0), "obstacles": 4, "rough": 2, "free": ((1.0, 1.0),)}
    one, again, other = generate(name, 3, **make), generate(name, 3, **make), generate(name, 4, **make)
    assert one.shape == (70, 100)
    for field in ("height_m", "obstacle", "friction"):
        assert (getattr(one, field) == getattr(again, field)).all()
    assert name == "flat" or (one.height_m != other.height_m).any()
    assert one.obstacle.any()
    assert not one.obstacle[:12, :12].any()
    assert one.friction.max() > 1 == one.friction.min()
    assert (generate(name, 3, size_m=(20.0, 14.0)).height_m == one.height_m).all()


def test_unknown_and_impossible_grounds_are_refused() -> None:
    with pytest.raises(BadInput, match="did you mean 'bumps'"):
        generate("bump", 1)
    with pytest.raises(BadInput, match="no numbers"):
        terrain_of(np.full((5, 5), np.nan))
    with pytest.raises(BadInput, match="3 × 3 to 1024"):
        terrain_of(np.zeros((2, 5)))
    with pytest.raises(BadInput, match="positive"):
        terrain_of(np.zeros((5, 5)), friction=np.zeros((5, 5)))


def test_tilt_is_the_tangent_of_a_plane() -> None:
    y, x = np.mgrid[:20, :30]
    plane = ((0.3 * x + 0.4 * y) * CELL).astype(np.float32)
    assert tilt(plane, CELL) == pytest.approx(np.full((20, 30), 0.5), abs=1e-4)


def test_a_coarse_map_keeps_means_and_loses_detail() -> None:
    ground = generate("bumps", 2, size_m=(30.0, 30.0))
    rough = coarse(ground.height_m, CELL, 5.0)
    assert rough.mean() == pytest.approx(ground.height_m.mean(), rel=0.05)
    assert rough.max() < ground.height_m.max()
    assert (coarse(np.full((30, 40), 2.0, np.float32), CELL, 5.0) == 2.0).all()


def test_heights_are_read_from_every_format(tmp_path) -> None:
    heights = np.round(np.random.default_rng(1).random((6, 9)) * 2, 3)
    np.save(tmp_path / "a.npy", heights)
    np.savez(tmp_path / "b.npz", height_m=heights, other=np.zeros(3))
    header = "ncols 9\nnrows 6\nxllcorner 0\nyllcorner 0\ncellsize 0.25\nNODATA_value -9999\n"
    rows = "\n".join(" ".join(map(str, row)) for row in heights[::-1])
    (tmp_path / "c.asc").write_text(header + rows.replace(str(heights[5, 0]), "-9999", 1))
    Image.fromarray(np.rint(heights[::-1] / 2 * 65535).astype(np.uint16)).save(tmp_path / "d.png")
    Image.fromarray(np.rint(heights[::-1] / 2 * 255).astype(np.uint8)).save(tmp_path / "e.png")
    for name, within in (("a.npy", 1e-6), ("b.npz", 1e-6), ("d.png", 2e-5), ("e.png", 4e-3)):
        found, cell_m = read_heights(tmp_path / name, low_m=0.0, high_m=2.0)
        assert found == pytest.approx(heights, abs=within + 1e-6)
        assert cell_m is None
    found, cell_m = read_heights(tmp_path / "c.asc")
    assert cell_m == 0.25
    assert found[5, 0] == pytest.approx(found[0:5].min(), abs=0.5)
    assert found[:5] == pytest.approx(heights[:5], abs=1e-6)
    assert unpacked(packed(heights.astype(np.float32))) == pytest.approx(heights, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.tif", b"", "expected .npy, .npz, .png, .asc"),
        ("a.npy", b"nothing", "not a NumPy file"),
        ("a.png", b"nothing", "not a PNG"),
        ("a.asc", b"ncols 3\nnrows 3\n1 2 3", "no positive cellsize"),
        ("a.asc", b"ncols 3\nnrows 3\ncellsize 1\n1 2 x", "line 4"),
        ("a.asc", b"ncols 3\nnrows 3\ncellsize 1\n1 2 3", "got 3 heights, expected 3 × 3"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FormatError, match=words):
        read_heights(tmp_path / name)
    with pytest.raises(FormatError, match="no such file"):
        read_heights(tmp_path / "missing.npy")


def test_damaged_heights_are_refused() -> None:
    for text in ("", "5x5", "5x5:!!", "2x2:eJw=", "9999x9999:eJw="):
        with pytest.raises(BadInput, match="damaged"):
            unpacked(text)


# ---------------------------------------------------------------- trajectories


def test_kinematics_invert_each_other() -> None:
    for v, omega in ((0.5, 0.0), (0.3, 0.39), (0.0, -0.2)):
        assert body_speeds(*wheel_speeds(v, omega, 0.165, 0.8), 0.165, 0.8) == pytest.approx((v, omega))


def test_constant_controls_follow_the_kinematic_model() -> None:
    """Equation (13) integrated in small steps meets the closed form, better the smaller they are."""
    v, omega, seconds = 0.4, 0.35, 2.0
    expected, off = drive(v, omega, seconds, 0.3), []
    for n in (50, 100):
        x = y = 0.0
        for i in range(n):
            heading = 0.3 + omega * seconds * i / n
            x, y = x + v * math.cos(heading) * seconds / n, y + v * math.sin(heading) * seconds / n
        off.append(math.hypot(x - expected[0], y - expected[1]))
    assert off[1] < 0.55 * off[0] < 0.02


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_trajectory_ends_where_the_lattice_says(name: str) -> None:
    """Driven with its own curvature, piece by piece, it comes to the centre of its cell and to its heading."""
    c = cluster(name)
    assert name != "figure4" or c.size == 7
    for h, k in np.ndindex(HEADINGS, c.size):
        n, (dx, dy, to) = int(c.pieces[h, k]), c.end[h, k].tolist()
        seconds = float(c.seconds[h, k])
        assert seconds / 0.1 == pytest.approx(round(seconds / 0.1))
        if n == 0:
            assert (dx, dy) == (0, 0)
            assert abs((to - h + 8) % 16 - 8) * BIN / seconds <= math.pi / 8 + 1e-9
            continue
        bend = np.interp(np.arange(64 * n) / 64 + 1 / 128, np.arange(n) + 0.5, c.bend[h, k, :n])
        first, last = bend[64 // 2], bend[-64 // 2]
        if n > 1:  # curvature is linear: carry it on to both ends
            slope = (last - first) / (n - 1)
            middle = np.arange(64 * n) / 64 + 1 / 128 - 0.5
            bend = c.bend[h, k, 0] + slope * middle
        step = c.piece_m[h, k] / 64
        heading = h * BIN + np.cumsum(bend) * step - bend * step / 2
        x, y = np.sum(np.cos(heading)) * step / CELL, np.sum(np.sin(heading)) * step / CELL
        assert (x, y) == pytest.approx((dx, dy), abs=0.02)
        turned = (np.sum(bend) * step / BIN + h - to + 8) % 16 - 8
        assert turned == pytest.approx(0, abs=0.02)
        length = float(c.piece_m[h, k]) * n
        assert length / seconds <= 0.5 + 1e-9
        assert np.abs(bend).max() * length / seconds <= math.pi / 8 * 1.001
        assert {(0, 0), (dx, dy)} <= set(map(tuple, c.swept[h, k, : c.n_swept[h, k]].tolist()))
        assert len({tuple(e) for e in c.end[h].tolist()}) == c.size


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_cluster_has_the_symmetries_of_the_grid(name: str) -> None:
    c = cluster(name)
    for h in range(HEADINGS):
        here = {(*e, round(float(s), 6)) for e, s in zip(map(tuple, c.end[h].tolist()), c.seconds[h], strict=True)}
        turned = {(-y, x, (to + 4) % 16, s) for x, y, to, s in here}
        mirrored = {(y, x, (4 - to) % 16, s) for x, y, to, s in here}
        for other, expected in (((h + 4) % 16, turned), ((4 - h) % 16, mirrored)):
            ends = zip(map(tuple, c.end[other].tolist()), c.seconds[other], strict=True)
            assert {(*e, round(float(s), 6)) for e, s in ends} == expected


def test_the_lattice_joins_every_state_to_every_other() -> None:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    costs = costs_on(np.zeros((14, 14)))
    s, k = np.nonzero(costs.cost < BLOCKED)
    end = costs.cluster.end[s % 16, k]
    there = (s // 16 + end[:, 1] * 14 + end[:, 0]) * 16 + end[:, 2]
    graph = csr_array((np.ones(len(s)), (s, there)), shape=(len(costs.cost),) * 2)
    assert connected_components(graph, connection="strong")[0] == 1


def test_a_robot_that_is_too_slow_for_its_cells_is_refused() -> None:
    with pytest.raises(BadInput, match="expected smaller cells or a faster robot"):
        cluster("figure4", cell_m=5.0)
    with pytest.raises(BadInput, match="did you mean 'figure4'"):
        cluster("figure")


def test_a_world_of_terrain_keeps_within_memory() -> None:
    world = build_terrain(TerrainPlan(terrain_of(np.zeros((300, 300))), 0.1))
    graph = world.graph
    held = sum(a.nbytes for name in graph.__slots__ if isinstance(a := getattr(graph, name), np.ndarray))
    assert held < 60e6
    assert graph.n_states == 300 * 300 * 16
    assert world.place_at(3, 5) == 5 * 300 + 3
    assert world.label(world.place_at(3, 5)) == "cell (3, 5)"
    assert world.place_at(300, 0) == -1


# ---------------------------------------------------------------- energy


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("changes", [{}, {"recovery": 0.6, "printed_efficiency": 1.0, "mu_turn": 0.2}])
def test_costs_are_those_of_the_slow_twin(form: str, changes: dict[str, float]) -> None:
    rng = np.random.default_rng(4)
    height = rng.normal(0, 0.15, (22, 22)).astype(np.float32)
    friction = rng.choice([1.0, 2.0], (22, 22)).astype(np.float32)
    r = robot(form, **changes)
    costs = costs_on(height, friction=friction, robot=r, slope=85.0)
    for s in rng.choice(np.flatnonzero((costs.cost < BLOCKED).all(1)), 60, replace=False).tolist():
        (y, x), h = divmod(s // 16, 22), s % 16
        for k in range(costs.cluster.size):
            expected = joules(r, costs.cluster, height, friction, x, y, h, k)
            parts = costs.parts(s, k)
            for component in PARTS:
                assert abs(parts[component] - 1000 * expected[component.name.lower()]) <= 1.001
            assert costs.cost[s, k] == max(int(parts.sum()), 1)
            assert (form == "climb" or not changes) or parts[Component.RECOVERED] <= 0


def test_a_flat_metre_costs_alpha_in_both_forms() -> None:
    for form in ("climb", "power"):
        costs = costs_on(np.zeros((16, 16)), form)
        s = (5 * 16 + 2) * 16
        rolling, copper = costs.robot.flat_j_per_m
        assert costs.cost[s, 0] == pytest.approx(1000 * 0.4 * (rolling + copper), abs=4)


def test_climbing_costs_its_potential_energy_once() -> None:
    _, x = np.mgrid[:20, :20]
    for form, down in (("climb", True), ("power", False)):
        up = costs_on(0.1 * x * CELL, form)
        flat, s = costs_on(np.zeros((20, 20)), form), (8 * 20 + 5) * 16
        work = 60 * 9.81 * 0.1 * 0.4 / 0.8 * 1000
        more = up.cost[s, 0] - flat.cost[s, 0]  # the current of the form `power` also heats the motors more
        assert more == pytest.approx(work, rel=0.01) if form == "climb" else work < more < 1.3 * work
        back = up.cost[s + 8, 0]  # the same way downhill
        assert bool(back >= flat.cost[s, 0]) is down
        assert back >= 0


def test_the_printed_cost_pays_for_going_down() -> None:
    """(14) with its where-list refunds on the way down what it took on the way up: hills cost nothing."""
    x = np.arange(24)
    hill = np.tile(0.6 * np.exp(-((x - 12.0) ** 2) / 18), (24, 1))
    s = [(12 * 24 + cell) * 16 for cell in range(4, 20, 2)]
    sums = {form: [int(costs_on(h, form).cost[s, 0].sum()) for h in (hill, hill * 0)] for form in ("climb", "printed")}
    (over, flat), (printed, printed_flat) = sums["climb"], sums["printed"]
    assert over > 1.5 * flat
    assert printed < 1.1 * printed_flat


def test_wheel_torques_balance_weight_drag_and_inertia() -> None:
    r = robot("power")
    left, right = torques(r, 0.5, 0.0, slope=0.2)
    force = (left + right) / r.wheel_m
    assert force == pytest.approx(r.weight_n * (math.sin(0.2) + r.mu * math.cos(0.2)))
    left, right = torques(r, 0.5, 0.3)
    moment = (right - left) / r.wheel_m * r.width_m / 2
    assert moment == pytest.approx(r.scrub_nm(0.6))
    pushed = np.array(torques(r, 0.5, 0.0, dv=1.0)) - np.array(torques(r, 0.5, 0.0))
    assert pushed.sum() / r.wheel_m == pytest.approx(r.mass_kg)
    assert power_w(r, 0.5, 0.0) > 0
    assert power_w(r, 0.5, 0.0, -0.3) == 0.0
    assert power_w(robot("power", recovery=0.5), 0.5, 0.0, -0.3) < 0
    assert power_w(r, 0.5, 0.3) == pytest.approx(power_w(r, 0.5, -0.3))


def test_power_of_a_straight_climb_is_that_of_the_wheels() -> None:
    _, x = np.mgrid[:16, :16]
    slope = math.atan(0.2)
    costs = costs_on(0.2 * x * CELL, "power")
    s, seconds = (6 * 16 + 4) * 16, float(costs.cluster.seconds[0, 0])
    watts = power_w(costs.robot, 0.4 / seconds / math.cos(slope), 0.0, slope)
    assert costs.cost[s, 0] == pytest.approx(1000 * watts * seconds, rel=1e-4)


def test_bad_robots_are_refused() -> None:
    with pytest.raises(BadInput, match=r"efficiency is 1\.2"):
        robot(efficiency=1.2)
    with pytest.raises(BadInput, match="'climb' or 'power' or 'printed'"):
        robot("both")


def test_what_is_seen_changes_only_the_costs_nearby() -> None:
    """Costs after `see` are those of a new table over the same ground; states that it doesn't name have not changed."""
    rng = np.random.default_rng(8)
    height = rng.normal(0, 0.05, (30, 30)).astype(np.float32)
    costs = costs_on(height, body=0.3)
    before = costs.cost.copy()
    cells = np.array([(12, 14), (13, 14), (20, 7)], np.int32)
    seen = height.copy()
    seen[cells[:, 1], cells[:, 0]] += 0.2
    obstacle = np.zeros((30, 30), np.bool_)
    obstacle[7, 20] = True
    changed = costs.see(cells, seen[cells[:, 1], cells[:, 0]], np.array([0, 0, 1], np.uint8), np.ones(3, np.float32))
    assert (costs.cost == costs_on(seen, obstacle=obstacle, body=0.3).cost).all()
    assert set(changed.tolist()) == set(np.flatnonzero((costs.cost != before).any(1)).tolist())


# ---------------------------------------------------------------- scenarios


def test_a_scenario_of_terrain_is_itself_again_as_toml() -> None:
    scenario = parse(SMALL)
    assert parse(scenario.to_toml()) == scenario
    assert scenario.terrain_plan().terrain.shape == (50, 60)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[floor.terrain]\nwidth_m = 12.0\nlength_m = 10.0\nhills = 4\n", "", "needs a table"),
        ("hills = 4", 'generator = "bmps"', "did you mean 'bumps'"),
        ("count = 1", "count = 2", "one robot"),
        ("start = [[8, 8]]", 'start = "parking"', "in a cell"),
        ("goals = [[50, 40]]", "goals = [[70, 40]]", "outside"),
        ("cell_m = 0.2", "cell_m = 2.0", "smaller cells"),
        ('kind = "terrain"', 'kind = "drawing"\nrows = "..."', "only a floor of kind 'terrain'"),
        ("hills = 4", 'heights = "junk"', "damaged"),
        ("hills = 4", "sensor_m = 0.5", r"expected at least 1\.8 m"),
    ],
)
def test_what_is_wrong_with_a_scenario_is_said(old: str, new: str, words: str) -> None:
    assert old in SMALL
    with pytest.raises(BadInput, match=words):
        parse(SMALL.replace(old, new), "s.toml")


def test_a_map_of_heights_becomes_part_of_the_scenario(tmp_path) -> None:
    heights = np.random.default_rng(2).random((50, 60))
    np.save(tmp_path / "ground.npy", heights)
    text = SMALL.replace('kind = "terrain"', 'kind = "terrain"\nmap = "ground.npy"')
    scenario = parse(text, "s.toml", folder=tmp_path)
    assert scenario.terrain_plan().terrain.height_m == pytest.approx(heights, abs=1e-3)
    assert parse(scenario.to_toml()) == scenario
    with pytest.raises(BadInput, match="in the folder of the scenario"):
        parse(text.replace("ground.npy", "../ground.npy"), "s.toml", folder=tmp_path)
    with pytest.raises(BadInput, match="no such file"):
        parse(text.replace("ground.npy", "gone.npy"), "s.toml", folder=tmp_path)
