"""The camera's motion through a clip in words. Needs numpy alone."""

from __future__ import annotations

import numpy as np

from ..geometry import quaternion
from ..geometry.camera import CameraPath
from .wording import Asked

SHIFT = 0.005
"""World units (1 = median depth) up to which a camera stays in its place."""
TURN = 0.3
"""Degrees up to which it does not turn."""
ONE_WAY = 0.5
"""Part of a turn that goes one way for that way to be named."""


def camera_words(path: CameraPath, asked: Asked) -> str:
    """Return the sentence that answers a question about the motion of the camera of `path`.

    Lengths are between its outermost places, angles between its outermost orientations.
    """
    centers, rotations = path.centers, path.world_to_camera[:, :3, :3]
    apart = float(np.linalg.norm(centers[:, None] - centers, axis=-1).max())
    degrees = max(float(np.degrees(quaternion.angles_between(rotations, one)).max()) for one in rotations)
    does = []
    if apart > SHIFT:
        does.append(f"moves by up to {apart:.2f} times the median depth")
    if degrees > TURN:
        does.append(f"turns{_way(rotations)} by up to {degrees:.{degrees < 10:d}f} degrees")
    answer = asked.yes(degrees > TURN if asked.manner == "turn" else bool(does))
    if does and apart <= SHIFT:
        does.append("stays in its place")
    sentence = f"the camera {' and '.join(does) or 'stands still'}."
    return f"{answer}: {sentence}" if answer else sentence.capitalize()


def _way(rotations: np.ndarray) -> str:
    """Return " to the left" or another way in which a camera with `rotations (T,3,3)` from the world mostly turns, or ""."""
    ahead = rotations[0] @ rotations[:, 2].T  # (3,T) where it looks, in its own first axes
    across, down = ahead[0, -1], ahead[1, -1]
    if max(abs(across), abs(down)) <= ONE_WAY * np.abs(ahead[:2]).max():
        return ""
    if abs(across) > abs(down):
        return f" to the {'right' if across > 0 else 'left'}"
    return " down" if down > 0 else " up"
