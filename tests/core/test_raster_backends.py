"""Every raster backend against the float64 reference, and the reference against the rule written as a scalar loop."""

import sys
import types
from functools import cache

import numpy as np
import pytest
import torch

from benchmarks.speed.raster import Cases, benchmark, draw, make_wavy_scene, view_of
from f4x_core.errors import F4xError
from f4x_core.raster import RasterConfig, RasterInput, choose_backend
from f4x_core.raster.blend_weights import blend_weight_sums

WIDTH, HEIGHT = 61, 45
LEAVES = ("means", "quats", "scales", "opacities", "colors", "viewmat", "background", "mean2d_offset")
FAST = [("torch", torch.float64), ("torch", torch.float32), ("native", torch.float32)]
# Largest image difference and relative L2 gradient difference to the float64 reference.
TOLERANCE = {torch.float64: (1e-12, 1e-10), torch.float32: (2e-5, 5e-5)}


@pytest.fixture(params=FAST, ids=lambda p: f"{p[0]}-{str(p[1])[-2:]}")
def fast(request):
    """(backend, dtype) of everything that is to agree with the reference."""
    require(request.param[0])
    return request.param


@pytest.fixture(params=["reference", "torch", "native"])
def backend(request):
    require(request.param)
    return request.param


def require(backend):
    try:
        choose_backend(backend)
    except F4xError as error:
        pytest.skip(str(error))


def make_scene(n=120, channels=5, width=WIDTH, height=HEIGHT, seed=0):
    """Wavy sheets before a tilted camera with an off-centre principal point."""
    scene = make_wavy_scene(n, channels, width, height, seed)
    scene["viewmat"][:3] = torch.tensor([[0.96, 0.0, 0.28, -0.4], [0.0, 1.0, 0.0, 0.03], [-0.28, 0.0, 0.96, 0.05]])
    scene["K"][0, 2], scene["K"][1, 2] = 0.46 * width, 0.55 * height
    scene["background"] = torch.linspace(0.2, 0.9, channels)
    scene["mean2d_offset"] = torch.zeros(n, 2)
    return scene


def one_splat(mean=(0.0, 0.0, 2.0), scale=(0.1, 0.1, 0.1), opacity=0.8, color=(1.0, 0.5, 0.25)):
    return many_splats([mean], [scale], [opacity], [color])


def many_splats(means, scales, opacities, colors):
    n = len(means)
    scene = {"means": means, "scales": scales, "opacities": opacities, "colors": colors}
    scene = {name: torch.tensor(value) for name, value in scene.items()}
    scene["quats"] = torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1)
    scene |= {"viewmat": torch.eye(4), "K": torch.tensor([[30.0, 0, WIDTH / 2], [0, 30.0, HEIGHT / 2], [0, 0, 1]])}
    return scene | {"width": WIDTH, "height": HEIGHT}


