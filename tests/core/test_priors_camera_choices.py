"""How the camera solver chooses: thresholds, figures and what it passes on, with solutions whose error is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from test_priors_cameras import FOCAL, HEIGHT, PRINCIPAL, WIDTH, clip_and_priors, observe, project, truth

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import (
    CamerasConfig,
    PriorsConfig,
    camera_problem,
    cameras,
    mirror,
    moving_people,
    pan,
    refinement,
    sfm,
    structure,
)
from f4x_core.priors.bundle import Bundle, BundleConfig, Observations, adjust, rays, triangulate
from f4x_core.priors.camera_problem import Attempt
from f4x_core.priors.mirror import Decision, Evidence, mirrored
from f4x_core.priors.point_tracks import PointTracks
from f4x_core.priors.sfm import DEFAULT_FOCAL, FOCALS, Solution, refocused, sightings, subset, with_points_ahead
from f4x_core.priors.zoom import Zoom, mean_cost
from f4x_core.progress import silent


def static_solution(frames):
    """A camera that stands and sees nothing."""
    return cameras._static_camera(np.tile(np.eye(3), (frames, 1, 1)), replace(job_of(), focal=100.0))


def solution_of(bundle, noise=0.0):
    return Solution(bundle, observe(bundle, noise), np.ones(len(bundle.center), bool))


def job_of(bundle=None, noise=0.1, first=None, **settings):
    """The solver's inputs for projected points."""
    bundle = truth(frames=8, points=120) if bundle is None else bundle
    tracks, visible = project(bundle, noise)
    clip, priors = clip_and_priors(tracks, visible)
    return camera_problem.CameraProblem(
        clip,
        priors,
        PriorsConfig(cameras=CamerasConfig(**settings)),
        PointTracks.all_static(tracks, visible),
        FOCAL,
        first,
        silent,
    )


def test_frames_count_as_registered_when_their_cameras_meet_what_stands():
    """Any number of them, from which a first solution was made."""
    bundle = truth(frames=30, points=120)
    job = job_of(bundle, noise=0.1)
    found = refinement._trusted(job, Attempt(solution_of(bundle)))
    assert found.statistics == {"registered": 30}
    assert found.solution.registered.all() and found.solution.bundle is bundle
    turned = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.0, 0.04, 0.0])))
    wrong = replace(bundle, rotation=np.concatenate([bundle.rotation[:-2], turned @ bundle.rotation[-2:]]))
    found = refinement._trusted(job, Attempt(solution_of(wrong)))
    assert found.solution.registered.all() and found.statistics == {"registered": 30, "grown": True} and found.in_doubt


def test_the_largest_median_shift_between_two_frames():
    rng = np.random.default_rng(0)
    tracks = rng.normal(0, 1, (30, 40, 2)) + np.arange(30)[:, None, None] * [0.3, 0.1]
    visible, static = rng.random((30, 40)) < 0.6, rng.random(40) < 0.8
    visible[29] = np.arange(40) < 12  # too few shared with any other
    every = PointTracks(tracks, visible, static)
    for most in (24, 30, 5):
        frames, best = np.unique(np.linspace(0, 29, min(most, 30)).round().astype(int)), []
        for a, i in enumerate(frames):
            for j in frames[a + 1 :]:
                shared = visible[i] & visible[j] & static
                if shared.sum() >= 12:
                    best.append(np.median(np.hypot(*(tracks[j, shared] - tracks[i, shared]).T)))
        assert camera_problem.static_shift(every, most) == pytest.approx(max(best))
    assert camera_problem.static_shift(every) == camera_problem.static_shift(every, 24)
    twelve = np.arange(40) < 12
    assert camera_problem.static_shift(PointTracks(tracks[:2], np.ones((2, 40), bool), twelve)) > 0
    assert np.isnan(camera_problem.static_shift(PointTracks(tracks[:2], np.ones((2, 40), bool), np.arange(40) < 11)))
    assert np.isnan(camera_problem.static_shift(every.of_frames(slice(1))))


@pytest.mark.parametrize(
    ("first", "second", "both", "expected"),
    [
        (24, 24, 12, True),
        (24, 24, 11, False),
        (40, 60, 20, True),
        (40, 60, 19, False),
        (60, 40, 20, True),
        (12, 12, 12, True),
    ],
)
def test_frames_are_linked_by_half_of_the_fewer_tracks(first, second, both, expected):
    visible = np.zeros((2, first + second), bool)
    visible[0, :first], visible[1, first - both : first - both + second] = True, True
    assert structure.linked(visible) == expected
    assert structure.linked(np.vstack([visible, visible[1:]])) == expected
    assert structure.linked(np.vstack([visible[:1], visible])) == expected


def test_static_tracks_are_those_below_one_half():
    _, priors = clip_and_priors(*project(truth(frames=3, points=4)), motion=np.float32([0.49, 0.5, 0.51, 0]))
    np.testing.assert_array_equal(PointTracks.of(priors).static, [True, False, False, True])
    priors.tracks_motion = None
    assert PointTracks.of(priors).static.tolist() == [True] * 4
    for name in ("tracks", "tracks_visible"):
        none = PointTracks.of(replace(priors, **{name: None}))
        assert (none.uv.shape, none.visible.shape, none.static.shape) == ((3, 0, 2), (3, 0), (0,))


def test_interpolation_leaves_one_camera_out():
    true = truth(frames=9, points=60)
    seen, times = observe(true), np.array([0.0, 1, 2, 4, 5, 6, 8, 9, 10])
    few = seen.keep((seen.frame != 4) | (seen.point < 11))
    path, errors = true.path(times, WIDTH, HEIGHT), []
    for i in (2, 3, 5, 6):
        keep = np.arange(9) != i
        rest = CameraPath(path.intrinsics[keep], path.world_to_camera[keep], times[keep], WIDTH, HEIGHT)
        points = true.points[np.unique(seen.point[seen.frame == i])]
        away = rest.at(times[i]).project(points)[0] - path[i].project(points)[0]
        errors.append(np.median(np.hypot(*away.T)))
    found = cameras.interpolation_error(true, few, times)
    assert found["mean"] == pytest.approx(np.mean(errors), abs=6e-4)
    assert found["p90"] == pytest.approx(np.percentile(errors, 90), abs=6e-4)
    twelve = seen.keep((seen.frame == 4) & np.isin(seen.point, np.unique(seen.point[seen.frame == 4])[:12]))
    assert cameras.interpolation_error(true, twelve, times) is not None
    assert cameras.interpolation_error(true, seen.keep(seen.frame < 2), times) is None


