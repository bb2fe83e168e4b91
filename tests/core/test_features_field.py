"""Distillation: heads, spectrum, pictures, the light matrix, and a field learnt on the toy clip."""

import dataclasses
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from labelled_scene import labelled_scene
from random_scene import HEIGHT, WIDTH, random_scene

from f4x_core.errors import Cancelled, F4xError
from f4x_core.features.footprint import cell_weights
from f4x_core.features.heads import Head, head_widths
from f4x_core.features.maps import FeatureMaps
from f4x_core.features.pca import fit_pca
from f4x_core.features.spec import FeatureSpec
from f4x_core.features.spectrum import measure_spectrum
from f4x_core.fit.distil import distil, to_grid
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.raster import RasterConfig, rasterize
from f4x_core.scene import DynamicSet, StaticSet, write_scene
from f4x_core.scene.view import render

CONFIG = DistilConfig(width=8, steps=150, threads=1)


def maps_of(scene, name="colour", dim=12, grid=(10, 16), seed=5, **spec):
    """Maps that are a smooth function of the picture itself, so that a scene can hold them."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(3, dim))
    cameras = scene.cameras
    frames = []
    for t in range(len(cameras)):
        shown = render(scene, cameras[t], float(cameras.times[t]), ("rgb", "alpha"), "torch")
        rgb = to_grid(
            torch.from_numpy(shown["rgb"] / np.maximum(shown["alpha"], 0.1)[..., None]),
            torch.from_numpy(shown["alpha"]),
            FeatureSpec("g", 1, grid, "area"),
        )[0].numpy()
        frames.append(np.tanh(rgb @ mixing) + 0.1)
    spec = FeatureSpec(name, dim, grid, "area", **spec)
    return FeatureMaps(Path(name), spec, np.stack(frames).astype(np.float16))


@pytest.fixture(scope="module")
def scene():
    return random_scene(static=300, dynamic=60, degree=0)


@pytest.fixture(scope="module")
def learnt(scene):
    """(scene with one head, its maps)."""
    maps = maps_of(scene)
    return distil(scene, [maps], CONFIG), maps


def test_heads_double():
    assert head_widths(32, 256) == [32, 64, 128, 256]
    assert head_widths(32, 512) == [32, 64, 128, 256, 512]
    assert head_widths(32, 1408) == [32, 64, 128, 256, 512, 1024, 1408]
    assert head_widths(32, 384) == [32, 64, 128, 256, 384]
    assert head_widths(32, 8) == [32, 8]


def test_head_arrays_there_and_back_and_gradient():
    head = Head([4, 6, 5])
    latent = torch.randn(7, 4)
    arrays = head.to_arrays()
    assert {name: a.shape for name, a in arrays.items()} == {
        "weight_0": (4, 6),
        "bias_0": (6,),
        "weight_1": (6, 5),
        "bias_1": (5,),
    }
    torch.testing.assert_close(Head.from_arrays(arrays)(latent), head(latent))
    wide = Head([3, 5, 4]).double()
    assert torch.autograd.gradcheck(wide, (torch.randn(2, 3, dtype=torch.float64, requires_grad=True),))


def test_pca_finds_planted_directions_and_keeps_its_signs():
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(9, 9)))[0][:3]
    samples = rng.normal(size=(4000, 3)) * [9, 4, 2] @ basis + 7
    pca = fit_pca(samples)
    np.testing.assert_allclose(np.abs((pca.basis * basis).sum(1)), 1, atol=1e-3)
    assert (np.take_along_axis(pca.basis, np.abs(pca.basis).argmax(1)[:, None], 1) > 0).all()
    np.testing.assert_allclose(fit_pca(samples[::-1]).basis, pca.basis, atol=1e-5)
    picture = pca.to_rgb(samples.reshape(40, 100, 9))
    assert picture.dtype == np.uint8
    assert 0.005 < (picture == 0).mean() < 0.02 and 0.005 < (picture == 255).mean() < 0.02


@pytest.mark.parametrize("channels", [1, 2])
def test_pca_of_few_channels_and_of_nothing(channels):
    assert fit_pca(np.random.default_rng(0).normal(size=(50, channels))).to_rgb(np.ones((2, 3, channels))).shape == (
        2,
        3,
        3,
    )
    assert (fit_pca(np.zeros((0, 5))).to_rgb(np.ones((2, 2, 5))) == 0).all()


@pytest.mark.parametrize(("rank", "width"), [(5, 8), (14, 16), (30, 32), (200, 64)])
def test_width_follows_the_rank_of_the_teachers(rank, width):
    rng = np.random.default_rng(1)
    stored = (rng.normal(size=(4, 20, 20, rank)) @ rng.normal(size=(rank, 300))).astype(np.float16)
    a = FeatureMaps(Path("a"), FeatureSpec("a", 100, (20, 20)), stored[..., :100])
    b = FeatureMaps(Path("b"), FeatureSpec("b", 200, (20, 20)), 0.01 * stored[..., 100:])
    spectrum = measure_spectrum([a, b], range(4))
    assert spectrum.width(0.99) == width
    np.testing.assert_allclose(spectrum.values.sum(), 2, rtol=1e-4)  # each teacher counts the same, whatever its unit


@pytest.mark.parametrize("grid", [(10, 16), (5, 8), (7, 9), (1, 1)])
def test_light_times_channels_is_the_area_mean_of_the_picture(scene, grid):
    posed = scene.posed(1.0)
    camera, posed = scene.cameras[1], replace(posed, scales=0.3 * posed.scales)
    colours = np.random.default_rng(2).normal(size=(len(posed.ids), 4)).astype(np.float32)
    out = rasterize(posed, colours, camera, backend="torch", config=RasterConfig(threads=1))
    light = cell_weights(posed, camera, grid, backend="torch", config=RasterConfig(threads=1))
    rows = (np.arange(HEIGHT) + 0.5) * grid[0] // HEIGHT
    columns = (np.arange(WIDTH) + 0.5) * grid[1] // WIDTH
    cell = (rows[:, None] * grid[1] + columns).astype(int).ravel()
    expected = np.zeros((grid[0] * grid[1], 5))
    np.add.at(expected, cell, np.concatenate([out.channels, out.alpha[..., None]], -1).reshape(-1, 5))
    found = np.concatenate([light @ colours, np.asarray(light.sum(1))], 1)
    np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())


def test_a_distilled_field_shows_its_teacher_and_nothing_else_changes(scene, learnt):
    after, _ = learnt
    report = after.features.head("colour").report
    assert report["used"]["relative_error"] < 0.15 and report["used"]["cosine"] > 0.97
    assert report["held_out"]["cosine"] > 0.95
    assert report["stored_change"] < 0.02
    assert after.static is scene.static and after.dynamic is scene.dynamic and after.scaffold is scene.scaffold
    before, now = (render(s, s.cameras[3], 3.0, ("rgb",), "torch")["rgb"] for s in (scene, after))
    np.testing.assert_array_equal(before, now)


def test_rendered_latent_decodes_to_the_teacher(learnt):
    """The way every reader goes: composite latents at full size, divide by alpha, shrink, decode."""
    after, maps = learnt
    shown = render(after, after.cameras[2], 2.0, ("latent", "alpha"), "torch")  # a held-out frame
    latent, alpha = to_grid(torch.from_numpy(shown["latent"]), torch.from_numpy(shown["alpha"]), maps.spec)
    seen = alpha.numpy() > 0.5
    found = after.features.decode("colour", latent.numpy())[seen]
    wanted = maps.at(2)[seen]
    assert seen.mean() > 0.3
    assert np.abs(found - wanted).mean() < 0.2 * np.abs(wanted).mean()


@pytest.mark.parametrize(("keep", "drift"), [(float("inf"), 1e-6), (1.0, 0.05)])
def test_a_new_head_leaves_the_old_one_within_its_stated_drift(learnt, keep, drift):
    after, _ = learnt
    more = maps_of(after, "second", 20, (7, 9), seed=8)
    both = distil(after, [more], dataclasses.replace(CONFIG, width=None, keep=keep))
    assert both.features.names == ("colour", "second")
    assert both.features.head("colour").report["drift"] < drift
    assert both.features.head("second").report["used"]["relative_error"] < 0.25
    for t in (0, 2):
        shown = [render(s, s.cameras[t], float(t), ("head:colour",), "torch")["head:colour"] for s in (after, both)]
        assert np.abs(shown[1] - shown[0]).mean() <= 2 * drift * np.abs(shown[0]).mean()


def test_the_same_seed_gives_the_same_field(scene):
    config = dataclasses.replace(CONFIG, steps=5)
    maps = maps_of(scene)
    first, second = (distil(scene, [maps], config).features for _ in range(2))
    for name, array in first.to_arrays().items():
        np.testing.assert_array_equal(array, second.to_arrays()[name])


def test_features_reach_skinning_only_by_the_flag(scene):
    maps = maps_of(scene)
    config = dataclasses.replace(CONFIG, steps=10, feature_grad_to_skinning=True)
    moved = distil(scene, [maps], config)
    assert np.abs(moved.dynamic.weight - scene.dynamic.weight).max() > 1e-3
    np.testing.assert_allclose(moved.dynamic.weight.sum(1), 1, atol=1e-5)


@pytest.mark.parametrize("static", [40, 0])
def test_static_and_empty_scenes(static):
    scene = random_scene(static=static, dynamic=0)
    if static == 0:
        scene = dataclasses.replace(scene, static=StaticSet.empty(), dynamic=DynamicSet.empty())
    spec = FeatureSpec("x", 6, (4, 5))
    stored = np.random.default_rng(0).normal(size=(6, 4, 5, 6)).astype(np.float16)
    after = distil(scene, [FeatureMaps(Path("x"), spec, stored)], dataclasses.replace(CONFIG, steps=3))
    assert after.latents().shape == (static, 8)
    assert np.isfinite(after.features.decode("x", np.zeros((2, 8), np.float32))).all()


def test_a_latent_may_be_as_wide_as_the_features_of_its_teachers(scene):
    field = distil(scene, [maps_of(scene)], dataclasses.replace(CONFIG, width=512, steps=2)).features
    assert field.width == 512 and field.decode(field.names[0], np.zeros(512, np.float32)).shape == (
        field.heads[0].spec.dim,
    )


def test_what_cannot_be_distilled_is_told_in_one_sentence(scene, learnt):
    maps = maps_of(scene)
    with pytest.raises(F4xError, match="nothing to distil"):
        distil(scene, [], CONFIG)
    with pytest.raises(F4xError, match="called the same"):
        distil(scene, [maps, maps], CONFIG)
    with pytest.raises(F4xError, match="maps of 2 frames, the scene has 6"):
        distil(scene, [dataclasses.replace(maps, stored=maps.stored[:2])], CONFIG)
    with pytest.raises(F4xError, match="--width 13"):
        distil(scene, [maps], dataclasses.replace(CONFIG, width=13))
    with pytest.raises(F4xError, match="read 8 channels"):
        distil(learnt[0], [maps_of(scene, "other")], dataclasses.replace(CONFIG, width=16))


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space")
def test_maps_beyond_memory_are_one_sentence(tmp_path):
    folder = tmp_path / "features" / "precomputed"
    folder.mkdir(parents=True)
    (folder / "spec.json").write_text(json.dumps(FeatureSpec("huge", 8, (3000, 3000)).to_json()))
    with (folder / "maps.npy").open("wb") as file:  # 864 MB, of which none is written
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f2", "fortran_order": False, "shape": (6, 3000, 3000, 8)}
        )
        file.truncate(file.tell() + 6 * 3000 * 3000 * 8 * 2)
    write_scene(labelled_scene(features=False), tmp_path / "scene.f4x")
    program = f"""
import resource, sys
import cv2, torch, scipy.sparse
from f4x_core.cli.main import main
import f4x_core.cli.distilling
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 1_000_000_000,) * 2)
sys.exit(main(["distill", r"{tmp_path / "scene.f4x"}", "--teacher", "precomputed", "--threads", "1"]))
"""
    command, root = [sys.executable, "-c", program], Path(__file__).resolve().parents[2]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True)
    *_, output = result.stderr.splitlines()
    assert result.returncode == 2, result.stderr
    assert output.startswith("f4x distill: Distilling maps of 3000 x 3000 x 8 does not fit in memory")


def test_cancelling_passes_through(scene):
    def stop(stage, done, total, message=""):
        if stage == "distil" and done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        distil(scene, [maps_of(scene)], CONFIG, stop)
