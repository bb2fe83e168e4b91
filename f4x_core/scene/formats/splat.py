"""`.splat`: the 32-byte rows of antimatter15's web viewer, without a header (github.com/antimatter15/splat, convert.py).

Position and linear scale as float32; colour, opacity and rotation (wxyz, `128 q + 128`) as bytes; largest and most
opaque first. Axes are those of the PLY file it is made from. View-dependent colour does not fit in.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import F4xError
from ...files import replace_file
from ...geometry import quaternion, spherical_harmonics
from ..ply import Splats
from ..posing import Posable, moment, plain_color

ROW = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
QUATERNION_TOLERANCE = 4.0
"""Maximum distance from 128 of the length of a rotation's four bytes: rounding loses 1, cutting +1 off to 255 one more."""
PROBED = 4096
"""Rows looked at to tell whether a file without a header is one of these."""


def write_splat(scene: Posable, time: float, path: Path | str, transform: np.ndarray | None = None) -> None:
    """Write the scene at clip time `time`, moved by the 4x4 similarity `transform`. Raises F4xError."""
    posed = moment(scene, time, transform)
    posed_rgba = np.concatenate([plain_color(posed), posed.opacities[:, None]], axis=1)
    rows = np.empty(len(posed.ids), ROW)
    rows["xyz"], rows["scale"] = posed.means, posed.scales
    rows["rgba"] = np.rint(255 * posed_rgba)
    rows["rotation"] = np.clip(np.rint(128 * quaternion.normalize(posed.quats) + 128), 0, 255)
    importance = posed.scales.astype(np.float64).prod(axis=1) * posed.opacities
    with replace_file(path) as file:
        file.write(rows[np.argsort(-importance, kind="stable")].tobytes())


def read_splat(path: Path | str) -> Splats:
    """Read all rows; colours become harmonics of degree 0. Raises F4xError for anything but whole, finite rows."""
    path = Path(path)
    try:
        if path.stat().st_size % ROW.itemsize:
            raise F4xError(f"{path}: not whole rows of 32 bytes, so truncated or no .splat file; copy it again")
        rows = np.fromfile(path, ROW)
    except OSError as error:
        raise F4xError(f"{path}: cannot be read ({error.strerror or error}); choose a .splat file") from error
    bad = np.count_nonzero(~(np.isfinite(rows["xyz"]) & np.isfinite(rows["scale"]) & (rows["scale"] >= 0)).all(axis=1))
    if bad:
        raise F4xError(
            f"{path}: {bad} of {len(rows)} splats have no finite position or scale; clean it in a splat editor"
        )
    rgba = rows["rgba"].astype(np.float32) / 255
    return Splats(
        means=rows["xyz"].copy(),
        quats=quaternion.normalize(rows["rotation"].astype(np.float32) - 128),
        scales=rows["scale"].copy(),
        opacities=rgba[:, 3].copy(),
        sh=spherical_harmonics.dc_from_rgb(rgba[:, None, :3]).astype(np.float32),
    )


def looks_like_splat(path: Path) -> bool:
    """Return True if a file without a header holds such rows: whole ones, finite, with unit rotations."""
    size = path.stat().st_size
    if size == 0 or size % ROW.itemsize:
        return False
    rows = np.fromfile(path, ROW, PROBED)
    length = np.linalg.norm(rows["rotation"].astype(float) - 128, axis=1)
    with np.errstate(invalid="ignore"):
        plausible = np.isfinite(rows["xyz"]).all(axis=1) & (rows["scale"] >= 0).all(axis=1)
    return bool((plausible & (np.abs(length - 128) < QUATERNION_TOLERANCE)).all())