def cleaned(bundle, seen):
    return Solution(bundle, seen, np.ones(len(bundle.center), bool)).without_outliers()


def test_outliers_go_and_with_them_points_seen_twice():
    true = truth(frames=6, points=50)
    seen = observe(true, noise=0.2)
    uv = seen.uv.copy()
    uv[::11] += 2.7  # off by 3.8
    seen = replace(seen, uv=uv)
    for scale in (1.0, 6.0):  # the median decides where it is large
        noisy = replace(seen, uv=seen.uv + (scale - 1) * (observe(true, noise=0.2).uv - observe(true).uv))
        errors = true.errors(noisy)
        kept = errors < max(3, 4 * np.median(errors))
        count = [kept[noisy.point == p].sum() for p in range(50)]
        found = cleaned(true, noisy)
        bundle, rest = found.bundle, found.observations
        chosen = [p for p in range(50) if count[p] >= 3]
        np.testing.assert_array_equal(bundle.points, true.points[chosen])
        rows = [
            (f, chosen.index(p)) for f, p, k in zip(noisy.frame, noisy.point, kept, strict=True) if k and p in chosen
        ]
        np.testing.assert_array_equal(np.column_stack([rest.frame, rest.point]), rows)
    lost = replace(true, points=np.where(np.arange(50)[:, None] < 5, np.nan, true.points))
    assert len(cleaned(lost, seen).bundle.points) < 46
    most = replace(true, points=np.where(np.arange(50)[:, None] < 40, -true.points, true.points))
    assert 0 < len(cleaned(most, seen).bundle.points) <= 10  # those in front, where most are behind
    two = truth(frames=2, points=20)
    assert len(cleaned(two, observe(two)).bundle.points) == observe(two).visible(2, 20).all(0).sum()
    nothing = seen.keep(np.zeros(len(seen.frame), bool))
    assert len(cleaned(true, nothing).bundle.points) == 0


