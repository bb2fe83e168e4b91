"""Losses of the fit against their formulas, written out."""

import math

import numpy as np
import pytest
import torch

from f4x_core.fit.losses import depth_loss, depth_roughness, masked_l1, rgb_loss
from f4x_core.metrics.pictures import psnr, ssim, ssim_map


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


def roughness_by_loops(inverse, grey, unsure, step):
    """The mean bend of `inverse (H,W)`, pixel by pixel."""
    total, (height, width) = 0.0, inverse.shape
    for down, across in ((step, 0), (0, step)):
        bends = []
        for y in range(down, height - down):
            for x in range(across, width - across):
                places = [(y - down, x - across), (y, x), (y + down, x + across)]
                bend, texture = (abs(m[places[0]] - 2 * m[places[1]] + m[places[2]]) for m in (inverse, grey))
                bends.append(bend * math.exp(-texture / 0.04) * min(unsure[place] for place in places))
        total += sum(bends) / len(bends)
    return total


@pytest.mark.parametrize(("size", "step"), [((12, 17), 1), ((17, 12), 1), ((136, 140), 2)])
def test_depth_bends_count_where_pictures_are_plain_and_depth_unsure(size, step):
    rng = torch.Generator().manual_seed(1)
    depth, alpha, unsure = (0.2 + torch.rand(size, generator=rng, dtype=torch.float64) for _ in range(3))
    image = 0.5 + 0.02 * torch.randn(*size, 3, generator=rng, dtype=torch.float64)
    found = float(depth_roughness(depth, alpha, image, unsure))
    expected = roughness_by_loops((alpha / depth).numpy(), image.mean(-1).numpy(), unsure.numpy(), step)
    assert found == pytest.approx(expected, rel=1e-9) and found > 0.05


def test_planes_are_not_rough_and_neither_is_what_is_sure_or_moves():
    y, x = (torch.arange(n, dtype=torch.float64) for n in (20, 30))
    plane = 0.5 + 0.02 * x + 0.03 * y[:, None]
    image, unsure = torch.full((20, 30, 3), 0.5, dtype=torch.float64), torch.ones(20, 30, dtype=torch.float64)
    assert float(depth_roughness(1 / plane, torch.ones_like(plane), image, unsure)) < 1e-12
    bumpy = plane.clone()
    bumpy[10, 15] += 0.4
    assert float(depth_roughness(1 / bumpy, torch.ones_like(plane), image, unsure)) > 1e-3
    unsure[7:14, 12:19] = 0
    assert float(depth_roughness(1 / bumpy, torch.ones_like(plane), image, unsure)) < 1e-12


def test_the_gradient_of_roughness():
    rng = torch.Generator().manual_seed(2)
    depth, alpha, unsure = (0.5 + torch.rand(7, 9, generator=rng, dtype=torch.float64) for _ in range(3))
    image = torch.rand(7, 9, 3, generator=rng, dtype=torch.float64)
    depth.requires_grad_(), alpha.requires_grad_()
    assert torch.autograd.gradcheck(lambda d, a: depth_roughness(d, a, image, unsure), (depth, alpha))


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
