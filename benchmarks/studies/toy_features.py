"""Feature maps of a toy world whose labels are known, and how well a scene tells the labels."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

from f4x_core.features.maps import FeatureMaps, MapsPlan, write_maps
from f4x_core.features.spec import FeatureSpec
from f4x_core.geometry.camera import Camera
from f4x_core.query.score import cosines
from f4x_core.scene import Scene
from f4x_core.scene.clouds import COVERED
from f4x_core.scene.view import render

from ..quality.image_metrics import score_confusion
from .toy_fits import novel_views
from .toy_worlds import View, World

HEAD = "text"
"""Name of the made-up teacher's head."""
CELL = 3
"""Pixels along a cell."""
LOOKS = 0.4
"""Length of the part of a feature that follows from colours, beside the label's, which has length 1."""
NOISE = 0.5
"""Length of the part that no scene explains: another in every frame."""


def label_vectors(world: World, dim: int) -> np.ndarray:
    """Return (L,dim) unit vectors: what a text encoder would say to the labels' words."""
    vectors = np.random.default_rng(dim).normal(size=(len(world.labels), dim))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def world_maps(world: World, folder: Path, dim: int) -> FeatureMaps:
    """Maps as a teacher of `dim` channels might make: labels, plus something of the colours, plus noise; unit length."""
    rows, columns = world.height // CELL, world.width // CELL
    spec = FeatureSpec(HEAD, dim, (rows, columns), "area", normalised=True)
    rng = np.random.default_rng(dim + 1)
    vectors, directions = label_vectors(world, dim), rng.normal(size=(9, dim)) / dim**0.5

    def encode(view: View) -> np.ndarray:
        mix, rgb = (_shrink(layer[: rows * CELL, : columns * CELL]) for layer in (view.mix, view.rgb))
        looks = np.concatenate([rgb, rgb**2, rgb * rgb[..., [1, 2, 0]]], -1)
        noise = rng.normal(size=(rows, columns, dim)) / dim**0.5
        found = mix @ vectors + LOOKS * (looks - looks.mean((0, 1))) @ directions * 3 + NOISE * noise
        return found / np.linalg.norm(found, axis=-1, keepdims=True)

    return write_maps(folder, MapsPlan(spec, world.frames), map(encode, world.views))


def score_features(world: World, scene: Scene, dim: int) -> tuple[float, float]:
    """Return (mIoU, pixel accuracy) of the best label at every pixel of the novel views."""
    vectors = label_vectors(world, dim)
    return score_views(
        len(world.labels), novel_views(world, scene), lambda camera, time: _labels(scene, camera, time, vectors)
    )


def score_views(
    count: int, views: Iterable[tuple[Camera, float, View]], find: Callable[[Camera, float], np.ndarray]
) -> tuple[float, float]:
    """Return (mean over `count` labels of intersection / union, accuracy) of label pictures (H,W) int over all views.

    `find(camera, time)` may give a picture of any size, which is then enlarged; -1 is no label.
    """
    confusion = np.zeros((count, count + 1), np.int64)
    for camera, time, view in views:
        found, known = enlarge(find(camera, time), view.label.shape), view.label >= 0
        pairs = view.label[known] * (count + 1) + np.where(found < 0, count, found)[known]
        confusion += np.bincount(pairs, minlength=confusion.size).reshape(confusion.shape)
    return score_confusion(confusion)


def enlarge(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the picture (h,w) at `shape` (H,W) by its nearest cells."""
    rows, columns = (np.arange(size) * small // size for size, small in zip(shape, image.shape, strict=True))
    return image[rows[:, None], columns]


def _labels(scene: Scene, camera: Camera, time: float, vectors: np.ndarray) -> np.ndarray:
    drawn = render(scene, camera, time, ("latent", "alpha"))
    decode = partial(scene.require_field([HEAD]).decode, HEAD)
    found = np.stack([cosines(decode(row), vectors).argmax(-1) for row in drawn["latent"]])  # a row of pixels at once
    return np.where(drawn["alpha"] >= COVERED, found, -1)


def _shrink(layer: np.ndarray) -> np.ndarray:
    """Means over cells."""
    rows, columns = layer.shape[0] // CELL, layer.shape[1] // CELL
    return layer.reshape(rows, CELL, columns, CELL, -1).mean((1, 3))
