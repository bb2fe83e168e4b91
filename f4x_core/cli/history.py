"""`f4x history`, `f4x undo`, `f4x redo` and `f4x bake`: edits that there are. No sentence is read, so no grammar is loaded."""

from __future__ import annotations

import argparse
from contextlib import suppress
from dataclasses import replace
from typing import Any

from ..edit.apply import with_operations
from ..edit.baking import bake_into
from ..edit.description import SCENE_AXES, describe
from ..edit.plan_lines import as_seen
from ..edit.stack import Edit, EditStack, read_stack, redo, undo
from ..errors import F4xError
from ..language.lexicon import plural
from ..printing import one_line
from ..progress import Progress
from ..scene import read_scene, updating


def run_history(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """List the edits of a scene, and the undone edits that `redo` would restore."""
    stack = read_stack(args.scene)
    words = _in_words(args.scene, stack)
    lines = [edit_line(edit, words[edit.id]) for edit in stack.edits] + [
        f"{edit_line(edit, words[edit.id])} [undone]" for edit in reversed(stack.undone)
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
    return bake_into(args.output, read_scene(args.scene), args.scene)


def _in_words(path: str, stack: EditStack) -> dict[int, str]:
    """Return id of an edit -> what it does; what is kept along the axes of the scene is put as the camera sees it."""
    edits = (*stack.edits, *reversed(stack.undone))
    words = {edit.id: describe(edit.operation) for edit in edits}
    if any(SCENE_AXES in does for does in words.values()):
        scene = replace(read_scene(path), edits=())
        with suppress(F4xError):  # edits behind one that cannot be applied are shown as they are kept
            for edit in edits:
                words[edit.id] = as_seen(scene, edit.operation)
                scene = with_operations(scene, edit.operation) if edit.enabled else scene
    return words


def edit_line(edit: Edit, does: str) -> str:
    """Return a line: the effect of the edit and the sentence that it came from."""
    sentence = f' ("{edit.sentence}")' if edit.sentence not in ("", does) else ""
    return one_line(f"{does}{sentence}{'' if edit.enabled else ' [off]'}")


def _stack_result(args: argparse.Namespace, stack: EditStack, moved: int, verb: str) -> dict[str, Any]:
    """Return the result of undo or redo, which moved so many edits; `verb` says what happened to them."""
    done, undone = len(stack), len(stack.undone)
    fewer = f" (there were no more, {args.count} were asked for)" if moved < args.count else ""
    text = (
        f"{args.scene}: {count_of(moved)} {verb}{fewer}; {count_of(len(stack.in_effect))} in effect, {undone} to redo"
    )
    return {"edits": done, "undone": undone, "text": text}


def count_of(count: int) -> str:
    """Return "1 edit", "2 edits"."""
    return f"{count} {plural('edit', count)}"
