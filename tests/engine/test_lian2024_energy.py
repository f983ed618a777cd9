"""lian2024's drive and battery in a whole run: every millijoule accounted for, and the share of the motors."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.build import build, demand_model
from engine.energy.lian2024 import motors_share
from engine.errors import BadInput, ScenarioError
from engine.results.runlog import MemoryLog
from engine.scenario import load, parse
from engine.sim.judge import judge
from engine.sim.judge.energy import costs
from engine.types import Component
from engine.world.motion_graph import Primitive
from tests.strategies import LOOP, scenario_text


def text(parameters: str, battery: str = "charge_a = 6.0") -> str:
    return scenario_text(
        LOOP,
        3,
        orders='source = "poisson"\nrate_per_h = 500\nmix = [{ from = "station", to = "station", weight = 1.0 }]',
        fleet="mass_kg = 500.0\npayload_kg = 100.0",
        charger="power_w = 300.0",
        energy=f'demand = "lian2024"\nbeside = "lian2024-paper"\nparameters = {{ {parameters} }}',
        battery='model = "tremblay"\ncapacity_wh = 155.4\nvoltage_v = 25.9\ninitial_soc = [0.3, 0.6]\n'
        f"parameters = {{ {battery} }}",
    )


@pytest.mark.parametrize("recovery", [0.0, 0.9])
def test_a_run_with_motors_and_cells_adds_up(recovery: float) -> None:
    asked, log = parse(text(f"recovery = {recovery}, brake_mps2 = 0.3")), MemoryLog()
    sim = build(asked, recorder=log)
    sim.advance(1500)
    sim.flush()
    assert judge(log, asked, sim.world) == []
    assert sim.metrics()["orders_done"] > 10
    spent = {Component(c): mj / 1000 for c, mj in enumerate(sim.fleet.ledger.sum(axis=0).tolist())}
    assert (spent[Component.RECOVERED] < 0) == (recovery > 0)
    assert spent[Component.COPPER] > spent[Component.ROLLING] > 0
    assert 0.2 < motors_share(spent) < 0.95  # it also stands, at chargers and stations
    assert sim.parts.battery.capacity_mc == 24_000_000


def test_parameters_that_they_do_not_have_are_told_with_the_nearest() -> None:
    with pytest.raises(ScenarioError, match="'gears'; did you mean 'gear'"):
        build(parse(text("gears = 20.0")))
    with pytest.raises(ScenarioError, match=r"'charge_w'; did you mean 'charge_[av]'"):
        build(parse(text("gear = 20.0", "charge_w = 5.0")))
    with pytest.raises(BadInput, match=r"gear_efficiency is 1.4; expected a share"):
        build(parse(text("gear_efficiency = 1.4")))


@given(
    st.sampled_from([(900, 0, True, False), (450, 0, False, False), (0, 90, False, True), (900, 90, True, False)]),
    st.floats(50, 1500),
    st.floats(0.05, 2),
    st.floats(0.05, 2),
    st.floats(0.001, 0.05),
)
def test_the_judge_s_formulae_give_the_same(kind, mass, accel, brake, mu):
    length, turn, starts, pivot = kind
    changes = {"accel_mps2": accel, "brake_mps2": brake, "mu": mu}
    scenario = load("lian2024", {"energy.parameters": changes, "fleet.mass_kg": mass})
    primitive = Primitive("p", length, turn, starts, pivot, 10)

    class Graph:
        primitives = (primitive,)

    mine = demand_model("lian2024", scenario).joules(primitive, mass, 1.0)
    judged = costs(scenario, Graph())
    assert judged is not None
    for component, value in enumerate(judged[0, 0, 0].tolist()):
        assert value == pytest.approx(1000 * mine.get(Component(component), 0.0), abs=0.51)


def test_the_judge_leaves_braking_motors_to_others():
    assert costs(load("lian2024", {"energy.parameters": {"recovery": 0.5}}), build(load("lian2024")).graph) is None


@pytest.mark.parametrize(("model", "capacity_wh"), [("tremblay", 60.0), ("coulomb", 60.0)])
def test_a_run_swaps_batteries_at_entrances_strands_nobody_and_adds_up(model, capacity_wh):
    log = MemoryLog()
    changes = {
        "battery.model": model,
        "battery.capacity_wh": capacity_wh,
        "battery.initial_soc": [0.4, 0.5],
        "log.sample_s": 5.0,
    }
    sim = build(load("lian2024", changes), recorder=log)
    sim.advance(3000)
    sim.flush()
    assert judge(log, sim.scenario, sim.world) == []
    events = log.table("events")
    assert (events["kind"] == "battery changed").sum() > 5
    assert sim.metrics()["stranded"] == 0
    ledger = sim.fleet.ledger.sum(axis=0)
    assert ledger[Component.COPPER] > ledger[Component.ROLLING] > 0
    assert ledger[Component.STANDBY] == 29 * 3000 * 2000
