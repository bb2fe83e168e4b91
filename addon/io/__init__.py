"""Reading scene and splat files into Blender; the clip's camera, background and render settings."""
