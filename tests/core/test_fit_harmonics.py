"""Harmonics are added where, and only where, views from elsewhere become right by them."""

import dataclasses

import numpy as np
import pytest
import torch
from toy import clip_and_priors

from f4x_core.fit.config import profile
from f4x_core.fit.harmonics import GAIN_DB, next_band
from f4x_core.fit.model import SceneModel
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.gaussians import SetOptimiser, SpawnConfig, Spawned, spawn_static
from f4x_core.gaussians.camera_rig import CameraRig
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.spherical_harmonics import C0, basis
from f4x_core.raster import RasterConfig

FRAMES = 12


pytestmark = pytest.mark.usefixtures("one_thread")


def stage_of(clip, priors, **changes):
    config = dataclasses.replace(profile("quick"), steps=40, measure_every=40, threads=1, backend="torch", **changes)
    return start_fit(clip, priors, config)


@pytest.fixture(scope="module")
def shiny():
    """(stage with plain colours, pictures (F,H,W,3) uint8 of the same Gaussians whose colours change with the view)."""
    stage = stage_of(*clip_and_priors(FRAMES, moving=False))
    static = stage.model.static
    plain = dict(static.parameters)
    x, y, _ = (xyz := static.parameters["means"].detach()).T  # light mixes Gaussians, so neighbours shine alike
    looks = torch.stack([torch.sin(3 * x), torch.cos(2 * y), torch.sin(2 * x - y)], -1)
    slopes = looks[:, :, None] * torch.tensor([1.0, -0.5, 0.8])
    middle = xyz - torch.tensor([0.01 * (FRAMES - 1), 0, 0])  # seen from there, colours are the plain ones
    own = quaternion.rotate(quaternion.conjugate(quaternion.normalize(static.parameters["quats"].detach())), middle)
    there = (basis(own, 1)[:, 1:, None] * slopes).sum(1, keepdim=True)
    static.parameters |= {"shN": slopes, "sh0": plain["sh0"].detach() - there / C0}
    pictures = torch.stack([255 * stage.picture(frame) for frame in range(FRAMES)]).round().byte()
    static.parameters = plain
    return stage, pictures


def error(stage, pictures, frames):
    return float(np.mean([(stage.picture(f) - pictures[f].float() / 255).square().mean() for f in frames]))


def test_colours_that_change_with_the_view_are_found_and_added(shiny):
    stage, pictures = shiny
    optimiser = SetOptimiser(stage.model.static, {name: 0.01 for name in stage.model.static.parameters})
    band = next_band(stage.model, pictures, stage.raster, "torch")
    assert band.gain > 3
    ends = [0, 1, 2, FRAMES - 3, FRAMES - 2, FRAMES - 1]  # left out
    before = error(stage, pictures, ends)
    optimiser.add_band(band.plain, band.more)
    assert stage.model.static.sh.shape[1] == 4
    assert 10 * np.log10(before / error(stage, pictures, ends)) > 0.9 * band.gain


WIDTH, HEIGHT = 30, 20


def some_large_gaussians(frames: int) -> SceneModel:
    """Five, one of them out of sight and one that lights less than a pixel, and cameras that pass them."""
    xyz = np.array([[-0.3, 0, 2], [0.1, 0.1, 2.4], [0.4, -0.2, 2.2], [0, -0.1, 3], [0, 0, -5]], np.float32)
    rng = np.random.default_rng(0)
    colour = rng.uniform(0.2, 0.8, (5, 3)).astype(np.float32)
    static = spawn_static(Spawned(xyz, colour, np.full(5, 0.15, np.float32), np.ones(5, np.float32)), 0, SpawnConfig())
    with torch.no_grad():
        static.parameters["quats"].copy_(torch.from_numpy(rng.normal(size=(5, 4))))
        static.parameters["log_scales"][1] = np.log(0.004)
        static.parameters["opacity_logits"][1] = -1.5
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[:, 0, 3] = np.linspace(-1, 1, frames)
    intrinsics = np.tile(np.array([[25.0, 0, 15], [0, 25, 10], [0, 0, 1]]), (frames, 1, 1))
    path = CameraPath(intrinsics, matrices, np.arange(float(frames)), WIDTH, HEIGHT)
    return SceneModel(static, None, None, CameraRig(path), "sigma")


