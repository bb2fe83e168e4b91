"""What a prompt makes of masks on many frames, and the features that carry them, where each number is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene, square_mask

from f4x_core.errors import F4xError
from f4x_core.geometry import spherical_harmonics
from f4x_core.query import following, not_deleted, prompts, views
from f4x_core.query.following import draw_views, follow_masks, follow_thing
from f4x_core.query.labels import ask_for
from f4x_core.query.prompts import (
    SelectOptions,
    at_clip_size,
    select_by_mask,
    select_by_points,
    select_by_prompts,
    select_by_text,
    text_selection,
)
from f4x_core.query.select_config import SELECT, FollowConfig, SelectConfig
from f4x_core.query.views import Seen, views_of

PROMPTED = SelectConfig(follow=FollowConfig(lifted=0))
"""Prompted frames alone are lifted."""


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


SQUARE = {0: square_mask(0).astype(np.float32)}


class Decoder:
    """Makes the logits of all frames from masks alone."""

    def __init__(self, followed):
        self.followed, self.asked = followed, []

    def prompt(self, t, mask):
        self.asked.append(t)

    def propagate(self):
        return iter(self.followed.items())


class Lifted:
    """Stands in for what a scene's pictures show: made-up blend weights at made-up pixels, masks kept."""

    def __init__(self, monkeypatch, scene):
        random = np.random.default_rng(0)
        self.count = len(scene.ids)
        self.inside, self.sums = random.random(self.count), 0.2 * random.random(self.count)
        self.sums[:40] = 0
        self.masks, self.known, self.followed = {}, None, {}
        monkeypatch.setattr(following, "lift_masks", self.lift)
        monkeypatch.setattr(following, "_from_neighbours", self.fill)
        monkeypatch.setattr(following, "views_of", lambda scene: self)
        monkeypatch.setattr(prompts, "point_out", lambda scene, asked, likely=None, config=None: None)

    def lift(self, scene, masks, progress):
        self.masks |= masks
        return self.inside, self.sums

    def seen(self, scene, frame):
        random = np.random.default_rng(frame)
        rows = np.flatnonzero(random.random(self.count) < 0.7)[40:]
        pixels = random.integers(0, HEIGHT, len(rows)), random.integers(0, WIDTH, len(rows))
        self.followed[frame] = Seen(rows, 0.2 * random.random(len(rows)), pixels)
        return self.followed[frame]

    def fill(self, scene, scores, seen, meant, config):
        self.known = seen
        return np.where(seen, scores, 0.25) * meant


def moving_fraction(scene, lifted, fraction):
    """Make that fraction of the prompt's weights lie on moving Gaussians, small sums, no rounding."""
    lifted.inside = np.where(np.arange(len(scene.ids)) % 2, 0.5, 0.25)
    marked = np.zeros(len(scene.ids))
    rows = np.flatnonzero(scene.moving)[:1], np.flatnonzero(~scene.moving)[:1]
    for row, share in zip(rows, (fraction, 1 - fraction), strict=True):
        marked[row] = share / 64
    lifted.sums = marked / lifted.inside


def logits(seed):
    return 3 * np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)).astype(np.float32)


def test_masks_of_prompted_and_of_followed_frames_are_weighed(scene, monkeypatch):
    lifted = Lifted(monkeypatch, scene)
    decoder = Decoder({t: logits(10 + t) for t in range(FRAMES)})
    config = FollowConfig(lifted=4, prompted_weight=5.0, min_blend_weight=0.3, one_kind=0.99)
    masks = {t: square_mask(t).astype(np.float32) for t in (2, 3)}
    found = follow_masks(scene, masks, decoder, config)
    assert lifted.masks == masks
    assert sorted(lifted.followed) == [0, 5]  # of 0, 2, 3 and 5
    total = 5 * lifted.sums
    inside = lifted.inside * total
    for t, (rows, weights, (row, column)) in lifted.followed.items():
        inside[rows] += weights / (1 + np.exp(-decoder.followed[t][row, column]))
        total[rows] += weights
    np.testing.assert_array_equal(lifted.known, total > 0.3)
    assert 0.1 < lifted.known.mean() < 0.9
    expected = np.where(lifted.known, inside / np.maximum(total, 1e-30), 0.25)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_gaussian_that_no_frame_sees_is_not_seen(scene, monkeypatch):
    lifted = Lifted(monkeypatch, scene)
    found = follow_masks(scene, SQUARE, Decoder({}), FollowConfig(min_blend_weight=0.0))
    np.testing.assert_array_equal(lifted.known, np.arange(len(scene.ids)) >= 40)
    assert (found[:40] == 0.25).all()


