"""The first Gaussians: which frames, which pixels, what counts as covered, and where moving ones were before."""

import dataclasses

import numpy as np
import pytest
import torch
from toy import HEIGHT, WIDTH, clip_and_priors

from f4x_core.fit import spawning
from f4x_core.fit.config import profile
from f4x_core.fit.model import NodeSet, SceneModel
from f4x_core.fit.spawning import Spawner, first_lifetimes, spawn_frames
from f4x_core.fit.start import start_scaffold
from f4x_core.gaussians.camera_rig import CameraRig
from f4x_core.gaussians.spawn import cover
from f4x_core.progress import silent

pytestmark = pytest.mark.usefixtures("one_thread")

FRAMES = 7


@pytest.fixture
def case():
    """(clip, priors, config): one frame held out, depth with holes, unequal confidence, nothing moves in one frame."""
    clip, priors = clip_and_priors(FRAMES + 1, hold_out=FRAMES)
    rng = np.random.default_rng(0)
    priors.depth[rng.random(priors.depth.shape) < 0.02] = np.nan
    priors.depth[:, 3, 5], priors.depth[:, 30, 5] = 0, -1
    priors.depth_confidence = rng.random(priors.depth.shape).astype(np.float16)
    priors.depth_confidence[:, ::5] = 0.004
    priors.mask[2] = False
    config = profile("quick")
    spawn = dataclasses.replace(config.spawn_static, spacing=6.0, frames=3)
    few = dataclasses.replace(config.spawn_dynamic, spacing=5.0, frames=4)
    scaffold = dataclasses.replace(config.scaffold, geometry_steps=2, following_steps=2)
    config = dataclasses.replace(config, spawn_static=spawn, spawn_dynamic=few, scaffold=scaffold, threads=1, seed=3)
    return clip, priors, dataclasses.replace(config, backend="torch")


@pytest.fixture
def covered(monkeypatch):
    """What `cover` is asked for, call by call, and what it gives."""
    calls = []

    def watched(view, existing, spawn, rng):
        state = rng.bit_generator.state
        found = cover(view, existing, spawn, rng)
        names = ("image", "valid", "camera", "tolerance", "existing", "spawn", "state", "found")
        values = (view.image, view.valid, view.camera, view.tolerance, existing, spawn, state, found)
        calls.append(dict(zip(names, values, strict=True)))
        return found

    monkeypatch.setattr(spawning, "cover", watched)
    return calls


def has_depth(priors, frame):
    return np.array([[z == z and z > 0 for z in row] for row in priors.depth[frame]])


def near_motion(mask):
    """(H,W) bool: at most two steps up, down or sideways from what moves."""
    found = np.zeros(mask.shape, bool)
    for row, column in np.argwhere(mask):
        for down in range(-2, 3):
            for across in range(abs(down) - 2, 3 - abs(down)):
                if 0 <= row + down < HEIGHT and 0 <= column + across < WIDTH:
                    found[row + down, column + across] = True
    return found


def tolerances(priors, frame):
    """(H,W) twice the depth's relative error, 0.14 at confidence 1/2, within 0.1 and 0.5."""
    found = np.zeros((HEIGHT, WIDTH))
    for row in range(HEIGHT):
        for column in range(WIDTH):
            sure = max(float(priors.depth_confidence[frame, row, column]), 0.01)
            found[row, column] = min(max(2 * 0.14 * ((1 - sure) / sure) ** 0.5, 0.1), 0.5)
    return found


