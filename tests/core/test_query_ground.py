"""The floor of scenes whose floor is known, and of scenes that have none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from floater_scenes import planted

from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion
from f4x_core.query.ground import Plane, find_ground, ground_scores, is_of_ground, leaning, plane_through
from f4x_core.query.knowledge import refuse_unknown
from f4x_core.query.prompts import select_by_text


@pytest.mark.parametrize("kind", ["room", "street", "statue", "meadow"])
@pytest.mark.parametrize("pitch", [0.0, 25.0])
def test_the_floor_is_found_where_the_camera_looks_down(kind, pitch):
    scene, _, _ = planted(kind, 31)  # y = 1 is the floor
    turn = quaternion.from_rotation_vector(np.array([np.radians(pitch), 0, 0]))
    means = quaternion.rotate(turn, scene.static.means.astype(np.float64)).astype(np.float32)
    plane = find_ground(replace(scene, static=replace(scene.static, means=means)))
    up = quaternion.rotate(turn, np.array([0.0, -1, 0]))
    assert np.degrees(np.arccos(min(1.0, plane.normal @ up))) < 0.5 and plane.distance == pytest.approx(-1, abs=0.01)


@pytest.mark.parametrize("kind", ["cave", "shelf"])
def test_without_a_floor_none_is_made_up(kind):
    with pytest.raises(F4xError, match="No floor was found"):
        find_ground(planted(kind, 31)[0])


def test_the_lower_side_of_a_random_cloud_is_no_floor():
    scene, _, _ = planted("room", 31)
    means = np.random.default_rng(0).uniform((-1.3, -0.8, 3), (1.3, 0.8, 6), (len(scene.static), 3)).astype(np.float32)
    static = replace(scene.static, means=means, scales=np.full_like(means, 0.02))
    with pytest.raises(F4xError, match="No floor was found"):
        find_ground(replace(scene, static=static))


def test_a_floor_that_slopes_sideways_is_told():
    scene, _, _ = planted("room", 31)
    assert leaning(scene.cameras, Plane(np.array([0.0, -1, 0]), -1.0)) < 0.5
    sloping = Plane(np.array([np.sin(0.2), -np.cos(0.2), 0.0]), -1.0)
    assert leaning(scene.cameras, sloping) == pytest.approx(np.degrees(0.2), abs=0.5)


def test_a_plane_through_three_points():
    plane = plane_through(np.array([[0, 1, 0], [1, 1, 0], [0, 1, 1.0]]), np.zeros(3))
    np.testing.assert_allclose(plane.normal, [0, -1, 0])
    assert plane.distance == pytest.approx(-1) and plane.height(np.array([[0, 0, 0.0]]))[0] == pytest.approx(1)
    with pytest.raises(F4xError, match="nearly on one line"):
        plane_through(np.array([[0, 0, 0], [1, 0, 0], [2, 1e-3, 0]]), np.ones(3))


@pytest.mark.parametrize("kind", ["room", "street", "statue", "meadow"])
def test_the_ground_is_what_lies_level_in_its_plane(kind):
    scene, _, _ = planted(kind, 31)
    scene = replace(scene, static=replace(scene.static, scales=np.full_like(scene.static.scales, 0.05)))  # round ones
    count, low = len(scene.static), abs(scene.static.means[:, 1] - 1) < 0.01
    scores = ground_scores(scene)
    assert set(np.unique(scores)) == {0.0, 1.0} and not scores[count:].any()
    assert scores[:count][low].mean() > 0.9
    assert not scores[:count][scene.static.means[:, 1] < 0.5].any()
    np.testing.assert_array_equal(select_by_text(scene, ["the floor"]).chosen, scores > 0)  # without any features
    refuse_unknown(scene, "ground")


def test_feet_of_walls_are_no_ground():
    scene, _, _ = planted("room", 31)
    flat = np.tile(np.float32([0.05, 0.05, 0.001]), (len(scene.static), 1))  # normals along z: upright, all of them
    upright = replace(scene.static, scales=flat, quats=np.tile(np.float32([1, 0, 0, 0]), (len(flat), 1)))
    assert not ground_scores(replace(scene, static=upright)).any()


def test_a_scene_without_ground_says_what_to_do_instead():
    scene, _, _ = planted("cave", 31)
    with pytest.raises(F4xError, match=r"no ground was found.*click on the ground"):
        select_by_text(scene, ["ground"])


@pytest.mark.parametrize(
    ("label", "ground"), [("ground", True), ("The floor", True), ("grass", False), ("ground beetle", False)]
)
def test_words_for_the_ground(label, ground):
    assert is_of_ground(planted("room", 31)[0], label) == ground


@pytest.mark.parametrize(("encoder", "shape"), [("minilm", True), ("another", False)])
def test_a_teacher_that_knows_the_word_is_asked(encoder, shape):
    scene = planted("room", 31)[0]
    head = SimpleNamespace(spec=SimpleNamespace(text_encoder=encoder))
    assert is_of_ground(SimpleNamespace(features=SimpleNamespace(heads=[head]), name=scene.name), "ground") == shape
