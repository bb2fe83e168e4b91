"""Viewing angles, how far a view can be believed, and what the page says of the geometry."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import toy
from test_diagnostics import node_scaffold

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.metrics.believed import MAX_DEGREES, TOLERANCE, Believed, DepthEvidence, believed_degrees, depth_evidence
from f4x_core.metrics.viewing_angles import (
    angular_factor,
    group_views,
    parallax_degrees,
    spanned_degrees,
    static_view_degrees,
)
from f4x_core.metrics.way_round import WayRound
from f4x_core.report.advice import findings
from f4x_core.report.geometry_findings import ClipGeometry, about_geometry, believed_sentence
from f4x_core.report.geometry_section import _over_ground
from f4x_core.scaffold.groups import shape_change

CERTAIN = DepthEvidence(
    focal=1.0, depth_error=0.05, view_degrees=10.0, ray_noise=0.3 / 480, mirror_probability=0.0, moving_error=None
)
"""An ordinary clip with good cameras."""


@pytest.fixture
def priors():
    """Those of the toy clip."""
    return toy.clip_and_priors()[1]


def orbiting(degrees: np.ndarray) -> CameraPath:
    """Cameras on a circle of radius 1 about (0, 0, 1), looking at its middle."""
    matrices = np.tile(np.eye(4), (len(degrees), 1, 1))
    for matrix, angle in zip(matrices, np.radians(degrees), strict=True):
        right, forward = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
        matrix[:3, :3] = right, [0, 1, 0], forward
        matrix[:3, 3] = -matrix[:3, :3] @ (np.array([0, 0, 1.0]) - forward)
    intrinsics = np.tile(np.diag([60.0, 60, 1]), (len(degrees), 1, 1))
    return CameraPath(intrinsics, matrices, np.arange(len(degrees), dtype=float), 64, 40)


def mirror(margin: float, **fields) -> dict:
    """The camera stage's record of its decision."""
    evidence = [{"what": "sky", "for": -0.2, "detail": "<near>"}, {"what": "reprojection", "for": margin + 0.2}]
    return {"mirror": {"chosen": "as found", "margin": margin, "evidence": evidence} | fields}


def test_parallax_is_the_angle_at_the_median_depth(priors):
    baseline = 0.02 * (toy.FRAMES - 1)
    assert parallax_degrees(priors) == pytest.approx(np.degrees(2 * np.arctan(baseline / 2)))
    priors.cameras = None
    assert parallax_degrees(priors) == 0.0


def test_angular_factor_of_a_steady_orbit_is_its_speed():
    assert angular_factor(orbiting(np.arange(0, 21, 2.0)), fps=24.0) == pytest.approx(2.0 * 24)
    uneven = replace(orbiting(np.array([0.0, 2, 6])), times=np.array([0.0, 1, 3]))
    assert angular_factor(uneven, fps=10.0) == pytest.approx(20.0)  # a held-out frame between the last two
    assert angular_factor(orbiting(np.zeros(4)), fps=24.0) == pytest.approx(0, abs=1e-4)


def test_the_widest_pair_of_rays_counts_not_the_first_and_last():
    path = orbiting(np.array([0.0, 12, 3]))
    rays = np.array([0, 0, 1.0]) - path.centers[:, None]
    every = np.ones((3, 1), bool)
    assert spanned_degrees(rays, every)[0] == pytest.approx(12)
    assert spanned_degrees(rays, np.array([[True], [False], [True]]))[0] == pytest.approx(3)
    assert np.isnan(spanned_degrees(rays, np.array([[True], [False], [False]]))[0])


def test_static_points_are_seen_under_the_angle_of_the_path(priors):
    angles = static_view_degrees(priors)
    longest = np.degrees(2 * np.arctan(0.02 * (toy.FRAMES - 1) / 2 / toy.WALL))
    assert 0.9 * longest < angles.max() <= longest + 0.01  # by a point between the outermost cameras
    priors.cameras = replace(priors.cameras, world_to_camera=np.tile(np.eye(4), (toy.FRAMES, 1, 1)))
    assert static_view_degrees(priors).max() < 0.01
    priors.tracks = None
    assert not len(static_view_degrees(priors))


