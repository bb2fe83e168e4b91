"""The matte of what no frame saw: a square that moves before a wall, with another wall behind that nobody ever sees."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WALL, WIDTH, labelled_scene, sheet, square_mask

from f4x_core.edit.apply import edited
from f4x_core.edit.operations import Delete, Duplicate
from f4x_core.edit.resolve import EditorState, resolve
from f4x_core.edit.selects import Ids
from f4x_core.edit.stack import EditStack, with_stack
from f4x_core.geometry.arrays import evenly_spaced
from f4x_core.query.blend_weights import Look, seen_sums
from f4x_core.query.unseen import COLUMNS, LEAST, VIEWS, unseen_gaussians
from f4x_core.scene import MADE_UP, StaticSet
from f4x_core.scene.stage import Cloud, Surface, draw, fitted_config


@pytest.fixture(scope="module")
def scene():
    """The labelled scene with a green wall behind the blue one, which lets no light through."""
    plain = labelled_scene(features=False)
    back = sheet(np.linspace(-1.5, 1.5, 50), np.linspace(-1, 1, 34), WALL + 0.4, 0.05, (0.1, 0.8, 0.2))
    front = plain.static
    count = len(front)
    arrays = {name: np.concatenate([getattr(front, name), values]) for name, values in back.items()}
    ids = np.concatenate([front.ids, 10_000 + np.arange(len(back["means"]))])
    assert count == 40 * 28
    arrays["scales"][:count, :2] *= 2.5
    return replace(plain, static=StaticSet(ids=ids, **arrays))


def plate(scene, *operations, surfaces=()):
    stack = EditStack()
    for operation in operations:
        stack = stack.append(operation)
    changed = edited(with_stack(scene, stack))
    time = FRAMES // 2
    cloud = replace(Cloud.of_scene(changed, time), layers={"unseen": unseen_gaussians(changed)[:, None]})
    return draw([cloud], surfaces, changed.cameras.at(time), passes=("unseen",))


def test_the_hidden_wall_alone_is_unseen(scene):
    unseen = unseen_gaussians(scene)
    first, last = 40 * 28, len(scene.static)
    pixels, _ = scene.cameras.at(0.0).project(scene.static.means)
    within = ((pixels > 4) & (pixels < (WIDTH - 4, HEIGHT - 4))).all(1)
    assert not unseen[:first][within[:first]].any() and unseen[first:last][within[first:]].all()
    assert not unseen[last:].any()


def test_what_was_made_up_is_unseen_though_light_of_it_comes_through(scene):
    guessed = np.arange(len(scene.static)) % 5 == 0
    unseen, before = unseen_gaussians(replace(scene, extra={MADE_UP: guessed})), unseen_gaussians(scene)
    np.testing.assert_array_equal(unseen[: len(guessed)], before[: len(guessed)] | guessed)
    np.testing.assert_array_equal(unseen[len(guessed) :], before[len(guessed) :])


def test_it_is_what_numpy_alone_finds_view_by_view(scene):
    seen = np.zeros(len(scene.ids), bool)
    rows = round(COLUMNS * HEIGHT / WIDTH)
    for frame in evenly_spaced(FRAMES, VIEWS):
        camera = scene.cameras[frame].resized(COLUMNS, rows)
        config = fitted_config([Cloud.of_scene(scene, float(frame))], camera)
        nothing = np.zeros((rows, COLUMNS, 0), np.float32)
        seen |= seen_sums(Look(scene.posed(float(frame)), camera, config, "plain"), nothing, LEAST)[1]
    np.testing.assert_array_equal(unseen_gaussians(scene), ~seen)


def test_behind_what_moves_other_frames_saw_the_wall(scene):
    square = Delete(Ids.of(scene.dynamic.ids))
    assert plate(scene)["unseen"].max() < 0.06  # at the border, where pixels are wider than those that were looked at
    assert plate(scene, square)["unseen"].max() < 0.1


def test_behind_what_stands_still_nobody_saw_anything(scene):
    both = [Delete(Ids.of(scene.dynamic.ids)), Delete(Ids.of(np.arange(40 * 28)))]
    assert plate(scene, *both)["unseen"].min() > 0.98
    moved = square_mask(FRAMES // 2)
    with_square = plate(scene, both[1])["unseen"]
    assert with_square[moved].max() < 0.6 and np.median(with_square[moved]) < 0.1
    assert with_square[:, -10:].min() > 0.95


def test_where_nothing_is_nothing_was_seen_but_surfaces_are_there(scene):
    everything = Delete(Ids.of(scene.ids))
    assert plate(scene, everything)["unseen"].min() == 1
    corners = 100 * np.array([[[-1.0, -1, 0.05], [1, -1, 0.05], [0, 1, 0.05]]])
    surface = Surface(corners, np.ones((1, 3)))
    assert plate(scene, everything, surfaces=[surface])["unseen"].max() == 0


def test_copies_are_what_their_originals_are(scene):
    ids = np.concatenate([scene.dynamic.ids[:3], scene.static.ids[-800:-797]])
    copy = resolve(scene, Duplicate(Ids.of(ids), (0.1, 0.0, 0.0)), EditorState(None, 0.0))
    changed = edited(with_stack(scene, EditStack().append(copy)))
    unseen = unseen_gaussians(changed)
    np.testing.assert_array_equal(unseen[len(scene.ids) :], unseen_gaussians(scene)[changed.origin[len(scene.ids) :]])
    assert unseen[len(scene.ids) :].any() and not unseen[len(scene.ids) :].all()
