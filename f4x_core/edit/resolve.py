"""Resolves an operation for the edit stack: ids replace words and prompts, world units replace widths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import F4xError
from ..language.cast_words import caster, is_cast
from ..language.compounds import head_of, names_another
from ..language.lexicon import UNCOUNTED, plural_of, singular
from ..query.attached import attached_to
from ..query.cast import needs_no_teacher
from ..query.connected_objects import part_of, pick_object, separate_objects, split_objects, stand_to, ways_of
from ..query.inventory import instead, is_doubtful, labels_of
from ..query.knowledge import refuse_evidence_of_another, refuse_unknown
from ..query.labels import Encode, text_head, unknown_label
from ..query.not_deleted import not_deleted
from ..query.prompts import select_by_box, select_by_points, select_by_text
from ..query.score import THRESHOLD
from ..query.selection import SELECTED, Selection, fingerprint
from ..query.surroundings import NO_THING, everything_to, is_backdrop, known_things
from ..scene import Scene
from ..scene.model import PosedSplats
from ..scene.people import single_people
from .apply import EditedScene, edited, next_id, with_operations
from .change import DIRECTIONS, Change, ChangeWithShadow
from .description import whom
from .selects import (
    MAX_WORDS_LENGTH,
    All,
    And,
    Beside,
    Box,
    Current,
    Heading,
    Ids,
    Instance,
    Moving,
    Named,
    Not,
    Or,
    Part,
    Point,
    Select,
    SelectKind,
    Text,
    parts_of,
)
from .splat_rows import SplatRows
from .stack import of
from .which import asked_about, frame_of_most, which_of

__all__ = ["Absent", "EditorState", "Resolver", "chosen", "labels_of", "named", "resolve", "rows_of"]


LEFT = 0.1
"""Fraction of a thing's Gaussians below which it is hidden or removed, whatever edits left at its rim."""


class Absent(F4xError):  # noqa: N818  # nothing went wrong
    """No Gaussian of the scene matches the words."""

    def __init__(self, reason: str, commands: tuple[str, ...] | None = None):
        """Give the reason; `commands` are those that help, None: those near the sentence."""
        super().__init__(reason)
        self.commands = commands


@dataclass(frozen=True, eq=False)
class EditorState:
    """The caller's selection and frame: what "it" and "now" refer to."""

    selection: Selection | None = None
    """The caller's current selection."""
    frame: float = 0.0
    """The caller's current clip frame."""
    agreed: bool = False
    """A word that is probably misspelt is read as what was meant, and what nobody knows is left out; else `Doubt` asks."""


def resolve(scene: Scene, operation: Change, context: EditorState, encode: Encode | None = None) -> Change:
    """Return `operation` as a stack holds it: it means the same whenever it is replayed on `scene` with its present edits.

    Words, prompts, "it" and "the left one" become `Ids`; `All`, `Moving`, `Named` and combinations stay. `unit: size` becomes
    world units by the selection's width, `axes: camera` the axes of the clip's camera, both at the first frame of the
    operation's span, else at the present frame. `Duplicate.first_id` is reserved.

    Raises F4xError: a word that nobody knows or nothing answers to, nothing selected, a time outside the clip.
    """
    return Resolver(context, encode).resolve(edited(scene), operation)