def test_a_thing_that_turns_before_a_standing_camera_is_seen_from_many_sides():
    times = np.arange(8.0)
    scaffold = node_scaffold(times)
    standing = orbiting(np.zeros(8))
    middle = scaffold.xyz.mean(1, keepdims=True)
    turn = quaternion.from_rotation_vector(np.outer(np.radians(3 * times), [0, 1.0, 0]))
    turned = middle + quaternion.rotate(turn[:, None], scaffold.xyz[:1] - middle[:1])
    sliding = replace(scaffold, xyz=(scaffold.xyz - middle + [0, 0, 1.0]).astype(np.float32))
    turning = replace(scaffold, xyz=(turned - middle + [0, 0, 1.0]).astype(np.float32))
    (still,) = group_views(sliding, standing, 24.0)
    (round_,) = group_views(turning, standing, 24.0)
    assert still.degrees < 0.1 and still.nodes == 4 and still.frames == 8
    assert round_.degrees == pytest.approx(21, abs=0.2) and round_.degrees_per_second == pytest.approx(72, rel=0.01)
    (around,) = group_views(sliding, orbiting(3 * times), 24.0)
    assert around.degrees == pytest.approx(21, abs=0.2)  # the camera that turns about it sees the same


def test_groups_that_no_edge_joins_are_seen_each_for_itself():
    scaffold = node_scaffold(np.arange(8.0))
    alone = scaffold.neighbours.copy()
    alone[3], alone[:3] = 3, np.arange(3)[:, None]
    alone[:3, 1] = (1, 2, 0)
    views = group_views(replace(scaffold, neighbours=alone), orbiting(3.0 * np.arange(8)), 24.0)
    assert [view.nodes for view in views] == [3, 1]
    assert views[0].degrees is None, "three nodes turn by their noise"


def test_what_changes_its_shape_has_no_viewing_angle():
    scaffold = node_scaffold(np.arange(8.0))
    noise = np.random.default_rng(0).normal(scale=0.1, size=scaffold.xyz.shape)
    wobbling = replace(scaffold, xyz=(scaffold.xyz + noise).astype(np.float32))
    assert np.median(shape_change(wobbling.xyz)) > 0.5 and shape_change(scaffold.xyz).max() < 1e-5
    (view,) = group_views(wobbling, orbiting(3.0 * np.arange(8)), 24.0)
    assert view.degrees is None and view.frames == 8


def test_frames_without_a_measured_node_do_not_count():
    scaffold = node_scaffold(np.arange(8.0))
    hidden = replace(scaffold, certain=scaffold.certain & (np.arange(8) < 3)[:, None])
    (view,) = group_views(hidden, orbiting(3.0 * np.arange(8)), 24.0)
    (whole,) = group_views(scaffold, orbiting(3.0 * np.arange(8)), 24.0)
    assert view.frames == 3 and view.degrees < 0.5 * whole.degrees


def test_believed_angle_displaces_by_the_tolerance():
    believed = believed_degrees(replace(CERTAIN, view_degrees=None))
    assert np.tan(np.radians(believed.static)) * 0.05 == pytest.approx(TOLERANCE)
    assert believed.moving is None
    longer = believed_degrees(replace(CERTAIN, view_degrees=None, focal=2.0))
    assert np.tan(np.radians(longer.static)) == pytest.approx(np.tan(np.radians(believed.static)) / 2)


@pytest.mark.parametrize(
    "worse",
    [{"depth_error": 0.3}, {"view_degrees": 0.3}, {"ray_noise": 5 / 480}, {"mirror_probability": 0.4}, {"focal": 2.0}],
)
def test_weaker_evidence_believes_less(worse):
    assert believed_degrees(replace(CERTAIN, **worse)).static < 0.8 * believed_degrees(CERTAIN).static


