"""`f4x render`."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

from ..app.render_options import RenderOptions
from ..app.rendering import render_path
from ..edit.apply import open_scene
from ..language.lexicon import plural
from ..progress import Progress


def run_render(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write the pictures of a scene along a camera path."""
    given = {entry.name: getattr(args, entry.name) for entry in fields(RenderOptions)}
    options = RenderOptions(**{**given, "channels": tuple(args.channels.split(","))})
    done = render_path(open_scene(args.scene, args.edits), Path(args.output), options, progress)
    result: dict[str, Any] = {"frames": done.frames, "output": str(args.output)}
    text = ", ".join([f"{args.output}: {done.frames} {plural('frame', done.frames)}", *done.films])
    if done.frames == 0:
        text += f"; {done.of_all} frames in {args.part.split('/')[1]} parts leave nothing for --part {args.part}"
    if done.black:
        result["note"] = f"nothing in the scene answers to {', '.join(done.black)}: black pictures"
        text += f"; {result['note']}"
    if done.beyond:
        result["beyond"] = done.beyond
        text += f"\n! {done.beyond}"
    return {**result, "text": text}