def test_the_first_camera_is_the_origin_of_the_same_geometry():
    true = truth(frames=4, points=20)
    moved = cameras._first_camera_at_origin(true)
    np.testing.assert_allclose(moved.rotation[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(moved.center[0], 0, atol=1e-12)
    assert moved.errors(observe(true)).max() < 1e-4
    solution = solution_of(true)
    z = true.local(solution.observations)[:, 2]
    assert cameras._median_depth(solution) == pytest.approx(np.median(z))
    small = replace(true, points=0.1 * true.points, center=0.1 * true.center)
    assert cameras._median_depth(replace(solution, bundle=small)) == pytest.approx(0.1 * np.median(z))
    behind = replace(true, points=np.where(np.arange(20)[:, None] < 8, -true.points, true.points))
    z = behind.local(solution.observations)[:, 2]
    assert cameras._median_depth(replace(solution, bundle=behind)) == pytest.approx(np.median(z[z > 0]))
    nothing = static_solution(3)
    assert cameras._median_depth(nothing) == 1 and nothing.registered.all() and not nothing.bundle.center.any()
    np.testing.assert_array_equal(nothing.bundle.rotation, np.tile(np.eye(3), (3, 1, 1)))
    assert nothing.bundle.points.shape == (0, 3) and nothing.observations.uv.shape == (0, 2)
    path = true.path(np.arange(4), WIDTH, HEIGHT)
    turns = [np.arccos((np.trace(a.T @ b) - 1) / 2) for a, b in zip(true.rotation[1:], true.rotation[:-1], strict=True)]
    np.testing.assert_allclose(cameras._turns(path), turns, rtol=1e-6)
    assert (
        camera_problem.rounded(1.23456) == 1.2346
        and camera_problem.rounded(np.inf) is None
        and camera_problem.rounded(np.nan) is None
    )
    for known, share in (([0, 1, 0, 1, 0], 0.6), ([0, 0, 0, 0, 0], 0), ([1, 0, 0, 0, 1], 1), ([0, 0, 1, 0, 0], 0.2)):
        assert structure._covered(np.array(known, bool)) == pytest.approx(share)


def test_masks_grow_to_every_side():
    mask = np.zeros((2, 20, 24), bool)
    mask[0, 8, 9], mask[1, 0, 23] = True, True
    for margin in (1, 3):
        found = moving_people.dilate_masks(mask, margin)
        square = np.ones((2 * margin + 1,) * 2)
        np.testing.assert_array_equal(found, [ndimage.binary_dilation(one, square) for one in mask])


def test_keyframes_are_spread_over_all_frames():
    true = truth(frames=3, points=20)
    keyframes = np.array([1, 4, 6])
    solution = replace(solution_of(true), registered=np.array([True, False, True]))
    found = structure._spread(solution, keyframes, 8)
    np.testing.assert_array_equal(np.flatnonzero(found.registered), [1, 6])
    np.testing.assert_array_equal(found.bundle.center[keyframes], true.center)
    np.testing.assert_array_equal(found.bundle.rotation[keyframes], true.rotation)
    np.testing.assert_array_equal(found.bundle.rotation[0], np.eye(3))
    assert not found.bundle.center[[0, 2, 3, 5, 7]].any()
    np.testing.assert_array_equal(found.observations.frame, keyframes[solution.observations.frame])


def test_few_points_that_hold_all_frames_are_kept():
    true = truth(frames=6, points=50)
    points = true.points.copy()
    points[2] = np.nan
    seen = observe(true)
    often = np.flatnonzero(seen.visible(6, 50).all(0))[1]
    seen = seen.keep((seen.point != often) | (seen.frame < 2))
    solution = Solution(replace(true, points=points), seen, np.ones(6, bool))
    kept = np.unique(refinement._limited_observations(solution, 100).point)
    count = np.bincount(seen.point, minlength=50)
    np.testing.assert_array_equal(kept, [p for p in range(50) if count[p] > 2 and p != 2])
    assert count[often] == 2 and len(np.unique(refinement._limited_observations(solution, 12).point)) == 12


def test_missing_cameras_are_put_on_the_path_through_the_others():
    true = truth(frames=8, points=20)
    registered, times = np.array([1, 1, 0, 1, 0, 0, 1, 1], bool), np.array([0, 1, 2, 3, 5, 6, 7, 9.0])
    bundle = replace(true, center=np.where(registered[:, None], true.center, 99.0))
    found = refinement._interpolated(bundle, registered, np.array([2, 5]), times)
    known = CameraPath(true.intrinsics[registered], true.world_to_camera[registered], times[registered], WIDTH, HEIGHT)
    for frame in (2, 5):
        np.testing.assert_allclose(found.center[frame], known.at(times[frame]).center, atol=1e-12)
        np.testing.assert_allclose(found.rotation[frame], known.at(times[frame]).world_to_camera[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(found.center[4], [99, 99, 99])
    seen = observe(true)
    again = refinement._triangulated(replace(true, points=true.points + 1), seen, registered, 5)
    np.testing.assert_array_equal(again.points[:5], true.points[:5] + 1)
    expected, _ = triangulate(true, seen.keep(registered[seen.frame]), 20)
    np.testing.assert_array_equal(again.points[5:], expected[5:])


def test_a_solution_is_completed_from_its_neighbours_outwards(monkeypatch):
    true = truth(frames=9, points=80)
    tracks, visible = project(true, noise=0.1)
    registered = np.array([0, 0, 1, 1, 1, 0, 0, 0, 0], bool)
    start = Solution(
        replace(true, center=np.where(registered[:, None], true.center, 0)),
        observe(true, 0.1).keep(registered[observe(true).frame]),
        registered,
    )
    rings, adjusted, solve = [], [], refinement.resect

    def resect(bundle, seen, frames):
        rings.append(frames.tolist())
        assert set(np.unique(seen.weight)) == {0.2, 1.0}
        return solve(bundle, seen, frames)

    monkeypatch.setattr(refinement, "resect", resect)
    monkeypatch.setattr(
        refinement, "adjust", lambda bundle, seen, config: adjusted.append(config) or adjust(bundle, seen, config)
    )
    found = refinement.complete(start, PointTracks.all_static(tracks, visible), np.arange(9.0))
    assert rings == [[1, 5], [0, 6], [7], [8]] and found.registered.all()
    assert adjusted[0].iterations == 10 and not adjusted[0].refine_focal
    assert np.median(found.bundle.errors(found.observations)) < 0.3
    own, extra = start.observations, sightings(PointTracks.all_static(tracks, visible), 2000).seen
    assert len(own.frame) < len(found.observations.frame) <= len(own.frame) + len(extra.frame)
    refinement.complete(start, PointTracks.all_static(tracks, visible), np.arange(9.0), BundleConfig(refine_focal=True))
    assert adjusted[1].refine_focal and adjusted[1].iterations == 10


def test_tracks_in_pieces_are_the_same_sightings_and_link_all_neighbouring_frames():
    random = np.random.default_rng(3)
    tracks = random.uniform(0, 100, (60, 40, 2))
    visible = np.cumsum(random.random((60, 40)) < 0.03, 0) % 2 == 0  # seen and hidden for some thirty frames each
    chosen = np.ones(40, bool)
    every = PointTracks(tracks, visible, chosen)
    sighted, pieces = sightings(every, 40), sightings(every, 40, longest=12)
    (whole, order), (cut, owner) = ((one.seen, one.tracks) for one in (sighted, pieces))
    assert len(owner) > 2 * len(order) and cut.point.max() == len(owner) - 1
    assert np.allclose(cut.uv, tracks[cut.frame, owner[cut.point]])
    first, last, count = np.full(len(owner), 60), np.zeros(len(owner), int), np.bincount(cut.point)
    np.minimum.at(first, cut.point, cut.frame)
    np.maximum.at(last, cut.point, cut.frame)
    assert (last - first).max() < 12 and count.min() >= 3
    assert len(whole.frame) - len(cut.frame) <= 2 * (len(owner) + 2 * len(order))  # ends seen less than three times
    assert all(np.intersect1d(cut.point[cut.frame == t], cut.point[cut.frame == t + 1]).size > 5 for t in range(59))


@pytest.mark.parametrize(("travel", "noise"), [(0.02, 0.3), (0.12, 0.3), (0.9, 0.3), (0.3, 30.0)])
def test_translating_is_judged_by_gain_and_size(travel, noise):
    true = truth(frames=8, travel=travel, points=120)
    true = replace(true, points=0.4 * true.points + 1, center=0.4 * true.center + 1)
    job, moved = job_of(true, noise=noise), solution_of(true, noise=noise)
    translation = structure.translation_of(job, moved)
    seen = moved.observations
    sample, _ = subset(moved, 120, 8)
    still = refocused(replace(sample), FOCAL, False).bundle
    still = adjust(
        replace(still, center=0 * still.center),
        sample.observations,
        replace(job.lens, refine_centers=False, iterations=20),
    )
    own = mean_cost(sample.bundle, sample.observations, 3 * 8 + len(sample.bundle.points))
    gain = 1 - own / mean_cost(still, sample.observations)
    inverse = 1 / sample.bundle.local(sample.observations)[:, 2]
    spread = np.clip(inverse, *np.percentile(inverse, (2, 98))).std()
    reach = np.sqrt(((true.center - true.center.mean(0)) ** 2).sum(1).mean())
    size = FOCAL * spread * reach
    real, found = gain >= 0.1 and size >= 0.5, translation.summary()
    assert translation.real == real
    assert found["gain"] == pytest.approx(gain, abs=1e-4) and found["size_px"] == pytest.approx(size, abs=1e-4)
    assert found["verdict"] == ("none" if not real else "large" if size >= 8 else "small")
    assert len(seen.frame)


@pytest.mark.parametrize(
    ("points", "per_frame", "frames"),
    [(250, 250, [24]), (190, 190, [24, 48, 90]), (260, 140, [24, 48, 90]), (200, 150, [24])],
)
def test_more_frames_are_sampled_where_points_are_few(monkeypatch, points, per_frame, frames):
    asked = []

    def taken(solution, most, count):
        assert most == 500
        asked.append(min(count, 90))
        frame = np.repeat(np.arange(asked[-1]), per_frame)
        bundle = replace(solution.bundle, points=np.zeros((points, 3)))
        seen = Observations(frame, 0 * frame, np.zeros((len(frame), 2)), np.ones(len(frame)))
        return Solution(bundle, seen, np.ones(asked[-1], bool)), np.arange(asked[-1])

    monkeypatch.setattr(sfm, "subset", taken)
    true = truth(frames=90, points=10)
    _, kept = sfm.sampled(Solution(true, observe(true), np.ones(90, bool)))
    assert asked == frames and len(kept) == frames[-1]
    asked.clear()
    long = truth(frames=200, points=10)
    monkeypatch.setattr(
        sfm,
        "subset",
        lambda solution, most, count: (
            asked.append(count)
            or (replace(solution, observations=observe(long).keep(np.zeros(0, int))), np.arange(count))
        ),
    )
    sfm.sampled(Solution(long, observe(long), np.ones(200, bool)))
    assert asked == [24, 48, 96]


@pytest.mark.parametrize("margin", [4.7, 4.5, 0.2])
def test_what_lost_a_doubtful_decision_stays_a_rival(margin, monkeypatch):
    true = truth(frames=8, points=120)
    lost = replace(true, center=true.center - 1, points=true.points + 1)
    decision = Decision(true, True, (Evidence("it", margin, ""),), lost)
    monkeypatch.setattr(structure, "choose_orientation", lambda *asked: decision)
    found = structure._resolve_mirror(job_of(true), solution_of(true)).solution
    np.testing.assert_array_equal(found.bundle.center, true.center)
    if margin > 4.6:
        assert found.rival is None
    else:
        np.testing.assert_array_equal(found.rival.bundle.center, lost.center)
        np.testing.assert_array_equal(found.rival.bundle.points, lost.points)
        assert found.rival.observations is found.observations and found.rival.rival is None


@pytest.mark.parametrize("chosen", ["right", "mirrored"])
def test_of_two_rivals_the_one_that_holds_all_frames_wins(chosen):
    true = truth(frames=12, points=120)
    wrong = mirrored(true)
    job = job_of(true)
    sides = [solution_of(true), replace(solution_of(true), bundle=wrong)]
    first, rival = sides if chosen == "right" else sides[::-1]
    start = Attempt(replace(first, rival=rival), statistics={"mirror": {"verdict": "toss-up"}})
    completed = refinement._completed(job, start)
    found, decided = completed.solution, completed.statistics["mirror"]
    points, _ = triangulate(found.bundle, observe(true), len(true.points))
    known = np.isfinite(points).all(1)
    assert np.corrcoef(points[known, 2], true.points[known, 2])[0, 1] > 0.9 and found.error < 0.3
    assert decided["sample"] == {"verdict": "toss-up"} and decided["evidence"][0]["for"] > 0


def test_points_that_rays_meet_behind_the_cameras_go_to_infinity():
    true = truth(frames=8, points=120)
    seen = observe(true)
    behind = np.arange(120) % 3 == 0
    points = np.where(behind[:, None], true.points * [1, 1, -1], true.points)
    found = with_points_ahead(replace(true, points=points), seen)
    np.testing.assert_array_equal(found.points[~behind], true.points[~behind])
    sighted = behind & (np.bincount(seen.point, minlength=120) > 0)
    assert (np.linalg.norm(found.points[sighted], axis=1) > 100 * np.linalg.norm(true.points, axis=1).max()).all()
    far = seen.keep(sighted[seen.point])
    mean = np.stack([rays(true, far)[far.point == point].mean(0) for point in np.flatnonzero(sighted)])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    toward = found.points[sighted] / np.linalg.norm(found.points[sighted], axis=1, keepdims=True)
    np.testing.assert_allclose(toward, mean, atol=1e-3)


def test_a_mirror_image_is_decided_on_a_sample(monkeypatch):
    true = truth(frames=8, points=120)
    job, asked = job_of(true), []

    def choose(starts, seen, lens, known):
        asked.append((starts, seen, lens, known))
        return module_decision(starts[0])

    def module_decision(bundle):
        return Decision(replace(bundle, center=bundle.center + 1), False, ())

    monkeypatch.setattr(structure, "choose_orientation", choose)
    start = solution_of(true)
    sample, frames = sfm.sampled(start)
    attempt = structure._resolve_mirror(job, start)
    found = attempt.solution
    starts, _, lens, known = asked[0]
    assert len(starts) == 1 and lens == job.lens
    np.testing.assert_array_equal(known.frames, frames)
    np.testing.assert_array_equal(found.bundle.center[frames], true.center[frames] + 1)
    np.testing.assert_array_equal(found.observations.frame, frames[sample.observations.frame])
    holding = np.bincount(sample.observations.frame, minlength=8)
    np.testing.assert_array_equal(found.registered, holding >= 12)
    assert attempt.statistics["mirror"]["chosen"] == "least error"
    assert found.rival is None, "there was only one solution"
    turning = replace(start, bundle=replace(true, center=0 * true.center, points=3 * true.points))
    structure._resolve_mirror(job, turning)
    starts = asked[1][0]
    sample, _ = sfm.sampled(turning)
    directions = sample.bundle.points / np.linalg.norm(sample.bundle.points, axis=1, keepdims=True)
    below = mirror.guess_inverse_distance(directions, sample.bundle.rotation)[:, None]
    np.testing.assert_allclose(starts[0].points, directions / below)
    np.testing.assert_allclose(starts[1].points, directions * below)
    nothing = replace(start, observations=start.observations.keep(np.zeros(0, int)))
    assert structure._resolve_mirror(job, nothing) is None
    some = structure._with_sightings(job, nothing)
    expected = sightings(job.tracks, 2000)
    np.testing.assert_array_equal(some.observations.uv, expected.seen.uv)
    np.testing.assert_allclose(some.bundle.points, triangulate(true, expected.seen, len(expected.tracks))[0])
    assert structure._with_sightings(job, start) is start
    job.priors.scratch.seen_depth = "seen"
    assert job.cues(frames).depth == "seen"
    job.priors.depth = "prior"
    assert job.cues(frames).depth == "prior" and job.cues(frames).mask is None


class Known(Solution):
    """A solution whose error is given."""

    error = property(lambda self: self.bundle.focal)


def known(error, registered):
    registered = np.array(registered, bool)
    count = len(registered)
    bundle = Bundle(error, PRINCIPAL, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((0, 3)))
    return Known(bundle, static_solution(1).observations, registered)


ALL, NINE, EIGHT, FIVE, FOUR = ([1] * n + [0] * (10 - n) for n in (10, 9, 8, 5, 4))


@pytest.mark.parametrize(
    ("colmap", "own", "solver", "chosen", "warned"),
    [
        ((1.4, NINE), None, "auto", "colmap", False),  # good enough at once
        ((1.5, NINE), (0.5, ALL), "auto", "tracks", False),
        ((1.4, EIGHT), (2.9, NINE), "auto", "tracks", False),
        ((1.4, EIGHT), (3.0, NINE), "auto", "colmap", True),
        ((2.9, ALL), (0.5, EIGHT), "auto", "colmap", False),
        ((3.0, ALL), (3.0, ALL), "auto", "none", False),
        (None, (2.9, FIVE), "auto", "tracks", True),
        (None, (2.9, FOUR), "auto", "none", False),
        (None, None, "auto", "none", False),
        ((1.0, EIGHT), (1.0, ALL), "colmap", "colmap", True),
        ((1.0, ALL), (1.0, ALL), "tracks", "tracks", False),
    ],
)
def test_the_better_of_two_incremental_solvers(monkeypatch, colmap, own, solver, chosen, warned):
    made = {name: None if one is None else known(*one) for name, one in (("colmap", colmap), ("tracks", own))}
    job = job_of(truth(frames=10, points=20), solver=solver)
    monkeypatch.setattr(structure, "_solve_keyframes", lambda job, frames: made["colmap"])
    monkeypatch.setattr(structure, "solve_with_tracks", lambda *all: made["tracks"])
    found = structure._solve_incrementally(job)
    if chosen == "none":
        assert found is None
    else:
        assert found.statistics == {"solver": chosen} and found.solution is made[chosen]
        assert bool(found.warnings) == warned


def test_keyframes_get_masks_a_hundredth_wider(monkeypatch):
    job, asked = job_of(focal=0.8, features=99, seed=3), []
    job.priors.mask = np.zeros((8, HEIGHT, WIDTH), bool)
    job.priors.mask[:, 50, 60] = True
    monkeypatch.setattr(structure, "solve_with_colmap", lambda *all: asked.append(all))
    assert structure._solve_keyframes(job, np.array([1, 5])) is None
    pictures, masks, settings = asked[0]
    np.testing.assert_array_equal(pictures, job.clip.frames[[1, 5]])
    np.testing.assert_array_equal(masks, moving_people.dilate_masks(job.priors.mask[[1, 5]], 3))
    assert (settings.focal, settings.focal_known, settings.features, settings.seed) == (FOCAL, True, 99, 3)
    found = solution_of(truth(frames=2, points=20))
    monkeypatch.setattr(structure, "solve_with_colmap", lambda *all: asked.append(all) or found)
    free = job_of()
    assert structure._solve_keyframes(free, np.array([1, 5])).registered.sum() == 2
    assert asked[1][1] is None and asked[1][2].focal_known is False
    narrow = replace(free, priors=replace(free.priors, width=99, mask=job.priors.mask))
    structure._solve_keyframes(narrow, np.array([1, 5]))
    assert asked[2][1].sum() == 2 * 9  # a pixel at least


@pytest.mark.parametrize(
    ("error", "linked", "solver", "name", "count"),
    [
        (2.99, True, "auto", "direct", 1), (3.0, True, "auto", "tracks", 2), (0.5, False, "auto", "tracks", 2),
        (9.0, False, "direct", "direct", 1), (0.5, True, "tracks", "tracks", 1),
    ],
)  # fmt: skip
def test_small_motion_is_solved_directly_where_it_serves(monkeypatch, error, linked, solver, name, count):
    job, asked = job_of(solver=solver), []
    job.tracks.static[:9] = False
    monkeypatch.setattr(
        structure, "_resolve_mirror", lambda job, start: asked.append(start) or Attempt(known(error, [1] * 8))
    )

    def are_linked(visible):
        np.testing.assert_array_equal(visible, job.tracks.visible & job.tracks.static)
        return linked

    monkeypatch.setattr(structure, "linked", are_linked)
    monkeypatch.setattr(
        structure, "_solve_incrementally", lambda job: Attempt(known(1.0, [1] * 8), statistics={"solver": "tracks"})
    )
    found = structure._moving(job, known(0.1, [1] * 8))
    assert found.statistics["solver"] == name and len(asked) == count and found.solution.error == error


def test_what_is_left_where_every_solver_fails(monkeypatch):
    job = job_of()
    direct = known(9.0, [1] * 8)
    monkeypatch.setattr(structure, "_resolve_mirror", lambda job, start: Attempt(direct, statistics={"mirror": "its"}))
    monkeypatch.setattr(structure, "_solve_incrementally", lambda job: None)
    found = structure._moving(job, direct)
    assert found.solution is direct and found.statistics == {"solver": "direct", "mirror": "its"}


@pytest.mark.parametrize(
    ("error", "solver", "name"),
    [(5.99, "auto", "depth"), (6.0, "auto", "direct"), (1.0, "direct", "direct"), (1.0, "depth", "depth")],
)
def test_a_depth_prior_is_asked_first(monkeypatch, error, solver, name):
    job, asked = job_of(solver=solver, focal=0.8 if solver == "depth" else None), []
    job.priors.depth = np.ones((8, HEIGHT, WIDTH), np.float32)
    monkeypatch.setattr(
        structure, "solve_with_depth", lambda *all: asked.append(all) or (known(error, [1] * 8), {"curve": 1})
    )
    monkeypatch.setattr(structure, "_resolve_mirror", lambda job, start: Attempt(known(0.5, [1] * 8)))
    monkeypatch.setattr(structure, "linked", lambda visible: True)
    found = structure._moving(job, known(1.0, [1] * 8)).statistics
    assert found["solver"] == name
    assert len(asked) == (solver != "direct")
    if asked:
        assert asked[0][2:] == (FOCAL if solver == "depth" else None, WIDTH)
        assert found["focal_search"] == {"curve": 1}


def test_the_lens_is_looked_for_again_where_the_background_is_sure(monkeypatch):
    true = truth(frames=8, points=120)
    found = solution_of(true)
    asked = []
    monkeypatch.setattr(
        refinement,
        "best_focal",
        lambda solution, lens: asked.append(lens) or (1.3 * solution.bundle.focal, {"curve": 1}),
    )
    job = job_of(true)
    again = refinement._refocused(job, Attempt(found))
    assert again.statistics == {"focal_search": {"curve": 1}} and asked == [job.sharp_lens]
    assert again.solution.bundle.focal == pytest.approx(true.focal, rel=0.02)  # a wrong one is adjusted away again
    for given, start in (
        (job, replace(again, solution=found)),  # a depth prior has set it
        (job_of(true, focal=0.9), Attempt(found)),
        (job, Attempt(replace(found, registered=np.zeros(8, bool)))),
        (job, Attempt(found, statistics={"grown": True})),
    ):
        assert refinement._refocused(given, start) is start
    assert len(asked) == 1


def test_another_providers_cameras_start_the_solver(monkeypatch):
    first = solution_of(truth(frames=8, points=120))
    job = job_of(first=first)
    assert not job.lens.refine_focal and job_of().lens.refine_focal and not job_of(focal=1.0).lens.refine_focal
    assert job.lens.expected_focal == FOCAL
    monkeypatch.setattr(structure, "_resolve_mirror", lambda job, start: None)
    found = structure._moving(job, first)
    assert found.solution is first and found.statistics == {"solver": "classical"}
    assert pan.zoom_of(job, first) is None


def solved(monkeypatch, moves, zoom=None, kind=None, explains=False, solver="direct", parallax=0.3, focal=None):
    """What `_solve` makes of given pieces."""
    true = truth(frames=8, points=60)
    job = job_of(true, kind=kind, focal=focal)
    moved = solution_of(true)
    calls = []

    def search(solution, width, candidates, expected=DEFAULT_FOCAL):
        assert expected == DEFAULT_FOCAL  # of a picture that lies
        calls.append(tuple(candidates))
        points = np.full((1, 3), 1.0)
        bundle = Bundle(300.0, np.zeros(2), np.eye(3)[None], np.zeros((1, 3)), points)
        seen = Observations(
            np.zeros(11, int),
            np.zeros(11, int),
            300.0 + np.linspace(0, parallax / 0.9, 11)[:, None] * [1, 0],
            np.ones(11),
        )
        return Solution(bundle, seen, np.ones(1, bool)), {"search": len(calls)}

    monkeypatch.setattr(pan, "search_focal", search)
    monkeypatch.setattr(structure, "zoom_of", lambda job, turning: zoom)

    def moving(job, turning):
        seen = np.unique(turning.observations.point)
        np.testing.assert_allclose(np.linalg.norm(turning.bundle.points[seen], axis=1), 1)
        assert turning.bundle.focal == job.focal
        return Attempt(moved, statistics={"solver": solver}) if moves is not None else None

    monkeypatch.setattr(structure, "_moving", moving)
    monkeypatch.setattr(structure, "moving_explains_more", lambda zoom, moved: explains)
    translation = structure.Translation(10.0 * bool(moves), 1.0)
    monkeypatch.setattr(structure, "translation_of", lambda job, moved: translation)
    monkeypatch.setattr(
        structure,
        "panned",
        lambda job, start, focal, zoom=None: calls.append(("pan", focal, zoom)) or replace(start, solution="panned"),
    )
    monkeypatch.setattr(structure, "adjusted_pan", lambda turning, focal: ("adjusted", focal))
    return structure.first_solution(job), calls, moved


def test_an_upright_picture_is_believed_to_be_filmed_with_the_same_lens(monkeypatch):
    """A phone that is turned has the same focal length in pixels: in widths of its picture that is longer."""
    true = truth(frames=8, points=60)
    job = job_of(true)
    found = {}
    for high in (job.priors.height, 2 * job.priors.width):
        priors = replace(job.priors, height=high)
        monkeypatch.setattr(
            pan,
            "search_focal",
            lambda start, width, candidates, *rest, high=high: found.update({high: (candidates, *rest)}),
        )
        pan.search_lens(replace(job, priors=priors), solution_of(true))
    (lying, usual), (upright, longer) = found.values()
    assert tuple(lying) == FOCALS and usual == DEFAULT_FOCAL
    np.testing.assert_allclose(upright, 2 * np.array(FOCALS))
    assert longer == 2 * DEFAULT_FOCAL


def test_the_kind_of_camera(monkeypatch):
    found, calls, moved = solved(monkeypatch, True)
    assert found.solution is moved and found.kind == "moving" and calls == [FOCALS]
    assert found.statistics["solver"] == "direct" and found.statistics["translation"]["verdict"] == "large"
    assert found.statistics["parallax_px"] == pytest.approx(0.3, abs=1e-4)
    assert found.statistics["pan_focal_search"] == {"search": 1} and "focal_search" not in found.statistics
    assert len(solved(monkeypatch, True, solver="depth")[1]) == 1
    assert solved(monkeypatch, True, focal=0.7)[1] == [(FOCAL / WIDTH,)]
    found, calls, _ = solved(monkeypatch, False)
    assert (found.solution, found.kind) == ("panned", "pan") and calls[1] == ("pan", 300.0, None)
    assert solved(monkeypatch, False, kind="moving")[0].kind == "moving"
    assert solved(monkeypatch, True, kind="pan", zoom="zoom")[1][1] == ("pan", 300.0, "zoom")
    assert solved(monkeypatch, True, zoom="zoom")[1][1] == ("pan", 300.0, "zoom")
    assert solved(monkeypatch, True, zoom="zoom", explains=True)[0].kind == "moving"
    assert solved(monkeypatch, True, zoom="zoom", kind="moving")[0].kind == "moving"
    for parallax, assumed in ((0.95, False), (1.05, True)):
        found, _, _ = solved(monkeypatch, None, parallax=parallax)
        assert (found.solution, found.kind) == (("adjusted", 300.0), "pan")
        assert ("assumed" in found.statistics) == assumed
        assert any("could not be reconstructed" in line for line in found.warnings)


def test_cameras_are_adjusted_until_no_frame_is_left_behind(monkeypatch):
    true = truth(frames=8, points=120)
    tracks, visible = project(true, 0.1)
    every = sightings(PointTracks.all_static(tracks, visible), 120)
    some = sightings(PointTracks.all_static(tracks, visible), 60).seen
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.0, 0.02, 0.0])))
    rotation = true.rotation.copy()
    rotation[7] = turn @ rotation[7]
    lost, lens = solution_of(replace(true, rotation=rotation), noise=0.1), BundleConfig(refine_focal=False)
    worst = [refinement._worst_frame(one, every.seen, 120) for one in (true, lost.bundle)]
    assert worst[0] < 0.3 and worst[1] > 2
    found = refinement._settled(lost, every, some, lens)
    assert refinement._worst_frame(found.bundle, every.seen, 120) < 0.3 and found.registered.all()
    fine = solution_of(true, noise=0.1)
    assert refinement._settled(fine, every, some, lens) is fine
    asked = []
    monkeypatch.setattr(Solution, "adjusted_anew", lambda solution, *more: asked.append(solution) or solution)
    assert refinement._settled(lost, every, some, lens) is lost and len(asked) == 1  # no gain: not tried again


