"""Writes all passes of a frame as a multi-layer EXR with Blender's names, which its compositor, Nuke and OpenEXR read."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import replace_path
from .cryptomatte import metadata, ranked
from .stage import MATTE

LAYER = "ViewLayer"
"""Name of the view layer, Blender's own."""
PASSES = {
    "combined": ("Combined", "RGBA"),
    "depth": ("Depth", "Z"),
    "alpha": ("Alpha", "A"),
    "vector": ("Vector", "XYZW"),
    "normal": ("Normal", "XYZ"),
    "position": ("Position", "XYZ"),
    "mist": ("Mist", "Z"),
    "latent": ("Latent", "RGB"),
    "selection": ("Selection", "X"),
    "score": ("Score", "X"),
    "unseen": ("Unseen", "X"),
    "holdout": ("Holdout", "X"),
}
"""Pass of `stage.draw` -> (name, channels)."""
CRYPTO_CHANNELS = "rgba"
"""Channels of a picture of pairs; lower case, as Blender writes them."""
MATTES = {"object": "CryptoObject", "collection": "CryptoAsset"}
"""Layer of mattes -> its name. Blender's own name for what is above objects is Asset."""


def named_layers(images: Mapping[str, np.ndarray], depth: int) -> dict[str, tuple[np.ndarray, str]]:
    """Return name in Blender -> ((H,W,C), channels) of `shoot`'s pictures; mattes as pairs, `depth` of a pixel."""
    found = {}
    for name, image in images.items():
        if name in PASSES:
            title, channels = PASSES[name]
            found[title] = (image.reshape(*image.shape[:2], len(channels)), channels)
    for layer, title in MATTES.items():
        prefix = f"{MATTE}{layer}:"
        names = [name for name in images if name.startswith(prefix)]
        if names:
            ids = np.array([int(name.removeprefix(prefix), 16) for name in names], np.uint32)
            pairs = ranked(ids, np.stack([images[name] for name in names], -1), depth)
            found |= {f"{title}{number:02d}": (four, CRYPTO_CHANNELS) for number, four in enumerate(pairs)}
    return found


def write_exr(
    file: Path, layers: Mapping[str, tuple[np.ndarray, str]], manifests: Mapping[str, list[str]] | None = None
) -> None:
    """Write `layers` (of `named_layers`) as float32 channels `ViewLayer.PASS.CHANNEL`, losslessly packed.

    `manifests`: layer of mattes -> names that it tells apart. Raises F4xError where the file cannot be written; nothing stays then.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for layer, names in (manifests or {}).items():
        header |= metadata(f"{LAYER}.{MATTES[layer]}", names)
    channels = {
        f"{LAYER}.{title}.{letter}": np.ascontiguousarray(image[..., i], np.float32)
        for title, (image, letters) in layers.items()
        for i, letter in enumerate(letters)
    }
    with replace_path(file, ".exr") as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:  # what OpenEXR makes of a full disk
            code = next((number for number in errno.errorcode if os.strerror(number) in str(error)), None)
            raise (OSError(str(error)) if code is None else OSError(code, os.strerror(code))) from error
        except ValueError as error:  # a name that is no UTF-8
            raise F4xError(f"{file}: OpenEXR cannot write to this name ({error}); choose another folder") from error
