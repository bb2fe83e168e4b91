"""Angles beside the clip's camera at which a view stands, and up to which a scene can be believed, in numpy.

A view is judged at the point that the clip's camera looks at, at the median depth: the angle there between the view and the
nearest camera of the clip. A fit stores up to which angle its depth is good enough (`provenance["believed_degrees"]`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .model import Scene

DEPTH = 1.0
"""Depth of the point that a camera looks at, world units: the median depth of a clip."""
RING = 48
"""Corners of a ring."""


@dataclass(frozen=True, eq=False)
class BelievedZone:
    """The places from which a scene can be believed, in its own axes and unit."""

    degrees: float
    """Largest believed angle beside the clip's cameras."""
    eyes: np.ndarray
    """(T,3): the clip's cameras."""
    targets: np.ndarray
    """(T,3): what they look at."""

    @classmethod
    def of(cls, scene: Scene) -> BelievedZone | None:
        """Return the zone of a scene; None where its fit did not tell how far it can be believed."""
        degrees = scene.provenance.get("believed_degrees")
        if not isinstance(degrees, int | float) or not 0 <= degrees < 90:
            return None
        forward = scene.cameras.world_to_camera[:, 2, :3]
        return cls(float(degrees), scene.cameras.centers, scene.cameras.centers + DEPTH * forward)

    def aside(self, eye: np.ndarray) -> float:
        """Return the degrees from a view at `eye (3,)` to the nearest camera of the clip, at what that camera looks at."""
        to_eye, to_camera = eye - self.targets, self.eyes - self.targets
        lengths = np.linalg.norm(to_eye, axis=1) * np.linalg.norm(to_camera, axis=1)
        cosine = (to_eye * to_camera).sum(1) / np.maximum(lengths, 1e-12)
        return float(np.degrees(np.arccos(np.clip(cosine.max(), -1, 1))))

    def ring(self, index: int) -> np.ndarray:
        """Return (RING,3): the circle of places that see what camera `index` looks at from just the largest believed angle."""
        target, axis = self.targets[index], self.eyes[index] - self.targets[index]
        distance = np.linalg.norm(axis)
        axis = axis / distance
        side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        side /= np.linalg.norm(side)
        up = np.cross(axis, side)
        angle, around = np.radians(self.degrees), np.arange(RING)[:, None] * 2 * np.pi / RING
        return target + distance * (
            np.cos(angle) * axis + np.sin(angle) * (np.cos(around) * side + np.sin(around) * up)
        )

    def line(self, degrees: float) -> str:
        """Return the sentence about a view so many degrees aside; nothing where it can be believed."""
        if degrees <= self.degrees:
            return ""
        within = f"{self.degrees:.0f}°" if self.degrees >= 1 else "1°"
        return f"{degrees:.0f}° beside the clip's camera: guesswork (good up to about {within})"
