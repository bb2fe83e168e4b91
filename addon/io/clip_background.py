"""The clip behind the scene: pictures or film as the background of its camera."""

import re
from pathlib import Path

import bpy
import numpy as np

from ...f4x_core.clip.images import SUFFIXES
from ...f4x_core.clip.layouts import find_layout
from ...f4x_core.clip.model import Picture
from ...f4x_core.errors import F4xError
from ...f4x_core.scene import Scene
from ...f4x_core.scene.resemblance import ALIKE, resemblance
from ..scene.clip_time import Numbers, drive_background

FILMS = {".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v", ".mpg", ".mpeg", ".ogv"}


def find_clip(scene: Scene, file: Path) -> Path | None:
    """Return the clip that the scene was fitted to, at its stored path or beside the scene `file`; None if it is at neither."""
    source = scene.provenance.get("source")
    if not isinstance(source, str) or not source:
        return None
    places = (Path(source), file.parent / source, file.parent.parent / source, file.parent / Path(source).name)
    return next((place for place in places if place.exists()), None)


def frames_of(scene: Scene) -> range | None:
    """Return the indices of the clip's frames that a scene was fitted to, from its provenance; None if unknown."""
    span = scene.fitted_frames
    if span is None or not re.fullmatch(r"\d+:\d+:[1-9]\d*", span):
        return None
    first, end, step = map(int, span.split(":"))
    return range(first, end, step)


def has_bars(scene: Scene) -> bool:
    """Return True if the clip that the scene was fitted to has black bars, which the scene has not."""
    return Picture.read(scene.provenance.get("picture")) is not None


def show_clip(
    camera: bpy.types.Object,
    clip: Path,
    frames: np.ndarray,
    *,
    exact: bool = False,
    picked: range | None = None,
    barred: bool = False,
) -> bool:
    """Show `clip`, a film or a folder of numbered pictures, in `camera` at the clip frames `frames (T,)`; whether it did.

    `exact`: only when it has one picture for each frame, so that a selection of frames is never shown beside another, or
    when `picked` says which of its pictures they are. `barred`: it has bars that the scene has not. Raises F4xError for what
    is neither.
    """
    if clip.is_dir():
        images = find_layout(clip).images
        if not _fits(exact, picked, len(images), len(frames)):
            return False
        image = _image(images[0])
        image.source = "SEQUENCE"
        first, count = _first_number(images), len(images)
    elif clip.suffix.lower() in FILMS | SUFFIXES:
        image = _image(clip)
        first, count = 1, image.frame_duration
        if not _fits(exact, picked, count, len(frames)):
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
    # Opposite bars are alike: where the picture fills the view, they fall outside.
    background.display_depth, background.frame_method = "BACK", "CROP" if barred else "STRETCH"
    user = background.image_user
    user.frame_duration, user.use_cyclic = 1, True  # Blender counts no frames itself: Time gives the offset
    user.use_auto_refresh = True
    shown = Numbers(first + picked.start, picked.step, len(picked)) if picked else Numbers(first, 1, count)
    drive_background(camera.parent, camera.data, shown)
    camera.data.show_background_images = True
    return True


def shown_clip(root: bpy.types.Object) -> Path | None:
    """Return the film, or the folder of pictures, behind a camera of `root`; None without one."""
    for camera in (item for item in root.children if item.type == "CAMERA"):
        for image in (each.image for each in camera.data.background_images if each.image is not None):
            file = Path(bpy.path.abspath(image.filepath))
            if file.exists():
                return file.parent if image.source == "SEQUENCE" else file
    return None


def doubt(camera: bpy.types.Object, scene: Scene) -> str:
    """Return a sentence if the clip behind `camera` does not look like `scene`, else an empty string."""
    shown = camera.data.background_images[0].image
    image = bpy.data.images.load(
        shown.filepath, check_existing=False
    )  # its first picture, at whatever frame Blender stands
    width, height = image.size
    values = np.zeros(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    brightness = values.reshape(height, width, -1)[::-1, :, :3].mean(-1)  # Blender's first row is the lowest
    if brightness.size and resemblance(scene, float(scene.cameras.times[0]), brightness) >= ALIKE:
        return ""
    name = Path(shown.filepath)
    clip = name.parent.name if shown.source == "SEQUENCE" else name.name
    return f"{clip} does not look like the clip that {scene.name} was made of; choose another if it is not."


def _fits(exact: bool, picked: range | None, image_count: int, frames: int) -> bool:
    """Return True if each image belongs to a known frame, or the assignment need not be `exact`."""
    if picked is not None:
        return len(picked) == frames and picked[-1] < image_count
    return not exact or image_count == frames


def _image(file: Path) -> bpy.types.Image:
    try:
        return bpy.data.images.load(str(file.resolve()), check_existing=True)
    except RuntimeError as error:
        raise F4xError(f"{file} cannot be read as an image or a video; choose another clip.") from error


def _first_number(images: list[Path]) -> int:
    """Return the number in the first file name. F4xError unless the numbers are consecutive, as Blender's image sequences need."""
    digits = [name[len(name.rstrip("0123456789")) :] for name in (image.stem for image in images)]
    if not all(digits) or [int(number) for number in digits] != list(
        range(int(digits[0]), int(digits[0]) + len(digits))
    ):
        raise F4xError(
            f"{images[0].parent}: the images are not numbered consecutively, as Blender needs them; rename them."
        )
    return int(digits[0])