@pytest.mark.parametrize(
    ("found", "direct", "tracks", "blurred", "chosen"),
    [
        (0.85, 1.0, 1.0, (), ""),  # enough: nothing else is tried
        (0.6, 0.64, 0.65, (), ""),
        (0.6, 0.66, 0.65, (), "direct"),
        (0.6, 0.66, 0.67, (), "tracks"),
        (0.6, 0.86, 1.0, (), "direct"),
        (0.6, 0.86, 1.0, ("direct",), "tracks"),  # the direct ones miss what stands
        (0.6, 0.86, 1.0, ("direct", "tracks"), ""),
        (0.6, None, 0.7, (), "tracks"),
        (0.2, 0.59, 0.3, (), ""),  # not even these stand
    ],
)
def test_cameras_of_everything_explain_more_of_the_picture(monkeypatch, found, direct, tracks, blurred, chosen):
    """`None`: they only turn."""
    explained = {"": found, "direct": direct, "tracks": tracks}
    solutions = {name: solution_of(truth(frames=8, points=20)) for name in explained}
    job = job_of()
    job = replace(job, tracks=replace(job.tracks, static=np.zeros(120, bool)))

    def solve(other):
        assert other.tracks.static.all() and other.settings.kind == "moving"
        name = other.settings.solver
        kind = "pan" if explained[name] is None else "moving"
        return Attempt(solutions[name], kind, {"solver": name}, (name,))

    monkeypatch.setattr(cameras, "_solve", solve)
    monkeypatch.setattr(cameras, "translation_of", lambda job, solution: structure.Translation(10.0, 1.0))
    fractions = {id(solutions[name].bundle): fraction or 1.0 for name, fraction in explained.items()}
    monkeypatch.setattr(cameras, "explained_fraction", lambda bundle, *more: fractions[id(bundle)])
    errors = {id(solutions[name].bundle): 0.3 + 0.1 * (name in blurred) for name in explained}
    monkeypatch.setattr(cameras, "track_error", lambda bundle, *more: errors[id(bundle)])
    best = cameras._or_of_all_tracks(job, Attempt(solutions[""], "pan", {"zoom": 3}, ("It zooms.",)))
    assert best.solution is solutions[chosen] and best.kind == ("moving" if chosen else "pan")
    assert best.warnings == ((chosen,) if chosen else ("It zooms.",)) and ("zoom" in best.statistics) == (not chosen)
    assert best.statistics["explained"] == explained[chosen] and best.statistics.get("everything", False) == bool(
        chosen
    )
    assert ("translation" in best.statistics) == bool(chosen)


