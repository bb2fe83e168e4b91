"""Poses of nodes that an artist changed: Gaussians follow them from their old rests, in the stack as when baked."""

from dataclasses import replace

import numpy as np
import pytest
from random_scene import random_scene

from f4x_core.edit.apply import base_of, edited, with_operations
from f4x_core.edit.bake import bake
from f4x_core.edit.keys import rekeyed
from f4x_core.edit.operations import Duplicate, Recolour, Rekey, Retime, Transform, read_operation
from f4x_core.edit.selects import All, Moving
from f4x_core.edit.stack import of, read_stack, write_stack
from f4x_core.errors import F4xError
from f4x_core.geometry import dual_quaternion, pose, quaternion
from f4x_core.scaffold.deformation import node_poses_at
from f4x_core.scene import read_scene, write_scene

SCENE = random_scene(3, degree=1)
SCAFFOLD = SCENE.scaffold
FRAMES = SCENE.cameras.times


def poses(times) -> tuple[np.ndarray, np.ndarray]:
    """The scene's own poses (F,M,3), (F,M,4) of all nodes."""
    found = [node_poses_at(SCAFFOLD.times, SCAFFOLD.xyz, SCAFFOLD.quat, float(time)) for time in times]
    return np.stack([x for x, _ in found]), np.stack([q for _, q in found])


def change(nodes, times, shift=(0.3, -0.2, 0.1), turn=(0.0, 0.4, 0.0)) -> Rekey:
    """Nodes by index, held elsewhere and turned."""
    xyz, quat = poses(times)
    turn = quaternion.from_rotation_vector(np.array(turn))
    return Rekey.of(SCAFFOLD.ids[nodes], times, xyz[:, nodes] + shift, quaternion.multiply(quat[:, nodes], turn))


CHANGES = {
    "whole clip": change([0, 2], FRAMES),
    "some frames": change([1], [2.0, 3.0]),
    "all": change([0, 1, 2], FRAMES),
}


def posed_by_hand(scene, operation, time):
    """Every dynamic Gaussian blended by the plain formula from old rests to new poses."""
    xyz, quat = (part[0].astype(float) for part in poses([time]))
    if time in operation.times:
        place = [SCAFFOLD.ids.tolist().index(id) for id in operation.nodes]
        new_xyz, new_quat = operation.arrays
        xyz[place], quat[place] = (part[operation.times.index(time)] for part in (new_xyz, new_quat))
    quat = quaternion.normalize(quat)
    means = []
    for g in range(len(scene.dynamic)):
        total, first = np.zeros(8), None
        for node, weight in zip(scene.dynamic.node[g], scene.dynamic.weight[g], strict=True):
            rest = quaternion.normalize(SCAFFOLD.quat[scene.dynamic.reference[g], node].astype(float))
            inverse = pose.invert(rest, SCAFFOLD.xyz[scene.dynamic.reference[g], node].astype(float))
            part = dual_quaternion.from_pose(*pose.compose(quat[node], xyz[node], *inverse))
            first = part if first is None else first
            total += weight * part * (1 if part[:4] @ first[:4] >= 0 else -1)
        strength = scene.dynamic.strength[g]
        total = strength * total * (1 if total[0] >= 0 else -1) + (1 - strength) * dual_quaternion.IDENTITY
        q, t = dual_quaternion.to_pose(dual_quaternion.normalize(total, 1e-4))
        means.append(pose.transform(q, t, scene.dynamic.means[g].astype(float)))
    return np.array(means)


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("time", [0.0, 2.0, 5.0])
def test_posed_as_the_formula_says(name, time):
    posed = with_operations(SCENE, CHANGES[name]).posed(time)
    np.testing.assert_allclose(posed.means[posed.dynamic], posed_by_hand(SCENE, CHANGES[name], time), atol=3e-6)


def test_other_frames_and_other_nodes_stay():
    """Bit for bit at knots, to rounding at held-out clip frames."""
    scene = with_operations(SCENE, CHANGES["some frames"])
    for time in (0.0, 1.0, 4.0, 5.0):
        np.testing.assert_allclose(scene.posed(time).means, SCENE.posed(time).means, atol=1e-6)
    assert np.abs(scene.posed(2.0).means - SCENE.posed(2.0).means).max() > 0.05
    apart = ~(SCENE.dynamic.node == 1).any(1)
    posed = scene.posed(2.0)
    np.testing.assert_allclose(
        posed.means[posed.dynamic][apart], SCENE.posed(2.0).means[posed.dynamic][apart], atol=1e-6
    )


