"""The compiled colours and picture loss against their plain torch forms in float64."""

import pytest
import torch

from f4x_core.fit.frame_native import FrameMaps
from f4x_core.fit.losses import FrameFactors, depth_loss, depth_roughness, frame_losses, masked_l1, rgb_loss
from f4x_core.gaussians import appearance
from f4x_core.metrics.pictures import ssim_map
from f4x_core.native.kernels import Kernels

pytestmark = pytest.mark.usefixtures("native_library")


def relative(got: torch.Tensor, expected: torch.Tensor) -> float:
    return float((got.detach().double() - expected.detach()).norm() / expected.detach().norm().clamp_min(1e-12))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 7, 3001])
@pytest.mark.parametrize("threads", [1, 3])
def test_colours_and_gradients_are_those_of_the_formula(degree, count, threads):
    generator = torch.Generator().manual_seed(degree)
    sh = 0.4 * torch.randn(count, (degree + 1) ** 2, 3, generator=generator)
    means, quats = torch.randn(count, 3, generator=generator), 3 * torch.randn(count, 4, generator=generator)
    centre, sent = torch.tensor([0.2, -0.1, -4.0]), torch.randn(count, 3, generator=generator)
    fast = [t.clone().requires_grad_() for t in (sh, means, quats)]
    plain = [t.double().requires_grad_() for t in (sh, means, quats)]
    colours, expected = appearance(*fast, centre, Kernels(True, threads)), appearance(*plain, centre.double())
    assert relative(colours, expected) < 1e-6
    got = torch.autograd.grad(colours, fast, sent)
    wanted = torch.autograd.grad(expected, plain, sent.double(), allow_unused=True)
    for g, w in zip(got, wanted, strict=True):
        assert relative(g, torch.zeros_like(g).double() if w is None else w) < 5e-6


@pytest.mark.parametrize(("degree", "native"), [(0, True), (3, True), (4, False)])
def test_up_to_degree_three_colours_come_from_the_compiled_library(degree, native):
    """Torch's colours have a gradient of the centre, the library's have none."""
    generator = torch.Generator().manual_seed(degree)
    sh = 0.4 * torch.randn(5, (degree + 1) ** 2, 3, generator=generator)
    means, quats = torch.randn(5, 3, generator=generator), torch.randn(5, 4, generator=generator)
    centre = torch.tensor([0.2, -0.1, -4.0]).requires_grad_()
    colours = appearance(sh, means, quats, centre, Kernels(True))
    torch.testing.assert_close(colours, appearance(sh, means, quats, centre))
    (gradient,) = torch.autograd.grad(colours.sum(), centre, allow_unused=True)
    assert (gradient is None) == native


def test_a_gaussian_without_direction_or_orientation_keeps_finite_gradients():
    sh, means, quats = torch.rand(9, 4, 3), torch.randn(9, 3), torch.randn(9, 4)
    centre = means[2].clone()  # the camera sits on this one
    quats[5] = 0
    leaves = [t.requires_grad_() for t in (sh, means, quats)]
    colours = appearance(*leaves, centre, Kernels(True))
    assert torch.allclose(colours[2], sh[2, 0] * 0.28209479 + 0.5)
    turned = torch.tensor([1.0, 0, 0, 0]).expand(9, 4)
    assert torch.allclose(colours[5], appearance(sh, means, turned, centre)[5], atol=1e-6)
    assert all(g.isfinite().all() for g in torch.autograd.grad(colours.sum(), leaves))


@pytest.mark.parametrize(("height", "width"), [(40, 61), (5, 7), (1, 1), (33, 8), (11, 200)])
@pytest.mark.parametrize("threads", [1, 3])
def test_the_picture_loss_is_that_of_the_formula(height, width, threads):
    generator = torch.Generator().manual_seed(height)
    wide = torch.rand(height, width, 7, generator=generator)  # the picture is a slice of all rendered channels
    target, weight = torch.rand(height, width, 3, generator=generator), torch.rand(height, width, generator=generator)
    fast, plain = wide.clone().requires_grad_(), wide.double().requires_grad_()
    loss = rgb_loss(fast[..., :3], target, weight, 0.3, Kernels(True, threads))
    expected = rgb_loss(plain[..., :3], target.double(), weight.double(), 0.3)
    assert float(loss.detach()) == pytest.approx(float(expected.detach()), rel=2e-6)
    assert relative(torch.autograd.grad(loss, fast)[0], torch.autograd.grad(expected, plain)[0]) < 1e-5


def losses_written_out(channels, depth, alpha, maps, factors):
    """The sum that `frame_losses` makes, by the plain form of each loss."""
    target, motion, confidence = maps.frame.to(channels) / 255, maps.motion.to(channels), maps.confidence.to(channels)
    attention, unsure = 1 + (factors.moving - 1) * motion, (1 - confidence) * (1 - motion)
    loss = rgb_loss(channels[..., :3], target, attention, factors.ssim)
    loss = loss + factors.depth * depth_loss(depth, alpha, maps.prior.to(channels), confidence)
    if factors.roughness:
        loss = loss + factors.roughness * depth_roughness(depth, alpha, target, unsure)
    if channels.shape[-1] > 3:
        error = (channels[..., 3] - (motion > 0.5).to(channels)).abs()
        loss = loss + factors.mask * (error * (2 * motion - 1).abs()).mean()
    return loss


