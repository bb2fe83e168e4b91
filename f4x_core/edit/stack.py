"""The edit stack: an ordered list of operations beside the untouched base arrays, and what was undone last.

A stack is a value: every change gives a new one and has an exact inverse. In the file the edits are the list `edits` of
scene.json, and what `redo` would bring back is the list `undone`, which is left out when it is empty: a scene whose edits
are all undone and whose `undone` is dropped is byte for byte the scene before them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import F4xError
from ..scene import Scene, read_header, updating, write_edits
from .change import Change
from .operations import read_operation

UNDONE = "undone"
"""The field of scene.json with the undone edits, the one undone last at the end."""
MAX_EDITS = 200
"""Edits of one stack: each may read the one before it, so that they nest as deep as there are edits."""
MAX_SENTENCE_LENGTH = 2000
"""Characters kept of a person's sentence."""


@dataclass(frozen=True)
class Edit:
    """An operation in a stack."""

    operation: Change
    """The operation; its selections are ids, names, `all` or `moving`."""
    id: int
    """Unique in the stack, its undone edits included."""
    enabled: bool = True
    """False: skipped, but kept."""
    sentence: str = ""
    """The words it was made from."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.id < 1:
            raise F4xError(f"id is {self.id}; number edits from 1.")
        if len(self.sentence) > MAX_SENTENCE_LENGTH:
            raise F4xError(f"said has {len(self.sentence)} letters; keep at most {MAX_SENTENCE_LENGTH}.")

    @property
    def in_effect(self) -> bool:
        """True if it changes the scene: neither switched off nor there to switch another one off."""
        return self.enabled and not self.operation.taken_back

    def titled(self, number: int) -> str:
        """Return its name in messages as the edit `number` (from 1) of its stack: "edit 3 (recolour)"."""
        return f"edit {number} ({self.operation.TAG})"

    def to_json(self) -> dict[str, Any]:
        """Return the operation's JSON with `id`, and `enabled` and `said` (the sentence) where they differ from the default."""
        more: dict[str, Any] = {} if self.enabled else {"enabled": False}
        return {**self.operation.to_json(), "id": self.id, **more, **({"said": self.sentence} if self.sentence else {})}

    @classmethod
    def from_json(cls, data: object, where: str) -> Edit:
        """Read the JSON of `to_json`; F4xError begins with `where`."""
        if not isinstance(data, Mapping):
            raise F4xError(f"{where}: it is no JSON object; write {{...}}.")
        rest = dict(data)
        id, enabled, sentence = rest.pop("id", None), rest.pop("enabled", True), rest.pop("said", "")
        if type(id) is not int or type(enabled) is not bool or type(sentence) is not str:
            raise F4xError(f"{where}: it needs a whole number id; enabled is true or false and said is text.")
        operation = read_operation(rest, where)
        try:
            return cls(operation, id, enabled, sentence)
        except F4xError as error:
            raise F4xError(f"{where}: {error}") from error


