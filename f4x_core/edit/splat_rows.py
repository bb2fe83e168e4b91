"""The Gaussians after an edit stack and the rows that each edit selects: everything that does not depend on time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import F4xError
from ..scene import Scene
from .operations import (
    ChangeWithShadow,
    Delete,
    Duplicate,
    Extract,
    Match,
    Name,
    Rekey,
    TakeBack,
    Transform,
    steps_of_operation,
)
from .retiming import TimeMap, copy_time_map, time_map_of
from .selects import All, And, Ids, Moving, Named, Not, Or, SelectKind
from .stack import Edit

MAX_GAUSSIANS = 10_000_000
"""Maximum number of Gaussians of an edited scene, copies included: a few gigabytes."""


@dataclass(frozen=True, eq=False)
class SplatRows:
    """The N Gaussians after some edits. Rows never disappear: a deleted Gaussian has opacity 0."""

    ids: np.ndarray
    """(N,) int64."""
    origin: np.ndarray
    """(N,) int64 row of the base scene that it is, or is a copy of."""
    carried: np.ndarray
    """(N,) bool: the scaffold moves it."""
    moves: np.ndarray
    """(N,) bool: the scaffold or an edit moves it."""
    gone: np.ndarray
    """(N,) bool: deleted at all times."""
    names: Mapping[str, np.ndarray]
    """Name -> (n,) rows."""

    @classmethod
    def of(cls, scene: Scene) -> SplatRows:
        """The rows of a scene without edits."""
        moving = np.arange(len(scene.static) + len(scene.dynamic)) >= len(scene.static)
        ids = np.concatenate([scene.static.ids, scene.dynamic.ids])
        return cls(ids, np.arange(len(ids)), moving, moving, np.zeros(len(ids), bool), {})

    def chosen(self, select: SelectKind) -> np.ndarray:
        """(N,) bool: the rows that `select` selects. Unknown ids, such as those of copies of a disabled edit, are ignored."""
        if isinstance(select, All):
            return np.ones(len(self.ids), bool)
        if isinstance(select, Moving):
            return self.carried.copy()
        if isinstance(select, Ids):
            return np.isin(self.ids, select.array)
        if isinstance(select, Named):
            if select.name not in self.names:
                known = ", ".join(self.names) or "none"
                raise F4xError(f"no selection before it is named '{select.name}' (there are: {known}); name it first.")
            return np.isin(np.arange(len(self.ids)), self.names[select.name])
        if isinstance(select, Not):
            return ~self.chosen(select.of)
        if isinstance(select, And | Or):
            parts = [self.chosen(part) for part in select.of]
            if not parts:
                raise F4xError(f"'{select.TAG}' combines nothing; give at least one selection.")
            return (np.logical_and if isinstance(select, And) else np.logical_or).reduce(parts)
        raise F4xError(f"a selection by {select.TAG} is not settled yet; plan the edit, which looks up whom it means.")


@dataclass(frozen=True, eq=False)
class Step:
    """One edit that is in effect, with everything about it that does not depend on time."""

    edit: Edit
    before: SplatRows
    """The Gaussians before the edit."""
    chosen: np.ndarray
    """(N,) bool over `before`: the rows it changes."""
    source: np.ndarray | None = None
    """(N,) bool over `before`: the rows whose colours `match` takes."""
    along: np.ndarray | None = None
    """(N,) bool over `before`: those of the rows it changes that only go along, such as a shadow."""
    time_map: TimeMap | None = None
    """The time map of a retiming edit."""
    copied: np.ndarray | None = None
    """(n,) rows of `before` that `duplicate` copies, in the order of their ids."""
    copy_time_maps: tuple[TimeMap, ...] = ()
    """The time map of each copy."""

    @property
    def thing(self) -> np.ndarray:
        """(N,) bool over `before`: the rows it changes without those that only go along."""
        return self.chosen if self.along is None else self.chosen & ~self.along

    @property
    def reads(self) -> bool:
        """Whether it reads rows other than its own, or other times."""
        return self.time_map is not None or self.copied is not None

    @property
    def retimes(self) -> bool:
        """True if it shows other times than the clip's."""
        operation = self.edit.operation
        return self.time_map is not None or (isinstance(operation, Duplicate) and operation.time_shift != 0)

    def read(self, time: float, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For its own `rows (n,)` at `time`: (time (n,), row of `before` (n,), number of the copy (n,), 0 = none)."""
        when, copy = np.full(len(rows), float(time)), np.zeros(len(rows), int)
        if self.time_map is not None:
            when[self.chosen[rows]] = self.time_map(time)
        if self.copied is None:
            return when, rows, copy
        added = rows - len(self.before.ids)
        is_copy = added >= 0
        copy[is_copy] = added[is_copy] // len(self.copied) + 1
        for number in np.unique(copy[is_copy]):
            when[copy == number] = self.copy_time_maps[number - 1](time)
        return when, np.where(is_copy, self.copied[added % len(self.copied)], rows), copy


def steps_of(scene: Scene, edits: tuple[Edit, ...]) -> tuple[tuple[Step, ...], SplatRows]:
    """The edits that have an effect, in order, and the Gaussians after them. Raises F4xError that names the edit."""
    rows, clip = SplatRows.of(scene), (float(scene.cameras.times[0]), float(scene.cameras.times[-1]))
    steps = []
    for number, edit in enumerate(edits, 1):
        try:
            for operation in steps_of_operation(edit.operation):
                step, rows = _step(
                    edit if operation is edit.operation else replace(edit, operation=operation), rows, clip
                )
                if step is not None:
                    steps.append(step)
        except F4xError as error:
            raise F4xError(f"{scene.name}: {edit.titled(number)}: {error}") from error
    return tuple(steps), rows


def _step(edit: Edit, rows: SplatRows, clip: tuple[float, float]) -> tuple[Step | None, SplatRows]:
    operation = edit.operation
    if isinstance(
        operation, Rekey | TakeBack
    ):  # changes the motion that all steps read; has switched off an earlier edit
        return None, rows
    if isinstance(operation, Name):  # what was named once stays named, or edits after it would mean nobody
        return None, _named(rows, operation.name, np.flatnonzero(rows.chosen(operation.select)))
    if not edit.enabled:
        if isinstance(operation, Duplicate) and operation.name and operation.name not in rows.names:
            rows = _named(rows, operation.name, np.zeros(0, int))
        return None, rows
    chosen = rows.chosen(operation.select)
    if isinstance(operation, Extract):
        chosen = ~chosen
    source = rows.chosen(operation.source) if isinstance(operation, Match) else None
    if not chosen.any() or (source is not None and not source.any()):
        return None, _copied(operation, rows, np.zeros(0, int)) if isinstance(operation, Duplicate) else rows
    along = None
    if isinstance(operation, ChangeWithShadow) and operation.along is not None:
        along = rows.chosen(operation.along) & ~chosen
        chosen = chosen | along
    step = Step(edit, rows, chosen, source, along, time_map_of(operation, clip))
    if isinstance(operation, Delete | Extract) and operation.frames is None:
        return step, replace(rows, gone=rows.gone | chosen)
    if isinstance(operation, Transform):
        _require_world(operation)
        still = operation.frames is None and (
            operation.pivot not in ("centroid", "base") or not rows.moves[chosen].any() or _is_shift(operation)
        )
        return step, rows if still else replace(rows, moves=rows.moves | chosen)
    if isinstance(operation, Duplicate):
        _require_world(operation)
        picked = np.flatnonzero(chosen)
        picked = picked[np.argsort(rows.ids[picked])]
        copy_time_maps = tuple(copy_time_map(operation, copy, clip) for copy in range(1, operation.count + 1))
        return replace(step, copied=picked, copy_time_maps=copy_time_maps), _copied(operation, rows, picked)
    return step, rows


def _is_shift(operation: Transform) -> bool:
    return operation.scale == 1 and not any(operation.rotate)


def _require_world(operation: Transform | Duplicate) -> None:
    if (operation.unit, operation.axes) != ("world", "world"):
        raise F4xError("its distances are not in world units along world axes yet; plan the edit, which settles them.")


def _named(rows: SplatRows, name: str, chosen: np.ndarray) -> SplatRows:
    return replace(rows, names={**rows.names, name: chosen})


def _copied(operation: Duplicate, rows: SplatRows, picked: np.ndarray) -> SplatRows:
    """`rows` with `count` copies of the rows `picked` after them."""
    total = len(rows.ids) + len(picked) * operation.count
    if total > MAX_GAUSSIANS:
        raise F4xError(f"the scene would come to {total:,} Gaussians; {MAX_GAUSSIANS:,} are the most, so copy less.")
    ids = operation.first_id + np.arange(len(picked) * operation.count)
    if len(ids) and (operation.first_id < 0 or np.isin(ids, rows.ids).any()):
        raise F4xError("ids of its copies are taken or missing; plan the edit, which reserves its first_id.")
    again = np.concatenate([np.arange(len(rows.ids)), np.tile(picked, operation.count)])
    many = SplatRows(
        np.append(rows.ids, ids),
        rows.origin[again],
        rows.carried[again],
        rows.moves[again],
        rows.gone[again],
        rows.names,
    )
    return _named(many, operation.name, np.arange(len(rows.ids), total)) if operation.name else many
