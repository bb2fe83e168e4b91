"""`f4x open`."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..app.encoding import encoder
from ..edit.apply import base_of, edited
from ..edit.bake import bake
from ..edit.naming import by_words
from ..errors import F4xError
from ..progress import Progress
from ..scene import Scene
from ..scene.file import read_scene
from ..scene.foreign import notes_of, open_any
from ..scene.formats.web import PageOptions, write_page
from ..scene.recognise import identify


def run_open(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write a scene as one HTML page and show it in the browser, or only write it."""
    if args.degrees is not None and not 0 <= args.degrees < 90:
        raise F4xError(f"--degrees {args.degrees:g}: give a number from 0 to below 90.")
    scene = _scene_of(args)
    words = [word.strip() for word in (args.word or "").split(",") if word.strip()]
    found = by_words(edited(scene), words, encode=encoder(progress)) if words else {}
    marks = {word: selection.chosen for word, selection in found.items()}
    path = args.write or Path(tempfile.mkdtemp(prefix="f4x_")) / "scene.html"
    notes = [*notes_of(scene), *write_page(base_of(scene), path, PageOptions(args.degrees, marks))]
    megabytes = path.stat().st_size / 1e6
    text = "; ".join([f"{path}: {megabytes:.1f} MB", *notes])
    if scene.edits:
        text += f"; {len(scene.edits)} edits change with time in a way that the page cannot show"
    absent = [word for word, chosen in marks.items() if not chosen.any()]
    if absent:
        text += f"; nothing in the scene answers to {', '.join(absent)}"
    if args.write is None and not webbrowser.open(path.absolute().as_uri()):
        text += "; no browser answered, open it yourself"
    return {"output": str(path), "megabytes": megabytes, "edits_left": len(scene.edits), "notes": notes, "text": text}


def _scene_of(args: argparse.Namespace) -> Scene:
    """Return the scene with its edits in its arrays, or one of splats from elsewhere."""
    if identify(args.scene, sequence=False) != "scene":
        opened = open_any(args.scene, sequence=False)
        if not isinstance(opened, Scene):
            raise F4xError(f"{args.scene}: a sequence of files; open one of them.")
        return opened
    scene = read_scene(args.scene)
    return bake(scene) if args.edits and scene.edits else replace(scene, edits=())
