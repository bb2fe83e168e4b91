"""Found people against those of a rendered clip: their masks, their joints, and which of two limbs is in front."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from f4x_core.priors import Priors
from f4x_core.priors.joints import LIMBS, NAMES, turn_to_ray
from f4x_core.priors.synthetic import Truth

NEAR = 0.05
"""Fraction of a person's height in the picture within which a joint is right."""
OVERLAP = 0.06
"""Fraction of that height within which the axes of two limbs pass each other where the limbs overlap in the picture."""
MIN_APART = 0.03
"""Distance along the view, in heights, from which one of two limbs is in front."""
SAMPLES = np.linspace(0, 1, 11)
"""Places along a limb at which two limbs are compared."""
MATCHED = 0.1
"""J from which a found person is the rendered one in a frame."""
MIN_PIXELS = 30
"""Of a person in a frame that counts."""
LIMB_JOINTS = [
    i for i, name in enumerate(NAMES) if name.split()[-1] in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
]
"""Joints that mean the same on every rig; faces, hands and feet of figures have shapes of their own."""
OWN_PLACE = [
    i for i, name in enumerate(NAMES) if not any(part in name for part in ("inner", "outer", "thumb", "little"))
]
"""Joints that rendered figures have; the others stand where their neighbours do."""
SEGMENTS = [(part, pair) for part in ("left arm", "right arm", "left leg", "right leg") for pair in LIMBS[part]]
SEGMENTS += [("torso", pair) for pair in ((11, 23), (12, 24))]
"""Part of the body and joints of what is compared."""
CROSSINGS = [
    (first, second)
    for (part, first), (other, second) in combinations(SEGMENTS, 2)
    if part != other and not set(first) & set(second)
]


@dataclass(frozen=True)
class PersonScore:
    """One rendered person; `joints` and the limbs count the frames in which the person was found."""

    frames: int
    """That show the person."""
    height: float
    """Median of the person's height, standing, in heights of the picture."""
    found: float
    """Fraction of these frames in which the mask is the person's."""
    iou: float
    """Mean J of the mask over these frames; 0 where nobody was found."""
    joints: float
    """Fraction of the joints that nothing else hides within `NEAR`."""
    limb_joints: float
    """The same of `LIMB_JOINTS` alone."""
    joint_error: float
    """Median distance of those, in heights."""
    crossings: int
    """Pairs of limbs that overlap in the picture, one of them in front."""
    ordered: float
    """Fraction of these whose order along the view is right."""


def score_people(found: Priors, truth: Truth) -> list[PersonScore]:
    """Each rendered person against the found one whose masks overlap most with the person's."""
    assert truth.people is not None and found.people is not None and found.people_joints is not None
    scores = []
    for person in range(len(truth.people.heights)):
        shown = truth.people.who[found.frames] == person + 1
        frames = np.flatnonzero(shown.sum((1, 2)) >= MIN_PIXELS)
        overlaps = [_overlaps(found, who, shown)[frames] for who in range(found.people_joints.shape[1])]
        best = int(np.argmax([one.mean() for one in overlaps])) if overlaps else None
        iou = overlaps[best] if best is not None else np.zeros(len(frames))
        poses = [
            _Pose.of(found, truth, person, best, int(frame))
            for frame, j in zip(frames, iou, strict=True)
            if j > MATCHED
        ]
        scores.append(_summary(poses, truth, person, found.frames[frames], iou))
    return scores


def _overlaps(found: Priors, who: int, shown: np.ndarray) -> np.ndarray:
    """J (F,) of a found person's mask with `shown (F, H, W)`."""
    assert found.people is not None and found.people_probability is not None
    mask = (found.people == who + 1) & (found.people_probability > 0.5)
    return (mask & shown).sum((1, 2)) / np.maximum((mask | shown).sum((1, 2)), 1)


