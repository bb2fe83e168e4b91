"""Native raster kernel against the float64 reference backend: values, gradients, determinism, layout, self-check."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from test_native_values import KINDS, STORED, part

from benchmarks.speed.raster import draw, view_of
from f4x_core.errors import F4xError
from f4x_core.native import instruction_set
from f4x_core.native.build import compile_command, find_compiler
from f4x_core.raster import native
from f4x_core.raster.contract import RasterConfig, RasterInput
from f4x_core.raster.native import library

NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmat", "background", "mean2d_offset")
ONE = RasterConfig(threads=1)


pytestmark = pytest.mark.usefixtures("native_library")


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


def render_reference(scene, width, height, config=ONE, detached_from=None):
    out = draw(**scene, width=width, height=height, config=config, detached_from=detached_from, backend="reference")
    return out.channels, out.depth, out.alpha


def render_native(scene, width, height, config=ONE, detached_from=None):
    out = draw(**scene, width=width, height=height, config=config, detached_from=detached_from, backend="native")
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
    """Content of self_check.npz, from the float64 reference backend."""
    width, height, channels, detached_from = 23, 19, 3, 2
    scene, sent = make_scene(24, channels, width, height, seed=11, size=0.15), random_sent(width, height, channels)
    outputs = ("channels", "depth", "alpha")
    expected = dict(zip(outputs, render_reference(to_double(scene), width, height, ONE, detached_from), strict=True))
    expected |= gradients(lambda s: render_reference(s, width, height, ONE, detached_from), to_double(scene), sent)
    del expected["background"]  # taken outside the kernel
    content = {f"input_{name}": a for name, a in scene.items()} | {f"expect_{name}": a for name, a in expected.items()}
    content |= {f"sent_{name}": a for name, a in zip(outputs, sent, strict=True)}
    return {name: a.numpy() for name, a in content.items()} | {"detached_from": np.array(detached_from)}


@pytest.mark.parametrize(
    ("count", "channels", "width", "height", "detached_from"),
    [(250, 3, 61, 45, None), (400, 11, 50, 33, 4), (100, 36, 33, 20, 0), (5, 1, 16, 16, None), (60, 47, 20, 7, 46)],
)
def test_values_and_gradients_match_float64(count, channels, width, height, detached_from):
    scene, sent = make_scene(count, channels, width, height), random_sent(width, height, channels)
    options = (width, height, ONE, detached_from)
    for got, expected in zip(render_native(scene, *options), render_reference(to_double(scene), *options), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-5)
    got = gradients(lambda s: render_native(s, *options), scene, sent)
    expected = gradients(lambda s: render_reference(s, *options), to_double(scene), sent)
    # The background's share is 1 - alpha, which float32 knows to 6e-8 absolutely.
    errors = {name: relative(got[name], expected[name]) for name in NAMES}
    assert all(error < (1e-3 if name == "background" else 1e-5) for name, error in errors.items()), errors


def test_more_splats_than_a_chunk_in_every_tile():
    """1500 faint splats over one tile: six chunks, transmittance carried over, stops in different chunks."""
    scene, sent = make_scene(1500, 2, 16, 16, seed=8, size=0.4), random_sent(16, 16, 2)
    scene["opacities"] *= torch.linspace(0.005, 0.04, 1500)
    for got, expected in zip(render_native(scene, 16, 16), render_reference(to_double(scene), 16, 16), strict=True):
        np.testing.assert_allclose(got, expected, atol=2e-5)
    got = gradients(lambda s: render_native(s, 16, 16), scene, sent)
    expected = gradients(lambda s: render_reference(s, 16, 16), to_double(scene), sent)
    for name in NAMES:
        assert relative(got[name], expected[name]) < (1e-3 if name == "background" else 3e-5), name


def test_strided_views_are_read_as_what_they_show():
    """Once `depth` went in as a strided view by bare pointer: wrong order, wrong image, no complaint."""
    scene, sent = make_scene(80, 3, 40, 30), random_sent(40, 30, 3)
    wide = {n: torch.stack([a, torch.full_like(a, 7.0)], -1) for n, a in scene.items()}
    views = {n: a[..., 0] for n, a in wide.items()}
    assert not any(v.is_contiguous() for v in views.values())
    for a, b in zip(render_native(scene, 40, 30), render_native(views, 40, 30), strict=True):
        assert torch.equal(a, b)
    sent_views = [torch.stack([s, s + 1], -1)[..., 0] for s in sent]
    straight = gradients(lambda s: render_native(s, 40, 30), scene, sent)
    strided = gradients(lambda s: render_native(s, 40, 30), views, sent_views)
    assert all(torch.equal(straight[n], strided[n]) for n in NAMES)
    flipped = {n: a.numpy()[::-1] if n in ("means", "quats") else a.numpy() for n, a in scene.items()}
    copied = {n: a.copy() for n, a in flipped.items()}
    got, expected = (draw(**s, width=40, height=30, backend="native") for s in (flipped, copied))
    np.testing.assert_array_equal(got.depth, expected.depth)


def test_other_dtypes_are_refused_in_one_sentence():
    scene = make_scene(4, 2, 20, 16)
    with pytest.raises(F4xError, match=r"float32.*means is torch.float64.*backend='torch'"):
        draw(**to_double(scene), width=20, height=16, backend="native")


def test_forward_from_numpy_without_torch():
    """Blender's Python has numpy but no torch: importing and rendering must not ask for it."""
    program = """
import sys
sys.modules["torch"] = None
import numpy as np
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster import rasterize
splats = Splats(np.array([[0, 0, 2.0]]), np.array([[1.0, 0, 0, 0]]), np.full((1, 3), 0.2), np.array([0.8]))
camera = Camera([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]], np.eye(4), 32, 24)
out = rasterize(splats, np.ones((1, 4)), camera, backend="native")
assert out.channels.shape == (24, 32, 4) and out.visible.tolist() == [True]
print(float(out.alpha.max()), float(out.depth.max()))
"""
    root = Path(native.__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    alpha, depth = map(float, done.stdout.split())
    # The mean lies on the corner of four pixels, (0.5, 0.5) px away, with variance (40 * 0.2 / 2)^2 + 0.3 px^2.
    assert alpha == pytest.approx(0.8 * np.exp(-0.25 / 16.3), rel=1e-5)
    assert depth == pytest.approx(2 * alpha, rel=1e-5)


def built_with(flag, folder):
    """The kernel library compiled with another flag, where the flag can be given."""
    if Path(find_compiler()[0]).stem == "cl":
        pytest.skip("flags for GCC and clang")
    folder.mkdir(exist_ok=True)
    output = folder / "other.so"
    done = subprocess.run([*compile_command(find_compiler(), output), flag], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return output


@pytest.mark.parametrize("flag", ["-DF4X_PLAIN", "-DF4X_NO_AVX2", "-DF4X_NO_AVX512"])
@pytest.mark.slow
def test_other_builds_of_the_kernel_agree(flag, tmp_path, monkeypatch):
    """The kernel without vector extensions (other compilers) and for other processors passes the self-check."""
    own = instruction_set(library.open_library()[0])
    output = built_with(flag, tmp_path)
    monkeypatch.setattr("f4x_core.native.library.library_path", lambda: output)
    assert native.available(), native.why_not()
    expected = "avx2" if flag == "-DF4X_NO_AVX512" and own != "plain" else "plain"
    assert instruction_set(library.open_library()[0]) == expected


@pytest.mark.slow
def test_instruction_sets_with_fused_multiply_add_give_the_same_bits(tmp_path, monkeypatch):
    """AVX2 and AVX-512 with eight and with sixteen lanes: a timing may choose between them, and processors may differ."""
    if not instruction_set(library.open_library()[0]).startswith("avx512"):
        pytest.skip("a processor with AVX-512")
    with np.load(STORED) as file:
        stored = dict(file)
    results = {}
    for flag in ("-DF4X_NO_AVX512", "-DF4X_WIDE_LANES=0", "-DF4X_WIDE_LANES=1"):
        built = built_with(flag, tmp_path / flag)
        monkeypatch.setattr("f4x_core.native.library.library_path", lambda built=built: built)
        found = {kind: function(part(stored, f"{kind}_in_")) for kind, function in KINDS.items()}
        found |= {f"raster {channels}": pictures_and_gradients(channels) for channels in (1, 3, 7, 12, 35, 52)}
        results[instruction_set(library.open_library()[0])] = found
    assert list(results) == ["avx2", "avx512", "avx512-wide"]
    for name in ("avx512", "avx512-wide"):
        for kind, arrays in results["avx2"].items():
            differing = [key for key in arrays if not np.array_equal(arrays[key], results[name][kind][key])]
            assert not differing, (name, kind, differing)


def pictures_and_gradients(channels):
    """Arrays of a picture with cut-off tiles, many chunks of Gaussians and an uneven gradient, by the library in use."""
    scene = make_scene(1500, channels, 90, 61, seed=5)
    leaves = {name: array.clone().requires_grad_() for name, array in scene.items()}
    out = draw(**leaves, width=90, height=61, backend="native")
    (out.channels.square().sum() + out.depth.sum() + out.alpha.sum()).backward()
    images = {"channels": out.channels, "depth": out.depth, "alpha": out.alpha}
    gradients = {f"d_{name}": leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
    assert len(gradients) > 3
    return {name: tensor.detach().numpy() for name, tensor in (images | gradients).items()}


def test_pairs_are_the_pixels_that_each_splat_reaches():
    scene = make_scene(2, 1, 40, 30, seed=3, size=0.05)
    alone = [{n: a if n in ("viewmat", "K") else a[i : i + 1] for n, a in scene.items()} for i in (0, 1)]
    loaded, _ = library.open_library()

    def count(arrays):
        plain = {n: a.numpy() for n, a in arrays.items() if n != "background"}
        inputs = RasterInput(*view_of(plain | {"width": 40, "height": 30}), config=ONE)
        return library.count_pairs(loaded, library.forward(loaded, inputs, keep=True))

    for arrays in alone:
        reached = (
            draw(
                **{n: a for n, a in arrays.items() if n != "background"}, width=40, height=30, backend="reference"
            ).alpha
            > 0
        )
        assert count(arrays) == int(reached.sum()) > 0
    assert count(scene) == sum(map(count, alone))  # neither hides the other: no pixel is full


def test_a_missing_library_says_how_to_get_one(tmp_path, monkeypatch):
    monkeypatch.setattr("f4x_core.native.library.library_path", lambda: tmp_path / "absent.so")
    assert not native.available()
    with pytest.raises(F4xError, match=r"f4x_core.native.build"):
        draw(**{n: a.numpy() for n, a in make_scene(2, 1, 8, 8).items()}, width=8, height=8, backend="native")


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
