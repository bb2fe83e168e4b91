"""What always stands behind a mover is made up from what is around it; all else stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import SQUARE, WALL, labelled_scene, sheet

from f4x_core.fit.covered import BEHIND, _light, completed, harmonic
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.trajectory import View
from f4x_core.query.unseen import unseen_gaussians
from f4x_core.scene import MADE_UP, DynamicSet, StaticSet
from f4x_core.scene.concatenation import followed_by
from f4x_core.scene.people import People, people_of, with_people
from f4x_core.scene.view import render

BLUE, RED, GREEN = (0.2, 0.3, 0.8), (0.8, 0.2, 0.1), (0.1, 0.7, 0.2)


def before_a_wall(frames, slope=0.0):
    """The labelled scene's first frames, its wall `slope` per unit to the side farther away, and where the square stands in
    all of the first three."""
    scene = labelled_scene(features=False)
    path, means = scene.cameras, scene.static.means.copy()
    means[:, 2] += slope * means[:, 0]
    cameras = CameraPath(
        path.intrinsics[:frames], path.world_to_camera[:frames], path.times[:frames], path.width, path.height
    )
    behind = (means[:, 0] > -0.26) & (means[:, 0] < -0.14) & (abs(means[:, 1]) < 0.12)
    return replace(scene, static=replace(scene.static, means=means), cameras=cameras), behind


def ghost(frames):
    """The wall is red behind the square."""
    scene, behind = before_a_wall(frames)
    sh = scene.static.sh.copy()
    sh[behind] = spherical_harmonics.dc_from_rgb(np.float32(RED))
    return replace(scene, static=replace(scene.static, sh=sh)), behind


def hollow(frames, slope=0.0):
    """The wall has a hole behind the square."""
    scene, behind = before_a_wall(frames, slope)
    return replace(scene, static=scene.static.take(~behind))


def made(before, after):
    """The new Gaussians."""
    return after.static.take(slice(len(before.static), None))


def plate(scene, frame=1):
    """What a frame would show if nothing moved."""
    still = replace(scene, dynamic=DynamicSet.empty(), scaffold=None, extra={})
    return render(still, scene.cameras[frame], float(frame), ("rgb", "depth", "alpha"))


def colours(static):
    return spherical_harmonics.rgb_from_dc(static.sh[:, 0])


def test_what_no_frame_shows_gets_the_colours_around_it():
    scene, behind = ghost(3)
    assert behind.sum() >= 8
    found = completed(scene).static
    np.testing.assert_allclose(colours(found)[behind], np.tile(BLUE, (behind.sum(), 1)), atol=0.02)
    rest = replace(found, sh=np.where(behind[:, None, None], scene.static.sh, found.sh))
    np.testing.assert_allclose(rest.sh, scene.static.sh, atol=1e-3)  # blue stays blue
    assert len(found) == len(scene.static)  # an opaque wall needs no more


def test_a_sliver_at_the_rim_of_a_frame_shows_nothing_of_the_whole():
    """The last frame, without the square, looks to the side: of some of the ghost a rim is left in its corner."""
    scene, behind = ghost(3)
    path = scene.cameras
    pixels = path[2].project(scene.static.means[behind])[0]
    aside = path.intrinsics[2].copy()
    aside[0, 2] -= pixels[:, 0].max() + 2.5
    cameras = CameraPath(
        np.concatenate([path.intrinsics, aside[None]]),
        np.concatenate([path.world_to_camera, path.world_to_camera[2:]]),
        np.append(path.times, 60.0),
        path.width,
        path.height,
    )
    gone = np.tile(np.float32([-np.inf, -np.inf, 50, 50]), (len(scene.dynamic), 1))
    scene = replace(scene, cameras=cameras, dynamic=replace(scene.dynamic, span=gone))
    alone = _light(scene.background, View(cameras[3].of_width(240), 60.0))[: len(behind)]
    assert (alone[behind] > 0.1).any()
    found = colours(completed(scene).static)[behind]
    np.testing.assert_allclose(found, np.tile(BLUE, (behind.sum(), 1)), atol=0.05)


@pytest.mark.parametrize("make", [lambda: ghost(6)[0], lambda: hollow(6)])
def test_what_comes_to_light_in_one_frame_stays(make):
    scene = make()
    assert completed(scene).static is not scene.static
    for name, array in completed(scene).static.arrays().items():
        np.testing.assert_array_equal(array, scene.static.arrays()[name])


@pytest.mark.parametrize("change", [{"dynamic": DynamicSet.empty(), "scaffold": None}, {"static": StaticSet.empty()}])
def test_without_movers_or_background_nothing_is_made_up(change):
    scene = replace(hollow(3), **change)
    assert completed(scene) is scene


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_a_hole_in_a_wall_is_closed_by_the_wall(slope):
    scene = hollow(3, slope)
    found = completed(scene)
    new = made(scene, found)
    assert 5 < len(new) < 200
    hole = plate(scene)["alpha"] < 0.5
    assert hole.sum() > 20
    closed = plate(found)
    assert closed["alpha"][hole].min() > 0.9
    np.testing.assert_allclose(closed["rgb"][hole], np.tile(BLUE, (hole.sum(), 1)), atol=0.05)
    np.testing.assert_allclose(new.means[:, 2], BEHIND * (WALL + slope * new.means[:, 0]), rtol=0.02)


def test_pictures_along_the_path_stay():
    scene = hollow(3)
    found = completed(scene)
    for frame, camera in enumerate(found.cameras):
        before, after = (render(one, camera, float(frame), ("rgb",))["rgb"] for one in (scene, found))
        assert np.abs(before - after).max() < 0.025  # at the square's edge, which lets a little through
        assert np.abs(before - after).mean() < 3e-4


def test_what_stands_before_a_mover_does_not_go_on_behind_it():
    """A post nearer than the square hides its left half; what is made up right of it is wall."""
    scene = hollow(3)
    post = sheet(np.linspace(-0.28, -0.14, 12), np.linspace(-0.5, 0.5, 60), SQUARE - 0.3, 0.012, GREEN)
    nearer = StaticSet(ids=50_000 + np.arange(len(post["means"])), **post)
    scene = replace(scene, static=followed_by(scene.static, nearer))
    new = made(scene, completed(scene))
    assert len(new)
    np.testing.assert_allclose(colours(new), np.tile(BLUE, (len(new), 1)), atol=0.06)
    assert (new.means[:, 2] > SQUARE).all()


def test_what_is_made_up_is_told():
    scene = hollow(3)
    found, again = completed(scene), completed(scene)
    count = len(made(scene, found))
    assert found.needs[-1]["chosen"].startswith(f"Gaussians made up: {count}, ")
    assert "3 views" in found.needs[-1]["evidence"]
    assert made(scene, found).ids.min() >= scene.next_id
    assert found.next_id > found.static.ids.max() and len(np.unique(found.ids)) == len(found.ids)
    assert found.extra[MADE_UP][len(scene.static) :].all()
    assert unseen_gaussians(found)[: len(found.static)][found.extra[MADE_UP]].all()
    np.testing.assert_array_equal(found.static.means, again.static.means)


def test_what_comes_and_goes_does_so_beside_what_is_made_up():
    scene = hollow(3)
    span = np.tile(np.float32([-np.inf, -np.inf, 50, 50]), (len(scene.static), 1))
    found = completed(replace(scene, static=replace(scene.static, span=span)))
    np.testing.assert_array_equal(found.static.span[: len(span)], span)
    assert len(found.static) > len(span) and np.isinf(found.static.span[len(span) :]).all()


def test_a_plane_goes_on_as_a_plane():
    row, column = np.mgrid[:20, :30]
    ramp = np.stack([2.0 * row - column, 0.5 * column + 3], -1)
    known = np.ones((20, 30), bool)
    known[4:15, 7:22] = False
    given = np.where(known[..., None], ramp, np.nan)
    np.testing.assert_allclose(harmonic(given, known), ramp, atol=1e-9)


def test_where_only_one_side_is_known_that_goes_on():
    known = np.zeros((3, 5), bool)
    known[:, 0] = True
    np.testing.assert_allclose(harmonic(np.full((3, 5, 1), 7.0), known), 7)


def test_people_keep_their_labels_and_what_is_made_up_is_nobodys():
    before = hollow(3)
    people = People(before.moving.astype(np.uint8), 5 * before.moving.astype(np.uint8))
    after = completed(with_people(before, people))
    assert len(made(before, after)) > 0 and MADE_UP in after.extra
    assert np.array_equal(people_of(after).person, after.moving) and np.array_equal(
        people_of(after).part, 5 * after.moving
    )
