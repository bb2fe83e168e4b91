"""Edits of a scene by a sentence or by operations: proposed, shown, and written into its file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..edit.apply import base_of, open_scene, with_operations
from ..edit.change import Change
from ..edit.plan import Candidate, Proposal, preview, propose
from ..edit.resolve import EditorState, resolve
from ..edit.stack import Edit, of, write_stack
from ..edit.uncovered import Uncovered, takes_away, uncovered
from ..errors import F4xError
from ..files import in_place, replace_file
from ..progress import Progress, silent
from ..query.chat import ChatServer
from ..query.engines import Engines
from ..scene import PosedSplats, Scene, updating, write_scene
from .encoding import encoder

OPERATIONS = "operations"
"""`Proposal.understood_by` where operations were given in place of a sentence."""


@dataclass(frozen=True, eq=False)
class EditRequest:
    """An edit, as a sentence or as operations."""

    sentence: str = ""
    """Plain English; empty where operations are given."""
    operations: tuple[Change, ...] = ()
    """In place of a sentence."""
    source: str = ""
    """The file of the operations, for errors."""
    state: EditorState = field(default_factory=EditorState)
    """The meaning of "it", "here" and "now", and the consent to a doubtful reading."""
    server: ChatServer | None = None
    """Language model that reads the sentence; None: the grammar does, and nothing is sent."""
    candidates: int = 1
    """Readings of the sentence that are compared."""
    backend: str = "auto"
    """The raster backend of the pictures by which readings are compared."""


@dataclass(frozen=True, eq=False)
class Edited:
    """An edit of a scene file, before and after."""

    before: Scene
    """The scene with the edits that it had."""
    after: Scene
    """The scene with the new edits, too."""
    proposal: Proposal
    """All readings that were compared."""

    @property
    def new(self) -> Sequence[Edit]:
        """The edits that were added."""
        return of(self.after).edits[len(self.before.edits) :]

    @property
    def changes(self) -> bool:
        """True unless all Gaussians stay as they are at the clip's ends, at moments of the new edits, and halfway between those."""
        if not all(edit.operation.ACTS and not edit.operation.taken_back for edit in self.new):
            return True  # names and edits that are taken back need not show
        first, last = (float(time) for time in self.after.cameras.times[[0, -1]])
        named = [last if moment is None else float(moment) for edit in self.new for moment in edit.operation.moments]
        moments = sorted({first, *named, last})
        # Between them, too: what is only faster is the same at both ends.
        between = [(one + other) / 2 for one, other in pairwise(moments)]
        return any(map(self._differs, [*between, *moments]))

    def _differs(self, time: float) -> bool:
        """Return True if any Gaussian is another than before at a clip frame."""
        one, other = self.before.posed(time), self.after.posed(time)
        arrays = [each.name for each in fields(PosedSplats) if each.name != "dynamic"]
        return any(not np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)

    @property
    def uncovered(self) -> Uncovered | None:
        """The surfaces that edits uncover; None where they uncover nothing."""
        return uncovered(self.after) if takes_away(edit.operation for edit in self.new) else None


def propose_edit(scene: Scene, request: EditRequest, progress: Progress = silent) -> Proposal:
    """Return the plan of a request for the scene with its edits; nothing is written.

    Raises:
        F4xError: a sentence that is not understood, nothing that answers to its words, an operation that cannot be applied.
    """
    if request.operations:
        resolved = _resolved(scene, request, progress)
        return Proposal("", (Candidate(resolved, "as given"),), understood_by=OPERATIONS)
    engines = Engines(request.server, encoder(progress), request.backend, progress)
    return propose(scene, request.sentence, request.state, engines, candidates=request.candidates)


def edit_file(
    path: Path,
    request: EditRequest,
    output: Path | None = None,
    contact_sheet: Path | None = None,
    dry_run: bool = False,
    progress: Progress = silent,
) -> Edited:
    """Append the edits of a request to the scene file at `path`, as `f4x edit` does.

    Args:
        path: the scene file.
        request: what is done.
        output: another file to write; None: the stack of edits at `path` grows.
        contact_sheet: PNG of all readings, side by side.
        dry_run: nothing is written but the contact sheet.
        progress: is called `(stage, done, total, message)`.
    """
    path, output = in_place(path, output)
    grows = output is None and not dry_run
    with updating(path) if grows else nullcontext():  # what another writes between reading and writing would be lost
        scene = open_scene(path)
        proposal = propose_edit(scene, request, progress)
        if contact_sheet is not None:
            _write_sheet(scene, proposal, request.backend, contact_sheet)
        edited = Edited(scene, preview(scene, proposal.chosen), proposal)
        if not edited.changes:
            raise F4xError(
                "That leaves every Gaussian of the scene as it is, so nothing was written; ask for something else."
            )
        if grows:
            write_stack(path, of(edited.after))
        elif output is not None and not dry_run:
            write_scene(base_of(edited.after), output)
    return edited


def _resolved(scene: Scene, request: EditRequest, progress: Progress) -> tuple[Change, ...]:
    """Return the operations of a request, each resolved in the scene that those before it leave."""
    resolved: list[Change] = []
    encode = encoder(progress)
    for number, operation in enumerate(request.operations, 1):
        progress("edit", number - 1, 0, operation.TAG)
        try:
            resolved.append(resolve(scene, operation, request.state, encode))
            scene = with_operations(scene, resolved[-1])
        except F4xError as error:
            place = f"{request.source}: " if request.source else ""
            raise F4xError(f"{place}operation {number} ({operation.TAG}): {error}") from error
    return tuple(resolved)


def _write_sheet(scene: Scene, proposal: Proposal, backend: str, path: Path) -> None:
    """Draw the readings of a sentence side by side."""
    from ..edit.judge import candidate_sheet

    operations = [candidate.operations for candidate in proposal.candidates]
    with replace_file(path) as file:
        candidate_sheet(scene, operations, proposal.best, backend).save(file, "PNG")