@dataclass(frozen=True)
class _Pose:
    """True and found joints of one person in one frame; `pixels` are parted by the person's height in the picture."""

    true_pixels: np.ndarray
    """(33, 2) heights."""
    true_depth: np.ndarray
    """(33,) heights, along the view."""
    seen: np.ndarray
    """(33,) bool: nothing else hides the joint."""
    pixels: np.ndarray
    """(33, 2) heights; NaN where the person was not found."""
    depth: np.ndarray
    """(33,) metres, along the view."""

    @classmethod
    def of(cls, found: Priors, truth: Truth, person: int, who: int | None, row: int) -> _Pose:
        assert truth.people is not None and found.people_joints is not None and found.people_metres is not None
        frame = int(found.frames[row])
        camera, height = truth.cameras[frame], float(truth.people.heights[person])
        true = truth.people.pixels(frame, camera)[person]
        _, depth = camera.project(truth.people.joints[frame, person])
        scale = pixel_height(truth, person, frame)
        joints, metres = found.people_joints[row, who], found.people_metres[row, who]
        metres = metres @ turn_to_ray(joints[None], camera.intrinsics)[0].T
        return cls(true[:, :2] / scale, depth / height, true[:, 2] > 0, joints[:, :2] / scale, metres[:, 2])

    def distances(self, joints: list[int]) -> np.ndarray:
        """Return (n,) heights from the true `joints` to the found ones, of those that nothing hides."""
        which = np.array(joints)[self.seen[joints]]
        return np.linalg.norm(self.pixels[which] - self.true_pixels[which], axis=1)

    def orders(self) -> list[bool]:
        """For each pair of limbs that overlap in the picture, whether the nearer one is the nearer one."""
        right = []
        for first, second in CROSSINGS:
            if not self.seen[[*first, *second]].all():
                continue
            here, there = (_along(self.true_pixels, limb) for limb in (first, second))
            apart = np.linalg.norm(here[:, None] - there[None], axis=-1)
            i, k = np.unravel_index(apart.argmin(), apart.shape)
            nearer = _along(self.true_depth, second)[k] - _along(self.true_depth, first)[i]
            if apart[i, k] < OVERLAP and abs(nearer) > MIN_APART:
                right.append(bool((_along(self.depth, second)[k] - _along(self.depth, first)[i]) * nearer > 0))
        return right


def _along(values: np.ndarray, limb: tuple[int, int]) -> np.ndarray:
    """Values (33, ...) of joints at `SAMPLES` along a limb."""
    start, end = values[limb[0]], values[limb[1]]
    return start + np.multiply.outer(SAMPLES, end - start)


def pixel_height(truth: Truth, person: int, frame: int) -> float:
    """Height in pixels that the person has upright, at the distance of the middle of the joints."""
    assert truth.people is not None
    camera = truth.cameras[frame]
    _, depth = camera.project(truth.people.joints[frame, person])
    return float(camera.intrinsics[1, 1] * truth.people.heights[person] / np.mean(depth))


def _summary(poses: list[_Pose], truth: Truth, person: int, frames: np.ndarray, iou: np.ndarray) -> PersonScore:
    tall = [pixel_height(truth, person, int(frame)) / truth.cameras.height for frame in frames]
    poses = [pose for pose in poses if np.isfinite(pose.pixels).all()]
    every, limbs = (
        np.concatenate([np.zeros(0), *(pose.distances(joints) for pose in poses)])
        for joints in (OWN_PLACE, LIMB_JOINTS)
    )
    orders = [right for pose in poses for right in pose.orders()]
    return PersonScore(
        frames=len(frames),
        height=float(np.median(tall)) if tall else np.nan,
        found=float((iou > MATCHED).mean()) if len(iou) else np.nan,
        iou=float(iou.mean()) if len(iou) else np.nan,
        joints=float((every < NEAR).mean()) if len(every) else np.nan,
        limb_joints=float((limbs < NEAR).mean()) if len(limbs) else np.nan,
        joint_error=float(np.median(limbs)) if len(limbs) else np.nan,
        crossings=len(orders),
        ordered=float(np.mean(orders)) if orders else np.nan,
    )
