"""Which Gaussians make up one thing, and which of several things is meant, against sums written out."""

from types import SimpleNamespace

import numpy as np
import pytest

from f4x_core.edit.change import DIRECTIONS
from f4x_core.geometry.camera import Camera
from f4x_core.query.connected_objects import (
    centres_of,
    connect,
    label_components,
    part_of,
    pick_object,
    split_objects,
    stand_to,
    width_along,
)
from f4x_core.scene.model import PosedSplats

CAMERA = Camera(np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]]), np.eye(4), 64, 40)


def splats(groups):
    """Groups (place, number, scales, opacity), the Gaussians of each a thousandth apart: PosedSplats, and every group's rows."""
    means, scales, opacities, rows = [], [], [], []
    for place, count, size, opacity in groups:
        rows.append(np.arange(len(means), len(means) + count))
        means += [np.add(place, (0.001 * k, 0, 0)) for k in range(count)]
        scales += [size] * count
        opacities += [opacity] * count
    count = len(means)
    shape, looks = (np.float32(means), np.zeros((count, 4))), (np.float32(opacities), np.zeros((count, 1, 3)))
    known = {"ids": np.arange(count), "dynamic": np.zeros(count, bool)}
    return PosedSplats(*shape, np.float32(scales), *looks, **known), rows


def sizes_of(*groups):
    """The objects' numbers of the groups, far apart, and which of these are strays."""
    posed, rows = splats([((10.0 * k, 0, 5), *group) for k, group in enumerate(groups)])
    owner, stray = split_objects(posed, np.concatenate(rows))
    return [owner[part[0]] for part in rows], [bool(stray[part[0]]) for part in rows]


FLAT = (0.1, 0.02, 0.1)


def test_size_is_the_mean_of_surface_and_opacity():
    """sqrt(opacity times the two largest deviations, times opacity): n o sqrt(a b) of n alike."""
    assert sizes_of((4, FLAT, 0.5), (9, FLAT, 0.5), (6, FLAT, 0.5))[0] == [2, 0, 1]
    assert sizes_of((4, FLAT, 0.2), (4, FLAT, 0.5), (4, FLAT, 0.3))[0] == [2, 0, 1]
    assert sizes_of((4, (0.1, 0.01, 0.05), 0.5), (4, (0.01, 0.2, 0.05), 0.5))[0] == [1, 0]  # .005 and .01 of surface
    assert sizes_of((4, (0.1, 0.09, 0.1), 0.5), (4, (0.01, 0.21, 0.05), 0.5))[0] == [1, 0]  # .0100 and .0105
    assert sizes_of((4, FLAT, 0.5), (10, (0.06, 0.06, 0.01), 0.2))[0] == [
        0,
        1,
    ]  # sqrt(.02 2) = .2 and sqrt(.0072 2) = .12


def test_surface_goes_by_the_product_of_both_large_deviations():
    """.2 by .1 against .15 by .12: the sums are .30 and .27, the products .020 and .018, the squares .04 and .0225."""
    assert sizes_of((4, (0.15, 0.12, 0.01), 0.5), (4, (0.2, 0.1, 0.01), 0.5))[0] == [1, 0]
    assert sizes_of((4, (0.13, 0.16, 0.01), 0.5), (4, (0.2, 0.1, 0.01), 0.5))[0] == [0, 1]


def test_what_cannot_be_seen_has_a_size_all_the_same():
    assert sizes_of((2, FLAT, 0.0), (5, FLAT, 0.0)) == ([1, 0], [False, False])


@pytest.mark.parametrize(("count", "number", "stray"), [(11, 1, False), (9, 0, False), (2, 0, False), (0.9, 0, True)])
def test_a_tenth_is_a_thing_and_a_hundredth_a_stray(count, number, stray):
    """Beside a thing of a hundred alike; nine tenths of one are one of nine tenths of the opacity."""
    small = (max(1, int(count)), FLAT, 0.5 if count >= 1 else 0.5 * count)
    assert sizes_of((100, FLAT, 0.5), small) == ([0, number], [False, stray])


