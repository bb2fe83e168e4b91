"""A stage as textures: what is where, what is filled again, and the matrix that draws triangles."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.errors import F4xError
from f4x_core.geometry.camera import Camera
from f4x_core.scene.depth_order import OrderSettings
from f4x_core.scene.splat_textures import (
    CHANNELS,
    VIEW_TEXELS,
    WIDTH,
    SplatTextures,
    clip_matrix,
    refuse_too_large,
    triangle_vertices,
)
from f4x_core.scene.stage import Cloud, Surface

COUNTS = (WIDTH - 5, 9)


def make_clouds() -> list[Cloud]:
    rng = np.random.default_rng(0)

    def cloud(count: int, terms: int, **more) -> Cloud:
        shapes = {
            "means": (count, 3),
            "quats": (count, 4),
            "scales": (count, 3),
            "opacities": (count,),
            "sh": (count, terms, 3),
        }
        return Cloud(**{name: rng.uniform(0.1, 1, shape).astype(np.float32) for name, shape in shapes.items()}, **more)

    turn = rng.normal(size=(COUNTS[1], 4)).astype(np.float32)
    move = np.array([[2.0, 0, 0, 1], [0, 1, 0.5, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
    return [cloud(COUNTS[0], 1), cloud(COUNTS[1], 4, turn=turn, to_world=move)]


def texels(textures: SplatTextures, name: str, first: int, count: int) -> np.ndarray:
    """(count, channels) read as the shader reads."""
    places = np.arange(first, first + count)
    return textures.arrays[name][places // WIDTH, places % WIDTH]


def test_every_number_is_where_the_shader_looks_for_it():
    textures, clouds = SplatTextures(), make_clouds()
    assert textures.update(clouds[::-1]) == set(CHANNELS)  # what motion turns comes last
    assert (len(textures), textures.split, textures.terms) == (sum(COUNTS), COUNTS[0], 3)
    for i in (0, COUNTS[0] - 1, COUNTS[0], sum(COUNTS) - 1):
        number = int(i >= COUNTS[0])
        cloud, own = clouds[number], i - number * COUNTS[0]
        page = "moving_" * number
        assert np.array_equal(texels(textures, f"{page}means", 3 * own, 3)[:, 0], cloud.means[own])
        assert np.array_equal(texels(textures, f"{page}quats", own, 1)[0], cloud.quats[own])
        if number:
            assert np.array_equal(texels(textures, "turns", own, 1)[0], cloud.turn[own])
        assert np.array_equal(texels(textures, "shapes", i, 1)[0], [*cloud.scales[own], number])
        assert np.array_equal(texels(textures, "looks", i, 1)[0], [*cloud.sh[own, 0], cloud.opacities[own]])
        higher = np.zeros((3, 3)) if number == 0 else cloud.sh[own, 1:]
        assert np.array_equal(texels(textures, "harmonics", 3 * i, 3)[:, :3], np.float32(higher))


def test_only_what_is_another_array_is_filled_again():
    textures, clouds = SplatTextures(), make_clouds()
    textures.update(clouds)
    assert textures.update(clouds) == set()
    moved = replace(clouds[1], means=clouds[1].means + 1, quats=clouds[1].quats.copy())
    assert textures.update([clouds[0], moved]) == {"moving_means", "moving_quats"}
    assert np.array_equal(texels(textures, "moving_means", 0, 3)[:, 0], moved.means[0])
    assert textures.update([clouds[0], replace(moved, opacities=moved.opacities * 0)]) == {"looks"}
    assert textures.update([clouds[0], replace(moved, to_world=np.eye(4))]) == {
        "looks"
    }  # the opacities are the old ones again
    known = replace(clouds[1], higher=clouds[1].sh)
    textures.update([clouds[0], known])
    assert textures.update([clouds[0], replace(known, sh=known.sh + np.eye(4, 1))]) == {"looks"}
    assert textures.update(clouds[:1]) == set(CHANNELS)


def test_views_and_orders_are_those_of_the_clouds():
    textures, clouds = SplatTextures(), make_clouds()
    textures.update(clouds)
    world_to_camera = np.eye(4)
    world_to_camera[:3, 3] = 0.1, 0.2, 0.3
    camera = Camera(np.array([[100, 0, 50], [0, 100, 40], [0, 0, 1.0]]), world_to_camera, 100, 80)
    view = textures.view(camera).reshape(2, VIEW_TEXELS, 4)
    point = clouds[1].to_world @ [0.3, 0.4, 0.5, 1]
    assert np.allclose(view[1, :3] @ [0.3, 0.4, 0.5, 1], (world_to_camera @ point)[:3], atol=1e-6)
    assert np.allclose(clouds[1].to_world @ [*view[1, 3, :3], 1], [*camera.center, 1], atol=1e-6)

    order, count = textures.order(camera, OrderSettings(0.01, np.inf, 0.05))
    z = np.concatenate([(c.means @ c.to_world[2, :3] + c.to_world[2, 3]) for c in clouds]) + 0.3
    assert count == sum(COUNTS) and np.all(np.diff(z[order.ravel()[:count].astype(int)]) <= 1e-6)
    textures.update([])
    assert textures.order(camera, OrderSettings(0.01, np.inf, 0.05))[1] == 0


def test_triangles_land_on_the_pixels_that_the_camera_projects_to():
    camera = Camera(np.array([[90, 0, 40], [0, 80, 45], [0, 0, 1.0]]), np.eye(4), 100, 80)
    point = np.array([0.2, -0.3, 2.0])
    x, y, z, w = clip_matrix(camera, near=0.5) @ [*point, 1]
    pixel = (camera.intrinsics @ point)[:2] / point[2]
    assert np.allclose([(x / w + 1) * 50, (1 - y / w) * 40], pixel) and w == point[2] and -w < z < w
    assert np.isclose((clip_matrix(camera, near=2.0) @ [*point, 1])[2], -2.0)  # exactly on the near plane


def test_corners_of_surfaces_have_their_triangles_colour_and_a_holdout_is_black():
    triangles = np.array([[[0, 0, 1], [1, 0, 1], [0, 1, 1.0]]])
    shown = Surface(triangles, np.array([[0.5, 0.25, 1.0]]))
    corners = triangle_vertices([shown, replace(shown, holdout=True)])
    assert np.array_equal(corners["color"][:, :3], [[0.5, 0.25, 1]] * 3 + [[0, 0, 0]] * 3)
    assert np.array_equal(corners["normal"], [[0, 0, 1]] * 6) and corners["pos"].shape == (6, 3)


def test_a_card_that_is_too_small_is_named():
    textures = SplatTextures()
    textures.update(make_clouds())
    refuse_too_large(textures, 4)
    with pytest.raises(F4xError, match="textures of 4 rows, the graphics card takes 2"):
        refuse_too_large(textures, 2)
