"""The render engine: the evaluated Blender scene, shadows, viewports, compositing."""
