"""Writing rendered pictures, the same way on every Blender version."""

from pathlib import Path

import bpy

ENGINE = "FEATURE4X"
"""Identifier of the render engine."""


def _use_format(scene: bpy.types.Scene, file_format: str, media_type: str, depth: str) -> None:
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # Blender 5.0+ offers only the formats of the chosen media type
        image.media_type = media_type
    image.file_format = file_format
    image.color_depth = depth


def save_multilayer(scene: bpy.types.Scene, path: Path) -> None:
    """Render the current frame into a float32 multilayer EXR."""
    _use_format(scene, "OPEN_EXR_MULTILAYER", "MULTI_LAYER_IMAGE", "32")
    scene.render.image_settings.exr_codec = "ZIP"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def save_png(scene: bpy.types.Scene, path: Path) -> None:
    """Write the last render result as an 8-bit sRGB PNG."""
    _use_format(scene, "PNG", "IMAGE", "8")
    scene.render.image_settings.color_mode = "RGB"
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)
