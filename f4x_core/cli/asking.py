"""`f4x ask`."""

from __future__ import annotations

import argparse
from typing import Any

from ..app.asking import AskOptions, ask
from ..app.paths import trajectory_of
from ..app.selecting import read_selection
from ..edit.apply import open_scene
from ..errors import F4xError
from ..progress import Progress
from ..query.chat import ChatServer
from .doubts import asking_for_yes


def run_ask(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Answer a question about a scene, and say whether a model or a computation answered."""
    scene = open_scene(args.scene, args.edits)
    views = trajectory_of(scene, args.path, args.degrees)
    if args.select is not None and (args.model is not None or args.endpoint is not None):
        raise F4xError(
            "--select tells a computed answer what 'it' is; a model sees whole pictures, so leave out one of them."
        )
    selected = None if args.select is None else read_selection(args.select)
    server = ChatServer.from_environment(args.endpoint) if args.model is None else None
    with asking_for_yes():
        found = ask(
            scene, args.question, AskOptions(selected, views, server, args.model, args.yes), args.backend, progress
        )
    return {
        "answer": found.text,
        "answered_by": found.answered_by,
        "evidence": found.evidence,
        "text": f"[{found.answered_by}] {found.text}",
    }
