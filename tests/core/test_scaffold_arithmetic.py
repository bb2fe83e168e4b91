"""Arithmetic of the scaffold that only a worse scene would show to be wrong: each formula beside its own words or brute force."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.deformation.reference import SIGN_BAND, slot_signs
from f4x_core.scaffold.deformation.sparse import Deformer
from f4x_core.scaffold.groups import MAX_GROUPS, rigid_groups
from f4x_core.scaffold.lifting import LiftedTracks, fill_gaps
from f4x_core.scaffold.losses import smoothness_losses
from f4x_core.scaffold.optimise import GeometryConfig, optimise_geometry
from f4x_core.scaffold.rotation import initial_rotations
from f4x_core.scaffold.selection import SelectionConfig, automatic_unit, choose_nodes, track_noise
from f4x_core.windows.joining import join_scaffolds


def cameras(frames: int) -> CameraPath:
    lens = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])
    return CameraPath(
        np.tile(lens, (frames, 1, 1)), np.tile(np.eye(4), (frames, 1, 1)), np.arange(float(frames)), 32, 24
    )


def nodes(frames: int, places: np.ndarray, ids=None, sign: float = 1.0) -> Scaffold:
    """Nodes at rest, without edges, that are turned half a radian about x."""
    count = len(places)
    quat = sign * quaternion.from_rotation_vector(np.array([0.5, 0, 0]))
    return Scaffold(
        times=np.arange(float(frames)),
        xyz=np.tile(places, (frames, 1, 1)).astype(np.float32),
        quat=np.tile(quat, (frames, count, 1)).astype(np.float32),
        radius=np.full(count, 0.1, np.float32),
        certain=np.ones((frames, count), bool),
        ids=np.arange(count) if ids is None else np.asarray(ids),
        neighbours=np.arange(count)[:, None],
        edge_mask=np.ones((count, 1), bool),
        unit=0.1,
    )


@pytest.mark.parametrize("known", [0, 4])
def test_a_curve_known_in_one_frame_is_held_in_all(known):
    xyz = np.arange(15.0).reshape(5, 1, 3)
    certain = np.arange(5)[:, None] == known
    assert (fill_gaps(xyz, certain, np.arange(5.0)) == xyz[known]).all()


def test_turns_about_every_axis_count_as_turns():
    for axis in np.eye(3):
        turns = quaternion.from_rotation_vector(np.outer(0.1 * np.arange(4.0), axis))[:, None]
        spin = smoothness_losses(torch.zeros(4, 1, 3, dtype=torch.float64), torch.tensor(turns)).angular_velocity
        np.testing.assert_allclose(spin, 0.1, rtol=1e-9)


def test_two_nodes_are_enough_to_be_optimised(one_thread):
    shaken = nodes(6, np.array([[0.0, 0, 1], [0.1, 0, 1]]))
    shaken = replace(
        shaken, xyz=shaken.xyz + np.float32(0.01) * (-1.0) ** np.arange(6, dtype=np.float32)[:, None, None]
    )
    smooth = optimise_geometry(shaken, GeometryConfig(steps=20))
    assert np.abs(np.diff(smooth.xyz, axis=0)).mean() < 0.8 * np.abs(np.diff(shaken.xyz, axis=0)).mean()


def test_samples_that_were_filled_in_do_not_slow_a_turn():
    """Three of six neighbours were not seen from the second frame on and stand still; the other three turn."""
    around = np.random.default_rng(0).normal(size=(6, 3))
    turn = quaternion.from_rotation_vector(np.array([0.0, 0, 0.3]))
    points = np.stack([around, np.concatenate([quaternion.rotate(turn, around[:3]), around[3:]])])
    certain = np.array([[True] * 6, [True] * 3 + [False] * 3])
    neighbours, mask = np.arange(6)[None], np.ones((1, 6), bool)
    message, untold = (initial_rotations(neighbours, mask, points, which)[1, 0] for which in (certain, None))
    assert np.linalg.norm(message - turn) < 0.5 * np.linalg.norm(untold - turn)


def test_unit_is_the_distance_of_four_neighbours_over_the_whole_clip():
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(1, 40, 3)) * np.array([1.0, 3.0, 2.0])[:, None, None]
    squared = [np.median(np.sort(cdist(frame, frame), 1)[:, 1:5] ** 2) for frame in xyz]
    np.testing.assert_allclose(automatic_unit(xyz, 0.5), 0.5 * np.sqrt(np.median(squared)))
    np.testing.assert_allclose(automatic_unit(xyz, 0.5, frames=2), 0.5 * np.sqrt((squared[0] + squared[2]) / 2))


def test_noise_of_a_track_in_pixels_and_of_one_never_seen_for_long():
    rng = np.random.default_rng(2)
    xyz = (rng.normal(size=(4, 2, 3)) * 0.01 + [0.1, 0.1, 1.0]) * np.linspace(1, 4, 4)[:, None, None]
    certain = np.ones((4, 2), bool)
    certain[1, 1] = False
    lifted, path = LiftedTracks(xyz.astype(np.float32), certain, np.arange(2)), cameras(4)
    jitter = np.tensordot(np.array([-1, 3, -3, 1]) / np.sqrt(20), lifted.xyz.astype(float), 1)[:1]
    here = lifted.xyz[1, :1].astype(float)
    pixels = np.linalg.norm(path[1].project(here + jitter)[0] - path[1].project(here)[0])
    np.testing.assert_allclose(track_noise(lifted, path.times, path), [np.sqrt(2) * pixels, 0.0], rtol=1e-4)


def test_the_best_count_is_enough_without_slack():
    rng = np.random.default_rng(3)
    xyz = rng.normal(size=(1, 60, 3)) + 0.3 * rng.normal(size=(5, 60, 3)).cumsum(0)
    lifted = LiftedTracks(xyz.astype(np.float32), np.ones((5, 60), bool), np.arange(60))
    found = choose_nodes(lifted, np.arange(5.0), 0.0, SelectionConfig(slack=0.0))
    assert found.residual <= max(min(row.residual for row in found.table), 2 * found.noise)


def test_inside_the_band_both_backends_keep_the_sign():
    """Neighbours turned by 180 degrees and a hair more: their dot product is -SIGN_BAND / 2, then -2 SIGN_BAND."""
    deformer = Deformer(np.arange(2.0), np.array([0]), np.array([[0, 1]]), 2)
    for dot, sign in ((-0.5 * SIGN_BAND, 1), (-2 * SIGN_BAND, -1), (0.5 * SIGN_BAND, 1)):
        table = np.zeros((2, 8))
        table[0, 0], table[1, :2] = 1, (dot, np.sqrt(1 - dot**2))
        assert slot_signs(table, np.array([[0, 1]])).tolist() == [[1, sign]]
        assert deformer.slot_signs(torch.tensor(table)).tolist() == [[1, sign]]


@pytest.mark.parametrize("count", [1, 3, MAX_GROUPS, MAX_GROUPS + 6])
def test_things_that_all_move_by_themselves_are_as_many_groups_as_asked_for(count):
    xyz = np.random.default_rng(4).normal(size=(8, MAX_GROUPS + 6, 3))
    assert rigid_groups(xyz, count).max() + 1 == count


def test_nodes_joined_while_both_fade_stay_where_they_are():
    """Quaternions of either sign are the same pose, and shares that do not add up to 1 are still shares."""
    place = np.array([[0.3, -0.2, 1.0], [0.1, 0.4, 1.2]])
    parts = [nodes(4, place, [0, 1]), nodes(4, place, [0, 1], sign=-1.0)]
    spans = np.array([[-1.0, 9, 10, 11], [-1.0, 9, 10, 11]])
    whole, _ = join_scaffolds(parts, spans)
    np.testing.assert_allclose(whole.xyz, parts[0].xyz, atol=1e-6)
    np.testing.assert_allclose(np.abs((whole.quat * parts[0].quat).sum(-1)), 1, atol=1e-6)
