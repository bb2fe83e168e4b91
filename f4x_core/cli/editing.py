"""`f4x edit`, `f4x history`, `f4x undo`, `f4x redo` and `f4x bake`."""

from __future__ import annotations

import argparse
from typing import Any

from ..edit.apply import base_of, open_scene, with_operations
from ..edit.bake import bake, needs_time
from ..edit.description import describe
from ..edit.json_files import read_operations
from ..edit.judge import candidate_sheet
from ..edit.operations import Name, TakeBack
from ..edit.plan import preview, propose
from ..edit.plan_lines import plan_lines, sizes
from ..edit.resolve import EditorState, resolve
from ..edit.stack import Edit, EditStack, of, read_stack, redo, undo, write_stack
from ..edit.uncovered import summary_of, takes_away, uncovered
from ..errors import F4xError
from ..files import replace_file, same_file
from ..language.lexicon import plural
from ..printing import one_line
from ..progress import Progress
from ..query.chat import ChatServer
from ..scene import Scene, read_scene, updating, write_scene
from .encoding import encoder
from .querying import asking_for_yes, read_selection


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
    end = f"{written}: {_edits(active)} in effect; `f4x undo` takes back the last"
    return {
        **found,
        "output": None if args.dry_run else str(written),
        "edits": [edit.to_json() for edit in new],
        "gaussians": [sum(chosen.get(edit.id, ())) for edit in new],
        **({} if shows is None else {"uncovered": shows.to_json()}),
        "text": "\n".join([*lines, "nothing was written" if args.dry_run else end]),
    }


def run_history(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """List the edits of a scene, and the undone edits that `redo` would restore."""
    stack = read_stack(args.scene)
    lines = [edit_line(edit) for edit in stack.edits] + [
        f"{edit_line(edit)} [undone]" for edit in reversed(stack.undone)
    ]
    lines = [f"{number} {line}" for number, line in enumerate(lines, 1)]
    return {
        "edits": stack.to_json(),
        "undone": [edit.to_json() for edit in stack.undone],
        "text": "\n".join(lines) or f"{args.scene}: no edits",
    }


def run_undo(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Undo the last edits."""
    with updating(args.scene):
        before = len(read_stack(args.scene))
        stack = undo(args.scene, args.count)
    return _stack_result(args, stack, before - len(stack), "undone")


def run_redo(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Redo the edits that were undone last."""
    with updating(args.scene):
        before = len(read_stack(args.scene))
        stack = redo(args.scene, args.count)
    return _stack_result(args, stack, len(stack) - before, "redone")


def run_bake(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fold the edits into the arrays of a new scene file."""
    scene = read_scene(args.scene)
    if same_file(args.output, args.scene):
        raise F4xError(
            f"{args.output}: it is the scene itself, whose edits could not be undone any more; give another file."
        )
    if not scene.edits:
        raise F4xError(f"{args.scene}: it has no edits to fold in; copy the file.")
    baked = bake(scene)
    write_scene(baked, args.output)
    unfolded = [edit for edit in of(baked).edits if not isinstance(edit.operation, Name)]
    names = len(of(baked)) - len(unfolded)
    folded = len(baked.provenance.get("baked", ())) - len(scene.provenance.get("baked", ()))
    rest = ""
    if unfolded:
        staying = [edit.operation.TAG for edit in unfolded] + [f"{names} {plural('name', names)}"] * bool(names)
        rest = f"; these stay in the stack: {', '.join(staying)}: {_why_not_folded(scene)}"
    return {
        "output": str(args.output),
        "folded": folded,
        "left": len(unfolded),
        "static": len(baked.static),
        "dynamic": len(baked.dynamic),
        "text": f"{args.output}: {_edits(folded)} folded in{rest}",
    }


def _why_not_folded(scene: Scene) -> str:
    """The reason why the first remaining edit cannot be folded in."""
    for number, edit in enumerate(of(scene).edits, 1):
        if edit.enabled and needs_time(edit):
            return f"{edit.titled(number)} changes with time what base arrays hold once, and those after it build on it"
    return "the nodes of a scaffold cannot hold their moments exactly"


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


def edit_line(edit: Edit) -> str:
    """One line: the edit in words and the sentence that it came from."""
    does = describe(edit.operation)
    sentence = f' ("{edit.sentence}")' if edit.sentence not in ("", does) else ""
    return one_line(f"{does}{sentence}{'' if edit.enabled else ' [off]'}")


def _stack_result(args: argparse.Namespace, stack: EditStack, moved: int, verb: str) -> dict[str, Any]:
    """The result of undo or redo, which moved so many edits; `verb` says what happened to them."""
    done, undone = len(stack), len(stack.undone)
    fewer = f" (there were no more, {args.count} were asked for)" if moved < args.count else ""
    text = f"{args.scene}: {_edits(moved)} {verb}{fewer}; {_edits(done)} in effect, {undone} to redo"
    return {"edits": done, "undone": undone, "text": text}


def _edits(count: int) -> str:
    return f"{count} {plural('edit', count)}"