def test_a_pan_is_adjusted_at_its_focal_length(monkeypatch):
    true = truth(frames=8, points=60, travel=0.0)
    turning = solution_of(true, noise=0.3)
    found = pan.adjusted_pan(turning, 1.1 * FOCAL)
    start = refocused(turning, 1.1 * FOCAL, False)
    expected = adjust(
        start.bundle, start.observations, BundleConfig(iterations=8, refine_focal=False, refine_centers=False)
    )
    np.testing.assert_allclose(found.bundle.rotation, expected.rotation, atol=1e-12)
    assert found.bundle.focal == 1.1 * FOCAL and not found.bundle.center.any()
    start = Attempt(turning, "moving", {"mirror": 1, "solver": "direct", "pan_focal_search": 2})
    panned = pan.panned(job_of(true), start, 1.1 * FOCAL)
    np.testing.assert_array_equal(panned.solution.bundle.rotation, found.bundle.rotation)
    assert panned.kind == "pan" and panned.statistics == {"pan_focal_search": 2} and "only turns" in panned.warnings[0]


def test_moving_explains_more_than_a_zoom_at_little_more_than_half_its_cost():
    true = truth(frames=8, points=60)
    moved = solution_of(true, noise=0.3)
    sample, _ = sfm.sampled(moved)
    cost = mean_cost(sample.bundle, sample.observations, 6 * 8 + 3 * len(sample.bundle.points))
    for left, more in ((0.551, False), (0.549, True)):
        zoom = Zoom(1.2, 0.1, cost / left, np.zeros(8), np.arange(8))
        assert pan.moving_explains_more(zoom, moved) == more


