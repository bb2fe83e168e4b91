"""A triangle mesh around some of a scene's Gaussians, skinned by the nodes that carry them: what light and contact need.

`field` sums opacity on a grid, `contour` finds the surface in it, `simplify` cleans it, `skin` hangs it on the nodes, `build` does
all of that. numpy alone, because Blender's own Python does it too.
"""

from .build import MeshConfig, NoNodeError, SplatMesh, mesh_of
from .skin import Skin, carried, deviation

__all__ = ["MeshConfig", "NoNodeError", "Skin", "SplatMesh", "carried", "deviation", "mesh_of"]
