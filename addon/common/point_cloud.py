"""Point clouds with attributes, on every Blender version from 4.5."""

import bpy
import numpy as np

# attribute type -> (foreach_set key, components, type of a component: others are slow to hand over)
_LAYOUT = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, bool),
    "QUATERNION": ("value", 4, np.float32),
    "FLOAT4X4": ("value", 16, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "FLOAT4": ("vector", 4, np.float32),
}
FLOAT4 = "FLOAT4" if bpy.app.version >= (5, 2, 0) else "FLOAT_COLOR"
"""Four plain floats; Blender before 5.2 has only colours of four floats."""
RESIZES = "resize" in bpy.types.PointCloud.bl_rna.functions
"""True where points come and go within a point cloud; Blender before 5.1 makes another one."""


def write_attribute(data: bpy.types.ID, name: str, kind: str, values: np.ndarray) -> None:
    """Write one POINT attribute of a mesh or point cloud; `values` (N,) or (N,C). FLOAT4X4 wants (N,4,4) row-major."""
    key, components, dtype = _LAYOUT[kind]
    if kind == "FLOAT4X4":
        values = values.transpose(0, 2, 1)  # Blender stores columns one after the other
    flat = np.ascontiguousarray(values, dtype).ravel()
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
    if flat.size != components * len(attribute.data):
        raise ValueError(f"attribute {name} needs {components} x {len(attribute.data)} values, got {flat.size}")
    attribute.data.foreach_set(key, flat)


def read_attribute(data: bpy.types.ID, name: str) -> np.ndarray | None:
    """Return the values of one POINT attribute, (N,) or (N,C); None if it is missing or of an unsupported type."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type not in _LAYOUT:
        return None
    key, components, dtype = _LAYOUT[attribute.data_type]
    values = np.empty(len(attribute.data) * components, dtype)
    attribute.data.foreach_get(key, values)
    return values if components == 1 else values.reshape(-1, components)


def new_point_cloud(name: str, count: int, collection: bpy.types.Collection) -> bpy.types.Object:
    """Add an object with `count` points to `collection`; Gaussian splats where Blender has them (5.3)."""
    if RESIZES:
        cloud = bpy.data.pointclouds.new(name)
        cloud.resize(count)
        item = bpy.data.objects.new(name, cloud)
        collection.objects.link(item)
    else:
        item = _convert_mesh(name, count, collection)
    _use_splats(item.data)
    return item


def selected_in(layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """Return the selected objects, whether or not there is a current window, which `bpy.context.selected_objects` needs."""
    layer.update()
    return [item for item in layer.objects if item is not None and item.select_get(view_layer=layer)]


def select_only(item: bpy.types.Object) -> None:
    """Select an object alone and make it the active one."""
    layer = bpy.context.view_layer
    for other in selected_in(layer):
        other.select_set(False)
    item.select_set(True)
    layer.objects.active = item


def _convert_mesh(name: str, count: int, collection: bpy.types.Collection) -> bpy.types.Object:
    """Return a point cloud that is converted from the vertices of a mesh: Blender 4.5 and 5.0 have no other way."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(max(count, 1))  # an empty mesh does not convert
    item = bpy.data.objects.new(name, mesh)
    whole = bpy.context.scene.collection  # the other one may be left out of the view layer
    whole.objects.link(item)
    layer = bpy.context.view_layer
    selected, active = selected_in(layer), layer.objects.active
    select_only(item)
    bpy.ops.object.convert(target="POINTCLOUD")
    item.select_set(False)
    for other in selected:
        other.select_set(True)
    layer.objects.active = active
    if collection != whole:
        collection.objects.link(item)
        whole.objects.unlink(item)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)
    item.data.name = name
    return item


def _use_splats(cloud: bpy.types.PointCloud) -> None:
    """Turn on Blender 5.3's native Gaussian splats where the property exists."""
    kind = bpy.types.PointCloud.bl_rna.properties.get("type")
    splat = next((i.identifier for i in kind.enum_items if "SPLAT" in i.identifier), None) if kind else None
    if splat:
        cloud.type = splat
