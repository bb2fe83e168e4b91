"""Moving things that a click or a box picks out of all that moves, in all frames at once."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import HALF, SQUARE, labelled_scene, sheet, square_mask

from f4x_core.edit.apply import with_operations
from f4x_core.edit.operations import Duplicate
from f4x_core.edit.selects import Moving
from f4x_core.query import objects
from f4x_core.query.marks import Box, Point
from f4x_core.query.objects import Superpoints, graph_of, point_out, superpoints_of
from f4x_core.query.prompts import select_by_box, select_by_points, select_by_prompts
from f4x_core.scene import DynamicSet


def middle(mask):
    rows, columns = np.nonzero(mask)
    return columns.mean() + 0.5, rows.mean() + 0.5


def scene_with_ripples():
    """The scene and (N,) bool of its square; below that a patch of the wall's colour moves along."""
    scene = labelled_scene(features=False)
    side = np.linspace(-HALF, HALF, 9)
    ripples = sheet(side - 0.2, side + 2.2 * HALF, SQUARE, 0.018, (0.2, 0.3, 0.8))
    square, count = scene.dynamic, len(ripples["means"])
    more = {name: np.concatenate([getattr(square, name), values]) for name, values in ripples.items()}
    more["ids"] = np.concatenate([square.ids, scene.next_id + np.arange(count)])
    for name in ("reference", "node", "weight", "strength"):
        value = getattr(square, name)
        more[name] = np.concatenate([value, np.repeat(value[:1], count, 0)])
    scene = replace(scene, dynamic=DynamicSet(**more), next_id=0)
    rows = np.arange(len(scene.ids))
    return scene, (rows >= len(scene.static)) & (rows < len(scene.static) + len(square))


@pytest.mark.parametrize("features", [True, False])
@pytest.mark.parametrize("frame", [0, 3])
def test_a_click_on_what_moves_selects_it_in_all_frames(features, frame):
    scene = labelled_scene(features=features)
    found = select_by_points(scene, [middle(square_mask(frame))], frame)
    np.testing.assert_array_equal(found.chosen, scene.moving)


def test_a_click_tells_the_thing_from_ripples_that_move_along():
    scene, square = scene_with_ripples()
    found = select_by_points(scene, [middle(square_mask(2))], 2).chosen
    assert found[square].mean() > 0.95
    assert found[~square].mean() < 0.05 * square.mean()


def test_a_box_or_a_point_beside_leaves_out_what_is_not_meant():
    scene, square = scene_with_ripples()
    rows, columns = np.nonzero(square_mask(0))
    ripples = (columns.mean() + 0.5, rows.max() + 6.0)
    box = (columns.min() - 1, rows.min() - 1, columns.max() + 2, rows.max() + 2)
    either = select_by_points(scene, [middle(square_mask(0)), ripples], 0).chosen
    assert either[square].mean() > 0.95 and either[scene.moving & ~square].mean() > 0.5
    for found in (
        select_by_box(scene, box, 0).chosen,
        select_by_prompts(scene, {0: {"box": box, "points": [middle(square_mask(0))]}}).chosen,
        select_by_points(scene, [middle(square_mask(0)), ripples], 0, labels=[True, False]).chosen,
    ):
        assert found[square].mean() > 0.95
        assert found[scene.moving & ~square].mean() < 0.1


def test_a_click_on_what_stands_selects_nothing_that_moves():
    scene = labelled_scene()
    found = select_by_points(scene, [(60, 5)], 0).chosen
    assert found.any() and not found[scene.moving].any()


def test_a_box_too_small_for_any_piece_means_no_moving_thing():
    scene = labelled_scene()
    x, y = np.floor(middle(square_mask(0)))
    assert point_out(scene, [Box(0, True, [x, y, x + 1, y + 1])]) is None


def test_nothing_moves():
    scene = replace(labelled_scene(features=False), dynamic=DynamicSet.empty(), scaffold=None)
    assert point_out(scene, [Point(0, True, (60, 5))]).any()


def test_the_graph_is_made_once_and_goes_along_with_edits(monkeypatch):
    scene = labelled_scene()
    graph = graph_of(scene)
    monkeypatch.setattr(objects, "superpoints_of", lambda scene, config: pytest.fail("made again"))
    assert graph_of(scene) is graph
    edited = with_operations(scene, Duplicate(Moving(), first_id=scene.next_id))
    moving = graph_of(edited).moving
    np.testing.assert_array_equal(moving.rows, np.flatnonzero(edited.moving))
    half = len(graph.moving.index)
    np.testing.assert_array_equal(moving.index, np.tile(graph.moving.index, len(moving.index) // half))


def test_pieces_hold_every_moving_gaussian_once():
    scene = labelled_scene()
    superpoints = superpoints_of(scene).moving
    np.testing.assert_array_equal(superpoints.rows, np.flatnonzero(scene.moving))
    light = np.random.default_rng(0).random(len(scene.ids))
    assert superpoints.gather(light).sum() == pytest.approx(light[scene.moving].sum())
    np.testing.assert_array_equal(superpoints.spread(np.ones(len(superpoints.weight)), len(light)) > 0, scene.moving)


def test_a_thing_grows_by_the_walk_and_stops_at_the_least_cut():
    """Two cliques of four with weak bonds, the second much like what stands still: against all sets along the walk."""
    count, rng = 8, np.random.default_rng(1)
    bonds = np.kron(np.eye(2), np.ones((4, 4))) * rng.uniform(0.8, 1, (count, count))
    bonds = (bonds + bonds.T) / 2 + 0.02
    np.fill_diagonal(bonds, 0)
    near = 1 - np.eye(count)
    blend = np.repeat([0.05, 0.8], 4) * rng.uniform(0.8, 1, count)
    cast = np.zeros(count, bool)
    superpoints = Superpoints(np.arange(count), np.arange(count), np.ones(count), bonds, near, blend, cast)
    marked = np.eye(count)[1]
    np.testing.assert_array_equal(superpoints.grow(marked, np.zeros(count, bool)), np.arange(count) < 4)
    step = bonds / (1.001 * (bonds.sum(1) + blend))  # column j: where the walkers of superpoint j go
    visits = np.linalg.inv(np.eye(count) - step) @ marked
    order = np.argsort(-visits / (bonds.sum(1) + blend))
    cuts = []
    for size in range(1, count + 1):
        inside = np.isin(np.arange(count), order[:size])
        cut = bonds[inside][:, ~inside].sum() + blend[inside].sum()
        cuts.append(cut / (bonds[inside].sum() + blend[inside].sum()))
    assert int(np.argmin(cuts)) + 1 == 4
    against = np.arange(count) == 3
    found = superpoints.grow(marked, against)
    assert found[:3].all() and not found[3]
    assert not superpoints.grow(marked, np.ones(count, bool)).any()
