"""Losses of the fit against their formulas, written out."""

import math

import pytest
import torch

from f4x_core.fit.losses import depth_loss, masked_l1, psnr


@pytest.fixture
def maps():
    """Depths and alphas (4,5) of half-covered pixels, float64."""
    rng = torch.Generator().manual_seed(0)
    z = 1 + 3 * torch.rand(4, 5, generator=rng, dtype=torch.float64)
    alpha = 0.2 + 0.7 * torch.rand(4, 5, generator=rng, dtype=torch.float64)
    return z, alpha


def test_a_half_covered_pixel_has_the_depth_of_what_covers_it(maps):
    z, alpha = maps
    assert float(depth_loss(alpha * z, alpha, z, torch.ones_like(z))) == pytest.approx(0, abs=1e-12)


def test_depth_is_compared_as_inverse_depth_and_weighed_by_confidence(maps):
    z, alpha = maps
    confidence = torch.linspace(0, 1, z.numel(), dtype=torch.float64).view_as(z)
    prior = z.flip(0).clone()
    prior[0, 0] = torch.nan
    expected = (1 / z - 1 / prior).abs() * confidence
    total = confidence.sum() - confidence[0, 0]
    found = depth_loss(alpha * z, alpha, prior, confidence)
    assert float(found) == pytest.approx(float(expected.nansum() / total), rel=1e-12)


def test_psnr_of_a_known_error():
    image = torch.zeros(6, 7, 3)
    assert psnr(image, image + 0.1) == pytest.approx(20, abs=1e-4)
    weight = torch.zeros(6, 7)
    assert math.isnan(psnr(image, image, weight))
    weight[:3] = 1
    far = image.clone()
    far[3:] = 1
    assert psnr(image + 0.01, far, weight) == pytest.approx(40, abs=1e-4)


def test_masked_l1_sums_channels_and_averages_over_the_mask():
    image, target, weight = torch.zeros(2, 2, 3), torch.ones(2, 2, 3), torch.tensor([[1.0, 0.0], [0.5, 0.0]])
    target[0, 1] = 9
    assert float(masked_l1(image, target, weight)) == pytest.approx(3)
