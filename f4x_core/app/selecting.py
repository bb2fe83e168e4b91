"""Selections by words and marks on a clip's pictures, and the files that hold a selection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..clip import write_video
from ..clip.images import list_images, read_mask
from ..edit.apply import edited
from ..edit.json_files import read_json
from ..edit.naming import by_words, together
from ..errors import F4xError
from ..files import json_text, replace_file
from ..progress import Progress, silent
from ..query.marks import Box, Mark, Mask, Point
from ..query.matte import mask_video
from ..query.pixels import SHOWN, coverage_image, heat_map
from ..query.prompts import (
    SelectOptions,
    at_clip_size,
    select_by_box,
    select_by_evidence,
    select_by_mask,
    select_by_points,
)
from ..query.score import THRESHOLD
from ..query.selection import Selection
from ..scene import Scene
from .encoding import encoder
from .paths import Film

SELECTION = "selection.json"
"""File of a selection in a folder of `write_selection`."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """A request: words, marks on a frame of the clip, or both together."""

    words: tuple[str, ...] = ()
    """Words for it."""
    negatives: tuple[str, ...] | None = None
    """Words that these are weighed against; None: what the field of the scene is usually weighed against."""
    marks: tuple[Mark, ...] = ()
    """Points, boxes, strokes, lassos and masks on it, or on what is not meant."""
    part: bool = False
    """True to select the part of the body at a point, not the whole person."""
    threshold: float = THRESHOLD
    """Smallest score of a selected Gaussian, 0 to 1."""
    span: tuple[float, float] | None = None
    """First and last clip frame at which the selection holds; None: always."""


@dataclass(frozen=True, eq=False)
class Found:
    """A selection, and where words alone were asked for what each of them selects."""

    selection: Selection
    """All of it."""
    by_word: dict[str, Selection] = field(default_factory=dict)
    """Word -> what it selects."""


def select(scene: Scene, wanted: Wanted, backend: str = "auto", progress: Progress = silent) -> Found:
    """Select the Gaussians that are meant, in the scene with its edits.

    Words are names that edits gave and labels of the feature field. One point, box or mask is followed through the clip as a
    prompt; several marks, and marks with words, are evidence on one graph.

    Raises:
        F4xError: a word that nobody knows, a mark outside the picture or the clip, marks on nothing.
    """
    scene, words = edited(scene), list(wanted.words)
    negatives = None if wanted.negatives is None else list(wanted.negatives)
    if not wanted.marks:
        found = by_words(scene, words, negatives, wanted.threshold, encode=encoder(progress), span=wanted.span)
        return Found(together(found), found)
    options = SelectOptions(wanted.threshold, wanted.span, part=wanted.part, backend=backend, progress=progress)
    if len(wanted.marks) == 1 and not words and wanted.marks[0].on:
        prompted = _prompted(scene, wanted.marks[0], options)
        if prompted is not None:
            return Found(prompted)
    meant = together(by_words(scene, words, negatives, wanted.threshold, encode=encoder(progress))) if words else None
    selection = select_by_evidence(scene, wanted.marks, meant, options)
    _require_free(scene, wanted.marks, selection, backend)
    return Found(selection)


def _require_free(scene: Scene, marks: Sequence[Mark], selection: Selection, backend: str) -> None:
    """Raise F4xError where a point on what is not meant is selected all the same."""
    for mark in marks:
        if isinstance(mark, Point) and not mark.on:
            x, y = np.asarray(mark.at, float).reshape(2)
            moment = float(scene.cameras.times[mark.frame])
            covered = coverage_image(scene, selection, scene.cameras.at(moment), moment, backend)
            if covered[int(y), int(x)] > SHOWN:
                raise F4xError(
                    f"What is at {x:g},{y:g}, beside the thing, is selected all the same: the two are one thing in this scene. Draw"
                    " a box or a lasso around the thing, or give a mask of it."
                )


def _prompted(scene: Scene, mark: Mark, options: SelectOptions) -> Selection | None:
    """Return the selection by one mark as a prompt of its kind; None for a mark that is no prompt."""
    if isinstance(mark, Point):
        return select_by_points(scene, np.reshape(mark.at, (1, 2)), mark.frame, options=options)
    if isinstance(mark, Box):
        return select_by_box(scene, mark.corners, mark.frame, options)
    if isinstance(mark, Mask):
        return select_by_mask(scene, np.asarray(mark.mask), mark.frame, options)
    return None


def write_selection(
    scene: Scene, selection: Selection, film: Film, folder: Path, backend: str = "auto", progress: Progress = silent
) -> None:
    """Write `folder/selection.json`, `mask/00000.png` … and `heat.mp4` with the scores over the grey picture."""
    from PIL import Image  # Blender has none

    (folder / "mask").mkdir(parents=True, exist_ok=True)
    with replace_file(folder / SELECTION) as file:
        file.write(json_text(selection.to_json()).encode())

    def images() -> Iterator[np.ndarray]:
        for index, shown in enumerate(mask_video(scene, selection, film.views, backend, progress=progress)):
            with replace_file(folder / "mask" / f"{index:05d}.png") as file:
                Image.fromarray((shown.matte > SHOWN).astype(np.uint8) * 255).save(file, "PNG")
            yield heat_map(shown.picture, shown.scores)

    write_video(folder / "heat.mp4", images(), scene.fps, film.times)


def read_selection(file: Path) -> Selection:
    """Return the selection that `write_selection` left in a file. Raises F4xError that names the file."""
    data = read_json(file, f"the {SELECTION} that `f4x query SCENE … -o DIR` leaves")
    try:
        return Selection.from_json(data)
    except F4xError as error:
        raise F4xError(f"{file}: {error}") from error


def read_masks(folder: Path, scene: Scene) -> dict[int, np.ndarray]:
    """Clip frame -> (H,W) bool of a folder with one picture for each frame, at the size of the scene's pictures."""
    files = list_images(folder)
    if len(files) != len(scene.cameras):
        raise F4xError(
            f"--masks {folder}: it has {len(files)} pictures, the clip {len(scene.cameras)} frames; give one each."
        )
    return {t: mask_of(file, scene) for t, file in enumerate(files)}


def mask_of(file: Path, scene: Scene) -> np.ndarray:
    """Return (H,W) bool of the picture `file` at the size of the scene's pictures; F4xError for colours or another aspect."""
    try:
        return at_clip_size(read_mask(file, colours=False), scene.cameras)
    except F4xError as error:
        message = str(error)
        raise F4xError(message if message.startswith(str(file)) else f"{file}: {message}") from error