@pytest.mark.parametrize(("frames", "noise"), [(9, 0.2), (9, 0.0), (40, 0.2)])
def test_a_band_is_the_ridge_regression_of_what_is_left_on_the_directions(frames, noise):
    """Gaussian by Gaussian in float64: y = mean rest under its light, weighed by that light but by no more than one pixel."""
    model, rng = some_large_gaussians(frames), np.random.default_rng(1)
    chosen = sorted({round(i * (frames - 1) / 15) for i in range(16)})
    quarter = len(chosen) // 4
    middle, ends = chosen[quarter:-quarter], chosen[:quarter] + chosen[-quarter:]
    part, drawn, terms = {}, {}, {}
    for frame in chosen:
        posed = model.posed(None)
        camera = model.rig.camera(frame, WIDTH, HEIGHT)
        with torch.no_grad():
            out = model.render(posed, camera, extra=torch.eye(5), backend="torch").channels.double().numpy()
        drawn[frame], part[frame] = out[..., :3].clip(0, 1), out[..., 3:]
        centre = -model.rig.view(frame)[:3, 3].detach()  # the cameras do not turn
        own = quaternion.rotate(quaternion.conjugate(quaternion.normalize(posed.quats)), posed.means - centre).detach()
        unit = own.double().numpy() / np.linalg.norm(own.numpy(), axis=1, keepdims=True)
        first = np.sqrt(3 / (4 * np.pi))
        terms[frame] = np.column_stack([np.ones(5), -first * unit[:, 1], first * unit[:, 2], -first * unit[:, 0]])
    slopes = rng.normal(size=(5, 4, 3))
    pictures = np.zeros((frames, HEIGHT, WIDTH, 3), np.uint8)
    for frame in chosen:
        more = np.einsum("hwn,nt,ntc->hwc", part[frame], terms[frame], 0.1 * slopes)
        more = drawn[frame] + more + noise * rng.normal(size=more.shape)
        pictures[frame] = (255 * more).clip(0, 255).round()
    rest = {frame: pictures[frame] / 255 - drawn[frame] for frame in chosen}

    variance = max(float(np.mean([rest[frame] ** 2 for frame in middle])), 1e-6)
    plain, found = np.zeros((5, 3)), np.zeros((5, 4, 3))
    for i in range(5):
        normal, wanted = np.zeros((4, 4)), np.zeros((4, 3))
        for frame in middle:
            light = part[frame][..., i]
            scale = max(light.sum(), 1)
            row = terms[frame][i]
            normal += light.sum() / scale * np.outer(row, row)
            wanted += np.outer(row, np.einsum("hw,hwc->c", light, rest[frame]) / scale)
        plain[i] = wanted[0] / (normal[0, 0] + 1e-3)
        ridge = [1e-3, *3 * [variance / 0.2**2]]
        found[i] = np.linalg.solve(normal + np.diag(ridge), wanted)
    before = after = 0.0
    for frame in ends:
        constant = np.einsum("hwn,nc->hwc", part[frame], plain)
        whole = np.einsum("hwn,nt,ntc->hwc", part[frame], terms[frame], found)
        before += ((rest[frame] - constant) ** 2).mean()
        after += ((rest[frame] - whole) ** 2).mean()

    band = next_band(model, torch.from_numpy(pictures), RasterConfig(threads=1), "torch")
    y00 = 0.5 / np.sqrt(np.pi)
    np.testing.assert_allclose(band.plain[:, 0] * y00, found[:, 0], atol=1e-3)
    np.testing.assert_allclose(band.more, found[:, 1:], atol=1e-3)
    assert band.gain == pytest.approx(10 * np.log10(before / after), abs=0.01)
    assert not band.more[4].any(), "nothing is known of what no frame sees"


def test_pictures_that_are_right_already_and_noise_ask_for_nothing():
    stage = stage_of(*clip_and_priors(FRAMES, moving=False))
    drawn = torch.stack([255 * stage.picture(frame) for frame in range(FRAMES)])
    assert next_band(stage.model, drawn.round().byte(), stage.raster, "torch").gain < GAIN_DB
    noise = 20 * torch.randn(drawn.shape, generator=torch.Generator().manual_seed(1))
    noisy = (drawn + noise).clamp(0, 255).round().byte()
    assert next_band(stage.model, noisy, stage.raster, "torch").gain < GAIN_DB


def test_a_change_of_light_over_a_short_path_is_not_taken_for_a_steep_slope():
    """A slope that explains it within a few degrees is white fog when the thing is seen from 20 degrees aside."""
    stage = stage_of(*clip_and_priors(FRAMES, moving=False))
    drawn = torch.stack([255 * stage.picture(frame) for frame in range(FRAMES)])
    brighter = torch.linspace(0.9, 1.1, FRAMES)[:, None, None, None]
    band = next_band(stage.model, (drawn * brighter).clamp(0, 255).round().byte(), stage.raster, "torch")
    assert band.more.abs().quantile(0.99) < 0.5


@pytest.mark.parametrize("backend", ["auto", "reference"])
def test_backends_agree(backend):
    clip, priors = clip_and_priors(4, moving=True)
    stage = stage_of(clip, priors)
    bands = [next_band(stage.model, stage.levels[0].rgb, stage.raster, name) for name in ("torch", backend)]
    assert bands[1].gain == pytest.approx(bands[0].gain, abs=1e-3)
    assert torch.allclose(bands[1].more, bands[0].more, atol=1e-3)
    assert len(bands[0].more) == len(stage.model), "both sets"


def test_a_frame_alone_is_no_evidence():
    stage = stage_of(*clip_and_priors(3, moving=False))
    assert next_band(stage.model, stage.levels[0].rgb, stage.raster, "torch").gain < GAIN_DB


def test_moments_stay_with_their_coefficients():
    static = stage_of(*clip_and_priors(3, moving=False)).model.static
    optimiser = SetOptimiser(static, {name: 0.01 for name in static.parameters})
    first = torch.full((len(static), 3, 3), 0.2)
    optimiser.add_band(torch.zeros(len(static), 1, 3), first)
    static.sh.square().sum().backward()
    optimiser.step()
    moved = static.parameters["shN"].detach().clone()
    moment = optimiser.adam.state[static.parameters["shN"]]["exp_avg"].clone()
    optimiser.add_band(torch.zeros(len(static), 1, 3), torch.ones(len(static), 5, 3))
    rest = static.parameters["shN"]
    assert rest.requires_grad and rest.shape == (len(static), 8, 3)
    assert torch.equal(rest[:, :3], moved) and (rest[:, 3:] == 1).all()
    widened = optimiser.adam.state[rest]["exp_avg"]
    assert torch.equal(widened[:, :3], moment) and (widened[:, 3:] == 0).all()


@pytest.mark.parametrize(("most", "expected"), [(0, "no higher one"), (1, "wanted")])
def test_the_row_says_what_decided(most, expected):
    clip, priors = clip_and_priors(6, moving=False)
    stage = stage_of(clip, priors, max_sh_degree=most)
    stage.run()
    row = finish_fit(stage).scene.needs[0]
    assert row["what"] == "view-dependent colour" and expected in row["evidence"]
    assert len(stage.band_gains) == most
