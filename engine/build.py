"""The one place that knows every registry: from a scenario to a simulation.

Registries hold lazy strings, so that naming what exists imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from engine.energy import battery, parameter_sets
from engine.errors import ScenarioError, unknown_name
from engine.scenario import Scenario, goal_places, load, parse, start_places
from engine.types import Occupancy
from engine.units import MJ_PER_J
from engine.world import World, build_world

PLANNERS: dict[str, str] = {
    "prioritized": "engine.planners.prioritized:Prioritized",
    "quickest": "engine.planners.quickest:Quickest",
    "stochastic": "engine.planners.stochastic:Stochastic",
    "astar-distance": "engine.planners.astar_distance:AStarDistance",
    "astar-turns": "engine.planners.astar_turns:AStarTurns",
    "astar": "engine.planners.routes:AStarRoutes",
    "eea": "engine.planners.routes:EeaRoutes",
    "aco": "engine.planners.aco:Aco",
    "soochow-table": "engine.planners.soochow_table:SoochowTable",
}
"""Lifelong planners and routers: one vehicle's request at a time."""
SOLVERS: dict[str, str] = {
    "cbs": "engine.planners.cbs:CBS",
    "ecbs": "engine.planners.ecbs:ECBS",
    "prioritized": "engine.planners.one_shot_prioritized:OneShotPrioritized",
    "time-window": "engine.planners.time_window:TimeWindow",
}
"""One-shot solvers: all vehicles at once, where every vehicle has a goal."""
SEARCHES: dict[str, str] = {
    "astar": "engine.planners.astar:AStar",
    "eea": "engine.planners.eea:Eea",
}
DISPATCHERS: dict[str, str] = {
    "nearest": "engine.dispatch.nearest:Nearest",
    "nearest-sequence": "engine.dispatch.nearest_sequence:NearestSequence",
    "hungarian": "engine.dispatch.hungarian:Hungarian",
    "insertion": "engine.dispatch.insertion:Insertion",
    "makespan": "engine.dispatch.makespan:Makespan",
    "in-turn": "engine.dispatch.in_turn:InTurn",
}
CHARGING: dict[str, str] = {
    "levels": "engine.dispatch.levels:Levels",
}
DEMAND: dict[str, str] = {
    "xu2025": "engine.energy.xu2025:Xu2025",
    "constant": "engine.energy.constant:Constant",
    "lian2024": "engine.energy.lian2024:lian2024",
    "lian2024-paper": "engine.energy.lian2024:lian2024_paper",
}
DRIVES: dict[str, str] = {"skid-steer": "climb", "skid-steer-power": "power"}
"""Demand models of robots on terrain: name → form of the cost."""
ROAMING: dict[str, str] = {
    "adstar": "engine.planners.adstar:AdStar",
}
"""Planners of a robot on terrain, which plan while it drives."""
BATTERIES: dict[str, str] = battery.BATTERIES


def find(registry: Mapping[str, str], what: str, name: str) -> Any:
    """The object that a registry names. Raises ScenarioError with the nearest name."""
    if name not in registry:
        raise ScenarioError(unknown_name(what, name, registry))
    module, _, attribute = registry[name].partition(":")
    return getattr(import_module(module), attribute)


def demand_model(name: str, scenario: Scenario) -> Any:
    """A demand model with the scenario's parameters. Raises ScenarioError."""
    from engine.energy import parameters_over

    if name in DRIVES:
        raise ScenarioError(f"energy.demand: {name!r} is a robot on terrain, and has no costs on a flat floor")
    cls = find(DEMAND, "demand model", name)
    given = scenario.energy.parameters if name == scenario.energy.demand else {}
    if name == "constant":
        numbers = parameters_over(parameter_sets.constant(), given, name)
        return cls(running_w=scenario.battery.capacity_wh * 3600 * numbers["percent_per_s"] / 100)
    numbers_of = parameter_sets.lian2024 if name.startswith("lian2024") else parameter_sets.xu2025
    return cls(**parameters_over(numbers_of(scenario.motion.speed_mps), given, name))


