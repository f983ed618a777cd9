"""Plan files: a solved instance as one JSON text that says everything needed to judge it anywhere.

Cells are [x, y] as in MovingAI's files: the origin is the top left corner, `rows[y][x]` is the cell's letter. Ticks
last one second, cells are one metre wide, every motion takes one tick; a vehicle rests where its path ends.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from engine.energy import parameter_sets
from engine.errors import FormatError, nearest_name
from engine.scenario.model import Positive, Section
from engine.scenario.movingai import MAX_BYTES, MAX_SIDE, PASSABLE, Instance, parse_map

FORMAT = "wattlane plan 1"
HEADINGS = ("east", "north", "west", "south")

Cell = tuple[int, int]
OnMap = Annotated[int, Field(ge=0, lt=MAX_SIDE)]


class PlanVehicle(Section):
    """One vehicle. heading: in which it stands at tick 0 · path: cells tick by tick · energy_mj: what it uses."""

    mass_kg: Positive
    start: tuple[OnMap, OnMap]
    goal: tuple[OnMap, OnMap]
    heading: Literal["east", "north", "west", "south"]
    energy_mj: int
    path: Annotated[tuple[Cell, ...], Field(min_length=1)]


class PlanFile(Section):
    """A plan with all that it was made for.

    rows: of the map, top row first · parameters: of the planner · cost, lower_bound: ticks or mJ, by objective
    · energy: parameters of xu2025's demand model.
    """

    format: Literal["wattlane plan 1"]
    map: str
    scen: str
    planner: str
    parameters: dict[str, Any] = {}
    objective: Literal["time", "energy"]
    status: str
    cost: int
    lower_bound: int
    energy: dict[str, float]
    rows: Annotated[tuple[str, ...], Field(min_length=1, max_length=MAX_SIDE)]
    vehicles: Annotated[tuple[PlanVehicle, ...], Field(min_length=1)]

    def free(self) -> NDArray[np.bool_]:
        """(H, W) cells that a vehicle may be in, row 0 at the bottom."""
        return np.array([[letter in PASSABLE for letter in row] for row in self.rows[::-1]], np.bool_)

    def up(self, cell: Cell) -> Cell:
        """A cell with y upwards."""
        return cell[0], len(self.rows) - 1 - cell[1]

    def instance(self) -> Instance:
        """The floor with the vehicles' starts and goals."""
        starts, goals = (tuple(self.up(getattr(v, end)) for v in self.vehicles) for end in ("start", "goal"))
        return Instance(self.map, self.free(), starts, goals)

    def text(self) -> str:
        """As a file: one line per map row and vehicle."""
        head = self.model_dump_json(exclude={"rows", "vehicles"})[:-1]
        rows = ",\n  ".join(_json(row) for row in self.rows)
        vehicles = ",\n  ".join(v.model_dump_json() for v in self.vehicles)
        return f'{head},\n "rows": [\n  {rows}],\n "vehicles": [\n  {vehicles}]}}\n'


def read_plan(path: str | Path) -> PlanFile:
    """A plan from a file. Raises FormatError with one sentence."""
    file = Path(path)
    try:
        if file.stat().st_size > MAX_BYTES:
            raise FormatError(f"{file.name}: at most {MAX_BYTES:,} bytes are read, got {file.stat().st_size:,}")
        text = file.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{file.name}: a plan file is UTF-8 text; byte {error.start} is not") from error
    except OSError as error:
        raise FormatError(f"{file}: can't be read: {error.strerror or error}") from error
    return parse_plan(text, file.name)


def parse_plan(text: str, source: str = "<plan>") -> PlanFile:
    """A plan from its text. Raises FormatError that names the field, what was got and what was expected."""
    try:
        plan = PlanFile.model_validate_json(text)
    except ValidationError as error:
        raise FormatError(f"{source}: {_sentence(error)}") from error
    except RecursionError as error:
        raise FormatError(f"{source}: nested too deeply for a plan file") from error
    width = len(plan.rows[0])
    # the map reader knows letters and lengths, and says which row is wrong
    parse_map("\n".join([f"height {len(plan.rows)}", f"width {width}", "map", *plan.rows]), f"{source}, rows")
    known = parameter_sets.xu2025()
    for name in plan.energy:
        if name not in known:
            raise FormatError(f"{source}: energy: unknown parameter {name!r}{nearest_name(name, known)}")
    for name in known:
        if name not in plan.energy:
            raise FormatError(f"{source}: energy: {name!r} is missing")
    for i, vehicle in enumerate(plan.vehicles):
        for word, cell in (("start", vehicle.start), ("goal", vehicle.goal)):
            x, y = cell
            if x >= width or y >= len(plan.rows) or plan.rows[y][x] not in PASSABLE:
                raise FormatError(
                    f"{source}: vehicles[{i}].{word}: a free cell of the map was expected, got [{x}, {y}]"
                )
    return plan


def _sentence(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = "".join(f"[{at}]" if isinstance(at, int) else f".{at}" for at in first["loc"]).lstrip(".")
    got = repr(first["input"])
    got = got if len(got) <= 40 else got[:37] + "…"
    message = first["msg"][:1].lower() + first["msg"][1:]
    if first["type"] == "json_invalid":
        return f"not a plan file: {message}"
    if where in ("", "format"):
        return f"not a plan file: {FORMAT!r} was expected under 'format'"
    if first["type"] == "extra_forbidden":
        return f"{where}: no such field in a plan file"
    if first["type"] == "missing":
        return f"{where}: is missing"
    more = len(error.errors()) - 1
    return f"{where}: {message}, got {got}" + (f" (and {more} more)" if more else "")


def _json(text: str) -> str:
    from json import dumps

    return dumps(text, ensure_ascii=False)
