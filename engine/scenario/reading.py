"""From TOML text and overrides to a Scenario, or to one clear sentence per problem."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import assets
from engine.errors import BadInput, FormatError, ScenarioError, nearest_name, unknown_name
from engine.scenario import toml_text
from engine.scenario.consistency import Problem, problems_of
from engine.scenario.model import Scenario, Section
from engine.scenario.toml_text import Path

MAX_BYTES = 5_000_000
"""A larger text is refused before it is parsed."""

_AT = re.compile(r"^(?P<what>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|(?P<end>end of document))\)$", re.S)


def library() -> dict[str, str]:
    """Built-in scenarios: name → title, by name."""
    found: dict[str, str] = {}
    for file in sorted(assets.path("scenarios").glob("*.toml")):
        found[file.stem] = str(tomllib.loads(file.read_text("utf-8")).get("title", file.stem))
    return found


def load(name_or_path: str | FilePath, overrides: Mapping[str, object] | None = None) -> Scenario:
    """A built-in scenario by name, or one from a TOML file. Raises ScenarioError.

    overrides: dotted key → value, as from `--set fleet.count=12`; a string is read as a TOML value where it is one,
    None and "none" take a key back to its default.
    """
    wanted = str(name_or_path)
    names = library()
    file, source = FilePath(name_or_path), wanted
    if wanted in names:
        file, source = assets.path("scenarios", f"{wanted}.toml"), f"{wanted}.toml"
    elif not wanted or "\0" in wanted:
        raise ScenarioError(unknown_name("scenario", wanted, names))
    try:
        if file.is_dir():
            raise ScenarioError(f"{wanted}: a TOML file was expected, got a folder")
        size = file.stat().st_size
        if size > MAX_BYTES:
            raise ScenarioError(f"{source}: a scenario has at most {MAX_BYTES:,} bytes, got {size:,}")
        text = file.read_text("utf-8")
    except (FileNotFoundError, NotADirectoryError) as error:
        if file.suffix == ".toml" or len(file.parts) > 1:
            raise ScenarioError(f"{wanted}: there is no such file") from error
        raise ScenarioError(unknown_name("scenario", wanted, names)) from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{source}: UTF-8 text was expected; byte {error.start} is not") from error
    except OSError as error:
        raise ScenarioError(f"{source}: can't be read: {error.strerror or error}") from error
    return parse(text, source, overrides, file.parent)


def parse(
    text: str,
    source: str = "<text>",
    overrides: Mapping[str, object] | None = None,
    folder: FilePath | None = None,
) -> Scenario:
    """A scenario from TOML text. Raises ScenarioError whose message has one line per problem: source, line, field, what
    was got, what was expected.

    folder: where `floor.map` is looked for; without one no other file is read.
    """
    if len(text) > MAX_BYTES:
        raise ScenarioError(f"{source}: a scenario has at most {MAX_BYTES:,} bytes, got {len(text):,}")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(_malformed(source, str(error), text)) from error
    except (ValueError, RecursionError) as error:
        why = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise ScenarioError(f"{source}: malformed TOML: {why}") from error
    where = _Where(source, toml_text.lines_of(text), text)
    for key, value in (overrides or {}).items():
        _override(data, key, value, where)
    if folder is not None:
        _read_map(data, where, folder)
    return _validate(data, where)


def _read_map(data: dict[str, Any], where: _Where, folder: FilePath) -> None:
    """Put the rows of `floor.map` into `floor.rows`, so that the scenario is whole by itself."""
    floor = data.get("floor")
    if not isinstance(floor, dict) or not isinstance(name := floor.get("map"), str):
        return
    if floor.get("kind") == "terrain":
        _read_heights(floor, name, where, folder)
        return
    if floor.get("kind") != "movingai":
        return
    if "rows" in floor:
        raise _all([Problem(("floor", "map"), "a floor has either `map` or `rows`, not both")], where)
    if FilePath(name).is_absolute() or ".." in FilePath(name).parts or not name.endswith(".map"):
        text = f"got {name!r}, expected a .map file in the folder of the scenario"
        raise _all([Problem(("floor", "map"), text)], where)
    from engine.scenario.movingai import map_rows, read_map

    try:
        floor["rows"] = "\n".join(map_rows(read_map(folder / name)))
    except FormatError as error:
        raise _all([Problem(("floor", "map"), str(error))], where) from error
    del floor["map"]


def _read_heights(floor: dict[str, Any], name: str, where: _Where, folder: FilePath) -> None:
    """Put the heights of `floor.map` into `floor.terrain.heights`, and the side of a cell where the file says it."""
    from engine.world.height_files import ENDINGS, packed, read_heights

    table = floor.setdefault("terrain", {})
    if not isinstance(table, dict):
        return  # validation says so
    if "heights" in table:
        raise _all([Problem(("floor", "map"), "a floor has either `map` or `terrain.heights`, not both")], where)
    if FilePath(name).is_absolute() or ".." in FilePath(name).parts or FilePath(name).suffix.lower() not in ENDINGS:
        text = f"got {name!r}, expected a file of heights ({', '.join(ENDINGS)}) in the folder of the scenario"
        raise _all([Problem(("floor", "map"), text)], where)
    given = {key: float(table[key]) for key in ("low_m", "high_m") if isinstance(table.get(key), int | float)}
    try:
        heights, cell_m = read_heights(folder / name, **{"low_m": 0.0, "high_m": 2.0, **given})
        table["heights"] = packed(heights)
    except BadInput as error:
        raise _all([Problem(("floor", "map"), str(error))], where) from error
    if cell_m is not None:
        floor.setdefault("cell_m", cell_m)
    del floor["map"]


def from_dict(data: Mapping[str, Any], source: str = "<data>") -> Scenario:
    """A scenario from nested plain values, such as those of Scenario.model_dump. Raises ScenarioError."""
    return _validate(dict(data), _Where(source, {}, ""))


@dataclass(slots=True)
class _Where:
    """Where a problem stands: source text or override."""

    source: str
    lines: dict[Path, int]
    text: str
    overrides: tuple[Path, ...] = ()

    def sentence(self, problem: Problem) -> str:
        for path in self.overrides:
            if path == problem.path[: len(path)] or (problem.path and problem.path == path[: len(problem.path)]):
                return f"--set {_dotted(path)}: {problem.text}"
        line = toml_text.nearest_line(self.lines, problem.path) or (1 if self.text else None)
        if line is not None and problem.row is not None:
            line = self._row_line(line, problem.row)
        at = f", line {line}" if line else ""
        field = _dotted(problem.path)
        return f"{self.source}{at}: {field}: {problem.text}" if field else f"{self.source}{at}: {problem.text}"

    def _row_line(self, first: int, row: int) -> int:
        """Line of the row-th non-empty row of a multi-line string that begins on line `first`."""
        rest = self.text.split("\n")[first - 1 :]
        opening = re.match(r"^[^\"']*(\"\"\"|''')", rest[0])
        if opening is None:
            return first
        seen = -1
        for offset, line in enumerate(rest):
            content = line[opening.end() :] if offset == 0 else line
            if content.strip():
                seen += 1
                if seen == row:
                    return first + offset
        return first


def _validate(data: dict[str, Any], where: _Where) -> Scenario:
    """Check fields, then what they say together. Raises ScenarioError."""
    from pydantic import ValidationError

    try:
        scenario = Scenario.model_validate(_tuples(data))
    except ValidationError as error:
        raise _all(list(_problems(error, data)), where) from error
    found = problems_of(scenario)
    if found:
        raise _all(found, where)
    return scenario


def _all(problems: list[Problem], where: _Where) -> ScenarioError:
    sentences = [where.sentence(p) for p in problems]
    return ScenarioError("\n".join(dict.fromkeys(sentences)))


def _override(data: dict[str, Any], key: str, value: object, where: _Where) -> None:
    """Set a dotted key in nested tables; None takes it out."""
    parts = tuple(key.strip().split("."))
    if not all(parts):
        raise ScenarioError(f"--set {key}: a dotted key was expected, such as fleet.count")
    where.overrides = (*where.overrides, parts)
    table: dict[str, Any] = data
    for depth, part in enumerate(parts[:-1], start=1):
        inner = table.setdefault(part, {})
        if not isinstance(inner, dict):
            raise ScenarioError(f"--set {key}: {'.'.join(parts[:depth])} is a value, not a table")
        table = inner
    if isinstance(value, str):
        value = _value(value)
    if value is None:
        if _fields(parts[:-1]) is not None and parts[-1] not in (_fields(parts[:-1]) or {}):
            table[parts[-1]] = "none"  # unknown: let validation say so
        else:
            table.pop(parts[-1], None)
    else:
        table[parts[-1]] = value


def _value(text: str) -> object:
    """A TOML value when the text is one, None for `none`, else the text itself."""
    if text.strip() == "none":
        return None
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if len(found) == 1 else text


def _tuples(value: Any) -> Any:
    """Lists as tuples, which strict frozen models ask for."""
    if isinstance(value, dict):
        return {k: _tuples(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_tuples(v) for v in value)
    return value


def _problems(error: Any, data: dict[str, Any]) -> Iterable[Problem]:
    """One problem per field of a pydantic ValidationError; alternatives of a union joined by 'or'."""
    grouped: dict[Path, list[dict[str, Any]]] = {}
    for item in error.errors(include_url=False):
        grouped.setdefault(_real_path(item["loc"], data, item["type"] == "missing"), []).append(item)
    misspelt = {p: _unknown_key(p) for p, items in grouped.items() if items[0]["type"] == "extra_forbidden"}
    for path, items in grouped.items():
        if any(len(other) > len(path) and other[: len(path)] == path for other in grouped):
            continue  # the deeper problem says it better
        first = items[0]
        if first["type"] == "missing" and any(
            p[:-1] == path[:-1] and text.endswith(f"did you mean {path[-1]!r}?") for p, text in misspelt.items()
        ):
            continue  # the misspelt key is the missing one
        if path in misspelt:
            yield Problem(path, misspelt[path])
        elif first["type"] == "missing":
            text = "this element is missing" if isinstance(path[-1], int) else "this key is missing and has no default"
            yield Problem(path, text)
        else:
            wanted = " or ".join(dict.fromkeys(_expected(i) for i in items))
            near = "".join(_near_literal(i) for i in items if i["type"] == "literal_error")
            yield Problem(path, f"got {_shown(_at(data, path))}, expected {wanted}{near}")


def _real_path(loc: tuple[str | int, ...], data: Any, missing: bool) -> Path:
    """The part of a pydantic location that stands in the data: names of union members drop out."""
    out: Path = ()
    for i, part in enumerate(loc):
        in_table = isinstance(data, dict) and part in data
        in_list = isinstance(data, list | tuple) and isinstance(part, int) and part < len(data)
        if in_table or in_list:
            data = data[part]
        elif not (missing and i == len(loc) - 1):
            continue
        out = (*out, part)
    return out


def _at(data: Any, path: Path) -> Any:
    for part in path:
        data = data[part]
    return data


def _shown(value: Any) -> str:
    """A value as a person wrote it, cut when long."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _expected(item: dict[str, Any]) -> str:
    """What a field wanted, in words."""
    kind, ctx = item["type"], item.get("ctx", {})
    match kind:
        case "int_type" | "int_from_float" | "int_parsing" | "int_parsing_size":
            return "a whole number"
        case "float_type" | "float_parsing":
            return "a number"
        case "finite_number":
            return "a finite number"
        case "string_type":
            return "text"
        case "bool_type":
            return "true or false"
        case "tuple_type":
            return "a list"
        case "dict_type" | "model_type" | "model_attributes_type":
            return "a table"
        case "literal_error":
            return str(ctx["expected"])
        case "greater_than":
            return f"more than {ctx['gt']:g}"
        case "greater_than_equal":
            return f"at least {ctx['ge']:g}"
        case "less_than":
            return f"less than {ctx['lt']:g}"
        case "less_than_equal":
            return f"at most {ctx['le']:g}"
        case "too_long":
            return f"at most {ctx['max_length']} elements"
        case "too_short":
            return f"at least {ctx['min_length']} elements"
        case "string_too_short":
            return f"at least {ctx['min_length']} characters"
        case "string_too_long":
            return f"at most {ctx['max_length']} characters"
        case "string_pattern_mismatch":
            return f"text like {ctx['pattern']}"
        case _:
            return str(item["msg"])


