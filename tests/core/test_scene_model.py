"""Posing against a plain loop, colours in the Gaussian's own frame, identity, and what a scene refuses."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene
from random_scene import random_scene

from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.scaffold.deformation import node_poses_at
from f4x_core.scene import DynamicSet, StaticSet


def matrix(q):
    """Rotation matrix of one quaternion, float64."""
    return quaternion.to_matrix(np.asarray(q, np.float64))


def dual_quaternion(R, t):
    """(p (4,), d (4,)) of x -> R x + t, by the definition d = (0, t) p / 2."""
    p = quaternion.from_matrix(R)
    return p, 0.5 * quaternion.multiply(np.array([0, *t]), p)


def posed_by_loop(scene, time):
    """One Gaussian at a time, the blend written out with matrices: (means, rotation matrices)."""
    scaffold, dynamic = scene.scaffold, scene.dynamic
    x_now, q_now = node_poses_at(scaffold.times, scaffold.xyz.astype(float), scaffold.quat.astype(float), time)
    means, rotations = [], []
    for g in range(len(dynamic)):
        P, D, sign_of = np.zeros(4), np.zeros(4), None
        for k in range(dynamic.node.shape[1]):
            n, r = dynamic.node[g, k], dynamic.reference[g]
            R = matrix(q_now[n]) @ matrix(scaffold.quat[r, n]).T
            p, d = dual_quaternion(R, x_now[n] - R @ scaffold.xyz[r, n].astype(float))
            sign_of = p if sign_of is None else sign_of
            s = 1 if p @ sign_of >= 0 else -1
            P, D = P + s * dynamic.weight[g, k] * p, D + s * dynamic.weight[g, k] * d
        if P[0] < 0:
            P, D = -P, -D
        o = float(dynamic.strength[g])
        P, D = o * P + (1 - o) * np.array([1, 0, 0, 0]), o * D
        n = np.linalg.norm(P)
        p, d = P / n, D / n - P * (P @ D) / n**3
        t = 2 * quaternion.multiply(d, quaternion.conjugate(p))[1:]
        means.append(matrix(p) @ dynamic.means[g] + t)
        rotations.append(matrix(p) @ matrix(dynamic.quats[g]))
    return np.array(means), np.array(rotations)


@pytest.mark.parametrize("time", [0, 1.0, 2.0, 2.7, 5.0, 6.0])
def test_posed_equals_plain_loop(time):
    scene = random_scene()
    posed = scene.posed(time)
    means, rotations = posed_by_loop(scene, time)
    assert posed.dynamic.sum() == len(scene.dynamic) and not posed.dynamic[: len(scene.static)].any()
    np.testing.assert_allclose(posed.means[posed.dynamic], means, atol=2e-6)
    np.testing.assert_allclose(quaternion.to_matrix(posed.quats[posed.dynamic]), rotations, atol=2e-6)
    np.testing.assert_array_equal(posed.means[~posed.dynamic], scene.static.means)
    assert posed.means.dtype == posed.quats.dtype == np.float32


def test_gaussians_stand_at_their_stored_place_at_their_reference_time():
    scene = random_scene()
    for r, time in enumerate(scene.scaffold.times):
        here = scene.dynamic.reference == r
        posed = scene.posed(time).means[len(scene.static) :]
        np.testing.assert_allclose(posed[here], scene.dynamic.means[here], atol=1e-6)


def test_scene_without_motion():
    scene = random_scene(dynamic=0)
    posed = scene.posed(3.5)
    np.testing.assert_array_equal(posed.means, scene.static.means)
    np.testing.assert_array_equal(posed.ids, scene.static.ids)
    assert not posed.dynamic.any() and scene.info()["nodes"] == 0


def test_scene_with_moving_gaussians_only():
    scene = random_scene()
    alone = replace(scene, static=StaticSet.empty())
    np.testing.assert_array_equal(alone.posed(2.5).means, scene.posed(2.5).means[len(scene.static) :])
    assert alone.posed(2.5).sh.shape == (len(scene.dynamic), 4, 3)


def test_smaller_sh_degree_is_padded():
    scene = random_scene(degree=2)
    flat = replace(scene, dynamic=replace(scene.dynamic, sh=scene.dynamic.sh[:, :1]))
    camera = scene.cameras[0]
    posed = flat.posed(1.0)
    expected = np.maximum(spherical_harmonics.rgb_from_dc(scene.dynamic.sh[:, 0]), 0)
    np.testing.assert_allclose(flat.colors(posed, camera)[posed.dynamic], expected, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_colors_equal_world_axes_harmonics_turned_by_the_gaussian(degree):
    scene = random_scene(degree=degree)
    camera = scene.cameras[3]
    posed = scene.posed(4.2)
    world_sh = spherical_harmonics.rotate(posed.sh.astype(np.float64), posed.quats)
    expected = spherical_harmonics.evaluate(world_sh, posed.means - camera.center)
    np.testing.assert_allclose(scene.colors(posed, camera), expected, atol=2e-5)


def test_info_counts_and_bytes():
    info = random_scene().info()
    assert (info["static"], info["dynamic"], info["nodes"], info["frames"]) == (30, 20, 5, 6)
    assert info["megabytes"]["static"] == pytest.approx(30 * (8 + 4 * (3 + 4 + 3 + 1 + 12)) / 1e6)
    assert info["sh_degree"] == 1 and info["size"] == [64, 40]


def test_next_id_is_past_every_id_and_never_falls():
    assert random_scene().next_id == 50
    assert random_scene(next_id=99).next_id == 99


def test_take_keeps_ids():
    part = random_scene().dynamic.take(np.array([7, 3]))
    assert isinstance(part, DynamicSet) and part.ids.tolist() == [37, 33]


def changed(part, **arrays):
    """A function that replaces arrays of one part of a scene."""
    return lambda scene: replace(scene, **{part: replace(getattr(scene, part), **arrays)})


def altered(array, index, value):
    array = array.copy()
    array[index] = value
    return array


BASE = random_scene()
BAD = {
    "ids occur twice": changed("static", ids=altered(BASE.static.ids, 0, 40)),
    "id is negative": changed("static", ids=altered(BASE.static.ids, 0, -1)),
    "NaN": changed("static", means=altered(BASE.static.means, (3, 1), np.nan)),
    "logarithm": changed("dynamic", scales=altered(BASE.dynamic.scales, (0, 0), -2)),
    "logit": changed("static", opacities=altered(BASE.static.opacities, 0, 1.5)),
    "zero quaternion": changed("dynamic", quats=altered(BASE.dynamic.quats, 4, 0)),
    "static/scale has the shape": changed("static", scales=BASE.static.scales[:-1]),
    "static/xyz must be an array of float32": changed("static", means=BASE.static.means.astype(int)),
    "spherical harmonics": changed("static", sh=BASE.static.sh[:, :3]),
    "sum to 1": changed("dynamic", weight=BASE.dynamic.weight * 2, strength=np.ones(20, np.float32)),
    "weight has negative": changed("dynamic", weight=-BASE.dynamic.weight),
    "strength leaves": changed("dynamic", strength=BASE.dynamic.strength + 1),
    "dynamic/node points outside": changed("dynamic", node=altered(BASE.dynamic.node, (0, 0), 5)),
    "dynamic/reference points outside": changed("dynamic", reference=altered(BASE.dynamic.reference, 0, -1)),
    "no scaffold": lambda scene: replace(scene, scaffold=None),
    "held_out": lambda scene: replace(scene, held_out=(6,)),
    "fps": lambda scene: replace(scene, fps=0.0),
    "one row for each": lambda scene: replace(scene, extra={"static/latent": np.zeros((29, 2))}),
    "64-bit": lambda scene: replace(scene, next_id=1 << 63),
}


@pytest.mark.parametrize("words", BAD)
def test_refuses(words):
    with pytest.raises(F4xError, match=words):
        BAD[words](BASE)


def test_strength_zero_needs_no_weights():
    idle = replace(BASE.dynamic, weight=BASE.dynamic.weight * 0, strength=BASE.dynamic.strength * 0)
    posed = replace(BASE, dynamic=idle).posed(3.3)
    np.testing.assert_allclose(posed.means[posed.dynamic], BASE.dynamic.means, atol=1e-6)


def test_the_background_is_what_stands_without_features():
    scene = labelled_scene()
    still = scene.background
    assert not len(still.dynamic) and still.scaffold is None and still.features is None
    np.testing.assert_array_equal(still.static.means, scene.static.means)