def costs_of(scenario: Scenario, world: World, demand: str | None = None) -> Any:
    """The integer cost table of a scenario's fleet: a vehicle class per distinct mass, lightest first."""
    from engine.energy import cost_table

    model = demand_model(demand or scenario.energy.demand, scenario)
    masses = [(mass, scenario.fleet.payload_kg) for mass in sorted(set(scenario.fleet.each_mass_kg))]
    return cost_table(world.graph.primitives, model, masses, scenario.time.tick_s)


def beside_costs(scenario: Scenario, world: World) -> Any:
    """Costs of the scenario's second demand model, the vehicles' in turn, or None when it names none."""
    if not scenario.energy.beside:
        return None
    costs, cls = costs_of(scenario, world, scenario.energy.beside), classes_of(scenario)
    if not cls.any():
        return costs
    return type(costs)(costs.mj[cls], costs.total_mj[cls], costs.standby_mj[cls])


def classes_of(scenario: Scenario) -> Any:
    """(V,) vehicle class of every vehicle, a row of `costs_of`."""
    masses = scenario.fleet.each_mass_kg
    return np.searchsorted(sorted(set(masses)), masses).astype(np.int8)


def planner_of(name: str, scenario: Scenario) -> Any:
    """A lifelong planner with the scenario's parameters. Raises ScenarioError."""
    cls = find(PLANNERS, "planner", name)
    chosen = _configured(cls, scenario, name)
    if hasattr(cls, "route"):
        from engine.traffic.timer import Timed

        return Timed(chosen)
    return chosen


def team_of(scenario: Scenario) -> tuple[Any, Any]:
    """(lifelong planner, one-shot solver or None) of a scenario. Raises ScenarioError when the planner doesn't fit.

    A solver plans everybody at the start; what happens later is planned by `prioritized` with the same objective.
    """
    scenario = fitted(scenario)
    name = scenario.planner.name
    if scenario.orders.source != "goals" or not _fits(SOLVERS, name, scenario):
        return planner_of(name, scenario), None
    solver = _configured(find(SOLVERS, "planner", name), scenario, name)
    from engine.planners.prioritized import Prioritized

    return Prioritized(scenario.planner.objective), solver


def _configured(cls: Any, scenario: Scenario, name: str) -> Any:
    """A planner with the scenario's parameters when it is the scenario's own, else with its defaults."""
    from dataclasses import fields

    from engine.planners.base import configured

    parameters = dict(scenario.planner.parameters) if name == scenario.planner.name else {}
    if "objective" in {f.name for f in fields(cls)}:
        parameters.setdefault("objective", scenario.planner.objective)
    return configured(cls, parameters, name)


def planners_for(scenario: Scenario) -> list[str]:
    """Names of the planners that serve a scenario: its floor, its motions, and where its vehicles' tasks come from."""
    if scenario.floor.kind == "terrain":
        return list(ROAMING)
    names = [name for name in PLANNERS if _fits(PLANNERS, name, scenario)]
    if scenario.orders.source == "goals":
        names += [name for name in SOLVERS if name not in names and _fits(SOLVERS, name, scenario)]
    return names


def fitted(scenario: Scenario) -> Scenario:
    """The scenario, its objective being its planner's where that has only one.

    Raises ScenarioError with one sentence when its planner is unknown or doesn't serve it.
    """
    name = scenario.planner.name
    goals = scenario.orders.source == "goals"
    if scenario.floor.kind == "terrain" or name in ROAMING:
        return _fitted_roaming(scenario)
    if name not in PLANNERS and name not in SOLVERS:
        raise ScenarioError(unknown_name("planner", name, {**PLANNERS, **SOLVERS}))
    registry = SOLVERS if name not in PLANNERS or (goals and _fits(SOLVERS, name, scenario)) else PLANNERS
    why = _misfit(registry[name], scenario)
    if registry is SOLVERS and not goals:
        why = f"plans all vehicles at once, each to its goal, and orders.source is {scenario.orders.source!r}"
    if why:
        others = planners_for(scenario)
        known = f"expected {' or '.join(map(repr, others))}" if others else "no planner serves this scenario"
        raise ScenarioError(f"planner.name: {name!r} {why}; {known}")
    return _with_objective(scenario, registry)


