"""Figures: from plain data, with the theme, a zoom that survives updates, and little to send."""

import json

import numpy as np
import plotly.graph_objects as go
import pytest

from app import figures
from app.figures.base import MS
from app.figures.energy import unit_of
from app.figures.reservations import BARS_UP_TO, PLACES_UP_TO, ribbon_rows
from app.theme import DARK, GRAPH_CONFIG, INK, LIGHT, SERIES, STATE_WORDS, STATES

T = np.arange(0.0, 3600.0, 12.0)
LEVELS = {"critical": 0.15, "good": 0.3, "sufficient": 0.8, "full": 1.0}


def soc_data(vehicles: int) -> dict:
    rows = 0.9 - np.arange(vehicles)[:, None] * 0.001 - T[None, :] / 10_000
    return {"t_s": T, "soc": rows, "vehicles": list(range(vehicles))}


def bands_data(vehicles: int, step: float = 60.0) -> list[tuple[int, float, float, int]]:
    return [(v, t, t + step, int(v + t // step) % 8) for v in range(vehicles) for t in np.arange(0.0, 3600.0, step)]


def reservations_data(n: int, places: int = 100) -> dict:
    k = np.arange(n)
    return {"place": k % places, "t0": k, "t1": k + 3, "vehicle": k % 7}


def shares() -> dict:
    parts = np.array([0.5, 0.2, 0.1, 0.1, 0.1])
    names = ("moving", "waiting", "loading", "charging", "idle")
    return {"t_s": T, **{n: np.full(len(T), p) for n, p in zip(names, parts, strict=True)}, "fault": np.zeros(len(T))}


def all_figures(scheme: str) -> dict[str, go.Figure]:
    components = {"rolling": T * 100, "turning": T * 20, "charged": -T * 90, "climbing": T * 0}
    return {
        "soc": figures.soc_figure(soc_data(8), LEVELS, 3, scheme),
        "occupancy": figures.occupancy_figure(shares(), scheme),
        "throughput": figures.throughput_figure({"t_s": T, "per_h": T * 0 + 60, "open": T * 0 + 4}, scheme),
        "energy": figures.energy_figure({"t_s": T, "components": components}, scheme),
        "comparing": figures.comparing_figure("comparing", T, {"A": T, "B": 2 * T}, parting_s=60.0, scheme=scheme),
        "bands": figures.bands_figure(bands_data(8), 0, 3600, 1800, 3, scheme),
        "reservations": figures.reservations_figure(reservations_data(400), 0, 600, 1.0, 300, None, None, scheme),
    }


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_every_figure_has_the_theme_and_keeps_a_persons_zoom(scheme: str) -> None:
    first, second = all_figures(scheme), all_figures(scheme)
    for name, figure in first.items():
        assert figure.layout.uirevision == name == second[name].layout.uirevision
        assert figure.layout.template.layout.paper_bgcolor == "rgba(0,0,0,0)"
        assert figure.layout.template.layout.font.color == INK[scheme]["muted"]
        assert json.loads(figure.to_json())["data"], name
        assert figure.layout.xaxis.type == "date"


def test_every_figure_says_why_it_is_empty() -> None:
    nothing = np.zeros(0)
    empty = [
        figures.soc_figure({"t_s": nothing, "soc": np.zeros((0, 0)), "vehicles": []}),
        figures.occupancy_figure({"t_s": nothing}),
        figures.throughput_figure({"t_s": nothing, "per_h": nothing, "open": nothing}),
        figures.energy_figure({"t_s": T, "components": {"rolling": T * 0}}),
        figures.bands_figure([], 0, 10),
        figures.bands_figure([(0, 100.0, 200.0, 1)], 0, 10),
        figures.reservations_figure(reservations_data(0), 0, 10),
    ]
    for figure in empty:
        assert not figure.data
        assert len(figure.layout.annotations[0].text) > 10


def test_no_graph_offers_to_upload() -> None:
    assert GRAPH_CONFIG["displaylogo"] is False
    assert "sendChartToCloud" in GRAPH_CONFIG["modeBarButtonsToRemove"]


def test_charge_of_a_small_fleet_is_a_line_each_with_the_chosen_one_on_top() -> None:
    figure = figures.soc_figure(soc_data(20), LEVELS, selected=5)
    assert [trace.name for trace in figure.data][-1] == "vehicle 5"
    assert len(figure.data) == 20
    assert figure.data[-1].y[0] == pytest.approx(89.5)
    assert figure.data[-1].x[-1] == pytest.approx(T[-1] * MS)
    assert {line.y0 for line in figure.layout.shapes} == {15.0, 30.0, 80.0}


def test_charge_of_a_large_fleet_is_its_spread() -> None:
    data = soc_data(60)
    data["soc"][:, 0] = np.nan
    figure = figures.soc_figure(data, LEVELS, selected=59)
    names = [trace.name for trace in figure.data]
    assert names == ["5th percentile", "5th to 95th percentile", "median", "least", "vehicle 59"]
    assert np.nanmax(np.abs(figure.data[3].y - figure.data[4].y)) < 1e-9, "vehicle 59 has the least charge"
    assert len(figures.soc_figure(data, LEVELS, selected=None).data) == 4


def test_occupancy_adds_up_and_leaves_out_what_never_happened() -> None:
    figure = figures.occupancy_figure(shares())
    assert "fault" not in [trace.name for trace in figure.data]
    assert np.sum([trace.y for trace in figure.data], axis=0) == pytest.approx(np.full(len(T), 100.0))
    assert {trace.stackgroup for trace in figure.data} == {"fleet"}


def test_energy_is_stacked_in_a_unit_that_reads_well() -> None:
    assert [unit_of(x)[1] for x in (12.0, 12e3, 12e6)] == ["J", "kJ", "MJ"]
    parts = {"rolling": np.full(3, 2e6), "standby": np.full(3, 1e6), "charged": np.array([0, -1e6, -2e6])}
    figure = figures.energy_figure({"t_s": np.arange(3.0), "components": parts})
    by_name = {trace.name: trace for trace in figure.data}
    assert by_name["rolling"].y[0] == 2.0
    assert by_name["rolling"].stackgroup == by_name["standby"].stackgroup == "drawn"
    assert by_name["charged"].stackgroup is None
    assert list(by_name["charged"].y) == [0, 1, 2]


def test_few_bands_are_bars_with_exact_ends() -> None:
    figure = figures.bands_figure([(0, 0.0, 30.0, 1), (0, 30.0, 90.0, 2), (1, 0.0, 90.0, 1)], 10.0, 60.0, 50.0)
    bars = {trace.name: trace for trace in figure.data}
    assert set(bars) == {"moving", "waiting"}
    assert list(bars["moving"].base) == [10 * MS, 10 * MS]
    assert list(bars["moving"].x) == [20 * MS, 50 * MS]
    assert list(bars["waiting"].x) == [30 * MS]
    assert bars["moving"].marker.color == STATES[LIGHT][STATE_WORDS.index("moving")]
    assert figure.layout.shapes[-1].x0 == 50 * MS


def test_many_bands_become_a_raster_of_the_same_states() -> None:
    bands = bands_data(60, 30.0)
    figure = figures.bands_figure(bands, 0, 3600)
    (raster,) = (trace for trace in figure.data if trace.type == "heatmap")
    assert raster.z.shape == (60, 900)
    for vehicle, begin, end, state in bands[::97]:
        column = int((begin + end) / 2 / 3600 * 900)
        assert raster.z[vehicle, column] == state
    assert len(figure.to_json()) < 2_500_000


def test_ribbon_shows_the_busiest_places_or_those_of_the_chosen_vehicle() -> None:
    data = reservations_data(5000)
    rows, places = ribbon_rows(data, 0, 5000, None)
    assert len(places) == PLACES_UP_TO
    assert len(rows["place"]) <= BARS_UP_TO
    rows, places = ribbon_rows(data, 100, 160, 3)
    own = [p for p, v, t0, t1 in zip(data["place"], data["vehicle"], data["t0"], data["t1"], strict=True)
           if v == 3 and t1 > 100 and t0 < 160]  # fmt: skip
    assert places.tolist() == list(dict.fromkeys(own))
    assert rows["t0"].min() >= 100
    assert rows["t1"].max() <= 160


def test_ribbon_is_in_seconds_and_names_its_places() -> None:
    data = {"place": [4, 9], "t0": [10, 20], "t1": [12, 26], "vehicle": [0, 1]}
    figure = figures.reservations_figure(data, 0, 100, tick_s=0.5, now_s=8.0, names={4: "R7", 9: "(3, 2)"})
    bars = figure.data[0]
    assert list(bars.base) == pytest.approx([5 * MS, 10 * MS], abs=0.5)
    assert list(bars.x) == [1 * MS, 3 * MS]
    assert list(bars.marker.color) == [SERIES[0], SERIES[1]]
    assert list(figure.layout.yaxis.ticktext) == ["R7", "(3, 2)"]
    assert figure.layout.shapes[0].x0 == pytest.approx(8 * MS, abs=0.5)


def test_colours_of_the_canvas_and_of_the_charts_are_the_same() -> None:
    import assets

    css = assets.path("web", "style.css").read_text()
    light, dark = css.split('[data-mantine-color-scheme="dark"] {', 1)
    for scheme, text in ((LIGHT, light), (DARK, dark)):
        for word, colour in zip(STATE_WORDS, STATES[scheme], strict=True):
            assert f"--wl-state-{word.replace(' ', '-')}: {colour};" in text, (scheme, word)
