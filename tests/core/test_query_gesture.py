"""Gestures over a view: shapes against plain geometry, and what they select of a square that moves before a wall."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.errors import F4xError
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.geometry.trajectory import aside
from f4x_core.query.blend_weights import Look, seen_sums
from f4x_core.query.gesture import View, select_by_gesture, select_by_sphere, select_thing
from f4x_core.query.shapes import Polygon, Rectangle, Stroke
from f4x_core.raster.blend_weights import alpha_sums, blend_weight_sums
from f4x_core.scene.clouds import fitted_config

SCENE = labelled_scene()
COUNT = len(SCENE.static)
"""Gaussians of the wall; those of the square come after them."""


def view(time=2.0, **changes):
    return View(SCENE.cameras.at(time), time, **changes)


def box_of_square(time, margin=3.0):
    posed = SCENE.posed(time)
    pixels, _ = SCENE.cameras.at(time).project(posed.means[posed.dynamic])
    return Rectangle(tuple(pixels.min(0) - margin), tuple(pixels.max(0) + margin))


def chosen(selection):
    """(fraction of the wall, fraction of the square) that is chosen."""
    return selection.chosen[:COUNT].mean(), selection.chosen[COUNT:].mean()


@pytest.mark.parametrize(
    "shape",
    [
        Rectangle((7.0, 20.0), (30.0, 4.5)),
        Polygon([(3.0, 3.0), (30.0, 6.0), (12.0, 11.0), (28.0, 25.0), (5.0, 22.0)]),
        Stroke([(6.0, 7.0), (20.0, 12.0), (21.0, 25.0)], 4.5),
        Stroke([(15.0, 15.0)], 6.0),
    ],
)
def test_shapes_are_those_of_a_plain_drawing(shape):
    import cv2

    pixels = np.stack(np.meshgrid(np.arange(40.0), np.arange(32.0)), -1)
    drawn, fine = np.zeros((320, 400), np.uint8), 10
    scaled = lambda points: np.round(np.asarray(points) * fine).astype(np.int32)  # noqa: E731
    if isinstance(shape, Rectangle):
        (x0, y0), (x1, y1) = scaled((shape.corner, shape.opposite))
        cv2.rectangle(drawn, (x0, y0), (x1, y1), 1, -1)
    elif isinstance(shape, Polygon):
        cv2.fillPoly(drawn, [scaled(shape.outline)], 1)
    else:
        path = scaled(shape.path)
        cv2.polylines(drawn, [path.reshape(-1, 1, 2)], False, 1, round(2 * shape.radius * fine), cv2.LINE_8)
        for corner in path.tolist():
            cv2.circle(drawn, corner, round(shape.radius * fine), 1, -1)
    edge = cv2.dilate(drawn, np.ones((5, 5))) != cv2.erode(
        drawn, np.ones((5, 5))
    )  # half a tenth of a pixel is rounding
    sure = ~edge[::fine, ::fine]
    found = shape.contains(pixels.reshape(-1, 2)).reshape(32, 40)
    assert 0.05 < found.mean() < 0.9 and sure.mean() > 0.8
    np.testing.assert_array_equal(found[sure], drawn[::fine, ::fine][sure] > 0)


def test_a_lasso_that_crosses_itself_leaves_out_what_it_encloses_twice():
    star = [(np.sin(4 * np.pi * i / 5), -np.cos(4 * np.pi * i / 5)) for i in range(5)]
    assert Polygon(star).contains(np.array([[0.0, 0.0], [0.0, -0.8]])).tolist() == [False, True]


def test_three_corners_enclose_a_triangle():
    triangle = Polygon([(0.0, 0.0), (4.0, 0.0), (0.0, 4.0)])
    assert triangle.contains(np.array([[1.0, 1.0], [3.0, 3.0], [-1.0, 1.0]])).tolist() == [True, False, False]


def test_the_seen_are_the_square_and_through_it_the_wall():
    seen, through = (select_by_gesture(SCENE, view(), box_of_square(2.0), through=deep) for deep in (False, True))
    assert chosen(seen)[1] == 1 and chosen(through)[1] == 1
    behind = through.chosen[:COUNT] & box_of_square(2.0, -1.5).contains(
        SCENE.cameras.at(2.0).project(SCENE.static.means)[0]
    )
    assert behind.sum() > 10 and not (seen.chosen[:COUNT] & behind).any()
    as_it_is = select_by_gesture(SCENE, view(), box_of_square(2.0))
    np.testing.assert_array_equal(as_it_is.chosen, seen.chosen)  # what is seen, unless asked otherwise


@pytest.mark.parametrize("through", [False, True])
def test_moving_gaussians_are_met_where_they_are(through):
    """Where the square is first, the wall alone is later."""
    first, last = float(SCENE.cameras.times[0]), float(SCENE.cameras.times[-1])
    shape = box_of_square(first, -2.0)
    assert chosen(select_by_gesture(SCENE, view(first), shape, through=through))[1] > 0.4
    later = select_by_gesture(SCENE, view(last), shape, through=through)
    assert chosen(later)[1] == 0 < chosen(later)[0]


def test_what_stands_elsewhere_in_the_world_is_met_there():
    """A scene that is turned, shrunk and moved, with the camera moved along, gives the same selection."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = 0.5 * turn, (3.0, -2.0, 1.0)
    camera = SCENE.cameras.at(2.0)
    there = np.eye(4)
    there[:3, :3] = camera.world_to_camera[:3, :3] @ turn.T
    centre = to_world[:3, :3] @ camera.center + to_world[:3, 3]
    there[:3, 3] = -there[:3, :3] @ centre
    moved = View(Camera(camera.intrinsics, there, camera.width, camera.height), 2.0, to_world=to_world)
    for through in (False, True):
        expected, found = (select_by_gesture(SCENE, at, box_of_square(2.0), through=through) for at in (view(), moved))
        np.testing.assert_allclose(found.scores, expected.scores, atol=2e-3)
    sphere = select_by_sphere(SCENE, moved, to_world[:3, :3] @ SCENE.static.means[0] + to_world[:3, 3], 0.1)
    np.testing.assert_array_equal(sphere.chosen, select_by_sphere(SCENE, view(), SCENE.static.means[0], 0.2).chosen)


