"""The scenes of rendered clips: the table is whole, its halves part it, and what moves keeps to physics and its spec."""

import numpy as np
import pytest

from benchmarks.halves import PEOPLE as PEOPLE_HALVES
from benchmarks.halves import REAL, RENDERED, in_order
from f4x_core.clip.rendered_motion import RESTITUTION, body_poses, camera_poses
from f4x_core.clip.rendered_scenes import (
    ALL,
    EXAMPLES,
    GRID_MOTIONS,
    GRID_PATHS,
    PEOPLE,
    SCENES,
    Body,
    Swing,
    Way,
    scenes_named,
)
from f4x_core.clip.rendered_textures import PATTERNS, SIZE, texture
from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion

OPEN_AIR = [scene for scene in SCENES.values() if scene.setting in ("field", "yard")]
MOVERS = [(scene, body) for scene in OPEN_AIR for body in scene.bodies if body.way is not None]


def clip_times(scene):
    return np.arange(-1, scene.frames + 1) / (scene.frames - 1)


def corners_of(body: Body) -> np.ndarray:
    """A ball's or a box's surface about its centre."""
    if body.shape != "ball":
        return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2 * body.size
    points = np.random.default_rng(0).normal(size=(4000, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) / 2 * body.size


def test_the_table_has_what_was_asked_for():
    assert len(SCENES) >= 14 and all(name == scene.name for name, scene in SCENES.items())
    grid = {f"grid-{path}-{motion}" for path in GRID_PATHS for motion in GRID_MOTIONS}
    assert grid | {"falling", "pan-step", "walk", "orbit", "crossing", "return", "horizon"} <= SCENES.keys()
    assert {"procedural", "knight", "fox"} <= SCENES.keys()
    assert sum(scene.setting == "field" or scene.setting == "yard" for scene in SCENES.values()) > len(SCENES) / 2
    assert sum(scene.camera.path <= 0.2 for scene in OPEN_AIR) >= 5
    assert any("up" in scene.aside for scene in OPEN_AIR)


def test_the_halves_part_the_clips():
    assert sorted(RENDERED.every) == sorted(SCENES)
    assert sorted(PEOPLE_HALVES.every) == sorted(PEOPLE)
    for halves in (RENDERED, REAL, PEOPLE_HALVES):
        assert not set(halves.choosing) & set(halves.judging)
        assert abs(len(halves.choosing) - len(halves.judging)) <= 1
    assert REAL.half_of("train") == "choosing" and REAL.half_of("parkour") == "judging" and REAL.half_of("mine") == ""
    assert in_order(["mine", "parkour", "train", "dog"], REAL) == ["dog", "train", "parkour", "mine"]


def test_scenes_are_chosen_by_name():
    assert [scene.name for scene in scenes_named(["walk", "fox", "walk"])] == ["walk", "fox"]
    assert len(scenes_named([ALL])) == len(SCENES)
    with pytest.raises(F4xError, match="--scene run: no such scene; there are all, procedural"):
        scenes_named(["run"])


def test_examples_are_no_clips_that_anything_is_chosen_on_or_judged_by():
    assert not SCENES.keys() & EXAMPLES.keys() and len(EXAMPLES) == 3
    assert all(scene.camera.path >= 0.2 and not scene.models for scene in EXAMPLES.values())
    assert [scene.name for scene in scenes_named(["meeting"])] == ["meeting"]


def test_each_half_of_the_rendered_people_has_both_figures_and_two_at_once():
    for half in (PEOPLE_HALVES.choosing, PEOPLE_HALVES.judging):
        scenes = scenes_named(half)
        assert {model for scene in scenes for model in scene.models} == {"cesium_man", "knight"}
        assert any(len(scene.figures) > 1 for scene in scenes)
        assert all(24 <= scene.frames <= 48 and scene.size == (480, 270) for scene in scenes)
    assert len({scene.camera.distance for scene in PEOPLE.values()}) == 4  # as large in the picture as they are near


def test_what_swings_keeps_its_distance_and_looks_along_its_rope():
    swing = Swing(length=1.5, degrees=20, times=2, lowest=0.4)
    corners = corners_of(Body("box", (0.4, 0.4, 1.0), 1))
    times = np.linspace(0, 1, 33)
    places, turns = body_poses(Way(((0, 0.3, -0.2),), swing=swing), corners, times, 2.0)
    hung = np.array([0.3, -0.2, 0.4 + 0.5 + 1.5])
    np.testing.assert_allclose(np.linalg.norm(places - hung, axis=1), 1.5)
    up = quaternion.rotate(turns, np.tile([0.0, 0.0, 1.0], (len(times), 1)))
    np.testing.assert_allclose(up, (hung - places) / 1.5, atol=1e-12)
    lowest = (places[:, None] + quaternion.rotate(turns[:, None], corners[None]))[..., 2].min()
    assert lowest == pytest.approx(0.4, abs=0.02)  # a corner of the box reaches a little lower than its middle
    angle = np.degrees(np.arctan2(*(places - hung).T[[0]], -(places - hung)[:, 2]))
    assert angle.max() == pytest.approx(20) and angle.min() == pytest.approx(-20)
    assert (np.abs(angle[::8]) < 1e-9).all()  # there and back twice


@pytest.mark.parametrize("scene", OPEN_AIR, ids=lambda scene: scene.name)
def test_cameras_go_as_far_as_their_spec(scene):
    times = clip_times(scene)[1:-1]
    positions, targets = camera_poses(scene, times, seed=0)
    again = camera_poses(scene, times, seed=0)
    np.testing.assert_array_equal(positions, again[0])
    assert not np.array_equal(positions, camera_poses(scene, times, seed=1)[0])
    apart = np.linalg.norm(positions[-1] - positions[0])
    length = scene.camera.path * scene.camera.distance
    assert apart == pytest.approx(length, abs=0.1 * length + 4 * scene.camera.tremble)
    assert (positions[:, 2] > 1).all()
    ahead = (targets - positions) / np.linalg.norm(targets - positions, axis=1, keepdims=True)
    turned = np.degrees(np.arccos(np.clip(ahead @ ahead[0], -1, 1))).max()
    if scene.camera.kind == "pan":
        assert turned == pytest.approx(scene.camera.turn, abs=3)
    elif scene.camera.kind == "walk":
        assert turned < 3 and positions[-1, 1] - positions[0, 1] > 0.9 * length


@pytest.mark.parametrize(("scene", "body"), MOVERS, ids=lambda item: getattr(item, "name", getattr(item, "shape", "")))
def test_bodies_keep_to_their_way_and_above_the_ground(scene, body):
    times, corners = clip_times(scene), corners_of(body)
    stops = np.array(body.way.stops)
    assert (np.diff(stops[:, 0]) > 0).all() and stops[0, 0] == 0 and stops[-1, 0] == 1
    places, turns = body_poses(body.way, corners, times, scene.frames / 24)
    np.testing.assert_allclose(places[[1, -2], :2], stops[[0, -1], 1:], atol=1e-9)
    lowest = (quaternion.rotate(turns[:, None], corners[None]) + places[:, None])[..., 2].min(1)
    assert lowest.min() > -1e-9
    if body.way.drop == 0 and body.way.hops[0] == 0:
        assert lowest.max() < 1e-9


def test_a_falling_box_bounces_lower_each_time_and_comes_to_rest_on_a_side():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.3
    clock = np.linspace(0, 1, 601)
    places, turns = body_poses(Way(((0, 0.0, 0.0), (1, 0.5, 0.0)), drop=1.2), corners, clock, seconds=3.0)
    height = (quaternion.rotate(turns[:, None], corners[None]) + places[:, None])[..., 2].min(1)
    fall = np.sqrt(2 * 1.2 / 9.81)
    assert height[0] == pytest.approx(1.2) and height[clock * 3 < fall].min() >= 0
    flying = clock * 3 > fall
    assert height[flying].max() == pytest.approx(RESTITUTION**2 * 1.2, rel=0.01)
    assert height[-1] == 0 and places[-1, 2] == pytest.approx(0.3)  # it lies on a face, not on an edge


def test_a_ball_rolls_without_slipping():
    body = Body("ball", (0.6, 0.6, 0.6), 0, way=Way(((0, 0.0, 0.0), (1, 0.9, 0.0)), rolls=True))
    times = np.linspace(0, 1, 200)
    places, turns = body_poses(body.way, corners_of(body), times, seconds=1.0)
    touching = quaternion.rotate(quaternion.conjugate(turns), np.array([0.0, 0.0, -0.3]))  # in the ball's own frame
    below = quaternion.rotate(turns[1:], touching[:-1]) + places[1:]  # where that point of the skin is one moment later
    moved = np.linalg.norm(below - (places[:-1] - np.array([0, 0, 0.3])), axis=1)
    assert moved.max() < 0.1 * np.linalg.norm(np.diff(places, axis=0), axis=1).max()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_tile_and_are_strong(pattern):
    image = texture(7, pattern)
    assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
    np.testing.assert_array_equal(image, texture(7, pattern))
    assert image.std() > 0.1 > texture(7, pattern, strength=0.2).std() + 0.01
    steps = np.abs(np.diff(image, axis=0)).mean((1, 2))
    assert np.abs(image[0] - image[-1]).mean() < 1.3 * steps.max()  # no edge that the inside does not have
