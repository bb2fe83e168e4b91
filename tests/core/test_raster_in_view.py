"""What a camera cannot show may be left out: pictures stay the same, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster import RasterConfig, blend_weights, rasterize
from f4x_core.raster.blend_weights import blend_weight_sums
from f4x_core.raster.in_view import BLOCK, in_view


def some_splats(seed, count=4000):
    """Gaussians all around the origin, near and far, from specks to needles as long as they are far away."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = 10 ** rng.uniform(-2.5, 1.5, (count, 1))
    return Splats(
        means=(far * directions).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=(far * 10 ** rng.uniform(-3.5, 0, (count, 3)) * rng.choice([0.1, 1], (count, 1))).astype(np.float32),
        opacities=rng.uniform(0, 1, count).astype(np.float32),
    )


def a_camera(seed, size=(96, 54)):
    """Looks anywhere from near the origin, with a lens of any length that may lie off the picture's middle."""
    rng = np.random.default_rng(100 + seed)
    width, height = size
    focal = width * rng.uniform(0.4, 3)
    middle = np.array([0.5, 0.5]) + 0.3 * rng.normal(size=2) * (seed % 2)
    intrinsics = np.array([[focal, 0, middle[0] * width], [0, 1.1 * focal, middle[1] * height], [0, 0, 1]])
    turn = quaternion.from_rotation_vector(rng.normal(size=3) * 2)
    return Camera(intrinsics, pose.to_matrix(turn, 0.2 * rng.normal(size=3)), width, height)


@pytest.mark.parametrize("backend", ["native", "torch", "reference", "plain"])
@pytest.mark.parametrize("seed", range(6))
def test_pictures_are_the_same_without_what_is_out_of_view(seed, backend):
    splats = some_splats(seed, 600 if backend == "reference" else 4000)
    camera = a_camera(seed, (32, 18) if backend == "reference" else (96, 54))
    config = RasterConfig(blur=(0.3, 4.0)[seed % 2], threads=1)
    colors = np.random.default_rng(seed).uniform(size=(len(splats), 5)).astype(np.float32)
    seen = in_view(splats, camera, config)
    whole = rasterize(splats, colors, camera, config=config, backend=backend)
    part = rasterize(splats.take(seen), colors[seen], camera, config=config, backend=backend)
    for name in ("channels", "depth", "alpha"):
        assert np.array_equal(getattr(whole, name), getattr(part, name)), name
    assert np.array_equal(whole.visible[seen], part.visible) and not whole.visible[~seen].any()
    assert whole.alpha.max() > 0.3 and not seen.all()


@pytest.mark.parametrize("backend", ["native", "torch", "plain"])
def test_weights_are_the_same_without_what_is_out_of_view(monkeypatch, backend):
    splats, camera = some_splats(7), a_camera(7)
    layers = np.random.default_rng(7).uniform(size=(camera.height, camera.width, 3)).astype(np.float32)
    weights = blend_weight_sums(splats, camera, layers, backend=backend)
    seen = in_view(splats, camera)
    assert not weights[~seen].any() and weights[seen].any() and not seen.all()
    monkeypatch.setattr(blend_weights, "in_view", lambda splats, *_: np.ones(len(splats), bool))
    assert np.array_equal(weights, blend_weight_sums(splats, camera, layers, backend=backend))


def test_most_of_what_is_not_seen_is_told():
    """Of small Gaussians, as fits have them; the number of blocks changes nothing."""
    splats, camera = some_splats(8, 2 * BLOCK + 100), a_camera(8)
    splats = replace(splats, scales=np.minimum(splats.scales, 0.01 * np.linalg.norm(splats.means, axis=1)[:, None]))
    visible = rasterize(splats, np.zeros((len(splats), 1), np.float32), camera).visible
    seen = in_view(splats, camera)
    assert visible.sum() <= seen.sum() < 1.5 * visible.sum() < 0.5 * len(splats)
    assert np.array_equal(seen[-300:], in_view(splats.take(slice(len(splats) - 300, None)), camera))
    assert in_view(splats.take(slice(0, 0)), camera).shape == (0,)


def test_a_margin_is_a_larger_picture():
    splats, camera = some_splats(9), a_camera(8)
    width, height = camera.width, camera.height
    intrinsics = camera.intrinsics + np.array([[0, 0, 0.5 * width], [0, 0, 0.5 * height], [0, 0, 0]])
    larger = Camera(intrinsics, camera.world_to_camera, 2 * width, 2 * height)
    wide, narrow = in_view(splats, camera, margin=0.5), in_view(splats, camera)
    visible = rasterize(splats, np.zeros((len(splats), 1), np.float32), larger).visible
    small = splats.scales.max(1) < 0.01 * np.linalg.norm(splats.means, axis=1)
    assert not (visible & small & ~wide).any() and not (narrow & ~wide).any()
    assert (wide & small).sum() > 1.5 * (narrow & small).sum() > 0
