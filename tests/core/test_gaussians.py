"""Parameter sets, surgery with optimiser state, spawning and density control."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from f4x_core.gaussians import (
    DensityConfig,
    DensityControl,
    SetOptimiser,
    SpawnConfig,
    Spawned,
    appearance,
    spawn_dynamic,
    spawn_static,
)
from f4x_core.gaussians.spawn import coarse_to_fine, cover, spawn_that_fits
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import Camera


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


def test_appended_rows_start_with_zero_moments_and_leave_others_alone():
    whole, grown = some_static(), some_static()
    first, second = SetOptimiser(whole, rates(whole)), SetOptimiser(grown, rates(grown))
    descend(first, 5), descend(second, 5)
    new = {name: tensor.detach()[:4].clone() for name, tensor in grown.parameters.items()}
    second.append(new, {"ids": torch.arange(100, 104), "reach": torch.ones(4)})
    state = second.adam.state[grown.parameters["means"]]
    assert state["exp_avg"][40:].abs().max() == 0
    assert state["exp_avg"][:40].abs().max() > 0
    descend(first, 3), descend(second, 3)
    assert torch.equal(grown.parameters["means"][:40], whole.parameters["means"])
    assert grown.labels["ids"][-4:].tolist() == [100, 101, 102, 103]


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
    return spawned, spawn_dynamic(spawned, rng.integers(0, 5, count), *nodes, 3, 0, SpawnConfig())


def test_local_storage_gives_back_the_world_placement(nodes):
    spawned, dynamic = some_dynamic(nodes)
    x, q = dynamic.at_reference(*nodes)
    assert np.allclose(x.detach().numpy(), spawned.means, atol=1e-5)
    assert np.allclose(q.detach().abs()[:, 0].numpy(), 1, atol=1e-5)


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


def test_coarse_to_fine_visits_every_frame_once():
    for count in (1, 2, 3, 7, 24):
        order = list(coarse_to_fine(count))
        assert sorted(order) == list(range(count))
        assert order[0] == 0


def frame(depth_value=1.0):
    camera = Camera(np.array([[50.0, 0, 24], [0, 50, 16], [0, 0, 1]]), np.eye(4), 48, 32)
    image = np.random.default_rng(0).integers(0, 255, (32, 48, 3)).astype(np.uint8)
    return camera, image, np.full((32, 48), depth_value, np.float32)


def test_what_is_covered_is_not_spawned_again():
    camera, image, depth = frame()
    config, rng = SpawnConfig(spacing=2), np.random.default_rng(0)
    everywhere = np.ones(depth.shape, bool)
    first = cover(image, depth, everywhere, camera, np.zeros((0, 3)), config, rng)
    assert len(first.means) == 24 * 16
    again = cover(image, depth, everywhere, camera, first.means, config, rng)
    assert len(again.means) == 0
    behind = cover(image, depth * 2, everywhere, camera, first.means, config, rng)
    assert len(behind.means) == 24 * 16, "a surface at another depth is not covered"


def test_spawned_points_carry_their_pixels():
    camera, image, depth = frame(0.8)
    spawned = cover(
        image, depth, np.ones(depth.shape, bool), camera, np.zeros((0, 3)), SpawnConfig(), np.random.default_rng(0)
    )
    pixels, z = camera.project(spawned.means.astype(np.float64))
    column, row = np.floor(pixels).astype(int).T
    assert np.allclose(z, 0.8, atol=1e-5)
    assert np.allclose(spawned.rgb, image[row, column] / 255, atol=1e-6)


def test_plain_cells_share_one_gaussian_and_detailed_ones_do_not():
    camera, image, depth = frame()
    image[:, :24] = 120  # a wall
    everywhere, rng = np.ones(depth.shape, bool), np.random.default_rng(0)
    config = SpawnConfig(spacing=2)
    spawned = cover(image, depth, everywhere, camera, np.zeros((0, 3)), config, rng)
    plain = camera.project(spawned.means.astype(np.float64))[0][:, 0] < 24
    assert plain.sum() == 24 * 32 / 8**2, "blocks of 4 x 4 cells"
    assert (~plain).sum() == 24 * 32 / 2**2
    assert np.allclose(spawned.radius[plain], 4 * spawned.radius[~plain][0])
    assert len(cover(image, depth, everywhere, camera, spawned.means, config, rng).means) == 0
    depth[:, :24] = np.linspace(1, 2, 24)
    steep = cover(image, depth, everywhere, camera, np.zeros((0, 3)), config, rng)
    assert len(steep.means) == 24 * 16, "a wall that leads away is not one Gaussian"


def test_unsure_depth_is_covered_by_what_lies_a_little_off():
    camera, image, depth = frame()
    everywhere, rng = np.ones(depth.shape, bool), np.random.default_rng(0)
    config = SpawnConfig(spacing=2)
    first = cover(image, depth, everywhere, camera, np.zeros((0, 3)), config, rng)
    loose = np.where(np.arange(48) < 24, 0.5, 0.1)[None].repeat(32, 0)
    again = cover(image, 1.3 * depth, everywhere, camera, first.means, config, rng, loose)
    assert camera.project(again.means.astype(np.float64))[0][:, 0].min() > 24 and len(again.means) == 12 * 16


def test_what_has_no_room_is_covered_more_thinly_everywhere():
    camera, image, depth = frame()
    everywhere = np.ones(depth.shape, bool)

    def spawn(config):
        return cover(image, depth, everywhere, camera, np.zeros((0, 3)), config, np.random.default_rng(0))

    asked = SpawnConfig(spacing=1, max_count=200)
    thin, given = spawn_that_fits(spawn, asked)
    assert 100 < len(thin.means) <= 200 and given.spacing > asked.spacing
    columns = camera.project(thin.means.astype(np.float64))[0][:, 0]
    thirds = np.histogram(columns, 3, (0, 48))[0]
    assert thirds.min() > 0.7 * thirds.max()
    roomy = replace(asked, max_count=2000)
    assert spawn_that_fits(spawn, roomy)[1] is roomy


def test_near_and_far_move_equally_far_in_the_picture():
    gaussians = some_static(40)
    gaussians.labels["reach"] = torch.where(torch.arange(40) < 20, 0.2, 5.0)
    before = gaussians.parameters["means"].detach().clone()
    optimiser = SetOptimiser(gaussians, rates(gaussians))
    gaussians.parameters["means"].sum().backward()
    optimiser.step()
    moved = (gaussians.parameters["means"].detach() - before).abs()
    torch.testing.assert_close(moved[:20], torch.full((20, 3), 0.002), rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(moved[20:], torch.full((20, 3), 0.05), rtol=1e-3, atol=1e-6)


def test_density_control_splits_clones_prunes_and_keeps_within_its_limit():
    gaussians = some_static(100)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"][:10] = -8  # faint
        gaussians.parameters["log_scales"][50:] = np.log(0.1)  # large
    optimiser = SetOptimiser(gaussians, rates(gaussians))
    descend(optimiser)
    config = DensityConfig(
        every=1, start=0, stop=1, gradient=1e-3, growth=1.0, max_count=130, split_scale=0.05, least=1
    )
    control = DensityControl(optimiser, config, total_steps=10)
    control.record(torch.full((100, 2), 1.0), torch.ones(100, dtype=torch.bool), 10, 10)
    next_id = control.densify_and_prune(100, torch.Generator().manual_seed(0))
    assert next_id > 100
    ids = gaussians.labels["ids"]
    assert len(ids.unique()) == len(ids) <= 130
    assert not set(range(10)) & set(ids.tolist()), "faint Gaussians are gone"
    sizes = {name: len(tensor) for name, tensor in gaussians.parameters.items()}
    assert set(sizes.values()) == {len(ids)}
    assert len(control.seen) == len(ids)
    descend(optimiser)


def test_nothing_changes_outside_the_active_window():
    gaussians = some_static()
    control = DensityControl(
        SetOptimiser(gaussians, rates(gaussians)), DensityConfig(every=1, start=0.5, stop=0.6), total_steps=100
    )
    assert control.steps == frozenset(range(50, 60))