def rendered_frame(height, width, count):
    """(channels, depth, alpha) and what supervises them: unknown depths, empty pixels, plain colours."""
    generator = torch.Generator().manual_seed(height)
    channels, alpha = (
        torch.rand(height, width, count, generator=generator),
        torch.rand(height, width, generator=generator),
    )
    depth = alpha * (0.5 + torch.rand(height, width, generator=generator))
    depth[0, :3] = 1e-5
    prior = 0.5 + torch.rand(height, width, generator=generator)
    prior[-1, :4] = torch.tensor([torch.nan, torch.inf, 0, -1])
    frame = (120 + 4 * torch.randn(height, width, 3, generator=generator)).byte()
    confidence, motion = torch.rand(2, height, width, generator=generator).half()
    return (channels, depth, alpha), FrameMaps(frame, prior, confidence, motion)


@pytest.mark.parametrize(("height", "width", "count"), [(40, 61, 4), (33, 140, 7), (9, 8, 3), (5, 7, 4), (137, 141, 4)])
@pytest.mark.parametrize("rough", [0.0, 2.0])
def test_the_losses_of_a_frame_in_one_go_are_those_of_their_formulas(height, width, count, rough):
    """137 x 141 pixels compare every second one; more than four channels belong to other losses."""
    rendered, maps = rendered_frame(height, width, count)
    factors = FrameFactors(ssim=0.3, moving=3.0, depth=0.4, roughness=rough, mask=0.2)
    fast, plain = ([each.to(dtype).requires_grad_() for each in rendered] for dtype in (torch.float32, torch.float64))
    fast = [each.clone().detach().requires_grad_() for each in fast]
    loss, expected = frame_losses(tuple(fast), maps, factors, 3), losses_written_out(*plain, maps, factors)
    assert float(loss.detach()) == pytest.approx(float(expected.detach()), rel=2e-6)
    got, wanted = torch.autograd.grad(3 * loss, fast), torch.autograd.grad(3 * expected, plain)
    for g, w in zip(got, wanted, strict=True):
        assert relative(g, w) < 5e-6
    again = [torch.autograd.grad(3 * frame_losses(tuple(fast), maps, factors, n), fast) for n in (1, 2)]
    assert all(torch.equal(a, b) for other in again for a, b in zip(got, other, strict=True))


def test_structure_alone_is_compared_closely():
    """Of nearly equal pictures: where SSIM is close to 1 its gradient is a small difference of large terms."""
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(32, 48, 3, generator=generator)
    image = (target + 0.02 * torch.randn(32, 48, 3, generator=generator)).requires_grad_()
    weight = torch.ones(32, 48)
    plain = image.detach().double().requires_grad_()
    got = rgb_loss(image, target, weight, 1.0, Kernels(True, 2)) - masked_l1(image, target, weight)
    expected = 1 - ssim_map(plain, target.double()).mean()
    assert float(got.detach()) == pytest.approx(float(expected.detach()), abs=1e-6)
    assert relative(torch.autograd.grad(got, image)[0], torch.autograd.grad(expected, plain)[0]) < 1e-4


def test_threads_do_not_change_a_bit():
    generator = torch.Generator().manual_seed(1)
    image, target = torch.rand(2, 50, 70, 3, generator=generator)
    weight = torch.rand(50, 70, generator=generator)
    results = []
    for threads in (1, 2, 5):
        leaf = image.clone().requires_grad_()
        loss = rgb_loss(leaf, target, weight, 0.3, Kernels(True, threads))
        results.append((loss.detach(), torch.autograd.grad(loss, leaf)[0]))
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))


def in_memory(layout: str, image: torch.Tensor) -> torch.Tensor:
    """`image (H,W,3)` as a part of something else."""
    height, width, _ = image.shape
    wide = torch.full((height + 1, width + 2, 7), 9.0)
    if layout == "channels of a wider picture":
        found = torch.full((height, width, 7), 9.0)[..., :3]
    elif layout == "columns of a wider picture":
        found = wide[:height, 1 : width + 1, :3]
    elif layout == "every other channel":
        found = wide[:height, :width, 1::2]
    elif layout == "channels first":
        found = torch.zeros(3, height, width).permute(1, 2, 0)
    else:
        found = torch.zeros(width, height, 3).transpose(0, 1)
    found.copy_(image)
    return found


@pytest.mark.parametrize(
    "layout",
    [
        "channels of a wider picture",
        "columns of a wider picture",
        "every other channel",
        "channels first",
        "columns first",
    ],
)
@pytest.mark.parametrize(("height", "width"), [(12, 17), (1, 5), (6, 6)])
def test_how_a_picture_lies_in_memory_changes_nothing(layout, height, width):
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(2, height, width, 3, generator=generator)
    weight = torch.rand(height, width, generator=generator)
    results = []
    for each in (image.clone(), in_memory(layout, image)):
        each.requires_grad_()
        loss = rgb_loss(each, target, weight, 0.3, Kernels(True, 2))
        results.append((loss.detach(), torch.autograd.grad(3 * loss, each)[0]))
    assert torch.equal(results[0][0], results[1][0]) and torch.equal(results[0][1], results[1][1])
    with torch.no_grad():
        assert torch.equal(rgb_loss(in_memory(layout, image), target, weight, 0.3, Kernels(True, 2)), results[0][0])