def test_what_is_too_small_joins_the_nearest_thing():
    groups = [
        ((0, 0, 5), 20, FLAT, 0.5),
        ((10, 0, 5), 20, FLAT, 0.4),
        ((6, 0, 5), 1, FLAT, 0.5),
        ((4, 0, 5), 1, FLAT, 0.5),
    ]
    posed, rows = splats(groups)
    owner, _ = split_objects(posed, np.concatenate(rows))
    assert [owner[part[0]] for part in rows] == [0, 1, 1, 0]


@pytest.mark.parametrize(("gap", "things"), [(0.25, 1), (0.65, 2)])
def test_gaussians_are_linked_within_three_sizes(gap, things):
    """Cells are .3 wide; what lies in cells that touch is linked."""
    posed, rows = splats([((0, 0, 5), 4, FLAT, 0.5), ((gap, 0, 5), 4, FLAT, 0.5)])
    assert split_objects(posed, np.concatenate(rows))[0].max() + 1 == things


def test_in_a_large_selection_sparse_gaussians_are_linked():
    """A sixtieth of an extent of 60 is 1, though Gaussians are .001 small."""
    small = (0.001, 0.001, 0.001)
    posed, rows = splats([((x, 0, 5), 1, small, 0.5) for x in np.linspace(0, 60, 80)])
    assert split_objects(posed, np.concatenate(rows))[0].max() == 0
    posed, rows = splats([((x, 0, 5), 1, small, 0.5) for x in np.linspace(0, 60, 25)])
    assert split_objects(posed, np.concatenate(rows))[0].max() == 24


def test_pieces_of_a_graph():
    edges = np.array([[4, 1, 6], [2, 4, 5]])
    assert connect(edges, 7).tolist() == [0, 1, 1, 2, 1, 3, 3]
    assert connect(np.zeros((2, 0), int), 3).tolist() == [0, 1, 2]


def test_cells_that_touch_in_any_direction_are_linked():
    """Twenty-six neighbours of one cell, one at a time, and the two rings beyond it."""
    for step in np.ndindex(5, 5, 5):
        away = np.subtract(step, 2)
        found = label_components(np.stack([np.full(3, 0.5), away + 0.5]), 1.0)
        assert (found[0] == found[1]) == (np.abs(away).max() <= 1)


def test_a_thing_in_the_plane_of_the_camera_is_not_the_nearest():
    posed, rows = splats([((0.5, 0, 0), 4, FLAT, 0.5), ((-0.5, 0, 2), 4, FLAT, 0.5), ((0, 0, -3), 4, FLAT, 0.5)])
    everyone = np.concatenate(rows)
    np.testing.assert_array_equal(pick_object(posed, everyone, "nearest", CAMERA), rows[1])
    np.testing.assert_array_equal(pick_object(posed, everyone, "farthest", CAMERA), rows[1])
    behind = everyone[np.isin(everyone, rows[2])]
    np.testing.assert_array_equal(pick_object(posed, behind, "nearest", CAMERA), rows[2])


def test_of_things_that_are_all_behind_the_camera_one_is_picked_all_the_same():
    posed, rows = splats([((-2, 0, -5), 9, FLAT, 0.5), ((1, 0, -4), 3, FLAT, 0.5)])
    for which, thing in (("largest", 0), ("smallest", 1), ("farthest", 1), ("nearest", 0)):  # depth has a sign
        np.testing.assert_array_equal(pick_object(posed, np.concatenate(rows), which, CAMERA), rows[thing])


@pytest.mark.parametrize(
    ("which", "thing"),
    [
        ("left", 0), ("right", 2), ("top", 1), ("bottom", 2), ("middle", 1), ("nearest", 2), ("farthest", 1),
        ("largest", 0), ("smallest", 1),
    ],
)  # fmt: skip
def test_one_of_several(which, thing):
    """Sizes are surfaces: of the first 9 of .1 by .1 at .5, of the last 12 of .1 by .1 at .3."""
    groups = [((-2, 0.5, 5), 9, FLAT, 0.5), ((0.1, -0.6, 6), 3, FLAT, 0.5), ((1, 1, 4), 12, FLAT, 0.3)]
    posed, rows = splats(groups)
    found = pick_object(posed, np.concatenate(rows), which, CAMERA)
    np.testing.assert_array_equal(found, rows[thing])


