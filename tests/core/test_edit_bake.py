"""A baked scene shows what the edited one does, to programs that know nothing of edits."""

from dataclasses import replace

import numpy as np
import pytest
from edit_cases import stacks
from hypothesis import example, given, settings
from labelled_scene import labelled_scene
from random_scene import assert_same, random_scene

from f4x_core.edit.apply import base_of, edited, with_operations
from f4x_core.edit.bake import TOLERANCE, bake
from f4x_core.edit.operations import (
    Blur,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Loop,
    Match,
    Name,
    Opacity,
    Recolour,
    Retime,
    Reverse,
    Style,
    Transform,
)
from f4x_core.edit.selects import All, Ids, Moving, Named, Not
from f4x_core.edit.stack import of, with_stack
from f4x_core.evaluation.evaluate import psnr
from f4x_core.query.prompts import select_by_text
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.view import render


def early(**fields):
    """A random scene whose Gaussians all refer to frame 0, which every retiming below shows."""
    scene = random_scene(3, degree=1, **fields)
    return replace(scene, dynamic=replace(scene.dynamic, reference=np.zeros_like(scene.dynamic.reference)))


SCENE = early()
FRAMES = range(6)
M, S, SOME = Moving(), Not(Moving()), Ids.of(np.array([2, 3, 31, 44]))


def assert_shows_the_same(scene, baked, times=FRAMES, atol=2e-5):
    """Every Gaussian that is left is where, and looks as, the edited scene has it; the others are invisible there."""
    for time in times:
        a, b = edited(scene).posed(time), edited(baked).posed(time)
        place = {id: row for row, id in enumerate(a.ids.tolist())}
        row = np.array([place[id] for id in b.ids.tolist()], int)
        seen = (a.opacities[row] > 0) | (b.opacities > 0)
        np.testing.assert_allclose(b.opacities, a.opacities[row], atol=1e-6)
        gone = np.setdiff1d(np.arange(len(a.ids)), row)
        assert (a.opacities[gone] == 0).all()
        for name in ("means", "scales"):
            np.testing.assert_allclose(getattr(b, name)[seen], getattr(a, name)[row][seen], atol=atol, err_msg=name)
        np.testing.assert_allclose(np.abs((b.quats * a.quats[row]).sum(1))[seen], 1, atol=1e-5)
        size = min(a.sh.shape[1], b.sh.shape[1])
        np.testing.assert_allclose(b.sh[seen, :size], a.sh[row][seen, :size], atol=1e-6)
        assert not a.sh[row][:, size:].any() and not b.sh[:, size:].any()


FOLDED = {
    "delete": [Delete(SOME)],
    "extract": [Extract(SOME)],
    "looks": [Recolour(M, (1, 0, 0), keep_luminance=True), Style(S, "gold"), Match(M, S), Opacity(SOME, 0.5)],
    "standing moved": [Transform(S, (1, 0, 0), (0, 40, 0), 2.0)],
    "moving moved about a point": [Transform(M, (1, 0, 0), (0, 40, 0), 1.5, (0, 0, 2))],
    "about its own centre": [Transform(M, rotate=(10, 40, 0), scale=1.5)],
    "mixed": [Transform(SOME, rotate=(0, 90, 0), pivot="base")],
    "in time": [Transform(M, (0.2, 0, 0), (0, 90, 0), frames=(1, 4))],
    "standing in time": [Transform(S, (0.2, 0, 0), (0, 90, 0), frames=(1, 4))],
    "all in time": [Transform(All(), (0.2, 0, 0), (0, 90, 0), frames=(0, None))],
    "copies": [Duplicate(All(), (1, 0, 0), count=2), Delete(SOME)],
    "late copy": [Duplicate(M, (1, 0, 0), time_shift=1.5)],
    "freeze": [Freeze(M, 2.5)],
    "pause": [Freeze(SOME, 1, 3)],
    "slow": [Retime(M, 0.5)],
    "fast": [Retime(M, 2, (1, 3))],
    "backwards": [Reverse(M)],
    "loop": [Loop(M, (0, 2))],
    "much": [Transform(All(), rotate=(0, 20, 0), frames=(1, 4)), Duplicate(M, (0.5, 0, 0), time_shift=1),
             Transform(M, scale=0.5, pivot="base"), Reverse(M)],
}  # fmt: skip