def test_a_sphere_selects_by_distance_at_its_time():
    for time in (0.0, 4.0):
        means = SCENE.posed(time).means
        found = select_by_sphere(SCENE, view(time), means[-1], 0.16)
        np.testing.assert_array_equal(found.chosen, np.linalg.norm(means - means[-1], axis=1) <= 0.16)
        assert found.chosen.any() and found.chosen.mean() < 0.2


def test_what_is_hidden_neither_hides_nor_is_selected():
    hidden = np.arange(len(SCENE.ids)) >= COUNT
    found = select_by_gesture(SCENE, view(hidden=hidden), box_of_square(2.0, -1.0))
    assert chosen(found)[1] == 0 and chosen(found)[0] > 0.01


def test_nothing_before_the_near_plane_is_selected():
    found = select_by_gesture(SCENE, view(near=1.0), box_of_square(2.0), through=True)
    assert chosen(found)[1] == 0 < chosen(found)[0]
    assert chosen(select_by_gesture(SCENE, view(near=1.0), box_of_square(2.0)))[1] == 0


@pytest.mark.parametrize("turned", [False, True])
def test_a_stroke_on_the_square_shows_the_whole_square(turned):
    """Also from beside, where the clip's camera is not."""
    camera = SCENE.cameras.at(2.0)
    if turned:
        camera = aside(SCENE.cameras, 2.0, right=15.0, up=8.0).camera
    posed = SCENE.posed(2.0)
    pixels, _ = camera.project(posed.means[posed.dynamic])
    (x, y), width = pixels.mean(0), np.ptp(pixels[:, 0])
    stroke = Stroke([(x - 0.2 * width, y), (x + 0.2 * width, y)], 0.15 * width)
    painted = select_by_gesture(SCENE, View(camera, 2.0), stroke)
    assert 0.02 < chosen(painted)[1] < 0.6
    assert chosen(select_thing(SCENE, painted, 2, around=False)) == (0, 1)


