"""Compiled deformation against the torch one in float64: values, all gradients, hard cases, threads, and playback."""

import numpy as np
import pytest
import torch

from f4x_core.geometry import dual_quaternion, pose, quaternion
from f4x_core.scaffold.deformation import SIGN_BAND, blend, pairs_of, relative_motions
from f4x_core.scaffold.deformation.native import library
from f4x_core.scaffold.deformation.native.autograd import GaussianTensors, NativeDeformer, NodeTensors, SkinningData
from f4x_core.scaffold.deformation.sparse import Deformer
from f4x_core.scaffold.skinning import skinning_weights
from f4x_core.scaffold.structure import NodePoses

VALUE_ERROR, GRADIENT_ERROR = 2e-6, 2e-5


pytestmark = pytest.mark.usefixtures("native_library")


FRAMES, NODES = 4, 12


def make(number=301, slots=8, times=1, with_dw=False, seed=0, turn=1.0):
    """Leaves (float32 arrays), neighbours, references and mask. `turn`: radians that a node turns until each time."""
    rng = np.random.default_rng(seed)
    neighbours = np.stack([rng.permutation(NODES)[:slots] for _ in range(number)] or [np.zeros(slots, int)])[:number]
    axis = quaternion.normalize(rng.normal(size=(times, NODES, 4)))[..., 1:]
    then = quaternion.normalize(rng.normal(size=(NODES, 4)))
    leaves = {
        "xyz": 0.3 * rng.normal(size=(number, 3)),
        "quat": rng.normal(size=(number, 4)),
        "dw": 0.2 * rng.normal(size=(number, slots)) if with_dw else None,
        "node_xyz": 0.5 * rng.normal(size=(NODES, 3)) + 0.1 * rng.normal(size=(FRAMES, NODES, 3)),
        "node_quat": (then + 0.1 * rng.normal(size=(FRAMES, NODES, 4))) * rng.uniform(0.5, 2, (FRAMES, NODES, 1)),
        "radius": rng.uniform(0.2, 0.6, NODES),
        "now_xyz": 0.5 * rng.normal(size=(times, NODES, 3)),
        "now_quat": 1.3 * quaternion.multiply(quaternion.from_rotation_vector(turn * axis), then),
    }
    mask = rng.random((number, slots)) > 0.2
    mask[:, 0] = True
    carried = {"neighbours": neighbours, "reference": rng.integers(0, FRAMES, number), "mask": mask}
    return {name: None if a is None else a.astype(np.float32) for name, a in leaves.items()}, carried


def plain(leaves, carried, kernel):
    """Every Gaussian by itself."""
    neighbours, mask = torch.as_tensor(carried["neighbours"]), torch.as_tensor(carried["mask"])
    reference = torch.as_tensor(carried["reference"])[:, None]
    node_x = leaves["node_xyz"][reference, neighbours]  # (N,K,3)
    node_q = quaternion.normalize(leaves["node_quat"])[reference, neighbours]
    x = pose.transform(node_q[:, 0], node_x[:, 0], leaves["xyz"])
    q = quaternion.multiply(node_q[:, 0], quaternion.normalize(leaves["quat"]))
    weights, _ = skinning_weights(x, node_x, leaves["radius"][neighbours], mask, leaves["dw"], kernel)
    for now_x, now_q in zip(leaves["now_xyz"], quaternion.normalize(leaves["now_quat"]), strict=True):
        motion = pose.compose(now_q[neighbours], now_x[neighbours], *pose.invert(node_q, node_x))
        relative = dual_quaternion.from_pose(*motion)  # (N,K,8)
        agree = (relative[..., :4] * relative[:, :1, :4]).sum(-1)
        signed = torch.where(agree < -SIGN_BAND, -weights, weights)
        blended = dual_quaternion.normalize((signed[..., None] * relative).sum(1))
        turn, shift = dual_quaternion.to_pose(blended)
        yield quaternion.rotate(turn, x) + shift, quaternion.multiply(turn, q)


def native(leaves, carried, kernel, threads=1):
    deformer = Deformer(np.arange(FRAMES), carried["reference"], carried["neighbours"], NODES)
    skinning = SkinningData.of(deformer, torch.as_tensor(carried["mask"]), kernel, threads)
    gaussians = GaussianTensors(leaves["xyz"], leaves["quat"], leaves["dw"])
    nodes = NodeTensors(leaves["node_xyz"], leaves["node_quat"], leaves["radius"])
    return skinning.deform(gaussians, nodes, NodePoses(leaves["now_xyz"], quaternion.normalize(leaves["now_quat"])))


def run(function, arrays, *arguments, dtype, seeds=None):
    """Values and gradients of a random linear functional of them; `seeds` replaces it."""
    leaves = {k: None if a is None else torch.tensor(a, dtype=dtype, requires_grad=True) for k, a in arrays.items()}
    values = [part for moved in function(leaves, *arguments) for part in moved]
    generator = torch.Generator().manual_seed(1)
    seeds = seeds or [torch.randn(v.shape, generator=generator, dtype=torch.float32) for v in values]
    torch.autograd.backward(values, [seed.to(dtype) for seed in seeds])
    gradients = {k: leaf.grad.numpy() for k, leaf in leaves.items() if leaf is not None}
    return [v.detach().numpy() for v in values], gradients


