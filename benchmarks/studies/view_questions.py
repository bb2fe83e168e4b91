"""Labels and followed masks in views of other cameras, as tables A to C of the Feature4X supplement have them.

A teacher that looks at the true pictures is the truth there; against it stand the features that the scene has in the same views,
and the teacher looking at the scene's pictures of them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from f4x_core.clip import Clip
from f4x_core.clip.images import as_bytes
from f4x_core.errors import F4xError
from f4x_core.features.teachers import Teacher, extract, find_teacher, require_ready
from f4x_core.features.text import load_text_encoder
from f4x_core.fit.distil import distil
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.fit.vocabulary import EVERYDAY
from f4x_core.geometry.camera import Camera
from f4x_core.query.pixels import head_map
from f4x_core.query.score import cosines, overlap
from f4x_core.query.segmentation import FeaturePropagation, MaskDecoder
from f4x_core.scene import Scene, read_scene, write_scene
from f4x_core.scene.view import render

from ..quality.image_metrics import score_confusion
from ..study import Context, MissingError, Row
from .novel import NovelCamera

LABELLERS = ("clip", "tipsv2", "text")
"""Teachers whose features words can be compared with, best first: the first whose weights are here answers."""
FOLLOWERS = ("sam2", "visual")
"""Teachers whose features carry a mask, best first."""
WIDTH = 32
"""Of the latent: Feature4X's."""
QUICK_STEPS, FULL_STEPS = 80, 600
"""Steps of distilling."""
EXPERIMENTS = 3
"""Points of table A."""
LABEL_FILE = "labels.txt"
"""Words of a scene or of a data set, one a line; without it `EVERYDAY`."""
SCENES_LIGHT, GIVEN_MASK = "the scene's light", "the data set's mask"
"""Sources of the region in which the point of table A may lie."""
FEATURES, PICTURES, TRUTH = "features", "pictures", "true pictures"
Way = Callable[[int], np.ndarray]
"""View of a camera -> features (h,w,C)."""


def choose_teacher(names: Sequence[str]) -> str:
    """The first of `names` that can look at pictures here; MissingError where none can."""
    reasons = []
    for name in names:
        try:
            require_ready(name)
            return name
        except F4xError as reason:
            reasons.append(str(reason))
    raise MissingError(reasons[-1])


def add_heads(context: Context, clip: Clip, scene: Scene, teachers: Sequence[str]) -> tuple[Scene, Row]:
    """The scene with a head for each teacher, distilled now or in an earlier run of the report."""
    file = context.folder / f"{clip.name} features.f4x"
    config = DistilConfig(WIDTH, context.choose(QUICK_STEPS, FULL_STEPS), seed=context.seed, threads=context.threads)

    def work() -> Row:
        maps = [extract(clip, name, context.folder / "maps" / clip.name / name) for name in teachers]
        start = time.perf_counter()
        write_scene(distil(scene, maps, config), file)
        return {"distil (s)": time.perf_counter() - start}

    cost = context.step(
        f"{clip.name} features", work, teachers=list(teachers), steps=config.steps, frames=clip.picked, width=clip.width
    )
    return read_scene(file), cost


def ways_of(scene: Scene, head: str, encoder: Teacher, novel: NovelCamera, cameras: Sequence[Camera]) -> dict[str, Way]:
    """Return the sources of features of a view of `novel`; `cameras` are its views in the scene's world."""
    times = [float(time) for time in novel.path.times]

    def draw(index: int) -> np.ndarray:
        return as_bytes(render(scene, cameras[index], times[index], ("rgb",))["rgb"])

    return {
        TRUTH: lambda index: encoder.encode(novel.frames[index]),
        FEATURES: lambda index: head_map(scene, head, cameras[index], times[index]),
        PICTURES: lambda index: encoder.encode(draw(index)),
    }


def label_views(
    scene: Scene,
    teacher: str,
    labels: Sequence[str],
    views: Sequence[tuple[NovelCamera, Sequence[Camera]]],
    every: int = 1,
) -> list[Row]:
    """Best of `labels` at every cell of the teacher's grid, against those of the true pictures: mIoU, accuracy, seconds.

    Only every so many views of a camera are looked at.
    """
    spec = scene.require_field([teacher]).spec(teacher)
    vectors = load_text_encoder(spec.text_encoder).encode(list(labels))
    encoder = warm_encoder(teacher, views[0][0])
    count = len(labels)
    confusion = {way: np.zeros((count, count), np.int64) for way in (FEATURES, PICTURES)}
    seconds = dict.fromkeys(confusion, 0.0)
    for novel, cameras in views:
        ways = ways_of(scene, teacher, encoder, novel, cameras)
        for index in range(0, len(cameras), every):
            truth = cosines(ways[TRUTH](index), vectors).argmax(-1)
            for way in confusion:
                start = time.perf_counter()
                found = cosines(ways[way](index), vectors).argmax(-1)
                seconds[way] += time.perf_counter() - start
                pairs = np.bincount((truth * count + found).ravel(), minlength=count * count)
                confusion[way] += pairs.reshape(count, count)
    rows = []
    for way, table in confusion.items():
        miou, accuracy = score_confusion(table)
        rows.append({"from": way, "mIoU": miou, "accuracy": accuracy, "time (s)": seconds[way]})
    return rows


