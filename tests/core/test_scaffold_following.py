"""Nodes that are moved so that they carry all tracks."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from f4x_core.errors import Cancelled
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.native.kernels import TORCH, Kernels
from f4x_core.scaffold.deformation.native.autograd import NodeTensors
from f4x_core.scaffold.distance import curve_distance
from f4x_core.scaffold.following import SUPPORT, FollowingConfig, _samples, follow_tracks
from f4x_core.scaffold.graph import GraphConfig, build_graph
from f4x_core.scaffold.lifting import LiftedTracks
from f4x_core.scaffold.selection import track_residuals
from f4x_core.scaffold.structure import Scaffold

FRAMES, NODES, TRACKS = 12, 9, 160
SMALL = FollowingConfig(steps=120, frames=6)
NATIVE = Kernels(True, 1)


def motion():
    """Return the poses (F, 4), (F, 3) of a body that turns and travels before the camera."""
    s = np.linspace(0, 1, FRAMES)
    return quaternion.from_rotation_vector(np.array([0.2, 0.9, -0.1]) * s[:, None]), np.stack(
        [0.5 * s, 0.1 * s**2, 1.2 + 0 * s], 1
    )


def tracks_of_a_body(seed=0, seen=1.0):
    """Return true tracks of the body's points, of which each frame saw the fraction `seen`."""
    rng = np.random.default_rng(seed)
    turn, shift = motion()
    xyz = pose.transform(turn[:, None], shift[:, None], rng.uniform(-0.2, 0.2, (1, TRACKS, 3)))
    return LiftedTracks(xyz.astype(np.float32), rng.random((FRAMES, TRACKS)) < seen, np.arange(TRACKS))


def scaffold_of_some(lifted, wrong=0.03, seed=1):
    """Return nodes at a few of the tracks, misplaced by `wrong` in every second frame, upright throughout."""
    rng = np.random.default_rng(seed)
    xyz = lifted.xyz[:, :NODES].copy()
    xyz[1::2] += wrong * rng.normal(size=xyz[1::2].shape)
    neighbours, mask = build_graph(curve_distance(xyz), 6, 2.0)
    return Scaffold(
        np.arange(FRAMES * 1.0),
        xyz.astype(np.float32),
        np.tile(quaternion.IDENTITY, (FRAMES, NODES, 1)).astype(np.float32),
        np.full(NODES, 0.2, np.float32),
        np.ones((FRAMES, NODES), bool),
        np.arange(NODES),
        neighbours,
        mask,
        0.2,
    )


def resting_camera():
    intrinsics, still = np.array([[400.0, 0, 240], [0, 400, 135], [0, 0, 1]]), np.tile(np.eye(4), (FRAMES, 1, 1))
    return CameraPath(np.tile(intrinsics, (FRAMES, 1, 1)), still, np.arange(FRAMES * 1.0), 480, 270)


def pixels_off(scaffold, lifted):
    return float(np.median(track_residuals(scaffold, lifted, resting_camera())))


@pytest.mark.parametrize("kernels", [TORCH, NATIVE], ids=["torch", "native"])
def test_tracks_that_were_left_out_are_carried_better(kernels):
    lifted = tracks_of_a_body(seen=0.7)
    known, others = lifted.subset(np.arange(120)), lifted.subset(np.arange(120, TRACKS))
    before = scaffold_of_some(lifted)
    after = follow_tracks(before, known, resting_camera(), SMALL, kernels)
    assert pixels_off(after, others) < 0.25 * pixels_off(before, others)
    np.testing.assert_allclose(np.linalg.norm(after.quat, axis=-1), 1, atol=1e-5)


def test_the_compiled_library_carries_the_same_points():
    lifted = tracks_of_a_body(seen=0.7)
    scaffold = scaffold_of_some(lifted)
    parts = (torch.from_numpy(part).requires_grad_() for part in (scaffold.xyz, scaffold.quat))
    nodes = NodeTensors(*parts, torch.from_numpy(scaffold.radius))
    found = []
    for kernels in (TORCH, NATIVE):
        made = list(_samples(scaffold, lifted, resting_camera(), SMALL, kernels, np.random.default_rng(0)))
        carried = made[3].carried(nodes)
        found.append((carried.detach(), *torch.autograd.grad(made[3].miss(nodes, SMALL), (nodes.xyz, nodes.quat))))
    for plain, native in zip(*found, strict=True):
        torch.testing.assert_close(native, plain, rtol=1e-4, atol=1e-5)


