"""The scenarios that a person can open: those that come with the program, and those imported into the data folder.

An imported scenario is a folder of its own, `<root>/<name>/`: `scenario.toml`, which runs, as it was given or as made
from a MovingAI map; beside it the map and the scenario file as they were given; `import.json` says what came from
where.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import assets
from engine.errors import BadInput, ScenarioError, unknown_name

if TYPE_CHECKING:
    from engine.scenario import Scenario
    from engine.scenario.movingai import Instance
    from engine.world import World
    from engine.world.network import Arc, Node

SCENARIO, ABOUT = "scenario.toml", "import.json"
MAX_BYTES = 6 * 2**20
"""What the files of one import may have together."""
AGENTS = 10
"""Vehicles of an instance when nobody says how many."""
THUMB_SIDE = 160
"""A preview in a list has at most so many cells along a side."""
PLACES_SENT = 50_000
"""Instances of more cells are drawn from their letters alone."""
KEPT = {"entry": 1000, "findings": 50, "world": 2}
"""So many answers of each kind are kept until their file changes."""

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,79}")
_KINDS = (".toml", ".map", ".scen")


class NoSuchScenario(BadInput):
    """A name that names no scenario."""


@dataclass(frozen=True, slots=True)
class Upload:
    """A file as it was given."""

    name: str
    text: str

    @property
    def kind(self) -> str:
        return Path(self.name).suffix.lower()


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What goes with the files of an instance: how many vehicles, who plans, the seed of random starts and goals."""

    agents: int | None = None
    planner: str | None = None
    objective: str | None = None
    seed: int = 1


@dataclass(frozen=True, slots=True)
class Entry:
    """A scenario in the list; `error` says why it can't be read, and then only its name is known.

    width, height: in cells, 0 of a network · nodes, arcs: of a network.
    """

    name: str
    imported: bool
    revision: str
    title: str = ""
    width: int = 0
    height: int = 0
    nodes: int = 0
    arcs: int = 0
    cell_m: float = 1.0
    fleet: int = 0
    planner: str = ""
    paper: str = ""
    instance: bool = False
    error: str = ""

    @property
    def size(self) -> str:
        """How large the floor is, in words."""
        return f"{self.nodes} nodes, {self.arcs} arcs" if self.nodes else f"{self.width} × {self.height} cells"


@dataclass(frozen=True, slots=True)
class _Read:
    """What one reading of the files of an import said."""

    scenario: Scenario
    text: str
    made: tuple[Upload, ...]  # beside the TOML, to be kept
    most: int | None  # vehicles that an instance can have


def checked_name(name: object) -> str:
    """The name itself when a scenario may be kept under it. Raises BadInput with a near one that may."""
    text = name if isinstance(name, str) else ""
    if _NAME.fullmatch(text) and ".." not in text and not text.endswith((".", *_KINDS)):
        return text
    near = slug(text)
    hint = f"; did you mean {near!r}?" if near != "floor" else ", such as my-floor"
    raise BadInput(f"name: lower-case letters, digits, '-', '_' and '.' were expected, got {str(name)[:60]!r}{hint}")


def slug(text: str) -> str:
    """A name in the spirit of a text: `My Floor.map` gives `my-floor`."""
    stem = text.strip().replace("\\", "/").rpartition("/")[2]
    for kind in _KINDS:
        if stem.lower().endswith(kind):
            stem = stem[: -len(kind)]
    stem = re.sub(r"[^a-z0-9_.]+", "-", stem.lower())
    return re.sub(r"\.{2,}", ".", stem).strip("-._")[:80].rstrip("-._") or "floor"