def test_texture_decides_whether_motion_can_be_known():
    true = truth(frames=5, points=60)
    job = job_of(true)
    reason = cameras._why_motion_is_unknown(job.clip, job.tracks)
    assert reason == ""
    assert "too few" in cameras._why_motion_is_unknown(job.clip, replace(job.tracks, static=np.arange(60) < 11))
    assert cameras._why_motion_is_unknown(job.clip, replace(job.tracks, static=np.arange(60) < 12)) == ""
    plain = np.full_like(job.clip.frames, 90)
    assert "no texture" in cameras._why_motion_is_unknown(replace(job.clip, frames=plain), job.tracks)
    none = replace(job.tracks, visible=np.zeros_like(job.tracks.visible))
    assert cameras._why_motion_is_unknown(replace(job.clip, frames=plain), none) == ""
    for right, known_ in ((7, True), (5, False)):  # of 60 tracks a tenth must lie on texture
        tracks = np.full((5, 60, 2), 20.5, np.float32)
        tracks[:, :right, 0] = 250.5
        half = job.clip.frames.copy()
        half[:, :, :200] = 90
        found = cameras._why_motion_is_unknown(
            replace(job.clip, frames=half), PointTracks(tracks, np.ones((5, 60), bool), job.tracks.static)
        )
        assert (found == "") == known_


