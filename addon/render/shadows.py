"""Shadows of Blender's meshes on the Gaussians of a rendered picture: lamps and meshes as the core's, rays by Blender's BVH."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, PointerProperty
from mathutils.bvhtree import BVHTree

from ...f4x_core.scene import shadows
from ...f4x_core.scene.clouds import Cloud
from ..scene.scene_object import SceneObject
from .evaluated import OF, SOLID
from .surfaces import surface_of


class F4X_PG_shadows(bpy.types.PropertyGroup):  # noqa: N801 - Blender wants this form
    """Shadows on Gaussians."""

    use: BoolProperty(  # type: ignore[valid-type]
        name="Shadows on Gaussians",
        description="In final renders, let meshes take the light of lamps away from Gaussians",
    )
    strength: FloatProperty(  # type: ignore[valid-type]
        name="Strength",
        description="Fraction of a Gaussian's light that is lost where no lamp reaches it",
        default=shadows.STRENGTH,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )


def lighting(depsgraph: bpy.types.Depsgraph) -> Callable[[bpy.types.Object, Cloud], Cloud] | None:
    """Return the function that lights a cloud for `evaluated.stage`; None if shadows are off or nothing can cast one."""
    settings = depsgraph.scene.f4x_shadows
    if not settings.use:
        return None
    lamps, casters = _lamps(depsgraph), _casters(depsgraph)
    if not lamps or not casters:
        return None

    def lit(item: bpy.types.Object, cloud: Cloud) -> Cloud:
        root = _root(item)
        # objects of the clip have their shadows in it already
        others = [caster for caster, made_of in casters if made_of is None or made_of != root]
        light = shadows.light_left(cloud.places, lamps, others, settings.strength)
        return cloud if (light == 1).all() else replace(cloud, light=light)

    return lit


def _root(item: bpy.types.Object) -> bpy.types.Object | None:
    """Return the root of the scene that an evaluated object is a part of."""
    found = SceneObject.of(item.original)
    return None if found is None else found.root


def _lamps(depsgraph: bpy.types.Depsgraph) -> list[shadows.Lamp]:
    """Return the lamps that cast shadows."""
    found = []
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type == "LIGHT" and instance.show_self and item.data.use_shadow:
            lamp = _lamp(item.data, np.array(instance.matrix_world))
            if lamp.power > 0:
                found.append(lamp)
    return found


def _lamp(data: bpy.types.Light, matrix: np.ndarray) -> shadows.Lamp:
    """Return a lamp as the core's; it shines along its -z axis."""
    power = data.energy * 2 ** getattr(data, "exposure", 0.0) * sum(data.color) / 3
    axes, place = matrix[:3, :3], matrix[:3, 3]
    back = axes[:, 2] / np.linalg.norm(axes[:, 2])
    if data.type == "SUN":
        return shadows.Sun(power, float(np.tan(data.angle / 2)), back)
    if data.type == "AREA":
        longer = data.size if data.shape in ("SQUARE", "DISK") else data.size_y
        sides = np.array([data.size * axes[:, 0], longer * axes[:, 1]]) / 2
        return shadows.Area(power, place, sides, -back, data.shape in ("DISK", "ELLIPSE"), data.spread)
    if data.type == "SPOT":
        cosine = float(np.cos(data.spot_size / 2))
        return shadows.Spot(power, data.shadow_soft_size, place, np.linalg.inv(axes), cosine, data.spot_blend)
    return shadows.Ball(power, data.shadow_soft_size, place)


def _casters(depsgraph: bpy.types.Depsgraph) -> list[tuple[shadows.Caster, bpy.types.Object | None]]:
    """Return everything solid that casts shadows, seen by the camera or not; of a mesh of Gaussians also the root of its scene."""
    found = []
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type not in SOLID or not instance.show_self or not item.visible_shadow or item.is_shadow_catcher:
            continue
        surface = surface_of(item, np.array(instance.matrix_world))
        if surface is not None:
            corners = surface.triangles.reshape(-1, 3)
            box = np.stack([corners.min(0), corners.max(0)]).astype(float)
            root = _root(item) if OF in item.original else None
            found.append((shadows.Caster(box, _rays(corners)), root))
    return found


def _rays(corners: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return `Caster.blocks` of triangles whose corners are (3T,3) in the world."""
    tree = BVHTree.FromPolygons(corners.tolist(), np.arange(len(corners)).reshape(-1, 3).tolist(), all_triangles=True)

    def blocks(starts: np.ndarray, ways: np.ndarray) -> np.ndarray:
        lengths = np.linalg.norm(ways, axis=1).tolist()
        rays = zip(starts.tolist(), ways.tolist(), lengths, strict=True)
        return np.array([tree.ray_cast(start, way, length)[3] is not None for start, way, length in rays], bool)

    return blocks


CLASSES = (F4X_PG_shadows,)


def register() -> None:
    """Add the settings to scenes."""
    bpy.types.Scene.f4x_shadows = PointerProperty(type=F4X_PG_shadows)


def unregister() -> None:
    """Undo `register`."""
    del bpy.types.Scene.f4x_shadows
