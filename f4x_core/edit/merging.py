"""Two stacks of one scene made one, copies included: both sides may have reserved the same ids for the copies that they made."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..scene import Scene
from .apply import edited, next_id
from .change import Change
from .records import mapped
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


def _with_later_ids(operation: Change, start: int, further: int) -> Change:
    """Return an operation in which every Gaussian id from `start` on is larger by `further`."""

    def later(value: Any) -> Any:
        if isinstance(value, Ids):
            return Ids.of(value.array + further * (value.array >= start)).altered(words=value.words)
        return None

    moved: Change = mapped(operation, later)
    first = getattr(moved, "first_id", -1)
    return moved.altered(first_id=first + further) if first >= start else moved
