"""Light that meshes take from points: shapes of shadows that geometry tells, lamps by what they give, nothing elsewhere."""

import numpy as np
import pytest
import trimesh
from shapes import plane, static_scene

from f4x_core.geometry.camera import Camera
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.shadows import SAMPLES, Area, Ball, Caster, Spot, Sun, light_left
from f4x_core.scene.stage import Cloud, draw

POINTS, _ = plane(40)
SUN = Sun(3.0, 0.0, np.array([0.0, 0, -1]))
CUBE = trimesh.creation.box((0.4, 0.6, 0.4), trimesh.transformations.translation_matrix((0.1, -0.2, 1.2)))


def caster(mesh):
    """Tries every triangle (Moeller and Trumbore 1997)."""
    corner, *others = mesh.triangles.transpose(1, 0, 2)
    first, second = (other - corner for other in others)

    def blocks(starts, ways):
        across = np.cross(ways[:, None], second)
        size = (across * first).sum(2)
        offset = starts[:, None] - corner
        beside = np.cross(offset, first)
        with np.errstate(all="ignore"):  # ways along a triangle
            u, v = (across * offset).sum(2) / size, (beside * ways[:, None]).sum(2) / size
            along = (beside * second).sum(2) / size
            return ((u >= 0) & (v >= 0) & (u + v <= 1) & (along >= 0) & (along <= 1)).any(1)

    return Caster(mesh.bounds, blocks)


def test_a_cube_before_the_sun_shades_its_outline():
    light = light_left(POINTS, [SUN], [caster(CUBE)], 0.75)
    inside = (np.abs(POINTS[:, 0] - 0.1) < 0.2) & (np.abs(POINTS[:, 1] + 0.2) < 0.3)
    assert inside.sum() > 50
    np.testing.assert_array_equal(light, np.where(inside, 0.25, 1.0))


def test_a_ball_of_light_throws_a_larger_shadow():
    near = Ball(100.0, 0.0, np.array([0.1, -0.2, 0.25]))
    light = light_left(POINTS, [near], [caster(CUBE)], 1.0)
    # the face of the cube that is nearer to the lamp, 0.75 before it, seen on the plane at 1.75
    edge = np.array([0.2, 0.3]) * 1.75 / 0.75
    inside = (np.abs(POINTS[:, :2] - [0.1, -0.2]) < edge).all(1)
    np.testing.assert_array_equal(light == 0, inside)


def test_a_lamp_behind_the_plane_or_before_the_cube_shades_nothing():
    for place in ([0.1, -0.2, 3.0], [0.1, -0.2, 1.7]):
        assert (light_left(POINTS, [Ball(1.0, 0.0, np.array(place))], [caster(CUBE)]) == 1).all()


def test_a_wide_sun_has_soft_shadows():
    wide = Sun(3.0, 0.2, np.array([0.0, 0, -1]))
    light = light_left(POINTS, [wide], [caster(CUBE)], 1.0)
    soft = (light > 0) & (light < 1)
    assert soft.any() and len(np.unique(light)) <= SAMPLES + 1
    # a half shadow reaches as far as the sun's edge does, from the near and from the far face: 0.6 and 1 before the plane
    out = np.maximum(np.abs(POINTS[:, 0] - 0.1) - 0.2, np.abs(POINTS[:, 1] + 0.2) - 0.3)
    assert out[soft].max() < 0.2 * 1.0 and (light[out > 0.2] == 1).all() and (light[out < -0.13] == 0).all()


def test_a_spot_shines_in_its_cone_alone():
    """Straight down on the plane, turned aside and squeezed: by the formula for one point after the other."""
    place, angle, blend = np.array([0.1, -0.2, 0.25]), 0.6, 0.4
    tilt = trimesh.transformations.rotation_matrix(2.9, [1.0, 0.2, 0])[:3, :3]
    for axes in (np.diag([1.0, -1, -1]), tilt @ np.diag([1.0, 2, 1])):
        spot = Spot(100.0, 0.0, place, np.linalg.inv(axes), np.cos(angle / 2), blend)
        ways, given = spot.rays(POINTS, 1.0)
        assert ways.shape == (len(POINTS), 1, 3)
        for point, way, found in zip(POINTS, ways[:, 0], given[:, 0], strict=True):
            np.testing.assert_allclose(point + way, place, atol=1e-12)
            x, y, z = np.linalg.solve(axes, point - place)
            inside = np.clip(
                (-z / np.sqrt(x * x + y * y + z * z) - np.cos(angle / 2)) / (1 - np.cos(angle / 2)) / blend, 0, 1
            )
            expected = 100 / (4 * np.pi) / (way @ way) * (3 * inside**2 - 2 * inside**3)
            assert found == pytest.approx(expected, abs=1e-9)
        assert (given == 0).any() and (given > 0).any()
    spot = Spot(100.0, 0.0, place, np.diag([1.0, -1, -1]), np.cos(angle / 2), 0.0)
    ball, other = (light_left(POINTS, [lamp], [caster(CUBE)], 1.0) for lamp in (Ball(1.0, 0.0, place), spot))
    in_cone = np.linalg.norm(POINTS[:, :2] - place[:2], axis=1) < (2 - 0.25) * np.tan(angle / 2)
    np.testing.assert_array_equal(other, np.where(in_cone, ball, 1.0))
    assert (other == 0).any() and (ball[~in_cone] == 0).any()


