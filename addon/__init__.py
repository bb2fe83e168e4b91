"""The Blender extension: what imports bpy. Blender's axes exist only here; the numerics live in `f4x_core`."""
