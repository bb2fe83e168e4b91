"""The 33 joints of BlazePose (Bazarevsky et al. 2020) by name, and the limbs between them."""

from __future__ import annotations

import re

import numpy as np

NAMES = (
    "nose",
    "left eye inner",
    "left eye",
    "left eye outer",
    "right eye inner",
    "right eye",
    "right eye outer",
    "left ear",
    "right ear",
    "mouth left",
    "mouth right",
    "left shoulder",
    "right shoulder",
    "left elbow",
    "right elbow",
    "left wrist",
    "right wrist",
    "left little finger",
    "right little finger",
    "left index finger",
    "right index finger",
    "left thumb",
    "right thumb",
    "left hip",
    "right hip",
    "left knee",
    "right knee",
    "left ankle",
    "right ankle",
    "left heel",
    "right heel",
    "left toes",
    "right toes",
)
"""Joint -> its name; left and right are the person's own."""
JOINTS = len(NAMES)
SHOULDERS, HIPS = (11, 12), (23, 24)
TORSO = (*SHOULDERS, *HIPS)
FEET = (29, 30, 31, 32)
"""Heels and toes."""
ANKLES = (27, 28)
LEGS = ((25, 27, 29, 31), (26, 28, 30, 32))
"""Left and right: knee, ankle, heel and toes."""
BODY = (*range(11, 17), *range(23, 29))
"""Shoulders, elbows, wrists, hips, knees and ankles."""
OTHER_SIDE = tuple(
    NAMES.index(re.sub("left|right", lambda side: "right" if side[0] == "left" else "left", name)) for name in NAMES
)
"""Joint -> the same one on the other side of the body; a mirror exchanges them."""
LIMBS = {
    "head": ((0, 7), (0, 8), (7, 8)),
    "torso": ((11, 12), (23, 24), (11, 23), (12, 24), (11, 24), (12, 23)),
    "left arm": ((11, 13), (13, 15)),
    "right arm": ((12, 14), (14, 16)),
    "left hand": ((15, 17), (15, 19), (15, 21)),
    "right hand": ((16, 18), (16, 20), (16, 22)),
    "left leg": ((23, 25), (25, 27)),
    "right leg": ((24, 26), (26, 28)),
    "left foot": ((27, 29), (29, 31), (27, 31)),
    "right foot": ((28, 30), (30, 32), (28, 32)),
}
"""Part of the body -> the segments between joints that run through it."""


def to_segments(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances `(n, s)` of `points (n, 2)` to segments `start, end (s, 2)`, and the place of the nearest, 0..1."""
    along, away = end - start, points[:, None] - start
    part = np.clip((away * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-9), 0, 1)
    return np.linalg.norm(away - part[..., None] * along, axis=-1), part


def turn_to_ray(joints: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) shortest rotation of the camera's z axis to the ray through between the hips of `joints (n, 33, 3)`.

    It turns metres along that ray, as networks know them, into the axes of the camera. intrinsics: (3, 3), or (n, 3, 3).
    """
    hips = joints[:, list(HIPS), :2].mean(1)
    ray = np.ones((len(hips), 3))
    ray[:, :2] = (hips - intrinsics[..., :2, 2]) / np.stack([intrinsics[..., 0, 0], intrinsics[..., 1, 1]], -1)
    x, y, z = (ray / np.linalg.norm(ray, axis=1, keepdims=True)).T
    cross = np.zeros((len(ray), 3, 3))
    cross[:, 0, 2], cross[:, 2, 0], cross[:, 1, 2], cross[:, 2, 1] = x, -x, y, -y
    return np.eye(3) + cross + cross @ cross / (1 + z)[:, None, None]
