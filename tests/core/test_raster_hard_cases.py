"""Input that has broken rasterisers, beside the catalogue in `tests/hard_cases`: the backends agree with the float64
reference, stay finite and never crash."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from benchmarks.speed.raster import draw, make_wavy_scene
from f4x_core.errors import F4xError
from f4x_core.raster import RasterConfig, choose_backend

WIDTH, HEIGHT, GAUSSIANS = 61, 45, 120
LEAVES = ("means", "quats", "scales", "opacities", "colors", "viewmat")


@pytest.fixture(params=["torch", "native"])
def backend(request):
    try:
        return choose_backend(request.param)
    except F4xError as error:
        pytest.skip(str(error))


def make_scene(count=GAUSSIANS, channels=4, width=WIDTH, height=HEIGHT):
    return make_wavy_scene(count, channels, width, height)


def differentiate(scene, backend, **options):
    """The picture and the gradients of a fixed random functional of it."""
    scene = {k: v.detach() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    leaves = {k: scene[k].requires_grad_() for k in LEAVES}
    out = draw(**scene, backend=backend, **options)
    generator = torch.Generator().manual_seed(3)
    images = (out.channels, out.depth, out.alpha)
    sum((i * torch.rand(i.shape, generator=generator).to(i)).sum() for i in images).backward()
    return out, {name: leaf.grad for name, leaf in leaves.items()}


def test_alpha_exactly_at_the_cut(backend):
    """Centred on a pixel, alpha is the opacity: 1/255 still counts, the next smaller number does not."""
    cut = torch.tensor(1 / 255, dtype=torch.float32)
    below = torch.nextafter(cut, torch.tensor(0.0))
    for opacity, seen in ((cut * (1 + 1e-6), True), (below * (1 - 1e-6), False)):
        scene = make_scene(1, 1, 9, 9)
        scene["means"] = torch.tensor([[0.0, 0.0, 2.0]])
        scene["opacities"] = opacity[None]
        assert bool(draw(**scene, backend=backend).alpha[4, 4] > 0) == seen


def test_whole_numbers(backend):
    scene = make_scene(3, 2)
    whole = {
        "means": torch.tensor([[0, 0, 2], [0, 0, 3], [1, 0, 4]]),
        "quats": torch.tensor([[1, 0, 0, 0]] * 3),
        "scales": torch.tensor([[1, 1, 1]] * 3),
        "opacities": torch.tensor([1, 0, 1]),
        "colors": torch.tensor([[1, 0], [0, 1], [3, 2]]),
    }
    floats = draw(**scene | {k: v.float() for k, v in whole.items()}, backend=backend)
    assert torch.equal(draw(**scene | whole, backend=backend).channels, floats.channels)
    arrays = {k: v.numpy() if isinstance(v, torch.Tensor) else v for k, v in (scene | whole).items()}
    np.testing.assert_array_equal(draw(**arrays, backend=backend).channels, floats.channels.numpy())


def test_double_precision_arrays(backend):
    scene = make_scene()
    arrays = {k: v.double().numpy() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    got = draw(**arrays, backend=backend).channels
    np.testing.assert_allclose(got, draw(**scene, backend=backend).channels.numpy(), atol=1e-5)


@pytest.mark.slow
def test_a_picture_of_nine_megapixels(backend):
    width, height, splat = 4096, 2160, 24.0  # px
    scene = make_scene(300, 3, width, height)
    scene["scales"] = splat / scene["K"][0, 0] * scene["means"][:, 2:].expand(-1, 3)
    with torch.no_grad():
        out = draw(**scene, backend=backend)
    assert out.channels.shape == (height, width, 3) and out.channels.isfinite().all()
    # The last corner by itself, as the reference sees it. Splats this small need no clamp of the linearisation.
    left, top = width - 300, height - 200
    part = scene | {"width": 300, "height": 200, "K": scene["K"] - torch.tensor([[0, 0, left], [0, 0, top], [0, 0, 0]])}
    near = (scene["means"][:, 0] > 0) & (scene["means"][:, 1] > 0)
    part |= {k: v[near] for k, v in scene.items() if k in LEAVES[:5]}
    true = draw(**part, backend="reference")
    error = (out.alpha[top:, left:].double() - true.alpha).abs()
    assert true.alpha.max() > 0.5 and error.quantile(0.99) < 1e-3


@pytest.mark.slow
def test_two_million_gaussians(backend):
    scene = make_scene(2_000_000, 3, 160, 120)
    out, gradients = differentiate(scene, backend)
    assert out.channels.isfinite().all() and all(g.isfinite().all() for g in gradients.values())
    assert out.alpha.min() > 0.9


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "mean2d_offset"])
@pytest.mark.parametrize("kind", ["torch", "numpy"])
def test_what_is_not_finite_is_left_out_and_counted(backend, kind, name, value):
    scene = make_scene()
    scene["mean2d_offset"] = torch.zeros(GAUSSIANS, 2)
    broken = scene | {name: scene[name].clone()}
    broken[name].view(GAUSSIANS, -1)[[5, 40], -1] = value
    rest = torch.arange(GAUSSIANS)[~torch.isin(torch.arange(GAUSSIANS), torch.tensor([5, 40]))]
    clean = {k: v[rest] if k in ("mean2d_offset", *LEAVES[:5]) else v for k, v in scene.items()}
    if kind == "numpy":
        broken, clean = (
            {k: v.numpy() if isinstance(v, torch.Tensor) else v for k, v in s.items()} for s in (broken, clean)
        )
        out, expected = draw(**broken, backend=backend), draw(**clean, backend=backend)
    else:
        (out, gradients), (expected, clean_gradients) = differentiate(broken, backend), differentiate(clean, backend)
        for leaf in LEAVES[:5]:
            assert not gradients[leaf][[5, 40]].any()
            torch.testing.assert_close(gradients[leaf][rest], clean_gradients[leaf], rtol=1e-3, atol=1e-3)
    assert out.dropped == 2 and expected.dropped == 0
    assert not out.visible[[5, 40]].any()
    assert (out.channels - expected.channels).max() < 1e-6 and (expected.channels - out.channels).max() < 1e-6
    with pytest.raises(F4xError, match=rf"{name} of Gaussian 5 hold NaN or infinity \(2 of 120"):
        draw(**broken, backend=backend, config=RasterConfig(debug=True))


@pytest.mark.parametrize("name", ["viewmat", "K", "background"])
def test_a_camera_that_is_not_finite_is_refused(backend, name):
    scene = make_scene() | {"background": torch.zeros(4)}
    scene[name].view(-1)[0] = float("nan")
    with pytest.raises(F4xError, match=f"{name} holds NaN"):
        draw(**scene, backend=backend)


def test_large_but_finite_is_no_fault(backend):
    scene = make_scene()
    scene["colors"] = torch.full_like(scene["colors"], 1e37)  # their sum overflows
    out = draw(**scene, backend=backend)
    assert out.dropped == 0 and out.alpha.max() > 0.5


def test_renders_from_several_python_threads_at_once(backend):
    scenes = [make_scene(300 + 50 * k, 3, 100 + 7 * k, 80) for k in range(4)]
    config = RasterConfig(threads=2)
    alone = [differentiate(scene, backend, config=config) for scene in scenes]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            together = list(pool.map(lambda scene: differentiate(scene, backend, config=config), scenes))
            for (out, gradients), (expected, expected_gradients) in zip(together, alone, strict=True):
                assert torch.equal(out.channels, expected.channels)
                assert all(torch.equal(gradients[name], expected_gradients[name]) for name in LEAVES)
