"""`f4x ask`."""

from __future__ import annotations

import argparse
from typing import Any

from ..edit.apply import open_scene
from ..edit.resolve import named
from ..errors import F4xError
from ..progress import Progress
from ..query.chat import ChatServer
from ..query.questions import Answer, answer, ask_features
from .doubts import asking_for_yes
from .encoding import encoder
from .querying import read_selection
from .rendering import trajectory_of


def run_ask(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Answer a question about a scene, and say whether a model or a computation answered."""
    scene = open_scene(args.scene, args.edits)
    views = trajectory_of(scene, args.path, args.degrees)
    if args.select is not None and (args.model is not None or args.endpoint is not None):
        raise F4xError(
            "--select tells a computed answer what 'it' is; a model sees whole pictures, so leave out one of them."
        )
    selected = None if args.select is None else read_selection(args.select)
    if args.model is not None:
        from ..features.models.smolvlm import SmolVlm

        found: Answer = ask_features(scene, args.question, views, SmolVlm(args.model), args.backend, progress)
    else:
        server = ChatServer.from_environment(args.endpoint)
        options: dict[str, Any] = {"encode": encoder(progress), "backend": args.backend, "progress": progress}
        options |= {"server": server, "names": named(scene, selected), "agreed": args.yes}
        with asking_for_yes():
            found = answer(scene, args.question, views, **options)
    return {
        "answer": found.text,
        "answered_by": found.answered_by,
        "evidence": found.evidence,
        "text": f"[{found.answered_by}] {found.text}",
    }
