"""Losses of the fit against their formulas, written out."""

import math

import numpy as np
import pytest
import torch

from f4x_core.fit.losses import depth_loss, masked_l1, psnr, rgb_loss, ssim, ssim_map


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


def test_unknown_depth_says_nothing_and_little_confidence_is_not_blown_up():
    """Unknown: NaN, infinite, zero and negative. The mean divides by at least one pixel's worth of confidence."""
    depth, alpha = torch.full((1, 5), 2.0), torch.ones(1, 5)
    prior = torch.tensor([[torch.nan, torch.inf, 0.0, -3.0, 4.0]])
    assert float(depth_loss(depth, alpha, prior, torch.full((1, 5), 2.0))) == pytest.approx(1 / 2 - 1 / 4)
    assert float(depth_loss(depth, alpha, prior, torch.full((1, 5), 0.1))) == pytest.approx(0.1 * (1 / 2 - 1 / 4))


def test_an_empty_pixel_has_a_bounded_inverse_depth_and_gradient():
    depth, alpha = (torch.tensor([[value]], requires_grad=True) for value in (1e-5, 0.01))
    loss = depth_loss(depth, alpha, torch.full((1, 1), 2.0), torch.ones(1, 1))
    assert float(loss.detach()) == pytest.approx(0.01 / 1e-3 - 0.5)
    loss.backward()
    assert depth.grad.item() == 0 and alpha.grad.item() == pytest.approx(1000)


def ssim_written_out(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(H,W) SSIM of two grey images in [0,1], a window of 11 x 11 at each pixel, black outside."""
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    x, y = np.pad(x, 5), np.pad(y, 5)
    found = np.zeros((len(x) - 10, x.shape[1] - 10))
    for r in range(found.shape[0]):
        for c in range(found.shape[1]):
            a, b = x[r : r + 11, c : c + 11], y[r : r + 11, c : c + 11]
            ma, mb = (window * a).sum(), (window * b).sum()
            va, vb = (window * a * a).sum() - ma**2, (window * b * b).sum() - mb**2
            both = (window * a * b).sum() - ma * mb
            found[r, c] = (2 * ma * mb + 1e-4) * (2 * both + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    return found


def test_the_picture_loss_is_l1_over_channels_plus_weighed_dissimilarity():
    """Written out pixel by pixel, with weights that vary, borders included."""
    rng = np.random.default_rng(3)
    image, target, weight = rng.random((9, 13, 3)), rng.random((9, 13, 3)), rng.uniform(0.5, 3, (9, 13))
    image = 0.7 * target + 0.3 * image
    similar = np.stack([ssim_written_out(image[..., c], target[..., c]) for c in range(3)])
    total = l1 = unlike = 0.0
    for r in range(9):
        for c in range(13):
            l1 += weight[r, c] * sum(abs(image[r, c, k] - target[r, c, k]) for k in range(3))
            unlike += weight[r, c] * (1 - similar[:, r, c].mean())
            total += weight[r, c]
    tensors = [torch.from_numpy(a) for a in (image, target, weight)]
    np.testing.assert_allclose(ssim_map(*tensors[:2]), similar, rtol=1e-9)
    assert ssim(*tensors[:2]) == pytest.approx(similar.mean(), rel=1e-9)
    for part in (0.0, 0.3, 2.0):
        assert float(rgb_loss(*tensors, part)) == pytest.approx((l1 + part * unlike) / total, rel=1e-9)
    assert float(rgb_loss(tensors[0], tensors[1], torch.zeros(9, 13).double(), 0.3)) == 0
