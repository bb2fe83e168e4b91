"""Losses, geometric optimisation and node control of the scaffold."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from f4x_core.errors import Cancelled, F4xError
from f4x_core.geometry import pose, quaternion
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.control import densify_nodes, largest_weights, prune_nodes, rebase_local, resample_in_time
from f4x_core.scaffold.deformation import deform, pairs_of
from f4x_core.scaffold.distance import curve_distance
from f4x_core.scaffold.graph import EdgeLevel, build_graph
from f4x_core.scaffold.lifting import fill_gaps
from f4x_core.scaffold.losses import ArapEdges, arap_losses, smoothness_losses
from f4x_core.scaffold.optimise import GeometryConfig, Sightlines, optimise_geometry
from f4x_core.scaffold.radius import radius_from_logit, radius_to_logit
from f4x_core.scaffold.skinning import skinning_weights
from f4x_core.scaffold.structure import NodePoses


def rigid_scaffold(frames=12, nodes=15, noise=0.0, gaps=False, seed=0):
    """A rigid body that turns and travels; returns the (spoilt) scaffold and the true positions."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, frames)
    gq = quaternion.from_rotation_vector(np.array([0.3, 2.0, -0.4]) * s[:, None])
    gt = np.stack([0.3 * s, 0.1 * s**2, 1 + 0 * s], 1)
    truth = pose.transform(gq[:, None], gt[:, None], rng.uniform(-0.2, 0.2, (1, nodes, 3)))
    certain = np.ones((frames, nodes), bool)
    if gaps:
        for n in range(nodes):
            start = rng.integers(0, frames // 2)
            certain[start : start + frames // 3, n] = False
    xyz = fill_gaps(truth + noise * rng.normal(size=truth.shape), certain, np.arange(frames * 1.0))
    distance = curve_distance(xyz)
    neighbours, mask = build_graph(distance, 6, 1.0)
    quat = np.broadcast_to(gq[:, None], (frames, nodes, 4))
    scaffold = Scaffold(
        np.arange(frames * 1.0),
        xyz.astype(np.float32),
        quat.astype(np.float32),
        np.full(nodes, 0.1, np.float32),
        certain,
        np.arange(nodes),
        neighbours,
        mask,
        0.1,
    )
    return scaffold, truth


def tensors(scaffold, grad=True):
    return [torch.tensor(a, dtype=torch.float64, requires_grad=grad) for a in (scaffold.xyz, scaffold.quat)]


def edges_of(scaffold, levels=None, detach=True):
    return ArapEdges.build(scaffold.neighbours, scaffold.edge_mask, 1.0, levels, detach=detach, dtype=torch.float64)


# ---- losses ----------------------------------------------------------------------------------------------------------


def test_arap_is_zero_for_rigid_motions():
    scaffold, _ = rigid_scaffold()
    xyz, quat = tensors(scaffold)
    level = EdgeLevel(np.arange(14), np.full(14, 14), 0.3)
    coordinate, length = arap_losses(xyz, quaternion.normalize(quat), edges_of(scaffold, [level]))
    assert coordinate < 1e-6 and length < 1e-6  # float32 poses
    bent = xyz + torch.linspace(0, 0.3, 12)[:, None, None] * xyz[:1] ** 2
    coordinate, length = arap_losses(bent, quaternion.normalize(quat), edges_of(scaffold, [level]))
    assert coordinate > 1e-3 and length > 1e-3


def test_arap_equals_the_formula():
    rng = np.random.default_rng(0)
    xyz, quat = rng.normal(size=(6, 5, 3)), quaternion.normalize(rng.normal(size=(6, 5, 4)))
    neighbours = np.array([[0, 1, 2], [1, 0, 2], [2, 3, 4], [3, 4, 0], [4, 4, 4]])
    mask = np.array([[1, 1, 1], [1, 1, 0], [1, 1, 1], [1, 1, 1], [1, 0, 0]], bool)
    level = EdgeLevel(np.array([0, 0, 3]), np.array([2, 4, 1]), 0.3)
    expected = np.zeros(2)
    lists = [
        (1.0, [[b for b, m in zip(n[1:], v[1:], strict=True) if m] for n, v in zip(neighbours, mask, strict=True)])
    ]
    lists.append((0.3, [[2, 4], [], [], [1], []]))
    for weight, rows in lists:
        for a, row in enumerate(rows):
            for b in row:
                local = quaternion.rotate(quaternion.conjugate(quat[:, b]), xyz[:, a] - xyz[:, b])
                for shift, v in ((1, 0.6), (3, 0.4), (9, 1.0)):
                    for t in range(6 - shift):
                        factor = weight * v / len(row) / 5 / (6 - shift)
                        first, second = local[t], local[t + shift]
                        expected += factor * np.array(
                            [np.linalg.norm(first - second), abs(np.linalg.norm(first) - np.linalg.norm(second))]
                        )
    edges = ArapEdges.build(neighbours, mask, 1.0, [level], dtype=torch.float64)
    actual = arap_losses(torch.tensor(xyz), torch.tensor(quat), edges, (1, 3, 9), (0.6, 0.4, 1.0))
    np.testing.assert_allclose([loss.item() for loss in actual], expected, rtol=1e-12)


def test_arap_gradients():
    scaffold, _ = rigid_scaffold(frames=5, nodes=5)
    level = EdgeLevel(np.array([0, 1]), np.array([4, 3]), 0.3)
    rng = np.random.default_rng(0)
    xyz = torch.tensor(rng.normal(size=(5, 5, 3)), requires_grad=True)
    quat = torch.tensor(rng.normal(size=(5, 5, 4)), requires_grad=True)

    def both(x, q, detach):
        return torch.stack(arap_losses(x, quaternion.normalize(q), edges_of(scaffold, [level], detach)))

    assert torch.autograd.gradcheck(lambda x, q: both(x, q, False), (xyz, quat))
    only_level = ArapEdges.build(np.arange(5)[:, None], np.ones((5, 1), bool), 1.0, [level], dtype=torch.float64)
    arap_losses(xyz, quaternion.normalize(quat), only_level)[0].backward()
    assert (xyz.grad[:, 4] == 0).all() and (xyz.grad[:, 0] != 0).any()  # the coarse end leads
    assert torch.autograd.gradcheck(
        lambda x, q: torch.stack(smoothness_losses(x, quaternion.normalize(q))), (xyz, quat)
    )


def test_gradients_are_finite_on_static_scaffolds_and_coincident_nodes():
    scaffold, _ = rigid_scaffold()
    still = replace(scaffold, xyz=np.zeros_like(scaffold.xyz), quat=np.repeat(scaffold.quat[:1], 12, 0))
    xyz, quat = tensors(still)
    unit = quaternion.normalize(quat)
    total = sum(arap_losses(xyz, unit, edges_of(still))) + sum(smoothness_losses(xyz, unit))
    total.backward()
    assert total.item() < 1e-12
    assert torch.isfinite(xyz.grad).all() and torch.isfinite(quat.grad).all()


def test_smoothness_closed_forms():
    t = np.arange(10.0)
    circle = torch.tensor(np.stack([3 * np.cos(0.2 * t), 3 * np.sin(0.2 * t), 0 * t], 1)[:, None])
    quat = torch.tensor(quaternion.from_rotation_vector(np.outer(0.05 * t**2, [0, 0, 1.0]))[:, None])
    smooth = smoothness_losses(circle, quat)
    chord = 6 * np.sin(0.1)
    np.testing.assert_allclose(smooth.velocity, chord, rtol=1e-12)
    np.testing.assert_allclose(smooth.acceleration, chord * 2 * np.sin(0.1), rtol=1e-12)
    np.testing.assert_allclose(smooth.angular_velocity, np.mean(0.05 * (2 * t[:-1] + 1)), rtol=1e-9)
    np.testing.assert_allclose(smooth.angular_acceleration, 0.1, rtol=1e-9)
    flipped = smoothness_losses(circle, quat * torch.tensor([1.0, -1.0]).repeat(5)[:, None, None])
    np.testing.assert_allclose(flipped.angular_velocity, smooth.angular_velocity)
    uneven = torch.tensor([0.0, 1, 2, 4, 5, 8, 9, 10, 11, 12])
    line = uneven[:, None, None].double() * torch.tensor([0.3, 0.4, 0.0])
    assert smoothness_losses(line, quat, uneven).acceleration < 1e-12
    np.testing.assert_allclose(smoothness_losses(line, quat, uneven).velocity, 0.5, rtol=1e-6)


def test_short_clips_have_no_loss_to_speak_of():
    for frames in (1, 2):
        scaffold, _ = rigid_scaffold(frames=frames)
        xyz, quat = tensors(scaffold)
        losses = [*arap_losses(xyz, quat, edges_of(scaffold)), *smoothness_losses(xyz, quat)]
        assert all(torch.isfinite(loss) for loss in losses)
        assert losses[3] == losses[5] == 0  # accelerations


def test_three_frames_have_every_loss_and_two_have_speeds():
    xyz = torch.tensor([[[0.0, 0, 0]], [[3, 4, 0]], [[3, 4, 2]]], dtype=torch.float64)
    turn = torch.tensor(quaternion.from_rotation_vector(np.array([[[0.1, 0, 0]], [[0.3, 0, 0]], [[0.9, 0, 0]]])))
    times = torch.tensor([0.0, 1, 3])
    smooth = smoothness_losses(xyz, turn, times)
    bend = np.linalg.norm([-3, -4, 1]) / 1.5  # velocities (3, 4, 0) and (0, 0, 1), middles 1.5 apart
    np.testing.assert_allclose([float(one) for one in smooth], [(5 + 1) / 2, bend, (0.2 + 0.3) / 2, 0.1 / 1.5])
    two = smoothness_losses(xyz[:2], turn[:2], times[:2])
    np.testing.assert_allclose([float(one) for one in two], [5, 0, 0.2, 0])


def test_radius_logit_round_trip():
    radius = np.array([0.01, 0.2, 0.49])
    np.testing.assert_allclose(radius_from_logit(radius_to_logit(radius, 0.5), 0.5), radius, rtol=1e-12)
    assert np.isfinite(radius_to_logit(np.array([0.0, 0.5, 9.0]), 0.5)).all()
    torch.testing.assert_close(radius_from_logit(radius_to_logit(torch.tensor(radius), 0.5), 0.5), torch.tensor(radius))


# ---- optimisation ----------------------------------------------------------------------------------------------------


def test_geometry_fills_gaps_and_takes_out_noise():
    scaffold, truth = rigid_scaffold(frames=16, noise=0.004, gaps=True)
    seen = []
    result = optimise_geometry(
        scaffold, GeometryConfig(steps=150), lambda stage, done, total, message="": seen.append((done, total))
    )
    before, after = (np.linalg.norm(s.xyz - truth, axis=-1) for s in (scaffold, result))
    assert after[~scaffold.certain].mean() < 0.6 * before[~scaffold.certain].mean()
    assert after[scaffold.certain].mean() < 0.8 * before[scaffold.certain].mean()
    assert seen[-1] == (150, 150) and len(seen) > 10
    np.testing.assert_allclose(np.linalg.norm(result.quat, axis=-1), 1, atol=1e-5)
    assert ((result.quat[1:] * result.quat[:-1]).sum(-1) >= 0).all()
    again = optimise_geometry(scaffold, GeometryConfig(steps=150))
    np.testing.assert_array_equal(result.xyz, again.xyz)


@pytest.mark.parametrize(("frames", "nodes"), [(1, 5), (2, 5), (5, 1), (3, 2)])
def test_small_scaffolds_optimise(frames, nodes):
    scaffold, _ = rigid_scaffold(frames=frames, nodes=nodes)
    result = optimise_geometry(scaffold, GeometryConfig(steps=5))
    assert np.isfinite(result.xyz).all() and result.xyz.shape == (frames, nodes, 3)


def test_windows_of_long_clips_and_cancelling():
    scaffold, _ = rigid_scaffold(frames=20, noise=0.01)
    result = optimise_geometry(scaffold, GeometryConfig(steps=20, window=8))
    assert np.isfinite(result.xyz).all()

    def cancel(*_):
        raise Cancelled

    with pytest.raises(Cancelled):
        optimise_geometry(scaffold, GeometryConfig(steps=20), cancel)


def test_scaffolds_that_do_not_fit_together_are_refused():
    scaffold, _ = rigid_scaffold()
    with pytest.raises(F4xError, match="radius"):
        replace(scaffold, radius=np.zeros(3, np.float32))
    with pytest.raises(F4xError, match="increase"):
        replace(scaffold, times=np.zeros(12))
    with pytest.raises(F4xError, match="not finite"):
        replace(scaffold, xyz=scaffold.xyz * np.nan)
    with pytest.raises(F4xError, match="below 15"):
        replace(scaffold, neighbours=scaffold.neighbours + 100)


# ---- node control ----------------------------------------------------------------------------------------------------


def carried(scaffold, attach, reference, points, dw, time):
    neighbours = scaffold.neighbours[attach]
    skinning = skinning_weights(
        points,
        scaffold.xyz[reference[:, None], neighbours],
        scaffold.radius[neighbours],
        scaffold.edge_mask[attach],
        dw,
    )
    pairs = pairs_of(neighbours, reference)
    q, t = deform(scaffold.times, scaffold.xyz, scaffold.quat, pairs, skinning, time)
    return pose.transform(q, t, points), skinning.weights


def gaussians(scaffold, number=60, seed=0, attach_below=None):
    rng = np.random.default_rng(seed)
    attach = rng.integers(0, attach_below or len(scaffold), number)
    reference = rng.integers(0, len(scaffold.times), number)
    points = scaffold.xyz[reference, attach] + 0.02 * rng.normal(size=(number, 3)).astype(np.float32)
    return attach, reference, points


def bending():
    scaffold, _ = rigid_scaffold(noise=0.02)
    return scaffold


def test_pruning_a_weightless_node_changes_nothing():
    """Oracle 8: in surface mode a pruned node's slots had weight 0 (dw = -g); every position stays."""
    scaffold = bending()
    attach, reference, points = gaussians(scaffold, attach_below=12)
    neighbours = scaffold.neighbours[attach]
    raw = np.exp(
        -0.5
        * ((points[:, None] - scaffold.xyz[reference[:, None], neighbours]) ** 2).sum(-1)
        / scaffold.radius[neighbours] ** 2
    )
    useless = neighbours >= 12
    assert useless.any()
    dw = np.where(useless, -(raw + 1e-6), 0.01)
    before, weights = carried(scaffold, attach, reference, points, dw, 7.3)
    greatest = largest_weights(neighbours, weights, len(scaffold))
    pruned, new_index = prune_nodes(scaffold, greatest, attach, 1e-5)
    assert len(pruned) == 12 and (new_index[12:] == -1).all()
    assert pruned.ids.tolist() == list(range(12))
    after, _ = carried(pruned, new_index[attach], reference, points, dw, 7.3)
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_densifying_moves_nothing_that_is_carried():
    scaffold = bending()
    attach, reference, points = gaussians(scaffold)
    before, _ = carried(scaffold, attach, reference, points, None, 4.0)
    rng = np.random.default_rng(1)
    candidates = rng.uniform(-0.3, 0.3, (12, 30, 3))
    candidates[:, 1] = candidates[:, 0]  # a duplicate
    quat = np.broadcast_to(quaternion.IDENTITY, (12, 30, 4))
    dense, taken = densify_nodes(scaffold, candidates, quat, 0.1, next_id=100)
    assert 0 in taken and 1 not in taken
    assert dense.ids[15:].tolist() == list(range(100, 100 + len(taken)))
    np.testing.assert_array_equal(dense.neighbours[15:, 0], 15 + np.arange(len(taken)))
    assert dense.edge_mask[15:, 0].all()
    between = curve_distance(dense.xyz[:, 15:])
    assert between[~np.eye(len(taken), dtype=bool)].min() > scaffold.unit
    after, _ = carried(dense, attach, reference, points, None, 4.0)
    np.testing.assert_array_equal(after, before)
    same, none = densify_nodes(scaffold, candidates[:, :0], quat[:, :0], 0.1, 100)
    assert same is scaffold and len(none) == 0


def test_gaussians_that_change_nodes_stay_where_they_are():
    scaffold = bending()
    rng = np.random.default_rng(0)
    local = rng.normal(size=(8, 3)), quaternion.normalize(rng.normal(size=(8, 4)))
    reference, old, fresh = rng.integers(0, 12, 8), rng.integers(0, 15, 8), rng.integers(0, 15, 8)
    xyz, quat = scaffold.xyz.astype(np.float64), quaternion.normalize(scaffold.quat.astype(np.float64))
    moved_xyz, moved_quat = rebase_local(*local, reference, old, fresh, NodePoses(xyz, quat))
    before = pose.compose(quat[reference, old], xyz[reference, old], local[1], local[0])
    after = pose.compose(quat[reference, fresh], xyz[reference, fresh], moved_quat, moved_xyz)
    np.testing.assert_allclose(after[1], before[1], atol=1e-12)
    np.testing.assert_allclose(abs((after[0] * before[0]).sum(-1)), 1, atol=1e-12)


def test_resampling_in_time_keeps_knots_and_fills_between():
    scaffold, truth = rigid_scaffold(frames=23)
    key_frames = replace(
        scaffold,
        times=scaffold.times[::2],
        xyz=scaffold.xyz[::2],
        quat=scaffold.quat[::2] * np.where(np.arange(12) % 3, 1, -1).astype(np.float32)[:, None, None],
        certain=scaffold.certain[::2],
    )
    key_frames.certain[4, 0] = False
    dense = resample_in_time(key_frames, scaffold.times)
    np.testing.assert_array_equal(dense.xyz[::2], key_frames.xyz)
    assert np.linalg.norm(dense.xyz - truth, axis=-1).max() < 2e-3
    assert abs((dense.quat * scaffold.quat).sum(-1)).min() > 1 - 1e-5
    assert ((dense.quat[1:] * dense.quat[:-1]).sum(-1) > 0).all()
    assert np.flatnonzero(~dense.certain[:, 0]).tolist() == [5, 7, 8, 9, 11] and dense.certain[:, 1].all()


# ---- held along the ray ----------------------------------------------------------------------------------------------


def seen_from_the_origin(scaffold, confidence):
    direction = scaffold.xyz / np.linalg.norm(scaffold.xyz, axis=-1, keepdims=True)
    return Sightlines(direction, np.full(scaffold.certain.shape, confidence, np.float32))


def test_where_depth_is_a_guess_rigidity_takes_out_its_drift():
    scaffold, truth = rigid_scaffold(frames=12)
    shift = np.array([0.0, 0.0, 4.0])
    drift = 1 + 0.05 * np.sin(np.arange(12))[:, None, None]  # every frame has a depth of its own
    wrong = replace(scaffold, xyz=((truth + shift) * drift).astype(np.float32))
    config = GeometryConfig(steps=200, along_ray=1 / 256)
    guess = optimise_geometry(wrong, config, sightlines=seen_from_the_origin(wrong, 0.0))
    sure = optimise_geometry(wrong, config, sightlines=seen_from_the_origin(wrong, 1.0))
    plain = optimise_geometry(wrong, config)

    def wobble(found):
        return np.std(np.linalg.norm(found.xyz, axis=-1) / np.linalg.norm(truth + shift, axis=-1), axis=0).mean()

    assert wobble(guess) < 0.6 * wobble(plain)
    np.testing.assert_allclose(sure.xyz, plain.xyz, atol=1e-3)
    rays = seen_from_the_origin(wrong, 0.0).direction
    moved = guess.xyz - wrong.xyz
    aside = moved - (moved * rays).sum(-1, keepdims=True) * rays
    assert np.linalg.norm(aside, axis=-1).mean() < 0.3 * np.abs((moved * rays).sum(-1)).mean()
