"""Studies of the latent's width, and of the scene's own features in place of the teacher's look at rendered pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from f4x_core.errors import F4xError
from f4x_core.features.teachers import TEACHERS, extract, require_ready
from f4x_core.fit.distil import distil
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.geometry.camera import Camera
from f4x_core.query.pixels import head_map
from f4x_core.query.score import cosines, overlap
from f4x_core.query.segmentation import FeaturePropagation
from f4x_core.scene import Scene, read_scene, write_scene
from f4x_core.scene.view import render

from ..speed.feature_cost import compare_renders
from ..study import Context, Figure, Findings, MissingError, Row, Table, time_rows
from .supplement import DIMENSIONS, FOLLOWED, LABELLED, OURS
from .toy_features import HEAD, enlarge, score_features, score_views, world_maps
from .toy_fits import base_config, fit_world, novel_views, toy_world
from .toy_worlds import View, World

WORLD = "feature-rich"
"""Eighteen labels: the narrowest latents cannot keep them apart."""
WIDTHS = (8, 16, 32, 64, 128, 256, 512)
"""Those of the supplement."""
DIM = 512
"""Channels of the made-up teacher, as CLIP's."""
QUICK_STEPS, FULL_STEPS = 60, 600
"""Steps of distilling."""
CHOICE = 32
"""The width that Feature4X chose."""
TRAIN, DISTIL, DRAW = (f"{what} / that of {CHOICE}" for what in ("training time", "distilling time", "drawing time"))
"""Columns of times as multiples."""
TEACHER = "visual"
"""A real network whose weights come with a package."""
MOVER = "box"
"""Label of what is followed."""
Views = list[tuple[Camera, float, View]]
"""Camera in the scene's world, time, truth."""
Way = Callable[[Camera, float], np.ndarray]
"""Camera and time to features (h,w,C)."""


def study_widths(context: Context) -> Findings:
    """One fitted scene, the same features distilled into latents of every width."""
    world = toy_world(context, WORLD)
    plain, fit = fitted_scene(context, world)
    maps = world_maps(world, context.folder / "maps", DIM)
    steps = context.choose(QUICK_STEPS, FULL_STEPS)

    def work(width: int) -> Row:
        config = DistilConfig(width, steps, seed=context.seed, threads=context.threads)
        start = time.perf_counter()
        scene = distil(plain, [maps], config)
        seconds = time.perf_counter() - start
        write_scene(scene, _file(context, width))
        miou, accuracy = score_features(world, scene, DIM)
        images = compare_renders(scene, plain, world.clip)
        report = scene.require_field([HEAD]).head(HEAD).report
        sizes = scene.info()["megabytes"]
        return {
            "distil (s)": seconds,
            "mIoU": miou,
            "accuracy": accuracy,
            "cosine, held out": report["held_out"]["cosine"],
            "PSNR (dB)": images["psnr"],
            "PSNR change (dB)": images["psnr_change"],
            "size (MB)": sum(sizes.values()),
        }

    rows: list[Row] = [
        {"width": width, "source": OURS} | context.step(f"width {width}", partial(work, width), steps=steps)
        for width in WIDTHS
    ]
    drawn = context.step("draw", lambda: _draw_times(context, world))
    ours = []
    for row, times in zip(rows, drawn, strict=True):
        took = {name.replace("time", "draw"): value for name, value in times.items() if name != "name"}
        ours.append({"width": row["width"], "source": OURS, "train (s)": fit + row["distil (s)"]} | took | row)
    both = _compared(ours, "draw (ms)") + _compared(DIMENSIONS, "draw all (s)")
    timed = (
        TRAIN,
        DISTIL,
        DRAW,
        "train (s)",
        "distil (s)",
        "draw (ms)",
        "draw low (ms)",
        "draw high (ms)",
        "draw all (s)",
    )
    note = (
        f"Ours: world `{WORLD}`, a made-up teacher of {DIM} channels, {steps} steps of distilling after the fit (`train`:"
        " both); `draw` one view of latents, decoded on the teacher's grid, median and quartiles; labels scored on novel views."
        " Feature4X: tables D and E of its supplement (NVIDIA Jumping): other data, other machine, trained jointly."
    )
    figures = [
        Figure(f"Training, over that of width {CHOICE}", "widths", "width", TRAIN, "source"),
        Figure(f"Drawing, over that of width {CHOICE}", "widths", "width", DRAW, "source"),
        Figure("Labels told apart", "widths", "width", "mIoU", "source", log="x"),
    ]
    table = Table("widths", both, "Width of the latent", timed, note)
    return Findings([table], figures, _width_words(both[: len(ours)]))