@pytest.mark.parametrize("is_round", [False, True])
def test_an_area_is_many_small_lamps(is_round):
    """Against 10,000 of its places, each of which shines by Lambert's law."""
    place, sides, towards = (
        np.array([0.3, 0.0, 0.6]),
        np.array([[0.2, 0, 0], [0, 0.028, 0.096]]),
        np.array([0, -0.96, 0.28]),
    )
    area = Area(5.0, place, sides, towards, is_round)
    grid = (np.arange(100) + 0.5) / 50 - 1
    u, v = (part.ravel() for part in np.meshgrid(grid, grid))
    inside = u * u + v * v < 1 if is_round else u < 2
    ways = place + np.stack([u, v], 1)[inside] @ sides - POINTS[:, None]
    squared = (ways**2).sum(2)
    given = 5 / np.pi * np.maximum(-(ways @ towards), 0) / squared**1.5 / inside.sum()
    np.testing.assert_allclose(
        area.rays(POINTS, 1.0)[1].sum(1), given.sum(1), rtol=0.02, atol=1e-3 * given.sum(1).max()
    )
    some = np.random.default_rng(0).permutation(inside.sum())[:400]
    ways, given = ways[:, some], given[:, some]
    free = ~np.array(
        [caster(CUBE).blocks(np.tile(point, (400, 1)), way) for point, way in zip(POINTS, ways, strict=True)]
    )
    expected = (given * free).sum(1) / np.maximum(given.sum(1), 1e-12)
    light = light_left(POINTS, [area], [caster(CUBE)], 1.0)
    shone = given.sum(1) > 0
    assert (~shone).any() and (light[~shone] == 1).all()
    off = np.abs(light - expected)[shone]  # steps of one of 16 places, and what 400 leave
    assert off.max() < 2 / SAMPLES and off.mean() < 0.5 / SAMPLES
    assert (light == 0).any() and ((light > 0.1) & (light < 0.9)).any()


def test_a_honeycomb_before_an_area_narrows_its_light():
    place, sides = np.array([0.1, -0.2, 1.0]), 0.01 * np.eye(3)[:2]
    wide, narrow = (
        Area(5.0, place, sides, np.array([0, 0, 1.0]), spread=spread).rays(POINTS, 1.0)[1].sum(1)
        for spread in (np.pi, 0.8)
    )
    off = np.linalg.norm(POINTS[:, :2] - place[:2], axis=1)
    assert (narrow[off > np.tan(0.4) + 0.02] == 0).all() and (narrow[off < np.tan(0.4) - 0.02] > 0).all()
    near = off.argmin()
    gain = (np.tan(0.4) - off[near]) / (np.tan(0.4) - 0.4)
    assert narrow[near] == pytest.approx(wide[near] * gain, rel=0.02) and gain > 4


def test_lamps_count_by_what_they_give():
    beside = Ball(12 * np.pi, 0.0, np.array([5.0, 0, 1.9]))
    light = light_left(POINTS, [SUN, beside], [caster(CUBE)], 1.0)
    shaded = light < 1
    given = 3 / ((POINTS[shaded] - beside.place) ** 2).sum(1)
    assert shaded.any()
    np.testing.assert_allclose(light[shaded], given / (given + 3))


def test_what_is_not_there():
    assert (light_left(POINTS, [], [caster(CUBE)]) == 1).all()
    assert (light_left(POINTS, [SUN], []) == 1).all()
    assert light_left(np.zeros((0, 3)), [SUN], [caster(CUBE)]).shape == (0,)


def test_points_are_looked_at_in_blocks(monkeypatch):
    wide = Sun(3.0, 0.1, np.array([0.0, 0, -1]))
    whole = light_left(POINTS, [wide, SUN], [caster(CUBE)])
    monkeypatch.setattr("f4x_core.scene.shadows.BLOCK", 100)
    np.testing.assert_array_equal(light_left(POINTS, [wide, SUN], [caster(CUBE)]), whole)
    assert (whole < 1).any()


def test_two_shadows_are_no_darker_than_one():
    again = trimesh.creation.box((0.4, 0.6, 0.1), trimesh.transformations.translation_matrix((0.1, -0.2, 0.5)))
    one, two = (light_left(POINTS, [SUN], [caster(mesh) for mesh in meshes]) for meshes in ([CUBE], [CUBE, again]))
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("degree", [0, 1])
def test_a_factor_is_linear_light_and_leaves_the_rest_alone(degree):
    scene = static_scene(*plane(20), 0.06)
    cloud = Cloud.of_scene(scene, 0.0)
    if degree:
        cloud.__dict__["sh"] = np.concatenate([cloud.sh, np.full((len(cloud.sh), 3, 3), 0.1, np.float32)], 1)
    light = np.where(cloud.means[:, 0] > 0, 0.3, 1.0)
    shaded = Cloud(**{**vars(cloud), "light": light})
    before, after = cloud.colors(np.zeros(3)), shaded.colors(np.zeros(3))
    np.testing.assert_array_equal(before[light == 1], after[light == 1])
    np.testing.assert_allclose(linear_from_srgb(after), linear_from_srgb(before) * light[:, None], atol=1e-6)
    camera = Camera(np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]]), np.eye(4), 64, 40)
    whole, dark = (draw([one], [], camera)["rgb"] for one in (cloud, shaded))
    np.testing.assert_array_equal(whole[:, :20], dark[:, :20])
    assert (dark[:, 36:60] < whole[:, 36:60]).any()