@pytest.mark.parametrize("name", FOLDED)
def test_everything_is_folded_and_right_at_clip_frames(name, tmp_path):
    edits = base_of(with_operations(SCENE, *FOLDED[name]))
    baked = bake(edits)
    assert baked.edits == ()
    assert_shows_the_same(edits, baked)
    write_scene(baked, tmp_path / "b.f4x")  # a whole scene by the file's own rules
    assert_same(read_scene(tmp_path / "b.f4x"), baked)


@pytest.mark.parametrize(
    ("listed", "left"),
    [
        ([Recolour(M, (1, 0, 0)), Delete(SOME, (1, 3)), Transform(M, (1, 0, 0))], ["delete", "transform"]),
        ([Transform(M, scale=2.0, frames=(1, 3))], ["transform"]),
        ([Delete(SOME), Opacity(M, 0.5, (1, 2)), Duplicate(M, (1, 0, 0))], ["delete", "opacity", "duplicate"]),
        ([Name(M, "rex"), Transform(S, (0.2, 0, 0), frames=(1, 4)), Delete(M, (2, 3))], ["name", "delete"]),
        ([Name(M, "rex"), Opacity(Named("rex"), 0.5)], ["name"]),
    ],
)
def test_what_no_arrays_hold_stays_in_order(listed, left):
    edits = base_of(with_operations(SCENE, *listed))
    baked = bake(edits)
    assert [edit.operation.TAG for edit in of(baked).edits] == left
    assert_shows_the_same(edits, baked)
    assert_same(bake(bake(edits)), replace(baked, provenance=bake(bake(edits)).provenance))


def test_moments_that_no_node_can_reach_stay():
    """A Gaussian whose reference time is never shown again cannot be carried exactly by nodes that stand still."""
    late = replace(SCENE, dynamic=replace(SCENE.dynamic, reference=np.full_like(SCENE.dynamic.reference, 4)))
    edits = base_of(with_operations(late, Recolour(M, (1, 0, 0)), Freeze(M, 1.0), Opacity(M, 0.5)))
    baked = bake(edits)
    assert [edit.operation.TAG for edit in of(baked).edits] == ["freeze", "opacity"]
    assert_shows_the_same(edits, baked)


def test_what_was_hidden_comes_back_behind_an_edit_that_cannot_be_folded():
    shift = Duplicate(All(), (0, 0, 0), time_shift=-1.5)
    edits = base_of(with_operations(SCENE, Opacity(All(), 0.0), shift, Opacity(All(), 1.25)))
    assert_shows_the_same(edits, bake(edits))


@settings(max_examples=25, deadline=None)
@given(stacks)
@example([Transform(All(), scale=0.5), Blur(All(), 0.125)])
@example(
    [Duplicate(All(), (0, 0, 0), time_shift=-1.5), Name(M, "dog"), Recolour(Named("dog"), (0, 0, 0), strength=0.125)]
)
def test_random_stacks(listed):
    edits = base_of(with_operations(SCENE, *listed))
    focal = float(SCENE.cameras.intrinsics[0, 0, 0])
    # what is off by less than the tolerance at the nearest possible depth may be folded
    assert_shows_the_same(edits, bake(edits), (0, 2, 5), atol=max(2e-4, 10 * TOLERANCE / focal))


def test_ids_nodes_and_untouched_gaussians():
    edits = base_of(
        with_operations(SCENE, Duplicate(Ids.of(np.arange(30, 35)), (1, 0, 0)), Delete(Ids.of(np.arange(5))))
    )
    baked = bake(edits)
    np.testing.assert_array_equal(baked.static.ids, np.arange(5, 30))
    np.testing.assert_array_equal(baked.dynamic.ids, np.arange(30, 55))
    assert baked.next_id == 55
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(baked.dynamic, name)[:20], getattr(SCENE.dynamic, name), err_msg=name)
        np.testing.assert_array_equal(getattr(baked.static, name), getattr(SCENE.static, name)[5:], err_msg=name)
    old, new = SCENE.scaffold, baked.scaffold
    np.testing.assert_array_equal(new.ids[: len(old)], old.ids)
    assert len(np.unique(new.ids)) == len(new.ids) and (new.ids[len(old) :] > old.ids.max()).all()
    assert (new.neighbours[:, 0] == np.arange(len(new))).all()
    moved = bake(base_of(with_operations(SCENE, Transform(M, (1, 0, 0)))))
    assert (
        len(moved.scaffold) <= len(old) and not np.isin(moved.scaffold.ids, old.ids[SCENE.dynamic.node.ravel()]).any()
    )


