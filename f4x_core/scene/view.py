"""Renders a scene from any camera at any time with any available raster backend."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from ..geometry.trajectory import Trajectory
from ..progress import Progress, silent
from .clouds import Cloud, Composite
from .model import PosedSplats, Scene

if TYPE_CHECKING:
    from ..raster import RasterConfig

CHANNELS = ("rgb", "depth", "alpha", "motion")
HEAD = "head:"
"""`head:NAME` is the channel of decoded features."""
NEAR = 0.01
"""World units; a Gaussian that comes nearer to the camera plane by the next frame has no meaningful screen motion."""


def render(
    scene: Scene,
    camera: Camera,
    time: float,
    channels: Sequence[str] = CHANNELS,
    backend: str = "auto",
    values: Mapping[str, np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """Render the scene at clip time `time` (frame index, float allowed) from `camera`; float32 arrays by channel name.

    * `rgb (H,W,3)` sRGB over black, not clamped above 1; `over_background` puts another color behind it.
    * `depth (H,W)` expected z depth in world units, NaN where alpha < 0.1.
    * `alpha (H,W)` in [0, 1).
    * `motion (H,W,2)` pixels (right, down) from `time` to `time + 1` through this same, standing camera; alpha-weighted
      mean of the Gaussians, 0 for static ones and where alpha < 0.1.
    * `latent (H,W,D)` of the scene's feature field, alpha-weighted mean of the Gaussians, 0 where alpha < 0.1.
    * `head:NAME (H,W,C)` what that head decodes from it, 0 where alpha < 0.1.
    * every name in `values`: `(N,C)` numbers of the posed Gaussians, composited like colours over 0 -> `(H,W,C)`.

    `backend` goes to `raster.rasterize`. Raises F4xError for an unknown channel or a missing backend.
    """
    heads = [name for name in channels if name.startswith(HEAD)]
    unknown = set(channels) - {*CHANNELS, *heads, "latent"}
    if unknown:
        raise F4xError(
            f"render: unknown channel {', '.join(sorted(unknown))}; choose from {', '.join(CHANNELS)}, latent"
        )
    features = (
        scene.require_field([name.removeprefix(HEAD) for name in heads]) if {"latent", *heads} & {*channels} else None
    )
    posed = scene.posed(time)
    cloud = Cloud.of_posed(posed, scene.fitted_focal(time))
    layers: dict[str, np.ndarray] = {}
    if "rgb" in channels:
        layers["rgb"] = cloud.colors(camera.center)
    if "motion" in channels:
        layers["motion"] = screen_motion(scene, camera, time, posed)
    if features is not None:
        layers["latent"] = scene.latents()
    layers |= values or {}
    # depth and alpha come with any channel, so a render of them alone carries one empty channel
    widths = {name: layer.shape[1] for name, layer in layers.items()} or {"": 1}
    drawn = Composite.of([cloud], [layers], widths, camera).draw(backend)
    images = {name: drawn.layers[name] for name in layers}
    if "alpha" in channels:
        images["alpha"] = drawn.alpha
    if "depth" in channels:
        images["depth"] = drawn.mean(drawn.depth, np.nan)
    if "motion" in channels:
        images["motion"] = drawn.mean(images["motion"])
    if features is not None:
        images["latent"] = drawn.mean(images["latent"])
        for name in heads:
            images[name] = drawn.covered[..., None] * features.decode(name.removeprefix(HEAD), images["latent"])
    return images


def over_background(images: Mapping[str, np.ndarray], color: Sequence[float]) -> np.ndarray:
    """Return the `rgb (H,W,3)` of rendered `images`, which have their `alpha`, over one sRGB color."""
    return images["rgb"] + (1 - images["alpha"])[..., None] * np.asarray(color, np.float32)


def render_trajectory(
    scene: Scene,
    trajectory: Trajectory,
    channels: Sequence[str] = CHANNELS,
    backend: str = "auto",
    progress: Progress = silent,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield `render` of every view of a `geometry.trajectory`, one at a time; cancelling passes through."""
    for done, (camera, time) in enumerate(trajectory):
        progress("render", done, len(trajectory))
        yield render(scene, camera, time, channels, backend)
    progress("render", len(trajectory), len(trajectory))


def fitted_config(scene: Scene, camera: Camera, time: float) -> RasterConfig:
    """Return the rasteriser's constants with which an image from `camera` shows what was fitted, whatever its size."""
    from ..raster import RasterConfig

    return RasterConfig.as_fitted(scene.fitted_focal(time), camera)


def seen_from(scene: Scene, views: Iterable[tuple[Camera, float]], margin: float = 0.0) -> Scene:
    """Return the scene with no more background than cameras at times show, in pictures larger by `margin` on every side (shares).

    What its background leaves out draws nothing there (`raster.in_view`), so pictures are the same, for the memory of what is
    seen. Features are left behind.
    """
    from ..raster.in_view import in_view

    seen = np.zeros(len(scene.static), bool)
    for camera, time in views:
        seen |= in_view(scene.static, camera, fitted_config(scene, camera, time), margin)
    extra = {name: array[seen] if name.startswith("static/") else array for name, array in scene.extra.items()}
    return replace(scene, static=scene.static.take(seen), features=None, extra=extra)


def screen_motion(scene: Scene, camera: Camera, time: float, posed: PosedSplats | None = None) -> np.ndarray:
    """Return the screen motion (N,2) float32, in pixels, of every centre from `time` to `time + 1`, the camera at rest.

    Past the clip's last frame the scaffold's motion coasts on. A centre behind the camera at either time gives 0.
    """
    posed = scene.posed(time) if posed is None else posed
    motion = np.zeros((len(posed.ids), 2), np.float32)
    moving = posed.dynamic
    if moving.any():
        here, near_here = camera.project(posed.means[moving].astype(np.float64))
        there, near_there = camera.project(scene.posed(time + 1).means[moving].astype(np.float64))
        seen = np.minimum(near_here, near_there) > NEAR
        motion[moving] = np.where(seen[:, None], there - here, 0)
    return motion
