"""Parameter sets, surgery with optimiser state, spawning and density control."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from f4x_core.gaussians import SetOptimiser, SpawnConfig, Spawned, appearance, spawn_dynamic, spawn_static
from f4x_core.gaussians.parameters import localise, opacity_logit
from f4x_core.gaussians.spawn import DepthImage, Room, cover, spawn_that_fits
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import Camera
from f4x_core.native.kernels import TORCH, Kernels
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.adam import Adam


def some_static(count: int = 40, degree: int = 1):
    rng = np.random.default_rng(0)
    spawned = Spawned(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.uniform(size=(count, 3)).astype(np.float32),
        np.full(count, 0.02, np.float32),
        np.ones(count, np.float32),
    )
    return spawn_static(spawned, degree, SpawnConfig())


def rates(gaussians, rate=0.01):
    return dict.fromkeys(gaussians.parameters, rate)


def descend(optimiser, steps=1):
    for _ in range(steps):
        loss = sum((p * p).sum() for p in optimiser.gaussians.parameters.values())
        loss.backward()
        optimiser.step()


def test_kept_rows_go_on_as_if_nothing_had_happened():
    whole, cut = some_static(), some_static()
    keep = torch.arange(0, 40, 3)
    first, second = SetOptimiser(whole, rates(whole)), SetOptimiser(cut, rates(cut))
    descend(first, 5), descend(second, 5)
    second.keep(keep)
    descend(first, 5), descend(second, 5)
    for name, tensor in cut.parameters.items():
        assert torch.equal(tensor, whole.parameters[name][keep]), name
    assert torch.equal(cut.labels["ids"], whole.labels["ids"][keep])


@pytest.mark.parametrize(("first", "second"), [(False, True), (True, False)])
def test_adams_state_is_the_same_whatever_computes_a_step(first, second, native_library):
    """What one has left, the other continues, a tensor without elements included."""
    one, other = some_static(degree=0), some_static(degree=0)
    left, right = SetOptimiser(one, rates(one)), SetOptimiser(other, rates(other), Kernels(native=first))
    descend(left, 3), descend(right, 3)
    saved = right.adam.state_dict()
    right = SetOptimiser(other, rates(other), Kernels(native=second))
    right.adam.load_state_dict(saved)
    descend(left, 3), descend(right, 3)
    for name, tensor in one.parameters.items():
        torch.testing.assert_close(other.parameters[name], tensor, rtol=1e-6, atol=1e-6)
        state, same = left.adam.state[tensor], right.adam.state[other.parameters[name]]
        assert float(state["step"]) == float(same["step"]) == 6
        torch.testing.assert_close(same["exp_avg_sq"], state["exp_avg_sq"], rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("native", [False, True])
def test_checkpoints_of_torchs_adam_go_on(native, native_library):
    """State of earlier versions is read; our own comes back the same."""
    mine, other = torch.randn(40, 3, generator=torch.Generator().manual_seed(1)).requires_grad_(), None
    other = mine.detach().clone().requires_grad_()
    earlier = torch.optim.Adam([{"params": [other], "lr": 0.02, "name": "means"}], eps=1e-15)
    for _ in range(3):
        other.square().sum().backward()
        earlier.step(), earlier.zero_grad()
    saved = earlier.state_dict()
    with torch.no_grad():
        mine.copy_(other)
    first = Adam([{"params": [mine], "lr": 0.02, "name": "means"}], Kernels(native))
    first.load_state_dict(saved)
    again = Adam([{"params": [mine], "lr": 0.02, "name": "means"}], Kernels(native))
    again.load_state_dict(first.state_dict())
    for _ in range(2):
        for value, optimiser in ((other, earlier), (mine, again)):
            value.square().sum().backward()
            optimiser.step()
        earlier.zero_grad()
    torch.testing.assert_close(mine, other, rtol=1e-6, atol=1e-6)


def test_a_fit_does_not_load_the_compiler_of_torch():
    """A second of processor time and 70 MB, which making `torch.optim.Adam` takes."""
    code = (
        "import sys, torch; from f4x_core.scaffold.adam import Adam; import f4x_core.fit.pipeline;"
        "value = torch.ones(3, requires_grad=True); value.sum().backward(); Adam([{'params': [value], 'lr': 1.0}]).step();"
        "sys.exit('torch._dynamo' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2]).returncode == 0


def test_appended_rows_start_with_zero_moments_and_leave_others_alone():
    whole, grown = some_static(), some_static()
    first, second = SetOptimiser(whole, rates(whole)), SetOptimiser(grown, rates(grown))
    descend(first, 5), descend(second, 5)
    new = {name: tensor.detach()[:4].clone() for name, tensor in grown.parameters.items()}
    new_labels = {"ids": torch.arange(100, 104), "reach": torch.ones(4), "earlier": torch.zeros(4, dtype=torch.bool)}
    second.append(new, new_labels)
    state = second.adam.state[grown.parameters["means"]]
    assert state["exp_avg"][40:].abs().max() == 0
    assert state["exp_avg"][:40].abs().max() > 0
    descend(first, 3), descend(second, 3)
    assert torch.equal(grown.parameters["means"][:40], whole.parameters["means"])
    assert grown.labels["ids"][-4:].tolist() == [100, 101, 102, 103]


def adam_written_out(value, gradients, rate):
    """Adam of Kingma and Ba with the epsilon of 3DGS, float64."""
    first = second = np.zeros_like(value)
    for step, gradient in enumerate(gradients, 1):
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        value = value - rate * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-15)
    return value


@pytest.mark.parametrize("kernels", [TORCH, Kernels(native=True, threads=2)])
def test_each_tensor_takes_adams_steps_at_its_own_rate_and_places_in_units_of_reach(kernels, native_library):
    gaussians = some_static(12)
    reach = np.linspace(0.3, 4, 12)
    gaussians.labels["reach"] = torch.from_numpy(reach).float()
    own = {name: 1e-3 * (i + 1) for i, name in enumerate(gaussians.parameters)}
    optimiser = SetOptimiser(gaussians, dict.fromkeys(own, 1.0), kernels)
    optimiser.set_rates(own)
    rng = np.random.default_rng(5)
    before = {name: tensor.detach().double().numpy().copy() for name, tensor in gaussians.parameters.items()}
    gradients = {name: rng.normal(size=(4, *value.shape)) for name, value in before.items()}
    gradients["sh0"] *= 1e-11  # Adam's own epsilon would swallow these
    for step in range(4):
        for name, tensor in gaussians.parameters.items():
            tensor.grad = torch.from_numpy(gradients[name][step]).float()
        optimiser.step()
        assert all(tensor.grad is None for tensor in gaussians.parameters.values())
    for name, tensor in gaussians.parameters.items():
        moved = adam_written_out(before[name], gradients[name], own[name]) - before[name]
        if name == "means":
            moved *= reach[:, None]
        np.testing.assert_allclose(tensor.detach().double().numpy() - before[name], moved, atol=1e-6, err_msg=name)


def test_what_is_forgotten_begins_anew_and_the_rest_goes_on():
    gaussians = some_static(6)
    optimiser = SetOptimiser(gaussians, rates(gaussians))
    descend(optimiser, 3)
    optimiser.forget("quats")
    for name in gaussians.parameters:
        state = optimiser.adam.state[gaussians.parameters[name]]
        for moment in ("exp_avg", "exp_avg_sq"):
            assert bool(state[moment].any()) == (name not in ("quats", "shN")), (name, moment)


def test_a_band_is_added_behind_the_coefficients_and_its_constant_to_the_first():
    gaussians = some_static(6, degree=1)
    plain, more = torch.randn(6, 1, 3), torch.randn(6, 5, 3)
    wanted = torch.cat([gaussians.parameters["sh0"].detach() + plain, torch.zeros(6, 3, 3), more], 1)
    SetOptimiser(gaussians, rates(gaussians)).add_band(plain, more)
    torch.testing.assert_close(gaussians.sh.detach(), wanted)


def test_a_new_band_starts_with_zero_moments_and_the_other_coefficients_go_on():
    gaussians = some_static(6, degree=1)
    with torch.no_grad():
        gaussians.parameters["shN"].copy_(torch.linspace(1, 2, 54).view(6, 3, 3))
    optimiser = SetOptimiser(gaussians, rates(gaussians))
    descend(optimiser, 2)
    before = {name: optimiser.adam.state[value]["exp_avg"].clone() for name, value in gaussians.parameters.items()}
    optimiser.add_band(torch.zeros(6, 1, 3), torch.ones(6, 5, 3))
    for moment in ("exp_avg", "exp_avg_sq"):
        own, new = optimiser.adam.state[gaussians.parameters["shN"]][moment].split([3, 5], 1)
        assert own.min() > 0 and not new.any()
    for name in ("shN", "sh0"):
        now = optimiser.adam.state[gaussians.parameters[name]]["exp_avg"]
        torch.testing.assert_close(now[:, : before[name].shape[1]], before[name])
    descend(optimiser)


def test_what_is_stored_is_activated_as_3dgs_does():
    gaussians = some_static(7, degree=1)
    rng = np.random.default_rng(1)
    raw = {name: rng.normal(size=tuple(tensor.shape)) for name, tensor in gaussians.parameters.items()}
    gaussians.parameters = {name: torch.from_numpy(value) for name, value in raw.items()}
    np.testing.assert_allclose(gaussians.scales, np.exp(raw["log_scales"]))
    np.testing.assert_allclose(gaussians.opacities, 1 / (1 + np.exp(-raw["opacity_logits"])))
    np.testing.assert_array_equal(gaussians.sh[:, 0], raw["sh0"][:, 0])
    np.testing.assert_array_equal(gaussians.sh[:, 1:], raw["shN"])
    logit = opacity_logit(torch.tensor([0.0, 0.25, 0.6, 1.0], dtype=torch.float64))
    np.testing.assert_allclose(logit, np.log(np.array([1e-4, 0.25, 0.6, 1 - 1e-4]) / [1 - 1e-4, 0.75, 0.4, 1e-4]))


def test_gaussians_start_opaque_round_and_with_the_colour_of_their_pixel():
    rng = np.random.default_rng(4)
    spawned = Spawned(*(rng.uniform(0.1, 1, shape).astype(np.float32) for shape in ((5, 3), (5, 3), (5,), (5,))))
    made = spawn_static(spawned, 2, SpawnConfig(opacity=0.7), first_id=30)
    np.testing.assert_array_equal(made.parameters["means"].detach(), spawned.means)
    np.testing.assert_allclose(made.scales.detach(), np.tile(spawned.radius[:, None], 3), rtol=1e-6)
    np.testing.assert_allclose(made.opacities.detach(), 0.7, rtol=1e-6)
    y00 = 0.5 / np.sqrt(np.pi)
    np.testing.assert_allclose(made.sh[:, 0].detach() * y00 + 0.5, spawned.rgb, atol=1e-6)
    assert made.sh.shape == (5, 9, 3) and not made.sh[:, 1:].any()
    assert made.parameters["quats"].tolist() == [[1, 0, 0, 0]] * 5
    assert made.labels["ids"].tolist() == [30, 31, 32, 33, 34]
    np.testing.assert_array_equal(made.labels["reach"], spawned.depth)


@pytest.fixture
def nodes():
    generator = torch.Generator().manual_seed(1)
    xyz = torch.randn(5, 6, 3, generator=generator)
    quat = quaternion.normalize(torch.randn(5, 6, 4, generator=generator))
    return xyz, quat


def some_dynamic(nodes, count=30):
    rng = np.random.default_rng(2)
    spawned = Spawned(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.uniform(size=(count, 3)).astype(np.float32),
        np.full(count, 0.02, np.float32),
        np.ones(count, np.float32),
    )
    xyz, quat = (tensor.numpy() for tensor in nodes)
    radius, certain = np.ones(6, np.float32), np.ones((5, 6), bool)
    graph = np.zeros((6, 3), int), np.ones((6, 3), bool)
    scaffold = Scaffold(np.arange(5.0), xyz, quat, radius, certain, np.arange(6), *graph, 1.0)
    return spawned, spawn_dynamic(spawned, rng.integers(0, 5, count), scaffold, 0, SpawnConfig())


def test_a_gaussian_hangs_on_the_node_that_is_nearest_at_its_reference_frame(nodes):
    """Its place is R_node local + t_node there; `localise` is the way back."""
    spawned, dynamic = some_dynamic(nodes)
    assert dynamic.labels["ids"].tolist() == list(range(30))
    xyz, quat = (a.double().numpy() for a in nodes)
    place = dynamic.parameters["local_means"].detach().double().numpy()
    for i in range(len(dynamic)):
        frame, node = int(dynamic.labels["reference"][i]), int(dynamic.labels["attach"][i])
        distance = [np.linalg.norm(spawned.means[i] - xyz[frame, m]) for m in range(xyz.shape[1])]
        assert node == np.argmin(distance)
        w, x, y, z = quat[frame, node]
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(rotation @ place[i] + xyz[frame, node], spawned.means[i], atol=1e-5)
    generator = torch.Generator().manual_seed(8)
    with torch.no_grad():
        dynamic.parameters["local_quats"].copy_(torch.randn(30, 4, generator=generator))
    placed = [tensor.detach() for tensor in dynamic.at_reference(*nodes)]
    back = localise(*placed, dynamic.labels["attach"], dynamic.labels["reference"], *nodes)
    torch.testing.assert_close(back[0], dynamic.parameters["local_means"].detach(), atol=1e-5, rtol=1e-5)
    unit = quaternion.normalize(dynamic.parameters["local_quats"].detach())
    torch.testing.assert_close(back[1], unit, atol=1e-5, rtol=1e-5)


def test_moving_a_node_rigidly_moves_its_gaussians_rigidly(nodes):
    """Oracle 9: at the reference time itself."""
    _, dynamic = some_dynamic(nodes)
    xyz, quat = nodes
    turn = quaternion.normalize(torch.tensor([0.9, 0.1, -0.3, 0.2]))
    shift = torch.tensor([0.4, -0.2, 0.1])
    before, turned_before = (a.detach() for a in dynamic.at_reference(xyz, quat))
    moved = quaternion.multiply(turn.expand_as(quat), quat), quaternion.rotate(turn.expand_as(quat), xyz) + shift
    after, turned_after = (a.detach() for a in dynamic.at_reference(moved[1], moved[0]))
    assert torch.allclose(after, pose.transform(turn.expand(30, 4), shift.expand(30, 3), before), atol=1e-5)
    assert torch.allclose(turned_after, quaternion.multiply(turn.expand(30, 4), turned_before), atol=1e-5)


def test_appearance_turns_with_the_gaussian():
    """The same Gaussian and camera, both turned, show the same colour."""
    generator = torch.Generator().manual_seed(3)
    sh = torch.randn(20, 9, 3, generator=generator)
    means, quats = (
        torch.randn(20, 3, generator=generator),
        quaternion.normalize(torch.randn(20, 4, generator=generator)),
    )
    centre = torch.tensor([0.2, 0.1, -3.0])
    turn = quaternion.normalize(torch.tensor([0.5, 0.5, -0.1, 0.7]))
    turned = quaternion.multiply(turn.expand(20, 4), quats)
    moved = quaternion.rotate(turn.expand(20, 4), means)
    expected = appearance(sh, means, quats, centre)
    assert torch.allclose(appearance(sh, moved, turned, quaternion.rotate(turn, centre)), expected, atol=1e-5)


def frame(depth_value=1.0):
    camera = Camera(np.array([[50.0, 0, 24], [0, 50, 16], [0, 0, 1]]), np.eye(4), 48, 32)
    image = np.random.default_rng(0).integers(0, 255, (32, 48, 3)).astype(np.uint8)
    return camera, image, np.full((32, 48), depth_value, np.float32)


@pytest.mark.parametrize(("nearer", "count"), [(1.25, 0), (1.2500001, 384)])
def test_the_tolerance_itself_is_still_within(nearer, count):
    camera, image, depth = frame(2.0)
    everywhere, rng = np.ones(depth.shape, bool), np.random.default_rng(0)
    pixels = np.stack(np.meshgrid(np.arange(1, 48, 2.0), np.arange(1, 32, 2.0)), -1).reshape(-1, 2)
    existing = camera.unproject(pixels, np.full(len(pixels), 2.0 * nearer))
    config = SpawnConfig(spacing=2, depth_tolerance=0.25)
    assert len(cover(DepthImage(image, depth, everywhere, camera), existing, config, rng)) == count


@pytest.mark.parametrize(
    ("grey", "steep", "plain"), [(2.5, 0.0, True), (3.5, 0.0, False), (0, 0.015, True), (0, 0.025, False)]
)
def test_a_block_is_plain_where_grey_and_depth_deviate_less_than_their_limits(grey, steep, plain):
    """Checkerboards of pixels, so that the standard deviation is half the difference."""
    camera, _, depth = frame()
    board = np.indices(depth.shape).sum(0) % 2 * 2.0 - 1
    image = np.repeat((120 + grey * board)[..., None], 3, -1)
    depth = (depth * np.exp(steep * board)).astype(np.float32)
    everywhere, rng = np.ones(depth.shape, bool), np.random.default_rng(0)
    count = len(cover(DepthImage(image, depth, everywhere, camera), np.zeros((0, 3)), SpawnConfig(spacing=2), rng))
    assert count == (24 if plain else 384)


def test_what_has_no_room_is_covered_more_thinly_everywhere():
    camera, image, depth = frame()
    everywhere = np.ones(depth.shape, bool)

    def spawn(config):
        return cover(DepthImage(image, depth, everywhere, camera), np.zeros((0, 3)), config, np.random.default_rng(0))

    asked = SpawnConfig(spacing=1, max_count=200)
    start = spawn_that_fits(spawn, asked)
    assert 100 < len(start.made) <= 200 and start.config.spacing > asked.spacing
    assert start.room == Room(len(spawn(asked)), 200) and start.room.short
    columns = camera.project(start.made.means.astype(np.float64))[0][:, 0]
    thirds = np.histogram(columns, 3, (0, 48))[0]
    assert thirds.min() > 0.7 * thirds.max()
    roomy = replace(asked, max_count=2000)
    start = spawn_that_fits(spawn, roomy)
    assert start.config is roomy and not start.room.short


def test_cells_grow_until_what_is_made_fits():
    """Counts that fall with the square of the spacing: one more try, 3 % larger than needed."""

    def spawn(config):
        return range(round(9000 / config.spacing**2))

    start = spawn_that_fits(spawn, SpawnConfig(spacing=1.0, max_count=6000))
    assert start.config.spacing == pytest.approx(1.03 * 1.5**0.5)
    assert len(start.made) == len(spawn(start.config)) <= 6000 and start.room == Room(9000, 6000)
    start = spawn_that_fits(spawn, SpawnConfig(spacing=1.0, max_count=9000))
    assert start.config.spacing == 1 and len(start.made) == 9000 and not start.room.short