@dataclass(frozen=True)
class EditStack:
    """Edits in the order in which they act, and what was undone."""

    edits: tuple[Edit, ...] = ()
    """First to last."""
    undone: tuple[Edit, ...] = ()
    """Edits that `redo` brings back, the next one last. Cleared when something new is appended."""

    def __post_init__(self) -> None:
        """Refuse too many edits, and ids that occur twice."""
        for name, edits in (("edits", self.edits), ("undone edits", self.undone)):
            if len(edits) > MAX_EDITS:
                raise F4xError(f"there are {len(edits)} {name}; {MAX_EDITS} are the most, so `f4x bake` them first.")
        counts = Counter(edit.id for edit in (*self.edits, *self.undone))
        twice = next((id for id, count in counts.items() if count > 1), None)
        if twice is not None:
            raise F4xError(f"the edit id {twice} occurs twice; give every edit its own.")

    def __len__(self) -> int:
        return len(self.edits)

    @property
    def in_effect(self) -> tuple[Edit, ...]:
        """The edits that change the scene, first to last."""
        return tuple(edit for edit in self.edits if edit.in_effect)

    @classmethod
    def from_json(cls, edits: Sequence[object], where: str) -> EditStack:
        """Read the JSON of `to_json`, with nothing to redo; F4xError begins with `where`."""
        return _read(edits, (), where)

    def position(self, id: int) -> int:
        """Index of the edit `id` in `edits`; F4xError where there is none."""
        for index, edit in enumerate(self.edits):
            if edit.id == id:
                return index
        raise F4xError(f"there is no edit {id}; the stack has {', '.join(str(e.id) for e in self.edits) or 'none'}.")

    def append(self, operation: Change, sentence: str = "") -> EditStack:
        """Return the stack with one more edit, after which there is nothing to redo. Its inverse: `undo`."""
        id = 1 + max((edit.id for edit in (*self.edits, *self.undone)), default=0)
        for earlier in operation.taken_back:
            if not self.edits[self.position(earlier)].enabled:
                raise F4xError(f"the edit {earlier} is switched off already.")
        edit = Edit(operation, id, sentence=sentence[:MAX_SENTENCE_LENGTH])
        return EditStack((*self.edits, edit))._taken_back(edit)

    def undo(self) -> EditStack:
        """Return the stack without the last edit, which `redo` brings back; F4xError where there is none."""
        if not self.edits:
            raise F4xError("there is nothing to undo.")
        return EditStack(self.edits[:-1], (*self.undone, self.edits[-1]))._taken_back(self.edits[-1], False)

    def redo(self) -> EditStack:
        """Return the stack with the edit that was undone last; F4xError where there is none."""
        if not self.undone:
            raise F4xError("there is nothing to redo.")
        return EditStack((*self.edits, self.undone[-1]), self.undone[:-1])._taken_back(self.undone[-1])

    def enable(self, id: int, on: bool) -> EditStack:
        """Return the stack with the edit `id` switched on or off."""
        edit = replace(self.edits[self.position(id)], enabled=on)
        return self._with(edit)._taken_back(edit)

    def replace(self, id: int, operation: Change) -> EditStack:
        """Return the stack with another operation in the place of edit `id`. Its inverse: `replace` by the old one."""
        return self._with(replace(self.edits[self.position(id)], operation=operation))

    def remove(self, id: int) -> EditStack:
        """Return the stack without the edit `id`. Its inverse: `insert`."""
        at = self.position(id)
        return replace(self, edits=self.edits[:at] + self.edits[at + 1 :])._taken_back(self.edits[at], False)

    def insert(self, edit: Edit, at: int) -> EditStack:
        """Return the stack with `edit` at the index `at` (0 = first)."""
        if not 0 <= at <= len(self.edits):
            raise F4xError(f"{at} is no place in a stack of {len(self.edits)}; give 0 to {len(self.edits)}.")
        return replace(self, edits=(*self.edits[:at], edit, *self.edits[at:]))._taken_back(edit)

    def move(self, id: int, to: int) -> EditStack:
        """Return the stack with the edit `id` at the index `to`. Its inverse: `move` back to its old index."""
        edit = self.edits[self.position(id)]
        return self.remove(id).insert(edit, to)

    def _taken_back(self, edit: Edit, back: bool = True) -> EditStack:
        """Return the stack with the edits that `edit` takes back switched off, or on again where `back` is False."""
        off, ids = back and edit.enabled, edit.operation.taken_back
        return replace(self, edits=tuple(replace(one, enabled=not off) if one.id in ids else one for one in self.edits))

    def _with(self, edit: Edit) -> EditStack:
        at = self.position(edit.id)
        return replace(self, edits=(*self.edits[:at], edit, *self.edits[at + 1 :]))

    def to_json(self) -> list[dict[str, Any]]:
        """Return the list `edits` of scene.json."""
        return [edit.to_json() for edit in self.edits]