@pytest.mark.parametrize("name", CHANGES)
def test_baked_it_is_the_same_at_every_clip_frame(name, tmp_path):
    scene = base_of(with_operations(SCENE, CHANGES[name]))
    baked = bake(scene)
    assert not baked.edits and baked.scaffold.ids.tolist() == SCAFFOLD.ids.tolist()
    write_scene(baked, tmp_path / "b.f4x")
    baked = read_scene(tmp_path / "b.f4x")
    for time in FRAMES:
        np.testing.assert_allclose(baked.posed(time).means, edited(scene).posed(time).means, atol=2e-6)
        dots = (baked.posed(time).quats * edited(scene).posed(time).quats).sum(1)
        np.testing.assert_allclose(np.abs(dots), 1, atol=1e-6)


def test_between_frames_a_rest_far_before_the_clip_is_not_felt():
    scene = base_of(with_operations(SCENE, CHANGES["whole clip"]))
    ends = np.abs(bake(scene).posed(0.5).means - edited(scene).posed(0.5).means).max()
    inner = np.abs(bake(scene).posed(2.5).means - edited(scene).posed(2.5).means).max()
    assert ends < 5e-3 and inner < 2e-6


def test_changing_a_baked_scene_again():
    once = bake(base_of(with_operations(SCENE, CHANGES["whole clip"])))
    again = base_of(with_operations(once, CHANGES["all"]))
    for time in FRAMES:
        want = with_operations(SCENE, CHANGES["all"]).posed(time).means
        np.testing.assert_allclose(edited(again).posed(time).means, want, atol=3e-6)
        np.testing.assert_allclose(bake(again).posed(time).means, want, atol=3e-6)


def test_a_later_one_holds_and_undoing_gives_the_old_one_back():
    first, second = CHANGES["whole clip"], change([0], FRAMES, shift=(0, 0.5, 0))
    both = with_operations(SCENE, first, second)
    curves = rekeyed(SCENE, of(both).edits)
    np.testing.assert_array_equal(curves.xyz[:, 0], second.arrays[0][:, 0])
    np.testing.assert_array_equal(curves.xyz[:, 2], first.arrays[0][:, 1])
    undone = edited(replace(base_of(both), edits=tuple(of(both).undo().to_json())))
    np.testing.assert_array_equal(undone.posed(3.0).means, with_operations(SCENE, first).posed(3.0).means)


def test_with_other_edits():
    """Retimed parts show the changed motion at their moments; baked, everything is within the tolerance of a bake."""
    stack = [
        Recolour(Moving(), (1, 0, 0)),
        CHANGES["all"],
        Transform(Moving(), (0, 0, 1)),
        Duplicate(Moving(), (1, 0, 0)),
    ]
    scene = base_of(with_operations(SCENE, *stack))
    baked = edited(bake(scene))
    for time in FRAMES:
        want = edited(scene).posed(time)
        order = np.argsort(want.ids)
        mine = np.argsort(baked.posed(time).ids)
        np.testing.assert_allclose(baked.posed(time).means[mine], want.means[order], atol=1e-5)
    slow = with_operations(SCENE, CHANGES["all"], Retime(All(), 0.5))
    np.testing.assert_array_equal(slow.posed(4.0).means, with_operations(SCENE, CHANGES["all"]).posed(2.0).means)


def test_exact_in_the_file(tmp_path):
    file = tmp_path / "a.f4x"
    write_scene(SCENE, file)
    write_stack(file, of(SCENE).append(CHANGES["all"], "by hand"))
    (edit,) = read_stack(file).edits
    assert edit.operation == CHANGES["all"] and edit.sentence == "by hand"
    xyz, quat = edit.operation.arrays
    assert xyz.dtype == quat.dtype == np.float32 and xyz.shape == (len(FRAMES), 3, 3)


GOOD = change([0], [1.0, 2.0]).to_json()


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ({"nodes": []}, "no node"),
        ({"nodes": [1, 1]}, "twice"),
        ({"times": [2.0, 1.0]}, "increase"),
        ({"poses": "?"}, "base64"),
        ({"poses": "AAAA"}, "28"),
        ({"nodes": [0, 1]}, "28"),
        ({"poses": Rekey.of([0], [0.0], np.zeros((1, 1, 3)), np.eye(4)[None, :1]).poses[:-4]}, "28"),
    ],
)
def test_what_cannot_be_is_one_sentence(broken, words):
    with pytest.raises(F4xError, match=words):
        read_operation(GOOD | broken)


@pytest.mark.parametrize(("xyz", "quat"), [((np.nan, 0, 0), (1, 0, 0, 0)), ((0, 0, 0), (0, 0, 0, 0))])
def test_poses_that_are_none(xyz, quat):
    with pytest.raises(F4xError, match="poses"):
        Rekey.of([0], [0.0], np.array([[xyz]]), np.array([[quat]]))


def test_nodes_that_are_not_there():
    with pytest.raises(F4xError, match=r"edit 1 \(rekey\).*no node 999"):
        with_operations(SCENE, Rekey.of([999], [0.0], np.zeros((1, 1, 3)), np.eye(4)[None, :1]))
