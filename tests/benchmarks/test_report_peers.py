"""Peers of the rasteriser: one that is there is measured beside ours, one that is not is named with its reason."""

import os
import sys
import types

import pytest
import torch

from benchmarks.catalogue import choose
from benchmarks.runner import run_studies
from benchmarks.studies import peers, raster_curves
from benchmarks.study import Context
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.quaternion import to_matrix
from f4x_core.geometry.splats import Splats
from f4x_core.raster import RasterConfig
from f4x_core.raster.reference import project_ewa

NAMES = ("gsplat", "torch-splatting", "OpenSplat")


class _TorchReference(types.ModuleType):
    """The three functions of gsplat's torch reference that are called, with its shapes, for one image."""

    def _quat_scale_to_covar_preci(self, quats, scales, compute_covar=True, compute_preci=True, triu=False):
        assert compute_covar and not compute_preci and not triu
        self.shape = quats, scales
        half = to_matrix(quats) * scales[:, None]
        return half @ half.mT, None

    def _fully_fused_projection(self, means, covars, viewmats, Ks, width, height, eps2d=0.3, near_plane=0.01):
        assert covars.shape == (len(means), 3, 3) and viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3)
        config = RasterConfig(blur=eps2d, near=near_plane)
        mean2d, covariance, depth = project_ewa(
            Splats(means, *self.shape, None), Camera(Ks[0], viewmats[0], width, height), config
        )
        conic = torch.linalg.inv(covariance).flatten(1)[:, [0, 1, 3]]
        radii = torch.full((1, len(means), 2), max(width, height), dtype=torch.int32)
        return radii, mean2d[None], depth[None], conic[None], None

    def accumulate(self, means2d, conics, opacities, colors, gaussian_ids, pixel_ids, image_ids, width, height):
        from nerfacc import accumulate_along_rays, render_weight_from_alpha

        assert not image_ids.any() and (pixel_ids.diff() >= 0).all()
        pixel = torch.stack((pixel_ids % width, pixel_ids // width), 1) + 0.5
        dx, dy = (pixel - means2d[0, gaussian_ids]).unbind(1)
        a, b, c = conics[0, gaussian_ids].unbind(1)
        alpha = opacities[0, gaussian_ids] * torch.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        rays = {"ray_indices": pixel_ids, "n_rays": width * height}
        weights, _ = render_weight_from_alpha(alpha.clamp_max(0.999), **rays)
        image = accumulate_along_rays(weights, colors[0, gaussian_ids], **rays)
        light = accumulate_along_rays(weights, None, **rays)
        return image.view(1, height, width, -1), light.view(1, height, width, 1)


@pytest.fixture
def install(monkeypatch):
    """Puts a stand-in of gsplat, of this version, in the place of whatever is installed; None, and other peers: absent."""

    def install(version):
        package = None
        if version:
            package = types.ModuleType("gsplat")
            package.__version__ = version
        monkeypatch.setitem(sys.modules, "gsplat", package)
        monkeypatch.setitem(
            sys.modules, "gsplat.cuda._torch_impl", version and _TorchReference("gsplat.cuda._torch_impl")
        )

    monkeypatch.setitem(sys.modules, "gaussian_splatting", None)
    monkeypatch.setenv("PATH", "")
    return install


@pytest.fixture
def study(monkeypatch, tmp_path):
    """Measures a study of a tiny scene."""
    monkeypatch.setattr(Context, "repeats", property(lambda _: 2))
    monkeypatch.setattr(raster_curves, "SIZES", ({"count": 60, "width": 24, "height": 18}, None))
    size = {"count": 60, "channels": 3, "width": 24, "height": 18}
    monkeypatch.setattr(raster_curves, "REFERENCE_SIZES", (size, None))
    monkeypatch.setattr(raster_curves, "measure_thread_ceiling", lambda: 1.0)
    monkeypatch.setattr(raster_curves, "STEPS", (1e-4,))
    return lambda name: run_studies(choose([name]), tmp_path, Context(tmp_path, quick=True))["studies"][name]


def test_a_peer_that_is_there_is_measured_beside_ours(install, study):
    install("1.5.9")
    found = study("raster-backends")
    rows = {row["name"]: row for row in found["tables"][0]["rows"]}
    double, single = (rows[f"gsplat 1.5.9 (peer), {precision}"] for precision in ("float64", "float32"))
    assert double["backend"] == "gsplat 1.5.9 (peer)"
    assert all(row[column] > 0 for row in (double, single) for column in raster_curves.TIMED)
    rmse, worst = raster_curves.RMSE, raster_curves.WORST
    assert 0 < double[rmse] < 1e-14 < single[rmse] < 1e-5 and 0 < double[worst] < 1e-12 < single[worst] < 1e-4
    assert not any("gsplat" in sentence for sentence in found["skipped"])
    reported = [sentence for sentence in found["words"] if sentence.startswith("gsplat 1.5.9 (peer)")]
    assert len(reported) == 2 and all("times as long as torch" in sentence for sentence in reported)
    assert "clamp of alpha" in found["tables"][0]["note"]

    gradients = study("raster-gradients")["tables"][0]
    errors = [row["relative L2 error"] for row in gradients["rows"] if row["name"] == double["name"]]
    assert len(errors) == len(raster_curves.GRADIENTS) and 0 < max(errors) < 1e-12


def test_a_peer_is_compared_under_its_own_clamp(install):
    install("1.5.9")
    scene = raster_curves.make_wavy_scene(60, 3, 24, 18)
    scene["opacities"] = torch.full_like(scene["opacities"], 1.0)
    peer = next(way for way in raster_curves.find_ways(1)[0] if way.peer)
    ours = raster_curves.Way("reference", "float64")
    own, other = raster_curves.reference_answers([peer, ours], scene)
    found = peer.answer(scene)
    assert found.minus(own)["image_max"] < 1e-12 < 1e-4 < found.minus(other)["image_max"]


def test_an_error_of_a_peer_is_told_and_fails_nothing(install, study, monkeypatch):
    install("1.5.9")
    right = _TorchReference.accumulate
    monkeypatch.setattr(_TorchReference, "accumulate", lambda *a: tuple(0.5 * image for image in right(*a)))
    found = study("raster-backends")
    row = next(row for row in found["tables"][0]["rows"] if row["name"] == "gsplat 1.5.9 (peer), float64")
    assert row[raster_curves.RMSE] > 0.01 and not found["failed"]


def test_peers_that_are_absent_are_named(install, study):
    install(None)
    found = study("raster-backends")
    assert not any("peer" in row["name"] for row in found["tables"][0]["rows"])
    named = [sentence for sentence in found["skipped"] if sentence.startswith(NAMES)]
    assert named == [
        "gsplat: not installed (no module gsplat).",
        "torch-splatting: not installed (no module gaussian_splatting.gauss_render).",
        "OpenSplat: not installed (no program opensplat on the PATH).",
    ]


def test_peers_that_are_there_and_cannot_be_measured_say_why(install, monkeypatch, tmp_path):
    install("1.4.0")
    checkout = tmp_path / "gaussian_splatting"
    checkout.mkdir()
    (checkout / "gauss_render.py").touch()
    monkeypatch.delitem(sys.modules, "gaussian_splatting")
    monkeypatch.syspath_prepend(tmp_path)
    program = tmp_path / ("opensplat.exe" if os.name == "nt" else "opensplat")
    program.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    found, sentences = peers.find_peers()
    assert not found
    for name, words in zip(NAMES, ("1.4.0: only", "on a CUDA device", f"{program} trains"), strict=True):
        assert next(words in sentence for sentence in sentences if sentence.startswith(name))


def test_a_peer_that_cannot_be_imported_says_so(install, monkeypatch):
    install("1.5.9")
    monkeypatch.setitem(sys.modules, "gsplat.cuda._torch_impl", None)
    found, sentences = peers.find_peers()
    assert not found and sentences[0].startswith("gsplat: cannot be imported (")


def test_an_installed_nerfacc_is_put_back(monkeypatch):
    for module in (types.ModuleType("nerfacc"), None):
        monkeypatch.setitem(sys.modules, "nerfacc", module) if module else monkeypatch.delitem(sys.modules, "nerfacc")
        with peers._nerfacc_in_torch():
            assert sys.modules["nerfacc"] not in (module, None)
        assert sys.modules.get("nerfacc") is module