def render(scene, backend, dtype=torch.float32, **options):
    tensors = {k: v.to(dtype) if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    return draw(**tensors, backend=backend, **options)


def differentiate(scene, backend, dtype=torch.float32, **options):
    """Outputs, and gradients of a fixed random functional of them."""
    scene = {k: v.detach().to(dtype) if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    leaves = {k: scene[k].requires_grad_() for k in LEAVES if scene.get(k) is not None}
    out = draw(**scene, backend=backend, **options)
    generator = torch.Generator().manual_seed(3)
    images = (out.channels, out.depth, out.alpha)
    total = sum((image * torch.rand(image.shape, generator=generator).to(image)).sum() for image in images)
    total.backward()
    return out, {name: leaf.grad for name, leaf in leaves.items()}


def assert_agrees(scene, fast, truth=None, looser=1.0, **options):
    backend, dtype = fast
    image_limit, gradient_limit = (looser * limit for limit in TOLERANCE[dtype])
    out, gradients = differentiate(scene, backend, dtype, **options)
    true, true_gradients = truth or differentiate(scene, "reference", torch.float64, **options)
    for name in ("channels", "depth", "alpha"):
        image, expected = getattr(out, name).double(), getattr(true, name)
        assert image.shape == expected.shape
        assert (image - expected).abs().max() <= image_limit * expected.abs().max().clamp_min(1), name
    assert torch.equal(out.visible, true.visible)
    for name, expected in true_gradients.items():
        assert gradients[name].isfinite().all(), name
        assert (gradients[name].double() - expected).norm() <= gradient_limit * expected.norm() + 1e-12, name
    return out, gradients


def composite_by_hand(scene, config):
    """The rule as scalars: one pixel, one splat at a time."""
    s = {k: v.double().numpy() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    fx, fy, cx, cy = s["K"][0, 0], s["K"][1, 1], s["K"][0, 2], s["K"][1, 2]
    R, t = s["viewmat"][:3, :3], s["viewmat"][:3, 3]
    splats = []
    for i in range(len(s["means"])):
        x, y, z = R @ s["means"][i] + t
        if z <= config.near:
            continue
        w, a, b, c = s["quats"][i] / np.linalg.norm(s["quats"][i])
        axis = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        turn = np.eye(3) + 2 * w * axis + 2 * axis @ axis
        u = min(max(x / z, (-cx - 0.15 * s["width"]) / fx), (1.15 * s["width"] - cx) / fx)
        v = min(max(y / z, (-cy - 0.15 * s["height"]) / fy), (1.15 * s["height"] - cy) / fy)
        J = np.array([[fx / z, 0, -fx * u / z], [0, fy / z, -fy * v / z]])
        M = J @ R @ turn @ np.diag(s["scales"][i])
        inverse = np.linalg.inv(M @ M.T + config.blur * np.eye(2))
        splats.append((z, i, np.array([fx * x / z + cx, fy * y / z + cy]), inverse))
    splats.sort(key=lambda splat: splat[:2])
    channels = np.zeros((s["height"], s["width"], s["colors"].shape[1]))
    depth, alpha_sum = np.zeros(channels.shape[:2]), np.zeros(channels.shape[:2])
    for row in range(s["height"]):
        for column in range(s["width"]):
            light = 1.0
            for z, i, mean, inverse in splats:
                d = np.array([column + 0.5, row + 0.5]) - mean
                alpha = s["opacities"][i] * np.exp(-0.5 * d @ inverse @ d)
                if alpha < config.alpha_min:
                    continue
                alpha = min(alpha, config.alpha_max)
                if light * (1 - alpha) <= config.transmittance_min:
                    break
                channels[row, column] += light * alpha * s["colors"][i]
                depth[row, column] += light * alpha * z
                light *= 1 - alpha
            alpha_sum[row, column] = 1 - light
            channels[row, column] += light * s["background"]
    return channels, depth, alpha_sum


def test_reference_is_the_rule():
    scene = make_scene(40, 3, 23, 17)
    scene["opacities"][:20] = 0.999  # makes pixels stop
    out = render(scene, "reference")
    channels, depth, alpha = composite_by_hand(scene, RasterConfig())
    assert (1 - alpha).min() < 1e-3
    np.testing.assert_allclose(out.channels.numpy(), channels, atol=1e-12)
    np.testing.assert_allclose(out.depth.numpy(), depth, atol=1e-12)
    np.testing.assert_allclose(out.alpha.numpy(), alpha, atol=1e-12)


@pytest.mark.parametrize("backend", ["reference", "torch"])
def test_gradcheck(backend):
    scene = make_scene(5, 2, 9, 6, seed=4)
    scene["opacities"] = scene["opacities"] * 0.8
    leaves = [scene[name].double().requires_grad_() for name in LEAVES]

    def function(*values):
        out = draw(
            **{**scene, **dict(zip(LEAVES, values, strict=True))}, backend=backend, config=RasterConfig(alpha_min=1e-12)
        )
        return out.channels, out.depth, out.alpha

    # alpha_min far below everything, so that no finite difference steps over the cut.
    assert torch.autograd.gradcheck(function, leaves, eps=1e-6, atol=1e-6, rtol=1e-5, fast_mode=True)


@cache
def large_scene(detached_from):
    """A scene and what the reference makes of it."""
    scene = make_scene(600, 5, 137, 101)
    return scene, differentiate(scene, "reference", torch.float64, detached_from=detached_from)


@pytest.mark.parametrize("detached_from", [None, 2])
def test_values_and_gradients(fast, detached_from):
    scene, truth = large_scene(detached_from)
    assert_agrees(scene, fast, truth, detached_from=detached_from)


def test_camera_gradient_by_finite_differences(fast):
    backend, dtype = fast
    scene = make_scene()
    _, gradients = differentiate(scene, backend, dtype)
    direction = torch.randn(4, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    direction[3] = 0
    step, totals = 1e-6, []
    for sign in (1, -1):
        out = render(
            {**scene, "viewmat": scene["viewmat"].double() + sign * step * direction}, "reference", torch.float64
        )
        generator = torch.Generator().manual_seed(3)
        images = (out.channels, out.depth, out.alpha)
        totals.append(sum((i * torch.rand(i.shape, generator=generator).to(i)).sum() for i in images))
    slope = (totals[0] - totals[1]) / (2 * step)
    # The cut at alpha_min makes the image jump by up to 1/255 where a splat enters a pixel: no exact derivative.
    assert (gradients["viewmat"].double() * direction).sum() == pytest.approx(float(slope), rel=0.02)


def test_order_of_the_input_does_not_matter(backend):
    scene = make_scene()
    order = torch.randperm(120, generator=torch.Generator().manual_seed(1))
    shuffled = {k: v[order] if isinstance(v, torch.Tensor) and len(v) == 120 else v for k, v in scene.items()}
    a, b = render(scene, backend), render(shuffled, backend)
    torch.testing.assert_close(a.channels, b.channels, rtol=0, atol=1e-6)
    assert torch.equal(a.visible[order], b.visible)


def test_many_channels_are_repeated_three_channel_passes(backend):
    scene = make_scene(channels=9)
    whole = render(scene, backend)
    for start in (0, 3, 6):
        part = slice(start, start + 3)
        single = render({**scene, "colors": scene["colors"][:, part], "background": scene["background"][part]}, backend)
        torch.testing.assert_close(single.channels, whole.channels[..., part], rtol=1e-6, atol=1e-6)


def test_near_plane_and_behind_the_camera(fast):
    scene = make_scene()
    scene["means"][:40, 2] = torch.linspace(-1.0, 0.3, 40)
    scene["means"][:40, :2] *= 0.2
    assert_agrees(scene, fast, config=RasterConfig(near=0.1))
    assert not render(one_splat((0, 0, 0.09)), fast[0], config=RasterConfig(near=0.1)).visible.any()
    assert not render(one_splat((0, 0, -2.0)), fast[0]).alpha.any()


def test_padding_of_the_tile_lists_is_empty(fast):
    """The first splat stands in for the padding of every list; far from its tile its polynomial grows beyond 1."""
    scene = many_splats([[-1.9, -1.3, 2.0], [2.7, 1.9, 3.0]], [[2e-3, 0.02, 0.01]] * 2, [0.9] * 2, [[1.0], [0.5]])
    scene["quats"] = torch.tensor([[0.9, 0.3, -0.2, 0.4], [0.5, -0.1, 0.7, 0.2]])
    assert_agrees(scene, fast)


def test_outside_the_frustum_the_linearisation_is_clamped(fast):
    scene = make_scene()
    scene["means"][:, 0] *= 4
    scene["scales"] = scene["scales"] * 4
    assert_agrees(scene, fast)


def test_empty_scene(backend):
    scene = make_scene(0)
    out, gradients = differentiate(scene, backend)
    assert torch.equal(out.channels, scene["background"].to(out.channels).expand(HEIGHT, WIDTH, 5))
    assert out.visible.shape == (0,) and gradients["means"].shape == (0, 3)
    assert gradients["background"].sum() > 0


def test_views_with_strides_are_read_as_what_they_show(backend):
    scene = make_scene()
    strided = dict(scene)
    for name in ("means", "quats", "scales", "colors", "opacities"):
        wide = torch.full((2 * len(scene[name]), *scene[name].shape[1:]), 7.0)
        wide[::2] = scene[name]
        strided[name] = wide[::2]
    strided["viewmat"] = scene["viewmat"].t().contiguous().t()
    strided["means"] = scene["means"].t().contiguous().t()
    a, b = differentiate(scene, backend), differentiate(strided, backend)
    torch.testing.assert_close(a[0].channels, b[0].channels, rtol=0, atol=1e-5)
    for name in LEAVES:
        torch.testing.assert_close(a[1][name], b[1][name], rtol=1e-4, atol=1e-4)


def test_alpha_just_below_the_clamp_has_its_gradient_and_above_has_none(fast):
    for opacity, clamped in ((0.9895, False), (0.98999, False), (0.9901, True), (1.0, True)):
        # Centred on the pixel centre (WIDTH / 2, HEIGHT / 2), where alpha is the opacity itself.
        scene = one_splat(opacity=opacity)
        scene["opacities"].requires_grad_()
        leaf = scene["opacities"]
        gradient = torch.autograd.grad(render(scene, *fast).alpha[HEIGHT // 2, WIDTH // 2], leaf)[0]
        assert float(gradient) == pytest.approx(0.0 if clamped else 1.0, abs=1e-5)
    scene = make_scene()
    scene["opacities"] = torch.linspace(0.985, 0.995, 120)
    assert_agrees(scene, fast)


def test_zero_quaternion_is_the_identity(backend):
    scene = make_scene()
    identity = torch.tensor([1.0, 0, 0, 0]).expand(120, 4)
    out, gradients = differentiate({**scene, "quats": 0 * identity}, backend)
    torch.testing.assert_close(out.channels, render({**scene, "quats": identity}, backend).channels)
    assert all(gradient.isfinite().all() for gradient in gradients.values())


def test_detached_channels_reach_only_their_colors(backend):
    scene = make_scene()
    scene["background"] = None

    def gradients(**options):
        leaves = {k: scene[k].detach().requires_grad_() for k in LEAVES if scene[k] is not None}
        out = draw(**{**scene, **leaves}, backend=backend, detached_from=2, **options).channels
        return lambda image: dict(
            zip(leaves, torch.autograd.grad(image(out).sum(), list(leaves.values())), strict=True)
        )

    both, plain = gradients()(lambda c: c), gradients()(lambda c: c[..., :2])
    for name in both:
        if name != "colors":
            torch.testing.assert_close(both[name], plain[name])
    assert (both["colors"][:, 2:] > 0).any() and not plain["colors"][:, 2:].any()


def test_threads_and_tiles_never_change_the_result(fast):
    backend = fast[0]
    scene = make_scene(600, 5, 137, 101)
    results = [differentiate(scene, backend, config=RasterConfig(threads=threads)) for threads in (1, 2, 3)]
    for out, gradients in results[1:]:
        assert torch.equal(out.channels, results[0][0].channels)
        for name in set(LEAVES) - {"background"}:
            assert torch.equal(gradients[name], results[0][1][name]), name
    for tile in (4, 16):
        out = render(scene, backend, config=RasterConfig(tile=tile))
        torch.testing.assert_close(out.channels, results[0][0].channels, rtol=0, atol=1e-5)


def test_two_renders_before_two_backward_passes(backend):
    scene, other = make_scene(seed=0), make_scene(seed=1, width=40, height=31)
    alone = differentiate(scene, backend)[1]["means"]
    leaf = scene["means"].detach().requires_grad_()
    first = draw(**{**scene, "means": leaf}, backend=backend)
    kept = first.channels.detach().clone()
    draw(**other, backend=backend)
    assert torch.equal(first.channels, kept)
    generator = torch.Generator().manual_seed(3)
    images = (first.channels, first.depth, first.alpha)
    sum((i * torch.rand(i.shape, generator=generator).to(i)).sum() for i in images).backward()
    torch.testing.assert_close(leaf.grad, alone)


def test_one_tile_image_does_not_alias_work_memory():
    scene = make_scene(width=5, height=4)
    out = render(scene | {"background": None}, "torch")
    kept = out.channels.clone()
    render(make_scene(width=5, height=4, seed=9), "torch")
    assert torch.equal(out.channels, kept)


def test_numpy_in_numpy_out(backend):
    scene = make_scene()
    arrays = {k: v.numpy() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    out = draw(**arrays, backend=backend)
    assert isinstance(out.channels, np.ndarray) and out.visible.dtype == bool
    np.testing.assert_allclose(out.channels, render(scene, backend).channels.numpy(), atol=1e-6)


def test_light_into_layers_adds_up_to_the_picture(backend):
    scene = make_scene()
    arrays = {n: a.numpy() if isinstance(a, torch.Tensor) else a for n, a in scene.items() if n != "background"}
    splats, _, camera = view_of(arrays)
    layers = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32)
    layers[..., 2] = 1
    light = blend_weight_sums(splats, camera, layers, backend=backend)
    out = render(scene | {"background": None}, backend)
    np.testing.assert_allclose(light[:, 2].sum(), out.alpha.sum(), rtol=1e-5)
    shown = float((out.channels[..., 0] * torch.from_numpy(layers[..., 1])).sum())  # linear in the colours
    np.testing.assert_allclose(light[:, 1] @ scene["colors"][:, 0].numpy(), shown, rtol=1e-4)


def test_light_by_numpy_alone_is_the_same():
    scene = make_scene()
    arrays = {n: a.numpy() if isinstance(a, torch.Tensor) else a for n, a in scene.items() if n != "background"}
    splats, _, camera = view_of(arrays)
    layers = np.random.default_rng(0).random((HEIGHT, WIDTH, 2), np.float32)
    light, plain = (blend_weight_sums(splats, camera, layers, backend=backend) for backend in ("torch", "plain"))
    np.testing.assert_allclose(plain, light, atol=1e-4 * light.max())
    assert light.max() > 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"backend": "metal"}, "Unknown raster backend 'metal'"),
        ({"backend": "gsplat"}, "gsplat"),
        ({"quats": torch.zeros(120, 3)}, "quats has shape"),
        ({"background": torch.zeros(3)}, "background has shape"),
        ({"width": 0}, "got 0x45"),
        ({"detached_from": 6}, "detached_from is 6"),
    ],
)
def test_bad_calls_are_answered_in_one_sentence(change, words):
    with pytest.raises(F4xError, match=words):
        draw(**make_scene() | change)


class _TileKernels(types.ModuleType):
    """The three functions of gsplat that are used, dense and on the CPU, to check what goes in and comes out of them."""

    def isect_tiles(self, means2d, radii, depths, tile_size, tile_width, tile_height):
        assert tile_size == 16 and not means2d.requires_grad and radii.dtype == torch.int32
        seen = (radii[0] > 0).all(1).nonzero()[:, 0]
        return None, "keys", seen[torch.argsort(depths[0, seen], stable=True)]

    def isect_offset_encode(self, isect_ids, n_images, tile_width, tile_height):
        assert (isect_ids, n_images) == ("keys", 1)
        return torch.zeros(1, tile_height, tile_width)

    def rasterize_to_pixels(self, means2d, conics, colors, opacities, width, height, tile_size, offsets, ids):
        assert colors.shape[-1] <= 32 and offsets.shape == (1, -(-height // 16), -(-width // 16))
        y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        dx, dy = x[..., None] - means2d[0, ids, 0], y[..., None] - means2d[0, ids, 1]  # (H, W, n)
        a, b, c = conics[0, ids].unbind(1)
        alpha = opacities[0, ids] * torch.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        alpha = torch.where(alpha < 1 / 255, 0.0, alpha.clamp_max(0.999))
        after = torch.cumprod(1 - alpha, -1)
        before = torch.cat((torch.ones_like(after[..., :1]), after[..., :-1]), -1)
        weight = torch.where(after > 1e-4, alpha * before, 0.0)
        return (weight @ colors[0, ids])[None], weight.sum(-1)[None, ..., None]


@pytest.mark.parametrize(("channels", "detached_from"), [(3, None), (5, 3), (70, 0), (70, 40), (5, 5)])
def test_gsplat_is_called_as_it_wants(channels, detached_from, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", _TileKernels("gsplat"))
    monkeypatch.setattr("f4x_core.raster._why_not_gsplat", lambda: None)
    monkeypatch.setattr("f4x_core.raster.gsplat._check", lambda means, config: None)
    scene = make_scene(channels=channels)
    scene["opacities"] = scene["opacities"].clamp_max(0.98)  # above, gsplat clamps later
    assert_agrees(scene, ("gsplat", torch.float32), detached_from=detached_from)


def test_gsplat_says_what_it_cannot_do():
    from f4x_core.raster.gsplat import rasterize_gsplat

    with pytest.raises(F4xError, match="float32 tensors on a CUDA device"):
        rasterize_gsplat(RasterInput(*view_of(make_scene())))


@pytest.mark.parametrize("detached_from", [None, 3])
def test_gsplat_on_a_device(detached_from):
    require("gsplat")
    scene = make_scene(2000, 5, 160, 120)
    scene["opacities"] = scene["opacities"].clamp_max(0.98)
    truth = differentiate(scene, "reference", torch.float64, detached_from=detached_from)
    device = {k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    out, gradients = differentiate(device, "gsplat", detached_from=detached_from)
    assert (out.channels.cpu().double() - truth[0].channels).abs().max() < 1e-4
    for name, expected in truth[1].items():
        assert (gradients[name].cpu().double() - expected).norm() <= 1e-3 * expected.norm(), name


def test_benchmark_reports_every_backend():
    report = benchmark(Cases((200,), (3,), width=48, height=32), ("torch", "gsplat"), repeats=1)
    assert [row["backend"] for row in report["timings"]] == ["torch"] and "gsplat" in report["skipped"]
    assert report["errors"]["torch"]["image_max"] < 1e-4
    assert max(report["errors"]["torch"]["gradients"].values()) < 1e-4


def test_benchmark_compares_like_with_like():
    report = benchmark(Cases((200,), (3, 5), (1, 2), width=48, height=32), ("torch",), repeats=1)
    assert set(report["ratios"]) == {
        "5 / 3 channels, torch, 200 Gaussians, 1 threads",
        "5 / 3 channels, torch, 200 Gaussians, 2 threads",
        "1 / 2 threads, torch, 200 Gaussians, 3 channels",
        "1 / 2 threads, torch, 200 Gaussians, 5 channels",
    }
    times = {(row["channels"], row["threads"]): row["train_ms"] for row in report["timings"]}
    assert report["ratios"]["5 / 3 channels, torch, 200 Gaussians, 2 threads"] == times[5, 2] / times[3, 2]
