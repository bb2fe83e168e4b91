"""Harmonics are added where, and only where, views from elsewhere become right by them."""

import dataclasses

import numpy as np
import pytest
import torch
from toy import clip_and_priors

from f4x_core.fit.config import profile
from f4x_core.fit.harmonics import GAIN_DB, next_band
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.gaussians import SetOptimiser
from f4x_core.geometry import quaternion
from f4x_core.geometry.spherical_harmonics import C0, basis

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
    stage = stage_of(clip, priors, most_sh_degree=most)
    stage.run()
    row = finish_fit(stage).scene.needs[0]
    assert row["what"] == "view-dependent colour" and expected in row["evidence"]
    assert len(stage.band_gains) == most
