"""From words, points, boxes and masks to scores of Gaussians."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import ArrayLike

from ..clip.images import resize_nearest
from ..errors import F4xError
from ..geometry.camera import CameraPath
from ..language.cast_words import caster
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.people import people_of
from .blend_weights import lift_masks
from .calibration import word_probabilities
from .cast import Source, cast_of, shaped_scores, source_of, without_shadow
from .decoder_prompt import check_frame, check_prompt
from .following import decoder_of, follow_masks, follow_thing
from .labels import Encode, TextQuery, ask_for
from .marks import Mark, check_marks, marks_of
from .not_deleted import not_deleted
from .objects import MOSTLY, graph_of, point_out
from .outlines import within_outlines
from .people import people_beside, person_at, rows_of_people
from .pixels import label_scores
from .score import THRESHOLD, target_score
from .select_config import SELECT, SelectConfig, ThingConfig
from .selection import Selection, fingerprint

ASPECT_TOLERANCE = 0.01
"""Relative difference of aspects up to which a mask is taken for one of the clip: rounding to even sizes changes it so."""

CAST_TOO = 0.1
"""Fraction of a thing's Gaussians that are cast from which several marks mean its shadow or its ripples, too."""


@dataclass(frozen=True)
class SelectOptions:
    """Options of a search, for words and marks alike."""

    threshold: float = THRESHOLD
    """Smallest score of a selected Gaussian, 0 to 1."""
    span: tuple[float, float] | None = None
    """First and last clip frame at which the selection holds; None: always."""
    calibrated: bool = True
    """True if scores of words are probabilities where the text encoder has a null vector; else the rule of Feature4X holds."""
    outlined: bool = True
    """True if what words find ends at its outlines (`outlines`); else where its features end, which is quicker."""
    part: bool = False
    """True to select the part of the body at a point, not the whole person."""
    config: SelectConfig = SELECT
    """The numbers that tune the search."""
    backend: str = "auto"
    """Raster backend."""
    progress: Progress = silent
    """Called with stage, done and total."""


DEFAULT = SelectOptions()


def select_by_text(
    scene: Scene,
    labels: Sequence[str],
    negatives: Sequence[str] | None = None,
    options: SelectOptions = DEFAULT,
    *,
    head: str | None = None,
    encode: Encode | None = None,
) -> Selection:
    """Select Gaussians whose decoded latent matches one of `labels` better than any of `negatives` (see `labels.ask_for`).

    Scores are probabilities for which 0.5 is the natural threshold; see `text_selection`. Shadows and the like are found by what
    is behind them (`cast`), floaters, the ground and the sky by what shape, place and color tell (`cast.SHAPED`). This and every
    other selection leaves out what edits have deleted (`not_deleted`).
    """
    by_source: dict[Source, list[str]] = {"cast": [], "people": [], "shape": [], "teacher": []}
    for label in labels:
        by_source[source_of(scene, label)].append(label)
    people, things = by_source["people"], by_source["teacher"]
    parts = [_selection(scene, rows_of_people(scene, label).astype(float), options, label) for label in people]
    for label in by_source["shape"]:
        if (scores_of := shaped_scores(scene, label)) is not None:
            parts.append(_selection(scene, scores_of(scene), options, label))
    for label in by_source["cast"]:
        whose = caster(label)
        casting = [whose] if whose is not None else [*people, *things]  # "the dog and its shadow"
        by = select_by_text(scene, casting, negatives, head=head, encode=encode).chosen if casting else None
        parts.append(_selection(scene, cast_of(scene, by, options.config), options, label))
    if things or not parts:
        query = ask_for(scene, things, negatives, head, encode)
        parts.append(text_selection(scene, query, options))
    return reduce(or_, parts)


def text_selection(scene: Scene, query: TextQuery, options: SelectOptions = DEFAULT) -> Selection:
    """Return the selection of a query: score = probability that a Gaussian belongs to a target (`calibration`), and no wins.

    Without `options.calibrated`, or where the text encoder has no null vector, the rule of Feature4X: score = summed softmax of
    the targets, wins = a target is the best label. A horse is found without the rider whom the scene knows (`people_beside`).
    """
    targets, wins = query.labels[: query.targets], None
    probability = word_probabilities(scene, query) if options.calibrated else None
    if probability is not None:
        scores = without_shadow(scene, probability, options.config)
        if options.outlined:
            scores = within_outlines(scene, scores, options.threshold, options.config)
    else:
        total, wins = target_score(label_scores(query, scene.latents()), range(query.targets))
        scores = np.clip(total, 0, 1)
    found = _selection(scene, scores, options, ", ".join(targets), wins)
    return found.among(~people_beside(scene, targets, found.chosen))


