"""Gaussians as point attributes: where they are and what they look like, in the names that Blender 5.3 draws as splats."""

import bpy
import numpy as np

from ..f4x_core.geometry import spherical_harmonics
from ..f4x_core.scene.color import linear_from_srgb
from .point_cloud import FLOAT4, write_attribute

FITTED_FOCAL = "f4x_fitted_focal"
"""Custom property of a point cloud: `Scene.fitted_focal` of the scene that it shows. The render engine draws by it."""


def write_places(cloud: bpy.types.PointCloud, means: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> None:
    """Write `means (N,3)`, unit `rotation (N,4)` wxyz and `scale (N,3)`, in the frame of the cloud's object."""
    write_attribute(cloud, "position", "FLOAT_VECTOR", means)
    write_attribute(cloud, "scale", "FLOAT_VECTOR", scale)
    write_attribute(cloud, "rotation", "QUATERNION", rotation)
    # Engines that know no splats draw balls: of the ellipsoid's own volume, or flat splats would bulge out of their surface.
    write_attribute(cloud, "radius", "FLOAT", np.prod(scale, axis=1) ** (1 / 3))


def write_appearance(cloud: bpy.types.PointCloud, rotation: np.ndarray, sh: np.ndarray, opacity: np.ndarray) -> None:
    """Write harmonics `sh (N,S,3)`, in the Gaussians' own frames which `rotation (N,4)` turns, and `opacity (N,)`."""
    sh = spherical_harmonics.rotate(sh, rotation)  # own frame -> the object's frame
    rgb = np.clip(spherical_harmonics.rgb_from_dc(sh[:, 0]), 0.0, 1.0)
    alpha = opacity[:, None]
    write_attribute(cloud, "radiance:base", FLOAT4, np.concatenate([sh[:, 0], alpha], 1))
    for i in range(1, sh.shape[1]):
        write_attribute(cloud, f"radiance:sh_{i - 1}", "FLOAT_VECTOR", sh[:, i])
    write_attribute(cloud, "rgb", "FLOAT_COLOR", np.concatenate([linear_from_srgb(rgb), alpha], 1))