def _compared(rows: list[Row], draw: str) -> list[Row]:
    """Return the rows with their times over those of `CHOICE`, which tell the same on any machine."""
    one = next(row for row in rows if row["width"] == CHOICE)
    ratios = {TRAIN: "train (s)", DISTIL: "distil (s)", DRAW: draw}
    return [
        {"width": row["width"], "source": row["source"]}
        | {name: row[of] / one[of] for name, of in ratios.items() if of in row}
        | row
        for row in rows
    ]


def fitted_scene(context: Context, world: World) -> tuple[Scene, float]:
    """Return the world's scene without features, fitted once for the study, and the seconds that it took."""
    file = context.folder / "plain.f4x"

    def work() -> float:
        fitted = fit_world(world, base_config(context))
        write_scene(fitted.scene, file)
        return sum(fitted.seconds.values())

    seconds = context.step("fit", work)
    return read_scene(file), seconds


def study_inference(context: Context) -> Findings:
    """Labels and a followed mask in novel views: by features of the scene, and by a teacher that looks at rendered pictures."""
    try:
        require_ready(TEACHER)
    except F4xError as reason:
        raise MissingError(str(reason)) from reason
    world = toy_world(context, WORLD)
    (plain, _), clip = fitted_scene(context, world), world.clip
    maps = extract(clip, TEACHER, context.folder / "maps")
    steps = context.choose(QUICK_STEPS, FULL_STEPS)

    def learn() -> Row:
        config = DistilConfig(None, steps, seed=context.seed, threads=context.threads)
        start = time.perf_counter()
        write_scene(distil(plain, [maps], config), context.folder / "scene.f4x")
        return {"distil (s)": time.perf_counter() - start}

    context.step("distil", learn, steps=steps)
    scene = read_scene(context.folder / "scene.f4x")
    views, ways = novel_views(world, scene), _ways(world, scene)
    first, labels, masks = maps.at(0), [], []
    for name, way in ways.items():
        about = {"source": OURS, "data": WORLD, "from": name}
        labels.append(about | context.step(f"labels {name}", partial(_label, world, views, first, way)))
        masks.append(about | context.step(f"masks {name}", partial(_follow, world, views, way)))
    note = (
        f"Ours: the `{TEACHER}` teacher (MobileNetV2), {len(views)} novel views of world `{WORLD}`; a label's vector is the mean of"
        " the teacher's features where the first frame truly shows it. `truth`: the teacher sees the true novel picture, so"
        " that nothing is lost by the scene; features that many views agreed on can be better than one look."
        " Feature4X: table {} of its supplement, {}; other data, other machine."
    )
    tables = [
        Table("labels", labels + LABELLED, "Every pixel labelled", ("time (s)",), note.format("C", "CLIP-LSeg")),
        Table("masks", masks + FOLLOWED, "A mask followed", ("time (s)",), note.format("A", "SAM2")),
    ]
    return Findings(tables, words=[_inference_words("labels", labels), _inference_words("a followed mask", masks)])


def _file(context: Context, width: int) -> Path:
    return context.folder / f"latent {width}.f4x"


def _draw_times(context: Context, world: World) -> list[Row]:
    camera, moment, _ = world.novel_views[0]
    scenes = [read_scene(_file(context, width)) for width in WIDTHS]
    draw = [partial(head_map, scene, HEAD, camera, moment) for scene in scenes]
    return time_rows([str(width) for width in WIDTHS], draw, context.repeats)


