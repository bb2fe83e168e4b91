"""Native raster kernel against a plain float64 compositor: values, gradients, determinism, layout, self-check."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from f4x_core.errors import F4xError
from f4x_core.raster import native
from f4x_core.raster.contract import RasterConfig
from f4x_core.raster.native import library
from f4x_core.raster.native.build import build, find_compiler

NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmat", "background", "mean2d_offset")
ONE = RasterConfig(threads=1)


@pytest.fixture(scope="module", autouse=True)
def built():
    if find_compiler() is None:
        pytest.skip("no C++ compiler and no ziglang here")
    build()
    assert native.available(), native.why_not()


def make_scene(n, channels, width, height, seed=0, size=0.08):
    """Random anisotropic Gaussians in front of a slightly turned camera with an off-centre principal point."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.6, 3.0, n)
    spread = rng.uniform(-0.75, 0.75, (n, 2)) * depth[:, None]
    angle = 0.2
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    viewmat[:3, 3] = [0.05, -0.03, 0.1]
    camera_points = np.column_stack([spread, depth])
    scene = {
        "means": (camera_points - viewmat[:3, 3]) @ viewmat[:3, :3],
        "quats": rng.normal(size=(n, 4)),
        "scales": np.exp(rng.normal(np.log(size), 0.8, (n, 3))),
        "opacities": 1 / (1 + np.exp(-rng.normal(1, 1.5, n))),
        "colors": rng.normal(size=(n, channels)),
        "viewmat": viewmat,
        "K": np.array([[width * 0.9, 0, width * 0.53], [0, width * 0.95, height * 0.46], [0, 0, 1]]),
        "background": rng.normal(size=channels),
        "mean2d_offset": np.zeros((n, 2)),
    }
    return {name: torch.tensor(a, dtype=torch.float32) for name, a in scene.items()}


def composite(scene, width, height, config, detached_from=None):
    """Every splat over every pixel, one after the other, in the scene's dtype: the rule of contracts.md word for word."""
    means, quats, scales, opacities, colors, viewmat, K = (
        scene[n] for n in ("means", "quats", "scales", "opacities", "colors", "viewmat", "K")
    )
    point = means @ viewmat[:3, :3].T + viewmat[:3, 3]  # (N, 3)
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rotation = torch.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        1,
    ).reshape(-1, 3, 3)  # fmt: skip
    axes = viewmat[:3, :3] @ rotation * scales[:, None, :]  # (N, 3, 3)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    depth = point[:, 2]
    u = (point[:, 0] / depth).clamp(-cx / fx - margin_x, (width - cx) / fx + margin_x)
    v = (point[:, 1] / depth).clamp(-cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(u)
    jacobian = torch.stack([fx / depth, zero, -fx * u / depth, zero, fy / depth, -fy * v / depth], 1).reshape(-1, 2, 3)
    half = jacobian @ axes
    covariance = half @ half.transpose(1, 2) + config.blur * torch.eye(2, dtype=means.dtype)
    conic = torch.linalg.inv(covariance)
    centre = torch.stack([fx * point[:, 0] / depth + cx, fy * point[:, 1] / depth + cy], 1)
    if scene.get("mean2d_offset") is not None:
        centre = centre + scene["mean2d_offset"]

    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows], -1).reshape(-1, 2).to(means.dtype)  # (P, 2)
    geometry = colors.shape[1] if detached_from is None else detached_from
    left = torch.ones(len(pixels), dtype=means.dtype)
    going = torch.ones(len(pixels), dtype=torch.bool)
    image = torch.zeros(len(pixels), colors.shape[1], dtype=means.dtype)
    depths = torch.zeros(len(pixels), dtype=means.dtype)
    for i in torch.argsort(depth.detach().float(), stable=True).tolist():
        if depth[i] <= config.near:
            continue
        d = pixels - centre[i]
        alpha = opacities[i] * torch.exp(-0.5 * ((d @ conic[i]) * d).sum(1))
        alpha = torch.where(alpha >= config.alpha_min, alpha.clamp(max=config.alpha_max), 0.0)
        going = going & (left * (1 - alpha) > config.transmittance_min)
        weight = torch.where(going, alpha * left, 0.0)
        image = image + torch.cat([weight[:, None] * colors[i, :geometry], weight[:, None].detach() * colors[i, geometry:]], 1)
        depths = depths + weight * depth[i]
        left = left - weight
    if scene.get("background") is not None:
        back = scene["background"]
        image = image + torch.cat([left[:, None] * back[:geometry], left[:, None].detach() * back[geometry:]], 1)
    return image.reshape(height, width, -1), depths.reshape(height, width), 1 - left.reshape(height, width)


def render_native(scene, width, height, config=ONE, detached_from=None):
    out = native.rasterize_native(**scene, width=width, height=height, config=config, detached_from=detached_from)
    return out.channels, out.depth, out.alpha


def gradients(render, scene, sent):
    """Gradients of sum(output * sent) with respect to every array of the scene but K."""
    leaves = {n: a.clone().requires_grad_(n != "K") for n, a in scene.items()}
    total = sum((out * s.to(out.dtype)).sum() for out, s in zip(render(leaves), sent, strict=True))
    total.backward()
    return {n: leaves[n].grad for n in NAMES}


def random_sent(width, height, channels, seed=5):
    g = torch.Generator().manual_seed(seed)
    shapes = ((height, width, channels), (height, width), (height, width))
    return [torch.randn(shape, generator=g) for shape in shapes]


def relative(got, expected):
    return float((got.double() - expected.double()).norm() / expected.double().norm())


def to_double(scene):
    return {n: a.double() for n, a in scene.items()}


def make_self_check():
    """Content of self_check.npz, from the compositor above."""
    width, height, channels, detached_from = 23, 19, 3, 2
    scene, sent = make_scene(24, channels, width, height, seed=11, size=0.15), random_sent(width, height, channels)
    outputs = ("channels", "depth", "alpha")
    expected = dict(zip(outputs, composite(to_double(scene), width, height, ONE, detached_from), strict=True))
    expected |= gradients(lambda s: composite(s, width, height, ONE, detached_from), to_double(scene), sent)
    del expected["background"]  # taken outside the kernel
    content = {f"input_{name}": a for name, a in scene.items()} | {f"expect_{name}": a for name, a in expected.items()}
    content |= {f"sent_{name}": a for name, a in zip(outputs, sent, strict=True)}
    return {name: a.numpy() for name, a in content.items()} | {"detached_from": np.array(detached_from)}


def test_stored_self_check_is_the_reference():
    recomputed = make_self_check()
    with np.load(library.SELF_CHECK) as stored:
        assert set(stored.files) == set(recomputed)
        for name, value in recomputed.items():
            np.testing.assert_allclose(stored[name], value, rtol=1e-6, atol=1e-9, err_msg=name)


def test_self_check_notices_a_fault(monkeypatch):
    """A library that leaves one term out of one gradient must not be trusted."""
    honest = library.backward
    loaded, _ = library.open_library()
    assert library.self_check(loaded) < 1e-5

    def faulty(*args, **kwargs):
        got = honest(*args, **kwargs)
        got["quats"][0] = 0
        return got

    monkeypatch.setattr(library, "backward", faulty)
    assert library.self_check(loaded) > library.SELF_CHECK_ERROR


if __name__ == "__main__":
    np.savez_compressed(library.SELF_CHECK, **make_self_check())
