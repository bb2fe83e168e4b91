"""LPIPS (Zhang et al. 2018; version 0.1 on AlexNet) where the package `lpips` and AlexNet's weights are on this machine already.

Nothing is ever downloaded: the backbone is built without weights and filled from the checkpoints of `torch.hub`; the linear layers
come with the package.
"""

from __future__ import annotations

import math
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import torch
from torch import nn

WEIGHTS = "alexnet-owt-*.pth"
"""torchvision's file of AlexNet, in `checkpoints` of `torch.hub.get_dir()`; the hash in its name changed, the values did not."""
MIN_SIDE = 31
"""Minimum side of an image in pixels; the strides of AlexNet leave nothing of a smaller one."""
NOT_RUN = "LPIPS: not run; "


def lpips(image: np.ndarray, target: np.ndarray) -> float | None:
    """Return the LPIPS of RGB pictures (H,W,3) in [0,1], 0 for equal ones; None where it can't run, or for a side below 31."""
    distance = _distance(image, target, spatial=False)
    return None if distance is None else distance.item()


def lpips_bytes(image: np.ndarray, target: np.ndarray) -> float | None:
    """Return the LPIPS of uint8 RGB pictures (H,W,3) by the NVIDIA protocol (DynamicNeRF, RoDynRF, MoSca); None as in `lpips`.

    Their code hands pictures to the network as OpenCV reads them, blue first; so does this, lest figures not compare.
    """
    return lpips(image[..., ::-1] / 255, target[..., ::-1] / 255)


def masked_lpips(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float | None:
    """Return the LPIPS of RGB pictures (H,W,3) in [0,1] over the pixels of `mask` (H,W) bool: DyCheck's mLPIPS (Gao et al. 2022).

    Both pictures are black outside the mask, and the mean over the mask is of the map of distances at the pictures' size
    (`spatial=True`). NaN where no pixel counts; None as in `lpips`.
    """
    distance = _distance(image * mask[..., None], target * mask[..., None], spatial=True)
    if distance is None:
        return None
    return float(distance[mask].mean()) if mask.any() else math.nan


def lpips_missing() -> list[str]:
    """Return the sentence that says why LPIPS can't run on this machine; an empty list where it can."""
    network = _load(spatial=False)
    return [network] if isinstance(network, str) else []


def _distance(image: np.ndarray, target: np.ndarray, spatial: bool) -> np.ndarray | None:
    """Return () or, `spatial`, (H,W) of pictures (H,W,3) in [0,1]."""
    network = _load(spatial)
    if isinstance(network, str) or min(image.shape[:2]) < MIN_SIDE:
        return None
    one, other = (
        torch.from_numpy(np.ascontiguousarray(2 * values - 1, np.float32)).permute(2, 0, 1)[None]
        for values in (image, target)
    )
    with torch.no_grad():
        return network(one, other)[0, 0].numpy().squeeze()


@cache
def _load(spatial: bool) -> nn.Module | str:
    """Return the network, or the reason there is none; with `spatial` it gives a map of distances, not their mean."""
    try:
        from lpips import LPIPS
    except Exception as error:  # torchvision beside another build of torch fails in many ways
        return f"{NOT_RUN}the package `lpips` can't be imported ({_first_line(error)})."
    files = sorted(Path(torch.hub.get_dir(), "checkpoints").glob(WEIGHTS))
    if not files:
        return f"{NOT_RUN}no weights of its AlexNet ({WEIGHTS}) in torch.hub's checkpoints, and nothing is downloaded."
    try:
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():  # fits go on with the same random numbers
            warnings.simplefilter("ignore")
            network = LPIPS(net="alex", spatial=spatial, pnet_rand=True, verbose=False)
        weights = torch.load(files[-1], map_location="cpu", weights_only=True)
        # `slice2.3.weight` of the package is `features.3.weight` of torchvision.
        names = {name: "features." + name.partition(".")[2] for name in network.net.state_dict()}
        network.net.load_state_dict({name: weights[source] for name, source in names.items()})
    except Exception as error:  # another version of the package, or a damaged file
        return f"{NOT_RUN}{files[-1].name} does not fit the package `lpips` ({_first_line(error)})."
    return network.eval()


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