def test_prompted_frames_alone_are_quick(scene, monkeypatch):
    lifted = Lifted(monkeypatch, scene)
    follow_masks(scene, SQUARE, Decoder(None), PROMPTED.follow)  # nothing to follow
    assert sorted(lifted.masks) == [0] and not lifted.followed


@pytest.mark.parametrize(
    ("fraction", "kept"),
    [
        (0.75, "moving"),
        (0.7499, "all"),
        (0.5, "all"),
        (0.2501, "all"),
        (0.25, "static"),
        (1.0, "moving"),
        (0.0, "static"),
    ],
)
def test_a_prompt_of_one_kind_means_that_kind(scene, monkeypatch, fraction, kept):
    lifted = Lifted(monkeypatch, scene)
    moving_fraction(scene, lifted, fraction)
    means = follow_masks(scene, SQUARE, Decoder({}), FollowConfig(one_kind=0.75)) > 0
    rows = {"moving": scene.moving, "static": ~scene.moving, "all": np.ones(len(means), bool)}[kept]
    assert not means[~rows].any() and means[rows].mean() > 0.9


def test_moving_things_are_pointed_out_where_nothing_else_is_asked(scene, monkeypatch):
    Lifted(monkeypatch, scene)
    monkeypatch.setattr(prompts, "within_outlines", lambda scene, scores, *_, **__: scores)
    pointed = []
    scores = np.random.default_rng(1).random(len(scene.ids))
    monkeypatch.setattr(
        prompts,
        "point_out",
        lambda scene, asked, likely=None, config=None: pointed.append([mark.frame for mark in asked]) or scores,
    )
    point, mask = {"points": [[3, 3]]}, {"mask": square_mask(0)}
    found = select_by_prompts(scene, {0: point, 2: point}, SelectOptions(config=PROMPTED))
    np.testing.assert_array_equal(found.scores, scores)
    assert pointed == [[0, 2]] and found.label == "what is marked at frame 0, 2" and not found.wins.any()
    mixed = select_by_prompts(scene, {0: mask, 2: point}, SelectOptions(config=PROMPTED))
    assert mixed.label == "what is marked at frame 0, 2"
    assert pointed[1] == [0, 2]
    monkeypatch.setattr(prompts, "decoder_of", lambda scene, backend: Decoder({}))
    for asked, label in (
        ({0: mask}, "what is marked at frame 0"),
        ({2: mask, 0: mask}, "what is marked at frame 2, 0"),
    ):
        Lifted(monkeypatch, scene)
        monkeypatch.setattr(
            prompts, "point_out", lambda scene, asked, likely=None, config=None: pytest.fail("a mask is no point")
        )
        assert select_by_prompts(scene, asked).label == label


def test_a_thing_that_was_pointed_out_is_followed_by_its_looks(scene):
    whole = scene.moving.astype(float)
    torn = whole * (np.random.default_rng(0).random(len(whole)) < 0.9)  # superpoints missed a tenth of it
    for frames in ([0], [3, 0, 3]):
        found = follow_thing(scene, torn, frames)
        assert (found > 0.5)[scene.moving].mean() > 0.95 and not found[~scene.moving].any()
    blind = replace(scene, features=replace(scene.features, heads=scene.features.heads[:1]))
    for kept, chosen, config in (
        (scene, torn, PROMPTED),
        (blind, torn, SELECT),
        (scene, 1 - whole, SELECT),  # what stands is the same at all times
        (scene, 0.4 * whole, SELECT),  # nobody fills a pixel
    ):
        assert follow_thing(kept, chosen, [0], config) is chosen


def test_a_span_lies_within_the_clip(scene):
    point = np.argwhere(square_mask(0)).mean(0)[None, ::-1]
    for span in ((0, 5), (0, 0), (5, 5), (1.5, 4)):
        assert select_by_points(scene, point, 0, options=SelectOptions(span=span)).span == span
    for span in ((-0.5, 3), (2, 5.5), (-1, 9), (4, 3)):
        with pytest.raises(F4xError, match="does not lie within"):
            select_by_points(scene, point, 0, options=SelectOptions(span=span))


def test_a_mask_of_numbers_is_where_they_are_above_0(scene):
    expected = select_by_mask(scene, square_mask(0), 0).scores
    for dtype, one in ((np.uint8, 1), (np.uint8, 255), (float, 0.3)):
        np.testing.assert_array_equal(select_by_mask(scene, one * square_mask(0).astype(dtype), 0).scores, expected)


