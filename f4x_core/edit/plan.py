"""From a sentence to candidates of edits, to one that is applied: what panel, command line and agents call. No terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..language.grammar import read_as_meant
from ..language.refusal import Doubt, Refusal
from ..query.cast import with_untaught
from ..query.chat import ChatServer
from ..query.engines import BARE, Engines
from ..query.inventory import words_there
from ..query.people import in_ordinals, remarks_on
from ..scene import Scene, read_scene, updating
from . import endpoint, language
from .apply import edited, stack_of, with_operations
from .change import Change
from .description import describe
from .judge import judge
from .records import Record, mapped
from .request import Request
from .resolve import Absent, EditorState, Resolver, labels_of, rows_of
from .selects import Ids, Not, SelectKind, Text, parts_of
from .stack import EditStack, of, write_stack
from .stack import redo as redo  # the panel's one door: propose, preview, apply, undo, redo
from .stack import undo as undo
from .which import Several

GRAMMAR = "grammar"
"""`Proposal.understood_by` where no model was asked."""
MAX_CANDIDATES = 10
"""As many as the paper's; each costs a look-up and a few small pictures."""
THRESHOLDS = (0.35, 0.65, 0.2, 0.8)
"""Probabilities tried besides the one that was asked for, the likeliest to help first."""
MOMENTS, UNSEEN = 5, 0.01
"""Frames at which it is looked whether something is hidden, and the opacity below which it is."""
AMOUNTS = (0.7, 1.4)
"""Factors of distances and sizes tried where an operation has any."""


@dataclass(frozen=True)
class Candidate:
    """One way to carry out a sentence."""

    operations: tuple[Change, ...]
    """Resolved: as they go into the stack."""
    why: str = ""
    """Its difference from the plain reading, in words."""
    sentence: str = ""
    """The sentence, for the history."""
    scores: Mapping[str, float] = field(default_factory=dict)
    """Findings of the judge; empty where there was nothing to choose."""


@dataclass(frozen=True)
class Proposal:
    """The candidate edits for one sentence, and the judge's choice."""

    sentence: str
    """The sentence as it was typed."""
    candidates: tuple[Candidate, ...]
    """At least one; the first is the plain reading."""
    best: int = 0
    """Index of the one to apply."""
    understood_by: str = GRAMMAR
    """`grammar`, or the address of the server whose model did."""
    judged_by: str = ""
    """`measured`, the address of a server, or nothing with one candidate."""
    notes: tuple[str, ...] = ()
    """Notes for a person, such as why no model was asked."""

    @property
    def chosen(self) -> Candidate:
        """The best candidate."""
        return self.candidates[self.best]


def propose(
    scene: Scene, sentence: str, context: EditorState | None = None, engines: Engines = BARE, *, candidates: int = 1
) -> Proposal:
    """Resolve `sentence` in `scene` with its present edits into up to `candidates` variants, of which the judge chooses.

    With `engines.server` its model reads the sentence (and, where it sees pictures, chooses), and the grammar does where it fails.
    Raises F4xError (`language.Refusal` with the nearest commands, `Doubt` with a question): not understood, nobody there to
    edit, a time outside.
    """
    if not 1 <= candidates <= MAX_CANDIDATES:
        raise F4xError(f"{candidates} candidates are asked for; give 1 to {MAX_CANDIDATES}.")
    scene, context = edited(scene), context or EditorState()
    engines.progress("understand", 0, 0)
    try:
        asked, understood_by, notes = read_sentence(scene, sentence, context, engines.server)
    except Doubt:
        raise
    except Refusal as refusal:
        there = _there(scene)
        reason = language.about_there(refusal.reason, sentence, there)
        raise Refusal(reason, refusal.nearest and language.nearest(sentence, there)) from refusal
    resolver = Resolver(context, engines.encode)
    found: list[Candidate] = []
    for operations, tidy, why in _variants(asked):
        engines.progress("select", len(found), candidates)
        try:
            settled = resolver.resolve_sentence(scene, operations, tidy)
        except F4xError as error:
            if why:
                continue
            _raise_with_help(error, scene, sentence, asked, notes)
        if all(settled != other.operations for other in found):
            found.append(Candidate(settled, why, sentence))
        if len(found) == candidates:
            break
    notes += (*remarks_on(scene, words_in(asked)), *resolver.remarks, *_idle(scene, found[0].operations))
    proposal = Proposal(sentence, tuple(found), 0, understood_by, notes=notes)
    if len(found) == 1:
        return proposal
    readings = [candidate.operations for candidate in found]
    verdict = judge(scene, sentence, asked, readings, resolver, engines)
    scored = tuple(replace(c, scores=scores) for c, scores in zip(found, verdict.scores, strict=True))
    return replace(
        proposal, candidates=scored, best=verdict.best, judged_by=verdict.judged_by, notes=notes + verdict.notes
    )


