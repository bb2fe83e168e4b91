"""DAVIS' measures against loops, and clicks on made-up things that touch."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.quality import selecting
from benchmarks.quality.selecting import (
    boundary_f,
    box_of,
    corrected,
    innermost,
    largest_error,
    outline,
    score_selecting,
    score_things,
)
from benchmarks.quality.touching import clicks, drawn_things, touching_world, true_scene
from f4x_core.query.selection import Selection
from tests.core.labelled_scene import FRAMES, labelled_scene, square_mask

THINGS = Path(__file__).parents[1] / "data" / "static_things.json"


def outline_by_loops(mask):
    height, width = mask.shape
    result = np.zeros_like(mask)
    for y, x in np.ndindex(height, width):
        below, right = min(y + 1, height - 1), min(x + 1, width - 1)
        result[y, x] = any(mask[y, x] != mask[at] for at in ((y, right), (below, x), (below, right)))
    return result


def f_by_loops(mask, truth):
    reach = math.ceil(0.008 * math.hypot(*mask.shape))
    own, true = (np.argwhere(outline_by_loops(each)) for each in (mask, truth))
    if not len(own) or not len(true):
        return float(len(own) == len(true))

    def found(points, others):
        return np.mean([min(math.dist(point, other) for other in others) <= reach for point in points])

    precision, recall = found(own, true), found(true, own)
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


@pytest.mark.parametrize("seed", range(4))
def test_f_by_loops(seed):
    random = np.random.default_rng(seed)
    mask, truth = (np.kron(random.random((5, 8)) < 0.4, np.ones((8, 9))) > 0 for _ in range(2))
    moved = np.roll(truth, 1, axis=1)
    np.testing.assert_array_equal(outline(mask), outline_by_loops(mask))
    for one in (mask, moved):
        assert boundary_f(one, truth) == pytest.approx(f_by_loops(one, truth), abs=1e-12)
    assert boundary_f(truth, truth) == 1


def test_f_of_nothing():
    empty, some = np.zeros((9, 12), bool), np.zeros((9, 12), bool)
    some[3:6, 4:8] = True
    assert [boundary_f(*pair) for pair in ((empty, empty), (empty, some), (some, empty))] == [1, 0, 0]
    assert box_of(some) == (4, 3, 8, 6) and innermost(some)[1] == 4.5


def test_every_way_to_select_is_scored():
    masks = {t: square_mask(float(t)) for t in range(FRAMES)}
    rows = score_selecting(labelled_scene(), masks, "square")
    assert set(rows) == {"mask", "mask on the graph", "click", "three clicks", "box", "nothing", "word"}
    # Of pixels that the square covers in part, a refined outline may take some more.
    assert all(row["F"] == 1 and row["worst J"] > 0.98 for row in rows.values())
    refused = score_selecting(labelled_scene(), masks, "unicorn")["word"]
    assert set(refused) == {"refused"} and "lacks 'unicorn'" in refused["refused"]


def test_things_that_stand_are_scored_on_their_frame(tmp_path):
    file = tmp_path / "things.json"
    thing = {"frame": 0, "name": "wall", "outline": [[2, 2], [62, 2], [62, 38], [2, 38]]}
    file.write_text(json.dumps([thing | {"clip": "labelled"}, thing | {"clip": "another"}]))
    (row,) = score_things(labelled_scene(), file, "labelled")
    assert row["thing"] == "wall" and all(0 <= row[name] <= 1 for name in ("click", "three clicks", "box"))


def test_the_largest_error_that_a_hand_can_hit():
    truth, drawn = np.zeros((2, 40, 60), bool)
    truth[10:30, 10:30] = True
    drawn[10:30, 12:30] = True  # two columns are missing
    drawn[0:8, 40:60] = True
    part, missing = largest_error(drawn, truth)
    assert not missing and part.sum() == 160 and part[:8, 40:].all()
    part, missing = largest_error(drawn & False, truth)
    assert missing and (part == truth).all()
    drawn[0:8, 40:60] = False
    assert largest_error(drawn, truth) is None


def test_further_clicks_correct_the_first(monkeypatch):
    """The first click misses the left half of the square; the second is made there, and says that it is missing."""
    scene, truth, asked = labelled_scene(), square_mask(0.0), []
    left = scene.posed(0.0).means[:, 0] < -0.2
    whole = scene.moving

    def by_points(scene, points, frame, on):
        asked.append((len(points), on[-1]))
        chosen = whole if len(points) > 1 else whole & ~left
        return Selection(scene.ids, chosen.astype(float), np.zeros(len(chosen), bool))

    monkeypatch.setattr(selecting, "select_by_points", by_points)
    assert (corrected(scene, truth, 0, 3).chosen == whole).all() and asked == [(1, True), (2, True)]


def test_outlines_of_things_that_stand_lie_in_their_clips():
    for thing in json.loads(THINGS.read_text()):
        outline = np.array(thing["outline"])
        assert len(outline) > 2 and (outline >= 0).all() and (outline <= (480, 270)).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slide", "bump"])
def test_a_click_tells_apart_what_touches_and_moves_apart(kind):
    world = touching_world(kind, 2)
    scene, labels = true_scene(world)
    found = list(clicks(scene, drawn_things(world, scene, labels)))
    assert len(found) == 4 and min(value for *_, value in found) >= 0.85
