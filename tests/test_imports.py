"""Who may import whom. The table is the architecture; the tests below hold every module to it.

A room is a folder or file directly below engine/ or app/. `room` in a set allows all of that room's modules;
`room!` allows its front door alone (`engine.room` or `engine.room.base`: the contracts).
A room may always import itself. An import counts wherever it stands: at the top, in a function, for typing only.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# Pure data and vocabulary: anyone may import these.
PURE = {"engine.types", "engine.units", "engine.errors", "engine.compiled", "engine.results.schema"}

LAYOUT = {"world", "energy"}
ASKED = {"scenario", "orders"}
DECIDERS = {"planners", "dispatch", "traffic"}

MAY_IMPORT: dict[str, set[str]] = {
    "types": set(),
    "units": set(),
    "errors": set(),
    "compiled": set(),
    "world": set(),
    "energy": {"world"},
    "scenario": LAYOUT,
    "orders": LAYOUT | {"scenario"},
    "planners": {"world", "energy!", "traffic"} | ASKED,
    "dispatch": {"world", "energy!", "planners!", "traffic!"} | ASKED,
    "traffic": {"world", "energy!", "planners!"} | ASKED,
    "sim": LAYOUT | ASKED | {f"{room}!" for room in DECIDERS},
    "results": LAYOUT | ASKED | {f"{room}!" for room in DECIDERS} | {"sim"},
    "build": LAYOUT | ASKED | DECIDERS | {"sim", "results"},
    "replay": LAYOUT | ASKED | DECIDERS | {"sim", "results", "build"},
    "studies": LAYOUT | ASKED | DECIDERS | {"sim", "results", "build", "replay"},
}
# The front door, engine/__init__.py, lists what exists. Only what is outside engine/ comes in through it.
FRONT_DOOR = "engine"

# module prefix → rooms it may not import at all, whatever the table says of its room.
NEVER = {
    "engine.sim.judge": {"planners", "traffic", "dispatch", "build"},
}

# package → module prefixes that may import it; everything else may not.
ONLY_IN = {
    "rerun": ("engine.replay",),
    "dash": ("app",),
    "dash_ag_grid": ("app",),
    "dash_mantine_components": ("app",),
    "fastapi": ("app",),
    "starlette": ("app",),
    "uvicorn": ("app",),
    "plotly": ("app",),
    "typer": ("app",),
    "rich": ("app",),
}
# A figure builder takes data and returns a figure: it knows no Dash.
NOT_IN = {
    "dash": ("app.figures",),
    "dash_ag_grid": ("app.figures",),
    "dash_mantine_components": ("app.figures",),
}

# Outside these, the engine neither prints nor looks at a clock.
MAY_PRINT_AND_TIME = ("engine.replay", "engine.studies")
CLOCKS = re.compile(r"^(time(\..*)?|datetime\.(datetime\.|date\.)?(now|utcnow|today)|timeit(\..*)?)$")

# A registry names the modules of its own room; engine.build knows every registry.
KNOWS_EVERY_ROOM = ("engine.build", "app")
LAZY = re.compile(r"^(?:engine|app)(?:\.\w+)+:\w+$")

# Importing the command line must stay quick: these cost up to seconds each.
HEAVY = ("numba", "dash", "plotly", "rerun", "scipy", "pyarrow", "networkx", "fastapi", "uvicorn")


@dataclass(frozen=True)
class Module:
    name: str
    path: Path
    tree: ast.Module

    @property
    def room(self) -> str:
        parts = self.name.split(".")
        return parts[1] if len(parts) > 1 else FRONT_DOOR

    def within(self, prefixes: tuple[str, ...]) -> bool:
        return any(self.name == prefix or self.name.startswith(prefix + ".") for prefix in prefixes)

    def imports(self) -> Iterator[tuple[str, int]]:
        """Each dotted name that it imports, with the line. `from a import b` is a.b where that is a module, else a."""
        package = self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.name, node.lineno
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    parents = package.split(".")
                    base = ".".join([*parents[: len(parents) - node.level + 1], *([base] if base else [])])
                for alias in node.names:
                    whole = f"{base}.{alias.name}"
                    yield (whole if is_module(whole) else base), node.lineno


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


@cache
def modules() -> tuple[Module, ...]:
    found = []
    for top in ("engine", "app"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found.append(Module(name, path, ast.parse(path.read_text("utf-8"), str(path))))
    return tuple(found)


def where(module: Module, line: int) -> str:
    return f"{module.path.relative_to(ROOT).as_posix()}:{line}"


def allowed(module: Module, target: str) -> bool:
    """Whether a module of engine/ may import another one."""
    if target in PURE:
        return True
    parts = target.split(".")
    if len(parts) == 1:
        return False
    room = parts[1]
    if any(module.within((prefix,)) and room in rooms for prefix, rooms in NEVER.items()):
        return False
    if room == module.room:
        return True
    granted = MAY_IMPORT[module.room]
    return room in granted or (f"{room}!" in granted and parts[2:] in ([], ["base"]))


def test_the_table_has_every_room_and_no_other() -> None:
    present = {module.room for module in modules() if module.name.startswith("engine.")}
    assert present <= MAY_IMPORT.keys(), f"rooms that the table doesn't know: {sorted(present - MAY_IMPORT.keys())}"
    named = {room.rstrip("!") for granted in MAY_IMPORT.values() for room in granted}
    assert named <= MAY_IMPORT.keys()


def test_the_table_has_no_circle() -> None:
    """Whole rooms follow in one direction; only contracts (`!`) may be looked at from both sides."""
    seen: set[str] = set()

    def visit(room: str, way: tuple[str, ...]) -> None:
        assert room not in way, " → ".join([*way, room])
        if room not in seen:
            for below in sorted(MAY_IMPORT[room]):
                if not below.endswith("!"):
                    visit(below, (*way, room))
            seen.add(room)

    for room in MAY_IMPORT:
        visit(room, ())


def test_engine_rooms_import_only_what_the_table_allows() -> None:
    wrong = [
        f"{where(module, line)}: {module.room} imports {target}"
        for module in modules()
        if module.name.startswith("engine.")
        for target, line in module.imports()
        if target.split(".")[0] == "engine" and not allowed(module, target)
    ]
    assert not wrong, "\n".join(wrong)


def test_the_engine_knows_nothing_of_the_app_and_its_files() -> None:
    wrong = [
        f"{where(module, line)}: imports {target}"
        for module in modules()
        if module.name.split(".")[0] == "engine"
        for target, line in module.imports()
        if target.split(".")[0] in {"app", "tests"}
    ]
    assert not wrong, "\n".join(wrong)


def test_packages_are_imported_only_where_they_belong() -> None:
    wrong = []
    for module in modules():
        for target, line in module.imports():
            package = target.split(".")[0]
            here = package not in ONLY_IN or module.within(ONLY_IN[package])
            if not here or module.within(NOT_IN.get(package, ())):
                wrong.append(f"{where(module, line)}: imports {target}")
    assert not wrong, "\n".join(wrong)


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return ""


def test_the_engine_neither_prints_nor_looks_at_a_clock() -> None:
    wrong = []
    for module in modules():
        if not module.within(("engine",)) or module.within(MAY_PRINT_AND_TIME):
            continue
        wrong += [
            f"{where(module, line)}: imports {target}" for target, line in module.imports() if CLOCKS.match(target)
        ]
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call):
                called = dotted(node.func)
                # `from datetime import datetime` leaves the module's own name out.
                if called == "print" or any(CLOCKS.match(name) for name in (called, f"datetime.{called}")):
                    wrong.append(f"{where(module, node.lineno)}: calls {called}")
    assert not wrong, "\n".join(wrong)


def test_registries_name_the_modules_of_their_own_room() -> None:
    wrong = []
    for module in modules():
        if module.within(KNOWS_EVERY_ROOM):
            continue
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and LAZY.match(node.value):
                named = node.value.partition(":")[0]
                if named.split(".")[:2] != module.name.split(".")[:2]:
                    wrong.append(f"{where(module, node.lineno)}: names {node.value}")
    assert not wrong, "\n".join(wrong)


def test_lazy_names_lead_to_modules() -> None:
    wrong = [
        f"{where(module, node.lineno)}: {node.value}"
        for module in modules()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and LAZY.match(node.value)
        if not is_module(node.value.partition(":")[0])
    ]
    assert not wrong, "names of modules that don't exist:\n" + "\n".join(wrong)


def test_the_command_line_is_imported_without_the_heavy_packages() -> None:
    program = f"import sys, app.cli; print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == []


@pytest.mark.parametrize(
    ("name", "target", "fine"),
    [
        ("engine.world.grid", "engine.units", True),
        ("engine.world.grid", "engine.scenario.model", False),
        ("engine.world.grid", "engine", False),
        ("engine.planners.sipp", "engine.energy", True),
        ("engine.planners.sipp", "engine.energy.battery", False),
        ("engine.planners.sipp", "engine.sim.state", False),
        ("engine.planners.sipp", "engine.results.schema", True),
        ("engine.planners.sipp", "engine.results.runlog", False),
        ("engine.sim.step", "engine.planners.base", True),
        ("engine.sim.step", "engine.planners.sipp", False),
        ("engine.sim.judge", "engine.planners.base", False),
        ("engine.sim.judge", "engine.world.motion_graph", True),
        ("engine.build", "engine.planners.sipp", True),
    ],
)
def test_the_table_is_read_as_it_is_meant(name: str, target: str, fine: bool) -> None:
    assert allowed(Module(name, ROOT / "unused.py", ast.Module([], [])), target) is fine
