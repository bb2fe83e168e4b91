"""The judge sees what an edit changes: a known square in front of a known wall, and edits that do too much or too little."""

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene, square_mask
from scipy import ndimage
from stub_server import client, saying, stub_server

from benchmarks.quality.edits import measure_edit, measure_flicker, try_faults
from f4x_core.edit.apply import with_operations
from f4x_core.edit.judge import (
    MEASURED,
    STILL,
    ask_which,
    candidate_sheet,
    compare,
    difference,
    dilate,
    flicker,
    judge,
    views_of,
)
from f4x_core.edit.operations import Delete, Duplicate, Extract, Freeze, Name, Opacity, Recolour, Transform
from f4x_core.edit.resolve import EditorState, Resolver
from f4x_core.edit.selects import All, Ids, Text
from f4x_core.errors import F4xError
from f4x_core.query.engines import Engines
from f4x_core.query.prompts import select_by_text
from f4x_core.query.selection import Selection
from f4x_core.scene.visualise import GAP, LABEL_HEIGHT, MARGIN, MARK

SQUARE, GREEN = Text(("square",)), (0.0, 1.0, 0.0)


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture(scope="module")
def parts(scene):
    """Ids of the square, of half of it, and of the square with a piece of the wall."""
    square = scene.dynamic.ids
    return {"right": square, "half": square[::2], "much": np.append(square, scene.static.ids[300:700])}


def verdict(scene, asked, candidates, server=None):
    return judge(scene, "make it green", [asked], [(c,) for c in candidates], Resolver(EditorState()), Engines(server))


def test_compare_by_counting():
    rng = np.random.default_rng(0)
    before, after = rng.random((2, 12, 15, 3)) * 1.2
    after[:6] = before[:6]
    target = rng.random((12, 15)) > 0.6
    inside = ndimage.binary_dilation(target, np.ones((3, 3)))
    change = np.abs(before.clip(0, 1) - after.clip(0, 1)).max(-1)
    coverage = sum(change[y, x] > 0.02 for y, x in np.argwhere(target)) / target.sum()
    leakage = sum(change[y, x] for y, x in np.argwhere(~inside)) / change.sum()
    assert compare(before, after, target) == pytest.approx((coverage, leakage))
    assert (dilate(target) == inside).all() and np.allclose(difference(before, after), change)
    assert compare(before, before, target) == (0, 0) and compare(before, after, target & False)[0] == 0


def test_flicker_is_a_ratio_of_deviations():
    rng = np.random.default_rng(1)
    film, region = rng.random((4, 5, 6, 3)) * 0.5, np.zeros((5, 6), bool)
    assert flicker(film, film + 0.3, region) == 1
    region[1:3, 2:4] = True
    old = np.mean([film[:, y, x, c].std() for y, x in np.argwhere(region) for c in range(3)])
    assert flicker(film, 2 * film, region) == pytest.approx((2 * old + STILL) / (old + STILL))
    assert flicker(film * 0, film * 0, region) == 1


def test_the_whole_thing_and_nothing_else_wins(scene, parts):
    green = [Recolour(Ids.of(parts[name]), GREEN) for name in ("half", "much", "right")]
    found = verdict(scene, Recolour(SQUARE, GREEN), green)
    assert found.best == 2 and found.judged_by == MEASURED
    half, much, right = found.scores
    assert right["coverage"] > 0.95 and right["leakage"] < 0.02
    assert half["coverage"] < right["coverage"] + 1e-9 and much["leakage"] > 0.2
    assert right["score"] > max(half["score"], much["score"]) - 1e-9 and right["score"] > much["score"] + 0.2


def test_the_plain_reading_wins_a_draw(scene, parts):
    same = [Recolour(Ids.of(parts["right"]), (0.0, value, 0.0)) for value in (0.9, 1.0)]
    assert verdict(scene, Recolour(SQUARE, GREEN), same).best == 0


def test_words_tell_whether_something_is_gone(scene, parts):
    gone, still_there = verdict(
        scene, Delete(SQUARE), [Delete(Ids.of(parts["right"])), Opacity(Ids.of(parts["right"]), 0.9)]
    ).scores
    assert gone["words"] > 0.5 > still_there["words"] and gone["score"] > still_there["score"]
    alone = verdict(scene, Extract(SQUARE), [Extract(Ids.of(parts["right"])), Delete(Ids.of(scene.static.ids[:9]))])
    assert alone.scores[0]["words"] > 0.4 > alone.scores[1]["words"] and alone.best == 0


def test_what_is_moved_may_appear_elsewhere(scene, parts):
    who = Ids.of(parts["right"])
    for operation in (
        Transform(who, (0.0, 0.2, 0.0)),
        Duplicate(who, (0.0, 0.25, 0.0), first_id=10_000),
        Freeze(who, 1.0),
    ):
        (scores,) = verdict(scene, operation, [operation]).scores
        assert scores["leakage"] < 0.05, operation.TAG
        assert operation.TAG == "freeze" or scores["coverage"] > 0.8
    assert verdict(scene, Name(who, "it"), [Name(who, "it")]).scores[0]["coverage"] == 0


def test_an_edit_that_comes_and_goes_flickers(scene, parts):
    who = Ids.of(parts["right"])
    steady, blinking = verdict(
        scene, Recolour(SQUARE, GREEN), [Recolour(who, GREEN), Opacity(who, 0.0, (3.0, 3.0))]
    ).scores
    assert blinking["flicker"] > 5 > 1.3 > steady["flicker"] and blinking["score"] < steady["score"]