def _raise_with_help(
    error: F4xError, scene: Scene, sentence: str, asked: tuple[Change, ...], notes: tuple[str, ...]
) -> NoReturn:
    """Raise the error of the plain reading `asked` of a sentence, behind `notes`, with commands to give instead."""
    reason = " ".join([*notes, str(error)])
    if isinstance(error, Several):
        offered = tuple(one for one in error.commands if language.operations_of(one, labels_of(scene)))
        raise Refusal(error.reason, offered).behind(notes) from error
    if isinstance(error, Absent):  # another threshold would be a guess
        helps = error.commands
        raise Refusal(reason, _offered(sentence, asked, _there(scene)) if helps is None else helps) from error
    if notes:
        raise F4xError(reason) from error
    raise error


def read_sentence(
    scene: Scene, sentence: str, context: EditorState, server: ChatServer | None = None
) -> tuple[tuple[Change, ...], str, tuple[str, ...]]:
    """Return (operations in the words of the sentence, not yet resolved; the reader that understood it; notes). Raises F4xError."""
    names = _names(scene)
    chosen = None if context.selection is None else context.selection.for_ids(scene.ids).chosen
    sentence, people = in_ordinals(scene, sentence, "sentence", scene.cameras.frame_at(context.frame), chosen, names)
    labels = with_untaught(scene, [*labels_of(scene), *people])
    request = Request(sentence, labels, names, scene.fps, len(scene.cameras), chosen is not None, context.frame)
    notes: tuple[str, ...] = ()
    if server is not None:
        try:
            operations = endpoint.ask_for_operations(server, request)
            return operations, server.url, ()
        except F4xError as error:
            notes = (f"{error} The grammar read the sentence instead.",)
    active = reversed(of(scene).in_effect)
    earlier, copies = next((edit.sentence for edit in active), ""), _copies(scene)

    def read(text: str) -> tuple[Change, ...]:
        return language.parse(replace(request, sentence=text), copies=copies, earlier=earlier)

    try:
        understood, mended = read_as_meant(read, sentence, context.agreed)
    except Refusal as refusal:
        if notes:
            raise refusal.behind(notes) from refusal
        raise
    return understood, GRAMMAR, (*notes, *mended)


def _copies(scene: Scene) -> dict[SelectKind, SelectKind]:
    """Return a dictionary from the copies that edits made and that are still there to their originals, in order."""
    found: dict[SelectKind, SelectKind] = {}
    for step in getattr(scene, "steps", ()):
        if step.copied is not None:
            copies = Ids.of(step.copy_ids)
            if len(rows_of(scene, copies)):
                words = "the copy" if len(step.copy_time_maps) == 1 else "the copies"
                found[replace(copies, words=words)] = step.edit.operation.select
    return found


def _there(scene: Scene) -> tuple[str, ...]:
    """Return the words that examples may speak of: names, and what the scene's words find; where there are none, what moves."""
    words = (*_names(scene), *(words_there(scene)[0] if labels_of(scene) else ()))
    return words or ("moving thing",) * bool(scene.moving.any())


def _names(scene: Scene) -> tuple[str, ...]:
    """Return the names that edits gave."""
    return tuple(name for edit in of(scene).edits if (name := getattr(edit.operation, "name", "")))


