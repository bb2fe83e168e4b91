"""Depth limits of pixels in the backends that know them, and the plain numpy backend, against the float64 reference."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from test_raster_backends import HEIGHT, WIDTH, make_scene, many_splats, require

from benchmarks.speed.raster import draw
from f4x_core.errors import F4xError
from f4x_core.raster import RasterConfig, choose_backend

GRADIENTS = ("means", "quats", "scales", "opacities", "colors", "background")


def in_numpy(scene):
    return {k: v.numpy() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}


def some_limits():
    """Open rows, rows that need not be drawn, and an uneven surface amid the Gaussians."""
    limits = np.random.default_rng(0).uniform(1, 5, (HEIGHT, WIDTH)).astype(np.float32)
    limits[:10], limits[20:30] = np.inf, 0
    return limits


@pytest.mark.parametrize("limit", [None, some_limits()], ids=["open", "limited"])
@pytest.mark.parametrize("backend", ["plain", "native"])
def test_agrees_with_the_reference(backend, limit):
    require(backend)
    scene = in_numpy(make_scene())
    scene["mean2d_offset"] = np.random.default_rng(1).normal(0, 0.5, (len(scene["means"]), 2)).astype(np.float32)
    expected = draw(**scene, backend="reference", limit=limit)
    got = draw(**scene, backend=backend, limit=limit)
    for name in ("channels", "depth", "alpha"):
        assert np.abs(getattr(got, name) - getattr(expected, name)).max() < 1e-5
    assert (got.visible == expected.visible).all()


def test_plain_is_the_reference_in_float64():
    """Odd sizes, needles, opaque stacks that stop early, a Gaussian behind the camera."""
    scene = in_numpy(make_scene(n=900, width=50, height=37, seed=4))
    scene = {k: v.astype(np.float64) if isinstance(v, np.ndarray) else v for k, v in scene.items()}
    scene["opacities"][::2] = 1.0
    scene["scales"][::3, 0] *= 30
    scene["means"][0] = [0, 0, -5]
    config = RasterConfig(blur=0.1)
    expected = draw(**scene, backend="reference", config=config)
    got = draw(**scene, backend="plain", config=config)
    assert expected.alpha.max() > 0.999
    assert np.abs(got.channels - expected.channels).max() < 1e-12 and got.channels.dtype == np.float64
    assert np.abs(got.depth - expected.depth).max() < 1e-11


@pytest.mark.parametrize("backend", ["plain", "native", "reference"])
def test_a_surface_between_two_gaussians_hides_the_second(backend):
    require(backend)
    scene = in_numpy(many_splats([(0, 0, 2.0), (0, 0, 4.0)], [[0.2] * 3] * 2, [0.5, 0.9], [[1.0, 0, 0], [0, 1.0, 0]]))
    limit = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    limit[:, WIDTH // 2 + 1 :] = np.inf
    out = draw(**scene, backend=backend, limit=limit)
    hidden, seen = out.channels[HEIGHT // 2, WIDTH // 2], out.channels[HEIGHT // 2, WIDTH // 2 + 1]
    assert hidden[0] > 0.45 and hidden[1] == 0
    assert seen[0] > 0.45 and seen[1] > 0.35


@pytest.mark.parametrize("rows", [slice(0, HEIGHT), slice(7, 30)], ids=["whole", "rows"])
def test_native_gradients_stop_at_the_limit(rows):
    require("native")
    limit = torch.from_numpy(some_limits()[rows])
    gradients = []
    for backend, dtype in (("native", torch.float32), ("reference", torch.float64)):
        scene = {k: v.to(dtype) if isinstance(v, torch.Tensor) else v for k, v in make_scene().items()}
        leaves = [scene[name].requires_grad_() for name in GRADIENTS]
        out = draw(**scene, backend=backend, limit=limit.to(dtype), rows=rows)
        weights = torch.rand(out.channels.shape, generator=torch.Generator().manual_seed(3))
        ((out.channels * weights.to(dtype)).sum() + out.depth.sum() + out.alpha.square().sum()).backward()
        gradients.append([leaf.grad for leaf in leaves])
    for got, expected in zip(*gradients, strict=True):
        assert (got - expected).norm() < 5e-5 * expected.norm()


@pytest.mark.parametrize("backend", ["native", "plain", "reference"])
def test_bands_make_the_whole_picture_bit_for_bit(backend):
    """What a renderer does that wants to say how far it is: band after band, cut where tiles are not."""
    require(backend)
    scene, limit = in_numpy(make_scene()), some_limits()
    whole = draw(**scene, backend=backend, limit=limit)
    for rows in (slice(0, 13), slice(13, 14), slice(14, HEIGHT)):
        band = draw(**scene, backend=backend, limit=limit[rows], rows=rows)
        for name in ("channels", "depth", "alpha"):
            assert (getattr(band, name) == getattr(whole, name)[rows]).all(), name
        assert (band.visible == whole.visible).all()


def test_who_draws():
    arrays = make_scene()["means"].numpy()
    assert choose_backend("auto", arrays.astype(np.float64), partial=True) == "plain"
    assert choose_backend("auto", torch.zeros(1, 3, dtype=torch.float64), partial=True) == "reference"
    with pytest.raises(F4xError, match="torch raster backend knows no depth limits"):
        choose_backend("torch", arrays, partial=True)
    with pytest.raises(F4xError, match="numpy arrays"):
        draw(**make_scene(), backend="plain")
    with pytest.raises(F4xError, match="limit has shape"):
        draw(**in_numpy(make_scene()), limit=np.zeros((2, 2)))
    with pytest.raises(F4xError, match=f"last <= {HEIGHT}"):
        draw(**in_numpy(make_scene()), rows=slice(3, HEIGHT + 1))


def test_without_torch_and_library_numpy_draws():
    """Blender's own Python on a platform for which nothing is compiled."""
    program = """
import sys
import numpy as np
import f4x_core.raster as raster
sys.modules["torch"] = None
raster.find_spec = lambda name: None
assert raster.choose_backend("auto", np.zeros((1, 3), np.float32)) == "plain"
splats = raster.Splats(np.array([[0.0, 0, 2]]), np.array([[1.0, 0, 0, 0]]), np.full((1, 3), 0.2), np.array([0.5]))
camera = raster.Camera(np.array([[20.0, 0, 8], [0, 20, 8], [0, 0, 1]]), np.eye(4), 16, 16)
out = raster.rasterize(splats, np.ones((1, 3)), camera)
print(out.alpha.max())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 0.45 < float(done.stdout) <= 0.5


@pytest.mark.parametrize("count", [0, 400])
def test_torch_draws_a_large_picture_in_bands_bit_for_bit(count, monkeypatch):
    """No more than so many pairs of Gaussian and tile are in memory at once; with gradients all of them are."""
    from f4x_core.raster import tiles

    scene = {key: value for key, value in make_scene(n=count, width=50, height=37, seed=2).items()}
    whole = draw(**scene, backend="torch")
    listed = []

    def counted(*arguments):
        lists = real(*arguments)
        listed.append((int((~lists.padding).sum()), len(arguments[-1])))
        return lists

    real = tiles.build_tile_lists
    monkeypatch.setattr(tiles, "build_tile_lists", counted)
    monkeypatch.setattr(tiles, "PAIRS", 300)
    banded = draw(**scene, backend="torch")
    for name in ("channels", "depth", "alpha", "visible"):
        assert torch.equal(getattr(banded, name), getattr(whole, name)), name
    assert sum(rows for _, rows in listed) == -(-37 // RasterConfig().tile)
    assert all(pairs <= 300 or rows == 1 for pairs, rows in listed) and (len(listed) > 1) == (count > 0)
    listed.clear()
    scene["colors"].requires_grad_()
    assert draw(**scene, backend="torch").channels.requires_grad and len(listed) == 1