def follow_points(
    scene: Scene,
    teacher: str,
    novel: NovelCamera,
    cameras: Sequence[Camera],
    seed: int = 0,
    given: np.ndarray | None = None,
) -> list[Row]:
    """A point on what moves in the first view, its mask carried to the others; against the masks of the true pictures.

    Mean IoU over views and `EXPERIMENTS` points drawn at random, worst and best point, seconds of a whole video. What moves is what
    `given` (H,W) bool says of the first true picture; without it, where most of the scene's own light moves.

    Raises:
        MissingError: nothing moves in the first view.
    """
    moves = _moving_weights(scene, cameras[0], float(novel.path.times[0])) > 0.5 if given is None else given
    points = np.argwhere(moves)
    if not len(points):
        raise MissingError("nothing moves in the first view, so that there is no point to follow")
    encoder = warm_encoder(teacher, novel)
    ways = ways_of(scene, teacher, encoder, novel, cameras)
    scores: dict[str, list[float]] = {FEATURES: [], PICTURES: []}
    seconds: dict[str, list[float]] = {FEATURES: [], PICTURES: []}
    height, width = novel.frames.shape[1:3]
    rng = np.random.default_rng(seed)
    for row, column in points[rng.integers(len(points), size=EXPERIMENTS)]:
        follow = partial(follow_point, teacher, np.array([column, row]) + 0.5, len(cameras), (height, width))
        truth = follow(ways[TRUTH])
        for way in scores:
            start = time.perf_counter()
            found = follow(ways[way])
            seconds[way].append(time.perf_counter() - start)
            scores[way].append(float(np.mean([overlap(found[t], truth[t]) for t in truth])))
    return [
        {"from": way, "mIoU": statistics.fmean(found), "mIoU low": min(found), "mIoU high": max(found)}
        | {"time (s)": statistics.fmean(seconds[way]), "point on": SCENES_LIGHT if given is None else GIVEN_MASK}
        for way, found in scores.items()
    ]


def follow_point(teacher: str, point: np.ndarray, count: int, size: tuple[int, int], way: Way) -> dict[int, np.ndarray]:
    """View -> mask (H,W) bool of what is at `point` (x, y in pixels) in the first of `count` views."""
    decoder = mask_decoder(teacher, way, count, size)
    decoder.prompt(0, points=point[None])
    return {t: logits > 0 for t, logits in decoder.propagate()}


def mask_decoder(teacher: str, features: Way, count: int, size: tuple[int, int]) -> MaskDecoder:
    """Return the decoder of `teacher`'s features into masks; SAM 2's works without skip connections."""
    if teacher != "sam2":
        return FeaturePropagation(features, count, size)
    from f4x_core.features.models.sam2 import Sam2MaskDecoder, load_sam2

    return Sam2MaskDecoder(load_sam2(), features, count, size)


def warm_encoder(teacher: str, novel: NovelCamera) -> Teacher:
    """The teacher, after a first call in which it prepares itself for pictures of this size."""
    encoder = find_teacher(teacher).load(None)
    encoder.encode(np.zeros_like(novel.frames[0]))
    return encoder


def labels_for(folder: Path) -> list[str]:
    """Words of `labels.txt` in a scene's folder, else beside it, else everyday ones."""
    for place in (folder, folder.parent):
        if (place / LABEL_FILE).is_file():
            lines = (place / LABEL_FILE).read_text(encoding="utf-8").splitlines()
            return list(dict.fromkeys(line.strip() for line in lines if line.strip()))
    return list(EVERYDAY)


def _moving_weights(scene: Scene, camera: Camera, moment: float) -> np.ndarray:
    """(H,W) fraction of the blend weight that comes from moving Gaussians."""
    moving = {"moving": scene.moving[:, None].astype(np.float32)}
    return render(scene, camera, moment, ("alpha",), values=moving)["moving"][..., 0]
