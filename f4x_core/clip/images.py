"""Folders of pictures: listing in natural order, reading colour and masks, resampling, writing."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import F4xError
from ..reading import require_picture, require_pixels
from .pixels import SEEN, WHITE, as_8_bit

SUFFIXES = {".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff"}
ORIENTATION = 274
"""EXIF tag: how the camera was held."""
ASPECT_TOLERANCE = 0.01
"""Relative; rounding to even sizes changes the aspect of a 200-pixel frame by this much."""


def list_images(folder: Path) -> list[Path]:
    """Return the picture files directly in `folder`, numbers in their names sorted by value; none if no folder."""
    if not folder.is_dir():
        return []
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")]
    return sorted(files, key=lambda file: natural_key(file.name))


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key under which `frame2` comes before `frame10`."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"([0-9]+)", name)]


class Color(NamedTuple):
    """A picture from a file, turned upright as the camera's EXIF says."""

    pixels: np.ndarray
    """(H, W, 3) uint8 sRGB."""
    alpha: np.ndarray | None
    """(H, W) uint8, 0 where the picture hides its colours; None where it hides nothing."""


def read_color(file: Path) -> np.ndarray:
    """Return `(H, W, 3)` uint8 sRGB, also of what alpha hides, turned upright as the camera's EXIF says; raises F4xError."""
    return read_picture(file).pixels


def read_picture(file: Path, white: int = WHITE) -> Color:
    """Return the colours and the alpha of a picture of any type; `white` is that of 16 bits. Raises F4xError."""
    from PIL import Image, ImageOps

    deep = read_deep(file)
    if deep is None:
        image = _opened(file)
    else:
        try:
            image = Image.fromarray(as_8_bit(deep.values, white))
        except ValueError as error:
            raise F4xError(f"{file} holds {error}; write it as a PNG of 8 or 16 bits.") from error
        image.getexif()[ORIENTATION] = deep.orientation
    with image:
        upright = ImageOps.exif_transpose(image)
        if not upright.has_transparency_data:
            return Color(np.asarray(upright.convert("RGB")), None)
        pixels = np.asarray(upright.convert("RGBA"))
    alpha = np.ascontiguousarray(pixels[..., 3])
    return Color(np.ascontiguousarray(pixels[..., :3]), None if (alpha >= SEEN).all() else alpha)


class Deep(NamedTuple):
    """A picture of more than 8 bits, which PIL cuts off, does not scale, or does not read."""

    values: np.ndarray
    """(H, W), or (H, W, 3 or 4) RGB or RGBA, of the type in which the file has them."""
    orientation: int
    """EXIF's orientation of the camera; 1 where `values` are upright."""


def is_deep(image) -> bool:
    """Return True for a picture opened by PIL that has more than 8 bits."""
    return image.mode.startswith(("I", "F")) or any(";16" in str(tile.args) for tile in image.tile)


def read_deep(file: Path) -> Deep | None:
    """Return a picture that has more than 8 bits; None for all other files."""
    import cv2
    from PIL import Image

    orientation = 1
    try:
        with open_undecoded(file) as image:
            if not is_deep(image):
                return None
            if image.format != "TIFF":  # which OpenCV always turns upright
                orientation = image.getexif().get(ORIENTATION, 1)
    except (ValueError, Image.DecompressionBombError):  # refused, and not for its kind
        return None
    except (OSError, SyntaxError):
        if file.suffix.lower() not in (".tif", ".tiff") or not file.is_file():  # PIL knows no colours of float there
            return None
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    values = cv2.imdecode(np.fromfile(file, np.uint8), flags)
    if values is None:
        return None
    return Deep(values if values.ndim == 2 else values[..., [2, 1, 0, 3][: values.shape[2]]], orientation)


