"""From words, points, boxes and masks to scores of Gaussians."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import ArrayLike

from ..clip.images import resize_nearest
from ..errors import F4xError
from ..features.models.prompt import check_frame, check_prompt
from ..geometry.camera import CameraPath
from ..language.cast_words import caster, is_cast
from ..progress import Progress, silent
from ..scene import Scene
from .blend_weights import lift_masks
from .calibration import word_probabilities
from .cast import cast_of, without_shadow
from .floaters import floater_scores, is_floaters
from .following import FollowConfig, decoder_of, follow_masks, follow_thing
from .labels import Encode, TextQuery, ask_for
from .marks import Mark, check_marks, marks_of
from .not_deleted import not_deleted
from .objects import point_out
from .people import is_of_people, person_at, rows_of_people
from .pixels import label_scores
from .score import THRESHOLD, target_score
from .segmentation import MaskDecoder
from .selection import Selection, fingerprint

SEEN, INSIDE, OUTSIDE = 1.0, 0.7, 0.3
"""A moving Gaussian of so much blend weight, in pixels, on frames with masks is in the thing if at least the fraction `INSIDE` of
it is in the masks, and is not if at most `OUTSIDE` is. On four filmed clips a first-frame mask then finds .007 more (IoU); with
2 or .5 pixels, or .2 and .6, the same within .001."""
ASPECT_TOLERANCE = 0.01
"""Relative difference of aspects up to which a mask is taken for one of the clip: rounding to even sizes changes it so."""


def select_by_text(
    scene: Scene,
    labels: Sequence[str],
    negatives: Sequence[str] | None = None,
    threshold: float = THRESHOLD,
    *,
    head: str | None = None,
    encode: Encode | None = None,
    span: tuple[float, float] | None = None,
    calibrated: bool = True,
) -> Selection:
    """Gaussians whose decoded latent matches one of `labels` better than any of `negatives` (see `labels.ask_for`).

    Scores are probabilities for which 0.5 is the natural threshold; see `text_selection`. Shadows and the like are found by what
    is behind them (`cast`), floaters by what is around them (`floaters`). This and every other selection leaves out what edits
    have deleted (`not_deleted`).
    """
    cast = [label for label in labels if is_cast(label)]
    floaters = [label for label in labels if is_floaters(label)]
    people = [label for label in labels if is_of_people(scene, label)]
    things = [label for label in labels if label not in (*cast, *floaters, *people)]
    parts = []
    for label in people:
        rows = rows_of_people(scene, label)
        parts.append(_selection(scene, rows.astype(float), np.zeros(len(rows), bool), threshold, span, label))
    for label in floaters:
        scores = floater_scores(scene)
        parts.append(_selection(scene, scores, np.zeros(len(scores), bool), threshold, span, label))
    for label in cast:
        whose = caster(label)
        casting = [whose] if whose is not None else [*people, *things]  # "the dog and its shadow"
        by = select_by_text(scene, casting, negatives, head=head, encode=encode).chosen if casting else None
        parts.append(_selection(scene, cast_of(scene, by), np.zeros(len(scene.ids), bool), threshold, span, label))
    if things or not parts:
        query = ask_for(scene, things, negatives, head, encode)
        parts.append(text_selection(scene, query, threshold, span, calibrated=calibrated))
    return reduce(or_, parts)


def text_selection(
    scene: Scene,
    query: TextQuery,
    threshold: float = THRESHOLD,
    span: tuple[float, float] | None = None,
    *,
    calibrated: bool = True,
) -> Selection:
    """The selection of a query: score = probability that a Gaussian belongs to a target (`calibration`), and no wins.

    With `calibrated` False, or where the text encoder has no null vector, the rule of Feature4X: score = summed softmax of
    the targets, wins = a target is the best label.
    """
    names = ", ".join(query.labels[: query.targets])
    probability = word_probabilities(scene, query) if calibrated else None
    if probability is not None:
        probability = without_shadow(scene, probability)
        return _selection(scene, probability, np.zeros(len(probability), bool), threshold, span, names)
    total, best = target_score(label_scores(query, scene.latents()), range(query.targets))
    return _selection(scene, np.clip(total, 0, 1), best, threshold, span, names)


def select_by_mask(scene: Scene, mask: np.ndarray, frame: int, **options) -> Selection:
    """Gaussians of what the bool `mask (H,W)` shows on clip frame `frame`; options of `select_by_prompts`.

    A mask of another size than the clip's pictures is scaled; F4xError where its aspect is another (`at_clip_size`).
    """
    check_frame(frame, len(scene.cameras))
    return select_by_prompts(scene, {frame: {"mask": at_clip_size(np.asarray(mask) > 0, scene.cameras)}}, **options)


def at_clip_size(mask: np.ndarray, cameras: CameraPath) -> np.ndarray:
    """`mask (h,w)` bool at the size (H,W) of the clip's pictures; F4xError where the aspects differ by more than 1 %."""
    if mask.ndim != 2:
        raise F4xError(f"The mask has shape {mask.shape}; give one number for each pixel.")
    (height, width), (wide, high) = mask.shape, (cameras.width, cameras.height)
    if not width or not height or abs(width * high / (height * wide) - 1) > ASPECT_TOLERANCE:
        raise F4xError(
            f"The mask has {width}x{height} pixels, the clip's pictures {wide}x{high}; give a mask of the whole picture, at"
            " that size or in its proportions."
        )
    return resize_nearest(mask, wide, high)


