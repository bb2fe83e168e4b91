"""`f4x edit`."""

from __future__ import annotations

import argparse
from typing import Any

from ..app.editing import Edited, EditRequest, edit_file
from ..app.selecting import read_selection
from ..edit.json_files import read_operations
from ..edit.plan_lines import plan_lines, sizes
from ..edit.resolve import EditorState
from ..edit.stack import of
from ..edit.uncovered import summary_of
from ..progress import Progress
from ..query.chat import ChatServer
from .doubts import asking_for_yes
from .history import count_of


def run_edit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Append the edits of a sentence or of a JSON file to the scene's stack, in place or in another file, or only show them."""
    with asking_for_yes():
        edited = edit_file(args.scene, request_of(args), args.output, args.contact_sheet, args.dry_run, progress)
    return _result(edited, args)


def request_of(args: argparse.Namespace) -> EditRequest:
    """Return the edit that the arguments ask for."""
    selection = None if args.select is None else read_selection(args.select)
    state = EditorState(selection, args.frame, agreed=args.yes)
    if args.say is None:
        return EditRequest(operations=tuple(read_operations(args.ops)), source=str(args.ops), state=state)
    server = ChatServer.from_environment(args.endpoint)
    more = {"candidates": args.candidates, "backend": args.backend}
    return EditRequest(args.say, state=state, server=server, **more)


def _result(edited: Edited, args: argparse.Namespace) -> dict[str, Any]:
    """Return the sentences on what was done, or would be."""
    scene, new = edited.after, edited.new
    found, lines = ({}, []) if args.say is None else _readings(edited)
    chosen, before = sizes(scene), len(edited.before.edits)
    plan = plan_lines(edited.before, [edit.operation for edit in new], args.frame)
    lines += [
        f"{number} {line}"
        + (f": {' and '.join(f'{n:,}' for n in chosen[edit.id])} Gaussians" if edit.id in chosen else "")
        for number, (edit, line) in enumerate(zip(new, plan, strict=True), before + 1)
    ]
    shows = edited.uncovered
    lines += filter(None, [summary_of(shows)])
    written = args.scene if args.output is None else args.output
    undo = (
        "`f4x undo` takes back the last"
        if len(new) == 1
        else f"`f4x undo --count {len(new)}` takes these {len(new)} back"
    )
    end = f"{written}: {count_of(len(of(scene).in_effect))} in effect; {undo}"
    return {
        **found,
        "output": None if args.dry_run else str(written),
        "edits": [edit.to_json() for edit in new],
        "gaussians": [sum(chosen.get(edit.id, ())) for edit in new],
        **({} if shows is None else {"uncovered": shows.to_json()}),
        "text": "\n".join([*lines, "nothing was written" if args.dry_run else end]),
    }


def _readings(edited: Edited) -> tuple[dict[str, Any], list[str]]:
    """Return (all readings of the sentence as JSON, all readings as lines of text)."""
    proposal = edited.proposal
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
    return found, lines