def _ways(world: World, scene: Scene) -> dict[str, Way]:
    """Three sources of the teacher's features of a view."""
    encoder = TEACHERS[TEACHER].load(None)
    encoder.encode(np.zeros((world.height, world.width, 3), np.uint8))  # a first call prepares itself
    truth = {time: view for _, time, view in world.novel_views}

    def as_bytes(rgb: np.ndarray) -> np.ndarray:
        return (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)

    return {
        "features": lambda camera, moment: head_map(scene, TEACHER, camera, moment),
        "pictures": lambda camera, moment: encoder.encode(as_bytes(render(scene, camera, moment, ("rgb",))["rgb"])),
        "truth": lambda camera, moment: encoder.encode(as_bytes(truth[moment].rgb)),
    }


def _label(world: World, views: Views, first: np.ndarray, way: Way) -> Row:
    """Nearest of the labels' mean features at every cell; `first (h,w,C)`: the teacher's map of the first frame."""
    shown = world.views[0].label
    cells = enlarge(shown, first.shape[:2])
    present = [label for label in range(len(world.labels)) if (cells == label).any()]
    vectors = np.stack([first[cells == label].mean(0) for label in present])
    seconds = 0.0

    def find(camera: Camera, moment: float) -> np.ndarray:
        nonlocal seconds
        start = time.perf_counter()
        found = np.array(present)[cosines(way(camera, moment), vectors).argmax(-1)]
        seconds += time.perf_counter() - start
        return found

    miou, accuracy = score_views(len(world.labels), views, find)
    return {"mIoU": miou, "accuracy": accuracy, "time (s)": seconds}


def _follow(world: World, views: Views, way: Way) -> Row:
    """Return the mover's mask on the first novel view carried to the others."""
    mover = world.labels.index(MOVER)
    follower = FeaturePropagation(lambda t: way(*views[t][:2]), len(views), (world.height, world.width))
    start = time.perf_counter()
    follower.prompt(0, mask=views[0][2].label == mover)
    found: dict[int, Any] = dict(follower.propagate())
    seconds = time.perf_counter() - start
    scores = [overlap(found[t] > 0, views[t][2].label == mover) for t in range(1, len(views))]
    return {"mIoU": float(np.mean(scores)), "time (s)": seconds}


def _width_words(rows: list[Row]) -> list[str]:
    by_width = {row["width"]: row for row in rows}
    widest, chosen = rows[-1], by_width[CHOICE]
    theirs = next(row for row in _compared(DIMENSIONS, "draw all (s)") if row["width"] == widest["width"])
    largest_change = max(abs(row["PSNR change (dB)"]) for row in rows)
    best = max(rows, key=lambda row: row["mIoU"])
    enough = next(row for row in rows if row["mIoU"] >= best["mIoU"] - 0.01)
    return [
        f"Width {enough['width']} is the narrowest within 0.01 of the best mIoU ({best['mIoU']:.3f} at {best['width']});"
        f" {CHOICE} has {chosen['mIoU']:.3f}.",
        f"{widest['width']} channels take {widest[DISTIL]:.2f} times the distilling of {CHOICE}, {widest[TRAIN]:.2f} times the"
        f" training of which the fit of the pictures is a part, and {widest[DRAW]:.2f} times the drawing; Feature4X reports"
        f" {theirs[TRAIN]:.2f} for training, where pictures and features are fitted together, and {theirs[DRAW]:.2f} for drawing.",
        f"Features change no picture: PSNR differs by at most {largest_change:.2g} dB from that of the scene without them.",
    ]


def _inference_words(what: str, rows: list[Row]) -> str:
    by_way = {row["from"]: row for row in rows}
    features, images, truth = (by_way[name] for name in ("features", "pictures", "truth"))
    return (
        f"{what.capitalize()}: features of the scene take {features['time (s)']:.2g} s and reach mIoU"
        f" {features['mIoU']:.3f}; rendered pictures through the teacher {images['time (s)']:.2g} s and"
        f" {images['mIoU']:.3f}; true pictures {truth['mIoU']:.3f}."
    )
