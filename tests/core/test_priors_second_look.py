"""What passed for moving and is explained by points that stand still, on made-up cameras and tracks and on a walk past a wall."""

import numpy as np
import pytest

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig, TracksConfig, cameras, flow, motion, points, second_look, tracks
from f4x_core.progress import silent

from .warped_clip import walk_past_a_wall

FRAMES, HEIGHT, WIDTH, FOCAL = 16, 120, 160, 150.0


def path(frames=FRAMES):
    """A camera that walks ahead, sways and turns."""
    t = np.arange(frames)
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.0, 1.0, 0.0]) * 0.02 * t[:, None]))
    centre = np.stack([0.05 * np.sin(t), 0.03 * np.sin(1.7 * t), 0.08 * t], 1)
    pose = np.tile(np.eye(4), (frames, 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = turn, -np.einsum("fij,fj->fi", turn, centre)
    lens = np.tile(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]), (frames, 1, 1))
    return CameraPath(lens, pose, t.astype(float), WIDTH, HEIGHT)


def seen_by(cams, world):
    """(F,n,2) pixels of the points (F,n,3), and their depth (F,n)."""
    local = np.einsum("fij,fnj->fni", cams.world_to_camera[:, :3, :3], world) + cams.world_to_camera[:, None, :3, 3]
    return local[..., :2] / local[..., 2:] * FOCAL + (WIDTH / 2, HEIGHT / 2), local[..., 2]


