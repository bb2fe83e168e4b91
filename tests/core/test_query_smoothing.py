"""Patches of a scene, their bonds and their votes, against loops over Gaussians and dense matrices."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.query import smoothing
from f4x_core.query.smoothing import Patches, group, group_of


class MadeUp:
    """As much of a scene as patches need: Gaussians around a camera that looks aside, moving ones and some behind it."""

    def __init__(self, seed, names=("visual",), count=90):
        random = np.random.default_rng(seed)
        cell, layer = 1.3 * smoothing.CELL, 0.9 * smoothing.LAYER
        # Cells within reach of each other: slopes of up to two or three cells, and few layers, most of them nearer than 1.
        slopes, distance = cell * random.integers(-2, 3, (count, 2)), np.exp(layer * random.uniform(-3, 1, (count, 1)))
        front = np.where(random.random((count, 1)) < 0.7, 1.0, -1.0)
        directions = np.concatenate([1.6 * slopes, front], 1) + 0.002 * random.normal(size=(count, 3))
        x = distance * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        x[:3] = (
            (0.7, 0.1, 0),
            (0.7, 0.1, 1e-4),
            (0.7, 0.08, 1e-4),
        )  # beside the camera, not behind; neighbours of the last cell
        turn, shift = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]]), np.array([0.25, -0.125, 0.5])  # no rounding
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn, shift
        camera = SimpleNamespace(world_to_camera=matrix, intrinsics=np.diag([50.0, 70.0, 1.0]), width=80)
        self.ids, self._means = np.arange(count), (x - shift) @ turn
        self.dynamic, self.static = random.random(count) < 0.4, None
        self.dynamic[:3] = False
        self.cameras = Cameras(camera)
        self._latents = 0.1 * random.normal(size=(count, 5)) + 0.02
        decode = lambda head, latents: latents[:, :3] * (3, 1, -1)  # noqa: E731
        self.field = SimpleNamespace(names=names, decode=decode)
        self.weights = random.random(count) ** 3

    def posed(self, time):
        assert time == 12.0
        return SimpleNamespace(means=self._means, dynamic=self.dynamic)

    def latents(self):
        return self._latents

    def require_field(self):
        return self.field


class Cameras:
    """Of five frames; the one in the middle is known."""

    times = 10 + np.arange(5.0)

    def __init__(self, camera):
        self._camera = camera

    def __len__(self):
        return 5

    def __getitem__(self, frame):
        assert frame == 2
        return self._camera


def group_by_loops(scene):
    """(index (N,), weight, latents, bonds (P,P)) as `group` makes them."""
    camera, weights = scene.cameras[2], scene.weights + smoothing.UNSEEN
    names, places = [], []
    for mean, moves in zip(scene.posed(12.0).means, scene.dynamic, strict=True):
        x = camera.world_to_camera[:3, :3] @ mean + camera.world_to_camera[:3, 3]
        distance = math.sqrt(x @ x)
        u, v, w = 50 / 80 * x / distance
        cell = [math.floor(u * 40), math.floor(v * 40), math.floor(math.log(distance) / 0.15)]
        names.append((*cell, int(moves), int(w < 0)))
        places.append([u, v, w, 0.3 * math.log(distance)])
    patches = sorted(set(names))
    members = [np.array([name == patch for name in names]) for patch in patches]
    mean = lambda values: np.array([np.average(values[rows], axis=0, weights=weights[rows]) for rows in members])  # noqa: E731
    weight, latents, place = (
        np.array([weights[rows].sum() for rows in members]),
        mean(scene.latents()),
        mean(np.array(places)),
    )
    looks = scene.field.decode("", latents) if "visual" in scene.field.names else latents - latents.mean(0)
    looks = looks / np.linalg.norm(looks, axis=1, keepdims=True)
    bonds = np.eye(len(patches))
    for i, j in itertools.permutations(range(len(patches)), 2):
        steps = abs(np.subtract(patches[i], patches[j])[:3])
        if steps[0] <= 2 and steps[1] <= 2 and steps[2] <= 1:
            far = ((place[i] - place[j]) ** 2).sum() / smoothing.NEAR**2
            bonds[i, j] = math.exp(-far - (1 - looks[i] @ looks[j]) / smoothing.ALIKE)
    return np.array([patches.index(name) for name in names]), weight / weight.mean(), latents, bonds


@pytest.mark.parametrize("names", [("visual",), ("text",)])
@pytest.mark.parametrize("seed", range(3))
def test_patches_and_bonds_by_loops(monkeypatch, names, seed):
    """With bonds that weaken less, so that numbers show."""
    monkeypatch.setattr(smoothing, "NEAR", 0.2)
    monkeypatch.setattr(smoothing, "ALIKE", 1.5)
    scene = MadeUp(seed, names)
    asked = []
    monkeypatch.setattr(smoothing, "total_blend_weights", lambda *parts: asked.append(parts) or scene.weights.copy())
    found, (index, weight, latents, bonds) = group(scene), group_by_loops(scene)
    assert asked == [(scene, 3, 120)]
    np.testing.assert_array_equal(found.index, index)
    np.testing.assert_allclose(found.weight, weight)
    np.testing.assert_allclose(found.latents, latents, rtol=1e-5, atol=1e-7)
    assert found.latents.dtype == found.bond.dtype == np.float32
    dense = np.zeros_like(bonds)
    ends = np.repeat(np.arange(len(weight)), np.diff([*found.first, len(found.bond)]))
    np.add.at(dense, (ends, found.other), found.bond)
    np.testing.assert_allclose(dense, bonds, atol=1e-6)
    assert len(found.bond) == (bonds > 0).sum()
    assert ((bonds > 0.01).sum(1) > 1).mean() > 0.8


def random_patches(seed, count=30, spread=1.0):
    """Patches with random bonds, each with itself too, and weights over many orders of magnitude."""
    random = np.random.default_rng(seed)
    # Numbers whose sums float32 holds exactly.
    bonds = np.triu(random.integers(1, 65, (count, count)) / 64 * (random.random((count, count)) < 0.2), 1)
    bonds = (bonds + bonds.T + np.eye(count)).astype(np.float32)
    ends, others = np.nonzero(bonds)
    first = np.searchsorted(ends, np.arange(count))
    weight = np.exp(spread * random.normal(size=count))
    return Patches(np.arange(count), weight, np.zeros((count, 2)), first, others, bonds[ends, others]), bonds.astype(
        float
    )


def votes_by_matrix(patches, bonds, values, trust):
    own = trust * np.minimum(patches.weight, np.quantile(patches.weight, 0.95))
    own = own + 1e-6 * own.mean()
    return np.linalg.solve(np.diag(own + bonds.sum(1)) - bonds, own * values)


@pytest.mark.parametrize(("spread", "steps"), [(0.3, 200), (3.0, 45)])
def test_votes_solve_their_normal_equations(monkeypatch, spread, steps):
    """With weights of many sizes too, where conjugate gradients need their preconditioner to arrive in time."""
    monkeypatch.setattr(smoothing, "TOLERANCE", 1e-13)
    monkeypatch.setattr(smoothing, "STEPS", steps)
    for seed in range(3):
        patches, bonds = random_patches(seed, spread=spread)
        values = np.random.default_rng(seed).normal(size=30)
        for trust in (0.04, 3.0):
            expected = votes_by_matrix(patches, bonds, values, trust)
            np.testing.assert_allclose(patches.smooth(values, trust), expected, atol=2e-9)
        np.testing.assert_allclose(patches.smooth(values), votes_by_matrix(patches, bonds, values, 0.04), atol=2e-9)


def test_votes_on_numbers_of_any_size():
    patches, bonds = random_patches(1)
    values = np.random.default_rng(1).normal(size=30)
    expected = votes_by_matrix(patches, bonds, values, 0.04)
    for size in (1e-7, 1.0, 1e7):
        np.testing.assert_allclose(patches.smooth(size * values) / size, expected, atol=0.01)
    np.testing.assert_array_equal(patches.smooth(np.zeros(30)), 0)


def test_a_patch_of_no_weight_and_without_neighbours_keeps_its_value():
    lonely = Patches(
        np.arange(2), np.array([0.0, 2]), np.zeros((2, 2)), np.arange(2), np.arange(2), np.ones(2, np.float32)
    )
    np.testing.assert_allclose(lonely.smooth(np.array([5.0, -1])), [5, -1])


def test_patches_live_with_the_features_and_the_gaussians(monkeypatch):
    scene = labelled_scene()
    made = []
    monkeypatch.setattr(smoothing, "group", lambda scene: made.append(scene) or group(scene))
    first = group_of(scene)
    assert group_of(scene) is first and group_of(replace(scene, fps=12.0)) is first and made == [scene]
    others = replace(scene, static=replace(scene.static)), replace(scene, dynamic=replace(scene.dynamic))
    for count, other in enumerate(others, 2):
        assert group_of(other) is not first and len(made) == count
    group_of(scene)
    assert len(made) == 4
    head = scene.features.heads[0]
    assert not first.features(head).flags.writeable


def test_an_edited_scene_has_the_patches_of_its_base():
    scene = labelled_scene()
    origin = np.array([5, 900, 900, 0])
    edited = SimpleNamespace(base=scene, origin=origin, require_field=scene.require_field)
    found = group_of(edited)
    np.testing.assert_array_equal(found.index, group_of(scene).index[origin])
    assert found.bond is group_of(scene).bond