class Library:
    """Scenarios by name, those below `root` and the built-in ones. Safe to call from any thread.

    Methods raise NoSuchScenario, ScenarioError or BadInput with the sentence to show, and OSError when the disk
    refuses.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._lock = threading.RLock()
        self._answers: dict[str, OrderedDict[tuple[str, str], Any]] = {what: OrderedDict() for what in KEPT}

    # What there is

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self.built_in() or name in self.imported())

    def means(self, text: str) -> bool:
        """True when a person means a scenario by its name, known or not, and no file."""
        path = Path(text)
        return text in self or (len(path.parts) == 1 and path.suffix != ".toml" and not path.exists())

    def built_in(self) -> list[str]:
        """Names of the scenarios that came with the program."""
        return sorted(file.stem for file in assets.path("scenarios").glob("*.toml"))

    def imported(self) -> list[str]:
        """Names of the user's own scenarios. A folder that is a link, or holds no scenario, does not count."""
        if not self.root.is_dir():
            return []
        folders = (f for f in self.root.iterdir() if _NAME.fullmatch(f.name) and not f.is_symlink())
        return sorted(f.name for f in folders if (f / SCENARIO).is_file() and not (f / SCENARIO).is_symlink())

    def names(self) -> list[str]:
        """The built-in scenarios, then the user's own."""
        built_in = self.built_in()
        return built_in + [name for name in self.imported() if name not in built_in]

    def titles(self) -> dict[str, str]:
        """Name → title of all that can be started."""
        return {entry.name: entry.title for entry in self.entries() if not entry.error}

    def entries(self) -> list[Entry]:
        """All of them, the built-in ones first; one that can't be read says why."""
        found = []
        for name in self.names():
            with contextlib.suppress(NoSuchScenario):  # deleted meanwhile
                found.append(self.entry(name))
        return found

    def entry(self, name: str) -> Entry:
        """One scenario in a few words."""

        def make() -> Entry:
            try:
                scenario = self.load(name)
                nodes, arcs = network_of(scenario)
                rows = scenario.floor.drawing() or ("",)
            except BadInput as error:
                return Entry(name, self.is_imported(name), self.revision(name), title=name, error=str(error))
            return Entry(
                name,
                self.is_imported(name),
                self.revision(name),
                title=scenario.title,
                width=len(rows[0]),
                height=len(rows) if rows[0] else 0,
                nodes=len(nodes),
                arcs=len(arcs),
                cell_m=scenario.floor.cell_m,
                fleet=scenario.fleet.count,
                planner=scenario.planner.name,
                paper=scenario.paper,
                instance=is_instance(scenario) and scenario.floor.kind != "terrain",
            )

        found: Entry = self._kept("entry", name, make)
        return found

    def is_imported(self, name: str) -> bool:
        return name not in self.built_in()

    def file(self, name: str) -> Path:
        """The TOML of a scenario. Raises NoSuchScenario."""
        if isinstance(name, str):
            if name in self.built_in():
                return assets.path("scenarios", f"{name}.toml")
            if name in self.imported():
                return self.root / name / SCENARIO
        raise NoSuchScenario(unknown_name("scenario", str(name)[:80], self.names()))

    def files(self, name: str) -> dict[str, Path]:
        """File name for a download → file: the TOML, and the map and scenario file that it was made from."""
        toml = self.file(name)
        found = {f"{name}.toml": toml}
        if self.is_imported(name):
            found |= {f.name: f for f in sorted(toml.parent.iterdir()) if f.suffix in (".map", ".scen")}
        return found

    def revision(self, name: str) -> str:
        """Changes when the scenario's file does."""
        stat = self.file(name).stat()
        return f"{stat.st_mtime_ns:x}-{stat.st_size:x}"

    def raw_text(self, name: str) -> str:
        """The TOML as it stands in its file; bytes that are no UTF-8 show as �."""
        return self.file(name).read_text("utf-8", errors="replace")

    def about(self, name: str) -> dict[str, Any]:
        """When it was imported and from which files; empty for a built-in one."""
        try:
            found = json.loads((self.file(name).parent / ABOUT).read_text("utf-8"))
        except (FileNotFoundError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def load(self, name: str, overrides: Mapping[str, object] | None = None) -> Scenario:
        """The scenario by its name here, with overrides as engine.scenario.load takes them."""
        import engine.scenario

        if name in self.built_in():
            return engine.scenario.load(name, overrides)
        try:
            text = self.file(name).read_text("utf-8")
        except UnicodeDecodeError as error:
            raise ScenarioError(f"{name}.toml: UTF-8 text was expected; byte {error.start} is not") from error
        # a run of a renamed scenario goes by the new name
        return engine.scenario.parse(text, f"{name}.toml", {"name": name, **(overrides or {})})

    # What is shown of one

    def world(self, name: str) -> World:
        """The compiled floor."""
        from engine.world import build_world

        found: World = self._kept("world", name, lambda: build_world(self.load(name)))
        return found

    def floor(self, name: str) -> dict[str, Any]:
        """World.floor_json, with the `trips` of an instance; of a very large instance the letters alone."""
        scenario = self.load(name)
        ground = scenario.floor.kind == "terrain"
        large = not ground and is_instance(scenario) and sum(map(len, scenario.floor.drawing())) > PLACES_SENT
        floor = letters_of(scenario) if large else self.world(name).floor_json()
        return {**floor, "trips": trips_of(scenario)}

    def thumb(self, name: str) -> dict[str, Any]:
        """The floor's letters, thinned out where it is large: {cells (bottom row first), width, height}.

        Of a network its ends in metres: {nodes: [x, y, kind], arcs: [x, y, x, y], width, height}. Of terrain also
        heights and cell_m, as in World.floor_json.
        """
        scenario = self.load(name)
        if scenario.floor.kind == "terrain":
            return relief(scenario)
        return sketch(scenario) if scenario.floor.kind == "network" else thinned(scenario.floor.drawing())

    def findings(self, name: str) -> list[dict[str, Any]]:
        """What the checks found: level, check, text, place, and where that is in metres."""

        def make() -> list[dict[str, Any]]:
            from engine.scenario.checks import check

            world = self.world(name)
            xy = world.graph.xy_m
            rows = []
            for finding in check(self.load(name), world):
                row = {"level": finding.level, "check": finding.check, "text": finding.text, "place": finding.place}
                if finding.place is not None:
                    row["x"], row["y"] = (round(float(v), 4) for v in xy[finding.place])
                rows.append(row)
            return rows

        found: list[dict[str, Any]] = self._kept("findings", name, make)
        return found

    def planners(self, name: str) -> dict[str, list[str]]:
        """Planners that fit the scenario, each with the objectives that it serves."""
        return planners_of(self.load(name))

    # What changes it

    def look(self, files: Iterable[Upload], wanted: ImportOptions = ImportOptions()) -> dict[str, Any]:
        """What an import of these files would make, and how it looks; nothing is kept."""
        given = checked_files(files)
        read = _read(given, wanted)
        scenario = read.scenario
        nodes, arcs = network_of(scenario)
        rows = scenario.floor.drawing() or ("",)
        return {
            "kind": "instance" if read.most is not None else "scenario",
            "name": self._free(slug(given[0].name if read.most is not None else scenario.name)),
            "title": scenario.title,
            "description": scenario.description,
            "width": len(rows[0]),
            "height": len(rows) if rows[0] else 0,
            "size": f"{len(nodes)} nodes, {len(arcs)} arcs" if nodes else f"{len(rows[0])} × {len(rows)} cells",
            "fleet": scenario.fleet.count,
            "most": read.most,
            "random": read.most is not None and all(f.kind != ".scen" for f in given),
            "planner": scenario.planner.name,
            "objective": scenario.planner.objective,
            "planners": planners_of(scenario),
            "floor": letters_of(scenario)
            if is_instance(scenario) and scenario.floor.kind != "terrain"
            else _world(scenario).floor_json(),
            "trips": trips_of(scenario),
        }

    def add(self, files: Iterable[Upload], name: str | None = None, wanted: ImportOptions = ImportOptions()) -> str:
        """Keeps what the files say under a name (the file's own by default) and returns the name."""
        given = checked_files(files)
        read = _read(given, wanted)
        own = slug(given[0].name) if read.most is not None else read.scenario.name
        chosen = checked_name(name if name else own)
        about = {
            "files": [f.name for f in given],
            "imported": datetime.now(UTC).isoformat(timespec="seconds"),
            "random_seed": wanted.seed if read.made and all(f.kind != ".scen" for f in given) else None,
        }
        with self._lock:
            self._refuse_taken(chosen)
            self.root.mkdir(parents=True, exist_ok=True)
            folder = Path(tempfile.mkdtemp(dir=self.root, prefix=".import-"))
            try:
                _write(folder / SCENARIO, read.text)
                for file in read.made:
                    _write(folder / f"{slug(file.name)}{file.kind}", file.text)
                _write(folder / ABOUT, json.dumps(about, ensure_ascii=False, indent=1) + "\n")
                folder.chmod(0o755)
                folder.rename(self.root / chosen)
            except OSError:
                shutil.rmtree(folder, ignore_errors=True)
                raise
        return chosen

    def rename(self, name: str, new: str) -> str:
        """Gives one of the user's own scenarios another name."""
        folder, chosen = self._own(name), checked_name(new)
        with self._lock:
            if chosen != name:
                self._refuse_taken(chosen)
                folder.rename(self.root / chosen)
        return chosen

    def delete(self, name: str) -> None:
        """Removes one of the user's own scenarios; runs of it keep their own copy."""
        folder = self._own(name)
        with self._lock:
            bin_ = Path(tempfile.mkdtemp(dir=self.root, prefix=".delete-"))
            folder.rename(bin_ / name)  # first: what is left of a failed removal is no scenario
            shutil.rmtree(bin_)

    # Within

    def _own(self, name: str) -> Path:
        folder = self.file(name).parent
        if not self.is_imported(name):
            raise BadInput(f"{name} came with the program and can't be changed; import a copy under another name")
        return folder

    def _refuse_taken(self, name: str) -> None:
        if name in self.built_in() or (self.root / name).exists():
            raise BadInput(f"name: there is a scenario {name!r} already; {self._free(name)!r} is free")

    def _free(self, name: str) -> str:
        taken = set(self.names())
        if name not in taken:
            return name
        stem = name[:70]
        return next(made for i in range(2, len(taken) + 3) if (made := f"{stem}-{i}") not in taken)

    def _kept(self, what: str, name: str, make: Callable[[], Any]) -> Any:
        """make(), or what it gave before when the scenario's file has not changed since."""
        kept, key = self._answers[what], (name, self.revision(name))
        with self._lock:
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        made = make()
        with self._lock:
            kept[key] = made
            while len(kept) > KEPT[what]:
                kept.popitem(last=False)
        return made


def checked_files(files: Iterable[Upload]) -> tuple[Upload, ...]:
    """The files of one import: a TOML, or a map and at most one scenario file, in this order. Raises BadInput."""
    given = sorted(files, key=lambda f: (_KINDS.index(f.kind) if f.kind in _KINDS else -1, f.name))
    expected = "one .toml file, or one .map with at most one .scen, was expected"
    if not given:
        raise BadInput(f"{expected}; got no file")
    try:
        size = sum(len(f.text.encode()) for f in given)
    except UnicodeEncodeError:
        raise BadInput("the files of an import must be UTF-8 text") from None
    if size > MAX_BYTES:
        raise BadInput(f"an import has at most {MAX_BYTES / 2**20:.0f} MB; got {size / 2**20:.1f} MB")
    for file in given:
        if file.kind not in _KINDS:
            raise BadInput(f"{file.name[:80]}: {expected}")
        if "\0" in file.text:
            raise BadInput(f"{file.name[:80]}: a text file was expected, this one is binary")
    kinds = [f.kind for f in given]
    if kinds == [".scen"]:
        raise BadInput(f"{given[0].name[:80]}: a .scen file needs its .map; choose both together")
    if kinds not in ([".toml"], [".map"], [".map", ".scen"]):
        raise BadInput(f"{expected}; got {', '.join(f.name[:40] for f in given[:5])}")
    return tuple(given)


def planners_of(scenario: Scenario) -> dict[str, list[str]]:
    """Planners that fit a scenario, each with the objectives that it serves."""
    from engine.build import fitted, planners_for

    def served(name: str, objective: str) -> bool:
        plan = scenario.planner.model_copy(update={"name": name, "objective": objective})
        return fitted(scenario.model_copy(update={"planner": plan})).planner.objective == objective

    return {name: [o for o in ("time", "energy", "distance") if served(name, o)] for name in planners_for(scenario)}


def is_instance(scenario: Scenario) -> bool:
    """True when every vehicle has one goal of its own instead of orders."""
    return scenario.orders.source == "goals"


def fleet_overrides(scenario: Scenario, count: int) -> dict[str, object]:
    """Overrides for a fleet of `count`: of an instance, the first so many vehicles. Raises BadInput."""
    if count == scenario.fleet.count:
        return {}
    if not is_instance(scenario):
        return {"fleet.count": count}
    have = len(scenario.orders.goals)
    if not 1 <= count <= have:
        raise BadInput(f"vehicles: 1 to {have} were expected, as many as have a start and a goal; got {count}")
    told = f"{have} vehicles to their goals"
    changes: dict[str, object] = {
        "title": scenario.title.replace(told, f"{count} of {told}"),
        "fleet.count": count,
        "orders.goals": [list(cell) for cell in scenario.orders.goals[:count]],
    }
    if not isinstance(scenario.fleet.start, str):
        changes["fleet.start"] = [list(cell) for cell in scenario.fleet.start[:count]]
    return changes


def trips_of(scenario: Scenario) -> list[list[float]]:
    """Start and goal of every vehicle that has them as cells, in metres: [x, y, x, y], or [x, y] without a goal."""
    starts = scenario.fleet.start
    if isinstance(starts, str):
        return []
    goals = scenario.orders.goals if is_instance(scenario) else ()
    cell = scenario.floor.cell_m
    ends = [(*start, *goal) for start, goal in zip(starts, goals, strict=False)] or list(starts)
    return [[round((v + 0.5) * cell, 4) for v in trip] for trip in ends]


def letters_of(scenario: Scenario) -> dict[str, Any]:
    """World.floor_json of a floor without stations, places left out; needs no compiled world."""
    rows = scenario.floor.drawing()
    nothing = dict.fromkeys(("places", "stations", "chargers", "parking", "one_way"), ())
    size = {"width": len(rows[0]), "height": len(rows), "cell_m": scenario.floor.cell_m}
    return {"kind": "grid", **size, "cells": rows[::-1], **nothing}


def network_of(scenario: Scenario) -> tuple[tuple[Node, ...], tuple[Arc, ...]]:
    """Nodes and arcs of a path network; none of any other floor."""
    network = scenario.floor.network
    return network.parts() if network is not None else ((), ())


def sketch(scenario: Scenario) -> dict[str, Any]:
    """Nodes and arcs of a network in metres from its lower left corner; needs no compiled world."""
    from engine.world.network import extent

    nodes, arcs = network_of(scenario)
    x0, y0, x1, y1 = extent(nodes, arcs)
    at = [(round(n.x_m - x0, 3), round(n.y_m - y0, 3)) for n in nodes]
    return {
        "nodes": [[*xy, str(n.kind or "")] for xy, n in zip(at, nodes, strict=True)],
        "arcs": [[*at[arc.a], *at[arc.b]] for arc in arcs],
        "width": round(x1 - x0, 3),
        "height": round(y1 - y0, 3),
    }


def relief(scenario: Scenario) -> dict[str, Any]:
    """Terrain as `thinned` does drawings, with its heights as engine.world.terrain.packed gives them."""
    from engine.world.terrain import packed

    rows, plan = scenario.floor.drawing(), scenario.terrain_plan()
    step = -(-max(len(rows), len(rows[0])) // THUMB_SIDE)
    heights = packed(plan.terrain.height_m[::step, ::step])
    return {**thinned(rows), "cell_m": scenario.floor.cell_m * step, "heights": heights}


def thinned(rows: tuple[str, ...]) -> dict[str, Any]:
    """Every k-th letter of a drawing, so that neither side is longer than THUMB_SIDE; bottom row first."""
    step = -(-max(len(rows), len(rows[0])) // THUMB_SIDE)
    cells = [row[::step] for row in rows[::-1][::step]]
    return {"cells": cells, "width": len(cells[0]), "height": len(cells)}


def _world(scenario: Scenario) -> World:
    from engine.world import build_world

    return build_world(scenario)


def _read(given: tuple[Upload, ...], wanted: ImportOptions) -> _Read:
    """The scenario that the files describe. Raises ScenarioError, FormatError."""
    import engine.scenario
    from app.runner import checked

    if given[0].kind == ".toml":
        scenario = engine.scenario.parse(given[0].text, given[0].name)
        checked(scenario)
        _world(scenario)
        return _Read(scenario, given[0].text, (), None)
    from engine.scenario import movingai

    floor = given[0]
    if len(given) == 2:
        scen = given[1]
        most = len(movingai.parse_scen(scen.text, scen.name))
        agents = min(AGENTS, most) if wanted.agents is None else wanted.agents
    else:
        instance = _random(floor, wanted)
        most, agents = int(movingai.largest_part(instance.free).sum()), instance.agents
        scen = Upload(f"{Path(floor.name).stem}.scen", movingai.scen_text(instance, floor.name))
    if not 1 <= agents <= most:
        raise BadInput(f"vehicles: 1 to {most} were expected, got {agents}")
    more: dict[str, Any] = {}
    if wanted.planner:
        more["planner"] = wanted.planner
    if wanted.objective:
        more["objective"] = wanted.objective
    scenario = engine.scenario.from_movingai(
        floor.text, scen.text, agents=agents, map_name=floor.name, scen_name=scen.name, seed=wanted.seed, **more
    )
    scenario = checked(scenario)
    return _Read(scenario, scenario.to_toml(), (floor, scen), most)


def _random(floor: Upload, wanted: ImportOptions) -> Instance:
    """Seeded random starts and goals on a map."""
    import numpy as np

    from engine.scenario import movingai

    free = movingai.parse_map(floor.text, floor.name)
    agents = max(1, min(AGENTS, int(free.sum()) // 2)) if wanted.agents is None else wanted.agents
    if agents < 1:
        raise BadInput(f"vehicles: at least 1 was expected, got {agents}")
    return movingai.random_trips(np.random.default_rng(wanted.seed), free, agents, Path(floor.name).stem)


def _write(path: Path, text: str) -> None:
    """As it was given: line ends are not touched."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
