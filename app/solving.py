"""`wattlane solve`: one MovingAI instance, one planner, one answer, judged; its plan file and its trace."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.errors import BadInput, unknown_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from engine.planners.oneshot import Limits, Problem, Solution
    from engine.scenario.movingai import Instance
    from engine.scenario.plan_file import PlanFile

Tables = Mapping[str, Mapping[str, "NDArray[Any]"]]

OWN_OBJECTIVE = {"cbs": "time", "ecbs": "energy", "time-window": "energy", "astar": "time", "eea": "energy"}
"""Planners that minimise one thing only."""
TRACES = (".json", ".npz")


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be solved. masses_kg: in turn · parameters: of the planner · energy: over xu2025's defaults
    · heading: of all vehicles at the start, or `cheapest` · time_limit_s: wall time, None for no end.
    """

    map: Path
    scen: Path
    planner: str
    agents: int | None = None
    objective: str | None = None
    w: float | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    masses_kg: Sequence[float] = (1000.0,)
    energy: Mapping[str, float] = field(default_factory=dict)
    heading: str = "cheapest"
    time_limit_s: float | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of it. plan: None without one · summary: what `--json` prints · trace: tables, when asked for."""

    summary: dict[str, Any]
    note: str
    plan: PlanFile | None
    trace: Tables


def planners() -> list[str]:
    """Names of all planners that solve instances."""
    from engine.build import SEARCHES, SOLVERS

    return [*SOLVERS, *SEARCHES]


def check_targets(out: Path | None, trace: Path | None) -> None:
    """Raises BadInput when plan or trace can't be written under these names: before anything is searched."""
    if trace is not None and trace.suffix not in TRACES:
        raise BadInput(f"--trace: a file ending in {' or '.join(TRACES)} was expected, got {trace.name!r}")
    for option, file in (("--out", out), ("--trace", trace)):
        if file is not None and not file.absolute().parent.is_dir():
            raise BadInput(f"{option}: the folder {file.absolute().parent} doesn't exist")


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Positive numbers separated by commas. Raises BadInput."""
    return tuple(_above_zero(part, option, "numbers above 0 (such as 1000, or 2000,2200)") for part in text.split(","))


def _above_zero(text: str, option: str, what: str) -> float:
    try:
        found = float(text)
        if not 0 < found < float("inf"):
            raise ValueError(text)
    except ValueError:
        raise BadInput(f"{option}: expected {what}, got {text!r}") from None
    return found


def energies(pairs: Mapping[str, Any]) -> dict[str, float]:
    """Energy parameters given as texts. Raises BadInput."""
    from engine.energy import parameter_sets, parameters_over

    parameters_over(parameter_sets.xu2025(), dict.fromkeys(pairs, 0.0), "xu2025")
    return {name: _above_zero(str(text), f"--energy {name}", "a number above 0") for name, text in pairs.items()}


def read(asked: Asked) -> Instance:
    """The instance. Raises BadInput when it can't be read, or when the planner doesn't serve it."""
    from engine.scenario.movingai import read_instance

    planner, _, _ = configured_planner(asked)
    instance = read_instance(asked.map, asked.scen, asked.agents)
    if instance.agents == 0:
        raise BadInput(f"{asked.scen.name}: at least one vehicle was expected, got none")
    if hasattr(planner, "search") and instance.agents != 1:
        raise BadInput(f"{asked.planner} plans one vehicle; expected --agents 1, got {instance.agents} vehicles")
    return instance


def solve(
    asked: Asked, instance: Instance, *, trace: bool = False, clock: Callable[[], float] = time.monotonic
) -> Answer:
    """Solve and judge. clock: seconds, asked between chunks of work. Raises BadInput with one sentence."""
    from engine.planners.oneshot import Limits
    from engine.planners.problems import problem_of
    from engine.sim.judge import judge_plan_file
    from engine.types import PlanStatus

    planner, objective, parameters = configured_planner(asked)
    free_start = objective == "time" and asked.heading == "cheapest"
    heading = "east" if free_start else asked.heading
    problem = problem_of(instance, masses_kg=asked.masses_kg, parameters=asked.energy, heading=heading)
    end = None if asked.time_limit_s is None else clock() + asked.time_limit_s
    limits = Limits(stop=lambda: end is not None and clock() >= end)
    begin = time.process_time()
    found = run(planner, problem, limits, free_start=asked.heading == "cheapest", trace=trace)
    cpu_ms = 1000 * (time.process_time() - begin)
    if found.status is PlanStatus.INCONSISTENT:
        raise BadInput(f"{asked.scen.name}: {found.note}")
    plan = None
    if found.states:
        plan = plan_of(asked, instance, problem, found, objective, parameters, free_start)
    energy_mj = sum(v.energy_mj for v in plan.vehicles) if plan else 0
    summary = {
        "map": instance.name,
        "scen": asked.scen.name,
        "agents": instance.agents,
        "planner": asked.planner,
        "objective": objective,
        "status": str(found.status.value),
        "cost": found.cost if plan else None,
        "lower_bound": found.lower_bound,
        "energy_j": energy_mj / 1000 if plan else None,
        "makespan": max(len(v.path) for v in plan.vehicles) - 1 if plan else None,
        "expanded_high": found.expanded_high,
        "expanded_low": found.expanded_low,
        "cpu_ms": round(cpu_ms, 3),
        "breaches": len(judge_plan_file(plan)) if plan else 0,
    }
    return Answer(summary, found.note, plan, with_order(found.trace, problem))


def warm_up(asked: Asked) -> None:
    """Compiles, or loads, the kernels of a planner on a floor of four cells, so that none of it is counted."""
    import numpy as np

    from engine.planners.oneshot import Limits
    from engine.planners.problems import problem_of
    from engine.scenario.movingai import Instance

    planner, objective, _ = configured_planner(asked)
    n = 1 if hasattr(planner, "search") else 2
    starts, goals = ((0, 0), (1, 1))[:n], ((1, 1), (0, 0))[:n]
    problem = problem_of(Instance("four cells", np.ones((2, 2), np.bool_), starts, goals))
    run(planner, problem, Limits(nodes=100), free_start=objective == "time", trace=False)


# -- the planner ------------------------------------------------------------------------------------------------------


def configured_planner(asked: Asked) -> tuple[Any, str, dict[str, Any]]:
    """The planner, what it minimises, and all its parameters. Raises BadInput."""
    from engine.build import SEARCHES, SOLVERS, find
    from engine.planners.base import configured

    cls = find({**SOLVERS, **SEARCHES}, "planner", asked.planner)
    known = {f.name: f for f in fields(cls)}
    given = {name: _value(name, text, known) for name, text in asked.parameters.items()}
    objective = OWN_OBJECTIVE.get(asked.planner) or str(given.get("objective", asked.objective or "time"))
    if asked.objective is not None and asked.objective != objective:
        if asked.objective not in ("time", "energy"):
            raise BadInput(unknown_name("objective", asked.objective, ("time", "energy")))
        other = [name for name, own in OWN_OBJECTIVE.items() if own == asked.objective]
        raise BadInput(
            f"--objective: {asked.planner} minimises {objective}, not {asked.objective}; "
            f"{', '.join([*other, 'prioritized'])} do that"
        )
    if "objective" in known:
        given["objective"] = objective
    if asked.w is not None:
        if "w" not in known:
            raise BadInput(f"--w: {asked.planner} proves no bound; cbs and ecbs do")
        given["w"] = asked.w
    if not float(given.get("w", 1.0)) >= 1.0:
        raise BadInput(f"--w: a factor of at least 1 was expected, got {given['w']:g}")
    planner = configured(cls, given, asked.planner)
    return planner, objective, {name: getattr(planner, name) for name in known}


def _value(name: str, text: Any, known: Mapping[str, Any]) -> Any:
    """A parameter's text as a value of the type of its default. Raises BadInput."""
    if name not in known or not isinstance(text, str):
        return text  # an unknown name is refused with the nearest one later
    default = known[name].default
    try:
        if isinstance(default, bool):
            return {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[text.lower()]
        if isinstance(default, int):
            return int(text)
        if isinstance(default, float):
            return float(text)
        if isinstance(default, tuple):
            values = tuple(float(part) for part in text.split(","))
            if len(values) != len(default):
                raise ValueError(text)
            return values
    except (KeyError, ValueError):
        kind = "true or false" if isinstance(default, bool) else f"a value such as {default!r}"
        raise BadInput(f"--set {name}: {kind} was expected, got {text!r}") from None
    return text


def run(planner: Any, problem: Problem, limits: Limits, *, free_start: bool, trace: bool) -> Solution:
    """The planner's solution; a single vehicle's search is answered in the same form."""
    if not hasattr(planner, "search"):
        answer: Solution = planner.solve(problem, limits, trace=trace)
        return answer
    from engine.planners.eea import Eea
    from engine.planners.oneshot import Solution
    from engine.planners.single import Floor
    from engine.types import PlanStatus

    floor = Floor(problem.graph, problem.costs, problem.blocked)
    state, goal = int(problem.starts[0]), int(problem.goals[0])
    start = state // floor.per_place
    heading = None if free_start else state % floor.per_place // 2
    way = planner.search(floor, start, goal, heading=heading, trace=trace)
    tables = {"expansions": way.trace} if way.trace else {}
    if way.status is not PlanStatus.SOLVED:
        note = "vehicle 0 can't reach its goal" if way.status is PlanStatus.NO_PATH else ""
        return Solution(way.status, (), -1, 0, 0, way.expanded, note, tables)
    if isinstance(planner, Eea):
        # a variant's own count may be another than what its path uses; the bound is what the exact search proves
        best = Eea().search(floor, start, goal, heading=heading)
        return Solution(way.status, (way.states,), floor.energy(way.states), best.cost, 0, way.expanded, "", tables)
    ticks = len(way.states) - 1
    return Solution(way.status, (way.states,), ticks, ticks, 0, way.expanded, "", tables)


# -- files ------------------------------------------------------------------------------------------------------------


def plan_of(
    asked: Asked,
    instance: Instance,
    problem: Problem,
    found: Solution,
    objective: str,
    parameters: Mapping[str, Any],
    free_start: bool,
) -> PlanFile:
    """The plan with everything needed to judge it. free_start: a vehicle faces its first step, wherever that leads."""
    from engine.energy import parameter_sets, parameters_over
    from engine.planners.single import Floor
    from engine.scenario.movingai import map_rows
    from engine.scenario.plan_file import FORMAT, HEADINGS, PlanFile, PlanVehicle

    floor = Floor(problem.graph, problem.costs)
    height = instance.free.shape[0]
    xy = (problem.graph.xy_m - 0.5).round().astype(int)
    vehicles = []
    for k, states in enumerate(found.states):
        places = states // floor.per_place
        driven = floor.along(places) if free_start else states
        vehicles.append(
            PlanVehicle(
                mass_kg=float(asked.masses_kg[k % len(asked.masses_kg)]),
                start=(instance.starts[k][0], height - 1 - instance.starts[k][1]),
                goal=(instance.goals[k][0], height - 1 - instance.goals[k][1]),
                heading=HEADINGS[int(driven[0]) % floor.per_place // 2],
                energy_mj=floor.energy(driven, int(problem.cls[k])),
                path=tuple((x, height - 1 - y) for x, y in xy[places].tolist()),
            )
        )
    return PlanFile(
        format=FORMAT,
        map=instance.name,
        scen=asked.scen.name,
        planner=asked.planner,
        parameters=dict(parameters),
        objective=objective,  # type: ignore[arg-type]
        status=str(found.status.value),
        cost=int(found.cost),
        lower_bound=int(found.lower_bound),
        energy=parameters_over(parameter_sets.xu2025(), asked.energy, "xu2025"),
        rows=tuple(map_rows(instance.free)),
        vehicles=tuple(vehicles),
    )


def with_order(trace: Tables, problem: Problem) -> Tables:
    """A trace for a file: expansions get their number, and their place where nodes are states."""
    if "expansions" not in trace:
        return trace
    import numpy as np

    rows = trace["expansions"]
    return {**trace, "expansions": {"order": np.arange(len(rows["node"]), dtype=np.int32), **rows}}


def write_trace(trace: Tables, file: Path) -> None:
    """Tables as `{table: {column: [values]}}` in JSON, or as arrays `table/column` in an .npz without pickles."""
    if file.suffix == ".npz":
        import numpy as np

        arrays = {f"{table}/{name}": values for table, columns in trace.items() for name, values in columns.items()}
        with file.open("wb") as out:
            np.savez_compressed(out, **arrays)
        return
    plain = {t: {name: values.tolist() for name, values in columns.items()} for t, columns in trace.items()}
    file.write_text(json.dumps(plain), "utf-8")


# -- for a person -----------------------------------------------------------------------------------------------------


def amount(value: int, objective: str) -> str:
    """A cost in its unit."""
    return f"{value:,} ticks" if objective == "time" else f"{value / 1000:,.1f} J"


def verdict_of(summary: Mapping[str, Any]) -> str:
    """How far the answer is proven."""
    cost, bound, status = summary["cost"], summary["lower_bound"], summary["status"]
    if cost is None:
        return status
    if cost == bound:
        return f"{status}, proven optimal"
    if bound <= 0:
        return f"{status}, nothing proven"
    return f"{status}, at most {100 * (cost / bound - 1):.2f} % above the optimum"


def summary_text(answer: Answer, files: Sequence[Path]) -> str:
    """The answer for a person."""
    s = answer.summary
    vehicles = "1 vehicle" if s["agents"] == 1 else f"{s['agents']} vehicles"
    rows = [("status", verdict_of(s))]
    if answer.note:
        rows.append(("", answer.note))
    if s["cost"] is not None:
        rows.append(("cost", amount(s["cost"], s["objective"])))
    if s["lower_bound"] > 0 and s["lower_bound"] != s["cost"]:
        rows.append(("proven", f"no plan below {amount(s['lower_bound'], s['objective'])}"))
    if s["cost"] is not None:
        if s["objective"] == "time":
            rows.append(("energy", f"{s['energy_j']:,.1f} J"))
        rows.append(("makespan", f"{s['makespan']:,} ticks"))
    nodes = f"{s['expanded_high']:,} nodes · " if s["expanded_high"] else ""
    rows.append(("work", f"{nodes}{s['expanded_low']:,} expansions · {s['cpu_ms']:,.1f} ms CPU"))
    if s["cost"] is not None:
        rows.append(("judge", "legal" if not s["breaches"] else f"{s['breaches']} breaches"))
    rows += [("written", str(file)) for file in files]
    head = f"{s['map']} · {s['scen']} · {vehicles} · {s['planner']} by {s['objective']}"
    return "\n".join([head, *(f"  {name:<9} {value}" for name, value in rows)])