def _fitted_roaming(scenario: Scenario) -> Scenario:
    name = scenario.planner.name
    if scenario.floor.kind != "terrain":
        others = " or ".join(map(repr, planners_for(scenario)))
        raise ScenarioError(
            f"planner.name: {name!r} needs terrain, and floor.kind is {scenario.floor.kind!r}; expected {others}"
        )
    if name not in ROAMING:
        known = {**PLANNERS, **SOLVERS}
        wanted = " or ".join(map(repr, ROAMING))
        why = "plans on floors, and floor.kind is 'terrain'" if name in known else "is unknown"
        raise ScenarioError(f"planner.name: {name!r} {why}; expected {wanted}")
    return _with_objective(scenario, ROAMING)


def _with_objective(scenario: Scenario, registry: Mapping[str, str]) -> Scenario:
    """The scenario's objective, or the first one that its planner has."""
    objectives = find(registry, "planner", scenario.planner.name).promise.objectives
    if scenario.planner.objective in objectives:
        return scenario
    return scenario.model_copy(update={"planner": scenario.planner.model_copy(update={"objective": objectives[0]})})


def _fits(registry: Mapping[str, str], name: str, scenario: Scenario) -> bool:
    return name in registry and not _misfit(registry[name], scenario)


def _misfit(entry: str, scenario: Scenario) -> str:
    """What a planner asks of floor and motions and does not get; empty when it serves them."""
    module, _, attribute = entry.partition(":")
    promise = getattr(import_module(module), attribute).promise
    floor, motion = scenario.floor, scenario.motion
    if promise.cells and floor.kind == "network":
        return "needs a floor of cells, and floor.kind is 'network'"
    if Occupancy(floor.occupancy) not in promise.occupancies:
        wanted = " or ".join(repr(str(o)) for o in promise.occupancies)
        return f"needs the occupancy {wanted}, and floor.occupancy is {floor.occupancy!r}"
    if floor.connectivity not in promise.connectivity:
        wanted = " or ".join(map(str, sorted(promise.connectivity)))
        return f"needs {wanted} neighbours per cell, and floor.connectivity is {floor.connectivity}"
    if motion.turning not in promise.turnings:
        return f"needs vehicles that turn while driving, and motion.turning is {motion.turning!r}"
    ticks = (motion.straight_ticks, motion.turn_ticks, motion.reverse_ticks)
    if promise.unit and max(ticks) > 1:
        return f"needs motions of one tick each, and one of this scenario takes {max(ticks)}"
    return ""


def build(
    scenario: Scenario | str,
    *,
    seed: int | None = None,
    recorder: Any = None,
    planner: str | None = None,
    clock_ns: Callable[[], int] = lambda: 0,
) -> Any:
    """A simulation at tick 0. Raises ScenarioError when the scenario can't be built."""
    if isinstance(scenario, str):
        scenario = load(scenario)
    changes: dict[str, Any] = {} if seed is None else {"seed": seed}
    if planner is not None and planner != scenario.planner.name:
        changes["planner.name"] = planner
    if changes:
        scenario = parse(scenario.to_toml(), scenario.name, changes)
    return _simulation(parts_of(scenario), recorder, clock_ns)


def _simulation(parts: Any, recorder: Any, clock_ns: Callable[[], int]) -> Any:
    """The run of these parts: of vehicles on a floor, or of a robot on terrain."""
    if parts.scenario.floor.kind == "terrain":
        from engine.sim.roaming import Roaming

        return Roaming(parts, recorder, clock_ns)
    from engine.sim.simulation import Simulation

    return Simulation(parts, recorder, clock_ns)


