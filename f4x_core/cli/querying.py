"""`f4x query` and `f4x name`."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..app.encoding import encoder
from ..app.paths import Film
from ..app.selecting import Wanted, mask_of, select, write_selection
from ..edit.apply import open_scene, with_operations
from ..edit.naming import by_names
from ..edit.operations import Name
from ..edit.selects import Ids
from ..edit.stack import of, write_stack
from ..errors import F4xError
from ..language.lexicon import spellings
from ..progress import Progress
from ..query.inventory import instead, labels_of
from ..query.labels import words_of
from ..query.marks import Box, Brush, Lasso, Mark, Mask, Point
from ..query.score import THRESHOLD
from ..query.selection import Selection
from ..scene import Scene, updating
from ..scene.posing import require_time

MARKS = ("text", "point", "box", "brush", "lasso", "mask")
"""Options that say what is meant, in any mix."""
ALONE = ("point", "box", "mask")
"""Marks that are solved as a prompt of one kind where nothing else is given: a mask is followed."""


def run_query(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Select Gaussians by words or by a prompt on one frame; with -o write masks, a heat map video and the selection."""
    if not 0 <= args.threshold <= 1:
        raise F4xError(f"--threshold {args.threshold:g}: give a number from 0 to 1.")
    scene = open_scene(args.scene, args.edits)
    span = _span(scene, args.span) if args.span is not None else None
    film = Film.along(scene, args.path, args.degrees)
    found = select(scene, wanted_of(scene, args, span), args.backend, progress)
    selection, by_word = found.selection, found.by_word
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
        write_selection(scene, selection, film, args.output, args.backend, progress)
        result["output"] = str(args.output)
        lines.append(f"{args.output}: selection.json, mask/ with {len(film.views)} pictures, heat.mp4")
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
    selection = select(scene, wanted_of(scene, args), args.backend, progress).selection
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


def wanted_of(scene: Scene, args: argparse.Namespace, span: tuple[float, float] | None = None) -> Wanted:
    """Return the request that the arguments make. Raises F4xError for options that do not go together."""
    given = [name for name in MARKS if getattr(args, name) is not None]
    if not given:
        kinds = ", ".join(f"--{name}" for name in MARKS)
        raise F4xError(f"give at least one of {kinds}, alone or together; got none.")
    part = getattr(args, "part", False)
    if part and given != ["point"]:
        raise F4xError("--part goes with --point alone: it selects the part of the person's body there.")
    only_words = given == ["text"]
    if only_words and (args.frame is not None or args.beside is not None):
        raise F4xError("--frame goes with marks on the thing; words are asked of the whole clip (--span A:B).")
    if args.negatives is not None and args.text is None:
        raise F4xError("--not goes with --text; for a pixel on what is not meant say --beside.")
    if not only_words and args.frame is None:
        raise F4xError(_needs_frame(given, args))
    words = () if args.text is None else tuple(words_of(args.text))
    negatives = None if args.negatives is None else tuple(words_of(args.negatives))
    marks = () if only_words else tuple(_marks(scene, args))
    return Wanted(words, negatives, marks, part, args.threshold, span)


def _needs_frame(given: list[str], args: argparse.Namespace) -> str:
    """Return the sentence about marks without `--frame`."""
    if len(given) > 1 or args.beside is not None or given[0] not in ALONE:
        return "Marks need --frame T: the clip frame that they are on."
    flag = "click" if args.verb == "name" and given == ["point"] else given[0]
    return f"--{flag} needs --frame T: the clip frame that it belongs to."


def _marks(scene: Scene, args: argparse.Namespace) -> list[Mark]:
    """Return the marks on `--frame`."""
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
    """Parse "X,Y X,Y …" as [[x, y], ...]."""
    return [_numbers(pair, 2, flag, "'X,Y X,Y …'") for pair in text.split()]


def _empty_line(selection: Selection, hint: str = "") -> str:
    """Return the line that reports an empty selection."""
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