def test_the_middle_is_that_of_the_picture_and_sizes_have_two_sides():
    """Pixels (32, 30) and (37, 20) from the middle (32, 20) by 10 and 5; .02 by .1 is more than .03 by .05."""
    groups = [((0, 1, 5), 4, (0.02, 0.1, 0.01), 0.5), ((0.5, 0, 5), 4, (0.05, 0.03, 0.01), 0.5)]
    posed, rows = splats(groups)
    everyone = np.concatenate(rows)
    np.testing.assert_array_equal(pick_object(posed, everyone, "middle", CAMERA), rows[1])
    np.testing.assert_array_equal(pick_object(posed, everyone, "largest", CAMERA), rows[0])


def way(where, camera=CAMERA):
    return camera.camera_to_world[:3, :3] @ DIRECTIONS[where]


@pytest.mark.parametrize(
    ("where", "each", "things"),
    [
        ("left", True, [0]), ("right", True, [1, 2]), ("above", True, [1]), ("below", True, [0, 2]),
        ("front", True, [0, 2]), ("behind", True, [1]), ("near", True, [0, 1, 2]), ("near", False, [0]),
        ("right", False, [2]), ("below", False, [0]),
    ],
)  # fmt: skip
def test_things_to_a_side_of_another(where, each, things):
    groups = [
        ((-1, 0.5, 4.9), 4, FLAT, 0.5),
        ((3, -1, 8), 4, FLAT, 0.5),
        ((1, 2, 3), 4, FLAT, 0.5),
        ((0, 0, 5), 4, FLAT, 0.5),
    ]
    posed, rows = splats(groups)
    found = stand_to(posed, np.concatenate(rows), rows[3], way(where), each)
    np.testing.assert_array_equal(found, np.concatenate([rows[thing] for thing in things]))


def test_sides_are_those_of_the_camera():
    """Seen from behind, left is right."""
    turned = Camera(CAMERA.intrinsics, np.diag([-1.0, 1, -1, 1]), 64, 40)
    posed, rows = splats([((-1, 0, 4.9), 4, FLAT, 0.5), ((1, 0, 7), 4, FLAT, 0.5), ((0, 0, 5), 4, FLAT, 0.5)])
    others = np.concatenate(rows[:2])
    for where, thing in (("left", 1), ("right", 0), ("front", 1), ("behind", 0)):
        np.testing.assert_array_equal(stand_to(posed, others, rows[2], way(where, turned), True), rows[thing])
    assert not len(stand_to(posed, others, rows[2], way("above", turned), True))
    assert not len(stand_to(posed, rows[2], rows[2], way("left", turned), True))
    assert not len(stand_to(posed, rows[2], rows[2][:0], way("left", turned), True))


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_part_is_an_outer_share_of_the_extent(side, share):
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3)) + np.array([0, 0, 5])
    pixels = CAMERA.project(points)[0]
    along = {"left": pixels[:, 0], "right": -pixels[:, 0], "top": pixels[:, 1], "bottom": -pixels[:, 1]}[side]
    low, high = np.percentile(along, [2, 98])
    np.testing.assert_array_equal(part_of(points, side, share, CAMERA), along <= low + share * (high - low))


def test_centres_and_widths():
    points, owner, weights = np.arange(12.0).reshape(4, 3), np.array([0, 1, 0, 1]), np.array([1.0, 1, 3, 0])
    np.testing.assert_allclose(centres_of(points, owner, weights), [[4.5, 5.5, 6.5], [3, 4, 5]])
    many = np.random.default_rng(0).uniform(-1, 1, (10000, 3)) * (1, 2, 3)
    many[0] = 100  # a floater
    opacities = np.where(np.arange(10000) < 5000, 1.0, 0.04)
    many[5000:] *= 4  # shown at other times
    posed = SimpleNamespace(means=many, opacities=opacities)
    for axis, width in enumerate((2, 4, 6)):
        for rows, wide in ((np.arange(10000), width), (np.arange(5000, 10000), 4 * width)):
            assert width_along(posed, rows, np.eye(3)[axis]) == pytest.approx(0.96 * wide, rel=0.02)