@pytest.mark.parametrize("touches", [(True, False, True), (False, False, False)])
def test_the_page_plots_movers_over_the_ground(touches):
    """Of an older scene, whose priors do not know it, there is no plot."""
    path = {"seen": [4, 5, 7], "depth": [1.0, 1.1, 1.2], "ground": [1.0, None, 1.2], "touches": list(touches)}
    drawn = _over_ground({"group": 3, "over_time": path})
    assert drawn.startswith("<svg") and "moving object 3" in drawn
    assert ("touches the ground" in drawn) == any(touches)
    assert _over_ground({"group": 3}) == ""


def test_movers_are_believed_no_further_than_the_world_they_stand_in():
    good = believed_degrees(replace(CERTAIN, moving_error=0.01))
    poor = believed_degrees(replace(CERTAIN, moving_error=0.3))
    assert good.moving == good.static and poor.moving < 0.3 * poor.static
    toss = believed_degrees(replace(CERTAIN, mirror_probability=0.5, moving_error=0.01))
    assert toss.moving == toss.static < 1
    assert believed_degrees(replace(CERTAIN, depth_error=0.0, view_degrees=None)).static < MAX_DEGREES


def test_evidence_is_gathered_from_the_priors(priors):
    evidence = depth_evidence(priors)
    assert evidence.depth_error == 0 and evidence.view_degrees is None and evidence.mirror_probability == 0
    assert evidence.focal == pytest.approx(toy.FOCAL / toy.WIDTH) and evidence.moving_error == 0
    priors.provenance["depth"] = {"provider": "classical"}
    priors.depth_confidence = np.where(priors.mask, 0.2, 0.5).astype(np.float16)
    priors.statistics["cameras"] = mirror(1.0) | {"reprojection_px": {"median": 0.25}}
    evidence = depth_evidence(priors)
    assert evidence.depth_error == pytest.approx((1 / 50) ** 0.5, rel=1e-3)
    assert evidence.moving_error == 0.12  # ground contact: confidence is no precision there
    assert evidence.view_degrees == pytest.approx(np.median(static_view_degrees(priors)))
    assert evidence.ray_noise == pytest.approx(0.25 / toy.WIDTH)
    assert evidence.mirror_probability == pytest.approx(1 / (1 + np.e))
    priors.statistics["depth"] = {"movers": [{"group": 0, "frames": [0, 7], "decided_by": "surroundings"}]}
    assert depth_evidence(priors).moving_error == pytest.approx(0.3)
    priors.statistics["depth"]["movers"][0] |= {"decided_by": "its own motion", "emf_degrees": 5.0}
    expected = evidence.ray_noise / (evidence.focal * np.radians(5.0))
    assert depth_evidence(priors).moving_error == pytest.approx(expected)
    priors.provenance["depth"], priors.statistics["depth"] = {"provider": "depth-anything"}, {}
    assert depth_evidence(priors).moving_error == pytest.approx((4 / 50) ** 0.5, rel=1e-2)
    priors.cameras = None
    assert depth_evidence(priors) is None


@pytest.mark.parametrize(
    ("believed", "words"),
    [
        (Believed(12.3, None), "within about 12° of the camera's path."),
        (Believed(12.3, 12.1), "within about 12° of the camera's path."),
        (Believed(12.3, 3.0), "12° of the camera's path, moving objects within about 3° of it."),
        (Believed(12.3, 0.4), "moving objects on the path alone."),
        (Believed(0.6, 0.1), "along the camera's own path only"),
        (Believed(0.99, None), "along the camera's own path only"),
        (Believed(1.0, None), "within about 1° of the camera's path."),
        (Believed(12.5, 12.0), "12° of the camera's path, moving objects within about 12° of it."),
        (Believed(12.5, 12.01), "within about 12° of the camera's path."),
        (Believed(12.5, 1.0), "moving objects within about 1° of it."),
        (Believed(12.5, 0.99), "moving objects on the path alone."),
    ],
)
def test_believed_in_words(believed, words):
    assert words in believed_sentence(believed)