def merge(base: EditStack, ours: EditStack, theirs: EditStack) -> EditStack:
    """Return `ours` with everything that `theirs` changed since `base`; F4xError names an edit that both changed differently.

    New edits of theirs follow ours and get new ids where ours has taken theirs. Where both only reordered, ours holds. What
    was undone is forgotten.
    """
    was, mine, other = ({edit.id: edit for edit in stack.edits} for stack in (base, ours, theirs))
    merged = EditStack(ours.edits)
    for id, old in was.items():
        a, b = mine.get(id), other.get(id)
        if b == old or a == b:
            continue
        if a != old:
            reason = "one side removed it, the other changed it" if a is None or b is None else "both changed it"
            raise F4xError(f"{old.titled(base.position(id) + 1)}: {reason}, each in its own way; choose one of them.")
        merged = merged.remove(id) if b is None else merged._with(b)
    if [edit.id for edit in ours.edits if edit.id in was] == [edit.id for edit in base.edits if edit.id in mine]:
        order = {id: place for place, id in enumerate(other)}
        kept = iter(sorted((e for e in merged.edits if e.id in was), key=lambda edit: order[edit.id]))
        merged = EditStack(tuple(next(kept) if edit.id in was else edit for edit in merged.edits))
    renamed: dict[int, int] = {}
    for edit in theirs.edits:
        if edit.id not in was and edit not in ours.edits:
            if not renamed.keys().isdisjoint(edit.operation.taken_back):
                first, *others = (renamed.get(earlier, earlier) for earlier in edit.operation.taken_back)
                edit = replace(edit, operation=edit.operation.altered(edit=first, others=tuple(others)))
            taken = [e.id for e in merged.edits]
            if edit.id in taken:
                renamed[edit.id] = 1 + max(taken)
            merged = merged.insert(replace(edit, id=renamed.get(edit.id, edit.id)), len(merged))
    return merged


def of(scene: Scene) -> EditStack:
    """Return the stack of a scene; F4xError names what cannot be read."""
    return _read(scene.edits, scene.extra_fields.get(UNDONE, []), scene.name)


def with_stack(scene: Scene, stack: EditStack) -> Scene:
    """Return the scene, its base arrays shared, with another stack."""
    fields = {name: value for name, value in scene.extra_fields.items() if name != UNDONE}
    return replace(scene, edits=tuple(stack.to_json()), extra_fields={**fields, **_undone(stack)})


def read_stack(path: Path | str) -> EditStack:
    """Return the stack in a scene file, without reading its arrays."""
    header = read_header(path)
    return _read(header["edits"], header.get(UNDONE, []), str(path))


def write_stack(path: Path | str, stack: EditStack) -> None:
    """Put `stack` into a scene file, atomically; nothing else in it changes. Hold `updating` from reading it to here."""
    write_edits(path, stack.to_json(), fields={UNDONE: None, **_undone(stack)})


def undo(path: Path | str, count: int = 1) -> EditStack:
    """Take the last `count` edits of a scene file back, or all where there are fewer, atomically; F4xError where there is none."""
    return _stepped(path, EditStack.undo, lambda stack: len(stack), count)


def redo(path: Path | str, count: int = 1) -> EditStack:
    """Bring back the `count` edits undone last, or all where there are fewer, atomically; F4xError where there is none."""
    return _stepped(path, EditStack.redo, lambda stack: len(stack.undone), count)


def _stepped(
    path: Path | str, step: Callable[[EditStack], EditStack], max_steps: Callable[[EditStack], int], count: int
) -> EditStack:
    if count < 1:
        raise F4xError(f"{path}: {count} steps are asked for; give 1 or more.")
    with updating(path):
        stack = read_stack(path)
        try:
            for _ in range(min(count, max(max_steps(stack), 1))):
                stack = step(stack)
        except F4xError as error:
            raise F4xError(f"{path}: {error}") from error
        write_stack(path, stack)
    return stack


def _undone(stack: EditStack) -> dict[str, Any]:
    return {UNDONE: [edit.to_json() for edit in stack.undone]} if stack.undone else {}


def _read(edits: Sequence[object], undone: object, where: str) -> EditStack:
    if not isinstance(undone, list | tuple):
        raise F4xError(f"{where}: '{UNDONE}' is no list; take it out of scene.json.")
    lists = [
        tuple(Edit.from_json(data, f"{where}: {title} {number}") for number, data in enumerate(entries, 1))
        for title, entries in (("edit", edits), ("undone edit", undone))
    ]
    try:
        return EditStack(*lists)
    except F4xError as error:
        raise F4xError(f"{where}: {error}") from error