def provided(monkeypatch, kind=None, first=None, unknown="", shift=2.0, static=60, given=None, frames=6):
    true = truth(frames=frames, points=60)
    tracks, visible = project(true)
    motion = (np.arange(60) >= static).astype(np.float32)
    clip, priors = clip_and_priors(tracks, visible, motion)
    monkeypatch.setattr(cameras, "_why_motion_is_unknown", lambda *all: unknown)
    monkeypatch.setattr(cameras, "static_shift", lambda *all: shift)
    asked, solution = [], solution_of(true, noise=0.5)
    monkeypatch.setattr(cameras, "first_solution", lambda job: asked.append(job) or Attempt(solution))
    completed = []
    monkeypatch.setattr(refinement, "complete", lambda solution, *more: completed.append(more) or solution)
    config = replace(PriorsConfig(), cameras=CamerasConfig(kind=kind, focal=given))
    cameras.provide(clip, priors, config, silent, first)
    assert len(completed) == len(asked)
    np.testing.assert_array_equal(priors.cameras.intrinsics[0, :2, 2], PRINCIPAL)
    return priors, asked, solution


def test_cameras_and_their_statistics(monkeypatch):
    priors, (job,), solution = provided(monkeypatch)
    found = priors.statistics["cameras"]
    origin = cameras._first_camera_at_origin(solution.bundle)
    depth = np.median(origin.local(solution.observations)[:, 2])
    np.testing.assert_allclose(priors.cameras.centers, origin.center / depth, atol=1e-9)
    errors = solution.bundle.errors(solution.observations)
    assert found["reprojection_px"]["median"] == pytest.approx(np.median(errors), abs=1e-4)
    assert found["reprojection_px"]["p90"] == pytest.approx(np.percentile(errors, 90), abs=1e-4)
    assert found["focal_over_width"] == pytest.approx(FOCAL / WIDTH, abs=1e-4)
    assert found["fov_degrees"] == pytest.approx(np.rad2deg(2 * np.arctan(WIDTH / 2 / FOCAL)), abs=6e-3)
    path = np.linalg.norm(np.diff(solution.bundle.center, axis=0), axis=1).sum() / depth
    assert found["path_length"] == pytest.approx(path, abs=1e-4)
    turns = quaternion.from_matrix(solution.bundle.rotation)
    turn = [2 * np.arccos(min(abs(a @ b), 1)) for a, b in zip(turns[1:], turns[:-1], strict=True)]
    assert found["turn_degrees"] == pytest.approx(np.rad2deg(sum(turn)), abs=1e-3)
    assert found["static_tracks"] == 60 and found["static_shift_px"] == 2.0 and found["kind"] == "moving"
    assert job.focal == 0.9 * WIDTH
    np.testing.assert_array_equal(job.principal, PRINCIPAL)
    assert found["interpolation_px"] == cameras.interpolation_error(origin, solution.observations, np.arange(6.0))