@pytest.mark.parametrize(
    ("margin", "verdict", "weight", "words"),
    [
        (6.0, "sure", "good", "Near and far are the right way round: 403 to 1"),
        (2.0, "likely", "note", "probably the right way round (7.4 to 1)"),
        (0.1, "toss-up", "problem", "Near and far may be exchanged"),
        (20.0, "sure", "good", "more than 1,000 to 1"),
    ],
)
def test_the_way_round_is_said_first(margin, verdict, weight, words, priors):
    priors.statistics["cameras"] = mirror(margin)
    found = findings(priors, None, {"used_psnr": 20.0})
    equal = [finding for finding in found if finding.weight == weight]
    assert words in equal[0].what and WayRound.of(priors).verdict == verdict
    assert ("--prior cameras=FILE" in equal[0].advice) == (verdict != "sure")


def test_the_recorded_verdict_wins_and_evidence_is_sorted(priors):
    assert WayRound.of(priors) is None
    priors.statistics["cameras"] = mirror(5.0, verdict="likely", chosen="mirrored")
    way = WayRound.of(priors)
    assert (way.verdict, way.chosen) == ("likely", "mirrored")
    assert [clue.what for clue in way.clues] == ["reprojection", "sky"]
    assert way.clues[0].detail == "" and way.clues[1].log_odds == -0.2
    priors.statistics["cameras"] = mirror(5.0, verdict="sure")
    priors.statistics["cameras"]["mirror"]["margin"] = None  # infinity, from a file
    assert WayRound.of(priors).probability_wrong < 0.011


def test_measures_need_no_torch():
    code = "import sys; sys.modules['torch'] = None; import f4x_core.report.geometry_findings"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_small_step_and_the_origin_of_depth_are_noted(priors):

    def notes() -> str:
        return " ".join(finding.what for finding in findings(priors, None, {}) if finding.weight == "note")

    priors.statistics["cameras"] = {"translation": {"verdict": "small", "size_px": 1.25}}
    priors.statistics["depth"] = {"movers": [{"decided_by": name} for name in ("size", "size", "surroundings")]}
    assert "moves the picture by only 1.2 px" in notes()
    assert "The depth of what moves is a guess from how its size changes (2), its surroundings" in notes()
    priors.statistics["depth"] = {"movers": [{"decided_by": "ground contact", "group": 0}]}
    assert "The depth of what moves is a guess from where it touches the ground." in notes()
    priors.statistics["depth"] = {
        "movers": [{"decided_by": name} for name in ("size", "its own motion", "its own motion")]
    }
    assert "is a guess from how its size changes (1), and measured by its own motion (2)." in notes()
    priors.statistics["depth"] = {"movers": [{"decided_by": "its own motion"}]}
    assert "The depth of what moves is measured by its own motion." in notes() and "guess" not in notes()


def resting(jumps: dict[int, float], drift: float = 0.0):
    """Priors of a camera whose picture rests (or drifts by pixels a frame) and is off by some pixels in some frames."""
    _, priors = toy.clip_and_priors(frames=20)
    shift = np.array([drift * frame + jumps.get(frame, 0.0) for frame in range(20)])
    place = np.random.default_rng(0).uniform(5, 35, (40, 2))
    priors.tracks = (place[None] + shift[:, None, None] * [1.0, 0.0]).astype(np.float32)
    priors.tracks_visible, priors.tracks_motion = np.ones((20, 40), bool), np.zeros(40, np.float32)
    return priors


@pytest.mark.parametrize(
    ("jumps", "words"),
    [
        ({7: 15.0, 8: -5.0}, "bumped between frames 7 and 9: the picture jumps by up to 20 px"),
        ({frame: 4.0 for frame in range(12, 20)}, "bumped at frame 12: the picture jumps by up to 4 px"),
    ],
)
def test_a_bumped_tripod_is_named(jumps, words):
    assert words in " ".join(finding.what for finding in findings(resting(jumps), None, {}))