def select_by_points(
    scene: Scene, points: ArrayLike, frame: int, labels: ArrayLike | None = None, **options
) -> Selection:
    """Gaussians of the object at `points (n,2)` (x, y in pixels; `labels (n,)` False = beside it) on clip frame `frame`."""
    return select_by_prompts(scene, {frame: {"points": points, "labels": labels}}, **options)


def select_by_box(scene: Scene, box: ArrayLike, frame: int, **options) -> Selection:
    """Gaussians of the object in `box` (left, top, right, bottom in pixels) on clip frame `frame`."""
    return select_by_prompts(scene, {frame: {"box": box}}, **options)


def select_by_prompts(
    scene: Scene,
    prompts: dict[int, dict],
    *,
    threshold: float = THRESHOLD,
    span: tuple[float, float] | None = None,
    part: bool = False,
    decoder: MaskDecoder | None = None,
    config: FollowConfig | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> Selection:
    """Gaussians of one object that is prompted on one frame or several: `{clip frame: arguments of MaskDecoder.prompt}`.

    Points and boxes on moving Gaussians select a moving object in all frames at once (`objects.point_out`). Otherwise, and with
    a `decoder` always, the decoder (features of the scene when None, see `decoder_of`) carries the prompts to the other frames
    as masks. A Gaussian's score is then the fraction of its blend weights inside the masks, or its neighbours' mean score where it
    has none. If the prompt is clearly on moving or on static Gaussians, only those are selected. A point on a person, where the
    scene knows its people, selects that person, with `part` that part of the body.

    Raises F4xError: no prompt, an empty or contradictory one, a point outside the picture, a frame outside the clip.
    """
    config = config or FollowConfig()
    cameras = scene.cameras
    if not prompts:
        raise F4xError("Nothing is prompted; give a point, a box or a mask on some frame.")
    size = (cameras.height, cameras.width)
    for frame in prompts:
        check_frame(frame, len(cameras))
    checked = {frame: check_prompt(size, **prompt) for frame, prompt in prompts.items()}
    label = _marked_at(prompts)
    if decoder is None and all(prompt.mask is None for prompt in checked.values()):
        marks = [mark for frame, prompt in checked.items() for mark in marks_of(frame, prompt)]
        if len(marks) == 1 and marks[0].on and not marks[0].around:  # a click on a person means the person
            person = person_at(scene, marks[0].pixels(size) > 0, marks[0].frame, part)
            if person is not None:
                return _selection(scene, person.astype(float), np.zeros(len(person), bool), threshold, span, label)
        chosen = point_out(scene, marks)
        if chosen is not None:
            scores = follow_thing(scene, chosen, prompts, config, backend, progress)
            return _selection(scene, scores, np.zeros(len(scores), bool), threshold, span, label)
    exact: dict[int, np.ndarray] = {}
    if decoder is None:
        decoder = decoder_of(scene, backend)
        exact = {
            frame: np.asarray(prompt["mask"]) > 0 for frame, prompt in prompts.items() if prompt.get("mask") is not None
        }
    masks = {}
    for frame, prompt in prompts.items():
        logits = decoder.prompt(frame, **prompt)
        masks[frame] = np.asarray(prompt["mask"] if prompt.get("mask") is not None else logits > 0, np.float32)
        if not masks[frame].any():
            raise F4xError(
                f"The prompt on frame {frame} marks nothing that stands out there; give a mask, or another point."
            )
    scores = follow_masks(scene, masks, decoder, config, progress)
    scores = _as_in_masks(scene, without_shadow(scene, scores) if exact else scores, exact)
    return _selection(scene, scores, np.zeros(len(scores), bool), threshold, span, label)


def select_by_evidence(
    scene: Scene,
    marks: Sequence[Mark],
    words: Selection | None = None,
    threshold: float = THRESHOLD,
    span: tuple[float, float] | None = None,
    *,
    backend: str = "auto",
    progress: Progress = silent,
) -> Selection:
    """Gaussians of the thing that marks of any kinds and a word show together: evidence on one graph (`objects.point_out`).

    `marks`: `marks.Point`, `Box`, `Brush`, `Lasso` and `Mask`, on one frame or several, on the thing or (`on` False) on what is
    not meant; `words`: what words select, whose scores count as probabilities. Raises F4xError: marks that are empty, outside
    the clip or on nothing, or that leave nothing.
    """
    chosen = point_out(scene, check_marks(marks, len(scene.cameras)), None if words is None else words.scores)
    if chosen is None:
        raise F4xError("Nothing is left of what is marked there; leave a mark out, or mark another place.")
    frames = sorted({mark.frame for mark in marks})
    scores = follow_thing(scene, chosen, frames, FollowConfig(), backend, progress)
    size = (scene.cameras.height, scene.cameras.width)
    masks: dict[int, np.ndarray] = {}
    for mark in marks:
        if mark.on and mark.exact and mark.around:
            masks[mark.frame] = masks.get(mark.frame, False) | mark.pixels(size)
    scores = _as_in_masks(scene, scores, masks, adds=all(mark.on for mark in marks))
    label = _marked_at(frames)
    label = label if words is None else f"{words.label}, {label}"
    return _selection(scene, scores, np.zeros(len(scores), bool), threshold, span, label)


def _as_in_masks(scene: Scene, scores: np.ndarray, masks: Mapping[int, np.ndarray], adds: bool = True) -> np.ndarray:
    """`scores (N,)` of a thing, of moving Gaussians that `masks` (clip frame -> (H,W) bool) show clearly by the masks alone.

    Without `adds` none is added, because other marks may speak against it.
    """
    if not masks or not scores[scene.moving].any():
        return scores
    fraction, total = lift_masks(scene, {frame: mask.astype(np.float32) for frame, mask in masks.items()})
    sure = scene.moving & (total > SEEN)
    scores = np.where(sure & (fraction <= OUTSIDE), 0, scores)
    return np.where(sure & (fraction >= INSIDE), 1, scores) if adds else scores


def _marked_at(frames: Iterable[int]) -> str:
    return f"what is marked at frame {', '.join(map(str, frames))}"


def _selection(scene, scores, wins, threshold, span, label) -> Selection:
    if span is not None:
        first, last = scene.cameras.times[[0, -1]]
        if not first <= span[0] <= span[1] <= last:
            raise F4xError(
                f"The span {span[0]:g}:{span[1]:g} does not lie within the clip's frames, {first:g} to {last:g}."
            )
    return Selection(scene.ids, scores, wins, threshold, span, label, fingerprint(scene)).among(not_deleted(scene))