def select_by_mask(scene: Scene, mask: np.ndarray, frame: int, options: SelectOptions = DEFAULT) -> Selection:
    """Select the Gaussians of what the bool `mask (H,W)` shows on clip frame `frame`.

    A mask of another size than the clip's pictures is scaled; F4xError where its aspect is another (`at_clip_size`).
    """
    check_frame(frame, len(scene.cameras))
    return select_by_prompts(scene, {frame: {"mask": at_clip_size(np.asarray(mask) > 0, scene.cameras)}}, options)


def at_clip_size(mask: np.ndarray, cameras: CameraPath) -> np.ndarray:
    """Return `mask (h,w)` bool at the size (H,W) of the clip's pictures; F4xError where the aspects differ by more than 1 %."""
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
    scene: Scene, points: ArrayLike, frame: int, labels: ArrayLike | None = None, options: SelectOptions = DEFAULT
) -> Selection:
    """Select the object at `points (n,2)` (x, y in pixels; `labels (n,)` False = beside it) on clip frame `frame`."""
    return select_by_prompts(scene, {frame: {"points": points, "labels": labels}}, options)


def select_by_box(scene: Scene, box: ArrayLike, frame: int, options: SelectOptions = DEFAULT) -> Selection:
    """Select the object in `box` (left, top, right, bottom in pixels) on clip frame `frame`."""
    return select_by_prompts(scene, {frame: {"box": box}}, options)


def select_by_prompts(scene: Scene, prompts: dict[int, dict], options: SelectOptions = DEFAULT) -> Selection:
    """Select one object that is prompted on one frame or several: `{clip frame: arguments of check_prompt}`.

    Points and boxes are marks (`objects.point_out`). Masks alone are carried to the other frames by the looks of the scene
    (`following`): a Gaussian's score is then the fraction of its blend weights inside the masks, or its neighbours' mean score
    where it has none. If the masks are clearly on moving or on static Gaussians, only those are selected. A point on a person,
    where the scene knows its people, selects that person, with `options.part` that part of the body.

    Raises F4xError: no prompt, an empty or contradictory one, one that leaves nothing, a point outside the picture, a frame
    outside the clip.
    """
    if not prompts:
        raise F4xError("Nothing is prompted; give a point, a box or a mask on some frame.")
    cameras = scene.cameras
    size = (cameras.height, cameras.width)
    for frame in prompts:
        check_frame(frame, len(cameras))
    checked = {frame: check_prompt(size, **prompt) for frame, prompt in prompts.items()}
    masks = {frame: prompt.mask for frame, prompt in checked.items() if prompt.mask is not None}
    if len(masks) == len(checked):
        scores = _followed(scene, masks, options)
    else:
        marks = [mark for frame, prompt in checked.items() for mark in marks_of(frame, prompt)]
        scores = _pointed_at(scene, marks, None, options)
    return _selection(scene, scores, options, _marked_at(prompts))


def _pointed_at(scene: Scene, marks: Sequence[Mark], likely: np.ndarray | None, options: SelectOptions) -> np.ndarray:
    """Return (N,) scores of the person, or of the thing within its outlines, that marks show, by `likely (N,)` words, too.

    The masks of people are those that the fit found them by, and stay. F4xError where nothing is left.
    """
    person = None if likely is not None else _person_at(scene, marks, options)
    if person is not None:
        return person.astype(float)
    chosen = point_out(scene, marks, likely, options.config)
    if chosen is None:
        raise F4xError("Nothing is left of what is marked there; leave a mark out, or mark another place.")
    frames = sorted({mark.frame for mark in marks})
    scores = follow_thing(scene, chosen, frames, options.config, options.backend, options.progress)
    return scores if options.part else _outlined(scene, scores, marks, options)


def _person_at(scene: Scene, marks: Sequence[Mark], options: SelectOptions) -> np.ndarray | None:
    """Return (N,) bool: the person, or with `options.part` the part of the body, whom the first of `marks` clicks; else None.

    A fit finds a person in some frames and not in others, and clothes, hair and what is carried move along: so the person has all
    that the click points out, where most of that is the person's; a horse is more than its rider. Later marks add and take away
    what they do of things.
    """
    size, first = (scene.cameras.height, scene.cameras.width), marks[0]
    people = people_of(scene)
    if people is None or not first.on or first.around or (options.part and len(marks) > 1):
        return None
    person = person_at(scene, first.pixels(size) > 0, first.frame, options.part)
    alone = None if person is None or options.part else point_out(scene, marks[:1], config=options.config)
    if person is None or alone is None or not alone[scene.moving].any():
        return person if len(marks) == 1 else None
    superpoints, thing = graph_of(scene, options.config).moving, alone > 0
    own, whole = (superpoints.weight @ superpoints.means(rows, np.ones(len(rows))) for rows in (person & thing, thing))
    person = person | thing & (people.person == 0) if own > MOSTLY * whole else person
    chosen = alone if len(marks) == 1 else point_out(scene, marks, config=options.config)
    return None if chosen is None else (person | (chosen > alone)) & (chosen >= alone)


