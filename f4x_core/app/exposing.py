"""Pictures of `f4x render` with all passes in one EXR, motion blur and depth of field: as Blender's render engine takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..clip.images import as_bytes
from ..edit.naming import by_words
from ..edit.resolve import named
from ..errors import F4xError
from ..geometry.trajectory import Trajectory, cameras_of
from ..query.labels import encode_labels
from ..query.matte import MOVES, OBJECTS, refine_passes
from ..query.unseen import unseen_gaussians
from ..scene import Scene
from ..scene.clouds import Cloud
from ..scene.color import srgb_from_linear
from ..scene.cryptomatte import DEPTH, identify
from ..scene.exposure import Exposure, Lens, Take, shoot
from ..scene.layers import named_layers, write_exr
from ..scene.stage import DrawSettings
from .render_options import MASK, RenderOptions, mask_labels

CRYPTOMATTE = "cryptomatte"
PASSES = ("rgb", "alpha", "depth", "vector", "normal", "position", "mist", "unseen")
"""Channels of an EXR besides `CRYPTOMATTE` and `mask:LABEL`."""
MAX_SAMPLES = 1024


@dataclass(frozen=True, eq=False)
class Mattes:
    """Names and ids of the mattes: the scene, and each selection that an edit named or a channel `mask:LABEL` asks for."""

    names: tuple[str, ...]
    """The scene's own first."""
    ids: np.ndarray
    """(N,) uint32 in the order of `posed`."""

    @classmethod
    def of(cls, scene: Scene, channels: Sequence[str]) -> Mattes | None:
        """Return the mattes that the channels ask for; a Gaussian of several selections belongs to the last one."""
        labels = [*mask_labels(channels).values()]
        if CRYPTOMATTE not in channels and not labels:
            return None
        selections = named(scene) | by_words(scene, labels, encode=encode_labels)
        ids = np.full(len(scene.ids), identify(scene.name), np.uint32)
        for name, selection in selections.items():
            ids[selection.chosen] = identify(name)
        return cls((scene.name, *selections), ids)


def passes_of(channels: Sequence[str], exr: bool) -> list[str]:
    """Return the passes of `shoot` for `--channels`; F4xError for one that there is not."""
    known = (*PASSES, CRYPTOMATTE) if exr else ("rgb", "alpha")
    unknown = [name for name in channels if name not in known and not (exr and name.startswith(MASK))]
    if unknown:
        where = "with --exr" if exr else "with --motion-blur or --aperture and without --exr"
        more = ", or add --exr" if not exr and unknown[0] in (*PASSES, CRYPTOMATTE) else ""
        raise F4xError(
            f"--channels {','.join(channels)}: {where} there is no channel {unknown[0]}; choose from {','.join(known)}{more}."
        )
    return [name for name in channels if name in PASSES and name != "rgb"]


def exposure_of(options: RenderOptions) -> Exposure:
    """Return the exposure that the options ask for."""
    for name, value, most in (("motion-blur", options.motion_blur, 100.0), ("aperture", options.aperture, 100.0)):
        if not 0 <= value <= most:
            raise F4xError(f"--{name} {value:g}: give a number from 0 to {most:g}.")
    if not options.focus > 0:
        raise F4xError(f"--focus {options.focus:g}: give a depth above 0.")
    if not 1 <= options.samples <= MAX_SAMPLES:
        raise F4xError(f"--samples {options.samples}: give a number from 1 to {MAX_SAMPLES}.")
    lens = Lens(options.aperture, options.focus) if options.aperture else None
    return Exposure(options.samples, -options.motion_blur / 2, options.motion_blur / 2, lens)


@dataclass(frozen=True, eq=False)
class ExposedPath:
    """A scene along a camera path, with shutter and lens."""

    scene: Scene
    views: Trajectory
    """All of the path, also views that are not drawn: a shutter opens before a frame."""
    exposure: Exposure
    passes: Sequence[str]
    """Passes of `shoot`."""
    mattes: Mattes | None
    backend: str
    """The raster backend."""

    def images(self, index: int) -> dict[str, np.ndarray]:
        """Return the passes of view `index`, by `shoot`."""
        settings = DrawSettings(backend=self.backend)
        passes = [*self.passes, *([OBJECTS] if self.mattes else [])]
        selections = [*map(identify, self.mattes.names[1:])] if self.mattes else []

        def refine(images: dict[str, np.ndarray], take: Take) -> dict[str, np.ndarray]:
            return refine_passes(images, take, settings, selections)

        return shoot(
            lambda offset: self._take(index + offset),
            self.exposure,
            settings,
            passes,
            refine=refine if self.mattes else None,
        )

    def _take(self, row: float) -> Take:
        """Return the scene and the camera at a view of the path, which may be between two."""
        cloud = Cloud.of_scene(self.scene, _time_at([view.time for view in self.views], row))
        layers = {"unseen": unseen_gaussians(self.scene)[:, None]} if "unseen" in self.passes else {}
        if self.mattes is not None:
            cloud = replace(cloud, mattes={"object": self.mattes.ids})
            layers[MOVES] = self.scene.moving[:, None]
        return Take([replace(cloud, layers=layers)], [], cameras_of(self.views).at(row))


def write(file: Path, images: Mapping[str, np.ndarray], mattes: Mattes | None) -> None:
    """Write the images of `ExposedPath.images` as one multi-layer EXR."""
    manifests = None if mattes is None else {"object": list(mattes.names)}
    write_exr(file, named_layers(images, DEPTH), manifests)


def display(combined: np.ndarray) -> np.ndarray:
    """Return (H,W,3) uint8 sRGB of a picture in linear light."""
    return as_bytes(srgb_from_linear(combined[..., :3]))


def _time_at(times: Sequence[float], row: float) -> float:
    """Return the time at a fractional view of a trajectory, straight on beyond its ends."""
    if len(times) == 1:
        return times[0]
    below = int(np.clip(np.floor(row), 0, len(times) - 2))
    return times[below] + (row - below) * (times[below + 1] - times[below])
