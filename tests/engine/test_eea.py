"""EEA*: exact energies against plain Dijkstra, and the paper's own form with its mistake."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import ScenarioError
from engine.planners.eea import HEURISTICS, RULES, VARIANTS, Eea
from engine.planners.single import Floor
from engine.scenario.floor_costs import xu2025_costs
from engine.scenario.movingai import Instance, single_instance
from engine.types import PlanStatus
from tests import naive_mapf2 as naive
from tests.engine.test_astar import questions

Question = tuple[np.ndarray, naive.Cell, naive.Cell]

# start (0, 0), goal (2, 2), obstacles (1, 2) and (2, 0)
TRAP = np.array([[1, 1, 0], [1, 1, 1], [1, 0, 1]], np.bool_)


def floor_of(free: np.ndarray, energy: naive.Energy | None = None) -> Floor:
    e = energy or naive.Energy()
    graph = Instance("x", free, (), ()).graph()
    numbers = {"mu": e.mu, "v_mps": e.v, "omega": e.omega, "standby_w": e.standby}
    return Floor(graph, xu2025_costs(graph, (e.mass,), numbers))


def route(floor: Floor, states: np.ndarray) -> list[tuple[int, int]]:
    return [(int(x), int(y)) for x, y in floor.graph.xy_m[states >> floor.net.shift] - 0.5]


@pytest.mark.parametrize("heuristic", HEURISTICS)
@pytest.mark.parametrize("tie", ["fifo", "lifo"])
def test_the_exact_search_finds_the_cheaper_way(heuristic: str, tie: str) -> None:
    floor = floor_of(TRAP)
    way = Eea(heuristic=heuristic, tie=tie).search(floor, 0, 6)
    assert route(floor, way.states) == [(0, 0), (0, 1), (1, 1), (2, 1), (2, 2)]
    assert way.cost / 1000 == pytest.approx(1432.93, abs=0.005)
    assert floor.energy(way.states) == way.cost


@pytest.mark.parametrize("variant", ["literal-cell", "literal-cell-time"])
@pytest.mark.parametrize("heuristic", ["paper", "closed"])
def test_keyed_on_the_cell_the_paper_pays_more(variant: str, heuristic: str) -> None:
    floor = floor_of(TRAP)
    way = Eea(variant, heuristic, "fifo").search(floor, 0, 6)
    assert route(floor, way.states) == [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2)]
    assert way.cost / 1000 == pytest.approx(1643.20, abs=0.005)
    assert floor.energy(way.states) == way.cost


PARAMETERS = st.builds(
    naive.Energy,
    mass=st.sampled_from([400.0, 1000.0, 2350.0]),
    v=st.sampled_from([0.3, 1.0]),
    omega=st.sampled_from([0.2, 1.5707963267948966, 4.0]),
    standby=st.sampled_from([1.0, 30.0]),
    reversal=st.sampled_from(RULES),
    restart=st.sampled_from(RULES),
)


@pytest.mark.nojit_slice
@settings(max_examples=80)
@given(questions(), PARAMETERS, st.sampled_from(["table", "closed"]), st.sampled_from(["fifo", "lifo"]), st.booleans())
def test_exact_is_exact(question: Question, energy: naive.Energy, heuristic: str, tie: str, free_heading: bool) -> None:
    free, start, goal = question
    floor, instance = floor_of(free, energy), Instance("x", free, (), ())
    a, b = instance.place(start), instance.place(goal)
    eea = Eea("exact", heuristic, tie, energy.reversal, energy.restart)
    way = eea.search(floor, a, b, heading=None if free_heading else 1)
    best = naive.least_energy(free, [(start, h, False) for h in (range(4) if free_heading else [1])], goal, energy)
    if best is None:
        assert way.status is PlanStatus.NO_PATH
        return
    assert way.cost == best
    slow = Eea("exact", heuristic, tie, energy.reversal, energy.restart, increments=False)
    again = slow.search(floor, a, b, heading=None if free_heading else 1)
    assert (again.cost, again.expanded) == (way.cost, way.expanded)


@given(questions(), st.sampled_from(VARIANTS), st.sampled_from(HEURISTICS))
def test_no_variant_beats_the_exact_one(question: Question, variant: str, heuristic: str) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    a, b = instance.place(start), instance.place(goal)
    exact, way = Eea().search(floor, a, b), Eea(variant, heuristic, "fifo").search(floor, a, b)
    assert way.status == exact.status or variant == "literal-cell-time"
    if way.status is PlanStatus.SOLVED:
        assert way.cost >= exact.cost
        assert floor.energy(way.states) == way.cost


@given(questions(), st.sampled_from(VARIANTS), st.sampled_from(HEURISTICS), st.sampled_from(["fifo", "lifo"]))
def test_a_trace_tells_the_search_and_does_not_change_it(
    question: Question, variant: str, heuristic: str, tie: str
) -> None:
    free, start, goal = question
    floor, instance = floor_of(free), Instance("x", free, (), ())
    a, b = instance.place(start), instance.place(goal)
    eea = Eea(variant, heuristic, tie)
    limit = 5000
    with_trace, without = eea.search(floor, a, b, trace=True, limit=limit), eea.search(floor, a, b, limit=limit)
    assert with_trace.states.tolist() == without.states.tolist()
    assert without.trace == {}
    t = with_trace.trace
    if t:
        assert (t["f"] == t["g"] + t["h"]).all()
        assert t["parent"][0] == -1
        assert set(t["parent"].tolist()) - {-1} <= set(t["node"].tolist()) or variant != "exact"


def test_the_table_expands_less_at_equal_cost() -> None:
    for seed in range(5):
        instance = single_instance(np.random.default_rng(seed), 40, 0.2)
        floor = floor_of(instance.free)
        a, b = instance.place(instance.starts[0]), instance.place(instance.goals[0])
        ways = {h: Eea(heuristic=h).search(floor, a, b) for h in HEURISTICS}
        assert len({way.cost for way in ways.values()}) == 1
        assert len(ways["table"].states) - 1 == ways["table"].expanded
        assert ways["table"].expanded * 4 < ways["closed"].expanded <= ways["paper"].expanded


def test_a_full_room_is_made_larger() -> None:
    from engine.planners.kernels import single

    floor = floor_of(np.ones((8, 8), np.bool_))
    floor.state_work = single.new_state_work(floor.graph.n_states, 40, 128)
    assert (
        Eea(heuristic="closed").search(floor, 0, 63).cost
        == Eea().search(floor_of(np.ones((8, 8), np.bool_)), 0, 63).cost
    )


def test_a_room_is_used_again_and_again() -> None:
    floor = floor_of(np.ones((4, 4), np.bool_))
    first = Eea().search(floor, 0, 15).cost
    assert floor.state_work is not None
    floor.state_work.base[0] = (1 << 43) + 5  # nearly used up: the next searches begin anew
    for _ in range(3):
        assert Eea().search(floor, 0, 15).cost == first


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ScenarioError, match="did you mean 'literal-cell'"):
        Eea("literal-cel")