def parts_of(scenario: Scenario) -> Any:
    """Everything that a simulation of a scenario is made of. One seed sequence, split per consumer."""
    if scenario.floor.kind == "terrain":
        return _ground_parts(fitted(scenario))
    from engine.planners.search import FloorSearch
    from engine.sim.faults import Faults
    from engine.sim.simulation import Parts

    if scenario.energy.demand in DRIVES:
        raise ScenarioError(
            f"energy.demand: {scenario.energy.demand!r} is a robot on terrain, and floor.kind is "
            f"{scenario.floor.kind!r}; expected {' or '.join(map(repr, DEMAND))}"
        )
    world = build_world(scenario)
    if world.occupancy is Occupancy.MAPF and not world.graph.unit:
        longest = max(world.graph.primitives, key=lambda p: p.ticks)
        raise ScenarioError(
            f"floor.occupancy: got 'mapf', which needs motions of one tick, but {longest.name!r} takes "
            f"{longest.ticks}; expected 'hold'"
        )
    planner, solver = team_of(scenario)
    costs = costs_of(scenario, world)
    start, cls, goals = start_places(scenario, world), classes_of(scenario), goal_places(scenario, world)
    tick_s = scenario.time.tick_s
    streams = np.random.SeedSequence(scenario.seed).spawn(4)
    orders, batteries, planning, faults = streams
    soc = scenario.battery.initial_soc
    low, high = (soc, soc) if isinstance(soc, float) else soc
    charging = find(CHARGING, "charging policy", scenario.charging.policy)()
    if goals:
        from engine.dispatch.to_goals import ToGoals

        charging = ToGoals(goals)
    return Parts(
        scenario=scenario,
        world=world,
        seed=scenario.seed,
        costs=costs,
        search=FloorSearch(world.graph, costs),
        battery=battery.battery_of(**scenario.battery.asked),
        power_mj=charger_mj(scenario),
        planner=planner,
        solver=solver,
        planner_rng=np.random.default_rng(planning),
        dispatcher=dispatcher_of(scenario, charging),
        charging=charging,
        source=source_of(scenario, world, np.random.default_rng(orders)),
        faults=Faults(
            faults,
            scenario.fleet.count,
            scenario.faults.breakdowns_per_vehicle_day,
            round(scenario.faults.repair_s / tick_s),
            tick_s,
        ),
        start=start,
        cls=cls,
        facing=facing_of(scenario, world, costs, start, goals, cls),
        goals=np.array(goals, np.int32),
        initial_soc=np.random.default_rng(batteries).uniform(low, high, scenario.fleet.count),
    )


def robot_of(scenario: Scenario) -> Any:
    """The drive of a scenario's robot. Raises ScenarioError."""
    from engine.energy import parameters_over
    from engine.energy.skid_steer import SkidSteer

    name = scenario.energy.demand
    if name not in DRIVES:
        wanted = " or ".join(map(repr, DRIVES))
        raise ScenarioError(f"energy.demand: got {name!r}, and floor.kind is 'terrain'; expected {wanted}")
    numbers = parameters_over(parameter_sets.zhang2021(scenario.motion.speed_mps), scenario.energy.parameters, name)
    mass_kg = scenario.fleet.each_mass_kg[0] + scenario.fleet.payload_kg
    return SkidSteer(mass_kg=mass_kg, form=DRIVES[name], **numbers)


def terrain_costs(world: Any, robot: Any, objective: str, *, believed: bool = False, table: bool = True) -> Any:
    """Costs of a robot over the ground as it is, or as it is believed to be beforehand."""
    from engine.energy.terrain_costs import TerrainCosts

    ground = world.terrain
    seen = world.known if believed else np.ones(ground.shape, np.bool_)
    return TerrainCosts(
        world.cluster,
        robot,
        ground.cell_m,
        world.prior_m if believed else ground.height_m,
        ground.obstacle & seen,
        np.where(seen, ground.friction, min(1.0, float(ground.friction.min()))).astype(np.float32),
        seen,
        ground.slope_limit_deg,
        world.body_m,
        objective,
        table,
    )


