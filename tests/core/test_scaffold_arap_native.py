"""The compiled as-rigid-as-possible losses against the torch ones in float64: values, gradients, and poses that coincide."""

import numpy as np
import pytest
import torch

from f4x_core.geometry import quaternion
from f4x_core.native.kernels import TORCH, Kernels
from f4x_core.scaffold.graph import EdgeLevel
from f4x_core.scaffold.losses import ArapEdges, MotionTerms, arap_losses, motion_loss
from f4x_core.scaffold.motion_native import MotionWeights

pytestmark = pytest.mark.usefixtures("native_library")

SHIFTS, WEIGHTS = (1, 3, 9), (0.5, 0.3, 0.2)


def compiled(xyz, quat, edges, shifts=SHIFTS, weights=WEIGHTS):
    """The losses (coordinate, length) of poses, one at a time, by the library."""
    every = dict(zip(shifts, weights, strict=True))
    alone = MotionWeights(1, 0, 0, 0, 0, 0), MotionWeights(0, 1, 0, 0, 0, 0)
    times = torch.arange(len(xyz))
    return tuple(motion_loss(xyz, quat, times, MotionTerms(edges, every, one, Kernels(native=True))) for one in alone)


def both(xyz, quat, detach=True, factors=(1.3, 0.4)):
    """Losses and gradients of poses (F,M,…) in float64 by torch, and in float32 by the library."""
    nodes = xyz.shape[1]
    rng = np.random.default_rng(1)
    neighbours = np.stack([rng.permutation(nodes)[:4] for _ in range(nodes)])
    mask = rng.random(neighbours.shape) > 0.2
    level = EdgeLevel(np.arange(nodes), rng.permutation(nodes), 0.3)
    results = []
    for losses_of, dtype in ((arap_losses, torch.float64), (compiled, torch.float32)):
        x, q = (torch.tensor(array, dtype=dtype, requires_grad=True) for array in (xyz, quat))
        edges = ArapEdges.build(neighbours, mask, 1.0, [level], detach=detach, dtype=dtype)
        losses = torch.stack(losses_of(x, quaternion.normalize(q), edges, SHIFTS, WEIGHTS))
        (losses * torch.tensor(factors, dtype=dtype)).sum().backward()
        results.append([losses.detach().double(), x.grad.double(), q.grad.double()])
    return results


@pytest.mark.parametrize("frames", [2, 3, 4, 8, 9, 10, 11, 17, 24, 33])
@pytest.mark.parametrize("detach", [False, True])
def test_values_and_gradients_are_those_of_torch(frames, detach):
    rng = np.random.default_rng(frames)
    xyz = rng.normal(size=(1, 9, 3)) + 0.2 * rng.normal(size=(frames, 9, 3))
    expected, found = both(xyz, rng.normal(size=(frames, 9, 4)), detach)
    assert expected[0].min() > 1e-3
    for one, other in zip(expected, found, strict=True):
        torch.testing.assert_close(other, one, rtol=1e-5, atol=2e-6 * float(one.abs().max()))


@pytest.mark.parametrize("factors", [(1.0, 0.0), (0.0, 1.0)])
def test_each_loss_has_a_gradient_of_its_own(factors):
    rng = np.random.default_rng(3)
    expected, found = both(rng.normal(size=(12, 7, 3)), rng.normal(size=(12, 7, 4)), factors=factors)
    for one, other in zip(expected, found, strict=True):
        torch.testing.assert_close(other, one, rtol=1e-5, atol=2e-6 * max(float(one.abs().max()), 1.0))


def test_nodes_that_coincide_and_stand_still_have_no_gradient():
    _, (losses, xyz, quat) = both(np.zeros((10, 6, 3)), np.tile([1.0, 0, 0, 0], (10, 6, 1)))
    assert not losses.any() and not xyz.any() and not quat.any()
    still = np.tile(np.random.default_rng(0).normal(size=(1, 6, 3)), (10, 1, 1))
    _, (losses, xyz, quat) = both(still, np.tile([1.0, 0, 0, 0], (10, 6, 1)))
    assert not losses.any() and not xyz.any() and not quat.any()