def test_the_gradient_is_that_of_the_miss():
    lifted = tracks_of_a_body(seen=0.1)
    scaffold = scaffold_of_some(lifted)
    few = replace(SMALL, samples=6)
    sample = list(_samples(scaffold, lifted, resting_camera(), few, TORCH, np.random.default_rng(0)))[3]
    doubled = {
        f.name: value.double()
        for f in fields(sample)
        if isinstance(value := getattr(sample, f.name), torch.Tensor) and value.is_floating_point()
    }
    sample = replace(sample, **doubled)
    radius = torch.from_numpy(scaffold.radius).double()
    poses = [torch.from_numpy(part).double().requires_grad_() for part in (scaffold.xyz, scaffold.quat)]
    assert torch.autograd.gradcheck(lambda xyz, quat: sample.miss(NodeTensors(xyz, quat, radius), few), poses)


def test_a_lost_track_pulls_at_nothing():
    lifted = tracks_of_a_body()
    scaffold = scaffold_of_some(lifted)
    far = replace(lifted, xyz=lifted.xyz.copy())
    far.xyz[5, :, 0] += 1.0  # all were followed onto something else there
    poses = [torch.from_numpy(part).requires_grad_() for part in (scaffold.xyz, scaffold.quat)]
    nodes = NodeTensors(*poses, torch.from_numpy(scaffold.radius))
    made = list(_samples(scaffold, far, resting_camera(), SMALL, TORCH, np.random.default_rng(0)))
    assert not any(pull.any() for pull in torch.autograd.grad(made[5].miss(nodes, SMALL), poses))
    assert all(pull.any() for pull in torch.autograd.grad(made[0].miss(nodes, SMALL), poses))


def test_nodes_keep_their_distance_from_the_camera():
    """Depth of a track is a guess of each frame; across the rays it is known to a fraction of a pixel."""
    lifted = tracks_of_a_body()
    scaffold = scaffold_of_some(lifted)
    nearer = replace(lifted, xyz=lifted.xyz * np.linspace(0.9, 1.1, FRAMES, dtype=np.float32)[:, None, None])
    found = follow_tracks(scaffold, nearer, resting_camera(), SMALL)
    np.testing.assert_allclose(*(np.linalg.norm(s.xyz, axis=-1) for s in (found, scaffold)), rtol=5e-3)
    assert np.abs(found.xyz[..., 0] - scaffold.xyz[..., 0]).max() > 0.02


def test_threads_do_not_change_a_bit():
    lifted = tracks_of_a_body(seen=0.7)
    found = [
        follow_tracks(
            scaffold_of_some(lifted), lifted, resting_camera(), replace(SMALL, steps=20), Kernels(True, threads)
        )
        for threads in (1, 2)
    ]
    np.testing.assert_array_equal(found[0].xyz, found[1].xyz)
    np.testing.assert_array_equal(found[0].quat, found[1].quat)


def test_a_node_is_certain_where_a_track_was_seen_near_it():
    lifted = tracks_of_a_body()
    lifted.certain[4] = False
    lifted.certain[7] = np.arange(TRACKS) == 0
    scaffold = scaffold_of_some(lifted, wrong=0.0)
    found = follow_tracks(scaffold, lifted, resting_camera(), replace(SMALL, steps=1, learning_rate=0.0)).certain
    assert found[[0, 1, 11]].all() and not found[4].any()
    near = np.linalg.norm(scaffold.xyz[7] - lifted.xyz[7, 0], axis=1) <= SUPPORT * scaffold.radius
    np.testing.assert_array_equal(found[7], near)
    assert near.any() and not near.all()


@pytest.mark.parametrize("spoil", ["no steps", "one node", "nothing seen twice"])
def test_what_cannot_be_followed_comes_back_as_it_is(spoil):
    lifted = tracks_of_a_body()
    scaffold, config = scaffold_of_some(lifted), SMALL
    if spoil == "no steps":
        config = replace(config, steps=0)
    elif spoil == "one node":
        one = {name: getattr(scaffold, name)[:, :1] for name in ("xyz", "quat", "certain")}
        more = {name: getattr(scaffold, name)[:1] for name in ("radius", "ids")}
        graph = {"neighbours": np.zeros((1, 1), np.int64), "edge_mask": np.ones((1, 1), bool)}
        scaffold = replace(scaffold, **one, **more, **graph)
    else:
        lifted = replace(lifted, certain=np.arange(FRAMES)[:, None] == np.arange(TRACKS) % FRAMES)
    assert follow_tracks(scaffold, lifted, resting_camera(), config) is scaffold


def test_it_can_be_cancelled():
    def cancel(*_):
        raise Cancelled

    lifted = tracks_of_a_body()
    with pytest.raises(Cancelled):
        follow_tracks(scaffold_of_some(lifted), lifted, resting_camera(), SMALL, progress=cancel)


def test_the_graph_is_built_anew():
    lifted = tracks_of_a_body()
    config = replace(SMALL, geometry=replace(SMALL.geometry, graph=GraphConfig(neighbours=3)))
    assert follow_tracks(scaffold_of_some(lifted), lifted, resting_camera(), config).neighbours.shape == (NODES, 3)