def terrain_search(options: Any, costs: Any, robot: Any, friction: float, start: int, goal_cell: int) -> Any:
    """A search of AD* over costs, on ground with at least this friction factor."""
    from engine.energy.skid_steer import least
    from engine.energy.terrain_costs import OBJECTIVES
    from engine.planners.adstar import Heuristic, Search

    form, per_m, per_rise = ("space", 1.0, 0.0) if costs.objective == OBJECTIVES["distance"] else least(robot, friction)
    heuristic = Heuristic(form, 1000 * per_m, 1000 * per_rise)
    c = costs.cluster
    return Search(
        options, c.end, c.from_heading, c.from_k, costs.height, costs.cost, costs.cell_m, heuristic, start, goal_cell
    )


def roamer_of(scenario: Scenario) -> Any:
    """The options of a robot's planner on terrain. Raises ScenarioError."""
    from engine.planners.base import configured

    name = scenario.planner.name
    return configured(find(ROAMING, "planner", name), scenario.planner.parameters, name)


def check_parameters(scenario: Scenario) -> None:
    """Raises ScenarioError when planner or dispatcher don't take their parameters; makes nothing else of the run."""
    if scenario.floor.kind == "terrain":
        roamer_of(scenario)
        return
    team_of(scenario)
    dispatcher_of(scenario, find(CHARGING, "charging policy", scenario.charging.policy)())


def _ground_parts(scenario: Scenario) -> Any:
    """Everything that a run on terrain is made of."""
    from engine.orders.sources import NoOrders
    from engine.sim.roaming import GroundParts
    from engine.world.terrain import build_terrain

    world, robot = build_terrain(scenario.terrain_plan()), robot_of(scenario)
    options = roamer_of(scenario)
    friction = min(1.0, float(world.terrain.friction.min()))
    heading = {"east": 0, "north": 4, "west": 8, "south": 12}
    start, (goal,) = start_places(scenario, world)[0], goal_places(scenario, world)
    facing = scenario.fleet.heading
    if facing == "best":
        dx, dy = (world.graph.xy_m[goal] - world.graph.xy_m[start]).tolist()
        facing_index = round(np.arctan2(dy, dx) / (2 * np.pi) * 16) % 16
    else:
        facing_index = heading[facing]
    soc = scenario.battery.initial_soc
    low, high = (soc, soc) if isinstance(soc, float) else soc
    objective = scenario.planner.objective
    return GroundParts(
        scenario=scenario,
        world=world,
        seed=scenario.seed,
        battery=battery.battery_of(**scenario.battery.asked),
        believed=terrain_costs(world, robot, objective, believed=True),
        truth=terrain_costs(world, robot, objective, table=False),
        search_of=lambda costs, state, cell: terrain_search(options, costs, robot, friction, state, cell),
        per_tick=options.per_tick,
        standby_mj=round(robot.standby_w * scenario.time.tick_s * MJ_PER_J),
        start=start * 16 + facing_index,
        goal_cell=goal,
        initial_soc=float(np.random.default_rng(scenario.seed).uniform(low, high)),
        source=NoOrders(),
    )


def dispatcher_of(scenario: Scenario, charging: Any) -> Any:
    """The scenario's dispatcher with its parameters. Raises ScenarioError."""
    from engine.planners.base import configured

    name = scenario.dispatch.policy
    cls = find(DISPATCHERS, "dispatcher", name)
    return configured(cls, {"charging": charging, **scenario.dispatch.parameters}, name)


def facing_of(
    scenario: Scenario, world: World, costs: Any, start: Sequence[int], goals: Sequence[int], cls: Any
) -> Any:
    """(V,) motion states in which vehicles stand at the start; empty when they face straight out of their bays."""
    heading, graph = scenario.fleet.heading, world.graph
    if heading == "best":
        if not goals or scenario.floor.connectivity != 4 or scenario.motion.turning != "arc":
            return np.zeros(0, np.int32)
        from engine.planners.problems import cheapest_starts

        return cheapest_starts(graph, costs, start, goals, cls)
    index = graph.heading_deg.index({"east": 0, "north": 90, "west": 180, "south": 270}[heading])
    return np.array([graph.state(place, index) for place in start], np.int32)


