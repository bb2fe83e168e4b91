"""Spherical harmonics: orthonormal, in the published order and signs, exactly rotatable."""

import numpy as np
import pytest
import torch

from f4x_core.geometry import quaternion
from f4x_core.geometry import spherical_harmonics as sh


@pytest.fixture
def random():
    return np.random.default_rng(3)


def test_basis_is_orthonormal_by_monte_carlo(random):
    directions = random.normal(size=(200_000, 3))
    values = sh.basis(directions, 4)
    gram = 4 * np.pi * values.T @ values / len(values)
    np.testing.assert_allclose(gram, np.eye(25), atol=0.03)


def test_basis_has_the_signs_and_order_of_3d_gaussian_splatting():
    """Degree 1 is (-y, z, -x) C1; degree 2 and 3 spot values from the published polynomials at (0.6, 0, 0.8)."""
    values = sh.basis(np.array([0.6, 0.0, 0.8]), 3)
    np.testing.assert_allclose(
        values[:4], [0.28209479177387814, 0, 0.4886025119029199 * 0.8, -0.4886025119029199 * 0.6]
    )
    np.testing.assert_allclose(values[6], 0.31539156525252005 * (2 * 0.64 - 0.36))
    np.testing.assert_allclose(values[7], -1.0925484305920792 * 0.48)
    np.testing.assert_allclose(values[13], -0.4570457994644658 * 0.6 * (4 * 0.64 - 0.36))
    np.testing.assert_allclose(values[15], -0.5900435899266435 * 0.6 * 0.36)
    off_axis = sh.basis(np.array([0.0, 0.6, 0.8]), 3)
    np.testing.assert_allclose(off_axis[1], -0.4886025119029199 * 0.6)
    np.testing.assert_allclose(off_axis[5], -1.0925484305920792 * 0.48)
    np.testing.assert_allclose(off_axis[9], 0.5900435899266435 * 0.6 * 0.36)


@pytest.mark.parametrize("degree", range(5))
def test_rotation_turns_the_coloured_sphere_exactly(degree, random):
    coefficients = random.normal(size=(40, (degree + 1) ** 2, 3))
    q = quaternion.normalize(random.normal(size=(40, 4)))
    directions = random.normal(size=(40, 3))
    turned = sh.evaluate(sh.rotate(coefficients, q), quaternion.rotate(q, directions))
    np.testing.assert_allclose(turned, sh.evaluate(coefficients, directions), atol=1e-12)


def test_rotations_compose_and_keep_the_energy_of_each_band(random):
    coefficients = random.normal(size=(10, 25, 3))
    a, b = quaternion.normalize(random.normal(size=(2, 10, 4)))
    both = sh.rotate(coefficients, quaternion.multiply(a, b))
    np.testing.assert_allclose(both, sh.rotate(sh.rotate(coefficients, b), a), atol=1e-11)
    for band in range(5):
        part = slice(band**2, (band + 1) ** 2)
        np.testing.assert_allclose((both[:, part] ** 2).sum((1, 2)), (coefficients[:, part] ** 2).sum((1, 2)))
    np.testing.assert_allclose(sh.rotate(coefficients, quaternion.IDENTITY), coefficients, atol=1e-12)


def test_rotation_keeps_dtype_and_accepts_nothing(random):
    coefficients = random.normal(size=(5, 9, 3)).astype(np.float32)
    assert sh.rotate(coefficients, np.array([0.0, 1, 0, 0], np.float32)).dtype == np.float32
    assert sh.rotate(coefficients[:0], np.zeros((0, 4))).shape == (0, 9, 3)


def test_direct_colour_round_trip_and_clamp(random):
    rgb = random.uniform(size=(7, 3))
    np.testing.assert_allclose(sh.rgb_from_dc(sh.dc_from_rgb(rgb)), rgb)
    np.testing.assert_allclose(sh.evaluate(sh.dc_from_rgb(rgb)[:, None], np.ones((7, 3))), rgb)
    assert (sh.evaluate(np.full((1, 1, 3), -9.0), np.ones((1, 3))) == 0).all()


def test_numpy_equals_torch_with_gradients(random):
    coefficients, directions = random.normal(size=(4, 25, 3)), random.normal(size=(4, 3))
    tensors = [torch.tensor(array, requires_grad=True) for array in (coefficients, directions)]
    np.testing.assert_allclose(
        sh.evaluate(*tensors).detach().numpy(), sh.evaluate(coefficients, directions), atol=1e-13
    )
    assert torch.autograd.gradcheck(lambda d: sh.basis(d, 4), tensors[1])
    zero = torch.zeros(1, 3, requires_grad=True)
    (gradient,) = torch.autograd.grad(sh.basis(zero, 4).sum(), zero)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("wrong", [0, 2, 36])
def test_wrong_number_of_coefficients_is_refused(wrong):
    with pytest.raises(ValueError, match="1, 4, 9, 16 or 25"):
        sh.evaluate(np.zeros((1, wrong, 3)), np.ones((1, 3)))