def read_mask(file: Path, colours: bool = True) -> np.ndarray:
    """Return `(H, W)` bool, true where the picture (grey, colour or palette index) is not 0; raises F4xError.

    What alpha hides is not marked; alpha alone decides where all colours are the same.
    With `colours` False one whose channels differ is refused: a photo given by mistake would mark nearly every pixel.
    """
    shown = None
    with _opened(file) as image:
        if image.mode in ("RGBA", "LA"):
            shown = np.asarray(image.getchannel("A")) >= SEEN
        values = np.asarray(image if shown is None else image.convert(image.mode.removesuffix("A")))
    if not colours and values.ndim == 3 and (values != values[..., :1]).any():
        raise F4xError(f"{file} is a colour picture and no mask; make the thing white and all else black.")
    marked = values.any(axis=-1) if values.ndim == 3 else values != 0
    if shown is None or shown.all():
        return marked
    return shown if (values == values[0, 0]).all() else marked & shown


def open_undecoded(file: Path):
    """Return a PIL image whose size was compared with the bytes of `file`, and whose pixels were not read.

    Raises ValueError or DecompressionBombError for a size that is refused, OSError or SyntaxError for what is no picture.
    """
    from PIL import Image

    require_picture(file)
    image = Image.open(file)
    require_pixels(image.width, image.height, file.stat().st_size)
    return image


def _opened(file: Path):
    """Open and decode completely, so that a truncated picture is an error here and not grey pixels later."""
    from PIL import Image

    try:
        image = open_undecoded(file)
        image.load()
    except FileNotFoundError as error:
        raise F4xError(f"{file} does not exist; give a picture.") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise F4xError(f"{file} cannot be read as a picture ({error}); replace or remove it") from error
    return image


def even_size(width: int, height: int, new_width: int | None) -> tuple[int, int]:
    """Return (width, height) near `new_width` with the same aspect, both even as video codecs want; never larger."""
    if new_width is None or new_width >= width:
        return width, height
    return max(2, 2 * round(new_width / 2)), even_height(width, height, new_width)


def even_height(width: int, height: int, new_width: int) -> int:
    """Return the height of a picture of `width` x `height` that is made `new_width` wide, even as video codecs want."""
    return max(2, 2 * round(height * new_width / width / 2))


def resize_color(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `(height, width, 3)`, averaged over the area of each new pixel."""
    import cv2

    return (
        image
        if image.shape[:2] == (height, width)
        else cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    )


def alike(width: int, height: int, other_width: int, other_height: int) -> bool:
    """Return True where pictures of two sizes have the same aspect."""
    return abs(width * other_height / (height * other_width) - 1) <= ASPECT_TOLERANCE


def scaled(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `(height, width, 3)` of a larger or a smaller image."""
    return (enlarge_color if image.shape[1] < width else resize_color)(image, width, height)


def enlarge_color(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `(height, width, 3)`, smooth between the pixels of a smaller image."""
    import cv2

    return cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)


def resize_nearest(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `(..., height, width)` of `image (..., H, W)`, picked at the new pixels' centres: for masks and depth, which must
    not be mixed."""
    rows = ((np.arange(height) + 0.5) * image.shape[-2] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * image.shape[-1] / width).astype(int)
    return image[..., rows[:, None], columns]


def resize_linear(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `(height, width, ...)` float32, linear between the pixels of `image (H, W, ...)`: for smooth maps that are
    enlarged."""
    import cv2

    return cv2.resize(image.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)


def write_images(folder: str | Path, frames: Iterable[np.ndarray]) -> list[Path]:
    """Write `frames` ((H, W, 3) uint8, or float in [0, 1]) as `00000.png ...`; return the files."""
    from PIL import Image

    folder = Path(folder)
    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for index, frame in enumerate(frames):
            files.append(folder / f"{index:05d}.png")
            Image.fromarray(as_bytes(frame)).save(files[-1])
    except OSError as error:
        raise F4xError(f"{folder} cannot be written ({error}); choose a folder you may write to") from error
    return files


def as_bytes(frame: np.ndarray) -> np.ndarray:
    """Return uint8 colours of uint8 or float [0, 1] ones (clamped and rounded)."""
    frame = np.asarray(frame)
    return frame if frame.dtype == np.uint8 else np.round(np.clip(frame, 0, 1) * 255).astype(np.uint8)
