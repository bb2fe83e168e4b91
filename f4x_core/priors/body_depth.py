"""Depth of people within their bodies: limbs in front of and behind each other by their joints, in place of one upright plane.

A person's joints are known in metres from between the hips and in pixels of the picture, so the picture's scale at the body
is known too; with the distance of the feet (or of the body) that gives every joint a depth, and every pixel that of the limb
that it lies on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from .joints import FEET, HIPS, LIMBS, to_segments
from .moving_people import shows_person

if TYPE_CHECKING:
    from .folder import Priors

SEEN = 0.3
"""Visibility from which a joint tells anything."""
SMOOTH_FRAMES = 1.5
"""Gaussian (frames) over which joints in metres are smoothed: they tremble more than people do."""
LIMB_PIXELS, FALLOFF = 2.0, 4
"""Softening (pixels) and power of the distances by which limbs share a pixel."""
MAX_RELIEF = 0.3
"""Largest difference of depth within a body, as a fraction of its distance: an arm's length at two meters."""
BESIDE = 12
"""Pixels around a body that move with it: clothes and what is held have the depth of the nearest limb."""
MIN_JOINTS, MIN_PIXELS = 8, 40
"""Joints and pixels that a frame needs to show a body's relief."""


@dataclass(frozen=True)
class Body:
    """The joints of one person in one frame."""

    pixels: np.ndarray
    """(33, 2)."""
    metres: np.ndarray
    """(33, 3) from between the hips."""
    weight: np.ndarray
    """(33,) visibility, 0 where it tells nothing."""

    @property
    def pixels_per_metre(self) -> float:
        """Scale of the picture at the body: least squares between the joints in pixels and in metres."""
        weight = self.weight[:, None] / self.weight.sum()
        here = self.pixels - (weight * self.pixels).sum(0)
        there = self.metres[:, :2] - (weight * self.metres[:, :2]).sum(0)
        return float((weight * here * there).sum() / max((weight * there**2).sum(), 1e-9))

    @property
    def anchor(self) -> float:
        """Metres along the view of what gives the body's distance: of the feet that are seen, else of the hips."""
        for joints in (FEET, HIPS):
            weight = self.weight[list(joints)]
            if weight.sum() > 0:
                return float(np.average(self.metres[list(joints), 2], weights=weight))
        return 0.0

    def relief(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(n,) metres along the view, from between the hips, of the limbs at pixels `y, x (n,)`."""
        segments = np.array([pair for pairs in LIMBS.values() for pair in pairs])
        segments = segments[(self.weight[segments] > 0).all(1)]
        start, end = self.pixels[segments[:, 0]], self.pixels[segments[:, 1]]
        apart, part = to_segments(np.stack([x + 0.5, y + 0.5], 1), start, end)
        z = self.metres[segments[:, 0], 2] * (1 - part) + self.metres[segments[:, 1], 2] * part
        weight = 1 / (apart + LIMB_PIXELS) ** FALLOFF
        return (weight * z).sum(1) / weight.sum(1)


def add_relief(inverse: np.ndarray, guessed: np.ndarray, priors: Priors) -> int:
    """Write the relief of people into `inverse (F, H, W)`, in place, where their depth is `guessed (F, H, W)` bool.

    What is there gives each body's distance in each frame: the median of its inverse depth. Returns how many people have a
    relief.
    """
    if priors.people is None or priors.people_joints is None or priors.people_metres is None or priors.cameras is None:
        return 0
    found = 0
    for person in range(priors.people_joints.shape[1]):
        shown = shows_person(priors, person + 1) & guessed
        bodies = bodies_of(priors.people_joints[:, person], priors.people_metres[:, person])
        frames = [frame for frame in bodies if shown[frame].sum() >= MIN_PIXELS]
        scales = smooth_scales({frame: bodies[frame].pixels_per_metre for frame in frames})
        for frame in frames:
            beside = guessed[frame] & (priors.people[frame] == 0)
            per_metre = scales[frame] / float(priors.cameras.intrinsics[frame, 0, 0])
            _write(inverse[frame], shown[frame], beside, bodies[frame], per_metre)
        found += bool(frames)
    return found


def _write(inverse: np.ndarray, shown: np.ndarray, beside: np.ndarray, body: Body, per_metre: float) -> None:
    """Write a body's relief into one frame's `inverse (H, W)`: where it is `shown`, and on what is close `beside` it.

    per_metre: a metre at the body, as a fraction of its distance.
    """
    import cv2

    square = np.ones((2 * BESIDE + 1, 2 * BESIDE + 1), np.uint8)
    y, x = np.nonzero(shown | (beside & (cv2.dilate(shown.astype(np.uint8), square) > 0)))
    distance = 1 / float(np.median(inverse[shown]))
    relief = np.clip((body.relief(y, x) - body.anchor) * per_metre, -MAX_RELIEF, MAX_RELIEF)
    inverse[y, x] = 1 / (distance * (1 + relief))


def bodies_of(joints: np.ndarray, metres: np.ndarray) -> dict[int, Body]:
    """Frame -> body, from joints `(F, 33, 3)` and metres `(F, 33, 3)`; frames that show too few joints are left out."""
    seen = np.isfinite(joints).all((1, 2))
    weight = np.where(seen[:, None], np.nan_to_num(joints[..., 2]), 0)
    norm = ndimage.gaussian_filter1d(seen.astype(np.float64), SMOOTH_FRAMES)
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(metres).astype(np.float64), SMOOTH_FRAMES, axis=0)
    smooth /= np.maximum(norm, 1e-6)[:, None, None]
    sure = np.where(weight >= SEEN, weight, 0)
    frames = np.flatnonzero(seen & ((sure > 0).sum(1) >= MIN_JOINTS))
    return {int(frame): Body(joints[frame, :, :2].astype(np.float64), smooth[frame], sure[frame]) for frame in frames}


def smooth_scales(scales: dict[int, float]) -> dict[int, float]:
    """Median over neighbouring frames: one pose may be seen along the view, where its scale is a guess."""
    frames = np.array(list(scales))
    values = np.array([scales[frame] for frame in scales])
    return {int(frame): float(np.median(values[abs(frames - frame) <= 4])) for frame in frames}
