"""Skinning and dual-quaternion blending: rigid-motion laws, hard rotations, numpy = torch, gradients."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from f4x_core.geometry import dual_quaternion, pose, quaternion
from f4x_core.scaffold.deformation import (
    align_signs,
    blend,
    blend_reference,
    deform,
    interpolation_stencil,
    node_poses_at,
    pairs_of,
    relative_motions,
)
from f4x_core.scaffold.deformation.sparse import Deformer
from f4x_core.scaffold.skinning import SkinningWeights, skinning_weights


def turned(axis, degrees):
    axis = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    return quaternion.from_rotation_vector(axis * np.deg2rad(np.asarray(degrees, np.float64))[..., None])


def angle_between(a, b):
    """Degrees between rotations."""
    return np.rad2deg(
        np.linalg.norm(quaternion.to_rotation_vector(quaternion.multiply(a, quaternion.conjugate(b))), axis=-1)
    )


def make(seed=0, frames=6, nodes=5, number=40, slots=4, dtype=np.float64):
    """Smoothly moving nodes that turn alike, and Gaussians on them."""
    rng = np.random.default_rng(seed)
    xyz = (rng.normal(size=(1, nodes, 3)) + 0.1 * rng.normal(size=(frames, nodes, 3)).cumsum(0)).astype(dtype)
    quat = quaternion.normalize(
        turned([1, 2, 3], 40 * np.arange(frames))[:, None] + 0.1 * rng.normal(size=(frames, nodes, 4))
    )
    neighbours = np.stack([rng.permutation(nodes)[:slots] for _ in range(number)])
    weights = rng.uniform(0.05, 1, (number, slots)).astype(dtype)
    weights /= weights.sum(1, keepdims=True)
    return {
        "times": np.array([0.0, 1, 2, 4, 5, 6, 7, 9])[:frames],
        "xyz": xyz,
        "quat": quaternion.align_sequence(quat).astype(dtype),
        "neighbours": neighbours,
        "reference": np.arange(number) % frames,
        "weights": weights,
        "strength": rng.uniform(0.2, 1, number).astype(dtype),
    }


def motion(s, time, xyz=None, quat=None, strength=None):
    pairs = pairs_of(s["neighbours"], s["reference"])
    strength = s["strength"] if strength is None else strength
    return deform(
        s["times"],
        s["xyz"] if xyz is None else xyz,
        s["quat"] if quat is None else quat,
        pairs,
        SkinningWeights(s["weights"], strength),
        time,
    )


# ---- laws of the blend -----------------------------------------------------------------------------------------------


def test_at_the_reference_time_nothing_moves():
    s = make()
    for r, time in enumerate(s["times"]):
        q, t = motion(s, time)
        own = s["reference"] == r
        assert own.any()
        np.testing.assert_allclose(abs(q[own, 0]), 1, atol=1e-14)
        np.testing.assert_allclose(t[own], 0, atol=1e-14)


def test_nodes_that_move_rigidly_together_carry_exactly():
    s = make(frames=6)
    rng = np.random.default_rng(3)
    gq, gt = turned([3, -1, 2], 55 * np.arange(6)), rng.normal(size=(6, 3))
    rest_q, rest_x = quaternion.normalize(rng.normal(size=(5, 4))), rng.normal(size=(5, 3))
    quat, xyz = pose.compose(gq[:, None], gt[:, None], rest_q[None], rest_x[None])
    points = rng.normal(size=(40, 3))
    for f, time in enumerate(s["times"]):
        q, t = motion(s, time, xyz, quat, np.ones(40))
        then = pose.invert(gq[s["reference"]], gt[s["reference"]])
        expected = pose.transform(gq[f], gt[f], pose.transform(*then, points))
        np.testing.assert_allclose(pose.transform(q, t, points), expected, atol=1e-12)


def test_moving_the_whole_target_frame_rigidly_moves_the_result():
    s = make()
    table = relative_motions(s["times"], s["xyz"], s["quat"], (pairs := pairs_of(s["neighbours"], s["reference"])), 4.0)
    g = dual_quaternion.from_pose(turned([0, 1, 1], 77.0), np.array([0.3, -2.0, 1.0]))
    q, t = blend(table, pairs.index, s["weights"], np.ones(40))
    gq, gt = blend(dual_quaternion.multiply(g[None], table), pairs.index, s["weights"], np.ones(40))
    q, t = pose.compose(*dual_quaternion.to_pose(g), q, t)
    assert angle_between(gq, q).max() < 1e-6
    np.testing.assert_allclose(gt, t, atol=1e-12)


def test_one_neighbour_gives_its_own_motion():
    s = make()
    s["weights"] = np.eye(4)[np.zeros(40, int)]
    q, t = motion(s, 5.0, strength=np.ones(40))
    f, first = 4, s["neighbours"][:, 0]
    then = pose.invert(s["quat"][s["reference"], first], s["xyz"][s["reference"], first])
    expected_q, expected_t = pose.compose(s["quat"][f, first], s["xyz"][f, first], *then)
    assert angle_between(q, expected_q).max() < 1e-6
    np.testing.assert_allclose(t, expected_t, atol=1e-12)


def test_signs_of_stored_quaternions_do_not_matter():
    s = make()
    flips = np.random.default_rng(1).choice([-1.0, 1.0], s["quat"].shape[:2])[..., None]
    for time in (1.0, 2.7, 9.5):
        q, t = motion(s, time)
        fq, ft = motion(s, time, quat=s["quat"] * flips)
        assert angle_between(q, fq).max() < 1e-5
        np.testing.assert_allclose(t, ft, atol=1e-9)


@pytest.mark.parametrize("spread", [0.0, 10.0, 60.0])
def test_neighbours_around_any_rotation_blend_to_the_middle(spread):
    """Two neighbours at angle -+ spread/2, for every whole degree: also across 180, where signs would cancel."""
    degrees = np.arange(360.0)
    a, b = turned([1, 2, -1], degrees - spread / 2), turned([1, 2, -1], degrees + spread / 2)
    # as a provider would store them: w >= 0, which puts neighbours around 180 degrees on opposite hemispheres
    table = np.concatenate([np.where(x[:, :1] < 0, -x, x) for x in (a, b)])
    table = dual_quaternion.from_pose(table, np.zeros((720, 3))).astype(np.float32)
    index = np.stack([np.arange(360), np.arange(360) + 360], 1)
    half = np.full((360, 2), 0.5, np.float32)
    q, _ = blend(table, index, half, np.ones(360, np.float32))
    assert angle_between(q.astype(np.float64), turned([1, 2, -1], degrees)).max() < 1e-3
    reference, _ = blend_reference(table[index], half, np.ones(360, np.float32))
    np.testing.assert_allclose(abs((q * reference).sum(1)), 1, atol=1e-6)


def test_a_full_turn_in_time_never_pops():
    """Two nodes 20 degrees apart turn through 720 degrees: every Gaussian turns evenly with them."""
    frames = 145
    angles = np.linspace(0, 720, frames)
    quat = np.stack([turned([0, 0, 1], angles), turned([0, 0, 1], angles * (740 / 720))], 1).astype(np.float32)
    quat *= np.random.default_rng(0).choice([-1.0, 1.0], (frames, 2, 1)).astype(np.float32)
    quat = align_signs(quat, np.array([[0, 1], [1, 0]]), np.ones((2, 2), bool))
    xyz = np.zeros((frames, 2, 3), np.float32)
    pairs = pairs_of(np.array([[0, 1]]), np.array([0]))
    weights, one = np.array([[0.5, 0.5]], np.float32), np.ones(1, np.float32)
    times = np.arange(frames, dtype=float)
    path = np.concatenate(
        [deform(times, xyz, quat, pairs, SkinningWeights(weights, one), t)[0] for t in np.arange(0, frames - 1, 0.25)]
    )
    steps = angle_between(path[1:].astype(np.float64), path[:-1].astype(np.float64))
    np.testing.assert_allclose(steps, 730 / 144 / 4, atol=0.05)


def test_rotations_that_cancel_and_points_without_weights_rest():
    table = dual_quaternion.from_pose(np.array([quaternion.IDENTITY] * 2), np.ones((2, 3)))
    index = np.array([[0, 1], [0, 1]])
    q, t = blend(table, index, np.array([[0.5, -0.5], [0, 0]]), np.array([1.0, 0.0]))
    np.testing.assert_array_equal(q, [quaternion.IDENTITY] * 2)
    np.testing.assert_array_equal(t, np.zeros((2, 3)))


def test_strength_fades_to_rest_along_the_short_way():
    dq = dual_quaternion.from_pose(-turned([0, 0, 1], [50.0]), np.array([[1.0, 0, 0]]))  # stored on the far hemisphere
    q, t = blend(dq, np.zeros((3, 1), int), np.ones((3, 1)), np.array([1.0, 0.5, 0.0]))
    angles = angle_between(q, quaternion.IDENTITY)
    np.testing.assert_allclose(angles, [50, 25, 0], atol=1e-6)
    np.testing.assert_allclose(t[[0, 2]], [[1, 0, 0], [0, 0, 0]], atol=1e-12)
    assert 0 < np.linalg.norm(t[1]) < 1


def test_local_storage_follows_the_attach_node():
    """Oracle 9: moving an attach node rigidly at the reference time moves its Gaussians rigidly."""
    rng = np.random.default_rng(0)
    node = quaternion.normalize(rng.normal(size=4)), rng.normal(size=3)
    local = quaternion.normalize(rng.normal(size=(7, 4))), rng.normal(size=(7, 3))
    g = turned([1, 0, 2], 33.0), np.array([0.1, 0.2, 0.3])
    moved = pose.compose(*pose.compose(*g, *node), *local)
    expected = pose.compose(*g, *pose.compose(*node, *local))
    np.testing.assert_allclose(moved[1], expected[1], atol=1e-12)
    assert angle_between(moved[0], expected[0]).max() < 1e-6


# ---- time ------------------------------------------------------------------------------------------------------------


def test_stencil_is_exact_at_knots_and_sums_to_one():
    times = np.array([0.0, 1, 2.5, 3, 7])
    for i, time in enumerate(times):
        indices, c = interpolation_stencil(times, time)
        assert (c == (indices == i)).all() or (c[indices == i].sum() == 1 and (c[indices != i] == 0).all())
    for time in np.linspace(-3, 12, 61):
        indices, c = interpolation_stencil(times, time)
        assert indices.shape == c.shape == (4,)
        np.testing.assert_allclose(c.sum(), 1, atol=1e-12)
        if 0 <= time <= 7:
            np.testing.assert_allclose(c @ times[indices], time, atol=1e-12)  # straight lines stay straight


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_clips(frames):
    times, xyz = np.arange(frames) * 2.0, np.arange(frames * 3.0).reshape(frames, 1, 3)
    quat = turned([0, 1, 0], 30.0 * np.arange(frames))[:, None]
    for f in range(frames):
        x, q = node_poses_at(times, xyz, quat, times[f])
        np.testing.assert_array_equal(x, xyz[f])
        np.testing.assert_allclose(q, quat[f], atol=1e-15)
    x, q = node_poses_at(times, xyz, quat, 0.7)
    np.testing.assert_allclose(x, xyz[0] + (0.35 * 3 if frames > 1 else 0), atol=1e-12)
    assert np.isfinite(q).all()
    x, q = node_poses_at(times, xyz, quat, 1e6)
    assert np.isfinite(x).all() and abs(np.linalg.norm(q) - 1) < 1e-12


def test_rotation_between_knots_is_close_to_the_even_turn():
    times = np.arange(10.0)
    quat = turned([1, 1, 0], 20 * times)[:, None] * np.where(np.arange(10) % 3, 1, -1)[:, None, None]
    for time in np.linspace(0, 9, 37):
        _, q = node_poses_at(times, np.zeros((10, 1, 3)), quat, time)
        assert angle_between(q[0], turned([1, 1, 0], 20 * time)) < 0.1


def test_align_signs_agrees_in_time_and_along_the_tree():
    rng = np.random.default_rng(0)
    frames, nodes = 30, 12
    smooth = turned([0, 0, 1], 15 * np.arange(frames)[:, None] + 4 * np.arange(nodes)[None])
    shuffled = smooth * rng.choice([-1.0, 1.0], (frames, nodes, 1))
    chain = np.stack([np.arange(nodes), np.minimum(np.arange(nodes) + 1, nodes - 1)], 1)
    aligned = align_signs(shuffled, chain, np.ones((nodes, 2), bool), root=7)
    assert ((aligned[1:] * aligned[:-1]).sum(-1) > 0).all()
    assert ((aligned[:, 1:] * aligned[:, :-1]).sum(-1) > 0).all()
    assert angle_between(aligned, smooth).max() < 1e-5
    lone = align_signs(shuffled, chain, np.zeros((nodes, 2), bool))  # no edge: only time is aligned
    assert ((lone[1:] * lone[:-1]).sum(-1) > 0).all()


# ---- skinning --------------------------------------------------------------------------------------------------------


def test_skinning_follows_equation_1():
    x, nodes = np.zeros((1, 3)), np.array([[[0.1, 0, 0], [0.0, 0.3, 0]]])
    radius, mask = np.array([[0.2, 0.1]]), np.ones((1, 2), bool)
    g = np.exp([-0.01 / 0.08, -0.09 / 0.02]) + 1e-6
    w, s = skinning_weights(x, nodes, radius, mask)
    np.testing.assert_allclose(w[0], g / g.sum(), rtol=1e-12)
    np.testing.assert_allclose(s, min(g.sum(), 1), rtol=1e-12)
    g = np.exp([-0.01 / 0.4, -0.09 / 0.2]) + 1e-6
    w, s = skinning_weights(x, nodes, radius, mask, kernel="paper")
    np.testing.assert_allclose(w[0], g / g.sum(), rtol=1e-12)
    assert s[0] == 1
    dw = np.array([[0.3, -g[1]]])
    w, s = skinning_weights(x, nodes, radius, mask, dw, kernel="paper")
    np.testing.assert_allclose(w[0], [1, 0], atol=1e-12)


def test_skinning_is_the_same_in_torch_and_differentiable():
    rng = np.random.default_rng(0)
    arguments = [rng.normal(size=(6, 3)), rng.normal(size=(6, 3, 3)), rng.uniform(0.5, 1, (6, 3))]
    mask, dw = rng.random((6, 3)) > 0.2, 0.05 * rng.normal(size=(6, 3))
    tensors = [torch.tensor(a, requires_grad=True) for a in (*arguments, dw)]
    for kernel in ("sigma", "paper"):
        expected = skinning_weights(*arguments, mask, dw, kernel)
        for a, b in zip(expected, skinning_weights(*tensors[:3], torch.tensor(mask), tensors[3], kernel), strict=True):
            np.testing.assert_allclose(a, b.detach(), rtol=1e-12)
        assert torch.autograd.gradcheck(
            lambda x, n, r, d, k=kernel: skinning_weights(x, n, r, torch.tensor(mask), d, k), tensors
        )


# ---- the fast product ------------------------------------------------------------------------------------------------


def plain(s, xyz, quat, weights, strength, time):
    """Every Gaussian by itself, in torch."""
    x_now, q_now = node_poses_at(s["times"], xyz, quat, time)
    reference, neighbours = torch.as_tensor(s["reference"])[:, None], torch.as_tensor(s["neighbours"])
    then = pose.invert(quaternion.normalize(quat[reference, neighbours]), xyz[reference, neighbours])
    relative = dual_quaternion.from_pose(*pose.compose(q_now[neighbours], x_now[neighbours], *then))
    return blend_reference(relative, weights, strength)


@pytest.mark.parametrize("time", [2.0, 2.6, 6.0, -1.0, 8.2])
def test_product_equals_plain_blend_with_gradients(time):
    s = make(frames=6)
    names = ("xyz", "quat", "weights", "strength")
    inputs = [torch.tensor(s[name], requires_grad=True) for name in names]
    deformer = Deformer(s["times"], s["reference"], s["neighbours"], 5)
    rng = np.random.default_rng(2)
    g_q, g_t = torch.tensor(rng.normal(size=(40, 4))), torch.tensor(rng.normal(size=(40, 3)))
    results = []
    for function in (lambda *a: deformer(*a, time), lambda *a: plain(s, *a, time)):
        q, t = function(*inputs)
        sign = torch.where(q[:, :1] < 0, -1.0, 1.0).detach()  # q and -q are one rotation
        gradients = torch.autograd.grad((q * sign * g_q).sum() + (t * g_t).sum(), inputs)
        results.append([(q * sign).detach(), t.detach(), *gradients])
    for fast, slow in zip(*results, strict=True):
        np.testing.assert_allclose(fast, slow, atol=1e-10)


@pytest.mark.parametrize("fixed_weights", [False, True])
def test_product_gradcheck(fixed_weights):
    s = make(frames=4, nodes=3, number=6, slots=2)
    s["neighbours"][0] = 1  # the same node in both slots
    inputs = [
        torch.tensor(s[n], requires_grad=not (fixed_weights and n == "weights"))
        for n in ("xyz", "quat", "weights", "strength")
    ]
    deformer = Deformer(s["times"], s["reference"], s["neighbours"], 3)
    assert torch.autograd.gradcheck(lambda *a: deformer(*a, 1.3), inputs)
    assert torch.autograd.gradcheck(lambda *a: deformer(*a[:3], None, 2.0), inputs)


def test_deformer_skinning_equals_the_plain_one_with_gradients():
    s = make(frames=4, nodes=5, number=10, slots=3)
    rng = np.random.default_rng(0)
    means, xyz, radius, dw = (
        torch.tensor(a, requires_grad=True)
        for a in (rng.normal(size=(10, 3)), s["xyz"], rng.uniform(0.5, 1, 5), 0.01 * rng.normal(size=(10, 3)))
    )
    mask = torch.tensor(rng.random((10, 3)) > 0.2)
    deformer = Deformer(s["times"], s["reference"], s["neighbours"], 5)
    neighbours, reference = torch.tensor(s["neighbours"]), torch.tensor(s["reference"])[:, None]
    fast = deformer.skinning(means, xyz, radius, mask, dw)
    slow = skinning_weights(means, xyz[reference, neighbours], radius[neighbours], mask, dw)
    seed = torch.tensor(rng.normal(size=(10, 3)))
    gradients = [torch.autograd.grad((w * seed).sum() + o.sum(), (means, xyz, radius, dw)) for w, o in (fast, slow)]
    np.testing.assert_allclose(fast[0].detach(), slow[0].detach(), atol=1e-12)
    for a, b in zip(*gradients, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_no_gaussians_and_lone_nodes():
    deformer = Deformer(np.arange(2.0), np.zeros(0, int), np.zeros((0, 3), int), 4)
    xyz, quat = torch.zeros(2, 4, 3), torch.tensor(quaternion.IDENTITY, dtype=torch.float32).expand(2, 4, 4)
    q, t = deformer(xyz, quat, torch.zeros(0, 3), torch.zeros(0), 1.0)
    assert q.shape == (0, 4) and t.shape == (0, 3)
    q, t = blend(
        np.zeros((0, 8), np.float32), np.zeros((0, 3), int), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    )
    assert q.shape == (0, 4) and t.shape == (0, 3)


def test_deformation_needs_numpy_alone():
    code = (
        "import sys\n"
        "for name in ('torch', 'scipy', 'cv2'): sys.modules[name] = None\n"
        "import f4x_core.scaffold.skinning, f4x_core.scaffold.deformation, f4x_core.scaffold.radius\n"
        "import f4x_core.scaffold.distance, f4x_core.scaffold.graph, f4x_core.scaffold.selection, f4x_core.scaffold.control\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
