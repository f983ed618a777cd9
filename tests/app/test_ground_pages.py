"""What the dashboard sends and says of a run on terrain: routes, panels, tables, figures, the library's preview."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dash_mantine_components as dmc
import numpy as np
import pytest

from app import figures, runner
from app.components import panels, tables
from app.figures.base import MS, on_axis
from app.library import Library, Upload
from app.pages import data, stage
from app.runs import RunManager
from app.theme import DARK, LIGHT
from engine.results.ground import ground_of
from engine.results.runs import Catalogue
from tests.engine.test_roaming import PARTLY

NONE = float("nan")
PASSES: dict[str, Any] = {
    "t_s": np.array([0.5, 1.6, 4.0, 9.0, 12.0]),
    "bound": np.array([2.5, 1.5, 1.0, 1.0, NONE]),
    "cost": np.array([9000.0, 8000.0, 7000.0, 6500.0, NONE]),
    "expanded": np.array([100, 50, 400, 20, 9]),
    "open": np.array([70, 60, 50, 55, 0]),
    "incons": np.array([7, 3, 0, 0, 0]),
    "anew": np.array([True, False, False, False, False]),
    "repaired": np.array([False, False, False, True, False]),
}


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunManager]:
    """Of one finished run on small terrain."""
    from app.settings import Settings

    root = tmp_path_factory.mktemp("ground")
    file = root / "small.toml"
    file.write_text(PARTLY, encoding="utf-8")
    folder = runner.prepare(Catalogue(root / "runs"), runner.asked_scenario(str(file), {}))
    run = runner.Run.new(folder, rerun=False)
    run.advance(10_000)
    run.close()
    made = RunManager(Settings(data=root, scenario=None, open_browser=False))
    yield made
    made.close()


@pytest.fixture
def run_id(manager: RunManager) -> str:
    return next(str(run["run_id"]) for run in manager.list() if not run.get("demo"))


def texts(component: Any) -> str:
    """Everything that a Dash component says."""
    return json.dumps(component.to_plotly_json(), default=lambda part: part.to_plotly_json(), ensure_ascii=False)


@pytest.mark.parametrize("at_s", [None, 0.0, 6.0])
@pytest.mark.parametrize("tab", [name for name, _ in stage.TABS])
def test_every_tab_and_panel_of_a_run_on_terrain_is_filled(
    manager: RunManager, run_id: str, tab: str, at_s: float | None
) -> None:
    for selection in (None, {"kind": "vehicle", "id": 0}, {"kind": "place", "id": 700, "place": 700}):
        asked = data.Asked(run_id, at_s, tab, selection=selection, parts=frozenset({"marks"}))
        told = data.look(manager, asked)
        assert told.ground
        filled = stage.tab_outputs(told, asked, LIGHT, True)
        assert not {"soc", "occupancy", "throughput"} & filled.keys()
        said = texts(stage.side_panel(told, asked, True))
        for word in ("orders/h", "Charge now", "Load"):
            assert word not in said
        if selection is None:
            assert "Power now" in said
        elif selection["kind"] == "place":
            assert "Slope" in said
            assert "1.6 m wide" in said
            assert '\\"radius_m\\": 0.8' in said


def test_tabs_that_make_no_sense_are_not_offered() -> None:
    def offered(ground: bool) -> set[str]:
        return {part.value for part in stage._tabs({}, ground)._traverse() if isinstance(part, dmc.TabsTab)}

    assert offered(True) == stage.OF_GROUND
    assert offered(False) == stage.OF_FLEET


def test_the_bound_is_a_sentence() -> None:
    def words(bound: float | None) -> str:
        return panels.bound_words({"bound": bound})[0]

    assert [words(b) for b in (2.5, 1.5, 1.0, None)] == [
        "Within ≤ 2.5 × of the least", "Within ≤ 1.5 × of the least", "Optimal", "No way is known",
    ]  # fmt: skip
    assert panels.bound_words(None)[0] == "Searching for a first way"


def test_a_cell_says_what_the_robot_does_not_know() -> None:
    cell = {"height_m": 1.234, "prior_m": 0.8, "slope_deg": 31.2, "slope_limit_deg": 30.0, "friction": 1.8,
            "obstacle": True, "believed": False, "known": False, "seen": False}  # fmt: skip
    said = dict(panels.ground_rows(cell))
    assert said["Height"] == "1.23 m; the robot reckons with 0.80 m"
    assert said["Slope"].startswith("31°, steeper than the 30°")
    assert said["Obstacle"] == "yes, which the robot has not seen yet"
    assert (said["Friction"], said["Robot's view"]) == ("× 1.80", "not seen yet")


def test_ways_are_told_newest_first() -> None:
    rows = tables.way_rows(PASSES, "energy")
    assert [row["why"] for row in rows] == ["bettered", "repaired", "bettered", "bettered", "anew"]
    assert [row["bound"] for row in rows][::2] == ["no way is known", "optimal", "≤ 2.5 × of the least"]
    assert [row["total"] for row in rows][:2] == [579, 570]
    assert [row["cost"] for row in tables.way_rows(PASSES, "distance")][1] == "6500.00 m"


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_epsilon_cost_and_power_over_time(scheme: str) -> None:
    figure = figures.anytime_figure(PASSES, 0.0, 20.0, "energy", scheme)
    cost, bound, repaired = figure.data
    assert bound.y.tolist()[:4] == [2.5, 1.5, 1.0, 1.0]
    assert cost.y[0] == pytest.approx(9.0)  # kJ
    assert repaired.x.tolist() == pytest.approx([9.0 * MS], abs=0.5)
    assert bound.x[-1] == pytest.approx(20.0 * MS)
    assert not figures.anytime_figure({**PASSES, "t_s": np.zeros(0)}, 0.0, 1.0, "energy", scheme).data
    t_s = np.arange(1.0, 5.0)
    drawn = {"rolling": t_s * 10, "recovered": -t_s}
    power = figures.power_figure({"t_s": t_s, "watts": drawn}, scheme)
    assert [trace.stackgroup for trace in power.data] == ["drawn", "recovered"]
    assert not figures.power_figure({"t_s": np.zeros(0), "watts": {}}, scheme).data


def test_no_moment_is_read_as_a_year() -> None:
    """A date axis reads a number of two or four digits as a year."""
    ms = on_axis([0.0, 0.02, 0.5, 1.0, 1.6, 9.999, 10.0, 3600.0])
    assert ms == pytest.approx(np.array([0, 20, 500, 1000, 1600, 9999, 10_000, 3_600_000]), abs=0.3)
    assert not any(f"{value:g}" in ("20", "1000", "1600", "9999") for value in ms.tolist())


def test_runs_without_orders_say_so_when_compared() -> None:
    t_s = np.arange(10.0)
    flat = {"A": t_s * 0, "B": t_s * 0}
    assert not figures.comparing_figure("orders_done", t_s, flat, nothing="No order is done in these runs").data
    assert figures.comparing_figure("orders_done", t_s, flat).data


def test_the_ground_of_a_run_is_told_at_any_time(manager: RunManager, run_id: str) -> None:
    def told(time: float) -> Any:
        return manager.read(run_id, lambda view: ground_of(view).told(time, frontier=True))  # type: ignore[union-attr]

    early, late = told(30), told(1e9)
    assert early["search"]["bound"] >= late["search"]["bound"] == 1
    assert early["search"]["total"] < late["search"]["total"]
    assert early["track"] == late["track"]  # the browser cuts it at the moment shown
    assert set(late["frontier"]) == {"open", "incons"}


def test_a_run_on_a_floor_has_no_ground(client: Any, recorded: Path) -> None:
    run = next((recorded / "runs").iterdir()).name
    answer = client.get(f"/api/runs/{run}/ground")
    assert answer.status_code == 400
    assert "terrain" in answer.json()["error"]


def test_terrain_is_previewed_with_its_heights(tmp_path: Path) -> None:
    library = Library(tmp_path / "scenarios")
    name = library.add([Upload("small.toml", PARTLY)])
    thumb, floor = library.thumb(name), library.floor(name)
    heights = np.frombuffer(base64.b64decode(thumb["heights"]["data"]), "<u2")
    assert len(heights) == thumb["width"] * thumb["height"] == sum(map(len, thumb["cells"]))
    assert floor["kind"] == "terrain"
    assert floor["trips"] == [[1.7, 1.7, 10.1, 8.1]]
    assert not library.entry(name).instance
    seen = library.look([Upload("small.toml", PARTLY)])
    assert seen["floor"]["kind"] == "terrain"