def test_a_lasso_around_the_square_shows_the_square_without_the_wall():
    (left, top), (right, bottom) = box_of_square(2.0).corner, box_of_square(2.0).opposite
    lasso = Polygon([(left, top), (right, top), (right, bottom), (left, bottom)])
    marked = select_by_gesture(SCENE, view(), lasso)
    assert chosen(marked)[0] > 0
    assert chosen(select_thing(SCENE, marked, 2, around=True)) == (0, 1)


def test_what_the_clip_does_not_see_shows_nothing():
    nothing = select_by_gesture(SCENE, view(), Rectangle((0.0, 0.0), (0.001, 0.001)))
    with pytest.raises(F4xError, match="does not see"):
        select_thing(SCENE, nothing, 2, around=True)


def test_alpha_sums_are_the_blend_weights_of_gaussians_alone():
    rng = np.random.default_rng(0)
    camera = Camera(np.array([[80.0, 0, 48], [0, 80, 40], [0, 0, 1]]), np.eye(4), 96, 80)
    for _ in range(20):
        quats = rng.normal(size=(1, 4))
        one = Splats(
            np.array([[0.05, -0.03, 1.5]]), quats, rng.uniform(0.03, 0.12, (1, 3)), rng.uniform(0.1, 0.9, 1)
        ).map(np.float32)
        drawn = blend_weight_sums(one, camera, np.ones((80, 96, 1)))[0, 0]
        assert alpha_sums(one, camera)[0] == pytest.approx(drawn, rel=0.01)
    away = replace(one, means=one.means + np.float32([9, 0, 0]))
    assert alpha_sums(away, camera)[0] == 0


def test_who_shows_and_how_much_of_it_lies_in_each_layer():
    """In view, behind an opaque one, half hidden by a faint one, over the right edge, and beyond it."""
    camera = Camera(np.array([[80.0, 0, 48], [0, 80, 40], [0, 0, 1]]), np.eye(4), 96, 80)
    means = [(-0.3, 0, 1.5), (-0.3, 0, 2.0), (0.3, 0, 1.5), (0.3, 0, 2.0), (1.0, 0, 1.6), (1.6, 0, 1.6)]
    count = len(means)
    sizes, opacities = np.full((count, 3), 0.03), np.array([0.98, 0.9, 0.4, 0.9, 0.9, 0.9])
    sizes[0], sizes[2] = 0.2, 0.12
    splats = Splats(np.array(means), np.tile([1.0, 0, 0, 0], (count, 1)), sizes, opacities).map(np.float32)
    config = fitted_config([], camera)
    columns = np.mgrid[:80, :96][1]
    layers = np.stack([columns < 48, columns < 30, columns >= 0], -1).astype(np.float32)
    look = Look(splats, camera, config)
    sums, seen = seen_sums(look, layers, 0.3)
    assert sums.shape == (count, 3) and seen.tolist() == [True, False, True, True, True, False]
    np.testing.assert_allclose(sums, blend_weight_sums(splats, camera, layers, config=config), rtol=1e-3, atol=1e-3)
    assert not seen_sums(look, layers, 0.8)[1][3]  # 60 % of it passes
    assert seen_sums(look, layers[..., :0], 0.3)[0].shape == (count, 0)


def test_what_is_no_gesture_is_refused():
    for wrong in (lambda: Polygon([(0, 0), (1, 1)]), lambda: Stroke([], 2.0), lambda: Stroke([(0, 0)], 0.0)):
        with pytest.raises(F4xError, match="needs"):
            wrong()
    with pytest.raises(F4xError, match="radius"):
        select_by_sphere(SCENE, view(), (0, 0, 0), 0.0)
