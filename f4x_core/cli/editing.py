"""`f4x edit`, `f4x history`, `f4x undo`, `f4x redo` and `f4x bake`."""

from __future__ import annotations

import argparse
from typing import Any

from ..edit.apply import base_of, open_scene, with_operations
from ..edit.bake import bake, needs_time
from ..edit.description import describe
from ..edit.json_files import read_json, read_operations
from ..edit.judge import contact_sheet
from ..edit.operations import Name
from ..edit.plan import preview, propose
from ..edit.resolve import Context, resolve
from ..edit.stack import Edit, EditStack, of, read_stack, redo, undo, write_stack
from ..errors import F4xError
from ..files import replace_file
from ..progress import Progress
from ..query.chat import ChatServer
from ..query.labels import encode_labels
from ..query.selection import Selection
from ..scene import Scene, read_scene, write_scene

SELECTION = "selection.json"


def run_edit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Append what a sentence, or a JSON file, says to the scene's stack, there or in another file; or only look at it."""
    scene = open_scene(args.scene)
    before = len(scene.edits)
    if args.say is not None:
        scene, found, lines = _said(scene, args, progress)
    else:
        found, lines = {}, []
        scene = _with_file(scene, args, progress)
    new = of(scene).edits[before:]
    if args.dry_run:
        where = "nothing was written"
    elif args.output is None:
        write_stack(args.scene, of(scene))
        where = str(args.scene)
    else:
        write_scene(base_of(scene), args.output)
        where = str(args.output)
    chosen = {step.edit.id: int(step.chosen.sum()) for step in getattr(scene, "steps", ())}
    lines += [
        f"{number} {told(edit)}" + (f": {chosen[edit.id]:,} Gaussians" if edit.id in chosen else "")
        for number, edit in enumerate(new, before + 1)
    ]
    return {
        **found,
        "output": None if args.dry_run else where,
        "edits": [edit.to_json() for edit in new],
        "gaussians": [chosen.get(edit.id, 0) for edit in new],
        "text": "\n".join([*lines, where]),
    }


def run_history(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """List the edits of a scene, and those that `redo` would bring back."""
    stack = read_stack(args.scene)
    lines = [told(edit) for edit in stack.edits] + [f"{told(edit)} [undone]" for edit in reversed(stack.undone)]
    lines = [f"{number} {line}" for number, line in enumerate(lines, 1)]
    return {
        "edits": stack.to_json(),
        "undone": [edit.to_json() for edit in stack.undone],
        "text": "\n".join(lines) or f"{args.scene}: no edits",
    }


def run_undo(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Take back the last edits."""
    before = len(read_stack(args.scene))
    stack = undo(args.scene, args.count)
    return _left(args, stack, before - len(stack), "taken back")


def run_redo(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Bring back what was undone last."""
    before = len(read_stack(args.scene))
    stack = redo(args.scene, args.count)
    return _left(args, stack, len(stack) - before, "brought back")


def run_bake(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fold the edits into the arrays of a new scene file."""
    scene = read_scene(args.scene)
    if args.output.exists() and args.output.samefile(args.scene):
        raise F4xError(
            f"{args.output}: it is the scene itself, whose edits could not be undone any more; give another file."
        )
    if not scene.edits:
        raise F4xError(f"{args.scene}: it has no edits to fold in; copy the file.")
    baked = bake(scene)
    write_scene(baked, args.output)
    left = [edit for edit in of(baked).edits if not isinstance(edit.operation, Name)]
    names = len(of(baked)) - len(left)
    folded = len(baked.provenance.get("baked", ())) - len(scene.provenance.get("baked", ()))
    rest = ""
    if left:
        staying = [edit.operation.TAG for edit in left] + [f"{names} name{'' if names == 1 else 's'}"] * bool(names)
        rest = f"; these stay in the stack: {', '.join(staying)}: {_why_not_folded(scene)}"
    return {
        "output": str(args.output),
        "folded": folded,
        "left": len(left),
        "static": len(baked.static),
        "dynamic": len(baked.dynamic),
        "text": f"{args.output}: {_edits(folded)} folded in{rest}",
    }


def _why_not_folded(scene: Scene) -> str:
    """Why a bake goes no further than it did."""
    for number, edit in enumerate(of(scene).edits, 1):
        if edit.enabled and needs_time(edit):
            return f"{edit.titled(number)} changes with time what base arrays hold once, and those after it build on it"
    return "the nodes of a scaffold cannot hold their moments exactly"


def _with_file(scene: Scene, args: argparse.Namespace, progress: Progress) -> Scene:
    """The scene with the operations of the file `--ops`."""
    context = _context(args)
    for number, operation in enumerate(read_operations(args.ops), 1):
        progress("edit", number - 1, 0, operation.TAG)
        try:
            settled = resolve(scene, operation, context, encode_labels)
            scene = with_operations(scene, settled)
        except F4xError as error:
            raise F4xError(f"{args.ops}: operation {number} ({operation.TAG}): {error}") from error
    return scene


def _said(scene: Scene, args: argparse.Namespace, progress: Progress) -> tuple[Scene, dict[str, Any], list[str]]:
    """The scene with the best reading of `--say`, what is told of all readings as JSON, and in lines."""
    server = ChatServer.from_environment(args.endpoint)
    context = _context(args)
    options: dict[str, Any] = {"server": server, "encode": encode_labels, "candidates": args.candidates}
    proposal = propose(scene, args.say, context, backend=args.backend, progress=progress, **options)
    if args.contact_sheet is not None:
        candidates = [candidate.operations for candidate in proposal.candidates]
        with replace_file(args.contact_sheet) as file:
            contact_sheet(scene, candidates, proposal.best, args.backend).save(file, "PNG")
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
        told_scores = ", ".join(f"{name} {value:.2f}" for name, value in row["scores"].items())
        lines.append(f"{'*' if number - 1 == proposal.best else ' '} {number} {row['why']}: {told_scores}")
    return preview(scene, proposal.chosen), found, lines


def _context(args: argparse.Namespace) -> Context:
    """What "it" and "now" mean on the command line."""
    if args.select is None:
        return Context(frame=args.frame)
    data = read_json(args.select, f"the {SELECTION} that `f4x query SCENE … -o DIR` leaves")
    try:
        return Context(Selection.from_json(data), args.frame)
    except F4xError as error:
        raise F4xError(f"{args.select}: {error}") from error


def told(edit: Edit) -> str:
    """One line: the edit in words, and the sentence that it came from."""
    does = describe(edit.operation)
    said = f' ("{edit.said}")' if edit.said not in ("", does) else ""
    return f"{does}{said}{'' if edit.enabled else ' [off]'}"


def _left(args: argparse.Namespace, stack: EditStack, moved: int, how: str) -> dict[str, Any]:
    done, undone = len(stack), len(stack.undone)
    fewer = f" (there were no more, {args.count} were asked for)" if moved < args.count else ""
    text = f"{args.scene}: {_edits(moved)} {how}{fewer}; {_edits(done)} in effect, {undone} to redo"
    return {"edits": done, "undone": undone, "text": text}


def _edits(count: int) -> str:
    return f"{count} edit{'' if count == 1 else 's'}"
