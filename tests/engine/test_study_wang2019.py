"""The study of wang2019: the paper's numbers, right and wrong, and what its cells find."""

from __future__ import annotations

from itertools import product

import pytest

from engine.dispatch.insertion import insertion
from engine.dispatch.makespan import makespan
from engine.dispatch.schedule import by_rule
from engine.studies import wang2019
from engine.studies.base import Settings, as_plain
from engine.studies.wang2019 import Wang2019, case, distances, every_schedule, literal_s, planned, seconds, solve_cell
from tests import naive_dispatch

ROBOTS, EXITS = list(wang2019.ROBOTS), list(wang2019.EXITS)
PRINTED_BY_ORDER = {k: [wang2019.TABLE_3[name][i] for name in (*ROBOTS, *EXITS)] for i, k in enumerate(wang2019.ORDERS)}


def test_every_printed_distance_is_one_metre_off() -> None:
    true = distances()
    assert true == {"W1": (3, 15, 9, 16), "W2": (13, 3, 13, 14), "B1": (10, 18, 6, 27), "B2": (19, 9, 23, 10)}
    off = [abs(a - b) for name in true for a, b in zip(true[name], wang2019.TABLE_3[name], strict=True)]
    assert off == [1] * 16


@pytest.mark.parametrize("order", PRINTED_BY_ORDER)
def test_one_cell_alone_has_the_printed_distances(order: str) -> None:
    spots = [*wang2019.ROBOTS.values(), *wang2019.EXITS.values()]
    fits = [
        cell
        for cell in product(range(1, 27), range(1, 19))
        if [wang2019.manhattan(cell, spot) for spot in spots] == PRINTED_BY_ORDER[order]
    ]
    assert fits == [wang2019.PICKED_AT[order]]


def test_the_papers_sums_and_the_right_ones() -> None:
    assert [literal_s(robot) for robot in ROBOTS] == [42.2, 48.1]
    assert [seconds(end) for end in planned(case())] == [43.67, 49.67]
    assert [seconds(end) for end in planned(case(distances()))] == [43.67, 48.33]
    assert [end / 6 for end in planned(case())] == pytest.approx([42.2 + 1.5 - 1 / 30, 48.1 + 1.5 + 2 / 30])


def test_of_1920_schedules_none_is_done_sooner() -> None:
    work = case()
    mine = [
        tuple(naive_dispatch.time_of(work, r, *each) for r, each in enumerate(s))
        for s in naive_dispatch.schedules(2, 4, 2)
    ]
    assert sorted(mine) == sorted(every_schedule(work))
    assert len(mine) == 1920
    ends = sorted(max(end) for end in mine)
    assert ends[0] == max(planned(work)) == 298  # sixths of a second: 49 2/3 s
    assert seconds(min(end for end in ends if end > 298)) == 50.33
    assert seconds(min(sum(end) for end in mine)) == 93.33 == seconds(sum(planned(work)))
    for found in (by_rule(work), insertion(work, 100), makespan(work, 100)):
        assert found.makespan == 298
        assert found.routes == ((0, 2), (1, 3))
        assert found.exits == ((0, 0), (1, 1))
    assert makespan(work, 100).bound == 298


def test_table_4_is_table_3_in_seconds_but_for_two_cut_off() -> None:
    off = {}
    for name, times in wang2019.TABLE_4.items():
        service = 7.5 if name in ROBOTS else 6.0
        for i, time in enumerate(times):
            exact = wang2019.TABLE_3[name][i] / 1.5 + service
            if round(exact, 1) != time:
                off[name, i] = (exact, time)
    assert {key: time for key, (_, time) in off.items()} == {("B1", 1): 18.6, ("B1", 3): 24.6}
    assert all(exact - time == pytest.approx(1 / 15) for exact, time in off.values())


def test_the_shown_schedule_ends_when_it_must() -> None:
    bars = wang2019._gantt().data["bars"]
    ends = {bar["row"]: bar["end"] for bar in bars}
    assert ends["W1"] == pytest.approx(43.667, abs=0.01)
    assert ends["W2"] == pytest.approx(49.667, abs=0.01)
    assert ends["W1, as printed"] == pytest.approx(42.167, abs=0.01)
    assert ends["W2, as printed"] == pytest.approx(48.167, abs=0.01)


@pytest.fixture(scope="module")
def result() -> wang2019.Result:
    with pytest.MonkeyPatch.context() as small:
        small.setattr(wang2019, "LARGE", (24,))
        small.setattr(wang2019, "EXACT", ((2, 4),))
        small.setattr(wang2019, "MANY", ((4, 20),))
        return Wang2019().run(Settings(maps=6), lambda done, total, what: None)


def test_the_table_says_where_the_20_percent_come_from(result: wang2019.Result) -> None:
    rows = {(row.quantity, row.case): row for row in result.rows}
    assert rows["length saved by the octile distance over Manhattan", "4 neighbours both"].ours == 0
    for mode in ("8 neighbours", "8, corners cut"):
        assert rows["length saved by diagonals, octile both", mode].ours > 12
    for word in ("Euclidean", "Chebyshev", "octile"):
        lengths = {rows[f"length, {mode}", word].ours for mode in ("8 neighbours",)}
        assert lengths == {rows["length, 8 neighbours", "octile"].ours}
    assert rows["W2 is done, by the paper's arithmetic", "table 4"].verdict == "inside"
    assert rows["W2 is done", "table 3"].ours == 49.67
    assert rows["makespan found", "exact program"].note == "proven least"
    assert rows["length of W1's route", "octile distance of the printed coordinates"].ours == pytest.approx(20.9)
    assert rows["length of W2's route", "8, corners cut"].ours == pytest.approx(25.31)
    # all 16 distances inside with the cells of table 3, none with the printed coordinates
    by = {q: [r.verdict for r in result.rows if r.experiment == 2 and r.quantity.startswith(q)] for q in ("M", "d")}
    assert by == {"M": ["outside"] * 16, "d": ["inside"] * 16}
    assert result.breaches == 0
    assert result.plans > 30


def test_a_result_is_plain_values_and_the_same_again(result: wang2019.Result) -> None:
    plain = as_plain(result)
    assert {figure["kind"] for figure in plain["figures"]} == {"gantt", "histogram", "floor", "table", "bars"}
    cells = [cell for cell in Wang2019().cells(Settings(maps=2)) if cell["kind"] == "grid" and cell["size"] == 10]
    for cell in cells:
        one, two = solve_cell(cell), solve_cell(cell)
        one.pop("us"), two.pop("us")
        assert one == two