def _near_literal(item: dict[str, Any]) -> str:
    near = nearest_name(str(item["input"]), re.findall(r"'([^']*)'", item["ctx"]["expected"]))
    return near if "did you mean" in near else ""


def _unknown_key(path: Path) -> str:
    """Sentence for a key that no section knows, with the nearest one or the section where it belongs."""
    key = str(path[-1])
    known = _fields(path[:-1]) or {}
    near = nearest_name(key, known)
    if "did you mean" not in near:
        homes = [s for s in Scenario.model_fields if key in (_fields((s,)) or {})]
        if homes:
            near = f"; it belongs to [{homes[0]}]"
    return f"unknown key {key!r}{near}"


def _fields(path: Path) -> dict[str, Any] | None:
    """Keys of the section at a path, or None when there is no such section."""
    section: type[Section] = Scenario
    for part in path:
        if isinstance(part, int):
            continue
        info = section.model_fields.get(str(part))
        inner = section_of(info.annotation) if info else None
        if inner is None:
            return None
        section = inner
    return {(f.serialization_alias or name): f for name, f in section.model_fields.items()}


def section_of(annotation: Any) -> type[Section] | None:
    """The Section inside an annotation such as `BlocksSection | None`, or None."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        if (found := section_of(inner)) is not None:
            return found
    return None


def _dotted(path: Path) -> str:
    """`orders.pairs, item 3` for ('orders', 'pairs', 2)."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f", item {part + 1}"
        else:
            text += f".{part}" if text else part
    return text


def _malformed(source: str, message: str, text: str) -> str:
    message = message[:1].lower() + message[1:]
    match = _AT.match(message)
    if match is None:
        return f"{source}: malformed TOML: {message}"
    if match["end"]:
        return f"{source}, line {text.count(chr(10)) + 1}: malformed TOML: {match['what']} at the end of the text"
    return f"{source}, line {match['line']}, column {match['column']}: malformed TOML: {match['what']}"
