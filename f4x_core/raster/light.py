"""How much light every Gaussian sends into layers of a picture. numpy in and out; torch only for its own backends."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import choose_backend, rasterize
from .contract import RasterConfig
from .inputs import leave_out_broken


def light_into(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    viewmat: np.ndarray,
    K: np.ndarray,
    layers: np.ndarray,
    *,
    config: RasterConfig | None = None,
    backend: str = "auto",
) -> np.ndarray:
    """(N,L) float32: light, in pixels, of every Gaussian into `layers (H,W,L)`; Gaussians and camera as in `rasterize`.

    The picture is linear in the colours, `I_p = sum_g w_gp c_g`, so the gradient of `sum_p m_p I_p` with respect to the
    colour of Gaussian g is `sum_p m_p w_gp`: the light that g sends into the layer m. One backward pass gives it for all.

    Raises:
        F4xError: a camera that is not finite, an unknown backend, or one that is not installed.
    """
    layers = np.ascontiguousarray(layers, np.float32)
    height, width, count = layers.shape
    inputs = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "colors": np.zeros((len(means), count)),
        "viewmat": viewmat,
        "K": K,
    }
    config = config or RasterConfig()
    arrays = {name: np.ascontiguousarray(array, np.float32) for name, array in inputs.items()}
    chosen = choose_backend(backend, arrays["means"])
    if chosen in ("native", "plain"):
        whole, _ = leave_out_broken({**arrays, "background": None, "mean2d_offset": None}, config.debug)
    if chosen == "plain":
        from .plain import light_plain

        shapes = {name: whole[name] for name in ("means", "quats", "scales", "opacities", "viewmat", "K")}
        return light_plain(**shapes, layers=layers, config=config)
    if chosen == "native":
        from .native import library as native

        library, _ = native.open_library()
        assert library is not None
        render = native.forward(library, whole, width, height, config, 0, keep=True)
        return native.backward(library, render, layers, None, None)["colors"]
    import torch

    tensors: dict[str, Any] = {name: torch.tensor(array) for name, array in arrays.items()}
    colors = tensors["colors"].requires_grad_()
    with torch.enable_grad():  # whatever the caller does
        out = rasterize(**tensors, width=width, height=height, config=config, backend=backend, detached_from=0)
        out.channels.backward(torch.from_numpy(layers))
    assert colors.grad is not None
    return colors.grad.numpy()
