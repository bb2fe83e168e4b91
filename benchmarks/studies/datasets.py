"""The field's data sets by their own protocols, beside the figures of the Feature4X supplement."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from f4x_core.clip import Clip, read_clip
from f4x_core.errors import F4xError
from f4x_core.evaluation.evaluate import Figures, evaluate
from f4x_core.evaluation.perceptual_distance import lpips_missing
from f4x_core.features.teachers import extract
from f4x_core.query.pixels import head_map
from f4x_core.query.segmentation import MaskDecoder
from f4x_core.scene import Scene

from ..quality.image_metrics import region_similarity
from ..study import Context, Findings, MissingError, Row, Table
from .novel import read_annotations, read_moving
from .protocols import (
    DYCHECK,
    NERFIES,
    NVIDIA,
    Protocol,
    first_frames,
    fit_config,
    fit_scene,
    measure_views,
    read_scene_clip,
    scenes_of,
    sizes_of,
)
from .supplement import FOLLOWED, LABELLED, OURS, THEIRS, VIEWS
from .view_questions import (
    FEATURES,
    FOLLOWERS,
    LABELLERS,
    PICTURES,
    add_heads,
    choose_teacher,
    follow_points,
    label_views,
    labels_for,
    mask_decoder,
)

METHOD = "this program"
QUICK_EVERY = 4
"""Views of which a quick report labels one."""
TIMED = ("fit (s)", "distil (s)", "time (s)")
DAVIS_PROFILE = "f4x_davis"
HOLD_OUT = 8
"""Of DAVIS, which has no other camera, every so many frames one is held out."""
MATCHED = (
    "Cameras of the test views are moved to match before they are scored (scene frozen), as in MoSca's evaluation, but the"
    " best step counts in place of the last; `as placed` is before that."
)


@dataclass
class Answers:
    """Measured rows of the scenes of one data set."""

    views: list[Row] = field(default_factory=list)
    labels: list[Row] = field(default_factory=list)
    masks: list[Row] = field(default_factory=list)
    asked: dict[str, str] = field(default_factory=dict)
    """Question -> the teacher that answered."""
    skipped: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)


def study_nvidia(context: Context) -> Findings:
    """Tables A and B: seven scenes of twelve frames, measured from the first camera at every time."""
    answers = _measure(context, NVIDIA, scenes_of(context, NVIDIA.name, "poses_bounds.npy"))
    rows = [_with_features(row, answers.labels) for row in answers.views]
    theirs = _theirs(VIEWS, "scene", rows)
    note = (
        f"RoDynRF's protocol: uint8 PSNR as `cv2.PSNR`, SSIM as scikit-image's defaults, LPIPS on AlexNet; cameras are found, not"
        f" given. {MATCHED}"
        " Labels: features of the scene in the test views against the teacher on the true pictures"
        f" ({_answered(answers, 'labels')}; theirs: CLIP-LSeg). Sizes of ours: arrays in memory, theirs: checkpoints, features in"
        " static and dynamic."
    )
    views = Table("views", [*rows, *_mean_row(rows), *theirs], "Test views (table B)", TIMED, note)
    return _findings(answers, [views, _mask_table(answers, "NVIDIA")], _compare(rows, theirs, "PSNR (dB)"))


def study_nerfies(context: Context) -> Findings:
    """Tables A and C: the left camera learnt, the right one measured."""
    answers = _measure(context, NERFIES, scenes_of(context, NERFIES.name, "camera/*.json"))
    labels = [_of_data(row, "Nerfies") for row in answers.labels]
    theirs = _theirs(LABELLED, "data", labels)
    note = (
        f"Truth: the teacher's labels of the true pictures ({_answered(answers, 'labels')}; theirs: CLIP-LSeg, whose words the"
        " supplement does not name). Times are of whole videos."
    )
    tables = [
        Table("views", answers.views, "Test views", TIMED, f"Masked figures as DyCheck's, split `mono`. {MATCHED}"),
        _mask_table(answers, "Nerfies"),
        Table("labels", [*labels, *theirs], "Semantic segmentation of test views (table C)", TIMED, note),
    ]
    ours = [row for row in labels if row["from"] == FEATURES]
    return _findings(answers, tables, _compare(ours, [r for r in theirs if r["from"] == FEATURES], "mIoU", "data"))


def study_dycheck(context: Context) -> Findings:
    """Masked figures over co-visible pixels, and keypoints carried from frame to frame."""
    answers = _measure(context, DYCHECK, scenes_of(context, DYCHECK.name, "camera/*.json"), asks=False)
    note = (
        "Gao et al. 2022: PSNR, SSIM and LPIPS over pixels that enough training frames saw (`covisible/`); PCK: keypoints carried"
        f" between all pairs of annotated training frames, right within 5 % of the longer side. {MATCHED} The supplement has"
        " no figures of this data set."
    )
    rows = [*answers.views, *_mean_row(answers.views)]
    mean = [row["mPSNR (dB)"] for row in answers.views]
    words = [f"{len(mean)} scenes: mean mPSNR {statistics.fmean(mean):.2f} dB."] if mean else []
    return _findings(answers, [Table("views", rows, "Test views", TIMED, note)], words)


def study_davis(context: Context) -> Findings:
    """Held-out frames, and the first annotation carried through the video by the scene and by pictures alone."""
    folder = (context.data or Path("DATA")) / "davis"
    found = sorted(path for path in folder.glob("JPEGImages/480p/*") if path.is_dir()) if context.data else []
    if not found:
        raise MissingError(
            f"davis: no sequence (no {folder}/JPEGImages/480p/NAME); docs/datasets.md says where to get it."
        )
    rows, failed = [], []
    teacher = choose_teacher(FOLLOWERS)
    for sequence in context.choose(found[:1], found):
        try:
            rows.append({"clip": sequence.name} | _measure_davis(context, sequence.resolve(), teacher))
        except F4xError as error:
            failed.append(f"{sequence.name}: {error}")
    note = (
        f"Every {HOLD_OUT}th frame is held out. J: intersection over union with the annotations of the first frame's objects,"
        f" each carried by features of `{teacher}`, decoded from the scene or of the frames themselves; mean over all frames but"
        " the first and the last, then over objects, as the official tool's (at the size of the clip). The supplement shows DAVIS"
        " in pictures only."
    )
    words = [
        f"{row['clip']}: held-out frames {row['held out (dB)']:.2f} dB, the better picture without 3D"
        f" {max(row['nearest frame (dB)'], row['flow blend (dB)']):.2f} dB."
        for row in rows
    ]
    return Findings([Table("clips", rows, "Sequences", TIMED, note)], [], words, lpips_missing(), failed)


def _measure(context: Context, protocol: Protocol, folders: Sequence[Path], asks: bool = True) -> Answers:
    """Fit, place, draw and score every scene; one that fails costs no other."""
    answers = Answers()
    teachers: dict[str, str] = {}
    for what, names in (("labels", LABELLERS), ("masks", FOLLOWERS)) if asks else ():
        try:
            teachers[what] = choose_teacher(names)
        except MissingError as reason:
            answers.skipped.append(f"{what}: {reason}")
    answers.asked = teachers
    for folder in folders:
        try:
            _measure_scene(context, protocol, folder, teachers, answers)
        except F4xError as error:
            answers.failed.append(f"{folder.name}: {error}")
    return answers


def _measure_scene(
    context: Context, protocol: Protocol, folder: Path, teachers: dict[str, str], answers: Answers
) -> None:
    clip = read_scene_clip(context, folder, protocol)
    config = fit_config(context, protocol.profile)
    scene, cost = fit_scene(context, clip, config, protocol.known_cameras)
    placed, scores = measure_views(context, clip, scene, protocol)
    named = {"scene": folder.name, "source": OURS, "method": f"{METHOD}, profile {config.name}"}
    answers.views.append(named | scores | sizes_of(scene) | cost)
    if not teachers:
        return
    scene, distilled = add_heads(context, clip, scene, list(teachers.values()))
    answers.views[-1] |= sizes_of(scene) | distilled
    settings = {"frames": clip.picked, "width": clip.width, "teachers": teachers}
    about = {"scene": folder.name, "source": OURS}
    if "labels" in teachers:
        labels = labels_for(folder)
        work = partial(label_views, scene, teachers["labels"], labels, placed, context.choose(QUICK_EVERY, 1))
        answers.labels += [about | row for row in context.step(f"{clip.name} labels", work, labels=labels, **settings)]
    if "masks" in teachers:
        for novel, cameras in placed[:1]:
            given = read_moving(clip, novel)
            work = partial(follow_points, scene, teachers["masks"], novel, cameras, context.seed, given)
            try:
                found = context.step(f"{clip.name} masks", work, mask=given is not None, **settings)
                answers.masks += [about | row for row in found]
            except MissingError as reason:
                answers.skipped.append(f"masks of {folder.name}: {reason}")


def _measure_davis(context: Context, sequence: Path, teacher: str) -> Row:
    clip = first_frames(sequence, HOLD_OUT) if context.quick else read_clip(sequence, hold_out=HOLD_OUT)
    labels = read_annotations(clip)
    scene, cost = fit_scene(context, clip, fit_config(context, DAVIS_PROFILE))
    settings = {"frames": clip.picked, "width": clip.width}
    found = context.step(
        f"{clip.name} frames", lambda: _frame_scores(scene, clip), lpips=not lpips_missing(), **settings
    )
    scene, distilled = add_heads(context, clip, scene, [teacher])
    follow = partial(_follow_annotation, context, scene, clip, labels, teacher)
    return (
        found
        | context.step(f"{clip.name} masks", follow, teacher=teacher, **settings)
        | sizes_of(scene)
        | cost
        | distilled
    )


def _frame_scores(scene: Scene, clip: Clip) -> Row:
    scores = evaluate(scene, clip, Figures(refine_camera=True, baselines=True, perceptual=True))
    columns = {
        "used (dB)": "used_psnr",
        "held out, camera registered (dB)": "held_out_psnr_registered",
        "flow blend, camera registered (dB)": "held_out_psnr_flow_blend_registered",
        "held out (dB)": "held_out_psnr",
        "held out LPIPS": "held_out_lpips",
        "held out, camera refined (dB)": "held_out_psnr_refined",
        "nearest frame (dB)": "held_out_psnr_nearest",
        "flow blend (dB)": "held_out_psnr_flow_blend",
    }
    return {column: scores[name] for column, name in columns.items() if name in scores}


def _follow_annotation(context: Context, scene: Scene, clip: Clip, labels: np.ndarray, teacher: str) -> Row:
    """J of the first annotation carried on, by features of the scene and by those of the frames."""
    maps = extract(clip, teacher, context.folder / "maps" / clip.name / teacher)
    ways: dict[str, Callable[[int], np.ndarray]] = {
        "J, scene": lambda t: head_map(scene, teacher, scene.cameras[t], float(scene.cameras.times[t])),
        "J, frames": maps.at,
    }
    row: Row = {"objects": int((np.unique(labels[0]) > 0).sum())}
    for name, way in ways.items():
        decoder = mask_decoder(teacher, way, len(clip), (clip.height, clip.width))
        row[name] = region_similarity(follow_objects(decoder, labels[0]), labels)
    return row


def follow_objects(decoder: MaskDecoder, first: np.ndarray) -> np.ndarray:
    """Object numbers (T,H,W) uint8, 0 = none, of every object in `first` (H,W) carried on by itself.

    A pixel that several claim is of the one with the largest logit.
    """
    found = np.zeros((decoder.count, *decoder.size), np.uint8)
    best = np.zeros(found.shape, np.float32)
    for number in np.unique(first[first > 0]):
        decoder.reset()
        decoder.prompt(0, mask=first == number)
        for t, logits in decoder.propagate():
            found[t][logits > best[t]] = number
            np.maximum(best[t], logits, out=best[t])
    return found


def _mask_table(answers: Answers, data: str) -> Table:
    """Table A: ours for each scene and on average, theirs over the data set."""
    rows = [_of_data(row, data) for row in answers.masks]
    for way in (PICTURES, FEATURES):
        chosen = [row for row in answers.masks if row["from"] == way]
        if chosen:
            means = {name: statistics.fmean(row[name] for row in chosen) for name in ("mIoU", "time (s)")}
            rows.append({"source": OURS, "data": data, "from": way} | means)
    note = (
        f"A point on what moves in the first test view, its mask carried on by {_answered(answers, 'masks')}; truth: the same"
        " network on the true pictures; low and high: worst and best of three points. `point on`: who says what moves there, the"
        " data set's own mask, or, where it has none of that view, the light of our scene, which favours what our scene got"
        " right. Theirs: SAM 2, means of three, points on the object in the true first picture."
    )
    theirs = [row for row in FOLLOWED if row["data"] == data]
    return Table("masks", [*rows, *theirs], "Masks of one point (table A)", TIMED, note)


def _answered(answers: Answers, what: str) -> str:
    return f"`{answers.asked[what]}` answered" if what in answers.asked else "nobody answered"


def _with_features(row: Row, labels: Sequence[Row]) -> Row:
    """A scene's row with what the scene's features tell of labels."""
    for found in labels:
        if found["scene"] == row["scene"] and found["from"] == FEATURES:
            return row | {"accuracy": found["accuracy"], "mIoU": found["mIoU"]}
    return row


def _theirs(published: Sequence[Row], key: str, ours: Sequence[Row]) -> list[Row]:
    """Published rows of the scenes that were measured, under the names that the folders have, and their means."""
    names = {str(row[key]).casefold(): row[key] for row in ours}
    rows = [row | {key: names[row[key].casefold()]} for row in published if row[key].casefold() in names]
    return rows + [row for row in published if row[key].endswith("mean")]


def _mean_row(rows: Sequence[Row]) -> list[Row]:
    """Mean of our scenes where there are several."""
    if len(rows) < 2:
        return []
    numbers = [name for name, value in rows[0].items() if isinstance(value, float)]
    means = {name: statistics.fmean(row[name] for row in rows if row.get(name) is not None) for name in numbers}
    words = {name: value for name, value in rows[0].items() if isinstance(value, str)}
    return [words | {"scene": "mean of these"} | means]


def _of_data(row: Row, data: str) -> Row:
    """The row with its scene named as the supplement's tables A and C do."""
    return {"source": row["source"], "data": f"{data} {row['scene']}"} | {
        name: value for name, value in row.items() if name not in ("source", "scene")
    }


def _compare(ours: Sequence[Row], theirs: Sequence[Row], column: str, key: str = "scene") -> list[str]:
    """Our mean against the published one over the same scenes."""
    last = {row[key]: row[column] for row in theirs if row["source"] == THEIRS}
    both = [row for row in ours if row[key] in last]
    if not both:
        return []
    mine, published = (statistics.fmean(v) for v in ([r[column] for r in both], [last[r[key]] for r in both]))
    name, _, unit = column.partition(" (")
    unit = f" {unit.removesuffix(')')}" if unit else ""
    return [
        f"{len(both)} of the published scenes: mean {name} {mine:.3f}{unit} here, {published:.3f}{unit} in the supplement."
    ]


def _findings(answers: Answers, tables: list[Table], words: list[str]) -> Findings:
    return Findings(tables, [], words, [*lpips_missing(), *answers.skipped], answers.failed)
