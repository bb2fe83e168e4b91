"""The clip behind the scene: pictures or film as the background of its camera."""

from pathlib import Path

import bpy
import numpy as np

from ..f4x_core.clip.images import SUFFIXES
from ..f4x_core.clip.layouts import find_layout
from ..f4x_core.errors import F4xError
from ..f4x_core.scene import Scene

FILMS = {".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v", ".mpg", ".mpeg", ".ogv"}


def find_clip(scene: Scene, file: Path) -> Path | None:
    """The clip that the scene was made of, if it still lies where it was or beside the scene `file`; None if not."""
    source = scene.provenance.get("source")
    if not isinstance(source, str) or not source:
        return None
    places = (Path(source), file.parent / source, file.parent.parent / source, file.parent / Path(source).name)
    return next((place for place in places if place.exists()), None)


def show_clip(camera: bpy.types.Object, clip: Path, frames: np.ndarray, *, exact: bool = False) -> bool:
    """Show `clip`, a film or a folder of numbered pictures, in `camera` at Blender frames `frames (T,)`; whether it did.

    `exact`: only when it has one picture for each frame, so that a selection of frames is never shown beside another.
    Raises F4xError for what is neither.
    """
    if clip.is_dir():
        pictures = find_layout(clip).images
        if exact and len(pictures) != len(frames):
            return False
        image = _image(pictures[0])
        image.source = "SEQUENCE"
        first, count = _first_number(pictures), len(pictures)
    elif clip.suffix.lower() in FILMS | SUFFIXES:
        image = _image(clip)
        first, count = 1, image.frame_duration
        if exact and count != len(frames):
            bpy.data.images.remove(image)
            return False
    else:
        raise F4xError(
            f"{clip} is neither a film nor a folder of pictures; choose the clip that the scene was made of."
        )
    backgrounds = camera.data.background_images
    backgrounds.clear()
    background = backgrounds.new()
    background.image, background.alpha = image, 1.0
    background.display_depth, background.frame_method = "BACK", "STRETCH"
    user = background.image_user
    user.frame_start, user.frame_duration = int(frames[0]), count
    user.frame_offset = first - 1
    user.use_auto_refresh = True
    camera.data.show_background_images = True
    return True


def _image(file: Path) -> bpy.types.Image:
    try:
        return bpy.data.images.load(str(file.resolve()), check_existing=True)
    except RuntimeError as error:
        raise F4xError(f"{file} cannot be read as a picture or a film; choose another clip.") from error


def _first_number(pictures: list[Path]) -> int:
    """Number in the first name; F4xError unless the names count on from there, which is how Blender finds the others."""
    digits = [name[len(name.rstrip("0123456789")) :] for name in (picture.stem for picture in pictures)]
    if not all(digits) or [int(number) for number in digits] != list(
        range(int(digits[0]), int(digits[0]) + len(digits))
    ):
        raise F4xError(
            f"{pictures[0].parent}: the pictures are not numbered one after the other, as Blender wants; rename them."
        )
    return int(digits[0])