@pytest.mark.parametrize(
    "priors",
    [resting({}), resting({7: 0.2}), resting({7: 15.0}, drift=2.0), resting({f: 5.0 * (f % 2) for f in range(20)})],
    ids=["rests", "hardly", "is carried", "shakes"],
)
def test_no_other_camera_is_bumped(priors):
    assert "bumped" not in " ".join(finding.what for finding in findings(priors, None, {}))


def test_a_camera_that_is_only_assumed_to_stand_still_is_not_said_to_have_done_so(priors):
    priors.camera_kind, priors.statistics["cameras"] = "static", {"assumed": "too few points stand still"}
    message = " ".join(finding.what for finding in findings(priors, None, {}))
    assert (
        "How the camera moved is not known, because too few points stand still" in message
        and "The camera stood still" not in message
    )
    priors.statistics["cameras"] = {}
    assert "The camera stood still" in " ".join(finding.what for finding in findings(priors, None, {}))


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        (None, ("only the original view can be believed",)),
        (
            {"known": True, "people": True, "contacts": 57},
            ("a guess", "feet and the lowest points", "57 sightings", "° aside"),
        ),
        ({"known": True, "people": False, "contacts": 9}, ("where the lowest points of what moves touch it (9",)),
        ({"known": False, "people": False, "contacts": 0}, ("where it usually lies", "too little walks")),
    ],
)
def test_the_guess_before_a_standing_camera_is_told_with_what_it_rests_on(guess, words, priors):
    priors.camera_kind = "static"
    priors.statistics = {"cameras": {"standing": {"stands": True, "jitter_px": 1.7}}, "depth": {"guess": guess}}
    found = [finding for finding in findings(priors, None, {}) if "The camera stood still" in finding.what]
    assert len(found) == 1 and "half a metre" in found[0].advice and "1.7 px" in found[0].what
    assert all(word in found[0].what for word in words), found[0].what


@pytest.mark.parametrize(("share", "weight"), [(0.3, "good"), (0.7, "note")])
def test_a_path_that_rests_on_little_is_no_praise(share, weight, priors):
    priors.cameras, priors.statistics["cameras"] = (
        orbiting(np.linspace(0, 20, len(priors.frames))),
        {"static_tracks": 82},
    )
    priors.depth, priors.mask = np.ones_like(priors.depth), np.zeros_like(priors.mask)
    priors.mask[:, : int(share * priors.height)] = True
    found = {finding.what: finding.weight for finding in findings(priors, None, {})}
    assert [found[what] for what in found if "path spans" in what] == [weight]
    assert any("and the cameras rest on 82 points of it" in what for what in found) == (weight == "note")


def test_a_zoom_is_named_with_its_factor(priors):
    priors.camera_kind, priors.statistics["cameras"] = "pan", {"zoom": {"factor": 1.4}}
    named = [finding for finding in findings(priors, None, {}) if "zoomed" in finding.what]
    assert len(named) == 1 and "(1.40 times)" in named[0].what and "instead of zooming" in named[0].advice
    assert named[0].weight == "problem"


def weights_of(priors, words, **fields) -> list[str]:
    """Weights of the findings with `words`, where the geometry was measured otherwise."""
    geometry = replace(ClipGeometry.of(priors, None), **fields)
    return [finding.weight for finding in about_geometry(priors, geometry) if words in finding.what]


@pytest.mark.parametrize(
    ("believed", "weight"),
    [
        (Believed(10.0, None), "good"),
        (Believed(9.99, None), "note"),
        (Believed(12.0, 10.0), "good"),
        (Believed(12.0, 9.99), "note"),
    ],
)
def test_ten_degrees_of_everything_are_room_to_look_around(believed, weight, priors):
    assert weights_of(priors, "can be believed", believed=believed) == [weight]
    assert weights_of(priors, "can be believed", believed=None) == []


