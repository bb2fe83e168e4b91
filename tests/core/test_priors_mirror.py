"""Which way round: mirror images are other minima, and the world decides where errors do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr
from test_priors_cameras import FOCAL, HEIGHT, PRINCIPAL, WIDTH, clip_and_priors, observe, project

from f4x_core.geometry import quaternion
from f4x_core.priors import CamerasConfig, PriorsConfig, mirror
from f4x_core.priors.bundle import Bundle, BundleConfig, adjust, sighting_costs, total_cost
from f4x_core.priors.cameras import provide
from f4x_core.priors.mirror import Decision, DepthCues, Evidence, choose_orientation, mirrored
from f4x_core.priors.point_tracks import PointTracks
from f4x_core.progress import silent


def ground(travel=0.06, points=400, seed=0, frames=12):
    """A camera that hardly moves before a ground that is near below, and a wall behind it."""
    rng = np.random.default_rng(seed)
    s = np.linspace(-0.5, 0.5, frames)[:, None]
    center = s * np.array([travel, 0.1 * travel, 0.2 * travel])
    rotation = quaternion.to_matrix(quaternion.from_rotation_vector(s * np.array([0.02, 0.1, 0.0])))
    uv = rng.uniform([10, 10], [WIDTH - 10, HEIGHT - 10], (points, 2))
    depth = np.where(uv[:, 1] > 90, 0.8 * 90 / (uv[:, 1] - 60) * 1.0, 2.5)
    local = np.column_stack([(uv - PRINCIPAL) / FOCAL, np.ones(points)]) * depth[:, None]
    return Bundle(FOCAL, PRINCIPAL, rotation, center, local)


def ceiling(**changes):
    """`ground` upside down: nearer above, which is not usual."""
    upright, flip = ground(**changes), np.diag([1.0, -1.0, 1.0])
    rotation = flip @ upright.rotation @ flip
    return replace(upright, points=upright.points @ flip, rotation=rotation, center=upright.center @ flip)


def cues(tracks, visible, **more):
    return DepthCues(np.arange(len(tracks)), PointTracks.all_static(tracks, visible), **more)


def way_round(bundle, true):
    return spearmanr(bundle.local(observe(true))[:, 2], true.local(observe(true))[:, 2])[0]


def test_the_mirror_image_is_another_minimum_that_nearly_fits():
    true = ground()
    observations = observe(true, noise=0.2)
    other = adjust(mirrored(true), observations, BundleConfig(iterations=60))
    assert way_round(other, true) < -0.8
    assert np.median(other.errors(observations)) < 1.3 * np.median(true.errors(observations))
    back = adjust(mirrored(other), observations, BundleConfig(iterations=60))
    assert way_round(back, true) > 0.8


@pytest.mark.parametrize("start", ["right", "mirrored"])
def test_the_right_way_round_is_found_from_either_side(start):
    true = ground()
    tracks, visible = project(true, noise=0.2)
    observations = observe(true, noise=0.2)
    begun = true if start == "right" else adjust(mirrored(true), observations)
    decision = choose_orientation([begun], observations, BundleConfig(expected_focal=FOCAL), cues(tracks, visible))
    assert way_round(decision.bundle, true) > 0.8
    assert decision.verdict in ("likely", "sure")
    assert {item.what for item in decision.evidence} >= {"reprojection", "lower is nearer"}


def test_a_depth_prior_overrules_what_is_usual():
    """A ceiling: only the depth prior knows."""
    true = ceiling()
    tracks, visible = project(true, noise=0.2)
    depth = np.full((len(tracks), HEIGHT, WIDTH), np.nan, np.float32)
    for frame in range(len(tracks)):
        column, row = tracks[frame, visible[frame]].astype(int).T
        depth[frame, row, column] = (true.rotation[frame] @ (true.points - true.center[frame]).T)[2, visible[frame]]
    known = cues(tracks, visible, depth=depth)
    decision = choose_orientation([mirrored(true)], observe(true, noise=0.2), BundleConfig(expected_focal=FOCAL), known)
    assert way_round(decision.bundle, true) > 0.8
    assert next(item for item in decision.evidence if item.what == "depth prior").log_odds > 4


def test_a_mover_stands_on_what_is_near():
    true = ground()
    tracks, visible = project(true, noise=0.2)
    mask = np.zeros((len(tracks), HEIGHT, WIDTH), bool)
    mask[:, 60:120, 140:180] = True
    known = cues(tracks, visible, mask=mask)
    decision = choose_orientation([true], observe(true, noise=0.2), BundleConfig(expected_focal=FOCAL), known)
    assert next(item for item in decision.evidence if item.what == "movers stand in front").log_odds > 0.5


@pytest.mark.parametrize(("margin", "verdict"), [(5.0, "sure"), (-5.0, "toss-up"), (2.0, "likely"), (0.4, "toss-up")])
def test_verdicts_follow_the_margin(margin, verdict):
    decision = Decision(ground(), True, (Evidence("reprojection", margin - 1, ""), Evidence("depth prior", 1.0, "")))
    assert decision.verdict == verdict
    assert decision.summary()["margin"] == pytest.approx(margin)


def test_a_small_step_beside_a_turn_is_no_pan_and_its_depth_is_found():
    true = ground(travel=0.1)
    tracks, visible = project(true, noise=0.05)
    clip, priors = clip_and_priors(tracks, visible)
    provide(clip, priors, PriorsConfig(), silent)
    statistics = priors.statistics["cameras"]
    assert priors.camera_kind == "moving" and statistics["solver"] == "direct"
    assert statistics["translation"]["verdict"] == "small"
    assert statistics["mirror"]["verdict"] in ("likely", "sure")
    turn = priors.cameras.world_to_camera[:, :3, :3]
    found = Bundle(1.0, PRINCIPAL, turn, priors.cameras.centers, true.points)
    steps = np.diff(found.center, axis=0)
    straight = np.diff(true.center, axis=0) @ true.rotation[0].T
    cosine = (steps * straight).sum(1) / np.linalg.norm(steps, axis=1) / np.linalg.norm(straight, axis=1)
    assert np.median(cosine) > 0.95, "the path leads the way that it led, not its mirror image's"


def test_every_solver_goes_through_the_comparison():
    true = ground(travel=0.8)
    tracks, visible = project(true, noise=0.1)
    clip, priors = clip_and_priors(tracks, visible)
    provide(clip, priors, PriorsConfig(cameras=CamerasConfig(solver="tracks")), silent)
    assert priors.statistics["cameras"]["solver"] == "tracks"
    assert priors.statistics["cameras"]["mirror"]["verdict"] == "sure"


def test_believed_focal_length_costs_what_it_should():
    true = ground()
    observations = observe(true, noise=0.2)
    plain = total_cost(true, observations, BundleConfig())
    bare = [sighting_costs(true, observations, BundleConfig(expected_focal=far)) for far in (FOCAL, 2 * FOCAL)]
    assert (bare[0] == bare[1]).all() and bare[0].mean() < plain
    believed = total_cost(true, observations, BundleConfig(expected_focal=FOCAL))
    doubted = total_cost(true, observations, BundleConfig(expected_focal=2 * FOCAL))
    assert believed == pytest.approx(plain)
    assert 1.05 * plain < doubted < 1.3 * plain


def test_a_clear_order_from_top_to_bottom_says_more_than_in_proportion():
    """r (1 + 1.5 r^2) of the rank correlation of row and nearness."""
    true = ground()
    for one, sign in ((true, 1), (ceiling(), -1)):
        found = mirror._lower_is_nearer(one, observe(one))
        order = [
            spearmanr(seen.uv[:, 1], 1 / one.local(seen)[:, 2])[0]
            for seen in (observe(one).keep(observe(one).frame == frame) for frame in range(len(one.center)))
        ]
        assert sign * np.mean(order) > 0.5
        assert found == pytest.approx(np.mean(order) * (1 + 1.5 * np.mean(order) ** 2))
    flat = replace(true, points=true.points / true.points[:, 2:] * 2)
    assert abs(mirror._lower_is_nearer(flat, observe(flat))) < 0.6


def test_lost_tracks_have_no_say_about_a_depth_prior():
    """Places of lost tracks are NaN, though their points are known from other frames."""
    tracks = np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], (3, 60, 2))
    depth = 1 + np.arange(HEIGHT)[:, None] * np.ones(WIDTH)
    inverse = 1 / depth[tracks[..., 1].astype(int), tracks[..., 0].astype(int)]
    tracks[0, ::3] = np.nan
    prior = np.tile(depth, (3, 1, 1))
    found = mirror._agrees_with_prior(
        mirror._TrackDepths(inverse), cues(tracks, np.isfinite(tracks[..., 0]), depth=prior)
    )
    assert found == pytest.approx(1)
