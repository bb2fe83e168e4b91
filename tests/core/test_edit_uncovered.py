"""What edits bring to light that no frame saw: counted in the pictures, told by the verbs, drawn by `--channels unseen`."""

import json
from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import FOCAL, FRAMES, HEIGHT, WALL, WIDTH, labelled_scene
from PIL import Image

from f4x_core.cli.main import main
from f4x_core.edit.apply import edited, open_scene
from f4x_core.edit.bake import bake
from f4x_core.edit.operations import Delete, Opacity, Recolour, Transform
from f4x_core.edit.selects import Ids, Moving
from f4x_core.edit.stack import EditStack, with_stack
from f4x_core.edit.uncovered import takes_away, uncovered
from f4x_core.query.unseen import unseen_gaussians
from f4x_core.scene import MADE_UP, write_scene
from f4x_core.scene.stage import Cloud, draw

HALF = 0.2
"""Half the side of the made-up piece of the wall: more than the square ever hides of its middle."""
AREA = (2 * HALF * FOCAL / WALL) ** 2 / (WIDTH * HEIGHT)
SQUARE = Moving()


@pytest.fixture(scope="module")
def scene():
    """The labelled scene, in which the middle of the wall was made up."""
    plain = labelled_scene()
    return replace(plain, extra={MADE_UP: (np.abs(plain.static.means[:, :2]) <= HALF).all(1)})


def shows(scene, *operations):
    stack = EditStack()
    for operation in operations:
        stack = stack.append(operation)
    return uncovered(with_stack(scene, stack))


def test_what_is_made_up_and_comes_to_light_is_counted_in_the_pictures(scene):
    found = shows(scene, Delete(SQUARE))
    np.testing.assert_array_equal(found.frames, np.arange(FRAMES))
    np.testing.assert_allclose(found.made_up, AREA, rtol=0.1)
    assert not found.nothing.any()
    assert str(found).startswith(f"Up to {found.made_up.max():.1%} of a picture (frame {found.made_up.argmax()}; ")
    assert str(found).endswith("on average) shows background that no frame saw: it is made up from what is around it.")


def test_as_long_as_something_is_before_it_it_is_not_in_sight(scene):
    found = shows(scene, Delete(SQUARE, (3.0, None)))
    always = shows(scene, Delete(SQUARE))
    assert (found.made_up[:3] < 0.8 * AREA).all() and (found.made_up[3:] == always.made_up[3:]).all()


def test_where_nothing_is_left_it_says_nothing_but_not_of_what_was_empty_before(scene):
    piece = np.flatnonzero(scene.extra[MADE_UP])
    found = shows(scene, Delete(SQUARE), Delete(Ids.of(scene.static.ids[piece])))
    np.testing.assert_allclose(found.nothing, AREA, rtol=0.25)
    assert found.made_up.max() == 0 and str(found).endswith("is empty: there is nothing behind what was taken away.")
    left = scene.static.means[:, 0] < 0
    half = replace(labelled_scene(features=False), static=scene.static.take(left))
    before = shows(half, Transform(SQUARE, (0.0, 0.0, 1e-4)))
    assert before.nothing.max() < 0.002 and str(before) == ""


def test_only_what_takes_something_away_is_looked_at(scene):
    assert shows(scene) is None and shows(scene, Recolour(SQUARE, (0, 1, 0))) is None
    assert takes_away([Recolour(SQUARE, (0, 1, 0)), Opacity(SQUARE, 0.0)])
    assert uncovered(with_stack(scene, EditStack().append(Delete(SQUARE)).enable(1, False))) is None


def test_what_is_folded_in_is_told_too(scene):
    for operation, told in ((Delete(SQUARE), True), (Recolour(SQUARE, (0, 1, 0)), False)):
        baked = bake(with_stack(scene, EditStack().append(operation)))
        assert not baked.edits and (uncovered(baked) is not None) == told
    edit = shows(scene, Delete(SQUARE))
    np.testing.assert_allclose(
        uncovered(bake(with_stack(scene, EditStack().append(Delete(SQUARE))))).made_up, edit.made_up
    )


def test_a_scene_without_the_mark_has_nothing_made_up_to_tell():
    assert str(shows(labelled_scene(features=False), Delete(SQUARE))) == ""


def test_edit_and_info_tell_it_and_a_recolouring_does_not(scene, tmp_path, capsys):
    path = tmp_path / "a.f4x"
    write_scene(scene, path)

    def told(*arguments):
        assert main([*map(str, arguments)]) == 0
        return " ".join(capsys.readouterr().out.split())

    assert "made up" not in told("info", path)
    expected = f"{shows(scene, Delete(SQUARE))} `f4x render SCENE -o DIR --channels unseen` draws where."
    assert expected in told("edit", path, "--say", "take the square out")
    assert f"uncovered: {expected}" in told("info", path)
    assert "made up" not in told("edit", path, "--say", "make the wall red")
    assert main(["info", str(path), "--json"]) == 0
    parts = json.loads(capsys.readouterr().out)["uncovered"]
    np.testing.assert_allclose(parts["made_up"], shows(scene, Delete(SQUARE)).made_up)


def test_what_no_frame_saw_is_drawn_as_pictures_without_exr(scene, tmp_path, capsys):
    path, out = tmp_path / "a.f4x", tmp_path / "out"
    write_scene(with_stack(scene, EditStack().append(Delete(SQUARE))), path)
    assert main(["render", str(path), "-o", str(out), "--channels", "rgb,unseen", "--frames", "2:3"]) == 0
    drawn = np.asarray(Image.open(out / "unseen" / "00002.png")) / 255
    changed = edited(open_scene(path))
    cloud = replace(Cloud.of_scene(changed, 2.0), layers={"unseen": unseen_gaussians(changed)[:, None]})
    np.testing.assert_allclose(
        drawn, draw([cloud], [], changed.cameras.at(2.0), passes=("unseen",))["unseen"], atol=0.003
    )
    assert drawn.max() > 0.9 and (drawn > 0.5).mean() == pytest.approx(AREA, rel=0.1)
    capsys.readouterr()
    assert main(["render", str(path), "-o", str(out), "--channels", "vector"]) == 2
    assert "vector holds numbers that only EXR files can; add --exr" in capsys.readouterr().err
    assert main(["render", str(path), "-o", str(out), "--channels", "unseen", "--motion-blur", "0.5"]) == 2
    assert "or add --exr" in capsys.readouterr().err
