"""Gaussians as point attributes: where they are and what they look like, in the names that Blender 5.3 draws as splats.

Where Blender draws splats itself, `scale` and `radiance:base` are the appearance for linear light (`f4x_core.scene.linear`); two
more attributes say how the fitted one, which our engine draws, follows from them.
"""

import bpy
import numpy as np

from ...f4x_core.geometry import spherical_harmonics
from ...f4x_core.scene.color import linear_from_srgb
from ...f4x_core.scene.linear import Fitted, Look
from .point_cloud import FLOAT4, read_attribute, write_attribute

FITTED_FOCAL = "f4x_fitted_focal"
"""Custom property of a point cloud: `Scene.fitted_focal` of the scene that it shows. The render engine draws by it."""

RECOLORED = "f4x_recolored"
"""Point attribute, BOOLEAN: points whose harmonics an edit or a heat map made other than the scene file's."""


FITTED_SCALE, FITTED_BASE = "f4x_fitted_scale", "f4x_fitted_base"
"""Point attributes, `Fitted.scale` and `Fitted.dc` with `Fitted.depth`; there where Blender draws splats itself."""


def draws_splats() -> bool:
    """Return True if this Blender has splats of its own (5.3)."""
    return "type" in bpy.types.PointCloud.bl_rna.properties


def write_linear(cloud: bpy.types.PointCloud, fitted: Look, linear: Look) -> None:
    """Let other engines draw `linear` and ours `fitted`; both of all points, of which the fitted one has been written."""
    step = Fitted.of(fitted, linear)
    write_attribute(cloud, "scale", "FLOAT_VECTOR", linear.scales)
    write_attribute(cloud, "radiance:base", FLOAT4, np.concatenate([linear.dc, linear.opacities[:, None]], 1))
    write_attribute(cloud, "rgb", "FLOAT_COLOR", np.concatenate([_light_of(linear.dc), linear.opacities[:, None]], 1))
    write_attribute(cloud, FITTED_SCALE, "FLOAT_VECTOR", step.scale)
    write_attribute(cloud, FITTED_BASE, FLOAT4, np.concatenate([step.dc, step.depth[:, None]], 1))


def read_look(cloud: bpy.types.PointCloud) -> Look | None:
    """Return the fitted appearance of evaluated points, whatever modifiers did to them; None where they are no Gaussians."""
    scales, base = (read_attribute(cloud, name) for name in ("scale", "radiance:base"))
    if scales is None or base is None:
        return None
    look = Look(scales, np.clip(base[:, 3], 0, 1), base[:, :3])
    scale, shift = (read_attribute(cloud, name) for name in (FITTED_SCALE, FITTED_BASE))
    return look if scale is None or shift is None else Fitted(scale, shift[:, :3], shift[:, 3]).from_linear(look)


def write_places(cloud: bpy.types.PointCloud, means: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> None:
    """Write `means (N,3)`, unit `rotation (N,4)` wxyz and `scale (N,3)`, in the frame of the cloud's object."""
    write_attribute(cloud, "position", "FLOAT_VECTOR", means)
    write_attribute(cloud, "scale", "FLOAT_VECTOR", scale)
    write_attribute(cloud, "rotation", "QUATERNION", rotation)
    # Engines that know no splats draw balls: of the ellipsoid's own volume, or flat splats would bulge out of their surface.
    write_attribute(cloud, "radius", "FLOAT", np.prod(scale, axis=1) ** (1 / 3))


def write_appearance(
    cloud: bpy.types.PointCloud,
    rotation: np.ndarray,
    sh: np.ndarray,
    opacity: np.ndarray,
    rows: np.ndarray | None = None,
) -> None:
    """Write harmonics `sh (N,S,3)`, in the Gaussians' own frames which `rotation (N,4)` turns, and `opacity (N,)`.

    `rows (n,)` int: the other points keep their harmonics, whose turning takes most of the time, and get their opacity.
    """
    if rows is not None:
        rotation, sh = rotation[rows], sh[rows]
    sh = spherical_harmonics.rotate(sh, rotation)  # own frame -> the object's frame
    for name, kind, colors in (("radiance:base", FLOAT4, sh[:, 0]), ("rgb", "FLOAT_COLOR", _light_of(sh[:, 0]))):
        values = _kept(cloud, name, rows, (len(opacity), 4))
        values[slice(None) if rows is None else rows, :3] = colors
        values[:, 3] = opacity
        write_attribute(cloud, name, kind, values)
    if rows is not None and not len(rows):
        return
    for i in range(1, sh.shape[1]):
        values = _kept(cloud, f"radiance:sh_{i - 1}", rows, (len(opacity), 3))
        values[slice(None) if rows is None else rows] = sh[:, i]
        write_attribute(cloud, f"radiance:sh_{i - 1}", "FLOAT_VECTOR", values)


def _light_of(dc: np.ndarray) -> np.ndarray:
    """Return (N,3) linear light of the colors that coefficients of degree 0 make; what materials read as `rgb`."""
    return linear_from_srgb(np.clip(spherical_harmonics.rgb_from_dc(dc), 0.0, 1.0))


def _kept(cloud: bpy.types.PointCloud, name: str, rows: np.ndarray | None, shape: tuple[int, int]) -> np.ndarray:
    """Return the values of an attribute of which only `rows` change; zeros where all do."""
    values = None if rows is None else read_attribute(cloud, name)
    return np.zeros(shape, np.float32) if values is None else values
