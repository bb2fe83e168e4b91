"""How far a view is believed, and from how many sides things are seen, against loops over pixels, points and frames."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from test_diagnostics import node_scaffold
from test_geometry_findings import mirror, orbiting

from f4x_core.geometry.camera import CameraPath
from f4x_core.metrics import viewing_angles
from f4x_core.metrics.believed import DepthEvidence, believed_degrees, depth_evidence
from f4x_core.metrics.viewing_angles import (
    angular_factor,
    angular_speed,
    group_views,
    parallax_degrees,
    spanned_degrees,
)
from f4x_core.metrics.way_round import WayRound
from f4x_core.priors import Priors

# ---- the angle ---------------------------------------------------------------------------------------------------------

EVIDENCE = DepthEvidence(0.8, 0.05, 4.0, 0.002, 0.03, 0.2)


def angle(error: float, focal: float = 0.8) -> float:
    """Degrees aside at which a relative error of depth displaces by 3 / 480 of the width."""
    return math.degrees(math.atan(3 / 480 / (focal * error)))


def test_independent_errors_add_in_squares():
    relief = 0.002 / (0.8 * math.radians(4))
    found = believed_degrees(EVIDENCE)
    assert found.static == pytest.approx(angle(math.sqrt(relief**2 + 0.03**2 + 0.05**2)), rel=1e-9)
    assert found.moving == pytest.approx(angle(math.sqrt(relief**2 + 0.03**2 + 0.2**2)), rel=1e-9)
    better = believed_degrees(dataclasses.replace(EVIDENCE, moving_error=0.01))
    assert better.moving == better.static == found.static
    assert believed_degrees(dataclasses.replace(EVIDENCE, moving_error=None)).moving is None


@pytest.mark.parametrize("degrees", [0.0, 0.1, 0.5, 2.0])
def test_rays_that_are_almost_parallel_are_no_worse_than_a_guess(degrees):
    alone = dataclasses.replace(EVIDENCE, depth_error=0.0, mirror_probability=0.0, view_degrees=degrees)
    relief = min(0.002 / (0.8 * math.radians(degrees)), 0.6) if degrees else 0.6
    assert believed_degrees(alone).static == pytest.approx(angle(relief), rel=1e-9)


def test_the_best_depth_errs_by_two_percent_and_nothing_is_believed_beyond_thirty_degrees():
    perfect = DepthEvidence(0.8, 0.0, None, 0.002, 0.0, None)
    assert believed_degrees(perfect).static == pytest.approx(angle(0.02))
    assert believed_degrees(dataclasses.replace(perfect, focal=0.1)).static == 30


# ---- the evidence ------------------------------------------------------------------------------------------------------

FRAMES, WIDTH, HEIGHT = 3, 50, 38


@pytest.fixture
def priors():
    """Random depth with holes, confidence and mask; classical, from a moving camera."""
    rng = np.random.default_rng(0)
    made = Priors(WIDTH, HEIGHT, np.arange(FRAMES))
    intrinsics = np.tile(np.diag([45.0, 70, 1]), (FRAMES, 1, 1))
    intrinsics[0, 0, 0], intrinsics[2, 0, 0] = 40, 90  # median 45
    made.cameras = CameraPath(intrinsics, np.tile(np.eye(4), (FRAMES, 1, 1)), np.arange(3.0), WIDTH, HEIGHT)
    made.camera_kind, made.provenance["depth"] = "moving", {"provider": "classical"}
    made.depth = rng.uniform(1, 2, (FRAMES, HEIGHT, WIDTH)).astype(np.float32)
    made.depth[rng.random(made.depth.shape) < 0.3] = np.nan
    made.mask = rng.random(made.depth.shape) < 0.4
    made.depth_confidence = rng.uniform(0.1, 0.9, made.depth.shape).astype(np.float16)
    made.depth_confidence[~np.isfinite(made.depth)] = 0.01  # says nothing
    return made


def error_of(priors, moving, given=True):
    """Relative error at the median confidence `p / (p + 50)`, `p = 1 / error^2`, of every fourth pixel with depth."""
    found = []
    for frame in range(FRAMES):
        for row in range(0, HEIGHT, 4):
            for column in range(0, WIDTH, 4):
                at = frame, row, column
                if math.isfinite(priors.depth[at]) and (priors.mask is None or bool(priors.mask[at]) == moving):
                    found.append(float(priors.depth_confidence[at]) if given else 1.0)
    middle = float(np.median(found))
    return min(math.sqrt((1 - middle) / (50 * middle)), 0.6)


def test_evidence_is_the_median_of_every_fourth_pixel_with_depth(priors):
    evidence = depth_evidence(priors)
    assert evidence.focal == 45 / WIDTH
    assert evidence.depth_error == pytest.approx(error_of(priors, False), rel=1e-6)
    assert evidence.moving_error == 0.12 and evidence.view_degrees is None and evidence.mirror_probability == 0
    assert evidence.ray_noise == pytest.approx(0.4 * WIDTH / 480 / WIDTH)
    priors.provenance["depth"]["provider"] = "other"
    assert depth_evidence(priors).moving_error == pytest.approx(error_of(priors, True), rel=1e-6)
    priors.mask = None
    assert depth_evidence(priors).moving_error is None
    assert depth_evidence(priors).depth_error == pytest.approx(error_of(priors, False), rel=1e-6)
    priors.depth_confidence = None
    assert depth_evidence(priors).depth_error == 0


@pytest.mark.parametrize(("confidence", "error"), [(0.5, 0.02**0.5), (0.1, 0.18**0.5), (0.02, 0.6), (0.0, 0.6)])
def test_confidence_tells_the_error_of_depth_but_none_beyond_a_guess(priors, confidence, error):
    priors.depth_confidence = np.full(priors.depth.shape, confidence, np.float32)
    assert depth_evidence(priors).depth_error == pytest.approx(error, rel=1e-6)
    priors.depth[:] = np.nan
    assert depth_evidence(priors).depth_error == 0.6, "nothing known is a guess"
    assert depth_evidence(priors).moving_error is None


@pytest.mark.parametrize("missing", ["cameras", "depth", "tracks", "tracks_visible"])
def test_without_one_of_what_angles_are_made_from_there_are_none(priors, missing):
    priors.tracks, priors.tracks_visible = np.full((FRAMES, 9, 2), 10.0, np.float32), np.ones((FRAMES, 9), bool)
    assert len(viewing_angles.static_view_degrees(priors)) and depth_evidence(priors).view_degrees is not None
    setattr(priors, missing, None)
    assert not len(viewing_angles.static_view_degrees(priors))
    if missing in ("cameras", "depth"):
        assert depth_evidence(priors) is None
    else:
        assert depth_evidence(priors).view_degrees is None


def test_movers_count_by_what_decided_their_depth_half_of_them_worse(priors):
    noise = 0.4 / 480 / (45 / WIDTH)
    own = [{"decided_by": "its own motion", "emf_degrees": degrees} for degrees in (2.0, 0.01, 0.0)]
    named = [{"decided_by": name} for name in ("ground contact", "size", "surroundings", "something else")]
    for movers, expected in (
        (own[:1], noise / math.radians(2)),
        (own[1:2], 0.6),
        (own[2:], 0.12),  # no angle: by the ground, as if nothing were known
        (named[:2], 0.16),
        (named, 0.2),
        ([named[2], *own[:2]], 0.3),
    ):
        priors.statistics["depth"] = {"movers": movers}
        assert depth_evidence(priors).moving_error == pytest.approx(expected, rel=1e-9)


# ---- which way round ---------------------------------------------------------------------------------------------------


def way_round(priors, margin, **fields):
    priors.statistics["cameras"] = mirror(margin, **fields)
    return WayRound.of(priors)


@pytest.mark.parametrize(
    ("margin", "verdict"),
    [(4.61, "sure"), (4.6, "sure"), (4.59, "likely"), (1.1, "likely"), (1.09, "toss-up"), (-3.0, "toss-up")],
)
def test_the_verdict_follows_the_margin(priors, margin, verdict):
    way = way_round(priors, margin)
    assert way.verdict == verdict and way.margin == margin
    assert way.probability_wrong == pytest.approx(1 / (1 + math.exp(margin)), rel=1e-12)


@pytest.mark.parametrize(("verdict", "margin"), [("sure", 4.6), ("likely", 1.1), ("toss-up", 0.0)])
def test_a_margin_that_no_file_can_hold_is_that_of_its_verdict(priors, verdict, margin):
    way_round(priors, 9.0, verdict=verdict)
    priors.statistics["cameras"]["mirror"]["margin"] = None
    assert WayRound.of(priors).margin == margin


@pytest.mark.parametrize(
    ("margin", "words"),
    [
        (-2.0, "1.0 to 1"),
        (math.log(9.9), "9.9 to 1"),
        (math.log(10.1), "10 to 1"),
        (math.log(998), "998 to 1"),
        (math.log(999.5), "more than 1,000 to 1"),
    ],
)
def test_odds_are_the_exponential_of_the_margin(priors, margin, words):
    assert way_round(priors, margin).odds == words


def test_no_margin_is_too_large(priors):
    assert way_round(priors, 5000.0).probability_wrong == 0 and way_round(priors, -5000.0).probability_wrong == 1


def test_a_clue_without_a_number_says_nothing(priors):
    way = way_round(priors, 1.0, evidence=[{"what": "a"}, {"what": "b", "for": 0.5}, {"what": "c", "for": -0.7}])
    assert [(clue.what, clue.log_odds) for clue in way.clues] == [("c", -0.7), ("b", 0.5), ("a", 0.0)]


# ---- viewing angles ----------------------------------------------------------------------------------------------------


def between(a, b) -> float:
    """Degrees between two directions, exact for small angles too."""
    a, b = (np.asarray(v, float) / np.linalg.norm(v) for v in (a, b))
    return math.degrees(2 * math.atan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


def test_two_cameras_have_a_parallax_and_one_has_none(priors):
    priors.cameras.world_to_camera[2, :3, 3] = [0.3, -0.4, 0]
    assert parallax_degrees(priors) == pytest.approx(math.degrees(2 * math.atan(0.25)))
    path = priors.cameras
    for count, expected in ((2, 2 * math.atan(0.25)), (1, 0)):
        rows = slice(3 - count, 3)
        parts = {"intrinsics": path.intrinsics[rows], "world_to_camera": path.world_to_camera[rows]}
        priors.cameras = dataclasses.replace(path, **parts, times=path.times[rows])
        assert parallax_degrees(priors) == pytest.approx(math.degrees(expected))


def test_the_angular_factor_is_the_mean_speed_about_the_mean_point_at_depth_one():
    path = orbiting(np.array([0.0, 3, 9, 10]))
    path.world_to_camera[:, :3, 3] += np.random.default_rng(1).normal(0, 0.2, (4, 3))
    path = dataclasses.replace(path, times=np.array([0.0, 1, 4, 6]))
    centres = [-matrix[:3, :3].T @ matrix[:3, 3] for matrix in path.world_to_camera]
    axes = [matrix[2, :3] for matrix in path.world_to_camera]
    middle = np.mean([c + a for c, a in zip(centres, axes, strict=True)], axis=0)
    speeds = [between(middle - centres[t], middle - centres[t + 1]) / d for t, d in enumerate((1, 3, 2))]
    assert angular_factor(path, 24.0) == pytest.approx(24 * np.mean(speeds))


def test_speed_of_one_direction_of_two_and_of_rounded_ones():
    directions, times = np.random.default_rng(0).normal(size=(500, 3)), np.arange(0, 1000.0, 2)
    assert angular_speed(directions[:1], times[:1], 10.0) == 0
    expected = 10 * between(*directions[:2]) / 2
    assert angular_speed(directions[:2], times[:2], 10.0) == pytest.approx(expected)
    same, opposite = np.repeat(directions, 2, 0), np.repeat(directions, 2, 0)
    opposite[1::2] *= -1
    twice = np.arange(1000.0)
    expected = np.mean([between(a, b) for a, b in pairwise(same)])
    assert angular_speed(same, twice, 1.0) == pytest.approx(expected)
    assert np.isfinite(angular_speed(opposite, twice, 1.0))


def test_the_widest_of_all_pairs_of_visible_rays():
    rng = np.random.default_rng(2)
    rays, visible = rng.normal(size=(5, 40, 3)), rng.random((5, 40)) < 0.5
    visible[:, :3] = [[1, 1, 0], [1, 0, 0], [0] * 3, [0] * 3, [0] * 3]  # two, one, none
    rays[1, 0] = 2 * rays[0, 0]
    found = spanned_degrees(rays, visible)
    for p in range(40):
        seen = rays[visible[:, p], p]
        if len(seen) < 2:
            assert np.isnan(found[p])
        else:
            assert found[p] == pytest.approx(max(between(a, b) for a in seen for b in seen), abs=1e-5)
    many = rng.normal(size=(1, 500, 3))
    assert spanned_degrees(np.concatenate([many, -many]), np.ones((2, 500), bool)) == pytest.approx(180, abs=1e-5)


def angles_written_out(priors, step):
    """Degrees of each static track seen twice, every `step`-th: widest pair of rays to the median of its places."""
    found, path = [], priors.cameras
    seen_often = priors.tracks_visible.sum(0) >= 2
    motion = np.zeros(len(seen_often)) if priors.tracks_motion is None else priors.tracks_motion
    for track in np.flatnonzero((motion < 0.3) & seen_often)[::step]:
        frames, places, centres = np.flatnonzero(priors.tracks_visible[:, track]), [], []
        for t in frames:
            x, y = priors.tracks[t, track].astype(float)
            column, row = min(max(math.floor(x), 0), WIDTH - 1), min(max(math.floor(y), 0), HEIGHT - 1)
            z, matrix = float(priors.depth[t, row, column]), path.world_to_camera[t]
            local = np.linalg.inv(path.intrinsics[t]) @ [x, y, 1] * z
            centres.append(-matrix[:3, :3].T @ matrix[:3, 3])
            if math.isfinite(z):
                places.append(matrix[:3, :3].T @ local + centres[-1])
        if places:
            place = np.median(places, axis=0)
            found.append(max(between(place - a, place - b) for a in centres for b in centres))
    return found


@pytest.mark.parametrize(("most", "step"), [(1000, 1), (50, 1), (49, 2), (17, 3)])
def test_static_tracks_are_seen_under_the_widest_pair_of_rays_to_their_median_place(priors, monkeypatch, most, step):
    rng = np.random.default_rng(4)
    for t, matrix in enumerate(priors.cameras.world_to_camera):
        matrix[:3, 3] = [0.1 * t, -0.05 * t * t, 0.02 * t]
    count = 60
    priors.tracks = rng.uniform(-1, 1, (FRAMES, count, 2)) * [WIDTH / 2, HEIGHT / 2] + [WIDTH / 2, HEIGHT / 2]
    priors.tracks[0, :3] = [[WIDTH, 3], [5, HEIGHT], [-0.5, -0.5]]
    priors.tracks = priors.tracks.astype(np.float32)
    priors.tracks_visible = np.ones((FRAMES, count), bool)
    priors.tracks_visible[1:, 50:54] = False  # once
    priors.tracks_visible[2, 40:] = False  # twice
    priors.tracks_motion = np.zeros(count, np.float64)
    priors.tracks_motion[54:] = 0.3
    monkeypatch.setattr(viewing_angles, "MAX_POINTS", most)
    found = viewing_angles.static_view_degrees(priors)
    assert found == pytest.approx(angles_written_out(priors, step), abs=1e-4)
    priors.tracks_motion = None
    found = viewing_angles.static_view_degrees(priors)
    assert found == pytest.approx(angles_written_out(priors, -(-56 // most)), abs=1e-4), "all are taken for static"


def test_a_group_that_was_measured_once_spans_nothing():
    scaffold = node_scaffold(np.arange(8.0))
    once = dataclasses.replace(scaffold, certain=scaffold.certain & (np.arange(8) == 3)[:, None])
    (view,) = group_views(once, orbiting(3.0 * np.arange(8)), 24.0)
    assert (view.nodes, view.frames, view.degrees, view.degrees_per_second) == (4, 1, 0.0, 0.0)
    never = dataclasses.replace(scaffold, certain=np.zeros_like(scaffold.certain))
    (view,) = group_views(never, orbiting(3.0 * np.arange(8)), 24.0)
    assert (view.frames, view.degrees, view.degrees_per_second) == (0, None, None)