def _offered(sentence: str, asked: Sequence[Change], there: Sequence[str]) -> tuple[str, ...]:
    """Return commands about things that are `there`, in place of a sentence about one that is not.

    A sentence that spares a thing is offered again with another one spared: nobody who says "everything but" means the rest.
    """
    if not any(isinstance(part, Not) for operation in asked for part in parts_of(operation.select)):
        return language.nearest(sentence, there)
    absent = [word for word in words_in(tuple(asked)) if word not in there and word in sentence]
    others = [word for word in there if word not in sentence]
    return (sentence.replace(absent[0], others[0]),) if absent and others else ()


def words_in(value: Any) -> Iterator[str]:
    """Yield the words for things in operations and selections."""
    if isinstance(value, Text):
        yield from value.labels
    elif isinstance(value, Record):
        value = tuple(getattr(value, entry.name) for entry in fields(value))  # type: ignore[arg-type]
    for part in value if isinstance(value, tuple) else ():
        yield from words_in(part)


def _idle(scene: Scene, operations: tuple[Change, ...]) -> Iterator[str]:
    """Yield a sentence about each operation that changes nothing, is not seen, or may do other than expected."""
    clip = (float(scene.cameras.times[0]), float(scene.cameras.times[-1]))
    for operation in operations:
        retimes, rows = operation.time_map(clip) is not None, rows_of(scene, operation.select)
        if retimes and not scene.fades and not scene.moving[rows].any():
            yield f"{describe(operation)}: that stands still already, so nothing changes."
        elif _is_hidden(scene, operation, rows):
            yield f"{describe(operation)}: that is hidden by an earlier edit, so it is not seen; show it again, or take that back."
        elif remark := operation.remark(scene, rows):
            yield remark
        scene = with_operations(scene, operation)


def _is_hidden(scene: Scene, operation: Change, rows: np.ndarray) -> bool:
    """Return True for a change of what earlier edits hide, the Gaussians `rows`, at all times that it is for."""
    seen_in_place = operation.SEEN != "nowhere" and not (operation.removes or operation.brings_back)
    if not seen_in_place or not any(edit.operation.hides for edit in of(scene).in_effect):
        return False
    times = scene.cameras.times
    first, last = operation.span or (None, None)
    during = times[(times >= (times[0] if first is None else first)) & (times <= (times[-1] if last is None else last))]
    looked_at = during[evenly_spaced(len(during), MOMENTS)]
    return len(rows) > 0 and all(scene.posed(float(time)).opacities[rows].max() < UNSEEN for time in looked_at)


def preview(scene: Scene, candidate: Candidate) -> Scene:
    """Return the scene with `candidate` applied; nothing is written."""
    return with_operations(scene, *candidate.operations, sentence=candidate.sentence)


def apply(path: Path | str, candidate: Candidate) -> EditStack:
    """Append a candidate to the stack of the scene file at `path`, atomically; F4xError leaves the file as it was."""
    with updating(path):
        stack = stack_of(read_scene(path), *candidate.operations, sentence=candidate.sentence)
        write_stack(path, stack)
    return stack


def _variants(asked: tuple[Change, ...]) -> Iterator[tuple[tuple[Change, ...], bool, str]]:
    """Yield (operations, tidy, why): the plain reading first, then others; some may come to the same."""
    yield asked, False, ""
    yield asked, True, "without stray pieces"
    for number, threshold in enumerate(THRESHOLDS):
        changed = tuple(_with_threshold(operation, threshold) for operation in asked)
        yield changed, False, f"probability from {threshold:g}"
        if number < len(AMOUNTS):
            amount = AMOUNTS[number]
            yield tuple(operation.times_as_much(amount) for operation in asked), False, f"{amount:g} times as much"
        yield changed, True, f"probability from {threshold:g}, without stray pieces"


def _with_threshold(operation: Change, threshold: float) -> Change:
    """Return an operation with another threshold for its words."""
    return mapped(operation, lambda value: value.altered(threshold=threshold) if isinstance(value, Text) else None)  # type: ignore[no-any-return]