class Resolver:
    """`resolve` for several operations and candidates: the selection of each word is computed once."""

    def __init__(self, context: EditorState, encode: Encode | None = None):
        self.context, self.encode = context, encode
        self._found: dict[tuple[bytes, Select], Selection] = {}
        self._before: Scene | None = None
        self._resolved: dict[SelectKind, SelectKind] = {}
        self._hidden_too = False
        self._several: dict[str, int] = {}
        self._doubtful: set[str] = set()

    @property
    def remarks(self) -> Iterator[str]:
        """A sentence about each word whose thing may not be there, and each noun in the singular of which several are meant."""
        for label in sorted(self._doubtful):
            yield f"Whether '{label}' is in the scene is doubtful: `f4x info` does not list it among what the scene answers to."
        for noun, many in self._several.items():
            yield f"There are {many} {plural_of(noun)}, and all of them are meant; say for example 'the left {noun}' for one."

    def resolve_sentence(self, scene: Scene, operations: Sequence[Change], tidy: bool = False) -> tuple[Change, ...]:
        """Return the operations of one sentence, each resolved in the scene that those before it leave.

        Words mean what they match before the sentence, and the same each time they occur: a copy is no second dog.
        Every single one has to be answered; `Absent` names the one that is not.
        """
        self._before, self._resolved = scene, {}
        operations = [one for operation in operations for one in operation.planned(of(scene).edits)]
        self._ask_which(scene, operations)
        settled: list[Change] = []
        for operation in operations:
            scene = with_operations(scene, settled[-1]) if settled else scene
            settled.append(self.resolve(scene, operation, tidy))
        self._before = None
        return tuple(settled)

    def resolve(self, scene: Scene, operation: Change, tidy: bool = False) -> Change:
        """Resolve one operation, as the function `resolve` does; `tidy` leaves out small stray components of what words select."""
        _check_times(scene, operation, self.context.frame)
        self._hidden_too = operation.brings_back
        operation = _without_own_shadow(operation)
        named = {entry.name: getattr(operation, entry.name) for entry in fields(operation)}  # type: ignore[arg-type]
        changed: dict[str, Any] = {
            name: self.select(scene, value, tidy)  # type: ignore[arg-type]  # each kind is in the union
            for name, value in named.items()
            if isinstance(value, Select) and name != "along"
        }
        if "select" not in changed:  # it is for no Gaussians
            return operation
        changed |= operation.settled(Settling(self, scene, operation, changed, tidy))
        if "first_id" in named:
            changed["first_id"] = next_id(scene)
        return operation.altered(**changed)

    def select(self, scene: Scene, select: SelectKind, tidy: bool = False) -> SelectKind:
        """Return the selection in ids, names, `all` and `moving`; F4xError where it is empty."""
        found = self._cached(scene, select, tidy)
        if not len(rows_of(scene, found)):
            if chosen(scene, found).any():
                raise Absent(
                    f"In the scene '{scene.name}' an edit removed {whom(select)} before; take that back, or name something else."
                )
            raise Absent(self._nothing(scene, select))
        return found

    def selection(self, scene: Scene, text: Text) -> Selection:
        """Return the scored selection of words, at their threshold."""
        key = (not_deleted(scene).tobytes(), replace(text, threshold=THRESHOLD))
        if key not in self._found:
            for label in text.labels:
                refuse_unknown(scene, label, self.encode)
            found = select_by_text(scene, text.labels, text.negatives, encode=self.encode)
            if len(text.labels) == 1:
                refuse_evidence_of_another(scene, text.labels[0], found.at_threshold(THRESHOLD), self.encode)
                if not needs_no_teacher(scene, text.labels[0]) and is_doubtful(scene, found):
                    self._doubtful.add(text.labels[0])
            self._found[key] = found
        # Being the best label says no more than a majority would, so it is not enough where more is asked for.
        return self._found[key].at_threshold(text.threshold, keep_wins=text.threshold <= THRESHOLD)

    def _ask_which(self, scene: Scene, operations: Sequence[Change]) -> None:
        """Raise `Several` where one of several of a kind is meant and the sentence does not say which."""
        for operation in operations:
            self._hidden_too = False
            for select in asked_about(operation):
                rows = rows_of(scene, self._resolve_node(scene, select, False))
                if (many := self._count(scene, rows)) > 1:
                    frame = self._frame_of_most(scene, rows)
                    raise which_of(operations, select, many, None if frame == round(self.context.frame) else frame)

    def _count(self, scene: Scene, rows: np.ndarray) -> int:
        """Number of separate things that the Gaussians `rows` make up."""
        return int(self._separate(scene, rows).max()) + 1 if len(rows) else 0

    def _frame_of_most(self, scene: Scene, rows: np.ndarray) -> int:
        return frame_of_most(scene, rows, self._separate(scene, rows), round(self.context.frame))

    def _separate(self, scene: Scene, rows: np.ndarray) -> np.ndarray:
        """Return `separate_objects` of the Gaussians `rows (n,)` at the context's frame; people are known, a backdrop is one."""
        owner = separate_objects(scene.posed(self.context.frame), rows, single_people(scene, rows))
        backdrop = is_backdrop(scene, rows[owner == np.bincount(owner).argmax()], self.context.frame)
        return np.zeros(len(rows), int) if backdrop else owner

    def each(self, scene: Scene, select: SelectKind, rows: np.ndarray, tidy: bool) -> tuple[SelectKind, ...]:
        """Return the separate things of a selection, each of which turns and grows about itself; none where it is one, or all."""
        if isinstance(select, Text) and len(select.labels) > 1:
            kinds: tuple[SelectKind, ...] = tuple(replace(select, labels=(label,)) for label in select.labels)
        elif isinstance(select, Or):
            kinds = select.of
        elif isinstance(select, Text | Moving | Heading | And | Named | Beside):
            kinds = (select,)
        else:
            return ()
        parts: list[np.ndarray] = []
        free = rows
        for kind in kinds:
            own = np.intersect1d(free, rows_of(scene, self._cached(scene, kind, tidy)) if len(kinds) > 1 else free)
            free = np.setdiff1d(free, own)
            if len(own):
                owner = self._separate(scene, own)
                parts += [own[owner == number] for number in range(owner.max() + 1)]
        return tuple(Ids.of(scene.ids[part]) for part in parts) if len(parts) > 1 else ()

    def _cached(self, scene: Scene, select: SelectKind, tidy: bool) -> SelectKind:
        if self._before is None:
            return self._with_description(scene, select, tidy)
        if select not in self._resolved:
            self._resolved[select] = self._with_description(scene, select, tidy)
        return self._resolved[select]

    def _with_description(self, scene: Scene, select: SelectKind, tidy: bool) -> SelectKind:
        if isinstance(select, Instance) and isinstance(select.of, Text) and select.frame == round(self.context.frame):
            rows = rows_of(scene, self._cached(scene, select.of, tidy))
            select = replace(select, frame=self._frame_of_most(scene, rows)) if len(rows) else select
        found = self._resolve_node(scene, select, tidy)
        if isinstance(found, Ids) and found is not select:
            words = whom(select)
            if isinstance(select, Text) and len(select.labels) > 1:
                each = (replace(select, labels=(label,)) for label in select.labels)
                words = " and ".join(whom(self._cached(scene, one, tidy)) for one in each)
            elif isinstance(select, Text) and select.labels[0].split()[-1] not in UNCOUNTED:
                many = self._count(scene, rows_of(scene, found))
                if many > 1:
                    noun = singular(select.labels[0])
                    words = f"the {many} {plural_of(noun)}"
                    self._several |= {noun: many} if select.single else {}
            return replace(found, words="".join(filter(str.isprintable, words))[:MAX_WORDS_LENGTH])
        return found

    def _resolve_node(self, scene: Scene, select: SelectKind, tidy: bool) -> SelectKind:
        if isinstance(select, And | Or):
            return replace(select, of=tuple(self._cached(scene, part, tidy) for part in select.of))
        if isinstance(select, Not):
            return Not(self._cached(scene, select.of, tidy))
        if isinstance(select, Ids):
            strange = np.setdiff1d(select.array, scene.ids)
            if len(strange):
                raise F4xError(
                    f"{scene.name}: there is no Gaussian of the id {strange[0]}; take ids of this scene with its edits, as"
                    " `f4x query` gives them."
                )
        if isinstance(select, Text):
            scene = self._before or scene
            return self._words(scene.base if self._hidden_too else scene, select, tidy)
        if isinstance(select, Point):
            return Ids.of(
                select_by_points(scene, [(select.x, select.y)], scene.cameras.frame_at(select.frame)).chosen_ids
            )
        if isinstance(select, Box):
            return Ids.of(select_by_box(scene, select.box, scene.cameras.frame_at(select.frame)).chosen_ids)
        if isinstance(select, Instance | Part | Beside):
            return Ids.of(scene.ids[self._by_place(scene, select, tidy)])
        if isinstance(select, Heading):
            return Ids.of(scene.ids[self._going(scene, select.way)])
        if isinstance(select, Current):
            return Ids.of(self._current(scene).chosen_ids)
        return select

    def _words(self, scene: Scene, select: Text, tidy: bool) -> Ids:
        """Return the Gaussians that words mean; `Absent` where there are fewer or more things than the words say."""
        rows = self._rows_of_words(scene, select)
        if select.number == "one" and (first := rows[rows < len(scene.base.ids)]).size:
            rows = first
        if (select.number == "both" or select.count) and len(rows):
            many = self._count(scene, rows)
            if many == 1 and select.number == "both":
                raise Absent(f"In the scene '{scene.name}' there is only one of {whom(select)}, not both.")
            if select.count not in (0, many):
                raise Absent(
                    f"In the scene '{scene.name}' there {'is' if many == 1 else 'are'} {many} of {whom(select)}, not"
                    f" {select.count}; those that touch count as one. Say 'all' for all of them, or 'the left one'."
                )
        if tidy and len(rows):
            rows = rows[~self._split(scene, rows)[1]]
        return Ids.of(scene.ids[rows])

    def _by_place(self, scene: Scene, select: Instance | Part | Beside, tidy: bool) -> np.ndarray:
        """Return the rows (n,) of a thing, things or a part that are known by their place, seen through the clip's camera."""
        time = float(select.frame)
        posed, camera = scene.posed(time), scene.cameras.at(time)
        if isinstance(select, Instance) and select.of == All():
            return self._nearest_of_all(scene, select)
        if isinstance(select, Beside):
            others = rows_of(scene, self._cached(scene, select.other, tidy))
            if select.of == All():
                found = everything_to(scene, others, select.where, time)
            else:
                rows = rows_of(scene, self._cached(scene, select.of, tidy))
                way = camera.camera_to_world[:3, :3] @ DIRECTIONS[select.where]
                found = stand_to(posed, rows, others, way, select.each, single_people(scene, rows))
            if not len(found):
                words = whom(select)
                nothing = f"nothing is {words.removeprefix('everything ')}" if select.of == All() else ""
                reason = nothing or f"there is no {words.removeprefix('the ')}"
                raise Absent(f"In the scene '{scene.name}' {reason}.")
            return found
        rows = rows_of(scene, self._cached(scene, select.of, tidy))
        if not len(rows):
            raise Absent(self._nothing(scene, select.of))
        if isinstance(select, Instance):
            return pick_object(posed, rows, select.which, camera, single_people(scene, rows))
        return rows[part_of(posed.means[rows], select.side, select.share, camera)]

    def _going(self, scene: Scene, way: str) -> np.ndarray:
        """Return the rows (n,) of the known things that go to the `way` across the picture."""
        owner = known_things(scene, self.context.frame)
        rows = np.flatnonzero((owner != NO_THING) & scene.moving)
        numbers = np.unique(owner[rows], return_inverse=True)[1]
        return rows[ways_of(scene, rows, numbers) == way]

    def _nearest_of_all(self, scene: Scene, select: Instance) -> np.ndarray:
        """Return the rows (n,) of the one among all known things that is `which`, backdrops left out."""
        time = float(select.frame)
        owner = known_things(scene, time)
        for thing in range(owner.max() + 1):
            if is_backdrop(scene, np.flatnonzero(owner == thing), time):
                owner[owner == thing] = NO_THING
        rows = np.flatnonzero(owner != NO_THING)
        if not len(rows):
            raise Absent(
                f"In the scene '{scene.name}' no thing is known by a word, so none can be told; name it or click on it."
            )
        known = np.unique(owner[rows], return_inverse=True)[1]
        return pick_object(scene.posed(time), rows, select.which, scene.cameras.at(time), known)

    def _rows_of_words(self, scene: Scene, text: Text) -> np.ndarray:
        """Return the rows (n,) that words mean; of a compound those of its kind of thing, too: the dog's hat is a hat."""
        known = labels_of(scene)
        heads = {label: head_of(label, {word.lower() for word in known}) for label in text.labels}

        def meant(*labels: str) -> np.ndarray:
            return self.selection(scene, replace(text, labels=labels)).chosen

        for label, head in heads.items():
            if names_another(label) and label not in known:
                raise Absent(unknown_label(scene, label, known, text_head(scene).spec.text_encoder or ""))
            if head or self._before is not None:
                self._refuse_unseen(scene, replace(text, labels=(head or label,), single=()))
                if not meant(head or label).any():
                    raise Absent(self._nothing(scene, replace(text, labels=(head or label,))))
        chosen = meant(*text.labels)
        if any(heads.values()):
            chosen = chosen & meant(*(head or label for label, head in heads.items()))
        return np.flatnonzero(chosen)

    def _refuse_unseen(self, scene: Scene, text: Text) -> None:
        """Raise `Absent` where earlier edits leave next to nothing of what a word means."""
        if scene.base is scene:
            return
        before = self.selection(scene.base, text).chosen
        if self.selection(scene, text).chosen.sum() >= LEFT * before.sum():
            return
        rows, who = np.flatnonzero(before), whom(text)
        hidden = any(step.edit.operation.hides and step.chosen[rows].any() for step in getattr(scene, "steps", ()))
        done, back = ("hides", f"say 'show {who}' first") if hidden else ("removed", "take that back")
        reason = f"In the scene '{scene.name}' an earlier edit {done} {who}; {back}, or name something else."
        raise Absent(reason, (f"show {who}",) if hidden else ())

    def _current(self, scene: Scene) -> Selection:
        if self.context.selection is None:
            raise F4xError("Nothing is selected, so nobody knows what 'it' is; name the thing, or select it first.")
        self.context.selection.require_scene(scene)
        return self.context.selection.for_ids(scene.ids)

    def _split(self, scene: Scene, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `split_objects` of the Gaussians `rows (n,)` at the context's frame; people are known by themselves."""
        return split_objects(scene.posed(self.context.frame), rows, single_people(scene, rows))

    def _nothing(self, scene: Scene, select: SelectKind) -> str:
        """Return the sentence about a selection without a Gaussian."""
        words = next((part for part in parts_of(select) if isinstance(part, Text)), None)
        if any(isinstance(part, Heading) for part in parts_of(select)):
            return f"In the scene '{scene.name}' nothing answers to '{whom(select)}'."
        if words is None or scene.features is None:
            return (
                f"In the scene '{scene.name}' the selection is empty at this place in the edits; select something else."
            )
        best = float(self.selection(scene, words).scores.max(initial=0))
        if isinstance(select, And | Not) and best >= words.threshold:
            one = any(isinstance(part, Instance) for part in parts_of(select))
            reason = f"there is only one of {whom(words)}, so " if one else ""
            return f"In the scene '{scene.name}' {reason}nothing is left of {whom(select)}."
        return nothing_called(scene, words.labels, words.threshold, best, self.encode)


@dataclass(frozen=True, eq=False)
class Settling:
    """An operation that is being resolved in a scene, as `Change.settled` sees it."""

    resolver: Resolver
    scene: Scene
    operation: Change
    """As it was asked for."""
    selects: Mapping[str, Any]
    """Its selections by field, in ids."""
    tidy: bool

    @cached_property
    def rows(self) -> np.ndarray:
        """(n,) rows of the scene that it is for."""
        return self.rows_of("select")

    def rows_of(self, name: str) -> np.ndarray:
        """Return the rows (n,) of the selection in a field."""
        return rows_of(self.scene, self.selects[name])

    @property
    def time(self) -> float:
        """The first frame concerned, else the present one."""
        return self.operation.span[0] if self.operation.span else self.resolver.context.frame

    @cached_property
    def axes(self) -> np.ndarray:
        """(3,3) right, down, forward of the camera then as columns."""
        return self.scene.cameras.at(self.time).camera_to_world[:3, :3]

    @cached_property
    def posed(self) -> PosedSplats:
        """The scene's N Gaussians then."""
        return self.scene.posed(self.time)

    @property
    def means(self) -> np.ndarray:
        """(N,3) centers then."""
        return self.posed.means

    @property
    def pixel(self) -> float:
        """World units that a pixel of the clip spans at the depth of the selection."""
        camera = self.scene.cameras.at(self.time)
        depth = float(np.median(camera.project(self.means[self.rows])[1]))
        if depth <= 0:
            raise F4xError("What lies behind the camera is not moved by pixels; say how many widths.")
        return depth / camera.focal

    @property
    def picture(self) -> np.ndarray:
        """(3,) width and height of the clip's pictures in pixels, and 0."""
        camera = self.scene.cameras.at(self.time)
        return np.array([camera.width, camera.height, 0.0])

    def each(self) -> tuple[SelectKind, ...]:
        """Return the separate things of the selection; none where it is one."""
        return self.resolver.each(self.scene, self.operation.select, self.rows, self.tidy)

    @property
    def takes_shadow(self) -> bool:
        """Return True if a shadow goes along: not with a part of a thing, nor where words speak of a shadow themselves."""
        return not any(isinstance(part, Part) or _cast_words(part) for part in parts_of(self.operation.select))

    @property
    def _there(self) -> np.ndarray:
        """(N,) bool: the rows that may go along; hidden ones, too, where it can bring them back."""
        return ~splat_rows(self.scene).gone if self.operation.brings_back else not_deleted(self.scene)

    def attached(self, lifted: bool = False) -> Ids | None:
        """Return the shadow and loose edges of its selection; those of a thing that is `lifted` without the shadow."""
        return _attached(self.scene, self.rows, self._there, lifted)

    def with_attached(self, select: SelectKind) -> SelectKind:
        """Return a selection with what goes along with it."""
        along = _attached(self.scene, rows_of(self.scene, select), self._there)
        return select if along is None else Or((select, along))


def nothing_called(
    scene: Scene, labels: Sequence[str], threshold: float, best: float, encode: Encode | None = None
) -> str:
    """Return the sentence about labels that no Gaussian has at `threshold`; `best`: the highest probability of one."""
    _, hint = instead(scene, labels, encode)
    return (
        f"In the scene '{scene.name}' nothing is called '{', '.join(labels)}' with a probability of"
        f" {threshold:g} or more (best: {best:.2f}){hint and f'; {hint}'}."
    )


def rows_of(scene: Scene, select: SelectKind) -> np.ndarray:
    """Return the rows (n,) int of `scene.posed` in a resolved selection, without those that are deleted at all times."""
    return np.flatnonzero(chosen(scene, select) & ~splat_rows(scene).gone)


def chosen(scene: Scene, select: SelectKind) -> np.ndarray:
    """Return the rows (N,) bool of `scene.posed` in a resolved selection."""
    return splat_rows(scene).chosen(select)


def _cast_words(select: SelectKind) -> tuple[str, ...]:
    """Return the words of a selection that name a shadow or the like."""
    return tuple(filter(is_cast, select.labels)) if isinstance(select, Text) else ()


def _without_own_shadow(operation: Change) -> Change:
    """Return the operation on "the car" for "the car and its shadow", where the shadow goes along anyway."""
    select, shadows = operation.select, _cast_words(operation.select)
    if not isinstance(operation, ChangeWithShadow) or not isinstance(select, Text) or any(map(caster, shadows)):
        return operation
    things = tuple(label for label in select.labels if label not in shadows)
    return operation.altered(select=replace(select, labels=things)) if things and shadows else operation


def _attached(scene: Scene, rows: np.ndarray, there: np.ndarray, lifted: bool = False) -> Ids | None:
    """Return the shadow and loose edges of the Gaussians `rows (n,)` that are `there (N,)` bool; None: nothing.

    Those that are `lifted` leave their shadow.
    """
    count = len(scene.base.ids)  # copies have the shadow that was copied with them
    chosen = np.isin(np.arange(count), rows)
    shadow, edges = (each & there[:count] for each in attached_to(scene.base, chosen))
    shadow &= not lifted
    words = "its shadow" if shadow.any() else "its edges"
    along = shadow | edges
    return replace(Ids.of(scene.base.ids[along]), words=words) if along.any() else None


def named(scene: Scene, selected: Selection | None = None) -> dict[str, Selection]:
    """Name that an edit gave -> its selection without deleted Gaussians, for queries and questions; `SELECTED` -> `selected`."""
    own = {} if selected is None else {SELECTED: selected}
    found = {name: chosen(scene, Named(name)).astype(float) for name in splat_rows(scene).names}
    if not found:
        return own
    no_wins, present, mark = np.zeros(len(scene.ids), bool), not_deleted(scene), fingerprint(scene)
    return {
        name: Selection(scene.ids, scores, no_wins, label=name, scene=mark).among(present)
        for name, scores in found.items()
    } | own


def splat_rows(scene: Scene) -> SplatRows:
    """Return the Gaussians of a scene as its edits leave them."""
    return scene.rows if isinstance(scene, EditedScene) else SplatRows.of(scene)


def _check_times(scene: Scene, operation: Change, frame: float) -> None:
    """Raise F4xError for a time of `operation`, or a present frame, outside the clip."""
    first, last = scene.cameras.times[[0, -1]]
    for time in (*operation.moments, frame):
        if time is not None and not first <= time <= last:
            raise F4xError(
                f"{operation.TAG}: frame {time:g} lies outside the clip, whose frames are {first:g} to {last:g}."
            )