@pytest.mark.parametrize(
    ("degrees", "words", "weight"),
    [
        (1.99, "moved very little", "problem"),
        (2.0, "path spans 2°", "note"),
        (7.99, "path spans 8°", "note"),
        (8.0, "path spans 8°", "good"),
    ],
)
def test_a_path_is_judged_by_the_angle_that_it_spans(degrees, words, weight, priors):
    assert weights_of(priors, words, parallax=degrees, static_degrees=(3.3, 4.4)) == [weight]
    assert weights_of(priors, "seen from 3.3° (median)", parallax=degrees, static_degrees=(3.3, 4.4)) == [weight]


def test_what_is_measured_of_a_clip(priors):
    angles, scaffold = static_view_degrees(priors), node_scaffold(np.arange(float(toy.FRAMES)))
    geometry = ClipGeometry.of(priors, scaffold)
    assert geometry.static_degrees == pytest.approx((np.median(angles), np.percentile(angles, 90)))
    assert geometry.angular_factor == pytest.approx(angular_factor(priors.cameras, priors.fps))
    assert geometry.parallax == parallax_degrees(priors) and len(geometry.groups) == 1
    assert geometry.believed == believed_degrees(depth_evidence(priors))
    assert ClipGeometry.of(priors, None).groups == ()
    assert ClipGeometry.of(priors, node_scaffold(np.arange(5.0))).groups == ()
    priors.cameras = None
    geometry = ClipGeometry.of(priors, scaffold)
    assert geometry == ClipGeometry(None, 0.0, None, None, (), None)


def steps(count: int, *jumps: float) -> dict[int, float]:
    """Places of a picture that stays where it has jumped, one frame after the other, `count` frames before the end."""
    places = np.cumsum(jumps)
    return {20 - count + i: float(places[min(i, len(places) - 1)]) for i in range(count)}


@pytest.mark.parametrize(
    ("width", "jumps", "rest", "words"),
    [
        (480, steps(5, 3.01), 0.0, "bumped at frame 15: the picture jumps by up to 3 px"),
        (480, steps(5, 2.99), 0.0, ""),
        (960, steps(5, 6.02), 0.0, "bumped at frame 15: the picture jumps by up to 6 px"),
        (960, steps(5, 5.98), 0.0, ""),
        (480, steps(5, 9.0), 0.49, "bumped at frame 15"),
        (480, steps(5, 9.0), 0.51, ""),
        (480, steps(9, 5.0, 5.0, 6.0), 0.0, "bumped between frames 11 and 13: the picture jumps by up to 6 px"),
        (480, steps(9, 5.0, 5.0, 5.0, 5.0), 0.0, ""),  # 4 of 19 steps are no accident
    ],
)
def test_a_bump_is_a_jump_of_three_pixels_in_few_frames_of_a_picture_that_rests(width, jumps, rest, words):
    priors = resting(jumps, rest)
    priors.width, priors.depth = width, None
    found = " ".join(finding.what for finding in about_geometry(priors, ClipGeometry.of(priors, None)))
    assert (words or "bumped") in found if words else "bumped" not in found


def test_a_jump_is_the_median_of_the_static_tracks_that_both_frames_see():
    priors = resting({})
    priors.width, priors.depth = 480, None
    priors.tracks[10:, :17] += [30, 40]  # fewer than half
    priors.tracks[10:, 20:24] += 30  # seen in one frame of both alone
    priors.tracks_visible[10, 20:22], priors.tracks_visible[9, 22:24] = False, False
    priors.tracks_visible[3:5] = False  # nothing is seen there
    assert not weights_of(priors, "bumped")
    priors.tracks_visible[9, 30:] = False  # and now at least half of the others
    assert weights_of(priors, "bumped at frame 10: the picture jumps by up to 50 px") == ["problem"]
    priors.tracks_visible[:] = False
    assert not weights_of(priors, "bumped")


@pytest.mark.parametrize(
    ("kind", "verdict", "found"), [("moving", "small", 1), ("pan", "small", 0), ("moving", "x", 0)]
)
def test_a_small_shift_is_noted_where_the_camera_shifts(kind, verdict, found, priors):
    priors.camera_kind, priors.statistics["cameras"] = kind, {"translation": {"verdict": verdict}}
    assert len(weights_of(priors, "hardly")) == found
