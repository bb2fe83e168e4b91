"""`f4x edit`."""

from __future__ import annotations

import argparse
from typing import Any

from ..edit.apply import base_of, open_scene, with_operations
from ..edit.json_files import read_operations
from ..edit.judge import candidate_sheet
from ..edit.operations import TakeBack
from ..edit.plan import preview, propose
from ..edit.plan_lines import plan_lines, sizes
from ..edit.resolve import EditorState, resolve
from ..edit.stack import of, write_stack
from ..edit.uncovered import summary_of, takes_away, uncovered
from ..errors import F4xError
from ..files import replace_file, same_file
from ..progress import Progress
from ..query.chat import ChatServer
from ..scene import Scene, updating, write_scene
from .doubts import asking_for_yes
from .encoding import encoder
from .history import count_of
from .querying import read_selection


def run_edit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Append the edits of a sentence or of a JSON file to the scene's stack, in place or in another file, or only show them."""
    if args.output is not None and same_file(args.output, args.scene):
        args.scene, args.output = args.output, None  # in place, under the name that is to be written
    if args.output is not None or args.dry_run:
        return _edit(args, progress)
    with updating(args.scene):  # what another writes between reading and writing would be lost
        return _edit(args, progress)


def _edit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Read the scene, append the edits and write it where that is asked for."""
    scene = unedited = open_scene(args.scene)
    before = len(scene.edits)
    if args.say is not None:
        scene, found, lines = _propose(scene, args, progress)
    else:
        found, lines = {}, []
        scene = _with_file(scene, args, progress)
    new = of(scene).edits[before:]
    written = args.scene if args.output is None else args.output
    if args.output is None and not args.dry_run:
        write_stack(args.scene, of(scene))
    elif not args.dry_run:
        write_scene(base_of(scene), args.output)
    chosen = sizes(scene)
    plan = plan_lines(unedited, [edit.operation for edit in new], args.frame)
    lines += [
        f"{number} {line}"
        + (f": {' and '.join(f'{n:,}' for n in chosen[edit.id])} Gaussians" if edit.id in chosen else "")
        for number, (edit, line) in enumerate(zip(new, plan, strict=True), before + 1)
    ]
    shows = uncovered(scene) if takes_away(edit.operation for edit in new) else None
    lines += filter(None, [summary_of(shows)])
    active = sum(edit.enabled and not isinstance(edit.operation, TakeBack) for edit in of(scene).edits)
    end = f"{written}: {count_of(active)} in effect; `f4x undo` takes back the last"
    return {
        **found,
        "output": None if args.dry_run else str(written),
        "edits": [edit.to_json() for edit in new],
        "gaussians": [sum(chosen.get(edit.id, ())) for edit in new],
        **({} if shows is None else {"uncovered": shows.to_json()}),
        "text": "\n".join([*lines, "nothing was written" if args.dry_run else end]),
    }


def _with_file(scene: Scene, args: argparse.Namespace, progress: Progress) -> Scene:
    """The scene with the operations of the file `--ops`."""
    context, encode = _context(args), encoder(progress)
    for number, operation in enumerate(read_operations(args.ops), 1):
        progress("edit", number - 1, 0, operation.TAG)
        try:
            resolved = resolve(scene, operation, context, encode)
            scene = with_operations(scene, resolved)
        except F4xError as error:
            raise F4xError(f"{args.ops}: operation {number} ({operation.TAG}): {error}") from error
    return scene


def _propose(scene: Scene, args: argparse.Namespace, progress: Progress) -> tuple[Scene, dict[str, Any], list[str]]:
    """(scene with the best reading of `--say`, all readings as JSON, all readings as lines of text)."""
    server = ChatServer.from_environment(args.endpoint)
    context = _context(args)
    options: dict[str, Any] = {
        "server": server,
        "encode": encoder(progress),
        "candidates": args.candidates,
    }
    with asking_for_yes():
        proposal = propose(scene, args.say, context, backend=args.backend, progress=progress, **options)
    if args.contact_sheet is not None:
        candidates = [candidate.operations for candidate in proposal.candidates]
        with replace_file(args.contact_sheet) as file:
            candidate_sheet(scene, candidates, proposal.best, args.backend).save(file, "PNG")
    rows: list[dict[str, Any]] = [
        {"why": one.why or "as said", "scores": dict(one.scores)} for one in proposal.candidates
    ]
    found = {
        "understood_by": proposal.understood_by,
        "judged_by": proposal.judged_by,
        "best": proposal.best,
        "candidates": rows,
        "notes": list(proposal.notes),
    }
    lines = list(proposal.notes)
    for number, row in enumerate(rows if len(rows) > 1 else (), 1):
        scores = ", ".join(f"{name} {value:.2f}" for name, value in row["scores"].items())
        lines.append(f"{'*' if number - 1 == proposal.best else ' '} {number} {row['why']}: {scores}")
    return preview(scene, proposal.chosen), found, lines


def _context(args: argparse.Namespace) -> EditorState:
    """The selection and the frame that "it" and "now" in a sentence refer to."""
    selection = None if args.select is None else read_selection(args.select)
    return EditorState(selection, args.frame, agreed=args.yes)
