"""The measures by which a rigid body is accepted, against their plain forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr
from test_priors_own_motion import FOCAL, FRAMES, ball, on_object

from f4x_core.geometry import quaternion
from f4x_core.priors import own_motion as module
from f4x_core.priors.bundle import Bundle, Observations, triangulate


def body(seed=0, count=60, frames=6):
    """A bundle of points that a turning body may have, and its sightings."""
    rng = np.random.default_rng(seed)
    turns = quaternion.to_matrix(
        quaternion.from_rotation_vector(np.linspace(-0.3, 0.3, frames)[:, None] * [0.1, 1, 0.2])
    )
    center = -np.einsum("fji,j->fi", turns, [0, 0, 6.0])
    bundle = Bundle(FOCAL, np.array([120.0, 68]), turns, center, rng.normal(size=(count, 3)))
    frame, point = np.nonzero(rng.random((frames, count)) < 0.8)
    seen = Observations(frame, point, np.zeros((len(frame), 2)), np.ones(len(frame)))
    seen = replace(seen, uv=bundle.residuals(seen) + rng.normal(0, 0.2, (len(frame), 2)))
    return bundle, seen


def test_the_unit_is_that_of_a_picture_480_wide():
    tracks, visible, _, path = ball()
    assert on_object(tracks, visible, path).unit == pytest.approx(0.5)


def test_extent_is_half_the_middle_span():
    _, seen = body()
    few = seen.keep((seen.frame != 2) | (np.cumsum(seen.frame == 2) <= 3))
    spans = []
    for frame in (0, 1, 3, 4, 5):
        uv = seen.uv[seen.frame == frame]
        spans.append([np.percentile(uv[:, axis], 84) - np.percentile(uv[:, axis], 16) for axis in (0, 1)])
    width, height = np.median(spans, axis=0)
    assert module._extent(few, 6) == pytest.approx(np.sqrt(width * height) / 2)
    four = seen.keep((seen.frame != 2) | (np.cumsum(seen.frame == 2) <= 4))
    assert module._extent(four, 6) != module._extent(few, 6)


def test_relief_is_depth_against_width_and_height():
    bundle, seen = body()
    seen = seen.keep((seen.frame != 1) | (np.cumsum(seen.frame == 1) <= 10))
    seen = seen.keep((seen.frame != 2) | (np.cumsum(seen.frame == 2) <= 9))
    found = []
    for frame in (0, 1, 3, 4, 5):
        xyz = bundle.local(seen.keep(seen.frame == frame))
        span = [
            np.subtract(*np.percentile(one, (84, 16)))
            for one in (xyz[:, 0] / xyz[:, 2], xyz[:, 1] / xyz[:, 2], xyz[:, 2])
        ]
        found.append(span[2] / np.median(xyz[:, 2]) / np.sqrt(span[0] * span[1]))
    assert module._relief(bundle, seen) == pytest.approx(np.median(found))
    assert module._relief(bundle, seen.keep(seen.frame == 2)) == np.inf


def test_the_bulge_is_a_rank_correlation():
    bundle, seen = body()
    outline = np.random.default_rng(0).uniform(0, 40, (6, 60))
    outline[1] = 25  # all the same beyond 20
    seen = seen.keep((seen.frame != 3) | (np.cumsum(seen.frame == 3) <= 19))
    seen = seen.keep((seen.frame != 4) | (np.cumsum(seen.frame == 4) <= 20))
    bundle = replace(bundle, points=np.where(np.arange(60)[:, None] == 9, [[0, 0, -30.0]], bundle.points))
    found = []
    for frame in (0, 2, 4, 5):
        own = seen.keep(seen.frame == frame)
        z = bundle.local(own)[:, 2]
        distance = [min(outline[frame, p], 20) for p in own.point]
        kept = z > 0
        if kept.sum() >= 20:
            found.append(spearmanr(1 / z[kept], np.array(distance)[kept])[0])
    assert module._bulge(bundle, seen, outline) == pytest.approx(np.mean(found))
    small = replace(bundle, points=0.01 * bundle.points, center=0.01 * bundle.center)
    assert module._bulge(small, seen, outline) == pytest.approx(np.mean(found))
    assert module._bulge(bundle, seen.keep(seen.frame == 3), outline) == 0


def steps_of(*degrees):
    angles = np.deg2rad(np.array(degrees, float))
    return quaternion.to_matrix(quaternion.from_rotation_vector(angles[:, None] * [0, 1.0, 0]))


@pytest.mark.parametrize(
    ("degrees", "steady"),
    [
        ((0, 10, 20, 40, 60), True),
        ((0, 10, 0, 10), False),  # 30 degrees to and fro
        ((0, 9, 0), True),  # less than 20 in all
        ((0, 30, 26), True),  # 30 of 34
        ((0, 30, 22), False),  # 30 of 38
        ((0, 60, 130, 60, 0), False),  # 130 of 260, and short of half a turn
        ((0, 90, 175, 260, 350), True),  # half a turn: where it is no longer tells how far it went
    ],
)
def test_a_body_that_turns_goes_somewhere(degrees, steady):
    turns = steps_of(*degrees)
    bundle = Bundle(1.0, np.zeros(2), turns, np.zeros((len(turns), 3)), np.zeros((0, 3)))
    still = np.tile(np.eye(4), (len(turns), 1, 1))
    assert module._turns_steadily(bundle, still) == steady
    rolling = still.copy()
    rolling[:, :3, :3] = turns  # the camera turned, not the body
    assert module._turns_steadily(bundle, rolling)


def test_medians_of_the_sightings_of_each_point():
    point, values = np.array([2, 0, 2, 2, 0, 4, 2]), np.array([3.0, 9, 1, 2, 7, 5, 8])
    np.testing.assert_array_equal(module._median_by(point, values, 6), [9, np.inf, 3, np.inf, 5, np.inf])


def test_the_orientation_is_decided_by_errors_and_bulge(monkeypatch):
    bundle, _ = body()
    other = replace(bundle, focal=2.0)
    for costs, bulges, chosen in (
        ((1.0, 1.1), (0.0, 0.5), 0),
        ((1.0, 1.1), (-0.5, 0.9), 1),
        ((1.1, 1.0), (0.9, -0.5), 0),
        ((1.1, 1.0), (0.5, 0.3), 1),
        ((1.0, 1.0), (0.3, 0.3), 0),
    ):
        asked, queue, rates = [], [bundle, other], list(bulges)
        monkeypatch.setattr(
            module,
            "adjust_coarse_to_fine",
            lambda one, seen, config, first=0, asked=asked, queue=queue: asked.append(first) or queue.pop(0),
        )
        monkeypatch.setattr(module, "mirrored", lambda one: one)
        monkeypatch.setattr(module, "_bulge", lambda one, *more, rates=rates: rates.pop(0))
        monkeypatch.setattr(module, "total_cost", lambda one, *more, costs=costs: costs[one is other])
        odds = np.log(costs[1] / costs[0]) / 0.025 + 6 * (bulges[0] - bulges[1]) / 2
        assert (odds < 0) == chosen
        found, bulge = module._resolve_mirror(bundle, None, None, None)
        assert found is (bundle, other)[chosen] and bulge == bulges[chosen] and asked == [0, 1]


def accepted(monkeypatch, errors=0.5, follows=1.0, bulge=0.5, relief=1.0, steady=True, tracks=40):
    """What `solve` does with a body whose measures are given."""
    all_tracks, visible, _, path = ball(count=tracks)
    visible[:] = True
    seen = on_object(all_tracks, visible, path)
    asked = {}

    class Body:
        def errors(self, observed):
            bad = observed.point >= follows * tracks
            return np.where(bad, 1.6, errors)

    def resolved(start, observed, config, outline):
        asked.update(config=config, outline=outline, start=start, observed=observed)
        return Body(), bulge

    monkeypatch.setattr(module, "_resolve_mirror", resolved)
    monkeypatch.setattr(module, "_relief", lambda one, kept: asked.update(kept=kept) or relief)
    monkeypatch.setattr(module, "_turns_steadily", lambda one, poses: steady)
    monkeypatch.setattr(module, "_at_all_frames", lambda *all: all)
    monkeypatch.setattr(module, "_in_every_frame", lambda *all: all)
    return module.solve(seen), asked, seen


@pytest.mark.parametrize(
    ("measures", "rigid"),
    [
        ({}, True), ({"errors": 1.0}, True), ({"errors": 1.01}, False), ({"follows": 0.75}, True), ({"follows": 0.7}, False),
        ({"bulge": 0.15}, True), ({"bulge": 0.14}, False), ({"relief": 1.5}, True), ({"relief": 1.51}, False),
        ({"steady": False}, False),
        ({"tracks": 30}, True), ({"tracks": 29}, False), ({"bulge": np.nan}, False),
    ],
)  # fmt: skip
def test_what_makes_a_rigid_body(monkeypatch, measures, rigid):
    found, asked, seen = accepted(monkeypatch, **measures)
    assert (found is not None) == rigid
    if rigid:
        config = asked["config"]
        assert not config.refine_focal and config.robust_px == 1.0
        assert config.relief == pytest.approx(module._extent(asked["observed"], FRAMES) / FOCAL)
        np.testing.assert_allclose(asked["outline"], seen.from_outline / seen.unit)
        whole, tracks, _, usual = found
        follows = whole[3]
        assert follows.mean() == measures.get("follows", 1.0) and usual == measures.get("errors", 0.5)
        assert follows[asked["kept"].point].all()
        np.testing.assert_array_equal(whole[2], np.flatnonzero(follows))
        np.testing.assert_allclose(tracks, seen.tracks)


def test_a_lens_that_zooms_is_brought_to_one_focal_length(monkeypatch):
    tracks, visible, _, path = ball(count=40)
    visible[:] = True
    seen = on_object(tracks, visible, path)
    zoom = np.linspace(0.8, 1.3, FRAMES)
    zoomed = replace(
        seen, tracks=(seen.tracks - seen.principal) * zoom[:, None, None] + seen.principal, focal=FOCAL * zoom
    )
    monkeypatch.setattr(module, "_resolve_mirror", lambda start, observed, *more: (start, 1.0))
    asked = {}
    monkeypatch.setattr(
        module,
        "solve_rotations",
        lambda tracks, *more: asked.update(tracks=tracks.uv, focal=more[0]) or (_ for _ in ()).throw(KeyError),
    )
    with pytest.raises(KeyError):
        module.solve(zoomed)
    factor = np.median(zoom)
    np.testing.assert_allclose(asked["tracks"], (seen.tracks - seen.principal) * factor + seen.principal, atol=1e-9)
    assert asked["focal"] == pytest.approx(FOCAL * factor)
    two = replace(
        seen, tracks=seen.tracks[:2], visible=visible[:2], from_outline=seen.from_outline[:2], focal=seen.focal[:2]
    )
    assert module.solve(two) is None


def test_other_frames_start_at_the_nearest_sampled_one(monkeypatch):
    tracks, visible, _, path = ball(count=50, noise=0.0)
    seen = on_object(tracks, visible, path)
    bundle, _ = body(count=30, frames=4)
    frames, order = np.array([0, 4, 7, 11]), np.arange(10, 35)
    follows = np.arange(30) % 6 > 0
    asked = []
    monkeypatch.setattr(module, "resect", lambda *all: asked.append(all) or all[0])
    module._at_all_frames(bundle, frames, order, follows, tracks, seen)
    near = [0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 3, 3]  # the first of equals: 2 is as far from 0 as from 4
    whole, sighted, others, *_ = asked[0]
    np.testing.assert_array_equal(whole.rotation, bundle.rotation[near])
    np.testing.assert_array_equal(whole.center, bundle.center[near])
    np.testing.assert_array_equal(whole.points, bundle.points[follows])
    np.testing.assert_array_equal(others, [1, 2, 3, 5, 6, 8, 9, 10])
    assert [(one[3], one[4]) for one in asked] == [(30, 32.0), (30, 2.0)]
    rows = [(f, k) for f in range(FRAMES) for k, n in enumerate(order) if visible[f, n]]
    np.testing.assert_array_equal(np.column_stack([sighted.frame, sighted.point]), rows)
    np.testing.assert_array_equal(sighted.uv, [tracks[f, order[k]] for f, k in rows])
    assert (sighted.weight == 1).all()
    asked.clear()
    every, _ = body(count=30, frames=FRAMES)
    module._at_all_frames(every, np.arange(FRAMES), order, follows, tracks, seen)
    assert not asked


def posed(count=160, degrees=60.0, noise=0.1):
    """The true cameras around a ball at rest, and its tracks, a few of which do not follow it."""
    tracks, visible, z, path = ball(count=count, degrees=degrees, noise=noise)
    axis = np.array([0.1, 0.97, 0.2])
    angles = np.radians(degrees) * np.linspace(-0.5, 0.5, FRAMES)
    turns = quaternion.to_matrix(quaternion.from_rotation_vector(angles[:, None] * axis / np.linalg.norm(axis)))
    center = -np.einsum("fji,fj->fi", turns, path)
    whole = Bundle(FOCAL, np.array([120.0, 68]), turns, center, np.zeros((0, 3)))
    tracks[:, :6] += 8 * np.random.default_rng(0).standard_normal((FRAMES, 6, 2))
    visible[:, 6] = False
    visible[[0, 1], 6] = True
    visible[:, 7] = False
    visible[[0, 6, 11], 7] = True
    return whole, on_object(tracks, visible, path), z


def test_every_track_is_triangulated_from_all_frames():
    whole, seen, truth = posed()
    found = module._in_every_frame(whole, seen.tracks, seen, 0.25)
    follows, spreads, depth = [], [], np.full((FRAMES, 160), np.nan)
    for n in range(160):
        frames = np.flatnonzero(seen.visible[:, n])
        if len(frames) < 2:
            follows.append(False)
            spreads.append(0)
            continue
        sighted = Observations(frames, np.zeros(len(frames), int), seen.tracks[frames, n], np.ones(len(frames)))
        points, (spread,) = triangulate(whole, sighted, 1)
        errors = np.sort(replace(whole, points=points).errors(sighted))
        depth[:, n] = [whole.rotation[f, 2] @ (points[0] - whole.center[f]) for f in range(FRAMES)]
        follows.append(errors[len(errors) // 2] < 1.5)
        spreads.append(spread)
    follows, spreads = np.array(follows), np.array(spreads)
    follows &= spreads >= 0.35 * np.median(spreads[follows])
    follows &= np.array([(depth[seen.visible[:, n], n] > 0).all() for n in range(160)]) & (seen.visible.sum(0) >= 3)
    np.testing.assert_array_equal(found.inliers, follows)
    assert 90 > follows.sum() > 30 and not follows[:7].all()
    assert found.degrees == pytest.approx(np.degrees(np.median(spreads[follows]))) and found.error_px == 0.25
    np.testing.assert_allclose(found.z, np.where(follows & (depth > 0), depth, np.nan), rtol=1e-6)
    seen_too = seen.visible & follows
    np.testing.assert_allclose(found.z[seen_too], truth[seen_too], rtol=0.05)


def test_a_body_in_a_small_unit_is_the_same():
    whole, seen, _ = posed()
    found = module._in_every_frame(whole, seen.tracks, seen, 0.25)
    small = module._in_every_frame(replace(whole, center=0.01 * whole.center), seen.tracks, seen, 0.25)
    np.testing.assert_allclose(small.z, 0.01 * found.z, rtol=1e-6)


def test_a_body_seen_from_a_narrow_angle_or_in_few_points_is_none():
    whole, seen, _ = posed(degrees=12.0, noise=0.0)
    wide, more, _ = posed(degrees=30.0, noise=0.0)
    assert module._in_every_frame(whole, seen.tracks, seen, 0.2) is None
    assert module._in_every_frame(wide, more.tracks, more, 0.2) is not None
    nothing = replace(more, visible=more.visible & False)
    assert module._in_every_frame(wide, more.tracks, nothing, 0.2) is None
    count = module._in_every_frame(wide, more.tracks, more, 0.2).inliers
    for kept, some in ((30, True), (29, False)):
        chosen = np.flatnonzero(count)[:kept]
        part = replace(more, tracks=more.tracks[:, chosen], visible=more.visible[:, chosen])
        found = module._in_every_frame(wide, part.tracks, part, 0.2)
        assert (found is not None) == some


@pytest.mark.parametrize(("frames", "tried"), [(2, False), (3, True)])
def test_a_body_needs_three_frames(frames, tried, monkeypatch):
    def solved(*given):
        raise InterruptedError

    monkeypatch.setattr(module, "solve_rotations", solved)
    tracks, visible, _, path = ball()
    seen = on_object(tracks, visible, path)
    by_frame = ("tracks", "visible", "from_outline", "focal", "world_to_camera")
    seen = replace(seen, **{name: getattr(seen, name)[:frames] for name in by_frame})
    if tried:
        with pytest.raises(InterruptedError):
            module.solve(seen)
    else:
        assert module.solve(seen) is None