def charger_mj(scenario: Scenario) -> tuple[int, int]:
    """Energy per tick that a charger draws from the mains, and that reaches the battery, in mJ."""
    tick_s, charger = scenario.time.tick_s, scenario.charger
    if charger.rate_percent_per_s is not None:
        net = scenario.battery.capacity_wh * 3600 * charger.rate_percent_per_s / 100 * tick_s * MJ_PER_J
        return round(net), round(net)
    gross = charger.power_w * tick_s * MJ_PER_J
    return round(gross), round(gross * charger.efficiency)


def source_of(scenario: Scenario, world: World, rng: np.random.Generator) -> Any:
    """The scenario's source of orders. Raises ScenarioError for unknown stations."""
    from engine.orders.sources import Backlog, Listed, NoOrders, Poisson

    orders = scenario.orders
    if orders.source == "goals":
        return NoOrders()
    if orders.source == "listed":
        for a, b in orders.pairs:
            world.station(a), world.station(b)
        return Listed(orders.pairs)
    mix = []
    for item in orders.mix:
        kinds = [[s.number for s in world.stations_of(kind)] for kind in (item.from_, item.to)]
        for kind, found in zip((item.from_, item.to), kinds, strict=True):
            if not found:
                raise ScenarioError(f"orders.mix: the floor has no station of kind {kind!r}")
        mix.append((kinds[0], kinds[1], item.weight))
    if orders.source == "backlog":
        return Backlog(rng, mix, orders.backlog, orders.limit)
    return Poisson(rng, orders.rate_per_h, mix, scenario.time.tick_s, orders.limit, orders.initial)


def resume(folder: Path, *, recorder: Any = None, clock_ns: Callable[[], int] = lambda: 0) -> Any:
    """The simulation of a checkpoint, at its tick. Its recorder must hold exactly the checkpoint's rows.

    Raises RunError when the checkpoint is damaged or of another version of the code.
    """
    from engine.sim import checkpoint

    plain = checkpoint.read_plain(folder)
    sim = _simulation(parts_of(parse(plain["scenario"], source=f"checkpoint {folder.name}")), None, clock_ns)
    if sim.scenario.floor.kind == "terrain":
        sim.restore(folder, plain)
    else:
        checkpoint.restore(sim, folder, plain)
    sim.ledger.recorder = recorder
    return sim


def replay(sim: Any, commands: Sequence[tuple[int, int, Mapping[str, Any]]], until: int | None = None) -> None:
    """Give a resumed simulation the commands (tick, number, command) that its checkpoint has not seen yet.

    It is advanced to each command's tick, and at last to `until` when given.
    """
    for tick, number, command in sorted(commands, key=lambda row: row[1]):
        if number < sim.commands or (until is not None and tick > until):
            continue
        sim.advance(tick - sim.tick)
        sim.submit(command)
    if until is not None:
        sim.advance(until - sim.tick)


FORKABLE = ("planner", "seed", "orders", "dispatch", "charging", "faults")
"""Sections of a scenario that may change in the middle of a run; what is on the floor depends on all others."""


def swap(
    sim: Any, *, planner: str | None = None, seed: int | None = None, overrides: Mapping[str, Any] | None = None
) -> Scenario:
    """Go on with another planner, seed or parameters from the present tick; returns the changed scenario.

    Motions already committed finish first; a new planner starts from `init`, new orders come from the new seed. Raises
    ScenarioError when a change needs a new run (floor, fleet, time, battery, a planner that is executed as it is …).
    """
    changes: dict[str, Any] = dict(overrides or {})
    if planner is not None:
        changes["planner.name"] = planner
    if seed is not None:
        changes["seed"] = seed
    old: Scenario = sim.scenario
    new = parse(old.to_toml(), "the fork", changes)
    for section in type(old).model_fields:
        if section not in FORKABLE and getattr(new, section) != getattr(old, section):
            raise ScenarioError(f"a fork can't change {section!r}: what is on the floor already depends on it")
    parts = parts_of(new)
    parts.source.start_at(sim.tick)
    same_orders = new.orders == old.orders and new.seed == old.seed
    sim.become(parts, keep_orders=same_orders, keep_faults=new.faults == old.faults and new.seed == old.seed)
    return new