def test_poses_of_any_layout_are_read():
    """A window of a larger tensor, positions that are every second node of another."""
    rng = np.random.default_rng(5)
    edges = ArapEdges.build(np.array([[0, 1], [1, 2], [2, 0]]), np.ones((3, 2), bool))
    wide = torch.tensor(rng.normal(size=(20, 6, 3)), dtype=torch.float32)
    quat = quaternion.normalize(torch.tensor(rng.normal(size=(20, 6, 4)), dtype=torch.float32))
    parts = wide[3:15, ::2], quat[3:15, ::2]
    found = compiled(*parts, edges)
    expected = compiled(*(part.contiguous() for part in parts), edges)
    assert found == expected and found[0] > 0
    turned = (part.permute(2, 1, 0).contiguous().permute(2, 1, 0) for part in parts)
    assert compiled(*turned, edges) == expected
    none = compiled(parts[0][:1], parts[1][:1], edges)
    assert none == (0, 0)


@pytest.mark.parametrize("frames", [1, 2, 3, 9, 17])
def test_the_losses_of_motion_in_one_go_are_those_of_torch(frames):
    """Uneven times, a node whose quaternion is zero, one that neither moves nor turns."""
    rng = np.random.default_rng(frames)
    xyz, quat = rng.normal(size=(frames, 9, 3)), rng.normal(size=(frames, 9, 4))
    xyz[:, 4], quat[:, 4], quat[0, 5] = xyz[0, 4], (1, 0, 0, 0), 0
    neighbours, mask = rng.integers(0, 9, (9, 4)), np.ones((9, 4), bool)
    times, weights = torch.tensor(np.cumsum(rng.uniform(0.5, 2, frames))), MotionWeights(0.3, 0.4, 0.2, 0.3, 0.5, 0.1)
    results = []
    for kernels, dtype in ((TORCH, torch.float64), (Kernels(native=True), torch.float32)):
        x, q = (torch.tensor(array, dtype=dtype, requires_grad=True) for array in (xyz, quat))
        edges = ArapEdges.build(neighbours, mask, dtype=dtype)
        loss = motion_loss(x, q, times, MotionTerms(edges, dict(zip(SHIFTS, WEIGHTS, strict=True)), weights, kernels))
        if frames > 1:
            (2 * loss).backward()
            results.append([loss.detach().double(), x.grad.double(), q.grad.double()])
        else:
            assert float(loss.detach()) == 0
    for one, other in zip(*results, strict=True) if results else ():
        torch.testing.assert_close(other, one, rtol=1e-5, atol=2e-6 * float(one.abs().max()))


def test_threads_change_no_bit_of_many_edges():
    """Enough for several parts of the sums; against torch in float64, too."""
    rng = np.random.default_rng(7)
    nodes, frames = 300, 12
    neighbours = np.stack([rng.permutation(nodes)[:5] for _ in range(nodes)])
    start = (
        rng.normal(size=(1, nodes, 3)) + 0.2 * rng.normal(size=(frames, nodes, 3)),
        rng.normal(size=(frames, nodes, 4)),
    )
    every, weights = dict(zip(SHIFTS, WEIGHTS, strict=True)), MotionWeights(1.3, 0.4, 0.5, 0.25, 2.0, 0.125)
    results = []
    for kernels, dtype in ((TORCH, torch.float64), *((Kernels(True, threads), torch.float32) for threads in (1, 2, 5))):
        x, q = (torch.tensor(array, dtype=dtype, requires_grad=True) for array in start)
        edges = ArapEdges.build(neighbours, np.ones_like(neighbours, bool), dtype=dtype)
        loss = motion_loss(x, q, torch.arange(frames), MotionTerms(edges, every, weights, kernels))
        results.append([loss.detach(), *torch.autograd.grad(loss, (x, q))])
    plain, one, *others = results
    for a, b in zip(one, plain, strict=True):
        torch.testing.assert_close(a.double(), b, rtol=1e-5, atol=4e-6 * float(b.abs().max()))
    assert all(torch.equal(a, b) for other in others for a, b in zip(one, other, strict=True))


def test_nodes_that_turn_no_further_than_rounding_have_no_gradient():
    quat = torch.randn(1, 6, 4, generator=torch.Generator().manual_seed(0)).repeat(8, 1, 1).requires_grad_()
    xyz = torch.zeros(8, 6, 3, requires_grad=True)
    edges = ArapEdges.build(np.arange(6)[:, None], np.ones((6, 1), bool))
    terms = MotionTerms(edges, {1: 1.0}, MotionWeights(1, 1, 1, 1, 1, 1), Kernels(native=True))
    loss = motion_loss(xyz, quat, torch.arange(8), terms)
    loss.backward()
    assert not quat.grad.any() and not xyz.grad.any()