def relative(a, b):
    """Relative L2 error; gradients that are 0 in truth, as those of weights with one neighbour, are measured against 1."""
    return np.linalg.norm(a - b) / max(np.linalg.norm(b), 1)


def compare(arrays, carried, kernel="sigma", threads=1):
    expected, slow = run(plain, arrays, carried, kernel, dtype=torch.float64)
    got, fast = run(native, arrays, carried, kernel, threads, dtype=torch.float32)
    for a, b in zip(got, expected, strict=True):
        assert np.isfinite(a).all() and relative(a, b) < VALUE_ERROR
    assert fast.keys() == slow.keys()
    for name, gradient in fast.items():
        assert np.isfinite(gradient).all(), name
        assert relative(gradient, slow[name]) < GRADIENT_ERROR, (name, relative(gradient, slow[name]))
    return got, fast


@pytest.mark.parametrize("with_dw", [False, True])
@pytest.mark.parametrize("kernel", ["sigma", "paper"])
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("slots", [1, 3, 8, 12])
def test_values_and_gradients(slots, times, kernel, with_dw):
    compare(*make(slots=slots, times=times, with_dw=with_dw), kernel)


@pytest.mark.parametrize("number", [1, 7, 8, 9])
def test_few_gaussians(number):
    compare(*make(number=number, times=2))


def test_no_gaussians():
    arrays, carried = make(number=0)
    values, gradients = run(native, arrays, carried, "sigma", dtype=torch.float32)
    assert [v.shape for v in values] == [(0, 3), (0, 4)]
    assert not any(gradient.any() for gradient in gradients.values())


def test_a_radius_at_its_lower_bound_has_no_gradient():
    arrays, carried = make(number=1, slots=2)
    arrays["node_xyz"][:, carried["neighbours"][0]] = 0
    arrays["xyz"][:] = 1e-6  # within reach of the bound
    arrays["radius"][carried["neighbours"][0, 0]] = 0
    _, gradients = run(native, arrays, carried, "paper", dtype=torch.float32)
    assert gradients["radius"].any() and not gradients["radius"][carried["neighbours"][0, 0]]


def test_corrections_that_cancel_every_weight_leave_the_gaussian_at_rest():
    arrays, carried = make(number=9, slots=1, with_dw=True)
    arrays["xyz"][:] = 0  # the raw weight on the node itself is 1 + floor
    arrays["dw"][:] = -np.float32(1) - np.float32(1e-6)
    (means, _), gradients = run(native, arrays, carried, "sigma", dtype=torch.float32)
    expected = arrays["node_xyz"][carried["reference"], carried["neighbours"][:, 0]]
    np.testing.assert_allclose(means, expected, atol=1e-6)
    assert all(np.isfinite(gradient).all() for gradient in gradients.values())
    assert not gradients["now_xyz"].any()


@pytest.mark.parametrize("threads", [2, 3, 4])
def test_threads_change_no_bit(threads):
    arrays, carried = make(number=4001, times=2, with_dw=True)  # enough Gaussians for several parts of the sums
    one, of_one = run(native, arrays, carried, "sigma", 1, dtype=torch.float32)
    got, gradients = run(native, arrays, carried, "sigma", threads, dtype=torch.float32)
    for a, b in zip(got, one, strict=True):
        np.testing.assert_array_equal(a, b)
    for name, gradient in gradients.items():
        np.testing.assert_array_equal(gradient, of_one[name])
    compare(arrays, carried, threads=threads)


def test_gradients_of_many_pairs_are_the_sums_of_few_and_the_same_for_every_number_of_threads():
    rng, frames, nodes, times = np.random.default_rng(5), 20, 100, 2
    pairs = frames * nodes
    shapes = {"node_xyz": (frames, nodes, 3), "node_quat": (frames, nodes, 4), "now_xyz": (times, nodes, 3)}
    given = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    given |= {"radius": np.ones(nodes, np.float32), "now_quat": np.float32([[[0.6, 0, 0.8, 0]] * nodes] * times)}
    then, sent = rng.permutation(pairs), rng.normal(size=(1 + times, pairs, 8)).astype(np.float32)

    def gradients(rows, threads=1):
        own = {"then": then[rows], "node": then[rows] % nodes}
        return library.relate_backward(given | own, sent[:, rows], threads)

    whole = gradients(slice(None))
    few = [gradients(slice(first, first + 400)) for first in range(0, pairs, 400)]
    for name, value in whole.items():
        np.testing.assert_allclose(value, sum(part[name].astype(float) for part in few), rtol=1e-4, atol=1e-4)
        for threads in (2, 5):
            np.testing.assert_array_equal(gradients(slice(None), threads)[name], value)


