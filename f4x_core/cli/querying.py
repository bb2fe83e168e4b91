"""`f4x query` and `f4x name`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..clip import write_video
from ..clip.images import list_images, read_mask
from ..edit.apply import open_scene, with_operations
from ..edit.json_files import read_json
from ..edit.naming import by_names, by_words, together
from ..edit.operations import Name
from ..edit.selects import Ids
from ..edit.stack import of, write_stack
from ..errors import F4xError
from ..files import json_text, replace_file
from ..language.lexicon import spellings
from ..progress import Progress
from ..query.inventory import instead, labels_of
from ..query.labels import Encode, words_of
from ..query.marks import Box, Brush, Lasso, Mark, Mask, Point
from ..query.pixels import coverage_image, heat_map, mask_video
from ..query.prompts import at_clip_size, select_by_box, select_by_evidence, select_by_mask, select_by_points
from ..query.score import THRESHOLD
from ..query.selection import Selection
from ..scene import Scene, updating
from ..scene.posing import require_time
from ..scene.view import render
from .encoding import encoder
from .rendering import times_of, trajectory_of

SELECTION = "selection.json"
MARKS = ("text", "point", "box", "brush", "lasso", "mask")
"""Options that say what is meant, in any mix."""
ALONE = ("point", "box", "mask")
"""Those of them that are solved as a prompt of one kind where nothing else is given: a mask is followed."""


def run_query(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Select Gaussians by words or by a prompt on one frame; with -o write masks, a heat map video and the selection."""
    if not 0 <= args.threshold <= 1:
        raise F4xError(f"--threshold {args.threshold:g}: give a number from 0 to 1.")
    scene = open_scene(args.scene, args.edits)
    span = _span(scene, args.span) if args.span is not None else None
    views = trajectory_of(scene, args.path, args.degrees)
    selection, by_word = chosen_by(scene, args, span, progress)
    result: dict[str, Any] = {
        "label": selection.label,
        "chosen": int(selection.chosen.sum()),
        "static": int(selection.chosen[~scene.moving].sum()),
        "gaussians": len(selection.ids),
        "threshold": selection.threshold,
        "span": selection.span,
    }
    lines = [
        f"{selection.label}: {result['chosen']} of {result['gaussians']} Gaussians, {result['static']} of them static"
    ]
    absent: list[str] = []
    if selection.remarks:
        lines += selection.remarks
        result["remarks"] = [*selection.remarks]
    if by_word:
        result["missing"] = [word for word, each in by_word.items() if not each.chosen.any()]
        absent = [_empty_line(by_word[word]) for word in result["missing"]]
    if not result["chosen"]:
        given_names = by_names(scene, list(by_word))
        asked = [word for word in by_word if word not in given_names]
        result["there"], hint = instead(scene, asked, encoder(progress)) if asked else ([], "")
        if not args.if_any:
            raise F4xError(_empty_line(selection, hint) + ".")
        absent, lines = [_empty_line(selection, hint)], []
    if absent:
        lines += absent
        result["note"] = "; ".join(absent)
    if args.output is not None:
        _write(scene, selection, views, args, progress)
        result["output"] = str(args.output)
        lines.append(f"{args.output}: selection.json, mask/ with {len(views)} pictures, heat.mp4")
    return {**result, "text": "\n".join(lines)}


