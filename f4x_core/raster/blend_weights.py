"""How much each Gaussian weighs in layers of a picture. numpy in and out; torch only for its own backends."""

from __future__ import annotations

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
    """(N,L) float32: the blend weights of every Gaussian, summed over the pixels of `camera` as `layers (H,W,L)` weigh them.

    A picture is linear in the colours, `I_p = sum_g w_gp c_g` with the blend weights `w_gp = alpha_gp T_gp`, so the gradient of
    `sum_p m_p I_p` with respect to the colour of Gaussian g is `sum_p m_p w_gp`: one backward pass gives the sums of all.

    Raises:
        F4xError: layers of another size than the camera's, an unknown backend, or one that is not installed.
    """
    if layers.shape[:2] != (camera.height, camera.width):
        raise F4xError(
            f"layers have the shape {layers.shape}, the camera's image has {camera.height} x {camera.width} pixels."
        )
    config = config or RasterConfig()
    seen = in_view(splats, camera, config)
    sums = np.zeros((len(splats), layers.shape[2]), np.float32)
    given = _prepared(splats.shape.take(seen), camera, layers.shape[2], config)
    sums[seen] = _sums(given, np.ascontiguousarray(layers, np.float32), choose_backend(backend, given.splats.means))
    return sums


def _sums(given: RasterInput, layers: np.ndarray, backend: str) -> np.ndarray:
    """`blend_weight_sums` of what is in view."""
    if backend == "plain":
        from .plain import blend_weight_sums_plain

        return blend_weight_sums_plain(given, layers)
    if backend == "native":
        from .native import color_gradient

        return color_gradient(given, layers)
    import torch

    tensors = as_tensors(given)
    tensors.colors.requires_grad_()
    with torch.enable_grad():  # whatever the caller does
        backend_function(backend)(tensors).channels.backward(torch.from_numpy(layers))
    return tensors.colors.grad.numpy()


def alpha_sums(splats: Splats, camera: Camera, *, config: RasterConfig | None = None) -> np.ndarray:
    """(N,) float64: what the blend weights of each Gaussian would sum to with nothing before it, on an endless picture.

    That is the integral of `opacity exp(-r^2 / 2)` in pixels where it reaches `alpha_min`; 0 for what `camera` does not see.
    """
    from .plain import alpha_sums_plain

    return alpha_sums_plain(_prepared(splats, camera, 0, config))


def _prepared(splats: Splats, camera: Camera, channels: int, config: RasterConfig | None) -> RasterInput:
    shape = splats.shape.map(lambda array: np.ascontiguousarray(array, np.float32))
    colors = np.zeros((len(splats), channels), np.float32)
    given, _ = prepare(RasterInput(shape, colors, camera, config=config or RasterConfig(), detached_from=0))
    return given