def _followed(scene: Scene, masks: Mapping[int, np.ndarray], options: SelectOptions) -> np.ndarray:
    """Return the scores (N,) of what the scene's own features find of `masks` (clip frame -> (H,W) bool) in all frames."""
    decoder = decoder_of(scene, options.backend)
    for frame, mask in masks.items():
        decoder.prompt(frame, mask)
    prompted = {frame: mask.astype(np.float32) for frame, mask in masks.items()}
    scores = follow_masks(scene, prompted, decoder, options.config.follow, options.progress)
    scores = without_shadow(scene, scores, options.config)
    scores = within_outlines(scene, scores, options.threshold, options.config)
    return _as_in_masks(scene, scores, masks, options.config.thing)


def select_by_evidence(
    scene: Scene, marks: Sequence[Mark], words: Selection | None = None, options: SelectOptions = DEFAULT
) -> Selection:
    """Select the thing that marks of any kinds and a word show together: evidence on one graph (`objects.point_out`).

    `marks`: `marks.Point`, `Box`, `Brush`, `Lasso` and `Mask`, on one frame or several, on the thing or (`on` False) on what is
    not meant; `words`: what words select, whose scores count as probabilities. Raises F4xError: marks that are empty, outside
    the clip or on nothing, or that leave nothing.
    """
    marks = check_marks(marks, len(scene.cameras))
    scores = _pointed_at(scene, marks, None if words is None else words.scores, options)
    size = (scene.cameras.height, scene.cameras.width)
    masks: dict[int, np.ndarray] = {}
    for mark in marks:
        if mark.on and mark.exact and mark.around:
            masks[mark.frame] = masks.get(mark.frame, False) | mark.pixels(size)
    scores = _as_in_masks(scene, scores, masks, options.config.thing, adds=all(mark.on for mark in marks))
    label = _marked_at(sorted({mark.frame for mark in marks}))
    return _selection(scene, scores, options, label if words is None else f"{words.label}, {label}")


def _outlined(scene: Scene, scores: np.ndarray, marks: Sequence[Mark], options: SelectOptions) -> np.ndarray:
    """Return `scores (N,)` of a thing, `within_outlines`; as they are where several marks mean what is cast, too.

    None is added where marks are on what is not meant.
    """
    superpoints = graph_of(scene, options.config).moving
    held = superpoints.gather(scores)
    if len(marks) > 1 and held[superpoints.cast].sum() > CAST_TOO * held.sum():
        return scores
    return within_outlines(scene, scores, options.threshold, options.config, adds=all(mark.on for mark in marks))


def _as_in_masks(
    scene: Scene, scores: np.ndarray, masks: Mapping[int, np.ndarray], limits: ThingConfig, adds: bool = True
) -> np.ndarray:
    """Return `scores (N,)` of a thing, of moving Gaussians that `masks` (clip frame -> (H,W) bool) show clearly by the masks alone.

    Without `adds` none is added, because other marks may speak against it.
    """
    if not masks or not scores[scene.moving].any():
        return scores
    fraction, total = lift_masks(scene, {frame: mask.astype(np.float32) for frame, mask in masks.items()})
    sure = scene.moving & (total > limits.seen)
    scores = np.where(sure & (fraction <= limits.outside), 0, scores)
    return np.where(sure & (fraction >= limits.inside), 1, scores) if adds else scores


def _marked_at(frames: Iterable[int]) -> str:
    return f"what is marked at frame {', '.join(map(str, frames))}"


def _selection(
    scene: Scene, scores: np.ndarray, options: SelectOptions, label: str, wins: np.ndarray | None = None
) -> Selection:
    """Return the selection by `scores (N,)` and of those that `wins (N,)` bool, without what edits deleted."""
    span, wins = options.span, np.zeros(len(scores), bool) if wins is None else wins
    if span is not None:
        first, last = scene.cameras.times[[0, -1]]
        if not first <= span[0] <= span[1] <= last:
            raise F4xError(
                f"The span {span[0]:g}:{span[1]:g} does not lie within the clip's frames, {first:g} to {last:g}."
            )
    selection = Selection(scene.ids, scores, wins, options.threshold, span, label, fingerprint(scene))
    return selection.among(not_deleted(scene))
