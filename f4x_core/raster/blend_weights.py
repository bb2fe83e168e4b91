"""Sums of the blend weights of each Gaussian over layers of a picture. numpy in and out; torch only for its own backends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from . import as_tensors, backend_function, choose_backend
from .contract import RasterConfig, RasterInput
from .in_view import in_view
from .inputs import prepare


def blend_weight_sums(
    splats: Splats,
    camera: Camera,
    layers: np.ndarray,
    *,
    config: RasterConfig | None = None,
    backend: str = "auto",
) -> np.ndarray:
    """Return (N,L) float32: the blend weights of every Gaussian, summed over the pixels of `camera` as `layers (H,W,L)` weigh them.

    A picture is linear in the colours, `I_p = sum_g w_gp c_g` with the blend weights `w_gp = alpha_gp T_gp`, so the gradient of
    `sum_p m_p I_p` with respect to the colour of Gaussian g is `sum_p m_p w_gp`: one backward pass gives the sums of all.

    Raises:
        F4xError: layers of another size than the camera's, an unknown backend, or one that is not installed.
    """
    return BlendWeights(splats, camera, layers.shape[2], config, backend).sums(layers)


class BlendWeights:
    """The blend weights of N Gaussians in one view, as the linear map from their colours to the picture, and back."""

    def __init__(
        self,
        splats: Splats,
        camera: Camera,
        channels: int,
        config: RasterConfig | None = None,
        backend: str = "auto",
    ):
        """Prepare `splats` seen from `camera`, with this number of colour `channels`.

        Raises:
            F4xError: an unknown backend, or one that is not installed.
        """
        config = config or RasterConfig()
        self.seen = in_view(splats, camera, config)
        """(N,) bool: Gaussians that can have a weight."""
        self.camera = camera
        self._given = _prepared(splats.shape.take(self.seen), camera, channels, config)
        self._backend = choose_backend(backend, self._given.splats.means)

    def picture(self, colors: np.ndarray) -> np.ndarray:
        """Return (H,W,C) float32: the picture in which the Gaussians have `colors (N,C)`, over black."""
        given = replace(self._given, colors=np.ascontiguousarray(colors[self.seen], np.float32))
        drawn = backend_function(self._backend)
        if self._backend in ("plain", "native"):
            return np.asarray(drawn(given).channels, np.float32)
        import torch

        with torch.no_grad():
            return np.asarray(drawn(as_tensors(given)).channels.numpy(), np.float32)

    def sums(self, layers: np.ndarray) -> np.ndarray:
        """Return (N,C) float32: the weights of every Gaussian, summed over the pixels as `layers (H,W,C)` weigh them.

        Raises:
            F4xError: layers of another size than the camera's.
        """
        if layers.shape[:2] != (self.camera.height, self.camera.width):
            raise F4xError(
                f"layers have the shape {layers.shape}, the camera's image has {self.camera.height} x "
                f"{self.camera.width} pixels."
            )
        sums = np.zeros((len(self.seen), layers.shape[2]), np.float32)
        sums[self.seen] = self._gradient(np.ascontiguousarray(layers, np.float32))
        return sums

    @cached_property
    def _gradient(self) -> Callable[[np.ndarray], np.ndarray]:
        """Function from the gradient of a picture to that of the colours of Gaussians in view."""
        if self._backend == "plain":
            from .plain import blend_weight_sums_plain

            return partial(blend_weight_sums_plain, self._given)
        if self._backend == "native":
            from .native import color_gradients

            return color_gradients(self._given)
        return self._by_torch

    def _by_torch(self, layers: np.ndarray) -> np.ndarray:
        import torch

        tensors = as_tensors(self._given)
        tensors.colors.requires_grad_()
        with torch.enable_grad():  # whatever the caller does
            backend_function(self._backend)(tensors).channels.backward(torch.from_numpy(layers))
        gradient: np.ndarray = tensors.colors.grad.numpy()
        return gradient


def alpha_sums(splats: Splats, camera: Camera, *, config: RasterConfig | None = None) -> np.ndarray:
    """Return (N,) float64: what the blend weights of each Gaussian would sum to with nothing before it, on an endless picture.

    That is the integral of `opacity exp(-r^2 / 2)` in pixels where it reaches `alpha_min`; 0 for what `camera` does not see.
    """
    from .plain import alpha_sums_plain

    return alpha_sums_plain(_prepared(splats, camera, 0, config))


def _prepared(splats: Splats, camera: Camera, channels: int, config: RasterConfig | None) -> RasterInput:
    shape = splats.shape.map(lambda array: np.ascontiguousarray(array, np.float32))
    colors = np.zeros((len(splats), channels), np.float32)
    given, _ = prepare(RasterInput(shape, colors, camera, config=config or RasterConfig(), detached_from=0))
    return given
