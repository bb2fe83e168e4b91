"""Frozen dataclasses as JSON objects and back, strictly: an unknown key, a missing one or a wrong kind is one sentence.

A family of dataclasses shares a tag, for example `op`: its value is the class's `TAG`, and says which class a record is. Own
code and no library, because Blender 4.5 brings numpy alone, and because people write these records by hand.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from difflib import get_close_matches
from functools import cache
from typing import Any, Literal, Self, Union, get_args, get_origin, get_type_hints

from ..errors import F4xError

_MAX_PLACE_LENGTH = 100
"""Letters of the place of what lies too deep."""
MAX_DEPTH = 32
"""Levels of records inside records that are read: no person needs more, and a hostile file could ask for thousands."""


MAX_WHOLE = (1 << 63) - 1
"""Limits of numpy's integers; JSON may have thousands of digits."""


class Record:
    """Base of a dataclass that travels as JSON; `KEY` names the tag's key and `TAG` its value where it has one."""

    KEY = ""
    TAG = ""

    def to_json(self) -> dict[str, Any]:
        """Return plain values for `json.dumps`: the tag, then every field that differs from its default or has none."""
        values = {self.KEY: self.TAG} if self.KEY else {}
        for entry in fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass
            value = getattr(self, entry.name)
            if entry.default is MISSING or value != entry.default:
                values[entry.name] = _plain(value)
        return values

    def altered(self, **changed: Any) -> Self:
        """Return the record with other values in some fields."""
        return replace(self, **changed)  # type: ignore[type-var]  # every subclass is a dataclass


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return `value`, a record or a part of one, with each part for which `change` returns something replaced by that."""
    found = change(value)
    if found is not None:
        return found
    if isinstance(value, tuple):
        return tuple(mapped(part, change) for part in value)
    if isinstance(value, Record):
        return value.altered(**{entry.name: mapped(getattr(value, entry.name), change) for entry in fields(value)})  # type: ignore[arg-type]
    return value


def read_record(family: Any, data: Any, where: str, depth: int = 0) -> Any:
    """Return the dataclass (or member of a union of tagged dataclasses) `family` that the JSON object `data` describes.

    `where` begins every sentence, for example "edit 3". Raises F4xError.
    """
    if depth > MAX_DEPTH:
        raise F4xError(
            f"{where[:_MAX_PLACE_LENGTH]} …: more than {MAX_DEPTH} records inside one another; write it flatter."
        )
    if not isinstance(data, Mapping):
        raise F4xError(f"{where}: {_short(data)} is no JSON object; write {{...}}.")
    members = {kind.TAG: kind for kind in get_args(family)} if get_args(family) else {}
    if members:
        key = next(iter(members.values())).KEY
        tag = data.get(key)
        if not isinstance(tag, str) or tag not in members:
            reason = f"'{key}' is missing" if tag is None else f"{_short(tag)} is no {key}{near(tag, members)}"
            raise F4xError(f"{where}: {reason}; known: {', '.join(members)}.")
        kind, data = members[tag], {name: value for name, value in data.items() if name != key}
        where = f"{where} ({tag})"
    else:
        kind = family
    known, hints = {entry.name: entry for entry in fields(kind)}, _hints(kind)
    for name in data:
        if name not in known:
            raise F4xError(f"{where}: '{name}' is unknown{near(name, known)}; known: {', '.join(known) or 'nothing'}.")
    for name, entry in known.items():
        if entry.default is MISSING and name not in data:
            raise F4xError(f"{where}: '{name}' is missing; add it.")
    values = {name: _value(hints[name], value, f"{where}, {name}", depth) for name, value in data.items()}
    try:
        return kind(**values)
    except F4xError as error:
        raise F4xError(f"{where}: {error}") from error


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _plain(value: Any) -> Any:
    if isinstance(value, Record):
        return value.to_json()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _value(hint: Any, value: Any, where: str, depth: int) -> Any:
    """Return `value` as the type `hint`: bool, int, float, str, Literal, tuple, `X | None`, or a record."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        if value not in parts:
            raise F4xError(f"{where} is {_short(value)}{near(value, parts)}; use {', '.join(map(str, parts))}.")
        return value
    if origin in (Union, types.UnionType) and not all(_is_record(part) for part in parts):
        if value is None and type(None) in parts:
            return None
        others = [part for part in parts if part is not type(None)]
        if not any(_is_record(part) for part in others):
            return _first(others, value, where, depth)
        return read_record(Union[tuple(others)], value, where, depth + 1)  # noqa: UP007  # built from values
    if origin is tuple:
        return _tuple(parts, value, where, depth)
    if origin in (Union, types.UnionType) or _is_record(hint):
        return read_record(hint, value, where, depth + 1)
    if type(value) is int and abs(value) > MAX_WHOLE:
        raise F4xError(f"{where} is {_short(value)}; write a number of 64 bits.")
    if hint is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if hint in (bool, int, str) and type(value) is hint:
        return value
    raise F4xError(f"{where} is {_short(value)}; write {_name(hint)}.")


def _tuple(parts: tuple[Any, ...], value: Any, where: str, depth: int) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise F4xError(f"{where} is {_short(value)}; write a list.")
    if parts[-1] is Ellipsis:
        return tuple(_value(parts[0], item, where, depth) for item in value)
    if len(value) != len(parts):
        raise F4xError(f"{where} has {len(value)} entries; write {len(parts)}.")
    return tuple(_value(part, item, where, depth) for part, item in zip(parts, value, strict=True))


def _first(hints: list[Any], value: Any, where: str, depth: int) -> Any:
    """Return the value by the first hint that accepts it; raises the last one's complaint where none does."""
    for hint in hints[:-1]:
        try:
            return _value(hint, value, where, depth)
        except F4xError:
            continue
    return _value(hints[-1], value, where, depth)


def _is_record(hint: Any) -> bool:
    if get_origin(hint) in (Union, types.UnionType):
        return all(_is_record(part) for part in get_args(hint))
    return isinstance(hint, type) and is_dataclass(hint)


def _name(hint: Any) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number", str: "text"}.get(hint, str(hint))


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def near(name: Any, known: Any) -> str:
    """Return ", near it is 'x'" where one of `known` is spelt like `name`, else nothing."""
    near = get_close_matches(str(name), [str(item) for item in known], 1, 0.6)
    return f", near it is '{near[0]}'" if near else ""