def test_views_are_spread_and_one_looks_from_aside(scene):
    views = views_of(scene)
    assert [view.time for view in views[:-1]] == sorted({view.time for view in views[:-1]}) and len(views) == 4
    assert not np.allclose(views[-1].camera.world_to_camera, views[1].camera.world_to_camera)


def test_a_model_that_sees_pictures_chooses(scene, parts):
    candidates = [Recolour(Ids.of(parts[name]), GREEN) for name in ("right", "half", "much")]
    with stub_server() as stub:
        stub.reply = (200, saying('{"best": 3}'), 0)
        found = verdict(scene, Recolour(SQUARE, GREEN), candidates, server=client(stub))
        assert (found.best, found.judged_by) == (2, client(stub).url) and len(found.scores) == 3
        content = stub.asked[0][2]["messages"][-1]["content"]
        assert content[0]["image_url"]["url"].startswith("data:image/png;base64,")
        assert "'make it green'" in content[1]["text"]


@pytest.mark.parametrize("answer", ['{"best": 4}', "the second", '{"best": "1"}', '{"best": 1, "run": "x"}'])
def test_a_model_that_chooses_nobody_is_replaced_by_numbers(scene, parts, answer):
    candidates = [Recolour(Ids.of(parts[name]), GREEN) for name in ("right", "half", "much")]
    with stub_server() as stub:
        stub.reply = (200, saying(answer), 0)
        found = verdict(scene, Recolour(SQUARE, GREEN), candidates, server=client(stub))
        assert found.best == 0 and found.judged_by == MEASURED and "measured instead" in found.notes[0]
        with pytest.raises(F4xError, match="cannot be used"):
            ask_which(client(stub), "x", candidate_sheet(scene, []), 3)


def test_the_contact_sheet_shows_all_and_marks_the_winner(scene, parts):
    candidates = [(Recolour(Ids.of(parts["right"]), GREEN),), (Delete(All()),)]
    sheet = np.asarray(candidate_sheet(scene, candidates, best=0))
    assert sheet.shape == (LABEL_HEIGHT + 4 * (HEIGHT + GAP), MARGIN + 3 * (WIDTH + GAP), 3)

    def cell(row, column):
        top, left = LABEL_HEIGHT + row * (HEIGHT + GAP), MARGIN + column * (WIDTH + GAP)
        return sheet[top : top + HEIGHT, left : left + WIDTH].astype(int)

    mask = square_mask(views_of(scene)[1].time)
    assert np.abs(cell(1, 0) - cell(1, 1))[mask].mean() > 20 > np.abs(cell(1, 0) - cell(1, 1))[~dilate(mask)].mean()
    assert cell(1, 2).max() == 0
    marked = (sheet == MARK).all(-1).any(0)
    columns = np.flatnonzero(marked)
    assert columns.min() >= MARGIN + WIDTH and columns.max() < MARGIN + 2 * (WIDTH + GAP)
    assert not (np.asarray(candidate_sheet(scene, candidates)) == MARK).all(-1).any()


def test_an_edit_is_measured_against_true_masks(scene):
    views = [(scene.cameras[t], float(t), mask, mask | True) for t in range(FRAMES) for mask in [square_mask(t)]]
    for edit in ("recolour", "delete"):
        good = measure_edit(scene, select_by_text(scene, ["square"]), views, edit)
        assert good["iou"] > (0.95 if edit == "recolour" else 0.75)  # rims that show little of it are seen to change
        assert good["coverage"] > 0.95 and good["leakage"] < 0.02
        assert good["leakage"] <= good["leakage_strict"] and good["iou_worst"] <= good["iou"]
        bad = measure_edit(scene, select_by_text(scene, ["wall"]), views, edit)
        assert bad["iou"] < 0.2 and bad["leakage"] > 0.75
    with pytest.raises(F4xError, match="empty"):
        measure_edit(
            scene,
            select_by_text(scene, ["square"]),
            [(scene.cameras[0], 0.0, square_mask(0) & False, square_mask(0) | True)],
        )


def test_what_is_not_known_does_not_count(scene, parts):
    much = Selection(scene.ids, np.isin(scene.ids, parts["much"]) * 1.0, np.zeros(len(scene.ids), bool))
    mask = square_mask(2)
    (everything, near) = (
        measure_edit(scene, much, [(scene.cameras[2], 2.0, mask, known)]) for known in (mask | True, dilate(mask))
    )
    assert everything["leakage"] > 0.2 and near["leakage"] < 1e-6 and near["iou"] > everything["iou"] + 0.2


def test_what_stands_still_does_not_flicker_when_painted(scene):
    assert measure_flicker(scene) <= 1.05


def test_every_fault_of_a_server_is_one_sentence():
    message = try_faults()
    assert len(message) == 10
    for name, sentence in message.items():
        assert sentence.startswith("URL: ") and "\n" not in sentence and len(sentence) < 900, name


def test_judging_leaves_the_scene_alone(scene, parts):
    before = scene.posed(2.0).arrays()
    candidate = Recolour(Ids.of(parts["right"]), GREEN)
    verdict(scene, Recolour(SQUARE, GREEN), [candidate, candidate])
    after = scene.posed(2.0)
    assert not scene.edits and all(np.array_equal(array, getattr(after, name)) for name, array in before.items())
    assert len(with_operations(scene, candidate).edits) == 1
