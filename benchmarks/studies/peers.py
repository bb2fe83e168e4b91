"""Rasterisers of others: those that draw on a CPU are measured beside ours, the others are named with the reason."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from f4x_core.raster import RasterConfig
from f4x_core.raster.reference import pixel_row, weigh_row

from ..speed.raster import Draw

GSPLAT = "1.5"
"""Version of gsplat whose torch reference is called here: it is no public interface, so another version's may differ."""
GSPLAT_ALPHA_MAX = 0.999
"""To which that version clamps alpha, written into its functions."""
TORCH_SPLATTING = "gaussian_splatting.gauss_render"


@dataclass(frozen=True)
class Peer:
    """Somebody else's rasteriser that draws on a CPU and has gradients."""

    name: str
    """With its version."""
    alpha_max: float
    """Its clamp of alpha, which can't be set: the one constant in which its rule differs from `RasterConfig`."""
    prepare: Callable[[dict[str, Any], RasterConfig], Draw]
    """Its drawing of a scene of CPU tensors (float32 or float64), with all that it is given for free done before."""


def find_peers() -> tuple[list[Peer], list[str]]:
    """Return the peers that can be measured here, and one sentence for each that can't."""
    peers: list[Peer] = []
    absent = []
    try:
        version: str = import_module("gsplat").__version__
        reference = import_module("gsplat.cuda._torch_impl")
    except (ImportError, OSError) as error:
        missing = getattr(error, "name", None) == "gsplat"
        absent.append(f"gsplat: {'not installed (no module gsplat)' if missing else f'cannot be imported ({error})'}.")
    else:
        if version.startswith(f"{GSPLAT}."):
            peers.append(Peer(f"gsplat {version}", GSPLAT_ALPHA_MAX, partial(prepare_gsplat, reference)))
        else:
            absent.append(f"gsplat {version}: only the torch reference of version {GSPLAT} is known here.")
    if _is_there(TORCH_SPLATTING):
        absent.append("torch-splatting: its renderer makes its tensors on a CUDA device, whatever it is given.")
    else:
        absent.append(f"torch-splatting: not installed (no module {TORCH_SPLATTING}).")
    program = shutil.which("opensplat")
    absent.append(
        f"OpenSplat: {program} trains a scene from photographs and draws between its steps; it cannot draw given Gaussians."
        if program
        else "OpenSplat: not installed (no program opensplat on the PATH)."
    )
    return peers, absent


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of its package
        return False


def prepare_gsplat(reference: ModuleType, scene: dict[str, Any], config: RasterConfig) -> Draw:
    """Return the drawing of gsplat's torch `reference` (`gsplat/cuda/_torch_impl.py`): its projection, its `accumulate`.

    Its list of (pixel, splat) pairs is made by a CUDA kernel: it is given ours, made here, once, from its own projection.
    `accumulate` asks nerfacc for two functions, one of which wants a CUDA device: it is given both in torch.
    """

    def project(scene: dict[str, Any]) -> tuple[Tensor, ...]:
        covariance, _ = reference._quat_scale_to_covar_preci(scene["quats"], scene["scales"], compute_preci=False)
        camera = scene["viewmat"][None], scene["K"][None], scene["width"], scene["height"]
        return reference._fully_fused_projection(
            scene["means"], covariance, *camera, eps2d=config.blur, near_plane=config.near
        )[:4]

    with torch.no_grad():
        radii, mean2d, depth, conic = (values[0] for values in project(scene))
        order = (radii > 0).all(1).nonzero()[:, 0]
        order = order[torch.argsort(depth[order], stable=True)]
        splats, pixels = _list_pairs(order, mean2d, conic, scene, config)
    images = torch.zeros_like(splats)  # all pairs are of the one image

    def draw(**scene: Any) -> Tensor:
        _, mean2d, _, conic = project(scene)
        shape = mean2d, conic, scene["opacities"][None], scene["colors"][None]
        with _nerfacc_in_torch():
            image, _ = reference.accumulate(*shape, splats, pixels, images, scene["width"], scene["height"])
        return image[0]

    return draw


def _list_pairs(
    order: Tensor, mean2d: Tensor, conic: Tensor, scene: dict[str, Any], config: RasterConfig
) -> tuple[Tensor, Tensor]:
    """Splat and pixel (row-major) of every pair that contributes, pixel after pixel, front to back.

    `order`: visible splats, front to back; `mean2d` (N, 2) and `conic` (N, 3), upper triangle, of all.
    """
    matrix = conic[:, [0, 1, 1, 2]].view(-1, 2, 2)
    mean2d, matrix, opacities = (values[order].double() for values in (mean2d, matrix, scene["opacities"]))
    splats, pixels = [], []
    for row in range(scene["height"]):
        column, place = weigh_row(pixel_row(row, scene["width"]), mean2d, matrix, opacities, config).nonzero().unbind(1)
        splats.append(order[place])
        pixels.append(row * scene["width"] + column)
    return torch.cat(splats), torch.cat(pixels)


@contextmanager
def _nerfacc_in_torch() -> Iterator[None]:
    """Within it `from nerfacc import ...` finds the two functions below, whether nerfacc is installed or not."""
    module = ModuleType("nerfacc")
    vars(module).update(render_weight_from_alpha=_weigh_rays, accumulate_along_rays=_accumulate_rays)
    before = sys.modules.get("nerfacc")
    sys.modules["nerfacc"] = module
    try:
        yield
    finally:
        if before is None:
            del sys.modules["nerfacc"]
        else:
            sys.modules["nerfacc"] = before


def _weigh_rays(alphas: Tensor, *, ray_indices: Tensor, n_rays: int) -> tuple[Tensor, Tensor]:
    """nerfacc's `render_weight_from_alpha`: weights and transmittances (M,) of samples that lie ray after ray."""
    counts = torch.bincount(ray_indices, minlength=n_rays)
    place = torch.arange(len(alphas)) - (counts.cumsum(0) - counts)[ray_indices]
    passed = alphas.new_ones(n_rays, int(counts.max()) + 1).index_put((ray_indices, place + 1), 1 - alphas)
    transmittance = passed.cumprod(1)[ray_indices, place]
    return transmittance * alphas, transmittance


def _accumulate_rays(weights: Tensor, values: Tensor | None, *, ray_indices: Tensor, n_rays: int) -> Tensor:
    """nerfacc's `accumulate_along_rays`: (rays, D) sums of weights (M,) times values (M, D), None = 1."""
    terms = weights[:, None] if values is None else weights[:, None] * values
    return terms.new_zeros(n_rays, terms.shape[1]).index_add(0, ray_indices, terms)