@pytest.mark.parametrize(("asked", "frames"), [(1, [0]), (2, [0, 6]), (3, [0, 3, 6]), (99, [0, 1, 2, 3, 4, 5, 6])])
def test_static_gaussians_come_from_frames_spread_evenly(case, asked, frames):
    _, priors, config = case
    spawn = dataclasses.replace(config.spawn_static, frames=asked)
    assert spawn_frames(priors, dataclasses.replace(config, spawn_static=spawn)).tolist() == frames


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("partly", [True, False])
def test_static_gaussians_cover_what_stands_still_has_depth_and_is_not_shown_yet(case, covered, moving, partly):
    clip, priors, config = case
    rng = np.random.default_rng(1)
    explained = {frame: rng.random((HEIGHT, WIDTH)) < 0.5 for frame in (0, 3, 6)} if partly else None
    spawned = Spawner(clip, priors, config, 1, silent).static(moving, explained, 70)
    before = []
    for frame, call in zip((0, 3, 6), sorted(covered, key=lambda call: call["camera"].center[0]), strict=True):
        valid = has_depth(priors, frame)
        if moving:
            valid &= ~near_motion(priors.mask[frame])
        if partly:
            valid &= ~explained[frame]
        np.testing.assert_array_equal(call["valid"], valid)
        np.testing.assert_array_equal(call["image"], clip.frames[priors.frames[frame]])
        np.testing.assert_allclose(call["tolerance"], tolerances(priors, frame), rtol=1e-3)
    for call in covered:
        assert len(call["existing"]) == sum(len(part) for part in before)
        if before:
            np.testing.assert_array_equal(call["existing"], np.concatenate(before))
        before.append(call["found"].means)
    assert len(before) == 3 and len(before[1]) > 0
    np.testing.assert_array_equal(spawned.parameters["means"].detach(), np.concatenate(before))
    assert spawned.labels["ids"].tolist() == list(range(70, 70 + len(spawned))) and spawned.sh.shape[1] == 4
    assert covered[0]["state"] == np.random.default_rng(3).bit_generator.state


def test_depth_without_confidence_is_compared_with_the_usual_tolerance(case, covered):
    clip, priors, config = case
    priors.depth_confidence = None
    Spawner(clip, priors, config, 0, silent).static(True, None, 0)
    assert [call["tolerance"] for call in covered] == [None] * 3


def test_where_there_is_no_mask_everything_stands_still(case, covered):
    clip, priors, config = case
    priors.mask = None
    Spawner(clip, priors, config, 0, silent).static(True, None, 0)
    np.testing.assert_array_equal(covered[0]["valid"], has_depth(priors, 0))


def test_dynamic_gaussians_fill_what_those_of_other_frames_leave_open_once_moved_there(case, covered):
    clip, priors, config = case
    scaffold = start_scaffold(priors, config, silent).scaffold
    nodes, rig = NodeSet(scaffold, config.scaffold.graph), CameraRig(priors.cameras)
    spawner = Spawner(clip, priors, config, 0, silent)
    static = spawner.static(True, None, 0)
    covered.clear()
    bare = SceneModel(static, None, nodes, rig, config.scaffold.kernel, config.kernels)
    dynamic = spawner.dynamic(bare, 500)
    order = [int(np.abs(priors.cameras.centers - call["camera"].center).sum(1).argmin()) for call in covered]
    assert sorted(order[:4]) == [0, 3, 4, 6] and order[0] == 0 and order[3] in (3, 4)
    assert order[4:] == [1, 5]  # between the chosen ones; nothing moves in frame 2
    alone = len(covered[0]["found"]) / covered[0]["valid"].sum()
    needed = [i < 4 or len(call["found"]) >= 0.1 * alone * call["valid"].sum() for i, call in enumerate(covered)]
    assert needed[4:] == [True, False]
    counts = np.cumsum([0, *(len(call["found"]) * kept for call, kept in zip(covered, needed, strict=True))])
    model = SceneModel(static, dynamic, nodes, rig, config.scaffold.kernel, config.kernels)
    for frame, call, start, end in zip(order, covered, counts, counts[1:], strict=False):
        np.testing.assert_array_equal(call["valid"], has_depth(priors, frame) & priors.mask[frame])
        np.testing.assert_allclose(call["tolerance"], tolerances(priors, frame), rtol=1e-3)
        with torch.no_grad():
            places = model.dynamic_at(float(model.times[frame]))[0][0].numpy()
        np.testing.assert_allclose(call["existing"], places[:start].reshape(-1, 3), atol=1e-5)
        if end > start:
            np.testing.assert_allclose(places[start:end], call["found"].means, atol=1e-4)
        assert set(dynamic.labels["reference"][start:end].tolist()) <= {frame}
    assert counts[1] > 10 and counts[-1] == len(dynamic)
    assert dynamic.labels["ids"].tolist() == list(range(500, 500 + len(dynamic)))
    assert dynamic.parameters["dw"].shape[1] == nodes.neighbours.shape[1]
    assert covered[0]["state"] == np.random.default_rng(3).bit_generator.state


