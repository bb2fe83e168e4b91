"""Two stacks of one scene made one, copies included: both sides may have reserved the same ids for the copies that they made."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from ..scene import Scene
from .apply import edited, next_id
from .records import Record
from .selects import Ids
from .stack import EditStack, merge, with_stack


def merge_edits(scene: Scene, base: EditStack, ours: EditStack, theirs: EditStack) -> EditStack:
    """`merge` for the stacks of `scene`: copies that `theirs` made since `base` get ids behind those of `ours`.

    Selections in new edits of `theirs` follow. Raises F4xError where both changed one edit, or where the result does not apply.
    """
    known = {edit.id for edit in base.edits}
    shared = [edit for edit in theirs.edits if edit.id in known or edit in ours.edits]
    start = next_id(with_stack(scene, EditStack(tuple(shared))))
    further = next_id(with_stack(scene, ours)) - start
    moved = (
        edit if edit in shared else replace(edit, operation=_with_later_ids(edit.operation, start, further))
        for edit in theirs.edits
    )
    merged = merge(base, ours, EditStack(tuple(moved)) if further > 0 else theirs)
    edited(with_stack(scene, merged))
    return merged


def _with_later_ids(value: Any, start: int, further: int) -> Any:
    """An operation or a part of one, in which every Gaussian id from `start` on is larger by `further`."""
    if isinstance(value, Ids):
        ids = value.array
        return replace(Ids.of(ids + further * (ids >= start)), words=value.words)
    if isinstance(value, tuple):
        return tuple(_with_later_ids(part, start, further) for part in value)
    if not isinstance(value, Record):
        return value
    inner = {entry.name: _with_later_ids(getattr(value, entry.name), start, further) for entry in fields(value)}  # type: ignore[arg-type]
    if getattr(value, "first_id", -1) >= start:
        inner["first_id"] += further
    return replace(value, **inner)  # type: ignore[type-var]  # every record is a dataclass