def test_views_are_read_like_copies():
    arrays, carried = make()
    one, expected = run(native, arrays, carried, "sigma", dtype=torch.float32)

    def strided(leaves, *arguments):
        spread = {k: None if a is None else torch.stack([a, a + 1], -1)[..., 0] for k, a in leaves.items()}
        assert not spread["xyz"].is_contiguous()
        return native(spread, *arguments)

    turned = {name: np.asfortranarray(a) for name, a in carried.items()}
    seeds = [torch.ones(1).expand(v.shape) for v in one]  # strides of 0, as sum() sends them
    values, gradients = run(strided, arrays, turned, "sigma", dtype=torch.float32, seeds=seeds)
    plain_values, plain_gradients = run(native, arrays, carried, "sigma", dtype=torch.float32, seeds=seeds)
    for a, b in zip(values, plain_values, strict=True):
        np.testing.assert_array_equal(a, b)
    for name, gradient in gradients.items():
        np.testing.assert_array_equal(gradient, plain_gradients[name])
        assert relative(gradient, expected[name]) > 0.1  # another functional: the seeds were read


def test_one_output_alone():
    arrays, carried = make(times=2)
    leaves = {k: None if a is None else torch.tensor(a, requires_grad=True) for k, a in arrays.items()}
    native(leaves, carried, "sigma")[1][0].sum().backward()
    assert not leaves["now_xyz"].grad[0].any() and leaves["now_xyz"].grad[1].any() and not leaves["quat"].grad.any()


def test_deformer_equals_the_torch_one():
    arrays, carried = make(number=500, slots=4, with_dw=True)
    start = [arrays[name] for name in ("xyz", "quat", "dw", "node_xyz", "node_quat", "radius")]
    mask, reference = torch.from_numpy(carried["mask"]), carried["reference"]
    deformer = Deformer(np.array([0.0, 1, 2, 4]), reference, carried["neighbours"], NODES)
    fast = NativeDeformer(deformer, mask, "sigma", 2)

    def slow(gaussians, nodes, times):
        xyz, quat, dw = gaussians
        node_xyz, node_quat, radius = nodes
        attach = reference, carried["neighbours"][:, 0]
        node_q = quaternion.normalize(node_quat)[attach]
        x = pose.transform(node_q, node_xyz[attach], xyz)
        q = quaternion.multiply(node_q, quaternion.normalize(quat))
        weights, _ = deformer.skinning(x, node_xyz, radius, mask, dw)
        for time in times:
            turn, shift = deformer(node_xyz, node_quat, weights, None, time)
            yield quaternion.rotate(turn, x) + shift, quaternion.multiply(turn, q)

    results = []
    for function, dtype in ((slow, torch.float64), (fast, torch.float32)):
        leaves = [torch.tensor(a, dtype=dtype, requires_grad=True) for a in start]
        values = [
            part
            for moved in function(GaussianTensors(*leaves[:3]), NodeTensors(*leaves[3:]), (2.0, 3.3))
            for part in moved
        ]
        sum((v * v.detach().roll(1, 0)).sum() for v in values).backward()
        results.append([v.detach().numpy() for v in values] + [leaf.grad.numpy() for leaf in leaves])
    for got, expected in zip(*results[::-1], strict=True):
        assert relative(got, expected) < GRADIENT_ERROR


# ---- playback --------------------------------------------------------------------------------------------------------


def make_playback(number=1003, slots=8, dtype=np.float32):
    arrays, carried = make(number, slots)
    rng = np.random.default_rng(0)
    pairs = pairs_of(carried["neighbours"], carried["reference"])
    table = relative_motions(np.arange(FRAMES), arrays["node_xyz"], arrays["node_quat"], pairs, 1.4)
    table = table * rng.choice([-1, 1], (len(table), 1))
    weights = rng.random((number, slots)) * carried["mask"]
    weights /= weights.sum(1, keepdims=True)
    return table.astype(dtype), pairs.index, weights.astype(dtype), arrays["xyz"], arrays["quat"]


@pytest.mark.parametrize("fades", [False, True])
@pytest.mark.parametrize("slots", [1, 8, 11])
def test_playback_equals_numpy(slots, fades, monkeypatch):
    *blended, means, quats = make_playback(slots=slots)
    strength = np.random.default_rng(1).choice([0, 0.3, 1] if fades else [1], len(means)).astype(np.float32)
    fast = library.move_gaussians(*blended, strength, means, quats)
    monkeypatch.setattr(library, "open_library", lambda: (None, "left out"))
    slow = library.move_gaussians(*blended, strength, means, quats)
    for a, b in zip(fast, slow, strict=True):
        assert a.dtype == b.dtype == np.float32
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_playback_of_other_dtypes_stays_in_numpy():
    *blended, means, quats = make_playback(number=5, dtype=np.float64)
    q, t = blend(*blended, np.ones(5))
    for one in (means, means.astype(np.float64)):  # some of another type, and all
        moved, _ = library.move_gaussians(*blended, np.ones(5), one, quats.astype(one.dtype))
        np.testing.assert_array_equal(moved, quaternion.rotate(q, one) + t)