@pytest.mark.parametrize("crumbs", [0.0, 0.1, 9.0])
def test_frames_between_the_chosen_ones_come_only_where_much_is_open(case, covered, monkeypatch, crumbs):
    clip, priors, config = case
    monkeypatch.setattr(spawning, "CRUMBS", crumbs)
    scaffold = start_scaffold(priors, config, silent).scaffold
    scaffold.certain[:] = False  # nothing is carried anywhere: every frame is as open as if it were alone
    nodes, rig = NodeSet(scaffold, config.scaffold.graph), CameraRig(priors.cameras)
    spawner = Spawner(clip, priors, config, 0, silent)
    static = spawner.static(True, None, 0)
    covered.clear()
    dynamic = spawner.dynamic(SceneModel(static, None, nodes, rig, config.scaffold.kernel, config.kernels), 0)
    visited = set(dynamic.labels["reference"].tolist())
    assert visited == ({0, 3, 4, 6} if crumbs > 1 else {0, 1, 3, 4, 5, 6})


def test_a_moving_gaussian_covers_only_frames_in_which_its_nodes_are_seen(case, covered):
    clip, priors, config = case
    scaffold = start_scaffold(priors, config, silent).scaffold
    scaffold.certain[4:, : len(scaffold) // 2] = False  # tracks of one half end after frame 3
    nodes, rig = NodeSet(scaffold, config.scaffold.graph), CameraRig(priors.cameras)
    parts = {"nodes": nodes, "rig": rig, "kernel": config.scaffold.kernel, "kernels": config.kernels}
    for rate in (config.rates.lifetimes, 0.0):
        rates = dataclasses.replace(config.rates, lifetimes=rate)
        spawner = Spawner(clip, priors, dataclasses.replace(config, rates=rates), 0, silent)
        static = spawner.static(True, None, 0)
        covered.clear()
        dynamic = spawner.dynamic(SceneModel(static, None, **parts), 0)
        model = SceneModel(static, dynamic, **parts)
        order = [int(np.abs(priors.cameras.centers - call["camera"].center).sum(1).argmin()) for call in covered]
        late = order.index(6)
        before = sum(len(call["found"]) for call in covered[:late])
        near = nodes.neighbours[dynamic.labels["attach"][:before]].numpy()
        seen = np.array([2 * sum(scaffold.certain[6, n] for n in slots) >= len(slots) for slots in near])
        with torch.no_grad():
            places = model.dynamic_at(float(model.times[6]))[0].means.numpy()[:before]
        assert 0 < seen.sum() < len(seen)
        np.testing.assert_allclose(covered[late]["existing"], places[seen] if rate else places, atol=1e-5)


def test_lifetimes_begin_whole_while_nodes_are_seen():
    times, reference = np.array([0.0, 1, 2, 4, 5, 8]), np.array([2, 2, 5, 0])
    carried = np.ones((6, 4), bool)
    carried[[0, 4], 0] = False  # seen in frames 1 to 3 around frame 2: lost two frames before, three after
    carried[2, 1] = False  # not even in its own frame, which it was made in
    before, after = first_lifetimes(times, reference, carried).detach().exp().T
    np.testing.assert_allclose(before, [4, 2.5, 10, 2], rtol=1e-6)
    np.testing.assert_allclose(after, [6, 7.5, 2, 10], rtol=1e-6)


@pytest.mark.parametrize(("own", "limit", "room"), [(500, 10_000, 500), (500, 100, 80), (3, 1, 1)])
def test_a_set_begins_within_the_number_that_it_may_grow_to(case, own, limit, room):
    clip, priors, config = case
    spawn = dataclasses.replace(config.spawn_static, spacing=1.0, max_count=own)
    density = dataclasses.replace(config.density_static, max_count=limit)
    config = dataclasses.replace(config, spawn_static=spawn, density_static=density)
    assert config.start_of("static") == dataclasses.replace(spawn, max_count=room)
    made = Spawner(clip, priors, config, 1, silent).static(False, None, 70)
    assert 0.3 * room <= len(made) <= max(room, 3)
    assert config.start_of("dynamic") == config.spawn_dynamic