@pytest.mark.parametrize(
    ("shape", "fits"),
    [((40, 64), True), ((81, 128), False), ((80, 128), True), ((79, 128), False), ((126, 200), True), ((124, 200), True),
     ((0, 64), False), ((40, 0), False), ((0, 0), False), ((40, 64, 1), False), ((64,), False)],
)  # fmt: skip
def test_a_mask_has_the_proportions_of_the_clip(scene, shape, fits):
    mask = np.random.default_rng(0).random(shape) < 0.5
    if fits:
        rows, columns = (((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip((40, 64), shape, strict=True))
        np.testing.assert_array_equal(at_clip_size(mask, scene.cameras), mask[np.ix_(rows, columns)])
    else:
        with pytest.raises(F4xError, match=r"The mask has"):
            at_clip_size(mask, scene.cameras)


def test_the_calibrated_probability_is_the_default(scene, monkeypatch):
    probability = np.random.default_rng(2).random(len(scene.ids))
    monkeypatch.setattr(prompts, "word_probabilities", lambda scene, query: probability)
    query = ask_for(scene, ["square"])
    for found in (select_by_text(scene, ["square"]), text_selection(scene, query)):
        np.testing.assert_array_equal(found.scores, probability)
        assert not found.wins.any() and found.label == "square"
    rule = SelectOptions(calibrated=False)
    for found in (select_by_text(scene, ["square"], options=rule), text_selection(scene, query, rule)):
        assert found.wins.any() and not np.array_equal(found.scores, probability)


def test_what_following_needs_is_drawn_beforehand(scene, monkeypatch):
    fresh = replace(scene)
    draw_views(fresh, FollowConfig(lifted=3))
    monkeypatch.setattr(views, "render", None)
    monkeypatch.setattr(views, "blend_weight_sums", None)
    kept = views_of(fresh)
    assert [kept.appearance(fresh, t).shape[:2] for t in range(FRAMES)] == [(20, 32)] * FRAMES
    assert all(len(kept.seen(fresh, t).rows) for t in (0, 2, 5))
    for nothing in (replace(scene, features=None), replace(scene, dynamic=scene.dynamic.empty(0, 4))):
        draw_views(nothing)  # its things are not followed


def scores_by_loops(scene, scores, seen, meant, config):
    result = scores * meant
    colours = scene.colours * config.colour_weight
    for row in np.flatnonzero(meant & ~seen):
        known = np.flatnonzero(seen & meant & (scene.dynamic == scene.dynamic[row]))
        if len(known) > following.KNOWN:
            known = known[[i * (len(known) - 1) // (following.KNOWN - 1) for i in range(following.KNOWN)]]
        far = [
            ((scene.means[row] - scene.means[k]) ** 2).sum() + ((colours[row] - colours[k]) ** 2).sum() for k in known
        ]
        nearest = known[np.argsort(far)[: config.neighbours]]
        result[row] = scores[nearest].mean() if len(known) else 0
    return result


@pytest.mark.parametrize(("known", "block"), [(4096, 2048), (10, 3)])
@pytest.mark.parametrize("neighbours", [1, 4, 99])
def test_scores_of_the_unseen_are_their_neighbours_mean(monkeypatch, known, block, neighbours):
    monkeypatch.setattr(following, "KNOWN", known)
    monkeypatch.setattr(following, "BLOCK", block)
    random = np.random.default_rng(neighbours)
    count = 60
    made = SimpleNamespace(means=random.normal(size=(count, 3)), colours=0.3 * random.random((count, 3)))
    made.dynamic, seen = random.random(count) < 0.4, random.random(count) < 0.6
    sh = np.stack([spherical_harmonics.dc_from_rgb(made.colours), random.random((count, 3))], 1)
    made.posed = lambda time: {3.0: SimpleNamespace(means=made.means, sh=sh, dynamic=made.dynamic)}[time]
    made.cameras = SimpleNamespace(times=np.array([3.0, 4.0]))
    scores, config = random.random(count), FollowConfig(neighbours=neighbours, colour_weight=6.0)
    before = scores.copy()
    every, nobody = np.ones(count, bool), seen & ~made.dynamic
    for known_ones, meant in ((seen, every), (nobody, every), (seen, made.dynamic)):
        found = following._from_neighbours(made, scores, known_ones, meant, config)
        np.testing.assert_allclose(found, scores_by_loops(made, scores, known_ones, meant, config))
        assert not found[~meant | (made.dynamic & (known_ones is nobody))].any()
    np.testing.assert_array_equal(scores, before)


class Edited:
    """A scene after edits: opacities by time, parts with spans or none."""

    def __init__(self, opacities, spans=(None, None), gone=()):
        self.opacities, self.ids, self.times = opacities, np.arange(len(opacities(0.0))), []
        self.origin, self.gone, self.fades = self.ids, np.isin(self.ids, gone), any(span is not None for span in spans)
        self.base = SimpleNamespace(static=Part(spans[0]), dynamic=Part(spans[1]))
        self.cameras, self.untimed = SimpleNamespace(times=np.arange(20.0)), self

    def posed(self, time):
        self.times.append(time)
        return SimpleNamespace(opacities=self.opacities(time))


class Part:
    """A set of Gaussians of which only the spans are known."""

    def __init__(self, span):
        self.span = span

    def __len__(self):
        return 0 if self.span is None else len(self.span)


def test_deleted_is_whose_opacity_is_0_at_all_checked_times(monkeypatch):
    monkeypatch.setattr(not_deleted, "CHECKED_FRAMES", 3)
    scene = Edited(
        lambda time: np.array([0.0, 0.3 * (time == 10), 1e-4 * (time == 19), 0.5 * (time == 5), 0.7 * (time == 0)])
    )
    assert not_deleted.not_deleted(scene).tolist() == [False, True, True, False, True]
    assert scene.times == [0, 10, 19]
    again = not_deleted.not_deleted(scene)
    assert again is not_deleted.not_deleted(scene) and len(scene.times) == 3  # known by then
    whole = Edited(lambda time: np.ones(4))
    assert not_deleted.not_deleted(whole).all() and whole.times == [0]


def test_gaussians_of_a_short_life_are_checked_while_they_live(monkeypatch):
    """Between their second and third time, held within the clip; before edits nothing is checked."""
    monkeypatch.setattr(not_deleted, "CHECKED_FRAMES", 2)
    spans = np.array([[2.0, 3, 4, 5], [-9, -8, 3, 4], [3, 4, 6, 7]]), np.array([[12.0, 13, 15, 16], [11, 13, 14, 15]])
    scene = Edited(
        lambda time: np.array([0, float(time == 3), float(time == 4), float(time == 14), float(time in (2, 5, 16))]),
        spans,
    )
    assert not_deleted.not_deleted(scene).tolist() == [False, True, True, True, False]
    assert scene.times == [0, 19, 0, 3, 4, 6, 13, 14]  # both frames, then early and late moments, some of several lives
    scene = Edited(lambda time: np.zeros(2))
    scene.base = scene
    assert not_deleted.not_deleted(scene).all() and not scene.times


def test_thousands_of_short_lives_take_as_few_moments_as_their_lengths_allow():
    random = np.random.default_rng(0)
    start = random.uniform(0, 18, 5000)
    spans = (start[:, None] + (-0.5, 0, 1, 1.5), np.zeros((0, 4)))
    hidden = Edited(lambda time: np.zeros(5000), spans)
    assert not not_deleted.not_deleted(hidden).any() and len(hidden.times) < 16 + 2 * 20
    removed = Edited(lambda time: np.zeros(5000), spans, gone=range(5000))
    assert not not_deleted.not_deleted(removed).any() and not removed.times
    inside = Edited(lambda time: ((start <= time) & (time <= start + 1)).astype(float), spans)
    assert not_deleted.not_deleted(inside).all()


def test_a_mask_keeps_to_its_mover_and_holds_all_of_it(scene, monkeypatch):
    """Of two movers that cross one lies in the mask: following takes the other, too, and it or its path tells of what is unseen."""
    moving_fraction(scene, Lifted(monkeypatch, scene), 1.0)
    moving = np.flatnonzero(scene.moving)
    held, others = (np.isin(np.arange(len(scene.ids)), rows) for rows in (moving[1:5], moving[5:9]))
    monkeypatch.setattr(following, "held_movers", lambda scene, inside, seen: (held.copy(), others.copy()))
    for lost in (True, False):
        decoder = Decoder({t: logits(10 + t) + (-9 if lost else 9) for t in range(FRAMES)})
        found = follow_masks(scene, {2: square_mask(2).astype(np.float32)}, decoder, FollowConfig())
        assert (found[others] == 0).all()
        assert (found[held] == 1).all() if lost else (found[held] < 1).all()
