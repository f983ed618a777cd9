"""The settable keys of a scenario, for forms and help."""

from __future__ import annotations

from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from engine.errors import InvariantBroken
from engine.scenario.model import Scenario, Section
from engine.scenario.reading import section_of


def parameters(scenario: Scenario | None = None) -> list[dict[str, Any]]:
    """Settable dotted keys in the order of the file: plain JSON values.

    Each has key, type ("integer", "number", "text", "choice", "list", "table"), default, value (the scenario's, else
    the default), description, choices (of a choice) and minimum, maximum where there are any. Default None means that
    the key is either required or may be left out; required says which. Sections that the scenario does without, such
    as floor.blocks of a drawn floor, are left out.
    """
    return list(_walk(Scenario, "", scenario))


def _walk(section: type[Section], prefix: str, values: Section | None) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for name, field in section.model_fields.items():
        value = getattr(values, name) if values is not None else None
        inner = section_of(field.annotation)
        if inner is not None and not _is_list(field):
            if values is None or value is not None:
                rows += _walk(inner, f"{prefix}{name}.", value)
            continue
        default = field.get_default(call_default_factory=True)
        required = default is PydanticUndefined
        default = None if required else _plain(default)
        rows.append(
            {
                "key": f"{prefix}{name}",
                "type": _type(field),
                "default": default,
                "value": _plain(value) if values is not None else default,
                "required": required,
                "description": field.description or "",
                "choices": _choices(field.annotation),
                **_bounds(field),
            }
        )
    return rows


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is tuple


def _alternatives(annotation: Any) -> list[Any]:
    """Members of a union without None, or the annotation itself."""
    if get_origin(annotation) in (Union, UnionType):
        return [a for a in get_args(annotation) if a is not type(None)]
    return [annotation]


def _type(field: FieldInfo) -> str:
    for inner in _alternatives(field.annotation):
        plain = get_args(inner)[0] if get_origin(inner) is Annotated else inner
        origin = get_origin(plain)
        if origin in (tuple, dict, Literal):
            return {tuple: "list", dict: "table", Literal: "choice"}[origin]
        if plain in (int, float, str):
            return {int: "integer", float: "number", str: "text"}[plain]
    raise InvariantBroken(f"a field of type {field.annotation} has no form")


def _choices(annotation: Any) -> list[Any]:
    for inner in _alternatives(annotation):
        if get_origin(inner) is Literal:
            return list(get_args(inner))
    return []


def _bounds(field: FieldInfo) -> dict[str, float]:
    """Bounds from the field's own constraints and those of its type."""
    found: dict[str, float] = {}
    metadata = list(field.metadata)
    for inner in _alternatives(field.annotation):
        for part in getattr(inner, "__metadata__", ()):
            metadata += [part, *getattr(part, "metadata", ())]
    for constraint in metadata:
        for attribute, key in (("ge", "minimum"), ("gt", "minimum"), ("le", "maximum"), ("lt", "maximum")):
            if (limit := getattr(constraint, attribute, None)) is not None:
                found[key] = limit
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Section):
        return value.model_dump(by_alias=True, exclude_none=True, mode="json")
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return value
