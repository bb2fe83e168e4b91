"""The Gaussians after an edit stack and the rows that each edit selects: everything that does not depend on time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import F4xError
from ..scene import Scene
from .change import TimeMap
from .selects import All, And, Ids, Moving, Named, Not, Or, SelectKind

if TYPE_CHECKING:
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
        """Return the rows of a scene without edits."""
        moving = np.arange(len(scene.static) + len(scene.dynamic)) >= len(scene.static)
        ids = np.concatenate([scene.static.ids, scene.dynamic.ids])
        return cls(ids, np.arange(len(ids)), moving, moving, np.zeros(len(ids), bool), {})

    def by_id(self, chosen: np.ndarray) -> np.ndarray:
        """Return the rows `chosen (N,) bool` as indices (n,) in the order of their ids."""
        picked = np.flatnonzero(chosen)
        return picked[np.argsort(self.ids[picked])]

    def chosen(self, select: SelectKind) -> np.ndarray:
        """Return the rows (N,) bool that `select` selects; unknown ids, such as those of copies of a disabled edit, are ignored."""
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
        """Return True if it reads rows other than its own, or other times."""
        return self.time_map is not None or self.copied is not None

    @property
    def retimes(self) -> bool:
        """True if it shows other times than the clip's."""
        operation = self.edit.operation
        return self.time_map is not None or operation.untimed() != operation

    @property
    def copy_ids(self) -> np.ndarray:
        """(n,) ids of the copies that it makes."""
        made = 0 if self.copied is None else len(self.copied) * len(self.copy_time_maps)
        return getattr(self.edit.operation, "first_id", 0) + np.arange(made)

    def read(self, time: float, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (time (n,), row of `before` (n,), number of the copy (n,), 0 = none) that its own `rows (n,)` show at `time`."""
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
    """Return the edits that have an effect, in order, and the Gaussians after them. F4xError names the edit."""
    rows, clip = SplatRows.of(scene), (float(scene.cameras.times[0]), float(scene.cameras.times[-1]))
    steps = []
    for number, edit in enumerate(edits, 1):
        try:
            for operation in edit.operation.steps():
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
    if not edit.enabled or not operation.ACTS:
        return None, operation.rows_without(rows)
    chosen, other = operation.chosen(rows), getattr(operation, "source", None)
    source = None if other is None else rows.chosen(other)
    along = getattr(operation, "along", None)
    only_along = rows.chosen(along) & ~chosen if along is not None and chosen.any() else None
    chosen = chosen if only_along is None else chosen | only_along
    after = operation.rows_after(rows, chosen)
    if not chosen.any() or (source is not None and not source.any()):
        return None, after
    copy_time_maps, copied = operation.copy_time_maps(clip), None
    if copy_time_maps:
        copied = rows.by_id(chosen)
    return Step(edit, rows, chosen, source, only_along, operation.time_map(clip), copied, copy_time_maps), after


def with_name(rows: SplatRows, name: str, named: np.ndarray) -> SplatRows:
    """Return `rows` with a name for the rows `named (n,)`."""
    return replace(rows, names={**rows.names, name: named})


def with_copies(rows: SplatRows, picked: np.ndarray, count: int, first_id: int, name: str = "") -> SplatRows:
    """Return `rows` followed by `count` copies of the rows `picked (n,)`, which have a name and ids from `first_id` on."""
    total = len(rows.ids) + len(picked) * count
    if total > MAX_GAUSSIANS:
        raise F4xError(f"the scene would come to {total:,} Gaussians; {MAX_GAUSSIANS:,} are the most, so copy less.")
    ids = first_id + np.arange(len(picked) * count)
    if len(ids) and (first_id < 0 or np.isin(ids, rows.ids).any()):
        raise F4xError("ids of its copies are taken or missing; plan the edit, which reserves its first_id.")
    again = np.concatenate([np.arange(len(rows.ids)), np.tile(picked, count)])
    many = SplatRows(
        np.append(rows.ids, ids),
        rows.origin[again],
        rows.carried[again],
        rows.moves[again],
        rows.gone[again],
        rows.names,
    )
    return with_name(many, name, np.arange(len(rows.ids), total)) if name else many
