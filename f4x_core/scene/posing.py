"""Poses the Gaussians of one moment for export: moved as a whole, in the axes of the format."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ..errors import F4xError
from ..geometry import quaternion, spherical_harmonics
from ..geometry.camera import CameraPath
from ..geometry.similarity import Similarity
from ..scaffold import Scaffold
from .model import PosedSplats

Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Half a turn around x: from the scene's axes (x right, y down, z forward) to those of glTF and of a Y-up USD stage."""
SIMILARITY_TOLERANCE = 1e-4
"""Relative; what float32 matrices of a modelling program lose when they are multiplied a few times."""


class Posable(Protocol):
    """Something that can be exported: a `Scene`, with or without edits, or a sequence of splat files."""

    @property
    def name(self) -> str:
        """Short name, used for exported files."""

    @property
    def fps(self) -> float:
        """Clip frames per second."""

    @property
    def cameras(self) -> CameraPath:
        """Cameras of the clip frames; their times are the clip's."""

    @property
    def offset(self) -> np.ndarray:
        """(3,) float64 to be added to positions for those of the file that it comes from; mostly 0."""

    @property
    def scaffold(self) -> Scaffold | None:
        """The scaffold that moves the dynamic Gaussians, if there is one."""

    def posed(self, time: float) -> PosedSplats:
        """Return all Gaussians at a clip time."""


def similarity_of(matrix: np.ndarray) -> Similarity:
    """Return the similarity `x -> s R x + t` of a 4x4 matrix.

    Raises F4xError for uneven scale, shear, a mirror or a projection: Gaussians and their harmonics cannot follow those.
    """
    matrix = np.asarray(matrix, np.float64)
    if matrix.shape == (4, 4) and np.isfinite(matrix).all() and (matrix[3] == [0, 0, 0, 1]).all():
        linear = matrix[:3, :3]
        scale = np.cbrt(np.linalg.det(linear))
        if scale > 0 and np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() < SIMILARITY_TOLERANCE:
            return Similarity(matrix[:3, 3], quaternion.from_matrix(linear / scale), float(scale))
    raise F4xError(
        "transform: this 4x4 matrix is not a move, a turn and one even scale (it shears, mirrors or scales unevenly);"
        " give one that is, or none"
    )


def transformed(posed: PosedSplats, matrix: np.ndarray | None) -> PosedSplats:
    """Return `posed` moved as a whole by a 4x4 similarity (None: not at all).

    Harmonics stay: they are in each Gaussian's own frame, which turns with it. Raises F4xError like `similarity_of`.
    """
    if matrix is None:
        return posed
    move = similarity_of(matrix)
    return replace(
        posed,
        means=move(posed.means.astype(np.float64)).astype(np.float32),
        quats=quaternion.multiply(move.rotation, posed.quats.astype(np.float64)).astype(np.float32),
        scales=(move.scale * posed.scales).astype(np.float32),
    )


def require_time(scene: Posable, time: float, flag: str) -> None:
    """Raise F4xError when `time`, named by `flag`, lies outside the clip of `scene`."""
    first, last = scene.cameras.times[[0, -1]]
    if not first <= time <= last:
        raise F4xError(f"{flag}: T must lie within the clip's frames, {first:g} to {last:g}.")


def moment(scene: Posable, time: float, transform: np.ndarray | None = None) -> PosedSplats:
    """Return all that is visible at clip time `time`, moved by `transform`; deleted Gaussians (opacity 0) are left out."""
    return visible(scene.posed(time), transform)


def visible(posed: PosedSplats, transform: np.ndarray | None = None) -> PosedSplats:
    """Return the visible part of `posed`, moved by `transform`; deleted Gaussians (opacity 0) are left out."""
    return transformed(posed.take(posed.opacities > 0), transform)


def world_harmonics(posed: PosedSplats, degree: int = spherical_harmonics.MAX_DEGREE) -> np.ndarray:
    """Return (N,S,3) float32 coefficients for directions in world axes, as every other program expects, up to `degree`."""
    return spherical_harmonics.rotate(posed.sh[:, : (degree + 1) ** 2], posed.quats)


def plain_color(posed: PosedSplats) -> np.ndarray:
    """Return (N,3) sRGB in [0, 1]: the colour without its dependence on the view, for formats that know no harmonics."""
    return np.clip(spherical_harmonics.rgb_from_dc(posed.sh[:, 0]), 0, 1)