@pytest.fixture
def passing(monkeypatch):
    """Priors whose mask holds a near wall (its left part) and something that walks (its right part), with tracks on both."""
    # Flow says nothing here: tracks decide.
    monkeypatch.setattr(second_look, "long_flows", lambda *given: {})
    monkeypatch.setattr(
        second_look, "flow_beyond_cameras", lambda cameras, mask, *more: np.ones_like(mask[:, ::4, ::4], float)
    )
    rng, cams = np.random.default_rng(0), path()
    near = np.tile(
        np.stack([rng.uniform(-1.4, -0.6, 60), rng.uniform(-0.5, 0.5, 60), rng.uniform(2.2, 3, 60)], 1), (FRAMES, 1, 1)
    )
    walker = np.tile(
        np.stack([rng.uniform(0.5, 1.2, 60), rng.uniform(-0.6, 0.6, 60), np.full(60, 4.0)], 1), (FRAMES, 1, 1)
    )
    walker[..., 0] += 0.1 * np.sin(0.5 * np.arange(FRAMES))[:, None]
    uv, _ = seen_by(cams, np.concatenate([near, walker], 1))
    uv += rng.normal(0, 0.3, uv.shape)
    visible = ((uv > 0) & (uv < (WIDTH, HEIGHT))).all(-1)
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    for t in range(FRAMES):
        for column, row in np.floor(uv[t, visible[t]]).astype(int):
            mask[t, max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = True
    priors = Priors(WIDTH, HEIGHT, np.arange(FRAMES), mask=mask, motion=mask.astype(np.float16), cameras=cams)
    priors.tracks, priors.tracks_visible = np.where(visible[..., None], uv, np.nan).astype(np.float32), visible
    priors.tracks_motion = np.ones(120, np.float32)
    return priors


def test_points_are_those_that_tracks_show(passing):
    cams = path()
    truth = np.array([[-0.5, 0.2, 3.0], [0.6, -0.3, 5.0], [0.0, 0.0, -4.0]])
    uv, depth = seen_by(cams, np.tile(truth, (FRAMES, 1, 1)))
    seen = np.ones((FRAMES, 3), bool)
    seen[4:9, 1] = False
    found = points.fit_points(cams, uv, seen)
    assert (found.rms[:2] < 1e-6).all() and np.isinf(found.rms[2])  # behind the cameras that saw it
    front = found.point < 2
    np.testing.assert_allclose(found.z[front], depth[found.frame, found.point][front], rtol=1e-6)
    shaken = uv + np.array([1.5, 0.0]) * (-1.0) ** np.arange(FRAMES)[:, None, None]
    assert points.fit_points(cams, shaken, seen).rms[0] == pytest.approx(1.5, abs=0.2)
    unseen = points.fit_points(cams, uv, seen & (np.arange(3) != 0))
    assert np.isinf(unseen.rms[0]) and unseen.inverse_depth[0] == 0
    assert found.inverse_depth[0] == pytest.approx((1 / depth[:, 0]).mean(), rel=1e-6)


def test_sightings_that_slipped_move_no_point_when_they_count_less(passing):
    cams, truth = path(), np.array([[-0.5, 0.2, 3.0], [0.6, -0.3, 5.0]])
    uv, _ = seen_by(cams, np.tile(truth, (FRAMES, 1, 1)))
    uv[FRAMES - 4 :, 0, 0] += 12.0
    seen = np.ones((FRAMES, 2), bool)
    plain, robust = points.fit_points(cams, uv, seen), points.fit_points(cams, uv, seen, rounds=second_look.ROUNDS)
    assert plain.rms_of_nearest(second_look.MOST)[0] > 1 > 0.1 > robust.rms_of_nearest(second_look.MOST)[0]
    np.testing.assert_allclose(plain.rms_of_nearest(1.0), plain.rms)
    for k in range(2):
        errors = np.sort(plain.error[plain.point == k])[: int(np.ceil(0.6 * FRAMES))]
        assert plain.rms_of_nearest(0.6)[k] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert np.isinf(points.fit_points(cams, uv, seen & False).rms_of_nearest(0.5)).all()


def test_what_one_point_explains_is_taken_out_and_the_rest_stays(passing, monkeypatch):
    asked = {}
    monkeypatch.setattr(second_look, "densify", lambda *given, known: asked.update(known=known))
    before = passing.mask.copy()
    fraction = second_look.release_static(None, passing, PriorsConfig(), silent)
    left = np.arange(WIDTH) < WIDTH / 2 - 8
    assert passing.mask[before & left].mean() < 0.02
    assert passing.mask[before & ~left].mean() > 0.98
    assert fraction == pytest.approx(1 - passing.mask.sum() / before.sum())
    assert not passing.motion[before & ~passing.mask].any() and (passing.motion[passing.mask] == 1).all()
    assert set(asked["known"]) <= set(range(60)) and len(asked["known"]) > 50
    assert passing.statistics["motion"] == {"share": pytest.approx(passing.mask.mean()), "moving": True}
    assert not passing.warnings


def test_where_everything_stands_still_nothing_is_left_and_it_says_so(passing, monkeypatch):
    monkeypatch.setattr(second_look, "densify", lambda *given, known: None)
    passing.tracks, passing.tracks_visible = passing.tracks[:, :60], passing.tracks_visible[:, :60]
    passing.tracks_motion = passing.tracks_motion[:60]
    passing.mask[..., WIDTH // 2 :] = False
    assert second_look.release_static(None, passing, PriorsConfig(), silent) == 1.0
    assert not passing.mask.any() and not passing.statistics["motion"]["moving"]
    assert any("Nothing in this clip moves" in line for line in passing.warnings)


@pytest.mark.parametrize("case", ["given", "walker", "short", "distant"])
def test_nothing_is_taken_out_without_proof(passing, case):
    if case == "given":
        passing.provenance["mask"] = {"provider": "user"}
    elif case == "walker":  # nothing else is left
        passing.tracks, passing.tracks_visible = passing.tracks[:, 60:], passing.tracks_visible[:, 60:]
        passing.tracks_motion = passing.tracks_motion[60:]
    elif case == "short":
        passing.tracks_visible[second_look.MIN_FRAMES - 1 :] = False
    else:  # a camera that hardly moves shows no parallax
        pose = passing.cameras.world_to_camera.copy()
        pose[:, :3, 3] *= 1e-4
        passing.cameras = CameraPath(passing.cameras.intrinsics, pose, passing.cameras.times, WIDTH, HEIGHT)
        still = np.tile(np.random.default_rng(1).uniform((-1, -1, 3), (1, 1, 5), (120, 3)), (FRAMES, 1, 1))
        passing.tracks = (
            seen_by(passing.cameras, still)[0] + np.random.default_rng(2).normal(0, 0.3, (FRAMES, 120, 2))
        ).astype(np.float32)
    before = passing.mask
    assert second_look.release_static(None, passing, PriorsConfig(), silent) == 0
    assert passing.mask is before


def test_a_point_that_explains_an_even_walk_within_pixels_is_no_proof(passing):
    """Some point explains what walks evenly past the camera, but less nearly than those of the background are explained."""
    rng = np.random.default_rng(3)
    passing.tracks[:, :60] += rng.normal(0, 1.15, (FRAMES, 60, 2))
    assert second_look._stands_still(passing, np.arange(60)).mean() > 0.8
    still = np.tile(rng.uniform((-1, -1, 3), (1, 1, 5), (80, 3)), (FRAMES, 1, 1))
    uv = (seen_by(passing.cameras, still)[0] + rng.normal(0, 0.2, (FRAMES, 80, 2))).astype(np.float32)
    passing.tracks = np.concatenate([passing.tracks, uv], 1)
    passing.tracks_visible = np.concatenate([passing.tracks_visible, np.ones((FRAMES, 80), bool)], 1)
    passing.tracks_motion = np.append(passing.tracks_motion, np.zeros(80, np.float32))
    assert second_look._stands_still(passing, np.arange(60)).mean() < 0.1


def test_tracks_that_slip_stand_still_but_not_in_the_lens(passing):
    """There three quarters of the sightings of whatever passes meet some point."""
    passing.tracks[FRAMES - 3 :] += 12.0
    slipped = np.flatnonzero(passing.tracks_visible[FRAMES - 3 :, :60].any(0))
    assert second_look._stands_still(passing, slipped).mean() > 0.8
    pose = passing.cameras.world_to_camera.copy()
    pose[:, :3, 3] /= 20  # the same pictures of a world that is so much smaller: depths of 2 to 3 become .1 to .15
    passing.cameras = CameraPath(passing.cameras.intrinsics, pose, passing.cameras.times, WIDTH, HEIGHT)
    assert not second_look._stands_still(passing, slipped).any()


@pytest.mark.parametrize(("step", "joins"), [(0.1, True), (0.0, False)])
def test_who_walks_joins_the_mask_however_small_and_who_stands_does_not(passing, monkeypatch, step, joins):
    """Nothing of a person of twelve pixels is in the mask."""
    monkeypatch.setattr(second_look, "densify", lambda *given, **named: None)
    rng, (uv, _) = np.random.default_rng(1), walk_of(step)
    joints = np.concatenate([uv + rng.normal(0, 0.3, uv.shape), np.ones((*uv.shape[:2], 1))], 2)
    passing.people_joints = joints[:, None].astype(np.float32)
    passing.people = np.zeros(passing.mask.shape, np.uint8)
    for t, (column, row) in enumerate(np.floor(uv.mean(1)).astype(int)):
        passing.people[t, row - 5 : row + 6, column - 2 : column + 3] = 1
    passing.people_probability = passing.people.astype(np.float16)
    passing.mask[:], passing.motion[:] = False, 0
    assert second_look.release_static(None, passing, PriorsConfig(), silent) == 0
    np.testing.assert_array_equal(passing.mask, passing.people == 1 if joins else np.zeros_like(passing.mask))
    assert (passing.motion > 0.5).any() == joins


def walk_of(step):
    """Pixels (F,33,2) and depth of a body 1 m high, 12 m away, that goes up and to and fro by `step` metres a frame."""
    rng, t = np.random.default_rng(0), np.arange(FRAMES)
    rest = np.stack([rng.uniform(-0.2, 0.2, 33), rng.uniform(-0.5, 0.5, 33), np.full(33, 12.0)], 1)
    way = step * np.stack([4 * np.sin(0.5 * t), 0.5 * t, 0 * t], 1)
    return seen_by(path(), rest + way[:, None])


def test_what_flow_explains_is_taken_out_where_no_track_lasts(passing, monkeypatch):
    monkeypatch.setattr(second_look, "densify", lambda *given, known: None)
    passing.tracks_visible[second_look.MIN_FRAMES - 1 :] = False
    before = np.zeros_like(passing.mask)
    before[:, 20:60, 20:60] = before[:, 20:60, 90:140] = True
    passing.mask, beyond = before.copy(), np.ones((FRAMES, HEIGHT // 4, WIDTH // 4), np.float32)
    beyond[..., : WIDTH // 8] = second_look.OWN_MOTION - 0.1
    monkeypatch.setattr(second_look, "flow_beyond_cameras", lambda *given: beyond)
    assert second_look.release_static(None, passing, PriorsConfig(), silent) == pytest.approx(40 / 90)
    half = np.arange(WIDTH) < WIDTH / 2
    assert not passing.mask[..., half].any() and (passing.mask == before)[..., ~half].all()
    passing.mask = before
    beyond[..., 5:] = 1.0  # next to nothing: not worth new tracks
    assert second_look.release_static(None, passing, PriorsConfig(), silent) == 0 and passing.mask is before


@pytest.mark.parametrize(
    ("provider", "rows", "doubted"),
    [("user", slice(None), False), ("classical", slice(None), True), ("classical", slice(50, 70), False)],
)
def test_a_mask_that_fills_the_border_is_in_doubt(passing, provider, rows, doubted):
    passing.provenance["mask"] = {"provider": provider}
    passing.mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    passing.mask[:, rows, :60] = True
    assert second_look.mask_in_doubt(passing) == doubted


@pytest.mark.slow
def test_a_wall_that_a_walking_camera_passes_stands_still():
    clip, man, wall = walk_past_a_wall()
    priors, config = Priors.empty(clip), PriorsConfig(tracks=TracksConfig(count=4000))
    for stage in (flow, tracks, motion):
        stage.provide(clip, priors, config, silent)
    assert priors.mask[wall].mean() > 0.5  # pairs of pictures cannot tell
    cameras.provide(clip, priors, config, silent)
    assert priors.camera_kind == "moving"
    assert priors.mask[wall].mean() < 0.35 and priors.mask[man].mean() > 0.95
    assert priors.statistics["cameras"]["released"] > 0.2
    priors.validate()


def test_what_rests_at_first_and_moves_later_is_joined_to_the_mask(passing, monkeypatch):
    """The walker was not seen to move in the first frames; its tracks are those that move later. The wall stands."""
    whole, made_anew = passing.mask.copy(), []
    monkeypatch.setattr(second_look, "densify", lambda *given: made_anew.append(given))
    passing.tracks_motion = np.repeat(np.float32([0.0, 1.0]), 60)
    wall = np.zeros_like(whole)
    for t in range(FRAMES):
        for column, row in np.floor(passing.tracks[t, :60][passing.tracks_visible[t, :60]]).astype(int):
            wall[t, max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = True
    passing.mask = whole & ~wall
    passing.mask[:6] = False
    passing.motion = passing.mask.astype(np.float16)
    fraction = second_look.join_resting(None, passing, PriorsConfig(), silent)
    assert 0.3 < fraction < 2 and len(made_anew) == 1
    walker = whole & ~wall
    assert passing.mask[:6][walker[:6]].mean() > 0.8 and passing.mask[wall & ~walker].mean() < 0.1
    assert (passing.motion[passing.mask] >= second_look.JOINED_MOTION).all()


def test_holes_are_filled_where_nothing_in_them_stands():
    mask = np.zeros((60, 80), bool)
    mask[10:50, 10:70] = True
    mask[20:30, 20:30] = mask[20:30, 50:60] = False
    votes = np.zeros(mask.shape, np.float32)
    votes[24, 54] = -1
    found = second_look._with_resting(mask, votes)
    assert found[20:30, 20:30].all() and not found[22:28, 52:58].any() and not found[:8].any()


def test_a_mask_that_was_given_is_not_joined(passing):
    passing.provenance["mask"] = {"provider": "user"}
    before = passing.mask.copy()
    assert second_look.join_resting(None, passing, PriorsConfig(), silent) == 0
    assert (passing.mask == before).all()
