"""Queries rendered as images, from any camera at any time: text scores, coverage by a selection, heat maps."""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..scene import Scene
from ..scene.clouds import COVERED
from ..scene.view import render
from ..scene.visualise import SPECTRUM
from .labels import TextQuery
from .score import text_scores
from .segmentation import shrink
from .selection import Selection

ROWS = 1 << 14
"""Pixels scored at once: 512 channels of them take 34 MB."""
PER_CELL = 4
"""Pixels along each side of a head's cell that are drawn and averaged; with 2, followed masks lose 0.02 of IoU."""
SHOWN = 0.5
"""A mask of what Gaussians cover holds the pixels of which they cover more than this fraction."""
HEAT = 0.6
"""Opacity of the heat map over the picture."""


def label_scores(query: TextQuery, latents: np.ndarray) -> np.ndarray:
    """Return the probabilities (…,L) float32 of the query's labels for `latents (…,D)`, decoded block by block."""
    rows = latents.reshape(-1, latents.shape[-1])
    out = np.empty((len(rows), len(query.labels)), np.float32)
    for start in range(0, len(rows), ROWS):
        part = slice(start, start + ROWS)
        out[part] = text_scores(query.head(rows[part]), query.vectors, query.head.spec.temperature)
    return out.reshape(*latents.shape[:-1], len(query.labels))


def head_map(scene: Scene, head: str, camera: Camera, time: float, backend: str = "auto") -> np.ndarray:
    """Return (h,w,C) float32 that `head` sees from `camera` on its own grid: latents are averaged over each cell, then decoded."""
    features = scene.require_field([head])
    grid = features.spec(head).grid
    latent = render(scene, cell_camera(camera, grid), time, ("latent",), backend)["latent"]
    return features.decode(head, shrink(latent, grid))


def cell_camera(camera: Camera, grid: tuple[int, int]) -> Camera:
    """Return `camera` at the size of pictures that are averaged over the cells of `grid` (rows, columns)."""
    rows, columns = grid
    return camera.resized(min(camera.width, PER_CELL * columns), min(camera.height, PER_CELL * rows))


def text_score_map(
    scene: Scene, query: TextQuery, camera: Camera, time: float, backend: str = "auto", step: int = 1
) -> np.ndarray:
    """Return the probability (H,W,L) float32 of each label at each pixel; 0 where alpha < 0.1.

    The latent is composited and then decoded, as in training. `step` n draws every n-th pixel only.
    """
    if step > 1:
        camera = camera.resized(max(1, camera.width // step), max(1, camera.height // step))
    drawn = render(scene, camera, time, ("latent", "alpha"), backend)
    return label_scores(query, drawn["latent"]) * (drawn["alpha"] >= COVERED)[..., None]


def coverage_image(
    scene: Scene, selection: Selection, camera: Camera, time: float, backend: str = "auto", soft: bool = False
) -> np.ndarray:
    """Return the coverage (H,W) float32 in [0, 1] of the chosen Gaussians at clip time `time`: their sum of blend weights.

    With `soft` the Gaussians count with their scores. 0 everywhere outside the selection's span.
    """
    if not selection.holds_at(time):
        return np.zeros((camera.height, camera.width), np.float32)
    return coverage_by(scene, selection.scores if soft else selection.chosen, camera, time, backend)


def coverage_by(scene: Scene, shares: np.ndarray, camera: Camera, time: float, backend: str = "auto") -> np.ndarray:
    """Return the coverage (H,W) float32 in [0, 1] of the Gaussians at clip time `time`, each counted by `shares (N,)`."""
    drawn = render(scene, camera, time, (), backend, values={"shares": shares[:, None].astype(np.float32)})
    return np.clip(drawn["shares"][..., 0], 0, 1)


def heat_map(image: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Return (H,W,3) uint8: `score (H,W)` in [0, 1] as colors, dark violet 0 to dark red 1, over the gray of `image (H,W,3)`."""
    grey = np.clip(image, 0, 1) @ np.array([0.299, 0.587, 0.114])
    at = np.linspace(0, 1, len(SPECTRUM))
    colours = np.stack([np.interp(score, at, SPECTRUM[:, c]) for c in range(3)], -1)
    return ((HEAT * colours + (1 - HEAT) * grey[..., None]) * 255 + 0.5).astype(np.uint8)