def test_when_a_camera_stands_still(monkeypatch):
    for shift, still in ((0.5, False), (0.49, True), (np.nan, True)):
        priors, asked, _ = provided(monkeypatch, shift=shift)
        assert (priors.camera_kind == "static") == still == (not asked)
    assert not provided(monkeypatch, kind="static")[1] and provided(monkeypatch, kind="moving", shift=0.1)[1]
    priors, asked, _ = provided(monkeypatch, unknown="it is dark")
    assert priors.statistics["cameras"]["assumed"] == "it is dark" and not asked
    assert provided(monkeypatch, kind="moving", unknown="it is dark")[1]
    priors, _, _ = provided(monkeypatch, unknown="it is dark", frames=1)
    assert "assumed" not in priors.statistics["cameras"] and not priors.warnings
    assert "assumed" in provided(monkeypatch, unknown="it is dark", frames=2)[0].statistics["cameras"]
    assert priors.cameras.intrinsics[0, 0, 0] == 0.9 * WIDTH
    assert provided(monkeypatch, kind="static", given=0.7)[0].cameras.intrinsics[0, 0, 0] == pytest.approx(0.7 * WIDTH)


def test_cameras_of_another_provider_are_kept_where_too_little_stands_still(monkeypatch):
    first = solution_of(truth(frames=6, points=60))
    for static, refined in ((11, False), (12, True)):
        priors, asked, _ = provided(monkeypatch, first=first, static=static, unknown="never asked")
        assert bool(asked) == refined and priors.camera_kind == "moving"
        assert any("they are taken as they are" in line for line in priors.warnings) != refined
    priors, _, _ = provided(monkeypatch, first=first, static=11)
    assert priors.statistics["cameras"]["solver"] == "classical"
    assert priors.cameras.intrinsics[0, 0, 0] == pytest.approx(FOCAL)
    priors, _, _ = provided(monkeypatch, first=first, static=11, given=1.5)
    assert priors.cameras.intrinsics[0, 0, 0] == pytest.approx(1.5 * WIDTH)
    assert provided(monkeypatch, first=first, static=11, kind="static")[0].camera_kind == "static"


def test_a_zoom_is_looked_for_where_the_lens_is_not_known(monkeypatch):
    job, turning = job_of(), solution_of(truth(frames=8, points=120))
    zooms = [Zoom(1.3, left, 1.0, np.zeros(8), np.arange(8)) for left in (0.1, 0.9)]
    queue, asked = list(zooms), []
    monkeypatch.setattr(pan, "find_zoom", lambda sample, frames, lens: asked.append((frames, lens)) or queue.pop(0))
    assert pan.zoom_of(job, turning) is zooms[0] and pan.zoom_of(job, turning) is None
    np.testing.assert_array_equal(asked[0][0], sfm.sampled(turning)[1])
    assert asked[0][1] == job.lens
    nothing = replace(turning, observations=turning.observations.keep(np.zeros(0, int)))
    assert pan.zoom_of(job, nothing) is None and len(asked) == 2


@pytest.mark.parametrize("focal", [None, 0.8])
def test_a_known_focal_length_is_handed_to_the_zoom(monkeypatch, focal):
    job, asked = job_of(focal=focal), []
    found = solution_of(replace(truth(frames=8, points=120), zoom=np.linspace(0.9, 1.1, 8)))
    monkeypatch.setattr(pan, "zoomed", lambda turning, zoom, known: asked.append(known) or found)
    zoom = Zoom(1.3, 0.1, 1.0, np.zeros(8), np.arange(8))
    panned = pan.panned(job, Attempt(found, statistics={"pan_focal_search": 1}), 1.0, zoom)
    assert panned.solution is found and asked == [None if focal is None else FOCAL]
    assert panned.statistics == {"zoom": zoom.summary(found.bundle, WIDTH)} and "zooms" in panned.warnings[0]


def test_a_clip_without_sightings_has_no_parallax(monkeypatch):
    job = job_of()
    monkeypatch.setattr(pan, "search_focal", lambda *all, **more: (static_solution(1), {}))
    monkeypatch.setattr(structure, "_moving", lambda job, turning: None)
    found = structure.first_solution(job)
    assert found.statistics["parallax_px"] == 0 and "assumed" not in found.statistics
