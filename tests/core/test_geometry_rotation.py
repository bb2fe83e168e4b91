"""Quaternions, poses, dual quaternions: against scipy, numpy against torch, gradients at the hard places."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from f4x_core.geometry import dual_quaternion, pose, quaternion

DEGENERATE = {
    "identity": [1.0, 0, 0, 0],
    "half turn": [0.0, 1, 0, 0],
    "almost half turn": [1e-9, 0, 0.6, 0.8],
    "minus identity": [-1.0, 0, 0, 0],
    "tiny turn": [1.0, 1e-9, 0, 0],
}


@pytest.fixture
def random():
    return np.random.default_rng(7)


def unit(random, *shape):
    return quaternion.normalize(random.normal(size=(*shape, 4)))


def as_scipy(q):
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


def same_rotation(a, b, tolerance=1e-12):
    np.testing.assert_allclose(np.abs((a * b).sum(-1)), 1, rtol=0, atol=tolerance)


def test_quaternions_agree_with_scipy(random):
    a, b, v = unit(random, 200), unit(random, 200), random.normal(size=(200, 3))
    sa, sb = as_scipy(a), as_scipy(b)
    np.testing.assert_allclose(quaternion.rotate(a, v), sa.apply(v), atol=1e-13)
    np.testing.assert_allclose(quaternion.rotate(3.7 * a, v), sa.apply(v), atol=1e-13)
    np.testing.assert_allclose(quaternion.to_matrix(-0.2 * a), sa.as_matrix(), atol=1e-14)
    same_rotation(quaternion.multiply(a, b), (sa * sb).as_quat()[:, [3, 0, 1, 2]])
    same_rotation(quaternion.from_matrix(sa.as_matrix()), a)
    np.testing.assert_allclose(quaternion.to_rotation_vector(a), sa.as_rotvec(), atol=1e-13)
    same_rotation(quaternion.from_rotation_vector(sa.as_rotvec()), a)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 0.00999, 0.01001, 1.0, 3.1, np.pi - 1e-9])
def test_rotation_vectors_are_exact_across_the_series_switch(angle, random):
    axis = random.normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    q = quaternion.from_rotation_vector(vector)
    np.testing.assert_allclose(q[[1, 2, 3, 0]], Rotation.from_rotvec(vector).as_quat(), atol=1e-15)
    np.testing.assert_allclose(quaternion.to_rotation_vector(q), vector, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", DEGENERATE)
def test_matrix_round_trip_where_square_roots_fail(name):
    q = quaternion.normalize(np.array(DEGENERATE[name]))
    recovered = quaternion.from_matrix(quaternion.to_matrix(q))
    same_rotation(recovered, q)
    assert recovered[0] >= 0


def test_zero_quaternion_is_the_identity():
    zero, v = np.zeros(4), np.array([1.0, 2, 3])
    np.testing.assert_array_equal(quaternion.normalize(zero), quaternion.IDENTITY)
    np.testing.assert_array_equal(quaternion.rotate(zero, v), v)
    np.testing.assert_array_equal(quaternion.to_matrix(zero), np.eye(3))


def test_slerp_takes_the_shorter_arc_at_constant_speed(random):
    a = unit(random, 50)
    vector = random.uniform(-1.8, 1.8, size=(50, 3))  # shorter than pi
    b = -quaternion.multiply(a, quaternion.from_rotation_vector(vector))  # the sign must not matter
    for fraction in (0.0, 0.25, 1.0):
        expected = quaternion.multiply(a, quaternion.from_rotation_vector(fraction * vector))
        same_rotation(quaternion.slerp(a, b, fraction), expected)


def test_align_sequence_leaves_no_flip_along_any_axis(random):
    path = quaternion.from_rotation_vector(np.cumsum(random.normal(size=(40, 3, 3)) * 0.1, axis=0))
    flipped = path * random.choice([-1.0, 1.0], size=(40, 3, 1))
    aligned = quaternion.align_sequence(flipped)
    assert ((aligned[1:] * aligned[:-1]).sum(-1) > 0).all()
    np.testing.assert_array_equal(aligned[0], flipped[0])
    np.testing.assert_array_equal(quaternion.align_sequence(flipped.swapaxes(0, 1), axis=1), aligned.swapaxes(0, 1))


def test_poses_compose_like_matrices(random):
    qa, ta, qb, tb, x = unit(random, 20), random.normal(size=(20, 3)), unit(random, 20), *random.normal(size=(2, 20, 3))
    product = pose.to_matrix(*pose.compose(qa, ta, qb, tb))
    np.testing.assert_allclose(product, pose.to_matrix(qa, ta) @ pose.to_matrix(qb, tb), atol=1e-13)
    np.testing.assert_allclose(pose.to_matrix(*pose.invert(qa, ta)), np.linalg.inv(pose.to_matrix(qa, ta)), atol=1e-13)
    np.testing.assert_allclose(pose.transform(*pose.from_matrix(product), x), (product @ homogeneous(x))[:, :3, 0])


def homogeneous(x):
    return np.concatenate([x, np.ones_like(x[:, :1])], axis=1)[..., None]


def test_align_similarity_recovers_the_motion_despite_weighted_out_outliers(random):
    p = random.normal(size=(30, 3))
    rotation = as_scipy(unit(random)).as_matrix()
    q = 2.5 * p @ rotation.T + [1, -2, 3]
    q[:5] += 10
    s, R, t = pose.align_similarity(p, q, weights=np.arange(30) >= 5)
    np.testing.assert_allclose(s, 2.5)
    np.testing.assert_allclose(R, rotation, atol=1e-12)
    np.testing.assert_allclose(t, [1, -2, 3], atol=1e-12)
    assert pose.align_similarity(p, q, with_scale=False)[0] == 1.0


def test_align_similarity_never_mirrors(random):
    p = random.normal(size=(30, 3))
    s, R, _ = pose.align_similarity(p, p * [1, 1, -1])
    assert np.linalg.det(R) == pytest.approx(1)
    assert s > 0
    flat = p * [1, 1, 0]
    _, R, _ = pose.align_similarity(flat, flat @ Rotation.from_euler("x", 90, degrees=True).as_matrix().T)
    np.testing.assert_allclose(R, Rotation.from_euler("x", 90, degrees=True).as_matrix(), atol=1e-12)


def test_dual_quaternion_algebra(random):
    qa, ta, qb, tb = unit(random, 20), random.normal(size=(20, 3)), unit(random, 20), random.normal(size=(20, 3))
    a, b = dual_quaternion.from_pose(qa, ta), dual_quaternion.from_pose(qb, tb)
    q, t = dual_quaternion.to_pose(dual_quaternion.multiply(a, b))
    expected_q, expected_t = pose.compose(qa, ta, qb, tb)
    np.testing.assert_allclose(q, expected_q, atol=1e-13)
    np.testing.assert_allclose(t, expected_t, atol=1e-13)
    np.testing.assert_allclose(dual_quaternion.normalize(3 * a), a, atol=1e-13)
    real, dual = np.split(dual_quaternion.normalize(0.7 * a + 0.3 * b), 2, axis=-1)
    np.testing.assert_allclose((real * real).sum(-1), 1)
    np.testing.assert_allclose((real * dual).sum(-1), 0, atol=1e-13)
    np.testing.assert_array_equal(dual_quaternion.normalize(np.full(8, 1e-6)), dual_quaternion.IDENTITY)


def functions():
    vectors = slice(None, 3)
    yield "normalize", quaternion.normalize
    yield "rotate", lambda q: quaternion.rotate(q, q[..., vectors])
    yield "to_matrix", quaternion.to_matrix
    yield "from_matrix", lambda q: quaternion.from_matrix(quaternion.to_matrix(q))
    yield "rotation_vector", lambda q: quaternion.to_rotation_vector(quaternion.normalize(q))
    yield "from_rotation_vector", lambda q: quaternion.from_rotation_vector(q[..., 1:])
    yield "slerp", lambda q: quaternion.slerp(quaternion.normalize(q), quaternion.normalize(q)[..., [1, 0, 3, 2]], 0.3)
    yield "dual", lambda q: dual_quaternion.normalize(dual_quaternion.from_pose(q, q[..., vectors]))
    yield "dual to pose", lambda q: dual_quaternion.to_pose(dual_quaternion.from_pose(q, q[..., vectors]))[1]
    yield "pose matrix", lambda q: pose.to_matrix(*pose.invert(q, q[..., vectors]))
    yield "align", quaternion.align_sequence


@pytest.mark.parametrize("name, function", list(functions()))
def test_numpy_equals_torch_and_gradients_are_right(name, function, random):
    q = unit(random, 6) * random.uniform(0.5, 2, size=(6, 1))
    tensor = torch.tensor(q, requires_grad=True)
    result = function(tensor)
    np.testing.assert_allclose(result.detach().numpy(), function(q), atol=1e-13)
    assert torch.autograd.gradcheck(function, tensor)
    assert function(q.astype(np.float32)).dtype == np.float32
    assert function(tensor.float()).dtype == torch.float32


@pytest.mark.parametrize("name, function", list(functions()))
@pytest.mark.parametrize("place", [*DEGENERATE, "zero"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_degenerate_rotations(name, function, place, dtype):
    q = torch.tensor([DEGENERATE.get(place, [0.0] * 4)] * 2, dtype=dtype, requires_grad=True)
    result = function(q)
    (gradient,) = torch.autograd.grad(result.sum(), q)
    assert torch.isfinite(result).all()
    assert torch.isfinite(gradient).all()


def test_rotation_vector_gradient_at_identity_is_the_analytic_one():
    q = torch.tensor(quaternion.IDENTITY, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(quaternion.to_rotation_vector, q)
    np.testing.assert_allclose(jacobian[:, 1:].numpy(), 2 * np.eye(3))
    vector = torch.zeros(3, dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(quaternion.from_rotation_vector, vector)
    np.testing.assert_allclose(jacobian[1:].numpy(), np.eye(3) / 2)