def test_a_standing_scene_learns_to_move():
    base = random_scene(2, dynamic=0)
    edits = base_of(with_operations(base, Transform(Ids.of(np.arange(10)), (0.5, 0, 0), frames=(1, 3))))
    baked = bake(edits)
    assert len(baked.dynamic) == 10 and len(baked.scaffold) == 1 and len(baked.static) == 20
    assert_shows_the_same(edits, baked)
    nothing = bake(base_of(with_operations(SCENE, Delete(Moving()))))
    assert nothing.scaffold is None and len(nothing.dynamic) == 0


def test_features_and_unknown_arrays_come_along():
    scene = labelled_scene()
    count, moving = len(scene.static), len(scene.dynamic)
    extra = {"static/note": np.arange(count), "dynamic/note": np.arange(moving) + 5000, "other": np.ones(3)}
    scene = replace(scene, extra=extra)
    part = Ids.of(np.arange(100))
    edits = base_of(
        with_operations(
            scene,
            Transform(part, (0.1, 0, 0), frames=(1, 3)),
            Duplicate(M, (0.4, 0, 0)),
            Delete(Ids.of(np.arange(100, 150))),
        )
    )
    baked = bake(edits)
    assert len(baked.static) == count - 150 and len(baked.dynamic) == 2 * moving + 100
    np.testing.assert_array_equal(baked.extra["static/note"], np.arange(150, count))
    assert (baked.extra["dynamic/note"] < 5000).sum() == 100 and len(baked.extra["other"]) == 3
    for words in (["square"], ["wall"]):
        a, b = select_by_text(edited(edits), words), select_by_text(baked, words)
        np.testing.assert_array_equal(a.for_ids(baked.ids).chosen, b.chosen)


def test_baked_pictures_are_the_edited_ones():
    scene = labelled_scene(features=False)
    wall = Not(Moving())  # all of it: which of two Gaussians at one depth is in front goes by their order
    edits = base_of(
        with_operations(
            scene,
            Recolour(M, (0.1, 0.8, 0.2), keep_luminance=True),
            Transform(M, rotate=(0, 0, 60), frames=(0, 5)),
            Duplicate(M, (0.3, 0.1, 0), time_shift=1.0, name="twin"),
            Transform(Named("twin"), scale=0.7, pivot="base"),
            Transform(wall, (0.2, 0, 0), frames=(1, 4)),
            Style(wall, "ocean"),
        )
    )
    baked = bake(edits)
    assert [edit.operation.TAG for edit in of(baked).edits] == ["name"]
    between = []
    for time in (0, 1, 2, 4, 5, 0.5, 2.5):
        camera = scene.cameras.at(time)
        a, b = (render(s, camera, time, ("rgb",))["rgb"] for s in (edited(edits), baked))
        if time == int(time):
            assert psnr(np.clip(a, 0, 1), np.clip(b, 0, 1)) > 50
        else:
            between.append(psnr(np.clip(a, 0, 1), np.clip(b, 0, 1)))
    assert min(between) > 40  # curves through the same places, bent a little differently


def test_switched_off_and_undone_edits_are_left_behind():
    stack = of(with_operations(SCENE, Delete(SOME), Recolour(M, (1, 0, 0)), Delete(M))).enable(1, False).undo()
    baked = bake(with_stack(SCENE, stack))
    assert baked.edits == () and "undone" not in baked.extra_fields and len(baked.ids) == 50
    assert [result["op"] for result in baked.provenance["baked"]] == ["recolour"]