def run_name(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Make a word of a selection: a `name` edit, which words in queries, questions and sentences then mean."""
    with updating(args.scene):
        return _name(args, progress)


def _name(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Read the scene, append the name and write it."""
    from ..edit.phrases import refuse_as_name  # the grammar: no query needs it

    scene = open_scene(args.scene)
    word = " ".join(args.word.split())
    refuse_as_name(word)
    args.negatives, args.threshold = None, THRESHOLD
    selection, _ = chosen_by(scene, args, None, progress)
    chosen = selection.chosen_ids
    if not len(chosen):
        raise F4xError(_empty_line(selection) + ".")
    write_stack(args.scene, of(with_operations(scene, Name(Ids.of(chosen), word))))
    text = f"{args.scene}: '{word}' is {len(chosen):,} Gaussians; it answers to that name from now on"
    known = {label.lower() for label in labels_of(scene)}
    replaced = "name" if by_names(scene, [word]) else "word" if known.intersection(spellings(word)) else ""
    if replaced:
        before = "an earlier edit called so" if replaced == "name" else "the scene's own word meant"
        text += f", in place of what {before}; `f4x undo` brings that back"
    return {"name": word, "chosen": len(chosen), "replaced": replaced, "text": text}


def read_masks(folder: Path, scene: Scene) -> dict[int, np.ndarray]:
    """Clip frame -> (H,W) bool of a folder with one picture for each frame, at the size of the scene's pictures."""
    files = list_images(folder)
    if len(files) != len(scene.cameras):
        raise F4xError(
            f"--masks {folder}: it has {len(files)} pictures, the clip {len(scene.cameras)} frames; give one each."
        )
    return {t: mask_of(file, scene) for t, file in enumerate(files)}


def mask_of(file: Path, scene: Scene) -> np.ndarray:
    """(H,W) bool of the picture `file` at the size of the scene's pictures; F4xError for colours or another aspect."""
    try:
        return at_clip_size(read_mask(file, colours=False), scene.cameras)
    except F4xError as error:
        message = str(error)
        raise F4xError(message if message.startswith(str(file)) else f"{file}: {message}") from error


def _by_words(
    scene: Scene, args: argparse.Namespace, span: tuple[float, float] | None, encode: Encode
) -> dict[str, Selection]:
    """Word of --text -> what it selects."""
    if args.frame is not None or args.beside is not None:
        raise F4xError("--frame goes with marks on the thing; words are asked of the whole clip (--span A:B).")
    negatives = words_of(args.negatives) if args.negatives is not None else None
    return by_words(scene, words_of(args.text), negatives, args.threshold, encode=encode, span=span)


def read_selection(file: Path) -> Selection:
    """The selection that `f4x query -o DIR` left in a file; F4xError."""
    data = read_json(file, f"the {SELECTION} that `f4x query SCENE … -o DIR` leaves")
    try:
        return Selection.from_json(data)
    except F4xError as error:
        raise F4xError(f"{file}: {error}") from error


def chosen_by(
    scene: Scene, args: argparse.Namespace, span: tuple[float, float] | None, progress: Progress
) -> tuple[Selection, dict[str, Selection]]:
    """What the arguments select, and what each word does where words alone are given."""
    given = [name for name in MARKS if getattr(args, name) is not None]
    if not given:
        kinds = ", ".join(f"--{name}" for name in MARKS)
        raise F4xError(f"give at least one of {kinds}, alone or together; got none.")
    if getattr(args, "part", False) and given != ["point"]:
        raise F4xError("--part goes with --point alone: it selects the part of the person's body there.")
    if given == ["text"]:
        by_word = _by_words(scene, args, span, encoder(progress))
        return together(by_word), by_word
    if len(given) == 1 and args.beside is None and given[0] in ALONE:
        return _selection(scene, args, given[0], span, progress), {}
    return _evidence(scene, args, span, progress), {}


def _evidence(
    scene: Scene, args: argparse.Namespace, span: tuple[float, float] | None, progress: Progress
) -> Selection:
    """Several kinds of evidence at once: marks on the thing and beside it, and words."""
    if args.frame is None:
        raise F4xError("Marks need --frame T: the clip frame that they are on.")
    if args.negatives is not None and args.text is None:
        raise F4xError("--not goes with --text; for a pixel on what is not meant say --beside.")
    words = None
    if args.text is not None:
        negatives = words_of(args.negatives) if args.negatives is not None else None
        words = together(by_words(scene, words_of(args.text), negatives, args.threshold, encode=encoder(progress)))
    options: dict[str, Any] = {"backend": args.backend, "progress": progress}
    return select_by_evidence(scene, _marks(scene, args), words, args.threshold, span, **options)


def _marks(scene: Scene, args: argparse.Namespace) -> list[Mark]:
    """The marks on `--frame`."""
    frame = args.frame
    marks: list[Mark] = [
        Point(frame, on, _numbers(text, 2, flag, "X,Y"))
        for text, flag, on in ((args.point, "--point", True), (args.beside, "--beside", False))
        if text is not None
    ]
    if args.box is not None:
        marks.append(Box(frame, True, _numbers(args.box, 4, "--box", "X0,Y0,X1,Y1")))
    if args.brush is not None:
        marks.append(Brush(frame, True, _line(args.brush, "--brush"), args.brush_width / 2))
    if args.lasso is not None:
        marks.append(Lasso(frame, True, _line(args.lasso, "--lasso")))
    if args.mask is not None:
        marks.append(Mask(frame, True, mask_of(args.mask, scene)))
    return marks


def _line(text: str, flag: str) -> list[list[float]]:
    """[[x, y], ...] of "X,Y X,Y …"."""
    return [_numbers(pair, 2, flag, "'X,Y X,Y …'") for pair in text.split()]


def _selection(
    scene: Scene, args: argparse.Namespace, kind: str, span: tuple[float, float] | None, progress: Progress
) -> Selection:
    if args.negatives is not None:
        raise F4xError("--not goes with --text; for a pixel on what is not meant say --beside.")
    if args.frame is None:
        flag = "click" if args.verb == "name" and kind == "point" else kind
        raise F4xError(f"--{flag} needs --frame T: the clip frame that it belongs to.")
    options: dict[str, Any] = {
        "threshold": args.threshold,
        "span": span,
        "backend": args.backend,
        "progress": progress,
    }
    if kind == "point":
        options["part"] = getattr(args, "part", False)
        return select_by_points(scene, [_numbers(args.point, 2, "--point", "X,Y")], args.frame, **options)
    if kind == "box":
        return select_by_box(scene, _numbers(args.box, 4, "--box", "X0,Y0,X1,Y1"), args.frame, **options)
    return select_by_mask(scene, mask_of(args.mask, scene), args.frame, **options)


def _empty_line(selection: Selection, hint: str = "") -> str:
    """The line that reports an empty selection."""
    best = float(selection.scores.max(initial=0))
    end = hint and f"; {hint}"
    return f"{selection.label}: nothing in the scene answers to it with {selection.threshold:g} or more (best: {best:.2f}){end}"


def _numbers(text: str, count: int, flag: str, form: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise F4xError(f"{flag} {text}: write {form} in pixels, for example {flag} {','.join(['120'] * count)}.")
    return numbers


def _span(scene: Scene, text: str) -> tuple[float, float]:
    try:
        first, last = (float(part) for part in text.split(":"))
    except ValueError as error:
        raise F4xError(f"--span {text}: write A:B, the first and the last clip frame.") from error
    for time in (first, last):
        require_time(scene, time, f"--span {text}")
    if first > last:
        raise F4xError(f"--span {text}: it ends before it starts.")
    return first, last


def _write(scene: Scene, selection: Selection, views, args: argparse.Namespace, progress: Progress) -> None:
    """selection.json, mask/00000.png …, heat.mp4 (scores over the grey picture)."""
    from PIL import Image

    folder, backend = args.output, args.backend
    (folder / "mask").mkdir(parents=True, exist_ok=True)
    with replace_file(folder / SELECTION) as file:
        file.write(json_text(selection.to_json()).encode())

    def images() -> Iterator[np.ndarray]:
        for index, weights in enumerate(mask_video(scene, selection, views, backend, progress=progress)):
            with replace_file(folder / "mask" / f"{index:05d}.png") as file:
                Image.fromarray((weights > 0.5).astype(np.uint8) * 255).save(file, "PNG")
            camera, time = views[index]
            rgb = render(scene, camera, time, ("rgb",), backend)["rgb"]
            yield heat_map(rgb, coverage_image(scene, selection, camera, time, backend, soft=True))

    write_video(folder / "heat.mp4", images(), scene.fps, times_of(scene, args.path))
